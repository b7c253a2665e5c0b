//! Packed rows of weights of receivers.

use alloc::vec::Vec;

use glam::{Vec2, Vec4};
use scene::parallel::*;
use transport::{QUADRANTS, check_length};

use crate::error::Error;
use crate::kernel::weights::{
    LISTED_BITS, MAX_LISTED, ROTATED_BITS, ROTATION_BIAS, ROTATION_STEPS, WEIGHT_BIAS, WEIGHT_STEPS, first_of,
    first_rotated, half_word, listed, rotation_of, weight_of, weighted_row,
};
use crate::types::WeightParams;

/// Most rows of a block.
const MAX_BLOCK_ROWS: usize = 16;
/// Rows that are packed together on all cores.
const ROWS_PER_BATCH: usize = 1 << 16;

/// A receiver's share of a value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weight {
    /// Number of the receiver.
    pub receiver: u32,
    /// Its weight, between −2 and 2.
    pub weight: f32,
    /// By how much its normal differs, to the right and upwards of its frame, each at most 1/2; `None` where it does
    /// not.
    pub rotation: Option<Vec2>,
}

/// Rows of weights of receivers near each other, about three bytes a weight: each row is a weighted mean of their
/// values and of their rotated irradiance ([`crate::kernel::weights::weighted_row`]). Weights are rounded to steps of
/// 1/128 so that their sum is that of the row, to half a step; light that is the same everywhere stays so.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PackedWeights {
    block_rows: u32,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    row_start: Vec<u32>,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    list_start: Vec<u32>,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    lists: Vec<u32>,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    entries: Vec<u32>,
}

impl PackedWeights {
    /// `rows` rows, of which `row` makes each, on all cores. Rows that follow each other should name the same
    /// receivers.
    ///
    /// # Errors
    /// [`Error::TooMany`] for a row of more than 128 weights or of more than 31 rotations, and beyond 2²⁷ numbers of 16
    /// bits; [`Error::Value`] for a weight that is out of its range.
    pub fn new(rows: usize, row: impl Fn(usize) -> Vec<Weight> + Sync) -> Result<Self, Error> {
        let longest = (0..rows).into_par_iter().map(|k| row(k).len()).max().unwrap_or(0);
        check_most("weights of a row", longest as u64, u64::from(MAX_LISTED))?;
        let mut block_rows = MAX_BLOCK_ROWS;
        while block_rows * longest > MAX_LISTED as usize {
            block_rows /= 2;
        }
        let mut packed = Self { block_rows: block_rows as u32, ..Self::default() };
        let mut units: Vec<u16> = Vec::new();
        for first in (0..rows).step_by(ROWS_PER_BATCH) {
            let end = rows.min(first + ROWS_PER_BATCH);
            let starts = (first..end).into_par_iter().step_by(block_rows);
            let blocks: Result<Vec<Block>, Error> =
                starts.map(|start| Block::new(start, end.min(start + block_rows), &row)).collect();
            for block in blocks? {
                packed.list_start.push(packed.lists.len() as u32);
                packed.lists.extend(block.list);
                for row in block.rows {
                    packed.row_start.push((units.len() as u32) << ROTATED_BITS | row.rotated);
                    units.extend(row.units);
                }
                check_most("numbers of weights", units.len() as u64, u64::from(u32::MAX >> ROTATED_BITS))?;
            }
        }
        packed.row_start.push((units.len() as u32) << ROTATED_BITS);
        let word = |pair: &[u16]| u32::from(pair[0]) | u32::from(pair.get(1).copied().unwrap_or(0)) << 16;
        packed.entries = units.par_chunks(2).map(word).collect();
        Ok(packed)
    }

