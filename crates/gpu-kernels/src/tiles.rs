//! Entry points of the product with tiles: the exitance in their order and in whole numbers, the sums of their vectors, those
//! in whole numbers, the rows, those of squares and single entries.

use ::multibounce::kernel::tiles;
use ::multibounce::{TileQuad, TileSquare};
use ::scene::Rgb;
use glam::{UVec2, UVec3, UVec4, Vec4};
use spirv_std::spirv;

use crate::invocation::element;
use crate::params::{CountParams, EnterParams, ProjectParams};

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

/// Sums of the slots of a few quads: [`tiles::project`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_tiles_project"))]
#[inline(never)]
pub fn tiles_project(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &ProjectParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] runs: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] quads: &[TileQuad],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] words: &[UVec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] scales: &[Vec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] light: &[UVec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] sums: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let (quad, count) = tiles::quads_of(k, runs);
        if count > 0 {
            let sixteen = tiles::project(quad, count, p.axes, quads, words, scales, light);
            let first = (tiles::QUAD * quad) as usize;
            sums[first] = sixteen[0];
            sums[first + 1] = sixteen[1];
            sums[first + 2] = sixteen[2];
            sums[first + 3] = sixteen[3];
            if count > 1 {
                sums[first + 4] = sixteen[4];
                sums[first + 5] = sixteen[5];
                sums[first + 6] = sixteen[6];
                sums[first + 7] = sixteen[7];
            }
            if count > 2 {
                sums[first + 8] = sixteen[8];
                sums[first + 9] = sixteen[9];
                sums[first + 10] = sixteen[10];
                sums[first + 11] = sixteen[11];
            }
            if count > 3 {
                sums[first + 12] = sixteen[12];
                sums[first + 13] = sixteen[13];
                sums[first + 14] = sixteen[14];
                sums[first + 15] = sixteen[15];
            }
        }
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
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] partner: &[UVec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] sums: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] factors: &mut [UVec4],
) {
    let k = element(id, groups);
    if k < p.count {
        tiles::weigh(k, runs, partner, sums, factors);
    }
}

/// Rows of the ordered irradiance, those of two lanes: [`tiles::expand`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_tiles_expand"))]
#[inline(never)]
pub fn tiles_expand(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] run_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] runs: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] quads: &[TileQuad],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] words: &[UVec2],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] factors: &[UVec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] rows: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let rows_of = tiles::expand(k, run_start, runs, quads, words, factors);
        rows[tiles::row_at(k, 0) as usize] = rows_of[0];
        rows[tiles::row_at(k, 0) as usize + 1] = rows_of[8];
        rows[tiles::row_at(k, 1) as usize] = rows_of[1];
        rows[tiles::row_at(k, 1) as usize + 1] = rows_of[9];
        rows[tiles::row_at(k, 2) as usize] = rows_of[2];
        rows[tiles::row_at(k, 2) as usize + 1] = rows_of[10];
        rows[tiles::row_at(k, 3) as usize] = rows_of[3];
        rows[tiles::row_at(k, 3) as usize + 1] = rows_of[11];
        rows[tiles::row_at(k, 4) as usize] = rows_of[4];
        rows[tiles::row_at(k, 4) as usize + 1] = rows_of[12];
        rows[tiles::row_at(k, 5) as usize] = rows_of[5];
        rows[tiles::row_at(k, 5) as usize + 1] = rows_of[13];
        rows[tiles::row_at(k, 6) as usize] = rows_of[6];
        rows[tiles::row_at(k, 6) as usize + 1] = rows_of[14];
        rows[tiles::row_at(k, 7) as usize] = rows_of[7];
        rows[tiles::row_at(k, 7) as usize + 1] = rows_of[15];
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
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] square_words: &[UVec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] light: &[UVec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] entries: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] steps: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] ordered: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 8)] near: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let eight = tiles::near(k, square_start, squares, square_words, light, row_start, entries, steps, ordered);
        let first = 8 * k as usize;
        near[first] = eight[0];
        near[first + 1] = eight[1];
        near[first + 2] = eight[2];
        near[first + 3] = eight[3];
        near[first + 4] = eight[4];
        near[first + 5] = eight[5];
        near[first + 6] = eight[6];
        near[first + 7] = eight[7];
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
