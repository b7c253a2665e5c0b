//! Rows that change with what moves: those of its own points, and those of elements and receivers whose rays it meets.
//!
//! A row is a count of rays by element. An object in front of an element takes that element's rays over: the column of
//! the element is replaced by that of the object's. The rays that go to the sky are no entries of such rows; those that
//! meet an object now become entries of it.

use std::ops::Range;

use formfactor::add_quadrant_rows;
use glam::{Affine3A, Mat3, UVec2, Vec3};
use patches::Columns;
use rayon::prelude::*;
use scene::{Geometry, Hit, NONE, SKY_BINS, SurfacePoint, sky_bin, sky_direction};
use transport::kernel::hits::COUNT_STEP;
use transport::{Csr, HitCounts, LinearOperator as _, Owner, Patch, QUADRANTS, Surfaces, quad_columns, quad_of};

use crate::bake::Bake;
use crate::error::Error;
use crate::low_level::stage::objects::ItemChange;
use crate::method::firstshot::ignore_progress;

/// An object is not looked for where it covers less than this share of the hemisphere.
const MIN_COVER: f32 = 0.002;

/// By how much a box about an object is larger than it, as a share of its longest edge: rays and boxes are rounded
/// apart.
const MARGIN: f32 = 1e-4;

/// Place of an object: the ball about it, and the box in its own space.
#[derive(Clone, Copy, Debug)]
pub struct Ball {
    pub middle: Vec3,
    pub radius: f32,
    to_own: Affine3A,
    low: Vec3,
    high: Vec3,
}

impl Ball {
    /// About triangles of a geometry that a transform has put there.
    pub fn of(geometry: &Geometry, triangles: Range<usize>, transform: &Affine3A) -> Self {
        let own = &geometry.triangles[triangles];
        let corners = || own.iter().flat_map(|t| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b]);
        let low = corners().fold(Vec3::INFINITY, Vec3::min);
        let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
        let middle = 0.5 * (low + high);
        let radius = corners().map(|corner| corner.distance(middle)).fold(0.0, f32::max);
        let to_own = transform.inverse();
        let inside = |low: Vec3, corner: Vec3| low.min(to_own.transform_point3(corner));
        let outside = |high: Vec3, corner: Vec3| high.max(to_own.transform_point3(corner));
        let low = corners().fold(Vec3::INFINITY, inside);
        let high = corners().fold(Vec3::NEG_INFINITY, outside);
        let margin = MARGIN * (high - low).max_element();
        let (low, high) = (low - margin, high + margin);
        Self { middle, radius, to_own, low, high }
    }

    /// Returns true if the ball covers enough of what a point sees.
    fn is_near(&self, position: Vec3, normal: Vec3) -> bool {
        let to = self.middle - position;
        let distance = to.length_squared();
        let radius = self.radius * self.radius;
        (radius >= 2.0 * MIN_COVER * distance) && to.dot(normal) > -self.radius
    }

    /// Returns true if the way from a point by `way` comes near, up to `longest` times its length.
    fn is_met(&self, position: Vec3, way: Vec3, longest: f32) -> bool {
        let to = self.middle - position;
        let t = (to.dot(way) / way.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, longest);
        (to - way * t).length_squared() <= self.radius * self.radius
    }
}

/// What moves, for rays from anywhere.
pub struct Movers<'a> {
    /// The geometry with what moves.
    pub geometry: &'a Geometry,
    pub balls: &'a [Ball],
    /// What rests.
    pub elements: &'a [Patch],
    /// Places above their middles.
    pub middles: &'a [Vec3],
    /// Column of the first element of what moves.
    pub first_column: u32,
}

/// A row, or the rows of a receiver's quadrants, that an object changes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowChange {
    /// The element, or the receiver.
    pub item: u32,
    /// Quads of rows over elements some of whose columns are those of objects, by their number.
    pub quads: Vec<(u32, UVec2)>,
    /// Quads of rows over bins of the sky some of which are covered: the dark one stands in their place.
    pub sky: Vec<(u32, UVec2)>,
    /// Of each quadrant, a column that it meets instead of the sky, and how often.
    pub more: [Option<(u32, u32)>; QUADRANTS],
}

impl RowChange {
    /// What changes of rows over elements.
    pub fn of_elements(&self) -> ItemChange<'_> {
        ItemChange { item: self.item, quads: &self.quads, more: &self.more }
    }

    /// What changes of rows over bins of the sky.
    pub fn of_sky(&self) -> ItemChange<'_> {
        ItemChange { item: self.item, quads: &self.sky, more: &[] }
    }
}

