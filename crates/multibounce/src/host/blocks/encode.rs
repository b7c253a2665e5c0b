//! From a matrix to blocks.

use alloc::vec;
use alloc::vec::Vec;
use core::ops::ControlFlow;
use core::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use block_compression::encode::{compress_rgba8, compress_rgba16};
use block_compression::{BC6HSettings, BC7Settings, CompressionVariant};
use glam::{UVec2, UVec4, Vec3, Vec4};
use half::f16;
use scene::parallel::*;
use transport::{Permutation, check_length};

use super::{BlockCodec, BlockMatrix, BlockReport, BlockSettings, Filling, decode_texel, params, unpack};
use crate::error::Error;
use crate::host::energy::row_factor;
use crate::host::order::MatrixRows;
use crate::host::outliers::Outliers;
use crate::host::outliers::find::{Extremes, find_extremes, magnitude, pack};
use crate::kernel::blocks::{BLOCK, entry};
use crate::types::BlockParams;

/// Greatest factor by which a row is brightened to give it its sum back.
const BRIGHTEN_LIMIT: f32 = 2.0;

/// Entries along the edge of a block.
const EDGE: usize = BLOCK as usize;

impl BlockMatrix {
    /// Brings a matrix with entries ≥ 0 into blocks. `rows(i, row)` gives row i, columns in the order of the patches;
    /// it is called three times for each row. `order` says which rows and columns lie beside each other. The same for
    /// any number of threads.
    ///
    /// `progress(tile rows done, of all)` may stop the work.
    ///
    /// # Errors
    /// [`transport::Error::Setting`] for settings out of range, [`transport::Error::Length`] for an order of another
    /// length, [`transport::Error::TooMany`] beyond 65,536 rows, [`transport::Error::Value`] for an entry that is no
    /// number ≥ 0, and [`transport::Error::Cancelled`].
    pub fn encode(
        n: usize,
        rows: &MatrixRows,
        order: Permutation,
        settings: BlockSettings,
        progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
    ) -> Result<Self, Error> {
        check(n, &order, &settings)?;
        let extremes = find_extremes(n, rows, settings.outliers)?;
        let norm = norm(&extremes);
        let mut matrix = Self {
            settings,
            words: Vec::new(),
            scales: Vec::new(),
            outliers: Outliers { start: vec![0], entries: Vec::new() },
            row_scales: vec![Vec4::ZERO; n],
            permutation: order,
            report: BlockReport { row_scaled_up: 1.0, row_scaled_down: 1.0, ..BlockReport::default() },
        };
        let source = Source {
            n,
            rows,
            order: &matrix.permutation,
            norm,
            threshold: extremes.threshold * norm,
            filling: settings.filling,
        };
        let params = params(n, &settings);
        let all: Vec<usize> = (0..n.div_ceil(settings.tile)).collect();
        let encoded = in_parallel(&all, progress, |t| source.encode(t, &settings, &params))?;
        let mut error = 0.0;
        let mut square = 0.0;
        let mut permuted_index = 0;
        let mut in_blocks = InBlocks::default();
        for tile in encoded {
            matrix.words.extend(tile.words);
            matrix.scales.extend(tile.scales);
            matrix.outliers.entries.extend(tile.outliers);
            for (count, factor) in tile.rows {
                let i = matrix.permutation.order()[permuted_index] as usize;
                let last = matrix.outliers.start[permuted_index];
                matrix.outliers.start.push(last + count);
                matrix.row_scales[i] = (factor / norm).extend(0.0);
                matrix.report.row_scaled_up = matrix.report.row_scaled_up.max(factor.max_element());
                matrix.report.row_scaled_down = matrix.report.row_scaled_down.min(factor.min_element());
                permuted_index += 1;
            }
            error += tile.error;
            square += tile.square;
            in_blocks.add(tile.in_blocks);
        }
        let unit = f64::from(norm) * f64::from(norm);
        matrix.report.frobenius = if square > 0.0 { (error / square).sqrt() } else { 0.0 };
        matrix.report.mse = error / unit / (3.0 * (n * n).max(1) as f64);
        matrix.report.block_mse = in_blocks.mse() / unit;
        Ok(matrix)
    }

