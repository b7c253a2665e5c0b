//! Kopylov's published variants: algorithm 1, Cardano's formula, direct light at corners.

mod support;

use std::ops::ControlFlow;

use glam::{Vec2, Vec3};
use patchlight_firstshot::{
    Cubic, Emission, IlluminationMaps, LightElement, LightElementSettings, PhotonSettings, Sequences, Subdivision,
    Texels, Tracer, corner_light, light_elements,
};
use scene::gpu::{LIGHT_DIRECTIONAL, Triangle};
use scene::{Light, Scene};
use support::*;

/// Light elements after one split of a triangle as Kopylov prints it, B and C at ±1 m of the corner A's height `apex`
/// above BC, with a lamp 0.05 m over the share `along` of the way from A to the middle of BC.
fn split_once(apex: f32, along: f32) -> (Scene, Vec<LightElement>) {
    let a = Vec3::Z * -apex;
    let b = Vec3::new(-1.0, 0.0, 0.0);
    let c = Vec3::X;
    let triangle = Triangle { corner: a, edge_a: b - a, edge_b: c - a, ..Triangle::default() };
    let lamp = bulb(Vec3::new(0.0, 0.05, -apex * (1.0 - along)));
    let scene = scene(vec![triangle], vec![grey(0.5)], vec![lamp]);
    let settings =
        LightElementSettings { subdivision: Subdivision::Kopylov, depth: 1, ..LightElementSettings::default() };
    let elements = light_elements(&scene, &settings, &ignore_progress).unwrap().elements;
    (scene, elements)
}

/// Returns true if an element has a corner at these shares.
fn has_corner(element: &LightElement, at: Vec2) -> bool {
    element.corners.iter().any(|corner| corner.distance(at) < 1e-6)
}

#[test]
fn the_printed_subdivision_makes_three_two_or_four() {
    let middle = Vec2::splat(1.0 / 3.0);
    let half_of_longest = Vec2::splat(0.5);
    // No obtuse angle: three that meet in the middle.
    let (_, three) = split_once(1.7, 2.0 / 3.0);
    assert!(three.len() == 3 && three.iter().all(|e| has_corner(e, middle)), "{three:?}");
    // Obtuse at A. The light bends most in the middle: two that share the cut from A to the middle of BC.
    let (_, two) = split_once(0.3, 2.0 / 3.0);
    let is_cut = |e: &LightElement| has_corner(e, half_of_longest) && has_corner(e, Vec2::ZERO);
    assert!(two.len() == 2 && two.iter().all(is_cut), "{two:?}");
    // It bends most on BC: four, three of which meet in the middle of BC.
    let (_, four) = split_once(0.3, 1.0);
    assert_eq!((four.len(), four.iter().filter(|e| has_corner(e, half_of_longest)).count()), (4, 3));
    assert!(four.iter().any(|e| [Vec2::X * 0.5, Vec2::Y * 0.5, half_of_longest].iter().all(|&at| has_corner(e, at))));
    for elements in [three, two, four] {
        let share: f32 =
            elements.iter().map(|e| (e.corners[1] - e.corners[0]).perp_dot(e.corners[2] - e.corners[0])).sum();
        assert!((share - 1.0).abs() < 1e-5, "all turn the same way and cover the triangle: {share}");
    }
}

#[test]
fn the_printed_subdivision_has_the_light_of_a_lamp_and_leaves_even_light_whole() {
    let scene = plate(0.5, vec![bulb(Vec3::new(0.3, 0.5, 0.2))]);
    let of = |settings: LightElementSettings| light_elements(&scene, &settings, &ignore_progress).unwrap();
    let light = |elements: &[LightElement]| elements.iter().map(|e| f64::from(e.mean() * e.area)).sum::<f64>();
    let with = |tolerance: f32| LightElementSettings { tolerance, ..LightElementSettings::default() };
    let truth = light(&of(with(0.001)).elements);
    let printed = |tolerance: f32| of(with(tolerance).as_printed());
    // The middle of an element says less of its light than edges do: 2 % too much with a tolerance of 5 %, less with
    // less.
    for (tolerance, off) in [(0.05, 0.03), (0.02, 0.006), (0.005, 0.002)] {
        let found = printed(tolerance);
        for (name, found) in [("ours", of(with(tolerance))), ("printed", printed(tolerance))] {
            let off = light(&found.elements) / truth - 1.0;
            let count = found.elements.len();
            println!("{tolerance} {name}: {count} elements, {} shadow rays, light {off:.5} off", found.shadow_rays);
        }
        assert!((light(&found.elements) / truth - 1.0).abs() < off, "{tolerance}");
        let is_even = |e: &LightElement| (e.middle - e.mean()).abs() <= tolerance * e.top();
        assert!(found.elements.iter().all(is_even), "{tolerance}");
    }
    let coarse = of(LightElementSettings { depth: 1, ..with(0.005).as_printed() });
    assert!((light(&coarse.elements) / truth - 1.0).abs() > 0.03, "one split is not enough");
    let sun = Light { kind: LIGHT_DIRECTIONAL, direction: Vec3::NEG_Y, color: COLOR, ..Light::default() };
    let even = plate(0.5, vec![sun]);
    let whole = light_elements(&even, &LightElementSettings::default().as_printed(), &ignore_progress).unwrap();
    // Three corners and the middle of each triangle.
    assert_eq!((whole.elements.len(), whole.shadow_rays), (2, 8));
}