/// What rows change by.
pub fn item_changes(changes: &[RowChange], of: impl Fn(&RowChange) -> ItemChange<'_>) -> Vec<ItemChange<'_>> {
    changes.iter().map(of).collect()
}

/// Directions and distances from a point in which an object's ball and box are met.
#[derive(Clone, Copy, Debug)]
struct Cone {
    way: Vec3,
    /// Squares of the length to the edge of the ball, and of the shortest length that meets it.
    edge: f32,
    shortest: f32,
    /// Corners of the box from the point, and the way there, in the space of the object.
    low: Vec3,
    high: Vec3,
    to_own: Mat3,
}

impl Cone {
    fn new(ball: &Ball, from: Vec3) -> Self {
        let way = ball.middle - from;
        let beyond = (way.length() - ball.radius).max(0.0);
        // Met all about from inside.
        let edge = way.length_squared() - ball.radius * ball.radius;
        let own = ball.to_own.transform_point3(from);
        let to_own = Mat3::from(ball.to_own.matrix3);
        Self { way, edge, shortest: beyond * beyond, low: ball.low - own, high: ball.high - own, to_own }
    }

    /// Returns true for those of four ways, by their coordinates, that meet the box.
    fn meets(&self, [x, y, z]: [[f32; 4]; 3]) -> [bool; 4] {
        let mut first = [0.0f32; 4];
        let mut last = [1.0f32; 4];
        for axis in 0..3 {
            let row = self.to_own.row(axis);
            let (low, high) = (self.low[axis], self.high[axis]);
            for k in 0..4 {
                let share = 1.0 / (x[k] * row.x + y[k] * row.y + z[k] * row.z);
                let (a, b) = (low * share, high * share);
                first[k] = first[k].max(a.min(b));
                last[k] = last[k].min(a.max(b));
            }
        }
        let mut met = [false; 4];
        (0..4).for_each(|k| met[k] = first[k] <= last[k]);
        met
    }

    /// Returns true for those of four ways, by their coordinates, that may meet the ball.
    fn holds(&self, [x, y, z]: [[f32; 4]; 3]) -> [bool; 4] {
        let mut met = [false; 4];
        for k in 0..4 {
            let along = x[k] * self.way.x + y[k] * self.way.y + z[k] * self.way.z;
            let length = x[k] * x[k] + y[k] * y[k] + z[k] * z[k];
            let is_within = (along > 0.0) & (along * along >= length * self.edge);
            met[k] = (length >= self.shortest) & (is_within | (self.edge <= 0.0));
        }
        met
    }
}

impl Movers<'_> {
    /// Column of what moves on the way from a point by `way`, up to `longest` times its length.
    fn on_the_way(&self, near: &[Ball], position: Vec3, way: Vec3, longest: f32) -> Option<u32> {
        if !near.iter().any(|ball| ball.is_met(position, way, longest)) {
            return None;
        }
        self.met(position, way, longest)
    }

    /// [`Self::on_the_way`] of a way that comes near.
    fn met(&self, position: Vec3, way: Vec3, longest: f32) -> Option<u32> {
        let hit = self.geometry.closest_moving(position, way, longest);
        (hit.triangle != NONE).then(|| self.column(hit.triangle))
    }

    fn column(&self, triangle: u32) -> u32 {
        self.first_column + (triangle - self.geometry.moving().start as u32)
    }

    fn near(&self, position: Vec3, normal: Vec3) -> Vec<Ball> {
        self.balls.iter().filter(|ball| ball.is_near(position, normal)).copied().collect()
    }

    /// Quads of rows that begin at a point in which a column meets what moves on its way.
    fn replaced(&self, near: &[Ball], from: Vec3, rows: &HitCounts, own: Range<usize>) -> Vec<(u32, UVec2)> {
        let cones: Vec<Cone> = near.iter().map(|ball| Cone::new(ball, from)).collect();
        let own = rows.row_start()[own.start]..rows.row_start()[own.end];
        let mut changed = Vec::new();
        for number in own {
            let columns = quad_columns(rows.quads()[number as usize]);
            let ways = columns.map(|column| self.middles[column as usize] - from);
            let parts = [ways.map(|way| way.x), ways.map(|way| way.y), ways.map(|way| way.z)];
            let mut met = [false; 4];
            for cone in &cones {
                let held = cone.holds(parts);
                if held != [false; 4] {
                    let by_one = cone.meets(parts);
                    (0..4).for_each(|k| met[k] |= held[k] & by_one[k]);
                }
            }
            if met == [false; 4] {
                continue;
            }
            let mut now = columns;
            for k in (0..4).filter(|&k| met[k]) {
                now[k] = self.met(from, ways[k], 1.0).unwrap_or(columns[k]);
            }
            if now != columns {
                changed.push((number, quad_of(now)));
            }
        }
        changed
    }

    /// Rows of elements that change.
    pub fn element_changes(&self, rows: &HitCounts) -> Vec<RowChange> {
        let change = |(item, element): (usize, &Patch)| {
            let near = self.near(element.centroid, element.normal);
            if near.is_empty() {
                return None;
            }
            let from = element.centroid + element.normal * self.geometry.ray_offset;
            let quads = self.replaced(&near, from, rows, item..item + 1);
            (!quads.is_empty()).then(|| RowChange { item: item as u32, quads, ..RowChange::default() })
        };
        self.elements.par_iter().enumerate().filter_map(change).collect()
    }

    /// Rows of receivers that change, over the elements and over the bins of the sky.
    pub fn receiver_changes(
        &self,
        receivers: &[SurfacePoint],
        rows: &HitCounts,
        sky_rows: &HitCounts,
    ) -> Vec<RowChange> {
        let change = |(item, receiver): (usize, &SurfacePoint)| {
            let near = self.near(receiver.position, receiver.normal);
            if near.is_empty() {
                return None;
            }
            let from = receiver.position + receiver.normal * self.geometry.ray_offset;
            let own = QUADRANTS * item..QUADRANTS * (item + 1);
            let quads = self.replaced(&near, from, rows, own.clone());
            let mut change = RowChange { item: item as u32, quads, ..RowChange::default() };
            for (more, row) in change.more.iter_mut().zip(own) {
                let mut met = Vec::new();
                let sky = changed_quads(sky_rows, row..row + 1, |bin| {
                    let column = self.on_the_way(&near, from, sky_direction(bin), f32::INFINITY)?;
                    met.push(column);
                    // The bin behind the last is dark.
                    Some(SKY_BINS as u32)
                });
                *more = most_met(&met, covered(sky_rows, &sky));
                change.sky.extend(sky);
            }
            (!change.quads.is_empty() || !change.sky.is_empty()).then_some(change)
        };
        receivers.par_iter().enumerate().filter_map(change).collect()
    }

    /// Rows of points of what moves, over the elements at rest and those that move, and over the bins of the sky.
    pub fn traced(&self, bake: &Bake, points: &[SurfacePoint], rays: u32, seed: u32) -> Result<[Csr; 2], Error> {
        let offsets: Vec<u32> = (0..=points.len() as u32).collect();
        let mesh = &bake.mesh;
        let first_moving = self.geometry.moving().start as u32;
        let moving = self.geometry.moving().len();
        let columns = self.first_column as usize + moving;
        let patches = vec![Patch::default(); columns];
        let owner: Owner = Box::new(|hit: &Hit, direction: Vec3| {
            if hit.triangle == NONE || hit.triangle < first_moving {
                return mesh.element(&bake.scene, hit, direction);
            }
            let t = &self.geometry.triangles[hit.triangle as usize];
            // The inside of an object sends nothing.
            if t.edge_a.cross(t.edge_b).dot(direction) < 0.0 { self.column(hit.triangle) } else { NONE }
        });
        let at_rest = mesh.lighting(&bake.scene, Columns::Elements, points, &offsets, seed);
        let surfaces = Surfaces { patches: &patches, visibility: self.geometry, owner, ..at_rest };
        let mut rows = HitCounts::new(columns)?;
        let mut sky = HitCounts::new(SKY_BINS)?;
        add_quadrant_rows(&mut rows, (&mut sky, &sky_bin), &surfaces, rays, &ignore_progress)?;
        Ok([whole_rows(&rows)?, whole_rows(&sky)?])
    }
}

