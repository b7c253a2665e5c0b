//! Receivers: points at which irradiance is evaluated, and the grids of triangle vertices that take their values.

use std::collections::HashMap;
use std::vec::Vec;

use glam::{IVec3, Vec3, Vec4};
use rayon::prelude::*;
use scene::sampling::hash3;
use scene::{NONE, ReceiverSet, Scene, Sides, SurfacePoint, Visibility, is_open};

use super::storage::check_length;
use super::subdivide::{MOST_DIVISIONS, check_positive, number_entries, side_point, triangle_area, vertex_point};
use crate::error::Error;
use crate::kernel::grid::{cell_corners, cell_count, vertex_at, vertex_count};
use crate::types::TriangleGrid;

/// Grid vertices nearer than this share of the longest edge share a receiver, where the surface is near enough to flat.
const WELD: f32 = 0.4;
/// Least cosine between their normals.
const LEAST_COSINE: f32 = 0.94;
/// Most distance of a vertex from the plane of its receiver, as a share of the welding distance.
const MOST_OFFSET: f32 = 0.1;

/// Cells of a side that are tried when none of its vertices serves.
const MIDDLES: u32 = 8;

/// Points at which irradiance is wanted: the vertices of a grid on each triangle, those that lie together merged.
#[derive(Clone, Debug, Default)]
pub struct Receivers {
    /// Per triangle of the scene, where its vertices stand in `vertices`; see [`crate::kernel::grid::interpolate`].
    pub grids: Vec<TriangleGrid>,
    /// Per grid vertex, its receiver.
    pub vertices: Vec<u32>,
    /// The receivers, a little inside of a triangle, with the normal of its side; `patch` is their own number.
    pub points: Vec<SurfacePoint>,
    /// Receiver i owns the point i: `0..=n`.
    pub offsets: Vec<u32>,
}

impl Receivers {
    /// Grid vertices on each side in `sides`, edges at most `edge` m long. Vertices closer than 0.4 edges on nearly the same
    /// plane and side are one receiver, so that finely tessellated meshes need no more receivers than coarse ones.
    ///
    /// # Errors
    /// [`Error::Setting`] for an edge that is not positive, [`Error::Length`], [`Error::TooMany`].
    pub fn new(scene: &Scene, sides: &[Sides], edge: f32) -> Result<Self, Error> {
        check_length("sides", scene.triangles.len(), sides.len())?;
        check_positive("edge", edge)?;
        let divisions: Vec<u32> = scene
            .triangles
            .iter()
            .map(|t| {
                let longest = t.edge_a.length().max(t.edge_b.length()).max((t.edge_b - t.edge_a).length());
                (longest / edge * (1.0 - 1e-6)).ceil().clamp(1.0, MOST_DIVISIONS as f32) as u32
            })
            .collect();
        let grids = number_entries(sides, &divisions, vertex_count)?;
        let total: u32 = grids.iter().map(|g| sides_of(g).count() as u32 * vertex_count(g.divisions)).sum();
        let mut welder = Welder { distance: WELD * edge, cells: HashMap::new(), points: Vec::new() };
        let mut vertices = vec![NONE; total as usize];
        // The largest triangles first: theirs are the safest places.
        let mut order: Vec<(f32, usize)> = (0..grids.len()).map(|t| (triangle_area(scene, t), t)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        for (_, triangle) in order {
            let grid = grids[triangle];
            let n = grid.divisions;
            for (front, first) in sides_of(&grid) {
                for j in 0..=n {
                    for i in 0..=n - j {
                        let point =
                            in_sight(scene, triangle as u32, n, vertex_point(scene, triangle as u32, front, n, i, j));
                        vertices[(first + vertex_at(n, i, j)) as usize] = welder.receiver(scene, point);
                    }
                }
            }
        }
        let offsets = (0..=welder.points.len() as u32).collect();
        Ok(Self { grids, vertices, points: welder.points, offsets })
    }

    /// Leaves out receivers that are not good: their grid vertices take the nearest good one on their side of the triangle. A
    /// side without a good vertex takes the middle of one of its cells; if none is good, it has no receivers.
    pub fn retain(&mut self, scene: &Scene, is_good: impl Fn(&SurfacePoint) -> bool + Sync) {
        let mut flags: Vec<bool> = self.points.par_iter().map(&is_good).collect();
        let good = |flags: &[bool], receiver: u32| flags[receiver as usize];
        for (triangle, grid) in self.grids.iter_mut().enumerate() {
            for (front, first) in sides_of(grid) {
                let own = first as usize..(first + vertex_count(grid.divisions)) as usize;
                if own.clone().all(|k| good(&flags, self.vertices[k])) {
                    continue;
                }
                let mut kept: Vec<(Vec3, u32)> = Vec::new();
                let mut bad: Vec<(Vec3, usize)> = Vec::new();
                for j in 0..=grid.divisions {
                    for i in 0..=grid.divisions - j {
                        let at = own.start + vertex_at(grid.divisions, i, j) as usize;
                        let place = vertex_point(scene, triangle as u32, front, grid.divisions, i, j).position;
                        if good(&flags, self.vertices[at]) {
                            kept.push((place, self.vertices[at]));
                        } else {
                            bad.push((place, at));
                        }
                    }
                }
                if kept.is_empty() {
                    let cells = cell_count(grid.divisions);
                    let middles = (0..cells.min(MIDDLES)).map(|k| {
                        let (a, b, c) = cell_corners(grid.divisions, k * cells / cells.min(MIDDLES));
                        side_point(scene, triangle as u32, front, (a + b + c) / 3.0)
                    });
                    if let Some(point) = middles.into_iter().find(&is_good) {
                        let number = self.points.len() as u32;
                        self.points.push(SurfacePoint { patch: number, ..point });
                        flags.push(true);
                        bad.iter().for_each(|&(_, at)| self.vertices[at] = number);
                        continue;
                    }
                    *(if front { &mut grid.front } else { &mut grid.back }) = NONE;
                    bad.iter().for_each(|&(_, at)| self.vertices[at] = NONE);
                    continue;
                }
                for (place, at) in bad {
                    let distance = |k: &&(Vec3, u32)| k.0.distance_squared(place);
                    if let Some(nearest) = kept.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))) {
                        self.vertices[at] = nearest.1;
                    }
                }
            }
        }
        let mut used = vec![false; self.points.len()];
        self.vertices.iter().filter(|&&r| r != NONE).for_each(|&r| used[r as usize] = true);
        let mut numbers = vec![NONE; self.points.len()];
        let kept = numbers.iter_mut().zip(&used).filter(|(_, used)| **used);
        kept.zip(0..).for_each(|((number, _), next)| *number = next);
        self.points.retain(|point| used[point.patch as usize]);
        (self.points.iter_mut().zip(0..)).for_each(|(point, number)| point.patch = number);
        // A vertex without receiver is never asked for.
        self.vertices.iter_mut().for_each(|r| *r = if *r == NONE { 0 } else { numbers[*r as usize] });
        self.offsets = (0..=self.points.len() as u32).collect();
    }
}

