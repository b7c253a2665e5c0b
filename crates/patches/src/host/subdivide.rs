//! Triangles of a scene cut into patches and receivers.

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;
use glam::{Vec2, Vec3};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::double::{exp, ln};
use scene::parallel::*;
use scene::sampling::{hash3, uniform_triangle, unit};
use scene::{Hit, NONE, POINT_WALKS, Scene, SidePolicy, Sides, SurfacePoint, find_lit_sides, find_sides, is_open};
use transport::kernel::grid::{cell_corners, cell_count, owner};
use transport::{Patch, Polygon, Surfaces, TriangleGrid, check_length};

use super::focus::Density;
use super::visibility::{SurfacePlace, is_covered, is_visible};
use crate::error::Error;

/// Most divisions along an edge.
pub(super) const MAX_DIVISIONS: u32 = 4096;
/// Most patches or receivers: the last two indices stand for the sky and for lost hits, and words must count them.
const MAX_ENTRIES: u64 = 1 << 31;
/// Most cells of the grids of all triangles in which patches and receivers are looked up: gigabytes of them.
const MAX_CELLS: u64 = 1 << 28;
/// Places at which a cell with holes is looked at.
const MASK_PROBES: u32 = 64;

/// Size of patches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PatchSize {
    /// Patches of at most this area, m².
    Area(f32),
    /// About this many patches in all (never fewer than one a side).
    Count(u32),
}

/// Settings of [`subdivide`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SubdivideSettings {
    /// Size of the patches.
    pub size: PatchSize,
    /// Density of what is cut by count.
    pub density: Density,
    /// Which sides.
    pub sides: SidePolicy,
    /// Sample points a patch.
    pub points: u32,
    /// Changes the sample points.
    pub seed: u32,
}

impl Default for SubdivideSettings {
    fn default() -> Self {
        Self { size: PatchSize::Count(4000), density: Density::default(), sides: SidePolicy::Lit, points: 32, seed: 0 }
    }
}

/// The patches of a scene.
#[derive(Clone, Debug, Default)]
pub struct Subdivision {
    /// Patches: triangle by triangle, front before back, cell by cell.
    pub patches: Vec<Patch>,
    /// Per triangle of the scene, the numbers of its patches.
    pub grids: Vec<TriangleGrid>,
    /// Stratified sample points, patch by patch, none in a hole.
    pub points: Vec<SurfacePoint>,
    /// Patch i owns `points[offsets[i]..offsets[i + 1]]`; `[n + 1]`.
    pub offsets: Vec<u32>,
    /// Corners of each patch, counter-clockwise from its side.
    pub corners: Vec<[Vec3; 3]>,
}

pub(super) fn triangle_area(scene: &Scene, triangle: usize) -> f32 {
    let t = scene.geometry.triangles[triangle];
    0.5 * t.edge_a.cross(t.edge_b).length()
}

fn edge_divisions(ratio: f32) -> u32 {
    (scene::math::sqrt(ratio) * (1.0 - 1e-6)).ceil().clamp(1.0, MAX_DIVISIONS as f32) as u32
}

pub(super) fn check_positive(name: &'static str, value: f32) -> Result<(), Error> {
    if value > 0.0 && value.is_finite() {
        Ok(())
    } else {
        Err(transport::Error::Setting { name, value: f64::from(value), rule: "positive and finite" }.into())
    }
}

/// Divisions of every triangle so that patches have at most `area` m²: `n = ⌈√(A / area)⌉`.
///
/// # Errors
/// [`transport::Error::Setting`] for an area that is not positive.
pub fn divisions_for_area(scene: &Scene, area: f32) -> Result<Vec<u32>, Error> {
    check_positive("area", area)?;
    Ok(divisions_of(&(0..scene.geometry.triangles.len()).map(|t| triangle_area(scene, t)).collect::<Vec<_>>(), area))
}

fn divisions_of(areas: &[f32], area: f32) -> Vec<u32> {
    areas.iter().map(|own| edge_divisions(own / area)).collect()
}

