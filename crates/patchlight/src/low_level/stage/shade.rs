//! Pixels: sub-frames of primary rays, direct light, indirect light from the interpolation points or from the patches
//! about, and shading.

use std::sync::Arc;

use gpu_kernels::params::{CountParams, FollowParams, PixelParams};
use gpu_kernels::scene::{AlbedoPass, ChainShadePass, ChainSurfacePass, FollowPass, PrimaryPass, ShadePass};
use gpu_kernels::transport::InterpolatePass;
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{PassId, Plan, Slice};
use runtime::recipe::patches::LookupTables;
use runtime::recipe::scene::{PassMedium, SceneTables};
use scene::gpu::{DirectParams, SpecularChain};
use scene::sampling::hash3;
use scene::{Camera, Hit, Rgb, SurfacePoint};
use transport::{ReceiverCell, TriangleGrid};

use super::bands::{Band, bands};
use super::finish::{FinishLight, FinishTables};
use super::sky::SkyLight;
use super::smooth::{SmoothLight, SmoothPasses};
use crate::bake::ReceiverKind;
use crate::low_level::frame::FramePlan;

/// Method for direct light of large sources at pixels: sky, rectangles, emissive triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelLight {
    /// Without noise: the same in every frame. The sky as the receivers' rays see it; rectangles and emissive triangles
    /// exactly, times the share that shadow rays of a fixed pattern see, averaged over like pixels. Where there are
    /// receivers on the mesh; else as [`Self::Sampled`].
    #[default]
    Smooth,
    /// By random rays in each sub-frame, other ones in every frame.
    Sampled,
}

/// Shadow rays to area lights, and rays to the sky, in each sub-frame of a pixel.
const PIXEL_RAYS: u32 = 2;

/// Settings of pictures.
#[derive(Clone, Copy, Debug)]
pub struct PixelSettings {
    /// Picture size, pixels.
    pub size: (u32, u32),
    /// Sub-frames a picture.
    pub sub_frames: u32,
    /// Bytes of a buffer that one binding may show: larger pictures run in bands.
    pub binding_bytes: u64,
    /// Settings of direct light at the pixels: shadow rays to area lights, rays to the sky where it is sampled, and the
    /// distance of points from their surface.
    pub direct: DirectParams,
    /// Keeps a separate sum of direct light.
    pub has_separate_direct: bool,
    /// Follows primary rays at mirrors and through glass, and attenuates light in a medium: in each sub-frame chance
    /// picks what a surface shows.
    pub follows: bool,
    /// Irradiance of the interpolation points from the sky, for direct light without noise, which needs a sum of its
    /// own; without it light is sampled.
    pub smooth_sky: Option<Slice<Rgb>>,
    /// Finish of surfaces, which takes light without noise.
    pub finish: Option<FinishTables>,
}

/// The passes of pictures.
#[derive(Clone, Debug)]
pub struct Shade {
    /// Sums over the sub-frames of all radiance, W/m²/sr.
    pub full: Slice<Rgb>,
    /// Sum of direct radiance, where that is separate.
    pub direct: Slice<Rgb>,
    /// Buffers of one sub-frame, overwritten by the next.
    pub pixels: PixelBuffers,
    no_light: Slice<Rgb>,
    settings: PixelSettings,
    medium: PassMedium,
    bands: Vec<Band>,
    smooth: Option<SmoothLight>,
    finish: Option<FinishLight>,
    sub_frames: Vec<SubFrame>,
    /// The passes that follow.
    last: Vec<PassId>,
    passes: Vec<PassId>,
}

/// The passes of a sub-frame: the primary rays of all bands, the albedo of what they meet, then the rest of each. Where
/// rays go on at mirrors, the points that they show and the albedo there follow as primary passes.
#[derive(Clone, Debug)]
struct SubFrame {
    primary: Vec<PassId>,
    albedo: Vec<PassId>,
    finish: Vec<[PassId; 2]>,
    bands: Vec<BandPasses>,
    passes: Vec<PassId>,
}

/// Passes of a band whose push constants change.
#[derive(Clone, Copy, Debug)]
struct BandPasses {
    light: PassId,
    smooth: Option<SmoothPasses>,
    shade_full: PassId,
    shade_direct: Option<PassId>,
}

