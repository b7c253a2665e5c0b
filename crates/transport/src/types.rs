//! The plain data that CPU and GPU share, field for field.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// A flat part of one side of a surface.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Patch {
    /// Centre of mass, m.
    pub centroid: Vec3,
    /// Area A, m².
    pub area: f32,
    /// Unit normal of the side that sends and receives.
    pub normal: Vec3,
    /// Triangle of the scene that it is part of.
    pub triangle: u32,
}
const _: () = assert!(size_of::<Patch>() == 32);

/// Division of a triangle of the scene into `divisions²` similar triangles, and the position of their values in a
/// table. The same structure numbers patches and, in a second table, the cells of receivers.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct TriangleGrid {
    /// First entry of the front side, or [`scene::NONE`] when that side has none.
    pub front: u32,
    /// First entry of the back side, or [`scene::NONE`].
    pub back: u32,
    /// Divisions along each edge, ≥ 1.
    pub divisions: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
}
const _: () = assert!(size_of::<TriangleGrid>() == 16);

/// A cell of a triangle's grid as receivers take it: cut once more into `divisions²` like triangles, whose vertices
/// have entries of their own.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct ReceiverCell {
    /// First of its (divisions + 1)(divisions + 2)/2 vertices.
    pub first: u32,
    /// Divisions along each edge, ≥ 1.
    pub divisions: u32,
}
const _: () = assert!(size_of::<ReceiverCell>() == 8);

/// Settings of the dense products: one block of rows of F times the whole vector B.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct GatherParams {
    /// Rows of the block that is bound.
    pub rows: u32,
    /// Vectors of four factors in a row: the number of columns / 4, rounded up; what is beyond the columns is 0.
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

/// Settings of the kernels that compute only the rows a view needs ([`crate::kernel::view`]).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct ViewParams {
    /// Rows, or pixels.
    pub count: u32,
    /// Number of the first quad that is bound, with rows of counts of hits; else 0.
    pub first_quad: u32,
    /// Number of the view, from 1 on.
    pub view: u32,
    /// Number of the light, from 1 on.
    pub light: u32,
}
const _: () = assert!(size_of::<ViewParams>() == 16);
