//! Errors of tables, settings and long work in any method.

/// Why something was refused. Variants name the table or setting, the place in it, and the value.
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
        /// Rule that it breaks.
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
        /// Rule that it breaks.
        rule: &'static str,
    },
    /// More of something than can be numbered or held.
    #[error("{name}: {found}; at most {limit} are possible")]
    TooMany {
        /// Name of the counted things.
        name: &'static str,
        /// Number found.
        found: u64,
        /// Greatest number allowed.
        limit: u64,
    },
    /// A polygon has too few or too many corners.
    #[error("a polygon with {found} corners: 3 to {most} are possible")]
    PolygonCorners {
        /// Corners given.
        found: usize,
        /// Most corners.
        most: usize,
    },
    /// A polygon is not flat, not convex, or has no area.
    #[error("corner {corner} of a polygon {reason}")]
    PolygonShape {
        /// The corner at which it shows.
        corner: usize,
        /// Description of the fault.
        reason: &'static str,
    },
    /// The observer or progress callback asked to stop.
    #[error("cancelled after {done} of {total}")]
    Cancelled {
        /// Steps done.
        done: usize,
        /// Steps in all.
        total: usize,
    },
}

/// Checks a table of offsets: `rows + 1` of them, none less than the one before, the last one `entries`.
///
/// # Errors
/// [`Error::Length`] or [`Error::Value`] with the first offset that is wrong.
pub fn check_offsets(name: &'static str, rows: usize, entries: usize, offsets: &[u32]) -> Result<(), Error> {
    check_length(name, rows + 1, offsets.len())?;
    if let Some(index) = offsets.windows(2).position(|pair| pair[0] > pair[1]) {
        let value = f64::from(offsets[index + 1]);
        return Err(Error::Value { name, index: index + 1, value, rule: "no less than the one before" });
    }
    match offsets[rows] as usize == entries {
        true => Ok(()),
        false => {
            Err(Error::Value { name, index: rows, value: f64::from(offsets[rows]), rule: "the number of entries" })
        }
    }
}

/// Checks a table of indices: each is below `count`, or [`scene::NONE`] where that may be.
///
/// # Errors
/// [`Error::Value`] with the first that is not.
pub fn check_indices(name: &'static str, count: usize, or_none: bool, indices: &[u32]) -> Result<(), Error> {
    match indices.iter().position(|&k| k as usize >= count && !(or_none && k == scene::NONE)) {
        Some(index) => {
            Err(Error::Value { name, index, value: f64::from(indices[index]), rule: "the number of one that is there" })
        }
        None => Ok(()),
    }
}

/// Checks the length of a table.
///
/// # Errors
/// [`Error::Length`] unless `expected` is `found`.
pub fn check_length(name: &'static str, expected: usize, found: usize) -> Result<(), Error> {
    match expected == found {
        true => Ok(()),
        false => Err(Error::Length { name, expected, found }),
    }
}

/// Checks a setting against its rule.
///
/// # Errors
/// [`Error::Setting`] unless the rule `holds`.
pub fn check_setting(name: &'static str, value: f64, rule: &'static str, holds: bool) -> Result<(), Error> {
    match holds {
        true => Ok(()),
        false => Err(Error::Setting { name, value, rule }),
    }
}
