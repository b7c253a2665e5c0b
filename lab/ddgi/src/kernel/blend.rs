//! Blending of a frame's rays into the texels of probes (Majercik et al. 2019, section 4.3; 2021, section 4).

use core::f32::consts::PI;

use glam::{Vec2, Vec3};
use scene::Rgb;
use scene::math::abs;

use super::encoding::{power, root};
use super::octahedral::{inner_texel, texel_direction};
use crate::{
    BlendParams, IRRADIANCE_EDGE, IRRADIANCE_TEXELS, Probe, ProbeRay, RAY_WEIGHTS, VISIBILITY_EDGE, VISIBILITY_TEXELS,
    WeightParams,
};

/// Rays of less weight in a texel are left out: together they weigh less than rounding of 16 bits.
const MIN_WEIGHT: f32 = 1e-6;
/// Changes of a texel over its value, encoded, that make it forget faster, or all.
const CHANGE: f32 = 0.25;
const NEW_LIGHT: f32 = 0.8;
/// Share of the hysteresis in the first frame.
const FORGET: f32 = 0.15;
/// Texels of irradiance without border, before those of visibility among weights.
const IRRADIANCE_INNER: u32 = IRRADIANCE_EDGE * IRRADIANCE_EDGE;

/// Weight of a ray in a texel without border: the cosine for irradiance, its power for visibility; 0 where it does not
/// count.
#[inline]
pub fn weight(p: &WeightParams, texel: u32, direction: Vec3) -> f32 {
    let is_light = texel < IRRADIANCE_INNER;
    let edge = if is_light { IRRADIANCE_EDGE } else { VISIBILITY_EDGE };
    let inner = if is_light { texel } else { texel - IRRADIANCE_INNER };
    let cosine = texel_direction(inner % edge, inner / edge, edge).dot(direction);
    if cosine <= 0.0 {
        return 0.0;
    }
    let weight = if is_light { cosine } else { power(cosine, p.exponent) };
    if weight > MIN_WEIGHT { weight } else { 0.0 }
}

/// Irradiance of stored texel `k` of all probes after a frame, as its root. Shapes: `weights[rays · RAY_WEIGHTS]`,
/// those of a ray one after the other; `rays[probes · rays]`. Probes that are off stay as they are.
#[inline]
pub fn blend_irradiance(
    k: u32,
    p: &BlendParams,
    probes: &[Probe],
    weights: &[f32],
    rays: &[ProbeRay],
    old: Rgb,
) -> Rgb {
    let probe = k / IRRADIANCE_TEXELS;
    if probes[probe as usize].is_active == 0 {
        return old;
    }
    let (x, y) = inner_texel(k % IRRADIANCE_TEXELS, IRRADIANCE_EDGE);
    let texel = y * IRRADIANCE_EDGE + x;
    let mut sum = Vec3::ZERO;
    let mut total = 0.0;
    for number in 0..p.rays {
        let weight = weights[(number * RAY_WEIGHTS + texel) as usize];
        if weight > 0.0 {
            let ray = rays[(probe * p.rays + number) as usize];
            // Backs are inside of things, where light is not.
            if ray.distance >= 0.0 {
                sum += ray.radiance * weight;
                total += weight;
            }
        }
    }
    mixed_irradiance(old.truncate(), sum, total, p.hysteresis, p.encoding).extend(0.0)
}

/// Stored irradiance after rays with a sum of weights and of weighted radiance, W/m²/sr: π times their mean as its
/// root, and the old.
#[inline]
pub fn mixed_irradiance(old: Vec3, sum: Vec3, total: f32, hysteresis: f32, encoding: u32) -> Vec3 {
    if total <= 0.0 {
        return old;
    }
    let mean = sum * (PI / total);
    let new = Vec3::new(root(mean.x, encoding), root(mean.y, encoding), root(mean.z, encoding));
    old + (new - old) * (1.0 - texel_hysteresis(old, new, hysteresis))
}

/// Visibility of stored texel `k` of all probes after a frame: mean distance, m, and mean square. Shapes as those of
/// [`blend_irradiance`].
#[inline]
pub fn blend_visibility(
    k: u32,
    p: &BlendParams,
    probes: &[Probe],
    weights: &[f32],
    rays: &[ProbeRay],
    old: Vec2,
) -> Vec2 {
    let probe = k / VISIBILITY_TEXELS;
    if probes[probe as usize].is_active == 0 {
        return old;
    }
    let (x, y) = inner_texel(k % VISIBILITY_TEXELS, VISIBILITY_EDGE);
    let texel = IRRADIANCE_INNER + y * VISIBILITY_EDGE + x;
    let mut sum = Vec2::ZERO;
    let mut total = 0.0;
    for number in 0..p.rays {
        let weight = weights[(number * RAY_WEIGHTS + texel) as usize];
        if weight > 0.0 {
            sum += moments(rays[(probe * p.rays + number) as usize].distance, p.most) * weight;
            total += weight;
        }
    }
    mixed_visibility(old, sum, total, p.hysteresis)
}

/// [`ProbeRay::distance`] without its sign, m, no more than `most`, and its square.
#[inline]
pub fn moments(distance: f32, most: f32) -> Vec2 {
    let distance = abs(distance);
    let distance = if distance < most { distance } else { most };
    Vec2::new(distance, distance * distance)
}

/// Stored visibility after rays with a sum of weights and of weighted moments.
#[inline]
pub fn mixed_visibility(old: Vec2, sum: Vec2, total: f32, hysteresis: f32) -> Vec2 {
    if total > 0.0 { old + (sum / total - old) * (1.0 - hysteresis) } else { old }
}

/// A texel that changes much forgets faster.
#[inline]
fn texel_hysteresis(old: Vec3, new: Vec3, hysteresis: f32) -> f32 {
    let greatest = old.max(new).max_element();
    let change = (new - old).abs().max_element();
    if change > NEW_LIGHT * greatest {
        0.0
    } else if change > CHANGE * greatest {
        let less = hysteresis - FORGET;
        if less > 0.0 { less } else { 0.0 }
    } else {
        hysteresis
    }
}
