//! Scene files in: scene .toml version 1, OBJ with MTL, glTF and GLB, their textures, lights and cameras, luminaires of
//! IES and EULUMDAT files.
//!
//! Everything inside a [`scene::Scene`] is in metres: lengths of files are multiplied by `metres_per_unit`. What can be
//! repaired is repaired and stated in [`LoadedScene::warnings`]; what cannot is an [`ImportError`] that names file,
//! place and remedy. No input panics.

use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::Vec3;
use scene::{Camera, Scene};
use serde::{Deserialize, Serialize};

pub mod animation;
mod description;
pub(crate) mod draft;
mod error;
mod gltf_file;
mod gltf_moving;
mod lightmap_uvs;
pub(crate) mod lights;
pub mod luminaire;
pub mod moving;
mod mtl;
mod obj;
mod optics;
pub(crate) mod pictures;
mod scene_file;

pub use animation::{Animation, Keyframe, Target, Track};
pub use error::ImportError;
pub use lightmap_uvs::{AtlasTriangle, LightmapUvs};
pub use luminaire::Photometry;
pub use moving::{MovingObject, Pose};
pub use pictures::is_guarded;

/// Viewpoint of a picture, in metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Position of the eye, m.
    pub eye: Vec3,
    /// A point in the middle of the picture, m.
    pub target: Vec3,
    /// Up, any length.
    pub up: Vec3,
    /// Vertical field of view, degrees.
    pub vertical_fov_degrees: f32,
}

impl Default for View {
    fn default() -> Self {
        Self { eye: Vec3::new(0.0, 0.0, 1.0), target: Vec3::ZERO, up: Vec3::Y, vertical_fov_degrees: 45.0 }
    }
}

impl View {
    /// The pinhole of this view for a picture size in pixels.
    pub fn camera(&self, width: u32, height: u32) -> Camera {
        Camera::look_at(self.eye, self.target, self.up, self.vertical_fov_degrees, width, height)
    }
}

/// Triangles that the file has and the scene does not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Dropped {
    /// Without area.
    pub zero_area: usize,
    /// Equal to another one: same corners, same winding.
    pub duplicates: usize,
    /// Triangles of a material with `d` below 0.5.
    pub holes: usize,
}

/// A scene ready for every method, with what a picture of it needs.
#[derive(Clone)]
pub struct LoadedScene {
    /// Name: the file's stem, or that of the built-in scene.
    pub name: String,
    /// Geometry, materials, textures, lights, sky; metres.
    pub scene: Scene,
    /// Camera of the file, or one that frames the bounds.
    pub view: View,
    /// Exposure of pictures: radiance is multiplied by 2 to this power.
    pub exposure_stops: f32,
    /// True if the scene says its exposure; else [`Self::exposure_stops`] is 0, and pictures may choose.
    pub is_exposed: bool,
    /// Length of the file's unit, m.
    pub metres_per_unit: f32,
    /// Names of objects, by [`scene::gpu::Triangle::object`].
    pub objects: Vec<String>,
    /// Names of materials, by [`scene::gpu::Triangle::material`].
    pub materials: Vec<String>,
    /// Names of textures, in the order of [`scene::Geometry::textures`].
    pub textures: Vec<String>,
    /// Repairs and replacements; each line names the file or material.
    pub warnings: Vec<String>,
    /// Lights and camera over time; without tracks when the file has none.
    pub animation: Animation,
    /// Objects that move through the scene, none of them among its triangles.
    pub moving: Vec<MovingObject>,
    /// SHA-256 over everything that decides a picture.
    pub content_hash: [u8; 32],
    /// Files that it was read from; none for a built-in scene.
    pub files: Vec<PathBuf>,
    /// Triangles in the file, before any was dropped.
    pub file_triangles: usize,
    /// Triangles that were dropped.
    pub dropped: Dropped,
    /// Coordinates that the file brings for a lightmap; none where it brings none that suit.
    pub lightmap_uvs: LightmapUvs,
    /// Seconds of each phase of the import.
    pub timings: Vec<(&'static str, f64)>,
}

/// Choices of [`load_with`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoadOptions {
    /// Largest texel buffer in bytes; the largest textures are halved until they fit. The default, 128 MiB, is the
    /// smallest storage-buffer range among the devices that are supported.
    pub texel_budget: usize,
    /// Most memory that the triangles may take while they are read, bytes; `None` for what the system says is free.
    pub memory_limit: Option<u64>,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self { texel_budget: 128 << 20, memory_limit: None }
    }
}

/// Reads a scene file (.toml, .obj, .gltf, .glb), or builds the built-in scene of that name ([`crate::procedural`])
/// when there is no such file.
///
/// # Errors
/// [`ImportError`]: file, place and remedy.
pub fn load_or_build(spec_or_path: &str) -> Result<LoadedScene, ImportError> {
    load_or_build_with(spec_or_path, &LoadOptions::default())
}

/// [`load_or_build`] with choices.
///
/// # Errors
/// [`ImportError`]: file, place and remedy.
pub fn load_or_build_with(spec_or_path: &str, options: &LoadOptions) -> Result<LoadedScene, ImportError> {
    if crate::procedural::is_built_in(spec_or_path) && !Path::new(spec_or_path).is_file() {
        return crate::procedural::build(spec_or_path);
    }
    load_with(Path::new(spec_or_path), options)
}

/// Reads a scene file: .toml version 1, .obj, .gltf or .glb.
///
/// # Errors
/// [`ImportError`]: file, place and remedy.
pub fn load(path: &Path) -> Result<LoadedScene, ImportError> {
    load_with(path, &LoadOptions::default())
}

/// [`load`] with choices.
///
/// # Errors
/// [`ImportError`]: file, place and remedy.
pub fn load_with(path: &Path, options: &LoadOptions) -> Result<LoadedScene, ImportError> {
    if ending(path) == "toml" {
        return scene_file::load(path, options);
    }
    let mesh = read_mesh(path, options)?;
    let name = path.file_stem().map_or_else(|| String::from("scene"), |s| s.to_string_lossy().into_owned());
    let setting = draft::Setting { default_light: true, ..draft::Setting::new(path, &name) };
    draft::finish(mesh, setting, options)
}

fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

/// The geometry and materials of an .obj, .gltf or .glb file.
fn read_mesh(path: &Path, options: &LoadOptions) -> Result<draft::Mesh, ImportError> {
    let start = Instant::now();
    let ending = ending(path);
    if !path.is_dir() && !["obj", "gltf", "glb"].contains(&ending.as_str()) {
        return Err(ImportError::UnknownFormat { path: path.to_path_buf() });
    }
    let bytes = read(path)?;
    let read_seconds = draft::seconds(start);
    let mut mesh =
        if ending == "obj" { obj::load(path, &bytes, options)? } else { gltf_file::load(path, &bytes, options)? };
    mesh.timings.insert(0, ("read", read_seconds));
    mesh.files.push(path.to_path_buf());
    Ok(mesh)
}

/// All bytes of a file that has some.
fn read(path: &Path) -> Result<Vec<u8>, ImportError> {
    if path.is_dir() {
        return Err(ImportError::Directory { path: path.to_path_buf() });
    }
    let bytes =
        scene::host::read_regular(path).map_err(|source| ImportError::Read { path: path.to_path_buf(), source })?;
    if bytes.is_empty() {
        return Err(ImportError::Empty { path: path.to_path_buf() });
    }
    Ok(bytes)
}
