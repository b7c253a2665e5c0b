//! Form factors between patches, and between the elements into which they are cut, by the estimator of the settings.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use formfactor::{
    AreaToArea, Contour, Hemisphere, PointToPoint, SkyBin, add_hit_rows, add_quadrant_rows, add_traced_rows, balance,
    form_factors, sparse_rows,
};
use patches::{Columns, PatchMesh, Walker};
use rayon::prelude::*;
use runtime::executor::{DeviceKind, Executor, ExecutorError};
use runtime::recipe::formfactor::RowTracer;
use runtime::recipe::rays::RayStops;
use runtime::recipe::scene::load_scene;
use runtime::recipe::walks::Walks;
use scene::{Geometry, Lighting, Ray, Scene, SurfacePoint, reachability};
use serde::{Deserialize, Serialize};
use transport::{Csr, HitCounts, LinearOperator, Observer, Phase};

use crate::error::Error;
use crate::observe::Report;
use crate::rounds::Rounds;

/// Most lights to which each surface of a walk looks on lavapipe, which ends all loops of an invocation after 65,535
/// rounds.
const MAX_EMULATED_LIGHTS: usize = 8;
/// Fewest rays of an element's row.
const MIN_ELEMENT_RAYS: u64 = 64;

/// Estimator of the form factors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Estimator {
    /// Cosine-weighted rays.
    Hemisphere {
        /// Rays a row.
        rays: u32,
    },
    /// Lambert's contour formula with shadow rays.
    Contour,
    /// Pairs of points on both patches.
    Area,
    /// One point a patch.
    Point,
}

/// Who traces the rays of elements and receivers and walks to light: the host's own hierarchy, or the kernels of a
/// device.
pub(crate) struct RowRays<'d> {
    device: Option<Mutex<Device<'d>>>,
    /// Files of rows that others trace.
    rounds: Option<&'d Rounds>,
}

/// All cores of the host.
pub(crate) static HOST: RowRays<'static> = RowRays { device: None, rounds: None };

/// A device, and what it did since it was last told.
struct Device<'d> {
    executor: &'d mut (dyn Executor + 'static),
    rays: u64,
    places: u64,
    sights: u64,
    /// Kind of the loaded plan, unless it is that of rows.
    loaded: Option<Loaded>,
}

/// A plan of walks and of rays from place to place in a scene.
#[derive(Clone)]
struct Loaded {
    geometry: Arc<Geometry>,
    lighting: Lighting,
    walks: Walks,
    stops: RayStops,
}

impl Device<'_> {
    /// The passes for a scene.
    fn load(&mut self, scene: &Scene) -> Result<(Walks, RayStops), ExecutorError> {
        let is_own =
            |loaded: &&Loaded| Arc::ptr_eq(&loaded.geometry, &scene.geometry) && loaded.lighting == scene.lighting;
        if let Some(loaded) = self.loaded.as_ref().filter(is_own) {
            return Ok((loaded.walks, loaded.stops));
        }
        self.loaded = None;
        let (walks, stops) = load_scene(self.executor, scene, |plan, tables| {
            Ok((Walks::add(plan, tables, scene)?, RayStops::add(plan, tables)?))
        })?;
        let geometry = Arc::clone(&scene.geometry);
        let lighting = scene.lighting.clone();
        self.loaded = Some(Loaded { geometry, lighting, walks, stops });
        Ok((walks, stops))
    }

    fn reachability(
        &mut self,
        scene: &Scene,
        places: &[SurfacePoint],
        walks: u32,
        seed: u32,
    ) -> Result<Vec<u32>, ExecutorError> {
        let (pass, _) = self.load(scene)?;
        self.places += places.len() as u64;
        pass.find(self.executor, places, walks, seed)
    }

    fn stopped(&mut self, scene: &Scene, rays: &[Ray]) -> Result<Vec<u32>, ExecutorError> {
        let (_, pass) = self.load(scene)?;
        self.sights += rays.len() as u64;
        pass.find(self.executor, rays)
    }
}

/// Rows of rays over the elements of a mesh.
pub(crate) struct ElementRows<'a> {
    /// The scene of the mesh.
    pub scene: &'a Scene,
    /// Whose elements are the columns.
    pub mesh: &'a PatchMesh,
    /// Row i starts from `points[offsets[i]..offsets[i + 1]]`.
    pub points: &'a [SurfacePoint],
    /// One more than rows.
    pub offsets: &'a [u32],
    /// Rays of each.
    pub rays: u32,
    /// Changes every random number.
    pub seed: u32,
}

