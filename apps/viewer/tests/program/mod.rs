//! Runs the program as a user does.

use std::path::Path;
use std::process::{Command, Output, Stdio};

/// The program with these arguments, not started yet.
pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_patchlight-view"));
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

pub fn run(arguments: &[&str]) -> Output {
    command(arguments).output().expect("the program starts")
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Runs a command that must fail with `code`, and returns its message.
pub fn fails(code: i32, arguments: &[&str]) -> String {
    let output = run(arguments);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
    assert!(!message.contains("panicked"), "{arguments:?}: {message}");
    message
}

/// Half-written files of a folder.
#[allow(dead_code, reason = "not all tests look for them")]
pub fn leftovers(folder: &Path) -> Vec<String> {
    let names = std::fs::read_dir(folder).map(|d| d.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()));
    names.map(|n| n.filter(|n| n.contains("part") || n.contains("tmp")).collect()).unwrap_or_default()
}
