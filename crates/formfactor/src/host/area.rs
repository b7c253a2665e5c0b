//! Form factors by pairs of points on both patches: low-discrepancy pairs, more of them the nearer the patches are.

use alloc::vec::Vec;
use core::f64::consts::PI;

use glam::DVec3;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::double::{atan2, sin_cos};
use transport::Polygon;

use super::contour::contour;
use super::triangle::{four_parts, triangle_area};

/// Depth to which a triangle of the receiving patch is split towards a near source.
const DEEPEST: u32 = 5;

/// Beyond this many radii a source is sampled by area, nearer by solid angle.
const FAR_RADII: f64 = 3.0;

/// All pairs of points are used up to a distance of this many radii (squared) of both patches, fewer beyond.
const PAIRS_NEARBY: f64 = 1.0;

/// Point `k` of the additive recurrence in four dimensions whose steps are the powers of 1/φ₄, φ₄⁵ = φ₄ + 1 (Roberts
/// 2018), shifted by `shift` on the torus.
pub fn recurrence(k: u64, shift: [f64; 4]) -> [f64; 4] {
    const STEPS: [f64; 4] =
        [0.856_674_883_854_502_9, 0.733_891_856_627_126, 0.628_706_721_037_808_7, 0.538_597_257_223_610_1];
    let mut x = [0.0; 4];
    for d in 0..4 {
        x[d] = (shift[d] + (k + 1) as f64 * STEPS[d]).fract();
    }
    x
}

/// Uniform point of a triangle (Heitz 2019).
fn triangle_point(t: [DVec3; 3], x: f64, y: f64) -> DVec3 {
    let (u, v) = if y > x { (0.5 * x, y - 0.5 * x) } else { (x - 0.5 * y, 0.5 * y) };
    t[0] + (t[1] - t[0]) * u + (t[2] - t[0]) * v
}

/// Uniform point of a polygon: a triangle of the fan in proportion to its area, then a point of it; what is left of x
/// is uniform again.
pub fn polygon_point(polygon: &Polygon, x: f64, y: f64) -> DVec3 {
    let mut rest = x * polygon.area;
    let last = polygon.corners().len() - 3;
    for (k, t) in polygon.fan().enumerate() {
        let area = triangle_area(t);
        if rest < area || k == last {
            return triangle_point(t, (rest / area).clamp(0.0, 1.0), y);
        }
        rest -= area;
    }
    polygon.centroid
}

/// Solid angle of a triangle of unit vectors (Van Oosterom and Strackee 1983).
fn solid_angle(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let triple = a.dot(b.cross(c)).abs();
    2.0 * atan2(triple, 1.0 + a.dot(b) + b.dot(c) + c.dot(a))
}

/// Uniform direction within a spherical triangle of solid angle `omega` (Arvo 1995).
fn spherical_triangle_point(a: DVec3, b: DVec3, c: DVec3, omega: f64, x: f64, y: f64) -> DVec3 {
    let at = |p: DVec3| (p - a * p.dot(a)).normalize_or_zero();
    let ab = at(b);
    let ac = at(c);
    let cos_alpha = ab.dot(ac).clamp(-1.0, 1.0);
    let sin_alpha = ab.cross(ac).length();
    let alpha = atan2(sin_alpha, cos_alpha);
    let (s, t) = sin_cos(x * omega - alpha);
    let u = t - cos_alpha;
    let v = s + sin_alpha * a.dot(b);
    let denominator = (v * s + u * t) * sin_alpha;
    let q = if denominator == 0.0 { 1.0 } else { (((v * t - u * s) * cos_alpha - v) / denominator).clamp(-1.0, 1.0) };
    let d = a * q + ac * (1.0 - q * q).max(0.0).sqrt();
    let z = 1.0 - y * (1.0 - d.dot(b));
    b * z + (d - b * d.dot(b)).normalize_or_zero() * (1.0 - z * z).max(0.0).sqrt()
}

