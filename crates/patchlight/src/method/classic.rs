//! Classic radiosity: one product with the sparse form factors for each bounce, `H = F B`, `B = E + ρ∘H`.

use std::sync::Arc;

use runtime::executor::Executor;
use runtime::recipe::formfactor::SparseTables;

use super::{Method, MethodReport, bytes};
use crate::albedo::Albedo;
use crate::bake::Bake;
use crate::error::Error;
use crate::low_level::frame::FramePlan;

/// Bounces by the form factors themselves.
pub struct Classic {
    bytes: u64,
}

impl Classic {
    /// For the form factors of a bake.
    pub fn new(bake: &Arc<Bake>) -> Self {
        Self { bytes: bake.form_factors.factor_bytes() }
    }
}

impl Method for Classic {
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<(), Error> {
        frame.start_from_source()?;
        let bounces = frame.patch_bounces();
        if bounces == 0 {
            return Ok(());
        }
        let factors = &frame.bake.form_factors.factors;
        let rows = SparseTables::new(&mut frame.plan, &mut frame.tables, "patch", factors);
        for _ in 0..bounces {
            rows.gather(&mut frame.plan, "method", frame.patches.exitance, frame.patches.irradiance)?;
            frame.bounce()?;
        }
        Ok(())
    }

    fn set_albedo(&mut self, _: &Albedo, _: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        Ok(())
    }

    fn depends_on_source_alone(&self) -> bool {
        true
    }

    fn report(&self) -> MethodReport {
        MethodReport { bytes: bytes([("form_factors", self.bytes)]), ..MethodReport::default() }
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}