/// Buffers of a sub-frame, shared by all.
#[derive(Clone, Copy, Debug)]
pub struct PixelBuffers {
    /// Hits of the primary rays.
    pub hits: Slice<Hit>,
    /// Hits as points to be lit.
    pub points: Slice<SurfacePoint>,
    /// Albedo there.
    pub albedo: Slice<Rgb>,
    /// The part of it that reflects diffusely: all, but where surfaces have a finish.
    pub matte: Slice<Rgb>,
    /// Direct irradiance there, W/m².
    pub direct: Slice<Rgb>,
    /// Indirect irradiance there, W/m².
    pub indirect: Slice<Rgb>,
    /// Specular paths of the primary rays, where they go on at mirrors and through glass.
    pub chains: Option<Slice<SpecularChain>>,
}

/// Adds the passes of so many sub-frames of a picture of a bake; without noise where there is light of the sky for it.
///
/// # Errors
/// What the plan says.
pub fn add(
    frame: &mut FramePlan,
    scene: &SceneTables,
    indirect: &Indirect,
    size: (u32, u32),
    sub_frames: u32,
    sky: Option<&SkyLight>,
    finish: Option<FinishTables>,
) -> Result<Shade, ExecutorError> {
    let smooth_sky = sky.map(|sky| sky.interpolated);
    let direct = DirectParams { area_rays: PIXEL_RAYS, sky_rays: PIXEL_RAYS, ..frame.bake.direct };
    let settings = PixelSettings {
        size,
        sub_frames,
        binding_bytes: frame.binding_bytes(),
        direct,
        has_separate_direct: true,
        follows: frame.bake.scene.specular_material().is_some() || frame.bake.scene.has_medium(),
        smooth_sky,
        finish,
    };
    add_pixels(&mut frame.plan, scene, indirect, &settings)
}

/// Adds the passes of pictures of a scene whose indirect light is anywhere.
///
/// # Errors
/// What the plan says.
pub fn add_pixels(
    plan: &mut Plan,
    scene: &SceneTables,
    indirect: &Indirect,
    settings: &PixelSettings,
) -> Result<Shade, ExecutorError> {
    let count = settings.size.0 * settings.size.1;
    let first = plan.passes().len();
    let count = count as usize;
    let albedo = plan.array("pixel albedo", count);
    let smooth_sky = settings.smooth_sky.filter(|_| settings.has_separate_direct);
    let finish = settings.finish.filter(|_| smooth_sky.is_some());
    let finish = finish.map(|tables| FinishLight::new(plan, tables, count));
    let pixels = PixelBuffers {
        hits: plan.array("hits", count),
        points: plan.array("pixel points", count),
        albedo,
        matte: finish.as_ref().map_or(albedo, |finish| finish.matte),
        direct: plan.array("pixel direct", count),
        indirect: plan.array("pixel indirect", count),
        chains: settings.follows.then(|| plan.array("chains", count)),
    };
    let bands = bands(settings.size, settings.binding_bytes);
    let direct_count = if settings.has_separate_direct { count } else { 0 };
    let band_count = bands.first().map_or(0, |band| band.count as usize);
    let no_light = plan.array("no light", direct_count.min(band_count));
    let full = plan.array("full", count);
    let direct = plan.array("direct sum", direct_count);
    let sub_frames = settings.sub_frames.max(1);
    let smooth = smooth_sky.map(|sky| SmoothLight::new(plan, sky, sub_frames, settings, scene.medium()));
    let mut shade = Shade {
        full,
        direct,
        pixels,
        no_light,
        settings: *settings,
        medium: scene.medium(),
        bands,
        smooth,
        finish,
        sub_frames: Vec::new(),
        last: Vec::new(),
        passes: Vec::new(),
    };
    for _ in 0..sub_frames {
        let sub_frame = add_sub_frame(plan, scene, &shade, indirect)?;
        shade.sub_frames.push(sub_frame);
    }
    if let Some(smooth) = &shade.smooth {
        for &band in &shade.bands {
            shade.last.push(smooth.add_marks(plan, &shade.pixels, band)?);
        }
        for &band in &shade.bands {
            shade.last.push(smooth.add_sum(plan, &shade.pixels, band, (full, direct))?);
        }
        if let Some(finish) = &shade.finish {
            for &band in &shade.bands {
                shade.last.push(finish.add_rays(plan, &shade.pixels, (full, direct), (band, settings.size))?);
            }
        }
    }
    shade.passes = plan.all_passes().split_off(first);
    Ok(shade)
}

