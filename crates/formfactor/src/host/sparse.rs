//! Sparse rows of form factors by rays: for many receivers or many patches, where dense rows would not fit.

use alloc::vec::Vec;
use core::ops::Range;
use core::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use glam::Vec4;
use scene::parallel::*;
use scene::{Hit, NONE};

use super::estimate::{
    Estimator, Hemisphere, SkyBin, check_surfaces, first_sky_column, hemisphere_hits, in_quadrants, like_rays,
    quadrant_hits, rows_hits, traced_hits,
};
use crate::error::Error;
use transport::{Csr, HitCounts, LinearOperator, Proceed, QUADRANTS, Surfaces, check_length};

/// Rows that one task makes.
const TASK_ROWS: usize = 64;
/// Rays that are traced together, of as many rows as have them.
const GROUP_RAYS: usize = 1 << 14;
/// Hits of a block of rows that are coded together.
const BLOCK_HITS: usize = 1 << 22;

/// Sparse rows of form factors: the factors of a row, its sky factor and its lost share sum to 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SparseRows {
    /// `F_ij`, rows × patches.
    pub factors: Csr,
    /// `F_i0`: share of each row's hemisphere that sees no geometry.
    pub sky_factor: Vec<f32>,
    /// Share of each row's rays that met something no patch owns: surfaces without patches are dark, and send nothing.
    pub lost: Vec<f32>,
}

