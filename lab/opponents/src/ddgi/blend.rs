//! Blending on the host: rays of no weight in a texel are left out of lists, and inner texels are found once. The same
//! bits as the kernels, for what is left out adds nothing.

use ::ddgi::kernel::blend::{mixed_irradiance, mixed_visibility, moments, weight};
use ::ddgi::kernel::octahedral::inner_texel;
use ::ddgi::{BlendParams, IRRADIANCE_EDGE, ProbeRay, RAY_WEIGHTS, VISIBILITY_EDGE, WeightParams};
use glam::{Vec2, Vec3};
use scene::Rgb;

/// Texels without borders.
const IRRADIANCE_INNER: usize = (IRRADIANCE_EDGE * IRRADIANCE_EDGE) as usize;
const VISIBILITY_INNER: usize = (VISIBILITY_EDGE * VISIBILITY_EDGE) as usize;

/// Weights of the rays of a frame in all texels, the same for all probes: a list of (ray, weight) for each texel.
pub struct Weights {
    start: Vec<usize>,
    entries: Vec<(u32, f32)>,
}

impl Weights {
    /// Weights of rays in these unit directions.
    pub fn new(directions: &[Vec3], exponent: u32) -> Self {
        let rays = directions.len() as u32;
        let p = WeightParams { count: RAY_WEIGHTS * rays, rays, exponent };
        let mut lists = Self { start: vec![0], entries: Vec::new() };
        for texel in 0..RAY_WEIGHTS {
            for (direction, ray) in directions.iter().zip(0..) {
                let weight = weight(&p, texel, *direction);
                if weight > 0.0 {
                    lists.entries.push((ray, weight));
                }
            }
            lists.start.push(lists.entries.len());
        }
        lists
    }

    fn of(&self, texel: usize) -> &[(u32, f32)] {
        &self.entries[self.start[texel]..self.start[texel + 1]]
    }

    /// Blends rays into the irradiance of a probe, with its border.
    pub fn blend_irradiance(&self, rays: &[ProbeRay], p: &BlendParams, texels: &mut [Rgb]) {
        let mut inner = [Vec3::ZERO; IRRADIANCE_INNER];
        for (texel, value) in inner.iter_mut().enumerate() {
            let mut sum = Vec3::ZERO;
            let mut total = 0.0;
            for &(ray, weight) in self.of(texel) {
                let ray = &rays[ray as usize];
                // Backs are inside of things, where light is not.
                if ray.distance >= 0.0 {
                    sum += ray.radiance * weight;
                    total += weight;
                }
            }
            let old = texels[stored_place(texel, IRRADIANCE_EDGE)].truncate();
            *value = mixed_irradiance(old, sum, total, p.hysteresis, p.encoding);
        }
        fill(texels, IRRADIANCE_EDGE, |texel| inner[texel].extend(0.0));
    }

    /// Blends distances and their squares into the visibility of a probe, with its border.
    pub fn blend_visibility(&self, rays: &[ProbeRay], p: &BlendParams, texels: &mut [Vec2]) {
        let mut inner = [Vec2::ZERO; VISIBILITY_INNER];
        for (texel, value) in inner.iter_mut().enumerate() {
            let mut sum = Vec2::ZERO;
            let mut total = 0.0;
            for &(ray, weight) in self.of(IRRADIANCE_INNER + texel) {
                sum += moments(rays[ray as usize].distance, p.most) * weight;
                total += weight;
            }
            *value = mixed_visibility(texels[stored_place(texel, VISIBILITY_EDGE)], sum, total, p.hysteresis);
        }
        fill(texels, VISIBILITY_EDGE, |texel| inner[texel]);
    }
}

/// Place among the stored texels of one without border.
fn stored_place(texel: usize, edge: u32) -> usize {
    let edge = edge as usize;
    (texel / edge + 1) * (edge + 2) + texel % edge + 1
}

/// All stored texels from those without border.
fn fill<T>(texels: &mut [T], edge: u32, inner: impl Fn(usize) -> T) {
    for (k, texel) in (0..).zip(texels) {
        let (x, y) = inner_texel(k, edge);
        *texel = inner((y * edge + x) as usize);
    }
}
