//! Start and end of a program, and the start of another one.

use std::env;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use crate::error::Error;
use crate::{print, progress};

/// Runs the work of a program. Exit code 0, 1 for an error, 2 for wrong usage (by the reader of the command line), 130
/// after Ctrl-C.
pub fn run<E: Failure>(threads: usize, work: impl FnOnce() -> Result<(), E>) -> ExitCode {
    // What a decoder of a damaged file says when it gives up is an error, which is printed as such.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !assets::import::is_guarded() {
            hook(panic);
        }
    }));
    if let Err(e) = progress::watch_for_cancel() {
        tell!("warning: Ctrl-C will stop at once: {e}");
    }
    let start = || Ok::<(), E>(start_threads(threads)?);
    match start().and_then(|()| work()).and_then(|()| Ok(print::finish()?)) {
        Ok(()) => ExitCode::SUCCESS,
        // Work that is told to stop may say so in words of its own.
        Err(e) if e.is_cancelled() || progress::is_cancelled() => {
            progress::tell_stopped();
            ExitCode::from(progress::STOPPED)
        }
        Err(e) => {
            tell!("error: {e}");
            ExitCode::FAILURE
        }
    }
}

/// Why the work of a program failed.
pub trait Failure: std::fmt::Display + From<Error> {
    /// Returns true if the user asked to stop.
    fn is_cancelled(&self) -> bool;
}

impl Failure for Error {
    fn is_cancelled(&self) -> bool {
        Self::is_cancelled(self)
    }
}

/// The pool of the whole process, so that no work starts threads of its own.
fn start_threads(threads: usize) -> Result<(), Error> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
    pool.build_global().map_err(|e| Error::Threads { threads, reason: e.to_string() })
}

/// Another program of the project, and what builds it.
#[derive(Clone, Copy, Debug)]
pub struct Program {
    /// Its name, without what the system appends.
    pub name: &'static str,
    /// The command that builds it beside this program.
    pub build: &'static str,
}

/// The window.
pub const VIEWER: Program = Program { name: "patchlight-view", build: "cargo build --release -p patchlight-view" };
/// The command line.
pub const CLI: Program = Program { name: "patchlight", build: "cargo build --release -p patchlight-cli" };
/// The experiments.
pub const BENCH: Program = Program { name: "patchlight-bench", build: "cargo build --release -p patchlight-bench" };

impl Program {
    /// Path of the program: beside this one, else in the folders of PATH.
    pub fn find(self) -> Option<PathBuf> {
        let own = env::current_exe().ok();
        let beside = own.as_deref().and_then(Path::parent).map(Path::to_path_buf);
        let path = env::var_os("PATH").unwrap_or_default();
        let file = format!("{}{}", self.name, env::consts::EXE_SUFFIX);
        let folders = beside.into_iter().chain(env::split_paths(&path));
        folders.map(|folder| folder.join(&file)).find(|program| program.is_file())
    }

    /// Path of the program.
    ///
    /// # Errors
    /// [`Error::NoProgram`] where it is not there.
    pub fn found(self) -> Result<PathBuf, Error> {
        let reason = "it is neither beside this program nor in PATH";
        self.find().ok_or_else(|| Error::NoProgram { name: self.name, build: self.build, reason: reason.to_owned() })
    }

    /// Becomes this program with these arguments, or starts it and ends as it ends where the system cannot replace a
    /// process.
    ///
    /// # Errors
    /// [`Error::NoProgram`] where it is not there, or does not start.
    pub fn run(self, arguments: &[OsString]) -> Result<ExitCode, Error> {
        let missing = |reason: String| Error::NoProgram { name: self.name, build: self.build, reason };
        let program = self.found()?;
        let mut command = Command::new(&program);
        command.args(arguments);
        replace_by(&mut command).map_err(|e| missing(format!("{} does not start: {e}", program.display())))
    }
}

/// Signals then reach the program itself.
#[cfg(unix)]
fn replace_by(command: &mut Command) -> Result<ExitCode, std::io::Error> {
    use std::os::unix::process::CommandExt as _;
    Err(command.exec())
}

#[cfg(not(unix))]
fn replace_by(command: &mut Command) -> Result<ExitCode, std::io::Error> {
    let code = command.status()?.code().and_then(|code| u8::try_from(code).ok());
    Ok(code.map_or(ExitCode::FAILURE, ExitCode::from))
}
