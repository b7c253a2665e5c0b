//! Errors of the programs, as the user sees them.

use std::path::PathBuf;

use patchlight::Change;
use runtime::executor::ExecutorError;

/// Why a command failed. Messages name the file, the place and the remedy; the exit code is 1, or 130 after Ctrl-C.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A scene file.
    #[error("{}", import_with_hint(.0))]
    Import(#[from] assets::ImportError),
    /// The library.
    #[error("{}", with_hint(.0))]
    Library(#[from] patchlight::Error),
    /// A picture, a comparison, a saved accumulation.
    #[error(transparent)]
    Reference(#[from] reference::Error),
    /// A result could not be written.
    #[error("cannot write {}: {source}; check that the folder exists, may be written to and has room", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Error from the operating system.
        source: std::io::Error,
    },
    /// Standard output could not be written.
    #[error("cannot write to standard output: {source}; files were written as asked, only the text is lost")]
    Print {
        /// Error from the operating system.
        source: std::io::Error,
    },
    /// The surfaces of a world are diffuse.
    #[error(
        "{} is the bake of a world, whose surfaces are diffuse; leave out --materials, or render its scene",
        path.display()
    )]
    WorldMaterials {
        /// The bake.
        path: PathBuf,
    },
    /// The bake of a world goes with one method.
    #[error("{} is the bake of a world; render it with --method local, or render its scene", path.display())]
    BakeMethod {
        /// The bake.
        path: PathBuf,
    },
    /// A bake without the operator of a method.
    #[error(
        "{} holds no operator for --method {asked}, {}; bake the scene again with `patchlight bake SCENE {again}`, or \
         render the scene itself",
        path.display(),
        what_is_held(held)
    )]
    NotHeld {
        /// The bake.
        path: PathBuf,
        /// The method and options that were asked for.
        asked: String,
        /// Those that it has operators for.
        held: Vec<String>,
        /// Options to give to `bake`.
        again: String,
    },
    /// The bake of a world where light is to be written.
    #[error("{} is the bake of a world, whose light is never there as a whole; give a scene or the bake of \
         one", path.display())]
    WorldLight {
        /// The bake.
        path: PathBuf,
    },
    /// The bake of a scene where parts of a world are joined.
    #[error(
        "{} is the bake of a scene, which has no parts; give those of a world (`patchlight world SCENE --part K/N`)",
        path.display()
    )]
    NoPart {
        /// The bake.
        path: PathBuf,
    },
    /// A path whose folder cannot be told.
    #[error("{}: where it is cannot be told: {source}; give an absolute path", path.display())]
    NoPath {
        /// The path.
        path: PathBuf,
        /// Error from the operating system.
        source: std::io::Error,
    },
    /// A word that a job template would take for an expression.
    #[error("`{word}` holds two opening brackets, which a job template takes for an expression; rename it")]
    Unplannable {
        /// The path or name.
        word: String,
    },
    /// A file that is no bake where a bake is to be written.
    #[error("{} is there and is no bake; remove it, or choose another name with --out", path.display())]
    Overwrites {
        /// The file.
        path: PathBuf,
    },
    /// A bake with blocks that cannot be read.
    #[error(
        "{}: {lost} of {blocks} blocks cannot be read; copy the file again, or bake the scene again",
        path.display()
    )]
    LostBlocks {
        /// The bake.
        path: PathBuf,
        /// Blocks that are lost.
        lost: usize,
        /// All blocks.
        blocks: u32,
    },
    /// A device where only native code works.
    #[error("{command} runs as native code on the CPU only; leave out --device {device}, or choose --device cpu")]
    NoDevice {
        /// The command.
        command: &'static str,
        /// The device asked for.
        device: String,
    },
    /// Another program of the project is not there.
    #[error("`{name}` cannot be started: {reason}; build it with `{build}`")]
    NoProgram {
        /// The program.
        name: &'static str,
        /// Command that builds it.
        build: &'static str,
        /// Why not.
        reason: String,
    },
    /// The thread pool could not be made.
    #[error("cannot start {threads} threads: {reason}; choose fewer with --threads")]
    Threads {
        /// Threads asked for.
        threads: usize,
        /// Message of the operating system.
        reason: String,
    },
    /// A picture with a pixel that is no number.
    #[error(
        "frame {frame}: pixel ({x}, {y}) is not a finite number; lower the light or the emission that shines there"
    )]
    NotFinite {
        /// The frame, from 0.
        frame: u32,
        /// The pixel, from the left.
        x: u32,
        /// And from the top.
        y: u32,
    },
    /// Two pictures that cannot be compared.
    #[error("{} beside {}: {source}", ours.display(), reference.display())]
    Compared {
        /// The first picture.
        ours: PathBuf,
        /// The reference.
        reference: PathBuf,
        /// Why not.
        source: Box<reference::Error>,
    },
    /// A window that cannot be shown any longer.
    #[error(transparent)]
    Window(Box<dyn std::error::Error + Send + Sync>),
    /// A scene that cannot be used.
    #[error("{scene}: {source}")]
    OfScene {
        /// The scene as the command line names it.
        scene: String,
        /// The underlying error.
        source: Box<Self>,
    },
    /// The user asked to stop.
    #[error("stopped")]
    Cancelled,
}

