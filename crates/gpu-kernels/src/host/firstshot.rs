//! Host forms of the kernels of photons.

use ::firstshot::kernel::segment;
use ::firstshot::{Photon, PhotonHit, PhotonParams};
use ::scene::kernel::bvh;
use glam::Vec3;
use rayon::prelude::*;

use super::{HostCall, HostError, geometry};
use crate::table::Kernel;

pub(crate) fn segment(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [nodes, triangles, uvs, materials, textures, texels, photons, photon_hits]) =
        call.parts::<PhotonParams, 8>(kernel)?;
    let n = p.count as usize;
    let geometry = geometry([nodes, triangles, uvs, materials, textures, texels])?;
    let (photons, photon_hits) = (photons.write::<Photon>(n)?, photon_hits.write::<PhotonHit>(n)?);
    photons.par_iter_mut().zip(photon_hits).with_min_len(32).enumerate().for_each(|(k, (photon, photon_hit))| {
        *photon_hit = segment::NO_PHOTON_HIT;
        if photon.flux != Vec3::ZERO {
            let hit = bvh::closest_hit(&geometry, photon.origin, photon.direction, bvh::FAR);
            *photon_hit = segment::photon_hit(&geometry, k as u32, photon, hit);
            *photon = segment::reflect(&geometry, &p, k as u32, photon, hit);
        }
    });
    Ok(())
}
