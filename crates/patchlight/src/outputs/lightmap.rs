//! A lightmap on the triangles of a scene as it was before its bake.

use std::collections::VecDeque;
use std::sync::{Arc, Weak};

use glam::{Vec2, Vec3};
use patches::LightmapTexels;
use rayon::prelude::*;
use scene::gpu::{Triangle, TriangleUv};
use scene::sampling::{hammersley, hash3, uniform_triangle};
use scene::{
    Lighting, Material, NONE, POINT_WALKS, ReceiverSet as _, Scene, SceneParts, SidePolicy, Sides, SurfacePoint,
    find_sides, is_inside, is_open,
};
use transport::kernel::view::vertices_at;

use super::{LightPart, Surroundings, add_at_taps};
use crate::bake::{Bake, ReceiverKind};
use crate::error::{Error, Reason};
use crate::light::LightField;

/// Texels look for the bake's surface from so many ray offsets above it, and then from farther.
const LIFTS: [f32; 3] = [2.0, 16.0, 128.0];
/// Places of a triangle that tell which side of it has light.
const SIDE_SAMPLES: u32 = 16;
/// A point that looks away is as good as one that is three times as far.
const FACING: f32 = 4.0;
/// Cosine between normals of the same surface.
const PARALLEL: f32 = 0.99;
/// Rays from a texel to each material that shines, and to the sky.
const RAYS: u32 = 64;

/// A lightmap that follows a light field from update to update, and from bake to bake of the same scene. Its charts lie
/// on the triangles of the scene that an engine draws; those of a bake are cut where something stands on them. Each
/// texel takes its indirect light from three interpolation points of the bake, which a short ray finds once for each
/// bake. Texels to which light comes but none of the bake's receivers take the nearest of the others.
///
/// An update costs three reads and additions a texel, and shadow rays to lights for [`LightPart::Full`].
pub struct LiveLightmap {
    scene: Scene,
    texels: LightmapTexels,
    /// The receiver of each texel.
    shown: Vec<u32>,
    bake: Weak<Bake>,
    rows: Vec<LightmapRow>,
    surroundings: Surroundings,
}

/// Interpolation points of a bake from which a receiver takes its light, and their weights.
pub type LightmapRow = ([u32; 3], [f32; 3]);

impl LiveLightmap {
    /// Lays out the sides of a scene to which light comes, with square texels of `texel` m.
    ///
    /// # Errors
    /// A texel that is not positive; more texels than an atlas has.
    pub fn new(scene: &Scene, texel: f32) -> Result<Self, Error> {
        Self::of_sides(scene, &find_sides(scene, SidePolicy::Lit), texel)
    }

    /// Lays out these sides, one entry a triangle: for meshes that have one place for both sides of a triangle, or are
    /// drawn from one.
    ///
    /// # Errors
    /// As [`Self::new`]; a wrong number of sides.
    pub fn of_sides(scene: &Scene, sides: &[Sides], texel: f32) -> Result<Self, Error> {
        Self::laid_out(scene, sides, texel, &|point| is_open_point(scene, point))
    }

    /// Lays out triangles, the corners of each in m, counter-clockwise from the front, on the surfaces of a bake: for
    /// an engine that has its geometry and a bake from a file. A triangle has its front's light, or its back's where only
    /// that has any. Triangles that the bake does not know have no chart.
    ///
    /// # Errors
    /// As [`Self::new`]; corners that are no numbers; [`Unsupported`](crate::ErrorKind::Unsupported) unless receivers
    /// are on the mesh.
    pub fn over(bake: &Bake, triangles: &[[Vec3; 3]], texel: f32) -> Result<Self, Error> {
        check(bake)?;
        let triangle = |(source, &[corner, a, b]): (u32, &[Vec3; 3])| Triangle {
            corner,
            edge_a: a - corner,
            edge_b: b - corner,
            source,
            ..Triangle::default()
        };
        let parts = SceneParts {
            triangles: (0..).zip(triangles).map(triangle).collect(),
            uvs: vec![TriangleUv::default(); triangles.len()],
            materials: vec![Material::default()],
            ..SceneParts::default()
        };
        let scene = Scene::new(parts)?;
        let tables = scene.tables();
        let is_lit = |triangle: u32| {
            (0..SIDE_SAMPLES).any(|k| {
                let (u, v) = uniform_triangle(hammersley(k, SIDE_SAMPLES, (0, 0)));
                let (position, normal) = (tables.position(triangle, u, v), tables.normal(triangle));
                row(bake, &SurfacePoint { position, patch: NONE, normal, weight: 1.0 }).is_some()
            })
        };
        let side = |triangle| Sides { front: true, back: !is_lit(triangle) };
        let sides: Vec<Sides> = (0..triangles.len() as u32).into_par_iter().map(side).collect();
        let is_lit = |point: &SurfacePoint| match row(bake, point) {
            // Where something stands on a surface, an interpolation mesh may still have light.
            Some(_) => !is_inside(&bake.scene, point),
            // A face so small that the bake found no light there.
            None => is_of(bake, point) && is_open_point(&bake.scene, point),
        };
        Self::laid_out(&scene, &sides, texel, &is_lit)
    }

