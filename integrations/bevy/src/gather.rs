//! Meshes and materials of a world as plain tables, and the scene that they make.

use std::collections::HashMap;

use bevy::asset::{AssetId, Assets, Handle};
use bevy::ecs::entity::Entity;
use bevy::image::Image;
use bevy::log::warn;
use bevy::math::Affine3A as BevyAffine;
use bevy::mesh::{Mesh as BevyMesh, PrimitiveTopology, VertexAttributeValues};
use bevy::pbr::StandardMaterial;
use bevy::prelude::{AlphaMode, ColorToComponents};
use bevy::render::render_resource::TextureFormat;
use patchlight::glam::{Affine3A, Mat3, Vec2, Vec3};
use patchlight::scene::BuildError;
use patchlight::{Lighting, MAX_ALBEDO, Material, MaterialId, Mesh, Scene};

use crate::lights::vector;

/// A mesh of the world.
#[derive(Clone, Debug)]
pub(crate) struct MeshParts {
    pub entity: Entity,
    pub name: String,
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub uvs: Vec<Vec2>,
    pub indices: Vec<u32>,
    pub transform: Affine3A,
    /// Its number in [`Snapshot::materials`].
    pub material: usize,
    /// True if its back is drawn, too.
    pub is_two_sided: bool,
}

/// What a material reflects.
#[derive(Clone, Debug)]
struct MaterialParts {
    albedo: Vec3,
    texture: Option<usize>,
    cutoff: Option<f32>,
}

/// The resting part of a world, and the materials of what moves.
#[derive(Clone, Debug, Default)]
pub(crate) struct Snapshot {
    pub meshes: Vec<MeshParts>,
    /// Bevy's materials, in the order of ours, which begin at 1.
    pub ids: Vec<AssetId<StandardMaterial>>,
    materials: Vec<MaterialParts>,
    /// Size, sRGB texels, and the linear color by which they are multiplied.
    textures: Vec<((u32, u32), Vec<u8>, Vec3)>,
    known: HashMap<AssetId<StandardMaterial>, usize>,
    textures_known: HashMap<(AssetId<Image>, [u32; 3]), Option<usize>>,
}

/// What a mesh is made of where it can be used.
pub(crate) fn parts(
    (entity, name): (Entity, String),
    mesh: &BevyMesh,
    transform: &BevyAffine,
    (material, own): (usize, &StandardMaterial),
) -> Option<MeshParts> {
    if mesh.primitive_topology() != PrimitiveTopology::TriangleList {
        warn!("Patchlight leaves out the mesh {name}: it is no list of triangles");
        return None;
    }
    let Ok(Some(positions)) = mesh.try_attribute_option(BevyMesh::ATTRIBUTE_POSITION) else {
        warn!(
            "Patchlight leaves out the mesh {name}: its vertices are on the graphics card only; give it \
             RenderAssetUsages::default()"
        );
        return None;
    };
    let vectors = |values: &VertexAttributeValues| -> Option<Vec<Vec3>> {
        Some(values.as_float3()?.iter().map(|v| Vec3::from(*v)).collect())
    };
    let positions = vectors(positions)?;
    let normals = mesh.try_attribute_option(BevyMesh::ATTRIBUTE_NORMAL).ok().flatten().and_then(vectors);
    let uvs = match mesh.try_attribute_option(BevyMesh::ATTRIBUTE_UV_0) {
        // Ours begin at the bottom of a picture.
        Ok(Some(VertexAttributeValues::Float32x2(uvs))) => uvs.iter().map(|uv| Vec2::new(uv[0], 1.0 - uv[1])).collect(),
        _ => Vec::new(),
    };
    let indices = match mesh.try_indices_option() {
        Ok(Some(indices)) => indices.iter().map(|index| index as u32).collect(),
        _ => (0..positions.len() as u32).collect(),
    };
    Some(MeshParts {
        entity,
        name,
        positions,
        normals: normals.unwrap_or_default(),
        uvs,
        indices,
        transform: affine(transform),
        material,
        is_two_sided: own.double_sided || own.cull_mode.is_none(),
    })
}

/// A transform of Bevy's as one of ours.
pub(crate) fn affine(transform: &BevyAffine) -> Affine3A {
    let axis = |v: bevy::math::Vec3A| vector(v.into());
    let m = &transform.matrix3;
    let matrix = Mat3::from_cols(axis(m.x_axis), axis(m.y_axis), axis(m.z_axis));
    Affine3A::from_mat3_translation(matrix, axis(transform.translation))
}

