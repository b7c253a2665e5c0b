//! Operators in tiles: rank-1 terms, dense sub-blocks and sparse residual.

mod dense_sparse;
mod encode;
mod lanes;
mod product;
mod rectangular;
mod reduce;
mod source;
mod symmetric;

use alloc::vec::Vec;

use faer::Mat;
use glam::Vec4;
use transport::check_length;

use crate::error::Error;
use crate::host::solve::Factors;
#[cfg(feature = "std")]
use crate::host::stored::StoredOperator;
use crate::kernel::low_rank::{GROUP_VECTORS, LANES, NO_VECTOR, PERMUTED_INDICES, RUN_GROUPS, SUB_BLOCK_WORDS, TILE};
use crate::types::{PackedGroup, SubBlock};

pub(super) use reduce::SIDE;

pub use dense_sparse::{DenseSparseTables, dense_sparse_all};
pub use product::{
    LowRankWorkspace, UTables, VtTables, multiply_u_all, multiply_vt_all, permute_in_all, permute_out_all,
    quantise_all, requantise_all,
};
pub use rectangular::SparseRows;

/// Most patches: entries name columns by 16 bits.
pub const MAX_TILE_PATCHES: usize = PERMUTED_INDICES - TILE as usize;

/// Most receivers: vectors name blocks by 16 bits.
pub const MAX_TILE_RECEIVERS: usize = SIDE << 16;

/// The rows or the columns of an operator.
#[derive(Clone, Copy, Debug)]
pub struct TileSide<'a> {
    /// Area that each of them stands for, m².
    pub area: &'a [f32],
    /// Which of them is at each permuted index of an order in which neighbours are alike ([`crate::halving_order`]).
    pub order: &'a [u32],
}

/// Input of [`LowRank::encode`].
#[derive(Clone, Copy)]
pub enum TileSource<'a> {
    /// Operators that are symmetric by the areas of the patches, which are both rows and columns.
    Symmetric {
        /// The operators of the colour channels.
        channels: Channels<'a>,
        /// Their rows and columns.
        patches: TileSide<'a>,
    },
    /// The rows of any operator, one channel for all colours.
    Rows {
        /// Columns and values of each row.
        rows: &'a SparseRows<'a>,
        /// The rows: where irradiance is wanted.
        receivers: TileSide<'a>,
        /// The columns: what sends light.
        patches: TileSide<'a>,
    },
}

