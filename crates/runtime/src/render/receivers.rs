//! Receivers on the mesh: points where irradiance is gathered, more of them where it bends, and nodes of the mesh that take
//! the mean of the receivers about.

use formfactor::kernel::product::gather_row_sparse;
use formfactor::{Csr, HitRows, Operator, Receivers};
use glam::{Vec3, Vec4};
use patches::{LitSampler, Nearest, Sample};
use rayon::prelude::*;
use scene::math::luminance;
use scene::sampling::{frame, hammersley, hash3};
use scene::{Camera, DirectParams, LIGHT_DIRECTIONAL, Scene, Sides, SurfacePoint, Visibility, is_open};

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
/// Receivers that are compared: one and its neighbours.
const COMPARED: usize = 7;
/// Candidates for a receiver to be added.
const CANDIDATES: usize = 2;
/// Receivers that a node takes the mean of; one more gives the distance at which the weight is zero.
const NEIGHBOURS: usize = 19;
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
pub struct Placing<'a> {
    /// Cameras.
    pub views: &'a [Camera],
    /// Distance between them where nothing happens, m.
    pub edge: f32,
    /// Most receivers.
    pub most: usize,
    /// Rays of a row.
    pub rays: u32,
    /// Changes every random number.
    pub seed: u32,
}

/// Adds the rows of points.
pub type AddRows<'a> = dyn Fn(&mut HitRows, &[SurfacePoint]) -> Result<(), Error> + 'a;

/// Receivers and the mesh between them.
pub struct MeshReceivers {
    /// Where irradiance is gathered.
    pub points: Vec<SurfacePoint>,
    /// Their rows over the facets.
    pub rows: HitRows,
    /// The nodes, and the triangles' grids over them.
    pub nodes: Receivers,
    /// Weights of the receivers at each node; they sum to 1.
    pub weights: Csr,
}

impl MeshReceivers {
    /// No receivers, for a scene that no light comes to.
    pub fn none(scene: &Scene) -> Result<Self, Error> {
        let nodes = Receivers::new(scene, &vec![Sides::default(); scene.triangles.len()], 1.0, 1.0, |_, _| None)?;
        let weights = Csr { row_start: vec![0], ..Csr::default() };
        Ok(Self { points: Vec::new(), rows: HitRows::new(0)?, nodes, weights })
    }

