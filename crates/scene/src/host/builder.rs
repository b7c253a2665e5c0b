//! A scene put together in memory.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use glam::{Affine3A, Mat3, Vec2, Vec3, Vec4};

use super::distribution::Distribution;
use super::lighting::Lighting;
use super::pyramid::Pyramid;
use super::scene::{Scene, SceneParts};
use crate::error::Error;
use crate::gpu::*;
use crate::kernel::shade::decode_srgb;
use crate::units::{Flux, Intensity, Radiance};

/// Most that a surface may reflect of a channel: with more, light in a closed room hardly ends.
const MAX_ALBEDO: f32 = 0.95;

/// Puts a scene together from meshes, materials, textures and lights in memory; [`Scene::builder`] makes one.
///
/// What is wrong is told by [`SceneBuilder::build`], with the mesh, triangle, texture, material or light that it is
/// about.
///
/// ```
/// use glam::Vec3;
/// use patchlight_scene::{Flux, Irradiance, Light, Material, Mesh, Scene};
///
/// let mut builder = Scene::builder();
/// let red = builder.add_material(Material::diffuse(Vec3::new(0.7, 0.1, 0.1)));
/// let corners = [Vec3::ZERO, Vec3::Z, Vec3::new(1.0, 0.0, 1.0), Vec3::X];
/// builder.add_mesh(Mesh { name: "floor", positions: &corners, indices: &[0, 1, 2, 0, 2, 3], material: red, ..Mesh::default() });
/// let lamp = builder.add_light(Light::point(Vec3::new(0.5, 2.0, 0.5), Flux::lumens(800.0)));
/// builder.add_light(Light::sun(Vec3::new(0.3, -1.0, 0.2), Irradiance::lux(60_000.0)));
/// let mut scene = builder.build()?;
///
/// // A light is found again by its handle.
/// scene.lighting.light_mut(lamp).expect("it was not taken away").position.y = 1.5;
/// # Ok::<(), patchlight_scene::BuildError>(())
/// ```
#[derive(Clone, Debug)]
pub struct SceneBuilder {
    parts: SceneParts,
    meshes: u32,
    /// The first fault.
    fault: Option<BuildError>,
}

/// A material of a builder. The default is mid-grey.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct MaterialId(u32);

/// A texture of a builder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TextureId(u32);

/// A mesh of a builder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MeshId(u32);

/// A light of a builder, of the scene that it made, and of any lighting that begins with the same lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LightId(u32);

impl MaterialId {
    /// The material with this number among [`Scene::materials`], for meshes that are added to a scene.
    pub fn of_scene(index: usize) -> Self {
        Self(index as u32)
    }

    /// Its number among [`Scene::materials`].
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

impl MeshId {
    /// [`Triangle::object`] of its triangles.
    pub fn object(self) -> u32 {
        self.0
    }
}

impl LightId {
    /// Its number among [`Lighting::lights`].
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

impl Lighting {
    /// A light by its handle; `None` where lights were taken away.
    pub fn light(&self, id: LightId) -> Option<&Light> {
        self.lights.get(id.index())
    }

    /// A light, to move or change it.
    pub fn light_mut(&mut self, id: LightId) -> Option<&mut Light> {
        self.lights.get_mut(id.index())
    }
}

/// Triangles of one material.
#[derive(Clone, Copy, Debug)]
pub struct Mesh<'a> {
    /// For messages.
    pub name: &'a str,
    /// Vertices, m, before `transform`.
    pub positions: &'a [Vec3],
    /// Three vertices of each triangle, counter-clockwise as seen from its front; empty where every three vertices are
    /// one.
    pub indices: &'a [u32],
    /// The side that each vertex faces, where that is known: triangles whose corners run the other way round are
    /// turned, and pictures shade them as the smooth surface that the normals say. Indirect light is that of flat
    /// triangles.
    pub normals: &'a [Vec3],
    /// Texture coordinates of each vertex, or none; v = 0 is the bottom row of the picture.
    pub uvs: &'a [Vec2],
    /// Material of its triangles.
    pub material: MaterialId,
    /// Position, rotation and scale. One that mirrors keeps the front in front.
    pub transform: Affine3A,
}

impl Default for Mesh<'_> {
    fn default() -> Self {
        Self {
            name: "",
            positions: &[],
            indices: &[],
            normals: &[],
            uvs: &[],
            material: MaterialId::default(),
            transform: Affine3A::IDENTITY,
        }
    }
}

