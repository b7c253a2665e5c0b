//! Hierarchical radiosity: closed forms, occlusion, the number of links.

use formfactor::Error;
use glam::{Vec2, Vec3};
use scene::gpu::{Triangle, TriangleUv};
use scene::{Material, Scene, SceneParts};
use solvers::{HierarchicalScene, HierarchicalSettings, HierarchicalSolution, hierarchical};

/// Two triangles; the front is the side of `a × b`.
fn quad(corner: Vec3, a: Vec3, b: Vec3) -> [[Vec3; 3]; 2] {
    [[corner, corner + a, corner + b], [corner + a + b, corner + b, corner + a]]
}

/// Unit squares one metre apart that face each other.
fn parallel_squares() -> Vec<[Vec3; 3]> {
    [quad(Vec3::ZERO, Vec3::X, Vec3::Y), quad(Vec3::Z, Vec3::Y, Vec3::X)].concat()
}

/// A box with its fronts inside.
fn room(size: Vec3) -> Vec<[Vec3; 3]> {
    let x = Vec3::X * size.x;
    let y = Vec3::Y * size.y;
    let z = Vec3::Z * size.z;
    [
        quad(Vec3::ZERO, y, z),
        quad(size, -z, -y),
        quad(Vec3::ZERO, z, x),
        quad(size, -x, -z),
        quad(Vec3::ZERO, x, y),
        quad(size, -y, -x),
    ]
    .concat()
}

fn scene(triangles: &[[Vec3; 3]]) -> Scene {
    let triangles: Vec<Triangle> = triangles
        .iter()
        .map(|[a, b, c]| Triangle { corner: *a, edge_a: *b - *a, edge_b: *c - *a, ..Triangle::default() })
        .collect();
    let uvs = vec![TriangleUv::default(); triangles.len()];
    Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..SceneParts::default() }).unwrap()
}

fn settings(error: f32, least_area: f32) -> HierarchicalSettings {
    HierarchicalSettings { error, least_area, shadow_rays: 16, tolerance: 1e-5, seed: 0 }
}

/// Solves for the first triangles, with whatever stands in the scene between them.
fn solve(
    scene: &Scene,
    triangles: &[[Vec3; 3]],
    light: &(dyn Fn(usize, Vec2) -> (Vec3, Vec3) + Sync),
    settings: &HierarchicalSettings,
) -> HierarchicalSolution {
    let ray_offset = scene.geometry.ray_offset;
    hierarchical(&HierarchicalScene { triangles, visibility: scene, ray_offset, light }, settings).unwrap()
}

/// The lower square shines, nothing reflects.
fn lower_shines(triangle: usize, _: Vec2) -> (Vec3, Vec3) {
    (if triangle < 2 { Vec3::ONE } else { Vec3::ZERO }, Vec3::ZERO)
}

#[test]
fn parallel_squares_exchange_their_form_factor() {
    let squares = parallel_squares();
    let scene = scene(&squares);
    // Howell C-11, and B-4 four times for the middle of the square.
    let mean = 0.199_825;
    let middle = 0.239_495;
    let at_middle = |found: &HierarchicalSolution| found.irradiance(2, Vec2::splat(0.499)).x;
    for error in [10.0, 1e-3, 1e-5] {
        let found = solve(&scene, &squares, &lower_shines, &settings(error, 1e-3));
        let above = 0.5 * (found.mean(2) + found.mean(3)).x;
        // The form factors of the links are exact, so is their sum.
        assert!((above / mean - 1.0).abs() < 1e-3, "{error}: {above}");
        assert!(found.mean(0) == Vec3::ZERO, "nothing reflects");
        if error < 1e-3 {
            assert!((at_middle(&found) / middle - 1.0).abs() < 0.01, "{}", at_middle(&found));
        }
    }
    // Whole triangles know no middle.
    let whole = solve(&scene, &squares, &lower_shines, &settings(10.0, 1e-3));
    assert!(whole.leaves == 4 && whole.links == 4 && (at_middle(&whole) / middle - 1.0).abs() > 0.1);
}

