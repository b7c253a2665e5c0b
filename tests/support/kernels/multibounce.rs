//! Inputs of the kernels of operators.

use ::multibounce::kernel::blocks::{BLOCK, NO_ELEMENT};
use ::multibounce::kernel::invert::{PIVOT_ROWS, PIVOT_VECTORS};
use ::multibounce::kernel::low_rank::{
    FACTOR_WORDS, GROUP_VECTORS, LANES, LIGHT_WORDS, NO_VECTOR, PAIRS, PARTS, PERMUTED_INDICES, RUN_GROUPS,
    RUN_INVOCATIONS, SPLITS, SUB_BLOCK_WORDS, TILE, U32X4S, chroma_weights,
};
use ::multibounce::kernel::multiply::{TILE_ROWS, TILE_VECTORS};
use ::multibounce::{
    BlockCodec, BlockParams, Companding, FeedbackParams, InvertParams, MultiplyParams, PackedGroup, SubBlock,
    quantise_all, requantise_all,
};
use glam::{UVec2, Vec4};
use gpu_kernels::params::{CountParams, MultiplyVtParams, PermuteInParams};
use gpu_kernels::table::ImageFormat;

use super::{Bytes, Data, Random, Tables, buffer, call, offsets, room};

/// Red and blue of the chroma axes.
const CHROMA_AXES: Vec4 = Vec4::new(0.8, -0.6, 0.6, 0.8);

/// Packed groups of two blocks, for one colour or for all, of short and long elements, and their words: those of a run
/// of [`TILE_RUNS`] have equal channels and bits.
fn tile_groups(r: &mut Random) -> (Vec<PackedGroup>, Vec<u32>) {
    let mut start = 0;
    let n = TILE_RUNS[TILE_RUNS.len() - 1];
    let groups = (0..n).map(|k| {
        let run = TILE_RUNS.partition_point(|&first| first <= k) as u32;
        let group = PackedGroup::new(start, 2 * k / n, run % 4, run.is_multiple_of(3));
        start += GROUP_VECTORS * group.vector_len();
        group
    });
    let groups = groups.collect();
    (groups, r.words(start * LANES))
}

/// First packed groups of runs, half of them of the first block.
const TILE_RUNS: [u32; 13] = [0, 8, 9, 12, 16, 18, 20, 28, 29, 30, 34, 37, 40];

/// The paired vector of each vector and sums for the vectors' channels.
fn tile_sums(r: &mut Random, groups: &[PackedGroup]) -> (Vec<u32>, Vec<Vec4>) {
    // Paired vectors are for the same colour, and so are their sums.
    let n = groups.len() as u32;
    let vectors = GROUP_VECTORS * groups.len() as u32;
    let other = |k: u32| {
        let alike = |group: &u32| groups[*group as usize].color() == groups[(k / GROUP_VECTORS) as usize].color();
        (0..n).map(|d| (k / GROUP_VECTORS + 5 + d) % n).find(alike).unwrap() * GROUP_VECTORS + k * 3 % GROUP_VECTORS
    };
    let paired = (0..vectors).map(|k| if k % 7 == 3 { NO_VECTOR } else { other(k) }).collect();
    let colors = r.colors(vectors as usize);
    let sum = |k: usize| {
        ((colors[k].truncate() - 0.4) * chroma_weights(groups[k / GROUP_VECTORS as usize].color(), CHROMA_AXES))
            .extend(0.0)
    };
    (paired, (0..vectors as usize).map(sum).collect())
}