    /// Equal-area receivers, then more of them where they are not the mean of their neighbours under `lights`.
    pub fn place(
        scene: &Scene,
        sampler: &LitSampler,
        senders: &Senders,
        placing: &Placing,
        lights: &[[Vec4; VECTORS]],
        add_rows: &AddRows,
    ) -> Result<Self, Error> {
        let clock = std::time::Instant::now();
        let wanted = sampler.lit_area() / f64::from(placing.edge * placing.edge);
        let mut samples = sampler.samples(wanted.clamp(1.0, placing.most as f64) as u32, placing.seed);
        let mut points = surface_points(&samples, 0);
        let mut rows = HitRows::new(senders.facets.len())?;
        add_rows(&mut rows, &points)?;
        eprintln!("first {:.1?} {}", clock.elapsed(), samples.len());
        for round in 0..ROUNDS {
            let room = placing.most.saturating_sub(points.len()) / (ROUNDS - round);
            let seed = placing.seed.wrapping_add(1 + round as u32);
            let (light, noise) = light_and_noise(&rows, lights, placing.rays)?;
            let added = worst_places(scene, placing.views, sampler, &samples, &light, &noise, room, seed);
            eprintln!("chosen {:.1?}", clock.elapsed());
            if added.is_empty() {
                break;
            }
            let new = surface_points(&added, points.len() as u32);
            add_rows(&mut rows, &new)?;
            points.extend(new);
            // All stand for the same mean area: distances are measured in the mean edge.
            samples.extend(added);
            let area = (sampler.lit_area() / samples.len() as f64) as f32;
            samples.iter_mut().for_each(|sample| sample.area = area);
        }
        eprintln!("rounds {:.1?}", clock.elapsed());
        let edge = scene::math::sqrt((sampler.lit_area() / samples.len().max(1) as f64) as f32);
        let nearest = Nearest::new(&samples);
        if env("PL_DUMP") > 0.0 {
            use std::io::Write;
            use scene::sampling::cosine_hemisphere;
            let (light, noise) = light_and_noise(&rows, lights, placing.rays)?;
            let open: Vec<[f32; 12]> = (0..samples.len()).into_par_iter().map(|k| {
                let s = &samples[k];
                let mut shares = [0.0f32; 12];
                for (set, n) in [(0, 256u32), (6, 16)] {
                    for r in 0..n {
                        let d = cosine_hemisphere(s.normal, hammersley(r, n, (scene::sampling::hash3(k as u32, 1 + set as u32, 7), scene::sampling::hash3(k as u32, 2 + set as u32, 9))));
                        let hit = scene.closest_before(s.position + s.normal * scene.ray_offset, d, 8.0 * edge);
                        let t = if hit.is_miss() { 1e9 } else { hit.t };
                        for (q, m) in [0.25, 0.5, 1.0, 2.0, 4.0, 8.0].into_iter().enumerate() {
                            shares[set + q] += f32::from(u8::from(t >= m * edge * 0.999)) / n as f32;
                        }
                    }
                }
                shares
            }).collect();
            let mut f = std::io::BufWriter::new(std::fs::File::create("/tmp/recv.bin").unwrap());
            eprintln!("edge {edge} area {}", sampler.lit_area());
            for k in 0..samples.len() {
                let s = &samples[k];
                let mut row = vec![s.position.x, s.position.y, s.position.z, s.normal.x, s.normal.y, s.normal.z];
                for v in 0..2 { row.extend([light[k][v].x, light[k][v].y, light[k][v].z]); }
                for v in 0..2 { row.extend([noise[k][v].x, noise[k][v].y, noise[k][v].z]); }
                row.extend(open[k]);
                f.write_all(bytemuck::cast_slice(&row)).unwrap();
            }
        }
        let filter = if env("PL_SMOOTH") > 0.0 {
            smooth(scene, &nearest, &samples, &rows, lights, edge, placing.rays)?
        } else {
            vec![]
        };
        eprintln!(
            "smooth {:.1?} {:.1}",
            clock.elapsed(),
            filter.iter().map(Vec::len).sum::<usize>() as f32 / samples.len() as f32
        );
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
            (count > 0).then(|| mean.max(env("PL_LN") * edge))
        };
        eprintln!("spacing {:.1?}", clock.elapsed());
        let mut nodes = Receivers::new(scene, &senders.sides(), CELL_EDGE * edge, WELD * edge, within)?;
        eprintln!("nodes {:.1?}", clock.elapsed());
        let weigh = |node: &SurfacePoint, seen: bool| node_weights(scene, &nearest, &samples, edge, node, seen);
        // A node that sees no receiver is inside of a solid or behind a wall: others of its cell serve. Where there are none,
        // the nearest receivers have to, unless no light comes there at all.
        let good = nodes.retain(scene, |node| !weigh(node, true).is_empty());
        eprintln!("retain {:.1?}", clock.elapsed());
        let mut weights: Vec<Vec<(u32, f32)>> = (nodes.points.par_iter().zip(&good))
            .map(|(node, good)| if *good && env("PL_ALL") == 0.0 { weigh(node, true) } else { Vec::new() })
            .collect();
        let orphans: Vec<usize> = (0..weights.len()).filter(|&k| weights[k].is_empty()).collect();
        eprintln!("orphans {} of {}", orphans.len(), weights.len());
        let new: Vec<SurfacePoint> = (orphans.iter().zip(points.len() as u32..))
            .map(|(&k, patch)| SurfacePoint { patch, weight: 1.0, ..nodes.points[k] })
            .collect();
        add_rows(&mut rows, &new)?;
        (orphans.iter().zip(&new)).for_each(|(&k, point)| weights[k] = vec![(point.patch, 1.0)]);
        points.extend(new);
        eprintln!("weights {:.1?}", clock.elapsed());
        if !filter.is_empty() {
            for row in &mut weights {
                let mut sums: Vec<(u32, f32)> = Vec::new();
                for &(k, w) in row.iter() {
                    match filter.get(k as usize) {
                        Some(f) => sums.extend(f.iter().map(|&(j, v)| (j, v * w))),
                        None => sums.push((k, w)),
                    }
                }
                sums.sort_by_key(|s| s.0);
                sums.dedup_by(|n, k| {
                    let same = n.0 == k.0;
                    if same {
                        k.1 += n.1
                    }
                    same
                });
                *row = sums;
            }
        }
        let weights = Csr::from_rows(points.len(), &weights)?;
        Ok(Self { points, rows, nodes, weights })
    }
}

