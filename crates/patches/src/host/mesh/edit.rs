//! Patches of a scene that was edited: those far from what changed stay, with their elements.

use alloc::vec;
use alloc::vec::Vec;

use glam::{IVec3, Vec3, Vec4};
use hashbrown::HashSet;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::gpu::Triangle;
use scene::parallel::*;
use scene::{NONE, Scene, Sides, SurfacePoint};
use transport::kernel::grid::{cell_corners, cell_count};
use transport::{Patch, TriangleGrid};

use super::build::{ElementPoints, lookup_cells, lookup_divisions, patch};
use super::cells::{Choice, ElementSearch, settled};
use super::{MAX_PATCHES, PatchMesh};
use crate::error::Error;
use crate::host::focus::Density;
use crate::host::lit::LitSampler;
use crate::host::nearest::Nearest;
use crate::host::patch_set::PatchSet;
use crate::host::subdivide::{cell_grids, check_cells};
use crate::host::view::{Wanted, clusters_of};
use crate::types::{Member, Sample};

/// Light comes to a place that has had no sample of like normal within this many sample edges: a room that was closed.
const UNKNOWN: f32 = 4.0;
/// The same in the zone: where something stood.
const EMPTY: f32 = 1.0;
/// Height from which the triangle of a sample is looked for, in ray offsets.
const BESIDE: f32 = 4.0;
/// Most parts along the edge of a triangle that are added to a zone.
const MAX_PARTS: f32 = 2048.0;
/// The element of a cell whose element is gone.
const GONE: u32 = NONE - 1;

/// Places near what changed: cubes of a grid, and those beside them.
#[derive(Clone, Debug)]
pub struct Zone {
    edge: f32,
    cubes: HashSet<IVec3>,
    low: Vec3,
    high: Vec3,
}

impl Zone {
    /// An empty one that will reach between one and two `margin` m about what is added to it.
    pub fn new(margin: f32) -> Self {
        Self { edge: margin, cubes: HashSet::new(), low: Vec3::INFINITY, high: Vec3::NEG_INFINITY }
    }

    /// Returns true if it has no place.
    pub fn is_empty(&self) -> bool {
        self.cubes.is_empty()
    }

    /// Adds a place, m.
    pub fn add_place(&mut self, position: Vec3) {
        self.low = self.low.min(position - 2.0 * self.edge);
        self.high = self.high.max(position + 2.0 * self.edge);
        self.cubes.insert(self.cube(position));
    }

    /// Adds the places of a triangle.
    pub fn add_triangle(&mut self, triangle: &Triangle) {
        let Triangle { corner, edge_a, edge_b, .. } = *triangle;
        let longest = edge_a.length().max(edge_b.length()).max(edge_a.distance(edge_b));
        let parts = (longest / self.edge).ceil().clamp(1.0, MAX_PARTS) as u32;
        for j in 0..=parts {
            for i in 0..=parts - j {
                let [u, v] = [i, j].map(|step| step as f32 / parts as f32);
                self.add_place(corner + edge_a * u + edge_b * v);
            }
        }
    }

    /// Returns true if a place is near to one that was added.
    pub fn contains(&self, position: Vec3) -> bool {
        if position.cmplt(self.low).any() || position.cmpgt(self.high).any() {
            return false;
        }
        let own = self.cube(position);
        let beside = |k: i32| own + IVec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
        (0..27).any(|k| self.cubes.contains(&beside(k)))
    }

    /// Returns true if part of a box may be near.
    fn meets(&self, low: Vec3, high: Vec3) -> bool {
        low.cmple(self.high).all() && high.cmpge(self.low).all()
    }

    fn cube(&self, position: Vec3) -> IVec3 {
        (position / self.edge).floor().as_ivec3()
    }
}

/// Difference between two scenes.
#[derive(Clone, Copy)]
pub struct MeshChange<'a> {
    /// The scene of the patches so far.
    pub before: &'a Scene,
    /// For each triangle now, the same one before; [`NONE`] where there is none.
    pub same: &'a [u32],
    /// For each triangle before, true if its surface is gone, and not only cut into other triangles.
    pub gone: &'a [bool],
    /// For each triangle now, true if its surface is new, and not only cut into other triangles.
    pub come: &'a [bool],
}

