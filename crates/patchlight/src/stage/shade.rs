//! Pixels: sub-frames of primary rays, direct light, indirect light from the interpolation points or from the patches about,
//! and shading.

use gpu_kernels::params::PixelParams;
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{BufferId, PassId, Plan, Range};
use runtime::recipe::formfactor::interpolate;
use runtime::recipe::patches::LookupTables;
use runtime::recipe::scene::SceneTables;
use runtime::recipe::{Named, rgb_bytes};
use scene::sampling::hash3;
use scene::{Camera, DirectParams, Hit, SurfacePoint};

use crate::bake::ReceiverKind;
use crate::frame::FramePlan;

/// Shadow rays to area lights, and rays to the sky, in each sub-frame of a pixel.
const PIXEL_RAYS: u32 = 2;

/// What pictures are made with.
#[derive(Clone, Copy, Debug)]
pub struct PixelSettings {
    /// Picture size, pixels.
    pub size: (u32, u32),
    /// Sub-frames a picture.
    pub sub_frames: u32,
    /// How direct light is measured at the pixels: shadow rays to area lights, rays to the sky where it is sampled, and how
    /// far points lie off their surface.
    pub direct: DirectParams,
    /// Whether direct light has a sum of its own, too.
    pub has_separate_direct: bool,
}

/// The passes of pictures.
#[derive(Clone, Debug)]
pub struct Shade {
    /// Sums over the sub-frames of all radiance, W/m²/sr.
    pub full: BufferId,
    /// Of direct radiance, where that has a sum of its own.
    pub direct: BufferId,
    /// What one sub-frame leaves the next overwrites.
    pub pixels: PixelBuffers,
    no_light: BufferId,
    settings: PixelSettings,
    sub_frames: Vec<SubFrame>,
    passes: Vec<PassId>,
}

/// The passes of a sub-frame; the push constants of those that are named change.
#[derive(Clone, Debug)]
struct SubFrame {
    light: PassId,
    primary: PassId,
    shade_full: PassId,
    shade_direct: Option<PassId>,
    passes: Vec<PassId>,
}

/// Buffers of a sub-frame, shared by all.
#[derive(Clone, Copy, Debug)]
pub struct PixelBuffers {
    /// What the primary rays meet.
    pub hits: BufferId,
    /// The same as points to be lit.
    pub points: BufferId,
    /// Direct irradiance there, W/m².
    pub direct: BufferId,
    /// Indirect irradiance there, W/m².
    pub indirect: BufferId,
}

/// Adds the passes of so many sub-frames of a picture of a bake.
///
/// # Errors
/// What the plan says.
pub fn add(
    frame: &mut FramePlan,
    scene: &SceneTables,
    indirect: &Indirect,
    size: (u32, u32),
    sub_frames: u32,
) -> Result<Shade, ExecutorError> {
    let direct = DirectParams { area_rays: PIXEL_RAYS, sky_rays: PIXEL_RAYS, ..frame.bake.direct };
    let settings = PixelSettings { size, sub_frames, direct, has_separate_direct: true };
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
        direct: plan.storage("pixel direct", rgb),
        indirect: plan.storage("pixel indirect", rgb),
    };
    let direct_bytes = if settings.has_separate_direct { rgb } else { 0 };
    let no_light = plan.storage("no light", direct_bytes);
    let full = plan.storage("full", rgb);
    let direct = plan.storage("direct sum", direct_bytes);
    let settings = PixelSettings { direct: DirectParams { count, ..settings.direct }, ..*settings };
    let mut shade = Shade { full, direct, pixels, no_light, settings, sub_frames: Vec::new(), passes: Vec::new() };
    for _ in 0..settings.sub_frames.max(1) {
        let sub_frame = add_sub_frame(plan, scene, &shade, indirect)?;
        shade.sub_frames.push(sub_frame);
    }
    shade.passes = plan.all_passes().split_off(first);
    Ok(shade)
}

