//! Cells of illumination maps: each side of a triangle is cut into `n²` like triangles, in rows of equal v; within a
//! row upright cells and cells on their tip alternate.

use glam::Vec2;
use scene::math::clamp;

use crate::types::MapGrid;

/// Cell of a place on a side of a triangle with this grid; places a little outside go to the nearest cell.
#[inline]
pub fn cell_at(grid: MapGrid, u: f32, v: f32, is_back: bool) -> u32 {
    let n = grid.divisions;
    let x = clamp(u, 0.0, 1.0) * n as f32;
    let y = clamp(v, 0.0, 1.0) * n as f32;
    let j = if (y as u32) < n { y as u32 } else { n - 1 };
    let last = n - 1 - j;
    let i = if (x as u32) < last { x as u32 } else { last };
    let is_tip = i < last && (x - i as f32) + (y - j as f32) > 1.0;
    grid.first + j * (2 * n - j) + 2 * i + is_tip as u32 + if is_back { n * n } else { 0 }
}

/// Corners (u, v) of the cell in column `i` and row `j`, upright or on its tip.
#[inline]
pub fn cell_corners(divisions: u32, i: u32, j: u32, is_tip: bool) -> (Vec2, Vec2, Vec2) {
    let n = 1.0 / divisions as f32;
    let u0 = i as f32 * n;
    let v0 = j as f32 * n;
    if is_tip {
        (Vec2::new(u0 + n, v0 + n), Vec2::new(u0, v0 + n), Vec2::new(u0 + n, v0))
    } else {
        (Vec2::new(u0, v0), Vec2::new(u0 + n, v0), Vec2::new(u0, v0 + n))
    }
}
