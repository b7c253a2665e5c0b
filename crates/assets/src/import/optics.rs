//! Specular reflection and transmission of imported materials.

use glam::Vec3;

/// Index of refraction where a file says none: that of window glass.
pub const GLASS: f32 = 1.5;
/// Least and greatest index of refraction.
pub const INDICES: (f32, f32) = (0.1, 10.0);

/// The specular parts of a material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// Share of the light that is mirrored.
    pub mirror: Vec3,
    /// Share that meets a clear dielectric.
    pub transmittance: Vec3,
    /// Index of refraction behind the front.
    pub index_of_refraction: f32,
    /// True if the surface is both faces of a pane.
    pub is_pane: bool,
}

impl Default for Optics {
    /// Neither mirror nor glass.
    fn default() -> Self {
        Self { mirror: Vec3::ZERO, transmittance: Vec3::ZERO, index_of_refraction: GLASS, is_pane: false }
    }
}

impl Optics {
    /// Returns true if there is anything specular.
    pub fn is_specular(&self) -> bool {
        self.mirror != Vec3::ZERO || self.transmittance != Vec3::ZERO
    }

    /// Light that the specular parts leave for diffuse reflection.
    pub fn rest(&self) -> Vec3 {
        (Vec3::ONE - self.mirror - self.transmittance).max(Vec3::ZERO)
    }

    /// Brings shares and index into their range. Returns what was changed.
    pub fn repair(&mut self) -> Option<String> {
        let before = *self;
        let share = |x: f32| if x.is_finite() { x.clamp(0.0, 1.0) } else { 0.0 };
        (self.mirror, self.transmittance) = (self.mirror.map(share), self.transmittance.map(share));
        let sum = (self.mirror + self.transmittance).max(Vec3::ONE);
        (self.mirror, self.transmittance) = (self.mirror / sum, self.transmittance / sum);
        if !(INDICES.0..=INDICES.1).contains(&self.index_of_refraction) {
            self.index_of_refraction = GLASS;
        }
        (before != *self).then(|| {
            format!(
                "mirror and transmittance were brought into 0 … 1 together, or its index of refraction into {} … {}",
                INDICES.0, INDICES.1
            )
        })
    }
}
