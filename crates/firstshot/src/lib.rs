#![no_std]
//! Photons that start where lights fall first.
#[cfg(any(feature = "std", test))]
extern crate std;

#[cfg(feature = "std")]
pub mod error;
#[cfg(feature = "std")]
pub mod host;
pub mod kernel;
pub mod types;

#[cfg(feature = "std")]
pub use error::Error;
#[cfg(feature = "std")]
pub use host::*;
pub use types::*;
