//! Photons emitted from first-lit surfaces: illumination maps on all triangles, and from them the irradiance of elements and
//! patches.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use ::firstshot::{
    Emission, Estimate, IlluminationMaps, LightElementSettings, PhotonAccumulator, PhotonSettings, Proceed, Round,
    Texels, Tracer,
};
use glam::{Vec2, Vec3, Vec4};
use patches::PatchMesh;
use rayon::prelude::*;
use runtime::executor::{DeviceChoice, Executor, open};
use runtime::recipe::firstshot::PhotonPasses;
use scene::kernel::bvh::FAR;
use scene::kernel::camera::surface_point;
use scene::kernel::light::direct_irradiance;
use scene::sampling::{cosine_hemisphere, hammersley, hash3};
use scene::{DirectParams, Hit, Lighting, NONE, Scene, SurfacePoint};
use transport::{Observer, Patch, Phase, Silent};

use super::{Method, MethodReport, Preparation, bytes};
use crate::albedo::Albedo;
use crate::bake::{Bake, ReceiverKind, direct_params};
use crate::error::Error;
use crate::frame::{FrameInput, FramePlan};
use crate::observe::run_phase;

/// Rays of a point whose light is gathered exactly.
const POINT_RAYS: u32 = 4096;

/// How much is traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstShotSettings {
    /// Relative error of the irradiance of the patches.
    pub error: f64,
    /// Most photons.
    pub most_photons: u64,
}

impl Default for FirstShotSettings {
    /// 5 %, at most 2²⁶ photons.
    fn default() -> Self {
        Self { error: 0.05, most_photons: PhotonSettings::default().most_photons }
    }
}

/// Illumination maps whose cells belong to elements and patches.
pub struct PatchMaps {
    /// The maps.
    pub maps: IlluminationMaps,
    /// Element of each cell, or [`NONE`].
    elements: Vec<u32>,
    /// Patch of each cell, or [`NONE`].
    patches: Vec<u32>,
}

impl PhotonAccumulator for PatchMaps {
    fn areas(&self) -> &[f32] {
        self.maps.areas()
    }

    fn cell(&self, triangle: u32, u: f32, v: f32, is_back: bool) -> u32 {
        self.maps.cell(triangle, u, v, is_back)
    }

    fn groups(&self) -> &[u32] {
        &self.patches
    }
}

impl PatchMaps {
    /// Maps as fine as elements are looked up.
    ///
    /// # Errors
    /// More cells than there may be.
    pub fn new(scene: &Scene, mesh: &PatchMesh) -> Result<Self, Error> {
        let maps = IlluminationMaps::with_divisions(scene, &mesh.divisions())?;
        let sides = (0..scene.geometry.triangles.len() as u32)
            .into_par_iter()
            .flat_map_iter(|triangle| [(triangle, false), (triangle, true)]);
        let elements: Vec<u32> =
            sides.flat_map_iter(|(triangle, is_back)| element_of_cells(&maps, mesh, triangle, is_back)).collect();
        let patches = elements.iter().map(|&element| mesh.patch_of(element)).collect();
        Ok(Self { maps, elements, patches })
    }

    /// Mean of the cells of each of `count` owners, W/m²; 0 where none is owned.
    fn means(&self, owner: &[u32], count: usize, irradiance: &[Vec3]) -> Vec<Vec4> {
        let mut sums = vec![Vec4::ZERO; count];
        for ((&owner, light), &area) in owner.iter().zip(irradiance).zip(self.areas()) {
            if let Some(sum) = sums.get_mut(owner as usize) {
                *sum += (*light * area).extend(area);
            }
        }
        sums.into_iter().map(|s| if s.w > 0.0 { (s.truncate() / s.w).extend(0.0) } else { Vec4::ZERO }).collect()
    }
}

/// The element in the middle of each cell of a side of a triangle.
fn element_of_cells(maps: &IlluminationMaps, mesh: &PatchMesh, triangle: u32, is_back: bool) -> Vec<u32> {
    let element = |(_, [a, b, c]): (u32, [Vec2; 3])| {
        let middle = (a + b + c) / 3.0;
        mesh.element_on_side(&Hit { triangle, u: middle.x, v: middle.y, t: 0.0 }, !is_back)
    };
    maps.cells(triangle, is_back).map(element).collect()
}

/// Irradiance of a patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchLight {
    /// The patch.
    pub patch: Patch,
    /// Indirect irradiance, W/m².
    pub irradiance: Vec3,
    /// Standard error of its luminance, W/m².
    pub error: f32,
}

/// Photons of a scene and where they have hit.
pub struct FirstShot {
    maps: PatchMaps,
    settings: FirstShotSettings,
    seed: u32,
    /// What shone in the last run.
    lighting: Option<Lighting>,
    estimate: Estimate,
    /// Kernels on a device; without, the host's own hierarchy is faster.
    passes: Option<PhotonPasses>,
    element_bytes: u64,
}

