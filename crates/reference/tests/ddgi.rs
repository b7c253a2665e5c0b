//! Probes with irradiance and visibility in scenes whose light is known.

use std::ops::ControlFlow;

use assets::LoadedScene;
use assets::procedural::build;
use glam::{Vec3, Vec3Swizzles, vec2, vec3};
use reference::{Ddgi, DdgiSettings, Error, PathSettings, PathTracer, Spacing, ViewedPoint};
use scene::kernel::camera::{primary_direction, primary_hit, surface_point};
use scene::math::luminance;
use scene::{Lighting, NONE, SurfacePoint};

/// Pixels along the edge of the pictures at whose points light is asked for.
const EDGE: u32 = 16;

/// What the pixels see of the scene.
fn points(loaded: &LoadedScene) -> Vec<ViewedPoint> {
    let camera = loaded.view.camera(EDGE, EDGE);
    let tables = loaded.scene.tables();
    let point = |pixel: u32| {
        let hit = primary_hit(&tables, &camera, pixel, 0);
        let direction = primary_direction(&camera, pixel, 0);
        let SurfacePoint { position, normal, .. } = surface_point(&tables, hit, direction);
        (!hit.is_miss()).then_some(ViewedPoint { position, normal, to_eye: -direction })
    };
    (0..EDGE * EDGE).filter_map(point).collect()
}

fn spaced(metres: f32) -> DdgiSettings {
    DdgiSettings { spacing: Spacing::Metres(metres), ..DdgiSettings::default() }
}

/// Indirect irradiance after so many frames in the dark and then in the scene's light.
fn light(loaded: &LoadedScene, settings: DdgiSettings, dark: u32, frames: u32) -> Vec<Vec3> {
    let mut ddgi = Ddgi::new(&loaded.scene, settings).unwrap();
    let go_on = |_, _| ControlFlow::Continue(());
    assert!(ddgi.settle(&Lighting::default(), 1000, dark, go_on).unwrap());
    assert!(ddgi.settle(&loaded.scene.lighting, 0, frames, go_on).unwrap());
    ddgi.irradiance_at(&points(loaded))
}

/// Mean luminance of `found` over that of `expected`, and the median of the relative errors.
fn compare(found: &[Vec3], expected: &[Vec3]) -> (f32, f32) {
    assert_eq!(found.len(), expected.len());
    let sum = |values: &[Vec3]| values.iter().map(|h| luminance(*h)).sum::<f32>();
    let error = |(f, e): (&Vec3, &Vec3)| (luminance(*f) / luminance(*e) - 1.0).abs();
    let mut errors: Vec<f32> = found.iter().zip(expected).map(error).collect();
    errors.sort_by(f32::total_cmp);
    (sum(found) / sum(expected), errors[errors.len() / 2])
}

/// A box that shines with M = 1 and reflects ρ = ½ has H = ρ M/(1 − ρ) = 1 after a reflection or more, and M/(1 − ρ) with
/// what comes straight. Known bias: a root is taken of noisy sums before they are averaged, which darkens them by up to 8 % here,
/// where emitters are found by one shadow ray from each hit.
#[test]
fn a_furnace_has_the_light_of_all_bounces() {
    let loaded = build("furnace").unwrap();
    let is_furnace = |values: &[Vec3]| {
        let (mean, median) = compare(values, &vec![Vec3::ONE; values.len()]);
        (0.92..1.02).contains(&mean) && median < 0.08
    };
    let settled = light(&loaded, spaced(0.5), 0, 120);
    assert!(is_furnace(&settled), "{:?}", compare(&settled, &vec![Vec3::ONE; settled.len()]));
    assert!(!is_furnace(&light(&loaded, spaced(0.5), 0, 3)), "missing bounces go unnoticed");
}

/// One update from the dark is one bounce. Known bias: irradiance is interpolated between probes.
#[test]
fn one_bounce_is_that_of_the_path_tracer() {
    let loaded = build("cornell").unwrap();
    let points = points(&loaded);
    let surface = |p: &ViewedPoint| SurfacePoint { position: p.position, patch: NONE, normal: p.normal, weight: 1.0 };
    let surface: Vec<SurfacePoint> = points.iter().map(surface).collect();
    let settings = PathSettings { bounces: 1, ..PathSettings::default() };
    let traced = PathTracer::new(&loaded.scene).irradiance(&surface, 2048, &settings);
    let expected: Vec<Vec3> = traced.iter().map(|p| p.indirect).collect();
    let mean = |frames: u32| {
        let mut sums = vec![Vec3::ZERO; points.len()];
        for seed in 0..16 {
            let settings = DdgiSettings { rays: 288, seed, ..spaced(0.07) };
            let found = light(&loaded, settings, 0, frames);
            sums.iter_mut().zip(found).for_each(|(sum, h)| *sum += h / 16.0);
        }
        sums
    };
    let is_right = |(ratio, median): (f32, f32)| (ratio - 1.0).abs() < 0.1 && median < 0.15;
    let one = compare(&mean(1), &expected);
    assert!(is_right(one), "{one:?}");
    let more = compare(&mean(4), &expected);
    assert!(!is_right(more), "more bounces go unnoticed: {more:?}");
}

#[test]
fn threads_do_not_change_a_bit() {
    let loaded = build("cornell").unwrap();
    let with = |threads: usize, seed: u32| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| light(&loaded, DdgiSettings { seed, ..spaced(0.2) }, 0, 3))
    };
    let one = with(1, 0);
    assert_eq!(one, with(2, 0));
    assert_ne!(one, with(2, 1), "another seed goes unnoticed");
}

