//! Illumination maps: regular grids on both sides of all triangles.

use alloc::vec::Vec;

use glam::{Vec2, Vec3};
use hashbrown::HashMap;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::sampling::{hash3, unit};
use scene::{NONE, Scene};

use super::tracer::PhotonAccumulator;
use crate::error::{Error, check_length, check_setting};
use crate::kernel::map::{cell_at, cell_corners};
use crate::types::MapGrid;

/// Most divisions along an edge of a triangle.
const MAX_DIVISIONS: f32 = 1024.0;
/// Most cells.
const MAX_CELLS: u64 = 1 << 26;
/// Parts along the edges of a cell in each of which a hole is looked for.
const HOLE_PARTS: u32 = 20;
/// Normals of sides that share the light of a vertex differ by less than this, squared.
const LIKE_NORMALS: f32 = 0.05;

/// Both sides of every triangle cut into `n²` like cells.
#[derive(Clone, Debug, Default)]
pub struct IlluminationMaps {
    /// Cells of each triangle.
    pub grids: Vec<MapGrid>,
    areas: Vec<f32>,
}

impl IlluminationMaps {
    /// Cells with edges of at most `edge` m.
    ///
    /// # Errors
    /// [`Error::Setting`] for an edge that is not positive, [`Error::TooMany`] beyond 2²⁶ cells.
    pub fn new(scene: &Scene, edge: f32) -> Result<Self, Error> {
        check_setting("edge", f64::from(edge), "positive", edge > 0.0)?;
        let divisions = |t: u32| (scene.longest_edge(t) / edge).ceil().clamp(1.0, MAX_DIVISIONS) as u32;
        Self::with_divisions(scene, &(0..scene.geometry.triangles.len() as u32).map(divisions).collect::<Vec<u32>>())
    }

    /// Grids with so many divisions along the edges of each triangle. The area of a cell is without its holes.
    ///
    /// # Errors
    /// [`Error::Length`] unless there is a number for each triangle, [`Error::TooMany`] beyond 2²⁶ cells.
    pub fn with_divisions(scene: &Scene, divisions: &[u32]) -> Result<Self, Error> {
        check_length("divisions", scene.geometry.triangles.len(), divisions.len())?;
        let total: u64 = divisions.iter().map(|&n| 2 * u64::from(n) * u64::from(n)).sum();
        if total > MAX_CELLS {
            return Err(Error::TooMany { name: "cells of illumination maps", found: total, limit: MAX_CELLS });
        }
        let mut grids = Vec::with_capacity(divisions.len());
        let mut areas = Vec::with_capacity(total as usize);
        for (t, &n) in scene.geometry.triangles.iter().zip(divisions) {
            let n = n.max(1);
            grids.push(MapGrid { first: areas.len() as u32, divisions: n });
            let area = 0.5 * t.edge_a.cross(t.edge_b).length() / (n * n) as f32;
            areas.resize(areas.len() + 2 * (n * n) as usize, area);
        }
        let mut maps = Self { grids, areas };
        maps.leave_holes_out(scene);
        Ok(maps)
    }

    fn leave_holes_out(&mut self, scene: &Scene) {
        let geometry = scene.tables();
        for (t, triangle) in (0u32..).zip(&scene.geometry.triangles) {
            if scene.materials[triangle.material as usize].mask_texture == NONE {
                continue;
            }
            let shares: Vec<f32> = self
                .cells(t, false)
                .map(|(cell, [a, b, c])| {
                    let is_solid = |k: &u32| {
                        // One place in each of like parts, anywhere in it: holes are often as regular as parts are.
                        let column = k % HOLE_PARTS;
                        let row = k / HOLE_PARTS;
                        let x = unit(hash3(cell, 2 * k, 0));
                        let y = unit(hash3(cell, 2 * k + 1, 0));
                        let x = (column as f32 + x) / HOLE_PARTS as f32;
                        let y = (row as f32 + y) / HOLE_PARTS as f32;
                        let (u, v) = if x + y > 1.0 { (1.0 - x, 1.0 - y) } else { (x, y) };
                        let at = a + (b - a) * u + (c - a) * v;
                        !geometry.is_hole(t, at.x, at.y)
                    };
                    let places = HOLE_PARTS * HOLE_PARTS;
                    (0..places).filter(is_solid).count() as f32 / places as f32
                })
                .collect();
            let first = self.grids[t as usize].first as usize;
            for (area, share) in self.areas[first..].iter_mut().zip(shares.iter().chain(&shares)) {
                *area *= share;
            }
        }
    }

