//! Light between patches by photons that start where lights fall first: illumination maps on all triangles, and from them the
//! irradiance of facets and patches.

mod files;
mod photons;

use std::ops::ControlFlow;

use firstshot::{
    Emission, Estimate, IlluminationMaps, PhotonSettings, PieceSettings, Proceed, Registry, Round, Texels, Tracer,
};
use formfactor::Patch;
use glam::{Vec3, Vec4};
use rayon::prelude::*;
use scene::kernel::bvh::FAR;
use scene::kernel::camera::surface_point;
use scene::kernel::light::direct_irradiance;
use scene::sampling::{cosine_hemisphere, hammersley, hash3};
use scene::{DirectParams, Hit, NONE, Scene, SurfacePoint};

use super::senders::Senders;
use super::{go_on, proceed};
use crate::error::Error;
use crate::executor::Executor;
pub use files::write_files;
pub use photons::PhotonPasses;

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

/// Illumination maps whose cells belong to facets and patches.
pub(crate) struct PatchMaps {
    pub maps: IlluminationMaps,
    /// Facet of each cell, or [`NONE`].
    facets: Vec<u32>,
    /// Patch of each cell, or [`NONE`].
    patches: Vec<u32>,
}

impl Registry for PatchMaps {
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
    /// Maps as fine as the senders are looked up.
    pub fn new(scene: &Scene, senders: &Senders) -> Result<Self, Error> {
        let maps = IlluminationMaps::with_divisions(scene, &senders.divisions()).map_err(Error::Photons)?;
        let side = |(t, is_back): (u32, bool)| -> Vec<u32> {
            let owner = |(_, [a, b, c]): (u32, [glam::Vec2; 3])| {
                let middle = (a + b + c) / 3.0;
                senders.facet_on_side(&Hit { triangle: t, u: middle.x, v: middle.y, t: 0.0 }, !is_back)
            };
            maps.cells(t, is_back).map(owner).collect()
        };
        let sides = (0..scene.triangles.len() as u32).into_par_iter().flat_map_iter(|t| [(t, false), (t, true)]);
        let facets: Vec<u32> = sides.flat_map_iter(side).collect();
        let patches = facets.iter().map(|&facet| senders.patch_of(facet)).collect();
        Ok(Self { maps, facets, patches })
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

/// Photons of a scene and what they have registered.
pub struct FirstShot {
    maps: PatchMaps,
    settings: FirstShotSettings,
    seed: u32,
    /// Lights of the last run.
    lights: Option<Vec<scene::Light>>,
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
        senders: &Senders,
        settings: FirstShotSettings,
        seed: u32,
        executor: Option<Box<dyn Executor>>,
    ) -> Result<Self, Error> {
        Ok(Self {
            maps: PatchMaps::new(scene, senders)?,
            settings,
            seed,
            lights: None,
            estimate: Estimate::default(),
            passes: executor.map(PhotonPasses::new),
            element_bytes: 0,
        })
    }

    /// Traces for the scene's lights, unless they are those of the last run.
    ///
    /// # Errors
    /// [`Error::Cancelled`], what the device says.
    pub fn solve(&mut self, scene: &Scene, report: &(dyn Fn(f32) -> bool + Sync)) -> Result<(), Error> {
        if self.lights.as_ref() == Some(&scene.lights) {
            return Ok(());
        }
        // The pieces are a small part of the work.
        let pieces = |done: usize, total: usize| proceed(report, done, 10 * total);
        let emission =
            Emission::first_shot(scene, &PieceSettings::default(), Texels::Mean, true, &pieces).map_err(cancelled)?;
        self.element_bytes = emission.bytes();
        let settings = PhotonSettings {
            error: self.settings.error,
            most_photons: self.settings.most_photons,
            seed: self.seed,
            ..PhotonSettings::default()
        };
        let mut tracer = Tracer::new(scene, &emission, &self.maps, settings).map_err(Error::Photons)?;
        let progress = |round: &Round| -> Proceed {
            let by_error = (settings.error / round.error).powi(2);
            let by_count = round.photons as f64 / settings.most_photons as f64;
            let share = 0.1 + 0.9 * by_error.max(by_count).min(1.0);
            if report(share as f32) { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        let finished = match &mut self.passes {
            Some(passes) => {
                passes.load(scene, &emission)?;
                tracer.run_with(&progress, |p| passes.trace(p))?
            }
            None => tracer.run(&progress).map_err(Error::Photons)?,
        };
        if !finished {
            return Err(Error::Cancelled);
        }
        self.estimate = tracer.estimate();
        self.lights = Some(scene.lights.clone());
        Ok(())
    }

    /// Indirect irradiance of the facets, W/m².
    pub fn facet_irradiance(&self, senders: &Senders) -> Vec<Vec4> {
        self.maps.means(&self.maps.facets, senders.facets.len(), &self.estimate.irradiance)
    }

    /// Indirect irradiance of the patches, W/m².
    pub fn patch_light(&self, senders: &Senders) -> Vec<PatchLight> {
        let means = self.maps.means(&self.maps.patches, senders.patches.len(), &self.estimate.irradiance);
        let light = |(k, (patch, mean)): (usize, (&Patch, Vec4))| {
            let error = self.estimate.error.get(k).copied().unwrap_or(0.0);
            PatchLight { patch: *patch, irradiance: mean.truncate(), error }
        };
        senders.patches.iter().zip(means).enumerate().map(light).collect()
    }

    /// What was traced, and its error.
    pub fn round(&self) -> Round {
        self.estimate.round
    }

    /// Irradiance of the cells of the illumination maps, and the maps.
    pub fn cells(&self) -> (&IlluminationMaps, &Estimate) {
        (&self.maps.maps, &self.estimate)
    }

    /// Bytes of the maps and of the elements.
    pub fn bytes(&self) -> [(&'static str, u64); 2] {
        // Flux, area, facet, patch.
        let cell = (size_of::<[f32; 3]>() + size_of::<f32>() + 2 * size_of::<u32>()) as u64;
        [("maps", self.maps.maps.len() as u64 * cell), ("elements", self.element_bytes)]
    }

    /// Indirect irradiance at points, W/m²: the mean over rays of `ρ (H_d + H)` at what they meet, H of the illumination maps,
    /// H_d by shadow rays.
    pub fn irradiance_at(&self, scene: &Scene, points: &[SurfacePoint], seed: u32) -> Vec<Vec3> {
        let (geometry, lights) = (scene.geometry(), scene.all_lights());
        let occluded = |origin: Vec3, direction: Vec3, t_max: f32| scene.occluded(origin, direction, t_max);
        let direct = DirectParams {
            area_rays: 1,
            sky_rays: u32::from(scene.has_sky()),
            seed,
            ..super::classic::direct_params(scene)
        };
        let (maps, estimate) = (&self.maps, &self.estimate);
        let light = |(index, point): (usize, &SurfacePoint)| {
            let shift = (hash3(index as u32, 0, seed), hash3(index as u32, 1, seed));
            let origin = point.position + point.normal * scene.ray_offset;
            let mut sum = Vec3::ZERO;
            for k in 0..POINT_RAYS {
                let direction = cosine_hemisphere(point.normal, hammersley(k, POINT_RAYS, shift));
                let hit = scene.closest_before(origin, direction, FAR);
                if hit.triangle == NONE {
                    continue;
                }
                let there = surface_point(&geometry, hit, direction);
                let number = hash3(index as u32, k, seed);
                let first = direct_irradiance(&geometry, &direct, number, there, &lights, occluded);
                let is_back = geometry.normal(hit.triangle).dot(direction) > 0.0;
                let cell = maps.cell(hit.triangle, hit.u, hit.v, is_back);
                let more = estimate.irradiance.get(cell as usize).copied().unwrap_or(Vec3::ZERO);
                sum += geometry.albedo(hit.triangle, hit.u, hit.v) * (first + more);
            }
            sum / POINT_RAYS as f32
        };
        points.par_iter().enumerate().map(light).collect()
    }
}

/// Goes on until the user cancels.
pub(crate) fn quietly(_: f32) -> bool {
    go_on(0, 0).is_continue()
}

fn cancelled(error: transport::Error) -> Error {
    match error {
        transport::Error::Cancelled { .. } => Error::Cancelled,
        other => Error::Photons(other),
    }
}
