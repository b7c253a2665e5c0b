//! The voxel volume: receivers in the air, for what moves.

use alloc::vec::Vec;

use glam::{DVec3, Vec3, Vec4};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::kernel::bvh::FAR;
use scene::math::abs;
use scene::parallel::*;
use scene::{ReceiverSet, Scene, SurfacePoint};

use super::lookup::fill_empty;
use crate::error::Error;
use crate::kernel::volume::{
    CUBE_SIDES, DIRECTIONS, PLANE_WORDS, SH_COEFFICIENTS, cube_to_harmonic, volume_lookup, volume_lookup_sh,
};
use crate::types::{GridShape, VolumeParams};

/// Voxels that a volume may have: each probe takes 516 bytes and six rows of form factors.
pub const PROBE_LIMIT: u64 = 1 << 20;

/// Points look at the probes from this share of the least voxel edge above their surface.
const LIFT: f32 = 0.02;
/// Distance that a probe needs from surfaces, in ray offsets: nearer to one its rays may start behind it.
const CLEARANCE: f32 = 4.0;
/// A ray that meets a surface at a smaller cosine says nothing of its plane.
const GRAZING: f32 = 1e-3;

/// Normals of a probe's receivers, in their order.
const NORMALS: [Vec3; CUBE_SIDES as usize] = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];

/// Resolution of a volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VolumeSize {
    /// Longest edge of the voxels, m; they fill the bounds exactly, so edges may be shorter and differ between axes.
    Edge(f32),
    /// About so many voxels over the scene's bounds; those without a valid probe count.
    Count(u32),
}

/// Settings of [`VoxelVolume::new`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VolumeSettings {
    /// Resolution of the volume.
    pub size: VolumeSize,
    /// True if probes that a point does not see do not count for it.
    pub walls: bool,
}

impl Default for VolumeSettings {
    fn default() -> Self {
        Self { size: VolumeSize::Count(8192), walls: true }
    }
}

/// A regular grid of probes over a scene's bounds, one in the middle of each voxel, each with six receivers: the
/// normals +x, −x, +y, −y, +z, −z. Irradiance at the receivers, in their order, is a volume of ambient cubes: `cubes[6
/// i + side]` belongs to probe i. [`VoxelVolume::at`] interpolates them; [`VoxelVolume::harmonics`] converts them to
/// spherical harmonics of degree 1.
///
/// A probe that touches a surface, or to none of whose sides light comes, is left out and takes no part. A point does
/// not take light from probes that it does not see, judged by the planes of the surfaces that rays from each probe to
/// the 26 voxels round it met ([`crate::kernel::volume`]): walls without thickness along the grid keep rooms separate
/// wherever each room sees probes; of walls across the grid, corners that no ray comes near to may take light from
/// outside (0.2 % of places in tests). A closed space smaller than the voxels has no probe, and takes the light of the
/// nearest.
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelVolume {
    /// Grid and settings.
    pub params: VolumeParams,
    /// One word a voxel: the number of its probe, or [`crate::types::EMPTY_CELL`] with that of the nearest one.
    pub probes: Vec<u32>,
    /// For each probe and direction, g with `g·q = 1` on the plane of what the ray met, q in voxels from the probe on;
    /// 0 where it met nothing. `[81 · probes]`.
    pub planes: Vec<f32>,
    points: Vec<SurfacePoint>,
}

