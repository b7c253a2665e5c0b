//! Small scenes with known light.
#![allow(dead_code, reason = "each test file uses a part")]

use std::ops::ControlFlow;

use glam::Vec3;
use reference::{Accumulation, PathSettings, PathTracer};
use scene::gpu::{LIGHT_DIRECTIONAL, Triangle, TriangleUv};
use scene::{Camera, Light, Material, NONE, Scene, SceneParts, Sky, SurfacePoint};

/// Collects quads into a scene.
#[derive(Default)]
pub struct Builder {
    pub parts: SceneParts,
}

impl Builder {
    pub fn material(&mut self, albedo: Vec3, radiance: Vec3) -> u32 {
        self.parts.materials.push(Material { albedo, radiance, ..Material::default() });
        self.parts.materials.len() as u32 - 1
    }

    /// Parallelogram with its front towards `a × b`.
    pub fn quad(&mut self, corner: Vec3, a: Vec3, b: Vec3, material: u32) -> &mut Self {
        for (edge_a, edge_b) in [(a, a + b), (a + b, b)] {
            self.parts.triangles.push(Triangle { corner, edge_a, edge_b, material, ..Triangle::default() });
            self.parts.uvs.push(TriangleUv::default());
        }
        self
    }

    /// Six faces with their fronts inwards.
    pub fn box_inwards(&mut self, low: Vec3, high: Vec3, material: u32) -> &mut Self {
        let d = high - low;
        let x = Vec3::X * d.x;
        let y = Vec3::Y * d.y;
        let z = Vec3::Z * d.z;
        self.quad(low, y, z, material).quad(low, z, x, material).quad(low, x, y, material);
        self.quad(high, -z, -y, material).quad(high, -x, -z, material).quad(high, -y, -x, material)
    }

    /// A sphere round the origin with its fronts inwards: each side of a cube cut `divisions` times along both edges.
    pub fn sphere_inwards(&mut self, radius: f32, divisions: u32, material: u32) -> &mut Self {
        let on_sphere = |axis: usize, side: f32, i: u32, j: u32| {
            let place = |k: u32| 2.0 * k as f32 / divisions as f32 - 1.0;
            let mut at = [0.0; 3];
            (at[axis], at[(axis + 1) % 3], at[(axis + 2) % 3]) = (side, place(i), place(j));
            Vec3::from(at).normalize() * radius
        };
        for k in 0..6 * divisions * divisions {
            let face = k / (divisions * divisions);
            let i = k / divisions % divisions;
            let j = k % divisions;
            let axis = (face / 2) as usize;
            let side = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
            let at = |di: u32, dj: u32| on_sphere(axis, side, i + di, j + dj);
            for [a, b, c] in [[at(0, 0), at(1, 0), at(1, 1)], [at(0, 0), at(1, 1), at(0, 1)]] {
                let is_outwards = (b - a).cross(c - a).dot(a) > 0.0;
                let (edge_a, edge_b) = if is_outwards { (c - a, b - a) } else { (b - a, c - a) };
                self.parts.triangles.push(Triangle { corner: a, edge_a, edge_b, material, ..Triangle::default() });
                self.parts.uvs.push(TriangleUv::default());
            }
        }
        self
    }

    pub fn light(&mut self, light: Light) -> &mut Self {
        self.parts.lights.push(light);
        self
    }

    pub fn sky(&mut self, radiance: Vec3) -> &mut Self {
        self.parts.sky = Sky { radiance, ..Sky::default() };
        self
    }

    pub fn build(&self) -> Scene {
        Scene::new(self.parts.clone()).expect("the scene is sound")
    }
}

/// Closed unit cube whose inner faces shine with radiance 1 and reflect `albedo`.
pub fn furnace(albedo: f32) -> Scene {
    let mut b = Builder::default();
    let m = b.material(Vec3::splat(albedo), Vec3::ONE);
    b.box_inwards(Vec3::ZERO, Vec3::ONE, m);
    b.build()
}

