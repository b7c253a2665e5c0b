//! `bench table3`: what is in view by tiles and sampled, beside every opponent on the same scene, lights, camera and rays: time of
//! a whole light update, memory, preparation, pictures and points against path tracing, and frames until a jump of the lights
//! is followed.
//!
//! Within a frame of moving lights the methods take turns, so that what else a machine does meets all of them alike.

mod contender;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use glam::{Vec3, Vec4};
use reference::metrics::{compare_points, indirect_scale};
use reference::{
    DdgiSettings, LpvSettings, Picture, PictureErrors, PictureFile, PointErrors, Spacing, ViewedPoint, VolumeSettings,
    scale_to_stops,
};
use scene::kernel::camera::{primary_direction, primary_hit, surface_point};
use scene::{Camera, Lighting, SurfacePoint};
use serde::{Deserialize, Serialize};

use super::all::smallest;
use super::truth::Truth;
use super::{Machine, Setup, load, suited_settings};
use crate::args::{Animate, Bench, Common};
use crate::date::today;
use crate::error::Error;
use crate::errors::picture_errors;
use crate::output;
use crate::progress::{Progress, is_cancelled};
use crate::report::{Figure, Plot, Section, Series, Table, page};
use crate::sequence::{Movement, distance};
use crate::summary::PassTimes;
use assets::import::{Animation, LoadedScene};
use contender::{Contender, FrameTime, OwnPatches, Paths, Time, Volumetric};
use patchlight::method::TemporalSettings;
use patchlight::operator::Codec;
use patchlight::renderer::with_lights;
use patchlight::{Bake, MethodSettings, Pictures, PixelGather};

/// Scenes, unless some are named.
const SCENES: [&str; 2] = ["cornell", "atrium"];
/// Patches of a scene, unless it is said.
const COUNT: u32 = 2000;
/// The project's own methods.
const OWN: [&str; 2] = ["tiles 1 %", "temporal"];
/// Relative error of the compressed operator.
const EPSILON: f64 = 0.01;
/// Frames with other lights, and then with the scene's own: enough for the hysteresis of probes.
const AWAY: u32 = 20;
const REST: u32 = 60;
/// Spacings are shares of this length in scenes that are smaller, m.
const SMALL_SCENE: f32 = 8.0;
/// Scenes that are smaller need no nested grids for light that is propagated, m.
const ONE_GRID: f32 = 40.0;
/// Cells along the longest axis of grids of light that is propagated.
const CELLS: [u32; 2] = [16, 32];
/// Scenes of which pixels see more backs of surfaces than this share are lit from both sides by opponents.
const BACKS: f64 = 0.01;
/// Light updates of a trial; the last one counts.
const TRIALS: u32 = 3;
/// What is left of the jump when it counts as followed.
const FOLLOWED: f64 = 0.1;
/// Name of the reference's picture, and of all pictures in one.
const REFERENCE: &str = "reference";
const SIDE_BY_SIDE: &str = "side-by-side";
/// Pictures in a row of that.
const COLUMNS: usize = 4;

/// What was measured of a method in a scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    pub scene: String,
    /// Kind of the method: a line of the plots.
    pub family: String,
    pub method: String,
    /// Patches, probes, cells or paths.
    pub size: String,
    /// Median and longest light update, and the median of the lookup of all pixels where that can be told apart, ms.
    pub update: PassTimes,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub lookup_ms: Option<f64>,
    /// Medians of both in time of all processors, ms.
    pub processor: ProcessorTime,
    pub build_s: f64,
    pub bytes: u64,
    /// Frames after a jump of the lights until a tenth of it is left; nothing if it never is.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub followed_after: Option<usize>,
    pub full: PictureErrors,
    pub indirect: PictureErrors,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub points: Option<PointErrors>,
    /// What is left of the jump after each frame; rounded, for a plot.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub left: Vec<f64>,
}

/// Medians of time of all processors, ms.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct ProcessorTime {
    pub update_ms: f64,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub lookup_ms: Option<f64>,
}

