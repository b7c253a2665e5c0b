//! Medium between surfaces: light is absorbed on its way, and not scattered (Beer and Lambert).

use core::ops::{AddAssign, Div, Mul};

use glam::Vec3;

use crate::math::exp_minus;

/// Share of light that is left after a way of `distance` m through a medium that absorbs `absorption` of it on each
/// metre: `T = e^(−σ d)`, channel by channel. 1 without a medium, bit for bit.
#[inline]
pub fn transmittance(absorption: Vec3, distance: f32) -> Vec3 {
    Vec3::new(
        exp_minus(absorption.x * distance),
        exp_minus(absorption.y * distance),
        exp_minus(absorption.z * distance),
    )
}

/// A share of light: one number where all channels lose alike, else RGB.
pub trait Share: Copy + AddAssign + Mul<f32, Output = Self> + Div<f32, Output = Self> {
    /// No light.
    const NOTHING: Self;

    /// This share of a colour.
    fn of(self, color: Vec3) -> Vec3;
}

impl Share for f32 {
    const NOTHING: Self = 0.0;

    #[inline]
    fn of(self, color: Vec3) -> Vec3 {
        color * self
    }
}

impl Share for Vec3 {
    const NOTHING: Self = Self::ZERO;

    #[inline]
    fn of(self, color: Vec3) -> Vec3 {
        color * self
    }
}

/// Medium between surfaces: transmitted light.
pub trait Medium: Copy {
    /// Transmittance.
    type Left: Share;

    /// Share of light that is left after a way of so many m.
    fn left(self, distance: f32) -> Self::Left;
}

/// Nothing, which leaves all light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Air;

impl Medium for Air {
    type Left = f32;

    #[inline]
    fn left(self, _: f32) -> f32 {
        1.0
    }
}

/// A medium with this absorption, 1/m: [`transmittance`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Absorbing(pub Vec3);

impl Medium for Absorbing {
    type Left = Vec3;

    #[inline]
    fn left(self, distance: f32) -> Vec3 {
        transmittance(self.0, distance)
    }
}
