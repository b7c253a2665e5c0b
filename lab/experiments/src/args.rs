//! Options that all commands share, and those of the experiments.

use std::path::{Path, PathBuf};

use assets::{Animation, LoadedScene};
use clap::{Args, ValueEnum};
use glam::Vec3;
use multibounce::BlockCodec;
use patches::{Focus, PatchKind};
use patchlight::method::FirstShotSettings;
use patchlight::{BakeSettings, Variant};

use runtime::executor::DeviceChoice;

use crate::bench::Part;
use crate::error::Error;

/// Options of every command.
#[derive(Args, Debug, Clone)]
pub struct Common {
    /// auto, cpu, vulkan, an index of `patchlight devices`, or part of a device's name.
    #[arg(long, global = true, default_value = "auto")]
    pub device: String,
    /// Threads of the CPU; 0 takes one a core.
    #[arg(long, global = true, default_value_t = 0, value_parser = parse_threads)]
    pub threads: usize,
    /// Changes every random number; the same seed gives the same bytes.
    #[arg(long, global = true, default_value_t = 0)]
    pub seed: u32,
    /// Folder for results (demo: out; render: out/SCENE-METHOD).
    #[arg(long, short, global = true)]
    pub out: Option<PathBuf>,
    /// No progress bars, no notes; warnings and errors remain.
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Print the summary as JSON on standard output.
    #[arg(long, global = true)]
    pub json: bool,
}

impl Common {
    /// Refuses a device where only native code works, in place of ignoring it.
    ///
    /// # Errors
    /// [`Error::NoDevice`] unless the device is left to the program, or native code.
    pub fn native_only(&self, command: &'static str) -> Result<(), Error> {
        match DeviceChoice::parse(&self.device) {
            DeviceChoice::Auto | DeviceChoice::Cpu => Ok(()),
            _ => Err(Error::NoDevice { command, device: self.device.clone() }),
        }
    }
}

/// How lights move.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Animate {
    /// Along the scene's own path, or a made-up one; the camera too.
    #[default]
    Path,
    /// Only suns move, the camera rests.
    Sun,
    /// They jump at a third of the frames, and back at two thirds; the camera rests.
    Jump,
    /// Nothing moves.
    Still,
}

/// Kinds of patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Patches {
    /// Triangles cut into like parts.
    Polygon,
    /// Samples of the surface gathered by what they see: any mesh in as many patches as wanted.
    Cluster,
    /// Samples of each voxel gathered where position and normal are alike.
    Voxel,
    /// Samples of each voxel shared out over the six directions of the axes.
    Axis,
}

impl Patches {
    /// Their kind.
    pub fn kind(self) -> PatchKind {
        match self {
            Self::Polygon => PatchKind::Polygon,
            Self::Cluster => PatchKind::Cluster,
            Self::Voxel => PatchKind::Voxel,
            Self::Axis => PatchKind::Axis,
        }
    }
}

/// Which form of the equations of patches is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum VariantChoice {
    /// Ours.
    #[default]
    Corrected,
    /// As the thesis prints them, for comparison.
    Thesis,
}

impl VariantChoice {
    /// The form.
    pub fn variant(self) -> Variant {
        match self {
            Self::Corrected => Variant::Corrected,
            Self::Thesis => Variant::Thesis,
        }
    }
}

/// Times at which a camera that moves is asked where it is.
const EYES: u16 = 9;

/// Where people look.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum FocusChoice {
    /// In enclosed space.
    #[default]
    Auto,
    /// Where the camera is.
    Camera,
    /// In a box.
    Box {
        /// Least coordinates, m.
        low: Vec3,
        /// Greatest coordinates, m.
        high: Vec3,
    },
}

