//! Kernels of opponents, declared with [`gpu_kernels::kernels!`] outside the crate of the library's own.
//!
//! `spv/` has the compiled modules and their manifest; `just spv` rebuilds them with those of `gpu-kernels`.
#![no_std]

pub mod ddgi;

#[cfg(feature = "std")]
pub use ddgi::KERNELS;
