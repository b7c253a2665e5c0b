//! Receivers on the mesh: points where irradiance is gathered, more of them where it bends; their values made smooth; and
//! nodes of the mesh that take the mean of the receivers about.

use formfactor::{Csr, HitRows, QUARTERS, Receivers, turns};
use glam::{Vec3, Vec4};
use patches::{LitSampler, Nearest, Sample};
use rayon::prelude::*;
use scene::math::sqrt;
use scene::{NONE, Scene, Sides, SurfacePoint};

use super::sight::sees;
use super::test_lights::{Estimates, Lights};
use crate::error::Error;

/// Irradiance counts as at least this share of its mean.
const DARK: f32 = 0.05;
/// Rounds in which receivers are added.
const ROUNDS: usize = 2;
/// Receivers are added where those about differ from their neighbours' mean by more than this share.
const TOLERANCE: f32 = 0.05;
/// Difference that noise may make, in squared standard deviations, before a receiver counts as different from its neighbours.
const CERTAIN: f32 = 4.0;
/// Receivers that are compared: one and its neighbours.
const COMPARED: usize = 7;
/// Candidates for a receiver to be added.
const CANDIDATES: usize = 2;

/// Receivers that a receiver may be smoothed with.
const SMOOTHED: usize = 24;
/// Squared standard deviations by which those may differ from it.
const ALIKE: f32 = 5.0;

/// Receivers that a node takes the mean of; one more gives the distance at which the weight is zero.
const NEIGHBOURS: usize = 6;
/// Receivers among which they are chosen.
const SEARCHED: usize = 20;
/// Furthest that a receiver may be from a node, in edges between receivers.
const FAR: f32 = 4.0;
/// The same for what is smaller than this many edges.
const SMALL: f32 = 3.0;
const FURTHEST: f32 = 8.0;
/// What a turn of the normal counts in the choice, over that in the search.
const TURN: f32 = 100.0;

/// Turns of the normal up to this are none.
const LEAST_TURN: f32 = 0.05;
/// Irradiance is turned by no more than this, however much the normal differs.
const MOST_TURN: f32 = 0.5;
/// Smoothed values begin at multiples of this: ranges of a buffer do at 256 bytes.
const ALIGNED: usize = 16;

/// Edge of the cells over which the distance between nodes may change, in mean edges between receivers.
const CELL_EDGE: f32 = 6.0;
/// Least distance between nodes, in the same.
const LEAST_NODE_EDGE: f32 = 0.3;
/// Nodes nearer than this may be one, in the same.
const WELD: f32 = 0.25;
/// Rounds in which nodes that see no receiver become receivers, and the share of them that does in each.
const ORPHAN_ROUNDS: usize = 2;
const ORPHAN_SHARE: usize = 3;
/// Share of the receivers that is kept for them.
const ORPHAN_ROOM: f64 = 0.2;

/// How receivers are placed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placing {
    /// Distance between them where nothing happens, m.
    pub edge: f32,
    /// Most receivers.
    pub most: usize,
    /// Rays of each.
    pub rays: u32,
    /// Changes every random number.
    pub seed: u32,
}

/// Adds the rows of points.
pub type AddRows<'a> = dyn Fn(&mut HitRows, &[SurfacePoint]) -> Result<(), Error> + 'a;

/// Receivers and the mesh between them.
#[derive(Clone)]
pub struct MeshReceivers {
    /// Where irradiance is gathered.
    pub points: Vec<SurfacePoint>,
    /// Their rows over the facets, one for each quarter of a receiver's hemisphere.
    pub rows: HitRows,
    /// What makes of the quarters' values one for each receiver, and smooth: the mean with those about that differ by no
    /// more than their noise.
    pub smoothing: Csr,
    /// The nodes, and the triangles' grids over them.
    pub nodes: Receivers,
    /// Weights of the values at each node: of the quarters, and from [`Self::first_smooth`] on of the smoothed ones. For light
    /// that is the same everywhere the sum is that of the smoothed ones.
    pub weights: Csr,
}

