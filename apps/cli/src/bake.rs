//! `patchlight bake`, and bakes of scenes where other commands take a scene.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use clap::{ArgMatches, Args, ValueEnum as _};
use localmatrix::BakeError;
use serde::Serialize;

use super::args::{
    BakeOptions, FormFactors, Input, Method, OperatorSettings, PatchOptions, parse_bytes, warn_of_idle_in_bake,
};
use super::world::check_file;
use assets::import::{LoadedScene, load_or_build};
use experiments::Error;
use experiments::args::Common;
use experiments::output;
use experiments::progress::{Progress, continue_in, interruptible};
use experiments::say;
use patchlight::energy::EnergyCheck;
use patchlight::file::{Section, beginning_of};
use patchlight::memory::peak_memory_bytes;
use patchlight::method::{FeedbackSettings, FirstShotSettings};
use patchlight::operator::{Build, BuildOn, Codec, OperatorKey};
use patchlight::{
    BakeFile, BakeSettings, Estimator, FileSettings, MethodSettings, Origin, ReceiverKind, RenderSettings, Renderer,
    Variant,
};
use runtime::executor::{DeviceChoice, DeviceKind, Executor, open};
use scene::Scene;

/// Bake a scene into a file: patches, form factors, receivers, and the operators of the methods that are named. `render` then
/// begins with the first frame, by any method that needs no operator or whose operator is there. Goes on where an interrupted
/// run of the same ended; the bytes are the same for any number of threads.
#[derive(Args, Clone, Debug)]
#[command(after_help = "Examples:\n  \
    patchlight bake sponza.toml --patch-count 10000 -o sponza.bake\n  \
    patchlight bake office --for tiles,feedback,temporal -o office.bake\n  \
    patchlight bake office --for multibounce --codec bc6h -o office.bake\n  \
    patchlight render office.bake --method temporal --frames 60 --animate sun\n  \
    patchlight info office.bake\n\n\
    --out names the file [default: SCENE.bake]. Worlds larger than memory: `patchlight world`.")]
pub struct Bake {
    /// A scene file (.toml, .obj, .gltf, .glb) or a built-in scene.
    pub scene: String,
    /// Methods that the file is for: tiles, multibounce and feedback have operators, which take time to make; all others need
    /// nothing but what every bake has.
    #[arg(long = "for", value_name = "METHODS", value_delimiter = ',', default_value = "tiles", value_parser = parse_purpose)]
    pub methods: Vec<Method>,
    #[command(flatten)]
    pub bake: BakeOptions,
    #[command(flatten)]
    pub operators: OperatorSettings,
    /// Says that only worlds are baked in parts.
    #[arg(long, hide = true, value_parser = refuse_plan)]
    pub plan: Option<u32>,
    /// As for worlds.
    #[arg(long, hide = true, requires = "plan")]
    pub format: Option<String>,
}

fn refuse_plan(_: &str) -> Result<u32, String> {
    let why = "the bake of a scene is made whole: each round of its receivers follows from the one before";
    Err(format!("{why}; bakes of worlds have parts: `patchlight world SCENE --plan N`"))
}