fn total_cells(sides: &[Sides], divisions: &[u32]) -> u64 {
    sides.iter().zip(divisions).map(|(s, &n)| (u64::from(s.front) + u64::from(s.back)) * u64::from(n).pow(2)).sum()
}

/// Divisions of every triangle for about `count` patches of like area times [`Density::share`].
///
/// # Errors
/// [`transport::Error::Setting`] for a count of 0, [`transport::Error::Length`] unless there is one entry of `sides` a
/// triangle.
pub fn divisions_for_count(scene: &Scene, sides: &[Sides], density: &Density, count: u32) -> Result<Vec<u32>, Error> {
    check_length("sides", scene.geometry.triangles.len(), sides.len())?;
    check_positive("count", count as f32)?;
    let areas: Vec<f32> = (0..sides.len())
        .map(|t| triangle_area(scene, t) * density.triangle_share(&scene.geometry.triangles[t]))
        .collect();
    let total: f64 = areas.iter().map(|&area| f64::from(area)).sum();
    let mut low = ln(total * 1e-12);
    let mut high = ln(total * 4.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if total_cells(sides, &divisions_of(&areas, exp(middle) as f32)) > u64::from(count) {
            low = middle;
        } else {
            high = middle;
        }
    }
    // Both ends of the bracket: take the count that is nearer.
    let fine = divisions_of(&areas, exp(low) as f32);
    let coarse = divisions_of(&areas, exp(high) as f32);
    let miss = |d: &[u32]| total_cells(sides, d).abs_diff(u64::from(count));
    Ok(if miss(&fine) < miss(&coarse) { fine } else { coarse })
}

/// Divisions of every triangle that follow an estimate of the light: from patches of `coarse_area` m² on, edges are
/// halved while the estimate differs by more than `tolerance` between neighbouring grid vertices and patches stay above
/// `fine_area` m². `estimate` is asked at points a little inside the triangle, on every side that has patches.
///
/// # Errors
/// [`transport::Error::Setting`] for an area or tolerance that is not positive, [`transport::Error::Length`].
pub fn divisions_for_gradient(
    scene: &Scene,
    sides: &[Sides],
    coarse_area: f32,
    fine_area: f32,
    tolerance: f32,
    estimate: impl Fn(&SurfacePoint) -> f32 + Sync,
) -> Result<Vec<u32>, Error> {
    check_length("sides", scene.geometry.triangles.len(), sides.len())?;
    check_positive("fine_area", fine_area)?;
    check_positive("tolerance", tolerance)?;
    let start = divisions_for_area(scene, coarse_area)?;
    Ok((0..sides.len())
        .into_par_iter()
        .map(|t| {
            let mut n = start[t];
            let area = triangle_area(scene, t);
            while 2 * n <= MAX_DIVISIONS && area / (4 * n * n) as f32 >= fine_area {
                let steep = [(true, sides[t].front), (false, sides[t].back)].iter().any(|&(front, alive)| {
                    alive
                        && largest_step(n, |i, j| estimate(&vertex_point(scene, t as u32, front, n, i, j))) > tolerance
                });
                if !steep {
                    break;
                }
                n *= 2;
            }
            n
        })
        .collect())
}

/// Greatest difference of a function between neighbouring vertices of a grid.
fn largest_step(n: u32, value: impl Fn(u32, u32) -> f32) -> f32 {
    let mut below = Vec::new();
    let mut worst = 0.0f32;
    for j in 0..=n {
        let row: Vec<f32> = (0..=n - j).map(|i| value(i, j)).collect();
        for pair in row.windows(2) {
            worst = worst.max((pair[1] - pair[0]).abs());
        }
        for (i, x) in row.iter().enumerate().take(below.len()) {
            let (a, b): (f32, f32) = (below[i], below[i + 1]);
            worst = worst.max((x - a).abs()).max((x - b).abs());
        }
        below = row;
    }
    worst
}

/// Grid vertex (i, j) of a triangle side, moved inwards by a twentieth of a cell.
pub(super) fn vertex_point(scene: &Scene, triangle: u32, front: bool, n: u32, i: u32, j: u32) -> SurfacePoint {
    let shares = Vec2::new(i as f32, j as f32) / n as f32;
    side_point(scene, triangle, front, shares + (Vec2::splat(1.0 / 3.0) - shares) * (0.05 / n as f32))
}

