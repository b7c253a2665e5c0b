//! The bodies of the kernels: one invocation each, no `std`.

pub mod blocks;
pub mod feedback;
pub mod invert;
pub mod low_rank;
pub mod multiply;