/// Patches after an edit.
pub struct EditedMesh {
    /// Patches and elements: first those that stay, in the order that they had.
    pub mesh: PatchMesh,
    /// For each element, the number that it had; [`NONE`] for new ones.
    pub before: Vec<u32>,
    /// Parts of the surface before and now that are gone, have come or have another element: corners, m.
    pub changed: Vec<[Vec3; 3]>,
}

impl PatchMesh {
    /// The patches after an edit of the scene, which is now that of the sampler: elements without a sample in the zone
    /// stay, unless most of their patch goes; the samples of those that go, as far as their surface is still there, and
    /// new ones, as dense, become new patches. There are new ones on new surfaces, where something stood, and where
    /// light comes now and did not before, which the zone gets.
    ///
    /// # Errors
    /// [`Error::TooMany`] elements; [`Error::Setting`] for patches that are not [`PatchKind::Cluster`](super::PatchKind).
    pub fn edited(
        &self,
        sampler: &LitSampler,
        change: &MeshChange,
        zone: &mut Zone,
        seed: u32,
    ) -> Result<EditedMesh, Error> {
        if self.cells.is_empty() || self.lookup.is_some() {
            let rule = "clusters of samples";
            return Err(Error::Setting { name: "the kind of patches that are edited", value: 0.0, rule });
        }
        let density = sampler.density();
        let area = self.counted_area(density);
        let sample_area = area / self.points.len().max(1) as f64;
        let old = self.as_samples();
        let goes = self.elements_that_go(zone);
        let (gone, kept): (Vec<usize>, Vec<usize>) = (0..old.len()).partition(|&k| goes[self.points[k].patch as usize]);
        let mut pool = surviving_samples(sampler, change, gone.into_iter().map(|k| old[k]), zone, seed)?;
        let known: Vec<Sample> = kept.into_iter().map(|k| old[k]).chain(pool.iter().copied()).collect();
        pool.extend(new_samples(sampler, change, &known, sample_area, zone, seed)?);

        let mut edit = Edit::of_kept(self, &old, &goes);
        let kept = edit.mesh.elements.len();
        if !pool.is_empty() {
            let share = |of: usize| ((pool.len() * of) as f64 / self.points.len() as f64).round() as usize;
            let patches = share(self.patches.len()).clamp(1, pool.len());
            let elements = share(self.elements.len()).clamp(patches, pool.len());
            if kept + elements > MAX_PATCHES {
                let found = (kept + elements) as u64;
                return Err(Error::TooMany { name: "elements", found, limit: MAX_PATCHES as u64 });
            }
            let samples = self.points.len().div_ceil(self.patches.len());
            let edge = scene::math::sqrt((area / self.patches.len() as f64) as f32);
            edit.add_clusters(
                sampler,
                &pool,
                &Wanted { patches, elements, most_elements: 2 * elements, samples, edge, seed },
            )?;
        }
        let search = Lookup { old: self, change, zone: &*zone, kept: kept as u32, area };
        search.fill(sampler, &mut edit)?;
        let changed = search.changed(sampler.scene(), &edit);
        Ok(EditedMesh { mesh: edit.mesh, before: edit.before, changed })
    }

    /// Area of the elements, each times the share of the density, m².
    pub fn counted_area(&self, density: &Density) -> f64 {
        self.elements.iter().map(|e| f64::from(e.area) * f64::from(density.share(e.centroid))).sum()
    }

    /// The sample points with what they stand for.
    fn as_samples(&self) -> Vec<Sample> {
        let sample = |(point, albedo): (&SurfacePoint, &Vec4)| Sample {
            position: point.position,
            area: self.elements[point.patch as usize].area * point.weight,
            normal: point.normal,
            triangle: NONE,
            albedo: albedo.truncate(),
            reserved: 0,
        };
        self.points.iter().zip(&self.point_albedo).map(sample).collect()
    }

    /// A patch of some elements, and its albedo: means by their areas.
    fn mean_of(&self, elements: &[usize]) -> (Patch, Vec4) {
        let area: f32 = elements.iter().map(|&e| self.elements[e].area).sum();
        let share = |e: usize| self.elements[e].area / area;
        let centroid = elements.iter().map(|&e| self.elements[e].centroid * share(e)).sum();
        let normal: Vec3 = elements.iter().map(|&e| self.elements[e].normal * share(e)).sum();
        let normal = normal.try_normalize().unwrap_or(self.elements[elements[0]].normal);
        let albedo = elements.iter().map(|&e| self.element_albedo[e] * share(e)).sum();
        (Patch { centroid, area, normal, triangle: NONE }, albedo)
    }