impl MeshReceivers {
    /// No receivers.
    pub fn none(scene: &Scene) -> Result<Self, Error> {
        let nodes =
            Receivers::new(scene, &vec![Sides::default(); scene.triangles.len()], 1.0, 1.0, |_, _| None, |_| None)?;
        let empty = || Csr { row_start: vec![0], ..Csr::default() };
        Ok(Self { points: Vec::new(), rows: HitRows::new(0)?, smoothing: empty(), nodes, weights: empty() })
    }

    /// Where the smoothed values of so many receivers stand among all: after those of the quarters.
    pub fn first_smooth(&self) -> usize {
        first_smooth(self.points.len())
    }

    /// The places without the rows, which are most of the memory.
    pub fn without_rows(self) -> Result<Self, Error> {
        let smoothing = Csr { row_start: vec![0], ..Csr::default() };
        Ok(Self { rows: HitRows::new(0)?, smoothing, ..self })
    }

    /// Receivers of the light of so many facets: equal-area ones, then more of them where they are not the mean of their
    /// neighbours under `lights` (the facets' exitance), then some where nodes see none.
    pub fn place(
        scene: &Scene,
        sampler: &LitSampler,
        facets: usize,
        placing: &Placing,
        lights: &[Lights],
        add_rows: &AddRows,
    ) -> Result<Self, Error> {
        let wanted = sampler.lit_area() / f64::from(placing.edge * placing.edge);
        let most = (placing.most as f64 * (1.0 - ORPHAN_ROOM)) as usize;
        let samples = sampler.samples(wanted.clamp(1.0, most as f64) as u32, placing.seed);
        let mut set = Set { scene, samples, points: Vec::new(), rows: HitRows::new(facets)? };
        set.add_rows(add_rows)?;
        for round in 0..ROUNDS {
            let room = most.saturating_sub(set.samples.len()) / (ROUNDS - round);
            let seed = placing.seed.wrapping_add(1 + round as u32);
            let added = set.worst_places(sampler, &Estimates::new(&set.rows, lights, placing.rays)?, room, seed);
            if added.is_empty() {
                break;
            }
            set.samples.extend(added);
            set.add_rows(add_rows)?;
        }
        // All stand for the same mean area: distances are measured in the mean edge.
        let area = (sampler.lit_area() / set.samples.len().max(1) as f64) as f32;
        set.samples.iter_mut().for_each(|sample| sample.area = area);
        let edge = sqrt(area);
        let mut field = Field::new(set, edge);
        let mut nodes = field.nodes(sampler, placing.seed)?;

        // A node that sees no receiver is inside of a solid or behind a wall: others of its cell serve. Where there are none,
        // some become receivers themselves.
        let mut found: Vec<Vec<(u32, f32)>> = nodes.points.par_iter().map(|node| field.weights(node, true)).collect();
        let good: Vec<bool> = found.iter().map(|weights| !weights.is_empty()).collect();
        let kept = nodes.retain(scene, &good)?;
        let mut weights: Vec<Vec<(u32, f32)>> = kept.iter().map(|&k| std::mem::take(&mut found[k as usize])).collect();
        drop(found);
        for round in 0..ORPHAN_ROUNDS {
            let orphans: Vec<usize> = (0..weights.len()).filter(|&k| weights[k].is_empty()).collect();
            let room = placing.most.saturating_sub(field.set.samples.len()) / (ORPHAN_ROUNDS - round);
            let step = ORPHAN_SHARE.max(orphans.len().div_ceil(room.max(1)));
            if orphans.is_empty() || room == 0 {
                break;
            }
            let sample = |k: &usize| Sample { area, ..sample_at(&nodes.points[*k]) };
            field.set.samples.extend(orphans.iter().step_by(step).map(sample));
            field.set.add_rows(add_rows)?;
            field = Field::new(field.set, edge);
            let found: Vec<_> = orphans.par_iter().map(|&k| field.weights(&nodes.points[k], true)).collect();
            orphans.into_iter().zip(found).for_each(|(k, found)| weights[k] = found);
        }
        // The nearest receivers have to serve the rest, unless no light comes there at all.
        let last = |(node, weights): (&SurfacePoint, &mut Vec<(u32, f32)>)| {
            if weights.is_empty() && sampler.is_lit(&sample_at(node), placing.seed) {
                *weights = field.weights(node, false);
            }
        };
        nodes.points.par_iter().zip(&mut weights).for_each(last);

        let estimates = Estimates::new(&field.set.rows, lights, placing.rays)?;
        let mut smoothing = field.smoothing(&estimates);
        let count = field.set.samples.len();
        let table = |columns: usize, rows: &mut [Vec<(u32, f32)>]| {
            rows.par_iter_mut().for_each(|row| row.sort_unstable_by_key(|w| w.0));
            Csr::from_rows(columns, rows)
        };
        let set = &field.set;
        let turn = |from: u32, to: Vec3| turn(set.samples[from as usize].normal, to);
        let first_smooth = first_smooth(count);
        smoothing.par_iter_mut().enumerate().for_each(|(k, row)| {
            let normal = set.samples[k].normal;
            let quarters = |&(j, weight): &(u32, f32)| {
                let turned = turn(j, normal);
                (0..QUARTERS).map(move |q| (quarter(j, q), weight * (1.0 + turned.map_or(0.0, |t| t[q]))))
            };
            *row = row.iter().flat_map(quarters).collect();
        });
        weights.par_iter_mut().enumerate().for_each(|(k, row)| {
            let normal = nodes.points[k].normal;
            let mut entries: Vec<(u32, f32)> = row.iter().map(|&(j, w)| (first_smooth as u32 + j, w)).collect();
            for &(j, weight) in &*row {
                let turned = turn(j, normal).into_iter().flatten().enumerate();
                entries.extend(turned.map(|(q, t)| (quarter(j, q), weight * t)));
            }
            *row = entries;
        });
        let smoothing = table(QUARTERS * count, &mut smoothing)?;
        let weights = table(first_smooth + count, &mut weights)?;
        Ok(Self { points: field.set.points, rows: field.set.rows, smoothing, nodes, weights })
    }
}

