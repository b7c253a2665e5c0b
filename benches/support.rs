//! Fixed seeds and sizes shared by all benches, and the bandwidth that products are compared with.

pub use experiments::bandwidth::{Stream, stream_gb_s};
use formfactor::Dense;
use glam::Vec4;
use rayon::prelude::*;
use scene::sampling::{hash3, unit};

/// Changes every random number.
pub const SEED: u32 = 2025;

/// Patches of the dense products: small, medium, and the largest of the thesis' table 1.
pub const PRODUCT_SIZES: [usize; 3] = [2_000, 5_000, 10_422];

/// A matrix of factors about 1/n: `rows` × `columns`, zeros from column `columns_used` on.
pub fn factors(rows: usize, columns: usize, columns_used: usize) -> Dense {
    let mut dense = Dense::zeros(rows, columns);
    dense.values.par_chunks_mut(columns).enumerate().for_each(|(i, row)| {
        // One hash a row: making the matrix must not take longer than measuring it.
        let mut state = hash3(i as u32, 1, SEED);
        for value in &mut row[..columns_used] {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            *value = (0.5 + unit(state)) / columns_used as f32;
        }
    });
    dense
}

/// Exitance of `count` patches, zeros up to `room`.
pub fn exitance(count: usize, room: usize) -> Vec<Vec4> {
    let number = |k: usize, c| unit(hash3(k as u32, c, SEED));
    let color = |k| if k < count { Vec4::new(number(k, 2), number(k, 3), number(k, 4), 0.0) } else { Vec4::ZERO };
    (0..room).map(color).collect()
}