impl Row {
    /// Whether the method is the project's own.
    pub fn is_own(&self) -> bool {
        OWN.contains(&self.family.as_str())
    }
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    version: &'static str,
    date: String,
    machine: &'a Machine,
    device: &'a str,
    /// What else is to be known of the machine, as it was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    note: Option<&'a str>,
    seed: u32,
    size: (u32, u32),
    frames: u32,
    patches: u32,
    /// What pictures and points are compared with, a line for each scene.
    references: &'a [String],
    rows: &'a [Row],
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let smallest = if args.quick { Some(smallest(args.name, args, &PathBuf::new())) } else { None };
    let args = smallest.as_ref().unwrap_or(args);
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, "table3", &SCENES, &[COUNT])?;
    let mut rows: Vec<Row> = Vec::new();
    let mut references: Vec<String> = Vec::new();
    let mut sections = Vec::new();
    let results = |rows: &[Row], references: &[String]| {
        output::json(&Results {
            name: "table3",
            version: env!("CARGO_PKG_VERSION"),
            date: today(),
            machine: &machine,
            device: &common.device,
            note: args.note.as_deref(),
            seed: common.seed,
            size: args.size(),
            frames: args.frames(),
            patches: counts[0],
            references,
            rows,
        })
    };
    for scene in scenes {
        let progress = Progress::new(common.quiet);
        let loaded = output::import(scene, &progress)?;
        let truth = Truth::traced_with_points(&loaded, args.size(), args.spp, common.seed, &progress)?;
        let folder = out.join(&loaded.name);
        output::make_folder(&folder)?;
        let view = View::new(common, args, &loaded);
        references.push(format!("{}: {}", loaded.name, truth.source));
        let measuring = Measuring { view: &view, truth: &truth, progress: &progress, folder };
        let found = measuring.measure(counts[0] as usize)?;
        sections.push(measuring.section(&found)?);
        rows.extend(found);
        // What is known is kept when the rest fails or is stopped.
        output::write_text(&out.join("summary.json"), &results(&rows, &references))?;
        let line = format!("Measured on {}, {} threads.", machine.cpu, machine.threads);
        output::write_text(&out.join("report.html"), &page("Patchlight: every method", &[line], &sections))?;
    }
    if common.json {
        say!("{}", results(&rows, &references));
    } else {
        tables(&rows).iter().for_each(|table| say!("{}", table.markdown()));
        say!("{} shows the same with pictures", out.join("report.html").display());
    }
    Ok(())
}

/// Irradiance at what pixels see, W/m².
type Gather<'a> = dyn Fn(&[SurfacePoint], u32) -> Result<Vec<Vec4>, patchlight::Error> + Sync + 'a;

/// What is seen of a scene.
pub struct View<'a> {
    pub common: &'a Common,
    pub args: &'a Bench,
    pub loaded: &'a LoadedScene,
    pub camera: Camera,
    /// What the pixels see.
    pub points: Vec<ViewedPoint>,
    /// Whether they see many backs of surfaces.
    pub two_sided: bool,
}

impl<'a> View<'a> {
    fn new(common: &'a Common, args: &'a Bench, loaded: &'a LoadedScene) -> Self {
        let camera = loaded.view.camera(args.size().0, args.size().1);
        let tables = loaded.scene.tables();
        let mut points = Vec::new();
        let mut backs = 0;
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
        Self { common, args, loaded, camera, points, two_sided }
    }

    /// A point as the eye sees it.
    pub fn viewed(&self, p: &SurfacePoint) -> ViewedPoint {
        let to_eye = (self.camera.eye - p.position).normalize_or_zero();
        ViewedPoint { position: p.position, normal: p.normal, to_eye }
    }

    /// Indirect radiance of the pixels from irradiance at what they see.
    pub fn gathered(&self, gather: &Gather) -> Result<Picture, Error> {
        let pixels = PixelGather {
            scene: &self.loaded.scene,
            gather,
            lights: &self.loaded.scene.lighting.lights,
            camera: &self.camera,
            frame: 0,
            sub_frames: self.args.sub_frames,
            seed: self.common.seed,
        };
        Ok(pixels.indirect()?)
    }

