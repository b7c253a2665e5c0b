//! Irradiance in the air: interpolation between the probes of a regular grid, of ambient cubes or spherical harmonics.

use core::f32::consts::PI;

use glam::{UVec3, Vec3, Vec4};
use scene::math::{abs, floor};

use crate::types::{EMPTY_CELL, VolumeParams};

/// Receivers of a probe: its normals are +x, −x, +y, −y, +z, −z.
pub const CUBE_SIDES: u32 = 6;
/// Coefficients of a probe: Y_00 and those of x, y and z.
pub const SH_COEFFICIENTS: u32 = 4;
/// Directions of a probe, those to the 26 voxels round it; direction (i, j, k) from −1 on has number
/// (i + 1) + 3 (j + 1) + 9 (k + 1), and number 13 is not used.
pub const DIRECTIONS: u32 = 27;
/// Words of a probe in the table of planes.
pub const PLANE_WORDS: u32 = 3 * DIRECTIONS;

/// Y_00 = √(1/4π).
const Y0: f32 = 0.282_094_8;
/// The x, y, z of unit directions times this are the functions Y_1m = √(3/4π) (x, y, z).
const Y1: f32 = 0.488_602_52;
/// The cosine lobe's part of degree 0: A_0 = π.
const A0: f32 = PI;
/// The cosine lobe's part of degree 1: A_1 = 2π/3.
const A1: f32 = 2.0 * PI / 3.0;

/// The weight of a probe falls over this last share of the way to the nearest plane,
const FADE: f32 = 0.25;
/// to this part, which a point on the plane still has: it may stand in the corner of a room.
const NEAR_WALL: f32 = 0.05;
/// Tolerance within which a point counts as on a plane, relative to its distance.
const ROUNDING: f32 = 1e-5;
/// Weight of a hidden probe that is in front of all planes of its quadrant; else times the fourth power of their share.
const HIDDEN: f32 = 1e-12;
/// Weight of any probe, so that there is always a mean.
const MIN: f32 = 1e-18;
/// Eight hidden probes weigh no more.
const NOTHING_SEEN: f32 = 1e-11;

/// Irradiance at a point `x` with unit normal `n`, W/m², from ambient cubes: the mean of
/// `E(n) = Σ_a n_a² cube[a, sign n_a]` over the eight probes round x, trilinear, without those that x does not see.
///
/// The squares sum to 1, so equal sides give that value for every n (McTaggart 2004, "Half-Life 2 / Valve Source
/// Shading"). Which probes count: see [`probe_weight`]; where x sees none of the eight, the 64 round it are taken. As
/// weights sum to 1 after the division, a constant in gives the same constant out; where all eight probes count fully,
/// a field that is linear in space is reproduced.
///
/// Shapes: `probes` one word a voxel, the number of its probe or [`EMPTY_CELL`] with that of the nearest one;
/// `planes[81 · probes]`; `cubes[6 · probes]` in the order of the receivers. Needs at least one probe.
#[inline]
pub fn volume_lookup(p: &VolumeParams, probes: &[u32], planes: &[f32], cubes: &[Vec4], x: Vec3, n: Vec3) -> Vec4 {
    let square = n * n / n.dot(n);
    let side_x = if n.x < 0.0 { 1 } else { 0 };
    let side_y = if n.y < 0.0 { 3 } else { 2 };
    let side_z = if n.z < 0.0 { 5 } else { 4 };
    interpolate(p, probes, planes, x, n, |probe| {
        let first = probe * CUBE_SIDES;
        cubes[(first + side_x) as usize] * square.x
            + cubes[(first + side_y) as usize] * square.y
            + cubes[(first + side_z) as usize] * square.z
    })
}

