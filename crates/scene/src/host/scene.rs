//! Geometry under lights.

use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;
use core::cell::Cell;
use core::mem;

use glam::{Vec3, Vec4};

use super::geometry::{Geometry, Occluder, filtered_albedo, texel_count};
use super::groups::group_emitters;
use super::hierarchy::is_sound;
use super::lighting::{Lighting, check_sky_map, find_emitters, set_emission};
use crate::Visibility;
use crate::error::{Error, ReflectanceFault};
use crate::gpu::*;
use crate::kernel::GeometryTables;
use crate::kernel::light::{Lights, direct_irradiance};
use crate::kernel::medium::{Absorbing, transmittance};
use crate::kernel::texture::texel;
use crate::kernel::walk::Lamps;
use crate::parallel::*;

/// Parts of a scene: the input of [`Scene::new`].
#[derive(Clone, Debug, Default)]
pub struct SceneParts {
    /// Triangles in any order, `[n]`, m.
    pub triangles: Vec<Triangle>,
    /// Texture coordinates and normals, `[n]`.
    pub uvs: Vec<TriangleUv>,
    /// Materials.
    pub materials: Vec<Material>,
    /// What pictures show of the first of them beside that; those of the rest are diffuse and even.
    pub finishes: Vec<Finish>,
    /// Pictures.
    pub textures: Vec<Texture>,
    /// Texels of all pictures, two words each.
    pub texels: Vec<u32>,
    /// Lights that are not geometry.
    pub lights: Vec<Light>,
    /// The sky.
    pub sky: Sky,
    /// Its map, `map_width · map_height` texels.
    pub sky_map: Vec<Vec4>,
    /// Distributions of luminaires, one after the other.
    pub distributions: Vec<f32>,
    /// Distance by which rays start above a surface, m; `None` for [`Geometry::ray_offset`]'s rule.
    pub ray_offset: Option<f32>,
    /// Absorption of the medium between surfaces, 1/m; 0 for air.
    pub absorption: Vec3,
}

/// Geometry under lights, ready for rays. A clone shares the geometry.
///
/// ```
/// use glam::Vec3;
/// use patchlight_scene::gpu::{Triangle, TriangleUv};
/// use patchlight_scene::{Lighting, Material, Scene, SceneParts, Sky};
///
/// let day = Scene::new(SceneParts {
///     triangles: vec![Triangle { edge_a: Vec3::Z, edge_b: Vec3::X, ..Triangle::default() }],
///     uvs: vec![TriangleUv::default()],
///     materials: vec![Material::default()],
///     ..SceneParts::default()
/// })?;
/// // The same triangles, now bright themselves.
/// let night = Lighting { emission: vec![Vec3::ONE], ..Lighting::default() };
/// let night = Scene::under(day.geometry.clone(), night)?;
/// assert_eq!((day.emitters.len(), night.emitters.len()), (0, 1));
/// # Ok::<(), patchlight_scene::Error>(())
/// ```
#[derive(Clone)]
pub struct Scene {
    /// The immutable part.
    pub geometry: Arc<Geometry>,
    /// Materials with the emission of the lighting. Their reflectance may be changed by
    /// [`Arc::make_mut`].
    pub materials: Arc<[Material]>,
    /// Emissive triangles with their cumulative distribution.
    pub emitters: Arc<[Emitter]>,
    /// Near ones of them together, where they are many.
    pub emitter_groups: Arc<[EmitterGroup]>,
    /// Light sources. Lights and sky may be changed in place; emission changes by [`Scene::set_lighting`], for
    /// materials and emitters follow from it.
    pub lighting: Lighting,
}

impl Scene {
    /// Checks the parts, builds the hierarchy and sorts the triangles into its leaf order.
    ///
    /// # Errors
    /// Names the triangle or material that is wrong: [`Error`].
    pub fn new(mut parts: SceneParts) -> Result<Self, Error> {
        check(&parts)?;
        let lighting = take_lighting(&mut parts);
        let geometry = Geometry::build(parts)?;
        Self::under(Arc::new(geometry), lighting)
    }

