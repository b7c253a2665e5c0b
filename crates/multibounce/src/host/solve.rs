//! Dense operators of many bounces.

use alloc::vec::Vec;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::solvers::Solve;
use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::{Accum, ColMut, Mat};
use scene::parallel::*;
use transport::{Proceed, check_length};

use crate::error::Error;

/// Form factors between patches as sparse rows, borrowed: row i has the entries `row_start[i]..row_start[i + 1]`.
#[derive(Clone, Copy, Debug)]
pub struct Factors<'a> {
    /// `[patches + 1]`.
    pub row_start: &'a [u32],
    /// Column of each entry, ascending in a row.
    pub columns: &'a [u32],
    /// `F_ij` of each entry.
    pub values: &'a [f32],
    /// Areas a, m², by which F is reciprocal: `a_i F_ij = a_j F_ji`.
    pub area: &'a [f32],
}

/// Largest `|a_i F_ij − a_j F_ji| / √(a_i a_j)` that passes as reciprocal.
const RECIPROCITY: f32 = 1e-4;

impl Factors<'_> {
    /// Number of patches.
    pub fn patches(&self) -> usize {
        self.area.len()
    }

    /// Columns and values of row `i`.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (usize, f32)> {
        let range = self.row_start[i] as usize..self.row_start[i + 1] as usize;
        self.columns[range.clone()].iter().map(|&j| j as usize).zip(self.values[range].iter().copied())
    }

    /// Checks that the tables belong together.
    ///
    /// # Errors
    /// [`transport::Error::Length`], [`transport::Error::Value`].
    pub fn check(&self) -> Result<(), Error> {
        let n = self.area.len();
        check_length("row_start", n + 1, self.row_start.len())?;
        check_length("columns", self.values.len(), self.columns.len())?;
        check_length("values", self.row_start[n] as usize, self.values.len())?;
        let value = |name, index, value: f32, rule| {
            transport::Error::Value { name, index, value: f64::from(value), rule }.into()
        };
        if let Some(k) = (0..n).find(|&k| self.row_start[k] > self.row_start[k + 1]) {
            return Err(value("row_start", k, self.row_start[k] as f32, "ascending"));
        }
        if let Some(k) = self.columns.iter().position(|&j| j as usize >= n) {
            return Err(value("columns", k, self.columns[k] as f32, "a patch"));
        }
        let range = |i: usize| self.row_start[i] as usize..self.row_start[i + 1] as usize;
        if let Some(i) = (0..n).find(|&i| !self.columns[range(i)].is_sorted()) {
            return Err(value("columns", i, i as f32, "ascending in every row"));
        }
        if let Some(k) = self.values.iter().position(|f| !(f.is_finite() && *f >= 0.0)) {
            return Err(value("values", k, self.values[k], "finite and not negative"));
        }
        if let Some(k) = self.area.iter().position(|a| !(a.is_finite() && *a > 0.0)) {
            return Err(value("area", k, self.area[k], "positive"));
        }
        Ok(())
    }

    /// Checks that the tables belong together and `a_i F_ij = a_j F_ji`.
    ///
    /// # Errors
    /// What [`Factors::check`] finds; [`transport::Error::Value`] where F is not reciprocal.
    pub fn check_reciprocal(&self) -> Result<(), Error> {
        self.check()?;
        let sqrt_area: Vec<f32> = self.area.iter().map(|&a| scene::math::sqrt(a)).collect();
        // Columns ascend in a row; one may stand in it more than once.
        let of = |i: usize, j: usize| -> f32 {
            let range = self.row_start[i] as usize..self.row_start[i + 1] as usize;
            let columns = &self.columns[range.clone()];
            let first = columns.partition_point(|&k| (k as usize) < j);
            let same = columns[first..].iter().take_while(|&&k| k as usize == j).count();
            self.values[range][first..first + same].iter().sum::<f32>() * sqrt_area[i] / sqrt_area[j]
        };
        let unlike = |i: usize| self.row(i).any(|(j, _)| (of(i, j) - of(j, i)).abs() > RECIPROCITY);
        match (0..self.patches()).into_par_iter().find_first(|&i| unlike(i)) {
            Some(index) => {
                let rule = "reciprocal: a_i F_ij = a_j F_ji (balance the form factors first)";
                Err(transport::Error::Value { name: "factors", index, value: f64::from(self.area[index]), rule }.into())
            }
            None => Ok(()),
        }
    }

    /// `Ŝ = a^½ F a^-½`, symmetric, all of it.
    ///
    /// # Errors
    /// As [`Factors::check_reciprocal`].
    pub fn symmetric(&self) -> Result<Mat<f32>, Error> {
        self.check_reciprocal()?;
        let n = self.patches();
        let sqrt_area: Vec<f32> = self.area.iter().map(|&a| scene::math::sqrt(a)).collect();
        let mut dense: Mat<f32> = Mat::zeros(n, n);
        for i in 0..n {
            // A column of the matrix, which lies together in memory.
            for (j, f) in self.row(i) {
                dense[(j, i)] += f * sqrt_area[i] / sqrt_area[j];
            }
        }
        Ok(dense)
    }
}

