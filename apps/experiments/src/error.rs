//! What can go wrong in the programs, as the user sees it.

use std::path::PathBuf;

use runtime::executor::ExecutorError;

/// Why a command failed. Messages name the file, the place and the remedy; the exit code is 1, or 130 after Ctrl-C.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A scene file.
    #[error(transparent)]
    Import(#[from] assets::ImportError),
    /// The library.
    #[error("{}", with_hint(.0))]
    Library(#[from] patchlight::Error),
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
    /// A bake goes with one method.
    #[error("{} is a bake; render it with --method local, or render its scene", path.display())]
    BakeMethod {
        /// The bake.
        path: PathBuf,
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

/// The library's error, and which options of the program do what it advises.
fn with_hint(error: &patchlight::Error) -> String {
    use patchlight::Error as Library;
    let options = match error {
        Library::FirstShotReceivers | Library::PatchesAsReceivers { .. } => "--patches, --receivers",
        Library::OperatorMemory { instead, .. } => return format!("{error} (--patch-count, --method {instead})"),
        Library::NoTextureUnit { .. } => "--decode kernel, --device",
        Library::WideBlocks { .. } => "--decode kernel, --patch-count",
        Library::OperatorPanels { .. } => "--memory-limit, --patch-count, --method feedback",
        Library::DeviceMemory { .. } => "--build-on host, --patch-count",
        Library::TooManyPatches { .. } => "--patches cluster, --method path",
        Library::TooManyVoxels { .. } => "--voxel-size, --patch-count",
        Library::MemoryLimit { .. } => "--memory-limit, --voxel-size",
        _ => return error.to_string(),
    };
    format!("{error} ({options})")
}

/// What the crates of the library say goes the same way as what the library says.
macro_rules! through_library {
    ($($error:ty),+) => {
        $(impl From<$error> for Error {
            fn from(error: $error) -> Self {
                Self::Library(error.into())
            }
        })+
    };
}

through_library!(
    ExecutorError,
    reference::Error,
    transport::Error,
    formfactor::Error,
    patches::Error,
    multibounce::Error,
    localmatrix::Error,
    localmatrix::BakeError
);
