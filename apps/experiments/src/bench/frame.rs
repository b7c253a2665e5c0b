//! `bench frame`: whole light updates, from "a light has moved" to irradiance at every visible point.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use scene::{Camera, Light};
use serde::Serialize;

use super::{Machine, Setup, load, suited_settings};
use crate::args::{Animate, Bench, CameraPath, Common};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, is_cancelled};
use crate::report::{Section, Table, page};
use crate::sequence::{Movement, pass_ms};
use crate::summary::PassTimes;
use assets::import::LoadedScene;
use patchlight::memory::peak_memory_bytes;
use patchlight::method::{LocalSettings, TemporalSettings};
use patchlight::operator::Codec;
use patchlight::renderer::with_lights;
use patchlight::{Bake, MethodSettings, ReceiverUpdate, RenderSettings, Renderer};

/// Scenes, unless some are named.
const SCENES: [&str; 1] = ["office"];
/// Patches of a scene, unless it is said.
const COUNT: u32 = 10_000;
/// Relative error of the compressed operator.
const EPSILON: f64 = 0.01;
/// Passes of pixels, which are no part of a light update.
const PIXELS: &str = "shade";
/// Passes of a light update, in their order; "update" is the matrix round the camera.
const PASSES: [&str; 7] = ["direct", "gather", "update", "method", "lookup", "mark", "view"];

/// What happens from frame to frame.
#[derive(Clone, Copy, PartialEq)]
enum Event {
    /// Suns, or where there are none all lights, move.
    Move,
    /// So do they, and the camera flies.
    Fly,
    /// Nothing changes.
    Rest,
    /// One of the lamps goes on and off.
    Switch,
}

impl Event {
    fn name(self) -> &'static str {
        match self {
            Self::Move => "lights move",
            Self::Fly => "lights and camera move",
            Self::Rest => "nothing moves",
            Self::Switch => "a lamp is switched",
        }
    }
}

/// A measurement.
#[derive(Clone, Serialize)]
struct Row {
    scene: String,
    method: String,
    event: &'static str,
    /// Which receivers are updated.
    receivers_updated: &'static str,
    patches: usize,
    receivers: usize,
    interpolation_points: usize,
    light_update: LightUpdate,
    /// Medians of the passes.
    passes: BTreeMap<&'static str, f64>,
    bytes: BTreeMap<String, u64>,
}

/// Whole light updates.
#[derive(Clone, Serialize)]
struct LightUpdate {
    median_ms: f64,
    max_ms: f64,
    /// Receivers, and interpolation points, whose light was found.
    visible_receivers: usize,
    visible_points: usize,
    /// Bytes of all that frames hold beside the scene.
    bytes: u64,
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    machine: &'a Machine,
    seed: u32,
    size: (u32, u32),
    frames: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    peak_memory_bytes: Option<u64>,
    rows: &'a [Row],
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, "frame", &SCENES, &[COUNT])?;
    let mut rows: Vec<Row> = Vec::new();
    let results = |rows: &[Row]| {
        output::json(&Results {
            name: "frame",
            machine: &machine,
            seed: common.seed,
            size: args.size(),
            frames: args.frames(),
            peak_memory_bytes: peak_memory_bytes(),
            rows,
        })
    };
    for scene in scenes {
        let progress = Progress::new(common.quiet);
        let loaded = output::import(scene, &progress)?;
        for &count in &counts {
            let measuring = Measuring { common, args, loaded: &loaded, progress: &progress };
            measuring.measure(count as usize, &mut |row| {
                rows.push(row);
                // What is known is kept when the rest fails or is stopped.
                output::write_text(&out.join("summary.json"), &results(&rows))
            })?;
            write_report(&machine, &rows, &out)?;
        }
    }
    if common.json {
        println!("{}", results(&rows));
    } else {
        tables(&machine, &rows).iter().for_each(|table| println!("{}", table.markdown()));
        println!("{} shows the same", out.join("report.html").display());
    }
    Ok(())
}

