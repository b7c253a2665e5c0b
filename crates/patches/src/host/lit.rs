//! Samples of the surfaces that light comes to, wherever they are in a scene.

use alloc::vec::Vec;

use glam::Vec3;
use scene::gpu::Triangle;
use scene::kernel::walk::{APART, DARK, LIT};
use scene::parallel::*;
use scene::sampling::{hash3, uniform_triangle, unit};
use scene::{POINT_WALKS, Ray, Scene, SurfacePoint, reachability};
use transport::check_length;

use super::focus::Density;
use super::nearest::Nearest;
use super::visibility::{SurfacePlace, is_covered, is_visible};
use crate::error::Error;
use crate::types::Sample;

/// Candidates for a sample, at most.
const MAX_CANDIDATES: f64 = 30.0;
const MIN_PROBES: u32 = 8192;
/// A candidate takes the answer of probe samples that agree: as many as there are, up to this many, within this many
/// of their edges.
const NEIGHBOURS: usize = 4;
/// A dark probe sample, and those near that are asked whether it sees them.
const COMPARED: usize = 7;
/// Walks of a candidate near which probe samples do not agree: one that is left out by mistake has neighbours.
const WALKS: u32 = 3;
const MAX_DISTANCE: f32 = 3.0;
/// The nearest of probe samples that say no is no further than this.
const DARK_DISTANCE: f32 = 1.0;

/// Who walks from places to light, and looks from place to place, in the host's stead.
pub trait Walker: Sync {
    /// Result of [`scene::reachability`] for each place, by so many walks.
    ///
    /// # Errors
    /// [`Error::Rows`] with the walker's own.
    fn reachability(&self, scene: &Scene, places: &[SurfacePoint], walks: u32, seed: u32) -> Result<Vec<u32>, Error>;

    /// 1 for each ray that something stops, else 0.
    ///
    /// # Errors
    /// [`Error::Rows`] with the walker's own.
    fn stopped(&self, scene: &Scene, rays: &[Ray]) -> Result<Vec<u32>, Error>;
}

