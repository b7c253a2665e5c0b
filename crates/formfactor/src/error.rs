//! Errors of patches, form factors and their files.

/// Why a form-factor computation was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A table, a setting, a value or a number that cannot be, or an end that was asked for.
    #[error(transparent)]
    Shared(#[from] transport::Error),
    /// The estimator works on outlines, and these patches have none.
    #[error("{estimator} needs the outlines of the patches")]
    NoOutlines {
        /// The estimator.
        estimator: &'static str,
    },
    /// A row has no points.
    #[error("row {row} has no points")]
    EmptyRow {
        /// The row.
        row: usize,
    },
    /// I − diag(ρ) F has no inverse that double precision can give.
    #[error("channel {channel}: the equations have no solution at patch {patch}")]
    Singular {
        /// The colour channel, 0 to 2.
        channel: usize,
        /// The first patch with a value that is not finite.
        patch: usize,
    },
    /// A file could not be read or written.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: alloc::string::String,
        /// Message of the operating system.
        reason: alloc::string::String,
    },
    /// A file of rows is not what it should be.
    #[error("{path}: {reason} (expected {expected}, found {found})")]
    FileContent {
        /// The file.
        path: alloc::string::String,
        /// Description of the fault.
        reason: &'static str,
        /// Expected value.
        expected: u64,
        /// Value found.
        found: u64,
    },
}
