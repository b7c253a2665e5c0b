//! Pixels: sub-frames of primary rays, direct light, indirect light from the interpolation points, and shading.

use gpu_kernels::params::PixelParams;
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{BufferId, PassId, Range};
use runtime::recipe::formfactor::interpolate;
use runtime::recipe::patches::LookupTables;
use runtime::recipe::rgb_bytes;
use runtime::recipe::scene::SceneTables;
use scene::sampling::hash3;
use scene::{Camera, DirectParams, Hit, SurfacePoint};

use crate::bake::ReceiverKind;
use crate::frame::FramePlan;

/// Shadow rays to area lights, and rays to the sky, in each sub-frame of a pixel.
const PIXEL_RAYS: u32 = 2;

/// The passes of pictures.
#[derive(Clone, Debug)]
pub struct Shade {
    /// Sums over the sub-frames of all radiance, and of direct radiance, W/m²/sr.
    pub full: BufferId,
    /// Direct radiance.
    pub direct: BufferId,
    no_light: BufferId,
    pixels: u32,
    direct_params: DirectParams,
    sub_frames: Vec<SubFrame>,
    passes: Vec<PassId>,
}

/// The passes of a sub-frame whose push constants change.
#[derive(Clone, Copy, Debug)]
struct SubFrame {
    light: PassId,
    primary: PassId,
    shade_full: PassId,
    shade_direct: PassId,
}

/// Buffers of a sub-frame, shared by all: what one leaves the next overwrites.
struct PixelBuffers {
    hits: BufferId,
    points: BufferId,
    direct: BufferId,
    indirect: BufferId,
}

/// Adds the passes of so many sub-frames of a picture.
///
/// # Errors
/// What the plan says.
pub fn add(
    frame: &mut FramePlan,
    scene: &SceneTables,
    size: (u32, u32),
    sub_frames: u32,
) -> Result<Shade, ExecutorError> {
    let pixels = size.0 * size.1;
    let first = frame.plan.passes().len();
    let rgb = rgb_bytes(pixels as usize);
    let buffers = PixelBuffers {
        hits: frame.plan.storage("hits", u64::from(pixels) * size_of::<Hit>() as u64),
        points: frame.plan.storage("pixel points", u64::from(pixels) * size_of::<SurfacePoint>() as u64),
        direct: frame.plan.storage("pixel direct", rgb),
        indirect: frame.plan.storage("pixel indirect", rgb),
    };
    let no_light = frame.plan.storage("no light", rgb);
    let full = frame.plan.storage("full", rgb);
    let direct = frame.plan.storage("direct sum", rgb);
    let direct_params = DirectParams { count: pixels, area_rays: PIXEL_RAYS, ..frame.bake.direct };
    let mut shade = Shade { full, direct, no_light, pixels, direct_params, sub_frames: Vec::new(), passes: Vec::new() };
    let indirect = Indirect::new(frame);
    for _ in 0..sub_frames.max(1) {
        let sub_frame = add_sub_frame(frame, scene, &shade, &buffers, &indirect)?;
        shade.sub_frames.push(sub_frame);
    }
    shade.passes = frame.plan.all_passes().split_off(first);
    Ok(shade)
}

/// Where pixels take indirect light from.
enum Indirect {
    /// The patches about.
    Patches(LookupTables),
    /// The interpolation points of the triangle that is seen.
    Interpolation { grids: Range, cells: Range, vertices: Range },
}

impl Indirect {
    fn new(frame: &mut FramePlan) -> Self {
        let plan = &mut frame.plan;
        let tables = &mut frame.tables;
        let by_patches = frame.bake.settings.receivers == ReceiverKind::Patches;
        if let Some(lookup) = frame.bake.mesh.lookup.as_ref().filter(|_| by_patches) {
            return Self::Patches(LookupTables::new(plan, tables, lookup));
        }
        let points = &frame.bake.receivers.interpolation;
        Self::Interpolation {
            grids: tables.part(plan, "grids", points, |points| &points.grids),
            cells: tables.part(plan, "receiver_cells", points, |points| &points.cells),
            vertices: tables.part(plan, "vertices", points, |points| &points.vertices),
        }
    }

