//! Operators, tile by tile in their order.

use alloc::vec::Vec;

#[cfg(not(feature = "std"))]
use num_traits::Float as _;

use faer::{Mat, unzip, zip};
use scene::double::{atan2, sin_cos};
use scene::parallel::*;
use transport::check_length;

use super::Channels;
use super::reduce::{SIDE, Weights, dot, squared_norm};
use crate::error::Error;
use crate::host::solve::Factors;
#[cfg(feature = "std")]
use crate::host::stored::StoredOperator;

/// Tiles above the diagonal stand for two.
pub(super) fn twice((i, j): (usize, usize)) -> f64 {
    if i == j { 1.0 } else { 2.0 }
}

/// A symmetric matrix.
pub(super) enum Matrix<'a> {
    Dense(&'a Mat<f32>),
    /// In a file, in the same order.
    #[cfg(feature = "std")]
    Stored(&'a StoredOperator),
    /// Columns by permuted index, rows ascending.
    Sparse(Vec<Vec<(u32, f32)>>),
}

impl Matrix<'_> {
    /// `Ŝ = a^½ F a^-½` by permuted indices.
    fn sparse(factors: &Factors, order: &[u32], permuted_index: &[u32]) -> Result<Self, Error> {
        factors.check_reciprocal()?;
        let sqrt_area: Vec<f32> = factors.area.iter().map(|&a| scene::math::sqrt(a)).collect();
        let row = |&i: &u32| {
            let entry = |(j, f): (usize, f32)| (permuted_index[j], f * sqrt_area[i as usize] / sqrt_area[j]);
            let mut row: Vec<(u32, f32)> = factors.row(i as usize).map(entry).collect();
            row.sort_unstable_by_key(|entry| entry.0);
            row
        };
        Ok(Self::Sparse(order.par_iter().map(row).collect()))
    }

    /// A tile, filled up with zeros.
    fn tile(&self, order: &[u32], (i, j): (usize, usize)) -> Result<Mat<f32>, Error> {
        let mut out = Mat::zeros(SIDE, SIDE);
        match self {
            Self::Dense(matrix) => {
                let at = |p: usize| order.get(p).map(|&k| k as usize);
                let rows: Vec<Option<usize>> = (0..SIDE).map(|r| at(i * SIDE + r)).collect();
                for c in 0..SIDE {
                    let Some(column) = at(j * SIDE + c) else { continue };
                    let column = matrix.col(column);
                    for (r, row) in rows.iter().enumerate() {
                        if let Some(row) = row {
                            out[(r, c)] = column[*row];
                        }
                    }
                }
            }
            #[cfg(feature = "std")]
            Self::Stored(operator) => return operator.tile((i, j)),
            // Columns, as in the dense matrix.
            Self::Sparse(columns) => {
                let first = i * SIDE;
                let end = (i + 1) * SIDE;
                for (c, column) in columns.iter().skip(j * SIDE).take(SIDE).enumerate() {
                    let from = column.partition_point(|entry| (entry.0 as usize) < first);
                    for &(row, value) in column[from..].iter().take_while(|entry| (entry.0 as usize) < end) {
                        out[(row as usize - first, c)] += value;
                    }
                }
            }
        }
        Ok(out)
    }
}

/// The operators in their order.
pub(super) struct Source<'a> {
    common: Matrix<'a>,
    /// Red and blue, when they differ from the common one.
    others: Option<[Matrix<'a>; 2]>,
    order: &'a [u32],
    /// Red and blue of the first chroma axis, then of the second: unit vectors at a right angle.
    pub chroma_axes: [[f32; 2]; 2],
    /// Weights of each block.
    pub weights: Vec<Weights>,
}

impl<'a> Source<'a> {
    pub fn new(channels: Channels<'a>, area: &[f32], order: &'a [u32], permuted_index: &[u32]) -> Result<Self, Error> {
        let (common, others) = match channels {
            Channels::One(matrix) => (dense(matrix, order.len())?, None),
            Channels::Three([red, green, blue]) => {
                let [red, blue] = [dense(red, order.len())?, dense(blue, order.len())?];
                (dense(green, order.len())?, Some([red, blue]))
            }
            #[cfg(feature = "std")]
            Channels::Stored([red, green, blue]) => {
                let [red, blue] = [stored(red, order)?, stored(blue, order)?];
                (stored(green, order)?, Some([red, blue]))
            }
            Channels::Factors(factors) => {
                check_length("rows", order.len(), factors.patches())?;
                (Matrix::sparse(&factors, order, permuted_index)?, None)
            }
        };
        let weights = |block: &[u32]| {
            Weights::new(&block.iter().map(|&i| scene::math::sqrt(area[i as usize])).collect::<Vec<_>>())
        };
        let weights = order.par_chunks(SIDE).map(weights).collect();
        Ok(Self { common, others, order, chroma_axes: [[1.0, 0.0], [0.0, 1.0]], weights })
    }

