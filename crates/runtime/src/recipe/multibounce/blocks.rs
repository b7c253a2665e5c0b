//! Operators in texture blocks, with their greatest entries beside them.

use std::ops;
use std::sync::Arc;

use bytemuck::cast_slice;
use glam::{UVec2, UVec4, Vec4};
use gpu_kernels::table::{self, ImageFormat, Kernel};
use multibounce::kernel::blocks::{BLOCK, NO_ELEMENT};
use multibounce::{BlockCodec, BlockMatrix, BlockParams};

use super::reorder;
use crate::executor::ExecutorError;
use crate::plan::{BufferId, Plan, RANGE_ALIGNMENT, Range};
use crate::recipe::{Named, Table, Tables, add_pass, rgb_bytes, row_blocks, row_step};

/// Decoder of texture blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decoder {
    /// The texture unit, from images of at most so many texels along their edges.
    Texture {
        /// Greatest width and height.
        edge: u32,
    },
    /// The kernel, from buffers.
    Kernel,
}

/// An operator in texture blocks on the device.
#[derive(Clone, Debug)]
pub struct BlockTables {
    matrix: Arc<BlockMatrix>,
    kernel: &'static Kernel,
    /// Patch at each permuted index of the blocks, with factors of 1.
    order: [Range; 2],
    /// Permuted index of each patch, with the scale of its row.
    permuted_index: [Range; 2],
    parts: Vec<Part>,
    tables: [Named; 2],
    ordered: BufferId,
    sums: BufferId,
}

/// Some of the rows of blocks, and what a pass over them binds.
#[derive(Clone, Debug)]
struct Part {
    rows: ops::Range<usize>,
    words: Range,
    outliers: Range,
    first_outlier: u32,
}

/// Words of some rows of blocks: the contents of an image.
struct BlockRows {
    matrix: Arc<BlockMatrix>,
    bytes: ops::Range<usize>,
}

impl Table for BlockRows {
    fn bytes(&self) -> &[u8] {
        &cast_slice::<u32, u8>(self.matrix.words())[self.bytes.clone()]
    }
}

impl BlockTables {
    /// Puts the operator on the device; a binding shows at most `range` bytes.
    pub fn new(plan: &mut Plan, tables: &mut Tables, matrix: &Arc<BlockMatrix>, range: u64, decoder: Decoder) -> Self {
        let padded_rows = matrix.block_count() * BLOCK as usize;
        let mut order = matrix.permutation().order().to_vec();
        order.resize(padded_rows, NO_ELEMENT);
        Self {
            matrix: Arc::clone(matrix),
            kernel: kernel(decoder, matrix.settings().codec),
            order: [tables.owned(plan, "block order", order), tables.owned(plan, "ones", vec![Vec4::ONE; padded_rows])],
            permuted_index: [
                tables.part(plan, "block indices", matrix, |m| m.permutation().place()),
                tables.part(plan, "row scales", matrix, |m| m.row_scales()),
            ],
            parts: Parts::new(matrix, range, decoder).add(plan, tables),
            tables: [
                tables.named_part(plan, "tile_scales", matrix, |m| m.scales()),
                tables.named_part(plan, "row_start", matrix, |m| &m.outliers().start),
            ],
            ordered: plan.storage("ordered", rgb_bytes(padded_rows)),
            sums: plan.storage("rows", rgb_bytes(padded_rows)),
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
        let padded_rows = (self.matrix.block_count() * BLOCK as usize) as u32;
        reorder(plan, pass, self.order[0], self.order[1], exitance, self.ordered, padded_rows)?;
        for part in &self.parts {
            let own = [
                ("blocks", part.words),
                ("outliers", part.outliers),
                ("exitance", self.ordered.into()),
                ("irradiance", self.sums.into()),
            ];
            let params = self.matrix.params(part.rows.start as u32, part.rows.len() as u32);
            let push = BlockParams { first_outlier: part.first_outlier, ..params };
            add_pass(plan, pass, self.kernel, &own, &self.tables, &push, push.block_rows)?;
        }
        let patches = self.matrix.len() as u32;
        reorder(plan, pass, self.permuted_index[0], self.permuted_index[1], self.sums, irradiance, patches)?;
        Ok(())
    }
}

fn kernel(decoder: Decoder, codec: BlockCodec) -> &'static Kernel {
    match (decoder, codec) {
        (Decoder::Texture { .. }, _) => &table::MULTIBOUNCE_BLOCKS_GATHER_IMAGE,
        (_, BlockCodec::Bc1) => &table::MULTIBOUNCE_BLOCKS_GATHER_BC1,
        (_, BlockCodec::Bc3) => &table::MULTIBOUNCE_BLOCKS_GATHER_BC3,
        (_, BlockCodec::Bc6h) => &table::MULTIBOUNCE_BLOCKS_GATHER_BC6H,
        (_, BlockCodec::Bc7) => &table::MULTIBOUNCE_BLOCKS_GATHER_BC7,
    }
}

