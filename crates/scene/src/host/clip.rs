//! Triangles cut at the planes of a grid of voxels, in double precision.

use glam::DVec3;

use crate::gpu::Triangle;
use crate::sampling::uniform_triangle;

/// Corners of a triangle cut by six planes at most: each plane adds one.
const MAX_CORNERS: usize = 10;

/// A convex flat polygon.
#[derive(Clone, Copy, Debug)]
pub struct Polygon {
    corners: [DVec3; MAX_CORNERS],
    len: usize,
}

impl Polygon {
    /// The whole of a triangle.
    pub fn of_triangle(t: &Triangle) -> Self {
        let mut corners = [DVec3::ZERO; MAX_CORNERS];
        let corner = t.corner.as_dvec3();
        corners[..3].copy_from_slice(&[corner, corner + t.edge_a.as_dvec3(), corner + t.edge_b.as_dvec3()]);
        Self { corners, len: 3 }
    }

    /// Its corners in order; none for what a cut leaves of nothing.
    pub fn corners(&self) -> &[DVec3] {
        &self.corners[..self.len]
    }

    /// Area, m²; 0 for fewer than three corners.
    pub fn area(&self) -> f64 {
        let c = self.corners();
        (2..c.len()).map(|k| (c[k - 1] - c[0]).cross(c[k] - c[0])).sum::<DVec3>().length() * 0.5
    }

    /// Centre of mass; the mean corner for a polygon without area.
    pub fn centroid(&self) -> DVec3 {
        let c = self.corners();
        let mut sum = DVec3::ZERO;
        let mut weight = 0.0;
        for k in 2..c.len() {
            let area = (c[k - 1] - c[0]).cross(c[k] - c[0]).length();
            sum += (c[0] + c[k - 1] + c[k]) * area;
            weight += 3.0 * area;
        }
        if weight > 0.0 { sum / weight } else { c.iter().sum::<DVec3>() / c.len().max(1) as f64 }
    }

    /// A point of the polygon from one of the unit square, uniformly; needs three corners.
    pub fn point(&self, at: (f32, f32)) -> DVec3 {
        let c = self.corners();
        let double = |k: usize| (c[k - 1] - c[0]).cross(c[k] - c[0]).length();
        let mut rest = f64::from(at.0) * (2..c.len()).map(double).sum::<f64>();
        let mut k = 2;
        while k + 1 < c.len() && rest > double(k) {
            rest -= double(k);
            k += 1;
        }
        let x = (rest / double(k)).clamp(0.0, 1.0) as f32;
        let (u, v) = uniform_triangle((x, at.1));
        c[0] + (c[k - 1] - c[0]) * f64::from(u) + (c[k] - c[0]) * f64::from(v)
    }

    /// The parts before and from the plane `x[axis] = at` on (Sutherland and Hodgman 1974). A polygon in the plane
    /// belongs to the second part wholly, so the parts' areas always sum to the whole.
    fn split(&self, axis: usize, at: f64) -> (Self, Self) {
        let empty = Self { corners: [DVec3::ZERO; MAX_CORNERS], len: 0 };
        let mut before = empty;
        let mut beyond = empty;
        for k in 0..self.len {
            let p = self.corners[k];
            let q = self.corners[(k + 1) % self.len];
            let p_before = p[axis] < at;
            let q_before = q[axis] < at;
            if p_before {
                before.push(p);
            } else {
                beyond.push(p);
            }
            if p_before != q_before {
                let mut cut = p + (q - p) * ((at - p[axis]) / (q[axis] - p[axis]));
                cut[axis] = at;
                before.push(cut);
                beyond.push(cut);
            }
        }
        (before, beyond)
    }

    fn push(&mut self, p: DVec3) {
        // Rounding cannot make a convex polygon gain more than one corner a plane; a lost corner would lose a sliver
        // only.
        if self.len < MAX_CORNERS {
            self.corners[self.len] = p;
            self.len += 1;
        }
    }
}

/// Half-open layers along one axis: layer k is `[origin + k·edge, origin + (k + 1)·edge)`.
#[derive(Clone, Copy, Debug)]
pub struct Layers {
    /// Position of the first, m.
    pub origin: f64,
    /// Thickness, m.
    pub edge: f64,
    /// Number of them, at least 1.
    pub count: u32,
}

