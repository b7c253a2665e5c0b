//! Light at the places where engines keep it: corners of triangles, texels of a lightmap, probes in the air.
//!
//! All of it is irradiance, W/m², of the last [`LightField::update`]. Indirect light on surfaces is what pixels
//! show, interpolated between the receivers; in the air it is gathered by rays from each probe. Direct light is added
//! by shadow rays.

pub mod lightmap;
pub mod live;
pub mod planes;
pub mod probes;
pub mod surroundings;

use std::borrow::Cow;
use std::sync::Arc;

use glam::{Vec3, Vec4};
use patches::{LightmapTexels, VoxelVolume};
use rayon::prelude::*;
use scene::gpu::DirectParams;
use scene::kernel::bvh::FAR;
use scene::kernel::camera::{camera_direction, surface_point};
use scene::math::luminance;
use scene::sampling::{cosine_hemisphere, hammersley, hash3};
use scene::{
    Camera, Hit, LUMENS_PER_WATT, Lighting, NONE, ReceiverSet as _, Scene, Sides, SurfacePoint, Visibility as _,
};
use transport::kernel::grid::{cell_count, interpolate_receivers};
use transport::kernel::view::vertices_at;

use crate::bake::{Bake, ReceiverKind, direct_params};
use crate::error::{Error, Reason};
use crate::light::LightField;

pub use lightmap::{LightmapRow, LiveLightmap};
pub use live::LiveProbes;
pub use planes::{CalculationPlane, PlaneKind, PlaneLight};
pub use probes::ProbeVolume;
pub use surroundings::Surroundings;

/// Shadow rays to each area light.
const AREA_RAYS: u32 = 64;
/// Rays to the sky.
const SKY_RAYS: u32 = 256;
/// Receivers of a lightmap whose direct light is found at once.
const TEXEL_BLOCK: usize = 1 << 16;
/// Rays that tell whether light comes to a point.
const LIT_RAYS: u32 = 8;
/// Corners are lit from this share of the way to the middle of their triangle.
const INWARDS: f32 = 0.05;

/// Which light is asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LightPart {
    /// Direct and indirect.
    #[default]
    Full,
    /// All but the direct light of lights: for engines that light by lamps and the sun themselves, yet know nothing of
    /// surfaces that shine and of skies.
    WithoutLights,
    /// Reflected at least once: for engines that light directly themselves.
    Indirect,
}

/// The sides of each triangle of the bake's own scene that have receivers: it is cut where something stands on a
/// triangle.
pub fn lit_sides(bake: &Bake) -> Vec<Sides> {
    let mesh = &bake.receivers.interpolation;
    let is_lit = |first: u32, divisions: u32| {
        first != NONE && {
            let cells = &mesh.cells[first as usize..(first + cell_count(divisions)) as usize];
            cells.iter().any(|cell| cell.first != NONE)
        }
    };
    mesh.grids
        .iter()
        .map(|grid| Sides { front: is_lit(grid.front, grid.divisions), back: is_lit(grid.back, grid.divisions) })
        .collect()
}

/// Returns true if light comes to a point of the bake's scene: one of a few rays from it leaves the scene or meets a
/// side with receivers, which stand where light comes. Inside of a solid, as where a column stands on a floor, none
/// does. Needs receivers on the mesh.
pub fn is_lit(bake: &Bake, point: &SurfacePoint) -> bool {
    let mesh = &bake.receivers.interpolation;
    let tables = bake.scene.tables();
    let [x, y, z] = point.position.to_array().map(f32::to_bits);
    let seed = hash3(x, y, z);
    (0..LIT_RAYS).any(|k| {
        let xi = hammersley(k, LIT_RAYS, (hash3(seed, 0, 1), hash3(seed, 1, 1)));
        let direction = cosine_hemisphere(point.normal, xi);
        let hit = bake.scene.closest(point.position + point.normal * bake.scene.geometry.ray_offset, direction);
        if hit.is_miss() {
            return true;
        }
        let front = tables.normal(hit.triangle).dot(direction) < 0.0;
        // A surface that touches closes the side.
        hit.t > 4.0 * bake.scene.geometry.ray_offset
            && vertices_at(&mesh.grids, &mesh.cells, &mesh.vertices, hit, front).0.x != NONE
    })
}