pub fn parse_purpose(text: &str) -> Result<Method, String> {
    match Method::from_str(text, true) {
        Ok(Method::Path) => Err("path tracing needs no bake".to_owned()),
        Ok(method) => Ok(method),
        Err(_) => {
            let names = Method::value_variants().iter().map(|method| method.name()).filter(|name| *name != "path");
            let names: Vec<&str> = names.collect();
            Err(format!("`{text}` is no method; choose from {}", names.join(", ")))
        }
    }
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

/// The method of an operator, or one without.
pub fn operator_of(options: &OperatorSettings, method: Method) -> MethodSettings {
    match method {
        Method::Tiles => MethodSettings::Multibounce(options.tiles()),
        Method::Multibounce => MethodSettings::Multibounce(options.storage()),
        Method::Feedback => {
            let FeedbackSettings { products, accelerated, .. } = FeedbackSettings::default();
            MethodSettings::Feedback(options.feedback(products, accelerated))
        }
        _ => MethodSettings::Classic,
    }
}

pub fn run(common: &Common, args: &Bake, matches: Option<&ArgMatches>) -> Result<(), Error> {
    let progress = Progress::new(common.quiet);
    if let Some(matches) = matches {
        warn_of_idle_in_bake(matches, args, &progress);
    }
    match &common.out {
        Some(path) => check_file(path)?,
        None => output::check_folder(Path::new("."))?,
    }
    let memory_limit = args.operators.memory_limit;
    let begun = SystemTime::now();
    let loaded = output::import_within(&args.scene, memory_limit, &progress)?;
    let path = common.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.bake", loaded.name.replace(':', "-"))));
    check_file(&path)?;
    // Before minutes of work.
    let mut device = open_device(common, &progress)?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let settings = FileSettings {
        origin: Origin {
            scene: args.scene.clone(),
            scene_hash: loaded.content_hash,
            application: loaded.description().into_bytes(),
        },
        bake: args.bake.settings(&loaded, &loaded.animation, memory_limit, common.seed),
        methods: args.methods.iter().map(|method| operator_of(&args.operators, *method)).collect(),
        build: Build { on: operators_on(common, device.device().kind), memory_limit, folder: folder.to_path_buf() },
    };
    let of_scene = |error: patchlight::Error| Error::of_scene(error, &args.scene);
    if args.bake.patches.voxel_size.is_none() {
        let FileSettings { bake, methods, build, .. } = &settings;
        let check = |method: &MethodSettings| method.check_memory(bake.patch_count, bake.bounces, build);
        methods.iter().try_for_each(check).map_err(of_scene)?;
    }
    continue_in(beginning_of(&path));
    let build = || patchlight::Bake::build_into(&path, &loaded.scene, &settings, device.as_mut(), &progress);
    let bake = interruptible(build).map_err(of_scene)?;
    if loaded.files.iter().any(|file| is_younger(file, begun)) {
        progress.warn(&format!("{} was edited while it was baked; bake it again", args.scene));
    }
    let report = Report {
        bytes: file_bytes(&path)?,
        patches: bake.mesh.patches.len(),
        elements: bake.mesh.elements.len(),
        receivers: bake.receivers.points.len(),
        operators: operators(&bake),
        seconds: progress.phases(),
        peak_memory_bytes: peak_memory_bytes(),
        file: path,
    };
    match common.json {
        true => say!("{}", output::json(&report)),
        false => report.print(),
    }
    Ok(())
}

impl Report {
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
    let one = |baked: &patchlight::operator::BakedOperator| Operator {
        options: options_of(&baked.key),
        what: baked.operator.describe(),
    };
    bake.operators.iter().map(one).collect()
}

fn print_operators(operators: &[Operator]) {
    operators.iter().for_each(|Operator { options, what }| say!("{:14} for --method {options}: {what}", ""));
}

fn file_bytes(path: &Path) -> Result<u64, Error> {
    let read = |source| BakeError::File { path: path.display().to_string(), reason: format!("{source}") };
    Ok(std::fs::metadata(path).map_err(read)?.len())
}

/// The method and options of `render` that take an operator.
fn options_of(key: &OperatorKey) -> String {
    match *key {
        OperatorKey::Bounces { codec: Codec::LowRank { epsilon }, .. } => format!("tiles --epsilon {epsilon}"),
        OperatorKey::Bounces { codec, .. } => format!("multibounce --codec {}", codec.name()),
        OperatorKey::FormFactors { epsilon } => format!("feedback --epsilon {epsilon}"),
    }
}

/// A bake that was opened.
pub struct Opened {
    /// The scene as the application knows it.
    pub loaded: LoadedScene,
    /// The bake.
    pub bake: patchlight::Bake,
    origin: Origin,
    sections: Vec<Section>,
    has_changed: bool,
}

impl Opened {
    /// Opens and checks a bake.
    fn new(path: &Path, progress: &Progress) -> Result<Self, Error> {
        let BakeFile { bake, origin, sections } = progress.phase("open", |_| patchlight::Bake::open(path))?;
        let loaded = std::str::from_utf8(&origin.application)
            .map_err(|error| error.to_string())
            .and_then(|text| LoadedScene::of_description(bake.scene.clone(), text))
            .map_err(|reason| BakeError::Damaged {
                path: path.display().to_string(),
                part: "origin",
                offset: sections.first().map_or(0, |section| section.offset),
                reason,
            })?;
        let has_changed = has_changed(path, &loaded, &origin);
        Ok(Self { loaded, bake, origin, sections, has_changed })
    }

    /// Opens a bake, and says so where its scene has changed since.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn read(path: &Path, progress: &Progress) -> Result<Self, Error> {
        let opened = Self::new(path, progress)?;
        if opened.has_changed {
            progress.warn(&format!(
                "{} has changed since it was baked into {}; the light is that of the scene as it was: bake it again",
                opened.origin.scene,
                path.display()
            ));
        }
        Ok(opened)
    }

    /// A method with the operator that the bake has, where the options leave open which.
    ///
    /// # Errors
    /// [`Error::NotHeld`] where the bake has none that suits.
    pub fn method(
        &self,
        path: &Path,
        method: Method,
        asked: MethodSettings,
        options: &OperatorSettings,
    ) -> Result<MethodSettings, Error> {
        let Some(key) = OperatorKey::of(&asked, &self.bake.settings) else { return Ok(asked) };
        let held: Vec<OperatorKey> = self.bake.operators.iter().map(|baked| baked.key).collect();
        if self.bake.mesh.patches.is_empty() || held.contains(&key) {
            return Ok(asked);
        }
        let is_open = method == Method::Multibounce && options.codec.is_none() && options.epsilon.is_none();
        let suits = |held: &&OperatorKey| match (key, **held) {
            (OperatorKey::Bounces { codec, .. }, OperatorKey::Bounces { codec: other, .. }) => {
                let are_tiles = matches!((codec, other), (Codec::LowRank { .. }, Codec::LowRank { .. }));
                is_open || are_tiles && options.epsilon.is_none()
            }
            (OperatorKey::FormFactors { .. }, OperatorKey::FormFactors { .. }) => options.epsilon.is_none(),
            _ => false,
        };
        match (held.iter().find(suits), asked) {
            (Some(OperatorKey::Bounces { codec, .. }), _) => Ok(MethodSettings::Multibounce(*codec)),
            (Some(OperatorKey::FormFactors { epsilon }), MethodSettings::Feedback(settings)) => {
                Ok(MethodSettings::Feedback(FeedbackSettings { epsilon: *epsilon, ..settings }))
            }
            _ => {
                let asked = options_of(&key);
                let (name, more) = asked.split_once(' ').unwrap_or((&asked, ""));
                Err(Error::NotHeld {
                    path: path.to_path_buf(),
                    held: held.iter().map(options_of).collect(),
                    again: format!("--for {name} {more}"),
                    asked: asked.clone(),
                })
            }
        }
    }
}