/// Why a scene could not be put together.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// A mesh makes no sense.
    #[error("mesh {mesh}: {fault}")]
    Mesh {
        /// Its name, or its number where it has none.
        mesh: String,
        /// The fault.
        fault: MeshFault,
    },
    /// A texture has another number of bytes than its size says.
    #[error("texture {texture}: {found} bytes, where {width} x {height} texels of four take {expected}")]
    Texture {
        /// Its number, from 0.
        texture: usize,
        /// Texels of a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes needed.
        expected: usize,
        /// Bytes given.
        found: usize,
    },
    /// A material reflects more than surfaces do, or is no number.
    #[error("material {material}: it reflects {value} of a channel; a surface reflects 0 to 0.95")]
    Albedo {
        /// Its number; 0 is the default material.
        material: usize,
        /// The share.
        value: f32,
    },
    /// A light makes no sense.
    #[error("light {light}: its {name} is {value}; it must be {rule}")]
    Light {
        /// Its number, from 0.
        light: usize,
        /// The part concerned.
        name: &'static str,
        /// Its value, of a vector the component that is wrong.
        value: f32,
        /// Rule that it breaks.
        rule: &'static str,
    },
    /// A fault that a scene of plain tables has, too.
    #[error(transparent)]
    Scene(#[from] Error),
}

/// Fault of a mesh.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshFault {
    /// Corners that make no triangle.
    #[error("{corners} corners are no whole number of triangles; give three for each")]
    Corners {
        /// Their number.
        corners: usize,
    },
    /// A triangle has a vertex that is not there.
    #[error("triangle {triangle} has vertex {vertex} of {count}")]
    Vertex {
        /// The triangle, from 0.
        triangle: usize,
        /// The vertex that it names.
        vertex: u32,
        /// Vertices there are.
        count: usize,
    },
    /// A table is neither empty nor of one entry a vertex.
    #[error("{found} {name} for {expected} vertices; give one for each, or none")]
    Length {
        /// The table.
        name: &'static str,
        /// Vertices.
        expected: usize,
        /// Entries.
        found: usize,
    },
    /// A corner is NaN or infinite after the transform.
    #[error("triangle {triangle} has a corner that is no place")]
    NotFinite {
        /// The triangle, from 0.
        triangle: usize,
    },
    /// A material of another builder.
    #[error("its material is number {material} of {count}; add it to this builder first")]
    Material {
        /// The material that it names.
        material: usize,
        /// Materials there are.
        count: usize,
    },
}

impl Default for SceneBuilder {
    fn default() -> Self {
        let parts = SceneParts { materials: Vec::from([Material::default()]), ..SceneParts::default() };
        Self { parts, meshes: 0, fault: None }
    }
}

impl Scene {
    /// A scene to be put together from meshes, materials, textures and lights.
    pub fn builder() -> SceneBuilder {
        SceneBuilder::default()
    }
}

impl SceneBuilder {
    /// Goes on with the parts of a scene; the next mesh gets a number that no object has.
    pub(super) fn of_parts(parts: SceneParts) -> Self {
        let meshes = parts.triangles.iter().map(|t| t.object.saturating_add(1)).max().unwrap_or(0);
        Self { parts, meshes, fault: None }
    }

    pub(super) fn parts_mut(&mut self) -> &mut SceneParts {
        &mut self.parts
    }

    /// Adds a material.
    pub fn add_material(&mut self, material: Material) -> MaterialId {
        let number = self.parts.materials.len();
        let is_wrong = |share: &f32| !(0.0..=MAX_ALBEDO).contains(share);
        if let Some(value) = material.albedo.to_array().into_iter().find(is_wrong) {
            self.refuse(BuildError::Albedo { material: number, value });
        }
        self.parts.materials.push(material);
        MaterialId(number as u32)
    }

    /// Sets what pictures show of a material beside diffuse light, where they show it.
    pub fn set_finish(&mut self, material: MaterialId, finish: Finish) {
        let finishes = &mut self.parts.finishes;
        finishes.resize(finishes.len().max(material.index() + 1), Finish::default());
        finishes[material.index()] = finish;
    }

    /// Adds a picture of sRGB bytes: red, green, blue and alpha of each texel, row by row from the top. Surfaces
    /// reflect at most 0.95 of a channel; brighter texels are lowered to that.
    pub fn add_texture(&mut self, size: (u32, u32), rgba: &[u8]) -> TextureId {
        self.add_tinted_texture(size, rgba, Vec3::ONE)
    }

