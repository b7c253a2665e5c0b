//! Entry points of photons that start where lights fall first.

use ::firstshot::kernel::{segment, start};
use ::firstshot::{AliasEntry, Element, Landing, Photon, PhotonParams};
use ::scene::kernel::bvh;
use ::scene::{BvhNode, GeometryTables, Light, Material, Rgb, Sky, Texture, Triangle, TriangleUv};
use glam::{UVec3, Vec3};
use spirv_std::spirv;

use crate::invocation::element;

/// Every photon as it leaves its element: [`start::start_photon`].
#[spirv(compute(threads(64), entry_point_name = "firstshot_start"))]
#[inline(never)]
pub fn start(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &PhotonParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] alias: &[AliasEntry],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] elements: &[Element],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] nodes: &[BvhNode],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] triangles: &[Triangle],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] uvs: &[TriangleUv],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] materials: &[Material],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] textures: &[Texture],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] texels: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 8)] lights: &[Light],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 9)] sky: &[Sky],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 10)] sky_map: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 11)] photons: &mut [Photon],
) {
    let k = element(id, groups);
    if k < p.count {
        let geometry = GeometryTables { nodes, triangles, uvs, materials, textures, texels };
        let sources = start::Sources { lights, sky: sky[0], sky_map };
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| bvh::any_hit(&geometry, origin, direction, t_max);
        photons[k as usize] = start::start_photon(&geometry, &sources, p, alias, elements, k, stopped);
    }
}

/// The next segment of every photon: where it lands, and the photon reflected there: [`segment::land`],
/// [`segment::reflect`].
#[spirv(compute(threads(64), entry_point_name = "firstshot_segment"))]
#[inline(never)]
pub fn segment(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &PhotonParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] nodes: &[BvhNode],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] triangles: &[Triangle],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] uvs: &[TriangleUv],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] materials: &[Material],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] textures: &[Texture],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] texels: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] photons: &mut [Photon],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] landings: &mut [Landing],
) {
    let k = element(id, groups);
    if k < p.count {
        let geometry = GeometryTables { nodes, triangles, uvs, materials, textures, texels };
        let photon = photons[k as usize];
        let mut landing = segment::NO_LANDING;
        if photon.flux != Vec3::ZERO {
            let hit = bvh::closest_hit(&geometry, photon.origin, photon.direction, bvh::FAR);
            landing = segment::land(&geometry, k, &photon, hit);
            photons[k as usize] = segment::reflect(&geometry, p, k, &photon, hit);
        }
        landings[k as usize] = landing;
    }
}
