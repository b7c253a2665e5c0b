//! Operators of low rank: rank-1 terms, dense sub-blocks and sparse residuals.

use std::sync::Arc;

use glam::{UVec4, Vec4};
use gpu_kernels::low_rank::{
    LowRankDenseSparsePass, LowRankMultiplyUPass, LowRankMultiplyVtPass, LowRankPermuteInPass, LowRankPermuteOutPass,
    LowRankQuantisePass, LowRankRequantisePass,
};
use gpu_kernels::params::{CountParams, MultiplyVtParams, PermuteInParams};
use multibounce::kernel::low_rank::{
    FACTOR_WORDS, GROUP_VECTORS, LIGHT_WORDS, PAIRS, PERMUTED_INDICES, RUN_INVOCATIONS, SPLITS, TILE, U32X4S,
};
use multibounce::{ColumnVectors, LowRank, PackedGroup, SubBlock};
use scene::Rgb;
use transport::LinearOperator as _;

use crate::executor::ExecutorError;
use crate::plan::{Plan, Slice};
use crate::recipe::Tables;

/// An operator of low rank on the device, and what a product keeps between its passes.
#[derive(Clone, Copy, Debug)]
pub struct LowRankTables {
    columns: Columns,
    rows: Rows,
    /// Chroma axes: of the differences of red and blue to green.
    chroma_axes: Vec4,
    counts: Counts,
    ordered: Slice<Rgb>,
    light: Slice<UVec4>,
    sums: Slice<Rgb>,
    factors: Slice<UVec4>,
    products: Slice<Rgb>,
    dense_sparse: Slice<Rgb>,
}

/// Tables that make sums of the exitance.
#[derive(Clone, Copy, Debug)]
struct Columns {
    order: Slice<u32>,
    scales: Slice<f32>,
    vectors: Vectors,
}

/// Vectors of the columns, or of the rows.
#[derive(Clone, Copy, Debug)]
struct Vectors {
    sqrt_area: Slice<f32>,
    runs: Slice<u32>,
    groups: Slice<PackedGroup>,
    words: Slice<u32>,
}

/// Tables that make irradiance of the sums.
#[derive(Clone, Copy, Debug)]
struct Rows {
    vectors: Vectors,
    permuted_index: Slice<u32>,
    paired: Slice<u32>,
    run_start: Slice<u32>,
    sub_block_start: Slice<u32>,
    sub_blocks: Slice<SubBlock>,
    sub_block_words: Slice<u32>,
    row_start: Slice<u32>,
    entries: Slice<u32>,
    steps: Slice<f32>,
}

/// Sizes of an operator.
#[derive(Clone, Copy, Debug)]
struct Counts {
    columns: u32,
    rows: u32,
    /// Packed groups of vectors of the columns.
    groups: u32,
    /// Runs of packed groups of the columns, and of the rows.
    column_runs: u32,
    row_runs: u32,
}

impl LowRankTables {
    /// Puts an operator on the device.
    pub fn new(plan: &mut Plan, tables: &mut Tables, operator: &Arc<LowRank>) -> Self {
        let rows = Rows::new(plan, tables, operator);
        let columns = Columns {
            order: tables.part(plan, "order", operator, |t| &t.order),
            scales: tables.part(plan, "scales", operator, |t| &t.scale),
            // The same where rows and columns are the same patches.
            vectors: match operator.columns {
                Some(_) => Vectors::of_columns(plan, tables, operator),
                None => rows.vectors,
            },
        };
        let (row_count, column_count) = operator.shape();
        let counts = Counts {
            columns: column_count as u32,
            rows: row_count as u32,
            groups: operator.vt_tables().groups.len() as u32,
            column_runs: operator.column_runs().len().saturating_sub(1) as u32,
            row_runs: operator.runs.len().saturating_sub(1) as u32,
        };
        Self::with(plan, columns, rows, operator.chroma_axes, counts)
    }

    fn with(plan: &mut Plan, columns: Columns, rows: Rows, chroma_axes: Vec4, counts: Counts) -> Self {
        let padded_rows = counts.rows.next_multiple_of(TILE) as usize;
        let column_tiles = counts.columns.div_ceil(TILE);
        Self {
            columns,
            rows,
            chroma_axes,
            counts,
            // Sparse residuals name any of these.
            ordered: plan.array("ordered", PERMUTED_INDICES),
            light: plan.array("light", (LIGHT_WORDS / 4 * column_tiles) as usize),
            sums: plan.array("sums", (GROUP_VECTORS * counts.groups) as usize),
            factors: plan.array("factors", (FACTOR_WORDS / 4 * counts.row_runs) as usize),
            products: plan.array("rows", SPLITS as usize * padded_rows),
            dense_sparse: plan.array("dense_sparse", padded_rows),
        }
    }

