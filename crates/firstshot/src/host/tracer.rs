//! Rounds of photons, accumulated and judged by independent batches, until the error is what was asked for.

use std::vec;
use std::vec::Vec;

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use scene::math::luminance;
use scene::{NONE, Scene};

use super::Proceed;
use super::emission::Emission;
use super::trace::trace_photons;
use crate::error::{Error, check_length, check_setting};
use crate::types::*;

/// Which cell a photon hits: cells of illumination maps, patches, or what else owns places of surfaces.
pub trait PhotonAccumulator: Sync {
    /// Areas of the cells, m².
    fn areas(&self) -> &[f32];
    /// The cell that owns the place (u, v) on a side of a triangle, or [`NONE`].
    fn cell(&self, triangle: u32, u: f32, v: f32, is_back: bool) -> u32;
    /// The group of each cell, or [`NONE`] for cells whose error does not count: errors are those of groups as a whole. Empty
    /// where each cell is a group.
    fn groups(&self) -> &[u32] {
        &[]
    }
}

/// Numbers that photons are made of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sequences {
    /// Independent random numbers.
    Random,
    /// Sobol's points with Owen's scrambling, a scrambling of its own for each batch.
    #[default]
    Sobol,
}

/// How many photons, of what numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotonSettings {
    /// Relative error at which it is enough: `√(Σ A σ² / Σ A H²)` over the cells or groups, σ the standard error of
    /// the luminance of H from the batches. Zero goes on to the most photons.
    pub error: f64,
    /// Most photons, of all batches together.
    pub most_photons: u64,
    /// Independent batches, at least two; each is a sequence of its own.
    pub batches: u32,
    /// Numbers that photons are made of.
    pub sequences: Sequences,
    /// Also registers light that comes straight from area lights and the sky; else indirect light only.
    pub with_direct: bool,
    /// Changes every random number.
    pub seed: u32,
}

impl Default for PhotonSettings {
    /// 5 %, at most 2²⁶ photons in 8 batches of Sobol's points, indirect light, seed 0.
    fn default() -> Self {
        Self {
            error: 0.05,
            most_photons: 1 << 26,
            batches: 8,
            sequences: Sequences::default(),
            with_direct: false,
            seed: 0,
        }
    }
}

/// Photons of each batch in the first round.
const FIRST_ROUND: u32 = 1 << 9;
/// Photons of all batches in a round at most: their photon hits are in memory together.
const MOST_ROUND: u32 = 1 << 18;
/// Photons of a batch that its numbers distinguish.
const MOST_BATCH: u64 = 1 << 31;

/// What one round asks for, and what is known after it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Round {
    /// Photons so far.
    pub photons: u64,
    /// Photon hits on cells so far.
    pub registered: u64,
    /// Segments so far, those that leave the scene included.
    pub segments: u64,
    /// Relative error so far; infinite before anything was registered.
    pub error: f64,
}

/// Indirect irradiance of the cells.
#[derive(Clone, Debug, Default)]
pub struct Estimate {
    /// Indirect irradiance H = Φ m / S of each cell, W/m².
    pub irradiance: Vec<Vec3>,
    /// Standard error of the luminance of each group, W/m²; of each cell where there are no groups.
    pub error: Vec<f32>,
    /// The last round.
    pub round: Round,
    /// Power that photons left their elements with, W: reflected light of point-like lights, emitted light of areas.
    pub emitted: DVec3,
    /// Power that left the scene, W.
    pub escaped: DVec3,
    /// Power that landed on what no cell owns, W.
    pub unowned: DVec3,
}

/// What all batches have registered.
#[derive(Clone, Default)]
struct Totals {
    /// Flux of each cell over the mean flux of a photon.
    cells: Vec<[f32; 3]>,
    registered: u64,
    segments: u64,
    emitted: DVec3,
    escaped: DVec3,
    unowned: DVec3,
}

/// A run of photons that can be continued.
pub struct Tracer<'a> {
    accumulator: &'a dyn PhotonAccumulator,
    scene: &'a Scene,
    emission: &'a Emission,
    settings: PhotonSettings,
    totals: Totals,
    /// Luminance of the flux of each group, batch by batch.
    batches: Vec<Vec<f32>>,
    /// Areas of the groups, m².
    group_areas: Vec<f64>,
    /// Photons of each batch so far.
    per_batch: u64,
}

