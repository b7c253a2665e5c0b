//! Recipes of `formfactor`: first exitance from samples, products with sparse rows and with counts of hits, bounces,
//! and irradiance between interpolation points.

use std::ops;
use std::sync::Arc;

use formfactor::HemisphereParams;
use gpu_kernels::params::CountParams;
use gpu_kernels::table;
use scene::{Hit, Scene, SurfacePoint};
use transport::kernel::hits::WORD_COUNTS;
use transport::{Csr, HitCounts, HitsParams, LinearOperator as _, Surfaces as RowSurfaces, TriangleGrid, ViewParams};

use super::scene::SceneTables;
use super::{Bindings, Named, Tables, add_pass, rgb_bytes, row_blocks};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{BufferId, PassId, Plan, Range};

/// Compressed sparse rows on the device.
#[derive(Clone, Copy, Debug)]
pub struct SparseTables {
    row_start: Range,
    columns: Range,
    values: Range,
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
        exitance: impl Into<Range>,
        irradiance: impl Into<Range>,
    ) -> Result<PassId, ExecutorError> {
        let own = [
            ("row_start", self.row_start),
            ("columns", self.columns),
            ("values", self.values),
            ("exitance", exitance.into()),
            ("irradiance", irradiance.into()),
        ];
        let count = CountParams { count: self.rows };
        add_pass(plan, pass, &table::FORMFACTOR_GATHER_CSR, &own, &[], &count, self.rows)
    }
}

/// A pass that computes only what a view needs, and its push constants, of which the numbers of the view and the light
/// change.
#[derive(Clone, Copy, Debug)]
pub struct ViewPass {
    /// The pass.
    pub pass: PassId,
    params: ViewParams,
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
    /// Marks ([`formfactor::kernel::view`]).
    pub marks: Range,
    /// Number of the light.
    pub computed: Range,
}

/// Adds the pass that marks the interpolation points that the pixels of a view take light from. Bindings: `hits`,
/// `points`, `triangles`, `grids`, `receiver_cells`, `vertices`, `marks`.
///
/// # Errors
/// Buffers that are missing or too short.
pub fn mark_pixels(plan: &mut Plan, pass: &str, bindings: Bindings, pixels: u32) -> Result<ViewPass, ExecutorError> {
    let params = ViewParams { count: pixels, ..ViewParams::default() };
    Ok(ViewPass { pass: add_pass(plan, pass, &table::FORMFACTOR_MARK_PIXELS, bindings, &[], &params, pixels)?, params })
}

/// Buffers of a bounce, each with one RGB value a patch (or element): albedo ρ, first exitance E and irradiance H in,
/// exitance B out; E, H and B in W/m².
#[derive(Clone, Copy, Debug)]
pub struct Surfaces {
    /// Number of patches or elements.
    pub count: u32,
    /// Albedo ρ, without unit.
    pub albedo: Range,
    /// First exitance E.
    pub source: Range,
    /// Irradiance H.
    pub irradiance: Range,
    /// Exitance B.
    pub exitance: Range,
}

impl Surfaces {
    /// The buffers by the names of the kernels' bindings.
    pub fn bindings(&self) -> [Named; 4] {
        [("albedo", self.albedo), ("source", self.source), ("irradiance", self.irradiance), ("exitance", self.exitance)]
    }

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
    pub fn bounce_of(
        &self,
        plan: &mut Plan,
        pass: &str,
        irradiance: impl Into<Range>,
    ) -> Result<PassId, ExecutorError> {
        let own = [("irradiance", irradiance.into())];
        let count = CountParams { count: self.count };
        add_pass(plan, pass, &table::FORMFACTOR_BOUNCE, &own, &self.bindings(), &count, self.count)
    }
}

/// Adds the pass that finds the first exitance of elements from the direct light at their samples:
/// `E = ρ Σ_k w_k H_d,k + emission`, W/m². Bindings: `points`, `offsets`, `direct`, `albedo` (of the samples),
/// `emission`, `source`.
///
/// # Errors
/// Buffers that are missing or too short.
pub fn assemble_source(
    plan: &mut Plan,
    pass: &str,
    bindings: Bindings,
    elements: u32,
) -> Result<PassId, ExecutorError> {
    let count = CountParams { count: elements };
    add_pass(plan, pass, &table::FORMFACTOR_ASSEMBLE_SOURCE, bindings, &[], &count, elements)
}

