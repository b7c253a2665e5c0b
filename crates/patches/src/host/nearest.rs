//! The sample of any place on a surface: the nearest of like normal.

use alloc::vec::Vec;
use glam::{IVec3, Vec3};
use hashbrown::HashMap;

use super::focus::Density;
use crate::types::Sample;

/// A rotation of the normal by 60° counts as much as this many sample edges.
const NORMAL_EDGES: f32 = 4.0;
/// Added to the square of the distance along the normal, so that it counts four times: sheets may be near.
const OFFSET: f32 = 15.0;
/// Edge of a cell of the search grid, in sample edges.
const CELL: f32 = 2.0;
/// Edge of a block of cells, in cells, and the cells in one.
const BLOCK: i32 = 8;
const BLOCK_CELLS: usize = (BLOCK * BLOCK * BLOCK) as usize;
/// Furthest that a search looks, in cells: not beyond the blocks beside the place's own.
const REACH: i32 = BLOCK / 2;
/// Cells are numbered up to this.
const FARTHEST: f32 = (1 << 24) as f32;
/// No block.
const NONE: u32 = u32::MAX;
/// Rounding tolerance of the least distance of a cell.
const ROUNDING: f32 = 0.9999;

/// Finds the nearest samples in position and normal. Distances are in sample edges, of each sample in its own: samples
/// reach as far as they are large.
#[derive(Clone)]
pub struct Nearest {
    density: Density,
    /// The samples of each level of the density.
    levels: Vec<Level>,
}

/// Samples of about equal area: cells in blocks of 8³, a hash of the blocks that hold samples, so that a search asks
/// the hash for eight blocks at most and looks only at cells that can hold something nearer than what it has.
#[derive(Clone)]
struct Level {
    /// Positions and normals in the order of their cells, and whose they are.
    places: Vec<(Vec3, Vec3)>,
    order: Vec<u32>,
    /// The number of each block.
    blocks: HashMap<IVec3, u32>,
    /// For each cell of each block where its samples begin in `order`, and one past the last of the block.
    starts: Vec<[u32; BLOCK_CELLS + 1]>,
    /// Cells a metre.
    scale: f32,
}

/// The block of a cell, and the cell in it.
fn block_of(cell: IVec3) -> (IVec3, usize) {
    let (block, IVec3 { x, y, z }) = (cell.div_euclid(IVec3::splat(BLOCK)), cell.rem_euclid(IVec3::splat(BLOCK)));
    (block, ((x * BLOCK + y) * BLOCK + z) as usize)
}

impl Nearest {
    /// Over samples as dense as is said: of about equal area on each level.
    pub fn new(samples: &[Sample], density: &Density) -> Self {
        let mut levels: Vec<Vec<u32>> = Vec::new();
        for (k, sample) in (0u32..).zip(samples) {
            let level = density.level(sample.position) as usize;
            levels.resize_with(levels.len().max(level + 1), Vec::new);
            levels[level].push(k);
        }
        Self { density: *density, levels: levels.into_iter().map(|level| Level::new(samples, level)).collect() }
    }

    /// The sample nearest to a place on the side of a surface with this unit normal, and its distance in its own edges:
    /// √ of the square of that in space, the part along the normal counted four times, and 16 |n − n'|². None when
    /// there is none within `most` edges, of which 8 are the most.
    pub fn sample(&self, position: Vec3, normal: Vec3, most: f32) -> Option<(u32, f32)> {
        let (best, found) = self.samples::<1>(position, normal, most);
        (found > 0).then_some(best[0])
    }

    /// Up to N nearest samples within `most` edges, the nearest first with their distances, as [`Nearest::sample`]
    /// finds one, and how many there are.
    pub fn samples<const N: usize>(&self, position: Vec3, normal: Vec3, most: f32) -> ([(u32, f32); N], usize) {
        let mut best = [(0, most * most); N];
        let mut found = 0;
        // Levels change slowly: what is near is of the place's own level or of one beside it.
        let own = if self.levels.len() > 1 { self.density.level(position) as usize } else { 0 };
        for level in self.levels.iter().take(own + 2).skip(own.saturating_sub(1)) {
            found = level.search(position, normal, &mut best, found);
        }
        (best.map(|(sample, squared)| (sample, scene::math::sqrt(squared))), found)
    }
}

