#![no_std]
//! Dynamic diffuse global illumination by probes (DDGI), an opponent: the bodies of its kernels.
//!
//! A probe holds irradiance H in 8 × 8 octahedral texels, as its fifth root, and the mean of distances and of their
//! squares in 16 × 16, each with a border of one texel. In a frame each probe sends rays; what one meets sends
//! `ρ/π (H_d + H)` back, W/m²/sr, with H from the probes as the frame before left them, so that bounces add up
//! ([`kernel::trace`]). Texels blend the rays in with hysteresis ([`kernel::blend`]). A point takes H from the eight
//! probes round it: trilinear, less from those behind the surface, less from those that by Chebyshev's inequality are
//! not seen from it ([`kernel::lookup`]).
//!
//! The host side (placement of the probes, whole light updates on the CPU) is `opponents::Ddgi`, which runs the same
//! bodies; here is only what a device needs, too. Roots and powers are products and Newton's steps, so that CPU and GPU
//! give the same bits.
//!
//! ```
//! use ddgi::kernel::octahedral::{decode, encode};
//! use glam::{Vec2, Vec3};
//!
//! // Up is the middle of the square, down its corners.
//! assert_eq!(encode(Vec3::Z), Vec2::ZERO);
//! assert_eq!(decode(Vec2::ONE), Vec3::NEG_Z);
//! ```
//!
//! Sources: Majercik, Guertin, Nowrouzezahrai, McGuire 2019, JCGT 8(2); Majercik, Marrs, Spjut, McGuire 2021, JCGT
//! 10(2).

pub mod kernel;
pub mod types;

pub use types::*;
