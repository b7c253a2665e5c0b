//! Rows as lists of what their rays hit.

use alloc::vec::Vec;

use glam::Vec4;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::parallel::*;
use transport::LinearOperator;

use super::frame::{Distribution, check_vectors, sum_rows_all};
use super::{NARROW_COLUMNS, TASK_ROWS, check_rows, pack_columns, starts, sum_rows};
use crate::error::{Error, check_length};
use crate::kernel::sample::{NARROW, column_at, sample_list, settle, sum_list};
use crate::types::{SampleParams, SumParams};

/// Rows whose entries are all equally likely: what the rays of each row hit, in ascending order, with repetitions. A
/// uniform index samples the row. 2 bytes an entry up to 65,536 columns, else 4.
///
/// Rays that meet nothing that shines are left out: the row's sum S is the share of the others, and no sample is spent
/// on them. A sky that shines is a column like any other (usually the last), with `π L` as its exitance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RayLists {
    columns: usize,
    row_start: Vec<u32>,
    words: Vec<u32>,
    sums: Vec<f32>,
}

impl RayLists {
    /// From the rays themselves: row k was hit by `hits[k · rays..(k + 1) · rays]`, in any order. What is no column
    /// (the sky, hits without owner) is left out, so the row's sum is the share that is one.
    ///
    /// # Errors
    /// [`Error::Setting`] for no rays, [`Error::Length`] for a part of a row, [`Error::TooMany`].
    pub fn from_hits(columns: usize, hits: &[u32], rays: usize) -> Result<Self, Error> {
        if rays == 0 {
            return Err(Error::Setting { name: "rays", value: 0.0, rule: "at least 1" });
        }
        let rows = hits.len() / rays;
        check_length("hits", rows * rays, hits.len())?;
        Self::gather(columns, rows, |i| {
            let own = hits[i * rays..(i + 1) * rays].iter().copied().filter(|&j| (j as usize) < columns);
            let mut list: Vec<u32> = own.collect();
            list.sort_unstable();
            let sum = list.len() as f32 / rays as f32;
            (list, sum)
        })
    }

    /// From counts: `row(i)` names the columns that the rays of row i hit and how many hit each; `scales[i]` is the
    /// factor of one hit.
    ///
    /// # Errors
    /// [`Error::Value`] for a column that is not there or a scale that is negative or not finite; [`Error::TooMany`].
    pub fn from_counts(
        columns: usize,
        scales: &[f32],
        row: impl Fn(usize) -> Vec<(u32, u32)> + Sync,
    ) -> Result<Self, Error> {
        if let Some(index) = scales.iter().position(|s| !(s.is_finite() && *s >= 0.0)) {
            let value = f64::from(scales[index]);
            return Err(Error::Value { name: "scales", index, value, rule: "finite and not negative" });
        }
        let lists = Self::gather(columns, scales.len(), |i| {
            let list: Vec<u32> =
                row(i).iter().flat_map(|&(j, count)| core::iter::repeat_n(j, count as usize)).collect();
            let sum = scales[i] * list.len() as f32;
            (list, sum)
        })?;
        lists.check_columns()?;
        Ok(lists)
    }

    /// From compressed sparse rows, `entries` for each row that is not zero, shared out in proportion to the values: a
    /// column has a whole number of entries less than one away from its exact share. The row's sum is exact.
    ///
    /// # Errors
    /// [`Error::Setting`] for no entries; [`Error::Length`], [`Error::Value`] for rows that are none;
    /// [`Error::TooMany`].
    pub fn from_rows(
        columns: usize,
        row_start: &[u32],
        column_index: &[u32],
        values: &[f32],
        entries: usize,
    ) -> Result<Self, Error> {
        check_rows(columns, row_start, column_index, values)?;
        if entries == 0 {
            return Err(Error::Setting { name: "entries", value: 0.0, rule: "at least 1" });
        }
        Self::gather(columns, row_start.len() - 1, |i| {
            let own = row_start[i] as usize..row_start[i + 1] as usize;
            let sum: f64 = values[own.clone()].iter().map(|&v| f64::from(v)).sum();
            let mut list = Vec::new();
            if sum > 0.0 {
                let mut end = 0.0;
                for k in own {
                    end += f64::from(values[k]) * entries as f64 / sum;
                    // Entry e stands for what lies about e + ½.
                    let next = (end + 0.5).floor().min(entries as f64) as usize;
                    list.resize(next.max(list.len()), column_index[k]);
                }
                let last = list.last().copied();
                list.resize(entries, last.unwrap_or(0));
            }
            (list, sum as f32)
        })
    }

