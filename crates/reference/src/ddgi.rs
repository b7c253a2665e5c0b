//! Dynamic diffuse global illumination by probes, an opponent: irradiance and visibility round points of a grid, by a few
//! rays of each probe in every frame.
//!
//! Sources: Majercik, Guertin, Nowrouzezahrai, McGuire 2019, "Dynamic Diffuse Global Illumination with Ray-Traced Irradiance
//! Fields" (JCGT 8(2)); Majercik, Marrs, Spjut, McGuire 2021, "Scaling Probe-Based Real-Time Dynamic Global Illumination for
//! Production" (JCGT 10(2)); defaults as the RTXGI library has them. A probe holds irradiance in 8 × 8 octahedral texels,
//! raised to 1/5, and mean distance and its square in 16 × 16, each with a border of one texel. A frame rotates a spherical
//! Fibonacci set of rays at random; what a ray meets sends ρ/π (H_d + H), with H from the probes as the frame before left
//! them, so that bounces add up. Texels blend the rays in with hysteresis. A point takes its irradiance from the eight
//! probes round it: trilinear, less from those behind the surface, and less from those that by Chebyshev's inequality are
//! not seen from it.
//!
//! Compared with the RTXGI library, version 1.3.7: the bases of weights, wrap, Chebyshev's inequality, crushing, powers, hysteresis,
//! 32 fixed rays, a quarter of backs, shortened backs, most albedo and farthest distance are its own. It differs where this is
//! kinder to the method: its 8 and 16 texels hold the border; its fixed rays are taken off those that bring light; a probe that
//! sees a tenth of backs takes in nothing there, here it goes on with the rest; it moves probes by a metre, here by what is
//! missing; its thresholds of change are of stored values in its own units (0.25, 0.1), here shares of the greater one, as the
//! paper of 2021 has them. A bias of 0.3 has the least error of 0.1 to 1.1 in the Cornell box.
//!
//! Where sources leave a choice: lengths (bias, least distance from surfaces) are in spacings, not in metres, so that small
//! scenes are served as well. Probes are at the centres of boxes that fill the bounds, so none is wasted behind outer walls.
//! Probes are moved and classified once, for geometry does not move. Numbers have 32 bits; [`Ddgi::bytes`] counts what the
//! library stores. H is indirect only, as for all methods here: emission and sky reach the hits of rays as direct light, one
//! shadow ray for each light and one for all emitters, and one to the sky, and are left out of the probes.

mod blend;
mod grid;
mod octahedral;
mod place;

use std::f32::consts::FRAC_1_PI;
use std::ops::ControlFlow;

use glam::{Mat3, UVec3, Vec2, Vec3};
use rayon::prelude::*;
use scene::kernel::bvh::FAR;
use scene::kernel::camera::surface_point;
use scene::kernel::light::direct_irradiance;
use scene::kernel::medium::Air;
use scene::math::pow;
use scene::sampling::hash3;
use scene::{DirectParams, Lighting, Scene};

use crate::error::Error;
use crate::harmonics::{random_turn, spherical_fibonacci};
use blend::{ProbeRay, Weights};
pub(crate) use grid::Grid;
pub use grid::{PROBE_LIMIT, Spacing};
use octahedral::{sample, stored};
use place::{Placed, place};

