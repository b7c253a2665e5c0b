//! Making patches of a scene.

use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;

use glam::{Vec3, Vec4};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::{NONE, Scene, SidePolicy, Sides, SurfacePoint};
use transport::{Patch, TriangleGrid};

use super::cells::cell_elements;
use super::{MAX_PATCHES, MeshSettings, PatchKind, PatchMesh};
use crate::error::Error;
use crate::host::axis::axis_patches;
use crate::host::cluster::{ClusterSettings, cluster_patches};
use crate::host::focus::Density;
use crate::host::grid::Grid;
use crate::host::lit::{LitSampler, Walker};
use crate::host::lookup::{Lookup, LookupSettings};
use crate::host::patch_set::PatchSet;
use crate::host::sample::{SampleSet, SampleSettings, sample_voxels_by};
use crate::host::subdivide::{PatchSize, SubdivideSettings, Subdivision, cell_grids, check_cells, subdivide};
use crate::host::view::{ViewSettings, view_clusters};
use crate::types::{Member, Sample, VirtualPatch};

/// Sample points of a polygon patch: origins of its form-factor rays, and where its direct light is
/// measured.
const POLYGON_POINTS: u32 = 16;
/// Cells along an element's edge: how finely triangles are looked up.
const CELLS: f32 = 1.5;
/// Most divisions along an edge of a triangle.
const MAX_DIVISIONS: f32 = 1024.0;
/// Patches that are not cut into elements are looked up as finely as if each had so many, up to
/// [`MAX_LOOKUP_CELLS`] in all.
const LOOKUP_CELLS: usize = 6;
const MAX_LOOKUP_CELLS: usize = 1 << 16;
/// Probe samples, which are asked whether light reaches them: for each patch, and at least and at
/// most in all.
const PROBES: usize = 6;
const MIN_PROBES: usize = 1 << 15;
const MAX_PROBES: usize = 1 << 16;

/// A sampler of the surfaces that light reaches, with as many probe samples as `count` patches need, as dense as is
/// said; `None` when light reaches none.
///
/// # Errors
/// What [`LitSampler::new`] says otherwise.
pub fn lit_sampler(scene: &Scene, count: usize, density: Density, seed: u32) -> Result<Option<LitSampler<'_>>, Error> {
    lit_sampler_with(None, scene, count, density, seed)
}

/// [`lit_sampler`] with somebody who walks for it.
///
/// # Errors
/// As [`lit_sampler`]; what the walker says.
pub fn lit_sampler_with<'a>(
    walker: Option<&'a dyn Walker>,
    scene: &'a Scene,
    count: usize,
    density: Density,
    seed: u32,
) -> Result<Option<LitSampler<'a>>, Error> {
    let probes = count.saturating_mul(PROBES).clamp(MIN_PROBES, MAX_PROBES);
    match LitSampler::with_walker(walker, scene, probes as u32, density, seed) {
        Ok(sampler) => Ok(Some(sampler)),
        Err(Error::NoSamples) => Ok(None),
        Err(error) => Err(error),
    }
}

impl PatchMesh {
    /// Patches of a scene. Without a sampler, where light reaches nothing, clusters are polygons
    /// instead, and all sides have patches: both give a black picture.
    ///
    /// # Errors
    /// [`Error::VoxelSizeWithoutVoxels`], [`Error::TooMany`] voxels, patches or samples, and what
    /// the making of the patches says.
    pub fn new(scene: &Scene, sampler: Option<&LitSampler>, settings: &MeshSettings) -> Result<Self, Error> {
        let MeshSettings { kind, count, voxel_size, samples, seed } = *settings;
        if voxel_size.is_some() && !kind.has_voxels() {
            return Err(Error::VoxelSizeWithoutVoxels { patches: kind.name() });
        }
        match (kind, sampler) {
            (PatchKind::Voxel | PatchKind::Axis, _) => {
                VoxelPatches { scene, sampler, kind, seed }.mesh(count, voxel_size)
            }
            (PatchKind::Cluster, Some(sampler)) => Self::of_clusters(sampler, count, samples, seed),
            (PatchKind::Polygon | PatchKind::Cluster, _) => {
                let density = sampler.map_or_else(Density::default, |sampler| *sampler.density());
                Self::of_polygons(scene, density, count, seed)
            }
        }
    }