/// Adds the pass that takes values at interpolation points to the pixels: each pixel's is linear in the part of the
/// cell of the triangle that it sees. Bindings: `hits`, `points`, `triangles`, `grids`, `receiver_cells`, `vertices`,
/// `values`, `irradiance`.
///
/// # Errors
/// Buffers that are missing or too short.
pub fn interpolate(plan: &mut Plan, pass: &str, bindings: Bindings, pixels: u32) -> Result<PassId, ExecutorError> {
    let count = CountParams { count: pixels };
    add_pass(plan, pass, &table::FORMFACTOR_INTERPOLATE, bindings, &[], &count, pixels)
}

/// Rays that are traced together, of as many rows as have them, or of one row.
const RAYS_TOGETHER: u32 = 1 << 20;

/// Traces the hemisphere rays of rows on a device: its plan holds the scene and the points of the rows.
pub struct RowTracer<'a> {
    executor: &'a mut (dyn Executor + 'static),
    pass: PassId,
    ids: BufferId,
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
        let rows = (RAYS_TOGETHER / rays.max(1)).clamp(1, surfaces.rows().max(1) as u32);
        let ids = plan.storage("ids", 4 * u64::from(rows) * u64::from(rays));
        let own = [
            tables.named(&mut plan, "offsets", surfaces.offsets.to_vec()),
            tables.named(&mut plan, "points", surfaces.points.to_vec()),
            tables.named(&mut plan, "grids", grids.to_vec()),
            tables.named(&mut plan, "cell_columns", cell_columns),
            ("ids", Range::from(ids)),
        ];
        let params = HemisphereParams {
            first_row: 0,
            row_count: rows,
            rays,
            patch_count: surfaces.patches.len() as u32,
            seed: surfaces.seed,
            ray_offset: surfaces.ray_offset,
            reserved: [0; 2],
        };
        let kernel = &table::FORMFACTOR_HEMISPHERE_HITS;
        let shared = scene_tables.bindings();
        let pass = add_pass(&mut plan, "rows", kernel, &own, shared, &params, rows * rays)?;
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
            self.executor.set_elements(self.pass, rays)?;
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
    offsets: BufferId,
    points: BufferId,
    hits: BufferId,
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
        let bytes = |count: usize, each: usize| (count * each) as u64;
        let offsets = plan.storage("offsets", bytes(rows + 1, size_of::<u32>()));
        let points = plan.storage("points", bytes(points, size_of::<SurfacePoint>()));
        let hits = plan.storage("hits", bytes(rows * rays as usize, size_of::<Hit>()));
        let own = [("offsets", offsets), ("points", points), ("hits", hits)];
        let own = own.map(|(name, buffer)| (name, Range::from(buffer)));
        let params = HemisphereParams { row_count: rows as u32, rays, ..HemisphereParams::default() };
        let kernel = &table::FORMFACTOR_HEMISPHERE_SURFACES;
        let shared = scene_tables.bindings();
        let pass = add_pass(&mut plan, "rows", kernel, &own, shared, &params, params.row_count * rays)?;
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
        self.executor.set_elements(self.pass, count)?;
        self.executor.submit_passes(&[self.pass])?;
        let mut found: Vec<Hit> = self.executor.download_table(self.hits)?;
        found.truncate(count as usize);
        Ok(found)
    }
}

/// Rows of counts of hits on the device.
#[derive(Clone, Debug)]
pub struct HitTables {
    hits: Arc<HitCounts>,
    row_start: BufferId,
    quads: BufferId,
    counts: BufferId,
    scales: BufferId,
}

/// Blocks of rows begin at multiples of this, and their quads too: ranges of a buffer begin at multiples of 256 bytes.
const BLOCK_STEP: usize = 256;

/// Some of the rows, and what a pass over them binds.
#[derive(Debug)]
struct RowBlock {
    rows: ops::Range<usize>,
    tables: [Named; 4],
    first_quad: u32,
}

