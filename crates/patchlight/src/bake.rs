//! The static part of a scene, computed once: patches, elements and receivers, and the form factors between them.

use std::sync::{Arc, Mutex, PoisonError};

use formfactor::{RowKey, Stop, jacobi};
use glam::Vec4;
use patches::{
    Density, Focus, LitSampler, MAX_PATCHES, MeshReceivers, MeshSettings, PatchKind, PatchMesh, Placing, ViewSettings,
    cut_at_feet, lit_sampler_with, test_lights,
};
use runtime::executor::Executor;
use scene::gpu::DirectParams;
use scene::sampling::hash3;
use scene::{Scene, SurfacePoint, sky_bin};
use serde::{Deserialize, Serialize};
use transport::{Csr, HitCounts, Observer, Phase};

use crate::energy::EnergyCheck;
use crate::error::{Error, Reason};
use crate::form_factors::{ElementRows, Estimator, FormFactors, HOST, RowRays};
use crate::low_level::operator::BakedOperator;
use crate::memory::check_free;
use crate::observe::{Report, run_phase};
use crate::settings::setters;

/// Receivers along the edge of a patch.
const RECEIVERS_AN_EDGE: f32 = 3.0;
/// Most receivers for each that their distance gives where light is even.
const MAX_RECEIVERS: f32 = 10.0 / 3.0;
/// Bytes of a receiver with those of the interpolation points near it, and of each element that its rays may hit, of
/// which about half are hit, while they are placed.
const RECEIVER_BYTES: f64 = 1500.0;
const HIT_BYTES: f64 = 1.2;
/// Bytes beside them: samples, patches, rows under way.
const SAMPLER_BYTES: u64 = 256 << 20;
/// Bounces when all are asked for end when no patch changes by more than this share of the brightest.
pub(crate) const TOLERANCE: f32 = 1e-4;
/// Bounces at most: an albedo of 0.95 in a closed room needs 180 for the tolerance.
pub(crate) const MAX_BOUNCES: u32 = 200;

/// Changes the random numbers of receivers.
pub(crate) const RECEIVERS: u32 = 0x7265_6365;

/// Shortest foot of something at which what it stands on is cut, as a share of the edge of a patch.
const FOOT_OF_PATCH: f32 = 0.5;

/// Points where irradiance is gathered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ReceiverKind {
    /// At points of the surface, close where light bends; pixels are interpolated between those about.
    #[default]
    Mesh,
    /// At every visible point of a view, with nothing in between: slow, for measuring.
    Pixels,
    /// By the patches themselves; pixels take the mean of those about. Only voxel and axis patches can.
    Patches,
}

/// Settings of [`Bake::build`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct BakeSettings {
    /// Kind of patches.
    pub patches: PatchKind,
    /// About how many patches.
    pub patch_count: usize,
    /// Viewing area: samples, patches and receivers are shared out by how much of the light that a place sends can get
    /// there. Voxel and axis patches and their receivers are the same everywhere.
    pub focus: Focus,
    /// Edge of the voxels of voxel and axis patches, m, instead of their count.
    pub voxel_size: Option<f32>,
    /// Samples of a cluster, on average: where its direct light is measured.
    pub samples: u32,
    /// Rays to area lights, and to a sky map, from each sample.
    pub sample_rays: u32,
    /// Estimator of the form factors between patches.
    pub estimator: Estimator,
    /// Bounces; `None` for all.
    pub bounces: Option<u32>,
    /// Points where irradiance is gathered.
    pub receivers: ReceiverKind,
    /// Distance between receivers in the focus where light is even, m; `None` takes a third of the patches' mean edge
    /// there, over √density.
    pub receiver_edge: Option<f32>,
    /// Most receivers: beyond those of the distance, where light bends; `None` for ten thirds of those.
    pub most_receivers: Option<usize>,
    /// Receivers for each that there would be by default.
    pub receiver_density: f32,
    /// Rays of a receiver's row.
    pub receiver_rays: u32,
    /// Most resident memory, bytes: more receivers than fit are refused. `None` for what the system says is free.
    pub memory_limit: Option<u64>,
    /// Changes every random number.
    pub seed: u32,
}

