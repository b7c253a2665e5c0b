//! Reciprocity and closure of a square matrix of form factors.

use alloc::vec::Vec;
use scene::parallel::*;

#[cfg(not(feature = "std"))]
use num_traits::Float as _;

use crate::error::Error;
use transport::{Dense, check_length};

/// Sums found by [`balance`] and the remaining errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Balance {
    /// [`reciprocity_residual`] before.
    pub reciprocity_before: f64,
    /// [`closure_residual`] before.
    pub closure_before: f64,
    /// [`reciprocity_residual`] after.
    pub reciprocity: f64,
    /// [`closure_residual`] after.
    pub closure: f64,
    /// Scaling steps.
    pub iterations: u32,
    /// Rows that see neither patch nor sky: nothing can be scaled, they are left as they are and not counted as
    /// residual.
    pub blind_rows: usize,
}

const STEPS: u32 = 2000;
/// Most that a row is scaled by: rows of few rays need thousands (the atrium with 512 rays), those that cannot be
/// closed would need infinity.
const MAX_SCALE: f64 = 1e4;
const TOLERANCE: f64 = 2e-6;
const TILE: usize = 64;

/// Greatest `|A_i F_ij − A_j F_ji| / √(A_i A_j)`.
pub fn reciprocity_residual(factors: &Dense, area: &[f32]) -> f64 {
    let n = factors.rows;
    (0..n)
        .into_par_iter()
        .map(|i| {
            let mut worst = 0.0f64;
            for j in 0..i {
                let a = f64::from(area[i]);
                let b = f64::from(area[j]);
                let there = a * f64::from(factors.values[i * n + j]);
                let back = b * f64::from(factors.values[j * n + i]);
                worst = worst.max((there - back).abs() / (a * b).sqrt());
            }
            worst
        })
        .par_fold_reduce(|| 0.0, f64::max, f64::max)
}

/// Greatest `|Σ_j F_ij + F_i0 − 1|` over the rows that see anything.
pub fn closure_residual(factors: &Dense, sky: &[f32]) -> f64 {
    (0..factors.rows)
        .into_par_iter()
        .map(|i| {
            let sum: f64 = factors.row(i).iter().map(|&f| f64::from(f)).sum::<f64>() + f64::from(sky[i]);
            if sum == 0.0 { 0.0 } else { (sum - 1.0).abs() }
        })
        .par_fold_reduce(|| 0.0, f64::max, f64::max)
}

/// Spreads what is missing in each row over its patches, `F_ij ← F_ij (1 − F_i0) / Σ_j F_ij`: lost rays did hit
/// geometry. Rows of any rectangular matrix; rows that see no patch stay as they are.
///
/// # Errors
/// [`transport::Error::Length`] unless there is one sky factor a row.
pub fn normalise_rows(factors: &mut Dense, sky: &[f32]) -> Result<(), Error> {
    check_length("sky_factor", factors.rows, sky.len())?;
    if factors.columns == 0 {
        return Ok(());
    }
    factors.values.par_chunks_mut(factors.columns).zip(sky).for_each(|(row, &sky)| {
        let sum: f64 = row.iter().map(|&f| f64::from(f)).sum();
        if sum > 0.0 {
            let scale = (1.0 - f64::from(sky)).max(0.0) / sum;
            for f in row {
                *f = (f64::from(*f) * scale) as f32;
            }
        }
    });
    Ok(())
}

