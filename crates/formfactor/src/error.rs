//! What can be wrong with patches, form factors and their files.

/// Why a form-factor computation was refused.
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
        /// What is wrong.
        reason: &'static str,
    },
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
    /// More patches than indices.
    #[error("{found} patches or receivers; at most {limit} can be numbered")]
    TooMany {
        /// How many there would be.
        found: u64,
        /// How many there may be.
        limit: u64,
    },
    /// The progress callback asked to stop.
    #[error("cancelled after {done} of {total} rows")]
    Cancelled {
        /// Rows done.
        done: usize,
        /// Rows in all.
        total: usize,
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
        /// What the operating system says.
        reason: alloc::string::String,
    },
    /// A file of rows is not what it should be.
    #[error("{path}: {reason} (expected {expected}, found {found})")]
    FileContent {
        /// The file.
        path: alloc::string::String,
        /// What is wrong.
        reason: &'static str,
        /// What should stand there.
        expected: u64,
        /// What stands there.
        found: u64,
    },
}
