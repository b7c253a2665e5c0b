//! Bodies of the GPU kernels: plain functions over slices, one invocation each, the only arithmetic there is.

pub mod hemisphere;
pub mod product;
