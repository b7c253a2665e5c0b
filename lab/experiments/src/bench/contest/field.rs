//! Who takes part: the project's own methods, its classic baselines on the same patches, and opponents.

use std::sync::Arc;
use std::time::Instant;

use opponents::{DdgiSettings, IrradianceVolume, LpvSettings, Spacing, VolumeSettings};
use patches::PatchKind;

use super::View;
use super::contender::{Contender, OwnPatches, Paths, Time, Volumetric, has_graphics_processor};
use crate::error::Error;
use crate::progress::Progress;
use crate::proxy::ProxySettings;
use patchlight::low_level::operator::Codec;
use patchlight::method::TemporalSettings;
use patchlight::{Bake, BakeSettings, Estimator, MethodSettings};
use solvers::{Links, Samples, Solver};

/// Kinds of the project's own methods.
pub const OWN: [&str; 2] = ["tiles 1 %", "temporal"];
/// Products with sparse form factors, one a bounce.
pub const GATHERING: &str = "gathering";
/// Relative error of the compressed operator.
const EPSILON: f64 = 0.01;
/// Samples of Monte Carlo radiosity for each patch.
const SAMPLES: u32 = 100;
/// Rays to area lights from each point of the proxy's faces.
const PROXY_RAYS: u32 = 16;
/// Scenes that are smaller need no nested grids for light that is propagated, m.
const ONE_GRID: f32 = 40.0;
/// Cells along the longest axis of grids of light that is propagated.
const CELLS: [u32; 2] = [16, 32];
/// Light updates of a trial; the last one counts.
const TRIALS: u32 = 3;
/// Probes of which the memory is that of the project's own methods are at most as many as take so many times their
/// time.
const MAX_TIME: f64 = 10.0;
/// Least and most probes of a grid that is chosen by time or memory.
const PROBES: (f64, f64) = (8.0, 32_768.0);
/// Polygons are whole triangles: where there are more of these than so many times the patches, they are no like of
/// clusters.
const MAX_POLYGONS: usize = 2;
/// Probes of a volume that is baked anew in every light update, at most.
const MAX_BAKED: usize = 4096;
/// Ending of the names of the project's own methods with a fraction of their memory: patches and rays are so many times
/// fewer. What is asked of these settings is the memory of the best probes, not the least error.
const SMALL: &str = ", small";
const FEWER_PATCHES: usize = 6;
const FEWER_RAYS: u32 = 4;
/// Paths a pixel in pictures that are denoised, beside those at equal time, are so many times as many.
const MORE_PATHS: u32 = 8;

/// A list of contenders.
pub type Contenders<'a> = Vec<Box<dyn Contender + 'a>>;

/// Method between patches.
#[derive(Clone, Copy)]
pub enum Between {
    /// By a method of the library.
    Method(MethodSettings),
    /// By a classic solver.
    Solver(Solver),
}

/// A method of patches.
#[derive(Clone, Copy)]
pub struct PatchMethod {
    pub name: &'static str,
    pub between: Between,
}

impl PatchMethod {
    /// A method of the library.
    pub fn of(name: &'static str, settings: MethodSettings) -> Self {
        Self { name, between: Between::Method(settings) }
    }

    /// The project's own methods, then gathering with sparse rows and Monte Carlo radiosity.
    pub fn usual(patches: usize, seed: u32) -> [Self; 4] {
        let samples = Samples { count: SAMPLES * patches as u32, seed };
        [
            Self::of(OWN[0], MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON })),
            Self::of(OWN[1], MethodSettings::Temporal(TemporalSettings::default())),
            Self::of(GATHERING, MethodSettings::Classic),
            Self { name: "Monte Carlo", between: Between::Solver(Solver::StochasticJacobi(samples)) },
        ]
    }

    /// Methods that need a matrix with an entry for each pair of patches: the dense product with the operator of all
    /// bounces, and progressive shooting.
    pub fn dense() -> [Self; 2] {
        [
            Self::of("dense product", MethodSettings::Multibounce(Codec::Dense)),
            Self { name: "shooting", between: Between::Solver(Solver::Shooting) },
        ]
    }

    /// Bytes of the dense matrices that it is made with, at their peak.
    pub fn matrix_bytes(&self, patches: usize) -> f64 {
        match self.between {
            // Also where tiles are kept of it: two operators, form factors, three of the solver.
            Between::Method(MethodSettings::Multibounce(_)) => 6.0 * size_of::<f32>() as f64 * (patches as f64).powi(2),
            Between::Method(_) => 0.0,
            Between::Solver(solver) => solver.matrix_bytes(patches),
        }
    }
}

/// Inputs of the contenders of a view.
pub struct Field<'a> {
    view: &'a View<'a>,
    bake: Arc<Bake>,
    bake_s: f64,
    progress: &'a Progress,
}

