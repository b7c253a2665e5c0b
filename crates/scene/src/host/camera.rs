//! Cameras from a place and a view.

use glam::Vec3;

use crate::Camera;
use crate::math::tan;

impl Camera {
    /// A pinhole at `eye` that looks at `target`.
    pub fn look_at(eye: Vec3, target: Vec3, up: Vec3, vertical_fov_degrees: f32, width: u32, height: u32) -> Self {
        let forward = (target - eye).normalize();
        let right = forward.cross(up).normalize();
        let half = tan(0.5 * vertical_fov_degrees.to_radians());
        Self {
            eye,
            width,
            forward,
            height,
            right: right * (half * width as f32 / height as f32),
            fixed_sub_frames: 0,
            up: right.cross(forward) * half,
            reserved_b: 0,
        }
    }
}
