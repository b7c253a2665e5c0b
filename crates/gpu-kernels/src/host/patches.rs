//! Host forms of the weighted means of receivers, and what those of the virtual patches check of their tables.

use ::patches::kernel::weights::{self, change_of, first_of, first_rotated, listed, rotation_of, weight_of};
use ::patches::{DifferenceParams, EMPTY_CELL, GridShape, WeightParams};
use ::scene::Rgb;

use super::view::{ViewOf, gather_view, mark_rows};
use super::{Bound, HostCall, HostError, fill};
use crate::table::Kernel;

/// Voxels of a grid; a count that does not fit is more than any table has.
pub(crate) fn voxels(shape: &GridShape) -> Result<usize, HostError> {
    let counts = [shape.count_x, shape.count_y, shape.count_z].map(|n| n as usize);
    let found = counts.into_iter().fold(1, usize::saturating_mul);
    if found == 0 { Err(HostError::TooShort { binding: "voxels of the grid", needed: 1, found }) } else { Ok(found) }
}

/// The greatest number in a table of cells, and one more.
pub(crate) fn cells_named(cells: &[u32]) -> usize {
    cells.iter().map(|cell| (cell & !EMPTY_CELL) as usize + 1).max().unwrap_or(0)
}

/// Length of a table that has so many values for each probe that is named.
pub(crate) fn of_probes(probes: &[u32], values: u32) -> usize {
    cells_named(probes) * values as usize
}

/// Blocks of rows of weights.
pub(crate) fn blocks(p: &WeightParams) -> Result<usize, HostError> {
    match p.count.checked_div(p.block_rows) {
        Some(_) => Ok(p.count.div_ceil(p.block_rows) as usize),
        None => Err(HostError::TooShort { binding: "rows of a block", needed: 1, found: 0 }),
    }
}

/// Blocks of the rows of weights that pixels take from.
pub(crate) fn difference_blocks(p: &DifferenceParams) -> Result<usize, HostError> {
    blocks(&WeightParams { count: p.rows, block_rows: p.block_rows, ..WeightParams::default() })
}

/// Tables of packed rows of weights.
struct Rows<'a> {
    p: WeightParams,
    row_start: &'a [u32],
    list_start: &'a [u32],
    lists: &'a [u32],
    entries: &'a [u16],
}

impl<'a> Rows<'a> {
    fn new(p: WeightParams, [row_start, list_start, lists, entries]: [Bound<'a, '_>; 4]) -> Result<Self, HostError> {
        let row_start = row_start.read::<u32>(p.count as usize + 1)?;
        let list_start = list_start.read::<u32>(blocks(&p)?)?;
        let numbers = first_of(row_start[p.count as usize]) as usize;
        let entries = bytemuck::cast_slice(entries.read::<u32>(numbers.div_ceil(2))?);
        Ok(Self { p, row_start, list_start, lists: lists.read(0)?, entries })
    }

    /// The list of a row's block, its entries, and those with a rotation.
    #[inline]
    fn row(&self, k: usize) -> (&[u32], &[u16], &[[u16; 2]]) {
        let end = first_of(self.row_start[k + 1]);
        let rotated = first_rotated(self.row_start[k], end) as usize;
        let list = &self.lists[self.list_start[k / self.p.block_rows as usize] as usize..];
        let plain = &self.entries[first_of(self.row_start[k]) as usize..rotated];
        (list, plain, self.entries[rotated..end as usize].as_chunks().0)
    }

    /// [`weights::weighted_row`] with what is known of a row checked once.
    fn sum(&self, k: usize, received: &[Rgb]) -> Rgb {
        match self.p.parts {
            1 => self.sum_of(k, received, |receiver| received[(self.p.first_value + receiver) as usize]),
            _ => self.sum_of(k, received, |receiver| weights::value_of(&self.p, receiver, received)),
        }
    }

    #[inline]
    fn sum_of(&self, k: usize, received: &[Rgb], value: impl Fn(u32) -> Rgb) -> Rgb {
        let (list, plain, rotated) = self.row(k);
        let mut sum = Rgb::ZERO;
        for &entry in plain {
            let entry = u32::from(entry);
            sum += value(list[listed(entry) as usize]) * weight_of(entry);
        }
        for &[entry, rotation] in rotated {
            let entry = u32::from(entry);
            let receiver = list[listed(entry) as usize];
            let (right, up) = rotation_of(u32::from(rotation));
            sum += (value(receiver) + change_of(receiver, right, up, received)) * weight_of(entry);
        }
        sum
    }

    /// The receivers that row `k` takes from, and whether each is rotated.
    fn receivers(&self, k: usize, mut each: impl FnMut(u32, bool)) {
        let (list, plain, rotated) = self.row(k);
        plain.iter().for_each(|&entry| each(list[listed(u32::from(entry)) as usize], false));
        rotated.iter().for_each(|entry| each(list[listed(u32::from(entry[0])) as usize], true));
    }
}

pub(crate) fn weigh(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, list_start, lists, entries, received, irradiance]) = call.parts::<WeightParams, 6>(kernel)?;
    let rows = Rows::new(p, [row_start, list_start, lists, entries])?;
    let received = received.read::<Rgb>(0)?;
    fill(irradiance.write(p.count as usize)?, |k| rows.sum(k as usize, received));
    Ok(())
}

pub(crate) fn weigh_view(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, list_start, lists, entries, received, marks, computed, irradiance]) =
        call.parts::<WeightParams, 8>(kernel)?;
    let rows = Rows::new(p, [row_start, list_start, lists, entries])?;
    let received = received.read::<Rgb>(0)?;
    let of = ViewOf { rows: p.count, view: p.view, light: p.light };
    gather_view(of, [marks, computed, irradiance], |k| rows.sum(k, received))
}

pub(crate) fn mark_receivers(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, list_start, lists, entries, row_marks, marks]) = call.parts::<WeightParams, 6>(kernel)?;
    let rows = Rows::new(p, [row_start, list_start, lists, entries])?;
    let row_marks = row_marks.write::<u32>(p.count as usize)?;
    mark_rows(p.view, row_marks, marks.whole()?, |k, set| {
        rows.receivers(k, |receiver, is_rotated| {
            (0..p.parts).for_each(|part| set.insert(p.first_value + p.parts * receiver + part));
            if is_rotated {
                (0..4).for_each(|quadrant| set.insert(4 * receiver + quadrant));
            }
        });
    });
    Ok(())
}
