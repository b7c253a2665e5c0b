//! Direct irradiance at the samples of the elements, or of what stands for them, W/m².

use bytemuck::Zeroable as _;
use glam::{Vec3, Vec4};
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{BufferId, PassId, Plan, Range};
use runtime::recipe::rgb_bytes;
use runtime::recipe::scene::{PassMedium, SceneTables};
use scene::{DirectParams, Light};

use crate::low_level::frame::FramePlan;

/// Most bytes of what is kept of the lights, each of two tables: of more lights, all are traced in each update.
const MAX_KEPT: u64 = 1 << 30;

/// Direct light at points that stay: what reaches them of each light is kept, so that only lights that have moved are
/// traced.
#[derive(Debug)]
pub struct DirectLight {
    /// Irradiance at the samples.
    pub irradiance: BufferId,
    /// The samples.
    pub points: Range,
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
    changed: BufferId,
    shares: BufferId,
    occluders: BufferId,
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
    let irradiance = plan.storage("direct irradiance", rgb_bytes(count));
    let share_bytes = (capacity * count * size_of::<f32>()) as u64;
    let medium = scene.medium();
    // What is kept of a light is one number for all channels.
    if share_bytes > binding_bytes.min(MAX_KEPT) || medium != PassMedium::default() {
        let own = [("points", points), ("irradiance", Range::from(irradiance))];
        let surround = scene.direct_light(plan, "direct", &own, params)?;
        return Ok(DirectLight { irradiance, points, surround, medium, kept: None });
    }
    let surroundings = plan.storage("surroundings", rgb_bytes(count));
    let shares = plan.storage("light shares", share_bytes);
    let occluders = plan.storage("occluders", (capacity * count * size_of::<u32>()) as u64);
    let changed = plan.storage("changed lights", (capacity * size_of::<u32>()) as u64);

    let of_lights = [("changed", changed), ("shares", shares), ("occluders", occluders)].map(|(n, id)| (n, id.into()));
    let own = [&[("points", points)], &of_lights[..]].concat();
    let trace = scene.direct_shares(plan, "direct", &own, params)?;
    let own = [("points", points), ("irradiance", Range::from(surroundings))];
    let surround = scene.direct_light(plan, "direct", &own, params)?;
    let own = [("shares", shares.into()), ("surroundings", surroundings.into()), ("irradiance", irradiance.into())];
    let add = scene.add_lights(plan, "direct", &own, params)?;
    let kept = KeptLights { trace, add, changed, shares, occluders, traced: Vec::new(), is_surrounded: false };
    Ok(DirectLight { irradiance, points, surround, medium, kept: Some(kept) })
}

impl DirectLight {
    /// Before the first frame.
    ///
    /// # Errors
    /// What the device says.
    pub fn clear(&self, executor: &mut dyn Executor) -> Result<(), ExecutorError> {
        executor.clear(self.irradiance)?;
        let Some(kept) = &self.kept else { return Ok(()) };
        executor.clear(kept.changed)?;
        executor.clear(kept.occluders)?;
        executor.clear(kept.shares)
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
    pub irradiance: BufferId,
}

/// Adds the pass for `params.count` points anywhere. Shapes: `points[count]` of `SurfacePoint`.
///
/// # Errors
/// What the plan says.
pub fn at_points(
    plan: &mut Plan,
    scene: &SceneTables,
    points: Range,
    params: &DirectParams,
) -> Result<PointLight, ExecutorError> {
    let irradiance = plan.storage("direct irradiance", rgb_bytes(params.count as usize));
    let own = [("points", points), ("irradiance", Range::from(irradiance))];
    let pass = scene.direct_light(plan, "direct", &own, params)?;
    Ok(PointLight { pass, irradiance })
}
