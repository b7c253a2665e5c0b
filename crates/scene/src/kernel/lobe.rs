//! What pictures show of a surface beside diffuse light, as glTF 2.0 has it: normals of a map, and a rough specular lobe.
//!
//! The lobe is that of microfacets with the distribution of Trowbridge and Reitz (GGX; Walter et al. 2007), the masking of
//! Smith for heights that are correlated (Heitz 2014) and Fresnel's reflectance after Schlick 1994:
//! `f = D V F`, with `α = roughness²`. Roughness is at least [`MIN_ROUGHNESS`]: what is smoother shows things, not light.

use core::f32::consts::FRAC_1_PI;

use glam::{Vec3, Vec4};

use super::bvh::{FAR, GeometryTables};
use super::large::{first_sample, fixed_point};
use super::light::{Lights, meet_rect, sample_emitter, sample_rect, unoccluded};
use super::medium::transmittance;
use crate::gpu::{DirectParams, EmitterGroup, Finish, Hit, LIGHT_RECT, LargeParams, Light, Lobe, NONE, SurfacePoint};
use crate::math::{sin_cos_2pi, sqrt};
use crate::sampling::frame;

/// Least roughness of a lobe.
pub const MIN_ROUGHNESS: f32 = 0.4;
/// Reflectance of what is no metal, along the normal: that of an index of refraction of 1.5.
const DIELECTRIC: f32 = 0.04;
/// Least height of a mapped normal over the triangle, and least cosine at which a surface is seen.
const MIN_HEIGHT: f32 = 0.1;
const MIN_COSINE: f32 = 0.05;
/// Scrambles the samples by which rays of lobes are chosen.
const RAY_SLOT: u32 = 0x6c6f_6265;
/// Points of a rectangle whose light the lobe reflects in a sub-frame; an emissive triangle has one.
const RECT_POINTS: u32 = 4;

/// `(1 − x)⁵`.
#[inline]
fn schlick(x: f32) -> f32 {
    let rest = 1.0 - x;
    let squared = rest * rest;
    squared * squared * rest
}

#[inline]
fn at_least(x: f32, least: f32) -> f32 {
    if x > least { x } else { least }
}

/// The finish of a surface that was met along the unit vector `direction`: the point with the normal of the map, and the
/// lobe. Textures are averaged over `area` m² of the surface; `albedo` is its own times `through`, the share of its light
/// that comes to the pixel.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn finished(
    g: &GeometryTables,
    finishes: &[Finish],
    hit: Hit,
    direction: Vec3,
    area: f32,
    point: SurfacePoint,
    albedo: Vec4,
    through: Vec3,
) -> (SurfacePoint, Lobe) {
    let mut lobe = Lobe { to_eye: -direction, matte: 1.0, ..Lobe::default() };
    let mut point = point;
    if hit.triangle == NONE {
        return (point, lobe);
    }
    let finish = finishes[g.triangles[hit.triangle as usize].material as usize];
    if finish.normal_texture != NONE {
        let normal = mapped_normal(g, &finish, hit, area, point.normal);
        lobe.bend = normal - point.normal;
        point.normal = normal;
    }
    if finish.has_lobe == 1 {
        let mut roughness = finish.roughness;
        let mut metallic = finish.metallic;
        if finish.surface_texture != NONE {
            let texel = g.texture_over(finish.surface_texture, hit.triangle, hit.u, hit.v, area);
            roughness *= texel.y;
            metallic *= texel.z;
        }
        let roughness = at_least(roughness, MIN_ROUGHNESS);
        let seen = schlick(at_least(point.normal.dot(lobe.to_eye), MIN_COSINE));
        lobe.alpha = roughness * roughness;
        lobe.facing = through * (DIELECTRIC * (1.0 - metallic)) + albedo.truncate() * metallic;
        lobe.grazing = through;
        // What the lobe takes is gone from the diffuse part.
        lobe.matte = (1.0 - metallic) * (1.0 - DIELECTRIC - (1.0 - DIELECTRIC) * seen);
    }
    (point, lobe)
}

