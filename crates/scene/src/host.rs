//! The scene on the host: tables, the hierarchy (built by obvhs), fast rays.

use std::cell::Cell;
use std::vec::Vec;

use glam::{Vec3, Vec4};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::leaf_collapser::collapse;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::PlocBuilder;
use rayon::prelude::*;

use crate::Visibility;
use crate::error::Error;
use crate::kernel::Geometry;
use crate::kernel::bvh::{FAR, STACK_SIZE};
use crate::kernel::light::{Lights, direct_irradiance};
use crate::math::luminance;
use crate::types::*;

pub mod clip;
mod receivers;
mod sides;
mod wide;

pub use receivers::ReceiverSet;
pub use sides::{POINT_WALKS, SidePolicy, Sides, find_sides, is_open};
use wide::WideBvh;

/// What a scene is made of: the input of [`Scene::new`].
#[derive(Clone, Debug, Default)]
pub struct SceneParts {
    /// Triangles in any order, `[n]`, m.
    pub triangles: Vec<Triangle>,
    /// Texture coordinates, `[n]`.
    pub uvs: Vec<TriangleUv>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Pictures.
    pub textures: Vec<Texture>,
    /// Texels of all pictures, two words each.
    pub texels: Vec<u32>,
    /// Lights that are not geometry.
    pub lights: Vec<Light>,
    /// The sky.
    pub sky: Sky,
    /// Its map, `map_width · map_height` texels.
    pub sky_map: Vec<Vec4>,
}

/// A scene ready for rays: tables in the order of the hierarchy's leaves, the hierarchy, and the emitters.
#[derive(Clone)]
pub struct Scene {
    /// Triangles in leaf order, `[n]`.
    pub triangles: Vec<Triangle>,
    /// Texture coordinates, `[n]`.
    pub uvs: Vec<TriangleUv>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Pictures.
    pub textures: Vec<Texture>,
    /// Texels of all pictures, two words each.
    pub texels: Vec<u32>,
    /// Binary hierarchy of the kernels, root first.
    pub nodes: Vec<BvhNode>,
    /// Lights that are not geometry; they may change at any time.
    pub lights: Vec<Light>,
    /// Emissive triangles with their cumulative distribution.
    pub emitters: Vec<Emitter>,
    /// The sky.
    pub sky: Sky,
    /// Its map.
    pub sky_map: Vec<Vec4>,
    /// Least and greatest coordinates, m.
    pub bounds: (Vec3, Vec3),
    /// Distance by which rays start above a surface: 2·10⁻⁵ of the bounds' diagonal, m.
    pub ray_offset: f32,
    wide: WideBvh,
}

/// What was in the way of a ray, if anything has been yet.
#[derive(Clone, Copy, Debug)]
pub struct Occluder(u32);

impl Default for Occluder {
    fn default() -> Self {
        Self(NONE)
    }
}