/// Makes samples of both sides of all triangles, as dense as a [`Density`] says and for equal areas where that is the
/// same everywhere, without those inside of solids, below what stands on a surface or lies close over it, or that see
/// no geometry. A few probe samples are tested by random walks; where they agree, candidates take their answer. In a
/// dark room walks fail: light comes also to what sees geometry and, along the surface, no more dark probe samples than
/// lit ones.
#[derive(Clone)]
pub struct LitSampler<'a> {
    scene: &'a Scene,
    density: Density,
    walker: Option<&'a dyn Walker>,
    /// Reachability of light at each uncovered probe sample, and their places.
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
        Self::with_walker(None, scene, probe_samples, density, seed)
    }

    /// [`LitSampler::new`] with somebody who walks for all samples that are asked about together; without, the host
    /// does.
    ///
    /// # Errors
    /// As [`LitSampler::new`]; what the walker says.
    pub fn with_walker(
        walker: Option<&'a dyn Walker>,
        scene: &'a Scene,
        probe_samples: u32,
        density: Density,
        seed: u32,
    ) -> Result<Self, Error> {
        let seed = seed ^ 0x7069_6c6f;
        let probe_samples = even_samples(scene, &density, probe_samples.max(MIN_PROBES), seed);
        let total_area =
            probe_samples.iter().map(|sample| f64::from(sample.area * triangle_share(scene, &density, sample))).sum();
        let probe_edge = scene::math::sqrt((total_area / probe_samples.len() as f64) as f32);
        let places: Vec<SurfacePoint> =
            (0u32..).zip(&probe_samples).map(|(k, sample)| place_of(sample, &density, k)).collect();
        let parts = reachability_of(walker, scene, &places, POINT_WALKS, seed)?;
        // What lies in a narrow gap does not speak for the surface that covers it.
        let is_covered = probe_samples.par_iter().map(|sample| is_sample_covered(scene, sample));
        let found = is_covered.collect::<Vec<bool>>().into_iter().zip(probe_samples.into_iter().zip(parts));
        let (covered, open): (Vec<_>, Vec<_>) = found.partition(|probe| probe.0);
        let probe_samples: Vec<Sample> = open.iter().map(|probe| probe.1.0).collect();
        let mut parts: Vec<u32> = open.iter().map(|probe| probe.1.1).collect();
        let nearest = Nearest::new(&probe_samples, &density);
        let probes: Vec<SurfacePlace> = probe_samples.iter().map(SurfacePlace::from).collect();
        light_majorities(scene, &probes, &nearest, |place| probe_edge * density.edge(place.position), &mut parts);
        let lit_parts = covered.iter().map(|probe| &probe.1.1).chain(&parts).filter(|part| **part == LIT);
        let lit_area = lit_parts.count() as f64 * f64::from(probe_edge * probe_edge);
        if lit_area == 0.0 {
            return Err(Error::NoSamples);
        }
        let lit = parts.into_iter().map(|part| part == LIT).collect();
        Ok(Self { scene, density, walker, lit, probes, nearest, total_area, lit_area, probe_edge })
    }

    /// The scene whose surfaces are asked about.
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// Who walks and looks in the host's stead, if there is somebody.
    pub(crate) fn walker(&self) -> Option<&'a dyn Walker> {
        self.walker
    }

    /// Density of samples.
    pub fn density(&self) -> &Density {
        &self.density
    }

    /// About the area to which light comes, both sides of sheets, m², each part counted by its [`Density::share`].
    pub fn lit_area(&self) -> f64 {
        self.lit_area
    }

    /// About `count` samples to which light comes, each for the same area times [`Density::share`].
    ///
    /// # Errors
    /// What the walker says.
    pub fn samples(&self, count: u32, seed: u32) -> Result<Vec<Sample>, Error> {
        self.lit_samples(self.candidates(count, seed), seed)
    }

    /// Samples of which about `count` are lit, without asking, each for the same area times [`Density::share`].
    pub fn candidates(&self, count: u32, seed: u32) -> Vec<Sample> {
        // No more than memory holds, however little of the surface is lit.
        let candidates = f64::from(count) * (self.total_area / self.lit_area).min(MAX_CANDIDATES);
        even_samples(self.scene, &self.density, candidates as u32, seed)
    }

    /// Samples without asking, each for `area` m² times [`Density::share`].
    pub fn candidates_for(&self, area: f64, seed: u32) -> Vec<Sample> {
        even_samples(self.scene, &self.density, (self.total_area / area) as u32, seed)
    }

    /// Those of the samples to which light comes and that nothing covers within a share of the distance between them:
    /// in so narrow a gap it is dark, and whoever interpolates between samples would take the darkness out of it. Where
    /// all are covered they stay.
    ///
    /// # Errors
    /// What the walker says.
    pub fn lit_samples(&self, samples: Vec<Sample>, seed: u32) -> Result<Vec<Sample>, Error> {
        let flags = self.take_part(&samples, |k, _| k as u32, seed)?;
        let samples: Vec<Sample> =
            samples.into_iter().zip(flags).filter_map(|(sample, lit)| lit.then_some(sample)).collect();
        let open: Vec<Sample> =
            samples.par_iter().filter(|sample| !is_sample_covered(self.scene, sample)).copied().collect();
        Ok(if open.is_empty() { samples } else { open })
    }

    /// Reachability of light at the place and side of each sample, which sees geometry; areas and albedos are not
    /// asked. The same place and seed give the same answer.
    ///
    /// # Errors
    /// What the walker says.
    pub fn are_lit(&self, samples: &[Sample], seed: u32) -> Result<Vec<bool>, Error> {
        self.take_part(samples, |_, sample| place_number(sample), seed)
    }

    /// The answer of the probe samples where they agree, else of walks with random numbers of its own, else of those
    /// that it sees. `number` chooses a sample's random numbers.
    fn take_part(
        &self,
        samples: &[Sample],
        number: impl Fn(usize, &Sample) -> u32,
        seed: u32,
    ) -> Result<Vec<bool>, Error> {
        let asked: Vec<Asked> = samples.par_iter().map(|sample| self.ask_probes(sample)).collect();
        let open: Vec<usize> = (0..samples.len()).filter(|&k| asked[k].answer.is_none()).collect();
        let places: Vec<SurfacePoint> =
            open.iter().map(|&k| place_of(&samples[k], &self.density, number(k, &samples[k]))).collect();
        let parts = reachability_of(self.walker, self.scene, &places, WALKS, seed)?;
        let settled: Vec<bool> =
            open.par_iter().zip(parts).map(|(&k, part)| self.is_settled(&samples[k], &asked[k], part)).collect();
        let mut lit: Vec<bool> = asked.iter().map(|asked| asked.answer == Some(true)).collect();
        open.into_iter().zip(settled).for_each(|(k, settled)| lit[k] = settled);
        Ok(lit)
    }

    /// Probe samples about a sample.
    fn ask_probes(&self, sample: &Sample) -> Asked {
        let (near, found) = self.nearest.samples::<NEIGHBOURS>(sample.position, sample.normal, MAX_DISTANCE);
        let answer = match near[..found].iter().filter(|probe| self.lit[probe.0 as usize]).count() {
            // A surface that is left out by mistake is black: dark ones must be many and near.
            0 if found == NEIGHBOURS && near[0].1 < DARK_DISTANCE => Some(false),
            lit if lit > 0 && lit == found => Some(true),
            _ => None,
        };
        Asked { answer, near: near.map(|probe| probe.0), found }
    }

    /// Returns true if light comes to a sample whose probes disagree and of which walks say this.
    fn is_settled(&self, sample: &Sample, asked: &Asked, part: u32) -> bool {
        if part != DARK {
            return part == LIT;
        }
        let edge = self.probe_edge * self.density.edge(sample.position);
        let seen = asked.near[..asked.found].iter().map(|&k| k as usize);
        let seen = seen.filter(|&k| is_visible(self.scene, sample.into(), self.probes[k], edge));
        is_majority(seen.map(|k| self.lit[k]))
    }
}

