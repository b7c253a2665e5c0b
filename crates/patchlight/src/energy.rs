//! A bake's estimate of its own errors, without a reference: light lost between patches, and receivers compared with
//! rays.

use formfactor::{Stop, jacobi};
use glam::{Vec3, Vec4};
use rayon::prelude::*;
use scene::gpu::DirectParams;
use scene::math::luminance;
use scene::sampling::{cosine_hemisphere, hammersley, hash3, unit};
use scene::{Hit, NONE, SurfacePoint};
use serde::{Deserialize, Serialize};
use transport::kernel::grid::interpolate_receivers;
use transport::{LinearOperator, QUADRANTS};

use crate::bake::Bake;
use crate::error::Error;
use crate::low_level::stage::source::sky_exitance;

/// Places at which rays are gathered, and rays of each.
const PLACES: u32 = 4096;
const RAYS: u32 = 16;
/// Most shadow rays to lights from where those hit: of many lights there are fewer places, and a greater standard
/// error.
const MAX_SHADOW_RAYS: usize = 1 << 26;
const MIN_PLACES: usize = 32;
/// Rays to each area light and to the sky from where one of those hits.
const LIGHT_RAYS: u32 = 4;
/// Start above, and end below, of rays that look for the triangle of a place, in ray offsets.
const OFFSETS: f32 = 4.0;
/// Light that all patches send alike is absorbed or gone when bounces change it by less than this.
const TOLERANCE: f32 = 1e-5;
/// One of so many patches shines where light is another than that of the scene.
const ONE_OF: u32 = 16;
/// Changes random numbers.
const SALT: u32 = 0x656e_6572;

/// Estimated errors of a bake without a reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EnergyCheck {
    /// (absorbed + escaped) / emitted − 1, where every patch sends 1 W/m² and light goes on until it is absorbed or
    /// escapes: `Σ A ((1 − ρ) H + B F_0) / Σ A E − 1`. Zero for form factors that are reciprocal and whose rows sum to
    /// `1 − F_0`.
    pub balance: f64,
    /// Indirect light in the focus beside rays; none in a scene without light.
    pub near: Option<MeanRatio>,
    /// Ratio where distances between patches are greater; none where there are no such places.
    pub far: Option<MeanRatio>,
    /// That of the focus under light which the bake was not made for: every sixteenth patch, by chance, sends 1 W/m²
    /// and nothing else shines.
    pub unseen: Option<MeanRatio>,
}

/// Mean irradiance that comes from surfaces at random places: what receivers show over what rays find.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeanRatio {
    /// Mean of what is shown over the mean of what rays find.
    pub ratio: f64,
    /// Its standard error, that of the rays.
    pub standard_error: f64,
    /// Places.
    pub places: usize,
}

/// Greatest standard error of a ratio that is believed; beyond it the places are too few, most of all where light comes
/// from small bright spots, which few rays meet.
pub const MAX_STANDARD_ERROR: f64 = 0.03;
/// Share of the energy that form factors may lose or add without a word.
const MAX_IMBALANCE: f64 = 0.005;

impl MeanRatio {
    /// Returns true if there were enough rays to believe it.
    pub fn is_believed(&self) -> bool {
        self.standard_error <= MAX_STANDARD_ERROR
    }

    /// Describes a light, such as "indirect light", by its ratio, as a part of a sentence.
    pub fn summary(&self, light: &str) -> String {
        let error = 100.0 * self.standard_error;
        match self.is_believed() {
            true => format!("{light} {:+.1} % (± {error:.1} %) beside rays", 100.0 * (self.ratio - 1.0)),
            false => format!(
                "{light} not judged, for {} places with {RAYS} rays each tell it to ± {error:.0} % only",
                self.places
            ),
        }
    }
}

impl EnergyCheck {
    /// Sentences that say what was checked, and what is known of it: a ratio is a statement only where its standard
    /// error is at most [`MAX_STANDARD_ERROR`].
    pub fn summary(&self) -> String {
        let checks = [
            ("indirect light", self.near),
            ("indirect light far off", self.far),
            ("light that the bake was not made for", self.unseen),
        ];
        let mut sentences: Vec<String> =
            checks.iter().filter_map(|(light, ratio)| Some(ratio.as_ref()?.summary(light))).collect();
        let percent = 100.0 * self.balance.abs();
        sentences.push(match self.balance {
            balance if balance.abs() < MAX_IMBALANCE => "form factors keep the energy".to_owned(),
            balance => format!(
                "form factors {} {percent:.1} % of light that all patches send alike, most of it in bounces that a \
                 picture gathers anew",
                if balance < 0.0 { "lose" } else { "add" }
            ),
        });
        sentences.join("; ")
    }

