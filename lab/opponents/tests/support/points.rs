//! Points at which an opponent's light is compared, and light that is known there.
#![allow(dead_code, reason = "each test file uses a part")]

use assets::LoadedScene;
use glam::Vec3;
use opponents::ViewedPoint;
use reference::{PathSettings, PathTracer};
use scene::kernel::camera::{primary_direction, primary_hit, surface_point};
use scene::math::luminance;
use scene::{NONE, SurfacePoint};

/// Pixels along the edge of the pictures at whose points light is asked for.
const EDGE: u32 = 16;

/// Points of the scene in view.
pub fn points(loaded: &LoadedScene) -> Vec<ViewedPoint> {
    let camera = loaded.view.camera(EDGE, EDGE);
    let tables = loaded.scene.tables();
    let point = |pixel: u32| {
        let hit = primary_hit(&tables, &camera, pixel, 0);
        let direction = primary_direction(&camera, pixel, 0);
        let SurfacePoint { position, normal, .. } = surface_point(&tables, hit, direction);
        (!hit.is_miss()).then_some(ViewedPoint { position, normal, to_eye: -direction })
    };
    (0..EDGE * EDGE).filter_map(point).collect()
}

/// Mean luminance of `found` over that of `expected`, and the median of the relative errors.
pub fn compare(found: &[Vec3], expected: &[Vec3]) -> (f32, f32) {
    assert_eq!(found.len(), expected.len());
    let sum = |values: &[Vec3]| values.iter().map(|h| luminance(*h)).sum::<f32>();
    let error = |(f, e): (&Vec3, &Vec3)| (luminance(*f) / luminance(*e) - 1.0).abs();
    let mut errors: Vec<f32> = found.iter().zip(expected).map(error).collect();
    errors.sort_by(f32::total_cmp);
    (sum(found) / sum(expected), errors[errors.len() / 2])
}

/// Indirect irradiance of the path tracer, of at most so many bounces.
pub fn traced(loaded: &LoadedScene, points: &[ViewedPoint], bounces: u32, samples: u32) -> Vec<Vec3> {
    let surface = |p: &ViewedPoint| SurfacePoint { position: p.position, patch: NONE, normal: p.normal, weight: 1.0 };
    let surface: Vec<SurfacePoint> = points.iter().map(surface).collect();
    let settings = PathSettings { bounces, ..PathSettings::default() };
    PathTracer::new(&loaded.scene).irradiance(&surface, samples, &settings).iter().map(|p| p.indirect).collect()
}
