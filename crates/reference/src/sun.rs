//! Light that parallel lights send onto surfaces, as a table of lit points to connect path vertices with.
//!
//! A room lit through an opening has its indirect light from small bright spots that cosine-weighted rays seldom find.
//! So points are picked on a plane across the light, followed to the first surface, and every path vertex is connected
//! with one of them; the balance heuristic shares the work with the rays that find the spots by chance. Where on the
//! plane to pick is learned from training paths.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use scene::gpu::LIGHT_DIRECTIONAL;
use scene::kernel::bvh::FAR;
use scene::kernel::camera::surface_point;
use scene::math::luminance;
use scene::sampling::{cosine_hemisphere, frame, hammersley, hash3};
use scene::{Light, Scene, SurfacePoint};

use crate::sampler::Sampler;

/// Cells of the plane along each axis.
const CELLS: usize = 64;
/// Share of the points that ignores what was learned.
const UNIFORM_SHARE: f64 = 0.1;
/// Bounces of a training path.
const TRAINING_BOUNCES: u32 = 6;

/// A point lit by a parallel light.
#[derive(Clone, Copy, Default)]
pub(crate) struct LitPoint {
    pub(crate) position: Vec3,
    /// Unit normal of the lit side.
    pub(crate) normal: Vec3,
    /// Radiance it sends divided by `density`, W/sr; 0 where the light met nothing.
    pub(crate) flux: Vec3,
    /// Probability density of this point, 1/m² of its surface.
    pub(crate) density: f32,
}

/// Hit of a training path in parallel light: which light, where, and how much it mattered.
pub(crate) type SunHit = (usize, Vec3, f32);

/// The distributions of all parallel lights.
pub(crate) struct SunGuide {
    /// By light; empty for other kinds.
    suns: Vec<Option<Sun>>,
}

struct Sun {
    light: Light,
    /// Share of the points that this light gets.
    share: f32,
    axes: (Vec3, Vec3),
    /// Least coordinates along the axes and size of a cell, m.
    low: Vec2,
    cell: Vec2,
    /// Start of rays along the direction of travel.
    start: f32,
    /// Cumulative probability of the cells, the last exactly 1.
    cumulative: Vec<f32>,
}

impl SunGuide {
    /// Learns from hits; `None` without parallel light.
    pub(crate) fn new(scene: &Scene, hits: &[SunHit]) -> Option<Self> {
        let power = |l: &Light| if l.kind == LIGHT_DIRECTIONAL { luminance(l.color).max(0.0) } else { 0.0 };
        let total: f32 = scene.lighting.lights.iter().map(power).sum();
        if total <= 0.0 {
            return None;
        }
        let mut suns: Vec<_> = scene
            .lighting
            .lights
            .iter()
            .map(|l| (power(l) > 0.0).then(|| Sun::new(scene, l, power(l) / total)))
            .collect();
        let mut weights = vec![vec![0.0f64; CELLS * CELLS]; suns.len()];
        for (slot, position, weight) in hits {
            if let Some(sun) = &suns[*slot] {
                weights[*slot][sun.cell_of(*position)] += f64::from(*weight);
            }
        }
        for (sun, weights) in suns.iter_mut().zip(&weights) {
            if let Some(sun) = sun {
                sun.learn(weights);
            }
        }
        Some(Self { suns })
    }

    /// Density of the light's points on a plane across it, 1/m².
    #[inline]
    pub(crate) fn density(&self, slot: usize, position: Vec3) -> f32 {
        self.suns[slot].as_ref().map_or(0.0, |sun| sun.density(sun.cell_of(position)))
    }

    /// `count` points, the same for the same seed.
    pub(crate) fn lit_points(&self, scene: &Scene, count: u32, seed: u32) -> Vec<LitPoint> {
        let shift = (hash3(1, 0, seed), hash3(2, 0, seed));
        let pick = |k: u32| {
            let u = hammersley(k, count, shift);
            let mut x = u.0;
            let mut chosen = None;
            for sun in self.suns.iter().flatten() {
                chosen = Some(sun);
                if x < sun.share {
                    break;
                }
                x -= sun.share;
            }
            chosen.map_or(LitPoint::default(), |sun| {
                sun.lit_point(scene, ((x / sun.share).clamp(0.0, 1.0), u.1), hash3(k, 3, seed))
            })
        };
        (0..count).into_par_iter().map(pick).collect()
    }
}

