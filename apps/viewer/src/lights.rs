//! Lights as they are edited: colour and power apart, switched off without being forgotten.

use glam::{Vec3, vec3};
use patchlight::Bake;
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT};
use scene::{Light, Lighting};

/// Half-angles of a new spot, degrees.
const SPOT_DEGREES: (f64, f64) = (15.0, 30.0);
/// Irradiance of a new sun, W/m².
const SUN: f32 = 10.0;

/// Kind of a new light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NewLight {
    /// A point.
    Point,
    /// Parallel light.
    Sun,
    /// A spot.
    Spot,
}

impl NewLight {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Point, Self::Sun, Self::Spot];

    /// Its name in panels and scripts.
    pub fn name(self) -> &'static str {
        match self {
            Self::Point => "point",
            Self::Sun => "sun",
            Self::Spot => "spot",
        }
    }
}

/// A light in the list.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EditedLight {
    /// Place, direction, shape.
    pub light: Light,
    /// Its colour, the greatest component 1.
    pub color: Vec3,
    /// The greatest component of irradiance (W/m²), intensity (W/sr) or radiance (W/m²/sr).
    pub power: f32,
    /// True if it shines.
    pub is_on: bool,
    /// True if it shines by itself, even if it is on: a sun above the horizon.
    pub is_up: bool,
}

impl EditedLight {
    /// A light as it shines.
    pub fn new(light: Light) -> Self {
        let power = light.color.max_element();
        let color = if power > 0.0 { light.color / power } else { Vec3::ONE };
        Self { light, color, power, is_on: true, is_up: true }
    }

    /// The light with its colour; black where it is off, so that the others need not be traced again.
    pub fn shining(&self) -> Light {
        let is_shining = self.is_on && self.is_up;
        Light { color: if is_shining { self.color * self.power } else { Vec3::ZERO }, ..self.light }
    }

    /// Its kind in words.
    pub fn kind(&self) -> &'static str {
        match self.light.kind {
            LIGHT_DIRECTIONAL => "sun",
            LIGHT_POINT => "point",
            LIGHT_SPOT => "spot",
            _ => "rectangle",
        }
    }

    /// Unit of its power.
    pub fn unit(&self) -> &'static str {
        match self.light.kind {
            LIGHT_DIRECTIONAL => "W/m²",
            LIGHT_RECT => "W/m²/sr",
            _ => "W/sr",
        }
    }

    /// Returns true if it is somewhere.
    pub fn has_position(&self) -> bool {
        self.light.kind != LIGHT_DIRECTIONAL
    }

    /// Returns true if it points somewhere.
    pub fn has_direction(&self) -> bool {
        matches!(self.light.kind, LIGHT_DIRECTIONAL | LIGHT_SPOT)
    }

    /// Position of its handle, m: the middle of a rectangle.
    pub fn handle(&self) -> Vec3 {
        self.light.position + 0.5 * (self.light.edge_a + self.light.edge_b)
    }
}

/// Edits of a lighting.
#[derive(Clone, Debug, PartialEq)]
pub struct Edits {
    lights: Vec<EditedLight>,
    emission: Vec<Vec3>,
    sky_scale: f32,
}

/// Light sources, as edited.
#[derive(Clone, Debug)]
pub struct EditedLighting {
    /// The lights.
    pub lights: Vec<EditedLight>,
    /// Sky and its map, and emission as the scene has them.
    base: Lighting,
    /// Emitted radiance of each material, W/m²/sr.
    pub emission: Vec<Vec3>,
    /// Emission as the scene has it.
    own_emission: Vec<Vec3>,
    /// Factor on the sky's radiance.
    pub sky_scale: f32,
}

impl EditedLighting {
    /// The lighting of a bake.
    pub fn of(bake: &Bake) -> Self {
        let base = bake.scene().lighting.clone();
        let own_emission: Vec<Vec3> = bake.scene().materials.iter().map(|material| material.radiance).collect();
        Self {
            lights: base.lights.iter().copied().map(EditedLight::new).collect(),
            emission: own_emission.clone(),
            own_emission,
            base,
            sky_scale: 1.0,
        }
    }

    /// Lighting of a frame.
    pub fn lighting(&self) -> Lighting {
        let mut lighting = self.base.clone();
        lighting.lights = self.lights.iter().map(EditedLight::shining).collect();
        lighting.sky.radiance *= self.sky_scale;
        if self.emission != self.own_emission {
            lighting.emission.clone_from(&self.emission);
        }
        lighting
    }

    /// All that can be edited.
    pub fn edits(&self) -> Edits {
        Edits { lights: self.lights.clone(), emission: self.emission.clone(), sky_scale: self.sky_scale }
    }

    /// Returns true if the scene has a sky.
    pub fn has_sky(&self) -> bool {
        self.base.has_sky()
    }

    /// The first sun.
    pub fn sun(&mut self) -> Option<&mut EditedLight> {
        self.lights.iter_mut().find(|light| light.light.kind == LIGHT_DIRECTIONAL)
    }

    /// Adds a light at a place, m, that shines along a unit direction on what is so far away, m.
    pub fn add(&mut self, new: NewLight, position: Vec3, direction: Vec3, distance: f32) {
        // As bright there as a sun.
        let intensity = Vec3::splat(SUN * distance * distance);
        let cosine = |degrees: f64| degrees.to_radians().cos() as f32;
        let light = match new {
            NewLight::Point => Light { kind: LIGHT_POINT, position, color: intensity, ..Light::default() },
            NewLight::Sun => {
                let color = SUN * vec3(1.0, 0.95, 0.85);
                Light { kind: LIGHT_DIRECTIONAL, direction, color, ..Light::default() }
            }
            NewLight::Spot => Light {
                kind: LIGHT_SPOT,
                position,
                direction,
                color: intensity,
                cos_inner: cosine(SPOT_DEGREES.0),
                cos_outer: cosine(SPOT_DEGREES.1),
                ..Light::default()
            },
        };
        self.lights.push(EditedLight::new(light));
    }
}
