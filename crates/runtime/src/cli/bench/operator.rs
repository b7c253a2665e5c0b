//! `bench operator`: how large and how fast the light between patches is, over the error of its compression.

use std::time::Instant;

use faer::Mat;
use formfactor::{Operator, Stop, jacobi};
use glam::Vec4;
use multibounce::{Channels, Tiles};
use scene::sampling::{hash3, unit};
use serde::Serialize;

use super::{Machine, SCENES, stream_gb_s};
use crate::cli::args::{Bench, Common};
use crate::cli::output;
use crate::cli::report::Table;
use crate::error::Error;
use crate::import::load_or_build;
use crate::progress::Progress;
use crate::render::classic::{ClassicSettings, Estimator, direct_params, exchange};
use crate::render::operator::{Between, MATRICES, check_memory};
use crate::render::senders::{SenderSettings, Senders, lit_sampler};

/// Patches of a scene, unless it is said.
const COUNT: u32 = 10_000;
/// Compact lights, and the share of the patches that each lights.
const LIGHTS: u32 = 8;
const LIT_SHARE: usize = 50;
/// What a turn of the normal counts beside a distance when patches of a light are chosen, m.
const TURN: f32 = 2.0;
/// Products whose times give the median.
const TURNS: usize = 41;
/// Bounces of classic radiosity that one product is compared with.
const BOUNCES: u32 = 3;

/// A measurement.
#[derive(Serialize)]
struct Row {
    scene: String,
    /// `F`, or `T` of all bounces.
    operator: &'static str,
    /// How it is stored.
    method: &'static str,
    patches: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    epsilon: Option<f64>,
    /// Bytes that a product reads, all channels.
    bytes: u64,
    /// Bytes of a file of it.
    stored_bytes: u64,
    /// Relative Frobenius error, the greatest of the channels.
    frobenius: f64,
    /// Relative error of irradiance (L2 by area): of the scene's light, the greatest of the compact lights.
    own_light: f64,
    compact_lights: f64,
    median_ms: f64,
    /// Time in which the machine reads as many bytes.
    floor_ms: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    compress_s: Option<f64>,
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    machine: &'a Machine,
    seed: u32,
    rows: &'a [Row],
}

/// A light and what it gives without compression.
struct Truth {
    source: Vec<Vec4>,
    direct: Vec<Vec4>,
    all: Vec<Vec4>,
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let out = output::folder_or(&common.out, "bench-operator");
    output::make_folder(&out)?;
    let machine = Machine::find(common)?;
    let scenes: Vec<&str> =
        if args.scenes.is_empty() { SCENES.to_vec() } else { args.scenes.iter().map(String::as_str).collect() };
    let counts = if args.counts.is_empty() { vec![COUNT] } else { args.counts.clone() };
    let mut rows = Vec::new();
    for scene in scenes {
        for &count in &counts {
            measure(common, args, scene, count as usize, &mut rows)?;
            let results = Results { name: "operator", machine: &machine, seed: common.seed, rows: &rows };
            output::write_text(&out.join("summary.json"), &output::json(&results))?;
        }
    }
    if common.json {
        println!("{}", output::json(&Results { name: "operator", machine: &machine, seed: common.seed, rows: &rows }));
    } else {
        println!(
            "{}, {} threads, reading {:.1} GB/s out of caches\n",
            machine.cpu, machine.threads, machine.stream_gb_s
        );
        println!("{}", table(&rows).markdown());
        println!("{} holds the same", out.join("summary.json").display());
    }
    Ok(())
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
        "compress s",
    ];
    let line = |row: &Row| {
        let percent = |x: f64| format!("{:.2}", 100.0 * x);
        vec![
            row.scene.clone(),
            row.operator.to_owned(),
            row.method.to_owned(),
            row.patches.to_string(),
            row.epsilon.map(percent).unwrap_or_default(),
            format!("{:.2}", row.stored_bytes as f64 * 1e-6 / if row.operator == "T" { 3.0 } else { 1.0 }),
            format!("{:.2}", row.bytes as f64 * 1e-6),
            percent(row.frobenius),
            percent(row.own_light),
            percent(row.compact_lights),
            format!("{:.3}", row.median_ms),
            format!("{:.3}", row.floor_ms),
            row.compress_s.map(|s| format!("{s:.1}")).unwrap_or_default(),
        ]
    };
    let caption = String::new();
    Table { caption, head: head.map(str::to_owned).to_vec(), rows: rows.iter().map(line).collect() }
}

