//! Entry points of the product with tiles: the exitance in their order and in whole numbers, the sums of their vectors, those
//! in whole numbers, the rows, those of squares and single entries.

use ::multibounce::kernel::tiles;
use ::multibounce::{TileQuad, TileSquare};
use ::scene::Rgb;
use glam::UVec3;
use spirv_std::spirv;

use crate::invocation::element;
use crate::params::{CountParams, EnterParams};

/// Exitance in the order of the tiles: [`tiles::enter`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_tiles_enter"))]
#[inline(never)]
pub fn tiles_enter(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &EnterParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] order: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] root: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] ordered: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        ordered[k as usize] = tiles::enter(k, p.patches, order, root, exitance);
    }
}

/// Exitance of a block in whole numbers: [`tiles::round`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_tiles_round"))]
#[inline(never)]
pub fn tiles_round(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] ordered: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] light: &mut [u32],
) {
    let k = element(id, groups);
    if k < p.count {
        tiles::round(k, ordered, light);
    }
}

/// Sums of the slots of a quad: [`tiles::project`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_tiles_project"))]
#[inline(never)]
pub fn tiles_project(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] quads: &[TileQuad],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] words: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] scales: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] light: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] sums: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let four = tiles::project(k, quads, words, scales, light);
        let first = (tiles::QUAD * k) as usize;
        sums[first] = four[0];
        sums[first + 1] = four[1];
        sums[first + 2] = four[2];
        sums[first + 3] = four[3];
    }
}

/// What the vectors of a run are multiplied by, in whole numbers: [`tiles::weigh`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_tiles_weigh"))]
#[inline(never)]
pub fn tiles_weigh(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] runs: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] partner: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] sums: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] factors: &mut [u32],
) {
    let k = element(id, groups);
    if k < p.count {
        tiles::weigh(k, runs, partner, sums, factors);
    }
}

/// Rows of the ordered irradiance, one of each part: [`tiles::expand`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_tiles_expand"))]
#[inline(never)]
pub fn tiles_expand(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] run_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] runs: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] quads: &[TileQuad],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] words: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] factors: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] rows: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let eight = tiles::expand(k, run_start, runs, quads, words, factors);
        rows[tiles::row_at(k, 0) as usize] = eight[0];
        rows[tiles::row_at(k, 1) as usize] = eight[1];
        rows[tiles::row_at(k, 2) as usize] = eight[2];
        rows[tiles::row_at(k, 3) as usize] = eight[3];
        rows[tiles::row_at(k, 4) as usize] = eight[4];
        rows[tiles::row_at(k, 5) as usize] = eight[5];
        rows[tiles::row_at(k, 6) as usize] = eight[6];
        rows[tiles::row_at(k, 7) as usize] = eight[7];
    }
}

/// Rows of squares and single entries: [`tiles::near`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_tiles_near"))]
#[inline(never)]
pub fn tiles_near(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] square_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] squares: &[TileSquare],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] square_words: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] light: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] entries: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] steps: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] ordered: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 8)] near: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        near[k as usize] =
            tiles::near(k, square_start, squares, square_words, light, row_start, entries, steps, ordered);
    }
}

/// Irradiance of the patches from the rows: [`tiles::leave`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_tiles_leave"))]
#[inline(never)]
pub fn tiles_leave(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] place: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] root: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] rows: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] near: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        irradiance[k as usize] = tiles::leave(k, place, root, rows, near);
    }
}
