//! Photons over mirrors and through clear glass: closed forms, and agreement of the ways to shoot.

mod support;

use std::f32::consts::PI;

use glam::Vec3;
use patchlight_firstshot::{Emission, Estimate, IlluminationMaps, PhotonAccumulator, PhotonSettings};
use scene::gpu::{LIGHT_DIRECTIONAL, Triangle};
use scene::{Light, Material, Scene};
use support::*;

/// Refractive index of glass.
const INDEX: f32 = 1.5;

fn specular(mirror: Vec3, transmittance: f32) -> Material {
    Material { mirror, transmittance: Vec3::splat(transmittance), index_of_refraction: INDEX, ..grey(0.0) }
}

/// A sun that travels along a direction.
fn sun(direction: Vec3) -> Light {
    Light { kind: LIGHT_DIRECTIONAL, direction: direction.normalize(), color: COLOR, ..Light::default() }
}

/// Indirect flux that lands on triangles of a material, W.
fn landed(scene: &Scene, maps: &IlluminationMaps, found: &Estimate, material: u32) -> Vec3 {
    let triangles = (0..scene.geometry.triangles.len() as u32)
        .filter(|&t| scene.geometry.triangles[t as usize].material == material);
    let cells = triangles.flat_map(|t| [false, true].map(|is_back| (t, is_back)));
    cells
        .flat_map(|(t, is_back)| maps.cells(t, is_back).map(|(cell, _)| cell as usize).collect::<Vec<_>>())
        .map(|cell| found.irradiance[cell] * maps.areas()[cell])
        .sum()
}

/// Photons of both ways to shoot, each with the flux that lands on a material.
fn by_both(scene: &Scene, material: u32) -> [Vec3; 2] {
    let maps = IlluminationMaps::new(scene, 0.25).unwrap();
    [first_shot(scene), Emission::classical(scene).unwrap()]
        .map(|emission| landed(scene, &maps, &trace(scene, &emission, &maps, photons(1 << 19)), material))
}

#[test]
fn a_mirror_sends_a_sun_on_as_it_comes() {
    let silver = Vec3::new(0.9, 0.5, 0.2);
    let below = |ground: Material| {
        let mut triangles = quad(Vec3::ZERO, Vec3::Z, Vec3::X, 0).to_vec();
        // The lower half of the wall gets all that the mirror sends, the upper half none.
        triangles.extend(quad(Vec3::X, Vec3::Z, Vec3::Y, 1));
        triangles.extend(quad(Vec3::X + Vec3::Y, Vec3::Z, Vec3::Y, 2));
        scene(triangles, vec![ground, grey(0.0), grey(0.0)], vec![sun(Vec3::new(1.0, -1.0, 0.0))])
    };
    let room = below(specular(silver, 0.0));
    let expected = silver * COLOR * 0.5f32.sqrt();
    for found in by_both(&room, 1) {
        assert!((found / expected - 1.0).abs().max_element() < 0.01, "{found} for {expected}");
    }
    for found in by_both(&room, 2) {
        assert!(found.max_element() < 1e-3 * expected.max_element(), "{found} where nothing is sent");
    }
    let diffuse = by_both(&below(Material { albedo: silver, ..grey(0.0) }), 1)[0];
    assert!((diffuse / expected).max_element() < 0.6, "a diffuse ground is noticed: {diffuse}");
}

/// Transmittance of a slab of glass by the cosine of the angle of incidence, in the forms with sines and tangents.
fn through_a_slab(cosine: f32) -> f32 {
    let here = f64::from(cosine).acos();
    let there = (here.sin() / f64::from(INDEX)).asin();
    let across = ((here - there).sin() / (here + there).sin()).powi(2);
    let along = ((here - there).tan() / (here + there).tan()).powi(2);
    let of = |r: f64| (1.0 - r) * (1.0 - r) / (1.0 - r * r);
    // Light is taken as not polarised at each face.
    of(0.5 * (across + along)) as f32
}

