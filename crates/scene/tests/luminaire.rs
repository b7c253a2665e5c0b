//! Luminaires: light by measured distributions, against closed forms.

use std::f64::consts::PI;

use glam::{Mat3, Vec3};
use patchlight_scene::gpu::*;
use patchlight_scene::kernel::light::luminaire_share;
use patchlight_scene::*;

/// A floor of 200 m, one light.
fn floor_under(light: Light, distributions: Vec<f32>) -> Scene {
    let corner = Vec3::new(-100.0, 0.0, -100.0);
    let a = Vec3::Z * 200.0;
    let b = Vec3::X * 200.0;
    let triangles = vec![
        Triangle { corner, edge_a: a, edge_b: a + b, ..Triangle::default() },
        Triangle { corner, edge_a: a + b, edge_b: b, ..Triangle::default() },
    ];
    Scene::new(SceneParts {
        uvs: vec![TriangleUv::default(); 2],
        triangles,
        materials: vec![Material::default()],
        lights: vec![light],
        distributions,
        // Small, so that rays start where they are asked for.
        ray_offset: Some(1e-5),
        ..SceneParts::default()
    })
    .unwrap()
}

/// Irradiance of the floor at places of it.
fn irradiance(scene: &Scene, places: &[Vec3]) -> Vec<Vec3> {
    let params = DirectParams {
        count: places.len() as u32,
        light_count: scene.lighting.lights.len() as u32,
        ray_offset: scene.geometry.ray_offset,
        ..DirectParams::default()
    };
    let point = |&position: &Vec3| SurfacePoint { position, patch: 0, normal: Vec3::Y, weight: 1.0 };
    scene.direct_irradiance(&params, &places.iter().map(point).collect::<Vec<_>>())
}

fn luminaire(distribution: &Distribution, place: Light) -> Scene {
    // Something else comes first.
    let mut table = vec![9.0; 5];
    let begin = distribution.append_to(&mut table).unwrap();
    floor_under(Light { kind: LIGHT_LUMINAIRE, distribution: begin, ..place }, table)
}

fn at(height: f32) -> Light {
    Light {
        position: Vec3::Y * height,
        direction: Vec3::NEG_Y,
        edge_a: Vec3::X,
        color: Vec3::new(3.0, 2.0, 1.0),
        ..Light::default()
    }
}

fn steps(step: f64, last: f64) -> Vec<f64> {
    (0..=(last / step).round() as u32).map(|k| f64::from(k) * step).collect()
}

/// The intensity of a Lambert surface.
fn lambert(step: f64) -> Distribution {
    let gammas = steps(step, 90.0);
    let intensities = gammas.iter().map(|gamma| gamma.to_radians().cos().max(0.0)).collect();
    Distribution::new(gammas, vec![0.0], intensities).unwrap()
}

/// Brighter from half-plane to half-plane: 1 at C = 0, 2 at 90°, 3 at 180°, 4 at 270°, at all γ.
fn fourfold() -> Distribution {
    let planes = steps(90.0, 270.0);
    Distribution::new(vec![0.0, 180.0], planes, vec![1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0]).unwrap()
}

#[test]
fn a_lambert_distribution_lights_a_plane_by_the_fourth_power_of_the_cosine() {
    let height = 2.5f32;
    let places: Vec<Vec3> = [0.0f32, 0.5, 1.0, 2.5, 4.0].map(|x| Vec3::new(0.6 * x, 0.0, -0.8 * x)).to_vec();
    let found = irradiance(&luminaire(&lambert(1.0), at(height)), &places);
    for (place, found) in places.iter().zip(&found) {
        // The mean is a quarter of the greatest: E = 4 I cos⁴θ / h².
        let cosine = height / place.distance(Vec3::Y * height);
        let expected = at(height).color * (4.0 * cosine.powi(4) / (height * height));
        assert!((*found / expected - 1.0).abs().max_element() < 1e-4, "{place}: {found} for {expected}");
    }
    // One third power is not it.
    let isotropic = Distribution::new(vec![0.0, 180.0], vec![0.0], vec![1.0; 2]).unwrap();
    let wrong = irradiance(&luminaire(&isotropic, at(height)), &places[4..])[0];
    assert!((wrong / found[4] - 1.0).abs().max_element() > 0.1);
}