impl<'a> Tracer<'a> {
    /// Nothing registered yet.
    ///
    /// # Errors
    /// [`Error::Setting`], and [`Error::Length`] unless there is a group for each cell or none at all.
    pub fn new(
        scene: &'a Scene,
        emission: &'a Emission,
        accumulator: &'a dyn PhotonAccumulator,
        settings: PhotonSettings,
    ) -> Result<Self, Error> {
        let cells = accumulator.areas().len();
        let PhotonSettings { error, batches, most_photons, .. } = settings;
        check_setting("error", error, "0 or positive", error >= 0.0)?;
        check_setting("batches", f64::from(batches), "2 to 64", (2..=64).contains(&batches))?;
        check_setting("most_photons", most_photons as f64, "at least 1", most_photons > 0)?;
        if !accumulator.groups().is_empty() {
            check_length("groups", cells, accumulator.groups().len())?;
        }
        let totals = Totals { cells: vec![[0.0; 3]; cells], ..Totals::default() };
        let (groups, areas) = (accumulator.groups(), accumulator.areas());
        let group_areas = if groups.is_empty() {
            areas.iter().map(|&area| f64::from(area)).collect()
        } else {
            let count = groups.iter().filter(|&&g| g != NONE).max().map_or(0, |&g| g as usize + 1);
            let mut sums = vec![0.0; count];
            for (&group, &area) in groups.iter().zip(areas).filter(|(g, _)| **g != NONE) {
                sums[group as usize] += f64::from(area);
            }
            sums
        };
        let batches = vec![vec![0.0; group_areas.len()]; batches as usize];
        Ok(Self { accumulator, scene, emission, settings, totals, batches, group_areas, per_batch: 0 })
    }