/// Texels along the edge of a probe's irradiance, and of its visibility, without borders.
const IRRADIANCE_EDGE: usize = 8;
const VISIBILITY_EDGE: usize = 16;
/// Bytes that the library stores of a probe: irradiance in 10 + 10 + 10 + 2 bits a texel, two halves of visibility, and four
/// halves for its offset and state.
const IRRADIANCE_BYTES: usize = stored(IRRADIANCE_EDGE) * 4;
const VISIBILITY_BYTES: usize = stored(VISIBILITY_EDGE) * 4;
const STATE_BYTES: usize = 8;
/// Rays of a probe at most.
const MOST_RAYS: u32 = 4096;
/// Reflectance for which light of the frame before counts at most, so that it dies out.
const MOST_ALBEDO: f32 = 0.9;
/// Distances count up to this many diagonals of a cell.
const MOST_DISTANCE: f32 = 1.5;
/// Share of its distance at which the back of a surface counts for visibility: probes in things are seen from nowhere.
const BACK_DISTANCE: f32 = 0.2;
/// After a change of the lights so many frames forget faster, by this factor on the hysteresis (2021, section 4).
const CHANGE_FRAMES: u32 = 10;
const CHANGE_FACTOR: f32 = 0.5;
/// Self-shadow bias: (normal · 0.2 + direction to the eye · 0.8) · 0.75 least spacing · bias (2021, section 3).
const BIAS_NORMAL: f32 = 0.2;
const BIAS_VIEW: f32 = 0.8;
const BIAS_SPACING: f32 = 0.75;
/// Least weight of a probe that is not seen, and of one behind the surface.
const LEAST_VISIBILITY: f32 = 0.05;
const LEAST_FACING: f32 = 0.2;
/// Power whose root irradiance is stored as, unless it is said.
const DEFAULT_ENCODING: f32 = 5.0;
const MOST_ENCODING: f32 = 16.0;
/// Weights below this are crushed.
const CRUSH: f32 = 0.2;

/// What [`Ddgi`] depends on, besides the scene.
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
    pub exponent: f32,
    /// Irradiance is stored raised to 1 over this; 1 stores it as it is.
    pub encoding: f32,
    /// Shadow rays of each hit of a ray to each area light, and to all emitters together.
    pub area_rays: u32,
    /// Chebyshev weights; without them light leaks.
    pub visibility: bool,
    /// Moves probes away from surfaces and out of things.
    pub relocation: bool,
    /// Switches off probes inside of things, and those that have no surface near.
    pub classification: bool,
    /// Backs of surfaces are lit and no inside, for scenes that are not made of closed bodies with their fronts outwards.
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
            exponent: 50.0,
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

