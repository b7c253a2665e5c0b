//! The largest entries of a matrix, kept beside its blocks.

#[cfg(feature = "texture-blocks")]
pub(super) mod find;

use alloc::vec::Vec;

use glam::UVec2;

/// The side table: rows in compressed sparse form, an entry a column and three halves.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Outliers {
    /// `start[rows + 1]`: row i has the entries `start[i]..start[i + 1]`.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub start: Vec<u32>,
    /// `[column | red << 16, green | blue << 16]`.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub entries: Vec<UVec2>,
}

impl Outliers {
    /// Bytes of the table.
    pub fn bytes(&self) -> u64 {
        size_of_val(&*self.start) as u64 + size_of_val(&*self.entries) as u64
    }
}