    /// [`BlockReport::block_mse`] in an order, found from every `step`-th row of tiles: how good an order is, without a
    /// matrix. `progress` as in [`Self::encode`].
    ///
    /// # Errors
    /// As [`Self::encode`].
    pub fn order_mse(
        n: usize,
        rows: &MatrixRows,
        order: &Permutation,
        settings: BlockSettings,
        step: usize,
        progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
    ) -> Result<f64, Error> {
        check(n, order, &settings)?;
        let extremes = find_extremes(n, rows, settings.outliers)?;
        let norm = norm(&extremes);
        let source = Source { n, rows, order, norm, threshold: extremes.threshold * norm, filling: settings.filling };
        let params = params(n, &settings);
        let chosen: Vec<usize> = (0..n.div_ceil(settings.tile)).step_by(step.max(1)).collect();
        let encoded = in_parallel(&chosen, progress, |t| source.encode(t, &settings, &params).in_blocks)?;
        let mut all = InBlocks::default();
        encoded.into_iter().for_each(|one| all.add(one));
        Ok(all.mse() / (f64::from(norm) * f64::from(norm)))
    }
}

/// The factor that makes the greatest entry 1: halves reach from 6·10⁻⁸ to 65,504.
fn norm(extremes: &Extremes) -> f32 {
    if extremes.largest > 0.0 { 1.0 / extremes.largest } else { 1.0 }
}

/// Work on rows of tiles, on all cores.
fn in_parallel<T: Send>(
    chosen: &[usize],
    progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
    work: impl Fn(usize) -> T + Sync,
) -> Result<Vec<T>, Error> {
    let done = AtomicUsize::new(0);
    let stop = AtomicBool::new(false);
    let made: Vec<Option<T>> = chosen
        .par_iter()
        .map(|&t| {
            if stop.load(Ordering::Relaxed) {
                return None;
            }
            let made = work(t);
            let count = done.fetch_add(1, Ordering::Relaxed) + 1;
            if progress(count, chosen.len()).is_break() {
                stop.store(true, Ordering::Relaxed);
            }
            Some(made)
        })
        .collect();
    if stop.load(Ordering::Relaxed) {
        return Err(transport::Error::Cancelled { done: done.load(Ordering::Relaxed), total: chosen.len() }.into());
    }
    Ok(made.into_iter().flatten().collect())
}

/// Squared errors of the entries that blocks hold.
#[derive(Clone, Copy, Default)]
struct InBlocks {
    error: f64,
    count: u64,
}

impl InBlocks {
    fn add(&mut self, more: Self) {
        self.error += more.error;
        self.count += more.count;
    }

    fn mse(&self) -> f64 {
        self.error / (3 * self.count.max(1)) as f64
    }
}

fn check(n: usize, order: &Permutation, settings: &BlockSettings) -> Result<(), Error> {
    check_length("order", n, order.len())?;
    if n > 1 << 16 {
        return Err(
            transport::Error::TooMany { name: "rows of a matrix in blocks", found: n as u64, limit: 1 << 16 }.into()
        );
    }
    if !(0.0..=1.0).contains(&settings.outliers) {
        return Err(
            transport::Error::Setting { name: "outliers", value: settings.outliers, rule: "from 0 to 1" }.into()
        );
    }
    if !settings.tile.is_power_of_two() || !(EDGE..=1024).contains(&settings.tile) {
        return Err(transport::Error::Setting {
            name: "tile",
            value: settings.tile as f64,
            rule: "a power of two from 4 to 1024",
        }
        .into());
    }
    Ok(())
}

/// The matrix to be encoded.
struct Source<'a> {
    n: usize,
    rows: &'a MatrixRows<'a>,
    order: &'a Permutation,
    /// Factor that makes the greatest entry 1.
    norm: f32,
    /// Entries above it, after that factor, are outliers.
    threshold: f32,
    /// Block values in the place of outliers.
    filling: Filling,
}

/// A row of tiles.
struct TileRow {
    words: Vec<u32>,
    scales: Vec<Vec4>,
    /// Outliers of each row, and the factor that restores its sum.
    rows: Vec<(u32, Vec3)>,
    outliers: Vec<UVec2>,
    error: f64,
    square: f64,
    in_blocks: InBlocks,
}

