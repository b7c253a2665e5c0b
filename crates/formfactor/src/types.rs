//! The plain data that CPU and GPU share, field for field.

use bytemuck::{Pod, Zeroable};

/// Settings of the hemisphere kernels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct HemisphereParams {
    /// First row of this dispatch.
    pub first_row: u32,
    /// Rows of this dispatch.
    pub row_count: u32,
    /// Rays a row.
    pub rays: u32,
    /// Number of patches: the id of the sky; one more stands for a hit that no patch owns.
    pub patch_count: u32,
    /// Changes every random number.
    pub seed: u32,
    /// Distance by which rays start above the surface, m.
    pub ray_offset: f32,
    /// Keeps the size a multiple of 16.
    pub reserved: [u32; 2],
}
const _: () = assert!(size_of::<HemisphereParams>() == 32);

pub use transport::{GatherParams, HitsParams, Patch, ReceiverCell, TriangleGrid, ViewParams};
