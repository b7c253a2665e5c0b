//! Meshes and materials of a Godot scene as those of the library.

use std::collections::HashMap;

use godot::classes::base_material_3d::{CullMode, Feature, TextureParam, Transparency};
use godot::classes::geometry_instance_3d::GiMode;
use godot::classes::image::Format;
use godot::classes::mesh::{ArrayType, PrimitiveType};
use godot::classes::{BaseMaterial3D, Material as GodotMaterial, MeshInstance3D, Node, SurfaceTool, Texture2D};
use godot::prelude::*;
use patchlight::glam::{Affine3A, Mat3, Vec2, Vec3};
use patchlight::scene::gpu::Triangle;
use patchlight::scene::{BuildError, SidePolicy, Sides, find_sides};
use patchlight::{Lighting, MAX_ALBEDO, Material, MaterialId, Mesh, Scene};

/// Nodes of this group hide and reflect light where they move.
pub const MOVING: &str = "patchlight_moving";

/// A surface of a mesh in its place: three vertices of its own for each triangle.
pub struct Surface {
    pub name: String,
    /// Clockwise from the front, as Godot has them.
    pub positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    uvs: Vec<Vec2>,
    /// Its number in [`Gathered::materials`].
    pub material: usize,
}

/// What a material reflects.
struct Reflected {
    albedo: Vec3,
    texture: Option<usize>,
    cutoff: Option<f32>,
}

/// A surface as arrays without indices, and which of [`Gathered::surfaces`] it is; none for one that is left out.
pub type SurfaceArrays = (VarArray, Option<usize>);

/// Meshes below a node that rest.
#[derive(Default)]
pub struct Gathered {
    pub meshes: Vec<(Gd<MeshInstance3D>, Vec<SurfaceArrays>)>,
    pub surfaces: Vec<(Surface, Affine3A)>,
    /// Meshes that move and hide light.
    pub moving: Vec<Gd<MeshInstance3D>>,
    /// Godot's materials in the order of ours, which begin at 1.
    pub materials: Vec<Option<Gd<GodotMaterial>>>,
    reflected: Vec<Reflected>,
    /// Size, sRGB texels, and the linear color by which they are multiplied.
    textures: Vec<((u32, u32), Vec<u8>, Vec3)>,
    known: HashMap<Option<InstanceId>, Option<usize>>,
}

/// All nodes of a class below one.
pub fn below<T: Inherits<Node>>(node: &Gd<Node>, found: &mut Vec<Gd<T>>) {
    for child in node.get_children().iter_shared() {
        if let Ok(own) = child.clone().try_cast::<T>() {
            found.push(own);
        }
        below(&child, found);
    }
}

/// A color as linear RGB.
pub fn linear(color: Color) -> Vec3 {
    let own = color.srgb_to_linear();
    Vec3::new(own.r, own.g, own.b)
}

/// A vector of Godot's as one of ours.
pub fn vector(v: Vector3) -> Vec3 {
    Vec3::new(v.x, v.y, v.z)
}

/// A transform of Godot's as one of ours.
pub fn affine(transform: Transform3D) -> Affine3A {
    let [x, y, z] = [0, 1, 2].map(|axis| {
        vector(match axis {
            0 => transform.basis.col_a(),
            1 => transform.basis.col_b(),
            _ => transform.basis.col_c(),
        })
    });
    Affine3A::from_mat3_translation(Mat3::from_cols(x, y, z), vector(transform.origin))
}

/// The surface of a mesh as arrays without indices.
fn arrays_of(mesh: &Gd<godot::classes::Mesh>, surface: i32) -> VarArray {
    let mut tool = SurfaceTool::new_gd();
    tool.create_from(mesh, surface);
    tool.deindex();
    tool.commit_to_arrays()
}

fn array<T: FromGodot>(arrays: &VarArray, kind: ArrayType) -> Option<T> {
    arrays.get(kind.ord() as usize)?.try_to::<T>().ok()
}

