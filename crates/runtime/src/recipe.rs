//! Recipes: the passes of each method as public functions, for plans of any program.
//!
//! A recipe puts the tables of a method on the device ([`Tables`]), adds the passes of one step of it to a
//! [`Plan`](crate::plan::Plan), and says which buffers hold the result. Where a step is one pass, a program adds the
//! kernel's own ([`Plan::add`](crate::plan::Plan::add)). One file holds the recipes of one method crate.

pub mod firstshot;
pub mod formfactor;
pub mod invert;
pub mod levels;
pub mod localmatrix;
pub mod multibounce;
pub mod multiply;
pub mod patches;
pub mod rays;
pub mod scene;
mod tables;
pub mod temporal;
pub mod walks;

use std::ops;

use glam::Vec4;

use crate::plan::RANGE_ALIGNMENT;

pub use tables::{Table, Tables, part_of};

/// Bytes of `count` RGB values: each is a `Vec4` whose last component is unused.
pub fn rgb_bytes(count: usize) -> u64 {
    (count * size_of::<Vec4>()) as u64
}

/// Rows that begin at bytes at which ranges of a buffer may begin have this distance.
fn row_step(row_bytes: u64) -> usize {
    (RANGE_ALIGNMENT >> row_bytes.trailing_zeros().min(RANGE_ALIGNMENT.trailing_zeros())) as usize
}

/// Rows from the first on in blocks that begin at multiples of `step` and are as long as `fits(first, end)` allows, one
/// step at least: the plan says so when even that is too much for a binding.
fn row_blocks(rows: usize, step: usize, fits: impl Fn(usize, usize) -> bool) -> Vec<ops::Range<usize>> {
    let mut blocks = Vec::new();
    let mut first = 0;
    while first < rows {
        let end = |steps: usize| (first + steps * step).min(rows);
        let most = (rows - first).div_ceil(step);
        let steps = (1..=most).take_while(|&k| fits(first, end(k))).last().unwrap_or(1);
        blocks.push(first..end(steps));
        first = end(steps);
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_begin_where_ranges_may() {
        for (row_bytes, step) in [(4, 64), (8, 32), (24, 32), (256, 1), (1 << 20, 1), (300, 64)] {
            assert_eq!(row_step(row_bytes), step);
            assert_eq!(step as u64 * row_bytes % RANGE_ALIGNMENT, 0);
        }
    }

    #[test]
    fn blocks_cover_all_rows_once() {
        let blocks = row_blocks(1000, 64, |first, end| end - first <= 200);
        assert_eq!(blocks.first(), Some(&(0..192)));
        assert_eq!(blocks.last().map(|block| block.end), Some(1000));
        assert!(blocks.windows(2).all(|pair| pair[0].end == pair[1].start));
        // A step that does not fit is a block nevertheless: the plan names the pass that exceeds the limit.
        assert_eq!(row_blocks(100, 64, |_, _| false), [0..64, 64..100]);
    }
}
