//! `patchlight render FILE.bake --method local`.

use std::collections::HashSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use localmatrix::{BakeFile, LocalSettings};
use reference::{DisplayTransform, PictureFile as _};
use serde::Serialize;

use super::args::Render;
use patchlight::memory::{peak_memory_bytes, resident_bytes};
use patchlight::world::{StreamFrame, StreamSettings, Streamed, scene_of};
use runtime::executor::DeviceChoice;
use shell::Error;
use shell::args::{Common, DisplaySettings, Method, Reflection};
use shell::device::open;
use shell::output;
use shell::progress::{Progress, interruptible, is_cancelled};
use shell::sequence::Movement;
use shell::summary::PassTimes;

/// Pixels when no size is given: few enough for native code.
const SIZE: (u32, u32) = (640, 360);
/// Sub-frames when none are given.
const SUB_FRAMES: u32 = 2;
/// Bytes of blocks of rows that stay in memory.
const CACHE: usize = 4 << 20;

#[derive(Serialize)]
struct Report {
    scene: String,
    method: &'static str,
    patches: usize,
    slots: usize,
    frames: u32,
    /// All of a frame: of frames after the first.
    frame: Option<PassTimes>,
    passes: Vec<(&'static str, PassTimes)>,
    /// Frames above twice the median.
    slow_frames: usize,
    entered: usize,
    left: usize,
    /// Frames that showed coarser nodes, as the disk was behind.
    waiting_frames: usize,
    /// Greatest change of displayed values at the same places that 99.9 % of the pixels stay below, in 255ths.
    #[serde(skip_serializing_if = "Option::is_none")]
    greatest_change: Option<f64>,
    /// Difference of displayed values from light that is still to come, 99 % of the pixels less: greatest, and in half
    /// of the frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    greatest_behind: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    median_behind: Option<f64>,
    /// Multiplications that changes of the matrix took.
    work: u64,
    blocks_read: u64,
    bytes: Vec<(&'static str, u64)>,
    geometry_bytes: u64,
    /// Greatest resident memory of a frame, and what of it is neither geometry nor the matrix.
    resident_bytes: u64,
    beside_bytes: u64,
    peak_memory_bytes: Option<u64>,
}

struct Line {
    ms: f64,
    frame: StreamFrame,
    resident: u64,
    beside: u64,
}

pub fn run(common: &Common, args: &Render) -> Result<(), Error> {
    let path = Path::new(&args.scene);
    if args.method != Method::Local {
        return Err(Error::BakeMethod { path: path.to_path_buf() });
    }
    if args.display.materials != Reflection::Diffuse {
        return Err(Error::WorldMaterials { path: path.to_path_buf() });
    }
    output::check_out(&common.out)?;
    let progress = Progress::new(common.quiet);
    let named = named_scene(path, &progress)?;
    let before = resident_bytes().unwrap_or(0);
    let loaded = output::import(&scene_beside(path, &named), &progress)?;
    let geometry = resident_bytes().unwrap_or(0).saturating_sub(before);
    let movement = Movement::new(&loaded, (args.animate, args.path), args.frames, &progress);
    let stops = loaded.exposure_stops;
    let shown = args.display.shown(&loaded);
    let settings = stream_settings(args, stops);
    let name = loaded.name.clone();
    let (executor, note) = open(&DeviceChoice::parse(&common.device))?;
    if let Some(note) = note {
        progress.note(&note);
    }
    let streamed = progress.phase("open", |_| {
        let file = BakeFile::open(path)?;
        Ok::<_, Error>(Streamed::new(loaded.scene, loaded.content_hash, file, executor, settings)?)
    })?;
    let out = output::folder_or(&common.out, &format!("{name}-local"));
    output::make_folder(&out)?;
    let mut flight = Flight {
        streamed,
        movement,
        settings,
        stops,
        shown,
        transform: None,
        out: &out,
        progress: &progress,
        told: HashSet::new(),
    };
    flight.settle()?;
    let lines = flight.frames(args.frames, before + geometry)?;
    output::write_text(&out.join("frames.csv"), &csv(&lines))?;
    let report = report(&name, &settings, &flight.streamed, &lines, geometry);
    let text = output::json(&report);
    output::write_text(&out.join("summary.json"), &text)?;
    if common.json {
        say!("{text}");
    } else {
        report.print();
        progress.note(&format!("written to {}", out.display()));
    }
    Ok(())
}

/// The scene that a bake names. The file comes first: a bake that cannot be read should not cost
/// the time of its scene.
fn named_scene(path: &Path, progress: &Progress) -> Result<String, Error> {
    let file = BakeFile::open(path)?;
    for error in file.lost() {
        progress.warn(&left_out(&error.to_string()));
    }
    Ok(scene_of(&file)?)
}

/// Settings of the options, for pictures that are exposed so.
fn stream_settings(args: &Render, stops: f32) -> StreamSettings {
    let options = args.local.options(stops);
    StreamSettings {
        local: LocalSettings {
            slots: options.slots,
            changes: options.budget,
            fade: options.fade,
            display_white: options.display_white,
            ..LocalSettings::default()
        },
        predicted_frames: options.predicted_frames,
        at_rest: options.at_rest,
        cache: CACHE,
        sub_frames: args.spp.unwrap_or(SUB_FRAMES),
        size: args.size.unwrap_or(SIZE),
        // Of one frame alone nothing is told.
        is_measured: args.frames > 1,
    }
}

/// Consequence of a loss for the pictures.
fn left_out(error: &str) -> String {
    format!("{error}; meanwhile its rows are left out, and the rest is used")
}

/// A bake, and the camera that moves through it.
struct Flight<'a> {
    streamed: Streamed,
    movement: Movement,
    settings: StreamSettings,
    stops: f32,
    /// Way of pictures to PNG files, and that of the first one, which all have.
    shown: DisplaySettings,
    transform: Option<DisplayTransform>,
    out: &'a Path,
    progress: &'a Progress,
    /// Losses that the user knows of.
    told: HashSet<String>,
}

impl Flight<'_> {
    /// Waits for the nodes that suit the first view.
    fn settle(&mut self) -> Result<(), Error> {
        let eye = self.movement.at(0).1.eye;
        let streamed = &mut self.streamed;
        let settled = self.progress.phase("settle", |report| {
            streamed.settle(eye, &|share| report((1000.0 * share) as usize, 1000).is_continue())
        })?;
        self.warn_of_lost(&settled.lost);
        let patches = self.streamed.patch_count();
        self.progress.note(&format!("{} nodes of {patches} patches stand for the world", settled.entered));
        Ok(())
    }