/// The point of a triangle side at these shares of its edges.
pub(super) fn side_point(scene: &Scene, triangle: u32, front: bool, shares: Vec2) -> SurfacePoint {
    let geometry = scene.tables();
    let normal = geometry.normal(triangle);
    SurfacePoint {
        position: geometry.position(triangle, shares.x, shares.y),
        patch: NONE,
        normal: if front { normal } else { -normal },
        weight: 1.0,
    }
}

fn table_start(next: &mut u64, alive: bool, count: u32) -> Result<u32, Error> {
    if !alive {
        return Ok(NONE);
    }
    let start = *next;
    *next += u64::from(count);
    if *next > MAX_ENTRIES {
        return Err(transport::Error::TooMany { name: "patches or cells", found: *next, limit: MAX_ENTRIES }.into());
    }
    Ok(start as u32)
}

/// Refuses grids with more cells than can be held, naming the triangle that has most.
pub(super) fn check_cells(scene: &Scene, sides: &[Sides], divisions: &[u32]) -> Result<(), Error> {
    let cells = |k: usize| (u64::from(sides[k].front) + u64::from(sides[k].back)) * u64::from(cell_count(divisions[k]));
    let total: u64 = (0..sides.len()).map(cells).sum();
    match (0..sides.len()).max_by_key(|&k| cells(k)) {
        Some(longest) if total > MAX_CELLS => {
            let length = scene.longest_edge(longest as u32);
            let triangle = scene.geometry.triangles[longest].source;
            Err(Error::LongTriangle { triangle, length, cells: total, limit: MAX_CELLS })
        }
        _ => Ok(()),
    }
}

pub(super) fn number_entries(
    sides: &[Sides],
    divisions: &[u32],
    count: impl Fn(u32) -> u32,
) -> Result<Vec<TriangleGrid>, Error> {
    let mut next = 0;
    let mut grids = Vec::with_capacity(sides.len());
    for (index, (side, &divisions)) in sides.iter().zip(divisions).enumerate() {
        if divisions == 0 || divisions > MAX_DIVISIONS {
            let value = f64::from(divisions);
            return Err(transport::Error::Value { name: "divisions", index, value, rule: "in 1..=4096" }.into());
        }
        let front = table_start(&mut next, side.front, count(divisions))?;
        let back = table_start(&mut next, side.back, count(divisions))?;
        grids.push(TriangleGrid { front, back, divisions, reserved: 0 });
    }
    Ok(grids)
}

/// Numbers the cells of all triangles, `divisions²` on each of their sides.
///
/// # Errors
/// [`transport::Error::Value`] for divisions outside 1..=4096, [`transport::Error::Length`],
/// [`transport::Error::TooMany`].
pub fn cell_grids(sides: &[Sides], divisions: &[u32]) -> Result<Vec<TriangleGrid>, Error> {
    check_length("divisions", sides.len(), divisions.len())?;
    number_entries(sides, divisions, cell_count)
}

struct Cell {
    patch: Patch,
    corners: [Vec3; 3],
    points: Vec<SurfacePoint>,
}

