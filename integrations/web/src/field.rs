//! The light of a bake.

use std::sync::Arc;

use patchlight::glam::{Vec2, Vec3};
use patchlight::method::{FeedbackSettings, TemporalSettings};
use patchlight::outputs::{LightPart, LiveLightmap};
use patchlight::scene::Sky;
use patchlight::scene::gpu::Triangle;
use patchlight::{Bake, Codec, Cpu, LightSettings, Lighting, MethodSettings, Point, PointKind, PointSet, Silent};
use wasm_bindgen::prelude::*;

use crate::lights::lights;

/// Relative error of operators that are made here.
const EPSILON: f64 = 0.01;

/// The light of a bake on the CPU. Tables stay where they are until the next call that makes them: `pointer` and `length`
/// of each are places in the memory of the module, in numbers.
#[wasm_bindgen]
pub struct LightField {
    field: patchlight::LightField,
    lighting: Lighting,
    lightmap: Option<LiveLightmap>,
    /// Corners of the triangles on which it lies.
    corners: Vec<[Vec3; 3]>,
    table: Vec<f32>,
    sets: Vec<Option<PointSet>>,
}

/// A table of numbers in the memory of the module.
#[wasm_bindgen]
#[derive(Clone, Copy)]
pub struct Table {
    /// Its first byte.
    pub pointer: usize,
    /// Numbers.
    pub length: usize,
}

#[wasm_bindgen]
impl LightField {
    /// The light of a bake whose bytes these are, by "classic", "low_rank", "multibounce", "feedback" or "temporal".
    /// `name` is what errors call it.
    ///
    /// # Errors
    /// No bake, another version, bytes that were altered or cut; another method.
    #[wasm_bindgen(constructor)]
    pub fn new(name: &str, bytes: Vec<u8>, method: &str) -> Result<Self, String> {
        Self::of_bake(Bake::from_bytes(name, bytes).map_err(text)?.bake, method)
    }

    /// Sets the lights of the next update by rows of [`crate::LIGHT_NUMBERS`] numbers.
    ///
    /// # Errors
    /// What is wrong with which light.
    pub fn set_lights(&mut self, numbers: &[f32]) -> Result<(), String> {
        self.lighting.lights = lights(numbers)?;
        Ok(())
    }

    /// Sets a sky that is the same everywhere, W/m²/sr.
    ///
    /// # Errors
    /// Numbers that are negative or none.
    pub fn set_sky(&mut self, red: f32, green: f32, blue: f32) -> Result<(), String> {
        self.lighting.sky = Sky { radiance: radiance(red, green, blue)?, ..Sky::default() };
        self.lighting.sky_map = Arc::new([]);
        Ok(())
    }

    /// Sets what a material shines with, W/m²/sr.
    ///
    /// # Errors
    /// A material that is not there; numbers that are negative or none.
    pub fn set_emission(&mut self, material: usize, red: f32, green: f32, blue: f32) -> Result<(), String> {
        let materials = &self.field.bake().scene().geometry.materials;
        if self.lighting.emission.is_empty() {
            self.lighting.emission = materials.iter().map(|material| material.radiance).collect();
        }
        let count = self.lighting.emission.len();
        let place =
            self.lighting.emission.get_mut(material).ok_or_else(|| format!("material {material} of {count}"))?;
        *place = radiance(red, green, blue)?;
        Ok(())
    }

    /// Finds the light; the number of the update.
    ///
    /// # Errors
    /// Lights that cannot be.
    pub fn update(&mut self) -> Result<u32, String> {
        Ok(self.field.update(&self.lighting).map_err(text)?.number)
    }

    /// Indirect irradiance at the interpolation points of the surfaces, W/m²: RGB.
    ///
    /// # Errors
    /// None on the CPU.
    pub fn surface(&mut self) -> Result<Table, String> {
        let values = self.field.surface_irradiance().map_err(text)?;
        Ok(self.keep(values.into_iter()))
    }

