//! Kernels of photons that start where lights fall first.

use ::firstshot::kernel::{segment, start};
use ::firstshot::{AliasEntry, Element, Photon, PhotonHit, PhotonParams};
use ::scene::kernel::bvh;
use ::scene::{Light, Rgb, Sky};
use glam::Vec3;

kernels! {
    /// Every photon as it leaves what it starts from: [`start::start_photon`]. One invocation
    /// per photon.
    FIRSTSHOT_START = "firstshot_start"(p: PhotonParams) for k in 0..count {
        alias: read [AliasEntry; p.element_count as usize],
        elements: read [Element; p.element_count as usize],
        geometry: GeometryTables,
        lights: read [Light],
        sky: read [Sky; 1],
        sky_map: read [Rgb],
        distributions: read [f32],
        photons: write [Photon],
    } each {
        let sources = start::Sources { lights, sky: sky[0], sky_map, distributions };
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
            bvh::any_hit(&geometry, origin, direction, t_max)
        };
        start::start_photon(&geometry, &sources, p, alias, elements, k, stopped)
    }

    /// The next segment of every photon: where it lands, and the photon as it goes on:
    /// [`segment::photon_hit`], [`segment::reflect`]. One invocation per photon.
    FIRSTSHOT_SEGMENT = "firstshot_segment"(p: PhotonParams) for k in 0..count {
        geometry: GeometryTables,
        photons: update [Photon],
        photon_hits: write [PhotonHit],
    } invocation {
        let photon = photons[k as usize];
        let mut photon_hit = segment::NO_PHOTON_HIT;
        if photon.flux != Vec3::ZERO {
            let hit = bvh::closest_hit(&geometry, photon.origin, photon.direction, bvh::FAR);
            photon_hit = segment::photon_hit(&geometry, k, &photon, hit);
            photons[k as usize] = segment::reflect(&geometry, p, k, &photon, hit);
        }
        photon_hits[k as usize] = photon_hit;
    } host crate::host::firstshot::segment;
}