impl<'d> RowRays<'d> {
    /// A device; the host where its own hierarchy is faster than the kernels, as native code.
    pub(crate) fn on(executor: &'d mut (dyn Executor + 'static)) -> Self {
        let is_host = executor.device().kind == DeviceKind::Native;
        Self {
            device: (!is_host).then(|| Mutex::new(Device { executor, rays: 0, places: 0, sights: 0, loaded: None })),
            rounds: None,
        }
    }

    /// Others, who trace the rows of each round; the host does the rest.
    pub(crate) fn in_rounds(rounds: &'d Rounds) -> Self {
        Self { device: None, rounds: Some(rounds) }
    }

    /// Who walks to light in the host's stead.
    pub(crate) fn walker(&self) -> Option<&dyn Walker> {
        self.device.is_some().then_some(self as &dyn Walker)
    }

    /// Tells what the device did in a phase.
    pub(crate) fn tell(&self, phase: Phase, observer: &dyn Observer) {
        let Some(mut device) = self.lock() else { return };
        let rays = std::mem::take(&mut device.rays);
        let places = std::mem::take(&mut device.places);
        let sights = std::mem::take(&mut device.sights);
        let mut done = Vec::new();
        if places > 0 {
            done.push(format!("random walks from {places} places"));
        }
        if rays > 0 {
            done.push(format!("{rays} rays of rows"));
        }
        if sights > 0 {
            done.push(format!("{sights} rays from place to place"));
        }
        if !done.is_empty() {
            observer.note(&format!("{phase}: {} on {}", done.join(", "), device.executor.device().name));
        }
    }

    /// Adds a row of counts of hits for each of the rows; with sky rows four, as [`add_quadrant_rows`] does. Returns
    /// their sky factors.
    ///
    /// # Errors
    /// Cancellation, what the device says.
    pub(crate) fn add(
        &self,
        counts: &mut HitCounts,
        sky: Option<(&mut HitCounts, &SkyBin)>,
        own: &ElementRows,
        report: &Report,
    ) -> Result<Vec<f32>, Error> {
        if let Some(rounds) = self.rounds {
            return rounds.add(counts, sky.map(|sky| sky.0), own);
        }
        let &ElementRows { scene, mesh, points, offsets, rays, seed } = own;
        let surfaces = mesh.lighting(scene, Columns::Elements, points, offsets, seed);
        let Some(mut device) = self.lock() else {
            return Ok(match sky {
                None => add_hit_rows(counts, &surfaces, rays, &report)?,
                Some(sky) => add_quadrant_rows(counts, sky, &surfaces, rays, &report)?,
            });
        };
        device.rays += u64::from(rays) * surfaces.rows() as u64;
        let cells = mesh.cell_columns(Columns::Elements);
        device.loaded = None;
        let mut tracer = RowTracer::new(device.executor, scene, cells, &surfaces, rays)?;
        let mut trace = |rows| tracer.columns(rows).map_err(Error::from);
        add_traced_rows(counts, sky, &surfaces, rays, &mut trace, &report)
    }

    fn lock(&self) -> Option<MutexGuard<'_, Device<'d>>> {
        // A plan is loaded anew for whatever comes next.
        self.device.as_ref().map(|device| device.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Walker for RowRays<'_> {
    fn reachability(
        &self,
        scene: &Scene,
        places: &[SurfacePoint],
        walks: u32,
        seed: u32,
    ) -> Result<Vec<u32>, patches::Error> {
        let too_many = |device: &Device| {
            let is_emulated = device.executor.device().kind == DeviceKind::EmulatedOnCpu;
            is_emulated && scene.lighting.lights.len() > MAX_EMULATED_LIGHTS
        };
        let Some(mut device) = self.lock().filter(|device| !too_many(device)) else {
            return Ok(places.par_iter().map(|place| reachability(scene, place, walks, seed)).collect());
        };
        device.reachability(scene, places, walks, seed).map_err(of_device)
    }

    fn stopped(&self, scene: &Scene, rays: &[Ray]) -> Result<Vec<u32>, patches::Error> {
        match self.lock() {
            Some(mut device) => device.stopped(scene, rays).map_err(of_device),
            None => {
                Ok(rays.par_iter().map(|ray| scene.occluded(ray.origin, ray.direction, ray.t_max).into()).collect())
            }
        }
    }
}

/// Converts a device's error on its way through `patches`.
fn of_device(error: ExecutorError) -> patches::Error {
    patches::Error::Rows(Box::new(Error::from(error)))
}

/// Form factors between patches, and between elements.
#[derive(Clone, Serialize, Deserialize)]
pub struct FormFactors {
    /// From patch to patch: means of the elements' rows.
    pub factors: Arc<Csr>,
    /// From element to element; none where the elements are the patches.
    pub element_rows: Option<Arc<HitCounts>>,
    /// Share of each element's hemisphere that sees no geometry.
    #[serde(with = "scene::pod::table")]
    pub sky_factor: Vec<f32>,
}

impl FormFactors {
    /// Estimates the form factors of a mesh.
    ///
    /// # Errors
    /// An estimator that needs outlines for patches that have none, cancellation.
    pub fn estimate(
        scene: &Scene,
        mesh: &PatchMesh,
        estimator: Estimator,
        seed: u32,
        report: &Report,
    ) -> Result<Self, Error> {
        Self::estimate_by(scene, mesh, (estimator, seed), &HOST, report)
    }

    /// [`FormFactors::estimate`]; rays of elements that are finer than patches are traced by the device, if there is
    /// one.
    ///
    /// # Errors
    /// As [`FormFactors::estimate`]; what the device says.
    pub(crate) fn estimate_by(
        scene: &Scene,
        mesh: &PatchMesh,
        (estimator, seed): (Estimator, u32),
        device: &RowRays,
        report: &Report,
    ) -> Result<Self, Error> {
        if !mesh.polygons.is_empty() {
            return Self::of_polygons(scene, mesh, estimator, seed, report);
        }
        let without_outlines = |estimator| Err(formfactor::Error::NoOutlines { estimator }.into());
        match estimator {
            Estimator::Hemisphere { rays } => Self::of_samples(scene, mesh, (rays, seed), device, report),
            Estimator::Contour => without_outlines("Contour"),
            Estimator::Area => without_outlines("AreaToArea"),
            Estimator::Point => without_outlines("PointToPoint"),
        }
    }

    /// Form factors of patches with outlines, made reciprocal and closed.
    fn of_polygons(
        scene: &Scene,
        mesh: &PatchMesh,
        estimator: Estimator,
        seed: u32,
        report: &Report,
    ) -> Result<Self, Error> {
        let estimator: Box<dyn formfactor::Estimator> = match estimator {
            Estimator::Hemisphere { rays } => Box::new(Hemisphere { rays }),
            Estimator::Contour => Box::new(Contour::default()),
            Estimator::Area => Box::new(AreaToArea::default()),
            Estimator::Point => Box::new(PointToPoint::default()),
        };
        let surfaces = mesh.surfaces(scene, seed);
        let mut rows = form_factors(&*estimator, &surfaces, &report)?;
        balance(&mut rows.factors, &mut rows.sky_factor, &mesh.areas(), None)?;
        let factors = Arc::new(rows.factors.to_csr(0.0)?);
        Ok(Self { factors, element_rows: None, sky_factor: rows.sky_factor })
    }

    /// Form factors of patches made of samples. No balance: their areas are estimates by samples, and reciprocity with
    /// them would make good rows worse.
    fn of_samples(
        scene: &Scene,
        mesh: &PatchMesh,
        (rays, seed): (u32, u32),
        device: &RowRays,
        report: &Report,
    ) -> Result<Self, Error> {
        let elements = mesh.elements.len();
        let rays = element_rays(rays, mesh);
        if elements == mesh.patches.len() {
            let rows = sparse_rows(&mesh.surfaces(scene, seed), rays, &report)?;
            let factors = Arc::new(rows.factors);
            return Ok(Self { factors, element_rows: None, sky_factor: rows.sky_factor });
        }
        let fine = ElementRows { scene, mesh, points: &mesh.points, offsets: &mesh.offsets, rays, seed };
        let mut rows = HitCounts::new(elements)?;
        let sky_factor = device.add(&mut rows, None, &fine, report)?;
        Self::of_rows(mesh, rows, sky_factor)
    }

    /// Form factors of a mesh whose elements have these rows.
    pub(crate) fn of_rows(mesh: &PatchMesh, rows: HitCounts, sky_factor: Vec<f32>) -> Result<Self, Error> {
        let patch: Vec<u32> = (0..mesh.elements.len() as u32).map(|element| mesh.patch_of(element)).collect();
        let factors = rows.means(&mesh.patch_elements, &mesh.element_shares(), &patch, mesh.patches.len())?;
        Ok(Self { factors: Arc::new(factors), element_rows: Some(Arc::new(rows)), sky_factor })
    }

    /// Operator that elements gather by.
    pub fn element_operator(&self) -> &dyn LinearOperator {
        match &self.element_rows {
            Some(rows) => &**rows,
            None => &*self.factors,
        }
    }

    /// Bytes of the form factors between patches.
    pub fn factor_bytes(&self) -> u64 {
        self.factors.bytes()
    }

    /// Bytes of what elements gather by beside what patches do: where `has_factors`, theirs are in a frame anyway.
    pub fn element_bytes(&self, has_factors: bool) -> u64 {
        match &self.element_rows {
            Some(rows) => rows.bytes(),
            None if has_factors => 0,
            None => self.factors.bytes(),
        }
    }
}

/// Rays of an element's row: as many in all as rows of the patches' own would take.
fn element_rays(rays: u32, mesh: &PatchMesh) -> u32 {
    let all = u64::from(rays) * mesh.patches.len() as u64;
    all.div_ceil(mesh.elements.len().max(1) as u64).max(MIN_ELEMENT_RAYS) as u32
}
