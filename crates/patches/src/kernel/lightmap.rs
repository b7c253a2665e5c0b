//! Values between texels.

use glam::{Vec2, Vec4};
use scene::NONE;
use scene::math::floor;

use crate::types::LightmapParams;

/// Irradiance at a texture coordinate of a lightmap, W/m²: bilinear between the middles of the four texels round it,
/// those that belong to no receiver left out and the weights renormalised; zero where there are none.
///
/// Shapes: `texels[width · height]`, the receiver of each or [`NONE`]; `values` one a receiver; `uv` in [0, 1]².
#[inline]
pub fn lightmap_lookup(p: &LightmapParams, texels: &[u32], values: &[Vec4], uv: Vec2) -> Vec4 {
    let width = p.width as f32;
    let height = p.height as f32;
    let place = Vec2::new(uv.x * width - 0.5, uv.y * height - 0.5);
    let low = Vec2::new(floor(place.x), floor(place.y));
    let share = place - low;
    let mut sum = Vec4::ZERO;
    let mut total = 0.0;
    for corner in 0..4u32 {
        let step = Vec2::new((corner & 1) as f32, (corner >> 1) as f32);
        let c = low + step;
        if c.x >= 0.0 && c.y >= 0.0 && c.x < width && c.y < height {
            let receiver = texels[(c.x as u32 + p.width * c.y as u32) as usize];
            if receiver != NONE {
                let t = (Vec2::ONE - step) * (Vec2::ONE - share) + step * share;
                let weight = t.x * t.y;
                sum += values[receiver as usize] * weight;
                total += weight;
            }
        }
    }
    if total > 0.0 { sum * (1.0 / total) } else { Vec4::ZERO }
}
