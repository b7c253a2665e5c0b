//! Options that have nothing to do in a run of `render`, `bake` or `info`: one table each says which options are for
//! which runs.

use crate::args::Render;
use crate::bake::Bake;
use shell::args::common::Patches;
use shell::args::idle::Rule;
use shell::args::{FormFactors, Input, Method, ReceiverPlaces, Storage, Switch};

/// A rule for one method.
macro_rules! of_method {
    ($method:ident, $name:literal, [$($option:literal),+]) => {
        Rule {
            options: &[$($option),+],
            whom: concat!("--method ", $name),
            suits: |args, _| args.method == Method::$method,
        }
    };
}

/// Which options are for which runs; those that are not here are for all.
pub const RULES: &[Rule<Render>] = &[
    of_method!(Temporal, "temporal", ["samples", "control_variate", "rotated", "rows", "sampled"]),
    Rule {
        options: &["blend"],
        whom: "--method temporal with --control-variate off",
        suits: |args, _| args.method == Method::Temporal && args.temporal.control_variate == Switch::Off,
    },
    Rule {
        options: &["refresh"],
        whom: "--method temporal with --control-variate on",
        suits: |args, _| args.method == Method::Temporal && args.temporal.control_variate == Switch::On,
    },
    of_method!(Local, "local", ["slots", "at_rest"]),
    Rule {
        options: &["budget", "look_ahead", "fade"],
        whom: "--method local without --at-rest",
        suits: |args, _| args.method == Method::Local && !args.local.at_rest,
    },
    of_method!(Feedback, "feedback", ["products", "plain"]),
    of_method!(
        Firstshot,
        "firstshot",
        ["error", "photons", "subdivision", "texels", "start_light", "cubic", "sequence"]
    ),
    of_method!(Multibounce, "multibounce", ["codec"]),
    Rule {
        options: &["epsilon"],
        whom: "--method low_rank and feedback, and multibounce with --codec low_rank",
        suits: |args, _| match args.method {
            Method::LowRank | Method::Feedback => true,
            Method::Multibounce => args.operators.codec.unwrap_or_default() == Storage::LowRank,
            _ => false,
        },
    },
    Rule {
        options: &["decode"],
        whom: "--method multibounce with --codec bc1, bc3, bc6h or bc7",
        suits: |args, _| {
            let blocks = [Storage::Bc1, Storage::Bc3, Storage::Bc6h, Storage::Bc7];
            args.method == Method::Multibounce && args.operators.codec.is_some_and(|codec| blocks.contains(&codec))
        },
    },
    Rule {
        options: &["build_on"],
        whom: "scenes, not bakes, and not for --method path",
        suits: |args, input| args.method != Method::Path && input == Input::Scene,
    },
    Rule {
        options: &["bounces"],
        whom: "scenes, not bakes, by methods other than firstshot and local, which take all bounces; and for --method \
             path",
        suits: |args, input| match args.method {
            Method::Firstshot | Method::Local => false,
            Method::Path => true,
            _ => input == Input::Scene,
        },
    },
    Rule {
        options: &["seed"],
        whom: "scenes, not bakes, which have their own; and for --method path",
        suits: |args, input| input == Input::Scene || args.method == Method::Path,
    },
    Rule { options: &["animate", "path"], whom: "--frames above 1", suits: |args, _| args.frames > 1 },
    Rule {
        options: &["resume"],
        whom: "--method path with one frame",
        suits: |args, _| args.method == Method::Path && args.frames == 1,
    },
    Rule {
        options: &["reference"],
        whom: "scenes and their bakes, not worlds",
        suits: |_, input| input != Input::World,
    },
    Rule {
        options: &["direct", "errors", "debug", "graph"],
        whom: "scenes and their bakes, not worlds, by methods other than path",
        suits: |args, input| input != Input::World && args.method != Method::Path,
    },
    Rule {
        options: &["patches", "patch_count", "voxel_size", "form_factors", "receivers", "receiver_rays"],
        whom: "scenes, not bakes, by methods other than path",
        suits: makes_patches,
    },
    Rule {
        options: &["focus"],
        whom: "scenes, not bakes, by methods other than path, with --patches polygon or cluster",
        suits: |args, input| {
            makes_patches(args, input) && !matches!(args.bake.patches.patches, Some(Patches::Voxel | Patches::Axis))
        },
    },
    Rule {
        options: &["rays"],
        whom: "scenes, not bakes, by methods other than path, with --form-factors hemisphere",
        suits: |args, input| makes_patches(args, input) && args.bake.form_factors == FormFactors::Hemisphere,
    },
    Rule {
        options: &["receiver_edge", "most_receivers"],
        whom: "scenes, not bakes, by methods other than path, with --receivers mesh",
        suits: |args, input| makes_patches(args, input) && args.bake.receivers == ReceiverPlaces::Mesh,
    },
];

