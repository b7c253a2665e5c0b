//! Recipe of `firstshot`: photons by the kernels of a device, one start and one segment, run until no photon is left.

use firstshot::{Emission, Photon, PhotonHit, PhotonParams};
use glam::Vec3;
use gpu_kernels::table;
use scene::{NONE, Scene};

use super::scene::SceneTables;
use super::{Named, Tables, add_pass};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{BufferId, PassId, Plan, Range};

/// Photons of one dispatch: what the tracer asks for in a round.
pub const MOST_PHOTONS: u32 = 1 << 18;
/// Segments after which a photon is given up; at the greatest reflectance one in 10¹¹ has more.
const MOST_SEGMENTS: usize = 512;

/// The passes and their tables on a device of their own.
pub struct PhotonPasses {
    executor: Box<dyn Executor>,
    loaded: Option<Loaded>,
}

#[derive(Clone, Copy)]
struct Loaded {
    start: PassId,
    segment: PassId,
    hits: BufferId,
}

impl PhotonPasses {
    /// No plan yet.
    pub fn new(executor: Box<dyn Executor>) -> Self {
        Self { executor, loaded: None }
    }

    /// Makes the plan and uploads the scene and what photons start from.
    ///
    /// # Errors
    /// What the device says: a scene too large for it, say.
    pub fn load(&mut self, scene: &Scene, emission: &Emission) -> Result<(), ExecutorError> {
        if emission.is_dark() {
            return Ok(());
        }
        let mut plan = Plan::new();
        let mut tables = Tables::new();
        let scene_tables = SceneTables::new(&mut plan, &mut tables, scene, scene.lighting.lights.len().max(1));
        let photons = plan.storage("photons", u64::from(MOST_PHOTONS) * size_of::<Photon>() as u64);
        let hits = plan.storage("photon hits", u64::from(MOST_PHOTONS) * size_of::<PhotonHit>() as u64);
        let own: [Named; 4] = [
            tables.named(&mut plan, "alias", emission.alias.clone()),
            tables.named(&mut plan, "elements", emission.elements.clone()),
            ("photons", Range::from(photons)),
            ("photon_hits", Range::from(hits)),
        ];
        let params = PhotonParams { count: MOST_PHOTONS, per_batch: 1, ..PhotonParams::default() };
        let shared = scene_tables.bindings();
        let start = add_pass(&mut plan, "start", &table::FIRSTSHOT_START, &own, shared, &params, MOST_PHOTONS)?;
        let segment = add_pass(&mut plan, "segment", &table::FIRSTSHOT_SEGMENT, &own, shared, &params, MOST_PHOTONS)?;
        let executor = self.executor.as_mut();
        executor.load(plan)?;
        tables.upload(executor)?;
        scene_tables.set_lights(executor, &scene.lighting.lights)?;
        scene_tables.set_sky_and_emission(executor, scene)?;
        self.loaded = Some(Loaded { start, segment, hits });
        Ok(())
    }

    /// Where the photons of a dispatch of at most [`MOST_PHOTONS`] hit, segment by segment.
    ///
    /// # Errors
    /// More photons than that, and what the device says.
    pub fn trace(&mut self, p: &PhotonParams) -> Result<Vec<PhotonHit>, ExecutorError> {
        let Some(Loaded { start, segment, hits }) = self.loaded else { return Ok(Vec::new()) };
        for pass in [start, segment] {
            self.executor.push(pass, p)?;
            self.executor.set_elements(pass, p.count)?;
        }
        self.executor.run_passes(&[start])?;
        let mut all: Vec<PhotonHit> = Vec::new();
        for _ in 0..MOST_SEGMENTS {
            self.executor.run_passes(&[segment])?;
            let found: Vec<PhotonHit> = self.executor.download_table(hits)?;
            let before = all.len();
            all.extend(found[..p.count as usize].iter().filter(|hit| hit.flux != Vec3::ZERO).copied());
            if all[before..].iter().all(|hit| hit.triangle == NONE) {
                break;
            }
        }
        Ok(all)
    }
}
