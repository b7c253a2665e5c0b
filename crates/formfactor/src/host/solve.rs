//! Classic radiosity: solvers of `B = E + ρ∘(F B)` for three colour channels.

use alloc::vec::Vec;
use faer::Mat;
use faer::linalg::solvers::Solve;
use glam::Vec4;

use crate::error::Error;
use transport::kernel::product::bounce;
use transport::{Dense, LinearOperator, check_length};

/// When an iteration ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stop {
    /// After this many bounces (sweeps, for [`gauss_seidel`]).
    Bounces(u32),
    /// When the residual, relative to the greatest exitance, is below this; at most 10,000 steps.
    Tolerance(f32),
}

const MAX_STEPS: u32 = 10_000;

/// A light distribution. The fourth components are 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solution {
    /// Indirect irradiance H, W/m².
    pub irradiance: Vec<Vec4>,
    /// Exitance B = E + ρ∘H, W/m².
    pub exitance: Vec<Vec4>,
    /// Greatest component of `E + ρ∘(F B) − B`, relative to the greatest component of B.
    pub residual: f32,
    /// Products, sweeps or shots.
    pub iterations: u32,
}

/// Checks that form factors, rows × columns, exitances and albedos are those of one system.
///
/// # Errors
/// [`transport::Error::Length`]; [`transport::Error::Value`] for a source or albedo that is negative or not finite.
pub fn check_inputs(rows: usize, columns: usize, source: &[Vec4], albedo: &[Vec4]) -> Result<(), Error> {
    check_length("columns", rows, columns)?;
    check_length("source", rows, source.len())?;
    check_length("albedo", rows, albedo.len())?;
    for (name, table) in [("source", source), ("albedo", albedo)] {
        for (index, x) in table.iter().enumerate() {
            let x = x.truncate();
            if !(x.is_finite() && x.min_element() >= 0.0) {
                let value = f64::from(if x.is_finite() { x.min_element() } else { f32::NAN });
                return Err(transport::Error::Value { name, index, value, rule: "finite and not negative" }.into());
            }
        }
    }
    Ok(())
}

fn largest(table: &[Vec4]) -> f32 {
    table.iter().map(|x| x.truncate().abs().max_element()).fold(0.0, f32::max)
}

fn largest_difference(a: &[Vec4], b: &[Vec4]) -> f32 {
    let difference = a.iter().zip(b).map(|(a, b)| (*a - *b).truncate().abs().max_element()).fold(0.0, f32::max);
    let scale = largest(b);
    if scale > 0.0 { difference / scale } else { difference }
}

fn plain(table: &[Vec4]) -> Vec<Vec4> {
    table.iter().map(|x| x.truncate().extend(0.0)).collect()
}

fn bounce_all(source: &[Vec4], albedo: &[Vec4], irradiance: &[Vec4]) -> Vec<Vec4> {
    source.iter().zip(albedo).zip(irradiance).map(|((&e, &a), &h)| bounce(e, a, h).truncate().extend(0.0)).collect()
}

impl Solution {
    /// Exitance and residual of an irradiance H, W/m², that `iterations` steps found: one more product.
    ///
    /// # Errors
    /// [`transport::Error::Length`].
    pub fn of(
        operator: &(impl LinearOperator + ?Sized),
        source: &[Vec4],
        albedo: &[Vec4],
        irradiance: Vec<Vec4>,
        iterations: u32,
    ) -> Result<Self, Error> {
        let exitance = bounce_all(source, albedo, &irradiance);
        let mut next = vec![Vec4::ZERO; source.len()];
        operator.apply(&exitance, &mut next)?;
        let residual = largest_difference(&bounce_all(source, albedo, &next), &exitance);
        Ok(Self { irradiance, exitance, residual, iterations })
    }
}

/// Gathering (Jacobi): `H ← F (E + ρ∘H)`. K bounces give `H = F Σ_{k<K} (ρF)^k E`.
///
/// Shapes: `operator` n × n, `source` (E, W/m²) and `albedo` (ρ) `[n]`.
///
/// # Errors
/// [`transport::Error::Length`]; [`transport::Error::Value`] for a source or albedo that is negative or not finite.
pub fn jacobi(
    operator: &(impl LinearOperator + ?Sized),
    source: &[Vec4],
    albedo: &[Vec4],
    stop: Stop,
) -> Result<Solution, Error> {
    check_inputs(operator.rows(), operator.columns(), source, albedo)?;
    let mut irradiance = vec![Vec4::ZERO; source.len()];
    let mut exitance = plain(source);
    let most = if let Stop::Bounces(k) = stop { k } else { MAX_STEPS };
    let mut iterations = 0;
    while iterations < most {
        operator.apply(&exitance, &mut irradiance)?;
        let next = bounce_all(source, albedo, &irradiance);
        let change = largest_difference(&exitance, &next);
        exitance = next;
        iterations += 1;
        if matches!(stop, Stop::Tolerance(t) if change <= t) {
            break;
        }
    }
    Solution::of(operator, source, albedo, irradiance, iterations)
}

