//! Operators from few patches to many receivers, block of rows by block of rows.

use core::sync::atomic::{AtomicUsize, Ordering};

use alloc::vec::Vec;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;

use faer::Mat;
use scene::parallel::*;
use scene::sampling::hash3;

use super::TileSide;
use super::encode::{Encoded, Encoder, Progress, Rows, sqrt_areas_of};
use super::reduce::{Costs, Part, SIDE, Weights, reduce, squared_norm};
use crate::error::Error;
use crate::kernel::low_rank::ALL_CHANNELS;

/// Blocks of rows from which on λ is first looked for with a part of them, and that part.
const MANY_BLOCKS: usize = 64;
const PART: u32 = 16;
/// The rows of a rectangular operator: calls the function with each column of this row, and its value. A column may
/// come more than once.
pub type SparseRows<'a> = dyn Fn(usize, &mut dyn FnMut(u32, f32)) + Sync + 'a;

/// The operator block by block.
pub(super) struct Source<'a> {
    rows: &'a SparseRows<'a>,
    receivers: TileSide<'a>,
    /// `√a` of the receivers, `1 / √a` of the patches.
    sqrt_areas: [Vec<f32>; 2],
    /// Permuted index of each patch.
    permuted_index: &'a [u32],
    even: Weights,
    /// Light of each block of patches.
    light: Vec<Weights>,
    /// Blocks of rows, and those by which λ is first looked for.
    all: Vec<usize>,
    some: Vec<usize>,
}

/// Entries of a tile: row, column, value.
type Entries = Vec<(u8, u8, f32)>;

/// Encoding of a block of rows: blocks of columns with their encodings.
struct BlockRow {
    parts: Vec<(usize, Part)>,
    /// Squared norm.
    norm: f64,
}

impl Source<'_> {
    /// The entries of a block of rows, tile by tile: row and column in the tile, value.
    fn entries(&self, block: usize) -> Result<Vec<Entries>, Error> {
        let mut tiles = vec![Vec::new(); self.light.len()];
        let mut wrong = None;
        for (r, &i) in self.receivers.order.iter().skip(block * SIDE).take(SIDE).enumerate() {
            let sqrt_area = self.sqrt_areas[0][i as usize];
            (self.rows)(i as usize, &mut |column, value| match self.permuted_index.get(column as usize) {
                Some(&permuted_index) if value.is_finite() => {
                    let value = value * (sqrt_area * self.sqrt_areas[1][column as usize]);
                    tiles[permuted_index as usize / SIDE].push((
                        r as u8,
                        (permuted_index as usize % SIDE) as u8,
                        value,
                    ));
                }
                Some(_) => wrong = Some(("values", i, f64::from(value), "finite")),
                None => wrong = Some(("columns", i, f64::from(column), "a patch")),
            });
        }
        match wrong {
            Some((name, index, value, rule)) => {
                Err(transport::Error::Value { name, index: index as usize, value, rule }.into())
            }
            None => Ok(tiles),
        }
    }

    fn encode_block(&self, block: usize, costs: &Costs) -> Result<BlockRow, Error> {
        let mut parts = Vec::new();
        let mut whole = 0.0;
        for (j, entries) in self.entries(block)?.into_iter().enumerate() {
            if !entries.is_empty() {
                let mut tile = dense(&entries);
                whole += squared_norm(&tile);
                let mut part = Part::default();
                reduce(&mut tile, (&self.even, &self.light[j]), costs, ALL_CHANNELS, &mut part);
                parts.push((j, Part { error: [squared_norm(&tile); 3], ..part }));
            }
        }
        Ok(BlockRow { parts, norm: whole })
    }

    /// Squared norm of some blocks of rows.
    fn norm(&self, blocks: &[usize]) -> Result<f64, Error> {
        let of =
            |&block: &usize| Ok(self.entries(block)?.iter().map(|entries| squared_norm(&dense(entries))).sum::<f64>());
        Ok(blocks.par_iter().map(of).collect::<Result<Vec<f64>, Error>>()?.iter().sum())
    }

    fn encode_all(&self, blocks: &[usize], lambda: f32, progress: &Progress) -> Result<Vec<BlockRow>, Error> {
        let costs = Costs { lambda, ..Costs::RECTANGULAR };
        let done = AtomicUsize::new(0);
        let total = blocks.len();
        let cancelled = |done: usize| Err(transport::Error::Cancelled { done, total }.into());
        let work = |&block: &usize| {
            let row = self.encode_block(block, &costs)?;
            let count = done.fetch_add(1, Ordering::Relaxed) + 1;
            if progress(count, total).is_break() { cancelled(count) } else { Ok(row) }
        };
        blocks.par_iter().with_max_len(1).map(work).collect()
    }
}