    /// Warns of rows that are lost, of those of a block once.
    fn warn_of_lost(&mut self, lost: &[localmatrix::Error]) {
        for error in lost {
            let text = error.to_string();
            if self.told.insert(text.clone()) {
                self.progress.warn(&left_out(&text));
            }
        }
    }

    /// Renders frames and writes their pictures; `held` are the bytes that were resident before the
    /// matrix.
    fn frames(&mut self, frames: u32, held: u64) -> Result<Vec<Line>, Error> {
        let mut lines = Vec::new();
        for number in 0..frames {
            let line = self.frame(number, held, frames == 1)?;
            if number % 25 == 0 {
                let Line { ms, frame, .. } = &line;
                let came = frame.step.entered;
                self.progress.note(&format!("frame {number}: {ms:.0} ms, {} nodes, {came} came", frame.nodes));
            }
            lines.push(line);
        }
        Ok(lines)
    }

    fn frame(&mut self, number: u32, held: u64, is_only: bool) -> Result<Line, Error> {
        let (lights, view) = self.movement.at(number);
        let (width, height) = self.settings.size;
        let start = Instant::now();
        let (picture, frame) = interruptible(|| self.streamed.frame(&lights, &view.camera(width, height), self.stops))?;
        let ms = start.elapsed().as_secs_f64() * 1e3;
        output::check_finite(number, &picture)?;
        if is_cancelled() {
            return Err(Error::Cancelled);
        }
        self.warn_of_lost(&frame.step.lost);
        let matrix: u64 = self.streamed.bytes().iter().filter(|part| part.0 == "matrix").map(|part| part.1).sum();
        let resident = resident_bytes().unwrap_or(0);
        let name = if is_only { "full.png".to_owned() } else { format!("frame-{number:04}.png") };
        let transform = self.transform.get_or_insert_with(|| self.shown.transform(&picture));
        picture.write_shown(&self.out.join(name), transform)?;
        Ok(Line { ms, frame, resident, beside: resident.saturating_sub(held + matrix) })
    }
}

/// The scene that a bake names: as it is, or beside the bake.
fn scene_beside(bake: &Path, named: &str) -> String {
    let beside: PathBuf = bake.parent().unwrap_or(Path::new("")).join(named);
    match !Path::new(named).exists() && beside.exists() {
        true => beside.to_string_lossy().into_owned(),
        false => named.to_owned(),
    }
}

