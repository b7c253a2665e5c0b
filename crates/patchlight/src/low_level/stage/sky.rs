//! Irradiance straight from the sky at the interpolation points, W/m²: from the rays of the receivers that escape,
//! smoothed and interpolated as indirect light is. It follows from the sky alone, and is found anew only where the sky
//! changes.

use glam::Vec4;
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{PassId, Slice};
use runtime::recipe::formfactor::HitTables;
use scene::kernel::bvh::FAR;
use scene::{Rgb, SKY_BINS, Scene, sky_exitance};
use transport::QUADRANTS;

use super::gather::ReceiverTables;
use super::objects::{ChangingRows, ObjectLight};
use crate::low_level::frame::FramePlan;
use crate::objects::ObjectTables;

/// Name of the passes.
pub const PASS: &str = "sky";

/// The passes.
#[derive(Clone, Debug)]
pub struct SkyLight {
    /// Exitance of each bin of the sky.
    bins: Slice<Rgb>,
    /// Irradiance of the quadrants of the receivers, and then smoothed; none where no receiver sees the sky.
    pub received: Option<Slice<Rgb>>,
    /// Irradiance of the interpolation points.
    pub interpolated: Slice<Rgb>,
    /// From the bins to the interpolation points; none where no receiver sees the sky.
    pub passes: Vec<PassId>,
    /// Rows of receivers of which objects change some.
    pub(crate) changing: Option<ChangingRows>,
}

/// Adds the passes.
///
/// # Errors
/// What the plan says.
pub(crate) fn add(
    frame: &mut FramePlan,
    tables: &ReceiverTables,
    objects: Option<&ObjectLight>,
) -> Result<SkyLight, crate::Error> {
    let receivers = &frame.bake.receivers;
    let count = receivers.points.len();
    let first_smooth = receivers.first_smooth();
    let range = frame.binding_bytes();
    let points = frame.interpolation_points();
    let first_moving = ObjectTables::first_point(frame.bake);
    let plan = &mut frame.plan;
    let first = plan.passes().len();
    // One bin more, which is dark: what objects cover.
    let bins = plan.array("sky bins", SKY_BINS + usize::from(objects.is_some()));
    let interpolated = plan.array("sky interpolated", points);
    if receivers.sky_rows.quads().is_empty() {
        // No receiver sees it.
        return Ok(SkyLight { bins, received: None, interpolated, passes: Vec::new(), changing: None });
    }
    let received = plan.array("received from the sky", first_smooth + count);
    let mut changing = None;
    if let Some(objects) = objects {
        objects.add_sky(plan, bins, interpolated.part(first_moving, points - first_moving))?;
        let rows = &receivers.sky_rows;
        changing = Some(ChangingRows::new(plan, &mut frame.tables, rows, SKY_BINS + 1, QUADRANTS, |_| false)?);
    }
    let rows = match &changing {
        Some(changing) => changing.tables.clone(),
        None => HitTables::new(plan, &mut frame.tables, &receivers.sky_rows),
    };
    rows.gather(plan, PASS, range, bins, received)?;
    let quadrants = received.part(0, QUADRANTS * count);
    let smooth = received.part(first_smooth, count);
    tables.smoothing.weigh(plan, PASS, quadrants, smooth)?;
    tables.weights.weigh(plan, PASS, received, interpolated)?;
    let passes = plan.all_passes().split_off(first);
    Ok(SkyLight { bins, received: Some(received), interpolated, passes, changing })
}

impl SkyLight {
    /// Exitance of the bins of a scene's sky, as far as a medium leaves it.
    pub fn bins_of(&self, scene: &Scene) -> Vec<Vec4> {
        let left = scene.transmittance(FAR).extend(1.0);
        sky_exitance(&scene.lighting).into_iter().map(|exitance| exitance * left).collect()
    }

    /// Puts the bins of a sky on the device; the passes then find its light.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(&self, executor: &mut dyn Executor, bins: &[Vec4]) -> Result<(), ExecutorError> {
        if self.passes.is_empty() {
            return executor.clear(self.interpolated.buffer);
        }
        executor.upload_at(self.bins.buffer, 0, bytemuck::cast_slice(bins))
    }
}
