//! Operators on the device, and the passes of their products.

use bytemuck::cast_slice;
use formfactor::GatherParams;
use glam::{UVec2, UVec4, Vec4};
use gpu_kernels::params::{CountParams, EnterParams, ProjectParams};
use gpu_kernels::table::{self, ImageFormat, Kernel};
use multibounce::kernel::blocks::{BLOCK, NO_ELEMENT};
use multibounce::kernel::tiles::{FACTOR_WORDS, LIGHT_WORDS, PAIRS, PLACES, QUAD, QUARTERS, RUN_PARTS, SPLITS, TILE};
use multibounce::{BlockCodec, BlockMatrix, BlockParams, ColumnVectors, ExpandTables, LowRank, NearTables};
use transport::LinearOperator;

use super::super::decode::{Decode, Decoder};
use super::super::operator::{PatchOperator, apart};
use super::{RANGE_ALIGNMENT, Uploads, pass, row_blocks};
use crate::error::Error;
use crate::executor::{Executor, ExecutorError};
use crate::plan::{BufferId, Plan, Range};

/// An operator's tables on the device, and what a product keeps between its passes.
pub(super) enum OperatorTables<'a> {
    Dense(DenseTables),
    Blocks(BlockTables<'a>),
    Tiles(TileTables),
}

impl<'a> OperatorTables<'a> {
    /// A binding shows at most `range` bytes; `decoder` is for texture blocks.
    pub fn new(
        plan: &mut Plan,
        uploads: &mut Uploads<'a>,
        operator: &'a PatchOperator,
        range: u64,
        decoder: Decoder,
    ) -> Self {
        match operator {
            PatchOperator::Dense(dense) => {
                let (words, kernel) = (cast_slice(&dense.values), &table::FORMFACTOR_GATHER);
                Self::Dense(DenseTables::new(plan, uploads, dense.rows, words, kernel))
            }
            PatchOperator::Half(half) => {
                let (words, kernel) = (cast_slice(&half.words), &table::FORMFACTOR_GATHER_HALF);
                Self::Dense(DenseTables::new(plan, uploads, half.rows, words, kernel))
            }
            PatchOperator::Blocks(matrix) => Self::Blocks(BlockTables::new(plan, uploads, matrix, range, decoder)),
            PatchOperator::Tiles(tiles) => Self::Tiles(TileTables::new(plan, uploads, tiles)),
        }
    }

    /// The passes of `irradiance = T exitance`; a binding shows at most `range` bytes.
    pub fn product(
        &self,
        plan: &mut Plan,
        range: u64,
        exitance: BufferId,
        irradiance: BufferId,
    ) -> Result<(), ExecutorError> {
        match self {
            Self::Dense(dense) => dense.product(plan, range, exitance, irradiance),
            Self::Blocks(blocks) => blocks.product(plan, exitance, irradiance),
            Self::Tiles(tiles) => tiles.product(plan, exitance, irradiance),
        }
    }
}

/// What decodes an operator's blocks on a device; `None` for one that has none.
pub(crate) fn decoder(
    decode: Decode,
    executor: &dyn Executor,
    operator: Option<&PatchOperator>,
) -> Result<Option<Decoder>, Error> {
    match operator {
        Some(PatchOperator::Blocks(matrix)) => Ok(Some(decode.on(executor.device(), matrix)?)),
        _ => Ok(None),
    }
}

/// Loads the product with an operator alone: where its exitance and its irradiance are.
fn load_product(
    executor: &mut dyn Executor,
    operator: &PatchOperator,
    range: u64,
    decoder: Decoder,
) -> Result<[BufferId; 2], ExecutorError> {
    let (mut plan, mut uploads) = (Plan::new(), Uploads::default());
    let tables = OperatorTables::new(&mut plan, &mut uploads, operator, range, decoder);
    let [exitance, irradiance] = ["exitance", "irradiance"].map(|name| plan.storage(name, rgb(operator.patches())));
    tables.product(&mut plan, range, exitance, irradiance)?;
    executor.load(plan)?;
    for (buffer, bytes) in uploads.0 {
        executor.upload_at(buffer, 0, &bytes)?;
    }
    Ok([exitance, irradiance])
}