impl FocusChoice {
    /// The focus in a scene with a camera that may move.
    pub fn focus(self, loaded: &LoadedScene, animation: &Animation) -> Focus {
        match self {
            Self::Auto => Focus::Auto,
            Self::Box { low, high } => Focus::Box { low, high },
            Self::Camera => {
                let time = |k: u16| animation.duration() * f32::from(k) / f32::from(EYES - 1);
                let mut eyes: Vec<Vec3> = (0..EYES).map(|k| animation.at(time(k)).1.eye).collect();
                eyes.dedup();
                Focus::seen_from(&loaded.scene, &eyes)
            }
        }
    }
}

/// A focus: auto, camera, or the least and the greatest coordinates of a box.
///
/// # Errors
/// Text that is none.
pub fn parse_focus(text: &str) -> Result<FocusChoice, String> {
    match text {
        "auto" => return Ok(FocusChoice::Auto),
        "camera" => return Ok(FocusChoice::Camera),
        _ => {}
    }
    let wrong = || {
        format!("`{text}` is no focus; write auto, camera, or a box as X,Y,Z,X,Y,Z: its least and greatest corner, m")
    };
    let numbers: Result<Vec<f32>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    let [a, b, c, d, e, f] = numbers.map_err(|_| wrong())?[..] else { return Err(wrong()) };
    let (low, high) = (Vec3::new(a, b, c), Vec3::new(d, e, f));
    let is_box = low.is_finite() && high.is_finite() && low.cmple(high).all();
    if is_box { Ok(FocusChoice::Box { low, high }) } else { Err(wrong()) }
}

/// Experiments.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Experiment {
    /// Kinds and numbers of patches, receivers on the mesh.
    Patches,
    /// The operator of all bounces: bytes and time over the error of its compression.
    #[value(alias = "compression")]
    Operator,
    /// Sampled light beside exact products: time, memory, jumps of the lights, noise at rest, pictures.
    Temporal,
    /// Ways to spread a product over frames, two of them naive, and the weight of the frames before: light while lights move.
    Spread,
    /// The matrix round a camera that moves, beside full radiosity: work, time, memory, pictures.
    Local,
    /// Photons to an error: from where lights fall first, and from the lights.
    Firstshot,
    /// What a person sees wrong in pictures: noise, leaks, stains, blotches, against converged references.
    Clean,
    /// Whole light updates: lights that move, lights that rest, a lamp that is switched, for every receiver and for those in
    /// view; where the time goes, and how far from the bandwidth that is.
    Frame,
    /// Time of products and of sampled light over the number of patches: `thesis table1`.
    Table1,
    /// Errors of products and of sampled light against path tracing: `thesis table2`.
    Table2,
    /// What is in view by tiles and sampled, beside every baseline and opponent: time, memory, pictures, points.
    Table3,
    /// Time of the light over the number of bounces: `thesis 3.10`.
    Bounces,
    /// A figure of the thesis, as printed beside ours: `thesis 5.3 [SCENES]`; `thesis` alone lists them.
    Thesis,
    /// Light behind walls, for every kind of method, in scenes with thin walls.
    Leaks,
    /// Frames until a jump of the lights is followed, and noise at rest, for every kind of method.
    Step,
    /// Errors over albedo, with colours and textures, for every kind of method.
    Materials,
    /// Errors under lights that no bake has seen, for every kind of method.
    Unseen,
    /// Light updates and memory over patches, receivers, triangles, lights and pixels.
    Scaling,
    /// lab/docs/experiments.md and its plots from lab/docs/data.
    Report,
    /// Every experiment, one after the other.
    All,
}

