//! Receivers on the mesh: points where irradiance is gathered, more of them where it changes; the
//! smoothing of their values; and interpolation points between them.

mod field;
mod refinement;
mod smoothing;
#[cfg(test)]
mod tests;

use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;

use glam::{Vec2, Vec3};
use scene::parallel::*;
use scene::sampling::frame;
use scene::{NONE, SKY_BINS, Scene, Sides, SurfacePoint};
use transport::{HitCounts, QUADRANTS};

use self::field::{PointWeights, ReceiverField, weighted_sum};
use self::refinement::ReceiverSamples;
use super::focus::Density;
use super::interpolation_mesh::InterpolationMesh;
use super::lit::LitSampler;
use super::mesh::Zone;
use super::test_lights::{Estimates, Lights, TestLights};
use super::weights::{PackedWeights, Weight};
use crate::error::Error;
use crate::types::Sample;

/// Rounds in which receivers are added.
const ROUNDS: usize = 2;
/// Rounds in which interpolation points that see no receiver become receivers, and the share of
/// them that does in each.
const ORPHAN_ROUNDS: usize = 2;
const ORPHAN_SHARE: usize = 3;
/// Share of the receivers that is kept for them.
const ORPHAN_ROOM: f64 = 0.2;

/// Differences of normals up to this are none.
const MIN_ROTATION: f32 = 0.05;
/// Irradiance is rotated by no more than this, however much the normal differs.
const MAX_ROTATION: f32 = 0.5;
/// Smoothed values begin at multiples of this: ranges of a buffer do at 256 bytes.
const ALIGNED: usize = 64;

/// Placement of receivers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placing {
    /// Distance between them in the focus where light is even, m.
    pub edge: f32,
    /// Most receivers.
    pub most: usize,
    /// Rays of each.
    pub rays: u32,
    /// Changes every random number.
    pub seed: u32,
}

/// The number of a receiver or a column, with its weight or distance.
type Entry = (u32, f32);

/// Adds the rows of receivers over the elements, and those over the sky's bins
/// ([`scene::sky_bin`]): [`QUADRANTS`] rows a point, in the order of [`transport::rotational_gradients`].
pub type AddRows<'a> = dyn Fn(&mut HitCounts, &mut HitCounts, &[SurfacePoint]) -> Result<(), Error> + 'a;

/// Receivers and the interpolation points between them. Cheap to clone.
#[derive(Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MeshReceivers {
    /// Points where irradiance is gathered.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub points: Arc<Vec<SurfacePoint>>,
    /// Their rows over the elements, one for each quadrant of a receiver's hemisphere.
    pub rows: Arc<HitCounts>,
    /// As many rows over the sky's bins: the share of the hemisphere that sees the sky there.
    pub sky_rows: Arc<HitCounts>,
    /// From the quadrants' values to one smoothed value for each receiver: a linear fit with those
    /// near it that differ by no more than their noise, each rotated to its normal.
    pub smoothing: Arc<PackedWeights>,
    /// The interpolation points, and the triangles' grids over them. Points that take most from the same receiver
    /// follow each other.
    pub interpolation: Arc<InterpolationMesh>,
    /// From the smoothed values, which stand behind the quadrants' from [`Self::first_smooth`] on, to the value of each
    /// interpolation point: smoothed values interpolate, and quadrants rotate them to the point's normal. For light
    /// that is the same everywhere the quadrants add nothing.
    pub weights: Arc<PackedWeights>,
}

impl MeshReceivers {
    /// No receivers.
    ///
    /// # Errors
    /// [`Error::Shared`] for a scene with more triangles than can be numbered.
    pub fn none(scene: &Scene) -> Result<Self, Error> {
        let sides = vec![Sides::default(); scene.geometry.triangles.len()];
        let nowhere = |points: &[SurfacePoint], _: u32| Ok(vec![None; points.len()]);
        let interpolation = InterpolationMesh::new(scene, &Density::default(), &sides, 1.0, 1.0, |_, _| None, nowhere)?;
        let empty = PackedWeights::new(0, |_| Vec::new())?;
        Ok(Self {
            points: Arc::default(),
            rows: Arc::new(HitCounts::new(0)?),
            sky_rows: Arc::new(HitCounts::new(SKY_BINS)?),
            smoothing: Arc::new(empty.clone()),
            interpolation: Arc::new(interpolation),
            weights: Arc::new(empty),
        })
    }

