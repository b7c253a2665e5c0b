//! Registered photons and the results computed from them.

use alloc::vec;
use alloc::vec::Vec;
use core::sync::atomic::{AtomicU32, Ordering};

use glam::{DVec3, Vec3};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::NONE;
use scene::math::luminance;
use scene::parallel::*;

use super::trace::{PhotonScene, trace_photons};
use super::tracer::{Estimate, PhotonAccumulator, Round};
use crate::error::{Error, check_length};
use crate::kernel::fixed::{UNITS, carry, fixed};
use crate::kernel::judge::{JUDGED, noise_and_signal};
use crate::kernel::register::{
    COUNT_WORDS, Registration, SLOT_SUMS, SLOTS, SUM_WORDS, count_word, luminance_word, registration, sum_count,
};
use crate::types::*;

/// Adds to a number in fixed point whose low word is word `at`, together with all other cores.
fn add(words: &[AtomicU32], at: u32, value: Fixed) {
    let at = at as usize;
    let before = words[at].fetch_add(value.low, Ordering::Relaxed);
    let high = value.high.wrapping_add(carry(before, value.low));
    if high != 0 {
        words[at + 1].fetch_add(high, Ordering::Relaxed);
    }
}

/// Adds a photon hit where it belongs.
fn add_hit(flux: &[AtomicU32], tallies: &[AtomicU32], hit: &PhotonHit, to: &Registration) {
    for sum in [to.sum, to.emitted].into_iter().filter(|&sum| sum != NONE) {
        for (channel, value) in (0..).zip(hit.flux.to_array()) {
            add(flux, SUM_WORDS * sum + 2 * channel, fixed(value));
        }
    }
    if to.luminance != NONE {
        add(tallies, to.luminance, fixed(luminance(hit.flux)));
    }
}

/// Traces the photons of a dispatch on all cores and adds every hit: what the kernel `firstshot_trace` does, with the
/// same sums. `flux` and `tallies` are laid out as [`crate::kernel::register`] says.
pub fn register_photons(
    scene: &PhotonScene,
    p: &PhotonParams,
    cell: impl Fn(&PhotonHit) -> u32 + Sync,
    group: impl Fn(u32) -> u32 + Sync,
    flux: &[AtomicU32],
    tallies: &[AtomicU32],
) {
    // Photon, segments, registered hits: the counts of a photon are added at once.
    let see = |counts: &mut Vec<(u32, u32, u32)>, hit: &PhotonHit| {
        let to = registration(p, hit, &cell, &group);
        add_hit(flux, tallies, hit, &to);
        match counts.last_mut().filter(|(photon, ..)| *photon == hit.photon) {
            Some((_, segments, registered)) => {
                *segments += 1;
                *registered += to.registered;
            }
            None => counts.push((hit.photon, 1, to.registered)),
        }
    };
    let counts = trace_photons(scene, p, Vec::new, see);
    for (photon, segments, registered) in counts.into_iter().flatten() {
        let at = count_word(photon);
        add(tallies, at, Fixed { low: segments, high: 0 });
        add(tallies, at + 2, Fixed { low: registered, high: 0 });
    }
}

/// Sums of a run, as the kernels have them.
#[derive(Debug)]
pub struct Sums {
    /// Flux of cells and slots.
    pub flux: Vec<AtomicU32>,
    /// Counts of slots, luminance of groups.
    pub tallies: Vec<AtomicU32>,
    group_areas: Vec<f32>,
    batches: u32,
}

/// Areas of the groups of cells, m²: of groups from 0 to the greatest number in use, or of the cells where there are no
/// groups.
pub fn group_areas(accumulator: &dyn PhotonAccumulator) -> Vec<f32> {
    let groups = accumulator.groups();
    let areas = accumulator.areas();
    if groups.is_empty() {
        return areas.to_vec();
    }
    let count = groups.iter().filter(|&&g| g != NONE).max().map_or(0, |&g| g as usize + 1);
    let mut sums = vec![0.0f64; count];
    for (&group, &area) in groups.iter().zip(areas).filter(|(g, _)| **g != NONE) {
        sums[group as usize] += f64::from(area);
    }
    sums.into_iter().map(|area| area as f32).collect()
}

/// Words of the tallies of so many groups in so many batches.
pub fn tally_words(groups: usize, batches: u32) -> usize {
    (SLOTS * COUNT_WORDS) as usize + 2 * groups * batches as usize
}

/// Words of the flux sums of so many cells.
pub fn flux_words(cells: usize) -> usize {
    SUM_WORDS as usize * sum_count(cells as u32) as usize
}

/// `√(Σ σ²/A / Σ (H² − σ²)/A)` from the sums of all blocks, [`noise_and_signal`]; infinite where nothing was
/// registered.
pub fn relative_error(blocks: impl Iterator<Item = glam::Vec2>) -> f64 {
    let sum = blocks.fold(glam::DVec2::ZERO, |sum, block| sum + block.as_dvec2());
    if sum.y > 0.0 { (sum.x / sum.y).sqrt() } else { f64::INFINITY }
}

