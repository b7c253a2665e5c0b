//! The light of a bake.

use std::sync::Arc;

use patchlight::glam::{Affine3A, Vec2, Vec3};
use patchlight::method::{FeedbackSettings, TemporalSettings};
use patchlight::outputs::{LightPart, LiveLightmap};
use patchlight::scene::Sky;
use patchlight::scene::gpu::Triangle;
use patchlight::{
    Bake, Codec, Cpu, LightSettings, Lighting, MaterialId, Mesh, MethodSettings, ObjectId, Point, PointKind, PointSet,
    Silent,
};
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
    objects: Vec<Option<ObjectId>>,
    /// Reflectance that materials were given.
    paint: Vec<Option<Vec3>>,
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

    /// Paints a material with a reflectance, 0 to 0.95, all over; with no numbers as the bake has it. By the methods "classic",
    /// "feedback" and "temporal".
    ///
    /// # Errors
    /// A material that is not there; numbers that are no colour; another method.
    pub fn paint(&mut self, material: usize, reflectance: &[f32]) -> Result<(), String> {
        let mut paint = self.paint.clone();
        paint.resize(self.field.bake().scene().geometry.materials.len(), None);
        let count = paint.len();
        let place = paint.get_mut(material).ok_or_else(|| format!("material {material} of {count}"))?;
        *place = match *reflectance {
            [] => None,
            [red, green, blue] => Some(Vec3::new(red, green, blue)),
            _ => return Err(format!("a color has 3 numbers, not {}", reflectance.len())),
        };
        self.field.set_albedo(&paint).map_err(text)?;
        self.paint = paint;
        Ok(())
    }

    /// Adds a closed mesh that moves, of a few hundred triangles whose corners these are, nine numbers each, at a place: a
    /// column-major matrix of 16 numbers. Its number.
    ///
    /// # Errors
    /// Numbers that are no mesh, no place, or flatten; a material that is not there.
    pub fn add_object(&mut self, corners: &[f32], material: usize, place: &[f32]) -> Result<usize, String> {
        if !corners.len().is_multiple_of(9) {
            return Err(format!("{} numbers are no triangles, of nine each", corners.len()));
        }
        let positions: Vec<Vec3> = corners.chunks_exact(3).map(Vec3::from_slice).collect();
        let indices: Vec<u32> = (0..positions.len() as u32).collect();
        let material = MaterialId::of_scene(material);
        let mesh = Mesh { name: "object", positions: &positions, indices: &indices, material, ..Mesh::default() };
        let object = self.field.objects().insert(&mesh, affine(place)?).map_err(text)?;
        self.objects.push(Some(object));
        Ok(self.objects.len() - 1)
    }

    /// Moves an object, from the next update on.
    ///
    /// # Errors
    /// An object that is not there; numbers that are no place, or flatten.
    pub fn move_object(&mut self, object: usize, place: &[f32]) -> Result<(), String> {
        let own = self.object(object)?;
        self.field.objects().set_transform(own, affine(place)?).map(drop).map_err(text)
    }

    /// Removes an object.
    ///
    /// # Errors
    /// An object that is not there.
    pub fn remove_object(&mut self, object: usize) -> Result<(), String> {
        let own = self.object(object)?;
        self.objects[object] = None;
        self.field.objects().remove(own).map_err(text)
    }

    /// The bake's own estimate of its error: mean of its indirect light over that of rays, less 1, and the standard error of
    /// that; none where it knows nothing.
    pub fn error(&self) -> Vec<f64> {
        let near = self.field.bake().energy().and_then(|energy| energy.near);
        near.map_or(Vec::new(), |near| vec![near.ratio - 1.0, near.standard_error])
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

    /// Rays from each texel of the lightmap to each material that shines, and to the sky; traced anew.
    ///
    /// # Errors
    /// No lightmap was made.
    pub fn set_rays(&mut self, rays: u32) -> Result<(), String> {
        self.lightmap.as_mut().ok_or("no lightmap was made")?.set_rays(rays);
        Ok(())
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
        Ok(Self {
            field,
            lighting,
            lightmap: None,
            corners: Vec::new(),
            table: Vec::new(),
            sets: Vec::new(),
            objects: Vec::new(),
            paint: Vec::new(),
        })
    }

    fn own_corners(&self) -> Vec<[Vec3; 3]> {
        let corners = |t: &Triangle| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b];
        self.field.bake().scene().geometry.triangles.iter().map(corners).collect()
    }

    fn set(&self, set: usize) -> Result<PointSet, String> {
        self.sets.get(set).copied().flatten().ok_or_else(|| format!("there is no point set {set}"))
    }

    fn object(&self, object: usize) -> Result<ObjectId, String> {
        self.objects.get(object).copied().flatten().ok_or_else(|| format!("there is no object {object}"))
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

/// A place by a column-major matrix.
fn affine(numbers: &[f32]) -> Result<Affine3A, String> {
    let [x0, x1, x2, _, y0, y1, y2, _, z0, z1, z2, _, w0, w1, w2, _] = *numbers else {
        return Err(format!("a place is a matrix of 16 numbers, not of {}", numbers.len()));
    };
    Ok(Affine3A::from_cols_array(&[x0, x1, x2, y0, y1, y2, z0, z1, z2, w0, w1, w2]))
}

pub(crate) fn text(error: patchlight::Error) -> String {
    error.to_string()
}
