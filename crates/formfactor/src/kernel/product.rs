//! What comes before and after the product H = F B: first exitance of patches, and irradiance at pixels. The products
//! themselves are those of [`transport::kernel::product`].

use glam::Vec4;
use scene::{Hit, NONE, SurfacePoint, Triangle};

pub use transport::kernel::product::*;

use super::grid::{interpolate, place_in_cell};
use crate::types::{ReceiverCell, TriangleGrid};

/// First exitance of patch `i`, `E = M_e + Σ_k w_k ρ_k H_d,k` over its points, W/m².
///
/// Shapes: `points`, `direct` and `albedo` by point, row `i` has `offsets[i]..offsets[i + 1]`; `emission` by patch.
#[inline]
pub fn assemble_source(
    i: u32,
    offsets: &[u32],
    points: &[SurfacePoint],
    direct: &[Vec4],
    emission: &[Vec4],
    albedo: &[Vec4],
) -> Vec4 {
    let mut sum = emission[i as usize];
    for k in offsets[i as usize]..offsets[i as usize + 1] {
        sum += albedo[k as usize] * direct[k as usize] * points[k as usize].weight;
    }
    sum
}

/// Irradiance of the side of a surface that a pixel shows, W/m²: [`interpolate_receivers`] at its hit, on the side on
/// which its point's normal stands.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn interpolate_pixel(
    grids: &[TriangleGrid],
    cells: &[ReceiverCell],
    vertices: &[u32],
    triangles: &[Triangle],
    values: &[Vec4],
    hit: Hit,
    point: SurfacePoint,
) -> Vec4 {
    if hit.triangle == NONE {
        return Vec4::ZERO;
    }
    let t = triangles[hit.triangle as usize];
    interpolate_receivers(grids, cells, vertices, values, hit, t.edge_a.cross(t.edge_b).dot(point.normal) > 0.0)
}

/// Irradiance at a hit, W/m²: linear between the three vertices round it in its cell and not negative, zero where there are
/// no receivers. `grids[triangle]` numbers the cells, `cells` their vertices, `vertices` names the receiver of each, `values`
/// holds their irradiance.
#[inline]
pub fn interpolate_receivers(
    grids: &[TriangleGrid],
    cells: &[ReceiverCell],
    vertices: &[u32],
    values: &[Vec4],
    hit: Hit,
    front: bool,
) -> Vec4 {
    if hit.triangle == NONE {
        return Vec4::ZERO;
    }
    let grid = grids[hit.triangle as usize];
    let first = if front { grid.front } else { grid.back };
    if first == NONE {
        return Vec4::ZERO;
    }
    let (index, s, t) = place_in_cell(grid.divisions, hit.u, hit.v);
    let cell = cells[(first + index) as usize];
    if cell.first == NONE {
        return Vec4::ZERO;
    }
    let (ids, w) = interpolate(cell.divisions, s, t);
    let a = values[vertices[(cell.first + ids.x) as usize] as usize];
    let b = values[vertices[(cell.first + ids.y) as usize] as usize];
    let c = values[vertices[(cell.first + ids.z) as usize] as usize];
    (a * w.x + b * w.y + c * w.z).max(Vec4::ZERO)
}
