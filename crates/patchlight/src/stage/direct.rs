//! Direct irradiance at the samples of the elements, or of what stands for them, W/m².

use runtime::executor::ExecutorError;
use runtime::plan::{BufferId, PassId, Plan, Range};
use runtime::recipe::rgb_bytes;
use runtime::recipe::scene::SceneTables;
use scene::DirectParams;

use crate::frame::FramePlan;

/// The pass of direct light, whose push constants have the number of lights.
#[derive(Clone, Copy, Debug)]
pub struct DirectLight {
    /// The pass.
    pub pass: PassId,
    /// Irradiance at the samples.
    pub irradiance: BufferId,
    /// The samples.
    pub points: Range,
}

/// Adds the pass for the samples of a bake.
///
/// # Errors
/// What the plan says.
pub fn add(frame: &mut FramePlan, scene: &SceneTables) -> Result<DirectLight, ExecutorError> {
    let mesh = &frame.bake.mesh;
    let points = frame.tables.part(&mut frame.plan, "points", mesh, |mesh| &mesh.points);
    at_points(&mut frame.plan, scene, points, &frame.bake.direct)
}

/// Adds the pass for `params.count` samples anywhere. Shapes: `points[count]` of `SurfacePoint`.
///
/// # Errors
/// What the plan says.
pub fn at_points(
    plan: &mut Plan,
    scene: &SceneTables,
    points: Range,
    params: &DirectParams,
) -> Result<DirectLight, ExecutorError> {
    let irradiance = plan.storage("direct irradiance", rgb_bytes(params.count as usize));
    let own = [("points", points), ("irradiance", Range::from(irradiance))];
    let pass = scene.direct_light(plan, "direct", &own, params)?;
    Ok(DirectLight { pass, irradiance, points })
}
