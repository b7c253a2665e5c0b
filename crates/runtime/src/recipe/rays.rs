//! Recipe of `scene_any_hit`: which of any number of rays are stopped.

use gpu_kernels::params::CountParams;
use scene::{Ray, Scene};

use super::scene::{SceneTables, load_scene};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{BufferId, PassId, Plan, Range};

/// Rays that are traced together: few enough that drivers take no run for one that hangs.
const RAYS_TOGETHER: u32 = 1 << 17;

/// The pass over rays of a plan that has a scene, and the buffers that change.
#[derive(Clone, Copy, Debug)]
pub struct RayStops {
    pass: PassId,
    rays: BufferId,
    stopped: BufferId,
}

impl RayStops {
    /// Adds the pass to a plan.
    ///
    /// # Errors
    /// Buffers that are too large.
    pub fn add(plan: &mut Plan, scene: &SceneTables) -> Result<Self, ExecutorError> {
        let rays = plan.storage("shadow rays", u64::from(RAYS_TOGETHER) * size_of::<Ray>() as u64);
        let stopped = plan.storage("stopped rays", u64::from(RAYS_TOGETHER) * size_of::<u32>() as u64);
        let own = [("rays", Range::from(rays)), ("stopped", Range::from(stopped))];
        let pass = scene.any_hits(plan, "shadow rays", &own, RAYS_TOGETHER)?;
        Ok(Self { pass, rays, stopped })
    }

    /// Loads a plan that has the scene and this pass alone. The plan that the device had goes.
    ///
    /// # Errors
    /// What the device says: a scene too large for it, say.
    pub fn load(executor: &mut (dyn Executor + 'static), scene: &Scene) -> Result<Self, ExecutorError> {
        load_scene(executor, scene, Self::add)
    }

    /// 1 for every ray that is stopped, else 0. Waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn find(&self, executor: &mut (dyn Executor + 'static), rays: &[Ray]) -> Result<Vec<u32>, ExecutorError> {
        let mut found = Vec::with_capacity(rays.len());
        for some in rays.chunks(RAYS_TOGETHER as usize) {
            let count = some.len() as u32;
            executor.upload(self.rays, some)?;
            executor.push(self.pass, &CountParams { count })?;
            executor.set_elements(self.pass, count)?;
            executor.submit_passes(&[self.pass])?;
            let stopped: Vec<u32> = executor.download_table(self.stopped)?;
            found.extend_from_slice(&stopped[..some.len()]);
        }
        Ok(found)
    }
}
