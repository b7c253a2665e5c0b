//! Recipe of `temporal`: rows that are sampled in each frame, and irradiance that stays from frame to frame.

use std::ops;
use std::sync::Arc;

use glam::Vec4;
use gpu_kernels::params::CountParams;
use gpu_kernels::table::{self, Kernel};
use temporal::kernel::sample::{AUTO, CONTROL, NARROW, has};
use temporal::{AliasTables, Distribution, RayLists, SampleParams, Settings, SumParams};

use super::{Named, Tables, add_pass, rgb_bytes, row_blocks};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{BufferId, PassId, Plan, Range};

/// Rows begin at multiples of this, and entries: ranges of a buffer begin at multiples of 256 bytes.
const STEP: usize = 256;
/// Frames that light which has settled counts for.
const SETTLED: f32 = (1 << 20) as f32;

/// Rows of an operator as distributions that frames sample.
#[derive(Clone, Debug, PartialEq)]
pub enum Rows {
    /// Lists of columns, all entries alike.
    Lists(Arc<RayLists>),
    /// Alias tables.
    Tables(Arc<AliasTables>),
}

impl Rows {
    /// The rows as they are sampled.
    pub fn distribution(&self) -> &dyn Distribution {
        match self {
            Self::Lists(lists) => &**lists,
            Self::Tables(tables) => &**tables,
        }
    }

    /// First entry of each row, and the end of the last.
    fn row_start(&self) -> &[u32] {
        match self {
            Self::Lists(lists) => lists.row_start(),
            Self::Tables(tables) => tables.row_start(),
        }
    }
}

/// Rows of one kind that frames sample: what goes in, and what stays.
pub struct SampledRows<'a> {
    /// Name of the passes.
    pub pass: &'a str,
    /// The rows.
    pub rows: &'a Rows,
    /// Settings of the sampling.
    pub settings: Settings,
    /// Exitance is `source + albedo∘reflected`, one for each column.
    pub source: Range,
    /// Albedo of the columns.
    pub albedo: Range,
    /// Irradiance of the columns that is reflected, W/m².
    pub reflected: Range,
    /// Irradiance found by sampling, one for each row, W/m².
    pub irradiance: BufferId,
}

/// The passes of [`SampledRows`].
pub struct SampledPasses {
    settings: Settings,
    options: u32,
    /// Passes that find the change of the exitance, and the exitance itself.
    change: Vec<PassId>,
    blocks: Vec<Block>,
    /// First exitance and irradiance of a block's rows before the first frame.
    start: [(BufferId, usize); 2],
}

/// Rows that one binding shows.
struct Block {
    sample: PassId,
    sum: PassId,
    rows: u32,
    first_row: u32,
    first_entry: u32,
}

impl SampledPasses {
    /// Adds the passes of a frame: changes, samples, and exact sums of the rows that this frame refreshes; a binding
    /// shows at most `range` bytes.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn new(plan: &mut Plan, tables: &mut Tables, level: &SampledRows, range: u64) -> Result<Self, ExecutorError> {
        let rows = level.rows.distribution();
        let seen = plan.storage("seen", rgb_bytes(rows.columns()));
        let (change, change_passes) = add_change(plan, level, seen)?;
        let entries = EntryTables::new(plan, tables, level.rows);
        let light = [("exitance", Range::from(seen)), ("change", Range::from(change))];
        let mut blocks = Vec::new();
        for own in row_blocks(rows.rows(), STEP, |first, end| entries.fits(first, end, range)) {
            blocks.push(add_block(plan, level, &entries, &light, own)?);
        }
        let start = [(seen, rows.columns()), (level.irradiance, rows.rows())];
        Ok(Self { settings: level.settings, options: rows.options(), change: change_passes, blocks, start })
    }

    /// The dark, before the first frame.
    ///
    /// # Errors
    /// What the device says.
    pub fn clear(&self, executor: &mut (dyn Executor + 'static)) -> Result<(), ExecutorError> {
        for (buffer, count) in self.start {
            executor.upload(buffer, &vec![Vec4::new(0.0, 0.0, 0.0, SETTLED); count])?;
        }
        Ok(())
    }

    /// Exact sums of all rows.
    ///
    /// # Errors
    /// What the device says.
    pub fn settle(&self, executor: &mut (dyn Executor + 'static)) -> Result<(), ExecutorError> {
        executor.submit_passes(&self.change)?;
        for block in &self.blocks {
            let push = SumParams {
                count: block.rows,
                rows: block.rows,
                first: 0,
                first_entry: block.first_entry,
                options: self.options,
            };
            executor.push(block.sum, &push)?;
            executor.set_elements(block.sum, block.rows)?;
            executor.submit_passes(&[block.sum])?;
        }
        Ok(())
    }

    /// Samples of another frame.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_frame(&self, executor: &mut (dyn Executor + 'static), frame: u32) -> Result<(), ExecutorError> {
        for block in &self.blocks {
            let params = self.settings.params(block.rows, self.options, frame);
            let sample = SampleParams { first_row: block.first_row, first_entry: block.first_entry, ..params };
            executor.push(block.sample, &sample)?;
            let rows_to_sum = self.settings.rows_to_sum(block.rows, self.options, frame);
            executor.push(block.sum, &SumParams { first_entry: block.first_entry, ..rows_to_sum })?;
            executor.set_elements(block.sum, rows_to_sum.count)?;
        }
        Ok(())
    }
}

