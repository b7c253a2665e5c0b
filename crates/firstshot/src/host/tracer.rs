//! Rounds of photons, accumulated and judged by independent batches, until the error is what was asked for.

use alloc::vec::Vec;

use glam::{DVec3, Vec3};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::Scene;

use super::Proceed;
use super::emission::Emission;
use super::sums::{Sums, group_areas, register_photons};
use super::trace::PhotonScene;
use crate::error::{Error, check_length, check_setting};
use crate::types::*;

/// Which cell a photon hits: cells of illumination maps, patches, or what else owns places of surfaces.
pub trait PhotonAccumulator: Sync {
    /// Areas of the cells, m².
    fn areas(&self) -> &[f32];
    /// The cell that owns the place (u, v) on a side of a triangle, or [`scene::NONE`].
    fn cell(&self, triangle: u32, u: f32, v: f32, is_back: bool) -> u32;
    /// The group of each cell, or [`scene::NONE`] for cells whose error does not count: errors are those of groups as a
    /// whole. Empty where each cell is a group.
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

/// Solver of a start point's cubic equation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cubic {
    /// Newton's method, kept in its bracket: to single precision.
    #[default]
    Newton,
    /// Cardano's formula (Kopylov): to 1.5·10⁻³ of the density.
    Cardano,
}

/// Number of photons, and their random numbers.
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
    /// Solver of start points on light elements.
    pub cubic: Cubic,
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
            cubic: Cubic::default(),
            with_direct: false,
            seed: 0,
        }
    }
}

/// Photons of each batch in the first round.
const FIRST_ROUND: u64 = 1 << 9;
/// Photons of all batches in a round at most: of one dispatch.
pub const MAX_ROUND: u32 = 1 << 18;

impl PhotonSettings {
    /// Refuses settings that no run can have.
    ///
    /// # Errors
    /// [`Error::Setting`], and [`Error::TooMany`] for more photons than sums have room for.
    pub fn check(&self) -> Result<(), Error> {
        let Self { error, batches, most_photons, .. } = *self;
        check_setting("error", error, "0 or positive", error >= 0.0)?;
        check_setting("batches", f64::from(batches), "2 to 64", (2..=64).contains(&batches))?;
        check_setting("most_photons", most_photons as f64, "at least 1", most_photons > 0)?;
        if most_photons > MAX_PHOTONS {
            return Err(Error::TooMany { name: "photons", found: most_photons, limit: MAX_PHOTONS });
        }
        Ok(())
    }

    /// Photons of each batch in the next round, after so many of each and with this relative error; 0 when it is
    /// enough. Without an error that is asked for, rounds are as large as they may be and depend on nothing that was
    /// found.
    pub fn next_round(&self, per_batch: u64, error: f64) -> u32 {
        let batches = u64::from(self.batches);
        let left = (self.most_photons / batches).max(1).saturating_sub(per_batch);
        let room = u64::from(MAX_ROUND) / batches;
        if self.error <= 0.0 {
            return room.min(left) as u32;
        }
        if error <= self.error {
            return 0;
        }
        // As many as before, or what is likely to be missing.
        let before = per_batch.max(FIRST_ROUND);
        let missing = if error.is_finite() && per_batch > 0 {
            let more = (error / self.error).powi(2) - 1.0;
            // Multiples of a chunk. The prediction falls short every other time: a small round follows.
            ((per_batch as f64 * more) as u64 + 1).next_multiple_of(64)
        } else {
            before
        };
        missing.min(before).min(room).max(1).min(left) as u32
    }

    /// The dispatch of the next `count` photons of each batch, after so many of each; `targets` are the numbers of
    /// cells and of groups.
    pub fn params(
        &self,
        scene: &Scene,
        emission: &Emission,
        per_batch: u64,
        count: u32,
        targets: [u32; 2],
    ) -> PhotonParams {
        PhotonParams {
            low: emission.bounds.0,
            count: count * self.batches,
            high: emission.bounds.1,
            per_batch: count,
            first: per_batch as u32,
            first_batch: 0,
            element_count: emission.elements.len() as u32,
            sequence: match self.sequences {
                Sequences::Random => SEQUENCE_RANDOM,
                Sequences::Sobol => SEQUENCE_SOBOL,
            },
            seed: self.seed,
            flags: emission.flags
                | if self.with_direct { FLAG_DIRECT } else { 0 }
                | if self.cubic == Cubic::Cardano { FLAG_CARDANO } else { 0 },
            cell_count: targets[0],
            group_count: targets[1],
            absorption: scene.geometry.absorption,
            ray_offset: scene.geometry.ray_offset,
        }
    }
}

