//! Photons on all cores: the kernels' bodies over whole paths, with the scene's wide hierarchy.

use alloc::vec::Vec;
use core::cell::Cell;

use scene::kernel::bvh::{FAR, closest_hit, host_occluder};
use scene::parallel::*;
use scene::{GeometryTables, NONE, Scene};

use super::emission::Emission;
use crate::kernel::segment::{is_under_way, photon_hit, reflect};
use crate::kernel::sequence::Sequence;
use crate::kernel::start::{Sources, pick, start_from};
use crate::types::{AliasEntry, Element, PhotonHit, PhotonParams};

/// Photons that one task follows.
const CHUNK: usize = 512;

/// Sources and geometry of photons.
#[derive(Clone, Copy, Debug)]
pub struct PhotonScene<'a> {
    /// Surfaces, and the hierarchy that rays go through.
    pub geometry: GeometryTables<'a>,
    /// Lights and sky.
    pub sources: Sources<'a>,
    /// Distribution over the elements.
    pub alias: &'a [AliasEntry],
    /// Elements that photons start from.
    pub elements: &'a [Element],
}

impl<'a> PhotonScene<'a> {
    /// A scene with its wide hierarchy.
    pub fn new(scene: &'a Scene, emission: &'a Emission) -> Self {
        Self {
            geometry: GeometryTables { hierarchy: scene.geometry.hierarchy(), ..scene.tables() },
            sources: Sources::of(&scene.all_lights()),
            alias: &emission.alias,
            elements: &emission.elements,
        }
    }
}

/// Follows the photons of a dispatch, all their segments; `see` gets every hit. One task follows some hundred photons
/// with a `T` of its own; all of these are given back, in an order that depends on the photons alone.
pub fn trace_photons<T: Send>(
    scene: &PhotonScene,
    p: &PhotonParams,
    start: impl Fn() -> T + Sync,
    see: impl Fn(&mut T, &PhotonHit) + Sync,
) -> Vec<T> {
    if scene.alias.is_empty() {
        return Vec::new();
    }
    let geometry = &scene.geometry;
    // Photons of one element one after the other: what they read first is near, and the hierarchy about it.
    let element = |k: u32| pick(scene.alias, p.element_count, Sequence::of(p, k).element());
    let mut order: Vec<(u32, u32)> = (0..p.count).into_par_iter().map(|k| (element(k), k)).collect();
    order.par_sort_unstable();
    let chunk = |chunk: &[(u32, u32)]| {
        // Places on one element are often in the shadow of one thing.
        let last = Cell::new(NONE);
        let mut own = start();
        for &(chosen, k) in chunk {
            let element = scene.elements[chosen as usize];
            let mut photon = start_from(geometry, &scene.sources, p, element, k, |origin, direction, t_max| {
                let occluder = host_occluder(geometry, origin, direction, t_max, [last.get(), NONE]);
                if occluder != NONE {
                    last.set(occluder);
                }
                occluder != NONE
            });
            while is_under_way(&photon) {
                let hit = closest_hit(geometry, photon.origin, photon.direction, FAR);
                see(&mut own, &photon_hit(geometry, p, k, &photon, hit));
                photon = reflect(geometry, p, k, &photon, hit);
            }
        }
        own
    };
    order.par_chunks(CHUNK).map(chunk).collect()
}
