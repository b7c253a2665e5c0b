//! `bench report`: lab/docs/experiments.md with its plots, from nothing but lab/docs/data. The same data give the same
//! bytes.

mod bar;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use super::claims::Claims;
use super::leaks::Leaks;
use super::materials::Materials;
use super::scaling::Scaling;
use super::step::Step;
use super::study::{Record, document};
use super::table3::{Row, Table3};
use super::unseen::Unseen;
use crate::args::{Bench, Common};
use crate::error::Error;
use crate::output;
use crate::report::significant;

/// Folder of documents, unless it is said, and what is read and written there.
const DOCUMENTS: &str = "lab/docs";
const CLAIMS: &str = "data/claims.json";
const REPORT: &str = "experiments.md";
const PLOTS: &str = "experiments";

/// Writes the report and its plots beside the data.
pub fn run(common: &Common, _: &Bench) -> Result<(), Error> {
    let folder = common.out.clone().unwrap_or_else(|| PathBuf::from(DOCUMENTS));
    output::make_folder(&folder.join(PLOTS))?;
    let text = text(&folder)?;
    output::write_text(&folder.join(REPORT), &text)?;
    if !common.quiet {
        say!("{}", folder.join(REPORT).display());
    }
    Ok(())
}

/// The whole report. Writing into a string cannot fail.
fn text(folder: &Path) -> Result<String, Error> {
    let (methods, table3) = document::<Table3>(folder)?;
    let sections = [
        table3,
        document::<Leaks>(folder)?.1,
        document::<Step>(folder)?.1,
        document::<Materials>(folder)?.1,
        document::<Unseen>(folder)?.1,
        document::<Scaling>(folder)?.1,
    ];
    // Their numbers are those of the experiments, which are there by now.
    let claims = Claims::read(&folder.join(CLAIMS))?;
    let mut text = String::from(
        "# Experiments\n\nThis page and its plots are made by `patchlight bench report` from `data`; a test compares \
         them.\n\n\
         ## What does not hold\n\n",
    );
    text += &bar::text(&methods);
    let _ = write!(text, "\nOf what this project and its sources claim:\n\n");
    for claim in claims.failed() {
        let _ = writeln!(text, "- {} ({}): {}", claim.claim, claim.source, claim.reason);
    }
    let _ =
        write!(text, "\nWhere opponents, or baselines on the same patches, are better than tiles and temporal:\n\n");
    text += &worse(&methods);
    let _ = write!(text, "\n## Claims\n\n{}", claims.table(false));
    let _ = write!(text, "\n## What opponents' authors show\n\n{}", claims.table(true));
    for section in sections {
        let _ = write!(text, "\n{section}");
    }
    Ok(text)
}

/// Opponents that are named where they are better.
const NAMED: usize = 4;

/// A measure of a row: less is better.
type Measure = (&'static str, fn(&Row) -> Option<f64>, fn(f64) -> String);

const MEASURES: [Measure; 8] = [
    ("processor time of a light update, ms", |row| Some(row.times.processor.median_ms), significant),
    ("memory, MB", |row| (row.who.bytes > 0).then_some(row.who.megabytes()), significant),
    ("preparation, s", |row| Some(row.who.build_s), |x| format!("{x:.1}")),
    ("PSNR of indirect light, dB", |row| Some(-row.indirect.psnr_db), |x| format!("{:.2}", -x)),
    ("SSIM of indirect light", |row| Some(-row.indirect.ssim), |x| format!("{:.4}", -x)),
    ("FLIP of indirect light", |row| Some(row.indirect.flip), |x| format!("{x:.4}")),
    ("median error of blocks, %", |row| Some(100.0 * row.indirect.block_median_relative_error), significant),
    ("median error at points, %", |row| row.points.map(|p| 100.0 * p.median_relative_error), significant),
];

/// In which measures which others are better than the better of the project's own methods, by more than is shown of a
/// number.
fn worse(record: &Record<Row>) -> String {
    let mut text = String::new();
    for scene in &record.scenes {
        for (name, measure, show) in MEASURES {
            let own = scene.rows.iter().filter(|row| row.who.is_own());
            let ours = own.filter_map(measure).fold(f64::INFINITY, f64::min);
            let others = scene.rows.iter().filter(|row| !row.who.is_own());
            let mut better: Vec<(f64, &Row)> = others
                .filter_map(|row| Some((measure(row)?, row)))
                .filter(|(value, _)| *value < ours && show(*value) != show(ours))
                .collect();
            better.sort_by(|a, b| a.0.total_cmp(&b.0));
            if better.is_empty() {
                continue;
            }
            let named = better.iter().take(NAMED).map(|(value, row)| format!("{} {}", row.who.method, show(*value)));
            let mut names: Vec<String> = named.collect();
            if better.len() > NAMED {
                names.push(format!("and {} more", better.len() - NAMED));
            }
            let _ = writeln!(text, "- {}, {name}: ours {}; {}.", scene.scene, show(ours), names.join("; "));
        }
    }
    if text.is_empty() { "- In no measure of table 3.\n".to_owned() } else { text }
}