    /// Triangles cut into similar parts, which are patches and elements at once.
    fn of_polygons(scene: &Scene, density: Density, count: usize, seed: u32) -> Result<Self, Error> {
        let mut settings = SubdivideSettings {
            size: PatchSize::Count(count as u32),
            density,
            points: POLYGON_POINTS,
            seed,
            ..Default::default()
        };
        let mut subdivision = subdivide(scene, &settings)?;
        if subdivision.patches.is_empty() {
            settings.sides = SidePolicy::Front;
            subdivision = subdivide(scene, &settings)?;
        }
        let polygons = subdivision.polygons()?;
        let Subdivision { patches, grids, points, offsets, .. } = subdivision;
        let mut point_albedo = Vec::with_capacity(points.len());
        for (patch, range) in patches.iter().zip(offsets.windows(2)) {
            let own = &points[range[0] as usize..range[1] as usize];
            let area = patch.area / own.len().max(1) as f32;
            for point in own {
                let albedo = scene.filtered_albedo(patch.triangle, point.position, area);
                point_albedo.push(albedo.extend(0.0));
            }
        }
        let albedo = mean_albedo(&offsets, &points, &point_albedo);
        Ok(Self {
            patch_elements: (0..=patches.len() as u32).collect(),
            elements: patches.clone(),
            element_albedo: albedo.clone(),
            patches,
            albedo,
            samples: points.len(),
            points,
            point_albedo,
            offsets,
            polygons,
            lookup: None,
            grids,
            cells: Vec::new(),
        })
    }

    /// Clusters of samples, cut into elements.
    fn of_clusters(sampler: &LitSampler, count: usize, samples: u32, seed: u32) -> Result<Self, Error> {
        let settings = ViewSettings { patches: count as u32, samples, seed, ..ViewSettings::default() };
        let clusters = view_clusters(sampler, &settings)?;
        let sample_count = clusters.set.samples.len() as u32;
        // An element is a range of samples.
        let members = (0..sample_count).map(|sample| Member { sample, weight: 1.0 }).collect();
        let no_voxels = vec![NONE; clusters.elements.len() - 1];
        let patches = clusters.set.patches;
        let elements = PatchSet::from_groups(clusters.set.samples, &no_voxels, clusters.elements, members)?;
        let scene = (sampler.scene(), sampler.walker());
        Self::of_samples(scene, sampler.density(), elements, &patches, clusters.patch_elements)
    }

    /// Patches whose elements are the patches of a set: patch i owns the elements
    /// `patch_elements[i]..patch_elements[i + 1]`.
    fn of_samples(
        (scene, walker): (&Scene, Option<&dyn Walker>),
        density: &Density,
        elements: PatchSet,
        patches: &[VirtualPatch],
        patch_elements: Vec<u32>,
    ) -> Result<Self, Error> {
        let points = ElementPoints::new(&elements);
        let area: f64 = elements.patches.iter().map(|p| f64::from(p.area) * f64::from(density.share(p.position))).sum();
        let cells = lookup_cells(elements.len(), patches.len());
        let grids = lookup_grids(scene, density, scene::math::sqrt((area / cells as f64) as f32))?;
        let sample_edge = scene::math::sqrt((area / elements.samples.len() as f64) as f32);
        let cells = cell_elements((scene, walker), density, &grids, &elements.samples, &points.owner, sample_edge)?;
        Ok(Self {
            patches: patches.iter().map(patch).collect(),
            albedo: patches.iter().map(|p| p.albedo.extend(0.0)).collect(),
            patch_elements,
            elements: elements.patches.iter().map(patch).collect(),
            element_albedo: elements.patches.iter().map(|e| e.albedo.extend(0.0)).collect(),
            points: points.points,
            point_albedo: points.albedo,
            offsets: elements.offsets,
            samples: elements.samples.len(),
            polygons: Vec::new(),
            lookup: None,
            grids,
            cells,
        })
    }
}

