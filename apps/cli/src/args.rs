//! Options of commands that share them.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use shell::args::common::{Animate, CameraPath, parse_size};
use shell::args::definition::RESEARCH;
use shell::args::{
    BakeOptions, BuildPlace, Decoding, DisplayOptions, LocalArgs, Method, MethodOptions, OperatorSettings,
    TemporalOptions,
};

/// Method for direct light of sky, rectangles and emissive triangles at pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DirectLight {
    /// Without noise: the sky at the receivers; the others exactly where nothing is in the way, times what shadow rays
    /// of a fixed pattern see. With receivers on the mesh only, else sampled.
    Smooth,
    /// By random rays in each sub-frame.
    Sampled,
}

/// `patchlight render`.
#[derive(Args, Debug)]
pub struct Render {
    /// A scene file (.toml, .obj, .gltf, .glb), a bake, or a built-in scene.
    ///
    /// Built-in scenes may have parameters, as in atrium:20000 or rooms:wall=0.1,ground=1000: `patchlight scene --help`
    /// lists them.
    pub scene: String,
    /// Method for indirect light [default: low_rank].
    ///
    /// In a medium the default is firstshot, in the bake of a world local, and of other bakes the method that they are
    /// for.
    #[arg(long, value_enum, hide_default_value = true, default_value_t = Method::LowRank, help_heading = "Method")]
    pub method: Method,
    /// True if the command line names it.
    #[arg(skip)]
    pub is_method_given: bool,
    /// Frames; with more than one the lights move.
    ///
    /// frames.csv and report.html then say what each frame measured.
    #[arg(
        long,
        default_value_t = 1,
        value_parser = clap::value_parser!(u32).range(1..=100_000),
        help_heading = "Light"
    )]
    pub frames: u32,
    /// Light motion.
    #[arg(long, value_enum, default_value_t = Animate::Path, help_heading = "Light")]
    pub animate: Animate,
    /// Also find the light of each frame by exact products, and write the error of each into frames.csv (not path).
    #[arg(long, help_heading = RESEARCH)]
    pub errors: bool,
    #[command(flatten)]
    pub temporal: TemporalOptions,
    #[command(flatten)]
    pub local: LocalArgs,
    /// Motion of the camera.
    ///
    /// Lights then move as --animate says, but for a camera of their path.
    #[arg(long, value_enum, help_heading = "Picture")]
    pub path: Option<CameraPath>,
    /// Picture size [default: that of the reference, else 960x540].
    #[arg(long, value_parser = parse_size, help_heading = "Picture")]
    pub size: Option<(u32, u32)>,
    /// Sub-frames (classic) or paths (path) a pixel [default: 16 and 64].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000), help_heading = "Picture")]
    pub spp: Option<u32>,
    #[command(flatten)]
    pub display: DisplayOptions,
    #[command(flatten)]
    pub bake: BakeOptions,
    #[command(flatten)]
    pub operators: OperatorSettings,
    /// Device that bakes.
    ///
    /// auto takes the device if it is a graphics processor. What bakes traces the rays and random walks of the bake,
    /// and builds the operator between patches (multibounce, low_rank).
    #[arg(long, value_enum, default_value_t = BuildPlace::Auto, help_heading = "Device")]
    pub build_on: BuildPlace,
    /// Decoder of texture blocks on a Vulkan device (multibounce with --codec bc1, bc3, bc6h, bc7).
    #[arg(long, value_enum, default_value_t, help_heading = RESEARCH)]
    pub decode: Decoding,
    #[command(flatten)]
    pub methods: MethodOptions,
    /// Method for direct light of large lights and the sky at pixels.
    #[arg(long, value_enum, default_value_t = DirectLight::Smooth, help_heading = RESEARCH)]
    pub direct: DirectLight,
    /// Folder with full.exr, indirect.exr and points.csv to compare with.
    ///
    /// OUT/points.csv then has the error of each point, worst first.
    #[arg(long, help_heading = "Picture")]
    pub reference: Option<PathBuf>,
    /// Also write pictures into OUT/debug: colours by patch, element, axis and receiver, E and H of
    /// the patches, where receivers were refined; with --reference the blocks that are worst
    /// (classic).
    #[arg(long, help_heading = RESEARCH)]
    pub debug: bool,
    /// Also write the frame graph in Graphviz' language: passes with their times, buffers with sizes and lifetimes,
    /// barriers.
    #[arg(long, value_name = "FILE", help_heading = RESEARCH)]
    pub graph: Option<PathBuf>,
    /// Continue an interrupted path-traced picture in the same folder.
    #[arg(long, help_heading = "Picture")]
    pub resume: bool,
}

/// `patchlight compare`.
#[derive(Args, Debug)]
pub struct Compare {
    /// Our picture (EXR, HDR or PNG).
    pub ours: PathBuf,
    /// Picture to compare with.
    pub reference: PathBuf,
    /// Picture whose black pixels are left out.
    #[arg(long)]
    pub mask: Option<PathBuf>,
    /// Exposure before tone mapping, in stops; without it 0.18 over the reference's log-average.
    #[arg(long, allow_hyphen_values = true)]
    pub stops: Option<f32>,
    /// Write a picture of the difference: red where ours is brighter, blue where it is darker, white where equal, by up
    /// to half of the reference.
    #[arg(long)]
    pub difference: Option<PathBuf>,
    /// Make that the absolute difference times this, exposed as the pictures are: black where equal.
    #[arg(long, value_name = "FACTOR", requires = "difference", value_parser = parse_gain)]
    pub difference_gain: Option<f32>,
    /// Standard error of the reference as a picture; differences of at most three of them are no leaks, stains or
    /// blotches.
    #[arg(long, value_name = "PICTURE")]
    pub reference_error: Option<PathBuf>,
    /// The reference's indirect light, by whose mean leaks are measured [default: the reference].
    #[arg(long, value_name = "PICTURE")]
    pub indirect: Option<PathBuf>,
    /// Write faults.png (leaks red, stains blue), noise.png and blotches.png into this folder.
    #[arg(long, value_name = "FOLDER")]
    pub marked: Option<PathBuf>,
}

fn parse_gain(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(gain) if gain > 0.0 && f32::is_finite(gain) => Ok(gain),
        _ => Err(format!("`{text}` is no factor: a number above 0")),
    }
}
