//! Probes without visibility in scenes whose light is known.

#[path = "support/points.rs"]
mod viewed;

use assets::LoadedScene;
use assets::procedural::build;
use glam::Vec3;
use opponents::{IrradianceVolume, Spacing, ViewedPoint, VolumeSettings};
use reference::Error;
use viewed::{compare, points, traced};

fn spaced(metres: f32) -> VolumeSettings {
    VolumeSettings { spacing: Spacing::Metres(metres), ..VolumeSettings::default() }
}

fn light(loaded: &LoadedScene, settings: VolumeSettings, points: &[ViewedPoint]) -> Vec<Vec3> {
    let mut volume = IrradianceVolume::new(&loaded.scene, settings).unwrap();
    volume.bake(&loaded.scene.lighting).unwrap();
    volume.irradiance_at(points)
}

#[test]
fn a_furnace_has_the_light_of_all_bounces() {
    let loaded = build("furnace").unwrap();
    let points = points(&loaded);
    for bands in [1, 2] {
        let found = light(&loaded, VolumeSettings { bands, ..spaced(0.5) }, &points);
        let is_furnace = |expected: f32| {
            let (mean, median) = compare(&found, &vec![Vec3::splat(expected); points.len()]);
            (mean - 1.0).abs() < 0.02 && median < 0.03
        };
        assert!(is_furnace(1.0), "{:?}", compare(&found, &vec![Vec3::ONE; points.len()]));
        assert!(!is_furnace(0.9), "a bounce too few goes unnoticed");
    }
}

/// Known bias: light is interpolated between probes, through everything.
#[test]
fn light_is_near_that_of_the_path_tracer() {
    let loaded = build("cornell").unwrap();
    let points = points(&loaded);
    let expected = traced(&loaded, &points, u32::MAX, 512);
    let is_near = |settings| {
        let (ratio, median) = compare(&light(&loaded, settings, &points), &expected);
        (ratio - 1.0).abs() < 0.1 && median < 0.1
    };
    assert!(is_near(spaced(0.07)));
    assert!(!is_near(spaced(0.5)), "probes that are too far apart go unnoticed");
    // The second band brings a volume nearer.
    let error = |bands| compare(&light(&loaded, VolumeSettings { bands, ..spaced(0.1) }, &points), &expected).1;
    assert!(error(2) < error(1), "{} {}", error(2), error(1));
}

#[test]
fn threads_do_not_change_a_bit() {
    let loaded = build("cornell").unwrap();
    let points = points(&loaded);
    let with = |threads: usize, seed: u32| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| light(&loaded, VolumeSettings { seed, rays: 64, ..spaced(0.2) }, &points))
    };
    assert_eq!(with(1, 0), with(3, 0));
    assert_ne!(with(1, 0), with(1, 1), "another seed goes unnoticed");
}

#[test]
fn settings_out_of_range_are_refused() {
    let loaded = build("cornell").unwrap();
    let refused = |settings| matches!(IrradianceVolume::new(&loaded.scene, settings), Err(Error::Setting { .. }));
    for wrong in [
        VolumeSettings { bands: 0, ..spaced(0.2) },
        VolumeSettings { bands: 3, ..spaced(0.2) },
        VolumeSettings { rays: 0, ..spaced(0.2) },
        spaced(0.0),
    ] {
        assert!(refused(wrong), "{wrong:?}");
    }
    assert!(!refused(spaced(0.2)));
}