    /// That of a bake: the balance of its patches, and 65,536 rays from 4,096 places that are shared out as patches
    /// are; fewer for more than 1,024 lights, each of which costs a shadow ray where a ray hits. Where a ray hits,
    /// direct light is found anew, and indirect light is that of the bake's element there: what is compared is the last
    /// bounce with all that patches, elements, receivers and interpolation do to it. The same again under light from
    /// some of the patches. None without patches, and in a medium.
    ///
    /// # Errors
    /// Operators that have not the shapes of the mesh.
    pub fn of(bake: &Bake) -> Result<Option<Self>, Error> {
        if bake.mesh.patches.is_empty() || bake.scene.has_medium() {
            return Ok(None);
        }
        let places = places(bake, place_count(bake.scene.lighting.lights.len()));
        let values_of = |light: &Settled, patches: Option<&[Vec4]>| -> Vec<(f64, f64)> {
            let shown = places.iter().map(|place| light.shown(bake, place));
            shown.zip(light.gathered(bake, &places, patches)).collect()
        };
        let ratio = |values: &[(f64, f64)], is_near: bool| {
            let chosen = places.iter().zip(values).filter(|(place, _)| place.is_near == is_near);
            mean_ratio(&chosen.map(|(_, values)| *values).collect::<Vec<_>>())
        };
        let own = values_of(&Settled::new(bake, &scene_source(bake))?, None);
        let some = some_patches(bake);
        let unseen = values_of(&Settled::new(bake, &some)?, Some(&some));
        Ok(Some(Self {
            balance: balance(bake)?,
            near: ratio(&own, true),
            far: ratio(&own, false),
            unseen: ratio(&unseen, true),
        }))
    }
}

/// [`EnergyCheck::balance`].
fn balance(bake: &Bake) -> Result<f64, Error> {
    let mesh = &bake.mesh;
    let source = vec![Vec3::ONE.extend(0.0); mesh.patches.len()];
    let settled = jacobi(&*bake.form_factors.factors, &source, &mesh.albedo, Stop::Tolerance(TOLERANCE))?;
    let sky: Vec<Vec4> = bake.form_factors.sky_factor.iter().map(|&share| Vec4::splat(share)).collect();
    let mut emitted = 0.0;
    let mut gone = 0.0;
    for (i, sky) in mesh.patch_means(&sky).into_iter().enumerate() {
        let area = f64::from(mesh.patches[i].area);
        let absorbed = (Vec4::ONE - mesh.albedo[i]) * settled.irradiance[i];
        let escaped = settled.exitance[i] * sky;
        emitted += area * 3.0;
        gone += area * f64::from((absorbed + escaped).truncate().element_sum());
    }
    Ok(gone / emitted - 1.0)
}

/// Ratio of the means of pairs, and its error to first order; none where the second mean is 0.
fn mean_ratio(values: &[(f64, f64)]) -> Option<MeanRatio> {
    let (shown, found) = values.iter().fold((0.0, 0.0), |sum, v| (sum.0 + v.0, sum.1 + v.1));
    if found <= 0.0 {
        return None;
    }
    let ratio = shown / found;
    let squares: f64 = values.iter().map(|(shown, found)| (shown - ratio * found).powi(2)).sum();
    Some(MeanRatio { ratio, standard_error: squares.sqrt() / found, places: values.len() })
}

/// A place on the surface.
struct Place {
    point: SurfacePoint,
    hit: Hit,
    is_front: bool,
    is_near: bool,
}

/// Places for so many lights.
fn place_count(lights: usize) -> u32 {
    let affordable = MAX_SHADOW_RAYS / (RAYS as usize * lights.max(1));
    affordable.clamp(MIN_PLACES, PLACES as usize) as u32
}

