//! Entry points of the matrix round a camera: light of merged patches, lists of slots, the product between them, what the
//! patches get of it, and updates of the matrix.

use ::localmatrix::kernel;
use ::localmatrix::kernel::BLOCK;
use ::localmatrix::{FadeParams, SlotParams, UpdateParams};
use ::scene::Rgb;
use glam::{UVec2, UVec3, Vec4};
use spirv_std::spirv;

use crate::invocation::element;
use crate::params::CountParams;

/// Mean exitance of the leaves of each slot: [`kernel::mean`].
#[spirv(compute(threads(64), entry_point_name = "localmatrix_mean"))]
#[inline(never)]
pub fn mean(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] runs: &[UVec2],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] area: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] light: &mut [Rgb],
) {
    let slot = element(id, groups);
    if slot < p.count {
        let run = runs[slot as usize];
        light[slot as usize] = kernel::mean(run.x, run.y, area, exitance);
    }
}

/// Slots of each block that go into a list: [`kernel::count`].
#[spirv(compute(threads(64), entry_point_name = "localmatrix_count"))]
#[inline(never)]
pub fn count(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &SlotParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] values: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] counts: &mut [u32],
) {
    let block = element(id, groups);
    if block < p.count {
        counts[block as usize] = kernel::count(block, p.slots, values);
    }
}

/// Where each block begins in the list: [`kernel::start`].
#[spirv(compute(threads(64), entry_point_name = "localmatrix_start"))]
#[inline(never)]
pub fn start(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] counts: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] starts: &mut [u32],
) {
    let block = element(id, groups);
    if block < p.count {
        starts[block as usize] = kernel::start(block, counts);
    }
}

/// The slot at each place of a list: [`kernel::compact`].
#[spirv(compute(threads(64), entry_point_name = "localmatrix_compact"))]
#[inline(never)]
pub fn compact(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] starts: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] values: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] list: &mut [u32],
) {
    let place = element(id, groups);
    if place < p.count {
        list[place as usize] = kernel::compact(place, p.count, starts, values);
    }
}

/// Irradiance of the visible slots from the lit ones, and 0 at the others: [`kernel::gather`].
#[spirv(compute(threads(64), entry_point_name = "localmatrix_product"))]
#[inline(never)]
#[allow(clippy::too_many_arguments)]
pub fn product(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &SlotParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] lit_starts: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] lit: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] visible_starts: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] visible: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] red: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] green: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] blue: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] root: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 8)] light: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 9)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let slot = visible[k as usize];
        let end = p.slots.div_ceil(BLOCK) as usize;
        // Invocations beyond the visible slots have nothing to sum; each slot is named once.
        let lit_count = if k < visible_starts[end] { lit_starts[end] } else { 0 };
        irradiance[slot as usize] = kernel::gather(slot, p.slots, lit_count, lit, red, green, blue, root, light);
    }
}

/// Irradiance of each leaf: [`kernel::spread`].
#[spirv(compute(threads(64), entry_point_name = "localmatrix_spread"))]
#[inline(never)]
pub fn spread(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] slot_of: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] irradiance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] leaves: &mut [Rgb],
) {
    let leaf = element(id, groups);
    if leaf < p.count {
        leaves[leaf as usize] = kernel::spread(slot_of[leaf as usize], irradiance);
    }
}

/// What is left of jumps of the light: [`kernel::fade`].
#[spirv(compute(threads(64), entry_point_name = "localmatrix_fade"))]
#[inline(never)]
pub fn fade(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &FadeParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] before: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] now: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] offset: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let i = k as usize;
        offset[i] = kernel::fade(offset[i], before[i], now[i], p);
    }
}

/// Irradiance of each patch, with what is left of jumps: [`kernel::show`].
#[spirv(compute(threads(64), entry_point_name = "localmatrix_show"))]
#[inline(never)]
pub fn show(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] leaf_of: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] now: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] offset: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        irradiance[k as usize] = kernel::show(leaf_of[k as usize], now, offset);
    }
}

/// Four entries of a plane after an update: [`kernel::update`].
#[spirv(compute(threads(64), entry_point_name = "localmatrix_update"))]
#[inline(never)]
pub fn update(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &UpdateParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] vectors: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] columns: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] place: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] plane: &mut [f32],
) {
    let k = element(id, groups);
    if k < p.count {
        let at = 4 * k as usize;
        let old = Vec4::new(plane[at], plane[at + 1], plane[at + 2], plane[at + 3]);
        let new = kernel::update(k, p, vectors, columns, place, old);
        plane[at] = new.x;
        plane[at + 1] = new.y;
        plane[at + 2] = new.z;
        plane[at + 3] = new.w;
    }
}
