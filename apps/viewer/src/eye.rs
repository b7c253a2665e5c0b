//! Who looks: a camera that flies.

use std::f32::consts::FRAC_PI_2;

use assets::View;
use glam::{Quat, Vec3, vec3};
use scene::Camera;
use scene::math::{acos, atan2, pow, tan};

/// Steepest look, radians from level: straight up or down has no right.
const STEEPEST: f32 = 1.55;
/// Times as fast with Shift.
const FAST: f32 = 4.0;
/// Times as fast for each step of the wheel.
const WHEEL: f32 = 1.2;
/// Seconds to cross the scene, at first.
const CROSSING: f32 = 12.0;

/// A camera by place and direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// Position, m.
    pub position: Vec3,
    /// Turn about up, radians, to the right of a level direction that up alone decides.
    pub yaw: f32,
    /// Angle above level, radians.
    pub pitch: f32,
    /// Vertical field of view, degrees.
    pub fov_degrees: f32,
    /// Unit vector upwards.
    up: Vec3,
    /// Metres a second.
    pub speed: f32,
}

/// Keys that are held: each −1, 0 or 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flight {
    /// To the right.
    pub right: f32,
    /// Up.
    pub up: f32,
    /// Forward.
    pub forward: f32,
    /// True if it goes fast.
    pub is_fast: bool,
}

impl Eye {
    /// The eye of a view, as fast as a scene of so many metres asks for.
    pub fn of_view(view: &View, scene_metres: f32) -> Self {
        let up = view.up.try_normalize().unwrap_or(Vec3::Y);
        let mut eye = Self {
            position: view.eye,
            yaw: 0.0,
            pitch: 0.0,
            fov_degrees: view.vertical_fov_degrees,
            up,
            speed: scene_metres.max(1e-3) / CROSSING,
        };
        eye.look_along((view.target - view.eye).try_normalize().unwrap_or(eye.level()));
        eye
    }

    /// A level direction, and the one to its right.
    fn axes(&self) -> (Vec3, Vec3) {
        let other = if self.up.dot(Vec3::Z).abs() < 0.9 { Vec3::Z } else { Vec3::Y };
        let right = other.cross(self.up).normalize();
        (self.up.cross(right), right)
    }

    /// The direction of yaw and pitch 0.
    fn level(&self) -> Vec3 {
        self.axes().0
    }

    /// Turns to a unit direction.
    pub fn look_along(&mut self, direction: Vec3) {
        let (ahead, right) = self.axes();
        self.pitch = (FRAC_PI_2 - acos(direction.dot(self.up))).clamp(-STEEPEST, STEEPEST);
        self.yaw = atan2(direction.dot(right), direction.dot(ahead));
    }

    /// Unit direction of the look.
    pub fn forward(&self) -> Vec3 {
        let (ahead, right) = self.axes();
        Quat::from_axis_angle(self.up, -self.yaw) * (Quat::from_axis_angle(right, self.pitch) * ahead)
    }

    /// Turns so that what was under the pointer stays there, after it moved by so many pixels of a picture so high.
    pub fn turn(&mut self, pixels: (f32, f32), height: f32) {
        let radians = 2.0 * tan(0.5 * self.fov_degrees.to_radians()) / height.max(1.0);
        self.yaw -= pixels.0 * radians;
        self.pitch = (self.pitch + pixels.1 * radians).clamp(-STEEPEST, STEEPEST);
    }

    /// Goes on for some seconds.
    pub fn fly(&mut self, flight: &Flight, seconds: f32) {
        let forward = self.forward();
        let right = forward.cross(self.up).normalize();
        let way = right * flight.right + self.up * flight.up + forward * flight.forward;
        let fast = if flight.is_fast { FAST } else { 1.0 };
        self.position += way * (self.speed * fast * seconds);
    }

