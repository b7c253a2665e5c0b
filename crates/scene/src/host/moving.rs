//! Rigid meshes that move through geometry at rest: a hierarchy of two levels, whose upper one is made anew in each
//! frame.
//!
//! Their triangles stand behind those at rest, and their nodes behind the others' nodes: the kernels' hierarchy has one
//! root more, above what rests and what moves. Each mesh keeps the hierarchy that it was given, with boxes about its
//! place now.

use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;
use core::ops::Range;

use glam::{Affine3A, Vec3};

use super::builder::{Mesh, MeshFault, SceneBuilder, normal_matrix};
use super::geometry::Geometry;
use super::hierarchy;
use super::scene::SceneParts;
use super::wide::WideBvh;
use crate::error::Error;
use crate::gpu::*;
use crate::kernel::GeometryTables;
use crate::kernel::bvh::STACK_SIZE;

/// A rigid mesh before any transform, its triangles in the leaf order of its own hierarchy.
#[derive(Clone, Debug)]
pub struct MovingMesh {
    triangles: Vec<Triangle>,
    uvs: Vec<TriangleUv>,
    /// Root first; a leaf names triangles of the mesh.
    nodes: Vec<BvhNode>,
}

/// What moves, behind what rests.
#[derive(Clone)]
pub(crate) struct Moving {
    meshes: Vec<Arc<MovingMesh>>,
    /// Numbers of the first triangle and of the first node of what moves.
    first_triangle: usize,
    first_node: usize,
    wide: WideBvh,
}

impl Moving {
    pub fn wide(&self) -> &WideBvh {
        &self.wide
    }
}

impl MovingMesh {
    /// The triangles of a mesh, with one of `materials` materials of a scene.
    ///
    /// # Errors
    /// What is wrong with the mesh; one without triangles.
    pub fn new(mesh: &Mesh, materials: usize) -> Result<Self, MeshFault> {
        let parts = SceneParts { materials: vec![Material::default(); materials], ..SceneParts::default() };
        let mut builder = SceneBuilder::of_parts(parts);
        builder.take(mesh, NONE)?;
        let SceneParts { triangles, uvs, .. } = core::mem::take(builder.parts_mut());
        if triangles.is_empty() {
            return Err(MeshFault::Corners { corners: 0 });
        }
        let (nodes, order) = hierarchy::build(&triangles);
        Ok(Self {
            triangles: order.iter().map(|&k| triangles[k as usize]).collect(),
            uvs: order.iter().map(|&k| uvs[k as usize]).collect(),
            nodes,
        })
    }

    /// The triangles, m.
    pub fn triangles(&self) -> &[Triangle] {
        &self.triangles
    }

    /// Texture coordinates and normals of each.
    pub fn uvs(&self) -> &[TriangleUv] {
        &self.uvs
    }

    /// Levels of the hierarchy.
    fn depth(&self) -> usize {
        hierarchy::depth(&self.nodes)
    }
}

/// Moves a triangle, and the normals of its corners.
fn moved(triangle: &Triangle, uv: &TriangleUv, transform: &Affine3A) -> (Triangle, TriangleUv) {
    let moved = Triangle {
        corner: transform.transform_point3(triangle.corner),
        edge_a: transform.transform_vector3(triangle.edge_a),
        edge_b: transform.transform_vector3(triangle.edge_b),
        ..*triangle
    };
    let uv = match uv.normals() {
        Some(normals) => {
            let turned = normal_matrix(transform);
            uv.with_normals(&moved, normals.map(|normal| turned * normal))
        }
        None => *uv,
    };
    (moved, uv)
}

/// The box of two.
fn joined(a: &BvhNode, b: &BvhNode) -> BvhNode {
    BvhNode { min: a.min.min(b.min), max: a.max.max(b.max), ..BvhNode::default() }
}

/// Nodes of all meshes under one root, children numbered from that root on; a leaf names triangles of the geometry.
struct Forest<'a> {
    nodes: Vec<BvhNode>,
    /// Free for the upper level.
    next: u32,
    triangles: &'a [Triangle],
}

