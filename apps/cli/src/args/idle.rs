//! Options of `render` that have nothing to do in a run: one table says which options are for which runs.

use clap::ArgMatches;
use clap::parser::ValueSource;

use experiments::args::Patches;
use experiments::progress::Progress;

use super::{Bounces, FormFactors, Method, ReceiverPlaces, Render, Storage, Switch};

/// A run of `render`.
#[derive(Clone, Copy)]
pub struct Run<'a> {
    /// Its options.
    pub args: &'a Render,
    /// Whether it renders a bake of a streamed world.
    pub is_bake: bool,
}

/// Options that are for some runs only.
struct Rule {
    /// Their names, as the program has them.
    options: &'static [&'static str],
    /// What they are for, as the user reads it.
    whom: &'static str,
    /// Whether a run is one of these.
    suits: fn(Run) -> bool,
}

/// A rule for one method.
macro_rules! of_method {
    ($method:ident, $name:literal, [$($option:literal),+]) => {
        Rule {
            options: &[$($option),+],
            whom: concat!("--method ", $name),
            suits: |run| run.args.method == Method::$method,
        }
    };
}

/// Which options are for which runs; those that are not here are for all.
const RULES: &[Rule] = &[
    of_method!(Temporal, "temporal", ["samples", "control_variate", "rotated", "rows", "sampled"]),
    Rule {
        options: &["blend"],
        whom: "--method temporal with --control-variate off",
        suits: |Run { args, .. }| args.method == Method::Temporal && args.temporal.control_variate == Switch::Off,
    },
    Rule {
        options: &["refresh"],
        whom: "--method temporal with --control-variate on",
        suits: |Run { args, .. }| args.method == Method::Temporal && args.temporal.control_variate == Switch::On,
    },
    of_method!(Local, "local", ["slots", "at_rest"]),
    Rule {
        options: &["budget", "look_ahead", "fade"],
        whom: "--method local without --at-rest",
        suits: |Run { args, .. }| args.method == Method::Local && !args.local.at_rest,
    },
    of_method!(Feedback, "feedback", ["products", "plain"]),
    of_method!(Firstshot, "firstshot", ["error", "photons"]),
    of_method!(Multibounce, "multibounce", ["codec"]),
    Rule {
        options: &["epsilon"],
        whom: "--method tiles and feedback, and multibounce with --codec tiles",
        suits: |Run { args, .. }| match args.method {
            Method::Tiles | Method::Feedback => true,
            Method::Multibounce => args.codec.unwrap_or_default() == Storage::Tiles,
            _ => false,
        },
    },
    Rule {
        options: &["decode"],
        whom: "--method multibounce with --codec bc1, bc3, bc6h or bc7",
        suits: |Run { args, .. }| {
            let blocks = [Storage::Bc1, Storage::Bc3, Storage::Bc6h, Storage::Bc7];
            args.method == Method::Multibounce && args.codec.is_some_and(|codec| blocks.contains(&codec))
        },
    },
    Rule {
        options: &["build_on"],
        whom: "operators of --bounces K (--method multibounce and tiles); others are built on the host",
        suits: |Run { args, .. }| {
            matches!(args.method, Method::Multibounce | Method::Tiles) && args.bounces != Bounces::All
        },
    },
    Rule {
        options: &["bounces"],
        whom: "methods other than firstshot and local, which take all bounces",
        suits: |Run { args, .. }| !matches!(args.method, Method::Firstshot | Method::Local),
    },
    Rule { options: &["animate", "path"], whom: "--frames above 1", suits: |Run { args, .. }| args.frames > 1 },
    Rule {
        options: &["resume"],
        whom: "--method path with one frame",
        suits: |Run { args, .. }| args.method == Method::Path && args.frames == 1,
    },
    Rule { options: &["reference"], whom: "scenes, not bakes", suits: |run| !run.is_bake },
    Rule {
        options: &[
            "patches",
            "patch_count",
            "voxel_size",
            "form_factors",
            "receivers",
            "receiver_rays",
            "direct",
            "errors",
            "debug",
        ],
        whom: "scenes, not bakes, by methods other than path",
        suits: has_patches,
    },
    Rule {
        options: &["focus"],
        whom: "scenes, not bakes, by methods other than path, with --patches polygon or cluster",
        suits: |run| has_patches(run) && !matches!(run.args.patches.patches, Some(Patches::Voxel | Patches::Axis)),
    },
    Rule {
        options: &["rays"],
        whom: "scenes, not bakes, by methods other than path, with --form-factors hemisphere",
        suits: |run| has_patches(run) && run.args.form_factors == FormFactors::Hemisphere,
    },
    Rule {
        options: &["receiver_edge", "most_receivers"],
        whom: "scenes, not bakes, by methods other than path, with --receivers mesh",
        suits: |run| has_patches(run) && run.args.receivers == ReceiverPlaces::Mesh,
    },
];

