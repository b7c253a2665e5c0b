//! DDGI as native code and on devices.

use assets::procedural;
use experiments::probes::DeviceDdgi;
use glam::Vec3;
use opponents::{Ddgi, DdgiSettings, Spacing, ViewedPoint};
use reference::Error;
use runtime::cpu::Cpu;
use runtime::executor::{DeviceChoice, DeviceKind, Executor, open};
use scene::Light;

/// Frames under the scene's lights, and then under moved ones.
const FRAMES: u32 = 2;

fn settings(seed: u32) -> DdgiSettings {
    DdgiSettings { spacing: Spacing::Metres(0.2), rays: 32, seed, ..DdgiSettings::default() }
}

/// Points on the floor and the back wall of the Cornell box.
fn points() -> Vec<ViewedPoint> {
    let place = |k: u32| 0.03 + 0.06 * (k as f32);
    let to_eye = Vec3::new(0.1, 0.2, -0.9).normalize();
    let on_floor =
        |k: u32| ViewedPoint { position: Vec3::new(place(k % 9), 0.0, place(k / 9)), normal: Vec3::Y, to_eye };
    let on_wall =
        |k: u32| ViewedPoint { position: Vec3::new(place(k % 9), place(k / 9), 0.559), normal: Vec3::NEG_Z, to_eye };
    (0..81).map(on_floor).chain((0..81).map(on_wall)).collect()
}

fn moved(lights: &[Light]) -> Vec<Light> {
    lights
        .iter()
        .map(|light| Light { position: light.position + Vec3::X * 0.05, color: light.color * 2.0, ..*light })
        .collect()
}

/// Irradiance at the points after the frames, W/m².
fn on_host(seed: u32) -> Vec<Vec3> {
    let loaded = procedural::build("cornell").unwrap();
    let mut lighting = loaded.scene.lighting.clone();
    let mut probes = Ddgi::new(&loaded.scene, settings(seed)).unwrap();
    for frame in 0..2 * FRAMES {
        if frame == FRAMES {
            lighting.lights = moved(&lighting.lights);
        }
        probes.update(&lighting, frame).unwrap();
    }
    probes.irradiance_at(&points())
}

fn on_device(executor: Box<dyn Executor>) -> Vec<Vec3> {
    let loaded = procedural::build("cornell").unwrap();
    let mut lights = loaded.scene.lighting.lights.clone();
    let mut probes = DeviceDdgi::new(&loaded.scene, settings(0), executor, &points()).unwrap();
    for frame in 0..2 * FRAMES {
        if frame == FRAMES {
            lights = moved(&lights);
        }
        probes.update(&lights, frame).unwrap();
    }
    probes.look_up_view().unwrap();
    probes.irradiance_at(&points()).unwrap()
}

fn greatest_difference(found: &[Vec3], expected: &[Vec3]) -> f32 {
    let brightest = expected.iter().map(|h| h.max_element()).fold(0.0, f32::max);
    let differences = found.iter().zip(expected).map(|(a, b)| (*a - *b).abs().max_element());
    differences.fold(0.0, f32::max) / brightest
}

#[test]
fn the_native_executor_gives_the_bits_of_the_host() {
    let expected = on_host(0);
    assert!(expected.iter().all(|h| h.min_element() > 0.0));
    assert_eq!(on_device(Box::new(Cpu::new())), expected);
    assert_ne!(on_host(1), expected, "other rays go unnoticed");
}

#[test]
fn a_vulkan_device_gives_the_light_of_the_host() {
    let executor = match open(&DeviceChoice::Vulkan) {
        Ok((executor, _)) => executor,
        Err(error) => {
            assert!(std::env::var_os("REQUIRE_VULKAN").is_none(), "REQUIRE_VULKAN is set: {error}");
            println!("skipped: {error}");
            return;
        }
    };
    // Other devices divide less exactly, and a ray that grazes an edge may fall on its other side.
    let tolerance = if executor.device().kind == DeviceKind::EmulatedOnCpu { 0.0 } else { 0.01 };
    let expected = on_host(0);
    let found = on_device(executor);
    assert!(greatest_difference(&found, &expected) <= tolerance, "{}", greatest_difference(&found, &expected));
    assert!(greatest_difference(&on_host(1), &expected) > 0.01, "other rays go unnoticed");
}

#[test]
fn more_lights_than_there_is_room_for_are_refused() {
    let loaded = procedural::build("cornell").unwrap();
    let lights = &loaded.scene.lighting.lights;
    let mut probes = DeviceDdgi::new(&loaded.scene, settings(0), Box::new(Cpu::new()), &points()).unwrap();
    probes.update(lights, 0).unwrap();
    let error = probes.update(&[&lights[..], &lights[..]].concat(), 1).unwrap_err();
    let experiments::Error::Shell(shell::Error::Reference(error)) = error else { panic!("{error}") };
    assert!(matches!(error, Error::Setting { name: "lights", value: 2.0, .. }), "{error}");
}
