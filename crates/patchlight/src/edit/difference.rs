//! What two scenes have in common: triangles by their content, whatever their numbers.

use std::collections::HashMap;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};

use bytemuck::bytes_of;
use scene::gpu::{Triangle, TriangleUv};
use scene::{Geometry, Material, NONE, Scene, texel_count};

/// Steps in which the normals of planes are compared, and ray offsets in which their distances are.
const NORMAL_STEPS: f64 = 1024.0;
const OFFSETS: f64 = 16.0;
/// Two sets of triangles are one surface where areas differ by less than this share, and corners of their boxes by
/// less than so many ray offsets.
const SAME_AREA: f64 = 1e-3;
const SAME_BOX: f32 = 16.0;

/// Difference between the geometries of two scenes.
pub(super) struct Difference {
    /// For each triangle now, the same one before; [`NONE`] where there is none.
    pub same: Vec<u32>,
    /// For each triangle before, true if its surface is gone.
    pub gone: Vec<bool>,
    /// For each triangle now, true if its surface is new.
    pub come: Vec<bool>,
}

impl Difference {
    /// Between two scenes. Emission is of no account.
    pub fn new(before: &Scene, now: &Scene) -> Self {
        let old = Keys::new(&before.geometry, &before.materials);
        let new = Keys::new(&now.geometry, &now.materials);
        let mut known: HashMap<u64, Vec<u32>> = HashMap::new();
        // The first one last, so that it is taken first.
        for (t, key) in old.triangles.iter().enumerate().rev() {
            known.entry(*key).or_default().push(t as u32);
        }
        let same: Vec<u32> =
            new.triangles.iter().map(|key| known.get_mut(key).and_then(Vec::pop).unwrap_or(NONE)).collect();
        let mut gone = vec![true; old.triangles.len()];
        for &t in same.iter().filter(|&&t| t != NONE) {
            gone[t as usize] = false;
        }
        let mut come: Vec<bool> = same.iter().map(|&t| t == NONE).collect();
        // A surface that is cut otherwise is still there.
        let offset = before.geometry.ray_offset;
        let old_planes = planes(&before.geometry, &old.materials, &gone, offset);
        let new_planes = planes(&now.geometry, &new.materials, &come, offset);
        for (plane, surface) in &new_planes {
            if let Some(was) = old_planes.get(plane).filter(|was| was.is_like(surface, offset)) {
                was.triangles.iter().for_each(|&t| gone[t as usize] = false);
                surface.triangles.iter().for_each(|&t| come[t as usize] = false);
            }
        }
        Self { same, gone, come }
    }

    /// Returns true if both have the same triangles in the same order.
    pub fn is_none(&self) -> bool {
        self.gone.len() == self.same.len() && (0u32..).zip(&self.same).all(|(t, same)| t == *same)
    }
}

/// Hashes of what triangles are, and of what their materials are.
struct Keys {
    materials: Vec<u64>,
    triangles: Vec<u64>,
}

impl Keys {
    fn new(geometry: &Geometry, materials: &[Material]) -> Self {
        let texture = |texture: u32| {
            let texture = geometry.textures.get(texture as usize)?;
            let texels = texel_count(texture.width, texture.height, texture.levels);
            let first = 2 * texture.offset as usize;
            Some((texture.width, texture.height, texture.levels, &geometry.texels[first..first + 2 * texels]))
        };
        let hash = |value: &dyn Fn(&mut DefaultHasher)| {
            let mut hasher = DefaultHasher::new();
            value(&mut hasher);
            hasher.finish()
        };
        let textures: Vec<u64> =
            (0..geometry.textures.len()).map(|t| hash(&|hasher| texture(t as u32).hash(hasher))).collect();
        let material = |m: &Material| {
            let names = [m.albedo_texture, m.mask_texture].map(|texture| textures.get(texture as usize).copied());
            let plain =
                Material { albedo_texture: 0, mask_texture: 0, radiance_texture: 0, radiance: glam::Vec3::ZERO, ..*m };
            hash(&|hasher| (names, bytes_of(&plain)).hash(hasher))
        };
        let materials: Vec<u64> = materials.iter().map(material).collect();
        let triangle = |(t, uv): (&Triangle, &TriangleUv)| {
            let plain = Triangle { material: 0, source: 0, object: 0, ..*t };
            hash(&|hasher| (materials[t.material as usize], bytes_of(&plain), bytes_of(uv)).hash(hasher))
        };
        let triangles = geometry.triangles.iter().zip(&geometry.uvs).map(triangle).collect();
        Self { materials, triangles }
    }
}

/// Material, normal and distance of a plane.
type Plane = (u64, [i64; 3], i64);

/// Triangles of one material in one plane.
#[derive(Default)]
struct Surface {
    triangles: Vec<u32>,
    area: f64,
    bounds: Option<(glam::Vec3, glam::Vec3)>,
}

impl Surface {
    fn is_like(&self, other: &Self, offset: f32) -> bool {
        let (Some(own), Some(its)) = (self.bounds, other.bounds) else { return false };
        let near = |a: glam::Vec3, b: glam::Vec3| a.distance(b) <= SAME_BOX * offset;
        (self.area - other.area).abs() <= SAME_AREA * self.area && near(own.0, its.0) && near(own.1, its.1)
    }
}

/// The marked triangles by their planes.
fn planes(geometry: &Geometry, materials: &[u64], marked: &[bool], offset: f32) -> HashMap<Plane, Surface> {
    let mut planes: HashMap<Plane, Surface> = HashMap::new();
    for (t, triangle) in geometry.triangles.iter().enumerate().filter(|(t, _)| marked[*t]) {
        let [corner, a, b] = [triangle.corner, triangle.edge_a, triangle.edge_b].map(|v| v.as_dvec3());
        let normal = a.cross(b).normalize_or_zero();
        let distance = corner.dot(normal) / (OFFSETS * f64::from(offset));
        let steps = (normal * NORMAL_STEPS).round().to_array().map(|x| x as i64);
        let plane = (materials[triangle.material as usize], steps, distance.round() as i64);
        let surface = planes.entry(plane).or_default();
        surface.triangles.push(t as u32);
        surface.area += 0.5 * a.cross(b).length();
        for place in [triangle.corner, triangle.corner + triangle.edge_a, triangle.corner + triangle.edge_b] {
            let (low, high) = surface.bounds.unwrap_or((place, place));
            surface.bounds = Some((low.min(place), high.max(place)));
        }
    }
    planes
}
