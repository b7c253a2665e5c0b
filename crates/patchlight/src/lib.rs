//! Diffuse global illumination by radiosity, as a library: bake a scene once, light it in every frame.
//!
//! [`Bake::build`] cuts a scene into patches and elements, estimates their form factors and places receivers;
//! [`Bake::start`] does so in the background, and [`Bake::build_into`] keeps all of it in a file, which [`Bake::open`]
//! has ready in a moment. There are two doors to
//! its light:
//!
//! - A [`LightField`] puts a bake on an executor: native code, a Vulkan device of its own, or one that is borrowed from
//!   an engine. [`LightField::update`] finds the light of a frame without waiting, whatever lights, sky and emission
//!   have become; [`LightField::buffers`] hands out the device buffers, and [`LightField::add_points`] lights places of
//!   one's own: vertices, texels, probes, sensors. It has no camera and no pictures. An engine that knows the direct
//!   light already gives it: [`LightField::set_sample_light`]. Methods whose operators do not hold the albedo take
//!   another one of each material: [`LightField::set_albedo`].
//!   Objects that move stand in its way, and are lit: [`LightField::objects`].
//! - A [`PictureRenderer`] makes pictures of a light field: primary rays, direct light at pixels, shading, display.
//!
//! How light goes between patches is a [`Method`]: classic radiosity, the operator of all bounces, progressive
//! feedback, sampled rows, the matrix round the camera, photons, or one's own. A frame is a plan of stages: direct
//! light at samples → first exitance → the method → elements, receivers and interpolation points → pixels
//! ([`low_level::stage`]).
//!
//! This crate is the only one that an application needs: `scene`, `runtime`, `transport` and `glam` are
//! re-exported, what is needed of them most often by its own name.
//!
//! A bake takes minutes in large scenes. [`Bake::refine`] begins with a coarse one, made in seconds, and goes on in the
//! background; [`PictureRenderer::refine`] takes each finer level between two frames.
//!
//! Units: metres; exitance and irradiance W/m², radiance W/m²/sr, linear Rec.709 RGB.
//! Equation: `B = E + ρ H`, `H = F B` (Goral et al. 1984).
//!
//! ```
//! # extern crate assets as patchlight_assets;
//! use std::sync::Arc;
//!
//! use patchlight::{Bake, BakeSettings, Cpu, LightField, LightSettings, PictureRenderer, PictureSettings, Silent};
//!
//! let loaded = patchlight_assets::load_or_build("cornell")?;
//! let settings = BakeSettings::default().with_patch_count(200).with_receiver_density(0.2);
//! let bake = Arc::new(Bake::build(&loaded.scene, &settings, &Silent)?);
//! let mut light = LightField::new(bake, Box::new(Cpu::new()), &LightSettings::default(), &Silent)?;
//! let mut lighting = loaded.scene.lighting.clone();
//! lighting.lights[0].color *= 2.0;
//! light.update(&lighting)?;
//! let indirect = light.surface_irradiance()?;
//! assert!(indirect.iter().all(|h| h.is_finite()));
//!
//! // A picture of it.
//! let settings = PictureSettings::default().with_size((64, 48)).with_sub_frames(1);
//! let mut renderer = PictureRenderer::new(light, &settings)?;
//! let picture = renderer.picture(&lighting, &loaded.view.camera(64, 48), 0)?;
//! assert!(picture.pictures.full.mean().min_element() > 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod albedo;
pub mod bake;
#[cfg(feature = "debug-pictures")]
pub mod debug;
pub mod edit;
pub mod energy;
pub mod error;
pub mod file;
pub mod form_factors;
pub mod job;
pub mod light;
pub mod low_level;
pub mod memory;
pub mod method;
pub mod objects;
pub mod observe;
pub mod outputs;
pub mod picture;
pub mod pictures;
mod pixels;
pub mod points;
pub mod refine;
pub mod rounds;
mod settings;
pub mod world;

#[doc(inline)]
pub use albedo::{Albedo, MAX_ALBEDO};
#[doc(inline)]
pub use bake::{Bake, BakeSettings, PatchBake, ReceiverKind};
#[doc(inline)]
pub use edit::EditedBake;
#[doc(inline)]
pub use energy::{EnergyCheck, MeanRatio};
#[doc(inline)]
pub use error::{Change, Error, ErrorKind, Remedy, Result, Setting};
#[doc(inline)]
pub use file::{BakeFile, FileSettings, Origin};
#[doc(inline)]
pub use form_factors::{Estimator, FormFactors};
#[doc(inline)]
pub use job::{BakeJob, BakeProgress};
#[doc(inline)]
pub use light::{LightField, LightSettings, LightUpdate, ReceiverBuffers, SampleLight};
#[doc(inline)]
pub use low_level::frame::{FrameInput, FramePlan};
#[doc(inline)]
pub use low_level::operator::{Build, BuildOn, Codec, Decode};
#[doc(inline)]
pub use low_level::stage::shade::PixelLight;
#[doc(inline)]
pub use method::{Method, MethodReport, MethodSettings};
#[doc(inline)]
pub use objects::{ObjectId, Objects};
#[doc(inline)]
pub use observe::run_phase;
#[doc(inline)]
pub use picture::{Picture, Pictures};
#[doc(inline)]
pub use pictures::{FrameResult, PendingPicture, PictureRenderer, PictureSettings, ReceiverUpdate};
#[doc(inline)]
pub use pixels::PixelGather;
#[doc(inline)]
pub use points::{Point, PointKind, PointLight, PointSet};
#[doc(inline)]
pub use refine::Refinement;
#[doc(inline)]
pub use rounds::Round;
pub use transport::{Observer, Phase, Silent};

pub use runtime::cpu::Cpu;
pub use runtime::executor::{DeviceChoice, Executor, open};
#[cfg(feature = "vulkan")]
pub use runtime::vulkan::{BorrowedDevice, Vulkan};
pub use scene::{
    Camera, DisplayTransform, Flux, Intensity, Irradiance, Light, LightId, Lighting, Material, MaterialId, Mesh,
    Radiance, Scene, SceneBuilder, SurfacePoint, TextureId, Tone,
};
pub use {glam, rayon, runtime, scene, transport};