/// Irradiance at the corners of each triangle, on its front or its back, W/m²: at the corner, the end of `edge_a` and
/// the end of `edge_b`. Zero where that side has no receivers. Direct light is that of a place a twentieth of the way
/// to the middle of the triangle: a corner itself touches what stands beside it.
///
/// # Errors
/// [`Unsupported`](crate::ErrorKind::Unsupported) unless receivers are on the mesh; what the device says.
pub fn at_corners(field: &mut LightField, part: LightPart, front: bool) -> Result<Vec<[Vec3; 3]>, Error> {
    let indirect = indirect(field)?;
    let mesh = &field.bake().receivers.interpolation;
    let mut corners: Vec<[Vec3; 3]> =
        mesh.corner_irradiance(&indirect, front)?.iter().map(|corners| corners.map(Vec4::truncate)).collect();
    if part == LightPart::Indirect {
        return Ok(corners);
    }
    let is_lit = |side: &Sides| if front { side.front } else { side.back };
    let sides = lit_sides(field.bake());
    let lit: Vec<usize> = (0..corners.len()).filter(|&triangle| is_lit(&sides[triangle])).collect();
    let points: Vec<SurfacePoint> =
        lit.iter().flat_map(|&triangle| corner_points(field.scene(), triangle as u32, front)).collect();
    let lit_scene = lit_by(field.scene(), part)?;
    let direct = direct(&lit_scene, &points, 1);
    for (&triangle, direct) in lit.iter().zip(direct.chunks_exact(3)) {
        corners[triangle].iter_mut().zip(direct).for_each(|(sum, direct)| *sum += *direct);
    }
    Ok(corners)
}

/// Irradiance at the receivers of a lightmap, W/m², as [`LightmapTexels::picture`] takes them.
///
/// # Errors
/// [`Unsupported`](crate::ErrorKind::Unsupported) unless receivers are on the mesh; what the device says.
pub fn on_lightmap(field: &mut LightField, lightmap: &LightmapTexels, part: LightPart) -> Result<Vec<Vec4>, Error> {
    let indirect = indirect(field)?;
    let mesh = &field.bake().receivers.interpolation;
    let tables = field.scene().tables();
    let at = |(place, point): (&Hit, &SurfacePoint)| {
        let front = tables.normal(place.triangle).dot(point.normal) > 0.0;
        interpolate_receivers(&mesh.grids, &mesh.cells, &mesh.vertices, &indirect, *place, front)
    };
    let mut values: Vec<Vec4> = lightmap.places.par_iter().zip(lightmap.points()).map(at).collect();
    if part != LightPart::Indirect {
        let mut direct = vec![Vec3::ZERO; values.len()];
        let lit_scene = lit_by(field.scene(), part)?;
        add_at_taps(&lit_scene, (field.scene(), lightmap), &mut direct);
        values.iter_mut().zip(direct).for_each(|(sum, direct)| *sum += direct.extend(0.0));
    }
    Ok(values)
}

/// Irradiance at the receivers of a probe volume, W/m²: six to a probe, as [`VoxelVolume::at`] takes them.
///
/// # Errors
/// What the device says; cancellation.
pub fn in_volume(field: &mut LightField, volume: &VoxelVolume, part: LightPart) -> Result<Vec<Vec4>, Error> {
    let indirect = field.irradiance_at(volume.points())?;
    let mut values: Vec<Vec4> = indirect.iter().map(|h| h.extend(0.0)).collect();
    add_direct(field.scene(), volume.points(), part, &mut values)?;
    Ok(values)
}

