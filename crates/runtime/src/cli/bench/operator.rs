//! `bench operator`: how large and how fast the light between patches is, over the error of its compression.

mod blocks;
mod receivers;

use std::time::Instant;

use formfactor::{Operator, Stop, jacobi};
use glam::Vec4;
use multibounce::{Channels, LowRank, LowRankWorkspace, TileSide, TileSource};
use serde::Serialize;

use super::{Machine, SCENES, Setup, stream_gb_s};
use crate::cli::args::{Bench, Blocks, Common, Patches};
use crate::cli::output;
use crate::cli::report::{Plot, Section, Series, Table, page};
use crate::error::Error;
use crate::executor::{DeviceChoice, DeviceKind, Executor, open};
use crate::progress::Progress;
use crate::render::classic::{ClassicSettings, Estimator, PatchKind};
use crate::render::exchange::exchange;
use crate::render::frame::product_on_device;
use crate::render::operator::measure::{bounces_until, compact_lights, exact_product, own_light, relative_error};
use crate::render::operator::{Between, MATRICES, PatchOperator, accelerations, check_memory};
use crate::render::senders::{SenderSettings, Senders, lit_sampler};
use crate::summary::peak_memory_bytes;
use receivers::{ReceiverRows, Receivers};

/// Patches of a scene, unless it is said.
const COUNT: u32 = 10_000;
/// Products whose times give the median.
const TURNS: usize = 41;
/// The same on a device.
const DEVICE_TURNS: usize = 11;
/// Bounces of classic radiosity that one product is compared with.
const BOUNCES: u32 = 3;

/// A measurement.
#[derive(Serialize)]
struct Row {
    scene: String,
    /// What the patches are.
    kind: &'static str,
    /// `F`, `T` of all bounces, or `F_r` from the patches to receivers.
    operator: &'static str,
    /// How it is stored.
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

/// What a scene took before its operators were compressed.
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
    /// Where T is known.
    all: Option<Vec<Vec4>>,
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, "operator", &SCENES, &[COUNT])?;
    let (mut builds, mut rows) = (Vec::new(), Vec::new());
    // Any device that speaks Vulkan, software too.
    let choice = if common.device == "auto" { "vulkan" } else { &common.device };
    let mut device = match open(&DeviceChoice::parse(choice)) {
        Ok((executor, _)) if executor.device().kind != DeviceKind::Native => Some(executor),
        Ok(_) => None,
        Err(error) if common.device != "auto" => return Err(error.into()),
        Err(error) => {
            Progress::new(common.quiet).note(&format!("{error}; products are not measured on a Vulkan device"));
            None
        }
    };
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
        println!("{}", results(&builds, &rows));
    } else {
        println!("{}\n", machine_line(&machine));
        builds.iter().for_each(|build| println!("{}\n", build_line(build)));
        [Some(table(&rows)), blocks::table(&rows)].iter().flatten().for_each(|table| println!("{}", table.markdown()));
        println!("{} shows the same", out.join("report.html").display());
    }
    Ok(())
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
        "{}, {} {} patches: form factors {:.1} s, {operator}; of a change of light a bounce leaves {:.0} % to come, accelerated \
         {:.0} %: the scene's own is there to a thousandth after {} and {} bounces{}{}",
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
                    row.senders() == (&build.scene, build.kind, build.patches)
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
        figures: Vec::new(),
        strip: Vec::new(),
        tables: std::iter::once(table(rows)).chain(blocks::table(rows)).collect(),
        plots: vec![
            curve("Bytes that a file needs, over the error", "MB a channel", &Row::channel_mb),
            curve("Time of a product of three channels, over the error", "ms", &|row| row.median_ms),
        ],
    };
    let introduction = [
        machine_line(machine),
        "F are form factors, of one channel; T the light of all bounces, of three; F_r form factors from receivers to patches. Errors are those of irradiance (L2 by \
         area), of the scene's own light and the worst of eight compact lights, against the same operator without \
         compression; Frobenius is the error of the entries, for which ε was asked."
            .to_owned(),
    ];
    page("Patchlight: operators", &introduction, [&section])
}

