//! The demo: the built-in Cornell box, atrium and office, every method against path tracing, lights that move.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use clap::Args;
use reference::metrics::difference_picture;
use reference::path::PathSettings;
use reference::{PictureErrors, PictureFile as _};
use scene::Light;
use temporal::Settings;

use assets::import::{Animation, LoadedScene, View};
use assets::procedural;
use patchlight::light::with_lights;
use patchlight::low_level::operator::{BuildOn, Codec, decoder_name};
use patchlight::memory::peak_memory_bytes;
use patchlight::method::firstshot::FirstShotMethod;
use patchlight::method::multibounce::Multibounce;
use patchlight::method::temporal::{RowKind, Sampled};
use patchlight::method::{FeedbackSettings, FirstShotSettings, LocalSettings, TemporalSettings};
use patchlight::{
    Bake, BakeSettings, Estimator, LightSettings, MethodSettings, PictureRenderer, PictureSettings, Pictures,
};
use runtime::executor::DeviceChoice;
use runtime::graph::{Graph, Stage};
use shell::Error;
use shell::args::{Common, DisplaySettings};
use shell::device::open;
use shell::errors::picture_errors;
use shell::opened::build;
use shell::output;
use shell::output::write_pictures;
use shell::path;
use shell::progress::{Progress, interruptible, is_cancelled};
use shell::report::{Comparison, Figure, FrameGraph, Plot, Section, Series, Table, page, significant};
use shell::sequence::frame_time;
use shell::summary::{PassTimes, PhotonCounts, Summary};

/// Amount of work of the demo.
struct Effort {
    size: (u32, u32),
    frames: u32,
    /// Frames that are path traced as well.
    checked: u32,
    paths: u32,
    patches: usize,
    rays: u32,
}

const QUICK: Effort = Effort { size: (240, 180), frames: 6, checked: 1, paths: 16, patches: 600, rays: 512 };
const FULL: Effort = Effort { size: (480, 360), frames: 24, checked: 2, paths: 48, patches: 2000, rays: 1024 };

/// `patchlight demo`.
#[derive(Args, Clone, Copy, Debug, Default)]
#[command(
    after_help = "Examples:\n  patchlight demo\n  patchlight demo --full --out out/full\n  patchlight demo --device \
     vulkan"
)]
pub struct Demo {
    /// Larger pictures, more frames, patches and paths: minutes.
    #[arg(long, help_heading = "Picture")]
    pub full: bool,
}

/// Scenes of the demo.
const SCENES: [&str; 3] = ["cornell", "atrium", "office"];

/// Relative error of the compressed operators.
const EPSILON: f64 = 0.02;

const FEEDBACK: FeedbackSettings = FeedbackSettings { epsilon: EPSILON, products: 1, accelerated: true };
/// Relative error of the patches' irradiance by photons.
const PHOTON_ERROR: f64 = 0.05;

/// A method that the demo shows.
struct Method {
    name: &'static str,
    title: &'static str,
    /// When it is the one to take.
    purpose: &'static str,
    settings: MethodSettings,
}

const METHODS: [Method; 6] = [
    Method {
        name: "classic",
        title: "Classic radiosity",
        purpose: "the plain method, one sparse product a bounce: to measure others by, and for scenes that are seldom \
             lit twice",
        settings: MethodSettings::Classic,
    },
    Method {
        name: "low_rank",
        title: "Operator in tiles",
        purpose: "all bounces in one product: scenes at rest whose lights move; the operator is baked once",
        settings: MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON }),
    },
    Method {
        name: "feedback",
        title: "Feedback",
        purpose: "one bounce a frame: albedo may change, and there is next to nothing to bake; light settles within \
             frames",
        settings: MethodSettings::Feedback(FEEDBACK),
    },
    Method {
        name: "temporal",
        title: "Temporal",
        purpose: "more patches than an operator has room for: a few samples a row and frame of what changed",
        settings: MethodSettings::Temporal(TEMPORAL),
    },
    Method {
        name: "local",
        title: "Local matrix",
        purpose: "worlds without end: the exact matrix of the patches round the camera, read from disk as it moves",
        settings: MethodSettings::Local(LOCAL),
    },
    Method {
        name: "firstshot",
        title: "First shot",
        purpose: "no form factors between patches: photons from where light falls first, until the error that is \
         asked for",
        settings: MethodSettings::FirstShot(FirstShotSettings {
            error: PHOTON_ERROR,
            most_photons: 1 << 24,
            ..FirstShotSettings::DEFAULT
        }),
    },
];

