//! Light that goes on from frame to frame: its eigenvalues, and how soon it settles.

use glam::Vec4;
use patchlight_multibounce::kernel::feedback::change;
use patchlight_multibounce::{Acceleration, Error, spectral_range};
use scene::math::ln;
use scene::sampling::{hash3, unit};
use transport::FnOperator;

const N: usize = 60;

/// A matrix that is symmetric, with row sums of at most 1: near patches see more of each other.
fn matrix() -> Vec<Vec<f32>> {
    let s = |i: usize, j: usize| {
        let x = i.abs_diff(j) as f32 / N as f32;
        if i == j { 0.0 } else { (0.5 + unit(hash3(i.min(j) as u32, i.max(j) as u32, 2))) / (0.02 + x * x) }
    };
    let most = (0..N).map(|i| (0..N).map(|j| s(i, j)).sum::<f32>()).fold(0.0, f32::max);
    (0..N).map(|i| (0..N).map(|j| s(i, j) / most).collect()).collect()
}

fn multiply(matrix: &[Vec<f32>], light: &[Vec4], out: &mut [Vec4]) {
    for (out, row) in out.iter_mut().zip(matrix) {
        *out = row.iter().zip(light).map(|(f, b)| *b * *f).sum();
    }
}

fn albedo() -> Vec<Vec4> {
    let random = |i: usize, c| 0.5 + 0.45 * unit(hash3(i as u32, c, 5));
    (0..N).map(|i| Vec4::new(random(i, 0), random(i, 1), random(i, 2), 0.0)).collect()
}

/// Distance to where the light settles, after each bounce, as a share of the first.
fn distances(acceleration: Acceleration, bounces: usize) -> Vec<f32> {
    distances_by(&vec![acceleration; bounces])
}

/// As [`distances`], each bounce by its own step.
fn distances_by(steps: &[Acceleration]) -> Vec<f32> {
    let matrix = matrix();
    let albedo = albedo();
    let source: Vec<Vec4> = (0..N).map(|i| Vec4::splat(if i < 3 { 1.0 } else { 0.0 })).collect();
    let run = |steps: &[Acceleration], from: &[Vec4]| -> Vec<Vec<Vec4>> {
        let mut light = from.to_vec();
        let mut last = vec![Vec4::ZERO; N];
        let mut irradiance = vec![Vec4::ZERO; N];
        let mut all = Vec::new();
        for acceleration in steps {
            let p = acceleration.params(N as u32);
            multiply(&matrix, &light, &mut irradiance);
            for i in 0..N {
                last[i] = change(&p, source[i], albedo[i], irradiance[i], light[i], last[i]);
                light[i] += last[i];
            }
            all.push(light.clone());
        }
        all
    };
    let dark = vec![Vec4::ZERO; N];
    let plain = Acceleration { step: 1.0, momentum: 0.0, rate: 0.0 };
    let settled = run(&[plain; 2000], &dark).pop().unwrap();
    let distance = |light: &[Vec4]| {
        light.iter().zip(&settled).map(|(a, b)| (*a - *b).truncate().length_squared()).sum::<f32>().sqrt()
    };
    let first = distance(&dark);
    run(steps, &dark).iter().map(|light| distance(light) / first).collect()
}

fn range() -> std::ops::RangeInclusive<f32> {
    let matrix = matrix();
    let operator = FnOperator::new(N, N, |light: &[Vec4], out: &mut [Vec4]| {
        multiply(&matrix, light, out);
        Ok(())
    });
    spectral_range(&operator, &albedo(), 1e-4, 1000).unwrap()
}

#[test]
fn eigenvalues_of_two_plates_are_known() {
    // diag(ρ) F = [[0, a], [b, 0]]: ± √(a b).
    let albedo = [Vec4::new(0.8, 0.2, 0.0, 0.0), Vec4::new(0.5, 0.9, 0.3, 0.0)];
    let operator = FnOperator::new(2, 2, |light: &[Vec4], out: &mut [Vec4]| {
        (out[0], out[1]) = (light[1] * 0.9, light[0] * 0.4);
        Ok(())
    });
    let range = spectral_range(&operator, &albedo, 1e-5, 500).unwrap();
    let expected = (0.8f32 * 0.9 * 0.5 * 0.4).sqrt();
    assert!((range.end() - expected).abs() < 1e-4 && (range.start() + expected).abs() < 1e-4, "{range:?}");
}

#[test]
fn light_settles_at_the_stated_rates() {
    let range = range();
    assert!(*range.start() < -0.05 && *range.end() > 0.5, "{range:?}");
    let plain = Acceleration::none(range.clone());
    let fast = Acceleration::new(range).unwrap();
    assert!(fast.rate < 0.7 * plain.rate, "{plain:?} {fast:?}");
    for acceleration in [plain, fast] {
        let found = distances(acceleration, 12);
        println!("{acceleration:?}: {found:.5?}");
        // Momentum may add a share for each bounce, (1 + k (1 − rate²)) rate^k.
        for (k, distance) in (1..).zip(&found) {
            let most = (1.0 + k as f32 * (1.0 - acceleration.rate.powi(2))) * acceleration.rate.powi(k);
            assert!(*distance < 1.2 * most, "{acceleration:?}, bounce {k}: {distance} of {most}");
        }
    }
    // Bounces until a thousandth is left for good.
    let needed = |acceleration: Acceleration| distances(acceleration, 60).iter().rposition(|d| *d > 1e-3).unwrap() + 2;
    assert!(needed(fast) * 3 < needed(plain) * 2, "{} and {} bounces", needed(fast), needed(plain));
    // Far too much momentum is noticed.
    let wrong = Acceleration { momentum: 0.8, ..fast };
    assert!(needed(wrong) > needed(plain), "{}", needed(wrong));
}

#[test]
fn chebyshevs_steps_leave_what_they_say() {
    let greatest = *range().end();
    for (radius, share) in [(greatest, 1e-2), (greatest, 1e-4), (0.98, 1e-3)] {
        let steps = Acceleration::until(radius, share).unwrap();
        let found = distances_by(&steps);
        let mut most = 1.0;
        for (distance, acceleration) in found.iter().zip(&steps) {
            most *= acceleration.rate;
            // In the norm of eigenvectors; that of light is others by albedos.
            assert!(*distance < 1.5 * most + 1e-6, "{radius}, {share}: {distance} of {most}");
        }
        assert!(most <= share && most / steps[steps.len() - 1].rate > share);
        let plain = ln(share) / ln(radius);
        assert!((steps.len() as f32) < 0.6 * plain, "{} bounces in the place of {plain}", steps.len());
    }
    // A radius that is much too small leaves more.
    let steps = Acceleration::until(0.3 * greatest, 1e-4).unwrap();
    assert!(*distances_by(&steps).last().unwrap() > 1e-3);
    for (radius, share) in [(0.0, 0.1), (1.0, 0.1), (f32::NAN, 0.1), (0.5, 0.0), (0.5, 1.0)] {
        assert!(Acceleration::until(radius, share).is_err());
    }
}

#[test]
fn light_that_grows_is_refused() {
    for range in [-0.1..=1.0, -0.1..=f32::NAN, f32::NEG_INFINITY..=0.5, 0.5..=0.4] {
        assert!(matches!(
            Acceleration::new(range),
            Err(Error::Shared(transport::Error::Setting { name: "eigenvalues", .. }))
        ));
    }
    let none = Acceleration::new(0.0..=0.0).unwrap();
    assert_eq!((none.step, none.momentum, none.bounces(1e-3)), (1.0, 0.0, 1));
}
