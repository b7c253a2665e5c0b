//! What can go wrong, as the user sees it.

use std::path::PathBuf;

/// Why a command failed. Messages name the file, the place and the remedy; the exit code is 1, or 130 after Ctrl-C.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A scene file.
    #[error(transparent)]
    Import(#[from] crate::import::ImportError),
    /// A device or a plan.
    #[error(transparent)]
    Executor(#[from] crate::executor::ExecutorError),
    /// A picture, a comparison, a saved accumulation.
    #[error(transparent)]
    Reference(#[from] reference::Error),
    /// Patches or form factors.
    #[error("form factors: {0}")]
    FormFactor(#[from] formfactor::Error),
    /// Virtual patches.
    #[error("patches: {0}")]
    Patches(#[from] patches::Error),
    /// Tables, settings and sizes of any method.
    #[error(transparent)]
    Transport(#[from] transport::Error),
    /// Photons.
    #[error("photons: {0}")]
    Photons(transport::Error),
    /// Rows that frames sample.
    #[error("temporal radiosity: {0}")]
    Temporal(transport::Error),
    /// Receivers that photons do not serve.
    #[error("--method firstshot gathers at the mesh or at the pixels; choose --receivers mesh or pixels")]
    FirstShotReceivers,
    /// The operator of the light between patches.
    #[error("operator: {0}")]
    Operator(#[from] multibounce::Error),
    /// The matrix round the camera.
    #[error("local matrix: {0}")]
    Local(#[from] localmatrix::Error),
    /// Matrices that would not fit into memory.
    #[error(
        "the operator of {patches} patches takes {needed:.1} GB while it is made, and {available:.1} GB are free; choose a \
         smaller --patch-count, or --method {instead}"
    )]
    OperatorMemory {
        /// The patches.
        patches: usize,
        /// GB needed.
        needed: f64,
        /// GB free.
        available: f64,
        /// What takes less.
        instead: &'static str,
    },
    /// Texture blocks where no texture unit decodes them.
    #[error(
        "{device} has no textureCompressionBC, without which no texture unit decodes blocks; choose --decode kernel, or \
         another --device"
    )]
    NoTextureUnit {
        /// The device.
        device: String,
    },
    /// Texture blocks that make a wider image than the device takes.
    #[error(
        "blocks of {patches} patches are an image as wide, {device} takes at most {limit} texels (maxImageDimension2D); \
         choose --decode kernel, or a smaller --patch-count"
    )]
    WideBlocks {
        /// The device.
        device: String,
        /// The patches.
        patches: usize,
        /// Greatest width of its images.
        limit: u32,
    },
    /// A limit that is too small for panels of an operator.
    #[error(
        "the operator of {patches} patches takes {needed} MB beside the form factors even when it is built panel by panel, and \
         {left} MB are left; allow more with --memory-limit, or choose a smaller --patch-count, or --method feedback"
    )]
    OperatorPanels {
        /// The patches.
        patches: usize,
        /// MB needed.
        needed: u64,
        /// MB that the limit leaves.
        left: u64,
    },
    /// A device on which an operator does not fit while it is built.
    #[error(
        "the operator of {patches} patches takes {needed:.1} GB of {device} while it is built: {source}; choose --build-on host, or \
         a smaller --patch-count"
    )]
    DeviceMemory {
        /// The patches.
        patches: usize,
        /// GB needed.
        needed: f64,
        /// The device.
        device: String,
        /// What it says.
        source: Box<crate::executor::ExecutorError>,
    },
    /// An experiment cannot go on.
    #[error("{}: not what --resume can continue ({why}); give the options of that run, another --out, or leave out --resume", path.display())]
    OtherExperiment {
        /// The file.
        path: PathBuf,
        /// What is different.
        why: String,
    },
    /// A result could not be written.
    #[error("cannot write {}: {source}; check that the folder exists, may be written to and has room", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The scene has too many triangles for polygon patches.
    #[error(
        "{scene}: {triangles} triangles give at least {needed} polygon patches, classic radiosity takes at most {limit}; \
         choose --patches cluster, --method path, or a scene with fewer triangles"
    )]
    TooManyPatches {
        /// The scene.
        scene: String,
        /// Its triangles.
        triangles: usize,
        /// Patches they give.
        needed: usize,
        /// Patches there may be.
        limit: usize,
    },
    /// Voxels so small, or so many patches, that there are too many of something.
    #[error(
        "{found} {name}, and at most {limit} are possible; choose a larger --voxel-size or a smaller --patch-count"
    )]
    TooManyVoxels {
        /// What there are too many of.
        name: &'static str,
        /// How many there would be.
        found: u64,
        /// How many there may be.
        limit: u64,
    },
    /// Patches that are not bound to voxels cannot do what is asked.
    #[error(
        "{option} needs patches of voxels, and {patches} patches have none; choose --patches voxel or axis, or {instead}"
    )]
    NoVoxels {
        /// What was asked.
        option: &'static str,
        /// The kind of patches.
        patches: &'static str,
        /// What does without voxels.
        instead: &'static str,
    },
    /// A bake of a world.
    #[error(transparent)]
    Bake(#[from] localmatrix::BakeError),
    /// A bake of another scene than the one it names now.
    #[error(
        "{} is a bake of {scene} as it was then, and {scene} has changed; bake it again", path.display()
    )]
    OtherScene {
        /// The bake.
        path: PathBuf,
        /// The scene that it names.
        scene: String,
    },
    /// A bake goes with one method.
    #[error("{} is a bake; render it with --method local, or render its scene", path.display())]
    BakeMethod {
        /// The bake.
        path: PathBuf,
    },
    /// More memory than allowed.
    #[error(
        "{phase} take {} MB of memory, and --memory-limit allows {} MB; allow more, or choose a larger --voxel-size or a smaller scene",
        used >> 20, limit >> 20
    )]
    MemoryLimit {
        /// What took it.
        phase: &'static str,
        /// Bytes resident.
        used: u64,
        /// Bytes allowed.
        limit: u64,
    },
    /// A bake with blocks that cannot be read.
    #[error("{}: {lost} of {blocks} blocks cannot be read; copy the file again, or bake the scene again", path.display())]
    LostBlocks {
        /// The bake.
        path: PathBuf,
        /// Blocks that are lost.
        lost: usize,
        /// All blocks.
        blocks: u32,
    },
    /// The thread pool could not be made.
    #[error("cannot start {threads} threads: {reason}; choose fewer with --threads")]
    Threads {
        /// Threads asked for.
        threads: usize,
        /// What the system says.
        reason: String,
    },
    /// The user asked to stop.
    #[error("stopped")]
    Cancelled,
}
