//! From irradiance to pictures.

use core::f32::consts::FRAC_1_PI;

use glam::{Vec3, Vec4};

use super::bvh::{FAR, GeometryTables};
use super::camera::primary_direction;
use super::light::{Lights, meet_rect, sky_radiance};
use crate::gpu::{Camera, Hit, NONE};
use crate::math::{abs, pow, pow_unit, sqrt};

/// Radiance to the eye, W/m²/sr: `L = L_e + ρ/π (H_d + H)`; the sky, or a rectangle light in front of the surface,
/// shows its own radiance. `albedo` is that of the surface.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn pixel_radiance(
    g: &GeometryTables,
    lights: &Lights,
    light_count: u32,
    camera: &Camera,
    direction: Vec3,
    hit: Hit,
    albedo: Vec3,
    irradiance: Vec3,
) -> Vec3 {
    let mut nearest = if hit.triangle == NONE { FAR } else { hit.t };
    let mut radiance = Vec3::ZERO;
    if hit.triangle == NONE {
        radiance = sky_radiance(&lights.sky, lights.sky_map, direction);
    } else {
        radiance += albedo * irradiance * FRAC_1_PI;
        if g.normal(hit.triangle).dot(direction) < 0.0 {
            radiance += g.radiance(hit.triangle, hit.u, hit.v);
        }
    }
    for k in 0..light_count {
        let t = meet_rect(&lights.lights[k as usize], camera.eye, direction, nearest);
        if t < nearest {
            nearest = t;
            radiance = lights.lights[k as usize].color;
        }
    }
    radiance
}

/// Albedo of what a primary ray in unit `direction` met, averaged over what a sub-frame shows of a pixel there; 0 for the
/// sky.
#[inline]
pub fn pixel_albedo(g: &GeometryTables, camera: &Camera, direction: Vec3, hit: Hit) -> Vec4 {
    if hit.triangle == NONE {
        return Vec4::ZERO;
    }
    let area = footprint(g, camera, direction, hit);
    g.albedo_over(hit.triangle, hit.u, hit.v, area).extend(0.0)
}

/// [`footprint`] of what a primary ray met; 0 for the sky.
#[inline]
pub fn seen_area(g: &GeometryTables, camera: &Camera, direction: Vec3, hit: Hit) -> f32 {
    if hit.triangle == NONE { 0.0 } else { footprint(g, camera, direction, hit) }
}

/// Area of the triangle that was hit in unit `direction` which a sub-frame of a pixel shows, m²: all of the pixel where
/// the positions of sub-frames are random. Grows without limit towards grazing rays.
#[inline]
pub fn footprint(g: &GeometryTables, camera: &Camera, direction: Vec3, hit: Hit) -> f32 {
    let cosine = abs(g.normal(hit.triangle).dot(direction));
    let depth = hit.t * direction.dot(camera.forward);
    let pixel = 4.0 * sqrt(camera.right.length_squared() * camera.up.length_squared())
        / (camera.width as f32 * camera.height as f32);
    let shown = if camera.fixed_sub_frames > 0 { 1.0 / camera.fixed_sub_frames as f32 } else { 1.0 };
    let least = 1e-6;
    pixel * shown * depth * depth * direction.dot(camera.forward) / if cosine > least { cosine } else { least }
}

/// Sum of a pixel's radiance after one more sub-frame, W/m²/sr: what its primary ray of sub-frame `seed` met, lit by
/// the direct and the indirect irradiance there, with the albedo of the surface. The fourth component counts the
/// sub-frames.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn add_sub_frame(
    g: &GeometryTables,
    lights: &Lights,
    light_count: u32,
    camera: &Camera,
    seed: u32,
    index: u32,
    hit: Hit,
    albedo: Vec4,
    direct: Vec4,
    indirect: Vec4,
    sum: Vec4,
) -> Vec4 {
    let direction = primary_direction(camera, index, seed);
    let irradiance = (direct + indirect).truncate();
    sum + pixel_radiance(g, lights, light_count, camera, direction, hit, albedo.truncate(), irradiance).extend(1.0)
}

/// sRGB code value in [0, 1] of a linear one in [0, 1] (IEC 61966-2-1).
#[inline]
pub fn encode_srgb(x: f32) -> f32 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * pow_unit(x, 1.0 / 2.4) - 0.055 }
}

/// Linear value of an sRGB code value.
#[inline]
pub fn decode_srgb(x: f32) -> f32 {
    if x <= 0.040_45 { x / 12.92 } else { pow((x + 0.055) / 1.055, 2.4) }
}
