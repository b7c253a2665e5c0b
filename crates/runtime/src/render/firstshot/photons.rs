//! Photons by the kernels of a device: a plan of one start and one segment, run until no photon is left.

use firstshot::{AliasEntry, Element, Emission, Landing, Photon, PhotonParams};
use glam::Vec3;
use gpu_kernels::table;
use scene::{NONE, Scene};

use crate::error::Error;
use crate::executor::{Executor, ExecutorError};
use crate::plan::{BufferId, PassId, Plan, Range};

/// Photons of one dispatch: what the tracer asks for in a round.
const MOST_PHOTONS: u32 = 1 << 18;
/// Segments after which a photon is given up; at the greatest reflectance one in 10¹¹ has more.
const MOST_SEGMENTS: usize = 512;

/// The passes and their tables on a device.
pub struct PhotonPasses {
    executor: Box<dyn Executor>,
    loaded: Option<Loaded>,
}

struct Loaded {
    start: PassId,
    segment: PassId,
    landings: BufferId,
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
    pub fn load(&mut self, scene: &Scene, emission: &Emission) -> Result<(), Error> {
        if emission.is_dark() {
            return Ok(());
        }
        let mut plan = Plan::new();
        let sky = [scene.sky];
        let tables: Vec<(&'static str, &[u8])> = vec![
            ("alias", bytemuck::cast_slice::<AliasEntry, u8>(&emission.alias)),
            ("elements", bytemuck::cast_slice::<Element, u8>(&emission.elements)),
            ("nodes", bytemuck::cast_slice(&scene.nodes)),
            ("triangles", bytemuck::cast_slice(&scene.triangles)),
            ("uvs", bytemuck::cast_slice(&scene.uvs)),
            ("materials", bytemuck::cast_slice(&scene.materials)),
            ("textures", bytemuck::cast_slice(&scene.textures)),
            ("texels", bytemuck::cast_slice(&scene.texels)),
            ("lights", bytemuck::cast_slice(&scene.lights)),
            ("sky", bytemuck::cast_slice(&sky)),
            ("sky_map", bytemuck::cast_slice(&scene.sky_map)),
        ];
        let buffers: Vec<(&'static str, BufferId)> =
            tables.iter().map(|(name, bytes)| (*name, plan.storage(*name, bytes.len() as u64))).collect();
        let photons = plan.storage("photons", u64::from(MOST_PHOTONS) * size_of::<Photon>() as u64);
        let landings = plan.storage("landings", u64::from(MOST_PHOTONS) * size_of::<Landing>() as u64);
        let mut pass = |name: &str, kernel: &'static table::Kernel| -> Result<PassId, Error> {
            let own = [("photons", photons), ("landings", landings)];
            let find =
                |name: &str| own.iter().chain(&buffers).find(|(n, _)| *n == name).map(|(_, id)| Range::from(*id));
            let bindings: Vec<Range> = kernel.bindings.iter().map_while(|b| find(b.name)).collect();
            let params = PhotonParams { count: MOST_PHOTONS, per_batch: 1, ..PhotonParams::default() };
            Ok(plan.pass(name, kernel, &bindings, &params, MOST_PHOTONS).map_err(ExecutorError::from)?)
        };
        let start = pass("start", &table::FIRSTSHOT_START)?;
        let segment = pass("segment", &table::FIRSTSHOT_SEGMENT)?;
        self.executor.load(plan)?;
        for ((_, bytes), (_, buffer)) in tables.iter().zip(&buffers) {
            if !bytes.is_empty() {
                self.executor.upload_at(*buffer, 0, bytes)?;
            }
        }
        self.loaded = Some(Loaded { start, segment, landings });
        Ok(())
    }

    /// The landings of a dispatch of at most 2¹⁸ photons, segment by segment.
    ///
    /// # Errors
    /// [`Error::Photons`] for more than that, and what the device says.
    pub fn trace(&mut self, p: &PhotonParams) -> Result<Vec<Landing>, Error> {
        if p.count > MOST_PHOTONS {
            let (found, limit) = (u64::from(p.count), u64::from(MOST_PHOTONS));
            return Err(Error::Photons(transport::Error::TooMany { name: "photons of a dispatch", found, limit }));
        }
        let Some(Loaded { start, segment, landings }) = self.loaded else { return Ok(Vec::new()) };
        for pass in [start, segment] {
            self.executor.push(pass, p)?;
            self.executor.set_elements(pass, p.count)?;
        }
        self.executor.run_passes(&[start])?;
        let mut all: Vec<Landing> = Vec::new();
        for _ in 0..MOST_SEGMENTS {
            self.executor.run_passes(&[segment])?;
            let found: Vec<Landing> = self.executor.download_table(landings)?;
            let before = all.len();
            all.extend(found[..p.count as usize].iter().filter(|l| l.flux != Vec3::ZERO).copied());
            if all[before..].iter().all(|l| l.triangle == NONE) {
                break;
            }
        }
        Ok(all)
    }
}
