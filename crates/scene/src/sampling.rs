//! Counter-based random numbers and low-discrepancy points: the same numbers on CPU and GPU, for any thread count.

use core::f32::consts::PI;

use glam::Vec3;

use crate::math::{atan2, clamp, sin_cos_2pi, sqrt};

/// PCG-RXS-M-XS hash of one word (Jarzynski and Olano 2020, "Hash Functions for GPU Rendering").
#[inline]
pub fn hash(x: u32) -> u32 {
    let state = x.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28).wrapping_add(4))) ^ state).wrapping_mul(277_803_737);
    (word >> 22) ^ word
}

/// Hash of a tuple (row, sample, seed).
#[inline]
pub fn hash3(a: u32, b: u32, c: u32) -> u32 {
    hash(a ^ hash(b ^ hash(c)))
}

/// The word as a number in [0, 1): its upper 24 bits.
#[inline]
pub fn unit(x: u32) -> f32 {
    (x >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Radical inverse in base 2 (van der Corput) of `x` as a fixed-point word.
#[inline]
pub fn radical_inverse(x: u32) -> u32 {
    x.reverse_bits()
}

/// Point `k` of an n-point Hammersley set, shifted on the torus by the two words of `shift` (Cranley and Patterson
/// 1976).
#[inline]
pub fn hammersley(k: u32, n: u32, shift: (u32, u32)) -> (f32, f32) {
    let x = (k as f32 + 0.5) / n as f32 + unit(shift.0);
    (if x >= 1.0 { x - 1.0 } else { x }, unit(radical_inverse(k).wrapping_add(shift.1)))
}

/// Point `k` of the first two dimensions of Sobol's sequence as fixed-point words (Sobol 1967); combine with a shift by
/// `wrapping_add`.
#[inline]
pub fn sobol2(k: u32) -> (u32, u32) {
    let mut y = 0u32;
    let mut direction = 1u32 << 31;
    let mut bits = k;
    while bits != 0 {
        if bits & 1 != 0 {
            y ^= direction;
        }
        bits >>= 1;
        direction ^= direction >> 1;
    }
    (k.reverse_bits(), y)
}

/// Product of two words, its upper and its lower word.
#[inline]
pub fn wide_product(x: u32, n: u32) -> (u32, u32) {
    let a = x >> 16;
    let b = x & 0xffff;
    let c = n >> 16;
    let d = n & 0xffff;
    let low = b * d;
    let middle = a * d + (low >> 16);
    let other = b * c + (middle & 0xffff);
    (a * c + (middle >> 16) + (other >> 16), other << 16 | (low & 0xffff))
}

/// [`sobol2`] in five steps: the matrix of the second dimension is Pascal's triangle modulo 2, a sum over the supersets
/// of each bit position.
#[inline]
pub fn sobol2_fast(k: u32) -> (u32, u32) {
    let mut y = k;
    y ^= (y & 0xaaaa_aaaa) >> 1;
    y ^= (y & 0xcccc_cccc) >> 2;
    y ^= (y & 0xf0f0_f0f0) >> 4;
    y ^= (y & 0xff00_ff00) >> 8;
    y ^= y >> 16;
    (k.reverse_bits(), y.reverse_bits())
}

/// Nested uniform scrambling of a fixed-point number (Owen 1995): every bit is flipped by a hash of the bits above it
/// (Laine and Karras 2011, constants of Vegdahl 2021). Of an index it is a shuffle that keeps blocks of every power of
/// two together.
#[inline]
pub fn owen_scramble(x: u32, seed: u32) -> u32 {
    let mut x = x.reverse_bits();
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x.reverse_bits()
}

/// Two unit vectors that make a right-handed frame with the unit vector `n` (Duff et al. 2017, "Building an Orthonormal
/// Basis, Revisited").
#[inline]
pub fn frame(n: Vec3) -> (Vec3, Vec3) {
    let sign = if n.z < 0.0 { -1.0 } else { 1.0 };
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vec3::new(b, sign + n.y * n.y * a, -n.y))
}

/// Cosine-weighted direction round the unit normal `n`, density cosθ/π, from a point of the unit square (Malley).
#[inline]
pub fn cosine_hemisphere(n: Vec3, u: (f32, f32)) -> Vec3 {
    let r = sqrt(u.0);
    let (s, c) = sin_cos_2pi(u.1);
    let (t, b) = frame(n);
    // Never exactly in the plane: a ray along the surface it starts from is no use to anybody.
    let z = sqrt(1.0 - u.0);
    t * (r * c) + b * (r * s) + n * if z > 1e-4 { z } else { 1e-4 }
}

/// Uniform barycentric shares (of edge_a, edge_b) of a triangle from a point of the unit square.
#[inline]
pub fn uniform_triangle(u: (f32, f32)) -> (f32, f32) {
    // Heitz 2019, "A Low-Distortion Map Between Triangle and Square".
    if u.1 > u.0 {
        let x = u.0 * 0.5;
        (x, u.1 - x)
    } else {
        let y = u.1 * 0.5;
        (u.0 - y, y)
    }
}

/// Direction to a point of a triangle, uniform in solid angle, and the solid angle of the triangle, sr, for the unit
/// directions to its corners and a point of the unit square (Arvo 1995). The solid angle is 0 where the corners lie nearly
/// on one great circle.
#[inline]
pub fn spherical_triangle([a, b, c]: [Vec3; 3], at: (f32, f32)) -> (Vec3, f32) {
    let ab = a.cross(b);
    let bc = b.cross(c);
    let ca = c.cross(a);
    let alpha = angle(ab, -ca);
    let area = alpha + angle(bc, -ab) + angle(ca, -bc) - PI;
    if area < MIN_SOLID_ANGLE {
        return (a, 0.0);
    }
    // The point on the great circle through a and c whose triangle with a and b has this share of the area.
    let (sin_alpha, cos_alpha) = sin_cos_2pi(alpha * (0.5 / PI));
    let (sin_part, cos_part) = sin_cos_2pi(at.0 * area * (0.5 / PI));
    let sin_phi = cos_part * sin_alpha - sin_part * cos_alpha;
    let cos_phi = -cos_part * cos_alpha - sin_part * sin_alpha;
    let k1 = cos_phi + cos_alpha;
    let k2 = sin_phi - sin_alpha * a.dot(b);
    let above = k2 + (k2 * cos_phi - k1 * sin_phi) * cos_alpha;
    let below = (k2 * sin_phi + k1 * cos_phi) * sin_alpha;
    let cos_b = clamp(if below != 0.0 { above / below } else { 1.0 }, -1.0, 1.0);
    let on_side = a * cos_b + across(c, a) * sqrt(1.0 - cos_b * cos_b);
    let z = 1.0 - at.1 * (1.0 - on_side.dot(b));
    let direction = b * z + across(on_side, b) * sqrt(clamp(1.0 - z * z, 0.0, 1.0));
    (direction * (1.0 / direction.length()), area)
}

/// Solid angles below this are 0, sr: single precision loses them.
const MIN_SOLID_ANGLE: f32 = 1e-3;

/// Angle between two vectors.
#[inline]
fn angle(a: Vec3, b: Vec3) -> f32 {
    atan2(a.cross(b).length(), a.dot(b))
}

/// Unit vector at right angles to a unit vector, in its plane with another one; zero where they are one.
#[inline]
fn across(vector: Vec3, axis: Vec3) -> Vec3 {
    let rest = vector - axis * vector.dot(axis);
    let length = rest.length();
    if length > 0.0 { rest * (1.0 / length) } else { Vec3::ZERO }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_orthonormal_and_right_handed() {
        for k in 0..10_000 {
            let z = 2.0 * unit(hash3(k, 0, 1)) - 1.0;
            let (s, c) = sin_cos_2pi(unit(hash3(k, 1, 1)));
            let r = sqrt(1.0 - z * z);
            let n = Vec3::new(r * c, r * s, z);
            let (t, b) = frame(n);
            assert!((t.cross(b) - n).length() < 1e-5 && t.dot(n).abs() < 1e-5 && (t.length() - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn cosine_directions_have_the_moments_of_the_density() {
        let n = Vec3::new(0.0, 0.6, 0.8);
        let mut mean = 0.0f64;
        let mut squares = 0.0f64;
        let count = 1 << 16;
        for k in 0..count {
            let cosine = f64::from(cosine_hemisphere(n, hammersley(k, count, (hash(1), hash(2)))).dot(n));
            mean += cosine / f64::from(count);
            squares += cosine * cosine / f64::from(count);
        }
        // ∫ cos²/π = 2/3, ∫ cos³/π = 1/2 over the hemisphere.
        assert!((mean - 2.0 / 3.0).abs() < 1e-4 && (squares - 0.5).abs() < 1e-4, "{mean} {squares}");
    }

    #[test]
    fn sobol_points_are_stratified() {
        // Every elementary interval of 1/16 x 1/16 holds one of the first 256 points.
        let mut seen = [false; 256];
        for k in 0..256 {
            let (x, y) = sobol2(k);
            let cell = ((x >> 28) * 16 + (y >> 28)) as usize;
            assert!(!seen[cell]);
            seen[cell] = true;
        }
    }

    #[test]
    fn the_wide_product_is_that_of_longer_words() {
        for k in 0..100_000 {
            let x = hash(k);
            let n = if k % 2 == 0 { hash(k + 1) } else { hash(k) >> 17 };
            let (high, low) = wide_product(x, n);
            assert_eq!(u64::from(high) << 32 | u64::from(low), u64::from(x) * u64::from(n));
        }
        assert_eq!(wide_product(u32::MAX, u32::MAX), (u32::MAX - 1, 1));
    }

    #[test]
    fn the_fast_sobol_points_are_sobol_points() {
        for k in (0..100_000).chain([u32::MAX, 0x8000_0001, 0x1234_5678]) {
            assert_eq!(sobol2_fast(k), sobol2(k), "{k}");
        }
    }

    #[test]
    fn triangle_points_stay_inside() {
        for k in 0..4096 {
            let (a, b) = uniform_triangle(hammersley(k, 4096, (hash(3), hash(4))));
            assert!(a >= 0.0 && b >= 0.0 && a + b <= 1.0 + 1e-6);
        }
    }

    #[test]
    fn spherical_triangles_are_met_evenly() {
        // An octant: π/2 sr; the mean direction of a uniform one has equal parts.
        let octant = [Vec3::X, Vec3::Y, Vec3::Z];
        let flat = [Vec3::new(1.0, 0.0, 0.1), Vec3::new(0.4, 1.0, 0.1), Vec3::new(-0.9, 0.2, 0.1)].map(Vec3::normalize);
        for corners in [octant, flat, [octant[2], octant[1], octant[0]]] {
            let count = 40_000;
            let mut mean = Vec3::ZERO;
            let mut expected = Vec3::ZERO;
            let mut inside = 0;
            let mut area = 0.0;
            let holds = |d: Vec3| {
                let side = |a: Vec3, b: Vec3| a.cross(b).dot(d) >= -1e-5;
                let [a, b, c] = corners;
                let turn = a.cross(b).dot(c) > 0.0;
                [(a, b), (b, c), (c, a)].iter().all(|&(a, b)| if turn { side(a, b) } else { side(b, a) })
            };
            for k in 0..count {
                let (direction, solid_angle) = spherical_triangle(corners, hammersley(k, count, (0, 0)));
                assert!((direction.length() - 1.0).abs() < 1e-5 && holds(direction), "{direction}");
                area = solid_angle;
                mean += direction / count as f32;
                // The whole sphere, for comparison.
                let (u, v) = hammersley(k, count, (7, 9));
                let z = 2.0 * u - 1.0;
                let (sin, cos) = sin_cos_2pi(v);
                let other = Vec3::new(cos, sin, 0.0) * sqrt(1.0 - z * z) + Vec3::Z * z;
                if holds(other) {
                    inside += 1;
                    expected += other;
                }
            }
            let share = inside as f32 / count as f32 * 4.0 * PI;
            assert!((area - share).abs() < 0.02, "{area} sr beside {share}");
            assert!(mean.distance(expected / inside as f32) < 6e-3, "{mean} beside {}", expected / inside as f32);
        }
        assert_eq!(spherical_triangle([Vec3::X, Vec3::Y, Vec3::new(1.0, 1.0, 0.0).normalize()], (0.5, 0.5)).1, 0.0);
    }
}