fn first_smooth(receivers: usize) -> usize {
    (QUARTERS * receivers).next_multiple_of(ALIGNED)
}

/// The row of a quarter of a receiver.
fn quarter(receiver: u32, quarter: usize) -> u32 {
    QUARTERS as u32 * receiver + quarter as u32
}

/// By what share the irradiance from each quarter changes as the normal turns; nothing where it does not.
fn turn(from: Vec3, to: Vec3) -> Option<[f32; QUARTERS]> {
    let way = to - from;
    (way.length() > LEAST_TURN).then(|| turns(from).map(|t| t.dot(way.clamp_length_max(MOST_TURN))))
}

/// Receivers so far. Rows may be missing for the last samples.
struct Set<'a> {
    scene: &'a Scene,
    samples: Vec<Sample>,
    points: Vec<SurfacePoint>,
    rows: HitRows,
}

impl Set<'_> {
    fn add_rows(&mut self, add_rows: &AddRows) -> Result<(), Error> {
        let first = self.points.len();
        let point =
            |(s, patch): (&Sample, u32)| SurfacePoint { position: s.position, patch, normal: s.normal, weight: 1.0 };
        self.points.extend(self.samples[first..].iter().zip(first as u32..).map(point));
        add_rows(&mut self.rows, &self.points[first..])
    }

    /// Samples about the receivers that are least the mean of their neighbours, at most `room`.
    fn worst_places(&self, sampler: &LitSampler, estimates: &Estimates, room: usize, seed: u32) -> Vec<Sample> {
        let samples = &self.samples;
        if room == 0 || samples.len() <= COMPARED {
            return Vec::new();
        }
        let nearest = Nearest::new(samples);
        let Estimates { light, variance } = estimates;
        let error = |(k, sample): (usize, &Sample)| {
            let (found, count) = nearest.samples::<COMPARED>(sample.position, sample.normal, FAR);
            let others: Vec<(u32, f32)> = found[..count].iter().filter(|f| f.0 as usize != k).copied().collect();
            if others.len() < 2 {
                return 0.0;
            }
            let weights = shepard(others.iter().map(|o| o.1), others[others.len() - 1].1);
            let total = weights.iter().sum::<f32>().max(f32::MIN_POSITIVE);
            let share = |v: usize| {
                let each = || others.iter().zip(&weights).map(|(o, w)| (o.0 as usize, w / total));
                let mean: Vec4 = each().map(|(j, w)| light[j][v] * w).sum();
                let noise: Vec4 = each().map(|(j, w)| variance[j][v] * (w * w)).sum::<Vec4>() + variance[k][v];
                let difference = light[k][v] - mean;
                let real = (difference * difference - noise * CERTAIN).max(Vec4::ZERO);
                let scale = light[k][v].max(mean) + Vec4::splat(DARK);
                (real / (scale * scale)).max_element()
            };
            sqrt(share(0).max(share(1)))
        };
        let errors: Vec<f32> = samples.par_iter().enumerate().map(error).collect();
        let about = |sample: &Sample| {
            let (found, count) = nearest.samples::<4>(sample.position, sample.normal, FAR);
            found[..count].iter().map(|f| errors[f.0 as usize]).sum::<f32>() / count.max(1) as f32
        };
        let candidates = sampler.candidates((CANDIDATES * room) as u32, seed);
        let wanted = candidates.into_par_iter().filter(|sample| about(sample) > TOLERANCE).collect();
        let found = sampler.lit_samples(wanted, seed);
        let mut order: Vec<(f32, usize)> = found.par_iter().enumerate().map(|(k, s)| (about(s), k)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        order.truncate(room);
        let mut chosen: Vec<usize> = order.into_iter().map(|(_, k)| k).collect();
        chosen.sort_unstable();
        chosen.into_iter().map(|k| found[k]).collect()
    }
}

