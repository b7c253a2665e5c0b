//! `bench ddgi`: what is in view, by tiles and sampled, beside probes with irradiance and visibility: time of a whole light
//! update, memory, indirect light against path tracing, and frames until a jump of the lights is followed.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;
use reference::metrics::{compare_pictures, indirect_scale};
use reference::{Ddgi, DdgiSettings, Picture, PictureErrors, PictureFile, Spacing, ViewedPoint, scale_to_stops};
use scene::kernel::camera::{primary_direction, primary_hit, surface_point};
use scene::{Camera, Lighting, SurfacePoint};
use serde::Serialize;

use super::truth::Truth;
use super::{Machine, Setup, load, suited_settings};
use crate::args::{Animate, Bench, Common};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, interruptible, is_cancelled};
use crate::report::{Figure, Plot, Section, Series, Table, page};
use crate::sequence::{Movement, PIXELS, distance, pass_ms};
use crate::summary::PassTimes;
use assets::import::{Animation, LoadedScene};
use patchlight::method::TemporalSettings;
use patchlight::operator::Codec;
use patchlight::renderer::with_lights;
use patchlight::{Bake, MethodSettings, PixelGather, ReceiverUpdate, RenderSettings, Renderer};

/// Scenes, unless some are named.
const SCENES: [&str; 2] = ["cornell", "office"];
/// Patches of a scene, unless it is said.
const COUNT: u32 = 2000;
/// Relative error of the compressed operator.
const EPSILON: f64 = 0.01;
/// Frames with other lights, and then with the scene's own: enough for the hysteresis of probes.
const AWAY: u32 = 60;
const REST: u32 = 120;
/// Spacings are shares of this length in scenes that are smaller, m.
const SMALL_SCENE: f32 = 8.0;
/// Scenes of which pixels see more backs of surfaces than this share are lit from both sides by probes.
const BACKS: f64 = 0.01;
/// What is left of the jump when it counts as followed.
const FOLLOWED: f64 = 0.1;
/// Name of the reference's picture.
const REFERENCE: &str = "reference";

/// A measurement.
#[derive(Clone, Serialize)]
struct Row {
    scene: String,
    method: String,
    /// Probes of the grid and those that are on; nothing for patches.
    #[serde(skip_serializing_if = "Option::is_none")]
    probes: Option<(usize, usize)>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rays: Option<u32>,
    /// Median and longest light update, and of probes the lookup of all pixels.
    update: PassTimes,
    #[serde(skip_serializing_if = "Option::is_none")]
    lookup_ms: Option<f64>,
    build_s: f64,
    bytes: u64,
    /// Frames after a jump of the lights until a tenth of it is left; nothing if it never is.
    followed_after: Option<usize>,
    indirect: PictureErrors,
    #[serde(skip)]
    left: Vec<f64>,
    #[serde(skip)]
    picture: String,
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    machine: &'a Machine,
    seed: u32,
    size: (u32, u32),
    frames: u32,
    rows: &'a [Row],
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, "ddgi", &SCENES, &[COUNT])?;
    let mut rows: Vec<Row> = Vec::new();
    let mut sections = Vec::new();
    let results = |rows: &[Row]| {
        let (size, frames) = (args.size(), args.frames());
        output::json(&Results { name: "ddgi", machine: &machine, seed: common.seed, size, frames, rows })
    };
    for scene in scenes {
        let progress = Progress::new(common.quiet);
        let loaded = output::import(scene, &progress)?;
        let own = &loaded.scene.lighting.lights;
        let truth = Truth::traced(&loaded, own, args.size(), args.spp, common.seed, &progress)?;
        let folder = out.join(&loaded.name);
        output::make_folder(&folder)?;
        let measuring = Measuring::new(common, args, &loaded, &truth, &progress, folder);
        let first = rows.len();
        measuring.measure(counts[0] as usize, &mut |row| {
            rows.push(row);
            // What is known is kept when the rest fails or is stopped.
            output::write_text(&out.join("summary.json"), &results(&rows))
        })?;
        sections.push(measuring.section(&rows[first..])?);
        let line = format!("Measured on {}, {} threads.", machine.cpu, machine.threads);
        output::write_text(&out.join("report.html"), &page("Patchlight: patches and probes", &[line], &sections))?;
    }
    if common.json {
        say!("{}", results(&rows));
    } else {
        say!("{}", table(&rows).markdown());
        say!("{} shows the same with pictures", out.join("report.html").display());
    }
    Ok(())
}

struct Measuring<'a> {
    common: &'a Common,
    args: &'a Bench,
    loaded: &'a LoadedScene,
    truth: &'a Truth,
    progress: &'a Progress,
    folder: PathBuf,
    camera: Camera,
    /// What the pixels see.
    points: Vec<ViewedPoint>,
    /// Whether they see many backs of surfaces.
    two_sided: bool,
}