/// Sample points of the elements, each as likely as its area times its share of the density, and one in each interval
/// of their sum.
fn places(bake: &Bake, count: u32) -> Vec<Place> {
    let mesh = &bake.mesh;
    let mut sums = Vec::with_capacity(mesh.points.len());
    let mut sum = 0.0f64;
    for (element, range) in mesh.elements.iter().zip(mesh.offsets.windows(2)) {
        for point in &mesh.points[range[0] as usize..range[1] as usize] {
            sum += f64::from(point.weight * element.area * bake.density.share(point.position));
            sums.push(sum);
        }
    }
    let seed = bake.settings.seed ^ SALT;
    let place = |k: u32| {
        let at = (f64::from(k) + f64::from(unit(hash3(k, 0, seed)))) * sum / f64::from(count);
        let point = mesh.points[sums.partition_point(|&s| s <= at).min(sums.len() - 1)];
        let scene = &bake.scene;
        let above = OFFSETS * scene.geometry.ray_offset;
        let hit = scene.closest_before(point.position + point.normal * above, -point.normal, 2.0 * above);
        let is_front = !hit.is_miss() && scene.tables().normal(hit.triangle).dot(point.normal) > 0.0;
        let is_near = bake.density.level(point.position) == 0;
        (!hit.is_miss()).then_some(Place { point, hit, is_front, is_near })
    };
    (0..count).into_par_iter().filter_map(place).collect()
}

/// First exitance of the elements under the lighting of the scene, W/m².
fn scene_source(bake: &Bake) -> Vec<Vec4> {
    let mesh = &bake.mesh;
    let direct = bake.scene.direct_irradiance(&bake.direct, &mesh.points);
    let mut source = sky_exitance(bake, &mesh.element_albedo, &bake.scene.lighting);
    for (range, source) in mesh.offsets.windows(2).zip(&mut source) {
        let own = range[0] as usize..range[1] as usize;
        for ((point, albedo), direct) in
            mesh.points[own.clone()].iter().zip(&mesh.point_albedo[own.clone()]).zip(&direct[own])
        {
            *source += *albedo * direct.extend(0.0) * point.weight;
        }
    }
    source
}

/// First exitance of the elements where one of [`ONE_OF`] patches shines, W/m².
fn some_patches(bake: &Bake) -> Vec<Vec4> {
    let mesh = &bake.mesh;
    let seed = bake.settings.seed ^ SALT;
    let shines = |element: u32| hash3(mesh.patch_of(element), 3, seed).is_multiple_of(ONE_OF);
    (0..mesh.elements.len() as u32)
        .map(|element| if shines(element) { Vec3::ONE.extend(0.0) } else { Vec4::ZERO })
        .collect()
}

/// The light that comes of what elements send first, W/m².
struct Settled {
    /// Indirect irradiance of the elements.
    elements: Vec<Vec4>,
    /// That of the interpolation points.
    points: Vec<Vec4>,
}

impl Settled {
    /// By the steps of a frame.
    fn new(bake: &Bake, source: &[Vec4]) -> Result<Self, Error> {
        let mesh = &bake.mesh;
        let factors = &bake.form_factors;
        let patches = jacobi(&*factors.factors, &mesh.patch_means(source), &mesh.albedo, Stop::Bounces(bake.bounces))?;
        let mut elements = patches.irradiance.clone();
        if let Some(rows) = &factors.element_rows {
            let patch = |element: usize| patches.irradiance[mesh.patch_of(element as u32) as usize];
            let exitance: Vec<Vec4> = (0..source.len())
                .map(|element| source[element] + mesh.element_albedo[element] * patch(element))
                .collect();
            elements = vec![Vec4::ZERO; source.len()];
            rows.apply(&exitance, &mut elements)?;
        }
        let exitance: Vec<Vec4> = (0..source.len())
            .map(|element| source[element] + mesh.element_albedo[element] * elements[element])
            .collect();
        let points = interpolated(bake, &exitance)?;
        Ok(Self { elements, points })
    }

    /// Indirect irradiance that is shown at a place: between interpolation points, or that of the element where there
    /// are none.
    fn shown(&self, bake: &Bake, place: &Place) -> f64 {
        let mesh = &bake.receivers.interpolation;
        let shown = match self.points.is_empty() {
            true => self.of_element(bake.mesh.element_on_side(&place.hit, place.is_front)),
            false => {
                interpolate_receivers(&mesh.grids, &mesh.cells, &mesh.vertices, &self.points, place.hit, place.is_front)
            }
        };
        f64::from(luminance(shown.truncate()))
    }

    fn of_element(&self, element: u32) -> Vec4 {
        if element == NONE { Vec4::ZERO } else { self.elements[element as usize] }
    }

