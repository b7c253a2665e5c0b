//! Rows of a rectangular operator as counts of hits: storage, and the product on all cores.

use alloc::vec::Vec;

use glam::{UVec2, Vec4};
use scene::parallel::*;

use super::storage::Csr;
use crate::error::{Error, check_length, check_offsets};
use crate::kernel::hits::{COUNT_STEP, MAX_HIT_COLUMNS, QUAD_COLUMNS, WORD_COUNTS};
use crate::operator::LinearOperator;

/// As a size of arrays.
const MAX_COLUMNS: usize = MAX_HIT_COLUMNS as usize;
/// Columns of a quad.
const FOUR: usize = QUAD_COLUMNS as usize;
/// Steps of a hit: [`COUNT_STEP`] is one over it.
const STEPS: usize = FOUR;
/// Greatest count of four columns that differ: four times this fits a byte.
const MAX_COUNT: usize = u8::MAX as usize / STEPS;
/// Rows one task works through.
const TASK_ROWS: usize = 128;

/// A rectangular operator whose rows come from rays: `F_ij = s_i c_ij`, c the number of row i's rays that hit column j,
/// s a scale of the row. About 2.4 bytes an entry that is not zero: columns are 16-bit numbers (so at most 65,536), in
/// quads of four with like counts, and a quad has one byte. The product adds up exitance and multiplies once a quad.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct HitCounts {
    columns: usize,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    row_start: Vec<u32>,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    quads: Vec<UVec2>,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    counts: Vec<u8>,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    scales: Vec<f32>,
}

impl HitCounts {
    /// An operator without rows yet.
    ///
    /// # Errors
    /// [`Error::TooMany`] above 65,536 columns.
    pub fn new(columns: usize) -> Result<Self, Error> {
        if columns > MAX_COLUMNS {
            return Err(Error::TooMany { name: "columns", found: columns as u64, limit: MAX_COLUMNS as u64 });
        }
        Ok(Self { columns, row_start: vec![0], ..Self::default() })
    }

    /// Adds rows, coded on all cores: row k of the block was hit by `hits[k · rays..(k + 1) · rays]`, in any order;
    /// what is no column (the sky, hits without owner) is left out. `scales[k]` is the factor of one of its hits,
    /// usually one over the number of its rays. Rows may come in blocks, so that all hits are never together in memory.
    ///
    /// # Errors
    /// [`Error::Length`] unless `hits` holds the same number of rays for every row; [`Error::Value`] for a scale that
    /// is not finite; [`Error::TooMany`] beyond 2³² − 1 quads. Nothing is added then.
    pub fn push(&mut self, hits: &[u32], scales: &[f32]) -> Result<(), Error> {
        let rows = scales.len();
        let rays = hits.len().checked_div(rows).unwrap_or(0);
        check_length("hits", rows * rays, hits.len())?;
        if let Some(index) = scales.iter().position(|s| !s.is_finite()) {
            return Err(Error::Value { name: "scales", index, value: f64::from(scales[index]), rule: "finite" });
        }
        let row = |k: usize| Row::new(&hits[k * rays..(k + 1) * rays], self.columns);
        self.add((0..rows).into_par_iter().map(row).collect(), scales)
    }

    /// Adds all rows of another operator over the same columns.
    ///
    /// # Errors
    /// [`Error::Length`] of other columns; [`Error::TooMany`] beyond 2³² − 1 quads.
    pub fn append(&mut self, other: Self) -> Result<(), Error> {
        check_length("columns", self.columns, other.columns)?;
        let first = self.quads.len();
        let found = (first + other.quads.len()) as u64;
        if found > u64::from(u32::MAX) {
            return Err(Error::TooMany { name: "quads", found, limit: u64::from(u32::MAX) });
        }
        self.row_start.extend(other.row_start.iter().skip(1).map(|&end| first as u32 + end));
        self.quads.extend(other.quads);
        self.counts.extend(other.counts);
        self.scales.extend(other.scales);
        Ok(())
    }

