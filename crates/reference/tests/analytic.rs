//! Scenes whose light has a closed form.

mod support;

use std::f32::consts::PI;

use glam::Vec3;
use patchlight_reference::{PathSettings, PathTracer, Picture, Strategy};
use scene::Light;
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT};
use scene::math::luminance;
use support::{Builder, camera, direct, floor, furnace, point, trace};

/// Relative deviations from a value: of the mean, and the greatest of an 8 × 8 block.
fn deviations(picture: &Picture, expected: f32) -> (f32, f32) {
    let deviation = |p: Vec3| (p / expected - 1.0).abs().max_element();
    (deviation(picture.mean()), picture.block_means(8).pixels.iter().map(|p| deviation(*p)).fold(0.0, f32::max))
}

/// Returns true if direct and indirect light in a furnace of reflectance `rho` agree with the closed forms for
/// `expected`: means within 0.5 %, blocks of direct light within 0.5 %, of indirect light within their noise of 0.7 %
/// (4 σ).
fn is_furnace(rho: f32, expected: f32, strategy: Strategy) -> bool {
    let scene = furnace(rho);
    let a = trace(&scene, &camera(32, 24), PathSettings { strategy, ..PathSettings::default() }, 256);
    // Direct: L_e + ρ L_e. Indirect: the rest of L_e / (1 − ρ).
    let (direct, direct_block) = deviations(&a.direct(), 1.0 + expected);
    let (indirect, indirect_block) = deviations(&a.indirect(), expected * expected / (1.0 - expected));
    println!("ρ {rho}, {strategy:?}: direct {direct} {direct_block}, indirect {indirect} {indirect_block}");
    direct < 5e-3 && direct_block < 5e-3 && indirect < 5e-3 && indirect_block < 3e-2
}

#[test]
fn white_furnace() {
    for (rho, strategy) in [(0.5, Strategy::Both), (0.5, Strategy::Bounces), (0.8, Strategy::Both)] {
        assert!(is_furnace(rho, rho, strategy));
    }
}

#[test]
fn a_wrong_albedo_fails_the_furnace() {
    assert!(!is_furnace(0.52, 0.5, Strategy::Both));
}

#[test]
fn bounces_are_limited() {
    for bounces in 0..4 {
        let settings = PathSettings { bounces, ..PathSettings::default() };
        let a = trace(&furnace(0.5), &camera(16, 16), settings, 128);
        // ρ² + ρ³ + … with one term a bounce.
        let expected = 0.5 - 0.5f32.powi(bounces as i32 + 1);
        let mean = a.indirect().mean().x;
        assert!((mean - expected).abs() < 5e-3 * expected.max(1e-3), "{bounces}: {mean} {expected}");
        assert!((a.direct().mean().x - 1.5).abs() < 5e-3);
    }
}

#[test]
fn floor_below_sun_and_sky() {
    let direction = Vec3::new(0.3, -0.8, 0.2).normalize();
    let irradiance = Vec3::new(30.0, 28.0, 25.0);
    let sky = Vec3::new(0.4, 0.7, 1.0);
    let mut b = floor();
    b.light(Light { kind: LIGHT_DIRECTIONAL, direction, color: irradiance, ..Light::default() }).sky(sky);
    let scene = b.build();
    let view = scene::Camera::look_at(Vec3::new(0.0, 3.0, 1.0), Vec3::ZERO, Vec3::Y, 40.0, 16, 16);
    let a = trace(&scene, &view, PathSettings::default(), 16);
    let expected = (irradiance * -direction.y + sky * PI) * 0.6 / PI;
    for p in &a.direct().pixels {
        assert!(((p / expected) - 1.0).abs().max_element() < 1e-5, "{p} {expected}");
    }
    assert!(a.indirect().pixels.iter().all(|p| *p == Vec3::ZERO));
    assert_eq!(a.full_errors().expect("two passes").max, 0.0);
}