/// Fewer slots than patches, so that far ones are merged.
const LOCAL: LocalSettings = LocalSettings { slots: 1024, ..LocalSettings::DEFAULT };

const TEMPORAL: TemporalSettings =
    TemporalSettings { settings: Settings::DEFAULT, rows: RowKind::Lists, sampled: Sampled::Patches };

/// Results of one scene.
struct Outcome {
    /// One a method.
    summaries: Vec<Summary>,
    section: Section,
}

/// Milliseconds of each pass, frame by frame.
type Times = Vec<(String, Vec<f64>)>;

/// A checked frame, errors of all and of indirect light.
type Errors = (u32, PictureErrors, PictureErrors);

/// Results of a method.
struct Run {
    times: Times,
    /// Pictures of the checked frames.
    pictures: Vec<(u32, Pictures)>,
    /// Their errors, once they are compared.
    errors: Vec<Errors>,
    /// Seconds before the first frame that other methods do not need.
    phases: Vec<(String, f64)>,
    /// The stages of a frame, and which each reads from.
    stages: Vec<Stage>,
    summary: Summary,
}

/// A frame that is path traced.
struct Checked {
    frame: u32,
    traced: Pictures,
}

pub fn run(common: &Common, args: Demo) -> Result<(), Error> {
    let effort = if args.full { FULL } else { QUICK };
    let out = common.out.clone().unwrap_or_else(|| "out".into());
    output::check_folder(&out)?;
    output::make_folder(&out)?;
    let mut outcomes = Vec::new();
    let mut device = String::new();
    Progress::new(common.quiet).note(&format!(
        "Lights {} built-in rooms by {} methods while their lights move, and path traces a frame of each to compare \
         with.\n\
         {} Pictures and report.html: {}. Your own scene: patchlight render SCENE",
        SCENES.len(),
        METHODS.len(),
        if args.full { "This takes minutes." } else { "About a minute; with --full larger and longer." },
        out.display()
    ));
    for name in SCENES {
        let progress = Progress::new(common.quiet);
        progress.note(&format!("{name}:"));
        let loaded = progress.phase("import", |_| procedural::build(name))?;
        let outcome = one_scene(common, &effort, &loaded, &out.join(name), &progress)?;
        device = outcome.summaries.first().map(|summary| summary.device.clone()).unwrap_or_default();
        outcomes.push(outcome);
    }
    let introduction = [
        format!(
            "Diffuse global illumination on {device}, beside path tracing of the same frames. Lights move over {} \
             frames; form factors are computed once.",
            effort.frames
        ),
        format!(
            "Classic radiosity multiplies by the form factors for each bounce. The operator of all bounces does it in \
             one product; it is stored in tiles with an error of {:.0} %. Feedback takes one product a frame with \
             form factors stored alike, from the light of the frame before; temporal radiosity does it with {} \
             samples a row of what has changed. The local matrix multiplies once by the operator of {} patches, fine \
             ones near the camera, merged ones far off. First shot traces photons from where lights fall first until \
             the irradiance of the patches has an error of {:.0} %. All share patches, form factors and receivers.",
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
    let sections: Vec<_> = std::iter::once(purposes()).chain(outcomes.into_iter().map(|o| o.section)).collect();
    let report = out.join("report.html");
    output::write_text(&report, &page("Patchlight: demo", &introduction, &sections))?;
    let text = output::json(&summaries);
    output::write_text(&out.join("summary.json"), &text)?;
    if common.json {
        say!("{text}");
    } else {
        say!("{} and the pictures beside it show what was rendered on {device}", report.display());
    }
    Ok(())
}

/// Purpose of each method.
fn purposes() -> Section {
    let line = |method: &Method| format!("{} (--method {}): {}.", method.title, method.name, method.purpose);
    let text = METHODS.iter().map(line).collect();
    Section { title: "What each method is for".into(), text, ..Section::default() }
}

fn one_scene(
    common: &Common,
    effort: &Effort,
    loaded: &LoadedScene,
    out: &Path,
    progress: &Progress,
) -> Result<Outcome, Error> {
    output::make_folder(out)?;
    let settings = BakeSettings::default()
        .with_patch_count(effort.patches)
        .with_estimator(Estimator::Hemisphere { rays: effort.rays })
        .with_receiver_rays(effort.rays / 2)
        .with_seed(common.seed);
    let (mut device, _) = open(&DeviceChoice::parse(&common.device))?;
    let bake = Arc::new(build(device.as_mut(), BuildOn::Auto, &loaded.scene, &settings, progress)?);
    drop(device);
    let show = Show { common, effort, loaded, bake: &bake, out };
    let mut runs = Vec::new();
    for method in &METHODS {
        progress.note(&format!("{}:", method.name));
        runs.push(show.run(method)?);
    }
    let checked = show.trace_some(progress)?;
    for run in &mut runs {
        run.compare(&checked, loaded.exposure_stops)?;
    }
    let mut shared = progress.phases();
    shared.retain(|(name, _)| name != "path tracing");
    let section = show.section(&runs, &checked, &shared)?;
    let mut summaries = Vec::new();
    for run in runs {
        let bake = shared.iter().chain(&run.phases).cloned().collect();
        summaries.push(Summary { bake, ..run.summary });
    }
    Ok(Outcome { summaries, section })
}

impl Effort {
    /// Returns true if a frame is path traced: some at even distances, the last one among them.
    fn is_checked(&self, frame: u32) -> bool {
        frame * self.checked / self.frames != (frame + 1) * self.checked / self.frames
    }
}

fn frame_file(frame: u32) -> String {
    format!("frame-{frame:04}.png")
}

/// A scene with its bake, on which the methods are shown.
struct Show<'a> {
    common: &'a Common,
    effort: &'a Effort,
    loaded: &'a LoadedScene,
    bake: &'a Arc<Bake>,
    out: &'a Path,
}

impl Show<'_> {
    /// Lights and view of a frame.
    fn at(&self, frame: u32) -> (Vec<Light>, View) {
        let animation = Animation::or_default_path(self.loaded);
        animation.at(frame_time(&animation, frame, self.effort.frames))
    }

    /// Path traces the frames that are checked.
    fn trace_some(&self, progress: &Progress) -> Result<Vec<Checked>, Error> {
        let effort = self.effort;
        let mut checked = Vec::new();
        for frame in (0..effort.frames).filter(|&frame| effort.is_checked(frame)) {
            let (lights, view) = self.at(frame);
            let mut scene = self.loaded.scene.clone();
            scene.set_lights(&lights);
            let camera = view.camera(effort.size.0, effort.size.1);
            let settings = PathSettings { seed: self.common.seed, ..PathSettings::default() };
            let traced = path::render(&scene, &camera, settings, effort.paths, None, false, progress)?.pictures;
            checked.push(Checked { frame, traced });
        }
        Ok(checked)
    }

    /// A method on the device of the options.
    fn load(&self, method: &Method, progress: &Progress) -> Result<PictureRenderer, Error> {
        let (executor, note) = open(&DeviceChoice::parse(&self.common.device))?;
        if let Some(note) = note.filter(|_| method.settings == MethodSettings::Classic) {
            progress.note(&note);
        }
        let light = LightSettings::default().with_method(method.settings).with_eye(self.loaded.view.eye);
        let pictures = PictureSettings::default().with_size(self.effort.size).with_sub_frames(4);
        Ok(interruptible(|| PictureRenderer::of_bake(Arc::clone(self.bake), executor, &light, &pictures, progress))?)
    }

    /// Pictures of all frames by the first method; by the others only the light, but for the frames that are checked.
    fn run(&self, method: &Method) -> Result<Run, Error> {
        let effort = self.effort;
        let progress = Progress::new(self.common.quiet);
        let mut renderer = self.load(method, &progress)?;
        let phases = progress.phases();
        let is_first = method.settings == MethodSettings::Classic;
        let mut times = Times::new();
        let mut pictures = Vec::new();
        let mut shown = None;
        for frame in 0..effort.frames {
            let (lights, view) = self.at(frame);
            let lighting = with_lights(&self.loaded.scene, &lights);
            let camera = view.camera(effort.size.0, effort.size.1);
            let is_checked = effort.is_checked(frame);
            let passes = if is_first || is_checked {
                let done = progress.timed("frame", || renderer.picture(&lighting, &camera, frame))?;
                if is_first {
                    let path = self.out.join(frame_file(frame));
                    let transform =
                        shown.get_or_insert_with(|| DisplaySettings::of(self.loaded).transform(&done.pictures.full));
                    done.pictures.full.write_shown(&path, transform)?;
                    if frame == 0 {
                        progress.note(&format!("first picture: {}", path.display()));
                    }
                }
                if is_checked {
                    pictures.push((frame, done.pictures));
                }
                done.times
            } else {
                interruptible(|| renderer.advance(&lighting, &camera))?
            };
            if is_cancelled() {
                return Err(Error::Cancelled);
            }
            if (frame + 1) % 8 == 0 {
                progress.note(&format!("frame {} of {}", frame + 1, effort.frames));
            }
            add_times(&mut times, passes);
        }
        renderer.light_mut().counted_report()?;
        let summary = self.summary(method, &mut renderer, &times);
        let stages = Graph::new(renderer.light_mut().executor_mut().plan().clone()).stages();
        Ok(Run { times, pictures, errors: Vec::new(), phases, stages, summary })
    }

    fn summary(&self, method: &Method, renderer: &mut PictureRenderer, times: &Times) -> Summary {
        let device = renderer.light_mut().executor_mut().device().name.clone();
        let own = renderer.light().method().as_any();
        let decoder = own.downcast_ref::<Multibounce>().and_then(Multibounce::decoder);
        let photons = own.downcast_ref::<FirstShotMethod>();
        Summary {
            scene: self.loaded.name.clone(),
            method: method.name.into(),
            codec: None,
            decode: decoder.map(decoder_name),
            device,
            patches: Some(self.bake.mesh().patches.len()),
            receivers: Some(self.bake.receivers().points.len()),
            photons: photons.map(|photons| PhotonCounts::of(&photons.shot().round())),
            frames: self.effort.frames,
            seed: self.common.seed,
            light_update: None,
            passes: times.iter().filter_map(|(name, t)| Some((name.clone(), PassTimes::of(t)?))).collect(),
            bake: BTreeMap::new(),
            energy: self.bake.energy(),
            peak_memory_bytes: peak_memory_bytes(),
            bytes: renderer.light().bytes(),
            full: None,
            indirect: None,
            points: None,
        }
    }

    /// Section of the report on a scene.
    fn section(&self, runs: &[Run], checked: &[Checked], shared: &[(String, f64)]) -> Result<Section, Error> {
        let Self { effort, loaded, out, .. } = *self;
        let [classic, ..] = runs else { return Err(Error::Cancelled) };
        let mut strip = Vec::new();
        for frame in (0..effort.frames).step_by(effort.frames.div_ceil(12) as usize) {
            strip.push(Figure::photograph(out, &frame_file(frame), format!("frame {frame}"))?);
        }
        let mut between_patches = Vec::new();
        for (method, run) in METHODS.iter().zip(runs) {
            if let Some((_, values)) = run.times.iter().find(|(name, _)| name == "method") {
                between_patches.push(line(method.name, values));
            }
        }
        let passes = classic.times.iter().map(|(name, values)| line(name, values)).collect();
        Ok(Section {
            title: format!("{} ({} triangles)", loaded.name, loaded.scene.geometry.triangles.len()),
            text: vec![format!(
                "{} patches, {} receivers; picture {} × {}.",
                classic.summary.patches.unwrap_or(0),
                classic.summary.receivers.unwrap_or(0),
                effort.size.0,
                effort.size.1
            )],
            comparisons: comparisons(out, runs, checked.last(), &DisplaySettings::of(loaded))?,
            figures: differences(out, runs, checked.last())?,
            strip,
            tables: vec![
                times_table(runs, &classic.summary.device),
                bytes_table(runs),
                bake_table(shared, runs),
                error_table("All light against the path tracer", runs, |e| e.1),
                error_table("Indirect light against the path tracer", runs, |e| e.2),
            ],
            plots: vec![
                over_frames("Time of each pass, classic radiosity", passes),
                over_frames("Time of the light between patches", between_patches),
            ],
            graphs: METHODS.iter().zip(runs).take(2).map(|(method, run)| run.graph(method)).collect(),
        })
    }
}

