//! The bodies of the kernels: one invocation each, no `std`.

use glam::{Vec3, Vec4};

use crate::types::{FadeParams, ProductParams};

/// Irradiance at a slot from some lit slots, `H_i = Σ_j T̂_ij √a_j E_j / √a_i`, W/m²; the fourth component is 0.
///
/// Shapes: `lit[lit_count]` names slots; `red`, `green` and `blue` hold the rows `first_row..first_row + rows` of the planes of T̂,
/// `[rows · slots]`; `root[slots]` holds √a, m; `exitance[slots]`, W/m². Needs a slot of these rows.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn gather(
    slot: u32,
    lit_count: u32,
    p: &ProductParams,
    lit: &[u32],
    red: &[f32],
    green: &[f32],
    blue: &[f32],
    root: &[f32],
    exitance: &[Vec4],
) -> Vec4 {
    let row = (slot - p.first_row) * p.slots;
    let mut sum = Vec3::ZERO;
    for k in 0..lit_count {
        let j = lit[k as usize];
        let at = (row + j) as usize;
        sum += Vec3::new(red[at], green[at], blue[at]) * (exitance[j as usize].truncate() * root[j as usize]);
    }
    (sum / root[slot as usize]).extend(0.0)
}

/// Mean exitance of the leaves `first..end` by their areas, W/m²; 0 where there are none.
///
/// Shapes: `area[leaves]`, m²; `exitance[leaves]`, W/m². Needs `end ≤ leaves`.
#[inline]
pub fn mean(first: u32, end: u32, area: &[f32], exitance: &[Vec4]) -> Vec4 {
    let (mut sum, mut whole) = (Vec3::ZERO, 0.0);
    for k in first..end {
        sum += exitance[k as usize].truncate() * area[k as usize];
        whole += area[k as usize];
    }
    if whole > 0.0 { (sum / whole).extend(0.0) } else { Vec4::ZERO }
}

/// What is left of the jumps of a leaf's light, W/m²: `o ← keep · o + (H_before − H)`, so that `H + o` goes on where the light was
/// before the matrix changed. `before` and `now` are by the matrix as it was and as it is, of the same exitance.
#[inline]
pub fn fade(offset: Vec4, before: Vec4, now: Vec4, p: &FadeParams) -> Vec4 {
    let jump = if p.has_jump != 0 { before - now } else { Vec4::ZERO };
    offset * p.keep + jump
}
