//! Tables 1 and 2: sampled light beside products with the form factors, their time over the number of patches and their
//! errors against path tracing. Table 3 is `bench table3`.

use reference::PictureErrors;
use serde::Serialize;
use temporal::{AliasTables, Blend, Distribution, Packing, RayLists, Settings, State};
use transport::{Csr, Dense, LinearOperator};

use super::matrix::{Subject, product_ms, timed};
use super::{Outcome, Study};
use crate::bench::contest::field::{Field, GATHERING, OWN, PatchMethod};
use crate::bench::contest::{View, errors, pictures_at_rest};
use crate::bench::setup::bake_settings;
use crate::bench::truth::Truth;
use crate::error::Error;
use crate::progress::is_cancelled;
use crate::report::{Plot, Series, Table, significant};
use patchlight::MethodSettings;
use patchlight::method::TemporalSettings;
use patchlight::method::temporal::RowKind;

/// Values that table 1 prints, on a graphics processor: patches, ms of the product, ms of sampled light.
const PRINTED: [(usize, f64, f64); 4] =
    [(1736, 0.34, 0.02), (5485, 2.94, 0.04), (8786, 7.34, 0.06), (10_422, 12.01, 0.08)];
/// Patches that are as many as printed if they differ by no more than this share.
const AS_MANY: f64 = 0.01;
/// Samples a row, and the weight of the frames before where it is a fixed one.
pub(super) const SAMPLES: u32 = 64;
pub(super) const WEIGHT: f32 = 0.9;
/// Entries of a list that stands for a row.
const LIST_ENTRIES: usize = 1024;
/// Frames whose mean counts.
const ROUNDS: u32 = 8;
/// Bytes of the largest dense matrix that is made.
const MAX_DENSE: usize = 2_000_000_000;

/// Times of a row of table 1: processor milliseconds, bytes that a product reads.
#[derive(Serialize)]
struct Times {
    patches: usize,
    dense_ms: Option<f64>,
    sparse_ms: f64,
    /// As printed, and of the change of the light.
    sampled_ms: f64,
    changes_ms: f64,
    dense_bytes: u64,
    sparse_bytes: u64,
    /// Printed values for as many patches: product, sampled light.
    printed_ms: Option<(f64, f64)>,
}

/// Settings as the thesis has them, with a fixed weight of the frames before.
pub(super) fn printed(seed: u32) -> Settings {
    Settings {
        samples: SAMPLES,
        blend: Blend::Fixed(WEIGHT),
        control_variate: false,
        rotated: false,
        seed,
        ..Settings::DEFAULT
    }
}

/// Samples of the change of the light.
pub(super) fn changes(seed: u32) -> Settings {
    Settings { samples: SAMPLES, seed, ..Settings::DEFAULT }
}

/// Rows of form factors as they are sampled: alias tables as printed, and lists.
pub(super) fn sampled_rows(factors: &Csr) -> Result<(AliasTables, RayLists), Error> {
    let Csr { columns, row_start, column_index, values, .. } = factors;
    let tables = AliasTables::from_rows(*columns, row_start, column_index, values, Packing::Stacks);
    let lists = RayLists::from_rows(*columns, row_start, column_index, values, LIST_ENTRIES);
    Ok((tables.map_err(patchlight::Error::from)?, lists.map_err(patchlight::Error::from)?))
}

/// Table 1: time over the number of patches.
pub(super) fn time(study: &Study) -> Result<Outcome, Error> {
    let mut rows = Vec::new();
    for &count in &study.counts {
        let subject = Subject::new(study, count)?;
        rows.push(times(study, &subject)?);
        if is_cancelled() {
            return Err(shell::Error::Cancelled.into());
        }
    }
    let series = |name: &str, of: fn(&Times) -> Option<f64>| Series {
        name: name.into(),
        points: rows.iter().filter_map(|row| Some((row.patches as f64, of(row)?))).collect(),
    };
    let plot = Plot {
        title: "A frame".into(),
        unit: "processor ms".into(),
        x: "patches".into(),
        logarithmic: true,
        series: vec![
            series("dense product", |row| row.dense_ms),
            series("sparse product", |row| Some(row.sparse_ms)),
            series("samples, as printed", |row| Some(row.sampled_ms)),
            series("samples of the change", |row| Some(row.changes_ms)),
        ],
    };
    Ok(Outcome {
        rows: serde_json::to_value(&rows).unwrap_or_default(),
        tables: vec![table_of_times(&rows)],
        plots: vec![("time", plot)],
    })
}

fn times(study: &Study, subject: &Subject) -> Result<Times, Error> {
    let factors: &Csr = &subject.bake.form_factors().factors;
    let n = factors.columns;
    let dense_bytes = n * n * size_of::<f32>();
    let dense = (dense_bytes <= MAX_DENSE).then(|| dense(factors));
    let (tables, lists) = sampled_rows(factors)?;
    let seed = study.common.seed;
    Ok(Times {
        patches: n,
        dense_ms: dense.map(|dense| product_ms(&dense, &subject.light)).transpose()?,
        sparse_ms: product_ms(factors, &subject.light)?,
        sampled_ms: frames_ms(subject, &tables, &printed(seed))?,
        changes_ms: frames_ms(subject, &lists, &changes(seed))?,
        dense_bytes: dense_bytes as u64,
        sparse_bytes: factors.bytes(),
        printed_ms: PRINTED
            .iter()
            .find(|(patches, ..)| (n as f64 / *patches as f64 - 1.0).abs() <= AS_MANY)
            .map(|&(_, product, sampled)| (product, sampled)),
    })
}

