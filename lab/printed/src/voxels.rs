//! Patches of voxels [T 5.1] to [T 5.9].

use std::collections::BTreeMap;
use std::ops::Range;

use glam::{DVec3, Vec3};
use patches::{
    AreaRule, Error, Grid, Member, PatchSet, Sample, SampleSet, SampleSettings, VirtualPatch, sample_voxels,
};
use rayon::prelude::*;
use scene::Scene;
use transport::Dense;

/// Parts of a normal along an axis that are smaller make no patch: they are rounding.
const MIN_PART: f32 = 1e-6;
/// Rays from each face of a voxel. The thesis leaves their number open; the form factors of all pairs of points cost
/// its square.
const POINTS: u32 = 4;
/// Patches of a voxel after merging.
pub const PRINTED_PATCHES: usize = 4;

/// Form factors from some points to all.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointRows {
    /// (5.1), rows × points, row-major.
    pub factors: Vec<f32>,
    /// Share of each row's hemisphere that sees no geometry.
    pub sky: Vec<f32>,
}

/// Finds the rows of a range of samples over all of them.
pub type RowsOfPoints<'a> = dyn Fn(Range<usize>) -> Result<PointRows, Error> + 'a;

/// Patches with the form factors between them.
#[derive(Clone, Debug, PartialEq)]
pub struct PrintedPatches {
    /// Patches with their samples. The albedo of axis patches is no mean of theirs: see [`printed_axis_patches`].
    pub set: PatchSet,
    /// `F`, patches × patches.
    pub factors: Dense,
    /// Share of each patch's hemisphere that sees no geometry: an entry of its row.
    pub sky: Vec<f32>,
    /// Most entries of rows of single points that were in memory at once: those of one voxel.
    pub most_entries: usize,
}

/// Rule that makes patches of the points of a voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// The closest points are merged: [`printed_cluster_patches`].
    Clusters,
    /// Points are shared out over the directions of the axes: [`printed_axis_patches`].
    Axes,
}

/// Settings of [`printed_samples`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrintedSettings {
    /// Form of patches.
    pub form: Form,
    /// About how many patches.
    pub count: usize,
    /// Edge of the voxels, m, instead of the count.
    pub voxel_size: Option<f32>,
    /// Changes every random number.
    pub seed: u32,
}

/// Voxels, and the points in them [T 5.1] to [T 5.4]: the first surface that a ray meets, with the normal of its
/// triangle and the area of the triangle over the number of its points. All surfaces take part, whether light reaches
/// them or not.
///
/// # Errors
/// What [`Grid::for_count`] and [`sample_voxels`] say.
pub fn printed_samples(scene: &Scene, settings: &PrintedSettings) -> Result<(Grid, SampleSet), Error> {
    let PrintedSettings { form, count, voxel_size, seed } = *settings;
    // Of the rules for areas this one adds no points of its own.
    let sampling = SampleSettings { points: POINTS, layers: 1, rule: AreaRule::Projected, seed };
    let sampled = |grid: &Grid| -> Result<SampleSet, Error> {
        let mut set = sample_voxels(scene, grid, &sampling, &|_: &Sample| true)?;
        give_whole_triangles(scene, &mut set.samples);
        Ok(set)
    };
    let patches_of = |set: &SampleSet| -> usize {
        let voxels = set.offsets.windows(2).map(|pair| &set.samples[pair[0] as usize..pair[1] as usize]);
        match form {
            Form::Axes => voxels.map(|samples| axes(samples).len()).sum(),
            Form::Clusters => voxels.map(|samples| samples.len().min(PRINTED_PATCHES)).sum(),
        }
    };
    let grid = match voxel_size {
        Some(edge) => Grid::new(scene, Vec3::splat(edge))?,
        None => Grid::for_count(scene, Vec3::ONE, count, |grid| Ok(patches_of(&sampled(grid)?)))?,
    };
    let set = sampled(&grid)?;
    Ok((grid, set))
}

/// The area of the whole triangle over all of its samples, in whatever voxel and from whichever side they were seen,
/// and the normal of its front [T 5.4]. Triangles that no ray met are lost.
fn give_whole_triangles(scene: &Scene, samples: &mut [Sample]) {
    let mut counts = vec![0u32; scene.geometry.triangles.len()];
    samples.iter().for_each(|s| counts[s.triangle as usize] += 1);
    samples.par_iter_mut().for_each(|s| {
        let t = &scene.geometry.triangles[s.triangle as usize];
        s.area = 0.5 * t.edge_a.cross(t.edge_b).length() / counts[s.triangle as usize] as f32;
        s.normal = scene.tables().normal(s.triangle);
        s.albedo = scene.filtered_albedo(s.triangle, s.position, s.area);
    });
}

