//! Receivers in space: the interpolation points between them, and their weights.

use alloc::vec;
use alloc::vec::Vec;

use arrayvec::ArrayVec;
use glam::{Mat2, Vec2, Vec3, Vec4};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::math::sqrt;
use scene::parallel::*;
use scene::sampling::frame;
use scene::{Ray, Sides, SurfacePoint};
use transport::check_length;

use super::refinement::ReceiverSamples;
use super::{Entry, sample_at};
use crate::error::Error;
use crate::host::interpolation_mesh::InterpolationMesh;
use crate::host::lit::{LitSampler, Walker};
use crate::host::nearest::Nearest;
use crate::host::test_lights::{LIGHT_VECTORS, Lights};
use crate::host::visibility::{SurfacePlace, is_visible, sight};
use crate::types::Sample;

/// Receivers that an interpolation point takes its value from; one more gives the distance at which
/// the weight is zero.
const NEIGHBOURS: usize = 8;
/// Interpolation points that look for them together.
const POINTS_PER_BATCH: usize = 1 << 15;
/// Receivers among which they are chosen.
const SEARCHED: usize = 20;
/// Ridge of the linear fit through them, in squared edges between receivers.
const RIDGE: f32 = 0.03;
/// The value of an interpolation point may be beyond those of its receivers by this share of the
/// greatest: where light is even rounding would not let it go anywhere.
const SLACK: f32 = 0.01;
/// Weights below this are left out.
const MIN_WEIGHT: f32 = 0.02;
/// Greatest weight that a fit gives, either way: far outside of its receivers it would follow their noise.
const MAX_WEIGHT: f32 = 1.5;
/// Most that a fit may change the sum of the weights, before they are made to sum to 1 again.
const MAX_CHANGE: f32 = 0.25;
/// Changes the random numbers of each further attempt.
const AGAIN: u32 = 0x9e37_79b9;
/// Weight of a difference of the normal in the choice, over that in the search.
const NORMAL_WEIGHT: f32 = 100.0;

/// Furthest that receivers are compared, in edges between them.
pub(super) const NEAR: f32 = 4.0;
/// Furthest that a receiver may be from an interpolation point, or from one that is smoothed with
/// it, in the same.
pub(super) const FAR: f32 = 5.5;
/// Furthest that one may be from what is smaller than [`SMALL`] edges.
const FURTHEST: f32 = 8.0;
const SMALL: f32 = 3.0;

/// Edge of the cells over which the distance between interpolation points may change, in mean edges
/// between receivers.
const CELL_EDGE: f32 = 6.0;
/// Least distance between interpolation points, in the same.
const MIN_SPACING: f32 = 0.3;
/// Interpolation points nearer than this may be one, in the same.
const WELD: f32 = 0.25;
/// Receivers whose distances give the distance between interpolation points: one and its
/// neighbours.
const SPACED: usize = 5;

/// Weights of an interpolation point: millions are held at once.
pub(super) type PointWeights = ArrayVec<Entry, NEIGHBOURS>;

/// Receivers in space.
pub(super) struct ReceiverField<'a> {
    pub set: ReceiverSamples<'a>,
    pub nearest: Nearest,
    /// Mean edge between receivers in the focus, m.
    pub edge: f32,
}

impl<'a> ReceiverField<'a> {
    pub fn new(set: ReceiverSamples<'a>) -> Self {
        let nearest = Nearest::new(&set.samples, &set.density);
        let edge = sqrt(set.mean_area);
        Self { set, nearest, edge }
    }

    /// Mean edge between receivers about a place, m.
    fn edge_at(&self, position: Vec3) -> f32 {
        self.edge * self.set.density.edge(position)
    }

    /// Interpolation points, as close as receivers are about them.
    pub fn interpolation_mesh(&self, sampler: &LitSampler, seed: u32) -> Result<InterpolationMesh, Error> {
        let Self { set, edge, .. } = self;
        let spacing: Vec<f32> = set.samples.par_iter().map(|sample| self.spacing(sample)).collect();
        let both = vec![Sides { front: true, back: true }; set.scene.geometry.triangles.len()];
        InterpolationMesh::new(
            set.scene,
            &set.density,
            &both,
            CELL_EDGE * edge,
            WELD * edge,
            |point, size| self.spacing_about(&spacing, point, size),
            // Light may come where no receiver is: interpolation points there gather it themselves.
            |points, attempt| {
                let seed = seed ^ attempt.wrapping_mul(AGAIN);
                let samples: Vec<Sample> = points.iter().map(sample_at).collect();
                let lit = sampler.are_lit(&samples, seed)?.into_iter().zip(points);
                Ok(lit.map(|(is_lit, point)| is_lit.then(|| SMALL * self.edge_at(point.position))).collect())
            },
        )
    }

    /// Mean distance of a receiver from its neighbours, m.
    fn spacing(&self, sample: &Sample) -> f32 {
        let (found, count) = self.nearest.samples::<SPACED>(sample.position, sample.normal, NEAR);
        let mut sum = 0.0;
        for &(k, _) in &found[..count] {
            sum += self.set.samples[k as usize].position.distance(sample.position);
        }
        sum / (count.max(2) - 1) as f32
    }