/// Whether a camera sees a point of the side of a surface.
fn sees(scene: &Scene, c: &Camera, s: &Sample) -> bool {
    let way = s.position - c.eye;
    let z = way.dot(c.forward);
    if z <= 0.0 || way.dot(s.normal) >= 0.0 { return false; }
    let (x, y) = (way.dot(c.right) / c.right.length_squared(), way.dot(c.up) / c.up.length_squared());
    if x.abs() > z * 1.05 || y.abs() > z * 1.05 { return false; }
    !scene.any_hit(c.eye, s.position + s.normal * scene.ray_offset)
}

fn surface_points(samples: &[Sample], first: u32) -> Vec<SurfacePoint> {
    let point =
        |(s, patch): (&Sample, u32)| SurfacePoint { position: s.position, patch, normal: s.normal, weight: 1.0 };
    samples.iter().zip(first..).map(point).collect()
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

/// Means over neighbours that do not differ by more than their noise.
fn smooth(
    scene: &Scene,
    nearest: &Nearest,
    samples: &[Sample],
    rows: &HitRows,
    lights: &[[Vec4; VECTORS]],
    edge: f32,
    rays: u32,
) -> Result<Vec<Vec<(u32, f32)>>, Error> {
    const K: usize = 25;
    let (light, noise) = light_and_noise(rows, lights, rays)?;
    let (level, base) = (env("PL_SMOOTH"), env("PL_BASE"));
    Ok((0..samples.len())
        .into_par_iter()
        .map(|i| {
            let own = &samples[i];
            let (found, count) = nearest.samples::<K>(own.position, own.normal, FAR);
            let mut kept: Vec<(u32, f32)> = vec![(i as u32, 1.0)];
            for &(j, _) in &found[..count] {
                let j = j as usize;
                if j == i {
                    continue;
                }
                let mut worst = 0.0f32;
                for v in 0..VECTORS {
                    let d = light[i][v] - light[j][v];
                    let var = noise[i][v] + noise[j][v];
                    let m = (light[i][v] + light[j][v]) * (0.5 * base) + Vec4::splat(base * DARK);
                    let z = d * d / (var * level * level + m * m + Vec4::splat(1e-12));
                    worst = worst.max(z.max_element());
                }
                if worst > 1.0 {
                    continue;
                }
                let there = &samples[j];
                let (way, bend) = (there.position.distance(own.position), there.normal.distance(own.normal));
                let height = scene.ray_offset + LIFT * edge + 0.25 * way * bend;
                if scene.any_hit(own.position + own.normal * height, there.position + there.normal * height) {
                    continue;
                }
                kept.push((j as u32, 1.0 - worst));
            }
            let total: f32 = kept.iter().map(|k| k.1).sum();
            kept.iter_mut().for_each(|k| k.1 /= total);
            kept
        })
        .collect())
}

/// Samples about the receivers that are least the mean of their neighbours, at most `room`.
fn worst_places(
    scene: &Scene,
    views: &[Camera],
    sampler: &LitSampler,
    samples: &[Sample],
    light: &[[Vec4; VECTORS]],
    noise: &[[Vec4; VECTORS]],
    room: usize,
    seed: u32,
) -> Vec<Sample> {
    if room == 0 || samples.len() <= COMPARED {
        return Vec::new();
    }
    let nearest = Nearest::new(samples);
    let error = |(k, sample): (usize, &Sample)| {
        let (found, count) = nearest.samples::<COMPARED>(sample.position, sample.normal, FAR);
        let others: Vec<(u32, f32)> = found[..count].iter().filter(|f| f.0 as usize != k).copied().collect();
        if others.len() < 2 {
            return 0.0;
        }
        let weights = shepard(&others.iter().map(|o| o.1).collect::<Vec<f32>>());
        let total: f32 = weights.iter().sum();
        let total = total.max(f32::MIN_POSITIVE);
        let share = |v: usize| {
            let each = || others.iter().zip(&weights).map(|(o, w)| (o.0 as usize, w / total));
            let mean: Vec4 = each().map(|(j, w)| light[j][v] * w).sum();
            let variance: Vec4 = each().map(|(j, w)| noise[j][v] * (w * w)).sum::<Vec4>() + noise[k][v];
            let difference = light[k][v] - mean;
            let real = (difference * difference - variance * env("PL_NOISE")).max(Vec4::ZERO);
            let scale = light[k][v].max(mean) + Vec4::splat(DARK);
            (real / (scale * scale)).max_element()
        };
        scene::math::sqrt(share(0).max(share(1)))
    };
    let errors: Vec<f32> = samples.par_iter().enumerate().map(error).collect();
    let about = |sample: &Sample| {
        let (found, count) = nearest.samples::<4>(sample.position, sample.normal, FAR);
        found[..count].iter().map(|f| errors[f.0 as usize]).sum::<f32>() / count.max(1) as f32
    };
    let found = sampler.samples_where((CANDIDATES * room) as u32, seed, |sample| about(sample) > TOLERANCE);
    let floor = env("PL_HIDDEN");
    let seen = |s: &Sample| {
        if floor >= 1.0 { return 1.0 }
        let any = views.iter().any(|c| sees(scene, c, s));
        if any { 1.0 } else { floor }
    };
    let mut order: Vec<(f32, usize)> = found.par_iter().enumerate().map(|(k, sample)| (about(sample) * seen(sample), k)).collect();
    eprintln!("found {} visible {}", found.len(), found.par_iter().filter(|s| views.iter().any(|c| sees(scene, c, s))).count());
    order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    order.truncate(room);
    let mut chosen: Vec<usize> = order.into_iter().map(|(_, k)| k).collect();
    chosen.sort_unstable();
    chosen.into_iter().map(|k| found[k]).collect()
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
    static EXTRA: std::sync::LazyLock<(f32, usize)> =
        std::sync::LazyLock::new(|| (env("PL_EXTRA"), env("PL_K") as usize));
    for f in &mut found[..count] {
        f.1 = scene::math::sqrt(f.1 * f.1 + EXTRA.0 * samples[f.0 as usize].normal.distance_squared(node.normal));
    }
    found[..count].sort_by(|a, b| a.1.total_cmp(&b.1));
    let count = count.min(EXTRA.1 + 1);
    let seen = |&(k, distance): &(u32, f32)| {
        let there = &samples[k as usize];
        let (way, bend) = (there.position.distance(node.position), there.normal.distance(node.normal));
        let height = scene.ray_offset + LIFT * edge + env("PL_BEND") * way * bend;
        let (from, to) = (node.position + node.normal * height, there.position + there.normal * height);
        !must_be_seen || distance < TOUCHING || !scene.any_hit(from, to)
    };
    let range = found[count - 1].1.max(1e-6) * 1.001;
    let mut kept: Vec<(u32, f32)> = found[..count].iter().copied().filter(seen).collect();
    kept.truncate(EXTRA.1);
    if env("PL_OLD") > 0.0 {
        let weights = shepard(&found[..count].iter().map(|f| f.1).collect::<Vec<f32>>());
        let mut kept: Vec<((u32, f32), f32)> =
            found[..count].iter().copied().zip(weights).filter(|f| seen(&f.0)).collect();
        kept.truncate(EXTRA.1);
        let total: f32 = kept.iter().map(|k| k.1).sum();
        if total <= 0.0 {
            return Vec::new();
        }
        return kept.into_iter().map(|((k, _), weight)| (k, weight / total)).collect();
    }
    linear_weights(samples, edge, node, &kept, range)
}

fn env(name: &str) -> f32 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(0.0)
}

