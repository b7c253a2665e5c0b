//! Receivers on the mesh: points where irradiance is gathered, more of them where it bends; their values made smooth; and
//! nodes of the mesh that take their value from the receivers about.

use formfactor::{Csr, HitRows, QUARTERS, turns};
use glam::{Mat2, Vec2, Vec3, Vec4};
use multibounce::halving_order;
use patches::{LitSampler, Nearest, Receivers, Sample};
use rayon::prelude::*;
use scene::math::sqrt;
use scene::sampling::frame;
use scene::{NONE, Scene, Sides, SurfacePoint};

use super::sight::sees;
use super::test_lights::{Estimates, Lights, VECTORS};
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
const ALIKE: f32 = 10.0;
/// Ridge of the linear fit through them, in squared edges between receivers.
const SMOOTH_RIDGE: f32 = 0.3;

/// Receivers that a node takes its value from; one more gives the distance at which the weight is zero.
const NEIGHBOURS: usize = 8;
/// Receivers among which they are chosen.
const SEARCHED: usize = 20;
/// Ridge of the linear fit through them, in squared edges between receivers.
const NODE_RIDGE: f32 = 0.03;
/// A node's value may be beyond those of its receivers by this share of the greatest: where light is even rounding would not let
/// it go anywhere.
const SLACK: f32 = 0.01;
/// Weights below this are left out.
const LEAST_WEIGHT: f32 = 0.02;
/// Furthest that receivers are compared, in edges between them.
const NEAR: f32 = 4.0;
/// Furthest that a receiver may be from a node, or from one that is smoothed with it, in the same.
const FAR: f32 = 5.5;
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

/// Rows of an operator that are made together.
const BLOCK_ROWS: usize = 1 << 16;

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

/// The number of a receiver or a column, with its weight or distance.
type Entry = (u32, f32);

/// Adds the rows of points.
pub type AddRows<'a> = dyn Fn(&mut HitRows, &[SurfacePoint]) -> Result<(), Error> + 'a;

/// Receivers and the mesh between them.
#[derive(Clone)]
pub struct MeshReceivers {
    /// Where irradiance is gathered.
    pub points: Vec<SurfacePoint>,
    /// Their rows over the facets, one for each quarter of a receiver's hemisphere.
    pub rows: HitRows,
    /// What makes of the quarters' values one for each receiver, and smooth: a linear fit with those about that differ by no
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
        let nodes = Receivers::new(
            scene,
            &vec![Sides::default(); scene.geometry.triangles.len()],
            1.0,
            1.0,
            |_, _| None,
            |_| None,
        )?;
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
        let mut found: Vec<Vec<Entry>> = nodes.points.par_iter().map(|node| field.weights(node, true)).collect();
        let good: Vec<bool> = found.iter().map(|weights| !weights.is_empty()).collect();
        let kept = nodes.retain(scene, &good)?;
        let mut weights: Vec<Vec<Entry>> = kept.iter().map(|&k| std::mem::take(&mut found[k as usize])).collect();
        drop(found);
        for round in 0..ORPHAN_ROUNDS {
            let orphans: Vec<usize> = (0..weights.len()).filter(|&k| weights[k].is_empty()).collect();
            let room = placing.most.saturating_sub(field.set.samples.len()) / (ORPHAN_ROUNDS - round);
            let step = ORPHAN_SHARE.max(orphans.len().div_ceil(room.max(1)));
            if orphans.is_empty() || room == 0 {
                break;
            }
            let sample = |k: &usize| Sample { area, ..sample_at(&nodes.points[*k]) };
            let is_lit = |sample: &Sample| sampler.is_lit(sample, placing.seed);
            field.set.samples.par_extend(orphans.par_iter().step_by(step).map(sample).filter(is_lit));
            field.set.add_rows(add_rows)?;
            field = Field::new(field.set, edge);
            let found: Vec<_> = orphans.par_iter().map(|&k| field.weights(&nodes.points[k], true)).collect();
            orphans.into_iter().zip(found).for_each(|(k, found)| weights[k] = found);
        }
        let estimates = Estimates::new(&field.set.rows, lights, placing.rays)?;
        let smoothing = field.smoothing(&estimates);
        let smooth: Vec<Lights> = smoothing.par_iter().map(|row| weighted(row, &estimates.light)).collect();
        nodes.points.par_iter().zip(&mut weights).for_each(|(node, weights)| field.bend(node, weights, &smooth));
        // The nearest receivers have to serve the rest, unless no light comes there at all.
        let last = |(node, weights): (&SurfacePoint, &mut Vec<Entry>)| {
            if weights.is_empty() && sampler.is_lit(&sample_at(node), placing.seed) {
                *weights = field.weights(node, false);
            }
        };
        nodes.points.par_iter().zip(&mut weights).for_each(last);

