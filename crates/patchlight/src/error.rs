//! Errors of the library.

use std::path::PathBuf;

/// Kind of an error, by what its remedy concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// A scene, lighting, settings or another argument.
    Input,
    /// A combination of scene, method and device that is not served.
    Unsupported,
    /// Memory of the host or of a device.
    Memory,
    /// A device, its driver or the system.
    Device,
    /// A file.
    File,
    /// The observer asked to stop.
    Cancelled,
}

/// Setting that an error concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Setting {
    /// Where receivers stand.
    Receivers,
    /// Distance between receivers on the mesh.
    ReceiverEdge,
    /// Greatest number of receivers.
    MaxReceivers,
    /// Kind of the patches.
    Patches,
    /// Number of patches.
    PatchCount,
    /// Edge of the voxels that bound patches.
    VoxelSize,
    /// Method, or its options.
    Method,
    /// Patches of the local matrix.
    Slots,
    /// Size of the picture.
    PictureSize,
    /// Memory that may be taken.
    MemoryLimit,
    /// Place where an operator is built.
    BuildOn,
    /// Unit that decodes texture blocks.
    Decode,
    /// Device.
    Device,
}

/// Change of a setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Change {
    /// A larger value.
    Larger,
    /// A smaller value.
    Smaller,
    /// This value, by its name on command lines and in files.
    To(&'static str),
    /// None at all.
    Without,
    /// Another value.
    Other,
}

/// Change of a setting that would help.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct Remedy {
    /// The setting.
    pub setting: Setting,
    /// Its change.
    pub change: Change,
}

impl Remedy {
    fn of(setting: Setting, change: Change) -> Self {
        Self { setting, change }
    }
}

/// Failure of the library. The message names the file, the place and the remedy; [`Error::kind`] says what to do about
/// it, [`Error::remedies`] which settings would help.
///
/// A method of one's own makes errors with [`Error::new`], or from those of the crates below.
#[derive(thiserror::Error)]
#[error(transparent)]
pub struct Error(Box<Reason>);