impl VoxelVolume {
    /// Places the probes and casts 26 rays from each. `is_lit` says whether light comes to a receiver, as
    /// [`scene::is_open`] does by random walks; a probe with none that is lit stands inside of a solid and is left out.
    /// On all cores, the same bytes for any number of them.
    ///
    /// # Errors
    /// [`Error::Setting`] for an edge or count that is not positive, [`Error::TooMany`] beyond [`PROBE_LIMIT`] voxels,
    /// [`Error::NoProbes`] if none is left.
    pub fn new(
        scene: &Scene,
        settings: &VolumeSettings,
        is_lit: &(impl Fn(&SurfacePoint) -> bool + Sync),
    ) -> Result<Self, Error> {
        let edge = match settings.size {
            VolumeSize::Edge(edge) => edge,
            VolumeSize::Count(0) => {
                return Err(Error::Setting { name: "probe count", value: 0.0, rule: "at least 1" });
            }
            VolumeSize::Count(count) => edge_for(scene, count),
        };
        let shape = shape(scene, edge)?;
        let counts = shape.counts();
        let voxels = counts.element_product();
        let is_valid = |voxel: u32| {
            let place = probe_position(&shape, voxel);
            has_clearance(scene, place) && receivers(place, 0).iter().any(is_lit)
        };
        let full: Vec<u32> = (0..voxels).into_par_iter().filter(|&voxel| is_valid(voxel)).collect();
        if full.is_empty() {
            return Err(Error::NoProbes);
        }
        let mut probes = alloc::vec![u32::MAX; voxels as usize];
        (full.iter().zip(0..)).for_each(|(&voxel, probe)| probes[voxel as usize] = probe);
        let planes = full.par_iter().flat_map_iter(|&voxel| planes(scene, &shape, voxel)).collect();
        let points =
            full.iter().zip(0..).flat_map(|(&voxel, probe)| receivers(probe_position(&shape, voxel), probe)).collect();
        fill_empty(&mut probes, full, counts);
        let lift = (LIFT * shape.edges.min_element()).max(2.0 * scene.geometry.ray_offset);
        let params = VolumeParams { shape, lift, walls: u32::from(settings.walls), count: 0, reserved: 0 };
        Ok(Self { params, probes, planes, points })
    }

    /// Number of probes that take part.
    pub fn len(&self) -> usize {
        self.points.len() / CUBE_SIDES as usize
    }

    /// Returns true if there are none; [`VoxelVolume::new`] makes no such volume.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Irradiance at a point with a unit normal, W/m², from the ambient cubes: [`volume_lookup`].
    ///
    /// # Errors
    /// [`Error::Length`] unless there is one value a receiver.
    pub fn at(&self, cubes: &[Vec4], position: Vec3, normal: Vec3) -> Result<Vec4, Error> {
        check("cubes", self.points.len(), cubes)?;
        Ok(volume_lookup(&self.params, &self.probes, &self.planes, cubes, position, normal))
    }

    /// [`VoxelVolume::at`] for many points, on all cores.
    ///
    /// # Errors
    /// [`Error::Length`] unless there is one value a receiver.
    pub fn at_points(&self, cubes: &[Vec4], points: &[SurfacePoint]) -> Result<Vec<Vec4>, Error> {
        check("cubes", self.points.len(), cubes)?;
        let value =
            |p: &SurfacePoint| volume_lookup(&self.params, &self.probes, &self.planes, cubes, p.position, p.normal);
        Ok(points.par_iter().map(value).collect())
    }

    /// Spherical harmonics of degree 1 of the radiance at each probe, W/m²/sr, from the ambient cubes: L_00, L_1x,
    /// L_1y, L_1z, `[4 · probes]`; [`cube_to_harmonic`] gives the convention.
    ///
    /// # Errors
    /// [`Error::Length`] unless there is one value a receiver.
    pub fn harmonics(&self, cubes: &[Vec4]) -> Result<Vec<Vec4>, Error> {
        check("cubes", self.points.len(), cubes)?;
        let all = 0..self.len() as u32 * SH_COEFFICIENTS;
        Ok(all.map(|k| cube_to_harmonic(cubes, k / SH_COEFFICIENTS, k % SH_COEFFICIENTS)).collect())
    }

    /// Irradiance at many points, W/m², from the spherical harmonics: [`volume_lookup_sh`] on all cores.
    ///
    /// # Errors
    /// [`Error::Length`] unless there are four coefficients a probe.
    pub fn at_points_sh(&self, harmonics: &[Vec4], points: &[SurfacePoint]) -> Result<Vec<Vec4>, Error> {
        check("harmonics", self.len() * SH_COEFFICIENTS as usize, harmonics)?;
        Ok(points
            .par_iter()
            .map(|p| volume_lookup_sh(&self.params, &self.probes, &self.planes, harmonics, p.position, p.normal))
            .collect())
    }

    /// Bytes of all tables that a lookup reads, without the values.
    pub fn bytes(&self) -> usize {
        4 * (self.probes.len() + self.planes.len())
    }
}

