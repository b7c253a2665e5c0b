//! An unbiased path tracer over a [`Scene`]: the ground truth of this project.
//!
//! `L = L_e + ρ/π · E`, and the irradiance E of a point is estimated by a path: at every vertex shadow rays to each
//! light, to one emissive triangle and to one direction of the sky map, then one cosine-weighted ray; emitters and sky
//! map are weighted by the balance heuristic (Veach and Guibas 1995), Russian roulette ends dark paths. Every vertex is
//! also connected with a point in parallel light, so that rooms lit through an opening have little noise. Rectangle
//! lights are no geometry: only shadow rays, the camera and what mirrors or refracts see them. A medium between
//! surfaces absorbs `1 − e^(−σ d)` of the light on each segment of d m, that to the camera included.
//!
//! Where a surface mirrors or refracts, too ([`scene::kernel::specular`]), chance picks its diffuse part, what it
//! mirrors or what goes through. A ray that is mirrored or refracted sees what shines as the camera does: no shadow ray
//! finds that light. So the light that points, spots, luminaires and parallel lights send by way of a mirror or through
//! glass is not found at all; photons find it.

use std::f32::consts::{FRAC_1_PI, PI};
use std::ops::ControlFlow;

use glam::Vec3;
use rayon::prelude::*;
use scene::gpu::{DirectParams, LIGHT_DIRECTIONAL, LIGHT_LUMINAIRE, LIGHT_RECT, LIGHT_SPOT};
use scene::kernel::bvh::FAR;
use scene::kernel::camera::{camera_direction, surface_point};
use scene::kernel::light::{luminaire_share, meet_rect, pick_emitter, sky_radiance, spot_falloff};
use scene::kernel::lobe;
use scene::kernel::normal::shading_point;
use scene::kernel::specular::specular_parts;
use scene::math::{clamp, sin_cos_2pi};
use scene::sampling::{cosine_hemisphere, frame, hash3, uniform_triangle};
use scene::{Camera, Finish, GeometryTables, Hit, Light, Lights, Lobe, Materials, Scene, SurfacePoint};

use crate::accumulation::Accumulation;
use crate::error::Error;
use crate::sampler::Sampler;
use crate::sky::SkyDistribution;
use crate::sun::{LitPoint, SunGuide, training_path};

/// Sampling strategy for light of emissive triangles, of a sky map and of spots in parallel light. All agree in the
/// mean; the others exist to show that. All agree in the mean; the others exist to show that.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// Shadow rays, connections with points in parallel light, and bounces, weighted.
    #[default]
    Both = 0,
    /// Shadow rays only.
    ShadowRays = 1,
    /// Bounces only.
    Bounces = 2,
}

/// Inputs of a path, besides the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathSettings {
    /// Changes every random number.
    pub seed: u32,
    /// Greatest number of reflections and refractions between a light and the visible surface, which may be seen in a
    /// mirror; 0 leaves direct light only.
    pub bounces: u32,
    /// Sampling strategy for emitters and sky map.
    pub strategy: Strategy,
    /// Reflection of what the camera sees.
    pub materials: Materials,
}

impl PathSettings {
    /// Strategy and materials as a number of files.
    pub(crate) fn code(&self) -> u32 {
        self.strategy as u32 | (self.materials as u32) << 8
    }
}

impl Default for PathSettings {
    /// All bounces, both strategies, seed 0.
    fn default() -> Self {
        Self { seed: 0, bounces: u32::MAX, strategy: Strategy::Both, materials: Materials::Diffuse }
    }
}

/// Irradiance at a point with standard errors (1 σ), W/m².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PointIrradiance {
    /// Straight from emitters, lights and sky.
    pub direct: Vec3,
    /// After one or more bounces.
    pub indirect: Vec3,
    /// Standard error of `direct`.
    pub direct_error: Vec3,
    /// Standard error of `indirect`.
    pub indirect_error: Vec3,
}