impl BakeSettings {
    /// Bytes that the rows of all elements and receivers and what is made of them take at most about while they are
    /// placed, and those of a part of so many.
    pub fn rows_bytes(&self, parts: u32) -> [u64; 2] {
        let receivers = self.expected_receivers();
        let hits = f64::from(self.receiver_rays.min(MAX_PATCHES as u32));
        let bytes = receivers * (RECEIVER_BYTES + HIT_BYTES * hits);
        [bytes, bytes / f64::from(parts.max(1))].map(|bytes| bytes as u64 + SAMPLER_BYTES)
    }

    /// Most receivers there will be about, as far as the settings alone say it.
    fn expected_receivers(&self) -> f64 {
        let even = self.patch_count as f32 * RECEIVERS_AN_EDGE.powi(2) * self.receiver_density;
        self.most_receivers.map_or(f64::from(MAX_RECEIVERS * even), |most| most as f64)
    }

    /// Refuses what will not fit into memory before any work, as far as the settings alone say it.
    fn check_memory(&self) -> Result<(), Error> {
        let is_known = self.receiver_edge.is_none() && !self.patches.has_voxels();
        if self.receivers != ReceiverKind::Mesh || !is_known && self.most_receivers.is_none() {
            return Ok(());
        }
        check_rows(self, self.expected_receivers(), MAX_PATCHES.min(self.patch_count), "")
    }
}

impl Default for BakeSettings {
    /// 4,000 clusters, 4,096 rays a row, all bounces, receivers on the mesh.
    fn default() -> Self {
        Self {
            patches: PatchKind::default(),
            patch_count: 4000,
            focus: Focus::default(),
            voxel_size: None,
            samples: ViewSettings::default().samples,
            sample_rays: 8,
            estimator: Estimator::Hemisphere { rays: 4096 },
            bounces: None,
            receivers: ReceiverKind::default(),
            receiver_edge: None,
            most_receivers: None,
            receiver_density: 1.0,
            receiver_rays: 1024,
            memory_limit: None,
            seed: 0,
        }
    }
}

setters!(BakeSettings {
    /// With a kind of patches.
    with_patches(patches: PatchKind);
    /// With about so many patches.
    with_patch_count(patch_count: usize);
    /// With a viewing area.
    with_focus(focus: Focus);
    /// With an edge of the voxels, m, or by their count.
    with_voxel_size(voxel_size: Option<f32>);
    /// With so many samples of a cluster, on average.
    with_samples(samples: u32);
    /// With so many rays to area lights, and to a sky map, from each sample.
    with_sample_rays(sample_rays: u32);
    /// With an estimator of the form factors between patches.
    with_estimator(estimator: Estimator);
    /// With so many bounces; `None` for all.
    with_bounces(bounces: Option<u32>);
    /// With points where irradiance is gathered.
    with_receivers(receivers: ReceiverKind);
    /// With a distance between receivers, m.
    with_receiver_edge(receiver_edge: Option<f32>);
    /// With at most so many receivers.
    with_most_receivers(most_receivers: Option<usize>);
    /// With so many receivers for each that there would be by default.
    with_receiver_density(receiver_density: f32);
    /// With so many rays of a receiver's row.
    with_receiver_rays(receiver_rays: u32);
    /// With a limit of resident memory, bytes.
    with_memory_limit(memory_limit: Option<u64>);
    /// With another seed of every random number.
    with_seed(seed: u32);
});

/// The static part of a scene: patches, elements and receivers, and their form factors. Lights may change after it.
#[derive(Clone)]
pub struct Bake {
    /// The scene, with the lighting that it was baked with.
    pub(crate) scene: Scene,
    /// Patches and elements.
    pub(crate) mesh: Arc<PatchMesh>,
    /// Their form factors.
    pub(crate) form_factors: FormFactors,
    /// Receivers and interpolation points.
    pub(crate) receivers: MeshReceivers,
    /// Density of patches and receivers.
    pub(crate) density: Density,
    /// Estimate of its errors; none for a bake without patches, or of a scene with a medium, through which no light
    /// goes by form factors.
    pub(crate) energy: Option<EnergyCheck>,
    /// Settings of direct light at the samples.
    pub(crate) direct: DirectParams,
    /// Bounces of a frame.
    pub(crate) bounces: u32,
    /// Settings that it was made with.
    pub(crate) settings: BakeSettings,
    /// Operators that methods need not make anew.
    pub(crate) operators: Vec<BakedOperator>,
    /// Sources of the random numbers of rows, for edits.
    pub(crate) keys: RowKeys,
}