/// What commands that write light take.
#[derive(Args, Clone, Debug)]
pub struct LightOptions {
    /// A scene file (.toml, .obj, .gltf, .glb), a built-in scene, or the bake of one.
    pub scene: String,
    #[command(flatten)]
    pub patches: PatchOptions,
    /// Most resident memory: bytes, or with K, M or G. What would take more is refused before it is begun [default: what is free].
    #[arg(long, value_parser = parse_bytes)]
    pub memory_limit: Option<u64>,
}

/// A scene whose light is written.
pub struct Lightable {
    /// The scene, its triangles cut as those of the bake.
    pub loaded: LoadedScene,
    /// Its light, without pictures.
    pub renderer: Renderer,
    /// The folder of the results, which is there.
    pub out: PathBuf,
}

impl Lightable {
    /// Opens a bake, or makes that of a scene. Results go to `--out`, or to a folder with the name of the scene and of the
    /// command.
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
        let method = match bake.scene.has_medium() {
            true => MethodSettings::FirstShot(FirstShotSettings::DEFAULT),
            false => MethodSettings::Classic,
        };
        let eye = loaded.view.eye;
        let frame = RenderSettings { method, size: (1, 1), sub_frames: 1, eye, ..RenderSettings::default() };
        let renderer = interruptible(|| Renderer::new(bake, executor, &frame, progress))?;
        Ok(Self { loaded, renderer, out })
    }
}

/// The device that is asked for; a note where it is another one than a user may expect.
///
/// # Errors
/// A device that is not there, or lacks a feature.
pub fn open_device(common: &Common, progress: &Progress) -> Result<Box<dyn Executor>, Error> {
    let (executor, note) = open(&DeviceChoice::parse(&common.device))?;
    if let Some(note) = note {
        progress.note(&note);
    }
    Ok(executor)
}

/// Where a bake on a device of this kind builds operators: there, if it was asked for by name, else if it is a graphics processor
/// that is large enough.
fn operators_on(common: &Common, kind: DeviceKind) -> BuildOn {
    match (DeviceChoice::parse(&common.device), kind) {
        (_, DeviceKind::Native) => BuildOn::Host,
        (DeviceChoice::Auto, _) => BuildOn::Auto,
        _ => BuildOn::Device,
    }
}

