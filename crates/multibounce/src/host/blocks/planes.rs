//! Blocks as 16 texels of planar RGB: the same numbers as the kernels' decoders, in loops of which a compiler makes
//! vectors. The bit fields are read once a block, not once a texel.

use glam::{UVec3, UVec4, Vec3, Vec4};

use crate::kernel::blocks::{Bc1, Bc3, Bc6h, Bc7, BlockFormat};

/// Texels of a block.
const TEXELS: usize = 16;

/// Red, green and blue of the texels, rows from the top; of BC3 their product with alpha.
pub(super) type Planes = [[f32; TEXELS]; 3];

/// A format that is decoded a block at a time.
pub(super) trait PlaneFormat: BlockFormat {
    /// All texels of a block.
    fn planes(words: UVec4) -> Planes;
}

/// One texel after the other, by the kernels' decoder.
fn texel_by_texel<F: BlockFormat>(words: UVec4, value: impl Fn(Vec4) -> Vec3) -> Planes {
    let block = F::parse(words);
    let mut planes = [[0.0; TEXELS]; 3];
    for k in 0..TEXELS {
        let color = value(F::texel(block, k as u32));
        for (c, plane) in planes.iter_mut().enumerate() {
            plane[k] = color[c];
        }
    }
    planes
}

/// Indices of `n` bits, the first lowest.
#[inline(always)]
fn indices(bits: u64, n: u32) -> [u32; TEXELS] {
    // Each half fits a word: vectors of words shift faster.
    let halves = [bits as u32, (bits >> (8 * n)) as u32];
    let mut out = [0; TEXELS];
    for (k, index) in out.iter_mut().enumerate() {
        *index = halves[k / 8] >> (n * (k as u32 % 8)) & ((1 << n) - 1);
    }
    out
}

/// Puts a zero at each of the `anchors`' highest bits, where the format leaves a bit out. They rise.
#[inline(always)]
fn with_anchors(bits: u64, n: u32, anchors: [u32; 3]) -> u64 {
    let mut bits = bits;
    for anchor in anchors {
        if anchor < TEXELS as u32 {
            let low = (1u64 << (anchor * n + n - 1)) - 1;
            bits = bits & low | (bits & !low) << 1;
        }
    }
    bits
}

/// Bits of a block from `start` on.
#[inline(always)]
fn bits_from(words: UVec4, start: u32) -> u64 {
    let low = u128::from(words.x) | u128::from(words.y) << 32;
    let all = low | u128::from(words.z) << 64 | u128::from(words.w) << 96;
    (all >> start) as u64
}