impl std::fmt::Debug for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// What failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Reason {
    /// A device or a plan.
    #[error(transparent)]
    Executor(runtime::executor::ExecutorError),
    /// Patches or form factors.
    #[error("form factors: {0}")]
    FormFactor(formfactor::Error),
    /// Virtual patches.
    #[error("patches: {0}")]
    Patches(patches::Error),
    /// Tables, settings and sizes of any method.
    #[error(transparent)]
    Transport(transport::Error),
    /// Photons.
    #[error("photons: {0}")]
    Photons(transport::Error),
    /// A medium between surfaces, of which form factors know nothing.
    #[error(
        "{what} goes by form factors, which know nothing of the medium that absorbs light between the surfaces of the \
         scene; choose firstshot, whose photons do, path trace the scene, or leave the medium out"
    )]
    Medium {
        /// The unsuitable feature.
        what: &'static str,
    },
    /// Receivers at pixels, whose light in a medium nothing finds.
    #[error("photons in a medium light receivers on the mesh, not at the pixels; choose receivers on the mesh")]
    MediumReceivers,
    /// Receivers that photons do not serve.
    #[error("photons light receivers on the mesh or at the pixels, not the patches themselves; choose other receivers")]
    FirstShotReceivers,
    /// Finish of surfaces where nothing knows the directions of light.
    #[error(
        "normal maps and specular lobes need receivers on the mesh, with light without noise at pixels; choose those, or \
         diffuse materials"
    )]
    FinishReceivers,
    /// Light at places of surfaces where no receivers stand on these.
    #[error("light at corners and texels is interpolated between receivers on the mesh; choose those")]
    OutputReceivers,
    /// A description that is no JSON, or not that of a probe volume.
    #[error("the description is damaged: {0}; export the probes again")]
    Json(serde_json::Error),
    /// Files of a probe volume that do not belong together.
    #[error("the probe volume is damaged: {what}; export the probes again")]
    Probes {
        /// Description of the fault.
        what: String,
    },
    /// A scene, or lighting that does not suit it.
    #[error(transparent)]
    Scene(scene::Error),
    /// The operator of the light between patches.
    #[error("operator: {0}")]
    Operator(multibounce::Error),
    /// The matrix round the camera.
    #[error("local matrix: {0}")]
    Local(localmatrix::Error),
    /// Matrices that would not fit into memory.
    #[error(
        "the operator of {patches} patches takes {needed:.1} GB while it is made, and {available:.1} GB are free; \
         choose fewer patches, or {instead}"
    )]
    OperatorMemory {
        /// The patches.
        patches: usize,
        /// GB needed.
        needed: f64,
        /// GB free.
        available: f64,
        /// Setting that takes less.
        instead: &'static str,
    },
    /// Texture blocks where no texture unit decodes them.
    #[error(
        "{device} has no textureCompressionBC, without which no texture unit decodes blocks; let the kernel \
         decode them, or choose another device"
    )]
    NoTextureUnit {
        /// The device.
        device: String,
    },
    /// Texture blocks that make a wider image than the device takes.
    #[error(
        "blocks of {patches} patches are an image as wide, {device} takes at most {limit} texels \
         (maxImageDimension2D); let the kernel decode them, or choose fewer patches"
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
        "the operator of {patches} patches takes {needed} MB beside the form factors even when it is built panel by \
         panel, and {left} MB are left; allow more memory, or choose fewer patches, or progressive feedback"
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
        "the operator of {patches} patches takes {needed:.1} GB of {device} while it is built: {source}; build it on \
         the host, or choose fewer patches"
    )]
    DeviceMemory {
        /// The patches.
        patches: usize,
        /// GB needed.
        needed: f64,
        /// The device.
        device: String,
        /// The device's error.
        source: Box<runtime::executor::ExecutorError>,
    },
    /// Texture blocks without their encoder.
    #[error(
        "this build cannot make texture blocks ({codec}): choose another codec, or build with the feature \
         `texture-blocks`"
    )]
    NoBlockEncoder {
        /// The codec.
        codec: &'static str,
    },
    /// A result could not be written.
    #[error("cannot write {}: {source}; check that the folder exists, may be written to and has room", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Error from the operating system.
        source: std::io::Error,
    },
    /// The scene has too many triangles for polygon patches.
    #[error(
        "{triangles} triangles give at least {needed} polygon patches, classic radiosity takes at most {limit}; \
         choose clusters as patches, path tracing, or a scene with fewer triangles"
    )]
    TooManyPatches {
        /// The scene's triangles.
        triangles: usize,
        /// Patches they give.
        needed: usize,
        /// Patches there may be.
        limit: usize,
    },
    /// Voxels so small, or so many patches, that there are too many of something.
    #[error("{found} {name}, and at most {limit} are possible; choose larger voxels or fewer patches")]
    TooManyVoxels {
        /// Name of the counted things.
        name: &'static str,
        /// Number found.
        found: u64,
        /// Greatest number allowed.
        limit: u64,
    },
    /// Patches that are not bound to voxels cannot be receivers.
    #[error(
        "only voxel and axis patches can be receivers themselves, {patches} patches cannot; choose those, or \
         receivers on the mesh"
    )]
    PatchesAsReceivers {
        /// The kind of patches.
        patches: &'static str,
    },
    /// A bake of a world.
    #[error(transparent)]
    Bake(localmatrix::BakeError),
    /// The rows of a round are to be traced; never shown.
    #[error("the rows of round {round} are to be traced")]
    RoundWaits {
        /// The round.
        round: u32,
    },
    /// Rows of a round are not there.
    #[error("{} is missing: round {round} of the bake needs the rows of all its parts; trace that part", path.display())]
    MissingRows {
        /// The round.
        round: u32,
        /// A file that is missing.
        path: PathBuf,
    },
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
    /// More memory than allowed.
    #[error(
        "{phase} take {} MB of memory, and {} MB are allowed; allow more, or choose larger voxels or a smaller scene",
        used >> 20, limit >> 20
    )]
    MemoryLimit {
        /// Phase that took it.
        phase: &'static str,
        /// Bytes resident.
        used: u64,
        /// Bytes allowed.
        limit: u64,
    },
    /// The settings ask for more than fits into memory.
    #[error("{what} would take about {:.1} GB, and {:.1} GB are free or allowed; \
         {remedy}", needed * 1e-9, *free as f64 * 1e-9)]
    TooLarge {
        /// Name of the table.
        what: String,
        /// Bytes.
        needed: f64,
        /// Bytes that are free.
        free: u64,
        /// Setting that takes less memory.
        remedy: &'static str,
    },
    /// Direct light of a caller's for another number of samples.
    #[error(
        "direct light of {found} samples, and the bake has {expected}; give one value for each of LightField::samples"
    )]
    SampleLightCount {
        /// Samples of the bake.
        expected: usize,
        /// Values given.
        found: usize,
    },
    /// Direct light of a caller's that no surface can receive.
    #[error("sample {sample} is to receive {value} W/m²; give finite irradiance that is not below 0")]
    SampleLightValue {
        /// Index of the sample.
        sample: usize,
        /// Value given.
        value: glam::Vec3,
    },
    /// A caller's direct light was in a buffer that an update has replaced by a larger one.
    #[error(
        "the buffer with the direct light of the samples is another one now: ask LightField::buffers for it, write \
         the light there, and call LightField::set_sample_light again"
    )]
    SampleLightLost,
    /// An albedo for another number of materials.
    #[error("an albedo for {found} materials of {expected}; give one value a material, none for that of the bake")]
    AlbedoCount {
        /// Materials of the scene.
        expected: usize,
        /// Values given.
        found: usize,
    },
    /// An albedo that no material has.
    #[error(
        "material {material} is to reflect {value}; give shares from 0 to {}, and no more than its mirror and \
         transmittance leave",
        crate::albedo::MAX_ALBEDO
    )]
    AlbedoValue {
        /// Index of the material.
        material: usize,
        /// Value given.
        value: glam::Vec3,
    },
    /// A point of one's own that is nowhere, or looks nowhere.
    #[error("point {index} is at {position} with the normal {normal}; give finite positions and unit normals")]
    PointValue {
        /// Index of the point.
        index: usize,
        /// Position given.
        position: glam::Vec3,
        /// Normal given.
        normal: glam::Vec3,
    },
    /// A method whose operator holds the albedo of the bake.
    #[error(
        "the operator of {method} holds the albedo of the bake; choose classic, feedback, temporal or firstshot, set \
         the albedo back, or bake the scene with another one"
    )]
    AlbedoHeld {
        /// The method.
        method: &'static str,
    },
    /// A mesh of an object that makes no sense.
    #[error("the object: {0}")]
    ObjectMesh(scene::MeshFault),
    /// An object that is nowhere, flat or inside out.
    #[error(
        "the object's transform has the determinant {determinant} and leads to {translation}; give a finite one that \
         neither flattens nor mirrors"
    )]
    ObjectTransform {
        /// Where it leads.
        translation: glam::Vec3,
        /// Determinant of its matrix.
        determinant: f32,
    },
    /// Objects where receivers are not on the mesh.
    #[error("objects that move need receivers on the mesh, of which the bake has none; bake with those")]
    ObjectReceivers,
    /// Something that objects are not served by.
    #[error("{what} knows nothing of objects that move; choose another, or remove the objects")]
    Objects {
        /// What it is.
        what: &'static str,
    },
    /// The system gives no thread for a bake in the background.
    #[error("cannot start a thread: {0}; bake without one")]
    Thread(#[source] std::io::Error),
    /// Another bake for a method that the caller made.
    #[error(
        "a method of the application's own is of the bake that it was made for; make a light field of the new bake, \
         with a new method"
    )]
    OwnMethod,
    /// The system gives no pool of threads.
    #[error("cannot start threads: {0}; give the bake a pool that is there")]
    Threads(String),
    /// An error of an application's own method.
    #[error(transparent)]
    Own(OwnError),
    /// The user asked to stop.
    #[error("stopped")]
    Cancelled,
}

