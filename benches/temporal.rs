//! Sampled rows beside dense products, natively and, where there is a device, on Vulkan: the sizes of the thesis's
//! table 1 and beyond, lists against alias tables, and how long tables take to build. Rows have the shape of those of
//! Sponza: 670 entries of most different size about the row's own number.
//!
//! `PATCHLIGHT_DEVICE` (a name or a number) chooses the device.

#![allow(missing_docs)]

use std::hint::black_box;
use std::time::{Duration, Instant};

use benches::{SEED, exitance, factors, stream_gb_s};
use criterion::{BenchmarkId, Criterion};
use glam::Vec4;
use gpu_kernels::table::{TEMPORAL_SAMPLE_LISTS, TEMPORAL_SAMPLE_TABLES, TEMPORAL_SUM_LISTS};
use rayon::prelude::*;
use runtime::executor::{DeviceChoice, Executor, ExecutorError, open};
use runtime::plan::{BufferId, Plan, Range};
use scene::sampling::{hash3, unit};
use temporal::{AliasTables, Distribution, Packing, RayLists, SampleParams, Settings, SumParams};
use transport::{Csr, LinearOperator};

/// The sizes of the thesis's table 1.
const SIZES: [usize; 4] = [1736, 5485, 8786, 10_422];
/// Beyond: no dense matrix.
const LARGE: [usize; 2] = [30_000, 60_000];
const SAMPLES: [u32; 3] = [16, 64, 200];
/// Entries of a row, and of the list that stands for it.
const ENTRIES: u32 = 670;
const LIST: usize = 1024;
/// Rounds of which the best counts.
const ROUNDS: usize = 15;

fn rows(n: usize) -> Csr {
    let rows: Vec<Vec<(u32, f32)>> = (0..n as u32).into_par_iter().map(|i| row(i, n)).collect();
    Csr::from_rows(n, &rows).expect("columns are below n")
}

/// Row `i` of n: half of its entries in the neighbourhood, half anywhere.
fn row(i: u32, n: usize) -> Vec<(u32, f32)> {
    let near = |k| {
        let far = if k % 2 == 0 { 0.02 } else { 1.0 };
        let offset = far * (unit(hash3(i, k, SEED)) - 0.5) * n as f32;
        ((i as f32 + offset).rem_euclid(n as f32) as u32).min(n as u32 - 1)
    };
    let mut columns: Vec<u32> = (0..ENTRIES).map(near).collect();
    columns.sort_unstable();
    columns.dedup();
    let value = |&j: &u32| 1e-4 + unit(hash3(i, j, SEED + 1)).powi(6);
    let sum: f32 = columns.iter().map(value).sum();
    columns.iter().map(|j| (*j, 0.95 * value(j) / sum)).collect()
}

fn best_ms(mut work: impl FnMut()) -> f64 {
    (0..ROUNDS).fold(f64::INFINITY, |best, _| {
        let start = Instant::now();
        work();
        best.min(1e3 * start.elapsed().as_secs_f64())
    })
}

/// Times a frame of these rows; the best, ms.
fn measure(criterion: &mut Criterion, name: &str, n: usize, mut frame: impl FnMut()) -> f64 {
    let mut group = criterion.benchmark_group("temporal/native");
    group.sample_size(10).warm_up_time(Duration::from_millis(200)).measurement_time(Duration::from_millis(600));
    group.bench_function(BenchmarkId::new(name, n), |b| b.iter(&mut frame));
    group.finish();
    best_ms(frame)
}

/// A kernel's buffers with what stands in them.
fn loaded(
    executor: &mut dyn Executor,
    kernel: &'static gpu_kernels::table::Kernel,
    buffers: &[(&str, &[u8])],
    push: &[u8],
) -> Result<Vec<BufferId>, ExecutorError> {
    let mut plan = Plan::new();
    let ids: Vec<BufferId> = buffers.iter().map(|(name, bytes)| plan.storage(*name, bytes.len() as u64)).collect();
    let ranges: Vec<Range> = ids.iter().map(|&id| Range::from(id)).collect();
    plan.pass_with_bytes(kernel.name, kernel, &ranges, push)?;
    executor.load(plan)?;
    for (id, (_, bytes)) in ids.iter().zip(buffers) {
        if !bytes.is_empty() {
            executor.upload_at(*id, 0, bytes)?;
        }
    }
    Ok(ids)
}