/// Weights by which the receivers give the value at a node of the plane fitted to theirs, over position and normal.
fn linear_weights(
    samples: &[Sample],
    edge: f32,
    node: &SurfacePoint,
    kept: &[(u32, f32)],
    range: f32,
) -> Vec<(u32, f32)> {
    use nalgebra::{SMatrix, SVector};
    static RIDGE: std::sync::LazyLock<[f32; 4]> =
        std::sync::LazyLock::new(|| [env("PL_RIDGE"), env("PL_NORMAL"), env("PL_LEAST"), env("PL_POW")]);
    let [ridge, turn, least, power] = *RIDGE;
    let (right, up) = frame(node.normal);
    let basis = |k: u32| {
        let s = &samples[k as usize];
        let way = (s.position - node.position) / (edge * range);
        let bend = (s.normal - node.normal) * (turn / range);
        SVector::<f32, 5>::new(1.0, way.dot(right), way.dot(up), bend.dot(right), bend.dot(up))
    };
    let weight = |d: f32| {
        if power > 0.0 {
            let d = d.max(0.05 * range);
            ((range - d) / (range * d)).powi(power as i32)
        } else {
            (1.0 - (d / range).powi(2)).powi(2)
        }
    };
    let terms: Vec<(f32, SVector<f32, 5>)> = kept.iter().map(|k| (weight(k.1), basis(k.0))).collect();
    let total: f32 = terms.iter().map(|t| t.0).sum();
    if total <= 0.0 {
        return Vec::new();
    }
    let shepard = || kept.iter().zip(&terms).map(|(k, t)| (k.0, t.0 / total)).collect();
    let mut sums = SMatrix::<f32, 5, 5>::zeros();
    for (w, b) in &terms {
        sums += b * b.transpose() * (*w / total);
    }
    for k in 1..5 {
        sums[(k, k)] += ridge;
    }
    let Some(cholesky) = sums.cholesky() else { return shepard() };
    let first = cholesky.solve(&SVector::<f32, 5>::new(1.0, 0.0, 0.0, 0.0, 0.0));
    let mut weights: Vec<f32> = terms.iter().map(|(w, b)| w / total * b.dot(&first)).collect();
    let sum: f32 = weights.iter().sum();
    let worst = weights.iter().fold(0.0f32, |a, w| a.min(*w / sum));
    if sum < 0.1 || !worst.is_finite() {
        return shepard();
    }
    // Blend toward the mean until none is very negative.
    let share = if worst < -least { least / -worst } else { 1.0 };
    weights.iter_mut().zip(&terms).for_each(|(w, t)| *w = share * *w / sum + (1.0 - share) * t.0 / total);
    kept.iter().zip(weights).map(|(k, w)| (k.0, w)).collect()
}