    /// Marks elements with a sample in a zone, and all of patches of which those are more than half.
    fn elements_that_go(&self, zone: &Zone) -> Vec<bool> {
        let is_near = |range: &[u32]| {
            let own = range[0] as usize..range[1] as usize;
            self.points[own].iter().any(|point| zone.contains(point.position))
        };
        let mut goes: Vec<bool> = self.offsets.par_windows(2).map(is_near).collect();
        for range in self.patch_elements.windows(2) {
            let own = &mut goes[range[0] as usize..range[1] as usize];
            let count = own.iter().filter(|goes| **goes).count();
            if 2 * count > own.len() {
                own.fill(true);
            }
        }
        goes
    }
}

/// Those of the samples whose surface is still there and that light still comes to.
fn surviving_samples(
    sampler: &LitSampler,
    change: &MeshChange,
    samples: impl Iterator<Item = Sample>,
    zone: &Zone,
    seed: u32,
) -> Result<Vec<Sample>, Error> {
    let height = BESIDE * change.before.geometry.ray_offset;
    let is_there = |sample: &Sample| {
        let origin = sample.position + sample.normal * height;
        let hit = change.before.closest_before(origin, -sample.normal, 2.0 * height);
        !hit.is_miss() && !change.gone[hit.triangle as usize]
    };
    let (near, mut survivors): (Vec<Sample>, Vec<Sample>) = samples.partition(|sample| zone.contains(sample.position));
    let there = near.into_par_iter().filter(is_there).collect();
    survivors.extend(sampler.lit_samples(there, seed)?);
    Ok(survivors)
}

/// Samples that light comes to: on new surfaces, where something stood, and where light did not come before, which the
/// zone gets. `known` are all others.
fn new_samples(
    sampler: &LitSampler,
    change: &MeshChange,
    known: &[Sample],
    area: f64,
    zone: &mut Zone,
    seed: u32,
) -> Result<Vec<Sample>, Error> {
    let nearest = Nearest::new(known, sampler.density());
    let is_empty = |sample: &Sample| {
        let edges = if zone.contains(sample.position) { EMPTY } else { UNKNOWN };
        nearest.sample(sample.position, sample.normal, edges).is_none()
    };
    let candidates = sampler.candidates_for(area, seed).into_par_iter();
    let wanted = candidates.filter(|sample| change.come[sample.triangle as usize] || is_empty(sample));
    let lit = sampler.lit_samples(wanted.collect(), seed)?;
    let beyond: Vec<Vec3> =
        lit.iter().map(|sample| sample.position).filter(|position| !zone.contains(*position)).collect();
    beyond.into_iter().for_each(|position| zone.add_place(position));
    Ok(lit)
}

/// Patches under way.
struct Edit {
    mesh: PatchMesh,
    /// Number that each element had, and now has.
    before: Vec<u32>,
    columns: Vec<u32>,
    /// All samples, and their elements.
    samples: Vec<Sample>,
    owner: Vec<u32>,
}