    /// Cells of all triangles.
    pub fn len(&self) -> usize {
        self.areas.len()
    }

    /// Returns true if there are none.
    pub fn is_empty(&self) -> bool {
        self.areas.is_empty()
    }

    /// Irradiance at the corners of the triangles, front then back: the area-weighted mean of the cells that touch the
    /// corner on this and on like sides of other triangles, `irradiance` holding one value a cell. A constant stays.
    ///
    /// # Errors
    /// [`Error::Length`].
    pub fn corner_irradiance(&self, scene: &Scene, irradiance: &[Vec3]) -> Result<Vec<[[Vec3; 3]; 2]>, Error> {
        check_length("irradiance", self.len(), irradiance.len())?;
        check_length("triangles", self.grids.len(), scene.geometry.triangles.len())?;
        let geometry = scene.tables();
        // Sides by the exact position of their corners: normal, sum of light and area, for each kind of normal.
        let mut vertices: HashMap<[u32; 3], Vec<(Vec3, Vec3, f32)>> = HashMap::new();
        let corners = [Vec2::ZERO, Vec2::X, Vec2::Y];
        let key = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
        let sides = |t: u32| {
            let front = geometry.normal(t);
            [(front, false), (-front, true)].map(|(n, back)| (if n.is_finite() { n } else { Vec3::ZERO }, back))
        };
        for (t, grid) in (0..).zip(&self.grids) {
            for (normal, is_back) in sides(t) {
                for at in corners {
                    let cell = cell_at(*grid, at.x, at.y, is_back) as usize;
                    let light = irradiance[cell] * self.areas[cell];
                    let area = self.areas[cell];
                    let known = vertices.entry(key(geometry.position(t, at.x, at.y))).or_default();
                    match known.iter_mut().find(|k| k.0.distance_squared(normal) < LIKE_NORMALS) {
                        Some((_, sum, weight)) => {
                            *sum += light;
                            *weight += area;
                        }
                        None => known.push((normal, light, area)),
                    }
                }
            }
        }
        let corner = |t: u32, normal: Vec3, at: Vec2| {
            let known = vertices.get(&key(geometry.position(t, at.x, at.y)));
            let like = known.and_then(|k| k.iter().find(|k| k.0.distance_squared(normal) < LIKE_NORMALS));
            like.filter(|k| k.2 > 0.0).map_or(Vec3::ZERO, |(_, sum, weight)| *sum / *weight)
        };
        Ok((0..self.grids.len() as u32)
            .map(|t| sides(t).map(|(normal, _)| corners.map(|at| corner(t, normal, at))))
            .collect())
    }

    /// The cells of a triangle's side: number, and corners (u, v).
    pub fn cells(&self, triangle: u32, is_back: bool) -> impl Iterator<Item = (u32, [Vec2; 3])> + '_ {
        let grid = self.grids[triangle as usize];
        let n = grid.divisions;
        let first = grid.first + if is_back { n * n } else { 0 };
        let row = move |j: u32| (0..2 * (n - j) - 1).map(move |k| (k / 2, j, k % 2 == 1));
        (0..n).flat_map(row).zip(first..).map(move |((i, j, is_tip), cell)| {
            let (a, b, c) = cell_corners(n, i, j, is_tip);
            (cell, [a, b, c])
        })
    }
}

impl PhotonAccumulator for IlluminationMaps {
    fn areas(&self) -> &[f32] {
        &self.areas
    }

    fn cell(&self, triangle: u32, u: f32, v: f32, is_back: bool) -> u32 {
        cell_at(self.grids[triangle as usize], u, v, is_back)
    }
}
