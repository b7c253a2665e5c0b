//! Matrices in memory: dense, half precision, compressed sparse rows.

use alloc::vec::Vec;
use half::f16;
use half::slice::HalfFloatSliceExt;
use scene::parallel::*;

use crate::error::{Error, check_length, check_offsets};
use crate::kernel::product::packed_row_words;

/// A dense matrix, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Dense {
    /// Rows, one a receiver.
    pub rows: usize,
    /// Columns, one a patch that sends.
    pub columns: usize,
    /// `[rows · columns]`.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub values: Vec<f32>,
}

/// A dense matrix of half-precision numbers, two a word as the GPU takes them: the lower half is the even column; rows
/// of odd length end with an unused upper half of 0.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Half {
    /// Rows, one a receiver.
    pub rows: usize,
    /// Columns, one a patch that sends.
    pub columns: usize,
    /// `[rows · columns.div_ceil(2)]`.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub words: Vec<u32>,
}

/// Compressed sparse rows.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Csr {
    /// Rows, one a receiver.
    pub rows: usize,
    /// Columns, one a patch that sends.
    pub columns: usize,
    /// Row i owns the entries `row_start[i]..row_start[i + 1]`; `[rows + 1]`.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub row_start: Vec<u32>,
    /// Column of each entry, ascending within a row.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub column_index: Vec<u32>,
    /// Value of each entry.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub values: Vec<f32>,
}

impl Dense {
    /// A matrix of zeros.
    pub fn zeros(rows: usize, columns: usize) -> Self {
        Self { rows, columns, values: vec![0.0; rows * columns] }
    }

    /// A matrix over given values.
    ///
    /// # Errors
    /// [`Error::Length`] unless there are `rows · columns`.
    pub fn new(rows: usize, columns: usize, values: Vec<f32>) -> Result<Self, Error> {
        check_length("values", rows * columns, values.len())?;
        Ok(Self { rows, columns, values })
    }

    /// Row `i`.
    pub fn row(&self, i: usize) -> &[f32] {
        &self.values[i * self.columns..(i + 1) * self.columns]
    }

    /// Row `i`, to be changed.
    pub fn row_mut(&mut self, i: usize) -> &mut [f32] {
        &mut self.values[i * self.columns..(i + 1) * self.columns]
    }

    /// Rounded to half precision.
    pub fn to_half(&self) -> Half {
        let width = packed_row_words(self.columns as u32) as usize;
        let mut words = vec![0u32; self.rows * width];
        if self.columns > 0 {
            words.par_chunks_mut(width).zip(self.values.par_chunks(self.columns)).for_each(|(words, row)| {
                let half_words: &mut [f16] = bytemuck::cast_slice_mut(words);
                half_words[..row.len()].convert_from_f32_slice(row);
                for word in words {
                    *word = u32::from_le(*word);
                }
            });
        }
        Half { rows: self.rows, columns: self.columns, words }
    }

