//! Objects that move: the light that they receive and send, W/m², and rows of others that change with them.
//!
//! Before the last two bounces the elements of objects have what direct light and the sky give them; after the first of
//! these, what their points receive of the elements, too. Receivers then see them among the elements.

use std::sync::Arc;

use glam::{UVec2, Vec4};
use gpu_kernels::params::CountParams;
use gpu_kernels::pass::KernelPass;
use gpu_kernels::transport::{BouncePass, GatherCsrPass};
use rayon::prelude::*;
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{PassId, Plan, Slice};
use runtime::recipe::Tables;
use runtime::recipe::formfactor::{HitTables, Surfaces};
use runtime::recipe::scene::PassMedium;
use scene::gpu::DirectParams;
use scene::{Rgb, SKY_BINS, Scene, SurfacePoint, sky_exitance};
use transport::{Csr, HitCounts, quad_of};

use super::direct::{self, PointLight};
use crate::error::Error;
use crate::low_level::frame::{ChangedPatches, FramePlan};
use crate::objects::{ObjectTables, Placed};

/// Name of the passes.
pub const PASS: &str = "objects";

/// Sparse rows that are made anew in each frame.
#[derive(Clone, Copy, Debug)]
struct ChangingCsr {
    rows: usize,
    row_start: Slice<u32>,
    columns: Slice<u32>,
    values: Slice<f32>,
}

impl ChangingCsr {
    fn new(plan: &mut Plan, rows: usize, entries: usize) -> Self {
        Self {
            rows,
            row_start: plan.array("object row starts", rows + 1),
            columns: plan.array("object columns", entries.max(1)),
            values: plan.array("object values", entries.max(1)),
        }
    }

    fn gather(self, plan: &mut Plan, exitance: Slice<Rgb>, irradiance: Slice<Rgb>) -> Result<PassId, ExecutorError> {
        let Self { row_start, columns, values, rows } = self;
        let count = rows as u32;
        let pass = GatherCsrPass { row_start, columns, values, exitance, irradiance };
        Ok(plan.add(PASS, &pass, &CountParams { count })?)
    }

