//! A matrix in texture blocks with its largest entries beside them (thesis, chapter 3).

#[cfg(feature = "texture-blocks")]
mod encode;
mod planes;
mod product;

use alloc::vec;
use alloc::vec::Vec;
use glam::{UVec4, Vec3, Vec4};
use scene::parallel::*;
use transport::{Permutation, check_length};

use super::order::MatrixRows;
use super::outliers::Outliers;
use crate::error::Error;
use crate::kernel::blocks::{
    BLOCK, Bc1, Bc3, Bc6h, Bc7, BlockFormat, COMPANDING_LOG2, COMPANDING_NONE, COMPANDING_SQRT, entry,
    widen_signed_half,
};
use crate::types::BlockParams;

/// Texture format of the blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum BlockCodec {
    /// Half a byte an entry: four colours on a line.
    Bc1,
    /// A byte an entry: the greatest channel as alpha, eight values a block; the colour relative to it as in BC1.
    Bc3,
    /// A byte an entry: half-precision colours on up to two lines.
    Bc6h,
    /// A byte an entry: 8-bit colours on up to three lines.
    Bc7,
}

impl BlockCodec {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Bc1, Self::Bc3, Self::Bc6h, Self::Bc7];

    /// Words of a block of 16 entries.
    pub fn block_words(self) -> usize {
        if self == Self::Bc1 { 2 } else { 4 }
    }
}

/// Companding of entries before they are quantised, so that small ones keep more of their precision.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Companding {
    /// Not at all.
    None,
    /// Square roots.
    Sqrt,
    /// Logarithms, `c = log2(1 + 255 m) / 8`.
    Log2,
}

impl Companding {
    /// The number by which kernels know it.
    pub fn id(self) -> u32 {
        match self {
            Self::None => COMPANDING_NONE,
            Self::Sqrt => COMPANDING_SQRT,
            Self::Log2 => COMPANDING_LOG2,
        }
    }

    /// `c(x)` for x in [0, 1]; [`crate::kernel::blocks::expand`] is its inverse.
    #[cfg(feature = "texture-blocks")]
    fn compress(self, x: Vec3) -> Vec3 {
        match self {
            Self::None => x,
            Self::Sqrt => x.map(scene::math::sqrt),
            Self::Log2 => x.map(|x| libm::log2f(1.0 + 255.0 * x) * (1.0 / 8.0)),
        }
    }
}

/// Block values in the place of outliers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Filling {
    /// The mean of the rest of their block, which bends no palette.
    #[default]
    Mean,
    /// Zeros, as printed [T 3].
    Zeros,
}

/// Settings of the compression of a matrix into blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BlockSettings {
    /// Texture format.
    pub codec: BlockCodec,
    /// Companding.
    pub companding: Companding,
    /// Share of the entries that are kept as outliers, the greatest ones; 0 to 1.
    pub outliers: f64,
    /// Entries along the edge of a tile, which shares a scale for each channel: a power of two, 4 to 1024.
    pub tile: usize,
    /// Block values in the place of outliers.
    pub filling: Filling,
}

impl BlockSettings {
    /// So many outliers that all takes at most a third of what one number of single precision an entry would, from some
    /// 1,000 rows on: 5 %, and 3.8 % where blocks take a byte an entry.
    pub fn of(codec: BlockCodec) -> Self {
        let outliers = if codec == BlockCodec::Bc1 { 0.05 } else { 0.038 };
        Self { codec, outliers, ..Self::default() }
    }
}

impl Default for BlockSettings {
    fn default() -> Self {
        Self { codec: BlockCodec::Bc1, companding: Companding::Sqrt, outliers: 0.05, tile: 64, filling: Filling::Mean }
    }
}

/// Bytes of the parts of a [`BlockMatrix`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlockBytes {
    /// The blocks.
    pub blocks: u64,
    /// The tiles' scales.
    pub scales: u64,
    /// The side table of the greatest entries.
    pub outliers: u64,
    /// Scales of the rows, and the order.
    pub vectors: u64,
}

impl BlockBytes {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.blocks + self.scales + self.outliers + self.vectors
    }
}

/// Loss by compression.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BlockReport {
    /// `‖m' − m‖ / ‖m‖`, Frobenius.
    pub frobenius: f64,
    /// Mean of `(m'_ij − m_ij)²` over entries and channels.
    pub mse: f64,
    /// Mean square error over the entries that are no outliers, as they come from the blocks, before rows are scaled:
    /// what the order of rows and columns decides (thesis, chapter 3).
    pub block_mse: f64,
    /// Greatest factor by which a row had to be scaled to get its sum back.
    pub row_scaled_up: f32,
    /// Least such factor.
    pub row_scaled_down: f32,
}

