//! The lightmap: receivers at the texels of an atlas of the scene's triangles.

use std::vec::Vec;

use glam::{IVec3, Vec2, Vec3, Vec4};
use rayon::prelude::*;
use scene::{GeometryTables, Hit, NONE, ReceiverSet, Scene, Sides, SurfacePoint, TriangleUv};

use crate::error::Error;
use crate::kernel::lightmap::lightmap_lookup;
use crate::types::LightmapParams;

/// Texels of an atlas each way.
pub const LIGHTMAP_LIMIT: u32 = 8192;

/// A texel is covered when its middle is so near to the triangle, in texels: then every point of the triangle lies in
/// covered texels.
const REACH: f32 = core::f32::consts::FRAC_1_SQRT_2;
/// Receivers stay so far from the edges of their triangle, in texels, where it is wide enough.
const INSET: f32 = 0.02;
/// Corners nearer than this share of the scene's diagonal are one.
const SAME_CORNER: f32 = 1e-5;
/// Least cosine between the normals of triangles that share a chart.
const SAME_PLANE: f32 = 1.0 - 1e-6;

/// An atlas of triangle sides, one receiver a covered texel. Each side has a chart of its own, or shares it with a
/// triangle across an edge in the same plane; charts have a border of a texel and never mix. Receivers stand at the middles
/// of the texels, moved into the triangle where these lie outside. Texels without a receiver take that of the nearest one
/// of their chart, so that values may be interpolated, and filtered by a texture unit, up to the edges.
#[derive(Clone, Debug, PartialEq)]
pub struct LightmapTexels {
    /// Size of the atlas.
    pub params: LightmapParams,
    /// Per triangle of the scene, where the texture coordinates of its front and back stand in `uvs`, or [`NONE`].
    pub sides: Vec<[u32; 2]>,
    /// Texture coordinates in [0, 1]² of the corners of each side.
    pub uvs: Vec<TriangleUv>,
    /// The receiver of each texel, row by row, or [`NONE`].
    pub texels: Vec<u32>,
    /// Where each receiver stands: its triangle and the shares u, v of the triangle's edges; t is 0.
    pub places: Vec<Hit>,
    points: Vec<SurfacePoint>,
}

impl LightmapTexels {
    /// Lays out the sides in `sides` with square texels of `texel` m. Receivers that are not `is_lit`, as those under what
    /// stands on a floor, are left out, and their texels take the nearest others; a side without any has no chart. On all
    /// cores, the same bytes for any number of them.
    ///
    /// # Errors
    /// [`Error::Setting`] for a texel that is not positive, [`Error::Length`] unless there is an entry of `sides` a
    /// triangle, [`Error::TooMany`] if the atlas exceeds [`LIGHTMAP_LIMIT`].
    pub fn new(
        scene: &Scene,
        sides: &[Sides],
        texel: f32,
        is_lit: &(impl Fn(&SurfacePoint) -> bool + Sync),
    ) -> Result<Self, Error> {
        if sides.len() != scene.geometry.triangles.len() {
            return Err(Error::Length { name: "sides", expected: scene.geometry.triangles.len(), found: sides.len() });
        }
        if !(texel.is_finite() && texel > 0.0) {
            return Err(Error::Setting { name: "texel", value: f64::from(texel), rule: "positive and finite" });
        }
        let charts = charts(scene, sides, texel);
        // Before anything of that size is filled.
        for chart in &charts {
            check_limit("texels across a chart", chart.size.max_element())?;
        }
        let area: f64 = charts.iter().map(|c| c.size.as_dvec2().element_product()).sum();
        let limit = u64::from(LIGHTMAP_LIMIT).pow(2);
        if area > limit as f64 {
            return Err(Error::TooMany { name: "texels of a lightmap", found: area as u64, limit });
        }
        let geometry = scene.tables();
        let filled: Vec<Option<Filled>> = charts.par_iter().map(|chart| chart.fill(&geometry, texel, is_lit)).collect();
        let sizes: Vec<[u32; 2]> = charts
            .iter()
            .zip(&filled)
            .map(|(chart, filled)| if filled.is_some() { [chart.size.x as u32, chart.size.y as u32] } else { [0; 2] })
            .collect();
        let (params, places) = pack(&sizes)?;
        let mut set = Self {
            params,
            sides: std::vec![[NONE; 2]; scene.geometry.triangles.len()],
            uvs: Vec::new(),
            texels: std::vec![NONE; params.width as usize * params.height as usize],
            places: Vec::new(),
            points: Vec::new(),
        };
        for (((chart, filled), place), size) in charts.iter().zip(filled).zip(places).zip(sizes) {
            let Some(filled) = filled else { continue };
            let first = set.points.len() as u32;
            for (k, receiver) in filled.texels.into_iter().enumerate() {
                let at = place[0] + k as u32 % size[0] + params.width * (place[1] + k as u32 / size[0]);
                set.texels[at as usize] = first + receiver;
            }
            set.places.extend(filled.places);
            set.points.extend(filled.points.into_iter().zip(first..).map(|(p, patch)| SurfacePoint { patch, ..p }));
            for part in &chart.triangles {
                let corner = |c: Vec2| {
                    let at = Vec2::new(place[0] as f32, place[1] as f32) + 1.0 + c / texel;
                    at / Vec2::new(params.width as f32, params.height as f32)
                };
                let [a, b, c] = part.corners.map(corner);
                set.sides[part.triangle as usize][usize::from(!chart.front)] = set.uvs.len() as u32;
                set.uvs.push(TriangleUv { corner: a, corner_a: b, corner_b: c });
            }
        }
        Ok(set)
    }

