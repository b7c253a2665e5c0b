//! The command line.

mod bake;
mod idle;
mod input;
mod local;
mod method;
mod operator;

use std::path::PathBuf;

use clap::{ArgMatches, Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand, ValueEnum};
use temporal::{Blend, MOST_SAMPLES, Settings};

use experiments::args::{
    Animate, Bench, CameraPath, Common, FocusChoice, Patches, parse_epsilon, parse_focus, parse_metres, parse_size,
};

use assets::procedural;

use super::bake::Bake;
use super::export::Export;
use super::illuminance::Illuminance;
use super::view::View;
use super::world::{Merge, World};
use patches::PatchKind;
use patchlight::MethodSettings;
use patchlight::method::TemporalSettings;
use patchlight::method::solved::{Links, Samples, Solver};
use patchlight::method::temporal::{RowKind, Sampled};

pub use bake::{BakeOptions, OperatorSettings};
pub use idle::{warn_of_idle, warn_of_idle_in_bake, warn_of_idle_in_info, warn_of_idle_in_view};
pub use input::{Input, kind};
pub use local::LocalArgs;
pub use method::MethodOptions;
pub use operator::{BuildPlace, Decoding, OperatorOptions, Storage};

/// Diffuse global illumination by radiosity, fast enough for every frame.
#[derive(Parser, Debug)]
#[command(
    name = "patchlight",
    version,
    about,
    after_help = "Examples:\n  \
        patchlight                                   demo: pictures and out/report.html\n  \
        patchlight render atrium --method classic    render a built-in scene\n  \
        patchlight render room.glb --out out/room    render your own scene\n  \
        patchlight bake room.glb -o room.bake        bake it once, for `render room.bake`\n  \
        patchlight view room.bake                    a window on it: fly, move its lights\n  \
        patchlight export room.glb --lightmap        its light in files for an engine\n  \
        patchlight compare ours.exr reference.exr    print the differences\n  \
        patchlight bench patches                     the experiments: tables, plots, report\n  \
        patchlight devices                           what can run the kernels"
)]
pub struct Cli {
    /// What to do; without a command, the demo.
    #[command(subcommand)]
    pub command: Option<Command>,
    #[command(flatten)]
    pub common: Common,
    /// Shortens the demo: smaller pictures, fewer frames and samples.
    #[arg(long)]
    pub fast: bool,
}

impl Cli {
    /// Reads the command line; what is wrong with it ends the process with exit code 2. Also gives what was found, for questions
    /// that only it answers.
    pub fn read() -> (Self, ArgMatches) {
        let matches = Self::definition().get_matches();
        let cli = Self::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
        (cli, matches)
    }

    /// The definition, with numbers below 0 as values: they are refused by name where they cannot stand.
    fn definition() -> clap::Command {
        let negative = |arg: clap::Arg| match arg.get_action().takes_values() {
            true => arg.allow_negative_numbers(true),
            false => arg,
        };
        Self::command().mut_args(negative).mut_subcommands(|command| command.mut_args(negative))
    }
}