/// `patchlight bench`.
#[derive(Args, Clone, Debug)]
pub struct Bench {
    /// The experiment.
    #[arg(value_enum)]
    pub name: Experiment,
    /// Scene files or built-in scenes, for thesis behind the figure [default: clean rooms stripes blinds clutter window corridor, leaks rooms corridor blinds
    /// clutter, frame and scaling office, materials cornell, table3, step and unseen cornell office, others cornell atrium; leaks,
    /// table3 and unseen the shared ones, too].
    pub scenes: Vec<String>,
    /// Patches [default: patches 1000,2000,5000,10000,20000, clean and firstshot 4000, scaling 512 to 262144, leaks,
    /// materials, spread, step, table3 and unseen 2000, thesis by figure, curves 1000,2000,4000,10000,20000 (clean), others 10000].
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=65_535))]
    pub counts: Vec<u32>,
    /// Where patches and receivers stand close: auto, camera, or a box as X,Y,Z,X,Y,Z (m): enclosed space, what the camera sees
    /// round it, or what is given (clean, frame, leaks, local, materials, scaling, step, table3, temporal, unseen).
    #[arg(long, default_value = "auto", value_name = "auto|camera|BOX", allow_hyphen_values = true, value_parser = parse_focus)]
    pub focus: FocusChoice,
    /// Relative errors (Frobenius) of compressed operators.
    #[arg(long, value_delimiter = ',', default_value = "0.05,0.03,0.02,0.01,0.005", value_parser = parse_epsilon)]
    pub epsilons: Vec<f64>,
    /// Texture blocks that are measured beside tiles, or none (operator).
    #[arg(long, value_delimiter = ',', value_enum, default_value = "bc1,bc3,bc6h,bc7")]
    pub codecs: Vec<Blocks>,
    /// Relative error of the patches' irradiance (firstshot).
    #[arg(long, default_value_t = FirstShotSettings::default().error, value_parser = parse_error)]
    pub error: f64,
    /// Most photons (firstshot).
    #[arg(long, default_value_t = FirstShotSettings::default().most_photons, value_parser = clap::value_parser!(u64).range(1..=1 << 33))]
    pub photons: u64,
    /// Receivers for each that there is by default.
    #[arg(long, value_delimiter = ',', default_value = "0.5,1,2", value_parser = parse_density)]
    pub densities: Vec<f32>,
    /// Kinds of patches [default: patches voxel,axis,cluster, operator cluster].
    #[arg(long, value_delimiter = ',', value_enum)]
    pub kinds: Vec<Patches>,
    /// Parts of the experiment (patches).
    #[arg(long, value_delimiter = ',', value_enum, default_value = "patches,break-down,lights")]
    pub parts: Vec<Part>,
    /// Folder whose folder SCENE holds full.exr, indirect.exr and points.csv to compare with; scenes without are path traced. For
    /// clean, without a folder: make the references of the scenes, or go on with them, and measure nothing.
    #[arg(long, num_args = 0..=1, value_name = "FOLDER")]
    pub references: Option<Option<PathBuf>>,
    /// Paths a pixel of references that are made (clean) [default: 2048 with --references; else those at hand are taken].
    #[arg(long, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    pub paths: Option<u32>,
    /// Folder where references are kept (clean, leaks) [default: clean patchlight/references in the user's cache folder, leaks
    /// OUT/references].
    #[arg(long, value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
    /// Size of path-traced references, or of the view of frames [default: frame 960x540, clean, leaks,
    /// materials, scaling, step, table3, thesis and unseen 240x135, others 480x360].
    #[arg(long, value_parser = parse_size)]
    pub size: Option<(u32, u32)>,
    /// Paths a pixel of path-traced references; half of them in each of two independent pictures, which tell their noise.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    pub spp: u32,
    /// Sub-frames of a picture.
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub sub_frames: u32,
    /// Frames whose times give the median, or whose mean is judged (clean) [default: frame 30, clean 16, table3 9,
    /// scaling 5, others 3].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub frames: Option<u32>,
    /// Rays a row of the form factors.
    #[arg(long, default_value_t = 4096, value_parser = clap::value_parser!(u32).range(16..=131_072))]
    pub rays: u32,
    /// Rays from each receiver [default: operator as many as --rays, others 1024].
    #[arg(long, value_parser = clap::value_parser!(u32).range(16..=131_072))]
    pub receiver_rays: Option<u32>,
    /// Receivers of the operator from patches to receivers, 0 to leave it out (operator).
    #[arg(long, default_value_t = 160_000, value_parser = clap::value_parser!(u32).range(0..=4_000_000))]
    pub receivers: u32,
    /// Relative errors (Frobenius) of the same, compressed.
    #[arg(long, value_delimiter = ',', default_value = "0.05,0.03", value_parser = parse_epsilon)]
    pub receiver_epsilons: Vec<f64>,
    /// Distances between probes, m; shares of 8 m in scenes that are smaller (table3; the least of leaks, materials, scaling, step, unseen).
    #[arg(long, value_delimiter = ',', default_value = "1,2,4", value_parser = parse_density)]
    pub spacings: Vec<f32>,
    /// Rays of each probe in a frame (table3; the least of leaks, materials, scaling, step, unseen).
    #[arg(long, value_delimiter = ',', default_value = "144,288", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub probe_rays: Vec<u32>,
    /// Errors over 1,000 to 20,000 patches, instead of one number (clean).
    #[arg(long)]
    pub curves: bool,
    /// Continue an interrupted experiment in the same folder: what OUT/summary.json has is not measured again (patches).
    #[arg(long)]
    pub resume: bool,
    /// The smallest setting of everything, whatever other options say: to see that it works (all, leaks, materials, scaling,
    /// step, table3, unseen).
    #[arg(long)]
    pub quick: bool,
    /// What else is to be known of the machine, to be kept with the numbers (leaks, materials, scaling, step, table3,
    /// unseen).
    #[arg(long, value_name = "TEXT")]
    pub note: Option<String>,
    /// Folder of documents where the numbers are kept, as FOLDER/data/NAME.json, and pictures, for `bench report` (leaks,
    /// materials, scaling, step, table3, unseen). Scenes are added to those that are there, or take their place.
    #[arg(long, value_name = "FOLDER")]
    pub docs: Option<PathBuf>,
    /// Folder of shared scenes, of which leaks, table3 and unseen take theirs when no scenes are named; those that are not there
    /// are left out.
    #[arg(long, value_name = "FOLDER", default_value = "../shared/scenes")]
    pub shared: PathBuf,
}