/// What frames of a method gave.
struct Frames {
    updates: Vec<f64>,
    lookups: Vec<f64>,
    /// Light from the last frame with other lights on.
    shown: Vec<Vec<Vec3>>,
}

impl<'a> Measuring<'a> {
    fn new(
        common: &'a Common,
        args: &'a Bench,
        loaded: &'a LoadedScene,
        truth: &'a Truth,
        progress: &'a Progress,
        folder: PathBuf,
    ) -> Self {
        let camera = loaded.view.camera(args.size().0, args.size().1);
        let tables = loaded.scene.tables();
        let (mut points, mut backs) = (Vec::new(), 0);
        for pixel in 0..camera.width * camera.height {
            let hit = primary_hit(&tables, &camera, pixel, 0);
            if hit.is_miss() {
                continue;
            }
            let direction = primary_direction(&camera, pixel, 0);
            let SurfacePoint { position, normal, .. } = surface_point(&tables, hit, direction);
            backs += usize::from(tables.normal(hit.triangle).dot(direction) > 0.0);
            points.push(ViewedPoint { position, normal, to_eye: -direction });
        }
        let two_sided = backs as f64 > BACKS * points.len() as f64;
        Self { common, args, loaded, truth, progress, folder, camera, points, two_sided }
    }

    fn measure(&self, count: usize, keep: &mut dyn FnMut(Row) -> Result<(), Error>) -> Result<(), Error> {
        let Self { common, args, loaded, progress, .. } = *self;
        let indirect = &self.truth.pictures.indirect;
        self.write_picture(REFERENCE, indirect)?;
        let settings = suited_settings(common, args, loaded, count);
        let start = Instant::now();
        let bake = Arc::new(Bake::build(&loaded.scene, &settings, progress)?);
        let bake_s = start.elapsed().as_secs_f64();
        let tiles = MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON });
        let temporal = MethodSettings::Temporal(TemporalSettings::default());
        for (name, method) in [("tiles 1 %", tiles), ("temporal", temporal)] {
            keep(self.patches(&bake, bake_s, name, method)?)?;
        }
        let (low, high) = loaded.scene.geometry.bounds;
        let share = ((high - low).max_element() / SMALL_SCENE).min(1.0);
        for &metres in &args.spacings {
            for &rays in &args.probe_rays {
                let spacing = Spacing::Metres(metres * share);
                let settings = DdgiSettings {
                    spacing,
                    rays,
                    two_sided: self.two_sided,
                    seed: common.seed,
                    ..DdgiSettings::default()
                };
                keep(self.probes(metres * share, settings)?)?;
            }
        }
        Ok(())
    }

    /// Lights of the frames whose times count; the first one makes memory ready.
    fn moving(&self) -> impl Iterator<Item = Lighting> + '_ {
        let frames = self.args.frames();
        let movement = Movement::new(self.loaded, (Animate::Sun, None), frames + 1, &Progress::new(true));
        (0..=frames).map(move |number| with_lights(&self.loaded.scene, &movement.at(number).0))
    }

    /// Other lights, and the scene's own.
    fn jump(&self) -> (Lighting, &Lighting) {
        let path = Animation::or_default_path(self.loaded);
        (with_lights(&self.loaded.scene, &path.at(path.duration() / 3.0).0), &self.loaded.scene.lighting)
    }

    /// A row of the project's own patches, what is in view.
    fn patches(&self, bake: &Arc<Bake>, bake_s: f64, name: &str, method: MethodSettings) -> Result<Row, Error> {
        let Self { common, args, loaded, .. } = self;
        let settings = RenderSettings {
            method,
            eye: loaded.view.eye,
            size: args.size(),
            sub_frames: args.sub_frames,
            receivers: ReceiverUpdate::InView,
            ..RenderSettings::default()
        };
        let start = Instant::now();
        let mut renderer = load(common, bake, &settings, &Progress::new(true))?;
        let build_s = bake_s + start.elapsed().as_secs_f64();
        let frames = self.patch_frames(&mut renderer)?;
        let picture = interruptible(|| renderer.picture(&loaded.scene.lighting, &self.camera, 0))?.pictures.indirect;
        let bytes = renderer.bytes().values().sum();
        self.row(name, Row { build_s, bytes, ..self.empty_row() }, &frames, &picture)
    }

    fn patch_frames(&self, renderer: &mut Renderer) -> Result<Frames, Error> {
        let mut frames = Frames { updates: Vec::new(), lookups: Vec::new(), shown: Vec::new() };
        for lighting in self.moving() {
            let start = Instant::now();
            let times = interruptible(|| renderer.advance(&lighting, &self.camera))?;
            frames.updates.push(1e3 * start.elapsed().as_secs_f64() - pass_ms(&times, PIXELS));
        }
        let (away, own) = self.jump();
        for frame in 0..AWAY + REST {
            interruptible(|| renderer.advance(if frame < AWAY { &away } else { own }, &self.camera))?;
            if frame + 1 >= AWAY {
                frames.shown.push(renderer.surface_irradiance()?);
            }
            cancelled()?;
        }
        Ok(frames)
    }

    /// A row of probes.
    fn probes(&self, metres: f32, settings: DdgiSettings) -> Result<Row, Error> {
        let start = Instant::now();
        let mut ddgi = Ddgi::new(&self.loaded.scene, settings)?;
        let build_s = start.elapsed().as_secs_f64();
        let frames = self.probe_frames(&mut ddgi)?;
        let picture = self.probe_picture(&ddgi)?;
        let (probes, rays) = (Some(ddgi.probe_counts()), Some(settings.rays));
        let row = Row { probes, rays, build_s, bytes: ddgi.bytes(), ..self.empty_row() };
        self.row(&format!("DDGI {metres:.2} m, {} rays", settings.rays), row, &frames, &picture)
    }

    fn probe_frames(&self, ddgi: &mut Ddgi) -> Result<Frames, Error> {
        let mut frames = Frames { updates: Vec::new(), lookups: Vec::new(), shown: Vec::new() };
        let mut number = 0;
        let mut update = |ddgi: &mut Ddgi, lighting: &Lighting| -> Result<f64, Error> {
            cancelled()?;
            let start = Instant::now();
            ddgi.update(lighting, number)?;
            number += 1;
            Ok(1e3 * start.elapsed().as_secs_f64())
        };
        for lighting in self.moving() {
            frames.updates.push(update(ddgi, &lighting)?);
            let start = Instant::now();
            std::hint::black_box(ddgi.irradiance_at(&self.points));
            frames.lookups.push(1e3 * start.elapsed().as_secs_f64());
        }
        let (away, own) = self.jump();
        for frame in 0..AWAY + REST {
            update(ddgi, if frame < AWAY { &away } else { own })?;
            if frame + 1 >= AWAY {
                frames.shown.push(ddgi.irradiance_at(&self.points));
            }
        }
        Ok(frames)
    }

    /// Indirect light of the pixels by the probes.
    fn probe_picture(&self, ddgi: &Ddgi) -> Result<Picture, Error> {
        let eye = self.camera.eye;
        let gather = |points: &[SurfacePoint], _: u32| {
            let viewed = |p: &SurfacePoint| {
                let to_eye = (eye - p.position).normalize_or_zero();
                ViewedPoint { position: p.position, normal: p.normal, to_eye }
            };
            let points: Vec<ViewedPoint> = points.iter().map(viewed).collect();
            Ok(ddgi.irradiance_at(&points).iter().map(|h| h.extend(0.0)).collect())
        };
        let pixels = PixelGather {
            scene: &self.loaded.scene,
            gather: &gather,
            lights: &self.loaded.scene.lighting.lights,
            camera: &self.camera,
            frame: 0,
            sub_frames: self.args.sub_frames,
            seed: self.common.seed,
        };
        Ok(pixels.indirect()?)
    }

    fn empty_row(&self) -> Row {
        Row {
            scene: self.loaded.name.clone(),
            method: String::new(),
            probes: None,
            rays: None,
            update: PassTimes { median_ms: 0.0, max_ms: 0.0 },
            lookup_ms: None,
            build_s: 0.0,
            bytes: 0,
            followed_after: None,
            indirect: PictureErrors {
                mse: 0.0,
                psnr_db: 0.0,
                ssim: 0.0,
                flip: 0.0,
                block_median_relative_error: 0.0,
                block_psnr_db: 0.0,
                mean_ratio: 0.0,
            },
            left: Vec::new(),
            picture: String::new(),
        }
    }

    /// Completes a row by what its frames and its picture are like.
    fn row(&self, name: &str, row: Row, frames: &Frames, picture: &Picture) -> Result<Row, Error> {
        let expected = &self.truth.pictures.indirect;
        let file: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
        self.write_picture(&file, picture)?;
        let left = left_of_jump(&frames.shown);
        let row = Row {
            method: name.to_owned(),
            update: PassTimes::of(&frames.updates[1..]).unwrap_or(row.update),
            lookup_ms: PassTimes::of(&frames.lookups).map(|times| times.median_ms),
            followed_after: followed_after(&left),
            indirect: compare_pictures(picture, expected, indirect_scale(expected), None)?,
            left,
            picture: file,
            ..row
        };
        self.progress.note(&format!(
            "{}: {name}: {:.2} ms, {:.2} dB, block error {:.2} %",
            row.scene,
            row.update.median_ms,
            row.indirect.psnr_db,
            100.0 * row.indirect.block_median_relative_error
        ));
        Ok(row)
    }

    fn write_picture(&self, name: &str, picture: &Picture) -> Result<(), Error> {
        let stops = scale_to_stops(indirect_scale(&self.truth.pictures.indirect));
        Ok(picture.write_png(&self.folder.join(format!("{name}.png")), stops)?)
    }

    fn section(&self, rows: &[Row]) -> Result<Section, Error> {
        let picture = |name: &str, caption: String| Figure::read(&self.folder, &format!("{name}.png"), caption);
        let mut figures = vec![picture(REFERENCE, "Indirect light, path traced".to_owned())?];
        for row in rows {
            let error = 100.0 * row.indirect.block_median_relative_error;
            let caption = format!("{}: {:.1} dB, blocks {error:.1} %", row.method, row.indirect.psnr_db);
            figures.push(picture(&row.picture, caption)?);
        }
        let line = |row: &Row| Series {
            name: row.method.clone(),
            points: row.left.iter().enumerate().skip(1).map(|(k, left)| (k as f64, left.max(1e-5))).collect(),
        };
        let sides = if self.two_sided { "; probes take surfaces as lit from both sides" } else { "" };
        Ok(Section {
            title: self.loaded.name.clone(),
            text: vec![format!("Compared with {}{sides}.", self.truth.source)],
            figures,

            tables: vec![table(rows)],
            plots: vec![Plot {
                title: "Distance from the light at rest after the lights jump".into(),
                unit: "share of the jump".into(),
                x: "frame".into(),
                logarithmic: true,
                series: rows.iter().map(line).collect(),
            }],
            ..Section::default()
        })
    }
}