/// Adds the passes that find what shines now, and how it has changed; gives the buffer of the change.
fn add_change(plan: &mut Plan, level: &SampledRows, seen: BufferId) -> Result<(BufferId, Vec<PassId>), ExecutorError> {
    let rows = level.rows.distribution();
    let options = level.settings.params(0, rows.options(), 0).options;
    let needs_change = has(options, CONTROL) || has(options, AUTO);
    let change = if needs_change { plan.storage("change", rgb_bytes(rows.columns())) } else { seen };
    let own = [
        ("source", level.source),
        ("albedo", level.albedo),
        ("irradiance", level.reflected),
        ("exitance", Range::from(seen)),
        ("change", Range::from(change)),
    ];
    let push = CountParams { count: rows.columns() as u32 };
    let mut passes = Vec::new();
    if needs_change {
        passes.push(add_pass(plan, level.pass, &table::TEMPORAL_CHANGE, &own, &[], &push, push.count)?);
    }
    passes.push(add_pass(plan, level.pass, &table::FORMFACTOR_BOUNCE, &own, &[], &push, push.count)?);
    Ok((change, passes))
}

/// Adds the passes of some rows: samples, and sums of those that this frame refreshes.
fn add_block(
    plan: &mut Plan,
    level: &SampledRows,
    entries: &EntryTables,
    light: &[Named],
    own: ops::Range<usize>,
) -> Result<Block, ExecutorError> {
    let options = level.rows.distribution().options();
    let rows = own.len() as u32;
    let first_row = own.start as u32;
    let (mut bound, first_entry) = entries.block(own.clone());
    bound.push(("irradiance", level.irradiance.range(rgb_bytes(own.start), rgb_bytes(own.len()))));
    let sample = SampleParams { first_row, first_entry, ..level.settings.params(rows, options, 0) };
    let sum = SumParams { first_entry, ..level.settings.rows_to_sum(rows, options, 0) };
    let [sample_kernel, sum_kernel] = entries.kernels;
    let sample = add_pass(plan, level.pass, sample_kernel, &bound, light, &sample, rows)?;
    let sum = add_pass(plan, level.pass, sum_kernel, &bound, light, &sum, sum.count)?;
    Ok(Block { sample, sum, rows, first_row, first_entry })
}

/// A table of the entries of rows.
struct Entries {
    name: &'static str,
    buffer: BufferId,
    /// Bytes of an entry; 0 for a table that all rows share.
    bytes: u64,
}

/// Rows on the device.
struct EntryTables<'a> {
    row_start: &'a [u32],
    starts: BufferId,
    sums: BufferId,
    entries: Vec<Entries>,
    kernels: [&'static Kernel; 2],
}

impl<'a> EntryTables<'a> {
    fn new(plan: &mut Plan, tables: &mut Tables, rows: &'a Rows) -> Self {
        let column_bytes = if has(rows.distribution().options(), NARROW) { 2 } else { 4 };
        match rows {
            Rows::Lists(lists) => Self {
                row_start: rows.row_start(),
                starts: tables.part(plan, "row starts", lists, |l| l.row_start()).buffer,
                sums: tables.part(plan, "row sums", lists, |l| l.sums()).buffer,
                entries: vec![Entries {
                    name: "columns",
                    buffer: tables.part(plan, "list columns", lists, |l| l.words()).buffer,
                    bytes: column_bytes,
                }],
                kernels: [&table::TEMPORAL_SAMPLE_LISTS, &table::TEMPORAL_SUM_LISTS],
            },
            Rows::Tables(alias) => {
                let slots = tables.part(plan, "slots", alias, |t| t.slots()).buffer;
                let columns = tables.part(plan, "table columns", alias, |t| t.words()).buffer;
                let colors = tables.part(plan, "table colors", alias, |t| t.colors()).buffer;
                Self {
                    row_start: rows.row_start(),
                    starts: tables.part(plan, "row starts", alias, |t| t.row_start()).buffer,
                    sums: tables.part(plan, "row sums", alias, |t| t.sums()).buffer,
                    entries: vec![
                        Entries { name: "slots", buffer: slots, bytes: 4 },
                        Entries { name: "columns", buffer: columns, bytes: column_bytes },
                        Entries { name: "colors", buffer: colors, bytes: 0 },
                    ],
                    kernels: [&table::TEMPORAL_SAMPLE_TABLES, &table::TEMPORAL_SUM_TABLES],
                }
            }
        }
    }

    /// First entry that a block binds, and the number of those that follow.
    fn span(&self, first: usize, end: usize) -> (u64, u64) {
        let from = self.row_start[first] as usize / STEP * STEP;
        (from as u64, (self.row_start[end] as usize - from) as u64)
    }

    fn fits(&self, first: usize, end: usize, range: u64) -> bool {
        let entries = self.span(first, end).1;
        self.entries.iter().all(|table| (entries * table.bytes).next_multiple_of(4) <= range)
    }

    /// Bindings of a block of rows, and its first entry.
    fn block(&self, rows: ops::Range<usize>) -> (Vec<Named>, u32) {
        let (from, count) = self.span(rows.start, rows.end);
        let part = |table: &Entries| match (table.bytes, count) {
            // Something is bound even where nothing is read.
            (0, _) | (_, 0) => Range::from(table.buffer),
            (bytes, _) => table.buffer.range(from * bytes, (count * bytes).next_multiple_of(4)),
        };
        let mut bound: Vec<Named> = self.entries.iter().map(|table| (table.name, part(table))).collect();
        bound.push(("row_start", self.starts.range(4 * rows.start as u64, 4 * (rows.len() + 1) as u64)));
        bound.push(("row_sums", self.sums.range(4 * rows.start as u64, 4 * rows.len() as u64)));
        (bound, from as u32)
    }
}
