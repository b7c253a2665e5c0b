//! Building of operators: on the host, in files, or on a device, by elimination of blocks or by steps of Horner's rule.

use std::path::PathBuf;

use faer::Mat;
use glam::Vec4;
use multibounce::{Channels, bounce_system, bounces_of_inverse, invert};
use runtime::executor::{DeviceKind, Executor, ExecutorError};
use runtime::recipe::invert::{BLOCK, Inverse};
use runtime::recipe::multiply::{Products, TILE_COLUMNS};
use transport::{Observer, Phase};

use super::{Codec, PatchOperator, RADIUS_TOLERANCE, SymmetricFactors, growth};
use crate::error::{Error, Reason};
use crate::memory::{available_bytes, free_bytes};
use crate::method::Preparation;
use crate::observe::{Report, run_phase};

/// Place where operators between patches are built.
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
    /// Returns true if such a device builds.
    pub fn is_device(self, kind: DeviceKind) -> bool {
        match self {
            Self::Auto => kind < DeviceKind::EmulatedOnCpu,
            Self::Host => false,
            Self::Device => true,
        }
    }
}

/// Building of the operator between patches.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Build {
    /// Place.
    pub on: BuildOn,
    /// Most resident memory of the program meanwhile, bytes; `None` for what the system says is free.
    pub memory_limit: Option<u64>,
    /// Folder for the files of operators that do not fit into it.
    pub folder: PathBuf,
}

impl Default for Build {
    /// In the memory that is free; files lie where the system has temporary ones. A browser has none.
    fn default() -> Self {
        let folder = if cfg!(target_family = "wasm") { PathBuf::new() } else { std::env::temp_dir() };
        Self { on: BuildOn::default(), memory_limit: None, folder }
    }
}

/// Dense matrices of single precision at the peak, of some bounces: two operators that are made, F, three of the
/// solver.
pub const MATRICES: usize = 6;

/// Memory that is left for what is not panels: packed blocks of products, tiles that are being made.
const ASIDE_BYTES: u64 = 64 << 20;

impl Build {
    /// Bytes for panels of an operator of so many patches and form factors, where its matrices exceed the limit.
    pub fn panel_bytes(&self, patches: usize, entries: usize) -> Option<u64> {
        let free = free_bytes(self.memory_limit)?;
        let needed = (MATRICES * size_of::<f32>()) as u64 * (patches as u64).pow(2);
        let sparse = (entries * size_of::<(u32, f32)>()) as u64;
        (needed > free).then(|| free.saturating_sub(sparse + ASIDE_BYTES))
    }
}

/// Checks that so many matrices fit into the free memory, where the system says how much that is.
///
/// # Errors
/// [`Memory`](crate::ErrorKind::Memory), with what would do `instead`.
pub fn check_memory(patches: usize, matrices: usize, instead: &'static str) -> Result<(), Error> {
    let needed = (matrices * size_of::<f32>()) as f64 * (patches as f64).powi(2) * 1e-9;
    match available_bytes() {
        Some(bytes) if needed > bytes as f64 * 1e-9 => {
            Err(Reason::OperatorMemory { patches, needed, available: bytes as f64 * 1e-9, instead }.into())
        }
        _ => Ok(()),
    }
}