    fn set(self, executor: &mut (dyn Executor + 'static), rows: &Csr) -> Result<(), ExecutorError> {
        executor.upload(self.row_start, &rows.row_start)?;
        executor.upload_at(self.columns.buffer, 0, bytemuck::cast_slice(&rows.column_index))?;
        executor.upload_at(self.values.buffer, 0, bytemuck::cast_slice(&rows.values))
    }
}

/// The light of objects on the device.
#[derive(Clone, Debug)]
pub struct ObjectLight {
    points: Slice<SurfacePoint>,
    direct: PointLight,
    params: DirectParams,
    medium: PassMedium,
    bins: Slice<Rgb>,
    albedo: Slice<Rgb>,
    rows: ChangingCsr,
    sky_rows: ChangingCsr,
    /// Passes to what elements send without light from others.
    pub before: Vec<PassId>,
    /// From there to what points receive of others, and elements send of it.
    pub after: Vec<PassId>,
    mean: Csr,
    /// Rows of the points over patches, and what objects change of the form factors between these.
    patch_rows: ChangingCsr,
    factors: ChangingCsr,
    /// Passes of the first exitance for the method, with what is changed of the irradiance.
    pub feed: Vec<PassId>,
    /// Passes from the irradiance that the method finds to what is changed of it.
    pub change: Vec<PassId>,
    /// Passes of the sum of both.
    pub sum: Vec<PassId>,
    /// What is changed.
    changed: ChangedPatches,
}

impl ObjectLight {
    /// Adds the buffers, and the passes before the last two bounces.
    ///
    /// # Errors
    /// What the plan says.
    pub fn new(frame: &mut FramePlan, objects: &ObjectTables, changed: ChangedPatches) -> Result<Self, Error> {
        let count = objects.points();
        let elements = objects.elements();
        let entries = count * objects.rays as usize;
        let exitance_of_objects = frame.exitance.part(ObjectTables::first_column(frame.bake), elements);
        let received = frame.interpolated.part(ObjectTables::first_point(frame.bake), count);
        let scene = frame.scene;
        let first = frame.plan.passes().len();
        let plan = &mut frame.plan;
        let points = plan.array("object points", count);
        let params = DirectParams { count: count as u32, first: 0, sky_rays: 0, ..frame.bake.direct };
        let direct = direct::at_points(plan, &scene, points, &params)?;
        let mut light = Self {
            points,
            direct,
            params,
            medium: scene.medium(),
            bins: plan.array("object sky bins", SKY_BINS),
            albedo: plan.array("object albedo", elements),
            rows: ChangingCsr::new(plan, count, entries),
            sky_rows: ChangingCsr::new(plan, count, entries),
            before: Vec::new(),
            after: Vec::new(),
            mean: objects.means()?,
            patch_rows: ChangingCsr::new(plan, count, entries),
            factors: ChangingCsr::new(plan, frame.patches.count as usize, objects.factor_room),
            feed: Vec::new(),
            change: Vec::new(),
            sum: Vec::new(),
            changed,
        };
        let patches = frame.patches;
        let patch_count = patches.count as usize;
        let first_moving = objects.first_patch_column(frame.bake);
        let from_patches = plan.array("changed exitance", first_moving + elements);
        let of_objects = from_patches.part(first_moving, elements);
        let from_sky = plan.array("object sky", count);
        light.sky_rows.gather(plan, light.bins, from_sky)?;
        let ones = frame.tables.owned(plan, "object ones", vec![Vec4::ONE; count]);
        let own = plan.array("object light", count);
        let sum = BouncePass { source: direct.irradiance, albedo: ones, irradiance: from_sky, exitance: own };
        add(plan, &sum, count)?;
        let mean = [
            frame.tables.owned(plan, "object mean starts", light.mean.row_start.clone()),
            frame.tables.owned(plan, "object mean columns", light.mean.column_index.clone()),
        ];
        let shares = frame.tables.owned(plan, "object mean shares", light.mean.values.clone());
        let zeros = frame.tables.owned(plan, "object zeros", vec![Vec4::ZERO; elements]);
        let of_elements = plan.array("object irradiance", elements);
        let all = plan.array("object light of all", count);
        let send = |plan: &mut Plan, light: &Self, from: Slice<Rgb>, to: Slice<Rgb>| {
            let [row_start, columns] = mean;
            let pass = GatherCsrPass { row_start, columns, values: shares, exitance: from, irradiance: of_elements };
            add(plan, &pass, elements)?;
            let Self { albedo, .. } = *light;
            add(plan, &BouncePass { source: zeros, albedo, irradiance: of_elements, exitance: to }, elements)
        };
        send(plan, &light, own, of_objects)?;
        light.before = plan.all_passes().split_off(first);

        let first = plan.passes().len();
        let Surfaces { albedo, source, irradiance, .. } = patches;
        let feed = BouncePass { source: changed.source, albedo, irradiance: changed.change, exitance: source };
        add(plan, &feed, patch_count)?;
        light.feed = plan.all_passes().split_off(first);
        let first = plan.passes().len();
        let exitance = from_patches.part(0, patch_count);
        add(plan, &BouncePass { source, albedo, irradiance, exitance }, patch_count)?;
        let of_patches = plan.array("object light of patches", count);
        light.patch_rows.gather(plan, from_patches, of_patches)?;
        add(plan, &BouncePass { source: own, albedo: ones, irradiance: of_patches, exitance: all }, count)?;
        send(plan, &light, all, of_objects)?;
        send(plan, &light, all, exitance_of_objects)?;
        light.factors.gather(plan, from_patches, changed.change)?;
        light.change = plan.all_passes().split_off(first);
        let first = plan.passes().len();
        let patch_ones = frame.tables.owned(plan, "patch ones", vec![Vec4::ONE; patch_count]);
        let ChangedPatches { change, irradiance: sum, .. } = changed;
        let both = BouncePass { source: irradiance, albedo: patch_ones, irradiance: change, exitance: sum };
        add(plan, &both, patch_count)?;
        light.sum = plan.all_passes().split_off(first);

        let first = plan.passes().len();
        light.rows.gather(plan, frame.exitance, received)?;
        let sum = BouncePass { source: own, albedo: ones, irradiance: received, exitance: all };
        add(plan, &sum, count)?;
        send(plan, &light, all, exitance_of_objects)?;
        light.after = plan.all_passes().split_off(first);
        Ok(light)
    }

