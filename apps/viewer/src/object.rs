//! A white ball that is moved through the scene: indirect light from probes in the air, direct light by shadow rays.
//!
//! It is drawn over the picture on the host, behind what its rays say is before it. It casts neither light nor shadow
//! back: the light of the scene is that of the bake's geometry.

use std::f32::consts::FRAC_1_PI;
use std::ops::Range;

use glam::Vec3;
use patchlight::bake::direct_params;
use patchlight::outputs::LiveProbes;
use rayon::prelude::*;
use scene::gpu::DirectParams;
use scene::kernel::camera::camera_direction;
use scene::kernel::shade::{decode_srgb, encode_srgb};
use scene::math::sqrt;
use scene::{Camera, DisplayTransform, NONE, Scene, SurfacePoint};

/// Probes, about.
pub const PROBES: u32 = 512;
/// Rays from each side of a probe.
pub const PROBE_RAYS: u32 = 256;
/// Shadow rays to each area light, and rays to the sky, from a pixel.
const RAYS: u32 = 32;
/// Places in a pixel along its edges, at which it is asked what covers it.
const PLACES: usize = 2;
/// Share of a ray's way within which what it meets touches the ball.
const TOUCHING: f32 = 1e-4;
/// Matt white paint.
const WHITE: f32 = 0.8;

/// The ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Object {
    /// True if it is there.
    pub is_on: bool,
    /// Its middle, m.
    pub position: Vec3,
    /// m.
    pub radius: f32,
    /// Share of the light that it reflects.
    pub albedo: Vec3,
}

impl Object {
    /// One of a radius, m, that is not there yet.
    pub fn new(radius: f32) -> Self {
        Self { is_on: false, position: Vec3::ZERO, radius, albedo: Vec3::splat(WHITE) }
    }

    /// First point where a ray with a unit direction meets it from outside, m.
    fn meet(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let to = self.position - origin;
        let along = to.dot(direction);
        let within = self.radius * self.radius - (to - along * direction).length_squared();
        let t = along - sqrt(within.max(0.0));
        (within > 0.0 && t > 0.0).then_some(t)
    }

    /// Columns and rows of a picture that it may cover.
    fn covered(&self, camera: &Camera) -> (Range<usize>, Range<usize>) {
        let size = (camera.width as usize, camera.height as usize);
        let to = self.position - camera.eye;
        let depth = to.dot(camera.forward);
        let all = (0..size.0, 0..size.1);
        if depth <= 1.01 * self.radius {
            // Beside the eye or behind it: where it is seen at all, its outline is no ellipse.
            return if depth < -self.radius { (0..0, 0..0) } else { all };
        }
        // Of the box round it, whose near side is widest.
        let near = depth - self.radius;
        let extent = |axis: Vec3, pixels: usize| {
            let half = axis.length();
            let at = to.dot(axis) / half;
            let bounds = [at - self.radius, at + self.radius].map(|x| [x / near, x / (depth + self.radius)]);
            let low = bounds[0][0].min(bounds[0][1]);
            let high = bounds[1][0].max(bounds[1][1]);
            let pixel = |x: f32| (0.5 + 0.5 * x / half) * pixels as f32;
            (pixel(low), pixel(high))
        };
        let (left, right) = extent(camera.right, size.0);
        let (bottom, top) = extent(camera.up, size.1);
        let clip = |low: f32, high: f32, pixels: usize| {
            (low.floor().clamp(0.0, pixels as f32) as usize)..(high.ceil().clamp(0.0, pixels as f32) as usize)
        };
        (clip(left, right, size.0), clip(size.1 as f32 - top, size.1 as f32 - bottom, size.1))
    }
}

/// A pixel of the ball: its place in the picture, the share that the ball covers, and where it is seen.
struct Seen {
    pixel: usize,
    share: f32,
    point: SurfacePoint,
}

