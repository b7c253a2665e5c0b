//! Recipes of `formfactor`: first exitance from samples, products with sparse rows and with counts of hits, bounces,
//! and irradiance between interpolation points.

use std::ops;
use std::sync::Arc;

use formfactor::HemisphereParams;
use glam::UVec2;
use gpu_kernels::formfactor::{HemisphereHitsPass, HemisphereSurfacesPass};
use gpu_kernels::params::CountParams;
use gpu_kernels::transport::{BouncePass, GatherCsrPass, GatherHitsPass, GatherHitsViewPass};
use scene::{Hit, Rgb, Scene, SurfacePoint};
use transport::kernel::hits::WORD_COUNTS;
use transport::{Csr, HitCounts, HitsParams, Surfaces as RowSurfaces, TriangleGrid, ViewParams};

use super::scene::SceneTables;
use super::{Tables, row_blocks};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{PassId, Plan, Slice};

/// Compressed sparse rows on the device.
#[derive(Clone, Copy, Debug)]
pub struct SparseTables {
    row_start: Slice<u32>,
    columns: Slice<u32>,
    values: Slice<f32>,
    rows: u32,
}

impl SparseTables {
    /// Puts the rows on the device; `name` is for messages and the printed graph.
    pub fn new(plan: &mut Plan, tables: &mut Tables, name: &str, rows: &Arc<Csr>) -> Self {
        Self {
            row_start: tables.part(plan, &format!("{name} starts"), rows, |rows| &rows.row_start),
            columns: tables.part(plan, &format!("{name} columns"), rows, |rows| &rows.column_index),
            values: tables.part(plan, &format!("{name} values"), rows, |rows| &rows.values),
            rows: rows.row_start.len().saturating_sub(1) as u32,
        }
    }

    /// Adds the pass of `irradiance = F exitance`.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn gather(
        &self,
        plan: &mut Plan,
        pass: &str,
        exitance: Slice<Rgb>,
        irradiance: Slice<Rgb>,
    ) -> Result<PassId, ExecutorError> {
        let Self { row_start, columns, values, rows } = *self;
        let bound = GatherCsrPass { row_start, columns, values, exitance, irradiance };
        Ok(plan.add(pass, &bound, &CountParams { count: rows })?)
    }
}

/// A pass that computes only what a view needs, and its push constants, of which the numbers of the view and the light
/// change.
#[derive(Clone, Copy, Debug)]
pub struct ViewPass {
    /// The pass.
    pub pass: PassId,
    /// Push constants.
    pub params: ViewParams,
}

impl ViewPass {
    /// Makes the pass ready for a view and a light.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(&self, executor: &mut (dyn Executor + 'static), view: u32, light: u32) -> Result<(), ExecutorError> {
        executor.push(self.pass, &ViewParams { view, light, ..self.params })
    }
}

/// Which rows a view needs, and for which light each was computed: a number of 32 bits a row.
#[derive(Clone, Copy, Debug)]
pub struct ViewRows {
    /// Marks ([`transport::kernel::view`]).
    pub marks: Slice<u32>,
    /// Number of the light.
    pub computed: Slice<u32>,
}

/// Buffers of a bounce, each with one RGB value a patch (or element): albedo ρ, first exitance E and irradiance H in,
/// exitance B out; E, H and B in W/m².
#[derive(Clone, Copy, Debug)]
pub struct Surfaces {
    /// Number of patches or elements.
    pub count: u32,
    /// Albedo ρ, without unit.
    pub albedo: Slice<Rgb>,
    /// First exitance E.
    pub source: Slice<Rgb>,
    /// Irradiance H.
    pub irradiance: Slice<Rgb>,
    /// Exitance B.
    pub exitance: Slice<Rgb>,
}

impl Surfaces {
    /// Adds the pass of `B = E + ρ∘H`.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn bounce(&self, plan: &mut Plan, pass: &str) -> Result<PassId, ExecutorError> {
        self.bounce_of(plan, pass, self.irradiance)
    }

    /// Adds the pass of `B = E + ρ∘H` with the irradiance of another buffer.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn bounce_of(&self, plan: &mut Plan, pass: &str, irradiance: Slice<Rgb>) -> Result<PassId, ExecutorError> {
        let Self { count, albedo, source, exitance, .. } = *self;
        Ok(plan.add(pass, &BouncePass { source, albedo, irradiance, exitance }, &CountParams { count })?)
    }
}

/// Rays that are traced together, of as many rows as have them, or of one row.
const RAYS_PER_BATCH: u32 = 1 << 20;

