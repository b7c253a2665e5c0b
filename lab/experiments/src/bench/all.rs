//! `bench all`: every experiment, one after the other, each in a folder of its own.

use std::path::Path;

use clap::ValueEnum as _;

use crate::args::{Bench, Blocks, Common, Experiment};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, is_cancelled};

/// Scenes of the smallest settings, and another for what needs more room than a box.
const SMALL_SCENE: &str = "cornell";
const SMALL_HALL: &str = "atrium:3000";

/// Runs all experiments; with `--quick` each at its smallest setting.
pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let folder = output::folder_or(&common.out, "bench-all");
    let progress = Progress::new(common.quiet);
    for &name in Experiment::value_variants() {
        // Figures of the thesis are all measured with it.
        let is_figure = matches!(name, Experiment::Table1 | Experiment::Table2 | Experiment::Bounces);
        if is_figure || matches!(name, Experiment::All | Experiment::Report) {
            continue;
        }
        if is_cancelled() {
            return Err(shell::Error::Cancelled.into());
        }
        if name == Experiment::Thesis {
            thesis_figures(common, args, &folder)?;
            continue;
        }
        let title = name.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
        progress.note(&format!("bench {title}"));
        let common = Common { out: Some(folder.join(&title)), ..common.clone() };
        let args = if args.quick { smallest(name, args, &folder) } else { Bench { name, ..args.clone() } };
        super::run(&common, &args)?;
    }
    Ok(())
}

/// Every figure of the thesis.
fn thesis_figures(common: &Common, args: &Bench, folder: &Path) -> Result<(), Error> {
    for figure in super::thesis::names() {
        let common = Common { out: Some(folder.join(format!("thesis-{figure}"))), ..common.clone() };
        let own = if args.quick { smallest(Experiment::Thesis, args, folder) } else { args.clone() };
        super::thesis::run_one(&common, &own, figure)?;
    }
    Ok(())
}

/// The smallest setting of an experiment; references that it makes are kept in the folder.
pub fn smallest(name: Experiment, args: &Bench, folder: &Path) -> Bench {
    let scene = match name {
        Experiment::Firstshot | Experiment::Frame | Experiment::Local => SMALL_HALL,
        Experiment::Clean | Experiment::Leaks => "rooms:wall=0.1",
        Experiment::Moving => "cornell:block",
        _ => SMALL_SCENE,
    };
    let counts = match name {
        Experiment::Patches => vec![100, 200],
        // More than it has slots.
        Experiment::Local => vec![600],
        _ => vec![200],
    };
    Bench {
        name,
        scenes: vec![scene.to_owned()],
        counts,
        epsilons: vec![0.1, 0.02],
        codecs: vec![Blocks::Bc1],
        error: 0.05,
        densities: vec![1.0],
        paths: (name == Experiment::Clean).then_some(32),
        cache: matches!(name, Experiment::Clean | Experiment::Leaks).then(|| folder.join("references")),
        size: Some((96, 64)),
        spp: 16,
        sub_frames: 1,
        frames: Some(2),
        rays: 128,
        receiver_rays: Some(32),
        receivers: 700,
        receiver_epsilons: vec![0.1],
        spacings: vec![2.0, 4.0],
        probe_rays: vec![32],
        ..args.clone()
    }
}
