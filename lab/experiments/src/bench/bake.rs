//! `bench bake`: time of a whole bake by phases, how many cores each keeps busy, and its memory; by turns with another
//! program.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use cpu_time::ProcessTime;
use patchlight::low_level::operator::{Build, Codec};
use patchlight::memory::peak_memory_bytes;
use patchlight::{Bake, MethodSettings, Observer, Phase};
use serde::Serialize;
use transport::Proceed;

use super::setup::{Machine, Setup, bake_settings, one_scene};
use crate::args::{Bench, Common};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, is_cancelled};
use crate::report::{Section, Table, page};
use shell::device::open;

/// Scene, and its patches, unless it is said.
const SCENE: &str = "office";
const COUNT: u32 = 10_000;
/// Relative error of the compressed operator.
const EPSILON: f64 = 0.01;
/// Turns beside another program.
const TURNS: usize = 3;
/// Cores of the machine to which times are carried over.
const MANY: f64 = 16.0;

/// A phase.
#[derive(Clone, Copy, Debug, Default, Serialize)]
struct Part {
    seconds: f64,
    /// Processor time over time.
    busy_cores: f64,
}

/// Whole bakes of two programs, by turns: the least time of each.
#[derive(Clone, Debug, Serialize)]
struct Beside {
    program: String,
    own_s: f64,
    other_s: f64,
    own_peak_memory_bytes: u64,
    other_peak_memory_bytes: u64,
}

#[derive(Serialize)]
struct Results {
    name: &'static str,
    scene: String,
    machine: Machine,
    patches: usize,
    receivers: usize,
    phases: BTreeMap<String, Part>,
    #[serde(skip_serializing_if = "Option::is_none")]
    peak_memory_bytes: Option<u64>,
    /// Since the scene was there.
    whole_s: f64,
    /// Share of the processor time that one core alone does, if the rest kept all busy (Amdahl).
    serial_share: f64,
    /// The whole on 16 such cores, by that share.
    whole_on_16_s: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    against: Option<Beside>,
}

/// Measures phases.
struct Meter<'a> {
    progress: &'a Progress,
    running: Mutex<Vec<(Phase, Instant, ProcessTime)>>,
    parts: Mutex<Vec<(Phase, f64, f64)>>,
}

impl Observer for Meter<'_> {
    fn progress(&self, phase: Phase, done: u64, total: u64) -> Proceed {
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        let own = running.iter().position(|(known, ..)| *known == phase);
        match (own, done, total) {
            (None, 0, 1) => running.push((phase, Instant::now(), ProcessTime::now())),
            (Some(own), 1, 1) => {
                let (_, begun, processor) = running.remove(own);
                let part = (phase, begun.elapsed().as_secs_f64(), processor.elapsed().as_secs_f64());
                self.parts.lock().unwrap_or_else(PoisonError::into_inner).push(part);
            }
            _ => {}
        }
        drop(running);
        self.progress.progress(phase, done, total)
    }

    fn note(&self, text: &str) {
        self.progress.note(text);
    }

    fn warn(&self, text: &str) {
        self.progress.warn(text);
    }
}

/// Runs the experiment.
pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let scene = one_scene(args, SCENE, "bake")?;
    let Setup { out, machine, counts, .. } = Setup::new(common, args, "bake", &[], &[COUNT])?;
    let against = args.against.as_deref().map(|program| beside(program, scene, counts[0], &out, common)).transpose()?;
    let progress = Progress::new(common.quiet);
    let meter = Meter { progress: &progress, running: Mutex::default(), parts: Mutex::default() };
    let begun = (Instant::now(), ProcessTime::now());
    let loaded = output::import_flat(scene, &progress)?;
    let import = Part::of(begun.0.elapsed().as_secs_f64(), begun.1.elapsed().as_secs_f64());
    let settings = bake_settings(common, args, &loaded, counts[0] as usize);
    let (mut device, _) = open(&runtime::executor::DeviceChoice::parse(&common.device))?;
    let method = MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON });
    let begun = (Instant::now(), ProcessTime::now());
    let mut bake = Bake::build_on(device.as_mut(), &loaded.scene, &settings, &meter)?;
    bake.build_operators(&[method], &Build::default(), device.as_mut(), &meter)?;
    let whole_s = begun.0.elapsed().as_secs_f64();
    let processor = begun.1.elapsed().as_secs_f64();
    let mut sums: BTreeMap<String, (f64, f64)> = BTreeMap::new();
    for (phase, seconds, processor) in meter.parts.into_inner().unwrap_or_else(PoisonError::into_inner) {
        let sum = sums.entry(phase.name().to_owned()).or_default();
        sum.0 += seconds;
        sum.1 += processor;
    }
    let mut phases: BTreeMap<String, Part> =
        sums.into_iter().map(|(name, (seconds, processor))| (name, Part::of(seconds, processor))).collect();
    phases.insert("import".to_owned(), import);
    let serial = serial_seconds(whole_s, processor, machine.threads);
    let results = Results {
        name: "bake",
        scene: loaded.name.clone(),
        patches: bake.mesh().patches.len(),
        receivers: bake.receivers().points.len(),
        machine,
        phases,
        peak_memory_bytes: peak_memory_bytes(),
        whole_s,
        serial_share: serial / processor.max(f64::MIN_POSITIVE),
        whole_on_16_s: serial + (processor - serial) / MANY,
        against,
    };
    let section = results.section();
    output::write_text(&out.join("summary.json"), &output::json(&results))?;
    let introduction = [results.machine.sentence()];
    output::write_text(&out.join("report.html"), &page("Patchlight: a bake", &introduction, [&section]))?;
    if common.json {
        say!("{}", output::json(&results));
    } else {
        section.tables.iter().for_each(|table| say!("{}", table.markdown()));
        section.text.iter().for_each(|line| say!("{line}"));
    }
    Ok(())
}