    /// Pictures of indirect light and of what lights send straight.
    pub fn with_direct(&self, indirect: Picture, direct: Option<&Picture>) -> Result<Pictures, Error> {
        let direct = direct.cloned().unwrap_or_else(|| Picture::new(indirect.width, indirect.height));
        let full = direct.plus(&indirect).map_err(reference::Error::from)?;
        Ok(Pictures { full, direct, indirect })
    }

    /// Share of lengths for scenes that are smaller.
    fn share(&self) -> f32 {
        (self.longest() / SMALL_SCENE).min(1.0)
    }

    fn longest(&self) -> f32 {
        let (low, high) = self.loaded.scene.geometry.bounds;
        (high - low).max_element()
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
}

struct Measuring<'a> {
    view: &'a View<'a>,
    truth: &'a Truth,
    progress: &'a Progress,
    folder: PathBuf,
}

impl<'a> Measuring<'a> {
    /// Rows of all methods; pictures are written on the way.
    fn measure(&self, patches: usize) -> Result<Vec<Row>, Error> {
        self.write_picture(REFERENCE, &self.truth.pictures.indirect)?;
        let mut contenders = self.contenders(patches)?;
        let times = self.times(&mut contenders)?;
        let mut direct = None;
        let mut rows = Vec::new();
        for (contender, times) in contenders.iter_mut().zip(times) {
            let row = self.row(contender.as_mut(), &times, &mut direct)?;
            self.progress.note(&format!(
                "{}: {}: {:.2} ms, {:.2} dB, block error {:.2} %",
                row.scene,
                row.method,
                row.processor.update_ms,
                row.indirect.psnr_db,
                100.0 * row.indirect.block_median_relative_error
            ));
            rows.push(row);
        }
        self.write_side_by_side(&rows)?;
        Ok(rows)
    }

