//! Diffuse global illumination by radiosity, as a library: bake a scene once, light it in every frame.
//!
//! [`Bake::build`] cuts a scene into patches and elements, estimates their form factors and places receivers;
//! [`Bake::build_into`] keeps all of it in a file, which [`Bake::open`] has ready in a moment. A
//! [`Renderer`] puts a bake on an executor: native code, a Vulkan device of its own, or one that is borrowed from an
//! engine. [`Renderer::update_light`] finds the light of a frame, whatever lights, sky and emission have become,
//! without waiting; [`Renderer::irradiance`] hands out the device buffers, and [`Renderer::picture`] shades a picture.
//! An engine that knows the direct light already gives it: [`Renderer::set_sample_light`]. Methods whose operators do
//! not hold the albedo take another one of each material: [`Renderer::set_albedo`].
//!
//! How light goes between patches is a [`Method`]: classic radiosity, the operator of all bounces, progressive
//! feedback, sampled rows, the matrix round the camera, photons, or one's own. A frame is a plan of stages: direct
//! light at samples → first exitance → the method → elements, receivers and interpolation points → pixels ([`stage`]).
//!
//! Units: metres; exitance and irradiance W/m², radiance W/m²/sr, linear Rec.709 RGB.
//! Equation: `B = E + ρ H`, `H = F B` (Goral et al. 1984).
//!
//! ```
//! # extern crate assets as patchlight_assets;
//! # extern crate runtime as patchlight_runtime;
//! use std::sync::Arc;
//!
//! use patchlight::{Bake, BakeSettings, RenderSettings, Renderer, Silent};
//! use patchlight_runtime::cpu::Cpu;
//!
//! let loaded = patchlight_assets::load_or_build("cornell")?;
//! let settings = BakeSettings { patch_count: 200, receiver_density: 0.2, ..BakeSettings::default() };
//! let bake = Arc::new(Bake::build(&loaded.scene, &settings, &Silent)?);
//! let render = RenderSettings { size: (64, 48), sub_frames: 1, ..RenderSettings::default() };
//! let mut renderer = Renderer::new(bake, Box::new(Cpu::new()), &render, &Silent)?;
//! let camera = loaded.view.camera(64, 48);
//! let mut lighting = loaded.scene.lighting.clone();
//! lighting.lights[0].color *= 2.0;
//! renderer.update_light(&lighting, &camera)?;
//! let indirect = renderer.surface_irradiance()?;
//! assert!(indirect.iter().all(|h| h.is_finite()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod albedo;
pub mod bake;
#[cfg(feature = "debug-pictures")]
pub mod debug;
pub mod energy;
pub mod error;
pub mod file;
pub mod form_factors;
pub mod frame;
pub mod memory;
pub mod method;
pub mod observe;
pub mod operator;
pub mod outputs;
pub mod picture;
mod pixels;
pub mod renderer;
pub mod stage;
pub mod world;

pub use albedo::{Albedo, MAX_ALBEDO};
pub use bake::{Bake, BakeSettings, PatchBake, ReceiverKind};
pub use energy::{EnergyCheck, MeanRatio};
pub use error::{Error, Result};
pub use file::{BakeFile, FileSettings, Origin};
pub use form_factors::{Estimator, FormFactors};
pub use frame::{FrameInput, FramePlan};
pub use method::{Method, MethodReport, MethodSettings};
pub use observe::run_phase;
pub use picture::{Picture, Pictures};
pub use pixels::PixelGather;
pub use renderer::{
    FrameResult, LightUpdate, PendingPicture, ReceiverBuffers, ReceiverUpdate, RenderSettings, Renderer, SampleLight,
};
pub use stage::shade::PixelLight;
pub use transport::{Observer, Phase, Silent};
