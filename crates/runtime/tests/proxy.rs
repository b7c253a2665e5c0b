//! Radiosity over the voxelisation proxy.

use glam::{Vec3, vec3};
use reference::ProxyLookup;
use runtime::Error;
use runtime::import::LoadedScene;
use runtime::procedural;
use runtime::progress::Progress;
use runtime::render::proxy::{ProxyRadiosity, ProxySettings};
use scene::{NONE, SurfacePoint};

fn bake(loaded: &LoadedScene, patch_count: usize) -> Result<ProxyRadiosity<'_>, Error> {
    let settings = ProxySettings { patch_count, rays: 512, point_rays: 4, seed: 1 };
    ProxyRadiosity::bake(&loaded.scene, settings, &mut Progress::new(true))
}

fn point(position: Vec3, normal: Vec3) -> SurfacePoint {
    SurfacePoint { position, patch: NONE, normal, weight: 1.0 }
}

#[test]
fn a_furnace_of_voxels_has_the_light_of_its_smaller_walls() {
    let loaded = procedural::build("furnace").unwrap();
    let (low, high) = loaded.scene.bounds;
    let (size, middle) = (high - low, 0.5 * (low + high));
    let material = loaded.scene.materials[0];
    let albedo = material.albedo.x;
    for count in [216, 384] {
        let proxy = bake(&loaded, count).unwrap();
        let area = 2.0 * (size.x * size.y + size.y * size.z + size.z * size.x);
        let inside = proxy.patch_count() as f32 * proxy.edge() * proxy.edge();
        // The same power from less area: Hd = M, and the rest is H = ρ Hd / (1 − ρ).
        let emitted = std::f32::consts::PI * material.radiance.x * area / inside;
        let expected = albedo * emitted / (1.0 - albedo);
        let points = [
            point(vec3(middle.x, low.y, middle.z), Vec3::Y),
            point(vec3(low.x, middle.y, middle.z), Vec3::X),
            point(vec3(middle.x, middle.y, high.z), Vec3::NEG_Z),
        ];
        for lookup in [ProxyLookup::Face, ProxyLookup::Bilinear] {
            for found in proxy.irradiance_at(&points, lookup).unwrap() {
                assert!((found.x / expected - 1.0).abs() < 0.1, "{count}: {found} {expected}");
            }
        }
        // What a pixel shows of it.
        let camera = loaded.view.camera(16, 12);
        let shown = proxy.indirect(&camera, 2, ProxyLookup::Face).unwrap().mean().x;
        let radiance = albedo * expected / std::f32::consts::PI;
        assert!((shown / radiance - 1.0).abs() < 0.15, "{shown} {radiance}");
    }
}

#[test]
fn a_lamp_inside_of_the_ceilings_voxels_lights_the_proxy() {
    let mut loaded = procedural::build("cornell").unwrap();
    let floor = [point(vec3(0.4, 0.0, 0.15), Vec3::Y)];
    let light = |loaded: &LoadedScene| {
        let proxy = bake(loaded, 150).unwrap();
        proxy.irradiance_at(&floor, ProxyLookup::Face).unwrap()[0]
    };
    assert!(light(&loaded).min_element() > 0.01);
    loaded.scene.lights.clear();
    assert_eq!(light(&loaded), Vec3::ZERO);
}

#[test]
fn settings_that_make_no_sense_are_refused() {
    let loaded = procedural::build("furnace").unwrap();
    assert!(bake(&loaded, 0).is_err());
}