    /// Adds rows that follow from those of another operator, coded on all cores. Column c of that is `columns[c]` here.
    ///
    /// # Errors
    /// [`Error::Length`] unless there is one scale a row and one column for each of the other operator;
    /// [`Error::Value`] for a row that is not there or hits a column that has none here; [`Error::TooMany`] beyond
    /// 2³² − 1 quads.
    pub fn push_edited(
        &mut self,
        before: &Self,
        columns: &[u32],
        rows: &[EditedRow],
        scales: &[f32],
    ) -> Result<(), Error> {
        check_length("scales", rows.len(), scales.len())?;
        check_length("columns", before.columns, columns.len())?;
        let row = |row: &EditedRow| match row {
            EditedRow::Same(row) => before.mapped(*row, columns, self.columns),
            EditedRow::Counts(own) => {
                let mut known: Vec<(u32, u32)> =
                    own.iter().copied().filter(|c| (c.0 as usize) < self.columns).collect();
                known.sort_unstable();
                Ok(Row::of_counts(&known))
            }
        };
        self.add(rows.par_iter().map(row).collect::<Result<_, _>>()?, scales)
    }

    /// A row with other columns.
    fn mapped(&self, row: usize, columns: &[u32], count: usize) -> Result<Row, Error> {
        let wrong = |rule| Error::Value { name: "rows", index: row, value: row as f64, rule };
        let (Some(&first), Some(&end)) = (self.row_start.get(row), self.row_start.get(row + 1)) else {
            return Err(wrong("a row of the operator"));
        };
        let own = first as usize..end as usize;
        let mut mapped = Row { quads: Vec::with_capacity(own.len()), counts: self.counts[own.clone()].to_vec() };
        for quad in &self.quads[own] {
            let four = quad_columns(*quad).map(|c| columns[c as usize]);
            if four.iter().any(|&column| column as usize >= count) {
                return Err(wrong("one whose columns are all still there"));
            }
            mapped.quads.push(quad_of(four));
        }
        Ok(mapped)
    }

    /// Copy over more columns, with one empty quad more at the end of each row that `has_room`.
    ///
    /// # Errors
    /// [`Error::TooMany`] columns or quads.
    pub fn with_room(&self, columns: usize, has_room: impl Fn(usize) -> bool) -> Result<Self, Error> {
        let mut copy = Self::new(columns.max(self.columns))?;
        copy.quads.reserve(self.quads.len());
        copy.counts.reserve(self.counts.len());
        copy.row_start.reserve(self.scales.len());
        for row in 0..self.scales.len() {
            let own = self.row_start[row] as usize..self.row_start[row + 1] as usize;
            copy.quads.extend_from_slice(&self.quads[own.clone()]);
            copy.counts.extend_from_slice(&self.counts[own]);
            if has_room(row) {
                copy.quads.push(UVec2::ZERO);
                copy.counts.push(0);
            }
            let found = copy.quads.len() as u64;
            if found > u64::from(u32::MAX) {
                return Err(Error::TooMany { name: "quads", found, limit: u64::from(u32::MAX) });
            }
            copy.row_start.push(found as u32);
        }
        copy.scales.clone_from(&self.scales);
        Ok(copy)
    }

    /// Adds rows that are coded.
    fn add(&mut self, coded: Vec<Row>, scales: &[f32]) -> Result<(), Error> {
        let found = (self.quads.len() + coded.iter().map(|row| row.quads.len()).sum::<usize>()) as u64;
        if found > u64::from(u32::MAX) {
            return Err(Error::TooMany { name: "quads", found, limit: u64::from(u32::MAX) });
        }
        for row in coded {
            self.quads.extend(row.quads);
            self.counts.extend(row.counts);
            self.row_start.push(self.quads.len() as u32);
        }
        self.scales.extend(scales);
        Ok(())
    }

    /// Checks the tables, where they come from a file.
    ///
    /// # Errors
    /// [`Error::Length`] or [`Error::Value`] naming the first entry that is wrong.
    pub fn check(&self) -> Result<(), Error> {
        check_offsets("row_start", self.scales.len(), self.quads.len(), &self.row_start)?;
        check_length("counts", self.quads.len(), self.counts.len())?;
        match self.quads.iter().position(|quad| quad_columns(*quad).iter().any(|&c| c as usize >= self.columns)) {
            Some(index) => {
                let value = quad_columns(self.quads[index]).into_iter().max().map_or(0.0, f64::from);
                Err(Error::Value { name: "quads", index, value, rule: "below the number of columns" })
            }
            None => Ok(()),
        }
    }

    /// Row i owns the quads `row_start[i]..row_start[i + 1]`; `[rows + 1]`.
    pub fn row_start(&self) -> &[u32] {
        &self.row_start
    }

    /// The columns of each quad, 16 bits each, the first in the lowest bits.
    pub fn quads(&self) -> &[UVec2] {
        &self.quads
    }

    /// Hits of each quad's columns, in steps of [`COUNT_STEP`], one byte a quad.
    pub fn counts(&self) -> &[u8] {
        &self.counts
    }

