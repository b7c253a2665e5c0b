//! Lights and the camera over time.

use glam::Vec3;
use scene::Light;
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_POINT};
use serde::{Deserialize, Serialize};

use super::{LoadedScene, View};

/// Target of a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Target {
    /// Position (or corner) of a light, m.
    LightPosition(usize),
    /// Direction of a light; made a unit vector after interpolation.
    LightDirection(usize),
    /// Irradiance, intensity or radiance of a light.
    LightColor(usize),
    /// Eye of the camera, m.
    CameraEye,
    /// Target of the camera, m.
    CameraTarget,
}

/// A value at a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Keyframe {
    /// Time, s.
    pub time: f32,
    /// Value, in metres or units of light.
    pub value: Vec3,
}

/// Keyframes of one value, in the order of time; linear between them, constant before the first and after the last.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Track {
    /// Moving target.
    pub target: Target,
    /// At least one keyframe, times ascending.
    pub keyframes: Vec<Keyframe>,
}

impl Track {
    /// The value at a time.
    pub fn value(&self, time: f32) -> Vec3 {
        let next = self.keyframes.partition_point(|k| k.time <= time);
        match (next.checked_sub(1).and_then(|k| self.keyframes.get(k)), self.keyframes.get(next)) {
            (Some(a), Some(b)) => a.value.lerp(b.value, (time - a.time) / (b.time - a.time)),
            (Some(k), None) | (None, Some(k)) => k.value,
            (None, None) => Vec3::ZERO,
        }
    }
}

/// Lights and view at rest, and the tracks that move them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Animation {
    /// Lights where no track says otherwise.
    pub lights: Vec<Light>,
    /// View where no track says otherwise.
    pub view: View,
    /// Animation tracks; empty for a static scene.
    pub tracks: Vec<Track>,
}

impl Animation {
    /// Lights and view at a time in seconds.
    pub fn at(&self, time: f32) -> (Vec<Light>, View) {
        let mut lights = self.lights.clone();
        let mut view = self.view;
        for track in &self.tracks {
            let value = track.value(time);
            match track.target {
                Target::CameraEye => view.eye = value,
                Target::CameraTarget => view.target = value,
                Target::LightPosition(k) | Target::LightDirection(k) | Target::LightColor(k) => {
                    let Some(light) = lights.get_mut(k) else { continue };
                    match track.target {
                        Target::LightPosition(_) => light.position = value,
                        Target::LightDirection(_) => light.direction = value.normalize_or(light.direction),
                        _ => light.color = value,
                    }
                }
            }
        }
        (lights, view)
    }

    /// Time of the last keyframe, s; 0 for a scene at rest.
    pub fn duration(&self) -> f32 {
        self.tracks.iter().filter_map(|t| t.keyframes.last()).map(|k| k.time).fold(0.0, f32::max)
    }

    /// A movement of one second for any scene: its own when it has one, or objects that move, else
    /// [`Animation::default_path`].
    pub fn or_default_path(scene: &LoadedScene) -> Self {
        if scene.animation.tracks.is_empty() && scene.moving.is_empty() {
            Self::default_path(scene)
        } else {
            scene.animation.clone()
        }
    }

    /// A movement of one second for any scene, whatever its own: each directional light is turned by ±25°
    /// round the vertical, every other light goes to and fro by a sixth of the scene's size. A scene lit only by
    /// emissive surfaces and sky gets a point light that crosses it above the camera's target.
    pub fn default_path(scene: &LoadedScene) -> Self {
        let mut animation = Self { tracks: Vec::new(), ..scene.animation.clone() };
        let (low, high) = scene.scene.geometry.bounds;
        let size = high - low;
        let along = if size.x >= size.z { Vec3::X * size.x } else { Vec3::Z * size.z };
        if animation.lights.is_empty() {
            animation.lights.push(travelling_light(scene));
        }
        for (k, light) in animation.lights.iter().enumerate() {
            let (target, values) = if light.kind == LIGHT_DIRECTIONAL {
                let rotated = |degrees: f32| rotate_about_y(light.direction, degrees);
                (Target::LightDirection(k), [rotated(-25.0), rotated(-8.0), rotated(8.0), rotated(25.0)])
            } else {
                let step = |share: f32| light.position + along * share;
                (Target::LightPosition(k), [step(-1.0 / 6.0), step(1.0 / 6.0), step(1.0 / 12.0), step(-1.0 / 6.0)])
            };
            let keyframes = (0..4).map(|i| Keyframe { time: i as f32 / 3.0, value: values[i] }).collect();
            animation.tracks.push(Track { target, keyframes });
        }
        animation
    }
}

impl Animation {
    /// The scene's own camera path where it has one; else along the longer way of the scene, a fifth of it away from
    /// both ends, at the height and on the line of its view, looking where it goes; lights rest.
    pub fn fly(scene: &LoadedScene) -> Self {
        let is_camera = |track: &&Track| matches!(track.target, Target::CameraEye | Target::CameraTarget);
        let own: Vec<Track> = scene.animation.tracks.iter().filter(is_camera).cloned().collect();
        if !own.is_empty() {
            return Self { tracks: own, ..scene.animation.clone() };
        }
        Self::along(scene, &[0.2, 0.8])
    }

