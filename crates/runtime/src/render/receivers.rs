//! Receivers on the mesh: points where irradiance is gathered, more of them where it bends, and nodes of the mesh that take
//! the mean of the receivers about.

use formfactor::kernel::product::gather_row_sparse;
use formfactor::{Csr, Dense, Operator, Receivers, SparseRows};
use glam::{Vec3, Vec4};
use patches::{LitSampler, Nearest, Sample};
use rayon::prelude::*;
use scene::math::luminance;
use scene::sampling::{frame, hammersley, hash3};
use scene::{DirectParams, LIGHT_DIRECTIONAL, Scene, Sides, SurfacePoint, Visibility, is_open};

use super::senders::Senders;
use crate::error::Error;

/// Lights under which receivers are compared: three to a vector, two vectors.
pub const VECTORS: usize = 2;
/// Bounces of their light.
const BOUNCES: usize = 4;
/// Irradiance counts as at least this share of its mean.
const DARK: f32 = 0.05;
/// Rounds in which receivers are added.
const ROUNDS: usize = 2;
/// Receivers are added where those about differ from their neighbours' mean by more than this share.
const TOLERANCE: f32 = 0.05;
/// Candidates for a receiver to be added.
const CANDIDATES: usize = 2;
/// Receivers that a node takes the mean of; one more gives the distance at which the weight is zero.
const NEIGHBOURS: usize = 6;
const SEARCHED: usize = NEIGHBOURS + 1;
/// Furthest that a receiver may be from a node, in edges between receivers.
const FAR: f32 = 4.0;
/// The same for what is smaller than this many edges.
const SMALL: f32 = 3.0;
const FURTHEST: f32 = 8.0;
/// Receivers nearer than this, in the same measure, need not be seen.
const TOUCHING: f32 = 0.2;
/// Edge of the cells over which the distance between nodes may change, in mean edges between receivers.
const CELL_EDGE: f32 = 6.0;
/// Least distance between nodes, in the same.
const LEAST_NODE_EDGE: f32 = 1.0;
/// Nodes nearer than this may be one, in the same.
const WELD: f32 = 0.25;
/// Height at which nodes look for receivers, in edges between receivers: above what bends in between.
const LIFT: f32 = 0.1;

/// Walks by which a node that sees no receiver looks for light.
const WALKS: u32 = 2;

/// How receivers are placed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placing {
    /// Distance between them where nothing happens, m.
    pub edge: f32,
    /// Most receivers.
    pub most: usize,
    /// Changes every random number.
    pub seed: u32,
}

/// Makes the rows of points.
pub type Rows<'a> = dyn Fn(&[SurfacePoint]) -> Result<SparseRows, Error> + 'a;

/// Receivers and the mesh between them.
pub struct MeshReceivers {
    /// Where irradiance is gathered.
    pub points: Vec<SurfacePoint>,
    /// Their rows over the facets.
    pub rows: Csr,
    /// The nodes, and the triangles' grids over them.
    pub nodes: Receivers,
    /// Weights of the receivers at each node; they sum to 1.
    pub weights: Csr,
}

impl MeshReceivers {
    /// No receivers, for a scene that no light comes to.
    pub fn none(scene: &Scene) -> Result<Self, Error> {
        let nodes = Receivers::new(scene, &vec![Sides::default(); scene.triangles.len()], 1.0, 1.0, |_, _| None)?;
        let empty = || Csr { row_start: vec![0], ..Csr::default() };
        Ok(Self { points: Vec::new(), rows: empty(), nodes, weights: empty() })
    }