/// Bakes a scene on the host, or on a device that is to.
///
/// # Errors
/// As [`patchlight::Bake::build_on`]; cancellation.
pub fn build(
    device: &mut (dyn Executor + 'static),
    on: BuildOn,
    scene: &Scene,
    settings: &BakeSettings,
    progress: &Progress,
) -> Result<patchlight::Bake, patchlight::Error> {
    interruptible(|| match on.is_device(device.device().kind) {
        true => patchlight::Bake::build_on(device, scene, settings, progress),
        false => patchlight::Bake::build(scene, settings, progress),
    })
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
    let settings = BakeSettings {
        patches: patches.kind(FormFactors::Hemisphere),
        patch_count: patches.count(),
        voxel_size: patches.voxel_size,
        focus: patches.focus.unwrap_or_default().focus(&loaded, &loaded.animation),
        memory_limit: *memory_limit,
        seed: common.seed,
        ..BakeSettings::default()
    };
    let bake = build(device, BuildOn::Auto, &loaded.scene, &settings, progress);
    let bake = bake.map_err(|error| Error::of_scene(error, scene))?;
    loaded.scene = bake.scene.clone();
    Ok((loaded, Arc::new(bake)))
}

/// Whether the scene of a bake, where it still lies where it lay, is another one by now. It is only read again where one of
/// its files is younger than the bake, or gone.
fn has_changed(bake: &Path, loaded: &LoadedScene, origin: &Origin) -> bool {
    let written = std::fs::metadata(bake).and_then(|meta| meta.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    Path::new(&origin.scene).is_file()
        && loaded.files.iter().any(|file| is_younger(file, written))
        && load_or_build(&origin.scene).map_or(true, |now| now.content_hash != origin.scene_hash)
}

/// Whether a file was changed after a time, or is gone.
fn is_younger(file: &Path, than: SystemTime) -> bool {
    !std::fs::metadata(file).and_then(|meta| meta.modified()).is_ok_and(|changed| changed <= than)
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
    /// What the bake says of its own errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    energy: Option<EnergyCheck>,
    sections: Vec<Part>,
    operators: Vec<Operator>,
    /// Methods that need no operator.
    #[serde(skip)]
    methods: &'static str,
}

/// A section.
#[derive(Serialize)]
struct Part {
    name: &'static str,
    offset: u64,
    bytes: u64,
}

/// Says what a bake holds; all of it is checked.
pub fn info(common: &Common, path: &Path) -> Result<(), Error> {
    common.native_only("info")?;
    let Opened { bake, origin, sections, has_changed, .. } = Opened::new(path, &Progress::new(common.quiet))?;
    let part = |section: &Section| Part { name: section.kind.name(), offset: section.offset, bytes: section.length };
    let info = Info {
        file: path.to_path_buf(),
        bytes: file_bytes(path)?,
        scene_hash: origin.scene_hash.iter().map(|byte| format!("{byte:02x}")).collect(),
        has_changed,
        scene: origin.scene,
        settings: bake.settings,
        triangles: bake.scene.geometry.triangles.len(),
        patches: bake.mesh.patches.len(),
        elements: bake.mesh.elements.len(),
        receivers: bake.receivers.points.len(),
        interpolation_points: bake.receivers.interpolation.points.len(),
        bounces: bake.bounces,
        energy: bake.energy,
        sections: sections.iter().map(part).collect(),
        operators: operators(&bake),
        methods: match bake.scene.has_medium() {
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
        say!("{:14} {}", "settings", in_words(&self.settings));
        say!("{:14} {} triangles, {} bounces", "", self.triangles, self.bounces);
        say!("{:14} {}, {} elements", "patches", self.patches, self.elements);
        say!("{:14} {}, {} interpolation points", "receivers", self.receivers, self.interpolation_points);
        if let Some(energy) = &self.energy {
            say!("{:14} {}", "errors", energy.in_words());
        }
        for Part { name, offset, bytes } in &self.sections {
            say!("{:14} {name}: {} from byte {offset}", "section", output::bytes(*bytes));
        }
        say!("{:14} {}", "methods", self.methods);
        print_operators(&self.operators);
    }
}

/// The settings of a bake as the options have them.
fn in_words(settings: &BakeSettings) -> String {
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
    let printed = if settings.variant == Variant::Thesis { " as the thesis prints them" } else { "" };
    format!("{patches}{printed}, {estimator}, {receivers}, seed {}", settings.seed)
}
