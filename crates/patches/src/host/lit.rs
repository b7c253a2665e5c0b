//! Samples of the surfaces that light comes to, wherever they are in a scene.

use std::vec::Vec;

use glam::Vec3;
use rayon::prelude::*;
use scene::sampling::{cosine_hemisphere, hammersley, hash3, uniform_triangle, unit};
use scene::{POINT_WALKS, Scene, SurfacePoint, is_open};

use super::nearest::Nearest;
use crate::error::Error;
use crate::types::Sample;

/// Rays by which a sample looks for geometry and for the sky.
const RAYS: u32 = 16;
/// Candidates for a sample, at most.
const MOST_CANDIDATES: f64 = 30.0;
const LEAST_PROBES: u32 = 8192;
/// A candidate takes the answer of probe samples that agree: as many as there are, up to this many, within this many
/// of their edges.
const NEIGHBOURS: usize = 4;
/// Walks of a candidate near which probe samples do not agree: one that is left out by mistake has neighbours.
const WALKS: u32 = 3;
const MOST_DISTANCE: f32 = 3.0;
/// The nearest of probe samples that say no is no further than this.
const DARK_DISTANCE: f32 = 1.0;

/// Makes equal-area samples of both sides of all triangles, without those inside of solids, below what stands on a surface,
/// or that see no geometry. A few probe samples are tested by random walks; where they agree, candidates take their
/// answer.
#[derive(Clone)]
pub struct LitSampler<'a> {
    scene: &'a Scene,
    /// Whether light comes to each probe sample, and where they are.
    lit: Vec<bool>,
    nearest: Nearest,
    total_area: f64,
    lit_area: f64,
    /// Dark probe samples are believed up to this distance, in their edges.
    dark_distance: f32,
}

impl<'a> LitSampler<'a> {
    /// Asks about `probe_samples` samples, and at least 8192.
    ///
    /// # Errors
    /// [`Error::NoSamples`] when light comes to none of them.
    pub fn new(scene: &'a Scene, probe_samples: u32, seed: u32) -> Result<Self, Error> {
        let seed = seed ^ 0x7069_6c6f;
        let probe_samples = equal_area_samples(scene, probe_samples.max(LEAST_PROBES), seed);
        let lit: Vec<bool> = probe_samples
            .par_iter()
            .enumerate()
            .map(|(k, s)| takes_part(scene, s, k as u32, POINT_WALKS, seed))
            .collect();
        let lit_area = probe_samples.iter().zip(&lit).filter(|(_, lit)| **lit).map(|(s, _)| f64::from(s.area)).sum();
        if lit_area == 0.0 {
            return Err(Error::NoSamples);
        }
        let total_area = probe_samples.iter().map(|s| f64::from(s.area)).sum();
        Ok(Self {
            scene,
            nearest: Nearest::new(&probe_samples),
            lit,
            total_area,
            lit_area,
            dark_distance: DARK_DISTANCE,
        })
    }

    /// Believes probe samples that no light comes to only up to so many metres off. In a scene so large that its probes lie
    /// further from each other than its floors are thick, those inside of a floor would speak for the room above it.
    /// What is dark then takes walks of its own.
    #[must_use]
    pub fn dark_within(mut self, metres: f32) -> Self {
        let edge = scene::math::sqrt((self.total_area / self.lit.len() as f64) as f32);
        self.dark_distance = DARK_DISTANCE.min(metres / edge);
        self
    }

    /// The scene whose surfaces are asked about.
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// About the area to which light comes, both sides of sheets, m².
    pub fn lit_area(&self) -> f64 {
        self.lit_area
    }

    /// About `count` samples to which light comes, each for the same area.
    pub fn samples(&self, count: u32, seed: u32) -> Vec<Sample> {
        self.lit_samples(self.candidates(count, seed), seed)
    }

    /// Samples of which about `count` are lit, without asking, each for the same area.
    pub fn candidates(&self, count: u32, seed: u32) -> Vec<Sample> {
        // No more than memory holds, however little of the surface is lit.
        let candidates = f64::from(count) * (self.total_area / self.lit_area).min(MOST_CANDIDATES);
        equal_area_samples(self.scene, candidates as u32, seed)
    }

