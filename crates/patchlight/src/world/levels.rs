//! Light of the leaves of a world as a camera sees it: of their own nodes near by, of coarser
//! levels further off, between two levels in between, so that no node shows its edges; its jumps
//! fade.

use std::sync::Arc;

use glam::{UVec3, Vec3, Vec4};
use localmatrix::kernel::{fade, spread as at_slot};
use localmatrix::{FadeParams, NO_NODE, Node};
use patches::{GridShape, Lookup, LookupSettings, VirtualPatch};
use rayon::prelude::*;
use scene::math::{ln, luminance};

use super::forest::{DarkPatch, Extra};
use crate::error::Error;

/// Light is taken from levels so much coarser than the nodes that stand there, so that none shows
/// its edges.
const COARSER: f32 = 0.7;

/// One level of merged nodes as leaves see it.
struct Level {
    /// Of those outdoors and of those indoors, where there are any.
    lookups: [Option<Lookup>; 2],
    /// First node.
    first: u32,
    /// Light of the nodes.
    light: Vec<Vec4>,
}

/// Light of the leaves, and of the levels above them.
pub struct Levels {
    /// What pixels see: the leaves, and a last value for what is dark.
    pub lookup: Arc<Lookup>,
    /// Light as the leaves are shown, W/m²; the fourth component is the luminance with which they
    /// were in the frame before.
    pub shown: Vec<Vec4>,
    /// What `shown` has beyond the light that the leaves are to have: what is left of its jumps.
    pub offset: Vec<Vec4>,
    indoors: Vec<bool>,
    levels: Vec<Level>,
    /// Apparent size of nodes at most.
    apparent_size: f32,
    /// Edge of a leaf, m.
    edge: f32,
}

/// Light that comes to the leaves.
#[derive(Clone, Copy)]
pub struct LeafLight<'a> {
    /// All nodes.
    pub nodes: &'a [Node],
    /// Slot of each leaf's node in the matrix.
    pub slot_of: &'a [u32],
    /// Irradiance of the slots, W/m².
    pub irradiance: &'a [Vec4],
    /// Irradiance of a hemisphere that sees nothing but a constant sky, W/m², and the share of it
    /// that each node sees.
    pub sky: Vec4,
    /// The shares.
    pub sky_factors: &'a [f32],
}

impl LeafLight<'_> {
    fn own(&self, leaf: usize) -> Vec4 {
        at_slot(self.slot_of[leaf], self.irradiance) + self.sky * self.sky_factors[leaf]
    }
}

impl Levels {
    /// Dark levels of a world whose leaves have edges of about `edge`, m.
    ///
    /// # Errors
    /// Voxels that are not of the grid.
    pub fn new(nodes: &[Node], extra: Extra, edge: f32) -> Result<Self, Error> {
        let (lookup, levels) = lookups(nodes, &extra)?;
        Ok(Self {
            shown: vec![Vec4::ZERO; lookup.values],
            offset: vec![Vec4::ZERO; lookup.values],
            lookup: Arc::new(lookup),
            indoors: extra.indoors,
            levels,
            apparent_size: 0.0,
            edge,
        })
    }

    /// Bytes of the lookups and of the light of the levels.
    pub fn lookup_bytes(&self) -> usize {
        let mut bytes = self.lookup.bytes();
        for level in &self.levels {
            bytes += level.lookups.iter().flatten().map(Lookup::bytes).sum::<usize>();
            bytes += size_of_val(&level.light[..]);
        }
        bytes
    }

    /// Begins a frame: what is shown becomes what the frame before has shown.
    pub fn begin(&mut self) {
        self.shown.par_iter_mut().for_each(|shown| shown.w = luminance(shown.truncate()));
    }

    /// Light of the leaves as a camera is to see them, from that of the matrix and the sky: its own
    /// for what is near, further off that of merged nodes, between their places and between two
    /// levels, so that none of them shows its edges. In `shown` then is what is shown of it: its
    /// jumps fade; without `jumps` it is there at once, and what is left of earlier jumps stays.
    pub fn spread(&mut self, from: &LeafLight, eye: Vec3, jumps: Option<FadeParams>) {
        self.merge(from);
        let mut shown = std::mem::take(&mut self.shown);
        let mut offset = std::mem::take(&mut self.offset);
        let leaves = shown.par_iter_mut().zip(&mut offset).take(from.slot_of.len()).enumerate();
        leaves.for_each(|(leaf, (shown, offset))| {
            let light = self.light(from, eye, leaf);
            if let Some(params) = &jumps {
                *offset = fade(Vec4::ZERO, *shown, light, params);
            }
            *shown = (light + *offset).truncate().extend(shown.w);
        });
        self.shown = shown;
        self.offset = offset;
    }