/// A virtual patch as one that light passes between.
pub(super) fn patch(p: &VirtualPatch) -> Patch {
    Patch { centroid: p.position, area: p.area, normal: p.normal, triangle: NONE }
}

/// Mean albedo of groups of sample points.
fn mean_albedo(offsets: &[u32], points: &[SurfacePoint], albedo: &[Vec4]) -> Vec<Vec4> {
    let mut means = Vec::with_capacity(offsets.len().saturating_sub(1));
    for range in offsets.windows(2) {
        let own = range[0] as usize..range[1] as usize;
        means.push(own.map(|k| albedo[k] * points[k].weight).sum());
    }
    means
}

/// The grids in which elements are looked up: cells are as large as an element with this edge in the focus, m.
fn lookup_grids(scene: &Scene, density: &Density, edge: f32) -> Result<Vec<TriangleGrid>, Error> {
    let divisions = lookup_divisions(scene, density, edge);
    let sides = vec![Sides { front: true, back: true }; divisions.len()];
    check_cells(scene, &sides, &divisions)?;
    cell_grids(&sides, &divisions)
}

/// Divisions of the triangles of [`lookup_grids`].
pub(super) fn lookup_divisions(scene: &Scene, density: &Density, edge: f32) -> Vec<u32> {
    (0..scene.geometry.triangles.len())
        .map(|triangle| {
            let edge = edge * density.triangle_edge(&scene.geometry.triangles[triangle]);
            let along_edge = (scene.longest_edge(triangle as u32) * CELLS / edge).ceil();
            along_edge.clamp(1.0, MAX_DIVISIONS) as u32
        })
        .collect()
}

/// Number of cells in which elements are looked up that would all be as large as an element.
pub(super) fn lookup_cells(elements: usize, patches: usize) -> usize {
    elements.max((LOOKUP_CELLS * patches).min(MAX_LOOKUP_CELLS))
}

/// The samples of elements as their points.
pub(super) struct ElementPoints {
    /// The points, element by element.
    pub points: Vec<SurfacePoint>,
    /// Albedo at each.
    pub albedo: Vec<Vec4>,
    /// For each sample, the element that has the greatest part of it: what is near the sample
    /// belongs to that one.
    pub owner: Vec<u32>,
}

impl ElementPoints {
    pub fn new(elements: &PatchSet) -> Self {
        let mut points = Vec::with_capacity(elements.members.len());
        let mut albedo = Vec::with_capacity(elements.members.len());
        let mut owner = vec![NONE; elements.samples.len()];
        let mut greatest = vec![0.0; elements.samples.len()];
        for (element, patch) in (0u32..).zip(&elements.patches) {
            for member in elements.members_of(element as usize) {
                let k = member.sample as usize;
                let sample = &elements.samples[k];
                points.push(SurfacePoint {
                    position: sample.position,
                    patch: element,
                    normal: sample.normal,
                    weight: member.weight,
                });
                albedo.push(sample.albedo.extend(0.0));
                let part = member.weight * patch.area;
                if part > greatest[k] {
                    greatest[k] = part;
                    owner[k] = element;
                }
            }
        }
        Self { points, albedo, owner }
    }
}

/// Makes patches of the samples of voxels.
struct VoxelPatches<'a> {
    scene: &'a Scene,
    sampler: Option<&'a LitSampler<'a>>,
    kind: PatchKind,
    seed: u32,
}

