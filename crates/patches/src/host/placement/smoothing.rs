//! Smoothing of the receivers' values.

use alloc::vec;
use alloc::vec::Vec;

use glam::Vec4;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::parallel::*;

use super::Entry;
use super::field::{FAR, ReceiverField};
use crate::host::test_lights::{Estimates, LIGHT_VECTORS};
use crate::host::visibility::SurfacePlace;

/// Receivers that a receiver may be smoothed with.
const SMOOTHED: usize = 24;
/// Squared standard deviations by which those may differ from it.
const SIMILAR: f32 = 10.0;
/// Ridge of the linear fit through them, in squared edges between receivers.
const RIDGE: f32 = 0.3;

impl ReceiverField<'_> {
    /// For each receiver a linear fit through those near it that it sees and that differ from it,
    /// under every light, by no more than noise can: less noise where light is even or changes
    /// evenly, and no less detail where it does not. No weight is negative.
    pub fn smoothing(&self, estimates: &Estimates) -> Vec<Vec<Entry>> {
        let receivers = (0..self.set.samples.len()).into_par_iter();
        receivers.map(|k| self.smoothing_row(estimates, k)).collect()
    }

    fn smoothing_row(&self, estimates: &Estimates, k: usize) -> Vec<Entry> {
        let place = SurfacePlace::from(&self.set.samples[k]);
        let mut row = self.similar_weights(estimates, k, place);
        let changes = self.linear_changes(place, &row, RIDGE);
        let least = changes.iter().copied().fold(0.0, f32::min);
        let share = if least < -1.0 { -1.0 / least } else { 1.0 };
        for (entry, change) in row.iter_mut().zip(changes) {
            entry.1 *= 1.0 + share * change;
        }
        row
    }

    /// Receiver `k` and those near it that are like it, with weights that sum to 1.
    fn similar_weights(&self, estimates: &Estimates, k: usize, place: SurfacePlace) -> Vec<Entry> {
        let SurfacePlace { position, normal } = place;
        let (found, count) = self.nearest.samples::<{ SMOOTHED + 2 }>(position, normal, FAR);
        let found = &found[..count];
        let range = found.last().map_or(1.0, |last| last.1.max(f32::MIN_POSITIVE) * 1.001);
        let mut kept = vec![(k as u32, 1.0)];
        for &(other, distance) in found.iter().filter(|f| f.0 as usize != k) {
            let weight = 1.0 - difference(estimates, k, other as usize);
            if weight > 0.0 && self.is_receiver_visible(place, other) {
                kept.push((other, weight * (1.0 - (distance / range).powi(2))));
            }
        }
        let total: f32 = kept.iter().map(|k| k.1).sum();
        kept.iter_mut().for_each(|k| k.1 /= total);
        kept
    }
}

/// Squared difference of two receivers under the light where it is greatest; 1 is the most that
/// noise can make.
fn difference(estimates: &Estimates, a: usize, b: usize) -> f32 {
    let Estimates { light, variance } = estimates;
    let mut greatest: f32 = 0.0;
    for v in 0..LIGHT_VECTORS {
        let difference = light[a][v] - light[b][v];
        let noise = (variance[a][v] + variance[b][v]) * SIMILAR + Vec4::splat(f32::MIN_POSITIVE);
        greatest = greatest.max((difference * difference / noise).max_element());
    }
    greatest
}