impl Source<'_> {
    fn encode(&self, tile_row: usize, settings: &BlockSettings, params: &BlockParams) -> TileRow {
        let tile = settings.tile;
        let width = self.n.next_multiple_of(EDGE);
        let first = tile_row * tile;
        let rows = tile.min(self.n - first);
        let values = self.load(first, rows, width);
        let (filled, scales) = self.fill(&values, rows, width, tile);
        let mut words = Vec::new();
        let mut decoded = vec![Vec3::ZERO; values.len()];
        for (strip, decoded) in filled.chunks(EDGE * width).zip(decoded.chunks_mut(EDGE * width)) {
            let texels: Vec<Vec3> = strip
                .iter()
                .enumerate()
                .map(|(k, value)| settings.companding.compress(relative(*value, scales[k % width / tile])))
                .collect();
            let blocks = compress(settings.codec, &texels, width);
            for (column, block) in blocks.chunks(settings.codec.block_words()).enumerate() {
                let at = |k: usize| block.get(k).map_or(0, |w| *w);
                let block = UVec4::new(at(0), at(1), at(2), at(3));
                for k in 0..EDGE * EDGE {
                    let j = column * EDGE + k % EDGE;
                    let value = entry(decode_texel(settings.codec, block, k as u32), params);
                    decoded[k / EDGE * width + j] = value * scales[j / tile].truncate();
                }
            }
            words.extend(blocks);
        }
        let mut result = TileRow {
            words,
            scales,
            rows: Vec::new(),
            outliers: Vec::new(),
            error: 0.0,
            square: 0.0,
            in_blocks: InBlocks::default(),
        };
        for row in 0..rows {
            let range = row * width..row * width + self.n;
            self.finish_row(&values[range.clone()], &mut decoded[range], &mut result);
        }
        result
    }

    /// Rows in the order of the blocks, `rows` of them and up to a whole block of zeros.
    fn load(&self, first: usize, rows: usize, width: usize) -> Vec<Vec3> {
        let mut values = vec![Vec3::ZERO; rows.next_multiple_of(EDGE) * width];
        let mut row = vec![Vec3::ZERO; self.n];
        for (i, values) in values.chunks_mut(width).take(rows).enumerate() {
            (self.rows)(self.order.order()[first + i] as usize, &mut row);
            for (value, &j) in values.iter_mut().zip(self.order.order()) {
                *value = row[j as usize] * self.norm;
            }
        }
        values
    }

    /// The values with the mean of their block in place of outliers and of what lies beyond the matrix, so that these
    /// bend no palette, or zeros there; and the greatest that is left of each tile.
    fn fill(&self, values: &[Vec3], rows: usize, width: usize, tile: usize) -> (Vec<Vec3>, Vec<Vec4>) {
        let mut filled = values.to_vec();
        let mut scales = vec![Vec4::ZERO; self.n.div_ceil(tile)];
        for block_row in (0..values.len() / width).step_by(EDGE) {
            for block_column in (0..width).step_by(EDGE) {
                let at = |k: usize| (block_row + k / EDGE, block_column + k % EDGE);
                let counts = |(i, j): (usize, usize)| {
                    i < rows && j < self.n && magnitude(values[i * width + j]) <= self.threshold
                };
                let mut sum = Vec3::ZERO;
                let mut count = 0u32;
                for (i, j) in (0..EDGE * EDGE).map(at).filter(|&p| counts(p)) {
                    sum += values[i * width + j];
                    count += 1;
                    let scale = &mut scales[j / tile];
                    *scale = scale.max(values[i * width + j].extend(0.0));
                }
                let mean = match self.filling {
                    Filling::Mean => sum / count.max(1) as f32,
                    Filling::Zeros => Vec3::ZERO,
                };
                for (i, j) in (0..EDGE * EDGE).map(at).filter(|&p| !counts(p)) {
                    filled[i * width + j] = mean;
                }
            }
        }
        (filled, scales)
    }

    /// Adds the outliers of a row to what was decoded, and takes sums and errors. An outlier's correction is what the
    /// block lacks in its place, so the entry is exact but for the rounding to halves.
    fn finish_row(&self, values: &[Vec3], decoded: &mut [Vec3], result: &mut TileRow) {
        let before = result.outliers.len();
        let mut sum = [0.0f64; 3];
        let mut decoded_sum = [0.0f64; 3];
        for (k, (value, decoded)) in values.iter().zip(decoded.iter_mut()).enumerate() {
            if magnitude(*value) > self.threshold {
                let words = pack(k as u32, *value - *decoded);
                *decoded += unpack(words);
                result.outliers.push(words);
            } else {
                let error = f64::from((*decoded - *value).length_squared());
                result.in_blocks.add(InBlocks { error, count: 1 });
            }
            for c in 0..3 {
                sum[c] += f64::from(value[c]);
                decoded_sum[c] += f64::from(decoded[c]);
            }
        }
        let color = |sum: [f64; 3]| Vec3::from_array(sum.map(|s| s as f32));
        let factor = row_factor(color(sum), color(decoded_sum), BRIGHTEN_LIMIT);
        for (value, decoded) in values.iter().zip(decoded) {
            result.error += f64::from((*decoded * factor - *value).length_squared());
            result.square += f64::from(value.length_squared());
        }
        result.rows.push(((result.outliers.len() - before) as u32, factor));
    }
}

