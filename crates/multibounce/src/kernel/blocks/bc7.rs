//! BC7, all 8 modes; bit for bit as Direct3D 11.3, 19.5.13 and the Khronos Data Format 1.3, 20.1.

use glam::{UVec4, Vec4};

use super::BlockFormat;
use super::words::{THREE_ANCHORS, THREE_SUBSETS, TWO_SUBSETS, bits, mix, weight};

/// Fields of each mode, four bits each, lowest first: subsets, bits of the partition, of a colour, of an alpha, low
/// bits of the endpoints (1: one for each, 2: one for each subset), bits of an index, of a second index, of rotation
/// and selection.
const MODES: [u32; 8] =
    [0x0031_0443, 0x0032_0662, 0x0020_0563, 0x0021_0762, 0x3320_6501, 0x2220_8701, 0x0041_7701, 0x0021_5562];

/// Bit positions in a block.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Header {
    subsets: u32,
    partition: u32,
    rotation: u32,
    selection: u32,
    color_bits: u32,
    alpha_bits: u32,
    low_bits: u32,
    /// First bit of the endpoints.
    ends: u32,
}

/// Endpoints of up to three subsets, 8 bits a channel, and where the indices are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ByteBlock {
    pub(crate) words: UVec4,
    pub(crate) low: UVec4,
    pub(crate) high: UVec4,
    pub(crate) second_low: UVec4,
    pub(crate) second_high: UVec4,
    pub(crate) third_low: UVec4,
    pub(crate) third_high: UVec4,
    /// Subset of each texel, two bits a texel.
    pub(crate) subset: u32,
    /// Texels of the second and third subset whose indices have a bit less; 16 where there is none.
    pub(crate) anchor: u32,
    pub(crate) third_anchor: u32,
    pub(crate) rotation: u32,
    /// 1 where colours take the second index.
    pub(crate) selection: u32,
    /// Bits of an index; 0 in the reserved mode, whose texels are 0.
    pub(crate) index_bits: u32,
    pub(crate) second_bits: u32,
    pub(crate) index_start: u32,
    pub(crate) second_start: u32,
}

/// BC7: 16 bytes a block, four 8-bit channels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bc7;

/// `count` bits, and `low` below them where `low < 2`, as 8 bits.
#[inline]
fn widen(value: u32, count: u32, low: u32) -> u32 {
    let n = if low < 2 { count + 1 } else { count };
    let v = (if low < 2 { value << 1 | low } else { value }) << (8 - n);
    v | v >> n
}

/// Endpoint `e` of all those of the block.
#[inline]
fn endpoint(w: UVec4, h: Header, e: u32) -> UVec4 {
    let ends = 2 * h.subsets;
    let alphas = h.ends + 3 * ends * h.color_bits;
    let lows = alphas + ends * h.alpha_bits;
    let low = if h.low_bits == 0 {
        2
    } else if h.low_bits == 1 {
        bits(w, lows + e, 1)
    } else {
        bits(w, lows + (e >> 1), 1)
    };
    let n = h.color_bits;
    let color = |channel: u32| widen(bits(w, h.ends + (channel * ends + e) * n, n), n, low);
    let alpha = if h.alpha_bits == 0 {
        255
    } else {
        widen(bits(w, alphas + e * h.alpha_bits, h.alpha_bits), h.alpha_bits, low)
    };
    UVec4::new(color(0), color(1), color(2), alpha)
}

/// Two bits a texel from a mask of one bit a texel.
#[inline]
fn spread(mask: u32) -> u32 {
    let mut v = mask;
    v = (v | v << 8) & 0x00ff_00ff;
    v = (v | v << 4) & 0x0f0f_0f0f;
    v = (v | v << 2) & 0x3333_3333;
    (v | v << 1) & 0x5555_5555
}

impl BlockFormat for Bc7 {
    type Block = ByteBlock;

