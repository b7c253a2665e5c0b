//! Smoothing and interpolation of known light.

use core::sync::atomic::{AtomicUsize, Ordering};

use glam::Vec4;
use scene::gpu::{Triangle, TriangleUv};
use scene::kernel::walk::LIT;
use scene::math::sqrt;
use scene::sampling::{hash, hash3, unit};
use scene::{Ray, SceneParts};

use super::*;
use crate::host::lit::Walker;

/// Receivers at random places of a square of 10 × 10 m, one a square metre, far from a scene of one triangle.
fn square(scene: &Scene) -> ReceiverField<'_> {
    let place = |k: u32| Vec3::new(10.0 * unit(hash3(k, 1, 5)), 10.0 * unit(hash3(k, 2, 5)), 100.0);
    let samples =
        (0..100).map(|k| Sample { position: place(k), normal: Vec3::Z, area: 1.0, ..Sample::default() }).collect();
    let set = ReceiverSamples::new(scene, Density::default(), samples, 1).unwrap();
    ReceiverField::new(ReceiverSamples { mean_area: 1.0, ..set })
}

fn triangle() -> Scene {
    let triangles = vec![Triangle { edge_a: Vec3::X, edge_b: Vec3::Y, ..Triangle::default() }];
    let parts =
        SceneParts { triangles, uvs: vec![TriangleUv::default()], materials: vec![<_>::default()], ..<_>::default() };
    Scene::new(parts).unwrap()
}

/// Light that rises along x from 1 to 2, and light with a step.
fn light(position: Vec3) -> Lights {
    [
        Vec4::new(1.0 + 0.1 * position.x, 0.0, 0.0, 0.0),
        Vec4::new(if position.y > 5.0 { 2.0 } else { 1.0 }, 0.0, 0.0, 0.0),
        Vec4::ZERO,
    ]
}

#[test]
fn interpolation_points_take_a_slope_as_it_is_and_leave_no_range() {
    let scene = triangle();
    let field = square(&scene);
    let smooth: Vec<Lights> = field.set.samples.iter().map(|s| light(s.position)).collect();
    let mut fit_error = 0.0f32;
    let mut mean_error = 0.0f32;
    let mut count = 0;
    for k in 0..400 {
        let position = Vec3::new(10.0 * unit(hash3(k, 3, 5)), 10.0 * unit(hash3(k, 4, 5)), 100.0);
        let point = SurfacePoint { position, normal: Vec3::Z, ..SurfacePoint::default() };
        let mut weights = field.visible_weights(&[point], None).unwrap().remove(0);
        let mean = weighted_sum(&weights, &smooth);
        let range = |v: usize| {
            let each = || weights.iter().map(|w| smooth[w.0 as usize][v].x);
            (each().fold(f32::MAX, f32::min), each().fold(f32::MIN, f32::max))
        };
        let ranges = [range(0), range(1)];
        field.fit(&point, &mut weights, &smooth);
        assert!((weights.iter().map(|w| w.1).sum::<f32>() - 1.0).abs() < 1e-4);
        let fit = weighted_sum(&weights, &smooth);
        for (v, (least, most)) in ranges.into_iter().enumerate() {
            // What small weights held may be missing.
            let slack = 0.1 * (most - least) + 1e-4;
            assert!(
                fit[v].x >= least - slack && fit[v].x <= most + slack,
                "point {k}: {} of {least}..{most}",
                fit[v].x
            );
        }
        let even = ranges[1].0 == ranges[1].1;
        if even && (1.0..9.0).contains(&position.x) && (1.0..9.0).contains(&position.y) {
            fit_error += (fit[0].x - light(position)[0].x).abs();
            mean_error += (mean[0].x - light(position)[0].x).abs();
            count += 1;
        }
    }
    assert!(count > 100, "{count} points");
    // Some points lie outside of their receivers. The mean of the same receivers is wrong.
    let fit = fit_error / count as f32;
    let mean = mean_error / count as f32;
    assert!(fit < 0.01 && mean > 2.0 * fit, "fit {fit}, mean {mean}, slope 0.1 an edge");
}

/// Traces rays on the host, and counts how often it is asked. Of a liar every third ray is stopped that is not, and the
/// other way round.
struct Looks {
    calls: AtomicUsize,
    is_liar: bool,
}

impl Walker for Looks {
    fn reachability(&self, _: &Scene, places: &[SurfacePoint], _: u32, _: u32) -> Result<Vec<u32>, Error> {
        Ok(vec![LIT; places.len()])
    }

    fn stopped(&self, scene: &Scene, rays: &[Ray]) -> Result<Vec<u32>, Error> {
        self.calls.fetch_add(1, Ordering::Relaxed);
        let is_stopped = |(k, ray): (usize, &Ray)| {
            let is_stopped = scene.occluded(ray.origin, ray.direction, ray.t_max);
            u32::from(is_stopped != (self.is_liar && k.is_multiple_of(3)))
        };
        Ok(rays.iter().enumerate().map(is_stopped).collect())
    }
}