/// Merges the points of each voxel, always the two clusters with the least
/// `M(i,j) = (1 + |c_i − c_j|)(2 − n_i·n_j)(1 + √Σ_k((F_ik − F_jk)² + (F_ki − F_kj)²))`, c their colours, until `most`
/// are left [T 5.7]. Merged are rows, colours and normals as means by area, columns and areas as sums (5.2).
///
/// One voxel follows the other: the rows of its points over all columns are found when its turn comes, columns of
/// voxels before it are merged already, and of its rows those of its clusters are kept. Columns follow from rows, `s_k
/// F_ki = s_i F_ik`, which (5.1) has and (5.2) keeps. Work: points² rows, and points · (points of a voxel)² for the
/// metric.
///
/// # Errors
/// [`Error::Length`] for rows of another length, what `rows` says.
pub fn printed_cluster_patches(
    grid: &Grid,
    set: SampleSet,
    most: usize,
    rows: &RowsOfPoints,
) -> Result<PrintedPatches, Error> {
    let samples = &set.samples;
    let mut patch_of = vec![usize::MAX; samples.len()];
    let mut done = Done::default();
    for slot in 0..grid.len() {
        let own = set.range(slot);
        if own.is_empty() {
            continue;
        }
        let found = checked(rows(own.clone())?, own.len(), samples.len())?;
        done.most_entries = done.most_entries.max(found.factors.len());
        let mut merging = Merging::new(samples, own, &found, &patch_of, &done.areas);
        merging.merge_until(most.max(1));
        done.take(merging, grid.occupied[slot], &mut patch_of);
    }
    done.finish(set.samples)
}

/// First exitance of patches, W/m²: `E_j = Σ_i e_i max(0, N_j·n_i)` over the points of the patch's voxel [T 5.8], with
/// what the points send, `sent`, one entry a sample, and the samples of each patch's voxel.
pub fn printed_source(set: &PatchSet, voxel_samples: &[Range<usize>], sent: &[Vec3]) -> Vec<Vec3> {
    set.patches
        .iter()
        .zip(voxel_samples)
        .map(|(patch, range)| range.clone().map(|k| sent[k] * patch.normal.dot(set.samples[k].normal).max(0.0)).sum())
        .collect()
}

/// Checks what a caller found.
fn checked(rows: PointRows, own: usize, all: usize) -> Result<PointRows, Error> {
    for (name, expected, found) in [("rows of points", own * all, rows.factors.len()), ("sky", own, rows.sky.len())] {
        if expected != found {
            return Err(Error::Length { name, expected, found });
        }
    }
    Ok(rows)
}

/// Points that have become one.
#[derive(Clone)]
struct Cluster {
    area: f64,
    colour: DVec3,
    normal: DVec3,
    sky: f64,
    /// Samples, rising.
    members: Vec<u32>,
    /// Its row over the columns of [`Merging`].
    row: Vec<f64>,
}

/// The clusters of one voxel. Columns are the patches of voxels before, the clusters, the points of voxels after.
struct Merging {
    clusters: Vec<Option<Cluster>>,
    /// Column of the first cluster.
    first: usize,
    /// Area of each column.
    areas: Vec<f64>,
    /// Σ_k of the metric for each pair i < j, `[n · n]`.
    distances: Vec<f64>,
}

impl Merging {
    fn new(samples: &[Sample], own: Range<usize>, rows: &PointRows, patch_of: &[usize], before: &[f64]) -> Self {
        let first = before.len();
        let n = own.len();
        let mut areas = before.to_vec();
        areas.extend((own.start..samples.len()).map(|k| f64::from(samples[k].area)));
        let cluster = |i: usize| {
            let s = &samples[own.start + i];
            let mut row = vec![0.0; areas.len()];
            for (k, &factor) in rows.factors[i * samples.len()..(i + 1) * samples.len()].iter().enumerate() {
                let column = if k < own.start { patch_of[k] } else { first + k - own.start };
                row[column] += f64::from(factor);
            }
            Some(Cluster {
                area: f64::from(s.area),
                colour: s.albedo.as_dvec3(),
                normal: s.normal.as_dvec3(),
                sky: f64::from(rows.sky[i]),
                members: vec![(own.start + i) as u32],
                row,
            })
        };
        let clusters = (0..n).into_par_iter().map(cluster).collect();
        let mut merging = Self { clusters, first, areas, distances: vec![0.0; n * n] };
        merging.distances = (0..n * n)
            .into_par_iter()
            .map(|k| if k / n < k % n { merging.distance(k / n, k % n) } else { 0.0 })
            .collect();
        merging
    }

