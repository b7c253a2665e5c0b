//! `bench frame`: whole light updates, from "a light has moved" to irradiance at every visible point.

mod beside;
mod floors;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;
use scene::{Camera, Light};
use serde::Serialize;

use self::beside::Beside;
use super::setup::{Machine, Setup, bake_settings, load};
use crate::args::{Animate, Bench, CameraPath, Common};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, interruptible, is_cancelled};
use crate::report::{Section, Table, page};
use crate::sequence::{Movement, PIXELS, pass_ms};
use crate::summary::{LightUpdate, PassTimes};
use assets::import::LoadedScene;
use patchlight::light::with_lights;
use patchlight::low_level::operator::Codec;
use patchlight::memory::peak_memory_bytes;
use patchlight::method::{LocalSettings, TemporalSettings};
use patchlight::{
    Bake, LightSettings, MethodSettings, PictureRenderer, PictureSettings, Point, PointKind, ReceiverUpdate, points,
};

/// Scenes, unless some are named.
const SCENES: [&str; 1] = ["office"];
/// Patches of a scene, unless it is said.
const COUNT: u32 = 10_000;
/// Relative error of the compressed operator.
const EPSILON: f64 = 0.01;
/// The method with it.
const TILES: &str = "tiles 1 %";
/// Points along each edge of the grid whose cost is measured.
const POINTS_AN_EDGE: usize = 10;
/// Passes of a light update, in their order; "update" is the matrix round the camera.
const PASSES: [&str; 7] = ["direct", "gather", "update", "method", "lookup", "mark", "view"];

/// Event from frame to frame.
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
    triangles: usize,
    lights: usize,
    patches: usize,
    receivers: usize,
    interpolation_points: usize,
    light_update: LightUpdate,
    /// Medians of the passes.
    passes: BTreeMap<&'static str, f64>,
    /// Least work of passes.
    work: BTreeMap<&'static str, Work>,
    bytes: BTreeMap<String, u64>,
}

/// Least work of a pass.
#[derive(Clone, Copy, Serialize)]
struct Work {
    /// Tables that it reads and values that it writes.
    bytes: u64,
    /// Multiplications and additions of single numbers; those of rays are not counted.
    operations: u64,
}

/// Cost of points of one's own: a grid in the air.
#[derive(Clone, Serialize)]
struct PointCost {
    scene: String,
    patches: usize,
    points: usize,
    /// Rays of each point, traced once.
    rays: u32,
    trace_s: f64,
    /// Median of their passes in a light update, and its part of a point.
    update_ms: f64,
    microseconds_a_point: f64,
}

/// A result as it comes.
enum Measured {
    Update(Row),
    Points(PointCost),
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
    points: &'a [PointCost],
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, "frame", &SCENES, &[COUNT])?;
    if let Some(program) = &args.against {
        return by_turns(common, args, program, (&scenes, &counts), &machine, &out);
    }
    let mut rows: Vec<Row> = Vec::new();
    let mut points: Vec<PointCost> = Vec::new();
    let results = |rows: &[Row], points: &[PointCost]| {
        output::json(&Results {
            name: "frame",
            machine: &machine,
            seed: common.seed,
            size: args.size(),
            frames: args.frames(),
            peak_memory_bytes: peak_memory_bytes(),
            rows,
            points,
        })
    };
    let operations_g = floors::operations_g();
    let mut keep = |measured: Measured| {
        match measured {
            Measured::Update(row) => rows.push(row),
            Measured::Points(cost) => points.push(cost),
        }
        // What is known is kept when the rest fails or is stopped.
        output::write_text(&out.join("summary.json"), &results(&rows, &points))?;
        write_report(&machine, operations_g, &rows, &points, &out)
    };
    for scene in scenes {
        let progress = Progress::new(common.quiet);
        let loaded = output::import_flat(scene, &progress)?;
        let measuring = Measuring { common, args, loaded: &loaded, progress: &progress };
        for &count in &counts {
            measuring.measure(count as usize, &mut keep)?;
        }
    }
    if common.json {
        say!("{}", results(&rows, &points));
    } else {
        tables(&machine, operations_g, &rows, &points).iter().for_each(|table| say!("{}", table.markdown()));
        say!("{} shows the same", out.join("report.html").display());
    }
    Ok(())
}