    /// Adds the pass of indirect irradiance at the visible points.
    fn add(
        &self,
        frame: &mut FramePlan,
        scene: &SceneTables,
        buffers: &PixelBuffers,
        pixels: u32,
    ) -> Result<PassId, ExecutorError> {
        let mut own = vec![("points", Range::from(buffers.points)), ("irradiance", Range::from(buffers.indirect))];
        match self {
            Self::Patches(lookup) => {
                own.push(("values", frame.patches.irradiance));
                lookup.at_points(&mut frame.plan, "shade", &own, pixels)
            }
            Self::Interpolation { grids, cells, vertices } => {
                own.extend([
                    ("hits", Range::from(buffers.hits)),
                    ("grids", *grids),
                    ("receiver_cells", *cells),
                    ("vertices", *vertices),
                    ("values", Range::from(frame.interpolated)),
                ]);
                own.extend(scene.bindings().iter().filter(|(name, _)| *name == "triangles"));
                interpolate(&mut frame.plan, "shade", &own, pixels)
            }
        }
    }
}

fn add_sub_frame(
    frame: &mut FramePlan,
    scene: &SceneTables,
    shade: &Shade,
    buffers: &PixelBuffers,
    indirect: &Indirect,
) -> Result<SubFrame, ExecutorError> {
    let camera = PixelParams { count: shade.pixels, ..PixelParams::default() };
    let seen = [("hits", Range::from(buffers.hits)), ("points", Range::from(buffers.points))];
    let primary = scene.primary(&mut frame.plan, "shade", &seen, &camera)?;
    let own = [("points", Range::from(buffers.points)), ("irradiance", Range::from(buffers.direct))];
    let light = scene.direct_light(&mut frame.plan, "shade", &own, &shade.direct_params)?;
    indirect.add(frame, scene, buffers, shade.pixels)?;
    let own = |indirect: BufferId, sum: BufferId| {
        [
            ("hits", Range::from(buffers.hits)),
            ("direct", Range::from(buffers.direct)),
            ("indirect", Range::from(indirect)),
            ("sum", Range::from(sum)),
        ]
    };
    let shade_full = scene.shade(&mut frame.plan, "shade", &own(buffers.indirect, shade.full), &camera)?;
    let shade_direct = scene.shade(&mut frame.plan, "shade", &own(shade.no_light, shade.direct), &camera)?;
    Ok(SubFrame { light, primary, shade_full, shade_direct })
}

/// What a picture is of.
pub struct Shot<'a> {
    /// From where.
    pub camera: &'a Camera,
    /// Number of lights.
    pub light_count: u32,
    /// Number of emissive triangles.
    pub emitter_count: u32,
    /// Whether the sky shines.
    pub has_sky: bool,
    /// Number of the frame: each has its own random numbers.
    pub number: u32,
    /// Changes every random number.
    pub seed: u32,
}

impl Shade {
    /// Fills what the first picture finds.
    ///
    /// # Errors
    /// What the device says.
    pub fn clear(&self, executor: &mut dyn Executor) -> Result<(), ExecutorError> {
        executor.clear(self.no_light)
    }

    /// Number of sub-frames.
    pub fn sub_frames(&self) -> u32 {
        self.sub_frames.len() as u32
    }

    /// The passes of a picture, in their order.
    pub fn passes(&self) -> &[PassId] {
        &self.passes
    }

    /// Makes the passes ready for a picture.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(&self, executor: &mut (dyn Executor + 'static), shot: &Shot) -> Result<(), ExecutorError> {
        executor.clear(self.full)?;
        executor.clear(self.direct)?;
        let light_count = shot.light_count;
        let sky_rays = if shot.has_sky { PIXEL_RAYS } else { 0 };
        for (k, sub) in (0..).zip(&self.sub_frames) {
            let seed = sub_frame_seed(shot.number, self.sub_frames(), k, shot.seed);
            let light =
                DirectParams { light_count, emitter_count: shot.emitter_count, sky_rays, seed, ..self.direct_params };
            executor.push(sub.light, &light)?;
            let push = PixelParams { camera: *shot.camera, count: self.pixels, seed, light_count, reserved: 0 };
            for pass in [sub.primary, sub.shade_full, sub.shade_direct] {
                executor.push(pass, &push)?;
            }
        }
        Ok(())
    }
}

/// Seed of sub-frame k of a frame.
pub fn sub_frame_seed(frame: u32, sub_frames: u32, k: u32, seed: u32) -> u32 {
    hash3(frame * sub_frames + k, 0x6672_616d, seed)
}
