//! Small scenes.
#![allow(dead_code)]

use std::ops::ControlFlow;

use firstshot::{Emission, Estimate, LightElementSettings, PhotonAccumulator, PhotonSettings, Texels, Tracer};
use glam::Vec3;
use scene::{Light, Material, Scene, SceneParts, Triangle, TriangleUv};

/// Two triangles; the front is the side of `a × b`.
pub fn quad(corner: Vec3, a: Vec3, b: Vec3, material: u32) -> [Triangle; 2] {
    let half = |corner, edge_a, edge_b| Triangle { corner, edge_a, edge_b, material, ..Triangle::default() };
    [half(corner, a, b), half(corner + a + b, -a, -b)]
}

/// A box with fronts inside; material of each of the sides x₀ x₁ y₀ y₁ z₀ z₁.
pub fn room(low: Vec3, size: Vec3, materials: [u32; 6]) -> Vec<Triangle> {
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    let high = low + size;
    [
        quad(low, y, z, materials[0]),
        quad(high, -z, -y, materials[1]),
        quad(low, z, x, materials[2]),
        quad(high, -x, -z, materials[3]),
        quad(low, x, y, materials[4]),
        quad(high, -y, -x, materials[5]),
    ]
    .concat()
}

pub fn grey(albedo: f32) -> Material {
    Material { albedo: Vec3::splat(albedo), ..Material::default() }
}

pub fn scene(triangles: Vec<Triangle>, materials: Vec<Material>, lights: Vec<Light>) -> Scene {
    let uvs = vec![TriangleUv::default(); triangles.len()];
    Scene::new(SceneParts { triangles, uvs, materials, lights, ..SceneParts::default() }).unwrap()
}

pub fn go_on(_: usize, _: usize) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

pub fn first_shot(scene: &Scene) -> Emission {
    Emission::first_shot(scene, &LightElementSettings::default(), Texels::Mean, true, &go_on).unwrap()
}

/// All photons, whatever the error.
pub fn trace(
    scene: &Scene,
    emission: &Emission,
    accumulator: &dyn PhotonAccumulator,
    settings: PhotonSettings,
) -> Estimate {
    let mut tracer = Tracer::new(scene, emission, accumulator, PhotonSettings { error: 0.0, ..settings }).unwrap();
    assert!(tracer.run(&|_| ControlFlow::Continue(())));
    tracer.estimate()
}

pub fn photons(count: u64) -> PhotonSettings {
    PhotonSettings { most_photons: count, ..PhotonSettings::default() }
}