/// The probe samples near a sample, and what they say of it; nothing where they do not agree.
struct Asked {
    answer: Option<bool>,
    near: [u32; NEIGHBOURS],
    found: usize,
}

/// A sample as a place from which somebody walks.
fn place_of(sample: &Sample, density: &Density, number: u32) -> SurfacePoint {
    let Sample { position, normal, .. } = *sample;
    let sees = density.is_far_and_faces(position, normal);
    SurfacePoint { position, patch: number, normal, weight: f32::from(u8::from(sees)) }
}

/// The number of a sample's random numbers, by its place.
fn place_number(sample: &Sample) -> u32 {
    let [x, y, z] = sample.position.to_array().map(f32::to_bits);
    hash3(x, y, z)
}

/// [`scene::reachability`] of places, by a walker or on all cores of the host.
fn reachability_of(
    walker: Option<&dyn Walker>,
    scene: &Scene,
    places: &[SurfacePoint],
    walks: u32,
    seed: u32,
) -> Result<Vec<u32>, Error> {
    match walker {
        Some(walker) if !places.is_empty() => walker.reachability(scene, places, walks, seed),
        _ => Ok(places.par_iter().map(|place| reachability(scene, place, walks, seed)).collect()),
    }
}

/// Results of so many random walks from each place, true where one comes to light ([`scene::is_open`]), by a walker or
/// on all cores of the host. The number that a place has as its patch is the seed of its walks.
pub(super) fn are_open(
    walker: Option<&dyn Walker>,
    scene: &Scene,
    places: &[SurfacePoint],
    walks: u32,
) -> Result<Vec<bool>, Error> {
    let walks_alone: Vec<SurfacePoint> = places.iter().map(|place| SurfacePoint { weight: -1.0, ..*place }).collect();
    let parts = reachability_of(walker, scene, &walks_alone, walks, 0)?;
    check_length("parts", places.len(), parts.len())?;
    Ok(parts.into_iter().map(|part| part == LIT).collect())
}

/// Lights dark samples that see, of those near, no more dark than lit ones; about a place they lie `edge` m from each
/// other. Inside of a hollow wall, where a rare walk comes out by a crack, most stay dark.
fn light_majorities(
    scene: &Scene,
    places: &[SurfacePlace],
    nearest: &Nearest,
    edge: impl Fn(&SurfacePlace) -> f32 + Sync,
    parts: &mut [u32],
) {
    let sees_light = |k: usize| {
        let (near, found) = nearest.samples::<COMPARED>(places[k].position, places[k].normal, MAX_DISTANCE);
        let others = near[..found].iter().map(|probe| probe.0 as usize).filter(|&j| j != k && parts[j] != APART);
        let edge = edge(&places[k]);
        let seen = others.filter(|&j| is_visible(scene, places[k], places[j], edge));
        is_majority(seen.map(|j| parts[j] == LIT))
    };
    let dark = (0..places.len()).into_par_iter().filter(|&k| parts[k] == DARK);
    let lit: Vec<usize> = dark.filter(|&k| sees_light(k)).collect();
    lit.into_iter().for_each(|k| parts[k] = LIT);
}

/// Returns true if there are some that are lit, and no more that are not.
fn is_majority(lit: impl Iterator<Item = bool>) -> bool {
    let mut bright = 0;
    let mut dark = 0;
    lit.for_each(|lit| if lit { bright += 1 } else { dark += 1 });
    bright > 0 && bright >= dark
}

/// Returns true if something covers a sample, with others as far from it as the edge of its area.
fn is_sample_covered(scene: &Scene, sample: &Sample) -> bool {
    is_covered(scene, SurfacePlace::from(sample), scene::math::sqrt(sample.area))
}

/// Share of an area on the triangle of a sample.
fn triangle_share(scene: &Scene, density: &Density, sample: &Sample) -> f32 {
    density.triangle_share(&scene.geometry.triangles[sample.triangle as usize])
}

/// About `count` samples of both sides of all triangles, each for the same area times what that counts: one in each
/// interval of the running sum over the sides. Holes of masked textures have none.
fn even_samples(scene: &Scene, density: &Density, count: u32, seed: u32) -> Vec<Sample> {
    let geometry = scene.tables();
    let triangles = &scene.geometry.triangles;
    let shares: Vec<f32> = triangles.iter().map(|t| density.triangle_share(t)).collect();
    let counted =
        |(t, &share): (&Triangle, &f32)| 0.5 * f64::from(t.edge_a.cross(t.edge_b).length()) * f64::from(share);
    let areas: Vec<f64> = triangles.iter().zip(&shares).map(counted).collect();
    let area = 2.0 * areas.iter().sum::<f64>() / f64::from(count);
    let mut samples = Vec::with_capacity(count as usize);
    let mut sum = 0.0;
    let mut next = 0u32;
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