/// Traces the hemisphere rays of rows on a device: its plan holds the scene and the points of the rows.
pub struct RowTracer<'a> {
    executor: &'a mut (dyn Executor + 'static),
    pass: PassId,
    ids: Slice<u32>,
    params: HemisphereParams,
    /// Rows of a dispatch.
    rows: u32,
}

impl<'a> RowTracer<'a> {
    /// Loads the scene and the rows of `surfaces`, each with `rays` rays. Of each triangle `grids` numbers the cells,
    /// of each cell `cell_columns` names the column that owns it.
    ///
    /// # Errors
    /// What the device says: a scene too large for it, say.
    pub fn new(
        executor: &'a mut (dyn Executor + 'static),
        scene: &Scene,
        (grids, cell_columns): (&[TriangleGrid], Vec<u32>),
        surfaces: &RowSurfaces,
        rays: u32,
    ) -> Result<Self, ExecutorError> {
        let mut plan = Plan::new();
        let mut tables = Tables::new();
        let scene_tables = SceneTables::new(&mut plan, &mut tables, scene, scene.lighting.lights.len().max(1));
        let rows = (RAYS_PER_BATCH / rays.max(1)).clamp(1, surfaces.rows().max(1) as u32);
        let ids = plan.array("ids", rows as usize * rays as usize);
        let bound = HemisphereHitsPass {
            offsets: tables.owned(&mut plan, "offsets", surfaces.offsets.to_vec()),
            points: tables.owned(&mut plan, "points", surfaces.points.to_vec()),
            grids: tables.owned(&mut plan, "grids", grids.to_vec()),
            cell_columns: tables.owned(&mut plan, "cell_columns", cell_columns),
            geometry: scene_tables.geometry,
            ids,
        };
        let params = HemisphereParams {
            first_row: 0,
            row_count: rows,
            rays,
            patch_count: surfaces.patches.len() as u32,
            seed: surfaces.seed,
            ray_offset: surfaces.ray_offset,
            reserved: [0; 2],
        };
        let pass = plan.add("rows", &bound, &params)?;
        executor.load(plan)?;
        tables.upload(executor)?;
        scene_tables.set_sky_and_emission(executor, scene)?;
        Ok(Self { executor, pass, ids, params, rows })
    }

    /// Columns of what the rays of some rows meet, row by row: a patch, the number of patches for the sky, one more for
    /// what no patch owns. Waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn columns(&mut self, rows: ops::Range<usize>) -> Result<Vec<u32>, ExecutorError> {
        let mut columns = Vec::with_capacity(rows.len() * self.params.rays as usize);
        for first in rows.clone().step_by(self.rows as usize) {
            let row_count = self.rows.min((rows.end - first) as u32);
            let params = HemisphereParams { first_row: first as u32, row_count, ..self.params };
            let rays = row_count * params.rays;
            self.executor.push(self.pass, &params)?;
            self.executor.submit_passes(&[self.pass])?;
            let found: Vec<u32> = self.executor.download_table(self.ids)?;
            columns.extend_from_slice(&found[..rays as usize]);
        }
        Ok(columns)
    }
}

/// Traces the hemisphere rays of rows on a device: its plan holds the scene, rows come and go.
pub struct SurfaceTracer<'a> {
    executor: &'a mut (dyn Executor + 'static),
    pass: PassId,
    offsets: Slice<u32>,
    points: Slice<SurfacePoint>,
    hits: Slice<Hit>,
    rays: u32,
}

impl<'a> SurfaceTracer<'a> {
    /// Loads the scene, with room for so many rows of `rays` rays and so many points of theirs.
    ///
    /// # Errors
    /// What the device says: a scene too large for it, say.
    pub fn new(
        executor: &'a mut (dyn Executor + 'static),
        scene: &Scene,
        (rows, points): (usize, usize),
        rays: u32,
    ) -> Result<Self, ExecutorError> {
        let mut plan = Plan::new();
        let mut tables = Tables::new();
        let scene_tables = SceneTables::new(&mut plan, &mut tables, scene, scene.lighting.lights.len().max(1));
        let offsets = plan.array("offsets", rows + 1);
        let points = plan.array("points", points);
        let hits = plan.array("hits", rows * rays as usize);
        let bound = HemisphereSurfacesPass { offsets, points, geometry: scene_tables.geometry, hits };
        let params = HemisphereParams { row_count: rows as u32, rays, ..HemisphereParams::default() };
        let pass = plan.add("rows", &bound, &params)?;
        executor.load(plan)?;
        tables.upload(executor)?;
        scene_tables.set_sky_and_emission(executor, scene)?;
        Ok(Self { executor, pass, offsets, points, hits, rays })
    }

    /// Hits of the rays of all rows of `surfaces`, row by row. Waits.
    ///
    /// # Errors
    /// More rows or points than there is room for; what the device says.
    pub fn hits(&mut self, surfaces: &RowSurfaces) -> Result<Vec<Hit>, ExecutorError> {
        let params = HemisphereParams {
            first_row: 0,
            row_count: surfaces.rows() as u32,
            rays: self.rays,
            patch_count: surfaces.patches.len() as u32,
            seed: surfaces.seed,
            ray_offset: surfaces.ray_offset,
            reserved: [0; 2],
        };
        let count = params.row_count * params.rays;
        self.executor.upload(self.offsets, surfaces.offsets)?;
        self.executor.upload(self.points, surfaces.points)?;
        self.executor.push(self.pass, &params)?;
        self.executor.submit_passes(&[self.pass])?;
        let mut found: Vec<Hit> = self.executor.download_table(self.hits)?;
        found.truncate(count as usize);
        Ok(found)
    }
}