    /// Light of merged nodes: means by area of what they are merged of.
    fn merge(&mut self, from: &LeafLight) {
        let nodes = from.nodes;
        for k in 0..self.levels.len() {
            let (below, rest) = self.levels.split_at_mut(k);
            let Level { first, light, .. } = &mut rest[0];
            let of = |child: u32| match below.last() {
                None => from.own(child as usize),
                Some(under) => under.light[(child - under.first) as usize],
            };
            light.par_iter_mut().enumerate().for_each(|(k, value)| {
                let node = *first as usize + k;
                let children = nodes[node].first_child..nodes[node].first_child + nodes[node].children;
                *value = children.map(|c| of(c) * nodes[c as usize].area).sum::<Vec4>() / nodes[node].area;
            });
        }
    }

    /// Light of a leaf between the two levels that suit its distance.
    fn light(&self, from: &LeafLight, eye: Vec3, leaf: usize) -> Vec4 {
        let node = &from.nodes[leaf];
        let size = self.apparent_size * (node.centre.distance(eye) + 2.0 * self.edge) / self.edge;
        let coarse = ln(size.max(1e-6)) / std::f32::consts::LN_2 + COARSER;
        let level = coarse.clamp(0.0, self.levels.len() as f32);
        let low = level.floor() as usize;
        let share = level.fract();
        if share == 0.0 {
            return self.at_level(from, low, leaf);
        }
        self.at_level(from, low, leaf).lerp(self.at_level(from, low + 1, leaf), share)
    }

    fn at_level(&self, from: &LeafLight, level: usize, leaf: usize) -> Vec4 {
        let Some(above) = level.checked_sub(1) else { return from.own(leaf) };
        let node = &from.nodes[leaf];
        let Level { lookups, light, .. } = &self.levels[above];
        let lookup = lookups[usize::from(self.indoors[leaf])].as_ref();
        // The tables have as many values as the lookup wants: made together.
        let normal = node.normal.normalize_or(Vec3::Y);
        lookup.and_then(|l| l.at(light, node.centre, normal).ok()).unwrap_or(Vec4::ZERO)
    }

    /// Finds the apparent size of nodes, once: pixels then take their light from levels that change
    /// with distance only.
    pub fn find_apparent_size(&mut self, nodes: &[Node], cut: &[u32], eye: Vec3) {
        if self.apparent_size > 0.0 {
            return;
        }
        let edge = self.edge;
        let size = |node: &Node| {
            scene::math::sqrt(node.area) / ((node.centre.distance(eye) - node.radius).max(0.0) + 2.0 * edge)
        };
        let merged = cut.iter().map(|&node| &nodes[node as usize]).filter(|node| node.children > 0);
        let mut sizes: Vec<f32> = merged.map(size).collect();
        sizes.sort_by(f32::total_cmp);
        self.apparent_size = sizes.get(sizes.len() * 9 / 10).copied().unwrap_or(1e-6);
    }
}

/// The lookup of the leaves, and those of each level above them, a voxel of which holds eight of
/// the one below.
fn lookups(nodes: &[Node], extra: &Extra) -> Result<(Lookup, Vec<Level>), Error> {
    let virtual_patch = |node: &Node, voxel: u32| VirtualPatch {
        position: node.centre,
        area: node.area,
        normal: node.normal.normalize_or(Vec3::Y),
        voxel,
        albedo: node.albedo,
        reserved: 0,
    };
    let settings = LookupSettings::default();
    let dark = |d: DarkPatch| VirtualPatch {
        position: d.position,
        area: 1.0,
        normal: d.normal.normalize_or(Vec3::Y),
        voxel: d.voxel,
        ..VirtualPatch::default()
    };
    let (mut shape, mut own) = (extra.shape, 0..extra.voxels.len());
    let mut coordinates: Vec<UVec3> = extra.voxels.iter().map(|&voxel| shape.coordinates(voxel)).collect();
    let mut indoors = extra.indoors.clone();
    let leaf = |k: usize| virtual_patch(&nodes[k], extra.voxels[k]);
    let dark = |k: usize| dark(extra.dark[k]);
    let lookup = Lookup::with_dark(&shape, (own.len(), leaf), (extra.dark.len(), dark), settings)?;
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
        let light = vec![Vec4::ZERO; above.len()];
        levels.push(Level { lookups: [lookup(false)?, lookup(true)?], first: above.start as u32, light });
        own = above;
    }
    Ok((lookup, levels))
}
