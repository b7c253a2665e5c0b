//! Lightmap of a scene: its place on the meshes, and what each texel takes from a bake.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use bevy::mesh::Mesh as BevyMesh;
use half::f16;
use patches::LightmapTexels;
use patchlight::bake::direct_params;
use patchlight::glam::{Vec2, Vec3, Vec4};
use patchlight::scene::gpu::DirectParams;
use patchlight::scene::sampling::hash3;
use patchlight::scene::{NONE, ReceiverSet as _, SidePolicy, Sides, Sky, find_sides, is_open};
use patchlight::transport::kernel::view::vertices_at;
use patchlight::{Bake, Lighting, Scene, SurfacePoint};
use rayon::prelude::*;

use crate::gather::{MeshParts, Snapshot};

/// Random walks that tell whether light comes to a texel.
const WALKS: u32 = 8;
/// Rows below the atlas that stay dark, for triangles to which no light comes.
const DARK_ROWS: u32 = 2;
/// Texels look for their surface from so many ray offsets above it, and then from farther.
const LIFTS: [f32; 3] = [2.0, 16.0, 128.0];
/// Points whose direct light is found at once.
const BLOCK: usize = 1 << 16;

/// Texels of a scene.
#[derive(Debug)]
pub(crate) struct Layout {
    texels: LightmapTexels,
    /// The receiver of each texel; of those between charts, that of the nearest: drawing reaches beyond the edges of
    /// triangles that are seen at a slant.
    receivers: Vec<u32>,
    /// Texture coordinates of the corners of each mesh, three for each of its triangles.
    uvs: Vec<Vec<[f32; 2]>>,
}

impl Layout {
    /// Lays out the meshes of a snapshot, whose scene this is, with texels of so many metres.
    ///
    /// # Errors
    /// More texels than an atlas has.
    pub fn new(scene: &Scene, snapshot: &Snapshot, texel: f32) -> Result<Self, patches::Error> {
        let lit = find_sides(scene, SidePolicy::Lit);
        let triangles = &scene.geometry.triangles;
        // A mesh has one place for a triangle: that of its front, unless only its back is lit. A front that no surface sees may
        // see the sky.
        let side = |(triangle, lit): (&patchlight::scene::gpu::Triangle, Sides)| {
            let is_back = snapshot.meshes[triangle.object as usize].is_two_sided && lit.back && !lit.front;
            Sides { front: !is_back, back: is_back }
        };
        let sides: Vec<Sides> = triangles.iter().zip(lit).map(side).collect();
        let is_lit = |point: &SurfacePoint| {
            let [x, y, z] = point.position.to_array().map(f32::to_bits);
            is_open(scene, point, WALKS, hash3(x, y, z))
        };
        let texels = LightmapTexels::new(scene, &sides, texel, &is_lit)?;
        let uvs = corner_uvs(scene, snapshot, &sides, &texels);
        let receivers = filled(&texels);
        Ok(Self { texels, receivers, uvs })
    }

    /// Texels of a row, and rows.
    pub fn size(&self) -> (u32, u32) {
        (self.texels.params.width, self.texels.params.height + DARK_ROWS)
    }

    /// Places whose light is asked for.
    pub fn points(&self) -> &[SurfacePoint] {
        self.texels.points()
    }

    /// A mesh of the snapshot with its places in the lightmap as second texture coordinates.
    pub fn lit_mesh(&self, number: usize, mesh: &BevyMesh) -> BevyMesh {
        let mut own = mesh.clone();
        if own.indices().is_some() {
            own.duplicate_vertices();
        }
        own.insert_attribute(BevyMesh::ATTRIBUTE_UV_1, self.uvs[number].clone());
        own
    }

    /// Irradiance at the points as texels of a picture: radiance of a white surface, `E / π`.
    pub fn picture(&self, values: &[Vec3]) -> Vec<u8> {
        let texel = |&receiver: &u32| values.get(receiver as usize).map_or([f16::ZERO; 4], |value| half_texel(*value));
        let texels = self.receivers.par_iter().map(texel);
        let mut bytes: Vec<u8> = texels.flat_map_iter(|texel| texel.into_iter().flat_map(f16::to_le_bytes)).collect();
        let (width, height) = self.size();
        bytes.resize(8 * width as usize * height as usize, 0);
        bytes
    }
}

