//! What stands in squares and single entries, on all cores.

use glam::Vec4;
use rayon::prelude::*;
use transport::check_length;

use super::lanes::{Lanes, WithLanes, dispatch};
use super::product::{GROUP, steps_of};
use super::{SIDE, check_below, check_finite, check_starts};
use crate::error::Error;
use crate::kernel::tiles::{CHANNEL_WORDS, LIGHT_WORDS, PAIRS, PAIRS_AT, PARTS, PLACES, SQUARE_WORDS};
use crate::types::TileSquare;

/// What [`near_all`] reads beside the light.
#[derive(Clone, Copy, Debug)]
pub struct NearTables<'a> {
    /// Squares of each [`crate::kernel::tiles::LANES`] places.
    pub square_start: &'a [u32],
    /// Where they are, and their steps.
    pub squares: &'a [TileSquare],
    /// Their elements.
    pub square_words: &'a [u32],
    /// Entries of each place.
    pub row_start: &'a [u32],
    /// Column in the lower 16 bits, value in the upper.
    pub entries: &'a [u32],
    /// Step of the values of each place.
    pub steps: &'a [f32],
}

impl NearTables<'_> {
    /// Of squares, of entries.
    pub(super) fn bytes(&self) -> [usize; 2] {
        [
            size_of_val(self.square_start) + size_of_val(self.squares) + size_of_val(self.square_words),
            size_of_val(self.row_start) + size_of_val(self.entries) + size_of_val(self.steps),
        ]
    }

    /// Whether the tables of so many blocks of rows belong together, and name places of so many blocks of columns.
    pub(super) fn check(&self, blocks: usize, columns: usize) -> Result<(), Error> {
        check_length("square_start", blocks * PARTS as usize + 1, self.square_start.len())?;
        check_length("square_words", self.squares.len() * SQUARE_WORDS as usize, self.square_words.len())?;
        check_length("row_start", blocks * SIDE + 1, self.row_start.len())?;
        check_length("steps", blocks * SIDE, self.steps.len())?;
        check_starts("square_start", self.square_start, self.squares.len())?;
        check_starts("row_start", self.row_start, self.entries.len())?;
        check_below("entries", self.entries.iter().map(|entry| entry & 0xffff), columns * SIDE)?;
        check_below("squares", self.squares.iter().map(|square| square.column), columns * PARTS as usize)?;
        check_finite("squares", self.squares.iter().map(|square| square.step))?;
        check_finite("steps", self.steps.iter().copied())
    }
}

/// [`crate::kernel::tiles::near`] for every place, bit for bit.
///
/// # Panics
/// Unless `ordered` has [`PLACES`] elements, as many as entries can name.
pub fn near_all(tables: &NearTables, light: &[u32], ordered: &[Vec4], rows: &mut [Vec4]) {
    let ordered: &[Vec4; PLACES] = ordered.try_into().expect("PLACES elements");
    let (blocks, _) = rows.as_chunks_mut::<SIDE>();
    blocks.par_iter_mut().enumerate().for_each(|(block, rows)| near_block(tables, light, ordered, block, rows));
}

/// [`near_all`] for one block.
pub(super) fn near_block(
    tables: &NearTables,
    light: &[u32],
    ordered: &[Vec4; PLACES],
    block: usize,
    rows: &mut [Vec4; SIDE],
) {
    let light = light.as_chunks::<{ LIGHT_WORDS as usize }>().0;
    for (part, rows) in rows.chunks_exact_mut(GROUP).enumerate() {
        let (edge, mut planes) = (block * PARTS as usize + part, [[0.0; GROUP]; 3]);
        let own = tables.square_start[edge] as usize..tables.square_start[edge + 1] as usize;
        let words = &tables.square_words.as_chunks::<{ SQUARE_WORDS as usize }>().0[own.clone()];
        dispatch(Squares { squares: &tables.squares[own], words, light, planes: &mut planes });
        for (r, row) in rows.iter_mut().enumerate() {
            *row = Vec4::new(planes[0][r], planes[1][r], planes[2][r], 0.0);
        }
    }
    dispatch(Entries { tables, first: block * SIDE, ordered, rows });
}

/// Rows of the squares of one part.
struct Squares<'a> {
    squares: &'a [TileSquare],
    words: &'a [[u32; SQUARE_WORDS as usize]],
    light: &'a [[u32; LIGHT_WORDS as usize]],
    planes: &'a mut [[f32; GROUP]; 3],
}

impl WithLanes for Squares<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self, l: L) {
        for (square, words) in self.squares.iter().zip(self.words) {
            let light = &self.light[(square.column / PARTS) as usize];
            let steps = steps_of(&light[3 * CHANNEL_WORDS as usize..]);
            // Nothing comes of darkness.
            if steps == [0.0; 3] {
                continue;
            }
            let first = (PAIRS_AT + square.column % PARTS * (3 * PAIRS)) as usize;
            let pairs = &light[first..first + 3 * PAIRS as usize];
            for k in 0..L::EACH {
                let mut sums = [l.splat(0); 3];
                for (i, group) in words.as_chunks::<GROUP>().0.iter().enumerate() {
                    let [a, b] = l.signed(l.load(group, k));
                    for (sum, pairs) in sums.iter_mut().zip(pairs.as_chunks::<{ PAIRS as usize }>().0) {
                        *sum = l.add(*sum, l.products(a, l.splat(pairs[2 * i])));
                        *sum = l.add(*sum, l.products(b, l.splat(pairs[2 * i + 1])));
                    }
                }
                for ((sum, step), plane) in sums.into_iter().zip(steps).zip(self.planes.iter_mut()) {
                    l.add_scaled(plane, k, sum, step * square.step);
                }
            }
        }
    }
}

/// Adds the single entries of the rows from a place on.
struct Entries<'a> {
    tables: &'a NearTables<'a>,
    first: usize,
    ordered: &'a [Vec4; PLACES],
    rows: &'a mut [Vec4],
}

impl WithLanes for Entries<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self, _: L) {
        let Self { tables, first, ordered, rows } = self;
        for (p, row) in (first..).zip(rows) {
            let (start, end) = (tables.row_start[p] as usize, tables.row_start[p + 1] as usize);
            let (fours, rest) = tables.entries[start..end].as_chunks::<4>();
            // The last ones are made four by nothing of the first place: how many there are is hard to foretell.
            let last = match tables.entries[end - rest.len()..].first_chunk::<4>() {
                Some(window) => std::array::from_fn(|k| window[k] & KEPT[rest.len() % 4][k]),
                None => std::array::from_fn(|k| rest.get(k).copied().unwrap_or(0)),
            };
            let mut sums = [Vec4::ZERO; 4];
            fours.iter().for_each(|four| add_entries(&mut sums, four, ordered));
            add_entries(&mut sums, &last, ordered);
            let [a, b, c, d] = sums;
            *row += (((a + b) + (c + d)) * tables.steps[p]).truncate().extend(0.0);
        }
    }
}

/// Bits that are kept of four entries, the first of which are some row's.
const KEPT: [[u32; 4]; 4] = [[0; 4], [!0, 0, 0, 0], [!0, !0, 0, 0], [!0, !0, !0, 0]];

#[inline(always)]
fn add_entries(sums: &mut [Vec4; 4], four: &[u32; 4], ordered: &[Vec4; PLACES]) {
    let values = four.map(|entry| ((entry as i32) >> 16) as f32);
    for ((sum, entry), value) in sums.iter_mut().zip(four).zip(values) {
        *sum += ordered[usize::from(*entry as u16)] * value;
    }
}
