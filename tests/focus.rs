//! Viewing areas with close patches and receivers, and the bake's estimate of its own errors.

use std::sync::Arc;

use assets::{LoadedScene, procedural};
use glam::{Vec3, vec3};
use integration_tests::setup::Setup;
use patches::{Density, Focus, PackedWeights, Weight};
use patchlight::{Bake, BakeSettings, EnergyCheck, Estimator, LightSettings, PictureRenderer, PictureSettings, Silent};
use reference::{PathSettings, PathTracer};
use runtime::cpu::Cpu;
use scene::math::luminance;
use scene::sampling::{hash3, unit};
use scene::{NONE, SurfacePoint, Visibility as _};

/// Patches of a bake.
const COUNT: usize = 1000;
/// Paths of the path tracer at a point.
const PATHS: u32 = 8192;
/// Points at which errors are measured.
const POINTS: u32 = 200;

fn settings(focus: Focus) -> BakeSettings {
    let setup = Setup {
        patch_count: COUNT,
        estimator: Estimator::Hemisphere { rays: 1024 },
        receiver_rays: 64,
        ..Setup::default()
    };
    setup.bake_settings().with_focus(focus).with_receiver_density(0.1)
}

fn bake(loaded: &LoadedScene, focus: Focus) -> Bake {
    Bake::build(&loaded.scene, &settings(focus), &Silent).unwrap()
}

/// Hits of rays in all directions from a place.
fn points_about(loaded: &LoadedScene, eye: Vec3) -> Vec<SurfacePoint> {
    let scene = &loaded.scene;
    let direction = |k: u32| vec3(unit(hash3(k, 0, 7)), unit(hash3(k, 1, 7)), unit(hash3(k, 2, 7))) * 2.0 - 1.0;
    let point = |k: u32| {
        let direction = direction(k).try_normalize()?;
        let hit = scene.closest(eye, direction);
        let is_near = !hit.is_miss() && hit.t < 10.0;
        let front = is_near.then(|| scene.tables().normal(hit.triangle))?;
        let normal = if front.dot(direction) < 0.0 { front } else { -front };
        Some(SurfacePoint { position: eye + direction * hit.t, patch: NONE, normal, weight: 1.0 })
    };
    (0..POINTS).filter_map(point).collect()
}

fn truth(loaded: &LoadedScene, points: &[SurfacePoint]) -> Vec<f32> {
    let found = PathTracer::new(&loaded.scene).irradiance(points, PATHS, &PathSettings::default());
    found.iter().map(|p| luminance(p.indirect)).collect()
}

/// Mean error of indirect light at points, as a share of its mean.
fn error(loaded: &LoadedScene, bake: Bake, points: &[SurfacePoint], truth: &[f32]) -> f32 {
    let light = LightSettings::default();
    let pictures = PictureSettings::default().with_size((16, 9)).with_sub_frames(1);
    let mut renderer =
        PictureRenderer::of_bake(Arc::new(bake), Box::new(Cpu::new()), &light, &pictures, &Silent).unwrap();
    renderer.picture(&loaded.scene.lighting, &loaded.view.camera(16, 9), 0).unwrap();
    let ours = renderer.light_mut().irradiance_at(points).unwrap();
    let errors: f32 = ours.iter().zip(truth).map(|(o, t)| (luminance(*o) - t).abs()).sum();
    errors / truth.iter().sum::<f32>()
}

/// Patches of a bake that lie in or about a box.
fn patches_about(bake: &Bake, (low, high): (Vec3, Vec3)) -> usize {
    let is_about = |p: Vec3| p.cmpge(low - 0.5).all() && p.cmple(high + 0.5).all();
    bake.mesh().patches.iter().filter(|patch| is_about(patch.centroid)).count()
}

/// Adding 1 km of ground takes few patches, and errors grow at most so many times; shared out by area, the same patches
/// are far worse.
fn check_ground(name: &str, eye: Vec3, most: f32) -> [usize; 3] {
    let without = procedural::build(name).unwrap();
    let with = procedural::build(&format!("{name}:ground=1000")).unwrap();
    let points = points_about(&without, eye);
    let (low, high) = with.scene.geometry.bounds;
    let bakes = [bake(&without, Focus::Auto), bake(&with, Focus::Auto), bake(&with, Focus::Box { low, high })];
    let counts = [0, 1, 2].map(|k| patches_about(&bakes[k], without.scene.geometry.bounds));
    println!("{name}: {counts:?} patches about it: alone, on ground, by area");
    assert!(counts[1] as f32 > 0.7 * counts[0] as f32, "{name}: {counts:?}");

    let [alone, on_ground, by_area] = bakes;
    let alone = error(&without, alone, &points, &truth(&without, &points));
    let own_truth = truth(&with, &points);
    let on_ground = error(&with, on_ground, &points, &own_truth);
    let by_area = error(&with, by_area, &points, &own_truth);
    println!(
        "{name}: {:.2} % alone, {:.2} % on ground, {:.2} % by area",
        100.0 * alone,
        100.0 * on_ground,
        100.0 * by_area
    );
    // Both errors hold about 1 % of noise, of rays here and paths there.
    assert!(on_ground < most * alone + 0.01, "{name}");
    assert!(by_area > 1.5 * on_ground, "{name}");
    counts
}

