//! Temporal radiosity through the whole pipeline, on the CPU and, where there is a device, on Vulkan.

use std::sync::Arc;

use assets::import::{Animation, LoadedScene};
use assets::procedural;
use glam::Vec3;
use integration_tests::setup::{Setup, furnace_error};
use integration_tests::vulkan;
use patches::PatchKind;
use patchlight::light::with_lights;
use patchlight::low_level::operator::Codec;
use patchlight::method::TemporalSettings;
use patchlight::method::temporal::{RowKind, Sampled};
use patchlight::{Bake, Estimator, MethodSettings, Pictures, ReceiverKind};
use runtime::executor::{DeviceChoice, Executor, open};
use scene::Light;
use scene::math::luminance;
use temporal::{Blend, Settings};

const SIZE: (u32, u32) = (48, 36);

fn settings(patches: PatchKind, receivers: ReceiverKind) -> Setup {
    Setup {
        patches,
        patch_count: 250,
        estimator: Estimator::Hemisphere { rays: 512 },
        receivers,
        receiver_rays: 128,
        most_receivers: Some(3000),
        sub_frames: 4,
        seed: 3,
        size: SIZE,
        ..Setup::default()
    }
}

fn bake(loaded: &LoadedScene, patches: PatchKind, receivers: ReceiverKind) -> Arc<Bake> {
    settings(patches, receivers).bake(loaded).unwrap()
}

/// Settings that a bake is rendered with.
fn loader(method: MethodSettings) -> Setup {
    Setup { method, sub_frames: 4, size: SIZE, ..Setup::default() }
}

fn cpu() -> Box<dyn Executor> {
    open(&DeviceChoice::Cpu).unwrap().0
}

fn distance(a: &[Vec3], b: &[Vec3]) -> f32 {
    let squares = |pairs: &mut dyn Iterator<Item = Vec3>| pairs.map(|d| d.length_squared()).sum::<f32>();
    (squares(&mut a.iter().zip(b).map(|(a, b)| *a - *b)) / squares(&mut b.iter().copied())).sqrt()
}

/// Other lights than the scene's own.
fn away(loaded: &LoadedScene) -> Vec<Light> {
    let path = Animation::or_default_path(loaded);
    path.at(path.duration() / 3.0).0
}

/// Light of some frames with other lights, then of so many with the scene's own: what surfaces receive in each of them,
/// and the last picture.
fn frames(
    loaded: &LoadedScene,
    bake: &Arc<Bake>,
    method: MethodSettings,
    executor: Box<dyn Executor>,
    count: u32,
) -> (Vec<Vec<Vec3>>, Pictures) {
    let mut light = loader(method).load(loaded, bake, executor).unwrap();
    let away = with_lights(&loaded.scene, &away(loaded));
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    (0..4).for_each(|_| drop(light.advance(&away, &camera).unwrap()));
    let lights = &loaded.scene.lighting;
    let mut shown = vec![light.light_mut().surface_irradiance().unwrap()];
    for _ in 0..count {
        light.advance(lights, &camera).unwrap();
        shown.push(light.light_mut().surface_irradiance().unwrap());
    }
    let pictures = light.picture(lights, &camera, 0).unwrap().pictures;
    (shown, pictures)
}

/// Settings under test, with the control variate and without.
fn variants() -> Vec<TemporalSettings> {
    let settings = Settings::default();
    let without = Settings { samples: 32, control_variate: false, ..settings };
    let fixed = Settings { blend: Blend::Fixed(0.6), rotated: false, ..without };
    vec![
        TemporalSettings { settings, rows: RowKind::Lists, sampled: Sampled::Patches },
        TemporalSettings { settings, rows: RowKind::Tables, sampled: Sampled::All },
        TemporalSettings { settings: without, rows: RowKind::Tables, sampled: Sampled::Patches },
        TemporalSettings { settings: fixed, rows: RowKind::Lists, sampled: Sampled::All },
        TemporalSettings { settings, rows: RowKind::AllBounces, sampled: Sampled::Patches },
    ]
}

