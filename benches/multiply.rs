//! A step of Horner's rule, `F + F diag(ρ) T`: faer, the kernel as native code, and the kernel on a Vulkan device; a
//! step of n patches is n³ products and as many sums. `PATCHLIGHT_DEVICE` (a name or a number) chooses the device.

#![allow(missing_docs)]

use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput};
use faer::{Accum, Mat};
use gpu_kernels::table::MULTIBOUNCE_MULTIPLY;
use multibounce::MultiplyParams;
use multibounce::kernel::multiply::{TILE_ROWS, TILE_VECTORS};
use runtime::cpu::Cpu;
use runtime::executor::{DeviceChoice, Executor, ExecutorError, open};
use runtime::plan::{Plan, Range};
use scene::sampling::{hash3, unit};

/// Patches: whole tiles, and few enough for one binding.
const SIZES: [usize; 2] = [512, 1024];

fn entry(i: usize, j: usize, n: usize) -> f32 {
    unit(hash3(i as u32, j as u32, 9)) / n as f32
}

/// Loads a step, and runs it once.
fn load(executor: &mut dyn Executor, n: usize) -> Result<(), ExecutorError> {
    let mut plan = Plan::new();
    let bytes = (4 * n * n) as u64;
    let buffers = [("factors", bytes), ("albedo", 4 * n as u64), ("operator", bytes), ("next", bytes)];
    let [factors, albedo, operator, next] = buffers.map(|(name, bytes)| plan.storage(name, bytes));
    let vectors = n as u32 / 4;
    let row_tiles = n as u32 / TILE_ROWS;
    let tiles = row_tiles * (vectors / TILE_VECTORS);
    let push = MultiplyParams { tiles, row_tiles, vectors, inner: vectors, first_inner: 0 };
    let ranges = [factors, albedo, operator, next].map(Range::from);
    plan.pass("product", &MULTIBOUNCE_MULTIPLY, &ranges, &push)?;
    executor.load(plan)?;
    let matrix: Vec<f32> = (0..n * n).map(|k| entry(k / n, k % n, n)).collect();
    executor.upload(factors, &matrix)?;
    executor.upload(operator, &matrix)?;
    executor.upload(next, &matrix)?;
    executor.upload(albedo, &vec![0.5f32; n])?;
    executor.run()?;
    let sums: Vec<f32> = executor.download_table(next)?;
    let expected: f32 = entry(3, 5, n) + 0.5 * (0..n).map(|k| entry(3, k, n) * entry(k, 5, n)).sum::<f32>();
    assert!((sums[3 * n + 5] - expected).abs() < 1e-4 * expected, "{} for {expected}", sums[3 * n + 5]);
    Ok(())
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let mut group = criterion.benchmark_group("multiply");
    group.sample_size(10).measurement_time(Duration::from_secs(3));
    let choice = std::env::var("PATCHLIGHT_DEVICE").map_or(DeviceChoice::Vulkan, |name| DeviceChoice::parse(&name));
    let mut devices: Vec<Box<dyn Executor>> = vec![Box::new(Cpu::new())];
    match open(&choice) {
        Ok((device, _)) => devices.push(device),
        Err(error) => println!("without a Vulkan device: {error}"),
    }
    for n in SIZES {
        group.throughput(Throughput::Elements(2 * (n as u64).pow(3)));
        let factors = Mat::from_fn(n, n, |i, j| entry(i, j, n));
        let mut next: Mat<f32> = factors.clone();
        group.bench_function(BenchmarkId::new("faer", n), |bencher| {
            bencher.iter(|| {
                let parallel = faer::get_global_parallelism();
                let to = next.as_mut();
                let f = factors.as_ref();
                faer::linalg::matmul::matmul(to, Accum::Replace, f, f, 1.0f32, parallel);
            });
        });
        for device in &mut devices {
            if let Err(error) = load(device.as_mut(), n) {
                println!("{}: {error}", device.device().name);
                continue;
            }
            let name = if device.device().index.is_some() { "vulkan" } else { "native" };
            println!("{name}: {}", device.device().name);
            group.bench_function(BenchmarkId::new(name, n), |bencher| {
                bencher.iter_custom(|rounds| {
                    let run = |_| device.run().map_or(0.0, |times| times.iter().map(|pass| pass.milliseconds).sum());
                    Duration::from_secs_f64((0..rounds).map(run).sum::<f64>() * 1e-3)
                });
            });
        }
    }
    group.finish();
    criterion.final_summary();
}
