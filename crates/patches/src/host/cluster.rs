//! Clusters of the samples of each voxel, by greedy merging.

use alloc::vec::Vec;

use scene::parallel::*;

use super::grid::Grid;
use super::group::{Group, check_voxels, merge_slivers, patches_of};
use super::patch_set::PatchSet;
use super::sample::SampleSet;
use crate::error::Error;
use crate::types::{Member, Sample};

/// Settings of [`cluster_patches`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClusterSettings {
    /// Patches of a voxel at most, unless the rest may not be merged.
    pub max_patches: u32,
}

impl Default for ClusterSettings {
    fn default() -> Self {
        Self { max_patches: 4 }
    }
}

/// Merges the samples of each voxel, always the closest pair of clusters, until `max_patches` are left, as [T 5.7]
/// does. The metric is `M(i,j) = (1 + |x_i − x_j|/d)(2 − n_i·n_j)(1 + row(i,j))` with the clusters' mean positions x,
/// the voxel's diagonal d, so that a scene in other units has the same clusters, and mean unit normals n (printed:
/// colours in the place of positions). Clusters that hold samples with `n_i·n_j < 0` are never merged, so more may be
/// left. Slivers (under 1 % of the voxel's mean patch) then go to the nearest cluster with a like normal that they may
/// be merged with.
///
/// `row_distance` gives the row term of two clusters, ≥ 0, by what else keeps them apart. Members name samples of
/// `set`; their weight is 1. Give `&|_, _| 0.0` where nothing does.
///
/// Voxels are independent, on all cores, so memory is that of one voxel a core. n samples of a voxel cost about n²
/// evaluations of the metric (n³ at worst: whenever a cluster's nearest is merged away, it looks for another); the row
/// term is asked for only where position and normal alone come out nearer than the best so far.
///
/// # Errors
/// [`Error::Setting`] for 0 patches, [`Error::Length`] for samples of another grid, [`Error::Value`] for a row term
/// that is negative or not a number, and what [`PatchSet::from_groups`] refuses.
pub fn cluster_patches(
    grid: &Grid,
    set: SampleSet,
    settings: &ClusterSettings,
    row_distance: &(impl Fn(&[Member], &[Member]) -> f32 + Sync),
) -> Result<PatchSet, Error> {
    check_voxels(grid, &set)?;
    if settings.max_patches == 0 {
        return Err(Error::Setting { name: "max_patches", value: 0.0, rule: "at least 1" });
    }
    let unit = f64::from(grid.shape.edges.length());
    let voxels: Result<Vec<_>, Error> = (0..grid.len())
        .into_par_iter()
        .map(|slot| {
            let leaves = set.range(slot).map(|index| {
                let mut leaf = Group::default();
                leaf.push(index as u32, &set.samples[index], 1.0);
                leaf
            });
            let mut merging = Merging::new(&set.samples, leaves.collect(), unit, row_distance)?;
            merging.merge_until(settings.max_patches as usize)?;
            let mut groups: Vec<Group> = merging.clusters.into_iter().map(|c| c.group).collect();
            merge_slivers(&mut groups, |a, b| agree(&set.samples, a, b));
            groups.sort_by_key(|g| g.members[0].sample);
            Ok(groups)
        })
        .collect();
    let voxels = voxels?;
    patches_of(grid, set, voxels)
}

/// Returns true if no sample of one group looks away from a sample of the other.
fn agree(samples: &[Sample], a: &Group, b: &Group) -> bool {
    let normal = |m: &Member| samples[m.sample as usize].normal;
    a.members.iter().all(|m| b.members.iter().all(|o| normal(m).dot(normal(o)) >= 0.0))
}

struct Cluster {
    group: Group,
    centre: glam::DVec3,
    normal: glam::DVec3,
    /// Its nearest cluster, and how near that is: infinite when there is none that it may be merged with.
    nearest: usize,
    distance: f64,
}

/// The clusters of one voxel that are left.
struct Merging<'a, R> {
    samples: &'a [Sample],
    clusters: Vec<Cluster>,
    unit: f64,
    row_distance: &'a R,
}

impl<'a, R: Fn(&[Member], &[Member]) -> f32> Merging<'a, R> {
    fn new(samples: &'a [Sample], leaves: Vec<Group>, unit: f64, row_distance: &'a R) -> Result<Self, Error> {
        let clusters = leaves.into_iter().map(Cluster::new).collect();
        let mut merging = Self { samples, clusters, unit, row_distance };
        for i in 0..merging.clusters.len() {
            merging.find_nearest(i)?;
        }
        Ok(merging)
    }

    /// The metric, or infinity when it is not below `best` or the clusters may not be merged.
    fn distance_below(&self, i: usize, j: usize, best: f64) -> Result<f64, Error> {
        let a = &self.clusters[i];
        let b = &self.clusters[j];
        let cosine = a.normal.dot(b.normal);
        let base = (1.0 + a.centre.distance(b.centre) / self.unit) * (2.0 - cosine);
        if cosine < 0.0 || base >= best || !agree(self.samples, &a.group, &b.group) {
            return Ok(f64::INFINITY);
        }
        let row = (self.row_distance)(&a.group.members, &b.group.members);
        if row.is_nan() || row < 0.0 {
            let index = a.group.members[0].sample as usize;
            return Err(Error::Value { name: "row distance", index, value: f64::from(row), rule: "at least 0" });
        }
        Ok(base * (1.0 + f64::from(row)))
    }

    fn find_nearest(&mut self, i: usize) -> Result<(), Error> {
        let mut nearest = usize::MAX;
        let mut best = f64::INFINITY;
        for j in 0..self.clusters.len() {
            if j != i {
                let d = self.distance_below(i, j, best)?;
                if d < best {
                    (nearest, best) = (j, d);
                }
            }
        }
        (self.clusters[i].nearest, self.clusters[i].distance) = (nearest, best);
        Ok(())
    }

    fn merge_until(&mut self, most: usize) -> Result<(), Error> {
        while self.clusters.len() > most {
            let closest = (0..self.clusters.len())
                .min_by(|&a, &b| self.clusters[a].distance.total_cmp(&self.clusters[b].distance))
                .unwrap_or(0);
            if self.clusters[closest].distance == f64::INFINITY {
                break;
            }
            let (kept, gone) = ordered(closest, self.clusters[closest].nearest);
            // The last takes the place of the one that is gone.
            let taken = self.clusters.swap_remove(gone);
            let moved = self.clusters.len();
            let cluster = &mut self.clusters[kept];
            cluster.group.absorb(taken.group);
            cluster.centre = cluster.group.centre();
            cluster.normal = cluster.group.mean_normal();
            self.find_nearest(kept)?;
            for i in 0..self.clusters.len() {
                if i == kept {
                    continue;
                }
                let nearest = self.clusters[i].nearest;
                if nearest == kept || nearest == gone {
                    self.find_nearest(i)?;
                    continue;
                }
                if nearest == moved {
                    self.clusters[i].nearest = gone;
                }
                let d = self.distance_below(i, kept, self.clusters[i].distance)?;
                if d < self.clusters[i].distance {
                    (self.clusters[i].nearest, self.clusters[i].distance) = (kept, d);
                }
            }
        }
        Ok(())
    }
}

impl Cluster {
    fn new(group: Group) -> Self {
        let centre = group.centre();
        let normal = group.mean_normal();
        Self { group, centre, normal, nearest: usize::MAX, distance: f64::INFINITY }
    }
}

fn ordered(a: usize, b: usize) -> (usize, usize) {
    if a < b { (a, b) } else { (b, a) }
}