/// The probes of a scene, with the light of the last update.
pub struct Ddgi {
    scene: Scene,
    settings: DdgiSettings,
    grid: Grid,
    probes: Vec<Placed>,
    active: Vec<usize>,
    /// H^(1/5), `[probes · 100]`.
    irradiance: Vec<Vec3>,
    /// Mean distance, m, and its square, `[probes · 324]`.
    visibility: Vec<Vec2>,
    /// Of the active probes, `[active · rays]`.
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
        let active: Vec<usize> = (0..probes.len()).filter(|&probe| probes[probe].is_active).collect();
        Ok(Self {
            scene: scene.clone(),
            settings,
            grid,
            irradiance: vec![Vec3::ZERO; probes.len() * stored(IRRADIANCE_EDGE)],
            visibility: vec![Vec2::ZERO; probes.len() * stored(VISIBILITY_EDGE)],
            rays: vec![ProbeRay::default(); active.len() * settings.rays as usize],
            directions: spherical_fibonacci(settings.rays),
            probes,
            active,
            updates: 0,
            changing: 0,
        })
    }

    /// A whole light update: rays of all active probes, direct light where they end, blending. `frame` rotates the rays. On all
    /// cores; the result does not depend on their number.
    ///
    /// # Errors
    /// [`Error::Scene`] for lighting that does not suit the scene.
    pub fn update(&mut self, lighting: &Lighting, frame: u32) -> Result<(), Error> {
        if self.updates > 0 && *lighting != self.scene.lighting {
            self.changing = CHANGE_FRAMES;
        }
        self.scene.set_lighting(lighting.clone())?;
        let rotation = Mat3::from_quat(random_turn(hash3(self.settings.seed, frame, 0x7475_726e)));
        let directions: Vec<Vec3> = self.directions.iter().map(|d| rotation * *d).collect();
        self.trace(&directions, hash3(self.settings.seed, frame, 0x7261_7973));
        self.blend(&Weights::new(&directions, self.settings.exponent));
        self.updates += 1;
        self.changing = self.changing.saturating_sub(1);
        Ok(())
    }

    /// Updates of frames `first`, `first + 1` and so on under still light. After each, `progress(done, count)` may stop the
    /// work; returns whether all were made.
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
        points.par_iter().map(|p| self.lookup(p)).collect()
    }

    /// Probes of the grid, and those of them that are on.
    pub fn probe_counts(&self) -> (usize, usize) {
        (self.probes.len(), self.active.len())
    }

    /// Where each probe is, m, and whether it is on.
    pub fn probes(&self) -> impl Iterator<Item = (Vec3, bool)> {
        self.probes.iter().map(|probe| (probe.position, probe.is_active))
    }

    /// Probes along the axes.
    pub fn grid_counts(&self) -> UVec3 {
        self.grid.counts
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
    fn trace(&mut self, directions: &[Vec3], seed: u32) {
        let mut rays = std::mem::take(&mut self.rays);
        let this = &*self;
        let params = this.direct_params(seed);
        rays.par_chunks_mut(directions.len()).zip(&this.active).for_each(|(rays, &probe)| {
            let origin = this.probes[probe].position;
            for (k, (ray, &direction)) in rays.iter_mut().zip(directions).enumerate() {
                *ray = this.ray(&params, (probe * directions.len() + k) as u32, origin, direction);
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

    /// What a ray of a probe brings: ρ/π (H_d + H) of the front of what it meets.
    fn ray(&self, params: &DirectParams, index: u32, origin: Vec3, direction: Vec3) -> ProbeRay {
        let scene = &self.scene;
        let tables = scene.tables();
        let hit = scene.closest_before(origin, direction, FAR);
        if hit.is_miss() {
            return ProbeRay { radiance: Vec3::ZERO, distance: FAR };
        }
        if !self.settings.two_sided && tables.normal(hit.triangle).dot(direction) > 0.0 {
            return ProbeRay { radiance: Vec3::ZERO, distance: -BACK_DISTANCE * hit.t };
        }
        let point = surface_point(&tables, hit, direction);
        let occluded = |origin: Vec3, direction: Vec3, t_max: f32| scene.occluded(origin, direction, t_max);
        let direct = direct_irradiance(&tables, params, index, point, &scene.all_lights(), Air, occluded);
        let before = ViewedPoint { position: point.position, normal: point.normal, to_eye: -direction };
        let albedo = tables.albedo(hit.triangle, hit.u, hit.v);
        let indirect = albedo.min(Vec3::splat(MOST_ALBEDO)) * self.lookup(&before);
        ProbeRay { radiance: (albedo * direct + indirect) * FRAC_1_PI, distance: hit.t }
    }

    /// Blends the rays into the probes.
    fn blend(&mut self, weights: &Weights) {
        let count = self.settings.rays as usize;
        let most = MOST_DISTANCE * self.grid.spacing.length();
        // Until there are enough frames for the hysteresis, the mean of all.
        let past = self.settings.hysteresis.min(self.updates as f32 / (self.updates + 1) as f32);
        let light = if self.changing > 0 { past * CHANGE_FACTOR } else { past };
        let encoding = self.settings.encoding;
        let mut slots: Vec<Option<&[ProbeRay]>> = vec![None; self.probes.len()];
        for (&probe, rays) in self.active.iter().zip(self.rays.chunks(count)) {
            slots[probe] = Some(rays);
        }
        let irradiance = self.irradiance.par_chunks_mut(stored(IRRADIANCE_EDGE));
        let visibility = self.visibility.par_chunks_mut(stored(VISIBILITY_EDGE));
        irradiance.zip(visibility).zip(slots).for_each(|((irradiance, visibility), rays)| {
            if let Some(rays) = rays {
                weights.blend_irradiance(rays, light, encoding, irradiance);
                weights.blend_visibility(rays, most, past, visibility);
            }
        });
    }

    /// Indirect irradiance at a point, W/m².
    fn lookup(&self, point: &ViewedPoint) -> Vec3 {
        let ViewedPoint { position, normal, to_eye } = *point;
        let bias = self.settings.bias * BIAS_SPACING * self.grid.spacing.min_element();
        let biased = position + (normal * BIAS_NORMAL + to_eye * BIAS_VIEW) * bias;
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for (probe, trilinear) in self.grid.around(biased) {
            let Placed { position: place, is_active } = self.probes[probe];
            if !is_active {
                continue;
            }
            let facing = ((place - position).normalize_or_zero().dot(normal) + 1.0) * 0.5;
            let mut weight = facing * facing + LEAST_FACING;
            if self.settings.visibility {
                weight *= self.visibility(probe, biased - place).max(LEAST_VISIBILITY);
            }
            if weight < CRUSH {
                weight *= weight * weight / (CRUSH * CRUSH);
            }
            weight *= trilinear;
            let texels = &self.irradiance[probe * stored(IRRADIANCE_EDGE)..][..stored(IRRADIANCE_EDGE)];
            let encoded = sample(texels, IRRADIANCE_EDGE, normal);
            // The mean is taken of square roots.
            sum += encoded.map(|x| self.root(x)) * weight;
            total += weight;
        }
        if total > 0.0 { (sum / total) * (sum / total) } else { Vec3::ZERO }
    }

    /// Square root of irradiance that is stored as x.
    #[inline]
    fn root(&self, x: f32) -> f32 {
        // x⁵ᐟ² by products: lookups are most of an update.
        if self.settings.encoding == DEFAULT_ENCODING { x * x * x.sqrt() } else { pow(x, 0.5 * self.settings.encoding) }
    }

    /// Chance that a point so far from a probe is seen from it, by Chebyshev's inequality, to the third power.
    fn visibility(&self, probe: usize, from_probe: Vec3) -> f32 {
        let distance = from_probe.length();
        if distance <= 0.0 {
            return 1.0;
        }
        let texels = &self.visibility[probe * stored(VISIBILITY_EDGE)..][..stored(VISIBILITY_EDGE)];
        let moments = sample(texels, VISIBILITY_EDGE, from_probe / distance);
        let beyond = distance - moments.x;
        if beyond <= 0.0 {
            return 1.0;
        }
        let variance = (moments.y - moments.x * moments.x).abs();
        let chance = variance / (variance + beyond * beyond);
        chance * chance * chance
    }
}

fn check(settings: &DdgiSettings) -> Result<(), Error> {
    let DdgiSettings { rays, hysteresis, bias, exponent, encoding, area_rays, .. } = *settings;
    if rays == 0 || rays > MOST_RAYS {
        return Err(Error::Setting { name: "rays of a probe", value: f64::from(rays), rule: "from 1 to 4096" });
    }
    if !(0.0..1.0).contains(&hysteresis) {
        return Err(Error::Setting {
            name: "hysteresis",
            value: f64::from(hysteresis),
            rule: "at least 0 and below 1",
        });
    }
    if area_rays == 0 || area_rays > MOST_RAYS {
        let value = f64::from(area_rays);
        return Err(Error::Setting { name: "shadow rays to an area light", value, rule: "from 1 to 4096" });
    }
    if !(1.0..=MOST_ENCODING).contains(&encoding) {
        return Err(Error::Setting {
            name: "encoding of irradiance",
            value: f64::from(encoding),
            rule: "from 1 to 16",
        });
    }
    for (name, value) in [("self-shadow bias", bias), ("exponent of distances", exponent)] {
        if !(value.is_finite() && value >= 0.0) {
            return Err(Error::Setting { name, value: f64::from(value), rule: "finite and not negative" });
        }
    }
    Ok(())
}
