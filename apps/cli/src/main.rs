//! The program `patchlight`.

mod args;
mod bake;
mod compare;
mod demo;
mod devices;
mod info;
mod render;
mod streamed;
mod write_scene;

use std::process::ExitCode;

use clap::Parser;

use args::{Cli, Command};
use experiments::progress;
use experiments::{Error, bench};

/// Runs the command that the process was started with. Exit code 0, 1 for an error, 2 for wrong usage, 130 after Ctrl-C.
fn main() -> ExitCode {
    let cli = Cli::parse();
    if let Err(e) = progress::watch_for_cancel() {
        eprintln!("warning: Ctrl-C will stop at once: {e}");
    }
    match dispatch(cli) {
        Ok(()) => ExitCode::SUCCESS,
        // Work that is told to stop may say so in words of its own.
        Err(e) if e.is_cancelled() || progress::is_cancelled() => {
            eprintln!("stopped; nothing was left half-written");
            ExitCode::from(130)
        }
        Err(e) => {
            eprintln!("error: {e}");
            ExitCode::FAILURE
        }
    }
}

fn dispatch(cli: Cli) -> Result<(), Error> {
    let threads = cli.common.threads;
    // The pool of the whole process, so that no work starts threads of its own.
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .map_err(|e| Error::Threads { threads, reason: e.to_string() })?;
    match cli.command {
        None => demo::run(&cli.common, cli.fast),
        Some(Command::Bake(args)) => bake::run(&cli.common, &args),
        Some(Command::Merge(args)) => bake::run_merge(&cli.common, &args),
        Some(Command::Info { scene, .. }) if bake::is_bake(&scene) => bake::info(&cli.common, &scene),
        Some(Command::Render(args)) if bake::is_bake(&args.scene) => streamed::run(&cli.common, &args),
        Some(Command::Render(args)) => render::run(&cli.common, &args),
        Some(Command::Compare(args)) => compare::run(&cli.common, &args),
        Some(Command::Bench(args)) => bench::run(&cli.common, &args),
        Some(Command::Devices) => devices::run(&cli.common),
        Some(Command::Info { scene, patches, operator }) => info::run(&cli.common, &scene, &patches, &operator),
        Some(Command::Scene { name }) => write_scene::run(&cli.common, &name),
    }
}
