//! The plain data that CPU and GPU share, field for field.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// A point of a surface that stands for a part of it, on one side.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Sample {
    /// Position, m.
    pub position: Vec3,
    /// Area s that the point stands for, m².
    pub area: f32,
    /// Unit geometric normal of the side that was seen.
    pub normal: Vec3,
    /// Triangle of the scene that the point lies on.
    pub triangle: u32,
    /// Reflectance ρ, the texture averaged over about the sample's area.
    pub albedo: Vec3,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
}
const _: () = assert!(size_of::<Sample>() == 48);

/// A sample's part in a patch.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Member {
    /// Index of the sample.
    pub sample: u32,
    /// Share of the patch's area, (0, 1]; the shares of a patch sum to 1.
    pub weight: f32,
}
const _: () = assert!(size_of::<Member>() == 8);

/// Samples taken together as one source patch (and, for [T 5]'s own receivers, receiver) of light.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct VirtualPatch {
    /// Area-weighted mean position of the samples, m.
    pub position: Vec3,
    /// Area A, m².
    pub area: f32,
    /// Area-weighted mean normal, unit.
    pub normal: Vec3,
    /// Voxel of the grid, or [`scene::NONE`] for a patch that is not bound to one.
    pub voxel: u32,
    /// Area-weighted mean reflectance ρ.
    pub albedo: Vec3,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
}
const _: () = assert!(size_of::<VirtualPatch>() == 48);

/// Position of the voxels: voxel (i, j, k) is the half-open box from `origin + (i, j, k)·edges` on, its number is `i +
/// count_x·(j + count_y·k)`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GridShape {
    /// Least corner, m.
    pub origin: Vec3,
    /// Voxels along x.
    pub count_x: u32,
    /// Edges of a voxel, m.
    pub edges: Vec3,
    /// Voxels along y.
    pub count_y: u32,
    /// Voxels along z.
    pub count_z: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: [u32; 3],
}
const _: () = assert!(size_of::<GridShape>() == 48);

/// A patch as the lookup sees it; those of a voxel follow each other.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct LookupPatch {
    /// Mean position, m.
    pub position: Vec3,
    /// Index of the patch.
    pub patch: u32,
    /// Unit direction that weighs it: its mean normal.
    pub direction: Vec3,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
}
const _: () = assert!(size_of::<LookupPatch>() == 32);

/// Marks a voxel without patches, or without a probe; the other bits are the nearest one that has.
pub const EMPTY_CELL: u32 = 1 << 31;

/// A lookup by the distance from the point's plane alone: [`LookupParams::rule`].
pub const RULE_PLANES: u32 = 0;
/// Besides, patches behind a wall (a patch across the point's plane, in the voxel of the point or of the other patch)
/// do not count.
pub const RULE_WALLS: u32 = 1;

/// Settings of the lookup.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct LookupParams {
    /// The grid.
    pub shape: GridShape,
    /// A patch counts less the farther it lies from the plane of the point that asks, and (almost) nothing from this
    /// distance on, in voxel edges along the normal.
    pub plane_limit: f32,
    /// Rule: [`RULE_PLANES`] or [`RULE_WALLS`].
    pub rule: u32,
    /// Points of a dispatch; the body does not ask.
    pub count: u32,
    /// First cell of the grid: 0, or further on in tables that several lookups share.
    pub first_cell: u32,
}
const _: () = assert!(size_of::<LookupParams>() == 64);

/// Positions and use of a volume's probes.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct VolumeParams {
    /// The grid; probes stand in the middles of its voxels.
    pub shape: GridShape,
    /// Distance along its normal from which a point looks at the probes, m.
    pub lift: f32,
    /// 1: probes that the point does not see do not count.
    pub walls: u32,
    /// Points of a dispatch; the body does not ask.
    pub count: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
}
const _: () = assert!(size_of::<VolumeParams>() == 64);

/// Size of a lightmap.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct LightmapParams {
    /// Texels of a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}
const _: () = assert!(size_of::<LightmapParams>() == 8);

/// Settings of the products with packed rows of weights ([`crate::kernel::weights`]), of all rows or of those that a
/// view needs.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct WeightParams {
    /// Rows.
    pub count: u32,
    /// Rows of a block, which have a list of receivers.
    pub block_rows: u32,
    /// First value of the receivers.
    pub first_value: u32,
    /// Numbers of a receiver's value: 1, or 4 where it is the sum of the quadrants.
    pub parts: u32,
    /// Number of the view, from 1 on; 0 for all rows.
    pub view: u32,
    /// Number of the light, from 1 on; 0 for all rows.
    pub light: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: [u32; 2],
}
const _: () = assert!(size_of::<WeightParams>() == 32);

/// Settings of the light that receivers know by direction, at pixels with a finish ([`crate::kernel::weights`]).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct DifferenceParams {
    /// Pixels.
    pub count: u32,
    /// Rows of weights: interpolation points.
    pub rows: u32,
    /// Rows of a block, which have a list of receivers.
    pub block_rows: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
}
const _: () = assert!(size_of::<DifferenceParams>() == 16);
