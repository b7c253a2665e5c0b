//! `patchlight bake`, and bakes of scenes where other commands take a scene.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use clap::Args;
use localmatrix::{BakeError, Part};
use serde::Serialize;

use super::plan::{Format, RoundPlan};
use super::world::{absolute, check_file, parse_part};
use assets::import::LoadedScene;
use patchlight::energy::EnergyCheck;
use patchlight::file::{Section, beginning_of};
use patchlight::low_level::operator::{Build, BuildOn};
use patchlight::memory::peak_memory_bytes;
use patchlight::method::FirstShotSettings;
use patchlight::rounds::MAX_ROUNDS;
use patchlight::{
    BakeSettings, Estimator, FileSettings, LightSettings, MethodSettings, Origin, PictureRenderer, PictureSettings,
    ReceiverKind, Scene,
};
use runtime::executor::{DeviceChoice, DeviceKind, Executor};
use shell::Error;
use shell::args::bake::parse_bytes;
use shell::args::{BakeOptions, Common, FormFactors, Input, Method, OperatorSettings, PatchOptions, parse_purpose};
use shell::device::open;
use shell::opened::{Opened, build, is_younger, open_device, operator_of, options_of};
use shell::output;
use shell::progress::{Progress, continue_in, interruptible};

/// Bake a scene into a file: patches, form factors, receivers, and the operators of the methods that are named.
/// `render` then begins with the first frame, by any method that needs no operator or whose operator is there. Goes on
/// where an interrupted run of the same ended; the bytes are the same for any number of threads.
#[derive(Args, Clone, Debug)]
#[command(after_help = "Examples:\n  \
    patchlight bake sponza.toml --patch-count 10000 -o sponza.bake\n  \
    patchlight bake office --for low_rank,feedback,temporal -o office.bake\n  \
    patchlight bake office --for multibounce --codec bc6h -o office.bake\n  \
    patchlight bake atrium --for-frames -o atrium.bake && gzip -9 atrium.bake     for a page\n  \
    patchlight bake sponza.toml --plan 8 --format slurm -o sponza.bake     the jobs of a farm: sbatch sponza.sbatch\n  \
    patchlight render office.bake --method temporal --frames 60 --animate sun\n  \
    patchlight info office.bake\n\n\
    --out names the file [default: SCENE.bake]. Worlds larger than memory: `patchlight world`.")]
pub struct Bake {
    /// A scene file (.toml, .obj, .gltf, .glb) or a built-in scene.
    pub scene: String,
    /// Methods that the file is for: low_rank, multibounce and feedback have operators, which take time to make; all
    /// others need nothing but what every bake has.
    #[arg(
        long = "for",
        value_name = "METHODS",
        value_delimiter = ',',
        default_value = "low_rank",
        value_parser = parse_purpose,
        help_heading = "Method"
    )]
    pub methods: Vec<Method>,
    /// Keep what frames need and no more, rounded, for downloads.
    ///
    /// `gzip` packs it to less than half. Edits of the scene and operators are made anew.
    #[arg(long, conflicts_with_all = ["methods", "plan", "round"], help_heading = "Method")]
    pub for_frames: bool,
    #[command(flatten)]
    pub bake: BakeOptions,
    #[command(flatten)]
    pub operators: OperatorSettings,
    /// Bake nothing, but write the jobs of a farm beside the file that --out names: rounds of rows that follow from each
    /// other, each traced in N parts; the scene and the file must be where all workers see them.
    #[arg(
        long,
        value_name = "N",
        requires = "format",
        conflicts_with = "round",
        value_parser = clap::value_parser!(u32).range(1..=1000),
        help_heading = "Farm"
    )]
    pub plan: Option<u32>,
    /// Who runs the jobs.
    #[arg(long, value_enum, requires = "plan", help_heading = "Farm")]
    pub format: Option<Format>,
    /// Go on to a round of rows, 1 to 7, and leave its task beside the file that --out names; the rows of those before
    /// must be there.
    #[arg(long, value_name = "R", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_ROUNDS) + 1), help_heading = "Farm")]
    pub round: Option<u32>,
    /// Trace part K of N of the rows of that round.
    #[arg(long, value_name = "K/N", requires = "round", value_parser = parse_part, help_heading = "Farm")]
    pub part: Option<Part>,
}