impl ReceiverSet for Receivers {
    fn points(&self) -> &[SurfacePoint] {
        &self.points
    }
}

impl Receivers {
    /// Irradiance at the mesh's own vertices, W/m²: at the corner, the end of `edge_a` and the end of `edge_b` of every
    /// triangle, on its front or its back; zero where that side has no receivers. Corners of different triangles that
    /// share a receiver have the same value, so that a vertex of a smooth mesh may take that of any of its triangles.
    /// `values` holds one entry a receiver.
    ///
    /// # Errors
    /// [`Error::Length`] for a wrong number of values.
    pub fn corner_irradiance(&self, values: &[Vec4], front: bool) -> Result<Vec<[Vec4; 3]>, Error> {
        check_length("values", self.points.len(), values.len())?;
        let corners = |grid: &TriangleGrid| {
            let first = if front { grid.front } else { grid.back };
            let value = |i: u32, j: u32| {
                if first == NONE {
                    return Vec4::ZERO;
                }
                values[self.vertices[(first + vertex_at(grid.divisions, i, j)) as usize] as usize]
            };
            [value(0, 0), value(grid.divisions, 0), value(0, grid.divisions)]
        };
        Ok(self.grids.iter().map(corners).collect())
    }
}

/// Moves a grid vertex that lies behind a wall through which its triangle passes to this side of the wall: to where the
/// ray from the middle of its cell comes.
fn in_sight(scene: &Scene, triangle: u32, divisions: u32, vertex: SurfacePoint) -> SurfacePoint {
    let third = 1.0 / 3.0;
    let centre = scene.geometry().position(triangle, third, third);
    let lift = vertex.normal * scene.ray_offset;
    let middle = vertex.position + (centre - vertex.position) / divisions as f32;
    let way = vertex.position - middle;
    let length = way.length();
    if length <= 0.0 {
        return vertex;
    }
    let direction = way / length;
    let hit = scene.closest_before(middle + lift, direction, length);
    // A middle that is buried in what stands on the surface judges nobody.
    let seed = hash3(triangle, vertex.position.x.to_bits(), vertex.position.z.to_bits());
    if hit.is_miss() || !is_open(scene, &SurfacePoint { position: middle, ..vertex }, seed) {
        return vertex;
    }
    SurfacePoint { position: middle + direction * (0.8 * hit.t), ..vertex }
}

/// Sides of a triangle that have entries: whether it is the front, and the first entry.
fn sides_of(grid: &TriangleGrid) -> impl Iterator<Item = (bool, u32)> + use<> {
    [(true, grid.front), (false, grid.back)].into_iter().filter(|&(_, first)| first != NONE)
}

/// Receivers by the cell of space that they are in.
struct Welder {
    distance: f32,
    cells: HashMap<IVec3, Vec<u32>>,
    points: Vec<SurfacePoint>,
}

impl Welder {
    /// The receiver of a vertex: one that is there with nothing between, or a new one.
    fn receiver(&mut self, scene: &Scene, point: SurfacePoint) -> u32 {
        let place = point.position;
        let home = (place / self.distance).floor().as_ivec3();
        let mut best = (self.distance * self.distance, NONE);
        for k in 0..27 {
            let cell = home + IVec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
            for &id in self.cells.get(&cell).map_or(&[][..], Vec::as_slice) {
                let there = &self.points[id as usize];
                let offset = (place - there.position).dot(there.normal).abs();
                let squared = place.distance_squared(there.position);
                if point.normal.dot(there.normal) >= LEAST_COSINE
                    && offset <= MOST_OFFSET * self.distance
                    && squared < best.0
                {
                    best = (squared, id);
                }
            }
        }
        if best.1 != NONE {
            let there = &self.points[best.1 as usize];
            // High enough to pass over the curvature that welding allows.
            let lift = (point.normal + there.normal) * (scene.ray_offset + MOST_OFFSET * self.distance);
            if scene.any_hit(place + lift, there.position + lift) {
                best.1 = NONE;
            }
        }
        if best.1 == NONE {
            best.1 = self.points.len() as u32;
            self.points.push(SurfacePoint { patch: best.1, ..point });
            self.cells.entry(home).or_default().push(best.1);
        }
        best.1
    }
}