/// Source of indirect light at pixels.
#[derive(Clone, Copy, Debug)]
pub enum Indirect {
    /// The patches about.
    Patches {
        /// Which patches are about.
        lookup: LookupTables,
        /// Irradiance of the patches, W/m²; as many values as the lookup needs.
        values: Slice<Rgb>,
    },
    /// The interpolation points of the triangle that is seen.
    Interpolation {
        /// Cells of each triangle.
        grids: Slice<TriangleGrid>,
        /// Cells.
        receiver_cells: Slice<ReceiverCell>,
        /// Interpolation points of the cells.
        vertices: Slice<u32>,
        /// Irradiance of the interpolation points, W/m².
        values: Slice<Rgb>,
    },
}

impl Indirect {
    /// The receivers of a bake.
    pub fn of_bake(frame: &mut FramePlan) -> Self {
        let plan = &mut frame.plan;
        let tables = &mut frame.tables;
        let by_patches = frame.bake.settings.receivers == ReceiverKind::Patches;
        if let Some(lookup) = frame.bake.mesh.lookup.as_ref().filter(|_| by_patches) {
            let values = frame.patches.irradiance;
            return Self::Patches { lookup: LookupTables::new(plan, tables, lookup), values };
        }
        let with_objects = frame.objects.map(|objects| Arc::new(objects.interpolation(frame.bake)));
        let points = with_objects.as_ref().unwrap_or(&frame.bake.receivers.interpolation);
        Self::Interpolation {
            grids: tables.part(plan, "grids", points, |points| &points.grids),
            receiver_cells: tables.part(plan, "receiver_cells", points, |points| &points.cells),
            vertices: tables.part(plan, "vertices", points, |points| &points.vertices),
            values: frame.interpolated,
        }
    }

    /// Copy with other light.
    pub fn with_values(self, light: Slice<Rgb>) -> Self {
        match self {
            Self::Patches { lookup, .. } => Self::Patches { lookup, values: light },
            Self::Interpolation { grids, receiver_cells, vertices, .. } => {
                Self::Interpolation { grids, receiver_cells, vertices, values: light }
            }
        }
    }

    /// Adds the pass of the irradiance of the visible points of a band, into `irradiance`.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add_to(
        &self,
        plan: &mut Plan,
        scene: &SceneTables,
        buffers: &PixelBuffers,
        irradiance: Slice<Rgb>,
        band: Band,
    ) -> Result<PassId, ExecutorError> {
        let points = band.of(buffers.points);
        let irradiance = band.of(irradiance);
        match *self {
            Self::Patches { lookup, values } => lookup.at_points(plan, "shade", values, points, irradiance, band.count),
            Self::Interpolation { grids, receiver_cells, vertices, values } => {
                let hits = band.of(buffers.hits);
                let triangles = scene.geometry.triangles;
                let pass =
                    InterpolatePass { hits, points, triangles, grids, receiver_cells, vertices, values, irradiance };
                Ok(plan.add("shade", &pass, &CountParams { count: band.count })?)
            }
        }
    }
}

fn add_sub_frame(
    plan: &mut Plan,
    scene: &SceneTables,
    shade: &Shade,
    indirect: &Indirect,
) -> Result<SubFrame, ExecutorError> {
    let first = plan.passes().len();
    let buffers = &shade.pixels;
    let SceneTables { geometry, lights, .. } = *scene;
    let mut primary = Vec::new();
    for &band in &shade.bands {
        let camera = PixelParams { count: band.count, first: band.first, ..PixelParams::default() };
        let hits = band.of(buffers.hits);
        primary.push(match buffers.chains {
            None => plan.add("shade", &PrimaryPass { geometry, hits, points: band.of(buffers.points) }, &camera)?,
            Some(chains) => {
                let follow = FollowParams { count: band.count, pixels: camera, ..FollowParams::default() };
                plan.add("shade", &FollowPass { geometry, lights, hits, chains: band.of(chains) }, &follow)?
            }
        });
    }
    let mut albedo = Vec::new();
    for &band in &shade.bands {
        let hits = band.of(buffers.hits);
        let seen = band.of(buffers.albedo);
        let camera = PixelParams { count: band.count, first: band.first, ..PixelParams::default() };
        match buffers.chains {
            None => {
                albedo.push(plan.add("shade", &AlbedoPass { hits, geometry, albedo: seen }, &camera)?);
            }
            // Points are a part of what is seen; their passes stand after those whose push constants change.
            Some(chains) => {
                let points = band.of(buffers.points);
                let pass = ChainSurfacePass { hits, chains: band.of(chains), geometry, points, albedo: seen };
                primary.push(plan.add("shade", &pass, &camera)?);
            }
        }
    }
    let mut finish = Vec::new();
    if let Some(light) = &shade.finish {
        for &band in &shade.bands {
            finish.push(light.add_surface(plan, scene, buffers, band)?);
        }
    }
    let bands =
        shade.bands.iter().map(|&band| add_band(plan, scene, shade, indirect, band)).collect::<Result<_, _>>()?;
    let passes = plan.all_passes().split_off(first);
    Ok(SubFrame { primary, albedo, finish, bands, passes })
}

