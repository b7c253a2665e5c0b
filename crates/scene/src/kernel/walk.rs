//! Reachability of light at a place, by random walks from surface point to surface point.

use glam::Vec3;

use super::bvh::{FAR, GeometryTables, any_hit, closest_hit};
use super::light::pick_emitter;
use super::specular::specular_parts;
use crate::gpu::{Emitter, Hit, LIGHT_DIRECTIONAL, LIGHT_RECT, Light, NONE, SurfacePoint, WalkParams};
use crate::sampling::{cosine_hemisphere, hammersley, hash3, uniform_triangle, unit};

/// The place sees no geometry.
pub const APART: u32 = 0;
/// It sees geometry, and no walk came to light.
pub const DARK: u32 = 1;
/// It sees geometry, and light comes to it.
pub const LIT: u32 = 2;

/// Rays by which a place looks for geometry and for the sky.
const RAYS: u32 = 16;
/// Rays by which a place that has seen nothing but sky looks for geometry that is far off and small.
const FAR_RAYS: u32 = 128;
/// Changes their random numbers.
const RAYS_SALT: u32 = 0x6c69_7421;
/// Surfaces that a walk meets at most.
const STEPS: u32 = 16;
/// Distance below which a hit touches the surface, in ray offsets.
const TOUCHING: f32 = 4.0;

/// Returns true if a surface touches the one that a ray starts from.
#[inline]
pub fn touches(hit: Hit, ray_offset: f32) -> bool {
    hit.triangle != NONE && hit.t <= TOUCHING * ray_offset
}

/// Light sources beside the sky.
#[derive(Clone, Copy)]
pub struct Lamps<'a> {
    /// Lights that are not geometry.
    pub lights: &'a [Light],
    /// Emissive triangles with their cumulative distribution.
    pub emitters: &'a [Emitter],
}

/// Class of a place by what it sees, and by whether light comes to it: [`APART`], [`DARK`] or [`LIT`]. What also sees
/// the sky is lit without a walk. `patch` numbers the place for its random numbers. Where the weight is below 0 walks
/// alone decide between [`DARK`] and [`LIT`], and `patch` is their seed: [`is_open`].
#[inline]
pub fn reachability(g: &GeometryTables, lamps: &Lamps, p: &WalkParams, point: SurfacePoint) -> u32 {
    let seed = p.seed ^ RAYS_SALT;
    let shift = (hash3(point.patch, 0, seed), hash3(point.patch, 1, seed));
    let origin = point.position + point.normal * p.ray_offset;
    let mut sky = false;
    let walks_alone = point.weight < 0.0;
    let mut met = point.weight != 0.0;
    let mut k = if walks_alone { RAYS + FAR_RAYS } else { 0 };
    while (k < RAYS || sky && k < RAYS + FAR_RAYS) && !(met && sky) {
        let is_near = k < RAYS;
        let number = if is_near { k } else { k - RAYS };
        let of = if is_near { RAYS } else { FAR_RAYS };
        let direction = cosine_hemisphere(point.normal, hammersley(number, of, shift));
        let hit = closest_hit(g, origin, direction, FAR);
        if hit.triangle == NONE {
            sky = true;
        } else if hit.t > TOUCHING * p.ray_offset {
            met = true;
        }
        k += 1;
    }
    let mut part = APART;
    if met {
        part = DARK;
        let of_walks = if walks_alone { point.patch } else { hash3(point.patch, 2, seed) };
        if sky || is_open(g, lamps, p, point, of_walks) {
            part = LIT;
        }
    }
    part
}

/// Returns true if one of the walks from `first_walk` to `end_walk`, of `walks` random ones from a point, comes to
/// light. All in one loop, a segment of a walk in each round.
#[inline]
pub fn is_open(g: &GeometryTables, lamps: &Lamps, p: &WalkParams, point: SurfacePoint, seed: u32) -> bool {
    let shift = (hash3(seed, 0, 1), hash3(seed, 1, 1));
    let start = point.position + point.normal * p.ray_offset;
    let mut walk = p.first_walk;
    let mut step = 0;
    let mut found = false;
    let mut origin = start;
    let mut direction = Vec3::ZERO;
    while walk < p.end_walk && !found {
        if step == 0 {
            origin = start;
            direction = cosine_hemisphere(point.normal, hammersley(walk, p.walks, shift));
        }
        let hit = closest_hit(g, origin, direction, FAR);
        let mut ends = step == 0 && touches(hit, p.ray_offset);
        if !ends {
            if hit.triangle == NONE {
                found = true;
            } else {
                let next = visit(g, lamps, p, hit, direction, (hash3(seed, walk, 2), step));
                found = next.is_lit;
                origin = next.origin;
                direction = next.direction;
            }
            step += 1;
            ends = step == STEPS;
        }
        if ends {
            walk += 1;
            step = 0;
        }
    }
    found
}

