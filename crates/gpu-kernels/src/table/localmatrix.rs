//! The matrix round a camera.

use ::localmatrix::{FadeParams, SlotParams, UpdateParams};
use ::scene::Rgb;
use glam::UVec2;

use super::{Access, Aligned, Kernel, buffer, read, write};
use crate::host;
use crate::invocation::WORKGROUP;
use crate::params::CountParams;

/// Mean exitance of the leaves of each slot, W/m². An element is a slot.
pub static LOCALMATRIX_MEAN: Kernel = Kernel {
    name: "localmatrix_mean",
    spv: spv!("localmatrix_mean"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[read::<UVec2>("runs"), read::<f32>("area"), read::<Rgb>("exitance"), write::<Rgb>("light")],
    host: host::localmatrix::mean,
};

/// Slots of each block of 64 whose light is not 0. An element is a block.
pub static LOCALMATRIX_COUNT: Kernel = Kernel {
    name: "localmatrix_count",
    spv: spv!("localmatrix_count"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<SlotParams>() as u32,
    bindings: &[read::<Rgb>("values"), write::<u32>("counts")],
    host: host::localmatrix::count,
};

/// Where each block begins in the list; at the end its length. An element is a block, or the end.
pub static LOCALMATRIX_START: Kernel = Kernel {
    name: "localmatrix_start",
    spv: spv!("localmatrix_start"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[read::<u32>("counts"), write::<u32>("starts")],
    host: host::localmatrix::start,
};

/// Slots whose light is not 0, then the others. An element is a place of the list.
pub static LOCALMATRIX_COMPACT: Kernel = Kernel {
    name: "localmatrix_compact",
    spv: spv!("localmatrix_compact"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[read::<u32>("starts"), read::<Rgb>("values"), write::<u32>("list")],
    host: host::localmatrix::compact,
};

/// Irradiance of visible slots from lit ones, W/m². An element is a place of the list of visible slots, whatever comes after them
/// gets nothing.
pub static LOCALMATRIX_PRODUCT: Kernel = Kernel {
    name: "localmatrix_product",
    spv: spv!("localmatrix_product"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<SlotParams>() as u32,
    bindings: &[
        read::<u32>("lit_starts"),
        read::<u32>("lit"),
        read::<u32>("visible_starts"),
        read::<u32>("visible"),
        read::<f32>("red"),
        read::<f32>("green"),
        read::<f32>("blue"),
        read::<f32>("root"),
        read::<Rgb>("light"),
        write::<Rgb>("irradiance"),
    ],
    host: host::localmatrix::product,
};

/// Irradiance of each leaf from that of the slots, W/m². An element is a leaf.
pub static LOCALMATRIX_SPREAD: Kernel = Kernel {
    name: "localmatrix_spread",
    spv: spv!("localmatrix_spread"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[read::<u32>("slot_of"), read::<Rgb>("irradiance"), write::<Rgb>("leaves")],
    host: host::localmatrix::spread,
};

/// What is left of the jumps of each leaf's light, W/m². An element is a leaf.
pub static LOCALMATRIX_FADE: Kernel = Kernel {
    name: "localmatrix_fade",
    spv: spv!("localmatrix_fade"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<FadeParams>() as u32,
    bindings: &[read::<Rgb>("before"), read::<Rgb>("now"), buffer::<Rgb>("offset", Access::ReadWrite)],
    host: host::localmatrix::fade,
};

/// Irradiance of each patch from that of its leaf and what is left of jumps, W/m². An element is a patch.
pub static LOCALMATRIX_SHOW: Kernel = Kernel {
    name: "localmatrix_show",
    spv: spv!("localmatrix_show"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[read::<u32>("leaf_of"), read::<Rgb>("now"), read::<Rgb>("offset"), write::<Rgb>("irradiance")],
    host: host::localmatrix::show,
};

/// A plane of the matrix after patches came or went. An element is four columns of a row.
pub static LOCALMATRIX_UPDATE: Kernel = Kernel {
    name: "localmatrix_update",
    spv: spv!("localmatrix_update"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<UpdateParams>() as u32,
    bindings: &[
        read::<f32>("vectors"),
        read::<f32>("columns"),
        read::<u32>("place"),
        buffer::<f32>("plane", Access::ReadWrite),
    ],
    host: host::localmatrix::update,
};
