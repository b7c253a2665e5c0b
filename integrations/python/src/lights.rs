//! Lights and skies.

use std::path::Path;
use std::sync::Arc;

use assets::import::luminaire;
use numpy::{PyReadonlyArray3, PyUntypedArrayMethods as _};
use patchlight::glam::{Vec3, Vec4};
use patchlight::scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_LUMINAIRE, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT};
use patchlight::scene::{self, SurfaceLight};
use patchlight::{Flux, Intensity, Irradiance, Lighting, Radiance};
use pyo3::prelude::*;

use crate::error::input;
use crate::work::warn;

/// A quantity by one of its units: RGB in the radiometric one, or a number in the photometric one.
type Rgb = (f32, f32, f32);

fn vector((x, y, z): Rgb) -> Vec3 {
    Vec3::new(x, y, z)
}

/// A light; see `patchlight.Light` for its constructors.
#[pyclass(frozen, module = "patchlight._core")]
#[derive(Clone)]
pub struct Light {
    pub light: scene::Light,
    /// The table that a luminaire's distribution stands in.
    pub distributions: Arc<[f32]>,
}

impl Light {
    fn of(light: scene::Light) -> Self {
        Self { light, distributions: Arc::new([]) }
    }
}

#[pymethods]
impl Light {
    #[staticmethod]
    fn sun(direction: Rgb, irradiance: Rgb) -> Self {
        Self::of(scene::Light::sun(vector(direction), Irradiance(vector(irradiance))))
    }

    #[staticmethod]
    fn point(position: Rgb, intensity: Rgb) -> Self {
        Self::of(scene::Light::point(vector(position), Intensity(vector(intensity))))
    }

    #[staticmethod]
    fn spot(position: Rgb, direction: Rgb, inner: f32, outer: f32, intensity: Rgb) -> Self {
        let angles = (inner, outer);
        Self::of(scene::Light::spot(vector(position), vector(direction), angles, Intensity(vector(intensity))))
    }

    #[staticmethod]
    fn rectangle(corner: Rgb, edge_a: Rgb, edge_b: Rgb, radiance: Rgb) -> Self {
        let edges = (vector(edge_a), vector(edge_b));
        Self::of(scene::Light::rectangle(vector(corner), edges, SurfaceLight::Radiance(Radiance(vector(radiance)))))
    }

    /// A measured luminaire from an IES or EULUMDAT file; the flux of the file, or so many lumens.
    #[staticmethod]
    #[pyo3(signature = (path, position, axis, across, lumens, tint, lamp_set))]
    fn luminaire(
        py: Python<'_>,
        path: &str,
        position: Rgb,
        axis: Rgb,
        across: Rgb,
        lumens: Option<f32>,
        tint: Rgb,
        lamp_set: usize,
    ) -> PyResult<Self> {
        let photometry = luminaire::read(Path::new(path), lamp_set)
            .map_err(|error| crate::error::FileError::new_err(error.to_string()))?;
        for text in &photometry.warnings {
            warn(py, text)?;
        }
        let flux = Flux::lumens(lumens.unwrap_or(photometry.flux() as f32)).tinted(vector(tint));
        let mut table = Vec::new();
        let begin = photometry.distribution.append_to(&mut table).map_err(input)?;
        let direction = vector(axis).normalize_or_zero();
        let light = scene::Light {
            kind: LIGHT_LUMINAIRE,
            position: vector(position),
            direction,
            edge_a: vector(across).reject_from(direction).normalize_or_zero(),
            color: Intensity::from(flux).0,
            distribution: begin,
            ..scene::Light::default()
        };
        Ok(Self { light, distributions: table.into() })
    }

    /// The same light, so many times as bright.
    fn scaled(&self, factor: Rgb) -> Self {
        let light = scene::Light { color: self.light.color * vector(factor), ..self.light };
        Self { light, ..self.clone() }
    }

    /// The same light elsewhere.
    fn moved(&self, position: Rgb) -> Self {
        Self { light: scene::Light { position: vector(position), ..self.light }, ..self.clone() }
    }

    #[getter]
    fn kind(&self) -> &'static str {
        match self.light.kind {
            LIGHT_DIRECTIONAL => "sun",
            LIGHT_POINT => "point",
            LIGHT_SPOT => "spot",
            LIGHT_RECT => "rectangle",
            _ => "luminaire",
        }
    }

    #[getter]
    fn position(&self) -> (f32, f32, f32) {
        self.light.position.into()
    }

    #[getter]
    fn direction(&self) -> (f32, f32, f32) {
        self.light.direction.into()
    }

    /// Irradiance of a sun, radiance of a rectangle, radiant intensity of the others.
    #[getter]
    fn color(&self) -> (f32, f32, f32) {
        self.light.color.into()
    }

    fn __repr__(&self) -> String {
        let unit = match self.light.kind {
            LIGHT_DIRECTIONAL => "W/m²",
            LIGHT_RECT => "W/m²/sr",
            _ => "W/sr",
        };
        let [r, g, b] = self.light.color.to_array();
        let place = if self.light.kind == LIGHT_DIRECTIONAL { self.light.direction } else { self.light.position };
        format!("Light.{}({}, {}, {}; {r:.4}, {g:.4}, {b:.4} {unit})", self.kind(), place.x, place.y, place.z)
    }
}

