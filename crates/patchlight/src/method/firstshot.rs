//! Photons emitted from first-lit surfaces: illumination maps on all triangles, and from them the irradiance of
//! elements and patches.

use std::ops::ControlFlow;
use std::sync::Arc;

pub use ::firstshot::{Cubic, Sequences, Subdivision, Texels};
use ::firstshot::{
    Emission, Estimate, IlluminationMaps, LightElementSettings, PhotonAccumulator, PhotonSettings, Proceed, Round,
    Sums, group_areas,
};
use glam::{Vec2, Vec3, Vec4};
use patches::PatchMesh;
use rayon::prelude::*;
use runtime::cpu::Cpu;
#[cfg(feature = "vulkan")]
use runtime::executor::{DeviceChoice, open_validated};
use runtime::executor::{DeviceKind, Executor, ExecutorError, PassTime};
use runtime::plan::{PassId, Plan, Slice};
use runtime::recipe::Tables;
use runtime::recipe::firstshot::{MapSlices, PhotonPasses, PhotonTargets};
use runtime::recipe::formfactor::SparseTables;
use runtime::recipe::rays::RayStops;
use runtime::recipe::scene::SceneTables;
#[cfg(feature = "vulkan")]
use runtime::vulkan::Validation;
use scene::gpu::DirectParams;
use scene::kernel::bvh::FAR;
use scene::kernel::camera::surface_point;
use scene::kernel::light::direct_irradiance;
use scene::kernel::medium::Absorbing;
use scene::sampling::{cosine_hemisphere, hammersley, hash3};
use scene::{Hit, Lighting, NONE, Ray, Rgb, Scene, SurfacePoint};
use transport::{Csr, Observer, Patch, Phase, QUADRANTS};
use web_time::Instant;

use super::{Method, MethodReport, Preparation, bytes, passes_so_far};
use crate::albedo::Albedo;
use crate::bake::{Bake, ReceiverKind, direct_params};
use crate::error::{Error, Reason};
use crate::low_level::frame::FramePlan;
use crate::observe::run_phase;

/// Rays of a point whose light is gathered exactly.
const POINT_RAYS: u32 = 4096;

/// Number and sources of photons.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstShotSettings {
    /// Relative error of the irradiance of the patches at which photons are enough, or of the elements where pictures
    /// show the maps themselves, which is among mirrors and glass and in a medium. It is asked for after each round of
    /// photons. With 0 all photons are traced, and no frame waits for what the device has found.
    pub error: f64,
    /// Most photons.
    pub most_photons: u64,
    /// Subdivision of triangles.
    pub subdivision: Subdivision,
    /// Value that stands for the reflectance of textured light elements.
    pub texels: Texels,
    /// Source of the light at a start point.
    pub start_light: StartLight,
    /// Solver of start points on light elements.
    pub cubic: Cubic,
    /// Numbers that photons are made of.
    pub sequences: Sequences,
}

/// Source of the light at a start point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StartLight {
    /// A shadow ray tells it: no bias from the table of light elements.
    #[default]
    Traced,
    /// The table of light elements, as it is (Kopylov).
    Table,
}

