//! The product with a matrix in blocks of 4 × 4 texels, and the exact decoding of BC1, BC3, BC6H and BC7. A block is up
//! to four words; the first texel is the upper left, the fourth the upper right one.
//!
//! An entry of the matrix is `m = s c⁻¹(rgb · a)` with the texel's colour and alpha (1 but for BC3), the companding c
//! ([`expand`]) and the scale s of its tile, plus the correction of the side table where it has one.

mod bc1;
mod bc6h;
mod bc7;
mod words;

use glam::{UVec2, UVec4, Vec3, Vec4};

pub use bc1::{AlphaColorBlock, Bc1, Bc3, ColorBlock};
pub use bc6h::{Bc6h, HalfBlock};
pub use bc7::{Bc7, ByteBlock};

use crate::types::BlockParams;

/// Rows and columns of a block.
pub const BLOCK: u32 = 4;

/// Invocations that share the columns of a row of blocks.
pub const LANES: u32 = 64;

/// [`BlockParams::companding`]: entries as they are.
pub const COMPANDING_NONE: u32 = 0;
/// [`BlockParams::companding`]: square roots.
pub const COMPANDING_SQRT: u32 = 1;
/// [`BlockParams::companding`]: logarithms, `c = log2(1 + 255 m) / 8` (the μ-law with μ = 255).
pub const COMPANDING_LOG2: u32 = 2;

/// An order that has no element at this permuted index.
pub const NO_ELEMENT: u32 = u32::MAX;

/// A way to store 4 × 4 colours in two or four words.
pub trait BlockFormat {
    /// Values that all texels of a block share.
    type Block: Copy;
    /// Reads a block; of formats with 8 bytes the last two words are not used.
    fn parse(words: UVec4) -> Self::Block;
    /// Colour and alpha of texel `k` < 16, rows from the top.
    fn texel(block: Self::Block, k: u32) -> Vec4;
}

/// The half in the low 16 bits to single precision, exact for every finite half that is not negative.
#[inline]
pub fn widen_half(half: u32) -> f32 {
    let shifted = half << 13;
    if shifted < 1 << 23 {
        // Subnormal halves by a subtraction of normal numbers.
        f32::from_bits(shifted + (113 << 23)) - f32::from_bits(113 << 23)
    } else {
        f32::from_bits(shifted + (112 << 23))
    }
}

/// As [`widen_half`] with a sign in bit 15.
#[inline]
pub fn widen_signed_half(half: u32) -> f32 {
    let magnitude = widen_half(half & 0x7fff);
    if half & 0x8000 == 0 { magnitude } else { -magnitude }
}

/// 2^x for x in [0, 16), within 3·10⁻⁷ relative, the same bits on CPU and GPU: Taylor series of 2^y, |y| ≤ ½.
#[inline(always)]
pub(crate) fn exp2(x: f32) -> f32 {
    // 1.5 · 2²³: the lowest bits of the sum are x, rounded. CPUs do this faster in vectors than casts or `floor`.
    const SHIFT: f32 = 12_582_912.0;
    let shifted = x + SHIFT;
    let y = (x - (shifted - SHIFT)) * core::f32::consts::LN_2;
    let series =
        1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y * (1.0 / 120.0 + y * (1.0 / 720.0))))));
    series * f32::from_bits((shifted.to_bits() - SHIFT.to_bits() + 127) << 23)
}

/// Entry, in units of its tile's scale, from its companded form.
#[inline]
pub fn expand(c: Vec3, companding: u32) -> Vec3 {
    if companding == COMPANDING_SQRT {
        c * c
    } else if companding == COMPANDING_LOG2 {
        let one = |x: f32| (exp2(8.0 * x) - 1.0) * (1.0 / 255.0);
        Vec3::new(one(c.x), one(c.y), one(c.z))
    } else {
        c
    }
}

