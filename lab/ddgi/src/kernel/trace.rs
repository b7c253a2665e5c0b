//! Rays of probes: what they meet, and the light that it sends back.

use core::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};
use scene::kernel::bvh::FAR;
use scene::kernel::camera::surface_point;
use scene::kernel::light::{Lights, direct_irradiance};
use scene::kernel::medium::Air;
use scene::{GeometryTables, Hit, Rgb};

use super::lookup::irradiance_at;
use crate::{LookupPoint, Probe, ProbeRay, TraceParams};

/// Share of its distance at which the back of a surface counts for visibility: probes in things are seen from nowhere.
const BACK_DISTANCE: f32 = 0.2;
/// Reflectance for which light of the frame before counts at most, so that it dies out.
const MAX_ALBEDO: f32 = 0.9;

/// Probes as the frame before left them.
#[derive(Clone, Copy)]
pub struct ProbeTables<'a> {
    /// `[probes]`.
    pub probes: &'a [Probe],
    /// H as its root, `[probes · 100]`.
    pub irradiance: &'a [Rgb],
    /// Mean distance, m, and mean square, `[probes · 324]`.
    pub visibility: &'a [Vec2],
}

/// A ray and what it met.
#[derive(Clone, Copy)]
pub struct Met {
    /// Number of the ray among those of all probes, for its random numbers.
    pub index: u32,
    /// Unit direction.
    pub direction: Vec3,
    /// Its hit.
    pub hit: Hit,
}

/// Radiance along a ray, W/m²/sr: ρ/π (H_d + H) of the front of what it met. `occluded(origin, direction, t_max)` tells
/// whether a shadow ray is stopped.
#[inline]
pub fn probe_ray(
    g: &GeometryTables,
    p: &TraceParams,
    lights: &Lights,
    tables: ProbeTables,
    met: Met,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool + Copy,
) -> ProbeRay {
    let Met { index, direction, hit } = met;
    if hit.is_miss() {
        return ProbeRay { radiance: Vec3::ZERO, distance: FAR };
    }
    if p.two_sided == 0 && g.normal(hit.triangle).dot(direction) > 0.0 {
        return ProbeRay { radiance: Vec3::ZERO, distance: -BACK_DISTANCE * hit.t };
    }
    let point = surface_point(g, hit, direction);
    let direct = direct_irradiance(g, &p.direct, index, point, lights, Air, occluded);
    let before = LookupPoint {
        position: point.position.extend(0.0),
        normal: point.normal.extend(0.0),
        to_eye: (-direction).extend(0.0),
    };
    let albedo = g.albedo(hit.triangle, hit.u, hit.v);
    let found = irradiance_at(&p.lookup, &before, tables.probes, tables.irradiance, tables.visibility);
    let indirect = albedo.min(Vec3::splat(MAX_ALBEDO)) * found;
    ProbeRay { radiance: (albedo * direct + indirect) * FRAC_1_PI, distance: hit.t }
}
