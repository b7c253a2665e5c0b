//! Weighted means of receivers near each other, as packed rows.
//!
//! Rows of a block take from the same few receivers, which the block lists; an entry of 16 bits names one of the list
//! and a weight in steps of 1/128. Where the normal of the row differs from that of a receiver, a second number of 16
//! bits says how the receiver's irradiance is rotated.

use glam::Vec4;
use scene::SurfacePoint;
use scene::kernel::lobe::Slope;
use scene::sampling::frame;
use transport::kernel::view::mark;

use crate::types::WeightParams;

/// Bits of an entry that name a receiver of the block's list.
pub const LISTED_BITS: u32 = 7;
/// Receivers of a list at most.
pub const MAX_LISTED: u32 = 1 << LISTED_BITS;
/// Steps of a weight of 1.
pub const WEIGHT_STEPS: u32 = 128;
/// A weight of 0, in steps: those that are stored are not negative.
pub const WEIGHT_BIAS: u32 = 256;
/// Bits of a row's start that count its entries with a rotation, which come last.
pub const ROTATED_BITS: u32 = 5;
/// Steps of a rotation of 1, and one of 0 in steps.
pub const ROTATION_STEPS: u32 = 254;
/// See [`ROTATION_STEPS`].
pub const ROTATION_BIAS: u32 = 128;

/// Number `k` of 16 bits.
#[inline]
pub fn half_word(words: &[u32], k: u32) -> u32 {
    words[(k / 2) as usize] >> (16 * (k % 2)) & 0xffff
}

/// First number of a row, by its start.
#[inline]
pub fn first_of(start: u32) -> u32 {
    start >> ROTATED_BITS
}

/// First number of the entries with a rotation, of a row with this start that ends before `end`.
#[inline]
pub fn first_rotated(start: u32, end: u32) -> u32 {
    end - 2 * (start & ((1 << ROTATED_BITS) - 1))
}

/// Which of the list an entry names.
#[inline]
pub fn listed(entry: u32) -> u32 {
    entry & (MAX_LISTED - 1)
}

/// Weight of an entry.
#[inline]
pub fn weight_of(entry: u32) -> f32 {
    ((entry >> LISTED_BITS) as i32 - WEIGHT_BIAS as i32) as f32 * (1.0 / WEIGHT_STEPS as f32)
}

/// Rotation to the right and upwards of the receiver's frame, as the difference of the normals.
#[inline]
pub fn rotation_of(packed: u32) -> (f32, f32) {
    let part = |bits: u32| (bits as i32 - ROTATION_BIAS as i32) as f32 * (1.0 / ROTATION_STEPS as f32);
    (part(packed & 0xff), part(packed >> 8))
}

/// Value `k` of a product with packed rows: `Σ_j w_j (h_j + Σ_q H_jq t_q·Δn_j)` with the values h of the receivers and
/// their irradiance H from each hemisphere quadrant, W/m² ([`transport::rotational_gradients`] has t).
///
/// Shapes: `row_start[rows + 1]`, first number of a row and how many of its entries are rotated ([`ROTATED_BITS`]);
/// `list_start`, first of the list of each block of `p.block_rows` rows; `lists`, numbers of receivers; `entries`, two
/// numbers of 16 bits a word; `values`, first the four quadrants of each receiver, and from `p.first_value` on the
/// values h: each is the sum of `p.parts` numbers. Needs `k < rows`.
#[inline]
pub fn weighted_row(
    k: u32,
    p: &WeightParams,
    row_start: &[u32],
    list_start: &[u32],
    lists: &[u32],
    entries: &[u32],
    values: &[Vec4],
) -> Vec4 {
    let start = row_start[k as usize];
    let end = first_of(row_start[k as usize + 1]);
    let rotated = first_rotated(start, end);
    let list = list_start[(k / p.block_rows) as usize];
    let mut sum = Vec4::ZERO;
    for unit in first_of(start)..rotated {
        let entry = half_word(entries, unit);
        let receiver = lists[(list + listed(entry)) as usize];
        sum += value_of(p, receiver, values) * weight_of(entry);
    }
    for pair in 0..(end - rotated) / 2 {
        let entry = half_word(entries, rotated + 2 * pair);
        let receiver = lists[(list + listed(entry)) as usize];
        let (right, up) = rotation_of(half_word(entries, rotated + 2 * pair + 1));
        sum += (value_of(p, receiver, values) + change_of(receiver, right, up, values)) * weight_of(entry);
    }
    sum
}