    /// `(F_ik − F_jk)² + (F_ki − F_kj)²` of one column.
    fn term(&self, a: &Cluster, b: &Cluster, k: usize) -> f64 {
        let column = (a.area * a.row[k] - b.area * b.row[k]) / self.areas[k];
        (a.row[k] - b.row[k]).powi(2) + column * column
    }

    fn distance(&self, i: usize, j: usize) -> f64 {
        match (&self.clusters[i], &self.clusters[j]) {
            (Some(a), Some(b)) => (0..self.areas.len()).map(|k| self.term(a, b, k)).sum(),
            _ => 0.0,
        }
    }

    /// The terms of two columns for a pair of clusters.
    fn terms(&self, (i, j): (usize, usize), columns: [usize; 2]) -> f64 {
        match (&self.clusters[i], &self.clusters[j]) {
            (Some(a), Some(b)) => columns.into_iter().map(|k| self.term(a, b, k)).sum(),
            _ => 0.0,
        }
    }

    /// The closest pair; the first of several.
    fn closest(&self) -> Option<(usize, usize)> {
        let n = self.clusters.len();
        let mut best = None;
        let mut least = f64::INFINITY;
        for i in 0..n {
            let Some(a) = &self.clusters[i] else { continue };
            for j in i + 1..n {
                let Some(b) = &self.clusters[j] else { continue };
                let rows = self.distances[i * n + j].max(0.0).sqrt();
                let metric = (1.0 + a.colour.distance(b.colour)) * (2.0 - a.normal.dot(b.normal)) * (1.0 + rows);
                if metric < least {
                    (best, least) = (Some((i, j)), metric);
                }
            }
        }
        best
    }

    fn merge_until(&mut self, most: usize) {
        let n = self.clusters.len();
        for _ in most..n {
            let Some((i, j)) = self.closest() else { return };
            let columns = [self.first + i, self.first + j];
            let is_pair = |a: usize, b: usize| a < b && ![i, j].contains(&a) && ![i, j].contains(&b);
            let pairs: Vec<(usize, usize)> =
                (0..n).flat_map(|a| (0..n).map(move |b| (a, b))).filter(|&(a, b)| is_pair(a, b)).collect();
            // Of pairs that stay, only what these two columns are changes.
            let before: Vec<f64> = pairs.iter().map(|&pair| self.terms(pair, columns)).collect();
            self.merge(i, j);
            for (&(a, b), before) in pairs.iter().zip(before) {
                self.distances[a * n + b] += self.terms((a, b), columns) - before;
            }
            let with_new: Vec<f64> = (0..n).into_par_iter().map(|k| self.distance(i.min(k), i.max(k))).collect();
            for (k, distance) in with_new.into_iter().enumerate() {
                self.distances[i.min(k) * n + i.max(k)] = distance;
            }
        }
    }

    /// (5.2): cluster i takes j in.
    fn merge(&mut self, i: usize, j: usize) {
        let (Some(mut a), Some(b)) = (self.clusters[i].take(), self.clusters[j].take()) else { return };
        let area = a.area + b.area;
        let u = a.area / area;
        let v = b.area / area;
        a.row.iter_mut().zip(&b.row).for_each(|(x, y)| *x = u * *x + v * y);
        a.colour = u * a.colour + v * b.colour;
        // Normals that cancel leave none to make a unit: that of the greater part.
        let greater = if u < v { b.normal } else { a.normal };
        a.normal = (u * a.normal + v * b.normal).try_normalize().unwrap_or(greater);
        a.sky = u * a.sky + v * b.sky;
        a.area = area;
        a.members.extend(b.members);
        a.members.sort_unstable();
        self.clusters[i] = Some(a);
        let to = self.first + i;
        let from = self.first + j;
        for cluster in self.clusters.iter_mut().flatten() {
            cluster.row[to] += std::mem::take(&mut cluster.row[from]);
        }
        self.areas[to] = area;
    }
}

