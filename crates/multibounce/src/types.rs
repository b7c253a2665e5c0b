//! The plain data that CPU and GPU share, field for field.

use bytemuck::{Pod, Zeroable};

/// Settings of the products with a matrix in blocks: some rows of blocks times the whole vector.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct BlockParams {
    /// Rows of blocks that are bound.
    pub block_rows: u32,
    /// Blocks in a row.
    pub block_columns: u32,
    /// First row of blocks that is bound.
    pub first_block_row: u32,
    /// Rows of the whole matrix.
    pub rows: u32,
    /// Tiles in a row.
    pub tile_columns: u32,
    /// Logarithm to base 2 of the blocks along a tile's edge.
    pub tile_shift: u32,
    /// Companding of entries: 0 none, 1 by square roots, 2 by logarithms ([`crate::kernel::blocks::expand`]).
    pub companding: u32,
    /// 1 where an entry is a texel's colour times its alpha, 0 where its alpha is not used.
    pub alpha: u32,
    /// Number of the first entry of the side table that is bound.
    pub first_outlier: u32,
}
const _: () = assert!(size_of::<BlockParams>() == 36);

/// A bounce of feedback, [`crate::kernel::feedback::change`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct FeedbackParams {
    /// Number of patches.
    pub count: u32,
    /// Step towards the light of a plain bounce.
    pub step: f32,
    /// Share of the last change that is made again.
    pub momentum: f32,
}
const _: () = assert!(size_of::<FeedbackParams>() == 12);

/// Some rows of `F + F diag(ρ) T`, [`crate::kernel::multiply::multiply`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct MultiplyParams {
    /// Number of tiles: those of the rows that are bound, for all columns.
    pub tiles: u32,
    /// Tiles from the first to the last row that is bound.
    pub row_tiles: u32,
    /// Vectors of a row, a multiple of [`crate::kernel::multiply::TILE_VECTORS`].
    pub vectors: u32,
    /// Vectors of columns of F whose rows of T are bound.
    pub inner: u32,
    /// The first of them; from 0 on, sums begin with F.
    pub first_inner: u32,
}
const _: () = assert!(size_of::<MultiplyParams>() == 20);

/// A step of elimination, [`crate::kernel::invert`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct InvertParams {
    /// Number of vectors to make, or of tiles.
    pub count: u32,
    /// Vectors of a row, of four columns each, a multiple of [`crate::kernel::multiply::TILE_VECTORS`].
    pub vectors: u32,
    /// First row of the block that is eliminated, a multiple of [`crate::kernel::invert::PIVOT_ROWS`].
    pub pivot: u32,
    /// First row of the matrix that is bound, a multiple of the same.
    pub first_row: u32,
    /// Rows that are bound, a multiple of the same.
    pub rows: u32,
    /// First vector of the block's rows that is wanted.
    pub first_vector: u32,
    /// Vectors of the block's rows that are wanted.
    pub width: u32,
}
const _: () = assert!(size_of::<InvertParams>() == 28);

/// A packed group of [`crate::LowRank`]: four vectors of one block that are for one colour.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct PackedGroup {
    /// First `u32x16`, of [`crate::kernel::low_rank::LANES`] words, of the first vector; the others' follow.
    pub start: u32,
    /// The block in the lower 16 bits; then the colour that the vectors are for: a chroma axis, 0 or 1, or
    /// [`crate::kernel::low_rank::ALL_CHANNELS`]; then 1 where elements have 4 bits instead of 8.
    pub tag: u32,
}
const _: () = assert!(size_of::<PackedGroup>() == 8);

/// A dense sub-block of [`crate::LowRank`]: [`crate::kernel::low_rank::LANES`] rows and columns.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SubBlock {
    /// First column, in edges of sub-blocks.
    pub column: u32,
    /// Quantisation step of its values.
    pub step: f32,
}
const _: () = assert!(size_of::<SubBlock>() == 8);

impl PackedGroup {
    /// Vectors of a block, for a colour, with elements of 4 or 8 bits.
    #[inline]
    pub fn new(start: u32, block: u32, color: u32, is_short: bool) -> Self {
        Self { start, tag: (block & 0xffff) | (color & 3) << 16 | u32::from(is_short) << 18 }
    }

    /// Block of rows or columns that the vectors belong to.
    #[inline]
    pub fn block(self) -> u32 {
        self.tag & 0xffff
    }

    /// Colour that they are for.
    #[inline]
    pub fn color(self) -> u32 {
        self.tag >> 16 & 3
    }

    /// Returns true if their elements have 4 bits.
    #[inline]
    pub fn is_short(self) -> bool {
        self.tag >> 18 & 1 == 1
    }

    /// `u32x16`s of a vector.
    #[inline]
    pub fn vector_len(self) -> u32 {
        2 - (self.tag >> 18 & 1)
    }

    /// One of the vectors; beyond the four, one of the groups that follow in a run.
    #[inline]
    pub fn vector(self, k: u32) -> TileVector {
        TileVector { start: self.start + k * self.vector_len(), is_short: self.is_short() }
    }
}

/// A vector of a rank-1 term.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileVector {
    /// Its first `u32x16`.
    pub start: u32,
    /// True if its elements have 4 bits.
    pub is_short: bool,
}
