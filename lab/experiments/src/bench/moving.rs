//! `bench moving`: objects that move through a bake, beside path tracing with them in their place and DDGI that knows
//! them there; and a door.

use std::sync::Arc;
use std::time::Instant;

use assets::import::{Animation, LoadedScene};
use glam::Vec3;
use patchlight::light::with_lights;
use patchlight::low_level::operator::Codec;
use patchlight::{Bake, LightField, LightSettings, MethodSettings, PictureRenderer, PictureSettings, ReceiverUpdate};
use reference::Picture;
use scene::math::luminance;
use scene::{Lighting, NONE};
use serde::Serialize;
use shell::sequence::Moving;

use super::contest::field::Field;
use super::contest::{View, cancelled};
use super::setup::{Machine, Setup, bake_settings, load};
use super::truth::Truth;
use crate::args::{Bench, Common};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, interruptible};
use crate::report::{Section, Table, page};

/// Scenes, and their patches, unless it is said; and the one with the door.
const SCENES: [&str; 3] = ["cornell:block", "office:person", "atrium:lorry"];
const DOOR: &str = "rooms:door";
const COUNT: u32 = 2000;
/// Angles of the door: so many steps from closed to open.
const ANGLES: u32 = 10;
/// What is near an object, m.
const NEAR: f32 = 1.0;
/// Edge of blocks, pixels.
const BLOCK: u32 = 8;
/// Relative error of the compressed operator.
const EPSILON: f64 = 0.01;
/// Light updates that are measured, by turns with and without a move.
const UPDATES: u32 = 9;
/// Frames of DDGI under light that rests: more change nothing.
const DDGI_FRAMES: u32 = 64;

/// An object in its place.
#[derive(Clone, Debug, Serialize)]
struct Row {
    scene: String,
    /// Share of the indirect light that is wrong near the object: with it, as if it had no indirect light and took none
    /// away, and by DDGI.
    error_near: f64,
    error_near_without: f64,
    ddgi_error_near: f64,
    /// Time of a light update with a move, beyond that of one without, ms.
    extra_ms: f64,
    /// Pixels that are near.
    pixels: usize,
}

/// Light of the room behind a door, over that of paths.
#[derive(Clone, Debug, Serialize)]
struct DoorRow {
    angle: f32,
    ratio: f64,
    /// Light of paths over that of the open door.
    open: f64,
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    machine: &'a Machine,
    rows: &'a [Row],
    door: &'a [DoorRow],
}

/// Runs the experiment.
pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, "moving", &SCENES, &[COUNT])?;
    let progress = Progress::new(common.quiet);
    let count = counts[0] as usize;
    let mut rows = Vec::new();
    for scene in scenes {
        rows.push(Subject::new(common, args, scene, count, &progress)?.row(common, args, &progress)?);
        cancelled()?;
    }
    let door = door(common, args, count, &progress)?;
    let results = Results { name: "moving", machine: &machine, rows: &rows, door: &door };
    output::write_text(&out.join("summary.json"), &output::json(&results))?;
    let section = results.section();
    output::write_text(
        &out.join("report.html"),
        &page("Patchlight: things that move", &[machine.sentence()], [&section]),
    )?;
    if common.json {
        say!("{}", output::json(&results));
    } else {
        section.tables.iter().for_each(|table| say!("{}", table.markdown()));
    }
    Ok(())
}

/// A scene with its bake.
struct Subject {
    loaded: LoadedScene,
    bake: Arc<Bake>,
}

impl Subject {
    fn new(common: &Common, args: &Bench, scene: &str, count: usize, progress: &Progress) -> Result<Self, Error> {
        let loaded = output::import_flat(scene, progress)?;
        if loaded.moving.is_empty() {
            return Err(Error::NothingMoves { scene: scene.to_owned() });
        }
        let bake = Bake::build(&loaded.scene, &bake_settings(common, args, &loaded, count), progress)?;
        Ok(Self { loaded, bake: Arc::new(bake) })
    }

