//! The bodies of the kernels: one invocation each, no `std`.

pub mod sample;
pub mod split;
pub mod tables;
