//! Common parts of Patchlight's programs: errors as a user sees them, results on disk, progress, arguments, summaries,
//! and how a program starts and ends.

#![warn(clippy::print_stdout, clippy::print_stderr)]

#[macro_use]
pub mod print;

pub mod args;
pub mod device;
pub mod error;
pub mod errors;
pub mod measure;
pub mod opened;
pub mod operator_error;
pub mod output;
pub mod path;
pub mod program;
pub mod progress;
pub mod report;
pub mod sequence;
pub mod summary;

pub use error::Error;
