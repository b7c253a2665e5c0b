//! Host forms of the multi-bounce products.

use ::multibounce::kernel::blocks::{self, BLOCK, Bc1, Bc3, Bc6h, Bc7, BlockFormat, BlockSums, LANES};
use ::multibounce::kernel::invert::{self, PIVOT_ROWS, PIVOT_VECTORS};
use ::multibounce::kernel::multiply as product;
use ::multibounce::kernel::multiply::{TILE_ROWS, TILE_VECTORS};
use ::multibounce::{BlockParams, InvertParams, MultiplyParams};
use ::scene::Rgb;
use glam::{UVec2, UVec4, Vec4};
use rayon::prelude::*;

use super::{Bound, HostCall, HostError};
use crate::table::{ImageFormat, Kernel};

/// Parts of the products beside the blocks.
struct Parts<'s> {
    p: BlockParams,
    tile_scales: &'s [Vec4],
    row_start: &'s [u32],
    outliers: &'s [UVec2],
    exitance: &'s [Rgb],
    rows: &'s mut [Rgb],
}

fn parts<'s, 'a>(kernel: &Kernel, call: &'s mut HostCall<'_, 'a>) -> Result<(Bound<'s, 'a>, Parts<'s>), HostError> {
    let (p, [blocks, tile_scales, row_start, outliers, exitance, irradiance]) = call.parts::<BlockParams, 6>(kernel)?;
    let last = p.rows.min(BLOCK.saturating_mul(p.first_block_row.saturating_add(p.block_rows)));
    let first = BLOCK.saturating_mul(p.first_block_row).min(last);
    let tile_rows = (p.first_block_row.saturating_add(p.block_rows) as usize).div_ceil(1 << p.tile_shift.min(31));
    let row_start = row_start.read::<u32>(last as usize + 1)?;
    let parts = Parts {
        p,
        tile_scales: tile_scales.read(tile_rows * p.tile_columns as usize)?,
        row_start,
        outliers: outliers.read(row_start[last as usize].saturating_sub(p.first_outlier) as usize)?,
        exitance: exitance.read((BLOCK * p.block_columns) as usize)?,
        rows: &mut irradiance.write::<Rgb>(last as usize)?[first as usize..],
    };
    Ok((blocks, parts))
}

/// Rows of blocks on all cores: for each the additions of a workgroup, lane by lane, and the tree over them.
fn gather(parts: Parts, lane_sums: impl Fn(&Parts, u32, u32) -> BlockSums + Sync) {
    let Parts { p, tile_scales, row_start, outliers, exitance, rows } = parts;
    // Without the result, so that the tasks may share the rest.
    let parts = Parts { p, tile_scales, row_start, outliers, exitance, rows: &mut [] };
    rows.par_chunks_mut(BLOCK as usize).enumerate().for_each(|(row, out)| {
        let row = row as u32;
        let mut lanes = [BlockSums::default(); LANES as usize];
        for (lane, sums) in (0..LANES).zip(&mut lanes) {
            let more = blocks::gather_outlier_rows(row, &p, lane, LANES, row_start, outliers, exitance);
            *sums = lane_sums(&parts, row, lane).plus(more);
        }
        for (k, result) in out.iter_mut().enumerate() {
            let mut sums = lanes.map(|lane| [lane.a, lane.b, lane.c, lane.d][k].extend(0.0));
            let mut stride = LANES as usize / 2;
            while stride > 0 {
                for lane in 0..stride {
                    sums[lane] = blocks::combine(sums[lane], sums[lane + stride]);
                }
                stride /= 2;
            }
            *result = sums[0];
        }
    });
}

/// Decodes in the kernel; `block` makes four words of a block as it is stored.
fn decoded<F: BlockFormat, T: bytemuck::Pod + Sync>(
    kernel: &Kernel,
    call: &mut HostCall,
    block: impl Fn(T) -> UVec4 + Sync,
) -> Result<(), HostError> {
    let (blocks, parts) = parts(kernel, call)?;
    let words = blocks.read::<T>(parts.p.block_rows as usize * parts.p.block_columns as usize)?;
    gather(parts, |parts, row, lane| {
        let load = |k: u32| block(words[k as usize]);
        blocks::decode_gather_row::<F>(row, &parts.p, lane, LANES, load, parts.tile_scales, parts.exitance)
    });
    Ok(())
}

pub(crate) fn blocks_gather_bc1(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    decoded::<Bc1, UVec2>(kernel, call, |pair| UVec4::new(pair.x, pair.y, 0, 0))
}

pub(crate) fn blocks_gather_bc3(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    decoded::<Bc3, UVec4>(kernel, call, |words| words)
}

