//! The immutable part of a scene: its tables, the hierarchy, and rays against them.

use alloc::sync::Arc;
use alloc::vec::Vec;
use core::cell::Cell;

use glam::Vec3;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;

use super::hierarchy;
use super::moving::{self, Moving};
use super::scene::SceneParts;
use super::wide::WideBvh;
use crate::Visibility;
use crate::error::Error;
use crate::gpu::*;
use crate::kernel::GeometryTables;
use crate::kernel::bvh::{FAR, Hierarchy, STACK_SIZE, host_occluder};
use crate::kernel::normal::{pack, unpack};

/// Triangles with their hierarchy, materials and textures: what never changes, shared by all
/// that use it.
///
/// Tables of one value a triangle are in the order of the hierarchy's leaves.
#[derive(Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "super::stored::Tables"))]
pub struct Geometry {
    /// Triangles in leaf order, `[n]`.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::table"))]
    pub triangles: Vec<Triangle>,
    /// Texture coordinates and normals, `[n]`.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::table"))]
    pub uvs: Vec<TriangleUv>,
    /// Materials as they were imported; [`Scene::materials`](crate::Scene::materials) has the
    /// emission of the lighting.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::table"))]
    pub materials: Arc<[Material]>,
    /// What pictures show of the first of them beside that.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::table"))]
    pub finishes: Vec<Finish>,
    /// Pictures.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::table"))]
    pub textures: Vec<Texture>,
    /// Texels of all pictures, two words each.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::table"))]
    pub texels: Arc<[u32]>,
    /// Binary hierarchy of the kernels, root first.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::table"))]
    pub nodes: Vec<BvhNode>,
    /// Least and greatest coordinates, m.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub bounds: (Vec3, Vec3),
    /// Distance by which rays start above a surface, m: 2·10⁻⁵ of the bounds' diagonal, or what
    /// [`SceneParts::ray_offset`] says. A few triangles far off do not count: the diagonal is at most
    /// four times that of the box of the triangles' middles without the outermost 2.5 % at either end
    /// of each axis. Never below 2⁻¹⁸ of the greatest coordinate, of which single precision keeps 2⁻²⁴.
    pub ray_offset: f32,
    /// Absorption of the medium between surfaces, 1/m; 0 for air.
    #[cfg_attr(feature = "serde", serde(with = "crate::pod::value"))]
    pub absorption: Vec3,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(super) wide: Arc<WideBvh>,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(super) moving: Option<Moving>,
}

/// Share of the diagonal by which rays start above a surface.
const OFFSET_OF_DIAGONAL: f32 = 2e-5;
/// Least share of the greatest coordinate, whatever else is far off: 2⁻¹⁸, 64 times what rounding may take from it.
const OFFSET_OF_COORDINATE: f32 = 1.0 / (1 << 18) as f32;
/// Share of the triangles that may be far off at either end of an axis.
const OUTERMOST: f32 = 0.025;
/// Fewer triangles than this have no outermost.
const MIN_TRIANGLES: usize = 16;

/// Cosines between the normal of a vertex and that of its triangle: where one is less, the triangle stays flat, and from
/// the other on it is.
const MIN_COSINE: f32 = 0.5;
const FLAT_COSINE: f32 = 0.999_99;

/// The last occluder of a ray, if there has been one.
#[derive(Clone, Copy, Debug)]
pub struct Occluder(pub(crate) u32);

impl Default for Occluder {
    fn default() -> Self {
        Self(NONE)
    }
}

impl Geometry {
    /// Builds the hierarchy and sorts the triangles into its leaf order. The parts are checked;
    /// their lights are left out.
    ///
    /// # Errors
    /// [`Error::HierarchyDepth`] where too many triangles lie on each other.
    pub(super) fn build(mut parts: SceneParts) -> Result<Self, Error> {
        let (nodes, order) = hierarchy::build(&parts.triangles);
        // Each table goes as soon as its sorted copy is there.
        let triangles: Vec<Triangle> = order.iter().map(|&k| parts.triangles[k as usize]).collect();
        parts.triangles = Vec::new();
        let uvs = order.iter().map(|&k| parts.uvs[k as usize]).collect();
        parts.uvs = Vec::new();
        drop(order);
        Self::of_leaves(SceneParts { triangles, uvs, ..parts }, nodes)
    }