/// Sources of the random numbers of rows.
#[derive(Clone, Default)]
pub(crate) struct RowKeys {
    /// Those of the elements.
    pub elements: Arc<Vec<RowKey>>,
    /// Those of the receivers.
    pub receivers: Arc<Vec<RowKey>>,
}

impl RowKeys {
    /// Those of a bake that was not edited.
    pub fn new(seed: u32, elements: usize, receivers: Vec<RowKey>) -> Self {
        let elements = (0..elements as u32).map(|number| RowKey { seed, number }).collect();
        Self { elements: Arc::new(elements), receivers: Arc::new(receivers) }
    }
}

setters!(Bake {
    /// With another scene of the same geometry. That parts belong together is not checked.
    with_scene(scene: Scene);
    /// With other patches and elements, as many of them.
    with_mesh(mesh: Arc<PatchMesh>);
    /// With other form factors between the same patches and elements.
    with_form_factors(form_factors: FormFactors);
    /// With other receivers.
    with_receivers(receivers: MeshReceivers);
    /// With so many bounces of a frame.
    with_bounces(bounces: u32);
});

/// A bake that has no receivers yet.
#[derive(Clone)]
pub struct PatchBake<'a> {
    sampler: Option<LitSampler<'a>>,
    bake: Bake,
}

impl Bake {
    /// The scene, with the lighting that it was baked with.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Patches and elements.
    pub fn mesh(&self) -> &Arc<PatchMesh> {
        &self.mesh
    }

    /// Form factors of patches and elements.
    pub fn form_factors(&self) -> &FormFactors {
        &self.form_factors
    }

    /// Receivers and interpolation points.
    pub fn receivers(&self) -> &MeshReceivers {
        &self.receivers
    }

    /// Density of patches and receivers.
    pub fn density(&self) -> &Density {
        &self.density
    }

    /// Estimate of its errors; `None` for a bake without patches, or of a scene with a medium, through which no light
    /// goes by form factors.
    pub fn energy(&self) -> Option<EnergyCheck> {
        self.energy
    }

    /// Settings of direct light at the samples.
    pub fn direct(&self) -> &DirectParams {
        &self.direct
    }

    /// Number of bounces of a frame.
    pub fn bounces(&self) -> u32 {
        self.bounces
    }

    /// Settings that it was made with.
    pub fn settings(&self) -> &BakeSettings {
        &self.settings
    }

    /// Operators that methods need not make anew.
    pub fn operators(&self) -> &[BakedOperator] {
        &self.operators
    }

    /// Adds an operator that methods need not make anew.
    pub fn add_operator(&mut self, operator: BakedOperator) {
        self.operators.push(operator);
    }

    /// Cuts a scene into patches, estimates their form factors, and places receivers, on all cores of the host.
    ///
    /// # Errors
    /// Too many triangles or voxels, settings that do not suit each other, cancellation.
    pub fn build(scene: &Scene, settings: &BakeSettings, observer: &dyn Observer) -> Result<Self, Error> {
        Self::build_by(&HOST, scene, settings, observer)
    }

    /// [`Bake::build`] with a device that traces the rays of elements and receivers, walks from places to light and
    /// looks from interpolation points to receivers, most of the work: the plan that it had goes. Native code as the
    /// device leaves them to the host. Where device and host find the same hits, the bake has the same bytes; of
    /// triangles that lie in one place they may name different ones.
    ///
    /// # Errors
    /// As [`Bake::build`]; what the device says.
    pub fn build_on(
        device: &mut (dyn Executor + 'static),
        scene: &Scene,
        settings: &BakeSettings,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        Self::build_by(&RowRays::on(device), scene, settings, observer)
    }

    fn build_by(
        rays: &RowRays,
        scene: &Scene,
        settings: &BakeSettings,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        let density = density_of(scene, settings, observer)?;
        let cut = cut_scene(scene, &density, settings)?;
        let patches = PatchBake::with_density(cut.as_ref().unwrap_or(scene), density, settings, rays, observer)?;
        patches.with_receivers_by(settings, rays, observer)
    }

    /// Values that the patches' irradiance has: those between them where pixels take it from the patches.
    pub fn irradiance_values(&self) -> usize {
        match &self.mesh.lookup {
            Some(lookup) if self.settings.receivers == ReceiverKind::Patches => lookup.values,
            _ => self.mesh.patches.len(),
        }
    }
}

impl<'a> PatchBake<'a> {
    /// Cuts a scene into patches, and estimates and balances their form factors. Triangles stay whole, so the focus is
    /// not asked: the density is the same everywhere.
    ///
    /// # Errors
    /// Too many triangles or voxels, settings that the patches do not suit, cancellation.
    pub fn build(scene: &'a Scene, settings: &BakeSettings, observer: &dyn Observer) -> Result<Self, Error> {
        Self::with_density(scene, Density::default(), settings, &HOST, observer)
    }

