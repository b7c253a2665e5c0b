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
    /// How entries are companded: 0 not, 1 by square roots, 2 by logarithms ([`crate::kernel::blocks::expand`]).
    pub companding: u32,
    /// 1 where an entry is a texel's colour times its alpha, 0 where its alpha says nothing.
    pub alpha: u32,
    /// Number of the first entry of the side table that is bound.
    pub first_outlier: u32,
}
const _: () = assert!(size_of::<BlockParams>() == 36);

/// One of the two vectors of a component of [`crate::Tiles`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct TileSlot {
    /// What its sums are multiplied by.
    pub scale: f32,
    /// Block of rows or columns that it belongs to.
    pub block: u32,
    /// Colour channel that it is for: 0, 1, 2, or [`crate::kernel::tiles::ALL_CHANNELS`].
    pub channel: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
}
const _: () = assert!(size_of::<TileSlot>() == 16);