struct Measuring<'a> {
    common: &'a Common,
    args: &'a Bench,
    loaded: &'a LoadedScene,
    progress: &'a Progress,
}

impl Measuring<'_> {
    fn measure(&self, count: usize, keep: &mut dyn FnMut(Row) -> Result<(), Error>) -> Result<(), Error> {
        let Self { common, args, loaded, progress } = *self;
        let settings = suited_settings(common, args, loaded, count);
        let bake = Arc::new(Bake::build(&loaded.scene, &settings, progress)?);
        let tiles = MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON });
        let render = RenderSettings {
            method: tiles,
            eye: loaded.view.eye,
            size: args.size(),
            sub_frames: 1,
            receivers: ReceiverUpdate::InView,
            ..RenderSettings::default()
        };
        let mut renderer = load(common, &bake, &render, progress)?;
        let events = match loaded.scene.lighting.lights.len() {
            0 | 1 => &[Event::Move, Event::Fly, Event::Rest][..],
            _ => &[Event::Move, Event::Fly, Event::Rest, Event::Switch],
        };
        for &event in events {
            keep(self.frames(&mut renderer, "tiles 1 %", event, ReceiverUpdate::InView)?)?;
        }
        renderer.set_receivers(ReceiverUpdate::All)?;
        keep(self.frames(&mut renderer, "tiles 1 %", Event::Move, ReceiverUpdate::All)?)?;
        renderer.set_receivers(ReceiverUpdate::InView)?;
        let temporal = MethodSettings::Temporal(TemporalSettings::default());
        let local = MethodSettings::Local(LocalSettings::default());
        for (name, method) in [("temporal", temporal), ("local", local), ("classic", MethodSettings::Classic)] {
            renderer.set_method(method, progress)?;
            keep(self.frames(&mut renderer, name, Event::Move, ReceiverUpdate::InView)?)?;
        }
        Ok(())
    }

    /// The lights and the camera of a frame.
    fn shot(&self, event: Event, movement: &Movement, number: u32) -> (Vec<Light>, Camera) {
        let (lights, view) = movement.at(number);
        let size = self.args.size();
        let view = if event == Event::Fly { view } else { self.loaded.view };
        (self.lights(event, lights, number), view.camera(size.0, size.1))
    }

    fn lights(&self, event: Event, moved: Vec<Light>, number: u32) -> Vec<Light> {
        let own = &self.loaded.scene.lighting.lights;
        match event {
            Event::Move | Event::Fly => moved,
            Event::Rest => own.clone(),
            Event::Switch => {
                let mut lights = own.clone();
                if number % 2 == 1 {
                    lights.remove(own.len() / 2);
                }
                lights
            }
        }
    }

    /// Light updates of all frames; the first one, which makes memory ready, does not count.
    fn frames(
        &self,
        renderer: &mut Renderer,
        method: &str,
        event: Event,
        receivers: ReceiverUpdate,
    ) -> Result<Row, Error> {
        let Self { args, loaded, progress, .. } = *self;
        let frames = args.frames();
        let movement = Movement::new(loaded, (Animate::Sun, Some(CameraPath::Fly)), frames + 1, &Progress::new(true));
        let mut whole = Vec::new();
        let mut by_pass: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
        for number in 0..=frames {
            let (lights, camera) = self.shot(event, &movement, number);
            let lighting = with_lights(&loaded.scene, &lights);
            let start = Instant::now();
            let times = renderer.advance(&lighting, &camera)?;
            let ms = 1e3 * start.elapsed().as_secs_f64() - pass_ms(&times, PIXELS);
            if is_cancelled() {
                return Err(Error::Cancelled);
            }
            if number > 0 {
                whole.push(ms);
                for pass in PASSES {
                    by_pass.entry(pass).or_default().push(pass_ms(&times, pass));
                }
            }
        }
        let PassTimes { median_ms, max_ms } =
            PassTimes::of(&whole).unwrap_or(PassTimes { median_ms: 0.0, max_ms: 0.0 });
        progress.note(&format!("{}: {method}, {}: {median_ms:.2} ms", loaded.name, event.name()));
        let bytes = renderer.bytes();
        let (visible_receivers, visible_points) = renderer.count_updated()?;
        let bake = renderer.bake();
        Ok(Row {
            scene: loaded.name.clone(),
            method: method.to_owned(),
            event: event.name(),
            receivers_updated: match receivers {
                ReceiverUpdate::All => "all",
                ReceiverUpdate::InView => "in view",
            },
            patches: bake.mesh.patches.len(),
            receivers: bake.receivers.points.len(),
            interpolation_points: bake.receivers.interpolation.points.len(),
            light_update: LightUpdate {
                median_ms,
                max_ms,
                visible_receivers,
                visible_points,
                bytes: bytes.values().sum(),
            },
            passes: by_pass.into_iter().filter_map(|(pass, t)| Some((pass, PassTimes::of(&t)?.median_ms))).collect(),
            bytes,
        })
    }
}