    /// Equal-area receivers, then more of them where they are not the mean of their neighbours under `lights`.
    pub fn place(
        scene: &Scene,
        sampler: &LitSampler,
        senders: &Senders,
        placing: &Placing,
        lights: &[[Vec4; VECTORS]],
        make_rows: &Rows,
    ) -> Result<Self, Error> {
        let wanted = sampler.lit_area() / f64::from(placing.edge * placing.edge);
        let mut samples = sampler.samples(wanted.clamp(1.0, placing.most as f64) as u32, placing.seed);
        let mut points = surface_points(&samples, 0);
        let mut rows = make_rows(&points)?.factors;
        for round in 0..ROUNDS {
            let room = placing.most.saturating_sub(points.len()) / (ROUNDS - round);
            let candidates = sampler.samples((CANDIDATES * room) as u32, placing.seed.wrapping_add(1 + round as u32));
            let added = worst_places(&samples, &irradiance(&rows, lights), candidates, room);
            if added.is_empty() {
                break;
            }
            let new = surface_points(&added, points.len() as u32);
            append(&mut rows, make_rows(&new)?.factors);
            points.extend(new);
            // All stand for the same mean area: distances are measured in the mean edge.
            samples.extend(added);
            let area = (sampler.lit_area() / samples.len() as f64) as f32;
            samples.iter_mut().for_each(|sample| sample.area = area);
        }
        let edge = scene::math::sqrt((sampler.lit_area() / samples.len().max(1) as f64) as f32);
        let nearest = Nearest::new(&samples);
        // Nodes stand as close as receivers do.
        let spacing: Vec<f32> = (samples.par_iter())
            .map(|s| {
                let (found, count) = nearest.samples::<5>(s.position, s.normal, FAR);
                edge * found[..count].iter().map(|f| f.1).sum::<f32>() / (count.max(2) - 1) as f32
            })
            .collect();
        // What is small may have no receiver of its own.
        let within = |point: &SurfacePoint, size: f32| {
            let far = if size <= SMALL * edge { FURTHEST } else { FAR };
            let (found, count) = nearest.samples::<3>(point.position, point.normal, far);
            let mean = found[..count].iter().map(|f| spacing[f.0 as usize]).sum::<f32>() / count as f32;
            (count > 0).then(|| mean.max(LEAST_NODE_EDGE * edge))
        };
        let mut nodes = Receivers::new(scene, &senders.sides(), CELL_EDGE * edge, WELD * edge, within)?;
        let weigh = |node: &SurfacePoint, seen: bool| node_weights(scene, &nearest, &samples, edge, node, seen);
        // A node that sees no receiver is inside of a solid or behind a wall: others of its cell serve. Where there are none,
        // the nearest receivers have to, unless no light comes there at all.
        let good = nodes.retain(scene, |node| !weigh(node, true).is_empty());
        let weights: Vec<Vec<(u32, f32)>> = (nodes.points.par_iter().zip(good))
            .map(|(node, good)| {
                let lit = good || is_open(scene, node, WALKS, hash3(node.patch, 0, placing.seed));
                if lit { weigh(node, good) } else { Vec::new() }
            })
            .collect();
        let mut table = Csr { rows: weights.len(), columns: points.len(), row_start: vec![0], ..Csr::default() };
        for mut node in weights {
            node.sort_unstable_by_key(|w| w.0);
            table.column_index.extend(node.iter().map(|w| w.0));
            table.values.extend(node.iter().map(|w| w.1));
            table.row_start.push(table.values.len() as u32);
        }
        Ok(Self { points, rows, nodes, weights: table })
    }
}

fn surface_points(samples: &[Sample], first: u32) -> Vec<SurfacePoint> {
    let point =
        |(s, patch): (&Sample, u32)| SurfacePoint { position: s.position, patch, normal: s.normal, weight: 1.0 };
    samples.iter().zip(first..).map(point).collect()
}

fn append(rows: &mut Csr, more: Csr) {
    let base = rows.values.len() as u32;
    rows.rows += more.rows;
    rows.row_start.extend(more.row_start[1..].iter().map(|k| k + base));
    rows.column_index.extend(more.column_index);
    rows.values.extend(more.values);
}

/// Weights of the nearest receivers by their distances, in rising order: inverse distance, down to zero at the last (Franke
/// and Little's form of Shepard's weights).
fn shepard(distances: &[f32]) -> Vec<f32> {
    let range = distances[distances.len() - 1].max(1e-6) * 1.001;
    let weight = |d: &f32| {
        let d = d.max(1e-3 * range);
        ((range - d) / (range * d)).powi(2)
    };
    distances.iter().map(weight).collect()
}