    /// Moves to and fro over the middle, twice.
    pub fn shuttle(scene: &LoadedScene) -> Self {
        Self::along(scene, &[0.3, 0.7, 0.3, 0.7, 0.3])
    }

    /// The camera once round the middle of the scene, looking outwards; lights rest.
    pub fn circle(scene: &LoadedScene) -> Self {
        let (low, high) = scene.scene.geometry.bounds;
        let centre = 0.5 * (low + high);
        let half = 0.25 * (high - low);
        let at = |k: u32| {
            // A whole circle in 64 straight parts.
            let angle = f64::from(k) / f64::from(CIRCLE) * std::f64::consts::TAU;
            Vec3::new(half.x * angle.cos() as f32, 0.0, half.z * angle.sin() as f32)
        };
        let eye = |k: u32| Vec3::new(centre.x, inside(scene).y, centre.z) + at(k);
        let target = |k: u32| eye(k) + at(k);
        let keys = |of: &dyn Fn(u32) -> Vec3| -> Vec<Keyframe> {
            (0..=CIRCLE).map(|k| Keyframe { time: k as f32 / CIRCLE as f32, value: of(k) }).collect()
        };
        Self::of_camera(scene, keys(&eye), keys(&target))
    }

    /// The camera at shares of the scene's longer way, one after the other.
    fn along(scene: &LoadedScene, shares: &[f32]) -> Self {
        let (low, high) = scene.scene.geometry.bounds;
        let axis = if high.x - low.x >= high.z - low.z { Vec3::X } else { Vec3::Z };
        let length = (high - low).dot(axis);
        let from = inside(scene);
        let eye = |share: f32| from + axis * (low.dot(axis) + share * length - from.dot(axis));
        let time = |k: usize| k as f32 / (shares.len() - 1) as f32;
        let keys = |ahead: f32| -> Vec<Keyframe> {
            let key = |(k, &share): (usize, &f32)| Keyframe { time: time(k), value: eye(share) + axis * ahead };
            shares.iter().enumerate().map(key).collect()
        };
        Self::of_camera(scene, keys(0.0), keys(length))
    }

    fn of_camera(scene: &LoadedScene, eye: Vec<Keyframe>, target: Vec<Keyframe>) -> Self {
        let tracks = vec![
            Track { target: Target::CameraEye, keyframes: eye },
            Track { target: Target::CameraTarget, keyframes: target },
        ];
        Self { lights: scene.scene.lighting.lights.clone(), view: scene.view, tracks }
    }
}

/// The eye of a scene's view, or the nearest place a tenth within the scene.
fn inside(scene: &LoadedScene) -> Vec3 {
    let (low, high) = scene.scene.geometry.bounds;
    let margin = 0.1 * (high - low);
    scene.view.eye.clamp(low + margin, high - margin)
}

/// Straight parts of a circle.
const CIRCLE: u32 = 64;

/// A point light at the upper third of the scene as bright as all its emitters together, at least enough to be seen.
fn travelling_light(scene: &LoadedScene) -> Light {
    let s = &scene.scene;
    let geometry = s.tables();
    let power: Vec3 =
        s.emitters.iter().map(|e| geometry.radiance(e.triangle, 1.0 / 3.0, 1.0 / 3.0) * e.area).sum::<Vec3>() * 0.25;
    let (low, high) = s.geometry.bounds;
    let centre = 0.5 * (low + high);
    let floor = Vec3::splat(0.02 * s.diagonal() * s.diagonal());
    let color = if power.max_element() > 0.0 { power } else { floor };
    let position = Vec3::new(centre.x, low.y + 0.7 * (high.y - low.y), centre.z);
    Light { kind: LIGHT_POINT, position, color, ..Light::default() }
}

fn rotate_about_y(v: Vec3, degrees: f32) -> Vec3 {
    let angle = f64::from(degrees).to_radians();
    let s = angle.sin() as f32;
    let c = angle.cos() as f32;
    Vec3::new(c * v.x + s * v.z, v.y, c * v.z - s * v.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracks_are_linear_between_keyframes_and_constant_outside() {
        let key = |time, x| Keyframe { time, value: Vec3::new(x, 0.0, 0.0) };
        let track = Track { target: Target::CameraEye, keyframes: vec![key(1.0, 2.0), key(3.0, 6.0), key(4.0, 0.0)] };
        for (time, x) in [(0.0, 2.0), (1.0, 2.0), (2.0, 4.0), (3.0, 6.0), (3.5, 3.0), (9.0, 0.0)] {
            assert_eq!(track.value(time).x, x, "at {time}");
        }
        let animation = Animation { tracks: vec![track], ..Animation::default() };
        assert_eq!(animation.duration(), 4.0);
        assert_eq!(animation.at(2.0).1.eye.x, 4.0);
    }

    #[test]
    fn a_rotation_keeps_length_and_height() {
        let v = Vec3::new(0.3, -0.8, 0.5);
        let w = rotate_about_y(v, 90.0);
        assert!((w - Vec3::new(0.5, -0.8, -0.3)).length() < 1e-6);
    }
}
