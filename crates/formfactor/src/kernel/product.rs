//! The step before the product H = F B: first exitance of patches. The products themselves are those of
//! [`transport::kernel::product`], what comes after them is [`transport::kernel::grid`]'s.

use glam::Vec4;
use scene::SurfacePoint;

/// First exitance of patch `i`, `E = M_e + Σ_k w_k ρ_k H_d,k` over its points, W/m².
///
/// Shapes: `points`, `direct` and `albedo` by point, row `i` has `offsets[i]..offsets[i + 1]`; `emission` by patch.
#[inline]
pub fn assemble_source(
    i: u32,
    offsets: &[u32],
    points: &[SurfacePoint],
    direct: &[Vec4],
    emission: &[Vec4],
    albedo: &[Vec4],
) -> Vec4 {
    let mut sum = emission[i as usize];
    for k in offsets[i as usize]..offsets[i as usize + 1] {
        sum += albedo[k as usize] * direct[k as usize] * points[k as usize].weight;
    }
    sum
}
