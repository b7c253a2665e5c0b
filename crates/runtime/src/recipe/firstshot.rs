//! Recipe of `firstshot`: photons of a device, registered there, and what follows from their sums. Nothing is read back
//! but a pair of numbers for some 64 groups, where the error decides how many photons there are.

use firstshot::kernel::judge::JUDGED;
use firstshot::{
    AliasEntry, Element, Emission, JudgeParams, MapGrid, PhotonParams, ResolveParams, Sums, flux_words, relative_error,
    tally_words,
};
use glam::Vec2;
use gpu_kernels::firstshot::{JudgePass, ResolvePass, TracePass};
use scene::Rgb;

use super::scene::SceneTables;
use crate::executor::{Executor, ExecutorError};
use crate::plan::{LightSlices, PassId, Plan, Slice};

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

/// Illumination maps on a device.
#[derive(Clone, Copy, Debug)]
pub struct MapSlices {
    /// Grid of cells of each triangle.
    pub grids: Slice<MapGrid>,
    /// Group of each cell.
    pub groups: Slice<u32>,
    /// Area of each group, m².
    pub group_areas: Slice<f32>,
    /// First cell of each element in `cells`, and the end of the last.
    pub cell_start: Slice<u32>,
    /// Cells of the elements.
    pub cells: Slice<u32>,
    /// Area of each element, m².
    pub element_areas: Slice<f32>,
    /// Irradiance of each element, W/m², the result.
    pub irradiance: Slice<Rgb>,
}

/// The passes, and the buffers that change.
#[derive(Clone, Copy, Debug)]
pub struct PhotonPasses {
    trace: PassId,
    judge: PassId,
    resolve: PassId,
    alias: Slice<AliasEntry>,
    elements: Slice<Element>,
    flux: Slice<u32>,
    tallies: Slice<u32>,
    judged: Slice<Vec2>,
    targets: PhotonTargets,
    capacity: usize,
}

impl PhotonPasses {
    /// Adds the passes to a plan, with room for `capacity` elements that photons start from.     ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn add(
        plan: &mut Plan,
        scene: &SceneTables,
        maps: &MapSlices,
        targets: PhotonTargets,
        capacity: usize,
    ) -> Result<Self, ExecutorError> {
        let PhotonTargets { cells, groups, elements: count, batches } = targets;
        let flux = plan.array("flux", flux_words(cells as usize));
        let tallies = plan.array("tallies", tally_words(groups as usize, batches));
        let blocks = groups.div_ceil(JUDGED);
        let judged = plan.array("judged", blocks as usize);
        let alias = plan.array("alias", capacity);
        let elements = plan.array("photon sources", capacity);
        let MapSlices { grids, groups: groups_of_cells, group_areas, .. } = *maps;
        let LightSlices { lights, sky, sky_map, distributions, .. } = scene.lights;
        let photons = TracePass {
            alias,
            elements,
            geometry: scene.geometry,
            lights,
            sky,
            sky_map,
            distributions,
            grids,
            groups: groups_of_cells,
            flux,
            tallies,
        };
        let push = PhotonParams { count: 1, per_batch: 1, ..PhotonParams::default() };
        let trace = plan.add("method", &photons, &push)?;
        let push = JudgeParams { count: blocks, group_count: groups, batches };
        let judge = plan.add("method", &JudgePass { tallies, group_areas, judged }, &push)?;
        let MapSlices { cell_start, cells, element_areas, irradiance, .. } = *maps;
        let light = ResolvePass { flux, cell_start, cells, element_areas, irradiance };
        let resolve = plan.add("method", &light, &ResolveParams { count, mean_flux: 0.0 })?;
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
        executor.clear(self.flux.buffer)?;
        executor.clear(self.tallies.buffer)
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
        executor.submit_passes(&[self.trace])
    }

    /// The relative error of what was registered; waits for it.
    ///
    /// # Errors
    /// What the device says.
    pub fn relative_error(&self, executor: &mut (dyn Executor + 'static)) -> Result<f64, ExecutorError> {
        executor.submit_passes(&[self.judge])?;
        let judged = executor.download_table(self.judged)?;
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