/// The symmetric operators of the colour channels, `T̂ = a^½ T a^-½`.
#[derive(Clone, Copy, Debug)]
pub enum Channels<'a> {
    /// One for all three: form factors.
    One(&'a Mat<f32>),
    /// Red, green, blue.
    Three([&'a Mat<f32>; 3]),
    /// Red, green, blue in files that have the order of the tiles: a tile of them is held at a time.
    #[cfg(feature = "std")]
    Stored([&'a StoredOperator; 3]),
    /// One for all three, of reciprocal form factors: no dense matrix is made.
    Factors(Factors<'a>),
}

/// An operator from columns j that send light to rows i that receive it, `H = T B`, as
/// `T̂ = a_r^½ T a_c^-½ ≈ Σ_k u_k s_k v_kᵀ + D + S` with the areas a of rows and columns. It is cut
/// into tiles of [`TILE`] rows and columns, each the sum of a few rank-1 terms of 4 or 8 bits, of
/// dense sub-blocks of 8 bits and of a sparse residual of 16 bits; a tile may have none of them.
///
/// A rank-1 term is kept when it lowers the rate–distortion cost, the squared error plus λ times the
/// bytes; sub-blocks and entries of the residual likewise. λ is found so that the whole has the error
/// that was asked for. Errors that are even over neighbouring columns are weighted by the cube root of
/// their extent when rank-1 terms are found: light is even over neighbours and adds them up. So the error of the
/// entries is not the least that so many bytes can have, but that of irradiance is about half of
/// what it then would be.
///
/// *Symmetric* operators, whose rows and columns are the same patches, have the upper triangle of
/// tiles only, and every pair of vectors serves both ways: `columns` is `None`. Their three colour
/// channels share what they have in common: green is the common part. Red and blue are stored as
/// differences to it, which have far fewer rank-1 terms, because the light that arrives directly is
/// the same, rotated into their two chroma axes (KLT), the first of which has most of both: where
/// walls are of one hue, red and blue differ from green alike.
///
/// The vectors of the columns make sums ([`crate::multiply_vt_all`]), by which those of the rows are
/// multiplied ([`crate::multiply_u_all`]).
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LowRank {
    /// Column at each permuted index.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub order: Vec<u32>,
    /// Permuted index of each row.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub permuted_index: Vec<u32>,
    /// `√a` of each row, m.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub row_sqrt_area: Vec<f32>,
    /// Runs of the rows' block b: `run_start[b]..run_start[b + 1]`.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub run_start: Vec<u32>,
    /// Packed groups of run k, which have equal channels and bits: `groups[runs[k]..runs[k + 1]]`, at most
    /// [`RUN_GROUPS`].
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub runs: Vec<u32>,
    /// The rows' vectors in packed groups, block by block, those with equal channels and bits
    /// together; zeros fill up the last of them. Vector index `4 k + m` is vector m of group k.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub groups: Vec<PackedGroup>,
    /// Elements of the rows' vectors, in `u32x16`s of [`LANES`] words.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub words: Vec<u32>,
    /// Vectors of the columns, or `None` where rows and columns are the same.
    pub columns: Option<ColumnVectors>,
    /// Red and blue of the first chroma axis, then of the second,
    /// [`crate::kernel::low_rank::chroma_weights`].
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::value"))]
    pub chroma_axes: Vec4,
    /// Factor on the sum of each vector of the columns.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub scale: Vec<f32>,
    /// Index of the paired singular vector of each of the rows' vectors, which its sum multiplies;
    /// [`NO_VECTOR`] where there is none.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub paired: Vec<u32>,
    /// Dense sub-blocks of each [`LANES`] rows: `sub_block_start[k]..sub_block_start[k + 1]`,
    /// `[blocks · PARTS + 1]`.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub sub_block_start: Vec<u32>,
    /// Dense sub-blocks; those of symmetric operators in both of their rows.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub sub_blocks: Vec<SubBlock>,
    /// Their elements of 8 bits, [`SUB_BLOCK_WORDS`] each.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub sub_block_words: Vec<u32>,
    /// Entries of the sparse residual of each permuted row, `[blocks · TILE + 1]`.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub row_start: Vec<u32>,
    /// The column's permuted index in the lower 16 bits, value in the upper.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub entries: Vec<u32>,
    /// Quantisation step of the values of each permuted row.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub steps: Vec<f32>,
    /// Loss by compression.
    pub report: TileReport,
}

/// The columns of an operator that are not its rows.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ColumnVectors {
    /// `√a` of each column, m.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub sqrt_area: Vec<f32>,
    /// First packed group of each run, and the end of the last.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub runs: Vec<u32>,
    /// The columns' vectors, as [`LowRank::groups`].
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub groups: Vec<PackedGroup>,
    /// Their elements, in `u32x16`s of [`LANES`] words.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub words: Vec<u32>,
}

/// Report on how an operator was stored.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TileReport {
    /// Relative Frobenius error of each channel.
    pub error: [f64; 3],
    /// Tiles that are empty, without rank-1 terms, with them.
    pub tiles: [usize; 3],
    /// Rank-1 terms for all channels, and of the differences.
    pub terms: [usize; 2],
    /// Most rank-1 terms of a tile.
    pub most_rank: usize,
    /// Dense sub-blocks of the upper triangle.
    pub sub_blocks: usize,
    /// Entries of the sparse residual of the upper triangle.
    pub entries: usize,
}

impl LowRank {
    /// Returns true if rows and columns are the same patches.
    pub fn is_symmetric(&self) -> bool {
        self.columns.is_none()
    }

    /// Blocks of [`TILE`] rows.
    pub fn blocks(&self) -> usize {
        self.permuted_index.len().div_ceil(SIDE)
    }

    /// Blocks of [`TILE`] columns.
    pub fn column_blocks(&self) -> usize {
        self.order.len().div_ceil(SIDE)
    }

    /// `√a` of each column, m.
    pub fn column_sqrt_area(&self) -> &[f32] {
        self.columns.as_ref().map_or(&self.row_sqrt_area, |columns| &columns.sqrt_area)
    }

    /// First packed group of each run of the columns, and the end of the last.
    pub fn column_runs(&self) -> &[u32] {
        self.columns.as_ref().map_or(&self.runs, |columns| &columns.runs)
    }

    /// Bytes of each part that a product reads.
    pub fn bytes_by_part(&self) -> [(&'static str, u64); 4] {
        let pairing = size_of_val(&self.scale[..]) + size_of_val(&self.paired[..]);
        let mut vectors = self.u_tables().bytes() + pairing;
        let mut indices =
            size_of_val(&self.order[..]) + size_of_val(&self.permuted_index[..]) + size_of_val(&self.row_sqrt_area[..]);
        if let Some(ColumnVectors { sqrt_area, runs, groups, words }) = &self.columns {
            vectors += size_of_val(&runs[..]) + size_of_val(&groups[..]) + size_of_val(&words[..]);
            indices += size_of_val(&sqrt_area[..]);
        }
        let [sub_blocks, entries] = self.dense_sparse_tables().bytes();
        [
            ("vectors", vectors as u64),
            ("squares", sub_blocks as u64),
            ("entries", entries as u64),
            ("places", indices as u64),
        ]
    }

    /// Bytes of what does not follow from the rest. Of symmetric operators: entries once, not for both of their rows;
    /// scale and paired vector once for both vectors of a rank-1 term; not `permuted_index`.
    pub fn stored_bytes(&self) -> u64 {
        let whole = self.bytes_by_part().iter().map(|part| part.1).sum::<u64>();
        if !self.is_symmetric() {
            return whole;
        }
        let sub_blocks = self.sub_blocks.len() - self.report.sub_blocks.min(self.sub_blocks.len());
        let entries = self.entries.len() - self.report.entries.min(self.entries.len());
        let mirrored = entries + sub_blocks * (SUB_BLOCK_WORDS as usize + size_of::<SubBlock>() / size_of::<u32>());
        let terms: usize = self.report.terms.iter().sum();
        let follows = mirrored + 2 * terms.min(self.scale.len() / 2) + self.permuted_index.len();
        whole - (follows * size_of::<u32>()) as u64
    }

    /// Checks that the tables belong together, so that no product reads beyond them.
    ///
    /// # Errors
    /// [`transport::Error::Length`], [`transport::Error::Value`], naming the table and the entry.
    pub fn check(&self) -> Result<(), Error> {
        let rows = self.permuted_index.len();
        let columns = self.order.len();
        check_length("sqrt_area", rows, self.row_sqrt_area.len())?;
        check_length("sqrt_area of columns", columns, self.column_sqrt_area().len())?;
        if let Some(own) = &self.columns {
            check_bank(&own.runs, &own.groups, &own.words, self.column_blocks())?;
        }
        let VtTables { groups, .. } = self.vt_tables();
        let vectors = GROUP_VECTORS as usize * groups.len();
        check_length("scale", vectors, self.scale.len())?;
        check_length("paired", GROUP_VECTORS as usize * self.groups.len(), self.paired.len())?;
        self.u_tables().check(self.blocks())?;
        self.dense_sparse_tables().check(self.blocks(), self.column_blocks())?;
        check_below("order", self.order.iter().copied(), columns)?;
        check_below("permuted_index", self.permuted_index.iter().copied(), rows)?;
        let paired = self.paired.iter().map(|&index| if index == NO_VECTOR { 0 } else { index });
        check_below("paired", paired, vectors.max(usize::from(!self.groups.is_empty())))?;
        check_finite("scale", self.scale.iter().copied())?;
        check_sqrt_area("sqrt_area", &self.row_sqrt_area)?;
        check_sqrt_area("sqrt_area of columns", self.column_sqrt_area())
    }
}

/// Permuted index of each patch in an order of all of them.
pub(super) fn permuted_indices(order: &[u32]) -> Result<Vec<u32>, Error> {
    let mut permuted_index = vec![u32::MAX; order.len()];
    for (p, &i) in order.iter().enumerate() {
        match permuted_index.get_mut(i as usize) {
            Some(index) if *index == u32::MAX => *index = p as u32,
            _ => {
                return Err(transport::Error::Value {
                    name: "order",
                    index: p,
                    value: f64::from(i),
                    rule: "every patch once",
                }
                .into());
            }
        }
    }
    Ok(permuted_index)
}

fn check_starts(name: &'static str, starts: &[u32], end: usize) -> Result<(), Error> {
    let last = starts.last().map_or(0, |&k| k as usize);
    check_length(name, end, last)?;
    match starts.windows(2).position(|w| w[0] > w[1]) {
        Some(index) => {
            Err(transport::Error::Value { name, index, value: f64::from(starts[index]), rule: "ascending" }.into())
        }
        None => Ok(()),
    }
}

/// Vectors of so many blocks: runs, their packed groups, and the words of these.
fn check_bank(runs: &[u32], groups: &[PackedGroup], words: &[u32], blocks: usize) -> Result<(), Error> {
    check_length("runs", runs.len().max(1), runs.len())?;
    let vectors: usize = groups.iter().map(|group| (GROUP_VECTORS * group.vector_len()) as usize).sum();
    check_length("words", vectors * LANES as usize, words.len())?;
    check_starts("runs", runs, groups.len())?;
    check_below("groups", groups.iter().map(|group| group.block()), blocks)?;
    check_below(
        "groups",
        groups.iter().map(|group| group.start.saturating_add(GROUP_VECTORS * group.vector_len() - 1)),
        vectors,
    )?;
    for (k, run) in runs.windows(2).enumerate() {
        let groups = &groups[run[0] as usize..run[1] as usize];
        let follow = groups
            .windows(2)
            .all(|w| w[0].tag == w[1].tag && w[0].start + GROUP_VECTORS * w[0].vector_len() == w[1].start);
        if groups.len() > RUN_GROUPS as usize || !follow {
            let rule = "the first of a few packed groups with equal channels and bits, one after another";
            return Err(transport::Error::Value { name: "runs", index: k, value: f64::from(run[0]), rule }.into());
        }
    }
    Ok(())
}

fn check_below(name: &'static str, mut table: impl Iterator<Item = u32> + Clone, limit: usize) -> Result<(), Error> {
    match table.clone().position(|k| k as usize >= limit) {
        Some(index) => {
            let value = table.nth(index).map_or(f64::NAN, f64::from);
            Err(transport::Error::Value { name, index, value, rule: "in its range" }.into())
        }
        None => Ok(()),
    }
}

fn check_finite(name: &'static str, mut table: impl Iterator<Item = f32>) -> Result<(), Error> {
    match table.position(|x| !x.is_finite()) {
        Some(index) => Err(transport::Error::Value { name, index, value: f64::NAN, rule: "finite" }.into()),
        None => Ok(()),
    }
}

fn check_sqrt_area(name: &'static str, sqrt_area: &[f32]) -> Result<(), Error> {
    match sqrt_area.iter().position(|r| !(r.is_finite() && *r > 0.0)) {
        Some(index) => {
            Err(transport::Error::Value { name, index, value: f64::from(sqrt_area[index]), rule: "positive" }.into())
        }
        None => Ok(()),
    }
}
