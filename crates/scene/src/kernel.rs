//! Bodies of the GPU kernels: plain functions over slices, one invocation each, the only arithmetic there is.

pub mod bvh;
pub mod camera;
pub mod light;
pub mod shade;
pub mod texture;

pub use bvh::Geometry;
