//! Rows of a product that a view needs. What a view shows marks the interpolation points that it takes light from,
//! these mark what they are computed from, and so on; then each marked row is computed once for each light.
//!
//! Views and lights are numbered from 1. The mark of a row is twice the number of the last view that needs it, and one
//! more when its own columns are marked: another look of the same view, from other places in its pixels, only adds
//! rows.

use glam::{UVec3, Vec3};
use scene::gpu::Triangle;
use scene::{Hit, NONE, SurfacePoint};

use super::grid::{interpolate, place_in_cell};
use crate::types::{ReceiverCell, TriangleGrid};

/// Mark of a row that a view needs and whose columns are not marked yet.
#[inline]
pub fn needed(view: u32) -> u32 {
    2 * view
}

/// Returns true if a view needs the row with this mark.
#[inline]
pub fn is_needed(mark: u32, view: u32) -> bool {
    mark / 2 == view
}

/// Marks row `k` for a view.
#[inline]
pub fn mark(marks: &mut [u32], k: u32, view: u32) {
    if !is_needed(marks[k as usize], view) {
        marks[k as usize] = needed(view);
    }
}

/// Vertices of the interpolation mesh round a hit and their weights, which sum to 1; the first is [`NONE`] where there
/// are no receivers. `grids[triangle]` numbers the cells, `cells` their vertices, `vertices` names the value of each.
#[inline]
pub fn vertices_at(
    grids: &[TriangleGrid],
    cells: &[ReceiverCell],
    vertices: &[u32],
    hit: Hit,
    front: bool,
) -> (UVec3, Vec3) {
    let nothing = (UVec3::new(NONE, NONE, NONE), Vec3::ZERO);
    if hit.triangle == NONE {
        return nothing;
    }
    let grid = grids[hit.triangle as usize];
    let first = if front { grid.front } else { grid.back };
    if first == NONE {
        return nothing;
    }
    let (index, s, t) = place_in_cell(grid.divisions, hit.u, hit.v);
    let cell = cells[(first + index) as usize];
    if cell.first == NONE {
        return nothing;
    }
    let (ids, weights) = interpolate(cell.divisions, s, t);
    let a = vertices[(cell.first + ids.x) as usize];
    let b = vertices[(cell.first + ids.y) as usize];
    let c = vertices[(cell.first + ids.z) as usize];
    (UVec3::new(a, b, c), weights)
}

/// Vertices of a pixel's receivers: at its hit, on the side on which its point's normal stands.
#[inline]
pub fn pixel_vertices(
    grids: &[TriangleGrid],
    cells: &[ReceiverCell],
    vertices: &[u32],
    triangles: &[Triangle],
    hit: Hit,
    point: SurfacePoint,
) -> (UVec3, Vec3) {
    if hit.triangle == NONE {
        return (UVec3::new(NONE, NONE, NONE), Vec3::ZERO);
    }
    let t = triangles[hit.triangle as usize];
    let front = t.edge_a.cross(t.edge_b).dot(point.normal) > 0.0;
    vertices_at(grids, cells, vertices, hit, front)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_belongs_to_one_view_and_remembers_that_its_columns_are_marked() {
        let mut marks = [0, needed(3), needed(3) + 1];
        assert!(!is_needed(marks[0], 3));
        assert!(is_needed(marks[1], 3) && is_needed(marks[2], 3) && !is_needed(marks[2], 4));
        for k in 0..3 {
            mark(&mut marks, k, 3);
        }
        assert_eq!(marks, [needed(3), needed(3), needed(3) + 1]);
        mark(&mut marks, 2, 4);
        assert_eq!(marks[2], needed(4));
    }
}
