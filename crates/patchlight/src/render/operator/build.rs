//! Where operators are built: on the host, or step by step of Horner's rule on a device.

use std::path::PathBuf;

use faer::Mat;
use glam::Vec4;
use gpu_kernels::table::MULTIBOUNCE_MULTIPLY;
use multibounce::MultiplyParams;
use multibounce::kernel::multiply::{TILE_ROWS, TILE_VECTORS};

use super::{Between, MATRICES, available_memory};
use crate::error::Error;
use crate::memory::resident_bytes;
use runtime::executor::{DeviceKind, Executor, ExecutorError};
use runtime::plan::{BufferId, PassId, Plan, Range};
use runtime::vulkan;

/// Where operators of some bounces are built; those of all bounces are factorised on the host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BuildOn {
    /// On the device that frames run on when it is a graphics processor, else on the host.
    #[default]
    Auto,
    /// On the host.
    Host,
    /// On the device that frames run on, whatever it is.
    Device,
}

impl BuildOn {
    /// Whether such a device builds.
    pub fn is_device(self, kind: DeviceKind) -> bool {
        match self {
            Self::Auto => kind < DeviceKind::EmulatedOnCpu,
            Self::Host => false,
            Self::Device => true,
        }
    }
}

/// How the operator between patches is built.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Build {
    /// Where.
    pub on: BuildOn,
    /// Most resident memory of the program meanwhile, bytes; `None` for what the system says is free.
    pub memory_limit: Option<u64>,
    /// Where the files of operators lie that do not fit into it.
    pub folder: PathBuf,
}

impl Default for Build {
    /// In the memory that is free; files lie where the system has temporary ones.
    fn default() -> Self {
        Self { on: BuildOn::default(), memory_limit: None, folder: std::env::temp_dir() }
    }
}

/// Memory that is left for what is not panels: packed blocks of products, tiles that are being made.
const ASIDE_BYTES: u64 = 64 << 20;

impl Build {
    /// Bytes for panels of an operator of so many patches and form factors, where its matrices exceed the limit.
    pub(super) fn panel_bytes(&self, patches: usize, entries: usize) -> Option<u64> {
        let free = match self.memory_limit {
            Some(limit) => limit.saturating_sub(resident_bytes().unwrap_or(0)),
            None => available_memory()?,
        };
        let needed = (MATRICES * size_of::<f32>()) as u64 * (patches as u64).pow(2);
        let sparse = (entries * size_of::<(u32, f32)>()) as u64;
        (needed > free).then(|| free.saturating_sub(sparse + ASIDE_BYTES))
    }
}

/// Columns of a tile: matrices on the device have a multiple of them.
const TILE_COLUMNS: usize = 4 * TILE_VECTORS as usize;

/// Products and their sums of a run at most: few enough that drivers take no run for one that hangs, and that work can be
/// cancelled.
const MOST_PRODUCTS: usize = 1 << 34;

/// Bytes of form factors that are sent at a time.
const UPLOAD_BYTES: usize = 1 << 24;