    /// As [`Scene::new`], from triangles in the leaf order of a hierarchy that is there already, root first: their
    /// numbers, and with them all random numbers, are the same as where it was built.
    ///
    /// # Errors
    /// As [`Scene::new`], and [`Error::Hierarchy`] where the nodes are no tree, or a leaf names a triangle that is not
    /// there.
    pub fn with_hierarchy(mut parts: SceneParts, nodes: Vec<BvhNode>) -> Result<Self, Error> {
        check(&parts)?;
        if !is_sound(&nodes, parts.triangles.len()) {
            return Err(Error::Hierarchy);
        }
        let lighting = take_lighting(&mut parts);
        let geometry = Geometry::of_leaves(parts, nodes)?;
        Self::under(Arc::new(geometry), lighting)
    }

    /// Geometry that is there already, under these lights.
    ///
    /// # Errors
    /// [`Error::EmissionLength`] where the emission is not of one value a material,
    /// [`Error::TableLength`] where the sky's map is not of the size that the sky says,
    /// [`Error::LightDistribution`] and [`Error::Distribution`] where those of luminaires are not there or no numbers.
    pub fn under(geometry: Arc<Geometry>, lighting: Lighting) -> Result<Self, Error> {
        lighting.check(&geometry)?;
        lighting.check_distributions()?;
        let mut materials = geometry.materials.clone();
        set_emission(&mut materials, &lighting, &geometry);
        let tables = geometry.tables_with(&materials);
        let emitters: Arc<[Emitter]> = find_emitters(&tables).into();
        let emitter_groups = group_emitters(&tables, &emitters).into();
        Ok(Self { geometry, materials, emitters, emitter_groups, lighting })
    }

    /// Replaces the lighting. Emitters are found anew only where emission has changed.
    ///
    /// # Errors
    /// As [`Scene::under`]; the scene is then left as it was.
    pub fn set_lighting(&mut self, lighting: Lighting) -> Result<(), Error> {
        lighting.check(&self.geometry)?;
        if !Arc::ptr_eq(&lighting.distributions, &self.lighting.distributions) {
            lighting.check_distributions()?;
        }
        if set_emission(&mut self.materials, &lighting, &self.geometry) {
            self.emitters = find_emitters(&self.tables()).into();
            self.emitter_groups = group_emitters(&self.tables(), &self.emitters).into();
        }
        self.lighting = lighting;
        Ok(())
    }

    /// Takes a geometry with the same materials, whose meshes that move stand elsewhere. Returns true if some of them
    /// shine: emitters are found anew then.
    pub fn set_moved(&mut self, geometry: Arc<Geometry>) -> bool {
        self.geometry = geometry;
        let mut moving = self.geometry.moving();
        let shines = moving.any(|t| {
            let material = self.geometry.triangles[t].material;
            self.materials[material as usize].radiance != Vec3::ZERO
        });
        if shines {
            self.emitters = find_emitters(&self.tables()).into();
            self.emitter_groups = group_emitters(&self.tables(), &self.emitters).into();
        }
        shines
    }

    /// Replaces the lights that are not geometry. Luminaires among them must pass [`Lighting::check_lights`].
    pub fn set_lights(&mut self, lights: &[Light]) {
        self.lighting.lights.clear();
        self.lighting.lights.extend_from_slice(lights);
    }

    /// The scene with every triangle flat: pictures then show the surfaces that light is computed for, as most references
    /// do.
    #[must_use]
    pub fn flat(mut self) -> Self {
        if self.geometry.uvs.iter().any(|uv| uv.normal != 0) {
            for uv in &mut Arc::make_mut(&mut self.geometry).uvs {
                *uv = TriangleUv { normal: 0, normal_a: 0, normal_b: 0, ..*uv };
            }
        }
        self
    }

