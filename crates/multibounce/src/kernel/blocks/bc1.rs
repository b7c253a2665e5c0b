//! BC1 and BC3 with the exact palette of the specification (Direct3D 11.3, 19.5; Khronos Data Format 1.3, 18):
//! endpoints of 5, 6 and 5 bits as fractions, thirds between them without rounding. Texture units round each colour to
//! 8 or so bits: up to 1.7/255 off.

use glam::{UVec4, Vec3, Vec4};

use super::BlockFormat;

/// Colours of 5, 6 and 5 bits, red highest.
#[inline]
fn unpack_565(c: u32) -> Vec3 {
    Vec3::new((c >> 11 & 31) as f32 * (1.0 / 31.0), (c >> 5 & 63) as f32 * (1.0 / 63.0), (c & 31) as f32 * (1.0 / 31.0))
}

/// Endpoints and indices of a block of colours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColorBlock {
    low: Vec3,
    high: Vec3,
    /// 1 where the palette is two colours, their mean and black; 0 where it is four colours on a line.
    has_black: u32,
    indices: u32,
}

impl ColorBlock {
    /// `opaque` (BC3) always has four colours on a line.
    #[inline]
    fn parse(ends: u32, indices: u32, opaque: bool) -> Self {
        let a = ends & 0xffff;
        let b = ends >> 16;
        let has_black = if opaque || a > b { 0 } else { 1 };
        Self { low: unpack_565(a), high: unpack_565(b), has_black, indices }
    }

    #[inline]
    fn texel(self, k: u32) -> Vec3 {
        let index = self.indices >> (2 * k) & 3;
        if index == 0 {
            self.low
        } else if index == 1 {
            self.high
        } else if self.has_black == 0 {
            let w = if index == 2 { 1.0 / 3.0 } else { 2.0 / 3.0 };
            self.low + (self.high - self.low) * w
        } else if index == 2 {
            (self.low + self.high) * 0.5
        } else {
            Vec3::ZERO
        }
    }
}

/// BC1: 8 bytes a block, two colours of 16 bits, four colours on the line between them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bc1;

impl BlockFormat for Bc1 {
    type Block = ColorBlock;

    #[inline]
    fn parse(words: UVec4) -> ColorBlock {
        ColorBlock::parse(words.x, words.y, false)
    }

    #[inline]
    fn texel(block: ColorBlock, k: u32) -> Vec4 {
        block.texel(k).extend(1.0)
    }
}

/// A block of BC3: colours, and alpha with eight values a block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlphaColorBlock {
    color: ColorBlock,
    /// First and second alpha in the lowest bytes, the first 16 bits of the indices above.
    alpha: u32,
    /// The other 32 bits of the indices.
    indices: u32,
}

/// BC3: 16 bytes a block, BC1 colours and an alpha of two 8-bit endpoints and 3-bit indices.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bc3;

impl BlockFormat for Bc3 {
    type Block = AlphaColorBlock;

    #[inline]
    fn parse(words: UVec4) -> AlphaColorBlock {
        AlphaColorBlock { color: ColorBlock::parse(words.z, words.w, true), alpha: words.x, indices: words.y }
    }

    #[inline]
    fn texel(block: AlphaColorBlock, k: u32) -> Vec4 {
        let bits = super::words::bits(UVec4::new(block.alpha, block.indices, 0, 0), 16 + 3 * k, 3);
        let a = block.alpha & 255;
        let b = block.alpha >> 8 & 255;
        let fa = a as f32 * (1.0 / 255.0);
        let fb = b as f32 * (1.0 / 255.0);
        let alpha = if bits == 0 {
            fa
        } else if bits == 1 {
            fb
        } else if a > b {
            fa + (fb - fa) * ((bits - 1) as f32 * (1.0 / 7.0))
        } else if bits == 6 {
            0.0
        } else if bits == 7 {
            1.0
        } else {
            fa + (fb - fa) * ((bits - 1) as f32 * (1.0 / 5.0))
        };
        block.color.texel(k).extend(alpha)
    }
}
