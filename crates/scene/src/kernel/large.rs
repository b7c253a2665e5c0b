//! Direct light of what is large, without noise: the irradiance that rectangles and emissive triangles would send were
//! nothing in the way, exactly, times the share of it that shadow rays of a fixed pattern see, averaged over like
//! pixels (Heitz, Hill and McGuire 2018, "Combining analytic direct illumination and stochastic shadows").

use core::f32::consts::FRAC_1_PI;

use glam::{Vec3, Vec4};

use super::bvh::{FAR, GeometryTables};
use super::camera::primary_direction;
use super::light::{Lights, meet_rect, pick_emitter, sample_emitter, sample_rect, sky_irradiance, unoccluded};
use super::medium::{Medium, Share as _};
use crate::gpu::{
    DirectParams, Emitter, EmitterGroup, Hit, LIGHT_RECT, LargeParams, Light, NONE, ShareParams, SurfacePoint,
};
use crate::math::{abs, atan2, clamp, luminance};
use crate::sampling::{hash3, sobol2_fast, unit};

/// Edge of the squares of pixels whose shadow rays together are one pattern.
pub const TILE: u32 = 4;
/// Emitters up to this many count exactly where nothing is in the way; more by groups.
pub const MAX_EXACT_EMITTERS: u32 = 64;
/// Points of many emitters among which that of a shadow ray is chosen.
const CANDIDATES: u32 = 8;
/// Points of a triangle whose emission is textured.
const TEXTURED_POINTS: u32 = 4;
/// A polygon whose squared extent is below this share of its squared distance is as good as a point: to 10⁻⁴.
const SMALL: f32 = 1e-4;
/// Distance in pixels to the furthest pixels that share visibility; those count half, so that each place of a tile
/// counts the same.
pub const REACH: i32 = 2;
/// Cosine between normals of pixels that share visibility, at least, and their slope out of the surface, at most.
const LIKE_NORMALS: f32 = 0.9;
const MAX_SLOPE: f32 = 0.1;

/// Contribution of one edge of a polygon to the contour sum: its angle times the component of its normal.
#[inline]
fn edge_term(a: Vec3, b: Vec3, normal: Vec3) -> f32 {
    let c = a.cross(b);
    let length = c.length();
    if length > 0.0 { atan2(length, a.dot(b)) * c.dot(normal) / length } else { 0.0 }
}

/// A contour sum while edges are added: the part above the horizon, where the outline last went below, and where it
/// came up.
#[derive(Clone, Copy)]
struct Contour {
    sum: f32,
    down: Vec3,
    up: Vec3,
}

impl Contour {
    const EMPTY: Self = Self { sum: 0.0, down: Vec3::ZERO, up: Vec3::ZERO };

    /// With the edge from `a` to `b`, both seen from the point.
    #[inline]
    fn with(self, a: Vec3, b: Vec3, normal: Vec3) -> Self {
        let above = a.dot(normal);
        let below = b.dot(normal);
        if above > 0.0 && below > 0.0 {
            return Self { sum: self.sum + edge_term(a, b, normal), ..self };
        }
        if above <= 0.0 && below <= 0.0 {
            return self;
        }
        let cut = a + (b - a) * (above / (above - below));
        if above > 0.0 {
            Self { sum: self.sum + edge_term(a, cut, normal), down: cut, up: self.up }
        } else {
            Self { sum: self.sum + edge_term(cut, b, normal), up: cut, down: self.down }
        }
    }

    /// Irradiance of unit radiance: half the sum, closed along the horizon.
    #[inline]
    fn irradiance(self, normal: Vec3) -> f32 {
        let half = 0.5 * abs(self.sum + edge_term(self.down, self.up, normal));
        // A point on the very edge.
        if half < core::f32::consts::PI { half } else { core::f32::consts::PI }
    }
}