/// Groups of samples whose spread gives the standard error of [`PointIrradiance`].
const GROUPS: u32 = 16;
/// Rows of the picture that a thread takes at a time.
const BAND_ROWS: usize = 4;
/// Vertices before Russian roulette begins.
const SURE_VERTICES: u32 = 2;
/// Surfaces that a path meets at most: it may be caught between mirrors that take nothing of its light.
const MAX_VERTICES: u32 = 1 << 12;
/// Training paths that find out where parallel light matters.
const TRAINING_PATHS: u32 = 1 << 16;
/// Least and greatest number of points in parallel light that one sample of a whole picture shares.
const LIT_POINTS: (u32, u32) = (1 << 10, 1 << 16);

/// A scene prepared for path tracing.
pub struct PathTracer<'a> {
    scene: &'a Scene,
    geometry: GeometryTables<'a>,
    lights: Lights<'a>,
    /// Density of emitter samples per m², `[triangles]`; empty without emitters.
    emitter_density: Vec<f32>,
    sky: Option<SkyDistribution>,
}

/// Values shared by all paths of one sample of a picture.
struct Shared<'g> {
    settings: PathSettings,
    sun: Option<(&'g SunGuide, Vec<LitPoint>)>,
}

/// Light that reaches a point, as E/π: straight from lights, and after reflections.
#[derive(Clone, Copy, Default)]
struct Gathered {
    direct: Vec3,
    indirect: Vec3,
}

/// Continuation of a path after a hit.
struct Onward {
    /// Factor on light that comes that way: the share of the part that was picked over the chance to pick it.
    weight: Vec3,
    /// Factor on radiance alone, where it goes into another dielectric.
    radiance_ratio: f32,
    /// Origin and direction, or nothing where the diffuse part was picked.
    ray: Option<(Vec3, Vec3)>,
}

/// Reflecting part of a surface as a ray sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reflected {
    /// W/m²/sr, without emission.
    pub radiance: Vec3,
    /// True if it sees the back.
    pub is_back: bool,
}

impl<'a> PathTracer<'a> {
    /// Prepares the tables by which lights are picked.
    pub fn new(scene: &'a Scene) -> Self {
        let lights = scene.all_lights();
        let mut emitter_density = Vec::new();
        if !scene.emitters.is_empty() {
            emitter_density = vec![0.0; scene.geometry.triangles.len()];
            for e in scene.emitters.iter() {
                emitter_density[e.triangle as usize] = e.probability / e.area;
            }
        }
        Self { scene, geometry: scene.tables(), lights, emitter_density, sky: SkyDistribution::new(&lights) }
    }

    /// Adds samples until every pixel has `target` of them, on all cores of the current rayon pool. Within each sample
    /// a pixel, and after it, `progress(done, target)` may stop the work: the accumulation then holds whole samples and
    /// can be continued. Returns whether the target is reached.
    ///
    /// # Errors
    /// [`Error::AccumulationSize`] when the accumulation belongs to another picture size.
    pub fn accumulate(
        &self,
        camera: &Camera,
        accumulation: &mut Accumulation,
        target: u32,
        progress: impl Fn(u32, u32) -> ControlFlow<()> + Sync,
    ) -> Result<bool, Error> {
        if (camera.width, camera.height) != (accumulation.width, accumulation.height) {
            return Err(Error::AccumulationSize {
                accumulation: (accumulation.width, accumulation.height),
                camera: (camera.width, camera.height),
            });
        }
        let width = camera.width as usize;
        let settings = accumulation.settings;
        let guide = self.guide(settings, |k, sampler| {
            let pixel =
                (f64::from(hash3(k, 0, settings.seed)) / 2f64.powi(32) * accumulation.pixels.len() as f64) as u32;
            let (hit, direction) = self.camera_hit(camera, pixel, sampler);
            (!hit.is_miss()).then(|| surface_point(&self.geometry, hit, direction))
        });
        let lit_points = (accumulation.pixels.len() as u32 / 8).clamp(LIT_POINTS.0, LIT_POINTS.1);
        let mut gathered = vec![Gathered::default(); accumulation.pixels.len()];
        while accumulation.samples < target {
            let sample = accumulation.samples;
            let shared = self.shared(settings, &guide, lit_points, sample);
            let bands = gathered.par_chunks_mut((width * BAND_ROWS).max(1)).enumerate();
            let is_whole = bands.map(|(band, pixels)| {
                if progress(sample, target).is_break() {
                    return false;
                }
                let first = band * width * BAND_ROWS;
                let rows = pixels.len() / width;
                // Column by column, so that neighbouring rays follow each other.
                for x in 0..width {
                    for y in 0..rows {
                        let k = y * width + x;
                        pixels[k] = self.pixel_sample(camera, &shared, (first + k) as u32, sample);
                    }
                }
                true
            });
            if !is_whole.reduce(|| true, |a, b| a && b) {
                break;
            }
            let pixels = accumulation.pixels.par_iter_mut();
            pixels.zip(&gathered).for_each(|(sums, light)| sums.add(sample, light.direct, light.indirect));
            accumulation.samples += 1;
            if progress(accumulation.samples, target).is_break() {
                break;
            }
        }
        Ok(accumulation.samples >= target)
    }

