//! Samples: what rays from the faces of the voxels meet inside them.

use alloc::vec::Vec;

use glam::Vec3;
use scene::parallel::*;
use scene::sampling::{hammersley, hash3};
use scene::{Hit, NONE, Scene};
use transport::check_length;

use super::grid::Grid;
use crate::error::Error;
use crate::types::Sample;

/// Voxels that are sampled before it is asked which of their samples stay.
const BATCH: usize = 256;

/// Points at which the holes of a masked triangle in a voxel are looked for.
const MASK_POINTS: u32 = 128;

/// Rule for the areas of samples. S_j is the area of triangle j inside the voxel without its holes (by 128 points where
/// it has a mask), |samples_j| the number of samples there on the same side of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AreaRule {
    /// `s = S_j / |samples_j|`. A triangle that no ray met gives its area to the nearest sample of the voxel with a
    /// like normal (`n_i·n_j > 0`), on as many sides as the nearest triangle that was met has; where there is none it
    /// gets a sample of its own on each side. So Σ s is the area of the surface, both sides of a sheet counted when
    /// both are seen.
    #[default]
    Clipped,
    /// `s = h_u h_v / k · |n·d|` for k rays in direction d from a face of h_u by h_v: as `n_x² + n_y² + n_z² = 1`, Σ s
    /// tends to the area of what the rays meet. Triangles that no ray met have none.
    Projected,
}

/// Settings of [`sample_voxels`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleSettings {
    /// Rays from each face of a voxel, at Hammersley's points.
    pub points: u32,
    /// Surfaces that a ray meets at most. The thesis stops at the first (1), and then the inner sides of two sheets in
    /// one voxel have no samples.
    pub layers: u32,
    /// The samples' areas.
    pub rule: AreaRule,
    /// Changes every random number.
    pub seed: u32,
}

impl Default for SampleSettings {
    fn default() -> Self {
        Self { points: 64, layers: 8, rule: AreaRule::Clipped, seed: 0 }
    }
}

/// Surface statistics; areas in m².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SampleReport {
    /// Rays cast.
    pub rays: u64,
    /// Samples that `keep` refused.
    pub refused: u64,
    /// Samples made for triangles with no like sample in their voxel.
    pub forced: u64,
    /// Area of the sides that were met and kept: what Σ s should be.
    pub surface_area: f64,
    /// Part of it that had no samples of its own and was given to neighbours.
    pub donated_area: f64,
    /// Σ s.
    pub sample_area: f64,
}

/// Samples of all voxels: occupied voxel `v` has `samples[offsets[v]..offsets[v + 1]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleSet {
    /// Samples, voxel by voxel.
    pub samples: Vec<Sample>,
    /// First sample of each occupied voxel, `[voxels + 1]`.
    pub offsets: Vec<u32>,
    /// Surface statistics.
    pub report: SampleReport,
}

/// Casts rays inwards from the six faces of each occupied voxel and makes samples of what they meet inside it [T 5.3]:
/// the point, the side that was seen, its area by the rule, and the reflectance from the level of the texture whose
/// texels are about as large. `keep` refuses sides that take no part, as the insides of solids; it sees samples without
/// area and albedo. Opposite faces share their lines, so that both sides of a sheet are met alike.
///
/// Voxels are independent, on all cores; the result is the same for any number of them. Rays: 6 · points · voxels,
/// times the surfaces met; a triangle that no ray met costs one pass over the voxel's samples.
///
/// # Errors
/// [`Error::Setting`] for 0 points or layers, [`Error::TooMany`] samples, [`Error::NoSamples`].
pub fn sample_voxels(
    scene: &Scene,
    grid: &Grid,
    settings: &SampleSettings,
    keep: &(impl Fn(&Sample) -> bool + Sync),
) -> Result<SampleSet, Error> {
    sample_voxels_by(scene, grid, settings, &|samples| Ok(samples.par_iter().map(keep).collect()))
}

/// Says of each of some samples, which have neither area nor albedo yet, whether it stays.
pub type Keep<'a> = dyn Fn(&[Sample]) -> Result<Vec<bool>, Error> + 'a;

