//! Push constants of the kernels that have no settings type in their own crate.

use ::scene::Camera;
use bytemuck::{Pod, Zeroable};
use glam::Vec4;

/// Kernels that need to know only how many elements there are.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct CountParams {
    /// Number of elements.
    pub count: u32,
}
const _: () = assert!(size_of::<CountParams>() == 4);

/// Exitance brought into the order of tiles.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct PermuteInParams {
    /// Number of permuted indices, whole blocks.
    pub count: u32,
    /// Number of patches.
    pub patches: u32,
}
const _: () = assert!(size_of::<PermuteInParams>() == 8);

/// Product with Vᵀ: sums of the vectors of tiles.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MultiplyVtParams {
    /// Red and blue of both chroma axes.
    pub chroma_axes: Vec4,
    /// Number of invocations: those of all runs.
    pub count: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: [u32; 3],
}
const _: () = assert!(size_of::<MultiplyVtParams>() == 32);

/// Primary rays and shading of one sub-frame.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PixelParams {
    /// The pinhole; pixels are counted row by row from the upper left corner.
    pub camera: Camera,
    /// Number of pixels of this dispatch.
    pub count: u32,
    /// Number of the sub-frame: decides the positions in the pixels.
    pub seed: u32,
    /// Number of lights (shading only).
    pub light_count: u32,
    /// First pixel of this dispatch.
    pub first: u32,
}
const _: () = assert!(size_of::<PixelParams>() == 80);

/// Rays of pixels by way of mirrors and through glass.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct FollowParams {
    /// As for other primary rays.
    pub pixels: PixelParams,
    /// Number of pixels of this dispatch.
    pub count: u32,
    /// Distance by which rays start above a surface, m.
    pub ray_offset: f32,
    /// Keeps the size a multiple of 16.
    pub reserved: [u32; 2],
}
const _: () = assert!(size_of::<FollowParams>() == 96);

/// Tone mapping.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ToneMapParams {
    /// Number of pixels.
    pub count: u32,
    /// Exposure, divided by the number of sub-frames that were summed.
    pub scale: f32,
}
const _: () = assert!(size_of::<ToneMapParams>() == 8);
