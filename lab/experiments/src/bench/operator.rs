//! `bench operator`: how large and how fast the light between patches is, over the error of its compression.

mod blocks;
mod receivers;

use std::sync::Arc;
use std::time::Instant;

use ::patches::{Density, MeshSettings, PatchKind, PatchMesh, lit_sampler};
use faer::Mat;
use formfactor::{Stop, jacobi};
use glam::Vec4;
use multibounce::{Acceleration, Channels, LowRank, LowRankWorkspace, TileSide, TileSource};
use patchlight::low_level::operator::build::{MATRICES, check_memory};
use patchlight::low_level::operator::{PatchOperator, SymmetricFactors, accelerations};
use patchlight::memory::peak_memory_bytes;
use patchlight::{BakeSettings, Estimator, FormFactors};
use runtime::executor::{DeviceChoice, DeviceKind, Executor};
use runtime::recipe::multibounce::{Decoder, Product};
use scene::Scene;
use serde::Serialize;
use shell::device::open;
use shell::operator_error::{exact_product, relative_error};
use transport::{Dense, LinearOperator};

use super::setup::{Machine, SCENES, Setup};
use crate::args::{Bench, Blocks, Common, Patches};
use crate::bandwidth::stream_gb_s;
use crate::error::Error;
use crate::measure::{Settling, compact_lights, own_light};
use crate::output;
use crate::progress::Progress;
use crate::report::{Plot, Section, Series, Table, page};
use receivers::{ReceiverRows, Receivers};

/// Patches of a scene, unless it is said.
const COUNT: u32 = 10_000;
/// Products whose times give the median.
const ROUNDS: usize = 41;
/// Rounds on a device.
const DEVICE_ROUNDS: usize = 11;
/// Bounces of classic radiosity that one product is compared with.
const BOUNCES: u32 = 3;

/// A measurement.
#[derive(Serialize)]
struct Row {
    scene: String,
    /// Kind of patches.
    kind: &'static str,
    /// `F`, `T` of all bounces, or `F_r` from the patches to receivers.
    operator: &'static str,
    /// Storage of the operator.
    method: &'static str,
    patches: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    receivers: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    epsilon: Option<f64>,
    /// Bytes that a product reads, all channels.
    bytes: u64,
    /// Bytes of what does not follow from the rest.
    stored_bytes: u64,
    /// Relative Frobenius error, the greatest of the channels.
    frobenius: f64,
    /// Relative error of irradiance (L2 by area): of the scene's light, the greatest of the compact lights.
    own_light: f64,
    compact_lights: f64,
    median_ms: f64,
    /// Time in which the machine reads as many bytes.
    floor_ms: f64,
    /// On the Vulkan device, by its clock.
    #[serde(skip_serializing_if = "Option::is_none")]
    device_ms: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    compress_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    blocks: Option<blocks::Blocks>,
}

/// Time and memory of a scene before its operators were compressed.
#[derive(Clone, Serialize)]
struct Build {
    scene: String,
    kind: &'static str,
    patches: usize,
    form_factors_s: f64,
    /// All bounces, three channels; absent where they do not fit into memory.
    #[serde(skip_serializing_if = "Option::is_none")]
    operator_s: Option<f64>,
    /// Share of a change of light that a bounce of feedback leaves to come, plain and accelerated.
    rates: [f32; 2],
    /// Bounces until a thousandth of the scene's own light is left to come, plain and accelerated.
    bounces: [usize; 2],
    #[serde(skip_serializing_if = "Option::is_none")]
    receivers: Option<ReceiverRows>,
    #[serde(skip_serializing_if = "Option::is_none")]
    peak_memory_bytes: Option<u64>,
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    machine: &'a Machine,
    seed: u32,
    builds: &'a [Build],
    rows: &'a [Row],
}

