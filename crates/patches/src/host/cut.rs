//! Triangles cut where something stands on them: light of either side of a wall then lies on triangles of its own.
//!
//! Patches, elements, receivers and interpolation points belong to triangles. A floor that goes on beyond a wall would
//! share them between both sides of the wall, which are strangers to each other. So the floor is cut along the foot of
//! the wall: the same surface, more triangles.

use alloc::vec;
use alloc::vec::Vec;

use glam::{DVec3, Vec2, Vec3};
use scene::gpu::{BvhNode, Triangle, TriangleUv};
use scene::parallel::*;
use scene::{Scene, SceneParts};

use super::focus::{Density, corners};

/// Triangles whose planes meet at a greater cosine than this stand on each other nowhere.
const MAX_COSINE: f64 = 0.9;
/// A corner that is no further from a plane than this many ray offsets lies in it.
const IN_PLANE: f64 = 2.0;
/// Most fragments of a triangle, unless the density alone gives more.
const MAX_FRAGMENTS: usize = 256;

/// A scene of the same surfaces in which triangles are cut along the feet of others that stand on them or pass through
/// them, and that meet a fragment over at least `least` m, and where they reach over more than two levels of a density;
/// none where nothing is cut. Texture coordinates are interpolated.
///
/// # Errors
/// What making the scene says.
pub fn cut_at_feet(scene: &Scene, density: &Density, least: f32) -> Result<Option<Scene>, scene::Error> {
    let triangles = &scene.geometry.triangles;
    let cutter =
        Cutter { scene, density, least: f64::from(least), tolerance: IN_PLANE * f64::from(scene.geometry.ray_offset) };
    let fragments: Vec<Option<Vec<Fragment>>> =
        (0..triangles.len()).into_par_iter().map(|t| cutter.fragments(t as u32)).collect();
    if fragments.iter().all(Option::is_none) {
        return Ok(None);
    }
    let mut parts = SceneParts {
        materials: scene.geometry.materials.to_vec(),
        finishes: scene.geometry.finishes.clone(),
        textures: scene.geometry.textures.clone(),
        texels: scene.geometry.texels.to_vec(),
        ray_offset: Some(scene.geometry.ray_offset),
        absorption: scene.geometry.absorption,
        ..SceneParts::default()
    };
    for (t, fragments) in fragments.iter().enumerate() {
        match fragments {
            None => {
                parts.triangles.push(triangles[t]);
                parts.uvs.push(scene.geometry.uvs[t]);
            }
            Some(fragments) => fragments.iter().for_each(|fragment| add_fragment(scene, t, fragment, &mut parts)),
        }
    }
    let mut cut = Scene::new(parts)?;
    cut.materials = scene.materials.clone();
    cut.set_lighting(scene.lighting.clone())?;
    Ok(Some(cut))
}

/// Corners of a convex polygon in the plane of its triangle, in the triangle's order.
type Fragment = Vec<DVec3>;

struct Cutter<'a> {
    scene: &'a Scene,
    density: &'a Density,
    /// Shortest foot that cuts, m.
    least: f64,
    /// Distance up to which a point lies in a plane or on a line, m.
    tolerance: f64,
}

