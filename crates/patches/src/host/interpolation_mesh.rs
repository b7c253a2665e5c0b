//! Receivers: points at which irradiance is evaluated, and the grids of triangle vertices that take their values.

use alloc::vec;
use alloc::vec::Vec;

use glam::{IVec3, Vec2, Vec3, Vec4};
use hashbrown::HashMap;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::parallel::*;
use scene::sampling::hash3;
use scene::{Hit, NONE, POINT_WALKS, ReceiverSet, Scene, Sides, SurfacePoint, Visibility, is_inside, is_open};
use transport::kernel::grid::{cell_corners, cell_count, interpolate_receivers, vertex_at, vertex_count};
use transport::{ReceiverCell, TriangleGrid, check_length};

use super::focus::Density;
use super::subdivide::{MAX_DIVISIONS, check_cells, check_positive, number_entries, side_point, triangle_area};
use crate::error::Error;

/// Least cosine between their normals.
const MIN_COSINE: f32 = 0.995;
/// Most distance of a vertex from the plane of its receiver, as a share of the welding distance.
const MAX_OFFSET: f32 = 0.1;

/// Vertices are moved inwards by this share of an edge between them.
const INWARDS: f32 = 0.05;
/// Sides whose places are looked for together, unless they have more cells than this.
const BLOCK_SIDES: usize = 1 << 14;
const BLOCK_CELLS: u32 = 1 << 16;
/// Further attempts to find light at a cell beside cells that have some.
const ATTEMPTS: u32 = 4;
/// Most divisions along the edge of a cell.
const MAX_WITHIN: f32 = 32.0;

/// Points at which irradiance is wanted: the vertices of a grid on each triangle, those that lie together merged.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct InterpolationMesh {
    /// Per triangle of the scene, where the cells of its sides stand in `cells`.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub grids: Vec<TriangleGrid>,
    /// The cells, and where their vertices stand in `vertices`, [`NONE`] for a cell without; see
    /// [`interpolate_receivers`].
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub cells: Vec<ReceiverCell>,
    /// Per vertex of a cell, its receiver.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub vertices: Vec<u32>,
    /// The receivers, a little inside of a triangle, with the normal of its side; `patch` is their own number.
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    pub points: Vec<SurfacePoint>,
}

/// A side of a triangle.
#[derive(Clone, Copy)]
struct Side {
    triangle: u32,
    front: bool,
    divisions: u32,
    /// First cell.
    first: u32,
}

impl InterpolationMesh {
    /// Vertices of a grid on each side in `sides`: cells whose edges are at most `edge` m long, each cut further until
    /// edges are no longer than `within` says for its middle and its corners and its longest edge; a cell for which it
    /// says nothing asks `otherwise` for its middle, many cells together, and has no vertices where that says nothing
    /// either, at several attempts where other cells of its side have some; one that is smaller than the length has a single one. Vertices closer than `weld` m on nearly the same
    /// plane and side are one receiver. Both lengths grow with [`Density::edge`].
    ///
    /// # Errors
    /// [`transport::Error::Setting`] for an edge that is not positive, [`transport::Error::Length`],
    /// [`transport::Error::TooMany`]; what `otherwise` says.
    pub fn new(
        scene: &Scene,
        density: &Density,
        sides: &[Sides],
        edge: f32,
        weld: f32,
        within: impl Fn(&SurfacePoint, f32) -> Option<f32> + Sync,
        otherwise: impl Fn(&[SurfacePoint], u32) -> Result<Vec<Option<f32>>, Error>,
    ) -> Result<Self, Error> {
        check_length("sides", scene.geometry.triangles.len(), sides.len())?;
        check_positive("edge", edge)?;
        check_positive("weld", weld)?;
        let divisions: Vec<u32> = (0..scene.geometry.triangles.len())
            .map(|t| {
                let edge = edge * density.triangle_edge(&scene.geometry.triangles[t]);
                (scene.longest_edge(t as u32) / edge * (1.0 - 1e-6)).ceil().clamp(1.0, MAX_DIVISIONS as f32) as u32
            })
            .collect();
        check_cells(scene, sides, &divisions)?;
        let grids = number_entries(sides, &divisions, cell_count)?;
        let total: u32 = grids.iter().map(|g| sides_of(g).count() as u32 * cell_count(g.divisions)).sum();
        let cells = vec![ReceiverCell { first: NONE, divisions: 1 }; total as usize];
        let mut new = Self { grids, cells, ..Self::default() };
        let sides = new.sides(scene);
        // The places on all cores, then the receivers one after the other; in blocks, because places are many.
        let mut welder = Welder::new(scene, density, weld);
        for block in blocks(&sides) {
            let mut cells: Vec<Vec<CellPlan>> = block.par_iter().map(|s| side_cells(scene, s, &within)).collect();
            let open: Vec<&mut CellPlan> = cells.iter_mut().flatten().filter(|cell| cell.length.is_none()).collect();
            let middles: Vec<SurfacePoint> = open.iter().map(|cell| cell.middle).collect();
            let lengths = otherwise(&middles, 0)?;
            check_length("lengths", middles.len(), lengths.len())?;
            open.into_iter().zip(lengths).for_each(|(cell, length)| cell.length = length);
            ask_again(&mut cells, &otherwise)?;
            let places: Vec<Vec<(u32, Vec<SurfacePoint>)>> =
                block.par_iter().zip(&cells).map(|(s, cells)| places(scene, s, cells)).collect();
            let found = new.vertices.len() as u64 + places.iter().flatten().map(|p| p.1.len() as u64).sum::<u64>();
            if found >= u64::from(NONE) {
                return Err(transport::Error::TooMany { name: "receivers", found, limit: u64::from(NONE) - 1 }.into());
            }
            let mut vertices = Vec::new();
            for (side, places) in block.iter().zip(places) {
                for (k, (divisions, points)) in (0u32..).zip(places) {
                    if divisions > 0 {
                        let first = (new.vertices.len() + vertices.len()) as u32;
                        new.cells[(side.first + k) as usize] = ReceiverCell { first, divisions };
                        vertices.extend(points);
                    }
                }
            }
            new.vertices.extend(welder.receivers(&vertices));
        }
        new.points = welder.points;
        Ok(new)
    }

