//! Operators in texture blocks, with their greatest entries beside them.

use std::ops;
use std::sync::Arc;

use bytemuck::cast_slice;
use glam::{UVec2, UVec4, Vec4};
use gpu_kernels::multibounce::{
    BlocksGatherBc1Pass, BlocksGatherBc3Pass, BlocksGatherBc6hPass, BlocksGatherBc7Pass, BlocksGatherImagePass,
};
use gpu_kernels::table::ImageFormat;
use multibounce::kernel::blocks::{BLOCK, NO_ELEMENT};
use multibounce::{BlockCodec, BlockMatrix, BlockParams};
use scene::Rgb;

use super::Order;
use crate::executor::ExecutorError;
use crate::plan::{BufferId, PassId, Plan, RANGE_ALIGNMENT, Slice};
use crate::recipe::{Table, Tables, row_blocks, row_step};

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
    /// Patch at each permuted index of the blocks, with factors of 1.
    order: Order,
    /// Permuted index of each patch, with the scale of its row.
    permuted_index: Order,
    parts: Vec<Part>,
    tile_scales: Slice<Vec4>,
    row_start: Slice<u32>,
    ordered: Slice<Rgb>,
    sums: Slice<Rgb>,
}

/// Some of the rows of blocks, and what a pass over them binds.
#[derive(Clone, Debug)]
struct Part {
    rows: ops::Range<usize>,
    blocks: Blocks,
    outliers: Slice<UVec2>,
    first_outlier: u32,
}

/// Blocks of some rows, by their decoder and codec.
#[derive(Clone, Copy, Debug)]
enum Blocks {
    Image(BufferId),
    Bc1(Slice<UVec2>),
    Bc3(Slice<UVec4>),
    Bc6h(Slice<UVec4>),
    Bc7(Slice<UVec4>),
}

impl Blocks {
    /// So many blocks of a buffer from number `first` on.
    fn part(codec: BlockCodec, buffer: BufferId, first: usize, count: usize) -> Self {
        match codec {
            BlockCodec::Bc1 => Self::Bc1(buffer.of().part(first, count)),
            BlockCodec::Bc3 => Self::Bc3(buffer.of().part(first, count)),
            BlockCodec::Bc6h => Self::Bc6h(buffer.of().part(first, count)),
            BlockCodec::Bc7 => Self::Bc7(buffer.of().part(first, count)),
        }
    }
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
        let order = tables.owned(plan, "block order", order);
        let ones = tables.owned(plan, "ones", vec![Vec4::ONE; padded_rows]);
        let indices = tables.part(plan, "block indices", matrix, |m| m.permutation().place());
        let row_scales = tables.part(plan, "row scales", matrix, |m| m.row_scales());
        Self {
            matrix: Arc::clone(matrix),
            order: Order::new(order, ones, padded_rows),
            permuted_index: Order::new(indices, row_scales, matrix.len()),
            parts: Parts::new(matrix, range, decoder).add(plan, tables),
            tile_scales: tables.part(plan, "tile_scales", matrix, |m| m.scales()),
            row_start: tables.part(plan, "row_start", matrix, |m| &m.outliers().start),
            ordered: plan.array("ordered", padded_rows),
            sums: plan.array("rows", padded_rows),
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
        self.order.add(plan, pass, exitance, self.ordered)?;
        for part in &self.parts {
            self.add_part(plan, pass, part)?;
        }
        self.permuted_index.add(plan, pass, self.sums, irradiance)?;
        Ok(())
    }

