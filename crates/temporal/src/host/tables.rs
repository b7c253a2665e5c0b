//! Alias tables of rows.

use alloc::vec::Vec;

use glam::{UVec2, Vec3, Vec4};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::math::{luminance, sqrt};
use scene::parallel::*;
use transport::LinearOperator;
use transport::alias::pair_entries;

use super::frame::{Distribution, check_vectors, sum_rows_all};
use super::{NARROW_COLUMNS, TASK_ROWS, check_rows, pack_columns, pack_halves, starts, sum_rows};
use crate::error::Error;
use crate::kernel::sample::{COLORED, NARROW, settle};
use crate::kernel::split::{pack_entry, scan_row, slot};
use crate::kernel::tables::{MAX_BLUE, MAX_RED, PARTS, decode, sample_table, sum_table};
use crate::types::{SampleParams, SumParams};

/// Most entries of a row: their numbers have 16 bits, their weights together 32.
const MAX_ENTRIES: usize = u16::MAX as usize;

/// Search for slots by weight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Packing {
    /// One after the other, from stacks of light and heavy entries (Vose 1991).
    #[default]
    Stacks,
    /// All at once, by prefix sums, as the kernels do: [`crate::kernel::split`].
    Split,
}

/// Rows as alias tables over their entries that are not zero: 4 bytes for a slot, 2 for its column (4 beyond 65,536
/// columns), and 2 for its colour where there are three channels. Probabilities are multiples of `2⁻¹⁶ / n` for a row
/// of n entries, and tables have exactly these.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AliasTables {
    columns: usize,
    row_start: Vec<u32>,
    slots: Vec<u32>,
    words: Vec<u32>,
    colors: Vec<u32>,
    sums: Vec<f32>,
}

/// A row before it is packed.
#[derive(Default)]
struct Row {
    columns: Vec<u32>,
    weights: Vec<u32>,
    colors: Vec<u32>,
    sum: f32,
}

impl Row {
    /// Entries of this column and share: whole parts whose sum is [`PARTS`] an entry, each less than one away from its
    /// exact share. What is left with none is left out.
    fn new(mut entries: Vec<(u32, f64)>) -> Self {
        entries.retain(|entry| entry.1 > 0.0);
        let sum: f64 = entries.iter().map(|entry| entry.1).sum();
        let mut row = Self { sum: sum as f32, ..Self::default() };
        // Fewer entries have larger parts: once more, until none is less than one part.
        loop {
            let all = (entries.len() as u64 * u64::from(PARTS)) as f64;
            let sum: f64 = entries.iter().map(|entry| entry.1).sum();
            let mut exact = 0.0;
            let mut given = 0.0f64;
            row.weights = entries
                .iter()
                .map(|entry| {
                    exact += entry.1;
                    let end = (exact / sum * all).round().clamp(given, all);
                    let weight = end - given;
                    given = end;
                    weight as u32
                })
                .collect();
            if !row.weights.contains(&0) {
                break;
            }
            let mut weights = row.weights.iter();
            entries.retain(|_| weights.next() != Some(&0));
        }
        row.columns = entries.iter().map(|entry| entry.0).collect();
        row
    }

    /// With colours of luminance 1; rounding goes on to the next entry, so that the row's sums of red and blue stay.
    fn colored(columns: &[Vec3]) -> Self {
        let entries = columns.iter().enumerate().map(|(j, c)| (j as u32, f64::from(luminance(*c)))).collect();
        let mut row = Self::new(entries);
        let mut owed = [0.0f32; 2];
        let codes = row.columns.iter().zip(&row.weights).map(|(&j, &weight)| {
            let c = columns[j as usize];
            let weight = weight as f32;
            let y = luminance(c);
            // At most what luminance leaves for it.
            let mut code = |k: usize, value: f32, most: f32, left: f32| {
                let wanted = value + owed[k] / weight;
                let near = (sqrt((wanted / most).clamp(0.0, 1.0)) * 255.0 + 0.5) as u32;
                let code = (0..=near).rev().find(|&code| decode(code, most) <= left).unwrap_or(0);
                // No more than an entry's own light is handed on.
                owed[k] = ((wanted - decode(code, most)) * weight).clamp(-weight, weight);
                code
            };
            let red = code(0, c.x / y, MAX_RED, MAX_RED);
            let left = 1.0 - decode(red, MAX_RED) / MAX_RED;
            red | code(1, c.z / y, MAX_BLUE, left * MAX_BLUE) << 8
        });
        row.colors = codes.collect();
        row
    }
}

