//! Pictures by photons of scenes with a medium that absorbs: closed forms, the path tracer, and air in its place.

use std::ops::ControlFlow;
use std::sync::Arc;

use assets::{LoadedScene, load_or_build};
use glam::Vec3;
use integration_tests::setup::Setup;
use integration_tests::vulkan;
use patchlight::low_level::operator::{Build, Codec};
use patchlight::method::{FeedbackSettings, FirstShotSettings, TemporalSettings};
use patchlight::outputs::{CalculationPlane, LiveProbes, PlaneKind, illuminance};
use patchlight::{
    Bake, ErrorKind, FileSettings, MethodSettings, Origin, Picture, PictureRenderer, Pictures, PixelLight,
    ReceiverKind, Silent,
};
use reference::Accumulation;
use reference::path::{PathSettings, PathTracer};
use runtime::cpu::Cpu;
use runtime::executor::{DeviceKind, Executor};
use scene::math::luminance;
use scene::{Camera, NONE, Scene, SceneParts, SurfacePoint};

/// A hall with columns and lamps under water.
const HALL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/media/hall.toml");
/// Size of its pictures, pixels, and of the squares of them whose means are compared.
const SIZE: (u32, u32) = (40, 30);
const BLOCK: u32 = 5;

/// e to the power x, by double precision: independent of what kernels use.
fn exp(x: f32) -> f32 {
    f64::from(x).exp() as f32
}

fn photons(error: f64, most_photons: u64) -> MethodSettings {
    MethodSettings::FirstShot(FirstShotSettings { error, most_photons, ..FirstShotSettings::default() })
}

/// Copy of a scene, filled with a medium.
fn filled(scene: &Scene, absorption: Vec3) -> Scene {
    let geometry = &scene.geometry;
    let parts = SceneParts {
        triangles: geometry.triangles.clone(),
        uvs: geometry.uvs.clone(),
        materials: geometry.materials.to_vec(),
        textures: geometry.textures.clone(),
        texels: geometry.texels.to_vec(),
        ray_offset: Some(geometry.ray_offset),
        absorption,
        ..SceneParts::default()
    };
    let mut filled = Scene::with_hierarchy(parts, geometry.nodes.clone()).unwrap();
    filled.set_lighting(scene.lighting.clone()).unwrap();
    filled
}

fn filled_cornell(absorption: Vec3) -> LoadedScene {
    let air = load_or_build("cornell").unwrap();
    LoadedScene { scene: filled(&air.scene, absorption), ..air }
}

/// A floor under a lamp, from a file.
fn lamp_over_a_floor(height: f32, absorption: Vec3) -> LoadedScene {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mesh = "mtllib a.mtl\nv -2 0 -2\nv -2 0 2\nv 2 0 2\nv 2 0 -2\nusemtl m\nf 1 2 3 4\n";
    std::fs::write(path("a.obj"), mesh).unwrap();
    std::fs::write(path("a.mtl"), "newmtl m\nKd 0.6 0.5 0.4\n").unwrap();
    let [r, g, b] = absorption.to_array();
    let toml = format!(
        "version = 1\nmesh = \"a.obj\"\n[camera]\neye = [0, 2, 1.5]\ntarget = [0, 0, 0]\nvertical_fov_degrees = 35\n\
         [medium]\nabsorption = [{r:?}, {g:?}, {b:?}]\n\
         [[light]]\ntype = \"point\"\nposition = [0, {height}, 0]\nintensity = [3, 2, 1]\n"
    );
    std::fs::write(path("a.toml"), toml).unwrap();
    load_or_build(path("a.toml").to_str().unwrap()).unwrap()
}

fn pictures(setup: &Setup, loaded: &LoadedScene, bake: &Arc<Bake>, executor: Box<dyn Executor>) -> Pictures {
    let camera = &loaded.view.camera(setup.size.0, setup.size.1);
    let mut renderer = setup.load(loaded, bake, executor).unwrap();
    renderer.picture(&loaded.scene.lighting, camera, 0).unwrap().pictures
}

