//! The sample of any place on a surface: the nearest of like normal.

use glam::{IVec3, Vec3};
use hashbrown::{HashMap, HashSet};
use std::vec::Vec;

use crate::types::Sample;

/// A turn of the normal by 60° counts as much as this many sample edges.
const NORMAL_EDGES: f32 = 4.0;
/// What is added to the square of the distance along the normal, so that it counts four times: sheets may be near.
const OFFSET: f32 = 15.0;
/// Edge of the coarse cells by which far places are told, in cells.
const COARSE: i32 = 4;
/// Edge of a cell of the search grid, in sample edges.
const CELL: f32 = 2.0;

/// Finds the nearest samples in position and normal: a hash grid over positions, so that a search looks at the cells round
/// the place only.
pub struct Nearest {
    samples: Vec<(Vec3, Vec3)>,
    /// Samples in the order of their cells.
    order: Vec<u32>,
    /// First and one past the last of each cell in `order`.
    cells: HashMap<IVec3, (u32, u32)>,
    /// Coarse cells that hold samples, and those beside them.
    about: HashSet<IVec3>,
    /// Cells a metre.
    scale: f32,
}

impl Nearest {
    /// Over samples of about equal area.
    pub fn new(samples: &[Sample]) -> Self {
        let total: f64 = samples.iter().map(|s| f64::from(s.area)).sum();
        let edge = scene::math::sqrt((total / samples.len().max(1) as f64) as f32);
        let scale = 1.0 / (CELL * edge);
        let cell = |k: u32| (samples[k as usize].position * scale).floor().as_ivec3();
        let mut order: Vec<u32> = (0..samples.len() as u32).collect();
        order.sort_by_cached_key(|&k| (cell(k).to_array(), k));
        let mut cells: HashMap<IVec3, (u32, u32)> = HashMap::new();
        for (place, &k) in (0u32..).zip(&order) {
            cells.entry(cell(k)).or_insert((place, place)).1 = place + 1;
        }
        let coarse: HashSet<IVec3> = cells.keys().map(|cell| cell.div_euclid(IVec3::splat(COARSE))).collect();
        let beside = |cell: &IVec3| {
            let cell = *cell;
            (0..27).map(move |k| cell + IVec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1))
        };
        let about = coarse.iter().flat_map(beside).collect();
        let samples = samples.iter().map(|s| (s.position, s.normal)).collect();
        Self { samples, order, cells, about, scale }
    }

    /// The sample nearest to a place on the side of a surface with this unit normal, and its distance in sample edges: √ of
    /// the square of that in space, the part along the normal counted four times, and 16 |n − n'|². None when there is none
    /// within `most` sample edges.
    pub fn sample(&self, position: Vec3, normal: Vec3, most: f32) -> Option<(u32, f32)> {
        let mut best = [(0, most * most)];
        let found = self.search(position, normal, &mut best);
        (found > 0).then(|| (best[0].0, scene::math::sqrt(best[0].1)))
    }

    /// Up to N nearest samples within `most` sample edges, the nearest first with their distances, as
    /// [`Nearest::sample`] finds one, and how many there are.
    pub fn samples<const N: usize>(&self, position: Vec3, normal: Vec3, most: f32) -> ([(u32, f32); N], usize) {
        let mut best = [(0, most * most); N];
        let found = self.search(position, normal, &mut best);
        (best.map(|(sample, squared)| (sample, scene::math::sqrt(squared))), found)
    }

    /// Fills `best` with the nearest samples whose squared distance is below what stands there.
    fn search(&self, position: Vec3, normal: Vec3, best: &mut [(u32, f32)]) -> usize {
        let home = (position * self.scale).floor().as_ivec3();
        let (mut found, last) = (0, best.len() - 1);
        // Nothing within COARSE · CELL edges; nobody asks for more.
        if !self.about.contains(&home.div_euclid(IVec3::splat(COARSE))) {
            return 0;
        }
        let edges = CELL * self.scale; // sample edges a metre
        let mut ring = 0i32;
        // All that lies in rings beyond is at least this far.
        while ring == 0 || ((ring - 1) as f32 * CELL) * ((ring - 1) as f32 * CELL) < best[last].1 {
            for x in -ring..=ring {
                for y in -ring..=ring {
                    let inside = x.abs() < ring && y.abs() < ring;
                    let step = if inside { 2 * ring } else { 1 };
                    for z in (-ring..=ring).step_by(step.max(1) as usize) {
                        let Some(&(from, to)) = self.cells.get(&(home + IVec3::new(x, y, z))) else { continue };
                        for &k in &self.order[from as usize..to as usize] {
                            let (there, its) = self.samples[k as usize];
                            let turn = NORMAL_EDGES * NORMAL_EDGES * normal.distance_squared(its);
                            let (way, off) = (there - position, normal.dot(there - position));
                            let squared = (way.length_squared() + OFFSET * off * off) * edges * edges + turn;
                            if squared < best[last].1 {
                                found = (found + 1).min(best.len());
                                let mut at = last;
                                while at > 0 && squared < best[at - 1].1 {
                                    best[at] = best[at - 1];
                                    at -= 1;
                                }
                                best[at] = (k, squared);
                            }
                        }
                    }
                }
            }
            ring += 1;
        }
        found
    }
}
