//! The regular grid on a triangle: `n²` like cells (patches) and `(n + 1)(n + 2) / 2` vertices (receivers), numbered in
//! rows of equal v. A position is (u, v), the shares of the triangle's two edges.

use glam::{UVec3, Vec2, Vec3, Vec4};
use scene::gpu::Triangle;
use scene::{Hit, NONE, SurfacePoint};

use super::view::{pixel_vertices, vertices_at};
use crate::types::{ReceiverCell, TriangleGrid};

/// Number of cells of a grid with `divisions` divisions of each edge.
#[inline]
pub fn cell_count(divisions: u32) -> u32 {
    divisions * divisions
}

/// Number of vertices of a grid with `divisions` divisions of each edge.
#[inline]
pub fn vertex_count(divisions: u32) -> u32 {
    (divisions + 1) * (divisions + 2) / 2
}

/// Number of the vertex in column `i` of row `j`, `i + j ≤ divisions`.
#[inline]
pub fn vertex_at(divisions: u32, i: u32, j: u32) -> u32 {
    j * (2 * divisions + 3 - j) / 2 + i
}

/// Column, row and half of the cell that holds (u, v); positions a little outside go to the nearest cell. The half is 1
/// for a cell that stands on its tip.
#[inline]
fn locate(divisions: u32, u: f32, v: f32) -> (u32, u32, u32) {
    // The one cell of most triangles.
    if divisions == 1 {
        return (0, 0, 0);
    }
    let n = divisions as f32;
    let x = if u > 0.0 { u * n } else { 0.0 };
    let y = if v > 0.0 { v * n } else { 0.0 };
    let mut j = y as u32;
    j = if j < divisions { j } else { divisions - 1 };
    let last = divisions - 1 - j;
    let mut i = x as u32;
    i = if i < last { i } else { last };
    let over = (x - i as f32) + (y - j as f32) > 1.0;
    (i, j, if over && i < last { 1 } else { 0 })
}

/// Number of the cell that holds (u, v), in `0..divisions²`. Rows of equal v follow each other; within a row upright
/// cells and cells on their tip alternate.
#[inline]
pub fn cell_at(divisions: u32, u: f32, v: f32) -> u32 {
    let (i, j, half) = locate(divisions, u, v);
    j * (2 * divisions - j) + 2 * i + half
}

/// Column, row and half of a cell: the inverse of [`cell_at`]'s numbering. Needs `cell < divisions²`.
#[inline]
fn cell_place(divisions: u32, cell: u32) -> (u32, u32, u32) {
    let mut j = 0;
    while (j + 1) * (2 * divisions - (j + 1)) <= cell && j + 1 < divisions {
        j += 1;
    }
    let within = cell - j * (2 * divisions - j);
    (within / 2, j, within % 2)
}

/// The three corners (u, v) of a cell, in the sense of the triangle's own corners. Needs `cell < divisions²`.
#[inline]
pub fn cell_corners(divisions: u32, cell: u32) -> (Vec2, Vec2, Vec2) {
    let (i, j, half) = cell_place(divisions, cell);
    let n = divisions as f32;
    let u0 = i as f32 / n;
    let v0 = j as f32 / n;
    let u1 = (i + 1) as f32 / n;
    let v1 = (j + 1) as f32 / n;
    if half == 0 {
        (Vec2::new(u0, v0), Vec2::new(u1, v0), Vec2::new(u0, v1))
    } else {
        (Vec2::new(u1, v1), Vec2::new(u0, v1), Vec2::new(u1, v0))
    }
}

/// The cell of (u, v), and where in it: the place is `a + (b − a) s + (c − a) t` of its corners.
#[inline]
pub fn place_in_cell(divisions: u32, u: f32, v: f32) -> (u32, f32, f32) {
    let (i, j, half) = locate(divisions, u, v);
    let n = divisions as f32;
    let x = u * n - i as f32;
    let y = v * n - j as f32;
    let cell = cell_at(divisions, u, v);
    if half == 0 { (cell, x, y) } else { (cell, 1.0 - x, 1.0 - y) }
}

/// The three vertices round (u, v) and their barycentric weights, which sum to 1.
#[inline]
pub fn interpolate(divisions: u32, u: f32, v: f32) -> (UVec3, Vec3) {
    let (i, j, half) = locate(divisions, u, v);
    let n = divisions as f32;
    let x = clamp_share(u * n - i as f32);
    let y = clamp_share(v * n - j as f32);
    if half == 0 {
        // On the hypotenuse rounding may leave x + y a little above 1.
        let y = if x + y > 1.0 { 1.0 - x } else { y };
        let ids =
            UVec3::new(vertex_at(divisions, i, j), vertex_at(divisions, i + 1, j), vertex_at(divisions, i, j + 1));
        (ids, Vec3::new(1.0 - x - y, x, y))
    } else {
        let ids = UVec3::new(
            vertex_at(divisions, i + 1, j + 1),
            vertex_at(divisions, i, j + 1),
            vertex_at(divisions, i + 1, j),
        );
        (ids, Vec3::new(x + y - 1.0, 1.0 - x, 1.0 - y))
    }
}