/// Marks the values that row `k` takes from for a view ([`transport::kernel::view`]). Shapes: as in [`weighted_row`],
/// `marks` one a value. Needs `k < rows`.
#[inline]
pub fn mark_row(
    k: u32,
    p: &WeightParams,
    row_start: &[u32],
    list_start: &[u32],
    lists: &[u32],
    entries: &[u32],
    marks: &mut [u32],
) {
    let start = row_start[k as usize];
    let end = first_of(row_start[k as usize + 1]);
    let rotated = first_rotated(start, end);
    let list = list_start[(k / p.block_rows) as usize];
    for unit in first_of(start)..rotated {
        let receiver = lists[(list + listed(half_word(entries, unit))) as usize];
        mark_value(p, receiver, marks);
    }
    for pair in 0..(end - rotated) / 2 {
        let receiver = lists[(list + listed(half_word(entries, rotated + 2 * pair))) as usize];
        mark_value(p, receiver, marks);
        for quadrant in 0..4 {
            mark(marks, 4 * receiver + quadrant, p.view);
        }
    }
}

/// Marks the value of a receiver.
#[inline]
fn mark_value(p: &WeightParams, receiver: u32, marks: &mut [u32]) {
    for part in 0..p.parts {
        mark(marks, p.first_value + p.parts * receiver + part, p.view);
    }
}

/// Value of a receiver, the sum of its parts.
#[inline]
pub fn value_of(p: &WeightParams, receiver: u32, values: &[Vec4]) -> Vec4 {
    let first = (p.first_value + p.parts * receiver) as usize;
    if p.parts == 1 {
        return values[first];
    }
    (values[first] + values[first + 1]) + (values[first + 2] + values[first + 3])
}

/// Adds to `sum` how much more light comes from each side in row `k`, times `share`: `Σ_j w_j Σ_q H_jq t_q`, a vector for
/// each channel. Shapes: as in [`weighted_row`], `points` the receivers. Needs `k < rows`.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn add_difference(
    k: u32,
    block_rows: u32,
    row_start: &[u32],
    list_start: &[u32],
    lists: &[u32],
    entries: &[u32],
    points: &[SurfacePoint],
    values: &[Vec4],
    share: f32,
    sum: Slope,
) -> Slope {
    let mut sum = sum;
    let start = row_start[k as usize];
    let end = first_of(row_start[k as usize + 1]);
    let rotated = first_rotated(start, end);
    let list = list_start[(k / block_rows) as usize];
    let count = rotated - first_of(start) + (end - rotated) / 2;
    for number in 0..count {
        let straight = first_of(start) + number;
        let unit = if straight < rotated { straight } else { rotated + 2 * (straight - rotated) };
        let entry = half_word(entries, unit);
        let receiver = lists[(list + listed(entry)) as usize];
        let weight = share * weight_of(entry);
        let (right, up) = frame(points[receiver as usize].normal);
        sum = sum.with(change_of(receiver, weight, 0.0, values).truncate(), right);
        sum = sum.with(change_of(receiver, 0.0, weight, values).truncate(), up);
    }
    sum
}

/// Change of a receiver's irradiance by a rotation, `Σ_q H_q t_q·Δn`.
#[inline]
pub fn change_of(receiver: u32, right: f32, up: f32, values: &[Vec4]) -> Vec4 {
    let first = 4 * receiver as usize;
    let diagonal = values[first] - values[first + 2];
    let other = values[first + 1] - values[first + 3];
    (diagonal - other) * right + (diagonal + other) * up
}