/// Image format of a codec, and bytes of a block.
fn format(codec: BlockCodec) -> (ImageFormat, usize) {
    match codec {
        BlockCodec::Bc1 => (ImageFormat::Bc1Rgb, size_of::<UVec2>()),
        BlockCodec::Bc3 => (ImageFormat::Bc3, size_of::<UVec4>()),
        BlockCodec::Bc6h => (ImageFormat::Bc6hUfloat, size_of::<UVec4>()),
        BlockCodec::Bc7 => (ImageFormat::Bc7, size_of::<UVec4>()),
    }
}

/// Bytes of an outlier.
const OUTLIER_BYTES: u64 = size_of::<UVec2>() as u64;

/// Cuts an operator into rows of blocks whose blocks and outliers fit into one binding each, or into one image.
struct Parts<'a> {
    matrix: &'a Arc<BlockMatrix>,
    decoder: Decoder,
    format: ImageFormat,
    row_bytes: usize,
    range: u64,
}

/// Outliers of some rows of blocks.
struct OutlierSpan {
    first: u64,
    /// The last index before the first at which a range of a buffer may begin.
    aligned: u64,
    end: u64,
}

impl<'a> Parts<'a> {
    fn new(matrix: &'a Arc<BlockMatrix>, range: u64, decoder: Decoder) -> Self {
        let (format, block_bytes) = format(matrix.settings().codec);
        Self { matrix, decoder, format, row_bytes: matrix.block_count() * block_bytes, range }
    }

    fn add(&self, plan: &mut Plan, tables: &mut Tables) -> Vec<Part> {
        let outliers = tables.part(plan, "outliers", self.matrix, |m| &m.outliers().entries).buffer;
        let whole = match self.decoder {
            Decoder::Texture { .. } => None,
            Decoder::Kernel => Some(tables.part(plan, "blocks", self.matrix, |m| m.words()).buffer),
        };
        let mut parts = Vec::new();
        for rows in self.rows() {
            let words = match whole {
                Some(whole) => whole.range((rows.start * self.row_bytes) as u64, (rows.len() * self.row_bytes) as u64),
                None => self.image(plan, tables, &rows),
            };
            let span = self.outliers(rows.start, rows.end);
            // Rows without outliers read none; something is bound nevertheless.
            let (bound, first_outlier) = match span.first == span.end {
                true => (outliers.range(0, OUTLIER_BYTES), span.first),
                false => {
                    let bytes = (span.end - span.aligned) * OUTLIER_BYTES;
                    (outliers.range(span.aligned * OUTLIER_BYTES, bytes), span.aligned)
                }
            };
            parts.push(Part { rows, words, outliers: bound, first_outlier: first_outlier as u32 });
        }
        parts
    }

    fn rows(&self) -> Vec<ops::Range<usize>> {
        let (step, most_rows, most_bytes) = match self.decoder {
            Decoder::Texture { edge } => (1, (edge / BLOCK) as usize, u64::MAX),
            Decoder::Kernel => (row_step(self.row_bytes as u64), usize::MAX, self.range),
        };
        let fits = |first: usize, end: usize| {
            let span = self.outliers(first, end);
            let is_short = end - first <= most_rows && ((end - first) * self.row_bytes) as u64 <= most_bytes;
            is_short && (span.end - span.aligned) * OUTLIER_BYTES <= self.range
        };
        row_blocks(self.matrix.block_count(), step, fits)
    }

    fn outliers(&self, first_row: usize, end_row: usize) -> OutlierSpan {
        let start = &self.matrix.outliers().start;
        let at = |row: usize| u64::from(start[(row * BLOCK as usize).min(self.matrix.len())]);
        let step = RANGE_ALIGNMENT / OUTLIER_BYTES;
        OutlierSpan { first: at(first_row), aligned: at(first_row) / step * step, end: at(end_row) }
    }

    /// An image of some rows of blocks.
    fn image(&self, plan: &mut Plan, tables: &mut Tables, rows: &ops::Range<usize>) -> Range {
        let width = self.matrix.block_count() as u32 * BLOCK;
        let height = rows.len() as u32 * BLOCK;
        let image = plan.image("blocks", self.format, width, height);
        let bytes = rows.start * self.row_bytes..rows.end * self.row_bytes;
        tables.fill(image, Arc::new(BlockRows { matrix: Arc::clone(self.matrix), bytes }));
        image.into()
    }
}
