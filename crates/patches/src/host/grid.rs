//! The voxel grid: which triangles, and how much of each, lie in which voxel.

use alloc::vec::Vec;
use core::sync::atomic::{AtomicU64, Ordering};

use glam::{DVec3, UVec3, Vec3};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::Scene;
use scene::double::ln;
use scene::host::clip::{Layers, Polygon, cut_to_cell, cut_triangle};
use scene::parallel::*;

use crate::error::Error;
use crate::types::GridShape;

/// Voxels that a grid may have, empty ones included: the lookup keeps a word for each.
pub const VOXEL_LIMIT: u64 = 1 << 26;
/// Clipped triangles that a grid may hold: 16 bytes each while it is built, 8 after.
pub const CLIPPED_TRIANGLE_LIMIT: u64 = 1 << 26;

/// Surfaces that fill less than this share of a voxel's mean face do not occupy it.
const MIN_SHARE: f64 = 1e-9;
/// [`Grid::for_count`] asks for no better count when the edge is known to this factor.
const MIN_BRACKET: f64 = 1.002;
/// Room between the scene and the grid's outside, in voxel edges.
const MARGIN: f64 = 1e-3;

/// The occupied voxels of a scene with their triangles. Voxel `occupied[s]` holds the triangles
/// `triangles[offsets[s]..offsets[s + 1]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Position of the voxels.
    pub shape: GridShape,
    /// Numbers of the voxels that hold surfaces, rising, `[n]`.
    pub occupied: Vec<u32>,
    /// First triangle of each, `[n + 1]`.
    pub offsets: Vec<u32>,
    /// Triangles of the voxels, rising within each.
    pub triangles: Vec<u32>,
    /// Area of each of these triangles inside its voxel, m².
    pub areas: Vec<f32>,
}

impl Grid {
    /// Cuts the triangles of a scene at voxels with these edges, m. The grid is centred on the scene. On all cores;
    /// time and memory grow with triangles + clipped triangles.
    ///
    /// # Errors
    /// [`Error::Setting`] for an edge that is not positive and finite, [`Error::TooMany`] beyond [`VOXEL_LIMIT`] or
    /// [`CLIPPED_TRIANGLE_LIMIT`], [`Error::NoSamples`] for a scene without area.
    pub fn new(scene: &Scene, edges: Vec3) -> Result<Self, Error> {
        let shape = shape(scene, edges)?;
        let layers = layers(&shape);
        let e = edges.as_dvec3();
        let least = MIN_SHARE * (e.x * e.y + e.y * e.z + e.z * e.x) / 3.0;
        let total = AtomicU64::new(0);
        let mut clipped: Vec<(u64, f32)> = scene.geometry.triangles.par_iter().enumerate().par_fold_reduce(
            Vec::new,
            |mut clipped, (index, triangle)| {
                let before = clipped.len();
                if total.load(Ordering::Relaxed) <= CLIPPED_TRIANGLE_LIMIT {
                    cut_triangle(triangle, &layers, |cell, part| {
                        let area = part.area();
                        if area > least {
                            let voxel = u64::from(shape.voxel_at(UVec3::from_array(cell)));
                            clipped.push((voxel << 32 | index as u64, area as f32));
                        }
                    });
                }
                total.fetch_add((clipped.len() - before) as u64, Ordering::Relaxed);
                clipped
            },
            |mut a, mut b| {
                a.append(&mut b);
                a
            },
        );
        let found = total.into_inner();
        if found > CLIPPED_TRIANGLE_LIMIT {
            return Err(Error::TooMany { name: "clipped triangles in voxels", found, limit: CLIPPED_TRIANGLE_LIMIT });
        }
        if clipped.is_empty() {
            return Err(Error::NoSamples);
        }
        // Keys are distinct, so the order does not depend on who found what first.
        clipped.par_sort_unstable_by_key(|&(key, _)| key);
        let mut occupied = Vec::new();
        let mut offsets = Vec::new();
        for (index, &(key, _)) in clipped.iter().enumerate() {
            let voxel = (key >> 32) as u32;
            if occupied.last() != Some(&voxel) {
                occupied.push(voxel);
                offsets.push(index as u32);
            }
        }
        offsets.push(clipped.len() as u32);
        let triangles = clipped.iter().map(|&(key, _)| key as u32).collect();
        let areas = clipped.iter().map(|&(_, area)| area).collect();
        Ok(Self { shape, occupied, offsets, triangles, areas })
    }