    /// Makes it faster by steps of the wheel, slower by steps below 0.
    pub fn change_speed(&mut self, steps: f32) {
        self.speed = (self.speed * pow(WHEEL, steps)).clamp(1e-4, 1e6);
    }

    /// The pinhole for a picture size, pixels.
    pub fn camera(&self, (width, height): (u32, u32)) -> Camera {
        let target = self.position + self.forward();
        Camera::look_at(self.position, target, self.up, self.fov_degrees, width, height)
    }
}

/// Position of a point in a picture, as shares of its width and height from the upper left, with its depth, m; none
/// behind the eye.
pub fn project(camera: &Camera, point: Vec3) -> Option<Vec3> {
    let to = point - camera.eye;
    let depth = to.dot(camera.forward);
    if depth <= 0.0 {
        return None;
    }
    let across = to.dot(camera.right) / (depth * camera.right.length_squared());
    let upwards = to.dot(camera.up) / (depth * camera.up.length_squared());
    Some(vec3(0.5 + 0.5 * across, 0.5 - 0.5 * upwards, depth))
}

/// Displacement of a point at a depth when its picture moves by these shares of width and height.
pub fn moved(camera: &Camera, depth: f32, (x, y): (f32, f32)) -> Vec3 {
    (camera.right * (2.0 * x) - camera.up * (2.0 * y)) * depth
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        View { eye: vec3(1.0, 2.0, 3.0), target: vec3(4.0, 1.0, -2.0), up: Vec3::Y, vertical_fov_degrees: 50.0 }
    }

    #[test]
    fn an_eye_shows_what_its_view_shows() {
        for up in [Vec3::Y, Vec3::Z, Vec3::X] {
            let view = View { up, ..view() };
            let own = Eye::of_view(&view, 10.0).camera((64, 48));
            let expected = view.camera(64, 48);
            assert_eq!(own.eye, expected.eye);
            for (a, b) in [(own.forward, expected.forward), (own.right, expected.right), (own.up, expected.up)] {
                assert!(a.distance(b) < 1e-5, "{up}: {a} {b}");
            }
        }
    }

    #[test]
    fn a_projected_point_is_where_the_ray_through_it_goes() {
        let camera = view().camera(64, 48);
        let at = |x: f32, y: f32| camera.eye + 3.0 * (camera.forward + x * camera.right + y * camera.up);
        assert!(project(&camera, at(0.5, -0.25)).unwrap().distance(vec3(0.75, 0.625, 3.0)) < 1e-5);
        assert!(project(&camera, camera.eye - camera.forward).is_none());
        let there = at(0.5, -0.25) + moved(&camera, 3.0, (0.1, 0.2));
        assert!(project(&camera, there).unwrap().distance(vec3(0.85, 0.825, 3.0)) < 1e-5);
    }

    #[test]
    fn it_flies_along_its_look_and_turns_with_the_pointer() {
        let mut eye = Eye::of_view(&view(), 12.0);
        let before = eye.position;
        let forward = eye.forward();
        eye.fly(&Flight { forward: 1.0, ..Flight::default() }, 2.0);
        assert!(eye.position.distance(before + 2.0 * forward) < 1e-4, "a metre a second");
        eye.fly(&Flight { forward: -1.0, is_fast: true, ..Flight::default() }, 0.5);
        assert!(eye.position.distance(before) < 1e-4, "four times as fast");
        // What is in the middle goes with the pointer.
        let camera = eye.camera((100, 100));
        let point = camera.eye + 5.0 * camera.forward;
        eye.turn((3.0, 2.0), 100.0);
        let shown = project(&eye.camera((100, 100)), point).unwrap();
        assert!((shown.x - 0.53).abs() < 1e-3 && (shown.y - 0.52).abs() < 1e-3, "{shown}");
        for _ in 0..1000 {
            eye.turn((0.0, 50.0), 100.0);
        }
        assert!(eye.forward().is_finite() && eye.pitch <= STEEPEST);
    }
}
