//! Dynamic diffuse global illumination by probes, an opponent: irradiance and visibility round points of a grid, by a
//! few rays of each probe in every frame.
//!
//! Sources: Majercik, Guertin, Nowrouzezahrai, McGuire 2019, "Dynamic Diffuse Global Illumination with Ray-Traced
//! Irradiance Fields" (JCGT 8(2)); Majercik, Marrs, Spjut, McGuire 2021, "Scaling Probe-Based Real-Time Dynamic Global
//! Illumination for Production" (JCGT 10(2)); defaults as the RTXGI library has them. A probe holds irradiance in 8 × 8
//! octahedral texels, raised to 1/5, and mean distance and its square in 16 × 16, each with a border of one texel. A
//! frame rotates a spherical Fibonacci set of rays at random; what a ray meets sends ρ/π (H_d + H), with H from the
//! probes as the frame before left them, so that bounces add up. Texels blend the rays in with hysteresis. A point
//! takes its irradiance from the eight probes round it: trilinear, less from those behind the surface, and less from
//! those that by Chebyshev's inequality are not seen from it.
//!
//! Compared with the RTXGI library, version 1.3.7: the bases of weights, wrap, Chebyshev's inequality, crushing,
//! powers, hysteresis, 32 fixed rays, a quarter of backs, shortened backs, most albedo and farthest distance are its
//! own. It differs where this is kinder to the method: its 8 and 16 texels hold the border; its fixed rays are taken
//! off those that bring light; a probe that sees a tenth of backs takes in nothing there, here it goes on with the
//! rest; it moves probes by a metre, here by what is missing; its thresholds of change are of stored values in its own
//! units (0.25, 0.1), here shares of the greater one, as the paper of 2021 has them. A bias of 0.3 has the least error
//! of 0.1 to 1.1 in the Cornell box.
//!
//! Where sources leave a choice: lengths (bias, least distance from surfaces) are in spacings, not in metres, so that
//! small scenes are served as well. Probes are at the centres of boxes that fill the bounds, so none is wasted behind
//! outer walls. Probes are moved and classified once, for geometry does not move. Numbers have 32 bits; [`Ddgi::bytes`]
//! counts what the library stores. H is indirect only, as for all methods here: emission and sky reach the hits of rays
//! as direct light, one shadow ray for each light and one for all emitters, and one to the sky, and are left out of the
//! probes.

mod blend;
mod grid;
mod place;

use std::ops::ControlFlow;

use ::ddgi::kernel::lookup::irradiance_at;
use ::ddgi::kernel::trace::{Met, ProbeTables, probe_ray};
use ::ddgi::{
    BlendParams, IRRADIANCE_TEXELS, LookupParams, LookupPoint, Probe, ProbeRay, TraceParams, VISIBILITY_TEXELS,
};
use glam::{Mat3, Vec2, Vec3};
use rayon::prelude::*;
use scene::gpu::DirectParams;
use scene::kernel::bvh::FAR;
use scene::sampling::hash3;
use scene::{Lighting, Rgb, Scene};

use crate::harmonics::{random_turn, spherical_fibonacci};
use blend::Weights;
pub(crate) use grid::Grid;
pub use grid::{PROBE_LIMIT, Spacing};
use place::place;
use reference::Error;

/// Bytes that the library stores of a probe: irradiance in 10 + 10 + 10 + 2 bits a texel, two halves of visibility, and
/// four halves for its offset and state.
const IRRADIANCE_BYTES: usize = IRRADIANCE_TEXELS as usize * 4;
const VISIBILITY_BYTES: usize = VISIBILITY_TEXELS as usize * 4;
const STATE_BYTES: usize = 8;
/// Rays of a probe at most.
const MAX_RAYS: u32 = 4096;
/// Distances count up to this many diagonals of a cell.
const MAX_DISTANCE: f32 = 1.5;
/// After a change of the lights so many frames forget faster, by this factor on the hysteresis (2021, section 4).
const CHANGE_FRAMES: u32 = 10;
const CHANGE_FACTOR: f32 = 0.5;
/// Self-shadow bias: this share of the least spacing, times B (2021, section 3).
const BIAS_SPACING: f32 = 0.75;
/// Degree of the root that irradiance is stored as, unless it is said.
const DEFAULT_ENCODING: u32 = 5;
const MAX_ENCODING: u32 = 16;
/// Power of the cosine that weights distances at most.
const MAX_EXPONENT: u32 = 1000;