    /// Irradiance of the points from the sky, for pictures, added to a plan: into a part of `interpolated`.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add_sky(
        &self,
        plan: &mut Plan,
        bins: Slice<Rgb>,
        interpolated: Slice<Rgb>,
    ) -> Result<PassId, ExecutorError> {
        self.sky_rows.gather(plan, bins, interpolated)
    }

    /// Takes over the places and rows of all points, and the albedo of the elements.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(
        &self,
        executor: &mut (dyn Executor + 'static),
        Placed { points, rows: [rows, sky_rows], patch_rows, albedo, factors }: &Placed,
    ) -> Result<(), ExecutorError> {
        executor.upload(self.points, points)?;
        executor.upload(self.albedo, albedo)?;
        self.rows.set(executor, rows)?;
        self.sky_rows.set(executor, sky_rows)?;
        self.patch_rows.set(executor, patch_rows)?;
        self.factors.set(executor, factors)
    }

    /// Takes over the lights and the sky of a scene.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_lighting(&self, executor: &mut (dyn Executor + 'static), scene: &Scene) -> Result<(), ExecutorError> {
        let params = DirectParams {
            light_count: scene.lighting.lights.len() as u32,
            emitter_count: scene.emitters.len() as u32,
            ..self.params
        };
        self.medium.push_direct(executor, self.direct.pass, &params)?;
        executor.upload(self.bins, &sky_exitance(&scene.lighting))
    }

    /// Forgets what was changed of the irradiance of patches.
    ///
    /// # Errors
    /// What the device says.
    pub fn clear_change(&self, executor: &mut (dyn Executor + 'static)) -> Result<(), ExecutorError> {
        executor.clear(self.changed.change.buffer)
    }

    /// All passes of the objects' own light.
    pub fn passes(&self) -> impl Iterator<Item = PassId> + '_ {
        self.before.iter().chain(&self.after).copied()
    }
}

/// Adds a pass of so many invocations.
fn add<P: KernelPass<Push = CountParams>>(plan: &mut Plan, pass: &P, count: usize) -> Result<(), ExecutorError> {
    plan.add(PASS, pass, &CountParams { count: count as u32 })?;
    Ok(())
}

/// Items whose rows are put on the device together.
const TOGETHER: usize = 64;

/// Rows on the device of which objects change some.
#[derive(Clone, Debug)]
pub struct ChangingRows {
    /// The rows.
    pub tables: HitTables,
    before: Arc<HitCounts>,
    /// Counts as they are on the device; none where no row has room for more.
    counts: Vec<u8>,
    /// Rows of an item: an element, or the quadrants of a receiver.
    parts: usize,
    changed: Vec<u32>,
}

/// Rows of an item that objects change.
#[derive(Clone, Copy, Debug)]
pub struct ItemChange<'a> {
    /// The item.
    pub item: u32,
    /// Quads that are others than before, by their number.
    pub quads: &'a [(u32, UVec2)],
    /// For each of its rows, a column that is met more often, and how often.
    pub more: &'a [Option<(u32, u32)>],
}

