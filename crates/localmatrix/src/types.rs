//! What the host and the kernels share.

use bytemuck::{Pod, Zeroable};

/// How jumps of the light shrink.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct FadeParams {
    /// Leaves.
    pub count: u32,
    /// What is left of a jump after a frame.
    pub keep: f32,
    /// Whether the matrix has changed in this frame.
    pub has_jump: u32,
    /// 0.
    pub reserved: u32,
}

const _: () = assert!(size_of::<FadeParams>() == 16);

/// Shape of a product.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ProductParams {
    /// Rows of the planes that are bound.
    pub rows: u32,
    /// Slots.
    pub slots: u32,
    /// The first of the rows.
    pub first_row: u32,
    /// 0.
    pub reserved: u32,
}

const _: () = assert!(size_of::<ProductParams>() == 16);
