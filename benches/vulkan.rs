//! The dense products on a Vulkan device, by its own clock: GB/s of the matrix beside what the device streams itself
//! and what native code reads on this machine. `PATCHLIGHT_DEVICE` (a name or a number) chooses the device.

#![allow(missing_docs)]

use std::time::Duration;

use benches::{PRODUCT_SIZES, exitance, factors, stream_gb_s};
use criterion::{BenchmarkId, Criterion, Throughput};
use formfactor::GatherParams;
use glam::Vec4;
use gpu_kernels::params::CountParams;
use gpu_kernels::table::{Kernel, TRANSPORT_BOUNCE, TRANSPORT_GATHER, TRANSPORT_GATHER_HALF};
use runtime::executor::{DeviceChoice, Executor, ExecutorError, open};
use runtime::plan::{BufferId, Plan, Range};

/// Factors whole or half.
struct Form {
    name: &'static str,
    kernel: &'static Kernel,
    factor_bytes: usize,
}

const FORMS: [Form; 2] = [
    Form { name: "f32", kernel: &TRANSPORT_GATHER, factor_bytes: 4 },
    Form { name: "half", kernel: &TRANSPORT_GATHER_HALF, factor_bytes: 2 },
];

/// Milliseconds of one run of the loaded plan.
fn run(executor: &mut dyn Executor) -> Result<f64, ExecutorError> {
    Ok(executor.run()?.iter().map(|pass| pass.milliseconds).sum())
}

/// Loads `H = F B` for n patches in a form, in blocks of rows where the matrix exceeds a binding; its matrix' bytes.
fn load(executor: &mut dyn Executor, form: &Form, n: usize) -> Result<usize, ExecutorError> {
    let vectors = n.div_ceil(4);
    let row_bytes = 4 * vectors * form.factor_bytes;
    let bytes = n * row_bytes;
    let mut plan = Plan::new();
    let irradiance = plan.storage("irradiance", (n * size_of::<Vec4>()) as u64);
    let matrix: BufferId = plan.storage("factors", bytes as u64);
    let light: BufferId = plan.storage("exitance", (64 * vectors) as u64);
    let range = usize::try_from(executor.device().max_storage_buffer_range).unwrap_or(usize::MAX);
    // Blocks begin at multiples of 256 bytes.
    let block = (range / row_bytes / 64 * 64).clamp(64, n.next_multiple_of(64));
    for first in (0..n).step_by(block) {
        let rows = block.min(n - first);
        let part = matrix.range((first * row_bytes) as u64, (rows * row_bytes) as u64);
        let push = GatherParams { rows: rows as u32, vectors: vectors as u32, first_row: first as u32, reserved: 0 };
        plan.pass("product", form.kernel, &[part, light.into(), irradiance.into()], &push)?;
    }
    executor.load(plan)?;
    let dense = factors(n, 4 * vectors, n);
    if form.factor_bytes == 4 {
        executor.upload(matrix, &dense.values)?;
    } else {
        executor.upload(matrix, &dense.to_half().words)?;
    }
    executor.upload(light, &exitance(n, 4 * vectors))?;
    run(executor)?;
    let sums: Vec<Vec4> = executor.download_table(irradiance)?;
    // Rows of F sum to about 1 and the exitance is ½ in the mean: anything else would be the speed of another thing.
    let mean = sums.iter().map(|h| h.x).sum::<f32>() / n as f32;
    assert!((mean - 0.5).abs() < 0.05, "mean irradiance {mean}");
    Ok(bytes)
}

/// Bandwidth with which the device streams, GB/s: three buffers read, one written, as large as a binding may be (at
/// most 256 MB).
fn device_stream_gb_s(executor: &mut dyn Executor) -> Result<f64, ExecutorError> {
    let count = (executor.device().max_storage_buffer_range / 16).min(1 << 24) as u32;
    let mut plan = Plan::new();
    let buffers = ["source", "albedo", "irradiance", "exitance"].map(|name| plan.storage(name, u64::from(count) * 16));
    plan.pass("stream", &TRANSPORT_BOUNCE, &buffers.map(Range::from), &CountParams { count })?;
    executor.load(plan)?;
    for buffer in &buffers[..3] {
        // Buffers start as zeros; this only says that they may be read.
        executor.upload(*buffer, &[Vec4::ZERO])?;
    }
    let mut best = f64::INFINITY;
    for _ in 0..8 {
        best = best.min(run(executor)?);
    }
    Ok(64.0 * f64::from(count) * 1e-6 / best)
}

fn measure(criterion: &mut Criterion, executor: &mut dyn Executor) -> Result<(), ExecutorError> {
    let device = executor.device().name.clone();
    let native = stream_gb_s(1100 << 20, 5);
    let own = device_stream_gb_s(executor)?;
    println!("{device}: streams {own:.1} GB/s; native code reads {native:.1} GB/s out of cache on this machine");
    for n in PRODUCT_SIZES {
        for form in &FORMS {
            let bytes = load(executor, form, n)?;
            let read = stream_gb_s(bytes, 5);
            let mut best = f64::INFINITY;
            let mut failed = None;
            let mut group = criterion.benchmark_group("product/vulkan");
            group.sample_size(10).warm_up_time(Duration::from_millis(100)).measurement_time(Duration::from_secs(1));
            group.throughput(Throughput::Bytes(bytes as u64));
            group.bench_function(BenchmarkId::new(form.name, n), |b| {
                b.iter_custom(|rounds| {
                    let mut sum = 0.0;
                    for _ in 0..rounds {
                        match run(executor) {
                            Ok(milliseconds) => {
                                sum += milliseconds;
                                best = best.min(milliseconds);
                            }
                            Err(error) => failed = Some(error),
                        }
                    }
                    Duration::from_secs_f64(1e-3 * sum)
                });
            });
            group.finish();
            if let Some(error) = failed {
                return Err(error);
            }
            if best.is_finite() {
                let speed = bytes as f64 * 1e-6 / best;
                println!(
                    "product/vulkan/{}/{n} on {device}: {best:.2} ms, {speed:.2} GB/s, {:.1} % of the device's stream, \
                     {:.1} % of native reads of {:.0} MB ({read:.1} GB/s)",
                    form.name,
                    100.0 * speed / own,
                    100.0 * speed / read,
                    bytes as f64 * 1e-6
                );
            }
        }
    }
    Ok(())
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let choice = std::env::var("PATCHLIGHT_DEVICE").map_or(DeviceChoice::Vulkan, |name| DeviceChoice::parse(&name));
    match open(&choice) {
        Ok((mut executor, _)) => {
            if let Err(error) = measure(&mut criterion, executor.as_mut()) {
                println!("stopped: {error}");
            }
        }
        Err(error) => println!("skipped: {error}"),
    }
    criterion.final_summary();
}