/// A wall through the middle of the square: beside it points ask again and again.
#[test]
fn points_that_look_together_take_the_receivers_that_each_would_take() {
    let corner = Vec3::new(5.0, -20.0, 80.0);
    let wall = Triangle { corner, edge_a: 80.0 * Vec3::Y, edge_b: 80.0 * Vec3::Z, ..Triangle::default() };
    let uvs = vec![TriangleUv::default()];
    let materials = vec![<_>::default()];
    let scene = Scene::new(SceneParts { triangles: vec![wall], uvs, materials, ..<_>::default() }).unwrap();
    let field = square(&scene);
    let point = |k: u32| {
        let position = Vec3::new(10.0 * unit(hash3(k, 3, 5)), 10.0 * unit(hash3(k, 4, 5)), 100.0);
        SurfacePoint { position, normal: Vec3::Z, ..SurfacePoint::default() }
    };
    let points: Vec<SurfacePoint> = (0..400).map(point).collect();
    let alone = field.visible_weights(&points, None).unwrap();
    let beyond = |(point, own): (&SurfacePoint, &PointWeights)| {
        own.iter().any(|w| (field.set.samples[w.0 as usize].position.x > 5.0) != (point.position.x > 5.0))
    };
    assert!(!points.iter().zip(&alone).any(beyond), "nobody sees through the wall");
    let [honest, liar] = [false, true].map(|is_liar| Looks { calls: AtomicUsize::new(0), is_liar });
    assert!(field.visible_weights(&points, Some(&honest)).unwrap() == alone);
    assert!((2..20).contains(&honest.calls.into_inner()));
    assert!(field.visible_weights(&points, Some(&liar)).unwrap() != alone);
}

/// Nine receivers on an arc round a point: the ninth, which gives the range, has as much weight as each of the others.
#[test]
fn a_fit_through_receivers_that_are_equally_far_stays_in_range() {
    let scene = triangle();
    let samples: Vec<Sample> = (0..9)
        .map(|k| {
            let (sin, cos) = scene::math::sin_cos_2pi(0.02 * k as f32);
            Sample { position: Vec3::new(5.0 * cos, 5.0 * sin, 100.0), normal: Vec3::Z, area: 1.0, ..Sample::default() }
        })
        .collect();
    let set = ReceiverSamples::new(&scene, Density::default(), samples, 1).unwrap();
    let field = ReceiverField::new(ReceiverSamples { mean_area: 1.0, ..set });
    let point = SurfacePoint { position: Vec3::new(0.0, 0.0, 100.0), normal: Vec3::Z, ..SurfacePoint::default() };
    for seed in 0..400 {
        let value = |k: u32| Vec4::splat(2.0 * unit(hash3(k, seed, 9)));
        let smooth: Vec<Lights> = (0..9).map(|k| [value(k), Vec4::ZERO, Vec4::ZERO]).collect();
        let mut weights = field.visible_weights(&[point], None).unwrap().remove(0);
        assert_eq!(weights.len(), 8);
        field.fit(&point, &mut weights, &smooth);
        let sum: f32 = weights.iter().map(|w| w.1).sum();
        let greatest = weights.iter().map(|w| w.1.abs()).fold(0.0, f32::max);
        assert!((sum - 1.0).abs() < 1e-4 && greatest < 1.9, "{seed}: {weights:?}");
    }
}

#[test]
fn smoothing_takes_noise_and_leaves_slopes() {
    let scene = triangle();
    let field = square(&scene);
    let noise = |k: usize| 0.2 * (unit(hash(k as u32)) - 0.5);
    let samples = || field.set.samples.iter().enumerate();
    let with = |variance: f32| Estimates {
        light: samples().map(|(k, s)| light(s.position).map(|v| v * (1.0 + noise(k)))).collect(),
        variance: samples().map(|(_, s)| light(s.position).map(|v| v * v * variance)).collect(),
    };
    let error = |estimates: &Estimates, rows: &[Vec<Entry>]| {
        let each = samples().zip(rows).map(|((_, s), row)| {
            assert!(row.iter().all(|w| w.1 >= 0.0) && (row.iter().map(|w| w.1).sum::<f32>() - 1.0).abs() < 1e-4);
            let found = weighted_sum(row, &estimates.light);
            let true_light = light(s.position);
            [0, 1].map(|v| (found[v].x / true_light[v].x - 1.0).powi(2))
        });
        let sum = each.fold([0.0; 2], |a: [f32; 2], b| [a[0] + b[0], a[1] + b[1]]);
        sum.map(|s| sqrt(s / field.set.samples.len() as f32))
    };
    let estimates = with(0.2 * 0.2 / 12.0);
    let raw: Vec<Vec<Entry>> = samples().map(|(k, _)| vec![(k as u32, 1.0)]).collect();
    let before = error(&estimates, &raw);
    let after = error(&estimates, &field.smoothing(&estimates));
    assert!(after[0] < 0.75 * before[0] && after[1] < 0.75 * before[1], "{before:?} to {after:?}");
    // Given that noise is twenty times as great, it blurs the step.
    let wrong = with(20.0 * 20.0 * 0.2 * 0.2 / 12.0);
    let blurred = error(&wrong, &field.smoothing(&wrong));
    assert!(blurred[1] > before[1], "{blurred:?}");
}
