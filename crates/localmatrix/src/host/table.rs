//! A world in memory: patches, their rows, and a tree that merges them.

use std::vec::Vec;

use glam::Vec3;
use rayon::prelude::*;

use super::assembly::Row;
use super::world::{NO_NODE, Node, World};
use crate::error::Error;

/// A patch of a [`Table`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Middle, m.
    pub centre: Vec3,
    /// Normal, of length 1 at most.
    pub normal: Vec3,
    /// Area, m², by which the rows are reciprocal.
    pub area: f32,
    /// Reflectance.
    pub albedo: Vec3,
}

/// How much the share of sight that meets anything counts, as so many times the extent of the patches that are to be divided.
const COVER: f32 = 3.0;

/// A world in memory. A tree halves the patches by place, direction and what they see, a right turn of the normal counting like the extent
/// of those that are to be divided; a node's reflectance and row are the means of its patches', by their areas. When the rows are
/// reciprocal, so are those of all nodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    nodes: Vec<Node>,
    /// Node of each patch.
    node_of: Vec<u32>,
    /// The patches in the order of the leaves, and the run of them in each node.
    order: Vec<u32>,
    runs: Vec<[u32; 2]>,
    area: Vec<f32>,
    row_start: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f32>,
}

impl Table {
    /// A world of patches and the rows of F between them: those of patch i are `row_start[i]..row_start[i + 1]` of `columns` and `values`.
    ///
    /// # Errors
    /// [`Error::Length`] for rows that do not fit together; values are checked by [`super::Local::new`] and by the matrix.
    pub fn new(surfaces: &[Surface], row_start: Vec<u32>, columns: Vec<u32>, values: Vec<f32>) -> Result<Self, Error> {
        let count = surfaces.len();
        let check = |name, expected, found| match expected == found {
            true => Ok(()),
            false => Err(Error::Length { name, expected, found }),
        };
        check("row_start", count + 1, row_start.len())?;
        check("columns", row_start[count] as usize, columns.len())?;
        check("values", columns.len(), values.len())?;
        if row_start.windows(2).any(|two| two[0] > two[1]) || columns.iter().any(|&j| j as usize >= count) {
            return Err(Error::Length { name: "rows", expected: count, found: columns.len() });
        }
        let seen = what_is_seen(surfaces, &row_start, &columns, &values);
        let mut order: Vec<u32> = (0..count as u32).collect();
        let (mut nodes, mut runs, mut node_of) = (Vec::new(), Vec::new(), vec![NO_NODE; count]);
        if count > 0 {
            nodes.push(merged(surfaces, &order, NO_NODE));
            runs.push([0, count as u32]);
        }
        let mut next = 0;
        while next < nodes.len() {
            let [first, end] = runs[next].map(|k| k as usize);
            if end - first == 1 {
                node_of[order[first] as usize] = next as u32;
            } else {
                halve(surfaces, &seen, &mut order[first..end]);
                let middle = first.midpoint(end);
                (nodes[next].first_child, nodes[next].children) = (nodes.len() as u32, 2);
                for [first, end] in [[first, middle], [middle, end]] {
                    nodes.push(merged(surfaces, &order[first..end], next as u32));
                    runs.push([first as u32, end as u32]);
                }
            }
            next += 1;
        }
        let area = surfaces.iter().map(|one| one.area).collect();
        Ok(Self { nodes, node_of, order, runs, area, row_start, columns, values })
    }

    /// Node of each patch.
    pub fn node_of(&self) -> &[u32] {
        &self.node_of
    }

    /// The patches in the order of the leaves.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// Bytes of the rows and of the nodes.
    pub fn bytes(&self) -> u64 {
        let rows = size_of_val(&self.row_start[..]) + size_of_val(&self.columns[..]) + size_of_val(&self.values[..]);
        (rows + size_of_val(&self.nodes[..]) + size_of_val(&self.runs[..])) as u64
    }

    fn entries(&self, patch: u32) -> impl Iterator<Item = (u32, f32)> + '_ {
        let own = self.row_start[patch as usize] as usize..self.row_start[patch as usize + 1] as usize;
        self.columns[own.clone()].iter().copied().zip(self.values[own].iter().copied())
    }
}

impl World for Table {
    fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// All rows are there.
    fn want(&mut self, _: &[u32]) {}

