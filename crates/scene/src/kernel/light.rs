//! Direct irradiance at a point: H_d = ∫ L cosθ dω over lights, emitters and sky that are seen from it.

use core::f32::consts::PI;

use glam::{Vec2, Vec3, Vec4};

use super::bvh::{FAR, GeometryTables};
use super::medium::{Air, Medium, Share as _};
use crate::gpu::{
    DirectParams, Emitter, LIGHT_DIRECTIONAL, LIGHT_LUMINAIRE, LIGHT_RECT, LIGHT_SPOT, Light, NONE, Sky, SurfacePoint,
};
use crate::math::{acos, atan2, clamp, floor, sqrt};
use crate::sampling::{cosine_hemisphere, hammersley, hash3, spherical_triangle, uniform_triangle};

/// Words before the values of a distribution: its first γ in radians, its steps of γ per radian, its number of steps of
/// γ, and its number of half-planes, 0 where it is the same in all.
pub const DISTRIBUTION_HEADER: u32 = 4;
/// Steps of γ by which a direction may lie outside of a distribution by rounding.
const OUTSIDE: f32 = 1e-3;

/// Everything that shines.
#[derive(Clone, Copy, Debug)]
pub struct Lights<'a> {
    /// Lights that are not geometry.
    pub lights: &'a [Light],
    /// Emissive triangles with their cumulative distribution.
    pub emitters: &'a [Emitter],
    /// The sky.
    pub sky: Sky,
    /// Its map, row by row from the top, `map_width · map_height` texels.
    pub sky_map: &'a [Vec4],
    /// Distributions of luminaires.
    pub distributions: &'a [f32],
}

