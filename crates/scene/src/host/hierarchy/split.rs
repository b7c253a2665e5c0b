//! A hierarchy by cuts from the root down, where obvhs, which needs `std`, cannot be had.

use alloc::vec;
use alloc::vec::Vec;
use core::ops::Range;

use glam::Vec3;

use crate::gpu::{BvhNode, Triangle};

/// Triangles of a leaf at most: a packet of the host.
const LEAF: usize = 4;
/// Bins along an axis, between which a cut may lie.
const BINS: usize = 16;
/// From this level on parts are halved, so that no more than 2 + log₂ n levels follow, whatever the triangles.
const HALVED_LEVEL: usize = 32;

/// A triangle's box.
#[derive(Clone, Copy)]
struct Item {
    low: Vec3,
    high: Vec3,
    triangle: u32,
}

impl Item {
    fn new((triangle, t): (usize, &Triangle)) -> Self {
        let a = t.corner + t.edge_a;
        let b = t.corner + t.edge_b;
        Self { low: t.corner.min(a).min(b), high: t.corner.max(a).max(b), triangle: triangle as u32 }
    }

    /// Twice the middle of the box.
    fn middle(&self) -> Vec3 {
        self.low + self.high
    }
}

/// A box round some triangles.
#[derive(Clone, Copy)]
struct Bounds {
    low: Vec3,
    high: Vec3,
    count: usize,
}

impl Bounds {
    const EMPTY: Self = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY, count: 0 };

    fn of(items: &[Item]) -> Self {
        items.iter().fold(Self::EMPTY, |all, item| all.with(&Self { low: item.low, high: item.high, count: 1 }))
    }

    fn with(&self, other: &Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high), count: self.count + other.count }
    }

    /// Cost of rays through the parent: half the surface times the triangles.
    fn cost(&self) -> f32 {
        let size = self.high - self.low;
        if self.count == 0 { 0.0 } else { (size.x * (size.y + size.z) + size.y * size.z) * self.count as f32 }
    }
}

/// A cut across an axis.
#[derive(Clone, Copy)]
struct Cut {
    axis: usize,
    /// Twice the coordinate of the first bin's beginning.
    low: f32,
    /// Bins in twice a metre.
    per_length: f32,
    /// First bin of the second part.
    bin: usize,
    cost: f32,
}

impl Cut {
    fn bin_of(&self, item: &Item) -> usize {
        (((item.middle()[self.axis] - self.low) * self.per_length) as usize).min(BINS - 1)
    }
}

/// Nodes, root first, and the triangle of each place in the leaves, by the surface area heuristic in bins (Wald 2007).
pub fn build(triangles: &[Triangle]) -> (Vec<BvhNode>, Vec<u32>) {
    let mut items: Vec<Item> = triangles.iter().enumerate().map(Item::new).collect();
    let mut nodes = vec![BvhNode::default()];
    let mut waiting = vec![(0, 0..items.len(), 1)];
    while let Some((node, range, level)) = waiting.pop() {
        let first_child = nodes.len();
        let Range { start, end } = range.clone();
        let bounds = Bounds::of(&items[range.clone()]);
        let is_leaf = bounds.count <= LEAF;
        nodes[node] = BvhNode {
            min: bounds.low,
            max: bounds.high,
            prim_count: if is_leaf { bounds.count as u32 } else { 0 },
            first_index: if is_leaf { start as u32 } else { first_child as u32 },
        };
        if !is_leaf {
            let middle = start + split(&mut items[range], level);
            nodes.extend([BvhNode::default(); 2]);
            waiting.push((first_child + 1, middle..end, level + 1));
            waiting.push((first_child, start..middle, level + 1));
        }
    }
    (nodes, items.iter().map(|item| item.triangle).collect())
}

/// Puts the triangles of the first part before those of the second, neither empty, and tells how many they are.
fn split(items: &mut [Item], level: usize) -> usize {
    let cut = if level < HALVED_LEVEL { best_cut(items) } else { None };
    let Some(cut) = cut else {
        let half = items.len() / 2;
        let size = Bounds::of(items);
        let axis = (size.high - size.low).max_position();
        items.select_nth_unstable_by(half, |a, b| {
            a.middle()[axis].total_cmp(&b.middle()[axis]).then(a.triangle.cmp(&b.triangle))
        });
        return half;
    };
    let (first, second): (Vec<Item>, Vec<Item>) = items.iter().partition(|item| cut.bin_of(item) < cut.bin);
    items[..first.len()].copy_from_slice(&first);
    items[first.len()..].copy_from_slice(&second);
    first.len()
}

/// The cheapest cut; none where all middles are in one place.
fn best_cut(items: &[Item]) -> Option<Cut> {
    let low = items.iter().map(Item::middle).fold(Vec3::INFINITY, Vec3::min);
    let high = items.iter().map(Item::middle).fold(Vec3::NEG_INFINITY, Vec3::max);
    let cuts = (0..3).filter_map(|axis| {
        let per_length = BINS as f32 / (high[axis] - low[axis]);
        let cut = Cut { axis, low: low[axis], per_length, bin: 0, cost: f32::INFINITY };
        if per_length.is_finite() { cheapest(items, cut) } else { None }
    });
    cuts.min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// The cheapest cut across an axis.
fn cheapest(items: &[Item], cut: Cut) -> Option<Cut> {
    let mut bins = [Bounds::EMPTY; BINS];
    for item in items {
        let bin = &mut bins[cut.bin_of(item)];
        *bin = bin.with(&Bounds { low: item.low, high: item.high, count: 1 });
    }
    let mut after = [Bounds::EMPTY; BINS];
    for bin in (1..BINS).rev() {
        after[bin - 1] = after[bin].with(&bins[bin]);
    }
    let mut before = Bounds::EMPTY;
    let mut best: Option<Cut> = None;
    for bin in 1..BINS {
        before = before.with(&bins[bin - 1]);
        let second = after[bin - 1];
        let cost = before.cost() + second.cost();
        if before.count > 0 && second.count > 0 && best.is_none_or(|best| cost < best.cost) {
            best = Some(Cut { bin, cost, ..cut });
        }
    }
    best
}
