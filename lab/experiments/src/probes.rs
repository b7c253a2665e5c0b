//! DDGI on a device: the light update of [`opponents::Ddgi`] as the passes of a plan.
//!
//! Probes are placed, moved and classified on the host, once, for geometry does not move; so are the few numbers of a
//! frame (the turn of its rays, its hysteresis). Rays, their light, blending and lookups are the device's: the same
//! bodies, and on lavapipe the same bits as on the host.

use std::sync::{Mutex, PoisonError};

use ddgi::{
    BlendParams, IRRADIANCE_TEXELS, LookupPoint, PointParams, Probe, RAY_WEIGHTS, TraceParams, VISIBILITY_TEXELS,
    WeightParams,
};
use glam::{Vec2, Vec3, Vec4};
use lab_kernels::ddgi::{BlendIrradiancePass, BlendVisibilityPass, LookupPass, TracePass, WeightsPass};
use opponents::{Ddgi, DdgiSettings, ProbeFrame, ViewedPoint};
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{PassId, Plan, Slice};
use runtime::recipe::Tables;
use runtime::recipe::scene::SceneTables;
use scene::{Light, Lighting, Rgb, Scene};

use crate::error::Error;

/// Points beside those in view that are looked up together.
const BATCH: usize = 1 << 16;

/// Probes on a device.
pub struct DeviceDdgi {
    /// Probe positions and the numbers of each frame; its own probes stay dark.
    host: Ddgi,
    /// Light sources; only the lights change.
    lighting: Lighting,
    scene: SceneTables,
    passes: ProbePasses,
    /// A lookup writes to the device, and changes nothing that is seen.
    executor: Mutex<Box<dyn Executor>>,
}

impl DeviceDdgi {
    /// Places the probes, and puts them on the device with the scene and the points in view; probes are dark.
    ///
    /// # Errors
    /// Settings out of range; what the device says.
    pub fn new(
        scene: &Scene,
        settings: DdgiSettings,
        mut executor: Box<dyn Executor>,
        view: &[ViewedPoint],
    ) -> Result<Self, Error> {
        let host = Ddgi::new(scene, settings)?;
        let lighting = scene.lighting.clone();
        let mut plan = Plan::new();
        let mut tables = Tables::new();
        let scene_tables = SceneTables::new(&mut plan, &mut tables, scene, lighting.lights.len());
        let passes = ProbePasses::add(&mut plan, &mut tables, &scene_tables, &host, view.len())?;
        executor.load(plan)?;
        tables.upload(executor.as_mut())?;
        scene_tables.set_distributions(executor.as_mut(), &lighting.distributions)?;
        scene_tables.set_sky_and_emission(executor.as_mut(), scene)?;
        passes.start(executor.as_mut(), view)?;
        Ok(Self { host, lighting, scene: scene_tables, passes, executor: Mutex::new(executor) })
    }

    /// A whole light update as that of [`Ddgi::update`], with these lights in place of the scene's, no more of them
    /// than the scene has; sky and emission are the scene's. Waits for it.
    ///
    /// # Errors
    /// More lights than there is room for, or luminaires without their distributions; what the device says.
    pub fn update(&mut self, lights: &[Light], number: u32) -> Result<(), Error> {
        let most = self.scene.light_capacity();
        if lights.len() > most {
            let value = lights.len() as f64;
            let rule = "no more than the scene of the probes has";
            return Err(reference::Error::Setting { name: "lights", value, rule }.into());
        }
        self.lighting.lights.clear();
        self.lighting.lights.extend_from_slice(lights);
        let frame = self.host.begin(&self.lighting, number)?;
        let executor = self.executor.get_mut().unwrap_or_else(PoisonError::into_inner).as_mut();
        self.scene.set_lights(executor, lights)?;
        Ok(self.passes.update(executor, &frame)?)
    }

    /// Indirect irradiance at points, W/m².
    ///
    /// # Errors
    /// What the device says.
    pub fn irradiance_at(&self, points: &[ViewedPoint]) -> Result<Vec<Vec3>, ExecutorError> {
        let mut executor = self.executor.lock().unwrap_or_else(PoisonError::into_inner);
        let mut found = Vec::with_capacity(points.len());
        for part in points.chunks(BATCH) {
            found.extend(self.passes.look_up(executor.as_mut(), part)?);
        }
        Ok(found)
    }

    /// Finds indirect irradiance at the points in view, which stays on the device; waits for it.
    ///
    /// # Errors
    /// What the device says.
    pub fn look_up_view(&self) -> Result<(), ExecutorError> {
        let mut executor = self.executor.lock().unwrap_or_else(PoisonError::into_inner);
        executor.run_passes(&[self.passes.view.pass])?;
        Ok(())
    }

    /// Probes and their positions.
    pub fn placed(&self) -> &Ddgi {
        &self.host
    }
}

/// The passes of probes, and the buffers that change.
struct ProbePasses {
    directions: Slice<Vec4>,
    probes: ProbeSlices,
    weights: PassId,
    trace: PassId,
    blend_irradiance: PassId,
    blend_visibility: PassId,
    view: PointLookup,
    any: PointLookup,
    point_params: PointParams,
}

