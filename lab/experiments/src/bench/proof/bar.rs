//! The project's own bar: in each scene, tiles and temporal better than the best DDGI in the picture, at points and in
//! time, at equal or less memory.

use std::fmt::Write as _;

use super::Measure;
use crate::bench::study::{Record, SceneRows};
use crate::bench::table3::{NEAREST, Row};
use crate::report::{Table, significant};

/// Measures of the bar: less is better. The one for which DDGI is the best setting comes first.
const BAR: [Measure; 5] = [
    ("PSNR of indirect light", |row| Some(-row.indirect.psnr_db), |x| format!("{:.2} dB", -x)),
    ("SSIM of indirect light", |row| Some(-row.indirect.ssim), |x| format!("{:.4}", -x)),
    ("median error at points", |row| row.points.map(|p| 100.0 * p.median_relative_error), |x| format!("{x:.2} %")),
    ("time of a light update", |row| Some(row.times.processor.median_ms), |x| format!("{} ms", significant(x))),
    ("memory", |row| Some(row.who.megabytes()), |x| format!("{} MB", significant(x))),
];
/// Mark after a measure in which DDGI is better.
const MISSED: &str = " (missed)";

/// Comparison of one of the project's own methods, measure by measure.
struct Comparison<'a> {
    scene: &'a str,
    own: &'a Row,
    /// Has the greatest PSNR of indirect light of its kind.
    best: &'a Row,
}

impl Comparison<'_> {
    /// Names of measures in which it is worse.
    fn missed(&self) -> Vec<&'static str> {
        let is_worse = |measure: &&Measure| match (measure.1(self.own), measure.1(self.best)) {
            (Some(own), Some(best)) => own > best,
            // What was not measured is not met.
            _ => true,
        };
        BAR.iter().filter(is_worse).map(|measure| measure.0).collect()
    }

    fn cells(&self) -> Vec<String> {
        let missed = self.missed();
        let mut cells = vec![format!("{}, {}", self.scene, self.own.who.method), self.best.who.method.clone()];
        for (name, measure, show) in BAR {
            let text = |row: &Row| measure(row).map_or_else(|| "not measured".to_owned(), show);
            let mark = if missed.contains(&name) { MISSED } else { "" };
            cells.push(format!("{} against {}{mark}", text(self.own), text(self.best)));
        }
        cells
    }
}

/// Comparisons of each setting of each of the project's own methods in a scene.
fn comparisons(scene: &SceneRows<Row>) -> Vec<Comparison<'_>> {
    let (_, first, _) = BAR[0];
    let opponents = scene.rows.iter().filter(|row| row.who.family == NEAREST);
    let known = opponents.filter_map(|row| Some((first(row)?, row)));
    let Some((_, best)) = known.min_by(|a, b| a.0.total_cmp(&b.0)) else { return Vec::new() };
    let own = scene.rows.iter().filter(|row| row.who.is_own());
    own.map(|own| Comparison { scene: &scene.scene, own, best }).collect()
}

/// Setting that misses least, of each method in each scene.
fn nearest<'a>(all: &'a [Comparison<'a>]) -> Vec<(&'a Comparison<'a>, Vec<&'static str>)> {
    let mut cases: Vec<(&Comparison, Vec<&str>)> = Vec::new();
    for setting in all {
        let missed = setting.missed();
        let is_same = |case: &Comparison| case.scene == setting.scene && case.own.who.family == setting.own.who.family;
        match cases.iter_mut().find(|(case, _)| is_same(case)) {
            Some((_, least)) if least.len() <= missed.len() => {}
            Some(case) => *case = (setting, missed),
            None => cases.push((setting, missed)),
        }
    }
    cases
}

