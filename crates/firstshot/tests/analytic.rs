//! Closed forms: light on a plate, the white furnace, energy.

mod support;

use std::f32::consts::PI;

use glam::{DVec3, Vec2, Vec3};
use patchlight_firstshot::{
    Emission, IlluminationMaps, LightElementSettings, PhotonAccumulator, PhotonSettings, Texels, light_elements,
};
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_RECT, LIGHT_SPOT, Texture, TriangleUv};
use scene::math::luminance;
use scene::{Light, Material, Scene, SceneParts};
use support::*;

/// Solid angle of a square of half edge a at height h over its middle.
fn solid_angle(a: f64, h: f64) -> f64 {
    4.0 * (a * a / (a * a + h * h)).asin()
}

#[test]
fn a_point_light_over_a_plate_gives_its_solid_angle() {
    for height in [0.3f32, 1.0, 4.0] {
        let scene = plate(0.5, vec![bulb(Vec3::Y * height)]);
        let expected = 0.5 * f64::from(luminance(COLOR)) * solid_angle(1.0, f64::from(height));
        for exact in [false, true] {
            // Light elements are linear within a percent, so is their sum.
            let settings = LightElementSettings { tolerance: 0.01, ..LightElementSettings::default() };
            let emission = Emission::first_shot(&scene, &settings, Texels::Mean, exact, &ignore_progress).unwrap();
            assert!((emission.power / expected - 1.0).abs() < 0.01, "{height}: {} for {expected}", emission.power);
            let maps = IlluminationMaps::new(&scene, 10.0).unwrap();
            let found = trace(&scene, &emission, &maps, photons(1 << 18));
            // With shadow rays the power is that of the light, not of the table.
            let error = found.emitted.dot(DVec3::new(0.2126, 0.7152, 0.0722)) / expected - 1.0;
            let tolerance = if exact { 2e-4 } else { 0.01 };
            assert!(error.abs() < tolerance, "{height} {exact}: {error}");
            assert!(found.round.registered == 0 && (found.escaped - found.emitted).length() < 1e-6 * expected);
        }
    }
    // A wrong height is noticed.
    let emission = first_shot(&plate(0.5, vec![bulb(Vec3::Y)]));
    assert!((emission.power / (0.5 * f64::from(luminance(COLOR)) * solid_angle(1.0, 1.1)) - 1.0).abs() > 0.05);
}

#[test]
fn parallel_light_and_spots_have_their_power() {
    let sun = Light { kind: LIGHT_DIRECTIONAL, direction: Vec3::new(0.6, -0.8, 0.0), color: COLOR, ..Light::default() };
    // Narrow enough to fall on the plate as a whole: 2π I ∫ falloff dz.
    let spot = Light {
        kind: LIGHT_SPOT,
        position: Vec3::Y * 2.0,
        direction: Vec3::NEG_Y,
        color: COLOR,
        cos_inner: 0.98,
        cos_outer: 0.95,
        ..Light::default()
    };
    // ∫ smoothstep = ½ between the cones.
    let spot_power = 2.0 * PI * (0.02 + 0.5 * 0.03);
    for (light, expected) in [(sun, 4.0 * 0.8), (spot, spot_power)] {
        let scene = plate(0.25, vec![light]);
        let expected = f64::from(luminance(COLOR) * expected);
        let classical = Emission::classical(&scene).unwrap();
        let maps = IlluminationMaps::new(&scene, 10.0).unwrap();
        let settings = PhotonSettings { with_direct: true, ..photons(1 << 18) };
        let lands = trace(&scene, &classical, &maps, settings);
        let landed: f32 = lands.irradiance.iter().zip(maps.areas()).map(|(h, a)| luminance(*h) * a).sum();
        assert!((f64::from(landed) / expected - 1.0).abs() < 3e-3, "{landed} for {expected}");
        let shot = trace(&scene, &first_shot(&scene), &maps, photons(1 << 18));
        let error = shot.emitted.dot(DVec3::new(0.2126, 0.7152, 0.0722)) / (0.25 * expected) - 1.0;
        assert!(error.abs() < 3e-3, "{error}");
    }
}

