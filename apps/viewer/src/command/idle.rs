//! Options that have nothing to do in a run of the viewer.

use shell::args::common::Patches;
use shell::args::idle::Rule;
use shell::args::{FormFactors, Input, Method, ReceiverPlaces};

use super::View;

/// Which options are for which runs; those that are not here are for all.
pub const RULES: &[Rule<View>] = &[
    Rule {
        options: &[
            "methods",
            "epsilon",
            "bounces",
            "patches",
            "patch_count",
            "voxel_size",
            "form_factors",
            "receivers",
            "receiver_rays",
        ],
        whom: "scenes, not bakes, which have their own",
        suits: |_, input| input == Input::Scene,
    },
    Rule {
        options: &["codec"],
        whom: "scenes, not bakes, with --for multibounce",
        suits: |args, input| input == Input::Scene && args.methods.contains(&Method::Multibounce),
    },
    Rule {
        options: &["focus"],
        whom: "scenes, not bakes, with --patches polygon or cluster",
        suits: |args, input| {
            input == Input::Scene && !matches!(args.bake.patches.patches, Some(Patches::Voxel | Patches::Axis))
        },
    },
    Rule {
        options: &["rays"],
        whom: "scenes, not bakes, with --form-factors hemisphere",
        suits: |args, input| input == Input::Scene && args.bake.form_factors == FormFactors::Hemisphere,
    },
    Rule {
        options: &["receiver_edge", "most_receivers"],
        whom: "scenes, not bakes, with --receivers mesh",
        suits: |args, input| input == Input::Scene && args.bake.receivers == ReceiverPlaces::Mesh,
    },
];
