//! The rows of the dense and sparse parts: dense sub-blocks and sparse residual.

use glam::{IVec3, UVec3, UVec4, Vec3, Vec4};

use super::{
    CHANNEL_WORDS, Eight, LIGHT_WORDS, PAIRS, PAIRS_AT, PARTS, SUB_BLOCK_WORDS, U32X4S, add_scaled, high, low, steps_at,
};
use crate::types::SubBlock;

/// Contribution of entry `k` of the sparse residual: its column is in the lower 16 bits, its signed value above them.
#[inline]
fn light(k: u32, entries: &[u32], ordered: &[Vec4]) -> Vec3 {
    let entry = entries[k as usize];
    ordered[(entry & 0xffff) as usize].truncate() * ((entry as i32) >> 16) as f32
}

/// The sparse residual's row at permuted index `p`, times its step.
#[inline]
fn sparse_row(p: u32, row_start: &[u32], entries: &[u32], steps: &[f32], ordered: &[Vec4]) -> Vec3 {
    // Four sums: an addition takes longer than the loads.
    let mut a = Vec3::ZERO;
    let mut b = Vec3::ZERO;
    let mut c = Vec3::ZERO;
    let mut d = Vec3::ZERO;
    let mut k = row_start[p as usize];
    let end = row_start[p as usize + 1];
    while k + 4 <= end {
        a += light(k, entries, ordered);
        b += light(k + 1, entries, ordered);
        c += light(k + 2, entries, ordered);
        d += light(k + 3, entries, ordered);
        k += 4;
    }
    if k < end {
        a += light(k, entries, ordered);
    }
    if k + 1 < end {
        b += light(k + 1, entries, ordered);
    }
    if k + 2 < end {
        c += light(k + 2, entries, ordered);
    }
    ((a + b) + (c + d)) * steps[p as usize]
}

/// Four elements of a sub-block's row, in columns 0 and 1, then 2 and 3.
#[inline]
pub fn row_of(word: u32) -> [i32; 4] {
    let byte = |shift: u32| ((word << shift) as i32) >> 24;
    [byte(24), byte(8), byte(16), byte(0)]
}

/// Adds what four columns of a sub-block bring to one of its rows, given the exitance of the first and last two of
/// them.
#[inline]
fn add_four(sum: IVec3, word: u32, first: (IVec3, IVec3), last: (IVec3, IVec3)) -> IVec3 {
    let [a, b, c, d] = row_of(word);
    sum + first.0 * a + first.1 * b + last.0 * c + last.1 * d
}

/// Adds what four columns of a sub-block bring to eight rows.
#[inline]
fn add_columns(sum: Eight<IVec3>, (x, y): (UVec4, UVec4), first: UVec3, last: UVec3) -> Eight<IVec3> {
    let first = (low(first), high(first));
    let last = (low(last), high(last));
    Eight {
        a: add_four(sum.a, x.x, first, last),
        b: add_four(sum.b, x.y, first, last),
        c: add_four(sum.c, x.z, first, last),
        d: add_four(sum.d, x.w, first, last),
        e: add_four(sum.e, y.x, first, last),
        f: add_four(sum.f, y.y, first, last),
        g: add_four(sum.g, y.z, first, last),
        h: add_four(sum.h, y.w, first, last),
    }
}

/// Eight rows of the dense and sparse parts, from permuted index `8 k` on: the sub-blocks of their part, one after
/// another, then the sparse residual.
///
/// Shapes: `sub_block_start[blocks · PARTS + 1]`, `sub_blocks[n]`, `sub_block_words[n · SUB_BLOCK_WORDS / 4]`, `light`
/// of [`super::quantise`] as `u32x4`s, `row_start[blocks · TILE + 1]`, `steps[blocks · TILE]`, `ordered` long enough
/// for the entries' columns. Needs `8 k < blocks · TILE`.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn dense_sparse(
    k: u32,
    sub_block_start: &[u32],
    sub_blocks: &[SubBlock],
    sub_block_words: &[UVec4],
    light: &[UVec4],
    row_start: &[u32],
    entries: &[u32],
    steps: &[f32],
    ordered: &[Vec4],
) -> [Vec4; 8] {
    let part = (k / 2) as usize;
    let half = k % 2;
    let mut rows = Eight::splat(Vec3::ZERO);
    for s in sub_block_start[part]..sub_block_start[part + 1] {
        let sub_block = sub_blocks[s as usize];
        let first = sub_block.column / PARTS * (LIGHT_WORDS / 4);
        let pairs = first + PAIRS_AT / 4 + sub_block.column % PARTS * (3 * PAIRS / 4);
        let mut sum = Eight::splat(IVec3::ZERO);
        // Eight columns, four at a time.
        for two in 0..2 {
            let at = (pairs + two) as usize;
            let red = light[at];
            let green = light[at + 2];
            let blue = light[at + 4];
            let at = (s * (SUB_BLOCK_WORDS / 4) + two * 2 * U32X4S + 2 * half) as usize;
            let x = UVec3::new(red.x, green.x, blue.x);
            let y = UVec3::new(red.y, green.y, blue.y);
            sum = add_columns(sum, (sub_block_words[at], sub_block_words[at + 1]), x, y);
            let at = at + U32X4S as usize;
            let z = UVec3::new(red.z, green.z, blue.z);
            let w = UVec3::new(red.w, green.w, blue.w);
            sum = add_columns(sum, (sub_block_words[at], sub_block_words[at + 1]), z, w);
        }
        rows = add_scaled(rows, sum, steps_at(light, first + 3 * CHANNEL_WORDS / 4) * sub_block.step);
    }
    let p = 8 * k;
    [
        (rows.a + sparse_row(p, row_start, entries, steps, ordered)).extend(0.0),
        (rows.b + sparse_row(p + 1, row_start, entries, steps, ordered)).extend(0.0),
        (rows.c + sparse_row(p + 2, row_start, entries, steps, ordered)).extend(0.0),
        (rows.d + sparse_row(p + 3, row_start, entries, steps, ordered)).extend(0.0),
        (rows.e + sparse_row(p + 4, row_start, entries, steps, ordered)).extend(0.0),
        (rows.f + sparse_row(p + 5, row_start, entries, steps, ordered)).extend(0.0),
        (rows.g + sparse_row(p + 6, row_start, entries, steps, ordered)).extend(0.0),
        (rows.h + sparse_row(p + 7, row_start, entries, steps, ordered)).extend(0.0),
    ]
}