impl FirstShot {
    /// Nothing traced yet. With `executor`, its device traces.
    ///
    /// # Errors
    /// More cells than there may be.
    pub fn new(
        scene: &Scene,
        mesh: &PatchMesh,
        settings: FirstShotSettings,
        seed: u32,
        executor: Option<Box<dyn Executor>>,
    ) -> Result<Self, Error> {
        Ok(Self {
            maps: PatchMaps::new(scene, mesh)?,
            settings,
            seed,
            lighting: None,
            estimate: Estimate::default(),
            passes: executor.map(PhotonPasses::new),
            element_bytes: 0,
        })
    }

    /// Traces for what shines in the scene, unless it is that of the last run.
    ///
    /// # Errors
    /// [`Error::Cancelled`], what the device says.
    pub fn solve(&mut self, scene: &Scene, observer: &dyn Observer) -> Result<(), Error> {
        if self.lighting.as_ref() == Some(&scene.lighting) {
            return Ok(());
        }
        run_phase(observer, Phase::PHOTONS, |report| self.trace(scene, report))
    }

    fn trace(&mut self, scene: &Scene, report: &(dyn Fn(usize, usize) -> Proceed + Sync)) -> Result<(), Error> {
        // The adaptive light elements are a small part of the work.
        let elements = |done: usize, total: usize| report(done, 10 * total);
        let emission = Emission::first_shot(scene, &LightElementSettings::default(), Texels::Mean, true, &elements)?;
        self.element_bytes = emission.bytes();
        let settings = PhotonSettings {
            error: self.settings.error,
            most_photons: self.settings.most_photons,
            seed: self.seed,
            ..PhotonSettings::default()
        };
        let mut tracer = Tracer::new(scene, &emission, &self.maps, settings)?;
        let progress = |round: &Round| report(per_mille_done(round, &settings), 1000);
        let finished = match &mut self.passes {
            Some(passes) => {
                passes.load(scene, &emission)?;
                tracer.run_with(&progress, |p| passes.trace(p).map_err(Error::from))?
            }
            None => tracer.run(&progress)?,
        };
        if !finished {
            return Err(Error::Cancelled);
        }
        self.estimate = tracer.estimate();
        self.lighting = Some(scene.lighting.clone());
        Ok(())
    }

    /// Indirect irradiance of the elements, W/m².
    pub fn element_irradiance(&self, mesh: &PatchMesh) -> Vec<Vec4> {
        self.maps.means(&self.maps.elements, mesh.elements.len(), &self.estimate.irradiance)
    }

    /// Indirect irradiance of the patches, W/m².
    pub fn patch_light(&self, mesh: &PatchMesh) -> Vec<PatchLight> {
        let means = self.maps.means(&self.maps.patches, mesh.patches.len(), &self.estimate.irradiance);
        let mut light = Vec::with_capacity(means.len());
        for (k, (patch, mean)) in mesh.patches.iter().zip(means).enumerate() {
            let error = self.estimate.error.get(k).copied().unwrap_or(0.0);
            light.push(PatchLight { patch: *patch, irradiance: mean.truncate(), error });
        }
        light
    }

    /// What was traced, and its error.
    pub fn round(&self) -> Round {
        self.estimate.round
    }

    /// The illumination maps, and the irradiance of their cells.
    pub fn cells(&self) -> (&IlluminationMaps, &Estimate) {
        (&self.maps.maps, &self.estimate)
    }