/// A tile from its entries.
fn dense(entries: &[(u8, u8, f32)]) -> Mat<f32> {
    let mut tile = Mat::zeros(SIDE, SIDE);
    entries.iter().for_each(|&(r, c, value)| tile[(r as usize, c as usize)] += value);
    tile
}

/// Relative error of some blocks of rows.
fn relative_error(rows: &[BlockRow]) -> f64 {
    let norm: f64 = rows.iter().map(|row| row.norm).sum();
    let error: f64 = rows.iter().flat_map(|row| &row.parts).map(|part| part.1.error[0]).sum();
    if norm > 0.0 { (error / norm).sqrt() } else { 0.0 }
}

impl<'a> Source<'a> {
    pub fn new(
        rows: &'a SparseRows<'a>,
        receivers: TileSide<'a>,
        patches: TileSide<'a>,
        permuted_index: &'a [u32],
    ) -> Self {
        let sqrt_areas = [sqrt_areas_of(receivers), sqrt_areas_of(patches)];
        let light =
            |block: &[u32]| Weights::of_light(&block.iter().map(|&j| sqrt_areas[1][j as usize]).collect::<Vec<f32>>());
        let light: Vec<Weights> = patches.order.chunks(SIDE).map(light).collect();
        let [row_sqrt_area, column_sqrt_area] = sqrt_areas;
        let sqrt_areas = [row_sqrt_area, column_sqrt_area.iter().map(|r| 1.0 / r).collect()];
        let all: Vec<usize> = (0..receivers.order.len().div_ceil(SIDE)).collect();
        let is_some = |b: &usize| all.len() < MANY_BLOCKS || hash3(*b as u32, 0, 0).is_multiple_of(PART);
        let some = all.iter().copied().filter(is_some).collect();
        Self { rows, receivers, sqrt_areas, permuted_index, even: Weights::even(), light, all, some }
    }
}

impl Encoder for Source<'_> {
    fn first_lambda(&self, epsilon: f64) -> Result<f32, Error> {
        let norm = self.norm(&self.some)?;
        let tiles = (self.some.len() * SIDE * self.permuted_index.len()).max(1) as f64;
        Ok((epsilon * epsilon * norm / (0.03 * tiles)).max(1e-30) as f32)
    }

    fn has_sample(&self) -> bool {
        self.some.len() < self.all.len()
    }

    fn sample_error(&self, lambda: f32, progress: &Progress) -> Result<f64, Error> {
        let begin = |_: usize, _: usize| progress(0, self.all.len());
        Ok(relative_error(&self.encode_all(&self.some, lambda, &begin)?))
    }

    fn is_large(&self) -> bool {
        self.all.len() >= MANY_BLOCKS
    }

    fn encode(&self, lambda: f32, progress: &Progress) -> Result<Encoded, Error> {
        let made = self.encode_all(&self.all, lambda, progress)?;
        let norm: f64 = made.iter().map(|row| row.norm).sum();
        let mut at = Vec::new();
        let mut parts = Vec::new();
        for (i, row) in made.into_iter().enumerate() {
            at.extend(row.parts.iter().map(|part| (i, part.0)));
            parts.extend(row.parts.into_iter().map(|part| part.1));
        }
        let rows = Rows::pack(&at, &parts, self.all.len() * SIDE, false);
        let lost: f64 = parts.iter().map(|part| part.error[0]).sum::<f64>() + rows.error;
        let error = if norm > 0.0 { (lost / norm).sqrt() } else { 0.0 };
        Ok(Encoded { at, parts, rows, error: [error; 3], worst: error })
    }
}