#[test]
fn light_at_corners_is_that_of_the_lamp() {
    let height = 0.5;
    let lamp = Vec3::new(0.3, 0.5, 0.2);
    let scene = plate(0.5, vec![bulb(lamp)]);
    let found = corner_light(&scene);
    assert_eq!((found.irradiance.len(), found.shadow_rays), (2, 6));
    for (t, corners) in found.irradiance.iter().enumerate() {
        for (light, (u, v)) in corners.iter().zip([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]) {
            let distance = scene.tables().position(t as u32, u, v).distance(lamp);
            let expected = COLOR * (height / distance.powi(3));
            // Corners are looked at a thousandth inwards.
            assert!((*light / expected - 1.0).abs().max_element() < 5e-3, "{light} {expected}");
        }
    }
}

#[test]
fn cardanos_formula_starts_photons_where_newtons_method_does() {
    let scene = room_with_a_window(lights());
    let emission = first_shot(&scene);
    let maps = IlluminationMaps::new(&scene, 0.25).unwrap();
    let of = |cubic| trace(&scene, &emission, &maps, PhotonSettings { cubic, batches: 16, ..photons(1 << 18) });
    let newton = of(Cubic::Newton);
    let cardano = of(Cubic::Cardano);
    assert!(newton.irradiance != cardano.irradiance, "another formula, other roundings");
    // The same photons but for starts on the edge of a shadow: far nearer than independent ones.
    let (sigma, all) = deviation(&maps, &cardano, &newton);
    assert!(sigma < 0.3 && all.abs() < 1e-3, "{sigma} {all}");
    let others = trace(&scene, &emission, &maps, PhotonSettings { seed: 1, batches: 16, ..photons(1 << 18) });
    assert!(deviation(&maps, &others, &newton).0 > 0.6);
}

#[test]
fn all_that_is_printed_finds_the_light_with_about_as_many_photons() {
    let scene = room_with_a_window(lights());
    let maps = IlluminationMaps::new(&scene, 0.25).unwrap();
    let table = LightElementSettings { tolerance: 0.02, ..LightElementSettings::table_alone() };
    let ours = LightElementSettings::default();
    let ways = [
        ("ours", ours, Texels::Mean, true, Cubic::Newton, Sequences::Sobol),
        ("random numbers", ours, Texels::Mean, true, Cubic::Newton, Sequences::Random),
        ("algorithm 1", ours.as_printed(), Texels::Mean, true, Cubic::Newton, Sequences::Sobol),
        ("Cardano's formula", ours, Texels::Mean, true, Cubic::Cardano, Sequences::Sobol),
        ("brightest texel", ours, Texels::Bound, true, Cubic::Newton, Sequences::Sobol),
        ("table alone", table, Texels::Mean, false, Cubic::Newton, Sequences::Sobol),
        ("all as printed", table.as_printed(), Texels::Bound, false, Cubic::Cardano, Sequences::Sobol),
    ];
    let corners = corner_light(&scene);
    println!("direct light at corners: {} shadow rays", corners.shadow_rays);
    let truth = trace(&scene, &first_shot(&scene), &maps, PhotonSettings { seed: 9, ..photons(1 << 21) });
    let mut counts = Vec::new();
    for (name, elements, texels, is_exact, cubic, sequences) in ways {
        let emission = Emission::first_shot(&scene, &elements, texels, is_exact, &ignore_progress).unwrap();
        let settings = PhotonSettings { error: 0.02, batches: 16, cubic, sequences, ..PhotonSettings::default() };
        let mut tracer = Tracer::new(&scene, &emission, &maps, settings).unwrap();
        tracer.run(&|_| ControlFlow::Continue(()));
        let found = tracer.estimate();
        let all = deviation(&maps, &found, &truth).1;
        let photons = found.round.photons;
        let registered = found.round.registered;
        let count = emission.elements.len();
        let rays = emission.shadow_rays;
        println!(
            "{name}: {count} elements, {rays} shadow rays, {photons} photons, {registered} hits, light {all:.4} off"
        );
        assert!(found.round.error <= 0.02 && all.abs() < 0.03, "{name}: {all}");
        counts.push(photons as f64);
    }
    let most = counts.iter().copied().fold(0.0, f64::max);
    let least = counts.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(most < 3.0 * least, "{counts:?}");
}