/// [`sample_voxels`] where `keep` is asked about many samples together.
///
/// # Errors
/// As [`sample_voxels`]; what `keep` says; [`Error::Shared`] where it gives another number of answers.
pub fn sample_voxels_by(
    scene: &Scene,
    grid: &Grid,
    settings: &SampleSettings,
    keep: &Keep,
) -> Result<SampleSet, Error> {
    for (name, value) in [("points", settings.points), ("layers", settings.layers)] {
        if value == 0 {
            return Err(Error::Setting { name, value: 0.0, rule: "at least 1" });
        }
    }
    let mut set =
        SampleSet { samples: Vec::new(), offsets: Vec::with_capacity(grid.len() + 1), report: SampleReport::default() };
    set.offsets.push(0);
    // In batches, so that little more than the result is in memory.
    for first in (0..grid.len()).step_by(BATCH) {
        let slots = first..(first + BATCH).min(grid.len());
        let mut voxels: Vec<Voxel> =
            slots.into_par_iter().map(|slot| Voxel::cast(scene, grid, slot, settings)).collect();
        let met: Vec<Sample> = voxels.iter().flat_map(|voxel| &voxel.met).map(|met| met.sample).collect();
        let mut kept = asked(keep, &met)?.into_iter();
        let flags = voxels.iter_mut().flat_map(|voxel| &mut voxel.met).map(|met| &mut met.kept);
        flags.zip(&mut kept).for_each(|(flag, kept)| *flag = kept);
        voxels.par_iter_mut().for_each(|voxel| voxel.share_out(settings.rule));
        let forced: Vec<Sample> = voxels.iter().flat_map(|voxel| &voxel.forced).copied().collect();
        let mut kept = asked(keep, &forced)?.into_iter();
        for voxel in voxels {
            let voxel = voxel.samples(&mut kept);
            set.samples.extend(voxel.samples);
            let found = set.samples.len() as u64;
            if found >= u64::from(NONE) {
                return Err(Error::TooMany { name: "samples", found, limit: u64::from(NONE) - 1 });
            }
            set.offsets.push(found as u32);
            let sum = &mut set.report;
            let r = voxel.report;
            sum.rays += r.rays;
            sum.refused += r.refused;
            sum.forced += r.forced;
            sum.surface_area += r.surface_area;
            sum.donated_area += r.donated_area;
        }
    }
    if set.samples.is_empty() {
        return Err(Error::NoSamples);
    }
    set.samples
        .par_iter_mut()
        .for_each(|sample| sample.albedo = scene.filtered_albedo(sample.triangle, sample.position, sample.area));
    set.report.sample_area = set.samples.iter().map(|s| f64::from(s.area)).sum();
    Ok(set)
}

/// Which of some samples stay.
fn asked(keep: &Keep, samples: &[Sample]) -> Result<Vec<bool>, Error> {
    let kept = if samples.is_empty() { Vec::new() } else { keep(samples)? };
    check_length("kept samples", samples.len(), kept.len())?;
    Ok(kept)
}

impl SampleSet {
    /// Samples of the occupied voxel in place `slot`: positions in [`SampleSet::samples`].
    pub fn range(&self, slot: usize) -> core::ops::Range<usize> {
        self.offsets[slot] as usize..self.offsets[slot + 1] as usize
    }
}

/// Samples of one voxel.
struct VoxelSamples {
    samples: Vec<Sample>,
    report: SampleReport,
}

/// A point that a ray met.
#[derive(Clone, Copy)]
struct Met {
    /// Place of the triangle among the voxel's.
    clipped: u32,
    /// True if it was seen from behind.
    back: bool,
    kept: bool,
    /// Its area by the projected rule.
    projected: f32,
    sample: Sample,
}

/// A voxel while it is sampled.
struct Voxel<'a> {
    scene: &'a Scene,
    grid: &'a Grid,
    number: u32,
    /// Its triangles, rising.
    triangles: &'a [u32],
    /// Area of each inside the voxel, holes left out, m².
    areas: Vec<f32>,
    /// Hits of its rays, triangle by triangle.
    met: Vec<Met>,
    /// Samples of triangles that no ray met, which stay if they are kept.
    forced: Vec<Sample>,
    report: SampleReport,
}

