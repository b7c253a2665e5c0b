//! Which sides of the triangles take part in light transport.

use alloc::vec;
use alloc::vec::Vec;

use crate::parallel::*;
use glam::Vec3;

use crate::kernel::bvh::FAR;
use crate::kernel::walk;
use crate::sampling::{cosine_hemisphere, hammersley, hash3, uniform_triangle};
use crate::{Scene, SurfacePoint, Visibility};

/// The sides of a triangle that have patches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sides {
    /// The side from which the corners run counter-clockwise.
    pub front: bool,
    /// The other side.
    pub back: bool,
}

/// Choice of sides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SidePolicy {
    /// Sides that see geometry, unless they close a space that no light enters: the inside of a solid, also of one
    /// without a bottom that stands on a floor. A side that sees no geometry is seen by none, so leaving it out changes
    /// nothing.
    #[default]
    Lit,
    /// Fronts only.
    Front,
    /// Both sides of everything.
    Both,
}

/// Random walks from a side; each is one of its probe rays.
const WALKS: u32 = 32;

/// Chooses the sides of every triangle. [`SidePolicy::Lit`] sends 32 random walks of at most 16 diffuse reflections
/// from each side; a side is lit if one of them leaves the scene, meets an emitter or comes to a point that sees a
/// light or a random place of an emitter. At mirrors and glass half of the walks go on as light does. Walks go from
/// point to point, so light on the open part of a floor does not enter a column that stands on it.
pub fn find_sides(scene: &Scene, policy: SidePolicy) -> Vec<Sides> {
    let count = scene.geometry.triangles.len();
    match policy {
        SidePolicy::Front => return vec![Sides { front: true, back: false }; count],
        SidePolicy::Both => return vec![Sides { front: true, back: true }; count],
        SidePolicy::Lit => {}
    }
    find_lit_sides(scene, |_, _| false)
}

/// The sides by [`SidePolicy::Lit`], where those that are known to see geometry, by triangle and normal, need not meet
/// it by their walks.
pub fn find_lit_sides(scene: &Scene, sees: impl Fn(u32, Vec3) -> bool + Sync) -> Vec<Sides> {
    let side = |t: usize, normal: Vec3| takes_part(scene, t as u32, normal, sees(t as u32, normal));
    let normal = |t: usize| scene.tables().normal(t as u32);
    let triangles = (0..scene.geometry.triangles.len()).into_par_iter();
    triangles.map(|t| Sides { front: side(t, normal(t)), back: side(t, -normal(t)) }).collect()
}

/// Returns true if the side of a triangle with this normal sees geometry, or is known to, and is lit.
fn takes_part(scene: &Scene, triangle: u32, normal: Vec3, mut sees: bool) -> bool {
    let geometry = scene.host_tables();
    let lamps = scene.lamps();
    let params = scene.walk_params(WALKS, 0);
    let is_back = u32::from(geometry.normal(triangle).dot(normal) < 0.0);
    let key = |dimension: u32| hash3(2 * triangle + is_back, dimension, 0);
    let mut lit = false;
    for k in 0..WALKS {
        let (u, v) = uniform_triangle(hammersley(k, WALKS, (key(0), key(1))));
        let xi = hammersley(k.reverse_bits() >> 27, WALKS, (key(2), key(3)));
        let direction = cosine_hemisphere(normal, xi);
        let hit = scene.closest(geometry.position(triangle, u, v) + normal * scene.geometry.ray_offset, direction);
        // A surface that touches closes the side.
        if walk::touches(hit, params.ray_offset) {
            continue;
        }
        sees |= !hit.is_miss();
        lit = lit || walk::finds_light(&geometry, &lamps, &params, hit, direction, hash3(key(4), k, 0));
        if sees && lit {
            return true;
        }
    }
    false
}

/// Random walks from a point that are enough where the answer matters by itself.
pub const POINT_WALKS: u32 = 8;

/// Returns true if light comes to a point: a point inside of a solid, as where a column stands on a floor, has none. By
/// this many random walks as in [`find_sides`].
pub fn is_open(scene: &Scene, point: &SurfacePoint, walks: u32, seed: u32) -> bool {
    walk::is_open(&scene.host_tables(), &scene.lamps(), &scene.walk_params(walks, 0), *point, seed)
}

/// Rays by which [`is_inside`] looks about.
const LOOKS: u32 = 8;

/// Returns true for a point inside of what is closed and stands on a surface: all that is seen from there are backs, and
/// no light comes ([`is_open`]).
pub fn is_inside(scene: &Scene, point: &SurfacePoint) -> bool {
    let tables = scene.host_tables();
    let origin = point.position + point.normal * scene.geometry.ray_offset;
    let sees_back = |k: u32| {
        let direction = cosine_hemisphere(point.normal, hammersley(k, LOOKS, (0, 0)));
        let hit = scene.closest_before(origin, direction, FAR);
        !hit.is_miss() && tables.normal(hit.triangle).dot(direction) > 0.0
    };
    let [x, y, z] = point.position.to_array().map(f32::to_bits);
    (0..LOOKS).all(sees_back) && !is_open(scene, point, POINT_WALKS, hash3(x, y, z))
}

/// Result of [`walk::reachability`] for a place: whether it sees geometry, and whether light comes to it by so many
/// walks.
pub fn reachability(scene: &Scene, point: &SurfacePoint, walks: u32, seed: u32) -> u32 {
    walk::reachability(&scene.host_tables(), &scene.lamps(), &scene.walk_params(walks, seed), *point)
}
