//! `bench report`: docs/experiments.md with its plots, from nothing but docs/data. The same data give the same bytes.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::Machine;
use super::table3::{Row, error_plot, jump_plot, tables};
use crate::args::{Bench, Common};
use crate::error::Error;
use crate::output;
use crate::report::{Plot, significant};

/// Folder of documents, unless it is said, and what is read and written there.
const DOCUMENTS: &str = "docs";
const TABLE3: &str = "data/table3.json";
const CLAIMS: &str = "data/claims.json";
const REPORT: &str = "experiments.md";
const PLOTS: &str = "experiments";

/// What was measured by `bench table3`.
#[derive(Deserialize)]
struct Measured {
    version: String,
    date: String,
    machine: Machine,
    device: String,
    #[serde(default)]
    note: Option<String>,
    size: (u32, u32),
    frames: u32,
    patches: u32,
    references: Vec<String>,
    rows: Vec<Row>,
}

/// What is claimed, by whom, and what is found.
#[derive(Deserialize)]
struct Claim {
    source: String,
    claim: String,
    theirs: String,
    ours: String,
    verdict: Verdict,
    reason: String,
}

/// What a claim is worth here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
enum Verdict {
    #[serde(rename = "holds")]
    Holds,
    #[serde(rename = "holds only against a slow baseline")]
    SlowBaseline,
    #[serde(rename = "does not hold")]
    Fails,
    #[serde(rename = "not measured here")]
    NotMeasured,
}

impl Verdict {
    fn text(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::SlowBaseline => "holds only against a slow baseline",
            Self::Fails => "**does not hold**",
            Self::NotMeasured => "not measured here",
        }
    }
}

/// Writes the report and its plots beside the data.
pub fn run(common: &Common, _: &Bench) -> Result<(), Error> {
    let folder = common.out.clone().unwrap_or_else(|| PathBuf::from(DOCUMENTS));
    let measured: Measured = read(&folder.join(TABLE3))?;
    let claims: Vec<Claim> = read(&folder.join(CLAIMS))?;
    if let Some(claim) = claims.iter().find(|claim| claim.has_gap()) {
        let why = format!("`{}` has an empty cell", claim.claim);
        return Err(Error::Data { path: folder.join(CLAIMS), why });
    }
    output::make_folder(&folder.join(PLOTS))?;
    for scene in measured.scenes() {
        for (name, plot) in measured.plots(scene) {
            output::write_text(&folder.join(PLOTS).join(name), &plot.svg())?;
        }
    }
    output::write_text(&folder.join(REPORT), &text(&measured, &claims))?;
    if !common.quiet {
        say!("{}", folder.join(REPORT).display());
    }
    Ok(())
}

fn read<T: DeserializeOwned>(path: &Path) -> Result<T, Error> {
    let text =
        std::fs::read_to_string(path).map_err(|source| reference::Error::Read { path: path.to_owned(), source })?;
    serde_json::from_str(&text).map_err(|e| Error::Data { path: path.to_owned(), why: e.to_string() })
}

impl Claim {
    fn has_gap(&self) -> bool {
        [&self.source, &self.claim, &self.theirs, &self.ours, &self.reason]
            .into_iter()
            .any(|cell| cell.trim().is_empty())
    }
}

impl Measured {
    /// Scenes in their order.
    fn scenes(&self) -> Vec<&str> {
        let mut scenes: Vec<&str> = self.rows.iter().map(|row| row.scene.as_str()).collect();
        scenes.dedup();
        scenes
    }

    fn of_scene(&self, scene: &str) -> Vec<Row> {
        self.rows.iter().filter(|row| row.scene == scene).cloned().collect()
    }

    fn plots(&self, scene: &str) -> [(String, Plot); 2] {
        let rows = self.of_scene(scene);
        [(format!("{scene}-error.svg"), error_plot(&rows)), (format!("{scene}-jump.svg"), jump_plot(&rows))]
    }
}

/// The whole report. Writing into a string cannot fail.
fn text(measured: &Measured, claims: &[Claim]) -> String {
    let mut text = String::from(
        "# Experiments\n\nThis page and its plots are made by `patchlight bench report` from `docs/data`; a test compares them.\n\n",
    );
    let _ = write!(text, "## Where patches are worse\n\n{}", worse(measured));
    let failed = claims.iter().filter(|claim| claim.verdict == Verdict::Fails);
    for claim in failed {
        let _ = writeln!(text, "- {} ({}): {}", claim.claim, claim.source, claim.reason);
    }
    let _ = write!(text, "\n## Every method beside each other\n\n{}", introduction(measured));
    for scene in measured.scenes() {
        let _ = write!(text, "\n### {scene}\n\n");
        for table in tables(&measured.of_scene(scene)) {
            let _ = writeln!(text, "{}", table.markdown());
        }
        for (name, plot) in measured.plots(scene) {
            let _ = writeln!(text, "![{}]({PLOTS}/{name})\n", plot.title);
        }
        let names: Vec<String> = measured.of_scene(scene).into_iter().map(|row| row.method).collect();
        let _ = writeln!(
            text,
            "![Indirect light by every method](pictures/table3-{scene}.png)\n\nFrom left to right, then down: path traced reference, {}.",
            names.join("; ")
        );
    }
    let _ = write!(text, "\n## Claims\n\n{}", claim_table(claims));
    text
}

