//! Levels of a bake that is refined: coarse light at once, then finer, up to the settings asked for.

use std::sync::Arc;

use patches::PatchKind;
use rayon::ThreadPool;
use runtime::cpu::Cpu;
use runtime::executor::Executor;
use scene::Scene;
use transport::Observer;

use crate::bake::{Bake, BakeSettings, PatchBake, cut_scene, density_of};
use crate::error::Error;
use crate::form_factors::{Estimator, RowRays};
use crate::job::Shared;
use crate::low_level::operator::{BakedOperator, Build, Decode, OperatorKey};
use crate::method::{MethodSettings, Preparation};
use crate::settings::setters;

/// Receivers of a level over those of the one before it, patches over those, and rays of each.
const RECEIVER_STEP: usize = 4;
const PATCH_STEP: usize = 3;
const RAY_STEP: u32 = 2;
/// Fewest patches of a coarse level: what too few patches of a hall get wrong no receivers mend, and this many cost
/// little beside them.
const MIN_PATCHES: usize = 1000;
/// Fewest rays of a row of patches and of receivers.
const MIN_ROW_RAYS: u32 = 512;
const MIN_RECEIVER_RAYS: u32 = 128;
/// Most levels before the last, and patches whose receivers, were they all, are enough for one.
const MAX_COARSE: u32 = 2;
const MIN_SHARE: usize = 60;

/// Work of [`Bake::refine`] beside the bake itself.
#[derive(Default)]
#[non_exhaustive]
pub struct Refinement {
    /// Methods whose operators each level gets.
    pub methods: Vec<MethodSettings>,
    /// Place and memory in which they are built.
    pub build: Build,
    /// Threads; `None` for a pool of the job's own, with as many as the caller's.
    pub pool: Option<Arc<ThreadPool>>,
    /// A device that traces rays and builds operators, as in [`Bake::build_on`]: another one than that of the frames.
    /// `None` for the host.
    pub device: Option<Box<dyn Executor>>,
}

setters!(Refinement {
    /// With methods whose operators each level gets.
    with_methods(methods: Vec<MethodSettings>);
    /// With a place where operators are built.
    with_build(build: Build);
    /// With a pool of threads.
    with_pool(pool: Option<Arc<ThreadPool>>);
    /// With a device.
    with_device(device: Option<Box<dyn Executor>>);
});

/// Settings of the levels of [`Bake::refine`], the coarsest first and those asked for last: each has a quarter of the
/// receivers of the next, half of the rays of each, and a third of the patches, but at least a thousand. Polygon patches
/// are the triangles of the scene, and have one level.
pub fn levels(settings: &BakeSettings) -> Vec<BakeSettings> {
    let most = if settings.patches == PatchKind::Polygon { 0 } else { MAX_COARSE };
    let coarse = (1..=most).rev().filter(|&k| settings.patch_count / RECEIVER_STEP.pow(k) >= MIN_SHARE);
    coarse.map(|k| coarser(settings, k)).chain([*settings]).collect()
}

/// The level that is so many before the last.
fn coarser(last: &BakeSettings, steps: u32) -> BakeSettings {
    let fewer_rays = |rays: u32, least: u32| (rays / RAY_STEP.pow(steps)).max(least.min(rays));
    let estimator = match last.estimator {
        Estimator::Hemisphere { rays } => Estimator::Hemisphere { rays: fewer_rays(rays, MIN_ROW_RAYS) },
        other => other,
    };
    let patch_count = (last.patch_count / PATCH_STEP.pow(steps)).max(MIN_PATCHES.min(last.patch_count));
    let receivers = RECEIVER_STEP.pow(steps);
    // There are so many receivers for each patch.
    let of_patch = last.patch_count as f32 / (patch_count * receivers) as f32;
    let edges = (receivers as f32).sqrt();
    BakeSettings {
        patch_count,
        voxel_size: last.voxel_size.map(|edge| edge * (PATCH_STEP.pow(steps) as f32).sqrt()),
        estimator,
        receiver_density: last.receiver_density * of_patch,
        receiver_rays: fewer_rays(last.receiver_rays, MIN_RECEIVER_RAYS),
        receiver_edge: last.receiver_edge.map(|edge| edge * edges),
        most_receivers: last.most_receivers.map(|most| most.div_ceil(receivers)),
        ..*last
    }
}

