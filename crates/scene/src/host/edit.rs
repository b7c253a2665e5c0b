//! A scene whose objects change.

use alloc::sync::Arc;
use alloc::vec::Vec;

use glam::Affine3A;

use super::builder::{BuildError, Mesh, SceneBuilder, normal_matrix};
use super::lighting::Lighting;
use super::scene::{Scene, SceneParts};
use crate::gpu::Material;

/// A copy of a scene in which objects are moved, taken away and added; [`Scene::edit`] makes one. Materials and lighting
/// stay.
///
/// ```
/// use glam::{Affine3A, Vec3};
/// use patchlight_scene::{Mesh, Scene};
///
/// let corners = [Vec3::ZERO, Vec3::Z, Vec3::X];
/// let mut builder = Scene::builder();
/// builder.add_mesh(Mesh { name: "floor", positions: &corners, ..Mesh::default() });
/// let shelf = builder.add_mesh(Mesh { name: "shelf", positions: &corners, ..Mesh::default() }).object();
/// let scene = builder.build()?;
///
/// let mut edit = scene.edit();
/// edit.transform(shelf, Affine3A::from_translation(Vec3::Y));
/// let raised = edit.build()?;
/// assert_eq!(raised.geometry.bounds.1.y, 1.0);
/// # Ok::<(), patchlight_scene::BuildError>(())
/// ```
#[derive(Clone, Debug)]
pub struct SceneEdit {
    builder: SceneBuilder,
    materials: Arc<[Material]>,
    lighting: Lighting,
}

impl Scene {
    /// A copy to change. Objects are told by [`Triangle::object`](crate::gpu::Triangle::object).
    pub fn edit(&self) -> SceneEdit {
        let geometry = &self.geometry;
        let parts = SceneParts {
            triangles: geometry.triangles.clone(),
            uvs: geometry.uvs.clone(),
            materials: geometry.materials.to_vec(),
            finishes: geometry.finishes.clone(),
            textures: geometry.textures.clone(),
            texels: geometry.texels.to_vec(),
            ray_offset: Some(geometry.ray_offset),
            absorption: geometry.absorption,
            ..SceneParts::default()
        };
        let builder = SceneBuilder::of_parts(parts);
        SceneEdit { builder, materials: Arc::clone(&self.materials), lighting: self.lighting.clone() }
    }
}

impl SceneEdit {
    /// Takes an object away. One that is not there changes nothing.
    pub fn remove(&mut self, object: u32) -> &mut Self {
        let SceneParts { triangles, uvs, .. } = self.builder.parts_mut();
        let stays: Vec<bool> = triangles.iter().map(|t| t.object != object).collect();
        let mut k = stays.iter();
        triangles.retain(|_| k.next() == Some(&true));
        let mut k = stays.iter();
        uvs.retain(|_| k.next() == Some(&true));
        self
    }

    /// Moves, turns or scales an object. A transform that mirrors keeps the front in front.
    pub fn transform(&mut self, object: u32, transform: Affine3A) -> &mut Self {
        let is_mirrored = transform.matrix3.determinant() < 0.0;
        let turned = normal_matrix(&transform);
        let SceneParts { triangles, uvs, .. } = self.builder.parts_mut();
        for (triangle, uv) in triangles.iter_mut().zip(uvs).filter(|(t, _)| t.object == object) {
            triangle.corner = transform.transform_point3(triangle.corner);
            triangle.edge_a = transform.transform_vector3(triangle.edge_a);
            triangle.edge_b = transform.transform_vector3(triangle.edge_b);
            let mut normals = uv.normals().map(|normals| normals.map(|normal| turned * normal));
            if is_mirrored {
                core::mem::swap(&mut triangle.edge_a, &mut triangle.edge_b);
                core::mem::swap(&mut uv.corner_a, &mut uv.corner_b);
                normals = normals.map(|[first, second, third]| [first, third, second]);
            }
            *uv = uv.with_normals(triangle, normals.unwrap_or_default());
        }
        self
    }

    /// Adds an object; returns its number. Its material is one of the scene ([`MaterialId::of_scene`](super::MaterialId::of_scene)).
    pub fn add(&mut self, mesh: Mesh) -> u32 {
        self.builder.add_mesh(mesh).object()
    }

    /// The changed scene.
    ///
    /// # Errors
    /// What was wrong first with an added mesh; [`BuildError::Scene`] where no triangle is left, or one is moved to
    /// where there is no number.
    pub fn build(self) -> Result<Scene, BuildError> {
        let mut scene = self.builder.build()?;
        scene.materials = self.materials;
        scene.set_lighting(self.lighting).map_err(BuildError::Scene)?;
        Ok(scene)
    }
}
