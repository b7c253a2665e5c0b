#![no_std]
//! Form factors.
extern crate alloc;
pub mod kernel;
pub mod types;
pub use types::*;