impl Row {
    /// Whose light it is: the scene, what the patches are, and how many.
    fn senders(&self) -> (&str, &str, usize) {
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
    let mut progress = Progress::new(common.quiet);
    let loaded = output::import(name, &mut progress)?;
    let scene = &loaded.scene;
    let settings = ClassicSettings {
        patches: kind,
        patch_count: count,
        estimator: Estimator::Hemisphere { rays: args.rays },
        seed: common.seed,
        ..ClassicSettings::default()
    };
    let senders = progress.phase("sample", |_| -> Result<_, Error> {
        let sampler = lit_sampler(scene, count, common.seed)?;
        let made = SenderSettings { kind, count, voxel_size: None, samples: settings.samples, seed: common.seed };
        Senders::new(scene, sampler.as_ref(), &made)
    })?;
    let start = Instant::now();
    let found = progress.phase("form_factors", |report| exchange(scene, &senders, &settings, report))?;
    let form_factors_s = start.elapsed().as_secs_f64();
    let between = Between::new(&senders, &found.factors)?;
    let n = senders.patches.len();
    let start = Instant::now();
    // One more for the dense product.
    let operators = match check_memory(n, MATRICES + 1, "feedback") {
        Ok(()) => Some(between.bounces(&senders.albedo, None, &mut progress)?),
        Err(error) => {
            progress.warn(&format!("{error}; without it"));
            None
        }
    };
    let operator_s = operators.is_some().then(|| start.elapsed().as_secs_f64());
    let product = |light: &[Vec4], out: &mut [Vec4]| Ok(between.factors.apply(light, out)?);
    let both = accelerations(&senders.albedo, &between.factors)?;

    // The scene's own light, then compact ones.
    let mut sources = vec![own_light(scene, &senders, &settings)];
    let until = bounces_until(1e-3, &senders.albedo, &sources[0], both, &product)?;
    sources.extend(compact_lights(&senders, common.seed));
    let truth = |source: Vec<Vec4>| -> Result<Truth, Error> {
        let mut direct = vec![Vec4::ZERO; n];
        between.factors.apply(&source, &mut direct)?;
        let all =
            operators.as_ref().map(|three| exact_product(Channels::Three(three.each_ref()), &between.area, &source));
        Ok(Truth { source, direct, all })
    };
    let truths = sources.into_iter().map(truth).collect::<Result<Vec<_>, _>>()?;

    let row = |operator, method, bytes: u64, median_ms| Row {
        scene: loaded.name.clone(),
        kind: kind.name(),
        operator,
        method,
        patches: n,
        receivers: None,
        epsilon: None,
        bytes,
        stored_bytes: bytes,
        frobenius: 0.0,
        own_light: 0.0,
        compact_lights: 0.0,
        median_ms,
        floor_ms: bytes as f64 * 1e-6 / stream_gb_s((bytes as usize).max(1 << 20), TURNS),
        device_ms: None,
        compress_s: None,
        blocks: None,
    };
    // Classic radiosity: a sparse product a bounce.
    let csr = &between.factors;
    let csr_bytes = (size_of_val(&csr.row_start[..]) + 8 * csr.values.len()) as u64;
    let mut h = vec![Vec4::ZERO; n];
    let once = median_ms(|| Ok(csr.apply(&truths[0].source, &mut h)?))?;
    rows.push(row("F", "sparse rows", csr_bytes, once));
    let bounces = median_ms(|| {
        jacobi(csr, &truths[0].source, &senders.albedo, Stop::Bounces(BOUNCES))?;
        Ok(())
    })?;
    rows.push(row("F", "three bounces", csr_bytes, bounces));
    if let Some(operators) = &operators {
        // Symmetric: its columns are its rows.
        let values = (0..n).flat_map(|j| operators[1].col(j).iter().copied()).collect();
        let dense = formfactor::Dense::new(n, n, values)?;
        let time = median_ms(|| Ok(dense.apply(&truths[0].source, &mut h)?))?;
        rows.push(row("T", "dense f32, three products", 12 * (n * n) as u64, 3.0 * time));
    }
    if let Some(operators) = &operators {
        let codecs: Vec<_> = args.codecs.iter().filter_map(|codec| Blocks::codec(*codec)).collect();
        let source = blocks::Source { between: &between, operators, truths: &truths, row: &row, seed: common.seed };
        rows.extend(blocks::measure(&source, &codecs, device.as_deref_mut(), &mut progress)?);
    }
    for &epsilon in &args.epsilons {
        let all = operators.as_ref().map(|three| ("T", Channels::Three(three.each_ref())));
        for (operator, channels) in [("F", between.channels())].into_iter().chain(all) {
            let start = Instant::now();
            let tiles = progress.phase("compress", |report| {
                let proceed = |done, total| crate::render::proceed(report, done, total);
                {
                    let patches = TileSide { area: &between.area, order: &between.order };
                    LowRank::encode(TileSource::Symmetric { channels, patches }, epsilon, &proceed)
                }
            })?;
            let seconds = start.elapsed().as_secs_f64();
            let errors = truths.iter().map(|truth| {
                tiles.apply(&truth.source, &mut h)?;
                let exact = truth.all.as_ref().filter(|_| operator == "T").unwrap_or(&truth.direct);
                Ok(relative_error(&h, exact, &between.area))
            });
            let errors = errors.collect::<Result<Vec<f64>, Error>>()?;
            let mut room = LowRankWorkspace::default();
            let time = median_ms(|| Ok(tiles.apply_in(&mut room, &truths[0].source, &mut h)?))?;
            let compact = errors[1..].iter().copied().fold(0.0, f64::max);
            let read = tiles.bytes();
            let mut measured = Row {
                epsilon: Some(epsilon),
                stored_bytes: tiles.stored_bytes(),
                frobenius: tiles.report.error.iter().copied().fold(0.0, f64::max),
                own_light: errors[0],
                compact_lights: compact,
                compress_s: Some(seconds),
                ..row(operator, "tiles", read, time)
            };
            if let Some(device) = device.as_deref_mut() {
                let (tiles, source) = (PatchOperator::Tiles(Box::new(tiles)), &truths[0].source);
                measured.device_ms = Some(product_on_device(device, &tiles, source, DEVICE_TURNS)?.1);
            }
            rows.push(measured);
        }
    }
    let receivers = match args.receivers {
        0 => None,
        _ => {
            let sources = truths.iter().map(|truth| &truth.source[..]).collect();
            let what = Receivers { scene, senders: &senders, between: &between, sources };
            what.measure((common, args), &row, device, rows, &mut progress)?
        }
    };
    builds.push(Build {
        scene: loaded.name.clone(),
        kind: kind.name(),
        patches: n,
        form_factors_s,
        operator_s,
        rates: both.map(|acceleration| acceleration.rate),
        bounces: until,
        receivers,
        peak_memory_bytes: peak_memory_bytes(),
    });
    Ok(())
}

fn median_ms(mut work: impl FnMut() -> Result<(), Error>) -> Result<f64, Error> {
    let mut times = Vec::with_capacity(TURNS);
    for _ in 0..TURNS {
        let start = Instant::now();
        work()?;
        times.push(1e3 * start.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    Ok(times[TURNS / 2])
}
