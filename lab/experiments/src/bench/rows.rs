//! Rows of an experiment, and the tables that they make.

use reference::metrics::compare_points;
use reference::{PictureErrors, PointErrors};
use serde::{Deserialize, Serialize};

use super::truth::{Noise, Truth};
use crate::args::Part;
use crate::error::Error;
use crate::errors::picture_errors;
use crate::output;
use crate::report::{Table, significant};
use patchlight::Pictures;

/// One measurement. What was not measured is left out.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    pub scene: String,
    pub part: Part,
    pub method: String,
    /// In words: the kind of patches, what is more exact, the light.
    pub what: String,
    /// Receivers: where they are, and how many for each that there is by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub receivers_at: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub receiver_density: Option<f32>,
    /// Patches asked for.
    pub patch_count: usize,
    pub patches: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub receivers: Option<usize>,
    /// Seconds before the first frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bake_s: Option<f64>,
    /// Median of the frames: all passes but shading, and shading.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub median_ms: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shade_ms: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    #[serde(flatten)]
    pub errors: Errors,
    /// Noise of the reference.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference_noise: Option<Noise>,
}

/// Key of a row: scene, part, subject, receivers and how many for each, patches.
pub type Key<'a> = (&'a str, Part, &'a str, Option<&'a str>, Option<f32>, usize);

impl Row {
    /// Key of a row. Rows with the same are measurements of the same.
    pub fn key(&self) -> Key<'_> {
        let Self { scene, part, what, receivers_at, receiver_density, patch_count, .. } = self;
        (scene, *part, what, receivers_at.as_deref(), *receiver_density, *patch_count)
    }
}

/// Errors of pictures and points.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Errors {
    #[serde(skip_serializing_if = "Option::is_none")]
    psnr_db: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ssim: Option<f64>,
    indirect_psnr_db: f64,
    indirect_ssim: f64,
    pub indirect_block_median: f64,
    pub indirect_block_psnr_db: f64,
    indirect_mean_ratio: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    points_median: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    points_p95: Option<f64>,
}

impl Errors {
    /// Errors of a whole frame.
    pub fn of(pictures: &Pictures, points: Option<&[glam::Vec3]>, truth: &Truth, stops: f32) -> Result<Self, Error> {
        let (full, indirect) = picture_errors(pictures, &truth.pictures, stops)?;
        let points = points.map(|points| compare_points(points, &truth.point_indirect)).transpose()?;
        Ok(Self { psnr_db: Some(full.psnr_db), ssim: Some(full.ssim), ..Self::of_indirect(&indirect, points) })
    }

    /// Errors of indirect light alone.
    pub fn of_indirect(indirect: &PictureErrors, points: Option<PointErrors>) -> Self {
        Self {
            psnr_db: None,
            ssim: None,
            indirect_psnr_db: indirect.psnr_db,
            indirect_ssim: indirect.ssim,
            indirect_block_median: indirect.block_median_relative_error,
            indirect_block_psnr_db: indirect.block_psnr_db,
            indirect_mean_ratio: indirect.mean_ratio,
            points_median: points.map(|p| p.median_relative_error),
            points_p95: points.map(|p| p.p95_relative_error),
        }
    }

    /// Block median, block PSNR, mean ratio, points.
    fn cells(&self) -> [String; 4] {
        [
            percent(self.indirect_block_median),
            format!("{:.1} dB", self.indirect_block_psnr_db),
            format!("{:.3}", self.indirect_mean_ratio),
            or_dash(self.points_median.zip(self.points_p95), |(median, p95)| {
                format!("{} / {}", percent(median), percent(p95))
            }),
        ]
    }
}

const ERROR_HEAD: [&str; 4] = ["block median", "block PSNR", "mean ratio", "points median / p95"];

fn percent(share: f64) -> String {
    let value = 100.0 * share;
    if value < 100.0 { format!("{value:.2} %") } else { format!("{value:.0} %") }
}

fn or_dash<T>(value: Option<T>, text: impl FnOnce(T) -> String) -> String {
    value.map_or_else(|| "–".into(), text)
}

fn table(caption: &str, head: &[&str], rows: Vec<Vec<String>>) -> Table {
    Table { caption: caption.into(), head: head.iter().map(|h| (*h).to_owned()).collect(), rows }
}

/// Errors over kinds and numbers.
pub fn patches_table(rows: &[Row]) -> Table {
    let row = |r: &Row| {
        let at = match (r.receivers_at.as_deref(), r.receiver_density) {
            (Some(at), Some(density)) => format!("{at} × {density}"),
            (at, _) => at.unwrap_or("–").to_owned(),
        };
        let mut cells = vec![r.what.clone(), at, r.patches.to_string(), or_dash(r.receivers, |n| n.to_string())];
        cells.extend(r.errors.cells());
        cells.extend([
            or_dash(r.bake_s, significant),
            or_dash(r.median_ms, significant),
            or_dash(r.shade_ms, significant),
            or_dash(r.bytes, output::bytes),
        ]);
        cells
    };
    let mut head = vec!["patches are", "receivers", "patches", "receivers"];
    head.extend(ERROR_HEAD);
    head.extend(["bake s", "light ms", "shade ms", "bytes"]);
    let rows = rows.iter().filter(|r| r.part == Part::Patches).map(row).collect();
    table("Indirect light by kind and number of patches and by number of receivers", &head, rows)
}

/// Errors with one thing at a time made exact.
pub fn break_down_table(rows: &[Row]) -> Table {
    let row = |r: &Row| {
        let mut cells = vec![r.what.clone(), r.patches.to_string(), or_dash(r.receivers, |n| n.to_string())];
        cells.extend(r.errors.cells());
        cells
    };
    let mut head = vec!["clusters", "patches", "receivers"];
    head.extend(ERROR_HEAD);
    let rows = rows.iter().filter(|r| r.part == Part::BreakDown).map(row).collect();
    table("Where the error is: one thing at a time more exact", &head, rows)
}

/// Errors with lights that the bake has not seen, and over those with its own.
pub fn lights_table(rows: &[Row]) -> Table {
    let mut rows = rows.iter().filter(|r| r.part == Part::Lights).peekable();
    let own = rows.peek().map(|r| r.errors.indirect_block_median);
    let row = |r: &Row| {
        let [median, psnr, ratio, _] = r.errors.cells();
        let over = own.map_or(1.0, |own| r.errors.indirect_block_median / own);
        let noise = or_dash(r.reference_noise, |n| {
            format!("{}, {:.1} dB", percent(n.block_median_relative_error), n.block_psnr_db)
        });
        vec![r.what.clone(), median, psnr, ratio, format!("{over:.2}"), noise]
    };
    let head = ["light", "block median", "block PSNR", "mean ratio", "median over own", "noise of the reference"];
    table("Lights that the bake has not seen, against this project's path tracer", &head, rows.map(row).collect())
}
