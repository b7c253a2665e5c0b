//! What `patchlight bench` runs, and what the program shares with it: results on disk, reports, movements, app errors.

#![warn(clippy::print_stdout, clippy::print_stderr)]

#[macro_use]
pub mod print;

pub mod args;
pub mod bandwidth;
pub mod bench;
mod date;
mod error;
pub mod errors;
pub mod measure;
pub mod output;
pub mod path;
pub mod photons;
pub mod probes;
pub mod progress;
pub mod proxy;
pub mod references;
pub mod report;
pub mod sequence;
pub mod summary;
pub mod worst_blocks;

pub use error::Error;