    /// [`PatchBake::build`] with a density that is known.
    pub(crate) fn with_density(
        scene: &'a Scene,
        density: Density,
        settings: &BakeSettings,
        rays: &'a RowRays<'_>,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        check_receivers(settings)?;
        settings.check_memory()?;
        let triangles = scene.geometry.triangles.len();
        if settings.patches == PatchKind::Polygon && triangles > MAX_PATCHES {
            return Err(too_many(triangles, triangles));
        }
        let (sampler, mesh) = run_phase(observer, Phase::SAMPLE, |_| make_mesh(scene, density, settings, rays))?;
        rays.tell(Phase::SAMPLE, observer);
        if mesh.patches.len() > MAX_PATCHES {
            return Err(too_many(triangles, mesh.patches.len()));
        }
        let form_factors = run_phase(observer, Phase::FORM_FACTORS, |report| {
            FormFactors::estimate_by(scene, &mesh, (settings.estimator, settings.seed), rays, report)
        })?;
        rays.tell(Phase::FORM_FACTORS, observer);
        let bounces = match settings.bounces {
            Some(bounces) => bounces,
            None => run_phase(observer, Phase::BOUNCES, |_| enough_bounces(&form_factors.factors, &mesh.albedo))?,
        };
        let bake = Bake {
            scene: scene.clone(),
            direct: sample_params(scene, &mesh, settings),
            keys: RowKeys::new(settings.seed, mesh.elements.len(), Vec::new()),
            mesh: Arc::new(mesh),
            form_factors,
            receivers: MeshReceivers::none(scene)?,
            density,
            energy: None,
            bounces,
            settings: *settings,
            operators: Vec::new(),
        };
        Ok(Self { sampler, bake })
    }

    /// A bake whose receivers are still to be placed, on the scene that it was made of.
    ///
    /// # Errors
    /// Too many triangles.
    pub(crate) fn of(bake: Bake, scene: &'a Scene, rays: &'a RowRays<'_>) -> Result<Self, Error> {
        let sampler = sampler(scene, bake.density, &bake.settings, rays)?;
        Ok(Self { sampler, bake })
    }

    /// The bake without receivers.
    pub(crate) fn bake(&self) -> &Bake {
        &self.bake
    }

    /// Returns true if these are the patches of such settings: they differ at most in receivers.
    pub fn are_of(&self, settings: &BakeSettings) -> bool {
        let own = &self.bake.settings;
        let receivers = BakeSettings {
            receivers: own.receivers,
            receiver_edge: own.receiver_edge,
            most_receivers: own.most_receivers,
            receiver_density: own.receiver_density,
            receiver_rays: own.receiver_rays,
            memory_limit: own.memory_limit,
            ..*settings
        };
        receivers == *own
    }

    /// Places receivers: of these settings only what says where and with how many rays counts, with the patches as they
    /// are.
    ///
    /// # Errors
    /// Receivers that the patches do not suit, cancellation.
    pub fn with_receivers(self, settings: &BakeSettings, observer: &dyn Observer) -> Result<Bake, Error> {
        self.with_receivers_by(settings, &HOST, observer)
    }