impl MeshParts {
    /// Corners of its triangles in the world, m.
    pub fn corners(&self) -> impl Iterator<Item = [Vec3; 3]> {
        let place = |&vertex: &u32| self.transform.transform_point3(self.positions[vertex as usize]);
        self.indices.chunks_exact(3).map(move |own| [place(&own[0]), place(&own[1]), place(&own[2])])
    }

    /// The same for the library, of a material with this number.
    pub fn mesh(&self, transform: Affine3A) -> Mesh<'_> {
        Mesh {
            name: &self.name,
            positions: &self.positions,
            indices: &self.indices,
            normals: &self.normals,
            uvs: &self.uvs,
            material: MaterialId::of_scene(self.material + 1),
            transform,
        }
    }
}

impl Snapshot {
    /// Number of a material; none for one that lets light through, like glass.
    pub fn material(
        &mut self,
        handle: &Handle<StandardMaterial>,
        material: &StandardMaterial,
        images: &Assets<Image>,
    ) -> Option<usize> {
        let cutoff = match material.alpha_mode {
            AlphaMode::Opaque => None,
            AlphaMode::Mask(cutoff) => Some(cutoff),
            AlphaMode::AlphaToCoverage => Some(0.5),
            _ => return None,
        };
        if let Some(&number) = self.known.get(&handle.id()) {
            return Some(number);
        }
        let color = Vec3::from(material.base_color.to_linear().to_f32_array_no_alpha());
        let texture = material.base_color_texture.as_ref().and_then(|texture| self.texture(texture, color, images));
        let albedo = color.clamp(Vec3::ZERO, Vec3::splat(MAX_ALBEDO));
        let number = self.materials.len();
        self.materials.push(MaterialParts { albedo, texture, cutoff });
        self.ids.push(handle.id());
        self.known.insert(handle.id(), number);
        Some(number)
    }

    /// Number of a material that a snapshot has, or of the one whose reflectance is nearest.
    pub fn nearest(&self, handle: &Handle<StandardMaterial>, material: &StandardMaterial) -> usize {
        let color = Vec3::from(material.base_color.to_linear().to_f32_array_no_alpha());
        let distance = |k: usize| self.materials[k].albedo.distance_squared(color);
        let nearest = (0..self.materials.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        self.known.get(&handle.id()).copied().or(nearest).unwrap_or(0)
    }

    /// Number of a texture times a colour; none where the picture cannot be read.
    fn texture(&mut self, handle: &Handle<Image>, color: Vec3, images: &Assets<Image>) -> Option<usize> {
        let key = (handle.id(), color.to_array().map(f32::to_bits));
        if let Some(&known) = self.textures_known.get(&key) {
            return known;
        }
        let bytes = images.get(handle).and_then(|image| {
            let own = image.convert(TextureFormat::Rgba8UnormSrgb)?;
            let (size, mut texels) = ((own.width(), own.height()), own.data?);
            // Coarser levels follow.
            texels.truncate(4 * size.0 as usize * size.1 as usize);
            Some((size, texels, color))
        });
        if bytes.is_none() {
            warn!(
                "Patchlight takes the base colour of a material without its texture, which is compressed, or on the graphics \
                 card only"
            );
        }
        let number = bytes.map(|texture| {
            self.textures.push(texture);
            self.textures.len() - 1
        });
        self.textures_known.insert(key, number);
        number
    }

    /// The scene of all meshes under a light.
    ///
    /// # Errors
    /// A mesh or a light that makes no sense, by its name; no triangles.
    pub fn scene(&self, lighting: Lighting) -> Result<Scene, BuildError> {
        let mut builder = Scene::builder();
        let textures: Vec<_> =
            (self.textures.iter()).map(|(size, rgba, color)| builder.add_tinted_texture(*size, rgba, *color)).collect();
        for material in &self.materials {
            match material.texture {
                Some(texture) => builder.add_textured(textures[texture], material.cutoff),
                None => builder.add_material(Material::diffuse(material.albedo)),
            };
        }
        for mesh in &self.meshes {
            builder.add_mesh(mesh.mesh(mesh.transform));
        }
        let mut scene = builder.build()?;
        scene.set_lighting(lighting)?;
        Ok(scene)
    }
}
