//! Recipe of `scene_any_hit`: which of any number of rays are stopped.

use gpu_kernels::params::CountParams;
use gpu_kernels::scene::AnyHitPass;
use scene::{Ray, Scene};

use super::scene::{SceneTables, load_scene};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{PassId, Plan, Slice};

/// Rays that are traced together: few enough that drivers take no run for one that hangs.
const RAYS_PER_BATCH: u32 = 1 << 17;

/// The pass over rays of a plan that has a scene, and the buffers that change.
#[derive(Clone, Copy, Debug)]
pub struct RayStops {
    pass: PassId,
    rays: Slice<Ray>,
    stopped: Slice<u32>,
}

impl RayStops {
    /// Adds the pass to a plan.
    ///
    /// # Errors
    /// Buffers that are too large.
    pub fn add(plan: &mut Plan, scene: &SceneTables) -> Result<Self, ExecutorError> {
        let rays = plan.array("shadow rays", RAYS_PER_BATCH as usize);
        let stopped = plan.array("stopped rays", RAYS_PER_BATCH as usize);
        let bound = AnyHitPass { rays, geometry: scene.geometry, stopped };
        let pass = plan.add("shadow rays", &bound, &CountParams { count: RAYS_PER_BATCH })?;
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
        for some in rays.chunks(RAYS_PER_BATCH as usize) {
            let count = some.len() as u32;
            executor.upload(self.rays, some)?;
            executor.push(self.pass, &CountParams { count })?;
            executor.submit_passes(&[self.pass])?;
            let stopped = executor.download_table(self.stopped)?;
            found.extend_from_slice(&stopped[..some.len()]);
        }
        Ok(found)
    }
}
