//! The patches that send light, whatever they are made of: pieces of triangles, or clusters of samples.

use formfactor::kernel::grid::{cell_corners, cell_count, owner};
use formfactor::{Patch, PatchSize, Polygon, SubdivideSettings, Surfaces, TriangleGrid, cell_grids, subdivide};
use glam::{Vec3, Vec4};
use patches::{Nearest, ViewSettings, view_clusters};
use rayon::prelude::*;
use scene::{Hit, NONE, Scene, SidePolicy, Sides, SurfacePoint, is_open};

use crate::error::Error;

/// Sample points of a polygon patch: origins of its form-factor rays, and where its direct light is measured.
const POLYGON_POINTS: u32 = 16;
/// Cells a patch edge: how finely triangles are looked up.
const CELLS: f32 = 3.0;
/// Most pieces along an edge of a triangle.
const MOST_DIVISIONS: f32 = 1024.0;

/// A place is surely not inside of a solid when a sample of like normal lies within this many sample edges.
const NEAR: f32 = 2.0;
/// A place has no patch when the nearest sample of like normal is further, in sample edges.
const FAR: f32 = 6.0;

/// What patches are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PatchKind {
    /// Triangles cut into like pieces.
    Polygon,
    /// Samples of the surface gathered by what they see: any mesh, in as many patches as wanted.
    #[default]
    Cluster,
}

impl PatchKind {
    /// Polygons where triangles are few and large beside the patches, else clusters.
    pub fn suited(triangles: usize, patches: usize) -> Self {
        if 4 * triangles < patches { Self::Polygon } else { Self::Cluster }
    }
}

/// The senders of a scene.
pub struct Senders {
    /// Centroid, area, normal.
    pub patches: Vec<Patch>,
    /// Sample points, patch by patch.
    pub points: Vec<SurfacePoint>,
    /// Patch i owns `points[offsets[i]..offsets[i + 1]]`.
    pub offsets: Vec<u32>,
    /// Mean albedo.
    pub albedo: Vec<Vec4>,
    /// Outlines; none for clusters.
    pub polygons: Vec<Polygon>,
    /// Per triangle, the numbers of its cells.
    grids: Vec<TriangleGrid>,
    /// Patch of each cell; empty when cells are patches.
    cells: Vec<u32>,
    /// The nearest sample of any place; for clusters.
    nearest: Option<Nearest>,
}

impl Senders {
    /// About `count` patches of this kind.
    ///
    /// # Errors
    /// More patches than can be numbered; no surface that light comes to.
    pub fn new(scene: &Scene, kind: PatchKind, count: usize, seed: u32) -> Result<Self, Error> {
        match kind {
            PatchKind::Polygon => Self::polygons(scene, count, seed),
            PatchKind::Cluster => match Self::clusters(scene, count, seed) {
                // No light comes anywhere: the fronts of the triangles give a black picture.
                Err(Error::Patches(patches::Error::NoSamples)) => Self::polygons(scene, count, seed),
                result => result,
            },
        }
    }

    fn polygons(scene: &Scene, count: usize, seed: u32) -> Result<Self, Error> {
        let mut cut = SubdivideSettings {
            size: PatchSize::Count(count as u32),
            points: POLYGON_POINTS,
            seed,
            ..Default::default()
        };
        let mut subdivision = subdivide(scene, &cut)?;
        if subdivision.patches.is_empty() {
            cut.sides = SidePolicy::Front;
            subdivision = subdivide(scene, &cut)?;
        }
        let albedo = polygon_albedo(scene, &subdivision);
        let polygons = subdivision.polygons()?;
        let formfactor::Subdivision { patches, grids, points, offsets, .. } = subdivision;
        Ok(Self { patches, points, offsets, albedo, polygons, grids, cells: Vec::new(), nearest: None })
    }

    fn clusters(scene: &Scene, count: usize, seed: u32) -> Result<Self, Error> {
        let set = view_clusters(scene, &ViewSettings { patches: count as u32, seed, ..ViewSettings::default() })?;
        let area: f64 = set.patches.iter().map(|p| f64::from(p.area)).sum();
        let edge = scene::math::sqrt((area / set.len() as f64) as f32);
        let patches =
            set.patches.iter().map(|p| Patch { centroid: p.position, area: p.area, normal: p.normal, triangle: NONE });
        let albedo = set.patches.iter().map(|p| p.albedo.extend(0.0)).collect();
        let mut points = Vec::with_capacity(set.members.len());
        for patch in 0..set.len() {
            points.extend(set.members_of(patch).iter().map(|m| {
                let sample = &set.samples[m.sample as usize];
                SurfacePoint { position: sample.position, patch: patch as u32, normal: sample.normal, weight: m.weight }
            }));
        }
        let longest =
            |t: &scene::Triangle| t.edge_a.length().max(t.edge_b.length()).max((t.edge_b - t.edge_a).length());
        let divisions: Vec<u32> = scene
            .triangles
            .iter()
            .map(|t| (longest(t) * CELLS / edge).ceil().clamp(1.0, MOST_DIVISIONS) as u32)
            .collect();
        let grids = cell_grids(&vec![Sides { front: true, back: true }; divisions.len()], &divisions)?;
        let nearest = Nearest::new(&set);
        let cells = cell_patches(scene, &grids, &nearest);
        Ok(Self {
            patches: patches.collect(),
            points,
            offsets: set.offsets,
            albedo,
            polygons: Vec::new(),
            grids,
            cells,
            nearest: Some(nearest),
        })
    }

