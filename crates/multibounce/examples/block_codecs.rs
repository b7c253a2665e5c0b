//! A matrix in texture blocks: bytes and errors of each codec, before and after reordering.
//!
//! `cargo run --release -p multibounce --example block_codecs`

use std::ops::ControlFlow;

use glam::Vec3;
use patchlight_multibounce::{BlockCodec, BlockMatrix, BlockSettings, Companding, Error, projected_order};
use scene::sampling::{hash3, unit};
use transport::Permutation;

const N: usize = 1000;

fn main() -> Result<(), Error> {
    // Points of a cube, numbered at random; the light between them falls with distance.
    let places: Vec<Vec3> =
        (0..N as u32).map(|k| Vec3::from_array([0, 1, 2].map(|axis| unit(hash3(k, axis, 1))))).collect();
    let rows = |i: usize, row: &mut [Vec3]| {
        for (entry, place) in row.iter_mut().zip(&places) {
            let distance = place.distance_squared(places[i]);
            *entry = Vec3::new(1.0, 0.7, 0.5 + 0.5 * place.x) * (1e-4 / (0.01 + distance * distance));
        }
    };
    let orders = [("given", Permutation::identity(N)), ("reordered", projected_order(N, &rows, 1))];
    println!("{:10} {:5} {:>9} {:>10} {:>10}", "order", "codec", "bytes/n²", "error", "MSE");
    for codec in BlockCodec::ALL {
        for (name, order) in &orders {
            let settings =
                BlockSettings { codec, companding: Companding::Sqrt, outliers: 0.05, tile: 64, ..<_>::default() };
            let matrix = BlockMatrix::encode(N, &rows, order.clone(), settings, &|_, _| ControlFlow::Continue(()))?;
            let report = matrix.report();
            let bytes = matrix.bytes_by_part().total() as f64 / (N * N) as f64;
            println!("{name:10} {codec:<5?} {bytes:9.3} {:9.4}% {:10.2e}", 100.0 * report.frobenius, report.mse);
        }
    }
    Ok(())
}