/// The commands.
#[derive(Subcommand, Debug)]
pub enum Command {
    /// Light a scene and write pictures (PNG, EXR) and summary.json.
    #[command(after_help = "Examples:\n  \
        patchlight render cornell --method classic --patch-count 4000\n  \
        patchlight render sponza.toml --method tiles --patch-count 10000 --epsilon 0.02\n  \
        patchlight render sponza.toml --method temporal --samples 64 --frames 120 --animate sun\n  \
        patchlight render sponza.toml --method local --slots 1024 --path fly --animate still --frames 120\n  \
        patchlight render sponza.bake --method tiles --frames 120 --animate sun\n  \
        patchlight render city.bake --method local --path fly --frames 300 --out out/city\n  \
        patchlight render sponza.toml --method path --spp 128 --resume --out out/sponza\n  \
        patchlight render cornell.toml --method classic --reference reference/cornell\n  \
        patchlight render office --method firstshot --error 0.02")]
    Render(Render),
    View(View),
    Bake(Bake),
    World(World),
    Merge(Merge),
    Export(Export),
    Illuminance(Illuminance),
    /// Compare two pictures: MSE, PSNR, SSIM, FLIP, block errors; leaks, stains, blotches and noise, counted in pixels.
    #[command(
        after_help = "Examples:\n  patchlight compare ours.exr reference.exr --stops 1.8 --difference diff.png\n  \
        patchlight compare indirect.exr ref/indirect.exr --reference-error ref/indirect-error.exr --marked marked\n\n\
        Faults, of luminance (--reference-error: only differences beyond three standard errors count):\n  \
        leaks      share of pixels brighter than the reference by more than 10 % of the mean of --indirect\n  \
        stains     share of pixels darker than the reference by more than 25 % of its value\n  \
        blotches   relative error of means over 16 x 16, 32 x 32 and 64 x 64 pixels, 95th percentile\n  \
        noise      share of pixels whose displayed values differ by more than 1/255"
    )]
    Compare(Compare),
    /// Run an experiment and write its tables, plots and pictures.
    #[command(after_help = "Examples:\n  \
        patchlight bench operator sponza.toml --counts 10000 --epsilons 0.03,0.01\n  \
        patchlight bench patches sponza.toml --references reference --counts 2000,5000 --densities 1\n  \
        patchlight bench clean --references\n  \
        patchlight bench clean rooms:wall=0 office:ground=1000 --paths 256\n\n\
        Experiments:\n  \
        clean      noise, leaks, stains and blotches of pictures against converged references, with pictures that mark them;\n             \
        bench clean --references makes the references\n  \
        patches    errors of voxel, axis and cluster patches over their number and that of receivers, beside the voxelisation\n             \
        proxy; where the error is; lights that the bake has not seen\n  \
        operator   bytes, errors and time of compressed operators over the error that is asked for\n  \
        temporal   time, memory, jumps of the lights and noise at rest of sampled light, and its pictures\n  \
        local      work, time and memory of the matrix round a camera on three paths, its pictures beside full radiosity\n  \
        table3     what is in view by tiles and sampled, beside DDGI, LPV, baked volumes and path tracing: time, memory, pictures,\n             \
        points, jumps of the lights\n  \
        thesis     figures of the thesis, as printed beside ours: bench thesis 5.3 cornell; bench thesis lists them
  \
        report     lab/docs/experiments.md and its plots from lab/docs/data (another folder: --out)\n  \
        all        every experiment, one after the other; with --quick in minutes\n  \
        firstshot  photons and time to an error, first shot against photons from the lights")]
    Bench(Bench),
    /// List the devices that can run the kernels.
    Devices,
    /// Say what a scene file holds: triangles, areas, materials, lights, memory; with --patches also what patches it gives, with
    /// --operator what the operator of the light between them takes and loses. Or what a bake holds, which is checked: its
    /// sections and their bytes, settings, scene, and whether that has changed since.
    #[command(after_help = "Examples:\n  patchlight info sponza.toml\n  patchlight info sponza.bake\n  \
        patchlight info atrium:50000 --json\n  patchlight info sponza.toml --patches axis --patch-count 10000\n  \
        patchlight info atrium --operator --codec bc1 --out out/matrix")]
    Info {
        /// A scene file (.toml, .obj, .gltf, .glb), a bake, or a built-in scene.
        scene: String,
        #[command(flatten)]
        patches: PatchOptions,
        #[command(flatten)]
        operator: OperatorOptions,
    },
    /// Write a built-in scene as files: scene .toml, .obj, .mtl and textures.
    #[command(after_help = format!(
        "Examples:\n  patchlight scene atrium:20000 --out my-atrium\n  \
        patchlight scene rooms:wall=0.1,ground=1000 --out rooms\n\n{}",
        procedural::help()
    ))]
    Scene {
        /// NAME, NAME:TRIANGLES or NAME:KEY=VALUE,KEY=VALUE.
        name: String,
    },
}

/// How the light is found.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Classic radiosity: patches of any kind, one product a bounce.
    Classic,
    /// All bounces in one product with an operator that is stored as --codec says.
    Multibounce,
    /// Short for --method multibounce --codec tiles.
    Tiles,
    /// One product a frame with compressed form factors, from the light of the frame before.
    Feedback,
    /// A few samples a row and frame, from the light of the frame before: --samples, --blend, --control-variate.
    Temporal,
    /// All bounces in one product, with the matrix of the patches round the camera: --slots, --budget, --look-ahead, --fade.
    Local,
    /// Photons that start where lights fall first, until the error is what --error says.
    Firstshot,
    /// Path tracing on the CPU, the reference.
    Path,
}

