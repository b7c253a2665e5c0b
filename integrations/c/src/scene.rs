//! Scenes.

use std::ffi::c_char;

use patchlight::glam::{Affine3A, Mat3, Vec2, Vec3};
use patchlight::scene::SurfaceLight;
use patchlight::{Intensity, Irradiance, Light, Material, MaterialId, Mesh, Radiance, SceneBuilder, TextureId};

use crate::border::{
    Failure, Outcome, PlStatus, Sized32, free, give, guard, handle, input, room, structure, table, text, vector,
};

/// No texture.
pub const PL_NONE: u32 = u32::MAX;

/// Kind of a light.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(non_camel_case_types)]
pub enum PlLightKind {
    /// Parallel light along `direction`; `color` is the irradiance of a surface that faces it, W/m².
    PL_SUN = 0,
    /// A point at `position`; `color` is its radiant intensity, W/sr.
    PL_POINT = 1,
    /// A point that shines round `direction`, all of its intensity up to the half-angle `inner`, none beyond `outer`.
    PL_SPOT = 2,
    /// A parallelogram from the corner `position` along `edge_a` and `edge_b`, to the side of edge_a × edge_b; `color` is its
    /// radiance, W/m²/sr.
    PL_RECTANGLE = 3,
}

/// A light that is no surface.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct PlLight {
    /// sizeof(PlLight).
    pub struct_size: usize,
    /// A PlLightKind.
    pub kind: u32,
    /// Place, m.
    pub position: [f32; 3],
    /// Direction in which it shines, any length.
    pub direction: [f32; 3],
    /// Edges of a rectangle, m.
    pub edge_a: [f32; 3],
    /// See edge_a.
    pub edge_b: [f32; 3],
    /// Brightness; see PlLightKind.
    pub color: [f32; 3],
    /// Half-angles of a spot, radians.
    pub inner: f32,
    /// See inner.
    pub outer: f32,
}

/// A diffuse material.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct PlMaterial {
    /// sizeof(PlMaterial).
    pub struct_size: usize,
    /// Reflectance of each channel, 0 to 0.95; not used where there is a texture.
    pub reflectance: [f32; 3],
    /// Radiance of its front, W/m²/sr.
    pub radiance: [f32; 3],
    /// A texture of pl_builder_add_texture instead of the reflectance, or PL_NONE.
    pub texture: u32,
    /// With a texture: places of a lower alpha are holes; 0 for none.
    pub cutoff: f32,
}

/// Triangles of one material.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct PlMesh {
    /// sizeof(PlMesh).
    pub struct_size: usize,
    /// Name for messages, or NULL.
    pub name: *const c_char,
    /// x, y, z of each vertex, m.
    pub positions: *const f32,
    /// Number of vertices.
    pub vertex_count: usize,
    /// Three vertices of each triangle, counter-clockwise as seen from its front; NULL where every three vertices are one.
    pub indices: *const u32,
    /// Number of indices.
    pub index_count: usize,
    /// Smooth normals of the vertices, or NULL.
    pub normals: *const f32,
    /// u, v of each vertex, or NULL; v = 0 is the bottom row of the picture.
    pub uvs: *const f32,
    /// A material of pl_builder_add_material.
    pub material: u32,
    /// Three rows of four numbers: rotation with scale, and translation; or NULL.
    pub transform: *const f32,
}

// SAFETY: plain numbers and pointers, of which null is one.
unsafe impl Sized32 for PlLight {
    const NAME: &'static str = "PlLight";
}
// SAFETY: plain numbers.
unsafe impl Sized32 for PlMaterial {
    const NAME: &'static str = "PlMaterial";
}
// SAFETY: plain numbers and pointers, of which null is one.
unsafe impl Sized32 for PlMesh {
    const NAME: &'static str = "PlMesh";
}

/// A scene that is being put together.
pub struct PlBuilder(SceneBuilder, Vec<MaterialId>, Vec<TextureId>);

/// A scene: surfaces and lights. May be read by several threads at once.
pub struct PlScene(pub(crate) patchlight::Scene);

