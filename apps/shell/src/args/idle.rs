//! Options that have nothing to do in a run of a command: a table for each command says which options are for which
//! runs.

use clap::ArgMatches;
use clap::parser::ValueSource;

use super::input::Input;
use crate::progress::Progress;

/// Options of a command that are for some runs only.
pub struct Rule<T: 'static> {
    /// Their names, as the program has them.
    pub options: &'static [&'static str],
    /// Their purpose, as the user reads it.
    pub whom: &'static str,
    /// Returns true if a run with these options, and this input, is one of these.
    pub suits: fn(&T, Input) -> bool,
}

/// Warnings about given options that the run ignores.
pub fn idle_options<T>(rules: &[Rule<T>], matches: &ArgMatches, (args, input): (&T, Input)) -> Vec<String> {
    let given = |option: &str| matches.value_source(option) == Some(ValueSource::CommandLine);
    let idle = rules.iter().filter(|rule| !(rule.suits)(args, input));
    let options = idle.flat_map(|rule| rule.options.iter().map(|option| (rule.whom, *option)));
    options
        .filter(|(_, option)| given(option))
        .map(|(whom, option)| format!("--{} is for {whom}; this run ignores it", option.replace('_', "-")))
        .collect()
}

/// Warns of each option that was given and has nothing to do in a run with these options.
pub fn warn_of_idle<T>(rules: &[Rule<T>], matches: &ArgMatches, run: (&T, Input), progress: &Progress) {
    idle_options(rules, matches, run).iter().for_each(|line| progress.warn(line));
}
