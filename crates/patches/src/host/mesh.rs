//! The surface of a scene as patches, whatever they are made of: parts of triangles, clusters of
//! samples, or the samples of voxels.

mod build;
mod cells;
mod edit;

use alloc::boxed::Box;
use alloc::sync::Arc;
use alloc::vec::Vec;

use glam::{Vec3, Vec4};
use scene::{Hit, NONE, Scene, SurfacePoint};
use transport::kernel::grid::owner;
use transport::{Owner, Patch, Polygon, Surfaces, TriangleGrid};

pub use build::{lit_sampler, lit_sampler_with};
pub use edit::{EditedMesh, MeshChange, Zone};

use super::lookup::Lookup;

/// Largest number of patches: counts of hits name columns by 16 bits, and form factors of polygons
/// are a dense matrix while they are balanced.
pub const MAX_PATCHES: usize = 65_535;

/// Kind of patches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum PatchKind {
    /// Triangles cut into similar parts.
    Polygon,
    /// Samples of the surface clustered by what they see: any mesh, in as many patches as wanted.
    #[default]
    Cluster,
    /// Samples of each voxel clustered by position and normal.
    Voxel,
    /// Samples of each voxel shared out over the six directions of the axes.
    Axis,
}

impl PatchKind {
    /// Its name in settings and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Polygon => "polygon",
            Self::Cluster => "cluster",
            Self::Voxel => "voxel",
            Self::Axis => "axis",
        }
    }

    /// Returns true if patches are bound to voxels, so that the voxels' edge may be set and values between patches are
    /// looked up.
    pub fn has_voxels(self) -> bool {
        matches!(self, Self::Voxel | Self::Axis)
    }
}

/// Settings of [`PatchMesh::new`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshSettings {
    /// Kind of patches.
    pub kind: PatchKind,
    /// About how many patches.
    pub count: usize,
    /// Edge of the voxels, m, instead of the count.
    pub voxel_size: Option<f32>,
    /// Samples of a cluster, on average.
    pub samples: u32,
    /// Changes every random number.
    pub seed: u32,
}

/// The surface of a scene as patches, each cut into elements over which light is gathered more
/// finely than patches send it (Cohen, Greenberg et al. 1986).
#[derive(Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PatchMesh {
    /// Centroid, area and normal of each patch.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub patches: Vec<Patch>,
    /// Mean albedo of each patch.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub albedo: Vec<Vec4>,
    /// Patch i owns the elements `patch_elements[i]..patch_elements[i + 1]`; `[patches + 1]`.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub patch_elements: Vec<u32>,
    /// The elements; those of polygon patches are the patches.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub elements: Vec<Patch>,
    /// Mean albedo of each element.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub element_albedo: Vec<Vec4>,
    /// Sample points, element by element; their weights are shares of the element.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub points: Vec<SurfacePoint>,
    /// Albedo at each sample point.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub point_albedo: Vec<Vec4>,
    /// Element e owns `points[offsets[e]..offsets[e + 1]]`; `[elements + 1]`.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub offsets: Vec<u32>,
    /// Samples that the points are taken from: each is one point or more.
    pub samples: usize,
    /// Outlines of the patches; empty unless they are polygons.
    pub polygons: Vec<Polygon>,
    /// Values between patches; only patches of voxels have it.
    pub lookup: Option<Arc<Lookup>>,
    /// Per triangle, the numbers of its cells.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub(super) grids: Vec<TriangleGrid>,
    /// Element of each cell; empty when cells are elements.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub(super) cells: Vec<u32>,
}

/// Meaning of the columns of an operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Columns {
    /// Patches.
    Patches,
    /// Elements.
    Elements,
}