/// Draws the ball over a displayed picture: bytes red, green, blue and 255, row by row.
pub fn draw(
    bytes: &mut [u8],
    camera: &Camera,
    transform: &DisplayTransform,
    object: &Object,
    probes: &LiveProbes,
    scene: &Scene,
) {
    let seen = seen(camera, object, scene);
    let points: Vec<SurfacePoint> = seen.iter().map(|seen| seen.point).collect();
    let rays = DirectParams { count: points.len() as u32, area_rays: RAYS, ..direct_params(scene) };
    let direct = DirectParams { sky_rays: if scene.has_sky() { RAYS } else { 0 }, ..rays };
    let direct = scene.direct_irradiance(&direct, &points);
    let indirect = points.par_iter().map(|point| probes.irradiance(point.position, point.normal));
    let indirect: Vec<Vec3> = indirect.collect();
    for ((seen, direct), indirect) in seen.iter().zip(direct).zip(indirect) {
        let radiance = object.albedo * (direct + indirect) * FRAC_1_PI;
        let Some(pixel) = bytes.get_mut(4 * seen.pixel..4 * seen.pixel + 3) else { continue };
        for (code, own) in pixel.iter_mut().zip(transform.color(radiance).to_array()) {
            let behind = decode_srgb(f32::from(*code) / 255.0);
            let mixed = behind + (own - behind) * seen.share;
            *code = (encode_srgb(mixed) * 255.0 + 0.5) as u8;
        }
    }
}

/// The pixels that show the ball.
fn seen(camera: &Camera, object: &Object, scene: &Scene) -> Vec<Seen> {
    let (columns, rows) = object.covered(camera);
    rows.into_par_iter()
        .flat_map_iter(|y| columns.clone().filter_map(move |x| seen_in(camera, object, scene, (x, y))))
        .collect()
}

fn seen_in(camera: &Camera, object: &Object, scene: &Scene, (x, y): (usize, usize)) -> Option<Seen> {
    let mut count = 0;
    let mut sum = Vec3::ZERO;
    for place in 0..PLACES * PLACES {
        let within = |k: usize| (k as f32 + 0.5) / PLACES as f32;
        let at = (x as f32 + within(place % PLACES), y as f32 + within(place / PLACES));
        let direction = camera_direction(camera, at.0, at.1).normalize_or_zero();
        let Some(t) = object.meet(camera.eye, direction) else { continue };
        if !scene.occluded(camera.eye, direction, t * (1.0 - TOUCHING)) {
            count += 1;
            sum += camera.eye + t * direction;
        }
    }
    let normal = (sum / count.max(1) as f32 - object.position).try_normalize().filter(|_| count > 0)?;
    let position = object.position + object.radius * normal;
    Some(Seen {
        pixel: y * camera.width as usize + x,
        share: count as f32 / (PLACES * PLACES) as f32,
        point: SurfacePoint { position, patch: NONE, normal, weight: 1.0 },
    })
}

#[cfg(test)]
mod tests {
    use glam::vec3;

    use super::*;

    #[test]
    fn what_a_ball_covers_is_in_its_bounds() {
        let mut most = 0;
        for k in 0..200u32 {
            let random = |d: u32| scene::sampling::unit(scene::sampling::hash3(k, d, 7));
            let eye = vec3(random(0), random(1), random(2)) * 4.0;
            let target = vec3(random(3), random(4), random(5)) * 4.0;
            let camera = Camera::look_at(eye, target, Vec3::Y, 40.0 + 60.0 * random(6), 40, 30);
            let position = eye + (vec3(random(7), random(8), random(9)) - 0.5) * 6.0;
            let object = Object { position, ..Object::new(0.2 + random(10)) };
            let (columns, rows) = object.covered(&camera);
            for (x, y) in (0..30).flat_map(|y| (0..40).map(move |x| (x, y))) {
                let direction = camera_direction(&camera, x as f32 + 0.5, y as f32 + 0.5).normalize();
                let is_met = object.meet(eye, direction).is_some();
                let is_bounded = columns.contains(&x) && rows.contains(&y);
                assert!(!is_met || is_bounded, "{k}: {x} {y} beside {columns:?} {rows:?}");
                most += usize::from(is_met);
            }
        }
        assert!(most > 1000, "{most} pixels of balls");
    }

    #[test]
    fn a_ray_meets_the_near_side() {
        let object = Object { position: 5.0 * Vec3::Z, ..Object::new(1.0) };
        assert_eq!(object.meet(Vec3::ZERO, Vec3::Z), Some(4.0));
        assert_eq!(object.meet(Vec3::ZERO, Vec3::NEG_Z), None);
        assert_eq!(object.meet(1.5 * Vec3::X, Vec3::Z), None);
        assert_eq!(object.meet(5.0 * Vec3::Z, Vec3::Z), None, "from within");
    }
}