    /// Irradiance at points by `samples` paths each (rounded up to a multiple of 16), on all cores.
    pub fn irradiance(&self, points: &[SurfacePoint], samples: u32, settings: &PathSettings) -> Vec<PointIrradiance> {
        let group_samples = samples.div_ceil(GROUPS).max(1);
        let guide = self.guide(*settings, |k, _| points.get(k as usize % points.len().max(1)).copied());
        let mut sums = vec![[[Vec3::ZERO; 2]; 2]; points.len()];
        for group in 0..GROUPS {
            // A group is a sequence of its own with its own lit points, so that the groups are independent.
            let seed = hash3(settings.seed, group, 0x706f_696e);
            let shared = self.shared(PathSettings { seed, ..*settings }, &guide, LIT_POINTS.1, group);
            sums.par_iter_mut().zip(points).enumerate().for_each(|(stream, (sums, point))| {
                let mut mean = [Vec3::ZERO; 2];
                for sample in 0..group_samples {
                    let light = self.gather(*point, &shared, &mut Sampler::new(stream as u32, sample, seed));
                    mean[0] += light.direct;
                    mean[1] += light.indirect;
                }
                for (part, mean) in mean.iter().enumerate() {
                    let mean = *mean * (PI / group_samples as f32);
                    sums[0][part] += mean;
                    sums[1][part] += mean * mean;
                }
            });
        }
        let n = GROUPS as f32;
        sums.iter()
            .map(|sums| {
                let error = |part: usize| {
                    let mean = sums[0][part] / n;
                    ((sums[1][part] / n - mean * mean).max(Vec3::ZERO) / (n - 1.0)).map(f32::sqrt)
                };
                PointIrradiance {
                    direct: sums[0][0] / n,
                    indirect: sums[0][1] / n,
                    direct_error: error(0),
                    indirect_error: error(1),
                }
            })
            .collect()
    }

    /// One sample of what the surface in a direction reflects towards a point, and whether its back is seen. `stream`
    /// numbers the paths of a seed.
    pub fn reflected(&self, origin: Vec3, direction: Vec3, stream: u32, settings: &PathSettings) -> Reflected {
        let hit = self.scene.closest_before(origin, direction, FAR);
        if hit.is_miss() {
            return Reflected { radiance: Vec3::ZERO, is_back: false };
        }
        let is_back = self.geometry.normal(hit.triangle).dot(direction) > 0.0;
        let point = surface_point(&self.geometry, hit, direction);
        let shared = Shared { settings: *settings, sun: None };
        let light = self.gather(point, &shared, &mut Sampler::new(stream, 0, settings.seed));
        let albedo = self.geometry.albedo(hit.triangle, hit.u, hit.v) * self.scene.transmittance(hit.t);
        Reflected { radiance: albedo * (light.direct + light.indirect), is_back }
    }