/// Shadow rays requested by one round, and the state after it.
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
    /// Power that photons left their elements with, W: reflected light of point-like lights, emitted light of areas;
    /// less what a medium absorbs on the first segments.
    pub emitted: DVec3,
    /// Power that left the scene, W.
    pub escaped: DVec3,
    /// Power that landed on what no cell owns, W.
    pub unowned: DVec3,
}

/// A run of photons that can be continued.
pub struct Tracer<'a> {
    accumulator: &'a dyn PhotonAccumulator,
    scene: &'a Scene,
    emission: &'a Emission,
    settings: PhotonSettings,
    sums: Sums,
    /// Number of groups.
    groups: u32,
    /// Photons of each batch so far.
    per_batch: u64,
}

impl<'a> Tracer<'a> {
    /// Nothing registered yet.
    ///
    /// # Errors
    /// [`PhotonSettings::check`], and [`Error::Length`] unless there is a group for each cell or none at all.
    pub fn new(
        scene: &'a Scene,
        emission: &'a Emission,
        accumulator: &'a dyn PhotonAccumulator,
        settings: PhotonSettings,
    ) -> Result<Self, Error> {
        let cells = accumulator.areas().len();
        settings.check()?;
        if !accumulator.groups().is_empty() {
            check_length("groups", cells, accumulator.groups().len())?;
        }
        let areas = group_areas(accumulator);
        let groups = areas.len() as u32;
        let sums = Sums::new(cells, areas, settings.batches);
        Ok(Self { accumulator, scene, emission, settings, sums, groups, per_batch: 0 })
    }

    /// Another error to go on to.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn set_error(&mut self, error: f64) -> Result<(), Error> {
        self.settings.error = error;
        self.settings.check()
    }

    /// Traces on all cores until the error is reached, the photons are spent, or `progress(round)` says stop. Returns
    /// whether it was not stopped.
    pub fn run(&mut self, progress: &dyn Fn(&Round) -> Proceed) -> bool {
        if self.emission.is_dark() {
            return true;
        }
        let mut round = self.round();
        loop {
            let count = self.settings.next_round(self.per_batch, round.error);
            if count == 0 {
                return true;
            }
            self.trace(&self.params(count));
            round = self.round();
            if progress(&round).is_break() {
                return false;
            }
        }
    }

    fn trace(&mut self, p: &PhotonParams) {
        let accumulator = self.accumulator;
        let cell = |hit: &PhotonHit| accumulator.cell(hit.triangle, hit.u, hit.v, hit.info & HIT_BACK != 0);
        let groups = accumulator.groups();
        let group = |cell: u32| if groups.is_empty() { cell } else { groups[cell as usize] };
        let scene = PhotonScene::new(self.scene, self.emission);
        register_photons(&scene, p, cell, group, &self.sums.flux, &self.sums.tallies);
        self.per_batch += u64::from(p.per_batch);
    }

    /// The dispatch of the next `count` photons of each batch.
    pub fn params(&self, count: u32) -> PhotonParams {
        let cells = self.accumulator.areas().len() as u32;
        self.settings.params(self.scene, self.emission, self.per_batch, count, [cells, self.groups])
    }

    /// Counts and the error so far.
    pub fn round(&self) -> Round {
        self.sums.round(self.per_batch)
    }

    /// Irradiance and its error from all photons so far.
    pub fn estimate(&self) -> Estimate {
        self.sums.estimate(self.accumulator.areas(), self.emission.power, self.per_batch)
    }

    /// Bytes of the sums.
    pub fn bytes(&self) -> u64 {
        self.sums.bytes()
    }
}