/// Results by turns with another program.
#[derive(Serialize)]
struct Turns<'a> {
    name: &'static str,
    machine: &'a Machine,
    program: String,
    size: (u32, u32),
    frames: u32,
    rows: &'a [Beside],
}

/// Measures light updates of this build's `patchlight` and of another one, by turns, and nothing else.
fn by_turns(
    common: &Common,
    args: &Bench,
    program: &Path,
    (scenes, counts): (&[&str], &[u32]),
    machine: &Machine,
    out: &Path,
) -> Result<(), Error> {
    let mut rows = Vec::new();
    for scene in scenes {
        for &count in counts {
            rows.extend(beside::measure(common, args, program, (scene, count), out)?);
        }
    }
    let section = beside::section(&rows, program);
    let results = output::json(&Turns {
        name: "frame",
        machine,
        program: program.display().to_string(),
        size: args.size(),
        frames: args.frames(),
        rows: &rows,
    });
    output::write_text(&out.join("summary.json"), &results)?;
    let introduction = [machine.sentence()];
    output::write_text(&out.join("report.html"), &page("Patchlight: light updates", &introduction, [&section]))?;
    match common.json {
        true => say!("{results}"),
        false => section.tables.iter().for_each(|table| say!("{}", table.markdown())),
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
    fn measure(&self, count: usize, keep: &mut dyn FnMut(Measured) -> Result<(), Error>) -> Result<(), Error> {
        let Self { common, args, loaded, progress } = *self;
        let settings = bake_settings(common, args, loaded, count);
        let bake = Arc::new(Bake::build(&loaded.scene, &settings, progress)?);
        let (light, pictures) = self.settings();
        let mut renderer = load(common, &bake, &light, &pictures, progress)?;
        let events = match loaded.scene.lighting.lights.len() {
            0 | 1 => &[Event::Move, Event::Fly, Event::Rest][..],
            _ => &[Event::Move, Event::Fly, Event::Rest, Event::Switch],
        };
        for &event in events {
            keep(Measured::Update(self.frames(&mut renderer, TILES, event, ReceiverUpdate::InView)?))?;
        }
        renderer.set_receivers(ReceiverUpdate::All)?;
        keep(Measured::Update(self.frames(&mut renderer, TILES, Event::Move, ReceiverUpdate::All)?))?;
        keep(Measured::Points(self.points(&mut renderer)?))?;
        renderer.set_receivers(ReceiverUpdate::InView)?;
        let temporal = MethodSettings::Temporal(TemporalSettings::default());
        let local = MethodSettings::Local(LocalSettings::default());
        for (name, method) in [("temporal", temporal), ("local", local), ("classic", MethodSettings::Classic)] {
            renderer.set_method(method, progress)?;
            keep(Measured::Update(self.frames(&mut renderer, name, Event::Move, ReceiverUpdate::InView)?))?;
        }
        Ok(())
    }

    /// Adds a grid of points in the box of the receivers, updates the light frame by frame, and removes them.
    fn points(&self, renderer: &mut PictureRenderer) -> Result<PointCost, Error> {
        let Self { args, loaded, progress, .. } = *self;
        let light = renderer.light_mut();
        let positions = || light.bake().receivers().points.iter().map(|point| point.position);
        let low = positions().reduce(Vec3::min).unwrap_or(Vec3::ZERO);
        let high = positions().reduce(Vec3::max).unwrap_or(Vec3::ONE);
        let share = |k: usize| (k as f32 + 0.5) / POINTS_AN_EDGE as f32;
        let count = POINTS_AN_EDGE.pow(3);
        let all: Vec<Point> = (0..count)
            .map(|k| {
                let cell = [k % POINTS_AN_EDGE, k / POINTS_AN_EDGE % POINTS_AN_EDGE, k / POINTS_AN_EDGE.pow(2)];
                Point { position: low + (high - low) * Vec3::from_array(cell.map(share)), normal: Vec3::Y }
            })
            .collect();
        let start = Instant::now();
        let set = interruptible(|| light.add_points(&all, PointKind::Irradiance, progress))?;
        let trace_s = start.elapsed().as_secs_f64();
        let movement =
            Movement::new(loaded, (Animate::Sun, Some(CameraPath::Fly)), args.frames() + 1, &Progress::new(true));
        let mut updates = Vec::new();
        for number in 0..=args.frames() {
            let (lights, camera) = self.shot(Event::Move, &movement, number);
            let times = interruptible(|| renderer.advance(&with_lights(&loaded.scene, &lights), &camera))?;
            updates.push(pass_ms(&times, points::PASS));
        }
        let light = renderer.light_mut();
        light.remove_points(set)?;
        let update_ms = PassTimes::of(&updates[1..]).map_or(0.0, |times| times.median_ms);
        Ok(PointCost {
            scene: loaded.name.clone(),
            patches: light.bake().mesh().patches.len(),
            points: count,
            rays: light.settings().point_rays,
            trace_s,
            update_ms,
            microseconds_a_point: 1e3 * update_ms / count as f64,
        })
    }

    /// Tiles, what is in view.
    fn settings(&self) -> (LightSettings, PictureSettings) {
        let method = MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON });
        let light = LightSettings::default().with_method(method).with_eye(self.loaded.view.eye);
        let pictures = PictureSettings::default().with_size(self.args.size()).with_sub_frames(1);
        (light, pictures.with_receivers(ReceiverUpdate::InView))
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
                    lights[own.len() / 2].color = Vec3::ZERO;
                }
                lights
            }
        }
    }

    /// Light updates of all frames of an event.
    fn frames(
        &self,
        renderer: &mut PictureRenderer,
        method: &str,
        event: Event,
        receivers: ReceiverUpdate,
    ) -> Result<Row, Error> {
        let Self { args, loaded, .. } = *self;
        let frames = args.frames();
        let movement = Movement::new(loaded, (Animate::Sun, Some(CameraPath::Fly)), frames + 1, &Progress::new(true));
        let named = Named { method, event: event.name(), receivers };
        self.measured(renderer, &named, &|number| self.shot(event, &movement, number))
    }

    /// Light updates of all frames of a movement; the first one, which makes memory ready, does not count.
    fn measured(
        &self,
        renderer: &mut PictureRenderer,
        named: &Named,
        shot: &dyn Fn(u32) -> (Vec<Light>, Camera),
    ) -> Result<Row, Error> {
        let Self { args, loaded, .. } = *self;
        let mut whole = Vec::new();
        let mut by_pass: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
        let mut lights = 0;
        for number in 0..=args.frames() {
            let (shining, camera) = shot(number);
            lights = shining.len();
            let lighting = with_lights(&loaded.scene, &shining);
            let start = Instant::now();
            let times = interruptible(|| renderer.advance(&lighting, &camera))?;
            let ms = 1e3 * start.elapsed().as_secs_f64() - pass_ms(&times, PIXELS);
            if is_cancelled() {
                return Err(shell::Error::Cancelled.into());
            }
            if number > 0 {
                whole.push(ms);
                for pass in PASSES {
                    by_pass.entry(pass).or_default().push(pass_ms(&times, pass));
                }
            }
        }
        let passes = by_pass.into_iter().filter_map(|(pass, t)| Some((pass, PassTimes::of(&t)?.median_ms))).collect();
        let times = PassTimes::of(&whole).unwrap_or(PassTimes { median_ms: 0.0, max_ms: 0.0 });
        self.row(renderer, named, lights, times, passes)
    }

    /// The row of so many lights, with the times of whole updates and the medians of their passes.
    fn row(
        &self,
        renderer: &mut PictureRenderer,
        named: &Named,
        lights: usize,
        times: PassTimes,
        passes: BTreeMap<&'static str, f64>,
    ) -> Result<Row, Error> {
        let Self { args, loaded, progress, .. } = *self;
        let Named { method, event, receivers } = *named;
        progress.note(&format!("{}: {method}, {event}: {:.2} ms", loaded.name, times.median_ms));
        let found = renderer.count_updated()?;
        let bytes = renderer.light().bytes();
        let bake = renderer.light().bake();
        let mut work = floors::work(bake, lights, receivers, found);
        if event == Event::Fly.name() {
            work.insert("mark", floors::of_pixels(args.size()));
        }
        Ok(Row {
            scene: loaded.name.clone(),
            method: method.to_owned(),
            event,
            receivers_updated: match receivers {
                ReceiverUpdate::All => "all",
                ReceiverUpdate::InView => "in view",
            },
            triangles: loaded.scene.geometry.triangles.len(),
            lights,
            patches: bake.mesh().patches.len(),
            receivers: bake.receivers().points.len(),
            interpolation_points: bake.receivers().interpolation.points.len(),
            light_update: LightUpdate {
                median_ms: times.median_ms,
                max_ms: times.max_ms,
                frames_ms: Vec::new(),
                visible_receivers: found.0,
                visible_points: found.1,
                bytes: bytes.values().sum(),
            },
            passes,
            work,
            bytes,
        })
    }
}

