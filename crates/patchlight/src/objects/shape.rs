//! Points and elements of the meshes that move: where they receive light, and what they send.

use std::collections::HashMap;

use glam::{Affine3A, Mat3, Vec3};
use scene::{MovingMesh, NONE, SurfacePoint};
use transport::kernel::grid::{vertex_at, vertex_count};
use transport::{ReceiverCell, TriangleGrid};

/// Divisions of the longest extent of a mesh by points, and of an edge of a triangle at most.
const DIVISIONS: f32 = 6.0;
const MAX_DIVISIONS: u32 = 6;
/// Share of the way to the middle of the triangles about by which points stand off from edges and corners, where other
/// surfaces touch.
const INWARDS: f32 = 0.04;
/// Corners are one where they are as near as this share of the extent, and face the same way to so many steps.
const WELD: f32 = 1e-4;
const FACING: f32 = 32.0;

/// A point of a mesh before its transform.
#[derive(Clone, Copy, Debug)]
struct OwnPoint {
    position: Vec3,
    normal: Vec3,
}

/// Points and elements of a mesh. Each triangle is an element, and has a grid of points.
#[derive(Clone, Debug)]
pub struct Shape {
    points: Vec<OwnPoint>,
    /// Divisions of each triangle's edges, and its points in the order of a grid's vertices.
    divisions: Vec<u32>,
    vertices: Vec<u32>,
}

/// A position and the way it faces, as whole numbers.
type Key = [i32; 6];

impl Shape {
    pub fn new(mesh: &MovingMesh) -> Self {
        let corners = |t: &scene::gpu::Triangle| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b];
        let all = || mesh.triangles().iter().flat_map(corners);
        let low = all().fold(Vec3::INFINITY, Vec3::min);
        let high = all().fold(Vec3::NEG_INFINITY, Vec3::max);
        let extent = (high - low).max_element().max(f32::MIN_POSITIVE);
        let mut known: HashMap<Key, u32> = HashMap::new();
        let mut points: Vec<OwnPoint> = Vec::new();
        // Sums of the middles of the triangles about each, and their number.
        let mut middles: Vec<(Vec3, f32)> = Vec::new();
        let mut divisions = Vec::new();
        let mut vertices = Vec::new();
        for (t, uv) in mesh.triangles().iter().zip(mesh.uvs()) {
            let [a, b, c] = corners(t);
            let longest = t.edge_a.length().max(t.edge_b.length()).max((b - c).length());
            let n = ((DIVISIONS * longest / extent).ceil() as u32).clamp(1, MAX_DIVISIONS);
            let flat = t.edge_a.cross(t.edge_b).normalize_or_zero();
            let normals = uv.normals().unwrap_or([flat; 3]);
            let first = vertices.len();
            vertices.resize(first + vertex_count(n) as usize, 0);
            for j in 0..=n {
                for i in 0..=n - j {
                    let (u, v) = (i as f32 / n as f32, j as f32 / n as f32);
                    let position = a + t.edge_a * u + t.edge_b * v;
                    let normal = normals[0] * (1.0 - u - v) + normals[1] * u + normals[2] * v;
                    let normal = normal.normalize_or(flat);
                    let place = (position - low) / (WELD * extent);
                    let facing = normal * FACING;
                    let key = [place.x, place.y, place.z, facing.x, facing.y, facing.z].map(|x| x.round() as i32);
                    let number = *known.entry(key).or_insert_with(|| {
                        points.push(OwnPoint { position, normal });
                        middles.push((Vec3::ZERO, 0.0));
                        points.len() as u32 - 1
                    });
                    let middle = &mut middles[number as usize];
                    *middle = (middle.0 + (a + b + c) / 3.0, middle.1 + 1.0);
                    vertices[first + vertex_at(n, i, j) as usize] = number;
                }
            }
            divisions.push(n);
        }
        for (point, (sum, count)) in points.iter_mut().zip(middles) {
            let aside = (sum / count - point.position).reject_from_normalized(point.normal);
            point.position += INWARDS * aside;
        }
        Self { points, divisions, vertices }
    }

    pub fn points(&self) -> usize {
        self.points.len()
    }

    pub fn elements(&self) -> usize {
        self.divisions.len()
    }

    /// The points at a place.
    pub fn placed(&self, transform: &Affine3A) -> impl Iterator<Item = SurfacePoint> + '_ {
        let transform = *transform;
        let turned = Mat3::from(transform.matrix3).inverse().transpose();
        self.points.iter().map(move |point| SurfacePoint {
            position: transform.transform_point3(point.position),
            patch: NONE,
            normal: (turned * point.normal).normalize_or(Vec3::Y),
            weight: 1.0,
        })
    }

    /// Points of each element.
    pub fn element_points(&self) -> impl Iterator<Item = &[u32]> + '_ {
        let mut first = 0;
        self.divisions.iter().map(move |&n| {
            let own = first..first + vertex_count(n) as usize;
            first = own.end;
            &self.vertices[own]
        })
    }

    /// Adds the grids of the triangles to those of an interpolation mesh: points are numbered from `first_point` on.
    pub fn add_to(
        &self,
        grids: &mut Vec<TriangleGrid>,
        cells: &mut Vec<ReceiverCell>,
        vertices: &mut Vec<u32>,
        first_point: u32,
    ) {
        let mut first = vertices.len() as u32;
        for &divisions in &self.divisions {
            grids.push(TriangleGrid { front: cells.len() as u32, back: NONE, divisions: 1, reserved: 0 });
            cells.push(ReceiverCell { first, divisions });
            first += vertex_count(divisions);
        }
        vertices.extend(self.vertices.iter().map(|&vertex| first_point + vertex));
    }
}

#[cfg(test)]
mod tests {
    use scene::Mesh;

    use super::*;

    fn square() -> Shape {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y];
        let mesh = Mesh { positions: &positions, indices: &[0, 1, 2, 0, 2, 3], ..Mesh::default() };
        Shape::new(&MovingMesh::new(&mesh, 1).unwrap())
    }

    #[test]
    fn triangles_share_points_and_stand_off_from_edges() {
        let shape = square();
        let n = MAX_DIVISIONS + 1;
        assert_eq!((shape.points(), shape.elements()), ((n * n) as usize, 2));
        let points: Vec<SurfacePoint> = shape.placed(&Affine3A::IDENTITY).collect();
        let is_inside = |p: &SurfacePoint| {
            p.position.x > 1e-3 && p.position.x < 0.999 && p.position.y > 1e-3 && p.position.y < 0.999
        };
        assert!(points.iter().all(|p| is_inside(p) && p.position.z == 0.0 && p.normal == Vec3::Z));
        let mut vertices = Vec::new();
        let mut cells = Vec::new();
        let mut grids = Vec::new();
        shape.add_to(&mut grids, &mut cells, &mut vertices, 100);
        assert_eq!((grids.len(), cells.len()), (2, 2));
        assert!(vertices.iter().all(|&v| (100..100 + n * n).contains(&v)));
        assert_eq!(vertices.len(), 2 * vertex_count(MAX_DIVISIONS) as usize);
    }

    #[test]
    fn points_follow_a_transform() {
        let turn = Affine3A::from_rotation_y(std::f32::consts::FRAC_PI_2);
        let moved: Vec<SurfacePoint> = square().placed(&turn).collect();
        assert!(moved.iter().all(|p| (p.normal - Vec3::X).length() < 1e-6 && p.position.x.abs() < 1e-6));
    }
}
