//! Irradiance volumes as engines bake them, an opponent: probes on a grid hold irradiance in bands of spherical
//! harmonics and are interpolated, whatever lies between (Greger et al. 1998; Ramamoorthi and Hanrahan 2001).
//!
//! That is what users of engines have as light probes: no visibility, and static. Whenever a light moves the volume is
//! baked anew, by paths: each probe casts rays into all directions, and each ray goes on as a path of the path tracer.
//! Probes that see more backs of surfaces than a quarter of their rays are inside of things; they take the mean of
//! their nearest neighbours that are not, as engines' dilation does. H is indirect only, as for all methods here: what
//! rays meet sends ρ/π (H_d + H), and no emission.

use std::f32::consts::PI;

use glam::{IVec3, Vec3};
use rayon::prelude::*;
use scene::sampling::hash3;
use scene::{Lighting, Scene};

use crate::ddgi::{Grid, Spacing, ViewedPoint};
use crate::harmonics::{COSINE, MAX_COEFFICIENTS, band, random_turn, spherical_fibonacci, three_bands};
use reference::Error;
use reference::{PathSettings, PathTracer};

/// Rays of a probe at most.
const MAX_RAYS: u32 = 1 << 20;
/// A probe that sees more of the backs of surfaces is inside of something.
const MAX_BACKS: f32 = 0.25;

/// Settings of [`IrradianceVolume`], besides the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VolumeSettings {
    /// Distance between probes.
    pub spacing: Spacing,
    /// Highest band of the harmonics: 1 (four coefficients) or 2 (nine).
    pub bands: u32,
    /// Paths of a probe.
    pub rays: u32,
    /// Backs of surfaces are lit and no inside.
    pub two_sided: bool,
    /// Changes every random number.
    pub seed: u32,
}

impl Default for VolumeSettings {
    /// One metre, nine coefficients, 512 paths.
    fn default() -> Self {
        Self { spacing: Spacing::Metres(1.0), bands: 2, rays: 512, two_sided: false, seed: 0 }
    }
}

/// Coefficients of the irradiance of a probe, W/m².
type Probe = [Vec3; MAX_COEFFICIENTS];

/// Probes of a scene with the light they were baked in.
pub struct IrradianceVolume {
    scene: Scene,
    settings: VolumeSettings,
    grid: Grid,
    probes: Vec<Probe>,
}

impl IrradianceVolume {
    /// Places the probes; they are dark.
    ///
    /// # Errors
    /// [`Error::Setting`] for what is out of range.
    pub fn new(scene: &Scene, settings: VolumeSettings) -> Result<Self, Error> {
        let VolumeSettings { bands, rays, .. } = settings;
        if bands != 1 && bands != 2 {
            return Err(Error::Setting { name: "bands of harmonics", value: f64::from(bands), rule: "1 or 2" });
        }
        if rays == 0 || rays > MAX_RAYS {
            return Err(Error::Setting { name: "paths of a probe", value: f64::from(rays), rule: "from 1 to 2^20" });
        }
        let grid = Grid::new(scene, settings.spacing)?;
        let probes = vec![[Vec3::ZERO; MAX_COEFFICIENTS]; grid.count()];
        Ok(Self { scene: scene.clone(), settings, grid, probes })
    }

    /// Bakes all probes under these lights. On all cores; the result does not depend on their number.
    ///
    /// # Errors
    /// [`Error::Scene`] for lighting that does not suit the scene.
    pub fn bake(&mut self, lighting: &Lighting) -> Result<(), Error> {
        self.scene.set_lighting(lighting.clone())?;
        let tracer = PathTracer::new(&self.scene);
        let directions = spherical_fibonacci(self.settings.rays);
        let baked: Vec<Option<Probe>> =
            (0..self.grid.count()).into_par_iter().map(|probe| self.bake_probe(&tracer, probe, &directions)).collect();
        let filled = (0..baked.len()).map(|probe| baked[probe].unwrap_or_else(|| self.dilated(probe, &baked)));
        self.probes = filled.collect();
        Ok(())
    }

