//! Host forms of the form-factor kernels and of the products.

use ::formfactor::kernel::hits::{COUNT_STEP, MOST_HIT_COLUMNS, WORD_COUNTS};
use ::formfactor::kernel::product::{self, LANES, ROWS_TOGETHER, RowSums};
use ::formfactor::{GatherParams, HitsParams};
use ::scene::Rgb;
use glam::{UVec2, Vec4};
use rayon::prelude::*;

use super::{Bound, HostCall, HostError, fill};
use crate::half::unpack_half4;
use crate::params::CountParams;
use crate::table::Kernel;

/// Numbers of 16 bits.
const MOST_COLUMNS: usize = MOST_HIT_COLUMNS as usize;

/// Parts of a dense product: settings, factors, exitance, and the rows of the result.
type Dense<'s, 'a> = (GatherParams, Bound<'s, 'a>, Bound<'s, 'a>, &'s mut [Rgb]);

fn dense<'s, 'a>(kernel: &Kernel, call: &'s mut HostCall<'_, 'a>) -> Result<Dense<'s, 'a>, HostError> {
    let (p, [factors, exitance, irradiance]) = call.parts::<GatherParams, 3>(kernel)?;
    let (first, rows) = (p.first_row as usize, p.rows as usize);
    Ok((p, factors, exitance, &mut irradiance.write::<Rgb>(first + rows)?[first..]))
}

/// Four rows by [`LANES`] lanes and the tree over them: the additions of a workgroup, lane by lane, but with the vectors in
/// the order in which they lie in memory.
fn gather_together(p: &GatherParams, rows: &mut [Rgb], first: u32, factors: impl Fn(u32, u32) -> Vec4, light: &[Rgb]) {
    let row = |k: u32| product::clamp_row(first + k, p.rows);
    let (a, b, c, d) = (row(0), row(1), row(2), row(3));
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
    rows.par_chunks_mut(ROWS_TOGETHER as usize)
        .enumerate()
        .for_each(|(k, rows)| gather_together(&p, rows, k as u32 * ROWS_TOGETHER, load, light));
    Ok(())
}

pub(crate) fn gather_half(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, factors, exitance, rows) = dense(kernel, call)?;
    let factors = factors.read::<UVec2>(p.rows as usize * p.vectors as usize)?;
    let light = exitance.read::<Rgb>(4 * p.vectors as usize)?;
    let load = |row: u32, vector: u32| unpack_half4(factors[row as usize * p.vectors as usize + vector as usize]);
    rows.par_chunks_mut(ROWS_TOGETHER as usize)
        .enumerate()
        .for_each(|(k, rows)| gather_together(&p, rows, k as u32 * ROWS_TOGETHER, load, light));
    Ok(())
}

pub(crate) fn gather_csr(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, columns, values, exitance, irradiance]) = call.parts::<CountParams, 5>(kernel)?;
    let n = p.count as usize;
    let row_start = row_start.read::<u32>(n + 1)?;
    let entries = row_start[n] as usize;
    let (columns, values) = (columns.read::<u32>(entries)?, values.read::<f32>(entries)?);
    let exitance = exitance.read::<Rgb>(0)?;
    // `gather_row_sparse` with what is known of a row checked once.
    fill(irradiance.write(n)?, |k| {
        let own = row_start[k as usize] as usize..row_start[k as usize + 1] as usize;
        let entries = columns[own.clone()].iter().zip(&values[own]);
        entries.fold(Vec4::ZERO, |sum, (&column, &value)| sum + exitance[column as usize] * value)
    });
    Ok(())
}

pub(crate) fn gather_hits(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, quads, counts, scales, exitance, irradiance]) = call.parts::<HitsParams, 6>(kernel)?;
    let n = p.rows as usize;
    let row_start = row_start.read::<u32>(n + 1)?;
    let bound = row_start[n].saturating_sub(p.first_quad);
    let quads = quads.read::<UVec2>(bound as usize)?;
    let counts = counts.read::<u32>(bound.div_ceil(WORD_COUNTS) as usize)?;
    let (scales, exitance) = (scales.read::<f32>(n)?, exitance.read::<Rgb>(0)?);
    // `gather_row_hits` with what is known of a row checked once, and an entry for every number of 16 bits.
    let counts: &[u8] = bytemuck::cast_slice(counts);
    let known = exitance.len().min(MOST_COLUMNS);
    let mut table = std::vec![Vec4::ZERO; MOST_COLUMNS];
    table[..known].copy_from_slice(&exitance[..known]);
    let Some(table) = table.first_chunk::<MOST_COLUMNS>() else { return Ok(()) };
    fill(irradiance.write(n)?, |k| {
        let quad = |k: usize| (row_start[k] - p.first_quad) as usize;
        let own = quad(k as usize)..quad(k as usize + 1);
        let mut sum = Vec4::ZERO;
        for (four, &count) in quads[own.clone()].iter().zip(&counts[own]) {
            let b = |column: u32| table[(column & 0xffff) as usize];
            sum += ((b(four.x) + b(four.x >> 16)) + (b(four.y) + b(four.y >> 16))) * f32::from(count);
        }
        (sum * (COUNT_STEP * scales[k as usize])).truncate().extend(0.0)
    });
    Ok(())
}
