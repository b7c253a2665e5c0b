//! Sources of photons: elements with their power, and the distribution over them.

use alloc::vec::Vec;
use core::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_RECT, LIGHT_SPOT};
use scene::kernel::bvh::FAR;
use scene::kernel::light::{sky_radiance, spot_falloff};
use scene::math::{luminance, sin_cos_2pi};
use scene::parallel::*;
use scene::sampling::uniform_triangle;
use scene::{NONE, Scene};

use super::Proceed;
use super::alias::alias_table;
use super::light_elements::{LightElement, LightElementSettings, TraceRays, light_elements, light_elements_by};
use crate::error::Error;
use crate::kernel::start::area_across;
use crate::types::*;

/// Least density on a light element, over the greatest light known on it or around it: with a shadow ray from each
/// start point, what is not known is found nevertheless.
const MIN_DENSITY: f32 = 0.1;
/// Parts of the sky by height and azimuth, and places of each along both at which its power is measured.
const SKY_PARTS: (u32, u32) = (32, 64);
const SKY_PLACES: u32 = 4;
/// Reflectance that a texture's mean is not below: filtering may lose what single texels have.
const MIN_ALBEDO: f32 = 1e-3;
/// More elements than this do not fit into the 128 MiB that every device can bind.
const MAX_ELEMENTS: usize = 1 << 21;
/// Steps by which the box of the scene is larger than the scene.
const MARGIN: f32 = 4.0;

/// Value that stands for the reflectance of a textured light element in the distribution.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Texels {
    /// The mean texel; photons carry the ratio of their own.
    #[default]
    Mean,
    /// The brightest texel; photons of darker ones are rejected in proportion, so that all carry the same (Kopylov).
    Bound,
}

/// Elements and the distribution over them.
#[derive(Clone, Debug, Default)]
pub struct Emission {
    /// Elements that photons start from.
    pub elements: Vec<Element>,
    /// Alias table over the elements, by luminance of power; empty where nothing shines.
    pub alias: Vec<AliasEntry>,
    /// Luminance of the power of all elements, W: the mean flux of a photon is this over their number.
    pub power: f64,
    /// Any of the `FLAG_` constants.
    pub flags: u32,
    /// The box that parallel light and the sky enter through, m.
    pub bounds: (Vec3, Vec3),
    /// Shadow rays that found the light elements; 0 where they were known.
    pub shadow_rays: u64,
}

/// Elements with the luminance of their power, W.
#[derive(Default)]
struct Elements(Vec<(Element, f64)>);

impl Elements {
    fn add(&mut self, element: Element, power: f64) {
        if power > 0.0 && power.is_finite() {
            self.0.push((element, power));
        }
    }

    fn finish(self, scene: &Scene, flags: u32) -> Result<Emission, Error> {
        let found = self.0.len();
        if found > MAX_ELEMENTS {
            return Err(Error::TooMany { name: "elements", found: found as u64, limit: MAX_ELEMENTS as u64 });
        }
        let (elements, powers): (Vec<Element>, Vec<f64>) = self.0.into_iter().unzip();
        let alias = alias_table(&powers);
        let power = powers.iter().sum();
        Ok(Emission { elements, alias, power, flags, bounds: entry_box(scene), shadow_rays: 0 })
    }
}

/// The box of the scene with a margin, so that what enters it starts outside of all surfaces.
fn entry_box(scene: &Scene) -> (Vec3, Vec3) {
    let margin = Vec3::splat(MARGIN * scene.geometry.ray_offset);
    (scene.geometry.bounds.0 - margin, scene.geometry.bounds.1 + margin)
}