/// A sky; see `patchlight.Sky` for its constructors.
#[pyclass(frozen, module = "patchlight._core")]
#[derive(Clone)]
pub struct Sky {
    pub sky: scene::Sky,
    pub map: Arc<[Vec4]>,
}

#[pymethods]
impl Sky {
    #[staticmethod]
    fn constant(radiance: Rgb) -> Self {
        let sky = scene::Sky { radiance: vector(radiance), ..scene::Sky::default() };
        Self { sky, map: Arc::new([]) }
    }

    /// An equirectangular map of radiances, row by row from the zenith; its middle column is −z.
    #[staticmethod]
    fn map(radiances: PyReadonlyArray3<f32>) -> PyResult<Self> {
        let [height, width, channels] = [0, 1, 2].map(|axis| radiances.shape()[axis]);
        if channels != 3 || height == 0 || width == 0 {
            return Err(input(format!("a map of {height} x {width} x {channels} numbers; give rows, columns and RGB")));
        }
        let numbers = radiances.as_slice().map_err(|_| input("the map is not contiguous"))?;
        if let Some(at) = numbers.iter().position(|x| !(*x >= 0.0 && x.is_finite())) {
            return Err(input(format!(
                "the map's number {at} is {}; radiances are finite and not negative",
                numbers[at]
            )));
        }
        let map = numbers.chunks_exact(3).map(|rgb| Vec4::new(rgb[0], rgb[1], rgb[2], 0.0)).collect();
        let (map_width, map_height) = (width as u32, height as u32);
        Ok(Self { sky: scene::Sky { radiance: Vec3::ONE, map_width, map_height, ..scene::Sky::default() }, map })
    }

    /// Radiance of a sky without a map, W/m²/sr; 0 of one with a map.
    #[getter]
    fn constant_radiance(&self) -> (f32, f32, f32) {
        let radiance = if self.sky.map_width == 0 { self.sky.radiance } else { Vec3::ZERO };
        radiance.into()
    }

    /// The same sky, so many times as bright.
    fn scaled(&self, factor: Rgb) -> Self {
        let sky = scene::Sky { radiance: self.sky.radiance * vector(factor), ..self.sky };
        Self { sky, map: Arc::clone(&self.map) }
    }

    fn __repr__(&self) -> String {
        let [r, g, b] = self.sky.radiance.to_array();
        match self.sky.map_width {
            0 => format!("Sky.constant({r:.4}, {g:.4}, {b:.4} W/m²/sr)"),
            width => format!("Sky.map({} x {width})", self.sky.map_height),
        }
    }
}

/// What shines, for a scene: these lights and this sky, with the emission of its materials or another one.
pub fn lighting(lights: &[PyRef<'_, Light>], sky: Option<&Sky>, emission: &[Vec3]) -> Lighting {
    let mut own = Vec::new();
    let mut distributions: Vec<f32> = Vec::new();
    let mut tables: Vec<(Arc<[f32]>, u32)> = Vec::new();
    for light in lights {
        let mut copy = light.light;
        if copy.kind == LIGHT_LUMINAIRE {
            let known = tables.iter().find(|(table, _)| Arc::ptr_eq(table, &light.distributions));
            let begin = known.map(|&(_, begin)| begin).unwrap_or_else(|| {
                let begin = distributions.len() as u32;
                distributions.extend_from_slice(&light.distributions);
                tables.push((Arc::clone(&light.distributions), begin));
                begin
            });
            copy.distribution += begin;
        }
        own.push(copy);
    }
    let (sky, sky_map) = match sky {
        Some(sky) => (sky.sky, Arc::clone(&sky.map)),
        None => (scene::Sky::default(), Arc::from([])),
    };
    Lighting { lights: own, sky, sky_map, emission: emission.to_vec(), distributions: distributions.into() }
}

/// Lights and sky of a scene.
pub fn of_lighting(lighting: &Lighting) -> (Vec<Light>, Sky) {
    let distributions = &lighting.distributions;
    let lights = lighting.lights.iter().map(|&light| Light { light, distributions: Arc::clone(distributions) });
    (lights.collect(), Sky { sky: lighting.sky, map: Arc::clone(&lighting.sky_map) })
}
