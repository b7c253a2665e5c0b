#![no_std]
//! All bounces of light as one matrix, compressed so that its product fits in a cache.
//!
//! With the form factors F and the reflectance ρ of a colour channel, light that leaves as E arrives as
//! `H = T E`, `T = F (I − diag(ρ) F)⁻¹`; with K bounces `T_K = F Σ_{k<K} (diag(ρ) F)^k`. E and H are W/m².
//!
//! [`all_bounces`] makes T from reciprocal form factors by Cholesky's factorisation, [`all_bounces_lu`] from any,
//! [`some_bounces`] makes T_K by Horner's rule, in 3 n² numbers of memory each beside F; [`all_bounces_stored`] and
//! [`some_bounces_stored`] make them panel by panel, in as much memory as they may take, and keep them in a file. With
//! areas a by which F is reciprocal, `T̂ = a^½ T a^-½` is symmetric: half of it determines all. [`LowRank`] stores it
//! as rank-1 terms of 4 or 8 bits, dense sub-blocks and a sparse residual, in tiles of an order in which neighbours are
//! alike ([`halving_order`]), for a relative error that is asked for (Frobenius); errors that are even over neighbours
//! count more, because light adds them up. The three colour channels share what they have in common. It also stores
//! rectangular operators of few patches and many receivers, `H_r = F_r B`: one channel for all colours, with the same
//! product and kernels. The bodies in [`kernel`] run as SPIR-V and on the host alike; the forms for all cores give the
//! same bits.
//!
//! [`BlockMatrix`] keeps a matrix in texture blocks (BC1, BC3, BC6H, BC7), 0.5 to 1 byte an RGB entry, with the
//! greatest entries beside them, in an order of rows and columns that makes blocks smooth ([`projected_order`]). The
//! product decodes them on the way, on the host or in kernels, also by the texture unit.
//!
//! [`LowRank`] tiles of F alone serve *feedback*, `B ← E + ρ∘(F B)`, a bounce in each frame, in which ρ may change at
//! any time. With [`Acceleration`] a bounce uses where the light was going: it settles in about half as many.
//!
//! ```
//! # extern crate transport as patchlight_transport;
//! use glam::{Vec3, Vec4};
//! use patchlight_multibounce::{Channels, Factors, LowRank, TileSide, TileSource, all_bounces, halving_order};
//! use patchlight_transport::{LinearOperator, Proceed};
//!
//! // Two plates that see each other by half, one twice as large.
//! let (area, values) = ([1.0, 2.0], [0.5, 0.25]);
//! let factors = Factors { row_start: &[0, 1, 2], columns: &[1, 0], values: &values, area: &area };
//! let operator = all_bounces(factors.symmetric()?, &[0.8, 0.5])?;
//! let order = halving_order(&[Vec3::ZERO, Vec3::Z], &[Vec3::Z, Vec3::NEG_Z], &[]);
//! let ignore_progress = |_, _| Proceed::Continue(());
//! let patches = TileSide { area: &area, order: &order };
//! let source = TileSource::Symmetric { channels: Channels::One(&operator), patches };
//! let tiles = LowRank::encode(source, 1e-3, &ignore_progress)?;
//!
//! let mut irradiance = [Vec4::ZERO; 2];
//! tiles.apply(&[Vec4::ONE, Vec4::ZERO], &mut irradiance)?;
//! // H_2 = F_21 B_1 and B_1 = 1 + ρ_1 F_12 ρ_2 H_2.
//! let expected = 0.25 / (1.0 - 0.8 * 0.5 * 0.5 * 0.25);
//! assert!((irradiance[1].x - expected).abs() < 2e-3 * expected);
//! # Ok::<(), patchlight_multibounce::Error>(())
//! ```
//!
//! Source: A. S. Shcherbakov, thesis, MSU 2025, chapter 3; the symmetric form and the tiles are this project's own.
//!
//! | feature | what it adds |
//! |---|---|
//! | none | bodies of kernels and types, with `core` only |
//! | `alloc` | solvers, low rank, orders, products of all codecs, on one core |
//! | `std`, by default | loops over all cores, SIMD, operators in files, the encoder of texture blocks |
//! | `serde` | its tables in files |
//!
//! Results are the same to rounding: faer works in single precision by registers of other widths.
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