    /// Geometry of parts in the order of a hierarchy's leaves.
    ///
    /// # Errors
    /// [`Error::HierarchyDepth`].
    pub(super) fn of_leaves(parts: SceneParts, nodes: Vec<BvhNode>) -> Result<Self, Error> {
        let SceneParts { triangles, uvs, materials, finishes, textures, texels, absorption, .. } = parts;
        let depth = hierarchy::depth(&nodes);
        let too_deep = Error::HierarchyDepth { depth, limit: STACK_SIZE };
        if depth > STACK_SIZE {
            return Err(too_deep);
        }
        let wide = WideBvh::new(&nodes, &triangles, |t| materials[t.material as usize].mask_texture != NONE)
            .ok_or(too_deep)?;
        let (low, high) = bounds(&triangles);
        let ray_offset = parts.ray_offset.unwrap_or_else(|| ray_offset(&triangles, low, high));
        Ok(Self {
            triangles,
            uvs,
            materials: materials.into(),
            finishes,
            textures,
            texels: texels.into(),
            nodes,
            bounds: (low, high),
            ray_offset,
            absorption,
            wide: Arc::new(wide),
            moving: None,
        })
    }

    /// The tables that rays need, as the kernels take them, with the materials as imported.
    pub fn tables(&self) -> GeometryTables<'_> {
        self.tables_with(&self.materials)
    }

    /// [`Geometry::tables`] with other materials, `[materials]`.
    pub(super) fn tables_with<'a>(&'a self, materials: &'a [Material]) -> GeometryTables<'a> {
        GeometryTables {
            hierarchy: Hierarchy::from(&self.nodes[..]),
            triangles: &self.triangles,
            uvs: &self.uvs,
            materials,
            textures: &self.textures,
            texels: &self.texels,
        }
    }

    /// The hierarchy with that of the host: kernels' bodies that run on the host find the same hits sooner with it.
    pub fn hierarchy(&self) -> Hierarchy<'_> {
        let moving = self.moving.as_ref().map(Moving::wide);
        Hierarchy { nodes: &self.nodes, wide: Some(&self.wide), moving }
    }

    /// Length of the bounds' diagonal, m.
    pub fn diagonal(&self) -> f32 {
        (self.bounds.1 - self.bounds.0).length()
    }

    /// Nearest surface along `origin + t·direction`, t in (0, t_max), holes passed through: the same
    /// bits as [`crate::kernel::bvh::closest_hit`] unless two surfaces meet the ray at the same t.
    #[inline]
    pub fn closest_before(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Hit {
        self.traverse::<false>(origin, direction, t_max)
    }

    /// Returns true if anything is in the way along `origin + t·direction`, t in (0, t_max).
    #[inline]
    pub fn occluded(&self, origin: Vec3, direction: Vec3, t_max: f32) -> bool {
        self.traverse::<true>(origin, direction, t_max).triangle != NONE
    }

    /// [`Geometry::occluded`] for rays that follow each other from near by to one light: what was
    /// in the way of the `last` one is asked first.
    #[inline]
    pub fn occluded_again(&self, origin: Vec3, direction: Vec3, t_max: f32, last: &Cell<Occluder>) -> bool {
        let tables = GeometryTables { hierarchy: self.hierarchy(), ..self.tables() };
        let occluder = host_occluder(&tables, origin, direction, t_max, [last.get().0, NONE]);
        if occluder != NONE {
            last.set(Occluder(occluder));
        }
        occluder != NONE
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

    /// Reflectance at a point of a triangle, averaged over about `area` m² of it: from the level
    /// of the texture's pyramid whose texels are nearest to that in size.
    pub fn filtered_albedo(&self, triangle: u32, position: Vec3, area: f32) -> Vec3 {
        filtered_albedo(&self.tables(), triangle, self.shares(triangle, position), area)
    }

    #[inline]
    fn traverse<const ANY: bool>(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Hit {
        let tables = GeometryTables { hierarchy: self.hierarchy(), ..self.tables() };
        moving::traverse::<ANY>(&self.wide, &tables, origin, direction, t_max)
    }
}

impl TriangleUv {
    /// Normals of the corners; `None` for a flat triangle.
    pub fn normals(&self) -> Option<[Vec3; 3]> {
        (self.normal != 0).then(|| [self.normal, self.normal_a, self.normal_b].map(unpack))
    }

    /// Copy with normals of the corners of a triangle, of any length. It stays flat where they are those of the plane,
    /// or no directions, or one is more than 60° off: it then belongs to another surface, and light would leak.
    #[must_use]
    pub fn with_normals(self, triangle: &Triangle, normals: [Vec3; 3]) -> Self {
        let flat = triangle.edge_a.cross(triangle.edge_b).normalize_or_zero();
        let normals = normals.map(Vec3::normalize_or_zero);
        let least = normals.map(|normal| normal.dot(flat)).into_iter().fold(1.0, f32::min);
        let is_smooth = (MIN_COSINE..FLAT_COSINE).contains(&least);
        let [normal, normal_a, normal_b] = if is_smooth { normals.map(pack) } else { [0; 3] };
        Self { normal, normal_a, normal_b, ..self }
    }
}

impl Visibility for Geometry {
    #[inline]
    fn any_hit(&self, origin: Vec3, target: Vec3) -> bool {
        self.occluded(origin, target - origin, 1.0)
    }

    #[inline]
    fn closest(&self, origin: Vec3, direction: Vec3) -> Hit {
        self.closest_before(origin, direction, FAR)
    }
}

/// Least and greatest coordinates of triangles, m.
fn bounds(triangles: &[Triangle]) -> (Vec3, Vec3) {
    let mut low = Vec3::INFINITY;
    let mut high = Vec3::NEG_INFINITY;
    for t in triangles {
        for p in [t.corner, t.corner + t.edge_a, t.corner + t.edge_b] {
            low = low.min(p);
            high = high.max(p);
        }
    }
    (low, high)
}

/// The ray offset of triangles within these bounds, m; see [`Geometry::ray_offset`].
fn ray_offset(triangles: &[Triangle], low: Vec3, high: Vec3) -> f32 {
    let near = 4.0 * middle_box_diagonal(triangles);
    let coordinate = low.abs().max(high.abs()).max_element();
    let whole = OFFSET_OF_DIAGONAL * (high - low).length();
    (OFFSET_OF_DIAGONAL * near).max(OFFSET_OF_COORDINATE * coordinate).min(whole)
}

/// Diagonal of the box of the triangles' middles, without the outermost at either end of each axis, m.
fn middle_box_diagonal(triangles: &[Triangle]) -> f32 {
    let outermost = (triangles.len() as f32 * OUTERMOST).ceil() as usize;
    let last = triangles.len().saturating_sub(1);
    let extent = |axis: usize| {
        let mut middles: Vec<f32> = Vec::with_capacity(triangles.len());
        middles.extend(triangles.iter().map(|t| t.corner[axis] + (t.edge_a[axis] + t.edge_b[axis]) / 3.0));
        middles.sort_unstable_by(f32::total_cmp);
        middles[last.saturating_sub(outermost)] - middles[outermost.min(last)]
    };
    if triangles.len() < MIN_TRIANGLES {
        return f32::INFINITY;
    }
    Vec3::new(extent(0), extent(1), extent(2)).length()
}

/// [`Geometry::filtered_albedo`] at the shares of a triangle's edges.
pub(super) fn filtered_albedo(tables: &GeometryTables, triangle: u32, shares: (f32, f32), area: f32) -> Vec3 {
    let t = tables.triangles[triangle as usize];
    let material = tables.materials[t.material as usize];
    let Some(texture) = tables.textures.get(material.albedo_texture as usize) else {
        return material.albedo;
    };
    let uv = tables.uvs[triangle as usize];
    let share = (uv.corner_a - uv.corner).perp_dot(uv.corner_b - uv.corner).abs();
    let texels = share * texture.width as f32 * texture.height as f32;
    // Texels that the area covers; a level up, a texel is four times as large.
    let mut covered = area * texels / t.edge_a.cross(t.edge_b).length();
    let mut level = 0;
    while covered > 2.0 && level + 1 < texture.levels {
        covered *= 0.25;
        level += 1;
    }
    tables.albedo_at_level(triangle, shares.0, shares.1, level)
}

/// Texels of a picture with its pyramid.
pub fn texel_count(width: u32, height: u32, levels: u32) -> usize {
    (0..levels).map(|k| ((width >> k).max(1) * (height >> k).max(1)) as usize).sum()
}
