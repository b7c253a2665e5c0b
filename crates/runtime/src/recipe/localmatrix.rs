//! Recipe of `localmatrix`: a copy of the matrix round a camera on a device, which is changed there as the host's is.

use glam::{UVec2, Vec4};
use gpu_kernels::localmatrix::{
    CompactPass, CountPass, FadePass, MeanPass, ProductPass, ShowPass, SpreadPass, StartPass, UpdatePass,
};
use gpu_kernels::params::CountParams;
use localmatrix::kernel::{BLOCK, KEPT};
use localmatrix::{CameraMatrix, FadeParams, LocalMatrix, SlotParams, Update, UpdateParams};
use scene::Rgb;
use web_time::Instant;

use super::Tables;
use super::multibounce::Order;
use crate::executor::{Executor, ExecutorError};
use crate::plan::{PassId, Plan, Slice};

/// Vectors, and new columns, of an update on the device at most; beyond them the whole matrix is uploaded.
const UPDATE_CAPACITY: usize = 128;

/// Why a frame failed.
#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// The device.
    #[error(transparent)]
    Executor(#[from] ExecutorError),
    /// The matrix.
    #[error(transparent)]
    Matrix(#[from] localmatrix::Error),
}

/// The matrix between the slots of a camera's world on a device: from the exitance of the slots to their irradiance.
pub struct SlotMatrix {
    buffers: SlotBuffers,
    product: Vec<PassId>,
    updates: [PassId; 3],
    /// Start of each block of lit slots in their list; at the end their number.
    lit_starts: Slice<u32>,
}

/// The buffers of a matrix between slots.
#[derive(Clone, Copy)]
struct SlotBuffers {
    planes: [Slice<f32>; 3],
    sqrt_area: Slice<f32>,
    visible: Slice<Rgb>,
    vectors: Slice<f32>,
    columns: Slice<f32>,
    new_column: Slice<u32>,
    irradiance: Slice<Rgb>,
}

impl SlotBuffers {
    fn new(plan: &mut Plan, slots: usize) -> Self {
        Self {
            planes: ["red", "green", "blue"].map(|name| plan.array(name, slots * slots)),
            sqrt_area: plan.array("sqrt area", slots),
            visible: plan.array("visible", slots),
            vectors: plan.array("vectors", 3 * UPDATE_CAPACITY * slots),
            columns: plan.array("columns", 3 * UPDATE_CAPACITY * slots),
            new_column: plan.array("new column", slots),
            irradiance: plan.array("slot irradiance", slots),
        }
    }
}

impl SlotMatrix {
    /// Adds the passes of the product `H_i = Σ_j T̂_ij √a_j E_j / √a_i` over the slots
    /// ([`localmatrix::kernel::gather`]), W/m², and those that change the matrix. Shapes: `exitance[slots]`, a multiple
    /// of 4 slots. Run [`Self::product`] once [`Self::upload`] has put the matrix on the device.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn new(plan: &mut Plan, slots: usize, exitance: Slice<Rgb>) -> Result<Self, ExecutorError> {
        let b = SlotBuffers::new(plan, slots);
        let mut product = Vec::new();
        let lit = add_list(plan, &mut product, slots, exitance, ["lit counts", "lit starts", "lit"])?;
        let names = ["visible counts", "visible starts", "seen"];
        let visible = add_list(plan, &mut product, slots, b.visible, names)?;
        product.push(add_product(plan, &b, slots, exitance, &lit, &visible)?);
        let [red, green, blue] = b.planes;
        let updates = [
            add_update(plan, &b, slots, red)?,
            add_update(plan, &b, slots, green)?,
            add_update(plan, &b, slots, blue)?,
        ];
        Ok(Self { buffers: b, product, updates, lit_starts: lit.starts })
    }

    /// The passes of the product.
    pub fn product(&self) -> &[PassId] {
        &self.product
    }

    /// Irradiance of the slots that hold a patch, W/m²; of the others it has no meaning.
    pub fn irradiance(&self) -> Slice<Rgb> {
        self.buffers.irradiance
    }

    /// Puts the whole matrix on the device. From then on its changes are recorded, for [`Self::follow`].
    ///
    /// # Errors
    /// What the device says.
    pub fn upload(
        &self,
        executor: &mut (dyn Executor + 'static),
        matrix: &mut LocalMatrix,
    ) -> Result<(), ExecutorError> {
        matrix.record();
        matrix.take_updates();
        self.upload_planes(executor, matrix)?;
        self.upload_places(executor, matrix)
    }

    /// Changes the matrix on the device as the host's was since the last time. Where patches came or went, slots hold
    /// others: [`Self::upload_places`].
    ///
    /// # Errors
    /// What the device says.
    pub fn follow(
        &self,
        executor: &mut (dyn Executor + 'static),
        matrix: &mut LocalMatrix,
    ) -> Result<(), ExecutorError> {
        let updates = matrix.take_updates();
        if updates.iter().any(|one| one.rank as usize > UPDATE_CAPACITY || one.slots.len() > UPDATE_CAPACITY) {
            return self.upload_planes(executor, matrix);
        }
        updates.iter().try_for_each(|one| self.update(executor, one))
    }

    /// Puts on the device which slots hold patches, and the square roots of their areas.
    ///
    /// # Errors
    /// What the device says.
    pub fn upload_places(
        &self,
        executor: &mut (dyn Executor + 'static),
        matrix: &LocalMatrix,
    ) -> Result<(), ExecutorError> {
        let mut visible = vec![Vec4::ZERO; matrix.slots()];
        matrix.patches().for_each(|(slot, _)| visible[slot as usize] = Vec4::ONE);
        executor.upload(self.buffers.sqrt_area, matrix.sqrt_area())?;
        executor.upload(self.buffers.visible, &visible)
    }

    /// Slots that were lit in the last product; waits for it.
    ///
    /// # Errors
    /// What the device says.
    pub fn lit(&self, executor: &mut (dyn Executor + 'static)) -> Result<usize, ExecutorError> {
        Ok(executor.download_table(self.lit_starts)?.last().map_or(0, |&count| count as usize))
    }

    fn upload_planes(
        &self,
        executor: &mut (dyn Executor + 'static),
        matrix: &LocalMatrix,
    ) -> Result<(), ExecutorError> {
        let area = matrix.slots() * matrix.slots();
        let planes = matrix.state().chunks_exact(area);
        self.buffers.planes.iter().zip(planes).try_for_each(|(plane, state)| executor.upload(*plane, state))
    }

    /// An update of the matrix.
    fn update(&self, executor: &mut (dyn Executor + 'static), update: &Update) -> Result<(), ExecutorError> {
        let by_columns = (update.columns.len() / (3 * update.slots.len()).max(1)) as u32;
        let by_vectors = (update.vectors.len() / (3 * update.rank.max(1)) as usize) as u32;
        let slots = if by_columns > 0 { by_columns } else { by_vectors };
        if slots == 0 {
            return Ok(());
        }
        let mut new_column = vec![KEPT; slots as usize];
        update.slots.iter().zip(0..).for_each(|(&slot, column)| new_column[slot as usize] = column);
        executor.upload(self.buffers.vectors, &update.vectors)?;
        executor.upload(self.buffers.columns, &update.columns)?;
        executor.upload(self.buffers.new_column, &new_column)?;
        for (&pass, channel) in self.updates.iter().zip(0..) {
            let push = UpdateParams {
                count: slots * slots / 4,
                slots,
                rank: update.rank,
                sign: update.sign,
                first_vector: channel * update.rank * slots,
                first_column: channel * update.slots.len() as u32 * slots,
                ..UpdateParams::default()
            };
            executor.push(pass, &push)?;
        }
        executor.submit_passes(&self.updates)
    }
}

/// The matrix on a device, between the leaves of a camera's world.
pub struct MatrixCopy {
    slots: SlotMatrix,
    leaves: LeafBuffers,
    /// First exitance in the order of the leaves.
    order: PassId,
    /// From there to the irradiance of the slots.
    product: Vec<PassId>,
    /// Irradiance of the leaves before the matrix changes, and now.
    before: PassId,
    now: PassId,
    fade: PassId,
    show: PassId,
    is_there: bool,
}

/// The buffers between leaves and slots.
#[derive(Clone, Copy)]
struct LeafBuffers {
    runs: Slice<UVec2>,
    slot_of: Slice<u32>,
    offset: Slice<Rgb>,
    before: Slice<Rgb>,
    now: Slice<Rgb>,
    /// Light at the leaves and at the slots.
    at_leaves: Slice<Rgb>,
    mean: Slice<Rgb>,
}

impl LeafBuffers {
    fn new(plan: &mut Plan, slots: usize, leaves: usize) -> Self {
        Self {
            runs: plan.array("runs", slots),
            slot_of: plan.array("slot of", leaves),
            at_leaves: plan.array("leaf exitance", leaves),
            mean: plan.array("slot exitance", slots),
            before: plan.array("before", leaves),
            now: plan.array("now", leaves),
            offset: plan.array("offset", leaves),
        }
    }
}

impl MatrixCopy {
    /// Adds the passes between the first exitance of the patches and their irradiance, W/m². They are run by
    /// [`Self::frame`].
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn new(
        plan: &mut Plan,
        tables: &mut Tables,
        matrix: &CameraMatrix,
        source: Slice<Rgb>,
        irradiance: Slice<Rgb>,
    ) -> Result<Self, ExecutorError> {
        let order = matrix.order().to_vec();
        let slot_count = matrix.local().matrix().slots();
        let leaf_count = order.len();
        let mut leaf_of = vec![0u32; leaf_count];
        order.iter().zip(0..).for_each(|(&patch, leaf)| leaf_of[patch as usize] = leaf);
        let order = tables.owned(plan, "leaf order", order);
        let scale = tables.owned(plan, "leaf scale", vec![Vec4::ONE; leaf_count]);
        let area = tables.owned(plan, "leaf area", matrix.local().leaf_area().to_vec());
        let leaf_of = tables.owned(plan, "leaf of", leaf_of);
        let b = LeafBuffers::new(plan, slot_count, leaf_count);

        let count = CountParams { count: leaf_count as u32 };
        let order = Order::new(order, scale, leaf_count).add(plan, "method", source, b.at_leaves)?;
        let mean = MeanPass { runs: b.runs, area, exitance: b.at_leaves, light: b.mean };
        let mean = plan.add("method", &mean, &CountParams { count: slot_count as u32 })?;
        let slots = SlotMatrix::new(plan, slot_count, b.mean)?;
        let product = [mean].into_iter().chain(slots.product().iter().copied()).collect();
        let irradiance_of_slots = slots.irradiance();
        let mut spread = |leaves: Slice<Rgb>| {
            let spread = SpreadPass { slot_of: b.slot_of, irradiance: irradiance_of_slots, leaves };
            plan.add("method", &spread, &count)
        };
        let before = spread(b.before)?;
        let now = spread(b.now)?;
        let fade = FadePass { before: b.before, now: b.now, offset: b.offset };
        let fade = plan.add("method", &fade, &FadeParams { count: count.count, ..FadeParams::default() })?;
        let show = ShowPass { leaf_of, now: b.now, offset: b.offset, irradiance };
        let show = plan.add("method", &show, &count)?;
        Ok(Self { slots, leaves: b, order, product, before, now, fade, show, is_there: false })
    }

    /// Changes of the matrix, and irradiance of the patches; milliseconds of the host's part of the changes. Nothing is
    /// waited for.
    ///
    /// # Errors
    /// What the device and the matrix say.
    pub fn frame(
        &mut self,
        executor: &mut (dyn Executor + 'static),
        matrix: &mut CameraMatrix,
    ) -> Result<f64, CopyError> {
        let start = Instant::now();
        executor.submit_passes(&[self.order])?;
        let changes = matrix.choose()?;
        if !self.is_there || matrix.is_at_rest() {
            // All of it, as it is before the first frame; from then on what changes.
            self.slots.upload(executor, matrix.local_mut().matrix_mut())?;
            self.upload_places(executor, matrix)?;
            let dark = vec![Vec4::ZERO; matrix.order().len()];
            executor.upload(self.leaves.offset, &dark)?;
            executor.upload(self.leaves.before, &dark)?;
            self.is_there = true;
        }
        let has_jump = !changes.is_empty();
        if has_jump {
            let passes: Vec<PassId> = self.product.iter().copied().chain([self.before]).collect();
            executor.submit_passes(&passes)?;
        }
        matrix.apply(changes)?;
        self.slots.follow(executor, matrix.local_mut().matrix_mut())?;
        if has_jump {
            self.slots.upload_places(executor, matrix.local().matrix())?;
            self.upload_places(executor, matrix)?;
        }
        let update_ms = start.elapsed().as_secs_f64() * 1e3;
        executor.push(self.fade, &matrix.local().fade_params(has_jump))?;
        let passes: Vec<PassId> = self.product.iter().copied().chain([self.now, self.fade, self.show]).collect();
        executor.submit_passes(&passes)?;
        Ok(update_ms)
    }

    /// Patches and merged patches of the last frame that were lit; waits for it.
    ///
    /// # Errors
    /// What the device says.
    pub fn lit(&self, executor: &mut (dyn Executor + 'static)) -> Result<usize, ExecutorError> {
        self.slots.lit(executor)
    }

    /// Which leaves the slots hold.
    fn upload_places(
        &self,
        executor: &mut (dyn Executor + 'static),
        matrix: &CameraMatrix,
    ) -> Result<(), ExecutorError> {
        let (slot_of, runs) = matrix.local().places();
        executor.upload(self.leaves.runs.cast(), &runs)?;
        executor.upload(self.leaves.slot_of, &slot_of)
    }
}

/// Lists of slots that are not dark, or that are seen.
struct SlotList {
    starts: Slice<u32>,
    list: Slice<u32>,
}

/// Adds the passes of a list of slots whose values are not zero.
fn add_list(
    plan: &mut Plan,
    passes: &mut Vec<PassId>,
    slots: usize,
    values: Slice<Rgb>,
    [counts, starts, list]: [&str; 3],
) -> Result<SlotList, ExecutorError> {
    let blocks = slots.div_ceil(BLOCK as usize);
    let counts = plan.array(counts, blocks);
    let starts = plan.array(starts, blocks + 1);
    let list = plan.array(list, slots);
    let push = SlotParams { count: blocks as u32, slots: slots as u32 };
    passes.push(plan.add("method", &CountPass { values, counts }, &push)?);
    passes.push(plan.add("method", &StartPass { counts, starts }, &CountParams { count: blocks as u32 + 1 })?);
    passes.push(plan.add("method", &CompactPass { starts, values, list }, &CountParams { count: slots as u32 })?);
    Ok(SlotList { starts, list })
}

/// Adds the pass of the irradiance of the slots that are seen, from those that are lit.
fn add_product(
    plan: &mut Plan,
    b: &SlotBuffers,
    slots: usize,
    exitance: Slice<Rgb>,
    lit: &SlotList,
    visible: &SlotList,
) -> Result<PassId, ExecutorError> {
    let [red, green, blue] = b.planes;
    let product = ProductPass {
        lit_starts: lit.starts,
        lit: lit.list,
        visible_starts: visible.starts,
        visible: visible.list,
        red,
        green,
        blue,
        sqrt_area: b.sqrt_area,
        light: exitance,
        irradiance: b.irradiance,
    };
    Ok(plan.add("method", &product, &SlotParams { count: slots as u32, slots: slots as u32 })?)
}

/// Adds the pass of an update of one channel.
fn add_update(plan: &mut Plan, b: &SlotBuffers, slots: usize, plane: Slice<f32>) -> Result<PassId, ExecutorError> {
    let update = UpdatePass { vectors: b.vectors, columns: b.columns, new_column: b.new_column, plane };
    let push = UpdateParams { count: (slots * slots / 4) as u32, slots: slots as u32, ..UpdateParams::default() };
    Ok(plan.add("update", &update, &push)?)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use localmatrix::{CameraSettings, Surface, Table};
    use scene::sampling::{hash3, unit};

    use super::*;
    use crate::cpu::Cpu;

    const PATCHES: usize = 160;

    /// Patches along a line that have form factors to their neighbours.
    fn world() -> Table {
        let random = |a: usize, c: u32| unit(hash3(a as u32, 0, c));
        let surfaces: Vec<Surface> = (0..PATCHES)
            .map(|i| Surface {
                centre: Vec3::X * i as f32,
                normal: Vec3::Z,
                area: 1.0,
                albedo: Vec3::new(0.8 * random(i, 1), 0.5, 0.9 * random(i, 2)),
            })
            .collect();
        let mut starts = vec![0];
        let mut columns = Vec::new();
        let mut values = Vec::new();
        for i in 0..PATCHES {
            for j in i.saturating_sub(9)..(i + 10).min(PATCHES) {
                columns.push(j as u32);
                values.push(0.3 / (1.0 + i.abs_diff(j) as f32).powi(2));
            }
            starts.push(columns.len() as u32);
        }
        let factors =
            transport::Csr { rows: PATCHES, columns: PATCHES, row_start: starts, column_index: columns, values };
        Table::new(&surfaces, factors).unwrap()
    }

    const FLYING: CameraSettings = CameraSettings { slots: 48, budget: 12, fade: 8, ..CameraSettings::DEFAULT };

    fn greatest_difference(a: &[Vec<Vec4>], b: &[Vec<Vec4>]) -> f32 {
        a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max)
    }

    /// Irradiance frame by frame while the camera goes along the line and the light flickers; nodes that entered.
    fn frames(on_device: bool, settings: CameraSettings) -> (Vec<Vec<Vec4>>, usize) {
        let table = world();
        let order = table.order().to_vec();
        let mut matrix = CameraMatrix::new(Box::new(table), order, &settings, Vec3::ZERO, &|_| true).unwrap();
        let mut plan = Plan::new();
        let mut tables = Tables::new();
        let [source, irradiance] = ["source", "irradiance"].map(|name| plan.array(name, PATCHES));
        let mut copy = MatrixCopy::new(&mut plan, &mut tables, &matrix, source, irradiance).unwrap();
        let mut executor: Box<dyn Executor> = Box::new(Cpu::new());
        executor.load(plan).unwrap();
        tables.upload(executor.as_mut()).unwrap();
        let mut moved = 0;
        let mut frame = |k: usize| {
            let e: Vec<Vec4> = (0..PATCHES)
                .map(|i| Vec4::new(unit(hash3(i as u32, 7, 1)), 1.0 + (k % 3) as f32, (i % 2) as f32, 0.0))
                .collect();
            matrix.move_camera(Vec3::X * (2.0 * k as f32));
            let found = if on_device {
                executor.upload(source, &e).unwrap();
                copy.frame(executor.as_mut(), &mut matrix).unwrap();
                executor.download_table(irradiance).unwrap()
            } else {
                matrix.irradiance(&e, &|| 0.0).unwrap().irradiance
            };
            moved += matrix.last().step.entered;
            found
        };
        let all = (0..30).map(&mut frame).collect();
        (all, moved)
    }

    #[test]
    fn a_copy_on_a_device_gives_the_light_of_the_host() {
        let ((host, moved), (device, _)) = (frames(false, FLYING), frames(true, FLYING));
        assert!(moved > 100, "{moved}");
        let worst = greatest_difference(&host, &device);
        println!("{moved} entered; a difference of {worst:e}");
        assert!(worst < 1e-4, "{worst}");
        let differs = greatest_difference(&host, &frames(true, CameraSettings { fade: 1, ..FLYING }).0);
        assert!(differs > 1e-3, "what fades must be seen: {differs}");
    }

    #[test]
    fn at_rest_the_budget_makes_no_difference() {
        let at_rest = CameraSettings { predicted_frames: 0.0, fade: 1, at_rest: true, ..FLYING };
        let (all, moved) = frames(false, at_rest);
        assert!(moved > 100, "{moved}");
        let few = CameraSettings { budget: 2, ..at_rest };
        let host = greatest_difference(&all, &frames(false, few).0);
        let device = greatest_difference(&all, &frames(true, few).0);
        println!("{moved} entered; a difference of {host:e} on the host, {device:e} on a device");
        assert!(host < 1e-4 && device < 1e-4, "{host} {device}");
        // While the camera moves, with such a budget, the light is that of other nodes.
        let late = greatest_difference(&all, &frames(false, CameraSettings { at_rest: false, ..few }).0);
        assert!(late > 1e-2, "{late}");
    }
}
