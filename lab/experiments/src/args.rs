//! The command line of the experiments.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use multibounce::BlockCodec;
use patchlight::BakeSettings;
use patchlight::method::FirstShotSettings;
use serde::{Deserialize, Serialize};

pub use shell::args::common::*;

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
    /// Ways to spread a product over frames, two of them naive, and the weight of the frames before: light while lights
    /// move.
    Spread,
    /// The matrix round a camera that moves, beside full radiosity: work, time, memory, pictures.
    Local,
    /// Photons to an error: from where lights fall first, and from the lights.
    Firstshot,
    /// Visible faults of pictures: noise, leaks, stains, blotches, teeth, patterns, against converged references.
    Clean,
    /// Whole light updates: lights that move, lights that rest, a lamp that is switched, for every receiver and for
    /// those in view; where the time goes, and how far from the bandwidth that is.
    Frame,
    /// A bake that goes on beside the picture: its error over time, beside the path tracer's and DDGI's.
    Refine,
    /// Objects that move and a door: light near them beside path tracing, DDGI, and the time that they take.
    Moving,
    /// A whole bake: time and busy cores of its phases, memory; by turns with another program.
    Bake,
    /// Time of products and of sampled light over the number of patches: `thesis table1`.
    Table1,
    /// Errors of products and of sampled light against path tracing: `thesis table2`.
    Table2,
    /// Tiles and sampled rows in view, beside every baseline and opponent: time, memory, pictures, points.
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
    /// Scene files or built-in scenes, for thesis behind the figure [default: clean rooms stripes blinds clutter window
    /// corridor, leaks rooms corridor blinds clutter, moving cornell:block office:person atrium:lorry, bake, frame,
    /// refine and scaling office, materials cornell, table3, step and unseen cornell office, others cornell atrium;
    /// leaks, table3 and unseen the shared ones, too].
    pub scenes: Vec<String>,
    /// Patches [default: patches 1000,2000,5000,10000,20000, clean and firstshot 4000, scaling 512 to 262144, leaks,
    /// materials, spread, step, table3 and unseen 2000, thesis by figure, curves 1000,2000,4000,10000,20000 (clean),
    /// others 10000].
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=65_535))]
    pub counts: Vec<u32>,
    /// Viewing area with close patches and receivers: auto, camera, or a box as X,Y,Z,X,Y,Z (m): enclosed space, what
    /// the camera sees round it, or what is given (clean, frame, leaks, local, materials, scaling, step, table3,
    /// temporal, unseen).
    #[arg(
        long,
        default_value = "auto",
        value_name = "auto|camera|BOX",
        allow_hyphen_values = true,
        value_parser = parse_focus
    )]
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
    #[arg(
        long,
        default_value_t = FirstShotSettings::default().most_photons,
        value_parser = clap::value_parser!(u64).range(1..=1 << 33)
    )]
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
    /// Folder whose folder SCENE holds full.exr, indirect.exr and points.csv to compare with; scenes without are path
    /// traced. For clean, without a folder: make the references of the scenes, or go on with them, and measure nothing.
    #[arg(long, num_args = 0..=1, value_name = "FOLDER")]
    pub references: Option<Option<PathBuf>>,
    /// Paths a pixel of references that are made (clean) [default: 2048 with --references; else those at hand are
    /// taken].
    #[arg(long, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    pub paths: Option<u32>,
    /// Folder where references are kept (clean, leaks) [default: clean patchlight/references in the user's cache
    /// folder, leaks OUT/references].
    #[arg(long, value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
    /// Size of path-traced references, or of the view of frames [default: frame 960x540, clean, leaks,
    /// materials, scaling, step, table3, thesis and unseen 240x135, others 480x360].
    #[arg(long, value_parser = parse_size)]
    pub size: Option<(u32, u32)>,
    /// Paths a pixel of path-traced references; half of them in each of two independent pictures, which tell their
    /// noise.
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
    /// Distances between probes, m; shares of 8 m in scenes that are smaller (table3; the least of leaks, materials,
    /// scaling, step, unseen).
    #[arg(long, value_delimiter = ',', default_value = "1,2,4", value_parser = parse_density)]
    pub spacings: Vec<f32>,
    /// Rays of each probe in a frame (table3; the least of leaks, materials, scaling, step, unseen).
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "144,288",
        value_parser = clap::value_parser!(u32).range(1..=4096)
    )]
    pub probe_rays: Vec<u32>,
    /// Errors over 1,000 to 20,000 patches, instead of one number (clean).
    #[arg(long)]
    pub curves: bool,
    /// Another `patchlight` program whose whole bakes, or light updates and nothing else, are measured by turns with this
    /// one's (bake, frame).
    #[arg(long, value_name = "PROGRAM")]
    pub against: Option<PathBuf>,
    /// Continue an interrupted experiment in the same folder: what OUT/summary.json has is not measured again
    /// (patches).
    #[arg(long)]
    pub resume: bool,
    /// The smallest setting of everything, whatever other options say: to see that it works (all, leaks, materials,
    /// scaling, step, table3, unseen).
    #[arg(long)]
    pub quick: bool,
    /// Note on the machine, to be kept with the numbers (leaks, materials, scaling, step, table3, unseen).
    #[arg(long, value_name = "TEXT")]
    pub note: Option<String>,
    /// Folder of documents where the numbers are kept, as FOLDER/data/NAME.json, and pictures, for `bench report`
    /// (leaks, materials, scaling, step, table3, unseen). Scenes are added to those that are there, or take their
    /// place.
    #[arg(long, value_name = "FOLDER")]
    pub docs: Option<PathBuf>,
    /// Folder of shared scenes, of which leaks, table3 and unseen take theirs when no scenes are named; those that are
    /// not there are left out.
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
            | Experiment::Refine
            | Experiment::Moving
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

/// Table of the experiment with patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Part {
    /// Kinds, numbers of patches, receivers.
    Patches,
    /// Break-down of the error.
    BreakDown,
    /// Lights that the bake has not seen.
    Lights,
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
