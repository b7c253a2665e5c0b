//! The bodies of the kernels: one invocation each, no `std`.

use glam::{Vec3, Vec4};
use scene::math::{luminance, sqrt};

use crate::types::{FadeParams, LevelParams, UpdateParams};

/// Slots that are counted together where lists of them are made.
pub const BLOCK: u32 = 64;
/// No column among those that are new.
pub const KEPT: u32 = u32::MAX;

/// Irradiance at a slot from some lit slots, `H_i = Σ_j T̂_ij √a_j E_j / √a_i`, W/m²; the fourth component is 0.
///
/// Shapes: `lit[lit_count]` names slots; `red`, `green` and `blue` hold the planes of T̂, `[slots · slots]`;
/// `sqrt_area[slots]` holds √a, m; `exitance[slots]`, W/m². Needs `slot < slots`.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn gather(
    slot: u32,
    slots: u32,
    lit_count: u32,
    lit: &[u32],
    red: &[f32],
    green: &[f32],
    blue: &[f32],
    sqrt_area: &[f32],
    exitance: &[Vec4],
) -> Vec4 {
    let row = slot * slots;
    let mut sum = Vec3::ZERO;
    for k in 0..lit_count {
        let j = lit[k as usize];
        let at = (row + j) as usize;
        sum += Vec3::new(red[at], green[at], blue[at]) * (exitance[j as usize].truncate() * sqrt_area[j as usize]);
    }
    (sum / sqrt_area[slot as usize]).extend(0.0)
}

/// Returns true if a slot goes into the list: its light is not 0.
#[inline]
pub fn is_some(value: Vec4) -> bool {
    value.x != 0.0 || value.y != 0.0 || value.z != 0.0
}

/// Slots of a block of [`BLOCK`] that go into the list. Shapes: `values[slots]`.
#[inline]
pub fn count(block: u32, slots: u32, values: &[Vec4]) -> u32 {
    let mut sum = 0;
    for k in 0..BLOCK {
        let slot = block * BLOCK + k;
        if slot < slots && is_some(values[slot as usize]) {
            sum += 1;
        }
    }
    sum
}

/// Start of a block's slots in the list; of the block after the last, the length of the list. Shapes: `counts[blocks]`.
/// Needs `block ≤ blocks`.
#[inline]
pub fn start(block: u32, counts: &[u32]) -> u32 {
    let mut sum = 0;
    for k in 0..block {
        sum += counts[k as usize];
    }
    sum
}

/// The slot at a place of a list: those that go into it in their order, then the others in theirs, so that each slot is
/// there once.
///
/// Shapes: `starts[blocks + 1]`, `values[slots]`. Needs `place < slots`.
#[inline]
pub fn compact(place: u32, slots: u32, starts: &[u32], values: &[Vec4]) -> u32 {
    let blocks = slots.div_ceil(BLOCK);
    let length = starts[blocks as usize];
    let is_in = place < length;
    let rank = if is_in { place } else { place - length };
    // The last block that begins at this rank or before; slots that are left out follow those that are in.
    let mut low = 0;
    let mut high = blocks;
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        let begins = if is_in { starts[middle as usize] } else { middle * BLOCK - starts[middle as usize] };
        if begins <= rank {
            low = middle;
        } else {
            high = middle;
        }
    }
    let begins = if is_in { starts[low as usize] } else { low * BLOCK - starts[low as usize] };
    let mut left = rank - begins;
    let mut slot = low * BLOCK;
    let end = slots.min(slot + BLOCK);
    while slot < end {
        if is_some(values[slot as usize]) == is_in {
            if left == 0 {
                break;
            }
            left -= 1;
        }
        slot += 1;
    }
    slot
}

/// Four entries of a plane of T̂ after an update: `T̂_ij + sign · Σ_k r_ki r_kj`, or what a slot whose column is new
/// has there.
///
/// Shapes: one invocation for four columns of a row, `[slots · slots / 4]`; `vectors[rank · slots]` and
/// `columns[new · slots]` from where the parameters say; `new_column[slots]` names the column of each slot that is new,
/// or [`KEPT`]; `old` are the entries so far. Needs a multiple of 4 slots.
#[inline]
pub fn update(
    invocation: u32,
    p: &UpdateParams,
    vectors: &[f32],
    columns: &[f32],
    new_column: &[u32],
    old: Vec4,
) -> Vec4 {
    let row = invocation / (p.slots / 4);
    let column = 4 * (invocation % (p.slots / 4));
    let own = new_column[row as usize];
    if own != KEPT {
        let at = (p.first_column + own * p.slots + column) as usize;
        return Vec4::new(columns[at], columns[at + 1], columns[at + 2], columns[at + 3]);
    }
    let mut sum = Vec4::ZERO;
    for k in 0..p.rank {
        let first = p.first_vector + k * p.slots;
        let r = vectors[(first + row) as usize];
        let c = (first + column) as usize;
        sum += Vec4::new(vectors[c], vectors[c + 1], vectors[c + 2], vectors[c + 3]) * r;
    }
    let new = old + sum * p.sign;
    let across = p.first_column + row;
    let c = column as usize;
    Vec4::new(
        replaced(new_column[c], new.x, across, p.slots, columns),
        replaced(new_column[c + 1], new.y, across, p.slots, columns),
        replaced(new_column[c + 2], new.z, across, p.slots, columns),
        replaced(new_column[c + 3], new.w, across, p.slots, columns),
    )
}