    /// Learns where parallel light matters for paths that start at `start(path, sampler)`.
    fn guide(
        &self,
        settings: PathSettings,
        start: impl Fn(u32, &mut Sampler) -> Option<SurfacePoint> + Sync,
    ) -> Option<SunGuide> {
        let has_sun = self.lights.lights.iter().any(|l| l.kind == LIGHT_DIRECTIONAL);
        if !has_sun || settings.strategy != Strategy::Both || settings.bounces == 0 {
            return None;
        }
        let seed = hash3(settings.seed, 0, 0x7069_6c6f);
        let path = |k: u32| {
            let mut sampler = Sampler::new(k, 0, seed);
            start(k, &mut sampler).map(|point| training_path(self.scene, point, &mut sampler)).unwrap_or_default()
        };
        // Collected in order: the sums do not depend on the number of threads.
        let hits: Vec<_> = (0..TRAINING_PATHS).into_par_iter().map(path).flatten_iter().collect();
        SunGuide::new(self.scene, &hits)
    }

    /// New lit points for sample `sample`.
    fn shared<'g>(
        &self,
        settings: PathSettings,
        guide: &'g Option<SunGuide>,
        lit_points: u32,
        sample: u32,
    ) -> Shared<'g> {
        let seed = hash3(settings.seed, sample, 0x6c69_7470);
        Shared { settings, sun: guide.as_ref().map(|guide| (guide, guide.lit_points(self.scene, lit_points, seed))) }
    }

    /// One sample of the radiance of a pixel, split at the visible surface.
    fn pixel_sample(&self, camera: &Camera, shared: &Shared, pixel: u32, sample: u32) -> Gathered {
        let mut sampler = Sampler::new(pixel, sample, shared.settings.seed);
        let (mut hit, mut direction) = self.camera_hit(camera, pixel, &mut sampler);
        let mut origin = camera.eye;
        let mut found = Gathered::default();
        let mut throughput = Vec3::ONE;
        for surface in 0..MAX_VERTICES {
            let (radiance, distance) = self.seen(origin, hit, direction);
            throughput *= self.scene.transmittance(distance);
            found.direct += throughput * radiance;
            if distance < hit.t || hit.is_miss() {
                return found;
            }
            let onward = self.onward(hit, direction, &mut sampler);
            let through = throughput;
            throughput *= onward.weight * onward.radiance_ratio;
            let Some(ray) = onward.ray else {
                let point = shading_point(&self.geometry, hit, direction);
                let (point, lobe) = self.finished(hit, direction, point, onward.weight, shared.settings.materials);
                let light = self.gather(point, shared, &mut sampler);
                found.direct += throughput * lobe.matte * light.direct;
                found.indirect += throughput * lobe.matte * light.indirect;
                if lobe.alpha > 0.0 {
                    let light = self.gather_lobe(point, &lobe, shared, &mut sampler);
                    found.direct += through * light.direct;
                    found.indirect += through * light.indirect;
                }
                return found;
            };
            if surface >= SURE_VERTICES && !survives(&mut throughput, &mut sampler) {
                return found;
            }
            (origin, direction) = ray;
            hit = self.scene.closest_before(origin, direction, FAR);
        }
        found
    }

    /// The point that is shaded, and the lobe of its surface with this albedo.
    fn finished(
        &self,
        hit: Hit,
        direction: Vec3,
        point: SurfacePoint,
        albedo: Vec3,
        materials: Materials,
    ) -> (SurfacePoint, Lobe) {
        let geometry = &self.scene.geometry;
        let material = geometry.triangles[hit.triangle as usize].material as usize;
        if materials == Materials::Diffuse || material >= geometry.finishes.len() {
            return (point, Lobe { matte: 1.0, ..Lobe::default() });
        }
        let finishes: &[Finish] = &geometry.finishes;
        lobe::finished(&self.geometry, finishes, hit, direction, 0.0, point, albedo.extend(0.0), Vec3::ONE)
    }

    /// One sample of the radiance that a lobe sends to the eye: lights without extent by shadow rays, all else along a
    /// direction that the lobe picks.
    fn gather_lobe(&self, point: SurfacePoint, lobe: &Lobe, shared: &Shared, sampler: &mut Sampler) -> Gathered {
        let ray_offset = self.scene.geometry.ray_offset;
        let params =
            DirectParams { light_count: self.lights.lights.len() as u32, ray_offset, ..DirectParams::default() };
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| self.scene.occluded(origin, direction, t_max);
        let absorption = self.scene.geometry.absorption;
        let sharp = lobe::sharp_light(&params, absorption, point, lobe, &self.lights, stopped);
        let mut found = Gathered { direct: sharp, indirect: Vec3::ZERO };
        let (mut direction, density) = by_microfacets(lobe, point.normal, sampler.next());
        let mut origin = point.position + point.normal * ray_offset;
        let mut throughput = lobe::reflected(lobe, point.normal, direction) * (1.0 / density);
        if throughput == Vec3::ZERO || !throughput.is_finite() {
            return found;
        }
        for surface in 0..MAX_VERTICES {
            let hit = self.scene.closest_before(origin, direction, FAR);
            let (radiance, distance) = self.seen(origin, hit, direction);
            throughput *= self.scene.transmittance(distance);
            let part = if surface == 0 { &mut found.direct } else { &mut found.indirect };
            *part += throughput * radiance;
            if distance < hit.t || hit.is_miss() || surface >= shared.settings.bounces {
                return found;
            }
            let onward = self.onward(hit, direction, sampler);
            throughput *= onward.weight * onward.radiance_ratio;
            let Some(ray) = onward.ray else {
                let light = self.gather(surface_point(&self.geometry, hit, direction), shared, sampler);
                found.indirect += throughput * (light.direct + light.indirect);
                return found;
            };
            if surface >= SURE_VERTICES && !survives(&mut throughput, sampler) {
                return found;
            }
            (origin, direction) = ray;
        }
        found
    }

    /// Radiance of what shines first along a ray whose hit is known, W/m²/sr, and how far off that is, m: a rectangle
    /// light before the hit, the sky, or the emission of what was met.
    fn seen(&self, origin: Vec3, hit: Hit, direction: Vec3) -> (Vec3, f32) {
        let mut nearest = if hit.is_miss() { FAR } else { hit.t };
        let mut rect = None;
        for light in self.lights.lights {
            let t = meet_rect(light, origin, direction, nearest);
            if t < nearest {
                nearest = t;
                rect = Some(light.color);
            }
        }
        let radiance = match rect {
            Some(radiance) => radiance,
            None if hit.is_miss() => sky_radiance(&self.lights.sky, self.lights.sky_map, direction),
            None => self.emitted(hit, direction),
        };
        (radiance, nearest)
    }

    /// Picks one of the parts of a surface, by the greatest channel of their shares.
    #[inline]
    fn onward(&self, hit: Hit, direction: Vec3, sampler: &mut Sampler) -> Onward {
        let albedo = self.geometry.albedo(hit.triangle, hit.u, hit.v);
        if !self.geometry.is_specular(hit.triangle) {
            return Onward { weight: albedo, radiance_ratio: 1.0, ray: None };
        }
        let parts = specular_parts(&self.geometry, hit.triangle, direction);
        let diffuse = albedo.max_element();
        let mirrored = parts.mirrored.max_element();
        let all = diffuse + mirrored + parts.refracted.max_element();
        if all <= 0.0 {
            return Onward { weight: Vec3::ZERO, radiance_ratio: 1.0, ray: None };
        }
        let chosen = sampler.next().0 * all;
        if chosen < diffuse {
            return Onward { weight: albedo * (all / diffuse), radiance_ratio: 1.0, ray: None };
        }
        let position = self.geometry.position(hit.triangle, hit.u, hit.v);
        let above = parts.normal * self.scene.geometry.ray_offset;
        if chosen < diffuse + mirrored {
            let ray = Some((position + above, parts.mirror_direction));
            return Onward { weight: parts.mirrored * (all / mirrored), radiance_ratio: 1.0, ray };
        }
        Onward {
            weight: parts.refracted * (all / parts.refracted.max_element()),
            radiance_ratio: parts.radiance_ratio,
            ray: Some((position - above, parts.refracted_direction)),
        }
    }

    /// Hit of a ray through a random place of the pixel, and its unit direction.
    fn camera_hit(&self, camera: &Camera, pixel: u32, sampler: &mut Sampler) -> (Hit, Vec3) {
        let (dx, dy) = sampler.next();
        let x = (pixel % camera.width) as f32 + dx;
        let y = (pixel / camera.width) as f32 + dy;
        let direction = camera_direction(camera, x, y).normalize();
        (self.scene.closest_before(camera.eye, direction, FAR), direction)
    }

    /// One sample of E/π at a point, on the side of its normal.
    fn gather(&self, start: SurfacePoint, shared: &Shared, sampler: &mut Sampler) -> Gathered {
        let settings = &shared.settings;
        let mut gathered = Gathered::default();
        let mut throughput = Vec3::ONE;
        // Of radiance in the dielectric about the path, over that at its start.
        let mut ratio = 1.0;
        let mut point = start;
        let mut vertex = 0u32;
        // Density per m² with which the bounce found this vertex.
        let mut arrival = 0.0;
        loop {
            let origin = point.position + point.normal * self.scene.geometry.ray_offset;
            let mut light = self.light_by_shadow_rays(origin, point, arrival, shared, sampler);
            if let Some((_, lit)) = &shared.sun
                && vertex < settings.bounces
            {
                gathered.indirect += throughput * ratio * self.light_by_connection(origin, point.normal, lit, sampler);
            }
            let mut direction = cosine_hemisphere(point.normal, sampler.next());
            let mut hit = self.scene.closest_before(origin, direction, FAR);
            let mut left = self.scene.transmittance(if hit.is_miss() { FAR } else { hit.t });
            light += self.light_by_bounce(hit, direction, point.normal, settings.strategy) * left;
            if vertex == 0 {
                gathered.direct = light;
            } else {
                gathered.indirect += throughput * ratio * light;
            }
            let mut is_straight = true;
            // Until chance picks the diffuse part of what the ray, mirrored and refracted on its way, meets.
            loop {
                if hit.is_miss() || vertex == settings.bounces || vertex >= MAX_VERTICES {
                    return gathered;
                }
                let onward = self.onward(hit, direction, sampler);
                throughput *= onward.weight * left;
                ratio *= onward.radiance_ratio;
                vertex += 1;
                if throughput == Vec3::ZERO || vertex >= SURE_VERTICES && !survives(&mut throughput, sampler) {
                    return gathered;
                }
                let Some((origin, next)) = onward.ray else { break };
                is_straight = false;
                direction = next;
                hit = self.scene.closest_before(origin, direction, FAR);
                let (radiance, distance) = self.seen(origin, hit, direction);
                left = self.scene.transmittance(distance);
                gathered.indirect += throughput * ratio * radiance * left;
                if distance < hit.t {
                    return gathered;
                }
            }
            let cosine = direction.dot(point.normal);
            point = surface_point(&self.geometry, hit, direction);
            // Neither shadow rays nor connections find what a mirror shows.
            arrival =
                if is_straight { cosine * -direction.dot(point.normal) * FRAC_1_PI / (hit.t * hit.t) } else { 0.0 };
        }
    }

    /// E/π of light that parallel lights send to a point over one reflection, by a connection with one of the lit
    /// points.
    #[inline]
    fn light_by_connection(&self, origin: Vec3, normal: Vec3, lit: &[LitPoint], sampler: &mut Sampler) -> Vec3 {
        let k = (sampler.next().0 * lit.len() as f32) as usize;
        let y = &lit[k.min(lit.len() - 1)];
        let to = y.position + y.normal * self.scene.geometry.ray_offset - origin;
        let squared = to.length_squared();
        let here = to.dot(normal);
        let there = -to.dot(y.normal);
        if !(here > 0.0 && there > 0.0) || y.flux == Vec3::ZERO || self.scene.occluded(origin, to, 1.0) {
            return Vec3::ZERO;
        }
        let cosine_density = here * there * FRAC_1_PI / (squared * squared);
        let left = self.scene.transmittance(squared.sqrt());
        y.flux * left * (cosine_density * y.density / (y.density + cosine_density))
    }

    /// Emitted radiance of what a ray met, W/m²/sr, from the front only.
    #[inline]
    fn emitted(&self, hit: Hit, direction: Vec3) -> Vec3 {
        let radiance = self.geometry.radiance(hit.triangle, hit.u, hit.v);
        if radiance == Vec3::ZERO || self.geometry.normal(hit.triangle).dot(direction) >= 0.0 {
            return Vec3::ZERO;
        }
        radiance
    }

    /// E/π that a cosine-weighted ray brings from an emitter or from the sky.
    #[inline]
    fn light_by_bounce(&self, hit: Hit, direction: Vec3, normal: Vec3, strategy: Strategy) -> Vec3 {
        let cosine_density = direction.dot(normal) * FRAC_1_PI;
        if hit.is_miss() {
            let radiance = sky_radiance(&self.lights.sky, self.lights.sky_map, direction);
            return match &self.sky {
                Some(sky) => radiance * bounce_weight(strategy, cosine_density, || sky.density(direction)),
                None => radiance,
            };
        }
        let radiance = self.emitted(hit, direction);
        if radiance == Vec3::ZERO || self.emitter_density.is_empty() {
            return radiance;
        }
        radiance
            * bounce_weight(strategy, cosine_density, || {
                let cosine = -self.geometry.normal(hit.triangle).dot(direction);
                self.emitter_density[hit.triangle as usize] * hit.t * hit.t / cosine
            })
    }

    /// E/π of all lights by shadow rays: one to each light, one to an emissive triangle, one to the sky map.
    /// `arrival` is the density per m² with which a bounce found the point, 0 for the first one of a path.
    fn light_by_shadow_rays(
        &self,
        origin: Vec3,
        point: SurfacePoint,
        arrival: f32,
        shared: &Shared,
        sampler: &mut Sampler,
    ) -> Vec3 {
        let normal = point.normal;
        let strategy = shared.settings.strategy;
        let mut sum = Vec3::ZERO;
        for (slot, light) in self.lights.lights.iter().enumerate() {
            let mut irradiance = self.single_light(light, origin, normal, sampler);
            if light.kind == LIGHT_DIRECTIONAL
                && arrival > 0.0
                && irradiance != Vec3::ZERO
                && let Some((guide, _)) = &shared.sun
            {
                let density = guide.density(slot, point.position) * -normal.dot(light.direction);
                irradiance *= arrival / (arrival + density);
            }
            sum += irradiance;
        }
        if strategy == Strategy::Bounces {
            return sum * FRAC_1_PI;
        }
        if !self.lights.emitters.is_empty() {
            sum += self.one_emitter(origin, normal, strategy, sampler);
        }
        if let Some(sky) = &self.sky {
            let (direction, density) = sky.sample(sampler.next());
            let cosine = direction.dot(normal);
            if cosine > 0.0 && density > 0.0 && !self.scene.occluded(origin, direction, FAR) {
                let weight = shadow_weight(strategy, density, cosine * FRAC_1_PI);
                let radiance = sky_radiance(&self.lights.sky, self.lights.sky_map, direction);
                sum += radiance * self.scene.transmittance(FAR) * (cosine / density * weight);
            }
        }
        sum * FRAC_1_PI
    }

    /// Irradiance from one light.
    #[inline]
    fn single_light(&self, light: &Light, origin: Vec3, normal: Vec3, sampler: &mut Sampler) -> Vec3 {
        if light.kind == LIGHT_DIRECTIONAL {
            let cosine = -normal.dot(light.direction);
            if cosine > 0.0 && !self.scene.occluded(origin, -light.direction, FAR) {
                return light.color * self.scene.transmittance(FAR) * cosine;
            }
            return Vec3::ZERO;
        }
        let (to, share);
        if light.kind == LIGHT_RECT {
            let (u, v) = sampler.next();
            to = light.position + light.edge_a * u + light.edge_b * v - origin;
            let squared = to.length_squared();
            // edge_a × edge_b is normal · area: the area of the estimate is in it.
            share =
                to.dot(normal).max(0.0) * (-to.dot(light.edge_a.cross(light.edge_b))).max(0.0) / (squared * squared);
        } else {
            to = light.position - origin;
            let inverse = 1.0 / to.length();
            let of_direction = match light.kind {
                LIGHT_SPOT => spot_falloff(light, -to.dot(light.direction) * inverse),
                LIGHT_LUMINAIRE => luminaire_share(light, self.lights.distributions, -to),
                _ => 1.0,
            };
            share = to.dot(normal).max(0.0) * inverse * inverse * inverse * of_direction;
        }
        if share > 0.0 && share.is_finite() && !self.scene.occluded(origin, to, 1.0) {
            light.color * self.scene.transmittance(to.length()) * share
        } else {
            Vec3::ZERO
        }
    }

    /// Irradiance from all emissive triangles by a shadow ray to one of them.
    #[inline]
    fn one_emitter(&self, origin: Vec3, normal: Vec3, strategy: Strategy, sampler: &mut Sampler) -> Vec3 {
        let (x, y) = sampler.next();
        let emitters = self.lights.emitters;
        let e = emitters[pick_emitter(emitters, emitters.len() as u32, x) as usize];
        // What is left of x within the entry is uniform again, and stratified.
        let rest = clamp((x - (e.cumulative - e.probability)) / e.probability, 0.0, 1.0);
        let (u, v) = uniform_triangle((rest, y));
        let n = self.geometry.normal(e.triangle);
        let to = self.geometry.position(e.triangle, u, v) + n * self.scene.geometry.ray_offset - origin;
        let squared = to.length_squared();
        let inverse = 1.0 / squared.sqrt();
        let here = to.dot(normal) * inverse;
        let there = -to.dot(n) * inverse;
        if !(here > 0.0 && there > 0.0)
            || self.geometry.is_hole(e.triangle, u, v)
            || self.scene.occluded(origin, to, 1.0)
        {
            return Vec3::ZERO;
        }
        let density = e.probability / e.area * squared / there;
        let weight = shadow_weight(strategy, density, here * FRAC_1_PI);
        let left = self.scene.transmittance(squared.sqrt());
        self.geometry.radiance(e.triangle, u, v) * left * (here / density * weight)
    }
}

