//! Recipe of `multibounce_eliminate`: the inverse of a symmetric positive definite matrix on the device, block by
//! block.

use glam::Vec4;
use gpu_kernels::multibounce::{EliminatePass, PivotRowsPass, ScaledRowsPass};
use multibounce::InvertParams;
use multibounce::kernel::invert::{PIVOT_ROWS, PIVOT_VECTORS};
use multibounce::kernel::multiply::{TILE_ROWS, TILE_VECTORS};

use super::multiply::TILE_COLUMNS;
use crate::executor::{Executor, ExecutorError};
use crate::plan::{PassId, Plan, Slice};

/// Rows of a block.
pub const BLOCK: usize = PIVOT_ROWS as usize;

/// A matrix on a device that becomes its inverse ([`multibounce::kernel::invert`]): `size` × `size` numbers, and three
/// times 64 rows. The inverse of each block of 64 × 64 numbers on the diagonal comes from the caller.
pub struct Inverse {
    size: usize,
    row_bytes: u64,
    matrix: Slice<Vec4>,
    pivot_block: Slice<Vec4>,
    inverse: Slice<Vec4>,
    scale: PassId,
    panels: Vec<Panel>,
}

/// Some rows of the matrix, as many as a binding shows, and the passes over them.
struct Panel {
    first_row: usize,
    rows: usize,
    /// Pass of the block that is eliminated alone, and of its rows.
    pivot_block: PassId,
    pivot_rows: PassId,
    eliminate: PassId,
}

impl Inverse {
    /// Loads the plan for n rows; no binding exceeds `range` bytes.
    ///
    /// # Errors
    /// What the device says.
    pub fn load(device: &mut dyn Executor, n: usize, range: u64) -> Result<Self, ExecutorError> {
        let size = n.next_multiple_of(TILE_COLUMNS);
        let row_bytes = (size * size_of::<f32>()) as u64;
        let vectors = (size / 4) as u32;
        let mut plan = Plan::new();
        let row = size / 4;
        let matrix = plan.array("matrix", size * row);
        let pivot_block = plan.array("pivot block", BLOCK * BLOCK / 4);
        let inverse = plan.array("inverse of the block", BLOCK * BLOCK / 4);
        let pivot_rows = plan.array("pivot rows", BLOCK * row);
        let scaled_rows = plan.array("scaled rows", BLOCK * row);
        let most = usize::try_from(range / row_bytes).unwrap_or(usize::MAX).min(size);
        let rows_at_once = (most / BLOCK * BLOCK).max(BLOCK);
        let mut panels = Vec::new();
        for first_row in (0..size).step_by(rows_at_once) {
            let rows = rows_at_once.min(size - first_row);
            let part = matrix.part(first_row * row, rows * row);
            let params = InvertParams { vectors, first_row: first_row as u32, rows: rows as u32, ..Default::default() };
            let block = InvertParams { count: PIVOT_ROWS * PIVOT_VECTORS, width: PIVOT_VECTORS, ..params };
            let all = InvertParams { count: PIVOT_ROWS * vectors, width: vectors, ..params };
            let tiles = InvertParams { count: params.rows / TILE_ROWS * vectors / TILE_VECTORS, ..params };
            let of_block = PivotRowsPass { matrix: part, pivot_rows: pivot_block };
            let of_rows = PivotRowsPass { matrix: part, pivot_rows };
            let bound = EliminatePass { inverse, pivot_rows, scaled_rows, matrix: part };
            panels.push(Panel {
                first_row,
                rows,
                pivot_block: plan.add("pivot rows", &of_block, &block)?,
                pivot_rows: plan.add("pivot rows", &of_rows, &all)?,
                eliminate: plan.add("eliminate", &bound, &tiles)?,
            });
        }
        let params = InvertParams { count: PIVOT_ROWS * vectors, vectors, ..Default::default() };
        let scale = plan.add("scaled rows", &ScaledRowsPass { inverse, pivot_rows, scaled_rows }, &params)?;
        device.load(plan)?;
        // All of them are zeros; this only says that they may be read.
        for buffer in [pivot_block, pivot_rows] {
            device.upload_at(buffer.buffer, 0, &[0; 4])?;
        }
        Ok(Self { size, row_bytes, matrix, pivot_block, inverse, scale, panels })
    }

    /// Rows and columns of the matrix: n up to a multiple of 256.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Blocks on the diagonal, each a step.
    pub fn blocks(&self) -> usize {
        self.size / BLOCK
    }

    /// Puts rows of the matrix on the device, from `first_row` on; each has [`Self::size`] entries. Those beyond n are
    /// rows of the identity.
    ///
    /// # Errors
    /// Rows that do not fit; what the device says.
    pub fn upload_rows(&self, device: &mut dyn Executor, first_row: usize, rows: &[f32]) -> Result<(), ExecutorError> {
        device.upload_at(self.matrix.buffer, first_row as u64 * self.row_bytes, bytemuck::cast_slice(rows))
    }

    /// The next block on the diagonal, number `step`, 64 × 64 entries row by row. Waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn pivot_block(&self, device: &mut (dyn Executor + 'static), step: usize) -> Result<Vec<f32>, ExecutorError> {
        let pivot = step * BLOCK;
        for panel in self.panels.iter().filter(|panel| (panel.first_row..panel.first_row + panel.rows).contains(&pivot))
        {
            let params = InvertParams {
                count: PIVOT_ROWS * PIVOT_VECTORS,
                width: PIVOT_VECTORS,
                first_vector: (pivot / 4) as u32,
                ..self.params(panel, pivot)
            };
            device.push(panel.pivot_block, &params)?;
            device.submit_passes(&[panel.pivot_block])?;
        }
        device.download_table(self.pivot_block.cast())
    }

    /// Eliminates that block, of which `inverse` is the inverse.
    ///
    /// # Errors
    /// Another number of entries; what the device says.
    pub fn eliminate(
        &self,
        device: &mut (dyn Executor + 'static),
        step: usize,
        inverse: &[f32],
    ) -> Result<(), ExecutorError> {
        let pivot = step * BLOCK;
        device.upload(self.inverse.cast(), inverse)?;
        let vectors = (self.size / 4) as u32;
        let mut passes = Vec::new();
        for panel in &self.panels {
            let params = self.params(panel, pivot);
            device.push(panel.pivot_rows, &InvertParams { count: PIVOT_ROWS * vectors, width: vectors, ..params })?;
            passes.push(panel.pivot_rows);
        }
        passes.push(self.scale);
        for panel in &self.panels {
            let params = self.params(panel, pivot);
            let count = params.rows / TILE_ROWS * vectors / TILE_VECTORS;
            device.push(panel.eliminate, &InvertParams { count, ..params })?;
            passes.push(panel.eliminate);
        }
        device.submit_passes(&passes)
    }

    /// The matrix as it is: its upper half. Waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn download(&self, device: &mut (dyn Executor + 'static)) -> Result<Vec<f32>, ExecutorError> {
        device.download_table(self.matrix.cast())
    }

    fn params(&self, panel: &Panel, pivot: usize) -> InvertParams {
        InvertParams {
            vectors: (self.size / 4) as u32,
            pivot: pivot as u32,
            first_row: panel.first_row as u32,
            rows: panel.rows as u32,
            ..InvertParams::default()
        }
    }
}
