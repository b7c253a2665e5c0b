//! Light must not grow by being compressed.

use glam::{Vec3, Vec4};
use std::vec;
use std::vec::Vec;

use crate::error::{Error, check_length};

/// Factors that give the rows of a decoded matrix the sums of the original, `f_i = Σ_j m_ij / Σ_j m'_ij` for each channel.
/// A row that has lost all its light keeps what it has, and none grows by more than `limit`.
///
/// So constant exitance gives the irradiance that it gave, and `‖diag(ρ) M'‖∞ ≤ ‖diag(ρ) M‖∞`: for entries ≥ 0 the
/// spectral radius is no greater than this norm, so that repeated bounces converge as those of the original must
/// (row sums of form factors are at most 1).
pub(super) fn row_factor(original: Vec3, decoded: Vec3, limit: f32) -> Vec3 {
    let one = |s: f32, d: f32| if d > 0.0 { (s / d).min(limit) } else { 1.0 };
    Vec3::new(one(original.x, decoded.x), one(original.y, decoded.y), one(original.z, decoded.z))
}

/// The spectral radius of `diag(ρ) M` in each channel by power iteration from constant light, to about `tolerance`
/// relative: below 1 light dies out from bounce to bounce. `product` multiplies by M ≥ 0.
///
/// # Errors
/// [`Error::Length`] for an albedo of another length, and what `product` says.
pub fn spectral_radius(
    n: usize,
    albedo: &[Vec4],
    product: &mut dyn FnMut(&[Vec4], &mut [Vec4]) -> Result<(), Error>,
    tolerance: f32,
    iterations: usize,
) -> Result<Vec3, Error> {
    check_length("albedo", n, albedo.len())?;
    let mut light = vec![Vec4::ONE; n];
    let mut next = vec![Vec4::ZERO; n];
    let mut radius = Vec3::ZERO;
    for _ in 0..iterations {
        product(&light, &mut next)?;
        for (next, albedo) in next.iter_mut().zip(albedo) {
            *next *= *albedo;
        }
        let (before, after) = (norm(&light), norm(&next));
        let found = (after / before.max(Vec3::splat(f32::MIN_POSITIVE))).min(Vec3::INFINITY);
        let change = (found - radius).abs();
        radius = found;
        let scale: Vec<f32> = after.to_array().iter().map(|a| if *a > 0.0 { 1.0 / a } else { 0.0 }).collect();
        let scale = Vec4::new(scale[0], scale[1], scale[2], 0.0);
        for (light, next) in light.iter_mut().zip(&next) {
            *light = *next * scale;
        }
        if change.cmple(radius * tolerance).all() {
            break;
        }
    }
    Ok(radius)
}

/// Euclidean length of each channel.
fn norm(values: &[Vec4]) -> Vec3 {
    let sum = values.iter().fold([0.0f64; 3], |sum, v| core::array::from_fn(|c| sum[c] + f64::from(v[c]) * f64::from(v[c])));
    Vec3::from_array(sum.map(|s| s.sqrt() as f32))
}