    fn row(&mut self, node: u32) -> Result<Option<Row>, Error> {
        let [first, end] = self.runs[node as usize].map(|k| k as usize);
        if end - first == 1 {
            let row = self.entries(self.order[first]).map(|(j, f)| (self.node_of[j as usize], f));
            return Ok(Some(row.collect()));
        }
        let mut sums = vec![0.0f64; self.area.len()];
        for &patch in &self.order[first..end] {
            let area = f64::from(self.area[patch as usize]);
            self.entries(patch).for_each(|(j, f)| sums[j as usize] += area * f64::from(f));
        }
        let whole: f64 = self.order[first..end].iter().map(|&patch| f64::from(self.area[patch as usize])).sum();
        let entries = sums.par_iter().zip(&self.node_of).filter(|(sum, _)| **sum > 0.0);
        Ok(Some(entries.map(|(sum, &node)| (node, (sum / whole) as f32)).collect()))
    }
}

/// Several patches as one node without children.
fn merged(surfaces: &[Surface], patches: &[u32], parent: u32) -> Node {
    let (mut centre, mut normal, mut albedo, mut area) = ([0.0f64; 3], [0.0f64; 3], [0.0f64; 3], 0.0f64);
    for &patch in patches {
        let one = &surfaces[patch as usize];
        let weight = f64::from(one.area);
        area += weight;
        for k in 0..3 {
            centre[k] += weight * f64::from(one.centre[k]);
            normal[k] += weight * f64::from(one.normal[k]);
            albedo[k] += weight * f64::from(one.albedo[k]);
        }
    }
    let mean = |sum: [f64; 3]| Vec3::from_array(sum.map(|x| (x / area) as f32));
    let centre = mean(centre);
    // A disc of its area about the middle of each.
    let reach = |&patch: &u32| {
        let one = &surfaces[patch as usize];
        one.centre.distance(centre) + scene::math::sqrt(one.area / std::f32::consts::PI)
    };
    let radius = patches.iter().map(reach).fold(0.0, f32::max);
    Node {
        centre,
        radius,
        normal: mean(normal),
        area: area as f32,
        albedo: mean(albedo),
        parent,
        first_child: 0,
        children: 0,
    }
}

/// Middle of what a patch sees, by its row, and which share of its sight that is.
fn what_is_seen(surfaces: &[Surface], row_start: &[u32], columns: &[u32], values: &[f32]) -> Vec<(Vec3, f32)> {
    let of = |i: usize| {
        let own = row_start[i] as usize..row_start[i + 1] as usize;
        let (mut middle, mut whole) = (Vec3::ZERO, 0.0);
        for (&j, &factor) in columns[own.clone()].iter().zip(&values[own]) {
            middle += surfaces[j as usize].centre * factor;
            whole += factor;
        }
        if whole > 0.0 { (middle / whole, whole) } else { (surfaces[i].centre, 0.0) }
    };
    (0..surfaces.len()).into_par_iter().map(of).collect()
}

/// Brings patches into two halves, across the axis along which they are spread most: of place, direction, the place of what they see, and
/// the share of their sight that meets anything; what is under the sky and what is not have little light in common.
fn halve(surfaces: &[Surface], seen: &[(Vec3, f32)], patches: &mut [u32]) {
    let spread = |of: &dyn Fn(u32) -> Vec3| {
        let wider = |(low, high): (Vec3, Vec3), &patch: &u32| (low.min(of(patch)), high.max(of(patch)));
        let (low, high) = patches.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), wider);
        high - low
    };
    let place = spread(&|patch| surfaces[patch as usize].centre);
    let extent = place.length();
    let turn = spread(&|patch| surfaces[patch as usize].normal) * extent;
    let sight = spread(&|patch| seen[patch as usize].0);
    let cover = spread(&|patch| Vec3::splat(seen[patch as usize].1)).x * COVER * extent;
    let axes = [place.x, place.y, place.z, turn.x, turn.y, turn.z, sight.x, sight.y, sight.z, cover];
    let axis = (0..axes.len()).max_by(|&a, &b| axes[a].total_cmp(&axes[b]).then(b.cmp(&a))).unwrap_or(0);
    let key = |&patch: &u32| match axis / 3 {
        0 => surfaces[patch as usize].centre[axis],
        1 => surfaces[patch as usize].normal[axis - 3],
        2 => seen[patch as usize].0[axis - 6],
        _ => seen[patch as usize].1,
    };
    let middle = patches.len() / 2;
    patches.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
}