impl<'a> Voxel<'a> {
    /// Casts the rays.
    fn cast(scene: &'a Scene, grid: &'a Grid, slot: usize, settings: &SampleSettings) -> Self {
        let (triangles, areas) = grid.clipped_triangles(slot);
        let mut voxel = Self {
            scene,
            grid,
            number: grid.occupied[slot],
            triangles,
            areas: areas.to_vec(),
            met: Vec::new(),
            forced: Vec::new(),
            report: SampleReport { rays: 6 * u64::from(settings.points), ..SampleReport::default() },
        };
        voxel.leave_holes_out();
        voxel.met = voxel.cast_rays(settings);
        voxel.met.sort_by_key(|m| (m.clipped, m.back));
        voxel
    }

    /// Gives areas to the samples that are kept.
    fn share_out(&mut self, rule: AreaRule) {
        // Samples of each side of each triangle, and whether it was met at all.
        let mut counts = alloc::vec![[0u32; 2]; self.triangles.len()];
        let mut seen = alloc::vec![false; self.triangles.len()];
        for m in &self.met {
            seen[m.clipped as usize] = true;
            counts[m.clipped as usize][usize::from(m.back)] += u32::from(m.kept);
        }
        for (count, &area) in counts.iter().zip(&self.areas) {
            self.report.surface_area += f64::from(area) * count.iter().filter(|&&c| c > 0).count() as f64;
        }
        self.report.refused = self.met.iter().filter(|m| !m.kept).count() as u64;
        for m in self.met.iter_mut().filter(|m| m.kept) {
            let count = counts[m.clipped as usize][usize::from(m.back)];
            m.sample.area = match rule {
                AreaRule::Clipped => self.areas[m.clipped as usize] / count as f32,
                AreaRule::Projected => m.projected,
            };
        }
        if rule == AreaRule::Clipped {
            for (clipped, seen) in seen.into_iter().enumerate() {
                if !seen && self.areas[clipped] > 0.0 {
                    self.donate(clipped, &counts);
                }
            }
        }
    }

    /// The samples that stay: `kept` says of the forced ones of this voxel and those after it which do.
    fn samples(mut self, kept: &mut impl Iterator<Item = bool>) -> VoxelSamples {
        let mut samples: Vec<Sample> = self.met.iter().filter(|m| m.kept).map(|m| m.sample).collect();
        for forced in self.forced {
            if kept.next() == Some(true) {
                self.report.forced += 1;
                self.report.surface_area += f64::from(forced.area);
                samples.push(forced);
            }
        }
        VoxelSamples { samples, report: self.report }
    }

    /// Scales the areas of masked triangles by the share of points that are no holes.
    fn leave_holes_out(&mut self) {
        for clipped in 0..self.triangles.len() {
            if self.is_masked(clipped) {
                self.areas[clipped] *= self.opaque_points(clipped).count() as f32 / MASK_POINTS as f32;
            }
        }
    }

    fn is_masked(&self, clipped: usize) -> bool {
        let t = &self.scene.geometry.triangles[self.triangles[clipped] as usize];
        self.scene.materials[t.material as usize].mask_texture != NONE
    }

    /// Those of 128 points of a triangle's part in the voxel that are no holes.
    fn opaque_points(&self, clipped: usize) -> impl Iterator<Item = Vec3> {
        let triangle = self.triangles[clipped];
        let part = self.grid.clipped_triangle(self.scene, self.number, triangle);
        let geometry = self.scene.tables();
        // Shifted, as a picture may repeat in step with the points.
        let shift = (hash3(self.number, triangle, 1), hash3(self.number, triangle, 2));
        (0..MASK_POINTS).map(move |k| part.point(hammersley(k, MASK_POINTS, shift)).as_vec3()).filter(move |&p| {
            let (u, v) = self.scene.shares(triangle, p);
            !geometry.is_hole(triangle, u, v)
        })
    }