    /// Positions of the interpolation points, m.
    pub fn surface_points(&mut self) -> Table {
        let bake = Arc::clone(self.field.bake());
        self.keep(bake.receivers().interpolation.points.iter().map(|point| point.position))
    }

    /// Corners of the bake's triangles, m, nine numbers each: it cuts triangles where something stands on them.
    pub fn triangles(&mut self) -> Table {
        let corners = self.own_corners();
        self.keep(corners.into_iter().flatten())
    }

    /// Makes a lightmap with texels of this size, m, on triangles whose corners these are, nine numbers each; on the bake's own
    /// for none. Its width and height.
    ///
    /// # Errors
    /// Numbers that are no triangles; more texels than can be numbered.
    pub fn make_lightmap(&mut self, texel: f32, corners: &[f32]) -> Result<Vec<u32>, String> {
        if !corners.len().is_multiple_of(9) {
            return Err(format!("{} numbers are no triangles, of nine each", corners.len()));
        }
        let triangle = |own: &[f32]| [0, 3, 6].map(|first| Vec3::from_slice(&own[first..]));
        self.corners = match corners {
            [] => self.own_corners(),
            _ => corners.chunks_exact(9).map(triangle).collect(),
        };
        let made = LiveLightmap::over(self.field.bake(), &self.corners, texel).map_err(text)?;
        let (width, height) = made.size();
        self.lightmap = Some(made);
        Ok(vec![width, height])
    }

    /// Irradiance in the texels of the lightmap, W/m², row by row: RGB. "indirect", "full", or "without_lights": all but the
    /// direct light of lights.
    ///
    /// # Errors
    /// No lightmap was made; another part.
    pub fn lightmap(&mut self, part: &str) -> Result<Table, String> {
        let part = match part {
            "indirect" => LightPart::Indirect,
            "full" => LightPart::Full,
            "without_lights" => LightPart::WithoutLights,
            _ => return Err(format!("part is {part:?}; it is indirect, full or without_lights")),
        };
        let lightmap = self.lightmap.as_mut().ok_or("no lightmap was made")?;
        let values = lightmap.irradiance(&mut self.field, part).map_err(text)?;
        let picture = lightmap.picture(&values);
        Ok(self.keep(picture.into_iter()))
    }

    /// Coordinates in the lightmap of the corners of its triangles, six numbers each, 0 to 1; NaN for those without light.
    ///
    /// # Errors
    /// No lightmap was made.
    pub fn lightmap_uvs(&mut self) -> Result<Table, String> {
        let lightmap = self.lightmap.as_ref().ok_or("no lightmap was made")?;
        let uvs = lightmap.corner_uvs(&self.corners).into_iter();
        let numbers = |uvs: Option<[Vec2; 3]>| uvs.unwrap_or([Vec2::NAN; 3]).map(|corner| corner.to_array());
        self.table = uvs.flat_map(numbers).flatten().collect();
        Ok(self.kept())
    }

    /// Adds points whose indirect light every update finds from now on: places and normals, three numbers each. "irradiance",
    /// "cube" (six values a point: +x, -x, +y, -y, +z, -z) or "harmonics" (four: L_00, L_1x, L_1y, L_1z).
    ///
    /// # Errors
    /// Tables of unlike lengths; another kind.
    pub fn add_points(&mut self, places: &[f32], normals: &[f32], kind: &str) -> Result<usize, String> {
        let kind = match kind {
            "irradiance" => PointKind::Irradiance,
            "cube" => PointKind::Cube,
            "harmonics" => PointKind::HarmonicsL1,
            _ => return Err(format!("kind is {kind:?}; it is irradiance, cube or harmonics")),
        };
        if places.len() != normals.len() || !places.len().is_multiple_of(3) {
            return Err(format!("{} numbers of places, {} of normals", places.len(), normals.len()));
        }
        let vectors = |numbers: &[f32]| numbers.chunks_exact(3).map(Vec3::from_slice).collect::<Vec<_>>();
        let pairs = vectors(places).into_iter().zip(vectors(normals));
        let points: Vec<Point> = pairs.map(|(position, normal)| Point { position, normal }).collect();
        let set = self.field.add_points(&points, kind, &Silent).map_err(text)?;
        self.sets.push(Some(set));
        Ok(self.sets.len() - 1)
    }

