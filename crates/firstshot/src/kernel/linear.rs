//! Points of a triangle with a density that is linear between its corners.

use glam::{Vec2, Vec3};
use scene::math::sqrt;
use scene::sampling::uniform_triangle;

/// Most steps of Newton's method; it takes up to 17 where a corner holds nothing, seldom more than 5 elsewhere.
const STEPS: u32 = 32;

/// Share 1 − u of the first coordinate below which `beta` of the density lies, for the share b = B/S of the second corner.
///
/// With `S = A + B + C` the first coordinate u has `u³(S − 3B) − 3u²(S − 2B) + 3u(S − B) = αS` (Kopylov). In t = 1 − u and β = 1 − α
/// that is `t²(3b + (1 − 3b)t) = β`: nothing is divided by S − 3B, and the root keeps its relative precision where the density
/// ends in a corner. Newton's method from √β, kept in its bracket by bisection.
#[inline]
pub fn invert_first(b: f32, beta: f32) -> f32 {
    let cubic = 1.0 - 3.0 * b;
    let (mut low, mut high) = (0.0f32, 1.0f32);
    let mut t = sqrt(beta);
    let mut step = 0;
    while step < STEPS {
        let value = t * t * (3.0 * b + cubic * t) - beta;
        if value > 0.0 {
            high = t;
        } else {
            low = t;
        }
        let slope = t * (6.0 * b + 3.0 * cubic * t);
        let mut next = if slope > 0.0 { t - value / slope } else { -1.0 };
        if next < low || next > high {
            next = 0.5 * (low + high);
        }
        let change = if next > t { next - t } else { t - next };
        t = next;
        step = if change <= 1e-7 * t { STEPS } else { step + 1 };
    }
    t
}

/// Share s of a section at which `gamma` of the linear density from `first` to `last` lies:
/// `s = γ(D₀ + D₁) / (D₀ + √(D₀² + γ(D₁² − D₀²)))`, which has no case of its own for D₀ = D₁.
#[inline]
pub fn invert_section(first: f32, last: f32, gamma: f32) -> f32 {
    let inside = first * first + gamma * (last * last - first * first);
    let divisor = first + sqrt(if inside > 0.0 { inside } else { 0.0 });
    if divisor > 0.0 {
        let s = gamma * (first + last) / divisor;
        if s < 1.0 { s } else { 1.0 }
    } else {
        gamma
    }
}

/// Barycentric shares (of the second and third corner) of a point whose density is linear between `values` ≥ 0 at the
/// corners; uniform where all are zero. `x`, `y` in [0, 1).
#[inline]
pub fn linear_point(values: Vec3, x: f32, y: f32) -> Vec2 {
    let (a, b, c) = (values.x, values.y, values.z);
    let sum = a + b + c;
    if sum > 0.0 {
        let t = invert_first(b / sum, x);
        let u = 1.0 - t;
        let s = invert_section(a * t + b * u, c * t + b * u, y);
        Vec2::new(u, t * s)
    } else {
        let (u, v) = uniform_triangle((x, y));
        Vec2::new(u, v)
    }
}

/// The linear function with these values at the corners, at a point with these shares.
#[inline]
pub fn interpolate(values: Vec3, at: Vec2) -> f32 {
    values.x * (1.0 - at.x - at.y) + values.y * at.x + values.z * at.y
}