/// The receivers of all texels: empty ones take that of the nearest.
fn filled(texels: &LightmapTexels) -> Vec<u32> {
    let width = texels.params.width as usize;
    let mut all = texels.texels.clone();
    let mut queue: VecDeque<usize> = (0..all.len()).filter(|&texel| all[texel] != NONE).collect();
    while let Some(texel) = queue.pop_front() {
        for next in beside(texel, width) {
            if all.get(next) == Some(&NONE) {
                all[next] = all[texel];
                queue.push_back(next);
            }
        }
    }
    all
}

/// The four texels beside one; some may lie beyond the picture, or at the other end of a row.
fn beside(texel: usize, width: usize) -> [usize; 4] {
    [texel.wrapping_sub(1), texel + 1, texel.wrapping_sub(width), texel + width]
}

/// Radiance of a white surface with this irradiance, as a texel.
pub(crate) fn half_texel(irradiance: Vec3) -> [f16; 4] {
    let half = |x: f32| f16::from_f32((x * std::f32::consts::FRAC_1_PI).min(f16::MAX.to_f32()));
    [half(irradiance.x), half(irradiance.y), half(irradiance.z), f16::ONE]
}

/// Texture coordinates of the corners of each mesh.
fn corner_uvs(scene: &Scene, snapshot: &Snapshot, sides: &[Sides], texels: &LightmapTexels) -> Vec<Vec<[f32; 2]>> {
    let height = texels.params.height as f32;
    let all = height + DARK_ROWS as f32;
    let dark = [0.5 / texels.params.width as f32, 1.0 - 0.5 / all];
    let in_atlas = |uv: Vec2| [uv.x, uv.y * height / all];
    let mut firsts = Vec::new();
    let mut sum = 0;
    for mesh in &snapshot.meshes {
        firsts.push(sum);
        sum += mesh.indices.len() / 3;
    }
    let mut uvs: Vec<Vec<[f32; 2]>> = snapshot.meshes.iter().map(|mesh| vec![dark; mesh.indices.len()]).collect();
    for (number, triangle) in scene.geometry.triangles.iter().enumerate() {
        let Some(uv) = texels.uv(number as u32, !sides[number].back) else { continue };
        let mesh = triangle.object as usize;
        let first = 3 * (triangle.source as usize - firsts[mesh]);
        let mut corners = [uv.corner, uv.corner_a, uv.corner_b].map(in_atlas);
        if is_swapped(&snapshot.meshes[mesh], first, triangle.edge_a) {
            corners.swap(1, 2);
        }
        uvs[mesh][first..first + 3].copy_from_slice(&corners);
    }
    uvs
}

/// Returns true if a scene has the second and the third corner of a triangle the other way round.
fn is_swapped(mesh: &MeshParts, first: usize, edge_a: Vec3) -> bool {
    let corner = |k: usize| mesh.transform.transform_point3(mesh.positions[mesh.indices[first + k] as usize]);
    let [a, b, c] = [corner(0), corner(1), corner(2)];
    (c - a).distance_squared(edge_a) < (b - a).distance_squared(edge_a)
}

/// What each point takes from the interpolation points of a bake.
#[derive(Debug, Default)]
pub(crate) struct Rows(Vec<([u32; 3], [f32; 3])>);

impl Rows {
    /// Rows of a layout over a bake of its scene.
    pub fn new(layout: &Layout, bake: &Bake) -> Self {
        let mesh = &bake.receivers().interpolation;
        let scene = bake.scene();
        let tables = scene.tables();
        let row = |point: &SurfacePoint| {
            LIFTS.iter().find_map(|lift| {
                let lift = lift * scene.geometry.ray_offset;
                let hit = scene.closest_before(point.position + point.normal * lift, -point.normal, 2.0 * lift);
                if hit.is_miss() {
                    return None;
                }
                let front = tables.normal(hit.triangle).dot(point.normal) > 0.0;
                let (vertices, weights) = vertices_at(&mesh.grids, &mesh.cells, &mesh.vertices, hit, front);
                (vertices.x != NONE).then(|| (vertices.to_array(), weights.to_array()))
            })
        };
        let rows: Vec<_> = layout.points().par_iter().map(row).collect();
        let from = spread(&layout.texels, &rows.iter().map(Option::is_some).collect::<Vec<_>>());
        let none = ([0; 3], [0.0; 3]);
        Self(from.iter().map(|&k| rows.get(k as usize).copied().flatten().unwrap_or(none)).collect())
    }