/// A light and what it gives without compression.
struct Truth {
    source: Vec<Vec4>,
    direct: Vec<Vec4>,
    /// Light of all bounces, where T is known.
    all: Option<Vec<Vec4>>,
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, "operator", &SCENES, &[COUNT])?;
    let mut builds = Vec::new();
    let mut rows = Vec::new();
    let mut device = vulkan_device(common)?;
    let results = |builds: &[Build], rows: &[Row]| {
        output::json(&Results { name: "operator", machine: &machine, seed: common.seed, builds, rows })
    };
    let kinds = if args.kinds.is_empty() { &[Patches::Cluster] } else { &args.kinds[..] };
    let patches = kinds.iter().flat_map(|kind| counts.iter().map(move |&count| (kind.kind(), count as usize)));
    for scene in scenes {
        for patches in patches.clone() {
            measure(common, args, scene, patches, device.as_deref_mut(), &mut builds, &mut rows)?;
            output::write_text(&out.join("summary.json"), &results(&builds, &rows))?;
            output::write_text(&out.join("report.html"), &report(&machine, &builds, &rows))?;
        }
    }
    if common.json {
        say!("{}", results(&builds, &rows));
    } else {
        say!("{}\n", machine_line(&machine));
        builds.iter().for_each(|build| say!("{}\n", build_line(build)));
        [Some(table(&rows)), blocks::table(&rows)].iter().flatten().for_each(|table| say!("{}", table.markdown()));
        say!("{} shows the same", out.join("report.html").display());
    }
    Ok(())
}

/// The Vulkan device of the options; without options any that speaks Vulkan, software too.
fn vulkan_device(common: &Common) -> Result<Option<Box<dyn Executor>>, Error> {
    let choice = if common.device == "auto" { "vulkan" } else { &common.device };
    match open(&DeviceChoice::parse(choice)) {
        Ok((executor, _)) if executor.device().kind != DeviceKind::Native => Ok(Some(executor)),
        Ok(_) => Ok(None),
        Err(error) if common.device != "auto" => Err(error.into()),
        Err(error) => {
            Progress::new(common.quiet).note(&format!("{error}; products are not measured on a Vulkan device"));
            Ok(None)
        }
    }
}

fn machine_line(machine: &Machine) -> String {
    format!("{}, {} threads, reading {:.1} GB/s out of caches", machine.cpu, machine.threads, machine.stream_gb_s)
}

fn build_line(build: &Build) -> String {
    let operator = match build.operator_s {
        Some(seconds) => format!("operators of all bounces {seconds:.1} s"),
        None => "no operators of all bounces, which would not fit into memory".to_owned(),
    };
    let memory = build.peak_memory_bytes.map(|bytes| format!("; at most {:.2} GB", bytes as f64 * 1e-9));
    format!(
        "{}, {} {} patches: form factors {:.1} s, {operator}; of a change of light a bounce leaves {:.0} % to come, \
         accelerated {:.0} %: the scene's own is there to a thousandth after {} and {} bounces{}{}",
        build.scene,
        build.patches,
        build.kind,
        build.form_factors_s,
        100.0 * build.rates[0],
        100.0 * build.rates[1],
        build.bounces[0],
        build.bounces[1],
        memory.unwrap_or_default(),
        build.receivers.as_ref().map(|rows| format!("; {}", rows.line())).unwrap_or_default()
    )
}

/// The table, and curves of bytes and of time over the error.
fn report(machine: &Machine, builds: &[Build], rows: &[Row]) -> String {
    let curve = |title: &str, unit: &str, value: &dyn Fn(&Row) -> f64| Plot {
        title: title.to_owned(),
        unit: unit.to_owned(),
        x: "error of irradiance, worst light, %".to_owned(),
        logarithmic: true,
        series: builds
            .iter()
            .flat_map(|build| [(build, "F"), (build, "T"), (build, "F_r")])
            .map(|(build, operator)| {
                let own = |row: &&Row| {
                    row.patch_set() == (&build.scene, build.kind, build.patches)
                        && row.operator == operator
                        && row.epsilon.is_some()
                };
                let mut points: Vec<_> =
                    rows.iter().filter(own).map(|row| (100.0 * row.worst_light(), value(row))).collect();
                points.sort_by(|a, b| a.0.total_cmp(&b.0));
                Series { name: format!("{} {} {}, {operator}", build.scene, build.patches, build.kind), points }
            })
            .filter(|series| !series.points.is_empty())
            .collect(),
    };
    let section = Section {
        title: "Compressed operators".to_owned(),
        text: builds.iter().map(build_line).collect(),

        tables: std::iter::once(table(rows)).chain(blocks::table(rows)).collect(),
        plots: vec![
            curve("Bytes that a file needs, over the error", "MB a channel", &Row::channel_mb),
            curve("Time of a product of three channels, over the error", "ms", &|row| row.median_ms),
        ],
        ..Section::default()
    };
    let introduction = [
        machine_line(machine),
        "F are form factors, of one channel; T the light of all bounces, of three; F_r form factors from receivers to \
         patches. Errors are those of irradiance (L2 by area), of the scene's own light and the worst of eight \
         compact lights, against the same operator without compression; Frobenius is the error of the entries, for \
         which ε was asked."
            .to_owned(),
    ];
    page("Patchlight: operators", &introduction, [&section])
}

