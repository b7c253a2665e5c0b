//! Push constants of the kernels that have no settings type in their own crate.

use ::scene::Camera;
use ::scene::gpu::{DirectParams, LargeParams};
use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

/// Kernels that need to know only how many invocations there are.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct CountParams {
    /// Number of invocations.
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
    /// Absorption of the medium between surfaces, 1/m; 0 for air.
    pub absorption: Vec3,
    /// Distance by which rays start above a surface, m.
    pub ray_offset: f32,
    /// Number of pixels of this dispatch.
    pub count: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: [u32; 3],
}
const _: () = assert!(size_of::<FollowParams>() == 112);

/// Direct light through a medium.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MediumDirectParams {
    /// As without one.
    pub direct: DirectParams,
    /// Absorption of the medium, 1/m.
    pub absorption: Vec3,
    /// Number of points.
    pub count: u32,
}
const _: () = assert!(size_of::<MediumDirectParams>() == 48);

/// Light of rectangles and emissive triangles at pixels through a medium.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MediumLargeParams {
    /// As without one.
    pub large: LargeParams,
    /// Absorption of the medium, 1/m.
    pub absorption: Vec3,
    /// Number of pixels of this dispatch.
    pub count: u32,
}
const _: () = assert!(size_of::<MediumLargeParams>() == 128);

/// Tone mapping.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ToneMapParams {
    /// Number of pixels.
    pub count: u32,
    /// Exposure, divided by the number of sub-frames that were summed.
    pub scale: f32,
    /// Tone curve, as [`TONE_NONE`](::scene::gpu::TONE_NONE).
    pub tone: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
}
const _: () = assert!(size_of::<ToneMapParams>() == 16);

/// Metering of a picture.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct MeterParams {
    /// Number of means.
    pub count: u32,
    /// Number of pixels, and of those of a mean.
    pub pixels: u32,
    /// Consecutive pixels of a mean.
    pub run: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
}
const _: () = assert!(size_of::<MeterParams>() == 16);
