//! The command line of the window, and the bake that it shows.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use assets::import::LoadedScene;
use clap::{ArgMatches, Args};
use patchlight::low_level::operator::Build;
use patchlight::{Bake, MethodSettings, Refinement, Scene, open};
use runtime::executor::DeviceChoice;
use serde::Serialize;
use shell::Error;
use shell::args::common::parse_size;
use shell::args::idle::warn_of_idle;
use shell::args::{
    BakeOptions, Common, DisplayOptions, Input, LocalArgs, Method, MethodOptions, OperatorSettings, TemporalOptions,
    parse_purpose,
};
use shell::opened::{Opened, best_method, open_device, operator_of};
use shell::output;
use shell::progress::{Progress, is_cancelled};

mod idle;

use crate::script::HELP;
use crate::{Baking, Display, MethodDefaults, Report, Settings};

/// Open a window on a scene or a bake: fly through it, move its lights and its sun, switch methods while it runs,
/// compare with the path tracer or a picture. A scene is baked first. F1 in the window lists the keys.
#[derive(Args, Clone, Debug)]
#[command(after_help = format!(
    "Examples:\n  \
    patchlight-view cornell\n  \
    patchlight-view sponza.toml --patch-count 2000 --size 640x360\n  \
    patchlight-view sponza.bake --method temporal\n  \
    patchlight-view office.bake --reference reference/office/full.exr\n  \
    patchlight-view atrium --script tests/view/tour.txt --out out/tour\n\n\
    Commands of a script, one a line, # begins a comment:\n  {}\n\n\
    The window needs some Vulkan driver; Mesa's lavapipe will do. docs/viewer.md has more.",
    HELP.replace('\n', "\n  ")
))]
pub struct View {
    /// A scene file (.toml, .obj, .gltf, .glb), a built-in scene, or the bake of one.
    pub scene: String,
    /// First method for indirect light [default: low_rank where there is an operator for it, else classic; firstshot in
    /// a medium].
    #[arg(long, value_parser = parse_purpose, help_heading = "Method")]
    pub method: Option<Method>,
    /// Methods whose operators are made of a scene, so that the window can switch to them: low_rank, multibounce,
    /// feedback. All others need none.
    #[arg(
        long = "for",
        value_name = "METHODS",
        value_delimiter = ',',
        default_value = "low_rank",
        value_parser = parse_purpose,
        help_heading = "Method"
    )]
    pub methods: Vec<Method>,
    /// Size of the window, pixels.
    #[arg(long, value_parser = parse_size, default_value = "1280x720", help_heading = "Picture")]
    pub size: (u32, u32),
    /// Sub-frames a pixel at first: 1, 2, 4 or 16.
    #[arg(long, default_value_t = 1, value_parser = parse_sub_frames, help_heading = "Picture")]
    pub spp: u32,
    /// Pictures a second to be kept while something moves, by fewer pixels, down to a sixteenth [default: all pixels].
    #[arg(long, value_parser = parse_fps, help_heading = "Picture")]
    pub fps: Option<f32>,
    /// Exposure and tone curve.
    #[command(flatten)]
    pub display: DisplayOptions,
    /// A picture (EXR, HDR, PNG) to compare with, in place of path tracing: of the scene's camera and lights.
    #[arg(long, help_heading = "Picture")]
    pub reference: Option<PathBuf>,
    /// A script of input events that drives the window.
    #[arg(long)]
    pub script: Option<PathBuf>,
    /// Sampled light.
    #[command(flatten)]
    pub temporal: TemporalOptions,
    /// The matrix round the camera.
    #[command(flatten)]
    pub local: LocalArgs,
    /// Other methods.
    #[command(flatten)]
    pub method_options: MethodOptions,
    /// The bake of a scene.
    #[command(flatten)]
    pub bake: BakeOptions,
    /// Its operators.
    #[command(flatten)]
    pub operators: OperatorSettings,
}

fn parse_sub_frames(text: &str) -> Result<u32, String> {
    let known = crate::state::SUB_FRAMES;
    text.parse().ok().filter(|count| known.contains(count)).ok_or_else(|| format!("`{text}`: choose from {known:?}"))
}

fn parse_fps(text: &str) -> Result<f32, String> {
    let rate = text.parse().ok().filter(|rate| (1.0..=1000.0).contains(rate));
    rate.ok_or_else(|| format!("`{text}` is no number from 1 to 1000"))
}

/// Time between looks at a bake, and the steps of its bar.
const LOOK: Duration = Duration::from_millis(10);
const STEPS: f32 = 1000.0;

/// Report of what was shown, for `--json`.
#[derive(Serialize)]
struct Summary {
    device: String,
    screen: String,
    size: (u32, u32),
    pictures: u32,
    pictures_a_second: f64,
    update_ms: f64,
    shading_ms: f64,
    presenting_ms: f64,
    longest_ms: f64,
}

