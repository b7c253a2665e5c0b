//! `bench temporal`: light that is sampled beside exact products: time, memory, how fast it follows a jump of the
//! lights, noise at rest, and pictures against the reference.

use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;
use reference::PictureErrors;
use reference::metrics::{compare_pictures, indirect_scale};
use reference::stops_to_scale;
use serde::Serialize;
use temporal::{Blend, Settings};

use super::setup::{Machine, SCENES, Setup, bake_settings, load};
use super::truth::Truth;
use crate::args::{Bench, Common};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, interruptible, is_cancelled};
use crate::report::{Plot, Section, Series, Table, page};
use crate::sequence::{distance, flicker, pass_ms};
use crate::summary::PassTimes;
use assets::import::{Animation, LoadedScene};
use patchlight::light::with_lights;
use patchlight::method::temporal::{RowKind, Sampled};
use patchlight::method::{FeedbackSettings, TemporalSettings};
use patchlight::{Bake, LightSettings, MethodSettings, PictureRenderer, PictureSettings};

/// Patches of a scene, unless it is said.
const COUNT: u32 = 10_000;
/// Frames with other lights, and then with the scene's own.
const AWAY: u32 = 12;
const REST: u32 = 48;

/// Variants measured beside classic radiosity.
fn variants(epsilon: f64, seed: u32) -> Vec<(&'static str, MethodSettings)> {
    let default = Settings { seed, ..Settings::DEFAULT };
    let few = Settings { samples: 16, ..default };
    let many = Settings { samples: 200, ..default };
    let without = Settings { control_variate: false, ..default };
    let independent = Settings { rotated: false, ..without };
    let fixed = Settings { blend: Blend::Fixed(0.75), ..independent };
    let feedback = FeedbackSettings { epsilon, ..FeedbackSettings::default() };
    vec![
        ("feedback", MethodSettings::Feedback(feedback)),
        ("Q 16", temporal(few, RowKind::Lists, Sampled::Patches)),
        ("Q 64", temporal(Settings { samples: 64, ..default }, RowKind::Lists, Sampled::Patches)),
        ("Q 200", temporal(many, RowKind::Lists, Sampled::Patches)),
        ("Q 64, tables", temporal(default, RowKind::Tables, Sampled::Patches)),
        ("Q 64, no variate", temporal(without, RowKind::Lists, Sampled::Patches)),
        ("Q 64, no variate, no lattice", temporal(independent, RowKind::Lists, Sampled::Patches)),
        ("Q 64, as printed, w 0.75", temporal(fixed, RowKind::Tables, Sampled::Patches)),
        ("Q 16, all bounces", temporal(few, RowKind::AllBounces, Sampled::Patches)),
        ("Q 64, all bounces", temporal(default, RowKind::AllBounces, Sampled::Patches)),
        ("Q 16, all rows", temporal(few, RowKind::Lists, Sampled::All)),
        ("Q 64, all rows", temporal(default, RowKind::Lists, Sampled::All)),
        ("Q 64, all rows, no variate", temporal(without, RowKind::Lists, Sampled::All)),
    ]
}

fn temporal(settings: Settings, rows: RowKind, sampled: Sampled) -> MethodSettings {
    MethodSettings::Temporal(TemporalSettings { settings, rows, sampled })
}

/// A measurement.
#[derive(Clone, Serialize)]
struct Row {
    scene: String,
    method: String,
    device: String,
    patches: usize,
    receivers: usize,
    /// Median of the light between patches, and of its way to the receivers.
    median_ms: f64,
    lookup_ms: f64,
    /// Operators and tables that are multiplied by or sampled from: between patches, and to elements and receivers.
    bytes: u64,
    lookup_bytes: u64,
    /// Time of preparation that classic radiosity does not need.
    build_s: f64,
    /// Distance from the light at rest over that of the light before, so many frames after the jump.
    left_1: f64,
    left_8: f64,
    /// Relative L2 distance from exact light, and from the frame before, in the end; change of displayed values, 99.9th
    /// percentile.
    error: f64,
    change: f64,
    flicker_255: f64,
    full: PictureErrors,
    indirect: PictureErrors,
    #[serde(skip)]
    left: Vec<f64>,
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    machine: &'a Machine,
    seed: u32,
    rows: &'a [Row],
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, "temporal", &SCENES, &[COUNT])?;
    let mut rows: Vec<Row> = Vec::new();
    let results =
        |rows: &[Row]| output::json(&Results { name: "temporal", machine: &machine, seed: common.seed, rows });
    for scene in scenes {
        let progress = Progress::new(common.quiet);
        let loaded = output::import_flat(scene, &progress)?;
        let truth = match Truth::find(args.reference_folder(), &loaded)? {
            Some(truth) => truth,
            None => {
                Truth::traced(&loaded, &loaded.scene.lighting.lights, args.size(), args.spp, common.seed, &progress)?
            }
        };
        progress.note(&format!("compared with {}", truth.source));
        for &count in &counts {
            let measuring = Measuring { common, args, loaded: &loaded, truth: &truth };
            measuring.measure(count as usize, &progress, &mut |row| {
                rows.push(row);
                // What is known is kept when the rest fails or is stopped.
                Ok(output::write_text(&out.join("summary.json"), &results(&rows))?)
            })?;
            output::write_text(&out.join("report.html"), &report(&machine, &rows))?;
        }
    }
    if common.json {
        say!("{}", results(&rows));
    } else {
        tables(&rows).iter().for_each(|table| say!("{}", table.markdown()));
        say!("{} shows the same", out.join("report.html").display());
    }
    Ok(())
}