    /// Those of the samples to which light comes.
    pub fn lit_samples(&self, samples: Vec<Sample>, seed: u32) -> Vec<Sample> {
        let lit = |(k, sample): (usize, &Sample)| self.takes_part(sample, k as u32, seed);
        let flags: Vec<bool> = samples.par_iter().enumerate().map(lit).collect();
        samples.into_iter().zip(flags).filter_map(|(sample, lit)| lit.then_some(sample)).collect()
    }

    /// Whether light comes to the place and side of a sample, which sees geometry; its area and albedo are not asked. The
    /// same place and seed give the same answer.
    pub fn is_lit(&self, sample: &Sample, seed: u32) -> bool {
        let [x, y, z] = sample.position.to_array().map(f32::to_bits);
        self.takes_part(sample, hash3(x, y, z), seed)
    }

    /// The answer of the probe samples where they agree, else of walks with random numbers of their own.
    fn takes_part(&self, sample: &Sample, index: u32, seed: u32) -> bool {
        self.verdict(sample).unwrap_or_else(|| takes_part(self.scene, sample, index, WALKS, seed))
    }

    /// Whether light comes to a sample, where the probe samples round it agree.
    fn verdict(&self, sample: &Sample) -> Option<bool> {
        let (near, found) = self.nearest.samples::<NEIGHBOURS>(sample.position, sample.normal, MOST_DISTANCE);
        match near[..found].iter().filter(|&&(k, _)| self.lit[k as usize]).count() {
            _ if found == 0 => None,
            // A surface that is left out by mistake is black: dark ones must be many and near.
            0 => (found == NEIGHBOURS && near[0].1 < self.dark_distance).then_some(false),
            lit if lit == found => Some(true),
            _ => None,
        }
    }
}

/// Whether a sample sees geometry and light comes to it.
fn takes_part(scene: &Scene, sample: &Sample, index: u32, walks: u32, seed: u32) -> bool {
    let key = |dimension: u32| hash3(index, dimension, seed ^ 0x6c69_7421);
    let origin = sample.position + sample.normal * scene.geometry.ray_offset;
    let (mut sky, mut met) = (false, false);
    for k in 0..RAYS {
        let direction = cosine_hemisphere(sample.normal, hammersley(k, RAYS, (key(0), key(1))));
        let hit = scene.closest_before(origin, direction, f32::INFINITY);
        met |= !hit.is_miss() && hit.t > 4.0 * scene.geometry.ray_offset;
        sky |= hit.is_miss();
        if met && sky {
            return true;
        }
    }
    let point = SurfacePoint { position: sample.position, patch: 0, normal: sample.normal, weight: 1.0 };
    met && is_open(scene, &point, walks, key(2))
}

/// About `count` samples of both sides of all triangles, each for the same area: one in each interval of the running sum of
/// the sides' areas. Holes of masked textures have none.
fn equal_area_samples(scene: &Scene, count: u32, seed: u32) -> Vec<Sample> {
    let geometry = scene.tables();
    let areas: Vec<f64> =
        scene.geometry.triangles.iter().map(|t| 0.5 * f64::from(t.edge_a.cross(t.edge_b).length())).collect();
    let area = 2.0 * areas.iter().sum::<f64>() / f64::from(count);
    let (mut samples, mut sum, mut next) = (Vec::with_capacity(count as usize), 0.0, 0u32);
    let place = |k: u32| area * (f64::from(k) + f64::from(unit(hash3(k, 0x7374_6570, seed))));
    for side in 0..2 {
        for (triangle, &own) in areas.iter().enumerate() {
            sum += own;
            let mut k = 0u32;
            while place(next) < sum {
                // An additive recurrence (Roberts 2018), from a start of its own on each side.
                let word = |step: u32, salt: u32| {
                    unit(k.wrapping_mul(step).wrapping_add(hash3(triangle as u32, side + salt, seed)))
                };
                let (u, v) = uniform_triangle((word(0xc13f_a9a9, 2), word(0x91e1_0da6, 4)));
                let normal = geometry.normal(triangle as u32);
                if !geometry.is_hole(triangle as u32, u, v) {
                    let position = geometry.position(triangle as u32, u, v);
                    samples.push(Sample {
                        position,
                        area: area as f32,
                        normal: if side == 0 { normal } else { -normal },
                        triangle: triangle as u32,
                        albedo: Vec3::ZERO,
                        reserved: 0,
                    });
                }
                (next, k) = (next + 1, k + 1);
            }
        }
    }
    samples.par_iter_mut().for_each(|s| s.albedo = scene.filtered_albedo(s.triangle, s.position, s.area));
    samples
}
