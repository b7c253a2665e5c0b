//! The matrix round the camera among the passes of a frame: on the host itself where that runs the kernels, else a copy of it on the
//! device, which is changed there as the host's is.

use std::time::Instant;

use bytemuck::cast_slice;
use glam::Vec4;
use gpu_kernels::params::CountParams;
use gpu_kernels::table;
use localmatrix::kernel::{BLOCK, KEPT};
use localmatrix::{FadeParams, SlotParams, Update, UpdateParams};

use super::super::local::LocalLight;
use super::{Uploads, pass};
use crate::error::Error;
use runtime::executor::{Executor, ExecutorError, PassTime};
use runtime::plan::{BufferId, PassId, Plan, Range};

/// Vectors, and new columns, that an update on the device has room for; beyond them the whole matrix is uploaded.
const ROOM: usize = 128;

/// Where the matrix stands among the passes.
pub(super) struct LocalStage {
    light: LocalLight,
    source: BufferId,
    irradiance: BufferId,
    first_pass: usize,
    copy: Option<Copied>,
}

/// The matrix on a device.
struct Copied {
    planes: [BufferId; 3],
    root: BufferId,
    runs: BufferId,
    slot_of: BufferId,
    visible: BufferId,
    offset: BufferId,
    before_light: BufferId,
    vectors: BufferId,
    columns: BufferId,
    place: BufferId,
    /// Where blocks of lit slots begin in their list; at the end their number.
    lit_starts: BufferId,
    /// First exitance in the order of the leaves; from there to the leaves' irradiance; the same before the matrix changes.
    order: PassId,
    product: Vec<PassId>,
    before: PassId,
    now: PassId,
    fade: PassId,
    show: PassId,
    updates: [PassId; 3],
    passes: usize,
    is_there: bool,
}

impl LocalStage {
    /// Between the passes so far, which find the first exitance, and those to come, which use the irradiance.
    pub fn new<'a>(
        plan: &mut Plan,
        uploads: &mut Uploads<'a>,
        mut light: LocalLight,
        (source, irradiance): (BufferId, BufferId),
        on_device: bool,
    ) -> Result<Self, ExecutorError> {
        let first_pass = plan.passes().len();
        let copy = on_device.then(|| Copied::new(plan, uploads, &mut light, source, irradiance)).transpose()?;
        Ok(Self { light, source, irradiance, first_pass, copy })
    }

    /// Passes of the plan before the matrix.
    pub fn first_pass(&self) -> usize {
        self.first_pass
    }

    /// Passes of the plan that are the matrix's own.
    pub fn passes(&self) -> usize {
        self.copy.as_ref().map_or(0, |copy| copy.passes)
    }

    pub fn light_mut(&mut self) -> &mut LocalLight {
        &mut self.light
    }

    /// Changes of the matrix, and irradiance of the patches.
    pub fn light(&mut self, executor: &mut dyn Executor) -> Result<Vec<PassTime>, Error> {
        if let Some(copy) = &mut self.copy {
            return copy.light(executor, &mut self.light);
        }
        let source: Vec<Vec4> = executor.download_table(self.source)?;
        let (irradiance, [update, product]) = self.light.on_host(&source)?;
        executor.upload(self.irradiance, &irradiance)?;
        Ok(vec![time("update", update), time("method", product)])
    }
}

fn time(name: &str, milliseconds: f64) -> PassTime {
    PassTime { name: name.into(), milliseconds }
}

