//! Samples of a row and what they make of its irradiance; lists of hits. H and B are W/m²; the fourth component of H is
//! the number of frames that it averages where w is chosen by itself, else it is kept.

use glam::{Vec3, Vec4};
use scene::math::{abs, luminance};
use scene::sampling::{hash, hash3, wide_product};

use crate::types::{SampleParams, SumParams};

/// Columns are 16-bit numbers, two a word, the first in the lower half.
pub const NARROW: u32 = 1;
/// Samples are the points of a lattice, shifted by one random number a row and by the golden section from frame to
/// frame.
pub const ROTATED: u32 = 2;
/// Samples the change of the exitance.
pub const CONTROL: u32 = 4;
/// The weight of the frames before follows from variance and change.
pub const AUTO: u32 = 8;
/// Entries of tables have colours.
pub const COLORED: u32 = 16;

/// 2³² over the golden section: multiples of it spread evenly over the words.
const GOLDEN: u32 = 0x9e37_79b9;
/// A row whose exact sum differs by no more than this share keeps its value, so that rounding cannot go round in
/// circles: each change that is taken brings light closer to its rest by a certain amount.
pub const STILL: f32 = 1.0 / 131_072.0;
/// Frames by which an average of no frames grows in a frame, and by how much more for each that it has, up to one: the
/// first frames after a jump, which lack the later bounces, soon count little.
pub const GROWTH: f32 = 0.25;
/// See [`GROWTH`].
pub const GROWTH_RISE: f32 = 1.0 / 16.0;
/// Variances of the change of light that are taken for noise: with one what is left of its square is unbiased, and a
/// change counts that more than one sample sees.
pub const CERTAIN: f32 = 1.0;
/// Halvings that take 2²⁰ frames below 1.
const HALVINGS: u32 = 24;

/// Returns true if an option is set.
#[inline]
pub fn has(options: u32, option: u32) -> bool {
    options & option != 0
}

/// First word of a row's random numbers.
#[inline]
pub fn first_word(row: u32, p: &SampleParams) -> u32 {
    if has(p.options, ROTATED) {
        // Between two points of the lattice only: its other points go along.
        hash3(row, 0, p.seed).wrapping_add(p.frame.wrapping_mul(GOLDEN / p.samples))
    } else {
        hash3(row, p.frame, p.seed)
    }
}

/// Word of sample k of a row, uniform over all words.
#[inline]
pub fn word(first: u32, k: u32, p: &SampleParams) -> u32 {
    if has(p.options, ROTATED) {
        first.wrapping_add(k.wrapping_mul(u32::MAX / p.samples))
    } else {
        hash(first.wrapping_add(k.wrapping_mul(GOLDEN)))
    }
}

/// Value of a column in a table; of the last one where there is none.
#[inline]
pub(super) fn at(values: &[Vec4], column: u32) -> Vec3 {
    values[column.min(values.len() as u32 - 1) as usize].truncate()
}

/// Column at an entry of a list.
#[inline]
pub fn column_at(entry: u32, columns: &[u32], options: u32) -> u32 {
    if has(options, NARROW) {
        columns[(entry / 2) as usize] >> (16 * (entry % 2)) & 0xffff
    } else {
        columns[entry as usize]
    }
}

