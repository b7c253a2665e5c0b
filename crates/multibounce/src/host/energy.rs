//! Light must not grow by being compressed.

use alloc::vec;
use alloc::vec::Vec;
use glam::{Vec3, Vec4};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use transport::{FnOperator, LinearOperator, check_length};

use crate::error::Error;

/// Factors that give the rows of a decoded matrix the sums of the original, `f_i = Σ_j m_ij / Σ_j m'_ij` for each
/// channel. A row that has lost all its light keeps what it has, and none grows by more than `limit`.
///
/// So constant exitance gives the irradiance that it gave, and `‖diag(ρ) M'‖∞ ≤ ‖diag(ρ) M‖∞`: for entries ≥ 0 the
/// spectral radius is no greater than this norm, so that repeated bounces converge as those of the original must
/// (row sums of form factors are at most 1).
#[cfg(feature = "texture-blocks")]
pub(super) fn row_factor(original: Vec3, decoded: Vec3, limit: f32) -> Vec3 {
    let one = |s: f32, d: f32| if d > 0.0 { (s / d).min(limit) } else { 1.0 };
    Vec3::new(one(original.x, decoded.x), one(original.y, decoded.y), one(original.z, decoded.z))
}

/// The spectral radius of `diag(ρ) M` in each channel, M ≥ 0, to about `tolerance` relative: below
/// 1 light dies out from bounce to bounce. Power iteration from constant light; the mean growth of
/// two steps, for where light goes to and fro between two sets of patches the single steps differ
/// for ever.
///
/// # Errors
/// [`transport::Error::Length`] for an albedo of another length, and what the operator says.
pub fn spectral_radius(
    operator: &dyn LinearOperator,
    albedo: &[Vec4],
    tolerance: f32,
    iterations: usize,
) -> Result<Vec3, Error> {
    let n = operator.rows();
    check_length("albedo", n, albedo.len())?;
    let bounce = FnOperator::new(n, n, |light: &[Vec4], out: &mut [Vec4]| {
        operator.apply(light, out)?;
        out.iter_mut().zip(albedo).for_each(|(out, albedo)| *out *= *albedo);
        Ok(())
    });
    power(vec![Vec4::ONE; n], &bounce, tolerance, iterations)
}

/// The greatest eigenvalue, by its absolute value, of a square operator in each channel.
pub(super) fn power(
    mut light: Vec<Vec4>,
    operator: &dyn LinearOperator,
    tolerance: f32,
    iterations: usize,
) -> Result<Vec3, Error> {
    let mut next = vec![Vec4::ZERO; light.len()];
    let mut radius = Vec3::ZERO;
    let mut last = Vec3::ZERO;
    for step in 0..iterations {
        operator.apply(&light, &mut next)?;
        // The light has length 1 after the first step.
        let growth = norm(&next);
        let found = (growth * last).map(scene::math::sqrt);
        let change = (found - radius).abs();
        (radius, last) = (found, growth);
        let scale = growth.map(|g| if g > 0.0 { 1.0 / g } else { 0.0 }).extend(0.0);
        for (light, next) in light.iter_mut().zip(&next) {
            *light = *next * scale;
        }
        if step > 1 && change.cmple(radius * tolerance).all() {
            break;
        }
    }
    Ok(radius)
}

/// Euclidean length of each channel.
fn norm(values: &[Vec4]) -> Vec3 {
    let sum =
        values.iter().fold([0.0f64; 3], |sum, v| core::array::from_fn(|c| sum[c] + f64::from(v[c]) * f64::from(v[c])));
    Vec3::from_array(sum.map(|s| s.sqrt() as f32))
}