    /// Index of the first smoothed value: after those of the quadrants.
    pub fn first_smooth(&self) -> usize {
        first_smooth(self.points.len())
    }

    /// Receivers of the light of so many elements: even ones, then more of them where they
    /// differ from the mean of their neighbours under `lights`, then some
    /// where interpolation points see none.
    ///
    /// # Errors
    /// What `add_rows` says, and [`Error::Shared`] for more elements, points or weights than can be
    /// numbered.
    pub fn place(
        scene: &Scene,
        sampler: &LitSampler,
        elements: usize,
        placing: &Placing,
        lights: &TestLights,
        add_rows: &AddRows,
    ) -> Result<Self, Error> {
        let placement = Placement { scene, sampler, placing, lights, add_rows };
        placement.finish(placement.refined_samples(elements)?)
    }

    /// Receivers of a scene that was edited: those that stay, and in the zone, which none of them is in, new ones, for
    /// the mean area of a receiver each. Of the placement only the number of rays, the seed and the most receivers
    /// count.
    ///
    /// # Errors
    /// As [`Self::place`].
    pub fn place_again(
        sampler: &LitSampler,
        kept: KeptReceivers,
        zone: &Zone,
        placing: &Placing,
        lights: &TestLights,
        add_rows: &AddRows,
    ) -> Result<Self, Error> {
        let placement = Placement { scene: sampler.scene(), sampler, placing, lights, add_rows };
        placement.finish(placement.kept_samples(kept, zone)?)
    }
}

/// Receivers that stay where a scene was edited.
pub struct KeptReceivers {
    /// Points where irradiance is gathered.
    pub points: Vec<SurfacePoint>,
    /// Their rows over the elements that there are now.
    pub rows: HitCounts,
    /// Their rows over the sky's bins.
    pub sky_rows: HitCounts,
    /// Number of receivers before the edit.
    pub before: usize,
}

/// Inputs of all steps of [`MeshReceivers::place`].
struct Placement<'a> {
    scene: &'a Scene,
    sampler: &'a LitSampler<'a>,
    placing: &'a Placing,
    lights: &'a TestLights,
    add_rows: &'a AddRows<'a>,
}

impl<'a> Placement<'a> {
    /// Everything that follows from receivers with rows, and some more of them.
    fn finish(&self, set: ReceiverSamples<'a>) -> Result<MeshReceivers, Error> {
        let Self { scene, sampler, placing, lights, .. } = *self;
        let mut field = ReceiverField::new(set);
        let mut interpolation = field.interpolation_mesh(sampler, placing.seed)?;
        // An interpolation point that sees no receiver is inside of a solid or behind a wall.
        let mut weights = field.visible_weights(&interpolation.points, sampler.walker())?;
        retain_served(scene, &mut interpolation, &mut weights)?;
        field = self.serve_orphans(field, &interpolation.points, &mut weights)?;
        let estimates = Estimates::new(&field.set.rows, &field.set.sky_rows, lights, placing.rays)?;
        let smoothing = field.smoothing(&estimates);
        let smooth: Vec<Lights> = smoothing.par_iter().map(|row| weighted_sum(row, &estimates.light)).collect();
        let points = interpolation.points.par_iter();
        points.zip(&mut weights).for_each(|(point, weights)| field.fit(point, weights, &smooth));
        self.serve_rest(&field, &interpolation.points, &mut weights)?;
        retain_served(scene, &mut interpolation, &mut weights)?;
        let order = order_by_receivers(&weights, field.set.samples.len());
        interpolation.permute(&order)?;

        let samples = &field.set.samples;
        let smoothing = PackedWeights::new(smoothing.len(), |k| {
            smoothing[k].iter().map(|&entry| rotated_weight(samples, samples[k].normal, entry)).collect()
        })?;
        let points = &interpolation.points;
        let weights = PackedWeights::new(order.len(), |k| {
            let own = &weights[order[k] as usize];
            own.iter().map(|&entry| rotated_weight(samples, points[k].normal, entry)).collect()
        })?;
        Ok(MeshReceivers {
            points: Arc::new(field.set.points),
            rows: Arc::new(field.set.rows),
            sky_rows: Arc::new(field.set.sky_rows),
            smoothing: Arc::new(smoothing),
            interpolation: Arc::new(interpolation),
            weights: Arc::new(weights),
        })
    }

