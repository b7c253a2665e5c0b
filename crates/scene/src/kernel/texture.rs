//! Texel fetches and bilinear filtering over the texel buffer.

use glam::{Vec2, Vec4};

use crate::gpu::Texture;
use crate::math::floor;

/// A texel: linear r, g, b and a in [0, 1]. `index` counts texels.
#[inline]
pub fn texel(texels: &[u32], index: u32) -> Vec4 {
    let rg = texels[2 * index as usize];
    let ba = texels[2 * index as usize + 1];
    Vec4::new((rg & 0xffff) as f32, (rg >> 16) as f32, (ba & 0xffff) as f32, (ba >> 16) as f32) * (1.0 / 65_535.0)
}

/// Bilinear, repeating sample of one level (clamped to the last); v = 0 is the bottom of the picture.
#[inline]
pub fn sample(texture: Texture, texels: &[u32], uv: Vec2, level: u32) -> Vec4 {
    let level = if level < texture.levels { level } else { texture.levels - 1 };
    let mut width = texture.width;
    let mut height = texture.height;
    let mut offset = texture.offset;
    for _ in 0..level {
        offset += width * height;
        width = if width > 1 { width >> 1 } else { 1 };
        height = if height > 1 { height >> 1 } else { 1 };
    }
    let x = (uv.x - floor(uv.x)) * width as f32 - 0.5;
    let y = (1.0 - (uv.y - floor(uv.y))) * height as f32 - 0.5;
    let x_floor = floor(x);
    let y_floor = floor(y);
    let fx = x - x_floor;
    let fy = y - y_floor;
    let x0 = wrap(x_floor as i32, width);
    let x1 = wrap(x_floor as i32 + 1, width);
    let y0 = wrap(y_floor as i32, height);
    let y1 = wrap(y_floor as i32 + 1, height);
    let top = texel(texels, offset + y0 * width + x0) * (1.0 - fx) + texel(texels, offset + y0 * width + x1) * fx;
    let bottom = texel(texels, offset + y1 * width + x0) * (1.0 - fx) + texel(texels, offset + y1 * width + x1) * fx;
    top * (1.0 - fy) + bottom * fy
}

/// Column or row −1 … size onto 0 … size − 1.
#[inline]
fn wrap(x: i32, size: u32) -> u32 {
    if x < 0 {
        size - 1
    } else if x as u32 >= size {
        0
    } else {
        x as u32
    }
}
