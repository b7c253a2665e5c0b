//! The light sources of a scene, and the emitters that follow from them.

use alloc::sync::Arc;
use alloc::vec::Vec;

use glam::{Vec3, Vec4};

use super::distribution::{check_lights, check_table};
use super::geometry::Geometry;
use crate::error::Error;
use crate::gpu::{Emitter, Light, Material, NONE, Sky};
use crate::kernel::GeometryTables;
use crate::math::luminance;
use crate::sampling::uniform_triangle;

/// The light sources, which may change in every frame.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Lighting {
    /// Lights that are not geometry.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::table"))]
    pub lights: Vec<Light>,
    /// The sky.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::value"))]
    pub sky: Sky,
    /// Its map, `map_width · map_height` texels.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::table"))]
    pub sky_map: Arc<[Vec4]>,
    /// Emitted radiance of each material, W/m²/sr, instead of [`Material::radiance`] (a radiance
    /// texture still multiplies it); empty for what the materials say.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::table"))]
    pub emission: Vec<Vec3>,
    /// Distributions of luminaires ([`crate::Distribution::append_to`]), one after the other.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::table"))]
    pub distributions: Arc<[f32]>,
}

impl Lighting {
    /// Returns true if the sky sends any light.
    pub fn has_sky(&self) -> bool {
        luminance(self.sky.radiance) > 0.0
    }

    /// Checks that luminaires among these lights have distributions here.
    ///
    /// # Errors
    /// [`Error::LightDistribution`] names the light.
    pub fn check_lights(&self, lights: &[Light]) -> Result<(), Error> {
        check_lights(lights, &self.distributions)
    }

    /// Checks that the tables fit the geometry's materials and the sky's size, and the lights their distributions.
    ///
    /// # Errors
    /// [`Error::EmissionLength`], [`Error::TableLength`] for the sky's map, or those of [`crate::Distribution`].
    pub(super) fn check(&self, geometry: &Geometry) -> Result<(), Error> {
        check_sky_map(&self.sky, self.sky_map.len())?;
        let expected = geometry.materials.len();
        let found = self.emission.len();
        if found != 0 && found != expected {
            return Err(Error::EmissionLength { expected, found });
        }
        self.check_lights(&self.lights)
    }

    /// Checks that the distributions are numbers.
    ///
    /// # Errors
    /// [`Error::Distribution`].
    pub(super) fn check_distributions(&self) -> Result<(), Error> {
        check_table(&self.distributions)
    }

    /// Emitted radiance of each material, `[materials]`, W/m²/sr.
    fn emissions<'a>(&'a self, geometry: &'a Geometry) -> impl Iterator<Item = Vec3> + 'a {
        let imported = geometry.materials.iter().enumerate();
        imported.map(|(k, material)| self.emission.get(k).copied().unwrap_or(material.radiance))
    }
}

/// Checks that the sky's map has as many texels as the sky says.
///
/// # Errors
/// [`Error::TableLength`].
pub(super) fn check_sky_map(sky: &Sky, found: usize) -> Result<(), Error> {
    let expected = sky.map_width as usize * sky.map_height as usize;
    if found != expected {
        return Err(Error::TableLength { name: "sky_map", expected, found });
    }
    Ok(())
}

/// Gives the materials of a geometry the emission of a lighting; whether that changed them. They
/// stay shared where it did not.
pub(super) fn set_emission(materials: &mut Arc<[Material]>, lighting: &Lighting, geometry: &Geometry) -> bool {
    let mut pairs = materials.iter().zip(lighting.emissions(geometry));
    if pairs.all(|(material, radiance)| material.radiance == radiance) {
        return false;
    }
    for (material, radiance) in Arc::make_mut(materials).iter_mut().zip(lighting.emissions(geometry)) {
        material.radiance = radiance;
    }
    true
}

/// Emissive triangles with the cumulative distribution of their power.
pub(super) fn find_emitters(tables: &GeometryTables) -> Vec<Emitter> {
    let mut emitters: Vec<Emitter> = Vec::new();
    let mut total = 0.0f64;
    for (index, t) in tables.triangles.iter().enumerate() {
        let area = 0.5 * t.edge_a.cross(t.edge_b).length();
        let mean = mean_luminance(tables, index as u32);
        let power = f64::from(area) * f64::from(mean);
        if power > 0.0 {
            total += power;
            let probability = power as f32;
            emitters.push(Emitter { triangle: index as u32, cumulative: 0.0, probability, area });
        }
    }
    let mut sum = 0.0f64;
    for e in &mut emitters {
        e.probability = (f64::from(e.probability) / total) as f32;
        sum += f64::from(e.probability);
        e.cumulative = sum as f32;
    }
    if let Some(last) = emitters.last_mut() {
        last.cumulative = 1.0;
    }
    emitters
}

/// Mean luminance that a triangle emits, W/m²/sr; over a grid of it where emission is textured.
fn mean_luminance(tables: &GeometryTables, triangle: u32) -> f32 {
    let material = tables.triangles[triangle as usize].material;
    let is_textured = tables.materials[material as usize].radiance_texture != NONE;
    let steps = if is_textured { 8 } else { 1 };
    let mut mean = 0.0;
    for a in 0..steps {
        for b in 0..steps {
            let at = ((a as f32 + 0.5) / steps as f32, (b as f32 + 0.5) / steps as f32);
            let (u, v) = uniform_triangle(at);
            mean += luminance(tables.radiance(triangle, u, v)) / (steps * steps) as f32;
        }
    }
    mean
}

/// Mean radiance of a triangle, W/m²/sr; over a grid of it where emission is textured.
pub(super) fn mean_radiance(tables: &GeometryTables, triangle: u32) -> Vec3 {
    const STEPS: u32 = 8;
    let mut mean = Vec3::ZERO;
    for k in 0..STEPS * STEPS {
        let at = ((k / STEPS) as f32 + 0.5, (k % STEPS) as f32 + 0.5);
        let (u, v) = uniform_triangle((at.0 / STEPS as f32, at.1 / STEPS as f32));
        if !tables.is_hole(triangle, u, v) {
            mean += tables.radiance(triangle, u, v) / (STEPS * STEPS) as f32;
        }
    }
    mean
}