/// Irradiance by an operator on a device, W/m², and the median of the times of so many products, ms.
pub(crate) fn product_on_device(
    executor: &mut dyn Executor,
    operator: &PatchOperator,
    light: &[Vec4],
    turns: usize,
) -> Result<(Vec<Vec4>, f64), ExecutorError> {
    product_decoded(executor, operator, light, turns, Decoder::Kernel)
}

/// The same with a decoder of texture blocks.
pub(crate) fn product_decoded(
    executor: &mut dyn Executor,
    operator: &PatchOperator,
    light: &[Vec4],
    turns: usize,
    decoder: Decoder,
) -> Result<(Vec<Vec4>, f64), ExecutorError> {
    let range = executor.device().max_storage_buffer_range;
    let buffers = load_product(executor, operator, range, decoder)?;
    time_product(executor, buffers, light, turns)
}

/// Of the product that is loaded, where its exitance and its irradiance are.
fn time_product(
    executor: &mut dyn Executor,
    [exitance, irradiance]: [BufferId; 2],
    light: &[Vec4],
    turns: usize,
) -> Result<(Vec<Vec4>, f64), ExecutorError> {
    executor.upload(exitance, light)?;
    let mut times = Vec::with_capacity(turns);
    for _ in 0..turns.max(1) {
        times.push(executor.run()?.iter().map(|pass| pass.milliseconds).sum::<f64>());
    }
    times.sort_by(f64::total_cmp);
    Ok((executor.download_table(irradiance)?, times[times.len() / 2]))
}

fn rgb(n: usize) -> u64 {
    (n * size_of::<Vec4>()) as u64
}

/// Rows that begin at bytes at which ranges may begin are so many apart.
fn row_step(row_bytes: u64) -> usize {
    (RANGE_ALIGNMENT >> row_bytes.trailing_zeros().min(RANGE_ALIGNMENT.trailing_zeros())) as usize
}

/// Entries one by one, whole or half, channels apart.
pub(super) struct DenseTables {
    kernel: &'static Kernel,
    /// Brings the channels apart.
    order: Range,
    scale: Range,
    light: BufferId,
    factors: BufferId,
    rows: usize,
    columns: usize,
    row_bytes: u64,
}

impl DenseTables {
    fn new<'a>(
        plan: &mut Plan,
        uploads: &mut Uploads<'a>,
        rows: usize,
        words: &'a [u8],
        kernel: &'static Kernel,
    ) -> Self {
        let order: Vec<u32> = apart(rows).map(|at| at.map_or(NO_ELEMENT, |(j, _)| j as u32)).collect();
        let scale: Vec<Vec4> = apart(rows).map(|at| at.map_or(Vec4::ZERO, |(_, c)| Vec4::AXES[c])).collect();
        Self {
            kernel,
            order: uploads.table(plan, "channel order", cast_slice(&order).to_vec()),
            scale: uploads.table(plan, "channel scale", cast_slice(&scale).to_vec()),
            light: plan.storage("channels", rgb(order.len())),
            factors: uploads.table(plan, "operator", words).buffer,
            rows,
            columns: order.len(),
            row_bytes: (words.len() / rows.max(1)) as u64,
        }
    }

    fn product(
        &self,
        plan: &mut Plan,
        range: u64,
        exitance: BufferId,
        irradiance: BufferId,
    ) -> Result<(), ExecutorError> {
        let own =
            [("order", self.order), ("scale", self.scale), ("input", exitance.into()), ("output", self.light.into())];
        let count = CountParams { count: self.columns as u32 };
        pass(plan, "method", &table::MULTIBOUNCE_REORDER, &own, &[], &count, count.count)?;
        let fits = |first: usize, end: usize| (end - first) as u64 * self.row_bytes <= range;
        for rows in row_blocks(self.rows, row_step(self.row_bytes), fits) {
            let part = self.factors.range(rows.start as u64 * self.row_bytes, rows.len() as u64 * self.row_bytes);
            let own = [("factors", part), ("exitance", self.light.into()), ("irradiance", irradiance.into())];
            let push = GatherParams {
                rows: rows.len() as u32,
                vectors: self.columns as u32 / 4,
                first_row: rows.start as u32,
                reserved: 0,
            };
            pass(plan, "method", self.kernel, &own, &[], &push, push.rows)?;
        }
        Ok(())
    }
}

