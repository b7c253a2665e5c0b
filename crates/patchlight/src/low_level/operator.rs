//! The light between patches as one operator: all bounces in a product, or the form factors of one bounce.

mod baked;
pub mod build;
mod decode;
mod symmetric;

use std::sync::Arc;

use glam::{Vec3, Vec4};
use multibounce::{
    Acceleration, BlockCodec, BlockMatrix, Channels, LowRank, MatrixRows, TileSide, TileSource, spectral_radius,
    spectral_range,
};
use rayon::prelude::*;
use runtime::plan::Plan;
use runtime::recipe::Tables;
use runtime::recipe::multibounce::{
    BlockTables, Decoder, DenseTables, LowRankTables, OperatorTables, planar, planar_columns,
};
use serde::{Deserialize, Serialize};
use transport::kernel::product::packed_row_words;
use transport::{Dense, Half, LinearOperator, Observer, Permutation, Phase, check_length, widen_half};

use crate::error::Error;
use crate::observe::{Report, run_phase};

pub use baked::{BakedOperator, OperatorKey};
pub use build::{Build, BuildOn};
pub use decode::{Decode, decoder_name};
pub use symmetric::{SymmetricFactors, mean_visible_points};

/// Storage of an operator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Codec {
    /// A number of single precision for each entry and channel.
    Dense,
    /// Rows in half precision.
    Half,
    /// Texture blocks, with the greatest entries beside them.
    Blocks(BlockCodec),
    /// Rank-1 terms, dense sub-blocks and sparse residuals.
    LowRank {
        /// Relative Frobenius error.
        epsilon: f64,
    },
}

impl Codec {
    /// Its name in summaries and options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dense => "dense",
            Self::Half => "f16",
            Self::Blocks(BlockCodec::Bc1) => "bc1",
            Self::Blocks(BlockCodec::Bc3) => "bc3",
            Self::Blocks(BlockCodec::Bc6h) => "bc6h",
            Self::Blocks(BlockCodec::Bc7) => "bc7",
            Self::LowRank { .. } => "low_rank",
        }
    }
}

/// An operator between patches as it is multiplied by.
///
/// The dense ones have a row `[red | green | blue | zeros]` for each patch, `columns / 3` entries of each channel, for
/// planar RGB: so the products with one number an entry serve three channels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum PatchOperator {
    /// Single precision.
    Dense(Arc<Dense>),
    /// Half precision.
    Half(Arc<Half>),
    /// Texture blocks and outliers.
    Blocks(Arc<BlockMatrix>),
    /// Low rank; of one channel they hold form factors.
    LowRank(Arc<LowRank>),
}

/// `H = T E` on the host, W/m².
impl LinearOperator for PatchOperator {
    fn shape(&self) -> (usize, usize) {
        (self.patches(), self.patches())
    }

    fn bytes(&self) -> u64 {
        self.bytes_by_part().iter().map(|part| part.1).sum()
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), transport::Error> {
        match self {
            Self::Dense(dense) => dense.apply(&to_planar(exitance), irradiance),
            Self::Half(half) => half.apply(&to_planar(exitance), irradiance),
            Self::Blocks(matrix) => matrix.apply(exitance, irradiance),
            Self::LowRank(tiles) => tiles.apply(exitance, irradiance),
        }
    }
}

/// A matrix in texture blocks, in an order that brings like rows together.
#[cfg(feature = "texture-blocks")]
fn in_blocks(
    codec: BlockCodec,
    (n, rows): (usize, &MatrixRows),
    seed: u32,
    report: &Report,
) -> Result<BlockMatrix, Error> {
    let order = multibounce::projected_order(n, rows, seed);
    Ok(BlockMatrix::encode(n, rows, order, multibounce::BlockSettings::of(codec), &report)?)
}

/// Reports that the encoder is not compiled in.
#[cfg(not(feature = "texture-blocks"))]
fn in_blocks(codec: BlockCodec, _: (usize, &MatrixRows), _: u32, _: &Report) -> Result<BlockMatrix, Error> {
    Err(crate::error::Reason::NoBlockEncoder { codec: Codec::Blocks(codec).name() }.into())
}

fn to_planar(exitance: &[Vec4]) -> Vec<Vec4> {
    planar(exitance.len()).map(|at| at.map_or(Vec4::ZERO, |(j, c)| Vec4::AXES[c] * exitance[j][c])).collect()
}

impl PatchOperator {
    /// Stores the operator `a^-½ T̂ a^½` of symmetric channels.
    ///
    /// # Errors
    /// What the codec says; cancellation.
    pub fn encode(
        codec: Codec,
        channels: Channels,
        factors: &SymmetricFactors,
        seed: u32,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        let n = factors.area.len();
        let rows = factors.rows(channels);
        run_phase(observer, Phase::COMPRESS, |report: &Report| {
            Ok(match codec {
                Codec::Dense => Self::Dense(Arc::new(encode_dense(n, &rows))),
                Codec::Half => Self::Half(Arc::new(encode_half(n, &rows))),
                Codec::Blocks(codec) => Self::Blocks(Arc::new(in_blocks(codec, (n, &rows), seed, report)?)),
                Codec::LowRank { epsilon } => {
                    let patches = TileSide { area: &factors.area, order: &factors.order };
                    let source = TileSource::Symmetric { channels, patches };
                    Self::LowRank(Arc::new(LowRank::encode(source, epsilon, &report)?))
                }
            })
        })
    }