/// A square RGB matrix with entries ≥ 0, `m = diag(r) Pᵀ (D + O) P`: the order P, blocks D in tiles with scales,
/// outliers O, and scales r of the rows. The product is `H_i = Σ_j m_ij B_j`.
///
/// In the place of an outlier D holds the mean of the rest of its block, which bends no palette (zeros there give 1.6
/// times the squared error with BC1, 1.8 with BC3, at 2,000 clusters of Sponza), and O what is missing: so outliers are
/// exact but for the rounding to halves. The scales of the rows give each row, in each channel, the sum that it had:
/// constant light is kept exactly, and `‖diag(ρ) m‖∞`, which bounds the spectral radius, does not grow.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BlockMatrix {
    settings: BlockSettings,
    permutation: Permutation,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    words: Vec<u32>,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    scales: Vec<Vec4>,
    outliers: Outliers,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    row_scales: Vec<Vec4>,
    report: BlockReport,
}

impl BlockMatrix {
    /// Rows and columns.
    pub fn len(&self) -> usize {
        self.permutation.len()
    }

    /// True without rows.
    pub fn is_empty(&self) -> bool {
        self.permutation.is_empty()
    }

    /// Checks that the tables belong together, so that no product reads beyond them.
    ///
    /// # Errors
    /// [`transport::Error::Length`], [`transport::Error::Value`], naming the table and the entry.
    pub fn check(&self) -> Result<(), Error> {
        let n = self.len();
        let is_sound = Permutation::new(self.permutation.order().to_vec())? == self.permutation;
        let tile = self.settings.tile;
        let is_tile = tile.is_power_of_two() && (BLOCK as usize..1 << 16).contains(&tile);
        transport::check_setting("permutation", n as f64, "the inverse of its inverse", is_sound)?;
        transport::check_setting("edge of a tile", tile as f64, "a power of two of at least a block", is_tile)?;
        let blocks = self.block_count().pow(2);
        check_length("words", blocks * self.settings.codec.block_words(), self.words.len())?;
        check_length("scales", n.div_ceil(tile).pow(2), self.scales.len())?;
        check_length("row_scales", n, self.row_scales.len())?;
        let Outliers { start, entries } = &self.outliers;
        transport::check_offsets("outliers", n, entries.len(), start)?;
        let columns: Vec<u32> = entries.iter().map(|entry| entry.x & 0xffff).collect();
        transport::check_indices("outliers", n, false, &columns)?;
        Ok(())
    }

    /// Settings by which the matrix was brought into blocks.
    pub fn settings(&self) -> BlockSettings {
        self.settings
    }

    /// The order of the blocks' rows and columns.
    pub fn permutation(&self) -> &Permutation {
        &self.permutation
    }

    /// Blocks, row by row, of 2 words (BC1) or 4.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// The blocks, to be changed: for tests of what damage does.
    pub fn words_mut(&mut self) -> &mut [u32] {
        &mut self.words
    }

    /// Scale of each tile in each channel, row by row.
    pub fn scales(&self) -> &[Vec4] {
        &self.scales
    }

    /// The greatest entries, rows and columns in the order of the blocks, less what the blocks hold in their place.
    pub fn outliers(&self) -> &Outliers {
        &self.outliers
    }

    /// Factor of each row and channel, in the order of the patches: `H_i = r_i Σ_k (D + O)_{permuted_index[i] k}
    /// B_{order[k]}`.
    pub fn row_scales(&self) -> &[Vec4] {
        &self.row_scales
    }

    /// Rows, and columns, of blocks.
    pub fn block_count(&self) -> usize {
        self.len().div_ceil(BLOCK as usize)
    }

    /// Kernel parameters for `block_rows` rows of blocks from `first_block_row` on.
    pub fn params(&self, first_block_row: u32, block_rows: u32) -> BlockParams {
        BlockParams { block_rows, first_block_row, ..params(self.len(), &self.settings) }
    }

    /// Bytes of each part.
    pub fn bytes_by_part(&self) -> BlockBytes {
        BlockBytes {
            blocks: size_of_val(&*self.words) as u64,
            scales: size_of_val(&*self.scales) as u64,
            outliers: self.outliers.bytes(),
            vectors: (size_of_val(&*self.row_scales) + size_of_val(self.permutation.order())) as u64,
        }
    }

    /// Errors against the original.
    pub fn report(&self) -> BlockReport {
        self.report
    }