    /// Sides that have cells, the largest triangles first: theirs are the safest places.
    fn sides(&self, scene: &Scene) -> Vec<Side> {
        let mut order: Vec<(f32, usize)> = (0..self.grids.len()).map(|t| (triangle_area(scene, t), t)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let sides = order.into_iter().flat_map(|(_, t)| {
            let grid = self.grids[t];
            let side = move |(front, first)| Side { triangle: t as u32, front, divisions: grid.divisions, first };
            sides_of(&grid).map(side)
        });
        sides.collect()
    }

    /// Leaves out receivers that are not good where their cell has a good one: their vertices take that of a good
    /// vertex beside them. Returns what number each of those that are left had. `good` holds one flag a receiver.
    ///
    /// # Errors
    /// [`transport::Error::Length`] for a wrong number of flags.
    pub fn retain(&mut self, scene: &Scene, good: &[bool]) -> Result<Vec<u32>, Error> {
        check_length("good", self.points.len(), good.len())?;
        for side in self.sides(scene) {
            for k in 0..cell_count(side.divisions) {
                let cell = self.cells[(side.first + k) as usize];
                if cell.first == NONE {
                    continue;
                }
                let own = &mut self.vertices[cell.first as usize..(cell.first + vertex_count(cell.divisions)) as usize];
                let count = own.iter().filter(|&&r| good[r as usize]).count();
                if count == 0 || count == own.len() {
                    continue;
                }
                // Only beside a good one: what lies further in is dark, and may be seen from its own side of a wall.
                let n = cell.divisions;
                let at = |i: u32, j: u32| vertex_at(n, i, j) as usize;
                let before = own.to_vec();
                for (i, j) in (0..=n).flat_map(|j| (0..=n - j).map(move |i| (i, j))) {
                    if good[before[at(i, j)] as usize] {
                        continue;
                    }
                    let beside = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, -1), (-1, 1)];
                    let found = beside.iter().find_map(|&(di, dj)| {
                        let x = i.checked_add_signed(di)?;
                        let y = j.checked_add_signed(dj)?;
                        (x + y <= n && good[before[at(x, y)] as usize]).then(|| before[at(x, y)])
                    });
                    if let Some(receiver) = found {
                        own[at(i, j)] = receiver;
                    }
                }
            }
        }
        let mut used = vec![false; self.points.len()];
        self.vertices.iter().for_each(|&r| used[r as usize] = true);
        let mut numbers = vec![NONE; self.points.len()];
        let kept = numbers.iter_mut().zip(&used).filter(|(_, used)| **used);
        kept.zip(0..).for_each(|((number, _), next)| *number = next);
        self.points.retain(|point| used[point.patch as usize]);
        let left = self.points.iter().map(|point| point.patch).collect();
        (self.points.iter_mut().zip(0..)).for_each(|(point, number)| point.patch = number);
        self.vertices.iter_mut().for_each(|r| *r = numbers[*r as usize]);
        Ok(left)
    }

    /// Puts the points into another order: `order[k]` is the number that point k has so far.
    ///
    /// # Errors
    /// [`transport::Error::Length`] unless the order has one number a point.
    pub(super) fn permute(&mut self, order: &[u32]) -> Result<(), Error> {
        check_length("order", self.points.len(), order.len())?;
        let mut numbers = vec![NONE; order.len()];
        for (k, &before) in (0u32..).zip(order) {
            numbers[before as usize] = k;
        }
        self.points =
            (0u32..).zip(order).map(|(k, &old)| SurfacePoint { patch: k, ..self.points[old as usize] }).collect();
        self.vertices.iter_mut().for_each(|point| *point = numbers[*point as usize]);
        Ok(())
    }
}

