//! Which triangles of a scene share a chart of the lightmap.

use alloc::vec::Vec;

use glam::{IVec3, Vec2, Vec3};
use scene::gpu::TriangleUv;
use scene::parallel::*;
use scene::{Scene, Sides};

/// Corners nearer than this share of the scene's diagonal are one.
const SAME_CORNER: f32 = 1e-5;
/// Least cosine between normals of triangles that are called even.
const SAME_PLANE: f32 = 1.0 - 1e-6;
/// Least cosine between the normals across an edge inside of a chart, and between those of a chart and its middle: 30°.
const MIN_COSINE: f32 = 0.866;
/// Most triangles of a chart.
const MAX_TRIANGLES: usize = 1024;
/// A chart whose triangles cover so much of its rectangle may take more texels than its parts: small rectangles that
/// fit together in no other way become large ones.
const FULL: f32 = 0.75;
/// Triangles of a chart may overlap by so much, in texels: rounding.
const OVERLAP: f32 = 0.01;
/// Permitted overlap where charts are given: whoever made them may have meant fewer texels.
const GIVEN_OVERLAP: f32 = 0.5;
/// Triangles of a given chart that cover less, in texels, have no place in it.
const MIN_AREA: f32 = 1e-4;
/// Times that all edges are looked at: strips become blocks in later ones.
const MAX_PASSES: u32 = 12;

/// A triangle in the plane of its chart.
pub(super) struct ChartTriangle {
    pub triangle: u32,
    pub front: bool,
    /// Corners, m, from the chart's least coordinates on.
    pub corners: [Vec2; 3],
}

/// Triangles that share a rectangle of the atlas.
pub(super) struct Chart {
    pub triangles: Vec<ChartTriangle>,
    /// Texels with the border, as numbers that may exceed every limit.
    pub size: Vec2,
}

/// The charts of all sides, in the order of their first triangles: neighbours across an edge come together, even ones
/// first, as long as they fill their rectangle or take no more texels than apart, bend little and do not cover each
/// other in the chart.
pub(super) fn charts(scene: &Scene, sides: &[Sides], texel: f32) -> Vec<Chart> {
    let corners: Vec<[Vec3; 3]> =
        (scene.geometry.triangles.iter()).map(|t| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b]).collect();
    let mut merging = Merging::new(scene, corners, texel);
    let edges = merging.edges(scene, sides);
    for _ in 0..MAX_PASSES {
        let merged = edges.iter().filter(|&&edge| merging.merge(edge)).count();
        if merged == 0 {
            break;
        }
    }
    let mut charts = Vec::new();
    for group in merging.groups.iter().flatten() {
        let side = sides[group.triangles[0] as usize];
        for front in [true, false] {
            if if front { side.front } else { side.back } {
                charts.push(merging.chart(group, front));
            }
        }
    }
    charts
}

/// Two triangles with an edge in common.
#[derive(Clone, Copy)]
struct Edge {
    triangles: [u32; 2],
    is_even: bool,
    length: f32,
}

/// Triangles that have come together, by number.
#[derive(Clone)]
struct Group {
    triangles: Vec<u32>,
    frame: Frame,
    /// Least and greatest coordinates of all corners in the frame, m.
    low: Vec2,
    high: Vec2,
}

/// Directions of a chart.
#[derive(Clone, Copy)]
struct Frame {
    along: Vec3,
    normal: Vec3,
}

impl Frame {
    /// Along the edge of a triangle from corner `k` on.
    fn of(corners: &[Vec3; 3], normal: Vec3, k: usize) -> Option<Self> {
        let along = (corners[(k + 1) % 3] - corners[k]).normalize_or_zero();
        (along != Vec3::ZERO).then_some(Self { along, normal })
    }

    /// Directions rotated into the plane of another.
    fn turned_to(self, normal: Vec3) -> Option<Self> {
        let along = (self.along - normal * self.along.dot(normal)).normalize_or_zero();
        (along != Vec3::ZERO).then_some(Self { along, normal })
    }

    fn flat(&self, p: Vec3) -> Vec2 {
        Vec2::new(p.dot(self.along), p.dot(self.normal.cross(self.along)))
    }
}

struct Merging {
    texel: f32,
    /// Corners from the middle of the scene on, m.
    corners: Vec<[Vec3; 3]>,
    normals: Vec<Vec3>,
    /// The group of each triangle, whose first triangle numbers it.
    group_of: Vec<u32>,
    groups: Vec<Option<Group>>,
}

impl Merging {
    /// Each triangle that has an area as a group.
    fn new(scene: &Scene, mut corners: Vec<[Vec3; 3]>, texel: f32) -> Self {
        let middle = 0.5 * (scene.geometry.bounds.0 + scene.geometry.bounds.1);
        corners.iter_mut().flatten().for_each(|c| *c -= middle);
        let tables = scene.tables();
        let normals: Vec<Vec3> = (0..corners.len() as u32).map(|t| tables.normal(t)).collect();
        let group_of = (0..corners.len() as u32).collect();
        let mut merging = Self { texel, corners, normals, group_of, groups: Vec::new() };
        merging.groups = (0..merging.corners.len() as u32).map(|triangle| merging.alone(triangle)).collect();
        merging
    }

