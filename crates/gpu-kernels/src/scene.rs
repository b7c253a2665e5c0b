//! Entry points over the scene: rays, direct light, primary visibility, shading, tone mapping.

use ::scene::kernel::{bvh, camera, light, shade};
use ::scene::{
    BvhNode, DirectParams, Emitter, GeometryTables, Hit, Light, Lights, Material, Ray, Rgb, Sky, SurfacePoint, Texture,
    Triangle, TriangleUv,
};
use glam::{UVec3, Vec3};
use spirv_std::spirv;

use crate::invocation::element;
use crate::params::{CountParams, PixelParams, ToneMapParams};

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
        let geometry = GeometryTables { nodes, triangles, uvs, materials, textures, texels };
        let ray = rays[k as usize];
        hits[k as usize] = bvh::closest_hit(&geometry, ray.origin, ray.direction, ray.t_max);
    }
}

/// 1 for every ray that is stopped, else 0: [`bvh::any_hit`].
#[spirv(compute(threads(64), entry_point_name = "scene_any_hit"))]
#[inline(never)]
pub fn any_hit(
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
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] stopped: &mut [u32],
) {
    let k = element(id, groups);
    if k < p.count {
        let geometry = GeometryTables { nodes, triangles, uvs, materials, textures, texels };
        let ray = rays[k as usize];
        stopped[k as usize] = bvh::any_hit(&geometry, ray.origin, ray.direction, ray.t_max) as u32;
    }
}

/// Direct irradiance at every point: [`light::direct_irradiance`] with shadow rays by [`bvh::any_hit`].
#[spirv(compute(threads(64), entry_point_name = "scene_direct_light"))]
#[inline(never)]
pub fn direct_light(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &DirectParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] points: &[SurfacePoint],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] nodes: &[BvhNode],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] triangles: &[Triangle],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] uvs: &[TriangleUv],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] materials: &[Material],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] textures: &[Texture],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] texels: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] lights: &[Light],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 8)] emitters: &[Emitter],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 9)] sky: &[Sky],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 10)] sky_map: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 11)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let geometry = GeometryTables { nodes, triangles, uvs, materials, textures, texels };
        let lights = Lights { lights, emitters, sky: sky[0], sky_map };
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| bvh::any_hit(&geometry, origin, direction, t_max);
        let light = light::direct_irradiance(&geometry, p, p.first + k, points[k as usize], &lights, stopped);
        irradiance[k as usize] = light.extend(0.0);
    }
}

/// What every pixel's primary ray meets, as a hit and as a point to be lit: [`camera::primary_hit`], [`camera::surface_point`].
#[spirv(compute(threads(64), entry_point_name = "scene_primary"))]
#[inline(never)]
pub fn primary(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &PixelParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] nodes: &[BvhNode],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] triangles: &[Triangle],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] uvs: &[TriangleUv],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] materials: &[Material],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] textures: &[Texture],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] texels: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] hits: &mut [Hit],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] points: &mut [SurfacePoint],
) {
    let k = element(id, groups);
    if k < p.count {
        let geometry = GeometryTables { nodes, triangles, uvs, materials, textures, texels };
        let hit = camera::primary_hit(&geometry, &p.camera, k, p.seed);
        let direction = camera::primary_direction(&p.camera, k, p.seed);
        hits[k as usize] = hit;
        points[k as usize] = camera::surface_point(&geometry, hit, direction);
    }
}

/// Adds the radiance of one sub-frame to every pixel's sum: [`shade::add_sub_frame`].
#[spirv(compute(threads(64), entry_point_name = "scene_shade"))]
#[inline(never)]
pub fn shade(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &PixelParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] hits: &[Hit],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] direct: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] indirect: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] nodes: &[BvhNode],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] triangles: &[Triangle],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] uvs: &[TriangleUv],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] materials: &[Material],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] textures: &[Texture],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 8)] texels: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 9)] lights: &[Light],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 10)] emitters: &[Emitter],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 11)] sky: &[Sky],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 12)] sky_map: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 13)] sum: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let geometry = GeometryTables { nodes, triangles, uvs, materials, textures, texels };
        let lights = Lights { lights, emitters, sky: sky[0], sky_map };
        let i = k as usize;
        sum[i] = shade::add_sub_frame(
            &geometry,
            &lights,
            p.light_count,
            &p.camera,
            p.seed,
            k,
            hits[i],
            direct[i],
            indirect[i],
            sum[i],
        );
    }
}

/// Displayed colour of every pixel: [`shade::tone_map`].
#[spirv(compute(threads(64), entry_point_name = "scene_tone_map"))]
#[inline(never)]
pub fn tone_map(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &ToneMapParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] sum: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] pixels: &mut [u32],
) {
    let k = element(id, groups);
    if k < p.count {
        pixels[k as usize] = shade::tone_map(sum[k as usize], p.scale);
    }
}
