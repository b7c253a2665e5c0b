//! The plain data that CPU and GPU share, field for field.

use bytemuck::{Pod, Zeroable};

/// Settings of the kernels that sample rows.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SampleParams {
    /// Rows of the block that is bound.
    pub rows: u32,
    /// Number of the block's first row, for its random numbers.
    pub first_row: u32,
    /// Number of the first entry that is bound.
    pub first_entry: u32,
    /// Samples a row, Q ≥ 1.
    pub samples: u32,
    /// Number of the frame.
    pub frame: u32,
    /// Changes every random number.
    pub seed: u32,
    /// A sum of the constants of [`crate::kernel::sample`]: [`crate::kernel::sample::NARROW`] and so on.
    pub options: u32,
    /// Weight w of the frames before; with [`crate::kernel::sample::AUTO`] the greatest.
    pub blend: f32,
}
const _: () = assert!(size_of::<SampleParams>() == 32);

/// Settings of the kernels that sum some rows exactly: `count` rows of a block from `first` on, after the last the
/// first.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct SumParams {
    /// Rows to sum, at most `rows`.
    pub count: u32,
    /// Rows of the block that is bound.
    pub rows: u32,
    /// The first one to sum, below `rows`.
    pub first: u32,
    /// Number of the first entry that is bound.
    pub first_entry: u32,
    /// As in [`SampleParams`].
    pub options: u32,
}
const _: () = assert!(size_of::<SumParams>() == 20);
