//! Direct light of pixels without noise: of the sky from the interpolation points, of rectangles and emissive triangles exactly
//! where nothing is in the way, times the share that shadow rays of a fixed pattern see, averaged over like pixels. Parallel,
//! point and spot lights have a shadow ray in each sub-frame.

use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{BufferId, PassId, Plan, Range};
use runtime::recipe::rgb_bytes;
use runtime::recipe::scene::{SceneTables, add_large_light};
use scene::{Camera, DirectParams, LargeParams, ShareParams};

use super::shade::{Indirect, PixelBuffers, Shot};

/// Most by which shares of light differ that are averaged, times the number of samples of a pixel: with few samples all, with
/// many only those that differ by a step or two of their counting.
const TOLERANCE: f32 = 2.5;

/// Buffers of all sub-frames.
#[derive(Clone, Copy, Debug)]
pub struct SmoothLight {
    /// Irradiance of the interpolation points from the sky, W/m².
    sky: Range,
    /// The same at the pixels.
    from_sky: BufferId,
    /// Radiance from rectangles and emitters, were nothing in the way; of the samples that are seen; of all samples.
    open: BufferId,
    seen: BufferId,
    sampled: BufferId,
    /// Number of pixels, and of sub-frames.
    pixels: u32,
    sub_frames: u32,
    /// How direct light is measured.
    direct: DirectParams,
}

/// The passes of a sub-frame.
#[derive(Clone, Copy, Debug)]
pub struct SmoothPasses {
    /// Parallel, point and spot lights.
    pub sharp: PassId,
    large: [PassId; 2],
}

impl SmoothLight {
    /// The buffers of so many sub-frames of `direct.count` pixels, with the irradiance of the interpolation points from the sky.
    pub fn new(plan: &mut Plan, sky: Range, sub_frames: u32, direct: &DirectParams) -> Self {
        let bytes = rgb_bytes(direct.count as usize);
        Self {
            sky,
            from_sky: plan.storage("pixel sky", bytes),
            open: plan.storage("open light", bytes),
            seen: plan.storage("seen samples", bytes),
            sampled: plan.storage("all samples", bytes),
            pixels: direct.count,
            sub_frames,
            direct: *direct,
        }
    }

    /// Adds the passes of a sub-frame, behind its primary rays.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add(
        &self,
        plan: &mut Plan,
        scene: &SceneTables,
        buffers: &PixelBuffers,
        indirect: &Indirect,
    ) -> Result<SmoothPasses, ExecutorError> {
        let points = ("points", Range::from(buffers.points));
        indirect.with_values(self.sky).add_to(plan, scene, buffers, self.from_sky, self.pixels)?;
        let own = [points, ("from_sky", self.from_sky.into()), ("irradiance", buffers.direct.into())];
        let sharp = scene.sharp_light(plan, "shade", &own, &self.direct)?;
        let own = [
            ("hits", buffers.hits.into()),
            points,
            ("open", self.open.into()),
            ("seen", self.seen.into()),
            ("sampled", self.sampled.into()),
        ];
        let params = LargeParams { count: self.pixels, ..LargeParams::default() };
        let large = scene.large_light(plan, "shade", &own, &params)?;
        Ok(SmoothPasses { sharp, large })
    }

    /// Adds the pass behind all sub-frames, which adds what they found to the sums of the pixels.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add_sum(
        &self,
        plan: &mut Plan,
        buffers: &PixelBuffers,
        width: u32,
        (full, direct): (BufferId, BufferId),
    ) -> Result<PassId, ExecutorError> {
        let own = [
            ("points", Range::from(buffers.points)),
            ("open", self.open.into()),
            ("seen", self.seen.into()),
            ("sampled", self.sampled.into()),
            ("full", full.into()),
            ("direct", direct.into()),
        ];
        let samples = (self.direct.area_rays * self.sub_frames) as f32;
        let tolerance = TOLERANCE / samples;
        let params = ShareParams { count: self.pixels, width, tolerance, reserved: 0 };
        add_large_light(plan, "shade", &own, &params)
    }

    /// The camera with the positions of these sub-frames.
    pub fn camera(&self, camera: &Camera) -> Camera {
        Camera { fixed_sub_frames: self.sub_frames, ..*camera }
    }

    /// Fills what the first sub-frame finds.
    ///
    /// # Errors
    /// What the device says.
    pub fn clear(&self, executor: &mut dyn Executor) -> Result<(), ExecutorError> {
        [self.open, self.seen, self.sampled].into_iter().try_for_each(|buffer| executor.clear(buffer))
    }

    /// Makes the passes of a sub-frame ready for a picture by the camera of [`Self::camera`].
    ///
    /// # Errors
    /// What the device says.
    pub fn set(
        &self,
        executor: &mut (dyn Executor + 'static),
        passes: &SmoothPasses,
        camera: &Camera,
        shot: &Shot,
        sub_frame: u32,
    ) -> Result<(), ExecutorError> {
        let DirectParams { area_rays: rays, ray_offset, .. } = self.direct;
        let push = LargeParams {
            camera: *camera,
            count: self.pixels,
            sub_frame,
            light_count: shot.light_count,
            emitter_count: shot.emitter_count,
            rays,
            first_sample: rays * sub_frame,
            stride: (rays * self.sub_frames).next_power_of_two(),
            ray_offset,
            group_count: shot.group_count,
            reserved: [0; 3],
        };
        passes.large.into_iter().try_for_each(|pass| executor.push(pass, &push))
    }
}
