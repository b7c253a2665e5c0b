//! Test lights, under which receivers are compared before any frame is rendered: what is alike
//! under all of them may be averaged.

use alloc::vec;
use alloc::vec::Vec;

use glam::{Vec3, Vec4};
use scene::gpu::{DirectParams, LIGHT_DIRECTIONAL};
use scene::math::luminance;
use scene::parallel::*;
use scene::sampling::{frame, hammersley};
use scene::{Scene, SurfacePoint, sky_exitance};
use transport::{HitCounts, LinearOperator, QUADRANTS};

use super::focus::Density;
use super::mesh::PatchMesh;
use crate::error::Error;

/// Vectors of test lights, three lights to a vector; the fourth components are 0.
pub const LIGHT_VECTORS: usize = 3;
/// Those of them that come from elements; the last comes from the sky.
const ELEMENT_VECTORS: usize = 2;
/// Values under all test lights, in grey: the scene's own lights and suns 0 and 1; suns 2 and 3 and light that is the
/// same everywhere; straight from the sky, the scene's own and an even one.
pub type Lights = [Vec4; LIGHT_VECTORS];

/// Exitance of elements and of the sky under the test lights.
#[derive(Clone, Debug)]
pub struct TestLights {
    /// Test lights of the elements.
    pub elements: Vec<Lights>,
    /// Test lights of the sky's bins, the last vector; all 0 in a scene without a sky.
    pub sky: Vec<Vec4>,
}

/// Suns among the test lights.
const SUNS: u32 = 4;
/// Changes where they stand.
const SUNS_SEED: u32 = 0x2545_f491;
/// Bounces of the test lights.
const BOUNCES: usize = 4;
/// Variance of a row's irradiance as a share of that of independent rays: rows are stratified.
/// Measured in Sponza: 0.27 (light that is the same everywhere) to 0.48.
const STRATIFIED: f32 = 0.4;

/// Irradiance of receivers under the test lights, as their rows estimate it.
pub(super) struct Estimates {
    /// Irradiance; its mean over the patches is 1 under each light.
    pub light: Vec<Lights>,
    /// Variance of the estimate.
    pub variance: Vec<Lights>,
}

impl Estimates {
    /// Light of receivers that have `rays` rays each, and a row over the elements and one over the sky's bins for each
    /// hemisphere quadrant.
    pub fn new(rows: &HitCounts, sky_rows: &HitCounts, exitance: &TestLights, rays: u32) -> Result<Self, Error> {
        let squared = TestLights {
            elements: exitance.elements.iter().map(|b| b.map(|v| v * v)).collect(),
            sky: exitance.sky.iter().map(|&b| b * b).collect(),
        };
        let mut light = gather(rows, sky_rows, exitance)?;
        let mut variance = gather(rows, sky_rows, &squared)?;
        for (variance, mean) in variance.iter_mut().zip(&light) {
            for (square, mean) in variance.iter_mut().zip(mean) {
                *square = (*square - *mean * *mean).max(Vec4::ZERO) * (STRATIFIED / rays as f32);
            }
        }
        scale_sky(&mut light, &mut variance);
        Ok(Self { light, variance })
    }
}

/// Scales what comes straight from the sky so that the receivers' mean is 1.
fn scale_sky(light: &mut [Lights], variance: &mut [Lights]) {
    let sum: Vec4 = light.iter().map(|lights| lights[ELEMENT_VECTORS]).sum();
    let mean = sum / light.len().max(1) as f32;
    let scale = Vec4::select(mean.cmpgt(Vec4::ZERO), mean.recip(), Vec4::ZERO);
    light.iter_mut().for_each(|lights| lights[ELEMENT_VECTORS] *= scale);
    variance.iter_mut().for_each(|lights| lights[ELEMENT_VECTORS] *= scale * scale);
}

/// Irradiance of receivers, the sum over their quadrants.
fn gather(rows: &HitCounts, sky_rows: &HitCounts, exitance: &TestLights) -> Result<Vec<Lights>, Error> {
    let row_count = LinearOperator::rows(rows);
    let mut gathered = vec![[Vec4::ZERO; LIGHT_VECTORS]; row_count / QUADRANTS];
    for v in 0..LIGHT_VECTORS {
        let mut received = vec![Vec4::ZERO; row_count];
        if v < ELEMENT_VECTORS {
            let vector: Vec<Vec4> = exitance.elements.iter().map(|light| light[v]).collect();
            rows.apply(&vector, &mut received)?;
        } else {
            sky_rows.apply(&exitance.sky, &mut received)?;
        }
        for (lights, quadrants) in gathered.iter_mut().zip(received.chunks(QUADRANTS)) {
            lights[v] = quadrants.iter().sum();
        }
    }
    Ok(gathered)
}

/// Exitance of the elements of a mesh under the test lights: the scene's own lights, four suns where
/// there may be suns, and light that is the same everywhere. Each is scaled so that the mean
/// irradiance of the patches, each by its area times [`Density::share`], is 1.
///
/// `factors` are the form factors from patch to patch, `element_rows` those from element to element.
///
/// # Errors
/// [`transport::Error::Length`] unless the operators have the shapes of the mesh.
pub fn test_lights(
    scene: &Scene,
    mesh: &PatchMesh,
    density: &Density,
    factors: &dyn LinearOperator,
    element_rows: &dyn LinearOperator,
    direct: &DirectParams,
) -> Result<TestLights, Error> {
    let mut exitance = vec![[Vec4::ZERO; LIGHT_VECTORS]; mesh.elements.len()];
    let irradiance = direct_irradiance(scene, &mesh.points, direct);
    for (v, irradiance) in irradiance.iter().enumerate() {
        let of_elements = settled_exitance(mesh, density, factors, element_rows, irradiance)?;
        for (lights, exitance) in exitance.iter_mut().zip(of_elements) {
            lights[v] = exitance;
        }
    }
    Ok(TestLights { elements: exitance, sky: sky_lights(scene) })
}

