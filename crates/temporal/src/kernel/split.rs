//! Alias tables in parallel by splitting (Lehmann, Hübschle-Schneider and Sanders 2021, "Weighted random sampling on
//! GPUs").
//!
//! Weights are whole numbers whose sum is [`PARTS`] times their count. Light entries (below [`PARTS`]) are filled one
//! after the other by heavy ones, in order; a heavy one that falls below is filled by the next. With prefix sums of
//! what the light ones lack and the heavy ones have too much, each slot finds its own second entry by bisection:
//! [`scan_row`] makes the sums, row by row, [`pack_entry`] the slots, all at once.

use glam::UVec2;

use super::tables::PARTS;

/// Partition and prefix sums of a row: its light entries in order, then its heavy ones; x is the number of the entry
/// within the row, y the sum of what the light ones before it lack, or of what the heavy ones up to it have too much.
///
/// Shapes: `weights[row_start[rows]]`; the row's part of the sums goes to `scan` from `row_start[row] − base` on.
#[inline]
pub fn scan_row(row: u32, row_start: &[u32], weights: &[u32], base: u32, scan: &mut [UVec2]) {
    let first = row_start[row as usize];
    let end = row_start[row as usize + 1];
    let mut place = first - base;
    let mut sum = 0;
    for entry in first..end {
        let weight = weights[entry as usize];
        if weight < PARTS {
            scan[place as usize] = UVec2::new(entry - first, sum);
            place += 1;
            sum = sum.wrapping_add(PARTS - weight);
        }
    }
    sum = 0;
    for entry in first..end {
        let weight = weights[entry as usize];
        if weight >= PARTS {
            sum = sum.wrapping_add(weight - PARTS);
            scan[place as usize] = UVec2::new(entry - first, sum);
            place += 1;
        }
    }
}

/// Row that owns an entry.
#[inline]
pub fn row_of(entry: u32, rows: u32, row_start: &[u32]) -> u32 {
    let mut low = 0;
    let mut high = rows;
    while high - low > 1 {
        let middle = (low + high) / 2;
        if row_start[middle as usize] <= entry {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// A slot of a full entry: t cannot count all parts, but the other column is its own.
#[inline]
pub fn slot(t: u32, own: u32, other: u32) -> u32 {
    if t < PARTS { t << 16 | other } else { 0xffff_0000 | own }
}

/// Slot of an entry, as in [`super::tables`].
///
/// Shapes: `row_start[rows + 1]`, `weights` and `scan` by entry.
#[inline]
pub fn pack_entry(entry: u32, rows: u32, row_start: &[u32], weights: &[u32], scan: &[UVec2]) -> u32 {
    let row = row_of(entry, rows, row_start);
    let first = row_start[row as usize];
    let end = row_start[row as usize + 1];
    // The first heavy one.
    let mut low = first;
    let mut high = end;
    while low < high {
        let middle = (low + high) / 2;
        if weights[(first + scan[middle as usize].x) as usize] < PARTS {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    // Weights of another sum have none: nothing is read beyond the row.
    let heavy = low.min(end - 1);
    let own = entry - first;
    let weight = weights[entry as usize];
    // Its place: entries ascend on both sides.
    let (mut low, mut high) = if weight < PARTS { (first, heavy) } else { (heavy, end) };
    while high - low > 1 {
        let middle = (low + high) / 2;
        if scan[middle as usize].x <= own {
            low = middle;
        } else {
            high = middle;
        }
    }
    let at = scan[low as usize];
    if weight < PARTS {
        // Filled by the first heavy one that lasts longer than what was lacking before.
        let mut a = heavy;
        let mut b = end - 1;
        while a < b {
            let middle = (a + b) / 2;
            if scan[middle as usize].y > at.y {
                b = middle;
            } else {
                a = middle + 1;
            }
        }
        return slot(weight, own, scan[a as usize].x);
    }
    // What those lack that begin before it is used up: the sum before the first that does not.
    let mut a = first;
    let mut b = heavy;
    while a < b {
        let middle = (a + b) / 2;
        if scan[middle as usize].y < at.y {
            a = middle + 1;
        } else {
            b = middle;
        }
    }
    // All of them lack as much as the heavy ones have too much.
    let lacking = if a < heavy { scan[a as usize].y } else { scan[(end - 1) as usize].y };
    let next = if low + 1 < end { scan[(low + 1) as usize].x } else { own };
    slot(PARTS.wrapping_add(at.y).wrapping_sub(lacking), own, next)
}
