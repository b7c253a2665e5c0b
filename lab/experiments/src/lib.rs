//! Experiments of `patchlight-bench`: tables, plots and reports that prove each claim.

#![warn(clippy::print_stdout, clippy::print_stderr)]

#[macro_use]
extern crate shell;

pub mod args;
pub mod bandwidth;
pub mod bench;
mod date;
mod error;
pub mod probes;
pub mod proxy;
pub mod references;

pub use error::Error;
pub(crate) use shell::{errors, measure, output, path, progress, report, sequence, summary};