    fn alone(&self, triangle: u32) -> Option<Group> {
        let corners = &self.corners[triangle as usize];
        let normal = self.normals[triangle as usize];
        if self.area(triangle) <= 0.0 || !normal.is_finite() {
            return None;
        }
        let frames = (0..3).filter_map(|k| Frame::of(corners, normal, k));
        let groups = frames.map(|frame| self.group(alloc::vec![triangle], frame));
        groups.min_by(|a, b| self.texels(a).total_cmp(&self.texels(b)))
    }

    fn area(&self, triangle: u32) -> f32 {
        let c = &self.corners[triangle as usize];
        0.5 * (c[1] - c[0]).cross(c[2] - c[0]).length()
    }

    fn group(&self, triangles: Vec<u32>, frame: Frame) -> Group {
        let places = triangles.iter().flat_map(|&t| self.corners[t as usize]).map(|c| frame.flat(c));
        let (low, high) = places.fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)));
        Group { triangles, frame, low, high }
    }

    /// Texels of a group's rectangle with its border.
    fn texels(&self, group: &Group) -> f32 {
        ((group.high - group.low) / self.texel + 2.0).element_product()
    }

    /// Pairs of lit triangles that may come together, even ones first, of these the longest edges.
    fn edges(&self, scene: &Scene, sides: &[Sides]) -> Vec<Edge> {
        let scale = 1.0 / (SAME_CORNER * scene.diagonal().max(f32::MIN_POSITIVE));
        let key = |p: Vec3| (p * scale).round().as_ivec3();
        let less = |a: IVec3, b: IVec3| a.to_array() < b.to_array();
        let mut ends: Vec<([[i32; 3]; 2], u32, f32)> = Vec::new();
        for (triangle, group) in (0u32..).zip(&self.groups) {
            let side = sides[triangle as usize];
            if group.is_none() || !(side.front || side.back) {
                continue;
            }
            let c = self.corners[triangle as usize];
            for k in 0..3 {
                let p = c[k];
                let q = c[(k + 1) % 3];
                let a = key(p);
                let b = key(q);
                if a != b {
                    let pair = if less(a, b) { [a, b] } else { [b, a] };
                    ends.push((pair.map(|e| e.to_array()), triangle, p.distance(q)));
                }
            }
        }
        ends.par_sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut edges: Vec<Edge> = (ends.windows(2))
            .filter(|w| w[0].0 == w[1].0 && w[0].1 != w[1].1)
            .filter(|w| sides[w[0].1 as usize] == sides[w[1].1 as usize])
            .filter_map(|w| {
                let cosine = self.normals[w[0].1 as usize].dot(self.normals[w[1].1 as usize]);
                let edge = Edge { triangles: [w[0].1, w[1].1], is_even: cosine > SAME_PLANE, length: w[0].2 };
                (cosine > MIN_COSINE).then_some(edge)
            })
            .collect();
        edges.sort_by(|a, b| {
            b.is_even.cmp(&a.is_even).then(b.length.total_cmp(&a.length)).then(a.triangles.cmp(&b.triangles))
        });
        edges
    }

    /// Brings the groups on both sides of an edge together, if they may.
    fn merge(&mut self, edge: Edge) -> bool {
        let [a, b] = edge.triangles.map(|t| self.group_of[t as usize]);
        if a == b {
            return false;
        }
        let (Some(one), Some(two)) = (&self.groups[a as usize], &self.groups[b as usize]) else { return false };
        if one.triangles.len() + two.triangles.len() > MAX_TRIANGLES {
            return false;
        }
        let Some(both) = self.together(one, two) else { return false };
        let first = a.min(b);
        let other = a.max(b);
        for &triangle in &both.triangles {
            self.group_of[triangle as usize] = first;
        }
        self.groups[other as usize] = None;
        self.groups[first as usize] = Some(both);
        true
    }

    fn together(&self, one: &Group, two: &Group) -> Option<Group> {
        let (large, small) = if self.texels(one) >= self.texels(two) { (one, two) } else { (two, one) };
        let normal = large.frame.normal;
        if small.triangles.iter().any(|&t| self.normals[t as usize].dot(normal) < MIN_COSINE) {
            return None;
        }
        let mut triangles = [&large.triangles[..], &small.triangles[..]].concat();
        triangles.sort_unstable();
        // A pair of triangles lies along any of its edges; more keep the directions of one of the two.
        let edges = if triangles.len() == 2 { 0..3 } else { 0..0 };
        let corners = &self.corners[large.triangles[0] as usize];
        let frames = edges.filter_map(|k| Frame::of(corners, normal, k));
        let frames = frames.chain([large.frame]).chain(small.frame.turned_to(normal));
        let both = frames.map(|frame| self.group(triangles.clone(), frame));
        let both = both.min_by(|a, b| self.texels(a).total_cmp(&self.texels(b)))?;
        let area: f32 = triangles.iter().map(|&t| self.area(t)).sum();
        let is_full = area > FULL * (both.high - both.low).element_product();
        let fits = is_full || self.texels(&both) <= self.texels(one) + self.texels(two);
        (fits && !self.overlap(large, small, &both.frame)).then_some(both)
    }

    /// Returns true if a triangle of one covers part of one of the other in a chart of both.
    fn overlap(&self, one: &Group, two: &Group, frame: &Frame) -> bool {
        let flat = |group: &Group| -> Vec<[Vec2; 3]> {
            group.triangles.iter().map(|&t| self.corners[t as usize].map(|c| frame.flat(c))).collect()
        };
        let one = flat(one);
        let two = flat(two);
        one.iter().any(|a| two.iter().any(|b| triangles_overlap(a, b, OVERLAP * self.texel)))
    }

    fn chart(&self, group: &Group, front: bool) -> Chart {
        let corners = |t: u32| self.corners[t as usize].map(|p| group.frame.flat(p) - group.low);
        let triangle = |&t: &u32| ChartTriangle { triangle: t, front, corners: corners(t) };
        let size = ((group.high - group.low) / self.texel).ceil() + 2.0;
        Chart { triangles: group.triangles.iter().map(triangle).collect(), size }
    }
}