/// Share of a spot's intensity at a cosine from its axis: smoothstep between the outer and the inner cone.
#[inline]
pub fn spot_falloff(light: &Light, cosine: f32) -> f32 {
    let x = clamp((cosine - light.cos_outer) / (light.cos_inner - light.cos_outer + 1e-6), 0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// Intensity of a luminaire along `away`, of any length, over its mean: bilinear in γ and C, as LM-63 and CIE 121 have
/// it; 0 beyond the angles that were measured. Shape of a distribution: [`DISTRIBUTION_HEADER`] words, then `steps + 1`
/// values of each half-plane, which lie at equal angles from C = 0 on.
#[inline]
pub fn luminaire_share(light: &Light, distributions: &[f32], away: Vec3) -> f32 {
    let first = light.distribution;
    let gamma_first = distributions[first as usize];
    let per_radian = distributions[first as usize + 1];
    let steps = distributions[first as usize + 2];
    let planes = distributions[first as usize + 3] as u32;
    let x = away.dot(light.edge_a);
    let y = away.dot(light.edge_a.cross(light.direction));
    let gamma = atan2(sqrt(x * x + y * y), away.dot(light.direction));
    let row = (gamma - gamma_first) * per_radian;
    if row < -OUTSIDE || row > steps + OUTSIDE {
        return 0.0;
    }
    let row = clamp(row, 0.0, steps);
    let low = floor(row);
    let fraction = row - low;
    let last = steps as u32;
    let low = low as u32;
    let high = if low < last { low + 1 } else { last };
    let values = first + DISTRIBUTION_HEADER;
    if planes == 0 {
        return mix(distributions, values + low, values + high, fraction);
    }
    let turn = atan2(y, x) * (0.5 / PI);
    let column = (if turn < 0.0 { turn + 1.0 } else { turn }) * planes as f32;
    let left = floor(column);
    let beside = column - left;
    let left = if left < planes as f32 { left as u32 } else { 0 };
    let right = if left + 1 < planes { left + 1 } else { 0 };
    let a = values + left * (last + 1);
    let b = values + right * (last + 1);
    let at_left = mix(distributions, a + low, a + high, fraction);
    let at_right = mix(distributions, b + low, b + high, fraction);
    at_left + (at_right - at_left) * beside
}

/// Between two values of a table.
#[inline]
fn mix(table: &[f32], a: u32, b: u32, fraction: f32) -> f32 {
    let at_a = table[a as usize];
    at_a + (table[b as usize] - at_a) * fraction
}

/// Radiance of the sky in a unit direction, W/m²/sr: bilinear in the equirectangular map (columns wrap, rows end).
#[inline]
pub fn sky_radiance(sky: &Sky, map: &[Vec4], direction: Vec3) -> Vec3 {
    if sky.map_width == 0 {
        return sky.radiance;
    }
    let width = sky.map_width;
    let height = sky.map_height;
    let x = (0.5 + atan2(direction.x, -direction.z) * (0.5 / PI)) * width as f32 - 0.5;
    let y = acos(direction.y) * (1.0 / PI) * height as f32 - 0.5;
    let x_floor = floor(x);
    let y_floor = floor(y);
    let fx = x - x_floor;
    let fy = y - y_floor;
    let x0 = if x_floor < 0.0 { width - 1 } else { x_floor as u32 % width };
    let x1 = if x0 + 1 < width { x0 + 1 } else { 0 };
    let y0 = if y_floor < 0.0 { 0 } else { y_floor as u32 };
    let y0 = if y0 < height { y0 } else { height - 1 };
    let y1 = if y_floor >= 0.0 && y0 + 1 < height { y0 + 1 } else { y0 };
    let top = map[(y0 * width + x0) as usize] * (1.0 - fx) + map[(y0 * width + x1) as usize] * fx;
    let bottom = map[(y1 * width + x0) as usize] * (1.0 - fx) + map[(y1 * width + x1) as usize] * fx;
    sky.radiance * (top * (1.0 - fy) + bottom * fy).truncate()
}

/// The first emitter whose cumulative probability exceeds `x`.
#[inline]
pub fn pick_emitter(emitters: &[Emitter], count: u32, x: f32) -> u32 {
    let mut low = 0u32;
    let mut high = count - 1;
    while low < high {
        let middle = (low + high) / 2;
        if emitters[middle as usize].cumulative > x {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    low
}

/// Geometric part of light from a small area at `target` with unit normal `target_normal`: cosθ cosθ'/r², 0 behind
/// either.
#[inline]
pub(super) fn coupling(to: Vec3, normal: Vec3, target_normal: Vec3) -> f32 {
    let squared = to.length_squared();
    let here = to.dot(normal);
    let there = -to.dot(target_normal);
    if here > 0.0 && there > 0.0 { here * there / (squared * squared) } else { 0.0 }
}

/// A triangle is near where its middle is no further than this many of its longest edges: by area, the points of it that
/// are next to a place would then be met too seldom, and count too much.
const NEAR_EDGES: f32 = 2.0;

/// A sample of the front of a triangle with these corners: its irradiance over its radiance and over the probability
/// density of the sample, 0 behind either, and the way to it. Uniform in solid angle from near, else in area. `at` is a
/// point of the unit square.
#[inline]
pub(super) fn sample_triangle(
    corner: Vec3,
    edge_a: Vec3,
    edge_b: Vec3,
    (origin, normal): (Vec3, Vec3),
    at: (f32, f32),
) -> (f32, Vec3) {
    let a = corner - origin;
    let area_normal = edge_a.cross(edge_b);
    let twice = area_normal.length();
    let front = area_normal * (1.0 / twice);
    let across = edge_b - edge_a;
    let longest = if edge_a.length_squared() > edge_b.length_squared() { edge_a } else { edge_b };
    let longest = if across.length_squared() > longest.length_squared() { across } else { longest };
    let middle = a + (edge_a + edge_b) * (1.0 / 3.0);
    let height = -a.dot(front);
    if height > 0.0 && middle.length_squared() < NEAR_EDGES * NEAR_EDGES * longest.length_squared() {
        let b = a + edge_a;
        let c = a + edge_b;
        let corners = [a * (1.0 / a.length()), b * (1.0 / b.length()), c * (1.0 / c.length())];
        let (direction, solid_angle) = spherical_triangle(corners, at);
        if solid_angle > 0.0 {
            let facing = -direction.dot(front);
            let cosine = direction.dot(normal);
            if facing <= 0.0 || cosine <= 0.0 {
                return (0.0, middle);
            }
            return (cosine * solid_angle, direction * (height / facing));
        }
    }
    let (u, v) = uniform_triangle(at);
    let to = a + edge_a * u + edge_b * v;
    (coupling(to, normal, front) * (0.5 * twice), to)
}

/// A sample of an emitter: its irradiance over the probability density, W/m², without shadows, and the way to it.
#[inline]
pub(super) fn sample_emitter(
    g: &GeometryTables,
    e: &Emitter,
    at: (f32, f32),
    from: (Vec3, Vec3),
    ray_offset: f32,
) -> (Vec3, Vec3) {
    let t = g.triangles[e.triangle as usize];
    let front = g.normal(e.triangle);
    // Shadow rays end above the emitter.
    let (share, to) = sample_triangle(t.corner + front * ray_offset, t.edge_a, t.edge_b, from, at);
    let mut light = Vec3::ZERO;
    if share > 0.0 {
        let place = from.0 + to - front * ray_offset - t.corner;
        let area_normal = t.edge_a.cross(t.edge_b);
        let inverse = 1.0 / area_normal.length_squared();
        let u = clamp(place.cross(t.edge_b).dot(area_normal) * inverse, 0.0, 1.0);
        let v = clamp(t.edge_a.cross(place).dot(area_normal) * inverse, 0.0, 1.0 - u);
        if !g.is_hole(e.triangle, u, v) {
            light = g.radiance(e.triangle, u, v) * share;
        }
    }
    (light, to)
}

/// A sample of a rectangle, as [`sample_triangle`]: of one of its halves.
#[inline]
pub(super) fn sample_rect(light: &Light, from: (Vec3, Vec3), (u, v): (f32, f32)) -> (f32, Vec3) {
    let is_first = u < 0.5;
    let opposite = light.position + light.edge_a + light.edge_b;
    let corner = if is_first { light.position } else { opposite };
    let sign = if is_first { 1.0 } else { -1.0 };
    let at = (if is_first { 2.0 * u } else { 2.0 * u - 1.0 }, v);
    let (share, to) = sample_triangle(corner, light.edge_a * sign, light.edge_b * sign, from, at);
    (2.0 * share, to)
}

/// Light of a parallel, point or spot light or a luminaire at a point, were nothing in the way: the irradiance is
/// `color · share`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Irradiance over the light's `color`: cosθ, cosθ/r² or that times the spot's falloff or the luminaire's share; 0
    /// behind the surface.
    pub share: f32,
    /// Way to the light, and how far along it something would be in the way.
    pub to_light: Vec3,
    /// Greatest t of the shadow ray.
    pub t_max: f32,
}

impl Arrival {
    /// Length of the way to the light, m.
    #[inline]
    pub fn distance(&self) -> f32 {
        self.to_light.length() * self.t_max
    }
}

/// Light that a source without area sends to a point with this unit normal, without shadows.
#[inline]
pub fn unoccluded(light: &Light, distributions: &[f32], origin: Vec3, normal: Vec3) -> Arrival {
    if light.kind == LIGHT_DIRECTIONAL {
        return Arrival { share: -normal.dot(light.direction), to_light: -light.direction, t_max: FAR };
    }
    let to = light.position - origin;
    let squared = to.length_squared();
    let cosine = to.dot(normal);
    if cosine <= 0.0 || squared <= 0.0 {
        return Arrival { share: 0.0, to_light: to, t_max: 1.0 };
    }
    let inverse = 1.0 / to.length();
    let mut share = cosine * inverse * inverse * inverse;
    if light.kind == LIGHT_SPOT {
        share *= spot_falloff(light, -to.dot(light.direction) * inverse);
    }
    if light.kind == LIGHT_LUMINAIRE {
        share *= luminaire_share(light, distributions, -to);
    }
    Arrival { share, to_light: to, t_max: 1.0 }
}

/// Irradiance from one light over its `color`, without shadow rays for parts behind the surface. `index` numbers the
/// point, `slot` the light.
#[inline]
#[allow(clippy::too_many_arguments)]
fn light_share<M: Medium>(
    p: &DirectParams,
    index: u32,
    slot: u32,
    light: &Light,
    distributions: &[f32],
    (origin, normal): (Vec3, Vec3),
    medium: M,
    mut occluded: impl FnMut(Vec3, Vec3, f32) -> bool,
) -> M::Left {
    if light.kind == LIGHT_RECT {
        let shift = (hash3(index, 2 * slot, p.seed), hash3(index, 2 * slot + 1, p.seed));
        let mut sum = M::Left::NOTHING;
        for k in 0..p.area_rays {
            let (share, to) = sample_rect(light, (origin, normal), hammersley(k, p.area_rays, shift));
            if share > 0.0 && !occluded(origin, to, 1.0) {
                sum += medium.left(to.length()) * share;
            }
        }
        return sum * (1.0 / p.area_rays as f32);
    }
    let arrival = unoccluded(light, distributions, origin, normal);
    if arrival.share > 0.0 && !occluded(origin, arrival.to_light, arrival.t_max) {
        medium.left(arrival.distance()) * arrival.share
    } else {
        M::Left::NOTHING
    }
}

/// Share of a light's `color` that arrives at a point as irradiance: 1 (parallel light), 1/m² (point, spot) or sr
/// (rectangle). It depends on where the light is, not on how bright, so that it can be kept while lights are dimmed and
/// switched.
#[inline]
pub fn irradiance_share(
    p: &DirectParams,
    index: u32,
    slot: u32,
    light: &Light,
    distributions: &[f32],
    point: SurfacePoint,
    occluded: impl FnMut(Vec3, Vec3, f32) -> bool,
) -> f32 {
    let normal = point.normal;
    if normal.dot(normal) < 0.5 {
        return 0.0;
    }
    light_share(p, index, slot, light, distributions, (point.position + normal * p.ray_offset, normal), Air, occluded)
}

/// [`irradiance_share`], and what stopped the last ray that was stopped, 1 added, or 0; `occluder` is that of before:
/// most rays meet it again while a light moves little. `find(origin, direction, t_max, last)` gives what stops a ray,
/// or [`NONE`].
#[allow(clippy::too_many_arguments)]
#[inline]
pub fn share_and_occluder(
    p: &DirectParams,
    index: u32,
    slot: u32,
    light: &Light,
    distributions: &[f32],
    point: SurfacePoint,
    occluder: u32,
    mut find: impl FnMut(Vec3, Vec3, f32, u32) -> u32,
) -> (f32, u32) {
    let mut last = occluder.wrapping_sub(1);
    let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
        let found = find(origin, direction, t_max, last);
        if found != NONE {
            last = found;
        }
        found != NONE
    };
    let share = irradiance_share(p, index, slot, light, distributions, point, stopped);
    (share, last.wrapping_add(1))
}

/// H_d of point `k`, W/m²: the light of emitters and sky there, and of each light its colour times the point's share of
/// it. Shapes: `shares[light_count · count]`, light by light.
#[inline]
pub fn add_lights(k: u32, p: &DirectParams, lights: &[Light], shares: &[f32], surroundings: Vec4) -> Vec4 {
    let mut sum = Vec3::ZERO;
    for slot in 0..p.light_count {
        sum += lights[slot as usize].color * shares[(slot * p.count + k) as usize];
    }
    (sum + surroundings.truncate()).extend(0.0)
}

/// Direct irradiance H_d at a point, W/m², by shadow rays: one to each parallel, point and spot light and to each
/// luminaire, `area_rays` to each rectangle, as many to all emitters together (picked in proportion to their power,
/// uniform on the triangle, from near in solid angle), `sky_rays` cosine-weighted ones to the sky. `occluded(origin, direction, t_max)` tells
/// whether a ray is stopped. Of light of suns and of the sky the medium leaves what it leaves after [`FAR`].
#[inline]
pub fn direct_irradiance(
    g: &GeometryTables,
    p: &DirectParams,
    index: u32,
    point: SurfacePoint,
    lights: &Lights,
    medium: impl Medium,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool + Copy,
) -> Vec3 {
    let normal = point.normal;
    if normal.dot(normal) < 0.5 {
        return Vec3::ZERO;
    }
    let origin = point.position + normal * p.ray_offset;
    let mut sum = Vec3::ZERO;
    for slot in 0..p.light_count {
        let light = &lights.lights[slot as usize];
        let share = light_share(p, index, slot, light, lights.distributions, (origin, normal), medium, occluded);
        sum += share.of(light.color);
    }
    if p.emitter_count > 0 && p.area_rays > 0 {
        let shift = (hash3(index, 0x656d_6974, p.seed), hash3(index, 0x656d_6975, p.seed));
        let mut light = Vec3::ZERO;
        for k in 0..p.area_rays {
            let (x, y) = hammersley(k, p.area_rays, shift);
            let e = lights.emitters[pick_emitter(lights.emitters, p.emitter_count, x) as usize];
            // What is left of x within the entry is uniform again, and stratified.
            let rest = clamp((x - (e.cumulative - e.probability)) / e.probability, 0.0, 1.0);
            let (found, to) = sample_emitter(g, &e, (rest, y), (origin, normal), p.ray_offset);
            if found != Vec3::ZERO && !occluded(origin, to, 1.0) {
                light += medium.left(to.length()).of(found * (1.0 / e.probability));
            }
        }
        sum += light * (1.0 / p.area_rays as f32);
    }
    sum += medium.left(FAR).of(sky_irradiance(p, index, (origin, normal), lights, occluded));
    sum
}

/// Irradiance from the sky at a point, W/m²: by `sky_rays` cosine-weighted rays, 0 without any. `index` numbers the
/// point.
#[inline]
pub fn sky_irradiance(
    p: &DirectParams,
    index: u32,
    (origin, normal): (Vec3, Vec3),
    lights: &Lights,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool,
) -> Vec3 {
    if p.sky_rays == 0 {
        return Vec3::ZERO;
    }
    let shift = (hash3(index, 0x736b_7900, p.seed), hash3(index, 0x736b_7901, p.seed));
    let mut light = Vec3::ZERO;
    for k in 0..p.sky_rays {
        let direction = cosine_hemisphere(normal, hammersley(k, p.sky_rays, shift));
        if !occluded(origin, direction, FAR) {
            light += sky_radiance(&lights.sky, lights.sky_map, direction);
        }
    }
    light * (PI / p.sky_rays as f32)
}

/// Distance to the front of a rectangle light before `t_max`, else [`FAR`].
#[inline]
pub fn meet_rect(light: &Light, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
    if light.kind != LIGHT_RECT {
        return FAR;
    }
    let n = light.edge_a.cross(light.edge_b);
    let facing = direction.dot(n);
    if facing >= 0.0 {
        return FAR;
    }
    let t = (light.position - origin).dot(n) / facing;
    let d = origin + direction * t - light.position;
    // Coordinates along the edges, by Cramer's rule in the plane.
    let aa = light.edge_a.dot(light.edge_a);
    let ab = light.edge_a.dot(light.edge_b);
    let bb = light.edge_b.dot(light.edge_b);
    let da = d.dot(light.edge_a);
    let db = d.dot(light.edge_b);
    let inverse = 1.0 / (aa * bb - ab * ab);
    let uv = Vec2::new((da * bb - db * ab) * inverse, (db * aa - da * ab) * inverse);
    if t > 0.0 && t < t_max && uv.x >= 0.0 && uv.y >= 0.0 && uv.x <= 1.0 && uv.y <= 1.0 { t } else { FAR }
}