#[test]
fn a_plane_of_1_km_round_rooms_takes_no_patches_from_them() {
    // Light in the second room is what comes round from the ground; a quarter of the patches is there.
    check_ground("rooms", vec3(6.0, 1.3, 2.0), 1.5);
}

#[test]
fn a_plane_of_1_km_round_the_office_takes_no_patches_from_it() {
    let eye = procedural::build("office").unwrap().view.eye;
    let [alone, _, by_area] = check_ground("office", eye, 1.1);
    assert!((by_area as f32) < 0.3 * alone as f32, "{by_area} of {alone}");
}

#[test]
fn the_ground_does_not_lift_rays() {
    for name in ["rooms", "office", "stripes", "cornell"] {
        let without = procedural::build(name).unwrap();
        let with = procedural::build(&format!("{name}:ground=1000")).unwrap();
        let diagonal = without.scene.geometry.diagonal();
        assert_eq!(without.scene.geometry.ray_offset, 2e-5 * diagonal, "{name}");
        assert!(with.scene.geometry.ray_offset < 2.5e-3, "{name}: {}", with.scene.geometry.ray_offset);
    }
}

#[test]
fn the_focus_is_where_it_was_asked_for() {
    let loaded = procedural::build("rooms:ground=1000").unwrap();
    let first_room = Focus::seen_from(&loaded.scene, &[vec3(1.0, 1.3, 3.0)]);
    let Focus::Box { low, high } = first_room else { panic!("nothing is seen") };
    assert!(low.min_element() > -3.0 && high.max_element() < 12.0, "{low} {high}");
    let density = Density::new(&loaded.scene, first_room, 0).unwrap();
    let levels = [0.0, 10.0, 50.0, 400.0].map(|x: f32| density.level(vec3(2.0 - x, 0.0, 2.0)));
    assert!(levels[0] == 0 && levels.is_sorted() && levels[3] > levels[1], "{levels:?}");
    // Enclosed space is that of the rooms; a box may be anywhere.
    let enclosed = Density::new(&loaded.scene, Focus::Auto, 0).unwrap();
    assert_eq!(enclosed.level(vec3(4.0, 1.0, 2.0)), 0);
    assert!(enclosed.level(vec3(-400.0, 0.0, 2.0)) > 3);
    let far = Focus::Box { low: vec3(-410.0, 0.0, 0.0), high: vec3(-400.0, 5.0, 10.0) };
    let density = Density::new(&loaded.scene, far, 0).unwrap();
    assert!(density.level(vec3(-405.0, 0.0, 5.0)) == 0 && density.level(vec3(4.0, 1.0, 2.0)) > 3);
    let none = Focus::Box { low: Vec3::ONE, high: Vec3::ZERO };
    let error = Density::new(&loaded.scene, none, 0).unwrap_err().to_string();
    assert!(error.contains("focus") && error.contains("-1"), "{error}");
}

#[test]
fn scenes_without_far_ground_are_the_same_everywhere() {
    for name in ["cornell", "atrium:3000", "office", "stripes"] {
        let loaded = procedural::build(name).unwrap();
        let density = Density::new(&loaded.scene, Focus::Auto, 0).unwrap();
        let edges = loaded.scene.geometry.triangles.iter().map(|t| density.triangle_edge(t));
        assert!(edges.clone().all(|edge| edge == 1.0), "{name}: {}", edges.fold(0.0, f32::max));
    }
}

/// A bake is right by its own account, and says so when it is damaged.
#[test]
fn a_damaged_bake_says_so() {
    for name in ["furnace", "cornell", "office"] {
        let loaded = procedural::build(name).unwrap();
        let sound = bake(&loaded, Focus::Auto);
        let check = sound.energy().unwrap();
        let near = check.near.unwrap();
        let unseen = check.unseen.unwrap();
        println!("{name}: {check:?}");
        assert!(check.balance.abs() < 0.02, "{name}: {check:?}");
        for part in [near, unseen] {
            assert!((part.ratio - 1.0).abs() < 0.03 + 3.0 * part.standard_error, "{name}: {check:?}");
        }

        let mut brighter = sound.form_factors().clone();
        let factors = Arc::make_mut(&mut brighter.factors);
        factors.values.iter_mut().for_each(|value| *value *= 1.05);
        let found = EnergyCheck::of(&sound.clone().with_form_factors(brighter)).unwrap().unwrap();
        assert!(found.balance > check.balance + 0.03, "{name}: {found:?}");

        let mut dim = sound.receivers().clone();
        let whole = &dim.weights;
        let dimmed = |weight: Weight| Weight { weight: 0.9 * weight.weight, ..weight };
        let dimmed = PackedWeights::new(whole.rows(), |k| whole.row(k).into_iter().map(dimmed).collect());
        dim.weights = Arc::new(dimmed.unwrap());
        let found = EnergyCheck::of(&sound.with_receivers(dim)).unwrap().unwrap();
        // Weights are rounded to steps of 1/128.
        for (found, sound) in [(found.near, near), (found.unseen, unseen)] {
            assert!((found.unwrap().ratio / sound.ratio - 0.9).abs() < 5e-3, "{name}: {found:?}");
        }
    }
}
