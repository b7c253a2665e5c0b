//! `y = A x` for RGB vectors, whatever stores A.

use glam::Vec4;

use crate::error::{Error, check_length};

/// A matrix that multiplies RGB vectors. Rows and columns are patches, elements or receivers; of a
/// matrix of form factors, x is exitance and y irradiance, W/m².
pub trait LinearOperator: Sync {
    /// Rows and columns.
    fn shape(&self) -> (usize, usize);

    /// `y[i] = Σ_j a_ij x[j]`, the same bits for any number of threads. The fourth components of
    /// x are not used.
    ///
    /// # Errors
    /// [`Error::Length`] unless `x` has one entry a column and `y` one a row.
    fn apply(&self, x: &[Vec4], y: &mut [Vec4]) -> Result<(), Error>;

    /// Bytes that a product reads beside the vectors.
    fn bytes(&self) -> u64;

    /// Number of rows.
    fn rows(&self) -> usize {
        self.shape().0
    }

    /// Number of columns.
    fn columns(&self) -> usize {
        self.shape().1
    }

    /// Checks the lengths of the vectors of a product.
    ///
    /// # Errors
    /// [`Error::Length`] unless `x` has one entry a column and `y` one a row.
    fn check_vectors(&self, x: &[Vec4], y: &[Vec4]) -> Result<(), Error> {
        let (rows, columns) = self.shape();
        check_length("exitance", columns, x.len())?;
        check_length("irradiance", rows, y.len())
    }
}

/// An operator that also multiplies from the other side.
pub trait TransposedOperator: LinearOperator {
    /// `x[j] = Σ_i a_ij y[i]`.
    ///
    /// # Errors
    /// [`Error::Length`] unless `x` has one entry a column and `y` one a row.
    fn apply_transposed(&self, y: &[Vec4], x: &mut [Vec4]) -> Result<(), Error>;
}

/// A function as an operator: a composition of others, or one that has no table.
#[derive(Clone, Copy, Debug)]
pub struct FnOperator<F> {
    rows: usize,
    columns: usize,
    function: F,
}

impl<F: Fn(&[Vec4], &mut [Vec4]) -> Result<(), Error> + Sync> FnOperator<F> {
    /// The operator of so many rows and columns that `function(x, y)` applies. The lengths of both
    /// are checked before it is called.
    pub fn new(rows: usize, columns: usize, function: F) -> Self {
        Self { rows, columns, function }
    }
}

impl<F: Fn(&[Vec4], &mut [Vec4]) -> Result<(), Error> + Sync> LinearOperator for FnOperator<F> {
    fn shape(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    fn apply(&self, x: &[Vec4], y: &mut [Vec4]) -> Result<(), Error> {
        self.check_vectors(x, y)?;
        (self.function)(x, y)
    }

    /// None of its own.
    fn bytes(&self) -> u64 {
        0
    }
}

impl<T: LinearOperator + ?Sized> LinearOperator for &T {
    fn shape(&self) -> (usize, usize) {
        (**self).shape()
    }

    fn apply(&self, x: &[Vec4], y: &mut [Vec4]) -> Result<(), Error> {
        (**self).apply(x, y)
    }

    fn bytes(&self) -> u64 {
        (**self).bytes()
    }
}
