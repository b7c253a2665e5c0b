#![no_std]
//! Form factors.
// Not without `std`: the kernel build has `core` only.
#[cfg(any(feature = "std", test))]
extern crate alloc;
#[cfg(any(feature = "std", test))]
extern crate std;

pub mod kernel;
pub mod types;

pub use types::*;