/// New irradiance of a row from Q samples, W/m²: `H + Ĥ` of the change, or `w H + (1 − w) Ĥ`, `Ĥ = S/Q Σ_k c_k B_j(k)`.
/// `pick` takes a word to a column and its colour c, `row` is its number among all rows, `sum` the row's S. What the
/// change leaves is not below 0.
///
/// With [`AUTO`], a row that averages n frames has the variance `σ²/(2n)` and lags behind by n times the change d of a
/// frame (both relative): n grows, see [`GROWTH`], while `4 d² n³ ≤ σ²`, where the sum of variance and squared lag is
/// least, up to `w / (1 − w)` for the greatest w; else it is halved until that holds. Light that jumps has d ≈ 1: it
/// starts again. What noise may be of the change, [`CERTAIN`] times its variance over the samples, does not count: else
/// light that is fed back would never come to rest.
#[inline]
pub fn sample_row(
    row: u32,
    p: &SampleParams,
    sum: f32,
    pick: impl Fn(u32) -> (u32, Vec3),
    exitance: &[Vec4],
    change: &[Vec4],
    previous: Vec4,
) -> Vec4 {
    let first = first_word(row, p);
    let scale = sum / p.samples as f32;
    let is_control = has(p.options, CONTROL);
    let is_auto = has(p.options, AUTO);
    let mut light = Vec3::ZERO;
    let mut mean = 0.0;
    let mut squares = 0.0;
    let mut moved = 0.0;
    let mut spread = 0.0;
    // One loop for all: a closure over buffers that is called at several places does not compile for the GPU.
    for k in 0..p.samples {
        let (column, color) = pick(word(first, k, p));
        let sample = if is_control { at(change, column) } else { at(exitance, column) } * color;
        light += sample;
        if is_auto {
            let y = luminance(sample);
            mean += y;
            squares += y * y;
            let step = luminance(at(change, column) * color);
            moved += step;
            spread += step * step;
        }
    }
    if is_control {
        return (previous.truncate() + light * scale).max(Vec3::ZERO).extend(previous.w);
    }
    if !is_auto {
        return (previous.truncate() * p.blend + light * (scale * (1.0 - p.blend))).extend(previous.w);
    }
    // Of Q samples, so σ² of their mean is (Σy²/Q − (Σy/Q)²) / Q, over its square.
    let q = p.samples as f32;
    let variance = (squares * q - mean * mean) / q;
    let certain = moved * moved - CERTAIN * (spread - moved * moved / q);
    let age = frames(previous.w, variance, mean, abs(moved), certain, p.blend / (1.0 - p.blend));
    let w = age / (age + 1.0);
    let growth = GROWTH + age * GROWTH_RISE;
    (previous.truncate() * w + light * (scale * (1.0 - w))).extend(age + growth.min(1.0))
}

/// Frames that go on counting, of those that H averages: see [`sample_row`]. `variance`, `certain` and the squares of
/// `mean` and `moved` have one unit.
#[inline]
fn frames(before: f32, variance: f32, mean: f32, moved: f32, certain: f32, most: f32) -> f32 {
    let mut age = if before < most { before } else { most };
    // Light that has gone was all of it: nothing is left to compare with.
    let whole = if mean > moved { mean } else { moved };
    let change = if certain > 0.0 { certain / (whole * whole + f32::MIN_POSITIVE) } else { 0.0 };
    let noise = variance / (mean * mean + f32::MIN_POSITIVE);
    for _ in 0..HALVINGS {
        if 4.0 * change * age * age * age > noise {
            age *= 0.5;
        }
    }
    age
}

/// Irradiance of a row after an exact sum: see [`STILL`].
#[inline]
pub fn settle(previous: Vec4, exact: Vec3) -> Vec4 {
    let before = previous.truncate();
    let step = (exact - before).abs();
    let most = before.abs() * STILL;
    if step.x <= most.x && step.y <= most.y && step.z <= most.z { previous } else { exact.extend(previous.w) }
}

/// Change of the exitance, `E + ρ∘H − B`, W/m²: B is what H was sampled from.
#[inline]
pub fn change(source: Vec4, albedo: Vec4, irradiance: Vec4, exitance: Vec4) -> Vec4 {
    (source + albedo * irradiance - exitance).truncate().extend(0.0)
}

/// [`sample_row`] for row `i` of a block of lists.
///
/// Shapes: `row_start[rows + 1]` counts entries, `columns` from the entry `first_entry` on (a multiple of 2 where
/// narrow), `sums[rows]`, `exitance` and `change` by column. Needs `i < rows`.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn sample_list(
    i: u32,
    p: &SampleParams,
    row_start: &[u32],
    columns: &[u32],
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
    let pick = move |x: u32| (column_at(first + wide_product(x, count).0, columns, options), Vec3::ONE);
    sample_row(p.first_row + i, p, sums[i as usize], pick, exitance, change, previous)
}

/// Row of a block that invocation `k` sums.
#[inline]
pub fn summed_row(k: u32, p: &SumParams) -> u32 {
    let row = p.first + k;
    if row < p.rows { row } else { row - p.rows }
}

/// Exact irradiance of row `i` of a block of lists, `S/L Σ_e B_e`, W/m²; shapes as for [`sample_list`].
#[inline]
pub fn sum_list(i: u32, p: &SumParams, row_start: &[u32], columns: &[u32], sums: &[f32], exitance: &[Vec4]) -> Vec3 {
    let first = row_start[i as usize] - p.first_entry;
    let end = row_start[i as usize + 1] - p.first_entry;
    if first == end {
        return Vec3::ZERO;
    }
    let mut light = Vec3::ZERO;
    for entry in first..end {
        light += at(exitance, column_at(entry, columns, p.options));
    }
    light * (sums[i as usize] / (end - first) as f32)
}
