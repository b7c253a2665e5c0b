//! Pixels: sub-frames of primary rays, direct light, indirect light from the interpolation points or from the patches
//! about, and shading.

use gpu_kernels::params::{FollowParams, PixelParams};
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{BufferId, PassId, Plan, Range};
use runtime::recipe::formfactor::interpolate;
use runtime::recipe::patches::LookupTables;
use runtime::recipe::scene::{PassMedium, SceneTables};
use runtime::recipe::{Named, rgb_bytes};
use scene::sampling::hash3;
use scene::{Camera, DirectParams, Hit, Rgb, SpecularChain, SurfacePoint};

use super::bands::{Band, bands};
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
    pub smooth_sky: Option<Range>,
}

/// The passes of pictures.
#[derive(Clone, Debug)]
pub struct Shade {
    /// Sums over the sub-frames of all radiance, W/m²/sr.
    pub full: BufferId,
    /// Sum of direct radiance, where that is separate.
    pub direct: BufferId,
    /// Buffers of one sub-frame, overwritten by the next.
    pub pixels: PixelBuffers,
    no_light: BufferId,
    settings: PixelSettings,
    medium: PassMedium,
    bands: Vec<Band>,
    smooth: Option<SmoothLight>,
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
    pub hits: BufferId,
    /// Hits as points to be lit.
    pub points: BufferId,
    /// Albedo there.
    pub albedo: BufferId,
    /// Direct irradiance there, W/m².
    pub direct: BufferId,
    /// Indirect irradiance there, W/m².
    pub indirect: BufferId,
    /// Specular paths of the primary rays, where they go on at mirrors and through glass.
    pub chains: Option<BufferId>,
}

impl PixelBuffers {
    /// Hits of the primary rays of a band, as a binding.
    pub fn hits_of(&self, band: Band) -> Named {
        ("hits", band.of::<Hit>(self.hits))
    }

    /// Specular paths of the rays of a band, as a binding, where they go on.
    fn chains_of(&self, band: Band) -> Option<Named> {
        self.chains.map(|chains| ("chains", band.of::<SpecularChain>(chains)))
    }

    /// The albedo of a band, as a binding.
    pub fn albedo_of(&self, band: Band) -> Named {
        ("albedo", band.of::<Rgb>(self.albedo))
    }

