//! The sample of any place on a surface: the nearest of like normal.

use std::num::NonZero;

use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use std::vec::Vec;

use crate::types::Sample;

/// A turn of the normal by 60° counts as much as this many sample edges.
const NORMAL_EDGES: f32 = 4.0;

/// Finds the nearest sample in position and normal, in O(log S).
pub struct Nearest {
    tree: ImmutableKdTree<f32, 6>,
    /// Sample edges a metre.
    scale: f32,
}

impl Nearest {
    /// Over samples of about equal area.
    pub fn new(samples: &[Sample]) -> Self {
        let total: f64 = samples.iter().map(|s| f64::from(s.area)).sum();
        let edge = scene::math::sqrt((total / samples.len().max(1) as f64) as f32);
        let scale = 1.0 / edge;
        let places: Vec<[f32; 6]> = samples.iter().map(|s| place(s.position * scale, s.normal)).collect();
        Self { tree: ImmutableKdTree::new_from_slice(&places), scale }
    }

    /// The sample nearest to a place on the side of a surface with this unit normal, and its distance in sample edges: √ of
    /// the square of that in space and 16 |n − n'|².
    pub fn sample(&self, position: Vec3, normal: Vec3) -> (u32, f32) {
        let found = self.tree.nearest_one::<SquaredEuclidean>(&place(position * self.scale, normal));
        (found.item as u32, scene::math::sqrt(found.distance))
    }

    /// The nearest samples, as [`Nearest::sample`] finds one.
    pub fn samples(&self, position: Vec3, normal: Vec3, count: usize) -> Vec<(u32, f32)> {
        let Some(count) = NonZero::new(count.min(self.tree.size())) else { return Vec::new() };
        let found = self.tree.nearest_n::<SquaredEuclidean>(&place(position * self.scale, normal), count);
        found.iter().map(|f| (f.item as u32, scene::math::sqrt(f.distance))).collect()
    }
}

fn place(position: Vec3, normal: Vec3) -> [f32; 6] {
    let n = normal * NORMAL_EDGES;
    [position.x, position.y, position.z, n.x, n.y, n.z]
}