/// Weights in 64ths of indices of 2, 3 and 4 bits.
const WEIGHTS: [[u32; TEXELS]; 3] = [
    [0, 21, 43, 64, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
    [0, 9, 18, 27, 37, 46, 55, 64, 0, 0, 0, 0, 0, 0, 0, 0],
    [0, 4, 9, 13, 17, 21, 26, 30, 34, 38, 43, 47, 51, 55, 60, 64],
];

/// Weights of the texels of a block whose indices have `n` bits from bit `start` on.
#[inline(always)]
fn weights(words: UVec4, start: u32, n: u32, anchors: [u32; 3]) -> [u32; TEXELS] {
    let table = &WEIGHTS[(n as usize).clamp(2, 4) - 2];
    indices(with_anchors(bits_from(words, start), n, anchors), n).map(|k| table[k as usize & 15])
}

/// Numbers between the ends of each texel's subset, `(a (64 − w) + b w + 32) / 64`; `ends` are those of subset 0, 1 and
/// 2, `subset` has two bits a texel.
#[inline(always)]
fn mix(ends: [(u32, u32); 3], subset: u32, weights: &[u32; TEXELS]) -> [u32; TEXELS] {
    let mut out = [0; TEXELS];
    for (k, value) in out.iter_mut().enumerate() {
        let s = subset >> (2 * k) & 3;
        let pick = |x: [u32; 3]| {
            if s == 0 {
                x[0]
            } else if s == 1 {
                x[1]
            } else {
                x[2]
            }
        };
        let a = pick(ends.map(|e| e.0));
        let b = pick(ends.map(|e| e.1));
        *value = (a * (64 - weights[k]) + b * weights[k] + 32) >> 6;
    }
    out
}

/// Colours of a block of BC1; `None` for the rare ones that hold black.
#[inline(always)]
fn colors(ends: u32, words: u32, opaque: bool) -> Option<Planes> {
    if !opaque && ends & 0xffff <= ends >> 16 {
        return None;
    }
    let mut shares = [0.0f32; TEXELS];
    for (k, share) in shares.iter_mut().enumerate() {
        let index = words >> (2 * k) & 3;
        let third = if index == 2 { 1.0 / 3.0 } else { 2.0 / 3.0 };
        *share = if index < 2 { index as f32 } else { third };
    }
    let channel = |shift: u32, count: u32| {
        let most = (1u32 << count) - 1;
        let one = |c: u32| (c >> shift & most) as f32 * (1.0 / most as f32);
        let a = one(ends);
        let b = one(ends >> 16);
        shares.map(|share| a + (b - a) * share)
    };
    Some([channel(11, 5), channel(5, 6), channel(0, 5)])
}

impl PlaneFormat for Bc1 {
    #[inline(always)]
    fn planes(words: UVec4) -> Planes {
        match colors(words.x, words.y, false) {
            Some(planes) => planes,
            None => texel_by_texel::<Self>(words, Vec4::truncate),
        }
    }
}

impl PlaneFormat for Bc3 {
    #[inline(always)]
    fn planes(words: UVec4) -> Planes {
        let Some(planes) = colors(words.z, words.w, true) else {
            return texel_by_texel::<Self>(words, |texel| texel.truncate() * texel.w);
        };
        let a = words.x & 255;
        let b = words.x >> 8 & 255;
        // Six numbers between the ends, or four, 0 and 1.
        let steps = if a > b { 7 } else { 5 };
        let a = a as f32 * (1.0 / 255.0);
        let b = b as f32 * (1.0 / 255.0);
        let step = (b - a) * (1.0 / steps as f32);
        let mut alphas = [0.0f32; TEXELS];
        for (alpha, index) in alphas.iter_mut().zip(indices(bits_from(words, 16), 3)) {
            let between = a + step * (index as i32 - 1) as f32;
            let end = if index == 0 { a } else { b };
            let rest = (index as i32 - 6) as f32;
            let inner = if index <= steps { between } else { rest };
            *alpha = if index < 2 { end } else { inner };
        }
        planes.map(|plane| {
            let mut out = plane;
            for (value, alpha) in out.iter_mut().zip(&alphas) {
                *value *= alpha;
            }
            out
        })
    }
}

impl PlaneFormat for Bc6h {
    #[inline(always)]
    fn planes(words: UVec4) -> Planes {
        let block = Self::parse(words);
        if block.index_bits == 0 {
            return [[0.0; TEXELS]; 3];
        }
        let weights = weights(words, block.index_start, block.index_bits, [0, block.anchor, TEXELS as u32]);
        let ends = [(block.low, block.high), (block.second_low, block.second_high)];
        let channel = |of: fn(UVec3) -> u32| {
            let [first, second] = ends.map(|(a, b)| (of(a), of(b)));
            let mut out = [0.0f32; TEXELS];
            for (k, value) in out.iter_mut().enumerate() {
                let is_second = block.second >> k & 1 == 1;
                let a = if is_second { second.0 } else { first.0 };
                let b = if is_second { second.1 } else { first.1 };
                let mixed = (a * (64 - weights[k]) + b * weights[k] + 32) >> 6;
                *value = widen((mixed * 31) >> 6);
            }
            out
        };
        [channel(|v| v.x), channel(|v| v.y), channel(|v| v.z)]
    }
}

/// A half that is not negative to single precision, without a branch.
#[inline(always)]
fn widen(half: u32) -> f32 {
    let shifted = half << 13;
    let subnormal = f32::from_bits(shifted + (113 << 23)) - f32::from_bits(113 << 23);
    let normal = f32::from_bits(shifted + (112 << 23));
    if shifted < 1 << 23 { subnormal } else { normal }
}

impl PlaneFormat for Bc7 {
    #[inline(always)]
    fn planes(words: UVec4) -> Planes {
        let block = Self::parse(words);
        if block.index_bits == 0 || block.second_bits > 0 {
            return texel_by_texel::<Self>(words, Vec4::truncate);
        }
        let second = block.anchor.min(block.third_anchor);
        let third = block.anchor.max(block.third_anchor);
        let weights = weights(words, block.index_start, block.index_bits, [0, second, third]);
        let ends =
            [(block.low, block.high), (block.second_low, block.second_high), (block.third_low, block.third_high)];
        let channel = |of: fn(UVec4) -> u32| {
            mix(ends.map(|(a, b)| (of(a), of(b))), block.subset, &weights).map(|v| v as f32 * (1.0 / 255.0))
        };
        [channel(|v| v.x), channel(|v| v.y), channel(|v| v.z)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::sampling::hash3;

    /// Greatest difference from the kernels' decoder over random blocks, whose lowest bits `low` gives.
    fn difference<F: PlaneFormat>(low: impl Fn(u32) -> (u32, u32), value: impl Fn(Vec4) -> Vec3 + Copy) -> f32 {
        let mut worst = 0.0f32;
        for k in 0..20_000u32 {
            let mut words = UVec4::from_array([0, 1, 2, 3].map(|word| hash3(k, word, 9)));
            let (bits, count) = low(k);
            words.x = words.x >> count << count | bits;
            let expected = texel_by_texel::<F>(words, value);
            for (a, b) in F::planes(words).iter().flatten().zip(expected.iter().flatten()) {
                worst = worst.max((a - b).abs());
            }
        }
        worst
    }

    #[test]
    fn planes_hold_what_the_kernels_decode() {
        assert_eq!(
            difference::<Bc6h>(
                |k| if k % 3 < 2 { (k % 3, 2) } else { (k / 6 % 8 * 4 + 2 + k / 3 % 2, 5) },
                Vec4::truncate
            ),
            0.0
        );
        assert_eq!(difference::<Bc7>(|k| (1 << (k % 9) & 255, k % 9 + 1), Vec4::truncate), 0.0);
        // The end of a line is reached by an addition here, by a choice there: they differ by a rounding.
        assert!(difference::<Bc1>(|_| (0, 0), Vec4::truncate) < 2e-7);
        assert!(difference::<Bc3>(|_| (0, 0), |texel| texel.truncate() * texel.w) < 2e-7);
        assert!(difference::<Bc3>(|_| (0, 0), Vec4::truncate) > 0.1);
    }
}
