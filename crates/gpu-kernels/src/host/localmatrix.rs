//! Host forms of the kernels of the matrix round a camera: the bodies on all cores.

use ::localmatrix::kernel::{self, BLOCK, KEPT};
use ::localmatrix::{SlotParams, UpdateParams};
use ::scene::Rgb;
use glam::{UVec2, Vec4};
use rayon::prelude::*;
use std::vec::Vec;

use super::{HostCall, HostError, fill};
use crate::params::CountParams;
use crate::table::Kernel;

/// Indices of a table must be below the number of the elements they name.
fn check(binding: &'static str, most: Option<u32>, found: usize) -> Result<(), HostError> {
    match most {
        Some(most) if most as usize >= found => Err(HostError::TooShort { binding, needed: most as usize + 1, found }),
        _ => Ok(()),
    }
}

/// Number of leaves that runs of them need.
pub(crate) fn end_of_runs(runs: &[UVec2]) -> usize {
    runs.iter().map(|run| run.y).max().unwrap_or(0) as usize
}

/// Number of slots that a table names, except those that keep what they had.
pub(crate) fn slots_named(slots: &[u32]) -> usize {
    slots.iter().filter(|slot| **slot != KEPT).max().map_or(0, |slot| *slot as usize + 1)
}

fn blocks(slots: u32) -> usize {
    slots.div_ceil(BLOCK) as usize
}

pub(crate) fn compact(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [starts, values, list]) = call.parts::<CountParams, 3>(kernel)?;
    let n = p.count as usize;
    let starts = starts.read::<u32>(blocks(p.count) + 1)?;
    let values = values.read::<Rgb>(n)?;
    if !starts.is_sorted() {
        return Err(HostError::TooShort { binding: "starts", needed: n, found: 0 });
    }
    check("list", starts[blocks(p.count)].checked_sub(1), n)?;
    fill(list.write(n)?, |place| kernel::compact(place, p.count, starts, values));
    Ok(())
}

pub(crate) fn product(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, bound) = call.parts::<SlotParams, 10>(kernel)?;
    let [lit_starts, lit, visible_starts, visible, red, green, blue, sqrt_area, light, irradiance] = bound;
    let n = p.count as usize;
    let slots = p.slots as usize;
    let end = blocks(p.slots);
    let lit_count = lit_starts.read::<u32>(end + 1)?[end];
    let seen = visible_starts.read::<u32>(end + 1)?[end];
    let lit = lit.read::<u32>(lit_count as usize)?;
    let visible = visible.read::<u32>(n)?;
    check("light", lit[..lit_count as usize].iter().max().copied(), slots)?;
    check("irradiance", visible[..n].iter().max().copied(), slots)?;
    let [red, green, blue] = [red.read::<f32>(slots * slots)?, green.read(slots * slots)?, blue.read(slots * slots)?];
    let sqrt_area = sqrt_area.read::<f32>(slots)?;
    let light = light.read::<Rgb>(slots)?;
    let irradiance: &mut [Rgb] = irradiance.write(slots)?;
    let one = |k: usize| {
        let count = if (k as u32) < seen { lit_count } else { 0 };
        kernel::gather(visible[k], p.slots, count, lit, red, green, blue, sqrt_area, light)
    };
    let sums: Vec<Vec4> = (0..n).into_par_iter().with_min_len(16).map(one).collect();
    visible.iter().zip(sums).for_each(|(&slot, sum)| irradiance[slot as usize] = sum);
    Ok(())
}

pub(crate) fn update(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [vectors, columns, new_column, plane]) = call.parts::<UpdateParams, 4>(kernel)?;
    let n = p.count as usize;
    let slots = p.slots as usize;
    if slots == 0 || !slots.is_multiple_of(4) || 4 * n > slots * slots {
        return Err(HostError::TooShort { binding: "plane", needed: 4 * n, found: slots * slots });
    }
    let vectors = vectors.read::<f32>(p.first_vector as usize + p.rank as usize * slots)?;
    let new_column = new_column.read::<u32>(slots)?;
    let new = new_column[..slots].iter().filter(|one| **one != KEPT).max().map_or(0, |one| *one as usize + 1);
    let columns = columns.read::<f32>(p.first_column as usize + new * slots)?;
    let plane: &mut [f32] = plane.write(4 * n)?;
    plane.par_chunks_mut(4).with_min_len(64).enumerate().for_each(|(k, four)| {
        let new = kernel::update(k as u32, &p, vectors, columns, new_column, Vec4::from_slice(four));
        four.copy_from_slice(&new.to_array());
    });
    Ok(())
}
