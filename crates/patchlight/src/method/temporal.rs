//! Temporal radiosity: a few samples a row and frame, from the light of the frame before.

use std::ops;
use std::sync::Arc;

use ::temporal::{AliasTables, Packing, RayLists, Settings};
use runtime::executor::Executor;
use runtime::plan::{PassId, Slice};
use runtime::recipe::temporal::{Rows, SampledPasses, SampledRows};
use scene::Rgb;
use transport::{Csr, HitCounts, LinearOperator as _, Phase};

use super::{Method, MethodReport, MethodSettings, Preparation, passes_so_far};
use crate::albedo::Albedo;
use crate::bake::{Bake, ReceiverKind};
use crate::error::{Error, Reason};
use crate::low_level::frame::{FrameInput, FramePlan, LAST_BOUNCES};
use crate::low_level::operator::{OperatorKey, PatchOperator};
use crate::observe::run_phase;

/// Entries of a list that stands for a row of real numbers.
const LIST_ENTRIES: usize = 1024;

/// Storage of rows between patches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RowKind {
    /// Lists of columns, all entries alike: [`RayLists`].
    #[default]
    Lists,
    /// [`AliasTables`].
    Tables,
    /// Alias tables of the operator of all bounces, three channels: every bounce lags alike, and none is fed back.
    AllBounces,
}

/// Which rows are sampled; the others are multiplied by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sampled {
    /// Those from patch to patch.
    #[default]
    Patches,
    /// Those to elements and receivers, too.
    All,
}

/// Settings of temporal radiosity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TemporalSettings {
    /// Settings of a frame.
    pub settings: Settings,
    /// Storage of the rows.
    pub rows: RowKind,
    /// Which rows are sampled.
    pub sampled: Sampled,
}

/// Rows of form factors as lists, or as alias tables where `has_tables`.
///
/// # Errors
/// What the distributions refuse.
pub fn rows_of_factors(factors: &Csr, has_tables: bool) -> Result<Rows, Error> {
    let Csr { columns, row_start, column_index, values, .. } = factors;
    Ok(if has_tables {
        let tables = AliasTables::from_rows(*columns, row_start, column_index, values, Packing::Stacks)?;
        Rows::Tables(Arc::new(tables))
    } else {
        let lists = RayLists::from_rows(*columns, row_start, column_index, values, LIST_ENTRIES)?;
        Rows::Lists(Arc::new(lists))
    })
}

/// Rows of an operator between patches as alias tables with colours.
///
/// # Errors
/// What the distributions refuse: more than 65,535 entries in a row.
fn rows_of_operator(operator: &PatchOperator) -> Result<Rows, Error> {
    let patches = operator.patches();
    let tables = AliasTables::from_rgb(patches, patches, Packing::Stacks, |i, row| operator.row(i, row))?;
    Ok(Rows::Tables(Arc::new(tables)))
}

/// Rows of counts of hits, as lists of these.
///
/// # Errors
/// What the distributions refuse.
pub fn rows_of_hits(rows: &HitCounts) -> Result<Rows, Error> {
    let lists = RayLists::from_counts(rows.columns(), rows.scales(), |i| rows.row(i))?;
    Ok(Rows::Lists(Arc::new(lists)))
}

/// Light that is sampled from frame to frame.
pub struct TemporalMethod {
    settings: Settings,
    /// From patch to patch; none where all bounces end at elements and receivers.
    patches: Option<Rows>,
    /// True if those are of all bounces.
    has_all_bounces: bool,
    elements: Option<Rows>,
    receivers: Option<Rows>,
    levels: Vec<Level>,
    /// Passes of the plan up to the last level.
    passes: usize,
    frame: u32,
    is_settled: bool,
}

/// Rows of one kind among the passes of a frame.
struct Level {
    /// The passes since the level before, which find what it samples.
    before: ops::Range<usize>,
    sampled: SampledPasses,
    /// Number of bounces summed before the first frame.
    bounces: u32,
    all: Vec<PassId>,
}

