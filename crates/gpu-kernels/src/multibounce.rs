//! Kernels of the multi-bounce products: matrices in texture blocks, feedback, and steps of the
//! operator.

use ::multibounce::kernel::blocks::{self, BLOCK, Bc1, Bc3, Bc6h, Bc7, BlockSums, LANES};
use ::multibounce::kernel::{feedback, invert, multiply as product};
use ::multibounce::{BlockParams, FeedbackParams, InvertParams, MultiplyParams};
use ::scene::Rgb;
use glam::{UVec2, UVec4, Vec4};
use spirv_std::arch::workgroup_memory_barrier_with_group_sync;
use spirv_std::glam::UVec2 as TexelPlace;

use crate::params::CountParams;

kernels! {
    /// Product with a matrix in blocks of BC1 (`multibounce::BlockMatrix`), decoded in the kernel:
    /// [`blocks::decode_gather_row`]. A workgroup takes a row of blocks; `exitance` and
    /// `irradiance` are in the order of the blocks, `exitance` holds 4 elements for each column of
    /// blocks.
    MULTIBOUNCE_BLOCKS_GATHER_BC1: BlocksGatherBc1Pass = "multibounce_blocks_gather_bc1"(p: BlockParams)
    for group of 1 in 0..block_rows, lane, shared: [Vec4; 256] {
        blocks: read [UVec2],
        tile_scales: read [Vec4],
        row_start: read [u32],
        outliers: read [UVec2],
        exitance: read [Rgb],
        irradiance: write [Rgb],
    } workgroup {
        let (row, exists) = row_of_blocks(group, p);
        let load = |k: u32| {
            let pair = blocks[k as usize];
            UVec4::new(pair.x, pair.y, 0, 0)
        };
        let sums =
            blocks::decode_gather_row::<Bc1>(row, p, lane, LANES, load, tile_scales, exitance);
        let more = blocks::gather_outlier_rows(row, p, lane, LANES, row_start, outliers, exitance);
        add_lanes(lane, sums.plus(more), shared);
        let i = BLOCK * (p.first_block_row + row) + lane;
        if exists && lane < BLOCK && i < p.rows {
            irradiance[i as usize] = shared[(lane * LANES) as usize];
        }
    } host crate::host::multibounce::blocks_gather_bc1;

    /// Gathers from blocks of BC3.
    MULTIBOUNCE_BLOCKS_GATHER_BC3: BlocksGatherBc3Pass = "multibounce_blocks_gather_bc3"(p: BlockParams)
    for group of 1 in 0..block_rows, lane, shared: [Vec4; 256] {
        blocks: read [UVec4],
        tile_scales: read [Vec4],
        row_start: read [u32],
        outliers: read [UVec2],
        exitance: read [Rgb],
        irradiance: write [Rgb],
    } workgroup {
        let (row, exists) = row_of_blocks(group, p);
        let load = |k: u32| blocks[k as usize];
        let sums =
            blocks::decode_gather_row::<Bc3>(row, p, lane, LANES, load, tile_scales, exitance);
        let more = blocks::gather_outlier_rows(row, p, lane, LANES, row_start, outliers, exitance);
        add_lanes(lane, sums.plus(more), shared);
        let i = BLOCK * (p.first_block_row + row) + lane;
        if exists && lane < BLOCK && i < p.rows {
            irradiance[i as usize] = shared[(lane * LANES) as usize];
        }
    } host crate::host::multibounce::blocks_gather_bc3;

    /// Gathers from blocks of BC6H.
    MULTIBOUNCE_BLOCKS_GATHER_BC6H: BlocksGatherBc6hPass = "multibounce_blocks_gather_bc6h"(p: BlockParams)
    for group of 1 in 0..block_rows, lane, shared: [Vec4; 256] {
        blocks: read [UVec4],
        tile_scales: read [Vec4],
        row_start: read [u32],
        outliers: read [UVec2],
        exitance: read [Rgb],
        irradiance: write [Rgb],
    } workgroup {
        let (row, exists) = row_of_blocks(group, p);
        let load = |k: u32| blocks[k as usize];
        let sums =
            blocks::decode_gather_row::<Bc6h>(row, p, lane, LANES, load, tile_scales, exitance);
        let more = blocks::gather_outlier_rows(row, p, lane, LANES, row_start, outliers, exitance);
        add_lanes(lane, sums.plus(more), shared);
        let i = BLOCK * (p.first_block_row + row) + lane;
        if exists && lane < BLOCK && i < p.rows {
            irradiance[i as usize] = shared[(lane * LANES) as usize];
        }
    } host crate::host::multibounce::blocks_gather_bc6h;

    /// Gathers from blocks of BC7.
    MULTIBOUNCE_BLOCKS_GATHER_BC7: BlocksGatherBc7Pass = "multibounce_blocks_gather_bc7"(p: BlockParams)
    for group of 1 in 0..block_rows, lane, shared: [Vec4; 256] {
        blocks: read [UVec4],
        tile_scales: read [Vec4],
        row_start: read [u32],
        outliers: read [UVec2],
        exitance: read [Rgb],
        irradiance: write [Rgb],
    } workgroup {
        let (row, exists) = row_of_blocks(group, p);
        let load = |k: u32| blocks[k as usize];
        let sums =
            blocks::decode_gather_row::<Bc7>(row, p, lane, LANES, load, tile_scales, exitance);
        let more = blocks::gather_outlier_rows(row, p, lane, LANES, row_start, outliers, exitance);
        add_lanes(lane, sums.plus(more), shared);
        let i = BLOCK * (p.first_block_row + row) + lane;
        if exists && lane < BLOCK && i < p.rows {
            irradiance[i as usize] = shared[(lane * LANES) as usize];
        }
    } host crate::host::multibounce::blocks_gather_bc7;

    /// Gathers from blocks of any format as an image, 4 texels for each block each way, decoded by the texture unit.
    MULTIBOUNCE_BLOCKS_GATHER_IMAGE: BlocksGatherImagePass = "multibounce_blocks_gather_image"(p: BlockParams)
    for group of 1 in 0..block_rows, lane, shared: [Vec4; 256] {
        blocks: image crate::table::ImageFormat::BLOCKS,
        tile_scales: read [Vec4],
        row_start: read [u32],
        outliers: read [UVec2],
        exitance: read [Rgb],
        irradiance: write [Rgb],
    } workgroup {
        let (row, exists) = row_of_blocks(group, p);
        // By components: an application may resolve another glam for `spirv_std`.
        let fetch = |x: u32, y: u32| -> Vec4 {
            let texel = blocks.fetch(TexelPlace::new(x, y));
            Vec4::new(texel.x, texel.y, texel.z, texel.w)
        };
        let sums = blocks::fetch_gather_row(row, p, lane, LANES, fetch, tile_scales, exitance);
        let more = blocks::gather_outlier_rows(row, p, lane, LANES, row_start, outliers, exitance);
        add_lanes(lane, sums.plus(more), shared);
        let i = BLOCK * (p.first_block_row + row) + lane;
        if exists && lane < BLOCK && i < p.rows {
            irradiance[i as usize] = shared[(lane * LANES) as usize];
        }
    } host crate::host::multibounce::blocks_gather_image;

    /// A vector in another order, each element scaled: [`blocks::reorder`]. An invocation makes one
    /// of the result.
    MULTIBOUNCE_REORDER: ReorderPass = "multibounce_reorder"(p: CountParams) for k in 0..count {
        order: read [u32; count],
        scale: read [Vec4; count],
        input: read [Rgb],
        output: write [Rgb],
    } each {
        blocks::reorder(k, order, scale, input)
    }

    /// A bounce that begins with the light of the frame before: the change of exitance and the
    /// exitance, W/m²: [`feedback::change`]. An invocation takes a patch.
    MULTIBOUNCE_FEEDBACK: FeedbackPass = "multibounce_feedback"(p: FeedbackParams) for k in 0..count {
        source: read [Rgb; count],
        albedo: read [Rgb; count],
        irradiance: read [Rgb; count],
        change: update [Rgb] as change_before,
        exitance: update [Rgb] as exitance_before,
    } each {
        let i = k as usize;
        let exitance = exitance_before;
        let change =
            feedback::change(p, source[i], albedo[i], irradiance[i], exitance, change_before);
        (change, exitance + change)
    }

    /// A step of Horner's rule, `F + F diag(ρ) T`: some rows of it, with some rows of T:
    /// [`product::multiply`]. A workgroup takes a tile of
    /// `multibounce::kernel::multiply::TILE_ROWS` rows and `TILE_VECTORS` vectors of four columns.
    /// `factors` and `next` hold the same rows; with another than the first rows of T, sums go on
    /// from what `next` has.
    MULTIBOUNCE_MULTIPLY: MultiplyPass = "multibounce_multiply"(p: MultiplyParams)
    for group of 1 in 0..tiles, lane {
        factors: read [Vec4],
        albedo: read [Vec4],
        operator: read [Vec4],
        next: update [Vec4],
    } workgroup {
        if group < p.tiles {
            let (row, vector) = product::tile_at(group, lane, p);
            let first = (row * p.vectors + vector) as usize;
            let below = p.vectors as usize;
            let sums = if p.first_inner == 0 {
                let start = |r: u32| factors[first + r as usize * below];
                product::multiply(row, vector, p, factors, albedo, operator, start)
            } else {
                let start = |r: u32| next[first + r as usize * below];
                product::multiply(row, vector, p, factors, albedo, operator, start)
            };
            next[first] = sums[0];
            next[first + below] = sums[1];
            next[first + 2 * below] = sums[2];
            next[first + 3 * below] = sums[3];
            next[first + 4 * below] = sums[4];
            next[first + 5 * below] = sums[5];
            next[first + 6 * below] = sums[6];
            next[first + 7 * below] = sums[7];
            next[first + 8 * below] = sums[8];
            next[first + 9 * below] = sums[9];
            next[first + 10 * below] = sums[10];
            next[first + 11 * below] = sums[11];
            next[first + 12 * below] = sums[12];
            next[first + 13 * below] = sums[13];
            next[first + 14 * below] = sums[14];
            next[first + 15 * below] = sums[15];
        }
    } host crate::host::multibounce::multiply;

    /// Rows of the block that is eliminated, from the upper half of the matrix: [`invert::pivot_row`].
    /// An invocation makes a vector of four columns.
    MULTIBOUNCE_PIVOT_ROWS: PivotRowsPass = "multibounce_pivot_rows"(p: InvertParams) for k in 0..count {
        matrix: read [Vec4; p.rows as usize * p.vectors as usize],
        pivot_rows: update [Vec4] as before,
    } each {
        invert::pivot_row(k, p, matrix, before)
    }

    /// Multiplies rows by the inverse of the block: [`invert::scaled_row`]. An invocation makes a vector of four
    /// columns.
    MULTIBOUNCE_SCALED_ROWS: ScaledRowsPass = "multibounce_scaled_rows"(p: InvertParams) for k in 0..count {
        inverse: read [Vec4; (invert::PIVOT_ROWS * invert::PIVOT_VECTORS) as usize],
        pivot_rows: read [Vec4; count],
        scaled_rows: write [Vec4],
    } each {
        invert::scaled_row(k, p, inverse, pivot_rows)
    }

    /// A step of elimination in some rows of the matrix, those of its upper half:
    /// [`invert::eliminate`]. A workgroup takes a tile of
    /// `multibounce::kernel::multiply::TILE_ROWS` rows and `TILE_VECTORS` vectors of four columns.
    MULTIBOUNCE_ELIMINATE: EliminatePass = "multibounce_eliminate"(p: InvertParams)
    for group of 1 in 0..count, lane {
        inverse: read [Vec4],
        pivot_rows: read [Vec4],
        scaled_rows: read [Vec4],
        matrix: update [Vec4],
    } workgroup {
        if group < p.count {
            let (row, vector) = invert::tile_at(group, lane, p);
            if invert::is_upper(row, vector) {
                let first = ((row - p.first_row) * p.vectors + vector) as usize;
                let below = p.vectors as usize;
                let start = |r: u32| matrix[first + r as usize * below];
                let rows = invert::eliminate(row, vector, p, inverse, pivot_rows, scaled_rows, start);
                matrix[first] = rows[0];
                matrix[first + below] = rows[1];
                matrix[first + 2 * below] = rows[2];
                matrix[first + 3 * below] = rows[3];
                matrix[first + 4 * below] = rows[4];
                matrix[first + 5 * below] = rows[5];
                matrix[first + 6 * below] = rows[6];
                matrix[first + 7 * below] = rows[7];
                matrix[first + 8 * below] = rows[8];
                matrix[first + 9 * below] = rows[9];
                matrix[first + 10 * below] = rows[10];
                matrix[first + 11 * below] = rows[11];
                matrix[first + 12 * below] = rows[12];
                matrix[first + 13 * below] = rows[13];
                matrix[first + 14 * below] = rows[14];
                matrix[first + 15 * below] = rows[15];
            }
        }
    } host crate::host::multibounce::eliminate;
}

/// Rows of blocks beyond the last one are computed as the last one, and not written: barriers need
/// all invocations.
#[inline]
fn row_of_blocks(row: u32, p: &BlockParams) -> (u32, bool) {
    if row < p.block_rows { (row, true) } else { (p.block_rows.max(1) - 1, false) }
}

/// Leaves the sum over all lanes of row r in `shared[r * LANES]`: [`blocks::combine`] in a tree.
#[inline]
fn add_lanes(lane: u32, sums: BlockSums, shared: &mut [Vec4; 256]) {
    shared[lane as usize] = sums.a.extend(0.0);
    shared[(LANES + lane) as usize] = sums.b.extend(0.0);
    shared[(2 * LANES + lane) as usize] = sums.c.extend(0.0);
    shared[(3 * LANES + lane) as usize] = sums.d.extend(0.0);
    workgroup_memory_barrier_with_group_sync();
    let mut stride = LANES / 2;
    while stride > 0 {
        if lane < stride {
            for row in 0..BLOCK {
                let k = (row * LANES + lane) as usize;
                shared[k] = blocks::combine(shared[k], shared[k + stride as usize]);
            }
        }
        workgroup_memory_barrier_with_group_sync();
        stride /= 2;
    }
}
