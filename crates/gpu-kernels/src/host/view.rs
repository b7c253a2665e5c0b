//! Host forms of the kernels that compute only the rows a view needs.

use std::vec::Vec;

use ::formfactor::{ReceiverCell, TriangleGrid, ViewParams};
use ::scene::gpu::Triangle;
use ::scene::{Hit, NONE, Rgb, SurfacePoint};
use ::transport::kernel::view::{is_needed, needed, pixel_vertices};
use rayon::prelude::*;

use super::transport::HitRows;
use super::{Bound, HostCall, HostError};
use crate::table::Kernel;

/// Rows that a core takes at once.
const BATCH: usize = 4096;
/// Rows whose marks are looked at together.
const PACK: usize = 64;
/// Parts for each core of what is marked: each has a set of its own.
const PARTS: usize = 4;

/// Rows or pixels of a part.
fn part_of(count: usize) -> usize {
    count.div_ceil(PARTS * rayon::current_num_threads()).max(BATCH)
}

/// Rows by number, a bit each: every part of the work collects its own, then they are united.
pub(super) struct RowSet(Vec<u64>);

impl RowSet {
    fn new(rows: usize) -> Self {
        Self(std::vec![0; rows.div_ceil(64)])
    }

    #[inline]
    pub(super) fn insert(&mut self, row: u32) {
        self.0[row as usize / 64] |= 1 << (row % 64);
    }

    fn united(mut self, other: Self) -> Self {
        for (a, b) in self.0.iter_mut().zip(other.0) {
            *a |= b;
        }
        self
    }

    /// Marks the rows for a view.
    fn mark(&self, marks: &mut [u32], view: u32) {
        marks.par_chunks_mut(64 * BATCH).zip(self.0.par_chunks(BATCH)).for_each(|(marks, words)| {
            for (marks, &word) in marks.chunks_mut(64).zip(words) {
                let mut left = word;
                while left != 0 {
                    let mark = &mut marks[left.trailing_zeros() as usize];
                    left &= left - 1;
                    if !is_needed(*mark, view) {
                        *mark = needed(view);
                    }
                }
            }
        });
    }
}

pub(crate) fn mark_pixels(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [hits, points, triangles, grids, cells, vertices, marks]) = call.parts::<ViewParams, 7>(kernel)?;
    let n = p.count as usize;
    let hits = hits.read::<Hit>(n)?;
    let points = points.read::<SurfacePoint>(n)?;
    let triangles = triangles.read::<Triangle>(1)?;
    let grids = grids.read::<TriangleGrid>(triangles.len())?;
    let cells = cells.read::<ReceiverCell>(0)?;
    let vertices = vertices.read::<u32>(0)?;
    let marks = marks.whole::<u32>()?;
    let rows = marks.len();
    let part = part_of(n);
    let seen = hits[..n].par_chunks(part).zip(points[..n].par_chunks(part)).map(|(hits, points)| {
        let mut set = RowSet::new(rows);
        for (&hit, &point) in hits.iter().zip(points) {
            let (ids, _) = pixel_vertices(grids, cells, vertices, triangles, hit, point);
            if ids.x != NONE {
                ids.to_array().iter().for_each(|&id| set.insert(id));
            }
        }
        set
    });
    if let Some(seen) = seen.reduce_with(RowSet::united) {
        seen.mark(marks, p.view);
    }
    Ok(())
}

/// Marks what the rows that a view needs take from, once: `columns` puts those of a row into a set.
pub(super) fn mark_rows(
    view: u32,
    row_marks: &mut [u32],
    marks: &mut [u32],
    columns: impl Fn(usize, &mut RowSet) + Sync,
) {
    let rows = marks.len();
    let part = part_of(row_marks.len());
    let needing = row_marks.par_chunks_mut(part).enumerate().map(|(chunk, row_marks)| {
        let mut set = RowSet::new(rows);
        for (k, mark) in row_marks.iter_mut().enumerate().filter(|(_, mark)| **mark == needed(view)) {
            *mark = needed(view) + 1;
            columns(chunk * part + k, &mut set);
        }
        set
    });
    if let Some(needing) = needing.reduce_with(RowSet::united) {
        needing.mark(marks, view);
    }
}

/// So many rows, for a view and a light.
#[derive(Clone, Copy)]
pub(super) struct ViewOf {
    pub rows: u32,
    pub view: u32,
    pub light: u32,
}

/// Computes the rows that a view needs and that are of another light.
pub(super) fn gather_view(
    of: ViewOf,
    [marks, computed, irradiance]: [Bound; 3],
    row: impl Fn(usize) -> Rgb + Sync,
) -> Result<(), HostError> {
    let n = of.rows as usize;
    let marks = &marks.read::<u32>(n)?[..n];
    let computed = computed.write::<u32>(n)?;
    let irradiance = irradiance.write::<Rgb>(n)?;
    let parts = computed.par_chunks_mut(PACK).zip(irradiance.par_chunks_mut(PACK)).zip(marks.par_chunks(PACK));
    parts.with_min_len(BATCH / PACK / 8).enumerate().for_each(|(pack, ((computed, irradiance), marks))| {
        // Most rows are out of view, and their neighbours with them.
        if !marks.iter().fold(false, |any, &mark| any | is_needed(mark, of.view)) {
            return;
        }
        for (k, ((light, irradiance), &mark)) in computed.iter_mut().zip(irradiance).zip(marks).enumerate() {
            if is_needed(mark, of.view) && *light != of.light {
                (*light, *irradiance) = (of.light, row(PACK * pack + k));
            }
        }
    });
    Ok(())
}

pub(crate) fn gather_hits(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, quads, counts, scales, exitance, marks, computed, irradiance]) =
        call.parts::<ViewParams, 8>(kernel)?;
    let rows = HitRows::new(p.count as usize, p.first_quad, [row_start, quads, counts, scales, exitance])?;
    let of = ViewOf { rows: p.count, view: p.view, light: p.light };
    gather_view(of, [marks, computed, irradiance], |k| rows.gather(k))
}
