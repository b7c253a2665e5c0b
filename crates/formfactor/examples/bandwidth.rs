//! Speed of the products H = F B beside a plain parallel read of the same matrix.

use std::time::Instant;

use glam::Vec4;
use rayon::prelude::*;
use transport::{Dense, Error, LinearOperator};

/// Best of a few runs, s.
fn best(mut run: impl FnMut()) -> f64 {
    (0..8)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min)
}

fn main() -> Result<(), Error> {
    for n in [2000usize, 5000, 10_422] {
        let values = (0..n * n).into_par_iter().map(|k| (k % 1021) as f32 / (1021 * n) as f32).collect();
        let dense = Dense::new(n, n, values)?;
        let exitance: Vec<Vec4> = (0..n).map(|k| Vec4::splat(k as f32 / n as f32)).collect();
        let mut irradiance = vec![Vec4::ZERO; n];
        let bytes = (4 * n * n) as f64;
        let mut total = 0u64;
        let words: &[u64] = bytemuck::cast_slice(&dense.values[..n * n / 2 * 2]);
        let read = best(|| {
            total ^= words.par_chunks(1 << 16).map(|c| c.iter().fold(0, |a, x| a ^ x)).reduce(|| 0, |a, b| a ^ b)
        });
        let product = best(|| dense.apply(&exitance, &mut irradiance).unwrap_or_default());
        let half = dense.to_half();
        let packed = best(|| half.apply(&exitance, &mut irradiance).unwrap_or_default());
        println!(
            "N {n}: read {:.1} GB/s, f32 {:.1} GB/s ({:.0} %, {:.2} ms), f16 {:.1} GB/s ({:.2} ms) [{total:x}]",
            bytes / read * 1e-9,
            bytes / product * 1e-9,
            100.0 * read / product,
            product * 1e3,
            bytes / 2.0 / packed * 1e-9,
            packed * 1e3
        );
    }
    Ok(())
}