/// Settings of [`Ddgi`], besides the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DdgiSettings {
    /// Distance between probes.
    pub spacing: Spacing,
    /// Rays of a probe in a frame: the library offers 144 and 288, among others.
    pub rays: u32,
    /// Share of the old that is left after a frame. After n frames no more than n/(n + 1).
    pub hysteresis: f32,
    /// Self-shadow bias B.
    pub bias: f32,
    /// Power of the cosine that weights distances.
    pub exponent: u32,
    /// Irradiance is stored as its root of this degree; 1 stores it as it is.
    pub encoding: u32,
    /// Shadow rays of each hit of a ray to each area light, and to all emitters together.
    pub area_rays: u32,
    /// Chebyshev weights; without them light leaks.
    pub visibility: bool,
    /// Moves probes away from surfaces and out of things.
    pub relocation: bool,
    /// Switches off probes inside of things, and those that have no surface near.
    pub classification: bool,
    /// Backs of surfaces are lit and no inside, for scenes that are not made of closed bodies with their fronts
    /// outwards.
    pub two_sided: bool,
    /// Changes every random number.
    pub seed: u32,
}

impl Default for DdgiSettings {
    /// One metre, 144 rays, the library's defaults.
    fn default() -> Self {
        Self {
            spacing: Spacing::Metres(1.0),
            rays: 144,
            hysteresis: 0.97,
            bias: 0.3,
            exponent: 50,
            encoding: DEFAULT_ENCODING,
            area_rays: 1,
            visibility: true,
            relocation: true,
            classification: true,
            two_sided: false,
            seed: 0,
        }
    }
}

/// A point whose irradiance is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewedPoint {
    /// m.
    pub position: Vec3,
    /// Unit normal of the side that is lit.
    pub normal: Vec3,
    /// Unit direction to the eye.
    pub to_eye: Vec3,
}

impl From<&ViewedPoint> for LookupPoint {
    fn from(p: &ViewedPoint) -> Self {
        let ViewedPoint { position, normal, to_eye } = *p;
        Self { position: position.extend(0.0), normal: normal.extend(0.0), to_eye: to_eye.extend(0.0) }
    }
}

/// Inputs of a light update beside the scene and the probes, for a device that makes it.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbeFrame {
    /// Unit directions of the rays, the same for all probes.
    pub directions: Vec<Vec3>,
    /// Rays of the probes.
    pub trace: TraceParams,
    /// Texels of irradiance.
    pub irradiance: BlendParams,
    /// Texels of visibility.
    pub visibility: BlendParams,
}

/// The probes of a scene, with the light of the last update.
pub struct Ddgi {
    scene: Scene,
    settings: DdgiSettings,
    grid: Grid,
    probes: Vec<Probe>,
    active: Vec<u32>,
    /// H^(1/5), `[probes · 100]`.
    irradiance: Vec<Rgb>,
    /// Mean distance, m, and its square, `[probes · 324]`.
    visibility: Vec<Vec2>,
    /// Rays of the active probes, `[active · rays]`.
    rays: Vec<ProbeRay>,
    /// Rays before they are turned.
    directions: Vec<Vec3>,
    updates: u32,
    /// Frames that still forget faster.
    changing: u32,
}

impl Ddgi {
    /// Places the probes; they are dark. On all cores.
    ///
    /// # Errors
    /// [`Error::Setting`] for what is out of range, and for more probes than [`PROBE_LIMIT`].
    pub fn new(scene: &Scene, settings: DdgiSettings) -> Result<Self, Error> {
        check(&settings)?;
        let grid = Grid::new(scene, settings.spacing)?;
        let probes = place(scene, &grid, &settings);
        let active: Vec<u32> =
            (0..probes.len() as u32).filter(|&probe| probes[probe as usize].is_active != 0).collect();
        Ok(Self {
            scene: scene.clone(),
            settings,
            grid,
            irradiance: vec![Rgb::ZERO; probes.len() * IRRADIANCE_TEXELS as usize],
            visibility: vec![Vec2::ZERO; probes.len() * VISIBILITY_TEXELS as usize],
            rays: vec![ProbeRay::default(); active.len() * settings.rays as usize],
            directions: spherical_fibonacci(settings.rays),
            probes,
            active,
            updates: 0,
            changing: 0,
        })
    }

