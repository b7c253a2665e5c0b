//! The program `patchlight`.

#![warn(clippy::print_stdout, clippy::print_stderr)]

mod args;
mod bake;
mod compare;
mod demo;
mod devices;
mod export;
mod illuminance;
mod info;
mod plan;
mod render;
mod streamed;
mod view;
mod world;
mod write_scene;

use std::process::ExitCode;

use clap::ArgMatches;

use args::{Cli, Command, Input, warn_of_idle, warn_of_idle_in_info};
use experiments::progress::Progress;
use experiments::tell;
use experiments::{Error, bench};
use experiments::{print, progress};

/// Runs the command that the process was started with. Exit code 0, 1 for an error, 2 for wrong usage, 130 after Ctrl-C.
fn main() -> ExitCode {
    let (cli, matches) = Cli::read();
    // What a decoder of a damaged file says when it gives up is an error, which is printed as such.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !assets::import::is_guarded() {
            hook(panic);
        }
    }));
    if let Err(e) = progress::watch_for_cancel() {
        tell!("warning: Ctrl-C will stop at once: {e}");
    }
    match dispatch(cli, &matches).and_then(|()| print::finish()) {
        Ok(()) => ExitCode::SUCCESS,
        // Work that is told to stop may say so in words of its own.
        Err(e) if e.is_cancelled() || progress::is_cancelled() => {
            progress::tell_stopped();
            ExitCode::from(progress::STOPPED)
        }
        Err(e) => {
            tell!("error: {e}");
            ExitCode::FAILURE
        }
    }
}

fn dispatch(cli: Cli, matches: &ArgMatches) -> Result<(), Error> {
    let threads = cli.common.threads;
    // The pool of the whole process, so that no work starts threads of its own.
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .map_err(|e| Error::Threads { threads, reason: e.to_string() })?;
    match cli.command {
        None => demo::run(&cli.common, cli.fast),
        Some(Command::Bake(args)) => bake::run(&cli.common, &args, matches.subcommand_matches("bake")),
        Some(Command::World(args)) => world::run(&cli.common, &args),
        Some(Command::Merge(args)) => world::run_merge(&cli.common, &args),
        Some(Command::Render(args)) => {
            let input = Input::of(&args.scene);
            if let Some(matches) = matches.subcommand_matches("render") {
                warn_of_idle(matches, &args, input, &Progress::new(cli.common.quiet));
            }
            match input {
                Input::World => streamed::run(&cli.common, &args),
                Input::Scene => render::run(&cli.common, &args),
                Input::Bake => render::run_bake(&cli.common, &args),
            }
        }
        Some(Command::View(args)) => view::run(&cli.common, &args, matches.subcommand_matches("view")),
        Some(Command::Compare(args)) => compare::run(&cli.common, &args),
        Some(Command::Bench(args)) => bench::run(&cli.common, &args),
        Some(Command::Devices) => devices::run(&cli.common),
        Some(Command::Info { scene, patches, operator }) => {
            let input = Input::of(&scene);
            if let Some(matches) = matches.subcommand_matches("info") {
                warn_of_idle_in_info(matches, input, &Progress::new(cli.common.quiet));
            }
            match input {
                Input::World => world::info(&cli.common, &scene),
                Input::Bake => bake::info(&cli.common, scene.as_ref()),
                Input::Scene => info::run(&cli.common, &scene, &patches, &operator),
            }
        }
        Some(Command::Export(args)) => export::run(&cli.common, &args),
        Some(Command::Illuminance(args)) => illuminance::run(&cli.common, &args),
        Some(Command::Scene { name }) => write_scene::run(&cli.common, &name),
    }
}
