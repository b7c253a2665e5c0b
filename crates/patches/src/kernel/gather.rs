//! Means over the samples of a patch.

use glam::Vec4;

use crate::types::Member;

/// Area-weighted mean of a quantity over the samples of patch `i`: `Σ w e / Σ w` with the members' weights, which sum
/// to 1, as for the first exitance `E_i = Σ w e`.
///
/// Shapes: `offsets[n + 1]`, `members[offsets[n]]`, `values` one a sample. Needs `i < n`.
#[inline]
pub fn gather_mean(i: u32, offsets: &[u32], members: &[Member], values: &[Vec4]) -> Vec4 {
    let mut sum = Vec4::ZERO;
    for k in offsets[i as usize]..offsets[i as usize + 1] {
        let member = members[k as usize];
        sum += values[member.sample as usize] * member.weight;
    }
    sum
}