    /// As [`Self::add_texture`], times a linear color.
    pub fn add_tinted_texture(&mut self, (width, height): (u32, u32), rgba: &[u8], color: Vec3) -> TextureId {
        let texture = self.parts.textures.len();
        let expected = 4 * width as usize * height as usize;
        if rgba.len() != expected || expected == 0 {
            self.refuse(BuildError::Texture { texture, width, height, expected, found: rgba.len() });
            return TextureId(NONE);
        }
        let texel = |c: &[u8]| {
            let [r, g, b] = [0, 1, 2].map(|k| (decode_srgb(f32::from(c[k]) / 255.0) * color[k]).clamp(0.0, MAX_ALBEDO));
            Vec4::new(r, g, b, f32::from(c[3]) / 255.0)
        };
        let mut pyramid = Pyramid::new((width, height), 0);
        rgba.chunks_exact(4 * width as usize).for_each(|row| pyramid.push(row.chunks_exact(4).map(texel).collect()));
        let (own, words) = pyramid.finish();
        self.parts.textures.push(Texture { offset: (self.parts.texels.len() / 2) as u32, ..own });
        self.parts.texels.extend(words);
        TextureId(texture as u32)
    }

    /// Adds a surface whose reflectance is that of a texture; with `cutoff`, places where its alpha is lower are holes.
    pub fn add_textured(&mut self, texture: TextureId, cutoff: Option<f32>) -> MaterialId {
        let material = Material { albedo_texture: texture.0, ..Material::default() };
        self.add_material(match cutoff {
            Some(mask_cutoff) => Material { mask_texture: texture.0, mask_cutoff, ..material },
            None => material,
        })
    }

    /// Adds the triangles of a mesh.
    pub fn add_mesh(&mut self, mesh: Mesh) -> MeshId {
        let number = self.meshes;
        self.meshes += 1;
        if let Err(fault) = self.take(&mesh, number) {
            let name = if mesh.name.is_empty() { format!("{number}") } else { format!("`{}`", mesh.name) };
            self.refuse(BuildError::Mesh { mesh: name, fault });
        }
        MeshId(number)
    }

    /// Adds a light.
    pub fn add_light(&mut self, light: Light) -> LightId {
        let number = self.parts.lights.len();
        if let Some((name, value, rule)) = light_fault(&light) {
            self.refuse(BuildError::Light { light: number, name, value, rule });
        }
        self.parts.lights.push(light);
        LightId(number as u32)
    }

    /// Adds a measured luminaire at a place, m, that sends this flux: `axis` is its direction γ = 0 (down, of a lamp on
    /// a ceiling), `across` the direction in which its half-plane C = 0 lies.
    pub fn add_luminaire(
        &mut self,
        position: Vec3,
        (axis, across): (Vec3, Vec3),
        flux: Flux,
        distribution: &Distribution,
    ) -> LightId {
        let distribution = match distribution.append_to(&mut self.parts.distributions) {
            Ok(begin) => begin,
            Err(error) => {
                self.refuse(error.into());
                0
            }
        };
        let direction = axis.normalize_or_zero();
        self.add_light(Light {
            kind: LIGHT_LUMINAIRE,
            position,
            direction,
            edge_a: across.reject_from(direction).normalize_or_zero(),
            color: Intensity::from(flux).0,
            distribution,
            ..Light::default()
        })
    }

    /// Light from every direction that sees no geometry, the same from all of them.
    pub fn set_sky(&mut self, radiance: Radiance) {
        self.parts.sky = Sky { radiance: radiance.0, ..Sky::default() };
        self.parts.sky_map.clear();
    }

    /// Sets the sky to an equirectangular map of radiances, W/m²/sr, row by row from the top; its middle column is −z,
    /// its top row +y.
    pub fn set_sky_map(&mut self, (map_width, map_height): (u32, u32), radiances: &[Vec3]) {
        self.parts.sky = Sky { radiance: Vec3::ONE, map_width, map_height, ..Sky::default() };
        self.parts.sky_map = radiances.iter().map(|radiance| radiance.extend(0.0)).collect();
    }

    /// The scene, with the hierarchy that rays need.
    ///
    /// # Errors
    /// What was wrong first with what was added; [`BuildError::Scene`] for the whole: no triangles, a sky's map of
    /// another size.
    pub fn build(self) -> Result<Scene, BuildError> {
        match self.fault {
            Some(fault) => Err(fault),
            None => Ok(Scene::new(self.parts)?),
        }
    }

