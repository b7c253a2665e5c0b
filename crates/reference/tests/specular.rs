//! Paths over mirrors and through clear glass.

mod support;

use glam::Vec3;
use patchlight_reference::{PathSettings, PathTracer, PointIrradiance};
use scene::{Camera, Error, Material, ReflectanceFault, Scene, SurfacePoint};
use support::{Builder, camera, point, trace};

/// Refractive index of glass.
const INDEX: f64 = 1.5;

/// A surface without any diffuse part.
fn specular(mirror: Vec3, transmittance: f32, index_of_refraction: f32) -> Material {
    let transmittance = Vec3::splat(transmittance);
    Material { albedo: Vec3::ZERO, mirror, transmittance, index_of_refraction, ..Material::default() }
}

fn add(b: &mut Builder, material: Material) -> u32 {
    b.parts.materials.push(material);
    b.parts.materials.len() as u32 - 1
}

fn irradiance(scene: &Scene, points: &[SurfacePoint], samples: u32) -> Vec<PointIrradiance> {
    PathTracer::new(scene).irradiance(points, samples, &PathSettings::default())
}

/// A room, 1 m wide, with a lamp and a board, whose side x = 0 is a mirror; or, in the place of the mirror, all of it
/// once more.
fn room_with_a_mirror(mirror: Option<f32>) -> Scene {
    let mut b = Builder::default();
    let white = b.material(Vec3::new(0.7, 0.6, 0.5), Vec3::ZERO);
    let red = b.material(Vec3::new(0.7, 0.1, 0.1), Vec3::ZERO);
    let lamp = b.material(Vec3::splat(0.2), Vec3::new(9.0, 8.0, 7.0));
    let low = if mirror.is_some() { 0.0 } else { -1.0 };
    let corner = Vec3::X * low;
    let x = Vec3::X * (1.0 - low);
    let y = Vec3::Y;
    let z = Vec3::Z;
    b.quad(corner, z, x, white).quad(corner + y, x, z, white).quad(corner, x, y, white).quad(corner + z, y, x, white);
    b.quad(Vec3::X, z, y, red);
    match mirror {
        Some(share) => {
            let silver = add(&mut b, specular(Vec3::splat(share), 0.0, 1.5));
            b.quad(Vec3::ZERO, y, z, silver);
        }
        None => {
            b.quad(corner, y, z, red);
            b.quad(Vec3::new(-0.5, 0.95, 0.3), 0.3 * Vec3::X, 0.4 * Vec3::Z, lamp);
            b.quad(Vec3::new(-0.3, 0.0, 0.5), 0.5 * Vec3::Y, 0.3 * Vec3::NEG_X, white);
        }
    }
    b.quad(Vec3::new(0.2, 0.95, 0.3), 0.3 * Vec3::X, 0.4 * Vec3::Z, lamp);
    b.quad(Vec3::new(0.3, 0.0, 0.5), 0.5 * Vec3::Y, 0.3 * Vec3::X, white);
    b.build()
}

#[test]
fn a_mirror_is_the_room_once_more() {
    let points = [
        point(Vec3::new(0.1, 0.0, 0.2), Vec3::Y),
        point(Vec3::new(0.8, 0.0, 0.8), Vec3::Y),
        point(Vec3::new(0.5, 1.0, 0.9), Vec3::NEG_Y),
        point(Vec3::new(1.0, 0.4, 0.5), Vec3::NEG_X),
    ];
    let total = |scene: &Scene| -> Vec<Vec3> {
        irradiance(scene, &points, 1 << 14).iter().map(|p| p.direct + p.indirect).collect()
    };
    let expected = total(&room_with_a_mirror(None));
    let worst = |mirror: f32| {
        let found = total(&room_with_a_mirror(Some(mirror)));
        found.iter().zip(&expected).map(|(a, b)| (*a / *b - 1.0).abs().max_element()).fold(0.0, f32::max)
    };
    let error = worst(1.0);
    assert!(error < 0.02, "{error}");
    assert!(worst(0.9) > 0.03, "a tenth that is absorbed is noticed");
}