impl Error {
    /// Returns true if the user, or whoever watches, asked to stop.
    pub fn is_cancelled(&self) -> bool {
        match self {
            Self::Cancelled => true,
            Self::Library(error) => error.is_cancelled(),
            Self::OfScene { source, .. } => source.is_cancelled(),
            _ => false,
        }
    }

    /// Names the scene that it is about.
    pub fn of_scene(error: impl Into<Self>, scene: &str) -> Self {
        Self::OfScene { scene: scene.to_owned(), source: Box::new(error.into()) }
    }
}

/// The operators that a bake has.
fn what_is_held(held: &[String]) -> String {
    match held.is_empty() {
        true => "nor any other".to_owned(),
        false => format!("but for --method {}", held.join(", ")),
    }
}

/// Fault of a scene, and the option that does what is advised.
fn import_with_hint(error: &assets::ImportError) -> String {
    match error {
        assets::ImportError::Memory { .. } => format!("{error} (--memory-limit)"),
        _ => error.to_string(),
    }
}

/// The library's error, and which options of the program do what it advises.
fn with_hint(error: &patchlight::Error) -> String {
    match hint(error) {
        Some(options) => format!("{error} ({options})"),
        None => error.to_string(),
    }
}

/// The options that do what an error of the library advises.
fn hint(error: &patchlight::Error) -> Option<String> {
    if let Some(fault) = error.downcast_ref() {
        return bake_hint(fault);
    }
    let mut options: Vec<(&str, String)> = Vec::new();
    for remedy in error.remedies() {
        let Some(option) = option(remedy.setting) else { continue };
        match (remedy.change, options.last_mut()) {
            // Another value of the same.
            (Change::To(value), Some((last, text))) if *last == option => *text += &format!(" or {value}"),
            (Change::To(value), _) => options.push((option, format!("{option} {value}"))),
            (Change::Larger, _) => options.push((option, format!("a larger {option}"))),
            (Change::Smaller, _) => options.push((option, format!("a smaller {option}"))),
            (Change::Without, _) => options.push((option, format!("no {option}"))),
            (_, _) => options.push((option, option.to_owned())),
        }
    }
    let texts: Vec<String> = options.into_iter().map(|(_, text)| text).collect();
    (!texts.is_empty()).then(|| texts.join(", "))
}

/// The option behind a setting of the library.
fn option(setting: patchlight::Setting) -> Option<&'static str> {
    use patchlight::Setting;
    Some(match setting {
        Setting::Receivers => "--receivers",
        Setting::ReceiverEdge => "--receiver-edge",
        Setting::MaxReceivers => "--most-receivers",
        Setting::Patches => "--patches",
        Setting::PatchCount => "--patch-count",
        Setting::VoxelSize => "--voxel-size",
        Setting::Method => "--method",
        Setting::Slots => "--slots",
        Setting::PictureSize => "--size",
        Setting::MemoryLimit => "--memory-limit",
        Setting::BuildOn => "--build-on",
        Setting::Decode => "--decode",
        Setting::Device => "--device",
        _ => return None,
    })
}

fn bake_hint(error: &localmatrix::BakeError) -> Option<String> {
    match error {
        localmatrix::BakeError::NotABake { .. } => Some("patchlight bake SCENE -o FILE".to_owned()),
        localmatrix::BakeError::Kind { .. } => Some("patchlight merge PART... -o FILE".to_owned()),
        localmatrix::BakeError::MissingParts { parts, .. } => Some(format!("--part K/{parts}")),
        _ => None,
    }
}

/// Converts errors of the library's crates by way of the library's own.
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
    scene::Error,
    transport::Error,
    formfactor::Error,
    patches::Error,
    multibounce::Error,
    localmatrix::Error,
    localmatrix::BakeError
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_the_library_name_the_options_that_help() {
        let few = patches::Error::LongTriangle { triangle: 4, length: 9.0, cells: 2, limit: 1 };
        let long = Error::from(few).to_string();
        assert!(long.contains("(a larger --receiver-edge, a smaller --patch-count)"), "{long}");
        let parts = Error::from(localmatrix::BakeError::MissingParts { parts: 3, missing: vec![2] });
        assert!(parts.to_string().contains("(--part K/3)"), "{parts}");
        let cancelled = Error::from(transport::Error::Cancelled { done: 1, total: 2 });
        assert!(!cancelled.to_string().contains("--"), "{cancelled}");
    }

    #[test]
    fn an_end_that_was_asked_for_is_told_from_a_failure() {
        let cancelled = transport::Error::Cancelled { done: 1, total: 2 };
        assert!(Error::Cancelled.is_cancelled() && Error::from(cancelled.clone()).is_cancelled());
        assert!(Error::from(formfactor::Error::from(cancelled)).is_cancelled());
        assert!(Error::from(localmatrix::Error::Cancelled).is_cancelled());
        assert!(!Error::from(localmatrix::Error::NotThere { patch: 1 }).is_cancelled());
    }
}
