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
    /// Its first group of [`crate::kernel::tiles::LANES`] words.
    pub group: u32,
    /// Block of rows or columns that it belongs to in the lower 16 bits; then the colour channel that it is for: 0, 1, 2, or
    /// [`crate::kernel::tiles::ALL_CHANNELS`]; then 1 where elements have 4 bits instead of 8 ([`TileSlot::new`]).
    pub tag: u32,
}
const _: () = assert!(size_of::<TileSlot>() == 12);

impl TileSlot {
    /// A vector of a block, a channel, and elements of 4 or 8 bits.
    #[inline]
    pub fn new(scale: f32, group: u32, block: u32, channel: u32, is_short: bool) -> Self {
        Self { scale, group, tag: (block & 0xffff) | channel << 16 | u32::from(is_short) << 18 }
    }

    /// Block that it belongs to.
    #[inline]
    pub fn block(self) -> u32 {
        self.tag & 0xffff
    }

    /// Colour channel that it is for.
    #[inline]
    pub fn channel(self) -> u32 {
        self.tag >> 16 & 3
    }

    /// Whether its elements have 4 bits.
    #[inline]
    pub fn is_short(self) -> bool {
        self.tag >> 18 & 1 == 1
    }

    /// Groups of words that its elements take.
    #[inline]
    pub fn groups(self) -> u32 {
        if self.is_short() { 1 } else { 2 }
    }
}
