//! Receivers as samples of the surface, and where more of them are needed.

use alloc::vec::Vec;

use glam::{Vec3, Vec4};
use scene::math::sqrt;
use scene::parallel::*;
use scene::{SKY_BINS, Scene, SurfacePoint};
use transport::{HitCounts, spatial_order};

use super::field::{NEAR, shepard_weights, weighted_sum};
use super::{AddRows, Entry};
use crate::error::Error;
use crate::host::focus::Density;
use crate::host::lit::LitSampler;
use crate::host::nearest::Nearest;
use crate::host::test_lights::{Estimates, LIGHT_VECTORS};
use crate::types::Sample;

/// Irradiance counts as at least this share of its mean.
const DARK: f32 = 0.05;
/// Receivers are added where those near differ from the mean of their neighbours by more than this
/// share.
const TOLERANCE: f32 = 0.05;
/// Difference that noise may make, in squared standard deviations, before a receiver counts as
/// different from its neighbours.
const CERTAIN: f32 = 4.0;
/// Receivers that are compared: one and its neighbours.
const COMPARED: usize = 7;
/// Receivers whose mean error is that of a place.
const NEIGHBOURS: usize = 4;
/// Candidates for a receiver to be added.
const CANDIDATES: usize = 2;
/// Receivers in order that are cut together: parts of more are cut at multiples of it.
const BLOCK: usize = 128;

/// Receivers so far. Rows may be missing for the last samples.
pub(super) struct ReceiverSamples<'a> {
    pub scene: &'a Scene,
    pub density: Density,
    pub samples: Vec<Sample>,
    /// The samples that have rows.
    pub points: Vec<SurfacePoint>,
    /// Their rows over the elements, one for each hemisphere quadrant.
    pub rows: HitCounts,
    /// Their rows over the sky's bins, of rays that escape.
    pub sky_rows: HitCounts,
    /// Mean area that a receiver stands for in the focus, m².
    pub mean_area: f32,
}

impl<'a> ReceiverSamples<'a> {
    /// Samples without rows, which will be over so many elements.
    pub fn new(scene: &'a Scene, density: Density, samples: Vec<Sample>, elements: usize) -> Result<Self, Error> {
        let rows = HitCounts::new(elements)?;
        let sky_rows = HitCounts::new(SKY_BINS)?;
        Ok(Self { scene, density, samples, points: Vec::new(), rows, sky_rows, mean_area: 0.0 })
    }

    /// Lets all stand for the same mean area of so much surface, m², as it is counted: distances are measured in the mean
    /// edge.
    pub fn share_out(&mut self, surface: f64) {
        let area = (surface / self.samples.len().max(1) as f64) as f32;
        let density = self.density;
        self.samples.iter_mut().for_each(|sample| sample.area = area / density.share(sample.position));
        self.mean_area = area;
    }

    /// Makes the rows that are missing. New samples are put into an order in which neighbours are
    /// near, so that lookups find what they need in the caches.
    pub fn add_rows(&mut self, add_rows: &AddRows) -> Result<(), Error> {
        let first = self.points.len();
        let added = self.samples.split_off(first);
        let positions: Vec<Vec3> = added.iter().map(|s| s.position).collect();
        let normals: Vec<Vec3> = added.iter().map(|s| s.normal).collect();
        for (patch, k) in (first as u32..).zip(spatial_order(&positions, &normals, &[], BLOCK)) {
            let sample = added[k as usize];
            let Sample { position, normal, .. } = sample;
            self.samples.push(sample);
            self.points.push(SurfacePoint { position, patch, normal, weight: 1.0 });
        }
        add_rows(&mut self.rows, &mut self.sky_rows, &self.points[first..])
    }

    /// Samples near the receivers that differ most from the mean of their neighbours, at most
    /// `budget`.
    pub fn worst_places(
        &self,
        sampler: &LitSampler,
        estimates: &Estimates,
        budget: usize,
        seed: u32,
    ) -> Result<Vec<Sample>, Error> {
        if budget == 0 || self.samples.len() <= COMPARED {
            return Ok(Vec::new());
        }
        let nearest = Nearest::new(&self.samples, &self.density);
        let receivers = (0..self.samples.len()).into_par_iter();
        let errors: Vec<f32> = receivers.map(|k| self.error(&nearest, estimates, k)).collect();
        let candidates = sampler.candidates((CANDIDATES * budget) as u32, seed).into_par_iter();
        let wanted = candidates.filter(|sample| mean_error(&nearest, &errors, sample) > TOLERANCE);
        let found = sampler.lit_samples(wanted.collect(), seed)?;
        let numbered = found.par_iter().enumerate();
        let mut order: Vec<(f32, usize)> =
            numbered.map(|(k, sample)| (mean_error(&nearest, &errors, sample), k)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        order.truncate(budget);
        let mut chosen: Vec<usize> = order.into_iter().map(|(_, k)| k).collect();
        chosen.sort_unstable();
        Ok(chosen.into_iter().map(|k| found[k]).collect())
    }

    /// Difference of receiver `k` from the mean of its neighbours that noise does not explain, as a
    /// share of its irradiance under the light where that is greatest.
    fn error(&self, nearest: &Nearest, estimates: &Estimates, k: usize) -> f32 {
        let Estimates { light, variance } = estimates;
        let sample = &self.samples[k];
        let (found, count) = nearest.samples::<COMPARED>(sample.position, sample.normal, NEAR);
        let mut others: Vec<Entry> = found[..count].iter().filter(|f| f.0 as usize != k).copied().collect();
        if others.len() < 2 {
            return 0.0;
        }
        let weights = shepard_weights(&others, others[others.len() - 1].1);
        let total = weights.iter().sum::<f32>().max(f32::MIN_POSITIVE);
        for (other, weight) in others.iter_mut().zip(weights) {
            other.1 = weight / total;
        }
        let squared: Vec<Entry> = others.iter().map(|&(j, w)| (j, w * w)).collect();
        let mean = weighted_sum(&others, light);
        let noise = weighted_sum(&squared, variance);
        let mut worst: f32 = 0.0;
        for v in 0..LIGHT_VECTORS {
            let difference = light[k][v] - mean[v];
            let noise = noise[v] + variance[k][v];
            let real = (difference * difference - noise * CERTAIN).max(Vec4::ZERO);
            let scale = light[k][v].max(mean[v]) + Vec4::splat(DARK);
            worst = worst.max((real / (scale * scale)).max_element());
        }
        sqrt(worst)
    }
}

/// Mean error of the receivers nearest to a sample.
fn mean_error(nearest: &Nearest, errors: &[f32], sample: &Sample) -> f32 {
    let (found, count) = nearest.samples::<NEIGHBOURS>(sample.position, sample.normal, NEAR);
    found[..count].iter().map(|f| errors[f.0 as usize]).sum::<f32>() / count.max(1) as f32
}