impl Default for FirstShotSettings {
    /// [`FirstShotSettings::DEFAULT`].
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl FirstShotSettings {
    /// 5 %, at most 2²⁶ photons, and everything else as is best.
    pub const DEFAULT: Self = Self {
        error: 0.05,
        most_photons: 1 << 26,
        subdivision: Subdivision::Edges,
        texels: Texels::Mean,
        start_light: StartLight::Traced,
        cubic: Cubic::Newton,
        sequences: Sequences::Sobol,
    };

    /// As Kopylov prints the method.
    pub fn as_printed() -> Self {
        Self {
            subdivision: Subdivision::Kopylov,
            texels: Texels::Bound,
            start_light: StartLight::Table,
            cubic: Cubic::Cardano,
            sequences: Sequences::Sobol,
            ..Self::default()
        }
    }

    /// Surfaces that the lights fall on, and the distribution over them.
    ///
    /// # Errors
    /// More elements than there may be, cancellation.
    pub fn emission(
        &self,
        scene: &Scene,
        progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
    ) -> Result<Emission, ::firstshot::Error> {
        Emission::first_shot(scene, &self.light_elements(), self.texels, self.is_exact(), progress)
    }

    fn is_exact(&self) -> bool {
        self.start_light == StartLight::Traced
    }

    fn light_elements(&self) -> LightElementSettings {
        let own = if self.is_exact() { LightElementSettings::default() } else { LightElementSettings::table_alone() };
        match self.subdivision {
            Subdivision::Edges => own,
            Subdivision::Kopylov => own.as_printed(),
        }
    }

    /// Settings of the photons.
    pub fn photons(&self, seed: u32) -> PhotonSettings {
        PhotonSettings {
            error: self.error,
            most_photons: self.most_photons,
            sequences: self.sequences,
            cubic: self.cubic,
            seed,
            ..PhotonSettings::default()
        }
    }
}

/// Illumination maps whose cells belong to elements and patches.
pub struct PatchMaps {
    /// The maps.
    pub maps: IlluminationMaps,
    /// Patch of each cell whose error is judged, or element where these are shown, or [`NONE`].
    groups: Vec<u32>,
    /// Areas of those that have cells, m².
    group_areas: Vec<f32>,
    /// True if errors are those of elements.
    by_elements: bool,
    /// The cells of each element one after the other, those without area left out, and where each element's begin.
    cells_of_elements: Vec<u32>,
    cell_start: Vec<u32>,
    /// Areas of the elements, m²: those of their cells.
    element_areas: Vec<f32>,
}

impl PhotonAccumulator for PatchMaps {
    fn areas(&self) -> &[f32] {
        self.maps.areas()
    }

    fn cell(&self, triangle: u32, u: f32, v: f32, is_back: bool) -> u32 {
        self.maps.cell(triangle, u, v, is_back)
    }

    fn groups(&self) -> &[u32] {
        &self.groups
    }
}

impl PatchMaps {
    /// Maps as fine as elements are looked up.
    ///
    /// # Errors
    /// More cells than there may be.
    pub fn new(scene: &Scene, mesh: &PatchMesh) -> Result<Self, Error> {
        let by_elements = are_shown(scene);
        let maps = IlluminationMaps::with_divisions(scene, &mesh.divisions())?;
        let sides = (0..scene.geometry.triangles.len() as u32)
            .into_par_iter()
            .flat_map_iter(|triangle| [(triangle, false), (triangle, true)]);
        let elements: Vec<u32> =
            sides.flat_map_iter(|(triangle, is_back)| element_of_cells(&maps, mesh, triangle, is_back)).collect();
        let groups =
            elements.iter().map(|&element| if by_elements { element } else { mesh.patch_of(element) }).collect();
        let count = mesh.elements.len();
        let (cells_of_elements, cell_start) = lists(&elements, maps.areas(), count);
        let mut areas = vec![0.0f64; count];
        for (&element, &area) in elements.iter().zip(maps.areas()) {
            if let Some(sum) = areas.get_mut(element as usize) {
                *sum += f64::from(area);
            }
        }
        let element_areas = areas.into_iter().map(|area| area as f32).collect();
        let mut whole =
            Self { maps, groups, group_areas: Vec::new(), by_elements, cells_of_elements, cell_start, element_areas };
        whole.group_areas = group_areas(&whole);
        Ok(whole)
    }

    fn patch_of(&self, mesh: &PatchMesh, group: u32) -> u32 {
        if self.by_elements { mesh.patch_of(group) } else { group }
    }

    /// Mean of the cells of each patch, W/m²; 0 where none is owned.
    fn patch_means(&self, mesh: &PatchMesh, irradiance: &[Vec3]) -> Vec<Vec3> {
        let mut sums = vec![Vec4::ZERO; mesh.patches.len()];
        for ((&group, light), &area) in self.groups.iter().zip(irradiance).zip(self.areas()) {
            if let Some(sum) = sums.get_mut(self.patch_of(mesh, group) as usize) {
                *sum += (*light * area).extend(area);
            }
        }
        sums.into_iter().map(|s| if s.w > 0.0 { s.truncate() / s.w } else { Vec3::ZERO }).collect()
    }