    #[inline]
    fn parse(w: UVec4) -> ByteBlock {
        let mode = (w.x | 256).trailing_zeros();
        let reserved = mode == 8;
        let layout = MODES[if reserved { 6 } else { mode } as usize];
        let field = |k: u32| layout >> (4 * k) & 15;
        let subsets = field(0);
        let partition_bits = field(1);
        let more = field(7);
        let start = mode + 1;
        let header = Header {
            subsets,
            partition: bits(w, start, partition_bits),
            rotation: if more > 0 { bits(w, start, 2) } else { 0 },
            selection: if more > 2 { bits(w, start + 2, 1) } else { 0 },
            color_bits: field(2),
            alpha_bits: field(3),
            low_bits: field(4),
            ends: start + partition_bits + more,
        };
        let low = endpoint(w, header, 0);
        let high = endpoint(w, header, 1);
        let mut second_low = low;
        let mut second_high = high;
        let mut third_low = low;
        let mut third_high = high;
        let mut subset = 0;
        let mut anchor = 16;
        let mut third_anchor = 16;
        if subsets > 1 {
            second_low = endpoint(w, header, 2);
            second_high = endpoint(w, header, 3);
        }
        if subsets == 2 {
            let two = TWO_SUBSETS[header.partition as usize];
            subset = spread(two & 0xffff);
            anchor = two >> 16;
        }
        if subsets == 3 {
            third_low = endpoint(w, header, 4);
            third_high = endpoint(w, header, 5);
            subset = THREE_SUBSETS[header.partition as usize];
            anchor = THREE_ANCHORS[header.partition as usize] & 15;
            third_anchor = THREE_ANCHORS[header.partition as usize] >> 4;
        }
        let lows = if header.low_bits == 1 {
            2 * subsets
        } else if header.low_bits == 2 {
            subsets
        } else {
            0
        };
        let index_bits = if reserved { 0 } else { field(5) };
        let index_start = header.ends + 2 * subsets * (3 * header.color_bits + header.alpha_bits) + lows;
        ByteBlock {
            words: w,
            low,
            high,
            second_low,
            second_high,
            third_low,
            third_high,
            subset,
            anchor,
            third_anchor,
            rotation: header.rotation,
            selection: header.selection,
            index_bits,
            second_bits: field(6),
            index_start,
            second_start: index_start + 16 * field(5) - 1,
        }
    }

    #[inline]
    fn texel(block: ByteBlock, k: u32) -> Vec4 {
        let n = block.index_bits;
        if n == 0 {
            return Vec4::ZERO;
        }
        let before = u32::from(k > 0) + u32::from(k > block.anchor) + u32::from(k > block.third_anchor);
        let is_anchor = u32::from(k == 0) + u32::from(k == block.anchor) + u32::from(k == block.third_anchor);
        let mut color = weight(bits(block.words, block.index_start + k * n - before, n - is_anchor), n);
        let mut alpha = color;
        if block.second_bits > 0 {
            let n = block.second_bits;
            let start = block.second_start + k * n - u32::from(k > 0);
            let second = weight(bits(block.words, start, n - u32::from(k == 0)), n);
            if block.selection == 1 {
                color = second;
            } else {
                alpha = second;
            }
        }
        let subset = block.subset >> (2 * k) & 3;
        let mut low = block.low;
        let mut high = block.high;
        if subset == 1 {
            low = block.second_low;
            high = block.second_high;
        } else if subset == 2 {
            low = block.third_low;
            high = block.third_high;
        }
        let r = mix(low.x, high.x, color) as f32;
        let g = mix(low.y, high.y, color) as f32;
        let b = mix(low.z, high.z, color) as f32;
        let a = mix(low.w, high.w, alpha) as f32;
        let v = if block.rotation == 0 {
            Vec4::new(r, g, b, a)
        } else if block.rotation == 1 {
            Vec4::new(a, g, b, r)
        } else if block.rotation == 2 {
            Vec4::new(r, a, b, g)
        } else {
            Vec4::new(r, g, a, b)
        };
        v * (1.0 / 255.0)
    }
}
