#![no_std]
//! Form factors.
// The kernel build has `core` only: what needs `alloc` needs the feature `std`.
#[cfg(any(feature = "std", test))]
extern crate alloc;
#[cfg(any(feature = "std", test))]
#[macro_use]
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