impl HitTables {
    /// Puts the rows on the device.
    pub fn new(plan: &mut Plan, tables: &mut Tables, hits: &Arc<HitCounts>) -> Self {
        Self {
            hits: Arc::clone(hits),
            row_start: tables.part(plan, "row starts", hits, |hits| hits.row_start()).buffer,
            quads: tables.part(plan, "quads", hits, |hits| hits.quads()).buffer,
            counts: tables.owned(plan, "counts", hits.count_words()).buffer,
            scales: tables.part(plan, "scales", hits, |hits| hits.scales()).buffer,
        }
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
        exitance: BufferId,
        irradiance: BufferId,
    ) -> Result<(), ExecutorError> {
        for RowBlock { rows, tables, first_quad } in self.blocks(range) {
            let received = irradiance.range(rgb_bytes(rows.start), rgb_bytes(rows.len()));
            let light = [("exitance", Range::from(exitance)), ("irradiance", received)];
            let push = HitsParams { rows: rows.len() as u32, first_quad };
            add_pass(plan, pass, &table::FORMFACTOR_GATHER_HITS, &light, &tables, &push, push.rows)?;
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
        exitance: BufferId,
        irradiance: BufferId,
        (marks, computed): (BufferId, BufferId),
    ) -> Result<Vec<ViewPass>, ExecutorError> {
        let mut passes = Vec::new();
        for RowBlock { rows, tables, first_quad } in self.blocks(range) {
            let of_rows =
                |buffer: BufferId, stride: u64| buffer.range(stride * rows.start as u64, stride * rows.len() as u64);
            let own = [
                ("exitance", Range::from(exitance)),
                ("irradiance", of_rows(irradiance, rgb_bytes(1))),
                ("marks", of_rows(marks, 4)),
                ("computed", of_rows(computed, 4)),
            ];
            let params = ViewParams { count: rows.len() as u32, first_quad, ..ViewParams::default() };
            let kernel = &table::FORMFACTOR_GATHER_HITS_VIEW;
            passes.push(ViewPass { pass: add_pass(plan, pass, kernel, &own, &tables, &params, params.count)?, params });
        }
        Ok(passes)
    }

    /// Blocks of rows whose quads fit into one binding.
    fn blocks(&self, range: u64) -> Vec<RowBlock> {
        let starts = self.hits.row_start();
        let quad_bytes = self.quad_bytes();
        let most = (range / quad_bytes.max(1)).saturating_sub(BLOCK_STEP as u64);
        let fits = |first: usize, end: usize| u64::from(starts[end] - starts[first]) <= most;
        row_blocks(self.hits.rows(), BLOCK_STEP, fits).into_iter().map(|rows| self.block(rows)).collect()
    }

    fn quad_bytes(&self) -> u64 {
        let quads = self.hits.quads();
        size_of_val(quads) as u64 / quads.len().max(1) as u64
    }

    fn block(&self, rows: ops::Range<usize>) -> RowBlock {
        let starts = self.hits.row_start();
        let first_quad = starts[rows.start] as usize / BLOCK_STEP * BLOCK_STEP;
        let quads = (starts[rows.end] as usize - first_quad) as u64;
        let words = quads.div_ceil(u64::from(WORD_COUNTS));
        let first_row = rows.start as u64;
        let row_count = rows.len() as u64;
        let tables = [
            ("row_start", self.row_start.range(4 * first_row, 4 * (row_count + 1))),
            ("quads", self.quads.range(first_quad as u64 * self.quad_bytes(), quads * self.quad_bytes())),
            ("counts", self.counts.range(first_quad as u64, 4 * words)),
            ("scales", self.scales.range(4 * first_row, 4 * row_count)),
        ];
        RowBlock { rows, tables, first_quad: first_quad as u32 }
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
            for RowBlock { rows, tables: bound, first_quad } in blocks {
                assert_eq!(rows.start, next);
                next = rows.end;
                let starts = tables.hits.row_start();
                let quads = starts[rows.end] - first_quad;
                assert!(starts[rows.start] >= first_quad && first_quad % 256 == 0);
                let range_of_quads = bound[1].1;
                let expected = (8 * u64::from(first_quad), Some(8 * u64::from(quads)));
                assert_eq!((range_of_quads.offset, range_of_quads.bytes), expected);
                assert!(range < 1000 || range_of_quads.bytes <= Some(range), "{range}: {range_of_quads:?}");
                assert_eq!(bound[2].1.bytes, Some(u64::from(quads.div_ceil(4) * 4)));
            }
            assert_eq!(next, 3000);
        }
    }
}