/// The operator of so many bounces between patches, or of all, as `codec` stores it.
///
/// # Errors
/// An operator that does not fit into memory, cancellation.
pub fn all_bounces_operator(
    codec: Codec,
    bounces: Option<u32>,
    with: &Preparation,
    device: &mut (dyn Executor + 'static),
) -> Result<PatchOperator, Error> {
    let bake = with.bake;
    let factors = SymmetricFactors::new(&bake.mesh, &bake.form_factors.factors)?;
    let albedo = &bake.mesh.albedo;
    let seed = bake.settings.seed;
    let observer = with.observer;
    let operator = match with.build.panel_bytes(albedo.len(), factors.factors.values.len()) {
        Some(bytes) => {
            let panels = Panels { factors: &factors, albedo, bounces, seed, build: with.build, bytes };
            panels.build(codec, observer)?
        }
        None => {
            let operators = bounces_on(&factors, albedo, bounces, with.build, device, observer)?;
            PatchOperator::encode(codec, Channels::Three(operators.each_ref()), &factors, seed, observer)?
        }
    };
    observer.note(&operator.describe());
    Ok(operator)
}

/// The compressed form factors, with a relative Frobenius error of `epsilon`.
///
/// # Errors
/// Form factors that cannot be compressed, cancellation.
pub fn form_factor_operator(epsilon: f64, with: &Preparation) -> Result<PatchOperator, Error> {
    let bake = with.bake;
    let factors = SymmetricFactors::new(&bake.mesh, &bake.form_factors.factors)?;
    let operator = compress_form_factors(factors, epsilon, bake.settings.seed, with.observer)?;
    with.observer.note(&operator.describe());
    Ok(operator)
}

/// The compressed form factors, scaled where light would grow in them from bounce to bounce: their spectral radius is
/// at most 1, and so is below 1 with every albedo below 1.
pub(crate) fn compress_form_factors(
    mut factors: SymmetricFactors,
    epsilon: f64,
    seed: u32,
    observer: &dyn Observer,
) -> Result<PatchOperator, Error> {
    let codec = Codec::LowRank { epsilon };
    let operator = PatchOperator::encode(codec, factors.channels(), &factors, seed, observer)?;
    let radius = growth(&vec![Vec4::ONE; operator.patches()], &operator)?;
    if radius <= 1.0 + 2.0 * RADIUS_TOLERANCE {
        return Ok(operator);
    }
    observer.note(&format!("compressed form factors are scaled by {:.4}, for light would grow", 1.0 / radius));
    let scale = (1.0 - RADIUS_TOLERANCE) / radius;
    factors.factors.values.iter_mut().for_each(|f| *f *= scale);
    PatchOperator::encode(codec, factors.channels(), &factors, seed, observer)
}

/// An operator whose matrices do not fit into memory.
pub(crate) struct Panels<'a> {
    pub factors: &'a SymmetricFactors,
    pub albedo: &'a [Vec4],
    pub bounces: Option<u32>,
    pub seed: u32,
    pub build: &'a Build,
    /// Bytes of panels that are held at a time.
    pub bytes: u64,
}

impl Panels<'_> {
    /// Builds it in files; only low-rank operators are encoded from those: other codecs read it patch by patch, or are
    /// as large themselves.
    pub fn build(&self, codec: Codec, observer: &dyn Observer) -> Result<PatchOperator, Error> {
        let patches = self.albedo.len();
        if !matches!(codec, Codec::LowRank { .. }) {
            let needed = (MATRICES * size_of::<f32>()) as f64 * (patches as f64).powi(2) * 1e-9;
            let available = self.bytes as f64 * 1e-9;
            return Err(Reason::OperatorMemory { patches, needed, available, instead: "low_rank" }.into());
        }
        let stored = self.factors.stored(self.albedo, self.bounces, self.build, self.bytes, observer)?;
        let held = stored.iter().map(|stored| stored.held_bytes).max().unwrap_or(0);
        let folder = self.build.folder.display();
        observer.note(&format!("operator built in panels of {} MB, kept in {folder}", held >> 20));
        PatchOperator::encode(codec, Channels::Stored(stored.each_ref()), self.factors, self.seed, observer)
    }
}