impl Method {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Classic => "classic",
            Self::Multibounce => "multibounce",
            Self::Tiles => "tiles",
            Self::Feedback => "feedback",
            Self::Temporal => "temporal",
            Self::Local => "local",
            Self::Firstshot => "firstshot",
            Self::Path => "path",
        }
    }
}

/// What frames of --method temporal do.
#[derive(Args, Clone, Copy, Debug, PartialEq)]
pub struct TemporalOptions {
    /// Samples a row and frame (temporal).
    #[arg(long, default_value_t = Settings::default().samples, value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_SAMPLES)))]
    pub samples: u32,
    /// Weight of the frames before, from 0 to below 1, or auto: from the noise of the samples and the change of the light
    /// (temporal without control variate).
    #[arg(long, default_value = "auto", value_parser = parse_blend)]
    pub blend: Blend,
    /// Whether only what changes is sampled, so that light at rest has no noise (temporal).
    #[arg(long, value_enum, default_value_t = Switch::On)]
    pub control_variate: Switch,
    /// Frames in which each row is once summed exactly (temporal with control variate); 0 for never.
    #[arg(long, default_value_t = Settings::default().refresh, value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    pub refresh: u32,
    /// Whether samples are points of a lattice, rotated by chance, or independent (temporal).
    #[arg(long, value_enum, default_value_t = Switch::On)]
    pub rotated: Switch,
    /// How rows between patches are kept (temporal).
    #[arg(long, value_enum, default_value_t = RowStorage::Lists)]
    pub rows: RowStorage,
    /// Which rows are sampled (temporal); the others are multiplied by.
    #[arg(long, value_enum, default_value_t = SampledRows::Patches)]
    pub sampled: SampledRows,
}

/// On or off.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Switch {
    /// Yes.
    On,
    /// No.
    Off,
}

/// How rows are kept for sampling.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowStorage {
    /// Lists of columns, all entries alike.
    Lists,
    /// Alias tables.
    Tables,
    /// Alias tables of all bounces in three channels: every bounce lags alike; for few patches, and albedo that stays.
    AllBounces,
}

/// Which rows are sampled.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampledRows {
    /// From patch to patch.
    Patches,
    /// Those to elements and to receivers, too.
    All,
}

impl TemporalOptions {
    /// The settings of the method.
    pub fn settings(&self, seed: u32) -> TemporalSettings {
        let settings = Settings {
            samples: self.samples,
            blend: self.blend,
            control_variate: self.control_variate == Switch::On,
            rotated: self.rotated == Switch::On,
            refresh: self.refresh,
            seed,
        };
        let rows = match self.rows {
            RowStorage::Lists => RowKind::Lists,
            RowStorage::Tables => RowKind::Tables,
            RowStorage::AllBounces => RowKind::AllBounces,
        };
        let sampled = match self.sampled {
            SampledRows::Patches => Sampled::Patches,
            SampledRows::All => Sampled::All,
        };
        TemporalSettings { settings, rows, sampled }
    }
}

/// What patches are made, and how many.
#[derive(Args, Clone, Copy, Debug, PartialEq)]
pub struct PatchOptions {
    /// What patches are [default: cluster, or polygon where form factors are not by rays].
    #[arg(long, value_enum)]
    pub patches: Option<Patches>,
    /// Patches, about [default: 4000].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=65_535))]
    pub patch_count: Option<u32>,
    /// Edge of the voxels of voxel and axis patches, m; replaces --patch-count.
    #[arg(long, value_name = "METRES", value_parser = parse_metres)]
    pub voxel_size: Option<f32>,
    /// Where patches and receivers stand close: auto, camera, or a box as X,Y,Z,X,Y,Z (m): enclosed space, what the camera sees
    /// round it, or what is given. What is far from there gets few, large ones [default: auto].
    #[arg(long, value_name = "auto|camera|BOX", allow_hyphen_values = true, value_parser = parse_focus)]
    pub focus: Option<FocusChoice>,
}