#[inline]
fn clamp_share(x: f32) -> f32 {
    if x > 1.0 {
        1.0
    } else if x > 0.0 {
        x
    } else {
        0.0
    }
}

/// The patch that owns a hit on the front or back of a triangle with this grid, or [`NONE`].
#[inline]
pub fn owner(grid: TriangleGrid, hit: Hit, front: bool) -> u32 {
    let first = if front { grid.front } else { grid.back };
    if first == NONE { NONE } else { first + cell_at(grid.divisions, hit.u, hit.v) }
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
    weighted(values, pixel_vertices(grids, cells, vertices, triangles, hit, point))
}

/// Irradiance at a hit, W/m²: linear between the three vertices round it in its cell and not negative, and 1 as the
/// fourth component; zero where there are no receivers. `grids[triangle]` numbers the cells, `cells` their vertices,
/// `vertices` names the receiver of each, `values` holds their irradiance.
#[inline]
pub fn interpolate_receivers(
    grids: &[TriangleGrid],
    cells: &[ReceiverCell],
    vertices: &[u32],
    values: &[Vec4],
    hit: Hit,
    front: bool,
) -> Vec4 {
    weighted(values, vertices_at(grids, cells, vertices, hit, front))
}

/// Value between three vertices, not negative, and 1; zero where there are none.
#[inline]
fn weighted(values: &[Vec4], (ids, w): (UVec3, Vec3)) -> Vec4 {
    if ids.x == NONE {
        return Vec4::ZERO;
    }
    let a = values[ids.x as usize];
    let b = values[ids.y as usize];
    let c = values[ids.z as usize];
    (a * w.x + b * w.y + c * w.z).max(Vec4::ZERO).truncate().extend(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_cover_the_triangle_once_and_agree_with_their_corners() {
        for n in 1..=12 {
            let mut area = 0.0;
            for cell in 0..cell_count(n) {
                let (a, b, c) = cell_corners(n, cell);
                let double = (b - a).perp_dot(c - a);
                assert!((double * (n * n) as f32 - 1.0).abs() < 1e-4, "cell {cell} of {n} has double area {double}");
                area += 0.5 * double;
                let middle = (a + b + c) / 3.0;
                assert_eq!(cell_at(n, middle.x, middle.y), cell);
                for corner in [a, b, c] {
                    let inside = corner + (middle - corner) * 0.01;
                    assert_eq!(cell_at(n, inside.x, inside.y), cell);
                }
            }
            assert!((area - 0.5).abs() < 1e-5);
            // Places outside go to a cell that exists.
            for (u, v) in [(1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (1.1, -0.1), (f32::NAN, 0.3)] {
                assert!(cell_at(n, u, v) < cell_count(n));
            }
        }
    }

    #[test]
    fn places_in_cells_lead_back() {
        for n in 1..=9 {
            for k in 0..500 {
                let (u, v) = scene::sampling::uniform_triangle(scene::sampling::hammersley(k, 500, (3, 4)));
                let (cell, s, t) = place_in_cell(n, u, v);
                let (a, b, c) = cell_corners(n, cell);
                let back = a + (b - a) * s + (c - a) * t;
                assert!((back - Vec2::new(u, v)).length() < 1e-5, "{n} {u} {v}: {back}");
                assert!(s > -1e-4 && t > -1e-4 && s + t < 1.0001);
            }
        }
    }

    #[test]
    fn interpolation_reproduces_linear_functions() {
        for n in 1..=9u32 {
            let mut values = alloc::vec![f32::NAN; vertex_count(n) as usize];
            for j in 0..=n {
                for i in 0..=n - j {
                    values[vertex_at(n, i, j) as usize] = 2.0 + 3.0 * i as f32 / n as f32 - 5.0 * j as f32 / n as f32;
                }
            }
            for k in 0..1000 {
                let (u, v) = scene::sampling::uniform_triangle(scene::sampling::hammersley(k, 1000, (1, 2)));
                let (ids, w) = interpolate(n, u, v);
                let found = values[ids.x as usize] * w.x + values[ids.y as usize] * w.y + values[ids.z as usize] * w.z;
                assert!((found - (2.0 + 3.0 * u - 5.0 * v)).abs() < 1e-5, "{n} {u} {v}: {found}");
                assert!(w.min_element() >= -1e-5);
            }
        }
    }
}
