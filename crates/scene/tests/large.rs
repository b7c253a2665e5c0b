//! Rectangles and emissive triangles where nothing is in the way, against closed forms.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};
use patchlight_scene::gpu::*;
use patchlight_scene::kernel::large::{MAX_EXACT_EMITTERS, group_irradiance, polygon_irradiance};
use patchlight_scene::math::{atan2, sin_cos_2pi};
use patchlight_scene::*;

/// Irradiance of a rectangle over radiance, seen from the origin by a normal.
fn rectangle(corner: Vec3, edge_a: Vec3, edge_b: Vec3, normal: Vec3) -> f32 {
    polygon_irradiance(false, corner, edge_a, edge_b, Vec3::ZERO, normal)
}

/// π times the form factor from a point to a rectangle a × b that is parallel, `height` above, with a corner over the
/// point (Howell's catalogue, B-3).
fn parallel(a: f32, b: f32, height: f32) -> f32 {
    let x = a / height;
    let y = b / height;
    let rx = (1.0 + x * x).sqrt();
    let ry = (1.0 + y * y).sqrt();
    0.5 * (x / rx * atan2(y, rx) + y / ry * atan2(x, ry))
}

/// Form factor to a rectangle that stands on the point's plane, `distance` away, `width` to one side of the point
/// (B-4).
fn standing(width: f32, height: f32, distance: f32) -> f32 {
    let far = (distance * distance + height * height).sqrt();
    0.5 * (atan2(width, distance) - distance / far * atan2(width, far))
}

#[test]
fn a_rectangle_over_a_plane_has_its_closed_form() {
    let corner = |height: f32| Vec3::Y * height;
    for (a, b, height) in [(1.0, 1.0, 1.0), (0.3, 2.0, 0.5), (20.0, 30.0, 0.01), (0.1, 0.1, 3.0)] {
        let found = rectangle(corner(height), Vec3::X * a, Vec3::Z * b, Vec3::Y);
        let expected = parallel(a, b, height);
        assert!((found / expected - 1.0).abs() < 1e-4, "{a} x {b} at {height}: {found} of {expected}");
        // Higher up the form is another, unless the rectangle takes all of a quarter of the hemisphere.
        let wrong = rectangle(corner(1.2 * height), Vec3::X * a, Vec3::Z * b, Vec3::Y);
        assert!(expected > 0.24 * PI || (wrong / expected - 1.0).abs() > 0.05, "{wrong}");
        // Nothing from the back, nothing below.
        assert_eq!(rectangle(corner(height), Vec3::Z * b, Vec3::X * a, Vec3::Y), 0.0);
        assert_eq!(rectangle(corner(height), Vec3::X * a, Vec3::Z * b, Vec3::NEG_Y), 0.0);
    }
    // All round: half space.
    let all = rectangle(Vec3::new(-1e4, 1.0, -1e4), Vec3::X * 2e4, Vec3::Z * 2e4, Vec3::Y);
    assert!((all / PI - 1.0).abs() < 1e-3, "{all}");
}

#[test]
fn what_is_below_the_horizon_sends_nothing() {
    for (width, height, distance) in [(1.0, 1.0, 1.0), (2.0, 0.5, 0.2), (5.0, 7.0, 2.0)] {
        let expected = standing(width, height, distance);
        for below in [0.0, 0.3, 10.0] {
            let corner = Vec3::new(distance, -below, 0.0);
            let found = rectangle(corner, Vec3::Z * width, Vec3::Y * (height + below), Vec3::Y);
            assert!((found / expected - 1.0).abs() < 1e-4, "{below} below: {found} of {expected}");
        }
        let higher = rectangle(Vec3::X * distance, Vec3::Z * width, Vec3::Y * (1.3 * height), Vec3::Y);
        assert!(higher / expected > 1.01, "{higher}");
    }
}

#[test]
fn triangles_add_up_to_their_rectangle_whatever_its_size() {
    let normal = Vec3::new(0.3, 0.9, -0.1).normalize();
    for size in [2.0f32, 0.3, 0.05, 0.031, 0.02, 0.001] {
        let corner = Vec3::new(0.4, 2.0, -0.3);
        let a = Vec3::new(size, 0.1 * size, 0.0);
        let b = Vec3::new(0.0, 0.2, 1.0) * size;
        let whole = rectangle(corner, a, b, normal);
        let halves = [(corner, a, b), (corner + a + b, -a, -b)];
        let sum: f32 =
            halves.iter().map(|&(corner, a, b)| polygon_irradiance(true, corner, a, b, Vec3::ZERO, normal)).sum();
        assert!(whole > 0.0 && (sum / whole - 1.0).abs() < 1e-3, "{size}: {sum} of {whole}");
        assert!((polygon_irradiance(true, corner, a, b, Vec3::ZERO, normal) / whole - 1.0).abs() > 0.1);
    }
}