    /// Removes points.
    ///
    /// # Errors
    /// A set that is not there.
    pub fn remove_points(&mut self, set: usize) -> Result<(), String> {
        let own = self.set(set)?;
        self.sets[set] = None;
        self.field.remove_points(own).map_err(text)
    }

    /// Light of points: RGB of each value.
    ///
    /// # Errors
    /// A set that is not there.
    pub fn points(&mut self, set: usize) -> Result<Table, String> {
        let light = self.field.read(self.set(set)?).map_err(text)?;
        Ok(self.keep(light.values.into_iter()))
    }

    /// Triangles, patches, receivers and interpolation points of the bake.
    pub fn counts(&self) -> Vec<u32> {
        let bake = self.field.bake();
        let receivers = bake.receivers();
        let counts = [
            bake.scene().geometry.triangles.len(),
            bake.mesh().patches.len(),
            receivers.points.len(),
            receivers.interpolation.points.len(),
        ];
        counts.map(|count| count as u32).to_vec()
    }
}

impl LightField {
    /// The light of a bake.
    ///
    /// # Errors
    /// Another method; a bake that it does not serve.
    pub(crate) fn of_bake(bake: Bake, method: &str) -> Result<Self, String> {
        let method = match method {
            "classic" => MethodSettings::Classic,
            "low_rank" => MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON }),
            "multibounce" => MethodSettings::Multibounce(Codec::Dense),
            "feedback" => MethodSettings::Feedback(FeedbackSettings::default()),
            "temporal" => MethodSettings::Temporal(TemporalSettings::default()),
            _ => {
                let names = "classic, low_rank, multibounce, feedback or temporal";
                return Err(format!("method is {method:?}; it is {names}"));
            }
        };
        let bake = Arc::new(bake);
        let lighting = bake.scene().lighting.clone();
        let settings = LightSettings::default().with_method(method);
        let field = patchlight::LightField::new(bake, Box::new(Cpu::new()), &settings, &Silent).map_err(text)?;
        Ok(Self { field, lighting, lightmap: None, corners: Vec::new(), table: Vec::new(), sets: Vec::new() })
    }

    fn own_corners(&self) -> Vec<[Vec3; 3]> {
        let corners = |t: &Triangle| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b];
        self.field.bake().scene().geometry.triangles.iter().map(corners).collect()
    }

    fn set(&self, set: usize) -> Result<PointSet, String> {
        self.sets.get(set).copied().flatten().ok_or_else(|| format!("there is no point set {set}"))
    }

    /// Keeps values as the table that a page reads.
    fn keep(&mut self, values: impl Iterator<Item = Vec3>) -> Table {
        self.table.clear();
        self.table.extend(values.flat_map(|value| value.to_array()));
        self.kept()
    }

    fn kept(&self) -> Table {
        Table { pointer: self.table.as_ptr() as usize, length: self.table.len() }
    }

    /// The numbers of the table that was made last, for programs that are not pages.
    pub fn numbers(&self) -> &[f32] {
        &self.table
    }
}

pub(crate) fn radiance(red: f32, green: f32, blue: f32) -> Result<Vec3, String> {
    let radiance = Vec3::new(red, green, blue);
    if radiance.is_finite() && radiance.min_element() >= 0.0 {
        Ok(radiance)
    } else {
        Err(format!("radiance is {radiance}; it is three numbers, none negative"))
    }
}

pub(crate) fn text(error: patchlight::Error) -> String {
    error.to_string()
}