impl Forest<'_> {
    /// Puts the nodes of a mesh, whose first triangle has this number, at `place` and behind the others.
    fn add_mesh(&mut self, place: usize, mesh: &MovingMesh, first_triangle: usize) {
        // The root goes to its place, the others behind what is there.
        let first = self.nodes.len() as u32;
        let number = |k: usize| if k == 0 { place } else { first as usize + k - 1 };
        self.nodes.resize(first as usize + mesh.nodes.len() - 1, BvhNode::default());
        for (k, node) in mesh.nodes.iter().enumerate() {
            let first_index = match node.prim_count {
                0 => first + node.first_index - 1,
                _ => node.first_index + first_triangle as u32,
            };
            self.nodes[number(k)] = BvhNode { first_index, ..*node };
        }
        self.refit(place);
    }

    /// Boxes from the triangles up.
    fn refit(&mut self, place: usize) {
        let mut order = vec![place];
        let mut at = 0;
        while let Some(&place) = order.get(at) {
            let node = self.nodes[place];
            if node.prim_count == 0 {
                order.extend([node.first_index as usize, node.first_index as usize + 1]);
            }
            at += 1;
        }
        for place in order.into_iter().rev() {
            let node = self.nodes[place];
            let first = node.first_index as usize;
            let bounds = match node.prim_count {
                0 => joined(&self.nodes[first], &self.nodes[first + 1]),
                count => {
                    let mut bounds = BvhNode { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY, ..BvhNode::default() };
                    for t in &self.triangles[first..first + count as usize] {
                        for p in [t.corner, t.corner + t.edge_a, t.corner + t.edge_b] {
                            bounds.min = bounds.min.min(p);
                            bounds.max = bounds.max.max(p);
                        }
                    }
                    bounds
                }
            };
            self.nodes[place] = BvhNode { min: bounds.min, max: bounds.max, ..node };
        }
    }

    /// Puts meshes under the node at `place`, halved along the longest axis of their middles.
    fn add(&mut self, place: usize, meshes: &mut [(Vec3, usize, &MovingMesh)]) {
        if let [(_, first_triangle, mesh)] = *meshes {
            return self.add_mesh(place, mesh, first_triangle);
        }
        let low = meshes.iter().fold(Vec3::INFINITY, |low, mesh| low.min(mesh.0));
        let high = meshes.iter().fold(Vec3::NEG_INFINITY, |high, mesh| high.max(mesh.0));
        let axis = (high - low).max_position();
        meshes.sort_by(|a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
        let pair = self.next;
        self.next += 2;
        let (left, right) = meshes.split_at_mut(meshes.len() / 2);
        self.add(pair as usize, left);
        self.add(pair as usize + 1, right);
        let bounds = joined(&self.nodes[pair as usize], &self.nodes[pair as usize + 1]);
        self.nodes[place] = BvhNode { first_index: pair, ..bounds };
    }
}

impl Geometry {
    /// A copy with rigid meshes that can be moved: [`Self::place`]. Each stands as its transform says. What moved in
    /// this one is not in the copy.
    ///
    /// # Errors
    /// [`Error::HierarchyDepth`].
    pub fn with_moving(&self, meshes: &[Arc<MovingMesh>], transforms: &[Affine3A]) -> Result<Self, Error> {
        let resting = self.resting();
        let first_triangle = resting.len();
        let first_node = self.moving.as_ref().map_or(self.nodes.len(), |moving| moving.first_node);
        let count: usize = meshes.iter().map(|mesh| mesh.triangles.len()).sum();
        let node_count: usize = meshes.iter().map(|mesh| mesh.nodes.len() - 1).sum();
        let mut triangles = Vec::with_capacity(first_triangle + count);
        triangles.extend_from_slice(&self.triangles[resting.clone()]);
        let mut uvs = Vec::with_capacity(first_triangle + count);
        uvs.extend_from_slice(&self.uvs[resting]);
        let mut nodes = Vec::with_capacity(first_node + 2 * meshes.len() + node_count);
        nodes.extend_from_slice(&self.nodes[..first_node]);
        if let Some(moving) = &self.moving {
            // Its root is the first of the pair under the root above both.
            nodes[0] = self.nodes[moving.first_node];
        }
        if meshes.is_empty() {
            return Ok(Self { triangles, uvs, nodes, moving: None, ..self.clone_tables() });
        }
        let upper = usize::BITS as usize - meshes.len().leading_zeros() as usize + 1;
        let of_meshes = upper + meshes.iter().map(|mesh| mesh.depth()).max().unwrap_or(0);
        let depth = 1 + hierarchy::depth(&nodes).max(of_meshes);
        if depth > STACK_SIZE {
            return Err(Error::HierarchyDepth { depth, limit: STACK_SIZE });
        }
        for mesh in meshes {
            triangles.extend_from_slice(&mesh.triangles);
            uvs.extend_from_slice(&mesh.uvs);
        }
        let wide = WideBvh::default();
        let moving = Moving { meshes: meshes.to_vec(), first_triangle, first_node, wide };
        let mut made = Self { triangles, uvs, nodes, moving: Some(moving), ..self.clone_tables() };
        made.place(transforms)?;
        Ok(made)
    }