    /// The counts as the kernel takes them: four a word, the first in the lowest bits.
    pub fn count_words(&self) -> Vec<u32> {
        let word = |four: &[u8]| four.iter().rev().fold(0, |word, &count| word << 8 | u32::from(count));
        self.counts.chunks(WORD_COUNTS as usize).map(word).collect()
    }

    /// Factor of one hit, `[rows]`.
    pub fn scales(&self) -> &[f32] {
        &self.scales
    }

    /// The columns that row `i` hits, ascending, and how many of its rays hit each; nothing for a row that is not
    /// there.
    pub fn row(&self, i: usize) -> Vec<(u32, u32)> {
        let (Some(&first), Some(&end)) = (self.row_start.get(i), self.row_start.get(i + 1)) else { return Vec::new() };
        let mut steps: Vec<(u32, u32)> = Vec::new();
        for quad in first as usize..end as usize {
            let count = u32::from(self.counts[quad]);
            steps.extend(quad_columns(self.quads[quad]).map(|column| (column, count)));
        }
        steps.sort_unstable();
        steps
            .chunk_by(|a, b| a.0 == b.0)
            .map(|same| (same[0].0, same.iter().map(|s| s.1).sum::<u32>() / STEPS as u32))
            .collect()
    }

    /// Sparse rows of means, with columns taken together: row g is `Σ_k weights[k] row_k` over the rows
    /// `groups[g]..groups[g + 1]`, and its column j the sum of all columns c with `owner[c] = j`, of `columns`.
    ///
    /// # Errors
    /// [`Error::Length`] unless there is one weight a row and one owner a column, and the groups end with the rows;
    /// [`Error::Value`] for an owner that is not there; [`Error::TooMany`] entries.
    pub fn means(&self, groups: &[u32], weights: &[f32], owner: &[u32], columns: usize) -> Result<Csr, Error> {
        check_length("weights", self.scales.len(), weights.len())?;
        check_length("groups", self.scales.len(), groups.last().map_or(0, |&end| end as usize))?;
        check_length("owner", self.columns, owner.len())?;
        let row = |range: &[u32]| {
            let first = range[0] as usize;
            let end = range[1] as usize;
            let mut sums: Vec<(u32, f32)> = Vec::new();
            for (k, weight) in (first..end).zip(&weights[first..end]) {
                let share = weight * self.scales[k];
                sums.extend(
                    self.row(k).into_iter().map(|(column, count)| (owner[column as usize], share * count as f32)),
                );
            }
            add_up(&mut sums);
            // All rows are in memory together, with what they have room for.
            sums.shrink_to_fit();
            sums
        };
        let rows: Vec<Vec<(u32, f32)>> = groups.par_windows(2).map(row).collect();
        Csr::from_rows(columns, &rows)
    }

    /// The operator as compressed sparse rows.
    ///
    /// # Errors
    /// [`Error::TooMany`] when there are more than 2³² − 1 entries.
    pub fn to_csr(&self) -> Result<Csr, Error> {
        let rows = self.scales.len();
        let mut csr = Csr { rows, columns: self.columns, row_start: vec![0], ..Csr::default() };
        for (i, scale) in self.scales.iter().enumerate() {
            for (column, count) in self.row(i) {
                csr.column_index.push(column);
                csr.values.push(count as f32 * scale);
            }
            let found = csr.values.len() as u64;
            if found > u64::from(u32::MAX) {
                return Err(Error::TooMany { name: "entries of sparse rows", found, limit: u64::from(u32::MAX) });
            }
            csr.row_start.push(found as u32);
        }
        Ok(csr)
    }
}

/// The columns of a quad.
pub fn quad_columns(quad: UVec2) -> [u32; FOUR] {
    [quad.x & 0xffff, quad.x >> 16, quad.y & 0xffff, quad.y >> 16]
}

/// A quad of four columns below 65,536.
pub fn quad_of(columns: [u32; FOUR]) -> UVec2 {
    UVec2::new(columns[0] | columns[1] << 16, columns[2] | columns[3] << 16)
}

/// Adds up the entries of each column of a row, in their order.
pub fn add_up(entries: &mut Vec<(u32, f32)>) {
    // Stable.
    entries.sort_by_key(|entry| entry.0);
    entries.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
}

/// A row that follows from those of another operator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EditedRow {
    /// The row with this number, which hits no column that is gone.
    Same(usize),
    /// Columns, none twice, and how many rays hit each.
    Counts(Vec<(u32, u32)>),
}

/// The quads of one row.
#[derive(Default)]
struct Row {
    quads: Vec<UVec2>,
    counts: Vec<u8>,
}

