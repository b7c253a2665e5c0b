//! The product H = F B for RGB vectors, one row an invocation, and what follows it. B is the exitance and H the
//! irradiance in W/m²; the fourth component is not used.

use glam::{Vec2, Vec4};
use scene::{Hit, NONE};

use super::grid::interpolate;
use crate::types::TriangleGrid;

/// Irradiance of row `i`, `H_i = Σ_j F_ij B_j`, W/m².
///
/// Shapes: `factors[rows · n]` row-major, `exitance[n]`. Needs `i < rows`.
#[inline]
pub fn gather_row(i: u32, n: u32, factors: &[f32], exitance: &[Vec4]) -> Vec4 {
    let base = i * n;
    let mut sum = Vec4::ZERO;
    for j in 0..n {
        sum += exitance[j as usize] * factors[(base + j) as usize];
    }
    sum
}

/// Words of one row of `n` half-precision numbers, two a word.
#[inline]
pub fn packed_row_words(n: u32) -> u32 {
    n.div_ceil(2)
}

/// Irradiance of row `i` from half-precision factors, W/m². `unpack` turns a word into its lower and upper half.
///
/// Shapes: `packed[rows · packed_row_words(n)]`, the last upper half of odd rows is 0; `exitance[n]`. Needs `i < rows`.
#[inline]
pub fn gather_row_packed(i: u32, n: u32, packed: &[u32], exitance: &[Vec4], unpack: impl Fn(u32) -> Vec2) -> Vec4 {
    let base = i * packed_row_words(n);
    let mut sum = Vec4::ZERO;
    for pair in 0..n / 2 {
        let f = unpack(packed[(base + pair) as usize]);
        sum += exitance[2 * pair as usize] * f.x;
        sum += exitance[2 * pair as usize + 1] * f.y;
    }
    if n % 2 == 1 {
        sum += exitance[(n - 1) as usize] * unpack(packed[(base + n / 2) as usize]).x;
    }
    sum
}

/// Irradiance of row `i` from compressed sparse rows, W/m².
///
/// Shapes: `row_start[rows + 1]`, `columns` and `values` `[row_start[rows]]`. Needs `i < rows`.
#[inline]
pub fn gather_row_sparse(i: u32, row_start: &[u32], columns: &[u32], values: &[f32], exitance: &[Vec4]) -> Vec4 {
    let mut sum = Vec4::ZERO;
    for k in row_start[i as usize]..row_start[i as usize + 1] {
        sum += exitance[columns[k as usize] as usize] * values[k as usize];
    }
    sum
}

/// Exitance after a bounce, `B = E + ρ∘H`, W/m².
#[inline]
pub fn bounce(source: Vec4, albedo: Vec4, irradiance: Vec4) -> Vec4 {
    source + albedo * irradiance
}

/// Irradiance at a hit, W/m²: linear between the three grid vertices of its triangle round it, zero where that side has
/// no receivers. `grids[triangle]` numbers the vertices, `values` holds their irradiance.
#[inline]
pub fn interpolate_receivers(grids: &[TriangleGrid], values: &[Vec4], hit: Hit, front: bool) -> Vec4 {
    if hit.triangle == NONE {
        return Vec4::ZERO;
    }
    let grid = grids[hit.triangle as usize];
    let first = if front { grid.front } else { grid.back };
    if first == NONE {
        return Vec4::ZERO;
    }
    let (ids, w) = interpolate(grid.divisions, hit.u, hit.v);
    values[(first + ids.x) as usize] * w.x
        + values[(first + ids.y) as usize] * w.y
        + values[(first + ids.z) as usize] * w.z
}