    /// Adds the pass of some rows of blocks.
    fn add_part(&self, plan: &mut Plan, pass: &str, part: &Part) -> Result<PassId, ExecutorError> {
        let params = self.matrix.params(part.rows.start as u32, part.rows.len() as u32);
        let push = BlockParams { first_outlier: part.first_outlier, ..params };
        let Self { tile_scales, row_start, ordered: exitance, sums: irradiance, .. } = *self;
        let outliers = part.outliers;
        Ok(match part.blocks {
            Blocks::Image(blocks) => {
                let bound = BlocksGatherImagePass { blocks, tile_scales, row_start, outliers, exitance, irradiance };
                plan.add(pass, &bound, &push)?
            }
            Blocks::Bc1(blocks) => {
                let bound = BlocksGatherBc1Pass { blocks, tile_scales, row_start, outliers, exitance, irradiance };
                plan.add(pass, &bound, &push)?
            }
            Blocks::Bc3(blocks) => {
                let bound = BlocksGatherBc3Pass { blocks, tile_scales, row_start, outliers, exitance, irradiance };
                plan.add(pass, &bound, &push)?
            }
            Blocks::Bc6h(blocks) => {
                let bound = BlocksGatherBc6hPass { blocks, tile_scales, row_start, outliers, exitance, irradiance };
                plan.add(pass, &bound, &push)?
            }
            Blocks::Bc7(blocks) => {
                let bound = BlocksGatherBc7Pass { blocks, tile_scales, row_start, outliers, exitance, irradiance };
                plan.add(pass, &bound, &push)?
            }
        })
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
        let outliers = tables.part(plan, "outliers", self.matrix, |m| &m.outliers().entries);
        let whole = match self.decoder {
            Decoder::Texture { .. } => None,
            Decoder::Kernel => Some(tables.part(plan, "blocks", self.matrix, |m| m.words()).buffer),
        };
        let columns = self.matrix.block_count();
        let codec = self.matrix.settings().codec;
        let mut parts = Vec::new();
        for rows in self.rows() {
            let blocks = match whole {
                Some(whole) => Blocks::part(codec, whole, rows.start * columns, rows.len() * columns),
                None => Blocks::Image(self.image(plan, tables, &rows)),
            };
            let span = self.outliers(rows.start, rows.end);
            // Rows without outliers read none; something is bound nevertheless.
            let (bound, first_outlier) = match span.first == span.end {
                true => (outliers.part(0, 1), span.first),
                false => (outliers.part(span.aligned as usize, (span.end - span.aligned) as usize), span.aligned),
            };
            parts.push(Part { rows, blocks, outliers: bound, first_outlier: first_outlier as u32 });
        }
        parts
    }

    fn rows(&self) -> Vec<ops::Range<usize>> {
        let (step, most_rows, most_bytes) = match self.decoder {
            Decoder::Texture { edge } => (1, (edge / BLOCK) as usize, u64::MAX),
            Decoder::Kernel => (row_step(self.row_bytes as u64), usize::MAX, self.range),
        };
        row_blocks(self.matrix.block_count(), step, |first, end| {
            let span = self.outliers(first, end);
            let is_short = end - first <= most_rows && ((end - first) * self.row_bytes) as u64 <= most_bytes;
            is_short && (span.end - span.aligned) * OUTLIER_BYTES <= self.range
        })
    }

    fn outliers(&self, first_row: usize, end_row: usize) -> OutlierSpan {
        let start = &self.matrix.outliers().start;
        let at = |row: usize| u64::from(start[(row * BLOCK as usize).min(self.matrix.len())]);
        let step = RANGE_ALIGNMENT / OUTLIER_BYTES;
        OutlierSpan { first: at(first_row), aligned: at(first_row) / step * step, end: at(end_row) }
    }

    /// An image of some rows of blocks.
    fn image(&self, plan: &mut Plan, tables: &mut Tables, rows: &ops::Range<usize>) -> BufferId {
        let width = self.matrix.block_count() as u32 * BLOCK;
        let height = rows.len() as u32 * BLOCK;
        let image = plan.image("blocks", self.format, width, height);
        let bytes = rows.start * self.row_bytes..rows.end * self.row_bytes;
        tables.fill(image, Arc::new(BlockRows { matrix: Arc::clone(self.matrix), bytes }));
        image
    }
}