    /// Irradiance at the points, of that at the interpolation points.
    pub fn gather(&self, values: &[Vec3]) -> Vec<Vec3> {
        let sum = |(vertices, weights): &([u32; 3], [f32; 3])| -> Vec3 {
            vertices.iter().zip(weights).map(|(&k, &weight)| values[k as usize] * weight).sum()
        };
        self.0.par_iter().map(sum).collect()
    }
}

/// For each receiver itself where it has light, else the nearest that has, from texel to texel; [`NONE`] without one.
fn spread(texels: &LightmapTexels, has_light: &[bool]) -> Vec<u32> {
    let mut from: Vec<u32> = (0..).zip(has_light).map(|(k, &has)| if has { k } else { NONE }).collect();
    if !has_light.contains(&false) {
        return from;
    }
    let width = texels.params.width as usize;
    let receiver = |texel: usize| texels.texels.get(texel).copied().unwrap_or(NONE);
    let lit = |texel: &usize| has_light.get(receiver(*texel) as usize).copied().unwrap_or(false);
    let mut queue: VecDeque<usize> = (0..texels.texels.len()).filter(lit).collect();
    while let Some(texel) = queue.pop_front() {
        let own = from[receiver(texel) as usize];
        for next in beside(texel, width) {
            if let Some(place) = from.get_mut(receiver(next) as usize)
                && *place == NONE
            {
                *place = own;
                queue.push_back(next);
            }
        }
    }
    from
}

/// Direct light of surfaces that shine and of the sky at points: it is linear in what they send, so that their rays are
/// traced once.
#[derive(Debug, Default)]
pub(crate) struct Surroundings {
    /// Irradiance by materials that shine with 1 W/m²/sr.
    emission: BTreeMap<usize, Vec<f32>>,
    /// Irradiance by a sky whose radiance is multiplied by 1; the map that it has.
    sky: Option<(Arc<[Vec4]>, Vec<Vec3>)>,
    rays: u32,
}

impl Surroundings {
    /// With so many rays to all emitters and to the sky.
    pub fn with_rays(rays: u32) -> Self {
        Self { rays, ..Self::default() }
    }

    /// Adds the light at points.
    pub fn add(&mut self, scene: &Scene, points: &[SurfacePoint], lighting: &Lighting, values: &mut [Vec3]) {
        for (material, radiance) in lighting.emission.iter().enumerate().filter(|(_, own)| **own != Vec3::ZERO) {
            let rays = self.rays;
            let own = self.emission.entry(material).or_insert_with(|| {
                let mut emission = vec![Vec3::ZERO; lighting.emission.len()];
                emission[material] = Vec3::ONE;
                let unit = Lighting { emission, ..Lighting::default() };
                direct(scene, unit, points, (rays, 0)).iter().map(|irradiance| irradiance.x).collect()
            });
            values.iter_mut().zip(own).for_each(|(sum, share)| *sum += *radiance * *share);
        }
        if lighting.has_sky() {
            if self.sky.as_ref().is_none_or(|(map, _)| map != &lighting.sky_map) {
                let sky = Sky { radiance: Vec3::ONE, ..lighting.sky };
                let unit = Lighting { sky, sky_map: Arc::clone(&lighting.sky_map), ..Lighting::default() };
                self.sky = Some((Arc::clone(&lighting.sky_map), direct(scene, unit, points, (0, self.rays))));
            }
            let (_, own) = self.sky.as_ref().expect("it was made above");
            values.iter_mut().zip(own).for_each(|(sum, share)| *sum += lighting.sky.radiance * *share);
        }
    }
}

/// Direct irradiance at points under a light.
fn direct(scene: &Scene, lighting: Lighting, points: &[SurfacePoint], rays: (u32, u32)) -> Vec<Vec3> {
    let Ok(lit) = Scene::under(Arc::clone(&scene.geometry), lighting) else { return vec![Vec3::ZERO; points.len()] };
    let params = DirectParams { area_rays: rays.0, sky_rays: rays.1, ..direct_params(&lit) };
    let blocks = points.chunks(BLOCK);
    blocks
        .flat_map(|block| lit.direct_irradiance(&DirectParams { count: block.len() as u32, ..params }, block))
        .collect()
}
