//! Many emissive triangles as few groups, for light of them where nothing is in the way.

use alloc::vec;
use alloc::vec::Vec;

use glam::{Mat3, Vec3};

use super::lighting::mean_radiance;
use crate::gpu::{Emitter, EmitterGroup};
use crate::kernel::GeometryTables;
use crate::kernel::large::MAX_EXACT_EMITTERS;
use crate::math::luminance;

/// Most groups.
pub const MAX_EMITTER_GROUPS: usize = 64;
/// A group whose normals add up to this share of their lengths is flat.
const FLAT: f32 = 0.999;

/// A part of a group.
struct Part {
    centre: Vec3,
    normal: Vec3,
    area: f32,
    radiance: Vec3,
}

/// Groups of near emitters, where these are too many to count one by one; none where they are not. The group with the
/// greatest power times squared extent is cut at the middle of its longest side, again and again.
pub(super) fn group_emitters(tables: &GeometryTables, emitters: &[Emitter]) -> Vec<EmitterGroup> {
    if emitters.len() <= MAX_EXACT_EMITTERS as usize {
        return Vec::new();
    }
    let parts: Vec<Part> = emitters.iter().map(|emitter| part(tables, emitter)).collect();
    let mut groups: Vec<Vec<usize>> = vec![(0..parts.len()).collect()];
    while groups.len() < MAX_EMITTER_GROUPS {
        let scores = groups.iter().map(|group| score(&parts, group));
        let Some((worst, score)) = scores.enumerate().max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0))) else {
            break;
        };
        if score <= 0.0 {
            break;
        }
        let mut near = groups.swap_remove(worst);
        let axis = longest_axis(&parts, &near);
        near.sort_by(|&a, &b| parts[a].centre[axis].total_cmp(&parts[b].centre[axis]).then(a.cmp(&b)));
        let middle = 0.5 * (parts[near[0]].centre[axis] + parts[near[near.len() - 1]].centre[axis]);
        let cut = near.partition_point(|&k| parts[k].centre[axis] <= middle).clamp(1, near.len() - 1);
        let far = near.split_off(cut);
        groups.extend([near, far]);
    }
    groups.iter().map(|group| moments(&parts, group)).collect()
}

fn part(tables: &GeometryTables, emitter: &Emitter) -> Part {
    Part {
        centre: tables.position(emitter.triangle, 1.0 / 3.0, 1.0 / 3.0),
        normal: tables.normal(emitter.triangle),
        area: emitter.area,
        radiance: mean_radiance(tables, emitter.triangle),
    }
}

fn extent(parts: &[Part], group: &[usize]) -> Vec3 {
    let centres = group.iter().map(|&k| parts[k].centre);
    let low = centres.clone().reduce(Vec3::min).unwrap_or_default();
    centres.reduce(Vec3::max).unwrap_or_default() - low
}

fn longest_axis(parts: &[Part], group: &[usize]) -> usize {
    extent(parts, group).max_position()
}

fn score(parts: &[Part], group: &[usize]) -> f32 {
    let power: f32 = group.iter().map(|&k| parts[k].area * luminance(parts[k].radiance)).sum();
    power * extent(parts, group).length_squared()
}

fn moments(parts: &[Part], group: &[usize]) -> EmitterGroup {
    let mut power = 0.0;
    let mut color = Vec3::ZERO;
    let mut centre = Vec3::ZERO;
    let mut normal = Vec3::ZERO;
    let mut second = Mat3::ZERO;
    for part in group.iter().map(|&k| &parts[k]) {
        let own = part.area * luminance(part.radiance);
        power += own;
        color += part.radiance * part.area;
        centre += part.centre * own;
        normal += part.normal * own;
        let n = part.normal;
        second += Mat3::from_cols(n * n.x, n * n.y, n * n.z) * own;
    }
    EmitterGroup {
        centre: centre / power,
        power,
        color: color / power,
        is_flat: u32::from(normal.length() >= FLAT * power),
        normal,
        squares_x: second.x_axis.x,
        squares_yz: Vec3::new(second.y_axis.y, second.z_axis.z, 0.0),
        reserved: 0,
        products: Vec3::new(second.x_axis.y, second.y_axis.z, second.z_axis.x),
        reserved_b: 0,
    }
}
