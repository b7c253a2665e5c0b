//! Alias tables: an entry is a slot, drawn uniformly; with the probability `t / 2¹⁶` it gives its own column, else that
//! of another entry of its row.
//!
//! Layout: `slots[e] = t << 16 | a`, a the number of the other entry within the row, so a row has at most 65,535
//! entries; `columns` as in lists. Colours: 16 bits an entry, two a word, see [`color_at`].

use glam::{Vec3, Vec4};
use scene::sampling::wide_product;

use super::sample::{COLORED, at, column_at, has, sample_row};
use crate::types::{SampleParams, SumParams};

/// Parts of a slot, whose number t counts.
pub const PARTS: u32 = 1 << 16;
/// Greatest red and blue of a colour whose luminance is 1.
pub const MAX_RED: f32 = 1.0 / 0.2126;
/// See [`MAX_RED`].
pub const MAX_BLUE: f32 = 1.0 / 0.0722;

/// The value of a code of 8 bits: squares are closer together where values are small.
#[inline]
pub fn decode(code: u32, most: f32) -> f32 {
    let root = code as f32 * (1.0 / 255.0);
    most * root * root
}

/// Colour of an entry, of luminance 1: red in the lower byte, blue in the upper; green follows.
#[inline]
pub fn color_at(entry: u32, colors: &[u32]) -> Vec3 {
    let codes = colors[(entry / 2) as usize] >> (16 * (entry % 2));
    let red = decode(codes & 0xff, MAX_RED);
    let blue = decode(codes >> 8 & 0xff, MAX_BLUE);
    let green = (1.0 - 0.2126 * red - 0.0722 * blue) * (1.0 / 0.7152);
    Vec3::new(red, if green > 0.0 { green } else { 0.0 }, blue)
}

/// Entry of a row of `count` that a word draws, counted from the row's first.
#[inline]
pub fn draw(x: u32, first: u32, count: u32, slots: &[u32]) -> u32 {
    let (slot, rest) = wide_product(x, count);
    let own = slots[(first + slot) as usize];
    if rest >> 16 < own >> 16 { slot } else { (own & 0xffff).min(count - 1) }
}

/// [`sample_row`] for row `i` of a block of tables.
///
/// Shapes: `row_start[rows + 1]` counts entries; `slots`, `columns` and, with [`COLORED`], `colors` from the entry
/// `first_entry` on (a multiple of 2); `sums[rows]`, `exitance` and `change` by column. Needs `i < rows`.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn sample_table(
    i: u32,
    p: &SampleParams,
    row_start: &[u32],
    slots: &[u32],
    columns: &[u32],
    colors: &[u32],
    sums: &[f32],
    exitance: &[Vec4],
    change: &[Vec4],
    previous: Vec4,
) -> Vec4 {
    let first = row_start[i as usize];
    let count = row_start[i as usize + 1] - first;
    if count == 0 {
        return Vec4::ZERO;
    }
    let first = first - p.first_entry;
    let options = p.options;
    let pick = move |x: u32| {
        let entry = first + draw(x, first, count, slots);
        let color = if has(options, COLORED) { color_at(entry, colors) } else { Vec3::ONE };
        (column_at(entry, columns, options), color)
    };
    sample_row(p.first_row + i, p, sums[i as usize], pick, exitance, change, previous)
}

/// Exact irradiance of row `i` of a block of tables, W/m²: each slot gives t parts to its own column and the rest to
/// the other. Shapes as for [`sample_table`].
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn sum_table(
    i: u32,
    p: &SumParams,
    row_start: &[u32],
    slots: &[u32],
    columns: &[u32],
    colors: &[u32],
    sums: &[f32],
    exitance: &[Vec4],
) -> Vec3 {
    let first = row_start[i as usize] - p.first_entry;
    let end = row_start[i as usize + 1] - p.first_entry;
    if first == end {
        return Vec3::ZERO;
    }
    let light = |entry: u32| {
        let light = at(exitance, column_at(entry, columns, p.options));
        if has(p.options, COLORED) { light * color_at(entry, colors) } else { light }
    };
    let mut sum = Vec3::ZERO;
    for entry in first..end {
        let own = slots[entry as usize];
        let t = own >> 16;
        let other = first + (own & 0xffff).min(end - first - 1);
        if other == entry {
            sum += light(entry);
        } else {
            let share = t as f32 * (1.0 / PARTS as f32);
            sum += light(entry) * share + light(other) * (1.0 - share);
        }
    }
    sum * (sums[i as usize] / (end - first) as f32)
}