/// Irradiance at a point `x` with unit normal `n`, W/m², from spherical harmonics of degree 1 of the radiance:
/// `E(n) = max(0, A_0 Y_00 L_00 + A_1 Σ_a Y_1a(n) L_1a)` with `Y_00 = √(1/4π)`, `Y_1a(n) = √(3/4π) n_a`, `A_0 = π`,
/// `A_1 = 2π/3` (Ramamoorthi and Hanrahan 2001), and the mean over the probes as in [`volume_lookup`].
///
/// Shapes: `harmonics[4 · probes]`, L_00 and L_1x, L_1y, L_1z of each ([`cube_to_harmonic`]); the rest as in
/// [`volume_lookup`].
#[inline]
pub fn volume_lookup_sh(
    p: &VolumeParams,
    probes: &[u32],
    planes: &[f32],
    harmonics: &[Vec4],
    x: Vec3,
    n: Vec3,
) -> Vec4 {
    let sum = interpolate(p, probes, planes, x, n, |probe| {
        let k = (probe * SH_COEFFICIENTS) as usize;
        harmonics[k] * (A0 * Y0)
            + (harmonics[k + 1] * n.x + harmonics[k + 2] * n.y + harmonics[k + 3] * n.z) * (A1 * Y1)
    });
    sum.max(Vec4::ZERO)
}

/// Coefficient `k` of the radiance at a probe, W/m²/sr, from its ambient cube: `L_00 = (Σ E) / (6 A_0 Y_00)`,
/// `L_1a = (E_+a − E_−a) / (2 A_1 √(3/4π))`.
///
/// The cosine lobe has no other odd part than that of degree 1, so the L_1a are exact; and the six directions know
/// nothing of degree 2, so L_00 is wrong by parts of degree 4 and more only.
#[inline]
pub fn cube_to_harmonic(cubes: &[Vec4], probe: u32, k: u32) -> Vec4 {
    let first = (probe * CUBE_SIDES) as usize;
    if k == 0 {
        let sum =
            cubes[first] + cubes[first + 1] + cubes[first + 2] + cubes[first + 3] + cubes[first + 4] + cubes[first + 5];
        return sum * (1.0 / (6.0 * A0 * Y0));
    }
    let side = first + 2 * (k as usize - 1);
    (cubes[side] - cubes[side + 1]) * (1.0 / (2.0 * A1 * Y1))
}

/// Mean of `value(probe)` over the eight probes round x; where x sees none of them, over the 64 round it by distance.
#[inline]
fn interpolate(
    p: &VolumeParams,
    probes: &[u32],
    planes: &[f32],
    x: Vec3,
    n: Vec3,
    value: impl Fn(u32) -> Vec4,
) -> Vec4 {
    let counts = Vec3::new(p.shape.count_x as f32, p.shape.count_y as f32, p.shape.count_z as f32);
    let place = p.shape.in_voxels(x) - 0.5;
    let place =
        Vec3::new(clamp_place(place.x, counts.x), clamp_place(place.y, counts.y), clamp_place(place.z, counts.z));
    let low = Vec3::new(floor(place.x), floor(place.y), floor(place.z));
    let share = place - low;
    let eye = p.shape.in_voxels(x + n * p.lift) - 0.5;
    let mut sum = Vec4::ZERO;
    let mut total = 0.0;
    for corner in 0..8u32 {
        let step = Vec3::new((corner & 1) as f32, (corner >> 1 & 1) as f32, (corner >> 2) as f32);
        let c = low + step;
        let probe = probe_at(p, probes, counts, c);
        if probe & EMPTY_CELL == 0 {
            let t = (Vec3::ONE - step) * (Vec3::ONE - share) + step * share;
            let weight = probe_weight(p, planes, probe, eye - c, t.x * t.y * t.z);
            sum += value(probe) * weight;
            total += weight;
        }
    }
    if total > NOTHING_SEEN {
        return sum * (1.0 / total);
    }
    // As in the corner of a room between probes that all stand outside.
    for corner in 0..64u32 {
        let c = low - 1.0 + Vec3::new((corner & 3) as f32, (corner >> 2 & 3) as f32, (corner >> 4) as f32);
        let probe = probe_at(p, probes, counts, c);
        if probe & EMPTY_CELL == 0 {
            let q = eye - c;
            let near = 1.0 / (1.0 + q.dot(q));
            let weight = probe_weight(p, planes, probe, q, near * near);
            sum += value(probe) * weight;
            total += weight;
        }
    }
    if total > 0.0 {
        return sum * (1.0 / total);
    }
    value(probes[p.shape.voxel_at(p.shape.nearest_coordinates(x)) as usize] & !EMPTY_CELL)
}

