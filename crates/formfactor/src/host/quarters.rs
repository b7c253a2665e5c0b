//! Rows by quarters of the hemisphere: irradiance from each, so that what a turned surface receives is known, too.

use glam::Vec3;
use scene::sampling::frame;

/// Quarters of a hemisphere; a receiver has a row for each, one after the other.
pub const QUARTERS: usize = 4;

/// How irradiance changes as a surface turns: with H_q from quarter q of the hemisphere round the unit normal n, that of a
/// surface turned to n' is about `Σ_q H_q (1 + t_q·(n' − n))`, where t_q is tangent to the surface. For light that is the same
/// over a quarter, t_q = 4/π ∫ ω_t dω over it, as cosine-weighted directions have ω_t/cosθ: a vector of length √2
/// towards its middle. The sum is that of the H_q for light that is the same everywhere, and none of the terms is negative while
/// |n' − n| < 1/√2.
pub fn turns(normal: Vec3) -> [Vec3; QUARTERS] {
    let (right, up) = frame(normal);
    [right + up, up - right, -right - up, right - up]
}