    /// Traces the rays of the six faces, in a fixed order.
    fn cast_rays(&mut self, settings: &SampleSettings) -> Vec<Met> {
        let (low, high) = self.grid.voxel_box(self.number);
        let edges = self.grid.shape.edges;
        // Rays go on a little behind what they met, and start a little outside: a surface in the face itself is met
        // too.
        let reach = low.abs().max(high.abs()).max_element();
        let mut met = Vec::new();
        for face in 0..6u32 {
            let axis = (face / 2) as usize;
            let downwards = face % 2 == 1;
            let u = (axis + 1) % 3;
            let v = (axis + 2) % 3;
            let step = (1e-5 * edges[axis]).max(1e-6 * reach);
            let mut direction = Vec3::ZERO;
            direction[axis] = if downwards { -1.0 } else { 1.0 };
            let word = |dimension: u32| hash3(self.number, dimension, settings.seed);
            let shift = (word(axis as u32), word(axis as u32 + 3));
            let cell = edges[u] * edges[v] / settings.points as f32;
            for k in 0..settings.points {
                let (x, y) = hammersley(k, settings.points, shift);
                let mut origin = low;
                origin[u] += x * edges[u];
                origin[v] += y * edges[v];
                origin[axis] = if downwards { high[axis] + step } else { low[axis] - step };
                let mut rest = edges[axis] + 2.0 * step;
                let mut last = NONE;
                let mut layer = 0;
                while layer < settings.layers && rest > 0.0 {
                    let hit = self.scene.closest_before(origin, direction, rest);
                    if hit.is_miss() {
                        break;
                    }
                    origin[axis] += direction[axis] * (hit.t + step);
                    rest -= hit.t + step;
                    if hit.triangle != last {
                        met.extend(self.meet(&hit, direction, cell));
                        layer += 1;
                    }
                    last = hit.triangle;
                }
            }
        }
        met
    }

    /// The sample of a hit; none for a triangle just outside the face, which belongs to the neighbour.
    fn meet(&mut self, hit: &Hit, direction: Vec3, cell: f32) -> Option<Met> {
        let clipped = self.triangles.binary_search(&hit.triangle).ok()?;
        let geometry = self.scene.tables();
        let front = geometry.normal(hit.triangle);
        let cosine = front.dot(direction);
        if cosine == 0.0 || !front.is_finite() {
            return None;
        }
        // A mask that hardly lets anything be seen was seen nevertheless.
        if self.areas[clipped] == 0.0 {
            self.areas[clipped] =
                self.grid.clipped_triangle(self.scene, self.number, hit.triangle).area() as f32 / MASK_POINTS as f32;
        }
        let back = cosine > 0.0;
        let sample = Sample {
            position: geometry.position(hit.triangle, hit.u, hit.v),
            normal: if back { -front } else { front },
            triangle: hit.triangle,
            ..Sample::default()
        };
        Some(Met { clipped: clipped as u32, back, kept: true, projected: cell * cosine.abs(), sample })
    }

    /// Gives the area of a triangle that no ray met to samples of the voxel, or makes samples of it.
    fn donate(&mut self, clipped: usize, counts: &[[u32; 2]]) {
        let triangle = self.triangles[clipped];
        let area = self.areas[clipped];
        let centre = self.grid.clipped_triangle(self.scene, self.number, triangle).centroid().as_vec3();
        let normal = self.scene.tables().normal(triangle);
        let Some(neighbour) = nearest(&self.met, centre, |m| m.sample.normal.dot(normal) != 0.0) else {
            // The centre may be a hole.
            let position = if self.is_masked(clipped) { self.opaque_points(clipped).next() } else { None };
            let position = position.unwrap_or(centre);
            for normal in [normal, -normal] {
                let sample = Sample { position, area, normal, triangle, ..Sample::default() };
                if normal.is_finite() {
                    self.forced.push(sample);
                }
            }
            return;
        };
        let neighbour = self.met[neighbour];
        for back in [false, true] {
            if counts[neighbour.clipped as usize][usize::from(back)] == 0 {
                continue;
            }
            let side = if back == neighbour.back { neighbour.sample.normal } else { -neighbour.sample.normal };
            let own = if normal.dot(side) > 0.0 { normal } else { -normal };
            if let Some(target) = nearest(&self.met, centre, |m| m.kept && m.sample.normal.dot(own) > 0.0) {
                self.met[target].sample.area += area;
                self.report.surface_area += f64::from(area);
                self.report.donated_area += f64::from(area);
            }
        }
    }
}

/// The nearest point that passes; the first of several.
fn nearest(met: &[Met], point: Vec3, passes: impl Fn(&Met) -> bool) -> Option<usize> {
    let mut best = None;
    let mut least = f32::INFINITY;
    for (index, m) in met.iter().enumerate() {
        let distance = m.sample.position.distance_squared(point);
        if distance < least && passes(m) {
            (best, least) = (Some(index), distance);
        }
    }
    best
}
