//! A bounce that begins with the light of the frame before, and with where that was going.

use glam::Vec4;

use crate::types::FeedbackParams;

/// Change of the exitance in this bounce, `ΔB ← momentum ΔB + step (E + ρ∘H − B)`, W/m², which is then added to B. With
/// a step of 1 and no momentum it is `E + ρ∘H − B`, a plain bounce.
///
/// Source: B. T. Polyak, "Some methods of speeding up the convergence of iteration methods", 1964.
#[inline]
pub fn change(
    p: &FeedbackParams,
    source: Vec4,
    albedo: Vec4,
    irradiance: Vec4,
    exitance: Vec4,
    last_change: Vec4,
) -> Vec4 {
    last_change * p.momentum + (source + albedo * irradiance - exitance) * p.step
}