/// Adds the milliseconds of a frame's passes.
fn add_times(times: &mut Times, passes: Vec<(String, f64)>) {
    for (name, ms) in passes {
        match times.iter_mut().find(|(n, _)| *n == name) {
            Some((_, list)) => list.push(ms),
            None => times.push((name, vec![ms])),
        }
    }
}

/// A line of a plot over the frames.
fn line(name: &str, values: &[f64]) -> Series {
    let points = values.iter().enumerate().map(|(frame, ms)| (frame as f64, *ms)).collect();
    Series { name: name.to_owned(), points }
}

fn over_frames(title: &str, series: Vec<Series>) -> Plot {
    Plot { title: title.to_owned(), unit: "ms".into(), x: "frame".into(), logarithmic: false, series }
}

impl Run {
    /// Compares the checked frames with what was path traced.
    fn compare(&mut self, checked: &[Checked], stops: f32) -> Result<(), Error> {
        for (frame, pictures) in &self.pictures {
            let Some(Checked { traced, .. }) = checked.iter().find(|check| check.frame == *frame) else { continue };
            let (full, indirect) = picture_errors(pictures, traced, stops)?;
            self.errors.push((*frame, full, indirect));
        }
        self.summary.full = self.errors.last().map(|errors| errors.1);
        self.summary.indirect = self.errors.last().map(|errors| errors.2);
        Ok(())
    }

