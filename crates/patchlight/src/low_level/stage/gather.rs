//! The last two bounces: irradiance of the elements, then of the receivers, smoothed, and of the interpolation points,
//! W/m².

use std::sync::Arc;

use gpu_kernels::params::CountParams;
use gpu_kernels::transport::GatherCsrPass;
use runtime::executor::ExecutorError;
use runtime::recipe::formfactor::{HitTables, SparseTables};
use runtime::recipe::patches::WeightTables;

use super::objects::ChangingRows;
use crate::low_level::frame::FramePlan;
use crate::method::Method;
use transport::{HitCounts, QUADRANTS};

/// Rows from the elements to the interpolation points on the device.
#[derive(Clone, Debug)]
pub struct ReceiverTables {
    /// From the elements to the quadrants of the receivers; none where the method finds these itself.
    pub rows: Option<HitTables>,
    /// The same where objects change some.
    pub(crate) changing: Option<ChangingRows>,
    /// From the quadrants to the smoothed values.
    pub smoothing: WeightTables,
    /// From both to the interpolation points.
    pub weights: WeightTables,
}

/// Adds the passes to the elements; gives their rows, if objects change some.
///
/// # Errors
/// What the plan and the method say.
pub(crate) fn add_elements(
    frame: &mut FramePlan,
    method: &mut dyn Method,
) -> Result<Option<ChangingRows>, crate::Error> {
    let mut changing = None;
    if frame.has_element_bounce() && !method.finds_element_irradiance() {
        changing = add_element_bounce(frame, method)?;
    }
    frame.elements.bounce(&mut frame.plan, "lookup")?;
    Ok(changing)
}

/// Adds the passes from the elements to all receivers and interpolation points; gives the tables, if there are
/// receivers.
///
/// # Errors
/// What the plan and the method say.
pub fn add_receivers(frame: &mut FramePlan, method: &mut dyn Method) -> Result<Option<ReceiverTables>, crate::Error> {
    if frame.bake.receivers.points.is_empty() {
        return Ok(None);
    }
    let is_found = method.add_receiver_passes(frame)?;
    let mut rows = None;
    let mut changing = None;
    if !is_found {
        let receivers = &frame.bake.receivers;
        let starts = receivers.sky_rows.row_start();
        let sees_sky = |row: usize| starts[row] < starts[row + 1];
        changing = changing_rows(frame, &receivers.rows, QUADRANTS, sees_sky)?;
        let tables = match &changing {
            Some(changing) => changing.tables.clone(),
            None => HitTables::new(&mut frame.plan, &mut frame.tables, &receivers.rows),
        };
        let range = frame.binding_bytes();
        tables.gather(&mut frame.plan, "lookup", range, frame.exitance, frame.received)?;
        rows = Some(tables);
    }
    let (smoothing, weights) = add_interpolation(frame)?;
    Ok(Some(ReceiverTables { rows, changing, smoothing, weights }))
}

/// Rows over the elements of which objects change some; none where there are no objects.
fn changing_rows(
    frame: &mut FramePlan,
    rows: &Arc<HitCounts>,
    parts: usize,
    has_room: impl Fn(usize) -> bool,
) -> Result<Option<ChangingRows>, crate::Error> {
    let columns = frame.columns();
    let objects = frame.objects;
    let made = objects.map(|_| ChangingRows::new(&mut frame.plan, &mut frame.tables, rows, columns, parts, has_room));
    made.transpose()
}

/// The first of the two last bounces: between elements, each with its own first exitance and its share of what the
/// patch reflects.
fn add_element_bounce(frame: &mut FramePlan, method: &mut dyn Method) -> Result<Option<ChangingRows>, crate::Error> {
    let Some(element_rows) = &frame.bake.form_factors.element_rows else {
        // The elements are the patches.
        if !method.add_element_passes(frame, frame.patches.exitance)? {
            let name = "patch";
            let rows = SparseTables::new(&mut frame.plan, &mut frame.tables, name, &frame.bake.form_factors.factors);
            rows.gather(&mut frame.plan, "lookup", frame.patches.exitance, frame.elements.irradiance)?;
        }
        return Ok(None);
    };
    add_patch_light(frame)?;
    let exitance = frame.elements.exitance;
    let mut changing = None;
    if !method.add_element_passes(frame, exitance)? {
        changing = changing_rows(frame, element_rows, 1, |_| false)?;
        let rows = match &changing {
            Some(changing) => changing.tables.clone(),
            None => HitTables::new(&mut frame.plan, &mut frame.tables, element_rows),
        };
        let range = frame.binding_bytes();
        rows.gather(&mut frame.plan, "lookup", range, frame.exitance, frame.elements.irradiance)?;
    }
    Ok(changing)
}

/// Exitance of the elements with the irradiance of their patches.
fn add_patch_light(frame: &mut FramePlan) -> Result<(), ExecutorError> {
    let mesh = &frame.bake.mesh;
    let plan = &mut frame.plan;
    let tables = &mut frame.tables;
    let elements = mesh.elements.len() as u32;
    let patch_light = plan.array("patch light at elements", elements as usize);
    let patch: Vec<u32> = (0..elements).map(|element| mesh.patch_of(element)).collect();
    let starts: Vec<u32> = (0..=elements).collect();
    let spread = GatherCsrPass {
        row_start: tables.owned(plan, "element starts", starts),
        columns: tables.owned(plan, "element patches", patch),
        values: tables.owned(plan, "element ones", vec![1.0; elements as usize]),
        exitance: frame.changed.map_or(frame.patches.irradiance, |changed| changed.irradiance),
        irradiance: patch_light,
    };
    plan.add("lookup", &spread, &CountParams { count: elements })?;
    frame.elements.bounce_of(plan, "lookup", patch_light)?;
    Ok(())
}

/// From the quadrants of the receivers to smoothed values, and from both to the interpolation points.
fn add_interpolation(frame: &mut FramePlan) -> Result<(WeightTables, WeightTables), ExecutorError> {
    let receivers = &frame.bake.receivers;
    let count = receivers.points.len();
    let first_smooth = receivers.first_smooth();
    let quadrants = frame.received.part(0, QUADRANTS * count);
    let smooth = frame.received.part(first_smooth, count);
    let plan = &mut frame.plan;
    let tables = &mut frame.tables;
    let smoothing = WeightTables::new(plan, tables, "smoothing", &receivers.smoothing, (0, QUADRANTS));
    smoothing.weigh(plan, "lookup", quadrants, smooth)?;
    let weights = WeightTables::new(plan, tables, "interpolation", &receivers.weights, (first_smooth, 1));
    weights.weigh(plan, "lookup", frame.received, frame.interpolated)?;
    Ok((smoothing, weights))
}
