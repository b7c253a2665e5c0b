//! Entry points of the product with tiles: the exitance in their order, the sums of their vectors, the rows.

use ::multibounce::TileComponent;
use ::multibounce::kernel::tiles;
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

/// Sums of the slots: [`tiles::project`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_tiles_project"))]
#[inline(never)]
pub fn tiles_project(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] components: &[TileComponent],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] words: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] ordered: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] sums: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        sums[k as usize] = tiles::project(k, components, words, ordered);
    }
}

/// Rows of the ordered irradiance: [`tiles::expand`].
#[spirv(compute(threads(64), entry_point_name = "multibounce_tiles_expand"))]
#[inline(never)]
pub fn tiles_expand(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] use_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] uses: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] components: &[TileComponent],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] words: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] sums: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] entries: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] steps: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 8)] ordered: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 9)] rows: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        rows[k as usize] =
            tiles::expand(k, use_start, uses, components, words, sums, row_start, entries, steps, ordered);
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
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        irradiance[k as usize] = tiles::leave(k, place, root, rows);
    }
}