    /// Distance between interpolation points about a point of a cell whose longest edge is `size` m;
    /// `None` where no receiver is near.
    fn spacing_about(&self, spacing: &[f32], point: &SurfacePoint, size: f32) -> Option<f32> {
        // What is small may have no receiver of its own.
        let edge = self.edge_at(point.position);
        let most = if size <= SMALL * edge { FURTHEST } else { NEAR };
        let (found, count) = self.nearest.samples::<3>(point.position, point.normal, most);
        if count == 0 {
            return None;
        }
        let mean = found[..count].iter().map(|f| spacing[f.0 as usize]).sum::<f32>() / count as f32;
        Some(mean.max(MIN_SPACING * edge))
    }

    /// The receivers that interpolation points take, with weights that sum to 1: the nearest in position and normal
    /// that they see. Empty for a point that sees none. With a walker the points of a block look together.
    ///
    /// # Errors
    /// What the walker says.
    pub fn visible_weights(
        &self,
        points: &[SurfacePoint],
        walker: Option<&dyn Walker>,
    ) -> Result<Vec<PointWeights>, Error> {
        let Some(walker) = walker else {
            let weights = |point: &SurfacePoint| {
                let mut choice = self.choice(point);
                while !choice.next().is_empty() {
                    let place = choice.place;
                    choice.take(|receiver| self.is_receiver_visible(place, receiver));
                }
                choice.weights()
            };
            return Ok(points.par_iter().map(weights).collect());
        };
        let mut found = Vec::with_capacity(points.len());
        for block in points.chunks(POINTS_PER_BATCH) {
            let mut choices: Vec<Choice> = block.par_iter().map(|point| self.choice(point)).collect();
            loop {
                let sights = |choice: &Choice| {
                    let place = choice.place;
                    choice.next().iter().map(|entry| self.sight(place, entry.0)).collect::<Vec<Ray>>()
                };
                let rays = choices.par_iter().map(sights).collect::<Vec<_>>().concat();
                if rays.is_empty() {
                    break;
                }
                let stopped = walker.stopped(self.set.scene, &rays)?;
                check_length("stopped", rays.len(), stopped.len())?;
                let mut stopped = stopped.into_iter();
                choices.iter_mut().for_each(|choice| choice.take(|_| stopped.next() == Some(0)));
            }
            found.extend(choices.into_par_iter().map(Choice::weights).collect::<Vec<_>>());
        }
        Ok(found)
    }

    /// Weights of the nearest receivers, whether the point sees them or not.
    pub fn nearest_weights(&self, point: &SurfacePoint) -> PointWeights {
        let mut choice = self.choice(point);
        choice.take(|_| true);
        choice.weights()
    }

    /// All receivers that an interpolation point may take, and none taken yet.
    fn choice(&self, point: &SurfacePoint) -> Choice {
        let place = SurfacePlace::from(point);
        Choice { place, similar: self.similar_receivers(place), asked: 0, kept: Vec::new() }
    }

    /// The receivers nearest to a place in position and normal, the nearest first.
    fn similar_receivers(&self, place: SurfacePlace) -> Vec<Entry> {
        let SurfacePlace { position, normal } = place;
        let (mut found, mut count) = self.nearest.samples::<SEARCHED>(position, normal, FAR);
        if count == 0 {
            (found, count) = self.nearest.samples::<SEARCHED>(position, normal, FURTHEST);
        }
        let mut similar = found[..count].to_vec();
        for (k, distance) in &mut similar {
            let rotation = normal.distance_squared(self.set.samples[*k as usize].normal);
            *distance = sqrt(*distance * *distance + NORMAL_WEIGHT * rotation);
        }
        similar.sort_by(|a, b| a.1.total_cmp(&b.1));
        similar
    }

    /// Returns true if a receiver is visible from a place.
    pub fn is_receiver_visible(&self, place: SurfacePlace, receiver: u32) -> bool {
        let there = SurfacePlace::from(&self.set.samples[receiver as usize]);
        is_visible(self.set.scene, place, there, self.edge_at(place.position))
    }

    /// The ray that is stopped where it is not.
    fn sight(&self, place: SurfacePlace, receiver: u32) -> Ray {
        let there = SurfacePlace::from(&self.set.samples[receiver as usize]);
        sight(self.set.scene, place, there, self.edge_at(place.position))
    }