    /// [`PatchBake::with_receivers`], their rays traced by the host or a device.
    pub(crate) fn with_receivers_by(
        self,
        settings: &BakeSettings,
        rays: &RowRays,
        observer: &dyn Observer,
    ) -> Result<Bake, Error> {
        let Self { sampler, bake } = self;
        let settings = BakeSettings { patches: bake.settings.patches, ..*settings };
        check_receivers(&settings)?;
        let (receivers, keys) = run_phase(observer, Phase::RECEIVERS, |report| match &sampler {
            Some(sampler) if settings.receivers == ReceiverKind::Mesh => place(&bake, sampler, &settings, rays, report),
            _ => Ok((MeshReceivers::none(&bake.scene)?, Vec::new())),
        })?;
        rays.tell(Phase::RECEIVERS, observer);
        observer.note(&format!(
            "{} patches, {} elements, {} receivers, {} interpolation points",
            bake.mesh.patches.len(),
            bake.mesh.elements.len(),
            receivers.points.len(),
            receivers.interpolation.points.len()
        ));
        let keys = RowKeys { receivers: Arc::new(keys), ..bake.keys };
        let mut bake = Bake { receivers, settings, keys, ..bake };
        bake.energy = run_phase(observer, Phase::ENERGY, |_| EnergyCheck::of(&bake))?;
        if let Some(energy) = &bake.energy {
            observer.note(&format!("energy: {}", energy.summary()));
        }
        Ok(bake)
    }
}

/// Density of patches and receivers on the surfaces of a scene.
pub(crate) fn density_of(scene: &Scene, settings: &BakeSettings, observer: &dyn Observer) -> Result<Density, Error> {
    match settings.patches.has_voxels() {
        true => Ok(Density::default()),
        false => run_phase(observer, Phase::DENSITY, |_| Ok(Density::new(scene, settings.focus, settings.seed)?)),
    }
}

/// The scene with triangles cut where something stands on them, as far as that matters to patches of these settings.
pub(crate) fn cut_scene(scene: &Scene, density: &Density, settings: &BakeSettings) -> Result<Option<Scene>, Error> {
    if settings.patches.has_voxels() {
        return Ok(None);
    }
    // Of both sides.
    let area: f64 = scene.geometry.triangles.iter().map(|triangle| density.counted_area(triangle)).sum::<f64>() * 2.0;
    let patch_edge = (area / settings.patch_count.max(1) as f64).sqrt();
    Ok(cut_at_feet(scene, density, FOOT_OF_PATCH * patch_edge as f32)?)
}

fn too_many(triangles: usize, needed: usize) -> Error {
    Reason::TooManyPatches { triangles, needed, limit: MAX_PATCHES }.into()
}

/// Builds the sampler, patches and elements.
fn make_mesh<'a>(
    scene: &'a Scene,
    density: Density,
    settings: &BakeSettings,
    rays: &'a RowRays<'_>,
) -> Result<(Option<LitSampler<'a>>, PatchMesh), Error> {
    let sampler = sampler(scene, density, settings, rays)?;
    let mesh = PatchMesh::new(scene, sampler.as_ref(), &mesh_settings(settings)).map_err(own_error)?;
    Ok((sampler, mesh))
}

/// Builds the sampler, if light comes anywhere.
pub(crate) fn sampler<'a>(
    scene: &'a Scene,
    density: Density,
    settings: &BakeSettings,
    rays: &'a RowRays<'_>,
) -> Result<Option<LitSampler<'a>>, Error> {
    lit_sampler_with(rays.walker(), scene, settings.patch_count, density, settings.seed).map_err(own_error)
}

/// An error that went through `patches`.
pub(crate) fn own_error(error: patches::Error) -> Error {
    match error {
        patches::Error::Rows(own) => match own.downcast::<Error>() {
            Ok(own) => *own,
            Err(other) => patches::Error::Rows(other).into(),
        },
        other => other.into(),
    }
}

fn mesh_settings(settings: &BakeSettings) -> MeshSettings {
    MeshSettings {
        kind: settings.patches,
        count: settings.patch_count,
        voxel_size: settings.voxel_size,
        samples: settings.samples,
        seed: settings.seed,
    }
}

/// Parameters of direct light at the samples of a mesh.
pub(crate) fn sample_params(scene: &Scene, mesh: &PatchMesh, settings: &BakeSettings) -> DirectParams {
    DirectParams {
        count: mesh.points.len() as u32,
        area_rays: settings.sample_rays,
        sky_rays: if scene.lighting.sky.map_width == 0 { 0 } else { settings.sample_rays },
        seed: settings.seed,
        ..direct_params(scene)
    }
}

