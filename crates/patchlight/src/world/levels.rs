//! Light of the leaves of a world as a camera sees it: of their own nodes near by, of coarser
//! levels further off, between two levels in between, so that no node shows its edges; its jumps
//! fade. The tables for it; [`runtime::recipe::levels`] has the passes.

use std::sync::Arc;

use glam::{UVec2, UVec3, Vec3, Vec4};
use localmatrix::{FadeParams, LevelParams, NO_NODE, Node};
use patches::{GridShape, Lookup, LookupSettings, VirtualPatch};
use runtime::recipe::levels::{Leaves, Level, LevelTables};
use scene::SurfacePoint;

use super::forest::{DarkPatch, Extra};
use crate::error::Error;

/// The leaves and the levels above them.
pub struct Levels {
    /// Lookup of pixels: the leaves, and a last value for what is dark.
    pub lookup: Arc<Lookup>,
    /// From the slots of the matrix to the leaves.
    pub tables: Arc<LevelTables>,
    /// Apparent size of nodes at most.
    apparent_size: f32,
    /// Edge of a leaf, m.
    edge: f32,
}

impl Levels {
    /// The levels of a world whose leaves have edges of about `edge`, m; `sky` is the irradiance of
    /// a hemisphere that sees nothing but a constant sky, W/m², of which each leaf sees a share.
    ///
    /// # Errors
    /// Voxels that are not of the grid.
    pub fn new(nodes: &[Node], extra: Extra, sky: Vec4, sky_factors: &[f32], edge: f32) -> Result<Self, Error> {
        let (lookup, levels) = lookups(nodes, &extra)?;
        let own = &nodes[..extra.voxels.len()];
        let point = |(node, &is_indoors): (&Node, &bool)| SurfacePoint {
            position: node.centre,
            patch: u32::from(is_indoors),
            normal: node.normal.normalize_or(Vec3::Y),
            weight: 1.0,
        };
        let leaves = Leaves {
            points: own.iter().zip(&extra.indoors).map(point).collect(),
            area: own.iter().map(|node| node.area).collect(),
            sky: match sky == Vec4::ZERO {
                true => Vec::new(),
                false => sky_factors[..own.len()].iter().map(|&share| sky * share).collect(),
            },
        };
        let tables = LevelTables::new(leaves, levels);
        Ok(Self { lookup: Arc::new(lookup), tables: Arc::new(tables), apparent_size: 0.0, edge })
    }

    /// Bytes of the lookups.
    pub fn bytes(&self) -> u64 {
        self.lookup.bytes() as u64 + self.tables.bytes()
    }

    /// Parameters of the leaves for a camera: [`LevelParams::begins`] in a frame, with jumps that fade, or without.
    pub fn params(&self, eye: Vec3, begins: bool, jumps: Option<FadeParams>) -> LevelParams {
        let FadeParams { keep, has_jump, display_white, .. } = jumps.unwrap_or_default();
        LevelParams {
            eye,
            count: self.tables.leaves() as u32,
            apparent_size: self.apparent_size,
            edge: self.edge,
            levels: self.tables.levels() as u32,
            begins: u32::from(begins),
            fades: u32::from(jumps.is_some()),
            keep,
            has_jump,
            display_white,
        }
    }

    /// Finds the apparent size of nodes, once: pixels then take their light from levels that change
    /// with distance only.
    pub fn find_apparent_size(&mut self, nodes: &[Node], cut: &[u32], eye: Vec3) {
        if self.apparent_size > 0.0 {
            return;
        }
        let edge = self.edge;
        let merged = cut.iter().map(|&node| &nodes[node as usize]).filter(|node| node.children > 0);
        let mut sizes: Vec<f32> = merged
            .map(|node| {
                scene::math::sqrt(node.area) / ((node.centre.distance(eye) - node.radius).max(0.0) + 2.0 * edge)
            })
            .collect();
        sizes.sort_by(f32::total_cmp);
        self.apparent_size = sizes.get(sizes.len() * 9 / 10).copied().unwrap_or(1e-6);
    }
}

/// The lookup of the leaves, and those of each level above them, a voxel of which holds eight of
/// the one below.
fn lookups(nodes: &[Node], extra: &Extra) -> Result<(Lookup, Vec<Level>), Error> {
    let settings = LookupSettings::default();
    let mut shape = extra.shape;
    let mut own = 0..extra.voxels.len();
    let mut coordinates: Vec<UVec3> = extra.voxels.iter().map(|&voxel| shape.coordinates(voxel)).collect();
    let mut indoors = extra.indoors.clone();
    let leaf = |k: usize| virtual_patch(&nodes[k], extra.voxels[k]);
    let lookup =
        Lookup::with_dark(&shape, (own.len(), leaf), (extra.dark.len(), |k| dark_patch(extra.dark[k])), settings)?;
    let mut levels = Vec::new();
    while nodes[own.clone()].iter().all(|node| node.parent != NO_NODE) {
        let merged = nodes[own.end..].iter().take_while(|node| own.contains(&(node.first_child as usize))).count();
        let above = own.end..own.end + merged;
        if merged == 0 {
            break;
        }
        let first_child = |node: usize| nodes[node].first_child as usize - own.start;
        coordinates = above.clone().map(|node| coordinates[first_child(node)] / 2).collect();
        indoors = above.clone().map(|node| indoors[first_child(node)]).collect();
        let counts = shape.counts().map(|n| n.div_ceil(2));
        let edges = shape.edges * 2.0;
        shape = GridShape { edges, count_x: counts.x, count_y: counts.y, count_z: counts.z, ..shape };
        let lookup = |class: bool| {
            let chosen: Vec<u32> = (0..above.len() as u32).filter(|&k| indoors[k as usize] == class).collect();
            if chosen.is_empty() {
                return Ok::<_, Error>(None);
            }
            let merged = |k: usize| {
                let k = chosen[k] as usize;
                virtual_patch(&nodes[above.start + k], shape.voxel_at(coordinates[k]))
            };
            let mut lookup =
                Lookup::with_dark(&shape, (chosen.len(), merged), (0, |_| VirtualPatch::default()), settings)?;
            // Values are those of the whole level.
            lookup.entries.iter_mut().for_each(|entry| entry.patch = chosen[entry.patch as usize]);
            lookup.values = above.len();
            Ok(Some(lookup))
        };
        let children = nodes[above.clone()].iter().map(|node| {
            let first = node.first_child - own.start as u32;
            UVec2::new(first, first + node.children)
        });
        levels.push(Level {
            lookups: [lookup(false)?, lookup(true)?],
            children: children.collect(),
            area: nodes[above.clone()].iter().map(|node| node.area).collect(),
        });
        own = above;
    }
    Ok((lookup, levels))
}

fn virtual_patch(node: &Node, voxel: u32) -> VirtualPatch {
    VirtualPatch {
        position: node.centre,
        area: node.area,
        normal: node.normal.normalize_or(Vec3::Y),
        voxel,
        albedo: node.albedo,
        reserved: 0,
    }
}

fn dark_patch(dark: DarkPatch) -> VirtualPatch {
    VirtualPatch {
        position: dark.position,
        area: 1.0,
        normal: dark.normal.normalize_or(Vec3::Y),
        voxel: dark.voxel,
        ..VirtualPatch::default()
    }
}