impl ChangingRows {
    /// Puts rows on the device with room for what changes: `columns` in all, and a quad more where `has_room`.
    ///
    /// # Errors
    /// More columns than can be numbered.
    pub fn new(
        plan: &mut Plan,
        tables: &mut Tables,
        rows: &Arc<HitCounts>,
        columns: usize,
        parts: usize,
        has_room: impl Fn(usize) -> bool,
    ) -> Result<Self, Error> {
        let roomy = rows.with_room(columns, has_room)?;
        let has_more = roomy.counts().len() > rows.counts().len();
        Ok(Self {
            tables: HitTables::changing(plan, tables, &roomy),
            before: Arc::clone(rows),
            counts: if has_more { roomy.counts().to_vec() } else { Vec::new() },
            parts,
            changed: Vec::new(),
        })
    }

    /// Makes the rows those of these changes, of ascending items, and of no others.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(
        &mut self,
        executor: &mut (dyn Executor + 'static),
        changes: &[ItemChange<'_>],
    ) -> Result<(), ExecutorError> {
        let mut items: Vec<u32> = changes.iter().map(|change| change.item).chain(self.changed.drain(..)).collect();
        items.sort_unstable();
        items.dedup();
        // Neighbours together.
        let runs: Vec<&[u32]> = items.chunk_by(|a, b| a + 1 == *b).flat_map(|run| run.chunks(TOGETHER)).collect();
        let made: Vec<Vec<UVec2>> = runs.par_iter().map(|run| self.quads(run, changes)).collect();
        for (run, quads) in runs.into_iter().zip(made) {
            let first = self.tables.first_quad(self.parts * run[0] as usize);
            if quads.is_empty() {
                continue;
            }
            self.tables.set_quads(executor, first, &quads)?;
            if !self.counts.is_empty() && self.set_more(run, changes) {
                self.tables.set_counts(executor, first..first + quads.len(), &self.counts)?;
            }
        }
        self.changed = changes.iter().map(|change| change.item).collect();
        Ok(())
    }

    /// Quads of the rows of items that follow each other.
    fn quads(&self, items: &[u32], changes: &[ItemChange<'_>]) -> Vec<UVec2> {
        let starts = self.before.row_start();
        let quads = self.before.quads();
        let mut made = Vec::new();
        for &item in items {
            let change = change_of(changes, item);
            let mut changed = change.map_or(&[][..], |change| change.quads).iter().peekable();
            for part in 0..self.parts {
                let row = self.parts * item as usize + part;
                let own = starts[row]..starts[row + 1];
                let first = made.len();
                made.extend_from_slice(&quads[own.start as usize..own.end as usize]);
                while let Some((number, quad)) = changed.next_if(|(number, _)| *number < own.end) {
                    made[first + (number - own.start) as usize] = *quad;
                }
                if self.has_room(row) {
                    let more = change.and_then(|change| change.more[part]);
                    made.push(more.map_or(UVec2::ZERO, |(column, _)| quad_of([column; 4])));
                }
            }
        }
        made
    }

    fn has_room(&self, row: usize) -> bool {
        let starts = self.before.row_start();
        self.tables.first_quad(row + 1) - self.tables.first_quad(row) > (starts[row + 1] - starts[row]) as usize
    }

    /// Sets the counts of columns that are met more often; returns true if some are others now.
    fn set_more(&mut self, items: &[u32], changes: &[ItemChange<'_>]) -> bool {
        let mut is_new = false;
        for &item in items {
            let change = change_of(changes, item);
            for part in 0..self.parts {
                let row = self.parts * item as usize + part;
                if self.has_room(row) {
                    let more = change.and_then(|change| change.more[part]);
                    let hits = more.map_or(0, |(_, hits)| hits.min(u32::from(u8::MAX)) as u8);
                    let count = &mut self.counts[self.tables.first_quad(row + 1) - 1];
                    is_new |= *count != hits;
                    *count = hits;
                }
            }
        }
        is_new
    }
}

fn change_of<'a>(changes: &[ItemChange<'a>], item: u32) -> Option<ItemChange<'a>> {
    changes.binary_search_by_key(&item, |change| change.item).ok().map(|k| changes[k])
}