impl PatchMesh {
    /// Bytes of each part.
    pub fn bytes(&self) -> [(&'static str, u64); 4] {
        let patches = size_of_val(&self.patches[..])
            + size_of_val(&self.albedo[..])
            + size_of_val(&self.patch_elements[..])
            + size_of_val(&self.elements[..])
            + size_of_val(&self.element_albedo[..])
            + size_of_val(&self.polygons[..]);
        let points =
            size_of_val(&self.points[..]) + size_of_val(&self.point_albedo[..]) + size_of_val(&self.offsets[..]);
        let cells = size_of_val(&self.grids[..]) + size_of_val(&self.cells[..]);
        let lookup = self.lookup.as_ref().map_or(0, |lookup| lookup.bytes());
        [
            ("patches", patches as u64),
            ("sample points", points as u64),
            ("cells", cells as u64),
            ("lookup", lookup as u64),
        ]
    }

    /// First exitance of the patches, W/m², from the direct irradiance at the sample points, W/m²:
    /// the mean of `ρ E` over each element, and of that over each patch. `direct` holds one entry a
    /// sample point.
    pub fn source(&self, direct: &[Vec3]) -> Vec<Vec4> {
        let mut elements = Vec::with_capacity(self.elements.len());
        for range in self.offsets.windows(2) {
            let own = range[0] as usize..range[1] as usize;
            let mut sum = Vec4::ZERO;
            for (point, (albedo, direct)) in
                self.points[own.clone()].iter().zip(self.point_albedo[own.clone()].iter().zip(&direct[own]))
            {
                sum += albedo * direct.extend(0.0) * point.weight;
            }
            elements.push(sum);
        }
        self.patch_means(&elements)
    }

    /// Area-weighted mean of a quantity over each patch, from one value an element.
    pub fn patch_means(&self, elements: &[Vec4]) -> Vec<Vec4> {
        let shares = self.element_shares();
        let mut means = Vec::with_capacity(self.patches.len());
        for range in self.patch_elements.windows(2) {
            let own = range[0] as usize..range[1] as usize;
            means.push(own.map(|e| elements[e] * shares[e]).sum());
        }
        means
    }

    /// Areas of the patches, m².
    pub fn areas(&self) -> Vec<f32> {
        self.patches.iter().map(|p| p.area).collect()
    }

    /// The element that owns a hit of a ray in a direction, or [`NONE`].
    pub fn element(&self, scene: &Scene, hit: &Hit, direction: Vec3) -> u32 {
        if hit.is_miss() {
            return NONE;
        }
        self.element_on_side(hit, scene.tables().normal(hit.triangle).dot(direction) < 0.0)
    }

    /// The element that owns a position on the front or back of a triangle, or [`NONE`].
    pub fn element_on_side(&self, hit: &Hit, front: bool) -> u32 {
        let cell = owner(self.grids[hit.triangle as usize], *hit, front);
        if self.cells.is_empty() || cell == NONE { cell } else { self.cells[cell as usize] }
    }

    /// Per triangle, the numbers of its cells; and the column that owns each cell, or [`NONE`]: what
    /// a device looks hits up in.
    pub fn cell_columns(&self, columns: Columns) -> (&[TriangleGrid], Vec<u32>) {
        let cells = match self.cells.is_empty() {
            true => (0..self.elements.len() as u32).collect(),
            false => self.cells.clone(),
        };
        let cells = match columns {
            Columns::Elements => cells,
            Columns::Patches => cells.into_iter().map(|element| self.patch_of(element)).collect(),
        };
        (&self.grids, cells)
    }

    /// Divisions of the edges of each triangle in which elements are looked up.
    pub fn divisions(&self) -> Vec<u32> {
        self.grids.iter().map(|grid| grid.divisions).collect()
    }

    /// The patch of an element; [`NONE`] of [`NONE`].
    pub fn patch_of(&self, element: u32) -> u32 {
        if element == NONE {
            return NONE;
        }
        self.patch_elements.partition_point(|&first| first <= element) as u32 - 1
    }

    /// The patch that owns a hit of a ray in a direction, or [`NONE`].
    pub fn patch(&self, scene: &Scene, hit: &Hit, direction: Vec3) -> u32 {
        self.patch_of(self.element(scene, hit, direction))
    }

    /// Share of its patch's area that each element has.
    pub fn element_shares(&self) -> Vec<f32> {
        let mut shares: Vec<f32> = self.elements.iter().map(|e| e.area).collect();
        for range in self.patch_elements.windows(2) {
            let own = &mut shares[range[0] as usize..range[1] as usize];
            let scale = 1.0 / own.iter().sum::<f32>();
            own.iter_mut().for_each(|share| *share *= scale);
        }
        shares
    }

    /// Operator from patches or elements to any points: row i of the form factors is the mean over
    /// `points[offsets[i]..offsets[i + 1]]`.
    pub fn lighting<'a>(
        &'a self,
        scene: &'a Scene,
        columns: Columns,
        points: &'a [SurfacePoint],
        offsets: &'a [u32],
        seed: u32,
    ) -> Surfaces<'a> {
        let patches = match columns {
            Columns::Patches => &self.patches,
            Columns::Elements => &self.elements,
        };
        let owner: Owner = match columns {
            Columns::Patches => Box::new(|hit, direction| self.patch(scene, hit, direction)),
            Columns::Elements => Box::new(|hit, direction| self.element(scene, hit, direction)),
        };
        Surfaces {
            patches,
            polygons: &self.polygons,
            row_polygons: &[],
            points,
            offsets,
            visibility: scene,
            owner,
            ray_offset: scene.geometry.ray_offset,
            seed,
        }
    }

    /// Operator from patches to elements.
    pub fn surfaces<'a>(&'a self, scene: &'a Scene, seed: u32) -> Surfaces<'a> {
        let surfaces = self.lighting(scene, Columns::Patches, &self.points, &self.offsets, seed);
        Surfaces { row_polygons: &self.polygons, ..surfaces }
    }
}