    fn laid_out(
        scene: &Scene,
        sides: &[Sides],
        texel: f32,
        is_lit: &(impl Fn(&SurfacePoint) -> bool + Sync),
    ) -> Result<Self, Error> {
        let texels = LightmapTexels::new(scene, sides, texel, is_lit)?;
        let shown = spread_texels(&texels);
        let surroundings = Surroundings::with_rays(RAYS);
        Ok(Self { scene: scene.clone(), texels, shown, bake: Weak::new(), rows: Vec::new(), surroundings })
    }

    /// With so many rays to each material that shines and to the sky, traced anew: few while bakes follow each other,
    /// more after the last.
    pub fn set_rays(&mut self, rays: u32) {
        self.surroundings = Surroundings::with_rays(rays);
    }

    /// The scene on which it lies.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Its charts and receivers.
    pub fn texels(&self) -> &LightmapTexels {
        &self.texels
    }

    /// Texels of a row, and rows.
    pub fn size(&self) -> (u32, u32) {
        (self.texels.params.width, self.texels.params.height)
    }

    /// The receiver of each texel, row by row: between charts that of the nearest texel, since drawing reaches beyond
    /// the edges of triangles that are seen at a slant. [`NONE`] in a lightmap without any.
    pub fn shown(&self) -> &[u32] {
        &self.shown
    }

    /// Texture coordinates in [0, 1]² of the corners of triangles, in the order in which they were given to the scene's
    /// builder, for vertices that are not shared. `corners` has their positions: a builder turns triangles that are
    /// wound against their normals. A triangle has its front's place, or its back's where only that has one; `None`
    /// where no light comes to it.
    pub fn corner_uvs(&self, corners: &[[Vec3; 3]]) -> Vec<Option<[Vec2; 3]>> {
        let mut uvs = vec![None; corners.len()];
        for (number, triangle) in (0..).zip(&self.scene.geometry.triangles) {
            let source = triangle.source as usize;
            let Some(uv) = self.texels.uv(number, true).or_else(|| self.texels.uv(number, false)) else { continue };
            let (Some(place), Some([first, second, third])) = (uvs.get_mut(source), corners.get(source)) else {
                continue;
            };
            let edge = triangle.edge_a;
            let is_turned = (*third - *first).distance_squared(edge) < (*second - *first).distance_squared(edge);
            let [a, b] = if is_turned { [uv.corner_b, uv.corner_a] } else { [uv.corner_a, uv.corner_b] };
            *place = Some([uv.corner, a, b]);
        }
        uvs
    }

    /// Irradiance at the receivers after the last update, W/m². Waits for it.
    ///
    /// # Errors
    /// [`Unsupported`](crate::ErrorKind::Unsupported) unless receivers are on the mesh; a lighting that does not fit
    /// the scene; what the device says.
    pub fn irradiance(&mut self, field: &mut LightField, part: LightPart) -> Result<Vec<Vec3>, Error> {
        let surface = field.surface_irradiance()?;
        self.irradiance_of(field, &surface, part)
    }