#[test]
fn an_isotropic_distribution_is_a_point_light_bit_by_bit() {
    let flat = |planes: Vec<f64>| {
        let gammas = steps(5.0, 180.0);
        let intensities = vec![123.4; gammas.len() * planes.len()];
        Distribution::new(gammas, planes, intensities).unwrap()
    };
    let places: Vec<Vec3> = (0..200).map(|k| Vec3::new(0.37 * k as f32 - 30.0, 0.0, 11.0 - 0.11 * k as f32)).collect();
    let place = Light { direction: Vec3::new(0.3, -0.5, 0.2).normalize(), edge_a: Vec3::Y, ..at(3.0) };
    let bulb = irradiance(&floor_under(Light { kind: LIGHT_POINT, ..place }, Vec::new()), &places);
    let mut lopsided = flat(steps(30.0, 330.0));
    assert_eq!(irradiance(&luminaire(&lopsided, place), &places), bulb);
    assert_eq!(irradiance(&luminaire(&flat(vec![0.0]), place), &places), bulb);
    // A tenth more in one half-plane is noticed.
    let mut intensities = lopsided.intensities().to_vec();
    intensities[..37].iter_mut().for_each(|value| *value *= 1.1);
    lopsided = Distribution::new(lopsided.gammas().to_vec(), lopsided.planes().to_vec(), intensities).unwrap();
    assert_ne!(irradiance(&luminaire(&lopsided, place), &places), bulb);
}

#[test]
fn half_planes_lie_where_the_standard_has_them() {
    // Seen from above, C goes from +x counter-clockwise: 90° is -z, where y is up.
    let scene = luminaire(&fourfold(), at(2.0));
    let places = [Vec3::X, Vec3::NEG_Z, Vec3::NEG_X, Vec3::Z];
    let found = irradiance(&scene, &places);
    let first = found[0].x;
    for (k, found) in found.iter().enumerate() {
        let expected = (k + 1) as f32;
        assert!((found.x / first / expected - 1.0).abs() < 1e-5, "C {}: {found}", 90 * k);
    }
    // Half-way between two half-planes it is half-way between their intensities.
    let between = irradiance(&scene, &[Vec3::new(1.0, 0.0, -1.0).normalize()])[0];
    assert!((between.x / found[0].x - 1.5).abs() < 1e-5, "{between}");
    // And between the last and the first.
    let between = irradiance(&scene, &[Vec3::new(1.0, 0.0, 1.0).normalize()])[0];
    assert!((between.x / found[0].x - 2.5).abs() < 1e-5, "{between}");
}

#[test]
fn a_luminaire_that_is_turned_takes_its_light_along() {
    let gammas = steps(10.0, 120.0);
    let planes = steps(45.0, 315.0);
    let intensities: Vec<f64> = (0..gammas.len() * planes.len()).map(|k| (1 + 7 * k % 13) as f64).collect();
    let distribution = Distribution::new(gammas, planes, intensities).unwrap();
    let mut table = Vec::new();
    let begin = distribution.append_to(&mut table).unwrap();
    let upright = Light { kind: LIGHT_LUMINAIRE, distribution: begin, ..at(0.0) };
    let turn = Mat3::from_rotation_z(0.7) * Mat3::from_rotation_y(1.1);
    let turned = Light { direction: turn * upright.direction, edge_a: turn * upright.edge_a, ..upright };
    let mut differences = 0;
    for k in 0..500u32 {
        let z = 1.0 - 2.0 * (k as f32 + 0.5) / 500.0;
        let around = 2.4 * k as f32;
        let (s, c) = math::sin_cos_2pi(around / std::f32::consts::TAU);
        let away = Vec3::new(c * (1.0 - z * z).sqrt(), z, s * (1.0 - z * z).sqrt());
        let before = luminaire_share(&upright, &table, away);
        let after = luminaire_share(&turned, &table, turn * away);
        assert!((before - after).abs() < 2e-4, "{away}: {before} {after}");
        // What the kernel reads is what the distribution says.
        let gamma = f64::from(-away.y).acos().to_degrees();
        let exact = distribution.intensity(gamma, f64::from(-away.z).atan2(f64::from(away.x)).to_degrees());
        let exact = (exact / distribution.mean()) as f32;
        assert!((before - exact).abs() < 2e-4 || (gamma - 120.0).abs() < 0.02, "{away}: {before} {exact}");
        differences += u32::from((before - luminaire_share(&turned, &table, away)).abs() > 0.05);
    }
    assert!(differences > 300, "a turn changes light: {differences}");
}

