//! Compression of the matrix of several bounces [T 3].

use glam::Vec3;
use multibounce::{BlockCodec, BlockSettings, Companding, Filling, MatrixRows};
use rayon::prelude::*;
use transport::Permutation;

/// BC1, 5 % of outliers with zeros in their place, values as they are, in the largest tiles.
pub const PRINTED_BLOCKS: BlockSettings = BlockSettings {
    codec: BlockCodec::Bc1,
    companding: Companding::None,
    outliers: 0.05,
    tile: 1024,
    filling: Filling::Zeros,
};

/// Listing 3.1: for each column, in order, the closest of all others changes places with the next column, though it may
/// have had its place already; then the same for rows. Rows and columns change places together. Of equally close ones
/// the first is taken; the last column has no next one.
///
/// 24 n² bytes and O(n³) operations.
pub fn printed_order(n: usize, rows: &MatrixRows) -> Permutation {
    let mut matrix = vec![Vec3::ZERO; n * n];
    matrix.chunks_mut(n.max(1)).enumerate().for_each(|(i, row)| rows(i, row));
    let transposed: Vec<Vec3> = (0..n * n).map(|k| matrix[k % n * n + k / n]).collect();
    let mut order = Permutation::identity(n);
    for lines in [&transposed, &matrix] {
        let line = |k: u32| &lines[k as usize * n..(k as usize + 1) * n];
        for i in 0..n.saturating_sub(1) {
            let own = order.order()[i];
            let distance = |&other: &u32| match other == own {
                true => f32::INFINITY,
                false => line(own).iter().zip(line(other)).map(|(a, b)| a.distance_squared(*b)).sum(),
            };
            let distances: Vec<f32> = order.order().par_iter().with_min_len(64).map(distance).collect();
            let closest = (0..n).min_by(|&a, &b| distances[a].total_cmp(&distances[b])).unwrap_or(i);
            order.swap(closest, i + 1);
        }
    }
    order
}
