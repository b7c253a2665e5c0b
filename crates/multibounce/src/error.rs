//! What can be wrong with an operator.

/// Why an operator was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A table has the wrong length.
    #[error("{name} holds {found} entries where {expected} are needed")]
    Length {
        /// The table.
        name: &'static str,
        /// Entries needed.
        expected: usize,
        /// Entries found.
        found: usize,
    },
    /// A setting lies outside its range.
    #[error("{name} is {value}; it must be {rule}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// The value given.
        value: f64,
        /// What it must be.
        rule: &'static str,
    },
    /// A value of a table is not a number that can stand there.
    #[error("{name}[{index}] is {value}; it must be {rule}")]
    Value {
        /// The table.
        name: &'static str,
        /// The entry.
        index: usize,
        /// Its value.
        value: f64,
        /// What it must be.
        rule: &'static str,
    },
    /// More patches, entries or bytes than can be numbered or held.
    #[error("{name}: {found}; at most {limit} are possible")]
    TooMany {
        /// What there is too much of.
        name: &'static str,
        /// How many there would be.
        found: u64,
        /// How many there may be.
        limit: u64,
    },
    /// Less memory than the least panel of an operator takes.
    #[error(
        "the operator takes {needed} MB of memory while it is built panel by panel, and {limit} MB are allowed; allow more"
    )]
    Memory {
        /// MB needed.
        needed: u64,
        /// MB allowed.
        limit: u64,
    },
    /// The file of an operator that does not fit into memory.
    #[error(
        "cannot {action} a file of {megabytes} MB for the operator in {}: {reason}; make room there, or name another folder",
        folder.display()
    )]
    File {
        /// The folder; the file has no name in it.
        folder: std::path::PathBuf,
        /// What failed.
        action: &'static str,
        /// Size of the file.
        megabytes: u64,
        /// What the system says.
        reason: std::string::String,
    },
    /// `I − diag(ρ) F` has no inverse: light would grow without end.
    #[error("light grows without end at patch {patch}: the rows of the form factors times the reflectance exceed 1")]
    Singular {
        /// The patch at which it shows.
        patch: usize,
    },
    /// The progress callback asked to stop.
    #[error("cancelled after {done} of {total}")]
    Cancelled {
        /// Steps done.
        done: usize,
        /// Steps in all.
        total: usize,
    },
}

/// One length against another.
pub(crate) fn check_length(name: &'static str, expected: usize, found: usize) -> Result<(), Error> {
    if expected == found { Ok(()) } else { Err(Error::Length { name, expected, found }) }
}