impl<'a> Field<'a> {
    /// Bakes the patches that the project's own methods and the classic baselines share.
    pub fn new(view: &'a View<'a>, settings: &BakeSettings, progress: &'a Progress) -> Result<Self, Error> {
        let start = Instant::now();
        let bake = Arc::new(Bake::build(&view.loaded.scene, settings, progress)?);
        Ok(Self { bake_s: start.elapsed().as_secs_f64(), ..Self::of_bake(view, &bake, progress) })
    }

    /// With a bake that is there.
    pub fn of_bake(view: &'a View<'a>, bake: &Arc<Bake>, progress: &'a Progress) -> Self {
        Self { view, bake: Arc::clone(bake), bake_s: 0.0, progress }
    }

    /// The bake of the patches.
    pub fn bake(&self) -> &Arc<Bake> {
        &self.bake
    }

    /// Everybody: DDGI at all spacings and numbers of rays, at equal time and at the nearest memory; paths at equal
    /// time and more; and who cannot take part, and why.
    pub fn all(&self) -> Result<(Contenders<'a>, Vec<String>), Error> {
        let View { args, .. } = *self.view;
        let mut list = self.patches()?;
        list.extend(self.small()?);
        for method in PatchMethod::dense() {
            list.push(self.radiosity(&self.bake, self.bake_s, method)?);
        }
        let mut left_out = Vec::new();
        match self.hierarchical()? {
            Ok(contender) => list.push(contender),
            Err(why) => left_out.push(why),
        }
        list.push(self.voxel_proxy()?);
        let own_ms = self.trial(list[0].as_mut())?;
        let own_bytes = list[0].bytes();
        for &metres in &args.spacings {
            for &rays in &args.probe_rays {
                list.push(Box::new(Volumetric::ddgi(self.view, self.probes(self.metres(metres), rays), "")?));
            }
        }
        self.add_equal_probes(own_ms, own_bytes, &mut list)?;
        for cells in CELLS {
            list.push(self.propagation(cells)?);
        }
        for bands in [1, 2] {
            list.push(self.baked_volume(bands)?);
        }
        let one_ms = self.trial(&mut Paths::new(self.view, 1, false)?)?;
        let equal = ((own_ms / one_ms) as u32).max(1);
        for samples in [equal, MORE_PATHS * equal] {
            for is_denoised in [false, true] {
                list.push(Box::new(Paths::new(self.view, samples, is_denoised)?));
            }
        }
        Ok((list, left_out))
    }

