//! The sky as bins of directions: what a point receives from it follows from the share of its rays that escape through
//! each.

use alloc::vec::Vec;

use core::f32::consts::{PI, TAU};

use glam::{Vec3, Vec4};

use super::lighting::Lighting;
use crate::kernel::light::sky_radiance;
use crate::math::{atan2, sin_cos_2pi, sqrt};
use crate::sampling::hammersley;

/// Rings of bins from the zenith to the nadir, and bins of a ring; all have the same solid angle.
const RINGS: u32 = 16;
const RING_BINS: u32 = 32;
/// Number of bins.
pub const SKY_BINS: usize = (RINGS * RING_BINS) as usize;
/// Directions of a bin in which a map is looked up.
const BIN_POINTS: u32 = 64;

/// The bin of a unit direction, below [`SKY_BINS`].
pub fn sky_bin(direction: Vec3) -> u32 {
    let ring = ((0.5 - 0.5 * direction.y) * RINGS as f32) as u32;
    let azimuth = (0.5 + atan2(direction.x, -direction.z) * (1.0 / TAU)) * RING_BINS as f32;
    ring.min(RINGS - 1) * RING_BINS + (azimuth as u32).min(RING_BINS - 1)
}

/// The direction of the middle of a bin.
pub fn sky_direction(bin: u32) -> Vec3 {
    bin_direction(bin, (0.5, 0.5))
}

/// Exitance of each bin, `[SKY_BINS]`, W/m²: π times its mean radiance. A point receives its sum over the bins, each
/// times the share of the point's cosine-weighted hemisphere that sees the sky there: exact for a sky that is even in
/// each bin, as one without a map is.
pub fn sky_exitance(lighting: &Lighting) -> Vec<Vec4> {
    let Lighting { sky, sky_map, .. } = lighting;
    if sky.map_width == 0 {
        return alloc::vec![(sky.radiance * PI).extend(0.0); SKY_BINS];
    }
    let mut bins = Vec::with_capacity(SKY_BINS);
    for bin in 0..SKY_BINS as u32 {
        let mut sum = Vec3::ZERO;
        for k in 0..BIN_POINTS {
            sum += sky_radiance(sky, sky_map, bin_direction(bin, hammersley(k, BIN_POINTS, (0, 0))));
        }
        bins.push((sum * (PI / BIN_POINTS as f32)).extend(0.0));
    }
    bins
}

/// The direction at a place of a bin's square.
fn bin_direction(bin: u32, (x, y): (f32, f32)) -> Vec3 {
    let height = 1.0 - 2.0 * ((bin / RING_BINS) as f32 + y) / RINGS as f32;
    // Azimuth 0.5 is −z.
    let azimuth = ((bin % RING_BINS) as f32 + x) / RING_BINS as f32;
    let (sin, cos) = sin_cos_2pi(azimuth);
    let radius = sqrt((1.0 - height * height).max(0.0));
    Vec3::new(-sin * radius, height, cos * radius)
}

#[cfg(test)]
mod tests {
    use alloc::vec;

    use super::*;
    use crate::gpu::Sky;
    use crate::sampling::{cosine_hemisphere, hash};

    #[test]
    fn directions_lie_in_their_bins() {
        for bin in 0..SKY_BINS as u32 {
            for k in 0..16 {
                let direction = bin_direction(bin, hammersley(k, 16, (hash(bin), hash(k))));
                assert!((direction.length() - 1.0).abs() < 1e-5);
                // On an edge rounding decides.
                let (x, y) = hammersley(k, 16, (hash(bin), hash(k)));
                if x.min(y) > 1e-3 && x.max(y) < 0.999 {
                    assert_eq!(sky_bin(direction), bin, "{direction}");
                }
            }
        }
    }

    /// Irradiance by bins and by directions, for a sky that rises from dark at −x to bright at +x.
    fn irradiances(normal: Vec3, bins: &[Vec4], lighting: &Lighting) -> (f32, f32) {
        let rays = 1 << 14;
        let mut by_bins = 0.0;
        let mut exact = 0.0;
        for k in 0..rays {
            let direction = cosine_hemisphere(normal, hammersley(k, rays, (0, 0)));
            by_bins += bins[sky_bin(direction) as usize].x / rays as f32;
            exact += PI * sky_radiance(&lighting.sky, &lighting.sky_map, direction).x / rays as f32;
        }
        (by_bins, exact)
    }

    #[test]
    fn bins_carry_the_irradiance_of_a_map() {
        let width = 64;
        let height = 32;
        let sky = Sky { radiance: Vec3::ONE, map_width: width, map_height: height, ..Sky::default() };
        let sky_map: Vec<Vec4> = (0..width * height)
            .map(|k| {
                let azimuth = ((k % width) as f32 + 0.5) / width as f32;
                Vec4::splat(1.0 + 0.9 * sin_cos_2pi(azimuth).0 * if k / width < height / 2 { 1.0 } else { 0.2 })
            })
            .collect();
        let lighting = Lighting { sky, sky_map: sky_map.into(), ..Lighting::default() };
        let bins = sky_exitance(&lighting);
        // The mean of all bins in each: a wrong table, which must not pass.
        let mean = bins.iter().sum::<Vec4>() / SKY_BINS as f32;
        let even = vec![mean; SKY_BINS];
        let mut worst_of_even: f32 = 0.0;
        for normal in [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::Z, Vec3::new(0.6, 0.8, 0.0), Vec3::NEG_Y] {
            let (found, expected) = irradiances(normal, &bins, &lighting);
            assert!((found / expected - 1.0).abs() < 0.01, "{normal}: {found} of {expected}");
            let (found, expected) = irradiances(normal, &even, &lighting);
            worst_of_even = worst_of_even.max((found / expected - 1.0).abs());
        }
        assert!(worst_of_even > 0.1, "{worst_of_even}");
    }

    #[test]
    fn a_constant_sky_is_exact() {
        let sky = Sky { radiance: Vec3::new(1.0, 2.0, 3.0), ..Sky::default() };
        let bins = sky_exitance(&Lighting { sky, ..Lighting::default() });
        assert!(bins.iter().all(|bin| *bin == Vec4::new(PI, 2.0 * PI, 3.0 * PI, 0.0)));
    }
}