/// The sky's bins under the test lights that come straight from it.
fn sky_lights(scene: &Scene) -> Vec<Vec4> {
    let has_sky = scene.has_sky();
    let own = sky_exitance(&scene.lighting).into_iter();
    own.map(|own| if has_sky { Vec4::new(grey(&own), 1.0, 0.0, 0.0) } else { Vec4::ZERO }).collect()
}

/// Direct irradiance at the sample points, vector by vector.
fn direct_irradiance(scene: &Scene, points: &[SurfacePoint], direct: &DirectParams) -> [Vec<Vec4>; ELEMENT_VECTORS] {
    let own = scene.direct_irradiance(direct, points);
    let mut first: Vec<Vec4> = own.iter().map(|e| Vec4::new(luminance(*e), 0.0, 0.0, 0.0)).collect();
    let mut second = vec![Vec4::new(0.0, 0.0, 1.0, 0.0); points.len()];
    if scene.has_sky() || scene.lighting.lights.iter().any(|l| l.kind == LIGHT_DIRECTIONAL) {
        let suns = [sun_direction(0), sun_direction(1), sun_direction(2), sun_direction(3)];
        first.par_iter_mut().zip(points).for_each(|(irradiance, point)| {
            irradiance.y = sun_irradiance(scene, point, suns[0]);
            irradiance.z = sun_irradiance(scene, point, suns[1]);
        });
        second.par_iter_mut().zip(points).for_each(|(irradiance, point)| {
            irradiance.x = sun_irradiance(scene, point, suns[2]);
            irradiance.y = sun_irradiance(scene, point, suns[3]);
        });
    }
    [first, second]
}

/// Unit direction to a sun among the test lights: they are spread over the sky, none very low.
fn sun_direction(k: u32) -> Vec3 {
    let (right, up) = frame(-Vec3::Y);
    let (x, azimuth) = hammersley(k, SUNS, (0, SUNS_SEED));
    let height = 0.4 + 0.5 * x;
    let (sin, cos) = scene::math::sin_cos_2pi(azimuth);
    (right * cos + up * sin) * scene::math::sqrt(1.0 - height * height) + Vec3::Y * height
}

/// Irradiance from a sun of unit strength.
fn sun_irradiance(scene: &Scene, point: &SurfacePoint, sun: Vec3) -> f32 {
    let cosine = point.normal.dot(sun);
    let origin = point.position + point.normal * scene.geometry.ray_offset;
    if cosine > 0.0 && !scene.occluded(origin, sun, f32::INFINITY) { cosine } else { 0.0 }
}

/// Exitance of the elements after some bounces of the light that comes to the sample points, scaled
/// so that the mean irradiance of the patches is 1.
fn settled_exitance(
    mesh: &PatchMesh,
    density: &Density,
    factors: &dyn LinearOperator,
    element_rows: &dyn LinearOperator,
    irradiance: &[Vec4],
) -> Result<Vec<Vec4>, Error> {
    let source = element_source(mesh, irradiance);
    let received = patch_irradiance(mesh, factors, &source)?;
    let counted: Vec<f32> = mesh.patches.iter().map(|p| p.area * density.share(p.centroid)).collect();
    let area: f32 = counted.iter().sum();
    let mean: Vec4 = received.iter().zip(&counted).map(|(h, own)| *h * (own / area)).sum();
    let scale = Vec4::select(mean.cmpgt(Vec4::ZERO), mean.recip(), Vec4::ZERO);
    // As in frames the last bounce goes from element to element.
    let mut exitance = Vec::with_capacity(source.len());
    for (element, albedo) in (0u32..).zip(&mesh.element_albedo) {
        let patch = mesh.patch_of(element) as usize;
        exitance.push(source[element as usize] + received[patch] * grey(albedo));
    }
    let mut received = vec![Vec4::ZERO; exitance.len()];
    element_rows.apply(&exitance, &mut received)?;
    for (k, exitance) in exitance.iter_mut().enumerate() {
        *exitance = (source[k] + received[k] * grey(&mesh.element_albedo[k])) * scale;
    }
    Ok(exitance)
}

/// First exitance of the elements from the irradiance at their sample points.
fn element_source(mesh: &PatchMesh, irradiance: &[Vec4]) -> Vec<Vec4> {
    let mut source = Vec::with_capacity(mesh.elements.len());
    for range in mesh.offsets.windows(2) {
        let own = range[0] as usize..range[1] as usize;
        let mut sum = Vec4::ZERO;
        for (point, (albedo, irradiance)) in
            mesh.points[own.clone()].iter().zip(mesh.point_albedo[own.clone()].iter().zip(&irradiance[own]))
        {
            sum += irradiance * (point.weight * grey(albedo));
        }
        source.push(sum);
    }
    source
}

/// Irradiance of the patches after some bounces.
fn patch_irradiance(mesh: &PatchMesh, factors: &dyn LinearOperator, source: &[Vec4]) -> Result<Vec<Vec4>, Error> {
    let source = mesh.patch_means(source);
    let mut exitance = source.clone();
    let mut received = vec![Vec4::ZERO; exitance.len()];
    for _ in 0..BOUNCES {
        factors.apply(&exitance, &mut received)?;
        for (i, exitance) in exitance.iter_mut().enumerate() {
            *exitance = source[i] + received[i] * grey(&mesh.albedo[i]);
        }
    }
    Ok(received)
}

fn grey(albedo: &Vec4) -> f32 {
    luminance(albedo.truncate())
}
