//! Path tracer, picture metrics and reference data: what every method of Patchlight is measured with.
//!
//! - `PathTracer` estimates `L = L_e + ρ/π · E` over a `scene::Scene`: two-sided Lambert surfaces with flat normals,
//!   mirrors and clear glass beside, alpha masks passed through, emission from the front face. Every path vertex casts
//!   a shadow ray to each light, to one emissive triangle and to one direction of the sky map, is connected with a
//!   point in parallel light, and goes on with a cosine-weighted ray; the balance heuristic (Veach and Guibas 1995)
//!   weights what can be found in several ways, Russian roulette ends dark paths. Unbiased: no clamping, no denoiser.
//! - Light is split at the visible surface: *direct* is what is seen of emitters and sky, and light that reached the
//!   visible surface straight from a light; *indirect* is the rest. Pixels are means over their squares.
//! - `Accumulation` holds the sums of a picture. It can be stopped, saved and continued; the bits do not depend on
//!   that, nor on the number of threads. Its standard errors come from the spread of passes of eight samples.
//! - `Picture` reads EXR, HDR and PNG and writes EXR and PNG, each file whole or not at all.
//! - `metrics` compares pictures (MSE, PSNR, SSIM, FLIP on displayed values; median relative error, PSNR and mean ratio
//!   on 8 × 8 block means) and irradiance at points; `metrics::faults` counts noise, leaks, stains and blotches,
//!   `metrics::edges` teeth along edges and patterns.
//!   `ReferenceData` reads a folder of pictures and points made by another program.
//!
//! Units: metres, radiance W/m²/sr, irradiance W/m², linear Rec.709 RGB.
//!
//! ```rust
//! # extern crate scene as patchlight_scene;
//! use std::ops::ControlFlow;
//!
//! use glam::{Vec3, vec3};
//! use patchlight_reference::{Accumulation, PathSettings, PathTracer};
//! use patchlight_scene::{Camera, Material, Scene, SceneParts, Sky};
//! use patchlight_scene::gpu::{Triangle, TriangleUv};
//!
//! let floor = Triangle { corner: vec3(-9.0, 0.0, -9.0), edge_a: vec3(0.0, 0.0, 99.0), edge_b: vec3(99.0, 0.0, 0.0), ..Default::default() };
//! let scene = Scene::new(SceneParts {
//!     triangles: vec![floor],
//!     uvs: vec![TriangleUv::default()],
//!     materials: vec![Material { albedo: Vec3::splat(0.4), ..Material::default() }],
//!     sky: Sky { radiance: Vec3::ONE, ..Sky::default() },
//!     ..SceneParts::default()
//! })?;
//! let camera = Camera::look_at(Vec3::Y, Vec3::ZERO, Vec3::X, 45.0, 16, 16);
//! let mut accumulation = Accumulation::new(&camera, PathSettings::default());
//! PathTracer::new(&scene).accumulate(&camera, &mut accumulation, 16, |_done, _target| ControlFlow::Continue(()))?;
//! // A floor below a sky of radiance 1 sends ρ.
//! assert!((accumulation.full().mean().x - 0.4).abs() < 1e-4);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod accumulation;
pub mod data;
pub mod error;
pub mod file;
pub mod metrics;
pub mod path;
pub mod picture;
mod sampler;
mod sky;
mod sun;

pub use accumulation::{Accumulation, BlockErrors, fingerprint};
pub use data::{ReferenceData, ReferencePoint};
pub use error::{Error, ResumeError};
pub use metrics::{Edges, Faults, Judge, PictureErrors, PointErrors, ReferenceNoise};
pub use path::{PathSettings, PathTracer, PointIrradiance, Reflected, Strategy};
pub use picture::{DisplayTransform, Picture, PictureFile, Precision, Tone, scale_to_stops, stops_to_scale};
