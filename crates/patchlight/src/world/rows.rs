//! Rows of patches by rays, a block at a time: the same bytes in any order and for any number of threads.

use std::ops::ControlFlow;

use formfactor::{sparse_rows, sparse_traced_rows};
use localmatrix::{Record, WorldHead, block_range};
use runtime::recipe::formfactor::SurfaceTracer;
use scene::sampling::hash3;
use scene::{Hit, NONE, Scene, SurfacePoint};
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
    /// Plan for the leaves of a world.
    pub fn new(scene: &'a Scene, world: &'a Forest, settings: &WorldSettings) -> Self {
        let patches = (0..world.leaves())
            .map(|leaf| {
                let node = &world.nodes[leaf];
                Patch { centroid: node.centre, area: node.area, normal: node.normal, triangle: NONE }
            })
            .collect();
        Self { scene, world, rays: settings.rays, seed: settings.seed, patches }
    }

    /// Hits of the rays of a block of leaves, found by a device.
    ///
    /// # Errors
    /// What the device says.
    pub fn hits(&self, head: &WorldHead, block: u32, tracer: &mut SurfaceTracer) -> Result<Vec<Hit>, Error> {
        Ok(tracer.hits(&self.surfaces(block, &self.points(head, block)))?)
    }

    /// The records of a block of leaves, by `hits` if a device has found what its rays meet; its random numbers are its
    /// own.
    ///
    /// # Errors
    /// What the estimator says.
    pub fn block(&self, head: &WorldHead, block: u32, hits: Option<&[Hit]>) -> Result<Vec<Record>, Error> {
        let own = self.points(head, block);
        let surfaces = self.surfaces(block, &own);
        let ignore_progress = |_, _| ControlFlow::Continue(());
        let rows = match hits {
            None => sparse_rows(&surfaces, self.rays, &ignore_progress)?,
            Some(hits) => sparse_traced_rows(&surfaces, self.rays, hits, &ignore_progress)?,
        };
        let range = block_range(head, block);
        let record = |(k, leaf): (usize, u32)| {
            let own = rows.factors.row_start[k] as usize..rows.factors.row_start[k + 1] as usize;
            Record {
                sky: rows.sky_factor[k],
                lost: rows.lost[k],
                factors: own.map(|e| (rows.factors.column_index[e], rows.factors.values[e])).collect(),
                points: self.world.points_of(leaf).to_vec(),
            }
        };
        Ok(range.enumerate().map(record).collect())
    }

    /// Points from which the rays of a block of leaves start.
    fn points(&self, head: &WorldHead, block: u32) -> RowPoints {
        let mut all = RowPoints { points: Vec::new(), offsets: vec![0] };
        for leaf in block_range(head, block) {
            let own = self.world.points_of(leaf);
            let weight = 1.0 / own.len() as f32;
            all.points.extend(own.iter().map(|p| SurfacePoint {
                position: p.position,
                patch: leaf,
                normal: p.normal,
                weight,
            }));
            all.offsets.push(all.points.len() as u32);
        }
        all
    }

    fn surfaces<'s>(&'s self, block: u32, own: &'s RowPoints) -> Surfaces<'s> {
        let geometry = self.scene.tables();
        Surfaces {
            patches: &self.patches,
            polygons: &[],
            row_polygons: &[],
            points: &own.points,
            offsets: &own.offsets,
            visibility: self.scene,
            owner: Box::new(move |hit, direction| {
                let normal = geometry.normal(hit.triangle);
                let facing = if normal.dot(direction) < 0.0 { normal } else { -normal };
                self.world.owner(geometry.position(hit.triangle, hit.u, hit.v), facing)
            }),
            ray_offset: self.scene.geometry.ray_offset,
            seed: hash3(block, 0x626c_6f63, self.seed),
        }
    }
}

/// Points of the rows of a block: row i has `points[offsets[i]..offsets[i + 1]]`.
struct RowPoints {
    points: Vec<SurfacePoint>,
    offsets: Vec<u32>,
}
