#![no_std]
//! Form factors.
extern crate alloc;
#[cfg(any(feature = "std", test))]
extern crate std;

pub mod kernel;
pub mod types;

pub use types::*;