        let set = &field.set;
        let (count, first_smooth) = (set.samples.len(), first_smooth(set.samples.len()));
        let turn = |from: u32, to: Vec3| turn(set.samples[from as usize].normal, to);
        let of_receiver = |k: usize, row: &[Entry]| {
            let quarters = |&(j, weight): &Entry| {
                let turned = turn(j, set.samples[k].normal);
                (0..QUARTERS).map(move |q| (quarter(j, q), weight * (1.0 + turned.map_or(0.0, |t| t[q]))))
            };
            row.iter().flat_map(quarters).collect()
        };
        let of_node = |k: usize, row: &[Entry]| {
            let quarters = |&(j, weight): &Entry| {
                let turned = turn(j, nodes.points[k].normal).into_iter().flatten().enumerate();
                turned.map(move |(q, t)| (quarter(j, q), weight * t))
            };
            let smooth = row.iter().map(|&(j, weight)| (first_smooth as u32 + j, weight));
            row.iter().flat_map(quarters).chain(smooth).collect()
        };
        let smoothing = table(QUARTERS * count, smoothing, &of_receiver)?;
        let weights = table(first_smooth + count, weights, &of_node)?;
        Ok(Self { points: field.set.points, rows: field.set.rows, smoothing, nodes, weights })
    }
}

fn first_smooth(receivers: usize) -> usize {
    (QUARTERS * receivers).next_multiple_of(ALIGNED)
}