pub(super) fn blocks(r: &mut Random, codec: BlockCodec, image: Option<ImageFormat>) -> (u32, Vec<u8>, Tables) {
    // More columns of blocks than lanes, and a last row of blocks that is not full.
    let rows = 273u32;
    let first_block_row = 60;
    let block_columns = rows.div_ceil(BLOCK);
    let block_rows = rows.div_ceil(BLOCK) - first_block_row;
    let (companding, mode_bits) = match codec {
        BlockCodec::Bc1 => (Companding::Sqrt, 0),
        BlockCodec::Bc3 => (Companding::Log2, 0),
        BlockCodec::Bc6h => (Companding::None, 5),
        BlockCodec::Bc7 => (Companding::Log2, 8),
    };
    let mut words = Vec::new();
    for k in 0..block_rows * block_columns {
        let first = words.len();
        words.extend((0..codec.block_words()).map(|_| r.word()));
        // Random bits are rarely in the higher modes.
        let mode = if codec == BlockCodec::Bc7 { 1 << (k % 9) & 255 } else { k % 32 };
        let kept = if codec == BlockCodec::Bc7 { k % 9 + 1 } else { mode_bits };
        if mode_bits > 0 {
            words[first] = words[first] >> kept << kept | mode;
        }
    }
    let mut row_start = vec![5u32];
    for k in 0..rows as usize {
        row_start.push(row_start[k] + if k % 7 == 0 { 70 + r.below(9) } else { r.below(5) });
    }
    // The side table from the first row of this block on; its halves may be negative.
    let first_outlier = row_start[(BLOCK * first_block_row) as usize];
    let outliers: Vec<UVec2> = (first_outlier..row_start[rows as usize])
        .map(|_| {
            let half = |r: &mut Random| u32::from(half::f16::from_f32(r.unit() - 0.4).to_bits());
            UVec2::new(r.below(rows) | half(r) << 16, half(r) | half(r) << 16)
        })
        .collect();
    let p = BlockParams {
        block_rows,
        block_columns,
        first_block_row,
        rows,
        tile_columns: block_columns.div_ceil(16),
        tile_shift: 4,
        companding: companding.id(),
        alpha: u32::from(codec == BlockCodec::Bc3),
        first_outlier,
    };
    let tiles = p.tile_columns * block_columns.div_ceil(16);
    let data = match image {
        Some(format) => {
            let width = BLOCK * block_columns;
            let height = BLOCK * block_rows;
            Data::Image { format, width, height, texels: Bytes::of(&words) }
        }
        None => Data::Buffer(Bytes::of(&words)),
    };
    let tables = vec![
        ("blocks", data),
        buffer("tile_scales", &r.colors(tiles as usize)),
        buffer("row_start", &row_start),
        buffer("outliers", &outliers),
        buffer("exitance", &r.colors((BLOCK * block_columns) as usize)),
        room::<Vec4>("irradiance", rows as usize),
    ];
    (block_rows, bytemuck::bytes_of(&p).to_vec(), tables)
}

