//! Diffuse global illumination by radiosity, ready to run: scene import, executors, frame plans, methods, and the program
//! `patchlight`.
//!
//! A scene file or a built-in scene becomes a [`import::LoadedScene`] ([`import::load_or_build`]): triangles, materials,
//! textures, lights and sky in metres. A frame is data: a [`plan::Plan`] of buffers and passes over the kernels of
//! `gpu-kernels`; what a pass reads and writes, and so order, barriers and lifetimes ([`graph`]), follow from the kernel
//! table. An [`executor::Executor`] runs it: [`cpu::Cpu`] by the kernels' host forms on all cores, [`vulkan::Vulkan`] by
//! their SPIR-V modules; the results agree. [`render`] holds the methods.
//!
//! ```no_run
//! use runtime::executor::{DeviceChoice, open};
//! use runtime::import::load_or_build;
//! use runtime::progress::Progress;
//! use runtime::render::classic::{Classic, ClassicSettings};
//!
//! let loaded = load_or_build("cornell")?;
//! let (executor, _note) = open(&DeviceChoice::Auto)?;
//! let mut progress = Progress::new(false);
//! let mut classic = Classic::bake(&loaded, ClassicSettings::default(), executor, &mut progress)?;
//! let frame = classic.frame(&loaded.scene.lights, &loaded.view.camera(960, 540), 0)?;
//! frame.pictures.full.write_png("cornell.png".as_ref(), loaded.exposure_stops)?;
//! # Ok::<(), runtime::Error>(())
//! ```

pub mod bake;
pub mod bandwidth;
pub mod cli;
pub mod cpu;
pub mod error;
pub mod executor;
pub mod export;
pub mod graph;
pub mod import;
pub mod plan;
pub mod procedural;
pub mod progress;
pub mod render;
pub mod summary;
pub mod vulkan;

pub use error::Error;
