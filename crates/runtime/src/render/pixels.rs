//! Receivers at the visible points of one view: what there is to see, with nothing in between, for measuring.

use formfactor::{Proceed, gather_by_rays};
use glam::{Vec3, Vec4};
use rayon::prelude::*;
use scene::kernel::camera::{primary_direction, primary_hit, surface_point};
use scene::kernel::shade::pixel_radiance;
use scene::{Camera, Hit, Light, Scene, SurfacePoint};

use super::frame::sub_frame_seed;
use super::senders::{Columns, Senders};
use crate::error::Error;

/// What the pixels of a frame show of the facets' light.
pub struct PixelGather<'a> {
    pub scene: &'a Scene,
    pub senders: &'a Senders,
    /// Exitance of the facets.
    pub exitance: &'a [Vec4],
    pub lights: &'a [Light],
    pub camera: &'a Camera,
    pub pixels: usize,
    /// Number of the frame, and its sub-frames.
    pub frame: u32,
    pub sub_frames: u32,
    /// Rays from each visible point.
    pub rays: u32,
    pub seed: u32,
}

impl PixelGather<'_> {
    /// Indirect radiance of the pixels, W/m²/sr: each visible point gathers by rays of its own, in every sub-frame.
    pub fn indirect(&self, progress: &(dyn Fn(usize, usize) -> Proceed + Sync)) -> Result<Vec<Vec3>, Error> {
        let mut sums = vec![Vec3::ZERO; self.pixels];
        for k in 0..self.sub_frames {
            let seed = sub_frame_seed(self.frame, self.sub_frames, k, self.seed);
            self.add(seed, &mut sums, &|done, total| {
                progress(k as usize * total + done, self.sub_frames as usize * total)
            })?;
        }
        sums.par_iter_mut().for_each(|sum| *sum /= self.sub_frames as f32);
        Ok(sums)
    }

    fn add(
        &self,
        seed: u32,
        sums: &mut [Vec3],
        progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
    ) -> Result<(), Error> {
        let geometry = self.scene.geometry();
        let visible: Vec<(usize, Hit, SurfacePoint)> = (0..self.pixels)
            .into_par_iter()
            .filter_map(|pixel| {
                let hit = primary_hit(&geometry, self.camera, pixel as u32, seed);
                let direction = primary_direction(self.camera, pixel as u32, seed);
                (!hit.is_miss()).then(|| (pixel, hit, surface_point(&geometry, hit, direction)))
            })
            .collect();
        let points: Vec<SurfacePoint> =
            visible.iter().map(|(_, _, point)| SurfacePoint { weight: 1.0, ..*point }).collect();
        let offsets: Vec<u32> = (0..=points.len() as u32).collect();
        let surfaces = self.senders.lighting(self.scene, Columns::Facets, &points, &offsets, seed);
        let light = gather_by_rays(&surfaces, self.rays, self.exitance, progress)?;
        let lights = scene::Lights { lights: self.lights, ..self.scene.all_lights() };
        let count = self.lights.len() as u32;
        for ((pixel, hit, _), irradiance) in visible.into_iter().zip(light) {
            let direction = primary_direction(self.camera, pixel as u32, seed);
            let shown = |light: Vec3| pixel_radiance(&geometry, &lights, count, self.camera, direction, hit, light);
            sums[pixel] += shown(irradiance.truncate()) - shown(Vec3::ZERO);
        }
        Ok(())
    }
}
