#![no_std]
//! Foundations of every method of light transport.
//!
//! Radiosity is linear: irradiance `H = F B` from exitance B, both in W/m², by a matrix F of form
//! factors or of whole paths of light. The methods differ in how they make, store and apply that
//! matrix. This crate has what they share:
//!
//! - [`LinearOperator`], `y = A x` for RGB vectors, whatever stores A: [`Dense`], [`Half`] (half
//!   precision), [`Csr`] (compressed sparse rows), [`HitCounts`] (rows as counts of ray hits), and
//!   [`FnOperator`] for any function;
//! - [`Patch`], [`Polygon`] and [`Surfaces`], what light passes between, and the regular grid on each
//!   triangle ([`TriangleGrid`], [`kernel::grid`]) that numbers patches and interpolates receivers;
//! - [`Permutation`], an order of rows or columns, [`bisect`], the top-down bisection that finds
//!   orders in which neighbours are alike, and [`spatial_order`], one of surface points;
//! - [`alias`], the construction of alias tables, which sample an entry in constant time;
//! - [`Observer`], by which long work tells how far it is and asks whether to go on;
//! - [`Error`], what can be wrong with tables and settings in any method.
//!
//! The bodies in [`kernel`] run as SPIR-V and on the host alike. Products on all cores give the same bits for any
//! number of threads.
//!
//! Sources: Goral et al. 1984 (radiosity); Walker 1977, Vose 1991 (alias tables).
//!
//! ```
//! use glam::Vec4;
//! use patchlight_transport::{Csr, LinearOperator};
//!
//! // Two plates that see each other by half, one twice as large.
//! let factors = Csr::from_rows(2, &[vec![(1, 0.5)], vec![(0, 0.25)]])?;
//! let mut irradiance = [Vec4::ZERO; 2];
//! factors.apply(&[Vec4::splat(8.0), Vec4::ZERO], &mut irradiance)?;
//! assert_eq!(irradiance[1].x, 2.0);
//! # Ok::<(), patchlight_transport::Error>(())
//! ```
//!
//! | feature | what it adds |
//! |---|---|
//! | none | bodies of kernels and types, with `core` only |
//! | `alloc` | matrices, operators, orders, alias tables, progress, errors, on one core |
//! | `std`, by default | loops over all cores, SIMD |
//! | `serde` | its tables in files |
//!
//! Results are the same, but that sums of dense and half-precision rows depend on the width of the registers, as they
//! do between processors.
// The kernel build has `core` only.
#[cfg(any(feature = "alloc", test))]
#[macro_use]
extern crate alloc;
#[cfg(any(feature = "std", test))]
extern crate std;

#[cfg(feature = "alloc")]
pub mod alias;
#[cfg(feature = "alloc")]
pub mod bisect;
#[cfg(feature = "alloc")]
pub mod error;
#[cfg(feature = "alloc")]
pub mod host;
pub mod kernel;
#[cfg(feature = "alloc")]
pub mod observer;
#[cfg(feature = "alloc")]
pub mod operator;
#[cfg(feature = "alloc")]
pub mod permutation;
#[cfg(feature = "alloc")]
pub mod quadrants;
pub mod types;

#[cfg(feature = "alloc")]
pub use error::{Error, check_indices, check_length, check_offsets, check_setting};
#[cfg(feature = "alloc")]
pub use host::*;
#[cfg(feature = "alloc")]
pub use observer::{Observer, Phase, Proceed, Silent, Steps};
#[cfg(feature = "alloc")]
pub use operator::{FnOperator, LinearOperator, TransposedOperator};
#[cfg(feature = "alloc")]
pub use permutation::Permutation;
#[cfg(feature = "alloc")]
pub use quadrants::{QUADRANTS, quadrant_of, rotational_gradients};
pub use types::*;
