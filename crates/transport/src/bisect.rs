//! Top-down bisection: a list is cut in two, then each of its parts, down to the leaves of a tree.
//!
//! What is near in space is near in the list afterwards, and the parts are a hierarchy of clusters.
//! Where and how a part is cut is the caller's: across the axis of greatest spread, at the median,
//! at multiples of a tile.

use alloc::vec::Vec;
use core::ops::Range;

use scene::parallel::*;

/// A part of a bisected list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part<V> {
    /// Range in the list.
    pub range: Range<usize>,
    /// Number of the first of the two parts that it is cut into, the other one follows; `None` for
    /// a leaf.
    pub first_child: Option<usize>,
    /// The answer of `visit`.
    pub value: V,
}

/// A part that is not yet visited: where it begins in the list, and its items.
type Open<'a, T> = (usize, &'a mut [T]);

/// Bisects a list from the top down. `visit(part)` brings the items of a part into order, and says
/// what is to be kept of it and where it is cut: a cut that leaves nothing on one side makes a leaf.
///
/// Parts are numbered level by level, the root 0; there are none for an empty list. With the feature
/// `std` the parts of a level are visited on all cores; the result does not depend on that.
pub fn bisect<T: Send, V: Send>(items: &mut [T], visit: impl Fn(&mut [T]) -> (V, usize) + Sync) -> Vec<Part<V>> {
    let mut parts = Vec::new();
    let mut level: Vec<Open<T>> = Vec::new();
    if !items.is_empty() {
        level.push((0, items));
    }
    while !level.is_empty() {
        let visited: Vec<(V, usize)> = level.par_iter_mut().map(|(_, items)| visit(items)).collect();
        let first_below = parts.len() + level.len();
        let mut below: Vec<Open<T>> = Vec::new();
        for ((start, items), (value, middle)) in level.into_iter().zip(visited) {
            let is_cut = 0 < middle && middle < items.len();
            let first_child = is_cut.then_some(first_below + below.len());
            parts.push(Part { range: start..start + items.len(), first_child, value });
            if is_cut {
                let (left, right) = items.split_at_mut(middle);
                below.push((start, left));
                below.push((start + middle, right));
            }
        }
        level = below;
    }
    parts
}