/// Quads of rows in which columns are replaced.
fn changed_quads(rows: &HitCounts, own: Range<usize>, mut column: impl FnMut(u32) -> Option<u32>) -> Vec<(u32, UVec2)> {
    let own = rows.row_start()[own.start]..rows.row_start()[own.end];
    let mut changed = Vec::new();
    for number in own {
        let before = quad_columns(rows.quads()[number as usize]);
        let after = before.map(|own| column(own).unwrap_or(own));
        if after != before {
            changed.push((number, quad_of(after)));
        }
    }
    changed
}

/// Rays that went to what is dark now.
fn covered(rows: &HitCounts, changed: &[(u32, UVec2)]) -> u32 {
    let dark = |quad: UVec2| quad_columns(quad).into_iter().filter(|&bin| bin == SKY_BINS as u32).count() as u32;
    let steps: u32 = changed.iter().map(|&(number, quad)| u32::from(rows.counts()[number as usize]) * dark(quad)).sum();
    (steps as f32 * COUNT_STEP).round() as u32
}

/// All of these hits go to the column that is met most.
fn most_met(met: &[u32], hits: u32) -> Option<(u32, u32)> {
    let times = |column: u32| met.iter().filter(|&&own| own == column).count();
    let most = met.iter().map(|&column| (times(column), column)).max();
    most.map(|(_, column)| (column, hits))
}

/// Rows of whole hemispheres from those of quadrants.
fn whole_rows(quadrants: &HitCounts) -> Result<Csr, Error> {
    let (count, columns) = quadrants.shape();
    let groups: Vec<u32> = (0..=count as u32).step_by(QUADRANTS).collect();
    let own: Vec<u32> = (0..columns as u32).collect();
    Ok(quadrants.means(&groups, &vec![1.0; count], &own, columns)?)
}
