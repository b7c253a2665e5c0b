//! Irradiance of what a view shows: of the interpolation points that its pixels take light from, and of the receivers
//! behind these. The others keep what an earlier light gave them until they come into view, and are exact then: nothing
//! of an irradiance depends on that of the frame before.

use gpu_kernels::transport::MarkPixelsPass;
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{BufferId, PassId, Plan, Slice};
use runtime::recipe::formfactor::{ViewPass, ViewRows};
use runtime::recipe::patches::WeightPass;
use runtime::recipe::scene::SceneTables;
use scene::Camera;
use transport::kernel::view::{is_needed, needed};
use transport::{QUADRANTS, ViewParams};

use super::gather::ReceiverTables;
use super::shade::{Indirect, Shade};
use crate::low_level::frame::FramePlan;

/// Name of the passes that find out what is in view.
pub const MARK: &str = "mark";
/// Name of those that compute it.
pub const PASS: &str = "view";

/// The passes, and for what view and what light they are.
#[derive(Clone, Debug)]
pub struct View {
    /// The passes that find out what is in view: the points of the pixels, band by band, then the receivers of points
    /// and of smoothing.
    mark_pixels: Vec<ViewPass>,
    mark_receivers: [WeightPass; 2],
    /// Those that compute it: the quadrants of the receivers, then smoothing and points.
    gathers: Vec<ViewPass>,
    weights: [WeightPass; 2],
    /// Buffers that begin as zeros.
    cleared: Vec<BufferId>,
    points: Slice<u32>,
    received: Slice<u32>,
    camera: Option<Camera>,
    view: u32,
    light: u32,
}

/// Tables of so many rows.
fn new_rows(frame: &mut FramePlan, count: usize) -> ViewRows {
    let plan = &mut frame.plan;
    ViewRows { marks: plan.array("marks", count), computed: plan.array("computed", count) }
}

/// `count` rows from the first on.
fn part(rows: ViewRows, first: usize, count: usize) -> ViewRows {
    ViewRows { marks: rows.marks.part(first, count), computed: rows.computed.part(first, count) }
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
    let count = receivers.points.len();
    let first_smooth = receivers.first_smooth();
    let point_count = frame.interpolation_points();
    let points = new_rows(frame, point_count);
    let received = new_rows(frame, first_smooth + count);
    let quadrants = part(received, 0, QUADRANTS * count);
    let smooth = part(received, first_smooth, count);
    let quadrant_values = frame.received.part(0, QUADRANTS * count);
    let smooth_values = frame.received.part(first_smooth, count);
    let range = frame.binding_bytes();
    let exitance = frame.exitance;
    let plan = &mut frame.plan;

    let Some(of_bands) = mark_bands(plan, scene, indirect, shade, points.marks)? else { return Ok(None) };
    let mark_receivers = [
        tables.weights.mark(plan, MARK, points.marks, received.marks)?,
        tables.smoothing.mark(plan, MARK, smooth.marks, quadrants.marks)?,
    ];
    let gathers = rows.gather_view(plan, PASS, range, exitance, frame.received, received)?;
    let weights = [
        tables.smoothing.weigh_view(plan, PASS, quadrant_values, smooth_values, smooth)?,
        tables.weights.weigh_view(plan, PASS, frame.received, frame.interpolated, points)?,
    ];

    let marks = [points.marks, points.computed, received.marks, received.computed].map(|table| table.buffer);
    let cleared = [&marks[..], &[frame.received.buffer, frame.interpolated.buffer]].concat();
    let points = points.marks;
    let received = received.marks;
    let view = View {
        mark_pixels: of_bands,
        mark_receivers,
        gathers,
        weights,
        cleared,
        points,
        received,
        camera: None,
        view: 0,
        // Rows are marked with 0 as long as they are computed for no light.
        light: 1,
    };
    shade.add_after_primary(&view.passes());
    Ok(Some(view))
}

/// Adds the passes that mark the interpolation points of the pixels, band by band; none where pixels take light from
/// patches.
fn mark_bands(
    plan: &mut Plan,
    scene: &SceneTables,
    indirect: &Indirect,
    shade: &Shade,
    marks: Slice<u32>,
) -> Result<Option<Vec<ViewPass>>, ExecutorError> {
    let Indirect::Interpolation { grids, receiver_cells, vertices, .. } = *indirect else { return Ok(None) };
    let triangles = scene.geometry.triangles;
    let mut of_bands = Vec::new();
    for &band in shade.bands() {
        let hits = band.of(shade.pixels.hits);
        let points = band.of(shade.pixels.points);
        let mark = MarkPixelsPass { hits, points, triangles, grids, receiver_cells, vertices, marks };
        let params = ViewParams { count: band.count, ..ViewParams::default() };
        of_bands.push(ViewPass { pass: plan.add(MARK, &mark, &params)?, params });
    }
    Ok(Some(of_bands))
}

impl View {
    /// The passes, in their order.
    pub fn passes(&self) -> Vec<PassId> {
        [self.marks(), self.gathers()].concat()
    }

    /// Those that find out what is in view.
    pub fn marks(&self) -> Vec<PassId> {
        let pixels = self.mark_pixels.iter().map(|mark| mark.pass);
        pixels.chain(self.mark_receivers.iter().map(|mark| mark.pass)).collect()
    }

    /// Those that compute what is known to be in view.
    pub fn gathers(&self) -> Vec<PassId> {
        let rows = self.gathers.iter().map(|gather| gather.pass);
        rows.chain(self.weights.iter().map(|weigh| weigh.pass)).collect()
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
        let marks = executor.download_table(self.received)?;
        let in_view = |marks: &[u32]| marks.iter().any(|&mark| is_needed(mark, self.view));
        let count = marks[..QUADRANTS * receivers].chunks(QUADRANTS).filter(|quadrants| in_view(quadrants)).count();
        let points = executor.download_table(self.points)?;
        Ok((count, points.iter().filter(|&&mark| is_needed(mark, self.view)).count()))
    }

    /// What the camera shows has moved.
    pub fn forget_camera(&mut self) {
        self.camera = None;
    }

    /// Makes the passes ready for a camera, and for another light where it `is_lit_anew`; says whether the camera is
    /// another.
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
            (self.view, self.light) = (0, 1);
        }
        self.view += u32::from(is_other);
        self.light += u32::from(is_lit_anew);
        self.camera = Some(*camera);
        for pass in self.mark_pixels.iter().chain(&self.gathers) {
            pass.set(executor, self.view, self.light)?;
        }
        for pass in self.mark_receivers.iter().chain(&self.weights) {
            pass.set(executor, self.view, self.light)?;
        }
        Ok(is_other)
    }
}