    /// The points of a band, as a binding.
    pub fn points_of(&self, band: Band) -> Named {
        ("points", band.of::<SurfacePoint>(self.points))
    }
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
) -> Result<Shade, ExecutorError> {
    let smooth_sky = sky.map(|sky| Range::from(sky.interpolated));
    let direct = DirectParams { area_rays: PIXEL_RAYS, sky_rays: PIXEL_RAYS, ..frame.bake.direct };
    let settings = PixelSettings {
        size,
        sub_frames,
        binding_bytes: frame.binding_bytes(),
        direct,
        has_separate_direct: true,
        follows: frame.bake.scene.specular_material().is_some() || frame.bake.scene.has_medium(),
        smooth_sky,
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
    let rgb = rgb_bytes(count as usize);
    let pixels = PixelBuffers {
        hits: plan.storage("hits", u64::from(count) * size_of::<Hit>() as u64),
        points: plan.storage("pixel points", u64::from(count) * size_of::<SurfacePoint>() as u64),
        albedo: plan.storage("pixel albedo", rgb),
        direct: plan.storage("pixel direct", rgb),
        indirect: plan.storage("pixel indirect", rgb),
        chains: settings.follows.then(|| plan.storage("chains", u64::from(count) * size_of::<SpecularChain>() as u64)),
    };
    let bands = bands(settings.size, settings.binding_bytes);
    let direct_bytes = if settings.has_separate_direct { rgb } else { 0 };
    let band_bytes = bands.first().map_or(0, |band| rgb_bytes(band.count as usize));
    let no_light = plan.storage("no light", direct_bytes.min(band_bytes));
    let full = plan.storage("full", rgb);
    let direct = plan.storage("direct sum", direct_bytes);
    let sub_frames = settings.sub_frames.max(1);
    let smooth_sky = settings.smooth_sky.filter(|_| settings.has_separate_direct);
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
        sub_frames: Vec::new(),
        last: Vec::new(),
        passes: Vec::new(),
    };
    for _ in 0..sub_frames {
        let sub_frame = add_sub_frame(plan, scene, &shade, indirect)?;
        shade.sub_frames.push(sub_frame);
    }
    if let Some(smooth) = &shade.smooth {
        let add = |&band| smooth.add_sum(plan, &shade.pixels, band, (full, direct));
        shade.last = shade.bands.iter().map(add).collect::<Result<_, _>>()?;
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
        values: Range,
    },
    /// The interpolation points of the triangle that is seen.
    Interpolation {
        /// Cells of each triangle.
        grids: Range,
        /// Cells.
        cells: Range,
        /// Interpolation points of the cells.
        vertices: Range,
        /// Irradiance of the interpolation points, W/m².
        values: Range,
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
        let points = &frame.bake.receivers.interpolation;
        Self::Interpolation {
            grids: tables.part(plan, "grids", points, |points| &points.grids),
            cells: tables.part(plan, "receiver_cells", points, |points| &points.cells),
            vertices: tables.part(plan, "vertices", points, |points| &points.vertices),
            values: frame.interpolated.into(),
        }
    }

    /// Bindings of the mesh of the interpolation points.
    pub fn mesh(&self) -> Vec<Named> {
        match *self {
            Self::Patches { .. } => Vec::new(),
            Self::Interpolation { grids, cells, vertices, .. } => {
                vec![("grids", grids), ("receiver_cells", cells), ("vertices", vertices)]
            }
        }
    }

    /// Copy with other light.
    pub fn with_values(self, light: Range) -> Self {
        match self {
            Self::Patches { lookup, .. } => Self::Patches { lookup, values: light },
            Self::Interpolation { grids, cells, vertices, .. } => {
                Self::Interpolation { grids, cells, vertices, values: light }
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
        irradiance: BufferId,
        band: Band,
    ) -> Result<PassId, ExecutorError> {
        let mut own = vec![buffers.points_of(band), ("irradiance", band.of::<Rgb>(irradiance))];
        match *self {
            Self::Patches { lookup, values } => {
                own.push(("values", values));
                lookup.at_points(plan, "shade", &own, band.count)
            }
            Self::Interpolation { values, .. } => {
                own.extend([buffers.hits_of(band), ("values", values)]);
                own.extend(self.mesh());
                own.extend(scene.bindings().iter().filter(|(name, _)| *name == "triangles"));
                interpolate(plan, "shade", &own, band.count)
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
    let mut primary = Vec::new();
    for &band in &shade.bands {
        let camera = PixelParams { count: band.count, first: band.first, ..PixelParams::default() };
        let hits = buffers.hits_of(band);
        primary.push(match buffers.chains_of(band) {
            None => scene.primary(plan, "shade", &[hits, buffers.points_of(band)], &camera)?,
            Some(chains) => {
                let follow = FollowParams { count: band.count, pixels: camera, ..FollowParams::default() };
                scene.follow(plan, "shade", &[hits, chains], &follow)?
            }
        });
    }
    let mut albedo = Vec::new();
    for &band in &shade.bands {
        let hits = buffers.hits_of(band);
        let own = buffers.albedo_of(band);
        match buffers.chains_of(band) {
            None => albedo.push(scene.albedo(plan, "shade", &[hits, own], band.count)?),
            // Points are a part of what is seen; their passes stand after those whose push constants change.
            Some(chains) => {
                let own = [hits, chains, buffers.points_of(band), own];
                primary.push(scene.chain_surface(plan, "shade", &own, band.count)?);
            }
        }
    }
    let add = |&band| add_band(plan, scene, shade, indirect, band);
    let bands = shade.bands.iter().map(add).collect::<Result<_, _>>()?;
    let passes = plan.all_passes().split_off(first);
    Ok(SubFrame { primary, albedo, bands, passes })
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
    let smooth = shade.smooth.as_ref().map(|smooth| smooth.add(plan, scene, buffers, indirect, band)).transpose()?;
    let light = match &smooth {
        Some(passes) => passes.sharp,
        None => {
            let own = [buffers.points_of(band), ("irradiance", band.of::<Rgb>(buffers.direct))];
            let direct = DirectParams { count: band.count, first: band.first, ..shade.settings.direct };
            scene.direct_light(plan, "shade", &own, &direct)?
        }
    };
    indirect.add_to(plan, scene, buffers, buffers.indirect, band)?;
    let camera = PixelParams { count: band.count, first: band.first, ..PixelParams::default() };
    let own = |indirect: Range, sum: BufferId| {
        let direct = band.of::<Rgb>(buffers.direct);
        let hits = buffers.hits_of(band);
        let albedo = buffers.albedo_of(band);
        let light = [hits, albedo, ("direct", direct), ("indirect", indirect), ("sum", band.of::<Rgb>(sum))];
        light.into_iter().chain(buffers.chains_of(band)).collect::<Vec<Named>>()
    };
    let mut add = |own: &[Named]| match buffers.chains {
        None => scene.shade(plan, "shade", own, &camera),
        Some(_) => scene.chain_shade(plan, "shade", own, band.count),
    };
    let shade_full = add(&own(band.of::<Rgb>(buffers.indirect), shade.full))?;
    let mut shade_direct = None;
    if shade.settings.has_separate_direct {
        let no_light = Band { first: 0, ..band }.of::<Rgb>(shade.no_light);
        shade_direct = Some(add(&own(no_light, shade.direct))?);
    }
    Ok(BandPasses { light, smooth, shade_full, shade_direct })
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
            executor.clear(self.no_light)?;
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
        self.sub_frames.first().into_iter().flat_map(|first| first.primary.iter().chain(&first.albedo)).copied()
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
        executor.clear(self.full)?;
        if self.settings.has_separate_direct {
            executor.clear(self.direct)?;
        }
        if let Some(smooth) = &self.smooth {
            smooth.clear(executor)?;
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
            for ((band, primary), passes) in self.bands.iter().zip(&sub.primary).zip(&sub.bands) {
                let &Band { first, count } = band;
                self.medium.push_direct(executor, passes.light, &DirectParams { first, count, ..light })?;
                if let (Some(smooth), Some(large)) = (&self.smooth, &passes.smooth) {
                    smooth.set(executor, large, *band, &camera, shot, number)?;
                }
                let pixels = PixelParams { first, count, ..pixels };
                if self.pixels.chains.is_some() {
                    let ray_offset = direct.ray_offset;
                    let absorption = self.medium.absorption;
                    let follow = FollowParams { pixels, absorption, ray_offset, count, ..FollowParams::default() };
                    executor.push(*primary, &follow)?;
                    continue;
                }
                for pass in [*primary, passes.shade_full].into_iter().chain(passes.shade_direct) {
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
