//! Samples of the surfaces that light comes to, wherever they are in a scene.

use alloc::vec::Vec;

use glam::Vec3;
use scene::parallel::*;
use scene::sampling::{cosine_hemisphere, hammersley, hash3, uniform_triangle, unit};
use scene::{POINT_WALKS, Scene, SurfacePoint, Triangle, is_open};

use super::focus::Density;
use super::nearest::Nearest;
use super::visibility::{SurfacePlace, is_covered, is_visible};
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
/// A dark probe sample, and those near that are asked whether it sees them.
const COMPARED: usize = 7;
/// Walks of a candidate near which probe samples do not agree: one that is left out by mistake has neighbours.
const WALKS: u32 = 3;
const MOST_DISTANCE: f32 = 3.0;
/// The nearest of probe samples that say no is no further than this.
const DARK_DISTANCE: f32 = 1.0;

/// Makes samples of both sides of all triangles, as dense as a [`Density`] says and for equal areas where that is the same
/// everywhere, without those inside of solids, below what stands on a surface or lies close over it, or that see no geometry.
/// A few probe samples are tested by random walks; where they agree, candidates take their answer. In a dark room walks
/// fail: light comes also to what sees geometry and, along the surface, no more dark probe samples than lit ones.
#[derive(Clone)]
pub struct LitSampler<'a> {
    scene: &'a Scene,
    density: Density,
    /// Whether light comes to each probe sample that nothing covers, and where they are.
    lit: Vec<bool>,
    probes: Vec<SurfacePlace>,
    nearest: Nearest,
    total_area: f64,
    lit_area: f64,
    /// Distance between probe samples in the focus, m.
    probe_edge: f32,
}

impl<'a> LitSampler<'a> {
    /// Asks about `probe_samples` samples, and at least 8192. All samples are as dense as `density` says.
    ///
    /// # Errors
    /// [`Error::NoSamples`] when light comes to none of them.
    pub fn new(scene: &'a Scene, probe_samples: u32, density: Density, seed: u32) -> Result<Self, Error> {
        let seed = seed ^ 0x7069_6c6f;
        let probe_samples = even_samples(scene, &density, probe_samples.max(LEAST_PROBES), seed);
        let counted = |sample: &Sample| f64::from(sample.area * triangle_share(scene, &density, sample));
        let total_area = probe_samples.iter().map(counted).sum();
        let probe_edge = scene::math::sqrt((total_area / probe_samples.len() as f64) as f32);
        // What lies in a narrow gap does not speak for the surface that covers it.
        let found = probe_samples.into_par_iter().enumerate().map(|(k, sample)| {
            let sees = density.is_far_and_faces(sample.position, sample.normal);
            let part = part_taken(scene, &sample, sees, k as u32, POINT_WALKS, seed);
            (sample, part, is_sample_covered(scene, &sample))
        });
        let (covered, open): (Vec<_>, Vec<_>) = found.collect::<Vec<_>>().into_iter().partition(|probe| probe.2);
        let probe_samples: Vec<Sample> = open.iter().map(|probe| probe.0).collect();
        let mut parts: Vec<Part> = open.iter().map(|probe| probe.1).collect();
        let nearest = Nearest::new(&probe_samples, &density);
        let probes: Vec<SurfacePlace> = probe_samples.iter().map(SurfacePlace::from).collect();
        light_majorities(scene, &probes, &nearest, |place| probe_edge * density.edge(place.position), &mut parts);
        let lit_parts = covered.iter().map(|probe| &probe.1).chain(&parts).filter(|part| **part == Part::Lit);
        let lit_area = lit_parts.count() as f64 * f64::from(probe_edge * probe_edge);
        if lit_area == 0.0 {
            return Err(Error::NoSamples);
        }
        let lit = parts.into_iter().map(|part| part == Part::Lit).collect();
        Ok(Self { scene, density, lit, probes, nearest, total_area, lit_area, probe_edge })
    }

    /// The scene whose surfaces are asked about.
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// How densely samples stand.
    pub fn density(&self) -> &Density {
        &self.density
    }

    /// About the area to which light comes, both sides of sheets, m², each part counted by its [`Density::share`].
    pub fn lit_area(&self) -> f64 {
        self.lit_area
    }

    /// About `count` samples to which light comes, each for the same area times [`Density::share`].
    pub fn samples(&self, count: u32, seed: u32) -> Vec<Sample> {
        self.lit_samples(self.candidates(count, seed), seed)
    }

    /// Samples of which about `count` are lit, without asking, each for the same area times [`Density::share`].
    pub fn candidates(&self, count: u32, seed: u32) -> Vec<Sample> {
        // No more than memory holds, however little of the surface is lit.
        let candidates = f64::from(count) * (self.total_area / self.lit_area).min(MOST_CANDIDATES);
        even_samples(self.scene, &self.density, candidates as u32, seed)
    }

    /// Those of the samples to which light comes and that nothing covers within a share of the distance between them: in
    /// so narrow a gap it is dark, and whoever interpolates between samples would take the darkness out of it. Where all
    /// are covered they stay.
    pub fn lit_samples(&self, samples: Vec<Sample>, seed: u32) -> Vec<Sample> {
        let lit = |(k, sample): (usize, &Sample)| self.takes_part(sample, k as u32, seed);
        let flags: Vec<bool> = samples.par_iter().enumerate().map(lit).collect();
        let samples: Vec<Sample> =
            samples.into_iter().zip(flags).filter_map(|(sample, lit)| lit.then_some(sample)).collect();
        let open: Vec<Sample> =
            samples.par_iter().filter(|sample| !is_sample_covered(self.scene, sample)).copied().collect();
        if open.is_empty() { samples } else { open }
    }

