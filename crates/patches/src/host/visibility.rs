//! Mutual visibility of points on a surface.

use glam::Vec3;
use scene::{Ray, Scene, SurfacePoint, Visibility};

use crate::types::Sample;

/// Height at which points look, in edges between samples: above what bends in between.
const LIFT: f32 = 0.1;
/// Height as a share of their distance for every unit that their normals differ: twice the height
/// of an arc over its chord.
const ARC: f32 = 0.25;

/// Height up to which a surface over a place covers it, in edges between samples: samples that far from each other do
/// not know how light falls off in so narrow a gap.
const COVER: f32 = 0.25;

/// A position on a surface, and the side that it is on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePlace {
    /// Position, m.
    pub position: Vec3,
    /// Unit normal of the side.
    pub normal: Vec3,
}

impl From<&Sample> for SurfacePlace {
    fn from(sample: &Sample) -> Self {
        Self { position: sample.position, normal: sample.normal }
    }
}

impl From<&SurfacePoint> for SurfacePlace {
    fn from(point: &SurfacePoint) -> Self {
        Self { position: point.position, normal: point.normal }
    }
}

/// Returns true if a surface lies close over a place of one with samples every `edge` m, as a poster over its wall.
pub fn is_covered(scene: &Scene, place: SurfacePlace, edge: f32) -> bool {
    has_cover(scene, place, COVER * edge)
}

/// Returns true if a surface lies over a place up to a height, m.
fn has_cover(scene: &Scene, place: SurfacePlace, height: f32) -> bool {
    let above = |height: f32| place.position + place.normal * (scene.geometry.ray_offset + height);
    scene.any_hit(above(0.0), above(height))
}

/// Returns true if a place of a surface with samples every `edge` m lies in a gap that is narrower than [`is_visible`]
/// lifts it, as behind a cupboard at its wall: it would look from beyond the wall.
pub fn is_in_gap(scene: &Scene, place: SurfacePlace, edge: f32) -> bool {
    has_cover(scene, place, LIFT * edge)
}

/// Returns true if nothing stands between two places of a surface with samples every `edge` m.
pub fn is_visible(scene: &Scene, from: SurfacePlace, to: SurfacePlace, edge: f32) -> bool {
    let Ray { origin, direction, t_max, .. } = sight(scene, from, to, edge);
    !scene.occluded(origin, direction, t_max)
}

/// The ray that is stopped where something stands between two places of a surface with samples every `edge` m.
pub fn sight(scene: &Scene, from: SurfacePlace, to: SurfacePlace, edge: f32) -> Ray {
    let arc = ARC * from.position.distance(to.position) * from.normal.distance(to.normal);
    let height = scene.geometry.ray_offset + LIFT * edge + arc;
    let origin = from.position + from.normal * height;
    Ray { origin, t_max: 1.0, direction: to.position + to.normal * height - origin, reserved: 0 }
}