/// Texture blocks and outliers.
pub(super) struct BlockTables<'a> {
    matrix: &'a BlockMatrix,
    kernel: &'static Kernel,
    /// Patch at each place of the blocks, and place of each patch with the scale of its row.
    order: [Range; 2],
    place: [Range; 2],
    parts: Vec<Part>,
    tables: [(&'static str, Range); 2],
    light: BufferId,
    sums: BufferId,
}

impl<'a> BlockTables<'a> {
    fn new(plan: &mut Plan, uploads: &mut Uploads<'a>, matrix: &'a BlockMatrix, range: u64, decoder: Decoder) -> Self {
        let places = matrix.block_count() * BLOCK as usize;
        let mut order = matrix.permutation().order().to_vec();
        order.resize(places, NO_ELEMENT);
        let ones = vec![Vec4::ONE; places];
        Self {
            matrix,
            kernel: match (decoder, matrix.settings().codec) {
                (Decoder::Texture { .. }, _) => &table::MULTIBOUNCE_BLOCKS_GATHER_IMAGE,
                (_, BlockCodec::Bc1) => &table::MULTIBOUNCE_BLOCKS_GATHER_BC1,
                (_, BlockCodec::Bc3) => &table::MULTIBOUNCE_BLOCKS_GATHER_BC3,
                (_, BlockCodec::Bc6h) => &table::MULTIBOUNCE_BLOCKS_GATHER_BC6H,
                (_, BlockCodec::Bc7) => &table::MULTIBOUNCE_BLOCKS_GATHER_BC7,
            },
            order: [
                uploads.table(plan, "block order", cast_slice(&order).to_vec()),
                uploads.table(plan, "ones", cast_slice(&ones).to_vec()),
            ],
            place: [
                uploads.table(plan, "block places", cast_slice(matrix.permutation().place())),
                uploads.table(plan, "row scales", cast_slice(matrix.row_scales())),
            ],
            parts: parts(plan, uploads, matrix, range, decoder),
            tables: [
                uploads.named(plan, "tile_scales", cast_slice(matrix.scales())),
                uploads.named(plan, "row_start", cast_slice(&matrix.outliers().start)),
            ],
            light: plan.storage("ordered", rgb(places)),
            sums: plan.storage("rows", rgb(places)),
        }
    }

    fn product(&self, plan: &mut Plan, exitance: BufferId, irradiance: BufferId) -> Result<(), ExecutorError> {
        let (matrix, columns) = (self.matrix, self.matrix.block_count());
        let mut reorder = |[order, scale]: [Range; 2], input: BufferId, output: BufferId, count: usize| {
            let own = [("order", order), ("scale", scale), ("input", input.into()), ("output", output.into())];
            let push = CountParams { count: count as u32 };
            pass(plan, "method", &table::MULTIBOUNCE_REORDER, &own, &[], &push, push.count)
        };
        reorder(self.order, exitance, self.light, columns * BLOCK as usize)?;
        for Part { rows, words, outliers, first_outlier } in &self.parts {
            let own = [
                ("blocks", *words),
                ("outliers", *outliers),
                ("exitance", self.light.into()),
                ("irradiance", self.sums.into()),
            ];
            let push =
                BlockParams { first_outlier: *first_outlier, ..matrix.params(rows.start as u32, rows.len() as u32) };
            pass(plan, "method", self.kernel, &own, &self.tables, &push, push.block_rows)?;
        }
        let own = [
            ("order", self.place[0]),
            ("scale", self.place[1]),
            ("input", self.sums.into()),
            ("output", irradiance.into()),
        ];
        let push = CountParams { count: matrix.len() as u32 };
        pass(plan, "method", &table::MULTIBOUNCE_REORDER, &own, &[], &push, push.count)?;
        Ok(())
    }
}

/// Rows of blocks whose blocks and outliers fit into one binding each, or into one image.
fn parts<'a>(
    plan: &mut Plan,
    uploads: &mut Uploads<'a>,
    matrix: &'a BlockMatrix,
    range: u64,
    decoder: Decoder,
) -> Vec<Part> {
    let (columns, start) = (matrix.block_count(), &matrix.outliers().start);
    let (format, block_bytes) = match matrix.settings().codec {
        BlockCodec::Bc1 => (ImageFormat::Bc1Rgb, size_of::<UVec2>()),
        BlockCodec::Bc3 => (ImageFormat::Bc3, size_of::<UVec4>()),
        BlockCodec::Bc6h => (ImageFormat::Bc6hUfloat, size_of::<UVec4>()),
        BlockCodec::Bc7 => (ImageFormat::Bc7, size_of::<UVec4>()),
    };
    let (words, row_bytes) = (cast_slice::<u32, u8>(matrix.words()), columns * block_bytes);
    let entries = uploads.table(plan, "outliers", cast_slice(&matrix.outliers().entries)).buffer;
    // Outliers from a place on at which a range may begin.
    let (entry_bytes, step) = (size_of::<UVec2>() as u64, RANGE_ALIGNMENT / size_of::<UVec2>() as u64);
    let extent = |first: usize, end: usize| {
        let at = |row: usize| u64::from(start[(row * BLOCK as usize).min(matrix.len())]);
        (at(first), at(first) / step * step, at(end))
    };
    let (row_step, most_rows, most_bytes) = match decoder {
        Decoder::Texture { edge } => (1, (edge / BLOCK) as usize, u64::MAX),
        Decoder::Kernel => (row_step(row_bytes as u64), usize::MAX, range),
    };
    let fits = |first: usize, end: usize| {
        let (_, aligned, last) = extent(first, end);
        let is_short = end - first <= most_rows && ((end - first) * row_bytes) as u64 <= most_bytes;
        is_short && (last - aligned) * entry_bytes <= range
    };
    let whole = match decoder {
        Decoder::Texture { .. } => None,
        Decoder::Kernel => Some(uploads.table(plan, "blocks", words).buffer),
    };
    let part = |rows: std::ops::Range<usize>| {
        let bytes = rows.start * row_bytes..rows.end * row_bytes;
        let blocks = match whole {
            Some(whole) => whole.range(bytes.start as u64, bytes.len() as u64),
            None => {
                let [width, height] = [columns, rows.len()].map(|blocks| blocks as u32 * BLOCK);
                let image = plan.image("blocks", format, width, height);
                uploads.0.push((image, words[bytes].into()));
                image.into()
            }
        };
        let (first, aligned, last) = extent(rows.start, rows.end);
        // Rows without outliers read none; something is bound nevertheless.
        let (outliers, first_outlier) = match first == last {
            true => (entries.range(0, entry_bytes), first),
            false => (entries.range(aligned * entry_bytes, (last - aligned) * entry_bytes), aligned),
        };
        Part { rows, words: blocks, outliers, first_outlier: first_outlier as u32 }
    };
    row_blocks(columns, row_step, fits).into_iter().map(part).collect()
}

