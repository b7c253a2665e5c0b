//! Estimates from the sums of a run: irradiance and its error.

use glam::{Vec2, Vec3, Vec4};

use super::fixed::{plus, to_float};
use super::register::{SUM_WORDS, luminance_word};
use crate::types::*;

/// Groups that one invocation judges.
pub const JUDGED: u32 = 64;

/// Number `k` of a table of numbers in fixed point.
#[inline]
fn fixed_at(words: &[u32], at: u32) -> Fixed {
    Fixed { low: words[at as usize], high: words[at as usize + 1] }
}

/// Irradiance of an element, W/m²: the mean of its cells, `H = Φ Σ m / Σ S`, Φ the mean flux of a photon, m the flux
/// over it that a cell has received, S the area of a cell. 0 for an element without cells.
///
/// Shapes: `sums` six words a cell, `cell_start[count + 1]`, `cells` the cells of the elements one after the other,
/// `element_areas[count]`, m².
#[inline]
pub fn element_irradiance(
    p: &ResolveParams,
    sums: &[u32],
    cell_start: &[u32],
    cells: &[u32],
    element_areas: &[f32],
    element: u32,
) -> Vec4 {
    let mut red = Fixed::default();
    let mut green = Fixed::default();
    let mut blue = Fixed::default();
    for n in cell_start[element as usize]..cell_start[element as usize + 1] {
        let at = SUM_WORDS * cells[n as usize];
        red = plus(red, fixed_at(sums, at));
        green = plus(green, fixed_at(sums, at + 2));
        blue = plus(blue, fixed_at(sums, at + 4));
    }
    let area = element_areas[element as usize];
    let scale = if area > 0.0 { p.mean_flux / area } else { 0.0 };
    (Vec3::new(to_float(red), to_float(green), to_float(blue)) * scale).extend(0.0)
}

/// Sums over the groups of block `k`, [`JUDGED`] of them, of `σ²/A` and `(H² − σ²)/A`: H the mean over the batches of
/// the luminance of a group's flux, σ the standard error of this mean, A the area of the group, m². The root of the
/// quotient of both sums over all groups is the relative error.
///
/// Shapes: `word(k)` is word k of the tallies, `group_areas[group_count]`.
#[inline]
pub fn noise_and_signal(p: &JudgeParams, word: impl Fn(u32) -> u32, group_areas: &[f32], k: u32) -> Vec2 {
    let first = k * JUDGED;
    let end = if first + JUDGED < p.group_count { first + JUDGED } else { p.group_count };
    let mut noise = 0.0;
    let mut signal = 0.0;
    for group in first..end {
        let area = group_areas[group as usize];
        if area > 0.0 {
            let value = |batch: u32| {
                let at = luminance_word(p.group_count, batch, group);
                to_float(Fixed { low: word(at), high: word(at + 1) })
            };
            let n = p.batches as f32;
            let mut sum = 0.0;
            let mut squares = 0.0;
            for batch in 0..p.batches {
                sum += value(batch);
            }
            let mean = sum / n;
            for batch in 0..p.batches {
                let off = value(batch) - mean;
                squares += off * off;
            }
            let variance = squares / (n * (n - 1.0));
            noise += variance / area;
            signal += (mean * mean - variance) / area;
        }
    }
    Vec2::new(noise, signal)
}