    fn refuse(&mut self, fault: BuildError) {
        self.fault.get_or_insert(fault);
    }

    pub(super) fn take(&mut self, mesh: &Mesh, number: u32) -> Result<(), MeshFault> {
        let Mesh { positions, indices, normals, uvs, material, transform, .. } = *mesh;
        let vertices = positions.len();
        for (name, found) in [("normals", normals.len()), ("texture coordinates", uvs.len())] {
            if found != 0 && found != vertices {
                return Err(MeshFault::Length { name, expected: vertices, found });
            }
        }
        if material.index() >= self.parts.materials.len() {
            return Err(MeshFault::Material { material: material.index(), count: self.parts.materials.len() });
        }
        let corners = if indices.is_empty() { vertices } else { indices.len() };
        if corners % 3 != 0 {
            return Err(MeshFault::Corners { corners });
        }
        let is_mirrored = transform.matrix3.determinant() < 0.0;
        let turned = normal_matrix(&transform);
        for triangle in 0..corners / 3 {
            let mut own = [0, 1, 2].map(|k| match indices.is_empty() {
                true => (3 * triangle + k) as u32,
                false => indices[3 * triangle + k],
            });
            if let Some(&vertex) = own.iter().find(|&&vertex| vertex as usize >= vertices) {
                return Err(MeshFault::Vertex { triangle, vertex, count: vertices });
            }
            let [a, b, c] = own.map(|vertex| positions[vertex as usize]);
            let facing: Vec3 = own.iter().filter_map(|&vertex| normals.get(vertex as usize)).sum();
            if ((b - a).cross(c - a).dot(facing) < 0.0) != is_mirrored {
                own.swap(1, 2);
            }
            let [corner, second, third] = own.map(|vertex| transform.transform_point3(positions[vertex as usize]));
            if !(corner.is_finite() && second.is_finite() && third.is_finite()) {
                return Err(MeshFault::NotFinite { triangle });
            }
            let [uv, uv_a, uv_b] = own.map(|vertex| uvs.get(vertex as usize).copied().unwrap_or_default());
            let new = Triangle {
                corner,
                material: material.0,
                edge_a: second - corner,
                source: self.parts.triangles.len() as u32,
                edge_b: third - corner,
                object: number,
            };
            let uv = TriangleUv { corner: uv, corner_a: uv_a, corner_b: uv_b, ..TriangleUv::default() };
            let smooth = own.map(|vertex| turned * normals.get(vertex as usize).copied().unwrap_or_default());
            self.parts.uvs.push(uv.with_normals(&new, smooth));
            self.parts.triangles.push(new);
        }
        Ok(())
    }
}

/// The matrix by which normals follow a transform: they stay normal to what is scaled unevenly. Zero where it flattens.
pub(super) fn normal_matrix(transform: &Affine3A) -> Mat3 {
    let matrix = Mat3::from(transform.matrix3);
    if matrix.determinant() == 0.0 { Mat3::ZERO } else { matrix.inverse().transpose() }
}

/// Faulty parameter of a light, its value, and the rule that it breaks.
fn light_fault(light: &Light) -> Option<(&'static str, f32, &'static str)> {
    let not_finite = |v: Vec3| v.to_array().into_iter().find(|x| !x.is_finite());
    if let Some(value) = light.color.to_array().into_iter().find(|x| !(x.is_finite() && *x >= 0.0)) {
        return Some(("light", value, "finite and not negative in each channel"));
    }
    if let Some(value) = not_finite(light.position) {
        return Some(("position", value, "finite"));
    }
    let turned = [LIGHT_DIRECTIONAL, LIGHT_SPOT, LIGHT_LUMINAIRE].contains(&light.kind);
    let is_unit = |v: Vec3| (v.length() - 1.0).abs() < 1e-3;
    if turned && !is_unit(light.direction) {
        return Some(("direction", light.direction.length(), "of some length"));
    }
    if light.kind == LIGHT_LUMINAIRE && !is_unit(light.edge_a) {
        return Some(("direction across", light.edge_a.length(), "of some length, and not along its axis"));
    }
    if light.kind == LIGHT_SPOT && !(light.cos_outer < light.cos_inner && light.cos_outer > -1.0) {
        return Some(("outer angle", libm::acosf(light.cos_outer), "greater than the inner one and below π"));
    }
    if light.kind == LIGHT_RECT && !(light.area > 0.0 && light.area.is_finite()) {
        return Some(("area", light.area, "positive and finite"));
    }
    None
}
