//! The number of an invocation: the one convention of all kernels.

use glam::UVec3;

/// Invocations of a workgroup, for every kernel.
pub const WORKGROUP: u32 = 64;

/// Number of this invocation. A dispatch is at most 65,535 workgroups wide (the least `maxComputeWorkGroupCount`);
/// what is more goes on in further rows of workgroups.
#[inline]
pub fn index(id: UVec3, groups: UVec3) -> u32 {
    id.x + id.y * groups.x * WORKGROUP
}

/// Number of this workgroup in the same order, for kernels whose workgroups share the work.
#[inline]
pub fn group_index(group: UVec3, groups: UVec3) -> u32 {
    group.x + group.y * groups.x
}