    /// The picture of the last checked frame.
    fn last(&self) -> Option<&Pictures> {
        self.pictures.last().map(|(_, pictures)| pictures)
    }

    /// The frame graph with median times.
    fn graph(&self, method: &Method) -> FrameGraph {
        let ms = |name: &str| self.summary.passes.get(name).map(|times| times.median_ms);
        let stages = self.stages.iter().map(|stage| (stage.name.clone(), ms(&stage.name), stage.reads.clone()));
        FrameGraph { title: format!("Frame graph, {}", method.title.to_lowercase()), stages: stages.collect() }
    }
}

/// Pictures of all and of indirect light over those that are path traced.
fn comparisons(
    out: &Path,
    runs: &[Run],
    checked: Option<&Checked>,
    shown: &DisplaySettings,
) -> Result<Vec<Comparison>, Error> {
    let Some(Checked { frame, traced }) = checked else { return Ok(Vec::new()) };
    let transform = shown.transform(&traced.full);
    write_pictures(&out.join("path"), traced, &transform)?;
    for (method, run) in METHODS.iter().zip(runs) {
        if let Some(ours) = run.last() {
            write_pictures(&out.join(method.name), ours, &transform)?;
        }
    }
    let compare = |file: &str, light: &str| -> Result<Comparison, Error> {
        let caption = format!("path traced, {light}, frame {frame}");
        let beneath = Figure::photograph(&out.join("path"), file, caption)?;
        let shown = METHODS.iter().zip(runs).filter(|(_, run)| run.last().is_some());
        let above = shown.map(|(method, _)| Figure::photograph(&out.join(method.name), file, method.title.to_owned()));
        Ok(Comparison { beneath, above: above.collect::<Result<_, Error>>()? })
    };
    Ok(vec![compare("full.png", "all light")?, compare("indirect.png", "indirect light")?])
}

fn differences(out: &Path, runs: &[Run], checked: Option<&Checked>) -> Result<Vec<Figure>, Error> {
    let Some(Checked { traced, .. }) = checked else { return Ok(Vec::new()) };
    let mut figures = Vec::new();
    for (method, run) in METHODS.iter().zip(runs) {
        let Some(ours) = run.last() else { continue };
        let folder = out.join(method.name);
        let blocks = [&ours.full, &traced.full].map(|picture| picture.block_means(8));
        difference_picture(&blocks[0], &blocks[1], 0.25)?.write_png(&folder.join("difference.png"), 0.0)?;
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
    table(format!("Time of each pass, median ms (greatest), {device}"), "pass", &parts, |values| {
        PassTimes::of(values)
            .map_or(String::new(), |t| format!("{} ({})", significant(t.median_ms), significant(t.max_ms)))
    })
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
