//! Flat convex outlines of patches, in double precision.

use glam::{DVec3, Vec3};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;

use crate::error::Error;

/// Most corners of a polygon that is given; cutting it by two planes adds at most two.
const MAX_CORNERS: usize = 8;
const CAPACITY: usize = MAX_CORNERS + 2;

/// A flat convex polygon. The corners run counter-clockwise as seen from the front, the side that sends and receives.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(into = "stored::Corners", try_from = "stored::Corners")
)]
pub struct Polygon {
    corners: [DVec3; CAPACITY],
    count: usize,
    /// Unit normal of the front.
    pub normal: DVec3,
    /// Area, m².
    pub area: f64,
    /// Centre of mass, m.
    pub centroid: DVec3,
    /// Greatest distance of a corner from the centre, m.
    pub radius: f64,
}

#[cfg(feature = "serde")]
mod stored {
    use alloc::vec::Vec;

    use super::*;

    /// A polygon in a file: its corners alone, m; all else follows from them.
    #[derive(serde::Serialize, serde::Deserialize)]
    pub(super) struct Corners(#[serde(with = "scene::pod::table")] Vec<DVec3>);

    impl From<Polygon> for Corners {
        fn from(polygon: Polygon) -> Self {
            Self(polygon.corners().to_vec())
        }
    }

    impl TryFrom<Corners> for Polygon {
        type Error = Error;

        fn try_from(Corners(given): Corners) -> Result<Self, Error> {
            let mut corners = [DVec3::ZERO; CAPACITY];
            let wrong = Error::PolygonCorners { found: given.len(), most: CAPACITY };
            corners.get_mut(..given.len()).ok_or(wrong)?.copy_from_slice(&given);
            Self::measure(corners, given.len())
                .ok_or(Error::PolygonShape { corner: 0, reason: "belongs to an outline without area" })
        }
    }
}

impl Polygon {
    /// Checks the corners and measures the polygon.
    ///
    /// # Errors
    /// [`Error::PolygonCorners`] unless there are 3 to 8; [`Error::PolygonShape`] when a corner is not finite, lies
    /// more than 10⁻⁴ of the size off the plane, makes the outline concave, or the area is zero.
    pub fn new(corners: &[Vec3]) -> Result<Self, Error> {
        if corners.len() < 3 || corners.len() > MAX_CORNERS {
            return Err(Error::PolygonCorners { found: corners.len(), most: MAX_CORNERS });
        }
        let mut table = [DVec3::ZERO; CAPACITY];
        for (corner, p) in corners.iter().enumerate() {
            if !p.is_finite() {
                return Err(Error::PolygonShape { corner, reason: "is not finite" });
            }
            table[corner] = p.as_dvec3();
        }
        let polygon = Self::measure(table, corners.len())
            .ok_or(Error::PolygonShape { corner: 0, reason: "belongs to an outline without area" })?;
        let n = polygon.count;
        for corner in 0..n {
            let a = table[corner];
            let b = table[(corner + 1) % n];
            let c = table[(corner + 2) % n];
            if (a - polygon.centroid).dot(polygon.normal).abs() > 1e-4 * polygon.radius {
                return Err(Error::PolygonShape { corner, reason: "lies off the plane of the others" });
            }
            if (b - a).cross(c - b).dot(polygon.normal) < -1e-6 * polygon.radius * polygon.radius {
                return Err(Error::PolygonShape { corner: (corner + 1) % n, reason: "makes the outline concave" });
            }
        }
        Ok(polygon)
    }

    /// A triangle; `None` when it has no area.
    pub fn triangle(a: DVec3, b: DVec3, c: DVec3) -> Option<Self> {
        let mut corners = [DVec3::ZERO; CAPACITY];
        (corners[0], corners[1], corners[2]) = (a, b, c);
        Self::measure(corners, 3)
    }

    fn measure(corners: [DVec3; CAPACITY], count: usize) -> Option<Self> {
        let mut twice = DVec3::ZERO;
        for k in 2..count {
            twice += (corners[k - 1] - corners[0]).cross(corners[k] - corners[0]);
        }
        let normal = twice.try_normalize()?;
        let mut centroid = DVec3::ZERO;
        for k in 2..count {
            let share = (corners[k - 1] - corners[0]).cross(corners[k] - corners[0]).dot(normal);
            centroid += (corners[0] + corners[k - 1] + corners[k]) * (share / 3.0);
        }
        centroid /= twice.length();
        let radius = corners[..count].iter().map(|p| p.distance(centroid)).fold(0.0, f64::max);
        Some(Self { corners, count, normal, area: 0.5 * twice.length(), centroid, radius })
    }

