//! Photons in a medium that absorbs: closed forms, and agreement of the ways to shoot.

mod support;

use std::f32::consts::PI;

use glam::Vec3;
use patchlight_firstshot::{
    Emission, Estimate, IlluminationMaps, LightElementSettings, PhotonAccumulator, PhotonSettings, Texels,
};
use scene::Material;
use scene::math::luminance;
use support::*;

/// e to the power x, by double precision: independent of what kernels use.
fn exp(x: f32) -> f32 {
    f64::from(x).exp() as f32
}

#[test]
fn a_sphere_filled_with_a_medium_has_its_closed_form() {
    let radius = 2.0f32;
    let albedo = 0.7;
    let absorption = Vec3::new(0.0, 0.3, 0.8);
    let shining = Material { radiance: Vec3::splat(1.0 / PI), ..grey(albedo) };
    let sphere = scene(sphere(radius, 16), vec![shining], Vec::new());
    let mean = |absorption: Vec3| {
        let scene = filled(&sphere, absorption);
        let maps = IlluminationMaps::new(&scene, 10.0).unwrap();
        let settings = PhotonSettings { with_direct: true, ..photons(1 << 19) };
        let found = trace(&scene, &first_shot(&scene), &maps, settings);
        let power: Vec3 = found.irradiance.iter().zip(maps.areas()).map(|(h, a)| *h * *a).sum();
        power / (0.5 * maps.areas().iter().sum::<f32>())
    };
    // B = M + ρH, H = τB, τ = 2∫₀¹ μ e^(−xμ) dμ = 2(1 − e^(−x)(1 + x))/x² with x = 2Rσ.
    let tau = absorption.map(|sigma| {
        let x = 2.0 * radius * sigma;
        if x > 0.0 { 2.0 * (1.0 - exp(-x) * (1.0 + x)) / (x * x) } else { 1.0 }
    });
    let expected = tau / (Vec3::ONE - albedo * tau);
    let found = mean(absorption);
    // Flat parts of the sphere do not see themselves, and each other better.
    assert!((found / expected - 1.0).abs().max_element() < 0.02, "{found} for {expected}");
    let wrong = mean(absorption * 1.2) / expected - 1.0;
    assert!(wrong.y < -0.05 && wrong.z < -0.05, "more absorption is noticed: {wrong}");
}

#[test]
fn a_lamp_in_a_medium_lights_a_plate_by_its_closed_form() {
    let height = 1.0f32;
    let absorption = Vec3::new(0.0, 0.4, 2.0);
    let open = plate(0.5, vec![bulb(Vec3::Y * height)]);
    let scene = filled(&open, absorption);
    // The integral of I cosθ/d² e^(−σd) over the plate, in small squares.
    let mut expected = Vec3::ZERO;
    let n = 400;
    for k in 0..n * n {
        let place = |k: i32| 2.0 * (k as f32 + 0.5) / n as f32 - 1.0;
        let distance = Vec3::new(place(k % n), height, place(k / n)).length();
        expected += COLOR * (-absorption * distance).map(exp) * (height / distance.powi(3) * 4.0 / (n * n) as f32);
    }
    let maps = IlluminationMaps::new(&scene, 10.0).unwrap();
    let settings = PhotonSettings { with_direct: true, ..photons(1 << 19) };
    let lands = trace(&scene, &Emission::classical(&scene).unwrap(), &maps, settings);
    let landed: Vec3 = lands.irradiance.iter().zip(maps.areas()).map(|(h, a)| *h * *a).sum();
    assert!((landed / expected - 1.0).abs().max_element() < 0.01, "{landed} for {expected}");
    let without = trace(&open, &Emission::classical(&open).unwrap(), &maps, settings);
    let more: Vec3 = without.irradiance.iter().zip(maps.areas()).map(|(h, a)| *h * *a).sum();
    assert!((more / expected - 1.0).z > 1.0, "without the medium there is more light: {more}");
    // The table of light elements holds the luminance of the same, times the albedo.
    for exact in [false, true] {
        let settings = LightElementSettings { tolerance: 0.01, ..LightElementSettings::default() };
        let emission = Emission::first_shot(&scene, &settings, Texels::Mean, exact, &ignore_progress).unwrap();
        let power = 0.5 * f64::from(luminance(expected));
        assert!((emission.power / power - 1.0).abs() < 0.02, "{exact}: {} for {power}", emission.power);
    }
}

#[test]
fn all_ways_to_shoot_agree_in_a_medium() {
    let settings = PhotonSettings { batches: 16, ..photons(1 << 19) };
    let absorption = Vec3::new(0.3, 1.0, 2.0);
    for light in &lights()[..2] {
        let open = room_with_a_window(vec![*light]);
        let scene = filled(&open, absorption);
        let maps = IlluminationMaps::new(&scene, 0.25).unwrap();
        let classical = trace(&scene, &Emission::classical(&scene).unwrap(), &maps, settings);
        let found = trace(&scene, &first_shot(&scene), &maps, settings);
        let (sigma, all) = deviation(&maps, &found, &classical);
        assert!(sigma < 1.25 && all.abs() < 0.01, "{:?}: {sigma} {all}", light.kind);
        // The table alone is off by its own error.
        let table = LightElementSettings { tolerance: 0.01, ..LightElementSettings::table_alone() };
        let emission = Emission::first_shot(&scene, &table, Texels::Mean, false, &ignore_progress).unwrap();
        let by_table = deviation(&maps, &trace(&scene, &emission, &maps, settings), &classical).1;
        assert!(by_table.abs() < 0.03, "{:?}: {by_table}", light.kind);
        // Air in its place is noticed.
        let air = trace(&open, &first_shot(&open), &maps, settings);
        assert!(deviation(&maps, &air, &classical).1 > 0.2);
    }
    // No light of a sun or a sky comes through.
    let mut endless = filled(&room_with_a_window(vec![lights()[2]]), absorption);
    endless.lighting.sky.radiance = Vec3::ONE;
    assert!(first_shot(&endless).is_dark() && Emission::classical(&endless).unwrap().is_dark());
}

#[test]
fn light_from_infinity_comes_in_channels_that_a_medium_leaves_alone() {
    let settings = PhotonSettings { batches: 16, ..photons(1 << 18) };
    let of = |absorption: Vec3| {
        let mut scene = filled(&room_with_a_window(vec![lights()[2]]), absorption);
        scene.lighting.sky.radiance = Vec3::ONE;
        scene
    };
    let scene = of(Vec3::new(0.0, 1.0, 2.0));
    let maps = IlluminationMaps::new(&scene, 0.25).unwrap();
    let classical = trace(&scene, &Emission::classical(&scene).unwrap(), &maps, settings);
    let found = trace(&scene, &first_shot(&scene), &maps, settings);
    for estimate in [&classical, &found] {
        let sum: Vec3 = estimate.irradiance.iter().sum();
        assert!(sum.x > 0.0 && sum.y == 0.0 && sum.z == 0.0, "{sum}");
    }
    let (sigma, all) = deviation(&maps, &found, &classical);
    assert!(sigma < 1.3 && all.abs() < 0.02, "{sigma} {all}");
    // All of it: red light is that of air.
    let red = |estimate: &Estimate| estimate.irradiance.iter().zip(maps.areas()).map(|(h, a)| h.x * a).sum::<f32>();
    let air = of(Vec3::ZERO);
    let in_air = trace(&air, &first_shot(&air), &maps, settings);
    assert!((red(&found) / red(&in_air) - 1.0).abs() < 0.02, "{} {}", red(&found), red(&in_air));
}
