//! Recipes of `patches`: values of patches, and of probe volumes, at any points.

use std::sync::Arc;

use gpu_kernels::table;
use patches::{Lookup, LookupParams, VolumeParams};

use super::{Bindings, Named, Tables, add_pass};
use crate::executor::ExecutorError;
use crate::plan::{PassId, Plan};

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

/// Adds the pass of irradiance from the ambient cubes of a probe volume round each point, W/m².
///
/// # Errors
/// Buffers that are missing or too short.
pub fn ambient_cubes(
    plan: &mut Plan,
    pass: &str,
    bindings: Bindings,
    params: &VolumeParams,
) -> Result<PassId, ExecutorError> {
    add_pass(plan, pass, &table::PATCHES_VOLUME_LOOKUP, bindings, &[], params, params.count)
}

/// Adds the pass of irradiance from the spherical harmonics of a probe volume round each point, W/m².
///
/// # Errors
/// Buffers that are missing or too short.
pub fn spherical_harmonics(
    plan: &mut Plan,
    pass: &str,
    bindings: Bindings,
    params: &VolumeParams,
) -> Result<PassId, ExecutorError> {
    add_pass(plan, pass, &table::PATCHES_VOLUME_LOOKUP_SH, bindings, &[], params, params.count)
}
