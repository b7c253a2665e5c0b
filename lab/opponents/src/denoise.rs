//! A simple denoiser for pictures of a few paths a pixel, an opponent with the path tracer: an à-trous wavelet filter
//! that stops at edges (Dammertz, Sewtz, Hanika, Lensch 2010, "Edge-Avoiding À-Trous Wavelet Transform for fast Global
//! Illumination Filtering").
//!
//! Each level takes 5 × 5 pixels, twice as far apart as the level before, by the weights of a cubic B-spline times
//! exp(−|Δcolour|²/σ_c² − |Δnormal|²/σ_n² − |Δposition|²/σ_p²). σ_c halves from level to level.

use std::f32::consts::E;

use glam::{IVec2, Vec3, ivec2};
use rayon::prelude::*;
use scene::kernel::bvh::FAR;
use scene::kernel::camera::{camera_direction, surface_point};
use scene::math::pow;
use scene::{Camera, Scene};

use reference::Error;
use reference::Picture;

/// A cubic B-spline at −2 to 2.
const SPLINE: [f32; 5] = [1.0 / 16.0, 1.0 / 4.0, 3.0 / 8.0, 1.0 / 4.0, 1.0 / 16.0];
/// Levels at most.
const MAX_LEVELS: u32 = 16;

/// Settings of [`denoise`], besides the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DenoiseSettings {
    /// Levels; the last reaches 2^(levels + 1) pixels to each side.
    pub levels: u32,
    /// σ_c of the first level, in means of the picture.
    pub colour: f32,
    /// σ_n.
    pub normal: f32,
    /// σ_p, in diagonals of the scene.
    pub position: f32,
}

impl Default for DenoiseSettings {
    /// Five levels, for pictures of one path a pixel: the least errors in the Cornell box and the atrium.
    fn default() -> Self {
        Self { levels: 5, colour: 64.0, normal: 0.3, position: 0.05 }
    }
}

/// Noise-free guides of the denoiser, one for each pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Guides {
    /// Unit normals, `[pixels]`; zero where nothing is seen.
    pub normals: Vec<Vec3>,
    /// Positions in diagonals of the scene, `[pixels]`.
    pub positions: Vec<Vec3>,
}

impl Guides {
    /// Guides at the middle of each pixel. On all cores.
    pub fn new(scene: &Scene, camera: &Camera) -> Self {
        let tables = scene.tables();
        let scale = 1.0 / scene.diagonal().max(f32::MIN_POSITIVE);
        let seen = |pixel: u32| {
            let x = (pixel % camera.width) as f32 + 0.5;
            let y = (pixel / camera.width) as f32 + 0.5;
            let direction = camera_direction(camera, x, y).normalize();
            let hit = scene.closest_before(camera.eye, direction, FAR);
            if hit.is_miss() {
                return (Vec3::ZERO, Vec3::ZERO);
            }
            let point = surface_point(&tables, hit, direction);
            (point.normal, point.position * scale)
        };
        let (normals, positions) = (0..camera.width * camera.height).into_par_iter().map(seen).unzip();
        Self { normals, positions }
    }
}

/// The picture with less noise. Pixels that see nothing stay as they are. On all cores.
///
/// # Errors
/// [`Error::Count`] for guides of another picture, [`Error::Setting`] for a setting out of range.
pub fn denoise(light: &Picture, guides: &Guides, settings: &DenoiseSettings) -> Result<Picture, Error> {
    check(light, guides, settings)?;
    let mean = light.mean().element_sum() / 3.0;
    let mut pixels = light.pixels.clone();
    for level in 0..settings.levels {
        let filter = Level {
            size: ivec2(light.width as i32, light.height as i32),
            apart: 1 << level,
            colour: inverse_square(settings.colour * mean / (1 << level) as f32),
            normal: inverse_square(settings.normal),
            position: inverse_square(settings.position),
            guides,
            pixels: &pixels,
        };
        pixels = (0..pixels.len()).into_par_iter().map(|k| filter.pixel(k)).collect();
    }
    Ok(Picture::from_pixels(light.width, light.height, pixels)?)
}

fn check(light: &Picture, guides: &Guides, settings: &DenoiseSettings) -> Result<(), Error> {
    for found in [guides.normals.len(), guides.positions.len()] {
        if found != light.pixels.len() {
            return Err(Error::Count { of: "pixels", expected: light.pixels.len(), found });
        }
    }
    if settings.levels > MAX_LEVELS {
        return Err(Error::Setting { name: "levels", value: f64::from(settings.levels), rule: "at most 16" });
    }
    let widths = [("colour", settings.colour), ("normal", settings.normal), ("position", settings.position)];
    for (name, value) in widths {
        if value.is_nan() || value < 0.0 {
            return Err(Error::Setting { name, value: f64::from(value), rule: "not negative" });
        }
    }
    Ok(())
}

fn inverse_square(width: f32) -> f32 {
    1.0 / (width * width).max(f32::MIN_POSITIVE)
}

/// One level of the filter.
struct Level<'a> {
    size: IVec2,
    /// Pixels from one tap to the next.
    apart: i32,
    /// 1/σ².
    colour: f32,
    normal: f32,
    position: f32,
    guides: &'a Guides,
    pixels: &'a [Vec3],
}

impl Level<'_> {
    fn pixel(&self, k: usize) -> Vec3 {
        let normal = self.guides.normals[k];
        if normal == Vec3::ZERO {
            return self.pixels[k];
        }
        let position = self.guides.positions[k];
        let colour = self.pixels[k];
        let at = ivec2(k as i32 % self.size.x, k as i32 / self.size.x);
        let mut sum = Vec3::ZERO;
        let mut total = 0.0;
        for tap in 0..25 {
            let step = ivec2(tap % 5, tap / 5) - 2;
            let place = at + step * self.apart;
            if place.cmplt(IVec2::ZERO).any() || place.cmpge(self.size).any() {
                continue;
            }
            let other = (place.y * self.size.x + place.x) as usize;
            if self.guides.normals[other] == Vec3::ZERO {
                continue;
            }
            let apart = self.normal * (self.guides.normals[other] - normal).length_squared()
                + self.position * (self.guides.positions[other] - position).length_squared()
                + self.colour * (self.pixels[other] - colour).length_squared();
            let spline = SPLINE[(step.x + 2) as usize] * SPLINE[(step.y + 2) as usize];
            let weight = spline * pow(E, -apart);
            sum += self.pixels[other] * weight;
            total += weight;
        }
        sum / total
    }
}
