//! The bodies of the kernels: one invocation each, no `std`.

use glam::{Vec3, Vec4};

/// Irradiance at a slot from some lit slots, `H_i = Σ_j T̂_ij √a_j E_j / √a_i`, W/m²; the fourth component is 0.
///
/// Shapes: `lit[lit_count]` names slots; `state[3 · slots · slots]` holds T̂ of red, green and blue; `root[slots]` holds √a, m;
/// `exitance[slots]`, W/m². Needs `slot < slots`.
#[inline]
pub fn gather(
    slot: u32,
    slots: u32,
    lit_count: u32,
    lit: &[u32],
    state: &[f32],
    root: &[f32],
    exitance: &[Vec4],
) -> Vec4 {
    let (row, plane) = (slot * slots, slots * slots);
    let mut sum = Vec3::ZERO;
    for k in 0..lit_count {
        let j = lit[k as usize];
        let at = row + j;
        let t = Vec3::new(state[at as usize], state[(plane + at) as usize], state[(2 * plane + at) as usize]);
        sum += t * (exitance[j as usize].truncate() * root[j as usize]);
    }
    (sum / root[slot as usize]).extend(0.0)
}