/// An error that an application made.
#[derive(Debug, thiserror::Error)]
#[error("{source}")]
pub(crate) struct OwnError {
    kind: ErrorKind,
    source: Box<dyn std::error::Error + Send + Sync>,
}

/// Makes errors of those of the crates below.
macro_rules! from_errors_of_crates {
    ($($variant:ident: $source:ty),+ $(,)?) => {
        $(impl From<$source> for Error {
            fn from(error: $source) -> Self {
                Reason::$variant(error).into()
            }
        })+
    };
}

from_errors_of_crates! {
    Executor: runtime::executor::ExecutorError,
    FormFactor: formfactor::Error,
    Patches: patches::Error,
    Transport: transport::Error,
    Json: serde_json::Error,
    Scene: scene::Error,
    Operator: multibounce::Error,
    Local: localmatrix::Error,
    Bake: localmatrix::BakeError,
}

impl From<Reason> for Error {
    fn from(reason: Reason) -> Self {
        Self(Box::new(reason))
    }
}

impl From<runtime::recipe::localmatrix::CopyError> for Error {
    fn from(error: runtime::recipe::localmatrix::CopyError) -> Self {
        match error {
            runtime::recipe::localmatrix::CopyError::Executor(error) => error.into(),
            runtime::recipe::localmatrix::CopyError::Matrix(error) => error.into(),
        }
    }
}