    /// Texture coordinates of the corners of a triangle's front or back, if it has a chart.
    pub fn uv(&self, triangle: u32, front: bool) -> Option<TriangleUv> {
        let place = self.sides.get(triangle as usize)?[usize::from(!front)];
        self.uvs.get(place as usize).copied()
    }

    /// Irradiance on a side of a triangle at the shares u, v of its edges, W/m²: [`lightmap_lookup`] there, zero without a
    /// chart. `values` holds one entry a receiver.
    ///
    /// # Errors
    /// [`Error::Length`] for a wrong number of values.
    pub fn at(&self, values: &[Vec4], triangle: u32, front: bool, u: f32, v: f32) -> Result<Vec4, Error> {
        self.check(values)?;
        let Some(t) = self.uv(triangle, front) else { return Ok(Vec4::ZERO) };
        let uv = t.corner * (1.0 - u - v) + t.corner_a * u + t.corner_b * v;
        Ok(lightmap_lookup(&self.params, &self.texels, values, uv))
    }

    /// The values as a picture, row by row; zero where no chart is.
    ///
    /// # Errors
    /// [`Error::Length`] for a wrong number of values.
    pub fn picture(&self, values: &[Vec4]) -> Result<Vec<Vec4>, Error> {
        self.check(values)?;
        Ok(self.texels.iter().map(|&r| values.get(r as usize).copied().unwrap_or(Vec4::ZERO)).collect())
    }

    fn check(&self, values: &[Vec4]) -> Result<(), Error> {
        if values.len() != self.points.len() {
            return Err(Error::Length { name: "values", expected: self.points.len(), found: values.len() });
        }
        Ok(())
    }
}

impl ReceiverSet for LightmapTexels {
    fn points(&self) -> &[SurfacePoint] {
        &self.points
    }
}

/// A triangle in the plane of its chart.
struct ChartTriangle {
    triangle: u32,
    /// Corners, m, from the chart's least coordinates on.
    corners: [Vec2; 3],
}

/// Triangles that share a rectangle of the atlas.
struct Chart {
    front: bool,
    triangles: Vec<ChartTriangle>,
    /// Texels with the border, as numbers that may exceed every limit.
    size: Vec2,
}

/// Receivers of a chart.
struct Filled {
    points: Vec<SurfacePoint>,
    places: Vec<Hit>,
    /// The receiver of each texel of the rectangle.
    texels: Vec<u32>,
}

/// The charts of all sides, in the order of their first triangles.
fn charts(scene: &Scene, sides: &[Sides], texel: f32) -> Vec<Chart> {
    let others = pair_up(scene, sides);
    let mut charts = Vec::new();
    for (triangle, &side) in sides.iter().enumerate() {
        let other = others[triangle];
        // A pair is made once, from its first triangle; triangles without area never.
        if other.is_some_and(|p| p < triangle) || !has_area(scene, triangle) {
            continue;
        }
        for front in [true, false] {
            if if front { side.front } else { side.back } {
                charts.push(chart(scene, triangle, other, front, texel));
            }
        }
    }
    charts
}

fn corners(scene: &Scene, triangle: usize) -> [Vec3; 3] {
    let t = &scene.geometry.triangles[triangle];
    [t.corner, t.corner + t.edge_a, t.corner + t.edge_b]
}

fn has_area(scene: &Scene, triangle: usize) -> bool {
    let t = &scene.geometry.triangles[triangle];
    t.edge_a.cross(t.edge_b).length() > 0.0 && scene.tables().normal(triangle as u32).is_finite()
}