#[test]
fn a_sun_comes_through_glass_as_fresnel_says() {
    let direction = Vec3::new(0.8, -1.0, 0.0).normalize();
    let expected = COLOR * (-direction.y * through_a_slab(-direction.y));
    let with = |glass: Material, faces: &[Triangle]| {
        let mut triangles = quad(Vec3::new(-2.0, 0.0, -1.5), Vec3::Z * 4.0, Vec3::X * 5.0, 1).to_vec();
        triangles.extend(faces);
        scene(triangles, vec![glass, grey(0.0)], vec![sun(direction)])
    };
    let low = quad(Vec3::new(0.0, 0.49, 0.0), Vec3::X, Vec3::Z, 0);
    let high = quad(Vec3::new(0.0, 0.5, 0.0), Vec3::Z, Vec3::X, 0);
    let glass = specular(Vec3::ZERO, 1.0);
    let slab = with(glass, &[low, high].concat());
    let pane = with(Material { is_pane: 1, ..glass }, &high);
    for scene in [&slab, &pane] {
        for found in by_both(scene, 1) {
            // At the edges of the slab a hundredth of the light leaves it.
            assert!((found / expected - 1.0).abs().max_element() < 0.015, "{found} for {expected}");
        }
    }
    let denser = Material { index_of_refraction: 2.0, is_pane: 1, ..glass };
    let found = by_both(&with(denser, &high), 1)[0];
    assert!((found / expected).max_element() < 0.93, "another glass is noticed: {found} for {expected}");
}

/// A room with a mirror, a mixed wall, and a block of glass.
fn specular_room(lights: Vec<Light>, shining: Vec3, mirror: f32) -> Scene {
    let mixed = Material { albedo: Vec3::splat(0.3), mirror: Vec3::new(0.2, 0.3, 0.1), ..specular(Vec3::ZERO, 0.2) };
    let mut triangles = room(Vec3::ZERO, Vec3::ONE, [0, 1, 0, 0, 0, 0]);
    // With its fronts outside.
    triangles.extend(room(Vec3::new(0.7, 0.4, 0.7), Vec3::splat(-0.3), [2; 6]));
    triangles.extend(quad(Vec3::new(0.1, 0.1, 0.3), Vec3::Y * 0.5, Vec3::new(0.2, 0.1, 0.3), 3));
    let materials = vec![
        Material { radiance: shining, ..grey(0.5) },
        Material { radiance: shining, albedo: Vec3::splat(0.2), mirror: Vec3::splat(0.3), ..grey(0.0) },
        specular(Vec3::ZERO, 1.0),
        if mirror > 0.0 { specular(Vec3::splat(mirror), 0.0) } else { mixed },
    ];
    scene(triangles, materials, lights)
}

#[test]
fn all_ways_to_shoot_agree_among_mirrors_and_glass() {
    let settings = PhotonSettings { batches: 16, ..photons(1 << 19) };
    for light in &lights()[..2] {
        let scene = specular_room(vec![*light], Vec3::ZERO, 0.0);
        let maps = IlluminationMaps::new(&scene, 0.25).unwrap();
        let classical = trace(&scene, &Emission::classical(&scene).unwrap(), &maps, settings);
        let found = trace(&scene, &first_shot(&scene), &maps, settings);
        let (sigma, all) = deviation(&maps, &found, &classical);
        assert!(sigma < 1.25 && all.abs() < 0.01, "{:?}: {sigma} {all}", light.kind);
        // Without its specular parts the room is another one.
        let mut dull = scene.clone();
        dull.materials =
            dull.materials.iter().map(|m| Material { mirror: Vec3::ZERO, transmittance: Vec3::ZERO, ..*m }).collect();
        let dull = trace(&dull, &first_shot(&dull), &maps, settings);
        assert!(deviation(&maps, &dull, &classical).1 < -0.05);
    }
}

#[test]
fn the_furnace_is_even_among_mirrors_and_glass() {
    let mean = |mirror: f32| {
        let scene = specular_room(Vec::new(), Vec3::splat(1.0 / PI), mirror);
        let maps = IlluminationMaps::new(&scene, 0.5).unwrap();
        let settings = PhotonSettings { with_direct: true, ..photons(1 << 20) };
        let found = trace(&scene, &first_shot(&scene), &maps, settings);
        // Both kinds of walls send half of what they get and 1 of their own: H = 1 + H/2.
        [0, 1, 3].map(|material| {
            let area: f32 = scene
                .geometry
                .triangles
                .iter()
                .filter(|t| t.material == material)
                .map(|t| 0.5 * t.edge_a.cross(t.edge_b).length() * if material == 3 { 2.0 } else { 1.0 })
                .sum();
            landed(&scene, &maps, &found, material).x / area
        })
    };
    let found = mean(1.0);
    assert!(found.iter().all(|h| (h / 2.0 - 1.0).abs() < 0.01), "{found:?}");
    assert!(mean(0.5)[0] < 1.96, "a mirror that absorbs is noticed");
}