/// Follows a walk on from its first hit, by at most 16 surfaces: whether it leaves the scene, meets an emitter, or
/// comes to a point that sees a light or a random place of an emitter.
#[inline]
pub fn finds_light(
    g: &GeometryTables,
    lamps: &Lamps,
    p: &WalkParams,
    first: Hit,
    first_direction: Vec3,
    seed: u32,
) -> bool {
    let mut hit = first;
    let mut direction = first_direction;
    let mut step = 0;
    let mut found = false;
    while step < STEPS && !found {
        if hit.triangle == NONE {
            found = true;
        } else {
            let next = visit(g, lamps, p, hit, direction, (seed, step));
            found = next.is_lit;
            direction = next.direction;
            step += 1;
            if !found && step < STEPS {
                hit = closest_hit(g, next.origin, direction, FAR);
            }
        }
    }
    found
}

/// Next surface of a walk, and whether light comes there.
struct Visit {
    is_lit: bool,
    origin: Vec3,
    direction: Vec3,
}

/// A surface that a walk has met, the `step`-th of the walk with this seed.
#[inline]
fn visit(
    g: &GeometryTables,
    lamps: &Lamps,
    p: &WalkParams,
    hit: Hit,
    direction: Vec3,
    (seed, step): (u32, u32),
) -> Visit {
    let front = g.normal(hit.triangle);
    let facing = front.dot(direction) < 0.0;
    let normal = if facing { front } else { -front };
    let origin = g.position(hit.triangle, hit.u, hit.v) + normal * p.ray_offset;
    let random = |dimension: u32| unit(hash3(seed, step, dimension));
    let mut is_lit = facing && g.radiance(hit.triangle, hit.u, hit.v).max_element() > 0.0;
    let mut slot = 0;
    while slot < p.light_count && !is_lit {
        let light = lamps.lights[slot as usize];
        let mut to_light = -light.direction;
        let mut t_max = FAR;
        let mut shines = light.direction.dot(normal) < 0.0;
        if light.kind != LIGHT_DIRECTIONAL {
            to_light = light.position - origin;
            if light.kind == LIGHT_RECT {
                to_light += light.edge_a * random(0) + light.edge_b * random(1);
            }
            shines = to_light.dot(normal) > 0.0;
            let distance = to_light.length();
            to_light /= distance;
            t_max = distance - p.ray_offset;
        }
        if shines {
            is_lit = !any_hit(g, origin, to_light, t_max);
        }
        slot += 1;
    }
    if !is_lit && p.emitter_count > 0 {
        is_lit = sees_emitter(g, lamps, p, origin, normal, (random(4), random(5), random(6)));
    }
    // What a specular surface mirrors or lets through, each half of the times where it does both, and for half of the
    // walks.
    if g.is_specular(hit.triangle) && random(7) >= 0.5 {
        let parts = specular_parts(g, hit.triangle, direction);
        let above = parts.normal * p.ray_offset;
        let position = g.position(hit.triangle, hit.u, hit.v);
        if parts.refracted.max_element() > 0.0 && random(8) < 0.5 {
            return Visit { is_lit, origin: position - above, direction: parts.refracted_direction };
        }
        return Visit { is_lit, origin: position + above, direction: parts.mirror_direction };
    }
    Visit { is_lit, origin, direction: cosine_hemisphere(normal, (random(2), random(3))) }
}

/// Returns true if a random place of a random emitter shines on a point: a small lamp, or one in a housing, is hardly
/// met by chance.
#[inline]
fn sees_emitter(
    g: &GeometryTables,
    lamps: &Lamps,
    p: &WalkParams,
    point: Vec3,
    normal: Vec3,
    random: (f32, f32, f32),
) -> bool {
    let chosen = pick_emitter(lamps.emitters, p.emitter_count, random.0);
    let emitter = lamps.emitters[chosen as usize].triangle;
    let (u, v) = uniform_triangle((random.1, random.2));
    let front = g.normal(emitter);
    let to_light = g.position(emitter, u, v) + front * p.ray_offset - point;
    let faces = to_light.dot(normal) > 0.0 && to_light.dot(front) < 0.0;
    if faces && g.radiance(emitter, u, v).max_element() > 0.0 && !g.is_hole(emitter, u, v) {
        !any_hit(g, point, to_light, 1.0)
    } else {
        false
    }
}
