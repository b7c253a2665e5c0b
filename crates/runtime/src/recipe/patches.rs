//! Recipes of `patches`: values of patches, and of probe volumes, at any points; weighted means of receivers.

use std::sync::Arc;

use gpu_kernels::table;
use patches::{Lookup, LookupParams, PackedWeights, WeightParams};

use super::formfactor::ViewRows;
use super::{Bindings, Named, Tables, add_pass};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{PassId, Plan, Range};

/// A lookup between patches on the device.
#[derive(Clone, Copy, Debug)]
pub struct LookupTables {
    named: [Named; 3],
    params: LookupParams,
}

impl LookupTables {
    /// Puts the lookup on the device.
    pub fn new(plan: &mut Plan, tables: &mut Tables, lookup: &Arc<Lookup>) -> Self {
        let named = [
            tables.named_part(plan, "cells", lookup, |l| &l.cells),
            tables.named_part(plan, "offsets", lookup, |l| &l.offsets),
            tables.named_part(plan, "entries", lookup, |l| &l.entries),
        ];
        Self { named, params: lookup.params }
    }

    /// Adds the pass of the mean of the patches about each point. Bindings: `values` (of the patches), `points`,
    /// `irradiance`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn at_points(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        points: u32,
    ) -> Result<PassId, ExecutorError> {
        let push = LookupParams { count: points, ..self.params };
        add_pass(plan, pass, &table::PATCHES_LOOKUP, bindings, &self.named, &push, points)
    }
}

/// Packed weights of receivers on the device.
#[derive(Clone, Copy, Debug)]
pub struct WeightTables {
    named: [Named; 4],
    params: WeightParams,
}

/// A pass over the rows that a view needs.
#[derive(Clone, Copy, Debug)]
pub struct WeightPass {
    /// The pass.
    pub pass: PassId,
    params: WeightParams,
}

impl WeightTables {
    /// Puts the weights on the device; `name` is for messages and the printed graph. Of the numbers that the passes
    /// bind as `received` the first are the irradiance of the four quadrants of each receiver, and from `first_value`
    /// on stand the values of the receivers, each the sum of `parts` numbers.
    pub fn new(
        plan: &mut Plan,
        tables: &mut Tables,
        name: &str,
        weights: &Arc<PackedWeights>,
        (first_value, parts): (usize, usize),
    ) -> Self {
        let named = [
            ("row_start", tables.part(plan, &format!("{name} starts"), weights, |weights| weights.row_start())),
            ("list_start", tables.part(plan, &format!("{name} list starts"), weights, |weights| weights.list_start())),
            ("lists", tables.part(plan, &format!("{name} lists"), weights, |weights| weights.lists())),
            ("entries", tables.part(plan, &format!("{name} entries"), weights, |weights| weights.entries())),
        ];
        let params = WeightParams {
            count: weights.rows() as u32,
            block_rows: weights.block_rows(),
            first_value: first_value as u32,
            parts: parts as u32,
            ..WeightParams::default()
        };
        Self { named, params }
    }

    /// Adds the pass of the weighted means of what was received.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn weigh(
        &self,
        plan: &mut Plan,
        pass: &str,
        received: impl Into<Range>,
        irradiance: impl Into<Range>,
    ) -> Result<PassId, ExecutorError> {
        let own = [("received", received.into()), ("irradiance", irradiance.into())];
        add_pass(plan, pass, &table::PATCHES_WEIGH, &own, &self.named, &self.params, self.params.count)
    }

    /// Adds the pass of those that a view needs.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn weigh_view(
        &self,
        plan: &mut Plan,
        pass: &str,
        received: impl Into<Range>,
        irradiance: impl Into<Range>,
        rows: ViewRows,
    ) -> Result<WeightPass, ExecutorError> {
        let own = [
            ("received", received.into()),
            ("irradiance", irradiance.into()),
            ("marks", rows.marks),
            ("computed", rows.computed),
        ];
        let params = self.params;
        let pass = add_pass(plan, pass, &table::PATCHES_WEIGH_VIEW, &own, &self.named, &params, params.count)?;
        Ok(WeightPass { pass, params })
    }

    /// Adds the pass that marks what the rows that a view needs take from.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn mark(
        &self,
        plan: &mut Plan,
        pass: &str,
        row_marks: impl Into<Range>,
        marks: impl Into<Range>,
    ) -> Result<WeightPass, ExecutorError> {
        let own = [("row_marks", row_marks.into()), ("marks", marks.into())];
        let params = self.params;
        let pass = add_pass(plan, pass, &table::PATCHES_MARK_RECEIVERS, &own, &self.named, &params, params.count)?;
        Ok(WeightPass { pass, params })
    }
}

impl WeightPass {
    /// Makes the pass ready for a view and a light.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(&self, executor: &mut (dyn Executor + 'static), view: u32, light: u32) -> Result<(), ExecutorError> {
        executor.push(self.pass, &WeightParams { view, light, ..self.params })
    }
}