struct Measuring<'a> {
    common: &'a Common,
    args: &'a Bench,
    loaded: &'a LoadedScene,
    truth: &'a Truth,
}

impl Measuring<'_> {
    fn measure(
        &self,
        count: usize,
        progress: &Progress,
        keep: &mut dyn FnMut(Row) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let Self { common, args, loaded, .. } = self;
        let settings = bake_settings(common, args, loaded, count);
        let bake = Arc::new(Bake::build(&loaded.scene, &settings, progress)?);
        let (classic, exact) = self.variant(&bake, "classic", MethodSettings::Classic, None)?;
        keep(classic)?;
        for (name, method) in variants(args.epsilons.first().copied().unwrap_or(0.01), common.seed) {
            if is_cancelled() {
                return Err(shell::Error::Cancelled.into());
            }
            progress.note(&format!("{name}:"));
            keep(self.variant(&bake, name, method, Some(&exact))?.0)?;
        }
        Ok(())
    }

    /// A row, and the light at rest in the end.
    fn variant(
        &self,
        bake: &Arc<Bake>,
        name: &str,
        method: MethodSettings,
        exact: Option<&Vec<Vec3>>,
    ) -> Result<(Row, Vec<Vec3>), Error> {
        let Self { common, args, loaded, truth } = self;
        let progress = Progress::new(true);
        let light = LightSettings::default().with_method(method).with_eye(loaded.view.eye);
        let pictures = PictureSettings::default().with_size(truth.size()).with_sub_frames(args.sub_frames);
        let start = Instant::now();
        let mut light = load(common, bake, &light, &pictures, &progress)?;
        let load_s = start.elapsed().as_secs_f64();
        let frames = self.frames(&mut light)?;
        let last = frames.shown[REST as usize].clone();
        let exact = exact.unwrap_or(&last);
        let whole = distance(&frames.shown[0], exact).max(f64::MIN_POSITIVE);
        let left: Vec<f64> = frames.shown.iter().map(|light| distance(light, exact) / whole).collect();
        let before = &frames.shown[REST as usize - 1];
        let scale = stops_to_scale(loaded.exposure_stops);
        let camera = loaded.view.camera(truth.size().0, truth.size().1);
        let pictures = interruptible(|| light.picture(&loaded.scene.lighting, &camera, 0))?.pictures;
        let indirect_exposure = indirect_scale(&truth.pictures.indirect);
        let bytes = light.light().bytes();
        let bytes_of = |names: &[&str]| names.iter().filter_map(|name| bytes.get(*name)).sum();
        let row = Row {
            scene: loaded.name.clone(),
            method: name.to_owned(),
            device: light.light_mut().executor_mut().device().name.clone(),
            patches: bake.mesh().patches.len(),
            receivers: bake.receivers().points.len(),
            median_ms: median(&frames.method_ms),
            lookup_ms: median(&frames.lookup_ms),
            bytes: bytes_of(&["operator", "tables", "form_factors"]),
            lookup_bytes: bytes_of(&["elements", "receivers"]),
            build_s: match method {
                MethodSettings::Classic => 0.0,
                MethodSettings::Temporal(_) => progress.seconds("tables"),
                _ => load_s,
            },
            left_1: left[1],
            left_8: left[8],
            error: distance(&last, exact),
            change: distance(&last, before),
            flicker_255: flicker(&last, before, scale),
            full: compare_pictures(&pictures.full, &truth.pictures.full, scale, None)?,
            indirect: compare_pictures(&pictures.indirect, &truth.pictures.indirect, indirect_exposure, None)?,
            left,
        };
        Ok((row, last))
    }

    /// Frames with other lights, then with the scene's own.
    fn frames(&self, light: &mut PictureRenderer) -> Result<Frames, Error> {
        let loaded = self.loaded;
        let path = Animation::or_default_path(loaded);
        let away = with_lights(&loaded.scene, &path.at(path.duration() / 3.0).0);
        let camera = loaded.view.camera(self.truth.size().0, self.truth.size().1);
        let mut frames = Frames::default();
        for frame in 0..AWAY + REST {
            let lighting = if frame < AWAY { &away } else { &loaded.scene.lighting };
            let times = interruptible(|| light.advance(lighting, &camera))?;
            frames.method_ms.push(pass_ms(&times, "method"));
            frames.lookup_ms.push(pass_ms(&times, "lookup"));
            if frame + 1 >= AWAY {
                frames.shown.push(light.light_mut().surface_irradiance()?);
            }
        }
        Ok(frames)
    }
}