#[test]
fn a_lamp_over_a_floor_in_a_medium_has_its_closed_form() {
    let absorption = Vec3::new(0.0, 0.3, 0.8);
    let height = 1.5;
    let loaded = lamp_over_a_floor(height, absorption);
    let setup = Setup { method: photons(0.1, 1 << 12), size: (48, 36), ..Setup::coarse() };
    let camera = loaded.view.camera(setup.size.0, setup.size.1);
    let bake = setup.bake(&loaded).unwrap();
    // Where a ray through the middle of a pixel meets the floor, and how far that is.
    let place = |pixel: u32| {
        let x = (pixel % camera.width) as f32 + 0.5;
        let y = (pixel / camera.width) as f32 + 0.5;
        let direction = scene::kernel::camera::camera_direction(&camera, x, y).normalize();
        let distance = -camera.eye.y / direction.y;
        (camera.eye + direction * distance, distance)
    };
    for direct in [PixelLight::Smooth, PixelLight::Sampled] {
        let setup = Setup { direct, sub_frames: 4, ..setup };
        let found = pictures(&setup, &loaded, &bake, Box::new(Cpu::new()));
        // Mean of the ratio less 1 and of its size, and the former without the way to the camera.
        let mut mean = Vec3::ZERO;
        let mut size = Vec3::ZERO;
        let mut without = Vec3::ZERO;
        let mut count = 0.0;
        for (pixel, found) in (0u32..).zip(&found.full.pixels) {
            let (at, distance) = place(pixel);
            // The pixel has no edge of the floor.
            if at.abs().max_element() > 1.6 {
                continue;
            }
            let way = at.distance(Vec3::Y * height);
            let irradiance = Vec3::new(3.0, 2.0, 1.0) * (height / way.powi(3));
            let in_air = Vec3::new(0.6, 0.5, 0.4) * irradiance * std::f32::consts::FRAC_1_PI;
            let error = |way: f32| *found / (in_air * (-absorption * way).map(exp)) - 1.0;
            mean += error(way + distance);
            size += error(way + distance).abs();
            without += error(way);
            count += 1.0;
        }
        let [mean, size, without] = [mean, size, without].map(|sum| (sum / count).abs());
        println!("{direct:?}: mean {mean}, size {size}, without the way to the camera {without}");
        assert!(count > 500.0 && mean.max_element() < 0.01 && size.max_element() < 0.03, "{direct:?}: {mean} {size}");
        assert!(without.y > 0.3 && without.z > 0.3, "{direct:?}: {without}");
    }
}

/// Means of the squares of a picture.
fn blocks(picture: &Picture) -> Vec<Vec3> {
    let columns = SIZE.0 / BLOCK;
    let mut sums = vec![Vec3::ZERO; (columns * SIZE.1 / BLOCK) as usize];
    for (k, pixel) in (0u32..).zip(&picture.pixels) {
        let x = k % SIZE.0 / BLOCK;
        let y = k / SIZE.0 / BLOCK;
        // The lamps themselves would outweigh all else.
        sums[(y * columns + x) as usize] += pixel.min(Vec3::ONE) / (BLOCK * BLOCK) as f32;
    }
    sums
}

/// Ratio of the means less 1, and mean error of the squares, of the channel in which it is greatest.
fn errors(found: &Picture, expected: &Picture) -> (f32, f32) {
    let pairs: Vec<(Vec3, Vec3)> = blocks(found).into_iter().zip(blocks(expected)).collect();
    let sums = pairs.iter().fold((Vec3::ZERO, Vec3::ZERO), |sum, pair| (sum.0 + pair.0, sum.1 + pair.1));
    let mean = (sums.0 / sums.1 - 1.0).abs().max_element();
    let errors: Vec3 = pairs.iter().map(|(found, expected)| (*found - *expected).abs()).sum();
    (mean, (errors / sums.1).max_element())
}

