//! Bodies of the GPU kernels: plain functions over slices, one invocation each, the only arithmetic there is.

// `mem::swap` and range `contains` take references, which the SPIR-V compiler cannot always follow.
#![allow(clippy::manual_swap, clippy::manual_range_contains)]

pub mod bvh;
pub mod camera;
pub mod large;
pub mod light;
pub mod lobe;
pub mod medium;
pub mod normal;
pub mod shade;
pub mod specular;
pub mod texture;
pub mod tone;
pub mod walk;

pub use bvh::{GeometryTables, Hierarchy};
