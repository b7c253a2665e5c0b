//! Sparse rows of form factors by rays: for many receivers or many senders, where dense rows would not fit.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::vec::Vec;

use rayon::prelude::*;

use super::estimate::{Estimator, Hemisphere, Proceed, Surfaces, hemisphere_hits};
use super::storage::Csr;
use crate::error::Error;

/// Rows that one task makes.
const TASK_ROWS: usize = 64;

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
/// What is wrong with the surfaces or the number of rays, [`Error::TooMany`] entries, [`Error::Cancelled`].
pub fn sparse_rows(
    surfaces: &Surfaces,
    rays: u32,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<SparseRows, Error> {
    surfaces.check()?;
    Hemisphere { rays }.check(surfaces)?;
    let (total, patches) = (surfaces.rows(), surfaces.patches.len() as u32);
    let (done, cancelled) = (AtomicUsize::new(0), AtomicBool::new(false));
    let task = |first: usize| {
        let rows = first..(first + TASK_ROWS).min(total);
        let mut part = Part::default();
        if !cancelled.load(Ordering::Relaxed) {
            for row in rows.clone() {
                part.push(hemisphere_hits(surfaces, row, rays), patches);
            }
        }
        let count = done.fetch_add(rows.len(), Ordering::Relaxed) + rows.len();
        if let ControlFlow::Break(()) = progress(count, total) {
            cancelled.store(true, Ordering::Relaxed);
        }
        part
    };
    let starts: Vec<usize> = (0..total).step_by(TASK_ROWS).collect();
    let parts: Vec<Part> = starts.into_par_iter().map(task).collect();
    if cancelled.load(Ordering::Relaxed) {
        return Err(Error::Cancelled { done: done.load(Ordering::Relaxed), total });
    }
    let found: u64 = parts.iter().map(|p| p.values.len() as u64).sum();
    if found > u64::from(u32::MAX) {
        return Err(Error::TooMany { found, limit: u64::from(u32::MAX) });
    }
    let factors = Csr { rows: total, columns: patches as usize, row_start: std::vec![0], ..Csr::default() };
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
        // Stable, so that shares are added in the order of the rays.
        hits.sort_by_key(|hit| hit.0);
        let start = self.columns.len();
        let (mut sky, mut lost) = (0.0, 0.0);
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
