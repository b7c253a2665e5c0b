//! Convergence of light that bounces once a frame.

use alloc::vec;
use alloc::vec::Vec;
use core::ops::RangeInclusive;
use glam::{Vec3, Vec4};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::sampling::hash3;
use transport::{FnOperator, LinearOperator};

use super::energy::{power, spectral_radius};
use crate::error::Error;
use crate::types::FeedbackParams;

/// The eigenvalues of `diag(ρ) F` of all channels, which are real for F ≥ 0 that is reciprocal or
/// symmetric by areas: from the least, which is negative, to the greatest, to about `tolerance` of
/// their distance. The operator is F.
///
/// The greatest by [`spectral_radius`], the least by the same on the difference to it, from light
/// without any order.
///
/// # Errors
/// As [`spectral_radius`].
pub fn spectral_range(
    operator: &dyn LinearOperator,
    albedo: &[Vec4],
    tolerance: f32,
    iterations: usize,
) -> Result<RangeInclusive<f32>, Error> {
    let n = albedo.len();
    let greatest = spectral_radius(operator, albedo, tolerance, iterations)?.max_element();
    let start: Vec<Vec4> = (0..n).map(|i| Vec4::splat(random_sign(i))).collect();
    let difference = FnOperator::new(n, n, |light: &[Vec4], out: &mut [Vec4]| {
        operator.apply(light, out)?;
        for ((out, light), albedo) in out.iter_mut().zip(light).zip(albedo) {
            *out = *light * greatest - *albedo * *out;
        }
        Ok(())
    });
    let distance: Vec3 = power(start, &difference, tolerance, iterations)?;
    Ok((greatest - distance.max_element()).min(0.0)..=greatest)
}

fn random_sign(i: usize) -> f32 {
    if hash3(i as u32, 0, 0) & 1 == 0 { 1.0 } else { -1.0 }
}

/// Extrapolation of the light in a bounce, so that it settles in fewer bounces. The light that it settles at is the
/// same. Light that stays then is the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Acceleration {
    /// Step towards the light of a plain bounce.
    pub step: f32,
    /// Share of the last change that is made again.
    pub momentum: f32,
    /// Share of the distance to where the light settles that a bounce leaves, after some of them.
    pub rate: f32,
}

impl Acceleration {
    /// Plain bounces, for eigenvalues of `diag(ρ) F` in a range within (−1, 1).
    pub fn none(eigenvalues: RangeInclusive<f32>) -> Self {
        let rate = eigenvalues.start().abs().max(eigenvalues.end().abs());
        Self { step: 1.0, momentum: 0.0, rate }
    }

    /// The fastest constant step and momentum: with `q = √(1 − a)`, `p = √(1 − b)` for eigenvalues in `a..=b`, a step
    /// of `(2 / (p + q))²`, a momentum of `((q − p) / (q + p))²`, and a rate of `(q − p) / (q + p)`. This is where
    /// Chebyshev's iteration tends to, and needs no start, so that lights may change in any frame.
    ///
    /// Source: B. T. Polyak, 1964; G. H. Golub, R. S. Varga, "Chebyshev semi-iterative methods", 1961.
    ///
    /// # Errors
    /// [`transport::Error::Setting`] for eigenvalues that are not in order, or not below 1: light would grow.
    pub fn new(eigenvalues: RangeInclusive<f32>) -> Result<Self, Error> {
        let least = *eigenvalues.start();
        let greatest = *eigenvalues.end();
        if !(greatest < 1.0 && least <= greatest && least.is_finite()) {
            let rule = "in ascending order and below 1";
            return Err(transport::Error::Setting { name: "eigenvalues", value: f64::from(greatest), rule }.into());
        }
        let q = scene::math::sqrt(1.0 - least);
        let p = scene::math::sqrt(1.0 - greatest);
        let rate = (q - p) / (q + p);
        Ok(Self { step: (2.0 / (q + p)) * (2.0 / (q + p)), momentum: rate * rate, rate })
    }

    /// The steps of Chebyshev's iteration, for eigenvalues in `−radius..=radius`, from any start until at most `share` of
    /// the distance to where the light settles is left. With `T_k` for Chebyshev's polynomials and `r` for the radius,
    /// k bounces leave `1 / T_k(1 / r)`; plain ones leave `rᵏ`. [`Self::new`] goes on from frame to frame; this ends.
    ///
    /// Source: G. H. Golub, R. S. Varga, "Chebyshev semi-iterative methods", 1961.
    ///
    /// # Errors
    /// [`transport::Error::Setting`] for a radius that is not in (0, 1), or a share that is not.
    pub fn until(radius: f32, share: f32) -> Result<Vec<Self>, Error> {
        for (name, value) in [("radius", radius), ("share", share)] {
            if !(value > 0.0 && value < 1.0) {
                let rule = "between 0 and 1";
                return Err(transport::Error::Setting { name, value: f64::from(value), rule }.into());
            }
        }
        // T_{k - 1}(1 / r) / T_k(1 / r)
        let mut rate = radius;
        let mut left = rate;
        let mut steps = vec![Self { step: 1.0, momentum: 0.0, rate }];
        while left > share {
            rate = 1.0 / (2.0 / radius - rate);
            left *= rate;
            let step = 2.0 * rate / radius;
            steps.push(Self { step, momentum: step - 1.0, rate });
        }
        Ok(steps)
    }

    /// Settings of the kernel for so many patches.
    pub fn params(&self, count: u32) -> FeedbackParams {
        FeedbackParams { count, step: self.step, momentum: self.momentum }
    }

    /// Bounces after which `share` of a change is left.
    pub fn bounces(&self, share: f32) -> u32 {
        match self.rate > 0.0 {
            true => (scene::math::ln(share) / scene::math::ln(self.rate)).ceil().max(1.0) as u32,
            false => 1,
        }
    }
}
