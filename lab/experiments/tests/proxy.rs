//! Radiosity over the voxelisation proxy.

use assets::import::LoadedScene;
use assets::procedural;
use experiments::Error;
use experiments::proxy::{ProxyRadiosity, ProxySettings};
use glam::{Vec3, vec3};
use opponents::ProxyLookup;
use scene::{NONE, SurfacePoint};
use shell::progress::Progress;

fn bake(loaded: &LoadedScene, patch_count: usize) -> Result<ProxyRadiosity<'_>, Error> {
    let settings = ProxySettings { patch_count, rays: 512, point_rays: 64, seed: 1 };
    ProxyRadiosity::bake(&loaded.scene, settings, &Progress::new(true))
}

fn point(position: Vec3, normal: Vec3) -> SurfacePoint {
    SurfacePoint { position, patch: NONE, normal, weight: 1.0 }
}

#[test]
fn a_furnace_of_voxels_has_the_light_of_its_smaller_walls() {
    let loaded = procedural::build("furnace").unwrap();
    let material = loaded.scene.materials[0];
    let albedo = material.albedo.x;
    // A box of 2 m round the origin.
    let area = 24.0;
    for count in [150, 384] {
        let proxy = bake(&loaded, count).unwrap();
        let edge = proxy.edge();
        let inside = proxy.patch_count() as f32 * edge * edge;
        // The same power from less area: the mean of Hd is M, of the rest H = ρ Hd / (1 − ρ).
        let emitted = std::f32::consts::PI * material.radiance.x * area / inside;
        let expected = albedo * emitted / (1.0 - albedo);
        // The places of the true walls behind the middles of the faces.
        let along = (proxy.patch_count() as f32 / 6.0).sqrt().round() as usize;
        assert_eq!(6 * along * along, proxy.patch_count());
        let place = |k: usize| (k as f32 + 0.5 - 0.5 * along as f32) * edge;
        let mut points = Vec::new();
        for (x, y) in (0..along * along).map(|k| (place(k % along), place(k / along))) {
            for side in [-1.0f32, 1.0] {
                points.push(point(vec3(side, x, y), Vec3::X * -side));
                points.push(point(vec3(x, side, y), Vec3::Y * -side));
                points.push(point(vec3(x, y, side), Vec3::Z * -side));
            }
        }
        for lookup in [ProxyLookup::Face, ProxyLookup::Bilinear] {
            let found = proxy.irradiance_at(&points, lookup);
            let mean = found.iter().map(|h| h.x).sum::<f32>() / found.len() as f32;
            // Direct light and rows are estimates of some rays each.
            assert!((mean / expected - 1.0).abs() < 0.03, "{count}: {mean} {expected}");
            // With the walls' true area the expectation would be far off.
            assert!((mean * inside / area / expected - 1.0).abs() > 0.1);
        }
        // What a pixel shows of it: the back wall, a little darker in its middle than near its edges.
        let camera = loaded.view.camera(16, 12);
        let shown = proxy.indirect(&camera, 2, ProxyLookup::Face).unwrap().mean().x;
        let radiance = albedo * expected / std::f32::consts::PI;
        assert!((shown / radiance - 1.0).abs() < 0.2, "{count}: {shown} {radiance}");
    }
}

#[test]
fn a_lamp_inside_of_the_ceilings_voxels_lights_the_proxy() {
    let mut loaded = procedural::build("cornell").unwrap();
    let floor = [point(vec3(0.4, 0.0, 0.15), Vec3::Y)];
    let light = |loaded: &LoadedScene| {
        let proxy = bake(loaded, 150).unwrap();
        proxy.irradiance_at(&floor, ProxyLookup::Face)[0]
    };
    assert!(light(&loaded).min_element() > 0.01);
    loaded.scene.lighting.lights.clear();
    assert_eq!(light(&loaded), Vec3::ZERO);
}

#[test]
fn settings_that_make_no_sense_are_refused() {
    let loaded = procedural::build("furnace").unwrap();
    assert!(bake(&loaded, 0).is_err());
}

#[test]
fn a_point_that_no_face_serves_is_dark() {
    // Slats thinner than voxels: no face that light comes to looks down there.
    let loaded = procedural::build("blinds").unwrap();
    let proxy = bake(&loaded, 500).unwrap();
    let down = point(vec3(1.332_359_3, 2.7, 3.973_906_8), Vec3::NEG_Y);
    let nowhere = point(down.position, Vec3::ZERO);
    for lookup in [ProxyLookup::Face, ProxyLookup::Bilinear] {
        assert!(proxy.irradiance_at(&[down, nowhere], lookup).iter().all(|h| h.is_finite()));
        assert_eq!(proxy.irradiance_at(&[nowhere], lookup), [Vec3::ZERO]);
    }
}