    /// The sides of the triangles that have patches.
    pub fn sides(&self) -> Vec<Sides> {
        let has = |first: u32, cells: u32| {
            first != NONE
                && (self.cells.is_empty()
                    || self.cells[first as usize..(first + cells) as usize].iter().any(|&patch| patch != NONE))
        };
        let sides = |grid: &TriangleGrid| {
            let cells = cell_count(grid.divisions);
            Sides { front: has(grid.front, cells), back: has(grid.back, cells) }
        };
        self.grids.iter().map(sides).collect()
    }

    /// Areas, m².
    pub fn areas(&self) -> Vec<f32> {
        self.patches.iter().map(|p| p.area).collect()
    }

    /// The patch that owns a hit, or [`NONE`].
    pub fn owner(&self, scene: &Scene, hit: &Hit, direction: Vec3) -> u32 {
        if hit.is_miss() {
            return NONE;
        }
        let front = scene.geometry().normal(hit.triangle).dot(direction) < 0.0;
        let cell = owner(self.grids[hit.triangle as usize], *hit, front);
        if self.cells.is_empty() || cell == NONE { cell } else { self.cells[cell as usize] }
    }

    /// Whether light comes to a receiver.
    pub fn is_lit(&self, scene: &Scene, point: &SurfacePoint, seed: u32) -> bool {
        let near = |nearest: &Nearest| nearest.patch(point.position, point.normal).1 <= NEAR;
        self.nearest.as_ref().is_some_and(near) || is_open(scene, point, seed)
    }

    /// These patches as senders, any points as receivers.
    pub fn lighting<'a>(
        &'a self,
        scene: &'a Scene,
        points: &'a [SurfacePoint],
        offsets: &'a [u32],
        seed: u32,
    ) -> Surfaces<'a> {
        Surfaces {
            patches: &self.patches,
            polygons: &self.polygons,
            row_polygons: &[],
            points,
            offsets,
            visibility: scene,
            owner: Box::new(|hit, direction| self.owner(scene, hit, direction)),
            ray_offset: scene.ray_offset,
            seed,
        }
    }

    /// These patches as senders and receivers.
    pub fn exchange<'a>(&'a self, scene: &'a Scene, seed: u32) -> Surfaces<'a> {
        Surfaces { row_polygons: &self.polygons, ..self.lighting(scene, &self.points, &self.offsets, seed) }
    }
}

/// The patch of each cell: that of the nearest sample.
fn cell_patches(scene: &Scene, grids: &[TriangleGrid], nearest: &Nearest) -> Vec<u32> {
    let geometry = scene.geometry();
    let side = |triangle: usize, normal: Vec3| -> Vec<u32> {
        let n = grids[triangle].divisions;
        let patch = |cell: u32| {
            let (a, b, c) = cell_corners(n, cell);
            let middle = (a + b + c) / 3.0;
            let (patch, distance) = nearest.patch(geometry.position(triangle as u32, middle.x, middle.y), normal);
            if distance <= FAR { patch } else { NONE }
        };
        (0..cell_count(n)).map(patch).collect()
    };
    (0..grids.len())
        .into_par_iter()
        .flat_map_iter(|t| {
            let normal = geometry.normal(t as u32);
            side(t, normal).into_iter().chain(side(t, -normal))
        })
        .collect()
}

/// Mean albedo of each polygon patch, over its sample points.
fn polygon_albedo(scene: &Scene, subdivision: &formfactor::Subdivision) -> Vec<Vec4> {
    (subdivision.patches.iter().zip(subdivision.offsets.windows(2)))
        .map(|(patch, range)| {
            let points = &subdivision.points[range[0] as usize..range[1] as usize];
            let area = patch.area / points.len().max(1) as f32;
            let albedo = |p: &SurfacePoint| scene.filtered_albedo(patch.triangle, p.position, area) * p.weight;
            points.iter().map(albedo).sum::<Vec3>().extend(0.0)
        })
        .collect()
}
