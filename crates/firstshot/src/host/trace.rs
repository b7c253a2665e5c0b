//! Photons on all cores: the kernels' bodies over whole paths, with the scene's wide hierarchy.

use std::cell::Cell;
use std::vec::Vec;

use glam::Vec3;
use rayon::prelude::*;
use scene::kernel::bvh::FAR;
use scene::{Occluder, Scene};

use super::emission::Emission;
use crate::kernel::segment::{photon_hit, reflect};
use crate::kernel::sequence::Sequence;
use crate::kernel::start::{Sources, pick, start_from};
use crate::types::{PhotonHit, PhotonParams};

/// Photons that one task follows.
const CHUNK: usize = 512;

/// Where the photons of a dispatch land, photon by photon, segment by segment: what the kernels `firstshot_start` and
/// `firstshot_segment` give, in another order.
pub fn trace_photons(scene: &Scene, emission: &Emission, p: &PhotonParams) -> Vec<PhotonHit> {
    if emission.is_dark() {
        return Vec::new();
    }
    let geometry = scene.tables();
    let sources = Sources::of(&scene.all_lights());
    // Photons of one element one after the other: what they read first is near, and the hierarchy about it.
    let element = |k: u32| pick(&emission.alias, p.element_count, Sequence::of(p, k).element());
    let mut order: Vec<(u32, u32)> = (0..p.count).into_par_iter().map(|k| (element(k), k)).collect();
    order.par_sort_unstable();
    let chunk = |chunk: &[(u32, u32)]| {
        // Places on one element are often in the shadow of one thing.
        let last = Cell::new(Occluder::default());
        let occluded =
            |origin: Vec3, direction: Vec3, t_max: f32| scene.occluded_again(origin, direction, t_max, &last);
        let mut hits = Vec::with_capacity(3 * CHUNK);
        for &(chosen, k) in chunk {
            let element = emission.elements[chosen as usize];
            let mut photon = start_from(&geometry, &sources, p, element, k, occluded);
            while photon.flux != Vec3::ZERO {
                let hit = scene.closest_before(photon.origin, photon.direction, FAR);
                hits.push(photon_hit(&geometry, k, &photon, hit));
                photon = reflect(&geometry, p, k, &photon, hit);
            }
        }
        hits
    };
    let parts: Vec<Vec<PhotonHit>> = order.par_chunks(CHUNK).map(chunk).collect();
    parts.concat()
}