    /// Standard errors of the patches from those of the groups, W/m²: elements err independently of each other.
    fn patch_errors(&self, mesh: &PatchMesh, errors: &[f32]) -> Vec<f32> {
        // Of a patch: square of the error of its flux, and area.
        let mut sums = vec![Vec2::ZERO; mesh.patches.len()];
        for ((group, &error), &area) in (0..).zip(errors).zip(&self.group_areas) {
            if let Some(sum) = sums.get_mut(self.patch_of(mesh, group) as usize) {
                *sum += Vec2::new((error * area).powi(2), area);
            }
        }
        sums.into_iter().map(|s| if s.y > 0.0 { s.x.sqrt() / s.y } else { 0.0 }).collect()
    }
}

/// Returns true if pictures show the maps themselves: rows of form factors know nothing of light that comes by way of a
/// mirror, through glass or through a medium.
fn are_shown(scene: &Scene) -> bool {
    scene.specular_material().is_some() || scene.has_medium()
}

/// The cells of each of `count` owners one after the other, those without area left out, and where each owner's begin.
fn lists(owners: &[u32], areas: &[f32], count: usize) -> (Vec<u32>, Vec<u32>) {
    let owned = |(cell, owner): &(u32, &u32)| (**owner as usize) < count && areas[*cell as usize] > 0.0;
    let mut pairs: Vec<(u32, u32)> = (0..).zip(owners).filter(owned).map(|(cell, &owner)| (owner, cell)).collect();
    pairs.sort_unstable();
    let start = (0..=count as u32).map(|owner| pairs.partition_point(|pair| pair.0 < owner) as u32).collect();
    (pairs.into_iter().map(|(_, cell)| cell).collect(), start)
}

/// The element in the middle of each cell of a side of a triangle.
fn element_of_cells(maps: &IlluminationMaps, mesh: &PatchMesh, triangle: u32, is_back: bool) -> Vec<u32> {
    maps.cells(triangle, is_back)
        .map(|(_, [a, b, c])| {
            let middle = (a + b + c) / 3.0;
            mesh.element_on_side(&Hit { triangle, u: middle.x, v: middle.y, t: 0.0 }, !is_back)
        })
        .collect()
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
    maps: Arc<PatchMaps>,
    settings: FirstShotSettings,
    seed: u32,
    /// Sources of photons, and the lighting that they were found for.
    emission: Emission,
    lighting: Option<Lighting>,
    /// Photons of each batch so far.
    per_batch: u64,
    /// Sums of the photons, once the host knows them.
    sums: Option<Sums>,
    estimate: Estimate,
}

impl FirstShot {
    fn new(
        scene: &Scene,
        mesh: &PatchMesh,
        settings: FirstShotSettings,
        seed: u32,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        settings.photons(seed).check().map_err(Reason::Photons)?;
        let maps = run_phase(observer, Phase::MAPS, |_| PatchMaps::new(scene, mesh))?;
        Ok(Self {
            maps: Arc::new(maps),
            settings,
            seed,
            emission: Emission::default(),
            lighting: None,
            per_batch: 0,
            sums: None,
            estimate: Estimate::default(),
        })
    }