impl Default for PlLight {
    fn default() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            kind: PlLightKind::PL_POINT as u32,
            position: [0.0; 3],
            direction: [0.0, -1.0, 0.0],
            edge_a: [1.0, 0.0, 0.0],
            edge_b: [0.0, 0.0, 1.0],
            color: [1.0; 3],
            inner: 0.5,
            outer: 0.7,
        }
    }
}

impl Default for PlMaterial {
    fn default() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            reflectance: [0.5; 3],
            radiance: [0.0; 3],
            texture: PL_NONE,
            cutoff: 0.0,
        }
    }
}

impl Default for PlMesh {
    fn default() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            name: std::ptr::null(),
            positions: std::ptr::null(),
            vertex_count: 0,
            indices: std::ptr::null(),
            index_count: 0,
            normals: std::ptr::null(),
            uvs: std::ptr::null(),
            material: 0,
            transform: std::ptr::null(),
        }
    }
}

impl PlLight {
    /// The library's light.
    pub(crate) fn light(&self) -> Outcome<Light> {
        let position = vector(self.position, "position of a light")?;
        let direction = vector(self.direction, "direction of a light")?;
        let color = vector(self.color, "color of a light")?;
        if color.min_element() < 0.0 {
            return Err(input(format!("color of a light is {color}; light is not negative")));
        }
        Ok(match self.kind {
            0 => Light::sun(direction, Irradiance(color)),
            1 => Light::point(position, Intensity(color)),
            2 => Light::spot(position, direction, (self.inner, self.outer), Intensity(color)),
            3 => {
                let edges = (vector(self.edge_a, "edge_a")?, vector(self.edge_b, "edge_b")?);
                Light::rectangle(position, edges, SurfaceLight::Radiance(Radiance(color)))
            }
            kind => return Err(input(format!("kind of a light is {kind}; it is one of PlLightKind"))),
        })
    }
}

impl PlMesh {
    /// The library's mesh, of the material with this number in a scene.
    ///
    /// # Safety
    /// Pointers are what they say, as long as the mesh is used.
    pub(crate) unsafe fn mesh<'a>(&self) -> Outcome<Mesh<'a>> {
        let count = self.vertex_count;
        // SAFETY: as the caller promises.
        let name = if self.name.is_null() { "" } else { unsafe { text(self.name, "name of a mesh") }? };
        let triples = |first: *const f32, name: &str| {
            let count = if first.is_null() && name == "normals" { 0 } else { count };
            // SAFETY: as the caller promises.
            unsafe { table(first.cast::<[f32; 3]>(), count, name) }
        };
        let positions: &[Vec3] = bytemuck::cast_slice(triples(self.positions, "positions")?);
        let normals: &[Vec3] = bytemuck::cast_slice(triples(self.normals, "normals")?);
        let index_count = if self.indices.is_null() { 0 } else { self.index_count };
        // SAFETY: as the caller promises.
        let indices = unsafe { table(self.indices, index_count, "indices") }?;
        let uv_count = if self.uvs.is_null() { 0 } else { count };
        // SAFETY: as the caller promises.
        let uvs: &[Vec2] = bytemuck::cast_slice(unsafe { table(self.uvs.cast::<[f32; 2]>(), uv_count, "uvs") }?);
        let transform = if self.transform.is_null() {
            Affine3A::IDENTITY
        } else {
            // SAFETY: as the caller promises.
            transform_of(unsafe { table(self.transform, 12, "transform") }?)
        };
        let material = MaterialId::of_scene(self.material as usize);
        Ok(Mesh { name, positions, indices, normals, uvs, material, transform })
    }
}

/// Fills a structure with its size and defaults: a point of 1 W/sr.
///
/// # Safety
/// `light` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_light_default(light: *mut PlLight) {
    if !light.is_null() {
        // SAFETY: as the caller promises.
        unsafe { light.write(PlLight::default()) };
    }
}

/// Fills a structure with its size and defaults: grey of 0.5.
///
/// # Safety
/// `material` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_material_default(material: *mut PlMaterial) {
    if !material.is_null() {
        // SAFETY: as the caller promises.
        unsafe { material.write(PlMaterial::default()) };
    }
}

