//! Which patches send light to which rows.

use alloc::boxed::Box;

use glam::Vec3;
use scene::{Hit, SurfacePoint, Visibility};

use super::polygon::Polygon;
use crate::types::Patch;

/// Finds the patch that owns a hit of a ray in a direction, or [`scene::NONE`].
pub type Owner<'a> = Box<dyn Fn(&Hit, Vec3) -> u32 + Sync + 'a>;

/// Which patches send light to which rows. Columns are patches; rows are the same patches or any points.
pub struct Surfaces<'a> {
    /// The patches that send.
    pub patches: &'a [Patch],
    /// Outlines of the patches that send; estimators by rays do without, and they may be missing.
    pub polygons: &'a [Polygon],
    /// Outlines of the receivers; empty when rows are points only. Estimators that know outlines
    /// average over them.
    pub row_polygons: &'a [Polygon],
    /// Points of the receivers.
    pub points: &'a [SurfacePoint],
    /// Row i owns `points[offsets[i]..offsets[i + 1]]`; `[rows + 1]`.
    pub offsets: &'a [u32],
    /// Who sees whom.
    pub visibility: &'a dyn Visibility,
    /// The patch that owns a hit of a ray in a direction, or [`scene::NONE`].
    pub owner: Owner<'a>,
    /// Distance by which rays start above a surface, m.
    pub ray_offset: f32,
    /// Changes every random number.
    pub seed: u32,
}

impl Surfaces<'_> {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Points of a row.
    pub fn row_points(&self, row: usize) -> &[SurfacePoint] {
        &self.points[self.offsets[row] as usize..self.offsets[row + 1] as usize]
    }
}