impl Copied {
    fn new<'a>(
        plan: &mut Plan,
        uploads: &mut Uploads<'a>,
        light: &mut LocalLight,
        source: BufferId,
        irradiance: BufferId,
    ) -> Result<Self, ExecutorError> {
        let order = light.order().to_vec();
        let local = light.local();
        let (slots, leaves) = (local.matrix().slots(), order.len());
        let blocks = slots.div_ceil(BLOCK as usize);
        let mut leaf_of = vec![0u32; leaves];
        order.iter().zip(0..).for_each(|(&patch, leaf)| leaf_of[patch as usize] = leaf);
        let (words, rgb) = (|n: usize| 4 * n as u64, |n: usize| (n * size_of::<Vec4>()) as u64);
        let orders = [
            uploads.table(plan, "leaf order", cast_slice(&order).to_vec()),
            uploads.table(plan, "leaf scale", cast_slice(&vec![Vec4::ONE; leaves]).to_vec()),
        ];
        let area = uploads.table(plan, "leaf area", cast_slice(local.leaf_area()).to_vec());
        let leaf_of = uploads.table(plan, "leaf of", cast_slice(&leaf_of).to_vec());
        let planes = ["red", "green", "blue"].map(|name| plan.storage(name, words(slots * slots)));
        let root = plan.storage("root", words(slots));
        let runs = plan.storage("runs", 8 * slots as u64);
        let slot_of = plan.storage("slot of", words(leaves));
        let visible = plan.storage("visible", rgb(slots));
        let vectors = plan.storage("vectors", words(3 * ROOM * slots));
        let columns = plan.storage("columns", words(3 * ROOM * slots));
        let place = plan.storage("place", words(slots));
        let at_leaves = plan.storage("leaf exitance", rgb(leaves));
        let mean = plan.storage("slot exitance", rgb(slots));
        let at_slots = plan.storage("slot irradiance", rgb(slots));
        let before_light = plan.storage("before", rgb(leaves));
        let now_light = plan.storage("now", rgb(leaves));
        let offset = plan.storage("offset", rgb(leaves));
        let first = plan.passes().len();
        let (at_leaf, at_slot) = (CountParams { count: leaves as u32 }, CountParams { count: slots as u32 });
        let own: Vec<(&'static str, Range)> =
            vec![("order", orders[0]), ("scale", orders[1]), ("input", source.into()), ("output", at_leaves.into())];
        let order = pass(plan, "method", &table::MULTIBOUNCE_REORDER, &own, &[], &at_leaf, at_leaf.count)?;

        let mut product = Vec::new();
        let own = [("runs", runs.into()), ("area", area), ("exitance", at_leaves.into()), ("light", mean.into())];
        product.push(pass(plan, "method", &table::LOCALMATRIX_MEAN, &own, &[], &at_slot, at_slot.count)?);
        let mut lists = Vec::new();
        for (values, names) in
            [(mean, ["lit counts", "lit starts", "lit"]), (visible, ["visible counts", "visible starts", "seen"])]
        {
            let counts = plan.storage(names[0], words(blocks));
            let starts = plan.storage(names[1], words(blocks + 1));
            let list = plan.storage(names[2], words(slots));
            let own = [
                ("values", values.into()),
                ("counts", counts.into()),
                ("starts", starts.into()),
                ("list", list.into()),
            ];
            let push = SlotParams { count: blocks as u32, slots: slots as u32 };
            product.push(pass(plan, "method", &table::LOCALMATRIX_COUNT, &own, &[], &push, push.count)?);
            let push = CountParams { count: blocks as u32 + 1 };
            product.push(pass(plan, "method", &table::LOCALMATRIX_START, &own, &[], &push, push.count)?);
            product.push(pass(plan, "method", &table::LOCALMATRIX_COMPACT, &own, &[], &at_slot, at_slot.count)?);
            lists.push((starts, list));
        }
        let own: Vec<(&'static str, Range)> = vec![
            ("lit_starts", lists[0].0.into()),
            ("lit", lists[0].1.into()),
            ("visible_starts", lists[1].0.into()),
            ("visible", lists[1].1.into()),
            ("red", planes[0].into()),
            ("green", planes[1].into()),
            ("blue", planes[2].into()),
            ("root", root.into()),
            ("light", mean.into()),
            ("irradiance", at_slots.into()),
        ];
        let push = SlotParams { count: slots as u32, slots: slots as u32 };
        product.push(pass(plan, "method", &table::LOCALMATRIX_PRODUCT, &own, &[], &push, push.count)?);
        let mut spread = |leaves: BufferId| {
            let own = [("slot_of", slot_of.into()), ("irradiance", at_slots.into()), ("leaves", leaves.into())];
            pass(plan, "method", &table::LOCALMATRIX_SPREAD, &own, &[], &at_leaf, at_leaf.count)
        };
        let (before, now) = (spread(before_light)?, spread(now_light)?);
        let own = [("before", before_light.into()), ("now", now_light.into()), ("offset", offset.into())];
        let push = FadeParams { count: at_leaf.count, ..FadeParams::default() };
        let fade = pass(plan, "method", &table::LOCALMATRIX_FADE, &own, &[], &push, push.count)?;
        let own: Vec<(&'static str, Range)> = vec![
            ("leaf_of", leaf_of),
            ("now", now_light.into()),
            ("offset", offset.into()),
            ("irradiance", irradiance.into()),
        ];
        let show = pass(plan, "method", &table::LOCALMATRIX_SHOW, &own, &[], &at_leaf, at_leaf.count)?;
        let mut update = |plane: BufferId| {
            let own = [
                ("vectors", vectors.into()),
                ("columns", columns.into()),
                ("place", place.into()),
                ("plane", plane.into()),
            ];
            let count = (slots * slots / 4) as u32;
            let push = UpdateParams { count, slots: slots as u32, ..UpdateParams::default() };
            pass(plan, "update", &table::LOCALMATRIX_UPDATE, &own, &[], &push, count)
        };
        let updates = [update(planes[0])?, update(planes[1])?, update(planes[2])?];
        let passes = plan.passes().len() - first;
        Ok(Self {
            planes,
            root,
            runs,
            slot_of,
            visible,
            offset,
            before_light,
            vectors,
            columns,
            place,
            lit_starts: lists[0].0,
            order,
            product,
            before,
            now,
            fade,
            show,
            updates,
            passes,
            is_there: false,
        })
    }

    fn light(&mut self, executor: &mut dyn Executor, light: &mut LocalLight) -> Result<Vec<PassTime>, Error> {
        let mut times = executor.run_passes(&[self.order])?;
        let start = Instant::now();
        let changes = light.choose()?;
        if !self.is_there || light.is_at_rest() {
            // All of it, as it is before the first frame; from then on what changes.
            light.local().matrix_mut().record();
            light.local().matrix_mut().take_updates();
            self.upload(executor, light)?;
            self.upload_places(executor, light)?;
            let dark = vec![Vec4::ZERO; light.order().len()];
            executor.upload(self.offset, &dark)?;
            executor.upload(self.before_light, &dark)?;
            self.is_there = true;
        }
        let mut updating = start.elapsed().as_secs_f64() * 1e3;
        let has_jump = !changes.is_empty();
        if has_jump {
            let passes: Vec<PassId> = self.product.iter().copied().chain([self.before]).collect();
            updating += executor.run_passes(&passes)?.iter().map(|one| one.milliseconds).sum::<f64>();
        }
        let start = Instant::now();
        light.apply(changes)?;
        updating += start.elapsed().as_secs_f64() * 1e3;
        let updates = light.local().matrix_mut().take_updates();
        if updates.iter().any(|one| one.rank as usize > ROOM || one.slots.len() > ROOM) {
            self.upload(executor, light)?;
        } else {
            for one in &updates {
                updating += self.update(executor, one)?;
            }
        }
        if has_jump {
            self.upload_places(executor, light)?;
        }
        times.push(time("update", updating));
        executor.push(self.fade, &light.local().fade_params(has_jump))?;
        let passes: Vec<PassId> = self.product.iter().copied().chain([self.now, self.fade, self.show]).collect();
        times.extend(executor.run_passes(&passes)?);
        let lit = executor.download_table::<u32>(self.lit_starts)?.last().copied().unwrap_or(0);
        light.multiplied(lit as usize);
        Ok(times)
    }

    /// The whole matrix.
    fn upload(&self, executor: &mut dyn Executor, light: &mut LocalLight) -> Result<(), ExecutorError> {
        let matrix = light.local().matrix();
        let area = matrix.slots() * matrix.slots();
        let planes = matrix.state().chunks_exact(area);
        self.planes.iter().zip(planes).try_for_each(|(plane, state)| executor.upload(*plane, state))
    }

    /// What is in the slots.
    fn upload_places(&self, executor: &mut dyn Executor, light: &mut LocalLight) -> Result<(), ExecutorError> {
        let local = light.local();
        let (slot_of, runs) = local.places();
        let mut visible = vec![Vec4::ZERO; runs.len()];
        local.matrix().patches().for_each(|(slot, _)| visible[slot as usize] = Vec4::ONE);
        executor.upload(self.root, local.matrix().root())?;
        executor.upload(self.runs, &runs)?;
        executor.upload(self.slot_of, &slot_of)?;
        executor.upload(self.visible, &visible)
    }

    /// An update of the matrix; milliseconds.
    fn update(&self, executor: &mut dyn Executor, update: &Update) -> Result<f64, Error> {
        let slots = (update.columns.len() / (3 * update.slots.len()).max(1)) as u32;
        let slots = if slots > 0 { slots } else { (update.vectors.len() / (3 * update.rank.max(1)) as usize) as u32 };
        if slots == 0 {
            return Ok(0.0);
        }
        let mut place = vec![KEPT; slots as usize];
        update.slots.iter().zip(0..).for_each(|(&slot, column)| place[slot as usize] = column);
        executor.upload_at(self.vectors, 0, cast_slice(&update.vectors))?;
        executor.upload_at(self.columns, 0, cast_slice(&update.columns))?;
        executor.upload(self.place, &place)?;
        let count = slots * slots / 4;
        for (&pass, channel) in self.updates.iter().zip(0..) {
            let first_vector = channel * update.rank * slots;
            let first_column = channel * update.slots.len() as u32 * slots;
            let (rank, sign) = (update.rank, update.sign);
            let push = UpdateParams { count, slots, rank, sign, first_vector, first_column, ..UpdateParams::default() };
            executor.push(pass, &push)?;
        }
        Ok(executor.run_passes(&self.updates)?.iter().map(|one| one.milliseconds).sum())
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use localmatrix::{Surface, Table};
    use scene::sampling::{hash3, unit};

    use super::super::super::local::LocalOptions;
    use super::*;
    use runtime::cpu::Cpu;

    const PATCHES: usize = 160;

    /// Patches along a line that exchange light with their neighbours.
    fn world() -> Table {
        let random = |a: usize, c: u32| unit(hash3(a as u32, 0, c));
        let surface = |i: usize| Surface {
            centre: Vec3::X * i as f32,
            normal: Vec3::Z,
            area: 1.0,
            albedo: Vec3::new(0.8 * random(i, 1), 0.5, 0.9 * random(i, 2)),
        };
        let surfaces: Vec<Surface> = (0..PATCHES).map(surface).collect();
        let (mut starts, mut columns, mut values) = (vec![0], Vec::new(), Vec::new());
        for i in 0..PATCHES {
            for j in i.saturating_sub(9)..(i + 10).min(PATCHES) {
                columns.push(j as u32);
                values.push(0.3 / (1.0 + i.abs_diff(j) as f32).powi(2));
            }
            starts.push(columns.len() as u32);
        }
        Table::new(&surfaces, starts, columns, values).unwrap()
    }

    const FLYING: LocalOptions = LocalOptions { slots: 48, budget: 12, fade: 8, ..LocalOptions::DEFAULT };

    /// Greatest difference.
    fn apart(a: &[Vec<Vec4>], b: &[Vec<Vec4>]) -> f32 {
        a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max)
    }

    /// Irradiance frame by frame while the camera goes along the line and the light flickers.
    fn frames(on_device: bool, options: LocalOptions) -> (Vec<Vec<Vec4>>, usize) {
        let (mut plan, mut uploads) = (Plan::new(), Uploads::default());
        let [source, irradiance] =
            ["source", "irradiance"].map(|name| plan.storage(name, (PATCHES * size_of::<Vec4>()) as u64));
        let light = LocalLight::of(world(), options, Vec3::ZERO, &|_| true).unwrap();
        let mut stage = LocalStage::new(&mut plan, &mut uploads, light, (source, irradiance), on_device).unwrap();
        // The host's way needs a pass to be a plan.
        let own = [("order", source), ("scale", source), ("input", source), ("output", irradiance)]
            .map(|(name, buffer)| (name, Range::from(buffer)));
        if !on_device {
            let count = CountParams { count: 0 };
            pass(&mut plan, "nothing", &table::MULTIBOUNCE_REORDER, &own, &[], &count, 0).unwrap();
        }
        let mut executor: Box<dyn Executor> = Box::new(Cpu::new());
        executor.load(plan).unwrap();
        for (buffer, bytes) in uploads.0 {
            executor.upload_at(buffer, 0, &bytes).unwrap();
        }
        let mut moved = 0;
        let frame = |k: usize| {
            let light = |i: usize| Vec4::new(unit(hash3(i as u32, 7, 1)), 1.0 + (k % 3) as f32, (i % 2) as f32, 0.0);
            let e: Vec<Vec4> = (0..PATCHES).map(light).collect();
            executor.upload(source, &e).unwrap();
            stage.light_mut().look(Vec3::X * (2.0 * k as f32));
            stage.light(&mut *executor).unwrap();
            moved += stage.light_mut().last().step.entered;
            executor.download_table::<Vec4>(irradiance).unwrap()
        };
        ((0..30).map(frame).collect(), moved)
    }

    #[test]
    fn a_copy_on_a_device_gives_the_light_of_the_host() {
        let ((host, moved), (device, _)) = (frames(false, FLYING), frames(true, FLYING));
        assert!(moved > 100, "{moved}");
        let worst = apart(&host, &device);
        println!("{moved} entered; apart by {worst:e}");
        assert!(worst < 1e-4, "{worst}");
        let differs = apart(&host, &frames(true, LocalOptions { fade: 1, ..FLYING }).0);
        assert!(differs > 1e-3, "what fades must be seen: {differs}");
    }

    #[test]
    fn at_rest_the_budget_makes_no_difference() {
        let at_rest = LocalOptions { look_ahead: 0.0, fade: 1, at_rest: true, ..FLYING };
        let (all, moved) = frames(false, at_rest);
        assert!(moved > 100, "{moved}");
        let few = LocalOptions { budget: 2, ..at_rest };
        let (host, device) = (apart(&all, &frames(false, few).0), apart(&all, &frames(true, few).0));
        println!("{moved} entered; apart by {host:e} on the host, {device:e} on a device");
        assert!(host < 1e-4 && device < 1e-4, "{host} {device}");
        // On the way, with such a budget, the light is that of other nodes.
        let late = apart(&all, &frames(false, LocalOptions { at_rest: false, ..few }).0);
        assert!(late > 1e-2, "{late}");
    }
}
