#![no_std]
//! Form factors between patches, and classic radiosity with them.
//!
//! `F_ij` is the share of the energy leaving patch i that arrives at j, `F_i0` the share that escapes to the sky:
//! `F_ij = 1/A_i ∫∫ V cosθ_i cosθ_j / (π r²) dA_j dA_i`, `A_i F_ij = A_j F_ji`, `Σ_j F_ij + F_i0 = 1`.
//! Light follows from `B = E + ρ∘(F B)`; the output is the irradiance `H = F B`. Lengths are metres, E, B and H W/m².
//! [`form_factors`] fills the rows between any [`transport::Surfaces`] by one of four estimators: [`Hemisphere`]
//! (rays), [`AreaToArea`] (pairs of points), [`PointToPoint`] (disc form) and [`Contour`] (Lambert's exact sum, the
//! reference for accuracy). [`balance`] enforces reciprocity and closure, [`reciprocal`] that of sparse rows. Rows
//! multiply as [`transport::Dense`], [`transport::Half`], [`transport::Csr`] and, where they come from rays, the small
//! [`transport::HitCounts`]; [`jacobi`], [`gauss_seidel`], [`shoot`] and [`lu`] solve; [`RowFileWriter`] takes rows to
//! disk. The bodies in [`kernel`] run as SPIR-V and on the host alike.
//!
//! Sources: Goral et al. 1984; Cohen et al. 1988; Baum, Rushmeier and Winget 1989; A. S. Shcherbakov, thesis, MSU 2025,
//! 2.2.5.
//!
//! ```
//! # extern crate transport as patchlight_transport;
//! use patchlight_formfactor::point_to_polygon;
//! use glam::{DVec3, Vec3};
//! use patchlight_transport::Polygon;
//!
//! // A point below the corner of a unit square one metre above it (Howell B-3).
//! let square = Polygon::new(&[Vec3::Z, Vec3::new(0.0, 1.0, 1.0), Vec3::ONE, Vec3::new(1.0, 0.0, 1.0)])?;
//! assert!((point_to_polygon(DVec3::ZERO, DVec3::Z, &square) - 0.138531606).abs() < 1e-9);
//! # Ok::<(), patchlight_transport::Error>(())
//! ```
//!
//! | feature | what it adds |
//! |---|---|
//! | none | bodies of kernels and types, with `core` only |
//! | `alloc` | estimators, balance, solvers, on one core |
//! | `std`, by default | loops over all cores, SIMD, rows in files |
//!
//! Results are the same; those of [`lu`] to rounding.
// The kernel build has `core` only.
#[cfg(any(feature = "alloc", test))]
#[macro_use]
extern crate alloc;
#[cfg(any(feature = "std", test))]
extern crate std;

#[cfg(feature = "alloc")]
pub mod error;
#[cfg(feature = "alloc")]
pub mod host;
pub mod kernel;
pub mod types;

#[cfg(feature = "alloc")]
pub use error::Error;
#[cfg(feature = "alloc")]
pub use host::*;
pub use types::*;
