//! Points of a triangle with a density that is linear between its corners.

use core::f32::consts::TAU;

use glam::{Vec2, Vec3};
use scene::math::{abs, acos, clamp, sin_cos_2pi, sqrt};
use scene::sampling::uniform_triangle;

/// Most steps of Newton's method; it takes up to 17 where a corner holds nothing, seldom more than 5 elsewhere.
const STEPS: u32 = 32;

/// Share 1 − u of the first coordinate below which `beta` of the density lies, for the share b = B/S of the second
/// corner.
///
/// With `S = A + B + C` the first coordinate u has `u³(S − 3B) − 3u²(S − 2B) + 3u(S − B) = αS` (Kopylov). In t = 1 − u
/// and β = 1 − α that is `t²(3b + (1 − 3b)t) = β`: nothing is divided by S − 3B, and the root keeps its relative
/// precision where the density ends in a corner. Newton's method from √β, kept in its bracket by bisection.
#[inline]
pub fn invert_first(b: f32, beta: f32) -> f32 {
    let cubic = 1.0 - 3.0 * b;
    let mut low = 0.0f32;
    let mut high = 1.0f32;
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

/// Coefficient 1 − 3b of the cubic below which it counts as a quadratic: what that neglects and what Cardano's formula
/// loses to rounding, about 10⁻³ of the density, are equal there.
const MIN_CUBIC: f32 = 1e-2;

/// Share u of the first coordinate below which `alpha` of the density lies, by Cardano's formula for
/// `u³(1 − 3b) − 3u²(1 − 2b) + 3u(1 − b) = α`, b = B/S (Kopylov, algorithm 2): the root in [0, 1].
///
/// With `u = (m + y)/a`, `a = 1 − 3b`, `m = 1 − 2b` that is `y³ − 3b²y + n = 0`, `n = m³ − 3mb² − αa²`. Three roots
/// `y = 2b cos φ` where |n| ≤ 2b³, `cos 3φ = −n/(2b³)`; else one, `y = y₁ + b²/y₁`, `y₁³ = −(n ± √(n² − 4b⁶))/2`. In
/// single precision the density below the root is within 1.5·10⁻³ of alpha, for a, by which is divided, may be next to
/// nothing; [`invert_first`] divides by nothing and is within 2·10⁻⁷.
#[inline]
pub fn invert_first_by_cardano(b: f32, alpha: f32) -> f32 {
    let a = 1.0 - 3.0 * b;
    if abs(a) < MIN_CUBIC {
        return 1.0 - sqrt(if alpha < 1.0 { 1.0 - alpha } else { 0.0 });
    }
    let m = 1.0 - 2.0 * b;
    let n = m * (m * m - 3.0 * b * b) - alpha * a * a;
    let cube = b * b * b;
    if abs(n) <= 2.0 * cube {
        let turn = acos(-n / (2.0 * cube)) * (1.0 / (3.0 * TAU));
        let first = (m + 2.0 * b * sin_cos_2pi(turn).1) / a;
        let second = (m + 2.0 * b * sin_cos_2pi(turn + 1.0 / 3.0).1) / a;
        let third = (m + 2.0 * b * sin_cos_2pi(turn + 2.0 / 3.0).1) / a;
        return in_unit(nearer_to_unit(first, nearer_to_unit(second, third)));
    }
    let s = sqrt(n * n - 4.0 * cube * cube);
    let one = cube_root(-0.5 * if n < 0.0 { n - s } else { n + s });
    let y = one + b * b / one;
    // Rounding hides two roots that are nearly one, as at alpha = 1: they are where the third says.
    in_unit(nearer_to_unit((m + y) / a, (m - 0.5 * y) / a))
}

/// Returns whichever is closer to [0, 1].
#[inline]
fn nearer_to_unit(a: f32, b: f32) -> f32 {
    if abs(a - in_unit(a)) <= abs(b - in_unit(b)) { a } else { b }
}

/// A number limited to [0, 1].
#[inline]
fn in_unit(x: f32) -> f32 {
    clamp(x, 0.0, 1.0)
}

/// Cube root, the same bits on CPU and GPU: three steps of Newton's method from a third of the exponent.
#[inline]
fn cube_root(x: f32) -> f32 {
    let size = abs(x);
    if size < f32::MIN_POSITIVE {
        return 0.0;
    }
    let mut y = f32::from_bits(size.to_bits() / 3 + 0x2a51_4067);
    let mut step = 0;
    while step < 3 {
        y = (2.0 * y + size / (y * y)) * (1.0 / 3.0);
        step += 1;
    }
    if x < 0.0 { -y } else { y }
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
    let sum = values.x + values.y + values.z;
    if sum > 0.0 {
        let t = invert_first(values.y / sum, x);
        on_section(values, 1.0 - t, t, y)
    } else {
        let (u, v) = uniform_triangle((x, y));
        Vec2::new(u, v)
    }
}

/// Linear start point by Cardano's formula, [`invert_first_by_cardano`].
#[inline]
pub fn linear_point_by_cardano(values: Vec3, x: f32, y: f32) -> Vec2 {
    let sum = values.x + values.y + values.z;
    if sum > 0.0 {
        let u = invert_first_by_cardano(values.y / sum, 1.0 - x);
        on_section(values, u, 1.0 - u, y)
    } else {
        let (u, v) = uniform_triangle((x, y));
        Vec2::new(u, v)
    }
}

/// The point on the section at u, t = 1 − u, below which `y` of its density lies.
#[inline]
fn on_section(values: Vec3, u: f32, t: f32, y: f32) -> Vec2 {
    let s = invert_section(values.x * t + values.y * u, values.z * t + values.y * u, y);
    Vec2::new(u, t * s)
}

/// The linear function with these values at the corners, at a point with these shares.
#[inline]
pub fn interpolate(values: Vec3, at: Vec2) -> f32 {
    values.x * (1.0 - at.x - at.y) + values.y * at.x + values.z * at.y
}