/// Slots of a row by stacks of what is left of its entries (Vose 1991).
fn pack_stacks(weights: &[u32]) -> Vec<u32> {
    let mut left: Vec<u64> = weights.iter().map(|&w| u64::from(w)).collect();
    let mut slots: Vec<u32> = (0..weights.len() as u32).map(|k| slot(PARTS, k, k)).collect();
    pair_entries(&mut left, u64::from(PARTS), (0..weights.len() as u32).rev(), |entry, kept, other| {
        slots[entry as usize] = slot(kept as u32, entry, other);
    });
    slots
}

impl AliasTables {
    /// Packs compressed sparse rows, as [`Packing`] says, on all cores.
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Value`] for rows that are none; [`Error::TooMany`] entries, or more than 65,535 in a
    /// row.
    pub fn from_rows(
        columns: usize,
        row_start: &[u32],
        column_index: &[u32],
        values: &[f32],
        packing: Packing,
    ) -> Result<Self, Error> {
        check_rows(columns, row_start, column_index, values)?;
        Self::gather(columns, row_start.len() - 1, packing, |i| {
            let own = row_start[i] as usize..row_start[i + 1] as usize;
            Row::new(own.map(|k| (column_index[k], f64::from(values[k]))).collect())
        })
    }

    /// Packs an RGB operator, sampled by luminance: `row(i, colors)` writes row i, one colour a column. The channels of
    /// an entry that is sampled are its colour over its luminance, red and blue to 8 bits.
    ///
    /// # Errors
    /// [`Error::Value`] for a colour that is negative or not finite; [`Error::TooMany`] as for
    /// [`AliasTables::from_rows`].
    pub fn from_rgb(
        columns: usize,
        rows: usize,
        packing: Packing,
        row: impl Fn(usize, &mut [Vec3]) + Sync,
    ) -> Result<Self, Error> {
        let read = |i: usize| {
            let mut colors = vec![Vec3::ZERO; columns];
            row(i, &mut colors);
            colors
        };
        let wrong = |i: usize| {
            let colors = read(i);
            let is_wrong = |c: &Vec3| !(c.is_finite() && c.min_element() >= 0.0);
            colors.iter().position(is_wrong).map(|j| (i, f64::from(colors[j].min_element())))
        };
        if let Some((index, value)) = (0..rows).into_par_iter().find_map_first(wrong) {
            return Err(Error::Value { name: "rows", index, value, rule: "finite and not negative" });
        }
        Self::gather(columns, rows, packing, |i| Row::colored(&read(i)))
    }

    fn gather(columns: usize, rows: usize, packing: Packing, row: impl Fn(usize) -> Row + Sync) -> Result<Self, Error> {
        let made: Vec<Row> = (0..rows).into_par_iter().map(&row).collect();
        let longest = made.iter().map(|row| row.columns.len()).max().unwrap_or(0);
        if longest > MAX_ENTRIES {
            return Err(Error::TooMany { name: "entries of a row", found: longest as u64, limit: MAX_ENTRIES as u64 });
        }
        let row_start = starts(made.iter().map(|row| row.columns.len()))?;
        let sums = made.iter().map(|row| row.sum).collect();
        let entries = row_start[rows] as usize;
        let slots = match packing {
            Packing::Stacks => {
                let slots: Vec<Vec<u32>> = made.par_iter().map(|row| pack_stacks(&row.weights)).collect();
                slots.concat()
            }
            Packing::Split => {
                let weights: Vec<u32> = made.iter().flat_map(|row| row.weights.iter().copied()).collect();
                let mut scan = vec![UVec2::ZERO; entries];
                let mut slots = vec![0; entries];
                scan_all(&row_start, &weights, &mut scan);
                pack_all(rows as u32, &row_start, &weights, &scan, &mut slots);
                slots
            }
        };
        let colors: Vec<u32> = made.iter().flat_map(|row| row.colors.iter().copied()).collect();
        let mut numbers = Vec::with_capacity(entries);
        made.into_iter().for_each(|row| numbers.extend(row.columns));
        let words = pack_columns(numbers, columns);
        Ok(Self { columns, row_start, slots, words, colors: pack_halves(colors.into_iter()), sums })
    }

    /// Row i owns the entries `row_start[i]..row_start[i + 1]`; `[rows + 1]`.
    pub fn row_start(&self) -> &[u32] {
        &self.row_start
    }

    /// Slots by entry.
    pub fn slots(&self) -> &[u32] {
        &self.slots
    }

    /// Columns of the entries, two a word where 16 bits hold all.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// Colours of the entries, two a word; empty for one channel.
    pub fn colors(&self) -> &[u32] {
        &self.colors
    }

    /// Sum S of each row, of its luminance where it has colours.
    pub fn sums(&self) -> &[f32] {
        &self.sums
    }

    /// Weights of the entries in parts of a slot, from the slots: the probability of each is `weight / (2¹⁶ n)`.
    pub fn weights(&self, i: usize) -> Vec<u64> {
        let (Some(&first), Some(&end)) = (self.row_start.get(i), self.row_start.get(i + 1)) else { return Vec::new() };
        let mut weights = vec![0u64; (end - first) as usize];
        for (k, own) in self.slots[first as usize..end as usize].iter().enumerate() {
            let t = u64::from(own >> 16);
            let other = (own & 0xffff) as usize;
            weights[k] += t;
            weights[other] += u64::from(PARTS) - t;
        }
        weights
    }

    fn tables(&self) -> TableColumns<'_> {
        let Self { row_start, slots, words, colors, sums, .. } = self;
        TableColumns { row_start, slots, columns: words, colors, sums }
    }
}

/// The tables of a block of rows, as [`sample_table`] takes them.
#[derive(Clone, Copy, Debug)]
pub struct TableColumns<'a> {
    /// First entry of each row, and the end of the last.
    pub row_start: &'a [u32],
    /// Slots.
    pub slots: &'a [u32],
    /// Columns.
    pub columns: &'a [u32],
    /// Colours.
    pub colors: &'a [u32],
    /// Sums of the rows.
    pub sums: &'a [f32],
}

impl LinearOperator for AliasTables {
    fn shape(&self) -> (usize, usize) {
        (self.sums.len(), self.columns)
    }

    fn bytes(&self) -> u64 {
        let bytes = size_of_val(&self.row_start[..])
            + size_of_val(&self.slots[..])
            + size_of_val(&self.words[..])
            + size_of_val(&self.colors[..])
            + size_of_val(&self.sums[..]);
        bytes as u64
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        sum_rows_all(self, exitance, irradiance)
    }
}

impl Distribution for AliasTables {
    fn options(&self) -> u32 {
        let narrow = if self.columns <= NARROW_COLUMNS { NARROW } else { 0 };
        narrow | if self.colors.is_empty() { 0 } else { COLORED }
    }

    fn sample(
        &self,
        p: &SampleParams,
        exitance: &[Vec4],
        change: &[Vec4],
        irradiance: &mut [Vec4],
    ) -> Result<(), Error> {
        check_vectors(self, exitance, change, irradiance)?;
        let p = SampleParams { first_row: 0, first_entry: 0, options: p.options | self.options(), ..*p };
        sample_tables_all(&p, &self.tables(), exitance, change, irradiance);
        Ok(())
    }

    fn sum(&self, p: &SumParams, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        check_vectors(self, exitance, exitance, irradiance)?;
        let p = p.within(self.rows(), self.options())?;
        sum_tables_all(&p, &self.tables(), exitance, irradiance);
        Ok(())
    }
}

/// [`sample_table`] for all rows of a block, on all cores.
pub fn sample_tables_all(
    p: &SampleParams,
    tables: &TableColumns,
    exitance: &[Vec4],
    change: &[Vec4],
    irradiance: &mut [Vec4],
) {
    let TableColumns { row_start, slots, columns, colors, sums } = *tables;
    irradiance.par_iter_mut().with_min_len(TASK_ROWS).enumerate().for_each(|(i, h)| {
        *h = sample_table(i as u32, p, row_start, slots, columns, colors, sums, exitance, change, *h);
    });
}

/// Exact sums of some rows of a block, on all cores; the others stay. Needs `first < rows` and `count ≤ rows`.
pub fn sum_tables_all(p: &SumParams, tables: &TableColumns, exitance: &[Vec4], irradiance: &mut [Vec4]) {
    let TableColumns { row_start, slots, columns, colors, sums } = *tables;
    sum_rows(p, irradiance, |i, h| settle(h, sum_table(i, p, row_start, slots, columns, colors, sums, exitance)));
}

/// [`scan_row`] for all rows, on all cores. Needs `scan` and `weights` as long as the rows.
pub fn scan_all(row_start: &[u32], weights: &[u32], scan: &mut [UVec2]) {
    let mut parts = Vec::with_capacity(row_start.len());
    let mut rest = scan;
    for (row, range) in row_start.windows(2).enumerate() {
        let (own, after) = rest.split_at_mut((range[1] - range[0]) as usize);
        parts.push((row as u32, own));
        rest = after;
    }
    parts.into_par_iter().with_min_len(16).for_each(|(row, own)| {
        scan_row(row, row_start, weights, row_start[row as usize], own);
    });
}

/// [`pack_entry`] for all entries, on all cores.
pub fn pack_all(rows: u32, row_start: &[u32], weights: &[u32], scan: &[UVec2], slots: &mut [u32]) {
    slots.par_iter_mut().with_min_len(256).enumerate().for_each(|(entry, slot)| {
        *slot = pack_entry(entry as u32, rows, row_start, weights, scan);
    });
}
