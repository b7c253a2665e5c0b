//! Which nodes of a world are to stand for it: fine ones near the camera, coarse ones far off.

use alloc::collections::BinaryHeap;
use alloc::vec::Vec;

use glam::Vec3;

use super::choice::distance_to_path;
use super::forest::Forest;
use super::world::Node;

/// Camera position, and the predicted one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The camera, m.
    pub eye: Vec3,
    /// The end of its predicted path, m: patches along it are near already.
    pub predicted: Vec3,
}

/// Nodes that take the place of others which cover the same leaves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Replacement {
    pub enter: Vec<u32>,
    pub leave: Vec<u32>,
}

/// A node by its rank, a greater one first, of equal ones that of the lower number.
#[derive(PartialEq)]
struct Ranked(f32, u32);

impl Eq for Ranked {}

impl PartialOrd for Ranked {
    fn partial_cmp(&self, other: &Self) -> Option<core::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Ranked {
    fn cmp(&self, other: &Self) -> core::cmp::Ordering {
        self.0.total_cmp(&other.0).then(other.1.cmp(&self.1))
    }
}

/// Ranks nodes by their apparent size.
pub(super) struct Chooser<'a> {
    pub nodes: &'a [Node],
    pub forest: &'a Forest,
    pub view: View,
    /// Below this distance all is equally near, m.
    pub near: f32,
    /// The apparent size of what is fine already counts as larger by this share.
    pub hysteresis: f32,
    /// The nodes that stand for the world now, in order.
    pub cut: &'a [u32],
}

impl Chooser<'_> {
    /// Apparent size of a node: its edge over its distance from the predicted camera path.
    pub fn apparent_size(&self, node: u32) -> f32 {
        let Node { centre, radius, area, .. } = self.nodes[node as usize];
        let distance = (distance_to_path(centre, self.view.eye, self.view.predicted) - radius).max(0.0);
        scene::math::sqrt(area) / (distance + self.near)
    }

    /// Rank with hysteresis: for nodes that are in, or whose descendants are.
    fn rank(&self, node: u32) -> f32 {
        let at = self.forest.first_from(self.cut, node);
        let is_in = self.cut.get(at).is_some_and(|&one| self.forest.covers(node, one));
        let is_finer = is_in && self.cut[at] != node;
        // Roots are never finer than they are: what counts for them is to be in at all.
        let is_root = self.nodes[node as usize].parent == super::world::NO_NODE;
        self.apparent_size(node) * if is_finer || (is_root && is_in) { 1.0 + self.hysteresis } else { 1.0 }
    }

    /// At most `capacity` nodes that cover the world, or the part of it of the greatest apparent size where its roots
    /// are too many already; in order. The node of the greatest apparent size is divided first. Nodes that
    /// `is_excluded` are not divided into.
    pub fn choose(&self, capacity: usize, is_excluded: impl Fn(u32) -> bool) -> Vec<u32> {
        let roots = self.forest.roots().iter().filter(|&&root| !is_excluded(root));
        let mut ranked: Vec<Ranked> = roots.map(|&root| Ranked(self.rank(root), root)).collect();
        ranked.sort_unstable_by(|a, b| b.cmp(a));
        ranked.truncate(capacity);
        let mut count = ranked.len();
        let mut heap = BinaryHeap::from(ranked);
        let mut chosen = Vec::new();
        while let Some(Ranked(_, node)) = heap.pop() {
            let Node { first_child, children, .. } = self.nodes[node as usize];
            let mut family = first_child..first_child + children;
            if children == 0 || count - 1 + children as usize > capacity || family.clone().any(&is_excluded) {
                chosen.push(node);
                continue;
            }
            count += children as usize - 1;
            heap.extend(&mut family.by_ref().map(|child| Ranked(self.rank(child), child)));
        }
        chosen.sort_unstable_by_key(|&node| self.forest.run(node));
        chosen
    }

    /// Replacements that lead from the present cut to another one, `(finer, coarser, out)`: of one node by several, of
    /// several by one, and of nodes that go without others in their place; nodes that come without are in `finer`.
    pub fn replacements(&self, target: &[u32]) -> (Vec<Replacement>, Vec<Replacement>, Vec<u32>) {
        let mut finer = Vec::new();
        let mut coarser = Vec::new();
        let mut out = Vec::new();
        let mut i = 0;
        let mut j = 0;
        while i < self.cut.len() || j < target.len() {
            let now = self.cut.get(i).copied();
            let then = target.get(j).copied();
            match (now, then) {
                (Some(now), Some(then)) if now == then => (i, j) = (i + 1, j + 1),
                (Some(now), Some(then)) if self.forest.covers(now, then) => {
                    let end = j + target[j..].partition_point(|&one| self.forest.covers(now, one));
                    finer.push(Replacement { enter: target[j..end].to_vec(), leave: vec![now] });
                    (i, j) = (i + 1, end);
                }
                (Some(now), Some(then)) if self.forest.covers(then, now) => {
                    let end = i + self.cut[i..].partition_point(|&one| self.forest.covers(then, one));
                    coarser.push(Replacement { enter: vec![then], leave: self.cut[i..end].to_vec() });
                    (i, j) = (end, j + 1);
                }
                (Some(now), then) if then.is_none_or(|then| self.forest.run(now)[0] < self.forest.run(then)[0]) => {
                    out.push(now);
                    i += 1;
                }
                (_, Some(then)) => {
                    finer.push(Replacement { enter: vec![then], leave: Vec::new() });
                    j += 1;
                }
                (_, None) => break,
            }
        }
        (finer, coarser, out)
    }
}