impl Subdivision {
    /// Cuts each triangle into `divisions²` patches on each of its sides. A patch with holes counts only what is solid
    /// as its area.
    ///
    /// # Errors
    /// [`transport::Error::Length`] unless there is one entry of `sides` and `divisions` a triangle,
    /// [`transport::Error::Value`] for divisions outside 1..=4096, [`transport::Error::Setting`] for no points,
    /// [`transport::Error::TooMany`].
    pub fn new(scene: &Scene, sides: &[Sides], divisions: &[u32], points: u32, seed: u32) -> Result<Self, Error> {
        check_length("sides", scene.geometry.triangles.len(), sides.len())?;
        check_length("divisions", scene.geometry.triangles.len(), divisions.len())?;
        check_positive("points", points as f32)?;
        let grids = number_entries(sides, divisions, cell_count)?;
        let cells: Vec<Vec<Cell>> = grids
            .par_iter()
            .enumerate()
            .map(|(triangle, grid)| {
                let mut cells = Vec::new();
                for (front, first) in [(true, grid.front), (false, grid.back)] {
                    if first != NONE {
                        for cell in 0..cell_count(grid.divisions) {
                            let id = first + cell;
                            cells.push(make_cell(
                                scene,
                                triangle as u32,
                                front,
                                grid.divisions,
                                cell,
                                id,
                                points,
                                seed,
                            ));
                        }
                    }
                }
                cells
            })
            .collect();
        let mut out = Self { grids, offsets: vec![0], ..Self::default() };
        for cell in cells.into_iter().flatten() {
            out.patches.push(cell.patch);
            out.corners.push(cell.corners);
            out.points.extend(cell.points);
            let found = out.points.len() as u64;
            if found > MAX_ENTRIES {
                return Err(transport::Error::TooMany { name: "points of patches", found, limit: MAX_ENTRIES }.into());
            }
            out.offsets.push(found as u32);
        }
        Ok(out)
    }

    /// Leaves out what lies inside of solids: sample points to which no light comes give way to those of the same patch
    /// that are open, and the patch's area shrinks in proportion. A patch wholly inside keeps a trace of area.
    ///
    /// In a dark room random walks from many an open point come to no light. So a point is open, too, that sees an open
    /// one of its patch and is not covered.
    pub fn clear_buried(&mut self, scene: &Scene, seed: u32) {
        let mut open: Vec<bool> = (self.points.par_iter().enumerate())
            .map(|(k, point)| is_open(scene, point, POINT_WALKS, hash3(k as u32, 0x6f70_656e, seed)))
            .collect();
        for (i, patch) in self.patches.iter_mut().enumerate() {
            let own = self.offsets[i] as usize..self.offsets[i + 1] as usize;
            let edge = scene::math::sqrt(patch.area / own.len() as f32);
            spread_openness(scene, &self.points[own.clone()], edge, &mut open[own.clone()]);
            let kept: Vec<_> = own.clone().filter(|&k| open[k]).map(|k| self.points[k]).collect();
            patch.area *= (kept.len() as f32).max(0.5) / own.len() as f32;
            if !kept.is_empty() {
                let count = own.len();
                for (k, point) in self.points[own].iter_mut().enumerate() {
                    *point = kept[k * kept.len() / count];
                }
            }
        }
    }

    /// The patch that owns a hit, or [`NONE`].
    pub fn owner(&self, scene: &Scene, hit: &Hit, direction: Vec3) -> u32 {
        if hit.is_miss() {
            return NONE;
        }
        let front = scene.tables().normal(hit.triangle).dot(direction) < 0.0;
        owner(self.grids[hit.triangle as usize], *hit, front)
    }

    /// Areas, m².
    pub fn areas(&self) -> Vec<f32> {
        self.patches.iter().map(|p| p.area).collect()
    }

    /// Outlines for the estimators that need them.
    ///
    /// # Errors
    /// [`transport::Error::PolygonShape`] for a patch without area.
    pub fn polygons(&self) -> Result<Vec<Polygon>, Error> {
        Ok(self.corners.iter().map(|c| Polygon::new(c)).collect::<Result<_, _>>()?)
    }

    /// The patches as rows and as columns. `polygons` may be empty for estimators by rays.
    pub fn surfaces<'a>(&'a self, scene: &'a Scene, polygons: &'a [Polygon]) -> Surfaces<'a> {
        let surfaces = self.surfaces_to(scene, polygons, &self.points, &self.offsets);
        Surfaces { row_polygons: polygons, ..surfaces }
    }

    /// The patches as columns; rows own points, row i `points[offsets[i]..offsets[i + 1]]`.
    pub fn surfaces_to<'a>(
        &'a self,
        scene: &'a Scene,
        polygons: &'a [Polygon],
        points: &'a [SurfacePoint],
        offsets: &'a [u32],
    ) -> Surfaces<'a> {
        Surfaces {
            patches: &self.patches,
            polygons,
            row_polygons: &[],
            points,
            offsets,
            visibility: scene,
            owner: Box::new(|hit, direction| self.owner(scene, hit, direction)),
            ray_offset: scene.geometry.ray_offset,
            seed: 0,
        }
    }
}

