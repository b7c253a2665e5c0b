//! Solvers by chance: no bias, noise that falls as it must, bad input.

use formfactor::{Reciprocal, Solution, Stop, lu, reciprocal};
use glam::Vec4;
use patches::PatchKind;
use patchlight::{Bake, BakeSettings, Estimator, ReceiverKind, Silent};
use scene::sampling::{hash3, unit};
use solvers::{Samples, random_walks, stochastic_jacobi};
use transport::Csr;

/// Reciprocal form factors between the polygons of the Cornell box, and their areas, m².
fn factors() -> (Csr, Vec<f32>) {
    let scene = assets::procedural::build("cornell").unwrap().scene;
    let settings = BakeSettings::default()
        .with_patches(PatchKind::Polygon)
        .with_patch_count(120)
        .with_estimator(Estimator::Hemisphere { rays: 512 })
        .with_receivers(ReceiverKind::Pixels);
    let bake = Bake::build(&scene, &settings, &Silent).unwrap();
    let Reciprocal { factors, area, .. } = reciprocal(&bake.form_factors().factors, &bake.mesh().areas()).unwrap();
    (factors, area)
}

/// Mean over the patches of the square of the error of the irradiance, and of its mean over solutions, relative to the
/// exact one.
fn errors_of(solutions: &[Solution], exact: &Solution) -> (f64, f64) {
    let square = |v: Vec4| f64::from(v.truncate().length_squared());
    let whole: f64 = exact.irradiance.iter().map(|&h| square(h)).sum();
    let of = |found: &[Vec4]| -> f64 {
        found.iter().zip(&exact.irradiance).map(|(a, b)| square(*a - *b)).sum::<f64>() / whole
    };
    let single = solutions.iter().map(|s| of(&s.irradiance)).sum::<f64>() / solutions.len() as f64;
    let n = exact.irradiance.len();
    let mean: Vec<Vec4> =
        (0..n).map(|i| solutions.iter().map(|s| s.irradiance[i]).sum::<Vec4>() / solutions.len() as f32).collect();
    (single, of(&mean))
}

#[test]
fn solvers_by_chance_are_right_on_average() {
    let (rows, area) = factors();
    let n = area.len();
    let albedo: Vec<Vec4> = (0..n as u32).map(|i| Vec4::new(0.9 * unit(hash3(i, 1, 1)), 0.5, 0.8, 0.0)).collect();
    let source: Vec<Vec4> = (0..n).map(|i| Vec4::splat(f32::from(i % 11 == 0))).collect();
    let exact = lu(&rows.to_dense(), &source, &albedo).unwrap();
    type Solve<'a> = &'a dyn Fn(&[Vec4], Samples) -> Solution;
    let walks: Solve = &|albedo, samples| random_walks(&rows, &area, &source, albedo, samples).unwrap();
    let jacobi: Solve =
        &|albedo, samples| stochastic_jacobi(&rows, &area, &source, albedo, samples, Stop::Tolerance(1e-6)).unwrap();
    for (name, solve) in [("walks", walks), ("jacobi", jacobi)] {
        let runs = |albedo: &[Vec4], count: u32| -> Vec<Solution> {
            (0..32).map(|seed| solve(albedo, Samples { count, seed })).collect()
        };
        let (few, mean_of_few) = errors_of(&runs(&albedo, 2000), &exact);
        let (many, mean_of_many) = errors_of(&runs(&albedo, 32_000), &exact);
        println!(
            "{name}: squared error {few:.2e}, of 16 times the samples {many:.2e}; of means {mean_of_few:.2e}, \
             {mean_of_many:.2e}"
        );
        // Noise goes with the number of samples, and with the number of solutions that are averaged: there is no bias.
        assert!((8.0..32.0).contains(&(few / many)), "{name}: {few} {many}");
        assert!(mean_of_few < 2.0 * few / 32.0 && mean_of_many < 2.0 * many / 32.0, "{name}");
        // Another albedo is another solution.
        let darker: Vec<Vec4> = albedo.iter().map(|a| *a * 0.9).collect();
        assert!(errors_of(&runs(&darker, 32_000), &exact).1 > 20.0 * mean_of_many, "{name}");
        assert_eq!(solve(&albedo, Samples { count: 500, seed: 7 }), solve(&albedo, Samples { count: 500, seed: 7 }));
    }
    let none = vec![Vec4::ZERO; n];
    let dark = random_walks(&rows, &area, &none, &albedo, Samples { count: 100, seed: 0 }).unwrap();
    assert!(dark.irradiance.iter().all(|h| *h == Vec4::ZERO));
    let wrong = random_walks(&rows, &area[1..], &source, &albedo, Samples { count: 1, seed: 0 });
    assert!(wrong.unwrap_err().to_string().contains("area"));
}