/// Irradiance at what the middle of each pixel shows, row by row, W/m²; zero where that is nothing. On lamps it is what
/// falls on them.
///
/// # Errors
/// [`Unsupported`](crate::ErrorKind::Unsupported) unless receivers are on the mesh; what the device says.
pub fn on_view(field: &mut LightField, camera: &Camera, part: LightPart) -> Result<Vec<Vec3>, Error> {
    let indirect = indirect(field)?;
    let mesh = &field.bake().receivers.interpolation;
    let scene = field.scene();
    let tables = scene.tables();
    let (mut values, points): (Vec<Vec4>, Vec<SurfacePoint>) = (0..camera.width * camera.height)
        .into_par_iter()
        .map(|pixel| {
            let x = pixel % camera.width;
            let y = pixel / camera.width;
            let direction = camera_direction(camera, x as f32 + 0.5, y as f32 + 0.5).normalize_or_zero();
            let hit = scene.closest_before(camera.eye, direction, FAR);
            let point = surface_point(&tables, hit, direction);
            let front = !hit.is_miss() && tables.normal(hit.triangle).dot(point.normal) > 0.0;
            (interpolate_receivers(&mesh.grids, &mesh.cells, &mesh.vertices, &indirect, hit, front), point)
        })
        .unzip();
    add_direct(scene, &points, part, &mut values)?;
    Ok(values.iter().map(|e| e.truncate()).collect())
}

/// Illuminance of an irradiance, lx: [`LUMENS_PER_WATT`] times its luminance.
pub fn illuminance(irradiance: Vec3) -> f32 {
    LUMENS_PER_WATT * luminance(irradiance)
}

/// Indirect irradiance at the interpolation points.
fn indirect(field: &mut LightField) -> Result<Vec<Vec4>, Error> {
    if field.bake().settings.receivers != ReceiverKind::Mesh {
        return Err(Reason::OutputReceivers.into());
    }
    Ok(field.surface_irradiance()?.iter().map(|h| h.extend(0.0)).collect())
}

/// Direct irradiance at points, with more rays than a frame can afford, `together` of which share them.
fn direct(scene: &Scene, points: &[SurfacePoint], together: u32) -> Vec<Vec3> {
    let sky_rays = if scene.has_sky() { SKY_RAYS / together } else { 0 };
    let area_rays = AREA_RAYS / together;
    let params = DirectParams { count: points.len() as u32, area_rays, sky_rays, ..direct_params(scene) };
    scene.direct_irradiance(&params, points)
}

/// Adds the direct light of a scene at the receivers of a lightmap, which lies on another or the same: each the mean of
/// four places about it.
fn add_at_taps(scene: &Scene, (under, lightmap): (&Scene, &LightmapTexels), values: &mut [Vec3]) {
    for (block, values) in (0..).zip(values.chunks_mut(TEXEL_BLOCK)) {
        let receivers = block * TEXEL_BLOCK..block * TEXEL_BLOCK + values.len();
        let taps: Vec<SurfacePoint> = receivers.filter_map(|k| lightmap.taps(under, k)).flatten().collect();
        let direct = direct(scene, &taps, 4);
        values.iter_mut().zip(direct.chunks_exact(4)).for_each(|(sum, taps)| *sum += 0.25 * taps.iter().sum::<Vec3>());
    }
}

/// A scene under the part of its light that is asked for directly.
fn lit_by(scene: &Scene, part: LightPart) -> Result<Cow<'_, Scene>, Error> {
    Ok(match part {
        LightPart::Full => Cow::Borrowed(scene),
        LightPart::WithoutLights => {
            let lighting = Lighting { lights: Vec::new(), ..scene.lighting.clone() };
            Cow::Owned(Scene::under(Arc::clone(&scene.geometry), lighting)?)
        }
        LightPart::Indirect => Cow::Owned(Scene::under(Arc::clone(&scene.geometry), Lighting::default())?),
    })
}

fn add_direct(scene: &Scene, points: &[SurfacePoint], part: LightPart, values: &mut [Vec4]) -> Result<(), Error> {
    if part != LightPart::Indirect {
        let lit_scene = lit_by(scene, part)?;
        let direct = direct(&lit_scene, points, 1);
        values.iter_mut().zip(direct).for_each(|(sum, direct)| *sum += direct.extend(0.0));
    }
    Ok(())
}

/// Places near the corners of a side.
fn corner_points(scene: &Scene, triangle: u32, front: bool) -> [SurfacePoint; 3] {
    let tables = scene.tables();
    let normal = tables.normal(triangle);
    let normal = if front { normal } else { -normal };
    let near = INWARDS / 3.0;
    let far = 1.0 - 2.0 * near;
    [(near, near), (far, near), (near, far)].map(|(u, v)| SurfacePoint {
        position: tables.position(triangle, u, v),
        patch: NONE,
        normal,
        weight: 1.0,
    })
}
