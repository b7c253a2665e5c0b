#![no_std]
//! Radiosity by a few samples a row and frame, averaged over frames.
//!
//! A row of form factors is a distribution: `H_i = Σ_j F_ij B_j = S_i E[B_j]` where j is drawn with the probability
//! `F_ij / S_i` and `S_i` is the sum of the row. Each frame takes Q samples of each row, so it costs `N · Q` instead of
//! N², `Ĥ_i = S_i / Q Σ_k B_j(k)`, and averages over frames: `H ← w H + (1 − w) Ĥ`. All bounces come from feedback:
//! what is sampled is `B = E + ρ∘H` with the H of the frame before. H and B are W/m².
//!
//! [`RayLists`] keep what the rays of a row hit: a uniform index into the list samples the row, 2 bytes an entry.
//! [`AliasTables`] sample any row in constant time (Walker 1977, Vose 1991), 6 bytes an entry that is not zero, 8 with
//! colours. Both are built on all cores; tables also by kernels ([`kernel::split`], after Lehmann et al. 2021).
//!
//! [`Settings`] choose what a frame does, each by itself:
//! - `control_variate` samples only what has changed, `H ← H + F̂ (B_t − B_{t−1})`, so still light has no noise at all.
//!   A share of the rows is summed exactly in each frame, one share after another, so that errors of the increments do
//!   not pile up.
//! - `blend` is w, or follows from the variance of the samples and from how fast the light changes: it falls to 0 where
//!   the light jumps.
//! - `rotated` takes the points of a lattice, shifted by one random number a row and by the golden section from frame
//!   to frame.
//!
//! Random numbers are hashes of (row, sample, frame, seed): the same on CPU and GPU, for any number of threads. The
//! bodies in [`kernel`] need no `std`.
//!
//! ```
//! use glam::Vec4;
//! use patchlight_temporal::{Distribution, RayLists, Settings, State};
//!
//! // Two plates that see each other with half of their rays; the rest escapes to the sky, column 2.
//! let lists = RayLists::from_hits(2, &[1, 2, 2, 1, 0, 2, 0, 2], 4)?;
//! let (source, albedo) = ([Vec4::ONE, Vec4::ZERO], [Vec4::splat(0.8), Vec4::splat(0.5)]);
//! let mut state = State::new(2);
//! for _ in 0..64 {
//!     state.advance(&lists, &source, &albedo, &Settings::default())?;
//! }
//! // H_2 = F_21 B_1 and B_1 = 1 + ρ_1 F_12 ρ_2 H_2.
//! let expected = 0.5 / (1.0 - 0.8 * 0.5 * 0.5 * 0.5);
//! assert!((state.irradiance[1].x - expected).abs() < 1e-4 * expected);
//! # Ok::<(), patchlight_temporal::Error>(())
//! ```
//!
//! Source: A. S. Shcherbakov, thesis, MSU 2025, chapter 6; lists, control variate and choice of w are this project's
//! own.
//!
//! | feature | what it adds |
//! |---|---|
//! | none | bodies of kernels and types, with `core` only |
//! | `alloc` | distributions over rows, their tables, frames, on one core |
//! | `std`, by default | loops over all cores |
//!
//! Results are the same.
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