/// Probes, and what they know.
#[derive(Clone, Copy)]
struct ProbeSlices {
    probes: Slice<Probe>,
    irradiance: Slice<Rgb>,
    visibility: Slice<Vec2>,
}

/// A pass that looks up points.
struct PointLookup {
    points: Slice<LookupPoint>,
    irradiance: Slice<Rgb>,
    pass: PassId,
}

impl ProbePasses {
    /// Adds the passes of a light update, and those of lookups at the points in view and at any others.
    fn add(
        plan: &mut Plan,
        tables: &mut Tables,
        scene: &SceneTables,
        host: &Ddgi,
        in_view: usize,
    ) -> Result<Self, ExecutorError> {
        let DdgiSettings { rays, exponent, .. } = *host.settings();
        let probes = host.probe_table();
        let count = probes.len() as u32;
        let directions = plan.array("directions", rays as usize);
        let probe_irradiance = plan.array("probe_irradiance", (count * IRRADIANCE_TEXELS) as usize);
        let probe_visibility = plan.array("probe_visibility", (count * VISIBILITY_TEXELS) as usize);
        let weights = plan.array("weights", (RAY_WEIGHTS * rays) as usize);
        let brought = plan.array("rays", (count * rays) as usize);
        let probes = tables.owned(plan, "probes", probes.to_vec());
        let slices = ProbeSlices { probes, irradiance: probe_irradiance, visibility: probe_visibility };
        let SceneTables { geometry, lights, .. } = *scene;
        let trace =
            TracePass { directions, probes, probe_irradiance, probe_visibility, geometry, lights, rays: brought };
        let irradiance = BlendIrradiancePass { probes, weights, rays: brought, probe_irradiance };
        let visibility = BlendVisibilityPass { probes, weights, rays: brought, probe_visibility };
        let weight_params = WeightParams { count: RAY_WEIGHTS * rays, rays, exponent };
        let trace_params = TraceParams { count: count * rays, rays, ..TraceParams::default() };
        let light_params = BlendParams { count: count * IRRADIANCE_TEXELS, rays, ..BlendParams::default() };
        let sight_params = BlendParams { count: count * VISIBILITY_TEXELS, ..light_params };
        let point_params = PointParams { count: 0, lookup: host.lookup_params(), ..PointParams::default() };
        Ok(Self {
            directions,
            probes: slices,
            weights: plan.add("weights", &WeightsPass { directions, weights }, &weight_params)?,
            trace: plan.add("trace", &trace, &trace_params)?,
            blend_irradiance: plan.add("blend irradiance", &irradiance, &light_params)?,
            blend_visibility: plan.add("blend visibility", &visibility, &sight_params)?,
            view: PointLookup::add(plan, slices, point_params, in_view)?,
            any: PointLookup::add(plan, slices, point_params, BATCH)?,
            point_params,
        })
    }

    /// Dark probes, and the points in view.
    fn start(&self, executor: &mut dyn Executor, view: &[ViewedPoint]) -> Result<(), ExecutorError> {
        executor.clear(self.probes.irradiance.buffer)?;
        executor.clear(self.probes.visibility.buffer)?;
        executor.upload(self.view.points, &lookup_points(view))
    }

    /// Makes a light update.
    fn update(&self, executor: &mut dyn Executor, frame: &ProbeFrame) -> Result<(), ExecutorError> {
        let directions: Vec<Vec4> = frame.directions.iter().map(|d| d.extend(0.0)).collect();
        executor.upload(self.directions, &directions)?;
        executor.push(self.trace, &frame.trace)?;
        executor.push(self.blend_irradiance, &frame.irradiance)?;
        executor.push(self.blend_visibility, &frame.visibility)?;
        executor.run_passes(&[self.weights, self.trace, self.blend_irradiance, self.blend_visibility])?;
        Ok(())
    }

    /// Irradiance at no more than [`BATCH`] points, W/m².
    fn look_up(&self, executor: &mut dyn Executor, points: &[ViewedPoint]) -> Result<Vec<Vec3>, ExecutorError> {
        let PointLookup { points: buffer, irradiance, pass } = self.any;
        let count = points.len() as u32;
        executor.upload_at(buffer.buffer, 0, bytemuck::cast_slice(&lookup_points(points)))?;
        executor.push(pass, &PointParams { count, ..self.point_params })?;
        executor.run_passes(&[pass])?;
        let found = executor.download_table(irradiance)?;
        Ok(found[..points.len()].iter().map(|h| h.truncate()).collect())
    }
}

impl PointLookup {
    /// Adds the pass for so many points.
    fn add(plan: &mut Plan, probes: ProbeSlices, params: PointParams, count: usize) -> Result<Self, ExecutorError> {
        let points = plan.array("points", count);
        let irradiance = plan.array("irradiance", count);
        let lookup = LookupPass {
            points,
            probes: probes.probes,
            probe_irradiance: probes.irradiance,
            probe_visibility: probes.visibility,
            irradiance,
        };
        let pass = plan.add("lookup", &lookup, &PointParams { count: count as u32, ..params })?;
        Ok(Self { points, irradiance, pass })
    }
}

fn lookup_points(points: &[ViewedPoint]) -> Vec<LookupPoint> {
    points.iter().map(LookupPoint::from).collect()
}
