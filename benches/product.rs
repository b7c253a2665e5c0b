//! Products as native code: of the operators of all bounces of the built-in atrium and, with the shared scenes, of
//! Sponza, however they are stored, and of dense matrices. Each row says how fast its bytes are read beside the
//! bandwidth with which the same cores read as many; the floor is the time that these would take. Measured alternately,
//! so that a busy machine slows both alike.

#![allow(missing_docs)]

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use assets::import::load_or_build;
use benches::{PRODUCT_SIZES, Stream, exitance, factors, stream_gb_s};
use criterion::{BenchmarkId, Criterion, Throughput};
use experiments::Error;
use glam::Vec4;
use multibounce::BlockCodec;
use patchlight::low_level::operator::build::{all_bounces_operator, form_factor_operator};
use patchlight::low_level::operator::{Build, Codec, Decode, PatchOperator};
use patchlight::method::Preparation;
use patchlight::{Bake, BakeSettings, ReceiverKind};
use runtime::cpu::Cpu;
use shell::progress::Progress;
use transport::LinearOperator;

/// Rounds of the table: product, stream, product, …
const ROUNDS: usize = 15;

/// More than four times the last-level cache of large servers.
const OUT_OF_CACHE: usize = 1100 << 20;

/// Relative error of operators of low rank.
const EPSILON: f64 = 0.01;

/// Patches of the operators.
const PATCHES: usize = 2000;

const SPONZA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/scenes/sponza/sponza.toml");

/// Times a product of n rows that reads so many bytes.
fn measure(criterion: &mut Criterion, group: &str, name: &str, n: usize, bytes: usize, mut product: impl FnMut()) {
    let mut run = || {
        let start = Instant::now();
        product();
        start.elapsed()
    };
    let mut benches = criterion.benchmark_group(group);
    benches.sample_size(10).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    benches.throughput(Throughput::Bytes(bytes as u64));
    benches.bench_function(BenchmarkId::new(name, n), |b| b.iter_custom(|rounds| (0..rounds).map(|_| run()).sum()));
    benches.finish();

    let mut stream = Stream::new(bytes);
    let mut pairs: Vec<(f64, f64)> =
        (0..ROUNDS).map(|_| (bytes as f64 * 1e-9 / run().as_secs_f64(), stream.round())).collect();
    let best = |take: fn(&(f64, f64)) -> f64, pairs: &[(f64, f64)]| pairs.iter().map(take).fold(0.0, f64::max);
    let product = best(|p| p.0, &pairs);
    let read = best(|p| p.1, &pairs);
    pairs.sort_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
    let median = pairs[ROUNDS / 2].0 / pairs[ROUNDS / 2].1;
    let megabytes = bytes as f64 * 1e-6;
    println!(
        "{group}/{name}/{n}: {megabytes:.2} MB in {:.3} ms, floor {:.3} ms: {product:.1} GB/s, stream of as much \
         {read:.1} GB/s, median of the ratio {:.0} %",
        megabytes / product,
        megabytes / read,
        100.0 * median
    );
}

fn measure_dense(criterion: &mut Criterion, name: &str, operator: &impl LinearOperator, bytes: usize) {
    let n = operator.rows();
    let light = exitance(n, n);
    let mut out = vec![Vec4::ZERO; n];
    measure(criterion, "product/native", name, n, bytes, || {
        operator.apply(black_box(&light), &mut out).expect("the shapes agree");
    });
}

/// T of the light between the patches of a scene, and F for feedback.
fn measure_operators(criterion: &mut Criterion, scene: &str) -> Result<(), Error> {
    let loaded = load_or_build(scene)?;
    // No points of the surface: only the light between patches is measured.
    let settings = BakeSettings::default().with_patch_count(PATCHES).with_receivers(ReceiverKind::Pixels);
    let progress = Progress::new(true);
    let bake = Arc::new(Bake::build(&loaded.scene, &settings, &progress)?);
    let build = Build::default();
    let with =
        Preparation { bake: &bake, decode: Decode::Auto, build: &build, eye: loaded.view.eye, observer: &progress };
    let group = format!("product/{}", loaded.name);
    let blocks = BlockCodec::ALL.map(Codec::Blocks);
    let low_rank = Codec::LowRank { epsilon: EPSILON };
    for codec in [Codec::Dense, Codec::Half].into_iter().chain(blocks).chain([low_rank]) {
        let operator = all_bounces_operator(codec, None, &with, &mut Cpu::new())?;
        measure_operator(criterion, &group, &format!("T-{}", codec.name()), &operator);
    }
    measure_operator(criterion, &group, "F-tiles", &form_factor_operator(EPSILON, &with)?);
    Ok(())
}

fn measure_operator(criterion: &mut Criterion, group: &str, name: &str, operator: &PatchOperator) {
    let n = operator.patches();
    let light = exitance(n, n);
    let mut out = vec![Vec4::ZERO; n];
    measure(criterion, group, name, n, operator.bytes() as usize, || {
        operator.apply(black_box(&light), &mut out).expect("the shapes agree");
    });
}

fn main() -> Result<(), Error> {
    let mut criterion = Criterion::default().configure_from_args();
    println!("stream out of cache ({} MB): {:.1} GB/s", OUT_OF_CACHE / 1_000_000, stream_gb_s(OUT_OF_CACHE, 5));
    measure_operators(&mut criterion, "atrium")?;
    if Path::new(SPONZA).is_file() {
        measure_operators(&mut criterion, SPONZA)?;
    } else {
        println!("without ../shared/scenes/sponza its operators are left out");
    }
    for n in PRODUCT_SIZES {
        let dense = factors(n, n, n);
        measure_dense(&mut criterion, "f32", &dense, 4 * n * n);
        let half = dense.to_half();
        drop(dense);
        measure_dense(&mut criterion, "half", &half, 4 * half.words.len());
    }
    criterion.final_summary();
    Ok(())
}
