//! The light of a bake.

use std::sync::Arc;

use patches::LightmapTexels;
use patchlight::bake::direct_params;
use patchlight::glam::{Vec3, Vec4};
use patchlight::method::{FeedbackSettings, TemporalSettings};
use patchlight::outputs::{LightPart, is_lit, lit_sides, on_lightmap};
use patchlight::scene::gpu::DirectParams;
use patchlight::scene::sampling::hash3;
use patchlight::scene::{NONE, POINT_WALKS, ReceiverSet as _, SidePolicy, Sky, find_sides, is_open};
use patchlight::transport::kernel::view::vertices_at;
use patchlight::{
    Bake, Codec, Cpu, LightSettings, Lighting, MethodSettings, Point, PointKind, PointSet, Scene, Silent, SurfacePoint,
};
use wasm_bindgen::prelude::*;

use crate::lights::lights;

/// Receivers of a lightmap look for their surface from so many ray offsets above it, and then from farther.
const LIFTS: [f32; 3] = [2.0, 16.0, 128.0];
/// Rays to each area light, and to the sky, from a texel.
const DIRECT_RAYS: u32 = 64;
/// Relative error of operators that are made here.
const EPSILON: f64 = 0.01;

/// The light of a bake on the CPU. Tables stay where they are until the next call that makes them: `pointer` and `length`
/// of each are places in the memory of the module, in numbers.
#[wasm_bindgen]
pub struct LightField {
    field: patchlight::LightField,
    lighting: Lighting,
    lightmap: Option<LightmapTexels>,
    /// The scene before the bake cut its triangles, where it is known: lightmaps are laid out on it.
    whole: Option<Scene>,
    /// What each receiver of such a lightmap takes from the interpolation points.
    rows: Vec<Row>,
    table: Vec<f32>,
    sets: Vec<Option<PointSet>>,
}