/// Normal of the map about a hit, on the side of `normal`, that of the surface there: a little above the triangle at
/// least.
#[inline]
fn mapped_normal(g: &GeometryTables, finish: &Finish, hit: Hit, area: f32, normal: Vec3) -> Vec3 {
    let t = g.triangles[hit.triangle as usize];
    let uv = g.uvs[hit.triangle as usize];
    let a = uv.corner_a - uv.corner;
    let b = uv.corner_b - uv.corner;
    let determinant = a.perp_dot(b);
    if determinant == 0.0 {
        return normal;
    }
    let sign = if determinant < 0.0 { -1.0 } else { 1.0 };
    // The ways along which the coordinates rise.
    let along_u = (t.edge_a * b.y - t.edge_b * a.y) * sign;
    let along_v = (t.edge_b * a.x - t.edge_a * b.x) * sign;
    let flat = g.normal(hit.triangle);
    let side = if flat.dot(normal) < 0.0 { -1.0 } else { 1.0 };
    let front = normal * side;
    let right = along_u - front * front.dot(along_u);
    let length = right.length();
    if length <= 0.0 {
        return normal;
    }
    let right = right * (1.0 / length);
    let across = front.cross(right);
    let up = if across.dot(along_v) < 0.0 { -across } else { across };
    let texel = g.texture_over(finish.normal_texture, hit.triangle, hit.u, hit.v, area);
    let x = (2.0 * texel.x - 1.0) * finish.normal_scale;
    let y = (2.0 * texel.y - 1.0) * finish.normal_scale;
    let z = at_least(2.0 * texel.z - 1.0, 1e-3);
    let mapped = right * x + up * y + front * z;
    let mapped = mapped * (1.0 / mapped.length());
    let height = mapped.dot(flat);
    let raised = if height < MIN_HEIGHT { mapped + flat * (MIN_HEIGHT - height) } else { mapped };
    raised * (side / raised.length())
}

/// Radiance that a lobe sends to the eye over the radiance from unit direction `to_light` and its solid angle:
/// `f cosθ`, 1/sr.
#[inline]
pub fn reflected(lobe: &Lobe, normal: Vec3, to_light: Vec3) -> Vec3 {
    let light = normal.dot(to_light);
    if light <= 0.0 || lobe.alpha <= 0.0 {
        return Vec3::ZERO;
    }
    let eye = at_least(normal.dot(lobe.to_eye), MIN_COSINE);
    let half = to_light + lobe.to_eye;
    let length = half.length();
    if length <= 0.0 {
        return Vec3::ZERO;
    }
    let half = half * (1.0 / length);
    let facing = at_least(half.dot(lobe.to_eye), 0.0);
    let height = at_least(half.dot(normal), 0.0);
    let squared = lobe.alpha * lobe.alpha;
    let spread = height * height * (squared - 1.0) + 1.0;
    let distribution = squared * FRAC_1_PI / (spread * spread);
    let masking =
        light * sqrt(eye * eye * (1.0 - squared) + squared) + eye * sqrt(light * light * (1.0 - squared) + squared);
    let fresnel = lobe.facing + (lobe.grazing - lobe.facing) * schlick(facing);
    fresnel * (distribution * 0.5 / masking * light)
}

/// [`reflected`] of light that comes as irradiance from one direction, over that irradiance.
#[inline]
fn of_irradiance(lobe: &Lobe, normal: Vec3, to_light: Vec3) -> Vec3 {
    let direction = to_light * (1.0 / to_light.length());
    let cosine = normal.dot(direction);
    if cosine <= 1e-4 { Vec3::ZERO } else { reflected(lobe, normal, direction) * (1.0 / cosine) }
}

/// Change of a quantity with direction, a vector for each channel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Slope {
    /// Components along x, of red, green and blue; along y and z.
    pub x: Vec3,
    /// Along y.
    pub y: Vec3,
    /// Along z.
    pub z: Vec3,
}

impl Slope {
    /// With a change by `amount` along a direction.
    #[inline]
    #[must_use]
    pub fn with(self, amount: Vec3, along: Vec3) -> Self {
        Self { x: self.x + amount * along.x, y: self.y + amount * along.y, z: self.z + amount * along.z }
    }

    /// Change along a vector.
    #[inline]
    pub fn along(&self, way: Vec3) -> Vec3 {
        self.x * way.x + self.y * way.y + self.z * way.z
    }
}

/// Radiance that the lobe of a point sends to the eye from parallel, point and spot lights and luminaires, W/m²/sr, by a
/// shadow ray to each. `absorption` is that of the medium, 1/m.
#[inline]
pub fn sharp_light(
    p: &DirectParams,
    absorption: Vec3,
    point: SurfacePoint,
    lobe: &Lobe,
    lights: &Lights,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool + Copy,
) -> Vec3 {
    let mut sum = Vec3::ZERO;
    if lobe.alpha <= 0.0 {
        return sum;
    }
    let origin = point.position + point.normal * p.ray_offset;
    for slot in 0..p.light_count {
        let light = lights.lights[slot as usize];
        if light.kind != LIGHT_RECT {
            let arrival = unoccluded(&light, lights.distributions, origin, point.normal);
            if arrival.share > 0.0 && !occluded(origin, arrival.to_light, arrival.t_max) {
                let left = transmittance(absorption, arrival.distance());
                sum += light.color * left * arrival.share * of_irradiance(lobe, point.normal, arrival.to_light);
            }
        }
    }
    sum
}

