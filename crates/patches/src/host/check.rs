//! True if tables that come from a file fit together, so that nobody reads beside them.

use alloc::vec::Vec;

use scene::NONE;
use transport::{LinearOperator as _, QUADRANTS, TriangleGrid, check_indices, check_length, check_offsets};

use super::lookup::Lookup;
use super::mesh::PatchMesh;
use super::placement::MeshReceivers;
use crate::error::Error;
use crate::types::{EMPTY_CELL, GridShape};

impl PatchMesh {
    /// Checks the tables of a mesh over so many triangles.
    ///
    /// # Errors
    /// [`Error::Shared`] naming the first table that does not fit.
    pub fn check(&self, triangles: usize) -> Result<(), Error> {
        let patches = self.patches.len();
        let elements = self.elements.len();
        check_length("albedo", patches, self.albedo.len())?;
        check_offsets("patch_elements", patches, elements, &self.patch_elements)?;
        check_length("element_albedo", elements, self.element_albedo.len())?;
        check_offsets("offsets", elements, self.points.len(), &self.offsets)?;
        check_length("point_albedo", self.points.len(), self.point_albedo.len())?;
        if !self.polygons.is_empty() {
            check_length("polygons", patches, self.polygons.len())?;
        }
        if let Some(lookup) = &self.lookup {
            lookup.check_tables(patches)?;
        }
        let cells = if self.cells.is_empty() { elements } else { self.cells.len() };
        check_grids(&self.grids, triangles, cells)?;
        check_indices("cells", elements, true, &self.cells)?;
        Ok(())
    }
}

impl Lookup {
    /// Checks the tables of a lookup between so many patches.
    ///
    /// # Errors
    /// [`Error::Shared`] naming the first table that does not fit.
    fn check_tables(&self, patches: usize) -> Result<(), Error> {
        let GridShape { count_x, count_y, count_z, .. } = self.params.shape;
        let voxels = [count_x, count_y, count_z].map(|count| count as usize);
        check_length("cells", voxels[0].saturating_mul(voxels[1]).saturating_mul(voxels[2]), self.cells.len())?;
        let occupied = self.offsets.len().saturating_sub(1);
        check_offsets("offsets", occupied, self.entries.len(), &self.offsets)?;
        let places: Vec<u32> = self.cells.iter().map(|cell| cell & !EMPTY_CELL).collect();
        check_indices("cells", occupied, false, &places)?;
        check_length("values", self.values.clamp(patches, patches + 1), self.values)?;
        let named: Vec<u32> = self.entries.iter().map(|entry| entry.patch).collect();
        check_indices("entries", self.values, false, &named)?;
        Ok(())
    }
}

impl MeshReceivers {
    /// Checks the tables of receivers on so many triangles, over so many elements.
    ///
    /// # Errors
    /// [`Error::Shared`] naming the first table that does not fit.
    pub fn check(&self, triangles: usize, elements: usize) -> Result<(), Error> {
        let receivers = self.points.len();
        let quadrants = QUADRANTS * receivers;
        for (rows, columns) in
            [(&self.rows, if receivers == 0 { 0 } else { elements }), (&self.sky_rows, scene::SKY_BINS)]
        {
            rows.check()?;
            check_length("rows of receivers", quadrants, rows.rows())?;
            check_length("columns of receivers", columns, rows.columns())?;
        }
        self.smoothing.check(receivers, receivers)?;
        let mesh = &self.interpolation;
        self.weights.check(mesh.points.len(), receivers)?;
        check_grids(&mesh.grids, triangles, mesh.cells.len())?;
        for cell in mesh.cells.iter().filter(|cell| cell.first != NONE) {
            let n = u64::from(cell.divisions);
            let end = u64::from(cell.first) + (n + 1) * (n + 2) / 2;
            check_length("vertices", mesh.vertices.len().max(end as usize), mesh.vertices.len())?;
        }
        check_indices("vertices", mesh.points.len(), true, &mesh.vertices)?;
        Ok(())
    }
}

/// A grid a triangle, whose cells are among so many.
fn check_grids(grids: &[TriangleGrid], triangles: usize, cells: usize) -> Result<(), Error> {
    check_length("grids", triangles, grids.len())?;
    for grid in grids {
        for first in [grid.front, grid.back].into_iter().filter(|&first| first != NONE) {
            let end = u64::from(first) + u64::from(grid.divisions).pow(2);
            check_length("cells", cells.max(end as usize), cells)?;
        }
    }
    Ok(())
}