    /// A whole light update: rays of all active probes, direct light where they end, blending. `frame` rotates the
    /// rays. On all cores; the result does not depend on their number.
    ///
    /// # Errors
    /// [`Error::Scene`] for lighting that does not suit the scene.
    pub fn update(&mut self, lighting: &Lighting, frame: u32) -> Result<(), Error> {
        let frame = self.begin(lighting, frame)?;
        self.trace(&frame);
        self.blend(&Weights::new(&frame.directions, self.settings.exponent), &frame);
        Ok(())
    }

    /// Begins a light update that a device makes; the probes that are here stay as they are.
    ///
    /// # Errors
    /// As [`Ddgi::update`].
    pub fn begin(&mut self, lighting: &Lighting, frame: u32) -> Result<ProbeFrame, Error> {
        if self.updates > 0 && *lighting != self.scene.lighting {
            self.changing = CHANGE_FRAMES;
        }
        self.scene.set_lighting(lighting.clone())?;
        let rotation = Mat3::from_quat(random_turn(hash3(self.settings.seed, frame, 0x7475_726e)));
        let directions = self.directions.iter().map(|d| rotation * *d).collect();
        let rays = self.settings.rays;
        // Until there are enough frames for the hysteresis, the mean of all.
        let past = self.settings.hysteresis.min(self.updates as f32 / (self.updates + 1) as f32);
        let light = if self.changing > 0 { past * CHANGE_FACTOR } else { past };
        let probes = self.probes.len() as u32;
        let visibility = BlendParams {
            count: probes * VISIBILITY_TEXELS,
            rays,
            hysteresis: past,
            encoding: self.settings.encoding,
            most: MAX_DISTANCE * self.grid.spacing.length(),
        };
        let trace = TraceParams {
            count: probes * rays,
            rays,
            two_sided: u32::from(self.settings.two_sided),
            reserved: 0,
            lookup: self.lookup_params(),
            direct: self.direct_params(hash3(self.settings.seed, frame, 0x7261_7973)),
        };
        let irradiance = BlendParams { count: probes * IRRADIANCE_TEXELS, hysteresis: light, ..visibility };
        self.updates += 1;
        self.changing = self.changing.saturating_sub(1);
        Ok(ProbeFrame { directions, trace, irradiance, visibility })
    }

    /// Updates of frames `first`, `first + 1` and so on under still light. After each, `progress(done, count)` may stop
    /// the work; returns whether all were made.
    ///
    /// # Errors
    /// As [`Ddgi::update`].
    pub fn settle(
        &mut self,
        lighting: &Lighting,
        first: u32,
        count: u32,
        mut progress: impl FnMut(u32, u32) -> ControlFlow<()>,
    ) -> Result<bool, Error> {
        for done in 0..count {
            self.update(lighting, first.wrapping_add(done))?;
            if progress(done + 1, count).is_break() {
                return Ok(done + 1 == count);
            }
        }
        Ok(true)
    }

    /// Indirect irradiance at points, W/m², on all cores.
    pub fn irradiance_at(&self, points: &[ViewedPoint]) -> Vec<Vec3> {
        let params = self.lookup_params();
        let Self { probes, irradiance, visibility, .. } = self;
        points.par_iter().map(|p| irradiance_at(&params, &p.into(), probes, irradiance, visibility)).collect()
    }

    /// Probes of the grid, and those of them that are on.
    pub fn probe_counts(&self) -> (usize, usize) {
        (self.probes.len(), self.active.len())
    }

    /// Position of each probe, m, and whether it is on.
    pub fn probes(&self) -> impl Iterator<Item = (Vec3, bool)> {
        self.probes.iter().map(|probe| (probe.position, probe.is_active != 0))
    }

    /// All probes as kernels read them.
    pub fn probe_table(&self) -> &[Probe] {
        &self.probes
    }

    /// Settings of the probes.
    pub fn settings(&self) -> &DdgiSettings {
        &self.settings
    }

    /// Settings of probe lookups.
    pub fn lookup_params(&self) -> LookupParams {
        LookupParams {
            counts: self.grid.counts,
            encoding: self.settings.encoding,
            first: self.grid.first,
            bias: self.settings.bias * BIAS_SPACING * self.grid.spacing.min_element(),
            spacing: self.grid.spacing,
            visibility: u32::from(self.settings.visibility),
        }
    }