    /// Puts the operator on a device; a binding shows at most `range` bytes, and `decoder` is for texture blocks.
    pub fn add_tables(&self, plan: &mut Plan, tables: &mut Tables, range: u64, decoder: Decoder) -> OperatorTables {
        match self {
            Self::Dense(dense) => OperatorTables::Dense(DenseTables::new(plan, tables, dense)),
            Self::Half(half) => OperatorTables::Dense(DenseTables::half(plan, tables, half)),
            Self::Blocks(matrix) => OperatorTables::Blocks(BlockTables::new(plan, tables, matrix, range, decoder)),
            Self::LowRank(tiles) => OperatorTables::LowRank(LowRankTables::new(plan, tables, tiles)),
        }
    }

    /// Number of patches.
    pub fn patches(&self) -> usize {
        match self {
            Self::Dense(dense) => dense.rows,
            Self::Half(half) => half.rows,
            Self::Blocks(matrix) => matrix.len(),
            Self::LowRank(low_rank) => low_rank.shape().0,
        }
    }

    /// Checks that the tables are those of so many patches, where they come from a file.
    ///
    /// # Errors
    /// The table that is not.
    pub fn check(&self, patches: usize) -> Result<(), Error> {
        let columns = planar_columns(patches);
        check_length("patches of an operator", patches, self.patches())?;
        match self {
            Self::Dense(dense) => {
                check_length("columns of an operator", columns, dense.columns)?;
                check_length("entries of an operator", patches * columns, dense.values.len())?;
            }
            Self::Half(half) => {
                check_length("columns of an operator", columns, half.columns)?;
                let words = packed_row_words(columns as u32) as usize;
                check_length("entries of an operator", patches * words, half.words.len())?;
            }
            Self::Blocks(matrix) => matrix.check()?,
            Self::LowRank(tiles) => {
                check_length("columns of an operator", patches, tiles.shape().1)?;
                tiles.check()?;
            }
        }
        Ok(())
    }

    /// Bytes of each part that a product reads.
    pub fn bytes_by_part(&self) -> Vec<(&'static str, u64)> {
        match self {
            Self::Dense(dense) => vec![("entries", size_of_val(&dense.values[..]) as u64)],
            Self::Half(half) => vec![("entries", size_of_val(&half.words[..]) as u64)],
            Self::Blocks(matrix) => {
                let bytes = matrix.bytes_by_part();
                vec![
                    ("blocks", bytes.blocks),
                    ("scales", bytes.scales),
                    ("outliers", bytes.outliers),
                    ("vectors", bytes.vectors),
                ]
            }
            Self::LowRank(tiles) => tiles.bytes_by_part().to_vec(),
        }
    }

    /// Row `i` as it is stored, one RGB entry for each patch.
    pub fn row(&self, i: usize, row: &mut [Vec3]) {
        let n = row.len();
        match self {
            Self::Dense(dense) => {
                let entries = dense.row(i);
                (0..n).for_each(|j| row[j] = Vec3::from_array([0, 1, 2].map(|c| entries[c * n + j])));
            }
            Self::Half(half) => {
                let words = &half.words[i * packed_row_words(half.columns as u32) as usize..];
                let entry = |k: usize| widen_half(words[k / 2] >> (16 * (k % 2)));
                (0..n).for_each(|j| row[j] = Vec3::from_array([0, 1, 2].map(|c| entry(c * n + j))));
            }
            Self::Blocks(matrix) => {
                if matrix.row(i, row).is_err() {
                    row.fill(Vec3::ZERO);
                }
            }
            Self::LowRank(tiles) => {
                if tiles.row(i, row).is_err() {
                    row.fill(Vec3::ZERO);
                }
            }
        }
    }

    /// The order in which neighbours are similar, where the codec has one.
    ///
    /// # Errors
    /// An order that is none.
    pub fn order(&self) -> Result<Option<Permutation>, Error> {
        Ok(match self {
            Self::Dense(_) | Self::Half(_) => None,
            Self::Blocks(matrix) => Some(matrix.permutation().clone()),
            Self::LowRank(tiles) => Some(Permutation::new(tiles.order.clone())?),
        })
    }

    /// Relative error of the entries as the codec states it (Frobenius), the greatest of the channels.
    pub fn frobenius(&self, channels: Channels, factors: &SymmetricFactors) -> f64 {
        match self {
            Self::Blocks(matrix) => matrix.report().frobenius,
            Self::LowRank(tiles) => tiles.report.error.iter().copied().fold(0.0, f64::max),
            Self::Dense(_) | Self::Half(_) => frobenius_error(self, &factors.rows(channels)),
        }
    }

