//! Which sides of the triangles take part in light transport.

use alloc::vec;
use alloc::vec::Vec;

use crate::parallel::*;
use glam::Vec3;

use crate::kernel::light::pick_emitter;
use crate::kernel::specular::specular_parts;
use crate::sampling::{cosine_hemisphere, hammersley, hash3, uniform_triangle, unit};
use crate::{Hit, LIGHT_DIRECTIONAL, LIGHT_RECT, Scene, SurfacePoint, Visibility};

/// The sides of a triangle that have patches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sides {
    /// The side from which the corners run counter-clockwise.
    pub front: bool,
    /// The other side.
    pub back: bool,
}

/// How the sides are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SidePolicy {
    /// Sides that see geometry, unless they close a space that no light enters: the inside of a solid, also of one
    /// without a bottom that stands on a floor. A side that sees no geometry is seen by none, so leaving it out changes
    /// nothing.
    #[default]
    Lit,
    /// Fronts only.
    Front,
    /// Both sides of everything.
    Both,
}

/// Random walks from a side; each is one of its probe rays.
const WALKS: u32 = 32;
/// Surfaces that a walk meets at most.
const STEPS: u32 = 16;

/// Chooses the sides of every triangle. [`SidePolicy::Lit`] sends 32 random walks of at most 16 diffuse reflections from
/// each side; a side is lit if one of them leaves the scene, meets an emitter or comes to a point that sees a light or a
/// random place of an emitter. At mirrors and glass half of the walks go on as light does.
/// Walks go from point to point, so light on the open part of a floor does not enter a column that stands on it.
pub fn find_sides(scene: &Scene, policy: SidePolicy) -> Vec<Sides> {
    let count = scene.geometry.triangles.len();
    match policy {
        SidePolicy::Front => return vec![Sides { front: true, back: false }; count],
        SidePolicy::Both => return vec![Sides { front: true, back: true }; count],
        SidePolicy::Lit => {}
    }
    find_lit_sides(scene, |_, _| false)
}

/// The sides by [`SidePolicy::Lit`], where those that are known to see geometry, by triangle and normal, need not meet it by
/// their walks.
pub fn find_lit_sides(scene: &Scene, sees: impl Fn(u32, Vec3) -> bool + Sync) -> Vec<Sides> {
    let side = |t: usize, normal: Vec3| takes_part(scene, t as u32, normal, sees(t as u32, normal));
    let normal = |t: usize| scene.tables().normal(t as u32);
    let triangles = (0..scene.geometry.triangles.len()).into_par_iter();
    triangles.map(|t| Sides { front: side(t, normal(t)), back: side(t, -normal(t)) }).collect()
}

/// Whether the side of a triangle with this normal sees geometry, or is known to, and is lit.
fn takes_part(scene: &Scene, triangle: u32, normal: Vec3, mut sees: bool) -> bool {
    let geometry = scene.tables();
    let is_back = u32::from(geometry.normal(triangle).dot(normal) < 0.0);
    let key = |dimension: u32| hash3(2 * triangle + is_back, dimension, 0);
    let mut lit = false;
    for k in 0..WALKS {
        let (u, v) = uniform_triangle(hammersley(k, WALKS, (key(0), key(1))));
        let xi = hammersley(k.reverse_bits() >> 27, WALKS, (key(2), key(3)));
        let direction = cosine_hemisphere(normal, xi);
        let hit = scene.closest(geometry.position(triangle, u, v) + normal * scene.geometry.ray_offset, direction);
        // A surface that touches closes the side.
        if !hit.is_miss() && hit.t <= 4.0 * scene.geometry.ray_offset {
            continue;
        }
        sees |= !hit.is_miss();
        lit = lit || finds_light(scene, hit, direction, hash3(key(4), k, 0));
        if sees && lit {
            return true;
        }
    }
    false
}

/// Random walks from a point that are enough where the answer matters by itself.
pub const POINT_WALKS: u32 = 8;