    /// Distance between probes along the axes, m.
    pub fn spacing(&self) -> Vec3 {
        self.grid.spacing
    }

    /// Bytes of all probes in the library's formats, without the rays of a frame.
    pub fn bytes(&self) -> u64 {
        (self.probes.len() * (IRRADIANCE_BYTES + VISIBILITY_BYTES + STATE_BYTES)) as u64
    }

    /// Fills [`Ddgi::rays`].
    fn trace(&mut self, frame: &ProbeFrame) {
        let mut rays = std::mem::take(&mut self.rays);
        let this = &*self;
        let count = frame.directions.len();
        rays.par_chunks_mut(count).zip(&this.active).for_each(|(rays, &probe)| {
            for (k, (ray, &direction)) in rays.iter_mut().zip(&frame.directions).enumerate() {
                *ray = this.ray(&frame.trace, probe, k as u32, direction);
            }
        });
        self.rays = rays;
    }

    fn direct_params(&self, seed: u32) -> DirectParams {
        DirectParams {
            light_count: self.scene.lighting.lights.len() as u32,
            emitter_count: self.scene.emitters.len() as u32,
            area_rays: self.settings.area_rays,
            sky_rays: u32::from(self.scene.has_sky()),
            seed,
            ray_offset: self.scene.geometry.ray_offset,
            ..DirectParams::default()
        }
    }

    /// Radiance along ray `k` of a probe.
    fn ray(&self, params: &TraceParams, probe: u32, k: u32, direction: Vec3) -> ProbeRay {
        let scene = &self.scene;
        let hit = scene.closest_before(self.probes[probe as usize].position, direction, FAR);
        let tables = ProbeTables { probes: &self.probes, irradiance: &self.irradiance, visibility: &self.visibility };
        let met = Met { index: probe * params.rays + k, direction, hit };
        probe_ray(&scene.tables(), params, &scene.all_lights(), tables, met, |origin, direction, t_max| {
            scene.occluded(origin, direction, t_max)
        })
    }

    /// Blends the rays into the probes.
    fn blend(&mut self, weights: &Weights, frame: &ProbeFrame) {
        let mut slots: Vec<Option<&[ProbeRay]>> = vec![None; self.probes.len()];
        for (&probe, rays) in self.active.iter().zip(self.rays.chunks(frame.directions.len())) {
            slots[probe as usize] = Some(rays);
        }
        let irradiance = self.irradiance.par_chunks_mut(IRRADIANCE_TEXELS as usize);
        let visibility = self.visibility.par_chunks_mut(VISIBILITY_TEXELS as usize);
        irradiance.zip(visibility).zip(slots).for_each(|((irradiance, visibility), rays)| {
            if let Some(rays) = rays {
                weights.blend_irradiance(rays, &frame.irradiance, irradiance);
                weights.blend_visibility(rays, &frame.visibility, visibility);
            }
        });
    }
}

fn check(settings: &DdgiSettings) -> Result<(), Error> {
    let DdgiSettings { rays, hysteresis, bias, exponent, encoding, area_rays, .. } = *settings;
    if rays == 0 || rays > MAX_RAYS {
        return Err(Error::Setting { name: "rays of a probe", value: f64::from(rays), rule: "from 1 to 4096" });
    }
    if !(0.0..1.0).contains(&hysteresis) {
        return Err(Error::Setting {
            name: "hysteresis",
            value: f64::from(hysteresis),
            rule: "at least 0 and below 1",
        });
    }
    if area_rays == 0 || area_rays > MAX_RAYS {
        let value = f64::from(area_rays);
        return Err(Error::Setting { name: "shadow rays to an area light", value, rule: "from 1 to 4096" });
    }
    if !(1..=MAX_ENCODING).contains(&encoding) {
        return Err(Error::Setting {
            name: "encoding of irradiance",
            value: f64::from(encoding),
            rule: "from 1 to 16",
        });
    }
    if exponent > MAX_EXPONENT {
        return Err(Error::Setting { name: "exponent of distances", value: f64::from(exponent), rule: "at most 1000" });
    }
    if !(bias.is_finite() && bias >= 0.0) {
        let value = f64::from(bias);
        return Err(Error::Setting { name: "self-shadow bias", value, rule: "finite and not negative" });
    }
    Ok(())
}
