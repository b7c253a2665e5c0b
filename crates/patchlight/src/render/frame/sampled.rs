//! Light that is sampled and stays from frame to frame, on the device.

use bytemuck::cast_slice;
use glam::Vec4;
use gpu_kernels::params::CountParams;
use gpu_kernels::table::{self, Kernel};
use temporal::kernel::sample::{AUTO, CONTROL, NARROW, has};
use temporal::{SampleParams, Settings, SumParams};

use super::super::temporal::Rows;
use super::{Uploads, pass, row_blocks};
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{BufferId, PassId, Plan, Range};

/// Rows begin at multiples of this, and entries: ranges of a buffer begin at multiples of 256 bytes.
const STEP: usize = 256;
/// Frames that light which has settled counts for.
const SETTLED: f32 = (1 << 20) as f32;

/// Rows of one kind that frames sample: what goes in, and what stays.
pub(super) struct Level<'a> {
    pub name: &'static str,
    pub rows: &'a Rows,
    pub settings: Settings,
    /// What shines is `source + albedo∘reflected`, one for each column.
    pub source: Range,
    pub albedo: Range,
    pub reflected: Range,
    /// What is sampled for, one for each row.
    pub irradiance: BufferId,
}

/// The passes of a [`Level`].
pub(super) struct LevelPasses {
    settings: Settings,
    options: u32,
    /// What has changed, and what shines now.
    pub change: Vec<PassId>,
    blocks: Vec<Block>,
    /// What a block's rows shine with when the first frame begins.
    start: Vec<(BufferId, usize)>,
}

/// Rows that one binding shows.
struct Block {
    sample: PassId,
    sum: PassId,
    rows: u32,
    first_row: u32,
    first_entry: u32,
}

impl LevelPasses {
    /// Adds the passes of a frame: changes, samples, and exact sums of the rows whose turn it is.
    pub fn new<'a>(
        plan: &mut Plan,
        uploads: &mut Uploads<'a>,
        level: &Level<'a>,
        range: u64,
    ) -> Result<Self, ExecutorError> {
        let rows = level.rows.distribution();
        let (count, columns) = (rows.rows(), rows.columns());
        let settings = level.settings;
        let rgb = |n: usize| (n * size_of::<Vec4>()) as u64;
        let seen = plan.storage("seen", rgb(columns));
        let options = settings.params(0, rows.options(), 0).options;
        let needs_change = has(options, CONTROL) || has(options, AUTO);
        let change = if needs_change { plan.storage("change", rgb(columns)) } else { seen };
        let own = [
            ("source", level.source),
            ("albedo", level.albedo),
            ("irradiance", level.reflected),
            ("exitance", Range::from(seen)),
            ("change", Range::from(change)),
        ];
        let push = CountParams { count: columns as u32 };
        let mut first = Vec::new();
        if needs_change {
            first.push(pass(plan, level.name, &table::TEMPORAL_CHANGE, &own, &[], &push, push.count)?);
        }
        first.push(pass(plan, level.name, &table::FORMFACTOR_BOUNCE, &own, &[], &push, push.count)?);

        let tables = EntryTables::new(plan, uploads, level.rows);
        let light = [("exitance", Range::from(seen)), ("change", Range::from(change))];
        let mut blocks = Vec::new();
        for own in row_blocks(count, STEP, |first, end| tables.fits(first, end, range)) {
            let (mut bound, first_entry) = tables.block(own.clone());
            bound.push(("irradiance", level.irradiance.range(rgb(own.start), rgb(own.len()))));
            let (block_rows, first_row) = (own.len() as u32, own.start as u32);
            let sample = SampleParams { first_row, first_entry, ..settings.params(block_rows, rows.options(), 0) };
            let sum = SumParams { first_entry, ..settings.turn(block_rows, rows.options(), 0) };
            let sample = pass(plan, level.name, tables.kernels[0], &bound, &light, &sample, block_rows)?;
            let sum = pass(plan, level.name, tables.kernels[1], &bound, &light, &sum, sum.count)?;
            blocks.push(Block { sample, sum, rows: block_rows, first_row, first_entry });
        }
        let start = vec![(seen, columns), (level.irradiance, count)];
        Ok(Self { settings, options: rows.options(), change: first, blocks, start })
    }

    /// The dark, before the first frame.
    pub fn clear(&self, executor: &mut dyn Executor) -> Result<(), ExecutorError> {
        for (buffer, count) in &self.start {
            executor.upload(*buffer, &vec![Vec4::new(0.0, 0.0, 0.0, SETTLED); *count])?;
        }
        Ok(())
    }

    /// Exact sums of all rows.
    pub fn settle(&self, executor: &mut dyn Executor) -> Result<(), ExecutorError> {
        executor.run_passes(&self.change)?;
        for block in &self.blocks {
            let Block { sum, rows, first_entry, .. } = *block;
            executor.push(sum, &SumParams { count: rows, rows, first: 0, first_entry, options: self.options })?;
            executor.set_elements(sum, rows)?;
            executor.run_passes(&[sum])?;
        }
        Ok(())
    }

    /// Samples of another frame.
    pub fn set_frame(&self, executor: &mut dyn Executor, frame: u32) -> Result<(), ExecutorError> {
        for block in &self.blocks {
            let Block { sample, sum, rows, first_row, first_entry } = *block;
            let params = self.settings.params(rows, self.options, frame);
            executor.push(sample, &SampleParams { first_row, first_entry, ..params })?;
            let turn = self.settings.turn(rows, self.options, frame);
            executor.push(sum, &SumParams { first_entry, ..turn })?;
            executor.set_elements(sum, turn.count)?;
        }
        Ok(())
    }
}

