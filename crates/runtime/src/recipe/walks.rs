//! Recipe of `scene_reachability`: random walks from places to light on the device.

use gpu_kernels::scene::ReachabilityPass;
use scene::gpu::WalkParams;
use scene::kernel::walk;
use scene::{Scene, SurfacePoint};

use super::scene::{SceneTables, load_scene};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{PassId, Plan, Slice};

/// Places that walk together: few enough that drivers take no run for one that hangs.
const PLACES_PER_BATCH: u32 = 1 << 16;

/// The pass over places of a plan that has a scene, and the buffers that change.
#[derive(Clone, Copy, Debug)]
pub struct Walks {
    pass: PassId,
    points: Slice<SurfacePoint>,
    reached: Slice<u32>,
    params: WalkParams,
}

impl Walks {
    /// Adds the pass to a plan.
    ///
    /// # Errors
    /// Buffers that are too large.
    pub fn add(plan: &mut Plan, tables: &SceneTables, scene: &Scene) -> Result<Self, ExecutorError> {
        let points = plan.array("places", PLACES_PER_BATCH as usize);
        let reached = plan.array("reached", PLACES_PER_BATCH as usize);
        let SceneTables { geometry, lights, .. } = *tables;
        let bound = ReachabilityPass { points, geometry, lights: lights.lights, emitters: lights.emitters, reached };
        let params = WalkParams { count: PLACES_PER_BATCH, ..scene.walk_params(1, 0) };
        let pass = plan.add("walks", &bound, &params)?;
        Ok(Self { pass, points, reached, params })
    }

    /// Loads a plan that has the scene with its lights and this pass alone. The plan that the device had goes.
    ///
    /// # Errors
    /// What the device says: a scene too large for it, say.
    pub fn load(executor: &mut (dyn Executor + 'static), scene: &Scene) -> Result<Self, ExecutorError> {
        load_scene(executor, scene, |plan, tables| Self::add(plan, tables, scene))
    }

    /// Result of [`scene::reachability`] for each place, by so many walks: one from each in a dispatch, then one more
    /// from those that are dark so far. Few places need many; and lavapipe ends all loops of an invocation after 65,535
    /// rounds. Waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn find(
        &self,
        executor: &mut (dyn Executor + 'static),
        places: &[SurfacePoint],
        walks: u32,
        seed: u32,
    ) -> Result<Vec<u32>, ExecutorError> {
        let mut found = vec![walk::DARK; places.len()];
        let mut dark: Vec<usize> = (0..places.len()).collect();
        for first_walk in 0..walks.max(1) {
            for some in dark.chunks(PLACES_PER_BATCH as usize) {
                let count = some.len() as u32;
                let own: Vec<SurfacePoint> = some.iter().map(|&k| places[k]).collect();
                executor.upload(self.points, &own)?;
                let end_walk = (first_walk + 1).min(walks);
                executor.push(self.pass, &WalkParams { count, walks, seed, first_walk, end_walk, ..self.params })?;
                executor.submit_passes(&[self.pass])?;
                let all = executor.download_table(self.reached)?;
                some.iter().zip(all).for_each(|(&k, part)| found[k] = part);
            }
            dark.retain(|&k| found[k] == walk::DARK);
        }
        Ok(found)
    }
}