/// Bakes or opens, and shows the window until it is closed.
pub fn run(common: &Common, args: &View, matches: &ArgMatches) -> Result<(), Error> {
    let progress = Progress::new(common.quiet);
    let input = Input::of(&args.scene);
    if input == Input::World {
        return Err(Error::BakeMethod { path: PathBuf::from(&args.scene) });
    }
    warn_of_idle(idle::RULES, matches, (args, input), &progress);
    output::check_out(&common.out)?;
    // Before minutes of baking.
    let display = Display::open().map_err(window)?;
    let (loaded, baking) = match input {
        Input::Bake => {
            let Opened { mut loaded, bake, .. } = Opened::read(Path::new(&args.scene), &progress)?;
            loaded.scene = args.display.with_normals(bake.scene().clone(), args.reference.is_some());
            let bake = bake.with_scene(loaded.scene.clone());
            (loaded, Baking { bake: Arc::new(bake), job: None, again: None })
        }
        Input::Scene | Input::World => bake(common, args, &progress)?,
    };
    let settings = Settings {
        device: DeviceChoice::parse(&common.device),
        size: args.size,
        method: args.method.unwrap_or_else(|| best_method(&baking.bake)).name().to_owned(),
        methods: defaults(args, loaded.exposure_stops, common.seed),
        sub_frames: args.spp,
        fps: args.fps,
        shown: args.display.shown(&loaded),
        reference: args.reference.clone(),
        script: args.script.clone(),
        out: output::folder_or(&common.out, &format!("{}-view", loaded.name)),
        seed: common.seed,
    };
    let report = display.show(&loaded, baking, &settings, &progress, &is_cancelled).map_err(window)?;
    if is_cancelled() {
        return Err(Error::Cancelled);
    }
    print(common, &report);
    Ok(())
}

fn window(error: crate::Error) -> Error {
    Error::Window(Box::new(error))
}

/// The first level of a bake of a scene, with the operators that are asked for, and the job that refines it.
fn bake<'a>(common: &'a Common, args: &'a View, progress: &'a Progress) -> Result<(LoadedScene, Baking<'a>), Error> {
    let memory_limit = args.operators.memory_limit;
    let mut loaded = output::import_within(&args.scene, memory_limit, progress)?;
    loaded.scene = args.display.with_normals(loaded.scene, args.reference.is_some());
    let of_scene = |error: patchlight::Error| Error::of_scene(error, &args.scene);
    let settings = args.bake.settings(&loaded, &loaded.animation, memory_limit, common.seed);
    let folder = output::folder_or(&common.out, &format!("{}-view", loaded.name));
    let build = Build { memory_limit, folder, ..Build::default() };
    let methods: Vec<MethodSettings> = args.methods.iter().map(|m| operator_of(&args.operators, *m)).collect();
    if args.bake.patches.voxel_size.is_none() {
        let check = |m: &MethodSettings| m.check_memory(settings.patch_count, settings.bounces, &build);
        methods.iter().try_for_each(check).map_err(of_scene)?;
    }
    // A device of its own, so that frames go on beside it.
    let device = open_device(common, progress)?;
    let refinement = move |device| {
        Refinement::default().with_methods(methods.clone()).with_build(build.clone()).with_device(Some(device))
    };
    let job = Bake::refine(&loaded.scene, &settings, refinement(device)).map_err(of_scene)?;
    let again = move |scene: &Scene| {
        let (device, _) = open(&DeviceChoice::parse(&common.device))?;
        Bake::refine(scene, &settings, refinement(device))
    };
    let first = progress.phase("first light", |steps| {
        loop {
            if let Some(bake) = job.take_newest() {
                return Some(bake);
            }
            let is_stopped = steps((STEPS * job.progress().share) as usize, STEPS as usize).is_break();
            if is_stopped || job.is_finished() {
                return job.take_newest().filter(|_| !is_stopped);
            }
            std::thread::sleep(LOOK);
        }
    });
    match first {
        Some(bake) => Ok((loaded, Baking { bake, job: Some(job), again: Some(Box::new(again)) })),
        // It has failed, or the user asked to stop.
        None => {
            job.cancel();
            Err(job.join().err().map_or(Error::Cancelled, of_scene))
        }
    }
}

fn defaults(args: &View, exposure_stops: f32, seed: u32) -> MethodDefaults {
    MethodDefaults {
        feedback: args.method_options.feedback(&args.operators),
        temporal: args.temporal.settings(seed),
        local: args.local.options(exposure_stops),
        first_shot: args.method_options.first_shot(),
    }
}

fn print(common: &Common, report: &Report) {
    let Report { device, screen, size, rate } = report;
    let Some(rate) = rate else { return };
    if common.json {
        let [update_ms, shading_ms, presenting_ms] = rate.means;
        say!(
            "{}",
            output::json(&Summary {
                device: device.clone(),
                screen: screen.clone(),
                size: *size,
                pictures: rate.frames,
                pictures_a_second: rate.per_second,
                update_ms,
                shading_ms,
                presenting_ms,
                longest_ms: rate.longest,
            })
        );
        return;
    }
    say!("{:14} {device}; window: {screen}; last picture {} x {}", "device", size.0, size.1);
    say!("{:14} {}", "rate", rate.summary());
}
