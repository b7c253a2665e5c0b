//! Real spherical harmonics of the first bands, and sets of directions, for volumes of light.

use std::f32::consts::PI;

use glam::{Quat, Vec3, Vec4, vec4};
use scene::math::sin_cos_2pi;
use scene::sampling::{hash3, unit};

/// Y of band 0, and what x, y and z are multiplied by in band 1.
pub const BAND_0: f32 = 0.282_094_79;
pub const BAND_1: f32 = 0.488_602_51;
/// Factors of band 2: of xy, yz and xz; of 3z² − 1; of x² − y².
const BAND_2: [f32; 3] = [1.092_548_4, 0.315_391_57, 0.546_274_22];
/// Coefficients of bands 0, 1 and 2, in all.
pub const MAX_COEFFICIENTS: usize = 9;
/// By what a clamped cosine multiplies the bands in a convolution (Ramamoorthi and Hanrahan 2001).
pub const COSINE: [f32; 3] = [PI, 2.0 * PI / 3.0, 0.25 * PI];

/// Two bands in a unit direction: constant, x, y, z.
#[inline]
pub fn two_bands(d: Vec3) -> Vec4 {
    vec4(BAND_0, BAND_1 * d.x, BAND_1 * d.y, BAND_1 * d.z)
}

/// Two bands of a clamped cosine about a unit direction: ∫ max(0, n·ω) Y(ω) dω.
#[inline]
pub fn cosine_lobe(n: Vec3) -> Vec4 {
    two_bands(n) * vec4(COSINE[0], COSINE[1], COSINE[1], COSINE[1])
}

/// Three bands in a unit direction.
#[inline]
pub fn three_bands(d: Vec3) -> [f32; MAX_COEFFICIENTS] {
    let [products, polar, axes] = BAND_2;
    [
        BAND_0,
        BAND_1 * d.x,
        BAND_1 * d.y,
        BAND_1 * d.z,
        products * d.x * d.y,
        products * d.y * d.z,
        products * d.x * d.z,
        polar * (3.0 * d.z * d.z - 1.0),
        axes * (d.x * d.x - d.y * d.y),
    ]
}

/// The band of a coefficient of [`three_bands`].
pub const fn band(coefficient: usize) -> usize {
    if coefficient == 0 {
        0
    } else if coefficient < 4 {
        1
    } else {
        2
    }
}

/// Unit directions of a spherical Fibonacci set (Keinert et al. 2015): each stands for an equal part of the sphere.
pub fn spherical_fibonacci(count: u32) -> Vec<Vec3> {
    let golden = (5f64.sqrt() - 1.0) * 0.5;
    (0..count)
        .map(|k| {
            let z = 1.0 - (2.0 * k as f32 + 1.0) / count as f32;
            let (sin, cos) = sin_cos_2pi((f64::from(k) * golden).fract() as f32);
            let r = (1.0 - z * z).max(0.0).sqrt();
            Vec3::new(r * cos, r * sin, z)
        })
        .collect()
}

/// A rotation, all alike likely (Shoemake 1992, "Uniform Random Rotations").
pub fn random_turn(seed: u32) -> Quat {
    let [x, y, z] = [0, 1, 2].map(|axis| unit(hash3(seed, axis, 0x726f_7461)));
    let a = (1.0 - x).sqrt();
    let b = x.sqrt();
    let (sin_y, cos_y) = sin_cos_2pi(y);
    let (sin_z, cos_z) = sin_cos_2pi(z);
    Quat::from_xyzw(a * sin_y, a * cos_y, b * sin_z, b * cos_z).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean over the sphere of the product of two coefficients, times 4π.
    fn product(a: usize, b: usize) -> f32 {
        let directions = spherical_fibonacci(20_000);
        let sum: f32 = directions.iter().map(|&d| three_bands(d)[a] * three_bands(d)[b]).sum();
        sum * 4.0 * PI / directions.len() as f32
    }

    #[test]
    fn coefficients_are_orthonormal() {
        for (a, b) in (0..9).flat_map(|a| (0..9).map(move |b| (a, b))) {
            let expected = if a == b { 1.0 } else { 0.0 };
            assert!((product(a, b) - expected).abs() < 2e-3, "{a}, {b}: {}", product(a, b));
        }
    }

    #[test]
    fn a_lobe_is_the_cosine_in_two_bands() {
        let n = Vec3::new(0.6, -0.48, 0.64);
        let directions = spherical_fibonacci(20_000);
        let sum: Vec4 = directions.iter().map(|&d| two_bands(d) * d.dot(n).max(0.0)).sum();
        let measured = sum * (4.0 * PI / directions.len() as f32);
        assert!((measured - cosine_lobe(n)).abs().max_element() < 2e-3, "{measured}");
        assert!((measured - cosine_lobe(-n)).abs().max_element() > 0.1, "another side goes unnoticed");
    }
}
