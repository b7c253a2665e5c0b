//! Skies of environment maps, and mean colours of pictures.

use std::sync::Arc;

use bevy::asset::{AssetId, Assets};
use bevy::image::Image;
use bevy::light::EnvironmentMapLight;
use bevy::log::warn;
use bevy::prelude::ColorToComponents;
use patchlight::glam::{Quat, Vec3, Vec4};

use crate::lights::rotation;

/// Texels of the map that is made of an environment: light needs no more of it.
pub(crate) const MAP_SIZE: (u32, u32) = (64, 32);
/// Texels of a picture whose mean is taken, each way.
const MEAN_TEXELS: u32 = 64;

/// The map of the environment that was met last.
#[derive(Default)]
pub(crate) struct SkyMap {
    key: Option<(AssetId<Image>, Quat)>,
    texels: Option<Arc<[Vec4]>>,
}

impl SkyMap {
    /// Radiance round about, over the intensity of the environment; none where its picture cannot be read.
    pub fn of(&mut self, environment: &EnvironmentMapLight, images: &Assets<Image>) -> Option<Arc<[Vec4]>> {
        let key = (environment.specular_map.id(), rotation(environment.rotation));
        // A picture that is still being loaded is asked for again.
        let image = images.get(&environment.specular_map);
        if self.key != Some(key) && image.is_some() {
            self.texels = image.and_then(|image| map(image, key.1));
            self.key = Some(key);
            if self.texels.is_none() {
                warn!(
                    "the environment map sends no light to Patchlight: its picture has six square faces of floats, and stays \
                     in the main world (RenderAssetUsages::default())"
                );
            }
        }
        self.texels.clone().filter(|_| self.key == Some(key))
    }
}

/// An equirectangular map of a cube map that is turned.
fn map(image: &Image, turn: Quat) -> Option<Arc<[Vec4]>> {
    let edge = image.width();
    if image.height() != edge || image.texture_descriptor.size.depth_or_array_layers != 6 {
        return None;
    }
    image.get_color_at_3d(0, 0, 0).ok()?;
    let (width, height) = MAP_SIZE;
    let texels = (0..width * height).map(|k| {
        // The middle column is -z, the top row +y.
        let (azimuth, polar) = (
            ((k % width) as f32 + 0.5) / width as f32 * std::f32::consts::TAU - std::f32::consts::PI,
            ((k / width) as f32 + 0.5) / height as f32 * std::f32::consts::PI,
        );
        let direction = Vec3::new(polar.sin() * azimuth.sin(), polar.cos(), -polar.sin() * azimuth.cos());
        let (face, u, v) = cube_place(turn.inverse() * direction);
        let at = |share: f32| ((share * edge as f32) as u32).min(edge - 1);
        let color = image.get_color_at_3d(at(u), at(v), face).unwrap_or_default();
        Vec3::from(color.to_linear().to_f32_array_no_alpha()).extend(0.0)
    });
    Some(texels.collect())
}

/// Face of a cube map and the place on it that Bevy shows in a direction: cube maps are left-handed.
fn cube_place(direction: Vec3) -> (u32, f32, f32) {
    let Vec3 { x, y, z } = direction * Vec3::new(1.0, 1.0, -1.0);
    let size = direction.abs();
    let (face, s, t, along) = if size.x >= size.y && size.x >= size.z {
        if x > 0.0 { (0, -z, -y, x) } else { (1, z, -y, -x) }
    } else if size.y >= size.z {
        if y > 0.0 { (2, x, z, y) } else { (3, x, -z, -y) }
    } else if z > 0.0 {
        (4, x, -y, z)
    } else {
        (5, -x, -y, -z)
    };
    (face, 0.5 + 0.5 * s / along, 0.5 + 0.5 * t / along)
}

/// Mean colour of a picture, linear; none where it cannot be read.
pub(crate) fn mean_color(image: &Image) -> Option<Vec3> {
    let steps = |size: u32| (0..size.min(MEAN_TEXELS)).map(move |k| k * size / size.min(MEAN_TEXELS));
    let mut sum = Vec3::ZERO;
    let mut count = 0.0;
    for y in steps(image.height()) {
        for x in steps(image.width()) {
            sum += Vec3::from(image.get_color_at(x, y).ok()?.to_linear().to_f32_array_no_alpha());
            count += 1.0;
        }
    }
    (count > 0.0).then(|| sum / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_find_their_faces() {
        let middle = |direction: Vec3| cube_place(direction);
        assert_eq!(middle(Vec3::X), (0, 0.5, 0.5));
        assert_eq!(middle(Vec3::NEG_X), (1, 0.5, 0.5));
        assert_eq!(middle(Vec3::Y), (2, 0.5, 0.5));
        assert_eq!(middle(Vec3::NEG_Y), (3, 0.5, 0.5));
        // What lies ahead is the face +z of a left-handed map.
        assert_eq!(middle(Vec3::NEG_Z), (4, 0.5, 0.5));
        assert_eq!(middle(Vec3::Z), (5, 0.5, 0.5));
        // A little to the right of ahead is right on that face; a little up is above its middle.
        let (face, u, v) = middle(Vec3::new(0.2, 0.1, -1.0));
        assert!(face == 4 && (u - 0.6).abs() < 1e-6 && (v - 0.45).abs() < 1e-6, "{face} {u} {v}");
    }
}