/// Times of frames, and the light from the last one with other lights on.
#[derive(Default)]
struct Frames {
    method_ms: Vec<f64>,
    lookup_ms: Vec<f64>,
    shown: Vec<Vec<Vec3>>,
}

fn median(times: &[f64]) -> f64 {
    PassTimes::of(times).map_or(0.0, |times| times.median_ms)
}

const LIGHT_HEAD: [&str; 12] = [
    "scene, patches",
    "method",
    "method ms",
    "lookup ms",
    "MB between patches",
    "MB elements, receivers",
    "build s",
    "left after 1 frame %",
    "after 8 %",
    "error at rest %",
    "change at rest %",
    "flicker /255",
];

const PICTURE_HEAD: [&str; 9] = [
    "scene, patches",
    "method",
    "MSE",
    "PSNR dB",
    "SSIM",
    "indirect PSNR dB",
    "indirect SSIM",
    "indirect block PSNR dB",
    "indirect block median %",
];

impl Row {
    fn light_cells(&self) -> Vec<String> {
        vec![
            format!("{} {}", self.scene, self.patches),
            self.method.clone(),
            format!("{:.2}", self.median_ms),
            format!("{:.2}", self.lookup_ms),
            megabytes(self.bytes),
            megabytes(self.lookup_bytes),
            format!("{:.2}", self.build_s),
            percent(self.left_1),
            percent(self.left_8),
            percent(self.error),
            percent(self.change),
            format!("{:.3}", self.flicker_255),
        ]
    }

    fn picture_cells(&self) -> Vec<String> {
        vec![
            format!("{} {}", self.scene, self.patches),
            self.method.clone(),
            format!("{:.5}", self.full.mse),
            format!("{:.2}", self.full.psnr_db),
            format!("{:.4}", self.full.ssim),
            format!("{:.2}", self.indirect.psnr_db),
            format!("{:.4}", self.indirect.ssim),
            format!("{:.2}", self.indirect.block_psnr_db),
            percent(self.indirect.block_median_relative_error),
        ]
    }
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1}", bytes as f64 * 1e-6)
}

fn percent(share: f64) -> String {
    format!("{:.2}", 100.0 * share)
}

fn tables(rows: &[Row]) -> [Table; 2] {
    let caption = "Time, memory, and light after the lights jump (relative L2 of the irradiance on surfaces, over that \
                   of the jump) and at rest; the error is that against classic radiosity, which is exact";
    [
        Table {
            caption: caption.into(),
            head: LIGHT_HEAD.map(String::from).to_vec(),
            rows: rows.iter().map(Row::light_cells).collect(),
        },
        Table {
            caption: "Pictures against path tracing".into(),
            head: PICTURE_HEAD.map(String::from).to_vec(),
            rows: rows.iter().map(Row::picture_cells).collect(),
        },
    ]
}

fn report(machine: &Machine, rows: &[Row]) -> String {
    let device = rows.first().map(|row| row.device.clone()).unwrap_or_default();
    let lines = [format!(
        "{}, {} threads, reading {:.1} GB/s out of caches; kernels on {device}.",
        machine.cpu, machine.threads, machine.stream_gb_s
    )];
    let mut names: Vec<(&String, usize)> = rows.iter().map(|row| (&row.scene, row.patches)).collect();
    names.dedup();
    let sections: Vec<Section> = names
        .into_iter()
        .map(|name| {
            let own: Vec<Row> = rows.iter().filter(|row| (&row.scene, row.patches) == name).cloned().collect();
            let line = |row: &Row| Series {
                name: row.method.clone(),
                points: row.left.iter().enumerate().skip(1).map(|(k, left)| (k as f64, left.max(1e-5))).collect(),
            };
            Section {
                title: format!("{}, {} patches, {} receivers", name.0, name.1, own[0].receivers),

                tables: tables(&own).to_vec(),
                plots: vec![Plot {
                    title: "Distance from the light at rest after the lights jump".into(),
                    unit: "share of the jump".into(),
                    x: "frame".into(),
                    logarithmic: true,
                    series: own.iter().skip(1).map(line).collect(),
                }],
                ..Section::default()
            }
        })
        .collect();
    page("Patchlight: temporal radiosity", &lines, &sections)
}
