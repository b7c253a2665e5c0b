//! Rows of patches by rays, a block at a time: the same bytes in any order and for any number of threads.

use std::ops::ControlFlow;

use formfactor::sparse_rows;
use localmatrix::{Record, WorldHead, block_range};
use scene::sampling::hash3;
use scene::{NONE, Scene, SurfacePoint};
use transport::{Patch, Surfaces};

use super::bake::WorldSettings;
use super::forest::Forest;
use crate::error::Error;

/// Makes rows.
pub struct Rows<'a> {
    scene: &'a Scene,
    world: &'a Forest,
    rays: u32,
    seed: u32,
    /// The columns: only their number counts for rays.
    patches: Vec<Patch>,
}

impl<'a> Rows<'a> {
    /// Of the leaves of a world.
    pub fn new(scene: &'a Scene, world: &'a Forest, settings: &WorldSettings) -> Self {
        let patch = |leaf: usize| {
            let node = &world.nodes[leaf];
            Patch { centroid: node.centre, area: node.area, normal: node.normal, triangle: NONE }
        };
        let patches = (0..world.leaves()).map(patch).collect();
        Self { scene, world, rays: settings.rays, seed: settings.seed, patches }
    }

    /// The records of a block of leaves; its random numbers are its own.
    ///
    /// # Errors
    /// What the estimator says.
    pub fn block(&self, head: &WorldHead, block: u32) -> Result<Vec<Record>, Error> {
        let (mut points, mut offsets) = (Vec::new(), vec![0]);
        let range = block_range(head, block);
        for leaf in range.clone() {
            let own = self.world.points_of(leaf);
            let weight = 1.0 / own.len() as f32;
            let point = |p: &localmatrix::LitPoint| SurfacePoint {
                position: p.position,
                patch: leaf,
                normal: p.normal,
                weight,
            };
            points.extend(own.iter().map(point));
            offsets.push(points.len() as u32);
        }
        let geometry = self.scene.tables();
        let surfaces = Surfaces {
            patches: &self.patches,
            polygons: &[],
            row_polygons: &[],
            points: &points,
            offsets: &offsets,
            visibility: self.scene,
            owner: Box::new(|hit, direction| {
                let normal = geometry.normal(hit.triangle);
                let facing = if normal.dot(direction) < 0.0 { normal } else { -normal };
                self.world.owner(geometry.position(hit.triangle, hit.u, hit.v), facing)
            }),
            ray_offset: self.scene.geometry.ray_offset,
            seed: hash3(block, 0x626c_6f63, self.seed),
        };
        let rows = sparse_rows(&surfaces, self.rays, &|_, _| ControlFlow::Continue(()))?;
        let record = |(k, leaf): (usize, u32)| {
            let own = rows.factors.row_start[k] as usize..rows.factors.row_start[k + 1] as usize;
            let entry = |e: usize| (rows.factors.column_index[e], rows.factors.values[e]);
            Record {
                sky: rows.sky_factor[k],
                lost: rows.lost[k],
                factors: own.map(entry).collect(),
                points: self.world.points_of(leaf).to_vec(),
            }
        };
        Ok(range.enumerate().map(record).collect())
    }
}