    /// Bytes of the maps and of the light elements.
    pub fn bytes(&self) -> [(&'static str, u64); 2] {
        // Flux, area, element, patch.
        let cell = (size_of::<[f32; 3]>() + size_of::<f32>() + 2 * size_of::<u32>()) as u64;
        [("maps", self.maps.maps.len() as u64 * cell), ("light elements", self.element_bytes)]
    }

    /// Indirect irradiance at points, W/m²: the mean over rays of `ρ (H_d + H)` at what they meet, H of the illumination maps,
    /// H_d by shadow rays.
    pub fn irradiance_at(&self, scene: &Scene, points: &[SurfacePoint], seed: u32) -> Vec<Vec3> {
        let maps = &self.maps;
        let estimate = &self.estimate;
        let light = |(index, point): (usize, &SurfacePoint)| gather(maps, estimate, scene, index as u32, point, seed);
        points.par_iter().enumerate().map(light).collect()
    }
}

/// Indirect irradiance at a point, W/m²: see [`FirstShot::irradiance_at`].
fn gather(maps: &PatchMaps, estimate: &Estimate, scene: &Scene, index: u32, point: &SurfacePoint, seed: u32) -> Vec3 {
    let tables = scene.tables();
    let lights = scene.all_lights();
    let occluded = |origin: Vec3, direction: Vec3, t_max: f32| scene.occluded(origin, direction, t_max);
    let direct = DirectParams { area_rays: 1, sky_rays: u32::from(scene.has_sky()), seed, ..direct_params(scene) };
    let shift = (hash3(index, 0, seed), hash3(index, 1, seed));
    let origin = point.position + point.normal * scene.geometry.ray_offset;
    let mut sum = Vec3::ZERO;
    for k in 0..POINT_RAYS {
        let direction = cosine_hemisphere(point.normal, hammersley(k, POINT_RAYS, shift));
        let hit = scene.closest_before(origin, direction, FAR);
        if hit.triangle == NONE {
            continue;
        }
        let there = surface_point(&tables, hit, direction);
        let number = hash3(index, k, seed);
        let first = direct_irradiance(&tables, &direct, number, there, &lights, occluded);
        let is_back = tables.normal(hit.triangle).dot(direction) > 0.0;
        let cell = maps.cell(hit.triangle, hit.u, hit.v, is_back);
        let more = estimate.irradiance.get(cell as usize).copied().unwrap_or(Vec3::ZERO);
        sum += tables.albedo(hit.triangle, hit.u, hit.v) * (first + more);
    }
    sum / POINT_RAYS as f32
}

/// How much of the photons is done, of 1,000: what the error or the greatest number allows.
fn per_mille_done(round: &Round, settings: &PhotonSettings) -> usize {
    let by_error = (settings.error / round.error).powi(2);
    let by_count = round.photons as f64 / settings.most_photons as f64;
    (1000.0 * (0.1 + 0.9 * by_error.max(by_count).min(1.0))) as usize
}

/// Photons in place of products: they give the irradiance of the elements.
pub struct FirstShotMethod {
    bake: Arc<Bake>,
    shot: FirstShot,
    scene: Scene,
    irradiance: Option<runtime::plan::BufferId>,
    host_ms: f64,
}

impl FirstShotMethod {
    /// Lays out the maps and traces for the lights of the bake.
    ///
    /// # Errors
    /// Patches as receivers, which photons do not serve; cancellation.
    pub fn new(
        settings: &FirstShotSettings,
        with: &Preparation,
        device: &mut (dyn Executor + 'static),
    ) -> Result<Self, Error> {
        let bake = Arc::clone(with.bake);
        if bake.settings.receivers == ReceiverKind::Patches {
            return Err(Error::FirstShotReceivers);
        }
        let tracing = same_device(device)?;
        let mut shot = run_phase(with.observer, Phase::MAPS, |_| {
            FirstShot::new(&bake.scene, &bake.mesh, *settings, bake.settings.seed, tracing)
        })?;
        shot.solve(&bake.scene, with.observer)?;
        let round = shot.round();
        with.observer.note(&format!(
            "{} photons, {} registered, relative error {:.2} %",
            round.photons,
            round.registered,
            100.0 * round.error
        ));
        let scene = bake.scene.clone();
        Ok(Self { bake, shot, scene, irradiance: None, host_ms: 0.0 })
    }

    /// The photons.
    pub fn shot(&self) -> &FirstShot {
        &self.shot
    }
}

/// The same device once more, for tables of its own; nothing for native code and for a caller's device.
fn same_device(executor: &dyn Executor) -> Result<Option<Box<dyn Executor>>, Error> {
    match executor.device().index {
        Some(index) => Ok(Some(open(&DeviceChoice::Index(index))?.0)),
        None => Ok(None),
    }
}

impl Method for FirstShotMethod {
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<(), Error> {
        self.irradiance = Some(frame.elements.irradiance.buffer);
        Ok(frame.start_from_source()?)
    }

    fn set_albedo(&mut self, albedo: &Albedo, _: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        albedo.give_to(&mut self.scene);
        self.shot.lighting = None;
        Ok(())
    }

    fn finds_element_irradiance(&self) -> bool {
        true
    }

    fn before_frame(&mut self, input: &FrameInput, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        let start = Instant::now();
        self.scene.set_lighting(input.lighting.clone())?;
        self.shot.solve(&self.scene, &Silent)?;
        self.host_ms = start.elapsed().as_secs_f64() * 1e3;
        if let Some(buffer) = self.irradiance {
            executor.upload(buffer, &self.shot.element_irradiance(&self.bake.mesh))?;
        }
        Ok(())
    }

    fn report(&self) -> MethodReport {
        MethodReport {
            bytes: bytes(self.shot.bytes()),
            host_ms: self.host_ms,
            photons: Some(self.shot.round()),
            ..MethodReport::default()
        }
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

/// Whether the work goes on; for callers that tell nobody.
pub(crate) fn go_on(_: usize, _: usize) -> Proceed {
    ControlFlow::Continue(())
}