impl Bench {
    /// Size of path-traced references, or of the view of frames.
    pub fn size(&self) -> (u32, u32) {
        self.size.unwrap_or(match self.name {
            Experiment::Frame => (960, 540),
            Experiment::Clean
            | Experiment::Table3
            | Experiment::Leaks
            | Experiment::Step
            | Experiment::Materials
            | Experiment::Unseen
            | Experiment::Scaling
            | Experiment::Thesis => (240, 135),
            _ => (480, 360),
        })
    }

    /// Frames whose times give the median, or whose mean is judged.
    pub fn frames(&self) -> u32 {
        self.frames.unwrap_or(match self.name {
            Experiment::Frame => 30,
            Experiment::Clean => 16,
            Experiment::Table3 => 9,
            Experiment::Scaling => 5,
            _ => 3,
        })
    }

    /// Folder of pictures to compare with.
    pub fn reference_folder(&self) -> Option<&Path> {
        self.references.as_ref().and_then(Option::as_deref)
    }

    /// Rays from each receiver.
    pub fn receiver_rays(&self) -> u32 {
        self.receiver_rays.unwrap_or(match self.name {
            Experiment::Operator => self.rays,
            _ => BakeSettings::default().receiver_rays,
        })
    }
}

/// Threads that may be asked for on any machine, and for each of its cores: more only wait for each other.
const MOST_THREADS: usize = 64;
const THREADS_A_CORE: usize = 4;

fn parse_threads(text: &str) -> Result<usize, String> {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let most = MOST_THREADS.max(THREADS_A_CORE * cores);
    match text.parse() {
        Ok(threads) if threads <= most => Ok(threads),
        _ => Err(format!("`{text}` is no number from 0 to {most} (this machine has {cores} cores)")),
    }
}