    /// Adds the passes of `irradiance = T exitance`.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn product(
        &self,
        plan: &mut Plan,
        pass: &str,
        exitance: Slice<Rgb>,
        irradiance: Slice<Rgb>,
    ) -> Result<(), ExecutorError> {
        self.add_vt(plan, pass, exitance)?;
        self.add_u(plan, pass, irradiance)
    }

    /// Adds the passes from the exitance to its sums with the vectors of the columns.
    fn add_vt(&self, plan: &mut Plan, pass: &str, exitance: Slice<Rgb>) -> Result<(), ExecutorError> {
        let Self { ordered, light, sums, counts, .. } = *self;
        let Columns { order, scales, vectors } = self.columns;
        let Vectors { sqrt_area, runs, groups, words } = vectors;
        let padded = counts.columns.next_multiple_of(TILE);
        let permute_in = LowRankPermuteInPass { order, sqrt_area, exitance, ordered };
        plan.add(pass, &permute_in, &PermuteInParams { count: padded, patches: counts.columns })?;
        let quantise = LowRankQuantisePass { ordered, light: light.cast() };
        plan.add(pass, &quantise, &CountParams { count: padded / TILE * U32X4S })?;
        let words = words.cast();
        let scales = scales.cast();
        let multiply_vt = LowRankMultiplyVtPass { runs, groups, words, scales, light, sums };
        let count = RUN_INVOCATIONS * counts.column_runs;
        let push = MultiplyVtParams { chroma_axes: self.chroma_axes, count, reserved: [0; 3] };
        plan.add(pass, &multiply_vt, &push)?;
        Ok(())
    }

    /// Adds the passes from the sums to the irradiance.
    fn add_u(&self, plan: &mut Plan, pass: &str, irradiance: Slice<Rgb>) -> Result<(), ExecutorError> {
        let Self { ordered, light, sums, factors, products, dense_sparse, counts, .. } = *self;
        let Rows { vectors, permuted_index, run_start, sub_block_start, sub_blocks, .. } = self.rows;
        let Rows { row_start, entries, steps, .. } = self.rows;
        let Vectors { sqrt_area, runs, groups, words } = vectors;
        let paired = self.rows.paired.cast();
        let padded = counts.rows.next_multiple_of(TILE);
        let requantise = LowRankRequantisePass { runs, paired, sums, factors };
        plan.add(pass, &requantise, &CountParams { count: counts.row_runs })?;
        let words = words.cast();
        let multiply_u = LowRankMultiplyUPass { run_start, runs, groups, words, factors, rows: products };
        plan.add(pass, &multiply_u, &CountParams { count: SPLITS * padded / TILE * PAIRS })?;
        let sub_block_words = self.rows.sub_block_words.cast();
        let both = LowRankDenseSparsePass {
            sub_block_start,
            sub_blocks,
            sub_block_words,
            light,
            row_start,
            entries,
            steps,
            ordered,
            dense_sparse,
        };
        plan.add(pass, &both, &CountParams { count: padded / 8 })?;
        let permute_out = LowRankPermuteOutPass { permuted_index, sqrt_area, rows: products, dense_sparse, irradiance };
        plan.add(pass, &permute_out, &CountParams { count: counts.rows })?;
        Ok(())
    }
}

impl Rows {
    fn new(plan: &mut Plan, tables: &mut Tables, operator: &Arc<LowRank>) -> Self {
        Self {
            permuted_index: tables.part(plan, "permuted_index", operator, |t| &t.permuted_index),
            vectors: Vectors {
                sqrt_area: tables.part(plan, "sqrt_area", operator, |t| &t.row_sqrt_area),
                runs: tables.part(plan, "runs", operator, |t| t.u_tables().runs),
                groups: tables.part(plan, "groups", operator, |t| t.u_tables().groups),
                words: tables.part(plan, "words", operator, |t| t.u_tables().words),
            },
            paired: tables.part(plan, "paired", operator, |t| &t.paired),
            run_start: tables.part(plan, "run_start", operator, |t| t.u_tables().run_start),
            sub_block_start: tables
                .part(plan, "sub_block_start", operator, |t| t.dense_sparse_tables().sub_block_start),
            sub_blocks: tables.part(plan, "sub_blocks", operator, |t| t.dense_sparse_tables().sub_blocks),
            sub_block_words: tables
                .part(plan, "sub_block_words", operator, |t| t.dense_sparse_tables().sub_block_words),
            row_start: tables.part(plan, "row_start", operator, |t| t.dense_sparse_tables().row_start),
            entries: tables.part(plan, "entries", operator, |t| t.dense_sparse_tables().entries),
            steps: tables.part(plan, "steps", operator, |t| t.dense_sparse_tables().steps),
        }
    }
}

impl Vectors {
    /// Those of columns that are not the rows.
    fn of_columns(plan: &mut Plan, tables: &mut Tables, operator: &Arc<LowRank>) -> Self {
        fn part<T>(operator: &LowRank, part: fn(&ColumnVectors) -> &[T]) -> &[T] {
            operator.columns.as_ref().map_or(&[], part)
        }
        Self {
            sqrt_area: tables.part(plan, "sqrt_area", operator, |t| part(t, |c| &c.sqrt_area)),
            runs: tables.part(plan, "runs", operator, |t| part(t, |c| &c.runs)),
            groups: tables.part(plan, "groups", operator, |t| part(t, |c| &c.groups)),
            words: tables.part(plan, "words", operator, |t| part(t, |c| &c.words)),
        }
    }
}