    /// The grid with voxels of these proportions for which `count` (patches, say) comes nearest to `target`: bisection
    /// of the edge, down to 2 % of the target, to 10 % when the edge is known to 0.2 % (the count jumps where the grid
    /// gets a layer more), or 16 grids.
    ///
    /// # Errors
    /// As [`Grid::new`], and what `count` returns.
    pub fn for_count(
        scene: &Scene,
        proportions: Vec3,
        target: usize,
        count: impl Fn(&Self) -> Result<usize, Error>,
    ) -> Result<Self, Error> {
        if target == 0 {
            return Err(Error::Setting { name: "patch count", value: 0.0, rule: "at least 1" });
        }
        shape(scene, proportions)?;
        let extent = scene.geometry.bounds.1 - scene.geometry.bounds.0;
        let longest = f64::from((extent / proportions).max_element());
        // Surfaces fill voxels about as edge⁻²; the bracket is in edges, in which the count falls.
        let mut small = longest * 1e-5;
        let mut large = longest * 2.0;
        let area: f64 = scene.geometry.triangles.iter().map(|t| Polygon::of_triangle(t).area()).sum();
        let mut edge = (3.0 * area / target as f64).sqrt().clamp(small, large);
        let mut best: Option<(f64, Self)> = None;
        for _ in 0..16 {
            let found = match Self::new(scene, proportions * edge as f32) {
                Ok(grid) => {
                    let found = count(&grid)? as f64;
                    let distance = ln(found.max(1.0) / target as f64).abs();
                    if best.as_ref().is_none_or(|(least, _)| distance < *least) {
                        best = Some((distance, grid));
                    }
                    found.max(1.0)
                }
                Err(Error::TooMany { .. }) => f64::INFINITY,
                Err(error) => return Err(error),
            };
            let ratio = found / target as f64;
            if (ratio - 1.0).abs() < 0.02 {
                break;
            }
            if ratio > 1.0 {
                small = edge;
            } else {
                large = edge;
            }
            let is_near = best.as_ref().is_some_and(|(distance, _)| *distance < 0.1);
            if is_near && large < small * MIN_BRACKET {
                break;
            }
            let estimate = edge * ratio.sqrt();
            let inside = estimate > small * 1.000_1 && estimate < large * 0.999_9;
            edge = if inside { estimate } else { (small * large).sqrt() };
        }
        best.map(|(_, grid)| grid).ok_or(Error::TooMany { name: "voxels", found: VOXEL_LIMIT + 1, limit: VOXEL_LIMIT })
    }

    /// Number of occupied voxels.
    pub fn len(&self) -> usize {
        self.occupied.len()
    }

    /// Returns true if no voxel is occupied.
    pub fn is_empty(&self) -> bool {
        self.occupied.is_empty()
    }

    /// Triangles of the occupied voxel in place `slot`, rising, and their areas inside it, m². Needs `slot < len()`.
    pub fn clipped_triangles(&self, slot: usize) -> (&[u32], &[f32]) {
        let range = self.offsets[slot] as usize..self.offsets[slot + 1] as usize;
        (&self.triangles[range.clone()], &self.areas[range])
    }

    /// Place of a voxel among the occupied ones.
    pub fn slot_of(&self, voxel: u32) -> Option<usize> {
        self.occupied.binary_search(&voxel).ok()
    }

    /// Least and greatest corner of a voxel, m.
    pub fn voxel_box(&self, voxel: u32) -> (Vec3, Vec3) {
        let low = self.shape.origin + self.shape.coordinates(voxel).as_vec3() * self.shape.edges;
        (low, low + self.shape.edges)
    }

    /// The part of a triangle that lies in a voxel; the whole triangle if rounding leaves nothing.
    pub(super) fn clipped_triangle(&self, scene: &Scene, voxel: u32, triangle: u32) -> Polygon {
        let t = &scene.geometry.triangles[triangle as usize];
        let part = cut_to_cell(t, &layers(&self.shape), self.shape.coordinates(voxel).to_array());
        if part.corners().is_empty() { Polygon::of_triangle(t) } else { part }
    }

    /// Area of all surfaces, one side, holes included, m².
    pub fn area(&self) -> f64 {
        self.areas.iter().map(|&a| f64::from(a)).sum()
    }

    /// Bytes of all tables.
    pub fn bytes(&self) -> usize {
        4 * (self.occupied.len() + self.offsets.len() + self.triangles.len() + self.areas.len())
    }
}

fn shape(scene: &Scene, edges: Vec3) -> Result<GridShape, Error> {
    let names = ["voxel edge x", "voxel edge y", "voxel edge z"];
    for (name, edge) in names.into_iter().zip(edges.to_array()) {
        if !(edge.is_finite() && edge > 0.0) {
            return Err(Error::Setting { name, value: f64::from(edge), rule: "positive and finite" });
        }
    }
    let low = scene.geometry.bounds.0.as_dvec3();
    let high = scene.geometry.bounds.1.as_dvec3();
    let e = edges.as_dvec3();
    let counts = ((high - low) / e + 2.0 * MARGIN).ceil().max(DVec3::ONE);
    let found = counts.x * counts.y * counts.z;
    if found > VOXEL_LIMIT as f64 {
        return Err(Error::TooMany { name: "voxels", found: found as u64, limit: VOXEL_LIMIT });
    }
    let origin = 0.5 * (low + high - counts * e);
    let counts = counts.as_uvec3();
    Ok(GridShape {
        origin: origin.as_vec3(),
        edges,
        count_x: counts.x,
        count_y: counts.y,
        count_z: counts.z,
        reserved: [0; 3],
    })
}

fn layers(shape: &GridShape) -> [Layers; 3] {
    let axis = |a: usize| Layers {
        origin: f64::from(shape.origin[a]),
        edge: f64::from(shape.edges[a]),
        count: shape.counts()[a],
    };
    [axis(0), axis(1), axis(2)]
}