/// Times of whole light updates and of their passes, and what the updates would take if memory were all that counts.
fn tables(machine: &Machine, rows: &[Row]) -> Vec<Table> {
    let head = ["scene", "method", "what happens", "receivers", "median ms", "max ms"];
    let times = Table {
        caption: "Whole light updates, from \"a light has moved\" to irradiance at every visible point; passes, medians in ms. \
                  The primary rays of the pixels, which say what is in view, are not counted."
            .to_owned(),
        head: head.into_iter().chain(PASSES).chain(["receivers found", "points found"]).map(str::to_owned).collect(),
        rows: rows
            .iter()
            .map(|row| {
                let update = &row.light_update;
                let texts = [&row.scene, &row.method, row.event, row.receivers_updated].map(str::to_owned);
                let passes = PASSES.map(|pass| row.passes.get(pass).copied().unwrap_or(0.0));
                // A sum of nothing may be a negative zero.
                let numbers = [update.median_ms, update.max_ms].into_iter().chain(passes).map(|ms| ms + 0.0);
                let found = [
                    format!("{} of {}", update.visible_receivers, row.receivers),
                    format!("{} of {}", update.visible_points, row.interpolation_points),
                ];
                texts.into_iter().chain(numbers.map(|ms| format!("{ms:.2}"))).chain(found).collect()
            })
            .collect(),
    };
    vec![times, memory_table(machine, rows)]
}

/// What frames hold, and how long it takes to read it once.
fn memory_table(machine: &Machine, rows: &[Row]) -> Table {
    let mut seen: Vec<(&str, &str, usize)> = Vec::new();
    let mut lines = Vec::new();
    for row in rows {
        let key = (row.scene.as_str(), row.method.as_str(), row.patches);
        if seen.contains(&key) {
            continue;
        }
        seen.push(key);
        for (part, &bytes) in &row.bytes {
            lines.push(vec![
                row.scene.clone(),
                row.method.clone(),
                part.clone(),
                format!("{:.1}", bytes as f64 * 1e-6),
                format!("{:.2}", bytes as f64 * 1e-6 / machine.stream_gb_s),
            ]);
        }
    }
    let head = ["scene", "method", "part", "MB", "ms to read once"];
    Table {
        caption: format!("What frames hold beside the scene, and its reading at {:.1} GB/s.", machine.stream_gb_s),
        head: head.map(str::to_owned).to_vec(),
        rows: lines,
    }
}

fn write_report(machine: &Machine, rows: &[Row], out: &Path) -> Result<(), Error> {
    let section = Section {
        title: "Light updates".to_owned(),
        text: Vec::new(),
        figures: Vec::new(),
        strip: Vec::new(),
        tables: tables(machine, rows),
        plots: Vec::new(),
    };
    output::write_text(&out.join("report.html"), &page("Patchlight: light updates", &[], [&section]))
}