/// A node as a sample, without an area.
fn sample_at(&SurfacePoint { position, normal, .. }: &SurfacePoint) -> Sample {
    Sample { position, normal, triangle: NONE, ..Sample::default() }
}

/// Receivers in space.
struct Field<'a> {
    set: Set<'a>,
    nearest: Nearest,
    /// Mean edge between receivers, m.
    edge: f32,
}

impl<'a> Field<'a> {
    fn new(set: Set<'a>, edge: f32) -> Self {
        Self { nearest: Nearest::new(&set.samples), edge, set }
    }

    /// Nodes as close as receivers are about them.
    fn nodes(&self, sampler: &LitSampler, seed: u32) -> Result<Receivers, Error> {
        let Self { set, nearest, edge, .. } = self;
        let spacing = |s: &Sample| {
            let (found, count) = nearest.samples::<5>(s.position, s.normal, FAR);
            let sum: f32 = found[..count].iter().map(|f| set.samples[f.0 as usize].position.distance(s.position)).sum();
            sum / (count.max(2) - 1) as f32
        };
        let spacing: Vec<f32> = set.samples.par_iter().map(spacing).collect();
        // What is small may have no receiver of its own.
        let within = |point: &SurfacePoint, size: f32| {
            let far = if size <= SMALL * edge { FURTHEST } else { FAR };
            let (found, count) = nearest.samples::<3>(point.position, point.normal, far);
            let mean = found[..count].iter().map(|f| spacing[f.0 as usize]).sum::<f32>() / count as f32;
            (count > 0).then(|| mean.max(LEAST_NODE_EDGE * edge))
        };
        // Light may come where no receiver is: nodes there gather it themselves.
        let gathering = |point: &SurfacePoint| sampler.is_lit(&sample_at(point), seed).then_some(SMALL * edge);
        let both = vec![Sides { front: true, back: true }; set.scene.triangles.len()];
        Ok(Receivers::new(set.scene, &both, CELL_EDGE * edge, WELD * edge, within, gathering)?)
    }

