//! Which probes are moved, and which are off (Majercik et al. 2021, sections 4 and 5).

use ::ddgi::Probe;
use glam::Vec3;
use rayon::prelude::*;
use scene::Scene;
use scene::kernel::bvh::FAR;

use super::{DdgiSettings, Grid};
use crate::harmonics::spherical_fibonacci;

/// Rays of a probe that find where it is; the same in every frame.
const FIXED_RAYS: u32 = 32;
/// A probe that sees more of the backs of surfaces is inside of something.
const MAX_BACKS: f32 = 0.25;
/// Moves of a probe, and the most that they may add up to, in spacings.
const MOVES: u32 = 5;
const MAX_MOVE: f32 = 0.45;
/// Least distance of a probe from the front of a surface, in least spacings.
const MIN_FRONT: f32 = 0.2;

/// Hits of the fixed rays of a probe.
struct Sight {
    backs: f32,
    back: (f32, Vec3),
    front: (f32, Vec3),
    farthest: (f32, Vec3),
    /// True if a front is within a cell of the probe.
    is_near: bool,
}

/// Moves and classifies all probes.
pub fn place(scene: &Scene, grid: &Grid, settings: &DdgiSettings) -> Vec<Probe> {
    let directions = spherical_fibonacci(FIXED_RAYS);
    let one = |probe: usize| {
        let home = grid.position(probe);
        let mut position = home;
        for _ in 0..if settings.relocation { MOVES } else { 0 } {
            position = home + moved(&look(scene, grid, settings, &directions, position), grid, position - home);
        }
        let sight = look(scene, grid, settings, &directions, position);
        let is_active = !settings.classification || (sight.backs <= MAX_BACKS && sight.is_near);
        Probe { position, is_active: u32::from(is_active) }
    };
    (0..grid.count()).into_par_iter().map(one).collect()
}

fn look(scene: &Scene, grid: &Grid, settings: &DdgiSettings, directions: &[Vec3], origin: Vec3) -> Sight {
    let tables = scene.tables();
    let nothing = (FAR, Vec3::ZERO);
    let mut sight = Sight { backs: 0.0, back: nothing, front: nothing, farthest: (0.0, Vec3::ZERO), is_near: false };
    for &direction in directions {
        let hit = scene.closest_before(origin, direction, FAR);
        if hit.is_miss() {
            continue;
        }
        if !settings.two_sided && tables.normal(hit.triangle).dot(direction) > 0.0 {
            sight.backs += 1.0 / directions.len() as f32;
            if hit.t < sight.back.0 {
                sight.back = (hit.t, direction);
            }
            continue;
        }
        if hit.t < sight.front.0 {
            sight.front = (hit.t, direction);
        }
        if hit.t > sight.farthest.0 {
            sight.farthest = (hit.t, direction);
        }
        // Points of a cell that the probe takes part in are at most a spacing away along each axis.
        sight.is_near |= (direction * hit.t).abs().cmple(grid.spacing).all();
    }
    sight
}

/// The offset after one more move; the old one where the new one would be too far from home.
fn moved(sight: &Sight, grid: &Grid, offset: Vec3) -> Vec3 {
    let least = MIN_FRONT * grid.spacing.min_element();
    let new = if sight.backs > MAX_BACKS {
        // Out through the nearest back.
        offset + sight.back.1 * (sight.back.0 + 0.5 * least)
    } else if sight.front.0 < least {
        // Away from the nearest front, towards where there is most room.
        if sight.front.1.dot(sight.farthest.1) > 0.0 {
            return offset;
        }
        offset + sight.farthest.1 * sight.farthest.0.min(least)
    } else {
        // Home again, as far as there is room.
        let back = (sight.front.0 - least).min(offset.length());
        offset - offset.normalize_or_zero() * back
    };
    if (new / grid.spacing).length() < MAX_MOVE { new } else { offset }
}
