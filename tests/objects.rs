//! Objects that move through a bake: beside path tracing of the scene with the object in its place.

use assets::import::LoadedScene;
use assets::procedural;
use glam::{Affine3A, Vec3};
use integration_tests::setup::Setup;
use integration_tests::vulkan;
use patchlight::{PictureRenderer, Pictures, ReceiverUpdate};
use reference::{Accumulation, PathSettings, PathTracer, Strategy};
use runtime::executor::{DeviceChoice, Executor, open};
use scene::math::luminance;
use scene::{Material, MaterialId, Mesh, Picture, Scene, SceneParts};

const SIZE: (u32, u32) = (128, 96);
/// Edge of the blocks that are compared, pixels.
const BLOCK: u32 = 4;

fn cpu() -> Box<dyn Executor> {
    open(&DeviceChoice::Cpu).unwrap().0
}

fn setup() -> Setup {
    Setup { patch_count: 1000, most_receivers: Some(8000), receiver_rays: 512, sub_frames: 8, size: SIZE, ..Setup::default() }
}

/// The 36 corners of a box about the origin.
fn corners(half: Vec3) -> Vec<Vec3> {
    let mut all = Vec::new();
    for axis in 0..3 {
        for sign in [-1.0f32, 1.0] {
            let mut n = Vec3::ZERO;
            n[axis] = sign;
            let mut u = Vec3::ZERO;
            u[(axis + 1) % 3] = sign;
            let mut v = Vec3::ZERO;
            v[(axis + 2) % 3] = 1.0;
            let at = |a: f32, b: f32| (n + u * a + v * b) * half;
            all.extend([at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]);
        }
    }
    all
}

/// A built-in scene with one more material, red, which the objects have.
fn scene_with_red(name: &str) -> (LoadedScene, MaterialId) {
    let mut loaded = procedural::build(name).unwrap();
    let g = &loaded.scene.geometry;
    let mut materials = g.materials.to_vec();
    let red = MaterialId::of_scene(materials.len());
    materials.push(Material { albedo: Vec3::new(0.8, 0.1, 0.1), ..Material::default() });
    let parts = SceneParts {
        triangles: g.triangles.clone(),
        uvs: g.uvs.clone(),
        materials,
        textures: g.textures.clone(),
        texels: g.texels.to_vec(),
        ray_offset: Some(g.ray_offset),
        ..SceneParts::default()
    };
    let mut lighting = loaded.scene.lighting.clone();
    if !lighting.emission.is_empty() {
        lighting.emission.push(Vec3::ZERO);
    }
    let made = Scene::new(parts).unwrap();
    loaded.scene = Scene::under(made.geometry.clone(), lighting).unwrap();
    (loaded, red)
}

fn with_box(loaded: &LoadedScene, mesh: Mesh, transform: Affine3A) -> Scene {
    let mut edit = loaded.scene.edit();
    edit.add(Mesh { transform, ..mesh });
    edit.build().unwrap()
}

fn traced(scene: &Scene, loaded: &LoadedScene, samples: u32) -> Accumulation {
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let settings = PathSettings { strategy: Strategy::Both, ..PathSettings::default() };
    let mut sums = Accumulation::new(&camera, settings);
    PathTracer::new(scene).accumulate(&camera, &mut sums, samples, |_, _| std::ops::ControlFlow::Continue(())).unwrap();
    sums
}

fn picture_of(renderer: &mut PictureRenderer, loaded: &LoadedScene) -> Pictures {
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    renderer.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures
}

/// Mean difference of the luminance of blocks, over the mean of what is expected.
fn difference(found: &Picture, expected: &Picture) -> f32 {
    let (found, expected) = (found.block_means(BLOCK), expected.block_means(BLOCK));
    let pairs = found.pixels.iter().zip(&expected.pixels);
    let apart: f32 = pairs.map(|(a, b)| (luminance(*a) - luminance(*b)).abs()).sum();
    apart / expected.pixels.iter().map(|c| luminance(*c)).sum::<f32>()
}

#[test]
fn an_object_takes_and_gives_light_as_paths_say() {
    for (name, half, at) in [
        ("cornell", Vec3::new(0.06, 0.05, 0.06), Vec3::new(0.4, 0.0502, 0.06)),
        ("office", Vec3::new(0.3, 0.8, 0.3), Vec3::new(0.0, 0.81, 0.0)),
    ] {
        let (loaded, red) = scene_with_red(name);
        println!("{name} bounds {:?} eye {:?}", loaded.scene.geometry.bounds, loaded.view.eye);
        let positions = corners(half);
        let mesh = Mesh { positions: &positions, material: red, ..Mesh::default() };
        let transform = Affine3A::from_rotation_translation(glam::Quat::from_rotation_y(0.4), at);
        let expected = traced(&with_box(&loaded, mesh, transform), &loaded, 256);
        let without = traced(&loaded.scene, &loaded, 256);
        let mut renderer = setup().renderer(&loaded, cpu()).unwrap();
        let bare = picture_of(&mut renderer, &loaded);
        renderer.light_mut().objects().insert(&mesh, transform).unwrap();
        let found = picture_of(&mut renderer, &loaded);
        for (part, found, bare, expected, without) in [
            ("direct", &found.direct, &bare.direct, expected.direct(), without.direct()),
            ("indirect", &found.indirect, &bare.indirect, expected.indirect(), without.indirect()),
        ] {
            let mean = |p: &Picture| luminance(p.mean());
            println!(
                "{name} {part}: wrong {:.4} bare {:.4} change {:.4} energy {:.4} bare energy {:.4}",
                difference(found, &expected),
                difference(bare, &without),
                difference(&without, &expected),
                mean(found) / mean(&expected),
                mean(bare) / mean(&without),
            );
            if let Ok(folder) = std::env::var("OBJECTS_OUT") {
                for (kind, picture) in [("found", found), ("expected", &expected)] {
                    let path = format!("{folder}/{name}-{part}-{kind}.ppm");
                    let mut text = format!("P3 {} {} 255\n", SIZE.0, SIZE.1);
                    for c in &picture.pixels {
                        let c = (*c * 1.0 / (mean(&expected) * 2.5)).clamp(Vec3::ZERO, Vec3::ONE);
                        text += &c.to_array().map(|x| ((x.powf(1.0 / 2.2)) * 255.0) as u32).map(|x| x.to_string()).join(" ");
                        text += "\n";
                    }
                    std::fs::write(path, text).unwrap();
                }
            }
        }
    }
}
