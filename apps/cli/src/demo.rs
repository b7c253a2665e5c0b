//! The demo: the built-in Cornell box and atrium, every method against path tracing, a light that moves.

use reference::PictureFile as _;
use std::collections::BTreeMap;
use std::path::Path;

use reference::PictureErrors;
use reference::metrics::difference_picture;
use reference::path::PathSettings;
use scene::Light;
use temporal::Settings;

use assets::import::{Animation, LoadedScene, View};
use assets::procedural;
use experiments::Error;
use experiments::args::Common;
use experiments::errors::picture_errors;
use experiments::output;
use experiments::output::write_pictures;
use experiments::path;
use experiments::progress::{Progress, is_cancelled};
use experiments::report::{Figure, Plot, Section, Series, Table, page, significant};
use experiments::sequence::frame_time;
use experiments::summary::{PassTimes, PhotonCounts, Summary};
use patchlight::memory::peak_memory_bytes;
use patchlight::render::Pictures;
use patchlight::render::classic::{Bake, ClassicSettings, Estimator, PatchKind};
use patchlight::render::decode::Decoder;
use patchlight::render::firstshot::FirstShotSettings;
use patchlight::render::local::LocalOptions;
use patchlight::render::operator::{Codec, Feedback, Transport};
use patchlight::render::temporal::{RowKind, Sampled, Temporal};
use runtime::executor::{DeviceChoice, open};

/// How much the demo does.
struct Effort {
    size: (u32, u32),
    frames: u32,
    /// Frames that are path traced as well.
    checked: u32,
    paths: u32,
    patches: usize,
    rays: u32,
}

const FULL: Effort = Effort { size: (480, 360), frames: 24, checked: 4, paths: 48, patches: 4000, rays: 1024 };
const FAST: Effort = Effort { size: (160, 120), frames: 3, checked: 1, paths: 8, patches: 400, rays: 256 };

/// Relative error of the compressed operators.
const EPSILON: f64 = 0.02;

const FEEDBACK: Feedback = Feedback { epsilon: EPSILON, products: 1, accelerated: true };
/// Relative error of the patches' irradiance by photons.
const PHOTON_ERROR: f64 = 0.05;

/// A method that the demo shows.
struct Method {
    name: &'static str,
    title: &'static str,
    transport: Transport,
}

const METHODS: [Method; 6] = [
    Method { name: "classic", title: "Classic radiosity", transport: Transport::Classic },
    Method {
        name: "tiles",
        title: "Operator in tiles",
        transport: Transport::Operator(Codec::Tiles { epsilon: EPSILON }),
    },
    Method { name: "feedback", title: "Feedback", transport: Transport::Feedback(FEEDBACK) },
    Method { name: "temporal", title: "Temporal", transport: Transport::Temporal(TEMPORAL) },
    Method { name: "local", title: "Local matrix", transport: Transport::Local(LOCAL) },
    Method {
        name: "firstshot",
        title: "First shot",
        transport: Transport::FirstShot(FirstShotSettings { error: PHOTON_ERROR, most_photons: 1 << 24 }),
    },
];

/// Fewer slots than patches, so that far ones are merged.
const LOCAL: LocalOptions = LocalOptions { slots: 1024, ..LocalOptions::DEFAULT };

const TEMPORAL: Temporal = Temporal { settings: Settings::DEFAULT, rows: RowKind::Lists, sampled: Sampled::Patches };

/// What one scene gave.
struct Outcome {
    /// One a method.
    summaries: Vec<Summary>,
    section: Section,
}

/// Milliseconds of each pass, frame by frame.
type Times = Vec<(String, Vec<f64>)>;

/// A checked frame, errors of all and of indirect light.
type Errors = (u32, PictureErrors, PictureErrors);

/// What a method gave.
struct Run {
    times: Times,
    errors: Vec<Errors>,
    /// The last of these.
    pictures: Option<Pictures>,
    /// Seconds before the first frame that other methods do not need.
    phases: Vec<(String, f64)>,
    summary: Summary,
}

/// A frame that is path traced.
struct Checked {
    frame: u32,
    traced: Pictures,
}

