//! Errors in a scene file: each message names the file, the place in it and the remedy.

use std::path::PathBuf;

/// Why a scene could not be read, built or written.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The file cannot be opened or read.
    #[error("{}: cannot be read: {source}; give the path of a file that exists and that you may read", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error from the operating system.
        source: std::io::Error,
    },
    /// The path is a folder.
    #[error("{}: is a folder; give the scene file in it (.toml, .obj, .gltf or .glb)", path.display())]
    Directory {
        /// The folder.
        path: PathBuf,
    },
    /// The file has no bytes.
    #[error("{}: is empty; give a complete file (was a copy or download cut short?)", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// Neither a known ending nor the name of a built-in scene.
    #[error("{}: what this is cannot be told from its ending; give a .toml, .obj, .gltf or .glb file", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// The scene file is not TOML, has an unknown key or a value of the wrong kind.
    #[error("{}, line {line}: {reason}; see \"Scene .toml version 1\" for the keys", path.display())]
    Toml {
        /// The scene file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Message of the parser.
        reason: String,
    },
    /// The scene file is of a version this program does not know.
    #[error("{}, line {line}: version {found} is not known; write `version = 1`, or use a newer \
         patchlight", path.display())]
    Version {
        /// The scene file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Value found there.
        found: String,
    },
    /// A value of the scene file makes no sense.
    #[error("{}, line {line}: {key}: {reason}", path.display())]
    Value {
        /// The scene file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// The key.
        key: String,
        /// The fault and its remedy.
        reason: String,
    },
    /// The mesh that a scene file names does not exist.
    #[error("{}: the mesh {} does not exist; correct the key `mesh`, it is relative to the scene \
         file", path.display(), mesh.display())]
    MissingMesh {
        /// The scene file.
        path: PathBuf,
        /// The mesh.
        mesh: PathBuf,
    },
    /// A line of an OBJ file is wrong.
    #[error("{}, line {line}, object \"{object}\", face {face}: {reason}; export the mesh again", path.display())]
    Obj {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Object or group.
        object: String,
        /// Face of that object, from 1; the next one when the line is not a face.
        face: usize,
        /// Description of the fault.
        reason: String,
    },
    /// A corner is not finite or too far away.
    #[error("{}, object \"{object}\", face {face}: the corner {corner:?} is not within {limit:e} m of the origin; \
         correct it, or metres_per_unit", path.display())]
    Coordinate {
        /// The file.
        path: PathBuf,
        /// Object, group or mesh.
        object: String,
        /// Triangle of that object, from 1.
        face: usize,
        /// The corner in file units.
        corner: [f32; 3],
        /// Greatest coordinate, m.
        limit: f32,
    },
    /// A scene that is too small for rays.
    #[error("{}: the scene is {size:e} m across; below {limit} m rays cannot tell its surfaces apart: correct \
         metres_per_unit", path.display())]
    TooSmall {
        /// The file.
        path: PathBuf,
        /// Diagonal of its bounds, m.
        size: f32,
        /// Least diagonal, m.
        limit: f32,
    },
    /// A scene so far from the origin that coordinates cannot tell its corners apart.
    #[error("{}: coordinates of {coordinate:e} m come in steps of {step:e} m, too coarse for a scene {size:e} m across: \
         move it nearer to the origin, or correct metres_per_unit", path.display())]
    FarFromOrigin {
        /// The file.
        path: PathBuf,
        /// Greatest coordinate, m.
        coordinate: f32,
        /// Distance of single-precision numbers there, m.
        step: f32,
        /// Diagonal of its bounds, m.
        size: f32,
    },
    /// A part of a glTF file is wrong.
    #[error("{}, {place}: {reason}; export the file again", path.display())]
    Gltf {
        /// The file.
        path: PathBuf,
        /// Which node, mesh, accessor or buffer.
        place: String,
        /// Description of the fault.
        reason: String,
    },
    /// The file has no triangle with an area.
    #[error("{}: has no triangle with an area; a scene needs at least one surface", path.display())]
    NoTriangles {
        /// The file.
        path: PathBuf,
    },
    /// More triangles than indices can count.
    #[error("{}: has {count} triangles, at most {limit} can be loaded; split or simplify the mesh", path.display())]
    TooManyTriangles {
        /// The file.
        path: PathBuf,
        /// Triangles.
        count: usize,
        /// Limit.
        limit: usize,
    },
    /// More triangles than memory holds.
    #[error(
        "{}: has {count} triangles, every place counted at which a mesh is shown, which take {} MB, and {} MB are \
         free or allowed; split or simplify the mesh, or show it at fewer \
         places", path.display(), needed.div_ceil(1 << 20), allowed >> 20
    )]
    Memory {
        /// The file.
        path: PathBuf,
        /// Triangles.
        count: usize,
        /// Bytes needed.
        needed: u64,
        /// Bytes that may be used.
        allowed: u64,
    },
    /// The photometry of a luminaire cannot be used.
    #[error("{}, line {line}: {reason}", path.display())]
    Luminaire {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// The fault and its remedy.
        reason: String,
    },
    /// The picture of the sky cannot be used.
    #[error("{}: cannot be used as a sky: {reason}; give an equirectangular .hdr or .exr picture", path.display())]
    SkyMap {
        /// The picture.
        path: PathBuf,
        /// Description of the fault.
        reason: String,
    },
    /// A material sends more light than it gets.
    #[error(
        "{}: material \"{material}\": {found}; lower what it reflects diffusely, mirrors or lets through, in the \
         mesh or by \
         [[material]] of a scene file", path.display()
    )]
    Reflectance {
        /// The file.
        path: PathBuf,
        /// The material.
        material: String,
        /// Kind of fault.
        found: scene::ReflectanceFault,
    },
    /// The scene cannot be built from what was read.
    #[error("{}: {source}", path.display())]
    Scene {
        /// The file.
        path: PathBuf,
        /// The underlying error.
        source: scene::Error,
    },
    /// An object that moves could not be put into a scene.
    #[error("an object that moves through {scene}: {source}")]
    Moving {
        /// Name of the scene.
        scene: String,
        /// Why.
        source: scene::BuildError,
    },
    /// No built-in scene has this name, or its triangle count is out of range.
    #[error("built-in scene \"{spec}\": {reason}")]
    Procedural {
        /// Requested scene.
        spec: String,
        /// The fault and the accepted values.
        reason: String,
    },
    /// A file cannot be written.
    #[error("{}: cannot be written: {source}; choose an output folder that you may write to, with enough \
         room", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Error from the operating system.
        source: std::io::Error,
    },
}