/// An operator from what `entries` makes of each row, in blocks: the rows are many, and theirs are longer.
fn table(
    columns: usize,
    rows: Vec<Vec<Entry>>,
    entries: &(dyn Fn(usize, &[Entry]) -> Vec<Entry> + Sync),
) -> Result<Csr, Error> {
    let mut csr = Csr { columns, row_start: vec![0], ..Csr::default() };
    for (block, rows) in rows.chunks(BLOCK_ROWS).enumerate() {
        let made = |(k, row): (usize, &Vec<Entry>)| {
            let mut row = entries(block * BLOCK_ROWS + k, row);
            row.sort_unstable_by_key(|entry| entry.0);
            row
        };
        csr.push_rows(&rows.par_iter().enumerate().map(made).collect::<Vec<_>>())?;
    }
    Ok(csr)
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
    /// Makes the rows that are missing. New samples are put into an order in which neighbours are near, so that lookups find
    /// what they need in the caches.
    fn add_rows(&mut self, add_rows: &AddRows) -> Result<(), Error> {
        let first = self.points.len();
        let added = self.samples.split_off(first);
        let (positions, normals): (Vec<Vec3>, Vec<Vec3>) = added.iter().map(|s| (s.position, s.normal)).unzip();
        let order = halving_order(&positions, &normals, &[]);
        self.samples.extend(order.iter().map(|&k| added[k as usize]));
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
            let (found, count) = nearest.samples::<COMPARED>(sample.position, sample.normal, NEAR);
            let others: Vec<Entry> = found[..count].iter().filter(|f| f.0 as usize != k).copied().collect();
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
            let (found, count) = nearest.samples::<4>(sample.position, sample.normal, NEAR);
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
            let (found, count) = nearest.samples::<5>(s.position, s.normal, NEAR);
            let sum: f32 = found[..count].iter().map(|f| set.samples[f.0 as usize].position.distance(s.position)).sum();
            sum / (count.max(2) - 1) as f32
        };
        let spacing: Vec<f32> = set.samples.par_iter().map(spacing).collect();
        // What is small may have no receiver of its own.
        let within = |point: &SurfacePoint, size: f32| {
            let far = if size <= SMALL * edge { FURTHEST } else { NEAR };
            let (found, count) = nearest.samples::<3>(point.position, point.normal, far);
            let mean = found[..count].iter().map(|f| spacing[f.0 as usize]).sum::<f32>() / count as f32;
            (count > 0).then(|| mean.max(LEAST_NODE_EDGE * edge))
        };
        // Light may come where no receiver is: nodes there gather it themselves.
        let gathering = |point: &SurfacePoint| sampler.is_lit(&sample_at(point), seed).then_some(SMALL * edge);
        let both = vec![Sides { front: true, back: true }; set.scene.geometry.triangles.len()];
        Ok(Receivers::new(set.scene, &both, CELL_EDGE * edge, WELD * edge, within, gathering)?)
    }

    /// The receivers that a node takes, with weights that sum to 1: the nearest in position and normal. None when it
    /// must see them and sees none.
    fn weights(&self, node: &SurfacePoint, must_see: bool) -> Vec<Entry> {
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
        let seen = |(k, _): &Entry| {
            let there = &set.samples[*k as usize];
            let (from, to) = ((node.position, node.normal), (there.position, there.normal));
            !must_see || sees(set.scene, from, to, *edge)
        };
        let mut kept: Vec<Entry> = found.iter().copied().filter(seen).take(NEIGHBOURS + 1).collect();
        let Some(&(_, range)) = kept.last() else { return kept };
        let range = if kept.len() > NEIGHBOURS { range } else { 2.0 * range };
        let weights = shepard(kept.iter().map(|k| k.1), range);
        let total: f32 = weights.iter().sum();
        kept.iter_mut().zip(weights).for_each(|(k, weight)| k.1 = weight / total);
        kept.truncate(NEIGHBOURS);
        kept.shrink_to_fit();
        kept
    }

    /// Makes a node's weights those of a linear fit through its receivers, as far as under every light the value stays
    /// between the least and the greatest of theirs.
    fn bend(&self, node: &SurfacePoint, weights: &mut Vec<Entry>, smooth: &[Lights]) {
        let changes = self.linear(node.position, node.normal, weights, NODE_RIDGE);
        let mean = weighted(weights, smooth);
        let step: Vec<Entry> = weights.iter().zip(&changes).map(|(w, change)| (w.0, w.1 * change)).collect();
        let step = weighted(&step, smooth);
        let mut share: f32 = 1.0;
        for v in 0..VECTORS {
            let each = || weights.iter().map(|w| smooth[w.0 as usize][v]);
            let (least, most) = (each().reduce(Vec4::min), each().reduce(Vec4::max));
            let (Some(least), Some(most)) = (least, most) else { return };
            let slack = most * SLACK;
            let room = Vec4::select(step[v].cmpgt(Vec4::ZERO), most + slack - mean[v], least - slack - mean[v]);
            let moves = step[v].abs().cmpgt(Vec4::splat(f32::MIN_POSITIVE));
            share = share.min(Vec4::select(moves, room / step[v], Vec4::ONE).min_element());
        }
        let share = share.max(0.0);
        weights.iter_mut().zip(changes).for_each(|(w, change)| w.1 *= 1.0 + share * change);
        weights.retain(|w| w.1.abs() >= LEAST_WEIGHT);
        let total: f32 = weights.iter().map(|w| w.1).sum();
        weights.iter_mut().for_each(|w| w.1 /= total);
    }

    /// What a linear fit at a place changes in weights that sum to 1, as shares of each, where `ridge` holds the slope back.
    fn linear(&self, position: Vec3, normal: Vec3, weights: &[Entry], ridge: f32) -> Vec<f32> {
        let (right, up) = frame(normal);
        let place = |k: u32| {
            let way = (self.set.samples[k as usize].position - position) / self.edge;
            Vec2::new(way.dot(right), way.dot(up))
        };
        let places: Vec<(Vec2, f32)> = weights.iter().map(|&(k, w)| (place(k), w)).collect();
        let middle: Vec2 = places.iter().map(|&(p, w)| p * w).sum();
        let mut spread = Mat2::from_diagonal(Vec2::splat(ridge));
        for &(p, w) in &places {
            let away = p - middle;
            spread += Mat2::from_cols(away * away.x, away * away.y) * w;
        }
        let slope = spread.inverse() * -middle;
        places.iter().map(|&(p, _)| slope.dot(p - middle)).collect()
    }

    /// For each receiver a linear fit through those about that it sees and that differ from it, under every light, by no more
    /// than noise can: less noise where light is even or changes evenly, and no less detail where it does not. No weight is
    /// negative.
    fn smoothing(&self, estimates: &Estimates) -> Vec<Vec<Entry>> {
        let Self { set, nearest, edge, .. } = self;
        let Estimates { light, variance } = estimates;
        let row = |(k, own): (usize, &Sample)| {
            let (found, count) = nearest.samples::<{ SMOOTHED + 2 }>(own.position, own.normal, FAR);
            let range = found[..count].last().map_or(1.0, |last| last.1.max(f32::MIN_POSITIVE) * 1.001);
            let mut kept = vec![(k as u32, 1.0)];
            for &(other, distance) in found[..count].iter().filter(|f| f.0 as usize != k) {
                let (j, there) = (other as usize, &set.samples[other as usize]);
                let difference = |v: usize| {
                    let way = light[k][v] - light[j][v];
                    let noise = (variance[k][v] + variance[j][v]) * ALIKE + Vec4::splat(f32::MIN_POSITIVE);
                    (way * way / noise).max_element()
                };
                let weight = 1.0 - difference(0).max(difference(1));
                let (from, to) = ((own.position, own.normal), (there.position, there.normal));
                if weight > 0.0 && sees(set.scene, from, to, *edge) {
                    kept.push((other, weight * (1.0 - (distance / range).powi(2))));
                }
            }
            let total: f32 = kept.iter().map(|k| k.1).sum();
            kept.iter_mut().for_each(|k| k.1 /= total);
            let changes = self.linear(own.position, own.normal, &kept, SMOOTH_RIDGE);
            let least = changes.iter().copied().fold(0.0, f32::min);
            let share = if least < -1.0 { -1.0 / least } else { 1.0 };
            kept.iter_mut().zip(changes).for_each(|(k, change)| k.1 *= 1.0 + share * change);
            kept
        };
        set.samples.par_iter().enumerate().map(row).collect()
    }
}