/// Estimate of the form factor of the point to the source by one direction or point (x, y in the unit square):
/// `cosθ cosθ'/(π r²)` over the density of the choice, 0 when the point chosen is hidden.
fn sample_source(
    point: DVec3,
    normal: DVec3,
    source: &Polygon,
    near: bool,
    x: f64,
    y: f64,
    visible: &impl Fn(DVec3, DVec3) -> bool,
) -> f64 {
    if !near {
        let target = polygon_point(source, x, y);
        let to = target - point;
        let squared = to.length_squared();
        let here = to.dot(normal);
        let there = -to.dot(source.normal);
        let seen = here > 0.0 && there > 0.0 && visible(point, target);
        return if seen { source.area * here * there / (PI * squared * squared) } else { 0.0 };
    }
    let unit = |p: DVec3| (p - point).normalize_or_zero();
    let total: f64 = source.fan().map(|[a, b, c]| solid_angle(unit(a), unit(b), unit(c))).sum();
    let mut rest = x * total;
    let last = source.corners().len() - 3;
    for (k, [a, b, c]) in source.fan().enumerate() {
        let ua = unit(a);
        let ub = unit(b);
        let uc = unit(c);
        let omega = solid_angle(ua, ub, uc);
        if (rest < omega || k == last) && omega > 0.0 {
            let direction = spherical_triangle_point(ua, ub, uc, omega, (rest / omega).min(1.0), y);
            let here = direction.dot(normal);
            let there = -direction.dot(source.normal);
            if here <= 0.0 || there <= 0.0 {
                return 0.0;
            }
            let target = point + direction * ((point - a).dot(source.normal) / there);
            return if visible(point, target) { total * here / PI } else { 0.0 };
        }
        rest -= omega;
    }
    0.0
}

/// Form factor of a patch to another by pairs of points. `receiver` and `source` are cut at each other's planes,
/// `area` is the whole area of the receiving patch; at most about `samples` pairs, fewer the greater the distance
/// of the patches.
pub(super) fn patch_to_patch(
    receiver: &Polygon,
    source: &Polygon,
    area: f64,
    samples: u32,
    shift: [f64; 4],
    visible: &impl Fn(DVec3, DVec3) -> bool,
) -> f64 {
    let mut leaves = Vec::new();
    for t in receiver.fan() {
        split(t, source, DEEPEST, &mut leaves);
    }
    // Pairs go where the unoccluded energy is; a small even share keeps every leaf sampled.
    let mut expected: Vec<f64> = leaves
        .iter()
        .map(|&t| triangle_area(t) * contour((t[0] + t[1] + t[2]) / 3.0, receiver.normal, source))
        .collect();
    let floor = 0.02 * expected.iter().sum::<f64>() / receiver.area;
    for (e, &t) in expected.iter_mut().zip(&leaves) {
        *e += (floor + f64::MIN_POSITIVE) * triangle_area(t);
    }
    let total: f64 = expected.iter().sum();
    let ratio = (receiver.radius + source.radius) / receiver.centroid.distance(source.centroid).max(f64::MIN_POSITIVE);
    let pairs = (f64::from(samples) * (PAIRS_NEARBY * ratio * ratio).min(1.0)).max(4.0);
    let mut sum = 0.0;
    let mut k = 0u64;
    let mut owed = 0.0;
    for (&t, e) in leaves.iter().zip(&expected) {
        owed += pairs * e / total;
        let count = (owed as u64).max(1);
        owed -= count as f64;
        let centre = (t[0] + t[1] + t[2]) / 3.0;
        let near = source.distance(centre) < FAR_RADII * source.radius;
        let mut leaf = 0.0;
        for _ in 0..count {
            let x = recurrence(k, shift);
            leaf += sample_source(triangle_point(t, x[0], x[1]), receiver.normal, source, near, x[2], x[3], visible);
            k += 1;
        }
        sum += leaf / count as f64 * triangle_area(t);
    }
    sum / area
}

/// Form factor of a point to a patch, the source cut at the point's horizon.
pub(super) fn point_to_patch(
    point: DVec3,
    normal: DVec3,
    source: &Polygon,
    samples: u32,
    shift: [f64; 4],
    visible: &impl Fn(DVec3, DVec3) -> bool,
) -> f64 {
    let distance = source.distance(point);
    let near = distance < FAR_RADII * source.radius;
    let ratio = source.radius / distance.max(f64::MIN_POSITIVE);
    let count = (f64::from(samples) * (PAIRS_NEARBY * ratio * ratio).min(1.0)).max(4.0) as u64;
    let mut sum = 0.0;
    for k in 0..count {
        let y = recurrence(k, shift)[0];
        let x = (shift[3] + (k as f64 + 0.5) / count as f64).fract();
        sum += sample_source(point, normal, source, near, x, y, visible);
    }
    sum / count as f64
}

fn split(t: [DVec3; 3], source: &Polygon, depth: u32, leaves: &mut Vec<[DVec3; 3]>) {
    let centre = (t[0] + t[1] + t[2]) / 3.0;
    let radius = t.iter().map(|p| p.distance(centre)).fold(0.0, f64::max);
    if depth == 0 || source.distance(centre) > 1.5 * radius {
        leaves.push(t);
        return;
    }
    for part in four_parts(t) {
        split(part, source, depth - 1, leaves);
    }
}
