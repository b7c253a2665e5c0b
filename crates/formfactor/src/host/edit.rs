//! Rows of rays some of which meet something else than before, because surfaces were taken away, added or given to other
//! patches: those rays alone are traced again.

use alloc::vec::Vec;
use core::f32::consts::{FRAC_PI_2, PI, TAU};

use bytemuck::{Pod, Zeroable};
use glam::{UVec2, Vec3};
use scene::parallel::*;
use scene::sampling::{frame, sobol2_fast};
use scene::{NONE, SurfacePoint, math};
use transport::{EditedRow, HitCounts, LinearOperator as _, Proceed, QUADRANTS, Surfaces, check_length, quadrant_of};

use super::estimate::{SkyBin, numbered_params, ray_column};
use crate::error::Error;
use crate::kernel::hemisphere::{origin_of_ray, ray_from, shift_of_row};
use crate::types::HemisphereParams;

/// Rows that are coded together.
const BLOCK_ROWS: usize = 1 << 11;

/// Source of the random numbers of a row of rays: those of a row that stays are the same for ever.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct RowKey {
    /// Seed of the surfaces under which the row was made.
    pub seed: u32,
    /// Its number among their rows.
    pub number: u32,
}

/// What rays met before, and what they meet now.
pub struct RowEdit<'a> {
    /// Surfaces so far. Of both only what rays meet is asked, not the rows.
    pub before: &'a Surfaces<'a>,
    /// Surfaces now.
    pub after: &'a Surfaces<'a>,
    /// Returns true for a ray, by its origin and direction, that may meet what is gone, has come, or has another owner.
    pub may_meet: &'a (dyn Fn(Vec3, Vec3) -> bool + Sync),
    /// Middles and radii of balls that hold all of that, m: few, for rays that meet none of them are not asked.
    pub balls: &'a [(Vec3, f32)],
    /// Column that each column so far has now; [`NONE`] for one that is gone.
    pub columns: &'a [u32],
    /// Number of rays of each row.
    pub rays: u32,
}

/// A row that stays.
#[derive(Clone, Copy, Debug)]
pub struct KeptRow<'a> {
    /// Its number among the rows so far.
    pub row: usize,
    /// Source of its random numbers.
    pub key: RowKey,
    /// Origins of its rays.
    pub points: &'a [SurfacePoint],
}

/// Result of an edit of rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowChanges {
    /// For each row, by how much its sky factor grew.
    pub sky_factor: Vec<f32>,
    /// Number of rays that were traced.
    pub traced: u64,
}

/// Counts of one row after the edit.
struct NewRow {
    /// Its parts.
    parts: Vec<EditedRow>,
    sky_parts: Vec<EditedRow>,
    /// Rays that escape more than before.
    escaped: i64,
    traced: u64,
}

/// A change of the count of a column in a part of a row: the column now, by how much.
type Step = (u32, i64);