/// Whether a run makes patches.
fn has_patches(run: Run) -> bool {
    !run.is_bake && run.args.method != Method::Path
}

/// What there is to say of the options that were given, and that the run ignores.
fn idle_options<'a>(matches: &'a ArgMatches, run: Run<'a>) -> impl Iterator<Item = String> + 'a {
    let given = |option: &str| matches.value_source(option) == Some(ValueSource::CommandLine);
    let idle = RULES.iter().filter(move |rule| !(rule.suits)(run));
    idle.flat_map(|rule| rule.options.iter().map(move |option| (rule, *option)))
        .filter(move |(_, option)| given(option))
        .map(|(rule, option)| format!("--{} is for {}; this run ignores it", option.replace('_', "-"), rule.whom))
}

/// Warns of each option that was given and has nothing to do in the run.
pub fn warn_of_idle(matches: &ArgMatches, run: Run, progress: &Progress) {
    idle_options(matches, run).for_each(|line| progress.warn(&line));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::args::{Cli, Command};

    /// The names of the options that are idle when `render cornell` is given these.
    fn idle(options: &[&str]) -> Vec<String> {
        let all = ["patchlight", "render", "cornell"].iter().chain(options);
        let matches = Cli::definition().try_get_matches_from(all).unwrap();
        let cli = <Cli as clap::FromArgMatches>::from_arg_matches(&matches).unwrap();
        let Some(Command::Render(args)) = cli.command else { panic!("render") };
        let matches = matches.subcommand_matches("render").unwrap();
        let name = |line: String| line.split_once(' ').unwrap().0.to_owned();
        idle_options(matches, Run { args: &args, is_bake: false }).map(name).collect()
    }

    #[test]
    fn every_rule_names_options_of_render() {
        let command = Cli::definition();
        let render = command.find_subcommand("render").unwrap();
        for option in RULES.iter().flat_map(|rule| rule.options) {
            assert!(render.get_arguments().any(|arg| arg.get_id() == *option), "{option}");
        }
    }

    #[test]
    fn options_that_cannot_apply_are_named() {
        // Those that classic radiosity ignores.
        let classic: [&[&str]; 18] = [
            &["--samples", "16"],
            &["--blend", "0.5"],
            &["--refresh", "4"],
            &["--control-variate", "off"],
            &["--rotated", "off"],
            &["--slots", "64"],
            &["--budget", "8"],
            &["--look-ahead", "4"],
            &["--at-rest"],
            &["--products", "2"],
            &["--plain"],
            &["--error", "0.1"],
            &["--photons", "1000"],
            &["--epsilon", "0.1"],
            &["--resume"],
            &["--codec", "bc1"],
            &["--animate", "sun"],
            &["--path", "fly"],
        ];
        for options in classic {
            assert_eq!(idle(options), [options[0]], "{options:?}");
        }
        assert_eq!(idle(&classic.concat()).len(), classic.len());
        let path: [&[&str]; 8] = [
            &["--form-factors", "area"],
            &["--receivers", "pixels"],
            &["--receiver-edge", "0.1"],
            &["--errors"],
            &["--debug"],
            &["--epsilon", "0.1"],
            &["--patch-count", "50"],
            &["--focus", "camera"],
        ];
        for options in path {
            assert_eq!(idle(&[&["--method", "path"], options].concat()), [options[0]], "{options:?}");
        }
        assert_eq!(idle(&["--patches", "axis", "--focus", "0,0,0,1,1,1"]), ["--focus"]);
    }

    #[test]
    fn options_that_apply_are_not_named() {
        let none: [&[&str]; 10] = [
            &[],
            &["--method", "temporal", "--samples", "16", "--refresh", "4", "--frames", "3", "--animate", "sun"],
            &["--method", "temporal", "--control-variate", "off", "--blend", "0.5"],
            &["--method", "local", "--slots", "64", "--budget", "8", "--fade", "1"],
            &["--method", "feedback", "--plain", "--products", "2", "--epsilon", "0.1"],
            &[
                "--method",
                "multibounce",
                "--codec",
                "bc1",
                "--decode",
                "kernel",
                "--bounces",
                "3",
                "--build-on",
                "host",
            ],
            &["--method", "firstshot", "--error", "0.1", "--photons", "1000"],
            &["--method", "path", "--resume", "--spp", "4"],
            &["--focus", "camera", "--patches", "cluster"],
            &["--receiver-edge", "0.1", "--rays", "64", "--debug", "--errors", "--direct", "sampled"],
        ];
        for options in none {
            assert!(idle(options).is_empty(), "{options:?}: {:?}", idle(options));
        }
    }

    #[test]
    fn a_number_below_0_is_refused_by_the_name_of_its_option() {
        let arguments = ["patchlight", "render", "cornell", "--epsilon", "-1"];
        let error = Cli::definition().try_get_matches_from(arguments).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("--epsilon"), "{error}");
        assert!(!error.to_string().contains("unexpected argument"), "{error}");
    }
}
