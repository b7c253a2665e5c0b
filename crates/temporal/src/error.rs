//! What can be wrong with distributions and settings.

/// Why rows or a frame were refused.
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
    /// More entries than can be numbered.
    #[error("{name}: {found}; at most {limit} are possible")]
    TooMany {
        /// What there is too much of.
        name: &'static str,
        /// How many there would be.
        found: u64,
        /// How many there may be.
        limit: u64,
    },
}

/// One length against another.
pub(crate) fn check_length(name: &'static str, expected: usize, found: usize) -> Result<(), Error> {
    if expected == found { Ok(()) } else { Err(Error::Length { name, expected, found }) }
}
