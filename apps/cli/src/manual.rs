//! `patchlight completions` and `patchlight man`: from the definition of the command line.

use std::path::Path;

use clap_complete::Shell;
use shell::Error;
use shell::args::definition;
use shell::output;

use crate::cli::Cli;

/// Writes completions to standard output.
pub fn completions(shell: Shell) -> Result<(), Error> {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut definition::<Cli>(), "patchlight", &mut text);
    say!("{}", String::from_utf8_lossy(&text).trim_end());
    Ok(())
}

/// Writes `patchlight.1` and a page for each command.
pub fn pages(folder: &Path) -> Result<(), Error> {
    output::check_folder(folder)?;
    output::make_folder(folder)?;
    let mut program = definition::<Cli>();
    program.build();
    let commands = program.get_subcommands().filter(|command| command.get_name() != "help");
    for command in std::iter::once(&program).chain(commands) {
        let name = command.get_display_name().unwrap_or(command.get_name()).to_owned();
        let mut page = Vec::new();
        let path = folder.join(format!("{name}.1"));
        clap_mangen::Man::new(command.clone())
            .render(&mut page)
            .map_err(|source| Error::Write { path: path.clone(), source })?;
        output::write_text(&path, &String::from_utf8_lossy(&page))?;
    }
    Ok(())
}
