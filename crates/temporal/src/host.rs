//! The host side: distributions over rows, and frames on all cores.

mod frame;
mod lists;
mod tables;

pub use frame::{Blend, Distribution, MAX_SAMPLES, Settings, State, change_all};
pub use lists::{RayLists, sample_lists_all, sum_lists_all};
pub use tables::{AliasTables, Packing, TableColumns, pack_all, sample_tables_all, scan_all, sum_tables_all};

use alloc::vec::Vec;

use scene::parallel::*;

use crate::error::Error;
use crate::types::SumParams;

/// Most columns that 16 bits name.
const NARROW_COLUMNS: usize = 1 << 16;
/// Rows that one task samples.
const TASK_ROWS: usize = 64;

/// Numbers of 16 bits, two a word, the first in the lower half.
fn pack_halves(numbers: impl ExactSizeIterator<Item = u32>) -> Vec<u32> {
    let mut words = vec![0; numbers.len().div_ceil(2)];
    numbers.enumerate().for_each(|(k, number)| words[k / 2] |= number << (16 * (k % 2)));
    words
}

/// Columns as kernels take them, of 16 bits where all fit.
fn pack_columns(numbers: Vec<u32>, columns: usize) -> Vec<u32> {
    if columns <= NARROW_COLUMNS { pack_halves(numbers.into_iter()) } else { numbers }
}

/// Starts of rows of these lengths.
fn starts(lengths: impl Iterator<Item = usize>) -> Result<Vec<u32>, Error> {
    let mut starts = vec![0];
    let mut end = 0u64;
    for length in lengths {
        end += length as u64;
        // Room for the half word at the end.
        if end >= u64::from(u32::MAX) {
            return Err(Error::TooMany { name: "entries", found: end, limit: u64::from(u32::MAX) - 1 });
        }
        starts.push(end as u32);
    }
    Ok(starts)
}

/// The rows of a sum with what `row` makes of each of them and of its value before, on all cores.
fn sum_rows<T: Copy + Send>(p: &SumParams, values: &mut [T], row: impl Fn(u32, T) -> T + Sync) {
    let rows = p.rows as usize;
    let first = p.first as usize;
    let count = p.count as usize;
    let wrapped = (p.first as usize + p.count as usize).saturating_sub(rows);
    let part = |values: &mut [T], first: usize| {
        values
            .par_iter_mut()
            .with_min_len(TASK_ROWS)
            .enumerate()
            .for_each(|(k, value)| *value = row((first + k) as u32, *value));
    };
    part(&mut values[first..first + count - wrapped], first);
    part(&mut values[..wrapped], 0);
}

/// Checks the rows of compressed sparse rows.
fn check_rows(columns: usize, row_start: &[u32], column_index: &[u32], values: &[f32]) -> Result<(), Error> {
    use crate::error::check_length;
    if row_start.is_empty() {
        return Err(Error::Length { name: "row_start", expected: 1, found: 0 });
    }
    if let Some(index) = row_start.windows(2).position(|pair| pair[0] > pair[1]) {
        let value = f64::from(row_start[index + 1]);
        return Err(Error::Value { name: "row_start", index: index + 1, value, rule: "no less than the one before" });
    }
    let count = row_start[row_start.len() - 1] as usize;
    check_length("column_index", count, column_index.len())?;
    check_length("values", count, values.len())?;
    if let Some(index) = column_index.iter().position(|&j| j as usize >= columns) {
        let value = f64::from(column_index[index]);
        return Err(Error::Value { name: "column_index", index, value, rule: "below the number of columns" });
    }
    if let Some(index) = values.iter().position(|v| !(v.is_finite() && *v >= 0.0)) {
        return Err(Error::Value {
            name: "values",
            index,
            value: f64::from(values[index]),
            rule: "finite and not negative",
        });
    }
    Ok(())
}