/// Measured method.
struct Named<'a> {
    method: &'a str,
    event: &'static str,
    receivers: ReceiverUpdate,
}

/// Times of whole light updates and of their passes, and what the updates would take if memory were all that counts.
fn tables(machine: &Machine, operations_g: f64, rows: &[Row], points: &[PointCost]) -> Vec<Table> {
    let head = ["scene", "method", "what happens", "updated", "triangles", "patches", "lights", "median ms", "max ms"];
    let times = Table {
        caption: "Whole light updates, from \"a light has moved\" to irradiance at every visible point; passes, \
         medians in ms. \
                  The primary rays of the pixels, which say what is in view, are not counted."
            .to_owned(),
        head: head.into_iter().chain(PASSES).chain(["receivers found", "points found"]).map(str::to_owned).collect(),
        rows: rows
            .iter()
            .map(|row| {
                let update = &row.light_update;
                let texts =
                    [row.scene.clone(), row.method.clone(), row.event.to_owned(), row.receivers_updated.to_owned()];
                let passes = PASSES.map(|pass| row.passes.get(pass).copied().unwrap_or(0.0));
                // A sum of nothing may be a negative zero.
                let numbers = [update.median_ms, update.max_ms].into_iter().chain(passes).map(|ms| ms + 0.0);
                let found = [
                    format!("{} of {}", update.visible_receivers, row.receivers),
                    format!("{} of {}", update.visible_points, row.interpolation_points),
                ];
                let sizes = [row.triangles, row.patches, row.lights].map(|n| n.to_string());
                texts.into_iter().chain(sizes).chain(numbers.map(|ms| format!("{ms:.2}"))).chain(found).collect()
            })
            .collect(),
    };
    vec![times, point_table(points), floors::table(machine, operations_g, rows), memory_table(machine, rows)]
}

/// Cost of points of one's own.
fn point_table(points: &[PointCost]) -> Table {
    let head = ["scene", "patches", "points", "rays each", "traced once, s", "ms an update", "µs a point and update"];
    Table {
        caption: "Points of one's own, on a grid in the air: their passes in a light update, medians.".to_owned(),
        head: head.map(str::to_owned).to_vec(),
        rows: points
            .iter()
            .map(|cost| {
                vec![
                    cost.scene.clone(),
                    cost.patches.to_string(),
                    cost.points.to_string(),
                    cost.rays.to_string(),
                    format!("{:.2}", cost.trace_s),
                    format!("{:.3}", cost.update_ms),
                    format!("{:.3}", cost.microseconds_a_point),
                ]
            })
            .collect(),
    }
}

/// Memory of frames, and the time to read it once.
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

fn write_report(
    machine: &Machine,
    operations_g: f64,
    rows: &[Row],
    points: &[PointCost],
    out: &Path,
) -> Result<(), Error> {
    let section = Section {
        title: "Light updates".to_owned(),
        tables: tables(machine, operations_g, rows, points),
        ..Section::default()
    };
    Ok(output::write_text(&out.join("report.html"), &page("Patchlight: light updates", &[], [&section]))?)
}
