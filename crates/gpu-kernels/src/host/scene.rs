//! Host forms of the kernels of direct light.

use std::cell::Cell;

use ::scene::kernel::{bvh, light};
use ::scene::{DirectParams, Light, Occluder, SurfacePoint};
use glam::Vec3;
use rayon::prelude::*;

use super::{HostCall, HostError, geometry, named};
use crate::table::Kernel;

/// Points that a core takes at once: rays from near by to one light are likely to end at the same surface.
const TOGETHER: usize = 256;

/// Light by light, so that rays which follow each other go the same way.
pub(crate) fn direct_shares(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [points, nodes, triangles, uvs, materials, textures, texels, lights, changed, shares]) =
        call.parts::<DirectParams, 10>(kernel)?;
    let n = p.count as usize;
    let geometry = geometry([nodes, triangles, uvs, materials, textures, texels])?;
    let points = &points.read::<SurfacePoint>(n)?[..n];
    let changed = &changed.read::<u32>(p.light_count as usize)?[..p.light_count as usize];
    let slots = named(changed);
    let lights = lights.read::<Light>(slots)?;
    let shares = shares.write::<f32>(slots * n)?;
    for &slot in changed {
        let of_light = &mut shares[slot as usize * n..(slot as usize + 1) * n];
        let parts = of_light.par_chunks_mut(TOGETHER).zip(points.par_chunks(TOGETHER)).enumerate();
        parts.for_each(|(part, (shares, points))| {
            let last = Cell::new(Occluder::default());
            let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
                bvh::any_hit_again(&geometry, origin, direction, t_max, &last)
            };
            for (k, (share, &point)) in shares.iter_mut().zip(points).enumerate() {
                let at = p.first + (part * TOGETHER + k) as u32;
                *share = light::irradiance_share(&p, at, slot, &lights[slot as usize], point, stopped);
            }
        });
    }
    Ok(())
}