    /// Description for messages.
    pub fn describe(&self) -> String {
        let size = self.bytes() as f64 * 1e-6;
        match self {
            Self::Dense(_) | Self::Half(_) => format!("operator: {size:.2} MB"),
            Self::Blocks(matrix) => {
                format!("operator: {size:.2} MB, relative error {:.2} %", 100.0 * matrix.report().frobenius)
            }
            Self::LowRank(tiles) => describe_low_rank(tiles, size),
        }
    }
}

fn describe_low_rank(tiles: &LowRank, size: f64) -> String {
    let report = &tiles.report;
    format!(
        "operator: {size:.2} MB (stored {:.2} MB), relative error {:.2} / {:.2} / {:.2} %, {} rank-1 terms, {} dense \
         sub-blocks and {} sparse entries in {} tiles, ranks up to {}",
        tiles.stored_bytes() as f64 * 1e-6,
        100.0 * report.error[0],
        100.0 * report.error[1],
        100.0 * report.error[2],
        report.terms.iter().sum::<usize>(),
        report.sub_blocks,
        report.entries,
        report.tiles.iter().sum::<usize>(),
        report.most_rank
    )
}

fn encode_dense(n: usize, rows: &MatrixRows) -> Dense {
    let columns = planar_columns(n);
    let mut dense = Dense::zeros(n, columns);
    dense
        .values
        .par_chunks_mut(columns.max(1))
        .enumerate()
        .for_each_init(|| vec![Vec3::ZERO; n], |colors, (i, row)| fill_planar(rows, i, colors, row));
    dense
}

fn encode_half(n: usize, rows: &MatrixRows) -> Half {
    let columns = planar_columns(n);
    let width = packed_row_words(columns as u32) as usize;
    let mut words = vec![0; n * width];
    words.par_chunks_mut(width.max(1)).enumerate().for_each_init(
        || (vec![Vec3::ZERO; n], Dense::zeros(1, columns)),
        |(colors, one), (i, row)| {
            fill_planar(rows, i, colors, &mut one.values);
            row.copy_from_slice(&one.to_half().words);
        },
    );
    Half { rows: n, columns, words }
}

/// A row in planes; `colors` is workspace for it.
fn fill_planar(rows: &MatrixRows, i: usize, colors: &mut [Vec3], row: &mut [f32]) {
    rows(i, colors);
    for (value, at) in row.iter_mut().zip(planar(colors.len())) {
        *value = at.map_or(0.0, |(j, c)| colors[j][c]);
    }
}

/// Squared error and squared entries of each channel of a row.
type RowSquares = [[f64; 2]; 3];

fn frobenius_error(operator: &PatchOperator, exact: &MatrixRows) -> f64 {
    let n = operator.patches();
    let of_row = |i: usize| -> RowSquares {
        let mut right = vec![Vec3::ZERO; n];
        let mut row = vec![Vec3::ZERO; n];
        exact(i, &mut right);
        operator.row(i, &mut row);
        let mut sums = RowSquares::default();
        for (stored, right) in row.iter().zip(&right) {
            for (c, sum) in sums.iter_mut().enumerate() {
                sum[0] += f64::from(stored[c] - right[c]).powi(2);
                sum[1] += f64::from(right[c]).powi(2);
            }
        }
        sums
    };
    // In the order of the rows, so that the number of threads changes nothing.
    let rows: Vec<RowSquares> = (0..n).into_par_iter().map(of_row).collect();
    let mut sums = RowSquares::default();
    for row in rows {
        for (sum, one) in sums.iter_mut().zip(row) {
            sum[0] += one[0];
            sum[1] += one[1];
        }
    }
    sums.iter().map(|[wrong, all]| if *all > 0.0 { (wrong / all).sqrt() } else { 0.0 }).fold(0.0, f64::max)
}

/// Steps and tolerance of the power iteration that finds how far light can grow.
const RADIUS_STEPS: usize = 200;
pub(crate) const RADIUS_TOLERANCE: f32 = 1e-4;

/// Tolerance of the eigenvalues that accelerated bounces go by.
const RANGE_TOLERANCE: f32 = 1e-3;

/// Convergence of progressive bounces by these form factors, plain and accelerated.
///
/// # Errors
/// Form factors that are not those of so many patches.
pub fn accelerations(albedo: &[Vec4], factors: &dyn LinearOperator) -> Result<[Acceleration; 2], Error> {
    let range = spectral_range(factors, albedo, RANGE_TOLERANCE, RADIUS_STEPS)?;
    Ok([Acceleration::none(range.clone()), Acceleration::new(range)?])
}

/// Spectral radius of `diag(ρ) T`, the greatest of the channels.
///
/// # Errors
/// An operator that is not one of so many patches.
pub fn growth(albedo: &[Vec4], operator: &dyn LinearOperator) -> Result<f32, Error> {
    Ok(spectral_radius(operator, albedo, RADIUS_TOLERANCE, RADIUS_STEPS)?.max_element())
}

#[cfg(test)]
mod tests;
