//! The plain data that CPU and GPU share, field for field.

use bytemuck::{Pod, Zeroable};

/// Settings of the dense products: one block of rows of F times the whole vector B.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct GatherParams {
    /// Rows of the block that is bound.
    pub rows: u32,
    /// Vectors of four factors in a row: the number of senders / 4, rounded up; what is beyond the senders is 0.
    pub vectors: u32,
    /// Place of the block's first row in the result.
    pub first_row: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
}
const _: () = assert!(size_of::<GatherParams>() == 16);

/// Settings of the product with rows of counts of hits: one block of rows, with the quads that it owns.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct HitsParams {
    /// Rows of the block that is bound.
    pub rows: u32,
    /// Number of the first quad that is bound; a multiple of [`crate::kernel::hits::WORD_COUNTS`].
    pub first_quad: u32,
}
const _: () = assert!(size_of::<HitsParams>() == 8);