impl Row {
    fn new(hits: &[u32], columns: usize) -> Self {
        let mut known: Vec<u32> = hits.iter().copied().filter(|&column| (column as usize) < columns).collect();
        known.sort_unstable();
        let counts = known.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as u32));
        Self::of_counts(&counts.collect::<Vec<_>>())
    }

    /// Counts of columns, ascending.
    fn of_counts(counts: &[(u32, u32)]) -> Self {
        // Columns by what is left of their counts.
        let mut left: [Vec<u32>; MAX_COUNT + 1] = [const { Vec::new() }; MAX_COUNT + 1];
        for &(column, count) in counts {
            let mut rest = count as usize;
            while rest > 0 {
                let part = rest.min(MAX_COUNT);
                left[part].push(column);
                rest -= part;
            }
        }
        let mut row = Self::default();
        for count in (1..=MAX_COUNT).rev() {
            let class = core::mem::take(&mut left[count]);
            let groups = class.chunks_exact(FOUR);
            let rest = groups.remainder();
            for group in groups {
                row.add([group[0], group[1], group[2], group[3]], count * STEPS);
            }
            // Up to three columns without company join those of the next lower count, and come again with the
            // difference; where none is near, they fill quads by standing in them repeatedly.
            let lower = (count.div_ceil(2)..count).rev().find(|&lower| !left[lower].is_empty());
            match (lower, rest) {
                (Some(lower), _) => {
                    left[lower].extend(rest);
                    left[count - lower].extend(rest);
                }
                (None, &[a]) => row.add([a; FOUR], count),
                (None, &[a, b]) => row.add([a, b, a, b], 2 * count),
                (None, &[a, b, c]) => {
                    row.add([a, b, a, b], 2 * count);
                    row.add([c; FOUR], count);
                }
                _ => {}
            }
        }
        row
    }

    fn add(&mut self, columns: [u32; FOUR], steps: usize) {
        self.quads.push(UVec2::new(columns[0] | columns[1] << 16, columns[2] | columns[3] << 16));
        self.counts.push(steps as u8);
    }
}

impl LinearOperator for HitCounts {
    fn shape(&self) -> (usize, usize) {
        (self.scales.len(), self.columns)
    }

    fn bytes(&self) -> u64 {
        let bytes = size_of_val(&self.row_start[..])
            + size_of_val(&self.quads[..])
            + size_of_val(&self.counts[..])
            + size_of_val(&self.scales[..]);
        bytes as u64
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        self.check_vectors(exitance, irradiance)?;
        // An entry for every number of 16 bits: nothing is left to check in the inner loop.
        let mut table = vec![Vec4::ZERO; MAX_COLUMNS];
        table[..exitance.len()].copy_from_slice(exitance);
        let table: &Table = table.first_chunk().ok_or(Error::Length {
            name: "exitance",
            expected: MAX_COLUMNS,
            found: exitance.len(),
        })?;
        irradiance.par_chunks_mut(TASK_ROWS).enumerate().for_each(|(task, out)| {
            for (k, out) in out.iter_mut().enumerate() {
                let i = task * TASK_ROWS + k;
                let own = self.row_start[i] as usize..self.row_start[i + 1] as usize;
                let sum = row_sum(&self.quads[own.clone()], &self.counts[own], table);
                *out = (sum * (COUNT_STEP * self.scales[i])).truncate().extend(0.0);
            }
        });
        Ok(())
    }
}

/// Exitance by column.
type Table = [Vec4; MAX_COLUMNS];

/// `Σ_q c_q (B_q0 + B_q1 + B_q2 + B_q3)`. Two sums: an addition to one takes as long as a quad.
#[inline]
fn row_sum(quads: &[UVec2], counts: &[u8], exitance: &Table) -> Vec4 {
    let b = |column: u32| exitance[column as usize];
    let light = |quad: UVec2| (b(quad.x & 0xffff) + b(quad.x >> 16)) + (b(quad.y & 0xffff) + b(quad.y >> 16));
    let mut even = Vec4::ZERO;
    let mut odd = Vec4::ZERO;
    let quads = quads.chunks_exact(2);
    let counts = counts.chunks_exact(2);
    let last = quads.remainder().iter().zip(counts.remainder());
    for (quads, counts) in quads.zip(counts) {
        even += light(quads[0]) * f32::from(counts[0]);
        odd += light(quads[1]) * f32::from(counts[1]);
    }
    last.for_each(|(quad, count)| even += light(*quad) * f32::from(*count));
    even + odd
}
