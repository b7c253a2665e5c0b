//! Primary rays and what they meet.

use glam::Vec3;

use super::bvh::{FAR, GeometryTables, closest_hit};
use crate::gpu::{Camera, Hit, NONE, SurfacePoint};
use crate::sampling::{hash3, radical_inverse, unit};

/// Direction (not unit) through a picture position, (0, 0) the upper left corner, in pixels.
#[inline]
pub fn camera_direction(camera: &Camera, x: f32, y: f32) -> Vec3 {
    let sx = 2.0 * x / camera.width as f32 - 1.0;
    let sy = 1.0 - 2.0 * y / camera.height as f32;
    camera.forward + camera.right * sx + camera.up * sy
}

/// Position in the square of pixel `index` for sub-frame `seed` (box filter): random, or where the camera says so the
/// same in every pixel, a point of Hammersley's set in the middle of its cell.
#[inline]
pub fn pixel_position(camera: &Camera, index: u32, seed: u32) -> (f32, f32) {
    let x = index % camera.width;
    let y = index / camera.width;
    if camera.fixed_sub_frames > 0 {
        let step = 1.0 / camera.fixed_sub_frames as f32;
        let column = seed as f32 + OFF_MIDDLE.0;
        let row = unit(radical_inverse(seed)) + OFF_MIDDLE.1 * step;
        return (x as f32 + column * step, y as f32 + row);
    }
    (x as f32 + unit(hash3(index, 0x7069_7865, seed)), y as f32 + unit(hash3(index, 0x6c79_0000, seed)))
}

/// Position of fixed sub-frames in their share of a pixel: neither in its middle nor on its border, where the rays of a
/// camera that looks straight at a box meet its edges exactly.
const OFF_MIDDLE: (f32, f32) = (0.57, 0.46);

/// Unit direction of the primary ray of a pixel in a sub-frame.
#[inline]
pub fn primary_direction(camera: &Camera, index: u32, seed: u32) -> Vec3 {
    let (x, y) = pixel_position(camera, index, seed);
    let d = camera_direction(camera, x, y);
    d * (1.0 / d.length())
}

/// Hit of the primary ray of pixel `index` in sub-frame `seed`.
#[inline]
pub fn primary_hit(g: &GeometryTables, camera: &Camera, index: u32, seed: u32) -> Hit {
    closest_hit(g, camera.eye, primary_direction(camera, index, seed), FAR)
}

/// The hit as a point to be lit: position, and the normal of the side from which it is seen. A miss gives `patch ==
/// NONE` and a zero normal, which receives nothing.
#[inline]
pub fn surface_point(g: &GeometryTables, hit: Hit, direction: Vec3) -> SurfacePoint {
    let mut point = SurfacePoint { position: Vec3::ZERO, patch: NONE, normal: Vec3::ZERO, weight: 1.0 };
    if hit.triangle != NONE {
        let normal = g.normal(hit.triangle);
        point.position = g.position(hit.triangle, hit.u, hit.v);
        point.normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
        point.patch = hit.triangle;
    }
    point
}