impl Layers {
    /// The layer of a coordinate; the nearest one for what lies outside.
    pub fn layer_of(&self, x: f64) -> u32 {
        (((x - self.origin) / self.edge).max(0.0) as u32).min(self.count - 1)
    }

    /// Gives each layer's part of the polygon to `take`.
    fn slice(&self, polygon: &Polygon, axis: usize, mut take: impl FnMut(u32, &Polygon)) {
        let low = polygon.corners().iter().fold(f64::INFINITY, |m, c| m.min(c[axis]));
        let high = polygon.corners().iter().fold(f64::NEG_INFINITY, |m, c| m.max(c[axis]));
        let first = self.layer_of(low);
        let last = self.layer_of(high);
        let mut rest = *polygon;
        for layer in first..last {
            let (before, beyond) = rest.split(axis, self.origin + f64::from(layer + 1) * self.edge);
            if before.len >= 3 {
                take(layer, &before);
            }
            rest = beyond;
        }
        if rest.len >= 3 {
            take(last, &rest);
        }
    }
}

/// Gives the part of a triangle in each voxel (i, j, k) that it touches to `take(i, j, k, part)`.
pub fn cut_triangle(t: &Triangle, layers: &[Layers; 3], mut take: impl FnMut([u32; 3], &Polygon)) {
    let [x, y, z] = layers;
    x.slice(&Polygon::of_triangle(t), 0, |i, slab| {
        y.slice(slab, 1, |j, beam| z.slice(beam, 2, |k, part| take([i, j, k], part)));
    });
}

/// The part of a triangle in one voxel.
pub fn cut_to_cell(t: &Triangle, layers: &[Layers; 3], cell: [u32; 3]) -> Polygon {
    let mut part = Polygon::of_triangle(t);
    for (axis, layer) in layers.iter().enumerate() {
        let low = layer.origin + f64::from(cell[axis]) * layer.edge;
        let within = part.split(axis, low).1.split(axis, low + layer.edge).0;
        part = within;
    }
    part
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{hash3, unit};
    use glam::Vec3;

    fn layers(count: u32) -> [Layers; 3] {
        [Layers { origin: 0.0, edge: 1.0 / f64::from(count), count }; 3]
    }

    #[test]
    fn parts_sum_to_the_triangle_and_lie_in_their_voxels() {
        let random = |k, d| Vec3::from_array([0, 1, 2].map(|a| unit(hash3(k, d, a))));
        for k in 0..500 {
            let a = random(k, 0);
            let b = random(k, 1);
            let c = random(k, 2);
            let t = Triangle { corner: a, edge_a: b - a, edge_b: c - a, ..Triangle::default() };
            let whole = Polygon::of_triangle(&t);
            let mut area = 0.0;
            let mut moment = DVec3::ZERO;
            cut_triangle(&t, &layers(7), |cell, part| {
                let alone = cut_to_cell(&t, &layers(7), cell);
                assert!((alone.area() - part.area()).abs() < 1e-12);
                area += part.area();
                moment += part.centroid() * part.area();
                for p in part.corners() {
                    for axis in 0..3 {
                        let place = p[axis] * 7.0 - f64::from(cell[axis]);
                        assert!((-1e-9..=1.0 + 1e-9).contains(&place), "{place}");
                    }
                }
            });
            assert!((area - whole.area()).abs() < 1e-12 && (moment / area - whole.centroid()).length() < 1e-9);
        }
    }

    #[test]
    fn a_triangle_between_two_voxels_is_counted_once() {
        // In the plane z = 1/2 exactly, and just below it.
        for (z, layer) in [(0.5, 1), (0.499_999, 0)] {
            let t =
                Triangle { corner: Vec3::new(0.0, 0.0, z), edge_a: Vec3::X, edge_b: Vec3::Y, ..Triangle::default() };
            let mut area = 0.0;
            cut_triangle(&t, &layers(2), |cell, part| {
                assert_eq!(cell[2], layer);
                area += part.area();
            });
            assert!((area - 0.5).abs() < 1e-12);
        }
    }
}