impl ReceiverSet for InterpolationMesh {
    fn points(&self) -> &[SurfacePoint] {
        &self.points
    }
}

impl InterpolationMesh {
    /// Irradiance at the mesh's own vertices, W/m²: at the corner, the end of `edge_a` and the end of `edge_b` of every
    /// triangle, on its front or its back; zero where that side has no receivers. Corners of different triangles that
    /// share a receiver have the same value, so that a vertex of a smooth mesh may take that of any of its triangles.
    /// `values` holds one entry a receiver.
    ///
    /// # Errors
    /// [`transport::Error::Length`] for a wrong number of values.
    pub fn corner_irradiance(&self, values: &[Vec4], front: bool) -> Result<Vec<[Vec4; 3]>, Error> {
        check_length("values", self.points.len(), values.len())?;
        let corner = |triangle: usize, u: f32, v: f32| {
            let hit = Hit { triangle: triangle as u32, u, v, t: 1.0 };
            interpolate_receivers(&self.grids, &self.cells, &self.vertices, values, hit, front)
        };
        Ok((0..self.grids.len()).map(|t| [corner(t, 0.0, 0.0), corner(t, 1.0, 0.0), corner(t, 0.0, 1.0)]).collect())
    }
}

/// State of a cell before its vertices are placed.
struct CellPlan {
    middle: SurfacePoint,
    /// Longest edge between its vertices, m, if anything says so.
    length: Option<f32>,
    /// True if it is smaller than that, and has one value.
    is_single: bool,
}

/// Sides in blocks, so that what is found about them together fits into memory.
fn blocks(sides: &[Side]) -> Vec<&[Side]> {
    let mut blocks = Vec::new();
    let mut first = 0;
    let mut cells = 0;
    for (k, side) in sides.iter().enumerate() {
        cells += cell_count(side.divisions);
        if cells >= BLOCK_CELLS || k + 1 == sides.len() || k + 1 - first == BLOCK_SIDES {
            blocks.push(&sides[first..=k]);
            first = k + 1;
            cells = 0;
        }
    }
    blocks
}

/// Asks about cells again that have no length beside others of their side that do: chance may have missed them.
fn ask_again(
    sides: &mut [Vec<CellPlan>],
    otherwise: &impl Fn(&[SurfacePoint], u32) -> Result<Vec<Option<f32>>, Error>,
) -> Result<(), Error> {
    for attempt in 1..=ATTEMPTS {
        let is_lit = |side: &&mut Vec<CellPlan>| side.iter().any(|cell| cell.length.is_some());
        let cells = sides.iter_mut().filter(is_lit).flatten();
        let open: Vec<&mut CellPlan> = cells.filter(|cell| cell.length.is_none()).collect();
        let middles: Vec<SurfacePoint> = open.iter().map(|cell| cell.middle).collect();
        let lengths = otherwise(&middles, attempt)?;
        check_length("lengths", middles.len(), lengths.len())?;
        open.into_iter().zip(lengths).for_each(|(cell, length)| cell.length = length);
    }
    Ok(())
}