pub fn run(common: &Common, fast: bool) -> Result<(), Error> {
    let effort = if fast { FAST } else { FULL };
    let out = common.out.clone().unwrap_or_else(|| "out".into());
    output::make_folder(&out)?;
    let mut outcomes = Vec::new();
    let mut device = String::new();
    for name in ["cornell", "atrium"] {
        let progress = Progress::new(common.quiet);
        progress.note(&format!("{name}:"));
        let loaded = progress.phase("import", |_| procedural::build(name))?;
        let outcome = one_scene(common, &effort, &loaded, &out.join(name), &progress)?;
        device = outcome.summaries.first().map(|summary| summary.device.clone()).unwrap_or_default();
        outcomes.push(outcome);
    }
    let introduction = [
        format!(
            "Diffuse global illumination on {device}, beside path tracing of the same frames. Lights move over {} frames; \
             form factors are computed once.",
            effort.frames
        ),
        format!(
            "Classic radiosity multiplies by the form factors for each bounce. The operator of all bounces does it in one \
             product; it is stored in tiles with an error of {:.0} %. Feedback takes one product a frame with form factors \
             stored alike, from the light of the frame before; temporal radiosity does it with {} samples a row of what has \
             changed. The local matrix multiplies once by the operator of {} patches, fine ones near the camera, merged ones far \
             off. First shot traces photons from where lights fall first until the irradiance of the patches has an error \
             of {:.0} %. All share senders, form factors and receivers.",
            100.0 * EPSILON,
            TEMPORAL.settings.samples,
            LOCAL.slots,
            100.0 * PHOTON_ERROR
        ),
        "Errors are those of 8 × 8 block means of luminance against the path tracer, whose own noise they include; \
         pictures of indirect light are exposed by 0.18 over the log-average of the reference."
            .to_owned(),
    ];
    let summaries: Vec<_> = outcomes.iter().flat_map(|o| o.summaries.clone()).collect();
    let sections: Vec<_> = outcomes.into_iter().map(|o| o.section).collect();
    let report = out.join("report.html");
    output::write_text(&report, &page("Patchlight: demo", &introduction, &sections))?;
    let text = output::json(&summaries);
    output::write_text(&out.join("summary.json"), &text)?;
    if common.json {
        println!("{text}");
    } else {
        println!("{} and the pictures beside it show what was rendered on {device}", report.display());
    }
    Ok(())
}

fn one_scene(
    common: &Common,
    effort: &Effort,
    loaded: &LoadedScene,
    out: &Path,
    progress: &Progress,
) -> Result<Outcome, Error> {
    output::make_folder(out)?;
    let settings = ClassicSettings {
        patches: PatchKind::suited(loaded.scene.geometry.triangles.len(), effort.patches),
        patch_count: effort.patches,
        estimator: Estimator::Hemisphere { rays: effort.rays },
        receiver_rays: effort.rays / 2,
        sub_frames: 6,
        seed: common.seed,
        size: effort.size,
        ..ClassicSettings::default()
    };
    let bake = Bake::new(&loaded.scene, loaded.view.eye, settings, progress)?;
    let animation = Animation::or_default_path(loaded);
    let mut checked = Vec::new();
    for frame in (0..effort.frames).filter(|&frame| effort.is_checked(frame)) {
        let (lights, view) = animation.at(frame_time(&animation, frame, effort.frames));
        checked.push(Checked { frame, traced: trace(common, effort, loaded, (&lights, &view), progress)? });
    }
    let mut runs = Vec::new();
    for method in &METHODS {
        progress.note(&format!("{}:", method.name));
        runs.push(one_method(common, effort, loaded, &bake, method, &checked, out)?);
    }
    let [classic, ..] = &runs[..] else { return Err(Error::Cancelled) };
    let mut strip = Vec::new();
    for frame in (0..effort.frames).step_by(effort.frames.div_ceil(12) as usize) {
        strip.push(Figure::read(out, &frame_file(frame), format!("frame {frame}"))?);
    }
    let shared: Vec<(String, f64)> =
        progress.phases.iter().filter(|(name, _)| name != "path tracing").cloned().collect();
    let (all, indirect) = (|e: &Errors| e.1, |e: &Errors| e.2);
    let line = |(name, values): &(String, Vec<f64>)| Series {
        name: name.clone(),
        points: values.iter().enumerate().map(|(frame, ms)| (frame as f64, *ms)).collect(),
    };
    let bounces = |(method, run): (&Method, &Run)| {
        let (_, values) = run.times.iter().find(|(name, _)| name == "method")?;
        Some(line(&(method.name.to_owned(), values.clone())))
    };
    let plot = |title: &str, series| Plot {
        title: title.to_owned(),
        unit: "ms".into(),
        x: "frame".into(),
        logarithmic: false,
        series,
    };
    let section = Section {
        title: format!("{} ({} triangles)", loaded.name, loaded.scene.geometry.triangles.len()),
        text: vec![format!(
            "{} patches, {} receivers; picture {} × {}.",
            classic.summary.patches.unwrap_or(0),
            classic.summary.receivers.unwrap_or(0),
            effort.size.0,
            effort.size.1
        )],
        figures: compared_figures(out, &runs, checked.last(), loaded.exposure_stops)?,
        strip,
        tables: vec![
            times_table(&runs, &classic.summary.device),
            bytes_table(&runs),
            bake_table(&shared, &runs),
            error_table("All light against the path tracer", &runs, all),
            error_table("Indirect light against the path tracer", &runs, indirect),
        ],
        plots: vec![
            plot("Time of each pass, classic radiosity", classic.times.iter().map(line).collect()),
            plot("Time of the light between patches", METHODS.iter().zip(&runs).filter_map(bounces).collect()),
        ],
    };
    let summary = |run: Run| Summary { bake: shared.iter().chain(&run.phases).cloned().collect(), ..run.summary };
    Ok(Outcome { summaries: runs.into_iter().map(summary).collect(), section })
}