/// Irradiance of every row under the lights.
fn irradiance(rows: &HitRows, lights: &[[Vec4; VECTORS]]) -> Result<Vec<[Vec4; VECTORS]>, Error> {
    let mut found = vec![[Vec4::ZERO; VECTORS]; rows.rows()];
    for k in 0..VECTORS {
        let exitance: Vec<Vec4> = lights.iter().map(|light| light[k]).collect();
        let mut received = vec![Vec4::ZERO; rows.rows()];
        rows.product(&exitance, &mut received)?;
        found.iter_mut().zip(received).for_each(|(all, one)| all[k] = one);
    }
    Ok(found)
}

/// Irradiance of every row under the lights, and the variance of its estimate.
fn light_and_noise(
    rows: &HitRows,
    lights: &[[Vec4; VECTORS]],
    rays: u32,
) -> Result<(Vec<[Vec4; VECTORS]>, Vec<[Vec4; VECTORS]>), Error> {
    let light = irradiance(rows, lights)?;
    let squares: Vec<[Vec4; VECTORS]> = lights.iter().map(|l| l.map(|v| v * v)).collect();
    let squares = irradiance(rows, &squares)?;
    let noise = light
        .iter()
        .zip(&squares)
        .map(|(m, s)| [0, 1].map(|v| (s[v] - m[v] * m[v]).max(Vec4::ZERO) / rays as f32))
        .collect();
    Ok((light, noise))
}

/// Exitance of the facets under several lights: the scene's own, four suns where there may be suns, and light that is the
/// same everywhere. Each is scaled so that the mean irradiance of the patches is 1.
pub fn test_lights(
    scene: &Scene,
    senders: &Senders,
    factors: &Csr,
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
