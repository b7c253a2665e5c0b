//! Rays against the binary hierarchy. The order is that of obvhs: leaf children are intersected as soon as their box is
//! hit, the farther inner child waits on a stack.

use glam::{Vec2, Vec3, Vec4};

use super::texture;
use crate::gpu::{BvhNode, Hit, Material, NONE, Texture, Triangle, TriangleUv};
use crate::math::{abs, sqrt};

/// Levels of the hierarchy that fit on the traversal stack; the host refuses deeper ones.
pub const STACK_SIZE: usize = 64;

/// A distance beyond every scene: `t_max` of a ray without an end.
pub const FAR: f32 = 1e30;
/// Width of the outline of a triangle, as a share of its edges.
const OUTLINE: f32 = 1.0 / 256.0;

/// The hierarchy of a scene's triangles.
#[derive(Clone, Copy, Debug)]
pub struct Hierarchy<'a> {
    /// Nodes of the binary hierarchy, root first.
    pub nodes: &'a [BvhNode],
    /// Eight-wide hierarchy, where the host has it: rays go through this one then, with the same results.
    #[cfg(feature = "alloc")]
    pub(crate) wide: Option<&'a crate::host::WideBvh>,
    /// That of what moves, whose triangles the other does not have.
    #[cfg(feature = "alloc")]
    pub(crate) moving: Option<&'a crate::host::WideBvh>,
}

impl<'a> From<&'a [BvhNode]> for Hierarchy<'a> {
    /// The binary hierarchy alone.
    #[inline]
    fn from(nodes: &'a [BvhNode]) -> Self {
        Self {
            nodes,
            #[cfg(feature = "alloc")]
            wide: None,
            #[cfg(feature = "alloc")]
            moving: None,
        }
    }
}

/// Tables for rays against a scene.
#[derive(Clone, Copy, Debug)]
pub struct GeometryTables<'a> {
    /// Hierarchy.
    pub hierarchy: Hierarchy<'a>,
    /// Triangles in leaf order.
    pub triangles: &'a [Triangle],
    /// Texture coordinates of each triangle.
    pub uvs: &'a [TriangleUv],
    /// Materials.
    pub materials: &'a [Material],
    /// Pictures.
    pub textures: &'a [Texture],
    /// Texels of all pictures, two words each.
    pub texels: &'a [u32],
}

impl GeometryTables<'_> {
    /// Point of a triangle at the shares (u, v) of its edges.
    #[inline]
    pub fn position(&self, triangle: u32, u: f32, v: f32) -> Vec3 {
        let t = self.triangles[triangle as usize];
        t.corner + t.edge_a * u + t.edge_b * v
    }

    /// Unit normal of the triangle's front.
    #[inline]
    pub fn normal(&self, triangle: u32) -> Vec3 {
        let t = self.triangles[triangle as usize];
        let n = t.edge_a.cross(t.edge_b);
        n * (1.0 / n.length())
    }

    /// Texture coordinate at the shares (u, v).
    #[inline]
    pub fn texture_coordinate(&self, triangle: u32, u: f32, v: f32) -> Vec2 {
        let t = self.uvs[triangle as usize];
        t.corner * (1.0 - u - v) + t.corner_a * u + t.corner_b * v
    }

    /// Reflectance at the shares (u, v), bilinear in level 0.
    #[inline]
    pub fn albedo(&self, triangle: u32, u: f32, v: f32) -> Vec3 {
        self.albedo_at_level(triangle, u, v, 0)
    }

    /// Reflectance at the shares (u, v) from a level of the mip pyramid (clamped to the levels there are).
    #[inline]
    pub fn albedo_at_level(&self, triangle: u32, u: f32, v: f32, level: u32) -> Vec3 {
        let material = self.materials[self.triangles[triangle as usize].material as usize];
        if material.albedo_texture == NONE {
            return material.albedo;
        }
        let t = self.textures[material.albedo_texture as usize];
        texture::sample(t, self.texels, self.texture_coordinate(triangle, u, v), level).truncate()
    }

    /// Reflectance about the shares (u, v), averaged over about `area` m² of the triangle: between the two levels of the
    /// mip pyramid whose texels are nearest to that in size.
    #[inline]
    pub fn albedo_over(&self, triangle: u32, u: f32, v: f32, area: f32) -> Vec3 {
        let t = self.triangles[triangle as usize];
        let material = self.materials[t.material as usize];
        if material.albedo_texture == NONE {
            return material.albedo;
        }
        self.texture_over(material.albedo_texture, triangle, u, v, area).truncate()
    }

    /// A texture about the shares (u, v), averaged over about `area` m² of the triangle, as [`Self::albedo_over`] has it.
    #[inline]
    pub fn texture_over(&self, texture: u32, triangle: u32, u: f32, v: f32, area: f32) -> Vec4 {
        let t = self.triangles[triangle as usize];
        let texture = self.textures[texture as usize];
        let uv = self.uvs[triangle as usize];
        let share = abs((uv.corner_a - uv.corner).perp_dot(uv.corner_b - uv.corner));
        // Texels that the area covers; a level up, a texel is four times as large.
        let mut covered = area * share * (texture.width * texture.height) as f32 / t.edge_a.cross(t.edge_b).length();
        let mut level = 0;
        while covered > 4.0 && level + 1 < texture.levels {
            covered *= 0.25;
            level += 1;
        }
        let at = self.texture_coordinate(triangle, u, v);
        let fine = texture::sample(texture, self.texels, at, level);
        if covered > 1.0 && level + 1 < texture.levels {
            let coarse = texture::sample(texture, self.texels, at, level + 1);
            fine + (coarse - fine) * (sqrt(covered) - 1.0)
        } else {
            fine
        }
    }

    /// Returns true if the triangle mirrors light or lets it through.
    #[inline]
    pub fn is_specular(&self, triangle: u32) -> bool {
        self.materials[self.triangles[triangle as usize].material as usize].is_specular()
    }

    /// Share of the light that the triangle mirrors or lets through, at any angle.
    #[inline]
    pub fn specular_share(&self, triangle: u32) -> Vec3 {
        let material = self.materials[self.triangles[triangle as usize].material as usize];
        material.mirror + material.transmittance
    }

    /// Radiance emitted from the front at the shares (u, v), W/m²/sr.
    #[inline]
    pub fn radiance(&self, triangle: u32, u: f32, v: f32) -> Vec3 {
        let material = self.materials[self.triangles[triangle as usize].material as usize];
        if material.radiance_texture == NONE {
            return material.radiance;
        }
        let t = self.textures[material.radiance_texture as usize];
        material.radiance * texture::sample(t, self.texels, self.texture_coordinate(triangle, u, v), 0).truncate()
    }

    /// Returns true if the triangle has a hole at the shares (u, v).
    #[inline]
    pub fn is_hole(&self, triangle: u32, u: f32, v: f32) -> bool {
        let material = self.materials[self.triangles[triangle as usize].material as usize];
        if material.mask_texture == NONE {
            return false;
        }
        let t = self.textures[material.mask_texture as usize];
        texture::sample(t, self.texels, self.texture_coordinate(triangle, u, v), 0).w < material.mask_cutoff
    }
}