impl Level {
    /// These ones of the samples.
    fn new(samples: &[Sample], mut order: Vec<u32>) -> Self {
        let total: f64 = order.iter().map(|&k| f64::from(samples[k as usize].area)).sum();
        let edge = scene::math::sqrt((total / order.len().max(1) as f64) as f32);
        let scale = 1.0 / (CELL * edge);
        let cell = |k: u32| block_of((samples[k as usize].position * scale).floor().as_ivec3());
        order.sort_by_cached_key(|&k| {
            let (block, cell) = cell(k);
            (block.to_array(), cell, k)
        });
        let mut blocks: HashMap<IVec3, u32> = HashMap::new();
        let mut starts: Vec<[u32; BLOCK_CELLS + 1]> = Vec::new();
        for (place, &k) in (0u32..).zip(&order) {
            let (block, cell) = cell(k);
            let number = *blocks.entry(block).or_insert_with(|| {
                starts.push([place; BLOCK_CELLS + 1]);
                starts.len() as u32 - 1
            });
            starts[number as usize][cell + 1..].fill(place + 1);
        }
        let places = order.iter().map(|&k| (samples[k as usize].position, samples[k as usize].normal)).collect();
        Self { places, order, blocks, starts, scale }
    }

    /// Fills `best`, of which `found` are found already, with the nearest samples whose squared distance is below what
    /// stands there, and returns how many are found then.
    fn search(&self, position: Vec3, normal: Vec3, best: &mut [(u32, f32)], mut found: usize) -> usize {
        let place = position * self.scale;
        let home = place.floor().as_ivec3();
        let within = place - home.as_vec3();
        let last = best.len() - 1;
        // Without samples there is no scale, and what is out of all bounds has none about it.
        if self.blocks.is_empty() || place.abs().max_element() >= FARTHEST {
            return found;
        }
        let low = (home - REACH).div_euclid(IVec3::splat(BLOCK));
        let numbers: [u32; 8] = core::array::from_fn(|k| {
            let corner = IVec3::new(k as i32 >> 2, k as i32 >> 1 & 1, k as i32 & 1);
            self.blocks.get(&(low + corner)).copied().unwrap_or(NONE)
        });
        if numbers == [NONE; 8] {
            return found;
        }
        let edges = CELL * self.scale; // sample edges a metre
        // Distance of the place from the cells at this step along an axis, in cells.
        let gap = |step: i32, within: f32| if step > 0 { step as f32 - within } else { within - (step + 1) as f32 };
        let gaps = |axis: f32| move |step: i32| if step == 0 { 0.0 } else { gap(step, axis) };
        let gap_x = gaps(within.x);
        let gap_y = gaps(within.y);
        let gap_z = gaps(within.z);
        // Half of a cell's extent along the normal.
        let half = 0.5 * normal.abs().element_sum();
        let nearest_side = within.min(Vec3::ONE - within).min_element();
        for ring in 0..=REACH {
            // All that lies in rings beyond is at least this far.
            let beyond = if ring == 0 { 0.0 } else { (nearest_side + (ring - 1) as f32) * CELL };
            if beyond * beyond * ROUNDING >= best[last].1 {
                break;
            }
            for x in -ring..=ring {
                let square_x = gap_x(x) * gap_x(x);
                for y in -ring..=ring {
                    let square_xy = square_x + gap_y(y) * gap_y(y);
                    if square_xy * (CELL * CELL * ROUNDING) >= best[last].1 {
                        continue;
                    }
                    let inside = x.abs() < ring && y.abs() < ring;
                    let step = if inside { 2 * ring } else { 1 };
                    for z in (-ring..=ring).step_by(step.max(1) as usize) {
                        let cell = IVec3::new(x, y, z);
                        let off = (normal.dot(cell.as_vec3() + 0.5 - within).abs() - half).max(0.0);
                        let square = square_xy + gap_z(z) * gap_z(z) + OFFSET * off * off;
                        if square * (CELL * CELL * ROUNDING) >= best[last].1 {
                            continue;
                        }
                        let (block, cell) = block_of(home + cell);
                        let corner = block - low;
                        let number = numbers[(corner.x << 2 | corner.y << 1 | corner.z) as usize];
                        if number == NONE {
                            continue;
                        }
                        let starts = &self.starts[number as usize];
                        for k in starts[cell] as usize..starts[cell + 1] as usize {
                            let (there, its) = self.places[k];
                            let rotation = NORMAL_EDGES * NORMAL_EDGES * normal.distance_squared(its);
                            let way = there - position;
                            let off = normal.dot(there - position);
                            let squared = (way.length_squared() + OFFSET * off * off) * edges * edges + rotation;
                            if squared < best[last].1 {
                                found = (found + 1).min(best.len());
                                let mut at = last;
                                while at > 0 && squared < best[at - 1].1 {
                                    best[at] = best[at - 1];
                                    at -= 1;
                                }
                                best[at] = (self.order[k], squared);
                            }
                        }
                    }
                }
            }
        }
        found
    }
}