#[derive(Serialize)]
struct Report {
    file: PathBuf,
    bytes: u64,
    patches: usize,
    elements: usize,
    receivers: usize,
    operators: Vec<Operator>,
    seconds: Vec<(String, f64)>,
    #[serde(skip_serializing_if = "Option::is_none")]
    peak_memory_bytes: Option<u64>,
}

/// An operator of a bake in words.
#[derive(Serialize)]
struct Operator {
    /// The options of `render` that take it.
    options: String,
    what: String,
}

pub fn run(common: &Common, args: &Bake) -> Result<(), Error> {
    let progress = Progress::new(common.quiet);
    match &common.out {
        Some(path) => check_file(path)?,
        None => output::check_folder(Path::new("."))?,
    }
    let memory_limit = args.operators.memory_limit;
    let begun = SystemTime::now();
    let loaded = output::import_within(&args.scene, memory_limit, &progress)?;
    let path = common.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.bake", loaded.name.replace(':', "-"))));
    check_file(&path)?;
    let of_farm = args.plan.is_some() || args.round.is_some();
    if of_farm {
        common.native_only(if args.plan.is_some() { "bake --plan" } else { "bake --round" })?;
    }
    // Before minutes of work.
    let mut device = match of_farm {
        true => open(&DeviceChoice::Cpu)?.0,
        false => open_device(common, &progress)?,
    };
    let methods: &[Method] = if args.for_frames { &[] } else { &args.methods };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let settings = FileSettings {
        origin: Origin {
            scene: args.scene.clone(),
            scene_hash: loaded.content_hash,
            application: loaded.description().into_bytes(),
        },
        bake: args.bake.settings(&loaded, &loaded.animation, memory_limit, common.seed),
        methods: methods.iter().map(|method| operator_of(&args.operators, *method)).collect(),
        build: Build { on: operators_on(common, device.device().kind), memory_limit, folder: folder.to_path_buf() },
    };
    let of_scene = |error: patchlight::Error| Error::of_scene(error, &args.scene);
    if args.bake.patches.voxel_size.is_none() {
        let FileSettings { bake, methods, build, .. } = &settings;
        let check = |method: &MethodSettings| method.check_memory(bake.patch_count, bake.bounces, build);
        methods.iter().try_for_each(check).map_err(of_scene)?;
    }
    if let (Some(parts), Some(format)) = (args.plan, args.format) {
        return plan(common, args, &path, &settings.bake, (parts, format));
    }
    if let Some(round) = args.round {
        let rounds = || go_on(common, (&path, &loaded.scene, &settings), (round, args.part), &progress);
        return interruptible(rounds).map_err(of_scene);
    }
    continue_in(beginning_of(&path));
    let build = || patchlight::Bake::build_into(&path, &loaded.scene, &settings, device.as_mut(), &progress);
    let bake = interruptible(build).map_err(of_scene)?;
    if args.for_frames {
        bake.save_for_frames(&path, &settings.origin).map_err(of_scene)?;
    }
    if loaded.files.iter().any(|file| is_younger(file, begun)) {
        progress.warn(&format!("{} was edited while it was baked; bake it again", args.scene));
    }
    let report = Report::of(&bake, path, &progress)?;
    match common.json {
        true => say!("{}", output::json(&report)),
        false => report.print(),
    }
    Ok(())
}

/// Summary of a step of a farm.
#[derive(Serialize)]
struct StepReport {
    file: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    round: Option<u32>,
    rows: usize,
    is_done: bool,
}

/// Goes on to a round, or traces a part of it.
fn go_on(
    common: &Common,
    (path, scene, settings): (&Path, &Scene, &FileSettings),
    (round, part): (u32, Option<Part>),
    progress: &Progress,
) -> Result<(), patchlight::Error> {
    let file = path.to_path_buf();
    let report = match part {
        Some(part) => {
            let rows = patchlight::Bake::trace_round(path, scene, settings, (round, part), progress)?;
            StepReport { file, round: Some(round), rows, is_done: false }
        }
        None => match patchlight::Bake::go_on_to(path, scene, settings, round, progress)? {
            Some(waits) => StepReport { file, round: Some(waits.number), rows: waits.rows, is_done: false },
            None => StepReport { file, round: None, rows: 0, is_done: true },
        },
    };
    if common.json {
        say!("{}", output::json(&report));
        return Ok(());
    }
    match (report.round, part) {
        (None, _) => say!("{:14} {}, done", "file", report.file.display()),
        (Some(round), None) => say!("{:14} {round}: {} rows are to be traced", "round", report.rows),
        (Some(round), Some(part)) => {
            say!("{:14} {round}: {} rows, part {} of {}", "round", report.rows, part.number, part.of);
        }
    }
    Ok(())
}

