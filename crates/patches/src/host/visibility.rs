//! Whether places of a surface see each other.

use glam::Vec3;
use scene::{Scene, Visibility};

/// Height at which places look, in edges between samples: above what bends in between.
const LIFT: f32 = 0.1;
/// The same as a share of their distance for every unit that their normals differ: twice the height of an arc over its chord.
const ARC: f32 = 0.25;

/// Whether nothing stands between two places with these normals, where samples are `edge` m apart.
pub fn sees(scene: &Scene, from: (Vec3, Vec3), to: (Vec3, Vec3), edge: f32) -> bool {
    let height = scene.geometry.ray_offset + LIFT * edge + ARC * from.0.distance(to.0) * from.1.distance(to.1);
    !scene.any_hit(from.0 + from.1 * height, to.0 + to.1 * height)
}