#[test]
fn a_picture_of_a_mirror_is_that_of_the_mirrored_camera() {
    let color = Vec3::new(0.9, 0.8, 0.5);
    let with = |mirror: bool| {
        let mut b = Builder::default();
        let grey = b.material(Vec3::splat(0.6), Vec3::ZERO);
        let lamp = b.material(Vec3::ZERO, Vec3::new(3.0, 4.0, 5.0));
        b.quad(Vec3::new(0.1, 0.0, -3.0), 6.0 * Vec3::Z, 6.0 * Vec3::X, grey);
        b.quad(Vec3::new(1.5, 0.2, 0.0), Vec3::new(0.3, 0.0, 0.4), Vec3::Y, lamp);
        if mirror {
            let silver = add(&mut b, specular(color, 0.0, 1.5));
            b.quad(Vec3::new(0.0, -9.0, -9.0), 18.0 * Vec3::Y, 18.0 * Vec3::Z, silver);
        }
        b.build()
    };
    let view = Camera::look_at(Vec3::new(0.5, 0.8, 0.3), Vec3::new(0.0, 0.75, 0.25), Vec3::Y, 30.0, 24, 16);
    let across = |v: Vec3| Vec3::new(-v.x, v.y, v.z);
    let mirrored = Camera {
        eye: across(view.eye),
        forward: across(view.forward),
        right: across(view.right),
        up: across(view.up),
        ..view
    };
    // Light that comes straight from the lamp: the mirror lights nothing.
    let settings = PathSettings { bounces: 0, ..PathSettings::default() };
    let found = trace(&with(true), &view, settings, 256).full();
    let expected = trace(&with(false), &mirrored, settings, 256).full();
    let error = |tint: Vec3| {
        let ratio = |(a, b): (&Vec3, &Vec3)| ((*a - tint * *b).abs() / (tint * *b + 0.01)).max_element();
        let all = found.pixels.iter().zip(&expected.pixels).map(ratio);
        all.sum::<f32>() / found.pixels.len() as f32
    };
    assert!(error(color) < 0.03, "{}", error(color));
    assert!(error(Vec3::splat(0.9)) > 0.05, "the colour of the mirror is noticed");
}

/// Reflectance of glass by the angles of incidence and refraction, in the forms with sines and tangents.
fn reflectance(angle: f64) -> f64 {
    let there = (angle.sin() / INDEX).asin();
    let across = ((angle - there).sin() / (angle + there).sin()).powi(2);
    let along = ((angle - there).tan() / (angle + there).tan()).powi(2);
    0.5 * (across + along)
}

/// Mean of a function of the angle over a sky of one radiance: `2∫ f(θ) cosθ sinθ dθ`.
fn over_the_sky(f: impl Fn(f64) -> f64) -> f32 {
    let steps = 20_000;
    let step = std::f64::consts::FRAC_PI_2 / f64::from(steps);
    let at = |k: i32| {
        let angle = (f64::from(k) + 0.5) * step;
        2.0 * f(angle) * angle.cos() * angle.sin() * step
    };
    (0..steps).map(at).sum::<f64>() as f32
}

/// Mean radiance that a black floor gets from a sky of radiance 1 through these sheets, which lie far beyond its edges.
fn below(sheets: &[(f32, bool)], material: Material) -> f32 {
    let mut b = Builder::default();
    let black = b.material(Vec3::ZERO, Vec3::ZERO);
    let glass = add(&mut b, material);
    let x = 2000.0 * Vec3::X;
    let z = 2000.0 * Vec3::Z;
    let far = Vec3::new(-1000.0, 0.0, -1000.0);
    b.quad(far, z, x, black);
    for &(height, is_up) in sheets {
        let corner = far + Vec3::Y * height;
        if is_up {
            b.quad(corner, z, x, glass)
        } else {
            b.quad(corner, x, z, glass)
        };
    }
    b.sky(Vec3::ONE);
    b.parts.ray_offset = Some(1e-4);
    let found = irradiance(&b.build(), &[point(Vec3::ZERO, Vec3::Y)], 1 << 14)[0];
    assert_eq!(found.direct, Vec3::ZERO, "all light has gone through glass");
    found.indirect.x / std::f32::consts::PI
}

