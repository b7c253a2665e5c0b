//! Classic radiosity: one product with the sparse form factors for each bounce, `H = F B`, `B = E + ρ∘H`. Where all
//! bounces are asked for, they are those of Chebyshev's iteration, of which fewer leave as little.

use std::sync::Arc;

use multibounce::Acceleration;
use runtime::executor::Executor;
use runtime::plan::Slice;
use runtime::recipe::formfactor::SparseTables;
use runtime::recipe::multibounce::accelerated_bounce;
use scene::Rgb;
use scene::math::{exp_minus, ln};

use super::{Method, MethodReport, bytes};
use crate::albedo::Albedo;
use crate::bake::{Bake, MAX_BOUNCES, TOLERANCE};
use crate::error::Error;
use crate::low_level::frame::{FramePlan, zeros};

/// What Chebyshev's steps leave: less than the tolerance, since in rooms behind rooms they leave a greater share than in
/// the first, by powers of their number.
const LEFT: f32 = 0.1 * TOLERANCE;

/// Bounces by the form factors themselves.
pub struct Classic {
    bytes: u64,
    /// The last change of exitance, and the number of patches.
    change: Option<(Slice<Rgb>, usize)>,
}

impl Classic {
    /// For the form factors of a bake.
    pub fn new(bake: &Arc<Bake>) -> Self {
        Self { bytes: bake.form_factors.factor_bytes(), change: None }
    }
}

impl Method for Classic {
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<(), Error> {
        frame.start_from_source()?;
        self.change = None;
        let bounces = frame.patch_bounces();
        if bounces == 0 {
            return Ok(());
        }
        let steps = match frame.bake.settings.bounces {
            Some(_) => None,
            None => Some(accelerated(frame.bounces)?),
        };
        let factors = &frame.bake.form_factors.factors;
        let rows = SparseTables::new(&mut frame.plan, &mut frame.tables, "patch", factors);
        let Some(steps) = steps.filter(|steps| steps.len() < bounces as usize) else {
            for _ in 0..bounces {
                rows.gather(&mut frame.plan, "method", frame.patches.exitance, frame.patches.irradiance)?;
                frame.bounce()?;
            }
            return Ok(());
        };
        let surfaces = frame.patches;
        let change = frame.plan.array("change", surfaces.count as usize);
        self.change = Some((change, surfaces.count as usize));
        for step in steps {
            rows.gather(&mut frame.plan, "method", surfaces.exitance, surfaces.irradiance)?;
            accelerated_bounce(&mut frame.plan, "method", &surfaces, change, &step)?;
        }
        Ok(())
    }

    fn start(&mut self, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        match self.change {
            Some((change, patches)) => Ok(executor.upload(change, &zeros(patches))?),
            None => Ok(()),
        }
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

/// Steps in the place of so many plain bounces, which leave the tolerance of bakes; more than that where a bake takes no
/// more of them.
fn accelerated(bounces: u32) -> Result<Vec<Acceleration>, Error> {
    let enough = if bounces < MAX_BOUNCES { bounces.max(1) } else { bounces + bounces / 2 };
    let radius = exp_minus(-ln(TOLERANCE) / enough as f32);
    Ok(Acceleration::until(radius, LEFT)?)
}
