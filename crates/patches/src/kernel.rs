//! Bodies of the GPU kernels: plain functions over slices, one invocation each, the only arithmetic there is.

pub mod gather;
pub mod grid;
pub mod lightmap;
pub mod lookup;
pub mod volume;
pub mod weights;