#[test]
fn point_and_spot_lights_on_a_plane() {
    let intensity = Vec3::new(10.0, 20.0, 30.0);
    let height = 1.5f32;
    let lamp = Light { kind: LIGHT_POINT, position: Vec3::Y * height, color: intensity, ..Light::default() };
    let distances = [0.0f32, 0.5, 1.0, 3.0, 10.0];
    let points: Vec<_> = distances.iter().map(|r| point(Vec3::X * *r, Vec3::Y)).collect();
    let mut b = floor();
    b.light(lamp);
    // E = I h / (h² + r²)^(3/2)
    let expected = |r: f32| intensity * height / (height * height + r * r).powi(3).sqrt();
    let scene = b.build();
    // The rays start above the floor.
    let tolerance = 4.0 * scene.geometry.ray_offset / height;
    for (e, r) in direct(&scene, &points, 16).iter().zip(distances) {
        assert!((*e / expected(r) - 1.0).abs().max_element() < tolerance, "{r}: {e}");
    }

    let mut b = floor();
    // Half-angles of 20° and 40°: full light at r = 0 and 0.5 (18.4°), part at 1 (33.7°), none at r ≥ 3.
    let cos_inner = 0.939_692_6;
    let cos_outer = 0.766_044_4;
    b.light(Light { kind: LIGHT_SPOT, direction: Vec3::NEG_Y, cos_inner, cos_outer, ..lamp });
    let spot = direct(&b.build(), &points, 16);
    for k in [0, 1] {
        assert!((spot[k] / expected(distances[k]) - 1.0).abs().max_element() < tolerance, "{k}: {}", spot[k]);
    }
    assert!(spot[2].x > 0.0 && spot[2].x < expected(1.0).x);
    assert_eq!((spot[3], spot[4]), (Vec3::ZERO, Vec3::ZERO));
}

/// Share of the hemisphere that a rectangle a × b covers, parallel to the plane at distance h, a corner above the point
/// (Howell, B-3).
fn corner_form_factor(a: f32, b: f32, h: f32) -> f32 {
    let part = |a: f32, b: f32| {
        let d = (a * a + h * h).sqrt();
        a / d * scene::math::atan2(b, d)
    };
    (part(a, b) + part(b, a)) / (2.0 * PI)
}

#[test]
fn rectangles_above_a_plane() {
    let a = 1.0f32;
    let b = 0.6f32;
    let h = 0.8f32;
    let radiance = 5.0f32;
    // Seen from below: a × b points down.
    let edge_a = Vec3::X * a;
    let edge_b = Vec3::Z * b;
    assert!(edge_a.cross(edge_b).y < 0.0);
    let below_corner = point(Vec3::ZERO, Vec3::Y);
    let below_centre = point(Vec3::new(0.5 * a, 0.0, 0.5 * b), Vec3::Y);
    let expected =
        [PI * radiance * corner_form_factor(a, b, h), PI * radiance * 4.0 * corner_form_factor(0.5 * a, 0.5 * b, h)];

    let mut light = floor();
    let color = Vec3::splat(radiance);
    let rect =
        Light { kind: LIGHT_RECT, position: Vec3::Y * h, color, edge_a, edge_b, area: a * b, ..Light::default() };
    light.light(rect);
    let mut emitter = floor();
    let m = emitter.material(Vec3::ZERO, color);
    emitter.quad(Vec3::Y * h, edge_a, edge_b, m);
    for (name, scene) in [("light", light.build()), ("emitter", emitter.build())] {
        for (e, expected) in direct(&scene, &[below_corner, below_centre], 16_384).iter().zip(expected) {
            // Rays start 6 mm above the floor of 200 m: closer to the rectangle.
            assert!((e.x / expected - 1.0).abs() < 2e-2, "{name}: {e} {expected}");
        }
    }

    // The back sends nothing.
    let mut turned = floor();
    turned.light(Light { edge_a: edge_b, edge_b: edge_a, ..rect });
    assert_eq!(direct(&turned.build(), &[below_corner], 16)[0], Vec3::ZERO);
}