impl Row {
    /// Whose light it is: the scene, what the patches are, and how many.
    fn patch_set(&self) -> (&str, &str, usize) {
        (&self.scene, self.kind, self.patches)
    }

    /// Relative error of irradiance, the greatest of all lights.
    fn worst_light(&self) -> f64 {
        self.own_light.max(self.compact_lights)
    }

    fn channel_mb(&self) -> f64 {
        self.stored_bytes as f64 * 1e-6 / if self.operator == "T" { 3.0 } else { 1.0 }
    }
}

fn table(rows: &[Row]) -> Table {
    let head = [
        "scene",
        "operator",
        "stored as",
        "patches",
        "ε %",
        "MB a channel",
        "MB read",
        "Frobenius %",
        "own light %",
        "compact lights %",
        "product ms",
        "floor ms",
        "on the device ms",
        "compress s",
    ];
    let line = |row: &Row| {
        let percent = |x: f64| format!("{:.2}", 100.0 * x);
        vec![
            row.scene.clone(),
            row.operator.to_owned(),
            row.method.to_owned(),
            format!("{} {}", row.patches, row.kind) + &row.receivers.map(|to| format!(" to {to}")).unwrap_or_default(),
            row.epsilon.map(percent).unwrap_or_default(),
            format!("{:.2}", row.channel_mb()),
            format!("{:.2}", row.bytes as f64 * 1e-6),
            percent(row.frobenius),
            percent(row.own_light),
            percent(row.compact_lights),
            format!("{:.3}", row.median_ms),
            format!("{:.3}", row.floor_ms),
            row.device_ms.map(|ms| format!("{ms:.2}")).unwrap_or_default(),
            row.compress_s.map(|s| format!("{s:.1}")).unwrap_or_default(),
        ]
    };
    let caption =
        "Bytes, errors and times of products; the floor is the time in which the machine reads the bytes.".to_owned();
    Table { caption, head: head.map(str::to_owned).to_vec(), rows: rows.iter().map(line).collect() }
}

fn measure(
    common: &Common,
    args: &Bench,
    name: &str,
    (kind, count): (PatchKind, usize),
    mut device: Option<&mut (dyn Executor + 'static)>,
    builds: &mut Vec<Build>,
    rows: &mut Vec<Row>,
) -> Result<(), Error> {
    let progress = &Progress::new(common.quiet);
    let loaded = output::import_flat(name, progress)?;
    let scene = &loaded.scene;
    let estimator = Estimator::Hemisphere { rays: args.rays };
    let settings = BakeSettings::default().with_patches(kind).with_patch_count(count);
    let settings = settings.with_estimator(estimator).with_seed(common.seed);
    let mesh = &progress.phase("sample", |_| make_mesh(scene, &settings))?;
    let start = Instant::now();
    let found = progress
        .phase("form_factors", |report| FormFactors::estimate(scene, mesh, estimator, settings.seed, report))?;
    let form_factors_s = start.elapsed().as_secs_f64();
    let factors = SymmetricFactors::new(mesh, &found.factors)?;
    drop(found);
    let start = Instant::now();
    let operators = all_bounces(&factors, mesh, progress)?;
    let operator_s = operators.is_some().then(|| start.elapsed().as_secs_f64());
    let mut subject = Subject {
        scene_name: &loaded.name,
        kind,
        mesh,
        factors: &factors,
        operators: operators.as_ref(),
        truths: Vec::new(),
        seed: common.seed,
        progress,
    };

    // The scene's own light, then compact ones.
    let own = own_light(scene, mesh, settings.sample_rays, settings.seed);
    let both = accelerations(&mesh.albedo, &factors.factors)?;
    let bounces = subject.settling_bounces(&own, &both)?;
    subject.add_truths(std::iter::once(own).chain(compact_lights(mesh, common.seed)))?;

    subject.add_rows(args, device.as_deref_mut(), rows)?;
    let receivers = match args.receivers {
        0 => None,
        _ => Receivers { scene, subject: &subject, common, args }.measure(device, rows)?,
    };
    builds.push(Build {
        scene: loaded.name.clone(),
        kind: kind.name(),
        patches: mesh.patches.len(),
        form_factors_s,
        operator_s,
        rates: both.map(|acceleration| acceleration.rate),
        bounces,
        receivers,
        peak_memory_bytes: peak_memory_bytes(),
    });
    Ok(())
}

fn make_mesh(scene: &Scene, settings: &BakeSettings) -> Result<PatchMesh, Error> {
    let made = MeshSettings {
        kind: settings.patches,
        count: settings.patch_count,
        voxel_size: None,
        samples: settings.samples,
        seed: settings.seed,
    };
    let sampler = lit_sampler(scene, settings.patch_count, Density::default(), settings.seed)?;
    Ok(PatchMesh::new(scene, sampler.as_ref(), &made)?)
}

/// The operators of all bounces for red, green and blue, unless they do not fit into memory.
fn all_bounces(
    factors: &SymmetricFactors,
    mesh: &PatchMesh,
    progress: &Progress,
) -> Result<Option<[Mat<f32>; 3]>, Error> {
    // One more for the dense product.
    match check_memory(mesh.patches.len(), MATRICES + 1, "feedback") {
        Ok(()) => Ok(Some(factors.bounces(&mesh.albedo, None, progress)?)),
        Err(error) => {
            progress.warn(&format!("{error}; without it"));
            Ok(None)
        }
    }
}

/// The patches of a scene, their operators, and lights to measure them with.
struct Subject<'a> {
    scene_name: &'a str,
    kind: PatchKind,
    mesh: &'a PatchMesh,
    factors: &'a SymmetricFactors,
    /// Operators of all bounces, where they fit into memory.
    operators: Option<&'a [Mat<f32>; 3]>,
    /// The scene's own light first.
    truths: Vec<Truth>,
    seed: u32,
    progress: &'a Progress,
}