    /// The tables that rays need, as the kernels take them, with the emission of the lighting.
    pub fn tables(&self) -> GeometryTables<'_> {
        self.geometry.tables_with(&self.materials)
    }

    /// [`Scene::tables`] with the host's own hierarchy: kernels' bodies that run on the host find the same hits sooner
    /// with it.
    pub fn host_tables(&self) -> GeometryTables<'_> {
        GeometryTables { hierarchy: self.geometry.hierarchy(), ..self.tables() }
    }

    /// Light sources beside the sky, for walks.
    pub fn lamps(&self) -> Lamps<'_> {
        Lamps { lights: &self.lighting.lights, emitters: &self.emitters }
    }

    /// Settings of random walks in this scene.
    pub fn walk_params(&self, walks: u32, seed: u32) -> WalkParams {
        WalkParams {
            count: 0,
            walks,
            seed,
            light_count: self.lighting.lights.len() as u32,
            emitter_count: self.emitters.len() as u32,
            ray_offset: self.geometry.ray_offset,
            first_walk: 0,
            end_walk: walks,
        }
    }

    /// Everything that shines, as the kernels take it.
    pub fn all_lights(&self) -> Lights<'_> {
        Lights {
            lights: &self.lighting.lights,
            emitters: &self.emitters,
            sky: self.lighting.sky,
            sky_map: &self.lighting.sky_map,
            distributions: &self.lighting.distributions,
        }
    }

    /// Returns true if the sky sends any light.
    pub fn has_sky(&self) -> bool {
        self.lighting.has_sky()
    }

    /// Returns true if a medium between surfaces absorbs light.
    pub fn has_medium(&self) -> bool {
        self.geometry.absorption != Vec3::ZERO
    }

    /// The first material that mirrors light or lets it through, if any triangle has one.
    pub fn specular_material(&self) -> Option<usize> {
        if !self.materials.iter().any(Material::is_specular) {
            return None;
        }
        let mut is_used = vec![false; self.materials.len()];
        self.geometry.triangles.iter().for_each(|t| is_used[t.material as usize] = true);
        (0..is_used.len()).find(|&material| is_used[material] && self.materials[material].is_specular())
    }

    /// Share of light that is left after a way of `distance` m ([`crate::kernel::medium::transmittance`]).
    pub fn transmittance(&self, distance: f32) -> Vec3 {
        transmittance(self.geometry.absorption, distance)
    }

    /// [`Geometry::diagonal`].
    pub fn diagonal(&self) -> f32 {
        self.geometry.diagonal()
    }

    /// [`Geometry::closest_before`].
    #[inline]
    pub fn closest_before(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Hit {
        self.geometry.closest_before(origin, direction, t_max)
    }

    /// [`Geometry::occluded`].
    #[inline]
    pub fn occluded(&self, origin: Vec3, direction: Vec3, t_max: f32) -> bool {
        self.geometry.occluded(origin, direction, t_max)
    }

    /// [`Geometry::occluded_again`].
    #[inline]
    pub fn occluded_again(&self, origin: Vec3, direction: Vec3, t_max: f32, last: &Cell<Occluder>) -> bool {
        self.geometry.occluded_again(origin, direction, t_max, last)
    }

    /// [`Geometry::longest_edge`].
    pub fn longest_edge(&self, triangle: u32) -> f32 {
        self.geometry.longest_edge(triangle)
    }

    /// [`Geometry::shares`].
    pub fn shares(&self, triangle: u32, position: Vec3) -> (f32, f32) {
        self.geometry.shares(triangle, position)
    }

    /// [`Geometry::filtered_albedo`] with this scene's materials.
    pub fn filtered_albedo(&self, triangle: u32, position: Vec3, area: f32) -> Vec3 {
        filtered_albedo(&self.tables(), triangle, self.shares(triangle, position), area)
    }

    /// Direct irradiance at many points, W/m², on all cores:
    /// [`direct_irradiance`] with this scene's rays and medium.
    pub fn direct_irradiance(&self, p: &DirectParams, points: &[SurfacePoint]) -> Vec<Vec3> {
        let medium = Absorbing(self.geometry.absorption);
        let tables = self.tables();
        let lights = self.all_lights();
        let occluded = |origin: Vec3, direction: Vec3, t_max: f32| self.occluded(origin, direction, t_max);
        points
            .par_iter()
            .enumerate()
            .map(|(k, point)| direct_irradiance(&tables, p, p.first + k as u32, *point, &lights, medium, occluded))
            .collect()
    }
}

impl Visibility for Scene {
    #[inline]
    fn any_hit(&self, origin: Vec3, target: Vec3) -> bool {
        self.geometry.any_hit(origin, target)
    }

    #[inline]
    fn closest(&self, origin: Vec3, direction: Vec3) -> Hit {
        self.geometry.closest(origin, direction)
    }
}

/// The lighting of parts, which is taken out of them.
fn take_lighting(parts: &mut SceneParts) -> Lighting {
    Lighting {
        lights: mem::take(&mut parts.lights),
        sky: parts.sky,
        sky_map: mem::take(&mut parts.sky_map).into(),
        emission: Vec::new(),
        distributions: mem::take(&mut parts.distributions).into(),
    }
}