fn traced(scene: &Scene, camera: &Camera, samples: u32) -> Picture {
    let mut accumulation = Accumulation::new(camera, PathSettings::default());
    let ignore_progress = |_, _| ControlFlow::Continue(());
    assert!(PathTracer::new(scene).accumulate(camera, &mut accumulation, samples, ignore_progress).unwrap());
    accumulation.full()
}

fn of_hall() -> Setup {
    Setup {
        patch_count: 600,
        most_receivers: Some(3000),
        receiver_rays: 64,
        size: SIZE,
        seed: 3,
        method: photons(0.02, 1 << 19),
        ..Setup::default()
    }
}

#[test]
fn pictures_by_photons_in_a_medium_are_those_of_the_path_tracer() {
    let loaded = load_or_build(HALL).unwrap();
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let bake = of_hall().bake(&loaded).unwrap();
    let found = pictures(&of_hall(), &loaded, &bake, Box::new(Cpu::new()));
    let expected = traced(&loaded.scene, &camera, 128);
    let (mean, block) = errors(&found.full, &expected);
    let air = filled(&loaded.scene, Vec3::ZERO);
    let in_air = errors(&found.full, &traced(&air, &camera, 16));
    println!("mean {mean:.4}, squares {block:.4}; beside air {in_air:.3?}");
    assert!(mean < 0.02 && block < 0.05, "{mean} {block}");
    assert!(in_air.0 > 0.4 && in_air.1 > 0.4, "air is noticed: {in_air:?}");
    let indirect = found.indirect.pixels.iter().map(|pixel| luminance(*pixel)).sum::<f32>();
    let full = found.full.pixels.iter().map(|pixel| luminance(*pixel)).sum::<f32>();
    assert!(indirect > 0.1 * full, "{indirect} of {full} is indirect");
    let Some(vulkan) = vulkan() else { return };
    let exact = vulkan.device().kind == DeviceKind::EmulatedOnCpu;
    let theirs = pictures(&of_hall(), &loaded, &bake, Box::new(vulkan));
    assert!(!exact || found.full == theirs.full && found.direct == theirs.direct, "host and device differ");
}

#[test]
fn a_medium_that_absorbs_next_to_nothing_leaves_direct_light_as_in_air_in_every_bit() {
    for (name, direct) in [("cornell", PixelLight::Sampled), ("atrium", PixelLight::Smooth)] {
        let air = load_or_build(name).unwrap();
        let setup = Setup { method: photons(0.1, 1 << 13), direct, ..Setup::coarse() };
        let bake = setup.bake(&air).unwrap();
        let of = |absorption: Vec3| {
            // Patches and receivers are the same, whatever is between them.
            let scene = filled(bake.scene(), absorption);
            let bake = Arc::new(Bake::clone(&bake).with_scene(scene));
            pictures(&setup, &air, &bake, Box::new(Cpu::new())).direct
        };
        let expected = of(Vec3::ZERO);
        // So little that of light from the sky all is left, too.
        assert!(of(Vec3::splat(f32::MIN_POSITIVE)) == expected, "{name} {direct:?}");
        assert!(of(Vec3::Y * (0.2 / air.scene.diagonal())) != expected, "{name} {direct:?}: a medium is noticed");
    }
}