    /// Everybody who takes part: those with the time of the project's own take what a trial frame of theirs tells.
    fn contenders(&self, patches: usize) -> Result<Vec<Box<dyn Contender + 'a>>, Error> {
        let View { common, args, loaded, .. } = *self.view;
        let start = Instant::now();
        let bake = Bake::build(&loaded.scene, &suited_settings(common, args, loaded, patches), self.progress)?;
        let bake = Arc::new(bake);
        let bake_s = start.elapsed().as_secs_f64();
        let tiles = MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON });
        let temporal = MethodSettings::Temporal(TemporalSettings::default());
        let mut tiles = OwnPatches::new(self.view, &bake, bake_s, OWN[0], tiles)?;
        let temporal = OwnPatches::new(self.view, &bake, bake_s, OWN[1], temporal)?;
        let own_ms = self.trial(&mut tiles)?;
        let mut list: Vec<Box<dyn Contender + 'a>> = vec![Box::new(tiles), Box::new(temporal)];
        self.add_probes(own_ms, &mut list)?;
        self.add_volumes(&mut list)?;
        let one_ms = self.trial(&mut Paths::new(self.view, 1, false)?)?;
        let equal = ((own_ms / one_ms) as u32).max(1);
        for is_denoised in [false, true] {
            list.push(Box::new(Paths::new(self.view, equal, is_denoised)?));
        }
        for is_denoised in [false, true] {
            list.push(Box::new(Paths::new(self.view, 8 * equal, is_denoised)?));
        }
        Ok(list)
    }

    /// DDGI at all spacings and numbers of rays, and as many probes as take the time of the project's own.
    fn add_probes(&self, own_ms: f64, list: &mut Vec<Box<dyn Contender + 'a>>) -> Result<(), Error> {
        let View { common, args, two_sided, .. } = *self.view;
        let settings =
            |spacing, rays| DdgiSettings { spacing, rays, two_sided, seed: common.seed, ..Default::default() };
        for &metres in &args.spacings {
            for &rays in &args.probe_rays {
                let spacing = Spacing::Metres(metres * self.view.share());
                list.push(Box::new(Volumetric::ddgi(self.view, settings(spacing, rays), "")?));
            }
        }
        let (Some(&metres), Some(&rays)) = (args.spacings.first(), args.probe_rays.first()) else { return Ok(()) };
        let tried = settings(Spacing::Metres(metres * self.view.share()), rays);
        let mut trial = Volumetric::ddgi(self.view, tried, "")?;
        let ms = self.trial(&mut trial)?;
        let probes = (trial.probe_count() as f64 * own_ms / ms.max(1e-3)).clamp(8.0, f64::from(1 << 15));
        let equal = settings(Spacing::Probes(probes as u32), rays);
        list.push(Box::new(Volumetric::ddgi(self.view, equal, ", time of tiles")?));
        Ok(())
    }

    fn add_volumes(&self, list: &mut Vec<Box<dyn Contender + 'a>>) -> Result<(), Error> {
        let View { common, args, two_sided, .. } = *self.view;
        let eye = self.view.camera.eye;
        let cascades = if self.view.longest() < ONE_GRID { 1 } else { 3 };
        for cells in CELLS {
            let settings = LpvSettings { cells, cascades, eye, steps: 2 * cells, two_sided, ..LpvSettings::default() };
            list.push(Box::new(Volumetric::lpv(self.view, settings)?));
        }
        let finest = args.spacings.iter().copied().fold(f32::INFINITY, f32::min);
        for bands in [1, 2] {
            let spacing = Spacing::Metres(finest * self.view.share());
            let settings = VolumeSettings { spacing, bands, two_sided, seed: common.seed, ..VolumeSettings::default() };
            list.push(Box::new(Volumetric::baked(self.view, settings)?));
        }
        Ok(())
    }

    /// Processor time of a light update after another, ms. Lights move in between: what rests is kept, and takes no time.
    fn trial(&self, contender: &mut dyn Contender) -> Result<f64, Error> {
        let mut last = 0.0;
        for (number, lighting) in (0..TRIALS).zip(self.view.moving()) {
            last = contender.frame(&lighting, number)?.update.processor;
            cancelled()?;
        }
        Ok(last)
    }

    /// Times of all frames of all methods, which take turns; without the first frame.
    fn times(&self, contenders: &mut [Box<dyn Contender + 'a>]) -> Result<Vec<Vec<FrameTime>>, Error> {
        let mut times = vec![Vec::new(); contenders.len()];
        self.progress
            .phase("light updates", |report| {
                for (number, lighting) in (0..).zip(self.view.moving()) {
                    for (contender, times) in contenders.iter_mut().zip(&mut times) {
                        let time = contender.frame(&lighting, number)?;
                        if number > 0 {
                            times.push(time);
                        }
                        cancelled()?;
                    }
                    let _ = report(number as usize + 1, self.view.args.frames() as usize + 1);
                }
                Ok(())
            })
            .map(|()| times)
    }

    /// Light of the last frame with other lights, and of all after it.
    fn shown(&self, contender: &mut dyn Contender) -> Result<Vec<Vec<Vec3>>, Error> {
        let (away, own) = self.view.jump();
        let (away_frames, rest_frames) = match (contender.remembers(), self.view.args.quick) {
            (false, _) => (1, 2),
            (true, true) => (AWAY / 4, REST / 4),
            (true, false) => (AWAY, REST),
        };
        let first = self.view.args.frames() + 1;
        let mut shown = Vec::new();
        for frame in 0..away_frames + rest_frames {
            contender.frame(if frame < away_frames { &away } else { own }, first + frame)?;
            if frame + 1 >= away_frames {
                shown.push(contender.light()?);
            }
            cancelled()?;
        }
        Ok(shown)
    }

    /// What a method's frames and pictures are like. The direct light of the first is that of all.
    fn row(
        &self,
        contender: &mut dyn Contender,
        times: &[FrameTime],
        direct: &mut Option<Picture>,
    ) -> Result<Row, Error> {
        let left = left_of_jump(&self.shown(contender)?);
        let pictures = contender.pictures(direct.as_ref())?;
        self.write_picture(&file_name(&contender.name()), &pictures.indirect)?;
        let (full, indirect) = picture_errors(&pictures, &self.truth.pictures, self.view.loaded.exposure_stops)?;
        direct.get_or_insert(pictures.direct);
        let points = contender.at_points(&self.truth.points)?;
        let points = points.map(|found| compare_points(&found, &self.truth.point_indirect)).transpose()?;
        let updates: Vec<Time> = times.iter().map(|time| time.update).collect();
        let lookups: Vec<Time> = times.iter().filter_map(|time| time.lookup).collect();
        let none = PassTimes { median_ms: 0.0, max_ms: 0.0 };
        let wall = |times: &[Time]| PassTimes::of(&times.iter().map(|time| time.wall).collect::<Vec<_>>());
        let processor = |times: &[Time]| PassTimes::of(&times.iter().map(|time| time.processor).collect::<Vec<_>>());
        // What remembers nothing has followed once it is asked again, up to its noise.
        let followed = if contender.remembers() { followed_after(&left) } else { Some(1) };
        Ok(Row {
            scene: self.view.loaded.name.clone(),
            family: contender.family().to_owned(),
            method: contender.name(),
            size: contender.size(),
            update: wall(&updates).unwrap_or(none),
            lookup_ms: wall(&lookups).map(|times| times.median_ms),
            processor: ProcessorTime {
                update_ms: processor(&updates).unwrap_or(none).median_ms,
                lookup_ms: processor(&lookups).map(|times| times.median_ms),
            },
            build_s: contender.build_s(),
            bytes: contender.bytes(),
            followed_after: followed,
            full,
            indirect,
            points,
            left: if contender.remembers() { left.iter().map(|&left| rounded(left)).collect() } else { Vec::new() },
        })
    }

    fn write_picture(&self, name: &str, picture: &Picture) -> Result<(), Error> {
        let stops = scale_to_stops(indirect_scale(&self.truth.pictures.indirect));
        Ok(picture.write_png(&self.folder.join(format!("{name}.png")), stops)?)
    }

    /// All pictures in one, in the order of the table, the reference first.
    fn write_side_by_side(&self, rows: &[Row]) -> Result<(), Error> {
        let names = std::iter::once(REFERENCE.to_owned()).chain(rows.iter().map(|row| file_name(&row.method)));
        let read = |name: String| Picture::read(&self.folder.join(format!("{name}.png")));
        let pictures = names.map(read).collect::<Result<Vec<_>, _>>()?;
        let (width, height) = (self.view.camera.width as usize, self.view.camera.height as usize);
        let lines = pictures.len().div_ceil(COLUMNS);
        let mut all = Picture::new((COLUMNS * width) as u32, (lines * height) as u32);
        for (number, picture) in pictures.iter().enumerate() {
            let corner = (number / COLUMNS) * height * COLUMNS * width + number % COLUMNS * width;
            for (y, row) in picture.pixels.chunks(width).enumerate() {
                all.pixels[corner + y * COLUMNS * width..][..width].copy_from_slice(row);
            }
        }
        Ok(all.write_png(&self.folder.join(format!("{SIDE_BY_SIDE}.png")), 0.0)?)
    }

    fn section(&self, rows: &[Row]) -> Result<Section, Error> {
        let picture = |name: &str, caption: String| Figure::read(&self.folder, &format!("{name}.png"), caption);
        let mut figures = vec![picture(REFERENCE, "Indirect light, path traced".to_owned())?];
        for row in rows {
            let error = 100.0 * row.indirect.block_median_relative_error;
            let caption = format!("{}: {:.1} dB, blocks {error:.1} %", row.method, row.indirect.psnr_db);
            figures.push(picture(&file_name(&row.method), caption)?);
        }
        let sides = if self.view.two_sided { "; opponents take surfaces as lit from both sides" } else { "" };
        Ok(Section {
            title: self.view.loaded.name.clone(),
            text: vec![format!("Compared with {}{sides}.", self.truth.source)],
            figures,
            tables: tables(rows).to_vec(),
            plots: vec![error_plot(rows), jump_plot(rows)],
            ..Section::default()
        })
    }
}