/// A value in units of its tile's scale.
fn relative(value: Vec3, scale: Vec4) -> Vec3 {
    let one = |v: f32, s: f32| if s > 0.0 { (v / s).clamp(0.0, 1.0) } else { 0.0 };
    Vec3::new(one(value.x, scale.x), one(value.y, scale.y), one(value.z, scale.z))
}

/// Blocks of a strip of four rows of texels in [0, 1].
///
/// Slower settings of the encoders gain little: at 2,000 clusters of Sponza, BC7 `very_fast` has 1.05 and BC6H `fast`
/// 1.02 times the squared error of the settings that take 1.6 and 2 times as long.
fn compress(codec: BlockCodec, texels: &[Vec3], width: usize) -> Vec<u32> {
    let (variant, w) = match codec {
        BlockCodec::Bc1 => (CompressionVariant::BC1, width as u32),
        BlockCodec::Bc3 => (CompressionVariant::BC3, width as u32),
        BlockCodec::Bc6h => (CompressionVariant::BC6H(BC6HSettings::fast()), width as u32),
        BlockCodec::Bc7 => (CompressionVariant::BC7(BC7Settings::opaque_very_fast()), width as u32),
    };
    let mut words = vec![0u32; width / EDGE * codec.block_words()];
    let blocks = bytemuck::cast_slice_mut(&mut words);
    if codec == BlockCodec::Bc6h {
        let halves: Vec<f16> = texels.iter().flat_map(|t| [t.x, t.y, t.z, 1.0]).map(f16::from_f32).collect();
        compress_rgba16(variant, &halves, blocks, w, BLOCK, 4 * w);
    } else {
        let texels = if codec == BlockCodec::Bc3 {
            with_alpha(texels, width)
        } else {
            texels.iter().map(|t| t.extend(1.0)).collect()
        };
        let bytes: Vec<u8> = texels.iter().flat_map(|t| t.to_array()).map(|x| (255.0 * x + 0.5) as u8).collect();
        compress_rgba8(variant, &bytes, blocks, w, BLOCK, 4 * w);
    }
    words
}

/// The greatest channel as alpha, the colours relative to it; black takes the colour of its block.
fn with_alpha(texels: &[Vec3], width: usize) -> Vec<Vec4> {
    let unit = |color: Vec3| if color.max_element() > 0.0 { color / color.max_element() } else { Vec3::ONE };
    let mean = |column: usize| -> Vec3 {
        (0..EDGE * EDGE).map(|k| texels[k / EDGE * width + column / EDGE * EDGE + k % EDGE]).sum()
    };
    texels
        .iter()
        .enumerate()
        .map(|(k, &texel)| {
            let alpha = texel.max_element();
            unit(if alpha > 0.0 { texel } else { mean(k % width) }).extend(alpha)
        })
        .collect()
}