    /// Indirect irradiance at places, by rays, under the lighting of the scene or where these are what elements send
    /// first.
    fn gathered(&self, bake: &Bake, places: &[Place], patches: Option<&[Vec4]>) -> Vec<f64> {
        let scene = &bake.scene;
        let seed = bake.settings.seed ^ SALT;
        let ray = |k: usize| {
            let point = &places[k / RAYS as usize].point;
            let index = k as u32 / RAYS;
            let shift = (hash3(index, 1, seed), hash3(index, 2, seed));
            let direction = cosine_hemisphere(point.normal, hammersley(k as u32 % RAYS, RAYS, shift));
            let hit = scene.closest_before(
                point.position + point.normal * scene.geometry.ray_offset,
                direction,
                f32::INFINITY,
            );
            (hit, direction)
        };
        let rays: Vec<(Hit, Vec3)> = (0..places.len() * RAYS as usize).into_par_iter().map(ray).collect();
        let hits: Vec<SurfacePoint> = rays.iter().map(|&(hit, direction)| hit_point(bake, hit, direction)).collect();
        let has_sky = scene.has_sky();
        let params = DirectParams {
            count: hits.len() as u32,
            area_rays: LIGHT_RAYS,
            sky_rays: if has_sky { LIGHT_RAYS } else { 0 },
            seed,
            ..bake.direct
        };
        let direct = if patches.is_none() { scene.direct_irradiance(&params, &hits) } else { Vec::new() };
        let reflected = |k: usize| {
            let (hit, direction) = rays[k];
            if hit.is_miss() {
                return 0.0;
            }
            let albedo = scene.filtered_albedo(hit.triangle, hits[k].position, 0.0);
            let element = bake.mesh.element(scene, &hit, direction);
            let indirect = self.of_element(element).truncate();
            let sent = match patches {
                Some(patches) => patches.get(element as usize).map_or(Vec3::ZERO, |sent| sent.truncate()),
                None => albedo * direct[k],
            };
            f64::from(luminance(sent + albedo * indirect))
        };
        let gathered = (0..places.len()).into_par_iter().map(|place| {
            let own = place * RAYS as usize..(place + 1) * RAYS as usize;
            own.map(reflected).sum::<f64>() / f64::from(RAYS)
        });
        gathered.collect()
    }
}

/// Irradiance of the interpolation points from the exitance of the elements; none where there are no receivers.
fn interpolated(bake: &Bake, exitance: &[Vec4]) -> Result<Vec<Vec4>, Error> {
    let receivers = &bake.receivers;
    let count = receivers.points.len();
    if count == 0 {
        return Ok(Vec::new());
    }
    let first_smooth = receivers.first_smooth();
    let mut values = vec![Vec4::ZERO; first_smooth + count];
    let (quadrants, smooth) = values.split_at_mut(first_smooth);
    receivers.rows.apply(exitance, &mut quadrants[..QUADRANTS * count])?;
    receivers.smoothing.apply(0, QUADRANTS, quadrants, smooth)?;
    let mut points = vec![Vec4::ZERO; receivers.interpolation.points.len()];
    receivers.weights.apply(first_smooth, 1, &values, &mut points)?;
    Ok(points)
}

/// The point where a ray hits, on the side that it came from; of one that escapes nothing is asked.
fn hit_point(bake: &Bake, hit: Hit, direction: Vec3) -> SurfacePoint {
    let geometry = bake.scene.tables();
    if hit.is_miss() {
        return SurfacePoint { position: Vec3::ZERO, patch: NONE, normal: Vec3::Y, weight: 1.0 };
    }
    let front = geometry.normal(hit.triangle);
    let normal = if front.dot(direction) < 0.0 { front } else { -front };
    SurfacePoint { position: geometry.position(hit.triangle, hit.u, hit.v), patch: NONE, normal, weight: 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratios_are_said_only_where_they_can_be_believed() {
        let check = |standard_error: f64, balance: f64| {
            let near = Some(MeanRatio { ratio: 1.181, standard_error, places: 4096 });
            EnergyCheck { balance, near, far: None, unseen: None }.summary()
        };
        let sure = check(0.004, 0.001);
        assert!(sure.contains("+18.1 % (± 0.4 %)") && sure.ends_with("form factors keep the energy"), "{sure}");
        let unsure = check(0.082, -0.348);
        assert!(!unsure.contains("18.1") && unsure.contains("not judged") && unsure.contains("± 8 %"), "{unsure}");
        assert!(unsure.contains("lose 34.8 %"), "{unsure}");
    }

    #[test]
    fn many_lights_have_fewer_places_and_no_more_shadow_rays() {
        for (lights, places) in
            [(0, PLACES), (1, PLACES), (1024, PLACES), (4096, PLACES / 4), (100_000, 41), (1 << 30, 32)]
        {
            assert_eq!(place_count(lights), places, "{lights} lights");
        }
    }
}
