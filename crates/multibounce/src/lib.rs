#![no_std]
//! All bounces of light as one matrix, compressed so that its product fits in a cache.
//!
//! With the form factors F and the reflectance ρ of a colour channel, light that leaves as E arrives as
//! `H = T E`, `T = F (I − diag(ρ) F)⁻¹`; with K bounces `T_K = F Σ_{k<K} (diag(ρ) F)^k`.
//!
//! [`BlockMatrix`] keeps a matrix in texture blocks (BC1, BC3, BC6H, BC7), 0.5 to 1 byte an RGB entry, with the greatest
//! entries beside them, in an order of rows and columns that makes blocks smooth ([`projected_order`]). The product decodes
//! them on the way, on the host or in kernels, also by the texture unit.
//!
//! Source: A. S. Shcherbakov, thesis, MSU 2025, chapter 3.
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
