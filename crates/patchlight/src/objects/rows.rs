//! Rows that change with what moves: those of its own points, and those of elements and receivers whose rays it meets.
//!
//! A row is a count of rays by element. An object in front of an element takes that element's rays over: the column of
//! the element is replaced by that of the object's. The rays that go to the sky are no entries of such rows; those that
//! meet an object now become entries of it.

use formfactor::add_quadrant_rows;
use glam::Vec3;
use patches::Columns;
use rayon::prelude::*;
use scene::{Geometry, Hit, NONE, SKY_BINS, SurfacePoint, sky_bin, sky_direction};
use transport::{Csr, HitCounts, LinearOperator as _, Owner, Patch, QUADRANTS, Surfaces};

use crate::bake::Bake;
use crate::error::Error;
use crate::method::firstshot::ignore_progress;

/// An object is not looked for where it covers less than this share of the hemisphere.
const MIN_COVER: f32 = 0.002;

/// Place of an object: the ball about it.
#[derive(Clone, Copy, Debug)]
pub struct Ball {
    pub middle: Vec3,
    pub radius: f32,
}

impl Ball {
    /// About triangles of a geometry.
    pub fn of(geometry: &Geometry, triangles: std::ops::Range<usize>) -> Self {
        let own = &geometry.triangles[triangles];
        let corners = || own.iter().flat_map(|t| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b]);
        let low = corners().fold(Vec3::INFINITY, Vec3::min);
        let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
        let middle = 0.5 * (low + high);
        Self { middle, radius: corners().map(|corner| corner.distance(middle)).fold(0.0, f32::max) }
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
        let t = (to.dot(way) / way.length_squared()).clamp(0.0, longest);
        (to - way * t).length_squared() <= self.radius * self.radius
    }
}

/// What moves, for rays from anywhere.
pub struct Movers<'a> {
    /// The geometry with what moves.
    pub geometry: &'a Geometry,
    pub balls: &'a [Ball],
    /// Column of the first element of what moves.
    pub first_column: u32,
}

/// A row, or the rows of a receiver's quadrants, that an object changes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowChange {
    /// The element, or the receiver.
    pub item: u32,
    /// Columns that are replaced, ascending, and by which.
    pub columns: Vec<(u32, u32)>,
    /// Bins of the sky that are covered, ascending.
    pub bins: Vec<u32>,
    /// Of each quadrant, a column that it meets instead of the sky, and how often.
    pub more: [Option<(u32, u32)>; QUADRANTS],
}

impl RowChange {
    /// The column in place of one.
    pub fn column(&self, column: u32) -> u32 {
        match self.columns.binary_search_by_key(&column, |own| own.0) {
            Ok(k) => self.columns[k].1,
            Err(_) => column,
        }
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

    /// Columns of rows that begin at a point which meet what moves on their way.
    fn replaced(
        &self,
        near: &[Ball],
        from: Vec3,
        elements: &[Patch],
        columns: impl Iterator<Item = u32>,
    ) -> Vec<(u32, u32)> {
        let offset = self.geometry.ray_offset;
        let way = |column: u32| {
            let element = &elements[column as usize];
            element.centroid + element.normal * offset - from
        };
        // Most columns are nowhere near, and stand in the row several times.
        let comes_near = |&column: &u32| {
            let way = way(column);
            near.iter().any(|ball| ball.is_met(from, way, 1.0))
        };
        let mut met: Vec<u32> = columns.filter(comes_near).collect();
        met.sort_unstable();
        met.dedup();
        met.into_iter().filter_map(|column| Some((column, self.met(from, way(column), 1.0)?))).collect()
    }

    /// Rows of elements that change.
    pub fn element_changes(&self, elements: &[Patch], rows: &HitCounts) -> Vec<RowChange> {
        let change = |(item, element): (usize, &Patch)| {
            let near = self.near(element.centroid, element.normal);
            if near.is_empty() {
                return None;
            }
            let from = element.centroid + element.normal * self.geometry.ray_offset;
            let columns = self.replaced(&near, from, elements, rows.quad_columns(item));
            (!columns.is_empty()).then(|| RowChange { item: item as u32, columns, ..RowChange::default() })
        };
        elements.par_iter().enumerate().filter_map(change).collect()
    }

    /// Rows of receivers that change, over the elements and over the bins of the sky.
    pub fn receiver_changes(
        &self,
        elements: &[Patch],
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
            let columns = own.clone().flat_map(|row| rows.quad_columns(row));
            let columns = self.replaced(&near, from, elements, columns);
            let mut change = RowChange { item: item as u32, columns, ..RowChange::default() };
            for (more, row) in change.more.iter_mut().zip(own) {
                let mut met: Vec<(u32, u32)> = Vec::new();
                for (bin, count) in sky_rows.row(row) {
                    if let Some(column) = self.on_the_way(&near, from, sky_direction(bin), f32::INFINITY) {
                        change.bins.push(bin);
                        met.push((column, count));
                    }
                }
                // All of them to the element that is met most.
                let hits = met.iter().map(|own| own.1).sum();
                let times = |column: u32| met.iter().filter(|own| own.0 == column).map(|own| own.1).sum::<u32>();
                let most = met.iter().map(|own| (times(own.0), own.0)).max();
                *more = most.map(|(_, column)| (column, hits));
            }
            change.bins.sort_unstable();
            change.bins.dedup();
            (!change.columns.is_empty() || !change.bins.is_empty()).then_some(change)
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

/// Rows of whole hemispheres from those of quadrants.
fn whole_rows(quadrants: &HitCounts) -> Result<Csr, Error> {
    let (count, columns) = quadrants.shape();
    let groups: Vec<u32> = (0..=count as u32).step_by(QUADRANTS).collect();
    let own: Vec<u32> = (0..columns as u32).collect();
    Ok(quadrants.means(&groups, &vec![1.0; count], &own, columns)?)
}
