//! Normals of vertices, and surfaces that are shaded as if they were as smooth as those say.

use glam::Vec3;

use super::bvh::GeometryTables;
use super::camera::surface_point;
use crate::gpu::{Hit, NONE, SurfacePoint};
use crate::math::{abs, floor};

/// Steps of a coordinate of the octahedron.
const STEPS: f32 = 65_534.0;

/// A unit normal in two numbers of 16 bits, neither of which is 0: its place on an octahedron that is unfolded to a square
/// (Meyer et al. 2010).
#[inline]
pub fn pack(normal: Vec3) -> u32 {
    let flat = normal * (1.0 / (abs(normal.x) + abs(normal.y) + abs(normal.z)));
    let (x, y) = if flat.z < 0.0 { folded(flat.x, flat.y) } else { (flat.x, flat.y) };
    code(x) | code(y) << 16
}

/// The unit normal of [`pack`], to 10⁻⁴.
#[inline]
pub fn unpack(code: u32) -> Vec3 {
    let x = ((code & 0xffff) as f32 - 1.0) * (2.0 / STEPS) - 1.0;
    let y = ((code >> 16) as f32 - 1.0) * (2.0 / STEPS) - 1.0;
    let z = 1.0 - abs(x) - abs(y);
    let (x, y) = if z < 0.0 { folded(x, y) } else { (x, y) };
    let normal = Vec3::new(x, y, z);
    normal * (1.0 / normal.length())
}

#[inline]
fn code(x: f32) -> u32 {
    floor((0.5 * x + 0.5) * STEPS + 0.5) as u32 + 1
}

/// The place on the other side of the octahedron's edge.
#[inline]
fn folded(x: f32, y: f32) -> (f32, f32) {
    let across = (1.0 - abs(y), 1.0 - abs(x));
    (if x < 0.0 { -across.0 } else { across.0 }, if y < 0.0 { -across.1 } else { across.1 })
}

/// [`surface_point`] for pixels: with the interpolated normal, and lifted onto the smooth surface that the triangle
/// stands for, so that neighbours throw no shadow of their edges on it (Hanika 2021).
#[inline]
pub fn shading_point(g: &GeometryTables, hit: Hit, direction: Vec3) -> SurfacePoint {
    let mut point = surface_point(g, hit, direction);
    if hit.triangle == NONE {
        return point;
    }
    let vertices = g.uvs[hit.triangle as usize];
    if vertices.normal == 0 {
        return point;
    }
    let side = if g.normal(hit.triangle).dot(point.normal) < 0.0 { -1.0 } else { 1.0 };
    let a = unpack(vertices.normal) * side;
    let b = unpack(vertices.normal_a) * side;
    let c = unpack(vertices.normal_b) * side;
    let share = 1.0 - hit.u - hit.v;
    let normal = a * share + b * hit.u + c * hit.v;
    let t = g.triangles[hit.triangle as usize];
    let from = point.position - t.corner;
    let lift = a * (share * depth(from, a))
        + b * (hit.u * depth(from - t.edge_a, b))
        + c * (hit.v * depth(from - t.edge_b, c));
    point.position += lift;
    point.normal = normal * (1.0 / normal.length());
    point
}

/// How far a place lies below the plane through a vertex.
#[inline]
fn depth(from: Vec3, normal: Vec3) -> f32 {
    let height = from.dot(normal);
    if height < 0.0 { -height } else { 0.0 }
}
