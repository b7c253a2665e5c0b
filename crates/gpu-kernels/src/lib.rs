//! SPIR-V entry points of all methods, their compiled modules, and the table that describes them.
#![no_std]
#[cfg(feature = "std")]
extern crate std;

pub mod formfactor;
mod half;
mod invocation;
pub mod params;
pub mod scene;

#[cfg(feature = "std")]
pub mod host;
#[cfg(feature = "std")]
pub mod table;