/// Where rows are on the device.
struct EntryTables<'a> {
    row_start: &'a [u32],
    starts: BufferId,
    sums: BufferId,
    /// With the bytes of an entry.
    entries: Vec<(&'static str, BufferId, u64)>,
    kernels: [&'static Kernel; 2],
}

impl<'a> EntryTables<'a> {
    fn new(plan: &mut Plan, uploads: &mut Uploads<'a>, rows: &'a Rows) -> Self {
        let column_bytes = if has(rows.distribution().options(), NARROW) { 2 } else { 4 };
        let mut table = |name, words: &'a [u32]| uploads.table(plan, name, cast_slice(words)).buffer;
        let starts = table("row starts", rows.row_start());
        let (entries, sums, kernels) = match rows {
            Rows::Lists(lists) => (
                vec![("columns", table("list columns", lists.words()), column_bytes)],
                lists.sums(),
                [&table::TEMPORAL_SAMPLE_LISTS, &table::TEMPORAL_SUM_LISTS],
            ),
            Rows::Tables(tables) => (
                vec![
                    ("slots", table("slots", tables.slots()), 4),
                    ("columns", table("table columns", tables.words()), column_bytes),
                    ("colors", table("table colors", tables.colors()), 0),
                ],
                tables.sums(),
                [&table::TEMPORAL_SAMPLE_TABLES, &table::TEMPORAL_SUM_TABLES],
            ),
        };
        let sums = uploads.table(plan, "row sums", cast_slice(sums)).buffer;
        Self { row_start: rows.row_start(), starts, sums, entries, kernels }
    }

    /// First entry that a block binds, and the number of those that follow.
    fn span(&self, first: usize, end: usize) -> (u64, u64) {
        let from = self.row_start[first] as usize / STEP * STEP;
        (from as u64, (self.row_start[end] as usize - from) as u64)
    }

    fn fits(&self, first: usize, end: usize, range: u64) -> bool {
        let entries = self.span(first, end).1;
        self.entries.iter().all(|(_, _, bytes)| (entries * bytes).next_multiple_of(4) <= range)
    }

    fn block(&self, rows: std::ops::Range<usize>) -> (Vec<(&'static str, Range)>, u32) {
        let (from, count) = self.span(rows.start, rows.end);
        let part = |buffer: BufferId, bytes: u64| match (bytes, count) {
            // Something is bound even where nothing is read.
            (0, _) | (_, 0) => Range::from(buffer),
            _ => buffer.range(from * bytes, (count * bytes).next_multiple_of(4)),
        };
        let mut bound: Vec<(&'static str, Range)> =
            self.entries.iter().map(|&(name, buffer, bytes)| (name, part(buffer, bytes))).collect();
        bound.push(("row_start", self.starts.range(4 * rows.start as u64, 4 * (rows.len() + 1) as u64)));
        bound.push(("row_sums", self.sums.range(4 * rows.start as u64, 4 * rows.len() as u64)));
        (bound, from as u32)
    }
}