/// Irradiance over radiance at `origin` with this unit normal from the front of a triangle with these corners and area
/// normal (`edge_a × edge_b`), or of the parallelogram that has three of its corners there: `½ Σ γ_i Γ_i·n` over the
/// edges of what is above the horizon, with the angle γ_i and the unit normal Γ_i of the plane of each edge and the
/// point (Lambert 1760; Baum, Rushmeier and Winget 1989). 0 behind either; as a point where it is small.
#[inline]
pub fn polygon_irradiance(
    is_triangle: bool,
    corner: Vec3,
    edge_a: Vec3,
    edge_b: Vec3,
    origin: Vec3,
    normal: Vec3,
) -> f32 {
    let a = corner - origin;
    let area_normal = edge_a.cross(edge_b);
    // Twice the height over the plane times the area of the triangle.
    let height = -a.dot(area_normal);
    if height <= 0.0 {
        return 0.0;
    }
    let share = if is_triangle { 1.0 / 3.0 } else { 0.5 };
    let middle = a + (edge_a + edge_b) * share;
    let squared = middle.length_squared();
    if edge_a.length_squared() + edge_b.length_squared() < SMALL * squared {
        let cosine = middle.dot(normal);
        let half = if is_triangle { 0.5 } else { 1.0 };
        return if cosine > 0.0 { half * height * cosine / (squared * squared) } else { 0.0 };
    }
    let b = a + edge_a;
    let c = a + edge_b;
    let mut contour = Contour::EMPTY.with(a, b, normal);
    if is_triangle {
        contour = contour.with(b, c, normal);
    } else {
        let far = b + edge_b;
        contour = contour.with(b, far, normal).with(far, c, normal);
    }
    contour.with(c, a, normal).irradiance(normal)
}

/// Irradiance of a rectangle light at a point, W/m², were nothing in the way.
#[inline]
pub fn rect_irradiance(light: &Light, origin: Vec3, normal: Vec3) -> Vec3 {
    light.color * polygon_irradiance(false, light.position, light.edge_a, light.edge_b, origin, normal)
}

/// Irradiance of an emitter at a point, W/m², were nothing in the way: exact, but where its emission is textured.
#[inline]
fn emitter_irradiance(g: &GeometryTables, p: &LargeParams, e: &Emitter, origin: Vec3, normal: Vec3) -> Vec3 {
    let t = g.triangles[e.triangle as usize];
    let material = g.materials[t.material as usize];
    if material.radiance_texture == NONE && material.mask_texture == NONE {
        return material.radiance * polygon_irradiance(true, t.corner, t.edge_a, t.edge_b, origin, normal);
    }
    let mut sum = Vec3::ZERO;
    for k in 0..TEXTURED_POINTS {
        sum += sample_emitter(g, e, fixed_point(k, 0), (origin, normal), p.ray_offset).0;
    }
    sum * (1.0 / TEXTURED_POINTS as f32)
}

/// Weight of an emitter when rays are shared out: its power, and roughly its orientation to the point; 0 only where no
/// light comes.
#[inline]
fn emitter_weight(g: &GeometryTables, e: &Emitter, origin: Vec3, normal: Vec3) -> f32 {
    let t = g.triangles[e.triangle as usize];
    let a = t.corner - origin;
    let height = -a.dot(t.edge_a.cross(t.edge_b)) / (2.0 * e.area);
    let at_a = a.dot(normal);
    let at_b = (a + t.edge_a).dot(normal);
    let at_c = (a + t.edge_b).dot(normal);
    let most = if at_a > at_b { at_a } else { at_b };
    let most = if most > at_c { most } else { at_c };
    if height <= 0.0 || most <= 0.0 {
        return 0.0;
    }
    let squared = (a + (t.edge_a + t.edge_b) * (1.0 / 3.0)).length_squared() + e.area;
    e.probability * height * most / (squared * squared)
}

/// Point `k` of Sobol's sequence in the unit square, scrambled by what it is for.
#[inline]
pub(super) fn fixed_point(k: u32, slot: u32) -> (f32, f32) {
    let (x, y) = sobol2_fast(k);
    (unit(x ^ hash3(slot, 0x6c61_7267, 0)), unit(y ^ hash3(slot, 0x6c61_7267, 1)))
}

/// Number of a pixel's first sample of a sub-frame: the samples of a pixel in all sub-frames follow each other, and so
/// do those of the pixels of a tile, so that either are a net.
#[inline]
pub(super) fn first_sample(p: &LargeParams, index: u32) -> u32 {
    let x = index % p.camera.width;
    let y = index / p.camera.width;
    let mixed = x ^ y;
    let place = (mixed & 1) << 3 | (y & 1) << 2 | (mixed >> 1 & 1) << 1 | (y >> 1 & 1);
    place * p.stride + p.first_sample
}