/// The sum of some values under all lights.
fn weighted(weights: &[Entry], values: &[Lights]) -> Lights {
    let mut sum = [Vec4::ZERO; VECTORS];
    for &(k, weight) in weights {
        sum.iter_mut().zip(values[k as usize]).for_each(|(sum, value)| *sum += value * weight);
    }
    sum
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

#[cfg(test)]
mod tests {
    use scene::sampling::{hash, hash3, unit};
    use scene::{SceneParts, Triangle, TriangleUv};

    use super::*;

    /// Receivers at random places of a square of 10 × 10 m, one a square metre, far from a scene of one triangle.
    fn square(scene: &Scene) -> Field<'_> {
        let place = |k: u32| Vec3::new(10.0 * unit(hash3(k, 1, 5)), 10.0 * unit(hash3(k, 2, 5)), 100.0);
        let sample = |k| Sample { position: place(k), normal: Vec3::Z, area: 1.0, ..Sample::default() };
        let samples = (0..100).map(sample).collect();
        Field::new(Set { scene, samples, points: Vec::new(), rows: HitRows::new(1).unwrap() }, 1.0)
    }

    fn triangle() -> Scene {
        let triangles = vec![Triangle { edge_a: Vec3::X, edge_b: Vec3::Y, ..Triangle::default() }];
        let parts = SceneParts {
            triangles,
            uvs: vec![TriangleUv::default()],
            materials: vec![<_>::default()],
            ..<_>::default()
        };
        Scene::new(parts).unwrap()
    }

    /// Light that rises along x from 1 to 2, and light with a step.
    fn light(position: Vec3) -> Lights {
        [
            Vec4::new(1.0 + 0.1 * position.x, 0.0, 0.0, 0.0),
            Vec4::new(if position.y > 5.0 { 2.0 } else { 1.0 }, 0.0, 0.0, 0.0),
        ]
    }

    #[test]
    fn nodes_take_a_slope_as_it_is_and_leave_no_range() {
        let scene = triangle();
        let field = square(&scene);
        let smooth: Vec<Lights> = field.set.samples.iter().map(|s| light(s.position)).collect();
        let (mut fit_error, mut mean_error, mut count) = (0.0f32, 0.0f32, 0);
        for k in 0..400 {
            let position = Vec3::new(10.0 * unit(hash3(k, 3, 5)), 10.0 * unit(hash3(k, 4, 5)), 100.0);
            let node = SurfacePoint { position, normal: Vec3::Z, ..SurfacePoint::default() };
            let mut weights = field.weights(&node, true);
            let mean = weighted(&weights, &smooth);
            let range = |v: usize| {
                let each = || weights.iter().map(|w| smooth[w.0 as usize][v].x);
                (each().fold(f32::MAX, f32::min), each().fold(f32::MIN, f32::max))
            };
            let ranges = [range(0), range(1)];
            field.bend(&node, &mut weights, &smooth);
            assert!((weights.iter().map(|w| w.1).sum::<f32>() - 1.0).abs() < 1e-4);
            let fit = weighted(&weights, &smooth);
            for (v, (least, most)) in ranges.into_iter().enumerate() {
                // What small weights held may be missing.
                let slack = 0.1 * (most - least) + 1e-4;
                assert!(
                    fit[v].x >= least - slack && fit[v].x <= most + slack,
                    "node {k}: {} of {least}..{most}",
                    fit[v].x
                );
            }
            let even = ranges[1].0 == ranges[1].1;
            if even && (1.0..9.0).contains(&position.x) && (1.0..9.0).contains(&position.y) {
                fit_error += (fit[0].x - light(position)[0].x).abs();
                mean_error += (mean[0].x - light(position)[0].x).abs();
                count += 1;
            }
        }
        assert!(count > 100, "{count} nodes");
        // Some nodes lie outside of their receivers. The mean of the same receivers is wrong.
        let (fit, mean) = (fit_error / count as f32, mean_error / count as f32);
        assert!(fit < 0.01 && mean > 2.0 * fit, "fit {fit}, mean {mean}, slope 0.1 an edge");
    }

    #[test]
    fn smoothing_takes_noise_and_leaves_slopes() {
        let scene = triangle();
        let field = square(&scene);
        let noise = |k: usize| 0.2 * (unit(hash(k as u32)) - 0.5);
        let samples = || field.set.samples.iter().enumerate();
        let with = |variance: f32| Estimates {
            light: samples().map(|(k, s)| light(s.position).map(|v| v * (1.0 + noise(k)))).collect(),
            variance: samples().map(|(_, s)| light(s.position).map(|v| v * v * variance)).collect(),
        };
        let error = |estimates: &Estimates, rows: &[Vec<Entry>]| {
            let each = samples().zip(rows).map(|((_, s), row)| {
                assert!(row.iter().all(|w| w.1 >= 0.0) && (row.iter().map(|w| w.1).sum::<f32>() - 1.0).abs() < 1e-4);
                let (found, true_light) = (weighted(row, &estimates.light), light(s.position));
                [0, 1].map(|v| (found[v].x / true_light[v].x - 1.0).powi(2))
            });
            let sum = each.fold([0.0; 2], |a: [f32; 2], b| [a[0] + b[0], a[1] + b[1]]);
            sum.map(|s| sqrt(s / field.set.samples.len() as f32))
        };
        let estimates = with(0.2 * 0.2 / 12.0);
        let raw: Vec<Vec<Entry>> = samples().map(|(k, _)| vec![(k as u32, 1.0)]).collect();
        let (before, after) = (error(&estimates, &raw), error(&estimates, &field.smoothing(&estimates)));
        assert!(after[0] < 0.75 * before[0] && after[1] < 0.75 * before[1], "{before:?} to {after:?}");
        // Told that noise is twenty times as great, it blurs the step.
        let wrong = with(20.0 * 20.0 * 0.2 * 0.2 / 12.0);
        let blurred = error(&wrong, &field.smoothing(&wrong));
        assert!(blurred[1] > before[1], "{blurred:?}");
    }
}