impl VoxelPatches<'_> {
    /// Patches of voxels with the edge `voxel_size`, m, or with that which gives about `count`
    /// patches. Each is its own element.
    fn mesh(&self, count: usize, voxel_size: Option<f32>) -> Result<PatchMesh, Error> {
        let grid = match voxel_size {
            Some(edge) => Grid::new(self.scene, Vec3::splat(edge))?,
            None => Grid::for_count(self.scene, Vec3::ONE, count, |grid| Ok(self.lit_patches(grid)?.len()))?,
        };
        let lit = self.lit_patches(&grid)?;
        let dark = self.dark_patches(&grid)?;
        let lookup = Lookup::with_dark(
            &grid.shape,
            (lit.len(), |k| lit.patches[k]),
            (dark.len(), |k| dark.patches[k]),
            LookupSettings::default(),
        )?;
        let patches = lit.patches.clone();
        let patch_elements = (0..=patches.len() as u32).collect();
        let scene = (self.scene, self.sampler.and_then(LitSampler::walker));
        let mesh = PatchMesh::of_samples(scene, &Density::default(), lit, &patches, patch_elements)?;
        Ok(PatchMesh { lookup: Some(Arc::new(lookup)), ..mesh })
    }

    /// The patches that light reaches.
    fn lit_patches(&self, grid: &Grid) -> Result<PatchSet, Error> {
        check_count("occupied voxels", grid.len())?;
        let samples = sample_voxels_by(self.scene, grid, &self.sampling(), &|samples| self.are_lit(samples))?;
        let set = self.gather(grid, samples)?;
        check_count("patches", set.len())?;
        Ok(set)
    }

    /// The others. They send nothing, but must not show the light of the other side of their wall.
    fn dark_patches(&self, grid: &Grid) -> Result<PatchSet, Error> {
        let are_dark = |samples: &[Sample]| Ok(self.are_lit(samples)?.into_iter().map(|is_lit| !is_lit).collect());
        match sample_voxels_by(self.scene, grid, &self.sampling(), &are_dark) {
            Ok(samples) => self.gather(grid, samples),
            Err(Error::NoSamples) => Ok(PatchSet::default()),
            Err(error) => Err(error),
        }
    }

    fn sampling(&self) -> SampleSettings {
        SampleSettings { seed: self.seed, ..SampleSettings::default() }
    }

    fn are_lit(&self, samples: &[Sample]) -> Result<Vec<bool>, Error> {
        match self.sampler {
            Some(sampler) => sampler.are_lit(samples, self.seed),
            None => Ok(alloc::vec![true; samples.len()]),
        }
    }

    fn gather(&self, grid: &Grid, samples: SampleSet) -> Result<PatchSet, Error> {
        match self.kind {
            PatchKind::Axis => axis_patches(grid, samples),
            _ => cluster_patches(grid, samples, &ClusterSettings::default(), &|_, _| 0.0),
        }
    }
}

/// More than can be numbered is an error.
fn check_count(name: &'static str, found: usize) -> Result<(), Error> {
    if found <= MAX_PATCHES {
        return Ok(());
    }
    Err(Error::TooMany { name, found: found as u64, limit: MAX_PATCHES as u64 })
}

#[cfg(test)]
mod tests {
    use scene::SceneParts;
    use scene::gpu::{Triangle, TriangleUv};

    use super::*;

    #[test]
    fn a_voxel_size_needs_voxels() {
        let parts = SceneParts {
            triangles: vec![Triangle { edge_a: Vec3::X, edge_b: Vec3::Y, ..Triangle::default() }],
            uvs: vec![TriangleUv::default()],
            materials: vec![<_>::default()],
            ..<_>::default()
        };
        let scene = Scene::new(parts).unwrap();
        let settings = MeshSettings { kind: PatchKind::Polygon, count: 10, voxel_size: Some(0.5), samples: 4, seed: 0 };
        let refused = PatchMesh::new(&scene, None, &settings).err().unwrap();
        assert!(matches!(refused, Error::VoxelSizeWithoutVoxels { patches: "polygon" }), "{refused}");
        let settings = MeshSettings { voxel_size: Some(0.001), kind: PatchKind::Axis, ..settings };
        let refused = PatchMesh::new(&scene, None, &settings).err().unwrap();
        assert!(matches!(refused, Error::TooMany { name: "occupied voxels", .. }), "{refused}");
        let settings = MeshSettings { voxel_size: None, kind: PatchKind::Polygon, ..settings };
        assert!(PatchMesh::new(&scene, None, &settings).is_ok());
    }
}