    /// Checks tables that come from a file: so many rows over so many receivers.
    ///
    /// # Errors
    /// [`Error::Shared`] naming the first table that does not fit.
    #[cfg(feature = "serde")]
    pub(super) fn check(&self, rows: usize, receivers: usize) -> Result<(), Error> {
        let rule = "1, 2, 4, 8 or 16";
        let blocks = f64::from(self.block_rows);
        transport::check_setting("rows of a block", blocks, rule, matches!(self.block_rows, 1 | 2 | 4 | 8 | 16))?;
        let first: Vec<u32> = self.row_start.iter().map(|&start| first_of(start)).collect();
        let units = first.last().map_or(0, |&end| end as usize);
        transport::check_offsets("row_start", rows, units, &first)?;
        check_length("entries", units.div_ceil(2), self.entries.len())?;
        check_length("list_start", rows.div_ceil(self.block_rows as usize), self.list_start.len())?;
        let mut lists = self.list_start.clone();
        lists.push(self.lists.len() as u32);
        transport::check_offsets("list_start", self.list_start.len(), self.lists.len(), &lists)?;
        transport::check_indices("lists", receivers, false, &self.lists)?;
        for (k, pair) in self.row_start.windows(2).enumerate() {
            let block = k / self.block_rows as usize;
            let start = first_of(pair[0]);
            let end = first_of(pair[1]);
            let tail = 2 * (pair[0] & ((1 << ROTATED_BITS) - 1));
            transport::check_setting("rotated", f64::from(tail), "within its row", tail <= end - start)?;
            let rotated = end - tail;
            let named = (start..rotated).chain((rotated..end).step_by(2));
            let listed: Vec<u32> = named.map(|unit| listed(half_word(&self.entries, unit))).collect();
            transport::check_indices("entries", (lists[block + 1] - lists[block]) as usize, false, &listed)?;
        }
        Ok(())
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.row_start.len().saturating_sub(1)
    }

    /// Number of weights.
    pub fn weights(&self) -> usize {
        let of_row = |starts: &[u32]| {
            let end = first_of(starts[1]);
            let rotated = first_rotated(starts[0], end);
            (rotated - first_of(starts[0]) + (end - rotated) / 2) as usize
        };
        self.row_start.par_windows(2).map(of_row).sum()
    }

    /// Rows of a block.
    pub fn block_rows(&self) -> u32 {
        self.block_rows
    }

    /// First number of each row, and how many of its entries are rotated; `[rows + 1]`.
    pub fn row_start(&self) -> &[u32] {
        &self.row_start
    }

    /// First of the list of each block of rows.
    pub fn list_start(&self) -> &[u32] {
        &self.list_start
    }

    /// The receivers that each block takes from.
    pub fn lists(&self) -> &[u32] {
        &self.lists
    }

    /// Entries, two numbers of 16 bits a word.
    pub fn entries(&self) -> &[u32] {
        &self.entries
    }

    /// Bytes of all tables.
    pub fn bytes(&self) -> u64 {
        (size_of::<u32>() * (self.row_start.len() + self.list_start.len() + self.lists.len() + self.entries.len()))
            as u64
    }

    /// The product with values, on all cores: `out[k]` is [`weighted_row`] of row k, `[rows]`. Values of receivers
    /// begin at `first_value` and are the sum of `parts` numbers each; the quadrants' come first.
    ///
    /// # Errors
    /// [`transport::Error::Length`] for another number of results, or for fewer values than the rows name.
    pub fn apply(&self, first_value: usize, parts: usize, values: &[Vec4], out: &mut [Vec4]) -> Result<(), Error> {
        check_length("results", self.rows(), out.len())?;
        if let Some(&last) = self.lists.iter().max() {
            let needed = (first_value + parts * (last as usize + 1)).max(QUADRANTS * (last as usize + 1));
            check_length("values", needed, values.len().min(needed))?;
        }
        let params = WeightParams {
            count: self.rows() as u32,
            block_rows: self.block_rows,
            first_value: first_value as u32,
            parts: parts as u32,
            ..WeightParams::default()
        };
        out.par_iter_mut().enumerate().for_each(|(k, out)| {
            let Self { row_start, list_start, lists, entries, .. } = self;
            *out = weighted_row(k as u32, &params, row_start, list_start, lists, entries, values);
        });
        Ok(())
    }

    /// The weights of row `k`, as they are used; nothing for a row that is not there.
    pub fn row(&self, k: usize) -> Vec<Weight> {
        let (Some(&start), Some(&end)) = (self.row_start.get(k), self.row_start.get(k + 1)) else { return Vec::new() };
        let rotated = first_rotated(start, first_of(end));
        let list = self.list_start[k / self.block_rows as usize];
        let weight = |unit: u32, rotation: Option<Vec2>| {
            let entry = half_word(&self.entries, unit);
            Weight { receiver: self.lists[(list + listed(entry)) as usize], weight: weight_of(entry), rotation }
        };
        let mut row: Vec<Weight> = (first_of(start)..rotated).map(|unit| weight(unit, None)).collect();
        for unit in (rotated..first_of(end)).step_by(2) {
            row.push(weight(unit, Some(rotation_of(half_word(&self.entries, unit + 1)).into())));
        }
        row
    }
}

