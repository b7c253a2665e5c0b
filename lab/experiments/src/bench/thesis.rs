//! `bench thesis`: the figures of A. S. Shcherbakov's thesis, measured here: as printed beside ours.

mod clusters;
mod lamp;
mod local;
mod matrix;
mod patches;
mod solvers;
mod tables;

use std::path::Path;

use serde::Serialize;

use super::setup::Setup;
use crate::args::{Bench, Common, Experiment};
use crate::error::Error;
use crate::output;
use crate::progress::Progress;
use crate::report::{Plot, Table};
use assets::import::LoadedScene;
use reference::Picture;

/// A figure that can be measured, or what a chapter or section says.
struct Figure {
    /// Its number.
    name: &'static str,
    /// Caption.
    says: &'static str,
    /// Patches of each scene unless it is said.
    counts: &'static [u32],
    measure: fn(&Study) -> Result<Outcome, Error>,
}

const FIGURES: &[Figure] = &[
    Figure {
        name: "2.2.5",
        says: "section: classic solvers of all bounces, by elimination, iteration, chance and links: time, memory, \
             errors",
        counts: &[1000],
        measure: solvers::solvers,
    },
    Figure {
        name: "3.2",
        says: "form factors by their value, and entries of the matrix of three bounces",
        counts: &[1000],
        measure: matrix::histogram,
    },
    Figure {
        name: "3.3",
        says: "error of BC1 before listing 3.1 puts patches in order: as printed beside ours, with 3.4",
        counts: &[1000],
        measure: matrix::compression,
    },
    Figure { name: "3.4", says: "the same after it, with 3.3", counts: &[1000], measure: matrix::compression },
    Figure {
        name: "3.10",
        says: "time of the light over the number of bounces: form factors, the matrix, its blocks",
        counts: &[1000],
        measure: matrix::bounces,
    },
    Figure {
        name: "3.11",
        says: "bytes of the same, and what preprocessing takes more",
        counts: &[500, 1000],
        measure: matrix::bytes,
    },
    Figure {
        name: "4",
        says: "chapter: clusters of patches that overlap, each with a matrix of its own: edges in the light, work, \
             bytes",
        counts: &[2000],
        measure: clusters::overlapping,
    },
    Figure {
        name: "4.12",
        says: "the whole matrix beside the local one, as printed and ours: work, time, errors; what is visible and lit",
        counts: &[500, 1000, 2000],
        measure: local::figure,
    },
    Figure {
        name: "5.3",
        says: "light by virtual patches: as printed, ours, a voxelised proxy, the reference",
        counts: &[1000],
        measure: patches::virtual_patches,
    },
    Figure { name: "5.4", says: "the same by patches along the axes", counts: &[1000], measure: patches::axis_patches },
    Figure {
        name: "6.4",
        says: "section: a lamp that moves, by sampled light that lags and by a small matrix round it",
        counts: &[2000],
        measure: lamp::moving,
    },
    Figure {
        name: "table1",
        says: "time of products and of sampled light over the number of patches",
        counts: &[1736, 5485, 8786, 10_422],
        measure: tables::time,
    },
    Figure {
        name: "table2",
        says: "errors of products and of sampled light against path tracing",
        counts: &[2000],
        measure: tables::accuracy,
    },
];

/// Input of a figure's measurement.
struct Study<'a> {
    common: &'a Common,
    args: &'a Bench,
    loaded: &'a LoadedScene,
    /// Patches.
    counts: Vec<u32>,
    /// Folder of pictures.
    out: &'a Path,
    progress: &'a Progress,
}

impl Study<'_> {
    /// A file of this figure and scene.
    fn file(&self, what: &str) -> std::path::PathBuf {
        self.out.join(format!("{}-{what}", self.loaded.name))
    }
}

/// Results of one scene.
struct Outcome {
    /// The numbers.
    rows: serde_json::Value,
    tables: Vec<Table>,
    /// Names of files, and what they show.
    plots: Vec<(&'static str, Plot)>,
}

/// summary.json.
#[derive(Serialize)]
struct Results<'a> {
    name: String,
    machine: &'a super::Machine,
    seed: u32,
    scenes: serde_json::Map<String, serde_json::Value>,
}

/// Numbers of the figures, in order.
pub fn names() -> impl Iterator<Item = &'static str> {
    FIGURES.iter().map(|figure| figure.name)
}

/// Measures one of [`names`] in the scenes of the options.
///
/// # Errors
/// As [`run`].
pub fn run_one(common: &Common, args: &Bench, name: &str) -> Result<(), Error> {
    let scenes = [&[name.to_owned()], &args.scenes[..]].concat();
    run(common, &Bench { name: Experiment::Thesis, scenes, ..args.clone() })
}

/// Measures the figure that the first word names; without one lists them.
///
/// # Errors
/// [`Error::NoFigure`], what the measurement meets.
pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let Some((name, scenes)) = args.scenes.split_first() else {
        FIGURES.iter().for_each(|figure| say!("{:6} {}", figure.name, figure.says));
        return Ok(());
    };
    let Some(figure) = FIGURES.iter().find(|figure| figure.name == name) else {
        let known = names().collect::<Vec<_>>().join(", ");
        return Err(Error::NoFigure { name: name.clone(), known });
    };
    let args = &Bench { scenes: scenes.to_vec(), ..args.clone() };
    let folder = format!("thesis-{}", figure.name);
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, &folder, &super::SCENES, figure.counts)?;
    let mut results = Results {
        name: format!("thesis {}", figure.name),
        machine: &machine,
        seed: common.seed,
        scenes: <_>::default(),
    };
    let mut text = String::new();
    for scene in scenes {
        let progress = Progress::new(common.quiet);
        let loaded = output::import_flat(scene, &progress)?;
        patchlight::MethodSettings::Classic.check_medium(&loaded.scene)?;
        let study = Study { common, args, loaded: &loaded, counts: counts.clone(), out: &out, progress: &progress };
        let Outcome { rows, tables, plots } = (figure.measure)(&study)?;
        for (name, plot) in &plots {
            output::write_text(&study.file(&format!("{name}.svg")), &plot.svg())?;
        }
        text += &format!("## Thesis {}, {}\n\n", figure.name, loaded.name);
        tables.iter().for_each(|table| text += &(table.markdown() + "\n"));
        results.scenes.insert(loaded.name.clone(), rows);
        output::write_text(&out.join("summary.json"), &output::json(&results))?;
    }
    output::write_text(&out.join("report.md"), &text)?;
    if common.json {
        say!("{}", output::json(&results));
    } else {
        say!("{text}{} has the numbers and the pictures", out.display());
    }
    Ok(())
}

/// Pictures of one size, side by side.
fn beside(pictures: &[&Picture]) -> Result<Picture, Error> {
    let (width, height) = pictures.first().map_or((0, 0), |picture| (picture.width, picture.height));
    let rows = (0..height as usize).flat_map(|y| {
        let row = move |picture: &&Picture| picture.pixels[y * width as usize..(y + 1) * width as usize].to_vec();
        pictures.iter().flat_map(row)
    });
    Ok(Picture::from_pixels(width * pictures.len() as u32, height, rows.collect())?)
}
