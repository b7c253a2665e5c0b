//! Form factors by cosine-weighted rays: each ray of row i carries its share of the energy that leaves i to the patch
//! it hits. Every row has its own points: `points[offsets[row]..offsets[row + 1]]`.

use glam::Vec3;
use scene::sampling::{cosine_hemisphere, hash3, sobol2_fast, unit};
use scene::{GeometryTables, Hit, NONE, SurfacePoint};

use crate::types::{HemisphereParams, TriangleGrid};
use transport::kernel::grid::owner;

/// Columns of a row beyond the patches: the sky, and hits that no patch owns.
pub const EXTRA_COLUMNS: u32 = 2;

/// Which point of its row ray `k` starts from, and how many rays start there. Contiguous blocks, the first
/// `rays % count` of them one longer; a row with more points than rays uses every (count / rays)-th.
#[inline]
fn point_of_ray(rays: u32, count: u32, k: u32) -> (u32, u32) {
    let block = rays / count;
    let longer = rays % count;
    if block == 0 {
        (k * (count / rays), 1)
    } else if k < longer * (block + 1) {
        (k / (block + 1), block + 1)
    } else {
        (longer + (k - longer * (block + 1)) / block, block)
    }
}

/// Origin and unit direction of ray `k` of row `row`: density cosθ/π round the point's normal, Sobol points in
/// contiguous blocks (each block stratified by itself, and all together), shifted by the row's own random vector
/// (Cranley and Patterson 1976). The origin stands `ray_offset` above the surface. Needs `k < rays` and a row with at
/// least one point.
#[inline]
pub fn hemisphere_ray(
    p: &HemisphereParams,
    offsets: &[u32],
    points: &[SurfacePoint],
    row: u32,
    k: u32,
) -> (Vec3, Vec3) {
    let first = offsets[row as usize];
    let count = offsets[row as usize + 1] - first;
    ray_from(p, points[(first + point_of_ray(p.rays, count, k).0) as usize], row, k)
}

/// The point from which ray `k` of a row with these points starts. Needs at least one.
#[inline]
pub fn origin_of_ray(p: &HemisphereParams, own: &[SurfacePoint], k: u32) -> SurfacePoint {
    own[point_of_ray(p.rays, own.len() as u32, k).0 as usize]
}

/// Ray `k` of the row with this number, wherever the row stands in a table now, from a point of it.
#[inline]
pub fn ray_from(p: &HemisphereParams, point: SurfacePoint, number: u32, k: u32) -> (Vec3, Vec3) {
    let (x, y) = sobol2_fast(k);
    let (shift_u, shift_v) = shift_of_row(p.seed, number);
    let square = (unit(x.wrapping_add(shift_u)), unit(y.wrapping_add(shift_v)));
    (point.position + point.normal * p.ray_offset, cosine_hemisphere(point.normal, square))
}

/// By how much the Sobol points of the row with this number are shifted, as fixed-point words.
#[inline]
pub fn shift_of_row(seed: u32, number: u32) -> (u32, u32) {
    (hash3(number, 0x6865_6d69, seed), hash3(number, 0x7370_6865, seed))
}

/// Share of the row's energy that ray `k` carries: the weight of its point over that point's number of rays (equal
/// shares where a row has more points than rays). The shares of a row sum to 1.
#[inline]
pub fn ray_share(p: &HemisphereParams, offsets: &[u32], points: &[SurfacePoint], row: u32, k: u32) -> f32 {
    let first = offsets[row as usize];
    let count = offsets[row as usize + 1] - first;
    if count > p.rays {
        return 1.0 / p.rays as f32;
    }
    let (s, block) = point_of_ray(p.rays, count, k);
    points[(first + s) as usize].weight / block as f32
}

/// Column of what a ray met: the patch that owns the hit, `patch_count` for the sky, `patch_count + 1` for a hit that
/// no patch owns. `grids[triangle]` numbers the cells of each triangle, and `cell_columns[cell]` names the patch of
/// each.
#[inline]
pub fn classify_hit(
    p: &HemisphereParams,
    grids: &[TriangleGrid],
    cell_columns: &[u32],
    geometry: &GeometryTables,
    direction: Vec3,
    hit: Hit,
) -> u32 {
    if hit.triangle == NONE {
        return p.patch_count;
    }
    let front = geometry.normal(hit.triangle).dot(direction) < 0.0;
    let cell = owner(grids[hit.triangle as usize], hit, front);
    let column = if cell == NONE { NONE } else { cell_columns[cell as usize] };
    if column < p.patch_count { column } else { p.patch_count + 1 }
}

/// Row `first_row + row_local` of F from the columns that its rays met: writes all
/// `factors[row_local · (patch_count + 2) ..][.. patch_count + 2]` (patches, sky, lost), which sum to 1.
///
/// Shapes: `ids[row_count · rays]`, rows of this dispatch one after the other. One invocation a row; it writes nothing
/// but its own row. Needs `row_local < row_count`.
#[inline]
pub fn hemisphere_row(
    p: &HemisphereParams,
    offsets: &[u32],
    points: &[SurfacePoint],
    ids: &[u32],
    row_local: u32,
    factors: &mut [f32],
) {
    let columns = p.patch_count + EXTRA_COLUMNS;
    let base = row_local * columns;
    for column in 0..columns {
        factors[(base + column) as usize] = 0.0;
    }
    for k in 0..p.rays {
        let id = ids[(row_local * p.rays + k) as usize];
        factors[(base + id) as usize] += ray_share(p, offsets, points, p.first_row + row_local, k);
    }
}
