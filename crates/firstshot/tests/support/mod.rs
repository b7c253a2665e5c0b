//! Small scenes.
#![allow(dead_code)]

use std::ops::ControlFlow;

use glam::{Vec2, Vec3};
use patchlight_firstshot::{
    Emission, Estimate, IlluminationMaps, LightElementSettings, PhotonAccumulator, PhotonSettings, Texels, Tracer,
};
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_SPOT, Texture, Triangle, TriangleUv};
use scene::{Light, Material, Scene, SceneParts};

/// Two triangles; the front is the side of `a × b`.
pub fn quad(corner: Vec3, a: Vec3, b: Vec3, material: u32) -> [Triangle; 2] {
    let half = |corner, edge_a, edge_b| Triangle { corner, edge_a, edge_b, material, ..Triangle::default() };
    [half(corner, a, b), half(corner + a + b, -a, -b)]
}

/// A box with fronts inside; material of each of the sides x₀ x₁ y₀ y₁ z₀ z₁.
pub fn room(low: Vec3, size: Vec3, materials: [u32; 6]) -> Vec<Triangle> {
    let x = Vec3::X * size.x;
    let y = Vec3::Y * size.y;
    let z = Vec3::Z * size.z;
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

/// A sphere round the origin with its fronts inwards: each side of a cube cut `divisions` times along both edges.
pub fn sphere(radius: f32, divisions: u32) -> Vec<Triangle> {
    let on_sphere = |axis: usize, side: f32, i: u32, j: u32| {
        let place = |k: u32| 2.0 * k as f32 / divisions as f32 - 1.0;
        let mut at = [0.0; 3];
        (at[axis], at[(axis + 1) % 3], at[(axis + 2) % 3]) = (side, place(i), place(j));
        Vec3::from(at).normalize() * radius
    };
    let mut triangles = Vec::new();
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
            triangles.push(Triangle { corner: a, edge_a, edge_b, ..Triangle::default() });
        }
    }
    triangles
}

/// Copy of a scene, filled with a medium.
pub fn filled(scene: &Scene, absorption: Vec3) -> Scene {
    let g = &scene.geometry;
    Scene::new(SceneParts {
        triangles: g.triangles.clone(),
        uvs: g.uvs.clone(),
        materials: g.materials.to_vec(),
        textures: g.textures.clone(),
        texels: g.texels.to_vec(),
        lights: scene.lighting.lights.clone(),
        sky: scene.lighting.sky,
        absorption,
        ..SceneParts::default()
    })
    .unwrap()
}

pub fn grey(albedo: f32) -> Material {
    Material { albedo: Vec3::splat(albedo), ..Material::default() }
}

pub fn scene(triangles: Vec<Triangle>, materials: Vec<Material>, lights: Vec<Light>) -> Scene {
    let uvs = vec![TriangleUv::default(); triangles.len()];
    Scene::new(SceneParts { triangles, uvs, materials, lights, ..SceneParts::default() }).unwrap()
}

pub fn ignore_progress(_: usize, _: usize) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

pub fn first_shot(scene: &Scene) -> Emission {
    Emission::first_shot(scene, &LightElementSettings::default(), Texels::Mean, true, &ignore_progress).unwrap()
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

/// Colour of lamps.
pub const COLOR: Vec3 = Vec3::new(3.0, 2.0, 1.0);

/// A square of 2 m in the plane y = 0.
pub fn plate(albedo: f32, lights: Vec<Light>) -> Scene {
    let ground = quad(Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, 0);
    scene(ground.to_vec(), vec![grey(albedo)], lights)
}

/// A point light.
pub fn bulb(position: Vec3) -> Light {
    Light { kind: LIGHT_POINT, position, color: COLOR, ..Light::default() }
}

/// A point, a spot and a parallel light.
pub fn lights() -> Vec<Light> {
    let base = Light { position: Vec3::new(0.4, 0.8, 0.6), color: Vec3::new(1.0, 0.8, 0.5), ..Light::default() };
    let down = Vec3::new(0.3, -0.9, 0.1).normalize();
    vec![
        Light { kind: LIGHT_POINT, ..base },
        Light { kind: LIGHT_SPOT, direction: down, cos_inner: 0.9, cos_outer: 0.7, ..base },
        Light { kind: LIGHT_DIRECTIONAL, direction: down, ..base },
    ]
}

/// A room with a window and a board in it, a texture on the floor, holes in the board.
pub fn room_with_a_window(lights: Vec<Light>) -> Scene {
    let mut triangles = room(Vec3::ZERO, Vec3::ONE, [0, 1, 2, 0, 0, 0]);
    triangles.remove(6);
    triangles.extend(quad(Vec3::new(0.2, 0.35, 0.3), Vec3::new(0.4, 0.1, 0.0), Vec3::Z * 0.4, 3));
    let color = |r, g, b| Material { albedo: Vec3::new(r, g, b), ..Material::default() };
    let materials = vec![
        color(0.7, 0.7, 0.7),
        color(0.8, 0.2, 0.1),
        Material { albedo_texture: 0, ..Material::default() },
        Material { albedo_texture: 0, mask_texture: 0, ..Material::default() },
    ];
    // Bright and dark squares, half of the texels holes.
    let texel = |k: u32| {
        let bright = (k + k / 8).is_multiple_of(2);
        let value = if bright { 55_000u32 } else { 9000 };
        [value | (value << 16), (value / 2) | if bright { 0xffff_0000 } else { 0 }]
    };
    let uv = TriangleUv { corner: Vec2::ZERO, corner_a: Vec2::X, corner_b: Vec2::Y, ..TriangleUv::default() };
    Scene::new(SceneParts {
        uvs: vec![uv; triangles.len()],
        triangles,
        materials,
        textures: vec![Texture { offset: 0, width: 8, height: 8, levels: 1 }],
        texels: (0..64).flat_map(texel).collect(),
        lights,
        ..SceneParts::default()
    })
    .unwrap()
}

/// Greatest deviation of two estimates in standard errors, and the relative difference of the light of all cells.
pub fn deviation(maps: &IlluminationMaps, a: &Estimate, b: &Estimate) -> (f64, f64) {
    let mut squares = 0.0;
    let mut cells = 0;
    let mut light = [0.0f64; 2];
    for k in 0..maps.len() {
        let own = [a, b].map(|e| f64::from(scene::math::luminance(e.irradiance[k])));
        let variance = f64::from(a.error[k]).powi(2) + f64::from(b.error[k]).powi(2);
        if variance > 0.0 {
            squares += (own[0] - own[1]).powi(2) / variance;
            cells += 1;
        }
        (0..2).for_each(|n| light[n] += own[n] * f64::from(maps.areas()[k]));
    }
    ((squares / f64::from(cells)).sqrt(), light[0] / light[1] - 1.0)
}
