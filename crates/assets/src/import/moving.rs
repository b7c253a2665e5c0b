//! Objects of a scene that move.

use glam::{Affine3A, Quat, Vec2, Vec3};
use scene::{MaterialId, Mesh, Scene};
use serde::{Deserialize, Serialize};

use super::draft::FileTriangle;
use super::{ImportError, LoadedScene};

/// Place of an object at a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Time, s.
    pub time: f32,
    /// Where its origin is, m.
    pub position: Vec3,
    /// Its rotation about that.
    pub rotation: Quat,
}

/// A rigid mesh of one material that moves through a scene, which does not have it among its triangles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MovingObject {
    /// Its name.
    pub name: String,
    /// Material, by its number in the scene.
    pub material: usize,
    /// Three corners of each triangle about its origin, counter-clockwise from the front, m.
    pub corners: Vec<Vec3>,
    /// Texture coordinates of each corner, v = 0 at the bottom row; none where all are 0.
    pub uvs: Vec<Vec2>,
    /// At least one pose, times ascending; between them positions go straight and rotations turn evenly, before the
    /// first and after the last it rests.
    pub poses: Vec<Pose>,
}

impl MovingObject {
    /// Of some triangles of a file.
    pub(crate) fn of_triangles<'a>(
        name: String,
        material: usize,
        triangles: impl Iterator<Item = &'a FileTriangle> + Clone,
        poses: Vec<Pose>,
    ) -> Self {
        let corners = triangles.clone().flat_map(|triangle| triangle.corners).collect();
        let mut uvs: Vec<Vec2> = triangles.flat_map(|triangle| triangle.uvs).collect();
        if uvs.iter().all(|&uv| uv == Vec2::ZERO) {
            uvs = Vec::new();
        }
        Self { name, material, corners, uvs, poses }
    }

    /// In metres, of units that have so many.
    pub(crate) fn scaled(mut self, metres: f32) -> Self {
        self.corners.iter_mut().for_each(|corner| *corner *= metres);
        self.poses.iter_mut().for_each(|pose| pose.position *= metres);
        self
    }

    /// Its place at a time, s.
    pub fn transform(&self, time: f32) -> Affine3A {
        let next = self.poses.partition_point(|pose| pose.time <= time);
        let before = next.checked_sub(1).and_then(|k| self.poses.get(k));
        match (before, self.poses.get(next)) {
            (Some(a), Some(b)) => {
                let share = (time - a.time) / (b.time - a.time);
                let rotation = a.rotation.slerp(b.rotation, share);
                Affine3A::from_rotation_translation(rotation, a.position.lerp(b.position, share))
            }
            (Some(pose), None) | (None, Some(pose)) => {
                Affine3A::from_rotation_translation(pose.rotation, pose.position)
            }
            (None, None) => Affine3A::IDENTITY,
        }
    }

    /// Its mesh, about its origin.
    pub fn mesh(&self) -> Mesh<'_> {
        Mesh {
            name: &self.name,
            positions: &self.corners,
            uvs: &self.uvs,
            material: MaterialId::of_scene(self.material),
            ..Mesh::default()
        }
    }
}

impl LoadedScene {
    /// Time of the last pose of an object that moves, s; 0 where none does.
    pub fn moving_duration(&self) -> f32 {
        let last = self.moving.iter().filter_map(|object| object.poses.last());
        last.map(|pose| pose.time).fold(0.0, f32::max)
    }

    /// The scene with the objects that move where they are at a time, s, among its triangles.
    ///
    /// # Errors
    /// What is wrong with an object's mesh.
    pub fn scene_at(&self, time: f32) -> Result<Scene, ImportError> {
        if self.moving.is_empty() {
            return Ok(self.scene.clone());
        }
        let mut edit = self.scene.edit();
        for object in &self.moving {
            edit.add(Mesh { transform: object.transform(time), ..object.mesh() });
        }
        edit.build().map_err(|source| ImportError::Moving { scene: self.name.clone(), source })
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;

    use super::*;

    #[test]
    fn poses_are_met_and_joined() {
        let pose = |time: f32, x: f32, angle: f32| Pose {
            time,
            position: Vec3::X * x,
            rotation: Quat::from_rotation_y(angle),
        };
        let poses = vec![pose(1.0, 0.0, 0.0), pose(3.0, 4.0, FRAC_PI_2)];
        let object = MovingObject::of_triangles(String::new(), 0, [].iter(), poses);
        let at = |time: f32| object.transform(time).transform_point3(Vec3::X);
        assert!((at(0.0) - Vec3::X).length() < 1e-6 && (at(9.0) - Vec3::new(4.0, 0.0, -1.0)).length() < 1e-6);
        let half = std::f32::consts::FRAC_1_SQRT_2;
        assert!((at(2.0) - Vec3::new(2.0 + half, 0.0, -half)).length() < 1e-6, "{}", at(2.0));
    }

    #[test]
    fn a_scene_has_its_objects_where_they_are() {
        for (spec, triangles) in [("cornell:block", 12), ("rooms:door", 12)] {
            let loaded = crate::load_or_build(spec).unwrap();
            let count = |scene: &Scene| scene.geometry.triangles.len();
            let end = loaded.moving_duration();
            assert!(end > 0.0);
            assert_eq!(count(&loaded.scene_at(0.0).unwrap()), count(&loaded.scene) + triangles, "{spec}");
            assert!(loaded.scene_at(0.0).unwrap().geometry.bounds == loaded.scene.geometry.bounds, "{spec}");
            let object = &loaded.moving[0];
            assert!(object.transform(0.0) != object.transform(0.5 * end));
            let again = LoadedScene::of_description(loaded.scene.clone(), &loaded.description()).unwrap();
            assert_eq!(again.moving, loaded.moving);
        }
        assert!(crate::load_or_build("cornell").unwrap().moving.is_empty());
        assert!(crate::load_or_build("cornell:wall").is_err());
    }
}
