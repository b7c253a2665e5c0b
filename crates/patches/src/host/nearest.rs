//! The patch of any place on a surface: that of the nearest sample of like normal.

use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use std::vec::Vec;

use super::patch_set::PatchSet;
use scene::NONE;

/// A turn of the normal by 60° counts as much as this many sample edges.
const NORMAL_EDGES: f32 = 4.0;

/// Finds the nearest sample in position and normal, in O(log S).
pub struct Nearest {
    tree: ImmutableKdTree<f32, 6>,
    /// Sample edges a metre.
    scale: f32,
    /// Patch of each sample.
    patches: Vec<u32>,
}

impl Nearest {
    /// Over the samples of a set whose samples belong to one patch each.
    pub fn new(set: &PatchSet) -> Self {
        let total: f64 = set.samples.iter().map(|s| f64::from(s.area)).sum();
        let edge = scene::math::sqrt((total / set.samples.len().max(1) as f64) as f32);
        let scale = 1.0 / edge;
        let places: Vec<[f32; 6]> = set.samples.iter().map(|s| place(s.position * scale, s.normal)).collect();
        let mut patches = std::vec![NONE; set.samples.len()];
        for (patch, range) in set.offsets.windows(2).enumerate() {
            for member in &set.members[range[0] as usize..range[1] as usize] {
                patches[member.sample as usize] = patch as u32;
            }
        }
        Self { tree: ImmutableKdTree::new_from_slice(&places), scale, patches }
    }

    /// The patch of a place on the side of a surface with this unit normal, and its distance in sample edges: √ of the
    /// square of that in space and 16 |n − n'|².
    pub fn patch(&self, position: Vec3, normal: Vec3) -> (u32, f32) {
        let found = self.tree.nearest_one::<SquaredEuclidean>(&place(position * self.scale, normal));
        (self.patches[found.item as usize], scene::math::sqrt(found.distance))
    }
}

fn place(position: Vec3, normal: Vec3) -> [f32; 6] {
    let n = normal * NORMAL_EDGES;
    [position.x, position.y, position.z, n.x, n.y, n.z]
}