impl Sums {
    /// Nothing registered yet.
    pub fn new(cells: usize, group_areas: Vec<f32>, batches: u32) -> Self {
        let zeros = |count: usize| (0..count).map(|_| AtomicU32::new(0)).collect();
        let tallies = zeros(tally_words(group_areas.len(), batches));
        Self { flux: zeros(flux_words(cells)), tallies, group_areas, batches }
    }

    /// The sums that a device has.
    ///
    /// # Errors
    /// [`Error::Length`].
    pub fn from_words(
        flux: Vec<u32>,
        tallies: Vec<u32>,
        cells: usize,
        group_areas: Vec<f32>,
        batches: u32,
    ) -> Result<Self, Error> {
        check_length("flux", flux_words(cells), flux.len())?;
        check_length("tallies", tally_words(group_areas.len(), batches), tallies.len())?;
        let atomic = |words: Vec<u32>| words.into_iter().map(AtomicU32::new).collect();
        Ok(Self { flux: atomic(flux), tallies: atomic(tallies), group_areas, batches })
    }

    /// The words, for a device.
    pub fn words(&self) -> (Vec<u32>, Vec<u32>) {
        let plain = |words: &[AtomicU32]| words.iter().map(|word| word.load(Ordering::Relaxed)).collect();
        (plain(&self.flux), plain(&self.tallies))
    }

    /// Bytes of the sums.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.flux[..]) + size_of_val(&self.tallies[..])) as u64
    }

    fn number(words: &[AtomicU32], at: usize) -> u64 {
        let word = |k: usize| u64::from(words[k].load(Ordering::Relaxed));
        word(at) | word(at + 1) << 32
    }

    fn value(words: &[AtomicU32], at: usize) -> f64 {
        Self::number(words, at) as f64 / f64::from(UNITS)
    }

    /// Flux over the mean flux of a photon of a cell, or of what comes after the cells.
    fn flux_of(&self, sum: usize) -> DVec3 {
        let channel = |c: usize| Self::value(&self.flux, SUM_WORDS as usize * sum + 2 * c);
        DVec3::new(channel(0), channel(1), channel(2))
    }

    /// Relative error by the batches; infinite before anything was registered.
    pub fn relative_error(&self) -> f64 {
        let groups = self.group_areas.len() as u32;
        let p = JudgeParams { count: groups.div_ceil(JUDGED), group_count: groups, batches: self.batches };
        let word = |k: u32| self.tallies[k as usize].load(Ordering::Relaxed);
        relative_error((0..p.count).map(|k| noise_and_signal(&p, word, &self.group_areas, k)))
    }

    /// Counts and the error, after so many photons of each batch.
    pub fn round(&self, per_batch: u64) -> Round {
        let count = |which: u32| {
            (0..SLOTS).map(|slot| Self::number(&self.tallies, (count_word(slot) + 2 * which) as usize)).sum()
        };
        Round {
            photons: per_batch * u64::from(self.batches),
            segments: count(0),
            registered: count(1),
            error: self.relative_error(),
        }
    }

    /// Irradiance of cells with these areas, m², and its error, after so many photons of each batch, all of them
    /// together of the given power, W.
    pub fn estimate(&self, areas: &[f32], power: f64, per_batch: u64) -> Estimate {
        let batches = u64::from(self.batches);
        let mean_flux = power / (per_batch * batches).max(1) as f64;
        let of_batch = power / per_batch.max(1) as f64;
        let cell = |(k, &area): (usize, &f32)| {
            let scale = if area > 0.0 { mean_flux / f64::from(area) } else { 0.0 };
            (self.flux_of(k) * scale).as_vec3()
        };
        let groups = self.group_areas.len() as u32;
        let error = |group: u32| {
            let area = f64::from(self.group_areas[group as usize]);
            let luminance = |batch: u32| Self::value(&self.tallies, luminance_word(groups, batch, group) as usize);
            let n = batches as f64;
            let mean = (0..self.batches).map(luminance).sum::<f64>() / n;
            let squares = (0..self.batches).map(|batch| (luminance(batch) - mean).powi(2)).sum::<f64>();
            let deviation = (squares / (n * (n - 1.0))).sqrt();
            if area > 0.0 { (of_batch / area * deviation) as f32 } else { 0.0 }
        };
        let irradiance: Vec<Vec3> = areas.par_iter().enumerate().map(cell).collect();
        let of_slots = |which: u32| {
            (0..SLOTS).map(|slot| self.flux_of(areas.len() + (slot * SLOT_SUMS + which) as usize)).sum::<DVec3>()
                * mean_flux
        };
        Estimate {
            irradiance,
            error: (0..groups).into_par_iter().map(error).collect(),
            round: self.round(per_batch),
            emitted: of_slots(0),
            escaped: of_slots(1),
            unowned: of_slots(2),
        }
    }
}
