//! Rows of receivers and facets on the device, in blocks that fit into a binding.

use bytemuck::cast_slice;
use formfactor::kernel::hits::WORD_COUNTS;
use formfactor::{HitRows, HitsParams, Operator as _};
use glam::Vec4;
use gpu_kernels::table;

use super::{Uploads, pass, row_blocks};
use runtime::executor::ExecutorError;
use runtime::plan::{BufferId, Plan, Range};

/// Where rows of hits are on the device.
#[derive(Clone, Copy)]
pub(super) struct HitTables {
    row_start: BufferId,
    quads: BufferId,
    counts: BufferId,
    scales: BufferId,
}

/// Blocks of rows begin at multiples of this, and their quads too: ranges of a buffer begin at multiples of 256 bytes.
const BLOCK_STEP: usize = 256;

/// Some of the receivers' rows, and what a pass over them binds.
#[derive(Debug)]
pub(super) struct RowBlock {
    pub rows: std::ops::Range<usize>,
    pub tables: [(&'static str, Range); 4],
    pub first_quad: u32,
}

impl HitTables {
    pub fn new<'a>(plan: &mut Plan, uploads: &mut Uploads<'a>, hits: &'a HitRows) -> Self {
        Self {
            row_start: uploads.table(plan, "row starts", cast_slice(hits.row_start())).buffer,
            quads: uploads.table(plan, "quads", cast_slice(hits.quads())).buffer,
            counts: uploads.table(plan, "counts", cast_slice(&hits.count_words()).to_vec()).buffer,
            scales: uploads.table(plan, "scales", cast_slice(hits.scales())).buffer,
        }
    }

    /// Adds the passes of a lookup that gathers irradiance from exitance by these rows.
    pub fn gather(
        &self,
        plan: &mut Plan,
        hits: &HitRows,
        range: u64,
        exitance: BufferId,
        irradiance: BufferId,
    ) -> Result<(), ExecutorError> {
        let rgb = |n: usize| (n * size_of::<Vec4>()) as u64;
        for RowBlock { rows, tables, first_quad } in self.blocks(hits, range) {
            let light = irradiance.range(rgb(rows.start), rgb(rows.len()));
            let light = [("exitance", Range::from(exitance)), ("irradiance", light)];
            let push = HitsParams { rows: rows.len() as u32, first_quad };
            pass(plan, "lookup", &table::FORMFACTOR_GATHER_HITS, &light, &tables, &push, push.rows)?;
        }
        Ok(())
    }

    /// Blocks of rows whose quads fit into one binding.
    fn blocks(&self, hits: &HitRows, range: u64) -> Vec<RowBlock> {
        let (starts, count) = (hits.row_start(), hits.rows());
        let quad_bytes = size_of_val(hits.quads()) as u64 / hits.quads().len().max(1) as u64;
        let most = (range / quad_bytes.max(1)).saturating_sub(BLOCK_STEP as u64);
        let fits = |first: usize, end: usize| u64::from(starts[end] - starts[first]) <= most;
        let block = |rows: std::ops::Range<usize>| {
            let quad = starts[rows.start] as usize / BLOCK_STEP * BLOCK_STEP;
            let quads = starts[rows.end] as usize - quad;
            let part = |buffer: BufferId, from: usize, to: usize, bytes: u64| {
                buffer.range(from as u64 * bytes, (to - from) as u64 * bytes)
            };
            let words = (quads as u64).div_ceil(u64::from(WORD_COUNTS));
            let tables = [
                ("row_start", part(self.row_start, rows.start, rows.end + 1, 4)),
                ("quads", part(self.quads, quad, quad + quads, quad_bytes)),
                ("counts", self.counts.range(quad as u64, 4 * words)),
                ("scales", part(self.scales, rows.start, rows.end, 4)),
            ];
            RowBlock { rows, tables, first_quad: quad as u32 }
        };
        row_blocks(count, BLOCK_STEP, fits).into_iter().map(block).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use runtime::plan::Plan;

    #[test]
    fn blocks_hold_every_row_once_and_fit_into_a_binding() {
        // 3,000 rows of 40 hits in different columns: 10 quads of 8 bytes each.
        let mut hits = HitRows::new(1000).unwrap();
        let columns: Vec<u32> = (0..3000 * 40).map(|k| k * 7 % 1000).collect();
        hits.push(&columns, &[0.025; 3000]).unwrap();
        let mut plan = Plan::new();
        let mut room = |name: &str| plan.storage(name, 1 << 24);
        let tables = HitTables {
            row_start: room("starts"),
            quads: room("quads"),
            counts: room("counts"),
            scales: room("scales"),
        };
        // 100,000 bytes are 12,500 quads: four steps of 256 rows, and not five.
        for (range, expected) in [(u64::MAX, 1), (100_000, 3), (1, 12)] {
            let blocks = tables.blocks(&hits, range);
            assert_eq!(blocks.len(), expected, "{range}");
            let mut next = 0;
            for RowBlock { rows, tables, first_quad } in blocks {
                assert_eq!(rows.start, next);
                next = rows.end;
                let quads = hits.row_start()[rows.end] - first_quad;
                assert!(hits.row_start()[rows.start] >= first_quad && first_quad % 256 == 0);
                let (offset, bytes) = (tables[1].1.offset, tables[1].1.bytes);
                assert_eq!((offset, bytes), (8 * u64::from(first_quad), Some(8 * u64::from(quads))));
                assert!(range < 1000 || bytes <= Some(range), "{range}: {bytes:?}");
                assert_eq!(tables[2].1.bytes, Some(u64::from(quads.div_ceil(4) * 4)));
            }
            assert_eq!(next, 3000);
        }
    }
}