#[test]
fn glass_lets_through_what_fresnel_says() {
    let glass = specular(Vec3::ZERO, 1.0, INDEX as f32);
    let slab = [(0.1, false), (0.2, true)];
    // Between the faces light goes to and fro: (1 − R)²(1 + R² + R⁴ + …).
    let expected = over_the_sky(|angle| {
        let r = reflectance(angle);
        (1.0 - r) * (1.0 - r) / (1.0 - r * r)
    });
    let found = below(&slab, glass);
    assert!((found / expected - 1.0).abs() < 0.005, "{found} for {expected}");
    let pane = below(&[(0.1, true)], Material { is_pane: 1, ..glass });
    assert!((pane / expected - 1.0).abs() < 0.005, "{pane} for {expected}");
    let denser = below(&slab, specular(Vec3::ZERO, 1.0, 1.8));
    assert!(denser / expected < 0.97, "{denser} for {expected}");
    // Under one face alone all directions lie in the cone of the critical angle, with n² of the radiance.
    let inside = over_the_sky(|angle| 1.0 - reflectance(angle));
    let found = below(&[(0.1, true)], glass);
    assert!((found / inside - 1.0).abs() < 0.02, "{found} for {inside}");
}

#[test]
fn the_furnace_is_even_with_mirrors_and_glass() {
    let picture = |mirror: f32, wall: Material| {
        let mut b = Builder::default();
        let wall = add(&mut b, Material { radiance: Vec3::ONE, ..wall });
        b.box_inwards(Vec3::ZERO, Vec3::ONE, wall);
        let glass = add(&mut b, specular(Vec3::ZERO, 1.0, 1.5));
        // From the highest corner to the lowest: fronts outwards.
        b.box_inwards(Vec3::new(0.45, 0.5, 0.5), Vec3::new(0.15, 0.2, 0.2), glass);
        let silver = add(&mut b, specular(Vec3::splat(mirror), 0.0, 1.5));
        b.box_inwards(Vec3::new(0.8, 0.4, 0.5), Vec3::new(0.55, 0.1, 0.2), silver);
        let half = specular(Vec3::splat(0.3), 0.4, 1.3);
        let half = add(&mut b, Material { albedo: Vec3::splat(0.3), is_pane: 1, ..half });
        b.quad(Vec3::new(0.3, 0.6, 0.3), 0.3 * Vec3::Y, 0.3 * Vec3::X, half);
        trace(&b.build(), &camera(24, 16), PathSettings::default(), 256).full()
    };
    let expected = 2.0;
    let grey = Material { albedo: Vec3::splat(0.5), ..Material::default() };
    let mixed = Material { albedo: Vec3::splat(0.2), mirror: Vec3::splat(0.3), ..grey };
    let errors = |mirror: f32, wall: Material| {
        let picture = picture(mirror, wall);
        let worst = picture.pixels.iter().map(|p| (p.x / expected - 1.0).abs()).fold(0.0, f32::max);
        (picture.mean().x / expected - 1.0, worst)
    };
    for wall in [grey, mixed] {
        let (mean, worst) = errors(1.0, wall);
        assert!(mean.abs() < 0.004 && worst < 0.16, "{mean} {worst}");
    }
    assert!(errors(0.8, grey).0 < -0.02, "a mirror that absorbs is noticed");
}

#[test]
fn materials_that_would_make_light_are_refused() {
    let fault = |material: Material| {
        let mut b = Builder::default();
        let m = add(&mut b, material);
        b.quad(Vec3::ZERO, Vec3::X, Vec3::Y, m);
        Scene::new(b.parts).err()
    };
    let half = Material { albedo: Vec3::splat(0.5), mirror: Vec3::new(0.5, 0.5, 0.4), ..Material::default() };
    assert_eq!(fault(half), None);
    let sum = fault(Material { transmittance: Vec3::Z * 0.2, ..half });
    assert!(
        matches!(sum, Some(Error::Reflectance { material: 0, found: ReflectanceFault::Sum { diffuse: 0.5, .. } })),
        "{sum:?}"
    );
    let negative = fault(Material { mirror: Vec3::X * -0.1, ..half });
    assert!(
        matches!(negative, Some(Error::Reflectance { found: ReflectanceFault::Share { name: "mirror", .. }, .. })),
        "{negative:?}"
    );
    let index = fault(Material { index_of_refraction: f32::NAN, ..half });
    assert!(matches!(index, Some(Error::Reflectance { found: ReflectanceFault::Index { .. }, .. })), "{index:?}");
}