    /// Receivers that stay, and new ones in a zone.
    fn kept_samples(&self, kept: KeptReceivers, zone: &Zone) -> Result<ReceiverSamples<'a>, Error> {
        let Self { scene, sampler, placing, .. } = *self;
        let KeptReceivers { mut points, rows, sky_rows, before } = kept;
        (0u32..).zip(&mut points).for_each(|(k, point)| point.patch = k);
        let area = sampler.lit_area() / before.max(1) as f64;
        let candidates = sampler.candidates_for(area, placing.seed).into_par_iter();
        let near = candidates.filter(|sample| zone.contains(sample.position)).collect();
        let mut samples: Vec<Sample> = points.iter().map(sample_at).collect();
        samples.extend(sampler.lit_samples(near, placing.seed)?);
        let density = *sampler.density();
        let mut set = ReceiverSamples { scene, density, samples, points, rows, sky_rows, mean_area: 0.0 };
        set.add_rows(self.add_rows)?;
        set.share_out(sampler.lit_area());
        Ok(set)
    }

    /// Even receivers, and more of them where they differ from the mean of their neighbours.
    fn refined_samples(&self, elements: usize) -> Result<ReceiverSamples<'a>, Error> {
        let Self { sampler, placing, .. } = self;
        let wanted = sampler.lit_area() / f64::from(placing.edge * placing.edge);
        let most = ((placing.most as f64 * (1.0 - ORPHAN_ROOM)) as usize).max(1);
        let samples = sampler.samples(wanted.clamp(1.0, most as f64) as u32, placing.seed)?;
        let mut set = ReceiverSamples::new(self.scene, *sampler.density(), samples, elements)?;
        set.add_rows(self.add_rows)?;
        for round in 0..ROUNDS {
            let budget = most.saturating_sub(set.samples.len()) / (ROUNDS - round);
            let seed = placing.seed.wrapping_add(1 + round as u32);
            let estimates = Estimates::new(&set.rows, &set.sky_rows, self.lights, placing.rays)?;
            let added = set.worst_places(sampler, &estimates, budget, seed)?;
            if added.is_empty() {
                break;
            }
            set.samples.extend(added);
            set.add_rows(self.add_rows)?;
        }
        set.share_out(sampler.lit_area());
        Ok(set)
    }

    /// Makes receivers of some of the interpolation points that see none, and finds the weights of
    /// all of them again.
    fn serve_orphans(
        &self,
        mut field: ReceiverField<'a>,
        points: &[SurfacePoint],
        weights: &mut [PointWeights],
    ) -> Result<ReceiverField<'a>, Error> {
        let Self { sampler, placing, .. } = *self;
        let area = field.set.mean_area;
        for round in 0..ORPHAN_ROUNDS {
            let orphans: Vec<usize> = (0..weights.len()).filter(|&k| weights[k].is_empty()).collect();
            let budget = placing.most.saturating_sub(field.set.samples.len()) / (ORPHAN_ROUNDS - round);
            let step = ORPHAN_SHARE.max(orphans.len().div_ceil(budget.max(1)));
            if orphans.is_empty() || budget == 0 {
                break;
            }
            let chosen = orphans.iter().step_by(step);
            let sample = |&k: &usize| Sample {
                area: area / sampler.density().share(points[k].position),
                ..sample_at(&points[k])
            };
            let samples: Vec<Sample> = chosen.map(sample).collect();
            let lit = sampler.are_lit(&samples, placing.seed)?;
            field.set.samples.extend(samples.into_iter().zip(lit).filter_map(|(sample, lit)| lit.then_some(sample)));
            field.set.add_rows(self.add_rows)?;
            field = ReceiverField::new(field.set);
            let own: Vec<SurfacePoint> = orphans.iter().map(|&k| points[k]).collect();
            let found = field.visible_weights(&own, sampler.walker())?;
            for (k, found) in orphans.into_iter().zip(found) {
                weights[k] = found;
            }
        }
        Ok(field)
    }

    /// The nearest receivers have to serve the rest of the interpolation points, unless no light
    /// comes there at all.
    fn serve_rest(
        &self,
        field: &ReceiverField,
        points: &[SurfacePoint],
        weights: &mut [PointWeights],
    ) -> Result<(), Error> {
        let Self { sampler, placing, .. } = *self;
        let rest: Vec<usize> = (0..weights.len()).filter(|&k| weights[k].is_empty()).collect();
        let samples: Vec<Sample> = rest.iter().map(|&k| sample_at(&points[k])).collect();
        let lit = sampler.are_lit(&samples, placing.seed)?;
        let served: Vec<usize> = rest.into_iter().zip(lit).filter_map(|(k, lit)| lit.then_some(k)).collect();
        let found: Vec<_> = served.par_iter().map(|&k| field.nearest_weights(&points[k])).collect();
        served.into_iter().zip(found).for_each(|(k, found)| weights[k] = found);
        Ok(())
    }
}

