//! `patchlight render FILE.bake --method local`.

use reference::PictureFile as _;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use localmatrix::{BakeFile, LocalSettings};
use serde::Serialize;

use super::args::{Method, Render};
use experiments::Error;
use experiments::args::Common;
use experiments::output;
use experiments::progress::{Progress, is_cancelled};
use experiments::sequence::Movement;
use experiments::summary::PassTimes;
use patchlight::memory::{peak_memory_bytes, resident_bytes};
use patchlight::render::streamed::{StreamFrame, StreamSettings, Streamed, scene_of};

/// Pixels when no size is given: every one of them is shaded on the host.
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
    greatest_change: f64,
    /// What displayed values lack of light that is still to come, 99 % of the pixels less: greatest, and in half of the frames.
    greatest_behind: f64,
    median_behind: f64,
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
    let progress = Progress::new(common.quiet);
    // The file first: a bake that cannot be read should not cost the time of its scene.
    let file = BakeFile::open(path)?;
    for error in file.lost() {
        progress.warn(&error.to_string());
    }
    let named = scene_of(&file)?;
    drop(file);
    let before = resident_bytes().unwrap_or(0);
    let loaded = output::import(&scene_beside(path, &named), &progress)?;
    let geometry = resident_bytes().unwrap_or(0).saturating_sub(before);
    let movement = Movement::new(&loaded, (args.animate, args.path), args.frames, &progress);
    let options = args.local.options(loaded.exposure_stops);
    let settings = StreamSettings {
        local: LocalSettings {
            slots: options.slots,
            changes: options.budget,
            fade: options.fade,
            white: options.white,
            ..LocalSettings::default()
        },
        look_ahead: options.look_ahead,
        at_rest: options.at_rest,
        cache: CACHE,
        sub_frames: args.spp.unwrap_or(SUB_FRAMES),
        size: args.size.unwrap_or(SIZE),
    };
    let stops = loaded.exposure_stops;
    let (name, hash, scene) = (loaded.name.clone(), loaded.content_hash, loaded.scene);
    let mut streamed =
        progress.phase("open", |_| Ok::<_, Error>(Streamed::new(scene, hash, BakeFile::open(path)?, settings)?))?;
    let out = output::folder_or(&common.out, &format!("{name}-local"));
    output::make_folder(&out)?;
    let first = movement.at(0).1;
    let settled = progress.phase("settle", |report| streamed.settle(first.eye, report))?;
    progress.note(&format!("{} nodes of {} patches stand for the world", settled.entered, streamed.patch_count()));
    let mut lines: Vec<Line> = Vec::new();
    let matrix = |streamed: &Streamed| streamed.bytes().iter().filter(|b| b.0 == "matrix").map(|b| b.1).sum::<u64>();
    for number in 0..args.frames {
        let (lights, view) = movement.at(number);
        let start = std::time::Instant::now();
        let (picture, frame) = streamed.frame(&lights, &view.camera(settings.size.0, settings.size.1), stops)?;
        let ms = start.elapsed().as_secs_f64() * 1e3;
        if is_cancelled() {
            return Err(Error::Cancelled);
        }
        for error in &frame.step.lost {
            progress.warn(&error.to_string());
        }
        let resident = resident_bytes().unwrap_or(0);
        let beside = resident.saturating_sub(geometry + before + matrix(&streamed));
        picture.write_png(
            &out.join(if args.frames == 1 { "full.png".into() } else { format!("frame-{number:04}.png") }),
            stops,
        )?;
        if !common.quiet && (number % 25 == 0) {
            progress.note(&format!("frame {number}: {ms:.0} ms, {} nodes, {} came", frame.nodes, frame.step.entered));
        }
        lines.push(Line { ms, frame, resident, beside });
    }
    output::write_text(&out.join("frames.csv"), &csv(&lines))?;
    let report = report(&name, &settings, &streamed, &lines, geometry);
    let text = output::json(&report);
    output::write_text(&out.join("summary.json"), &text)?;
    if common.json {
        println!("{text}");
    } else {
        report.print();
        progress.note(&format!("written to {}", out.display()));
    }
    Ok(())
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
        let change = f.change.map_or(String::new(), |c| format!("{c:.3}"));
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "{k},{ms:.2},{:.2},{:.2},{:.2},{:.2},{:.2},{},{},{},{},{},{},{residual},{},{},{resident},{beside},{change},{:.3}",
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
            f.behind,
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
        greatest_change: lines.iter().filter_map(|l| l.frame.change).fold(0.0, f64::max),
        greatest_behind: lines.iter().map(|l| l.frame.behind).fold(0.0, f64::max),
        median_behind: times(&|line| line.frame.behind).map_or(0.0, |t| t.median_ms),
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
        println!("{:14} {} by {}, {} slots for {} patches", "scene", self.scene, self.method, self.slots, self.patches);
        if let Some(t) = &self.frame {
            println!(
                "{:14} median {:.1} ms, max {:.1} ms, {} above twice the median",
                "frame", t.median_ms, t.max_ms, self.slow_frames
            );
        }
        for (name, t) in &self.passes {
            println!("{:14} median {:.2} ms, max {:.2} ms", format!("pass {name}"), t.median_ms, t.max_ms);
        }
        println!(
            "{:14} {} came, {} went, {} frames waited for the disk",
            "nodes", self.entered, self.left, self.waiting_frames
        );
        println!("{:14} {:.3}/255 a frame at most, for 99.9 % of the pixels", "change", self.greatest_change);
        println!(
            "{:14} {:.1}/255 behind in half of the frames, {:.1} at most, for 99 % of the pixels",
            "", self.median_behind, self.greatest_behind
        );
        for (name, bytes) in &self.bytes {
            println!("{:14} {}", format!("bytes {name}"), output::bytes(*bytes));
        }
        println!(
            "{:14} {}, {} without geometry and matrix",
            "resident",
            output::bytes(self.resident_bytes),
            output::bytes(self.beside_bytes)
        );
    }
}
