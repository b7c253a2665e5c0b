//! What the host forms of the kernels of virtual patches check of their tables.

use ::patches::{EMPTY_CELL, GridShape};

use super::HostError;

/// Voxels of a grid; a count that does not fit is more than any table has.
pub(crate) fn voxels(shape: &GridShape) -> Result<usize, HostError> {
    let counts = [shape.count_x, shape.count_y, shape.count_z].map(|n| n as usize);
    let found = counts.into_iter().fold(1, usize::saturating_mul);
    if found == 0 { Err(HostError::TooShort { binding: "voxels of the grid", needed: 1, found }) } else { Ok(found) }
}

/// The greatest number in a table of cells, and one more.
pub(crate) fn cells_named(cells: &[u32]) -> usize {
    cells.iter().map(|cell| (cell & !EMPTY_CELL) as usize + 1).max().unwrap_or(0)
}

/// Length of a table that has so many values for each probe that is named.
pub(crate) fn of_probes(probes: &[u32], values: u32) -> usize {
    cells_named(probes) * values as usize
}
