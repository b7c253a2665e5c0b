#![no_std]
//! Virtual patches: any mesh as a few thousand senders of light.
// The kernel build has `core` only: what needs `alloc` needs the feature `std`.
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