    /// One of each kind, each with another name of its kind: DDGI at the finest spacing and the fewest rays that are
    /// asked for.
    pub fn one_of_each(&self) -> Result<Contenders<'a>, Error> {
        let mut list = self.patches()?;
        list.push(self.voxel_proxy()?);
        list.push(self.finest_probes()?);
        list.push(self.propagation(CELLS[0])?);
        list.push(self.baked_volume(2)?);
        list.push(Box::new(Paths::new(self.view, 1, true)?));
        Ok(list)
    }

    /// DDGI at the finest spacing and the fewest rays that are asked for.
    pub fn finest_probes(&self) -> Result<Box<dyn Contender + 'a>, Error> {
        let rays = self.view.args.probe_rays.iter().copied().min().unwrap_or(DdgiSettings::default().rays);
        Ok(Box::new(Volumetric::ddgi(self.view, self.probes(self.metres(self.finest()), rays), "")?))
    }

    /// Contenders that need a bake: [`PatchMethod::usual`].
    pub fn patches(&self) -> Result<Contenders<'a>, Error> {
        self.with_patches(&PatchMethod::usual(self.bake.mesh().patches.len(), self.view.common.seed))
    }

    /// Some methods of patches.
    pub fn with_patches(&self, methods: &[PatchMethod]) -> Result<Contenders<'a>, Error> {
        methods.iter().map(|method| self.radiosity(&self.bake, self.bake_s, *method)).collect()
    }

    fn radiosity(&self, bake: &Arc<Bake>, bake_s: f64, method: PatchMethod) -> Result<Box<dyn Contender + 'a>, Error> {
        Ok(Box::new(OwnPatches::new(self.view, bake, bake_s, method, "")?))
    }

    /// The project's own methods with fewer patches, fewer receivers, and fewer rays from each.
    fn small(&self) -> Result<Contenders<'a>, Error> {
        let View { common, args, loaded, .. } = *self.view;
        let settings = self
            .bake
            .settings()
            .with_patch_count((self.bake.mesh().patches.len() / FEWER_PATCHES).max(1))
            .with_estimator(Estimator::Hemisphere { rays: (args.rays / FEWER_RAYS).max(1) })
            .with_receiver_rays((args.receiver_rays() / FEWER_RAYS).max(1));
        let start = Instant::now();
        let bake = Arc::new(Bake::build(&loaded.scene, &settings, self.progress)?);
        let bake_s = start.elapsed().as_secs_f64();
        let own = PatchMethod::usual(settings.patch_count, common.seed)
            .into_iter()
            .filter(|method| OWN.contains(&method.name));
        let contender = |method| OwnPatches::new(self.view, &bake, bake_s, method, SMALL);
        own.map(|method| Ok(Box::new(contender(method)?) as Box<dyn Contender + 'a>)).collect()
    }

    /// Links between parts of polygons, which have a bake of their own, or why there is none.
    fn hierarchical(&self) -> Result<Result<Box<dyn Contender + 'a>, String>, Error> {
        let scene = &self.view.loaded.scene;
        let triangles = scene.geometry.triangles.len();
        let patches = self.bake.mesh().patches.len();
        if triangles > MAX_POLYGONS * patches {
            return Ok(Err(format!("hierarchical radiosity, whose patches are parts of the {triangles} triangles")));
        }
        let settings = self.bake.settings().with_patches(PatchKind::Polygon);
        let start = Instant::now();
        let bake = Arc::new(Bake::build(scene, &settings, self.progress)?);
        let method =
            PatchMethod { name: "hierarchical", between: Between::Solver(Solver::Hierarchical(Links::default())) };
        self.radiosity(&bake, start.elapsed().as_secs_f64(), method).map(Ok)
    }

    /// As many faces as there are patches.
    fn voxel_proxy(&self) -> Result<Box<dyn Contender + 'a>, Error> {
        let View { common, args, .. } = *self.view;
        let patch_count = self.bake.mesh().patches.len();
        let settings = ProxySettings { patch_count, rays: args.rays, point_rays: PROXY_RAYS, seed: common.seed };
        Ok(Box::new(Volumetric::voxel_proxy(self.view, settings, self.progress)?))
    }

    fn probes(&self, spacing: Spacing, rays: u32) -> DdgiSettings {
        let View { common, two_sided, .. } = *self.view;
        DdgiSettings { spacing, rays, two_sided, seed: common.seed, ..DdgiSettings::default() }
    }

    fn metres(&self, metres: f32) -> Spacing {
        Spacing::Metres(metres * self.view.share())
    }

    /// The finest spacing that is asked for, m.
    fn finest(&self) -> f32 {
        self.view.args.spacings.iter().copied().fold(f32::INFINITY, f32::min)
    }

    /// As many probes as take the time of the project's own methods, and as many as fill their memory.
    fn add_equal_probes(&self, own_ms: f64, own_bytes: u64, list: &mut Contenders<'a>) -> Result<(), Error> {
        let Some(&rays) = self.view.args.probe_rays.first() else { return Ok(()) };
        let mut trial = Volumetric::ddgi(self.view, self.probes(self.metres(self.finest()), rays), "")?;
        let ms = self.trial(&mut trial)?.max(1e-3);
        let probes = trial.probe_count() as f64;
        let by_time = probes * own_ms / ms;
        let by_memory = probes * own_bytes as f64 / trial.bytes().max(1) as f64;
        let most = if self.view.args.quick { by_time } else { MAX_TIME * by_time };
        for (count, label) in [(by_time, ", time of tiles"), (by_memory.min(most), ", towards memory of tiles")] {
            let count = count.clamp(PROBES.0, PROBES.1) as u32;
            list.push(Box::new(Volumetric::ddgi(self.view, self.probes(Spacing::Probes(count), rays), label)?));
        }
        Ok(())
    }

    fn propagation(&self, cells: u32) -> Result<Box<dyn Contender + 'a>, Error> {
        let View { two_sided, .. } = *self.view;
        let eye = self.view.camera.eye;
        let cascades = if self.view.longest() < ONE_GRID { 1 } else { 3 };
        let settings = LpvSettings { cells, cascades, eye, steps: 2 * cells, two_sided, ..LpvSettings::default() };
        Ok(Box::new(Volumetric::lpv(self.view, settings)?))
    }

    fn baked_volume(&self, bands: u32) -> Result<Box<dyn Contender + 'a>, Error> {
        let View { common, two_sided, .. } = *self.view;
        let spacing = self.metres(self.finest());
        let mut settings = VolumeSettings { spacing, bands, two_sided, seed: common.seed, ..VolumeSettings::default() };
        if IrradianceVolume::new(&self.view.loaded.scene, settings)?.probe_count() > MAX_BAKED {
            settings.spacing = Spacing::Probes(MAX_BAKED as u32);
        }
        Ok(Box::new(Volumetric::baked(self.view, settings)?))
    }

    /// Processor time of a light update after others, ms; where a graphics processor is at work, by the clock. Lights
    /// move in between: what rests is kept, and takes no time.
    fn trial(&self, contender: &mut dyn Contender) -> Result<f64, Error> {
        let by_clock = has_graphics_processor(self.view)?;
        let mut last = 0.0;
        for (number, lighting) in (0..).zip(self.view.moving(TRIALS)) {
            let Time { wall, processor } = contender.frame(&lighting, number)?.update;
            last = if by_clock { wall } else { processor };
            super::cancelled()?;
        }
        Ok(last)
    }
}
