//! Direct light of pixels without noise: of the sky from the interpolation points, of rectangles and emissive triangles
//! exactly where nothing is in the way, times the share that shadow rays of a fixed pattern see, averaged over like
//! pixels. Parallel, point and spot lights have a shadow ray in each sub-frame.

use gpu_kernels::scene::{AddLargeLightPass, MarkSteadyPass};
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{PassId, Plan, Slice};
use runtime::recipe::scene::{LargeLight, PassMedium, SceneTables};
use scene::gpu::{DirectParams, LargeParams, ShareParams};
use scene::{Camera, Rgb};

use super::bands::Band;
use super::finish::{FinishLight, FinishPasses};
use super::shade::{Indirect, PixelBuffers, PixelSettings, Shot};

/// Most by which shares of light differ that are averaged where it is not steady, times the number of samples of a pixel
/// and times its root: a step or two of their counting, and a part of what chance makes of equal shares. With few samples
/// all are averaged.
const STEPS: f32 = 2.5;
const TOLERANCE: f32 = 0.6;
/// Most by which the share of light bends over a tile where it counts as steady. Averages over 5 × 5 pixels blur an edge
/// of that height by half of it in two pixels, and are wrong by a twentieth of it where light bends smoothly.
const BEND: f32 = 0.15;

/// Buffers of all sub-frames.
#[derive(Clone, Copy, Debug)]
pub struct SmoothLight {
    /// Irradiance of the interpolation points from the sky, W/m².
    sky: Slice<Rgb>,
    /// Light of the sky at the pixels.
    from_sky: Slice<Rgb>,
    /// Radiance from rectangles and emitters, were nothing in the way; of the samples that are seen; of all samples.
    open: Slice<Rgb>,
    seen: Slice<Rgb>,
    sampled: Slice<Rgb>,
    /// Picture size, pixels, and number of sub-frames.
    size: (u32, u32),
    sub_frames: u32,
    /// Settings of direct light.
    direct: DirectParams,
    medium: PassMedium,
}

/// The passes of a sub-frame.
#[derive(Clone, Copy, Debug)]
pub struct SmoothPasses {
    /// Parallel, point and spot lights.
    pub sharp: PassId,
    large: [PassId; 2],
    /// Those of the lobes of surfaces.
    finish: Option<FinishPasses>,
}

impl SmoothLight {
    /// The buffers of so many sub-frames of a picture, with the irradiance of the interpolation points from the sky.
    pub fn new(
        plan: &mut Plan,
        sky: Slice<Rgb>,
        sub_frames: u32,
        settings: &PixelSettings,
        medium: PassMedium,
    ) -> Self {
        let size = settings.size;
        let count = size.0 as usize * size.1 as usize;
        Self {
            sky,
            from_sky: plan.array("pixel sky", count),
            open: plan.array("open light", count),
            seen: plan.array("seen samples", count),
            sampled: plan.array("all samples", count),
            size,
            sub_frames,
            direct: settings.direct,
            medium,
        }
    }

    /// Adds the passes of a band of a sub-frame, behind its primary rays.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add(
        &self,
        plan: &mut Plan,
        scene: &SceneTables,
        (buffers, indirect): (&PixelBuffers, &Indirect),
        finish: Option<&FinishLight>,
        band: Band,
    ) -> Result<SmoothPasses, ExecutorError> {
        let points = band.of(buffers.points);
        indirect.with_values(self.sky).add_to(plan, scene, buffers, self.from_sky, band)?;
        let add_finish =
            |light: &FinishLight| light.add_direct(plan, scene, (buffers, indirect), (self.from_sky, self.open), band);
        let finish = finish.map(add_finish).transpose()?;
        let direct = DirectParams { count: band.count, first: band.first, ..self.direct };
        let from_sky = band.of(self.from_sky);
        let sharp = scene.sharp_light(plan, "shade", points, from_sky, band.of(buffers.direct), &direct)?;
        let pixels = LargeLight {
            hits: band.of(buffers.hits),
            albedo: band.of(buffers.albedo),
            matte: band.of(buffers.matte),
            points,
            open: band.of(self.open),
            seen: band.of(self.seen),
            sampled: band.of(self.sampled),
        };
        let params = LargeParams { count: band.count, first: band.first, ..LargeParams::default() };
        let large = scene.large_light(plan, "shade", &pixels, &params)?;
        Ok(SmoothPasses { sharp, large, finish })
    }

    /// Adds the pass behind all sub-frames that marks where in a band light is steady.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add_marks(&self, plan: &mut Plan, buffers: &PixelBuffers, band: Band) -> Result<PassId, ExecutorError> {
        let about = band.with_pixels_about(self.size);
        let pass = MarkSteadyPass {
            points: about.of(buffers.points),
            seen: about.of(self.seen),
            sampled: about.of(self.sampled),
            open: band.of(self.open),
        };
        Ok(plan.add("shade", &pass, &self.shares(band, about))?)
    }

    /// Adds the pass behind the marks of all bands, which adds what the sub-frames found to the sums of the pixels of a
    /// band.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add_sum(
        &self,
        plan: &mut Plan,
        buffers: &PixelBuffers,
        band: Band,
        (full, direct): (Slice<Rgb>, Slice<Rgb>),
    ) -> Result<PassId, ExecutorError> {
        let about = band.with_pixels_about(self.size);
        let pass = AddLargeLightPass {
            points: about.of(buffers.points),
            open: about.of(self.open),
            seen: about.of(self.seen),
            sampled: about.of(self.sampled),
            full: band.of(full),
            direct: band.of(direct),
        };
        Ok(plan.add("shade", &pass, &self.shares(band, about))?)
    }

    fn shares(&self, band: Band, about: Band) -> ShareParams {
        let samples = (self.direct.area_rays * self.sub_frames) as f32;
        let tolerance = (STEPS / samples).max(TOLERANCE / samples.sqrt());
        ShareParams {
            count: band.count,
            first: band.first,
            width: self.size.0,
            height: self.size.1,
            first_about: about.first,
            count_about: about.count,
            tolerance,
            bend: BEND,
        }
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
        [self.open, self.seen, self.sampled].into_iter().try_for_each(|sum| executor.clear(sum.buffer))
    }

    /// Makes the passes of a band of a sub-frame ready for a picture by the camera of [`Self::camera`].
    ///
    /// # Errors
    /// What the device says.
    pub fn set(
        &self,
        executor: &mut (dyn Executor + 'static),
        passes: &SmoothPasses,
        light: &DirectParams,
        camera: &Camera,
        shot: &Shot,
        sub_frame: u32,
    ) -> Result<(), ExecutorError> {
        let DirectParams { area_rays: rays, ray_offset, .. } = self.direct;
        let push = LargeParams {
            camera: *camera,
            count: light.count,
            sub_frame,
            light_count: shot.light_count,
            emitter_count: shot.emitter_count,
            rays,
            first_sample: rays * sub_frame,
            stride: (rays * self.sub_frames).next_power_of_two(),
            ray_offset,
            group_count: shot.group_count,
            first: light.first,
            reserved: [0; 2],
        };
        if let Some(finish) = &passes.finish {
            finish.set(executor, self.medium, light, &push)?;
        }
        self.medium.push_large(executor, passes.large, &push)
    }
}
