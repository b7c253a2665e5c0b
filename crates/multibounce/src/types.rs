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

/// A bounce of feedback, [`crate::kernel::feedback::change`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct FeedbackParams {
    /// Number of patches.
    pub count: u32,
    /// How far towards the light of a plain bounce.
    pub step: f32,
    /// Share of the last change that is made again.
    pub momentum: f32,
}
const _: () = assert!(size_of::<FeedbackParams>() == 12);

/// A component of [`crate::Tiles`]: two vectors, one along the rows of its tile and one along the columns.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct TileComponent {
    /// What their sums are multiplied by.
    pub scale: f32,
    /// First group of [`crate::kernel::tiles::LANES`] words of the first; the second follows it.
    pub group: u32,
    /// Block of rows in the lower 12 bits, block of columns in the next 12; then the colour channel that it is for: 0, 1, 2,
    /// or [`crate::kernel::tiles::ALL_CHANNELS`]; then 1 where elements have 4 bits instead of 8.
    pub tag: u32,
}
const _: () = assert!(size_of::<TileComponent>() == 12);

impl TileComponent {
    /// Of a tile in these blocks of rows and columns, for a channel, with elements of 4 or 8 bits.
    #[inline]
    pub fn new(scale: f32, group: u32, (rows, columns): (u32, u32), channel: u32, is_short: bool) -> Self {
        let tag = (rows & 0xfff) | (columns & 0xfff) << 12 | (channel & 3) << 24 | u32::from(is_short) << 26;
        Self { scale, group, tag }
    }

    /// Groups of words that both of its vectors take.
    #[inline]
    pub fn groups(self) -> u32 {
        if self.tag >> 26 & 1 == 1 { 2 } else { 4 }
    }

    /// The vector along the rows (0) or the columns (1).
    #[inline]
    pub fn vector(self, side: u32) -> TileVector {
        let is_short = self.tag >> 26 & 1;
        TileVector {
            group: self.group + side * (2 - is_short),
            block: self.tag >> (12 * side) & 0xfff,
            channel: self.tag >> 24 & 3,
            is_short: is_short == 1,
        }
    }
}

/// A vector of a component.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileVector {
    /// Its first group of words.
    pub group: u32,
    /// Block of rows or columns that it belongs to.
    pub block: u32,
    /// Colour channel that it is for.
    pub channel: u32,
    /// Whether its elements have 4 bits.
    pub is_short: bool,
}
