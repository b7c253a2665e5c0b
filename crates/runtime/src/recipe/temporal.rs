//! Recipe of `temporal`: rows that are sampled in each frame, and irradiance that stays from frame to frame.

use std::ops;
use std::sync::Arc;

use glam::Vec4;
use gpu_kernels::params::CountParams;
use gpu_kernels::temporal::{ChangePass, SampleListsPass, SampleTablesPass, SumListsPass, SumTablesPass};
use gpu_kernels::transport::BouncePass;
use scene::Rgb;
use temporal::kernel::sample::{AUTO, CONTROL, NARROW, has};
use temporal::{AliasTables, Distribution, RayLists, SampleParams, Settings, SumParams};

use super::{Tables, row_blocks};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{PassId, Plan, Slice};

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
    pub source: Slice<Rgb>,
    /// Albedo of the columns.
    pub albedo: Slice<Rgb>,
    /// Irradiance of the columns that is reflected, W/m².
    pub reflected: Slice<Rgb>,
    /// Irradiance found by sampling, one for each row, W/m².
    pub irradiance: Slice<Rgb>,
}

/// The passes of [`SampledRows`].
pub struct SampledPasses {
    settings: Settings,
    options: u32,
    /// Passes that find the change of the exitance, and the exitance itself.
    change: Vec<PassId>,
    blocks: Vec<Block>,
    /// First exitance and irradiance of a block's rows before the first frame.
    start: [(Slice<Rgb>, usize); 2],
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
        let seen = plan.array("seen", rows.columns());
        let (change, change_passes) = add_change(plan, level, seen)?;
        let entries = EntryTables::new(plan, tables, level.rows);
        let mut blocks = Vec::new();
        for own in row_blocks(rows.rows(), STEP, |first, end| entries.fits(first, end, range)) {
            blocks.push(add_block(plan, level, &entries, [seen, change], own)?);
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
        }
        Ok(())
    }
}

/// Adds the passes that find what shines now, and how it has changed; gives the buffer of the change.
fn add_change(
    plan: &mut Plan,
    level: &SampledRows,
    exitance: Slice<Rgb>,
) -> Result<(Slice<Rgb>, Vec<PassId>), ExecutorError> {
    let rows = level.rows.distribution();
    let options = level.settings.params(0, rows.options(), 0).options;
    let needs_change = has(options, CONTROL) || has(options, AUTO);
    let SampledRows { source, albedo, reflected: irradiance, .. } = *level;
    let push = CountParams { count: rows.columns() as u32 };
    let mut change = exitance;
    let mut passes = Vec::new();
    if needs_change {
        change = plan.array("change", rows.columns());
        let bound = ChangePass { source, albedo, irradiance, exitance, change };
        passes.push(plan.add(level.pass, &bound, &push)?);
    }
    passes.push(plan.add(level.pass, &BouncePass { source, albedo, irradiance, exitance }, &push)?);
    Ok((change, passes))
}

/// Adds the passes of some rows: samples, and sums of those that this frame refreshes.
fn add_block(
    plan: &mut Plan,
    level: &SampledRows,
    tables: &EntryTables,
    [exitance, change]: [Slice<Rgb>; 2],
    own: ops::Range<usize>,
) -> Result<Block, ExecutorError> {
    let options = level.rows.distribution().options();
    let rows = own.len() as u32;
    let first_row = own.start as u32;
    let BlockTables { first_entry, row_start, row_sums, entries } = tables.block(own.clone());
    let irradiance = level.irradiance.part(own.start, own.len());
    let sample = SampleParams { first_row, first_entry, ..level.settings.params(rows, options, 0) };
    let sum = SumParams { first_entry, ..level.settings.rows_to_sum(rows, options, 0) };
    let pass = level.pass;
    let (sample, sum) = match entries {
        Entries::Lists { columns } => {
            let samples = SampleListsPass { row_start, columns, row_sums, exitance, change, irradiance };
            let sums = SumListsPass { row_start, columns, row_sums, exitance, irradiance };
            (plan.add(pass, &samples, &sample)?, plan.add(pass, &sums, &sum)?)
        }
        Entries::Tables { slots, columns, colors } => {
            let samples =
                SampleTablesPass { row_start, slots, columns, colors, row_sums, exitance, change, irradiance };
            let sums = SumTablesPass { row_start, slots, columns, colors, row_sums, exitance, irradiance };
            (plan.add(pass, &samples, &sample)?, plan.add(pass, &sums, &sum)?)
        }
    };
    Ok(Block { sample, sum, rows, first_row, first_entry })
}