impl Edit {
    /// What is left of the patches when elements go.
    fn of_kept(old: &PatchMesh, samples: &[Sample], goes: &[bool]) -> Self {
        let empty = PatchMesh {
            patches: Vec::new(),
            albedo: Vec::new(),
            patch_elements: vec![0],
            elements: Vec::new(),
            element_albedo: Vec::new(),
            points: Vec::new(),
            point_albedo: Vec::new(),
            offsets: vec![0],
            samples: 0,
            polygons: Vec::new(),
            lookup: None,
            grids: Vec::new(),
            cells: Vec::new(),
        };
        let columns = vec![NONE; old.elements.len()];
        let mut edit = Self { mesh: empty, before: Vec::new(), columns, samples: Vec::new(), owner: Vec::new() };
        for p in 0..old.patches.len() {
            let own = old.patch_elements[p] as usize..old.patch_elements[p + 1] as usize;
            let left: Vec<usize> = own.clone().filter(|&e| !goes[e]).collect();
            if left.is_empty() {
                continue;
            }
            let (patch, albedo) = match left.len() == own.len() {
                true => (old.patches[p], old.albedo[p]),
                false => old.mean_of(&left),
            };
            edit.mesh.patches.push(patch);
            edit.mesh.albedo.push(albedo);
            for e in left {
                let number = edit.mesh.elements.len() as u32;
                edit.columns[e] = number;
                edit.before.push(e as u32);
                edit.mesh.elements.push(old.elements[e]);
                edit.mesh.element_albedo.push(old.element_albedo[e]);
                let own = old.offsets[e] as usize..old.offsets[e + 1] as usize;
                let points = old.points[own.clone()].iter();
                edit.mesh.points.extend(points.map(|point| SurfacePoint { patch: number, ..*point }));
                edit.mesh.point_albedo.extend_from_slice(&old.point_albedo[own.clone()]);
                edit.owner.extend(own.clone().map(|_| number));
                edit.samples.extend_from_slice(&samples[own]);
                edit.mesh.offsets.push(edit.mesh.points.len() as u32);
            }
            edit.mesh.patch_elements.push(edit.mesh.elements.len() as u32);
        }
        edit.mesh.samples = edit.mesh.points.len();
        edit
    }

    /// Adds patches of samples.
    fn add_clusters(&mut self, sampler: &LitSampler, pool: &[Sample], wanted: &Wanted) -> Result<(), Error> {
        let clusters = clusters_of(sampler, pool, wanted)?;
        let members = (0..pool.len() as u32).map(|sample| Member { sample, weight: 1.0 }).collect();
        let no_voxels = vec![NONE; clusters.elements.len() - 1];
        let elements = PatchSet::from_groups(clusters.set.samples, &no_voxels, clusters.elements, members)?;
        let ElementPoints { points, albedo, owner } = ElementPoints::new(&elements);
        let mesh = &mut self.mesh;
        let first_element = mesh.elements.len() as u32;
        let first_point = mesh.points.len() as u32;
        mesh.patches.extend(clusters.set.patches.iter().map(patch));
        mesh.albedo.extend(clusters.set.patches.iter().map(|p| p.albedo.extend(0.0)));
        mesh.patch_elements.extend(clusters.patch_elements[1..].iter().map(|end| first_element + end));
        mesh.elements.extend(elements.patches.iter().map(patch));
        mesh.element_albedo.extend(elements.patches.iter().map(|e| e.albedo.extend(0.0)));
        let numbered = |point: SurfacePoint| SurfacePoint { patch: first_element + point.patch, ..point };
        mesh.points.extend(points.into_iter().map(numbered));
        mesh.point_albedo.extend(albedo);
        mesh.offsets.extend(elements.offsets[1..].iter().map(|end| first_point + end));
        mesh.samples = mesh.points.len();
        self.before.resize(mesh.elements.len(), NONE);
        self.owner.extend(owner.into_iter().map(|own| first_element + own));
        self.samples.extend(elements.samples);
        Ok(())
    }
}

/// The elements of cells, so far and now.
struct Lookup<'a> {
    old: &'a PatchMesh,
    change: &'a MeshChange<'a>,
    zone: &'a Zone,
    /// Number of the first new element.
    kept: u32,
    /// Area of all elements before, as it is counted, m².
    area: f64,
}

