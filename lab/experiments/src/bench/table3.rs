//! `bench table3`: every method and every opponent on the same scene, lights, camera and rays: time of a whole light
//! update, memory, preparation, pictures and points against path tracing.

use reference::metrics::{compare_points, indirect_scale};
use reference::{Picture, PictureErrors, PictureFile as _, PointErrors, scale_to_stops};
use serde::{Deserialize, Serialize};

use super::contest::field::Field;
use super::contest::{UpdateTimes, View, Who, errors, lightings_of, pictures_at_rest, side_by_side, take_turns};
use super::setup::bake_settings;
use super::study::{Measured, Place, SIDE_BY_SIDE, SceneRows, Study, file_name};
use super::truth::Truth;
use crate::error::Error;
use crate::report::{Figure, Plot, Section, Series, Table, significant};
use assets::import::LoadedScene;

/// Name of the reference's picture.
const REFERENCE: &str = "reference";
/// Family of the opponent that is named where it is nearest.
pub const NEAREST: &str = "DDGI";

/// Measurements of a method in a scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    #[serde(flatten)]
    pub who: Who,
    #[serde(flatten)]
    pub times: UpdateTimes,
    pub full: PictureErrors,
    pub indirect: PictureErrors,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub points: Option<PointErrors>,
}

/// The experiment.
pub struct Table3;

impl Study for Table3 {
    type Row = Row;
    const NAME: &'static str = "table3";
    const TITLE: &'static str = "Every method beside each other";
    const ABOUT: &'static str = "An update goes from lights that moved to irradiance: at the points in view for \
        patches, in the volume for probes, cells and faces of voxels, whose lookup at all pixels is in its own \
        column; what pixels of patches take from points is in no column. Methods take turns; a turn is two light \
        updates, of which the second counts. Processor time is that of all cores together, in which what else the \
        machine did is hardly seen; where it was busy, believe that. Path tracing has no update: its time is that of \
        the picture. All methods share direct light, rays and their hierarchy. Memory is what light needs from frame \
        to frame; that of probes and cells is in their authors' formats. A volume that engines bake is baked anew \
        when a light moves. Small tiles and small temporal have a sixth of the patches, and with them of elements and \
        receivers, and a quarter of the rays of each. Gathering (sparse rows, a product a bounce), the dense product \
        (the operator of all bounces, read once an update), shooting (progressive refinement) and Monte Carlo \
        radiosity (stochastic Jacobi, 100 samples a patch) are baselines on the same patches as tiles and temporal; \
        hierarchical radiosity has polygons, and finds its links anew with the light of each update. Updates of a \
        second and more are measured three times. With a Vulkan device, methods of patches and DDGI run on it, the \
        other opponents on the CPU; of a graphics processor's work, processor time knows nothing: believe the \
        update's there.";
    const SCENES: &'static [&'static str] = &["cornell", "office"];
    const SHARED: &'static [&'static str] = &["cornell-dragon", "bathroom", "sponza"];
    const TIMED: bool = true;
    const SHOWN: &'static [&'static str] = &["cornell", "office"];

    fn measure(place: &Place, loaded: &LoadedScene) -> Result<Measured<Row>, Error> {
        let Place { common, args, progress, .. } = *place;
        let truth = Truth::traced_with_points(loaded, args.size(), args.spp, common.seed, progress)?;
        let view = View::new(common, args, loaded);
        let stops = scale_to_stops(indirect_scale(&truth.pictures.indirect));
        let file = |name: &str| place.folder.join(format!("{}.png", file_name(name)));
        truth.pictures.indirect.write_png(&file(REFERENCE), stops)?;
        let field = Field::new(&view, &bake_settings(common, args, loaded, place.patches), progress)?;
        let (mut contenders, left_out) = field.all()?;
        let lightings = view.moving(lightings_of(args.frames()));
        let times = take_turns(&mut contenders, &lightings, progress)?;
        let mut direct = None;
        let mut rows = Vec::new();
        for (contender, times) in contenders.iter_mut().zip(times) {
            let pictures = pictures_at_rest(&view, contender.as_mut(), lightings.len() as u32, &mut direct)?;
            pictures.indirect.write_png(&file(&contender.name()), stops)?;
            let (full, indirect) = errors(&view, &pictures, &truth)?;
            let found = contender.at_points(&truth.points)?;
            let points = found.map(|found| compare_points(&found, &truth.point_indirect)).transpose()?;
            let row = Row { who: Who::of(contender.as_ref()), times, full, indirect, points };
            progress.note(&format!("{}: {}", loaded.name, caption(&row)));
            rows.push(row);
        }
        let mut names = vec![REFERENCE.to_owned()];
        names.extend(rows.iter().map(|row| row.who.method.clone()));
        let read = |name: &String| Picture::read(&file(name));
        let pictures = names.iter().map(read).collect::<Result<Vec<_>, _>>()?;
        side_by_side(&pictures, &place.folder.join(SIDE_BY_SIDE), 0.0)?;
        let captions = std::iter::once("Indirect light, path traced".to_owned()).chain(rows.iter().map(caption));
        let figures = names
            .iter()
            .zip(captions)
            .map(|(name, caption)| Figure::read(&place.folder, &format!("{}.png", file_name(name)), caption))
            .collect::<Result<Vec<_>, _>>()?;
        let sides = if view.two_sided { "; opponents take surfaces as lit from both sides" } else { "" };
        Ok(Measured { rows, reference: Some(format!("{}{sides}", truth.source)), figures, shown: names, left_out })
    }

    fn sections(scenes: &[SceneRows<Row>]) -> Vec<Section> {
        let section = |scene: &SceneRows<Row>| Section {
            title: scene.scene.clone(),
            text: nearest(&scene.rows),
            tables: tables(scene),
            plots: vec![error_plot(&scene.rows)],
            ..Section::default()
        };
        scenes.iter().map(section).collect()
    }
}