/// Tables of the entries of rows.
#[derive(Clone, Copy)]
enum Entries {
    Lists {
        /// Columns, in words of one or two.
        columns: Slice<u32>,
    },
    Tables {
        slots: Slice<u32>,
        columns: Slice<u32>,
        /// Colours, which all rows share.
        colors: Slice<u32>,
    },
}

/// Rows on the device.
struct EntryTables<'a> {
    first_entries: &'a [u32],
    row_start: Slice<u32>,
    row_sums: Slice<f32>,
    entries: Entries,
    /// Columns that a word holds.
    word_columns: usize,
}

/// What the passes of some rows bind.
struct BlockTables {
    first_entry: u32,
    row_start: Slice<u32>,
    row_sums: Slice<f32>,
    entries: Entries,
}

impl<'a> EntryTables<'a> {
    fn new(plan: &mut Plan, tables: &mut Tables, rows: &'a Rows) -> Self {
        let first_entries = rows.row_start();
        let word_columns = if has(rows.distribution().options(), NARROW) { 2 } else { 1 };
        match rows {
            Rows::Lists(lists) => Self {
                first_entries,
                row_start: tables.part(plan, "row starts", lists, |l| l.row_start()),
                row_sums: tables.part(plan, "row sums", lists, |l| l.sums()),
                entries: Entries::Lists { columns: tables.part(plan, "list columns", lists, |l| l.words()) },
                word_columns,
            },
            Rows::Tables(alias) => Self {
                first_entries,
                entries: Entries::Tables {
                    slots: tables.part(plan, "slots", alias, |t| t.slots()),
                    columns: tables.part(plan, "table columns", alias, |t| t.words()),
                    colors: tables.part(plan, "table colors", alias, |t| t.colors()),
                },
                row_start: tables.part(plan, "row starts", alias, |t| t.row_start()),
                row_sums: tables.part(plan, "row sums", alias, |t| t.sums()),
                word_columns,
            },
        }
    }

    /// First entry that a block binds, and the number of those that follow.
    fn span(&self, first: usize, end: usize) -> (usize, usize) {
        let from = self.first_entries[first] as usize / STEP * STEP;
        (from, self.first_entries[end] as usize - from)
    }

    fn fits(&self, first: usize, end: usize, range: u64) -> bool {
        let entries = self.span(first, end).1;
        let words = match self.entries {
            Entries::Lists { .. } => entries.div_ceil(self.word_columns),
            Entries::Tables { .. } => entries,
        };
        (words * size_of::<u32>()) as u64 <= range
    }

    /// Bindings of a block of rows, and its first entry.
    fn block(&self, rows: ops::Range<usize>) -> BlockTables {
        let (from, count) = self.span(rows.start, rows.end);
        let part = |table: Slice<u32>, word_entries: usize| match count {
            // Something is bound even where nothing is read.
            0 => table,
            _ => table.part(from / word_entries, count.div_ceil(word_entries)),
        };
        BlockTables {
            first_entry: from as u32,
            row_start: self.row_start.part(rows.start, rows.len() + 1),
            row_sums: self.row_sums.part(rows.start, rows.len()),
            entries: match self.entries {
                Entries::Lists { columns } => Entries::Lists { columns: part(columns, self.word_columns) },
                Entries::Tables { slots, columns, colors } => {
                    Entries::Tables { slots: part(slots, 1), columns: part(columns, self.word_columns), colors }
                }
            },
        }
    }
}