pub(super) fn check_albedo(albedo: &[f32], patches: usize) -> Result<(), Error> {
    check_length("albedo", patches, albedo.len())?;
    match albedo.iter().position(|a| !(0.0..1.0).contains(a)) {
        Some(index) => Err(transport::Error::Value {
            name: "albedo",
            index,
            value: f64::from(albedo[index]),
            rule: "at least 0 and below 1",
        }
        .into()),
        None => Ok(()),
    }
}

/// Reflectance below which a patch is first taken to reflect so much, because [`all_bounces`] divides by it.
pub(super) const MIN_ALBEDO: f32 = 0.1;

/// Least entry that is taken from the identity: far below what single precision can tell, but no product of a few such
/// numbers is denormal. Processors multiply denormal numbers many times slower, and light that fades from room to room
/// has plenty.
pub(super) const FLOOR: f32 = 1e-13;

/// All bounces of one colour channel, from the symmetric form factors, `T = a^-½ T̂ a^½`: with `P = diag(ρ^½)`,
/// `T̂ = P⁻¹ ((I − P Ŝ P)⁻¹ − I) P⁻¹`. The inverse is found by Cholesky's factorisation, about n³ operations; it takes
/// the place of Ŝ, and n² numbers of memory more at the peak. Where ρ is almost 0, the operator T̂' of a small
/// reflectance ρ' is made first, and then `T̂ = T̂' − T̂' Δ T̂` with `Δ = diag(ρ' − ρ)`, which is a linear system of so
/// many patches only.
///
/// # Errors
/// [`transport::Error::Length`], [`transport::Error::Value`] for an albedo outside of 0 to 1, [`Error::Singular`] when
/// light grows without end.
pub fn all_bounces(symmetric: Mat<f32>, albedo: &[f32]) -> Result<Mat<f32>, Error> {
    let mut out = bounce_system(symmetric, albedo)?;
    invert(&mut out)?;
    bounces_of_inverse(out, albedo)
}

/// `I − P Ŝ P`, whose inverse [`bounces_of_inverse`] takes, in the place of Ŝ; see [`all_bounces`].
///
/// # Errors
/// [`transport::Error::Length`], [`transport::Error::Value`] for an albedo outside of 0 to 1.
pub fn bounce_system(symmetric: Mat<f32>, albedo: &[f32]) -> Result<Mat<f32>, Error> {
    let mut out = symmetric;
    check_length("columns", out.nrows(), out.ncols())?;
    check_albedo(albedo, out.nrows())?;
    let sqrt_albedo = sqrt_albedo(albedo);
    let columns: Vec<ColMut<f32>> = out.col_iter_mut().collect();
    columns.into_par_iter().enumerate().for_each(|(j, column)| {
        for (i, value) in column.iter_mut().enumerate() {
            *value = identity(i, j) - (sqrt_albedo[i] * *value * sqrt_albedo[j]).max(FLOOR);
        }
    });
    Ok(out)
}

/// All bounces from the inverse of [`bounce_system`], in its place; see [`all_bounces`].
///
/// # Errors
/// [`transport::Error::Length`], [`transport::Error::Value`] for an albedo outside of 0 to 1.
pub fn bounces_of_inverse(inverse: Mat<f32>, albedo: &[f32]) -> Result<Mat<f32>, Error> {
    let mut out = inverse;
    let n = out.nrows();
    check_length("columns", n, out.ncols())?;
    check_albedo(albedo, n)?;
    let sqrt_albedo = sqrt_albedo(albedo);
    let columns: Vec<ColMut<f32>> = out.col_iter_mut().collect();
    columns.into_par_iter().enumerate().for_each(|(j, column)| {
        for (i, value) in column.iter_mut().enumerate() {
            *value = (*value - identity(i, j)) / (sqrt_albedo[i] * sqrt_albedo[j]);
        }
    });
    let dark: Vec<usize> = (0..n).filter(|&i| albedo[i] < MIN_ALBEDO).collect();
    if dark.is_empty() {
        return Ok(out);
    }
    let less = |k: usize| MIN_ALBEDO - albedo[dark[k]];
    let columns = Mat::from_fn(n, dark.len(), |i, k| out[(i, dark[k])]);
    let small = Mat::from_fn(dark.len(), dark.len(), |i, k| identity(i, k) + columns[(dark[i], k)] * less(k));
    let rows = small.partial_piv_lu().solve(columns.transpose());
    let scaled = Mat::from_fn(n, dark.len(), |i, k| columns[(i, k)] * less(k));
    let parallel = faer::get_global_parallelism();
    faer::linalg::matmul::matmul(out.as_mut(), Accum::Add, scaled.as_ref(), rows.as_ref(), -1.0f32, parallel);
    mirror(&mut out);
    Ok(out)
}

