#![no_std]
//! Form factors.
extern crate alloc;
#[cfg(any(feature = "std", test))]
#[macro_use]
extern crate std;

pub mod error;
#[cfg(feature = "std")]
pub mod host;
pub mod kernel;
pub mod types;

pub use error::Error;
#[cfg(feature = "std")]
pub use host::*;
pub use types::*;