    fn renderer(&self, common: &Common, args: &Bench) -> Result<PictureRenderer, Error> {
        let method = MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON });
        let light = LightSettings::default().with_method(method).with_eye(self.loaded.view.eye);
        let pictures = PictureSettings::default().with_size(args.size()).with_sub_frames(args.sub_frames);
        load(common, &self.bake, &light, &pictures, &Progress::new(true))
    }

    /// The scene with the objects among its triangles.
    fn at(&self, time: f32) -> Result<LoadedScene, Error> {
        Ok(LoadedScene { scene: self.loaded.scene_at(time)?, moving: Vec::new(), ..self.loaded.clone() })
    }

    fn place(&self, moving: &Moving, light: &mut LightField, time: f32) -> Result<(), Error> {
        let places: Vec<_> = self.loaded.moving.iter().map(|object| object.transform(time)).collect();
        Ok(moving.place(light, &places)?)
    }

    fn row(&self, common: &Common, args: &Bench, progress: &Progress) -> Result<Row, Error> {
        let time = 0.5 * self.loaded.moving_duration();
        let now = self.at(time)?;
        let lights = &self.loaded.scene.lighting.lights;
        let truth = Truth::traced(&now, lights, args.size(), args.spp, common.seed, progress)?;
        let args = &Bench { size: Some(truth.size()), ..args.clone() };
        let view = View::new(common, args, &now);
        let near = near_objects(&view, self.loaded.objects.len());
        let expected = &truth.pictures.indirect;
        let mut renderer = self.renderer(common, args)?;
        let lighting = &self.loaded.scene.lighting;
        let bare = interruptible(|| renderer.picture(lighting, &view.camera, 0))?.pictures.indirect;
        let moving = Moving::add(renderer.light_mut(), &self.loaded.moving)?;
        self.place(&moving, renderer.light_mut(), time)?;
        let found = interruptible(|| renderer.picture(lighting, &view.camera, 0))?.pictures.indirect;
        let extra_ms = self.extra_ms(&mut renderer, &moving, &view)?;
        drop(renderer);
        let mut probes = Field::of_bake(&view, &self.bake, progress).finest_probes()?;
        progress.phase("DDGI", |_| {
            (0..DDGI_FRAMES).try_for_each(|number| {
                probes.frame(lighting, number)?;
                cancelled()
            })
        })?;
        let by_probes = probes.pictures(None)?.indirect;
        let error = |picture: &Picture| difference(picture, expected, &near);
        let row = Row {
            scene: self.name(),
            error_near: error(&found),
            error_near_without: error(&bare),
            ddgi_error_near: error(&by_probes),
            extra_ms,
            pixels: near.iter().filter(|near| **near).count(),
        };
        progress.note(&format!(
            "{}: {:.2} % near, {:.2} % without",
            row.scene,
            100.0 * row.error_near,
            100.0 * row.error_near_without
        ));
        Ok(row)
    }

    fn name(&self) -> String {
        let moving: Vec<&str> = self.loaded.moving.iter().take(1).map(|object| object.name.as_str()).collect();
        format!("{}, {}", self.loaded.name, moving.concat())
    }

    /// Time that a move takes beyond what lights that move take, ms: medians, by turns.
    fn extra_ms(&self, renderer: &mut PictureRenderer, moving: &Moving, view: &View) -> Result<f64, Error> {
        renderer.set_receivers(ReceiverUpdate::InView)?;
        let path = Animation::default_path(&self.loaded);
        let half = 0.5 * self.loaded.moving_duration();
        let mut times = [Vec::new(), Vec::new()];
        for k in 0..2 * UPDATES {
            let lights = path.at(path.duration() * k as f32 / (2 * UPDATES) as f32).0;
            let lighting: Lighting = with_lights(&self.loaded.scene, &lights);
            let moves = k % 2 == 1;
            if moves {
                self.place(moving, renderer.light_mut(), half * (1.0 + 0.01 * k as f32))?;
            }
            let start = Instant::now();
            interruptible(|| renderer.advance(&lighting, &view.camera))?;
            times[usize::from(moves)].push(1e3 * start.elapsed().as_secs_f64());
        }
        let [without, with] = times.map(|mut times| {
            times.sort_by(f64::total_cmp);
            times[times.len() / 2]
        });
        Ok(with - without)
    }
}

/// Pixels that show a surface at rest near an object: of a scene whose objects have numbers from `first` on.
fn near_objects(view: &View, first: usize) -> Vec<bool> {
    let geometry = &view.loaded.scene.geometry;
    let is_object = |t: &scene::gpu::Triangle| t.object as usize >= first;
    let own: Vec<Vec3> = geometry
        .triangles
        .iter()
        .filter(|t| is_object(t))
        .flat_map(|t| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b, t.corner + (t.edge_a + t.edge_b) / 3.0])
        .collect();
    let tables = view.loaded.scene.tables();
    let near = |pixel: u32| {
        let hit = scene::kernel::camera::primary_hit(&tables, &view.camera, pixel, 0);
        if hit.triangle == NONE || is_object(&geometry.triangles[hit.triangle as usize]) {
            return false;
        }
        let place = tables.position(hit.triangle, hit.u, hit.v);
        own.iter().any(|corner| corner.distance_squared(place) < NEAR * NEAR)
    };
    (0..view.camera.width * view.camera.height).map(near).collect()
}