/// Rows of counts of hits on the device.
#[derive(Clone, Debug)]
pub struct HitTables {
    starts: Vec<u32>,
    row_start: Slice<u32>,
    quads: Slice<UVec2>,
    counts: Slice<u32>,
    scales: Slice<f32>,
}

/// Blocks of rows begin at multiples of this, and their quads too: ranges of a buffer begin at multiples of 256 bytes.
const BLOCK_STEP: usize = 256;

/// Some of the rows, and what a pass over them binds.
#[derive(Debug)]
struct RowBlock {
    rows: ops::Range<usize>,
    row_start: Slice<u32>,
    quads: Slice<UVec2>,
    counts: Slice<u32>,
    scales: Slice<f32>,
    first_quad: u32,
}

impl RowBlock {
    /// The rows of a table that has one element for each.
    fn of<T>(&self, table: Slice<T>) -> Slice<T> {
        table.part(self.rows.start, self.rows.len())
    }
}

impl HitTables {
    /// Puts the rows on the device.
    pub fn new(plan: &mut Plan, tables: &mut Tables, hits: &Arc<HitCounts>) -> Self {
        // Rows of which no ray met anything have no quads, and a binding has at least one.
        let is_empty = hits.quads().is_empty();
        Self {
            starts: hits.row_start().to_vec(),
            row_start: tables.part(plan, "row starts", hits, |hits| hits.row_start()),
            quads: match is_empty {
                true => tables.owned(plan, "quads", vec![UVec2::ZERO]),
                false => tables.part(plan, "quads", hits, |hits| hits.quads()),
            },
            counts: tables.owned(plan, "counts", if is_empty { vec![0] } else { hits.count_words() }),
            scales: tables.part(plan, "scales", hits, |hits| hits.scales()),
        }
    }

    /// Puts rows on the device of which some change from frame to frame ([`Self::set_quads`]).
    pub fn changing(plan: &mut Plan, tables: &mut Tables, hits: &HitCounts) -> Self {
        // Not shared: the executor writes to them.
        let quads = hits.quads();
        let is_empty = quads.is_empty();
        Self {
            starts: hits.row_start().to_vec(),
            row_start: tables.owned(plan, "row starts", hits.row_start().to_vec()),
            quads: tables.owned(plan, "quads", if is_empty { vec![UVec2::ZERO] } else { quads.to_vec() }),
            counts: tables.owned(plan, "counts", if is_empty { vec![0] } else { hits.count_words() }),
            scales: tables.owned(plan, "scales", hits.scales().to_vec()),
        }
    }

    /// Number of a row's first quad; that of the row behind the last is the number of quads.
    pub fn first_quad(&self, row: usize) -> usize {
        self.starts[row] as usize
    }

    /// Replaces quads of [`Self::changing`], from one on.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_quads(
        &self,
        executor: &mut (dyn Executor + 'static),
        first: usize,
        quads: &[UVec2],
    ) -> Result<(), ExecutorError> {
        let offset = (first * size_of::<UVec2>()) as u64;
        executor.upload_at(self.quads.buffer, offset, bytemuck::cast_slice(quads))
    }

    /// Replaces the counts of a range of quads of [`Self::changing`] by those of all `counts`.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_counts(
        &self,
        executor: &mut (dyn Executor + 'static),
        quads: ops::Range<usize>,
        counts: &[u8],
    ) -> Result<(), ExecutorError> {
        // Whole words.
        let words = WORD_COUNTS as usize;
        let from = quads.start / words * words;
        let to = quads.end.next_multiple_of(words).min(counts.len());
        let mut bytes = counts[from..to].to_vec();
        bytes.resize(bytes.len().next_multiple_of(words), 0);
        executor.upload_at(self.counts.buffer, from as u64, &bytes)
    }

