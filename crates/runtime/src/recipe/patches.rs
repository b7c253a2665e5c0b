//! Recipes of `patches`: values of patches, and of probe volumes, at any points; weighted means of receivers.

use std::sync::Arc;

use gpu_kernels::patches::{LookupPass, MarkReceiversPass, TurnPass, WeighPass, WeighViewPass};
use patches::{DifferenceParams, Lookup, LookupParams, LookupPatch, PackedWeights, WeightParams};
use scene::gpu::Triangle;
use scene::{Hit, Lobe, Rgb, SurfacePoint};
use transport::{ReceiverCell, TriangleGrid};

use super::Tables;
use super::formfactor::ViewRows;
use crate::executor::{Executor, ExecutorError};
use crate::plan::{PassId, Plan, Slice};

/// A lookup between patches on the device.
#[derive(Clone, Copy, Debug)]
pub struct LookupTables {
    cells: Slice<u32>,
    offsets: Slice<u32>,
    entries: Slice<LookupPatch>,
    params: LookupParams,
}

impl LookupTables {
    /// Puts the lookup on the device.
    pub fn new(plan: &mut Plan, tables: &mut Tables, lookup: &Arc<Lookup>) -> Self {
        Self {
            cells: tables.part(plan, "cells", lookup, |l| &l.cells),
            offsets: tables.part(plan, "offsets", lookup, |l| &l.offsets),
            entries: tables.part(plan, "entries", lookup, |l| &l.entries),
            params: lookup.params,
        }
    }

    /// Adds the pass of the mean of the patches about each of `count` points.
    ///
    /// # Errors
    /// Buffers that are empty or too short.
    pub fn at_points(
        &self,
        plan: &mut Plan,
        pass: &str,
        values: Slice<Rgb>,
        points: Slice<SurfacePoint>,
        irradiance: Slice<Rgb>,
        count: u32,
    ) -> Result<PassId, ExecutorError> {
        let Self { cells, offsets, entries, params } = *self;
        let bound = LookupPass { cells, offsets, entries, values, points, irradiance };
        Ok(plan.add(pass, &bound, &LookupParams { count, ..params })?)
    }
}

/// Packed weights of receivers on the device.
#[derive(Clone, Copy, Debug)]
pub struct WeightTables {
    row_start: Slice<u32>,
    list_start: Slice<u32>,
    lists: Slice<u32>,
    entries: Slice<u32>,
    params: WeightParams,
}

/// Bindings of [`WeightTables::turn`].
#[derive(Clone, Copy, Debug)]
pub struct DirectedLight {
    /// Primary hits.
    pub hits: Slice<Hit>,
    /// The hits as points to be lit, with the normals of maps.
    pub points: Slice<SurfacePoint>,
    /// Their lobes.
    pub lobes: Slice<Lobe>,
    /// Triangles of the scene.
    pub triangles: Slice<Triangle>,
    /// Cells of each triangle.
    pub grids: Slice<TriangleGrid>,
    /// Cells.
    pub receiver_cells: Slice<ReceiverCell>,
    /// Interpolation points of the cells.
    pub vertices: Slice<u32>,
    /// The receivers.
    pub receivers: Slice<SurfacePoint>,
    /// Irradiance of their quadrants, W/m².
    pub received: Slice<Rgb>,
    /// Irradiance of the pixels, W/m².
    pub irradiance: Slice<Rgb>,
}

/// A pass over the rows that a view needs.
#[derive(Clone, Copy, Debug)]
pub struct WeightPass {
    /// The pass.
    pub pass: PassId,
    params: WeightParams,
}

impl WeightTables {
    /// Puts the weights on the device; `name` is for messages and the printed graph. Of the numbers that the passes
    /// bind as `received` the first are the irradiance of the four quadrants of each receiver, and from `first_value`
    /// on stand the values of the receivers, each the sum of `parts` numbers.
    pub fn new(
        plan: &mut Plan,
        tables: &mut Tables,
        name: &str,
        weights: &Arc<PackedWeights>,
        (first_value, parts): (usize, usize),
    ) -> Self {
        Self {
            row_start: tables.part(plan, &format!("{name} starts"), weights, |weights| weights.row_start()),
            list_start: tables.part(plan, &format!("{name} list starts"), weights, |weights| weights.list_start()),
            lists: tables.part(plan, &format!("{name} lists"), weights, |weights| weights.lists()),
            entries: tables.part(plan, &format!("{name} entries"), weights, |weights| weights.entries()),
            params: WeightParams {
                count: weights.rows() as u32,
                block_rows: weights.block_rows(),
                first_value: first_value as u32,
                parts: parts as u32,
                ..WeightParams::default()
            },
        }
    }

    /// Adds the pass of the weighted means of what was received.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn weigh(
        &self,
        plan: &mut Plan,
        pass: &str,
        received: Slice<Rgb>,
        irradiance: Slice<Rgb>,
    ) -> Result<PassId, ExecutorError> {
        let Self { row_start, list_start, lists, entries, params } = *self;
        Ok(plan.add(pass, &WeighPass { row_start, list_start, lists, entries, received, irradiance }, &params)?)
    }

    /// Adds the pass that turns the irradiance of pixels to the normals of maps.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn turn(
        &self,
        plan: &mut Plan,
        pass: &str,
        pixels: &DirectedLight,
        count: u32,
    ) -> Result<PassId, ExecutorError> {
        let Self { row_start, list_start, lists, entries, params } = *self;
        let DirectedLight { hits, points, lobes, triangles, grids, receiver_cells, vertices, .. } = *pixels;
        let DirectedLight { receivers, received, irradiance, .. } = *pixels;
        let bound = TurnPass {
            hits,
            points,
            lobes,
            triangles,
            grids,
            receiver_cells,
            vertices,
            row_start,
            list_start,
            lists,
            entries,
            receivers,
            received,
            irradiance,
        };
        let push = DifferenceParams { count, rows: params.count, block_rows: params.block_rows, reserved: 0 };
        Ok(plan.add(pass, &bound, &push)?)
    }

    /// Adds the pass of those that a view needs.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn weigh_view(
        &self,
        plan: &mut Plan,
        pass: &str,
        received: Slice<Rgb>,
        irradiance: Slice<Rgb>,
        ViewRows { marks, computed }: ViewRows,
    ) -> Result<WeightPass, ExecutorError> {
        let Self { row_start, list_start, lists, entries, params } = *self;
        let bound = WeighViewPass { row_start, list_start, lists, entries, received, marks, computed, irradiance };
        Ok(WeightPass { pass: plan.add(pass, &bound, &params)?, params })
    }

    /// Adds the pass that marks what the rows that a view needs take from.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn mark(
        &self,
        plan: &mut Plan,
        pass: &str,
        row_marks: Slice<u32>,
        marks: Slice<u32>,
    ) -> Result<WeightPass, ExecutorError> {
        let Self { row_start, list_start, lists, entries, params } = *self;
        let bound = MarkReceiversPass { row_start, list_start, lists, entries, row_marks, marks };
        Ok(WeightPass { pass: plan.add(pass, &bound, &params)?, params })
    }
}

impl WeightPass {
    /// Makes the pass ready for a view and a light.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(&self, executor: &mut (dyn Executor + 'static), view: u32, light: u32) -> Result<(), ExecutorError> {
        executor.push(self.pass, &WeightParams { view, light, ..self.params })
    }
}