/// An entry, or that of a column that is new.
#[inline]
fn replaced(new_column: u32, entry: f32, across: u32, slots: u32, columns: &[f32]) -> f32 {
    if new_column == KEPT { entry } else { columns[(across + new_column * slots) as usize] }
}

/// Irradiance of a leaf, W/m²: that of the slot that stands for it, or 0. Shapes: `irradiance[slots]`.
#[inline]
pub fn spread(slot: u32, irradiance: &[Vec4]) -> Vec4 {
    if slot == KEPT { Vec4::ZERO } else { irradiance[slot as usize] }
}

/// Mean exitance of the leaves `first..end` by their areas, W/m²; 0 where there are none.
///
/// Shapes: `area[leaves]`, m²; `exitance[leaves]`, W/m². Needs `end ≤ leaves`.
#[inline]
pub fn mean(first: u32, end: u32, area: &[f32], exitance: &[Vec4]) -> Vec4 {
    let mut sum = Vec3::ZERO;
    let mut whole = 0.0;
    for k in first..end {
        sum += exitance[k as usize].truncate() * area[k as usize];
        whole += area[k as usize];
    }
    if whole > 0.0 { (sum / whole).extend(0.0) } else { Vec4::ZERO }
}

/// Remaining jump of a leaf's light, W/m²: `o ← s (o + H_before − H)`, so that `H + o` continues from the light before
/// the matrix changed. `before` and `now` are by the matrix as it was and as it is, of the same exitance; s is `keep`,
/// or more where a displayed value would change by more than two 255ths, see [`share_left`].
#[inline]
pub fn fade(offset: Vec4, before: Vec4, now: Vec4, p: &FadeParams) -> Vec4 {
    let jump = if p.has_jump != 0 { before - now } else { Vec4::ZERO };
    let left = offset + jump;
    let shown = now + left;
    let red = share_left(shown.x, now.x, p);
    let green = share_left(shown.y, now.y, p);
    let blue = share_left(shown.z, now.z, p);
    let most = if red > green { red } else { green };
    left * if most > blue { most } else { blue }
}

/// Light is taken from levels so much coarser than the nodes that stand there, as a factor of their edges, that none
/// shows its edges.
const COARSER: f32 = 1.6;

/// The level that a leaf takes its light from, and the share of the next coarser one: levels double the edge of nodes,
/// from 0 for the leaves themselves to `p.levels`, and nodes that look as large as those of the matrix are larger in
/// the distance.
#[inline]
pub fn level(p: &LevelParams, centre: Vec3) -> (u32, f32) {
    let distance = sqrt((centre - p.eye).length_squared());
    let mut size = COARSER * p.apparent_size * (distance + 2.0 * p.edge) / p.edge;
    let mut low = 0;
    while size >= 2.0 && low < p.levels {
        size *= 0.5;
        low += 1;
    }
    (low, if low < p.levels && size > 1.0 { size - 1.0 } else { 0.0 })
}

/// Remaining jump of a leaf's light, and its displayed light, W/m², from the previous values of both and the target.
/// The fourth component of what is shown is the luminance that was shown in the frame before.
#[inline]
pub fn show_leaf(offset: Vec4, before: Vec4, light: Vec4, p: &LevelParams) -> (Vec4, Vec4) {
    let was = if p.begins != 0 { luminance(before.truncate()) } else { before.w };
    let jumps = FadeParams { count: p.count, keep: p.keep, has_jump: p.has_jump, display_white: p.display_white };
    let left = if p.fades != 0 { fade(Vec4::ZERO, before, light, &jumps) } else { offset };
    (left, (light + left).truncate().extend(was))
}

/// Step of the square root of a displayed value, as a share of display white, with which the value itself changes by no
/// more than two 255ths: the curve of sRGB is nowhere more than 1.44 times as steep as the square root.
pub const FADE_STEP: f32 = 2.0 / 255.0 / 1.44;
/// Square root of the share of display white from which a value is displayed as white.
const NEARLY_DISPLAY_WHITE: f32 = 0.998;

/// Share of `shown − now` that is left after a frame, for one channel, W/m²: `keep`, or as much as the light is still
/// off when its square root, display white being 1, has come nearer by [`FADE_STEP`]. Above display white nothing can
/// be seen to change.
#[inline]
pub fn share_left(shown: f32, now: f32, p: &FadeParams) -> f32 {
    let from = shown / p.display_white;
    let to = now / p.display_white;
    let a = sqrt_to_display_white(from);
    let b = sqrt_to_display_white(to);
    let difference = if a > b { a - b } else { b - a };
    if difference <= FADE_STEP || (a > NEARLY_DISPLAY_WHITE && b > NEARLY_DISPLAY_WHITE) {
        return p.keep;
    }
    let next = if a > b { a - FADE_STEP } else { a + FADE_STEP };
    let share = (next * next - to) / (from - to);
    if share > p.keep { share } else { p.keep }
}

/// The square root of a share of display white, within 0 and 1.
#[inline]
fn sqrt_to_display_white(share: f32) -> f32 {
    let low = if share > 0.0 { share } else { 0.0 };
    sqrt(if low < 1.0 { low } else { 1.0 })
}

/// Irradiance of a patch, W/m²: that of its leaf, and what is left of jumps there. Shapes: `now[leaves]`,
/// `offset[leaves]`.
#[inline]
pub fn show(leaf: u32, now: &[Vec4], offset: &[Vec4]) -> Vec4 {
    now[leaf as usize] + offset[leaf as usize]
}
