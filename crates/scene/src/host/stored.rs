//! Geometry out of a file: its hierarchy is taken as it is, and checked, instead of built.

use alloc::sync::Arc;
use alloc::vec::Vec;

use glam::Vec3;
use serde::Deserialize;

use super::geometry::Geometry;
use super::hierarchy;
use super::scene::{SceneParts, check};
use crate::error::Error;
use crate::gpu::*;

/// Most texels of a row or a column of a picture, and levels of its pyramid.
const MAX_TEXELS: u32 = 1 << 15;
const MAX_LEVELS: u32 = 16;

/// The tables that a [`Geometry`] is written as, in the same order.
#[derive(Deserialize)]
pub(super) struct Tables {
    #[serde(with = "crate::pod::table")]
    triangles: Vec<Triangle>,
    #[serde(with = "crate::pod::table")]
    uvs: Vec<TriangleUv>,
    #[serde(with = "crate::pod::table")]
    materials: Arc<[Material]>,
    #[serde(with = "crate::pod::table")]
    finishes: Vec<Finish>,
    #[serde(with = "crate::pod::table")]
    textures: Vec<Texture>,
    #[serde(with = "crate::pod::table")]
    texels: Vec<u32>,
    #[serde(with = "crate::pod::table")]
    nodes: Vec<BvhNode>,
    ray_offset: f32,
    #[serde(with = "crate::pod::value")]
    absorption: Vec3,
}

impl TryFrom<Tables> for Geometry {
    type Error = Error;

    fn try_from(tables: Tables) -> Result<Self, Error> {
        let Tables { triangles, uvs, materials, finishes, textures, texels, nodes, ray_offset, absorption } = tables;
        let materials = materials.to_vec();
        let parts =
            SceneParts { triangles, uvs, materials, finishes, textures, texels, absorption, ..SceneParts::default() };
        // Beyond these no size can be counted.
        let is_countable = |t: &Texture| t.width.max(t.height) <= MAX_TEXELS && t.levels <= MAX_LEVELS;
        if !parts.textures.iter().all(is_countable) {
            return Err(Error::TextureSize);
        }
        check(&parts)?;
        if !hierarchy::is_sound(&nodes, parts.triangles.len()) {
            return Err(Error::Hierarchy);
        }
        let mut geometry = Self::of_leaves(parts, nodes)?;
        geometry.ray_offset = ray_offset;
        Ok(geometry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scene;

    fn stored() -> Tables {
        let triangle = |x: f32| Triangle {
            corner: Vec3::new(x, 0.0, 0.0),
            edge_a: Vec3::X,
            edge_b: Vec3::Z,
            ..Triangle::default()
        };
        let parts = SceneParts {
            triangles: (0..40).map(|k| triangle(3.0 * k as f32)).collect(),
            uvs: alloc::vec![TriangleUv::default(); 40],
            materials: alloc::vec![Material::default()],
            ..SceneParts::default()
        };
        let scene = Scene::new(parts).unwrap();
        let g = scene.geometry;
        Tables {
            triangles: g.triangles.clone(),
            uvs: g.uvs.clone(),
            materials: g.materials.clone(),
            finishes: Vec::new(),
            textures: Vec::new(),
            texels: Vec::new(),
            nodes: g.nodes.clone(),
            ray_offset: g.ray_offset,
            absorption: g.absorption,
        }
    }

    #[test]
    fn rays_meet_the_same_after_a_file() {
        let geometry = Geometry::try_from(stored()).unwrap();
        for k in 0..40 {
            let hit = geometry.closest_before(Vec3::new(3.0 * k as f32 + 0.25, 1.0, 0.25), Vec3::NEG_Y, 10.0);
            assert_eq!(geometry.triangles[hit.triangle as usize].corner.x, 3.0 * k as f32);
        }
    }

    #[test]
    fn a_hierarchy_that_is_none_is_refused() {
        let damages: [fn(&mut Tables); 4] = [
            |t| t.nodes.clear(),
            |t| t.nodes[0].first_index = 0,
            |t| t.nodes[0].first_index = 1 << 30,
            |t| t.nodes.last_mut().unwrap().prim_count = 41,
        ];
        for damage in damages {
            let mut tables = stored();
            damage(&mut tables);
            assert_eq!(Geometry::try_from(tables).err(), Some(Error::Hierarchy));
        }
    }
}
