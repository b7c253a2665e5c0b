//! The program `patchlight-view`.

use std::process::ExitCode;

use clap::Parser;
use shell::args::Common;
use viewer::command::{View, run};

/// Diffuse global illumination by radiosity, in a window.
#[derive(Parser, Debug)]
#[command(name = "patchlight-view", version)]
struct Cli {
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    view: View,
}

/// Opens the window. Exit code 0, 1 for an error, 2 for wrong usage, 130 after Ctrl-C.
fn main() -> ExitCode {
    let (cli, matches) = shell::args::read::<Cli>();
    shell::program::run(cli.common.threads, || run(&cli.common, &cli.view, &matches))
}