/// The cells of a side, with what `within` says of them.
fn side_cells(
    scene: &Scene,
    side: &Side,
    within: &(impl Fn(&SurfacePoint, f32) -> Option<f32> + Sync),
) -> Vec<CellPlan> {
    let longest = scene.longest_edge(side.triangle) / side.divisions as f32;
    let cell = |k: u32| {
        let (a, b, c) = cell_corners(side.divisions, k);
        let point = |place: Vec2| side_point(scene, side.triangle, side.front, place);
        let middle = point((a + b + c) / 3.0);
        let here = within(&middle, longest);
        let near = |p: Vec2, q: Vec2, r: Vec2| point(p * 0.9 + (q + r) * 0.05);
        let corners = [near(a, b, c), near(b, c, a), near(c, a, b)];
        if here.is_some_and(|length| longest <= length) {
            // Its middle may be inside of what stands on it.
            let outside = [middle].into_iter().chain(corners).find(|place| !is_inside(scene, place));
            return CellPlan { middle: outside.unwrap_or(middle), length: here, is_single: true };
        }
        // A cell may lie across the border of what is lit.
        let corners = corners.map(|corner| within(&corner, longest));
        CellPlan { middle, length: corners.into_iter().flatten().chain(here).reduce(f32::min), is_single: false }
    };
    (0..cell_count(side.divisions)).map(cell).collect()
}

/// Divisions and places of the vertices of each cell of a side; divisions of 0 for a cell without.
fn places(scene: &Scene, side: &Side, cells: &[CellPlan]) -> Vec<(u32, Vec<SurfacePoint>)> {
    let longest = scene.longest_edge(side.triangle) / side.divisions as f32;
    let vertices = |(k, cell): (u32, &CellPlan)| {
        let Some(length) = cell.length else { return (0, Vec::new()) };
        // All vertices are its middle.
        if cell.is_single {
            return (1, vec![cell.middle; 3]);
        }
        let divisions = (longest / length * (1.0 - 1e-6)).ceil().clamp(1.0, MAX_WITHIN) as u32;
        (divisions, cell_vertices(scene, side, k, divisions, cell.middle.position))
    };
    (0u32..).zip(cells).map(vertices).collect()
}

/// Places (u, v) of the vertices of cell `k` of a side, in their order.
fn vertex_places(side: &Side, k: u32, divisions: u32) -> impl Iterator<Item = Vec2> + use<> {
    let (a, b, c) = cell_corners(side.divisions, k);
    let step = 1.0 / divisions as f32;
    (0..=divisions).flat_map(move |j| {
        (0..=divisions - j).map(move |i| a + (b - a) * (i as f32 * step) + (c - a) * (j as f32 * step))
    })
}

/// The receivers that the vertices of cell `k` of a side would have alone: a little inwards, and visible from its
/// middle.
fn cell_vertices(scene: &Scene, side: &Side, k: u32, divisions: u32, middle: Vec3) -> Vec<SurfacePoint> {
    let third = Vec2::splat(1.0 / 3.0);
    let inwards = INWARDS / (side.divisions * divisions) as f32;
    let mut open = None;
    vertex_places(side, k, divisions)
        .map(|place| {
            let place = place + (third - place) * inwards;
            visible_vertex(scene, middle, side_point(scene, side.triangle, side.front, place), &mut open)
        })
        .collect()
}

/// Moves a vertex that lies behind a wall through which its triangle passes to this side of the wall: to where the ray
/// from the middle of its cell comes. A middle that is buried in what stands on the surface judges nobody; `open` keeps
/// whether it is not.
fn visible_vertex(scene: &Scene, middle: Vec3, vertex: SurfacePoint, open: &mut Option<bool>) -> SurfacePoint {
    let offset = vertex.position - middle;
    let length = offset.length();
    if length <= 0.0 {
        return vertex;
    }
    let direction = offset / length;
    let hit = scene.closest_before(middle + vertex.normal * scene.geometry.ray_offset, direction, length);
    if hit.is_miss() {
        return vertex;
    }
    let seed = hash3(middle.x.to_bits(), middle.y.to_bits(), middle.z.to_bits());
    if !*open.get_or_insert_with(|| is_open(scene, &SurfacePoint { position: middle, ..vertex }, POINT_WALKS, seed)) {
        return vertex;
    }
    SurfacePoint { position: middle + direction * (0.8 * hit.t), ..vertex }
}

/// Sides of a triangle that have entries: whether it is the front, and the first entry.
fn sides_of(grid: &TriangleGrid) -> impl Iterator<Item = (bool, u32)> + use<> {
    [(true, grid.front), (false, grid.back)].into_iter().filter(|&(_, first)| first != NONE)
}