/// Mean difference of the luminance of blocks over their mean, of the pixels that count.
fn difference(found: &Picture, expected: &Picture, counts: &[bool]) -> f64 {
    let (width, height) = (found.width, found.height);
    let mut apart = 0.0;
    let mut whole = 0.0;
    for by in 0..height.div_ceil(BLOCK) {
        for bx in 0..width.div_ceil(BLOCK) {
            let mut sums = [0.0f64; 2];
            for y in by * BLOCK..((by + 1) * BLOCK).min(height) {
                for x in bx * BLOCK..((bx + 1) * BLOCK).min(width) {
                    let pixel = (y * width + x) as usize;
                    if counts[pixel] {
                        sums[0] += f64::from(luminance(found.pixels[pixel]));
                        sums[1] += f64::from(luminance(expected.pixels[pixel]));
                    }
                }
            }
            apart += (sums[0] - sums[1]).abs();
            whole += sums[1];
        }
    }
    if whole > 0.0 { apart / whole } else { 0.0 }
}

/// Light of the room behind the door at even angles, from closed to open.
fn door(common: &Common, args: &Bench, count: usize, progress: &Progress) -> Result<Vec<DoorRow>, Error> {
    let subject = Subject::new(common, args, DOOR, count, progress)?;
    let mut renderer = subject.renderer(common, args)?;
    let moving = Moving::add(renderer.light_mut(), &subject.loaded.moving)?;
    let camera = subject.loaded.view.camera(args.size().0, args.size().1);
    let lighting = &subject.loaded.scene.lighting;
    let mean = |picture: &Picture| f64::from(luminance(picture.mean()));
    let mut rows: Vec<DoorRow> = Vec::new();
    // From the middle of its time, when it is closed, to the end.
    for k in (0..=ANGLES).rev() {
        let share = k as f32 / ANGLES as f32;
        let time = 0.5 * subject.loaded.moving_duration() * (1.0 + share);
        let now = subject.at(time)?;
        let truth = Truth::traced(&now, &lighting.lights, args.size(), args.spp, common.seed, progress)?;
        subject.place(&moving, renderer.light_mut(), time)?;
        let found = interruptible(|| renderer.picture(lighting, &camera, 0))?.pictures.indirect;
        let expected = mean(&truth.pictures.indirect);
        let open = rows.first().map_or(expected, |row| row.open);
        // Of a closed door: over the light of the open one.
        let ratio = mean(&found) / if expected > 1e-3 * open { expected } else { open };
        rows.push(DoorRow {
            angle: 90.0 * share,
            ratio,
            open: if rows.is_empty() { expected } else { expected / open },
        });
        cancelled()?;
    }
    if let Some(first) = rows.first_mut() {
        first.open = 1.0;
    }
    rows.reverse();
    Ok(rows)
}

impl Results<'_> {
    fn section(&self) -> Section {
        let percent = |x: f64| format!("{:.2}", 100.0 * x);
        let row = |row: &Row| {
            vec![
                row.scene.clone(),
                percent(row.error_near),
                percent(row.error_near_without),
                percent(row.ddgi_error_near),
                format!("{:.1}", row.extra_ms),
                row.pixels.to_string(),
            ]
        };
        let head = ["object", "error near %", "without it %", "DDGI %", "more ms an update", "pixels"];
        let objects = Table {
            caption: format!("Indirect light within {NEAR} m of objects, beside paths"),
            head: head.map(str::to_owned).to_vec(),
            rows: self.rows.iter().map(row).collect(),
        };
        let row =
            |row: &DoorRow| vec![format!("{:.0}", row.angle), format!("{:.3}", row.ratio), format!("{:.3}", row.open)];
        let head = ["angle °", "light / paths", "paths / open"];
        let door = Table {
            caption: "Mean light of the room behind a door; closed, over that of the open door".to_owned(),
            head: head.map(str::to_owned).to_vec(),
            rows: self.door.iter().map(row).collect(),
        };
        Section { title: "Things that move".to_owned(), tables: vec![objects, door], ..Section::default() }
    }
}
