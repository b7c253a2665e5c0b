//! Reciprocity of sparse rows whose areas are only estimates.

use alloc::vec::Vec;

#[cfg(not(feature = "std"))]
use num_traits::Float as _;

use scene::parallel::*;

use crate::error::Error;
use transport::{Csr, check_length};

/// Steps towards the areas, and towards closed rows.
const STEPS: usize = 60;
/// Areas change by no more than this factor.
const AREA_RANGE: f64 = 20.0;
/// Factors of a row change by no more than this factor beyond the mean.
const SCALE_RANGE: f64 = 5.0;
/// A row whose factors add up to less is not closed: too few of its rays met a patch.
const MIN_SUM: f64 = 1e-3;

/// Result of [`reciprocal`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reciprocal {
    /// F with `a_i F_ij = a_j F_ji`; its rows add up as before.
    pub factors: Csr,
    /// Areas a by which it is reciprocal, m².
    pub area: Vec<f32>,
    /// Greatest change of a row's sum, among those that are closed.
    pub closure: f64,
}

/// Makes sparse rows reciprocal that come from rays, for patches whose areas are estimates.
///
/// 1. Areas as the rays see them: if F were exact, `Σ_i a_i F_ij = a_j Σ_i F_ji`. From the given areas on,
///    `a_j ← √(a_j Σ_i a_i F_ij / Σ_i F_ji)`.
/// 2. `S_ij = (F_ij + F_ji) / (1/a_i + 1/a_j)`: the mean of `a_i F_ij` and `a_j F_ji` by their precisions, for rows of
///    equally many rays.
/// 3. `S_ij ← x_i x_j S_ij`, so that the rows add up as before, by damped steps as in [`super::balance`].
///
/// Half of the noise of F goes with it: the two estimates of each pair are independent.
///
/// # Errors
/// [`transport::Error::Length`] for tables of other sizes, [`transport::Error::Value`] for areas that are not positive
/// or factors that are negative.
pub fn reciprocal(factors: &Csr, area: &[f32]) -> Result<Reciprocal, Error> {
    factors.check()?;
    let n = factors.rows;
    check_length("columns", n, factors.columns)?;
    check_length("area", n, area.len())?;
    if let Some(index) = area.iter().position(|&a| !(a > 0.0 && a.is_finite())) {
        return Err(
            transport::Error::Value { name: "area", index, value: f64::from(area[index]), rule: "positive" }.into()
        );
    }
    if let Some(index) = factors.values.iter().position(|&f| !(f >= 0.0 && f.is_finite())) {
        let value = f64::from(factors.values[index]);
        return Err(transport::Error::Value { name: "factors", index, value, rule: "finite and not negative" }.into());
    }
    let transposed = transpose(factors);
    let sums: Vec<f64> = (0..n).into_par_iter().map(|i| row(factors, i).map(|(_, f)| f64::from(f)).sum()).collect();
    let a = seen_areas(&transposed, area, &sums);
    let mut out = merged(factors, &transposed, &a)?;
    drop(transposed);
    let closure = close(&mut out, &a, &sums);
    Ok(Reciprocal { factors: out, area: a.iter().map(|&a| a as f32).collect(), closure })
}

/// Step 1 of [`reciprocal`]: areas as the rays see them, from those that are given and the sums of the rows.
fn seen_areas(transposed: &Csr, area: &[f32], sums: &[f64]) -> Vec<f64> {
    let given: Vec<f64> = area.iter().map(|&a| f64::from(a)).collect();
    let mut a = given.clone();
    for _ in 0..STEPS {
        let next = |j: usize| {
            let seen: f64 = row(transposed, j).map(|(i, f)| a[i] * f64::from(f)).sum();
            let step = (a[j] * seen / sums[j].max(MIN_SUM)).sqrt();
            step.clamp(given[j] / AREA_RANGE, given[j] * AREA_RANGE)
        };
        a = (0..a.len()).into_par_iter().map(next).collect();
    }
    a
}

/// Step 2 of [`reciprocal`]: the symmetric S for areas a, m².
fn merged(factors: &Csr, transposed: &Csr, a: &[f64]) -> Result<Csr, Error> {
    let both = |i: usize| {
        let weight = |j: usize| (1.0 / (1.0 / a[i] + 1.0 / a[j])) as f32;
        let mut out: Vec<(u32, f32)> = Vec::new();
        let mut there = row(factors, i).peekable();
        let mut back = row(transposed, i).peekable();
        loop {
            let (j, f) = match (there.peek().copied(), back.peek().copied()) {
                (Some(t), Some(b)) if t.0 == b.0 => {
                    there.next();
                    back.next();
                    (t.0, t.1 + b.1)
                }
                (Some(t), b) if b.is_none_or(|b| t.0 < b.0) => {
                    there.next();
                    t
                }
                (_, Some(b)) => {
                    back.next();
                    b
                }
                _ => break,
            };
            out.push((j as u32, f * weight(j)));
        }
        out
    };
    let rows: Vec<Vec<(u32, f32)>> = (0..a.len()).into_par_iter().map(both).collect();
    Ok(Csr::from_rows(a.len(), &rows)?)
}

