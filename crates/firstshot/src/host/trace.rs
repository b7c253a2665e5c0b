//! Photons on all cores: the kernels' bodies over whole paths, with the scene's wide hierarchy.

use std::vec::Vec;

use glam::Vec3;
use rayon::prelude::*;
use scene::Scene;
use scene::kernel::bvh::FAR;

use super::emission::Emission;
use crate::kernel::segment::{land, reflect};
use crate::kernel::start::{Sources, start_photon};
use crate::types::{Landing, PhotonParams};

/// Photons that one task follows.
const CHUNK: u32 = 512;

/// Where the photons of a dispatch land, photon by photon, segment by segment: what the kernels `firstshot_start` and
/// `firstshot_segment` give, in another order.
pub fn trace_photons(scene: &Scene, emission: &Emission, p: &PhotonParams) -> Vec<Landing> {
    if emission.is_dark() {
        return Vec::new();
    }
    let geometry = scene.geometry();
    let sources = Sources { lights: &scene.lights, sky: scene.sky, sky_map: &scene.sky_map };
    let occluded = |origin: Vec3, direction: Vec3, t_max: f32| scene.occluded(origin, direction, t_max);
    let chunk = |chunk: u32| {
        let mut landings = Vec::with_capacity(3 * CHUNK as usize);
        for k in chunk * CHUNK..((chunk + 1) * CHUNK).min(p.count) {
            let mut photon = start_photon(&geometry, &sources, p, &emission.alias, &emission.elements, k, occluded);
            while photon.flux != Vec3::ZERO {
                let hit = scene.closest_before(photon.origin, photon.direction, FAR);
                landings.push(land(&geometry, k, &photon, hit));
                photon = reflect(&geometry, p, k, &photon, hit);
            }
        }
        landings
    };
    let parts: Vec<Vec<Landing>> = (0..p.count.div_ceil(CHUNK)).into_par_iter().map(chunk).collect();
    parts.concat()
}