    /// Indirect irradiance at points, W/m², on all cores.
    pub fn irradiance_at(&self, points: &[ViewedPoint]) -> Vec<Vec3> {
        points.par_iter().map(|p| self.lookup(p.position, p.normal)).collect()
    }

    /// Probes of the grid.
    pub fn probe_count(&self) -> usize {
        self.probes.len()
    }

    /// Distance between probes along the axes, m.
    pub fn spacing(&self) -> Vec3 {
        self.grid.spacing
    }

    /// Bytes of all probes, three halves a coefficient.
    pub fn bytes(&self) -> u64 {
        (self.probes.len() * self.coefficients() * 6) as u64
    }

    fn coefficients(&self) -> usize {
        ((self.settings.bands + 1) * (self.settings.bands + 1)) as usize
    }

    /// Light of a probe; nothing inside of things.
    fn bake_probe(&self, tracer: &PathTracer, probe: usize, directions: &[Vec3]) -> Option<Probe> {
        let origin = self.grid.position(probe);
        let seed = hash3(self.settings.seed, probe as u32, 0x7072_6f62);
        let turn = random_turn(seed);
        let path = PathSettings { seed, ..PathSettings::default() };
        let weight = 4.0 * PI / directions.len() as f32;
        let mut sums = [Vec3::ZERO; MAX_COEFFICIENTS];
        let mut backs = 0;
        for (ray, direction) in (0..).zip(directions) {
            let direction = turn * *direction;
            let seen = tracer.reflected(origin, direction, ray, &path);
            backs += u32::from(seen.is_back);
            if seen.is_back && !self.settings.two_sided {
                continue;
            }
            for (sum, y) in sums.iter_mut().zip(three_bands(direction)) {
                *sum += seen.radiance * (y * weight);
            }
        }
        if !self.settings.two_sided && backs as f32 > MAX_BACKS * directions.len() as f32 {
            return None;
        }
        sums.iter_mut().enumerate().for_each(|(k, sum)| *sum *= COSINE[band(k)]);
        Some(sums)
    }

    /// Mean of the nearest probes that have light; dark where none has.
    fn dilated(&self, probe: usize, baked: &[Option<Probe>]) -> Probe {
        let counts = self.grid.counts;
        let cell = self.grid.cell(probe).as_ivec3();
        let reach = counts.max_element() as i32;
        for ring in 1..=reach {
            let mut sum = [Vec3::ZERO; MAX_COEFFICIENTS];
            let mut found = 0.0;
            let side = 2 * ring + 1;
            for k in 0..side * side * side {
                let step = IVec3::new(k % side, k / side % side, k / (side * side)) - ring;
                let other = cell + step;
                let is_inside = other.cmpge(IVec3::ZERO).all() && other.cmplt(counts.as_ivec3()).all();
                if step.abs().max_element() == ring
                    && is_inside
                    && let Some(light) = baked[self.grid.number(other.as_uvec3())]
                {
                    sum.iter_mut().zip(light).for_each(|(sum, light)| *sum += light);
                    found += 1.0;
                }
            }
            if found > 0.0 {
                return sum.map(|sum| sum / found);
            }
        }
        [Vec3::ZERO; MAX_COEFFICIENTS]
    }

    fn lookup(&self, position: Vec3, normal: Vec3) -> Vec3 {
        let harmonics = three_bands(normal);
        let mut sum = Vec3::ZERO;
        let mut total = 0.0;
        let used = self.coefficients();
        for (probe, weight) in self.grid.around(position) {
            for (light, y) in self.probes[probe][..used].iter().zip(harmonics) {
                sum += *light * (y * weight);
            }
            total += weight;
        }
        (sum / total).max(Vec3::ZERO)
    }
}
