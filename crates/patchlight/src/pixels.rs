//! Indirect light at the visible points of one view, with nothing in between, for measuring.

use glam::{Vec3, Vec4};
use rayon::prelude::*;
use scene::kernel::camera::{primary_direction, primary_hit};
use scene::kernel::normal::shading_point;
use scene::kernel::shade::{pixel_albedo, pixel_radiance};
use scene::{Camera, Hit, Light, Scene, SurfacePoint};

use crate::error::Error;
use crate::low_level::stage::shade::sub_frame_seed;
use crate::picture::Picture;

/// Irradiance at some points, W/m², with the seed of their sub-frame.
pub type Gather<'a> = dyn Fn(&[SurfacePoint], u32) -> Result<Vec<Vec4>, Error> + Sync + 'a;

/// Indirect light at the pixels of a frame.
pub struct PixelGather<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Indirect irradiance at the visible points.
    pub gather: &'a Gather<'a>,
    /// Its lights.
    pub lights: &'a [Light],
    /// Who looks.
    pub camera: &'a Camera,
    /// Number of the frame, and its sub-frames.
    pub frame: u32,
    /// Positions in each pixel.
    pub sub_frames: u32,
    /// Changes every random number.
    pub seed: u32,
}

impl PixelGather<'_> {
    /// Indirect radiance of the pixels, W/m²/sr: each visible point asks for light of its own, in every sub-frame.
    pub fn indirect(&self) -> Result<Picture, Error> {
        let width = self.camera.width;
        let height = self.camera.height;
        let mut sums = vec![Vec3::ZERO; width as usize * height as usize];
        for k in 0..self.sub_frames {
            self.add(k, &mut sums)?;
        }
        sums.par_iter_mut().for_each(|sum| *sum /= self.sub_frames as f32);
        Ok(Picture::from_pixels(width, height, sums)?)
    }

    fn add(&self, sub_frame: u32, sums: &mut [Vec3]) -> Result<(), Error> {
        let seed = sub_frame_seed(self.frame, self.sub_frames, sub_frame, self.seed);
        let geometry = self.scene.tables();
        let visible: Vec<(usize, Hit, SurfacePoint)> = (0..sums.len())
            .into_par_iter()
            .filter_map(|pixel| {
                let hit = primary_hit(&geometry, self.camera, pixel as u32, seed);
                let direction = primary_direction(self.camera, pixel as u32, seed);
                (!hit.is_miss()).then(|| (pixel, hit, shading_point(&geometry, hit, direction)))
            })
            .collect();
        let points: Vec<SurfacePoint> =
            visible.iter().map(|(_, _, point)| SurfacePoint { weight: 1.0, ..*point }).collect();
        let light = (self.gather)(&points, seed)?;
        let lights = scene::Lights { lights: self.lights, ..self.scene.all_lights() };
        let count = self.lights.len() as u32;
        for ((pixel, hit, _), irradiance) in visible.into_iter().zip(light) {
            let direction = primary_direction(self.camera, pixel as u32, seed);
            let albedo = pixel_albedo(&geometry, self.camera, direction, hit).truncate();
            let shown =
                |light: Vec3| pixel_radiance(&geometry, &lights, count, self.camera, direction, hit, albedo, light);
            sums[pixel] += shown(irradiance.truncate()) - shown(Vec3::ZERO);
        }
        Ok(())
    }
}
