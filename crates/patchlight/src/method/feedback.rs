//! Progressive radiosity: products with the compressed form factors, from the light of the frame before.

use multibounce::Acceleration;
use runtime::executor::Executor;
use runtime::plan::{PassId, Slice};
use runtime::recipe::multibounce::{Decoder, accelerated_bounce};
use scene::Rgb;
use transport::{LinearOperator as _, Phase};

use super::classic::Classic;
use super::{Method, MethodReport, MethodSettings, Preparation, bytes, passes_so_far};
use crate::albedo::Albedo;
use crate::error::Error;
use crate::low_level::frame::{FrameInput, FramePlan, zeros};
use crate::low_level::operator::{OperatorKey, PatchOperator, accelerations};
use crate::observe::run_phase;

/// Settings of light that bounces once a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedbackSettings {
    /// Relative Frobenius error of the form factors.
    pub epsilon: f64,
    /// Bounces in a frame.
    pub products: u32,
    /// Extrapolates the light in a bounce ([`Acceleration`]).
    pub accelerated: bool,
}

impl Default for FeedbackSettings {
    fn default() -> Self {
        Self { epsilon: 0.01, products: 1, accelerated: true }
    }
}

/// Bounces whose light stays from frame to frame.
pub struct Feedback {
    operator: PatchOperator,
    is_accelerated: bool,
    acceleration: Acceleration,
    products: u32,
    passes: Option<Passes>,
}

struct Passes {
    /// A frame's bounces.
    bounces: Vec<PassId>,
    /// Those of them that go by the acceleration.
    accelerated: Vec<PassId>,
    change: Slice<Rgb>,
    patches: usize,
    /// Frames after which nothing changes, when the lights do not.
    settling_frames: u32,
    is_settled: bool,
}

/// Compresses the form factors, or takes classic radiosity where there are so few bounces that patches need none.
///
/// # Errors
/// Form factors that cannot be compressed, cancellation.
pub fn prepare(
    settings: &FeedbackSettings,
    with: &Preparation,
    device: &mut (dyn Executor + 'static),
) -> Result<Box<dyn Method>, Error> {
    let bake = with.bake;
    let key = OperatorKey::of(&MethodSettings::Feedback(*settings), &bake.settings);
    let Some(key) = key.filter(|_| !bake.mesh.patches.is_empty()) else {
        return Ok(Box::new(Classic::new(bake)));
    };
    let operator = key.find_or_build(with, device)?;
    let [plain, fast] = run_phase(with.observer, Phase::FEEDBACK, |_| accelerations(&bake.mesh.albedo, &operator))?;
    with.observer.note(&format!(
        "of a change of light a bounce leaves {:.1} % to come, accelerated {:.1} %",
        100.0 * plain.rate,
        100.0 * fast.rate
    ));
    let is_accelerated = settings.accelerated;
    let acceleration = if is_accelerated { fast } else { plain };
    Ok(Box::new(Feedback { operator, is_accelerated, acceleration, products: settings.products, passes: None }))
}

impl Method for Feedback {
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<(), Error> {
        let before = passes_so_far(frame).len();
        let range = frame.binding_bytes();
        let tables = self.operator.add_tables(&mut frame.plan, &mut frame.tables, range, Decoder::Kernel);
        let patches = frame.patches.count as usize;
        let change = frame.plan.array("change", patches);
        let surfaces = frame.patches;
        let mut accelerated = Vec::new();
        for _ in 0..self.products {
            tables.product(&mut frame.plan, "method", range, surfaces.exitance, surfaces.irradiance)?;
            accelerated.push(accelerated_bounce(&mut frame.plan, "method", &surfaces, change, &self.acceleration)?);
        }
        let bounces = passes_so_far(frame).split_off(before);
        let settling_frames = frame.patch_bounces().div_ceil(self.products.max(1));
        self.passes = Some(Passes { bounces, accelerated, change, patches, settling_frames, is_settled: false });
        Ok(())
    }

    fn start(&mut self, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        if let Some(passes) = &self.passes {
            executor.upload(passes.change, &zeros(passes.patches))?;
        }
        Ok(())
    }

    fn before_frame(&mut self, _: &FrameInput, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        let Some(passes) = self.passes.as_mut().filter(|passes| !passes.is_settled) else { return Ok(()) };
        passes.is_settled = true;
        for _ in 0..passes.settling_frames {
            executor.submit_passes(&passes.bounces)?;
        }
        Ok(())
    }

    fn set_albedo(&mut self, albedo: &Albedo, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        let [plain, fast] = accelerations(&albedo.patches, &self.operator)?;
        self.acceleration = if self.is_accelerated { fast } else { plain };
        let Some(passes) = &self.passes else { return Ok(()) };
        let params = self.acceleration.params(passes.patches as u32);
        for &pass in &passes.accelerated {
            executor.push(pass, &params)?;
        }
        Ok(())
    }

    fn report(&self) -> MethodReport {
        let operator: u64 = self.operator.bytes();
        MethodReport { bytes: bytes([("operator", operator)]), ..MethodReport::default() }
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}
