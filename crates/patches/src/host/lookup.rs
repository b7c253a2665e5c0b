//! The tables of the lookup.

use alloc::vec::Vec;

use glam::{UVec3, Vec3, Vec4};
use scene::SurfacePoint;
use scene::parallel::*;

use super::grid::Grid;
use super::patch_set::PatchSet;
use crate::error::Error;
use crate::kernel::lookup::lookup;
use crate::types::{EMPTY_CELL, GridShape, LookupParams, LookupPatch, RULE_PLANES, RULE_WALLS, VirtualPatch};

/// Settings of the interpolation between patches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LookupSettings {
    /// Distance from the point's plane from which on patches do not count, in voxel edges along the normal.
    pub plane_limit: f32,
    /// True if patches behind a wall do not count.
    pub walls: bool,
}

impl LookupSettings {
    /// Rule and limit for the kernel, which divides by the limit and squares it.
    fn rule(self) -> Result<(u32, f32), Error> {
        let limit = self.plane_limit;
        if limit.is_nan() || limit <= 0.0 {
            return Err(Error::Setting { name: "plane limit", value: f64::from(limit), rule: "positive" });
        }
        Ok((if self.walls { RULE_WALLS } else { RULE_PLANES }, limit.min(1e15)))
    }
}

impl Default for LookupSettings {
    fn default() -> Self {
        Self { plane_limit: 0.5, walls: true }
    }
}

/// Tables of [`lookup`]: the patches of each voxel, and for each empty voxel the nearest one that has patches.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Lookup {
    /// Grid and settings.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::value"))]
    pub params: LookupParams,
    /// One word a voxel: the place of its patches, or [`EMPTY_CELL`] with the place of the nearest ones.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub cells: Vec<u32>,
    /// First entry of each voxel with patches, and the end.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub offsets: Vec<u32>,
    /// Patches, voxel by voxel.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub entries: Vec<LookupPatch>,
    /// Length of the table of values: one a patch, and with dark patches a last one that is 0.
    pub values: usize,
}

/// A dark patch has no say where a patch of the set looks its way, with a cosine above this, in the same plane and
/// beside it.
const LIKE_COSINE: f32 = 0.5;

impl Lookup {
    /// The tables for patches of this grid's voxels, in any order.
    ///
    /// # Errors
    /// [`Error::Setting`] for a limit that is not positive, [`Error::Value`] for a patch without a voxel of the grid,
    /// [`Error::NoSamples`] without patches.
    pub fn new(grid: &Grid, set: &PatchSet, settings: LookupSettings) -> Result<Self, Error> {
        Self::with_dark(&grid.shape, (set.len(), |k| set.patches[k]), (0, |_| VirtualPatch::default()), settings)
    }

    /// As [`Lookup::new`], for a number of patches and what tells one of them, so that they need no table; and with
    /// patches of the places that no light comes to, so that such a place is dark and does not show what lies behind
    /// its wall. A dark patch is left out where the voxels beside its own hold one of the others in its plane that
    /// looks its way: no place that light comes to becomes darker. The value of all dark patches is the last of the
    /// table of values, which then has one more than there are patches and must end with 0.
    ///
    /// # Errors
    /// As [`Lookup::new`].
    pub fn with_dark(
        shape: &GridShape,
        (count, patch): (usize, impl Fn(usize) -> VirtualPatch + Sync),
        (dark_count, dark): (usize, impl Fn(usize) -> VirtualPatch + Sync),
        settings: LookupSettings,
    ) -> Result<Self, Error> {
        let (rule, limit) = settings.rule()?;
        if count == 0 {
            return Err(Error::NoSamples);
        }
        let counts = shape.counts();
        let voxels = counts.x as usize * counts.y as usize * counts.z as usize;
        let dark_voxels = (0..dark_count).map(|d| dark(d).voxel);
        for (index, voxel) in (0..count).map(|k| patch(k).voxel).chain(dark_voxels).enumerate() {
            if voxel as usize >= voxels {
                let value = f64::from(voxel);
                return Err(Error::Value { name: "patches.voxel", index, value, rule: "in the grid" });
            }
        }
        // Voxel by voxel, dark ones behind the others.
        let mut order: Vec<(u32, u32)> = (0..count).map(|k| (patch(k).voxel, k as u32)).collect();
        order.sort_unstable();
        let is_separate = |&d: &u32| !has_like(shape, &order, &patch, &dark(d as usize), limit);
        let separate: Vec<u32> = (0..dark_count as u32).into_par_iter().filter(is_separate).collect();
        let values = count + usize::from(!separate.is_empty());
        order.extend(separate.iter().map(|&d| (dark(d as usize).voxel, count as u32 + d)));
        order.sort_unstable();
        let mut cells = alloc::vec![u32::MAX; voxels];
        let mut offsets = Vec::new();
        let mut entries = Vec::with_capacity(order.len());
        let mut full = Vec::new();
        for &(voxel, k) in &order {
            let cell = &mut cells[voxel as usize];
            if *cell == u32::MAX {
                *cell = full.len() as u32;
                full.push(voxel);
                offsets.push(entries.len() as u32);
            }
            let of = (k as usize).checked_sub(count).map_or_else(|| patch(k as usize), &dark);
            let position = of.position;
            let direction = of.normal;
            entries.push(LookupPatch { position, patch: k.min(count as u32), direction, reserved: 0 });
        }
        offsets.push(entries.len() as u32);
        fill_empty(&mut cells, full, counts);
        let params = LookupParams { shape: *shape, plane_limit: limit, rule, count: 0, first_cell: 0 };
        Ok(Self { params, cells, offsets, entries, values })
    }

