//! The matrix round a camera: what a patch costs that enters, alone and among others, what refreshing a column costs,
//! and the product over shares of lit and of visible slots. Bytes a second stand beside: an entering patch reads the
//! matrix and reads and writes it once more. Then a step along a world of more patches than slots, with and without
//! changes.

#![allow(missing_docs)]

use std::hint::black_box;

use benches::{SEED, exitance, stream_gb_s};
use criterion::{BatchSize, BenchmarkId, Criterion, Throughput};
use glam::{Vec3, Vec4};
use localmatrix::{Entering, Error, Local, LocalMatrix, LocalSettings, Surface, Table, View};
use scene::sampling::{hash3, unit};

/// Bytes of a read that no cache holds.
const OUT_OF_CACHE: usize = 1100 << 20;
const SLOTS: [usize; 2] = [512, 2048];
/// Patches that enter together.
const BATCH: [usize; 3] = [1, 4, 16];
/// Shares of the slots that are lit, and that are visible.
const SHARES: [f64; 4] = [1.0, 0.5, 0.25, 0.1];

/// Patches and form factors.
type Row = Vec<(u32, f32)>;

/// Form factors of patches along a line, most with the nearest.
fn row(patch: u32, patches: u32) -> Row {
    let factor = |j: u32| {
        let far = patch.abs_diff(j) as f32;
        (j, 0.3 * (0.5 + unit(hash3(patch.min(j), patch.max(j), SEED))) / (1.0 + far * far))
    };
    (0..patches).filter(|&j| j != patch).map(factor).collect()
}

/// A matrix with so many free slots, and the rows of patches that may enter.
fn filled(slots: usize, free: usize) -> Result<(LocalMatrix, Vec<Row>), Error> {
    let rows: Vec<Row> = (0..slots as u32).map(|i| row(i, slots as u32)).collect();
    let mut matrix = LocalMatrix::new(slots)?;
    let there: Vec<Entering> = (0..(slots - free) as u32).map(|patch| entering(patch, &rows)).collect();
    there.chunks(128).try_for_each(|some| matrix.add(some))?;
    Ok((matrix, rows))
}

fn entering(patch: u32, rows: &[Row]) -> Entering<'_> {
    Entering { patch, area: 1.0, albedo: Vec3::new(0.6, 0.5, 0.4), factors: &rows[patch as usize] }
}

/// Patches of a world, and slots for it.
const WORLD: usize = 8192;
const WORLD_SLOTS: usize = 1024;
/// Patches to each side that a row of the world has form factors to.
const REACH: usize = 40;

/// A long street: each patch sends light to its neighbours.
fn street() -> Result<Table, Error> {
    let surface = |i: usize| Surface {
        centre: Vec3::new(i as f32 * 0.1, unit(hash3(i as u32, 1, SEED)), 0.0),
        normal: Vec3::Z,
        area: 1.0,
        albedo: Vec3::new(0.6, 0.5, 0.4),
    };
    let surfaces: Vec<Surface> = (0..WORLD).map(surface).collect();
    let mut starts = vec![0];
    let mut columns = Vec::new();
    let mut values = Vec::new();
    for i in 0..WORLD {
        for j in (i.saturating_sub(REACH)..(i + REACH + 1).min(WORLD)).filter(|&j| j != i) {
            columns.push(j as u32);
            values.push(0.3 / (1.0 + (i.abs_diff(j) as f32).powi(2)));
        }
        starts.push(columns.len() as u32);
    }
    let factors = transport::Csr { rows: WORLD, columns: WORLD, row_start: starts, column_index: columns, values };
    Table::new(&surfaces, factors)
}

/// Steps of a camera that goes to and fro, and that stands.
fn steps(criterion: &mut Criterion) -> Result<(), Error> {
    let mut world = street()?;
    let mut group = criterion.benchmark_group(format!("localmatrix/{WORLD_SLOTS} of {WORLD}"));
    for changes in [16, 64] {
        let settings = LocalSettings { slots: WORLD_SLOTS, changes, ..LocalSettings::default() };
        let mut local = Local::new(localmatrix::World::nodes(&world), settings)?;
        let view = |x: f32| View { eye: Vec3::X * x, predicted: Vec3::X * x };
        local.settle(&mut world, view(100.0), &|_| true)?;
        let mut step = 0;
        group.bench_function(BenchmarkId::new("step", changes), |bench| {
            bench.iter(|| {
                // A metre a frame over three hundred and back.
                step = (step + 1) % 600;
                let x = 400.0 - i32::abs(step - 300) as f32;
                local.step(&mut world, view(x)).map(|step| black_box(step.work))
            });
        });
        local.settle(&mut world, view(100.0), &|_| true)?;
        group.bench_function(BenchmarkId::new("step at rest", changes), |bench| {
            bench.iter(|| local.step(&mut world, view(100.0)).map(|step| black_box(step.work)));
        });
    }
    group.finish();
    Ok(())
}

fn main() -> Result<(), Error> {
    let mut criterion = Criterion::default().configure_from_args().sample_size(20);
    println!("stream out of cache ({} MB): {:.1} GB/s", OUT_OF_CACHE / 1_000_000, stream_gb_s(OUT_OF_CACHE, 5));
    for slots in SLOTS {
        let (matrix, rows) = filled(slots, 16)?;
        let state = 12 * (slots * slots) as u64;
        let mut group = criterion.benchmark_group(format!("localmatrix/{slots}"));
        for count in BATCH {
            let first = (slots - 16) as u32;
            let some: Vec<Entering> = (first..first + count as u32).map(|patch| entering(patch, &rows)).collect();
            group.throughput(Throughput::Bytes(3 * state));
            group.bench_function(BenchmarkId::new("enter", count), |bench| {
                let fresh = || matrix.clone();
                bench.iter_batched_ref(
                    fresh,
                    |matrix| matrix.add(&some).expect("slots are free"),
                    BatchSize::LargeInput,
                );
            });
        }
        group.throughput(Throughput::Bytes(2 * state));
        group.bench_function(BenchmarkId::new("refresh", 1), |bench| {
            let mut matrix = matrix.clone();
            bench.iter(|| black_box(matrix.refresh(1)));
        });
        let light = exitance(slots, slots);
        let mut irradiance = vec![Vec4::ZERO; slots];
        for lit in SHARES {
            for visible in SHARES {
                let some = |share: f64| -> Vec<u32> { (0..(share * slots as f64) as u32).collect() };
                let seen = some(visible);
                let lit_slots = some(lit);
                group.throughput(Throughput::Bytes(12 * (seen.len() * lit_slots.len()) as u64));
                let name = format!("{:.0} % lit, {:.0} % visible", 100.0 * lit, 100.0 * visible);
                group.bench_function(BenchmarkId::new("product", name), |bench| {
                    bench.iter(|| matrix.product(&seen, &lit_slots, &light, &mut irradiance));
                });
            }
        }
        group.finish();
    }
    steps(&mut criterion)?;
    criterion.final_summary();
    Ok(())
}
