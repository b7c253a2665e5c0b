//! Definition and parsing of a program's command line.

use std::ffi::OsString;

use clap::{ArgMatches, Command, Parser};

/// The heading of options that serve measurements alone. `--help` leaves them out, `--help-research` shows them.
pub const RESEARCH: &str = "Research";
/// The option that shows them.
const SHOW_RESEARCH: &str = "--help-research";

/// The definition of a program: numbers below 0 are values, which are refused by name where they cannot stand; options
/// of research are hidden.
pub fn definition<T: Parser>() -> Command {
    of_all(T::command(), &|command| {
        let command = command.mut_args(|arg| {
            let arg = match arg.get_action().takes_values() {
                true => arg.allow_negative_numbers(true),
                false => arg,
            };
            match arg.get_help_heading() {
                Some(RESEARCH) => arg.hide(true),
                _ => arg,
            }
        });
        let has_research = command.get_arguments().any(|arg| arg.get_help_heading() == Some(RESEARCH));
        match (has_research, command.get_after_help().map(ToString::to_string)) {
            (true, None) => command.after_help(POINTER),
            (true, Some(after)) => command.after_help(format!("{after}\n\n{POINTER}")),
            (false, _) => command,
        }
    })
}

/// Pointer to the hidden options.
const POINTER: &str = "Options for measurements: --help-research";

/// The definition with all options in its help.
pub fn research_definition<T: Parser>() -> Command {
    of_all(definition::<T>(), &|command| command.mut_args(|arg| arg.hide(false)))
}

/// A command and its commands, changed.
fn of_all(command: Command, change: &dyn Fn(Command) -> Command) -> Command {
    change(command.mut_subcommands(|command| of_all(command, change)))
}

/// Reads the command line; what is wrong with it ends the process with exit code 2. Also gives what was found, for
/// questions that only it answers.
pub fn read<T: Parser>() -> (T, ArgMatches) {
    let arguments: Vec<OsString> = std::env::args_os().collect();
    let is_research = |argument: &OsString| argument == SHOW_RESEARCH;
    let matches = match arguments.iter().any(is_research) {
        // As if `--help` had been asked for, of a command that hides nothing.
        true => {
            let asked = arguments.iter().map(|a| if is_research(a) { "--help".into() } else { a.clone() });
            research_definition::<T>().get_matches_from(asked)
        }
        false => definition::<T>().get_matches_from(arguments),
    };
    let parsed = T::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    (parsed, matches)
}
