//! Errors of grids, samples, patches and receivers.

use alloc::boxed::Box;

/// Why virtual patches could not be made or used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Triangles of an atlas lie on each other.
    #[error("triangles {} and {} have the same place in the atlas: their light cannot be told apart; give each a \
         place of its own", triangles[0], triangles[1])]
    AtlasOverlap {
        /// Their numbers.
        triangles: [u32; 2],
    },
    /// A table, a setting or a number that cannot be.
    #[error(transparent)]
    Shared(#[from] transport::Error),
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
    /// A value of a table is not one that can stand there.
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
    /// More voxels, clipped triangles, samples or patches than can be numbered.
    #[error("{found} {name}; at most {limit} are possible")]
    TooMany {
        /// Name of the counted things.
        name: &'static str,
        /// Number found.
        found: u64,
        /// Greatest number allowed.
        limit: u64,
    },
    /// Triangles so long beside patches, or the distance between receivers, that their grids have too many cells.
    #[error(
        "triangle {triangle} has an edge of {length} m, and its grid with those of others has {cells} cells where at \
         most {limit} are possible; cut long thin triangles, or choose fewer patches or a larger distance between \
         receivers"
    )]
    LongTriangle {
        /// The triangle with the most cells, by its number in the file ([`scene::gpu::Triangle::source`]).
        triangle: u32,
        /// Its longest edge, m.
        length: f32,
        /// Cells of all triangles.
        cells: u64,
        /// Cells there may be.
        limit: u64,
    },
    /// No probe stands in the open.
    #[error("no probe stands where light comes to: the volume would be empty")]
    NoProbes,
    /// No ray met a surface.
    #[error("no ray met a surface: there are no samples to make patches of")]
    NoSamples,
    /// An edge of voxels was given for patches that have none.
    #[error("{patches} patches have no voxels whose size could be set; give their number instead")]
    VoxelSizeWithoutVoxels {
        /// The kind of patches.
        patches: &'static str,
    },
    /// The caller's estimator of the receivers' rows, or what walks for it, failed or was cancelled.
    #[error(transparent)]
    Rows(Box<dyn core::error::Error + Send + Sync>),
}