impl Error {
    /// An error of an application's own part, such as its [`Method`](crate::Method).
    pub fn new(kind: ErrorKind, source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        match kind {
            ErrorKind::Cancelled => Self::cancelled(),
            _ => Reason::Own(OwnError { kind, source: source.into() }).into(),
        }
    }

    /// The end that an observer asked for.
    #[must_use]
    pub fn cancelled() -> Self {
        Reason::Cancelled.into()
    }

    /// Kind of the error.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match &*self.0 {
            _ if self.is_cancelled() => ErrorKind::Cancelled,
            Reason::Executor(error) if error.is_out_of_memory() => ErrorKind::Memory,
            Reason::OperatorMemory { .. }
            | Reason::OperatorPanels { .. }
            | Reason::DeviceMemory { .. }
            | Reason::MemoryLimit { .. }
            | Reason::TooLarge { .. } => ErrorKind::Memory,
            Reason::Executor(_) | Reason::Thread(_) | Reason::Threads(_) => ErrorKind::Device,
            Reason::Write { .. }
            | Reason::Json(_)
            | Reason::Probes { .. }
            | Reason::Bake(_)
            | Reason::OtherScene { .. }
            | Reason::MissingRows { .. } => ErrorKind::File,
            Reason::Medium { .. }
            | Reason::MediumReceivers
            | Reason::FirstShotReceivers
            | Reason::OutputReceivers
            | Reason::PatchesAsReceivers { .. }
            | Reason::NoTextureUnit { .. }
            | Reason::WideBlocks { .. }
            | Reason::NoBlockEncoder { .. }
            | Reason::OwnMethod
            | Reason::ObjectReceivers
            | Reason::Objects { .. }
            | Reason::AlbedoHeld { .. } => ErrorKind::Unsupported,
            Reason::Own(error) => error.kind,
            _ => ErrorKind::Input,
        }
    }

    /// Changes of settings that would help, those that help most first; none where no setting is at fault.
    #[must_use]
    pub fn remedies(&self) -> Vec<Remedy> {
        use Change::{Larger, Other, Smaller, To, Without};
        use Setting::{
            BuildOn, Decode, Device, MaxReceivers, MemoryLimit, Method, PatchCount, Patches, PictureSize, ReceiverEdge,
            Receivers, Slots, VoxelSize,
        };
        let all: &[(Setting, Change)] = match &*self.0 {
            Reason::FirstShotReceivers => &[(Receivers, To("mesh")), (Receivers, To("pixels"))],
            Reason::OutputReceivers | Reason::MediumReceivers | Reason::ObjectReceivers => &[(Receivers, To("mesh"))],
            Reason::PatchesAsReceivers { .. } => {
                &[(Patches, To("voxel")), (Patches, To("axis")), (Receivers, To("mesh"))]
            }
            Reason::TooLarge { .. } => &[
                (ReceiverEdge, Larger),
                (MaxReceivers, Smaller),
                (PatchCount, Smaller),
                (Method, To("low_rank")),
                (Slots, Smaller),
                (PictureSize, Smaller),
                (MemoryLimit, Larger),
            ],
            Reason::OperatorMemory { instead, .. } => {
                return vec![Remedy::of(PatchCount, Smaller), Remedy::of(Method, To(instead))];
            }
            Reason::NoTextureUnit { .. } => &[(Decode, To("kernel")), (Device, Other)],
            Reason::WideBlocks { .. } => &[(Decode, To("kernel")), (PatchCount, Smaller)],
            Reason::OperatorPanels { .. } => &[(MemoryLimit, Larger), (PatchCount, Smaller), (Method, To("feedback"))],
            Reason::DeviceMemory { .. } => &[(BuildOn, To("host")), (PatchCount, Smaller)],
            Reason::TooManyPatches { .. } => &[(Patches, To("cluster")), (Method, To("path"))],
            Reason::TooManyVoxels { .. } => &[(VoxelSize, Larger), (PatchCount, Smaller)],
            Reason::MemoryLimit { .. } => &[(MemoryLimit, Larger), (VoxelSize, Larger)],
            Reason::Patches(error) => match error {
                patches::Error::VoxelSizeWithoutVoxels { .. } => {
                    &[(Patches, To("voxel")), (Patches, To("axis")), (VoxelSize, Without), (PatchCount, Other)]
                }
                patches::Error::Shared(transport::Error::PolygonShape { .. }) => &[(Patches, To("cluster"))],
                patches::Error::LongTriangle { .. } => &[(ReceiverEdge, Larger), (PatchCount, Smaller)],
                patches::Error::TooMany { .. } | patches::Error::Shared(transport::Error::TooMany { .. }) => {
                    &[(VoxelSize, Larger), (PatchCount, Smaller)]
                }
                _ => &[],
            },
            _ => &[],
        };
        all.iter().map(|&(setting, change)| Remedy::of(setting, change)).collect()
    }

    /// The error of a crate below, of the system or of [`Error::new`], if it is one of that type.
    #[must_use]
    pub fn downcast_ref<E: std::error::Error + 'static>(&self) -> Option<&E> {
        let inner: &(dyn std::error::Error + 'static) = match &*self.0 {
            Reason::Executor(error) => error,
            Reason::FormFactor(error) => error,
            Reason::Patches(error) => error,
            Reason::Transport(error) | Reason::Photons(error) => error,
            Reason::Json(error) => error,
            Reason::Scene(error) => error,
            Reason::Operator(error) => error,
            // A file's fault, however far down it was found.
            Reason::Local(localmatrix::Error::Bake(error)) | Reason::Bake(error) => error,
            Reason::Local(error) => error,
            Reason::Write { source, .. } | Reason::Thread(source) => source,
            Reason::DeviceMemory { source, .. } => &**source,
            Reason::Own(error) => &*error.source,
            _ => return None,
        };
        inner.downcast_ref()
    }

    /// What failed.
    pub(crate) fn reason(&self) -> &Reason {
        &self.0
    }

    /// Returns true if the observer asked to stop.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        match &*self.0 {
            Reason::Cancelled => true,
            Reason::Transport(error) => is_cancelled(error),
            Reason::FormFactor(formfactor::Error::Shared(error)) => is_cancelled(error),
            Reason::Operator(multibounce::Error::Shared(error)) => is_cancelled(error),
            Reason::Local(localmatrix::Error::Cancelled) => true,
            Reason::Local(localmatrix::Error::Shared(error)) => is_cancelled(error),
            Reason::Patches(patches::Error::Shared(error)) => is_cancelled(error),
            _ => false,
        }
    }
}