#[test]
fn the_white_furnace_is_even() {
    let room = room(Vec3::new(1.0, 2.0, 3.0));
    let scene = scene(&room);
    for albedo in [0.0, 0.3, 0.8] {
        let light = |_: usize, _: Vec2| (Vec3::new(3.0, 2.0, 1.0), Vec3::splat(albedo));
        let expected = Vec3::new(3.0, 2.0, 1.0) / (1.0 - albedo);
        // A part takes the light of its whole from links that are not split: right in the mean, and everywhere once all
        // are.
        for (error, everywhere) in [(1e-4, 0.4), (1e-9, 5e-3)] {
            let found = solve(&scene, &room, &light, &settings(error, 0.04));
            for triangle in 0..room.len() {
                let mean = found.mean(triangle);
                assert!((mean / expected - 1.0).abs().max_element() < 5e-3, "{albedo}: {mean} for {expected}");
                for at in [Vec2::splat(0.01), Vec2::splat(0.3), Vec2::new(0.05, 0.9)] {
                    let light = found.irradiance(triangle, at);
                    let off = (light / expected - 1.0).abs().max_element();
                    assert!(off < everywhere, "{albedo} {error}: {light} for {expected}");
                }
            }
        }
    }
}

#[test]
fn what_stands_between_blocks_light() {
    let squares = parallel_squares();
    let board = |size: f32| quad(Vec3::new(0.5 - 0.5 * size, 0.5 - 0.5 * size, 0.5), Vec3::X * size, Vec3::Y * size);
    let of = |size: f32| {
        let scene = scene(&[&squares[..], &board(size)].concat());
        let found = solve(&scene, &squares, &lower_shines, &settings(1e-4, 1e-3));
        0.5 * (found.mean(2) + found.mean(3)).x
    };
    assert_eq!(of(1.0), 0.0, "half way up, a square of the same size hides one from the other");
    let half = of(0.5);
    assert!(half > 0.02 && half < 0.15, "{half}");
}

#[test]
fn links_are_far_fewer_than_pairs_and_the_light_is_that_of_all_pairs() {
    let room = room(Vec3::ONE);
    let scene = scene(&room);
    // The floor has a bright square in a corner.
    let light = |triangle: usize, at: Vec2| {
        let is_lit = triangle == 4 && at.max_element() < 0.3;
        (if is_lit { Vec3::ONE } else { Vec3::ZERO }, Vec3::splat(0.6))
    };
    let mut before = f64::INFINITY;
    let all = solve(&scene, &room, &light, &settings(1e-12, 1.0 / 64.0));
    let pairs = |found: &HierarchicalSolution| (found.leaves * found.leaves) as f64;
    // With no error allowed every leaf is linked to every leaf of other sides.
    assert!(all.links as f64 > 0.2 * pairs(&all), "{} {}", all.links, all.leaves);
    for error in [1e-2, 1e-3, 1e-4] {
        let found = solve(&scene, &room, &light, &settings(error, 1.0 / 64.0));
        let mut difference = 0.0;
        for triangle in 0..room.len() {
            difference += f64::from((found.mean(triangle) - all.mean(triangle)).length() / all.mean(triangle).length());
        }
        let difference = difference / room.len() as f64;
        println!("{error}: {} links, {} leaves, {difference:.4} off", found.links, found.leaves);
        assert!(difference <= before, "{error}: {difference} {before}");
        before = difference;
        if error == 1e-3 {
            assert!(difference < 0.02 && found.links < all.links / 5, "{difference} {} {}", found.links, all.links);
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_light_and_bad_settings_are_refused() {
    let room = room(Vec3::ONE);
    let scene = scene(&[&room[..], &quad(Vec3::splat(0.3), Vec3::X * 0.3, Vec3::Y * 0.3)].concat());
    let light = |triangle: usize, _: Vec2| (Vec3::splat(if triangle < 2 { 1.0 } else { 0.0 }), Vec3::splat(0.5));
    let of = |seed: u32| {
        let settings = HierarchicalSettings { seed, ..settings(1e-3, 0.01) };
        let found = solve(&scene, &room, &light, &settings);
        (0..room.len()).map(|triangle| found.mean(triangle)).collect::<Vec<_>>()
    };
    assert_eq!(of(3), of(3));
    assert_ne!(of(3), of(4));
    let scene_of = |triangles| HierarchicalScene { triangles, visibility: &scene, ray_offset: 1e-4, light: &light };
    for wrong in [settings(0.0, 1.0), settings(f32::NAN, 1.0), settings(1e-3, -1.0)] {
        assert!(matches!(hierarchical(&scene_of(&room), &wrong), Err(Error::Shared(transport::Error::Setting { .. }))));
    }
    let flat = [[Vec3::ZERO, Vec3::X, Vec3::X * 2.0]];
    let refused = hierarchical(&scene_of(&flat), &settings(1e-3, 1.0));
    assert!(matches!(refused, Err(Error::Shared(transport::Error::Value { index: 0, .. }))));
    let many = vec![room[0]; 12_000];
    let refused = hierarchical(&scene_of(&many), &settings(1e-3, 1.0));
    assert!(matches!(refused, Err(Error::Shared(transport::Error::TooMany { .. }))));
}