/// The candidates whose neighbours bend most, at most `room`, in their order.
fn worst_places(samples: &[Sample], light: &[[Vec4; VECTORS]], candidates: Vec<Sample>, room: usize) -> Vec<Sample> {
    if room == 0 || samples.len() <= SEARCHED {
        return Vec::new();
    }
    let nearest = Nearest::new(samples);
    let error = |(k, sample): (usize, &Sample)| {
        let (found, count) = nearest.samples::<SEARCHED>(sample.position, sample.normal, FAR);
        let others: Vec<(u32, f32)> = found[..count].iter().filter(|f| f.0 as usize != k).copied().collect();
        if others.len() < 2 {
            return 0.0;
        }
        let weights = shepard(&others.iter().map(|o| o.1).collect::<Vec<f32>>());
        let total: f32 = weights.iter().sum();
        let mean = [0, 1].map(|v| {
            let sum: Vec4 = others.iter().zip(&weights).map(|(o, w)| light[o.0 as usize][v] * *w).sum();
            sum / total.max(f32::MIN_POSITIVE)
        });
        difference(&light[k], &mean)
    };
    let errors: Vec<f32> = samples.par_iter().enumerate().map(error).collect();
    let about = |sample: &Sample| {
        let (found, count) = nearest.samples::<4>(sample.position, sample.normal, FAR);
        found[..count].iter().map(|f| errors[f.0 as usize]).sum::<f32>() / count.max(1) as f32
    };
    let about: Vec<f32> = candidates.par_iter().map(about).collect();
    let mut order: Vec<usize> = (0..candidates.len()).filter(|&k| about[k] > TOLERANCE).collect();
    order.sort_by(|&a, &b| about[b].total_cmp(&about[a]).then(a.cmp(&b)));
    order.truncate(room);
    order.sort_unstable();
    order.into_iter().map(|k| candidates[k]).collect()
}

/// The receivers that a node takes, with weights that sum to 1; none when it must see them and sees none.
fn node_weights(
    scene: &Scene,
    nearest: &Nearest,
    samples: &[Sample],
    edge: f32,
    node: &SurfacePoint,
    must_be_seen: bool,
) -> Vec<(u32, f32)> {
    let (mut found, mut count) = nearest.samples::<SEARCHED>(node.position, node.normal, FAR);
    if count == 0 {
        (found, count) = nearest.samples::<SEARCHED>(node.position, node.normal, FURTHEST);
    }
    if count == 0 {
        return Vec::new();
    }
    let distances: Vec<f32> = found[..count].iter().map(|f| f.1).collect();
    let weights = shepard(&distances);
    let height = scene.ray_offset + LIFT * edge;
    let seen = |&((k, distance), _): &((u32, f32), f32)| {
        let there = &samples[k as usize];
        let (from, to) = (node.position + node.normal * height, there.position + there.normal * height);
        !must_be_seen || distance < TOUCHING || !scene.any_hit(from, to)
    };
    let mut kept: Vec<((u32, f32), f32)> = found[..count].iter().copied().zip(weights).filter(seen).collect();
    kept.truncate(NEIGHBOURS);
    let total: f32 = kept.iter().map(|k| k.1).sum();
    if total <= 0.0 {
        return Vec::new();
    }
    kept.into_iter().map(|((k, _), weight)| (k, weight / total)).collect()
}

/// Irradiance of every row under the lights.
fn irradiance(rows: &Csr, lights: &[[Vec4; VECTORS]]) -> Vec<[Vec4; VECTORS]> {
    let planes: Vec<Vec<Vec4>> = (0..VECTORS).map(|k| lights.iter().map(|l| l[k]).collect()).collect();
    let gather = |row: usize, plane: &[Vec4]| {
        gather_row_sparse(row as u32, &rows.row_start, &rows.column_index, &rows.values, plane)
    };
    (0..rows.rows).into_par_iter().map(|row| [0, 1].map(|k| gather(row, &planes[k]))).collect()
}

