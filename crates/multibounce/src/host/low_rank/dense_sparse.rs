//! The dense and sparse parts of the product, on all cores.

use glam::Vec4;
use scene::parallel::*;
use transport::check_length;

use super::lanes::{Lanes, WithLanes, dispatch};
use super::product::{LANE_COUNT, steps_of};
use super::{SIDE, check_below, check_finite, check_starts};
use crate::error::Error;
use crate::kernel::low_rank::{CHANNEL_WORDS, LIGHT_WORDS, PAIRS, PAIRS_AT, PARTS, PERMUTED_INDICES, SUB_BLOCK_WORDS};
use crate::types::SubBlock;

/// Inputs of [`dense_sparse_all`] beside the light.
#[derive(Clone, Copy, Debug)]
pub struct DenseSparseTables<'a> {
    /// Dense sub-blocks of each [`crate::kernel::low_rank::LANES`] rows.
    pub sub_block_start: &'a [u32],
    /// Positions and quantisation steps.
    pub sub_blocks: &'a [SubBlock],
    /// Their elements.
    pub sub_block_words: &'a [u32],
    /// Entries of the sparse residual of each row.
    pub row_start: &'a [u32],
    /// Column in the lower 16 bits, value in the upper.
    pub entries: &'a [u32],
    /// Quantisation step of the values of each row.
    pub steps: &'a [f32],
}

impl DenseSparseTables<'_> {
    /// Bytes of sub-blocks, and of the sparse residual.
    pub(super) fn bytes(&self) -> [usize; 2] {
        [
            size_of_val(self.sub_block_start) + size_of_val(self.sub_blocks) + size_of_val(self.sub_block_words),
            size_of_val(self.row_start) + size_of_val(self.entries) + size_of_val(self.steps),
        ]
    }

    /// Checks that the tables of so many blocks of rows belong together, and name columns of so many blocks.
    pub(super) fn check(&self, blocks: usize, columns: usize) -> Result<(), Error> {
        check_length("sub_block_start", blocks * PARTS as usize + 1, self.sub_block_start.len())?;
        check_length("sub_block_words", self.sub_blocks.len() * SUB_BLOCK_WORDS as usize, self.sub_block_words.len())?;
        check_length("row_start", blocks * SIDE + 1, self.row_start.len())?;
        check_length("steps", blocks * SIDE, self.steps.len())?;
        check_starts("sub_block_start", self.sub_block_start, self.sub_blocks.len())?;
        check_starts("row_start", self.row_start, self.entries.len())?;
        check_below("entries", self.entries.iter().map(|entry| entry & 0xffff), columns * SIDE)?;
        check_below("sub_blocks", self.sub_blocks.iter().map(|sub_block| sub_block.column), columns * PARTS as usize)?;
        check_finite("sub_blocks", self.sub_blocks.iter().map(|sub_block| sub_block.step))?;
        check_finite("steps", self.steps.iter().copied())
    }
}

/// [`crate::kernel::low_rank::dense_sparse`] for every row, bit for bit.
///
/// # Panics
/// Unless `ordered` has [`PERMUTED_INDICES`] elements, as many as entries can name.
pub fn dense_sparse_all(tables: &DenseSparseTables, light: &[u32], ordered: &[Vec4], rows: &mut [Vec4]) {
    let ordered: &[Vec4; PERMUTED_INDICES] = ordered.try_into().expect("PERMUTED_INDICES elements");
    let (blocks, _) = rows.as_chunks_mut::<SIDE>();
    blocks.par_iter_mut().enumerate().for_each(|(block, rows)| dense_sparse_block(tables, light, ordered, block, rows));
}

/// [`dense_sparse_all`] for one block.
pub(super) fn dense_sparse_block(
    tables: &DenseSparseTables,
    light: &[u32],
    ordered: &[Vec4; PERMUTED_INDICES],
    block: usize,
    rows: &mut [Vec4; SIDE],
) {
    let light = light.as_chunks::<{ LIGHT_WORDS as usize }>().0;
    for (part, rows) in rows.chunks_exact_mut(LANE_COUNT).enumerate() {
        let edge = block * PARTS as usize + part;
        let mut planes = [[0.0; LANE_COUNT]; 3];
        let own = tables.sub_block_start[edge] as usize..tables.sub_block_start[edge + 1] as usize;
        let words = &tables.sub_block_words.as_chunks::<{ SUB_BLOCK_WORDS as usize }>().0[own.clone()];
        dispatch(DenseSubBlocks { sub_blocks: &tables.sub_blocks[own], words, light, planes: &mut planes });
        for (r, row) in rows.iter_mut().enumerate() {
            *row = Vec4::new(planes[0][r], planes[1][r], planes[2][r], 0.0);
        }
    }
    dispatch(Entries { tables, first: block * SIDE, ordered, rows });
}

