#![no_std]
//! All bounces of light between the patches round a camera, kept exact while patches come and go.
//!
//! A world may have more patches than their matrix can hold. [`LocalMatrix`] holds M slots, and for each colour channel
//! the operator of all bounces `T = F (I − diag(ρ) F)⁻¹` of the patches in them: irradiance `H = T E` in W/m², for a
//! first exitance E. A patch that enters is a border of the matrix, with `f̂` its form factors to the others and ρ its
//! reflectance:
//!
//! ```text
//! w = f̂ + T̂ (ρ∘f̂)     σ = F_nn + f̂·(ρ∘w)     s = 1 − ρ_n σ
//! T̂ ← T̂ + (ρ_n / s) w wᵀ,     new row and column w / s,     corner σ / s
//! ```
//!
//! about 2 M² multiplications, nothing left out. `T̂ = a^½ T a^-½` with the patches' areas a, and so is f̂: both are
//! symmetric when F is reciprocal. Several patches enter as one border of as many columns. A patch that leaves becomes
//! a *ghost*: it keeps its slot, light still goes by way of it, and when it comes back there is nothing to do. When its
//! slot is needed, its border is taken away, `T̂ ← T̂ − ρ_n T̂_n T̂_nᵀ / (1 + ρ_n T̂_nn)`, which is exact as well: no
//! light is counted twice. What rounding leaves is taken out column by column ([`LocalMatrix::refresh`]).
//!
//! [`Local`] goes with a camera through a [`World`] of any size: its nodes are patches, and patches merged to trees. In
//! the matrix is a cut through them, fine where its apparent size from the predicted camera path is large and coarse
//! far off, so that no light is lost; within a budget of changes a step, one node gives way to its descendants or they
//! to it. Rows that are not in memory yet are asked for ahead, and until they come the coarser node stays. F between
//! nodes of any level is that of both rows ([`World`]), and what the light would jump by when the nodes change comes
//! over some frames. [`Table`] is a world in memory; [`Store`] one in a file, whose blocks a thread reads ahead into a
//! bounded cache, and which goes on without what is broken. [`BakeWriter`] writes such a file block by block, in parts
//! if need be. [`choose`] alone says which patches of a flat world are to enter and to leave, from how far they are
//! off.
//!
//! ```
//! use glam::{Vec3, Vec4};
//! use patchlight_localmatrix::{Entering, LocalMatrix};
//!
//! // Two plates that see each other by half, one twice as large.
//! let albedo = Vec3::splat(0.5);
//! let mut matrix = LocalMatrix::new(8)?;
//! matrix.add(&[Entering { patch: 7, area: 1.0, albedo, factors: &[(9, 0.5)] }])?;
//! matrix.add(&[Entering { patch: 9, area: 2.0, albedo, factors: &[(7, 0.25)] }])?;
//!
//! let slots = [7, 9].map(|patch| matrix.slot(patch).unwrap());
//! let (mut exitance, mut irradiance) = ([Vec4::ZERO; 8], [Vec4::ZERO; 8]);
//! exitance[slots[0] as usize] = Vec4::ONE;
//! matrix.product(&slots, &slots, &exitance, &mut irradiance)?;
//! // H_2 = F_21 B_1 and B_1 = 1 + ρ_1 F_12 ρ_2 H_2.
//! let expected = 0.25 / (1.0 - 0.5 * 0.5 * 0.5 * 0.25);
//! assert!((irradiance[slots[1] as usize].x - expected).abs() < 1e-6);
//! # Ok::<(), patchlight_localmatrix::Error>(())
//! ```
//!
//! Source: A. S. Shcherbakov, thesis, MSU 2025, chapter 4; the exact border and its symmetric form are this project's
//! own.
//!
//! | feature | what it adds |
//! |---|---|
//! | none | bodies of kernels and types, with `core` only |
//! | `alloc` | the matrix, the cut, worlds in memory, on one core |
//! | `std`, by default | loops over all cores, SIMD, worlds on disk |
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
pub use types::{FadeParams, LevelParams, SlotParams, UpdateParams};