/// Symmetric operators of so many bounces for red, green and blue, `T_{k+1} = F + F diag(ρ) T_k` by
/// `multibounce_multiply`: 3 N² · 4 bytes on the device (F, T_k and T_{k+1}), 4 N² · 4 bytes on the host (three results, and one
/// as it comes from the device), each N there a whole number of 256. No binding exceeds `range` bytes.
///
/// # Errors
/// Form factors that are not reciprocal, a device that is too small, cancellation.
pub(super) fn some_bounces_on_device(
    device: &mut (dyn Executor + 'static),
    between: &Between,
    albedo: &[Vec4],
    bounces: u32,
    range: u64,
    report: &(dyn Fn(f32) -> bool + Sync),
) -> Result<[Mat<f32>; 3], Error> {
    let n = between.area.len();
    if bounces <= 1 || n == 0 {
        let first = between.symmetric()?;
        return Ok([first.clone(), first.clone(), first]);
    }
    between.view().check_reciprocal()?;
    let name = device.device().name.clone();
    let too_large = |error: ExecutorError| match error {
        ExecutorError::OutOfMemory { .. } | ExecutorError::Vulkan(vulkan::Error::OutOfMemory { .. }) => {
            let needed = 12e-9 * (n.next_multiple_of(TILE_COLUMNS) as f64).powi(2);
            Error::DeviceMemory { patches: n, needed, device: name.clone(), source: Box::new(error) }
        }
        other => other.into(),
    };
    let products = Products::load(device, n, bounces, range).map_err(&too_large)?;
    products.upload_factors(device, between)?;
    let steps = bounces as usize - 1;
    let mut done = 0;
    let mut one = |channel: usize| -> Result<Mat<f32>, Error> {
        let mut reflected = vec![0.0; products.size];
        reflected.iter_mut().zip(albedo).for_each(|(r, rho)| *r = rho[channel]);
        device.upload(products.albedo, &reflected)?;
        for step in 0..steps {
            for panel in products.step(step) {
                device.run_passes(panel)?;
                done += 1;
                if !report(done as f32 / (3 * steps * products.panels) as f32) {
                    return Err(Error::Cancelled);
                }
            }
        }
        let table: Vec<f32> = device.download_table(products.result(steps)).map_err(&too_large)?;
        // Symmetric: rows are columns.
        Ok(Mat::from_fn(n, n, |i, j| table[j * products.size + i]))
    };
    Ok([one(0)?, one(1)?, one(2)?])
}

/// A plan of products, and what it is made of.
struct Products {
    /// Rows and columns of the matrices.
    size: usize,
    factors: BufferId,
    albedo: BufferId,
    operators: [BufferId; 2],
    /// Passes of the panels of `F + F diag(ρ) F`, of what follows, and of what follows that.
    passes: [Vec<Vec<PassId>>; 3],
    /// Panels of rows.
    panels: usize,
}

impl Products {
    /// Loads the plan for n patches.
    fn load(device: &mut dyn Executor, n: usize, bounces: u32, range: u64) -> Result<Self, ExecutorError> {
        let size = n.next_multiple_of(TILE_COLUMNS);
        let row_bytes = (size * size_of::<f32>()) as u64;
        let mut plan = Plan::new();
        let factors = plan.storage("form factors", size as u64 * row_bytes);
        let albedo = plan.storage("albedo", row_bytes);
        let first = plan.storage("operator", size as u64 * row_bytes);
        // Two bounces are one product.
        let second = if bounces > 2 { plan.storage("next operator", size as u64 * row_bytes) } else { first };
        let tile_rows = TILE_ROWS as usize;
        let bound = usize::try_from(range / row_bytes).unwrap_or(usize::MAX).min(size);
        let most_rows = bound.min(MOST_PRODUCTS / (size * size).max(1));
        let rows_at_once = (most_rows / tile_rows * tile_rows).max(tile_rows);
        let inner_at_once = (bound / 4 * 4).max(4);
        let part = |buffer: BufferId, first: usize, rows: usize| -> Range {
            buffer.range(first as u64 * row_bytes, rows as u64 * row_bytes)
        };
        let vectors = size / 4;
        let mut step = |from: BufferId, to: BufferId| -> Result<Vec<Vec<PassId>>, ExecutorError> {
            let mut panels = Vec::new();
            for row in (0..size).step_by(rows_at_once) {
                let rows = rows_at_once.min(size - row);
                let mut passes = Vec::new();
                for k in (0..size).step_by(inner_at_once) {
                    let inner = inner_at_once.min(size - k);
                    let row_tiles = rows / tile_rows;
                    let tiles = (row_tiles * (vectors / TILE_VECTORS as usize)) as u32;
                    let push = MultiplyParams {
                        tiles,
                        row_tiles: row_tiles as u32,
                        vectors: vectors as u32,
                        inner: inner as u32 / 4,
                        first_inner: k as u32 / 4,
                    };
                    let bound = [part(factors, row, rows), albedo.into(), part(from, k, inner), part(to, row, rows)];
                    passes.push(plan.pass("product", &MULTIBOUNCE_MULTIPLY, &bound, &push, tiles)?);
                }
                panels.push(passes);
            }
            Ok(panels)
        };
        let begin = step(factors, first)?;
        let (there, back) = if bounces > 2 { (step(first, second)?, step(second, first)?) } else { Default::default() };
        let panels = begin.len();
        device.load(plan)?;
        // All of it is zeros; this only says that it may be read, for sums go on from it.
        for buffer in [first, second] {
            device.upload_at(buffer, 0, &[0; 4])?;
        }
        Ok(Self { size, factors, albedo, operators: [first, second], passes: [begin, there, back], panels })
    }

    /// The symmetric form factors, some rows at a time.
    fn upload_factors(&self, device: &mut dyn Executor, between: &Between) -> Result<(), ExecutorError> {
        let n = between.area.len();
        let root: Vec<f32> = between.area.iter().map(|&a| scene::math::sqrt(a)).collect();
        let at_once = (UPLOAD_BYTES / (self.size * size_of::<f32>()).max(1)).max(1);
        let mut rows = Vec::new();
        for first in (0..n).step_by(at_once) {
            let count = at_once.min(n - first);
            rows.clear();
            rows.resize(count * self.size, 0.0f32);
            for (i, row) in (first..).zip(rows.chunks_mut(self.size)) {
                for (j, f) in between.view().row(i) {
                    row[j] += f * root[i] / root[j];
                }
            }
            let offset = (first * self.size * size_of::<f32>()) as u64;
            device.upload_at(self.factors, offset, bytemuck::cast_slice(&rows))?;
        }
        Ok(())
    }

    /// Passes of a step, panel by panel.
    fn step(&self, step: usize) -> impl Iterator<Item = &[PassId]> {
        self.passes[if step == 0 { 0 } else { 2 - step % 2 }].iter().map(Vec::as_slice)
    }

    /// Where so many steps end.
    fn result(&self, steps: usize) -> BufferId {
        self.operators[(steps + 1) % 2]
    }
}

#[cfg(test)]
mod tests {
    use multibounce::some_bounces;

    use super::super::tests::cornell;
    use super::*;
    use runtime::cpu::Cpu;
    use runtime::executor::{DeviceChoice, open};

    /// Greatest relative difference of the channels (Frobenius).
    fn difference(ours: &[Mat<f32>; 3], exact: &[Mat<f32>; 3]) -> f32 {
        let one = |(a, b): (&Mat<f32>, &Mat<f32>)| (a - b).norm_l2() / b.norm_l2();
        ours.iter().zip(exact).map(one).fold(0.0, f32::max)
    }

    fn channel(albedo: &[Vec4], c: usize) -> Vec<f32> {
        albedo.iter().map(|rho| rho[c]).collect()
    }

    #[test]
    fn a_device_builds_the_operator_of_the_host_for_every_size_of_a_binding() {
        let (between, albedo) = cornell();
        let symmetric = between.symmetric().unwrap();
        let n = albedo.len();
        let mut devices: Vec<Box<dyn Executor>> = vec![Box::new(Cpu::new())];
        match open(&DeviceChoice::Vulkan) {
            Ok((vulkan, _)) => devices.push(vulkan),
            Err(error) => println!("skipped on Vulkan: {error}"),
        }
        for mut device in devices {
            for (bounces, range) in [(1, u64::MAX), (2, 20_000), (3, u64::MAX), (4, 20_000), (5, 100_000)] {
                let device = device.as_mut();
                let range = range.min(device.device().max_storage_buffer_range);
                let made = some_bounces_on_device(device, &between, &albedo, bounces, range, &|_| true).unwrap();
                let host = [0, 1, 2].map(|c| {
                    let go_on = |_, _| std::ops::ControlFlow::Continue(());
                    some_bounces(&symmetric, &channel(&albedo, c), bounces, &go_on).unwrap()
                });
                let powers = [0, 1, 2].map(|c| {
                    let reflected = Mat::from_fn(n, n, |i, j| albedo[i][c] * symmetric[(i, j)]);
                    let (mut sum, mut power) = (symmetric.clone(), symmetric.clone());
                    for _ in 1..bounces {
                        power = &power * &reflected;
                        sum += &power;
                    }
                    sum
                });
                for exact in [&host, &powers] {
                    let error = difference(&made, exact);
                    assert!(error < 1e-5, "{bounces} bounces in ranges of {range} bytes: {error}");
                }
                if bounces > 1 {
                    let mut other = albedo.clone();
                    other.swap(3, 70);
                    other[n - 1] *= 0.9;
                    let made = some_bounces_on_device(device, &between, &other, bounces, range, &|_| true).unwrap();
                    assert!(difference(&made, &host) > 1e-4, "another albedo is not noticed");
                }
            }
        }
    }

    #[test]
    fn building_on_a_device_ends_when_it_is_cancelled_and_says_when_it_does_not_fit() {
        let (between, albedo) = cornell();
        let mut cpu = Cpu::new();
        let stopped = some_bounces_on_device(&mut cpu, &between, &albedo, 3, 20_000, &|share| share < 0.2);
        assert!(matches!(stopped, Err(Error::Cancelled)), "{stopped:?}");
        let error = Error::DeviceMemory {
            patches: 60_000,
            needed: 43.2,
            device: "a card".into(),
            source: Box::new(ExecutorError::OutOfMemory { buffer: "operator".into(), bytes: 1 << 33 }),
        };
        let message = error.to_string();
        assert!(message.contains("43.2 GB") && message.contains("--build-on host"), "{message}");
    }

    #[test]
    fn only_graphics_processors_build_by_themselves() {
        for kind in [DeviceKind::Discrete, DeviceKind::Integrated, DeviceKind::EmulatedOnCpu, DeviceKind::Native] {
            assert_eq!(BuildOn::Auto.is_device(kind), kind < DeviceKind::EmulatedOnCpu);
            assert!(BuildOn::Device.is_device(kind) && !BuildOn::Host.is_device(kind));
        }
    }
}