/// √ρ of each patch, of [`MIN_ALBEDO`] where it is less.
fn sqrt_albedo(albedo: &[f32]) -> Vec<f32> {
    albedo.iter().map(|&a| scene::math::sqrt(a.max(MIN_ALBEDO))).collect()
}

fn identity(i: usize, j: usize) -> f32 {
    if i == j { 1.0 } else { 0.0 }
}

/// The inverse of a positive definite matrix in its place, by Cholesky's factorisation `L Lᵀ`: `L⁻ᵀ L⁻¹`.
///
/// # Errors
/// [`Error::Singular`] with the row at which it is none.
pub fn invert(matrix: &mut Mat<f32>) -> Result<(), Error> {
    let n = matrix.nrows();
    let parallel = faer::get_global_parallelism();
    let mut memory = MemBuffer::new(cholesky_in_place_scratch::<f32>(n, parallel, Default::default()));
    let stack = MemStack::new(&mut memory);
    cholesky_in_place(matrix.as_mut(), Default::default(), parallel, stack, Default::default())
        .map_err(|LltError::NonPositivePivot { index }| Error::Singular { patch: index })?;
    let mut inverse: Mat<f32> = Mat::zeros(n, n);
    invert_lower_triangular(inverse.as_mut(), matrix.as_ref(), parallel);
    let lower = BlockStructure::TriangularLower;
    let upper = BlockStructure::TriangularUpper;
    matmul(matrix.as_mut(), lower, Accum::Replace, inverse.transpose(), upper, inverse.as_ref(), lower, 1.0, parallel);
    mirror(matrix);
    Ok(())
}

/// Makes what is above the diagonal the same as below it.
fn mirror(matrix: &mut Mat<f32>) {
    for j in 0..matrix.ncols() {
        for i in 0..j {
            matrix[(i, j)] = matrix[(j, i)];
        }
    }
}

/// All bounces of one colour channel for form factors that need not be reciprocal, `T = F (I − diag(ρ) F)⁻¹`, by LU
/// with partial pivoting: 8/3 n³ operations, 3 n² numbers of memory.
///
/// # Errors
/// As [`all_bounces`].
pub fn all_bounces_lu(factors: &Mat<f32>, albedo: &[f32]) -> Result<Mat<f32>, Error> {
    let n = factors.nrows();
    check_length("columns", n, factors.ncols())?;
    check_albedo(albedo, n)?;
    // Transposed, for a solve from the left: T (I − R) = F.
    let system = Mat::from_fn(n, n, |i, j| {
        let r = albedo[j] * factors[(j, i)];
        if i == j { 1.0 - r } else { -r }
    });
    let solved = system.partial_piv_lu().solve(factors.transpose());
    let out = solved.transpose().to_owned();
    match (0..n).find(|&i| (0..n).any(|j| !out[(i, j)].is_finite())) {
        Some(patch) => Err(Error::Singular { patch }),
        None => Ok(out),
    }
}

/// So many bounces of one colour channel, `T_K = F Σ_{k<K} (diag(ρ) F)^k`, by Horner's rule: `T_1 = F`,
/// `T_{k+1} = F + F diag(ρ) T_k`, K − 1 products of 2 n³ operations, 3 n² numbers of memory beside F. `progress(done,
/// total)` is called after each; breaking it cancels.
///
/// # Errors
/// [`transport::Error::Length`], [`transport::Error::Value`], [`transport::Error::Setting`] for no bounces,
/// [`transport::Error::Cancelled`].
pub fn some_bounces(
    factors: &Mat<f32>,
    albedo: &[f32],
    bounces: u32,
    progress: &dyn Fn(usize, usize) -> Proceed,
) -> Result<Mat<f32>, Error> {
    let n = factors.nrows();
    check_length("columns", n, factors.ncols())?;
    check_albedo(albedo, n)?;
    if bounces == 0 {
        return Err(transport::Error::Setting { name: "bounces", value: 0.0, rule: "at least 1" }.into());
    }
    let mut sum = factors.clone();
    let total = bounces as usize - 1;
    for done in 1..=total {
        let lit = Mat::from_fn(n, n, |i, j| albedo[i] * sum[(i, j)]);
        sum = factors.clone();
        let parallel = faer::get_global_parallelism();
        faer::linalg::matmul::matmul(sum.as_mut(), Accum::Add, factors.as_ref(), lit.as_ref(), 1.0f32, parallel);
        if progress(done, total).is_break() {
            return Err(transport::Error::Cancelled { done, total }.into());
        }
    }
    Ok(sum)
}
