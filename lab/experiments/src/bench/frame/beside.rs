//! Light updates of two programs, by turns.

use std::path::Path;
use std::process::Command;

use serde::Serialize;
use serde_json::Value;

use crate::args::{Bench, Common};
use crate::error::Error;
use crate::progress::is_cancelled;
use crate::report::{Section, Table};

/// Turns, of which the least time of each program counts.
const TURNS: usize = 3;
/// Methods, as both programs name them.
const METHODS: [&str; 2] = ["tiles", "temporal"];
/// What moves from frame to frame, by the options of `render`.
const EVENTS: [(&str, &[&str]); 2] =
    [("lights move", &["--animate", "sun"]), ("lights and camera move", &["--animate", "sun", "--path", "fly"])];

/// Light updates beside those of another program.
#[derive(Clone, Debug, Serialize)]
pub struct Beside {
    scene: String,
    method: &'static str,
    event: &'static str,
    patches: u32,
    /// Median of the frames, the least of all turns.
    own_ms: f64,
    other_ms: f64,
    own_peak_memory_bytes: u64,
    other_peak_memory_bytes: u64,
}

/// A program, and its bake of the scene.
struct Side<'a> {
    program: &'a Path,
    bake: std::path::PathBuf,
    common: &'a Common,
}

impl Side<'_> {
    fn run(&self, arguments: &[&str]) -> Result<Value, Error> {
        if is_cancelled() {
            return Err(shell::Error::Cancelled.into());
        }
        let failed = |why: String| Error::Against { program: self.program.to_path_buf(), why };
        let mut command = Command::new(self.program);
        command.args(arguments).args(["--json", "--quiet", "--device", &self.common.device]);
        let done = command.output().map_err(|error| failed(error.to_string()))?;
        if !done.status.success() {
            return Err(failed(String::from_utf8_lossy(&done.stderr).trim().to_owned()));
        }
        serde_json::from_slice(&done.stdout).map_err(|error| failed(error.to_string()))
    }

    /// Median of the light updates, ms, and the peak of memory.
    fn update(&self, method: &str, event: &[&str], args: &Bench, out: &Path) -> Result<(f64, u64), Error> {
        let (width, height) = args.size();
        let [size, frames] = [format!("{width}x{height}"), args.frames().to_string()];
        let [bake, out] = [&self.bake, out].map(|path: &Path| path.to_string_lossy().into_owned());
        let fixed =
            ["render", &bake, "--method", method, "--size", &size, "--spp", "1", "--frames", &frames, "--out", &out];
        let report = self.run(&[&fixed[..], event].concat())?;
        let median = report["light_update"]["median_ms"].as_f64();
        let without = || Error::Against {
            program: self.program.to_path_buf(),
            why: format!("it prints no time of a light update by {method}"),
        };
        Ok((median.ok_or_else(without)?, report["peak_memory_bytes"].as_u64().unwrap_or_default()))
    }
}

/// Measures a scene with so many patches.
pub fn measure(
    common: &Common,
    args: &Bench,
    program: &Path,
    (scene, patches): (&str, u32),
    out: &Path,
) -> Result<Vec<Beside>, Error> {
    let own = shell::program::CLI.found()?;
    let side = |program, name: &str| Side { program, bake: out.join(name), common };
    let sides = [side(own.as_path(), "own.bake"), side(program, "other.bake")];
    let [count, seed] = [patches.to_string(), common.seed.to_string()];
    for Side { bake, .. } in &sides {
        // One that is left from before may be of another version.
        match std::fs::remove_file(bake) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(shell::Error::Write { path: bake.clone(), source: error }.into());
            }
            _ => {}
        }
    }
    for side in &sides {
        let bake = side.bake.to_string_lossy();
        side.run(&["bake", scene, "--patch-count", &count, "--for", "tiles", "--seed", &seed, "--out", &bake])?;
    }
    let mut rows = Vec::new();
    for method in METHODS {
        for (event, options) in EVENTS {
            let mut best = [(f64::INFINITY, 0); 2];
            for _ in 0..TURNS {
                for (side, best) in sides.iter().zip(&mut best) {
                    let found = side.update(method, options, args, &out.join("turn"))?;
                    *best = if found.0 < best.0 { found } else { *best };
                }
            }
            let [(own_ms, own_peak_memory_bytes), (other_ms, other_peak_memory_bytes)] = best;
            let scene = scene.to_owned();
            let bytes = (own_peak_memory_bytes, other_peak_memory_bytes);
            rows.push(Beside {
                scene,
                method,
                event,
                patches,
                own_ms,
                other_ms,
                own_peak_memory_bytes: bytes.0,
                other_peak_memory_bytes: bytes.1,
            });
        }
    }
    for Side { bake, .. } in sides {
        std::fs::remove_file(&bake).map_err(|source| shell::Error::Write { path: bake.clone(), source })?;
    }
    Ok(rows)
}

/// What was measured, as a table.
pub fn section(rows: &[Beside], program: &Path) -> Section {
    let row = |row: &Beside| {
        vec![
            row.scene.clone(),
            row.method.to_owned(),
            row.event.to_owned(),
            format!("{:.2}", row.own_ms),
            format!("{:.2}", row.other_ms),
            format!("{:.2}", row.own_ms / row.other_ms),
            format!("{:.2}", row.own_peak_memory_bytes as f64 * 1e-9),
            format!("{:.2}", row.other_peak_memory_bytes as f64 * 1e-9),
        ]
    };
    let head = ["scene", "method", "event", "ms", "other, ms", "of it", "peak, GB", "other, GB"];
    let caption = format!("Light updates by turns with {}: medians, the least of {TURNS} turns", program.display());
    let tables = vec![Table { caption, head: head.map(str::to_owned).to_vec(), rows: rows.iter().map(row).collect() }];
    Section { title: "By turns".to_owned(), tables, ..Section::default() }
}