/// Gathering in place (Gauss–Seidel): each row uses the exitance of this sweep's earlier rows. One sweep is more than
/// one bounce.
///
/// # Errors
/// As [`jacobi`].
pub fn gauss_seidel(factors: &Dense, source: &[Vec4], albedo: &[Vec4], stop: Stop) -> Result<Solution, Error> {
    check_inputs(factors.rows, factors.columns, source, albedo)?;
    let mut irradiance = vec![Vec4::ZERO; source.len()];
    let mut exitance = plain(source);
    let most = if let Stop::Bounces(k) = stop { k } else { MAX_STEPS };
    let mut iterations = 0;
    while iterations < most {
        let mut change = 0.0f32;
        for i in 0..factors.rows {
            let mut sum = Vec4::ZERO;
            for (&f, &b) in factors.row(i).iter().zip(&exitance) {
                sum += b * f;
            }
            irradiance[i] = sum;
            let next = bounce(source[i], albedo[i], sum).truncate().extend(0.0);
            change = change.max((next - exitance[i]).abs().max_element());
            exitance[i] = next;
        }
        iterations += 1;
        if matches!(stop, Stop::Tolerance(t) if change <= t * largest(&exitance)) {
            break;
        }
    }
    Solution::of(factors, source, albedo, irradiance, iterations)
}

/// Progressive shooting (Southwell relaxation; Cohen et al. 1988): the patch with the most unshot power sends it,
/// `ΔH_j = F_ji ΔB_i = F_ij ΔB_i A_i / A_j`, so that one row of F serves one shot. F must be reciprocal
/// ([`super::balance`]). Ends when the unshot power of every patch is below the tolerance times the emitted power, or
/// after as many shots as `Stop::Bounces` says.
///
/// # Errors
/// As [`jacobi`], and [`transport::Error::Value`] for an area that is not positive.
pub fn shoot(factors: &Dense, area: &[f32], source: &[Vec4], albedo: &[Vec4], stop: Stop) -> Result<Solution, Error> {
    check_inputs(factors.rows, factors.columns, source, albedo)?;
    check_length("area", factors.rows, area.len())?;
    if let Some(index) = area.iter().position(|&a| !(a > 0.0 && a.is_finite())) {
        return Err(
            transport::Error::Value { name: "area", index, value: f64::from(area[index]), rule: "positive" }.into()
        );
    }
    let n = source.len();
    let mut irradiance = vec![Vec4::ZERO; n];
    let mut unshot = plain(source);
    let power = |b: Vec4, a: f32| b.truncate().element_sum() * a;
    let total: f32 = unshot.iter().zip(area).map(|(&b, &a)| power(b, a)).sum();
    let (most, tolerance) = match stop {
        Stop::Bounces(k) => (k, 0.0),
        Stop::Tolerance(t) => (MAX_STEPS.saturating_mul(n.max(1) as u32), t),
    };
    let mut iterations = 0;
    while iterations < most {
        let mut best = (0, 0.0);
        for i in 0..n {
            let p = power(unshot[i], area[i]);
            if p > best.1 {
                best = (i, p);
            }
        }
        let (i, p) = best;
        if p <= tolerance * total {
            break;
        }
        let shot = core::mem::replace(&mut unshot[i], Vec4::ZERO) * area[i];
        for (j, &f) in factors.row(i).iter().enumerate() {
            let received = shot * (f / area[j]);
            irradiance[j] += received;
            unshot[j] += albedo[j] * received;
        }
        iterations += 1;
    }
    Solution::of(factors, source, albedo, irradiance, iterations)
}

/// Direct solution of `(I − diag(ρ_c) F) B_c = E_c` for the three channels c by LU with partial pivoting in double
/// precision; O(n³).
///
/// # Errors
/// As [`jacobi`], and [`Error::Singular`].
pub fn lu(factors: &Dense, source: &[Vec4], albedo: &[Vec4]) -> Result<Solution, Error> {
    check_inputs(factors.rows, factors.columns, source, albedo)?;
    let n = source.len();
    let mut exitance = vec![Vec4::ZERO; n];
    for channel in 0..3 {
        let system = Mat::from_fn(n, n, |i, j| {
            let r = f64::from(albedo[i][channel]) * f64::from(factors.values[i * n + j]);
            if i == j { 1.0 - r } else { -r }
        });
        let right = Mat::from_fn(n, 1, |i, _| f64::from(source[i][channel]));
        let solution = system.partial_piv_lu().solve(&right);
        for (patch, b) in exitance.iter_mut().enumerate() {
            b[channel] = solution[(patch, 0)] as f32;
            if !b[channel].is_finite() {
                return Err(Error::Singular { channel, patch });
            }
        }
    }
    let mut irradiance = vec![Vec4::ZERO; n];
    factors.apply(&exitance, &mut irradiance)?;
    Solution::of(factors, source, albedo, irradiance, 1)
}
