//! Which sides of the triangles take part in the exchange of light.

use glam::Vec3;
use rayon::prelude::*;
use scene::math::sin_cos_turn;
use scene::sampling::{cosine_hemisphere, hammersley, hash3, uniform_triangle};
use scene::{LIGHT_DIRECTIONAL, NONE, Scene, Visibility};
use std::vec::Vec;

/// The sides of a triangle that have patches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sides {
    /// The side from which the corners run counter-clockwise.
    pub front: bool,
    /// The other side.
    pub back: bool,
}

/// How the sides are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SidePolicy {
    /// Sides that see geometry, unless they belong to a closed space that neither the outside, a light nor an emitter
    /// reaches (the inside of a solid). A side that sees no geometry is seen by none, so leaving it out changes nothing.
    #[default]
    Lit,
    /// Fronts only.
    Front,
    /// Both sides of everything.
    Both,
}

/// Probe rays a side.
const PROBES: u32 = 64;
/// Rays from each point-like or rectangle light.
const LIGHT_RAYS: u32 = 4096;

/// Chooses the sides of every triangle. [`SidePolicy::Lit`] casts 64 cosine-weighted rays from each side and joins the
/// sides that see each other: what is joined neither to the outside nor to a light stays without patches.
pub fn find_sides(scene: &Scene, policy: SidePolicy) -> Vec<Sides> {
    let count = scene.triangles.len();
    match policy {
        SidePolicy::Front => return vec![Sides { front: true, back: false }; count],
        SidePolicy::Both => return vec![Sides { front: true, back: true }; count],
        SidePolicy::Lit => {}
    }
    let geometry = scene.geometry();
    let side_of = |triangle: u32, direction: Vec3| {
        2 * triangle as usize + usize::from(geometry.normal(triangle).dot(direction) > 0.0)
    };
    let outside = 2 * count;
    // What the rays of each side meet; a surface that touches closes the side.
    let met: Vec<Vec<usize>> = (0..2 * count)
        .into_par_iter()
        .map(|side| {
            let triangle = (side / 2) as u32;
            let normal = if side % 2 == 0 { geometry.normal(triangle) } else { -geometry.normal(triangle) };
            let mut list = Vec::new();
            for k in 0..PROBES {
                let place = hammersley(k, PROBES, (hash3(side as u32, 1, 0), hash3(side as u32, 2, 0)));
                let turn =
                    hammersley(k.reverse_bits() >> 26, PROBES, (hash3(side as u32, 3, 0), hash3(side as u32, 4, 0)));
                let (u, v) = uniform_triangle(place);
                let direction = cosine_hemisphere(normal, turn);
                let hit = scene.closest(geometry.position(triangle, u, v) + normal * scene.ray_offset, direction);
                if hit.is_miss() {
                    list.push(outside);
                } else if hit.t > 4.0 * scene.ray_offset {
                    list.push(side_of(hit.triangle, direction));
                }
            }
            list.sort_unstable();
            list.dedup();
            list
        })
        .collect();

    let mut group = Groups((0..=outside).collect());
    let mut sees = vec![false; 2 * count];
    for (side, list) in met.iter().enumerate() {
        for &other in list {
            group.join(side, other);
            if other != outside {
                sees[side] = true;
                sees[other] = true;
            }
        }
    }
    for e in &scene.emitters {
        group.join(outside, 2 * e.triangle as usize);
    }
    for light in scene.lights.iter().filter(|l| l.kind != LIGHT_DIRECTIONAL) {
        let origin = light.position + (light.edge_a + light.edge_b) * 0.5;
        for k in 0..LIGHT_RAYS {
            let (x, y) = hammersley(k, LIGHT_RAYS, (0, 0));
            let z = 1.0 - 2.0 * x;
            let (s, c) = sin_cos_turn(y);
            let r = scene::math::sqrt((1.0 - z * z).max(0.0));
            let direction = Vec3::new(r * c, r * s, z);
            let hit = scene.closest(origin, direction);
            if hit.triangle != NONE {
                group.join(outside, side_of(hit.triangle, direction));
            }
        }
    }
    let lit = group.root(outside);
    (0..count)
        .map(|t| {
            let mut alive = |side: usize| sees[side] && group.root(side) == lit;
            Sides { front: alive(2 * t), back: alive(2 * t + 1) }
        })
        .collect()
}

/// Disjoint sets (Tarjan 1975, path halving).
struct Groups(Vec<usize>);

impl Groups {
    fn root(&mut self, mut k: usize) -> usize {
        while self.0[k] != k {
            self.0[k] = self.0[self.0[k]];
            k = self.0[k];
        }
        k
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        let (low, high) = (a.min(b), a.max(b));
        self.0[low] = high;
    }
}