/// A room with coloured walls, an emissive panel below the ceiling, a rectangle light and an open side to the sky.
pub fn room(albedo: f32) -> Scene {
    let mut b = Builder::default();
    let white = b.material(Vec3::splat(albedo), Vec3::ZERO);
    let red = b.material(Vec3::new(albedo, 0.1, 0.1), Vec3::ZERO);
    let panel = b.material(Vec3::splat(0.2), Vec3::new(9.0, 8.0, 7.0));
    let x = 2.0 * Vec3::X;
    let y = 2.0 * Vec3::Y;
    let z = 2.0 * Vec3::Z;
    b.quad(Vec3::ZERO, z, x, white).quad(y, x, z, white).quad(Vec3::ZERO, y, z, red).quad(x, z, y, white);
    b.quad(Vec3::ZERO, x, y, white);
    b.quad(Vec3::new(0.7, 1.7, 0.7), 0.5 * Vec3::X, 0.5 * Vec3::Z, panel);
    b.quad(Vec3::new(1.2, 0.0, 0.4), 0.7 * Vec3::Y, Vec3::new(0.4, 0.0, 0.3), white);
    b.sky(Vec3::new(0.2, 0.3, 0.5));
    b.build()
}

/// A room that two suns shine into through a hole in the ceiling.
pub fn sunny_room(albedo: f32) -> Scene {
    let mut b = Builder::default();
    let white = b.material(Vec3::splat(albedo), Vec3::ZERO);
    let red = b.material(Vec3::new(albedo, 0.1, 0.1), Vec3::ZERO);
    let x = 2.0 * Vec3::X;
    let y = 2.0 * Vec3::Y;
    let z = 2.0 * Vec3::Z;
    b.quad(Vec3::ZERO, z, x, white).quad(Vec3::ZERO, y, z, red).quad(x, z, y, white);
    b.quad(Vec3::ZERO, x, y, white).quad(z, y, x, white);
    b.quad(y, 0.8 * x, z, white).quad(y + 0.9 * x, 0.1 * x, z, white);
    for (direction, color) in [
        (Vec3::new(0.2, -1.0, 0.1), Vec3::new(30.0, 25.0, 20.0)),
        (Vec3::new(-0.6, -1.0, -0.2), Vec3::new(2.0, 4.0, 8.0)),
    ] {
        let direction = direction.normalize();
        b.light(Light { kind: LIGHT_DIRECTIONAL, direction, color, ..Light::default() });
    }
    b.build()
}

/// A camera inside the room or furnace.
pub fn camera(width: u32, height: u32) -> Camera {
    Camera::look_at(Vec3::new(0.8, 0.6, 0.95), Vec3::new(0.45, 0.45, 0.0), Vec3::Y, 60.0, width, height)
}

/// `samples` samples a pixel in one go.
pub fn trace(scene: &Scene, camera: &Camera, settings: PathSettings, samples: u32) -> Accumulation {
    let mut accumulation = Accumulation::new(camera, settings);
    let done = PathTracer::new(scene)
        .accumulate(camera, &mut accumulation, samples, |_, _| ControlFlow::Continue(()))
        .expect("sizes agree");
    assert!(done && accumulation.samples() == samples);
    accumulation
}

pub fn point(position: Vec3, normal: Vec3) -> SurfacePoint {
    SurfacePoint { position, patch: NONE, normal, weight: 1.0 }
}

/// A floor of reflectance 0.6, 200 m wide, centre at the origin.
pub fn floor() -> Builder {
    let mut b = Builder::default();
    let m = b.material(Vec3::splat(0.6), Vec3::ZERO);
    b.quad(Vec3::new(-100.0, 0.0, -100.0), 200.0 * Vec3::Z, 200.0 * Vec3::X, m);
    b
}

/// Direct irradiance of points, W/m²; none of it may be indirect.
pub fn direct(scene: &Scene, points: &[SurfacePoint], samples: u32) -> Vec<Vec3> {
    PathTracer::new(scene)
        .irradiance(points, samples, &PathSettings::default())
        .iter()
        .map(|p| {
            assert_eq!(p.indirect, Vec3::ZERO, "a floor alone reflects nothing onto itself");
            p.direct
        })
        .collect()
}
