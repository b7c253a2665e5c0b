//! Numbers of a bake with as many digits as frames need: what is left out packs to nothing.

use std::sync::Arc;

use scene::SurfacePoint;

use crate::bake::Bake;

/// Steps of a position in a ray's offset.
const STEPS: f32 = 8.0;
/// Bits of fraction of albedo, areas and weights.
const BITS: u32 = 10;
/// Those of a normal.
const NORMAL_BITS: u32 = 12;

/// Rounds samples, elements and receivers.
pub fn round(bake: &mut Bake) {
    // A power of two: the exponent alone.
    let step = f32::from_bits((bake.scene.geometry.ray_offset / STEPS).to_bits() & 0x7f80_0000);
    let mesh = Arc::make_mut(&mut bake.mesh);
    mesh.points.iter_mut().for_each(|point| round_point(point, step));
    for albedo in [&mut mesh.albedo, &mut mesh.element_albedo, &mut mesh.point_albedo] {
        albedo.iter_mut().for_each(|albedo| *albedo = albedo.to_array().map(|x| rounded(x, BITS)).into());
    }
    Arc::make_mut(&mut bake.receivers.points).iter_mut().for_each(|point| round_point(point, step));
    let interpolation = Arc::make_mut(&mut bake.receivers.interpolation);
    interpolation.points.iter_mut().for_each(|point| round_point(point, step));
}

fn round_point(point: &mut SurfacePoint, step: f32) {
    point.position = (point.position / step).round() * step;
    point.normal = point.normal.to_array().map(|x| rounded(x, NORMAL_BITS)).into();
    point.weight = rounded(point.weight, BITS);
}

/// A number with so many bits of fraction.
fn rounded(x: f32, bits: u32) -> f32 {
    let left = f32::MANTISSA_DIGITS - 1 - bits;
    f32::from_bits((x.to_bits() + (1 << (left - 1))) & !((1 << left) - 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_their_first_bits() {
        for x in [1.0f32, -0.3, 0.77, 1e-6, 12345.678] {
            let near = rounded(x, 8);
            assert!((near / x - 1.0).abs() <= 1.0 / 512.0, "{x} {near}");
            assert_eq!(near.to_bits() & 0x7fff, 0);
            assert_eq!(rounded(near, 8), near);
        }
        assert_eq!(rounded(0.0, 8), 0.0);
    }
}