#[test]
fn light_follows_a_jump_and_comes_to_rest_at_that_of_exact_products() {
    let loaded = procedural::build("cornell").unwrap();
    for (patches, receivers) in [(PatchKind::Cluster, ReceiverKind::Mesh), (PatchKind::Axis, ReceiverKind::Patches)] {
        let bake = bake(&loaded, patches, receivers);
        for temporal in variants() {
            // The operator of all bounces comes from form factors that were made reciprocal.
            let exact = match temporal.rows {
                RowKind::AllBounces => MethodSettings::Multibounce(Codec::Dense),
                _ => MethodSettings::Classic,
            };
            let (exact, _) = frames(&loaded, &bake, exact, cpu(), 1);
            let before = &exact[0];
            let rest = &exact[1];
            let jump = distance(before, rest);
            assert!(jump > 0.1, "the lights do not jump: {jump}");
            let (shown, _) = frames(&loaded, &bake, MethodSettings::Temporal(temporal), cpu(), 100);
            let left = |k: usize| distance(&shown[k], rest) / jump;
            let change = distance(&shown[100], &shown[99]);
            println!(
                "{patches:?} {temporal:?}: before {:.4}, after 8 {:.4}, 100 {:.5}, change {change:.1e}",
                distance(&shown[0], before),
                left(8),
                left(100)
            );
            // Settled before the first frame, with exact sums.
            assert!(distance(&shown[0], before) < 0.1, "{temporal:?}");
            // How much of the jump has arrived: noise, which has all directions, hardly counts.
            let arrived = |k: usize| {
                let along = |now: &[Vec3]| -> f32 {
                    now.iter().zip(before).zip(rest).map(|((h, a), b)| (*h - *a).dot(*b - *a)).sum()
                };
                along(&shown[k]) / along(rest)
            };
            // Averages hold back the later bounces, which are one a frame anyway.
            let least = if temporal.settings.control_variate { 0.9 } else { 0.85 };
            let first = arrived(0);
            let then = arrived(8);
            assert!((least..1.1).contains(&then) && first < 0.1, "{temporal:?}: {first}, {then}");
            if temporal.settings.control_variate {
                // The noise of a jump stays in a row until it is summed exactly, once in 16 frames; rows of all bounces
                // are longer.
                let soon = if temporal.rows == RowKind::AllBounces { 0.2 } else { 0.1 };
                // Lists share the entries of real rows out to 1,024.
                assert!(left(8) < soon && left(100) < 0.01 && shown[100] == shown[99], "{temporal:?}: {change}");
            } else {
                // Noise stays, of a fifth of the jump at most, but about the right light: sixty frames that go on by
                // 0.6 count as fifteen, and bring it to a twentieth.
                let mean = |k: usize| shown[41..].iter().map(|light| light[k]).sum::<Vec3>() / 60.0;
                let mean: Vec<Vec3> = (0..rest.len()).map(mean).collect();
                let error = distance(&mean, rest) / jump;
                assert!(error < 0.1 && change > 0.0, "{temporal:?}: {error}");
            }
            // The light of before is distinguished.
            assert!(left(0) > 0.5);
        }
    }
}

#[test]
fn both_executors_and_two_runs_give_the_same_bits() {
    let loaded = procedural::build("atrium:3000").unwrap();
    let bake = bake(&loaded, PatchKind::Cluster, ReceiverKind::Mesh);
    for temporal in variants() {
        let transport = MethodSettings::Temporal(temporal);
        let (ours, pictures) = frames(&loaded, &bake, transport, cpu(), 20);
        assert_eq!(frames(&loaded, &bake, transport, cpu(), 20), (ours.clone(), pictures), "{temporal:?}");
        let other = TemporalSettings { settings: Settings { seed: 1, ..temporal.settings }, ..temporal };
        assert_ne!(frames(&loaded, &bake, MethodSettings::Temporal(other), cpu(), 1).0[1], ours[1]);
        let Some(vulkan) = vulkan() else { continue };
        let is_emulated = vulkan.device().kind == runtime::executor::DeviceKind::EmulatedOnCpu;
        let (theirs, _) = frames(&loaded, &bake, transport, Box::new(vulkan), 20);
        let difference = distance(&theirs[20], &ours[20]);
        // Other devices may round divisions otherwise, and then other samples of the light are no other.
        assert!(if is_emulated { theirs == ours } else { difference < 1e-3 }, "{temporal:?}: {difference}");
    }
}

#[test]
fn white_furnace() {
    let loaded = procedural::build("furnace").unwrap();
    let bake = bake(&loaded, PatchKind::Polygon, ReceiverKind::Mesh);
    for temporal in variants() {
        let mut light = loader(MethodSettings::Temporal(temporal)).load(&loaded, &bake, cpu()).unwrap();
        let lights = &loaded.scene.lighting;
        let camera = loaded.view.camera(SIZE.0, SIZE.1);
        (0..10).for_each(|_| drop(light.advance(lights, &camera).unwrap()));
        let pictures = light.picture(lights, &camera, 0).unwrap().pictures;
        let error = furnace_error(&loaded, &pictures);
        println!("{temporal:?}: {error}");
        assert!(error < 0.01, "{temporal:?}: {error}");
        let mut darker = pictures;
        darker.full.pixels.iter_mut().for_each(|p| *p *= 0.98);
        assert!(furnace_error(&loaded, &darker) > 0.01);
    }
}

#[test]
fn the_inside_of_a_sealed_box_in_the_sun_stays_dark() {
    let loaded = procedural::build("sealed-box").unwrap();
    let bake = bake(&loaded, PatchKind::Polygon, ReceiverKind::Mesh);
    let outside =
        loaded.scene.lighting.lights.iter().map(|l| luminance(l.color)).fold(0.0, f32::max) / std::f32::consts::PI;
    for temporal in variants() {
        let (_, pictures) = frames(&loaded, &bake, MethodSettings::Temporal(temporal), cpu(), 10);
        let pixels = &pictures.full.pixels;
        let inside = pixels.iter().map(|p| luminance(*p)).sum::<f32>() / pixels.len() as f32;
        assert!(outside > 0.0 && inside < 1e-4 * outside, "{temporal:?}: inside {inside}, outside {outside}");
    }
}

#[test]
fn settings_out_of_their_range_are_refused() {
    let loaded = procedural::build("cornell").unwrap();
    let bake = bake(&loaded, PatchKind::Polygon, ReceiverKind::Mesh);
    for settings in
        [Settings { samples: 0, ..Settings::default() }, Settings { blend: Blend::Fixed(1.0), ..Settings::default() }]
    {
        let transport = MethodSettings::Temporal(TemporalSettings { settings, ..TemporalSettings::default() });
        let refused = loader(transport).load(&loaded, &bake, cpu());
        let message = refused.err().expect("a refusal").to_string();
        assert!(message.contains("must be"), "{message}");
    }
}