impl Lookup<'_> {
    /// Finds the elements of cells: those so far of triangles that are the same and not near.
    fn fill(&self, sampler: &LitSampler, edit: &mut Edit) -> Result<(), Error> {
        let scene = sampler.scene();
        let density = sampler.density();
        let edge = |parts: usize| scene::math::sqrt((self.area / parts.max(1) as f64) as f32);
        let cells = lookup_cells(self.old.elements.len(), self.old.patches.len());
        let mut divisions = lookup_divisions(scene, density, edge(cells));
        for (divisions, &same) in divisions.iter_mut().zip(self.change.same) {
            if let Some(grid) = self.old.grids.get(same as usize) {
                *divisions = grid.divisions;
            }
        }
        let sides = vec![Sides { front: true, back: true }; divisions.len()];
        check_cells(scene, &sides, &divisions)?;
        edit.mesh.grids = cell_grids(&sides, &divisions)?;
        let sample_edge = edge(self.old.points.len());
        let search = ElementSearch::new(scene, density, &edit.samples, &edit.owner, sample_edge);
        let columns = &edit.columns;
        edit.mesh.cells = settled(sampler.walker(), scene, divisions.len(), |t| match self.stays(scene, t, columns) {
            Some(same) => {
                let now = |cell: u32| now(columns, self.old.cells[cell as usize]);
                let element = |cell: u32| Choice { element: now(cell), place: None };
                both_sides(&self.old.grids[same as usize]).map(|(_, cell)| element(cell)).collect()
            }
            None => search.triangle(t as u32, divisions[t]),
        })?;
        Ok(())
    }

    /// The triangle before, if it is the same, all elements of its cells stay, and it is not near.
    fn stays(&self, scene: &Scene, triangle: usize, columns: &[u32]) -> Option<u32> {
        let same = self.change.same[triangle];
        let grid = self.old.grids.get(same as usize)?;
        if both_sides(grid).any(|(_, cell)| now(columns, self.old.cells[cell as usize]) == GONE) {
            return None;
        }
        let Triangle { corner, edge_a, edge_b, .. } = scene.geometry.triangles[triangle];
        let low = corner + edge_a.min(edge_b).min(Vec3::ZERO);
        let high = corner + edge_a.max(edge_b).max(Vec3::ZERO);
        let is_near = |k: u32| {
            let (a, b, c) = cell_corners(grid.divisions, k);
            let middle = (a + b + c) / 3.0;
            self.zone.contains(corner + edge_a * middle.x + edge_b * middle.y)
        };
        let is_touched = self.zone.meets(low, high) && (0..cell_count(grid.divisions)).any(is_near);
        (!is_touched).then_some(same)
    }

    /// Parts of the surface that are gone, have come, or have another element.
    fn changed(&self, scene: &Scene, edit: &Edit) -> Vec<[Vec3; 3]> {
        let MeshChange { before, same, gone, come } = *self.change;
        let mut is_found = vec![false; before.geometry.triangles.len()];
        let mut changed = Vec::new();
        for (t, &old) in same.iter().enumerate() {
            let grid = &edit.mesh.grids[t];
            let new = |cell: u32| edit.mesh.cells[cell as usize];
            if let Some(old_grid) = self.old.grids.get(old as usize) {
                is_found[old as usize] = true;
                let cells = both_sides(grid).zip(both_sides(old_grid));
                let differs = cells
                    .filter(|((_, cell), (_, was))| now(&edit.columns, self.old.cells[*was as usize]) != new(*cell));
                changed.extend(differs.map(|((k, _), _)| cell_places(scene, t, grid.divisions, k)));
            } else if come[t] {
                changed.push(cell_places(scene, t, 1, 0));
            } else {
                let own = both_sides(grid).filter(|(_, cell)| new(*cell) != NONE && new(*cell) >= self.kept);
                changed.extend(own.map(|(k, _)| cell_places(scene, t, grid.divisions, k)));
            }
        }
        for (t, grid) in self.old.grids.iter().enumerate().filter(|(t, _)| !is_found[*t]) {
            if gone[t] {
                changed.push(cell_places(before, t, 1, 0));
            } else {
                let is_gone = |cell: u32| now(&edit.columns, self.old.cells[cell as usize]) == GONE;
                let own = both_sides(grid).filter(|(_, cell)| is_gone(*cell));
                changed.extend(own.map(|(k, _)| cell_places(before, t, grid.divisions, k)));
            }
        }
        changed
    }
}

/// The element now of one before; [`GONE`] for one that goes, [`NONE`] for none.
fn now(columns: &[u32], element: u32) -> u32 {
    match columns.get(element as usize) {
        None => NONE,
        Some(&NONE) => GONE,
        Some(&column) => column,
    }
}

/// The cells of both sides of a triangle: the number on the side, and in the table.
fn both_sides(grid: &TriangleGrid) -> impl Iterator<Item = (u32, u32)> + use<> {
    let count = cell_count(grid.divisions);
    [grid.front, grid.back].into_iter().flat_map(move |first| (0..count).map(move |k| (k, first + k)))
}

/// Corners of cell `k` of a triangle, m.
fn cell_places(scene: &Scene, triangle: usize, divisions: u32, k: u32) -> [Vec3; 3] {
    let (a, b, c) = cell_corners(divisions, k);
    [a, b, c].map(|place| scene.tables().position(triangle as u32, place.x, place.y))
}