fn file_name(method: &str) -> String {
    method.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect()
}

fn cancelled() -> Result<(), Error> {
    if is_cancelled() { Err(Error::Cancelled) } else { Ok(()) }
}

/// Four digits after the point.
fn rounded(x: f64) -> f64 {
    (x * 1e4).round() * 1e-4
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

/// Error of the indirect picture over the time of an update, a line for each kind of method.
pub fn error_plot(rows: &[Row]) -> Plot {
    let mut series: Vec<Series> = Vec::new();
    for row in rows {
        let point = (row.processor.update_ms, 100.0 * row.indirect.block_median_relative_error);
        match series.iter_mut().find(|line| line.name == row.family) {
            Some(line) => line.points.push(point),
            None => series.push(Series { name: row.family.clone(), points: vec![point] }),
        }
    }
    series.iter_mut().for_each(|line| line.points.sort_by(|a, b| a.0.total_cmp(&b.0)));
    Plot {
        title: "Median error of 8 × 8 blocks of indirect light".into(),
        unit: "%".into(),
        x: "ms of processor time".into(),
        logarithmic: true,
        series,
    }
}

/// What is left of a jump of the lights over the frames after it.
pub fn jump_plot(rows: &[Row]) -> Plot {
    let line = |row: &Row| Series {
        name: row.method.clone(),
        points: row.left.iter().enumerate().skip(1).map(|(k, left)| (k as f64, left.max(1e-4))).collect(),
    };
    Plot {
        title: "Distance from the light at rest after the lights jump".into(),
        unit: "share of the jump".into(),
        x: "frame".into(),
        logarithmic: true,
        series: rows.iter().filter(|row| !row.left.is_empty()).map(line).collect(),
    }
}

/// Times and memory, and errors.
pub fn tables(rows: &[Row]) -> [Table; 2] {
    let dash = || "–".to_owned();
    let costs = |row: &Row| {
        vec![
            row.scene.clone(),
            row.method.clone(),
            row.size.clone(),
            format!("{:.2}", row.update.median_ms),
            format!("{:.2}", row.update.max_ms),
            row.lookup_ms.map_or_else(dash, |ms| format!("{ms:.2}")),
            format!("{:.2}", row.processor.update_ms),
            row.processor.lookup_ms.map_or_else(dash, |ms| format!("{ms:.2}")),
            format!("{:.1}", row.build_s),
            format!("{:.2}", row.bytes as f64 * 1e-6),
            row.followed_after.map_or_else(|| "never".to_owned(), |frame| frame.to_string()),
        ]
    };
    let errors = |row: &Row| {
        let e = &row.indirect;
        vec![
            row.scene.clone(),
            row.method.clone(),
            format!("{:.5}", e.mse),
            format!("{:.2}", e.psnr_db),
            format!("{:.4}", e.ssim),
            format!("{:.4}", e.flip),
            format!("{:.2}", 100.0 * e.block_median_relative_error),
            format!("{:.2}", e.block_psnr_db),
            format!("{:.3}", e.mean_ratio),
            format!("{:.5}", row.full.mse),
            format!("{:.2}", row.full.psnr_db),
            format!("{:.4}", row.full.ssim),
            format!("{:.4}", row.full.flip),
            row.points.map_or_else(dash, |p| format!("{:.2}", 100.0 * p.median_relative_error)),
            row.points.map_or_else(dash, |p| format!("{:.1}", 100.0 * p.p95_relative_error)),
        ]
    };
    let cost_head = [
        "scene",
        "method",
        "size",
        "update ms",
        "longest ms",
        "pixels ms",
        "processor ms",
        "pixels, processor ms",
        "build s",
        "MB",
        "frames to 90 %",
    ];
    let error_head = [
        "scene",
        "method",
        "MSE",
        "PSNR dB",
        "SSIM",
        "FLIP",
        "block error %",
        "block PSNR dB",
        "mean ratio",
        "MSE, all light",
        "PSNR, all light",
        "SSIM, all light",
        "FLIP, all light",
        "points: median %",
        "95th %",
    ];
    [
        Table {
            caption: "Whole light updates while lights move, memory, and frames until a jump of the lights is followed"
                .into(),
            head: cost_head.map(str::to_owned).to_vec(),
            rows: rows.iter().map(costs).collect(),
        },
        Table {
            caption: "Indirect light at rest against path tracing, then all light, then indirect irradiance at points"
                .into(),
            head: error_head.map(str::to_owned).to_vec(),
            rows: rows.iter().map(errors).collect(),
        },
    ]
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