    /// Finds what photons start from, unless it shines as before; says whether it does not. Shadow rays of light
    /// elements are those of a device whose plan has them, else the host's.
    fn set_lighting(
        &mut self,
        scene: &Scene,
        device: Option<(RayStops, &mut (dyn Executor + 'static))>,
        report: &(dyn Fn(usize, usize) -> Proceed + Sync),
    ) -> Result<bool, Error> {
        if self.lighting.as_ref() == Some(&scene.lighting) {
            return Ok(false);
        }
        self.lighting = None;
        self.sums = None;
        self.per_batch = 0;
        self.emission = match device {
            None => self.settings.emission(scene, report)?,
            Some((stops, executor)) => {
                let mut trace = |rays: &[Ray]| stops.find(executor, rays).map_err(Error::from);
                let FirstShotSettings { texels, .. } = self.settings;
                let elements = self.settings.light_elements();
                Emission::first_shot_by(&mut trace, scene, &elements, texels, self.settings.is_exact(), report)?
            }
        };
        self.lighting = Some(scene.lighting.clone());
        Ok(true)
    }

    /// The passes, and the tables that they need.
    fn add_passes(
        &self,
        plan: &mut Plan,
        tables: &mut Tables,
        scene: &SceneTables,
        irradiance: Slice<Rgb>,
    ) -> Result<PhotonPasses, ExecutorError> {
        let maps = &self.maps;
        let slices = MapSlices {
            grids: tables.part(plan, "grids", maps, |maps| &maps.maps.grids),
            groups: tables.part(plan, "groups", maps, |maps| &maps.groups),
            group_areas: tables.part(plan, "group_areas", maps, |maps| &maps.group_areas),
            cell_start: tables.part(plan, "cell_start", maps, |maps| &maps.cell_start),
            cells: tables.part(plan, "cells", maps, |maps| &maps.cells_of_elements),
            element_areas: tables.part(plan, "element_areas", maps, |maps| &maps.element_areas),
            irradiance,
        };
        let targets = PhotonTargets {
            cells: maps.areas().len() as u32,
            groups: maps.group_areas.len() as u32,
            elements: maps.element_areas.len() as u32,
            batches: self.settings.photons(self.seed).batches,
        };
        let capacity = self.emission.elements.len().next_power_of_two();
        PhotonPasses::add(plan, scene, &slices, targets, capacity)
    }

    /// Traces: all photons, with nothing read back, or until the device says that the error is reached.
    fn trace(
        &mut self,
        passes: &PhotonPasses,
        scene: &Scene,
        executor: &mut (dyn Executor + 'static),
        report: &dyn Fn(usize, usize) -> Proceed,
    ) -> Result<(), Error> {
        passes.start(executor, &self.emission)?;
        self.per_batch = 0;
        self.sums = None;
        if self.emission.is_dark() {
            return Ok(());
        }
        let settings = self.settings.photons(self.seed);
        let targets = [self.maps.areas().len() as u32, self.maps.group_areas.len() as u32];
        let mut error = f64::INFINITY;
        loop {
            let count = settings.next_round(self.per_batch, error);
            if count == 0 {
                return Ok(());
            }
            passes.trace(executor, &settings.params(scene, &self.emission, self.per_batch, count, targets))?;
            self.per_batch += u64::from(count);
            if settings.error > 0.0 {
                error = passes.relative_error(executor)?;
            }
            let photons = self.per_batch * u64::from(settings.batches);
            if report(per_mille_done(photons, error, &settings), 1000).is_break() {
                return Err(Error::cancelled());
            }
        }
    }

    /// Mean flux of a photon, W.
    fn mean_flux(&self) -> f32 {
        let photons = self.per_batch * u64::from(self.settings.photons(self.seed).batches);
        (self.emission.power / photons.max(1) as f64) as f32
    }

    /// Takes the sums over from the device; waits.
    fn count(&mut self, passes: &PhotonPasses, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        if self.sums.is_some() {
            return Ok(());
        }
        let (flux, tallies) = passes.words(executor)?;
        let batches = self.settings.photons(self.seed).batches;
        let cells = self.maps.areas().len();
        let areas = self.maps.group_areas.clone();
        let sums = Sums::from_words(flux, tallies, cells, areas, batches).map_err(Reason::Photons)?;
        self.estimate = sums.estimate(self.maps.areas(), self.emission.power, self.per_batch);
        self.sums = Some(sums);
        Ok(())
    }

    /// Indirect irradiance of the patches, W/m².
    pub fn patch_light(&self, mesh: &PatchMesh) -> Vec<PatchLight> {
        let means = self.maps.patch_means(mesh, &self.estimate.irradiance);
        let errors = self.maps.patch_errors(mesh, &self.estimate.error);
        let light =
            |((patch, irradiance), error): ((&Patch, Vec3), f32)| PatchLight { patch: *patch, irradiance, error };
        mesh.patches.iter().zip(means).zip(errors).map(light).collect()
    }

    /// Number of photons traced and their error, as of the last count.
    pub fn round(&self) -> Round {
        self.estimate.round
    }

    /// The illumination maps, and the irradiance of their cells.
    pub fn cells(&self) -> (&IlluminationMaps, &Estimate) {
        (&self.maps.maps, &self.estimate)
    }

    /// Bytes of the maps and of the light elements.
    pub fn bytes(&self) -> [(&'static str, u64); 2] {
        // Three channels of 64 bits, area, element, patch.
        let cell = (3 * size_of::<u64>() + size_of::<f32>() + 2 * size_of::<u32>()) as u64;
        [("maps", self.maps.maps.len() as u64 * cell), ("light elements", self.emission.bytes())]
    }

    /// Indirect irradiance at points, W/m²: the mean over rays of `T ρ (H_d + H)` at what they meet, H of the
    /// illumination maps, H_d by shadow rays, T what the medium leaves on the way. Where anything mirrors light or lets
    /// it through, that of the maps' cell under a point on a surface: no ray finds what a lamp sends by way of a
    /// mirror.
    pub fn irradiance_at(&self, scene: &Scene, points: &[SurfacePoint], seed: u32) -> Vec<Vec3> {
        let maps = &self.maps;
        let estimate = &self.estimate;
        if scene.specular_material().is_some() {
            let of_cell = |(index, point): (usize, &SurfacePoint)| match under(scene, point) {
                Some((hit, is_back)) => {
                    let cell = maps.cell(hit.triangle, hit.u, hit.v, is_back);
                    estimate.irradiance.get(cell as usize).copied().unwrap_or(Vec3::ZERO)
                }
                // In the air there is no cell: rays find what the maps reflect.
                None => gather(maps, estimate, scene, index as u32, point, seed),
            };
            return points.par_iter().enumerate().map(of_cell).collect();
        }
        let light = |(index, point): (usize, &SurfacePoint)| gather(maps, estimate, scene, index as u32, point, seed);
        points.par_iter().enumerate().map(light).collect()
    }
}

/// The place of a surface that a point stands on, and whether that is on its back.
fn under(scene: &Scene, point: &SurfacePoint) -> Option<(Hit, bool)> {
    let above = 2.0 * scene.geometry.ray_offset;
    let hit = scene.closest_before(point.position + point.normal * above, -point.normal, 2.0 * above);
    let is_back = || scene.tables().normal(hit.triangle).dot(point.normal) < 0.0;
    (!hit.is_miss()).then(|| (hit, is_back()))
}

/// Rows that give each quadrant of a receiver a fourth of the irradiance of the element that it stands on.
fn rows_of_elements(scene: &Scene, mesh: &PatchMesh, receivers: &[SurfacePoint]) -> Csr {
    let element =
        |point: &SurfacePoint| under(scene, point).map_or(NONE, |(hit, is_back)| mesh.element_on_side(&hit, !is_back));
    let elements: Vec<u32> = receivers.par_iter().map(element).collect();
    let columns = mesh.elements.len();
    let mut rows = Csr { rows: 0, columns, row_start: vec![0], column_index: Vec::new(), values: Vec::new() };
    for element in elements.into_iter().flat_map(|element| [element; QUADRANTS]) {
        if (element as usize) < columns {
            rows.column_index.push(element);
            rows.values.push(1.0 / QUADRANTS as f32);
        }
        rows.rows += 1;
        rows.row_start.push(rows.values.len() as u32);
    }
    rows
}

/// Indirect irradiance at a point, W/m²: see [`FirstShot::irradiance_at`].
fn gather(maps: &PatchMaps, estimate: &Estimate, scene: &Scene, index: u32, point: &SurfacePoint, seed: u32) -> Vec3 {
    let tables = scene.tables();
    let lights = scene.all_lights();
    let medium = Absorbing(scene.geometry.absorption);
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
        let first = direct_irradiance(&tables, &direct, number, there, &lights, medium, |origin, direction, t_max| {
            scene.occluded(origin, direction, t_max)
        });
        let is_back = tables.normal(hit.triangle).dot(direction) > 0.0;
        let cell = maps.cell(hit.triangle, hit.u, hit.v, is_back);
        let more = estimate.irradiance.get(cell as usize).copied().unwrap_or(Vec3::ZERO);
        sum += tables.albedo(hit.triangle, hit.u, hit.v) * (first + more) * scene.transmittance(hit.t);
    }
    sum / POINT_RAYS as f32
}

/// Share of the photons that is done, of 1,000: what the error or the greatest number allows.
fn per_mille_done(photons: u64, error: f64, settings: &PhotonSettings) -> usize {
    let by_error = (settings.error / error).powi(2);
    let by_count = photons as f64 / settings.most_photons as f64;
    (1000.0 * (0.1 + 0.9 * by_error.max(by_count).min(1.0))) as usize
}

/// Photons in place of products: they give the irradiance of the elements.
pub struct FirstShotMethod {
    bake: Arc<Bake>,
    shot: FirstShot,
    /// From the elements to the receivers, where something mirrors light or lets it through, or a medium absorbs it:
    /// form factors do not know what light comes that way, the maps do.
    receivers: Option<Arc<Csr>>,
    passes: Option<PhotonPasses>,
    /// Shadow rays of light elements, where the device is not native code: the host's hierarchy is faster than its
    /// kernels.
    stops: Option<RayStops>,
    /// True if the sums of the loaded plan are those of the lighting.
    is_traced: bool,
    start: Option<PassId>,
    host_ms: f64,
}

impl FirstShotMethod {
    /// Lays out the maps and traces for the lights of the bake.
    ///
    /// # Errors
    /// Patches as receivers, which photons do not serve; receivers at pixels in a medium; cancellation.
    pub fn new(
        settings: &FirstShotSettings,
        with: &Preparation,
        device: &mut (dyn Executor + 'static),
    ) -> Result<Self, Error> {
        let bake = Arc::clone(with.bake);
        if bake.settings.receivers == ReceiverKind::Patches {
            return Err(Reason::FirstShotReceivers.into());
        }
        if bake.settings.receivers == ReceiverKind::Pixels && bake.scene.has_medium() {
            return Err(Reason::MediumReceivers.into());
        }
        let seed = bake.settings.seed;
        let mut shot = FirstShot::new(&bake.scene, &bake.mesh, *settings, seed, with.observer)?;
        if let Some(executor) = same_device(device)? {
            run_phase(with.observer, Phase::PHOTONS, |report| {
                trace_for_bake(&mut shot, &bake.scene, executor, report)
            })?;
            let round = shot.round();
            let Emission { elements, shadow_rays, .. } = &shot.emission;
            let by = if device.device().kind == DeviceKind::Native { "the host" } else { &device.device().name };
            with.observer
                .note(&format!("photons start from {}, found by {shadow_rays} shadow rays on {by}", elements.len()));
            with.observer.note(&format!(
                "{} photons, {} registered, relative error {:.2} %",
                round.photons,
                round.registered,
                100.0 * round.error
            ));
        }
        let receivers =
            are_shown(&bake.scene).then(|| Arc::new(rows_of_elements(&bake.scene, &bake.mesh, &bake.receivers.points)));
        Ok(Self { bake, shot, receivers, passes: None, stops: None, is_traced: false, start: None, host_ms: 0.0 })
    }

    /// The photons; what they have found is that of the last frame once [`Method::count`] was called after it.
    pub fn shot(&self) -> &FirstShot {
        &self.shot
    }
}

/// Opens the device once more, for a plan of its own; nothing for a caller's device.
fn same_device(executor: &dyn Executor) -> Result<Option<Box<dyn Executor>>, Error> {
    let device = executor.device();
    match device.index {
        #[cfg(feature = "vulkan")]
        Some(index) => {
            let validation = if device.has_validation { Validation::Required } else { Validation::Off };
            Ok(Some(open_validated(&DeviceChoice::Index(index), validation)?.0))
        }
        #[cfg(not(feature = "vulkan"))]
        Some(_) => Ok(None),
        None if device.kind == DeviceKind::Native => Ok(Some(Box::new(Cpu::new()))),
        None => Ok(None),
    }
}

/// Traces for the lights of the bake, in a plan that has nothing else.
fn trace_for_bake(
    shot: &mut FirstShot,
    scene: &Scene,
    mut executor: Box<dyn Executor>,
    report: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<(), Error> {
    let executor = executor.as_mut();
    let stops = match executor.device().kind {
        DeviceKind::Native => None,
        _ => Some(RayStops::load(executor, scene)?),
    };
    // Light elements are a small part of the work.
    shot.set_lighting(scene, stops.map(|stops| (stops, &mut *executor)), &|done, total| report(done, 10 * total))?;
    let mut plan = Plan::new();
    let mut tables = Tables::new();
    let scene_tables = SceneTables::new(&mut plan, &mut tables, scene, scene.lighting.lights.len().max(1));
    let irradiance = plan.array("element irradiance", shot.maps.element_areas.len());
    let passes = shot.add_passes(&mut plan, &mut tables, &scene_tables, irradiance)?;
    executor.load(plan)?;
    tables.upload(executor)?;
    scene_tables.set_lights(executor, &scene.lighting.lights)?;
    scene_tables.set_distributions(executor, &scene.lighting.distributions)?;
    scene_tables.set_sky_and_emission(executor, scene)?;
    shot.trace(&passes, scene, executor, report)?;
    shot.count(&passes, executor)
}

impl Method for FirstShotMethod {
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<(), Error> {
        let irradiance = frame.elements.irradiance;
        self.passes = Some(self.shot.add_passes(&mut frame.plan, &mut frame.tables, &frame.scene, irradiance)?);
        self.stops = match frame.device.kind {
            DeviceKind::Native => None,
            _ => Some(RayStops::add(&mut frame.plan, &frame.scene)?),
        };
        let before = passes_so_far(frame).len();
        frame.start_from_source()?;
        self.start = passes_so_far(frame).get(before).copied();
        Ok(())
    }

    fn add_receiver_passes(&mut self, frame: &mut FramePlan) -> Result<bool, Error> {
        let Some(rows) = &self.receivers else { return Ok(false) };
        let rows = SparseTables::new(&mut frame.plan, &mut frame.tables, "receiver element", rows);
        let quadrants = frame.received.part(0, QUADRANTS * frame.bake.receivers.points.len());
        rows.gather(&mut frame.plan, "lookup", frame.elements.irradiance, quadrants)?;
        Ok(true)
    }

    fn set_albedo(&mut self, _: &Albedo, _: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        self.shot.lighting = None;
        Ok(())
    }

    fn finds_element_irradiance(&self) -> bool {
        true
    }

    fn supports_media(&self) -> bool {
        true
    }

    fn set_lighting(&mut self, scene: &Scene, executor: &mut (dyn Executor + 'static)) -> Result<bool, Error> {
        let start = Instant::now();
        if self.shot.set_lighting(scene, self.stops.map(|stops| (stops, executor)), &ignore_progress)? {
            self.is_traced = false;
        }
        self.host_ms = start.elapsed().as_secs_f64() * 1e3;
        Ok(self.passes.is_some_and(|passes| passes.fits(&self.shot.emission)))
    }

    fn start(&mut self, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        self.is_traced = false;
        if let (Some(passes), Some(sums)) = (&self.passes, &self.shot.sums) {
            passes.restore(executor, sums)?;
            self.is_traced = true;
        }
        Ok(())
    }

    fn submit(&mut self, executor: &mut (dyn Executor + 'static)) -> Option<Result<Vec<PassTime>, Error>> {
        Some(self.submit_photons(executor))
    }

    fn count(&mut self, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        match self.passes.filter(|_| self.is_traced) {
            Some(passes) => self.shot.count(&passes, executor),
            None => Ok(()),
        }
    }

    fn report(&self) -> MethodReport {
        MethodReport { bytes: bytes(self.shot.bytes()), host_ms: self.host_ms }
    }

    fn irradiance_at(&self, scene: &Scene, points: &[SurfacePoint], seed: u32) -> Option<Vec<Vec3>> {
        Some(self.shot().irradiance_at(scene, points, seed))
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

impl FirstShotMethod {
    fn submit_photons(&mut self, executor: &mut (dyn Executor + 'static)) -> Result<Vec<PassTime>, Error> {
        let Some(passes) = self.passes else { return Ok(Vec::new()) };
        if !self.is_traced {
            self.shot.trace(&passes, &self.bake.scene, executor, &ignore_progress)?;
            self.is_traced = true;
        }
        passes.resolve(executor, self.shot.mean_flux())?;
        executor.submit_passes(self.start.as_slice())?;
        Ok(vec![PassTime::of_host("method", self.host_ms)])
    }
}

/// Progress callback that continues; for callers that report to nobody.
pub(crate) fn ignore_progress(_: usize, _: usize) -> Proceed {
    ControlFlow::Continue(())
}