    /// A tile of green, then its differences along both axes when red and blue are others.
    pub fn planes(&self, at: (usize, usize)) -> Result<Vec<Mat<f32>>, Error> {
        let common = self.common.tile(self.order, at)?;
        let Some([red, blue]) = self.differences(at, &common)? else { return Ok(vec![common]) };
        let [first, second] =
            self.chroma_axes.map(|[a, b]| zip!(&red, &blue).map(|unzip!(red, blue)| a * red + b * blue));
        Ok(vec![common, first, second])
    }

    /// Tiles of red and blue less that of green.
    fn differences(&self, at: (usize, usize), common: &Mat<f32>) -> Result<Option<[Mat<f32>; 2]>, Error> {
        let Some([red, blue]) = &self.others else { return Ok(None) };
        Ok(Some([red.tile(self.order, at)? - common, blue.tile(self.order, at)? - common]))
    }

    /// Rotates the chroma axes so that the first has most of what these tiles' red and blue differ from green.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn rotate_axes(&mut self, tiles: &[(usize, usize)]) -> Result<(), Error> {
        let products = |&at: &(usize, usize)| -> Result<[f64; 3], Error> {
            let Some([red, blue]) = self.differences(at, &self.common.tile(self.order, at)?)? else {
                return Ok([0.0; 3]);
            };
            Ok([(&red, &red), (&red, &blue), (&blue, &blue)].map(|(a, b)| twice(at) * dot(a, b)))
        };
        let own = tiles.par_iter().map(products).collect::<Result<Vec<_>, Error>>()?;
        let [red, both, blue] = own.iter().fold([0.0; 3], |sum, own| core::array::from_fn(|k| sum[k] + own[k]));
        let (sin, cos) = sin_cos(0.5 * atan2(2.0 * both, red - blue));
        self.chroma_axes = [[cos as f32, sin as f32], [-sin as f32, cos as f32]];
        Ok(())
    }

    /// Frobenius norm of each channel over these tiles, both sides of the diagonal.
    ///
    /// # Errors
    /// [`transport::Error::Value`] for numbers that are not finite, [`Error::File`].
    pub fn norms(&self, tiles: &[(usize, usize)]) -> Result<[f64; 3], Error> {
        let of = |matrix: &Matrix| -> Result<f64, Error> {
            let squares: Result<Vec<f64>, Error> =
                tiles.par_iter().map(|&at| Ok(twice(at) * squared_norm(&matrix.tile(self.order, at)?))).collect();
            let norm = squares?.iter().sum::<f64>().sqrt();
            // Files are not looked through before.
            let rule = "finite";
            if norm.is_finite() {
                Ok(norm)
            } else {
                Err(transport::Error::Value { name: "operator", index: 0, value: norm, rule }.into())
            }
        };
        let green = of(&self.common)?;
        match &self.others {
            Some([red, blue]) => Ok([of(red)?, green, of(blue)?]),
            None => Ok([green; 3]),
        }
    }
}

/// A matrix in a file that has this order.
#[cfg(feature = "std")]
fn stored<'a>(operator: &'a StoredOperator, order: &[u32]) -> Result<Matrix<'a>, Error> {
    check_length("rows", order.len(), operator.patches())?;
    match operator.order().iter().zip(order).position(|(a, b)| a != b) {
        Some(index) => {
            let rule = "the order in which the operator was stored";
            Err(transport::Error::Value { name: "order", index, value: f64::from(order[index]), rule }.into())
        }
        None => Ok(Matrix::Stored(operator)),
    }
}

/// A matrix of so many rows and columns, and of finite numbers.
fn dense(matrix: &Mat<f32>, size: usize) -> Result<Matrix<'_>, Error> {
    check_length("rows", size, matrix.nrows())?;
    check_length("columns", size, matrix.ncols())?;
    let wrong = |j: usize| matrix.col(j).iter().any(|x| !x.is_finite());
    match (0..matrix.ncols()).into_par_iter().find_first(|&j| wrong(j)) {
        Some(index) => Err(transport::Error::Value { name: "operator", index, value: f64::NAN, rule: "finite" }.into()),
        None => Ok(Matrix::Dense(matrix)),
    }
}