impl Scene {
    /// Checks the parts, builds the hierarchy and sorts the triangles into its leaf order.
    ///
    /// # Errors
    /// Names the triangle or material that is wrong: [`Error`].
    pub fn new(mut parts: SceneParts) -> Result<Self, Error> {
        check(&parts)?;
        let boxes: Vec<_> = parts
            .triangles
            .iter()
            .map(|t| obvhs::triangle::Triangle {
                v0: t.corner.into(),
                v1: (t.corner + t.edge_a).into(),
                v2: (t.corner + t.edge_b).into(),
            })
            .collect();
        let binary = build(&boxes);
        // What is no longer needed goes at once: a scene of 5 million triangles would take 1 GB more while it is built.
        drop(boxes);
        let Bvh2 { nodes, primitive_indices: order, .. } = binary;
        let nodes: Vec<BvhNode> = bytemuck::cast_slice(&nodes).to_vec();
        let depth = depth(&nodes);
        if depth > STACK_SIZE {
            return Err(Error::HierarchyDepth { depth, limit: STACK_SIZE });
        }
        let triangles: Vec<Triangle> = order.iter().map(|&k| parts.triangles[k as usize]).collect();
        parts.triangles = Vec::new();
        let uvs = order.iter().map(|&k| parts.uvs[k as usize]).collect();
        parts.uvs = Vec::new();
        drop(order);
        let masked = |t: &Triangle| parts.materials[t.material as usize].mask_texture != NONE;
        let wide =
            WideBvh::new(&nodes, &triangles, masked).ok_or(Error::HierarchyDepth { depth, limit: STACK_SIZE })?;

        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for t in &triangles {
            for p in [t.corner, t.corner + t.edge_a, t.corner + t.edge_b] {
                low = low.min(p);
                high = high.max(p);
            }
        }
        let mut scene = Self {
            triangles,
            uvs,
            materials: parts.materials,
            textures: parts.textures,
            texels: parts.texels,
            nodes,
            lights: parts.lights,
            emitters: Vec::new(),
            sky: parts.sky,
            sky_map: parts.sky_map,
            bounds: (low, high),
            ray_offset: 2e-5 * (high - low).length(),
            wide,
        };
        scene.emitters = scene.collect_emitters();
        Ok(scene)
    }