/// Summary of a plan.
#[derive(Serialize)]
struct PlanReport {
    file: PathBuf,
    parts: u32,
    memory_bytes: u64,
    part_memory_bytes: u64,
}

/// Writes the jobs of a farm.
fn plan(
    common: &Common,
    args: &Bake,
    path: &Path,
    settings: &BakeSettings,
    (parts, format): (u32, Format),
) -> Result<(), Error> {
    // This process has loaded the scene, as each job will.
    let loaded = peak_memory_bytes().unwrap_or(0);
    let [rows, part] = settings.rows_bytes(parts);
    let limit = args.operators.memory_limit.unwrap_or(u64::MAX);
    let memory = [loaded + rows, loaded + part].map(|memory| memory.min(limit));
    let bake = absolute(path)?;
    let file = RoundPlan { parts, arguments: arguments(&args.scene, &bake)?, bake, memory }.write(format)?;
    let [memory_bytes, part_memory_bytes] = memory;
    let report = PlanReport { file, parts, memory_bytes, part_memory_bytes };
    if common.json {
        say!("{}", output::json(&report));
        return Ok(());
    }
    say!("{:14} {}: {MAX_ROUNDS} rounds at most, {parts} parts each", "jobs", report.file.display());
    let [memory, part] = memory.map(output::bytes);
    say!("{:14} {memory} for what goes on, {part} for a part", "memory");
    Ok(())
}

/// The arguments of this process for its jobs: those of the plan and of its report are left out, and paths are absolute.
fn arguments(scene: &str, bake: &Path) -> Result<Vec<String>, Error> {
    const WITH_VALUE: [&str; 5] = ["--plan", "--format", "--out", "-o", "--threads"];
    let mut arguments = Vec::new();
    let mut given = std::env::args().skip(1);
    while let Some(word) = given.next() {
        let is_short = word.starts_with("-o") && !word.starts_with("--");
        match word.as_str() {
            "--json" | "--quiet" => {}
            _ if WITH_VALUE.contains(&word.as_str()) => drop(given.next()),
            _ if is_short || WITH_VALUE.iter().any(|name| word.starts_with(&format!("{name}="))) => {}
            _ if word == scene && Path::new(scene).exists() => {
                arguments.push(absolute(Path::new(scene))?.to_string_lossy().into_owned());
            }
            _ => arguments.push(word),
        }
    }
    arguments.extend(["--quiet".to_owned(), "-o".to_owned(), bake.to_string_lossy().into_owned()]);
    Ok(arguments)
}

impl Report {
    fn of(bake: &patchlight::Bake, file: PathBuf, progress: &Progress) -> Result<Self, Error> {
        Ok(Self {
            bytes: file_bytes(&file)?,
            patches: bake.mesh().patches.len(),
            elements: bake.mesh().elements.len(),
            receivers: bake.receivers().points.len(),
            operators: operators(bake),
            seconds: progress.phases(),
            peak_memory_bytes: peak_memory_bytes(),
            file,
        })
    }

    fn print(&self) {
        say!("{:14} {}, {}", "file", self.file.display(), output::bytes(self.bytes));
        say!("{:14} {}, {} elements, {} receivers", "patches", self.patches, self.elements, self.receivers);
        print_operators(&self.operators);
        for (name, seconds) in &self.seconds {
            say!("{name:14} {seconds:.2} s");
        }
        if let Some(peak) = self.peak_memory_bytes {
            say!("{:14} {}", "peak memory", output::bytes(peak));
        }
    }
}

fn operators(bake: &patchlight::Bake) -> Vec<Operator> {
    let one = |baked: &patchlight::low_level::operator::BakedOperator| Operator {
        options: options_of(&baked.key),
        what: baked.operator.describe(),
    };
    bake.operators().iter().map(one).collect()
}