fn is_cancelled(error: &transport::Error) -> bool {
    matches!(error, transport::Error::Cancelled { .. })
}

/// Result of what can fail here.
pub type Result<T> = std::result::Result<T, Error>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_say_their_kind_their_remedies_and_what_lies_below() {
        let memory: Error =
            Reason::OperatorMemory { patches: 1, needed: 2.0, available: 1.0, instead: "feedback" }.into();
        let remedies = [(Setting::PatchCount, Change::Smaller), (Setting::Method, Change::To("feedback"))];
        assert_eq!(memory.remedies(), remedies.map(|(setting, change)| Remedy::of(setting, change)));
        assert_eq!(memory.kind(), ErrorKind::Memory);
        assert!(memory.downcast_ref::<transport::Error>().is_none());
        let own = Error::new(ErrorKind::Device, std::io::Error::other("the cable is loose"));
        assert_eq!((own.kind(), own.to_string().as_str()), (ErrorKind::Device, "the cable is loose"));
        assert!(own.downcast_ref::<std::io::Error>().is_some() && own.remedies().is_empty());
        let file =
            Error::from(localmatrix::Error::Bake(localmatrix::BakeError::MissingParts { parts: 3, missing: vec![] }));
        assert!(file.downcast_ref::<localmatrix::BakeError>().is_some());
    }

    #[test]
    fn an_end_that_was_asked_for_is_of_a_kind_of_its_own() {
        let below = transport::Error::Cancelled { done: 1, total: 2 };
        for error in [Error::cancelled(), below.into(), localmatrix::Error::Cancelled.into()] {
            assert!(error.is_cancelled() && error.kind() == ErrorKind::Cancelled, "{error}");
        }
        assert!(Error::new(ErrorKind::Cancelled, "enough").is_cancelled());
        assert!(!Error::from(localmatrix::Error::NotThere { patch: 1 }).is_cancelled());
    }
}
