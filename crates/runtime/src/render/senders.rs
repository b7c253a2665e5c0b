//! The patches that send light, whatever they are made of: pieces of triangles, or clusters of samples.

use formfactor::kernel::grid::{cell_corners, cell_count, owner};
use formfactor::{Patch, PatchSize, Polygon, SubdivideSettings, Surfaces, TriangleGrid, cell_grids, subdivide};
use glam::{Vec3, Vec4};
use patches::{Nearest, Sample, ViewSettings, view_clusters};
use rayon::prelude::*;
use scene::sampling::hash3;
use scene::{Hit, NONE, Scene, SidePolicy, Sides, SurfacePoint, is_open};

use super::sight::sees;
use crate::error::Error;

/// Sample points of a polygon patch: origins of its form-factor rays, and where its direct light is measured.
const POLYGON_POINTS: u32 = 16;
/// Cells a facet's edge: how finely triangles are looked up.
const CELLS: f32 = 1.5;
/// Most pieces along an edge of a triangle.
const MOST_DIVISIONS: f32 = 1024.0;

/// A place has no patch when the nearest sample of like normal is further, in sample edges.
const FAR: f32 = 4.0;
/// Samples that are tried, the nearest first.
const TRIED: usize = 6;
/// A sample nearer than this, in sample edges, need not be seen.
const TOUCHING: f32 = 0.2;
/// Walks by which a place that sees no sample looks for light.
const WALKS: u32 = 2;

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

/// The senders of a scene: patches, cut into facets, over which light is gathered more finely than patches send it.
pub struct Senders {
    /// Centroid, area, normal.
    pub patches: Vec<Patch>,
    /// Mean albedo.
    pub albedo: Vec<Vec4>,
    /// Patch i owns the facets `patch_facets[i]..patch_facets[i + 1]`.
    pub patch_facets: Vec<u32>,
    /// The facets; those of polygon patches are the patches.
    pub facets: Vec<Patch>,
    /// Mean albedo of each facet.
    pub facet_albedo: Vec<Vec4>,
    /// Sample points, facet by facet; their weights are shares of the facet.
    pub points: Vec<SurfacePoint>,
    /// Albedo at each sample point.
    pub point_albedo: Vec<Vec4>,
    /// Facet f owns `points[offsets[f]..offsets[f + 1]]`.
    pub offsets: Vec<u32>,
    /// Outlines; none for clusters.
    pub polygons: Vec<Polygon>,
    /// Per triangle, the numbers of its cells.
    grids: Vec<TriangleGrid>,
    /// Facet of each cell; empty when cells are facets.
    cells: Vec<u32>,
    /// Patch of each facet; empty when facets are patches.
    facet_patch: Vec<u32>,
}