/// The symmetric operators for red, green and blue, on a device where the build says so; on the host, with a note, when
/// nobody asked for a device that is too small.
fn bounces_on(
    factors: &SymmetricFactors,
    albedo: &[Vec4],
    bounces: Option<u32>,
    build: &Build,
    device: &mut (dyn Executor + 'static),
    observer: &dyn Observer,
) -> Result<[Mat<f32>; 3], Error> {
    let is_device = build.on.is_device(device.device().kind);
    if !is_device {
        return factors.bounces(albedo, bounces, observer);
    }
    let range = device.device().max_storage_buffer_range;
    let made = run_phase(observer, Phase::OPERATOR, |report| match bounces {
        Some(count) => some_bounces_on_device(device, factors, albedo, count, range, report),
        None => all_bounces_on_device(device, factors, albedo, range, report),
    });
    if made.is_ok() {
        observer.note(&format!("operator built on {}", device.device().name));
    }
    match made {
        Err(error) if build.on == BuildOn::Auto && matches!(error.reason(), Reason::DeviceMemory { .. }) => {
            observer.note(&format!("{error}; it is built on the host"));
            factors.bounces(albedo, bounces, observer)
        }
        other => other,
    }
}

/// Bytes of form factors that are sent at a time.
const UPLOAD_BYTES: usize = 1 << 24;

/// Symmetric operators of so many bounces for red, green and blue, `T_{k+1} = F + F diag(ρ) T_k` by
/// `multibounce_multiply`: 3 N² · 4 bytes on the device (F, T_k and T_{k+1}), 4 N² · 4 bytes on the host (three
/// results, and one as it comes from the device), each N there a whole number of 256. No binding exceeds `range` bytes.
///
/// # Errors
/// Form factors that are not reciprocal, a device that is too small, cancellation.
pub(crate) fn some_bounces_on_device(
    device: &mut (dyn Executor + 'static),
    factors: &SymmetricFactors,
    albedo: &[Vec4],
    bounces: u32,
    range: u64,
    report: &Report,
) -> Result<[Mat<f32>; 3], Error> {
    let n = factors.area.len();
    if bounces <= 1 || n == 0 {
        let first = factors.symmetric()?;
        return Ok([first.clone(), first.clone(), first]);
    }
    factors.view().check_reciprocal()?;
    let name = device.device().name.clone();
    let too_large = |error: ExecutorError| memory_error(error, n, &name);
    let products = Products::load(device, n, bounces, range).map_err(too_large)?;
    upload_factors(&products, device, factors)?;
    let steps = bounces as usize - 1;
    let total = 3 * steps * products.panels();
    let mut done = 0;
    let mut one = |channel: usize| -> Result<Mat<f32>, Error> {
        let mut reflected = vec![0.0; products.size()];
        reflected.iter_mut().zip(albedo).for_each(|(r, rho)| *r = rho[channel]);
        products.set_albedo(device, &reflected)?;
        for step in 0..steps {
            for panel in products.step(step) {
                device.run_passes(panel)?;
                done += 1;
                if report(done, total).is_break() {
                    return Err(Error::cancelled());
                }
            }
        }
        let table: Vec<f32> = device.download_table(products.result(steps)).map_err(too_large)?;
        // Symmetric: rows are columns.
        Ok(Mat::from_fn(n, n, |i, j| table[j * products.size() + i]))
    };
    Ok([one(0)?, one(1)?, one(2)?])
}

/// Symmetric operators of all bounces for red, green and blue, by elimination of blocks ([`Inverse`]): N² · 4 bytes on
/// the device, N a whole number of 256 there; the host inverts the blocks of 64 × 64 entries on the diagonal. No
/// binding exceeds `range` bytes.
///
/// # Errors
/// Form factors that are not reciprocal, light that would grow for ever, a device that is too small, cancellation.
pub(crate) fn all_bounces_on_device(
    device: &mut (dyn Executor + 'static),
    factors: &SymmetricFactors,
    albedo: &[Vec4],
    range: u64,
    report: &Report,
) -> Result<[Mat<f32>; 3], Error> {
    let n = factors.area.len();
    let name = device.device().name.clone();
    let inverse = Inverse::load(device, n, range).map_err(|error| memory_error(error, n, &name))?;
    let total = 3 * inverse.blocks();
    let mut one = |channel: usize| -> Result<Mat<f32>, Error> {
        let albedo: Vec<f32> = albedo.iter().map(|rho| rho[channel]).collect();
        upload_system(&inverse, device, &bounce_system(factors.symmetric()?, &albedo)?)?;
        for step in 0..inverse.blocks() {
            let block = inverse.pivot_block(device, step)?;
            // Symmetric but for rounding.
            let mut block = Mat::from_fn(BLOCK, BLOCK, |i, j| block[i.min(j) * BLOCK + i.max(j)]);
            invert(&mut block).map_err(|error| match error {
                multibounce::Error::Singular { patch } => multibounce::Error::Singular { patch: step * BLOCK + patch },
                other => other,
            })?;
            let block: Vec<f32> = block.col_iter().flat_map(|column| column.iter().copied()).collect();
            inverse.eliminate(device, step, &block)?;
            if report(channel * inverse.blocks() + step + 1, total).is_break() {
                return Err(Error::cancelled());
            }
        }
        let table = inverse.download(device)?;
        let whole = Mat::from_fn(n, n, |i, j| table[i.min(j) * inverse.size() + i.max(j)]);
        Ok(bounces_of_inverse(whole, &albedo)?)
    };
    Ok([one(0)?, one(1)?, one(2)?])
}

/// A symmetric matrix, some rows at a time; the identity beyond it.
fn upload_system(inverse: &Inverse, device: &mut dyn Executor, matrix: &Mat<f32>) -> Result<(), ExecutorError> {
    let size = inverse.size();
    let at_once = (UPLOAD_BYTES / (size * size_of::<f32>()).max(1)).max(1);
    for first in (0..size).step_by(at_once) {
        let mut rows = vec![0.0f32; at_once.min(size - first) * size];
        for (i, row) in (first..).zip(rows.chunks_mut(size)) {
            match i < matrix.ncols() {
                // A column lies together in memory.
                true => row.iter_mut().zip(matrix.col(i).iter()).for_each(|(to, &from)| *to = from),
                false => row[i] = 1.0,
            }
        }
        inverse.upload_rows(device, first, &rows)?;
    }
    Ok(())
}

/// Names what does not fit where a device says that something does not.
fn memory_error(error: ExecutorError, n: usize, device: &str) -> Error {
    if !error.is_out_of_memory() {
        return error.into();
    }
    let needed = 12e-9 * (n.next_multiple_of(TILE_COLUMNS) as f64).powi(2);
    Reason::DeviceMemory { patches: n, needed, device: device.to_owned(), source: Box::new(error) }.into()
}

/// The symmetric form factors, some rows at a time.
fn upload_factors(
    products: &Products,
    device: &mut dyn Executor,
    factors: &SymmetricFactors,
) -> Result<(), ExecutorError> {
    let n = factors.area.len();
    let size = products.size();
    let sqrt_area: Vec<f32> = factors.area.iter().map(|&a| scene::math::sqrt(a)).collect();
    let at_once = (UPLOAD_BYTES / (size * size_of::<f32>()).max(1)).max(1);
    let mut rows = Vec::new();
    for first in (0..n).step_by(at_once) {
        let count = at_once.min(n - first);
        rows.clear();
        rows.resize(count * size, 0.0f32);
        for (i, row) in (first..).zip(rows.chunks_mut(size)) {
            for (j, f) in factors.view().row(i) {
                row[j] += f * sqrt_area[i] / sqrt_area[j];
            }
        }
        products.upload_rows(device, first, &rows)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use multibounce::some_bounces;
    use runtime::cpu::Cpu;
    use runtime::executor::{DeviceChoice, open};

    use super::super::tests::cornell;
    use super::*;
    use crate::method::firstshot::ignore_progress;

    /// Greatest relative difference of the channels (Frobenius).
    fn difference(ours: &[Mat<f32>; 3], exact: &[Mat<f32>; 3]) -> f32 {
        ours.iter().zip(exact).map(|(a, b)| (a - b).norm_l2() / b.norm_l2()).fold(0.0, f32::max)
    }

    fn channel(albedo: &[Vec4], c: usize) -> Vec<f32> {
        albedo.iter().map(|rho| rho[c]).collect()
    }

    /// `F + F ρ F + …` by powers.
    fn by_powers(symmetric: &Mat<f32>, albedo: &[Vec4], bounces: u32, c: usize) -> Mat<f32> {
        let n = albedo.len();
        let reflected = Mat::from_fn(n, n, |i, j| albedo[i][c] * symmetric[(i, j)]);
        let mut sum = symmetric.clone();
        let mut power = symmetric.clone();
        for _ in 1..bounces {
            power = &power * &reflected;
            sum += &power;
        }
        sum
    }

    #[test]
    fn a_device_builds_the_operator_of_the_host_for_every_size_of_a_binding() {
        let (factors, albedo) = cornell();
        let symmetric = factors.symmetric().unwrap();
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
                let made = some_bounces_on_device(device, &factors, &albedo, bounces, range, &ignore_progress).unwrap();
                let host = [0, 1, 2]
                    .map(|c| some_bounces(&symmetric, &channel(&albedo, c), bounces, &ignore_progress).unwrap());
                let powers = [0, 1, 2].map(|c| by_powers(&symmetric, &albedo, bounces, c));
                for exact in [&host, &powers] {
                    let error = difference(&made, exact);
                    assert!(error < 1e-5, "{bounces} bounces in ranges of {range} bytes: {error}");
                }
                if bounces > 1 {
                    let mut other = albedo.clone();
                    other.swap(3, 70);
                    other[n - 1] *= 0.9;
                    let made =
                        some_bounces_on_device(device, &factors, &other, bounces, range, &ignore_progress).unwrap();
                    assert!(difference(&made, &host) > 1e-4, "another albedo is not noticed");
                }
            }
        }
    }

    #[test]
    fn a_device_builds_all_bounces_for_every_size_of_a_binding() {
        let (factors, mut albedo) = cornell();
        // Patches that hardly reflect are corrected for afterwards.
        albedo[7] = Vec4::ZERO;
        let exact = factors.bounces(&albedo, None, &transport::Silent).unwrap();
        let mut devices: Vec<Box<dyn Executor>> = vec![Box::new(Cpu::new())];
        match open(&DeviceChoice::Vulkan) {
            Ok((vulkan, _)) => devices.push(vulkan),
            Err(error) => println!("skipped on Vulkan: {error}"),
        }
        let mut same = Vec::new();
        for mut device in devices {
            for range in [u64::MAX, 70_000] {
                let device = device.as_mut();
                let range = range.min(device.device().max_storage_buffer_range);
                let made = all_bounces_on_device(device, &factors, &albedo, range, &ignore_progress).unwrap();
                let error = difference(&made, &exact);
                // Sums in single precision, in another order.
                assert!(error < 2e-5, "in ranges of {range} bytes: {error}");
                let mut other = albedo.clone();
                other.swap(3, 70);
                let wrong = all_bounces_on_device(device, &factors, &other, range, &ignore_progress).unwrap();
                assert!(difference(&wrong, &exact) > 1e-4, "another albedo is not noticed");
                same.push(made);
            }
        }
        let bits = |made: &[Mat<f32>; 3]| {
            made.each_ref().map(|m| {
                m.col_iter().flat_map(|c| c.iter().map(|x| x.to_bits()).collect::<Vec<_>>()).collect::<Vec<u32>>()
            })
        };
        assert!(same.iter().all(|made| bits(made) == bits(&same[0])), "devices and ranges change bits");
    }

    #[test]
    fn building_on_a_device_ends_when_it_is_cancelled_and_says_when_it_does_not_fit() {
        use std::ops::ControlFlow;
        let (factors, albedo) = cornell();
        let mut cpu = Cpu::new();
        let early = |done: usize, total: usize| match 5 * done < total {
            true => ControlFlow::Continue(()),
            false => ControlFlow::Break(()),
        };
        let stopped = some_bounces_on_device(&mut cpu, &factors, &albedo, 3, 20_000, &early);
        assert!(stopped.as_ref().is_err_and(Error::is_cancelled), "{stopped:?}");
        let error = Reason::DeviceMemory {
            patches: 60_000,
            needed: 43.2,
            device: "a card".into(),
            source: Box::new(ExecutorError::OutOfMemory { buffer: "operator".into(), bytes: 1 << 33 }),
        };
        let message = error.to_string();
        assert!(message.contains("43.2 GB") && message.contains("on the host"), "{message}");
    }

    #[test]
    fn only_graphics_processors_build_by_themselves() {
        for kind in [DeviceKind::Discrete, DeviceKind::Integrated, DeviceKind::EmulatedOnCpu, DeviceKind::Native] {
            assert_eq!(BuildOn::Auto.is_device(kind), kind < DeviceKind::EmulatedOnCpu);
            assert!(BuildOn::Device.is_device(kind) && !BuildOn::Host.is_device(kind));
        }
    }
}
