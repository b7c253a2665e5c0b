//! What fills the space between surfaces: light is absorbed on its way, and not scattered (Beer and Lambert).

use glam::Vec3;

use crate::math::exp_minus;

/// Share of light that is left after a way of `distance` m through a medium that absorbs `absorption` of it on each metre:
/// `T = e^(−σ d)`, channel by channel. 1 without a medium, bit for bit.
#[inline]
pub fn transmittance(absorption: Vec3, distance: f32) -> Vec3 {
    Vec3::new(
        exp_minus(absorption.x * distance),
        exp_minus(absorption.y * distance),
        exp_minus(absorption.z * distance),
    )
}
