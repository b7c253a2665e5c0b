//! Form factors between points by hand.

use std::ops::ControlFlow;

use formfactor::{Patch, PointToPoint, form_factors};
use glam::Vec3;
use printed::PrintedPoints;
use scene::gpu::{Triangle, TriangleUv};
use scene::{Material, NONE, Scene, SceneParts, SurfacePoint};
use transport::Surfaces;

#[test]
fn two_points_by_hand() {
    // Two points that face each other 2 m apart, the other turned by 60°: s cos 0° cos 60° / (π r²).
    let patches =
        [Patch { centroid: Vec3::Y * 2.0, area: 0.5, normal: Vec3::new(0.75f32.sqrt(), -0.5, 0.0), triangle: 0 }];
    let points = [SurfacePoint { position: Vec3::ZERO, patch: 0, normal: Vec3::Y, weight: 1.0 }];
    let scene = |height: f32| {
        let corner = Vec3::new(-1.0, height, -1.0);
        let triangle = Triangle { corner, edge_a: Vec3::X * 9.0, edge_b: Vec3::Z * 9.0, ..Triangle::default() };
        let triangles = vec![triangle];
        let uvs = vec![TriangleUv::default()];
        Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..<_>::default() }).unwrap()
    };
    let factor = |estimator: &dyn formfactor::Estimator, height: f32| {
        let scene = scene(height);
        let surfaces = Surfaces {
            patches: &patches,
            polygons: &[],
            row_polygons: &[],
            points: &points,
            offsets: &[0, 1],
            visibility: &scene,
            owner: Box::new(|_, _| NONE),
            ray_offset: 1e-4,
            seed: 0,
        };
        form_factors(estimator, &surfaces, &|_, _| ControlFlow::Continue(())).unwrap()
    };
    let printed = PrintedPoints { sky_rays: 64 };
    let above = factor(&printed, 3.0);
    let between = factor(&printed, 1.0);
    let expected = 0.5 * 0.5 / (core::f32::consts::PI * 4.0);
    assert!((above.factors.values[0] - expected).abs() < 1e-6);
    assert_eq!(between.factors.values[0], 0.0);
    // The triangle takes the sky that rays to the right, away from its edges, would see.
    assert!(above.sky_factor[0] > between.sky_factor[0] && between.sky_factor[0] > 0.0);
    // The disc form is another.
    let disc = factor(&PointToPoint { sky_rays: 64 }, 3.0).factors.values[0];
    assert!((disc - expected).abs() > 1e-4);
}
