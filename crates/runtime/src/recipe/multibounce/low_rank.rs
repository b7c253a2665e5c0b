//! Operators of low rank: rank-1 terms, dense sub-blocks and sparse residuals.

use std::sync::Arc;

use glam::Vec4;
use gpu_kernels::params::{CountParams, EnterParams, ProjectParams};
use gpu_kernels::table;
use multibounce::LowRank;
use multibounce::kernel::tiles::{FACTOR_WORDS, LIGHT_WORDS, PAIRS, PLACES, QUAD, QUARTERS, RUN_PARTS, SPLITS, TILE};
use transport::LinearOperator as _;

use crate::executor::ExecutorError;
use crate::plan::{BufferId, Plan, Range};
use crate::recipe::{Named, Tables, add_pass, rgb_bytes};

/// An operator of low rank on the device, and what a product keeps between its passes.
#[derive(Clone, Debug)]
pub struct LowRankTables {
    /// What makes sums of the exitance.
    columns: Vec<Named>,
    /// What makes irradiance of the sums: the same tables where rows and columns are the same patches.
    rows: Vec<Named>,
    /// Chroma axes: of the differences of red and blue to green.
    axes: Vec4,
    counts: Counts,
    ordered: BufferId,
    light: BufferId,
    sums: BufferId,
    factors: BufferId,
    products: BufferId,
    near: BufferId,
}

/// Sizes of an operator.
#[derive(Clone, Copy, Debug)]
struct Counts {
    columns: u32,
    rows: u32,
    /// Groups of vectors of the columns.
    quads: u32,
    /// Runs of groups of the columns, and of the rows.
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
            quads: operator.project_tables().quads.len() as u32,
            column_runs: operator.column_runs().len().saturating_sub(1) as u32,
            row_runs: operator.runs.len().saturating_sub(1) as u32,
        };
        Self::with(plan, columns, rows, operator.axes, counts)
    }

    fn with(plan: &mut Plan, columns: Vec<Named>, rows: Vec<Named>, axes: Vec4, counts: Counts) -> Self {
        let places = counts.rows.next_multiple_of(TILE) as usize;
        let column_tiles = u64::from(counts.columns.div_ceil(TILE));
        Self {
            columns,
            rows,
            axes,
            counts,
            // Sparse residuals name any of these.
            ordered: plan.storage("ordered", rgb_bytes(PLACES)),
            light: plan.storage("light", u64::from(LIGHT_WORDS * 4) * column_tiles),
            sums: plan.storage("sums", rgb_bytes((QUAD * counts.quads) as usize)),
            factors: plan.storage("factors", u64::from(FACTOR_WORDS * 4) * u64::from(counts.row_runs)),
            products: plan.storage("rows", rgb_bytes(SPLITS as usize * places)),
            near: plan.storage("near", rgb_bytes(places)),
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
            ("near", Range::from(self.near)),
        ];
        let from = self.counts.columns.next_multiple_of(TILE);
        let to = self.counts.rows.next_multiple_of(TILE);
        let count = |count: u32| CountParams { count };

        let columns = &self.columns;
        let enter = EnterParams { count: from, patches: self.counts.columns };
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_ENTER, &own, columns, &enter, from)?;
        let lanes = from / TILE * QUARTERS;
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_ROUND, &own, columns, &count(lanes), lanes)?;
        let parts = RUN_PARTS * self.counts.column_runs;
        let project = ProjectParams { axes: self.axes, count: parts, reserved: [0; 3] };
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_PROJECT, &own, columns, &project, parts)?;

        let rows = &self.rows;
        let runs = self.counts.row_runs;
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_WEIGH, &own, rows, &count(runs), runs)?;
        let lanes = SPLITS * to / TILE * PAIRS;
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_EXPAND, &own, rows, &count(lanes), lanes)?;
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_NEAR, &own, rows, &count(to / 8), to / 8)?;
        let receivers = self.counts.rows;
        add_pass(plan, pass, &table::MULTIBOUNCE_TILES_LEAVE, &own, rows, &count(receivers), receivers)?;
        Ok(())
    }
}

/// Tables that make irradiance of the sums.
fn row_tables(plan: &mut Plan, tables: &mut Tables, operator: &Arc<LowRank>) -> Vec<Named> {
    vec![
        tables.named_part(plan, "place", operator, |t| &t.place),
        tables.named_part(plan, "root", operator, |t| &t.root),
        tables.named_part(plan, "partner", operator, |t| &t.partner),
        tables.named_part(plan, "run_start", operator, |t| t.expand_tables().run_start),
        tables.named_part(plan, "runs", operator, |t| t.expand_tables().runs),
        tables.named_part(plan, "quads", operator, |t| t.expand_tables().quads),
        tables.named_part(plan, "words", operator, |t| t.expand_tables().words),
        tables.named_part(plan, "square_start", operator, |t| t.near_tables().square_start),
        tables.named_part(plan, "squares", operator, |t| t.near_tables().squares),
        tables.named_part(plan, "square_words", operator, |t| t.near_tables().square_words),
        tables.named_part(plan, "row_start", operator, |t| t.near_tables().row_start),
        tables.named_part(plan, "entries", operator, |t| t.near_tables().entries),
        tables.named_part(plan, "steps", operator, |t| t.near_tables().steps),
    ]
}

/// Tables that make sums of the exitance, of columns that are not the rows.
fn column_tables(plan: &mut Plan, tables: &mut Tables, operator: &Arc<LowRank>) -> Vec<Named> {
    vec![
        tables.named_part(plan, "root", operator, |t| t.columns.as_ref().map_or(&[], |c| &c.root)),
        tables.named_part(plan, "runs", operator, |t| t.columns.as_ref().map_or(&[], |c| &c.runs)),
        tables.named_part(plan, "quads", operator, |t| t.columns.as_ref().map_or(&[], |c| &c.quads)),
        tables.named_part(plan, "words", operator, |t| t.columns.as_ref().map_or(&[], |c| &c.words)),
    ]
}