pub(super) fn check(parts: &SceneParts) -> Result<(), Error> {
    let count = parts.triangles.len();
    if count == 0 {
        return Err(Error::NoTriangles);
    }
    if parts.uvs.len() != count {
        return Err(Error::TableLength { name: "uvs", expected: count, found: parts.uvs.len() });
    }
    for t in &parts.textures {
        let end = t.offset as usize + texel_count(t.width, t.height, t.levels);
        if parts.texels.len() < 2 * end {
            return Err(Error::TableLength { name: "texels", expected: 2 * end, found: parts.texels.len() });
        }
    }
    check_sky_map(&parts.sky, parts.sky_map.len())?;
    if let Some(&value) = parts.absorption.to_array().iter().find(|a| !(a.is_finite() && **a >= 0.0)) {
        return Err(Error::Absorption { value });
    }
    for (triangle, t) in parts.triangles.iter().enumerate() {
        if t.material as usize >= parts.materials.len() {
            return Err(Error::MaterialIndex { triangle, material: t.material, count: parts.materials.len() });
        }
        if !(t.corner.is_finite() && t.edge_a.is_finite() && t.edge_b.is_finite()) {
            return Err(Error::NotFinite { triangle });
        }
    }
    for (material, m) in parts.materials.iter().enumerate() {
        for texture in [m.albedo_texture, m.radiance_texture, m.mask_texture] {
            if texture != NONE && texture as usize >= parts.textures.len() {
                return Err(Error::TextureIndex { material, texture, count: parts.textures.len() });
            }
        }
        if m.is_specular() {
            check_reflectance(m, &parts.textures, &parts.texels)
                .map_err(|found| Error::Reflectance { material, found })?;
        }
    }
    check_finishes(parts)
}

/// Refuses finishes that no material has, and those with textures or numbers that are not there.
fn check_finishes(parts: &SceneParts) -> Result<(), Error> {
    let (count, textures) = (parts.materials.len(), parts.textures.len());
    if parts.finishes.len() > count {
        return Err(Error::FinishLength { expected: count, found: parts.finishes.len() });
    }
    for (material, finish) in parts.finishes.iter().enumerate() {
        for texture in [finish.normal_texture, finish.surface_texture] {
            if texture != NONE && texture as usize >= textures {
                return Err(Error::TextureIndex { material, texture, count: textures });
            }
        }
        let shares = [("roughness", finish.roughness), ("metallic", finish.metallic)];
        if let Some(&(name, value)) = shares.iter().find(|(_, share)| !(0.0..=1.0).contains(share)) {
            return Err(Error::Finish { material, name, value });
        }
        if !finish.normal_scale.is_finite() {
            return Err(Error::Finish { material, name: "normal scale", value: finish.normal_scale });
        }
    }
    Ok(())
}

/// Rounding tolerance of the shares of a material.
const ROUNDING: f32 = 1e-5;

/// Refuses a material that would send more light than it gets.
fn check_reflectance(m: &Material, textures: &[Texture], texels: &[u32]) -> Result<(), ReflectanceFault> {
    for (name, share) in [("mirror", m.mirror), ("transmittance", m.transmittance)] {
        if let Some(&value) = share.to_array().iter().find(|s| !(0.0..=1.0 + ROUNDING).contains(*s)) {
            return Err(ReflectanceFault::Share { name, value });
        }
    }
    let diffuse = match textures.get(m.albedo_texture as usize) {
        Some(t) => (0..t.width * t.height).map(|k| texel(texels, t.offset + k).truncate()).fold(Vec3::ZERO, Vec3::max),
        None => m.albedo,
    };
    let sum = diffuse + m.mirror + m.transmittance;
    if let Some(channel) = (0..3).find(|&c| sum[c].is_nan() || sum[c] > 1.0 + ROUNDING) {
        return Err(ReflectanceFault::Sum {
            diffuse: diffuse[channel],
            mirror: m.mirror[channel],
            transmittance: m.transmittance[channel],
        });
    }
    if !(0.1..=10.0).contains(&m.index_of_refraction) {
        return Err(ReflectanceFault::Index { value: m.index_of_refraction });
    }
    Ok(())
}
