//! Irradiance of what a view shows: of the interpolation points that its pixels take light from, and of the receivers behind
//! these. The others keep what an earlier light gave them until they come into view, and are exact then: nothing of an
//! irradiance depends on that of the frame before.

use formfactor::kernel::view::{is_needed, needed};
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{BufferId, PassId, Range};
use runtime::recipe::formfactor::{ViewPass, ViewRows, mark_pixels};
use runtime::recipe::rgb_bytes;
use runtime::recipe::scene::SceneTables;
use scene::Camera;
use transport::QUADRANTS;

use super::gather::ReceiverTables;
use super::shade::{Indirect, Shade};
use crate::frame::FramePlan;

/// Name of the passes that find out what is in view.
pub const MARK: &str = "mark";
/// Name of those that compute it.
pub const PASS: &str = "view";

/// The passes, and for what view and what light they are.
#[derive(Clone, Debug)]
pub struct View {
    /// Passes that find out what is in view, and those that compute it.
    marks: Vec<ViewPass>,
    gathers: Vec<ViewPass>,
    /// What is zeros at first.
    cleared: Vec<BufferId>,
    points: BufferId,
    received: BufferId,
    camera: Option<Camera>,
    view: u32,
    light: u32,
}

/// Marks of rows, and for which light each row was computed.
#[derive(Clone, Copy)]
struct Rows {
    marks: BufferId,
    computed: BufferId,
}

impl Rows {
    fn new(frame: &mut FramePlan, count: usize) -> Self {
        let mut table = |name: &str| frame.plan.storage(name, 4 * count as u64);
        Self { marks: table("marks"), computed: table("computed") }
    }

    /// `count` rows from the first on.
    fn part(&self, first: usize, count: usize) -> ViewRows {
        let range = |buffer: BufferId| buffer.range(4 * first as u64, 4 * count as u64);
        ViewRows { marks: range(self.marks), computed: range(self.computed) }
    }
}

/// Adds the passes, behind the primary rays of every sub-frame, which say what is in view; none without tables, and
/// where the method finds the irradiance of the receivers itself.
///
/// # Errors
/// What the plan says.
pub fn add(
    frame: &mut FramePlan,
    scene: &SceneTables,
    tables: Option<&ReceiverTables>,
    indirect: &Indirect,
    shade: &mut Shade,
) -> Result<Option<View>, ExecutorError> {
    let Some((tables, rows)) = tables.and_then(|tables| Some((tables, tables.rows.as_ref()?))) else { return Ok(None) };
    let receivers = &frame.bake.receivers;
    let (count, first_smooth) = (receivers.points.len(), receivers.first_smooth());
    let point_count = receivers.interpolation.points.len();
    let points = Rows::new(frame, point_count);
    let received = Rows::new(frame, first_smooth + count);
    let quadrants = received.part(0, QUADRANTS * count);
    let smooth = received.part(first_smooth, count);
    let quadrant_values = frame.received.range(0, rgb_bytes(QUADRANTS * count));
    let smooth_values = frame.received.range(rgb_bytes(first_smooth), rgb_bytes(count));
    let range = frame.binding_bytes();
    let exitance = frame.elements.exitance.buffer;
    let plan = &mut frame.plan;

    let mut seen = vec![
        ("hits", Range::from(shade.pixels.hits)),
        ("points", Range::from(shade.pixels.points)),
        ("marks", Range::from(points.marks)),
    ];
    seen.extend(indirect.mesh());
    seen.extend(scene.bindings().iter().filter(|(name, _)| *name == "triangles"));
    let mut marks = vec![mark_pixels(plan, MARK, &seen, shade.pixel_count())?];
    marks.push(tables.weights.mark_columns(plan, MARK, points.marks, received.marks)?);
    marks.push(tables.smoothing.mark_columns(plan, MARK, smooth.marks, quadrants.marks)?);
    let of_quadrants = (received.marks, received.computed);
    let mut gathers = rows.gather_view(plan, PASS, range, exitance, frame.received, of_quadrants)?;
    gathers.push(tables.smoothing.gather_view(plan, PASS, quadrant_values, smooth_values, smooth)?);
    let all_points = points.part(0, point_count);
    gathers.push(tables.weights.gather_view(plan, PASS, frame.received, frame.interpolated, all_points)?);

    let cleared =
        vec![points.marks, points.computed, received.marks, received.computed, frame.received, frame.interpolated];
    let (points, received) = (points.marks, received.marks);
    let view = View { marks, gathers, cleared, points, received, camera: None, view: 0, light: 0 };
    shade.add_after_primary(&view.passes());
    Ok(Some(view))
}

impl View {
    /// The passes, in their order.
    pub fn passes(&self) -> Vec<PassId> {
        self.marks.iter().chain(&self.gathers).map(|&(pass, _)| pass).collect()
    }

    /// Those that compute what is known to be in view.
    pub fn gathers(&self) -> Vec<PassId> {
        self.gathers.iter().map(|&(pass, _)| pass).collect()
    }

    /// Fills what the first frame finds.
    ///
    /// # Errors
    /// What the device says.
    pub fn clear(&self, executor: &mut dyn Executor) -> Result<(), ExecutorError> {
        self.cleared.iter().try_for_each(|&buffer| executor.clear(buffer))
    }

    /// Receivers of which a quadrant, and interpolation points, that the view needs; of so many receivers. Waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn count(
        &self,
        executor: &mut (dyn Executor + 'static),
        receivers: usize,
    ) -> Result<(usize, usize), ExecutorError> {
        let marks: Vec<u32> = executor.download_table(self.received)?;
        let in_view = |marks: &[u32]| marks.iter().any(|&mark| is_needed(mark, self.view));
        let count = marks[..QUADRANTS * receivers].chunks(QUADRANTS).filter(|quadrants| in_view(quadrants)).count();
        let points: Vec<u32> = executor.download_table(self.points)?;
        Ok((count, points.iter().filter(|&&mark| is_needed(mark, self.view)).count()))
    }

    /// Makes the passes ready for a camera, and for another light where it `is_lit_anew`; says whether the camera is another.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(
        &mut self,
        executor: &mut (dyn Executor + 'static),
        camera: &Camera,
        is_lit_anew: bool,
    ) -> Result<bool, ExecutorError> {
        let is_other = self.camera.as_ref() != Some(camera);
        if is_other && needed(self.view) > u32::MAX - 4 || self.light == u32::MAX {
            // The numbers are used up.
            self.clear(executor)?;
            (self.view, self.light) = (0, 0);
        }
        self.view += u32::from(is_other);
        self.light += u32::from(is_lit_anew);
        self.camera = Some(*camera);
        for &(pass, params) in self.marks.iter().chain(&self.gathers) {
            executor.push(pass, &transport::ViewParams { view: self.view, light: self.light, ..params })?;
        }
        Ok(is_other)
    }
}