    fn gather(columns: usize, rows: usize, row: impl Fn(usize) -> (Vec<u32>, f32) + Sync) -> Result<Self, Error> {
        let made: Vec<(Vec<u32>, f32)> = (0..rows).into_par_iter().map(&row).collect();
        let row_start = starts(made.iter().map(|row| row.0.len()))?;
        let sums = made.iter().map(|row| row.1).collect();
        let mut numbers = Vec::with_capacity(row_start[rows] as usize);
        made.into_iter().for_each(|row| numbers.extend(row.0));
        Ok(Self { columns, row_start, words: pack_columns(numbers, columns), sums })
    }

    fn check_columns(&self) -> Result<(), Error> {
        let all = 0..self.row_start.last().copied().unwrap_or(0);
        let wrong = all.into_iter().find(|&e| column_at(e, &self.words, self.options()) as usize >= self.columns);
        match wrong {
            Some(e) => {
                let value = f64::from(column_at(e, &self.words, self.options()));
                Err(Error::Value { name: "columns", index: e as usize, value, rule: "below the number of columns" })
            }
            None => Ok(()),
        }
    }

    /// Row i owns the entries `row_start[i]..row_start[i + 1]`; `[rows + 1]`.
    pub fn row_start(&self) -> &[u32] {
        &self.row_start
    }

    /// Columns of the entries, two a word where 16 bits hold all.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// Sum S of each row.
    pub fn sums(&self) -> &[f32] {
        &self.sums
    }

    /// Columns of a row's entries; none for a row that is not there.
    pub fn row(&self, i: usize) -> Vec<u32> {
        let (Some(&first), Some(&end)) = (self.row_start.get(i), self.row_start.get(i + 1)) else { return Vec::new() };
        (first..end).map(|e| column_at(e, &self.words, self.options())).collect()
    }
}

impl LinearOperator for RayLists {
    fn shape(&self) -> (usize, usize) {
        (self.sums.len(), self.columns)
    }

    fn bytes(&self) -> u64 {
        let bytes = size_of_val(&self.row_start[..]) + size_of_val(&self.words[..]) + size_of_val(&self.sums[..]);
        bytes as u64
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        sum_rows_all(self, exitance, irradiance)
    }
}

impl Distribution for RayLists {
    fn options(&self) -> u32 {
        if self.columns <= NARROW_COLUMNS { NARROW } else { 0 }
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
        sample_lists_all(&p, &self.row_start, &self.words, &self.sums, exitance, change, irradiance);
        Ok(())
    }

    fn sum(&self, p: &SumParams, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        check_vectors(self, exitance, exitance, irradiance)?;
        let p = p.within(self.rows(), self.options())?;
        sum_lists_all(&p, &self.row_start, &self.words, &self.sums, exitance, irradiance);
        Ok(())
    }
}

/// [`sample_list`] for all rows of a block, on all cores.
pub fn sample_lists_all(
    p: &SampleParams,
    row_start: &[u32],
    columns: &[u32],
    sums: &[f32],
    exitance: &[Vec4],
    change: &[Vec4],
    irradiance: &mut [Vec4],
) {
    irradiance.par_iter_mut().with_min_len(TASK_ROWS).enumerate().for_each(|(i, h)| {
        *h = sample_list(i as u32, p, row_start, columns, sums, exitance, change, *h);
    });
}

/// Exact sums of some rows of a block, on all cores; the others stay. Needs `first < rows` and `count ≤ rows`.
pub fn sum_lists_all(
    p: &SumParams,
    row_start: &[u32],
    columns: &[u32],
    sums: &[f32],
    exitance: &[Vec4],
    irradiance: &mut [Vec4],
) {
    sum_rows(p, irradiance, |i, h| settle(h, sum_list(i, p, row_start, columns, sums, exitance)));
}