/// A direction that a lobe mirrors to the eye, and its density, 1/sr, from a point of the unit square: by microfacets that
/// are chosen by `D cosθ`, seen or not (Walter et al. 2007).
fn by_microfacets(lobe: &Lobe, normal: Vec3, at: (f32, f32)) -> (Vec3, f32) {
    let squared = lobe.alpha * lobe.alpha;
    let cosine = ((1.0 - at.0) / (1.0 + (squared - 1.0) * at.0)).sqrt();
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let (s, c) = sin_cos_2pi(at.1);
    let (right, up) = frame(normal);
    let half = right * (sine * c) + up * (sine * s) + normal * cosine;
    let facing = half.dot(lobe.to_eye);
    let spread = cosine * cosine * (squared - 1.0) + 1.0;
    let density = squared * cosine / (PI * spread * spread * 4.0 * facing.abs().max(1e-6));
    (half * (2.0 * facing) - lobe.to_eye, density)
}

/// Russian roulette: whether a path goes on, by the greatest channel of its throughput, which it then has over.
#[inline]
fn survives(throughput: &mut Vec3, sampler: &mut Sampler) -> bool {
    let chance = throughput.max_element();
    if chance < 1.0 {
        if sampler.next().0 >= chance {
            return false;
        }
        *throughput *= 1.0 / chance;
    }
    true
}

/// Weight of a shadow ray: balance heuristic.
#[inline]
fn shadow_weight(strategy: Strategy, density: f32, cosine_density: f32) -> f32 {
    if strategy == Strategy::Both { density / (density + cosine_density) } else { 1.0 }
}

/// Weight of a bounce that met a light.
#[inline]
fn bounce_weight(strategy: Strategy, cosine_density: f32, density: impl Fn() -> f32) -> f32 {
    match strategy {
        Strategy::Both => cosine_density / (cosine_density + density()),
        Strategy::ShadowRays => 0.0,
        Strategy::Bounces => 1.0,
    }
}