/// Receivers by the cell of space that they are in: those from number `first` on.
struct Cells {
    density: Density,
    /// Distance of receivers that are one, in the focus, m.
    distance: f32,
    first: u32,
    /// The last receiver of each cell, level by level.
    last: HashMap<(u32, IVec3), u32>,
    /// For each receiver the one before it in its cell, or [`NONE`].
    before: Vec<u32>,
}

/// A receiver that may serve a vertex. Of those at the same distance the one with the least `order` does.
#[derive(Clone, Copy)]
struct Found {
    squared: f32,
    order: u32,
    receiver: u32,
}

/// The cells about a place, its own first: that holds most of what is found.
const ABOUT: [u32; 27] =
    [13, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26];
/// Rounding tolerance of a place in edges of a cell, as a share of it.
const ROUNDING: f32 = 1e-6;
/// Most distance of a receiver from the plane of a vertex, in edges of a cell: [`MAX_OFFSET`], and what the difference
/// of their normals adds.
const MAX_HEIGHT: f32 = 0.21;

impl Cells {
    fn new(density: &Density, distance: f32, first: usize) -> Self {
        Self { density: *density, distance, first: first as u32, last: HashMap::new(), before: Vec::new() }
    }

    /// Distance of receivers about a place that are one, m.
    fn distance(&self, place: Vec3) -> f32 {
        self.distance * self.density.edge(place)
    }

    fn add(&mut self, point: &SurfacePoint) {
        let place = point.position;
        let cell = (self.density.level(place), (place / self.distance(place)).floor().as_ivec3());
        let number = self.first + self.before.len() as u32;
        self.before.push(self.last.insert(cell, number).unwrap_or(NONE));
    }

    /// The nearest receiver of the same side and nearly the same plane as `point`, if it comes before `best`. The order
    /// is that of the cells, in a cell the newest first; `is_older` says that these receivers are older than those of
    /// `best`.
    fn nearest(&self, points: &[SurfacePoint], point: &SurfacePoint, is_older: bool, mut best: Found) -> Found {
        let level = self.density.level(point.position);
        let distance = self.distance(point.position);
        let place = point.position / distance;
        let home = place.floor();
        let about = About { within: place - home, normal: point.normal, slack: ROUNDING * place.abs().max_element() };
        for k in ABOUT {
            let step = IVec3::new(k as i32 % 3 - 1, k as i32 / 3 % 3 - 1, k as i32 / 9 - 1);
            if about.is_beyond(step.as_vec3(), best.squared / (distance * distance)) {
                continue;
            }
            let order = 2 * k + u32::from(is_older);
            let mut next = self.last.get(&(level, home.as_ivec3() + step)).copied().unwrap_or(NONE);
            while next != NONE {
                let receiver = next;
                next = self.before[(receiver - self.first) as usize];
                let there = &points[receiver as usize];
                let squared = point.position.distance_squared(there.position);
                let is_first = squared < best.squared || squared == best.squared && order < best.order;
                if is_first && are_of_one_plane(point, there, distance) {
                    best = Found { squared, order, receiver };
                }
            }
        }
        best
    }
}

/// Returns true if a vertex is on the side of a receiver and nearly in its plane; those within `distance` m are one.
fn are_of_one_plane(point: &SurfacePoint, there: &SurfacePoint, distance: f32) -> bool {
    let offset = (point.position - there.position).dot(there.normal).abs();
    point.normal.dot(there.normal) >= MIN_COSINE && offset <= MAX_OFFSET * distance
}

/// A place in its cell, in edges of a cell.
struct About {
    within: Vec3,
    normal: Vec3,
    slack: f32,
}

impl About {
    /// Returns true if no receiver of the cell at this step can serve: all are further than the root of `squared`, or
    /// too far from the plane.
    fn is_beyond(&self, step: Vec3, squared: f32) -> bool {
        let gap = (step - self.within).max(self.within - step - 1.0) - self.slack;
        if gap.max(Vec3::ZERO).length_squared() * (1.0 - ROUNDING) > squared {
            return true;
        }
        let half = 0.5 * self.normal.abs().element_sum();
        self.normal.dot(step + 0.5 - self.within).abs() > half + MAX_HEIGHT + 3.0 * self.slack
    }
}

/// Makes receivers of vertices.
struct Welder<'a> {
    scene: &'a Scene,
    cells: Cells,
    points: Vec<SurfacePoint>,
}

