//! Host forms of the kernels of direct light.

use ::scene::gpu::DirectParams;
use ::scene::kernel::{bvh, light};
use ::scene::{Light, NONE, SurfacePoint};
use glam::Vec3;
use rayon::prelude::*;

use super::{HostCall, HostError, geometry, named};
use crate::table::Kernel;

/// Points that a core takes at once: rays from near by to one light are likely to end at the same surface.
const BATCH: usize = 256;

/// Light by light, so that rays which follow each other go the same way.
pub(crate) fn direct_shares(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, parts) = call.parts::<DirectParams, 12>(kernel)?;
    let [points, nodes, triangles, uvs, materials, textures, texels, lights, distributions, changed, shares, occluders] =
        parts;
    let n = p.count as usize;
    let geometry = geometry([nodes, triangles, uvs, materials, textures, texels])?;
    let points = &points.read::<SurfacePoint>(n)?[..n];
    let changed = &changed.read::<u32>(p.light_count as usize)?[..p.light_count as usize];
    let slots = named(changed);
    let lights = lights.read::<Light>(slots)?;
    let distributions = distributions.read::<f32>(0)?;
    let shares = shares.write::<f32>(slots * n)?;
    let occluders = occluders.write::<u32>(slots * n)?;
    for &slot in changed {
        let of_light = slot as usize * n..(slot as usize + 1) * n;
        let parts = shares[of_light.clone()].par_chunks_mut(BATCH);
        let parts = parts.zip(occluders[of_light].par_chunks_mut(BATCH)).zip(points.par_chunks(BATCH));
        parts.enumerate().for_each(|(part, ((shares, occluders), points))| {
            let mut before = NONE;
            for (k, ((share, own), &point)) in shares.iter_mut().zip(occluders).zip(points).enumerate() {
                let at = p.first + (part * BATCH + k) as u32;
                let find = |origin: Vec3, direction: Vec3, t_max: f32, last: u32| {
                    let occluder = bvh::host_occluder(&geometry, origin, direction, t_max, [last, before]);
                    if occluder != NONE {
                        before = occluder;
                    }
                    occluder
                };
                let lamp = &lights[slot as usize];
                (*share, *own) = light::share_and_occluder(&p, at, slot, lamp, distributions, point, *own, find);
            }
        });
    }
    Ok(())
}