/// Adds what follows the primary rays of a band.
fn add_band(
    plan: &mut Plan,
    scene: &SceneTables,
    shade: &Shade,
    indirect: &Indirect,
    band: Band,
) -> Result<BandPasses, ExecutorError> {
    let buffers = &shade.pixels;
    let of_pixels = (buffers, indirect);
    let finish = shade.finish.as_ref();
    let smooth = shade.smooth.as_ref().map(|smooth| smooth.add(plan, scene, of_pixels, finish, band)).transpose()?;
    let light = match &smooth {
        Some(passes) => passes.sharp,
        None => {
            let direct = DirectParams { count: band.count, first: band.first, ..shade.settings.direct };
            scene.direct_light(plan, "shade", band.of(buffers.points), band.of(buffers.direct), &direct)?
        }
    };
    indirect.add_to(plan, scene, buffers, buffers.indirect, band)?;
    if let Some(finish) = finish {
        finish.add_indirect(plan, scene, of_pixels, (shade.full, shade.direct), band)?;
    }
    let shade_full = add_shading(plan, scene, buffers, band, band.of(buffers.indirect), shade.full)?;
    let mut shade_direct = None;
    if shade.settings.has_separate_direct {
        let no_light = Band { first: 0, ..band }.of(shade.no_light);
        shade_direct = Some(add_shading(plan, scene, buffers, band, no_light, shade.direct)?);
    }
    Ok(BandPasses { light, smooth, shade_full, shade_direct })
}

/// Adds the pass that adds a sub-frame's radiance under an indirect light to the sums of the pixels of a band.
fn add_shading(
    plan: &mut Plan,
    scene: &SceneTables,
    buffers: &PixelBuffers,
    band: Band,
    indirect: Slice<Rgb>,
    sum: Slice<Rgb>,
) -> Result<PassId, ExecutorError> {
    let SceneTables { geometry, lights, .. } = *scene;
    let albedo = band.of(buffers.matte);
    let direct = band.of(buffers.direct);
    let sum = band.of(sum);
    Ok(match buffers.chains {
        None => {
            let camera = PixelParams { count: band.count, first: band.first, ..PixelParams::default() };
            let hits = band.of(buffers.hits);
            plan.add("shade", &ShadePass { hits, albedo, direct, indirect, geometry, lights, sum }, &camera)?
        }
        Some(chains) => {
            let pass = ChainShadePass { chains: band.of(chains), albedo, direct, indirect, sum };
            plan.add("shade", &pass, &CountParams { count: band.count })?
        }
    })
}

/// Subject of a picture.
pub struct Shot<'a> {
    /// From where.
    pub camera: &'a Camera,
    /// Number of lights.
    pub light_count: u32,
    /// Number of emissive triangles.
    pub emitter_count: u32,
    /// Number of their groups.
    pub group_count: u32,
    /// True if pixels look for the sky.
    pub has_sky: bool,
    /// Seed of each sub-frame, of its positions in the pixels and of its shadow rays.
    pub seeds: &'a [u32],
}

impl Shade {
    /// Fills what the first picture finds.
    ///
    /// # Errors
    /// What the device says.
    pub fn clear(&self, executor: &mut dyn Executor) -> Result<(), ExecutorError> {
        if self.settings.has_separate_direct {
            executor.clear(self.no_light.buffer)?;
        }
        Ok(())
    }

    /// The bands of pixels over which passes run.
    pub fn bands(&self) -> &[Band] {
        &self.bands
    }

    /// Lets these passes follow the primary rays of every sub-frame.
    pub fn add_after_primary(&mut self, passes: &[PassId]) {
        for sub_frame in &mut self.sub_frames {
            let first = sub_frame.primary.len();
            sub_frame.passes.splice(first..first, passes.iter().copied());
        }
        let sub_frames = self.sub_frames.iter().flat_map(|sub_frame| sub_frame.passes.clone());
        self.passes = sub_frames.chain(self.last.iter().copied()).collect();
    }

