//! Exact form factors without occlusion by Lambert's contour formula (Lambert 1760; Baum, Rushmeier and Winget 1989).

use core::f64::consts::TAU;

use glam::DVec3;
use scene::double::atan2;
use transport::Polygon;

use super::triangle::{four_parts, triangle_area};

/// Cubature of degree 5 on a triangle (Radon 1948): barycentric coordinates (one coordinate, the other two equal) and
/// weights.
const RADON: [(f64, f64); 3] = [
    (1.0 / 3.0, 0.225),
    (0.797_426_985_353_087_3, 0.125_939_180_544_827_15),
    (0.059_715_871_789_769_82, 0.132_394_152_788_506_2),
];

/// Depth to which a triangle of the receiving patch is split at most.
const DEEPEST: u32 = 10;

/// Form factor of a point with unit normal to a polygon, `F = 1/2π Σ_e Θ_e n·Γ_e` over the edges of the part above the
/// point's horizon: the share of the point's cosine-weighted hemisphere that the front of the polygon covers.
pub fn point_to_polygon(point: DVec3, normal: DVec3, polygon: &Polygon) -> f64 {
    match polygon.clip(point, normal) {
        Some(part) => contour(point, normal, &part),
        None => 0.0,
    }
}

/// The contour sum for a polygon that lies above the horizon.
pub(super) fn contour(point: DVec3, normal: DVec3, polygon: &Polygon) -> f64 {
    if (point - polygon.centroid).dot(polygon.normal) <= 0.0 {
        return 0.0;
    }
    let corners = polygon.corners();
    let mut sum = 0.0;
    let mut a = corners[corners.len() - 1] - point;
    for corner in corners {
        let b = *corner - point;
        let cross = b.cross(a);
        let length = cross.length();
        if length > 0.0 {
            sum += atan2(length, a.dot(b)) * normal.dot(cross) / length;
        }
        a = b;
    }
    (sum / TAU).max(0.0)
}

/// Form factor of a polygon to another, without occlusion: the mean of [`point_to_polygon`] over the receiver by
/// adaptive cubature. `receiver` and `source` are already cut at each other's planes ([`Polygon::clip`]), `area` is the
/// whole area of the receiver, m².
pub fn polygon_to_polygon(receiver: &Polygon, source: &Polygon, area: f64) -> f64 {
    let value = |p: DVec3| contour(p, receiver.normal, source);
    let far = receiver.centroid.distance(source.centroid) > 6.0 * (receiver.radius + source.radius);
    let coarse: f64 = receiver.fan().map(|t| cubature(t, &value)).sum();
    if far {
        return coarse / area;
    }
    let tolerance = 3e-5 * coarse.max(1e-9 * area);
    let total: f64 = receiver.fan().map(|t| refine(t, cubature(t, &value), tolerance, DEEPEST, &value)).sum();
    total / area
}

fn cubature(t: [DVec3; 3], value: &impl Fn(DVec3) -> f64) -> f64 {
    let mut sum = RADON[0].1 * value((t[0] + t[1] + t[2]) / 3.0);
    for (major, weight) in [RADON[1], RADON[2]] {
        let minor = 0.5 * (1.0 - major);
        for k in 0..3 {
            sum += weight * value(t[k] * major + (t[(k + 1) % 3] + t[(k + 2) % 3]) * minor);
        }
    }
    sum * triangle_area(t)
}

fn refine(t: [DVec3; 3], whole: f64, tolerance: f64, depth: u32, value: &impl Fn(DVec3) -> f64) -> f64 {
    let parts = four_parts(t);
    let values = parts.map(|part| cubature(part, value));
    let sum: f64 = values.iter().sum();
    if (sum - whole).abs() <= tolerance || depth == 0 {
        return sum;
    }
    // Errors of neighbours have different signs: half the tolerance for a fourth of the area keeps the sum in bounds.
    (0..4).map(|k| refine(parts[k], values[k], 0.5 * tolerance, depth - 1, value)).sum()
}