/// Leaves out interpolation points without weights where others of their cell serve, so that no pixel between them
/// turns dark; the weights of those that stay are left.
fn retain_served(
    scene: &Scene,
    interpolation: &mut InterpolationMesh,
    weights: &mut Vec<PointWeights>,
) -> Result<(), Error> {
    let served: Vec<bool> = weights.iter().map(|weights| !weights.is_empty()).collect();
    let kept = interpolation.retain(scene, &served)?;
    // In place, for their order stays.
    kept.iter().enumerate().for_each(|(k, &before)| weights.swap(k, before as usize));
    weights.truncate(kept.len());
    Ok(())
}

/// An interpolation point as a sample, without an area.
fn sample_at(&SurfacePoint { position, normal, .. }: &SurfacePoint) -> Sample {
    Sample { position, normal, triangle: NONE, ..Sample::default() }
}

fn first_smooth(receivers: usize) -> usize {
    (QUADRANTS * receivers).next_multiple_of(ALIGNED)
}

/// The order of interpolation points by the receivers that they take most from: what is near in space is near in memory.
/// Those without weights come last.
fn order_by_receivers(weights: &[PointWeights], receivers: usize) -> Vec<u32> {
    let greatest = |row: &PointWeights| {
        let most = row.iter().copied().reduce(|a, b| if b.1 > a.1 { b } else { a });
        most.map_or(receivers, |entry| entry.0 as usize)
    };
    let mut next = vec![0u32; receivers + 1];
    weights.iter().for_each(|row| next[greatest(row)] += 1);
    let mut first = 0;
    for next in &mut next {
        (first, *next) = (first + *next, first);
    }
    let mut order = vec![0u32; weights.len()];
    for (k, row) in (0u32..).zip(weights.iter()) {
        let place = &mut next[greatest(row)];
        order[*place as usize] = k;
        *place += 1;
    }
    order
}

/// The weight of a receiver in a value at a place with this normal, to which it is rotated.
fn rotated_weight(samples: &[Sample], normal: Vec3, (receiver, weight): Entry) -> Weight {
    Weight { receiver, weight, rotation: rotation(samples[receiver as usize].normal, normal) }
}

/// The difference of two normals, to the right and upwards of the frame of the first; `None` where it is too small to
/// count.
fn rotation(from: Vec3, to: Vec3) -> Option<Vec2> {
    let difference = to - from;
    if difference.length() <= MIN_ROTATION {
        return None;
    }
    let (right, up) = frame(from);
    let rotation = difference.clamp_length_max(MAX_ROTATION);
    Some(Vec2::new(rotation.dot(right), rotation.dot(up)))
}