    /// The passes of the primary rays of the first sub-frame.
    pub fn first_primary(&self) -> &[PassId] {
        self.sub_frames.first().map_or(&[], |sub_frame| &sub_frame.primary)
    }

    /// Number of sub-frames.
    pub fn sub_frames(&self) -> u32 {
        self.sub_frames.len() as u32
    }

    /// The passes of a picture, in their order.
    pub fn passes(&self) -> &[PassId] {
        &self.passes
    }

    /// Those of direct light by itself, which a picture that is only shown does without.
    pub fn direct_passes(&self) -> impl Iterator<Item = PassId> {
        self.sub_frames.iter().flat_map(|sub_frame| &sub_frame.bands).filter_map(|band| band.shade_direct)
    }

    /// The passes that find what the first sub-frame sees.
    pub fn seeing_passes(&self) -> impl Iterator<Item = PassId> {
        let first = self.sub_frames.first().into_iter();
        first.flat_map(|first| first.primary.iter().chain(&first.albedo).chain(first.finish.as_flattened())).copied()
    }

    /// Returns true if one picture leaves its primary hits to the next from the same camera: one sub-frame, whose
    /// places in the pixels never change. Rays that go on at mirrors hold what they saw shine, which may.
    pub fn keeps_hits(&self) -> bool {
        self.sub_frames.len() == 1 && self.smooth.is_some() && self.pixels.chains.is_none()
    }

    /// Those of its first sub-frame.
    pub fn first_passes(&self) -> &[PassId] {
        self.sub_frames.first().map_or(&[], |sub_frame| &sub_frame.passes)
    }

    /// Makes the passes ready for a picture.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(&self, executor: &mut (dyn Executor + 'static), shot: &Shot) -> Result<(), ExecutorError> {
        executor.clear(self.full.buffer)?;
        if self.settings.has_separate_direct {
            executor.clear(self.direct.buffer)?;
        }
        if let Some(smooth) = &self.smooth {
            smooth.clear(executor)?;
        }
        if let Some(finish) = &self.finish {
            finish.clear(executor)?;
        }
        let light_count = shot.light_count;
        let direct = self.settings.direct;
        let sky_rays = if shot.has_sky { direct.sky_rays } else { 0 };
        let camera = self.smooth.as_ref().map_or(*shot.camera, |smooth| smooth.camera(shot.camera));
        for ((number, &seed), sub) in (0..).zip(shot.seeds).zip(&self.sub_frames) {
            // Light without noise is the same in every frame.
            let seed = if self.smooth.is_some() { number } else { seed };
            let light = DirectParams { light_count, emitter_count: shot.emitter_count, sky_rays, seed, ..direct };
            let pixels = PixelParams { camera, seed, light_count, ..PixelParams::default() };
            for (k, ((band, primary), passes)) in self.bands.iter().zip(&sub.primary).zip(&sub.bands).enumerate() {
                let &Band { first, count } = band;
                self.medium.push_direct(executor, passes.light, &DirectParams { first, count, ..light })?;
                if let (Some(smooth), Some(large)) = (&self.smooth, &passes.smooth) {
                    smooth.set(executor, large, &DirectParams { first, count, ..light }, &camera, shot, number)?;
                }
                let pixels = PixelParams { first, count, ..pixels };
                if let Some(&[finish, _]) = sub.finish.get(k) {
                    executor.push(finish, &pixels)?;
                }
                if self.pixels.chains.is_some() {
                    let ray_offset = direct.ray_offset;
                    let absorption = self.medium.absorption;
                    let follow = FollowParams { pixels, absorption, ray_offset, count, ..FollowParams::default() };
                    executor.push(*primary, &follow)?;
                    executor.push(sub.primary[self.bands.len() + k], &pixels)?;
                    continue;
                }
                let seen = [*primary, passes.shade_full, sub.albedo[k]];
                for pass in seen.into_iter().chain(passes.shade_direct) {
                    executor.push(pass, &pixels)?;
                }
            }
        }
        Ok(())
    }
}

/// Seeds of the sub-frames of a frame.
pub fn sub_frame_seeds(frame: u32, sub_frames: u32, seed: u32) -> Vec<u32> {
    (0..sub_frames).map(|k| sub_frame_seed(frame, sub_frames, k, seed)).collect()
}

/// Seed of sub-frame k of a frame.
pub fn sub_frame_seed(frame: u32, sub_frames: u32, k: u32, seed: u32) -> u32 {
    hash3(frame * sub_frames + k, 0x6672_616d, seed)
}
