//! Virtual lights: points where light lands first and is sent on.
//!
//! The paper takes them from reflective shadow maps (Dachsbacher and Stamminger 2005), one texel a point. Here each
//! light casts as many rays as a map has texels, so that area lights, emitters and skies are served as well.

use std::f32::consts::{PI, TAU};

use glam::Vec3;
use rayon::prelude::*;
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_LUMINAIRE, LIGHT_RECT, LIGHT_SPOT};
use scene::kernel::bvh::FAR;
use scene::kernel::camera::surface_point;
use scene::kernel::light::{luminaire_share, pick_emitter, sky_radiance, spot_falloff};
use scene::math::sin_cos_2pi;
use scene::sampling::{cosine_hemisphere, frame, hammersley, hash3, uniform_triangle, unit};
use scene::{Light, Scene};

/// A point that sends what it reflects of a light: flux Φ, as Φ/π · cosθ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VirtualLight {
    /// m.
    pub position: Vec3,
    /// Unit normal of the lit side.
    pub normal: Vec3,
    /// W.
    pub flux: Vec3,
}

/// Light on its way.
struct Beam {
    origin: Vec3,
    direction: Vec3,
    /// W.
    flux: Vec3,
}

/// Source of a map.
#[derive(Clone, Copy)]
enum Source {
    Light(usize),
    Emitters,
    Sky,
}

/// Virtual lights of all that shines, `texels` rays for each light, for all emitters together and for the sky. On all
/// cores; the same for any number of them.
pub fn virtual_lights(scene: &Scene, texels: u32) -> Vec<VirtualLight> {
    let mut sources: Vec<Source> = (0..scene.lighting.lights.len()).map(Source::Light).collect();
    if !scene.emitters.is_empty() {
        sources.push(Source::Emitters);
    }
    if scene.has_sky() {
        sources.push(Source::Sky);
    }
    let of_source = |source: Source| (0..texels).into_par_iter().filter_map(move |k| reflect(scene, source, k, texels));
    sources.into_par_iter().flat_map(of_source).collect()
}

/// Virtual light of ray `k` of `count`.
fn reflect(scene: &Scene, source: Source, k: u32, count: u32) -> Option<VirtualLight> {
    let beam = match source {
        Source::Light(slot) => light_beam(scene, &scene.lighting.lights[slot], k, count),
        Source::Emitters => emitter_beam(scene, k, count),
        Source::Sky => sky_beam(scene, k, count),
    };
    if beam.flux == Vec3::ZERO {
        return None;
    }
    let hit = scene.closest_before(beam.origin, beam.direction, FAR);
    if hit.is_miss() {
        return None;
    }
    let tables = scene.tables();
    let point = surface_point(&tables, hit, beam.direction);
    let flux = tables.albedo(hit.triangle, hit.u, hit.v) * beam.flux;
    Some(VirtualLight { position: point.position, normal: point.normal, flux })
}

/// Two numbers for ray `k` that have nothing to do with its place in a Hammersley set.
fn more(k: u32) -> (f32, f32) {
    (unit(hash3(k, 1, 0x6c70_7601)), unit(hash3(k, 2, 0x6c70_7602)))
}

fn light_beam(scene: &Scene, light: &Light, k: u32, count: u32) -> Beam {
    let (u, v) = hammersley(k, count, (0, 0));
    if light.kind == LIGHT_DIRECTIONAL {
        let (origin, area) = opening(scene, light.direction, (u, v));
        return Beam { origin, direction: light.direction, flux: light.color * (area / count as f32) };
    }
    if light.kind == LIGHT_RECT {
        let normal = light.edge_a.cross(light.edge_b) * (1.0 / light.area);
        let origin = light.position + light.edge_a * u + light.edge_b * v + normal * scene.geometry.ray_offset;
        let flux = light.color * (PI * light.area / count as f32);
        return Beam { origin, direction: cosine_hemisphere(normal, more(k)), flux };
    }
    // A cone for spots, the whole sphere for others: equal solid angles.
    let least = if light.kind == LIGHT_SPOT { light.cos_outer } else { -1.0 };
    let axis = if light.kind == LIGHT_SPOT { light.direction } else { Vec3::Y };
    let cosine = 1.0 - u * (1.0 - least);
    let direction = round(axis, cosine, v);
    let share = match light.kind {
        LIGHT_SPOT => spot_falloff(light, cosine),
        LIGHT_LUMINAIRE => luminaire_share(light, &scene.lighting.distributions, direction),
        _ => 1.0,
    };
    let solid_angle = TAU * (1.0 - least) / count as f32;
    Beam { origin: light.position, direction, flux: light.color * (share * solid_angle) }
}

fn emitter_beam(scene: &Scene, k: u32, count: u32) -> Beam {
    let tables = scene.tables();
    let (x, y) = hammersley(k, count, (0, 0));
    let e = scene.emitters[pick_emitter(&scene.emitters, scene.emitters.len() as u32, x) as usize];
    let rest = ((x - (e.cumulative - e.probability)) / e.probability).clamp(0.0, 1.0);
    let (u, v) = uniform_triangle((rest, y));
    let normal = tables.normal(e.triangle);
    let origin = tables.position(e.triangle, u, v) + normal * scene.geometry.ray_offset;
    let hole = tables.is_hole(e.triangle, u, v);
    let radiance = if hole { Vec3::ZERO } else { tables.radiance(e.triangle, u, v) };
    let flux = radiance * (PI * e.area / (e.probability * count as f32));
    Beam { origin, direction: cosine_hemisphere(normal, more(k)), flux }
}

fn sky_beam(scene: &Scene, k: u32, count: u32) -> Beam {
    let (u, v) = hammersley(k, count, (0, 0));
    let to_sky = round(Vec3::Y, 1.0 - 2.0 * u, v);
    let (origin, area) = opening(scene, -to_sky, more(k));
    let radiance = sky_radiance(&scene.lighting.sky, &scene.lighting.sky_map, to_sky);
    Beam { origin, direction: -to_sky, flux: radiance * (area * 2.0 * TAU / count as f32) }
}

/// Unit direction with this cosine to the axis, `turn` of a turn round it.
fn round(axis: Vec3, cosine: f32, turn: f32) -> Vec3 {
    let (a, b) = frame(axis);
    let (sin, cos) = sin_cos_2pi(turn);
    let r = (1.0 - cosine * cosine).max(0.0).sqrt();
    (a * (r * cos) + b * (r * sin) + axis * cosine).normalize()
}

/// Entry of parallel light into the scene's bounds: a place of the rectangle about their outline, and its area, m².
fn opening(scene: &Scene, direction: Vec3, (u, v): (f32, f32)) -> (Vec3, f32) {
    let (low, high) = scene.geometry.bounds;
    let centre = 0.5 * (low + high);
    let (a, b) = frame(direction);
    // A box reaches as far along an axis as its half edges do together.
    let reach = |axis: Vec3| axis.abs().dot(0.5 * (high - low));
    let wide = reach(a);
    let tall = reach(b);
    let place = a * (wide * (2.0 * u - 1.0)) + b * (tall * (2.0 * v - 1.0));
    let back = direction * (reach(direction) + scene.geometry.ray_offset);
    (centre + place - back, 4.0 * wide * tall)
}