/// Text of the misses, and a table of all of it. Writing into a string cannot fail.
pub fn text(record: &Record<Row>) -> String {
    let all: Vec<Comparison> = record.scenes.iter().flat_map(comparisons).collect();
    let cases = nearest(&all);
    let met = cases.iter().filter(|(_, missed)| missed.is_empty()).count();
    let mut text = format!(
        "The bar of this project: in each scene tiles and temporal better than the best setting of DDGI, that with \
         the greatest PSNR, in PSNR and SSIM of indirect light, error at points and time of a light update, at equal \
         or less memory, all with one setting. It is met in {met} of {} cases, each a method in a scene.",
        cases.len()
    );
    for (name, ..) in BAR {
        let where_missed = cases.iter().filter(|(_, missed)| missed.contains(&name));
        let names: Vec<String> =
            where_missed.map(|(case, _)| format!("{} ({})", case.scene, case.own.who.method)).collect();
        let _ = match names.len() {
            0 => write!(text, " Met everywhere: {name}."),
            count if count == cases.len() => write!(text, " Missed everywhere: {name}."),
            _ => write!(text, " Missed in {name}: {}.", names.join(", ")),
        };
    }
    let head = ["scene, method", "best DDGI"].into_iter().chain(BAR.map(|measure| measure.0));
    let table = Table {
        caption: "The bar, scene by scene".into(),
        head: head.map(str::to_owned).collect(),
        rows: all.iter().map(Comparison::cells).collect(),
    };
    let _ = write!(text, "\n\n{}", table.markdown());
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A record of one scene: tiles with much memory, and with what is given, and two settings of DDGI.
    fn record(tiles_db: f64, tiles_bytes: u64) -> Record<Row> {
        let errors = |db: f64| {
            serde_json::json!({
                "mse": 0.0, "psnr_db": db, "ssim": db / 100.0, "flip": 0.0, "block_median_relative_error": 0.0,
                "block_psnr_db": db, "mean_ratio": 1.0
            })
        };
        let row = |family: &str, method: &str, db: f64, ms: f64, bytes: u64| {
            serde_json::json!({
                "family": family, "method": method, "size": "", "build_s": 0.0, "bytes": bytes,
                "update": {"median_ms": ms, "max_ms": ms}, "processor": {"median_ms": ms, "max_ms": ms},
                "full": errors(db), "indirect": errors(db),
                "points": {"median_relative_error": 1.0 / db, "p95_relative_error": 1.0, "mean_ratio": 1.0}
            })
        };
        let rows = [
            row("tiles 1 %", "tiles 1 %", 36.0, 25.0, 10_000),
            row("tiles 1 %", "tiles 1 %, small", tiles_db, 20.0, tiles_bytes),
            row("DDGI", "coarse", 20.0, 2.0, 1000),
            row("DDGI", "fine", 30.0, 90.0, 4000),
        ];
        let scene = serde_json::json!({
            "scene": "box", "version": "0", "date": "", "device": "cpu", "seed": 0, "size": [1, 1], "frames": 1, "patches": 1,
            "machine": {"cpu": "", "threads": 1, "stream_gb_s": 1.0}, "rows": rows
        });
        serde_json::from_value(serde_json::json!({"name": "table3", "scenes": [scene]})).unwrap()
    }

    #[test]
    fn what_is_missed_is_said() {
        let met = text(&record(35.0, 3000));
        assert!(met.contains("met in 1 of 1 cases") && !met.contains("Missed"), "{met}");
        assert!(met.contains("| box, tiles 1 %, small | fine | 35.00 dB against 30.00 dB |"), "{met}");
        assert!(met.contains("0.0100 MB against 0.00400 MB (missed)"), "{met}");
        let more_memory = text(&record(35.0, 5000));
        assert!(more_memory.contains("met in 0 of 1") && more_memory.contains("Missed everywhere: memory."));
        assert!(more_memory.contains("0.00500 MB against 0.00400 MB (missed)"), "{more_memory}");
        // A setting that is small but worse in the picture leaves the other, which misses memory alone, as the nearest.
        let worse = text(&record(25.0, 3000));
        assert!(worse.contains("Missed everywhere: memory.") && worse.contains("met in 0 of 1"), "{worse}");
        assert!(worse.contains("25.00 dB against 30.00 dB (missed)"), "{worse}");
    }
}
