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

/// A world in memory. A tree halves the patches by place and direction, a right turn of the normal counting like the extent of those that are
/// to be divided; a node's reflectance and row are the means of its patches', by their areas. When the rows are
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
                halve(surfaces, &mut order[first..end]);
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

/// Brings patches into two halves, across the axis of place or direction along which they are spread most.
fn halve(surfaces: &[Surface], patches: &mut [u32]) {
    let spread = |of: &dyn Fn(&Surface) -> Vec3| {
        let bounds = |(low, high): (Vec3, Vec3), patch: &u32| {
            let x = of(&surfaces[*patch as usize]);
            (low.min(x), high.max(x))
        };
        let (low, high) = patches.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), bounds);
        high - low
    };
    let (place, turn) = (spread(&|one| one.centre), spread(&|one| one.normal));
    let extent = place.length();
    let axes = [place.x, place.y, place.z, turn.x * extent, turn.y * extent, turn.z * extent];
    let axis = (0..6).max_by(|&a, &b| axes[a].total_cmp(&axes[b]).then(b.cmp(&a))).unwrap_or(0);
    let key = |patch: &u32| {
        let one = &surfaces[*patch as usize];
        if axis < 3 { one.centre[axis] } else { one.normal[axis - 3] }
    };
    let middle = patches.len() / 2;
    patches.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
}