/// Share of irradiance that a pixel shows as radiance, ρ/π: 0 for the sky and behind a rectangle light.
#[inline]
fn reflection(lights: &Lights, p: &LargeParams, index: u32, hit: Hit, albedo: Vec4) -> Vec3 {
    if hit.triangle == NONE {
        return Vec3::ZERO;
    }
    let direction = primary_direction(&p.camera, index, p.sub_frame);
    for k in 0..p.light_count {
        if meet_rect(&lights.lights[k as usize], p.camera.eye, direction, hit.t) < FAR {
            return Vec3::ZERO;
        }
    }
    albedo.truncate() * FRAC_1_PI
}

/// Irradiance of a group of emitters at a point, W/m², were nothing in the way.
#[inline]
pub fn group_irradiance(group: &EmitterGroup, origin: Vec3, normal: Vec3) -> Vec3 {
    let to = group.centre - origin;
    let squared = to.length_squared();
    let cosine = to.dot(normal);
    if cosine <= 0.0 || squared <= 0.0 {
        return Vec3::ZERO;
    }
    let inverse = 1.0 / to.length();
    let away = to * -inverse;
    let along = group.normal.dot(away);
    let power = if group.is_flat != 0 {
        along
    } else {
        let squares = group.squares_x * away.x * away.x
            + group.squares_yz.x * away.y * away.y
            + group.squares_yz.y * away.z * away.z;
        let products = group.products.x * away.x * away.y
            + group.products.y * away.y * away.z
            + group.products.z * away.z * away.x;
        (3.0 / 32.0) * group.power + 0.5 * along + (15.0 / 32.0) * (squares + 2.0 * products)
    };
    if power > 0.0 { group.color * (power * cosine * inverse / squared) } else { Vec3::ZERO }
}

/// Sum of a pixel's radiance from all rectangles and emitters after one more sub-frame, W/m²/sr, were nothing in the
/// way.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn add_open_light(
    g: &GeometryTables,
    lights: &Lights,
    groups: &[EmitterGroup],
    p: &LargeParams,
    index: u32,
    hit: Hit,
    albedo: Vec4,
    point: SurfacePoint,
    sum: Vec4,
) -> Vec4 {
    let factor = reflection(lights, p, index, hit, albedo);
    let normal = point.normal;
    let origin = point.position + normal * p.ray_offset;
    let mut light = Vec3::ZERO;
    for slot in 0..p.light_count {
        if lights.lights[slot as usize].kind == LIGHT_RECT {
            light += rect_irradiance(&lights.lights[slot as usize], origin, normal);
        }
    }
    if p.group_count == 0 {
        for k in 0..p.emitter_count {
            light += emitter_irradiance(g, p, &lights.emitters[k as usize], origin, normal);
        }
    }
    for k in 0..p.group_count {
        light += group_irradiance(&groups[k as usize], origin, normal);
    }
    sum + (factor * light).extend(1.0)
}

/// Light of the samples of a rectangle: what is neither stopped nor absorbed, and all.
#[inline]
fn rect_samples<M: Medium>(
    p: &LargeParams,
    first: u32,
    slot: u32,
    light: &Light,
    from: (Vec3, Vec3),
    medium: M,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool,
) -> (Vec3, Vec3) {
    let mut seen = M::Left::NOTHING;
    let mut all = 0.0;
    for k in 0..p.rays {
        let (share, to) = sample_rect(light, from, fixed_point(first + k, 2 + slot));
        if share > 0.0 {
            all += share;
            if !occluded(from.0, to, 1.0) {
                seen += medium.left(to.length()) * share;
            }
        }
    }
    (seen.of(light.color), light.color * all)
}

