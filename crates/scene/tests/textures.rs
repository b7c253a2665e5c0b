//! Textures as pixels see them: averaged over what a pixel shows, so that far boards are grey and do not shimmer.

use glam::{Vec2, Vec3};
use patchlight_scene::kernel::camera::{primary_direction, primary_hit};
use patchlight_scene::kernel::shade::{footprint, pixel_albedo};
use patchlight_scene::{Camera, Mesh, Scene};

const SIDES: [u32; 6] = [0, 1, 2, 0, 2, 3];

/// A square floor of this half edge, with a board of 64 × 64 black and white texels on every metre.
fn board(half: f32) -> Scene {
    let texel = |k: u32| if (k % 64 + k / 64).is_multiple_of(2) { [230, 230, 230, 255] } else { [0, 0, 0, 255] };
    let rgba: Vec<u8> = (0..64 * 64).flat_map(texel).collect();
    let mut builder = Scene::builder();
    let picture = builder.add_texture((64, 64), &rgba);
    let material = builder.add_textured(picture, None);
    let positions = [(-half, -half), (-half, half), (half, half), (half, -half)].map(|(x, z)| Vec3::new(x, 0.0, z));
    let uvs = positions.map(|p| Vec2::new(p.x, p.z));
    builder.add_mesh(Mesh { positions: &positions, indices: &SIDES, uvs: &uvs, material, ..Mesh::default() });
    builder.build().expect("a floor")
}

/// Albedos of all pixels of a camera that looks along the floor.
fn albedos(scene: &Scene, camera: &Camera) -> Vec<f32> {
    let tables = scene.geometry.tables();
    (0..camera.width * camera.height)
        .map(|k| {
            let hit = primary_hit(&tables, camera, k, 0);
            pixel_albedo(&tables, camera, primary_direction(camera, k, 0), hit).x
        })
        .collect()
}

fn camera(height: f32, target: Vec3, sub_frames: u32) -> Camera {
    let camera = Camera::look_at(Vec3::Y * height, target, Vec3::NEG_Z, 40.0, 64, 48);
    Camera { fixed_sub_frames: sub_frames, ..camera }
}

#[test]
fn a_footprint_is_the_area_that_a_pixel_shows() {
    let scene = board(50.0);
    let tables = scene.geometry.tables();
    for sub_frames in [0, 1, 4] {
        // Straight down from 3 m, all footprints of a picture together are what it shows.
        let camera = camera(3.0, Vec3::ZERO, sub_frames);
        let areas = (0..64 * 48).map(|k| {
            let hit = primary_hit(&tables, &camera, k, 0);
            footprint(&tables, &camera, primary_direction(&camera, k, 0), hit)
        });
        let edge = 2.0 * 3.0 * patchlight_scene::math::tan(20.0_f32.to_radians());
        let expected = edge * edge * 64.0 / 48.0 / sub_frames.max(1) as f32;
        let sum: f32 = areas.sum();
        assert!((sum / expected - 1.0).abs() < 1e-3, "{sub_frames}: {sum}, expected {expected}");
    }
}

#[test]
fn textures_are_sharp_from_near_and_grey_from_far() {
    let scene = board(500.0);
    let white = 0.5 * patchlight_scene::math::pow((230.0 / 255.0 + 0.055) / 1.055, 2.4);
    let spread = |height: f32, sub_frames: u32| {
        let found = albedos(&scene, &camera(height, Vec3::ZERO, sub_frames));
        let mean = found.iter().sum::<f32>() / found.len() as f32;
        let variance = found.iter().map(|a| (a - mean) * (a - mean)).sum::<f32>() / found.len() as f32;
        (mean / white, variance.sqrt() / white)
    };
    // A texel is 16 mm; from 0.3 m a pixel shows 4.5 mm of the floor, from 100 m 1.5 m.
    let (_, near) = spread(0.3, 1);
    // A board that is interpolated bilinearly deviates by a third.
    assert!((near - 1.0 / 3.0).abs() < 0.02, "{near}");
    let mut before = near;
    for height in [2.0, 8.0, 30.0, 100.0] {
        let (mean, contrast) = spread(height, 1);
        assert!((mean - 1.0).abs() < 0.03, "{height}: {mean}");
        assert!(contrast <= before, "{height}: {contrast} after {before}");
        before = contrast;
    }
    assert!(before < 0.01, "{before}");
    // Sixteen sub-frames a pixel see finer texels, each its share of the pixel.
    let [one, sixteen] = [1, 16].map(|sub_frames| spread(1.0, sub_frames).1);
    assert!(sixteen > 1.3 * one, "{sixteen} {one}");
}

#[test]
fn levels_change_without_a_step() {
    let scene = board(5.0);
    let triangle = 0;
    let tables = scene.geometry.tables();
    let at = |area: f32| tables.albedo_over(triangle, 0.3, 0.2, area).x;
    assert_eq!(at(0.0), tables.albedo(triangle, 0.3, 0.2).x);
    let mut area = 1e-6_f32;
    let mut last = at(area);
    while area < 10.0 {
        area *= 1.01;
        let next = at(area);
        assert!((next - last).abs() < 0.02, "{area}: {last} to {next}");
        last = next;
    }
}
