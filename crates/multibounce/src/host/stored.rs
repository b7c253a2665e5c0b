//! Operators that do not fit into memory: kept in a file, tile by tile in their order.

mod build;
mod panel;

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::string::ToString;
use std::sync::{Mutex, PoisonError};
use std::vec::Vec;

use faer::Mat;
use transport::check_length;

use super::low_rank::SIDE;
use crate::error::Error;

pub use build::{all_bounces_stored, some_bounces_stored};

/// Workspace for an operator that does not fit into memory: its folder, and the memory to use.
#[derive(Clone, Copy, Debug)]
pub struct Workspace<'a> {
    /// Folder of its file, which has no name there and goes with the process, however that ends.
    pub folder: &'a Path,
    /// Most bytes of the matrices that are held at a time.
    pub bytes: u64,
}

/// Blocks of numbers in a file without a name.
#[derive(Debug)]
struct BlockFile {
    file: File,
    folder: PathBuf,
    /// Numbers of a block.
    block: usize,
    /// Bytes of all blocks.
    bytes: u64,
}

impl BlockFile {
    fn new(folder: &Path, block: usize, count: usize) -> Result<Self, Error> {
        let bytes = (count * block * size_of::<f32>()) as u64;
        let file = tempfile::tempfile_in(folder).map_err(|error| failed(folder, "make", bytes, &error))?;
        Ok(Self { file, folder: folder.to_path_buf(), block, bytes })
    }

    fn seek(&self, index: usize) -> std::io::Result<&File> {
        let mut file = &self.file;
        file.seek(SeekFrom::Start((index * self.block * size_of::<f32>()) as u64))?;
        Ok(file)
    }

    fn read(&self, index: usize, numbers: &mut [f32]) -> Result<(), Error> {
        self.seek(index)
            .and_then(|mut file| file.read_exact(bytemuck::cast_slice_mut(numbers)))
            .map_err(|error| failed(&self.folder, "read", self.bytes, &error))
    }

    fn write(&self, index: usize, numbers: &[f32]) -> Result<(), Error> {
        self.seek(index)
            .and_then(|mut file| file.write_all(bytemuck::cast_slice(numbers)))
            .map_err(|error| failed(&self.folder, "write", self.bytes, &error))
    }
}

fn failed(folder: &Path, action: &'static str, bytes: u64, error: &std::io::Error) -> Error {
    Error::File { folder: folder.to_path_buf(), action, megabytes: bytes.div_ceil(1 << 20), reason: error.to_string() }
}

/// A symmetric operator of one channel in a file: the tiles of its upper triangle, in the order of [`crate::LowRank`],
/// 2 n² bytes.
#[derive(Debug)]
pub struct StoredOperator {
    file: Mutex<BlockFile>,
    order: Vec<u32>,
    permuted_index: Vec<u32>,
    /// Most bytes that its building held at a time, beside the sparse form factors.
    pub held_bytes: u64,
}

/// Index of a tile of the upper triangle.
fn tile_index((i, j): (usize, usize)) -> usize {
    j * (j + 1) / 2 + i
}

impl StoredOperator {
    fn new(folder: &Path, order: &[u32], permuted_index: Vec<u32>) -> Result<Self, Error> {
        let blocks = order.len().div_ceil(SIDE);
        let file = BlockFile::new(folder, SIDE * SIDE, blocks * (blocks + 1) / 2)?;
        Ok(Self { file: Mutex::new(file), order: order.to_vec(), permuted_index, held_bytes: 0 })
    }

    /// Number of patches.
    pub fn patches(&self) -> usize {
        self.order.len()
    }

    /// The patch at each permuted index.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// A tile of the upper triangle, filled up with zeros.
    pub(super) fn tile(&self, at: (usize, usize)) -> Result<Mat<f32>, Error> {
        let mut numbers = vec![0.0; SIDE * SIDE];
        self.file.lock().unwrap_or_else(PoisonError::into_inner).read(tile_index(at), &mut numbers)?;
        Ok(Mat::from_fn(SIDE, SIDE, |r, c| numbers[c * SIDE + r]))
    }

    /// Writes the tiles of some columns of tiles, from `first` on; `columns` has so many rows a column, of which those
    /// behind the last patch are not looked at.
    fn write(&self, first: usize, columns: &[f32], rows: usize) -> Result<(), Error> {
        let n = self.order.len();
        let file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let mut numbers = vec![0.0; SIDE * SIDE];
        for (j, columns) in (first..n.div_ceil(SIDE)).zip(columns.chunks(SIDE * rows)) {
            for i in 0..=j {
                let height = SIDE.min(n - i * SIDE);
                numbers.fill(0.0);
                let width = SIDE.min(n - j * SIDE);
                for (column, to) in columns.chunks(rows).take(width).zip(numbers.chunks_mut(SIDE)) {
                    to[..height].copy_from_slice(&column[i * SIDE..i * SIDE + height]);
                }
                file.write(tile_index((i, j)), &numbers)?;
            }
        }
        Ok(())
    }

    /// `y = T̂ x`, by patches.
    ///
    /// # Errors
    /// [`transport::Error::Length`], [`Error::File`].
    pub fn product(&self, x: &[f32], y: &mut [f32]) -> Result<(), Error> {
        check_length("x", self.order.len(), x.len())?;
        check_length("y", self.order.len(), y.len())?;
        y.fill(0.0);
        for (j, columns) in self.order.chunks(SIDE).enumerate() {
            for (i, rows) in self.order.chunks(SIDE).take(j + 1).enumerate() {
                let tile = self.tile((i, j))?;
                for (c, &column) in columns.iter().enumerate() {
                    for (r, &row) in rows.iter().enumerate() {
                        y[row as usize] += tile[(r, c)] * x[column as usize];
                        if i != j {
                            y[column as usize] += tile[(r, c)] * x[row as usize];
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// Row of patch `i`, by patches.
    ///
    /// # Errors
    /// [`transport::Error::Length`] for a row of another length, [`transport::Error::Value`] for a patch that is not
    /// there, [`Error::File`].
    pub fn row(&self, i: usize, row: &mut [f32]) -> Result<(), Error> {
        check_length("row", self.order.len(), row.len())?;
        let Some(permuted_index) = self.permuted_index.get(i).map(|&permuted_index| permuted_index as usize) else {
            return Err(transport::Error::Value { name: "patch", index: i, value: i as f64, rule: "a patch" }.into());
        };
        let block = permuted_index / SIDE;
        let at = permuted_index % SIDE;
        for (other, patches) in self.order.chunks(SIDE).enumerate() {
            let tile = self.tile((block.min(other), block.max(other)))?;
            for (k, &patch) in patches.iter().enumerate() {
                row[patch as usize] = if other < block { tile[(k, at)] } else { tile[(at, k)] };
            }
        }
        Ok(())
    }
}
