//! Values between patches: the mean of the patches round a point.

use glam::{UVec3, Vec3, Vec4};
use scene::math::{abs, floor};

use crate::types::{EMPTY_CELL, LookupParams, LookupPatch, RULE_WALLS};

/// Weight of a patch that faces the point but lies off its plane or behind a wall, against one that does not: such
/// patches count only where there are no others.
const HIDDEN: f32 = 1e-6;
/// Weight of a patch that looks away, likewise.
const FACING_AWAY: f32 = 1e-12;
/// A patch whose normal has a smaller cosine than this with the point's normal may be a wall.
const WALL_COSINE: f32 = 0.5;
/// So far behind a wall something must lie to be hidden by it, in voxels.
const WALL_DEPTH: f32 = 1e-4;

/// The value at a surface point `x` with unit normal `n`, as `Σ w h / Σ w` over the patches of the 2×2×2 voxels round x
/// shifted by half a voxel along n [T 5.3], so that the voxel that holds x is always one of them.
///
/// `w = trilinear · max(0, n·n_j)² · (1 − (d/limit)²)²` with `d = |(c_j − x)·n|`, the distance of the patch from the
/// point's plane in voxels, so that floors above and below do not count. With [`RULE_WALLS`], neither do patches behind
/// a patch that stands across (`|n·n_w| < ½`), has x in front of it, and lies in the voxel of x or of the patch. Both,
/// and patches that look away, keep 10⁻⁶ and 10⁻¹² of the weight, so that they count where there is nothing else; where
/// all eight voxels are empty the patches of the nearest voxel are taken. As the weights sum to 1 after the division, a
/// constant in gives the same constant out.
///
/// Shapes: `cells` one word a voxel, the place of its patches or [`EMPTY_CELL`] with the place of the nearest ones;
/// `offsets` one a voxel with patches and one more; `entries[offsets.last()]`; `values` one a patch. Needs at least one
/// voxel with patches.
#[inline]
pub fn lookup(
    p: &LookupParams,
    cells: &[u32],
    offsets: &[u32],
    entries: &[LookupPatch],
    values: &[Vec4],
    x: Vec3,
    n: Vec3,
) -> Vec4 {
    let place = p.shape.in_voxels(x) + n * 0.5 - 0.5;
    let low = Vec3::new(floor(place.x), floor(place.y), floor(place.z));
    let share = place - low;
    let own = cells[(p.first_cell + p.shape.voxel_at(p.shape.nearest_coordinates(x))) as usize];
    let mut sum = Vec4::ZERO;
    let mut total = 0.0;
    for corner in 0..8u32 {
        let step = corner_step(corner);
        let cell = cell_at(p, cells, low + step);
        if cell & EMPTY_CELL == 0 {
            let trilinear = trilinear_weight(step, share);
            for k in offsets[cell as usize]..offsets[cell as usize + 1] {
                let entry = entries[k as usize];
                let mut visibility = plane_visibility(p, &entry, x, n);
                if visibility > 0.0 && p.rule == RULE_WALLS {
                    let hidden = is_behind_wall(p, offsets, entries, cell, &entry, x, n)
                        || (own != cell
                            && own & EMPTY_CELL == 0
                            && is_behind_wall(p, offsets, entries, own, &entry, x, n));
                    visibility = if hidden { 0.0 } else { visibility };
                }
                let weight = trilinear * patch_weight(&entry, visibility, n);
                sum += values[entry.patch as usize] * weight;
                total += weight;
            }
        }
    }
    // Below this the weights have no digits left.
    if total < 1e-25 {
        sum = Vec4::ZERO;
        total = 0.0;
        let cell = own & !EMPTY_CELL;
        for k in offsets[cell as usize]..offsets[cell as usize + 1] {
            let entry = entries[k as usize];
            let weight = patch_weight(&entry, plane_visibility(p, &entry, x, n), n);
            sum += values[entry.patch as usize] * weight;
            total += weight;
        }
    }
    sum * (1.0 / total)
}

/// One of the eight corners of a cube of edge 1.
#[inline]
fn corner_step(corner: u32) -> Vec3 {
    Vec3::new((corner & 1) as f32, (corner >> 1 & 1) as f32, (corner >> 2) as f32)
}

/// Weight of a corner for a place at these shares of the cube's edges.
#[inline]
fn trilinear_weight(step: Vec3, share: Vec3) -> f32 {
    let t = (Vec3::ONE - step) * (Vec3::ONE - share) + step * share;
    t.x * t.y * t.z
}

/// The word of the voxel with these coordinates; [`EMPTY_CELL`] outside of the grid.
#[inline]
fn cell_at(p: &LookupParams, cells: &[u32], c: Vec3) -> u32 {
    let counts = Vec3::new(p.shape.count_x as f32, p.shape.count_y as f32, p.shape.count_z as f32);
    let inside = c.x >= 0.0 && c.y >= 0.0 && c.z >= 0.0 && c.x < counts.x && c.y < counts.y && c.z < counts.z;
    if inside {
        cells[(p.first_cell + p.shape.voxel_at(UVec3::new(c.x as u32, c.y as u32, c.z as u32))) as usize]
    } else {
        EMPTY_CELL
    }
}

/// Visibility by planes: 1 for a patch in the plane of the point, 0 from the limit on or for one that faces away.
#[inline]
fn plane_visibility(p: &LookupParams, entry: &LookupPatch, x: Vec3, n: Vec3) -> f32 {
    let distance = abs(((entry.position - x) / p.shape.edges).dot(n)) / p.plane_limit;
    let near = if distance < 1.0 { 1.0 - distance * distance } else { 0.0 };
    if n.dot(entry.direction) > 0.0 { near * near } else { 0.0 }
}

/// Returns true if a patch of the voxel in place `cell` stands between x and the entry.
#[inline]
fn is_behind_wall(
    p: &LookupParams,
    offsets: &[u32],
    entries: &[LookupPatch],
    cell: u32,
    entry: &LookupPatch,
    x: Vec3,
    n: Vec3,
) -> bool {
    let mut hidden = false;
    for k in offsets[cell as usize]..offsets[cell as usize + 1] {
        let wall = entries[k as usize];
        let in_front = ((x - wall.position) / p.shape.edges).dot(wall.direction);
        let beyond = ((entry.position - wall.position) / p.shape.edges).dot(wall.direction);
        let across = abs(wall.direction.dot(n)) < WALL_COSINE;
        hidden = hidden || (across && in_front > 0.0 && beyond < -WALL_DEPTH);
    }
    hidden
}

/// Weight of a patch by its normal and its visibility; positive.
#[inline]
fn patch_weight(entry: &LookupPatch, visibility: f32, n: Vec3) -> f32 {
    let cosine = n.dot(entry.direction);
    let facing = if cosine > 0.0 { cosine * cosine } else { 0.0 };
    // 2 + cosine: nothing is ever without weight, and what looks away least counts most.
    facing * (visibility + HIDDEN) + FACING_AWAY * (2.0 + cosine)
}
