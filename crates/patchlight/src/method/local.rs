//! All bounces in one product with the matrix of the patches round the camera, which is kept exact while they come and
//! go.

use ::localmatrix::{CameraFrame, CameraMatrix, CameraSettings, Surface, Table};
use formfactor::{Reciprocal, reciprocal};
use runtime::executor::{Executor, PassTime};
use runtime::plan::{PassId, Slice};
use runtime::recipe::localmatrix::MatrixCopy;
use scene::Rgb;
use transport::Phase;
use web_time::Instant;

use super::{Method, MethodReport, Preparation};
use crate::albedo::Albedo;
use crate::error::{Error, Reason};
use crate::low_level::frame::{FrameInput, FramePlan};
use crate::observe::run_phase;

/// Albedo of the surface whose displayed value tells how much frames differ.
pub const SHOWN_ALBEDO: f32 = 0.5;

/// Display white: irradiance with which that surface is displayed as white, W/m², when radiance is multiplied by 2 to
/// the power of the exposure.
pub fn display_white(exposure_stops: f32) -> f32 {
    std::f32::consts::PI / (SHOWN_ALBEDO * scene::math::pow(2.0, exposure_stops))
}

/// The matrix round a camera between the stages of a frame.
pub struct Local {
    matrix: CameraMatrix,
    world_bytes: u64,
    passes: Option<Passes>,
    /// The exitance of the patches from the irradiance that the matrix gives.
    bounce: Option<PassId>,
}

/// Product with the matrix: by the host itself where that runs the kernels, else by a copy on the device.
enum Passes {
    Host { source: Slice<Rgb>, irradiance: Slice<Rgb> },
    Device(Box<MatrixCopy>),
}

impl Local {
    /// Makes the world of the patches of a bake, and the matrix for a camera.
    ///
    /// # Errors
    /// Settings out of their range; cancellation.
    pub fn new(settings: &CameraSettings, with: &Preparation) -> Result<Self, Error> {
        run_phase(with.observer, Phase::OPERATOR, |report| {
            let world = world_of(with)?;
            let world_bytes = world.bytes();
            let order = world.order().to_vec();
            let report_share = |share: f32| report((share * 1000.0) as usize, 1000).is_continue();
            let matrix = CameraMatrix::new(Box::new(world), order, settings, with.eye, &report_share)?;
            Ok(Self { matrix, world_bytes, passes: None, bounce: None })
        })
    }
}

impl Local {
    /// Changes of the matrix in the last frame.
    pub fn last_frame(&self) -> &CameraFrame {
        self.matrix.last()
    }
}

/// The patches of a bake as a world of the local matrix.
fn world_of(with: &Preparation) -> Result<Table, Error> {
    let mesh = &with.bake.mesh;
    let Reciprocal { factors, area, .. } = reciprocal(&with.bake.form_factors.factors, &mesh.areas())?;
    let mut surfaces = Vec::with_capacity(mesh.patches.len());
    for ((patch, albedo), &area) in mesh.patches.iter().zip(&mesh.albedo).zip(&area) {
        let albedo = albedo.truncate();
        surfaces.push(Surface { centre: patch.centroid, normal: patch.normal, area, albedo });
    }
    Ok(Table::new(&surfaces, factors)?)
}

impl Method for Local {
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<(), Error> {
        frame.start_from_source()?;
        let source = frame.patches.source;
        let irradiance = frame.patches.irradiance;
        let on_device = frame.device.index.is_some() || frame.device.kind != runtime::executor::DeviceKind::Native;
        self.passes = Some(if on_device {
            let copy = MatrixCopy::new(&mut frame.plan, &mut frame.tables, &self.matrix, source, irradiance)?;
            Passes::Device(Box::new(copy))
        } else {
            Passes::Host { source, irradiance }
        });
        self.bounce = Some(frame.bounce()?);
        Ok(())
    }

    fn set_albedo(&mut self, _: &Albedo, _: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        Err(Reason::AlbedoHeld { method: "local" }.into())
    }

    fn before_frame(&mut self, input: &FrameInput, _: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        self.matrix.move_camera(input.eye);
        Ok(())
    }

    fn submit(&mut self, executor: &mut (dyn Executor + 'static)) -> Option<Result<Vec<PassTime>, Error>> {
        let passes = self.passes.as_mut()?;
        let times = match passes {
            Passes::Device(copy) => submit_on_device(copy, &mut self.matrix, executor),
            Passes::Host { source, irradiance } => submit_on_host(&mut self.matrix, *source, *irradiance, executor),
        };
        let bounce = self.bounce;
        Some(times.and_then(|times| {
            executor.submit_passes(bounce.as_slice())?;
            Ok(times)
        }))
    }

    /// Counts the lit patches where a device has them.
    fn count(&mut self, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        if let Some(Passes::Device(copy)) = &self.passes {
            self.matrix.set_lit(copy.lit(executor)?);
        }
        Ok(())
    }

    fn report(&self) -> MethodReport {
        let mut bytes: std::collections::BTreeMap<String, u64> = self.matrix.bytes().into_iter().collect();
        bytes.insert("local world".to_owned(), self.world_bytes);
        MethodReport { bytes, ..MethodReport::default() }
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

/// A device multiplies by its copy of the matrix.
fn submit_on_device(
    copy: &mut MatrixCopy,
    matrix: &mut CameraMatrix,
    executor: &mut (dyn Executor + 'static),
) -> Result<Vec<PassTime>, Error> {
    let milliseconds = copy.frame(executor, matrix)?;
    Ok(vec![PassTime::of_host("update", milliseconds)])
}

/// Native code multiplies by the host's own matrix.
fn submit_on_host(
    matrix: &mut CameraMatrix,
    source: Slice<Rgb>,
    irradiance: Slice<Rgb>,
    executor: &mut (dyn Executor + 'static),
) -> Result<Vec<PassTime>, Error> {
    let exitance = executor.download_table(source)?;
    let start = Instant::now();
    let frame = matrix.irradiance(&exitance, &|| start.elapsed().as_secs_f64() * 1e3)?;
    executor.upload(irradiance, &frame.irradiance)?;
    Ok(vec![PassTime::of_host("update", frame.update_ms), PassTime::of_host("method", frame.product_ms)])
}