#[test]
fn light_elements_have_the_light_of_the_lamp_and_cover_the_plate() {
    let scene = plate(0.5, vec![bulb(Vec3::new(0.3, 0.5, 0.2))]);
    let elements = light_elements(&scene, &LightElementSettings::default(), &ignore_progress).unwrap().elements;
    let area: f32 = elements.iter().map(|p| p.area).sum();
    assert!((area - 4.0).abs() < 1e-4, "{area}");
    for p in &elements {
        let at = (p.corners[0] + p.corners[1] + p.corners[2]) / 3.0;
        let to = Vec3::new(0.3, 0.5, 0.2) - scene.tables().position(p.triangle, at.x, at.y);
        let expected = to.y / to.length().powi(3);
        assert!((p.middle / expected - 1.0).abs() < 2e-3 && (p.mean() / expected - 1.0).abs() < 0.08, "{p:?}");
    }
}

#[test]
fn edges_of_shadows_are_refined() {
    // A board over the plate throws a shadow on a fourth of it.
    let mut triangles = quad(Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, 0).to_vec();
    triangles.extend(quad(Vec3::new(-0.31, 0.5, -0.73), Vec3::Z, Vec3::X, 0));
    let sun = Light { kind: LIGHT_DIRECTIONAL, direction: Vec3::NEG_Y, color: COLOR, ..Light::default() };
    let scene = scene(triangles, vec![grey(0.5)], vec![sun]);
    let settings = LightElementSettings::default();
    let on_plate = |settings: &LightElementSettings| -> f64 {
        let geometry = scene.tables();
        let elements = light_elements(&scene, settings, &ignore_progress).unwrap().elements;
        let on_plate = elements.iter().filter(|p| geometry.position(p.triangle, 0.2, 0.2).y == 0.0);
        on_plate.map(|p| f64::from(p.mean() * p.area)).sum()
    };
    let coarse = on_plate(&LightElementSettings { depth: 0, ..settings });
    let fine = on_plate(&LightElementSettings { elements: 1 << 20, depth: 14, ..settings });
    assert!((on_plate(&settings) - 3.0).abs() < 0.02 && (fine - 3.0).abs() < 0.005, "{fine}");
    assert!((coarse - 3.0).abs() > 0.2, "{coarse}");
}

#[test]
fn the_white_furnace_is_even() {
    for albedo in [0.0, 0.3, 0.8] {
        let shining = Material { radiance: COLOR / PI, ..grey(albedo) };
        let scene = scene(room(Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0), [0; 6]), vec![shining], Vec::new());
        let maps = IlluminationMaps::new(&scene, 10.0).unwrap();
        let settings = PhotonSettings { with_direct: true, ..photons(1 << 20) };
        let all = trace(&scene, &first_shot(&scene), &maps, settings);
        let indirect = trace(&scene, &first_shot(&scene), &maps, photons(1 << 20));
        let inside = |k: usize| all.irradiance[k].x > 0.0 && maps.areas()[k] > 0.0;
        assert_eq!((0..maps.len()).filter(|&k| inside(k)).count(), maps.len() / 2);
        for k in (0..maps.len()).filter(|&k| inside(k)) {
            let expected = COLOR / (1.0 - albedo);
            assert!(
                (all.irradiance[k] / expected - 1.0).abs().max_element() < 0.01,
                "{} {expected}",
                all.irradiance[k]
            );
            assert!((indirect.irradiance[k] - (expected - COLOR)).abs().max_element() < 0.01 * expected.max_element());
        }
    }
}

