//! Irradiance at a point, from the probes round it (Majercik et al. 2019, section 4.4; 2021, section 3).

use glam::{UVec3, Vec2, Vec3};
use scene::Rgb;
use scene::math::sqrt;

use super::encoding::half_power;
use super::octahedral::sample;
use crate::{IRRADIANCE_EDGE, IRRADIANCE_TEXELS, LookupParams, LookupPoint, Probe, VISIBILITY_EDGE, VISIBILITY_TEXELS};

/// Self-shadow bias: (normal · 0.2 + direction to the eye · 0.8) · its length.
const BIAS_NORMAL: f32 = 0.2;
const BIAS_VIEW: f32 = 0.8;
/// Least weight of a probe along each axis, of one that is not seen, and of one behind the surface.
const MIN_SHARE: f32 = 1e-3;
const MIN_VISIBILITY: f32 = 0.05;
const MIN_FACING: f32 = 0.2;
/// Weights below this are crushed.
const CRUSH: f32 = 0.2;

/// Indirect irradiance at a point, W/m².
#[inline]
pub fn irradiance_at(
    p: &LookupParams,
    point: &LookupPoint,
    probes: &[Probe],
    irradiance: &[Rgb],
    visibility: &[Vec2],
) -> Vec3 {
    let position = point.position.truncate();
    let normal = point.normal.truncate();
    let biased = position + (normal * BIAS_NORMAL + point.to_eye.truncate() * BIAS_VIEW) * p.bias;
    let place = (biased - p.first) / p.spacing;
    let last = p.counts - UVec3::ONE;
    let base = place.max(Vec3::ZERO).as_uvec3().min(last);
    let share = (place - base.as_vec3()).max(Vec3::ZERO).min(Vec3::ONE);
    let mut sum = Vec3::ZERO;
    let mut total = 0.0;
    for k in 0..8 {
        let step = UVec3::new(k & 1, (k >> 1) & 1, k >> 2);
        let cell = (base + step).min(last);
        let number = cell.x + p.counts.x * (cell.y + p.counts.y * cell.z);
        let probe = probes[number as usize];
        if probe.is_active == 0 {
            continue;
        }
        let trilinear = axis(step.x, share.x) * axis(step.y, share.y) * axis(step.z, share.z);
        let facing = (cosine(probe.position - position, normal) + 1.0) * 0.5;
        let mut weight = facing * facing + MIN_FACING;
        if p.visibility != 0 {
            let seen = chance(number, biased - probe.position, visibility);
            weight *= if seen > MIN_VISIBILITY { seen } else { MIN_VISIBILITY };
        }
        if weight < CRUSH {
            weight *= weight * weight / (CRUSH * CRUSH);
        }
        weight *= trilinear;
        let first = (number * IRRADIANCE_TEXELS) as usize;
        let stored = sample(IRRADIANCE_EDGE, normal, |texel| irradiance[first + texel].truncate());
        // The mean is taken of square roots.
        let n = p.encoding;
        sum += Vec3::new(half_power(stored.x, n), half_power(stored.y, n), half_power(stored.z, n)) * weight;
        total += weight;
    }
    if total > 0.0 { (sum / total) * (sum / total) } else { Vec3::ZERO }
}

/// Weight of a probe along an axis.
#[inline]
fn axis(step: u32, share: f32) -> f32 {
    let weight = if step == 1 { share } else { 1.0 - share };
    if weight > MIN_SHARE { weight } else { MIN_SHARE }
}

/// Cosine between a vector and a unit vector; 0 for none.
#[inline]
fn cosine(vector: Vec3, unit: Vec3) -> f32 {
    let length = sqrt(vector.dot(vector));
    if length > 0.0 { vector.dot(unit) / length } else { 0.0 }
}

/// Chance that a point so far from a probe is seen from it, by Chebyshev's inequality, to the third power.
#[inline]
fn chance(probe: u32, from_probe: Vec3, visibility: &[Vec2]) -> f32 {
    let distance = sqrt(from_probe.dot(from_probe));
    if distance <= 0.0 {
        return 1.0;
    }
    let first = (probe * VISIBILITY_TEXELS) as usize;
    let moments = sample(VISIBILITY_EDGE, from_probe / distance, |texel| visibility[first + texel]);
    let beyond = distance - moments.x;
    if beyond <= 0.0 {
        return 1.0;
    }
    let variance = scene::math::abs(moments.y - moments.x * moments.x);
    let chance = variance / (variance + beyond * beyond);
    chance * chance * chance
}
