//! Entry points of the multi-bounce products.

use ::multibounce::kernel::blocks::{self, BLOCK, Bc1, Bc3, Bc6h, Bc7, BlockSums, LANES};
use ::multibounce::kernel::{feedback, multiply as product};
use ::multibounce::{BlockParams, FeedbackParams, MultiplyParams};
use ::scene::Rgb;
use glam::{UVec2, UVec3, UVec4, Vec4};
use spirv_std::arch::workgroup_memory_barrier_with_group_sync;
use spirv_std::{Image, spirv};

use crate::invocation::{element, group_index};
use crate::params::CountParams;

/// Rows of blocks beyond the last one are computed as the last one, and not written: barriers need all invocations.
#[inline]
fn row_of_blocks(group: UVec3, groups: UVec3, p: &BlockParams) -> (u32, bool) {
    let row = group_index(group, groups);
    if row < p.block_rows { (row, true) } else { (p.block_rows.max(1) - 1, false) }
}

/// Irradiance of every row of a matrix in blocks of BC1: a workgroup shares the columns of a row of blocks
/// ([`blocks::decode_gather_row`]) and adds its lanes up in a tree.
#[spirv(compute(threads(64), entry_point_name = "multibounce_blocks_gather_bc1"))]
#[inline(never)]
pub fn blocks_gather_bc1(
    #[spirv(workgroup_id)] group: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(local_invocation_index)] lane: u32,
    #[spirv(push_constant)] p: &BlockParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] words: &[UVec2],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] tile_scales: &[Vec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] outliers: &[UVec2],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] irradiance: &mut [Rgb],
    #[spirv(workgroup)] shared: &mut [Vec4; 256],
) {
    let (row, exists) = row_of_blocks(group, groups, p);
    let load = |k: u32| {
        let pair = words[k as usize];
        UVec4::new(pair.x, pair.y, 0, 0)
    };
    let sums = blocks::decode_gather_row::<Bc1>(row, p, lane, LANES, load, tile_scales, exitance);
    let more = blocks::gather_outlier_rows(row, p, lane, LANES, row_start, outliers, exitance);
    add_lanes(lane, sums.plus(more), shared);
    let i = BLOCK * (p.first_block_row + row) + lane;
    if exists && lane < BLOCK && i < p.rows {
        irradiance[i as usize] = shared[(lane * LANES) as usize];
    }
}

/// The same with blocks of BC3.
#[spirv(compute(threads(64), entry_point_name = "multibounce_blocks_gather_bc3"))]
#[inline(never)]
pub fn blocks_gather_bc3(
    #[spirv(workgroup_id)] group: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(local_invocation_index)] lane: u32,
    #[spirv(push_constant)] p: &BlockParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] words: &[UVec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] tile_scales: &[Vec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] outliers: &[UVec2],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] irradiance: &mut [Rgb],
    #[spirv(workgroup)] shared: &mut [Vec4; 256],
) {
    let (row, exists) = row_of_blocks(group, groups, p);
    let sums = blocks::decode_gather_row::<Bc3>(row, p, lane, LANES, |k| words[k as usize], tile_scales, exitance);
    let more = blocks::gather_outlier_rows(row, p, lane, LANES, row_start, outliers, exitance);
    add_lanes(lane, sums.plus(more), shared);
    let i = BLOCK * (p.first_block_row + row) + lane;
    if exists && lane < BLOCK && i < p.rows {
        irradiance[i as usize] = shared[(lane * LANES) as usize];
    }
}

/// The same with blocks of BC6H.
#[spirv(compute(threads(64), entry_point_name = "multibounce_blocks_gather_bc6h"))]
#[inline(never)]
pub fn blocks_gather_bc6h(
    #[spirv(workgroup_id)] group: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(local_invocation_index)] lane: u32,
    #[spirv(push_constant)] p: &BlockParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] words: &[UVec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] tile_scales: &[Vec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] outliers: &[UVec2],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] irradiance: &mut [Rgb],
    #[spirv(workgroup)] shared: &mut [Vec4; 256],
) {
    let (row, exists) = row_of_blocks(group, groups, p);
    let sums = blocks::decode_gather_row::<Bc6h>(row, p, lane, LANES, |k| words[k as usize], tile_scales, exitance);
    let more = blocks::gather_outlier_rows(row, p, lane, LANES, row_start, outliers, exitance);
    add_lanes(lane, sums.plus(more), shared);
    let i = BLOCK * (p.first_block_row + row) + lane;
    if exists && lane < BLOCK && i < p.rows {
        irradiance[i as usize] = shared[(lane * LANES) as usize];
    }
}