    /// As [`Self::irradiance`], of what [`LightField::surface_irradiance`] of the same bake has read already.
    ///
    /// # Errors
    /// As [`Self::irradiance`].
    pub fn irradiance_of(&mut self, field: &LightField, surface: &[Vec3], part: LightPart) -> Result<Vec<Vec3>, Error> {
        let lighting = &field.scene().lighting;
        let bake = field.bake();
        let mut values = match part {
            LightPart::Indirect => vec![Vec3::ZERO; self.texels.points().len()],
            _ => self.surroundings(bake, lighting)?,
        };
        let sum = |(points, weights): &LightmapRow| -> Vec3 {
            let of = |(&k, &weight): (&u32, &f32)| surface.get(k as usize).map_or(Vec3::ZERO, |own| *own * weight);
            points.iter().zip(weights).map(of).sum()
        };
        self.rows(bake)?.par_iter().zip(&mut values).for_each(|(row, value)| *value += sum(row));
        if part == LightPart::Full && !lighting.lights.is_empty() {
            let emission = vec![Vec3::ZERO; field.scene().materials.len()];
            let distributions = Arc::clone(&lighting.distributions);
            let lights = Lighting { lights: lighting.lights.clone(), emission, distributions, ..Lighting::default() };
            let lit = Scene::under(Arc::clone(&field.scene().geometry), lights)?;
            add_at_taps(&lit, (&self.scene, &self.texels), &mut values);
        }
        Ok(values)
    }

    /// The [interpolation points](patches::MeshReceivers::interpolation) of a bake and their weights, for each receiver:
    /// for callers whose own shaders take light from [`ReceiverBuffers::interpolated`](crate::ReceiverBuffers).
    ///
    /// # Errors
    /// [`Unsupported`](crate::ErrorKind::Unsupported) unless receivers are on the mesh.
    pub fn rows(&mut self, bake: &Arc<Bake>) -> Result<&[LightmapRow], Error> {
        self.take(bake)?;
        Ok(&self.rows)
    }

    /// Direct irradiance at the receivers from surfaces that shine and from the sky, W/m²: what
    /// [`LightPart::WithoutLights`] has besides indirect light.
    ///
    /// # Errors
    /// A lighting that does not fit the scene.
    pub fn surroundings(&mut self, bake: &Bake, lighting: &Lighting) -> Result<Vec<Vec3>, Error> {
        let mut values = vec![Vec3::ZERO; self.texels.points().len()];
        // Traced on the bake's triangles: its materials are those that the lighting speaks of.
        self.surroundings.add(bake.scene(), self.texels.points(), lighting, &mut values)?;
        Ok(values)
    }

    /// Irradiance in each texel, row by row, of that at the receivers.
    pub fn picture(&self, values: &[Vec3]) -> Vec<Vec3> {
        let texel = |&receiver: &u32| values.get(receiver as usize).copied().unwrap_or(Vec3::ZERO);
        self.shown.par_iter().map(texel).collect()
    }

    /// Finds the rows of a bake, unless they are there.
    fn take(&mut self, bake: &Arc<Bake>) -> Result<(), Error> {
        if std::ptr::eq(self.bake.as_ptr(), Arc::as_ptr(bake)) {
            return Ok(());
        }
        check(bake)?;
        let rows: Vec<_> = self.texels.points().par_iter().map(|point| row(bake, point)).collect();
        let nearest = spread_receivers(&self.texels, &rows.iter().map(Option::is_some).collect::<Vec<_>>());
        let known = &bake.receivers.interpolation.points;
        let row = |(&k, own): (&u32, &SurfacePoint)| {
            let of_chart = rows.get(k as usize).copied().flatten();
            // A chart of its own on which the bake found no light.
            of_chart.unwrap_or_else(|| ([nearest_like(known, own); 3], [1.0, 0.0, 0.0]))
        };
        self.rows = nearest.par_iter().zip(self.texels.points()).map(row).collect();
        self.bake = Arc::downgrade(bake);
        Ok(())
    }
}

fn is_open_point(scene: &Scene, point: &SurfacePoint) -> bool {
    let [x, y, z] = point.position.to_array().map(f32::to_bits);
    is_open(scene, point, POINT_WALKS, hash3(x, y, z))
}

fn check(bake: &Bake) -> Result<(), Error> {
    if bake.settings.receivers != ReceiverKind::Mesh {
        return Err(Reason::OutputReceivers.into());
    }
    Ok(())
}

