//! Errors of operators.

/// Why an operator was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A table, a setting, a value or a number that cannot be, or an end that was asked for.
    #[error(transparent)]
    Shared(#[from] transport::Error),
    /// Less memory than the least panel of an operator takes.
    #[error(
        "the operator takes {needed} MB of memory while it is built panel by panel, and {limit} MB are allowed; allow \
         more"
    )]
    Memory {
        /// MB needed.
        needed: u64,
        /// MB allowed.
        limit: u64,
    },
    /// The file of an operator that does not fit into memory.
    #[cfg(feature = "std")]
    #[error(
        "cannot {action} a file of {megabytes} MB for the operator in {}: {reason}; free some space there, or name \
         another folder",
        folder.display()
    )]
    File {
        /// The folder; the file has no name in it.
        folder: std::path::PathBuf,
        /// Failed action.
        action: &'static str,
        /// Size of the file.
        megabytes: u64,
        /// Message of the operating system.
        reason: alloc::string::String,
    },
    /// `I − diag(ρ) F` has no inverse: light would grow without end.
    #[error("light grows without end at patch {patch}: the rows of the form factors times the reflectance exceed 1")]
    Singular {
        /// The patch at which it shows.
        patch: usize,
    },
}