/// Entry, in units of its tile's scale, from its texel.
#[inline]
pub fn entry(texel: Vec4, p: &BlockParams) -> Vec3 {
    let color = texel.truncate();
    expand(if p.alpha == 1 { color * texel.w } else { color }, p.companding)
}

/// Sums of the four rows of a row of blocks. Named, not an array: an array would live in memory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BlockSums {
    /// Irradiance of the first row so far, W/m².
    pub a: Vec3,
    /// Value of the second row.
    pub b: Vec3,
    /// Value of the third row.
    pub c: Vec3,
    /// Value of the fourth row.
    pub d: Vec3,
}

impl BlockSums {
    /// Both together.
    #[inline]
    pub fn plus(self, more: Self) -> Self {
        Self { a: self.a + more.a, b: self.b + more.b, c: self.c + more.c, d: self.d + more.d }
    }
}

/// Adds the light through one block; `texels(k)` is its texel k, `light(c)` the exitance of its column c, `scale` its
/// tile's. A loop over columns: unrolled, a decoder would stand in a module sixteen times.
#[inline]
pub fn add_block(
    sums: BlockSums,
    texels: impl Fn(u32) -> Vec4,
    p: &BlockParams,
    scale: Vec3,
    light: impl Fn(u32) -> Vec3,
) -> BlockSums {
    let mut a = Vec3::ZERO;
    let mut b = Vec3::ZERO;
    let mut c = Vec3::ZERO;
    let mut d = Vec3::ZERO;
    for column in 0..BLOCK {
        let light = light(column);
        a += entry(texels(column), p) * light;
        b += entry(texels(4 + column), p) * light;
        c += entry(texels(8 + column), p) * light;
        d += entry(texels(12 + column), p) * light;
    }
    sums.plus(BlockSums { a: a * scale, b: b * scale, c: c * scale, d: d * scale })
}

/// Index of the scale of a block's tile.
#[inline]
fn tile_of(p: &BlockParams, row: u32, column: u32) -> u32 {
    (row >> p.tile_shift) * p.tile_columns + (column >> p.tile_shift)
}

/// Sum of one of `lanes` lanes for the four rows of a row of blocks: `H'_i = Σ_j m_ij B'_j` over the block columns
/// `lane, lane + lanes, …`, in the order of the columns. `words(k)` loads block k of the block rows that are bound,
/// `block_row` counts these; `scales` are of the whole matrix.
///
/// Shapes: `exitance[4 · block_columns]`, in the matrix's order and scaled by its columns ([`reorder`]), finite.
#[inline]
pub fn decode_gather_row<F: BlockFormat>(
    block_row: u32,
    p: &BlockParams,
    lane: u32,
    lanes: u32,
    words: impl Fn(u32) -> UVec4,
    scales: &[Vec4],
    exitance: &[Vec4],
) -> BlockSums {
    let mut sums = BlockSums { a: Vec3::ZERO, b: Vec3::ZERO, c: Vec3::ZERO, d: Vec3::ZERO };
    let mut column = lane;
    while column < p.block_columns {
        let block = F::parse(words(block_row * p.block_columns + column));
        let scale = scales[tile_of(p, p.first_block_row + block_row, column) as usize].truncate();
        let light = |c: u32| exitance[(BLOCK * column + c) as usize].truncate();
        sums = add_block(sums, |k| F::texel(block, k), p, scale, light);
        column += lanes;
    }
    sums
}

/// As [`decode_gather_row`], with texels that a texture unit decodes: `fetch(column, row)`.
#[inline]
pub fn fetch_gather_row(
    block_row: u32,
    p: &BlockParams,
    lane: u32,
    lanes: u32,
    fetch: impl Fn(u32, u32) -> Vec4,
    scales: &[Vec4],
    exitance: &[Vec4],
) -> BlockSums {
    let mut sums = BlockSums { a: Vec3::ZERO, b: Vec3::ZERO, c: Vec3::ZERO, d: Vec3::ZERO };
    let mut column = lane;
    while column < p.block_columns {
        let scale = scales[tile_of(p, p.first_block_row + block_row, column) as usize].truncate();
        let light = |c: u32| exitance[(BLOCK * column + c) as usize].truncate();
        let texel = |k: u32| fetch(BLOCK * column + (k & 3), BLOCK * block_row + (k >> 2));
        sums = add_block(sums, texel, p, scale, light);
        column += lanes;
    }
    sums
}

