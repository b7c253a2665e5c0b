//! Entry points of radiosity by samples: what changes, samples of rows, exact sums of some rows, and alias tables.

use ::scene::Rgb;
use ::temporal::kernel::{sample, split, tables};
use ::temporal::{SampleParams, SplitParams, SumParams};
use glam::{UVec2, UVec3};
use spirv_std::spirv;

use crate::invocation::element;
use crate::params::CountParams;

/// Change of the exitance: [`sample::change`].
#[spirv(compute(threads(64), entry_point_name = "temporal_change"))]
#[inline(never)]
pub fn change(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] source: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] albedo: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] irradiance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] change: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let i = k as usize;
        change[i] = sample::change(source[i], albedo[i], irradiance[i], exitance[i]);
    }
}

/// A frame of rows that are lists: [`sample::sample_list`].
#[spirv(compute(threads(64), entry_point_name = "temporal_sample_lists"))]
#[inline(never)]
pub fn sample_lists(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &SampleParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] columns: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] row_sums: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] change: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.rows {
        let previous = irradiance[k as usize];
        irradiance[k as usize] = sample::sample_list(k, p, row_start, columns, row_sums, exitance, change, previous);
    }
}

/// A frame of rows that are alias tables: [`tables::sample_table`].
#[spirv(compute(threads(64), entry_point_name = "temporal_sample_tables"))]
#[inline(never)]
pub fn sample_tables(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &SampleParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] slots: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] columns: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] colors: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] row_sums: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] change: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.rows {
        let previous = irradiance[k as usize];
        irradiance[k as usize] =
            tables::sample_table(k, p, row_start, slots, columns, colors, row_sums, exitance, change, previous);
    }
}

/// Exact sums of some lists: [`sample::sum_list`].
#[spirv(compute(threads(64), entry_point_name = "temporal_sum_lists"))]
#[inline(never)]
pub fn sum_lists(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &SumParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] columns: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] row_sums: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let i = sample::summed_row(k, p);
        let exact = sample::sum_list(i, p, row_start, columns, row_sums, exitance);
        irradiance[i as usize] = sample::settle(irradiance[i as usize], exact);
    }
}

/// Exact sums of some alias tables: [`tables::sum_table`].
#[spirv(compute(threads(64), entry_point_name = "temporal_sum_tables"))]
#[inline(never)]
pub fn sum_tables(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &SumParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] slots: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] columns: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] colors: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] row_sums: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let i = sample::summed_row(k, p);
        let exact = tables::sum_table(i, p, row_start, slots, columns, colors, row_sums, exitance);
        irradiance[i as usize] = sample::settle(irradiance[i as usize], exact);
    }
}

/// Prefix sums of a row's weights: [`split::scan_row`].
#[spirv(compute(threads(64), entry_point_name = "temporal_split_scan"))]
#[inline(never)]
pub fn split_scan(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &SplitParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] weights: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] scan: &mut [UVec2],
) {
    let k = element(id, groups);
    if k < p.count {
        split::scan_row(k, row_start, weights, 0, scan);
    }
}

/// Slot of an entry: [`split::pack_entry`].
#[spirv(compute(threads(64), entry_point_name = "temporal_split_pack"))]
#[inline(never)]
pub fn split_pack(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &SplitParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] weights: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] scan: &[UVec2],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] slots: &mut [u32],
) {
    let k = element(id, groups);
    if k < p.count {
        slots[k as usize] = split::pack_entry(k, p.rows, row_start, weights, scan);
    }
}
