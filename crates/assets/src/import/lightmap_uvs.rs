//! Texture coordinates that a file brings for a lightmap: glTF's `TEXCOORD_1`.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};
use scene::gpu::{Triangle, TriangleUv};

/// A triangle of a file and its place in the atlas.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct AtlasTriangle {
    /// Corners, m.
    pub corners: [Vec3; 3],
    /// Their coordinates in the atlas, [0, 1]² from the upper left.
    pub uvs: [Vec2; 3],
}

/// Places in an atlas of all triangles of a file, by [`Triangle::source`]; empty where the file has none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightmapUvs(pub(crate) Vec<AtlasTriangle>);

/// Coordinates may be so far out of [0, 1]: rounding.
const BEYOND: f32 = 1e-4;

impl LightmapUvs {
    /// Returns true if there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The place of a triangle of the scene, which may be a part of one of the file. None where the file has none for
    /// it.
    pub fn of(&self, triangle: &Triangle) -> Option<TriangleUv> {
        let whole = self.0.get(triangle.source as usize)?;
        let [a, b, c] = whole.corners;
        let edge_a = b - a;
        let edge_b = c - a;
        let normal = edge_a.cross(edge_b);
        let squared = normal.length_squared();
        let place = |p: Vec3| -> Vec2 {
            let from = p - a;
            let u = from.cross(edge_b).dot(normal) / squared;
            let v = edge_a.cross(from).dot(normal) / squared;
            whole.uvs[0] + (whole.uvs[1] - whole.uvs[0]) * u + (whole.uvs[2] - whole.uvs[0]) * v
        };
        // Corners of the file keep their own coordinates.
        let near = |p: Vec3| {
            let corner = whole.corners.iter().position(|corner| *corner == p);
            corner.map_or_else(|| place(p), |corner| whole.uvs[corner])
        };
        let ends = [triangle.corner, triangle.corner + triangle.edge_a, triangle.corner + triangle.edge_b];
        let [corner, corner_a, corner_b] = ends.map(near);
        let is_sound = [corner, corner_a, corner_b].iter().all(|uv| uv.is_finite());
        is_sound.then_some(TriangleUv { corner, corner_a, corner_b, ..TriangleUv::default() })
    }

    /// Says what is wrong with coordinates that are no atlas: outside of it, or without extent.
    pub(crate) fn fault(&self) -> Option<String> {
        let is_out = |uv: &Vec2| !(uv.min_element() >= -BEYOND && uv.max_element() <= 1.0 + BEYOND);
        if let Some((k, t)) = self.0.iter().enumerate().find(|(_, t)| t.uvs.iter().any(is_out)) {
            let uv = t.uvs.iter().find(|uv| is_out(uv)).copied().unwrap_or_default();
            return Some(format!("triangle {} has {uv}, outside of the texture", k + 1));
        }
        (self.0.iter().map(|t| (t.uvs[1] - t.uvs[0]).perp_dot(t.uvs[2] - t.uvs[0]).abs()).sum::<f32>() <= 0.0)
            .then(|| "no triangle covers any of the texture".to_owned())
    }

    /// As text, for a description of the scene.
    pub(crate) fn to_text(&self) -> String {
        STANDARD.encode(bytemuck::cast_slice::<_, u8>(&self.0))
    }

    pub(crate) fn of_text(text: &str) -> Result<Self, String> {
        let bytes = STANDARD.decode(text).map_err(|error| error.to_string())?;
        let triangles = bytes.chunks_exact(size_of::<AtlasTriangle>());
        if !triangles.remainder().is_empty() {
            return Err("its lightmap coordinates are cut short".into());
        }
        Ok(Self(triangles.map(bytemuck::pod_read_unaligned).collect()))
    }
}