/// The emitter to which `x` of the unit interval falls when they share it by weight, what of it is left of x, uniform,
/// and its probability.
#[inline]
fn emitter_at(
    g: &GeometryTables,
    p: &LargeParams,
    lights: &Lights,
    x: f32,
    total: f32,
    from: (Vec3, Vec3),
) -> (u32, f32, f32) {
    let wanted = x * total;
    let mut sum = 0.0;
    let mut k = 0;
    let mut weight = 0.0;
    for j in 0..p.emitter_count {
        if sum <= wanted {
            let own = emitter_weight(g, &lights.emitters[j as usize], from.0, from.1);
            if own > 0.0 {
                k = j;
                weight = own;
            }
            sum += own;
        }
    }
    (k, clamp((wanted - (sum - weight)) / weight, 0.0, 1.0), weight / total)
}

/// Light of the samples of few emitters: what is neither stopped nor absorbed, and all.
#[inline]
fn emitter_samples(
    g: &GeometryTables,
    p: &LargeParams,
    first: u32,
    lights: &Lights,
    from: (Vec3, Vec3),
    medium: impl Medium,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool,
) -> (Vec3, Vec3) {
    let mut total = 0.0;
    for k in 0..p.emitter_count {
        total += emitter_weight(g, &lights.emitters[k as usize], from.0, from.1);
    }
    let mut seen = Vec3::ZERO;
    let mut all = Vec3::ZERO;
    if total > 0.0 {
        for k in 0..p.rays {
            let (x, y) = fixed_point(first + k, 1);
            let (chosen, rest, probability) = emitter_at(g, p, lights, x, total, from);
            let e = lights.emitters[chosen as usize];
            let (found, to) = sample_emitter(g, &e, (rest, y), from, p.ray_offset);
            let light = found * (1.0 / probability);
            if luminance(light) > 0.0 {
                all += light;
                if !occluded(from.0, to, 1.0) {
                    seen += medium.left(to.length()).of(light);
                }
            }
        }
    }
    (seen, all)
}

/// Light of candidate `k`, a point of any emitter by power, and the way to it.
#[inline]
fn candidate(g: &GeometryTables, p: &LargeParams, k: u32, lights: &Lights, from: (Vec3, Vec3)) -> (Vec3, Vec3) {
    let (x, y) = fixed_point(k, 1);
    let e = lights.emitters[pick_emitter(lights.emitters, p.emitter_count, x) as usize];
    let rest = clamp((x - (e.cumulative - e.probability)) / e.probability, 0.0, 1.0);
    let (found, to) = sample_emitter(g, &e, (rest, y), from, p.ray_offset);
    (found * (1.0 / e.probability), to)
}

/// Light of the samples of many emitters: each ray goes to one of some candidates, chosen by their light, and stands
/// for all of them (resampled importance sampling, Talbot, Cline and Egbert 2005).
#[inline]
fn many_emitter_samples(
    g: &GeometryTables,
    p: &LargeParams,
    first: u32,
    lights: &Lights,
    from: (Vec3, Vec3),
    medium: impl Medium,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool,
) -> (Vec3, Vec3) {
    let mut seen = Vec3::ZERO;
    let mut all = Vec3::ZERO;
    for ray in first..first + p.rays {
        let mut sum = Vec3::ZERO;
        let mut total = 0.0;
        let mut to = Vec3::ZERO;
        let mut x = fixed_point(ray, 0).0;
        for k in 0..CANDIDATES {
            let found = candidate(g, p, ray * CANDIDATES + k, lights, from);
            let own = luminance(found.0);
            if own > 0.0 {
                sum += found.0;
                total += own;
                // What is left of x is uniform again.
                let share = own / total;
                if x < share {
                    to = found.1;
                    x /= share;
                } else {
                    x = (x - share) / (1.0 - share);
                }
            }
        }
        if total > 0.0 {
            all += sum;
            if !occluded(from.0, to, 1.0) {
                seen += medium.left(to.length()).of(sum);
            }
        }
    }
    (seen * (1.0 / CANDIDATES as f32), all * (1.0 / CANDIDATES as f32))
}