impl RowEdit<'_> {
    /// Adds rows that stay to `rows`: they have the counts of the rows `before`, except for rays that may meet a change,
    /// which are traced before and after it. Where the counts do not fit, a whole row is traced anew.
    ///
    /// With `sky`, rows over the sky's bins so far, those that get the new ones, and the bin of a direction, each row is
    /// [`QUADRANTS`] rows, as [`super::add_quadrant_rows`] makes them.
    ///
    /// # Errors
    /// [`transport::Error::Length`] of columns that do not fit, [`transport::Error::Cancelled`],
    /// [`transport::Error::TooMany`].
    pub fn add(
        &self,
        before: &HitCounts,
        kept: &[KeptRow],
        rows: &mut HitCounts,
        mut sky: Option<(&HitCounts, &mut HitCounts, &SkyBin)>,
        progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
    ) -> Result<RowChanges, Error> {
        check_length("columns", self.before.patches.len(), self.columns.len())?;
        let parts = if sky.is_some() { QUADRANTS } else { 1 };
        let bins: Vec<u32> = (0..sky.as_ref().map_or(0, |sky| sky.0.columns() as u32)).collect();
        let square: Vec<(u32, u32)> = (0..self.rays).map(sobol2_fast).collect();
        let mut changes = RowChanges::default();
        for (block, own) in kept.chunks(BLOCK_ROWS).enumerate() {
            let sky_before = sky.as_ref().map(|sky| (sky.0, sky.2));
            let new: Vec<NewRow> = own.par_iter().map(|row| self.row(&square, before, sky_before, row)).collect();
            let scales = alloc::vec![1.0 / self.rays as f32; parts * own.len()];
            let mut counts = Vec::with_capacity(scales.len());
            let mut sky_counts = Vec::new();
            for row in new {
                counts.extend(row.parts);
                sky_counts.extend(row.sky_parts);
                changes.sky_factor.push(row.escaped as f32 / self.rays as f32);
                changes.traced += row.traced;
            }
            rows.push_edited(before, self.columns, &counts, &scales)?;
            if let Some((sky_before, sky_rows, _)) = &mut sky {
                sky_rows.push_edited(sky_before, &bins, &sky_counts, &scales)?;
            }
            let done = block * BLOCK_ROWS + own.len();
            if progress(done, kept.len()).is_break() {
                return Err(transport::Error::Cancelled { done, total: kept.len() }.into());
            }
        }
        Ok(changes)
    }

    fn row(
        &self,
        square: &[(u32, u32)],
        before: &HitCounts,
        sky: Option<(&HitCounts, &SkyBin)>,
        kept: &KeptRow,
    ) -> NewRow {
        let parts = if sky.is_some() { QUADRANTS } else { 1 };
        let (right, up) = frame(kept.points[0].normal);
        let part_of = |direction: Vec3| if parts == 1 { 0 } else { quadrant_of(direction, right, up) };
        let bin_of = |direction: Vec3| sky.map_or(NONE, |sky| (sky.1)(direction));
        let [sky_before, sky_after] = [self.before, self.after].map(|surfaces| surfaces.patches.len() as u32);
        let mut steps: Vec<Vec<Step>> = alloc::vec![Vec::new(); parts];
        let mut sky_steps = steps.clone();
        let mut gone = alloc::vec![0i64; parts];
        let (mut escaped, mut traced) = (0, 0);
        let p = numbered_params(self.after, kept.key, self.rays);
        let (shift_u, shift_v) = shift_of_row(kept.key.seed, kept.key.number);
        let mut aimed = Aimed::default();
        for (k, &(x, y)) in (0u32..).zip(square) {
            let point = origin_of_ray(&p, kept.points, k);
            aimed.stand_at(&point, self.balls);
            if !aimed.may_meet(x.wrapping_add(shift_u), y.wrapping_add(shift_v)) {
                continue;
            }
            let (origin, direction) = ray_from(&p, point, kept.key.number, k);
            if !(self.may_meet)(origin, direction) {
                continue;
            }
            let (old, new) = self.columns_of_ray(&p, kept, point, k);
            traced += 2;
            let part = part_of(direction);
            if old == sky_before {
                sky_steps[part].push((bin_of(direction), -1));
                escaped -= 1;
            } else if let Some(&column) = self.columns.get(old as usize) {
                if column == NONE { gone[part] -= 1 } else { steps[part].push((column, -1)) }
            }
            if new == sky_after {
                sky_steps[part].push((bin_of(direction), 1));
                escaped += 1;
            } else if new < sky_after {
                steps[part].push((new, 1));
            }
        }
        let first = parts * kept.row;
        let new_parts: Option<Vec<EditedRow>> = (first..)
            .zip(steps.into_iter().zip(gone))
            .map(|(row, (steps, gone))| edited(before, row, steps, gone, |column| self.columns[column as usize]))
            .collect();
        let sky_parts = sky.map_or(Some(Vec::new()), |(sky, _)| {
            (first..).zip(sky_steps).map(|(row, steps)| edited(sky, row, steps, 0, |bin| bin)).collect()
        });
        match (new_parts, sky_parts) {
            (Some(parts), Some(sky_parts)) => NewRow { parts, sky_parts, escaped, traced },
            // Where a ray and a border are equal to rounding: all rays are asked.
            _ => self.whole_row(sky.map(|sky| sky.1), kept, part_of, traced),
        }
    }

    /// Columns of what ray `k` met and meets.
    fn columns_of_ray(&self, p: &HemisphereParams, kept: &KeptRow, point: SurfacePoint, k: u32) -> (u32, u32) {
        let column = |surfaces: &Surfaces, p: &HemisphereParams| {
            let (origin, direction) = ray_from(p, point, kept.key.number, k);
            ray_column(surfaces, p, origin, direction)
        };
        (column(self.before, &numbered_params(self.before, kept.key, self.rays)), column(self.after, p))
    }

    /// A row all of whose rays are traced.
    fn whole_row(
        &self,
        sky_bin: Option<&SkyBin>,
        kept: &KeptRow,
        part_of: impl Fn(Vec3) -> usize,
        traced: u64,
    ) -> NewRow {
        let parts = if sky_bin.is_some() { QUADRANTS } else { 1 };
        let p = numbered_params(self.after, kept.key, self.rays);
        let sky = self.after.patches.len() as u32;
        let mut steps: Vec<Vec<Step>> = alloc::vec![Vec::new(); parts];
        let mut sky_steps = steps.clone();
        let mut escaped = 0;
        for k in 0..self.rays {
            let point = origin_of_ray(&p, kept.points, k);
            let direction = ray_from(&p, point, kept.key.number, k).1;
            let (old, column) = self.columns_of_ray(&p, kept, point, k);
            let part = part_of(direction);
            if column < sky {
                steps[part].push((column, 1));
            } else if column == sky {
                escaped += 1;
                if let Some(sky_bin) = sky_bin {
                    sky_steps[part].push((sky_bin(direction), 1));
                }
            }
            escaped -= i64::from(old == self.before.patches.len() as u32);
        }
        let summed = |steps: Vec<Vec<Step>>| steps.into_iter().filter_map(sums).map(EditedRow::Counts).collect();
        let sky_parts = if sky_bin.is_some() { summed(sky_steps) } else { Vec::new() };
        NewRow { parts: summed(steps), sky_parts, escaped, traced: traced + 2 * u64::from(self.rays) }
    }
}