impl PatchOptions {
    /// How many patches.
    pub fn count(&self) -> usize {
        self.patch_count.unwrap_or(4000) as usize
    }

    /// What they are made of for an estimator of form factors: all but rays need outlines.
    pub fn kind(&self, form_factors: FormFactors) -> PatchKind {
        match (self.patches, form_factors) {
            (Some(patches), _) => patches.kind(),
            (None, FormFactors::Hemisphere) => PatchKind::Cluster,
            (None, FormFactors::Contour | FormFactors::Area | FormFactors::Point) => PatchKind::Polygon,
        }
    }

    /// Whether any of them was given.
    pub fn is_given(&self) -> bool {
        self.patches.is_some() || self.patch_count.is_some() || self.voxel_size.is_some() || self.focus.is_some()
    }
}

/// Where irradiance is gathered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ReceiverPlaces {
    /// Points of the surface, close where light bends; pixels take the mean of those about.
    Mesh,
    /// Every visible point, with nothing in between: slow, for measuring (try --receiver-rays 64 --spp 1).
    Pixels,
    /// The voxel or axis patches themselves; pixels take the mean of those about.
    #[value(name = "self")]
    Patches,
}

/// How pixels find direct light of sky, rectangles and emissive triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DirectLight {
    /// Without noise: the sky at the receivers; the others exactly where nothing is in the way, times what shadow rays of a
    /// fixed pattern see. With receivers on the mesh only, else sampled.
    Smooth,
    /// By random rays in each sub-frame.
    Sampled,
}

/// Estimator of the form factors.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum FormFactors {
    /// Cosine-weighted rays.
    Hemisphere,
    /// Lambert's contour formula with shadow rays: exact where nothing hides.
    Contour,
    /// Pairs of points on both patches.
    Area,
    /// One point a patch.
    Point,
}

/// Solvers of classic radiosity.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ClassicSolver {
    /// Gathering, one bounce a product.
    #[default]
    Jacobi,
    /// Gathering in place.
    GaussSeidel,
    /// Progressive shooting: the patch with most unsent light sends it.
    Shooting,
    /// Elimination of the whole system.
    Lu,
    /// Shooting by chance, a bounce at a time.
    StochasticJacobi,
    /// Walks of light by chance.
    RandomWalks,
    /// Links between parts of polygons, as large as their light lets them be (with --patches polygon).
    Hierarchical,
}

impl ClassicSolver {
    /// The method of the solver.
    pub fn method(self, count: u32, link_error: f64, seed: u32) -> MethodSettings {
        let samples = Samples { count, seed };
        MethodSettings::Solved(match self {
            Self::Jacobi => return MethodSettings::Classic,
            Self::GaussSeidel => Solver::GaussSeidel,
            Self::Shooting => Solver::Shooting,
            Self::Lu => Solver::Lu,
            Self::StochasticJacobi => Solver::StochasticJacobi(samples),
            Self::RandomWalks => Solver::RandomWalks(samples),
            Self::Hierarchical => Solver::Hierarchical(Links { error: link_error, seed }),
        })
    }
}