/// Returns true if a run makes patches.
fn makes_patches(args: &Render, input: Input) -> bool {
    input == Input::Scene && args.method != Method::Path
}

/// Rules for `bake`.
pub const BAKE_RULES: &[Rule<Bake>] = &[
    Rule {
        options: &["codec"],
        whom: "--for multibounce",
        suits: |args, _| args.methods.contains(&Method::Multibounce),
    },
    Rule {
        options: &["epsilon"],
        whom: "--for low_rank and feedback, and multibounce with --codec low_rank",
        suits: |args, _| {
            let is_low_rank = args.operators.codec.unwrap_or_default() == Storage::LowRank;
            args.methods.iter().any(|method| match method {
                Method::LowRank | Method::Feedback => true,
                Method::Multibounce => is_low_rank,
                _ => false,
            })
        },
    },
    Rule {
        options: &["focus"],
        whom: "--patches polygon or cluster",
        suits: |args, _| !matches!(args.bake.patches.patches, Some(Patches::Voxel | Patches::Axis)),
    },
    Rule {
        options: &["rays"],
        whom: "--form-factors hemisphere",
        suits: |args, _| args.bake.form_factors == FormFactors::Hemisphere,
    },
    Rule {
        options: &["receiver_edge", "most_receivers"],
        whom: "--receivers mesh",
        suits: |args, _| args.bake.receivers == ReceiverPlaces::Mesh,
    },
];

/// Rules for `info`.
pub const INFO_RULES: &[Rule<()>] = &[Rule {
    options: &["patches", "patch_count", "voxel_size", "focus", "operator", "codec", "epsilon", "decode"],
    whom: "scenes, not bakes",
    suits: |(), input| input == Input::Scene,
}];

#[cfg(test)]
mod tests {
    use shell::args::definition;
    use shell::args::idle::idle_options;

    use super::*;
    use crate::cli::{Cli, Command};

    /// The names of the options that are idle when `render cornell` is given these.
    fn idle(options: &[&str]) -> Vec<String> {
        idle_of(Input::Scene, options)
    }

    fn idle_of(input: Input, options: &[&str]) -> Vec<String> {
        let all = ["patchlight", "render", "cornell"].iter().chain(options);
        let matches = definition::<Cli>().try_get_matches_from(all).unwrap();
        let cli = <Cli as clap::FromArgMatches>::from_arg_matches(&matches).unwrap();
        let Some(Command::Render(args)) = cli.command else { panic!("render") };
        let matches = matches.subcommand_matches("render").unwrap();
        idle_options(RULES, matches, (&args, input)).into_iter().map(name).collect()
    }

    fn name(line: String) -> String {
        line.split_once(' ').unwrap().0.to_owned()
    }

