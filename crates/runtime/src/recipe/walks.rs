//! Recipe of `scene_parts_taken`: random walks from places to light on the device.

use gpu_kernels::table::SCENE_PARTS_TAKEN;
use scene::kernel::walk;
use scene::{Scene, SurfacePoint, WalkParams};

use super::scene::SceneTables;
use super::{Tables, add_pass};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{Plan, Range};

/// Places that walk together: few enough that drivers take no run for one that hangs.
const PLACES_TOGETHER: usize = 1 << 16;

/// What [`scene::part_taken`] says of each place, by so many walks: one from each in a dispatch, then one more from those that are
/// dark so far. Few places need many; and lavapipe ends all loops of an invocation after 65,535 rounds. The plan that the device
/// had goes. Waits.
///
/// # Errors
/// What the device says: a scene too large for it, say.
pub fn parts_taken(
    executor: &mut (dyn Executor + 'static),
    scene: &Scene,
    places: &[SurfacePoint],
    walks: u32,
    seed: u32,
) -> Result<Vec<u32>, ExecutorError> {
    let mut plan = Plan::new();
    let mut tables = Tables::new();
    let lights = &scene.lighting.lights;
    let scene_tables = SceneTables::new(&mut plan, &mut tables, scene, lights.len().max(1));
    let together = places.len().clamp(1, PLACES_TOGETHER);
    let points = plan.storage("points", (together * size_of::<SurfacePoint>()) as u64);
    let parts = plan.storage("parts", (together * size_of::<u32>()) as u64);
    let own = [("points", Range::from(points)), ("parts", Range::from(parts))];
    let params = WalkParams { count: together as u32, ..scene.walk_params(walks, seed) };
    let pass = add_pass(&mut plan, "walks", &SCENE_PARTS_TAKEN, &own, scene_tables.bindings(), &params, params.count)?;
    executor.load(plan)?;
    tables.upload(executor)?;
    scene_tables.set_lights(executor, lights)?;
    scene_tables.set_sky_and_emission(executor, scene)?;
    let mut found = vec![walk::DARK; places.len()];
    let mut dark: Vec<usize> = (0..places.len()).collect();
    for first_walk in 0..walks.max(1) {
        for some in dark.chunks(together) {
            let count = some.len() as u32;
            let own: Vec<SurfacePoint> = some.iter().map(|&k| places[k]).collect();
            executor.upload(points, &own)?;
            let end_walk = (first_walk + 1).min(walks);
            executor.push(pass, &WalkParams { count, first_walk, end_walk, ..params })?;
            executor.set_elements(pass, count)?;
            executor.submit_passes(&[pass])?;
            let all: Vec<u32> = executor.download_table(parts)?;
            some.iter().zip(all).for_each(|(&k, part)| found[k] = part);
        }
        dark.retain(|&k| found[k] == walk::DARK);
    }
    Ok(found)
}
