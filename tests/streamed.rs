//! Streamed worlds: a flight through a bake by native code and, where there is a device, by Vulkan.

use std::path::{Path, PathBuf};

use assets::import::{Animation, LoadedScene};
use assets::procedural;
use glam::Vec3;
use integration_tests::limited::Limited;
use integration_tests::vulkan;
use localmatrix::{BakeFile, LocalSettings};
use patchlight::world::{StreamFrame, StreamSettings, Streamed, WorldSettings, bake, bake_on};
use patchlight::{Picture, Silent};
use runtime::executor::{DeviceChoice, Executor, open};
use scene::Light;
use tempfile::TempDir;

const SIZE: (u32, u32) = (48, 32);
/// Frames of the whole flight, of which the tests show the first.
const FLIGHT_FRAMES: f32 = 24.0;
/// More lights than fit at first.
const MANY_LIGHTS: usize = 20;

/// A scene and its bake.
struct World {
    loaded: LoadedScene,
    file: PathBuf,
    _folder: TempDir,
}

fn world_settings(scene: &str) -> WorldSettings {
    WorldSettings { scene: scene.to_owned(), voxel_size: None, patch_count: 400, rays: 64, seed: 3 }
}

impl World {
    fn new(scene: &str) -> Self {
        let loaded = procedural::build(scene).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("world.bake");
        let settings = world_settings(scene);
        bake(&loaded.scene, loaded.content_hash, &settings, None, &file, 4 << 30, &Silent).unwrap();
        Self { loaded, file, _folder: folder }
    }

    fn stream(&self, executor: Box<dyn Executor>) -> Streamed {
        let settings = StreamSettings {
            local: LocalSettings { slots: 64, changes: 16, ..LocalSettings::default() },
            predicted_frames: 0.0,
            at_rest: true,
            cache: 1 << 20,
            sub_frames: 2,
            size: SIZE,
            is_measured: true,
        };
        let file = BakeFile::open(Path::new(&self.file)).unwrap();
        let scene = self.loaded.scene.clone();
        Streamed::new(scene, self.loaded.content_hash, file, executor, settings).unwrap()
    }

    fn frame(&self, streamed: &mut Streamed, number: u32, lights: &[Light]) -> (Picture, StreamFrame) {
        let path = Animation::fly(&self.loaded);
        let view = path.at(path.duration() * number as f32 / FLIGHT_FRAMES).1;
        let camera = view.camera(SIZE.0, SIZE.1);
        streamed.frame(lights, &camera, self.loaded.exposure_stops).unwrap()
    }

    /// The lights of the scene, each so many times and as much weaker.
    fn lights(&self, copies: usize) -> Vec<Light> {
        let own = &self.loaded.scene.lighting.lights;
        let weaker = own.iter().map(|light| Light { color: light.color / copies as f32, ..*light });
        weaker.collect::<Vec<Light>>().repeat(copies)
    }
}

fn cpu() -> Box<dyn Executor> {
    open(&DeviceChoice::Cpu).unwrap().0
}

/// Root of the mean square of the difference, as a share of that of `b`.
fn distance(a: &Picture, b: &Picture) -> f32 {
    let squares = |values: &mut dyn Iterator<Item = Vec3>| values.map(|d| d.length_squared()).sum::<f32>();
    let pairs = a.pixels.iter().zip(&b.pixels);
    (squares(&mut pairs.map(|(a, b)| *a - *b)) / squares(&mut b.pixels.iter().copied())).sqrt()
}

#[test]
fn rows_of_a_world_that_a_device_traces_have_the_bytes_of_the_hosts() {
    let Some(mut vulkan) = vulkan() else { return };
    let world = World::new("cornell");
    let folder = tempfile::tempdir().unwrap();
    let mut baked = |name: &str, seed: u32| {
        let file = folder.path().join(name);
        let settings = WorldSettings { seed, ..world_settings("cornell") };
        let World { loaded: LoadedScene { scene, content_hash, .. }, .. } = &world;
        bake_on(&mut vulkan, scene, *content_hash, (&settings, None), &file, 4 << 30, &Silent).unwrap();
        assert!(vulkan.plan().passes().iter().any(|pass| pass.name == "rows"), "the device traced rays");
        std::fs::read(file).unwrap()
    };
    let own = std::fs::read(&world.file).unwrap();
    assert!(own == baked("same", 3));
    assert!(own != baked("other", 4), "another seed is another world");
}

#[test]
fn a_device_shows_what_native_code_shows() {
    for scene in ["city:125000", "atrium:3000"] {
        let world = World::new(scene);
        let Some(device) = vulkan() else { return };
        let mut native = world.stream(cpu());
        let mut streamed = world.stream(Box::new(device));
        let mut came = 0;
        for number in 0..4 {
            // The lights change, then there are more of them, then fewer; nodes come and go all the while.
            let lights = world.lights(1 + number as usize % 3 * MANY_LIGHTS);
            let (expected, expected_frame) = world.frame(&mut native, 3 * number, &lights);
            let (picture, frame) = world.frame(&mut streamed, 3 * number, &lights);
            assert_eq!((frame.nodes, &frame.step), (expected_frame.nodes, &expected_frame.step));
            came += if number > 0 { frame.step.entered } else { 0 };
            let error = distance(&picture, &expected);
            println!("{scene}, frame {number}: an error of {error:.1e}, {} nodes came", frame.step.entered);
            assert!(error < 1e-4, "{scene}, frame {number}: {error}");
        }
        assert!(came > 0 || scene != "city:125000", "a flight that changes nothing shows nothing");
    }
}

#[test]
fn more_lights_than_fitted_shine_at_once() {
    let world = World::new("city:125000");
    let lights = world.lights(MANY_LIGHTS);
    let mut grown = world.stream(cpu());
    let (few, _) = world.frame(&mut grown, 0, &world.lights(1));
    let (many, _) = world.frame(&mut grown, 0, &lights);
    let (at_first, _) = world.frame(&mut world.stream(cpu()), 0, &lights);
    assert_eq!(many, at_first);
    // As bright together as one is.
    assert!(distance(&many, &few) < 1e-4);
    assert!(many.pixels.iter().any(|pixel| pixel.length() > 0.0));
}

#[test]
fn pictures_of_worlds_in_bands_are_the_same() {
    let world = World::new("city:125000");
    let lights = world.lights(1);
    let mut whole = world.stream(cpu());
    let mut in_bands = world.stream(Box::new(Limited::new(cpu(), 1 << 14)));
    for number in 0..2 {
        let (expected, at_once) = world.frame(&mut whole, 3 * number, &lights);
        let (picture, frame) = world.frame(&mut in_bands, 3 * number, &lights);
        assert!(picture == expected, "frame {number}");
        assert_eq!((frame.change, frame.behind), (at_once.change, at_once.behind), "frame {number}");
    }
}