fn introduction(measured: &Measured) -> String {
    let Measured { version, date, machine, device, size, frames, patches, .. } = measured;
    let note = measured.note.as_ref().map(|note| format!(" {note}")).unwrap_or_default();
    let mut text = format!(
        "`bench table3`, version {version}, {date}. {} Device `{device}`.{note} {patches} patches, {} × {} pixels, medians of {frames} \
         frames in which the methods take turns.\n\n\
         An update goes from lights that moved to irradiance: at the points in view for patches, in the volume for probes and \
         cells, whose lookup at all pixels is in its own column; what pixels of patches take from points is in no column. Processor \
         time is that of all cores together, in which what else the machine did is hardly seen; where it was busy, believe that. \
         Path tracing has no update: its time is that of the picture. All methods share direct light, rays and their \
         hierarchy. Bytes of opponents are those of their authors' formats. A volume that engines bake is baked anew when a \
         light moves.\n\n",
        machine.sentence(),
        size.0,
        size.1
    );
    for line in &measured.references {
        let _ = writeln!(text, "- Compared with {line}.");
    }
    text
}

/// Opponents that are named where they are better.
const NAMED: usize = 4;

/// A measure of a row: less is better.
type Measure = (&'static str, fn(&Row) -> Option<f64>, fn(f64) -> String);

const MEASURES: [Measure; 8] = [
    ("processor time of a light update, ms", |row| Some(row.processor.update_ms), significant),
    ("memory, MB", |row| (row.bytes > 0).then_some(row.bytes as f64 * 1e-6), significant),
    ("preparation, s", |row| Some(row.build_s), |x| format!("{x:.1}")),
    ("PSNR of indirect light, dB", |row| Some(-row.indirect.psnr_db), |x| format!("{:.2}", -x)),
    ("SSIM of indirect light", |row| Some(-row.indirect.ssim), |x| format!("{:.4}", -x)),
    ("FLIP of indirect light", |row| Some(row.indirect.flip), |x| format!("{x:.4}")),
    ("median error of blocks, %", |row| Some(100.0 * row.indirect.block_median_relative_error), significant),
    ("median error at points, %", |row| row.points.map(|p| 100.0 * p.median_relative_error), significant),
];

/// In which measures which opponents are better than the better of the project's own methods.
fn worse(measured: &Measured) -> String {
    let mut text = String::new();
    for scene in measured.scenes() {
        let rows = measured.of_scene(scene);
        for (name, measure, show) in MEASURES {
            let ours = rows.iter().filter(|row| row.is_own()).filter_map(measure).fold(f64::INFINITY, f64::min);
            let mut better: Vec<(f64, &Row)> = rows
                .iter()
                .filter(|row| !row.is_own())
                .filter_map(|row| Some((measure(row)?, row)))
                .filter(|(value, _)| *value < ours)
                .collect();
            better.sort_by(|a, b| a.0.total_cmp(&b.0));
            if better.is_empty() {
                continue;
            }
            let named = better.iter().take(NAMED).map(|(value, row)| format!("{} {}", row.method, show(*value)));
            let mut names: Vec<String> = named.collect();
            if better.len() > NAMED {
                names.push(format!("and {} more", better.len() - NAMED));
            }
            let _ = writeln!(text, "- {scene}, {name}: best patches {}; {}.", show(ours), names.join("; "));
        }
    }
    if text.is_empty() { "- In no measure of table 3.\n".to_owned() } else { text }
}

fn claim_table(claims: &[Claim]) -> String {
    let mut text = String::from(
        "| claim | source | its number | here | verdict | reason |\n| --- | --- | --- | --- | --- | --- |\n",
    );
    for claim in claims {
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} |",
            claim.claim,
            claim.source,
            claim.theirs,
            claim.ours,
            claim.verdict.text(),
            claim.reason
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claim_has_no_empty_cell() {
        let claim = |ours: &str| {
            let json = serde_json::json!({
                "source": "s", "claim": "c", "theirs": "1", "ours": ours, "verdict": "holds", "reason": "r",
            });
            serde_json::from_value::<Claim>(json).unwrap()
        };
        assert!(!claim("2").has_gap());
        assert!(claim(" ").has_gap());
        assert!(serde_json::from_str::<Verdict>("\"perhaps\"").is_err());
    }
}
