//! Figures 3.2 to 3.4, 3.10 and 3.11: the matrix of several bounces and its compression.

use cpu_time::ProcessTime;
use faer::Mat;
use glam::{Vec3, Vec4};
use localmatrix::Entering;
use multibounce::{
    BlockCodec, BlockMatrix, BlockSettings, Channels, MatrixRows, greedy_order, picture, projected_order,
};
use printed::{PRINTED_BLOCKS, printed_order};
use reference::{Picture, PictureFile as _};
use scene::sampling::hash3;
use serde::Serialize;
use transport::{LinearOperator, Permutation};

use super::{Outcome, Study, beside};
use crate::error::Error;
use crate::measure::own_light;
use crate::output;
use crate::report::{Plot, Series, Table, significant};
use patchlight::low_level::operator::{Codec, PatchOperator, SymmetricFactors};
use patchlight::{Bake, BakeSettings, Estimator, ReceiverKind};
use shell::operator_error::{exact_product, relative_error};

/// Bounces of the matrix, as in the thesis' measurements.
const BOUNCES: u32 = 3;
/// Most bounces of the curve.
const MAX_BOUNCES: u32 = 8;
/// Products whose mean time counts.
const ROUNDS: u32 = 8;
/// Share of the entries that lie apart.
const GREATEST: f64 = 0.05;
/// Bins of a decade, and decades below 1.
const BINS: usize = 2;
const DECADES: usize = 9;
/// Bins of equal width.
const LINEAR_BINS: usize = 24;
/// Greatest edge of a picture, pixels.
const MAX_PIXELS: usize = 512;

/// Patches with their form factors, and what they took.
pub(super) struct Subject {
    pub bake: Bake,
    pub factors: SymmetricFactors,
    /// First exitance of the scene's own lights, W/m².
    pub light: Vec<Vec4>,
    pub bake_s: f64,
}

impl Subject {
    pub fn new(study: &Study, count: u32) -> Result<Self, Error> {
        let scene = &study.loaded.scene;
        let settings = BakeSettings::default()
            .with_patch_count(count as usize)
            .with_estimator(Estimator::Hemisphere { rays: study.args.rays })
            .with_receivers(ReceiverKind::Pixels)
            .with_seed(study.common.seed);
        let (bake, bake_s) = timed(|| Ok(Bake::build(scene, &settings, study.progress)?))?;
        let factors = SymmetricFactors::new(bake.mesh(), &bake.form_factors().factors)?;
        let light = own_light(scene, bake.mesh(), settings.sample_rays, settings.seed);
        Ok(Self { bake, factors, light, bake_s })
    }

    fn len(&self) -> usize {
        self.factors.area.len()
    }

    /// Form factors of each patch.
    pub fn rows(&self) -> Vec<Vec<(u32, f32)>> {
        (0..self.len()).map(|i| self.factors.factors.row(i).map(|(j, f)| (j as u32, f)).collect()).collect()
    }

    /// Some patches as they enter a local matrix, with the form factors of all.
    pub fn entering<'a>(&self, patches: &[u32], rows: &'a [Vec<(u32, f32)>]) -> Vec<Entering<'a>> {
        let entering = |&patch: &u32| Entering {
            patch,
            area: self.factors.area[patch as usize],
            albedo: self.bake.mesh().albedo[patch as usize].truncate(),
            factors: &rows[patch as usize],
        };
        patches.iter().map(entering).collect()
    }

    /// The matrix of so many bounces, or of all.
    pub fn operators(&self, bounces: Option<u32>, study: &Study) -> Result<[Mat<f32>; 3], Error> {
        Ok(self.factors.bounces(&self.bake.mesh().albedo, bounces, study.progress)?)
    }
}

/// Result of some work, and seconds of all processors.
pub(super) fn timed<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<(T, f64), Error> {
    let start = ProcessTime::now();
    let result = work()?;
    Ok((result, start.elapsed().as_secs_f64()))
}

/// Mean milliseconds of all processors of a product.
pub(super) fn product_ms(operator: &dyn LinearOperator, light: &[Vec4]) -> Result<f64, Error> {
    let mut out = vec![Vec4::ZERO; light.len()];
    // The first makes memory ready.
    operator.apply(light, &mut out)?;
    let ((), seconds) = timed(|| (0..ROUNDS).try_for_each(|_| Ok(operator.apply(light, &mut out)?)))?;
    Ok(1e3 * seconds / f64::from(ROUNDS))
}

