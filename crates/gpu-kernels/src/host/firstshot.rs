//! Host forms of the kernels of photons.

use ::firstshot::kernel::{segment, start};
use ::firstshot::{AliasEntry, Element, Landing, Photon, PhotonParams};
use ::scene::Sky;
use ::scene::kernel::bvh;
use glam::Vec3;
use rayon::prelude::*;

use super::scene::geometry;
use super::{HostCall, HostError, agreed, fill};
use crate::table::Kernel;

pub(crate) fn start(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [alias, pieces, a, b, c, d, e, f, g, h, i, photons]) = call.parts::<PhotonParams, 12>(kernel)?;
    let n = agreed(elements, p.count)?;
    let alias = alias.read::<AliasEntry>(p.element_count as usize)?;
    let pieces = pieces.read::<Element>(p.element_count as usize)?;
    let geometry = geometry([a, b, c, d, e, f])?;
    let sources = start::Sources { lights: g.read(0)?, sky: h.read::<Sky>(1)?[0], sky_map: i.read(0)? };
    let stopped = |origin: Vec3, direction: Vec3, t_max: f32| bvh::any_hit(&geometry, origin, direction, t_max);
    fill(photons.write(n)?, |k| start::start_photon(&geometry, &sources, &p, alias, pieces, k, stopped));
    Ok(())
}

pub(crate) fn segment(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [a, b, c, d, e, f, photons, landings]) = call.parts::<PhotonParams, 8>(kernel)?;
    let n = agreed(elements, p.count)?;
    let geometry = geometry([a, b, c, d, e, f])?;
    let (photons, landings) = (photons.write::<Photon>(n)?, landings.write::<Landing>(n)?);
    photons.par_iter_mut().zip(landings).with_min_len(32).enumerate().for_each(|(k, (photon, landing))| {
        *landing = segment::NO_LANDING;
        if photon.flux != Vec3::ZERO {
            let hit = bvh::closest_hit(&geometry, photon.origin, photon.direction, bvh::FAR);
            *landing = segment::land(&geometry, k as u32, photon, hit);
            *photon = segment::reflect(&geometry, &p, k as u32, photon, hit);
        }
    });
    Ok(())
}
