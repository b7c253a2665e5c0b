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
    /// Display white: irradiance that is displayed as white, W/m²; infinite where displayed values do not matter.
    pub display_white: f32,
}

const _: () = assert!(size_of::<FadeParams>() == 16);

/// An update of a plane of the matrix.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct UpdateParams {
    /// Invocations: four columns of a row each.
    pub count: u32,
    /// Slots, a multiple of 4.
    pub slots: u32,
    /// Number of vectors.
    pub rank: u32,
    /// 1 or −1.
    pub sign: f32,
    /// Where the vectors of this plane begin.
    pub first_vector: u32,
    /// Where its new columns begin.
    pub first_column: u32,
    /// 0.
    pub reserved: [u32; 2],
}

const _: () = assert!(size_of::<UpdateParams>() == 32);

/// A list of slots, or a product with one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct SlotParams {
    /// Invocations.
    pub count: u32,
    /// Slots.
    pub slots: u32,
}

const _: () = assert!(size_of::<SlotParams>() == 8);