fn measure(common: &Common, args: &Bench, name: &str, count: usize, rows: &mut Vec<Row>) -> Result<(), Error> {
    let mut progress = Progress::new(common.quiet);
    let loaded = progress.phase("import", |_| load_or_build(name))?;
    loaded.warnings.iter().for_each(|line| progress.warn(line));
    let scene = &loaded.scene;
    let settings = ClassicSettings {
        patch_count: count,
        estimator: Estimator::Hemisphere { rays: args.rays },
        seed: common.seed,
        ..ClassicSettings::default()
    };
    let senders = progress.phase("sample", |_| -> Result<_, Error> {
        let sampler = lit_sampler(scene, count, common.seed)?;
        let kind = settings.patches;
        let made = SenderSettings { kind, count, voxel_size: None, samples: settings.samples, seed: common.seed };
        Senders::new(scene, sampler.as_ref(), &made)
    })?;
    let found = progress.phase("form_factors", |report| exchange(scene, &senders, &settings, report))?;
    // One more for the dense product.
    check_memory(senders.patches.len(), MATRICES + 1, "feedback")?;
    let between = Between::new(&senders, &found.factors)?;
    let operators = between.bounces(&senders.albedo, None, &mut progress)?;
    let n = senders.patches.len();

    // The scene's own light, then compact ones.
    let direct = scene::DirectParams {
        count: senders.points.len() as u32,
        area_rays: settings.sample_rays,
        sky_rays: if scene.sky.map_width == 0 { 0 } else { settings.sample_rays },
        seed: common.seed,
        ..direct_params(scene)
    };
    let mut sources = vec![senders.source(&scene.direct_irradiance(&direct, &senders.points))];
    for light in 0..LIGHTS {
        let centre = (unit(hash3(light, 0, common.seed ^ 0x6c69)) * n as f32) as usize;
        let Some(at) = senders.patches.get(centre) else { break };
        let far = |i: &u32| {
            let p = &senders.patches[*i as usize];
            p.centroid.distance(at.centroid) + TURN * p.normal.distance(at.normal)
        };
        let mut order: Vec<u32> = (0..n as u32).collect();
        order.sort_by(|a, b| far(a).total_cmp(&far(b)).then(a.cmp(b)));
        let mut source = vec![Vec4::ZERO; n];
        order.iter().take(n.div_ceil(LIT_SHARE)).for_each(|&i| source[i as usize] = Vec4::ONE.with_w(0.0));
        sources.push(source);
    }
    let truth = |source: Vec<Vec4>| -> Result<Truth, Error> {
        let mut direct = vec![Vec4::ZERO; n];
        between.factors.product(&source, &mut direct)?;
        let all = (0..3).map(|c| dense_product(&operators[c], &between.area, &source, c)).collect::<Vec<_>>();
        let all = (0..n).map(|i| Vec4::new(all[0][i], all[1][i], all[2][i], 0.0)).collect();
        Ok(Truth { source, direct, all })
    };
    let truths = sources.into_iter().map(truth).collect::<Result<Vec<_>, _>>()?;

    let row = |operator, method, bytes: u64, median_ms| Row {
        scene: loaded.name.clone(),
        operator,
        method,
        patches: n,
        epsilon: None,
        bytes,
        stored_bytes: bytes,
        frobenius: 0.0,
        own_light: 0.0,
        compact_lights: 0.0,
        median_ms,
        floor_ms: bytes as f64 * 1e-6 / stream_gb_s((bytes as usize).max(1 << 20), TURNS),
        compress_s: None,
    };
    // Classic radiosity: a sparse product a bounce.
    let csr = &between.factors;
    let csr_bytes = (size_of_val(&csr.row_start[..]) + 8 * csr.values.len()) as u64;
    let mut h = vec![Vec4::ZERO; n];
    let once = median_ms(|| Ok(csr.product(&truths[0].source, &mut h)?))?;
    rows.push(row("F", "sparse rows", csr_bytes, once));
    let bounces = median_ms(|| {
        jacobi(csr, &truths[0].source, &senders.albedo, Stop::Bounces(BOUNCES))?;
        Ok(())
    })?;
    rows.push(row("F", "three bounces", csr_bytes, bounces));
    {
        // Symmetric: its columns are its rows.
        let values = (0..n).flat_map(|j| operators[1].col(j).iter().copied()).collect();
        let dense = formfactor::Dense::new(n, n, values)?;
        let time = median_ms(|| Ok(dense.product(&truths[0].source, &mut h)?))?;
        rows.push(row("T", "dense f32, three products", 12 * (n * n) as u64, 3.0 * time));
    }
    for &epsilon in &args.epsilons {
        for (operator, channels) in [
            ("F", Channels::One(&between.symmetric)),
            ("T", Channels::Three([&operators[0], &operators[1], &operators[2]])),
        ] {
            let start = Instant::now();
            let tiles = progress.phase("compress", |report| {
                let proceed = |done, total| crate::render::proceed(report, done, total);
                Tiles::encode(channels, &between.area, &between.order, epsilon, &proceed)
            })?;
            let seconds = start.elapsed().as_secs_f64();
            let errors = truths.iter().map(|truth| {
                tiles.product(&truth.source, &mut h)?;
                let exact = if operator == "F" { &truth.direct } else { &truth.all };
                Ok(relative_error(&h, exact, &between.area))
            });
            let errors = errors.collect::<Result<Vec<f64>, Error>>()?;
            let time = median_ms(|| Ok(tiles.product(&truths[0].source, &mut h)?))?;
            let compact = errors[1..].iter().copied().fold(0.0, f64::max);
            rows.push(Row {
                epsilon: Some(epsilon),
                stored_bytes: tiles.stored_bytes(),
                frobenius: tiles.report.error.iter().copied().fold(0.0, f64::max),
                own_light: errors[0],
                compact_lights: compact,
                compress_s: Some(seconds),
                ..row(operator, "tiles", tiles.bytes().iter().map(|part| part.1).sum(), time)
            });
        }
    }
    Ok(())
}

/// One channel of the irradiance by the operator without compression.
fn dense_product(symmetric: &Mat<f32>, area: &[f32], source: &[Vec4], channel: usize) -> Vec<f32> {
    let light = faer::Col::from_fn(area.len(), |i| source[i][channel] * scene::math::sqrt(area[i]));
    let out = symmetric * &light;
    (0..area.len()).map(|i| out[i] / scene::math::sqrt(area[i])).collect()
}

/// Relative error of irradiance, L2 by area, the greatest of the channels.
fn relative_error(ours: &[Vec4], exact: &[Vec4], area: &[f32]) -> f64 {
    let error = |c: usize| {
        let (mut wrong, mut whole) = (0.0, 0.0);
        for ((h, x), a) in ours.iter().zip(exact).zip(area) {
            wrong += f64::from(*a) * f64::from(h[c] - x[c]).powi(2);
            whole += f64::from(*a) * f64::from(x[c]).powi(2);
        }
        if whole > 0.0 { (wrong / whole).sqrt() } else { 0.0 }
    };
    error(0).max(error(1)).max(error(2))
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