/// Interpolation points and their weights.
type Row = ([u32; 3], [f32; 3]);

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

    /// Corners of the triangles, m: nine numbers each, in the order of [`Self::lightmap_uvs`].
    pub fn triangles(&mut self) -> Table {
        let bake = Arc::clone(self.field.bake());
        let geometry = Arc::clone(&self.whole.as_ref().unwrap_or(bake.scene()).geometry);
        let triangles = geometry.triangles.iter();
        self.keep(triangles.flat_map(|t| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b]))
    }

    /// Makes a lightmap with texels of this size, m: its width and height.
    ///
    /// # Errors
    /// More texels than can be numbered.
    pub fn make_lightmap(&mut self, texel: f32) -> Result<Vec<u32>, String> {
        let bake = self.field.bake();
        let made = match &self.whole {
            Some(whole) => {
                let is_open = |point: &SurfacePoint| is_open(whole, point, POINT_WALKS, place_seed(point.position));
                LightmapTexels::new(whole, &find_sides(whole, SidePolicy::Lit), texel, &is_open)
            }
            None => LightmapTexels::new(bake.scene(), &lit_sides(bake), texel, &|point| is_lit(bake, point)),
        };
        let made = made.map_err(|error| error.to_string())?;
        self.rows = if self.whole.is_some() { rows_of(&made, bake) } else { Vec::new() };
        let size = vec![made.params.width, made.params.height];
        self.lightmap = Some(made);
        Ok(size)
    }

    /// Irradiance in the texels of the lightmap, W/m², row by row: RGB. With direct light, or without.
    ///
    /// # Errors
    /// No lightmap was made.
    pub fn lightmap(&mut self, is_direct: bool) -> Result<Table, String> {
        let texels = self.lightmap.as_ref().ok_or("no lightmap was made")?;
        let part = if is_direct { LightPart::Full } else { LightPart::Indirect };
        let values = match &self.whole {
            Some(whole) => {
                let irradiance = self.field.surface_irradiance().map_err(text)?;
                let lit = Scene::under(Arc::clone(&whole.geometry), self.lighting.clone());
                let lit = lit.map_err(|error| error.to_string())?;
                on_rows(&self.rows, &irradiance, &lit, texels, part)
            }
            None => on_lightmap(&mut self.field, texels, part).map_err(text)?,
        };
        let picture = texels.picture(&values).map_err(|error| error.to_string())?;
        Ok(self.keep(picture.into_iter().map(Vec4::truncate)))
    }

    /// Coordinates of the triangles' corners in the lightmap, six numbers each, 0 to 1; NaN without a chart.
    ///
    /// # Errors
    /// No lightmap was made.
    pub fn lightmap_uvs(&mut self, is_front: bool) -> Result<Table, String> {
        let texels = self.lightmap.as_ref().ok_or("no lightmap was made")?;
        let side = usize::from(!is_front);
        let corners = |at: u32| {
            let uv = &texels.uvs[at as usize];
            [uv.corner, uv.corner_a, uv.corner_b].map(|corner| corner.to_array())
        };
        let none = [[f32::NAN; 2]; 3];
        let of_sides = texels.sides.iter().map(|sides| sides[side]);
        self.table = of_sides.flat_map(|at| if at == NONE { none } else { corners(at) }).flatten().collect();
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
        Ok(Self { field, lighting, lightmap: None, whole: None, rows: Vec::new(), table: Vec::new(), sets: Vec::new() })
    }

    /// With the scene that was baked, whose triangles a page knows.
    #[cfg(feature = "bake")]
    pub(crate) fn with_whole(self, whole: Scene) -> Self {
        Self { whole: Some(whole), ..self }
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

fn place_seed(place: Vec3) -> u32 {
    let [x, y, z] = place.to_array().map(f32::to_bits);
    hash3(x, y, z)
}

/// What the receivers of a lightmap take from a bake of its scene: by a short ray onto their surface. Those that meet none
/// with light take the row of the receiver before them, a neighbour.
fn rows_of(lightmap: &LightmapTexels, bake: &Bake) -> Vec<Row> {
    let mesh = &bake.receivers().interpolation;
    let scene = bake.scene();
    let tables = scene.tables();
    let row = |point: &SurfacePoint| {
        LIFTS.iter().find_map(|lift| {
            let lift = lift * scene.geometry.ray_offset;
            let hit = scene.closest_before(point.position + point.normal * lift, -point.normal, 2.0 * lift);
            if hit.is_miss() {
                return None;
            }
            let front = tables.normal(hit.triangle).dot(point.normal) > 0.0;
            let (vertices, weights) = vertices_at(&mesh.grids, &mesh.cells, &mesh.vertices, hit, front);
            (vertices.x != NONE).then(|| (vertices.to_array(), weights.to_array()))
        })
    };
    let mut last = ([0; 3], [0.0; 3]);
    let rows = lightmap.points().iter().map(|point| {
        last = row(point).unwrap_or(last);
        last
    });
    rows.collect()
}

/// Irradiance at the receivers of a lightmap by their rows, with direct light where it is asked for.
fn on_rows(rows: &[Row], irradiance: &[Vec3], lit: &Scene, lightmap: &LightmapTexels, part: LightPart) -> Vec<Vec4> {
    let sum = |(vertices, weights): &Row| -> Vec3 {
        vertices
            .iter()
            .zip(weights)
            .map(|(&k, &weight)| irradiance.get(k as usize).copied().unwrap_or(Vec3::ZERO) * weight)
            .sum()
    };
    let mut values: Vec<Vec4> = rows.iter().map(|row| sum(row).extend(0.0)).collect();
    if part == LightPart::Full {
        let points = lightmap.points();
        let sky_rays = if lit.has_sky() { DIRECT_RAYS } else { 0 };
        let count = points.len() as u32;
        let params = DirectParams { count, area_rays: DIRECT_RAYS, sky_rays, ..direct_params(lit) };
        let direct = lit.direct_irradiance(&params, points);
        values.iter_mut().zip(direct).for_each(|(sum, direct)| *sum += direct.extend(0.0));
    }
    values
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