/// What rays look for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Columns {
    /// Patches.
    Patches,
    /// Facets.
    Facets,
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
        let polygons = subdivision.polygons()?;
        let formfactor::Subdivision { patches, grids, points, offsets, .. } = subdivision;
        let mut point_albedo = Vec::with_capacity(points.len());
        for (patch, range) in patches.iter().zip(offsets.windows(2)) {
            let own = &points[range[0] as usize..range[1] as usize];
            let area = patch.area / own.len().max(1) as f32;
            let albedo = |p: &SurfacePoint| scene.filtered_albedo(patch.triangle, p.position, area).extend(0.0);
            point_albedo.extend(own.iter().map(albedo));
        }
        let albedo = mean_albedo(&offsets, &points, &point_albedo);
        Ok(Self {
            patch_facets: (0..=patches.len() as u32).collect(),
            facets: patches.clone(),
            facet_albedo: albedo.clone(),
            patches,
            albedo,
            points,
            point_albedo,
            offsets,
            polygons,
            grids,
            cells: Vec::new(),
            facet_patch: Vec::new(),
        })
    }

    fn clusters(scene: &Scene, count: usize, seed: u32) -> Result<Self, Error> {
        let found = view_clusters(scene, &ViewSettings { patches: count as u32, seed, ..ViewSettings::default() })?;
        let patches = found.set.patches.iter();
        let patches =
            patches.map(|p| Patch { centroid: p.position, area: p.area, normal: p.normal, triangle: NONE }).collect();
        let albedo = found.set.patches.iter().map(|p| p.albedo.extend(0.0)).collect();
        let mut points = Vec::with_capacity(found.set.samples.len());
        let mut facets = Vec::with_capacity(found.facets.len());
        for (facet, range) in found.facets.windows(2).enumerate() {
            let samples = &found.set.samples[range[0] as usize..range[1] as usize];
            let weight = 1.0 / samples.len() as f32;
            let point =
                |s: &Sample| SurfacePoint { position: s.position, patch: facet as u32, normal: s.normal, weight };
            points.extend(samples.iter().map(point));
            let mean = |value: fn(&Sample) -> Vec3| samples.iter().map(value).sum::<Vec3>() * weight;
            facets.push(Patch {
                centroid: mean(|s| s.position),
                area: samples.iter().map(|s| s.area).sum(),
                normal: mean(|s| s.normal).normalize_or(samples[0].normal),
                triangle: NONE,
            });
        }
        let point_albedo: Vec<Vec4> = found.set.samples.iter().map(|s| s.albedo.extend(0.0)).collect();
        let facet_albedo = mean_albedo(&found.facets, &points, &point_albedo);
        let mut facet_patch = vec![0; facets.len()];
        for (patch, range) in found.patch_facets.windows(2).enumerate() {
            facet_patch[range[0] as usize..range[1] as usize].fill(patch as u32);
        }

        let area: f64 = facets.iter().map(|f: &Patch| f64::from(f.area)).sum();
        let edge = scene::math::sqrt((area / facets.len() as f64) as f32);
        let longest =
            |t: &scene::Triangle| t.edge_a.length().max(t.edge_b.length()).max((t.edge_b - t.edge_a).length());
        let divisions: Vec<u32> = scene
            .triangles
            .iter()
            .map(|t| (longest(t) * CELLS / edge).ceil().clamp(1.0, MOST_DIVISIONS) as u32)
            .collect();
        let grids = cell_grids(&vec![Sides { front: true, back: true }; divisions.len()], &divisions)?;
        let nearest = Nearest::new(&found.set.samples);
        let cells =
            cell_facets(scene, &grids, &nearest, &points, scene::math::sqrt((area / points.len() as f64) as f32));
        Ok(Self {
            patches,
            albedo,
            patch_facets: found.patch_facets,
            facets,
            facet_albedo,
            points,
            point_albedo,
            offsets: found.facets,
            polygons: Vec::new(),
            grids,
            cells,
            facet_patch,
        })
    }

    /// Areas, m².
    pub fn areas(&self) -> Vec<f32> {
        self.patches.iter().map(|p| p.area).collect()
    }

    /// The facet that owns a hit, or [`NONE`].
    pub fn facet(&self, scene: &Scene, hit: &Hit, direction: Vec3) -> u32 {
        if hit.is_miss() {
            return NONE;
        }
        let front = scene.geometry().normal(hit.triangle).dot(direction) < 0.0;
        let cell = owner(self.grids[hit.triangle as usize], *hit, front);
        if self.cells.is_empty() || cell == NONE { cell } else { self.cells[cell as usize] }
    }

    /// The patch that owns a hit, or [`NONE`].
    pub fn patch(&self, scene: &Scene, hit: &Hit, direction: Vec3) -> u32 {
        let facet = self.facet(scene, hit, direction);
        if self.facet_patch.is_empty() || facet == NONE { facet } else { self.facet_patch[facet as usize] }
    }

    /// Share of its patch's area that each facet has.
    pub fn facet_shares(&self) -> Vec<f32> {
        let mut shares: Vec<f32> = self.facets.iter().map(|f| f.area).collect();
        for range in self.patch_facets.windows(2) {
            let own = &mut shares[range[0] as usize..range[1] as usize];
            let scale = 1.0 / own.iter().sum::<f32>();
            own.iter_mut().for_each(|share| *share *= scale);
        }
        shares
    }

    /// Patches or facets as senders, any points as receivers.
    pub fn lighting<'a>(
        &'a self,
        scene: &'a Scene,
        columns: Columns,
        points: &'a [SurfacePoint],
        offsets: &'a [u32],
        seed: u32,
    ) -> Surfaces<'a> {
        let (patches, owner): (&[Patch], formfactor::Owner) = match columns {
            Columns::Patches => (&self.patches, Box::new(|hit, direction| self.patch(scene, hit, direction))),
            Columns::Facets => (&self.facets, Box::new(|hit, direction| self.facet(scene, hit, direction))),
        };
        Surfaces {
            patches,
            polygons: &self.polygons,
            row_polygons: &[],
            points,
            offsets,
            visibility: scene,
            owner,
            ray_offset: scene.ray_offset,
            seed,
        }
    }

    /// Patches as senders, facets as receivers.
    pub fn exchange<'a>(&'a self, scene: &'a Scene, seed: u32) -> Surfaces<'a> {
        let surfaces = self.lighting(scene, Columns::Patches, &self.points, &self.offsets, seed);
        Surfaces { row_polygons: &self.polygons, ..surfaces }
    }
}

/// The facet of each cell: that of the nearest sample that it sees, samples being `edge` m apart.
fn cell_facets(
    scene: &Scene,
    grids: &[TriangleGrid],
    nearest: &Nearest,
    points: &[SurfacePoint],
    edge: f32,
) -> Vec<u32> {
    let geometry = scene.geometry();
    let side = |triangle: usize, normal: Vec3| -> Vec<u32> {
        let n = grids[triangle].divisions;
        let facet = |cell: u32| {
            let (a, b, c) = cell_corners(n, cell);
            let middle = (a + b + c) / 3.0;
            let place = geometry.position(triangle as u32, middle.x, middle.y);
            let (found, count) = nearest.samples::<TRIED>(place, normal, FAR);
            // Nothing may stand between: a dark place has no facet, however bright it is beyond a wall.
            let seen = |&(sample, distance): &(u32, f32)| {
                let there = &points[sample as usize];
                distance < TOUCHING || sees(scene, (place, normal), (there.position, there.normal), edge)
            };
            let found = &found[..count];
            // What is small may hide from all samples of like normal, and be lit nevertheless.
            let lit = || {
                let point = SurfacePoint { position: place, patch: NONE, normal, weight: 1.0 };
                n == 1 && is_open(scene, &point, WALKS, hash3(triangle as u32, cell, 0x6869_6465))
            };
            let chosen = found.iter().find(|f| seen(f)).or_else(|| found.first().filter(|_| lit()));
            chosen.map_or(NONE, |f| points[f.0 as usize].patch)
        };
        (0..cell_count(n)).map(facet).collect()
    };
    (0..grids.len())
        .into_par_iter()
        .flat_map_iter(|t| {
            let normal = geometry.normal(t as u32);
            side(t, normal).into_iter().chain(side(t, -normal))
        })
        .collect()
}

/// Mean albedo of groups of sample points.
fn mean_albedo(offsets: &[u32], points: &[SurfacePoint], albedo: &[Vec4]) -> Vec<Vec4> {
    let mean = |range: &[u32]| (range[0] as usize..range[1] as usize).map(|k| albedo[k] * points[k].weight).sum();
    offsets.windows(2).map(mean).collect()
}
