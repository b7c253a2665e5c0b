//! Recipe of `scene_parts_taken`: random walks from places to light on the device.

use gpu_kernels::table::SCENE_PARTS_TAKEN;
use scene::kernel::walk;
use scene::{Scene, SurfacePoint, WalkParams};

use super::add_pass;
use super::scene::{SceneTables, load_scene};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{BufferId, PassId, Plan, Range};

/// Places that walk together: few enough that drivers take no run for one that hangs.
const PLACES_TOGETHER: u32 = 1 << 16;

/// The pass over places of a plan that has a scene, and the buffers that change.
#[derive(Clone, Copy, Debug)]
pub struct Walks {
    pass: PassId,
    points: BufferId,
    parts: BufferId,
    params: WalkParams,
}

impl Walks {
    /// Adds the pass to a plan.
    ///
    /// # Errors
    /// Buffers that are too large.
    pub fn add(plan: &mut Plan, tables: &SceneTables, scene: &Scene) -> Result<Self, ExecutorError> {
        let points = plan.storage("places", u64::from(PLACES_TOGETHER) * size_of::<SurfacePoint>() as u64);
        let parts = plan.storage("parts", u64::from(PLACES_TOGETHER) * size_of::<u32>() as u64);
        let own = [("points", Range::from(points)), ("parts", Range::from(parts))];
        let params = WalkParams { count: PLACES_TOGETHER, ..scene.walk_params(1, 0) };
        let pass = add_pass(plan, "walks", &SCENE_PARTS_TAKEN, &own, tables.bindings(), &params, params.count)?;
        Ok(Self { pass, points, parts, params })
    }

    /// Loads a plan that has the scene with its lights and this pass alone. The plan that the device had goes.
    ///
    /// # Errors
    /// What the device says: a scene too large for it, say.
    pub fn load(executor: &mut (dyn Executor + 'static), scene: &Scene) -> Result<Self, ExecutorError> {
        load_scene(executor, scene, |plan, tables| Self::add(plan, tables, scene))
    }

    /// Result of [`scene::part_taken`] for each place, by so many walks: one from each in a dispatch, then one more
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
            for some in dark.chunks(PLACES_TOGETHER as usize) {
                let count = some.len() as u32;
                let own: Vec<SurfacePoint> = some.iter().map(|&k| places[k]).collect();
                executor.upload(self.points, &own)?;
                let end_walk = (first_walk + 1).min(walks);
                executor.push(self.pass, &WalkParams { count, walks, seed, first_walk, end_walk, ..self.params })?;
                executor.set_elements(self.pass, count)?;
                executor.submit_passes(&[self.pass])?;
                let all: Vec<u32> = executor.download_table(self.parts)?;
                some.iter().zip(all).for_each(|(&k, part)| found[k] = part);
            }
            dark.retain(|&k| found[k] == walk::DARK);
        }
        Ok(found)
    }
}