#[test]
fn means_are_those_of_closed_forms() {
    let mean = |gammas: Vec<f64>, planes: Vec<f64>, values: Vec<f64>| {
        Distribution::new(gammas, planes, values).unwrap().mean()
    };
    assert!((mean(vec![0.0, 180.0], vec![0.0], vec![3.0; 2]) - 3.0).abs() < 1e-12);
    assert!((mean(vec![0.0, 90.0], vec![0.0], vec![3.0; 2]) - 1.5).abs() < 1e-12);
    // Linear from 1 at γ = 0 to 0 at γ = 180°: ½ ∫ (1 - γ/π) sin γ dγ = ½.
    assert!((mean(vec![0.0, 180.0], vec![0.0], vec![1.0, 0.0]) - 0.5).abs() < 1e-12);
    assert!((fourfold().mean() - 2.5).abs() < 1e-12);
    // Half-planes count by the angles they stand for: 1 from 315° to 45°, and half of the rest.
    let uneven = mean(vec![0.0, 180.0], vec![0.0, 90.0, 180.0], vec![1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    assert!((uneven - (90.0 + 180.0) / 720.0).abs() < 1e-12, "{uneven}");
    // The error of a table of a Lambert surface goes by the square of its step: 4π · mean = π.
    for (step, tolerance) in [(1.0, 3e-5), (5.0, 7e-4)] {
        let flux = 4.0 * PI * lambert(step).mean();
        assert!((flux / PI - 1.0).abs() < tolerance, "{step}: {flux}");
    }
    assert!((4.0 * PI * lambert(30.0).mean() / PI - 1.0).abs() > 1e-2);
}

#[test]
fn tables_hold_the_angles_that_lie_on_a_grid_and_say_how_far_off_others_are() {
    for (gammas, planes) in [
        (steps(2.5, 90.0), vec![0.0]),
        (vec![0.0, 1.0, 5.0, 90.0, 180.0], steps(22.5, 337.5)),
        (vec![90.0, 100.0, 120.0], vec![0.0, 30.0, 180.0]),
    ] {
        let values = (0..gammas.len() * planes.len()).map(|k| (1 + 5 * k % 7) as f64).collect();
        let distribution = Distribution::new(gammas, planes, values).unwrap();
        assert!(distribution.grid_error() < 1e-12, "{distribution:?}");
        let mut table = Vec::new();
        let begin = distribution.append_to(&mut table).unwrap();
        let back = Distribution::of_table(&table, begin).unwrap();
        assert!((back.mean() - 1.0).abs() < 1e-6);
        assert!((back.intensity(100.0, 35.0) * distribution.mean() - distribution.intensity(100.0, 35.0)).abs() < 1e-5);
    }
    // A peak at an angle between the finest steps loses what it would at their distance from it.
    let peak = Distribution::new(vec![0.0, 10.1, 180.0], vec![0.0], vec![0.0, 1.0, 0.0]).unwrap();
    let error = peak.grid_error();
    assert!(error > 0.0 && error < 0.25 / 10.1, "{error}");
    // It is what the table is off by.
    let grid = peak.on_grid();
    assert!((peak.intensity(10.1, 0.0) - grid.intensity(10.1, 0.0) - error).abs() < 1e-12);
}

#[test]
fn what_is_no_distribution_is_refused() {
    let name = |gammas: &[f64], planes: &[f64], values: &[f64]| match Distribution::new(
        gammas.to_vec(),
        planes.to_vec(),
        values.to_vec(),
    ) {
        Err(Error::Distribution { name, index, .. }) => (name, index),
        other => panic!("{other:?}"),
    };
    assert_eq!(name(&[0.0], &[0.0], &[1.0]).0, "number of angles");
    assert_eq!(name(&[0.0, 10.0, 10.0], &[0.0], &[1.0; 3]), ("γ", 2));
    assert_eq!(name(&[0.0, 181.0], &[0.0], &[1.0; 2]), ("γ", 1));
    assert_eq!(name(&[0.0, 90.0], &[0.0, 360.0], &[1.0; 4]), ("C", 1));
    assert_eq!(name(&[0.0, f64::NAN], &[0.0], &[1.0; 2]), ("γ", 1));
    assert_eq!(name(&[0.0, 90.0], &[0.0], &[1.0; 3]).0, "number of intensities");
    assert_eq!(name(&[0.0, 90.0], &[0.0], &[1.0, -1.0]), ("intensity", 1));
    assert_eq!(name(&[0.0, 90.0], &[0.0], &[f64::INFINITY, 1.0]), ("intensity", 0));

    // A light that names no distribution, in a scene and in a lighting.
    let scene = luminaire(&lambert(5.0), at(1.0));
    let mut lighting = scene.lighting.clone();
    for (begin, table) in [(0, scene.lighting.distributions.clone()), (1 << 30, scene.lighting.distributions.clone())]
        .into_iter()
        .chain([(5, scene.lighting.distributions[..20].into()), (5, [].into())])
    {
        lighting.lights[0].distribution = begin;
        lighting.distributions = table;
        let words = lighting.distributions.len();
        let expected = Error::LightDistribution { light: 0, begin, words };
        assert_eq!(Scene::under(scene.geometry.clone(), lighting.clone()).err(), Some(expected.clone()));
        assert_eq!(scene.clone().set_lighting(lighting.clone()), Err(expected));
    }
    let mut table = scene.lighting.distributions.to_vec();
    table[12] = f32::NAN;
    let lighting = Lighting { distributions: table.into(), ..scene.lighting.clone() };
    assert!(matches!(scene.clone().set_lighting(lighting), Err(Error::Distribution { name: "word", index: 12, .. })));
}