/// A scene of these emissive triangles.
fn emitters(triangles: Vec<Triangle>) -> Scene {
    let uvs = vec![TriangleUv::default(); triangles.len()];
    let materials = vec![Material { radiance: Vec3::new(2.0, 1.0, 0.5), ..Material::default() }];
    Scene::new(SceneParts { triangles, uvs, materials, ..SceneParts::default() }).unwrap()
}

/// A ball of unit radius, 2 · 32 · 16 triangles with fronts outside.
fn ball() -> Scene {
    let place = |k: u32, ring: u32| {
        let azimuth = sin_cos_2pi(k as f32 / 32.0);
        let polar = sin_cos_2pi(ring as f32 / 32.0);
        Vec3::new(polar.0 * azimuth.1, polar.1, -polar.0 * azimuth.0)
    };
    let mut triangles = Vec::new();
    for (k, ring) in (0..32).flat_map(|k| (0..16).map(move |ring| (k, ring))) {
        let a = place(k, ring);
        let b = place(k, ring + 1);
        let c = place(k + 1, ring + 1);
        let d = place(k + 1, ring);
        for (corner, edge_a, edge_b) in [(a, b - a, c - a), (a, c - a, d - a)] {
            if edge_a.cross(edge_b).length() > 1e-6 {
                triangles.push(Triangle { corner, edge_a, edge_b, ..Triangle::default() });
            }
        }
    }
    emitters(triangles)
}

/// A panel of 1 × 1 m that looks down, 2 · 16 · 16 triangles.
fn panel() -> Scene {
    let mut triangles = Vec::new();
    for k in 0..256u32 {
        let corner = Vec2::new((k % 16) as f32, (k / 16) as f32) / 16.0 - 0.5;
        let a = Vec3::X / 16.0;
        let b = Vec3::Z / 16.0;
        let corner = Vec3::new(corner.x, 0.0, corner.y);
        triangles.push(Triangle { corner, edge_a: a, edge_b: a + b, ..Triangle::default() });
        triangles.push(Triangle { corner, edge_a: a + b, edge_b: b, ..Triangle::default() });
    }
    emitters(triangles)
}

/// Irradiance at a point by groups, and by all triangles.
fn both(scene: &Scene, origin: Vec3, normal: Vec3) -> (f32, f32) {
    let groups = scene.emitter_groups.iter().map(|group| group_irradiance(group, origin, normal).x).sum();
    let of = |t: &Triangle| 2.0 * polygon_irradiance(true, t.corner, t.edge_a, t.edge_b, origin, normal);
    (groups, scene.geometry.triangles.iter().map(of).sum())
}

#[test]
fn groups_of_emitters_shine_as_their_triangles_do() {
    for (name, scene) in [("ball", ball()), ("panel", panel())] {
        assert!(scene.emitters.len() > MAX_EXACT_EMITTERS as usize);
        assert!((2..=MAX_EMITTER_GROUPS).contains(&scene.emitter_groups.len()));
        for direction in [Vec3::NEG_Y, Vec3::new(0.6, -0.8, 0.0), Vec3::new(-0.48, -0.6, 0.64)] {
            for distance in [2.5, 5.0, 50.0] {
                let (found, expected) = both(&scene, direction * distance, -direction);
                // Near a ball only parts that face the point count, whose bands of harmonics are 6 % too bright.
                let bound = if distance < 5.0 { 0.05 } else { 0.03 };
                assert!((found / expected - 1.0).abs() < bound, "{name} {direction} {distance}: {found} of {expected}");
            }
        }
    }
    // A scene of other triangles is no match; few need no groups.
    let (found, _) = both(&ball(), Vec3::NEG_Y * 5.0, Vec3::Y);
    let (_, expected) = both(&panel(), Vec3::NEG_Y * 5.0, Vec3::Y);
    assert!((found / expected - 1.0).abs() > 0.5);
    let few = ball().geometry.triangles[..MAX_EXACT_EMITTERS as usize].to_vec();
    assert!(emitters(few).emitter_groups.is_empty());
}