fn caption(row: &Row) -> String {
    format!(
        "{}: {:.1} dB, blocks {:.1} %, {:.1} ms",
        row.who.method,
        row.indirect.psnr_db,
        100.0 * row.indirect.block_median_relative_error,
        row.times.processor.median_ms
    )
}

/// The settings of DDGI that are nearest to tiles in time and in memory.
fn nearest(rows: &[Row]) -> Vec<String> {
    let Some(own) = rows.iter().find(|row| row.who.is_own()) else { return Vec::new() };
    let nearest = |what: &str, unit: &str, measure: fn(&Row) -> f64| {
        let distance = |row: &Row| (measure(row) / measure(own)).ln().abs();
        let opponents = rows.iter().filter(|row| row.who.family == NEAREST);
        let row = opponents.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        Some(format!(
            "Nearest to {} in {what} ({} {unit}) is {} ({} {unit}): blocks {:.2} and {:.2} %, PSNR of indirect light \
             {:.2} and {:.2} dB.",
            own.who.method,
            significant(measure(own)),
            row.who.method,
            significant(measure(row)),
            100.0 * own.indirect.block_median_relative_error,
            100.0 * row.indirect.block_median_relative_error,
            own.indirect.psnr_db,
            row.indirect.psnr_db
        ))
    };
    let by_time = nearest("time", "ms of processor time", |row| row.times.processor.median_ms);
    let by_memory = nearest("memory", "MB", |row| row.who.megabytes());
    by_time.into_iter().chain(by_memory).collect()
}

/// Error of the indirect picture over the time of an update, a line for each kind of method.
fn error_plot(rows: &[Row]) -> Plot {
    let mut series: Vec<Series> = Vec::new();
    for row in rows {
        let point = (row.times.processor.median_ms, 100.0 * row.indirect.block_median_relative_error);
        match series.iter_mut().find(|line| line.name == row.who.family) {
            Some(line) => line.points.push(point),
            None => series.push(Series { name: row.who.family.clone(), points: vec![point] }),
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

const COST_HEAD: [&str; 9] = [
    "method",
    "size",
    "memory MB",
    "processor ms",
    "longest",
    "pixels, processor ms",
    "update ms",
    "pixels ms",
    "build s",
];

const ERROR_HEAD: [&str; 14] = [
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

/// Times and memory, errors, and light between patches where an operator is read once.
fn tables(scene: &SceneRows<Row>) -> Vec<Table> {
    let mut tables = costs_and_errors(&scene.rows).to_vec();
    tables.extend(bandwidth(scene));
    tables
}

/// Bytes that products with operators read, and the least time to read them once.
fn bandwidth(scene: &SceneRows<Row>) -> Option<Table> {
    let stream = scene.circumstances.machine.stream_gb_s;
    let line = |row: &Row| {
        let bytes = row.who.operator_bytes? as f64;
        let ms = row.times.method_ms.filter(|ms| *ms > 0.0)?;
        let floor = 1e-6 * bytes / stream;
        let cells = [1e-6 * bytes, floor, ms, 1e-6 * bytes / ms].map(significant);
        let share = format!("{:.0}", 100.0 * floor / ms);
        Some([std::slice::from_ref(&row.who.method), &cells, &[share]].concat())
    };
    let rows: Vec<_> = scene.rows.iter().filter_map(line).collect();
    let head =
        ["method", "operator MB", "ms to read it once", "light between patches ms", "GB/s", "% of the bandwidth"];
    (!rows.is_empty()).then(|| Table {
        caption:
            "Light between patches alone, where it reads an operator once; more than the bandwidth is that of caches"
                .into(),
        head: head.map(str::to_owned).to_vec(),
        rows,
    })
}

fn costs_and_errors(rows: &[Row]) -> [Table; 2] {
    let or_dash = |ms: Option<f64>| ms.map_or_else(|| "–".to_owned(), |ms| format!("{ms:.2}"));
    let costs = |row: &Row| {
        let UpdateTimes { update, lookup_ms, processor, processor_lookup_ms, .. } = row.times;
        vec![
            row.who.method.clone(),
            row.who.size.clone(),
            significant(row.who.megabytes()),
            format!("{:.2}", processor.median_ms),
            format!("{:.2}", processor.max_ms),
            or_dash(processor_lookup_ms),
            format!("{:.2}", update.median_ms),
            or_dash(lookup_ms),
            format!("{:.1}", row.who.build_s),
        ]
    };
    let errors = |row: &Row| {
        let e = &row.indirect;
        vec![
            row.who.method.clone(),
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
            or_dash(row.points.map(|p| 100.0 * p.median_relative_error)),
            or_dash(row.points.map(|p| 100.0 * p.p95_relative_error)),
        ]
    };
    [
        Table {
            caption: "Whole light updates while lights move, and memory".into(),
            head: COST_HEAD.map(str::to_owned).to_vec(),
            rows: rows.iter().map(costs).collect(),
        },
        Table {
            caption: "Indirect light at rest against path tracing, then all light, then indirect irradiance at points"
                .into(),
            head: ERROR_HEAD.map(str::to_owned).to_vec(),
            rows: rows.iter().map(errors).collect(),
        },
    ]
}
