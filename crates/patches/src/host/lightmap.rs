//! The lightmap: receivers at the texels of an atlas of the scene's triangles.

mod charts;

use alloc::vec::Vec;

use glam::{UVec2, Vec2, Vec3, Vec4};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::gpu::TriangleUv;
use scene::parallel::*;
use scene::{GeometryTables, Hit, NONE, ReceiverSet, Scene, Sides, SurfacePoint};

use self::charts::{Chart, ChartTriangle, charts, given_chart, overlapping};
use crate::error::Error;
use crate::kernel::lightmap::lightmap_lookup;
use crate::types::LightmapParams;

/// Texels of an atlas each way.
pub const LIGHTMAP_LIMIT: u32 = 8192;

/// A texel is covered when its middle is so near to the triangle, in texels: then every point of the triangle lies in
/// covered texels.
const REACH: f32 = core::f32::consts::FRAC_1_SQRT_2;
/// Distance of taps from their receiver and from the edges of its triangle, in texels.
const TAP: f32 = 0.25;
/// Receivers stay so far from the edges of their triangle, in texels, where it is wide enough.
const INSET: f32 = 0.02;

/// An atlas of triangle sides, one receiver a covered texel. Neighbours across an edge share a chart where that bends
/// by less than 30° and they fill the chart, or take no more texels than with one for each; charts have a border of a
/// texel and never mix. Receivers stand at the middles of the texels, moved into the triangle where these lie outside.
/// Texels without a receiver take that of the nearest one of their chart, so that values may be interpolated, and
/// filtered by a texture unit, up to the edges.
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
    /// Position of each receiver: its triangle and the shares u, v of the triangle's edges; t is 0.
    pub places: Vec<Hit>,
    points: Vec<SurfacePoint>,
    /// Edge of a texel, m.
    texel: f32,
}