fn dense(factors: &Csr) -> Dense {
    let rows = factors.rows;
    let columns = factors.columns;
    let mut values = vec![0.0; rows * columns];
    for i in 0..rows {
        factors.row(i).for_each(|(j, f)| values[i * columns + j] = f);
    }
    Dense { rows, columns, values }
}

/// Frames in which the light goes up and down by a tenth, so that there are changes to sample.
fn frames_ms(subject: &Subject, rows: &impl Distribution, settings: &Settings) -> Result<f64, Error> {
    let albedo = &subject.bake.mesh().albedo;
    let lights = [1.0, 1.1].map(|scale| subject.light.iter().map(|e| *e * scale).collect::<Vec<_>>());
    let mut state = State::new(albedo.len());
    let mut advance = |frame: u32| {
        let light = &lights[frame as usize % lights.len()];
        state.advance(rows, light, albedo, settings).map_err(patchlight::Error::from)
    };
    advance(0)?;
    let ((), seconds) = timed(|| Ok((1..=ROUNDS).try_for_each(&mut advance)?))?;
    Ok(1e3 * seconds / f64::from(ROUNDS))
}

fn table_of_times(rows: &[Times]) -> Table {
    let ms = |ms: Option<f64>| ms.map_or_else(|| "–".to_owned(), significant);
    let cells = |row: &Times| {
        vec![
            row.patches.to_string(),
            ms(row.dense_ms),
            significant(row.dense_bytes as f64 * 1e-6),
            ms(Some(row.sparse_ms)),
            significant(row.sparse_bytes as f64 * 1e-6),
            ms(Some(row.sampled_ms)),
            ms(Some(row.changes_ms)),
            ms(row.dense_ms.map(|dense| dense / row.sampled_ms)),
            ms(row.printed_ms.map(|printed| printed.0)),
            ms(row.printed_ms.map(|printed| printed.1)),
        ]
    };
    let heads = [
        "patches",
        "dense product ms",
        "MB",
        "sparse product ms",
        "MB",
        "samples ms, as printed",
        "of the change, ours",
        "dense over samples",
        "printed: product ms",
        "samples ms",
    ];
    Table {
        caption: format!(
            "Table 1: a bounce between patches, processor time; {SAMPLES} samples a row. What is printed is time of a \
             graphics processor: compare ratios."
        ),
        head: heads.map(str::to_owned).to_vec(),
        rows: rows.iter().map(cells).collect(),
    }
}

/// Errors of a method against path tracing.
#[derive(Serialize)]
struct Errors {
    patches: usize,
    method: String,
    full: PictureErrors,
    indirect: PictureErrors,
}

/// Table 2: errors of products and of sampled light, against path tracing.
pub(super) fn accuracy(study: &Study) -> Result<Outcome, Error> {
    let Study { common, args, loaded, progress, .. } = *study;
    let truth = Truth::traced(loaded, &loaded.scene.lighting.lights, args.size(), args.spp, common.seed, progress)?;
    let view = View::new(common, args, loaded);
    let mut rows = Vec::new();
    for &count in &study.counts {
        let field = Field::new(&view, &bake_settings(common, args, loaded, count as usize), progress)?;
        let patches = field.bake().mesh().patches.len();
        let as_printed =
            TemporalSettings { settings: printed(common.seed), rows: RowKind::Tables, ..TemporalSettings::default() };
        let usual = PatchMethod::usual(patches, common.seed);
        let mut methods: Vec<PatchMethod> = usual.into_iter().filter(|method| method.name == GATHERING).collect();
        methods.push(PatchMethod::of("temporal, as printed", MethodSettings::Temporal(as_printed)));
        methods.extend(usual.into_iter().filter(|method| method.name == OWN[1]));
        let mut direct = None;
        for mut contender in field.with_patches(&methods)? {
            let pictures = pictures_at_rest(&view, contender.as_mut(), 0, &mut direct)?;
            let (full, indirect) = errors(&view, &pictures, &truth)?;
            rows.push(Errors { patches, method: contender.name(), full, indirect });
        }
    }
    Ok(Outcome {
        rows: serde_json::to_value(&rows).unwrap_or_default(),
        tables: vec![table_of_errors(&rows, &truth.source)],
        plots: Vec::new(),
    })
}

fn table_of_errors(rows: &[Errors], source: &str) -> Table {
    let cells = |row: &Errors| {
        let mut cells = vec![row.patches.to_string(), row.method.clone()];
        for errors in [&row.full, &row.indirect] {
            let PictureErrors { mse, psnr_db, ssim, .. } = errors;
            cells.extend([format!("{mse:.5}"), format!("{psnr_db:.2}"), format!("{ssim:.4}")]);
        }
        cells
    };
    let heads = ["patches", "method", "MSE", "PSNR dB", "SSIM", "indirect light alone: MSE", "PSNR dB", "SSIM"];
    Table {
        caption: format!(
            "Table 2: pictures at rest against path tracing ({source}). Printed: MSE 0.06658 and 0.06651, PSNR 23.53 \
             and 23.54 dB, SSIM 0.8354 and 0.8323 of products and of sampled light, in scenes of the thesis."
        ),
        head: heads.map(str::to_owned).to_vec(),
        rows: rows.iter().map(cells).collect(),
    }
}