/// For each triangle, the one with which it shares a chart: across its longest edge that has a neighbour in its plane.
fn pair_up(scene: &Scene, sides: &[Sides]) -> Vec<Option<usize>> {
    let scale = 1.0 / (SAME_CORNER * scene.diagonal().max(f32::MIN_POSITIVE));
    let key = |p: Vec3| ((p - scene.geometry.bounds.0) * scale).round().as_ivec3();
    let less = |a: IVec3, b: IVec3| a.to_array() < b.to_array();
    let mut edges: Vec<([[i32; 3]; 2], usize, f32)> = Vec::new();
    for triangle in 0..sides.len() {
        let c = corners(scene, triangle);
        for k in 0..3 {
            let (p, q) = (c[k], c[(k + 1) % 3]);
            let (a, b) = (key(p), key(q));
            if a != b {
                let ends = if less(a, b) { [a, b] } else { [b, a] };
                edges.push((ends.map(|e| e.to_array()), triangle, p.distance(q)));
            }
        }
    }
    edges.par_sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.cmp(&b.1)));
    let geometry = scene.tables();
    let mut pairs: Vec<(f32, usize, usize)> = (edges.windows(2))
        .filter(|w| w[0].0 == w[1].0)
        .map(|w| (w[0].2, w[0].1, w[1].1))
        .filter(|&(_, a, b)| {
            sides[a] == sides[b]
                && has_area(scene, a)
                && has_area(scene, b)
                && geometry.normal(a as u32).dot(geometry.normal(b as u32)) > SAME_PLANE
        })
        .collect();
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut others = std::vec![None; sides.len()];
    for (_, a, b) in pairs {
        if others[a].is_none() && others[b].is_none() && a != b {
            (others[a], others[b]) = (Some(b), Some(a));
        }
    }
    others
}

fn chart(scene: &Scene, triangle: usize, other: Option<usize>, front: bool, texel: f32) -> Chart {
    let own = corners(scene, triangle);
    let all: Vec<(u32, [Vec3; 3])> =
        [Some(triangle), other].into_iter().flatten().map(|t| (t as u32, corners(scene, t))).collect();
    let normal = scene.tables().normal(triangle as u32);
    // Along each edge of the first triangle: the rectangle with the least area.
    let frames = (0..3).map(|k| {
        let along = (own[(k + 1) % 3] - own[k]).normalize_or_zero();
        let across = normal.cross(along);
        let flat = |p: Vec3| Vec2::new((p - own[0]).dot(along), (p - own[0]).dot(across));
        let places = all.iter().flat_map(|(_, c)| c.map(flat));
        let (low, high) =
            places.fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(low, high): (Vec2, Vec2), p| (low.min(p), high.max(p)));
        (along, across, low, high - low)
    });
    let area = |f: &(Vec3, Vec3, Vec2, Vec2)| f.3.element_product();
    let usable = frames.filter(|f| f.0 != Vec3::ZERO);
    let (along, across, low, extent) =
        usable.min_by(|a, b| area(a).total_cmp(&area(b))).unwrap_or((Vec3::X, Vec3::Y, Vec2::ZERO, Vec2::ZERO));
    let origin = own[0] + along * low.x + across * low.y;
    let flat = |p: Vec3| Vec2::new((p - origin).dot(along), (p - origin).dot(across));
    Chart {
        front,
        triangles: all.iter().map(|&(triangle, c)| ChartTriangle { triangle, corners: c.map(flat) }).collect(),
        size: (extent / texel).ceil() + 2.0,
    }
}

impl Chart {
    /// The receivers at the covered texels, and the nearest one for each of the others; `None` if none is lit.
    fn fill(
        &self,
        geometry: &GeometryTables,
        texel: f32,
        is_lit: &(impl Fn(&SurfacePoint) -> bool + Sync),
    ) -> Option<Filled> {
        let (width, height) = (self.size.x as u32, self.size.y as u32);
        let mut texels = std::vec![NONE; (width * height) as usize];
        let (mut points, mut places) = (Vec::new(), Vec::new());
        for (k, entry) in texels.iter_mut().enumerate() {
            let middle = Vec2::new((k as u32 % width) as f32 - 0.5, (k as u32 / width) as f32 - 0.5) * texel;
            let nearest = (self.triangles.iter())
                .map(|part| (nearest_place(part.corners, middle, INSET * texel), part))
                .min_by(|a, b| a.0.distance_squared(middle).total_cmp(&b.0.distance_squared(middle)));
            let Some((place, part)) = nearest.filter(|n| n.0.distance(middle) <= (REACH + INSET) * texel) else {
                continue;
            };
            // On the triangle itself: the planes of the two may differ by a little.
            let [a, b, c] = part.corners;
            let double = (b - a).perp_dot(c - a);
            let (u, v) = ((place - a).perp_dot(c - a) / double, (b - a).perp_dot(place - a) / double);
            let position = geometry.position(part.triangle, u, v);
            let normal = geometry.normal(part.triangle);
            let normal = if self.front { normal } else { -normal };
            let point = SurfacePoint { position, patch: NONE, normal, weight: 1.0 };
            if is_lit(&point) {
                *entry = points.len() as u32;
                points.push(point);
                places.push(Hit { triangle: part.triangle, u, v, t: 0.0 });
            }
        }
        dilate(&mut texels, width, height);
        (!points.is_empty()).then_some(Filled { points, places, texels })
    }
}