/// Greatest difference under any light, as a share of the greater value. The lights' means are 1.
fn difference(a: &[Vec4; VECTORS], b: &[Vec4; VECTORS]) -> f32 {
    let share = |a: Vec4, b: Vec4| ((a - b).abs() / (a.max(b) + Vec4::splat(DARK))).max_element();
    share(a[0], b[0]).max(share(a[1], b[1]))
}

/// Exitance of the facets under several lights: the scene's own, four suns where there may be suns, and light that is the
/// same everywhere. Each is scaled so that the mean irradiance of the patches is 1.
pub fn test_lights(
    scene: &Scene,
    senders: &Senders,
    factors: &Dense,
    facet_rows: &Csr,
    direct: &DirectParams,
) -> Result<Vec<[Vec4; VECTORS]>, Error> {
    let points = &senders.points;
    let own = scene.direct_irradiance(direct, points);
    let mut sources: Vec<Vec4> = own.iter().map(|e| Vec4::new(luminance(*e), 0.0, 0.0, 0.0)).collect();
    let mut others = vec![Vec4::new(0.0, 0.0, 1.0, 0.0); points.len()];
    if scene.has_sky() || scene.lights.iter().any(|l| l.kind == LIGHT_DIRECTIONAL) {
        let (right, up) = frame(-Vec3::Y);
        let sun = |k: u32| {
            let (x, turn) = hammersley(k, 4, (0, 0x2545_f491));
            let height = 0.4 + 0.5 * x;
            let (s, c) = scene::math::sin_cos_turn(turn);
            (right * c + up * s) * scene::math::sqrt(1.0 - height * height) + Vec3::Y * height
        };
        let suns = [sun(0), sun(1), sun(2), sun(3)];
        let lit = |p: &SurfacePoint, sun: Vec3| {
            let cosine = p.normal.dot(sun);
            let origin = p.position + p.normal * scene.ray_offset;
            if cosine > 0.0 && !scene.occluded(origin, sun, f32::INFINITY) { cosine } else { 0.0 }
        };
        sources.par_iter_mut().zip(points).for_each(|(e, p)| (e.y, e.z) = (lit(p, suns[0]), lit(p, suns[1])));
        others.par_iter_mut().zip(points).for_each(|(e, p)| (e.x, e.y) = (lit(p, suns[2]), lit(p, suns[3])));
    }
    let grey = |albedo: &Vec4| luminance(albedo.truncate());
    let shares = senders.facet_shares();
    let area: f32 = senders.patches.iter().map(|p| p.area).sum();
    let mut result = vec![[Vec4::ZERO; VECTORS]; senders.facets.len()];
    for (vector, light) in [sources, others].iter().enumerate() {
        let of_points = |range: &[u32]| {
            let points = (range[0] as usize..range[1] as usize).map(|k| (k, points[k].weight));
            points.map(|(k, weight)| light[k] * (weight * grey(&senders.point_albedo[k]))).sum()
        };
        let source: Vec<Vec4> = senders.offsets.windows(2).map(of_points).collect();
        let of_facets = |range: &[u32]| (range[0] as usize..range[1] as usize).map(|f| source[f] * shares[f]).sum();
        let patch_source: Vec<Vec4> = senders.patch_facets.windows(2).map(of_facets).collect();
        let mut exitance = patch_source.clone();
        let mut received = vec![Vec4::ZERO; exitance.len()];
        for _ in 0..BOUNCES {
            factors.product(&exitance, &mut received)?;
            for (i, b) in exitance.iter_mut().enumerate() {
                *b = patch_source[i] + received[i] * grey(&senders.albedo[i]);
            }
        }
        let mean: Vec4 = received.iter().zip(&senders.patches).map(|(h, p)| *h * (p.area / area)).sum();
        let scale = Vec4::select(mean.cmpgt(Vec4::ZERO), mean.recip(), Vec4::ZERO);
        let Csr { row_start, column_index, values, .. } = facet_rows;
        result.par_iter_mut().enumerate().for_each(|(f, out)| {
            let h = gather_row_sparse(f as u32, row_start, column_index, values, &exitance);
            out[vector] = (source[f] + h * grey(&senders.facet_albedo[f])) * scale;
        });
    }
    Ok(result)
}
