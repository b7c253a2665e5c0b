//! Axis-aligned virtual patches: at most six a voxel.

use alloc::vec::Vec;

use scene::parallel::*;

use super::grid::Grid;
use super::group::{Group, check_voxels, merge_slivers, patches_of};
use super::patch_set::PatchSet;
use super::sample::SampleSet;
use crate::error::Error;

/// Parts of a sample below this are left to its other axes: rounding of a normal makes no patch.
pub(super) const MIN_PART: f32 = 1e-6;

/// One patch for each of the six axis directions that samples of a voxel look to [T 5.9]: area Σ w s, the rest means
/// weighted by w s, with `w = n_axis²` on the side that the normal n points to (printed: `max(0, n·e)`), so that the
/// weights of a sample sum to 1. Slivers (under 1 % of the voxel's mean patch) go to the nearest patch of the voxel
/// with a like normal. On all cores, linear in the number of samples.
///
/// # Errors
/// [`Error::Length`] for samples of another grid, and what [`PatchSet::from_groups`] refuses.
pub fn axis_patches(grid: &Grid, set: SampleSet) -> Result<PatchSet, Error> {
    check_voxels(grid, &set)?;
    let voxels = (0..grid.len())
        .into_par_iter()
        .map(|slot| {
            let mut groups: Vec<Group> = alloc::vec![Group::default(); 6];
            for index in set.range(slot) {
                let sample = &set.samples[index];
                for (axis, n) in sample.normal.to_array().into_iter().enumerate() {
                    let weight = n * n;
                    if weight > MIN_PART {
                        groups[2 * axis + usize::from(n < 0.0)].push(index as u32, sample, weight);
                    }
                }
            }
            groups.retain(|g| !g.members.is_empty());
            merge_slivers(&mut groups, |_, _| true);
            groups
        })
        .collect();
    patches_of(grid, set, voxels)
}