    /// The corners, m.
    pub fn corners(&self) -> &[DVec3] {
        &self.corners[..self.count]
    }

    /// The triangles of a fan from the first corner.
    pub fn fan(&self) -> impl Iterator<Item = [DVec3; 3]> + '_ {
        (2..self.count).map(|k| [self.corners[0], self.corners[k - 1], self.corners[k]])
    }

    /// The part in front of the plane through `origin` with unit normal `normal`; `None` when nothing is left. Parts
    /// nearer to the plane than 10⁻⁷ of `origin`'s and the polygon's coordinates count as in it, and so as nothing.
    pub fn clip(&self, origin: DVec3, normal: DVec3) -> Option<Self> {
        let margin = 1e-7 * (self.centroid - origin).abs().max_element().max(self.radius);
        let mut heights = [0.0; CAPACITY];
        let mut low = f64::INFINITY;
        let mut high = f64::NEG_INFINITY;
        for (height, corner) in heights.iter_mut().zip(self.corners()) {
            *height = (*corner - origin).dot(normal);
            low = low.min(*height);
            high = high.max(*height);
        }
        if high <= margin {
            return None;
        }
        if low >= -margin {
            return Some(*self);
        }
        let mut corners = [DVec3::ZERO; CAPACITY];
        let mut count = 0;
        for k in 0..self.count {
            let next = (k + 1) % self.count;
            let p = self.corners[k];
            let q = self.corners[next];
            let hp = heights[k];
            let hq = heights[next];
            if hp >= 0.0 && count < CAPACITY {
                corners[count] = p;
                count += 1;
            }
            if (hp >= 0.0) != (hq >= 0.0) && count < CAPACITY {
                corners[count] = p + (q - p) * (hp / (hp - hq));
                count += 1;
            }
        }
        if count < 3 { None } else { Self::measure(corners, count) }
    }

    /// Distance of a point from the polygon, m.
    pub fn distance(&self, point: DVec3) -> f64 {
        let height = (point - self.corners[0]).dot(self.normal);
        let mut inside = true;
        let mut nearest = f64::INFINITY;
        for k in 0..self.count {
            let a = self.corners[k];
            let edge = self.corners[(k + 1) % self.count] - a;
            let to = point - a;
            inside &= self.normal.cross(edge).dot(to) >= 0.0;
            let share = (to.dot(edge) / edge.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            nearest = nearest.min((to - edge * share).length_squared());
        }
        if inside { height.abs() } else { nearest.sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Polygon {
        Polygon::new(&[Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y]).unwrap()
    }

    #[test]
    fn a_square_is_measured_cut_and_its_distance_found() {
        let s = square();
        assert!((s.area - 1.0).abs() < 1e-12 && (s.normal - DVec3::Z).length() < 1e-12);
        let cut = s.clip(DVec3::new(0.25, 0.0, 0.0), DVec3::X).unwrap();
        assert!((cut.area - 0.75).abs() < 1e-12 && (cut.centroid.x - 0.625).abs() < 1e-12);
        assert!(s.clip(DVec3::ZERO, DVec3::Z).is_none() && s.clip(DVec3::ZERO, -DVec3::Z).is_none());
        assert_eq!(s.distance(DVec3::new(0.5, 0.5, 2.0)), 2.0);
        assert_eq!(s.distance(DVec3::new(4.0, 0.5, 4.0)), 5.0);
    }

    #[test]
    fn bad_outlines_are_refused() {
        let shape = |corners: &[Vec3]| Polygon::new(corners).unwrap_err();
        assert_eq!(shape(&[Vec3::ZERO, Vec3::X]), Error::PolygonCorners { found: 2, most: 8 });
        assert!(matches!(shape(&[Vec3::ZERO, Vec3::X, Vec3::X * 2.0]), Error::PolygonShape { .. }));
        assert!(matches!(shape(&[Vec3::ZERO, Vec3::X, Vec3::NAN]), Error::PolygonShape { corner: 2, .. }));
        let dart = [Vec3::ZERO, Vec3::X, Vec3::new(0.2, 0.2, 0.0), Vec3::Y];
        assert!(matches!(shape(&dart), Error::PolygonShape { corner: 2, .. }));
        let bent = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.3), Vec3::Y];
        assert!(matches!(shape(&bent), Error::PolygonShape { .. }));
    }
}