/// Fills a structure with its size and nothing else.
///
/// # Safety
/// `mesh` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_mesh_default(mesh: *mut PlMesh) {
    if !mesh.is_null() {
        // SAFETY: as the caller promises.
        unsafe { mesh.write(PlMesh::default()) };
    }
}

/// Begins a scene.
///
/// # Safety
/// `out` may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_builder_new(out: *mut *mut PlBuilder) -> PlStatus {
    // SAFETY: as the caller promises.
    guard(|| unsafe { give(out, PlBuilder(patchlight::Scene::builder(), vec![MaterialId::default()], Vec::new())) })
}

/// Adds a picture of sRGB bytes: red, green, blue and alpha of each texel, row by row from the top.
///
/// # Safety
/// `rgba` has 4 · width · height bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_builder_add_texture(
    builder: *mut PlBuilder,
    width: u32,
    height: u32,
    rgba: *const u8,
    out_texture: *mut u32,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let builder = unsafe { handle(builder, "builder") }?;
        // SAFETY: as the caller promises.
        let bytes = unsafe { table(rgba, 4 * width as usize * height as usize, "rgba") }?;
        let texture = builder.0.add_texture((width, height), bytes);
        builder.2.push(texture);
        // SAFETY: as the caller promises.
        unsafe { room(out_texture, 1, "out_texture") }?[0] = builder.2.len() as u32 - 1;
        Ok(())
    })
}

/// Adds a material. Material 0 is grey of 0.5 and is there already.
///
/// # Safety
/// Pointers are what they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_builder_add_material(
    builder: *mut PlBuilder,
    material: *const PlMaterial,
    out_material: *mut u32,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let builder = unsafe { handle(builder, "builder") }?;
        // SAFETY: as the caller promises.
        let own = unsafe { structure(material, PlMaterial::default()) }?;
        let id = if own.texture == PL_NONE {
            let material = Material::diffuse(vector(own.reflectance, "reflectance")?);
            builder.0.add_material(material.with_emission(Radiance(vector(own.radiance, "radiance")?)))
        } else {
            let texture = builder.2.get(own.texture as usize).copied();
            let texture = texture.ok_or_else(|| input(format!("texture {} is not of this scene", own.texture)))?;
            builder.0.add_textured(texture, (own.cutoff > 0.0).then_some(own.cutoff))
        };
        builder.1.push(id);
        // SAFETY: as the caller promises.
        unsafe { room(out_material, 1, "out_material") }?[0] = builder.1.len() as u32 - 1;
        Ok(())
    })
}

/// Adds the triangles of a mesh; their number goes to `out_object`, unless that is NULL.
///
/// # Safety
/// Tables of the mesh are as long as it says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_builder_add_mesh(
    builder: *mut PlBuilder,
    mesh: *const PlMesh,
    out_object: *mut u32,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let builder = unsafe { handle(builder, "builder") }?;
        // SAFETY: as the caller promises.
        let own = unsafe { structure(mesh, PlMesh::default()) }?;
        // SAFETY: as the caller promises.
        let mesh = unsafe { own.mesh() }?;
        let material = builder.1.get(own.material as usize).copied();
        let unknown = || input(format!("mesh `{}`: material {} is not of this scene", mesh.name, own.material));
        let id = builder.0.add_mesh(Mesh { material: material.ok_or_else(unknown)?, ..mesh });
        if !out_object.is_null() {
            // SAFETY: as the caller promises.
            unsafe { room(out_object, 1, "out_object") }?[0] = id.object();
        }
        Ok(())
    })
}

/// Three rows of four numbers as a transform.
pub(crate) fn transform_of(rows: &[f32]) -> Affine3A {
    let column = |k: usize| Vec3::new(rows[k], rows[4 + k], rows[8 + k]);
    Affine3A::from_mat3_translation(Mat3::from_cols(column(0), column(1), column(2)), column(3))
}

/// Adds a light; its number among the scene's lights goes to `out_light`, unless that is NULL.
///
/// # Safety
/// Pointers are what they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_builder_add_light(
    builder: *mut PlBuilder,
    light: *const PlLight,
    out_light: *mut u32,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let builder = unsafe { handle(builder, "builder") }?;
        // SAFETY: as the caller promises.
        let own = unsafe { structure(light, PlLight::default()) }?;
        let id = builder.0.add_light(own.light()?);
        if !out_light.is_null() {
            // SAFETY: as the caller promises.
            unsafe { room(out_light, 1, "out_light") }?[0] = id.index() as u32;
        }
        Ok(())
    })
}

