//! BC6H, unsigned, all 14 modes; bit for bit as Direct3D 11.3, 19.5.14 and the Khronos Data Format 1.3, 20.2.

use glam::{UVec3, UVec4, Vec4};

use super::words::{TWO_SUBSETS, bits, mix, weight};
use super::{BlockFormat, widen_half};

/// Bit at `position`, as bit `shift`; position 0 (which belongs to the mode) stands for a bit that is not there.
#[inline]
fn bit(w: UVec4, position: u32, shift: u32) -> u32 {
    if position == 0 { 0 } else { bits(w, position, 1) << shift }
}

/// Positions of the scattered bits of the endpoints w, x, y, z of the modes with two subsets, a byte each, lowest
/// first: `[gy4 gy5 gz4 gz5, by4 by5 bz4 bz5, bz0 bz1 bz2 bz3, rw10 gw10 bw10]`, and the widths: base, red, green, blue
/// difference.
const SCATTERED: [[u32; 5]; 10] = [
    [0x0028_0002, 0x0004_0003, 0x4c46_3c32, 0, 0x0505_050a],
    [0x0403_0218, 0x2122_160e, 0x2017_0d0c, 0, 0x0606_0607],
    [0, 0, 0x4c46_3c32, 0x003b_3128, 0x0404_050b],
    [0x0028_004b, 0, 0x4c46_3c45, 0x003b_3227, 0x0405_040b],
    [0, 0x004b_0028, 0x4c46_4532, 0x003c_3127, 0x0504_040b],
    [0x0028_0018, 0x0022_000e, 0x4c46_3c32, 0, 0x0505_0509],
    [0x000d_0018, 0x0022_000e, 0x2117_3c32, 0, 0x0505_0608],
    [0x2128_1718, 0x0022_000e, 0x4c46_3c0d, 0, 0x0506_0508],
    [0x0028_0018, 0x2122_170e, 0x4c46_0d32, 0, 0x0605_0508],
    [0x1f0b_1518, 0x2122_160e, 0x2017_0d0c, 0, 0x0606_0606],
];

/// The mode without differences among those of [`SCATTERED`].
const PLAIN: u32 = 9;

/// Byte `k` of a word.
#[inline]
fn byte(word: u32, k: u32) -> u32 {
    word >> (8 * k) & 255
}

/// `base + difference` in `width` bits, the difference being a signed number of `count` bits.
#[inline]
fn add_difference(base: u32, difference: u32, count: u32, width: u32) -> u32 {
    let unused = 32 - count;
    let signed = ((difference << unused) as i32 >> unused) as u32;
    base.wrapping_add(signed) & ((1 << width) - 1)
}

/// An endpoint of `width` bits as 16 bits.
#[inline]
fn unquantize(value: u32, width: u32) -> u32 {
    if width >= 15 || value == 0 {
        value
    } else if value == (1 << width) - 1 {
        0xffff
    } else {
        ((value << 16) + 0x8000) >> width
    }
}

#[inline]
fn unquantize3(v: UVec3, width: u32) -> UVec3 {
    UVec3::new(unquantize(v.x, width), unquantize(v.y, width), unquantize(v.z, width))
}

#[inline]
fn add_differences(base: UVec3, v: UVec3, counts: UVec3, width: u32) -> UVec3 {
    UVec3::new(
        add_difference(base.x, v.x, counts.x, width),
        add_difference(base.y, v.y, counts.y, width),
        add_difference(base.z, v.z, counts.z, width),
    )
}

/// Endpoints of both subsets, 16 bits a channel, and where the indices are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfBlock {
    pub(crate) words: UVec4,
    pub(crate) low: UVec3,
    pub(crate) high: UVec3,
    pub(crate) second_low: UVec3,
    pub(crate) second_high: UVec3,
    /// Mask of the texels of the second subset.
    pub(crate) second: u32,
    /// Texel of the second subset whose index has a bit less; 16 where there is one subset.
    pub(crate) anchor: u32,
    /// Bits of an index; 0 in a reserved mode, whose texels are black.
    pub(crate) index_bits: u32,
    pub(crate) index_start: u32,
}

/// BC6H: 16 bytes a block, three unsigned half-precision numbers a texel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bc6h;