    fn idle_in_bake(options: &[&str]) -> Vec<String> {
        let all = ["patchlight", "bake", "cornell"].iter().chain(options);
        let matches = definition::<Cli>().try_get_matches_from(all).unwrap();
        let cli = <Cli as clap::FromArgMatches>::from_arg_matches(&matches).unwrap();
        let Some(Command::Bake(args)) = cli.command else { panic!("bake") };
        let matches = matches.subcommand_matches("bake").unwrap();
        idle_options(BAKE_RULES, matches, (&args, Input::Scene)).into_iter().map(name).collect()
    }

    #[test]
    fn every_rule_names_options_of_its_command() {
        let mut command = definition::<Cli>();
        command.build();
        let check = |name: &str, option: &str| {
            let command = command.find_subcommand(name).unwrap();
            assert!(command.get_arguments().any(|arg| arg.get_id() == option), "{name} {option}");
        };
        RULES.iter().flat_map(|rule| rule.options).for_each(|option| check("render", option));
        BAKE_RULES.iter().flat_map(|rule| rule.options).for_each(|option| check("bake", option));
        INFO_RULES.iter().flat_map(|rule| rule.options).for_each(|option| check("info", option));
    }

    #[test]
    fn what_a_bake_has_decided_is_named() {
        let decided: [&[&str]; 12] = [
            &["--patch-count", "50"],
            &["--patches", "axis"],
            &["--voxel-size", "0.5"],
            &["--form-factors", "area"],
            &["--rays", "64"],
            &["--receivers", "pixels"],
            &["--receiver-edge", "0.1"],
            &["--most-receivers", "50"],
            &["--receiver-rays", "64"],
            &["--bounces", "3"],
            &["--build-on", "host"],
            &["--seed", "3"],
        ];
        for options in decided {
            let found = idle_of(Input::Bake, &[&["--method", "low_rank"], options].concat());
            assert_eq!(found, [options[0]], "{options:?}");
        }
        let free = ["--method", "low_rank", "--epsilon", "0.1", "--errors", "--debug", "--reference", "x"];
        assert!(idle_of(Input::Bake, &free).is_empty());
        assert!(idle_of(Input::Bake, &["--method", "path", "--bounces", "3", "--seed", "3"]).is_empty());
        assert_eq!(idle_of(Input::World, &["--method", "local", "--errors", "--seed", "3"]).len(), 2);
    }

    #[test]
    fn options_of_operators_that_are_not_baked_are_named() {
        assert_eq!(idle_in_bake(&["--codec", "bc1"]), ["--codec"]);
        assert_eq!(idle_in_bake(&["--for", "temporal", "--epsilon", "0.1"]), ["--epsilon"]);
        assert_eq!(idle_in_bake(&["--receivers", "pixels", "--receiver-edge", "1"]), ["--receiver-edge"]);
        let apply =
            ["--for", "multibounce,feedback", "--codec", "dense", "--epsilon", "0.1", "--rays", "64", "--seed", "3"];
        assert!(idle_in_bake(&apply).is_empty());
    }

    #[test]
    fn options_that_cannot_apply_are_named() {
        // Those that classic radiosity ignores.
        let classic: [&[&str]; 23] = [
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
            &["--subdivision", "kopylov"],
            &["--texels", "brightest"],
            &["--start-light", "table"],
            &["--cubic", "cardano"],
            &["--sequence", "random"],
            &["--epsilon", "0.1"],
            &["--resume"],
            &["--codec", "bc1"],
            &["--animate", "sun"],
            &["--path", "fly"],
        ];
        let by_classic = |options: &[&str]| idle(&[&["--method", "classic"], options].concat());
        for options in classic {
            assert_eq!(by_classic(options), [options[0]], "{options:?}");
        }
        assert_eq!(by_classic(&classic.concat()).len(), classic.len());
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
            &[
                "--method",
                "firstshot",
                "--error",
                "0.1",
                "--photons",
                "1000",
                "--cubic",
                "cardano",
                "--sequence",
                "random",
            ],
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
        let error = definition::<Cli>().try_get_matches_from(arguments).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("--epsilon"), "{error}");
        assert!(!error.to_string().contains("unexpected argument"), "{error}");
    }
}