/// The same radiance, W/m²/sr, from every direction that sees no surface.
///
/// # Safety
/// `radiance` has three numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_builder_set_sky(builder: *mut PlBuilder, radiance: *const f32) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let builder = unsafe { handle(builder, "builder") }?;
        // SAFETY: as the caller promises.
        let own = unsafe { table(radiance, 3, "radiance") }?;
        builder.0.set_sky(Radiance(vector([own[0], own[1], own[2]], "radiance of the sky")?));
        Ok(())
    })
}

/// An equirectangular map of radiances, W/m²/sr: red, green and blue, row by row from the top; its middle column is -z.
///
/// # Safety
/// `rgb` has 3 · width · height numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_builder_set_sky_map(
    builder: *mut PlBuilder,
    width: u32,
    height: u32,
    rgb: *const f32,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let builder = unsafe { handle(builder, "builder") }?;
        // SAFETY: as the caller promises.
        let texels = unsafe { table(rgb.cast::<[f32; 3]>(), width as usize * height as usize, "rgb") }?;
        builder.0.set_sky_map((width, height), bytemuck::cast_slice(texels));
        Ok(())
    })
}

/// Ends the builder, in any case, and gives the scene.
///
/// # Safety
/// The builder is not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_builder_build(builder: *mut PlBuilder, out: *mut *mut PlScene) -> PlStatus {
    guard(|| {
        if builder.is_null() {
            return Err(input("builder is NULL"));
        }
        // SAFETY: as the caller promises; it came from `give`.
        let own = unsafe { Box::from_raw(builder) };
        let scene = own.0.build().map_err(input)?;
        // SAFETY: as the caller promises.
        unsafe { give(out, PlScene(scene)) }
    })
}

/// Ends a builder that is not built.
///
/// # Safety
/// It is NULL or not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_builder_free(builder: *mut PlBuilder) {
    // SAFETY: as the caller promises.
    unsafe { free(builder) }
}

/// Reads a scene file (.toml, .obj, .gltf, .glb), or makes the built-in scene of that name.
///
/// # Safety
/// `path` ends with a zero; `out` may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_scene_load(path: *const c_char, out: *mut *mut PlScene) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let path = unsafe { text(path, "path") }?;
        let loaded = assets::load_or_build(path).map_err(|error| Failure(PlStatus::PL_FILE, error.to_string()))?;
        // SAFETY: as the caller promises.
        unsafe { give(out, PlScene(loaded.scene)) }
    })
}

/// Least and greatest coordinates, m: three numbers each.
///
/// # Safety
/// Pointers are what they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_scene_bounds(scene: *const PlScene, out_low: *mut f32, out_high: *mut f32) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let scene = unsafe { crate::border::shared(scene, "scene") }?;
        let (low, high) = scene.0.geometry.bounds;
        // SAFETY: as the caller promises.
        unsafe { room(out_low, 3, "out_low") }?.copy_from_slice(&low.to_array());
        // SAFETY: as the caller promises.
        unsafe { room(out_high, 3, "out_high") }?.copy_from_slice(&high.to_array());
        Ok(())
    })
}

/// Number of triangles; 0 of NULL.
///
/// # Safety
/// The handle is live or NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_scene_triangle_count(scene: *const PlScene) -> usize {
    // SAFETY: as the caller promises.
    unsafe { scene.as_ref() }.map_or(0, |scene| scene.0.geometry.triangles.len())
}

/// Number of lights; 0 of NULL.
///
/// # Safety
/// The handle is live or NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_scene_light_count(scene: *const PlScene) -> usize {
    // SAFETY: as the caller promises.
    unsafe { scene.as_ref() }.map_or(0, |scene| scene.0.lighting.lights.len())
}

/// Ends a scene; bakes of it stay.
///
/// # Safety
/// It is NULL or not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_scene_free(scene: *mut PlScene) {
    // SAFETY: as the caller promises.
    unsafe { free(scene) }
}