impl Surface {
    fn new(name: String, arrays: &VarArray, material: usize) -> Option<Self> {
        let vectors = |kind| {
            let own = array::<PackedVector3Array>(arrays, kind)?;
            Some(own.as_slice().iter().map(|v| vector(*v)).collect::<Vec<_>>())
        };
        let positions = vectors(ArrayType::VERTEX)?;
        let normals = vectors(ArrayType::NORMAL).filter(|own| own.len() == positions.len()).unwrap_or_default();
        let uvs = array::<PackedVector2Array>(arrays, ArrayType::TEX_UV).filter(|own| own.len() == positions.len());
        // Ours begin at the bottom of a picture.
        let uvs = uvs.map(|own| own.as_slice().iter().map(|uv| Vec2::new(uv.x, 1.0 - uv.y)).collect());
        (!positions.is_empty()).then(|| Self { name, positions, normals, uvs: uvs.unwrap_or_default(), material })
    }

    /// The same for the library, whose triangles are counter-clockwise from the front.
    pub fn with_mesh<T>(&self, transform: Affine3A, take: impl FnOnce(&Mesh<'_>) -> T) -> T {
        let triangles = (0..self.positions.len() as u32 / 3).map(|k| 3 * k);
        let indices: Vec<u32> = triangles.flat_map(|first| [first, first + 2, first + 1]).collect();
        take(&Mesh {
            name: &self.name,
            positions: &self.positions,
            indices: &indices,
            normals: &self.normals,
            uvs: &self.uvs,
            material: MaterialId::of_scene(self.material + 1),
            transform,
        })
    }

    /// Corners of its triangles in the world, m, counter-clockwise from the front.
    pub fn corners(&self, transform: Affine3A) -> impl Iterator<Item = [Vec3; 3]> {
        let own = self.positions.chunks_exact(3);
        own.map(move |own| [own[0], own[2], own[1]].map(|corner| transform.transform_point3(corner)))
    }
}

impl Gathered {
    /// Gathers the meshes below a node that are seen: those with the GI mode static; of the dynamic ones those of the
    /// group [`MOVING`].
    pub fn new(node: &Gd<Node>) -> Self {
        let mut all = Self::default();
        let mut meshes = Vec::new();
        below::<MeshInstance3D>(node, &mut meshes);
        for instance in meshes.into_iter().filter(|instance| instance.is_visible_in_tree()) {
            match instance.get_gi_mode() {
                GiMode::STATIC => all.add(instance),
                GiMode::DYNAMIC if instance.is_in_group(MOVING) => all.moving.push(instance),
                _ => {}
            }
        }
        all
    }

    fn add(&mut self, instance: Gd<MeshInstance3D>) {
        let Some(mesh) = instance.get_mesh() else { return };
        let transform = affine(instance.get_global_transform());
        let mut own = Vec::new();
        for surface in 0..mesh.get_surface_count() {
            let arrays = arrays_of(&mesh, surface);
            let is_triangles = mesh
                .clone()
                .try_cast::<godot::classes::ArrayMesh>()
                .is_ok_and(|mesh| mesh.surface_get_primitive_type(surface) == PrimitiveType::TRIANGLES)
                || mesh.clone().try_cast::<godot::classes::ArrayMesh>().is_err();
            let material = self.material(instance.get_active_material(surface));
            let made = material
                .filter(|_| is_triangles)
                .and_then(|material| Surface::new(format!("{} {surface}", instance.get_name()), &arrays, material));
            let number = made.map(|made| {
                self.surfaces.push((made, transform));
                self.surfaces.len() - 1
            });
            own.push((arrays, number));
        }
        self.meshes.push((instance, own));
    }

    /// A surface of what moves, of a material that rests or the grey one.
    pub fn moving_surfaces(&self, instance: &Gd<MeshInstance3D>) -> Vec<Surface> {
        let Some(mesh) = instance.get_mesh() else { return Vec::new() };
        let surfaces = (0..mesh.get_surface_count()).filter_map(|surface| {
            let arrays = arrays_of(&mesh, surface);
            let id = instance.get_active_material(surface).map(|own| own.instance_id());
            let material = self.known.get(&id).copied().flatten().unwrap_or(0);
            Surface::new(instance.get_name().to_string(), &arrays, material)
        });
        surfaces.collect()
    }