fn value(rows: &impl Serialize) -> serde_json::Value {
    serde_json::to_value(rows).unwrap_or_default()
}

fn heads(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

/// All entries of a matrix, by their greatest channel.
fn entries(n: usize, rows: &MatrixRows) -> Vec<f32> {
    let mut row = vec![Vec3::ZERO; n];
    let mut all = Vec::with_capacity(n * n);
    for i in 0..n {
        rows(i, &mut row);
        all.extend(row.iter().map(|entry| entry.max_element()));
    }
    all
}

/// A histogram.
#[derive(Serialize)]
struct Histogram {
    what: &'static str,
    zeros: usize,
    /// Entries of half a decade each, from 10⁻⁹ on.
    by_decade: Vec<usize>,
    /// Entries of bins of equal width up to the greatest.
    linear: Vec<usize>,
    greatest: f32,
    /// Threshold that the greatest 5 % exceed, and their share of the sum.
    threshold: f32,
    share_of_sum: f64,
}

impl Histogram {
    fn of(what: &'static str, mut all: Vec<f32>) -> Self {
        all.sort_by(f32::total_cmp);
        let greatest = all.last().copied().unwrap_or(0.0);
        let kept = all.len() - (GREATEST * all.len() as f64) as usize;
        let sum = |part: &[f32]| part.iter().map(|&x| f64::from(x)).sum::<f64>();
        let mut by_decade = vec![0; DECADES * BINS];
        let mut linear = vec![0; LINEAR_BINS];
        for &x in all.iter().filter(|&&x| x > 0.0) {
            let decades = DECADES as f64 + f64::from(x).log10();
            by_decade[((decades.max(0.0) * BINS as f64) as usize).min(DECADES * BINS - 1)] += 1;
            linear[((x / greatest * LINEAR_BINS as f32) as usize).min(LINEAR_BINS - 1)] += 1;
        }
        Self {
            what,
            zeros: all.iter().filter(|&&x| x <= 0.0).count(),
            by_decade,
            linear,
            greatest,
            threshold: all.get(kept).copied().unwrap_or(greatest),
            share_of_sum: sum(&all[kept..]) / sum(&all).max(f64::MIN_POSITIVE),
        }
    }
}

/// Figure 3.2.
pub(super) fn histogram(study: &Study) -> Result<Outcome, Error> {
    let subject = Subject::new(study, study.counts[0])?;
    let n = subject.len();
    let operators = subject.operators(Some(BOUNCES), study)?;
    let all = [
        Histogram::of("form factors", entries(n, &subject.factors.rows(subject.factors.channels()))),
        Histogram::of("matrix of 3 bounces", entries(n, &subject.factors.rows(Channels::Three(operators.each_ref())))),
    ];
    let by_decade = |h: &Histogram| Series {
        name: h.what.into(),
        points: (0..h.by_decade.len())
            .filter(|&bin| h.by_decade[bin] > 0)
            .map(|bin| (lower_end(bin).log10(), (h.by_decade[bin] as f64).log10()))
            .collect(),
    };
    let linear = |h: &Histogram| Series {
        name: h.what.into(),
        points: (0..LINEAR_BINS)
            .map(|bin| ((bin as f64 + 0.5) * f64::from(h.greatest) / LINEAR_BINS as f64, h.linear[bin] as f64))
            .collect(),
    };
    let plot = |unit: &str, x: &str, series| Plot {
        title: "Entries by their value".into(),
        unit: unit.into(),
        x: x.into(),
        logarithmic: false,
        series,
    };
    Ok(Outcome {
        rows: value(&all),
        tables: vec![Table {
            caption: format!("Entries of the matrices of {n} patches by their value, the greatest channel of each."),
            head: heads(&["value", "form factors", "matrix of 3 bounces"]),
            rows: histogram_rows(&all),
        }],
        plots: vec![
            ("logarithmic", plot("log₁₀ of their number", "log₁₀ of value", all.iter().map(by_decade).collect())),
            ("linear", plot("number", "value", all.iter().map(linear).collect())),
        ],
    })
}

/// Least value of a bin of the decades.
fn lower_end(bin: usize) -> f64 {
    10f64.powf(bin as f64 / BINS as f64 - DECADES as f64)
}

fn histogram_rows(all: &[Histogram]) -> Vec<Vec<String>> {
    let mut rows: Vec<Vec<String>> =
        vec![std::iter::once("0".to_owned()).chain(all.iter().map(|h| h.zeros.to_string())).collect()];
    for bin in 0..DECADES * BINS {
        let counts = all.iter().map(|h| h.by_decade[bin].to_string());
        rows.push(
            std::iter::once(format!("{:.1e} to {:.1e}", lower_end(bin), lower_end(bin + 1))).chain(counts).collect(),
        );
    }
    rows.push(
        std::iter::once("greatest".to_owned()).chain(all.iter().map(|h| format!("{:.3e}", h.greatest))).collect(),
    );
    rows.push(
        std::iter::once("exceeded by 5 %".to_owned())
            .chain(all.iter().map(|h| format!("{:.3e}", h.threshold)))
            .collect(),
    );
    rows.push(
        std::iter::once("share of the sum that these have".to_owned())
            .chain(all.iter().map(|h| format!("{:.1} %", 100.0 * h.share_of_sum)))
            .collect(),
    );
    rows
}

/// Errors of a compression in an order.
#[derive(Serialize)]
struct Compressed {
    settings: &'static str,
    order: &'static str,
    /// Mean squared error of the entries in blocks, of all entries, and relative error of the light.
    block_mse: f64,
    mse: f64,
    light: f64,
}

/// Figures 3.3 and 3.4.
pub(super) fn compression(study: &Study) -> Result<Outcome, Error> {
    let subject = Subject::new(study, study.counts[0])?;
    let n = subject.len();
    let area = &subject.factors.area;
    let operators = subject.operators(Some(BOUNCES), study)?;
    let channels = Channels::Three(operators.each_ref());
    let rows = subject.factors.rows(channels);
    let seed = study.common.seed;
    let mut random: Vec<u32> = (0..n as u32).collect();
    random.sort_by_key(|&i| (hash3(i, 0, seed ^ 0x6f72), i));
    let orders = [
        ("given", Permutation::identity(n)),
        ("random", Permutation::new(random)?),
        ("listing 3.1", printed_order(n, &rows)),
        ("greedy, each once", greedy_order(n, &rows)),
        ("projected logarithms", projected_order(n, &rows, seed)),
    ];
    let exact = exact_product(channels, area, &subject.light);
    let mut found = Vec::new();
    let mut pictures = Vec::new();
    for (what, settings) in [("as printed", PRINTED_BLOCKS), ("ours", BlockSettings::of(BlockCodec::Bc1))] {
        for (name, order) in &orders {
            let go = |_: usize, _: usize| std::ops::ControlFlow::Continue(());
            let matrix = BlockMatrix::encode(n, &rows, order.clone(), settings, &go)?;
            let mut irradiance = vec![Vec4::ZERO; n];
            matrix.apply(&subject.light, &mut irradiance)?;
            let report = matrix.report();
            let light = relative_error(&irradiance, &exact, area);
            found.push(Compressed { settings: what, order: name, block_mse: report.block_mse, mse: report.mse, light });
            let is_shown = (what == "as printed" && ["given", "listing 3.1"].contains(name))
                || (what == "ours" && *name == "projected logarithms");
            if is_shown {
                let difference = |i: usize, row: &mut [Vec3]| {
                    let mut right = vec![Vec3::ZERO; n];
                    rows(i, &mut right);
                    if matrix.row(i, row).is_ok() {
                        row.iter_mut().zip(right).for_each(|(entry, right)| *entry = (*entry - right).abs());
                    }
                };
                pictures.push(picture(n, &difference, order, MAX_PIXELS));
            }
        }
    }
    write_errors(study, n, &pictures)?;
    Ok(Outcome { rows: value(&found), tables: vec![compression_table(n, &found)], plots: Vec::new() })
}

fn compression_table(n: usize, found: &[Compressed]) -> Table {
    let line = |row: &Compressed| {
        vec![
            format!("{}, {}", row.settings, row.order),
            format!("{:.3e}", row.block_mse),
            format!("{:.3e}", row.mse),
            format!("{} %", significant(100.0 * row.light)),
        ]
    };
    Table {
        caption: format!(
            "BC1 of the matrix of {BOUNCES} bounces of {n} patches. As printed: values as they are, zeros in the \
             place of the greatest 5 %. Pictures, from the left, brighter alike: as printed before (3.3) and after \
             (3.4) listing 3.1, ours."
        ),
        head: heads(&["compression and order", "MSE in blocks", "MSE of all entries", "error of the light"]),
        rows: found.iter().map(line).collect(),
    }
}

/// Pictures of errors side by side, with one scale: white is what one pixel of 200 of the first exceeds.
fn write_errors(study: &Study, n: usize, errors: &[Vec<Vec3>]) -> Result<(), Error> {
    let Some(first) = errors.first() else { return Ok(()) };
    let mut greatest: Vec<f32> = first.iter().map(|error| error.max_element()).collect();
    greatest.sort_by(f32::total_cmp);
    let white = greatest.get(greatest.len() * 199 / 200).copied().unwrap_or(1.0).max(f32::MIN_POSITIVE);
    let edge = n.min(MAX_PIXELS) as u32;
    let picture = |pixels: &Vec<Vec3>| {
        Picture::from_pixels(edge, edge, pixels.iter().map(|error| (*error / white).min(Vec3::ONE)).collect())
    };
    let pictures = errors.iter().map(picture).collect::<Result<Vec<_>, _>>()?;
    let all = beside(&pictures.iter().collect::<Vec<_>>())?;
    all.write_png(&study.file("errors.png"), 0.0)?;
    Ok(())
}

/// Work of so many bounces.
#[derive(Serialize)]
struct Bounce {
    bounces: u32,
    dense_ms: f64,
    sparse_ms: f64,
    matrix_ms: f64,
    bc1_ms: f64,
}

/// Figure 3.10.
pub(super) fn bounces(study: &Study) -> Result<Outcome, Error> {
    let subject = Subject::new(study, study.counts[0])?;
    let n = subject.len();
    let factors = &subject.factors;
    let operators = subject.operators(Some(BOUNCES), study)?;
    let channels = Channels::Three(operators.each_ref());
    let encode = |codec| PatchOperator::encode(codec, channels, factors, study.common.seed, study.progress);
    let matrix = encode(Codec::Dense)?;
    let bc1 = encode(Codec::Blocks(BlockCodec::Bc1))?;
    let dense = factors.factors.to_dense();
    let light = &subject.light;
    let ms = [product_ms(&dense, light)?, product_ms(&factors.factors, light)?];
    let [matrix_ms, bc1_ms] = [product_ms(&matrix, light)?, product_ms(&bc1, light)?];
    let found: Vec<Bounce> = (1..=MAX_BOUNCES)
        .map(|bounces| Bounce {
            bounces,
            dense_ms: f64::from(bounces) * ms[0],
            sparse_ms: f64::from(bounces) * ms[1],
            matrix_ms,
            bc1_ms,
        })
        .collect();
    let cells = |row: &Bounce| {
        std::iter::once(row.bounces.to_string())
            .chain([row.dense_ms, row.sparse_ms, row.matrix_ms, row.bc1_ms].map(significant))
            .chain([significant(row.dense_ms / row.matrix_ms), significant(row.dense_ms / row.bc1_ms)])
            .collect()
    };
    let nonzero = factors.factors.values.len();
    let table = Table {
        caption: format!(
            "Processor milliseconds of the light between {n} patches over the number of bounces. A bounce multiplies \
             {} numbers by dense and {nonzero} by sparse form factors, three channels each; the matrix of all bounces \
             takes {} once. Bytes read: {} a bounce, {} and {} of the matrix and of its blocks.",
            n * n,
            n * n * 3,
            output::bytes(4 * (n * n) as u64),
            output::bytes(matrix.bytes()),
            output::bytes(bc1.bytes()),
        ),
        head: heads(&[
            "bounces",
            "form factors, dense",
            "form factors, sparse",
            "matrix",
            "matrix, BC1",
            "dense / matrix",
            "dense / BC1",
        ]),
        rows: found.iter().map(cells).collect(),
    };
    let plot = bounces_plot(&found);
    Ok(Outcome { rows: value(&found), tables: vec![table], plots: vec![("bounces", plot)] })
}

fn bounces_plot(found: &[Bounce]) -> Plot {
    let series = |name: &str, of: fn(&Bounce) -> f64| Series {
        name: name.into(),
        points: found.iter().map(|row| (f64::from(row.bounces), of(row))).collect(),
    };
    Plot {
        title: "Light between patches".into(),
        unit: "ms".into(),
        x: "bounces".into(),
        logarithmic: true,
        series: vec![
            series("form factors, dense", |row| row.dense_ms),
            series("form factors, sparse", |row| row.sparse_ms),
            series("matrix", |row| row.matrix_ms),
            series("matrix, BC1", |row| row.bc1_ms),
        ],
    }
}

/// Size of a matrix.
#[derive(Serialize)]
struct Size {
    patches: usize,
    what: &'static str,
    bytes: u64,
    /// Share of one number of single precision for each pair of patches.
    share: f64,
    /// Processor seconds, over those of patches and form factors.
    preparation: Option<f64>,
}

/// Figure 3.11, and what preprocessing takes more.
pub(super) fn bytes(study: &Study) -> Result<Outcome, Error> {
    let mut found: Vec<Size> = Vec::new();
    for &count in &study.counts {
        let subject = Subject::new(study, count)?;
        let n = subject.len();
        let factors = &subject.factors;
        let one = 4 * (n * n) as u64;
        let size = |what, bytes: u64, seconds: Option<f64>| Size {
            patches: n,
            what,
            bytes,
            share: bytes as f64 / one as f64,
            preparation: seconds.map(|s| s / subject.bake_s),
        };
        found.push(size("form factors", one, None));
        found.push(size("form factors, sparse", factors.factors.bytes(), None));
        let (operators, made_s) = timed(|| subject.operators(Some(BOUNCES), study))?;
        let channels = Channels::Three(operators.each_ref());
        found.push(size("matrix of 3 bounces", 3 * one, Some(made_s)));
        let rows = factors.rows(channels);
        let go = |_: usize, _: usize| std::ops::ControlFlow::Continue(());
        let (printed, printed_s) =
            timed(|| Ok(BlockMatrix::encode(n, &rows, printed_order(n, &rows), PRINTED_BLOCKS, &go)?))?;
        let bytes = printed.bytes_by_part().total();
        found.push(size("matrix, BC1 as printed", bytes, Some(made_s + printed_s)));
        for (what, codec) in [
            ("matrix, BC1", Codec::Blocks(BlockCodec::Bc1)),
            ("matrix, BC3", Codec::Blocks(BlockCodec::Bc3)),
            ("matrix, BC6H", Codec::Blocks(BlockCodec::Bc6h)),
            ("matrix, BC7", Codec::Blocks(BlockCodec::Bc7)),
            ("matrix, tiles of 1 % error", Codec::LowRank { epsilon: 0.01 }),
        ] {
            let (operator, seconds) =
                timed(|| Ok(PatchOperator::encode(codec, channels, factors, study.common.seed, study.progress)?))?;
            found.push(size(what, operator.bytes(), Some(made_s + seconds)));
        }
    }
    let plot = sizes_plot(&found);
    Ok(Outcome { rows: value(&found), tables: vec![sizes_table(&found)], plots: vec![("bytes", plot)] })
}

fn sizes_table(found: &[Size]) -> Table {
    let cells = |row: &Size| {
        vec![
            row.patches.to_string(),
            row.what.to_owned(),
            output::bytes(row.bytes),
            format!("{:.1} %", 100.0 * row.share),
            row.preparation.map_or_else(|| "–".to_owned(), |share| format!("{:.0} %", 100.0 * share)),
        ]
    };
    Table {
        caption: "Bytes beside those of form factors of one channel, a number of single precision a pair of patches; \
                  processor time of making the matrix and of compressing it, over that of patches and form factors."
            .into(),
        head: heads(&["patches", "what", "bytes", "of the form factors", "more preprocessing"]),
        rows: found.iter().map(cells).collect(),
    }
}

fn sizes_plot(found: &[Size]) -> Plot {
    let names =
        ["form factors", "matrix of 3 bounces", "matrix, BC1 as printed", "matrix, BC3", "matrix, tiles of 1 % error"];
    let series = |name: &str| Series {
        name: name.into(),
        points: found
            .iter()
            .filter(|row| row.what == name)
            .map(|row| (row.patches as f64, row.bytes as f64 / 1e6))
            .collect(),
    };
    Plot {
        title: "Bytes".into(),
        unit: "MB".into(),
        x: "patches".into(),
        logarithmic: true,
        series: names.into_iter().map(series).collect(),
    }
}