/// The best of some runs by the device's own clock, ms.
fn device_ms(executor: &mut dyn Executor) -> Result<f64, ExecutorError> {
    let mut best = f64::INFINITY;
    for _ in 0..ROUNDS {
        best = best.min(executor.run()?.iter().map(|pass| pass.milliseconds).sum());
    }
    Ok(best)
}

fn measure_device(
    executor: &mut dyn Executor,
    n: usize,
    lists: &RayLists,
    tables: &AliasTables,
) -> Result<(), ExecutorError> {
    use bytemuck::{bytes_of, cast_slice};
    let light = exitance(n, n);
    let out = vec![Vec4::ZERO; n];
    let device = executor.device().name.clone();
    for samples in SAMPLES {
        let settings = Settings { samples, ..Settings::default() };
        let p: SampleParams = settings.params(n as u32, lists.options(), 1);
        let of_lists: [(&str, &[u8]); 6] = [
            ("row_start", cast_slice(lists.row_start())),
            ("columns", cast_slice(lists.words())),
            ("row_sums", cast_slice(lists.sums())),
            ("exitance", cast_slice(&light)),
            ("change", cast_slice(&light)),
            ("irradiance", cast_slice(&out)),
        ];
        loaded(executor, &TEMPORAL_SAMPLE_LISTS, &of_lists, bytes_of(&p))?;
        let by_lists = device_ms(executor)?;
        let of_tables: [(&str, &[u8]); 8] = [
            of_lists[0],
            ("slots", cast_slice(tables.slots())),
            ("columns", cast_slice(tables.words())),
            ("colors", cast_slice(tables.colors())),
            ("row_sums", cast_slice(tables.sums())),
            of_lists[3],
            of_lists[4],
            of_lists[5],
        ];
        let of_tables =
            [("row_start", cast_slice(tables.row_start()))].into_iter().chain(of_tables.into_iter().skip(1));
        loaded(executor, &TEMPORAL_SAMPLE_TABLES, &of_tables.collect::<Vec<_>>(), bytes_of(&p))?;
        println!("{device}, N {n}, Q {samples}: lists {by_lists:.3} ms, tables {:.3} ms", device_ms(executor)?);
    }
    let params: SumParams = Settings::default().rows_to_sum(n as u32, lists.options(), 0);
    let sum: [(&str, &[u8]); 5] = [
        ("row_start", cast_slice(lists.row_start())),
        ("columns", cast_slice(lists.words())),
        ("row_sums", cast_slice(lists.sums())),
        ("exitance", cast_slice(&light)),
        ("irradiance", cast_slice(&out)),
    ];
    loaded(executor, &TEMPORAL_SUM_LISTS, &sum, bytes_of(&params))?;
    println!("{device}, N {n}: exact sums of {} rows {:.3} ms", params.count, device_ms(executor)?);
    Ok(())
}

fn main() -> Result<(), ExecutorError> {
    let mut criterion = Criterion::default().configure_from_args();
    println!("native code reads {:.1} GB/s out of cache", stream_gb_s(1100 << 20, 5));
    let choice = std::env::var("PATCHLIGHT_DEVICE").unwrap_or_else(|_| "vulkan".into());
    let mut device = match open(&DeviceChoice::parse(&choice)) {
        Ok((device, _)) => Some(device),
        Err(error) => {
            println!("without Vulkan: {error}");
            None
        }
    };
    for n in SIZES.into_iter().chain(LARGE) {
        let rows = rows(n);
        measure_exact(&mut criterion, n, &rows);
        let (lists, tables) = build(n, &rows);
        measure_samples(&mut criterion, "lists", n, &lists);
        measure_samples(&mut criterion, "tables", n, &tables);
        if let Some(device) = device.as_deref_mut().filter(|_| n < LARGE[0]) {
            measure_device(device, n, &lists, &tables)?;
        }
    }
    criterion.final_summary();
    Ok(())
}