    /// Whether light comes to the place and side of a sample, which sees geometry; its area and albedo are not asked. The
    /// same place and seed give the same answer.
    pub fn is_lit(&self, sample: &Sample, seed: u32) -> bool {
        let [x, y, z] = sample.position.to_array().map(f32::to_bits);
        self.takes_part(sample, hash3(x, y, z), seed)
    }

    /// The answer of the probe samples where they agree, else of walks with random numbers of its own, else of those that
    /// it sees.
    fn takes_part(&self, sample: &Sample, index: u32, seed: u32) -> bool {
        let (near, found) = self.nearest.samples::<NEIGHBOURS>(sample.position, sample.normal, MOST_DISTANCE);
        match near[..found].iter().filter(|probe| self.lit[probe.0 as usize]).count() {
            // A surface that is left out by mistake is black: dark ones must be many and near.
            0 if found == NEIGHBOURS && near[0].1 < DARK_DISTANCE => return false,
            lit if lit > 0 && lit == found => return true,
            _ => {}
        }
        let sees = self.density.is_far_and_faces(sample.position, sample.normal);
        match part_taken(self.scene, sample, sees, index, WALKS, seed) {
            Part::Lit => true,
            Part::Dark => {
                let edge = self.probe_edge * self.density.edge(sample.position);
                let seen = near[..found].iter().map(|probe| probe.0 as usize);
                let seen = seen.filter(|&k| is_visible(self.scene, sample.into(), self.probes[k], edge));
                is_majority(seen.map(|k| self.lit[k]))
            }
            Part::Apart => false,
        }
    }
}

/// Whether a sample takes part in light transport.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// It sees geometry, and light comes to it.
    Lit,
    /// It sees geometry, and no walk came to light.
    Dark,
    /// It sees no geometry.
    Apart,
}

/// Lights dark samples that see, of those near, no more dark than lit ones; about a place they lie `edge` m from each
/// other. Inside of a hollow wall, where a rare walk comes out by a crack, most stay dark.
fn light_majorities(
    scene: &Scene,
    places: &[SurfacePlace],
    nearest: &Nearest,
    edge: impl Fn(&SurfacePlace) -> f32 + Sync,
    parts: &mut [Part],
) {
    let sees_light = |k: usize| {
        let (near, found) = nearest.samples::<COMPARED>(places[k].position, places[k].normal, MOST_DISTANCE);
        let others = near[..found].iter().map(|probe| probe.0 as usize).filter(|&j| j != k && parts[j] != Part::Apart);
        let edge = edge(&places[k]);
        let seen = others.filter(|&j| is_visible(scene, places[k], places[j], edge));
        is_majority(seen.map(|j| parts[j] == Part::Lit))
    };
    let dark = (0..places.len()).into_par_iter().filter(|&k| parts[k] == Part::Dark);
    let lit: Vec<usize> = dark.filter(|&k| sees_light(k)).collect();
    lit.into_iter().for_each(|k| parts[k] = Part::Lit);
}

/// Whether there are some that are lit, and no more that are not.
fn is_majority(lit: impl Iterator<Item = bool>) -> bool {
    let (mut bright, mut dark) = (0, 0);
    lit.for_each(|lit| if lit { bright += 1 } else { dark += 1 });
    bright > 0 && bright >= dark
}

/// Whether something covers a sample, with others as far from it as the edge of its area.
fn is_sample_covered(scene: &Scene, sample: &Sample) -> bool {
    is_covered(scene, SurfacePlace::from(sample), scene::math::sqrt(sample.area))
}

/// Whether a sample sees geometry, or is known to, and whether light comes to it by so many walks.
pub(super) fn part_taken(scene: &Scene, sample: &Sample, sees: bool, index: u32, walks: u32, seed: u32) -> Part {
    let key = |dimension: u32| hash3(index, dimension, seed ^ 0x6c69_7421);
    let origin = sample.position + sample.normal * scene.geometry.ray_offset;
    let (mut sky, mut met) = (false, sees);
    for k in 0..RAYS {
        let direction = cosine_hemisphere(sample.normal, hammersley(k, RAYS, (key(0), key(1))));
        let hit = scene.closest_before(origin, direction, f32::INFINITY);
        met |= !hit.is_miss() && hit.t > 4.0 * scene.geometry.ray_offset;
        sky |= hit.is_miss();
        if met && sky {
            return Part::Lit;
        }
    }
    let point = SurfacePoint { position: sample.position, patch: 0, normal: sample.normal, weight: 1.0 };
    match met {
        true if is_open(scene, &point, walks, key(2)) => Part::Lit,
        true => Part::Dark,
        false => Part::Apart,
    }
}

/// What an area counts on the triangle of a sample.
fn triangle_share(scene: &Scene, density: &Density, sample: &Sample) -> f32 {
    density.triangle_share(&scene.geometry.triangles[sample.triangle as usize])
}

/// About `count` samples of both sides of all triangles, each for the same area times what that counts: one in each interval
/// of the running sum over the sides. Holes of masked textures have none.
fn even_samples(scene: &Scene, density: &Density, count: u32, seed: u32) -> Vec<Sample> {
    let geometry = scene.tables();
    let triangles = &scene.geometry.triangles;
    let shares: Vec<f32> = triangles.iter().map(|t| density.triangle_share(t)).collect();
    let counted =
        |(t, &share): (&Triangle, &f32)| 0.5 * f64::from(t.edge_a.cross(t.edge_b).length()) * f64::from(share);
    let areas: Vec<f64> = triangles.iter().zip(&shares).map(counted).collect();
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
                        area: area as f32 / shares[triangle],
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