/// The receiver of a vertex, and the one nearest to it: an older receiver, a vertex of the same block (numbered after
/// those), or [`NONE`].
#[derive(Clone, Copy)]
struct Joined {
    receiver: u32,
    nearest: u32,
}

impl<'a> Welder<'a> {
    fn new(scene: &'a Scene, density: &Density, distance: f32) -> Self {
        Self { scene, cells: Cells::new(density, distance, 0), points: Vec::new() }
    }

    /// The receiver of each vertex, one after the other: the nearest there is with nothing between, or a new one.
    ///
    /// The nearest of the receivers before the first vertex are found on all cores. So is what stands between, after
    /// all vertices were joined as if nothing did; where something does, they are joined once more.
    fn receivers(&mut self, vertices: &[SurfacePoint]) -> Vec<u32> {
        // The vertices of a cell with a single value are in one place.
        let is_same = |a: &SurfacePoint, b: &SurfacePoint| a.position == b.position && a.normal == b.normal;
        let mut places = vertices.to_vec();
        places.dedup_by(|a, b| is_same(a, b));
        let receivers = self.receivers_of_places(&places);
        let mut place = 0;
        let of_vertex = |vertex: &SurfacePoint| {
            place += usize::from(!is_same(vertex, &places[place]));
            receivers[place]
        };
        vertices.iter().map(of_vertex).collect()
    }

    /// [`Self::receivers`] of places of which no two that follow each other are the same.
    fn receivers_of_places(&mut self, vertices: &[SurfacePoint]) -> Vec<u32> {
        let first = self.points.len();
        let search = |vertex: &SurfacePoint| {
            let distance = self.cells.distance(vertex.position);
            let nothing = Found { squared: distance * distance, order: 0, receiver: NONE };
            self.cells.nearest(&self.points, vertex, true, nothing)
        };
        let older: Vec<Found> = vertices.par_iter().map(search).collect();
        let mut joined = self.join(vertices, &older, &|_, _, _| false);
        let hidden: Vec<bool> = (vertices.par_iter().zip(&joined))
            .map(|(vertex, join)| join.nearest != NONE && self.is_hidden(vertex, &self.points[join.receiver as usize]))
            .collect();
        if hidden.contains(&true) {
            self.points.truncate(first);
            let before = joined;
            joined = self.join(vertices, &older, &|welder, k, best| {
                if before[k].nearest == best.nearest {
                    return hidden[k];
                }
                welder.is_hidden(&vertices[k], &welder.points[best.receiver as usize])
            });
        }
        for point in &self.points[first..] {
            self.cells.add(point);
        }
        joined.iter().map(|join| join.receiver).collect()
    }

    /// Joins vertices with the nearest receivers that are not hidden, as `is_hidden(self, vertex, nearest)` says.
    /// `older` are the nearest receivers before the first vertex.
    fn join(
        &mut self,
        vertices: &[SurfacePoint],
        older: &[Found],
        is_hidden: &dyn Fn(&Self, usize, Joined) -> bool,
    ) -> Vec<Joined> {
        let first = self.points.len() as u32;
        let mut cells = Cells::new(&self.cells.density, self.cells.distance, first as usize);
        let mut made_by: Vec<u32> = Vec::new();
        let mut joined = Vec::with_capacity(vertices.len());
        for (k, (vertex, older)) in vertices.iter().zip(older).enumerate() {
            let receiver = cells.nearest(&self.points, vertex, false, *older).receiver;
            let is_older = receiver == NONE || receiver < first;
            let nearest = if is_older { receiver } else { first + made_by[(receiver - first) as usize] };
            let mut join = Joined { receiver, nearest };
            if nearest == NONE || is_hidden(self, k, join) {
                join.receiver = self.points.len() as u32;
                let point = SurfacePoint { patch: join.receiver, ..*vertex };
                self.points.push(point);
                cells.add(&point);
                made_by.push(k as u32);
            }
            joined.push(join);
        }
        joined
    }

    /// Returns true if something stands between a vertex and a receiver.
    fn is_hidden(&self, vertex: &SurfacePoint, receiver: &SurfacePoint) -> bool {
        // High enough to pass over the curvature that welding allows.
        let height = self.scene.geometry.ray_offset + MAX_OFFSET * self.cells.distance(vertex.position);
        let lift = (vertex.normal + receiver.normal) * height;
        self.scene.any_hit(vertex.position + lift, receiver.position + lift)
    }
}