impl<'a> Subject<'a> {
    fn patches(&self) -> usize {
        self.mesh.patches.len()
    }

    /// The scene's own light, W/m².
    fn own(&self) -> &[Vec4] {
        &self.truths[0].source
    }

    /// The form factors, and the operator of all bounces where there is one.
    fn channels(&self) -> Vec<(&'static str, Channels<'a>)> {
        let mut channels = vec![("F", self.factors.channels())];
        channels.extend(self.all_channels().map(|all| ("T", all)));
        channels
    }

    fn all_channels(&self) -> Option<Channels<'a>> {
        self.operators.map(|operators| Channels::Three(operators.each_ref()))
    }

    /// Bounces until a thousandth of the scene's own light is left to come.
    fn settling_bounces(&self, own: &[Vec4], both: &[Acceleration; 2]) -> Result<[usize; 2], Error> {
        let factors = &self.factors.factors;
        let settling = Settling { share: 1e-3, albedo: &self.mesh.albedo, source: own, factors };
        Ok(settling.bounces(*both)?)
    }

    /// Finds what lights give without compression.
    fn add_truths(&mut self, sources: impl Iterator<Item = Vec<Vec4>>) -> Result<(), Error> {
        for source in sources {
            let mut direct = vec![Vec4::ZERO; self.patches()];
            self.factors.factors.apply(&source, &mut direct)?;
            let all = self.all_channels().map(|channels| exact_product(channels, &self.factors.area, &source));
            self.truths.push(Truth { source, direct, all });
        }
        Ok(())
    }

    /// A row of these bytes and milliseconds, without errors.
    fn row(&self, operator: &'static str, method: &'static str, bytes: u64, median_ms: f64) -> Row {
        Row {
            scene: self.scene_name.to_owned(),
            kind: self.kind.name(),
            operator,
            method,
            patches: self.patches(),
            receivers: None,
            epsilon: None,
            bytes,
            stored_bytes: bytes,
            frobenius: 0.0,
            own_light: 0.0,
            compact_lights: 0.0,
            median_ms,
            floor_ms: bytes as f64 * 1e-6 / stream_gb_s((bytes as usize).max(1 << 20), ROUNDS),
            device_ms: None,
            compress_s: None,
            blocks: None,
        }
    }

    /// The rows of operators from patch to patch.
    fn add_rows(
        &self,
        args: &Bench,
        mut device: Option<&mut (dyn Executor + 'static)>,
        rows: &mut Vec<Row>,
    ) -> Result<(), Error> {
        self.add_exact(rows)?;
        let codecs: Vec<_> = args.codecs.iter().filter_map(|codec| Blocks::codec(*codec)).collect();
        rows.extend(blocks::measure(self, &codecs, device.as_deref_mut())?);
        for &epsilon in &args.epsilons {
            for (operator, channels) in self.channels() {
                rows.push(self.low_rank(operator, channels, epsilon, device.as_deref_mut())?);
            }
        }
        Ok(())
    }

    /// Rows without compression: a sparse product, three bounces of classic radiosity, dense
    /// products.
    fn add_exact(&self, rows: &mut Vec<Row>) -> Result<(), Error> {
        let sparse = &self.factors.factors;
        let bytes = (size_of_val(&sparse.row_start[..]) + 8 * sparse.values.len()) as u64;
        let n = self.patches();
        let mut irradiance = vec![Vec4::ZERO; n];
        let once = median_ms(|| Ok(sparse.apply(self.own(), &mut irradiance)?))?;
        rows.push(self.row("F", "sparse rows", bytes, once));
        let bounces = median_ms(|| {
            jacobi(sparse, self.own(), &self.mesh.albedo, Stop::Bounces(BOUNCES))?;
            Ok(())
        })?;
        rows.push(self.row("F", "three bounces", bytes, bounces));
        if let Some(operators) = self.operators {
            // Symmetric: its columns are its rows.
            let values = (0..n).flat_map(|j| operators[1].col(j).iter().copied()).collect();
            let dense = Dense::new(n, n, values)?;
            let time = median_ms(|| Ok(dense.apply(self.own(), &mut irradiance)?))?;
            rows.push(self.row("T", "dense f32, three products", 12 * (n * n) as u64, 3.0 * time));
        }
        Ok(())
    }

    /// The row of an operator of low rank.
    fn low_rank(
        &self,
        operator: &'static str,
        channels: Channels,
        epsilon: f64,
        device: Option<&mut (dyn Executor + 'static)>,
    ) -> Result<Row, Error> {
        let SymmetricFactors { area, order, .. } = self.factors;
        let start = Instant::now();
        let source = TileSource::Symmetric { channels, patches: TileSide { area, order } };
        let tiles = self.progress.phase("compress", |report| LowRank::encode(source, epsilon, &report))?;
        let seconds = start.elapsed().as_secs_f64();
        let mut irradiance = vec![Vec4::ZERO; self.patches()];
        let mut errors = Vec::with_capacity(self.truths.len());
        for truth in &self.truths {
            tiles.apply(&truth.source, &mut irradiance)?;
            let exact = truth.all.as_ref().filter(|_| operator == "T").unwrap_or(&truth.direct);
            errors.push(relative_error(&irradiance, exact, area));
        }
        let mut workspace = LowRankWorkspace::default();
        let time = median_ms(|| Ok(tiles.apply_in(&mut workspace, self.own(), &mut irradiance)?))?;
        let mut row = Row {
            epsilon: Some(epsilon),
            stored_bytes: tiles.stored_bytes(),
            frobenius: greatest(&tiles.report.error),
            own_light: errors[0],
            compact_lights: greatest(&errors[1..]),
            compress_s: Some(seconds),
            ..self.row(operator, "low_rank", tiles.bytes(), time)
        };
        if let Some(device) = device {
            let stored = PatchOperator::LowRank(Arc::new(tiles));
            row.device_ms = Some(product_ms(device, &stored, self.own(), DEVICE_ROUNDS, Decoder::Kernel)?);
        }
        Ok(row)
    }
}

/// Median of the times of so many products of an operator on a device, ms.
fn product_ms(
    device: &mut (dyn Executor + 'static),
    operator: &PatchOperator,
    light: &[Vec4],
    rounds: usize,
    decoder: Decoder,
) -> Result<f64, Error> {
    let n = operator.patches();
    let range = device.device().max_storage_buffer_range;
    let product =
        Product::load(device, n, n, range, &|plan, tables| operator.add_tables(plan, tables, range, decoder))?;
    Ok(product.run(device, light, rounds)?.1)
}

fn greatest(errors: &[f64]) -> f64 {
    errors.iter().copied().fold(0.0, f64::max)
}

fn median_ms(mut work: impl FnMut() -> Result<(), Error>) -> Result<f64, Error> {
    let mut times = Vec::with_capacity(ROUNDS);
    for _ in 0..ROUNDS {
        let start = Instant::now();
        work()?;
        times.push(1e3 * start.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    Ok(times[ROUNDS / 2])
}