/// 1/x, and a large number of the same sign near 0, so that boxes never see 0·∞.
#[inline]
pub fn safe_inverse(x: f32) -> f32 {
    if x > f32::EPSILON || x < -f32::EPSILON {
        1.0 / x
    } else if x < 0.0 {
        -1.0 / f32::EPSILON
    } else {
        1.0 / f32::EPSILON
    }
}

#[inline]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline]
fn greatest(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Distance at which the ray enters the box (negative from inside), [`FAR`] when it misses or the box lies behind.
#[inline]
fn enter_box(node: &BvhNode, origin: Vec3, inverse: Vec3) -> f32 {
    let a = (node.min - origin) * inverse;
    let b = (node.max - origin) * inverse;
    let near = greatest(greatest(least(a.x, b.x), least(a.y, b.y)), least(a.z, b.z));
    let far = least(least(greatest(a.x, b.x), greatest(a.y, b.y)), greatest(a.z, b.z));
    // Rounding must not lose a flat box that holds an axis-parallel triangle.
    if far * 1.000_001 >= near && far >= 0.0 { near } else { FAR }
}

/// Ray against triangle (Möller and Trumbore 1997), both sides. A miss has `triangle == NONE`.
#[inline]
pub fn intersect_triangle(triangle: &Triangle, index: u32, origin: Vec3, direction: Vec3, t_max: f32) -> Hit {
    let p = direction.cross(triangle.edge_b);
    let determinant = triangle.edge_a.dot(p);
    let mut hit = Hit { triangle: NONE, u: 0.0, v: 0.0, t: f32::INFINITY };
    if determinant == 0.0 {
        return hit;
    }
    let inverse = 1.0 / determinant;
    let s = origin - triangle.corner;
    let u = s.dot(p) * inverse;
    let q = s.cross(triangle.edge_a);
    let v = direction.dot(q) * inverse;
    let t = triangle.edge_b.dot(q) * inverse;
    if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < t_max {
        hit.triangle = index;
        hit.u = u;
        hit.v = v;
        hit.t = t;
    }
    hit
}

/// The leaf's nearest hit in front of `best`, else `best`.
#[inline]
fn intersect_leaf(g: &GeometryTables, node: &BvhNode, origin: Vec3, direction: Vec3, best: Hit) -> Hit {
    let mut best = best;
    for k in node.first_index..node.first_index + node.prim_count {
        let hit = intersect_triangle(&g.triangles[k as usize], k, origin, direction, best.t);
        if hit.triangle != NONE && !g.is_hole(k, hit.u, hit.v) {
            best = hit;
        }
    }
    best
}

/// Nearest surface along `origin + t·direction`, t in (0, t_max), holes passed through.
#[inline]
pub fn closest_hit(g: &GeometryTables, origin: Vec3, direction: Vec3, t_max: f32) -> Hit {
    #[cfg(feature = "alloc")]
    if let Some(wide) = g.hierarchy.wide {
        return crate::host::traverse::<false>(wide, g, origin, direction, t_max);
    }
    traverse(g, origin, direction, t_max, false)
}

/// Returns true if anything is in the way along `origin + t·direction`, t in (0, t_max).
#[inline]
pub fn any_hit(g: &GeometryTables, origin: Vec3, direction: Vec3, t_max: f32) -> bool {
    #[cfg(feature = "alloc")]
    if let Some(wide) = g.hierarchy.wide {
        return crate::host::traverse::<true>(wide, g, origin, direction, t_max).triangle != NONE;
    }
    traverse(g, origin, direction, t_max, true).triangle != NONE
}

/// Returns true if a hit at shares (u, v) of a triangle's edges is not so near to its outline that a ray which touches
/// it there may pass beside the boxes of the hierarchy: only then it may be taken for granted that the hierarchy knows
/// it.
#[inline]
pub fn is_well_inside(u: f32, v: f32) -> bool {
    u >= OUTLINE && v >= OUTLINE && u + v <= 1.0 - OUTLINE
}

/// Returns true if this triangle is in the way along `origin + t·direction`, t in (0, t_max), well inside of its
/// outline; [`NONE`] is not.
#[inline]
fn is_in_the_way(g: &GeometryTables, triangle: u32, origin: Vec3, direction: Vec3, t_max: f32) -> bool {
    if triangle == NONE {
        return false;
    }
    let hit = intersect_triangle(&g.triangles[triangle as usize], triangle, origin, direction, t_max);
    hit.triangle != NONE && is_well_inside(hit.u, hit.v) && !g.is_hole(triangle, hit.u, hit.v)
}

/// A triangle in the way along `origin + t·direction`, t in (0, t_max), or [`NONE`]. What was in the way of a ray like
/// this one (`last`, or [`NONE`]) is asked first.
#[inline]
pub fn occluder(g: &GeometryTables, origin: Vec3, direction: Vec3, t_max: f32, last: u32) -> u32 {
    if is_in_the_way(g, last, origin, direction, t_max) {
        return last;
    }
    traverse(g, origin, direction, t_max, true).triangle
}

/// [`occluder`] on the host, which names what is in the way by its place in the host's hierarchy, if there is one: two
/// such names are asked first.
#[cfg(feature = "alloc")]
#[inline]
pub fn host_occluder(g: &GeometryTables, origin: Vec3, direction: Vec3, t_max: f32, likely: [u32; 2]) -> u32 {
    match g.hierarchy.wide {
        Some(wide) => crate::host::occluder(wide, g, origin, direction, t_max, likely),
        None => occluder(g, origin, direction, t_max, likely[0]),
    }
}

#[inline]
fn traverse(g: &GeometryTables, origin: Vec3, direction: Vec3, t_max: f32, stop_at_any: bool) -> Hit {
    let mut best = Hit { triangle: NONE, u: 0.0, v: 0.0, t: t_max };
    let inverse = Vec3::new(safe_inverse(direction.x), safe_inverse(direction.y), safe_inverse(direction.z));
    let mut stack = [0u32; STACK_SIZE];
    let mut depth = 0usize;
    let nodes = g.hierarchy.nodes;
    let root = nodes[0];
    let mut children = root.first_index;
    let mut active = enter_box(&root, origin, inverse) < t_max;
    if active && root.prim_count > 0 {
        best = intersect_leaf(g, &root, origin, direction, best);
        active = false;
    }
    while active {
        let mut near = nodes[children as usize];
        let mut far = nodes[children as usize + 1];
        let mut near_t = enter_box(&near, origin, inverse);
        let mut far_t = enter_box(&far, origin, inverse);
        if near_t > far_t {
            let node = near;
            near = far;
            far = node;
            let t = near_t;
            near_t = far_t;
            far_t = t;
        }
        let mut go_near = near_t < best.t;
        if go_near && near.prim_count > 0 {
            best = intersect_leaf(g, &near, origin, direction, best);
            go_near = false;
        }
        let mut go_far = far_t < best.t;
        if go_far && far.prim_count > 0 {
            best = intersect_leaf(g, &far, origin, direction, best);
            go_far = false;
        }
        if stop_at_any && best.triangle != NONE {
            active = false;
        } else if go_near {
            children = near.first_index;
            if go_far {
                stack[depth] = far.first_index;
                depth += 1;
            }
        } else if go_far {
            children = far.first_index;
        } else if depth > 0 {
            depth -= 1;
            children = stack[depth];
        } else {
            active = false;
        }
    }
    if best.triangle == NONE {
        best.t = f32::INFINITY;
    }
    best
}