impl Effort {
    /// Whether a frame is path traced: some at even distances, the last one among them.
    fn is_checked(&self, frame: u32) -> bool {
        frame * self.checked / self.frames != (frame + 1) * self.checked / self.frames
    }
}

fn frame_file(frame: u32) -> String {
    format!("frame-{frame:04}.png")
}

/// All frames of the first method; of the others only the light, but for the frames that are checked.
fn one_method(
    common: &Common,
    effort: &Effort,
    loaded: &LoadedScene,
    bake: &Bake,
    method: &Method,
    checked: &[Checked],
    out: &Path,
) -> Result<Run, Error> {
    let progress = Progress::new(common.quiet);
    let (executor, note) = open(&DeviceChoice::parse(&common.device))?;
    let is_first = method.transport == Transport::Classic;
    if let Some(note) = note.filter(|_| is_first) {
        progress.note(&note);
    }
    let device = executor.device().name.clone();
    let mut loaded_bake = bake.clone().load(method.transport, executor, &progress)?;
    let phases = progress.phases.clone();
    let animation = Animation::or_default_path(loaded);
    let mut times = Times::new();
    let mut errors = Vec::new();
    let mut pictures = None;
    for frame in 0..effort.frames {
        let (lights, view) = animation.at(frame_time(&animation, frame, effort.frames));
        let check = checked.iter().find(|check| check.frame == frame);
        let passes = if is_first || check.is_some() {
            let camera = view.camera(effort.size.0, effort.size.1);
            let done = progress.timed("frame", || loaded_bake.frame(&lights, &camera, frame))?;
            if is_first {
                done.pictures.full.write_png(&out.join(frame_file(frame)), loaded.exposure_stops)?;
            }
            if let Some(Checked { traced, .. }) = check {
                let (full, indirect) = picture_errors(&done.pictures, traced, loaded.exposure_stops)?;
                errors.push((frame, full, indirect));
                pictures = Some(done.pictures);
            }
            done.times
        } else {
            loaded_bake.look(view.eye);
            loaded_bake.advance(&lights)?
        };
        if is_cancelled() {
            return Err(Error::Cancelled);
        }
        if (frame + 1) % 8 == 0 {
            progress.note(&format!("frame {} of {}", frame + 1, effort.frames));
        }
        for (name, ms) in passes {
            match times.iter_mut().find(|(n, _)| *n == name) {
                Some((_, list)) => list.push(ms),
                None => times.push((name, vec![ms])),
            }
        }
    }
    let (full, indirect) = errors.last().map(|(_, full, indirect)| (*full, *indirect)).unzip();
    let summary = Summary {
        scene: loaded.name.clone(),
        method: method.name.into(),
        codec: None,
        decode: loaded_bake.decoder().map(Decoder::name),
        device,
        patches: Some(loaded_bake.patch_count()),
        receivers: Some(loaded_bake.receiver_count()),
        photons: loaded_bake.first_shot().map(|shot| PhotonCounts::of(&shot.round())),
        frames: effort.frames,
        seed: common.seed,
        passes: times.iter().filter_map(|(name, t)| Some((name.clone(), PassTimes::of(t)?))).collect(),
        bake: BTreeMap::new(),
        peak_memory_bytes: peak_memory_bytes(),
        bytes: loaded_bake.bytes(),
        full,
        indirect,
        points: None,
    };
    Ok(Run { times, errors, pictures, phases, summary })
}

fn trace(
    common: &Common,
    effort: &Effort,
    loaded: &LoadedScene,
    at: (&[Light], &View),
    progress: &Progress,
) -> Result<Pictures, Error> {
    let mut scene = loaded.scene.clone();
    scene.set_lights(at.0);
    let camera = at.1.camera(effort.size.0, effort.size.1);
    let settings = PathSettings { seed: common.seed, ..PathSettings::default() };
    Ok(path::render(&scene, &camera, settings, effort.paths, None, false, progress)?.pictures)
}

