//! Registration of photon hits. Sums are integers in fixed point ([`super::fixed`]), of flux over the mean flux of a
//! photon; many photons add to one sum, in any order.
//!
//! Words of the flux sums: three channels, each a low and a high word, for each cell, and then for each of [`SLOTS`]
//! what was emitted, what has left the scene, and what no cell owns. Words of the tallies: for each slot the numbers of
//! segments and of registered hits, each a low and a high word, and then the luminance of each group, batch by batch.

use scene::NONE;

use crate::types::*;

/// Parts of the sums that belong to no cell: photons that follow each other add to different ones and need not wait.
pub const SLOTS: u32 = 256;
/// Sums of a slot: emitted, escaped, unowned.
pub const SLOT_SUMS: u32 = 3;
/// Words of a sum of flux.
pub const SUM_WORDS: u32 = 6;
/// Words of a slot's numbers of segments and registered hits.
pub const COUNT_WORDS: u32 = 4;

/// Place where a photon hit is added; [`NONE`] where it is not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Registration {
    /// The sum of flux that it belongs to.
    pub sum: u32,
    /// The sum of what was emitted, for a first hit.
    pub emitted: u32,
    /// First word of the luminance of its group in its batch, among the tallies.
    pub luminance: u32,
    /// 1 where a cell took it.
    pub registered: u32,
}

/// Number of the flux sums.
#[inline]
pub fn sum_count(cells: u32) -> u32 {
    cells + SLOTS * SLOT_SUMS
}

/// First word of the numbers of segments and registered hits of a photon's slot.
#[inline]
pub fn count_word(photon: u32) -> u32 {
    photon % SLOTS * COUNT_WORDS
}

/// First word of the luminance of a group in a batch, among the tallies.
#[inline]
pub fn luminance_word(groups: u32, batch: u32, group: u32) -> u32 {
    SLOTS * COUNT_WORDS + 2 * (batch * groups + group)
}

/// Finds the place where a photon hit is added: `cell` tells the cell of a hit, `group` the group of a cell.
#[inline]
pub fn registration(
    p: &PhotonParams,
    hit: &PhotonHit,
    cell: impl Fn(&PhotonHit) -> u32,
    group: impl Fn(u32) -> u32,
) -> Registration {
    let slot = p.cell_count + hit.photon % SLOTS * SLOT_SUMS;
    let emitted = if hit.info & HIT_FIRST != 0 { slot } else { NONE };
    let mut found = Registration { sum: NONE, emitted, luminance: NONE, registered: 0 };
    if hit.triangle == NONE {
        found.sum = slot + 1;
        return found;
    }
    if (hit.info & HIT_INDIRECT) | (p.flags & FLAG_DIRECT) == 0 {
        return found;
    }
    let cell = cell(hit);
    if cell >= p.cell_count {
        found.sum = slot + 2;
        return found;
    }
    found.sum = cell;
    found.registered = 1;
    let group = group(cell);
    if group < p.group_count {
        found.luminance = luminance_word(p.group_count, hit.photon / p.per_batch, group);
    }
    found
}