/// Seconds in which one core works alone: `t = s + (w − s)/n`, where w is the processor time and n the cores.
fn serial_seconds(whole: f64, processor: f64, cores: usize) -> f64 {
    let cores = cores as f64;
    match cores > 1.0 {
        true => ((cores * whole - processor) / (cores - 1.0)).clamp(0.0, processor),
        false => processor,
    }
}

impl Part {
    fn of(seconds: f64, processor: f64) -> Self {
        Self { seconds, busy_cores: processor / seconds.max(f64::MIN_POSITIVE) }
    }
}

/// Whole bakes by `patchlight bake` of this build and of another program.
fn beside(program: &Path, scene: &str, patches: u32, out: &Path, common: &Common) -> Result<Beside, Error> {
    let own = shell::program::CLI.found()?;
    let mut best = [(f64::INFINITY, 0u64); 2];
    for _ in 0..TURNS {
        for (program, best) in [own.as_path(), program].into_iter().zip(&mut best) {
            if is_cancelled() {
                return Err(shell::Error::Cancelled.into());
            }
            let file = out.join("turn.bake");
            let mut command = Command::new(program);
            command.args(["bake", scene, "--patch-count", &patches.to_string(), "--json", "--quiet", "--out"]);
            command.arg(&file).args(["--device", &common.device, "--seed", &common.seed.to_string()]);
            let begun = Instant::now();
            let failed = |why: String| Error::Against { program: program.to_path_buf(), why };
            let done = command.output().map_err(|error| failed(error.to_string()))?;
            let seconds = begun.elapsed().as_secs_f64();
            if !done.status.success() {
                return Err(failed(String::from_utf8_lossy(&done.stderr).trim().to_owned()));
            }
            std::fs::remove_file(&file).map_err(|source| shell::Error::Write { path: file, source })?;
            let report: serde_json::Value =
                serde_json::from_slice(&done.stdout).map_err(|error| failed(error.to_string()))?;
            let peak = report["peak_memory_bytes"].as_u64().unwrap_or_default();
            *best = if seconds < best.0 { (seconds, peak) } else { *best };
        }
    }
    let [own, other] = best;
    Ok(Beside {
        program: program.display().to_string(),
        own_s: own.0,
        other_s: other.0,
        own_peak_memory_bytes: own.1,
        other_peak_memory_bytes: other.1,
    })
}

impl Results {
    fn section(&self) -> Section {
        let row = |(name, part): (&String, &Part)| {
            vec![name.clone(), format!("{:.2}", part.seconds), format!("{:.2}", part.busy_cores)]
        };
        let phases = Table {
            caption: format!("{}: {} patches, {} receivers", self.scene, self.patches, self.receivers),
            head: ["phase", "seconds", "busy cores"].map(str::to_owned).to_vec(),
            rows: self.phases.iter().map(row).collect(),
        };
        let mut text = vec![format!(
            "Whole, without import: {:.1} s; {:.1} % of the work is done by one core alone; on 16 cores like these \
             {:.1} s.",
            self.whole_s,
            100.0 * self.serial_share,
            self.whole_on_16_s
        )];
        text.extend(self.peak_memory_bytes.map(|bytes| format!("Peak memory {:.2} GB.", bytes as f64 * 1e-9)));
        text.extend(self.against.as_ref().map(|beside| {
            format!(
                "Whole programs, least of {TURNS} by turns: {:.1} s and {:.2} GB, {} {:.1} s and {:.2} GB: {:.2} \
                 of it.",
                beside.own_s,
                beside.own_peak_memory_bytes as f64 * 1e-9,
                beside.program,
                beside.other_s,
                beside.other_peak_memory_bytes as f64 * 1e-9,
                beside.own_s / beside.other_s
            )
        }));
        Section { title: self.scene.clone(), text, tables: vec![phases], ..Section::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_serial_part_is_what_keeps_cores_idle() {
        // 2 s alone, then 8 s of work on four cores.
        assert!((serial_seconds(4.0, 10.0, 4) - 2.0).abs() < 1e-12);
        assert_eq!(serial_seconds(2.5, 10.0, 4), 0.0);
        assert_eq!(serial_seconds(10.0, 10.0, 1), 10.0);
    }
}