/// A length in metres.
///
/// # Errors
/// Text that is none.
pub fn parse_metres(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(metres) if metres > 0.0 && f32::is_finite(metres) => Ok(metres),
        _ => Err(format!("`{text}` is no length in metres: a number above 0")),
    }
}

/// A relative error of a compressed operator.
///
/// # Errors
/// Text that is none.
pub fn parse_epsilon(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(epsilon) if (1e-6..1.0).contains(&epsilon) => Ok(epsilon),
        _ => Err(format!("`{text}` is no number of at least 0.000001 and below 1")),
    }
}

/// A relative error of photons.
///
/// # Errors
/// Text that is none.
pub fn parse_error(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(error) if (1e-4..=1.0).contains(&error) => Ok(error),
        _ => Err(format!("`{text}` is no number from 0.0001 to 1")),
    }
}

/// A density of receivers, or a distance between probes.
///
/// # Errors
/// Text that is none.
pub fn parse_density(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(density) if (0.01..=100.0).contains(&density) => Ok(density),
        _ => Err(format!("`{text}` is no number from 0.01 to 100")),
    }
}

/// A picture size, `960x540`.
///
/// # Errors
/// Text that is none.
pub fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let wrong = || format!("`{text}` is no size; write WIDTHxHEIGHT, for example 960x540");
    let (width, height) = text.split_once('x').ok_or_else(wrong)?;
    let width = width.parse().map_err(|_| wrong())?;
    let height = height.parse().map_err(|_| wrong())?;
    if !(1..=16_384).contains(&width) || !(1..=16_384).contains(&height) {
        return Err(format!("`{text}`: each side must be from 1 to 16384 pixels"));
    }
    Ok((width, height))
}

/// How the camera moves.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraPath {
    /// Along the scene, from one end to the other.
    Fly,
    /// To and fro along the scene's middle, twice.
    Shuttle,
    /// Round the scene's middle.
    Circle,
}

impl CameraPath {
    /// The camera over one second.
    pub fn animation(self, loaded: &LoadedScene) -> Animation {
        match self {
            Self::Fly => Animation::fly(loaded),
            Self::Shuttle => Animation::shuttle(loaded),
            Self::Circle => Animation::circle(loaded),
        }
    }
}

/// Texture blocks of an experiment.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blocks {
    /// None.
    None,
    /// Half a byte an entry.
    Bc1,
    /// A byte an entry: brightness separate from colour.
    Bc3,
    /// A byte an entry: half-precision colours.
    Bc6h,
    /// A byte an entry: 8-bit colours.
    Bc7,
}

impl Blocks {
    /// The codec.
    pub fn codec(self) -> Option<BlockCodec> {
        match self {
            Self::None => None,
            Self::Bc1 => Some(BlockCodec::Bc1),
            Self::Bc3 => Some(BlockCodec::Bc3),
            Self::Bc6h => Some(BlockCodec::Bc6h),
            Self::Bc7 => Some(BlockCodec::Bc7),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_focus_is_auto_camera_or_a_box() {
        assert_eq!(parse_focus("auto"), Ok(FocusChoice::Auto));
        assert_eq!(parse_focus("camera"), Ok(FocusChoice::Camera));
        let (low, high) = (Vec3::new(-1.0, 0.0, 2.5), Vec3::new(3.0, 0.0, 4.0));
        assert_eq!(parse_focus("-1, 0,2.5,3,0,4"), Ok(FocusChoice::Box { low, high }));
        for wrong in ["", "here", "1,2,3", "0,0,0,1,1,1,1", "0,0,0,1,-1,1", "0,0,0,1,inf,1", "0,0,NaN,1,1,1"] {
            let message = parse_focus(wrong).unwrap_err();
            assert!(message.contains("X,Y,Z,X,Y,Z") && message.contains(wrong), "{wrong}: {message}");
        }
    }
}