    /// Places the meshes that move, in the order in which they were given.
    ///
    /// # Errors
    /// [`Error::TableLength`] unless there is one transform a mesh.
    pub fn place(&mut self, transforms: &[Affine3A]) -> Result<(), Error> {
        let Some(moving) = &mut self.moving else { return Ok(()) };
        let expected = moving.meshes.len();
        if transforms.len() != expected {
            return Err(Error::TableLength { name: "transforms", expected, found: transforms.len() });
        }
        let mut entries = Vec::with_capacity(expected);
        let mut first = moving.first_triangle;
        for (mesh, transform) in moving.meshes.iter().zip(transforms) {
            let mut low = Vec3::INFINITY;
            let mut high = Vec3::NEG_INFINITY;
            for (k, (triangle, uv)) in mesh.triangles.iter().zip(&mesh.uvs).enumerate() {
                let (triangle, uv) = moved(triangle, uv, transform);
                for p in [triangle.corner, triangle.corner + triangle.edge_a, triangle.corner + triangle.edge_b] {
                    low = low.min(p);
                    high = high.max(p);
                }
                self.triangles[first + k] = triangle;
                self.uvs[first + k] = uv;
            }
            entries.push((0.5 * (low + high), first, &**mesh));
            first += mesh.triangles.len();
        }
        // A pair less than there are meshes, and the root.
        let upper = vec![BvhNode::default(); 2 * expected - 1];
        let mut forest = Forest { nodes: upper, next: 1, triangles: &self.triangles };
        forest.add(0, &mut entries);
        let nodes = forest.nodes;
        let materials = &self.materials;
        let masked = |t: &Triangle| materials[t.material as usize].mask_texture != NONE;
        let too_deep = Error::HierarchyDepth { depth: hierarchy::depth(&nodes), limit: STACK_SIZE };
        moving.wide = WideBvh::new(&nodes, &self.triangles, masked).ok_or(too_deep)?;
        // Under the root above both: what rests, then what moves.
        let pair = moving.first_node;
        let resting = if self.nodes.len() > pair { self.nodes[pair] } else { self.nodes[0] };
        self.nodes.truncate(pair);
        self.nodes[0] = BvhNode { first_index: pair as u32, ..joined(&resting, &nodes[0]) };
        self.nodes.push(resting);
        self.nodes.extend(nodes.into_iter().map(|node| match node.prim_count {
            0 => BvhNode { first_index: node.first_index + pair as u32 + 1, ..node },
            _ => node,
        }));
        Ok(())
    }

    /// Triangles at rest.
    pub fn resting(&self) -> Range<usize> {
        0..self.moving.as_ref().map_or(self.triangles.len(), |moving| moving.first_triangle)
    }

    /// Triangles that move.
    pub fn moving(&self) -> Range<usize> {
        self.resting().end..self.triangles.len()
    }

    /// Nodes that [`Self::place`] changes: the root, and these.
    pub fn moving_nodes(&self) -> Range<usize> {
        self.moving.as_ref().map_or(self.nodes.len(), |moving| moving.first_node)..self.nodes.len()
    }

    /// Nearest surface of what moves along `origin + t·direction`, t in (0, t_max).
    #[inline]
    pub fn closest_moving(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Hit {
        let Some(moving) = &self.moving else {
            return Hit { triangle: NONE, u: 0.0, v: 0.0, t: f32::INFINITY };
        };
        let tables = self.tables();
        moving.wide.traverse::<false>(origin, direction, t_max, |triangle, u, v| tables.is_hole(triangle, u, v))
    }

    /// Copy without triangles and nodes.
    fn clone_tables(&self) -> Self {
        Self {
            triangles: Vec::new(),
            uvs: Vec::new(),
            nodes: Vec::new(),
            moving: None,
            materials: Arc::clone(&self.materials),
            finishes: self.finishes.clone(),
            textures: self.textures.clone(),
            texels: Arc::clone(&self.texels),
            wide: Arc::clone(&self.wide),
            bounds: self.bounds,
            ray_offset: self.ray_offset,
            absorption: self.absorption,
        }
    }
}

/// Nearest surface of what rests and of what moves, or any one when `ANY`.
#[inline]
pub(crate) fn traverse<const ANY: bool>(
    wide: &WideBvh,
    g: &GeometryTables,
    origin: Vec3,
    direction: Vec3,
    t_max: f32,
) -> Hit {
    let is_hole = |triangle, u, v| g.is_hole(triangle, u, v);
    let resting = wide.traverse::<ANY>(origin, direction, t_max, is_hole);
    let Some(moving) = g.hierarchy.moving else { return resting };
    if ANY && resting.triangle != NONE {
        return resting;
    }
    let t_max = if resting.triangle == NONE { t_max } else { resting.t };
    let nearer = moving.traverse::<ANY>(origin, direction, t_max, is_hole);
    if nearer.triangle == NONE { resting } else { nearer }
}

/// Name of something in the way, whether it rests or moves; two that are likely are asked first.
#[inline]
pub(crate) fn occluder(
    wide: &WideBvh,
    g: &GeometryTables,
    origin: Vec3,
    direction: Vec3,
    t_max: f32,
    likely: [u32; 2],
) -> u32 {
    let is_hole = |triangle, u, v| g.is_hole(triangle, u, v);
    let resting = wide.occluder(origin, direction, t_max, is_hole, likely);
    let Some(moving) = g.hierarchy.moving.filter(|_| resting == NONE) else { return resting };
    // Names of what moves follow those of what rests.
    let first = wide.packets() as u32;
    let own = likely.map(|name| if name == NONE { NONE } else { name.wrapping_sub(first) });
    match moving.occluder(origin, direction, t_max, is_hole, own) {
        NONE => NONE,
        name => first + name,
    }
}