/// Radiance that the lobe of a pixel sends to the eye from rectangles and emissive triangles, W/m²/sr, were nothing in
/// the way; groups of many emitters as points.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn open_light(
    g: &GeometryTables,
    lights: &Lights,
    groups: &[EmitterGroup],
    p: &LargeParams,
    index: u32,
    point: SurfacePoint,
    lobe: &Lobe,
) -> Vec3 {
    let mut sum = Vec3::ZERO;
    if lobe.alpha <= 0.0 {
        return sum;
    }
    let normal = point.normal;
    let origin = point.position + normal * p.ray_offset;
    let first = first_sample(p, index);
    for slot in 0..p.light_count {
        let light = lights.lights[slot as usize];
        if light.kind == LIGHT_RECT {
            for k in 0..RECT_POINTS {
                let at = fixed_point(RECT_POINTS * first + k, 2 + slot);
                let (share, to) = sample_rect(&light, (origin, normal), at);
                if share > 0.0 {
                    sum += light.color * (share / RECT_POINTS as f32) * of_irradiance(lobe, normal, to);
                }
            }
        }
    }
    if p.group_count == 0 {
        for k in 0..p.emitter_count {
            let at = fixed_point(first, 1);
            let (light, to) = sample_emitter(g, &lights.emitters[k as usize], at, (origin, normal), p.ray_offset);
            if light.x > 0.0 || light.y > 0.0 || light.z > 0.0 {
                sum += light * of_irradiance(lobe, normal, to);
            }
        }
    }
    for k in 0..p.group_count {
        let group = groups[k as usize];
        let light = super::large::group_irradiance(&group, origin, normal);
        if light.x > 0.0 || light.y > 0.0 || light.z > 0.0 {
            sum += light * of_irradiance(lobe, normal, group.centre - origin);
        }
    }
    sum
}

/// A lobe as it shows in a pixel: none behind a rectangle light.
#[inline]
pub fn shown(lobe: Lobe, lights: &[Light], count: u32, eye: Vec3, hit: Hit) -> Lobe {
    let mut shown = lobe;
    for k in 0..count {
        if meet_rect(&lights[k as usize], eye, -lobe.to_eye, hit.t) < FAR {
            shown.alpha = 0.0;
        }
    }
    shown
}

/// Direction from which light comes that a lobe reflects to the eye, from a point of the unit square, and the share of
/// its radiance that the eye gets: by microfacets as they are seen (Heitz 2018; Dupuy and Benyoub 2023), so that
/// Fresnel's reflectance and the masking of the light are left. A direction into the surface has no share.
#[inline]
pub fn sample(lobe: &Lobe, normal: Vec3, at: (f32, f32)) -> (Vec3, Vec3) {
    let (right, up) = frame(normal);
    let alpha = lobe.alpha;
    let eye = at_least(normal.dot(lobe.to_eye), MIN_COSINE);
    let stretched = Vec3::new(alpha * lobe.to_eye.dot(right), alpha * lobe.to_eye.dot(up), eye);
    let stretched = stretched * (1.0 / stretched.length());
    let (sine, cosine) = sin_cos_2pi(at.0);
    let z = (1.0 - at.1) * (1.0 + stretched.z) - stretched.z;
    let across = sqrt(at_least(1.0 - z * z, 0.0));
    let cap = Vec3::new(across * cosine, across * sine, z) + stretched;
    let half = right * (alpha * cap.x) + up * (alpha * cap.y) + normal * at_least(cap.z, 1e-6);
    let half = half * (1.0 / half.length());
    let facing = at_least(half.dot(lobe.to_eye), 0.0);
    let direction = half * (2.0 * facing) - lobe.to_eye;
    let light = direction.dot(normal);
    if light <= 0.0 {
        return (direction, Vec3::ZERO);
    }
    let squared = alpha * alpha;
    let of_eye = sqrt(eye * eye * (1.0 - squared) + squared);
    let of_light = sqrt(light * light * (1.0 - squared) + squared);
    let unmasked = light * (eye + of_eye) / (light * of_eye + eye * of_light);
    let fresnel = lobe.facing + (lobe.grazing - lobe.facing) * schlick(facing);
    (direction, fresnel * unmasked)
}

/// Reflectance of the microfacets that lie as the surface does: what the light of rays is divided by where it is averaged
/// over pixels.
#[inline]
pub fn reflectance(lobe: &Lobe, normal: Vec3) -> Vec3 {
    if lobe.alpha <= 0.0 {
        return Vec3::ZERO;
    }
    let cosine = at_least(normal.dot(lobe.to_eye), MIN_COSINE);
    lobe.facing + (lobe.grazing - lobe.facing) * schlick(cosine)
}

/// Ray of a pixel's lobe in a sub-frame, as [`sample`] has it.
#[inline]
pub fn ray(p: &LargeParams, index: u32, point: SurfacePoint, lobe: &Lobe) -> (Vec3, Vec3) {
    sample(lobe, point.normal, fixed_point(first_sample(p, index) / p.rays, RAY_SLOT))
}