impl LightmapTexels {
    /// Lays out the sides in `sides` with square texels of `texel` m. Receivers that are not `is_lit`, as those under
    /// what stands on a floor, are left out, and their texels take the nearest others; a side without any has no chart.
    /// On all cores, the same bytes for any number of them.
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
        let mut set = Self::empty(scene, params, texel);
        for (((chart, filled), place), size) in charts.iter().zip(filled).zip(places).zip(sizes) {
            if let Some(filled) = filled {
                set.add(chart, filled, place, size);
            }
        }
        Ok(set)
    }

    /// Receivers of an existing atlas: `uvs` has the place of each triangle in [0, 1]² from the upper left, as glTF's
    /// `TEXCOORD_1`, and none for those without. Square, of so many texels that one has `texel` m on the mean. A
    /// triangle whose two sides are lit takes part with its front. Otherwise as [`Self::new`].
    ///
    /// # Errors
    /// As [`Self::new`]; [`Error::AtlasOverlap`] where two triangles lie on each other.
    pub fn with_uvs(
        scene: &Scene,
        sides: &[Sides],
        uvs: &[Option<TriangleUv>],
        texel: f32,
        is_lit: &(impl Fn(&SurfacePoint) -> bool + Sync),
    ) -> Result<Self, Error> {
        for (name, found) in [("sides", sides.len()), ("texture coordinates", uvs.len())] {
            if found != scene.geometry.triangles.len() {
                return Err(Error::Length { name, expected: scene.geometry.triangles.len(), found });
            }
        }
        if !(texel.is_finite() && texel > 0.0) {
            return Err(Error::Setting { name: "texel", value: f64::from(texel), rule: "positive and finite" });
        }
        let mut surface = 0.0f64;
        let mut atlas = 0.0f64;
        for (t, uv) in scene.geometry.triangles.iter().zip(uvs) {
            let Some(uv) = uv else { continue };
            surface += f64::from(t.edge_a.cross(t.edge_b).length());
            atlas += f64::from((uv.corner_a - uv.corner).perp_dot(uv.corner_b - uv.corner).abs());
        }
        let width = if atlas > 0.0 { (surface / atlas).sqrt() / f64::from(texel) } else { 1.0 };
        check_limit("texels of a lightmap each way", width as f32)?;
        let width = (width.round() as u32).max(1);
        let chart = given_chart(sides, uvs, width, texel);
        if let Some(triangles) = overlapping(&chart, texel) {
            return Err(Error::AtlasOverlap { triangles });
        }
        let mut set = Self::empty(scene, LightmapParams { width, height: width }, texel);
        if let Some(filled) = chart.fill(&scene.tables(), texel, is_lit) {
            set.add(&chart, filled, [0; 2], [width; 2]);
        }
        Ok(set)
    }

    fn empty(scene: &Scene, params: LightmapParams, texel: f32) -> Self {
        Self {
            params,
            sides: alloc::vec![[NONE; 2]; scene.geometry.triangles.len()],
            uvs: Vec::new(),
            texels: alloc::vec![NONE; params.width as usize * params.height as usize],
            places: Vec::new(),
            points: Vec::new(),
            texel,
        }
    }

    /// Puts a chart where its least corner has this place in the atlas.
    fn add(&mut self, chart: &Chart, filled: Filled, place: [u32; 2], size: [u32; 2]) {
        let first = self.points.len() as u32;
        for (k, receiver) in filled.texels.into_iter().enumerate() {
            let at = place[0] + k as u32 % size[0] + self.params.width * (place[1] + k as u32 / size[0]);
            self.texels[at as usize] = first + receiver;
        }
        self.places.extend(filled.places);
        self.points.extend(filled.points.into_iter().zip(first..).map(|(p, patch)| SurfacePoint { patch, ..p }));
        let atlas = Vec2::new(self.params.width as f32, self.params.height as f32);
        for part in &chart.triangles {
            let [a, b, c] =
                part.corners.map(|c| (Vec2::new(place[0] as f32, place[1] as f32) + 1.0 + c / self.texel) / atlas);
            self.sides[part.triangle as usize][usize::from(!part.front)] = self.uvs.len() as u32;
            self.uvs.push(TriangleUv { corner: a, corner_a: b, corner_b: c, ..TriangleUv::default() });
        }
    }

    /// Texture coordinates of the corners of a triangle's front or back, if it has a chart.
    pub fn uv(&self, triangle: u32, front: bool) -> Option<TriangleUv> {
        let place = self.sides.get(triangle as usize)?[usize::from(!front)];
        self.uvs.get(place as usize).copied()
    }

    /// Four places about a receiver, a quarter of a texel from it each way and from the edges of its triangle where
    /// that is so wide: light that changes within a texel, as at the edge of a shadow, is better told by their mean.
    /// `None` beyond the receivers.
    pub fn taps(&self, scene: &Scene, receiver: usize) -> Option<[SurfacePoint; 4]> {
        let place = self.places.get(receiver)?;
        let point = self.points.get(receiver)?;
        let triangle = scene.geometry.triangles.get(place.triangle as usize)?;
        let along = triangle.edge_a.normalize_or_zero();
        let across = scene.tables().normal(place.triangle).cross(along);
        let flat = |p: Vec3| Vec2::new(p.dot(along), p.dot(across));
        let corners = [Vec2::ZERO, flat(triangle.edge_a), flat(triangle.edge_b)];
        let middle = corners[1] * place.u + corners[2] * place.v;
        Some([(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(|(x, y)| {
            let tap = middle + Vec2::new(x, y) * TAP * self.texel;
            let moved = nearest_place(corners, tap, TAP * self.texel);
            // On needles the edges push it far away.
            let tap = if moved.distance(middle) < self.texel { moved } else { middle };
            SurfacePoint { position: triangle.corner + along * tap.x + across * tap.y, ..*point }
        }))
    }

    /// Irradiance on a side of a triangle at the shares u, v of its edges, W/m²: [`lightmap_lookup`] there, zero
    /// without a chart. `values` holds one entry a receiver.
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

/// Receivers of a chart.
struct Filled {
    points: Vec<SurfacePoint>,
    places: Vec<Hit>,
    /// The receiver of each texel of the rectangle.
    texels: Vec<u32>,
}

impl Chart {
    /// The receivers at the covered texels, and the nearest one for each of the others; `None` if none is lit.
    fn fill(
        &self,
        geometry: &GeometryTables,
        texel: f32,
        is_lit: &(impl Fn(&SurfacePoint) -> bool + Sync),
    ) -> Option<Filled> {
        let width = self.size.x as u32;
        let height = self.size.y as u32;
        let covered = self.cover(width, height, texel);
        let mut texels = alloc::vec![NONE; covered.len()];
        let mut points = Vec::new();
        let mut places = Vec::new();
        for (entry, covered) in texels.iter_mut().zip(covered) {
            let Some((_, place, part)) = covered else { continue };
            // On the triangle itself: the chart is flat, and it need not be.
            let [a, b, c] = part.corners;
            let double = (b - a).perp_dot(c - a);
            let u = (place - a).perp_dot(c - a) / double;
            let v = (b - a).perp_dot(place - a) / double;
            let position = geometry.position(part.triangle, u, v);
            let normal = geometry.normal(part.triangle);
            let normal = if part.front { normal } else { -normal };
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

    /// For each texel that a triangle covers, the nearest place of the nearest triangle, and the square of its
    /// distance.
    fn cover(&self, width: u32, height: u32, texel: f32) -> Vec<Option<(f32, Vec2, &ChartTriangle)>> {
        let mut nearest = alloc::vec![None; (width * height) as usize];
        for part in &self.triangles {
            let [a, b, c] = part.corners;
            let first = (a.min(b).min(c) / texel - REACH).floor().max(Vec2::ZERO).as_uvec2();
            let last = (a.max(b).max(c) / texel + 1.0 + REACH).ceil().as_uvec2().min(UVec2::new(width, height) - 1);
            for y in first.y..=last.y {
                for x in first.x..=last.x {
                    let middle = (Vec2::new(x as f32, y as f32) - 0.5) * texel;
                    let place = nearest_place(part.corners, middle, INSET * texel);
                    let distance = place.distance_squared(middle);
                    let entry: &mut Option<(f32, Vec2, &ChartTriangle)> = &mut nearest[(x + width * y) as usize];
                    let is_near = distance <= ((REACH + INSET) * texel).powi(2);
                    if is_near && entry.is_none_or(|(least, ..)| distance < least) {
                        *entry = Some((distance, place, part));
                    }
                }
            }
        }
        nearest
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
        let p = corners[k];
        let q = corners[(k + 1) % 3];
        (q - p).perp_dot(place - p) * orientation >= 0.0
    });
    if is_inside {
        return place;
    }
    let on_edge = (0..3).map(|k| {
        let p = corners[k];
        let q = corners[(k + 1) % 3];
        let way = q - p;
        let squared = way.length_squared();
        p + way * if squared > 0.0 { ((place - p).dot(way) / squared).clamp(0.0, 1.0) } else { 0.0 }
    });
    on_edge.min_by(|a, b| a.distance_squared(place).total_cmp(&b.distance_squared(place))).unwrap_or(middle)
}

/// Gives texels without a receiver that of the nearest one, counted in steps to the eight neighbours; of several the
/// first.
fn dilate(texels: &mut [u32], width: u32, height: u32) {
    let mut front: Vec<u32> = (0..width * height).filter(|&k| texels[k as usize] != NONE).collect();
    while !front.is_empty() {
        let mut next = Vec::new();
        for &k in &front {
            let x = k % width;
            let y = k / width;
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
        let mut places = alloc::vec![[0; 2]; sizes.len()];
        let mut x = 0;
        let mut y = 0u64;
        let mut shelf = 0;
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
