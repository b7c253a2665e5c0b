//! Quantities of light, radiometric or photometric, each a type of its own: a sun takes no candela.

use core::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;

use crate::gpu::LUMENS_PER_WATT;
use crate::math::luminance;

/// A quantity with its radiometric and its photometric unit.
macro_rules! quantity {
    ($name:ident, $what:literal, $unit:literal, $photometric:ident, $symbol:literal) => {
        #[doc = concat!($what, ", ", $unit, ", linear Rec.709 RGB.")]
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct $name(pub Vec3);

        impl $name {
            #[doc = concat!("White light of so many ", $symbol, ", by ", stringify!(LUMENS_PER_WATT), ".")]
            pub fn $photometric(value: f32) -> Self {
                Self(Vec3::splat(value / LUMENS_PER_WATT))
            }

            /// As much light for the eye, of the hue of this linear RGB colour; none where that is black.
            #[must_use]
            pub fn tinted(self, color: Vec3) -> Self {
                let own = luminance(color);
                if own > 0.0 { Self(color * (luminance(self.0) / own)) } else { Self(Vec3::ZERO) }
            }
        }
    };
}

quantity!(Irradiance, "Irradiance", "W/m²", lux, "lx");
quantity!(Intensity, "Radiant intensity", "W/sr", candela, "cd");
quantity!(Radiance, "Radiance", "W/m²/sr", nits, "cd/m²");
quantity!(Flux, "Radiant flux", "W", lumens, "lm");

/// The intensity of a point that sends this flux evenly: Φ / 4π.
impl From<Flux> for Intensity {
    fn from(flux: Flux) -> Self {
        Self(flux.0 * (0.25 * FRAC_1_PI))
    }
}

/// Emission of a surface: its radiance, or its total flux.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SurfaceLight {
    /// In every direction.
    Radiance(Radiance),
    /// Flux of one side.
    Flux(Flux),
}

impl SurfaceLight {
    /// Its radiance on an area, m²: a Lambertian surface has Φ / (π A).
    pub fn radiance(self, area: f32) -> Radiance {
        match self {
            Self::Radiance(radiance) => radiance,
            Self::Flux(flux) => Radiance(flux.0 / (PI * area)),
        }
    }
}

impl From<Radiance> for SurfaceLight {
    fn from(radiance: Radiance) -> Self {
        Self::Radiance(radiance)
    }
}

impl From<Flux> for SurfaceLight {
    fn from(flux: Flux) -> Self {
        Self::Flux(flux)
    }
}