fn csv(lines: &[Line]) -> String {
    let mut text = String::from(
        "frame,ms,direct_ms,update_ms,method_ms,lookup_ms,shade_ms,nodes,entered,left,waiting,later,update_multiplications,\
         residual,blocks_read,cache_bytes,resident_bytes,beside_bytes,change_255,behind_255\n",
    );
    for (k, Line { ms, frame: f, resident, beside }) in lines.iter().enumerate() {
        let residual = f.step.residual.map_or(String::new(), |r| format!("{r:.3e}"));
        let [change, behind] = [f.change, f.behind].map(|v| v.map_or(String::new(), |v| format!("{v:.3}")));
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "{k},{ms:.2},{:.2},{:.2},{:.2},{:.2},{:.2},{},{},{},{},{},{},{residual},{},{},{resident},{beside},{change},{behind}",
            f.direct_ms,
            f.update_ms,
            f.method_ms,
            f.lookup_ms,
            f.shade_ms,
            f.nodes,
            f.step.entered,
            f.step.left,
            f.step.waiting,
            f.step.later,
            f.step.work,
            f.reader.reads,
            f.reader.bytes,
        );
    }
    text
}

fn report(name: &str, settings: &StreamSettings, streamed: &Streamed, lines: &[Line], geometry: u64) -> Report {
    // The first frame has all of its light at once.
    let later = &lines[1.min(lines.len())..];
    let times = |of: &dyn Fn(&Line) -> f64| PassTimes::of(&later.iter().map(of).collect::<Vec<_>>());
    let frame = times(&|line| line.ms);
    let pass = |name, of: &dyn Fn(&StreamFrame) -> f64| Some((name, times(&|line| of(&line.frame))?));
    let passes = [
        pass("direct", &|f| f.direct_ms),
        pass("update", &|f| f.update_ms),
        pass("method", &|f| f.method_ms),
        pass("lookup", &|f| f.lookup_ms),
        pass("shade", &|f| f.shade_ms),
    ];
    let behind: Vec<f64> = later.iter().filter_map(|line| line.frame.behind).collect();
    let slow = frame.map_or(0, |t| later.iter().filter(|line| line.ms > 2.0 * t.median_ms).count());
    Report {
        scene: name.to_owned(),
        method: "local",
        patches: streamed.patch_count(),
        slots: settings.local.slots,
        frames: lines.len() as u32,
        frame,
        passes: passes.into_iter().flatten().collect(),
        slow_frames: slow,
        entered: later.iter().map(|l| l.frame.step.entered).sum(),
        left: later.iter().map(|l| l.frame.step.left).sum(),
        waiting_frames: later.iter().filter(|l| l.frame.step.waiting > 0).count(),
        greatest_change: lines.iter().filter_map(|l| l.frame.change).reduce(f64::max),
        greatest_behind: behind.iter().copied().reduce(f64::max),
        median_behind: PassTimes::of(&behind).map(|t| t.median_ms),
        work: later.iter().map(|l| l.frame.step.work).sum(),
        blocks_read: lines.last().map_or(0, |l| l.frame.reader.reads),
        bytes: streamed.bytes(),
        geometry_bytes: geometry,
        resident_bytes: lines.iter().map(|l| l.resident).max().unwrap_or(0),
        beside_bytes: lines.iter().map(|l| l.beside).max().unwrap_or(0),
        peak_memory_bytes: peak_memory_bytes(),
    }
}

impl Report {
    fn print(&self) {
        say!("{:14} {} by {}, {} slots for {} patches", "scene", self.scene, self.method, self.slots, self.patches);
        if let Some(t) = &self.frame {
            say!(
                "{:14} median {:.1} ms, max {:.1} ms, {} above twice the median",
                "frame",
                t.median_ms,
                t.max_ms,
                self.slow_frames
            );
        }
        for (name, t) in &self.passes {
            say!("{:14} median {:.2} ms, max {:.2} ms", format!("pass {name}"), t.median_ms, t.max_ms);
        }
        say!(
            "{:14} {} came, {} went, {} frames waited for the disk",
            "nodes",
            self.entered,
            self.left,
            self.waiting_frames
        );
        if let Some(change) = self.greatest_change {
            say!("{:14} {change:.3}/255 a frame at most, for 99.9 % of the pixels", "change");
        }
        if let (Some(median), Some(greatest)) = (self.median_behind, self.greatest_behind) {
            let share = "for 99 % of the pixels";
            say!("{:14} {median:.1}/255 behind in half of the frames, {greatest:.1} at most, {share}", "");
        }
        for (name, bytes) in &self.bytes {
            say!("{:14} {}", format!("bytes {name}"), output::bytes(*bytes));
        }
        say!(
            "{:14} {}, {} without geometry and matrix",
            "resident",
            output::bytes(self.resident_bytes),
            output::bytes(self.beside_bytes)
        );
    }
}