    /// Makes the weights of an interpolation point those of a linear fit through its receivers, as
    /// far as under every light the value stays between the least and the greatest of theirs.
    /// `smooth` are the receivers' smoothed values.
    pub fn fit(&self, point: &SurfacePoint, weights: &mut PointWeights, smooth: &[Lights]) {
        let changes = self.linear_changes(point.into(), weights, RIDGE);
        let mean = weighted_sum(weights, smooth);
        let step: Vec<Entry> = weights.iter().zip(&changes).map(|(w, change)| (w.0, w.1 * change)).collect();
        let step = weighted_sum(&step, smooth);
        let mut share: f32 = 1.0;
        for v in 0..LIGHT_VECTORS {
            let values = weights.iter().map(|w| smooth[w.0 as usize][v]);
            let Some(least) = values.clone().reduce(Vec4::min) else { return };
            let Some(most) = values.reduce(Vec4::max) else { return };
            let slack = most * SLACK;
            let upwards = step[v].cmpgt(Vec4::ZERO);
            let margin = Vec4::select(upwards, most + slack - mean[v], least - slack - mean[v]);
            let moves = step[v].abs().cmpgt(Vec4::splat(f32::MIN_POSITIVE));
            share = share.min(Vec4::select(moves, margin / step[v], Vec4::ONE).min_element());
        }
        for (weight, change) in weights.iter().zip(&changes) {
            let step = weight.1 * change;
            let room = if step > 0.0 { MAX_WEIGHT - weight.1 } else { MAX_WEIGHT + weight.1 };
            share = if step.abs() > room { share.min(room / step.abs()) } else { share };
        }
        let share = share.max(0.0);
        let changed = weights.iter().zip(changes).map(|(entry, change)| (entry.0, entry.1 * (1.0 + share * change)));
        let mut fitted: PointWeights = changed.filter(|entry| entry.1.abs() >= MIN_WEIGHT).collect();
        let total: f32 = fitted.iter().map(|w| w.1).sum();
        // Where more receivers are equally far than are taken, their weights sum to less than 1; a steep fit takes the
        // rest.
        if (total - 1.0).abs() <= MAX_CHANGE {
            fitted.iter_mut().for_each(|w| w.1 /= total);
            *weights = fitted;
        } else {
            let total: f32 = weights.iter().map(|w| w.1).sum();
            weights.iter_mut().for_each(|w| w.1 /= total);
        }
    }

    /// Changes that a linear fit at a place makes to weights that sum to 1, as shares of each, where `ridge` limits the
    /// slope.
    pub fn linear_changes(&self, place: SurfacePlace, weights: &[Entry], ridge: f32) -> Vec<f32> {
        let (right, up) = frame(place.normal);
        let edge = self.edge_at(place.position);
        let mut offsets: Vec<Vec2> = Vec::with_capacity(weights.len());
        for &(k, _) in weights {
            let offset = (self.set.samples[k as usize].position - place.position) / edge;
            offsets.push(Vec2::new(offset.dot(right), offset.dot(up)));
        }
        let mean: Vec2 = offsets.iter().zip(weights).map(|(&offset, w)| offset * w.1).sum();
        let mut covariance = Mat2::from_diagonal(Vec2::splat(ridge));
        for (&offset, &(_, weight)) in offsets.iter().zip(weights) {
            let away = offset - mean;
            covariance += Mat2::from_cols(away * away.x, away * away.y) * weight;
        }
        let slope = covariance.inverse() * -mean;
        offsets.iter().map(|&offset| slope.dot(offset - mean)).collect()
    }
}

/// The receivers that an interpolation point takes, while it looks for them.
struct Choice {
    place: SurfacePlace,
    /// Those that it may take, the nearest first, and how many of them it has asked about.
    similar: Vec<Entry>,
    asked: usize,
    kept: Vec<Entry>,
}

impl Choice {
    /// Those that it asks about next: as many as are missing.
    fn next(&self) -> &[Entry] {
        let missing = NEIGHBOURS + 1 - self.kept.len();
        &self.similar[self.asked..self.similar.len().min(self.asked + missing)]
    }

    /// Takes those of them that it sees.
    fn take(&mut self, mut is_seen: impl FnMut(u32) -> bool) {
        let next = self.asked..self.asked + self.next().len();
        self.asked = next.end;
        self.kept.extend(self.similar[next].iter().filter(|entry| is_seen(entry.0)));
    }

    /// Their weights.
    fn weights(self) -> PointWeights {
        let mut kept = self.kept;
        let Some(&(_, last)) = kept.last() else { return PointWeights::new() };
        let range = if kept.len() > NEIGHBOURS { last } else { 2.0 * last };
        let weights = shepard_weights(&kept, range);
        let total: f32 = weights.iter().sum();
        for (entry, weight) in kept.iter_mut().zip(weights) {
            entry.1 = weight / total;
        }
        kept.into_iter().take(NEIGHBOURS).collect()
    }
}

/// `Σ_k w_k v_k` under all lights.
pub(super) fn weighted_sum(weights: &[Entry], values: &[Lights]) -> Lights {
    let mut sum = [Vec4::ZERO; LIGHT_VECTORS];
    for &(k, weight) in weights {
        for (sum, value) in sum.iter_mut().zip(values[k as usize]) {
            *sum += value * weight;
        }
    }
    sum
}

/// Weights by distance: inverse, down to zero at the range (Franke and Little's form of Shepard's
/// weights).
pub(super) fn shepard_weights(distances: &[Entry], range: f32) -> Vec<f32> {
    let range = range.max(1e-6) * 1.001;
    let mut weights = Vec::with_capacity(distances.len());
    for &(_, distance) in distances {
        let d = distance.max(1e-3 * range);
        weights.push(((range - d) / (range * d)).powi(2));
    }
    weights
}
