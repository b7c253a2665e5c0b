//! Entry points of the virtual patches: means over samples, and lookups between patches and between probes in the air.

use ::patches::kernel::{gather, lookup, volume};
use ::patches::{LookupParams, LookupPatch, Member, VolumeParams};
use ::scene::{Rgb, SurfacePoint};
use glam::UVec3;
use spirv_std::spirv;

use crate::invocation::element;
use crate::params::CountParams;

/// Mean of a quantity over the samples of every patch: [`gather::gather_mean`].
#[spirv(compute(threads(64), entry_point_name = "patches_gather_mean"))]
#[inline(never)]
pub fn gather_mean(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] offsets: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] members: &[Member],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] values: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] means: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        means[k as usize] = gather::gather_mean(k, offsets, members, values);
    }
}

/// Value of the patches round every point: [`lookup::lookup`].
#[spirv(compute(threads(64), entry_point_name = "patches_lookup"))]
#[inline(never)]
pub fn lookup(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &LookupParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] cells: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] offsets: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] entries: &[LookupPatch],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] values: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] points: &[SurfacePoint],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let point = points[k as usize];
        irradiance[k as usize] = lookup::lookup(p, cells, offsets, entries, values, point.position, point.normal);
    }
}

/// Irradiance of the ambient cubes round every point: [`volume::volume_lookup`].
#[spirv(compute(threads(64), entry_point_name = "patches_volume_lookup"))]
#[inline(never)]
pub fn volume_lookup(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &VolumeParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] probes: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] planes: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] cubes: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] points: &[SurfacePoint],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let point = points[k as usize];
        irradiance[k as usize] = volume::volume_lookup(p, probes, planes, cubes, point.position, point.normal);
    }
}

/// Irradiance of the spherical harmonics round every point: [`volume::volume_lookup_sh`].
#[spirv(compute(threads(64), entry_point_name = "patches_volume_lookup_sh"))]
#[inline(never)]
pub fn volume_lookup_sh(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &VolumeParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] probes: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] planes: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] harmonics: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] points: &[SurfacePoint],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let point = points[k as usize];
        irradiance[k as usize] = volume::volume_lookup_sh(p, probes, planes, harmonics, point.position, point.normal);
    }
}