/// Sums of a pixel's radiance from samples of all rectangles and emitters after one more sub-frame, W/m²/sr: of those
/// that the pixel sees, as far as the medium leaves it, and of all. Their ratio is the share of the light that arrives.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn add_seen_light(
    g: &GeometryTables,
    lights: &Lights,
    p: &LargeParams,
    index: u32,
    hit: Hit,
    albedo: Vec4,
    point: SurfacePoint,
    sums: (Vec4, Vec4),
    medium: impl Medium,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool + Copy,
) -> (Vec4, Vec4) {
    let factor = reflection(lights, p, index, hit, albedo) * (1.0 / p.rays as f32);
    if luminance(factor) <= 0.0 {
        return sums;
    }
    let from = (point.position + point.normal * p.ray_offset, point.normal);
    let first = first_sample(p, index);
    let mut seen = Vec3::ZERO;
    let mut all = Vec3::ZERO;
    for slot in 0..p.light_count {
        if lights.lights[slot as usize].kind == LIGHT_RECT {
            let found = rect_samples(p, first, slot, &lights.lights[slot as usize], from, medium, occluded);
            seen += found.0;
            all += found.1;
        }
    }
    if p.emitter_count > 0 {
        let found = if p.emitter_count > MAX_EXACT_EMITTERS {
            many_emitter_samples(g, p, first, lights, from, medium, occluded)
        } else {
            emitter_samples(g, p, first, lights, from, medium, occluded)
        };
        seen += found.0;
        all += found.1;
    }
    (sums.0 + (factor * seen).extend(0.0), sums.1 + (factor * all).extend(0.0))
}

/// Irradiance at point `index`, W/m²: from parallel, point and spot lights and luminaires by a shadow ray each, and
/// what the sky sends. Where no receiver tells the latter (`sky.w` is 0: there is hardly anything but sky to be seen),
/// `sky_rays` rays do. What receivers tell is what the medium has left.
#[inline]
pub fn sharp_irradiance(
    p: &DirectParams,
    index: u32,
    point: SurfacePoint,
    lights: &Lights,
    sky: Vec4,
    medium: impl Medium,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool + Copy,
) -> Vec3 {
    let normal = point.normal;
    if normal.dot(normal) < 0.5 {
        return Vec3::ZERO;
    }
    let origin = point.position + normal * p.ray_offset;
    let mut sum = sky.truncate();
    if sky.w == 0.0 {
        sum = medium.left(FAR).of(sky_irradiance(p, index, (origin, normal), lights, occluded));
    }
    for slot in 0..p.light_count {
        let light = lights.lights[slot as usize];
        if light.kind != LIGHT_RECT {
            let arrival = unoccluded(&light, lights.distributions, origin, normal);
            if arrival.share > 0.0 && !occluded(origin, arrival.to_light, arrival.t_max) {
                sum += (medium.left(arrival.distance()) * arrival.share).of(light.color);
            }
        }
    }
    sum
}

/// Share of the samples' light that a pixel sees, grey; below 0 without samples.
#[inline]
fn grey_share(seen: Vec4, all: Vec4) -> f32 {
    let all = luminance(all.truncate());
    if all > 0.0 { luminance(seen.truncate()) / all } else { -1.0 }
}

/// Returns true for pixels of one even surface.
#[inline]
fn are_alike(here: &SurfacePoint, there: &SurfacePoint) -> bool {
    let way = there.position - here.position;
    let slope = abs(way.dot(here.normal));
    there.normal.dot(here.normal) >= LIKE_NORMALS && slope * slope <= MAX_SLOPE * MAX_SLOPE * way.length_squared()
}

/// Share of light at pixel `at` of the tables where it is on the surface of `here` and has samples, else below 0.
#[inline]
fn share_alike(here: &SurfacePoint, points: &[SurfacePoint], seen: &[Vec4], all: &[Vec4], at: u32) -> f32 {
    let at = at as usize;
    if are_alike(here, &points[at]) { grey_share(seen[at], all[at]) } else { -1.0 }
}

/// Most by which the share of light bends from a pixel to those a tile further on both sides of it, `before` and
/// `after`; the change to one side where there is no other, -1 where there is none.
#[inline]
fn bend(before: f32, own: f32, after: f32) -> f32 {
    if before >= 0.0 && after >= 0.0 {
        abs(before + after - 2.0 * own)
    } else if before >= 0.0 {
        abs(before - own)
    } else if after >= 0.0 {
        abs(after - own)
    } else {
        -1.0
    }
}