/// The point that is near and looks the same way; 0 without any, whose light is none.
fn nearest_like(points: &[SurfacePoint], own: &SurfacePoint) -> u32 {
    let cost = |point: &SurfacePoint| {
        own.position.distance_squared(point.position) * (1.0 + FACING * (1.0 - own.normal.dot(point.normal)))
    };
    let costs = (0..).zip(points).map(|(k, point)| (k, cost(point)));
    costs.min_by(|a: &(u32, f32), b| a.1.total_cmp(&b.1)).map_or(0, |(k, _)| k)
}

/// True on the surface of a bake.
fn is_of(bake: &Bake, point: &SurfacePoint) -> bool {
    let scene = &bake.scene;
    let lift = LIFTS[0] * scene.geometry.ray_offset;
    let hit = scene.closest_before(point.position + point.normal * lift, -point.normal, 2.0 * lift);
    !hit.is_miss() && scene.tables().normal(hit.triangle).dot(point.normal) > PARALLEL
}

/// The interpolation points of a bake about a point on its surface, where light comes to them.
fn row(bake: &Bake, point: &SurfacePoint) -> Option<LightmapRow> {
    let mesh = &bake.receivers.interpolation;
    let scene = &bake.scene;
    LIFTS.iter().find_map(|lift| {
        let lift = lift * scene.geometry.ray_offset;
        let hit = scene.closest_before(point.position + point.normal * lift, -point.normal, 2.0 * lift);
        if hit.is_miss() {
            return None;
        }
        let front = scene.tables().normal(hit.triangle).dot(point.normal) > 0.0;
        let (points, weights) = vertices_at(&mesh.grids, &mesh.cells, &mesh.vertices, hit, front);
        (points.x != NONE).then(|| (points.to_array(), weights.to_array()))
    })
}

/// The four texels beside one; some may lie beyond the picture, or at the other end of a row.
fn beside(texel: usize, width: u32) -> [usize; 4] {
    let width = width as usize;
    [texel.wrapping_sub(1), texel + 1, texel.wrapping_sub(width), texel + width]
}

/// The receivers of all texels: empty ones take that of the nearest.
fn spread_texels(texels: &LightmapTexels) -> Vec<u32> {
    let mut all = texels.texels.clone();
    let mut queue: VecDeque<usize> = (0..all.len()).filter(|&texel| all[texel] != NONE).collect();
    while let Some(texel) = queue.pop_front() {
        for next in beside(texel, texels.params.width) {
            if all.get(next) == Some(&NONE) {
                all[next] = all[texel];
                queue.push_back(next);
            }
        }
    }
    all
}

/// For each receiver itself where it has light, else the nearest that has, from texel to texel; [`NONE`] without one.
fn spread_receivers(texels: &LightmapTexels, has_light: &[bool]) -> Vec<u32> {
    let mut from: Vec<u32> = (0..).zip(has_light).map(|(k, &has)| if has { k } else { NONE }).collect();
    if !has_light.contains(&false) {
        return from;
    }
    let receiver = |texel: usize| texels.texels.get(texel).copied().unwrap_or(NONE);
    let lit = |texel: &usize| has_light.get(receiver(*texel) as usize).copied().unwrap_or(false);
    let mut queue: VecDeque<usize> = (0..texels.texels.len()).filter(lit).collect();
    while let Some(texel) = queue.pop_front() {
        let own = from[receiver(texel) as usize];
        for next in beside(texel, texels.params.width) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_borrowed_of_what_is_near_and_looks_the_same_way() {
        let at = |x: f32, normal: Vec3| SurfacePoint { position: Vec3::X * x, patch: NONE, normal, weight: 1.0 };
        let points = [at(0.1, Vec3::Y), at(0.2, Vec3::NEG_Y), at(5.0, Vec3::NEG_Y)];
        assert_eq!(nearest_like(&points, &at(0.0, Vec3::NEG_Y)), 1);
        assert_eq!(nearest_like(&points, &at(0.0, Vec3::Y)), 0);
        assert_eq!(nearest_like(&points[..1], &at(0.0, Vec3::NEG_Y)), 0);
        assert_eq!(nearest_like(&[], &at(0.0, Vec3::Y)), 0);
    }
}