impl TemporalMethod {
    /// Makes the rows into distributions.
    ///
    /// # Errors
    /// Settings out of their range, rows that cannot be sampled.
    pub fn new(
        settings: &TemporalSettings,
        with: &Preparation,
        device: &mut (dyn Executor + 'static),
    ) -> Result<Self, Error> {
        settings.settings.check()?;
        let key = OperatorKey::of(&MethodSettings::Temporal(*settings), &with.bake.settings);
        let key = key.filter(|_| !with.bake.mesh.patches.is_empty());
        let operator = key.map(|key| key.find_or_build(with, device)).transpose()?;
        run_phase(with.observer, Phase::TABLES, |_| Self::of(settings, with.bake, operator.as_ref()))
    }

    fn of(settings: &TemporalSettings, bake: &Bake, operator: Option<&PatchOperator>) -> Result<Self, Error> {
        let has_tables = settings.rows != RowKind::Lists;
        let by_patches = bake.settings.receivers == ReceiverKind::Patches;
        let last = if by_patches { 0 } else { LAST_BOUNCES };
        let factors = &bake.form_factors.factors;
        let mut method = Self {
            settings: settings.settings,
            patches: None,
            has_all_bounces: settings.rows == RowKind::AllBounces,
            elements: None,
            receivers: None,
            levels: Vec::new(),
            passes: 0,
            frame: 0,
            is_settled: false,
        };
        // Where the bake says no number of bounces, there may be more with another albedo.
        let needs_patches = bake.bounces > last || bake.settings.bounces.is_none();
        method.patches = match (operator, settings.rows) {
            (Some(operator), _) => Some(rows_of_operator(operator)?),
            (None, RowKind::AllBounces) => None,
            (None, _) => needs_patches.then(|| rows_of_factors(factors, has_tables)).transpose()?,
        };
        // Elements that no light comes to from others, and receivers that are not there, are left as they are.
        let all = settings.sampled == Sampled::All;
        if all && bake.bounces > 1 && !by_patches {
            method.elements = Some(match &bake.form_factors.element_rows {
                Some(rows) => rows_of_hits(rows)?,
                None => rows_of_factors(factors, has_tables)?,
            });
        }
        if all && !bake.receivers.points.is_empty() {
            method.receivers = Some(rows_of_hits(&bake.receivers.rows)?);
        }
        Ok(method)
    }

    fn add_level(
        &mut self,
        frame: &mut FramePlan,
        pass: &str,
        rows: &Rows,
        light: Light,
        bounces: u32,
    ) -> Result<(), Error> {
        let before = self.passes..frame.plan.passes().len();
        let level = SampledRows {
            pass,
            rows,
            settings: self.settings,
            source: light.source,
            albedo: light.albedo,
            reflected: light.reflected,
            irradiance: light.irradiance,
        };
        let range = frame.binding_bytes();
        let sampled = SampledPasses::new(&mut frame.plan, &mut frame.tables, &level, range)?;
        let all = passes_so_far(frame);
        self.levels.push(Level { before, sampled, bounces, all });
        self.passes = frame.plan.passes().len();
        Ok(())
    }
}

/// Lighting and the bake that is lit.
struct Light {
    source: Slice<Rgb>,
    albedo: Slice<Rgb>,
    reflected: Slice<Rgb>,
    irradiance: Slice<Rgb>,
}

impl Method for TemporalMethod {
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<(), Error> {
        self.levels.clear();
        // Those of the first exitance have run before the first frame of the method.
        self.passes = frame.plan.passes().len();
        self.frame = 0;
        self.is_settled = false;
        let Some(rows) = self.patches.clone() else { return Ok(frame.start_from_source()?) };
        // What reflects all bounces already is fed nothing back.
        let (reflected, bounces) = match self.has_all_bounces {
            true => (frame.zeros, 1),
            false => (frame.patches.irradiance, frame.patch_bounces()),
        };
        let light = Light {
            source: frame.patches.source,
            albedo: frame.patches.albedo,
            reflected,
            irradiance: frame.patches.irradiance,
        };
        self.add_level(frame, "method", &rows, light, bounces)?;
        frame.bounce()?;
        Ok(())
    }

    fn add_element_passes(&mut self, frame: &mut FramePlan, exitance: Slice<Rgb>) -> Result<bool, Error> {
        let Some(rows) = self.elements.clone() else { return Ok(false) };
        // What is only passed on is reflected from nothing.
        let light = Light {
            source: exitance,
            albedo: frame.elements.albedo,
            reflected: frame.zeros,
            irradiance: frame.elements.irradiance,
        };
        self.add_level(frame, "lookup", &rows, light, 1)?;
        Ok(true)
    }

    fn add_receiver_passes(&mut self, frame: &mut FramePlan) -> Result<bool, Error> {
        let Some(rows) = self.receivers.clone() else { return Ok(false) };
        let light = Light {
            source: frame.elements.exitance,
            albedo: frame.elements.albedo,
            reflected: frame.zeros,
            irradiance: frame.received,
        };
        self.add_level(frame, "lookup", &rows, light, 1)?;
        Ok(true)
    }

    fn start(&mut self, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        for level in &self.levels {
            level.sampled.clear(executor)?;
        }
        Ok(())
    }

    fn before_frame(&mut self, _: &FrameInput, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        if !self.is_settled {
            // Before the first frame all rows are summed.
            self.is_settled = true;
            for level in &self.levels {
                executor.submit_passes(&level.all[level.before.clone()])?;
                for _ in 0..level.bounces {
                    level.sampled.settle(executor)?;
                }
            }
        }
        for level in &self.levels {
            level.sampled.set_frame(executor, self.frame)?;
        }
        self.frame = self.frame.wrapping_add(1);
        Ok(())
    }

    fn set_albedo(&mut self, _: &Albedo, _: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        match self.has_all_bounces && self.patches.is_some() {
            true => Err(Reason::AlbedoHeld { method: "temporal with the rows of all bounces" }.into()),
            false => Ok(()),
        }
    }

    fn report(&self) -> MethodReport {
        let parts = [("tables", &self.patches), ("elements", &self.elements), ("receivers", &self.receivers)];
        let parts = parts.into_iter().filter_map(|(name, rows)| Some((name, rows.as_ref()?)));
        let bytes = parts.map(|(name, rows)| (name.to_owned(), rows.distribution().bytes())).collect();
        MethodReport { bytes, ..MethodReport::default() }
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}
