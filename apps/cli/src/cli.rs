//! The command line: its commands, each with its options.

use std::ffi::OsString;
use std::path::PathBuf;

use assets::procedural;
use clap::{Args, Parser, Subcommand};
use shell::args::{Common, OperatorOptions, PatchOptions};

use crate::args::{Compare, Render};
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
        patchlight render sponza.toml --method low_rank --patch-count 10000 --epsilon 0.02\n  \
        patchlight render sponza.bake --method low_rank --frames 120 --animate sun\n  \
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
