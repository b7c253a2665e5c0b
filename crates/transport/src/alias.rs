//! Alias tables: an entry of a weighted list is sampled in constant time.
//!
//! Each of n entries has a slot of the same size. The slot of an entry of less than the mean weight
//! is filled up by one that has more, so a slot names at most two entries: draw a slot uniformly,
//! then one of the two (Walker 1977; construction in O(n) by Vose 1991). Methods keep slots in
//! formats of their own; the pairing is made here.

use alloc::vec::Vec;
use core::ops::{Sub, SubAssign};

/// Pairs entries that have less than a slot with entries that have more.
///
/// `shares[k]` is what entry k has, `full` what a slot holds; their sum should be `n · full`. On
/// return, `shares` holds what was left of each. `stacked` names all entries once, in the order in
/// which they are put on the stacks of light and heavy ones; the last on a stack comes first.
/// `fill(light, kept, heavy)` receives each pair: the slot of `light` keeps the share `kept` for
/// itself, and `heavy` has the rest. An entry that is never named as `light` has a whole slot.
///
/// Returns the light entries for which nothing heavy was left: none but for rounding.
pub fn pair_entries<T>(
    shares: &mut [T],
    full: T,
    stacked: impl Iterator<Item = u32>,
    mut fill: impl FnMut(u32, T, u32),
) -> Vec<u32>
where
    T: Copy + PartialOrd + Sub<Output = T> + SubAssign,
{
    let (mut light, mut heavy): (Vec<u32>, Vec<u32>) = stacked.partition(|&k| shares[k as usize] < full);
    while let (Some(&small), Some(&large)) = (light.last(), heavy.last()) {
        light.pop();
        let kept = shares[small as usize];
        fill(small, kept, large);
        shares[large as usize] -= full - kept;
        if shares[large as usize] < full {
            heavy.pop();
            light.push(large);
        }
    }
    light
}
