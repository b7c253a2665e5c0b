//! The command line.

pub mod idle;

use std::ffi::OsString;
use std::path::PathBuf;

use assets::procedural;
use clap::{Args, Parser, Subcommand, ValueEnum};
use shell::args::common::{Animate, CameraPath, parse_size};
use shell::args::definition::RESEARCH;
use shell::args::{
    BakeOptions, BuildPlace, Common, Decoding, LocalArgs, Method, MethodOptions, OperatorOptions, OperatorSettings,
    PatchOptions, TemporalOptions,
};

use crate::bake::Bake;
use crate::demo::Demo;
use crate::export::Export;
use crate::illuminance::Illuminance;
use crate::world::{Merge, World};

/// Diffuse global illumination by radiosity, fast enough for every frame.
#[derive(Parser, Debug)]
#[command(
    name = "patchlight",
    version,
    after_help = "Examples:\n  \
        patchlight                                   demo: pictures and out/report.html\n  \
        patchlight render atrium                     render a built-in scene\n  \
        patchlight render room.glb --out out/room    render your own scene\n  \
        patchlight bake room.glb -o room.bake        bake it once, for `render room.bake`\n  \
        patchlight view room.bake                    a window on it: fly, move its lights\n  \
        patchlight export room.glb --lightmap        its light in files for an engine\n  \
        patchlight compare ours.exr reference.exr    print the differences\n  \
        patchlight bench patches                     the experiments (patchlight-bench)\n  \
        patchlight devices                           what can run the kernels"
)]
pub struct Cli {
    /// Command; without one, the demo.
    #[command(subcommand)]
    pub command: Option<Command>,
    #[command(flatten)]
    pub common: Common,
}

/// Arguments passed on to another program.
#[derive(Args, Debug)]
pub struct Forwarded {
    /// Arguments of that program.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    pub arguments: Vec<OsString>,
}

/// The commands.
#[derive(Subcommand, Debug)]
pub enum Command {
    /// Light a scene and write pictures (PNG, EXR) and summary.json.
    #[command(after_help = "Examples:\n  \
        patchlight render cornell\n  \
        patchlight render sponza.toml --method tiles --patch-count 10000 --epsilon 0.02\n  \
        patchlight render sponza.bake --method tiles --frames 120 --animate sun\n  \
        patchlight render office --method firstshot --error 0.02")]
    Render(Box<Render>),
    /// Open a window on a scene or a bake: starts patchlight-view.
    #[command(disable_help_flag = true)]
    View(Forwarded),
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
    /// Run an experiment: starts patchlight-bench.
    #[command(disable_help_flag = true)]
    Bench(Forwarded),
    /// Light three built-in rooms by every method, beside path tracing; what `patchlight` alone does.
    Demo(Demo),
    /// Write completions of the command line for a shell to standard output.
    #[command(
        after_help = "Example:\n  patchlight completions bash > ~/.local/share/bash-completion/completions/patchlight"
    )]
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
    /// Write manual pages, one a command, into a folder.
    #[command(after_help = "Example:\n  patchlight man ~/.local/share/man/man1")]
    Man {
        /// The folder.
        folder: PathBuf,
    },
    /// List the devices that can run the kernels.
    Devices,
    /// Say what a scene file holds: triangles, areas, materials, lights, memory; with --patches also what patches it
    /// gives, with
    /// --operator what the operator of the light between them takes and loses. Or what a bake holds, which is checked:
    /// its sections and their bytes, settings, scene, and whether that has changed since.
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
    /// Method for indirect light [default: tiles].
    ///
    /// In a medium the default is firstshot, in the bake of a world local, and of other bakes the method that they are
    /// for.
    #[arg(long, value_enum, hide_default_value = true, default_value_t = Method::Tiles, help_heading = "Method")]
    pub method: Method,
    /// True if the command line names it.
    #[arg(skip)]
    pub is_method_given: bool,
    /// Frames; with more than one the lights move.
    ///
    /// frames.csv and report.html then say what each frame measured.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000), help_heading = "Light")]
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
    pub bake: BakeOptions,
    #[command(flatten)]
    pub operators: OperatorSettings,
    /// Device that bakes.
    ///
    /// auto takes the device if it is a graphics processor. What bakes traces the rays and random walks of the bake,
    /// and builds the operator between patches (multibounce, tiles).
    #[arg(long, value_enum, default_value_t = BuildPlace::Auto, help_heading = "Device")]
    pub build_on: BuildPlace,
    /// Decoder of texture blocks on a Vulkan device (multibounce with --codec bc1, bc3, bc6h, bc7).
    #[arg(long, value_enum, default_value_t, help_heading = RESEARCH)]
    pub decode: Decoding,
    #[command(flatten)]
    pub methods: MethodOptions,
    /// Method for direct light of large lights and the sky at pixels.
    #[arg(long, value_enum, default_value_t = DirectLight::Smooth, help_heading = "Picture")]
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

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_definition_holds_together() {
        Cli::command().debug_assert();
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
}