fn compared_figures(out: &Path, runs: &[Run], checked: Option<&Checked>, stops: f32) -> Result<Vec<Figure>, Error> {
    let Some(Checked { frame, traced }) = checked else { return Ok(Vec::new()) };
    let mut figures = Vec::new();
    let mut add = |folder: &Path, title: &str, pictures: &Pictures| -> Result<(), Error> {
        write_pictures(folder, pictures, stops)?;
        figures.push(Figure::read(folder, "full.png", format!("{title}, all light, frame {frame}"))?);
        figures.push(Figure::read(folder, "indirect.png", format!("{title}, indirect light"))?);
        Ok(())
    };
    add(&out.join("path"), "Path traced", traced)?;
    for (method, run) in METHODS.iter().zip(runs) {
        let Some(ours) = &run.pictures else { continue };
        add(&out.join(method.name), method.title, ours)?;
    }
    for (method, run) in METHODS.iter().zip(runs) {
        let Some(ours) = &run.pictures else { continue };
        let (folder, blocks) = (out.join(method.name), (ours.full.block_means(8), traced.full.block_means(8)));
        difference_picture(&blocks.0, &blocks.1, 0.25)?.write_png(&folder.join("difference.png"), 0.0)?;
        let caption = "difference of 8 × 8 block means: red brighter, blue darker, full colour at 25 %";
        figures.push(Figure::read(&folder, "difference.png", format!("{}: {caption}", method.title))?);
    }
    Ok(figures)
}

/// A head with a column for each method.
fn head(first: &str) -> Vec<String> {
    std::iter::once(first).chain(METHODS.iter().map(|method| method.name)).map(String::from).collect()
}

/// A row for each name that any of the methods has, and a cell for each method.
fn table<T>(caption: String, first: &str, parts: &[Vec<(String, T)>], cell: impl Fn(&T) -> String) -> Table {
    let mut names: Vec<&String> = Vec::new();
    for (name, _) in parts.iter().flatten() {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let of = |name: &str, part: &Vec<(String, T)>| {
        part.iter().find(|(n, _)| n == name).map(|(_, value)| cell(value)).unwrap_or_default()
    };
    let row = |name: &String| std::iter::once(name.clone()).chain(parts.iter().map(|part| of(name, part))).collect();
    Table { caption, head: head(first), rows: names.into_iter().map(row).collect() }
}

fn times_table(runs: &[Run], device: &str) -> Table {
    let parts: Vec<Times> = runs.iter().map(|run| run.times.clone()).collect();
    let cell = |values: &Vec<f64>| {
        PassTimes::of(values)
            .map_or(String::new(), |t| format!("{} ({})", significant(t.median_ms), significant(t.max_ms)))
    };
    table(format!("Time of each pass, median ms (greatest), {device}"), "pass", &parts, cell)
}

fn bytes_table(runs: &[Run]) -> Table {
    let parts: Vec<Vec<(String, u64)>> =
        runs.iter().map(|run| run.summary.bytes.clone().into_iter().collect()).collect();
    table("Memory of each part".into(), "part", &parts, |count| output::bytes(*count))
}

fn bake_table(shared: &[(String, f64)], runs: &[Run]) -> Table {
    let parts: Vec<Vec<(String, f64)>> =
        runs.iter().map(|run| shared.iter().chain(&run.phases).cloned().collect()).collect();
    table(
        "Once, before the first frame, seconds; shared but for operator, compress, tables, maps and photons".into(),
        "phase",
        &parts,
        |s| significant(*s),
    )
}

fn error_table(caption: &str, runs: &[Run], part: impl Fn(&Errors) -> PictureErrors) -> Table {
    let row = |method: &Method, errors: &Errors| {
        let e = part(errors);
        vec![
            format!("frame {}, {}", errors.0, method.name),
            format!("{:.2} %", 100.0 * e.block_median_relative_error),
            format!("{:.1} dB", e.block_psnr_db),
            format!("{:.3}", e.mean_ratio),
            format!("{:.4}", e.ssim),
            significant(e.flip),
        ]
    };
    let frames = runs.iter().map(|run| run.errors.len()).max().unwrap_or(0);
    let of_frame =
        |k: usize| METHODS.iter().zip(runs).filter_map(move |(method, run)| Some((method, run.errors.get(k)?)));
    Table {
        caption: caption.to_owned(),
        head: ["", "block median", "block PSNR", "mean ratio", "SSIM", "FLIP"].map(String::from).to_vec(),
        rows: (0..frames).flat_map(of_frame).map(|(method, errors)| row(method, errors)).collect(),
    }
}