impl Sun {
    fn new(scene: &Scene, light: &Light, share: f32) -> Self {
        let axes = frame(light.direction);
        let mut low = Vec2::INFINITY;
        let mut high = Vec2::NEG_INFINITY;
        let mut start = f32::INFINITY;
        for k in 0..8 {
            let side = |bit: u32, axis: usize| {
                if k >> bit & 1 == 0 { scene.geometry.bounds.0[axis] } else { scene.geometry.bounds.1[axis] }
            };
            let corner = Vec3::new(side(0, 0), side(1, 1), side(2, 2));
            let p = Vec2::new(corner.dot(axes.0), corner.dot(axes.1));
            (low, high) = (low.min(p), high.max(p));
            start = start.min(corner.dot(light.direction));
        }
        let margin = scene.diagonal() * 1e-3;
        let cell = (high - low + 2.0 * margin) / CELLS as f32;
        Self { light: *light, share, axes, low: low - margin, cell, start: start - margin, cumulative: Vec::new() }
    }

    fn learn(&mut self, weights: &[f64]) {
        let total: f64 = weights.iter().sum();
        let uniform = 1.0 / weights.len() as f64;
        let mut sum = 0.0;
        self.cumulative = weights
            .iter()
            .map(|w| {
                let learned = if total > 0.0 { w / total } else { uniform };
                sum += UNIFORM_SHARE * uniform + (1.0 - UNIFORM_SHARE) * learned;
                sum as f32
            })
            .collect();
        if let Some(last) = self.cumulative.last_mut() {
            *last = 1.0;
        }
    }

    #[inline]
    fn cell_of(&self, position: Vec3) -> usize {
        let p = (Vec2::new(position.dot(self.axes.0), position.dot(self.axes.1)) - self.low) / self.cell;
        let limit = (CELLS - 1) as f32;
        p.y.clamp(0.0, limit) as usize * CELLS + p.x.clamp(0.0, limit) as usize
    }

    #[inline]
    fn probability(&self, cell: usize) -> f32 {
        self.cumulative[cell] - if cell == 0 { 0.0 } else { self.cumulative[cell - 1] }
    }

    #[inline]
    fn density(&self, cell: usize) -> f32 {
        self.share * self.probability(cell) / (self.cell.x * self.cell.y)
    }

    fn lit_point(&self, scene: &Scene, u: (f32, f32), random: u32) -> LitPoint {
        let cell = self.cumulative.partition_point(|c| *c <= u.0).min(CELLS * CELLS - 1);
        let within = Vec2::new(scene::sampling::unit(random), u.1);
        let p = self.low + (Vec2::new((cell % CELLS) as f32, (cell / CELLS) as f32) + within) * self.cell;
        let origin = self.axes.0 * p.x + self.axes.1 * p.y + self.light.direction * self.start;
        let hit = scene.closest_before(origin, self.light.direction, FAR);
        if hit.is_miss() {
            return LitPoint::default();
        }
        let geometry = scene.tables();
        let point = surface_point(&geometry, hit, self.light.direction);
        let cosine = -point.normal.dot(self.light.direction);
        // The cell of the point, as a path that lands there finds it: rounding may put it across a border.
        let across = self.density(self.cell_of(point.position));
        let color = self.light.color * scene.transmittance(FAR);
        let radiance = geometry.albedo(hit.triangle, hit.u, hit.v) * color * (cosine * FRAC_1_PI);
        let density = across * cosine;
        let flux = if density > 0.0 { radiance / density } else { Vec3::ZERO };
        LitPoint { position: point.position, normal: point.normal, flux, density }
    }
}

/// Follows a path from a point and notes where it is in parallel light.
pub(crate) fn training_path(scene: &Scene, start: SurfacePoint, sampler: &mut Sampler) -> Vec<SunHit> {
    let geometry = scene.tables();
    let mut hits = Vec::new();
    let mut point = start;
    let mut throughput = 1.0f32;
    for _ in 0..TRAINING_BOUNCES {
        let origin = point.position + point.normal * scene.geometry.ray_offset;
        let direction = cosine_hemisphere(point.normal, sampler.next());
        let hit = scene.closest_before(origin, direction, FAR);
        if hit.is_miss() {
            break;
        }
        throughput *= luminance(geometry.albedo(hit.triangle, hit.u, hit.v));
        point = surface_point(&geometry, hit, direction);
        let origin = point.position + point.normal * scene.geometry.ray_offset;
        for (slot, light) in scene.lighting.lights.iter().enumerate() {
            let cosine = -point.normal.dot(light.direction);
            if light.kind == LIGHT_DIRECTIONAL && cosine > 0.0 && !scene.occluded(origin, -light.direction, FAR) {
                hits.push((slot, point.position, throughput * cosine * luminance(light.color) / PI));
            }
        }
    }
    hits
}
