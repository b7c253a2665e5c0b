//! Entry points over the scene: rays, direct light, primary visibility, shading, tone mapping.

use ::scene::kernel::bvh;
use ::scene::{BvhNode, Geometry, Hit, Material, Ray, Texture, Triangle, TriangleUv};
use glam::UVec3;
use spirv_std::spirv;

use crate::invocation::element;
use crate::params::CountParams;

/// Nearest hit of every ray: [`bvh::closest_hit`].
#[spirv(compute(threads(64), entry_point_name = "scene_closest_hit"))]
#[inline(never)]
pub fn closest_hit(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] rays: &[Ray],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] nodes: &[BvhNode],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] triangles: &[Triangle],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] uvs: &[TriangleUv],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] materials: &[Material],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] textures: &[Texture],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] texels: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] hits: &mut [Hit],
) {
    let k = element(id, groups);
    if k < p.count {
        let geometry = Geometry { nodes, triangles, uvs, materials, textures, texels };
        let ray = rays[k as usize];
        hits[k as usize] = bvh::closest_hit(&geometry, ray.origin, ray.direction, ray.t_max);
    }
}