#[test]
fn the_start_is_forgotten() {
    let loaded = build("cornell").unwrap();
    let is_alike = |frames: u32| {
        let [afresh, later] = [0, 40].map(|dark| light(&loaded, spaced(0.2), dark, frames));
        let (ratio, median) = compare(&later, &afresh);
        (ratio - 1.0).abs() < 0.01 && median < 0.01
    };
    assert!(is_alike(400));
    assert!(!is_alike(4), "a start that is not forgotten goes unnoticed");
}

/// Greatest luminance in a closed box in the sun, whose walls have no thickness, over that outside. Probes outside stay on; none
/// is so close to a wall that its texels see it at a slant.
fn leak(visibility: bool) -> f32 {
    let loaded = build("sealed-box").unwrap();
    let settings =
        DdgiSettings { visibility, two_sided: true, relocation: false, classification: false, ..spaced(1.25) };
    let mut ddgi = Ddgi::new(&loaded.scene, settings).unwrap();
    assert!(ddgi.settle(&loaded.scene.lighting, 0, 40, |_, _| ControlFlow::Continue(())).unwrap());
    let brightest = |values: Vec<Vec3>| values.iter().map(|h| luminance(*h)).fold(0.0, f32::max);
    let outside = ViewedPoint { position: vec3(1.0, 1.5, 0.0), normal: Vec3::X, to_eye: Vec3::X };
    brightest(ddgi.irradiance_at(&points(&loaded))) / brightest(ddgi.irradiance_at(&[outside]))
}

#[test]
fn visibility_keeps_most_light_out_of_a_sealed_box() {
    let (with, without) = (leak(true), leak(false));
    // What is left is known: the texels of a probe cannot tell the two sides of a wall without thickness apart at a slant.
    let is_tight = |leak: f32| leak < 0.25;
    assert!(is_tight(with), "{with}");
    assert!(!is_tight(without) && without > 1.5 * with, "leaks without visibility go unnoticed: {without}");
}

/// Whether a place is well inside of the tall block of the Cornell box.
fn is_in_block(p: Vec3) -> bool {
    p.y < 0.3 && (p.xz() - vec2(0.3685, 0.3515)).abs().max_element() < 0.05
}

#[test]
fn probes_inside_of_things_are_off() {
    let loaded = build("cornell").unwrap();
    let active_inside = |settings: DdgiSettings| {
        let ddgi = Ddgi::new(&loaded.scene, settings).unwrap();
        let inside: Vec<bool> =
            ddgi.probes().filter(|(p, _)| is_in_block(*p)).map(|(_, is_active)| is_active).collect();
        assert_eq!(ddgi.probes().filter(|(_, is_active)| *is_active).count(), ddgi.probe_counts().1);
        (inside.len(), inside.iter().filter(|&&is_active| is_active).count())
    };
    let fine = DdgiSettings { relocation: false, ..spaced(0.05) };
    let (inside, active) = active_inside(fine);
    assert!(inside > 4 && active == 0, "{active} of {inside}");
    let (_, active) = active_inside(DdgiSettings { classification: false, ..fine });
    assert_eq!(active, inside, "probes that are not classified go unnoticed");
}

#[test]
fn relocation_moves_probes_away_from_surfaces() {
    let loaded = build("cornell").unwrap();
    let places = |relocation: bool| {
        let ddgi = Ddgi::new(&loaded.scene, DdgiSettings { relocation, ..spaced(0.11) }).unwrap();
        ddgi.probes().map(|(p, _)| p).collect::<Vec<_>>()
    };
    let (moved, home) = (places(true), places(false));
    let furthest = moved.iter().zip(&home).map(|(a, b)| (*a - *b).length()).fold(0.0, f32::max);
    assert!(furthest > 0.01 && furthest < 0.45 * 0.11 * 1.001, "{furthest}");
}

#[test]
fn grids_have_the_number_that_is_asked_for() {
    let loaded = build("office").unwrap();
    let count = |spacing: Spacing| {
        let settings = DdgiSettings { spacing, ..DdgiSettings::default() };
        Ddgi::new(&loaded.scene, settings).map(|ddgi| ddgi.probe_counts().0)
    };
    for target in [64, 1000] {
        let found = count(Spacing::Probes(target)).unwrap() as f32 / target as f32;
        assert!((0.8..=1.0).contains(&found), "{target}: {found}");
    }
    // 9.7 × 2.8 × 6 m.
    assert_eq!(count(Spacing::Metres(1.0)).unwrap(), 10 * 3 * 6);
    for wrong in [Spacing::Metres(0.0), Spacing::Metres(f32::NAN), Spacing::Metres(0.01), Spacing::Probes(0)] {
        assert!(matches!(count(wrong), Err(Error::Setting { .. })), "{wrong:?}");
    }
}

#[test]
fn settings_out_of_range_are_refused() {
    let loaded = build("cornell").unwrap();
    let refused = |settings| matches!(Ddgi::new(&loaded.scene, settings), Err(Error::Setting { .. }));
    let sound = spaced(0.3);
    for wrong in [
        DdgiSettings { rays: 0, ..sound },
        DdgiSettings { hysteresis: 1.0, ..sound },
        DdgiSettings { bias: f32::NAN, ..sound },
        DdgiSettings { exponent: -1.0, ..sound },
    ] {
        assert!(refused(wrong), "{wrong:?}");
    }
    assert!(!refused(sound));
}
