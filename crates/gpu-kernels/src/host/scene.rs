//! Host forms of the kernels over the scene.

use ::scene::kernel::{bvh, camera, light, shade};
use ::scene::{DirectParams, GeometryTables, Hit, Lights, Ray, Rgb, Sky, SurfacePoint};
use glam::Vec3;
use rayon::prelude::*;

use super::{Bound, HostCall, HostError, agreed, fill};
use crate::params::{CountParams, PixelParams, ToneMapParams};
use crate::table::Kernel;

/// Tables of the scene from their bindings, in the order in which all kernels have them.
pub(super) fn geometry<'s>(bound: [Bound<'s, '_>; 6]) -> Result<GeometryTables<'s>, HostError> {
    let [nodes, triangles, uvs, materials, textures, texels] = bound;
    Ok(GeometryTables {
        nodes: nodes.read(1)?,
        triangles: triangles.read(1)?,
        uvs: uvs.read(1)?,
        materials: materials.read(1)?,
        textures: textures.read(0)?,
        texels: texels.read(0)?,
    })
}

/// Everything that shines, in the order in which all kernels have it.
fn all_lights<'s>(bound: [Bound<'s, '_>; 4]) -> Result<Lights<'s>, HostError> {
    let [lights, emitters, sky, sky_map] = bound;
    Ok(Lights {
        lights: lights.read(0)?,
        emitters: emitters.read(0)?,
        sky: sky.read::<Sky>(1)?[0],
        sky_map: sky_map.read(0)?,
    })
}

pub(crate) fn closest_hit(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [rays, a, b, c, d, e, f, hits]) = call.parts::<CountParams, 8>(kernel)?;
    let n = agreed(elements, p.count)?;
    let (rays, geometry) = (rays.read::<Ray>(n)?, geometry([a, b, c, d, e, f])?);
    fill(hits.write(n)?, |k| {
        let ray = rays[k as usize];
        bvh::closest_hit(&geometry, ray.origin, ray.direction, ray.t_max)
    });
    Ok(())
}

pub(crate) fn any_hit(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [rays, a, b, c, d, e, f, stopped]) = call.parts::<CountParams, 8>(kernel)?;
    let n = agreed(elements, p.count)?;
    let (rays, geometry) = (rays.read::<Ray>(n)?, geometry([a, b, c, d, e, f])?);
    fill(stopped.write(n)?, |k| {
        let ray = rays[k as usize];
        u32::from(bvh::any_hit(&geometry, ray.origin, ray.direction, ray.t_max))
    });
    Ok(())
}

pub(crate) fn direct_light(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [points, a, b, c, d, e, f, g, h, i, j, irradiance]) = call.parts::<DirectParams, 12>(kernel)?;
    let n = agreed(elements, p.count)?;
    let points = points.read::<SurfacePoint>(n)?;
    let (geometry, lights) = (geometry([a, b, c, d, e, f])?, all_lights([g, h, i, j])?);
    let stopped = |origin: Vec3, direction: Vec3, t_max: f32| bvh::any_hit(&geometry, origin, direction, t_max);
    fill(irradiance.write::<Rgb>(n)?, |k| {
        light::direct_irradiance(&geometry, &p, p.first + k, points[k as usize], &lights, stopped).extend(0.0)
    });
    Ok(())
}

pub(crate) fn primary(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [a, b, c, d, e, f, hits, points]) = call.parts::<PixelParams, 8>(kernel)?;
    let n = agreed(elements, p.count)?;
    let geometry = geometry([a, b, c, d, e, f])?;
    let (hits, points) = (hits.write::<Hit>(n)?, points.write::<SurfacePoint>(n)?);
    hits.par_iter_mut().zip(points).with_min_len(32).enumerate().for_each(|(k, (hit, point))| {
        let k = k as u32;
        *hit = camera::primary_hit(&geometry, &p.camera, k, p.seed);
        *point = camera::surface_point(&geometry, *hit, camera::primary_direction(&p.camera, k, p.seed));
    });
    Ok(())
}

pub(crate) fn shade(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [hits, direct, indirect, a, b, c, d, e, f, g, h, i, j, sum]) = call.parts::<PixelParams, 14>(kernel)?;
    let n = agreed(elements, p.count)?;
    let (hits, direct, indirect) = (hits.read::<Hit>(n)?, direct.read::<Rgb>(n)?, indirect.read::<Rgb>(n)?);
    let (geometry, lights) = (geometry([a, b, c, d, e, f])?, all_lights([g, h, i, j])?);
    sum.write::<Rgb>(n)?.par_iter_mut().with_min_len(32).enumerate().for_each(|(k, sum)| {
        *sum = shade::add_sub_frame(
            &geometry,
            &lights,
            p.light_count,
            &p.camera,
            p.seed,
            k as u32,
            hits[k],
            direct[k],
            indirect[k],
            *sum,
        );
    });
    Ok(())
}

pub(crate) fn tone_map(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [sum, pixels]) = call.parts::<ToneMapParams, 2>(kernel)?;
    let n = agreed(elements, p.count)?;
    let sum = sum.read::<Rgb>(n)?;
    fill(pixels.write(n)?, |k| shade::tone_map(sum[k as usize], p.scale));
    Ok(())
}