/// The place of a triangle that is nearest to another, at least `inset` from its edges where it is so wide.
fn nearest_place(corners: [Vec2; 3], place: Vec2, inset: f32) -> Vec2 {
    let [a, b, c] = corners;
    // Shrunk towards the middle of its inscribed circle, all edges move alike.
    let lengths = [b.distance(c), c.distance(a), a.distance(b)];
    let perimeter: f32 = lengths.iter().sum();
    let middle = (a * lengths[0] + b * lengths[1] + c * lengths[2]) / perimeter;
    let radius = (b - a).perp_dot(c - a).abs() / perimeter;
    let share = if radius > 0.0 { (inset / radius).min(0.5) } else { 0.5 };
    let corners = corners.map(|p| p.lerp(middle, share));
    let orientation = (corners[1] - corners[0]).perp_dot(corners[2] - corners[0]).signum();
    let is_inside = (0..3).all(|k| {
        let (p, q) = (corners[k], corners[(k + 1) % 3]);
        (q - p).perp_dot(place - p) * orientation >= 0.0
    });
    if is_inside {
        return place;
    }
    let on_edge = (0..3).map(|k| {
        let (p, q) = (corners[k], corners[(k + 1) % 3]);
        let way = q - p;
        let squared = way.length_squared();
        p + way * if squared > 0.0 { ((place - p).dot(way) / squared).clamp(0.0, 1.0) } else { 0.0 }
    });
    on_edge.min_by(|a, b| a.distance_squared(place).total_cmp(&b.distance_squared(place))).unwrap_or(middle)
}

/// Gives texels without a receiver that of the nearest one, counted in steps to the eight neighbours; of several the first.
fn dilate(texels: &mut [u32], width: u32, height: u32) {
    let mut front: Vec<u32> = (0..width * height).filter(|&k| texels[k as usize] != NONE).collect();
    while !front.is_empty() {
        let mut next = Vec::new();
        for &k in &front {
            let (x, y) = (k % width, k / width);
            for row in y.saturating_sub(1)..=(y + 1).min(height - 1) {
                for column in x.saturating_sub(1)..=(x + 1).min(width - 1) {
                    let there = column + width * row;
                    if texels[there as usize] == NONE {
                        texels[there as usize] = texels[k as usize];
                        next.push(there);
                    }
                }
            }
        }
        front = next;
    }
}

fn check_limit(name: &'static str, found: f32) -> Result<(), Error> {
    if found <= LIGHTMAP_LIMIT as f32 {
        return Ok(());
    }
    Err(Error::TooMany { name, found: found as u64, limit: u64::from(LIGHTMAP_LIMIT) })
}

/// Puts rectangles on shelves, the highest first; the size of the atlas and the least corner of each.
fn pack(sizes: &[[u32; 2]]) -> Result<(LightmapParams, Vec<[u32; 2]>), Error> {
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&k| (core::cmp::Reverse(sizes[k][1]), k));
    let area: f64 = sizes.iter().map(|s| f64::from(s[0]) * f64::from(s[1])).sum();
    let widest = sizes.iter().map(|s| s[0]).max().unwrap_or(0).max(1);
    let mut width = widest.max((area.sqrt().min(f64::from(LIGHTMAP_LIMIT))) as u32).min(LIGHTMAP_LIMIT);
    loop {
        let mut places = std::vec![[0; 2]; sizes.len()];
        let (mut x, mut y, mut shelf) = (0, 0u64, 0);
        for &k in &order {
            let [w, h] = sizes[k];
            if x + w > width {
                (x, y, shelf) = (0, y + shelf, 0);
            }
            shelf = shelf.max(u64::from(h));
            places[k] = [x, y.min(u64::from(LIGHTMAP_LIMIT)) as u32];
            x += w;
        }
        let height = (y + shelf).max(1);
        if height <= u64::from(LIGHTMAP_LIMIT) {
            return Ok((LightmapParams { width, height: height as u32 }, places));
        }
        if width == LIGHTMAP_LIMIT {
            return Err(Error::TooMany { name: "rows of a lightmap", found: height, limit: u64::from(LIGHTMAP_LIMIT) });
        }
        width = (width + width / 4 + 1).min(LIGHTMAP_LIMIT);
    }
}
