//! Scenes that the tests share.
#![allow(dead_code)]

use glam::{Quat, Vec3};
use scene::gpu::{Triangle, TriangleUv};
use scene::{Material, Scene, SceneParts};

/// Triangles under construction.
#[derive(Default)]
pub struct Mesh {
    pub triangles: Vec<Triangle>,
}

impl Mesh {
    /// The triangle a, b, c; its front is where the corners run counter-clockwise.
    pub fn triangle(&mut self, a: Vec3, b: Vec3, c: Vec3) {
        self.triangles.push(Triangle { corner: a, edge_a: b - a, edge_b: c - a, ..Triangle::default() });
    }

    /// A parallelogram whose front is the side of `a × b`.
    pub fn quad(&mut self, corner: Vec3, a: Vec3, b: Vec3) {
        self.triangle(corner, corner + a, corner + b);
        self.triangle(corner + a + b, corner + b, corner + a);
    }

    /// The six sides of a box, fronts inwards or outwards.
    pub fn cuboid(&mut self, low: Vec3, high: Vec3, inwards: bool) {
        let size = high - low;
        let x = Vec3::X * size.x;
        let y = Vec3::Y * size.y;
        let z = Vec3::Z * size.z;
        for (corner, a, b) in [(low, x, y), (low, y, z), (low, z, x), (high, -y, -x), (high, -z, -y), (high, -x, -z)] {
            if inwards { self.quad(corner, a, b) } else { self.quad(corner, b, a) }
        }
    }

    /// A closed prism of `sides` sides round the y axis, fronts outwards.
    pub fn column(&mut self, foot: Vec3, radius: f32, height: f32, sides: u32) {
        let at = |k: u32| {
            foot + Quat::from_rotation_y(core::f32::consts::TAU * k as f32 / sides as f32) * (Vec3::X * radius)
        };
        let up = Vec3::Y * height;
        for k in 0..sides {
            let a = at(k);
            let b = at(k + 1);
            self.quad(a, b - a, up);
            self.triangle(foot, b, a);
            self.triangle(foot + up, a + up, b + up);
        }
    }

    /// A ball of 8·4^level triangles, fronts outwards.
    pub fn ball(&mut self, centre: Vec3, radius: f32, level: u32) {
        let mut faces = Vec::new();
        for (sx, sy, sz) in
            [(1, 1, 1), (-1, 1, 1), (1, -1, 1), (-1, -1, 1), (1, 1, -1), (-1, 1, -1), (1, -1, -1), (-1, -1, -1)]
        {
            let x = Vec3::X * sx as f32;
            let y = Vec3::Y * sy as f32;
            let z = Vec3::Z * sz as f32;
            faces.push(if sx * sy * sz > 0 { [x, y, z] } else { [x, z, y] });
        }
        for _ in 0..level {
            faces = faces
                .into_iter()
                .flat_map(|[a, b, c]| {
                    let ab = (a + b).normalize();
                    let bc = (b + c).normalize();
                    let ca = (c + a).normalize();
                    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
                })
                .collect();
        }
        for [a, b, c] in faces {
            self.triangle(centre + a * radius, centre + b * radius, centre + c * radius);
        }
    }

    /// Area of one side of all triangles, m².
    pub fn area(&self) -> f64 {
        self.triangles.iter().map(|t| 0.5 * t.edge_a.as_dvec3().cross(t.edge_b.as_dvec3()).length()).sum()
    }

    /// The scene, scaled.
    pub fn scene(mut self, scale: f32) -> Scene {
        for t in &mut self.triangles {
            (t.corner, t.edge_a, t.edge_b) = (t.corner * scale, t.edge_a * scale, t.edge_b * scale);
        }
        let uvs = vec![TriangleUv::default(); self.triangles.len()];
        let materials = vec![Material::default()];
        Scene::new(SceneParts { triangles: self.triangles, uvs, materials, ..SceneParts::default() }).unwrap()
    }
}

/// A closed hall, 12 × 5 × 6 m, fronts inwards, with two rows of columns, a gallery and balls of small triangles.
pub fn atrium() -> Mesh {
    let mut mesh = Mesh::default();
    mesh.cuboid(Vec3::ZERO, Vec3::new(12.0, 5.0, 6.0), true);
    for k in 0..5 {
        for z in [1.5, 4.5] {
            mesh.column(Vec3::new(2.03 + 2.0 * k as f32, 0.01, z), 0.21, 2.9, 12);
        }
    }
    mesh.cuboid(Vec3::new(0.013, 3.01, 0.017), Vec3::new(11.9, 3.2, 1.9), false);
    mesh.cuboid(Vec3::new(0.013, 3.01, 4.1), Vec3::new(11.9, 3.2, 5.9), false);
    mesh.ball(Vec3::new(6.1, 1.02, 3.03), 0.8, 4);
    mesh.ball(Vec3::new(3.3, 0.4, 2.9), 0.3, 3);
    mesh
}

/// Two closed rooms of 2 × 2 × 2 m with one wall without thickness between them at x = 2.
pub fn two_rooms() -> Mesh {
    let mut mesh = Mesh::default();
    mesh.cuboid(Vec3::ZERO, Vec3::new(4.0, 2.0, 2.0), true);
    mesh.quad(Vec3::new(2.0, 0.0, 0.0), Vec3::Y * 2.0, Vec3::Z * 2.0);
    mesh
}
