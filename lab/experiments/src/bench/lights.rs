//! Lights that a bake has not seen.

use std::f32::consts::PI;

use glam::Vec3;
use scene::gpu::LIGHT_DIRECTIONAL;
use scene::math::sin_cos_2pi;
use scene::{Light, Scene};

use assets::import::{Animation, LoadedScene};

/// Angles of other suns about the vertical, degrees, and their heights above the horizon.
const SUNS: [(f32, f32); 3] = [(70.0, 60.0), (165.0, 45.0), (280.0, 75.0)];
/// Shares of the movement at which lamps are taken.
const TIMES: [f32; 2] = [0.0, 0.4];
/// Irradiance of a sun over that of the sky, in a scene that has none.
const SUN_OVER_SKY: f32 = 3.0;

/// Other lights with their names: three other suns for a scene that has a sun or a sky, else its lamps moved. A scene
/// that is lit by emissive surfaces only gets a lamp that crosses it.
pub fn other_lights(loaded: &LoadedScene) -> Vec<(String, Vec<Light>)> {
    let own = &loaded.scene.lighting.lights;
    if own.iter().any(|light| light.kind == LIGHT_DIRECTIONAL) || (loaded.scene.has_sky() && own.is_empty()) {
        return SUNS.iter().map(|&(angle, height)| other_sun(loaded, angle, height)).collect();
    }
    let animation = Animation::or_default_path(loaded);
    let moved = |share: &f32| animation.at(share * animation.duration()).0;
    TIMES
        .iter()
        .zip(["moved lamp", "moved lamp, the other way"])
        .map(|(share, name)| (name.into(), moved(share)))
        .collect()
}

fn other_sun(loaded: &LoadedScene, angle: f32, height: f32) -> (String, Vec<Light>) {
    let (up, along) = sin_cos_2pi(height / 360.0);
    let mut lights = loaded.scene.lighting.lights.clone();
    if lights.is_empty() {
        let color = sky_irradiance(&loaded.scene) * SUN_OVER_SKY;
        lights.push(Light { kind: LIGHT_DIRECTIONAL, direction: Vec3::NEG_Y, color, ..Light::default() });
    }
    for light in lights.iter_mut().filter(|light| light.kind == LIGHT_DIRECTIONAL) {
        let own = scene::math::atan2(light.direction.z, light.direction.x) / (2.0 * PI);
        let (z, x) = sin_cos_2pi(own + angle / 360.0);
        light.direction = Vec3::new(along * x, -up, along * z);
    }
    (format!("sun turned by {angle}°, {height}° high"), lights)
}

/// Irradiance of a surface that sees all of the sky, and as if it were the same everywhere, W/m².
fn sky_irradiance(scene: &Scene) -> Vec3 {
    let texels = scene.lighting.sky_map.len().max(1) as f32;
    let mean = if scene.lighting.sky_map.is_empty() {
        Vec3::ONE
    } else {
        scene.lighting.sky_map.iter().map(|texel| texel.truncate()).sum::<Vec3>() / texels
    };
    scene.lighting.sky.radiance * mean * PI
}

#[cfg(test)]
mod tests {
    use super::*;
    use assets::procedural;

    #[test]
    fn other_lights_differ_from_the_own_ones_and_from_each_other() {
        for (name, count) in [("atrium", 3), ("cornell", 2), ("furnace", 2)] {
            let loaded = procedural::build(name).unwrap();
            let found = other_lights(&loaded);
            assert_eq!(found.len(), count, "{name}");
            for (k, (what, lights)) in found.iter().enumerate() {
                assert_ne!(*lights, loaded.scene.lighting.lights, "{name}: {what}");
                assert_eq!(lights.len(), loaded.scene.lighting.lights.len().max(1));
                assert!(found[..k].iter().all(|other| other.1 != *lights), "{name}: {what}");
            }
        }
    }

    #[test]
    fn suns_stand_as_high_as_is_said() {
        let loaded = procedural::build("atrium").unwrap();
        for ((_, lights), (_, height)) in other_lights(&loaded).iter().zip(SUNS) {
            let sun = lights.iter().find(|light| light.kind == LIGHT_DIRECTIONAL).unwrap();
            let found = f64::from(-sun.direction.y).asin().to_degrees();
            assert!((found - f64::from(height)).abs() < 1e-3 && sun.direction.is_normalized(), "{found} {height}");
        }
    }
}