/// Returns true if two triangles overlap by more than so much: no edge of either separates them.
fn triangles_overlap(a: &[Vec2; 3], b: &[Vec2; 3], depth: f32) -> bool {
    let bounds = |t: &[Vec2; 3]| (t[0].min(t[1]).min(t[2]), t[0].max(t[1]).max(t[2]));
    let ((a_low, a_high), (b_low, b_high)) = (bounds(a), bounds(b));
    if (a_low + depth).cmpge(b_high).any() || (b_low + depth).cmpge(a_high).any() {
        return false;
    }
    let separates = |t: &[Vec2; 3], other: &[Vec2; 3]| {
        (0..3).any(|k| {
            let axis = (t[(k + 1) % 3] - t[k]).perp().normalize_or_zero();
            let along = |p: &Vec2| (*p - t[k]).dot(axis);
            // Which side the triangle itself is on.
            let inside = along(&t[(k + 2) % 3]).signum();
            other.iter().all(|p| along(p) * inside <= depth)
        })
    };
    !separates(a, b) && !separates(b, a)
}

/// One chart of given places in [0, 1]², `[triangles]`, of which `width` texels of `texel` m are each way. A triangle
/// takes part with its front, if that is lit, else with its back.
pub(super) fn given_chart(sides: &[Sides], uvs: &[Option<TriangleUv>], width: u32, texel: f32) -> Chart {
    let triangle = |(t, (side, uv)): (u32, (&Sides, &Option<TriangleUv>))| {
        let uv = uv.filter(|_| side.front || side.back)?;
        // There is no border: the middle of the first texel is half of one from the edge.
        let place = |uv: Vec2| (uv * width as f32 - 1.0) * texel;
        let corners = [place(uv.corner), place(uv.corner_a), place(uv.corner_b)];
        let double = (corners[1] - corners[0]).perp_dot(corners[2] - corners[0]).abs();
        (double > MIN_AREA * texel * texel).then_some(ChartTriangle { triangle: t, front: side.front, corners })
    };
    Chart {
        triangles: (0u32..).zip(sides.iter().zip(uvs)).filter_map(triangle).collect(),
        size: Vec2::splat(width as f32),
    }
}

/// Two triangles that lie on each other in a chart by more than [`GIVEN_OVERLAP`] texels, if any do.
pub(super) fn overlapping(chart: &Chart, texel: f32) -> Option<[u32; 2]> {
    // Along x those that are open are few.
    let first_x = |t: &ChartTriangle| t.corners.iter().fold(f32::INFINITY, |x, c| x.min(c.x));
    let mut order: Vec<&ChartTriangle> = chart.triangles.iter().collect();
    order.sort_by(|a, b| first_x(a).total_cmp(&first_x(b)));
    let mut open: Vec<&ChartTriangle> = Vec::new();
    for one in order {
        let first = first_x(one);
        open.retain(|other| other.corners.iter().any(|c| c.x > first));
        let hit = open.iter().find(|other| triangles_overlap(&one.corners, &other.corners, GIVEN_OVERLAP * texel));
        if let Some(other) = hit {
            return Some([other.triangle, one.triangle]);
        }
        open.push(one);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_overlap_unless_an_edge_separates_them() {
        let a = [Vec2::ZERO, Vec2::X, Vec2::Y];
        let moved = |x: f32, y: f32| a.map(|p| p + Vec2::new(x, y));
        assert!(triangles_overlap(&a, &moved(0.2, 0.2), 1e-3));
        assert!(!triangles_overlap(&a, &moved(0.6, 0.6), 1e-3));
        assert!(!triangles_overlap(&a, &moved(1.0, 0.0), 1e-3));
        assert!(triangles_overlap(&a, &a, 1e-3));
        // The other half of the square has an edge in common.
        let half = [Vec2::X, Vec2::ONE, Vec2::Y];
        assert!(!triangles_overlap(&a, &half, 1e-3));
        assert!(triangles_overlap(&a, &half.map(|p| p - 0.1), 1e-3));
    }
}