fn cancelled() -> Result<(), Error> {
    if is_cancelled() { Err(Error::Cancelled) } else { Ok(()) }
}

/// Distances of the light of each frame from that of the last, over that of the first.
fn left_of_jump(shown: &[Vec<Vec3>]) -> Vec<f64> {
    let (Some(first), Some(last)) = (shown.first(), shown.last()) else { return Vec::new() };
    let whole = distance(first, last).max(f64::MIN_POSITIVE);
    shown.iter().map(|light| distance(light, last) / whole).collect()
}

/// The frame from which on no more than [`FOLLOWED`] is left.
fn followed_after(left: &[f64]) -> Option<usize> {
    let frame = left.iter().rposition(|&left| left > FOLLOWED).map_or(0, |last| last + 1);
    // The last frame is its own measure.
    (frame + 1 < left.len()).then_some(frame)
}

/// What was measured.
fn table(rows: &[Row]) -> Table {
    let head = [
        "scene",
        "method",
        "probes on / all",
        "update ms",
        "longest ms",
        "pixels ms",
        "build s",
        "MB",
        "frames to 90 %",
        "MSE",
        "PSNR dB",
        "SSIM",
        "FLIP",
        "block error %",
        "block PSNR dB",
        "mean ratio",
    ];
    let dash = || "–".to_owned();
    let cells = |row: &Row| {
        let e = &row.indirect;
        vec![
            row.scene.clone(),
            row.method.clone(),
            row.probes.map_or_else(dash, |(all, on)| format!("{on} / {all}")),
            format!("{:.2}", row.update.median_ms),
            format!("{:.2}", row.update.max_ms),
            row.lookup_ms.map_or_else(dash, |ms| format!("{ms:.2}")),
            format!("{:.1}", row.build_s),
            format!("{:.2}", row.bytes as f64 * 1e-6),
            row.followed_after.map_or_else(dash, |frame| frame.to_string()),
            format!("{:.5}", e.mse),
            format!("{:.2}", e.psnr_db),
            format!("{:.4}", e.ssim),
            format!("{:.4}", e.flip),
            format!("{:.2}", 100.0 * e.block_median_relative_error),
            format!("{:.2}", e.block_psnr_db),
            format!("{:.3}", e.mean_ratio),
        ]
    };
    Table {
        caption: "Whole light updates while lights move, memory, and indirect light at rest against path tracing"
            .into(),
        head: head.map(str::to_owned).to_vec(),
        rows: rows.iter().map(cells).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_followed_once_little_stays_left() {
        let shown: Vec<Vec<Vec3>> = [5.0, 3.0, 2.2, 3.5, 2.1, 2.0, 2.0].map(|h| vec![Vec3::splat(h)]).into();
        let left = left_of_jump(&shown);
        assert!((left[0] - 1.0).abs() < 1e-6 && (left[1] - 1.0 / 3.0).abs() < 1e-6);
        assert_eq!(followed_after(&left), Some(4));
        assert_eq!(followed_after(&[1.0, 0.5, 0.4, 0.0]), None);
    }
}