fn print_operators(operators: &[Operator]) {
    operators.iter().for_each(|Operator { options, what }| say!("{:14} for --method {options}: {what}", ""));
}

fn file_bytes(path: &Path) -> Result<u64, Error> {
    let read = |source| BakeError::File { path: path.display().to_string(), reason: format!("{source}") };
    Ok(std::fs::metadata(path).map_err(read)?.len())
}

/// Options of commands that write light.
#[derive(Args, Clone, Debug)]
pub struct LightOptions {
    /// A scene file (.toml, .obj, .gltf, .glb), a built-in scene, or the bake of one.
    pub scene: String,
    #[command(flatten)]
    pub patches: PatchOptions,
    /// Most resident memory: bytes, or with K, M or G. What would take more is refused before it is begun [default:
    /// what is free].
    #[arg(long, value_parser = parse_bytes)]
    pub memory_limit: Option<u64>,
}

/// A scene whose light is written.
pub struct Lightable {
    /// The scene, its triangles cut as those of the bake.
    pub loaded: LoadedScene,
    /// Its light, without pictures.
    pub renderer: PictureRenderer,
    /// The folder of the results, which is there.
    pub out: PathBuf,
}

impl Lightable {
    /// Opens a bake, or makes that of a scene. Results go to `--out`, or to a folder with the name of the scene and of
    /// the command.
    ///
    /// # Errors
    /// What is wrong with the file or the device; [`Error::WorldLight`]; cancellation.
    pub fn of(common: &Common, options: &LightOptions, command: &str, progress: &Progress) -> Result<Self, Error> {
        output::check_out(&common.out)?;
        let mut executor = open_device(common, progress)?;
        let (loaded, bake) = baked(common, options, executor.as_mut(), progress)?;
        let out = output::folder_or(&common.out, &format!("{}-{command}", loaded.name));
        output::make_folder(&out)?;
        // No picture is made: the least there is.
        // Of all methods photons alone know a medium.
        let method = match bake.scene().has_medium() {
            true => MethodSettings::FirstShot(FirstShotSettings::DEFAULT),
            false => MethodSettings::Classic,
        };
        let eye = loaded.view.eye;
        let light = LightSettings::default().with_method(method).with_eye(eye);
        let pictures = PictureSettings::default().with_size((1, 1)).with_sub_frames(1);
        let renderer = interruptible(|| PictureRenderer::of_bake(bake, executor, &light, &pictures, progress))?;
        Ok(Self { loaded, renderer, out })
    }
}

/// Place where a bake on a device of this kind builds operators: there, if it was asked for by name, else if it is a
/// graphics processor that is large enough.
fn operators_on(common: &Common, kind: DeviceKind) -> BuildOn {
    match (DeviceChoice::parse(&common.device), kind) {
        (_, DeviceKind::Native) => BuildOn::Host,
        (DeviceChoice::Auto, _) => BuildOn::Auto,
        _ => BuildOn::Device,
    }
}