    /// Another error to go on to.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn set_error(&mut self, error: f64) -> Result<(), Error> {
        check_setting("error", error, "0 or positive", error >= 0.0)?;
        self.settings.error = error;
        Ok(())
    }

    /// Traces on all cores until the error is reached, the photons are spent, or `progress(round)` says stop. Returns whether
    /// it was not stopped.
    ///
    /// # Errors
    /// [`Error::TooMany`] for batches that no sequence can distinguish.
    pub fn run(&mut self, progress: &dyn Fn(&Round) -> Proceed) -> Result<bool, Error> {
        let (scene, emission) = (self.scene, self.emission);
        self.run_with(progress, |p| Ok::<_, Error>(trace_photons(scene, emission, p)))
    }

    /// [`Tracer::run`] with photons that are traced by somebody else, on a GPU perhaps: `trace` gives the photon hits
    /// of a dispatch, in any order that does not depend on chance.
    ///
    /// # Errors
    /// As [`Tracer::run`], and what `trace` gives.
    pub fn run_with<E: From<Error>>(
        &mut self,
        progress: &dyn Fn(&Round) -> Proceed,
        mut trace: impl FnMut(&PhotonParams) -> Result<Vec<PhotonHit>, E>,
    ) -> Result<bool, E> {
        if self.emission.is_dark() {
            return Ok(true);
        }
        let batches = self.batches.len() as u64;
        let most = (self.settings.most_photons / batches).max(1);
        if most > MOST_BATCH {
            return Err(Error::TooMany { name: "photons of a batch", found: most, limit: MOST_BATCH }.into());
        }
        let mut round = self.round();
        while self.per_batch < most && round.error > self.settings.error {
            let count = self.next_round(&round).min(most - self.per_batch) as u32;
            let p = self.params(count);
            let hits = trace(&p)?;
            self.accumulate(&p, &hits);
            round = self.round();
            if progress(&round).is_break() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Photons of each batch in the next round: as many as before, or what is likely to be missing.
    fn next_round(&self, round: &Round) -> u64 {
        let before = self.per_batch.max(u64::from(FIRST_ROUND));
        let room = u64::from(MOST_ROUND) / self.batches.len() as u64;
        let missing = if round.error.is_finite() && self.settings.error > 0.0 && self.per_batch > 0 {
            let more = (round.error / self.settings.error).powi(2) - 1.0;
            // Multiples of a chunk. The prediction falls short every other time: a small round follows.
            ((self.per_batch as f64 * more) as u64 + 1).next_multiple_of(64)
        } else {
            before
        };
        missing.min(before).min(room).max(1)
    }

    /// The dispatch of the next `count` photons of each batch.
    pub fn params(&self, count: u32) -> PhotonParams {
        PhotonParams {
            low: self.emission.bounds.0,
            count: count * self.batches.len() as u32,
            high: self.emission.bounds.1,
            per_batch: count,
            first: self.per_batch as u32,
            first_batch: 0,
            element_count: self.emission.elements.len() as u32,
            sequence: match self.settings.sequences {
                Sequences::Random => SEQUENCE_RANDOM,
                Sequences::Sobol => SEQUENCE_SOBOL,
            },
            seed: self.settings.seed,
            flags: self.emission.flags,
            ray_offset: self.scene.geometry.ray_offset,
            reserved: 0,
        }
    }

    /// Adds the photon hits of a dispatch in their order, so no sum depends on the number of threads.
    pub fn accumulate(&mut self, p: &PhotonParams, hits: &[PhotonHit]) {
        let (accumulator, with_direct) = (self.accumulator, self.settings.with_direct);
        let cell = |hit: &PhotonHit| {
            let is_counted = with_direct || hit.info & HIT_INDIRECT != 0;
            if is_counted && hit.triangle != NONE && hit.flux != Vec3::ZERO {
                accumulator.cell(hit.triangle, hit.u, hit.v, hit.info & HIT_BACK != 0)
            } else {
                NONE
            }
        };
        let cells: Vec<u32> = hits.par_iter().with_min_len(256).map(cell).collect();
        let groups = accumulator.groups();
        for (hit, cell) in hits.iter().zip(cells) {
            if !self.totals.add(hit, cell, with_direct) {
                continue;
            }
            let group = if groups.is_empty() { cell } else { groups[cell as usize] };
            let batch = self.batches.get_mut((hit.photon / p.per_batch) as usize);
            if let Some(sum) = batch.and_then(|batch| batch.get_mut(group as usize)) {
                *sum += luminance(hit.flux);
            }
        }
        self.per_batch += u64::from(p.per_batch);
    }

    /// Counts and the error so far.
    pub fn round(&self) -> Round {
        Round {
            photons: self.per_batch * self.batches.len() as u64,
            registered: self.totals.registered,
            segments: self.totals.segments,
            error: self.relative_error(),
        }
    }

    /// `√(Σ A σ² / Σ A H²)` of the luminance over the groups.
    fn relative_error(&self) -> f64 {
        let (mut noise, mut signal) = (0.0, 0.0);
        for (k, &area) in self.group_areas.iter().enumerate().filter(|(_, area)| **area > 0.0) {
            let (mean, variance) = self.mean_and_variance(k);
            noise += variance / area;
            signal += (mean * mean - variance) / area;
        }
        if signal > 0.0 { (noise / signal).sqrt() } else { f64::INFINITY }
    }

    /// Mean over the batches of a group's flux, and the variance of that mean.
    fn mean_and_variance(&self, group: usize) -> (f64, f64) {
        mean_and_variance(self.batches.iter().map(|batch| f64::from(batch[group])))
    }

    /// Irradiance and its error from all photons so far.
    pub fn estimate(&self) -> Estimate {
        let photons = (self.per_batch * self.batches.len() as u64).max(1);
        // Of a unit of flux in the totals, and in a batch.
        let (unit, unit_of_batch) =
            (self.emission.power / photons as f64, self.emission.power / self.per_batch.max(1) as f64);
        let cell = |(sum, &area): (&[f32; 3], &f32)| {
            let scale = if area > 0.0 { (unit / f64::from(area)) as f32 } else { 0.0 };
            Vec3::from(*sum) * scale
        };
        let error = |k: usize| {
            let area = self.group_areas[k];
            if area > 0.0 { (unit_of_batch / area * self.mean_and_variance(k).1.sqrt()) as f32 } else { 0.0 }
        };
        Estimate {
            irradiance: self.totals.cells.par_iter().zip(self.accumulator.areas()).map(cell).collect(),
            error: (0..self.group_areas.len()).into_par_iter().map(error).collect(),
            round: self.round(),
            emitted: self.totals.emitted * unit,
            escaped: self.totals.escaped * unit,
            unowned: self.totals.unowned * unit,
        }
    }

    /// Bytes of the sums.
    pub fn bytes(&self) -> u64 {
        let batches = self.batches.iter().map(|b| size_of_val(&b[..])).sum::<usize>();
        (size_of_val(&self.totals.cells[..]) + batches) as u64
    }
}

/// Mean of the batches, and the variance of that mean.
fn mean_and_variance(values: impl ExactSizeIterator<Item = f64> + Clone) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.clone().sum::<f64>() / n;
    let squares = values.map(|v| (v - mean).powi(2)).sum::<f64>();
    (mean, squares / (n * (n - 1.0)))
}

impl Totals {
    /// Adds a photon hit; whether a cell took it.
    fn add(&mut self, hit: &PhotonHit, cell: u32, with_direct: bool) -> bool {
        if hit.flux == Vec3::ZERO {
            return false;
        }
        let flux = hit.flux.as_dvec3();
        self.segments += 1;
        if hit.info & HIT_FIRST != 0 {
            self.emitted += flux;
        }
        if hit.triangle == NONE {
            self.escaped += flux;
            return false;
        }
        if hit.info & HIT_INDIRECT == 0 && !with_direct {
            return false;
        }
        let Some(sum) = self.cells.get_mut(cell as usize) else {
            self.unowned += flux;
            return false;
        };
        let more = hit.flux.to_array();
        sum.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        self.registered += 1;
        true
    }
}