/// Whether light comes to a point: a point inside of a solid, as where a column stands on a floor, has none. By this
/// many random walks as in [`find_sides`].
pub fn is_open(scene: &Scene, point: &SurfacePoint, walks: u32, seed: u32) -> bool {
    (0..walks).any(|k| {
        let xi = hammersley(k, walks, (hash3(seed, 0, 1), hash3(seed, 1, 1)));
        let direction = cosine_hemisphere(point.normal, xi);
        let hit = scene.closest(point.position + point.normal * scene.geometry.ray_offset, direction);
        (hit.is_miss() || hit.t > 4.0 * scene.geometry.ray_offset)
            && finds_light(scene, hit, direction, hash3(seed, k, 2))
    })
}

/// Whether a random place of a random emitter shines on a point: a small lamp, or one in a housing, is hardly met by
/// chance. Uses the random numbers 4 to 6.
fn sees_emitter(scene: &Scene, point: Vec3, normal: Vec3, random: impl Fn(u32) -> f32) -> bool {
    let geometry = scene.tables();
    let count = scene.emitters.len() as u32;
    if count == 0 {
        return false;
    }
    let emitter = scene.emitters[pick_emitter(&scene.emitters, count, random(4)) as usize].triangle;
    let (u, v) = uniform_triangle((random(5), random(6)));
    let front = geometry.normal(emitter);
    let to_light = geometry.position(emitter, u, v) + front * scene.geometry.ray_offset - point;
    to_light.dot(normal) > 0.0
        && to_light.dot(front) < 0.0
        && geometry.radiance(emitter, u, v).max_element() > 0.0
        && !geometry.is_hole(emitter, u, v)
        && !scene.occluded(point, to_light, 1.0)
}

/// Where a walk goes on that a specular surface mirrors or lets through, each half of the times where it does both: origin and
/// direction. Nothing for the other half of the walks, which are reflected diffusely, and at other surfaces. Uses the random numbers
/// 7 and 8.
fn specular_step(scene: &Scene, hit: &Hit, direction: Vec3, random: impl Fn(u32) -> f32) -> Option<(Vec3, Vec3)> {
    let geometry = scene.tables();
    if !geometry.is_specular(hit.triangle) || random(7) < 0.5 {
        return None;
    }
    let parts = specular_parts(&geometry, hit.triangle, direction);
    let above = parts.normal * scene.geometry.ray_offset;
    let position = geometry.position(hit.triangle, hit.u, hit.v);
    match parts.refracted != Vec3::ZERO && random(8) < 0.5 {
        true => Some((position - above, parts.refracted_direction)),
        false => Some((position + above, parts.mirror_direction)),
    }
}

/// Follows a walk on from its first hit.
fn finds_light(scene: &Scene, mut hit: Hit, mut direction: Vec3, seed: u32) -> bool {
    let geometry = scene.tables();
    for step in 0..STEPS {
        if hit.is_miss() {
            return true;
        }
        let front = geometry.normal(hit.triangle);
        let facing = front.dot(direction) < 0.0;
        if facing && geometry.radiance(hit.triangle, hit.u, hit.v).max_element() > 0.0 {
            return true;
        }
        let normal = if facing { front } else { -front };
        let point = geometry.position(hit.triangle, hit.u, hit.v) + normal * scene.geometry.ray_offset;
        let random = |dimension: u32| unit(hash3(seed, step, dimension));
        for light in &scene.lighting.lights {
            if light.kind == LIGHT_DIRECTIONAL {
                if light.direction.dot(normal) < 0.0 && !scene.occluded(point, -light.direction, f32::INFINITY) {
                    return true;
                }
                continue;
            }
            let mut to_light = light.position - point;
            if light.kind == LIGHT_RECT {
                to_light += light.edge_a * random(0) + light.edge_b * random(1);
            }
            let distance = to_light.length();
            if to_light.dot(normal) > 0.0
                && !scene.occluded(point, to_light / distance, distance - scene.geometry.ray_offset)
            {
                return true;
            }
        }
        if sees_emitter(scene, point, normal, random) {
            return true;
        }
        let diffuse = || (point, cosine_hemisphere(normal, (random(2), random(3))));
        let (origin, next) = specular_step(scene, &hit, direction, random).unwrap_or_else(diffuse);
        direction = next;
        hit = scene.closest(origin, direction);
    }
    false
}
