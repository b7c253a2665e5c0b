//! A lamp in a grey room: indirect light by first shot, beside the closed form of the mean.

use std::ops::ControlFlow;

use glam::Vec3;
use patchlight_firstshot::{
    Emission, IlluminationMaps, LightElementSettings, PhotonAccumulator, PhotonSettings, Texels, Tracer,
};
use scene::gpu::{LIGHT_POINT, Triangle, TriangleUv};
use scene::{Light, Material, Scene, SceneParts};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // A cube of 2 m, fronts inside.
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for side in [-1.0f32, 1.0] {
            let turned = |x: f32, y: f32| {
                let mut p = [side; 3];
                (p[(axis + 1) % 3], p[(axis + 2) % 3]) = if side < 0.0 { (x, y) } else { (y, x) };
                Vec3::from(p)
            };
            for [a, b, c] in [[(-1., -1.), (1., -1.), (-1., 1.)], [(1., 1.), (-1., 1.), (1., -1.)]] {
                let a = turned(a.0, a.1);
                let b = turned(b.0, b.1);
                let c = turned(c.0, c.1);
                triangles.push(Triangle { corner: a, edge_a: b - a, edge_b: c - a, ..Triangle::default() });
            }
        }
    }
    let lamp = Light { kind: LIGHT_POINT, color: Vec3::splat(10.0), ..Light::default() };
    let scene = Scene::new(SceneParts {
        uvs: vec![TriangleUv::default(); triangles.len()],
        triangles,
        materials: vec![Material { albedo: Vec3::splat(0.6), ..Material::default() }],
        lights: vec![lamp],
        ..SceneParts::default()
    })?;
    let ignore_progress = |_, _| ControlFlow::Continue(());
    let emission =
        Emission::first_shot(&scene, &LightElementSettings::default(), Texels::Mean, true, &ignore_progress)?;
    let maps = IlluminationMaps::new(&scene, 0.5)?;
    let mut tracer = Tracer::new(&scene, &emission, &maps, PhotonSettings { error: 0.02, ..Default::default() })?;
    tracer.run(&|_| ControlFlow::Continue(()));
    let found = tracer.estimate();
    let power: f32 = found.irradiance.iter().zip(maps.areas()).map(|(h, area)| h.y * area).sum();
    let expected = 4.0 * std::f32::consts::PI * 10.0 / 24.0 * 0.6 / (1.0 - 0.6);
    println!("{} photons: {:.3} W/m², {expected:.3} by the closed form", found.round.photons, power / 24.0);
    Ok(())
}
