//! All bounces in one product with the operator `T = F (I − diag(ρ) F)⁻¹`: `H = T E`.

use runtime::executor::Executor;
use runtime::recipe::multibounce::Decoder;
use transport::LinearOperator as _;

use super::classic::Classic;
use super::{Method, MethodReport, MethodSettings, Preparation, bytes};
use crate::albedo::Albedo;
use crate::error::{Error, Reason};
use crate::low_level::frame::FramePlan;
use crate::low_level::operator::{Codec, OperatorKey, PatchOperator};

/// All bounces in one product.
pub struct Multibounce {
    codec: Codec,
    operator: PatchOperator,
    decoder: Option<Decoder>,
}

/// Builds the operator, or takes classic radiosity where there are so few bounces that patches need none.
///
/// # Errors
/// An operator that does not fit into memory, blocks that the device cannot decode, cancellation.
pub fn prepare(
    codec: Codec,
    with: &Preparation,
    device: &mut (dyn Executor + 'static),
) -> Result<Box<dyn Method>, Error> {
    let key = OperatorKey::of(&MethodSettings::Multibounce(codec), &with.bake.settings);
    let Some(key) = key.filter(|_| !with.bake.mesh.patches.is_empty()) else {
        return Ok(Box::new(Classic::new(with.bake)));
    };
    let operator = key.find_or_build(with, device)?;
    let decoder = operator.decoder(with.decode, device.device())?;
    Ok(Box::new(Multibounce { codec, operator, decoder }))
}

impl Multibounce {
    /// Decoder of the operator, where it is in texture blocks.
    pub fn decoder(&self) -> Option<Decoder> {
        self.decoder
    }

    /// The operator.
    pub fn operator(&self) -> &PatchOperator {
        &self.operator
    }
}

impl Method for Multibounce {
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<(), Error> {
        frame.start_from_source()?;
        let range = frame.binding_bytes();
        let decoder = self.decoder.unwrap_or(Decoder::Kernel);
        let tables = self.operator.add_tables(&mut frame.plan, &mut frame.tables, range, decoder);
        let exitance = frame.patches.exitance;
        let irradiance = frame.patches.irradiance;
        tables.product(&mut frame.plan, "method", range, exitance, irradiance)?;
        frame.bounce()?;
        Ok(())
    }

    fn depends_on_source_alone(&self) -> bool {
        true
    }

    fn set_albedo(&mut self, _: &Albedo, _: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        let is_tiles = matches!(self.codec, Codec::LowRank { .. });
        Err(Reason::AlbedoHeld { method: if is_tiles { "low_rank" } else { "multibounce" } }.into())
    }

    fn report(&self) -> MethodReport {
        let operator: u64 = self.operator.bytes();
        MethodReport { bytes: bytes([("operator", operator)]), ..MethodReport::default() }
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}