/// Some of the rows of blocks, and what a pass over them binds.
struct Part {
    rows: std::ops::Range<usize>,
    words: Range,
    outliers: Range,
    first_outlier: u32,
}

/// An operator in tiles on the device, and what a product keeps between its passes.
pub(super) struct TileTables {
    /// What makes sums of the exitance, and what makes rows of the sums: the same tables where patches are both.
    senders: Vec<(&'static str, Range)>,
    receivers: Vec<(&'static str, Range)>,
    /// Of the differences of red and blue to green.
    axes: Vec4,
    ordered: BufferId,
    light: BufferId,
    sums: BufferId,
    factors: BufferId,
    rows: BufferId,
    near: BufferId,
    /// Senders, receivers, quads of the senders, runs of both.
    counts: [u32; 5],
}

impl TileTables {
    fn new<'a>(plan: &mut Plan, uploads: &mut Uploads<'a>, tiles: &'a LowRank) -> Self {
        let own = (&tiles.place[..], &tiles.root[..], &tiles.partner[..]);
        let receivers = rows_of(plan, uploads, own, tiles.expand_tables(), tiles.near_tables());
        let mut senders = vec![
            uploads.named(plan, "order", cast_slice(&tiles.order)),
            uploads.named(plan, "scales", cast_slice(&tiles.scale)),
        ];
        match &tiles.columns {
            Some(ColumnVectors { root, runs, quads, words }) => senders.extend([
                uploads.named(plan, "root", cast_slice(root)),
                uploads.named(plan, "runs", cast_slice(runs)),
                uploads.named(plan, "quads", cast_slice(quads)),
                uploads.named(plan, "words", cast_slice(words)),
            ]),
            None => senders.extend(receivers.iter().cloned()),
        }
        let quads = tiles.project_tables().quads.len();
        let [sender_runs, runs] = [tiles.column_runs(), &tiles.runs].map(|runs| runs.len().saturating_sub(1));
        let (rows, columns) = tiles.shape();
        Self::with(plan, senders, receivers, tiles.axes, [columns, rows, quads, sender_runs, runs])
    }

    fn with(
        plan: &mut Plan,
        senders: Vec<(&'static str, Range)>,
        receivers: Vec<(&'static str, Range)>,
        axes: Vec4,
        counts: [usize; 5],
    ) -> Self {
        let [patches, points, quads, _, runs] = counts;
        let places = points.next_multiple_of(TILE as usize);
        Self {
            senders,
            receivers,
            axes,
            // Single entries name any of these.
            ordered: plan.storage("ordered", rgb(PLACES)),
            light: plan.storage("light", u64::from(LIGHT_WORDS * 4) * patches.div_ceil(TILE as usize) as u64),
            sums: plan.storage("sums", rgb(QUAD as usize * quads)),
            factors: plan.storage("factors", u64::from(FACTOR_WORDS * 4) * runs as u64),
            rows: plan.storage("rows", rgb(SPLITS as usize * places)),
            near: plan.storage("near", rgb(places)),
            counts: counts.map(|count| count as u32),
        }
    }

    /// The passes of `irradiance = T exitance`.
    fn product(&self, plan: &mut Plan, exitance: BufferId, irradiance: BufferId) -> Result<(), ExecutorError> {
        let own = [
            ("exitance", Range::from(exitance)),
            ("irradiance", Range::from(irradiance)),
            ("ordered", Range::from(self.ordered)),
            ("light", Range::from(self.light)),
            ("sums", Range::from(self.sums)),
            ("factors", Range::from(self.factors)),
            ("rows", Range::from(self.rows)),
            ("near", Range::from(self.near)),
        ];
        let [patches, receivers, _, sender_runs, runs] = self.counts;
        let (from, to) = (patches.next_multiple_of(TILE), receivers.next_multiple_of(TILE));
        let (enter, count) = (EnterParams { count: from, patches }, |count| CountParams { count });
        let tables = &self.senders;
        pass(plan, "method", &table::MULTIBOUNCE_TILES_ENTER, &own, tables, &enter, from)?;
        let (lanes, parts) = (from / TILE * QUARTERS, RUN_PARTS * sender_runs);
        pass(plan, "method", &table::MULTIBOUNCE_TILES_ROUND, &own, tables, &count(lanes), lanes)?;
        let project = ProjectParams { axes: self.axes, count: parts, reserved: [0; 3] };
        pass(plan, "method", &table::MULTIBOUNCE_TILES_PROJECT, &own, tables, &project, parts)?;
        let (tables, lanes) = (&self.receivers, SPLITS * to / TILE * PAIRS);
        pass(plan, "method", &table::MULTIBOUNCE_TILES_WEIGH, &own, tables, &count(runs), runs)?;
        pass(plan, "method", &table::MULTIBOUNCE_TILES_EXPAND, &own, tables, &count(lanes), lanes)?;
        pass(plan, "method", &table::MULTIBOUNCE_TILES_NEAR, &own, tables, &count(to / 8), to / 8)?;
        pass(plan, "method", &table::MULTIBOUNCE_TILES_LEAVE, &own, tables, &count(receivers), receivers)?;
        Ok(())
    }
}

/// Tables that make rows of sums.
fn rows_of<'a>(
    plan: &mut Plan,
    uploads: &mut Uploads<'a>,
    (place, root, partner): (&'a [u32], &'a [f32], &'a [u32]),
    expand: ExpandTables<'a>,
    near: NearTables<'a>,
) -> Vec<(&'static str, Range)> {
    vec![
        uploads.named(plan, "place", cast_slice(place)),
        uploads.named(plan, "root", cast_slice(root)),
        uploads.named(plan, "partner", cast_slice(partner)),
        uploads.named(plan, "run_start", cast_slice(expand.run_start)),
        uploads.named(plan, "runs", cast_slice(expand.runs)),
        uploads.named(plan, "quads", cast_slice(expand.quads)),
        uploads.named(plan, "words", cast_slice(expand.words)),
        uploads.named(plan, "square_start", cast_slice(near.square_start)),
        uploads.named(plan, "squares", cast_slice(near.squares)),
        uploads.named(plan, "square_words", cast_slice(near.square_words)),
        uploads.named(plan, "row_start", cast_slice(near.row_start)),
        uploads.named(plan, "entries", cast_slice(near.entries)),
        uploads.named(plan, "steps", cast_slice(near.steps)),
    ]
}

/// Irradiance of the receivers of tiles on a device, W/m², and the median of the times of so many products, ms.
///
/// # Errors
/// What the device says.
pub fn receivers_on_device(
    executor: &mut dyn Executor,
    tiles: &LowRank,
    light: &[Vec4],
    turns: usize,
) -> Result<(Vec<Vec4>, f64), ExecutorError> {
    let (mut plan, mut uploads) = (Plan::new(), Uploads::default());
    let tables = TileTables::new(&mut plan, &mut uploads, tiles);
    let [exitance, irradiance] =
        [("exitance", tiles.columns()), ("irradiance", tiles.rows())].map(|(name, n)| plan.storage(name, rgb(n)));
    tables.product(&mut plan, exitance, irradiance)?;
    executor.load(plan)?;
    for (buffer, bytes) in uploads.0 {
        executor.upload_at(buffer, 0, &bytes)?;
    }
    time_product(executor, [exitance, irradiance], light, turns)
}

#[cfg(test)]
mod tests {
    use super::super::super::operator::measure::relative_error;
    use super::super::super::operator::tests::{CODECS, cornell, light};
    use super::*;
    use crate::cpu::Cpu;
    use crate::executor::DeviceChoice;
    use crate::progress::Progress;
    use crate::render::operator::Codec;
    use crate::vulkan::{Validation, Vulkan};
    use multibounce::Channels;

    #[test]
    fn the_passes_give_the_product_of_the_host_for_every_size_of_a_binding() {
        let (between, albedo) = cornell();
        let mut progress = Progress::new(true);
        let operators = between.bounces(&albedo, None, &mut progress).unwrap();
        let (n, light) = (albedo.len(), light(albedo.len()));
        assert_ne!(n % 4, 0, "whole blocks hide what happens beyond them");
        for (codec, _) in CODECS {
            let channels = Channels::Three(operators.each_ref());
            let operator = PatchOperator::encode(codec, channels, &between, 1, &mut progress).unwrap();
            let mut expected = vec![Vec4::ZERO; n];
            operator.apply(&light, &mut expected).unwrap();
            let run_by = |decoder: Decoder, range: u64, light: &[Vec4]| {
                let mut executor: Box<dyn Executor> = Box::new(Cpu::new());
                let [exitance, irradiance] = load_product(executor.as_mut(), &operator, range, decoder).unwrap();
                executor.upload(exitance, light).unwrap();
                executor.run().unwrap();
                (executor.plan().passes().len(), executor.download_table::<Vec4>(irradiance).unwrap())
            };
            let run = |range: u64, light: &[Vec4]| run_by(Decoder::Kernel, range, light);
            let (whole, found) = run(u64::MAX, &light);
            let error = relative_error(&found, &expected, &between.area);
            assert!(error < 2e-6, "{codec:?}: {error}");
            // In parts: more passes, the same bits.
            let (parts, same) = run(6_000, &light);
            assert_eq!(same, found, "{codec:?}");
            assert_eq!(parts > whole, !matches!(codec, Codec::Tiles { .. }), "{codec:?}");
            // From images, one or several, whose blocks native code decodes exactly: the same bits.
            if matches!(operator, PatchOperator::Blocks(_)) {
                for (edge, passes) in [(u32::MAX, whole), (152, whole), (44, whole + 3)] {
                    let by_images = run_by(Decoder::Texture { edge }, u64::MAX, &light);
                    assert_eq!((by_images.0, &by_images.1), (passes, &found), "{codec:?}, images of {edge}");
                }
            }
            let mut other = light.clone();
            other[n - 1].x += 1.0;
            assert!(relative_error(&run(6_000, &other).1, &expected, &between.area) > 1e-4);
        }
    }

    #[test]
    fn texture_units_give_the_product_of_the_host_from_one_image_and_from_several() {
        let choice = DeviceChoice::Vulkan;
        let mut executor: Box<dyn Executor> = match Vulkan::open(&choice, Validation::IfThere) {
            Ok(vulkan) if vulkan.device().has_block_images => Box::new(vulkan),
            other => {
                let required = std::env::var("REQUIRE_VULKAN").is_ok_and(|value| value == "1");
                assert!(!required || other.is_ok(), "REQUIRE_VULKAN is set and there is no device");
                println!("skipped: no device with textureCompressionBC");
                return;
            }
        };
        let (between, albedo) = cornell();
        let mut progress = Progress::new(true);
        let operators = between.bounces(&albedo, None, &mut progress).unwrap();
        let (n, light) = (albedo.len(), light(albedo.len()));
        for codec in BlockCodec::ALL {
            let channels = Channels::Three(operators.each_ref());
            let mut operator =
                PatchOperator::encode(Codec::Blocks(codec), channels, &between, 1, &mut progress).unwrap();
            let mut expected = vec![Vec4::ZERO; n];
            operator.apply(&light, &mut expected).unwrap();
            let mut run = |operator: &PatchOperator, edge: u32| {
                let decoder = Decoder::Texture { edge };
                let range = executor.device().max_storage_buffer_range;
                let [exitance, irradiance] = load_product(executor.as_mut(), operator, range, decoder).unwrap();
                executor.upload(exitance, &light).unwrap();
                executor.run().unwrap();
                executor.download_table::<Vec4>(irradiance).unwrap()
            };
            let found = run(&operator, 4096);
            assert_eq!(run(&operator, 44), found, "{codec:?}: in several images");
            // BC6H and BC7 are exact by their specification; of BC1 and BC3 up to 1.7/255 is rounded off at a texel, whose
            // square is an entry, and errors of a row's texels have both signs.
            let limit = if matches!(codec, BlockCodec::Bc1 | BlockCodec::Bc3) { 1e-2 } else { 5e-6 };
            let error = |found: &[Vec4]| relative_error(found, &expected, &between.area);
            println!("{codec:?}: {:.1e}", error(&found));
            assert!(error(&found) < limit, "{codec:?}: {}", error(&found));
            let PatchOperator::Blocks(matrix) = &mut operator else { panic!("the codec is one of blocks") };
            matrix.words_mut().iter_mut().for_each(|word| *word = word.rotate_left(3));
            assert!(error(&run(&operator, 4096)) > limit, "{codec:?}: other blocks pass");
        }
    }

    #[test]
    fn rows_begin_where_ranges_may() {
        for (row_bytes, step) in [(4, 64), (8, 32), (24, 32), (256, 1), (1 << 20, 1), (300, 64)] {
            assert_eq!(row_step(row_bytes), step);
            assert_eq!(step as u64 * row_bytes % RANGE_ALIGNMENT, 0);
        }
    }
}
