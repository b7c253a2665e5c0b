//! The program `patchlight-bench`.

use std::process::ExitCode;

use clap::Parser;
use experiments::args::{Bench, Common};
use experiments::bench;

/// Runs an experiment and writes its tables, plots and pictures.
#[derive(Parser, Debug)]
#[command(
    name = "patchlight-bench",
    version,
    after_help = "Examples:\n  \
        patchlight-bench operator sponza.toml --counts 10000 --epsilons 0.03,0.01\n  \
        patchlight-bench patches sponza.toml --references reference --counts 2000,5000 --densities 1\n  \
        patchlight-clean --references\n  \
        patchlight-bench clean rooms:wall=0 office:ground=1000 --paths 256\n\n\
        Experiments:\n  \
        clean      noise, leaks, stains, blotches, teeth and patterns of pictures against converged references, with marks;\n             \
        clean --references makes the references\n  \
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
        firstshot  photons and time to an error, first shot against photons from the lights"
)]
struct Cli {
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    bench: Bench,
}

/// Runs the experiment that the process was started with. Exit code 0, 1 for an error, 2 for wrong usage, 130 after
/// Ctrl-C.
fn main() -> ExitCode {
    let (cli, _) = shell::args::read::<Cli>();
    shell::program::run(cli.common.threads, || bench::run(&cli.common, &cli.bench))
}
