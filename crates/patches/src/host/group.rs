//! Groups of samples of one voxel, on the way to become patches.

use alloc::vec::Vec;

use glam::DVec3;

use super::grid::Grid;
use super::patch_set::PatchSet;
use super::sample::SampleSet;
use crate::error::Error;
use crate::types::{Member, Sample};

/// Patches below this share of the mean area of the voxel's patches are slivers.
const SLIVER_SHARE: f64 = 0.01;

/// Samples, with the part of each that belongs to the group, and their sums.
#[derive(Clone, Debug, Default)]
pub(super) struct Group {
    pub(super) area: f64,
    /// Σ a x, m³.
    position: DVec3,
    /// Σ a n, m².
    normal: DVec3,
    /// Members by rising sample.
    pub(super) members: Vec<Member>,
}

impl Group {
    /// Adds the part `weight` of a sample. Samples come in rising order.
    pub(super) fn push(&mut self, index: u32, sample: &Sample, weight: f32) {
        let a = f64::from(weight) * f64::from(sample.area);
        self.area += a;
        self.position += sample.position.as_dvec3() * a;
        self.normal += sample.normal.as_dvec3() * a;
        self.members.push(Member { sample: index, weight });
    }

    /// Area-weighted mean position, m.
    pub(super) fn centre(&self) -> DVec3 {
        self.position / self.area
    }

    /// Area-weighted mean normal, unit.
    pub(super) fn mean_normal(&self) -> DVec3 {
        self.normal.normalize_or_zero()
    }

    /// Takes the members of another group in; parts of the same sample add up.
    pub(super) fn absorb(&mut self, other: Self) {
        self.area += other.area;
        self.position += other.position;
        self.normal += other.normal;
        self.members.extend(other.members);
        self.members.sort_by_key(|m| m.sample);
        self.members.dedup_by(|next, kept| {
            let same = next.sample == kept.sample;
            if same {
                kept.weight += next.weight;
            }
            same
        });
    }
}

/// Merges groups with less than 1 % of the mean area into the nearest whose normal is alike and that `may_merge`, the
/// smallest first. Averages of A_i F_ij would ruin the rows of such slivers.
pub(super) fn merge_slivers(groups: &mut Vec<Group>, may_merge: impl Fn(&Group, &Group) -> bool) {
    let total: f64 = groups.iter().map(|g| g.area).sum();
    let least = SLIVER_SHARE * total / groups.len().max(1) as f64;
    let mut order: Vec<usize> = (0..groups.len()).filter(|&k| groups[k].area < least).collect();
    order.sort_by(|&a, &b| groups[a].area.total_cmp(&groups[b].area));
    for sliver in order {
        let centre = groups[sliver].centre();
        let normal = groups[sliver].mean_normal();
        let mut nearest = None;
        let mut distance = f64::INFINITY;
        for (k, group) in groups.iter().enumerate() {
            if k == sliver || group.members.is_empty() || normal.dot(group.mean_normal()) <= 0.0 {
                continue;
            }
            let d = group.centre().distance_squared(centre);
            if d < distance && may_merge(&groups[sliver], group) {
                (nearest, distance) = (Some(k), d);
            }
        }
        if let Some(target) = nearest {
            let taken = core::mem::take(&mut groups[sliver]);
            groups[target].absorb(taken);
        }
    }
    groups.retain(|g| !g.members.is_empty());
}

/// The patches of all voxels, `voxels[slot]` the groups of one.
pub(super) fn patches_of(grid: &Grid, set: SampleSet, voxels: Vec<Vec<Group>>) -> Result<PatchSet, Error> {
    let count: usize = voxels.iter().flatten().map(|g| g.members.len()).sum();
    if count > u32::MAX as usize {
        return Err(Error::TooMany { name: "members of patches", found: count as u64, limit: u64::from(u32::MAX) });
    }
    let mut numbers = Vec::new();
    let mut offsets = alloc::vec![0];
    let mut members = Vec::with_capacity(count);
    for (slot, groups) in voxels.into_iter().enumerate() {
        for group in groups {
            numbers.push(grid.occupied[slot]);
            members.extend(group.members);
            offsets.push(members.len() as u32);
        }
    }
    PatchSet::from_groups(set.samples, &numbers, offsets, members)
}

/// Checks that a set of samples belongs to a grid.
pub(super) fn check_voxels(grid: &Grid, set: &SampleSet) -> Result<(), Error> {
    if set.offsets.len() != grid.len() + 1 {
        return Err(Error::Length { name: "offsets of samples", expected: grid.len() + 1, found: set.offsets.len() });
    }
    let last = set.offsets[grid.len()] as usize;
    if set.samples.len() != last || set.offsets.windows(2).any(|p| p[0] > p[1]) {
        return Err(Error::Length { name: "samples", expected: last, found: set.samples.len() });
    }
    Ok(())
}