/// Step 3 of [`reciprocal`]: scales the symmetric S so that rows add up to `sums`, makes it form factors again, and
/// says how far the sums are off.
fn close(out: &mut Csr, a: &[f64], sums: &[f64]) -> f64 {
    let n = a.len();
    let mut x = vec![1.0f64; n];
    let mut closure = 0.0;
    for step in 0..=STEPS {
        let ratio = |i: usize| {
            let sum: f64 = row(out, i).map(|(j, s)| f64::from(s) * x[j]).sum::<f64>() * x[i];
            if sums[i] > MIN_SUM && sum > 0.0 { sum / (a[i] * sums[i]) } else { 1.0 }
        };
        let ratios: Vec<f64> = (0..n).into_par_iter().map(ratio).collect();
        if step == STEPS {
            closure = (0..n).map(|i| (ratios[i] - 1.0).abs() * sums[i]).fold(0.0, f64::max);
            break;
        }
        x.iter_mut().zip(&ratios).for_each(|(x, r)| *x = (*x / r.sqrt()).clamp(1.0 / SCALE_RANGE, SCALE_RANGE));
    }
    for i in 0..n {
        let range = out.row_start[i] as usize..out.row_start[i + 1] as usize;
        for k in range {
            let j = out.column_index[k] as usize;
            out.values[k] = (f64::from(out.values[k]) * x[i] * x[j] / a[i]) as f32;
        }
    }
    closure
}

/// Columns and values of a row.
fn row(rows: &Csr, i: usize) -> impl Iterator<Item = (usize, f32)> {
    let range = rows.row_start[i] as usize..rows.row_start[i + 1] as usize;
    rows.column_index[range.clone()].iter().map(|&j| j as usize).zip(rows.values[range].iter().copied())
}

fn transpose(rows: &Csr) -> Csr {
    let mut start = vec![0u32; rows.columns + 1];
    for &j in &rows.column_index {
        start[j as usize + 1] += 1;
    }
    for j in 0..rows.columns {
        start[j + 1] += start[j];
    }
    let mut next = start.clone();
    let mut column_index = vec![0u32; rows.values.len()];
    let mut values = vec![0.0f32; rows.values.len()];
    for i in 0..rows.rows {
        for (j, f) in row(rows, i) {
            let k = next[j] as usize;
            next[j] += 1;
            (column_index[k], values[k]) = (i as u32, f);
        }
    }
    Csr { rows: rows.columns, columns: rows.rows, row_start: start, column_index, values }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::sampling::{hash3, unit};

    /// A reciprocal F of areas a, and an estimate of it by so many rays a row.
    fn noisy(n: usize, rays: u32) -> (Vec<f32>, Csr, Csr) {
        let random = |i: usize, j: usize, d: u32| unit(hash3(i as u32, j as u32, d));
        let area: Vec<f32> = (0..n).map(|i| 0.2 + random(i, 0, 1)).collect();
        let s = |i: usize, j: usize| if i == j { 0.0 } else { random(i.min(j), i.max(j), 2) / n as f32 * 0.3 };
        let exact: Vec<Vec<(u32, f32)>> =
            (0..n).map(|i| (0..n).filter(|&j| j != i).map(|j| (j as u32, s(i, j) / area[i])).collect()).collect();
        let estimate = |i: usize| {
            let mut hits = vec![0.0; n];
            for ray in 0..rays {
                let mut at = random(i, ray as usize, 3);
                for &(j, f) in &exact[i] {
                    if at < f {
                        hits[j as usize] += 1.0 / rays as f32;
                        break;
                    }
                    at -= f;
                }
            }
            hits.into_iter().enumerate().filter(|h| h.1 > 0.0).map(|(j, f)| (j as u32, f)).collect::<Vec<_>>()
        };
        let estimates: Vec<Vec<(u32, f32)>> = (0..n).map(estimate).collect();
        (area, Csr::from_rows(n, &exact).unwrap(), Csr::from_rows(n, &estimates).unwrap())
    }

    #[test]
    fn areas_are_found_rows_stay_closed_and_noise_falls() {
        let (area, exact, estimate) = noisy(60, 40_000);
        // The areas that are given are wrong by up to a third.
        let given: Vec<f32> = area.iter().enumerate().map(|(i, a)| a * if i % 2 == 0 { 1.3 } else { 0.8 }).collect();
        let found = reciprocal(&estimate, &given).unwrap();
        let scale = area.iter().sum::<f32>() / found.area.iter().sum::<f32>();
        for (i, (found, area)) in found.area.iter().zip(&area).enumerate() {
            assert!((found * scale / area - 1.0).abs() < 0.05, "area {i}: {} for {area}", found * scale);
        }
        assert!(found.closure < 1e-3, "{}", found.closure);
        let f = found.factors.to_dense();
        let e = estimate.to_dense();
        let x = exact.to_dense();
        for i in 0..60 {
            let sum = |d: &super::super::Dense| d.row(i).iter().sum::<f32>();
            assert!((sum(&f) - sum(&e)).abs() < 1e-3);
            for j in 0..60 {
                let there = found.area[i] * f.row(i)[j];
                let back = found.area[j] * f.row(j)[i];
                assert!((there - back).abs() <= 1e-5 * there.max(back));
            }
        }
        let error = |d: &super::super::Dense| {
            d.values.iter().zip(&x.values).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
        };
        assert!(error(&f) < 0.85 * error(&e), "{} {}", error(&f), error(&e));
    }

    #[test]
    fn rows_without_hits_stay_dark_and_wrong_tables_are_refused() {
        let rows = Csr::from_rows(3, &[vec![(1, 0.5)], vec![(0, 0.25)], vec![]]).unwrap();
        let found = reciprocal(&rows, &[1.0, 2.0, 1.0]).unwrap();
        assert_eq!(found.factors.row_start[2], found.factors.row_start[3]);
        assert!((found.factors.to_dense().values[1] - 0.5).abs() < 1e-3);
        assert!(reciprocal(&rows, &[1.0, 2.0]).is_err());
        assert!(reciprocal(&rows, &[1.0, 0.0, 1.0]).is_err());
        let wrong = Csr { values: vec![0.5, f32::NAN], ..rows };
        assert!(reciprocal(&wrong, &[1.0, 2.0, 1.0]).is_err());
    }
}