/// `patchlight render`.
#[derive(Args, Debug)]
pub struct Render {
    /// A scene file (.toml, .obj, .gltf, .glb), a bake, or a built-in scene with its parameters, as in atrium:20000 or
    /// rooms:wall=0.1,ground=1000 (`patchlight scene --help` lists them).
    pub scene: String,
    /// How the light is found.
    #[arg(long, value_enum, default_value_t = Method::Classic)]
    pub method: Method,
    /// Frames; with more than one the scene's lights move, and frames.csv and report.html say what each measured.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub frames: u32,
    /// How lights move from frame to frame.
    #[arg(long, value_enum, default_value_t = Animate::Path)]
    pub animate: Animate,
    /// Also find the light of each frame by exact products, and write the error of each into frames.csv (not path).
    #[arg(long)]
    pub errors: bool,
    #[command(flatten)]
    pub temporal: TemporalOptions,
    #[command(flatten)]
    pub local: LocalArgs,
    /// How the camera moves from frame to frame; then lights move as --animate says, but for a camera of their path.
    #[arg(long, value_enum)]
    pub path: Option<CameraPath>,
    /// Picture size [default: that of the reference, else 960x540].
    #[arg(long, value_parser = parse_size)]
    pub size: Option<(u32, u32)>,
    /// Sub-frames (classic) or paths (path) a pixel [default: 16 and 64].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub spp: Option<u32>,
    #[command(flatten)]
    pub bake: BakeOptions,
    #[command(flatten)]
    pub operators: OperatorSettings,
    /// What traces the rays and random walks of the bake, and builds the operator between patches (multibounce, tiles): auto takes
    /// the device of --device when it is a graphics processor.
    #[arg(long, value_enum, default_value_t = BuildPlace::Auto)]
    pub build_on: BuildPlace,
    /// How the bounces of --method classic are found: jacobi takes one product a bounce on the device, the others are the host's,
    /// for comparison.
    #[arg(long, value_enum, default_value_t)]
    pub solver: ClassicSolver,
    /// Samples that the light is cut into by --solver stochastic-jacobi and random-walks.
    #[arg(long, default_value_t = 1_000_000, value_parser = clap::value_parser!(u32).range(1..=1 << 30))]
    pub solver_samples: u32,
    /// Most light that a link of --solver hierarchical carries before it is split, as a share of the emitted power.
    #[arg(long, default_value_t = Links::default().error, value_parser = parse_epsilon)]
    pub link_error: f64,
    /// What decodes texture blocks on a Vulkan device (multibounce with --codec bc1, bc3, bc6h, bc7).
    #[arg(long, value_enum, default_value_t)]
    pub decode: Decoding,
    #[command(flatten)]
    pub methods: MethodOptions,
    /// How pixels find direct light of sky, rectangles and emissive triangles.
    #[arg(long, value_enum, default_value_t = DirectLight::Smooth)]
    pub direct: DirectLight,
    /// Folder with full.exr, indirect.exr, points.csv to compare with; OUT/points.csv then has the error of each point, worst
    /// first.
    #[arg(long)]
    pub reference: Option<PathBuf>,
    /// Also write pictures into OUT/debug: colours by patch, element, axis and receiver, E and H of
    /// the patches, where receivers were refined; with --reference the blocks that are worst
    /// (classic).
    #[arg(long)]
    pub debug: bool,
    /// Also write the frame graph in Graphviz' language: passes with their times, buffers with sizes and lifetimes, barriers.
    #[arg(long, value_name = "FILE")]
    pub graph: Option<PathBuf>,
    /// Continue an interrupted path-traced picture in the same folder.
    #[arg(long)]
    pub resume: bool,
}

/// `patchlight compare`.
#[derive(Args, Debug)]
pub struct Compare {
    /// Our picture (EXR, HDR or PNG).
    pub ours: PathBuf,
    /// What it should be.
    pub reference: PathBuf,
    /// Picture whose black pixels are left out.
    #[arg(long)]
    pub mask: Option<PathBuf>,
    /// Exposure before tone mapping, in stops; without it 0.18 over the reference's log-average.
    #[arg(long, allow_hyphen_values = true)]
    pub stops: Option<f32>,
    /// Write a picture of the difference: red where ours is brighter, blue where it is darker, white where equal, by up to half of
    /// the reference.
    #[arg(long)]
    pub difference: Option<PathBuf>,
    /// Make that the absolute difference times this, exposed as the pictures are: black where equal.
    #[arg(long, value_name = "FACTOR", requires = "difference", value_parser = parse_gain)]
    pub difference_gain: Option<f32>,
    /// Standard error of the reference as a picture; differences of at most three of them are no leaks, stains or blotches.
    #[arg(long, value_name = "PICTURE")]
    pub reference_error: Option<PathBuf>,
    /// The reference's indirect light, by whose mean leaks are measured [default: the reference].
    #[arg(long, value_name = "PICTURE")]
    pub indirect: Option<PathBuf>,
    /// Write faults.png (leaks red, stains blue), noise.png and blotches.png into this folder.
    #[arg(long, value_name = "FOLDER")]
    pub marked: Option<PathBuf>,
}

/// A number of bounces, or all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bounces {
    /// This many.
    Count(u32),
    /// Until nothing changes.
    All,
}