/// Work of a level, in a unit of its own: rays of receivers, of which there are so many for each patch.
fn work(settings: &BakeSettings) -> f32 {
    settings.patch_count as f32 * settings.receiver_density * settings.receiver_rays as f32
}

/// Makes the levels one after the other, and publishes all but the last, which it returns.
pub(crate) fn refine(
    scene: &Scene,
    settings: &BakeSettings,
    refinement: Refinement,
    shared: &Shared,
) -> Result<Arc<Bake>, Error> {
    let Refinement { methods, build, device, .. } = refinement;
    let mut device = device.unwrap_or_else(|| Box::new(Cpu::new()));
    // Where the light is wanted, and where something stands on a surface, is the same on all levels.
    let density = density_of(scene, settings, shared)?;
    let cut = cut_scene(scene, &density, settings)?;
    let scene = cut.as_ref().unwrap_or(scene);
    let levels = levels(settings);
    let all: f32 = levels.iter().map(work).sum();
    let mut before = 0.0;
    let mut make = |k: usize| {
        let level = &levels[k];
        let own = work(level) / all.max(f32::MIN_POSITIVE);
        shared.begin_level(k, levels.len(), before, own);
        before += own;
        let rays = RowRays::on(device.as_mut());
        let patches = PatchBake::with_density(scene, density, level, &rays, shared)?;
        let mut bake = patches.with_receivers_by(level, &rays, shared)?;
        drop(rays);
        bake.build_operators(&methods, &build, device.as_mut(), shared)?;
        Ok::<_, Error>(Arc::new(bake))
    };
    for k in 0..levels.len() - 1 {
        shared.publish(make(k)?);
    }
    make(levels.len() - 1)
}

/// Edits a bake, and makes its operators again.
pub(crate) fn edit(
    before: &Bake,
    scene: &Scene,
    refinement: Refinement,
    observer: &dyn Observer,
) -> Result<Arc<Bake>, Error> {
    let Refinement { methods, build, device, .. } = refinement;
    let mut device = device.unwrap_or_else(|| Box::new(Cpu::new()));
    let mut bake = before.edit(scene, observer)?.bake;
    let keys: Vec<OperatorKey> = before.operators.iter().map(|baked| baked.key).collect();
    bake.make_operators(&keys, &build, device.as_mut(), observer)?;
    bake.build_operators(&methods, &build, device.as_mut(), observer)?;
    Ok(Arc::new(bake))
}

impl Bake {
    /// Builds the operators of methods that it does not have yet, so that these begin with the first frame; `device` may
    /// build them. Methods that do not serve the scene, and those without an operator, are passed over.
    ///
    /// # Errors
    /// An operator that does not fit into memory, cancellation.
    pub fn build_operators(
        &mut self,
        methods: &[MethodSettings],
        build: &Build,
        device: &mut (dyn Executor + 'static),
        observer: &dyn Observer,
    ) -> Result<(), Error> {
        let serving = methods.iter().filter(|method| method.check_medium(&self.scene).is_ok());
        let keys = OperatorKey::of_all(serving, &self.settings);
        self.make_operators(&keys, build, device, observer)
    }

    /// Builds the operators with these keys that it does not have yet.
    pub(crate) fn make_operators(
        &mut self,
        keys: &[OperatorKey],
        build: &Build,
        device: &mut (dyn Executor + 'static),
        observer: &dyn Observer,
    ) -> Result<(), Error> {
        if self.mesh.patches.is_empty() {
            return Ok(());
        }
        let shared = Arc::new(self.clone());
        let eye = glam::Vec3::ZERO;
        let with = Preparation { bake: &shared, decode: Decode::Auto, build, eye, observer };
        for &key in keys {
            if !self.operators.iter().any(|baked| baked.key == key) {
                let operator = key.find_or_build(&with, device)?;
                self.operators.push(BakedOperator { key, operator });
            }
        }
        Ok(())
    }
}