impl Emission {
    /// First shot: photons of point, spot and parallel lights start, already reflected, from the adaptive light
    /// elements that the lights fall on ([`light_elements`]); those of emitters, rectangle lights and the sky from
    /// these.
    ///
    /// With `is_exact`, a shadow ray from each start point finds its light, and the estimate has no bias from the
    /// table; without, the table's light is taken as it is (Kopylov).
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::TooMany`], [`Error::Cancelled`].
    pub fn first_shot(
        scene: &Scene,
        settings: &LightElementSettings,
        texels: Texels,
        is_exact: bool,
        progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
    ) -> Result<Self, Error> {
        let light_elements = light_elements(scene, settings, progress)?;
        let emission = Self::of_light_elements(scene, &light_elements.elements, texels, is_exact)?;
        Ok(Self { shadow_rays: light_elements.shadow_rays, ..emission })
    }

    /// [`Emission::first_shot`] with shadow rays of the light elements that are traced by somebody else:
    /// [`light_elements_by`].
    ///
    /// # Errors
    /// As [`Emission::first_shot`]; what `trace` gives.
    pub fn first_shot_by<E: From<Error>>(
        trace: &mut TraceRays<E>,
        scene: &Scene,
        settings: &LightElementSettings,
        texels: Texels,
        is_exact: bool,
        progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
    ) -> Result<Self, E> {
        let light_elements = light_elements_by(trace, scene, settings, progress)?;
        let emission = Self::of_light_elements(scene, &light_elements.elements, texels, is_exact)?;
        Ok(Self { shadow_rays: light_elements.shadow_rays, ..emission })
    }

    /// First shot from light elements that are known.
    ///
    /// # Errors
    /// [`Error::TooMany`].
    pub fn of_light_elements(
        scene: &Scene,
        light_elements: &[LightElement],
        texels: Texels,
        is_exact: bool,
    ) -> Result<Self, Error> {
        let brightest = Brightest::new(scene, texels);
        let element = |light_element: &LightElement| lit_element(scene, light_element, &brightest, is_exact);
        let mut elements = Elements::default();
        let found: Vec<(Element, f64)> = light_elements.par_iter().map(element).collect();
        found.into_iter().for_each(|(element, power)| elements.add(element, power));
        add_areas(scene, &mut elements);
        let exact = if is_exact { FLAG_EXACT } else { 0 };
        elements.finish(scene, exact | if texels == Texels::Bound { FLAG_BOUND } else { 0 })
    }

    /// The classical way, for comparison: photons of all lights start from the lights.
    ///
    /// # Errors
    /// [`Error::TooMany`].
    pub fn classical(scene: &Scene) -> Result<Self, Error> {
        let mut elements = Elements::default();
        let bounds = entry_box(scene);
        for (k, light) in scene.lighting.lights.iter().enumerate() {
            let element = Element { light: k as u32, triangle: NONE, ..Element::default() };
            let color = luminance(light.color);
            match light.kind {
                LIGHT_RECT => {}
                LIGHT_DIRECTIONAL => {
                    let color = luminance(light.color * scene.transmittance(FAR));
                    let power = color * area_across(bounds.0, bounds.1, light.direction);
                    elements.add(Element { kind: ELEMENT_BEAM, scale: 1.0 / power, ..element }, f64::from(power));
                }
                kind => {
                    const STEPS: u32 = 256;
                    let least = if kind == LIGHT_SPOT { light.cos_outer } else { -1.0 };
                    let mut mean = 1.0;
                    if kind == LIGHT_SPOT {
                        let at = |k: u32| 1.0 - (1.0 - least) * (k as f32 + 0.5) / STEPS as f32;
                        mean = (0..STEPS).map(|k| spot_falloff(light, at(k))).sum::<f32>() / STEPS as f32;
                    }
                    let power = color * TAU * (1.0 - least) * mean;
                    elements.add(Element { kind: ELEMENT_BULB, scale: 1.0 / power, ..element }, f64::from(power));
                }
            }
        }
        add_areas(scene, &mut elements);
        elements.finish(scene, 0)
    }

    /// Returns true if no photon can start anywhere.
    pub fn is_dark(&self) -> bool {
        self.alias.is_empty()
    }

    /// Bytes of the tables.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.elements[..]) + size_of_val(&self.alias[..])) as u64
    }
}

/// Emission coefficient of a light element: `S · mean(h) · lum(ρ̄∘color)`, S its area, h the light over the light's
/// colour, ρ̄ the share that goes on.
fn lit_element(scene: &Scene, light_element: &LightElement, brightest: &Brightest, is_exact: bool) -> (Element, f64) {
    let color = scene.lighting.lights[light_element.light as usize].color;
    let specular = scene.tables().specular_share(light_element.triangle);
    let onward = brightest.of(scene, light_element).map_or(light_element.onward, |albedo| albedo + specular);
    let textured = scene.materials[scene.geometry.triangles[light_element.triangle as usize].material as usize]
        .albedo_texture
        != NONE;
    let least = if textured { MIN_ALBEDO * luminance(color) } else { 0.0 };
    let reflected = luminance(onward * color).max(least);
    let mut values = Vec3::from(light_element.values);
    if is_exact {
        // Of starts that may be hidden, each with a chance, the square root of the chance makes the variance least.
        let least = MIN_DENSITY * light_element.top().max(light_element.around);
        values = values.max(Vec3::splat(least)) / light_element.seen.sqrt();
    }
    let element = Element {
        values,
        scale: 1.0 / reflected,
        corner: light_element.corners[0],
        edge_a: light_element.corners[1] - light_element.corners[0],
        edge_b: light_element.corners[2] - light_element.corners[0],
        kind: ELEMENT_LIT,
        triangle: light_element.triangle,
        light: light_element.light,
        is_back: u32::from(light_element.is_back),
        reserved: [0; 2],
    };
    let mean = f64::from(values.x) + f64::from(values.y) + f64::from(values.z);
    (element, f64::from(light_element.area) * mean / 3.0 * f64::from(reflected))
}

/// Emitters, rectangle lights and the sky.
fn add_areas(scene: &Scene, elements: &mut Elements) {
    let geometry = scene.tables();
    for e in scene.emitters.iter() {
        let steps = 8u32;
        let place = |k: u32| ((k % steps) as f32 + 0.5, (k / steps) as f32 + 0.5);
        let radiance = |k: u32| {
            let (x, y) = place(k);
            let (u, v) = uniform_triangle((x / steps as f32, y / steps as f32));
            luminance(geometry.radiance(e.triangle, u, v))
        };
        let mean = (0..steps * steps).map(radiance).sum::<f32>() / (steps * steps) as f32;
        let element = Element { kind: ELEMENT_EMITTER, triangle: e.triangle, light: NONE, ..Element::default() };
        elements.add(Element { scale: 1.0 / mean, ..element }, f64::from(PI * e.area * mean));
    }
    for (k, light) in scene.lighting.lights.iter().enumerate().filter(|(_, light)| light.kind == LIGHT_RECT) {
        let radiance = luminance(light.color);
        let element = Element { kind: ELEMENT_RECT, triangle: NONE, light: k as u32, ..Element::default() };
        elements.add(Element { scale: 1.0 / radiance, ..element }, f64::from(PI * light.area * radiance));
    }
    if scene.has_sky() {
        let left = scene.transmittance(FAR);
        let (low, high) = entry_box(scene);
        let lights = scene.all_lights();
        let (rows, columns) = SKY_PARTS;
        let size = Vec2::new(2.0 / rows as f32, 1.0 / columns as f32);
        for part in 0..rows * columns {
            let corner = Vec2::new((part / columns) as f32 * size.x - 1.0, (part % columns) as f32 * size.y);
            let mut mean = 0.0f32;
            for k in 0..SKY_PLACES * SKY_PLACES {
                let step = |n: u32| (n as f32 + 0.5) / SKY_PLACES as f32;
                let z = corner.x + size.x * step(k / SKY_PLACES);
                let azimuth = corner.y + size.y * step(k % SKY_PLACES);
                let (s, c) = sin_cos_2pi(azimuth);
                let r = (1.0 - z * z).max(0.0).sqrt();
                let towards = Vec3::new(r * s, z, -r * c);
                let light = sky_radiance(&lights.sky, lights.sky_map, towards).max(Vec3::ZERO);
                mean += luminance(light * left) * area_across(low, high, towards) / (SKY_PLACES * SKY_PLACES) as f32;
            }
            // A part that is dark where it was looked at may hold a star: it keeps a thousandth of the mean sky.
            let least = 1e-3 * luminance(scene.lighting.sky.radiance * left);
            let power = f64::from(mean.max(least) * TAU * size.x * size.y);
            let element = Element { kind: ELEMENT_SKY, triangle: NONE, light: NONE, corner, ..Element::default() };
            let extent = Element { edge_a: size, ..element };
            let solid_angle = TAU * size.x * size.y;
            elements.add(Element { scale: solid_angle / power as f32, ..extent }, power);
        }
    }
}

/// The brightest texel under light elements.
struct Brightest {
    /// Greatest reflectance of each texture, channel by channel; none unless asked for.
    whole: Option<Vec<Vec3>>,
}

impl Brightest {
    fn new(scene: &Scene, texels: Texels) -> Self {
        let greatest = |texture: &scene::gpu::Texture| {
            (0..texture.width * texture.height)
                .map(|k| scene::kernel::texture::texel(&scene.geometry.texels, texture.offset + k).truncate())
                .fold(Vec3::ZERO, Vec3::max)
        };
        Self { whole: (texels == Texels::Bound).then(|| scene.geometry.textures.par_iter().map(greatest).collect()) }
    }

    /// Greatest reflectance under a light element, channel by channel; nothing for plain surfaces and without the
    /// bound.
    fn of(&self, scene: &Scene, light_element: &LightElement) -> Option<Vec3> {
        let whole = self.whole.as_ref()?;
        let material = &scene.materials[scene.geometry.triangles[light_element.triangle as usize].material as usize];
        let texture = scene.geometry.textures.get(material.albedo_texture as usize)?;
        let geometry = scene.tables();
        let size = Vec2::new(texture.width as f32, texture.height as f32);
        // In texels, row 0 on top; a filtered place reaches one texel further.
        let at = |c: Vec2| {
            let uv = geometry.texture_coordinate(light_element.triangle, c.x, c.y);
            Vec2::new(uv.x, 1.0 - uv.y) * size
        };
        let a = at(light_element.corners[0]);
        let b = at(light_element.corners[1]);
        let c = at(light_element.corners[2]);
        let low = a.min(b).min(c).floor() - 1.0;
        let high = a.max(b).max(c).ceil() + 1.0;
        let extent = high - low;
        if !extent.is_finite() || extent.x >= size.x || extent.y >= size.y {
            return whole.get(material.albedo_texture as usize).copied();
        }
        let mut greatest = Vec3::ZERO;
        for y in 0..=extent.y as u32 {
            for x in 0..=extent.x as u32 {
                let wrapped = |low: f32, k: u32, n: u32| (low as i64 + i64::from(k)).rem_euclid(i64::from(n)) as u32;
                let x = wrapped(low.x, x, texture.width);
                let y = wrapped(low.y, y, texture.height);
                let index = texture.offset + y * texture.width + x;
                greatest = greatest.max(scene::kernel::texture::texel(&scene.geometry.texels, index).truncate());
            }
        }
        Some(greatest)
    }
}
