//! What can be wrong with a run of photons.

/// Why photons were refused.
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
    /// More cells, elements or photons than can be numbered.
    #[error("{name}: {found}; at most {limit} are possible")]
    TooMany {
        /// What there is too much of.
        name: &'static str,
        /// How many there would be.
        found: u64,
        /// How many there may be.
        limit: u64,
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

/// A setting against its rule.
pub(crate) fn check_setting(name: &'static str, value: f64, rule: &'static str, holds: bool) -> Result<(), Error> {
    if holds { Ok(()) } else { Err(Error::Setting { name, value, rule }) }
}