/// Makes F reciprocal, then closes its rows without losing reciprocity.
///
/// 1. `S_ij = A_i F_ij` becomes the mean of S_ij and S_ji, each weighted by its precision. Estimates from equally many
///    rays have a variance of `A_i S_ij`, so the weight of row i is `1 / A_i` times `samples[i]` (equal when `None`):
///    slivers do not ruin their neighbours, nor the reverse.
/// 2. `S_ij ← x_i x_j S_ij`, `F_i0 ← x_i F_i0` with `x_i (Σ_j S_ij x_j + A_i F_i0) = A_i`, by damped fixed-point steps:
///    a symmetric Sinkhorn scaling in which the sky is a column that takes whatever comes. No x is above 10⁴: a patch
///    that sees only smaller ones than itself, as beneath what stands on it, cannot be closed, and stays open.
///
/// Shapes: `factors[n · n]`, `sky_factor[n]`, `area[n]`.
///
/// # Errors
/// [`transport::Error::Length`] for a table of another size, [`transport::Error::Value`] for a factor that is negative
/// or not finite or an area that is not positive.
pub fn balance(
    factors: &mut Dense,
    sky_factor: &mut [f32],
    area: &[f32],
    samples: Option<&[f32]>,
) -> Result<Balance, Error> {
    let n = factors.rows;
    check_length("columns", n, factors.columns)?;
    check_length("sky_factor", n, sky_factor.len())?;
    check_length("area", n, area.len())?;
    check_length("samples", n, samples.map_or(n, <[f32]>::len))?;
    check_values("area", area, |a| a > 0.0 && a.is_finite(), "positive")?;
    check_values("samples", samples.unwrap_or(&[]), |r| r > 0.0 && r.is_finite(), "positive")?;
    check_values("sky_factor", sky_factor, |f| (0.0..=1.0).contains(&f), "in 0..=1")?;
    check_values("factors", &factors.values, |f| f >= 0.0 && f.is_finite(), "finite and not negative")?;

    let mut report = Balance {
        reciprocity_before: reciprocity_residual(factors, area),
        closure_before: closure_residual(factors, sky_factor),
        ..Balance::default()
    };
    let weight: Vec<f64> = (0..n).map(|i| samples.map_or(1.0, |s| f64::from(s[i])) / f64::from(area[i])).collect();
    symmetrise(factors, area, &weight);

    // From here on the matrix holds S.
    let sky_area: Vec<f64> = (0..n).map(|i| f64::from(sky_factor[i]) * f64::from(area[i])).collect();
    let x = find_scales(factors, &sky_area, area, &mut report.iterations);
    if n > 0 {
        factors.values.par_chunks_mut(n).enumerate().for_each(|(i, row)| {
            let scale = x[i] / f64::from(area[i]);
            for (f, x) in row.iter_mut().zip(&x) {
                *f = (f64::from(*f) * scale * x) as f32;
            }
        });
    }
    for i in 0..n {
        sky_factor[i] = (f64::from(sky_factor[i]) * x[i]) as f32;
    }
    report.blind_rows = (0..n).filter(|&i| sky_factor[i] == 0.0 && factors.row(i).iter().all(|&f| f == 0.0)).count();
    report.reciprocity = reciprocity_residual(factors, area);
    report.closure = closure_residual(factors, sky_factor);
    Ok(report)
}

/// Scales x of the rows and columns of S that close every row, or as good as closed.
fn find_scales(factors: &Dense, sky_area: &[f64], area: &[f32], iterations: &mut u32) -> Vec<f64> {
    let n = factors.rows;
    let mut x = vec![1.0f64; n];
    loop {
        let sums: Vec<f64> = (0..n)
            .into_par_iter()
            .map(|i| factors.row(i).iter().zip(&x).map(|(&s, x)| f64::from(s) * x).sum::<f64>() + sky_area[i])
            .collect();
        let mut worst = 0.0f64;
        for i in 0..n {
            let ratio = x[i] * sums[i] / f64::from(area[i]);
            let is_open = x[i] >= MAX_SCALE && ratio < 1.0;
            if sums[i] > 0.0 && !is_open {
                worst = worst.max((ratio - 1.0).abs());
            }
        }
        if worst <= TOLERANCE || *iterations == STEPS {
            return x;
        }
        for i in 0..n {
            if sums[i] > 0.0 {
                x[i] = (x[i] * (f64::from(area[i]) / (x[i] * sums[i])).sqrt()).min(MAX_SCALE);
            }
        }
        *iterations += 1;
    }
}

/// `S_ij = S_ji =` weighted mean of `A_i F_ij` and `A_j F_ji`, in place, tile by tile (both tiles stay in the cache).
fn symmetrise(factors: &mut Dense, area: &[f32], weight: &[f64]) {
    let n = factors.rows;
    for tile_i in (0..n).step_by(TILE) {
        for tile_j in (0..=tile_i).step_by(TILE) {
            for i in tile_i..(tile_i + TILE).min(n) {
                for j in tile_j..(tile_j + TILE).min(i + 1) {
                    let there = f64::from(area[i]) * f64::from(factors.values[i * n + j]);
                    let back = f64::from(area[j]) * f64::from(factors.values[j * n + i]);
                    let mean = ((there * weight[i] + back * weight[j]) / (weight[i] + weight[j])) as f32;
                    factors.values[i * n + j] = mean;
                    factors.values[j * n + i] = mean;
                }
            }
        }
    }
}

fn check_values(
    name: &'static str,
    values: &[f32],
    good: impl Fn(f32) -> bool,
    rule: &'static str,
) -> Result<(), Error> {
    match values.iter().position(|&x| !good(x)) {
        Some(index) => Err(transport::Error::Value { name, index, value: f64::from(values[index]), rule }.into()),
        None => Ok(()),
    }
}
