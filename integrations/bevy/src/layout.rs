//! The lightmap of a scene as Bevy has it: second texture coordinates of meshes, and half floats.

use bevy::mesh::Mesh as BevyMesh;
use half::f16;
use patchlight::glam::{Vec2, Vec3};
use patchlight::outputs::LiveLightmap;
use patchlight::scene::gpu::Triangle;
use patchlight::scene::{NONE, SidePolicy, Sides, find_sides};
use patchlight::{Error, Scene};
use rayon::prelude::*;

use crate::gather::{MeshParts, Snapshot};
use crate::shared::Layout;

/// Rows below the atlas that stay dark, for triangles to which no light comes.
const DARK_ROWS: u32 = 2;

/// Lays out the meshes of a snapshot, whose scene this is, with texels of so many metres.
///
/// # Errors
/// More texels than an atlas has.
pub(crate) fn lightmap(scene: &Scene, snapshot: &Snapshot, texel: f32) -> Result<LiveLightmap, Error> {
    let lit = find_sides(scene, SidePolicy::Lit);
    let triangles = &scene.geometry.triangles;
    // A mesh has one place for a triangle: that of its front, unless only its back is lit. A front that no surface sees may
    // see the sky.
    let side = |(triangle, lit): (&Triangle, Sides)| {
        let is_back = snapshot.meshes[triangle.object as usize].is_two_sided && lit.back && !lit.front;
        Sides { front: !is_back, back: is_back }
    };
    let sides: Vec<Sides> = triangles.iter().zip(lit).map(side).collect();
    LiveLightmap::of_sides(scene, &sides, texel)
}

/// Texels of a row of the picture of a lightmap, and rows.
pub(crate) fn size(lightmap: &LiveLightmap) -> (u32, u32) {
    let (width, height) = lightmap.size();
    (width, height + DARK_ROWS)
}

/// Texture coordinates of the corners of each mesh of a snapshot, three for each of its triangles.
pub(crate) fn corner_uvs(lightmap: &LiveLightmap, snapshot: &Snapshot) -> Vec<Vec<[f32; 2]>> {
    let (width, height) = lightmap.size();
    let all = (height + DARK_ROWS) as f32;
    let dark = [0.5 / width as f32, 1.0 - 0.5 / all];
    let in_picture = |uv: Vec2| [uv.x, uv.y * height as f32 / all];
    let corners: Vec<[Vec3; 3]> = snapshot.meshes.iter().flat_map(MeshParts::corners).collect();
    let uvs = lightmap.corner_uvs(&corners);
    let mut uvs = uvs.iter().flat_map(|uvs| uvs.map_or([dark; 3], |uvs| uvs.map(in_picture)));
    let mut of_mesh = |mesh: &MeshParts| uvs.by_ref().take(mesh.indices.len()).collect();
    snapshot.meshes.iter().map(&mut of_mesh).collect()
}

/// A mesh with its places in the lightmap as second texture coordinates.
pub(crate) fn lit_mesh(mesh: &BevyMesh, uvs: &[[f32; 2]]) -> BevyMesh {
    let mut own = mesh.clone();
    if own.indices().is_some() {
        own.duplicate_vertices();
    }
    own.insert_attribute(BevyMesh::ATTRIBUTE_UV_1, uvs.to_vec());
    own
}

/// The receivers of the texels of a lightmap's picture.
pub(crate) fn shown(lightmap: &LiveLightmap) -> Layout {
    let (width, height) = size(lightmap);
    let mut shown = lightmap.shown().to_vec();
    shown.resize(width as usize * height as usize, NONE);
    Layout { size: [width, height, 1], shown }
}

/// Irradiance at the receivers of a lightmap as texels of its picture: radiance of a white surface, `E / π`.
pub(crate) fn picture(lightmap: &LiveLightmap, values: &[Vec3]) -> Vec<u8> {
    let texel = |&receiver: &u32| values.get(receiver as usize).map_or([f16::ZERO; 4], |value| half_texel(*value));
    let texels = lightmap.shown().par_iter().map(texel);
    let mut bytes: Vec<u8> = texels.flat_map_iter(|texel| texel.into_iter().flat_map(f16::to_le_bytes)).collect();
    let (width, height) = size(lightmap);
    bytes.resize(8 * width as usize * height as usize, 0);
    bytes
}

/// Radiance of a white surface with this irradiance, as a texel.
pub(crate) fn half_texel(irradiance: Vec3) -> [f16; 4] {
    let half = |x: f32| f16::from_f32((x * std::f32::consts::FRAC_1_PI).min(f16::MAX.to_f32()));
    [half(irradiance.x), half(irradiance.y), half(irradiance.z), f16::ONE]
}
