//! The program `patchlight`.

#![warn(clippy::print_stdout, clippy::print_stderr)]

#[macro_use]
extern crate shell;

mod args;
mod bake;
mod cli;
mod compare;
mod demo;
mod devices;
mod export;
mod idle;
mod illuminance;
mod info;
mod manual;
mod photons;
mod plan;
mod render;
mod streamed;
mod world;
mod worst_blocks;
mod write_scene;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::ArgMatches;
use clap::parser::ValueSource;
use shell::Error;
use shell::args::idle::warn_of_idle;
use shell::args::{Input, Method};
use shell::program::{self, Program};
use shell::progress::Progress;

use cli::{Cli, Command};

/// Runs the command that the process was started with. Exit code 0, 1 for an error, 2 for wrong usage, 130 after
/// Ctrl-C.
fn main() -> ExitCode {
    let (cli, matches) = shell::args::read::<Cli>();
    match cli.command {
        Some(Command::View(_)) => start(program::VIEWER, "view"),
        Some(Command::Bench(_)) => start(program::BENCH, "bench"),
        _ => program::run(cli.common.threads, || dispatch(cli, &matches)),
    }
}

/// Hands the command line, without the command, to another program.
fn start(program: Program, command: &str) -> ExitCode {
    let mut arguments: Vec<OsString> = std::env::args_os().skip(1).collect();
    if let Some(at) = arguments.iter().position(|argument| argument == command) {
        arguments.remove(at);
    }
    program.run(&arguments).unwrap_or_else(|error| {
        tell!("error: {error}");
        ExitCode::FAILURE
    })
}

fn dispatch(cli: Cli, matches: &ArgMatches) -> Result<(), Error> {
    let common = &cli.common;
    let progress = Progress::new(common.quiet);
    let given = |name: &str| matches.subcommand_matches(name).unwrap_or(matches);
    match cli.command {
        None => demo::run(common, demo::Demo::default()),
        Some(Command::Demo(args)) => demo::run(common, args),
        Some(Command::Completions { shell }) => manual::completions(shell),
        Some(Command::Man { folder }) => manual::pages(&folder),
        Some(Command::Bake(args)) => {
            warn_of_idle(idle::BAKE_RULES, given("bake"), (&args, Input::Scene), &progress);
            bake::run(common, &args)
        }
        Some(Command::World(args)) => world::run(common, &args),
        Some(Command::Merge(args)) => world::run_merge(common, &args),
        Some(Command::Render(mut args)) => {
            args.is_method_given = given("render").value_source("method") == Some(ValueSource::CommandLine);
            let input = Input::of(&args.scene);
            if !args.is_method_given && input == Input::World {
                args.method = Method::Local;
            }
            warn_of_idle(idle::RULES, given("render"), (&*args, input), &progress);
            match input {
                Input::World => streamed::run(common, &args),
                Input::Scene => render::run(common, &mut args),
                Input::Bake => render::run_bake(common, &mut args),
            }
        }
        Some(Command::Compare(args)) => compare::run(common, &args),
        Some(Command::Devices) => devices::run(common),
        Some(Command::Info { scene, patches, operator }) => {
            let input = Input::of(&scene);
            warn_of_idle(idle::INFO_RULES, given("info"), (&(), input), &progress);
            match input {
                Input::World => world::info(common, &scene),
                Input::Bake => bake::info(common, scene.as_ref()),
                Input::Scene => info::run(common, &scene, &patches, &operator),
            }
        }
        Some(Command::Export(args)) => export::run(common, &args),
        Some(Command::Illuminance(args)) => illuminance::run(common, &args),
        Some(Command::Scene { name }) => write_scene::run(common, &name),
        // Other programs; see `main`.
        Some(Command::View(_) | Command::Bench(_)) => Ok(()),
    }
}