    /// The mean at a surface point with a unit normal of the values of the patches round it, [`Lookup::values`] of
    /// them.
    ///
    /// # Errors
    /// [`Error::Length`] for a wrong number of values.
    pub fn at(&self, values: &[Vec4], position: Vec3, normal: Vec3) -> Result<Vec4, Error> {
        self.check(values)?;
        Ok(self.value(values, position, normal))
    }

    /// [`Lookup::at`] for many points, on all cores.
    ///
    /// # Errors
    /// [`Error::Length`] for a wrong number of values.
    pub fn at_points(&self, values: &[Vec4], points: &[SurfacePoint]) -> Result<Vec<Vec4>, Error> {
        self.check(values)?;
        Ok(points.par_iter().map(|p| self.value(values, p.position, p.normal)).collect())
    }

    fn check(&self, values: &[Vec4]) -> Result<(), Error> {
        if values.len() != self.values {
            return Err(Error::Length { name: "values", expected: self.values, found: values.len() });
        }
        Ok(())
    }

    fn value(&self, values: &[Vec4], position: Vec3, normal: Vec3) -> Vec4 {
        lookup(&self.params, &self.cells, &self.offsets, &self.entries, values, position, normal)
    }

    /// Bytes of all tables.
    pub fn bytes(&self) -> usize {
        4 * (self.cells.len() + self.offsets.len()) + size_of_val(&self.entries[..])
    }
}

/// Returns true if the voxels round that of a dark patch hold one of the others in its plane that looks its way.
/// `order` has their voxels and numbers, and rises.
fn has_like(
    shape: &GridShape,
    order: &[(u32, u32)],
    patch: &impl Fn(usize) -> VirtualPatch,
    dark: &VirtualPatch,
    limit: f32,
) -> bool {
    let own = shape.coordinates(dark.voxel);
    let low = own.saturating_sub(UVec3::ONE);
    let high = (own + UVec3::ONE).min(shape.counts() - UVec3::ONE);
    let is_like = |other: VirtualPatch| {
        let off = ((other.position - dark.position) / shape.edges).dot(dark.normal).abs();
        other.normal.dot(dark.normal) > LIKE_COSINE && off < limit
    };
    (low.z..=high.z).any(|z| {
        (low.y..=high.y).any(|y| {
            let from = shape.voxel_at(UVec3::new(low.x, y, z));
            let to = shape.voxel_at(UVec3::new(high.x, y, z));
            let first = order.partition_point(|o| o.0 < from);
            order[first..].iter().take_while(|o| o.0 <= to).any(|o| is_like(patch(o.1 as usize)))
        })
    })
}

/// Gives each empty voxel the nearest one with patches, counted in steps along the axes; of several the first.
pub(super) fn fill_empty(cells: &mut [u32], full: Vec<u32>, counts: UVec3) {
    let row = counts.x;
    let layer = counts.x * counts.y;
    let mut front = full;
    while !front.is_empty() {
        let mut next = Vec::new();
        for &voxel in &front {
            let source = cells[voxel as usize] | EMPTY_CELL;
            let x = voxel % row;
            let y = voxel / row % counts.y;
            let z = voxel / layer;
            let mut reach = |inside: bool, neighbour: u32| {
                if inside && cells[neighbour as usize] == u32::MAX {
                    cells[neighbour as usize] = source;
                    next.push(neighbour);
                }
            };
            reach(x > 0, voxel.wrapping_sub(1));
            reach(x + 1 < counts.x, voxel + 1);
            reach(y > 0, voxel.wrapping_sub(row));
            reach(y + 1 < counts.y, voxel + row);
            reach(z > 0, voxel.wrapping_sub(layer));
            reach(z + 1 < counts.z, voxel + layer);
        }
        front = next;
    }
}
