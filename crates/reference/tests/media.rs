//! Paths in a medium that absorbs.

mod support;

use glam::Vec3;
use patchlight_reference::{PathSettings, PathTracer, Strategy};
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_POINT};
use scene::{Light, Scene, SurfacePoint};
use support::{Builder, direct, floor, point};

/// e to the power x, by double precision: independent of what kernels use.
fn exp(x: f32) -> f32 {
    f64::from(x).exp() as f32
}

/// Irradiance that a sphere of radius `radius` and exitance 1 sends to itself through a medium:
/// `2∫₀¹ μ e^(−xμ) dμ = 2(1 − e^(−x)(1 + x))/x²`, x = 2Rσ.
fn through_a_sphere(radius: f32, absorption: Vec3) -> Vec3 {
    absorption.map(|sigma| {
        let x = 2.0 * radius * sigma;
        if x > 0.0 { 2.0 * (1.0 - exp(-x) * (1.0 + x)) / (x * x) } else { 1.0 }
    })
}

#[test]
fn a_sphere_filled_with_a_medium() {
    let radius = 2.0;
    let rho = 0.7;
    let of = |absorption: Vec3, strategy: Strategy| {
        let mut b = Builder::default();
        let m = b.material(Vec3::splat(rho), Vec3::splat(std::f32::consts::FRAC_1_PI));
        b.sphere_inwards(radius, 8, m);
        b.parts.absorption = absorption;
        let scene = b.build();
        let points: Vec<SurfacePoint> = (0..8)
            .map(|k| {
                let t = scene.geometry.triangles[97 * k];
                point(t.corner + (t.edge_a + t.edge_b) / 3.0, t.edge_a.cross(t.edge_b).normalize())
            })
            .collect();
        let found = PathTracer::new(&scene).irradiance(&points, 8192, &PathSettings { strategy, ..Default::default() });
        found.iter().map(|p| p.direct + p.indirect).sum::<Vec3>() / points.len() as f32
    };
    let absorption = Vec3::new(0.0, 0.3, 1.5);
    // B = M + ρH, H = τB.
    let tau = through_a_sphere(radius, absorption);
    let expected = tau / (Vec3::ONE - rho * tau);
    for strategy in [Strategy::Both, Strategy::Bounces, Strategy::ShadowRays] {
        let found = of(absorption, strategy);
        // Flat parts of the sphere do not see themselves, and each other better.
        assert!((found / expected - 1.0).abs().max_element() < 0.02, "{strategy:?}: {found} for {expected}");
    }
    let wrong = of(absorption * 1.2, Strategy::Both) / expected - 1.0;
    assert!(wrong.y < -0.05 && wrong.z < -0.05, "more absorption is noticed: {wrong}");
}

#[test]
fn a_lamp_in_a_medium_on_a_plane() {
    let height = 2.0f32;
    let aside = 1.5f32;
    let absorption = Vec3::new(0.0, 0.2, 1.0);
    let mut b = floor();
    b.light(Light { kind: LIGHT_POINT, position: Vec3::Y * height, color: Vec3::ONE, ..Light::default() });
    b.parts.absorption = absorption;
    b.parts.ray_offset = Some(1e-5);
    let scene = b.build();
    let at = [Vec3::ZERO, Vec3::X * aside];
    for (found, at) in direct(&scene, &at.map(|at| point(at, Vec3::Y)), 16).iter().zip(at) {
        let distance = at.distance(Vec3::Y * height);
        let expected = (-absorption * distance).map(exp) * (height / distance.powi(3));
        assert!((*found / expected - 1.0).abs().max_element() < 1e-4, "{found} for {expected}");
    }
    // Light from infinity does not come through.
    b.parts.lights[0] = Light { kind: LIGHT_DIRECTIONAL, direction: Vec3::NEG_Y, color: Vec3::ONE, ..Light::default() };
    let sun = direct(&b.build(), &[point(Vec3::ZERO, Vec3::Y)], 16)[0];
    assert!((sun.x - 1.0).abs() < 1e-4 && sun.y == 0.0 && sun.z == 0.0, "{sun}");
    b.parts.absorption = Vec3::new(0.0, -0.1, 0.0);
    assert!(matches!(Scene::new(b.parts.clone()), Err(scene::Error::Absorption { .. })));
}

#[test]
fn no_light_of_a_sun_comes_through_a_medium_over_a_reflection() {
    let mut b = floor();
    let white = b.material(Vec3::splat(0.9), Vec3::ZERO);
    // A wall beside the point that the sun falls on, so that paths connect with points in its light.
    b.quad(Vec3::new(0.5, 0.0, -2.0), Vec3::Y * 4.0, Vec3::Z * 4.0, white);
    b.light(Light {
        kind: LIGHT_DIRECTIONAL,
        direction: Vec3::new(1.0, -1.0, 0.0).normalize(),
        color: Vec3::ONE,
        ..Light::default()
    });
    let of = |b: &Builder| {
        PathTracer::new(&b.build()).irradiance(&[point(Vec3::ZERO, Vec3::Y)], 256, &PathSettings::default())[0]
    };
    let air = of(&b);
    b.parts.absorption = Vec3::new(0.0, 0.2, 1.0);
    let found = of(&b);
    assert!(air.indirect.min_element() > 0.05, "{air:?}");
    // Of the channel that the medium does not absorb all is left.
    assert!((found.indirect.x / air.indirect.x - 1.0).abs() < 0.05, "{found:?}");
    assert!(found.direct.y == 0.0 && found.indirect.y == 0.0 && found.indirect.z == 0.0, "{found:?}");
}