/// Elements, push constants and tables of a kernel.
pub(super) fn own_tables(r: &mut Random, name: &str) -> (u32, Vec<u8>, Tables) {
    match name {
        "multibounce_low_rank_permute_in" => {
            let patches = 200u32;
            let padded_rows = 256u32;
            let order: Vec<u32> = (0..patches).map(|p| p * 7 % patches).collect();
            let tables = vec![
                buffer("order", &order),
                buffer("sqrt_area", &r.floats(patches as usize)),
                buffer("exitance", &r.colors(patches as usize)),
                room::<Vec4>("ordered", padded_rows as usize),
            ];
            call(padded_rows, PermuteInParams { count: padded_rows, patches }, tables)
        }
        "multibounce_low_rank_quantise" => {
            let count = 2 * U32X4S;
            let dark = |mut colors: Vec<Vec4>| {
                // One channel of a block is dark, and what is below 0 is rounded, too.
                colors[..TILE as usize].iter_mut().for_each(|x| x.y = 0.0);
                colors.iter_mut().step_by(3).for_each(|x| *x = -*x);
                colors
            };
            let tables = vec![
                buffer("ordered", &dark(r.colors(2 * TILE as usize))),
                room::<u32>("light", 2 * LIGHT_WORDS as usize),
            ];
            call(count, CountParams { count }, tables)
        }
        "multibounce_low_rank_requantise" => {
            let (groups, _) = tile_groups(r);
            let (paired, sums) = tile_sums(r, &groups);
            let count = TILE_RUNS.len() as u32 - 1;
            let tables = vec![
                buffer("runs", &TILE_RUNS),
                buffer("paired", &paired),
                buffer("sums", &sums),
                room::<u32>("factors", (count * FACTOR_WORDS) as usize),
            ];
            call(count, CountParams { count }, tables)
        }
        "multibounce_low_rank_multiply_vt" => {
            let (groups, words) = tile_groups(r);
            let n = groups.len() as u32;
            let count = RUN_INVOCATIONS * (TILE_RUNS.len() as u32 - 1);
            let mut light = vec![0; 2 * LIGHT_WORDS as usize];
            quantise_all(&r.colors(2 * TILE as usize), &mut light);
            let scale: Vec<f32> = (0..GROUP_VECTORS * n).map(|_| r.unit() - 0.3).collect();
            let tables = vec![
                buffer("runs", &TILE_RUNS),
                buffer("groups", &groups),
                buffer("words", &words),
                buffer("scales", &scale),
                buffer("light", &light),
                room::<Vec4>("sums", (GROUP_VECTORS * n) as usize),
            ];
            call(count, MultiplyVtParams { chroma_axes: CHROMA_AXES, count, reserved: [0; 3] }, tables)
        }
        "multibounce_low_rank_multiply_u" => {
            let padded_rows = 2 * TILE;
            let runs = TILE_RUNS.len() as u32 - 1;
            let (groups, words) = tile_groups(r);
            let (paired, sums) = tile_sums(r, &groups);
            assert!(TILE_RUNS.windows(2).all(|run| run[1] - run[0] <= RUN_GROUPS));
            let mut factors = vec![0; (runs * FACTOR_WORDS) as usize];
            requantise_all(&TILE_RUNS, &paired, &sums, &mut factors);
            let count = 2 * PAIRS * SPLITS;
            let tables = vec![
                buffer("run_start", &[0, runs / 2, runs]),
                buffer("runs", &TILE_RUNS),
                buffer("groups", &groups),
                buffer("words", &words),
                buffer("factors", &factors),
                room::<Vec4>("rows", (SPLITS * padded_rows) as usize),
            ];
            call(count, CountParams { count }, tables)
        }
        "multibounce_low_rank_dense_sparse" => {
            let padded_rows = 2 * TILE;
            let sub_block_start = offsets(r, 2 * PARTS as usize);
            let count = sub_block_start[2 * PARTS as usize];
            let sub_blocks: Vec<SubBlock> =
                (0..count).map(|_| SubBlock { column: r.below(2 * PARTS), step: r.unit() }).collect();
            let sub_block_words: Vec<u32> = (0..count * SUB_BLOCK_WORDS).map(|_| r.word()).collect();
            let mut light = vec![0; 2 * LIGHT_WORDS as usize];
            quantise_all(&r.colors(2 * TILE as usize), &mut light);
            let row_start = offsets(r, padded_rows as usize);
            let entries: Vec<u32> = (0..row_start[padded_rows as usize])
                .map(|_| r.word() << 16 | r.below(PERMUTED_INDICES as u32))
                .collect();
            let tables = vec![
                buffer("sub_block_start", &sub_block_start),
                buffer("sub_blocks", &sub_blocks),
                buffer("sub_block_words", &sub_block_words),
                buffer("light", &light),
                buffer("row_start", &row_start),
                buffer("entries", &entries),
                buffer("steps", &r.floats(padded_rows as usize)),
                buffer("ordered", &r.colors(PERMUTED_INDICES)),
                room::<Vec4>("dense_sparse", padded_rows as usize),
            ];
            call(padded_rows / 8, CountParams { count: padded_rows / 8 }, tables)
        }
        "multibounce_low_rank_permute_out" => {
            let n = 200u32;
            let permuted_index: Vec<u32> = (0..n).map(|i| i * 9 % 256).collect();
            let tables = vec![
                buffer("permuted_index", &permuted_index),
                buffer("sqrt_area", &r.floats(n as usize)),
                buffer("rows", &r.colors(256 * SPLITS as usize)),
                buffer("dense_sparse", &r.colors(256)),
                room::<Vec4>("irradiance", n as usize),
            ];
            call(n, CountParams { count: n }, tables)
        }
        "multibounce_feedback" => {
            let n = 200;
            let mut colors = |name| buffer(name, &r.colors(n));
            let tables = ["source", "albedo", "irradiance", "change", "exitance"].map(&mut colors).into();
            call(n as u32, FeedbackParams { count: n as u32, step: 1.2, momentum: 0.3 }, tables)
        }
        "multibounce_multiply" => {
            // Two rows and two columns of tiles, sums that go on, and fewer rows of the operator than columns of F.
            let row_tiles = 2;
            let vectors = 2 * TILE_VECTORS;
            let inner = 5;
            let first_inner = 3;
            let rows = (row_tiles * TILE_ROWS) as usize;
            let tiles = row_tiles * vectors / TILE_VECTORS;
            let mut matrix = |name, rows: usize| buffer(name, &r.colors(rows * vectors as usize));
            let tables = vec![
                matrix("factors", rows),
                matrix("operator", 4 * inner as usize),
                matrix("next", rows),
                buffer("albedo", &r.colors((first_inner + inner) as usize)),
            ];
            call(tiles, MultiplyParams { tiles, row_tiles, vectors, inner, first_inner }, tables)
        }
        "multibounce_pivot_rows" | "multibounce_scaled_rows" | "multibounce_eliminate" => {
            // The second block of four is eliminated; all but the first block's rows are bound.
            let vectors = TILE_VECTORS;
            let pivot = PIVOT_ROWS;
            let first_row = PIVOT_ROWS;
            let rows = 3 * PIVOT_ROWS;
            let count = match name {
                "multibounce_eliminate" => rows / TILE_ROWS * vectors / TILE_VECTORS,
                _ => PIVOT_ROWS * vectors,
            };
            let p = InvertParams { count, vectors, pivot, first_row, rows, first_vector: 0, width: vectors };
            let mut matrix = |name, rows: u32| buffer(name, &r.colors((rows * vectors) as usize));
            let mut tables = vec![matrix("matrix", rows), matrix("pivot_rows", PIVOT_ROWS)];
            tables.push(matrix("scaled_rows", PIVOT_ROWS));
            tables.push(buffer("inverse", &r.colors((PIVOT_ROWS * PIVOT_VECTORS) as usize)));
            call(count, p, tables)
        }
        "multibounce_blocks_gather_bc1" => blocks(r, BlockCodec::Bc1, None),
        "multibounce_blocks_gather_bc3" => blocks(r, BlockCodec::Bc3, None),
        "multibounce_blocks_gather_bc6h" => blocks(r, BlockCodec::Bc6h, None),
        "multibounce_blocks_gather_bc7" => blocks(r, BlockCodec::Bc7, None),
        "multibounce_blocks_gather_image" => blocks(r, BlockCodec::Bc7, Some(ImageFormat::Bc7)),
        "multibounce_reorder" => {
            let n = 200;
            let order: Vec<u32> = (0..n).map(|_| if r.below(9) == 0 { NO_ELEMENT } else { r.below(150) }).collect();
            let tables = vec![
                buffer("order", &order),
                buffer("scale", &r.colors(n as usize)),
                buffer("input", &r.colors(150)),
                room::<Vec4>("output", n as usize),
            ];
            call(n, CountParams { count: n }, tables)
        }
        other => panic!("the kernel {other} has no input here: add one"),
    }
}
