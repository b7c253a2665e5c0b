//! How the rays of a frame enter the texels of probes (Majercik et al. 2019, section 4.3; 2021, section 4).

use std::f32::consts::PI;

use glam::{Vec2, Vec3};
use scene::math::pow;

use super::octahedral::{fill_border, place, texel_direction};
use super::{IRRADIANCE_EDGE, VISIBILITY_EDGE};

/// Rays of less weight in a texel are left out: together they weigh less than rounding of 16 bits.
const LEAST_WEIGHT: f32 = 1e-6;
/// Changes of a texel over its value, encoded, that make it forget faster, or all.
const CHANGE: f32 = 0.25;
const NEW_LIGHT: f32 = 0.8;
/// How much of the hysteresis the first takes.
const FORGET: f32 = 0.15;

/// What a ray from a probe brought.
#[derive(Clone, Copy, Debug, Default)]
pub struct ProbeRay {
    /// W/m²/sr.
    pub radiance: Vec3,
    /// m; `None` of the radiance counts where it is negative: the back of a surface.
    pub distance: f32,
}

/// Weights of the rays of a frame in all texels, the same for all probes.
pub struct Weights {
    irradiance: Lists,
    visibility: Lists,
}

/// A list of (ray, weight) for each texel.
struct Lists {
    start: Vec<usize>,
    entries: Vec<(u32, f32)>,
}

impl Lists {
    fn new(directions: &[Vec3], edge: usize, weight: impl Fn(f32) -> f32) -> Self {
        let mut lists = Self { start: vec![0], entries: Vec::new() };
        for texel in 0..edge * edge {
            let normal = texel_direction(texel % edge, texel / edge, edge);
            for (direction, ray) in directions.iter().zip(0..) {
                let weight = weight(normal.dot(*direction).max(0.0));
                if weight > LEAST_WEIGHT {
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
}

impl Weights {
    /// Of rays in these unit directions: cosine for irradiance, its power for visibility.
    pub fn new(directions: &[Vec3], exponent: f32) -> Self {
        Self {
            irradiance: Lists::new(directions, IRRADIANCE_EDGE, |cosine| cosine),
            visibility: Lists::new(directions, VISIBILITY_EDGE, |cosine| pow(cosine, exponent)),
        }
    }

    /// Blends rays into the irradiance of a probe: π times the cosine-weighted mean of their radiance, raised to 1 over `encoding`.
    pub fn blend_irradiance(&self, rays: &[ProbeRay], hysteresis: f32, encoding: f32, texels: &mut [Vec3]) {
        for texel in 0..IRRADIANCE_EDGE * IRRADIANCE_EDGE {
            let (mut sum, mut total) = (Vec3::ZERO, 0.0);
            for &(ray, weight) in self.irradiance.of(texel) {
                let ray = &rays[ray as usize];
                // Backs are inside of things, where light is not.
                if ray.distance >= 0.0 {
                    sum += ray.radiance * weight;
                    total += weight;
                }
            }
            if total <= 0.0 {
                continue;
            }
            let new = (sum * (PI / total)).to_array().map(|h| pow(h, 1.0 / encoding)).into();
            let old = &mut texels[place(texel % IRRADIANCE_EDGE, texel / IRRADIANCE_EDGE, IRRADIANCE_EDGE)];
            *old = old.lerp(new, 1.0 - texel_hysteresis(*old, new, hysteresis));
        }
        fill_border(texels, IRRADIANCE_EDGE);
    }

    /// Blends distances (no more than `most`, m) and their squares into the visibility of a probe.
    pub fn blend_visibility(&self, rays: &[ProbeRay], most: f32, hysteresis: f32, texels: &mut [Vec2]) {
        for texel in 0..VISIBILITY_EDGE * VISIBILITY_EDGE {
            let (mut sum, mut total) = (Vec2::ZERO, 0.0);
            for &(ray, weight) in self.visibility.of(texel) {
                let distance = rays[ray as usize].distance.abs().min(most);
                sum += Vec2::new(distance, distance * distance) * weight;
                total += weight;
            }
            if total > 0.0 {
                let old = &mut texels[place(texel % VISIBILITY_EDGE, texel / VISIBILITY_EDGE, VISIBILITY_EDGE)];
                *old = old.lerp(sum / total, 1.0 - hysteresis);
            }
        }
        fill_border(texels, VISIBILITY_EDGE);
    }
}

/// A texel that changes much forgets faster.
fn texel_hysteresis(old: Vec3, new: Vec3, hysteresis: f32) -> f32 {
    let greatest = old.max_element().max(new.max_element());
    let change = (new - old).abs().max_element();
    if change > NEW_LIGHT * greatest {
        0.0
    } else if change > CHANGE * greatest {
        (hysteresis - FORGET).max(0.0)
    } else {
        hysteresis
    }
}