/// Cells along each axis of the unit square in which directions are told apart.
const STEPS: usize = 16;
const STEP_SHIFT: u32 = u32::BITS - STEPS.ilog2();
/// Angle by which balls are taken for larger, for rounding.
const SLACK: f32 = 2e-3;

/// Directions from a point in which something of some balls may be: cells of the square of
/// [`scene::sampling::cosine_hemisphere`].
#[derive(Default)]
struct Aimed {
    from: Option<(Vec3, Vec3)>,
    cells: [u16; STEPS],
}

impl Aimed {
    /// Looks from a point; nothing is done where that is the last one.
    fn stand_at(&mut self, point: &SurfacePoint, balls: &[(Vec3, f32)]) {
        let place = (point.position, point.normal);
        if self.from == Some(place) {
            return;
        }
        self.from = Some(place);
        self.cells = [0; STEPS];
        let (right, up) = frame(point.normal);
        for &(middle, radius) in balls {
            let way = middle - point.position;
            let distance = way.length();
            // The origin stands a little above the point.
            let sine = radius * (1.0 + SLACK) / distance.max(f32::MIN_POSITIVE);
            if sine >= 1.0 {
                self.cells = [u16::MAX; STEPS];
                return;
            }
            let reach = asin(sine) + SLACK;
            let tilt = math::acos((way.dot(point.normal) / distance).clamp(-1.0, 1.0));
            let low = (tilt - reach).max(0.0);
            let high = (tilt + reach).min(FRAC_PI_2);
            if low >= FRAC_PI_2 {
                continue;
            }
            let step = |angle: f32| ((sin(angle) * sin(angle) * STEPS as f32) as usize).min(STEPS - 1);
            let spread = sin(reach) / sin(tilt).max(f32::MIN_POSITIVE);
            let mask = match tilt <= reach || spread >= 1.0 || tilt + reach >= PI {
                true => u16::MAX,
                false => {
                    let turn = math::atan2(way.dot(up), way.dot(right));
                    turns(turn, asin(spread) + SLACK)
                }
            };
            self.cells[step(low)..=step(high)].iter_mut().for_each(|cells| *cells |= mask);
        }
    }

    /// Coordinates in the square as fixed-point words.
    fn may_meet(&self, u: u32, v: u32) -> bool {
        self.cells[(u >> STEP_SHIFT) as usize] >> (v >> STEP_SHIFT) & 1 != 0
    }
}

/// Sine of an angle from 0 to π.
fn sin(angle: f32) -> f32 {
    math::sin_cos_2pi(angle / TAU).0
}

fn asin(sine: f32) -> f32 {
    FRAC_PI_2 - math::acos(sine)
}

/// Cells of the turns about an angle, to both sides.
fn turns(angle: f32, reach: f32) -> u16 {
    let step = STEPS as f32 / TAU;
    let [first, last] = [angle - reach, angle + reach].map(|angle| math::floor(angle * step) as i32);
    (first..=last).fold(0, |mask, k| mask | 1 << k.rem_euclid(STEPS as i32))
}

/// A row after some steps, of a column that each before has now; `gone` are those to columns that have none. None where
/// a count would be less than nothing, or a ray still hits what is gone.
fn edited(
    before: &HitCounts,
    row: usize,
    mut steps: Vec<Step>,
    gone: i64,
    now: impl Fn(u32) -> u32,
) -> Option<EditedRow> {
    let quads = before.row_start()[row] as usize..before.row_start()[row + 1] as usize;
    let is_gone = |quad: &UVec2| {
        [quad.x & 0xffff, quad.x >> 16, quad.y & 0xffff, quad.y >> 16].into_iter().any(|column| now(column) == NONE)
    };
    if steps.is_empty() && gone == 0 && !before.quads()[quads].iter().any(is_gone) {
        return Some(EditedRow::Same(row));
    }
    let mut left = gone;
    for (column, count) in before.row(row) {
        match now(column) {
            NONE => left += i64::from(count),
            column => steps.push((column, i64::from(count))),
        }
    }
    if left == 0 { sums(steps).map(EditedRow::Counts) } else { None }
}

/// The count of each column, ascending; none where one would be less than nothing.
fn sums(mut steps: Vec<Step>) -> Option<Vec<(u32, u32)>> {
    steps.sort_unstable_by_key(|step| step.0);
    let sum = |same: &[Step]| u32::try_from(same.iter().map(|step| step.1).sum::<i64>()).map(|sum| (same[0].0, sum));
    let counts = steps.chunk_by(|a, b| a.0 == b.0).map(sum).collect::<Result<Vec<_>, _>>().ok()?;
    Some(counts.into_iter().filter(|count| count.1 > 0).collect())
}
