//! `bench temporal`: light that is sampled beside exact products: time, memory, how fast it follows a jump of the lights, noise
//! at rest, and pictures against the reference.

use std::time::Instant;

use glam::Vec3;
use reference::PictureErrors;
use reference::metrics::{compare_pictures, indirect_scale};
use reference::stops_to_scale;
use serde::Serialize;
use temporal::{Blend, Settings};

use super::truth::Truth;
use super::{Machine, SCENES, Setup};
use crate::args::{Bench, Common};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, is_cancelled};
use crate::report::{Plot, Section, Series, Table, page};
use crate::sequence::{distance, flicker};
use assets::import::{Animation, LoadedScene};
use patchlight::render::classic::{Bake, ClassicSettings, Estimator, PatchKind};
use patchlight::render::operator::{Feedback, Transport};
use patchlight::render::temporal::{RowKind, Sampled, Temporal};
use runtime::executor::{DeviceChoice, open};

/// Patches of a scene, unless it is said.
const COUNT: u32 = 10_000;
/// Frames with other lights, and then with the scene's own.
const AWAY: u32 = 12;
const REST: u32 = 48;

/// What is measured beside classic radiosity.
fn variants(epsilon: f64, seed: u32) -> Vec<(String, Transport)> {
    let default = Settings { seed, ..Settings::DEFAULT };
    let without = Settings { control_variate: false, ..default };
    let temporal = |settings, rows, sampled| Transport::Temporal(Temporal { settings, rows, sampled });
    let (lists, tables) = (RowKind::Lists, RowKind::Tables);
    let mut all = vec![("feedback".to_owned(), Transport::Feedback(Feedback { epsilon, ..Feedback::default() }))];
    for samples in [16, 64, 200] {
        let settings = Settings { samples, ..default };
        all.push((format!("Q {samples}"), temporal(settings, lists, Sampled::Patches)));
    }
    let independent = Settings { rotated: false, ..without };
    let fixed = Settings { blend: Blend::Fixed(0.75), ..independent };
    let more = [
        ("Q 64, tables", temporal(default, tables, Sampled::Patches)),
        ("Q 64, no variate", temporal(without, lists, Sampled::Patches)),
        ("Q 64, no variate, no lattice", temporal(independent, lists, Sampled::Patches)),
        ("Q 64, as printed, w 0.75", temporal(fixed, tables, Sampled::Patches)),
        ("Q 16, all rows", temporal(Settings { samples: 16, ..default }, lists, Sampled::All)),
        ("Q 64, all rows", temporal(default, lists, Sampled::All)),
        ("Q 64, all rows, no variate", temporal(without, lists, Sampled::All)),
    ];
    all.extend(more.map(|(name, transport)| (name.to_owned(), transport)));
    all
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
    /// What is multiplied by or sampled from: between patches, and to facets and receivers.
    bytes: u64,
    lookup_bytes: u64,
    /// Of what classic radiosity does not need.
    build_s: f64,
    /// Distance from the light at rest over that of the light before, so many frames after the jump.
    left_1: f64,
    left_8: f64,
    /// Relative L2 distance from exact light, and from the frame before, in the end; change of displayed values, 99.9th percentile.
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
        let loaded = output::import(scene, &progress)?;
        let truth = match Truth::find(args.references.as_deref(), &loaded)? {
            Some(truth) => truth,
            None => Truth::traced(&loaded, &loaded.scene.lighting.lights, args.size, args.spp, common.seed, &progress)?,
        };
        progress.note(&format!("compared with {}", truth.source));
        for &count in &counts {
            let measuring = Measuring { common, args, loaded: &loaded, truth: &truth };
            measuring.measure(count as usize, &progress, &mut |row| {
                rows.push(row);
                // What is known is kept when the rest fails or is stopped.
                output::write_text(&out.join("summary.json"), &results(&rows))
            })?;
            output::write_text(&out.join("report.html"), &report(&machine, &rows))?;
        }
    }
    if common.json {
        println!("{}", results(&rows));
    } else {
        tables(&rows).iter().for_each(|table| println!("{}", table.markdown()));
        println!("{} shows the same", out.join("report.html").display());
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
        let Self { common, args, loaded, truth } = self;
        let settings = ClassicSettings {
            patches: PatchKind::suited(loaded.scene.geometry.triangles.len(), count),
            patch_count: count,
            estimator: Estimator::Hemisphere { rays: args.rays },
            receiver_rays: args.receiver_rays(),
            sub_frames: args.sub_frames,
            seed: common.seed,
            size: truth.size(),
            ..ClassicSettings::default()
        };
        let bake = Bake::new(&loaded.scene, loaded.view.eye, settings, progress)?;
        let classic = self.variant(&bake, "classic", Transport::Classic, None)?;
        let exact = classic.1;
        keep(classic.0)?;
        for (name, transport) in variants(args.epsilons.first().copied().unwrap_or(0.01), common.seed) {
            if is_cancelled() {
                return Err(Error::Cancelled);
            }
            progress.note(&format!("{name}:"));
            keep(self.variant(&bake, &name, transport, Some(&exact))?.0)?;
        }
        Ok(())
    }

    /// A row, and the light at rest in the end.
    fn variant(
        &self,
        bake: &Bake,
        name: &str,
        transport: Transport,
        exact: Option<&Vec<Vec3>>,
    ) -> Result<(Row, Vec<Vec3>), Error> {
        let Self { common, loaded, truth, .. } = self;
        let progress = Progress::new(true);
        let (executor, _) = open(&DeviceChoice::parse(&common.device))?;
        let device = executor.device().name.clone();
        let start = Instant::now();
        let mut light = bake.clone().load(transport, executor, &progress)?;
        let load_s = start.elapsed().as_secs_f64();
        let path = Animation::or_default_path(loaded);
        let (away, own) = (path.at(path.duration() / 3.0).0, loaded.scene.lighting.lights.clone());
        let (mut method, mut lookup) = (Vec::new(), Vec::new());
        let mut shown: Vec<Vec<Vec3>> = Vec::new();
        for frame in 0..AWAY + REST {
            let times = light.advance(if frame < AWAY { &away } else { &own })?;
            let of = |name: &str| times.iter().filter(|(n, _)| n == name).map(|(_, ms)| ms).sum::<f64>();
            method.push(of("method"));
            lookup.push(of("lookup"));
            if frame + 1 >= AWAY {
                shown.push(light.surface_irradiance()?);
            }
        }
        let last = shown[REST as usize].clone();
        let exact = exact.unwrap_or(&last);
        let whole = distance(&shown[0], exact).max(f64::MIN_POSITIVE);
        let left: Vec<f64> = shown.iter().map(|light| distance(light, exact) / whole).collect();
        let (before, scale) = (&shown[REST as usize - 1], stops_to_scale(loaded.exposure_stops));
        let (width, height) = truth.size();
        let pictures = light.frame(&own, &loaded.view.camera(width, height), 0)?.pictures;
        let indirect_exposure = indirect_scale(&truth.pictures.indirect);
        let bytes = light.bytes();
        let of = |names: &[&str]| names.iter().filter_map(|name| bytes.get(*name)).sum();
        let median = |times: &mut Vec<f64>| {
            times.sort_by(f64::total_cmp);
            times[times.len() / 2]
        };
        let row = Row {
            scene: loaded.name.clone(),
            method: name.to_owned(),
            device,
            patches: light.patch_count(),
            receivers: light.receiver_count(),
            median_ms: median(&mut method),
            lookup_ms: median(&mut lookup),
            bytes: of(&["operator", "tables", "form_factors"]),
            lookup_bytes: of(&["facets", "receivers"]),
            build_s: match transport {
                Transport::Classic => 0.0,
                Transport::Temporal(_) => progress.seconds("tables"),
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
}

fn tables(rows: &[Row]) -> [Table; 2] {
    let labelled = |row: &Row| vec![format!("{} {}", row.scene, row.patches), row.method.clone()];
    let megabytes = |bytes: u64| format!("{:.1}", bytes as f64 * 1e-6);
    let percent = |x: f64| format!("{:.2}", 100.0 * x);
    let light = |row: &Row| {
        let numbers = [
            format!("{:.2}", row.median_ms),
            format!("{:.2}", row.lookup_ms),
            megabytes(row.bytes),
            megabytes(row.lookup_bytes),
            format!("{:.2}", row.build_s),
            percent(row.left_1),
            percent(row.left_8),
            percent(row.error),
            percent(row.change),
            format!("{:.3}", row.flicker_255),
        ];
        [labelled(row), numbers.to_vec()].concat()
    };
    let head = [
        "scene, patches",
        "method",
        "method ms",
        "lookup ms",
        "MB between patches",
        "MB facets, receivers",
        "build s",
        "left after 1 frame %",
        "after 8 %",
        "error at rest %",
        "change at rest %",
        "flicker /255",
    ];
    let picture = |row: &Row| {
        let numbers = [
            format!("{:.5}", row.full.mse),
            format!("{:.2}", row.full.psnr_db),
            format!("{:.4}", row.full.ssim),
            format!("{:.2}", row.indirect.psnr_db),
            format!("{:.4}", row.indirect.ssim),
            format!("{:.2}", row.indirect.block_psnr_db),
            percent(row.indirect.block_median_relative_error),
        ];
        [labelled(row), numbers.to_vec()].concat()
    };
    let picture_head = [
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
    let own = |head: &[&str]| head.iter().map(|name| String::from(*name)).collect();
    let caption = "Time, memory, and light after the lights jump (relative L2 of the irradiance on surfaces, over that of the \
                   jump) and at rest; the error is that against classic radiosity, which is exact";
    [
        Table { caption: caption.into(), head: own(&head), rows: rows.iter().map(light).collect() },
        Table {
            caption: "Pictures against path tracing".into(),
            head: own(&picture_head),
            rows: rows.iter().map(picture).collect(),
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
                text: Vec::new(),
                figures: Vec::new(),
                strip: Vec::new(),
                tables: tables(&own).to_vec(),
                plots: vec![Plot {
                    title: "Distance from the light at rest after the lights jump".into(),
                    unit: "share of the jump".into(),
                    x: "frame".into(),
                    logarithmic: true,
                    series: own.iter().skip(1).map(line).collect(),
                }],
            }
        })
        .collect();
    page("Patchlight: temporal radiosity", &lines, &sections)
}
