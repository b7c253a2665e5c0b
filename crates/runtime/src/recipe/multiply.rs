//! Recipe of `multibounce_multiply`: operators of some bounces built on the device, by Horner's rule.

use glam::Vec4;
use gpu_kernels::multibounce::MultiplyPass;
use multibounce::MultiplyParams;
use multibounce::kernel::multiply::{TILE_ROWS, TILE_VECTORS};

use crate::executor::{Executor, ExecutorError};
use crate::plan::{PassId, Plan, Slice};

/// Columns of a tile: matrices on the device have a multiple of them.
pub const TILE_COLUMNS: usize = 4 * TILE_VECTORS as usize;

/// Products and their sums of a run at most: few enough that drivers take no run for one that hangs, and that work can
/// be cancelled.
const MAX_PRODUCTS: u64 = 1 << 34;

/// The products `T_{k+1} = F + F diag(ρ) T_k` on a device: F, T_k and T_{k+1}, each of `size` × `size` numbers.
pub struct Products {
    size: usize,
    factors: Slice<Vec4>,
    albedo: Slice<Vec4>,
    operators: [Slice<Vec4>; 2],
    /// Passes of the panels of `F + F diag(ρ) F`, of what follows, and of what follows that.
    passes: [Vec<Vec<PassId>>; 3],
}

/// Division of a product into passes.
struct Cut {
    size: usize,
    rows_at_once: usize,
    inner_at_once: usize,
}

impl Products {
    /// Loads the plan for n patches and so many bounces; no binding exceeds `range` bytes.
    ///
    /// # Errors
    /// What the device says.
    pub fn load(device: &mut dyn Executor, n: usize, bounces: u32, range: u64) -> Result<Self, ExecutorError> {
        let cut = Cut::new(n, range);
        let size = cut.size;
        let mut plan = Plan::new();
        let vectors = size / 4;
        let factors = plan.array("form factors", size * vectors);
        let albedo = plan.array("albedo", vectors);
        let first = plan.array("operator", size * vectors);
        // Two bounces are one product.
        let second = if bounces > 2 { plan.array("next operator", size * vectors) } else { first };
        let begin = cut.add_step(&mut plan, factors, albedo, factors, first)?;
        let mut there = Vec::new();
        let mut back = Vec::new();
        if bounces > 2 {
            there = cut.add_step(&mut plan, factors, albedo, first, second)?;
            back = cut.add_step(&mut plan, factors, albedo, second, first)?;
        }
        device.load(plan)?;
        // All of it is zeros; this only says that it may be read, for sums go on from it.
        for buffer in [first, second] {
            device.upload_at(buffer.buffer, 0, &[0; 4])?;
        }
        Ok(Self { size, factors, albedo, operators: [first, second], passes: [begin, there, back] })
    }

    /// Rows and columns of the matrices: n up to a multiple of [`TILE_COLUMNS`].
    pub fn size(&self) -> usize {
        self.size
    }

    /// Panels of rows of a step.
    pub fn panels(&self) -> usize {
        self.passes[0].len()
    }

    /// Puts rows of F on the device, from `first_row` on; each has [`Self::size`] entries.
    ///
    /// # Errors
    /// Rows that do not fit; what the device says.
    pub fn upload_rows(&self, device: &mut dyn Executor, first_row: usize, rows: &[f32]) -> Result<(), ExecutorError> {
        let offset = (first_row * self.size * size_of::<f32>()) as u64;
        device.upload_at(self.factors.buffer, offset, bytemuck::cast_slice(rows))
    }

    /// Sets ρ of all patches in one channel, [`Self::size`] numbers.
    ///
    /// # Errors
    /// Another number of them; what the device says.
    pub fn set_albedo(&self, device: &mut (dyn Executor + 'static), albedo: &[f32]) -> Result<(), ExecutorError> {
        device.upload(self.albedo.cast(), albedo)
    }

    /// Passes of a step, panel by panel.
    pub fn step(&self, step: usize) -> impl Iterator<Item = &[PassId]> {
        self.passes[if step == 0 { 0 } else { 2 - step % 2 }].iter().map(Vec::as_slice)
    }

    /// Buffer of the result after so many steps.
    pub fn result(&self, steps: usize) -> Slice<f32> {
        self.operators[(steps + 1) % 2].cast()
    }
}

impl Cut {
    fn new(n: usize, range: u64) -> Self {
        let size = n.next_multiple_of(TILE_COLUMNS);
        let row_bytes = (size * size_of::<f32>()) as u64;
        let tile_rows = TILE_ROWS as usize;
        let bound = usize::try_from(range / row_bytes.max(1)).unwrap_or(usize::MAX).min(size);
        let most_rows = bound.min((MAX_PRODUCTS / (size as u64 * size as u64).max(1)) as usize);
        let rows_at_once = (most_rows / tile_rows * tile_rows).max(tile_rows);
        let inner_at_once = (bound / 4 * 4).max(4);
        Self { size, rows_at_once, inner_at_once }
    }

    /// Adds the passes of `to = to + F diag(ρ) from`, panel by panel.
    fn add_step(
        &self,
        plan: &mut Plan,
        factors: Slice<Vec4>,
        albedo: Slice<Vec4>,
        from: Slice<Vec4>,
        to: Slice<Vec4>,
    ) -> Result<Vec<Vec<PassId>>, ExecutorError> {
        let mut panels = Vec::new();
        let row_tiles_of = |rows: usize| rows / TILE_ROWS as usize;
        for row in (0..self.size).step_by(self.rows_at_once) {
            let rows = self.rows_at_once.min(self.size - row);
            let mut passes = Vec::new();
            for k in (0..self.size).step_by(self.inner_at_once) {
                let inner = self.inner_at_once.min(self.size - k);
                let vectors = self.size / 4;
                let tiles = (row_tiles_of(rows) * (vectors / TILE_VECTORS as usize)) as u32;
                let push = MultiplyParams {
                    tiles,
                    row_tiles: row_tiles_of(rows) as u32,
                    vectors: vectors as u32,
                    inner: inner as u32 / 4,
                    first_inner: k as u32 / 4,
                };
                let bound = MultiplyPass {
                    factors: self.part(factors, row, rows),
                    albedo,
                    operator: self.part(from, k, inner),
                    next: self.part(to, row, rows),
                };
                passes.push(plan.add("product", &bound, &push)?);
            }
            panels.push(passes);
        }
        Ok(panels)
    }

    /// Some rows of a matrix.
    fn part(&self, matrix: Slice<Vec4>, first: usize, rows: usize) -> Slice<Vec4> {
        let vectors = self.size / 4;
        matrix.part(first * vectors, rows * vectors)
    }
}
