//! Bodies of the GPU kernels: plain functions over slices, one invocation each, the only arithmetic there is.

pub mod grid;
pub mod hits;
pub mod product;
pub mod view;