/// The probe of the voxel at these coordinates, [`EMPTY_CELL`] outside of the grid.
#[inline]
fn probe_at(p: &VolumeParams, probes: &[u32], counts: Vec3, c: Vec3) -> u32 {
    let inside = c.x >= 0.0 && c.y >= 0.0 && c.z >= 0.0 && c.x < counts.x && c.y < counts.y && c.z < counts.z;
    if !inside {
        return EMPTY_CELL;
    }
    probes[p.shape.voxel_at(UVec3::new(c.x as u32, c.y as u32, c.z as u32)) as usize]
}

/// Weight of a probe for a point that looks from `q`, in voxels from the probe on, with the trilinear weight
/// `trilinear`.
///
/// Rays to the 26 voxels round the probe met surfaces; `g·q = 1` on the plane of each. The four of the quadrant of the
/// cube in which q lies decide: with `s = max g·q`, the way to the nearest of the planes, the weight is `trilinear ·
/// clamp((1 − s)/¼, 0.05, 1)`, and nothing behind any of them. In a convex room these planes are the walls, whatever
/// their direction; where a surface ends within the quadrant its plane hides a little too much. What is smaller than
/// the distance between the rays may be missed. So that there is always a mean, a hidden probe keeps 10⁻¹² times the
/// fourth power of the share of the planes that it has q in front of.
///
/// Shapes: `planes[81 · probes]`, g of each direction as x, y, z. Needs `probe` below the number of probes.
#[inline]
pub fn probe_weight(p: &VolumeParams, planes: &[f32], probe: u32, q: Vec3, trilinear: f32) -> f32 {
    let any = trilinear + 1e-3;
    if p.walls == 0 {
        return trilinear + MIN * any;
    }
    let x = abs(q.x);
    let y = abs(q.y);
    let z = abs(q.z);
    let toward_x = if q.x < 0.0 { 12 } else { 14 };
    let toward_y = if q.y < 0.0 { 10 } else { 16 };
    let toward_z = if q.z < 0.0 { 4 } else { 22 };
    // Numbers of the directions: of the axis that leads, with the second, with the third, with both.
    let is_x = x >= y && x >= z;
    let is_y = !is_x && y >= z;
    let lead = if is_x {
        toward_x
    } else if is_y {
        toward_y
    } else {
        toward_z
    };
    let second = if is_x { toward_y } else { toward_x };
    let third = if is_x || is_y { toward_z } else { toward_y };
    let length = if is_x {
        x
    } else if is_y {
        y
    } else {
        z
    };
    let inverse = if length > 0.0 { 1.0 / length } else { 0.0 };
    let u = (if is_x { y } else { x }) * inverse;
    let v = (if is_x || is_y { z } else { y }) * inverse;
    // The middle is number 13, counted in each of the others.
    let a = plane_at(planes, probe, lead, q);
    let b = plane_at(planes, probe, lead + second - 13, q);
    let c = plane_at(planes, probe, lead + third - 13, q);
    let d = plane_at(planes, probe, lead + second + third - 26, q);
    let mut s = if a > b { a } else { b };
    s = if c > s { c } else { s };
    s = if d > s { d } else { s };
    let free = (1.0 - s) * (1.0 / FADE);
    let seen = if free > 1.0 {
        1.0
    } else if free > NEAR_WALL {
        free
    } else if s < 1.0 + ROUNDING {
        NEAR_WALL
    } else {
        0.0
    };
    let share = in_front(a) * (1.0 - u) * (1.0 - v)
        + in_front(b) * u * (1.0 - v)
        + in_front(c) * (1.0 - u) * v
        + in_front(d) * u * v;
    let square = share * share;
    trilinear * seen + (HIDDEN * square * square + MIN) * any
}

#[inline]
fn in_front(s: f32) -> f32 {
    if s < 1.0 + ROUNDING { 1.0 } else { 0.0 }
}

/// `g·q` for the plane that a direction's ray met; 0 where it met nothing.
#[inline]
fn plane_at(planes: &[f32], probe: u32, direction: u32, q: Vec3) -> f32 {
    let k = (probe * PLANE_WORDS + 3 * direction) as usize;
    planes[k] * q.x + planes[k + 1] * q.y + planes[k + 2] * q.z
}

/// The place between the first and the last probe.
#[inline]
fn clamp_place(place: f32, count: f32) -> f32 {
    let last = count - 1.0;
    if place < last {
        if place > 0.0 { place } else { 0.0 }
    } else if place >= last {
        last
    } else {
        0.0
    }
}