/// Two subsets: a row of [`SCATTERED`].
#[inline]
fn parse_two(w: UVec4, mode: u32) -> HalfBlock {
    let layout = SCATTERED[mode as usize];
    let g = layout[0];
    let b = layout[1];
    let z = layout[2];
    let top = layout[3];
    let widths = layout[4];
    let width = byte(widths, 0);
    let low_bits = if width < 10 { width } else { 10 };
    let counts = UVec3::new(byte(widths, 1), byte(widths, 2), byte(widths, 3));
    let base = UVec3::new(
        bits(w, 5, low_bits) | bit(w, byte(top, 0), 10),
        bits(w, 15, low_bits) | bit(w, byte(top, 1), 10),
        bits(w, 25, low_bits) | bit(w, byte(top, 2), 10),
    );
    let x = UVec3::new(bits(w, 35, counts.x), bits(w, 45, counts.y), bits(w, 55, counts.z));
    let y = UVec3::new(
        bits(w, 65, counts.x),
        bits(w, 41, 4) | bit(w, byte(g, 0), 4) | bit(w, byte(g, 1), 5),
        bits(w, 61, 4) | bit(w, byte(b, 0), 4) | bit(w, byte(b, 1), 5),
    );
    let z = UVec3::new(
        bits(w, 71, counts.x),
        bits(w, 51, 4) | bit(w, byte(g, 2), 4) | bit(w, byte(g, 3), 5),
        bit(w, byte(z, 0), 0)
            | bit(w, byte(z, 1), 1)
            | bit(w, byte(z, 2), 2)
            | bit(w, byte(z, 3), 3)
            | bit(w, byte(b, 2), 4)
            | bit(w, byte(b, 3), 5),
    );
    let (high, second_low, second_high) = if mode == PLAIN {
        (x, y, z)
    } else {
        (
            add_differences(base, x, counts, width),
            add_differences(base, y, counts, width),
            add_differences(base, z, counts, width),
        )
    };
    let subsets = TWO_SUBSETS[bits(w, 77, 5) as usize];
    HalfBlock {
        words: w,
        low: unquantize3(base, width),
        high: unquantize3(high, width),
        second_low: unquantize3(second_low, width),
        second_high: unquantize3(second_high, width),
        second: subsets & 0xffff,
        anchor: subsets >> 16,
        index_bits: 3,
        index_start: 82,
    }
}

/// One subset; `width` bits a base of which all above the tenth are stored in reverse, `count` bits a difference.
#[inline]
fn parse_one(w: UVec4, width: u32, count: u32) -> HalfBlock {
    let more = width - 10;
    let top = |start: u32| if more == 0 { 0 } else { bits(w, start, more).reverse_bits() >> (32 - more) << 10 };
    let base = UVec3::new(
        bits(w, 5, 10) | top(35 + count),
        bits(w, 15, 10) | top(45 + count),
        bits(w, 25, 10) | top(55 + count),
    );
    let x = UVec3::new(bits(w, 35, count), bits(w, 45, count), bits(w, 55, count));
    let high = if more == 0 { x } else { add_differences(base, x, UVec3::new(count, count, count), width) };
    let low = unquantize3(base, width);
    let high = unquantize3(high, width);
    HalfBlock {
        words: w,
        low,
        high,
        second_low: low,
        second_high: high,
        second: 0,
        anchor: 16,
        index_bits: 4,
        index_start: 65,
    }
}

impl BlockFormat for Bc6h {
    type Block = HalfBlock;

    #[inline]
    fn parse(w: UVec4) -> HalfBlock {
        let mode = if w.x & 2 == 0 { w.x & 1 } else { w.x & 31 };
        // Two low bits 10: two subsets, 11: one subset; what is above counts the modes.
        if w.x & 2 == 0 {
            parse_two(w, mode)
        } else if mode & 1 == 0 {
            parse_two(w, 2 + (mode >> 2))
        } else if mode == 3 {
            parse_one(w, 10, 10)
        } else if mode == 7 {
            parse_one(w, 11, 9)
        } else if mode == 11 {
            parse_one(w, 12, 8)
        } else if mode == 15 {
            parse_one(w, 16, 4)
        } else {
            HalfBlock { index_bits: 0, ..parse_one(w, 10, 10) }
        }
    }

    #[inline]
    fn texel(block: HalfBlock, k: u32) -> Vec4 {
        if block.index_bits == 0 {
            return Vec4::new(0.0, 0.0, 0.0, 1.0);
        }
        let n = block.index_bits;
        // The anchors (texel 0, and one of the second subset) have a bit less.
        let before = u32::from(k > 0) + u32::from(k > block.anchor);
        let is_anchor = u32::from(k == 0) + u32::from(k == block.anchor);
        let index = bits(block.words, block.index_start + k * n - before, n - is_anchor);
        let w = weight(index, n);
        let is_second = block.second >> k & 1 == 1;
        let low = if is_second { block.second_low } else { block.low };
        let high = if is_second { block.second_high } else { block.high };
        Vec4::new(
            widen_half((mix(low.x, high.x, w) * 31) >> 6),
            widen_half((mix(low.y, high.y, w) * 31) >> 6),
            widen_half((mix(low.z, high.z, w) * 31) >> 6),
            1.0,
        )
    }
}