/// Opens points of a patch, `edge` m from each other, that see an open one and are not covered.
fn spread_openness(scene: &Scene, points: &[SurfacePoint], edge: f32, open: &mut [bool]) {
    let known: Vec<SurfacePlace> =
        points.iter().zip(&*open).filter(|(_, open)| **open).map(|(p, _)| p.into()).collect();
    for (point, open) in points.iter().zip(open) {
        let place = SurfacePlace::from(point);
        *open = *open
            || !is_covered(scene, place, edge) && known.iter().any(|there| is_visible(scene, place, *there, edge));
    }
}

#[allow(clippy::too_many_arguments)]
fn make_cell(
    scene: &Scene,
    triangle: u32,
    front: bool,
    divisions: u32,
    cell: u32,
    id: u32,
    points: u32,
    seed: u32,
) -> Cell {
    let geometry = scene.tables();
    let (a, b, c) = cell_corners(divisions, cell);
    // From behind, the corners run the other way.
    let (b, c) = if front { (b, c) } else { (c, b) };
    // An additive recurrence (Roberts 2018). A base-2 sequence would go in step with the Sobol blocks of the rays.
    let word = |k: u32, step: u32, salt: u32| unit(k.wrapping_mul(step).wrapping_add(hash3(id, salt, seed)));
    let place = |k: u32| {
        let (x, y) = uniform_triangle((word(k, 0xc13f_a9a9, 0x706f_696e), word(k, 0x91e1_0da6, 0x7473_0000)));
        a + (b - a) * x + (c - a) * y
    };
    let normal = if front { geometry.normal(triangle) } else { -geometry.normal(triangle) };
    let masked = scene.materials[scene.geometry.triangles[triangle as usize].material as usize].mask_texture != NONE;
    let mut places: Vec<_> = (0..points).map(place).collect();
    let mut solid = 1.0;
    if masked {
        let count = MASK_PROBES.max(points);
        let mut kept: Vec<_> = (0..count).map(place).collect();
        kept.retain(|p| !geometry.is_hole(triangle, p.x, p.y));
        // A cell that is all hole keeps a trace of area, so that nothing divides by zero; no ray ever meets it.
        solid = (kept.len() as f32).max(0.5) / count as f32;
        if !kept.is_empty() {
            places = (0..points as usize).map(|k| kept[k * kept.len() / points as usize]).collect();
        }
    }
    let position = |p: Vec2| geometry.position(triangle, p.x, p.y);
    let area = triangle_area(scene, triangle as usize) / (divisions * divisions) as f32 * solid;
    Cell {
        patch: Patch { centroid: position((a + b + c) / 3.0), area, normal, triangle },
        corners: [position(a), position(b), position(c)],
        points: places
            .iter()
            .map(|&p| SurfacePoint { position: position(p), patch: id, normal, weight: 1.0 / points as f32 })
            .collect(),
    }
}

/// Chooses sides and divisions and cuts: the usual way to the patches of a scene.
///
/// # Errors
/// As [`Subdivision::new`] and the functions that choose the divisions.
pub fn subdivide(scene: &Scene, settings: &SubdivideSettings) -> Result<Subdivision, Error> {
    let sides = match settings.sides {
        SidePolicy::Lit => find_lit_sides(scene, |triangle, normal| {
            let triangle = &scene.geometry.triangles[triangle as usize];
            let middle = triangle.corner + (triangle.edge_a + triangle.edge_b) / 3.0;
            settings.density.is_far_and_faces(middle, normal)
        }),
        policy => find_sides(scene, policy),
    };
    let divisions = match settings.size {
        PatchSize::Area(area) => divisions_for_area(scene, area)?,
        PatchSize::Count(count) => divisions_for_count(scene, &sides, &settings.density, count)?,
    };
    let mut subdivision = Subdivision::new(scene, &sides, &divisions, settings.points, settings.seed)?;
    if settings.sides == SidePolicy::Lit {
        subdivision.clear_buried(scene, settings.seed);
    }
    Ok(subdivision)
}
