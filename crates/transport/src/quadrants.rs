//! Rows by quadrants of the hemisphere: irradiance from each, so that what a turned surface
//! receives is known, too.

use glam::Vec3;
use scene::sampling::frame;

/// Quadrants of a hemisphere; a receiver has a row for each, one after the other.
pub const QUADRANTS: usize = 4;

/// The rotational gradient of irradiance, quadrant by quadrant: with `H_q` from quadrant q of the
/// hemisphere round the unit normal n, a surface turned to n' receives about
/// `Σ_q H_q (1 + t_q·(n' − n))`, where `t_q` is tangent to the surface.
///
/// For light that is the same over a quadrant, `t_q = 4/π ∫ ω_t dω` over it, as cosine-weighted
/// directions have `ω_t / cosθ`: a vector of length √2 towards its middle. The sum is that of the
/// `H_q` for light that is the same everywhere, and none of the terms is negative while
/// `|n' − n| < 1/√2`.
///
/// Source: Ward and Heckbert 1992, for samples in quadrants.
pub fn rotational_gradients(normal: Vec3) -> [Vec3; QUADRANTS] {
    let (right, up) = frame(normal);
    [right + up, up - right, -right - up, right - up]
}

/// The quadrant that a direction above the surface goes to, in the order of
/// [`rotational_gradients`]. `right` and `up` are the frame of the surface's normal.
pub fn quadrant_of(direction: Vec3, right: Vec3, up: Vec3) -> usize {
    match (direction.dot(right) < 0.0, direction.dot(up) < 0.0) {
        (false, false) => 0,
        (true, false) => 1,
        (true, true) => 2,
        (false, true) => 3,
    }
}