    /// The tables that rays need, as the kernels take them.
    pub fn geometry(&self) -> Geometry<'_> {
        Geometry {
            nodes: &self.nodes,
            triangles: &self.triangles,
            uvs: &self.uvs,
            materials: &self.materials,
            textures: &self.textures,
            texels: &self.texels,
        }
    }

    /// Everything that shines, as the kernels take it.
    pub fn all_lights(&self) -> Lights<'_> {
        Lights { lights: &self.lights, emitters: &self.emitters, sky: self.sky, sky_map: &self.sky_map }
    }

    /// Length of the bounds' diagonal, m.
    pub fn diagonal(&self) -> f32 {
        (self.bounds.1 - self.bounds.0).length()
    }

    /// Whether the sky sends any light.
    pub fn has_sky(&self) -> bool {
        luminance(self.sky.radiance) > 0.0
    }

    /// Nearest surface along `origin + t·direction`, t in (0, t_max), holes passed through: the same bits as
    /// [`crate::kernel::bvh::closest_hit`] unless two surfaces meet the ray at the same t.
    #[inline]
    pub fn closest_before(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Hit {
        self.traverse::<false>(origin, direction, t_max)
    }

    /// Whether anything is in the way along `origin + t·direction`, t in (0, t_max).
    #[inline]
    pub fn occluded(&self, origin: Vec3, direction: Vec3, t_max: f32) -> bool {
        self.traverse::<true>(origin, direction, t_max).triangle != NONE
    }

    /// [`Scene::occluded`] for rays that follow each other from near by to one light: what was in the way of the `last` one is
    /// asked first.
    #[inline]
    pub fn occluded_again(&self, origin: Vec3, direction: Vec3, t_max: f32, last: &Cell<Occluder>) -> bool {
        let geometry = self.geometry();
        let is_hole = |triangle, u, v| geometry.is_hole(triangle, u, v);
        let Occluder(mut packet) = last.get();
        let is_occluded = self.wide.occluded_again(origin, direction, t_max, is_hole, &mut packet);
        last.set(Occluder(packet));
        is_occluded
    }

    /// Longest edge of a triangle, m.
    pub fn longest_edge(&self, triangle: u32) -> f32 {
        let t = &self.triangles[triangle as usize];
        t.edge_a.length().max(t.edge_b.length()).max((t.edge_b - t.edge_a).length())
    }

    /// Shares (u, v) of a triangle's edges at a point of its plane, m.
    pub fn shares(&self, triangle: u32, position: Vec3) -> (f32, f32) {
        let t = self.triangles[triangle as usize];
        let p = position - t.corner;
        let normal = t.edge_a.cross(t.edge_b);
        let inverse = 1.0 / normal.length_squared();
        (p.cross(t.edge_b).dot(normal) * inverse, t.edge_a.cross(p).dot(normal) * inverse)
    }

    /// Reflectance at a point of a triangle, averaged over about `area` m² of it: from the level of the texture's pyramid
    /// whose texels are nearest to that in size.
    pub fn filtered_albedo(&self, triangle: u32, position: Vec3, area: f32) -> Vec3 {
        let t = self.triangles[triangle as usize];
        let material = self.materials[t.material as usize];
        let Some(texture) = self.textures.get(material.albedo_texture as usize) else { return material.albedo };
        let uv = self.uvs[triangle as usize];
        let share = (uv.corner_a - uv.corner).perp_dot(uv.corner_b - uv.corner).abs();
        let texels = share * texture.width as f32 * texture.height as f32;
        // Texels that the area covers; a level up, a texel is four times as large.
        let mut covered = area * texels / t.edge_a.cross(t.edge_b).length();
        let mut level = 0;
        while covered > 2.0 && level + 1 < texture.levels {
            covered *= 0.25;
            level += 1;
        }
        let (u, v) = self.shares(triangle, position);
        self.geometry().albedo_at_level(triangle, u, v, level)
    }

    #[inline]
    fn traverse<const ANY: bool>(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Hit {
        let geometry = self.geometry();
        self.wide.traverse::<ANY>(origin, direction, t_max, |triangle, u, v| geometry.is_hole(triangle, u, v))
    }

    /// Direct irradiance at many points, W/m², on all cores: [`direct_irradiance`] with this scene's rays.
    pub fn direct_irradiance(&self, p: &DirectParams, points: &[SurfacePoint]) -> Vec<Vec3> {
        let (geometry, lights) = (self.geometry(), self.all_lights());
        let occluded = |origin: Vec3, direction: Vec3, t_max: f32| self.occluded(origin, direction, t_max);
        points
            .par_iter()
            .enumerate()
            .map(|(k, point)| direct_irradiance(&geometry, p, p.first + k as u32, *point, &lights, occluded))
            .collect()
    }

    fn collect_emitters(&self) -> Vec<Emitter> {
        let geometry = self.geometry();
        let mut emitters: Vec<Emitter> = Vec::new();
        let mut total = 0.0f64;
        for (index, t) in self.triangles.iter().enumerate() {
            let area = 0.5 * t.edge_a.cross(t.edge_b).length();
            // Textured emission: the mean over a grid of the triangle decides how often it is picked.
            let steps = if self.materials[t.material as usize].radiance_texture == NONE { 1 } else { 8 };
            let mut mean = 0.0;
            for a in 0..steps {
                for b in 0..steps {
                    let u = ((a as f32 + 0.5) / steps as f32, (b as f32 + 0.5) / steps as f32);
                    let (u, v) = crate::sampling::uniform_triangle(u);
                    mean += luminance(geometry.radiance(index as u32, u, v)) / (steps * steps) as f32;
                }
            }
            let power = f64::from(area) * f64::from(mean);
            if power > 0.0 {
                total += power;
                emitters.push(Emitter { triangle: index as u32, cumulative: 0.0, probability: power as f32, area });
            }
        }
        let mut sum = 0.0f64;
        for e in &mut emitters {
            e.probability = (f64::from(e.probability) / total) as f32;
            sum += f64::from(e.probability);
            e.cumulative = sum as f32;
        }
        if let Some(last) = emitters.last_mut() {
            last.cumulative = 1.0;
        }
        emitters
    }
}

impl Visibility for Scene {
    #[inline]
    fn any_hit(&self, origin: Vec3, target: Vec3) -> bool {
        self.occluded(origin, target - origin, 1.0)
    }

    #[inline]
    fn closest(&self, origin: Vec3, direction: Vec3) -> Hit {
        self.closest_before(origin, direction, FAR)
    }
}

fn check(parts: &SceneParts) -> Result<(), Error> {
    let count = parts.triangles.len();
    if count == 0 {
        return Err(Error::NoTriangles);
    }
    if parts.uvs.len() != count {
        return Err(Error::TableLength { name: "uvs", expected: count, found: parts.uvs.len() });
    }
    let texels: usize = parts.textures.iter().map(|t| texel_count(t.width, t.height, t.levels)).sum();
    if parts.texels.len() < 2 * texels {
        return Err(Error::TableLength { name: "texels", expected: 2 * texels, found: parts.texels.len() });
    }
    let map = parts.sky.map_width as usize * parts.sky.map_height as usize;
    if parts.sky_map.len() != map {
        return Err(Error::TableLength { name: "sky_map", expected: map, found: parts.sky_map.len() });
    }
    for (triangle, t) in parts.triangles.iter().enumerate() {
        if t.material as usize >= parts.materials.len() {
            return Err(Error::MaterialIndex { triangle, material: t.material, count: parts.materials.len() });
        }
        if !(t.corner.is_finite() && t.edge_a.is_finite() && t.edge_b.is_finite()) {
            return Err(Error::NotFinite { triangle });
        }
    }
    for (material, m) in parts.materials.iter().enumerate() {
        for texture in [m.albedo_texture, m.radiance_texture, m.mask_texture] {
            if texture != NONE && texture as usize >= parts.textures.len() {
                return Err(Error::TextureIndex { material, texture, count: parts.textures.len() });
            }
        }
    }
    Ok(())
}

/// Texels of a picture with its pyramid.
pub fn texel_count(width: u32, height: u32, levels: u32) -> usize {
    (0..levels).map(|k| ((width >> k).max(1) * (height >> k).max(1)) as usize).sum()
}

/// Passes of PLOC that look for partners in a small neighbourhood only: none. Scenes of regular parts have many boxes at one place of
/// the space-filling curve, and pairs that such passes make badly stay: with 3 passes, as obvhs has it, rays in the procedural scenes
/// take 2 to 4 times as long.
const SEARCH_DEPTH: usize = 0;

/// A binary hierarchy whose leaves fill packets of four.
fn build(boxes: &[obvhs::triangle::Triangle]) -> Bvh2 {
    let settings = BvhBuildParams::medium_build();
    let mut optimizer = ReinsertionOptimizer::default();
    let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
        settings.ploc_search_distance,
        boxes,
        (0..boxes.len() as u32).collect(),
        settings.sort_precision,
        SEARCH_DEPTH,
    );
    optimizer.run(&mut binary, settings.reinsertion_batch_ratio, None);
    collapse(&mut binary, 4, settings.collapse_traversal_cost);
    let ratio = settings.reinsertion_batch_ratio * settings.post_collapse_reinsertion_batch_ratio_multiplier;
    optimizer.run(&mut binary, ratio, None);
    binary
}

fn depth(nodes: &[BvhNode]) -> usize {
    let (mut stack, mut deepest) = (std::vec![(0u32, 1usize)], 0);
    while let Some((k, level)) = stack.pop() {
        deepest = deepest.max(level);
        let node = &nodes[k as usize];
        if node.prim_count == 0 {
            stack.push((node.first_index, level + 1));
            stack.push((node.first_index + 1, level + 1));
        }
    }
    deepest
}

impl Camera {
    /// A pinhole at `eye` that looks at `target`.
    pub fn look_at(eye: Vec3, target: Vec3, up: Vec3, vertical_fov_degrees: f32, width: u32, height: u32) -> Self {
        let forward = (target - eye).normalize();
        let right = forward.cross(up).normalize();
        let half = crate::math::tan(0.5 * vertical_fov_degrees.to_radians());
        Self {
            eye,
            width,
            forward,
            height,
            right: right * (half * width as f32 / height as f32),
            reserved_a: 0,
            up: right.cross(forward) * half,
            reserved_b: 0,
        }
    }
}

const _: () = assert!(size_of::<obvhs::bvh2::node::Bvh2Node>() == size_of::<BvhNode>());