/// The patches of the voxels that are done.
#[derive(Default)]
struct Done {
    patches: Vec<VirtualPatch>,
    /// Their areas.
    areas: Vec<f64>,
    sky: Vec<f32>,
    offsets: Vec<u32>,
    members: Vec<Member>,
    /// Row of each over the patches of its own voxel and those before.
    rows: Vec<Vec<f32>>,
    most_entries: usize,
}

impl Done {
    fn take(&mut self, merging: Merging, voxel: u32, patch_of: &mut [usize]) {
        let first = merging.first;
        let left = || merging.clusters.iter().enumerate().filter_map(|(k, cluster)| Some((k, cluster.as_ref()?)));
        let columns: Vec<usize> = (0..first).chain(left().map(|(k, _)| first + k)).collect();
        for (_, cluster) in left() {
            let patch = self.patches.len();
            self.offsets.push(self.members.len() as u32);
            for &sample in &cluster.members {
                patch_of[sample as usize] = patch;
                self.members.push(Member { sample, weight: 0.0 });
            }
            self.patches.push(VirtualPatch {
                area: cluster.area as f32,
                normal: cluster.normal.as_vec3(),
                voxel,
                albedo: cluster.colour.as_vec3(),
                ..VirtualPatch::default()
            });
            self.areas.push(cluster.area);
            self.sky.push(cluster.sky as f32);
            self.rows.push(columns.iter().map(|&k| cluster.row[k] as f32).collect());
        }
    }

    fn finish(mut self, samples: Vec<Sample>) -> Result<PrintedPatches, Error> {
        self.offsets.push(self.members.len() as u32);
        let n = self.patches.len();
        for ((patch, range), area) in self.patches.iter_mut().zip(self.offsets.windows(2)).zip(&self.areas) {
            let share = |m: &Member| f64::from(samples[m.sample as usize].area) / area;
            let own = &mut self.members[range[0] as usize..range[1] as usize];
            own.iter_mut().for_each(|m| m.weight = share(m) as f32);
            patch.position = mean_position(&samples, own);
        }
        let mut factors = Dense::zeros(n, n);
        for (i, row) in self.rows.iter().enumerate() {
            factors.row_mut(i)[..row.len()].copy_from_slice(row);
        }
        // What lies behind the voxel of a row is the other way round in the rows there.
        for (i, row) in self.rows.iter().enumerate() {
            for k in row.len()..n {
                factors.row_mut(i)[k] = (f64::from(self.rows[k][i]) * self.areas[k] / self.areas[i]) as f32;
            }
        }
        let set = PatchSet::new(samples, self.patches, self.offsets, self.members)?;
        Ok(PrintedPatches { set, factors, sky: self.sky, most_entries: self.most_entries })
    }
}

fn mean_position(samples: &[Sample], members: &[Member]) -> Vec3 {
    let part = |m: &Member| samples[m.sample as usize].position.as_dvec3() * f64::from(m.weight);
    members.iter().map(part).sum::<DVec3>().as_vec3()
}

/// The directions of axes that samples look to, with the samples and `max(0, n·e)` of each: 0 to 5 are +x, −x, +y, −y,
/// +z, −z.
fn axes(samples: &[Sample]) -> BTreeMap<usize, Vec<(usize, f64)>> {
    let mut axes: BTreeMap<usize, Vec<(usize, f64)>> = BTreeMap::new();
    for (k, sample) in samples.iter().enumerate() {
        for (axis, n) in sample.normal.to_array().into_iter().enumerate() {
            if n.abs() > MIN_PART {
                axes.entry(2 * axis + usize::from(n < 0.0)).or_default().push((k, f64::from(n.abs())));
            }
        }
    }
    axes
}

