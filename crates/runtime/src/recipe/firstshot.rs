//! Recipe of `firstshot`: photons of a device, registered there, and what follows from their sums. Nothing is read back
//! but a pair of numbers for some 64 groups, where the error decides how many photons there are.

use firstshot::kernel::judge::JUDGED;
use firstshot::{
    AliasEntry, Element, Emission, JudgeParams, PhotonParams, ResolveParams, Sums, flux_words, relative_error,
    tally_words,
};
use glam::Vec2;
use gpu_kernels::table;

use super::scene::SceneTables;
use super::{Bindings, Named, add_pass};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{BufferId, PassId, Plan};

/// Buffers that photons are registered in, and their results.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PhotonTargets {
    /// Number of cells.
    pub cells: u32,
    /// Number of groups of cells.
    pub groups: u32,
    /// Number of elements, which own cells.
    pub elements: u32,
    /// Independent batches.
    pub batches: u32,
}

/// The passes, and the buffers that change.
#[derive(Clone, Copy, Debug)]
pub struct PhotonPasses {
    trace: PassId,
    judge: PassId,
    resolve: PassId,
    alias: BufferId,
    elements: BufferId,
    flux: BufferId,
    tallies: BufferId,
    judged: BufferId,
    targets: PhotonTargets,
    capacity: usize,
}

impl PhotonPasses {
    /// Adds the passes to a plan, with room for `capacity` elements that photons start from. `maps` are the bindings
    /// `grids`, `groups`, `group_areas`, `cell_start`, `cells`, `element_areas`, and `irradiance`, where that of the
    /// elements goes.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn add(
        plan: &mut Plan,
        scene: &SceneTables,
        maps: Bindings,
        targets: PhotonTargets,
        capacity: usize,
    ) -> Result<Self, ExecutorError> {
        let PhotonTargets { cells, groups, elements: count, batches } = targets;
        let mut words = |name: &str, count: usize| plan.storage(name, 4 * count as u64);
        let flux = words("flux", flux_words(cells as usize));
        let tallies = words("tallies", tally_words(groups as usize, batches));
        let blocks = groups.div_ceil(JUDGED);
        let judged = plan.storage("judged", u64::from(blocks) * size_of::<Vec2>() as u64);
        let alias = plan.storage("alias", (capacity * size_of::<AliasEntry>()) as u64);
        let elements = plan.storage("photon sources", (capacity * size_of::<Element>()) as u64);
        let changing: [Named; 5] = [
            ("flux", flux.into()),
            ("tallies", tallies.into()),
            ("judged", judged.into()),
            ("alias", alias.into()),
            ("elements", elements.into()),
        ];
        let own: Vec<Named> = changing.iter().chain(maps).copied().collect();
        let photons = PhotonParams { count: 1, per_batch: 1, ..PhotonParams::default() };
        let trace = add_pass(plan, "method", &table::FIRSTSHOT_TRACE, &own, scene.bindings(), &photons, 1)?;
        let p = JudgeParams { count: blocks, group_count: groups, batches };
        let judge = add_pass(plan, "method", &table::FIRSTSHOT_JUDGE, &own, &[], &p, blocks)?;
        let p = ResolveParams { count, mean_flux: 0.0 };
        let resolve = add_pass(plan, "method", &table::FIRSTSHOT_RESOLVE, &own, &[], &p, count)?;
        Ok(Self { trace, judge, resolve, alias, elements, flux, tallies, judged, targets, capacity })
    }

    /// Returns true if there is room for what photons start from.
    pub fn fits(&self, emission: &Emission) -> bool {
        emission.elements.len() <= self.capacity
    }

    /// Puts what photons start from on the device and forgets what was registered.
    ///
    /// # Errors
    /// More than there is room for; what the device says.
    pub fn start(&self, executor: &mut (dyn Executor + 'static), emission: &Emission) -> Result<(), ExecutorError> {
        executor.upload(self.alias, &emission.alias)?;
        executor.upload(self.elements, &emission.elements)?;
        executor.clear(self.flux)?;
        executor.clear(self.tallies)
    }

    /// Puts sums on the device that were found before.
    ///
    /// # Errors
    /// What the device says.
    pub fn restore(&self, executor: &mut (dyn Executor + 'static), sums: &Sums) -> Result<(), ExecutorError> {
        let (flux, tallies) = sums.words();
        executor.upload(self.flux, &flux)?;
        executor.upload(self.tallies, &tallies)
    }

    /// Submits a dispatch of photons; waits for nothing.
    ///
    /// # Errors
    /// What the device says.
    pub fn trace(&self, executor: &mut (dyn Executor + 'static), p: &PhotonParams) -> Result<(), ExecutorError> {
        executor.push(self.trace, p)?;
        executor.set_elements(self.trace, p.count)?;
        executor.submit_passes(&[self.trace])
    }

    /// The relative error of what was registered; waits for it.
    ///
    /// # Errors
    /// What the device says.
    pub fn relative_error(&self, executor: &mut (dyn Executor + 'static)) -> Result<f64, ExecutorError> {
        executor.submit_passes(&[self.judge])?;
        let judged: Vec<Vec2> = executor.download_table(self.judged)?;
        Ok(relative_error(judged.into_iter()))
    }

    /// Submits the irradiance of the elements from what was registered, with the mean flux of a photon, W; waits for
    /// nothing.
    ///
    /// # Errors
    /// What the device says.
    pub fn resolve(&self, executor: &mut (dyn Executor + 'static), mean_flux: f32) -> Result<(), ExecutorError> {
        let p = ResolveParams { count: self.targets.elements, mean_flux };
        executor.push(self.resolve, &p)?;
        executor.submit_passes(&[self.resolve])
    }

    /// The words of the sums, of flux and of tallies, for [`Sums::from_words`]; waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn words(&self, executor: &mut (dyn Executor + 'static)) -> Result<(Vec<u32>, Vec<u32>), ExecutorError> {
        Ok((executor.download_table(self.flux)?, executor.download_table(self.tallies)?))
    }
}
