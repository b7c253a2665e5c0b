//! Inputs of the kernels of photons: every kind of element, with and without shadow rays.

use std::ops::ControlFlow;

use firstshot::{Emission, LightElementSettings, Photon, PhotonHit, PhotonParams, SEQUENCE_SOBOL, Texels};
use glam::Vec3;
use scene::Scene;

use super::{Random, Tables, buffer, call, room};

/// Photons of a dispatch.
const PHOTONS: u32 = 700;

pub(super) fn own_tables(r: &mut Random, name: &str, scene: &Scene) -> (u32, Vec<u8>, Tables) {
    let settings = LightElementSettings { elements: 2000, longest: 0.2, ..LightElementSettings::default() };
    let go_on = |_, _| ControlFlow::Continue(());
    // Both ways to shoot together have all kinds of elements.
    let mut emission = Emission::first_shot(scene, &settings, Texels::Bound, true, &go_on).expect("lights shine");
    let lamps = Emission::classical(scene).expect("lights shine");
    emission.elements.truncate(600);
    emission.elements.extend(&lamps.elements[..lamps.elements.len().min(600)]);
    emission.alias = firstshot::alias_table(&vec![1.0; emission.elements.len()]);
    let p = PhotonParams {
        low: emission.bounds.0,
        count: PHOTONS,
        high: emission.bounds.1,
        per_batch: 100,
        first: 40,
        first_batch: 3,
        element_count: emission.elements.len() as u32,
        sequence: SEQUENCE_SOBOL,
        seed: 9,
        flags: emission.flags,
        ray_offset: scene.geometry.ray_offset,
        reserved: 0,
    };
    let tables = if name == "firstshot_start" {
        let photons = room::<Photon>("photons", PHOTONS as usize);
        vec![buffer("alias", &emission.alias), buffer("elements", &emission.elements), photons]
    } else {
        // Some that are no more, some that miss the scene.
        let photon = |_| Photon {
            origin: r.vector() * 2.0,
            reflections: r.below(3),
            direction: r.direction(),
            segments: r.below(4),
            flux: if r.below(8) == 0 { Vec3::ZERO } else { r.vector() },
            reserved: 0,
        };
        let photons: Vec<Photon> = (0..PHOTONS).map(photon).collect();
        vec![buffer("photons", &photons), room::<PhotonHit>("photon_hits", PHOTONS as usize)]
    };
    call(PHOTONS, p, tables)
}
