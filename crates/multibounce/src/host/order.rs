//! Orders of rows and columns in which neighbours are alike, so that blocks of the matrix are smooth.

use alloc::vec;
use alloc::vec::Vec;
use glam::Vec3;
use scene::parallel::*;
use scene::sampling::hash3;
use transport::Permutation;

/// The rows of a square RGB matrix: fills the slice, as long as the matrix has columns, with the row of this number.
pub type MatrixRows<'a> = dyn Fn(usize, &mut [Vec3]) + Sync + 'a;

/// Vectors of one length, one after the other.
struct Features {
    dimensions: usize,
    values: Vec<f32>,
}

impl Features {
    fn of(&self, k: usize) -> &[f32] {
        &self.values[k * self.dimensions..(k + 1) * self.dimensions]
    }

    /// Squared distance; eight sums side by side, so that the compiler takes vectors.
    fn distance(&self, a: usize, b: usize) -> f32 {
        let a = self.of(a);
        let b = self.of(b);
        let mut sums = [0.0f32; 8];
        let mut pairs = a.chunks_exact(8).zip(b.chunks_exact(8));
        for (x, y) in &mut pairs {
            for ((sum, x), y) in sums.iter_mut().zip(x).zip(y) {
                *sum += (x - y) * (x - y);
            }
        }
        let rest = a.len() / 8 * 8;
        let rest: f32 = a[rest..].iter().zip(&b[rest..]).map(|(x, y)| (x - y) * (x - y)).sum();
        sums.iter().sum::<f32>() + rest
    }
}

/// Candidates one task compares; fixed, so that the result does not depend on the number of threads.
const TASK: usize = 2048;

/// Starts with number 0 and goes on to the nearest of the rest each time (thesis, listing 3.1): `swap(i + 1, nearest)`.
/// Of equally near ones the first in the present order is taken.
fn nearest_neighbour_chain(features: &Features, n: usize) -> Permutation {
    let mut chain = Permutation::identity(n);
    for i in 0..n.saturating_sub(2) {
        let last = chain.order()[i] as usize;
        let rest = &chain.order()[i + 1..];
        let nearest_of = |(task, part): (usize, &[u32])| {
            let mut best = (f32::INFINITY, 0);
            for (k, &candidate) in part.iter().enumerate() {
                let distance = features.distance(last, candidate as usize);
                if distance < best.0 {
                    best = (distance, task * TASK + k);
                }
            }
            best
        };
        let nearer = |a: (f32, usize), b: (f32, usize)| if (b.0, b.1) < (a.0, a.1) { b } else { a };
        let best = if rest.len() <= TASK {
            nearest_of((0, rest))
        } else {
            rest.par_chunks(TASK).enumerate().map(nearest_of).par_fold_reduce(
                || (f32::INFINITY, usize::MAX),
                nearer,
                nearer,
            )
        };
        // Distances that are no numbers leave the order as it is.
        if best.1 < rest.len() {
            chain.swap(i + 1, i + 1 + best.1);
        }
    }
    chain
}

/// The greedy order of the thesis, listing 3.1: starts with column 0, and each next column is the one of the rest at
/// the least distance `Σ_i |m_ij − m_ik|²` from the last. Rows change places with columns.
///
/// The reference for small matrices: 12 n² bytes and O(n³) operations.
pub fn greedy_order(n: usize, rows: &MatrixRows) -> Permutation {
    nearest_neighbour_chain(&columns(n, rows), n)
}

/// Columns of a matrix as vectors.
fn columns(n: usize, rows: &MatrixRows) -> Features {
    let mut values = vec![0.0f32; 3 * n * n];
    let mut row = vec![Vec3::ZERO; n];
    for i in 0..n {
        rows(i, &mut row);
        for (j, color) in row.iter().enumerate() {
            let at = j * n + i;
            values[3 * at..3 * at + 3].copy_from_slice(&color.to_array());
        }
    }
    Features { dimensions: 3 * n, values }
}

/// Dimensions that columns are projected to.
pub const PROJECTED_DIMENSIONS: usize = 64;

/// Rows that are projected together.
const ROWS: usize = 256;

/// Columns one task projects.
const COLUMNS: usize = 64;

/// As [`greedy_order`], but with distances between columns of `log2(1 + (r + g + b) / ε)` that have been projected to
/// [`PROJECTED_DIMENSIONS`] dimensions by random signs, which keep distances to about 1/√64 (Achlioptas 2003,
/// "Database-friendly random projections"). ε is a 64th of the mean grey of every 16th row.
///
/// Logarithms, because the few great entries, which the codec keeps as outliers, would decide the distances: at 2,000
/// clusters of Sponza the squared error of BC1 is 0.65 of that after [`greedy_order`], and the same as after the same
/// chain on whole columns of logarithms or after optimal leaf ordering of a cluster tree. Any ε from 10⁻⁴ to 1 of the
/// mean does.
///
/// O(64 n²) operations, 1.3 kB a row; the same for any number of threads. The matrix is read once, a 16th of it twice.
pub fn projected_order(n: usize, rows: &MatrixRows, seed: u32) -> Permutation {
    const D: usize = PROJECTED_DIMENSIONS;
    let mut values = vec![0.0f32; D * n];
    let mut block = vec![0.0f32; ROWS.min(n) * n];
    let scale = 64.0 / mean_grey(n, rows).max(f32::MIN_POSITIVE);
    for first in (0..n).step_by(ROWS) {
        let block = &mut block[..ROWS.min(n - first) * n];
        block.par_chunks_mut(n).enumerate().for_each_init(
            || vec![Vec3::ZERO; n],
            |colors, (k, grey)| {
                rows(first + k, colors);
                for (grey, color) in grey.iter_mut().zip(colors) {
                    *grey = libm::log2f(1.0 + scale * color.element_sum());
                }
            },
        );
        let signs: Vec<[f32; D]> = (0..block.len() / n).map(|k| signs((first + k) as u32, seed)).collect();
        let block = &*block;
        values.par_chunks_mut(COLUMNS * D).enumerate().for_each(|(task, values)| {
            for (row, signs) in block.chunks(n).zip(&signs) {
                for (feature, grey) in values.chunks_mut(D).zip(&row[task * COLUMNS..]) {
                    for (sum, sign) in feature.iter_mut().zip(signs) {
                        *sum += sign * grey;
                    }
                }
            }
        });
    }
    nearest_neighbour_chain(&Features { dimensions: D, values }, n)
}

/// Mean of r + g + b over every 16th row.
fn mean_grey(n: usize, rows: &MatrixRows) -> f32 {
    let chosen: Vec<usize> = (0..n).step_by(16).collect();
    let sums: Vec<f64> = chosen
        .par_iter()
        .map_init(
            || vec![Vec3::ZERO; n],
            |row, &i| {
                rows(i, row);
                row.iter().map(|color| f64::from(color.element_sum())).sum()
            },
        )
        .collect();
    (sums.iter().sum::<f64>() / (chosen.len() * n).max(1) as f64) as f32
}

/// Random signs of a row.
fn signs(row: u32, seed: u32) -> [f32; PROJECTED_DIMENSIONS] {
    let words = [hash3(row, 0, seed), hash3(row, 1, seed)];
    core::array::from_fn(|d| if words[d / 32] >> (d % 32) & 1 == 1 { 1.0 } else { -1.0 })
}