/// The same with blocks of BC7.
#[spirv(compute(threads(64), entry_point_name = "multibounce_blocks_gather_bc7"))]
#[inline(never)]
pub fn blocks_gather_bc7(
    #[spirv(workgroup_id)] group: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(local_invocation_index)] lane: u32,
    #[spirv(push_constant)] p: &BlockParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] words: &[UVec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] tile_scales: &[Vec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] outliers: &[UVec2],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] irradiance: &mut [Rgb],
    #[spirv(workgroup)] shared: &mut [Vec4; 256],
) {
    let (row, exists) = row_of_blocks(group, groups, p);
    let sums = blocks::decode_gather_row::<Bc7>(row, p, lane, LANES, |k| words[k as usize], tile_scales, exitance);
    let more = blocks::gather_outlier_rows(row, p, lane, LANES, row_start, outliers, exitance);
    add_lanes(lane, sums.plus(more), shared);
    let i = BLOCK * (p.first_block_row + row) + lane;
    if exists && lane < BLOCK && i < p.rows {
        irradiance[i as usize] = shared[(lane * LANES) as usize];
    }
}

/// The same with texels that the texture unit decodes, from blocks of any format.
#[spirv(compute(threads(64), entry_point_name = "multibounce_blocks_gather_image"))]
#[inline(never)]
pub fn blocks_gather_image(
    #[spirv(workgroup_id)] group: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(local_invocation_index)] lane: u32,
    #[spirv(push_constant)] p: &BlockParams,
    #[spirv(descriptor_set = 0, binding = 0)] words: &Image!(2D, type=f32, sampled),
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] tile_scales: &[Vec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] outliers: &[UVec2],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] irradiance: &mut [Rgb],
    #[spirv(workgroup)] shared: &mut [Vec4; 256],
) {
    let (row, exists) = row_of_blocks(group, groups, p);
    let fetch = |x: u32, y: u32| -> Vec4 { words.fetch(UVec2::new(x, y)) };
    let sums = blocks::fetch_gather_row(row, p, lane, LANES, fetch, tile_scales, exitance);
    let more = blocks::gather_outlier_rows(row, p, lane, LANES, row_start, outliers, exitance);
    add_lanes(lane, sums.plus(more), shared);
    let i = BLOCK * (p.first_block_row + row) + lane;
    if exists && lane < BLOCK && i < p.rows {
        irradiance[i as usize] = shared[(lane * LANES) as usize];
    }
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

/// A vector in another order, each element scaled: [`blocks::reorder`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_reorder"))]
#[inline(never)]
pub fn reorder(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] order: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] scale: &[Vec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] input: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] output: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        output[k as usize] = blocks::reorder(k, order, scale, input);
    }
}

/// A bounce of feedback: [`feedback::change`] of every patch, added to its exitance.
#[spirv(compute(threads(64), entry_point_name = "multibounce_feedback"))]
#[inline(never)]
pub fn feedback(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &FeedbackParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] source: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] albedo: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] irradiance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] change: &mut [Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] exitance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let i = k as usize;
        change[i] = feedback::change(p, source[i], albedo[i], irradiance[i], exitance[i], change[i]);
        exitance[i] += change[i];
    }
}

/// A tile of a step of Horner's rule, a vector of each of its rows: [`product::multiply`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_multiply"))]
#[inline(never)]
pub fn multiply(
    #[spirv(workgroup_id)] group: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(local_invocation_index)] lane: u32,
    #[spirv(push_constant)] p: &MultiplyParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] factors: &[Vec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] albedo: &[Vec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] operator: &[Vec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] next: &mut [Vec4],
) {
    let t = group_index(group, groups);
    if t < p.tiles {
        let (row, vector) = product::tile_at(t, lane, p);
        let first = (row * p.vectors + vector) as usize;
        let below = p.vectors as usize;
        let sums = if p.first_inner == 0 {
            product::multiply(row, vector, p, factors, albedo, operator, |r| factors[first + r as usize * below])
        } else {
            product::multiply(row, vector, p, factors, albedo, operator, |r| next[first + r as usize * below])
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
}