    /// Words of block `k`, zeros after those of BC1.
    fn block(&self, k: usize) -> UVec4 {
        let w = self.settings.codec.block_words();
        let words = &self.words[k * w..(k + 1) * w];
        UVec4::new(words[0], words[1], words.get(2).map_or(0, |w| *w), words.get(3).map_or(0, |w| *w))
    }

    /// Row `i` as the product has it, columns in the order of the patches.
    ///
    /// # Errors
    /// [`transport::Error::Length`] unless `row` has an entry a column; [`transport::Error::Value`] for a row that is
    /// not there.
    pub fn row(&self, i: usize, row: &mut [Vec3]) -> Result<(), Error> {
        let n = self.len();
        check_length("row", n, row.len())?;
        let Some(&permuted_index) = self.permutation.place().get(i) else {
            return Err(transport::Error::Value {
                name: "row",
                index: 0,
                value: i as f64,
                rule: "smaller than the number of rows",
            }
            .into());
        };
        let permuted_index = permuted_index as usize;
        let p = self.params(0, 0);
        let edge = BLOCK as usize;
        let mut ordered = vec![Vec3::ZERO; self.block_count() * edge];
        for (column, entries) in ordered.chunks_mut(edge).enumerate() {
            let words = self.block(permuted_index / edge * self.block_count() + column);
            let tile =
                (permuted_index / self.settings.tile) * p.tile_columns as usize + column * edge / self.settings.tile;
            for (k, slot) in entries.iter_mut().enumerate() {
                let texel = decode_texel(self.settings.codec, words, (permuted_index % edge * edge + k) as u32);
                *slot = entry(texel, &p) * self.scales[tile].truncate();
            }
        }
        let start = &self.outliers.start[permuted_index..permuted_index + 2];
        for words in &self.outliers.entries[start[0] as usize..start[1] as usize] {
            ordered[(words.x & 0xffff) as usize] += unpack(*words);
        }
        for (k, &j) in self.permutation.order().iter().enumerate() {
            row[j as usize] = ordered[k] * self.row_scales[i].truncate();
        }
        Ok(())
    }
}

/// Kernel parameters for n rows, without the range of rows.
fn params(n: usize, settings: &BlockSettings) -> BlockParams {
    BlockParams {
        block_rows: 0,
        block_columns: n.div_ceil(BLOCK as usize) as u32,
        first_block_row: 0,
        rows: n as u32,
        tile_columns: n.div_ceil(settings.tile) as u32,
        tile_shift: (settings.tile as u32 / BLOCK).trailing_zeros(),
        companding: settings.companding.id(),
        alpha: u32::from(settings.codec == BlockCodec::Bc3),
        first_outlier: 0,
    }
}

/// Value of an entry of the side table.
fn unpack(words: glam::UVec2) -> Vec3 {
    Vec3::new(widen_signed_half(words.x >> 16), widen_signed_half(words.y & 0xffff), widen_signed_half(words.y >> 16))
}

fn decode_texel(codec: BlockCodec, words: UVec4, k: u32) -> Vec4 {
    match codec {
        BlockCodec::Bc1 => Bc1::texel(Bc1::parse(words), k),
        BlockCodec::Bc3 => Bc3::texel(Bc3::parse(words), k),
        BlockCodec::Bc6h => Bc6h::texel(Bc6h::parse(words), k),
        BlockCodec::Bc7 => Bc7::texel(Bc7::parse(words), k),
    }
}

/// A square picture of a matrix, `edge` pixels wide, each the mean of its entries: rows and columns in the order given.
/// With `rows` that give the difference of two matrices, a picture of the error.
pub fn picture(n: usize, rows: &MatrixRows, order: &Permutation, edge: usize) -> Vec<Vec3> {
    let edge = edge.min(n).min(order.len());
    let cell = |k: usize| k * n / edge..(k + 1) * n / edge;
    let mut pixels = vec![Vec3::ZERO; edge * edge];
    pixels.par_chunks_mut(edge.max(1)).enumerate().for_each_init(
        || vec![Vec3::ZERO; n],
        |row, (y, line)| {
            for i in cell(y) {
                rows(order.order()[i] as usize, row);
                for (x, pixel) in line.iter_mut().enumerate() {
                    *pixel += cell(x).map(|j| row[order.order()[j] as usize]).sum::<Vec3>();
                }
            }
            for (x, pixel) in line.iter_mut().enumerate() {
                *pixel /= (cell(x).len() * cell(y).len()) as f32;
            }
        },
    );
    pixels
}
