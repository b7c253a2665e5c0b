//! A world in memory: patches, their rows, and a tree that merges them.

use alloc::vec::Vec;

use glam::Vec3;
use scene::parallel::*;
use transport::bisect::bisect;
use transport::{Csr, LinearOperator, check_length};

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

/// Weight of ambient occlusion, as so many times the extent of the patches that are to be divided.
const OCCLUSION_WEIGHT: f32 = 3.0;

/// A world in memory. A tree halves the patches by position, normal and what they see, a right angle between normals
/// counting like the extent of those that are to be divided; a node's reflectance and row are the means of its
/// patches', by their areas. When the rows are reciprocal, so are those of all nodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    nodes: Vec<Node>,
    /// Node of each patch.
    node_of: Vec<u32>,
    /// The patches in the order of the leaves, and the run of them in each node.
    order: Vec<u32>,
    runs: Vec<[u32; 2]>,
    area: Vec<f32>,
    factors: Csr,
}

impl Table {
    /// A world of patches and the rows of F between them.
    ///
    /// # Errors
    /// [`transport::Error::Length`] unless there is one row and one column a patch, and what [`Csr::check`] finds;
    /// values are checked by [`super::Local::new`] and by the matrix.
    pub fn new(surfaces: &[Surface], factors: Csr) -> Result<Self, Error> {
        let count = surfaces.len();
        check_length("rows", count, factors.rows)?;
        check_length("columns", count, factors.columns)?;
        factors.check()?;
        let visibility = visibility(surfaces, &factors);
        let mut order: Vec<u32> = (0..count as u32).collect();
        let parts = bisect(&mut order, |part| {
            let node = merged(surfaces, part);
            (node, if part.len() > 1 { halve(surfaces, &visibility, part) } else { 0 })
        });
        let mut nodes: Vec<Node> = parts.iter().map(|part| part.value).collect();
        let mut node_of = vec![NO_NODE; count];
        for (i, part) in parts.iter().enumerate() {
            match part.first_child {
                Some(child) => {
                    nodes[i].first_child = child as u32;
                    nodes[i].children = 2;
                    nodes[child].parent = i as u32;
                    nodes[child + 1].parent = i as u32;
                }
                None => node_of[order[part.range.start] as usize] = i as u32,
            }
        }
        let runs = parts.iter().map(|part| [part.range.start as u32, part.range.end as u32]).collect();
        let area = surfaces.iter().map(|one| one.area).collect();
        Ok(Self { nodes, node_of, order, runs, area, factors })
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
        self.factors.bytes() + (size_of_val(&self.nodes[..]) + size_of_val(&self.runs[..])) as u64
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
            let row = self.factors.row(self.order[first] as usize).map(|(j, f)| (self.node_of[j], f));
            return Ok(Some(row.collect()));
        }
        let mut sums = vec![0.0f64; self.area.len()];
        for &patch in &self.order[first..end] {
            let area = f64::from(self.area[patch as usize]);
            self.factors.row(patch as usize).for_each(|(j, f)| sums[j] += area * f64::from(f));
        }
        let whole: f64 = self.order[first..end].iter().map(|&patch| f64::from(self.area[patch as usize])).sum();
        let entries = sums.par_iter().zip(&self.node_of).filter(|(sum, _)| **sum > 0.0);
        Ok(Some(entries.map(|(sum, &node)| (node, (sum / whole) as f32)).collect()))
    }
}

/// Several patches as one node, without parent and children.
fn merged(surfaces: &[Surface], patches: &[u32]) -> Node {
    let mut centre = [0.0f64; 3];
    let mut normal = [0.0f64; 3];
    let mut albedo = [0.0f64; 3];
    let mut area = 0.0f64;
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
        one.centre.distance(centre) + scene::math::sqrt(one.area / core::f32::consts::PI)
    };
    let radius = patches.iter().map(reach).fold(0.0, f32::max);
    Node {
        centre,
        radius,
        normal: mean(normal),
        area: area as f32,
        albedo: mean(albedo),
        parent: NO_NODE,
        first_child: 0,
        children: 0,
    }
}

/// Visibility of a patch, by its row.
struct Visibility {
    /// Mean visible point, m.
    mean_point: Vec3,
    /// Ambient occlusion: the share of its rays that hit anything.
    occlusion: f32,
}

/// Visibility of each patch.
fn visibility(surfaces: &[Surface], factors: &Csr) -> Vec<Visibility> {
    let of = |i: usize| {
        let mut sum = Vec3::ZERO;
        let mut occlusion = 0.0;
        for (j, factor) in factors.row(i) {
            sum += surfaces[j].centre * factor;
            occlusion += factor;
        }
        if occlusion > 0.0 {
            Visibility { mean_point: sum / occlusion, occlusion }
        } else {
            Visibility { mean_point: surfaces[i].centre, occlusion: 0.0 }
        }
    };
    (0..surfaces.len()).into_par_iter().map(of).collect()
}

/// Brings patches into two halves, across the axis along which they are spread most: of position, normal, mean visible
/// point, and ambient occlusion; what is under the sky and what is not have little light in common. Returns where they
/// are cut.
fn halve(surfaces: &[Surface], visibility: &[Visibility], patches: &mut [u32]) -> usize {
    let spread = |of: &dyn Fn(u32) -> Vec3| {
        let (low, high) = patches.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), &patch| {
            (low.min(of(patch)), high.max(of(patch)))
        });
        high - low
    };
    let position = spread(&|patch| surfaces[patch as usize].centre);
    let extent = position.length();
    let normal = spread(&|patch| surfaces[patch as usize].normal) * extent;
    let seen = spread(&|patch| visibility[patch as usize].mean_point);
    let occlusion = spread(&|patch| Vec3::splat(visibility[patch as usize].occlusion)).x * OCCLUSION_WEIGHT * extent;
    let axes = [position.x, position.y, position.z, normal.x, normal.y, normal.z, seen.x, seen.y, seen.z, occlusion];
    let axis = (0..axes.len()).max_by(|&a, &b| axes[a].total_cmp(&axes[b]).then(b.cmp(&a))).unwrap_or(0);
    let key = |&patch: &u32| match axis / 3 {
        0 => surfaces[patch as usize].centre[axis],
        1 => surfaces[patch as usize].normal[axis - 3],
        2 => visibility[patch as usize].mean_point[axis - 6],
        _ => visibility[patch as usize].occlusion,
    };
    let middle = patches.len() / 2;
    patches.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
    middle
}