/// Products with dense and with sparse rows.
fn measure_exact(criterion: &mut Criterion, n: usize, rows: &Csr) {
    let light = exitance(n, n);
    let mut out = vec![Vec4::ZERO; n];
    if n < LARGE[0] {
        let dense = factors(n, n, n);
        let bytes = 4.0 * (n * n) as f64;
        let ms = measure(criterion, "dense", n, || {
            dense.apply(black_box(&light), &mut out).expect("the shapes agree");
        });
        println!("N {n}: dense {ms:.3} ms, {:.1} GB/s", bytes * 1e-6 / ms);
    }
    let entries = rows.values.len();
    let ms = measure(criterion, "sparse", n, || {
        rows.apply(black_box(&light), &mut out).expect("the shapes agree");
    });
    println!("N {n}: sparse rows of {entries} entries {ms:.3} ms, {:.1} MB", 8e-6 * entries as f64);
}

/// Lists, and tables by stacks, with the times that they take, and those of tables by splitting.
fn build(n: usize, rows: &Csr) -> (RayLists, AliasTables) {
    let Csr { row_start, column_index, values, .. } = rows;
    let start = Instant::now();
    let lists = RayLists::from_rows(n, row_start, column_index, values, LIST).expect("rows are valid");
    let lists_ms = 1e3 * start.elapsed().as_secs_f64();
    let (tables, stacks_ms) = alias_tables(n, rows, Packing::Stacks);
    let (split, split_ms) = alias_tables(n, rows, Packing::Split);
    println!(
        "N {n}: built lists {lists_ms:.1} ms, {:.1} MB; tables by stacks {stacks_ms:.1} ms, by splitting \
         {split_ms:.1} ms, {:.1} MB, {:.2} bytes an entry",
        1e-6 * lists.bytes() as f64,
        1e-6 * split.bytes() as f64,
        split.bytes() as f64 / values.len() as f64
    );
    (lists, tables)
}

/// Tables, and milliseconds of making them.
fn alias_tables(n: usize, rows: &Csr, packing: Packing) -> (AliasTables, f64) {
    let start = Instant::now();
    let tables = AliasTables::from_rows(n, &rows.row_start, &rows.column_index, &rows.values, packing);
    (tables.expect("rows are valid"), 1e3 * start.elapsed().as_secs_f64())
}

/// Sampled frames, and the exact sums of the rows that a frame sums.
fn measure_samples(criterion: &mut Criterion, name: &str, n: usize, distribution: &dyn Distribution) {
    let light = exitance(n, n);
    let mut out = vec![Vec4::ZERO; n];
    for samples in SAMPLES {
        for (how, settings) in [
            ("", Settings { samples, ..Settings::default() }),
            ("-independent", Settings { samples, rotated: false, ..Settings::default() }),
        ] {
            let mut frame = 0;
            let ms = measure(criterion, &format!("{name}-{samples}{how}"), n, || {
                frame += 1;
                let p = settings.params(n as u32, 0, frame);
                distribution.sample(&p, black_box(&light), &light, &mut out).expect("the shapes agree");
            });
            let each = 1e6 * ms / (n as f64 * f64::from(samples));
            println!("N {n}, Q {samples}: {name}{how} {ms:.3} ms, {each:.2} ns a sample");
        }
    }
    let settings = Settings::default();
    let mut frame = 0;
    let ms = measure(criterion, &format!("{name}-sums"), n, || {
        frame += 1;
        let params = settings.rows_to_sum(n as u32, 0, frame);
        distribution.sum(&params, black_box(&light), &mut out).expect("the shapes agree");
    });
    println!("N {n}: {name}, exact sums of a {}th of the rows {ms:.3} ms", settings.refresh);
}