/// 1 where the share of light that arrives is even, or changes evenly, about pixel `index`, else 0. It is compared with
/// that of the pixels a tile further on the same surface, whose samples are the same: unlike differences between
/// neighbours, theirs have no noise. Shapes: all tables `[count_about]`, from pixel `first_about` on; they hold all
/// pixels of the picture up to [`TILE`] columns and rows away.
#[inline]
pub fn steadiness(p: &ShareParams, index: u32, points: &[SurfacePoint], seen: &[Vec4], all: &[Vec4]) -> f32 {
    let i = index - p.first_about;
    let own = grey_share(seen[i as usize], all[i as usize]);
    if own < 0.0 {
        return 0.0;
    }
    let here = points[i as usize];
    let x = index % p.width;
    let y = index / p.width;
    let down = TILE * p.width;
    let left = if x >= TILE { share_alike(&here, points, seen, all, i - TILE) } else { -1.0 };
    let right = if x + TILE < p.width { share_alike(&here, points, seen, all, i + TILE) } else { -1.0 };
    let above = if y >= TILE { share_alike(&here, points, seen, all, i - down) } else { -1.0 };
    let below = if y + TILE < p.height { share_alike(&here, points, seen, all, i + down) } else { -1.0 };
    let across = bend(left, own, right);
    let along = bend(above, own, below);
    let is_compared = across >= 0.0 || along >= 0.0;
    if is_compared && across <= p.bend && along <= p.bend { 1.0 } else { 0.0 }
}

/// Radiance of pixel `index` from rectangles and emitters, W/m²/sr: what `open` says times the share that samples see,
/// its mean over pixels about on the same surface that see a like share, or about which the share is steady
/// ([`steadiness`], the last number of `open`). Shapes: all tables `[count_about]`, from pixel `first_about` on; they
/// hold all pixels of the picture up to [`REACH`] columns and rows away.
#[inline]
pub fn shadowed_light(
    p: &ShareParams,
    index: u32,
    points: &[SurfacePoint],
    open: &[Vec4],
    seen: &[Vec4],
    all: &[Vec4],
) -> Vec3 {
    let i = (index - p.first_about) as usize;
    let at_pixel = open[i];
    if at_pixel.x <= 0.0 && at_pixel.y <= 0.0 && at_pixel.z <= 0.0 {
        // No light to share out, as in most pixels under the sky.
        return Vec3::ZERO;
    }
    let here = points[i];
    let own = grey_share(seen[i], all[i]);
    let x = (index % p.width) as i32;
    let y = (index / p.width) as i32;
    let mut seen_sum = Vec3::ZERO;
    let mut all_sum = Vec3::ZERO;
    for step in 0..(2 * REACH + 1) * (2 * REACH + 1) {
        let dx = step % (2 * REACH + 1) - REACH;
        let dy = step / (2 * REACH + 1) - REACH;
        let at_x = x + dx;
        let at_y = y + dy;
        if at_x >= 0 && at_y >= 0 && at_x < p.width as i32 && at_y < p.height as i32 {
            let j = (at_y as u32 * p.width + at_x as u32 - p.first_about) as usize;
            let share = if luminance(open[j].truncate()) > 0.0 { grey_share(seen[j], all[j]) } else { -1.0 };
            // Its own place may be another surface's: the last sub-frame's.
            let is_own = dx == 0 && dy == 0;
            let is_steady = at_pixel.w > 0.5 && open[j].w > 0.5;
            let is_like = share >= 0.0
                && (own < 0.0 || is_steady || abs(share - own) <= p.tolerance)
                && are_alike(&here, &points[j]);
            if is_like || is_own && share >= 0.0 {
                let half_x = if dx == REACH || dx == -REACH { 0.5 } else { 1.0 };
                let half_y = if dy == REACH || dy == -REACH { 0.5 } else { 1.0 };
                let weight = half_x * half_y / luminance(open[j].truncate());
                seen_sum += seen[j].truncate() * weight;
                all_sum += all[j].truncate() * weight;
            }
        }
    }
    let share = |seen: f32, all: f32| if all > 0.0 { seen / all } else { 0.0 };
    Vec3::new(
        at_pixel.x * share(seen_sum.x, all_sum.x),
        at_pixel.y * share(seen_sum.y, all_sum.y),
        at_pixel.z * share(seen_sum.z, all_sum.z),
    )
}
