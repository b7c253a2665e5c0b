//! Probes whose light is known in closed form.

use std::f32::consts::PI;

use ddgi::kernel::blend::{blend_irradiance, blend_visibility, weight};
use ddgi::kernel::encoding::root;
use ddgi::kernel::lookup::irradiance_at;
use ddgi::{
    BlendParams, IRRADIANCE_TEXELS, LookupParams, LookupPoint, Probe, ProbeRay, RAY_WEIGHTS, VISIBILITY_TEXELS,
    WeightParams,
};
use glam::{UVec3, Vec2, Vec3, Vec4, vec3};
use scene::math::sin_cos_2pi;

const ENCODING: u32 = 5;
const RAYS: u32 = 200;
const FAR: f32 = 100.0;

/// Directions that are spread evenly by the golden angle.
fn directions() -> Vec<Vec3> {
    let direction = |k: u32| {
        let z = 1.0 - (2.0 * k as f32 + 1.0) / RAYS as f32;
        let (sin, cos) = sin_cos_2pi((0.381_966 * k as f32).fract());
        let side = (1.0 - z * z).sqrt();
        vec3(side * cos, side * sin, z)
    };
    (0..RAYS).map(direction).collect()
}

fn weights() -> Vec<f32> {
    let p = WeightParams { count: RAY_WEIGHTS * RAYS, rays: RAYS, exponent: 50 };
    directions().iter().flat_map(|d| (0..RAY_WEIGHTS).map(|texel| weight(&p, texel, *d))).collect()
}

/// Radiance L from everywhere is irradiance π L on every side; surfaces at distance r have the moments r and r².
#[test]
fn even_light_gives_pi_times_its_radiance_in_every_texel() {
    let radiance = vec3(0.5, 2.0, 7.0);
    let distance = 1.5;
    let probes = [Probe { position: Vec3::ZERO, is_active: 1 }, Probe::default()];
    let rays = vec![ProbeRay { radiance, distance }; 2 * RAYS as usize];
    let weights = weights();
    let p = BlendParams { count: 0, rays: RAYS, hysteresis: 0.0, encoding: ENCODING, most: FAR };
    let is_pi = |found: Vec4, radiance: Vec3| {
        let back = found.truncate().to_array().map(|x| x.powi(ENCODING as i32));
        (Vec3::from(back) / (PI * radiance) - 1.0).abs().max_element() < 1e-5
    };
    for k in 0..IRRADIANCE_TEXELS {
        let found = blend_irradiance(k, &p, &probes, &weights, &rays, Vec4::ZERO);
        assert!(is_pi(found, radiance) && !is_pi(found, radiance * 1.001), "{k}: {found}");
        let off = blend_irradiance(IRRADIANCE_TEXELS + k, &p, &probes, &weights, &rays, Vec4::ONE);
        assert_eq!(off, Vec4::ONE, "a probe that is off stays as it is");
    }
    for k in 0..VISIBILITY_TEXELS {
        let found = blend_visibility(k, &p, &probes, &weights, &rays, Vec2::ZERO);
        assert!((found - Vec2::new(distance, distance * distance)).abs().max_element() < 1e-5, "{k}: {found}");
        let near = blend_visibility(k, &BlendParams { most: 1.0, ..p }, &probes, &weights, &rays, Vec2::ZERO);
        assert!((near - Vec2::ONE).abs().max_element() < 1e-5, "distances count up to the most: {near}");
    }
}

/// Eight probes round a point: four above with light, four below with other light, and what the point sees of them.
fn looked_up(below: f32, distance_below: f32) -> f32 {
    let p = LookupParams {
        counts: UVec3::splat(2),
        encoding: ENCODING,
        first: Vec3::ZERO,
        bias: 0.0,
        spacing: Vec3::ONE,
        visibility: 1,
    };
    let mut probes = Vec::new();
    let mut irradiance = Vec::new();
    let mut visibility = Vec::new();
    for k in 0..8u32 {
        probes.push(Probe { position: vec3((k & 1) as f32, (k >> 1 & 1) as f32, (k >> 2) as f32), is_active: 1 });
        let is_below = k >> 2 == 0;
        let light = root(if is_below { below } else { 2.0 }, ENCODING);
        let distance = if is_below { distance_below } else { FAR };
        irradiance.extend([Vec4::splat(light); IRRADIANCE_TEXELS as usize]);
        visibility.extend([Vec2::new(distance, distance * distance); VISIBILITY_TEXELS as usize]);
    }
    let point = LookupPoint { position: Vec4::splat(0.5), normal: Vec4::Z, to_eye: Vec4::Z };
    irradiance_at(&p, &point, &probes, &irradiance, &visibility).y
}

#[test]
fn a_point_takes_the_light_of_the_probes_that_it_sees() {
    assert!((looked_up(2.0, FAR) - 2.0).abs() < 1e-4, "even light is what it is");
    // Probes behind the surface count less than those before it: (½ (1 ∓ 1/√3))² + 0.2.
    let share = |cosine: f32| (0.5 * (1.0 + cosine)).powi(2) + 0.2;
    let front = share(1.0 / 3f32.sqrt());
    let back = share(-1.0 / 3f32.sqrt());
    let expected = (front * 2f32.sqrt() / (front + back)).powi(2);
    assert!((looked_up(0.0, FAR) - expected).abs() < 1e-4, "{} {expected}", looked_up(0.0, FAR));
    // Probes from which a surface hides the point count for almost nothing: 0.05 of their share, crushed.
    let crushed = (0.05 * back).powi(3) / 0.04;
    let hidden = (front * 2f32.sqrt() / (front + crushed)).powi(2);
    assert!((looked_up(0.0, 0.1) - hidden).abs() < 1e-4, "{} {hidden}", looked_up(0.0, 0.1));
    assert!(hidden - expected > 0.3, "hidden probes go unnoticed");
}