/// Rows of the sub-blocks of one part.
struct DenseSubBlocks<'a> {
    sub_blocks: &'a [SubBlock],
    words: &'a [[u32; SUB_BLOCK_WORDS as usize]],
    light: &'a [[u32; LIGHT_WORDS as usize]],
    planes: &'a mut [[f32; LANE_COUNT]; 3],
}

impl WithLanes for DenseSubBlocks<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self, l: L) {
        for (sub_block, words) in self.sub_blocks.iter().zip(self.words) {
            let light = &self.light[(sub_block.column / PARTS) as usize];
            let steps = steps_of(&light[3 * CHANNEL_WORDS as usize..]);
            // Nothing comes of darkness.
            if steps == [0.0; 3] {
                continue;
            }
            let first = (PAIRS_AT + sub_block.column % PARTS * (3 * PAIRS)) as usize;
            let pairs = &light[first..first + 3 * PAIRS as usize];
            for k in 0..L::EACH {
                let mut sums = [l.splat(0); 3];
                for (i, column_words) in words.as_chunks::<LANE_COUNT>().0.iter().enumerate() {
                    let [a, b] = l.signed(l.load(column_words, k));
                    for (sum, pairs) in sums.iter_mut().zip(pairs.as_chunks::<{ PAIRS as usize }>().0) {
                        *sum = l.add(*sum, l.products(a, l.splat(pairs[2 * i])));
                        *sum = l.add(*sum, l.products(b, l.splat(pairs[2 * i + 1])));
                    }
                }
                for ((sum, step), plane) in sums.into_iter().zip(steps).zip(self.planes.iter_mut()) {
                    l.add_scaled(plane, k, sum, step * sub_block.step);
                }
            }
        }
    }
}

/// Adds the sparse residual of the rows from a permuted index on.
struct Entries<'a> {
    tables: &'a DenseSparseTables<'a>,
    first: usize,
    ordered: &'a [Vec4; PERMUTED_INDICES],
    rows: &'a mut [Vec4],
}

impl WithLanes for Entries<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self, _: L) {
        let Self { tables, first, ordered, rows } = self;
        for (p, row) in (first..).zip(rows) {
            let start = tables.row_start[p] as usize;
            let end = tables.row_start[p + 1] as usize;
            let (chunks, rest) = tables.entries[start..end].as_chunks::<4>();
            // The last ones are filled up to four with zeros of column 0: a branch on their number is hard to predict.
            let last = match tables.entries[end - rest.len()..].first_chunk::<4>() {
                Some(window) => core::array::from_fn(|k| window[k] & KEPT[rest.len() % 4][k]),
                None => core::array::from_fn(|k| rest.get(k).copied().unwrap_or(0)),
            };
            let mut sums = [Vec4::ZERO; 4];
            chunks.iter().for_each(|chunk| add_entries(&mut sums, chunk, ordered));
            add_entries(&mut sums, &last, ordered);
            let [a, b, c, d] = sums;
            *row += (((a + b) + (c + d)) * tables.steps[p]).truncate().extend(0.0);
        }
    }
}

/// Bits that are kept of four entries, the first of which are some row's.
const KEPT: [[u32; 4]; 4] = [[0; 4], [!0, 0, 0, 0], [!0, !0, 0, 0], [!0, !0, !0, 0]];

#[inline(always)]
fn add_entries(sums: &mut [Vec4; 4], chunk: &[u32; 4], ordered: &[Vec4; PERMUTED_INDICES]) {
    let values = chunk.map(|entry| ((entry as i32) >> 16) as f32);
    for ((sum, entry), value) in sums.iter_mut().zip(chunk).zip(values) {
        *sum += ordered[usize::from(*entry as u16)] * value;
    }
}