/// A patch for each direction of an axis that points of a voxel look to [T 5.9]. With `w = max(0, n·e)` a point gives a
/// patch with w times its row, its column, its colour and its area; those of one direction are merged by (5.2). So the
/// colour is weighted twice, `c = Σ w² s c / Σ w s`, and rows and columns sum to less than those of the points.
///
/// Rows of points are found voxel by voxel. For the merged columns section 5.9 prints `Σ s_i F_hi` beside (5.2), an
/// area in the place of a share; they are those of (5.2), `Σ F_hi`.
///
/// # Errors
/// As [`printed_cluster_patches`].
pub fn printed_axis_patches(grid: &Grid, set: SampleSet, rows: &RowsOfPoints) -> Result<PrintedPatches, Error> {
    let samples = &set.samples;
    let mut patches = Vec::new();
    let mut offsets = vec![0];
    let mut members = Vec::new();
    let mut areas = Vec::<f64>::new();
    // Patches of each sample with its weight, and of each voxel.
    let mut parts: Vec<Vec<(usize, f64)>> = vec![Vec::new(); samples.len()];
    let mut voxel_patches = vec![0];
    for slot in 0..grid.len() {
        let own = set.range(slot);
        for (axis, some) in axes(&samples[own.clone()]) {
            let area: f64 = some.iter().map(|&(k, w)| w * f64::from(samples[own.start + k].area)).sum();
            let mut colour = DVec3::ZERO;
            let first = members.len();
            for (k, w) in some {
                let sample = &samples[own.start + k];
                let s = w * f64::from(sample.area);
                colour += s * w * sample.albedo.as_dvec3();
                members.push(Member { sample: (own.start + k) as u32, weight: (s / area) as f32 });
                parts[own.start + k].push((patches.len(), w));
            }
            let mut normal = [0.0; 3];
            normal[axis / 2] = if axis % 2 == 1 { -1.0 } else { 1.0 };
            patches.push(VirtualPatch {
                position: mean_position(samples, &members[first..]),
                area: area as f32,
                normal: Vec3::from_array(normal),
                voxel: grid.occupied[slot],
                albedo: (colour / area).as_vec3(),
                reserved: 0,
            });
            offsets.push(members.len() as u32);
            areas.push(area);
        }
        voxel_patches.push(patches.len());
    }
    let axis = AxisParts { parts, areas, voxel_patches };
    let (factors, sky, most_entries) = axis.factors(&set, rows)?;
    let set = PatchSet::new(set.samples, patches, offsets, members)?;
    Ok(PrintedPatches { set, factors, sky, most_entries })
}

/// Axis patches and the samples that they are made of.
struct AxisParts {
    /// Patches of each sample, with its weight there.
    parts: Vec<Vec<(usize, f64)>>,
    /// Areas of the patches, m².
    areas: Vec<f64>,
    /// First patch of each voxel, and their number.
    voxel_patches: Vec<usize>,
}

impl AxisParts {
    /// Form factors between the patches, those of the sky, and the most entries of rows of points that were held at once.
    fn factors(&self, set: &SampleSet, rows: &RowsOfPoints) -> Result<(Dense, Vec<f32>, usize), Error> {
        let Self { parts, areas, voxel_patches } = self;
        let samples = &set.samples;
        let n = areas.len();
        let mut factors = Dense::zeros(n, n);
        let mut sky = vec![0.0; n];
        let mut most_entries = 0;
        for slot in 0..voxel_patches.len() - 1 {
            let own = set.range(slot);
            let first = voxel_patches[slot];
            let mut sums = vec![vec![0.0f64; n + 1]; voxel_patches[slot + 1] - first];
            if own.is_empty() {
                continue;
            }
            let found = checked(rows(own.clone())?, own.len(), samples.len())?;
            most_entries = most_entries.max(found.factors.len());
            for (i, line) in found.factors.chunks(samples.len()).enumerate() {
                let mut row = vec![0.0f64; n + 1];
                for (factor, parts) in line.iter().zip(parts).filter(|(factor, _)| **factor > 0.0) {
                    parts.iter().for_each(|&(patch, w)| row[patch] += w * f64::from(*factor));
                }
                row[n] = f64::from(found.sky[i]);
                let sample = own.start + i;
                for &(patch, w) in &parts[sample] {
                    let share = w * f64::from(samples[sample].area) / areas[patch];
                    sums[patch - first].iter_mut().zip(&row).for_each(|(sum, f)| *sum += share * w * f);
                }
            }
            for (k, sum) in sums.iter().enumerate() {
                factors.row_mut(first + k).iter_mut().zip(sum).for_each(|(f, sum)| *f = *sum as f32);
                sky[first + k] = sum[n] as f32;
            }
        }
        Ok((factors, sky, most_entries))
    }
}