pub(crate) fn blocks_gather_bc6h(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    decoded::<Bc6h, UVec4>(kernel, call, |words| words)
}

pub(crate) fn blocks_gather_bc7(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    decoded::<Bc7, UVec4>(kernel, call, |words| words)
}

/// In the place of a texture unit: the exact decoders.
pub(crate) fn blocks_gather_image(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (image, parts) = parts(kernel, call)?;
    image.covers(BLOCK * parts.p.block_columns, BLOCK * parts.p.block_rows)?;
    let (words, format, columns) = image.blocks()?;
    let size = format.block_bytes() as usize / 4;
    gather(parts, |parts, row, lane| {
        let fetch = |x: u32, y: u32| {
            let block = (y / BLOCK) as usize * columns + (x / BLOCK) as usize;
            let block = &words[block * size..(block + 1) * size];
            let at = |k: usize| block.get(k).map_or(0, |word| *word);
            let w = UVec4::new(at(0), at(1), at(2), at(3));
            let k = y % BLOCK * BLOCK + x % BLOCK;
            match format {
                ImageFormat::Bc3 => Bc3::texel(Bc3::parse(w), k),
                ImageFormat::Bc6hUfloat => Bc6h::texel(Bc6h::parse(w), k),
                ImageFormat::Bc7 => Bc7::texel(Bc7::parse(w), k),
                // The table allows no other format.
                _ => Bc1::texel(Bc1::parse(w), k),
            }
        };
        blocks::fetch_gather_row(row, &parts.p, lane, LANES, fetch, parts.tile_scales, parts.exitance)
    });
    Ok(())
}

/// Rows of tiles on all cores.
pub(crate) fn multiply(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [factors, albedo, operator, next]) = call.parts::<MultiplyParams, 4>(kernel)?;
    let tiles = p.tiles;
    let below = p.vectors as usize;
    let rows = (p.row_tiles * TILE_ROWS) as usize;
    let inner = p.inner as usize;
    let factors = factors.read::<Vec4>(rows * below)?;
    let albedo = albedo.read::<Vec4>(p.first_inner as usize + inner)?;
    let operator = operator.read::<Vec4>(4 * inner * below)?;
    let next = next.write::<Vec4>(rows * below)?;
    next.par_chunks_mut((TILE_ROWS as usize * below).max(1)).zip(0..p.row_tiles).for_each(|(next, row_tile)| {
        let tiles = (0..p.vectors / TILE_VECTORS).map(|k| k * p.row_tiles + row_tile).filter(|&t| t < tiles);
        for (t, lane) in tiles.flat_map(|t| (0..TILE_VECTORS).map(move |lane| (t, lane))) {
            let (row, vector) = product::tile_at(t, lane, &p);
            let at = |r: u32| r as usize * below + vector as usize;
            let start = |r: u32| if p.first_inner == 0 { factors[row as usize * below + at(r)] } else { next[at(r)] };
            let sums = product::multiply(row, vector, &p, factors, albedo, operator, start);
            (0..TILE_ROWS).zip(sums).for_each(|(r, sum)| next[at(r)] = sum);
        }
    });
    Ok(())
}

/// Rows of tiles on all cores.
pub(crate) fn eliminate(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [inverse, pivot_rows, scaled_rows, matrix]) = call.parts::<InvertParams, 4>(kernel)?;
    let below = p.vectors as usize;
    let inverse = inverse.read::<Vec4>((PIVOT_ROWS * PIVOT_VECTORS) as usize)?;
    let pivot_rows = pivot_rows.read::<Vec4>(PIVOT_ROWS as usize * below)?;
    let scaled_rows = scaled_rows.read::<Vec4>(PIVOT_ROWS as usize * below)?;
    let matrix = matrix.write::<Vec4>(p.rows as usize * below)?;
    let row_tiles = p.rows / TILE_ROWS;
    matrix.par_chunks_mut((TILE_ROWS as usize * below).max(1)).zip(0..row_tiles).for_each(|(rows, row_tile)| {
        let tiles = (0..p.vectors / TILE_VECTORS).map(|k| k * row_tiles + row_tile).filter(|&t| t < p.count);
        for (t, lane) in tiles.flat_map(|t| (0..TILE_VECTORS).map(move |lane| (t, lane))) {
            let (row, vector) = invert::tile_at(t, lane, &p);
            if invert::is_upper(row, vector) {
                let at = |r: u32| r as usize * below + vector as usize;
                let start = |r: u32| rows[at(r)];
                let made = invert::eliminate(row, vector, &p, inverse, pivot_rows, scaled_rows, start);
                (0..TILE_ROWS).zip(made).for_each(|(r, value)| rows[at(r)] = value);
            }
        }
    });
    Ok(())
}