#[test]
fn the_camera_sees_rectangle_lights_and_rays_pass_through_them() {
    let mut b = floor();
    let color = Vec3::new(3.0, 2.0, 1.0);
    let edge_a = Vec3::X;
    let edge_b = Vec3::Z;
    b.light(Light {
        kind: LIGHT_RECT,
        position: Vec3::new(-0.5, 2.0, -0.5),
        color,
        edge_a,
        edge_b,
        area: 1.0,
        ..Light::default()
    });
    let scene = b.build();
    let up = scene::Camera::look_at(Vec3::Y, 2.0 * Vec3::Y, Vec3::Z, 10.0, 8, 8);
    let a = trace(&scene, &up, PathSettings::default(), 1);
    assert!(a.direct().pixels.iter().all(|p| *p == color) && a.indirect().mean() == Vec3::ZERO);
    // From above the light is not there: the floor under it is seen.
    let down = scene::Camera::look_at(3.0 * Vec3::Y, Vec3::ZERO, Vec3::Z, 10.0, 8, 8);
    let a = trace(&scene, &down, PathSettings::default(), 4);
    assert!(a.direct().pixels.iter().all(|p| *p != color && p.x > 0.0));
}

/// Greatest light inside over the light on top of a box of walls without thickness in sun and sky; `gap` opens the lid.
fn light_inside(gap: f32) -> f32 {
    let mut b = Builder::default();
    let m = b.material(Vec3::splat(0.8), Vec3::ZERO);
    b.quad(Vec3::new(-10.0, -0.5, -10.0), 20.0 * Vec3::Z, 20.0 * Vec3::X, m);
    let low = Vec3::new(-1.0, 0.0, -1.0);
    let high = Vec3::new(1.0, 2.0, 1.0);
    let x = 2.0 * Vec3::X;
    let y = 2.0 * Vec3::Y;
    let z = 2.0 * Vec3::Z;
    b.quad(low, y, z, m).quad(low, z, x, m).quad(low, x, y, m).quad(high, -z, -y, m).quad(high, -y, -x, m);
    b.quad(Vec3::new(-1.0 + gap, 2.0, -1.0), z, x - gap * Vec3::X, m);
    let direction = Vec3::new(0.4, -1.0, 0.3).normalize();
    b.light(Light { kind: LIGHT_DIRECTIONAL, direction, color: Vec3::splat(30.0), ..Light::default() });
    b.sky(Vec3::ONE);
    let scene = b.build();
    let mut points = vec![point(Vec3::new(0.0, 2.0, 0.0), Vec3::Y)];
    for k in 0..64 {
        // Floor, walls and lid from inside; some a hair from the edges.
        let near_edge = if k % 4 == 0 { 0.999 } else { 0.7 };
        let u = (k as f32 / 32.0 - 1.0) * near_edge;
        let v = near_edge * if k % 2 == 0 { 1.0 } else { -0.5 };
        points.push(point(Vec3::new(u, 0.0, v), Vec3::Y));
        points.push(point(Vec3::new(-1.0, 1.0 + u, v), Vec3::X));
        points.push(point(Vec3::new(v.max(-1.0 + gap), 2.0, u), Vec3::NEG_Y));
    }
    let light = PathTracer::new(&scene).irradiance(&points, 512, &PathSettings::default());
    let total = |p: &patchlight_reference::PointIrradiance| luminance(p.direct + p.indirect);
    light[1..].iter().map(total).fold(0.0, f32::max) / total(&light[0])
}

#[test]
fn a_sealed_box_in_the_sun_stays_dark() {
    let inside = light_inside(0.0);
    assert!(inside < 1e-4, "{inside}");
    // The same check sees a gap of 2 % of the lid.
    let leaking = light_inside(0.04);
    assert!(leaking > 1e-3, "{leaking}");
}