#[test]
fn holes_take_no_part_in_the_area_of_a_cell() {
    // Half of the texels are holes, in stripes.
    let texels = (0..64u32).flat_map(|k| [0x8000_8000, 0x8000 | if k % 4 < 2 { 0xffff_0000 } else { 0 }]).collect();
    let triangles = quad(Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, 0).to_vec();
    let uv = TriangleUv { corner: Vec2::ZERO, corner_a: Vec2::X, corner_b: Vec2::Y, ..TriangleUv::default() };
    let leaves = Material { mask_texture: 0, ..grey(0.5) };
    let mut scene = Scene::new(SceneParts {
        uvs: vec![uv; 2],
        triangles,
        materials: vec![leaves],
        textures: vec![Texture { offset: 0, width: 16, height: 4, levels: 1 }],
        texels,
        ..SceneParts::default()
    })
    .unwrap();
    scene.lighting.sky.radiance = COLOR;
    let maps = IlluminationMaps::new(&scene, 10.0).unwrap();
    // Of stripes of an eighth, 9/16 of each triangle.
    assert!(maps.areas().iter().all(|&area| (area / 1.125 - 1.0).abs() < 0.05), "{:?}", maps.areas());
    let settings = PhotonSettings { with_direct: true, ..photons(1 << 18) };
    let found = trace(&scene, &first_shot(&scene), &maps, settings);
    for light in &found.irradiance {
        assert!((*light / (COLOR * PI) - 1.0).abs().max_element() < 0.03, "{light}");
    }
}

/// Emitted, escaped, absorbed luminance of power, W.
fn balance(scene: &Scene, emission: &Emission, count: u64) -> [f64; 3] {
    let maps = IlluminationMaps::new(scene, 0.5).unwrap();
    let found = trace(scene, emission, &maps, PhotonSettings { with_direct: true, ..photons(count) });
    let weights = DVec3::new(0.2126, 0.7152, 0.0722);
    let mut absorbed = 0.0;
    for t in 0..scene.geometry.triangles.len() as u32 {
        let left = Vec3::ONE - scene.tables().albedo(t, 0.3, 0.3);
        for (cell, _) in maps.cells(t, false).chain(maps.cells(t, true)) {
            absorbed += f64::from(luminance(left * found.irradiance[cell as usize]) * maps.areas()[cell as usize]);
        }
    }
    [found.emitted.dot(weights), found.escaped.dot(weights), absorbed]
}

#[test]
fn what_is_emitted_is_absorbed_or_escapes() {
    // Half open, coloured, with every kind of light.
    let mut triangles = room(Vec3::ZERO, Vec3::ONE, [0, 1, 2, 2, 0, 1]);
    triangles.drain(6..8);
    let color = |r, g, b| Material { albedo: Vec3::new(r, g, b), ..Material::default() };
    let materials = vec![
        color(0.9, 0.1, 0.1),
        color(0.1, 0.8, 0.2),
        Material { radiance: Vec3::new(0.1, 0.2, 0.3), ..color(0.5, 0.5, 0.7) },
    ];
    let edges = (Vec3::X * 0.2, Vec3::Z * 0.2);
    let rect = Light {
        kind: LIGHT_RECT,
        position: Vec3::new(0.4, 0.9, 0.4),
        edge_a: edges.0,
        edge_b: edges.1,
        area: 0.04,
        color: COLOR,
        ..Light::default()
    };
    let sun = Light { kind: LIGHT_DIRECTIONAL, direction: Vec3::new(0.6, -0.8, 0.0), color: COLOR, ..Light::default() };
    let mut scene = scene(triangles, materials, vec![bulb(Vec3::splat(0.5)), rect, sun]);
    scene.lighting.sky.radiance = Vec3::new(0.3, 0.4, 0.5);
    for emission in [first_shot(&scene), Emission::classical(&scene).unwrap()] {
        let [emitted, escaped, absorbed] = balance(&scene, &emission, 1 << 20);
        assert!(((escaped + absorbed) / emitted - 1.0).abs() < 1e-3, "{emitted} {escaped} {absorbed}");
        assert!(escaped > 0.1 * emitted && absorbed > 0.1 * emitted);
    }
}

#[test]
fn a_constant_sky_over_a_plate_gives_pi_times_its_radiance() {
    let mut scene = plate(0.5, Vec::new());
    scene.lighting.sky.radiance = COLOR;
    let maps = IlluminationMaps::new(&scene, 10.0).unwrap();
    let settings = PhotonSettings { with_direct: true, ..photons(1 << 19) };
    let found = trace(&scene, &first_shot(&scene), &maps, settings);
    for light in &found.irradiance {
        assert!((*light / (COLOR * PI) - 1.0).abs().max_element() < 5e-3, "{light}");
    }
}
