//! Direct irradiance at the samples of the elements, W/m².

use runtime::executor::ExecutorError;
use runtime::plan::{BufferId, PassId, Range};
use runtime::recipe::rgb_bytes;
use runtime::recipe::scene::SceneTables;

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

/// Adds the pass.
///
/// # Errors
/// What the plan says.
pub fn add(frame: &mut FramePlan, scene: &SceneTables) -> Result<DirectLight, ExecutorError> {
    let mesh = &frame.bake.mesh;
    let points = frame.tables.part(&mut frame.plan, "points", mesh, |mesh| &mesh.points);
    let irradiance = frame.plan.storage("direct irradiance", rgb_bytes(mesh.points.len()));
    let own = [("points", points), ("irradiance", Range::from(irradiance))];
    let pass = scene.direct_light(&mut frame.plan, "direct", &own, &frame.bake.direct)?;
    Ok(DirectLight { pass, irradiance, points })
}
