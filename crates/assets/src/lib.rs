//! Scenes in and out: scene .toml, OBJ with MTL, glTF and GLB with their textures, lights, cameras and animations,
//! measured luminaires of IES LM-63 and EULUMDAT files ([`import`]); the same written as files ([`export`]); and scenes
//! that are built by a program ([`procedural`]).
//!
//! ```
//! let loaded = patchlight_assets::import::load_or_build("cornell")?;
//! assert_eq!(loaded.scene.lighting.lights.len(), 1);
//! # Ok::<(), patchlight_assets::import::ImportError>(())
//! ```

pub mod export;
pub mod import;
pub mod procedural;

pub use import::{Animation, ImportError, LoadedScene, View, load, load_or_build};