/// The rows that [`Hemisphere`] makes, sparse, on all cores, the same bytes for any number of threads.
/// `progress(done, total)` is called now and then, from any thread; breaking it cancels.
///
/// # Errors
/// What is wrong with the surfaces or the number of rays, [`transport::Error::TooMany`] entries,
/// [`transport::Error::Cancelled`].
pub fn sparse_rows(
    surfaces: &Surfaces,
    rays: u32,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<SparseRows, Error> {
    let order = like_rays(rays);
    collect_rows(surfaces, rays, &|row| hemisphere_hits(surfaces, row, &order), progress)
}

/// [`sparse_rows`] of rays that are traced by somebody else, on a GPU perhaps: `hits` has what ray k of row i meets at
/// `i · rays + k`. That ray is [`crate::kernel::hemisphere::hemisphere_ray`].
///
/// # Errors
/// As [`sparse_rows`]; [`transport::Error::Length`] unless there is one hit a ray.
pub fn sparse_traced_rows(
    surfaces: &Surfaces,
    rays: u32,
    hits: &[Hit],
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<SparseRows, Error> {
    check_length("hits", surfaces.rows() * rays as usize, hits.len())?;
    let order = like_rays(rays);
    let own = |row: usize| &hits[row * rays as usize..(row + 1) * rays as usize];
    collect_rows(surfaces, rays, &|row| traced_hits(surfaces, row, &order, own(row)), progress)
}

/// Sparse rows of the columns that the rays of each row meet, with their shares.
fn collect_rows(
    surfaces: &Surfaces,
    rays: u32,
    row_hits: &(dyn Fn(usize) -> Vec<(u32, f32)> + Sync),
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<SparseRows, Error> {
    check_surfaces(surfaces)?;
    Hemisphere { rays }.check(surfaces)?;
    let total = surfaces.rows();
    let patches = surfaces.patches.len() as u32;
    let parts = Watch::new(total, progress).tasks(0..total, |own| {
        let mut part = Part::default();
        own.for_each(|row| part.push(row_hits(row), patches));
        part
    })?;
    let found: u64 = parts.iter().map(|p| p.values.len() as u64).sum();
    if found > u64::from(u32::MAX) {
        return Err(
            transport::Error::TooMany { name: "entries of sparse rows", found, limit: u64::from(u32::MAX) }.into()
        );
    }
    let factors = Csr { rows: total, columns: patches as usize, row_start: alloc::vec![0], ..Csr::default() };
    let mut out = SparseRows { factors, ..SparseRows::default() };
    out.factors.column_index.reserve_exact(found as usize);
    out.factors.values.reserve_exact(found as usize);
    for part in parts {
        let base = out.factors.values.len() as u32;
        out.factors.row_start.extend(part.ends.iter().map(|end| base + end));
        out.factors.column_index.extend(part.columns);
        out.factors.values.extend(part.values);
        out.sky_factor.extend(part.sky_factor);
        out.lost.extend(part.lost);
    }
    Ok(out)
}

/// Adds the rows of [`sparse_rows`] to those of `rows`, as counts of hits: each ray of a row carries the same share, so
/// its points should have equal weights, and as many rays each. In blocks, so that the hits are never together in
/// memory. Returns the sky factors of the new rows.
///
/// # Errors
/// As [`sparse_rows`]; [`transport::Error::Length`] unless `rows` has one column a patch. Nothing is left half done:
/// the rows of whole blocks stay.
pub fn add_hit_rows(
    rows: &mut HitCounts,
    surfaces: &Surfaces,
    rays: u32,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<Vec<f32>, Error> {
    add_rows_of(rows, None, surfaces, 0..surfaces.rows(), rays, progress)
}

/// [`add_hit_rows`], or with sky rows [`add_quadrant_rows`], of some of the rows of surfaces: the same rows as if all
/// were made.
///
/// # Errors
/// As [`add_hit_rows`]; [`transport::Error::Length`] of rows that are not there.
pub fn add_rows_of(
    rows: &mut HitCounts,
    sky: Option<(&mut HitCounts, &SkyBin)>,
    surfaces: &Surfaces,
    own: Range<usize>,
    rays: u32,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<Vec<f32>, Error> {
    if own.end > surfaces.rows() {
        check_length("rows", surfaces.rows(), own.end)?;
    }
    let watch = Watch::new(own.len(), progress);
    let Some((sky_rows, sky_bin)) = sky else {
        return add_rows(rows, None, surfaces, own, (rays, 1), &mut |own| {
            Ok(watch.tasks(own, |own| in_groups(own, rays, &|own| rows_hits(surfaces, own, rays)))?.concat())
        });
    };
    add_rows(rows, Some(sky_rows), surfaces, own, (rays, QUADRANTS), &mut |own| {
        Ok(watch.tasks(own, |own| in_groups(own, rays, &|own| quadrant_hits(surfaces, own, rays, sky_bin)))?.concat())
    })
}

/// As [`add_hit_rows`], with [`QUADRANTS`] rows instead of one: the hits in each quadrant of the hemisphere round the
/// normal of the row's first point, as [`transport::rotational_gradients`] has them. `sky_rows` gets as many rows: of
/// the rays that escape, how many go to each bin of directions, which `sky_bin` names; it has one column a bin. Sky
/// factors are those of the quadrants.
///
/// # Errors
/// As [`add_hit_rows`].
pub fn add_quadrant_rows(
    rows: &mut HitCounts,
    sky: (&mut HitCounts, &SkyBin),
    surfaces: &Surfaces,
    rays: u32,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<Vec<f32>, Error> {
    add_rows_of(rows, Some(sky), surfaces, 0..surfaces.rows(), rays, progress)
}

/// [`add_hit_rows`], or with sky rows [`add_quadrant_rows`], of rays that are traced by somebody else, on a GPU
/// perhaps: `trace` gives the column of what each ray of some rows meets, row by row: a patch, the number of patches
/// for the sky, one more for what no patch owns. Ray k of a row is [`crate::kernel::hemisphere::hemisphere_ray`].
///
/// # Errors
/// As [`add_hit_rows`], and what `trace` gives.
pub fn add_traced_rows<E: From<Error>>(
    rows: &mut HitCounts,
    sky: Option<(&mut HitCounts, &SkyBin)>,
    surfaces: &Surfaces,
    rays: u32,
    trace: &mut dyn FnMut(Range<usize>) -> Result<Vec<u32>, E>,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<Vec<f32>, E> {
    let watch = Watch::new(surfaces.rows(), progress);
    let Some((sky_rows, sky_bin)) = sky else {
        return add_rows(rows, None, surfaces, 0..surfaces.rows(), (rays, 1), &mut |own| {
            let columns = trace(own.clone())?;
            watch.tasks(own, |_| ()).map_err(E::from)?;
            Ok(columns)
        });
    };
    add_rows(rows, Some(sky_rows), surfaces, 0..surfaces.rows(), (rays, QUADRANTS), &mut |own| {
        let columns = trace(own.clone())?;
        let of_rows = |rows: Range<usize>| {
            let place = |row: usize| (row - own.start) * rays as usize;
            in_quadrants(surfaces, rows.clone(), &columns[place(rows.start)..place(rows.end)], sky_bin)
        };
        Ok(watch.tasks(own.clone(), of_rows).map_err(E::from)?.concat())
    })
}

/// Applies `work` to groups of rows whose rays are traced together.
fn in_groups(rows: Range<usize>, rays: u32, work: &dyn Fn(Range<usize>) -> Vec<u32>) -> Vec<u32> {
    let group = (GROUP_RAYS / rays as usize).max(1);
    rows.clone().step_by(group).flat_map(|first| work(first..(first + group).min(rows.end))).collect()
}

/// Adds `parts` rows for each of the surfaces' from the columns that its rays hit, all rays for each part.
fn add_rows<E: From<Error>>(
    rows: &mut HitCounts,
    mut sky_rows: Option<&mut HitCounts>,
    surfaces: &Surfaces,
    all: Range<usize>,
    (rays, parts): (u32, usize),
    hits: &mut dyn FnMut(Range<usize>) -> Result<Vec<u32>, E>,
) -> Result<Vec<f32>, E> {
    check_surfaces(surfaces)?;
    Hemisphere { rays }.check(surfaces)?;
    check_length("columns", rows.columns(), surfaces.patches.len()).map_err(Error::from)?;
    let sky = surfaces.patches.len() as u32;
    let first_bin = first_sky_column(surfaces);
    let is_sky = |column: u32| column == sky || column >= first_bin && column != NONE;
    let mut sky_factor = Vec::with_capacity(parts * all.len());
    let block = (BLOCK_HITS / (parts * rays as usize)).max(1).next_multiple_of(TASK_ROWS);
    for first in all.clone().step_by(block) {
        let own = first..(first + block).min(all.end);
        let mut hits = hits(own.clone())?;
        let scales = alloc::vec![1.0 / rays as f32; parts * own.len()];
        rows.push(&hits, &scales).map_err(Error::from)?;
        let escaped = |hits: &[u32]| hits.iter().filter(|&&column| is_sky(column)).count() as f32 / rays as f32;
        sky_factor.extend(hits.chunks(rays as usize).map(escaped));
        if let Some(sky_rows) = &mut sky_rows {
            hits.par_iter_mut().for_each(|column| *column = column.checked_sub(first_bin).unwrap_or(NONE));
            sky_rows.push(&hits, &scales).map_err(Error::from)?;
        }
    }
    Ok(sky_factor)
}

/// The irradiance that the rows of [`sparse_rows`] would gather from this exitance, W/m², without the rows: for points
/// that are asked once. The fourth component is 0.
///
/// # Errors
/// As [`sparse_rows`]; [`transport::Error::Length`] unless there is one exitance a patch.
pub fn gather_by_rays(
    surfaces: &Surfaces,
    rays: u32,
    exitance: &[Vec4],
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<Vec<Vec4>, Error> {
    check_surfaces(surfaces)?;
    Hemisphere { rays }.check(surfaces)?;
    check_length("exitance", surfaces.patches.len(), exitance.len())?;
    let total = surfaces.rows();
    let order = like_rays(rays);
    let gather = |row: usize| {
        let light = |(column, share): (u32, f32)| exitance.get(column as usize).map_or(Vec4::ZERO, |b| *b * share);
        hemisphere_hits(surfaces, row, &order).into_iter().map(light).sum::<Vec4>().truncate().extend(0.0)
    };
    Ok(Watch::new(total, progress).tasks(0..total, |rows| rows.map(gather).collect::<Vec<_>>())?.concat())
}

/// Runs tasks of [`TASK_ROWS`] rows on all cores until `progress` says to stop.
struct Watch<'a> {
    total: usize,
    progress: &'a (dyn Fn(usize, usize) -> Proceed + Sync),
    done: AtomicUsize,
    cancelled: AtomicBool,
}

impl<'a> Watch<'a> {
    fn new(total: usize, progress: &'a (dyn Fn(usize, usize) -> Proceed + Sync)) -> Self {
        Self { total, progress, done: AtomicUsize::new(0), cancelled: AtomicBool::new(false) }
    }

    /// Applies `work` to each task of these rows, in order.
    fn tasks<T: Send>(&self, rows: Range<usize>, work: impl Fn(Range<usize>) -> T + Sync) -> Result<Vec<T>, Error> {
        let task = |first: usize| {
            let rows = first..(first + TASK_ROWS).min(rows.end);
            let made = (!self.cancelled.load(Ordering::Relaxed)).then(|| work(rows.clone()));
            let count = self.done.fetch_add(rows.len(), Ordering::Relaxed) + rows.len();
            if (self.progress)(count, self.total).is_break() {
                self.cancelled.store(true, Ordering::Relaxed);
            }
            made
        };
        let starts: Vec<usize> = rows.clone().step_by(TASK_ROWS).collect();
        let made: Vec<Option<T>> = starts.into_par_iter().map(task).collect();
        if self.cancelled.load(Ordering::Relaxed) {
            return Err(
                transport::Error::Cancelled { done: self.done.load(Ordering::Relaxed), total: self.total }.into()
            );
        }
        Ok(made.into_iter().flatten().collect())
    }
}

/// Some rows.
#[derive(Default)]
struct Part {
    ends: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f32>,
    sky_factor: Vec<f32>,
    lost: Vec<f32>,
}

impl Part {
    /// Adds the row whose rays met these columns with these shares.
    fn push(&mut self, mut hits: Vec<(u32, f32)>, patches: u32) {
        // Stable, so that shares are always added in the same order.
        hits.sort_by_key(|hit| hit.0);
        let start = self.columns.len();
        let mut sky = 0.0;
        let mut lost = 0.0;
        for (column, share) in hits {
            if column == patches {
                sky += share;
            } else if column > patches {
                lost += share;
            } else if self.columns.len() > start && self.columns[self.columns.len() - 1] == column {
                let last = self.values.len() - 1;
                self.values[last] += share;
            } else {
                self.columns.push(column);
                self.values.push(share);
            }
        }
        self.ends.push(self.values.len() as u32);
        self.sky_factor.push(sky);
        self.lost.push(lost);
    }
}
