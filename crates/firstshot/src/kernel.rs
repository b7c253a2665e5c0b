//! Bodies of the GPU kernels: plain functions over slices, one invocation each, the only arithmetic there is.

pub mod fixed;
pub mod judge;
pub mod linear;
pub mod map;
pub mod register;
pub mod segment;
pub mod sequence;
pub mod start;
