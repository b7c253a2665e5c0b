//! The dense product as native code: GB/s of the matrix beside the bandwidth with which the same cores read as many bytes.
//! The table is measured in turns, so that a busy machine slows both alike.

#![allow(missing_docs)]

use std::hint::black_box;
use std::time::{Duration, Instant};

use benches::{PRODUCT_SIZES, Stream, exitance, factors, stream_gb_s};
use criterion::{BenchmarkId, Criterion, Throughput};
use formfactor::Operator;
use glam::Vec4;

/// Turns of the table: product, stream, product, …
const TURNS: usize = 15;

/// More than four times the last-level cache of large servers.
const OUT_OF_CACHE: usize = 1100 << 20;

fn measure(criterion: &mut Criterion, name: &str, operator: &impl Operator, bytes: usize) {
    let n = operator.rows();
    let light = exitance(n, n);
    let mut out = vec![Vec4::ZERO; n];
    let mut run = || {
        let start = Instant::now();
        operator.product(black_box(&light), &mut out).expect("the shapes agree");
        start.elapsed()
    };
    let mut group = criterion.benchmark_group("product/native");
    group.sample_size(10).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    group.throughput(Throughput::Bytes(bytes as u64));
    group.bench_function(BenchmarkId::new(name, n), |b| b.iter_custom(|turns| (0..turns).map(|_| run()).sum()));
    group.finish();

    let mut stream = Stream::new(bytes);
    let mut pairs: Vec<(f64, f64)> =
        (0..TURNS).map(|_| (bytes as f64 * 1e-9 / run().as_secs_f64(), stream.turn())).collect();
    let best = |take: fn(&(f64, f64)) -> f64, pairs: &[(f64, f64)]| pairs.iter().map(take).fold(0.0, f64::max);
    let (product, read) = (best(|p| p.0, &pairs), best(|p| p.1, &pairs));
    pairs.sort_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
    let median = pairs[TURNS / 2].0 / pairs[TURNS / 2].1;
    println!(
        "product/native/{name}/{n}: {product:.1} GB/s, stream of {:.0} MB {read:.1} GB/s, median of the ratio {:.0} %",
        bytes as f64 * 1e-6,
        100.0 * median
    );
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    println!("stream out of cache ({} MB): {:.1} GB/s", OUT_OF_CACHE / 1_000_000, stream_gb_s(OUT_OF_CACHE, 5));
    for n in PRODUCT_SIZES {
        let dense = factors(n, n, n);
        measure(&mut criterion, "f32", &dense, 4 * n * n);
        let half = dense.to_half();
        drop(dense);
        measure(&mut criterion, "half", &half, 4 * half.words.len());
    }
    criterion.final_summary();
}