impl ReceiverSet for VoxelVolume {
    fn points(&self) -> &[SurfacePoint] {
        &self.points
    }
}

fn check(name: &'static str, expected: usize, values: &[Vec4]) -> Result<(), Error> {
    if values.len() == expected { Ok(()) } else { Err(Error::Length { name, expected, found: values.len() }) }
}

/// Voxels with edges of at most `edge` that fill the bounds exactly.
fn shape(scene: &Scene, edge: f32) -> Result<GridShape, Error> {
    if !(edge.is_finite() && edge > 0.0) {
        return Err(Error::Setting { name: "voxel edge", value: f64::from(edge), rule: "positive and finite" });
    }
    let extent = (scene.geometry.bounds.1 - scene.geometry.bounds.0).as_dvec3();
    let counts = counts(extent, f64::from(edge));
    let found = counts.element_product();
    if found > PROBE_LIMIT as f64 {
        return Err(Error::TooMany { name: "probes", found: found as u64, limit: PROBE_LIMIT });
    }
    let edges = DVec3::select(extent.cmpgt(DVec3::ZERO), extent / counts, DVec3::splat(edge.into()));
    let origin = 0.5 * (scene.geometry.bounds.0.as_dvec3() + scene.geometry.bounds.1.as_dvec3() - counts * edges);
    let counts = counts.as_uvec3();
    Ok(GridShape {
        origin: origin.as_vec3(),
        edges: edges.as_vec3(),
        count_x: counts.x,
        count_y: counts.y,
        count_z: counts.z,
        reserved: [0; 3],
    })
}

/// Voxels along each axis; rounding adds none.
fn counts(extent: DVec3, edge: f64) -> DVec3 {
    (extent / edge - 1e-3).ceil().max(DVec3::ONE)
}

/// The edge with which about so many voxels fill the bounds: bisection.
fn edge_for(scene: &Scene, count: u32) -> f32 {
    let extent = (scene.geometry.bounds.1 - scene.geometry.bounds.0).as_dvec3();
    let mut small = extent.max_element() * 1e-7;
    let mut large = extent.max_element();
    for _ in 0..60 {
        let edge = (small * large).sqrt();
        if counts(extent, edge).element_product() > f64::from(count) {
            small = edge;
        } else {
            large = edge;
        }
    }
    // Rounded up, so that no layer of voxels is added.
    (large * (1.0 + 1e-6)) as f32
}

fn probe_position(shape: &GridShape, voxel: u32) -> Vec3 {
    shape.origin + (shape.coordinates(voxel).as_vec3() + 0.5) * shape.edges
}

fn receivers(position: Vec3, probe: u32) -> [SurfacePoint; CUBE_SIDES as usize] {
    core::array::from_fn(|side| SurfacePoint {
        position,
        patch: probe * CUBE_SIDES + side as u32,
        normal: NORMALS[side],
        weight: 1.0,
    })
}

/// Returns true if no surface touches a place.
fn has_clearance(scene: &Scene, place: Vec3) -> bool {
    let reach = CLEARANCE * scene.geometry.ray_offset;
    [Vec3::X, Vec3::Y, Vec3::Z].iter().all(|&axis| !scene.occluded(place - axis * reach, axis, 2.0 * reach))
}

/// The planes of what the rays of a probe meet.
fn planes(scene: &Scene, shape: &GridShape, voxel: u32) -> [f32; PLANE_WORDS as usize] {
    let place = probe_position(shape, voxel);
    let mut planes = [0.0; PLANE_WORDS as usize];
    for direction in 0..DIRECTIONS {
        let step = Vec3::new((direction % 3) as f32, (direction / 3 % 3) as f32, (direction / 9) as f32) - 1.0;
        if step == Vec3::ZERO {
            continue;
        }
        let way = (step * shape.edges).normalize();
        let hit = scene.closest_before(place, way, FAR);
        if hit.is_miss() {
            continue;
        }
        let mut normal = scene.tables().normal(hit.triangle);
        if abs(normal.dot(way)) < GRAZING {
            normal = way;
        }
        let gradient = normal * shape.edges / (normal.dot(way) * hit.t);
        let first = 3 * direction as usize;
        planes[first..first + 3].copy_from_slice(&gradient.to_array());
    }
    planes
}
