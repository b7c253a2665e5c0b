//! Errors of experiments.

use std::path::PathBuf;

use shell::program::Failure;

/// Why an experiment failed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Errors of any program.
    #[error(transparent)]
    Shell(shell::Error),
    /// An experiment cannot go on.
    #[error(
        "{}: not what --resume can continue ({why}); give the options of that run, another --out, or leave \
         out --resume",
        path.display()
    )]
    OtherExperiment {
        /// The file.
        path: PathBuf,
        /// The difference.
        why: String,
    },
    /// Data of the report are not what they should be.
    #[error(
        "{}: not data of the report ({why}); measure again with `patchlight bench {experiment}`, or mend the \
         file", path.display()
    )]
    Data {
        /// The file.
        path: PathBuf,
        /// Description of the fault.
        why: String,
        /// Experiment that makes it.
        experiment: &'static str,
    },
    /// References that are not there.
    #[error(
        "no reference of {} in {}; make them once with `bench clean --references SCENE`, take smaller ones with \
         --paths 256, or name the folder that holds them with --cache",
        scenes.join(", "),
        folder.display()
    )]
    NoReferences {
        /// The scenes.
        scenes: Vec<String>,
        /// Folder in which they were looked for.
        folder: PathBuf,
    },
    /// More scenes than an experiment has.
    #[error("`bench {experiment}` measures one scene, and {found} are named; run it for each")]
    OneScene {
        /// The experiment.
        experiment: &'static str,
        /// Scenes that are named.
        found: usize,
    },
    /// A scene at rest where movement is measured.
    #[error("nothing moves in {scene}; give a scene with objects that do, such as office:person")]
    NothingMoves {
        /// The scene.
        scene: String,
    },
    /// Another program that is measured beside ours.
    #[error("{}: {why}; --against takes a `patchlight` program that can bake the scene", program.display())]
    Against {
        /// The program.
        program: PathBuf,
        /// Why it failed.
        why: String,
    },
    /// A figure that is not measured.
    #[error("there is no figure `{name}` to measure; choose one of {known}")]
    NoFigure {
        /// The name.
        name: String,
        /// Those that there are.
        known: String,
    },
    /// References that are looked for nowhere.
    #[error("--references needs a folder here; only `bench clean --references` makes references by itself")]
    NoReferenceFolder,
    /// A reference whose noise is not known.
    #[error("{paths} paths a pixel do not tell their noise; ask for at least 16 with --paths")]
    FewPaths {
        /// Paths a pixel.
        paths: u32,
    },
    /// The system names no folder for caches.
    #[error("the user's cache folder is not known ({why}); name one with --cache")]
    NoCacheFolder {
        /// Message of the operating system.
        why: String,
    },
}

/// Errors that the shell takes for its own.
impl<E> From<E> for Error
where
    shell::Error: From<E>,
{
    fn from(error: E) -> Self {
        Self::Shell(error.into())
    }
}

impl Failure for Error {
    fn is_cancelled(&self) -> bool {
        matches!(self, Self::Shell(error) if error.is_cancelled())
    }
}

impl Error {
    /// Returns true if the user asked to stop.
    pub fn is_cancelled(&self) -> bool {
        Failure::is_cancelled(self)
    }

    /// Names the scene that it is about.
    pub fn of_scene(error: impl Into<shell::Error>, scene: &str) -> Self {
        Self::Shell(shell::Error::of_scene(error, scene))
    }
}
