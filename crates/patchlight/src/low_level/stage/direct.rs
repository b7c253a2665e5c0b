//! Direct irradiance at the samples of the elements, or of what stands for them, W/m².

use bytemuck::Zeroable as _;
use glam::{Vec3, Vec4};
use gpu_kernels::scene::{AddLightsPass, DirectSharesPass};
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{PassId, Plan, Slice};
use runtime::recipe::scene::{PassMedium, SceneTables};
use scene::gpu::DirectParams;
use scene::{Light, Rgb, SurfacePoint};

use crate::low_level::frame::FramePlan;

/// Most bytes of what is kept of the lights, each of two tables: of more lights, all are traced in each update.
const MAX_KEPT: u64 = 1 << 30;

/// Direct light at points that stay: what reaches them of each light is kept, so that only lights that have moved are
/// traced.
#[derive(Debug)]
pub struct DirectLight {
    /// Irradiance at the samples.
    pub irradiance: Slice<Rgb>,
    /// The samples.
    pub points: Slice<SurfacePoint>,
    /// Light of emitters and sky, and all lights where nothing is kept of them.
    surround: PassId,
    medium: PassMedium,
    kept: Option<KeptLights>,
}

/// Kept light of each lamp.
#[derive(Debug)]
struct KeptLights {
    /// Traces the lights that have changed.
    trace: PassId,
    /// The sum of all.
    add: PassId,
    changed: Slice<u32>,
    shares: Slice<f32>,
    occluders: Slice<u32>,
    /// Lights whose shares are on the device, without their colours.
    traced: Vec<Light>,
    is_surrounded: bool,
}

/// Adds the passes for the samples of a bake.
///
/// # Errors
/// What the plan says.
pub fn add(frame: &mut FramePlan, scene: &SceneTables) -> Result<DirectLight, ExecutorError> {
    let mesh = &frame.bake.mesh;
    let points = frame.tables.part(&mut frame.plan, "points", mesh, |mesh| &mesh.points);
    let params = &frame.bake.direct;
    let binding_bytes = frame.binding_bytes();
    let plan = &mut frame.plan;
    let capacity = scene.light_capacity();
    let count = params.count as usize;
    let irradiance = plan.array("direct irradiance", count);
    let share_bytes = (capacity * count * size_of::<f32>()) as u64;
    let medium = scene.medium();
    // What is kept of a light is one number for all channels.
    if share_bytes > binding_bytes.min(MAX_KEPT) || medium != PassMedium::default() {
        let surround = scene.direct_light(plan, "direct", points, irradiance, params)?;
        return Ok(DirectLight { irradiance, points, surround, medium, kept: None });
    }
    let surroundings = plan.array("surroundings", count);
    let shares = plan.array("light shares", capacity * count);
    let occluders = plan.array("occluders", capacity * count);
    let changed = plan.array("changed lights", capacity);

    let lights = scene.lights.lights;
    let trace = DirectSharesPass {
        points,
        geometry: scene.geometry,
        lights,
        distributions: scene.lights.distributions,
        changed,
        shares,
        occluders,
    };
    let trace = plan.add("direct", &trace, params)?;
    let surround = scene.direct_light(plan, "direct", points, surroundings, params)?;
    let add = plan.add("direct", &AddLightsPass { lights, shares, surroundings, irradiance }, params)?;
    let kept = KeptLights { trace, add, changed, shares, occluders, traced: Vec::new(), is_surrounded: false };
    Ok(DirectLight { irradiance, points, surround, medium, kept: Some(kept) })
}

impl DirectLight {
    /// Before the first frame.
    ///
    /// # Errors
    /// What the device says.
    pub fn clear(&self, executor: &mut dyn Executor) -> Result<(), ExecutorError> {
        executor.clear(self.irradiance.buffer)?;
        let Some(kept) = &self.kept else { return Ok(()) };
        executor.clear(kept.changed.buffer)?;
        executor.clear(kept.occluders.buffer)?;
        executor.clear(kept.shares.buffer)
    }

    /// Makes the passes ready for lights; those that are to be submitted.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(
        &mut self,
        executor: &mut (dyn Executor + 'static),
        lights: &[Light],
        params: &DirectParams,
    ) -> Result<Vec<PassId>, ExecutorError> {
        let Some(kept) = &mut self.kept else {
            self.medium.push_direct(executor, self.surround, params)?;
            return Ok(vec![self.surround]);
        };
        let mut passes = Vec::new();
        let changed = kept.changed_lights(lights);
        executor.push(kept.trace, &DirectParams { light_count: changed.len() as u32, ..*params })?;
        if !changed.is_empty() {
            executor.upload(kept.changed, &changed)?;
            passes.push(kept.trace);
        }
        if !kept.is_surrounded {
            self.medium.push_direct(executor, self.surround, &DirectParams { light_count: 0, ..*params })?;
            passes.push(self.surround);
            kept.is_surrounded = true;
        }
        executor.push(kept.add, params)?;
        passes.push(kept.add);
        Ok(passes)
    }

    /// Bytes of what is kept of all lights at so many samples.
    pub fn bytes(&self, samples: usize) -> u64 {
        let lights = self.kept.as_ref().map_or(0, |kept| kept.traced.len());
        (lights * samples * (size_of::<f32>() + size_of::<u32>()) + samples * size_of::<Vec4>()) as u64
    }

    /// Emitters or the sky have changed.
    pub fn forget_surroundings(&mut self) {
        if let Some(kept) = &mut self.kept {
            kept.is_surrounded = false;
        }
    }

    /// Nothing that was traced counts any more.
    pub fn forget(&mut self) {
        if let Some(kept) = &mut self.kept {
            kept.traced.clear();
        }
        self.forget_surroundings();
    }
}

impl KeptLights {
    /// Numbers of the lights that are not where they were, in any colour.
    fn changed_lights(&mut self, lights: &[Light]) -> Vec<u32> {
        self.traced.resize(lights.len(), Light::zeroed());
        let mut changed = Vec::new();
        for (slot, (light, traced)) in (0u32..).zip(lights.iter().zip(&mut self.traced)) {
            let place = Light { color: Vec3::ONE, ..*light };
            if *traced != place {
                *traced = place;
                changed.push(slot);
            }
        }
        changed
    }
}

/// The pass of direct light at points that change.
#[derive(Clone, Copy, Debug)]
pub struct PointLight {
    /// The pass, whose push constants have the number of lights.
    pub pass: PassId,
    /// Irradiance at the points.
    pub irradiance: Slice<Rgb>,
}

/// Adds the pass for `params.count` points anywhere.
///
/// # Errors
/// What the plan says.
pub fn at_points(
    plan: &mut Plan,
    scene: &SceneTables,
    points: Slice<SurfacePoint>,
    params: &DirectParams,
) -> Result<PointLight, ExecutorError> {
    let irradiance = plan.array("direct irradiance", params.count as usize);
    let pass = scene.direct_light(plan, "direct", points, irradiance, params)?;
    Ok(PointLight { pass, irradiance })
}
