//! Operators of low rank: rank-1 terms, dense sub-blocks and sparse residuals.

use std::sync::Arc;

use glam::Vec4;
use gpu_kernels::params::{CountParams, MultiplyVtParams, PermuteInParams};
use gpu_kernels::table;
use multibounce::LowRank;
use multibounce::kernel::tiles::{
    FACTOR_WORDS, GROUP_VECTORS, LIGHT_WORDS, PAIRS, PERMUTED_INDICES, RUN_INVOCATIONS, SPLITS, TILE, U32X4S,
};
use transport::LinearOperator as _;

use crate::executor::ExecutorError;
use crate::plan::{BufferId, Plan, Range};
use crate::recipe::{Named, Tables, add_pass, rgb_bytes};

/// An operator of low rank on the device, and what a product keeps between its passes.
#[derive(Clone, Debug)]
pub struct LowRankTables {
    /// Tables that make sums of the exitance.
    columns: Vec<Named>,
    /// Tables that make irradiance of the sums: the same where rows and columns are the same patches.
    rows: Vec<Named>,
    /// Chroma axes: of the differences of red and blue to green.
    chroma_axes: Vec4,
    counts: Counts,
    ordered: BufferId,
    light: BufferId,
    sums: BufferId,
    factors: BufferId,
    products: BufferId,
    dense_sparse: BufferId,
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
        let rows = row_tables(plan, tables, operator);
        let mut columns = vec![
            tables.named_part(plan, "order", operator, |t| &t.order),
            tables.named_part(plan, "scales", operator, |t| &t.scale),
        ];
        match operator.columns {
            Some(_) => columns.extend(column_tables(plan, tables, operator)),
            None => columns.extend(rows.iter().copied()),
        }
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

    fn with(plan: &mut Plan, columns: Vec<Named>, rows: Vec<Named>, chroma_axes: Vec4, counts: Counts) -> Self {
        let padded_rows = counts.rows.next_multiple_of(TILE) as usize;
        let column_tiles = u64::from(counts.columns.div_ceil(TILE));
        Self {
            columns,
            rows,
            chroma_axes,
            counts,
            // Sparse residuals name any of these.
            ordered: plan.storage("ordered", rgb_bytes(PERMUTED_INDICES)),
            light: plan.storage("light", u64::from(LIGHT_WORDS * 4) * column_tiles),
            sums: plan.storage("sums", rgb_bytes((GROUP_VECTORS * counts.groups) as usize)),
            factors: plan.storage("factors", u64::from(FACTOR_WORDS * 4) * u64::from(counts.row_runs)),
            products: plan.storage("rows", rgb_bytes(SPLITS as usize * padded_rows)),
            dense_sparse: plan.storage("dense_sparse", rgb_bytes(padded_rows)),
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
        exitance: BufferId,
        irradiance: BufferId,
    ) -> Result<(), ExecutorError> {
        let own = [
            ("exitance", Range::from(exitance)),
            ("irradiance", Range::from(irradiance)),
            ("ordered", Range::from(self.ordered)),
            ("light", Range::from(self.light)),
            ("sums", Range::from(self.sums)),
            ("factors", Range::from(self.factors)),
            ("rows", Range::from(self.products)),
            ("dense_sparse", Range::from(self.dense_sparse)),
        ];
        let from = self.counts.columns.next_multiple_of(TILE);
        let to = self.counts.rows.next_multiple_of(TILE);
        let count = |count: u32| CountParams { count };

        let columns = &self.columns;
        let permute_in = PermuteInParams { count: from, patches: self.counts.columns };
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_PERMUTE_IN, &own, columns, &permute_in, from)?;
        let lanes = from / TILE * U32X4S;
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_QUANTISE, &own, columns, &count(lanes), lanes)?;
        let invocations = RUN_INVOCATIONS * self.counts.column_runs;
        let multiply_vt = MultiplyVtParams { chroma_axes: self.chroma_axes, count: invocations, reserved: [0; 3] };
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_MULTIPLY_VT, &own, columns, &multiply_vt, invocations)?;

        let rows = &self.rows;
        let runs = self.counts.row_runs;
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_REQUANTISE, &own, rows, &count(runs), runs)?;
        let lanes = SPLITS * to / TILE * PAIRS;
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_MULTIPLY_U, &own, rows, &count(lanes), lanes)?;
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_DENSE_SPARSE, &own, rows, &count(to / 8), to / 8)?;
        let receivers = self.counts.rows;
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_PERMUTE_OUT, &own, rows, &count(receivers), receivers)?;
        Ok(())
    }
}

/// Tables that make irradiance of the sums.
fn row_tables(plan: &mut Plan, tables: &mut Tables, operator: &Arc<LowRank>) -> Vec<Named> {
    vec![
        tables.named_part(plan, "permuted_index", operator, |t| &t.permuted_index),
        tables.named_part(plan, "sqrt_area", operator, |t| &t.row_sqrt_area),
        tables.named_part(plan, "paired", operator, |t| &t.paired),
        tables.named_part(plan, "run_start", operator, |t| t.u_tables().run_start),
        tables.named_part(plan, "runs", operator, |t| t.u_tables().runs),
        tables.named_part(plan, "groups", operator, |t| t.u_tables().groups),
        tables.named_part(plan, "words", operator, |t| t.u_tables().words),
        tables.named_part(plan, "sub_block_start", operator, |t| t.dense_sparse_tables().sub_block_start),
        tables.named_part(plan, "sub_blocks", operator, |t| t.dense_sparse_tables().sub_blocks),
        tables.named_part(plan, "sub_block_words", operator, |t| t.dense_sparse_tables().sub_block_words),
        tables.named_part(plan, "row_start", operator, |t| t.dense_sparse_tables().row_start),
        tables.named_part(plan, "entries", operator, |t| t.dense_sparse_tables().entries),
        tables.named_part(plan, "steps", operator, |t| t.dense_sparse_tables().steps),
    ]
}

/// Tables that make sums of the exitance, of columns that are not the rows.
fn column_tables(plan: &mut Plan, tables: &mut Tables, operator: &Arc<LowRank>) -> Vec<Named> {
    vec![
        tables.named_part(plan, "sqrt_area", operator, |t| t.columns.as_ref().map_or(&[], |c| &c.sqrt_area)),
        tables.named_part(plan, "runs", operator, |t| t.columns.as_ref().map_or(&[], |c| &c.runs)),
        tables.named_part(plan, "groups", operator, |t| t.columns.as_ref().map_or(&[], |c| &c.groups)),
        tables.named_part(plan, "words", operator, |t| t.columns.as_ref().map_or(&[], |c| &c.words)),
    ]
}