fn parse_bounces(text: &str) -> Result<Bounces, String> {
    if text == "all" {
        return Ok(Bounces::All);
    }
    match text.parse() {
        Ok(count) if (1..=1000).contains(&count) => Ok(Bounces::Count(count)),
        _ => Err(format!("`{text}` is neither `all` nor a number from 1 to 1000")),
    }
}

pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let wrong = || format!("`{text}` is no number of bytes; write for example 2G or 800M");
    let (digits, shift) = match text.char_indices().last() {
        Some((at, 'K' | 'k')) => (&text[..at], 10),
        Some((at, 'M' | 'm')) => (&text[..at], 20),
        Some((at, 'G' | 'g')) => (&text[..at], 30),
        _ => (text, 0),
    };
    let number: f64 = digits.parse().map_err(|_| wrong())?;
    let bytes = number * f64::from(1u32 << shift);
    if bytes.is_finite() && (1.0..1e15).contains(&bytes) { Ok(bytes as u64) } else { Err(wrong()) }
}

fn parse_gain(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(gain) if gain > 0.0 && f32::is_finite(gain) => Ok(gain),
        _ => Err(format!("`{text}` is no factor: a number above 0")),
    }
}

fn parse_blend(text: &str) -> Result<Blend, String> {
    match text.parse() {
        _ if text == "auto" => Ok(Settings::default().blend),
        Ok(w) if (0.0..1.0).contains(&w) => Ok(Blend::Fixed(w)),
        _ => Err(format!("`{text}` is neither `auto` nor a number of at least 0 and below 1")),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_definition_holds_together() {
        Cli::command().debug_assert();
    }

    #[test]
    fn blends() {
        assert_eq!(parse_blend("0.9"), Ok(Blend::Fixed(0.9)));
        assert!(matches!(parse_blend("auto"), Ok(Blend::Auto { .. })));
        for wrong in ["1", "-0.1", "NaN", "often", ""] {
            assert!(parse_blend(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn bytes() {
        assert_eq!(parse_bytes("2G"), Ok(2 << 30));
        assert_eq!(parse_bytes("1.5m"), Ok(3 << 19));
        assert_eq!(parse_bytes("4096"), Ok(4096));
        for wrong in ["", "G", "-1", "2T", "nan", "inf", "0", "1e99"] {
            assert!(parse_bytes(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn bad_options_of_frames_end_with_code_2() {
        let parse = |option: &str, value: &str| {
            Cli::try_parse_from(["patchlight", "render", "cornell", "--method", "temporal", option, value])
        };
        for (option, good, bad) in [
            ("--samples", "16", ["0", "65537", "few"]),
            ("--blend", "0.5", ["1", "2", "never"]),
            ("--control-variate", "off", ["0", "maybe", ""]),
            ("--refresh", "0", ["-1", "1.5", "1000001"]),
            ("--rows", "tables", ["table", "csr", ""]),
            ("--sampled", "all", ["none", "some", ""]),
            ("--animate", "sun", ["moon", "1", ""]),
            ("--path", "fly", ["walk", "1", ""]),
            ("--slots", "64", ["3", "32769", "many"]),
            ("--budget", "1", ["0", "-1", "all"]),
            ("--look-ahead", "0", ["-1", "1001", "far"]),
            ("--fade", "1", ["0", "1001", "slow"]),
            ("--build-on", "device", ["gpu", "1", ""]),
            ("--memory-limit", "800M", ["0", "much", ""]),
        ] {
            assert!(parse(option, good).is_ok(), "{option} {good}");
            for value in bad {
                assert_eq!(parse(option, value).unwrap_err().exit_code(), 2, "{option} {value}");
            }
        }
    }

    #[test]
    fn sizes_and_bounces() {
        assert_eq!(parse_size("960x540"), Ok((960, 540)));
        for wrong in ["", "960", "960x", "x540", "0x10", "-5x10", "20000x10", "1e9x2"] {
            assert!(parse_size(wrong).is_err(), "{wrong}");
        }
        assert_eq!(parse_bounces("all"), Ok(Bounces::All));
        assert_eq!(parse_bounces("3"), Ok(Bounces::Count(3)));
        for wrong in ["0", "-1", "many", "1001"] {
            assert!(parse_bounces(wrong).is_err(), "{wrong}");
        }
    }
}