#[test]
fn what_goes_by_form_factors_refuses_a_medium() {
    let loaded = filled_cornell(Vec3::splat(0.1));
    let bake = Setup::coarse().bake(&loaded).unwrap();
    assert_eq!((bake.energy(), bake.scene().geometry.absorption), (None, Vec3::splat(0.1)));
    let methods = [
        (MethodSettings::Classic, "classic"),
        (MethodSettings::Multibounce(Codec::LowRank { epsilon: 0.1 }), "low_rank"),
        (MethodSettings::Multibounce(Codec::Dense), "multibounce"),
        (MethodSettings::Feedback(FeedbackSettings::default()), "feedback"),
        (MethodSettings::Temporal(TemporalSettings::default()), "temporal"),
    ];
    for (method, name) in methods {
        let refused = Setup { method, ..Setup::coarse() }.load(&loaded, &bake, Box::new(Cpu::new())).err().unwrap();
        assert!(refused.to_string().starts_with(&format!("{name} goes by form factors")), "{name}: {refused}");
        assert!(refused.to_string().contains("firstshot"), "{refused}");
    }
    let shot = Setup { method: photons(0.1, 1 << 10), ..Setup::coarse() };
    let mut renderer = shot.load(&loaded, &bake, Box::new(Cpu::new())).unwrap();
    let refused = LiveProbes::new(renderer.light_mut(), 8, 16, &Silent).err().unwrap();
    assert_eq!(refused.kind(), ErrorKind::Unsupported, "{refused}");
    let pixels = Setup { receivers: ReceiverKind::Pixels, method: photons(0.1, 1 << 10), ..Setup::coarse() };
    let refused = pixels.renderer(&loaded, Box::new(Cpu::new())).err().unwrap();
    assert!(refused.to_string().starts_with("photons in a medium"), "{refused}");
}

#[test]
fn a_bake_in_a_file_keeps_its_medium() {
    let loaded = filled_cornell(Vec3::new(0.1, 0.2, 0.3));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fog.bake");
    let into = |methods: Vec<MethodSettings>| {
        let origin = Origin { scene: "fog".to_owned(), scene_hash: [7; 32], application: b"{}".to_vec() };
        let bake = Setup::coarse().bake_settings();
        let settings = FileSettings { origin, bake, methods, build: Build::default() };
        Bake::build_into(&path, &loaded.scene, &settings, &mut Cpu::new(), &Silent)
    };
    let refused = into(vec![MethodSettings::Multibounce(Codec::Dense)]).err().unwrap();
    assert!(refused.kind() == ErrorKind::Unsupported && refused.to_string().contains("the medium"), "{refused}");
    let built = Arc::new(into(Vec::new()).unwrap());
    let opened = Arc::new(Bake::open(&path).unwrap().bake);
    assert_eq!(opened.scene().geometry.absorption, Vec3::new(0.1, 0.2, 0.3));
    let setup = Setup { method: photons(0.1, 1 << 14), ..Setup::coarse() };
    let camera = loaded.view.camera(setup.size.0, setup.size.1);
    let of = |bake: &Arc<Bake>| {
        let mut renderer = setup.load(&loaded, bake, Box::new(Cpu::new())).unwrap();
        renderer.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures.full
    };
    assert!(of(&opened) == of(&built));
}

/// Light in the air by rays through the medium.
#[test]
fn a_calculation_plane_in_a_medium_has_the_light_of_the_path_tracer() {
    let loaded = load_or_build(HALL).unwrap();
    let plane = CalculationPlane { kind: PlaneKind::Horizontal, height: 0.8, spacing: 1.0, area: None };
    let mut renderer: PictureRenderer = of_hall().renderer(&loaded, Box::new(Cpu::new())).unwrap();
    renderer.update_light(&loaded.scene.lighting, &loaded.view.camera(1, 1)).unwrap();
    let light = plane.light(renderer.light_mut()).unwrap();
    let points: Vec<SurfacePoint> = (0..light.lux.len() as u32)
        .map(|k| SurfacePoint { position: light.place(k), patch: NONE, normal: Vec3::Y, weight: 1.0 })
        .collect();
    let expected = PathTracer::new(&loaded.scene).irradiance(&points, 512, &PathSettings::default());
    let lit =
        light.lux.iter().zip(&expected).filter_map(|(lux, e)| lux.map(|lux| (lux, illuminance(e.direct + e.indirect))));
    let mut found = 0.0;
    let mut sum = 0.0;
    for (lux, expected) in lit {
        found += lux;
        sum += expected;
    }
    println!("{found} lx for {sum} lx");
    assert!((found / sum - 1.0).abs() < 0.02, "{found} {sum}");
}