/// Some rows, and the receivers that they take from.
struct Block {
    list: Vec<u32>,
    rows: Vec<PackedRow>,
}

struct PackedRow {
    units: Vec<u16>,
    rotated: u32,
}

impl Block {
    fn new(first: usize, end: usize, row: &(impl Fn(usize) -> Vec<Weight> + Sync)) -> Result<Self, Error> {
        let mut rows = Vec::with_capacity(end - first);
        for k in first..end {
            let row = row(k);
            if let Some(wrong) = row.iter().find(|weight| !is_in_range(weight)) {
                let value = f64::from(wrong.weight);
                return Err(Error::Value { name: "weights", index: k, value, rule: "between -2 and 2" });
            }
            rows.push(rounded(row));
        }
        let mut list: Vec<u32> = rows.iter().flatten().map(|(weight, _)| weight.receiver).collect();
        list.sort_unstable();
        list.dedup();
        let packed: Result<Vec<PackedRow>, Error> = rows.iter().map(|row| PackedRow::new(row, &list)).collect();
        Ok(Self { rows: packed?, list })
    }
}

impl PackedRow {
    fn new(row: &[(Weight, i32)], list: &[u32]) -> Result<Self, Error> {
        let mut units = Vec::with_capacity(row.len());
        let mut rotated = 0;
        // Those with a rotation come last.
        for is_rotated in [false, true] {
            for (weight, steps) in row.iter().filter(|(weight, _)| weight.rotation.is_some() == is_rotated) {
                let place = list.partition_point(|&receiver| receiver < weight.receiver);
                units.push(place as u16 | ((steps + WEIGHT_BIAS as i32) as u16) << LISTED_BITS);
                if let Some(rotation) = weight.rotation {
                    units.push(rotation_code(rotation.x) | rotation_code(rotation.y) << 8);
                    rotated += 1;
                }
            }
        }
        check_most("rotated weights of a row", u64::from(rotated), (1 << ROTATED_BITS) - 1)?;
        Ok(Self { units, rotated })
    }
}

fn rotation_code(rotation: f32) -> u16 {
    let steps = scene::math::floor(rotation * ROTATION_STEPS as f32 + 0.5).clamp(-127.0, 127.0);
    (steps as i32 + ROTATION_BIAS as i32) as u16
}

/// Weights in whole steps whose sum is that of the weights, rounded: the weights that are furthest below are rounded
/// up. Those of no step are left out.
fn rounded(row: Vec<Weight>) -> Vec<(Weight, i32)> {
    let exact = |weight: &Weight| weight.weight * WEIGHT_STEPS as f32;
    let total = scene::math::floor(row.iter().map(exact).sum::<f32>() + 0.5) as i32;
    let mut rounded: Vec<(Weight, i32)> =
        row.into_iter().map(|weight| (weight, scene::math::floor(exact(&weight)) as i32)).collect();
    let missing = total - rounded.iter().map(|entry| entry.1).sum::<i32>();
    let mut order: Vec<usize> = (0..rounded.len()).collect();
    let left = |k: usize| exact(&rounded[k].0) - rounded[k].1 as f32;
    order.sort_by(|&a, &b| left(b).total_cmp(&left(a)).then(a.cmp(&b)));
    order.into_iter().take(missing.max(0) as usize).for_each(|k| rounded[k].1 += 1);
    rounded.retain(|entry| entry.1 != 0);
    rounded
}

fn is_in_range(weight: &Weight) -> bool {
    (weight.weight * WEIGHT_STEPS as f32).abs() < WEIGHT_BIAS as f32 - 1.0
}

fn check_most(name: &'static str, found: u64, limit: u64) -> Result<(), Error> {
    if found > limit { Err(transport::Error::TooMany { name, found, limit }.into()) } else { Ok(()) }
}
