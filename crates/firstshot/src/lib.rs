#![no_std]
//! Photons that start where lights fall first: indirect light of any mesh, unbiased, with its own error.
//!
//! Photons that are traced from lights spend their first segment, and most of their number where surfaces are dark, on
//! light that shadow rays find better. Here they start *already reflected*, from the surfaces that lights fall on (E.
//! A. Kopylov, "An efficient method of illumination computation using a probability distribution function for ray
//! generation", Keldysh Institute):
//!
//! 1. **Light elements** ([`light_elements`]): each triangle that a point, spot or parallel light may fall on is
//!    split into two, three or four until the light in the middle of a light element is the mean of that at its
//!    corners; obtuse elements are cut across their longest edge; edges of shadows are refined down to the limits. An
//!    element m of light n has the emission coefficient `Φ_mn = S ρ̄ ∫ h` (h the irradiance, ρ̄ of the mean or of the
//!    brightest texel).
//! 2. **Distribution** ([`Emission`]): an alias table over all elements, emitters, rectangle lights and parts of the
//!    sky, by the luminance of their power, picks in O(1). With A, B, C at a light element's corners and S = A + B +
//!    C the start point is at u from `u³(S − 3B) − 3u²(S − 2B) + 3u(S − B) = αS`, and v is linear on the section
//!    ([`kernel::linear`]).
//! 3. **Tracing** ([`Tracer`]): cosine-weighted directions, roulette with the chance `lum(ρ∘Φ)/lum(Φ)`, so all photons
//!    keep one luminance and their colour is in the ratio of the channels. Surfaces are two-sided Lambert, mirrors and
//!    clear glass in any mixture: the same number picks, and photons that start on a specular part keep the direction
//!    of the lamp's light. Holes let photons through. Each photon hit of reflected light adds to its cell j of a
//!    [`PhotonAccumulator`] (illumination maps, or patches): `H_j = Φ m_j / S_j`, W/m². Light that comes straight from
//!    area lights is direct and not counted, unless asked for.
//!
//! With shadow rays from the start points (`is_exact`) a photon's flux is that of the light there, `h(x)/h_linear(x)`,
//! and H has no bias from the table, but for spots of light that all four points of an element and of the one around it
//! miss; without them the table is the light, as in Kopylov's method. What else is printed there can be chosen: his
//! algorithm 1 ([`Subdivision::Kopylov`]), Cardano's formula ([`Cubic::Cardano`]), the brightest texel
//! ([`Texels::Bound`]). [`Emission::classical`] sends all photons from the lights, in the same code. A medium between
//! surfaces absorbs: a segment of d m leaves `e^(−σ d)` of the light.
//!
//! The error is known from independent batches, `√(Σ A σ² / Σ A H²)`; [`Tracer::run`] goes on until it is what was
//! asked for. Numbers come from Sobol's sequence with Owen's scrambling or from a hash. Sums are integers in fixed
//! point, in units of 2⁻²⁰ of a photon's mean flux ([`kernel::fixed`]): they do not depend on the order of photons, and
//! the same seed gives the same bytes for any number of threads and any division into rounds, by the host and by a
//! device. The bodies in [`kernel`] run as SPIR-V and on the host alike.
//!
//! Start points of a million photons, per cent in eighths of u (and of v) beside the density, lights at the corners 1,
//! 0, 0 and
//! 0.2, 1, 0.6:
//!
//! ```text
//! A B C         in   1/8    2/8    3/8    4/8    5/8    6/8    7/8    8/8
//! 1 0 0      u found 33.01  24.75  17.81  11.92   7.23   3.73   1.36   0.20
//!            density 33.01  24.80  17.77  11.91   7.23   3.71   1.37   0.20
//! 0.2 1 0.6  u found 17.02  17.36  16.77  15.46  13.48  10.51   6.89   2.49
//!            density 17.06  17.32  16.80  15.49  13.41  10.55   6.90   2.47
//!            v found 23.46  20.32  17.15  14.06  10.96   7.79   4.69   1.56
//!            density 23.44  20.31  17.19  14.06  10.94   7.81   4.69   1.56
//! ```
//!
//! ```
//! # extern crate scene as patchlight_scene;
//! use std::ops::ControlFlow;
//!
//! use patchlight_firstshot::{Emission, IlluminationMaps, PhotonSettings, LightElementSettings, Texels, Tracer};
//! use glam::Vec3;
//! use patchlight_scene::{Light, Material, Scene, SceneParts};
//! use patchlight_scene::gpu::{LIGHT_POINT, Triangle, TriangleUv};
//!
//! // A lamp between two plates.
//! let plate = |y: f32, edge_a: Vec3, edge_b: Vec3| Triangle { corner: Vec3::Y * y, edge_a, edge_b, ..Triangle::default() };
//! let scene = Scene::new(SceneParts {
//!     triangles: vec![plate(0.0, Vec3::Z, Vec3::X), plate(1.0, Vec3::X, Vec3::Z)],
//!     uvs: vec![TriangleUv::default(); 2],
//!     materials: vec![Material::default()],
//!     lights: vec![Light { kind: LIGHT_POINT, position: Vec3::new(0.2, 0.5, 0.2), color: Vec3::ONE, ..Light::default() }],
//!     ..SceneParts::default()
//! })?;
//! let ignore_progress = |_, _| ControlFlow::Continue(());
//! let emission = Emission::first_shot(&scene, &LightElementSettings::default(), Texels::Mean, true, &ignore_progress)?;
//! let maps = IlluminationMaps::new(&scene, 0.5)?;
//! let mut tracer = Tracer::new(&scene, &emission, &maps, PhotonSettings { error: 0.1, ..Default::default() })?;
//! tracer.run(&|_| ControlFlow::Continue(()));
//! let found = tracer.estimate();
//! assert!(found.round.error <= 0.1 && found.irradiance.iter().any(|h| h.x > 0.0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | feature | what it adds |
//! |---|---|
//! | none | bodies of kernels and types, with `core` only |
//! | `alloc` | light elements, tables, tracing, sums, on one core |
//! | `std`, by default | loops over all cores |
//!
//! Results are the same.
// The kernel build has `core` only.
#[cfg(any(feature = "alloc", test))]
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
