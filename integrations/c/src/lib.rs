//! The C interface: opaque handles, structures that begin with their size, a status from every function.
//!
//! `include/patchlight.h` is made of this by cbindgen (`cargo test -p patchlight-header`); comments here are those of the header.

mod bake;
mod border;
mod field;
mod objects;
mod scene;
#[cfg(feature = "vulkan")]
mod vulkan;

pub use bake::*;
pub use border::{PlStatus, pl_last_error, pl_version};
pub use field::*;
pub use objects::*;
pub use scene::*;
#[cfg(feature = "vulkan")]
pub use vulkan::*;
