//! `patchlight bench`: experiments as Markdown on standard output, summary.json, SVG plots and report.html.

mod all;
mod bake;
mod claims;
mod clean;
mod contest;
mod firstshot;
mod frame;
mod leaks;
mod lights;
mod local;
mod materials;
mod moving;
mod operator;
mod patches;
mod proof;
mod refine;
mod rows;
mod scaling;
mod setup;
mod spread;
mod step;
mod study;
mod table3;
mod temporal;
mod thesis;
mod truth;
mod unseen;

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::args::{Bench, Common, Experiment, Patches};
use crate::error::Error;
use crate::output;
use crate::report::page;
use patches::SceneResult;
use rows::Row;
use setup::{Machine, SCENES, Setup};

/// Patches of the experiment with patches.
const COUNTS: [u32; 5] = [1000, 2000, 5000, 10_000, 20_000];
/// Their kinds.
const KINDS: [Patches; 3] = [Patches::Voxel, Patches::Axis, Patches::Cluster];
/// Conditions of the rows of the experiment with patches, beside what they say: a run goes on only from its like.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Basis {
    seed: u32,
    rays: u32,
    receiver_rays: u32,
    sub_frames: u32,
    /// Size of path-traced references.
    size: (u32, u32),
    spp: u32,
    /// Patches of the break-down, the lights and the pictures.
    most_patches: u32,
}

impl Basis {
    fn new(common: &Common, args: &Bench, most_patches: u32) -> Self {
        let Bench { rays, sub_frames, spp, .. } = *args;
        let size = args.size();
        Self { seed: common.seed, rays, receiver_rays: args.receiver_rays(), sub_frames, size, spp, most_patches }
    }
}

/// summary.json of the experiment with patches.
#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    machine: &'a Machine,
    #[serde(flatten)]
    basis: &'a Basis,
    rows: Vec<&'a Row>,
}

/// State that a run that goes on needs.
#[derive(Deserialize)]
struct Before {
    #[serde(flatten)]
    basis: Basis,
    rows: Vec<Row>,
}

/// Runs an experiment.
///
/// # Errors
/// What the experiment meets.
pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    if args.references == Some(None) && args.name != Experiment::Clean {
        return Err(Error::NoReferenceFolder);
    }
    if args.name != Experiment::Report && !(args.name == Experiment::Thesis && args.scenes.is_empty()) {
        output::check_out(&common.out)?;
    }
    match args.name {
        Experiment::Clean => clean::run(common, args),
        Experiment::Patches => run_patches(common, args),
        Experiment::Operator => operator::run(common, args),
        Experiment::Temporal => temporal::run(common, args),
        Experiment::Spread => spread::run(common, args),
        Experiment::Local => local::run(common, args),
        Experiment::Frame => frame::run(common, args),
        Experiment::Refine => refine::run(common, args),
        Experiment::Moving => moving::run(common, args),
        Experiment::Bake => bake::run(common, args),
        Experiment::Table3 => study::run::<table3::Table3>(common, args),
        Experiment::Leaks => study::run::<leaks::Leaks>(common, args),
        Experiment::Step => study::run::<step::Step>(common, args),
        Experiment::Materials => study::run::<materials::Materials>(common, args),
        Experiment::Scaling => study::run::<scaling::Scaling>(common, args),
        Experiment::Unseen => study::run::<unseen::Unseen>(common, args),
        Experiment::Report => proof::run(common, args),
        Experiment::Thesis => thesis::run(common, args),
        Experiment::Table1 => thesis::run_one(common, args, "table1"),
        Experiment::Table2 => thesis::run_one(common, args, "table2"),
        Experiment::Bounces => thesis::run_one(common, args, "3.10"),
        Experiment::All => all::run(common, args),
        Experiment::Firstshot => {
            common.native_only("patchlight-bench firstshot")?;
            firstshot::run(common, args)
        }
    }
}

fn run_patches(common: &Common, args: &Bench) -> Result<(), Error> {
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, "patches", &SCENES, &COUNTS)?;
    let kinds = if args.kinds.is_empty() { KINDS.to_vec() } else { args.kinds.clone() };
    let args = &Bench { counts, kinds, ..args.clone() };
    let basis = Basis::new(common, args, patches::main_count(&args.counts));
    let numbers = out.join("summary.json");
    let known = if args.resume { rows_before(&numbers, &basis)? } else { Vec::new() };
    let text = |results: &[SceneResult], rows: &[Row]| {
        let new: Vec<&Row> = results.iter().flat_map(|result| &result.rows).chain(rows).collect();
        let old = known.iter().filter(|old| new.iter().all(|row| row.key() != old.key()));
        let rows = new.iter().copied().chain(old).collect();
        output::json(&Results { name: "patches", machine: &machine, basis: &basis, rows })
    };
    let mut results = Vec::new();
    for scene in scenes {
        // What is known is kept when the rest fails or is stopped.
        let keep = |rows: &[Row]| Ok(output::write_text(&numbers, &text(&results, rows))?);
        let result = patches::one_scene(common, args, scene, &out, &known, &keep)?;
        results.push(result);
        write(&machine, &results, &out)?;
    }
    if common.json {
        say!("{}", text(&results, &[]));
    } else {
        results.iter().for_each(|result| say!("{}", result.markdown()));
        say!("{} shows the same with pictures", out.join("report.html").display());
    }
    Ok(())
}

/// The rows of a run before; none where there was none.
fn rows_before(path: &Path, basis: &Basis) -> Result<Vec<Row>, Error> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text =
        std::fs::read_to_string(path).map_err(|source| reference::Error::Read { path: path.to_owned(), source })?;
    let other = |why: String| Error::OtherExperiment { path: path.to_owned(), why };
    let before: Before = serde_json::from_str(&text).map_err(|e| other(e.to_string()))?;
    if before.basis != *basis {
        return Err(other(format!("{:?} there, {basis:?} here", before.basis)));
    }
    Ok(before.rows)
}

fn write(machine: &Machine, results: &[SceneResult], out: &Path) -> Result<(), Error> {
    for result in results {
        for (name, plot) in result.plot_names().zip(&result.section.plots) {
            output::write_text(&out.join(name), &plot.svg())?;
        }
    }
    let introduction = [
        machine.sentence(),
        "Errors are those of indirect light. Blocks are means of 8 × 8 pixels: the median of the relative errors of \
         their luminance, and the PSNR of what a display shows of them, exposed by 0.18 over the log-average of the \
         reference. Points gather exactly from the patches, so their errors do not depend on receivers."
            .to_owned(),
    ];
    let sections = results.iter().map(|result| &result.section);
    Ok(output::write_text(&out.join("report.html"), &page("Patchlight: virtual patches", &introduction, sections))?)
}