    /// The receivers that a node takes, with weights that sum to 1: the nearest in position and normal. None when it
    /// must see them and sees none.
    fn weights(&self, node: &SurfacePoint, must_see: bool) -> Vec<(u32, f32)> {
        let Self { set, nearest, edge, .. } = self;
        let (mut found, mut count) = nearest.samples::<SEARCHED>(node.position, node.normal, FAR);
        if count == 0 {
            (found, count) = nearest.samples::<SEARCHED>(node.position, node.normal, FURTHEST);
        }
        if count == 0 {
            return Vec::new();
        }
        let found = &mut found[..count];
        for (k, distance) in &mut *found {
            let turn = node.normal.distance_squared(set.samples[*k as usize].normal);
            *distance = sqrt(*distance * *distance + TURN * turn);
        }
        found.sort_by(|a, b| a.1.total_cmp(&b.1));
        let seen = |(k, _): &(u32, f32)| {
            let there = &set.samples[*k as usize];
            let (from, to) = ((node.position, node.normal), (there.position, there.normal));
            !must_see || sees(set.scene, from, to, *edge)
        };
        let mut kept: Vec<(u32, f32)> = found.iter().copied().filter(seen).take(NEIGHBOURS + 1).collect();
        let Some(&(_, range)) = kept.last() else { return kept };
        let range = if kept.len() > NEIGHBOURS { range } else { 2.0 * range };
        let weights = shepard(kept.iter().map(|k| k.1), range);
        let total: f32 = weights.iter().sum();
        kept.iter_mut().zip(weights).for_each(|(k, weight)| k.1 = weight / total);
        kept.truncate(NEIGHBOURS);
        kept
    }

    /// For each receiver the mean with those about that it sees and that differ from it, under every light, by no more than
    /// noise can: less noise where light is even, and no less detail where it is not.
    fn smoothing(&self, estimates: &Estimates) -> Vec<Vec<(u32, f32)>> {
        let Self { set, nearest, edge, .. } = self;
        let Estimates { light, variance } = estimates;
        let row = |(k, own): (usize, &Sample)| {
            let (found, count) = nearest.samples::<{ SMOOTHED + 1 }>(own.position, own.normal, FAR);
            let mut kept = vec![(k as u32, 1.0)];
            for &(other, _) in found[..count].iter().filter(|f| f.0 as usize != k) {
                let (j, there) = (other as usize, &set.samples[other as usize]);
                let difference = |v: usize| {
                    let way = light[k][v] - light[j][v];
                    let noise = (variance[k][v] + variance[j][v]) * ALIKE + Vec4::splat(f32::MIN_POSITIVE);
                    (way * way / noise).max_element()
                };
                let weight = 1.0 - difference(0).max(difference(1));
                let (from, to) = ((own.position, own.normal), (there.position, there.normal));
                if weight > 0.0 && sees(set.scene, from, to, *edge) {
                    kept.push((other, weight));
                }
            }
            let total: f32 = kept.iter().map(|k| k.1).sum();
            kept.iter_mut().for_each(|k| k.1 /= total);
            kept
        };
        set.samples.par_iter().enumerate().map(row).collect()
    }
}

/// Weights by distance: inverse, down to zero at the range (Franke and Little's form of Shepard's weights).
fn shepard(distances: impl Iterator<Item = f32>, range: f32) -> Vec<f32> {
    let range = range.max(1e-6) * 1.001;
    let weight = |d: f32| {
        let d = d.max(1e-3 * range);
        ((range - d) / (range * d)).powi(2)
    };
    distances.map(weight).collect()
}
