//! Picking directions of an equirectangular sky in proportion to its light.

use std::f32::consts::PI;

use glam::Vec3;
use scene::Lights;
use scene::math::{acos, atan2, luminance, sin_cos_2pi};

/// Distribution over the texels of a sky map: luminance, averaged over 3 × 3 texels so that it is positive wherever the
/// bilinear value is, times the solid angle.
pub(crate) struct SkyDistribution {
    width: usize,
    height: usize,
    /// Cumulative share of the rows, `[height]`, the last exactly 1.
    rows: Vec<f32>,
    /// Cumulative share of the texels within their row, `[height · width]`.
    columns: Vec<f32>,
}

impl SkyDistribution {
    /// `None` without a map, or with a black one.
    pub(crate) fn new(lights: &Lights) -> Option<Self> {
        let width = lights.sky.map_width as usize;
        let height = lights.sky.map_height as usize;
        if width == 0 || height == 0 {
            return None;
        }
        let light =
            |x: usize, y: usize| f64::from(luminance(lights.sky.radiance * lights.sky_map[y * width + x].truncate()));
        let mut rows = Vec::with_capacity(height);
        let mut columns = Vec::with_capacity(width * height);
        let mut total = 0.0f64;
        for y in 0..height {
            let up = y.saturating_sub(1);
            let down = (y + 1).min(height - 1);
            let mut sum = 0.0f64;
            let mut sums = Vec::with_capacity(width);
            for x in 0..width {
                let left = (x + width - 1) % width;
                let right = (x + 1) % width;
                for v in [up, y, down] {
                    for u in [left, x, right] {
                        sum += light(u, v).max(0.0);
                    }
                }
                sums.push(sum);
            }
            columns.extend(normalised(&sums));
            let angle = std::f64::consts::PI * (y as f64 + 0.5) / height as f64;
            total += sum * angle.sin();
            rows.push(total);
        }
        (total > 0.0).then(|| Self { width, height, rows: normalised(&rows).collect(), columns })
    }

    /// A direction and its density per steradian.
    pub(crate) fn sample(&self, u: (f32, f32)) -> (Vec3, f32) {
        let (row, row_share, fy) = pick(&self.rows, u.1);
        let (column, share, fx) = pick(&self.columns[row * self.width..(row + 1) * self.width], u.0);
        let (s, c) = sin_cos_2pi((column as f32 + fx) / self.width as f32);
        let (sin, cos) = sin_cos_2pi(0.5 * (row as f32 + fy) / self.height as f32);
        // The map's middle column is −z: half a circle more changes both signs.
        (Vec3::new(-sin * s, cos, sin * c), self.density_of(row_share * share, sin))
    }

    /// Density of a unit direction per steradian.
    pub(crate) fn density(&self, direction: Vec3) -> f32 {
        let x = (0.5 + atan2(direction.x, -direction.z) * (0.5 / PI)) * self.width as f32;
        let y = acos(direction.y) * (1.0 / PI) * self.height as f32;
        let column = (x as usize).min(self.width - 1);
        let row = (y as usize).min(self.height - 1);
        let columns = &self.columns[row * self.width..(row + 1) * self.width];
        let sin = (1.0 - direction.y * direction.y).max(0.0).sqrt();
        self.density_of(share(&self.rows, row) * share(columns, column), sin)
    }

    fn density_of(&self, share: f32, sin: f32) -> f32 {
        share * (self.width * self.height) as f32 / (2.0 * PI * PI * sin.max(1e-6))
    }
}

/// Cumulative sums divided by the last, which becomes exactly 1; equal shares when all are 0.
fn normalised(sums: &[f64]) -> impl Iterator<Item = f32> + '_ {
    let last = sums[sums.len() - 1];
    let count = sums.len();
    sums.iter().enumerate().map(move |(k, s)| match last > 0.0 {
        _ if k + 1 == count => 1.0,
        true => (s / last) as f32,
        false => (k + 1) as f32 / count as f32,
    })
}

fn share(cumulative: &[f32], k: usize) -> f32 {
    cumulative[k] - if k == 0 { 0.0 } else { cumulative[k - 1] }
}

/// Entry that holds `x`, its share, and the position of `x` within it.
fn pick(cumulative: &[f32], x: f32) -> (usize, f32, f32) {
    let k = cumulative.partition_point(|c| *c <= x).min(cumulative.len() - 1);
    let share = share(cumulative, k);
    let start = cumulative[k] - share;
    (k, share, ((x - start) / share.max(f32::MIN_POSITIVE)).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use glam::Vec4;
    use scene::Sky;
    use scene::sampling::hammersley;

    use super::*;

    fn map() -> Vec<Vec4> {
        (0..16 * 8).map(|k| Vec4::splat(if k == 37 { 40.0 } else { (k % 5) as f32 * 0.1 })).collect()
    }

    #[test]
    fn samples_have_their_density_and_it_integrates_to_one() {
        let map = map();
        let sky = Sky { radiance: Vec3::ONE, map_width: 16, map_height: 8, ..Sky::default() };
        let lights = Lights { lights: &[], emitters: &[], sky, sky_map: &map, distributions: &[] };
        let distribution = SkyDistribution::new(&lights).expect("the map is not black");
        let count = 1 << 16;
        let mut sphere = 0.0f64;
        let mut differing = 0u32;
        for k in 0..count {
            let (direction, density) = distribution.sample(hammersley(k, count, (0, 0)));
            assert!((direction.length() - 1.0).abs() < 1e-5);
            if (distribution.density(direction) / density - 1.0).abs() > 1e-2 {
                differing += 1;
            }
            sphere += 1.0 / f64::from(density) / f64::from(count);
        }
        // ∫ 1 dω = 4π. A sample on the border of two texels may round into the neighbour, hardly any does.
        assert!((sphere / (4.0 * std::f64::consts::PI) - 1.0).abs() < 0.01, "{sphere}");
        assert!(differing < count / 1000, "{differing}");
    }

    #[test]
    fn a_black_map_has_no_distribution() {
        let sky = Sky { radiance: Vec3::ONE, map_width: 2, map_height: 2, ..Sky::default() };
        let map = [Vec4::ZERO; 4];
        assert!(
            SkyDistribution::new(&Lights { lights: &[], emitters: &[], sky, sky_map: &map, distributions: &[] })
                .is_none()
        );
    }
}