    /// Number of a material; none for one that lets light through.
    fn material(&mut self, own: Option<Gd<GodotMaterial>>) -> Option<usize> {
        let key = own.as_ref().map(|own| own.instance_id());
        if let Some(&known) = self.known.get(&key) {
            return known;
        }
        let reflected = match own.clone().and_then(|own| own.try_cast::<BaseMaterial3D>().ok()) {
            Some(own) => self.reflected_of(&own),
            None => Some(Reflected { albedo: Vec3::splat(0.5), texture: None, cutoff: None }),
        };
        let number = reflected.map(|reflected| {
            self.reflected.push(reflected);
            self.materials.push(own);
            self.reflected.len() - 1
        });
        self.known.insert(key, number);
        number
    }

    fn reflected_of(&mut self, own: &Gd<BaseMaterial3D>) -> Option<Reflected> {
        let cutoff = match own.get_transparency() {
            Transparency::DISABLED => None,
            Transparency::ALPHA_SCISSOR => Some(own.get_alpha_scissor_threshold()),
            Transparency::ALPHA_HASH => Some(0.5),
            _ => return None,
        };
        let color = linear(own.get_albedo());
        let texture = own.get_texture(TextureParam::ALBEDO).and_then(|texture| self.texture(&texture, color));
        Some(Reflected { albedo: color.clamp(Vec3::ZERO, Vec3::splat(MAX_ALBEDO)), texture, cutoff })
    }

    fn texture(&mut self, texture: &Gd<Texture2D>, color: Vec3) -> Option<usize> {
        let mut image = texture.get_image()?;
        if image.is_compressed() && image.decompress() != godot::global::Error::OK {
            godot_warn!("Patchlight takes a material's color without its texture, which cannot be read");
            return None;
        }
        image.clear_mipmaps();
        image.convert(Format::RGBA8);
        let size = (image.get_width() as u32, image.get_height() as u32);
        self.textures.push((size, image.get_data().to_vec(), color));
        Some(self.textures.len() - 1)
    }

    /// What each material shines with, W/m²/sr, after the library's grey one.
    pub fn emission(&self) -> Vec<Vec3> {
        let of = |own: &Option<Gd<GodotMaterial>>| {
            let own = own.clone().and_then(|own| own.try_cast::<BaseMaterial3D>().ok());
            let own = own.filter(|own| own.get_feature(Feature::EMISSION));
            own.map_or(Vec3::ZERO, |own| linear(own.get_emission()) * own.get_emission_energy_multiplier())
        };
        std::iter::once(Vec3::ZERO).chain(self.materials.iter().map(of)).collect()
    }

    /// The scene of all surfaces under a light.
    ///
    /// # Errors
    /// A mesh or a light that makes no sense, by its name; no triangles.
    pub fn scene(&self, lighting: Lighting) -> Result<Scene, BuildError> {
        let mut builder = Scene::builder();
        let textures: Vec<_> =
            (self.textures.iter()).map(|(size, rgba, color)| builder.add_tinted_texture(*size, rgba, *color)).collect();
        for material in &self.reflected {
            match material.texture {
                Some(texture) => builder.add_textured(textures[texture], material.cutoff),
                None => builder.add_material(Material::diffuse(material.albedo)),
            };
        }
        for (surface, transform) in &self.surfaces {
            surface.with_mesh(*transform, |mesh| {
                builder.add_mesh(*mesh);
            });
        }
        let mut scene = builder.build()?;
        scene.set_lighting(lighting)?;
        Ok(scene)
    }

    /// The side of each triangle that a lightmap has: its front, unless only its back is lit and drawn.
    pub fn sides(&self, scene: &Scene) -> Vec<Sides> {
        let is_two_sided = |own: &Option<Gd<GodotMaterial>>| {
            let own = own.clone().and_then(|own| own.try_cast::<BaseMaterial3D>().ok());
            own.is_some_and(|own| own.get_cull_mode() == CullMode::DISABLED)
        };
        let two_sided: Vec<bool> = self.materials.iter().map(is_two_sided).collect();
        let side = |(triangle, lit): (&Triangle, Sides)| {
            let material = self.surfaces[triangle.object as usize].0.material;
            let is_back = two_sided[material] && lit.back && !lit.front;
            Sides { front: !is_back, back: is_back }
        };
        scene.geometry.triangles.iter().zip(find_sides(scene, SidePolicy::Lit)).map(side).collect()
    }

    /// Corners of all triangles, one surface after the other.
    pub fn corners(&self) -> Vec<[Vec3; 3]> {
        self.surfaces.iter().flat_map(|(surface, transform)| surface.corners(*transform)).collect()
    }
}
