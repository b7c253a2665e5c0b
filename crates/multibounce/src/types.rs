//! The plain data that CPU and GPU share, field for field.

use bytemuck::{Pod, Zeroable};

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
