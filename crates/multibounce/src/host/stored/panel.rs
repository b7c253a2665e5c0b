//! Form factors in the order of tiles, and products of their rows with some columns at a time.

use std::vec::Vec;

use scene::parallel::*;

use crate::error::Error;
use crate::host::solve::Factors;

/// Columns that a product takes at a time: as many numbers as a line of a cache.
pub(super) const LANES: usize = 16;

/// `Ŝ = a^½ F a^-½` by permuted indices, sparse.
pub(super) struct Ordered {
    start: Vec<usize>,
    entries: Vec<(u32, f32)>,
}

impl Ordered {
    pub fn new(factors: &Factors, order: &[u32], permuted_index: &[u32]) -> Result<Self, Error> {
        factors.check_reciprocal()?;
        let sqrt_area: Vec<f32> = factors.area.iter().map(|&a| scene::math::sqrt(a)).collect();
        let mut start = Vec::with_capacity(order.len() + 1);
        let mut entries = Vec::with_capacity(factors.values.len());
        start.push(0);
        for &i in order {
            entries.extend(
                factors.row(i as usize).map(|(j, f)| (permuted_index[j], f * sqrt_area[i as usize] / sqrt_area[j])),
            );
            start.push(entries.len());
        }
        Ok(Self { start, entries })
    }

    pub fn len(&self) -> usize {
        self.start.len() - 1
    }

    /// A row, which is a column.
    pub fn row(&self, i: usize) -> &[(u32, f32)] {
        &self.entries[self.start[i]..self.start[i + 1]]
    }

    /// Adds row i of `Ŝ x` to some sums.
    fn add(&self, i: usize, x: &[[f32; LANES]], sums: &mut [f32; LANES]) {
        for &(k, s) in self.row(i) {
            for (sum, x) in sums.iter_mut().zip(&x[k as usize]) {
                *sum += s * x;
            }
        }
    }

    /// Columns of `Ŝ`, from `first` on, in lanes.
    fn columns(&self, first: usize, out: &mut [[f32; LANES]]) {
        out.fill([0.0; LANES]);
        let count = LANES.min(self.len().saturating_sub(first));
        let mut add = |lane: usize| self.row(first + lane).iter().for_each(|&(k, s)| out[k as usize][lane] += s);
        (0..count).for_each(&mut add);
    }

    /// Makes columns of so many bounces of them, `T_1 = Ŝ`, `T_{k+1} = Ŝ + Ŝ ρ T_k`: `columns` has so many rows a
    /// column, the first is column `first`.
    pub fn bounces(&self, albedo: &[f32], bounces: u32, first: usize, columns: &mut [f32], rows: usize) {
        let n = self.len();
        columns.par_chunks_mut((LANES * rows).max(1)).enumerate().for_each_init(
            || [vec![[0.0; LANES]; n], vec![[0.0; LANES]; n]],
            |[sums, next], (chunk, out)| {
                let first = first + chunk * LANES;
                self.columns(first, sums);
                for _ in 1..bounces {
                    sums.iter_mut().zip(albedo).for_each(|(t, rho)| t.iter_mut().for_each(|t| *t *= rho));
                    self.columns(first, next);
                    next.iter_mut().enumerate().for_each(|(i, next)| self.add(i, sums, next));
                    std::mem::swap(sums, next);
                }
                for (lane, column) in out.chunks_mut(rows).enumerate() {
                    column.iter_mut().zip(&*sums).for_each(|(out, t)| *out = t[lane]);
                }
            },
        );
    }

    /// Makes columns of T̂ of columns `Y = P T̂`, P = diag(`sqrt_albedo`): by division where `is_dark` is not, and
    /// there by `T̂ = Ŝ + Ŝ P Y`.
    pub fn unscale(&self, sqrt_albedo: &[f32], is_dark: &[bool], first: usize, columns: &mut [f32], rows: usize) {
        let n = self.len();
        let dark: Vec<usize> = (0..n).filter(|&i| is_dark[i]).collect();
        columns.par_chunks_mut((LANES * rows).max(1)).enumerate().for_each_init(
            || [vec![[0.0; LANES]; n], vec![[0.0; LANES]; n]],
            |[light, sums], (chunk, out)| {
                if !dark.is_empty() {
                    for (lane, column) in out.chunks(rows).enumerate() {
                        (0..n).for_each(|k| light[k][lane] = sqrt_albedo[k] * column[k]);
                    }
                    self.columns(first + chunk * LANES, sums);
                    dark.iter().for_each(|&i| self.add(i, light, &mut sums[i]));
                }
                for (lane, column) in out.chunks_mut(rows).enumerate() {
                    for i in 0..n {
                        column[i] = if is_dark[i] { sums[i][lane] } else { column[i] / sqrt_albedo[i] };
                    }
                }
            },
        );
    }
}
