//! Types that the host and the kernels share.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// Parameters of fading jumps of the light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct FadeParams {
    /// Leaves.
    pub count: u32,
    /// Share of a jump that remains after a frame.
    pub keep: f32,
    /// Non-zero if the matrix has changed in this frame.
    pub has_jump: u32,
    /// Display white: irradiance that is displayed as white, W/m²; infinite where displayed values do not matter.
    pub display_white: f32,
}

const _: () = assert!(size_of::<FadeParams>() == 16);

/// From where a camera sees the light of a streamed world, and how its jumps shrink.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct LevelParams {
    /// Camera position, m.
    pub eye: Vec3,
    /// Leaves.
    pub count: u32,
    /// Edge of a node, as a share of its distance, at which the nodes of the matrix stand.
    pub apparent_size: f32,
    /// Edge of a leaf, m.
    pub edge: f32,
    /// Levels of merged nodes above the leaves.
    pub levels: u32,
    /// 1: what is shown so far is that of the frame before.
    pub begins: u32,
    /// 1: jumps since the last time fade from now on; 0: the light is there at once, and what is left of earlier jumps
    /// stays.
    pub fades: u32,
    /// As in [`FadeParams`].
    pub keep: f32,
    /// As in [`FadeParams`].
    pub has_jump: u32,
    /// As in [`FadeParams`].
    pub display_white: f32,
}

const _: () = assert!(size_of::<LevelParams>() == 48);

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
    /// First vector of this plane.
    pub first_vector: u32,
    /// First new column of this plane.
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