/// Where pixels take indirect light from.
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

    /// Adds the pass of indirect irradiance at the visible points.
    fn add(
        &self,
        plan: &mut Plan,
        scene: &SceneTables,
        buffers: &PixelBuffers,
        pixels: u32,
    ) -> Result<PassId, ExecutorError> {
        let mut own = vec![("points", Range::from(buffers.points)), ("irradiance", Range::from(buffers.indirect))];
        match *self {
            Self::Patches { lookup, values } => {
                own.push(("values", values));
                lookup.at_points(plan, "shade", &own, pixels)
            }
            Self::Interpolation { values, .. } => {
                own.extend([("hits", Range::from(buffers.hits)), ("values", values)]);
                own.extend(self.mesh());
                own.extend(scene.bindings().iter().filter(|(name, _)| *name == "triangles"));
                interpolate(plan, "shade", &own, pixels)
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
    let direct = &shade.settings.direct;
    let camera = PixelParams { count: direct.count, ..PixelParams::default() };
    let seen = [("hits", Range::from(buffers.hits)), ("points", Range::from(buffers.points))];
    let primary = scene.primary(plan, "shade", &seen, &camera)?;
    let own = [("points", Range::from(buffers.points)), ("irradiance", Range::from(buffers.direct))];
    let light = scene.direct_light(plan, "shade", &own, direct)?;
    indirect.add(plan, scene, buffers, direct.count)?;
    let own = |indirect: BufferId, sum: BufferId| {
        [
            ("hits", Range::from(buffers.hits)),
            ("direct", Range::from(buffers.direct)),
            ("indirect", Range::from(indirect)),
            ("sum", Range::from(sum)),
        ]
    };
    let shade_full = scene.shade(plan, "shade", &own(buffers.indirect, shade.full), &camera)?;
    let mut shade_direct = None;
    if shade.settings.has_separate_direct {
        shade_direct = Some(scene.shade(plan, "shade", &own(shade.no_light, shade.direct), &camera)?);
    }
    Ok(SubFrame { light, primary, shade_full, shade_direct, passes: plan.all_passes().split_off(first) })
}

/// What a picture is of.
pub struct Shot<'a> {
    /// From where.
    pub camera: &'a Camera,
    /// Number of lights.
    pub light_count: u32,
    /// Number of emissive triangles.
    pub emitter_count: u32,
    /// Whether pixels look for the sky.
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

    /// Number of pixels.
    pub fn pixel_count(&self) -> u32 {
        self.settings.size.0 * self.settings.size.1
    }

    /// Lets these passes follow the primary rays of every sub-frame.
    pub fn add_after_primary(&mut self, passes: &[PassId]) {
        for sub_frame in &mut self.sub_frames {
            let first = sub_frame.passes.iter().position(|&pass| pass == sub_frame.primary).map_or(0, |k| k + 1);
            sub_frame.passes.splice(first..first, passes.iter().copied());
        }
        self.passes = self.sub_frames.iter().flat_map(|sub_frame| sub_frame.passes.clone()).collect();
    }

    /// The pass of the primary rays of the first sub-frame.
    pub fn first_primary(&self) -> &[PassId] {
        self.sub_frames.first().map_or(&[], |sub_frame| std::slice::from_ref(&sub_frame.primary))
    }

    /// Number of sub-frames.
    pub fn sub_frames(&self) -> u32 {
        self.sub_frames.len() as u32
    }

    /// The passes of a picture, in their order.
    pub fn passes(&self) -> &[PassId] {
        &self.passes
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
        let light_count = shot.light_count;
        let direct = self.settings.direct;
        let sky_rays = if shot.has_sky { direct.sky_rays } else { 0 };
        for (&seed, sub) in shot.seeds.iter().zip(&self.sub_frames) {
            let light = DirectParams { light_count, emitter_count: shot.emitter_count, sky_rays, seed, ..direct };
            executor.push(sub.light, &light)?;
            let push = PixelParams { camera: *shot.camera, count: direct.count, seed, light_count, reserved: 0 };
            for pass in [sub.primary, sub.shade_full].into_iter().chain(sub.shade_direct) {
                executor.push(pass, &push)?;
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
