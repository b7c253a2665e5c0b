//! Light propagation volumes in scenes whose light is known.

mod support;
#[path = "support/points.rs"]
mod viewed;

use assets::LoadedScene;
use assets::procedural::build;
use glam::{Vec3, vec3};
use opponents::{Lpv, LpvSettings, ViewedPoint};
use reference::Error;
use scene::Light;
use scene::gpu::LIGHT_POINT;
use scene::math::luminance;
use support::Builder;
use viewed::{compare, points, traced};

/// One grid.
fn cells(cells: u32) -> LpvSettings {
    LpvSettings { cells, cascades: 1, texels: 1 << 14, ..LpvSettings::default() }
}

/// Indirect irradiance at points.
fn light(loaded: &LoadedScene, settings: LpvSettings, points: &[ViewedPoint]) -> Vec<Vec3> {
    let mut lpv = Lpv::new(&loaded.scene, settings).unwrap();
    lpv.update(&loaded.scene.lighting).unwrap();
    lpv.irradiance_at(points)
}

/// Known bias: two bands blur light over a cell and more, blockers let a part through.
#[test]
fn one_bounce_is_near_that_of_the_path_tracer() {
    let loaded = build("office").unwrap();
    let points = points(&loaded);
    let expected = traced(&loaded, &points, 1, 512);
    let is_near = |settings: LpvSettings| {
        let (ratio, median) = compare(&light(&loaded, settings, &points), &expected);
        (ratio - 1.0).abs() < 0.1 && median < 0.35
    };
    let one = LpvSettings { bounces: false, ..cells(16) };
    assert!(is_near(one));
    assert!(!is_near(LpvSettings { occlusion: false, ..one }), "missing blockers go unnoticed");
    assert!(!is_near(LpvSettings { steps: 2, ..one }), "light that does not get far goes unnoticed");
}

#[test]
fn further_bounces_add_light() {
    let loaded = build("cornell").unwrap();
    let points = points(&loaded);
    let [one, more] = [false, true].map(|bounces| light(&loaded, LpvSettings { bounces, ..cells(16) }, &points));
    let (ratio, _) = compare(&more, &one);
    // The path tracer has about 1.7.
    assert!((1.15..2.0).contains(&ratio), "{ratio}");
}

/// H = 1 of all bounces. Known bias: what blockers let through leaves the box.
#[test]
fn a_furnace_has_much_of_the_light() {
    let loaded = build("furnace").unwrap();
    let points = points(&loaded);
    let ratio = |settings| compare(&light(&loaded, settings, &points), &vec![Vec3::ONE; points.len()]).0;
    let is_furnace = |ratio: f32| (0.6..1.05).contains(&ratio);
    assert!(is_furnace(ratio(cells(8))), "{}", ratio(cells(8)));
    let one = ratio(LpvSettings { bounces: false, ..cells(8) });
    assert!(!is_furnace(one), "missing bounces go unnoticed: {one}");
}

/// A floor with a wall across it, one metre thick, and a lamp on one side: light on the floor of the other.
fn light_behind_wall(occlusion: bool) -> f32 {
    let mut b = Builder::default();
    let white = b.material(Vec3::splat(0.6), Vec3::ZERO);
    let z = 16.0 * Vec3::Z;
    let up = 8.0 * Vec3::Y;
    b.quad(Vec3::ZERO, z, 16.0 * Vec3::X, white);
    b.quad(7.5 * Vec3::X, z, up, white).quad(8.5 * Vec3::X, up, z, white);
    b.light(Light { kind: LIGHT_POINT, position: vec3(4.0, 3.0, 8.0), color: Vec3::splat(100.0), ..Light::default() });
    let mut lpv = Lpv::new(&b.build(), LpvSettings { occlusion, ..cells(16) }).unwrap();
    lpv.update(&b.build().lighting).unwrap();
    let point = |x: f32| ViewedPoint { position: vec3(x, 0.0, 8.0), normal: Vec3::Y, to_eye: Vec3::Y };
    lpv.irradiance_at(&[10.0, 12.0, 14.0].map(point)).iter().map(|h| luminance(*h)).sum()
}

#[test]
fn it_is_darker_behind_a_blocker() {
    let with = light_behind_wall(true);
    let without = light_behind_wall(false);
    let is_darker = |light: f32| light < 0.4 * without;
    assert!(is_darker(with), "{with} of {without}");
    // In two bands a lobe stops three quarters of the light that meets it upright.
    assert!(with > 0.0 && !is_darker(without));
}

#[test]
fn threads_do_not_change_a_bit() {
    let loaded = build("cornell").unwrap();
    let points = points(&loaded);
    let with = |threads: usize, settings: LpvSettings| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| light(&loaded, settings, &points))
    };
    assert_eq!(with(1, cells(8)), with(3, cells(8)));
    assert_ne!(with(1, cells(8)), with(1, LpvSettings { texels: 1000, ..cells(8) }), "other lights go unnoticed");
}

#[test]
fn finer_grids_lie_about_the_eye() {
    let loaded = build("atrium:3000").unwrap();
    let eye = loaded.view.eye;
    let nested = LpvSettings { cells: 16, cascades: 3, eye, texels: 1 << 14, ..LpvSettings::default() };
    let lpv = Lpv::new(&loaded.scene, nested).unwrap();
    let edges: Vec<f32> = lpv.grids().map(|(_, edge)| edge).collect();
    assert!((edges[1] / edges[0] - 2.0).abs() < 1e-5 && (edges[2] / edges[1] - 2.0).abs() < 1e-5, "{edges:?}");
    assert!(lpv.grids().all(|(counts, _)| counts.into_iter().max() == Some(16)));
    // Far from the eye the coarsest alone has light; near it the finer ones see less of the scene.
    let points = points(&loaded);
    let far = |p: &&ViewedPoint| (p.position - eye).abs().max_element() > 8.0 * edges[1] + 4.0 * edges[1];
    let far: Vec<ViewedPoint> = points.iter().filter(far).copied().collect();
    assert!(!far.is_empty());
    let coarse = light(&loaded, LpvSettings { cascades: 1, ..nested }, &far);
    assert_eq!(light(&loaded, nested, &far), coarse);
    assert_ne!(light(&loaded, nested, &points), light(&loaded, LpvSettings { cascades: 1, ..nested }, &points));
}

#[test]
fn settings_out_of_range_are_refused() {
    let loaded = build("cornell").unwrap();
    let refused = |settings| matches!(Lpv::new(&loaded.scene, settings), Err(Error::Setting { .. }));
    for wrong in [
        LpvSettings { cells: 0, ..cells(8) },
        LpvSettings { cells: 1000, ..cells(8) },
        LpvSettings { cascades: 0, ..cells(8) },
        LpvSettings { texels: 0, ..cells(8) },
        LpvSettings { steps: 0, ..cells(8) },
        LpvSettings { eye: Vec3::NAN, ..cells(8) },
    ] {
        assert!(refused(wrong), "{wrong:?}");
    }
    assert!(!refused(cells(8)));
}
