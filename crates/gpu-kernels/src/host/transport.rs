//! Host forms of products with rows.

use ::scene::Rgb;
use ::transport::kernel::hits::{COUNT_STEP, MAX_HIT_COLUMNS, WORD_COUNTS};
use ::transport::kernel::product::{self, LANES, ROWS_PER_BATCH, RowSums};
use ::transport::{GatherParams, HitsParams};
use glam::{UVec2, Vec4};
use rayon::prelude::*;
use std::vec::Vec;

use super::{Bound, HostCall, HostError, fill};
use crate::half::unpack_half4;
use crate::params::CountParams;
use crate::table::Kernel;

/// Numbers of 16 bits.
const MAX_COLUMNS: usize = MAX_HIT_COLUMNS as usize;

/// Parts of a dense product: settings, factors, exitance, and the rows of the result.
type Dense<'s, 'a> = (GatherParams, Bound<'s, 'a>, Bound<'s, 'a>, &'s mut [Rgb]);

fn dense<'s, 'a>(kernel: &Kernel, call: &'s mut HostCall<'_, 'a>) -> Result<Dense<'s, 'a>, HostError> {
    let (p, [factors, exitance, irradiance]) = call.parts::<GatherParams, 3>(kernel)?;
    let first = p.first_row as usize;
    let rows = p.rows as usize;
    Ok((p, factors, exitance, &mut irradiance.write::<Rgb>(first + rows)?[first..]))
}

/// Four rows by [`LANES`] lanes and the tree over them: the additions of a workgroup, lane by lane, but with the
/// vectors in the order in which they lie in memory.
fn gather_together(p: &GatherParams, rows: &mut [Rgb], first: u32, factors: impl Fn(u32, u32) -> Vec4, light: &[Rgb]) {
    let row = |k: u32| product::clamp_row(first + k, p.rows);
    let a = row(0);
    let b = row(1);
    let c = row(2);
    let d = row(3);
    let mut lanes = [RowSums::default(); LANES as usize];
    for vector in 0..p.vectors {
        let lane = &mut lanes[(vector % LANES) as usize];
        let j = 4 * vector as usize;
        *lane = lane.add(
            factors(a, vector),
            factors(b, vector),
            factors(c, vector),
            factors(d, vector),
            (light[j], light[j + 1], light[j + 2], light[j + 3]),
        );
    }
    for (k, result) in rows.iter_mut().enumerate() {
        let mut sums = lanes.map(|lane| [lane.a, lane.b, lane.c, lane.d][k].extend(0.0));
        let mut stride = LANES as usize / 2;
        while stride > 0 {
            for lane in 0..stride {
                sums[lane] = product::combine(sums[lane], sums[lane + stride]);
            }
            stride /= 2;
        }
        *result = sums[0];
    }
}

pub(crate) fn gather(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, factors, exitance, rows) = dense(kernel, call)?;
    let factors = factors.read::<Vec4>(p.rows as usize * p.vectors as usize)?;
    let light = exitance.read::<Rgb>(4 * p.vectors as usize)?;
    let load = |row: u32, vector: u32| factors[row as usize * p.vectors as usize + vector as usize];
    rows.par_chunks_mut(ROWS_PER_BATCH as usize)
        .enumerate()
        .for_each(|(k, rows)| gather_together(&p, rows, k as u32 * ROWS_PER_BATCH, load, light));
    Ok(())
}

pub(crate) fn gather_half(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, factors, exitance, rows) = dense(kernel, call)?;
    let factors = factors.read::<UVec2>(p.rows as usize * p.vectors as usize)?;
    let light = exitance.read::<Rgb>(4 * p.vectors as usize)?;
    let load = |row: u32, vector: u32| unpack_half4(factors[row as usize * p.vectors as usize + vector as usize]);
    rows.par_chunks_mut(ROWS_PER_BATCH as usize)
        .enumerate()
        .for_each(|(k, rows)| gather_together(&p, rows, k as u32 * ROWS_PER_BATCH, load, light));
    Ok(())
}

pub(crate) fn gather_csr(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, columns, values, exitance, irradiance]) = call.parts::<CountParams, 5>(kernel)?;
    let n = p.count as usize;
    let row_start = row_start.read::<u32>(n + 1)?;
    let entries = row_start[n] as usize;
    let columns = columns.read::<u32>(entries)?;
    let values = values.read::<f32>(entries)?;
    let exitance = exitance.read::<Rgb>(0)?;
    fill(irradiance.write(n)?, |k| sparse_row(k as usize, row_start, columns, values, exitance));
    Ok(())
}

/// `gather_row_sparse` with what is known of a row checked once.
#[inline]
fn sparse_row(k: usize, row_start: &[u32], columns: &[u32], values: &[f32], exitance: &[Rgb]) -> Rgb {
    let own = row_start[k] as usize..row_start[k + 1] as usize;
    let entries = columns[own.clone()].iter().zip(&values[own]);
    entries.fold(Vec4::ZERO, |sum, (&column, &value)| sum + exitance[column as usize] * value)
}

pub(crate) fn gather_hits(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, quads, counts, scales, exitance, irradiance]) = call.parts::<HitsParams, 6>(kernel)?;
    let n = p.rows as usize;
    let rows = HitRows::new(n, p.first_quad, [row_start, quads, counts, scales, exitance])?;
    fill(irradiance.write(n)?, |k| rows.gather(k as usize));
    Ok(())
}

/// `gather_row_hits` with what is known of a row checked once, and an entry for every number of 16 bits.
pub(super) struct HitRows<'a> {
    first_quad: u32,
    row_start: &'a [u32],
    quads: &'a [UVec2],
    counts: &'a [u8],
    scales: &'a [f32],
    exitance: Vec<Vec4>,
}

impl<'a> HitRows<'a> {
    /// `n` rows, by their starts, quads, counts, scales, and the exitance.
    pub(super) fn new(n: usize, first_quad: u32, bound: [Bound<'a, '_>; 5]) -> Result<Self, HostError> {
        let [row_start, quads, counts, scales, exitance] = bound;
        let row_start = row_start.read::<u32>(n + 1)?;
        let bound = row_start[n].saturating_sub(first_quad);
        let quads = quads.read::<UVec2>(bound as usize)?;
        let counts = bytemuck::cast_slice(counts.read::<u32>(bound.div_ceil(WORD_COUNTS) as usize)?);
        let scales = scales.read::<f32>(n)?;
        let light = exitance.read::<Rgb>(0)?;
        let known = light.len().min(MAX_COLUMNS);
        let mut exitance = std::vec![Vec4::ZERO; MAX_COLUMNS];
        exitance[..known].copy_from_slice(&light[..known]);
        Ok(Self { first_quad, row_start, quads, counts, scales, exitance })
    }

    #[inline]
    pub(super) fn gather(&self, k: usize) -> Rgb {
        let Some(table) = self.exitance.first_chunk::<MAX_COLUMNS>() else { return Vec4::ZERO };
        let quad = |k: usize| (self.row_start[k] - self.first_quad) as usize;
        let own = quad(k)..quad(k + 1);
        let mut sum = Vec4::ZERO;
        for (four, &count) in self.quads[own.clone()].iter().zip(&self.counts[own]) {
            let b = |column: u32| table[(column & 0xffff) as usize];
            sum += ((b(four.x) + b(four.x >> 16)) + (b(four.y) + b(four.y >> 16))) * f32::from(count);
        }
        (sum * (COUNT_STEP * self.scales[k])).truncate().extend(0.0)
    }
}