    /// Without the entries of magnitude ≤ `threshold`.
    ///
    /// # Errors
    /// [`Error::TooMany`] when more than 2³² − 1 entries remain.
    pub fn to_csr(&self, threshold: f32) -> Result<Csr, Error> {
        let mut csr = Csr { rows: self.rows, columns: self.columns, row_start: vec![0], ..Csr::default() };
        for i in 0..self.rows {
            for (j, &value) in self.row(i).iter().enumerate() {
                if value.abs() > threshold {
                    csr.column_index.push(j as u32);
                    csr.values.push(value);
                }
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

impl Half {
    /// Widened to single precision.
    pub fn to_dense(&self) -> Dense {
        let mut dense = Dense::zeros(self.rows, self.columns);
        let width = packed_row_words(self.columns as u32) as usize;
        for i in 0..self.rows {
            for (j, value) in dense.row_mut(i).iter_mut().enumerate() {
                *value = f16::from_bits((self.words[i * width + j / 2] >> (16 * (j % 2))) as u16).to_f32();
            }
        }
        dense
    }
}

impl Csr {
    /// Checks the tables.
    ///
    /// # Errors
    /// [`Error::Length`] or [`Error::Value`] naming the first entry that is wrong.
    pub fn check(&self) -> Result<(), Error> {
        check_offsets("row_start", self.rows, self.column_index.len(), &self.row_start)?;
        check_length("values", self.column_index.len(), self.values.len())?;
        match self.column_index.iter().position(|&j| j as usize >= self.columns) {
            Some(index) => {
                let value = f64::from(self.column_index[index]);
                Err(Error::Value { name: "column_index", index, value, rule: "below the number of columns" })
            }
            None => Ok(()),
        }
    }

    /// Columns and values of row `i`.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (usize, f32)> {
        let own = self.row_start[i] as usize..self.row_start[i + 1] as usize;
        let columns = self.column_index[own.clone()].iter().map(|&j| j as usize);
        columns.zip(self.values[own].iter().copied())
    }

    /// From rows of columns and values.
    ///
    /// # Errors
    /// As [`Csr::push_rows`].
    pub fn from_rows(columns: usize, rows: &[Vec<(u32, f32)>]) -> Result<Self, Error> {
        let mut csr = Self { columns, row_start: vec![0], ..Self::default() };
        csr.push_rows(rows)?;
        Ok(csr)
    }

    /// Adds rows of columns and values: those of a large operator may come in blocks.
    ///
    /// # Errors
    /// [`Error::TooMany`] when there are more than 2³² − 1 entries, [`Error::Value`] for a column that is not there.
    /// Nothing is added then.
    pub fn push_rows(&mut self, rows: &[Vec<(u32, f32)>]) -> Result<(), Error> {
        let found: u64 = self.values.len() as u64 + rows.iter().map(|row| row.len() as u64).sum::<u64>();
        if found > u64::from(u32::MAX) {
            return Err(Error::TooMany { name: "entries of sparse rows", found, limit: u64::from(u32::MAX) });
        }
        let wrong = |(k, entry): (usize, &(u32, f32))| {
            (entry.0 as usize >= self.columns).then_some((self.values.len() + k, entry.0))
        };
        if let Some((index, column)) = rows.iter().flatten().enumerate().find_map(wrong) {
            let value = f64::from(column);
            return Err(Error::Value { name: "column_index", index, value, rule: "below the number of columns" });
        }
        if self.row_start.is_empty() {
            self.row_start.push(0);
        }
        for row in rows {
            self.column_index.extend(row.iter().map(|entry| entry.0));
            self.values.extend(row.iter().map(|entry| entry.1));
            self.row_start.push(self.values.len() as u32);
        }
        self.rows += rows.len();
        Ok(())
    }

    /// With all its zeros.
    pub fn to_dense(&self) -> Dense {
        let mut dense = Dense::zeros(self.rows, self.columns);
        for i in 0..self.rows {
            for k in self.row_start[i] as usize..self.row_start[i + 1] as usize {
                dense.values[i * self.columns + self.column_index[k] as usize] += self.values[k];
            }
        }
        dense
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conversions_return_what_went_in() {
        let mut dense = Dense::zeros(3, 5);
        for (k, value) in dense.values.iter_mut().enumerate() {
            *value = if k % 3 == 0 { 0.0 } else { k as f32 / 16.0 };
        }
        assert_eq!(dense.to_half().to_dense(), dense);
        let csr = dense.to_csr(0.0).unwrap();
        csr.check().unwrap();
        assert_eq!(csr.to_dense(), dense);
        assert_eq!(dense.to_half().words[0], u32::from(f16::from_f32(1.0 / 16.0).to_bits()) << 16);
        let mut bad = csr.clone();
        bad.column_index[1] = 5;
        assert!(matches!(bad.check(), Err(Error::Value { name: "column_index", index: 1, .. })));
    }
}