/// Sum of one of `lanes` lanes for row `i` of the side table, `Σ_k r_k B'_{j(k)}`; rows beyond the matrix have no
/// entries. An entry is a column and three halves: `[column | r << 16, g | b << 16]`.
///
/// Shapes: `start[rows + 1]`, of the whole matrix; `outliers` from [`BlockParams::first_outlier`] on.
#[inline]
pub fn gather_outliers(
    i: u32,
    p: &BlockParams,
    lane: u32,
    lanes: u32,
    start: &[u32],
    outliers: &[UVec2],
    exitance: &[Vec4],
) -> Vec3 {
    let mut sum = Vec3::ZERO;
    if i < p.rows {
        let end = start[i as usize + 1] - p.first_outlier;
        let mut k = start[i as usize] - p.first_outlier + lane;
        while k < end {
            let words = outliers[k as usize];
            let value = Vec3::new(
                widen_signed_half(words.x >> 16),
                widen_signed_half(words.y & 0xffff),
                widen_signed_half(words.y >> 16),
            );
            sum += value * exitance[(words.x & 0xffff) as usize].truncate();
            k += lanes;
        }
    }
    sum
}

/// [`gather_outliers`] for the four rows of a row of blocks.
#[inline]
pub fn gather_outlier_rows(
    block_row: u32,
    p: &BlockParams,
    lane: u32,
    lanes: u32,
    start: &[u32],
    outliers: &[UVec2],
    exitance: &[Vec4],
) -> BlockSums {
    let i = BLOCK * (p.first_block_row + block_row);
    BlockSums {
        a: gather_outliers(i, p, lane, lanes, start, outliers, exitance),
        b: gather_outliers(i + 1, p, lane, lanes, start, outliers, exitance),
        c: gather_outliers(i + 2, p, lane, lanes, start, outliers, exitance),
        d: gather_outliers(i + 3, p, lane, lanes, start, outliers, exitance),
    }
}

/// One step of the tree by which [`LANES`] partial sums become one: lane k takes in lane k + 32, then k + 16, …, k + 1.
#[inline]
pub fn combine(sum: Vec4, other: Vec4) -> Vec4 {
    sum + other
}

/// Element `k` of a vector in another order, `out_k = s_k in_{o(k)}`; 0 where o is [`NO_ELEMENT`].
#[inline]
pub fn reorder(k: u32, order: &[u32], scales: &[Vec4], input: &[Vec4]) -> Vec4 {
    let from = order[k as usize];
    if from == NO_ELEMENT { Vec4::ZERO } else { input[from as usize] * scales[k as usize] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_of_two_agree_with_double_precision() {
        for k in 0..100_000 {
            let x = k as f32 * (16.0 / 100_000.0);
            let expected = f64::from(x).exp2();
            assert!((f64::from(exp2(x)) - expected).abs() < 3e-7 * expected, "{x}");
        }
        assert!((f64::from(exp2(1.001)) - 2.0).abs() > 1e-3);
    }

    #[test]
    fn companding_begins_at_0_and_ends_at_1() {
        for companding in [COMPANDING_NONE, COMPANDING_SQRT, COMPANDING_LOG2] {
            assert_eq!(expand(Vec3::ZERO, companding), Vec3::ZERO);
            assert!((expand(Vec3::ONE, companding) - 1.0).abs().max_element() < 1e-6);
            assert!(expand(Vec3::splat(0.5), companding).x < 0.501);
        }
    }
}