/// Places receivers on the mesh.
fn place(
    bake: &Bake,
    sampler: &LitSampler,
    settings: &BakeSettings,
    device: &RowRays,
    report: &Report,
) -> Result<(MeshReceivers, Vec<RowKey>), Error> {
    let scene = &bake.scene;
    let mesh = &bake.mesh;
    let seed = settings.seed ^ RECEIVERS;
    let density = sampler.density();
    let area: f32 = mesh.patches.iter().map(|patch| patch.area * density.share(patch.centroid)).sum();
    let patch_edge = (area / mesh.patches.len().max(1) as f32).sqrt();
    let even = patch_edge / (RECEIVERS_AN_EDGE * scene::math::sqrt(settings.receiver_density));
    let edge = settings.receiver_edge.unwrap_or(even);
    if !(edge > 0.0 && edge.is_finite()) {
        let rule = "above 0 and finite";
        return Err(transport::Error::Setting { name: "distance between receivers", value: edge.into(), rule }.into());
    }
    let by_distance = f64::from(MAX_RECEIVERS) * f64::from(area) / f64::from(edge).powi(2);
    let most = settings.most_receivers.map_or(by_distance, |most| most as f64);
    check_rows(settings, most, mesh.elements.len(), &format!(", {edge} m from each other,"))?;
    let factors = &bake.form_factors;
    let lights = test_lights(scene, mesh, density, &*factors.factors, factors.element_operator(), &bake.direct)?;
    let placing = Placing {
        rays: settings.receiver_rays,
        edge,
        most: settings.most_receivers.unwrap_or(by_distance as usize),
        seed,
    };
    let keys = Mutex::new(Vec::new());
    let add = receiver_rows(bake, settings.receiver_rays, seed, device, &keys, report);
    let receivers = MeshReceivers::place(scene, sampler, mesh.elements.len(), &placing, &lights, &add);
    let receivers = receivers.map_err(own_error)?;
    drop(add);
    Ok((receivers, taken(keys)))
}

/// Adds rows of receivers and their keys. How many there will be is not known: the observer receives those of each
/// round.
pub(crate) fn receiver_rows<'a>(
    bake: &'a Bake,
    rays: u32,
    seed: u32,
    device: &'a RowRays,
    keys: &'a Mutex<Vec<RowKey>>,
    report: &'a Report,
) -> impl Fn(&mut HitCounts, &mut HitCounts, &[SurfacePoint]) -> Result<(), patches::Error> + 'a {
    move |rows, sky_rows, points| {
        let offsets: Vec<u32> = (0..=points.len() as u32).collect();
        let seed = hash3(transport::LinearOperator::rows(rows) as u32, 0, seed);
        let own = ElementRows { scene: &bake.scene, mesh: &bake.mesh, points, offsets: &offsets, rays, seed };
        let sky = (sky_rows, &sky_bin as &formfactor::SkyBin);
        let added = device.add(rows, Some(sky), &own, report);
        added.map_err(|error| patches::Error::Rows(Box::new(error)))?;
        let new = (0..points.len() as u32).map(|number| RowKey { seed, number });
        keys.lock().unwrap_or_else(PoisonError::into_inner).extend(new);
        Ok(())
    }
}

/// The keys of rows that were added.
pub(crate) fn taken(keys: Mutex<Vec<RowKey>>) -> Vec<RowKey> {
    keys.into_inner().unwrap_or_else(PoisonError::into_inner)
}

/// Refuses more receivers than fit into memory with their rows.
fn check_rows(settings: &BakeSettings, receivers: f64, elements: usize, distance: &str) -> Result<(), Error> {
    let hits = (settings.receiver_rays as usize).min(elements);
    check_free(
        format!("{receivers:.0} receivers{distance}"),
        receivers * (RECEIVER_BYTES + HIT_BYTES * hits as f64),
        settings.memory_limit,
        "choose a larger distance between receivers, or fewer receivers",
    )
}

/// Only voxels have a lookup between patches.
fn check_receivers(settings: &BakeSettings) -> Result<(), Error> {
    if settings.receivers == ReceiverKind::Patches && !settings.patches.has_voxels() {
        return Err(Reason::PatchesAsReceivers { patches: settings.patches.name() }.into());
    }
    Ok(())
}

/// Direct-light settings that follow from the scene.
pub fn direct_params(scene: &Scene) -> DirectParams {
    DirectParams {
        light_count: scene.lighting.lights.len() as u32,
        emitter_count: scene.emitters.len() as u32,
        ray_offset: scene.geometry.ray_offset,
        ..DirectParams::default()
    }
}

/// Bounces until a uniform source changes no patch by more than the tolerance, and a fourth more for sources that are
/// not uniform.
pub(crate) fn enough_bounces(factors: &Csr, albedo: &[Vec4]) -> Result<u32, Error> {
    let source = vec![Vec4::new(1.0, 1.0, 1.0, 0.0); albedo.len()];
    let steps = jacobi(factors, &source, albedo, Stop::Tolerance(TOLERANCE))?.iterations;
    Ok((steps + steps / 4).clamp(1, MAX_BOUNCES))
}