impl Cutter<'_> {
    /// Fragments of a triangle; none where it stays whole.
    fn fragments(&self, triangle: u32) -> Option<Vec<Fragment>> {
        let whole = corners(&self.scene.geometry.triangles[triangle as usize]);
        let mut fragments: Vec<Fragment> = self.density.parts(whole).into_iter().map(Vec::from).collect();
        let normal = (whole[1] - whole[0]).cross(whole[2] - whole[0]).try_normalize()?;
        let mut feet = Vec::new();
        if f64::from(self.scene.longest_edge(triangle)) >= 2.0 * self.least {
            feet = self.feet(triangle, &whole, normal);
        }
        // Long ones first: walls before what stands beside them.
        feet.sort_by(|a, b| (b[1] - b[0]).length().total_cmp(&(a[1] - a[0]).length()));
        let most = MAX_FRAGMENTS.max(fragments.len());
        for foot in &feet {
            let mut next = Vec::with_capacity(fragments.len() + 1);
            let room = most - fragments.len().min(most);
            for fragment in fragments {
                match self.split(&fragment, foot, normal).filter(|_| next.len() < most && room > 0) {
                    Some(halves) => next.extend(halves),
                    None => next.push(fragment),
                }
            }
            fragments = next;
        }
        (fragments.len() > 1).then_some(fragments)
    }

    /// Segments in which other triangles meet the plane of a triangle, near to it.
    fn feet(&self, triangle: u32, whole: &[DVec3; 3], normal: DVec3) -> Vec<[DVec3; 2]> {
        let low = whole[0].min(whole[1]).min(whole[2]) - self.tolerance;
        let high = whole[0].max(whole[1]).max(whole[2]) + self.tolerance;
        let mut feet = Vec::new();
        overlapping(&self.scene.geometry.nodes, low, high, &mut |other| {
            let is_long = f64::from(self.scene.longest_edge(other)) >= self.least;
            if other != triangle && is_long {
                let other = corners(&self.scene.geometry.triangles[other as usize]);
                feet.extend(self.foot(&other, whole[0], normal));
            }
        });
        feet
    }

    /// Line where a triangle meets a plane, if it stands on it or passes through it.
    fn foot(&self, other: &[DVec3; 3], origin: DVec3, normal: DVec3) -> Option<[DVec3; 2]> {
        let own = (other[1] - other[0]).cross(other[2] - other[0]).try_normalize()?;
        if own.dot(normal).abs() > MAX_COSINE {
            return None;
        }
        let height = other.map(|corner| {
            let height = (corner - origin).dot(normal);
            if height.abs() <= self.tolerance { 0.0 } else { height }
        });
        let mut ends: Vec<DVec3> = Vec::with_capacity(4);
        for k in 0..3 {
            let a = height[k];
            let b = height[(k + 1) % 3];
            if a == 0.0 {
                ends.push(other[k] - normal * (other[k] - origin).dot(normal));
            }
            if a * b < 0.0 {
                ends.push(other[k].lerp(other[(k + 1) % 3], a / (a - b)));
            }
        }
        let [first, last] = [*ends.first()?, *ends.last()?];
        ((last - first).length() >= self.least).then_some([first, last])
    }

    /// Both sides of the line of a foot in a fragment; none where the foot meets the fragment over too little, or along
    /// its border.
    fn split(&self, fragment: &Fragment, foot: &[DVec3; 2], normal: DVec3) -> Option<[Fragment; 2]> {
        let along = (foot[1] - foot[0]).normalize();
        let across = normal.cross(along);
        let side: Vec<f64> = fragment
            .iter()
            .map(|corner| {
                let distance = (corner - foot[0]).dot(across);
                if distance.abs() <= self.tolerance { 0.0 } else { distance }
            })
            .collect();
        if !side.iter().any(|s| *s > 0.0) || !side.iter().any(|s| *s < 0.0) {
            return None;
        }
        let [mut left, mut right] = [Vec::new(), Vec::new()];
        let mut border = Vec::new();
        for k in 0..fragment.len() {
            let next = (k + 1) % fragment.len();
            let a = side[k];
            if a >= 0.0 {
                left.push(fragment[k]);
            }
            if a <= 0.0 {
                right.push(fragment[k]);
            }
            if a == 0.0 {
                border.push(fragment[k]);
            }
            if a * side[next] < 0.0 {
                let crossing = fragment[k].lerp(fragment[next], a / (a - side[next]));
                left.push(crossing);
                right.push(crossing);
                border.push(crossing);
            }
        }
        // How much of the foot lies between the ends of the cut.
        let mut from = f64::INFINITY;
        let mut to = f64::NEG_INFINITY;
        for point in &border {
            let place = (point - foot[0]).dot(along);
            (from, to) = (from.min(place), to.max(place));
        }
        let met = to.min((foot[1] - foot[0]).length()) - from.max(0.0);
        (met >= self.least).then_some([left, right])
    }
}

/// The triangles of the leaves whose boxes meet a box.
fn overlapping(nodes: &[BvhNode], low: DVec3, high: DVec3, found: &mut impl FnMut(u32)) {
    let mut stack = vec![0u32];
    while let Some(node) = stack.pop().and_then(|k| nodes.get(k as usize)) {
        if node.min.as_dvec3().cmpgt(high).any() || node.max.as_dvec3().cmplt(low).any() {
            continue;
        }
        if node.prim_count == 0 {
            stack.extend([node.first_index, node.first_index + 1]);
        } else {
            (node.first_index..node.first_index + node.prim_count).for_each(&mut *found);
        }
    }
}

/// Adds a fragment of a triangle as triangles, from the corner that gives the widest ones.
fn add_fragment(scene: &Scene, triangle: usize, fragment: &Fragment, parts: &mut SceneParts) {
    let whole = scene.geometry.triangles[triangle];
    let uv = scene.geometry.uvs[triangle];
    let count = fragment.len();
    let area = |a: DVec3, b: DVec3, c: DVec3| (b - a).cross(c - a).length();
    let fan = |first: usize| (1..count - 1).map(move |k| [first, (first + k) % count, (first + k + 1) % count]);
    let least = |first: usize| {
        fan(first).map(|[a, b, c]| area(fragment[a], fragment[b], fragment[c])).fold(f64::INFINITY, f64::min)
    };
    let best = (0..count).max_by(|a, b| least(*a).total_cmp(&least(*b)).then(b.cmp(a))).unwrap_or(0);
    for [a, b, c] in fan(best) {
        let [a, b, c] = [a, b, c].map(|k| fragment[k].as_vec3());
        let cut = Triangle { corner: a, edge_a: b - a, edge_b: c - a, ..whole };
        if cut.edge_a.cross(cut.edge_b).length() <= 0.0 {
            continue;
        }
        let place = |p: Vec3| -> Vec2 {
            let (u, v) = scene.geometry.shares(triangle as u32, p);
            uv.corner + (uv.corner_a - uv.corner) * u + (uv.corner_b - uv.corner) * v
        };
        let own = TriangleUv { corner: place(a), corner_a: place(b), corner_b: place(c), ..TriangleUv::default() };
        let normals = uv.normals().map(|[first, second, third]| {
            [a, b, c].map(|p| {
                let (u, v) = scene.geometry.shares(triangle as u32, p);
                first * (1.0 - u - v) + second * u + third * v
            })
        });
        parts.uvs.push(own.with_normals(&cut, normals.unwrap_or_default()));
        parts.triangles.push(cut);
    }
}