/// A scene and its bake, opened or made.
fn baked(
    common: &Common,
    options: &LightOptions,
    device: &mut (dyn Executor + 'static),
    progress: &Progress,
) -> Result<(LoadedScene, Arc<patchlight::Bake>), Error> {
    let LightOptions { scene, patches, memory_limit } = options;
    match Input::of(scene) {
        Input::World => return Err(Error::WorldLight { path: scene.into() }),
        Input::Bake => {
            if patches.is_given() {
                progress.warn("options of patches are for scenes, not bakes; this run ignores them");
            }
            let Opened { loaded, bake, .. } = Opened::read(Path::new(scene), progress)?;
            return Ok((loaded, Arc::new(bake)));
        }
        Input::Scene => {}
    }
    let mut loaded = output::import_within(scene, *memory_limit, progress)?;
    let settings = BakeSettings::default()
        .with_patches(patches.kind(FormFactors::Hemisphere))
        .with_patch_count(patches.count())
        .with_voxel_size(patches.voxel_size)
        .with_focus(patches.focus.unwrap_or_default().focus(&loaded, &loaded.animation))
        .with_memory_limit(*memory_limit)
        .with_seed(common.seed);
    let bake = build(device, BuildOn::Auto, &loaded.scene, &settings, progress);
    let bake = bake.map_err(|error| Error::of_scene(error, scene))?;
    loaded.scene = bake.scene().clone();
    Ok((loaded, Arc::new(bake)))
}

#[derive(Serialize)]
struct Info {
    file: PathBuf,
    bytes: u64,
    scene: String,
    scene_hash: String,
    has_changed: bool,
    settings: BakeSettings,
    triangles: usize,
    patches: usize,
    elements: usize,
    receivers: usize,
    interpolation_points: usize,
    bounces: u32,
    /// The bake's estimate of its own errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    energy: Option<EnergyCheck>,
    sections: Vec<SectionPlace>,
    operators: Vec<Operator>,
    /// Methods that need no operator.
    #[serde(skip)]
    methods: &'static str,
}

/// A section.
#[derive(Serialize)]
struct SectionPlace {
    name: &'static str,
    offset: u64,
    bytes: u64,
}

/// Says what a bake holds; all of it is checked.
pub fn info(common: &Common, path: &Path) -> Result<(), Error> {
    common.native_only("info")?;
    let Opened { bake, origin, sections, has_changed, .. } = Opened::new(path, &Progress::new(common.quiet))?;
    let part =
        |section: &Section| SectionPlace { name: section.kind.name(), offset: section.offset, bytes: section.length };
    let info = Info {
        file: path.to_path_buf(),
        bytes: file_bytes(path)?,
        scene_hash: origin.scene_hash.iter().map(|byte| format!("{byte:02x}")).collect(),
        has_changed,
        scene: origin.scene,
        settings: *bake.settings(),
        triangles: bake.scene().geometry.triangles.len(),
        patches: bake.mesh().patches.len(),
        elements: bake.mesh().elements.len(),
        receivers: bake.receivers().points.len(),
        interpolation_points: bake.receivers().interpolation.points.len(),
        bounces: bake.bounces(),
        energy: bake.energy(),
        sections: sections.iter().map(part).collect(),
        operators: operators(&bake),
        methods: match bake.scene().has_medium() {
            true => "firstshot, path",
            false => "classic, temporal, local, firstshot, path",
        },
    };
    match common.json {
        true => say!("{}", output::json(&info)),
        false => info.print(),
    }
    Ok(())
}

impl Info {
    fn print(&self) {
        let changed = if self.has_changed { ", which has changed since: bake it again" } else { "" };
        say!("{:14} {}, {}", "bake", self.file.display(), output::bytes(self.bytes));
        say!("{:14} {} ({}…){changed}", "scene", self.scene, &self.scene_hash[..16]);
        say!("{:14} {}", "settings", settings_line(&self.settings));
        say!("{:14} {} triangles, {} bounces", "", self.triangles, self.bounces);
        say!("{:14} {}, {} elements", "patches", self.patches, self.elements);
        say!("{:14} {}, {} interpolation points", "receivers", self.receivers, self.interpolation_points);
        if let Some(energy) = &self.energy {
            say!("{:14} {}", "errors", energy.summary());
        }
        for SectionPlace { name, offset, bytes } in &self.sections {
            say!("{:14} {name}: {} from byte {offset}", "section", output::bytes(*bytes));
        }
        say!("{:14} {}", "methods", self.methods);
        print_operators(&self.operators);
    }
}

/// The settings of a bake as the options have them.
fn settings_line(settings: &BakeSettings) -> String {
    let estimator = match settings.estimator {
        Estimator::Hemisphere { rays } => format!("{rays} rays a row"),
        Estimator::Contour => "form factors by contours".to_owned(),
        Estimator::Area => "form factors by areas".to_owned(),
        Estimator::Point => "form factors by points".to_owned(),
    };
    let receivers = match settings.receivers {
        ReceiverKind::Mesh => format!("receivers of {} rays on the mesh", settings.receiver_rays),
        ReceiverKind::Pixels => format!("receivers of {} rays at the pixels", settings.receiver_rays),
        ReceiverKind::Patches => "patches as receivers".to_owned(),
    };
    let patches = match settings.voxel_size {
        Some(edge) => format!("{} patches of voxels of {edge} m", settings.patches.name()),
        None => format!("about {} {} patches", settings.patch_count, settings.patches.name()),
    };
    format!("{patches}, {estimator}, {receivers}, seed {}", settings.seed)
}