    /// Adds the passes of `irradiance = F exitance`, as many as it takes for no binding to show more than `range`
    /// bytes.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn gather(
        &self,
        plan: &mut Plan,
        pass: &str,
        range: u64,
        exitance: Slice<Rgb>,
        irradiance: Slice<Rgb>,
    ) -> Result<(), ExecutorError> {
        for block in self.blocks(range) {
            let push = HitsParams { rows: block.rows.len() as u32, first_quad: block.first_quad };
            let irradiance = block.of(irradiance);
            let RowBlock { row_start, quads, counts, scales, .. } = block;
            plan.add(pass, &GatherHitsPass { row_start, quads, counts, scales, exitance, irradiance }, &push)?;
        }
        Ok(())
    }

    /// Adds the passes of `irradiance = F exitance` for the rows that a view needs.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn gather_view(
        &self,
        plan: &mut Plan,
        pass: &str,
        range: u64,
        exitance: Slice<Rgb>,
        irradiance: Slice<Rgb>,
        needed: ViewRows,
    ) -> Result<Vec<ViewPass>, ExecutorError> {
        let mut passes = Vec::new();
        for block in self.blocks(range) {
            let params =
                ViewParams { count: block.rows.len() as u32, first_quad: block.first_quad, ..ViewParams::default() };
            let irradiance = block.of(irradiance);
            let marks = block.of(needed.marks);
            let computed = block.of(needed.computed);
            let RowBlock { row_start, quads, counts, scales, .. } = block;
            let bound = GatherHitsViewPass { row_start, quads, counts, scales, exitance, marks, computed, irradiance };
            passes.push(ViewPass { pass: plan.add(pass, &bound, &params)?, params });
        }
        Ok(passes)
    }

    /// Blocks of rows whose quads fit into one binding.
    fn blocks(&self, range: u64) -> Vec<RowBlock> {
        let starts = &self.starts;
        let most = (range / size_of::<UVec2>() as u64).saturating_sub(BLOCK_STEP as u64);
        let fits = |first: usize, end: usize| u64::from(starts[end] - starts[first]) <= most;
        row_blocks(self.starts.len() - 1, BLOCK_STEP, fits).into_iter().map(|rows| self.block(rows)).collect()
    }

    fn block(&self, rows: ops::Range<usize>) -> RowBlock {
        let starts = &self.starts;
        let last = (starts[starts.len() - 1] as usize).saturating_sub(1);
        let first_quad = last.min(starts[rows.start] as usize) / BLOCK_STEP * BLOCK_STEP;
        let quads = (starts[rows.end] as usize - first_quad).max(1);
        let words = quads.div_ceil(WORD_COUNTS as usize);
        RowBlock {
            row_start: self.row_start.part(rows.start, rows.len() + 1),
            quads: self.quads.part(first_quad, quads),
            counts: self.counts.part(first_quad / WORD_COUNTS as usize, words),
            scales: self.scales.part(rows.start, rows.len()),
            rows,
            first_quad: first_quad as u32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_hold_every_row_once_and_fit_into_a_binding() {
        // 3,000 rows of 40 hits in different columns: 10 quads of 8 bytes each.
        let mut hits = HitCounts::new(1000).unwrap();
        let columns: Vec<u32> = (0..3000 * 40).map(|k| k * 7 % 1000).collect();
        hits.push(&columns, &[0.025; 3000]).unwrap();
        let mut plan = Plan::new();
        let tables = HitTables::new(&mut plan, &mut Tables::new(), &Arc::new(hits));
        // 100,000 bytes are 12,500 quads: four steps of 256 rows, and not five.
        for (range, expected) in [(u64::MAX, 1), (100_000, 3), (1, 12)] {
            let blocks = tables.blocks(range);
            assert_eq!(blocks.len(), expected, "{range}");
            let mut next = 0;
            for block in blocks {
                assert_eq!(block.rows.start, next);
                next = block.rows.end;
                let starts = &tables.starts;
                let quads = starts[block.rows.end] - block.first_quad;
                assert!(starts[block.rows.start] >= block.first_quad && block.first_quad % 256 == 0);
                let bound = block.quads.range();
                let expected = (8 * u64::from(block.first_quad), Some(8 * u64::from(quads)));
                assert_eq!((bound.offset, bound.bytes), expected);
                assert!(range < 1000 || bound.bytes <= Some(range), "{range}: {bound:?}");
                assert_eq!(block.counts.range().bytes, Some(u64::from(quads.div_ceil(4) * 4)));
            }
            assert_eq!(next, 3000);
        }
    }
}
