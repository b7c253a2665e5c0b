//! Host forms of the kernels of tiles: on all cores, in vectors where the bodies allow it, bit for bit.

use ::multibounce::kernel::low_rank::{
    FACTOR_WORDS, GROUP_VECTORS, LANES, LIGHT_WORDS, NO_VECTOR, PAIRS, PARTS, PERMUTED_INDICES, RUN_GROUPS,
    RUN_INVOCATIONS, SPLITS, SUB_BLOCK_WORDS, TILE, U32X4S,
};
use ::multibounce::{
    DenseSparseTables, PackedGroup, SubBlock, UTables, VtTables, dense_sparse_all, multiply_u_all, multiply_vt_all,
    permute_in_all, permute_out_all, quantise_all, requantise_all,
};
use ::scene::Rgb;

use super::{HostCall, HostError, named};
use crate::params::{CountParams, MultiplyVtParams, PermuteInParams};
use crate::table::Kernel;

/// The greatest of starts that must ascend, or more than any table has.
fn end(starts: &[u32]) -> usize {
    if starts.is_sorted() { starts.last().map_or(0, |&k| k as usize) } else { usize::MAX }
}

/// Words that these packed groups read.
fn words_of(groups: &[PackedGroup]) -> usize {
    let end =
        |group: &PackedGroup| (group.start as usize + (GROUP_VECTORS * group.vector_len()) as usize) * LANES as usize;
    groups.iter().map(end).max().unwrap_or(0)
}

pub(crate) fn permute_in(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [order, sqrt_area, exitance, ordered]) = call.parts::<PermuteInParams, 4>(kernel)?;
    let n = p.count as usize;
    let order = &order.read::<u32>(p.patches as usize)?[..p.patches as usize];
    let patches = named(order);
    permute_in_all(order, sqrt_area.read(patches)?, exitance.read::<Rgb>(patches)?, ordered.write(n)?);
    Ok(())
}

pub(crate) fn quantise(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [ordered, light]) = call.parts::<CountParams, 2>(kernel)?;
    let blocks = p.count as usize / U32X4S as usize;
    let padded_columns = blocks * TILE as usize;
    quantise_all(&ordered.read::<Rgb>(padded_columns)?[..padded_columns], light.write(blocks * LIGHT_WORDS as usize)?);
    Ok(())
}

pub(crate) fn multiply_vt(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [runs, groups, words, scale, light, sums]) = call.parts::<MultiplyVtParams, 6>(kernel)?;
    let runs_count = p.count as usize / RUN_INVOCATIONS as usize;
    let n = runs_of(&runs.read::<u32>(runs_count + 1)?[..runs_count + 1]);
    let groups = &groups.read::<PackedGroup>(n)?[..n];
    let words = words.read::<u32>(words_of(groups))?;
    let blocks = groups.iter().map(|group| group.block() as usize + 1).max().unwrap_or(0);
    let vectors = GROUP_VECTORS as usize * n;
    let light = light.read::<u32>(blocks * LIGHT_WORDS as usize)?;
    let tables = VtTables { chroma_axes: p.chroma_axes, groups, words, scale: scale.read(vectors)? };
    multiply_vt_all(&tables, light, sums.write(vectors)?);
    Ok(())
}

/// Number of packed groups in all runs, each at most [`RUN_GROUPS`]; more than any table has when `runs` does not
/// ascend like that.
fn runs_of(runs: &[u32]) -> usize {
    let few = |run: &[u32]| run[1].checked_sub(run[0]).is_some_and(|groups| groups <= RUN_GROUPS);
    if runs.windows(2).all(few) { runs.last().map_or(0, |&k| k as usize) } else { usize::MAX / GROUP_VECTORS as usize }
}

pub(crate) fn requantise(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [runs, paired, sums, factors]) = call.parts::<CountParams, 4>(kernel)?;
    let n = p.count as usize;
    let runs = &runs.read::<u32>(n + 1)?[..n + 1];
    let vectors = GROUP_VECTORS as usize * runs_of(runs);
    let paired = &paired.read::<u32>(vectors)?[..vectors];
    let others = paired.iter().filter(|&&index| index != NO_VECTOR).map(|&index| index as usize + 1);
    let sums = sums.read::<Rgb>(others.max().unwrap_or(0))?;
    requantise_all(runs, paired, sums, factors.write(n * FACTOR_WORDS as usize)?);
    Ok(())
}

pub(crate) fn multiply_u(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [run_start, runs, groups, words, factors, rows]) = call.parts::<CountParams, 6>(kernel)?;
    let n = p.count as usize;
    let blocks = n / (PAIRS * SPLITS) as usize;
    let run_start = &run_start.read::<u32>(blocks + 1)?[..blocks + 1];
    let count = end(run_start);
    let runs = &runs.read::<u32>(count.saturating_add(1))?[..count + 1];
    let factors = factors.read::<u32>(count * FACTOR_WORDS as usize)?;
    let groups = &groups.read::<PackedGroup>(runs_of(runs))?[..runs_of(runs)];
    let words = words.read::<u32>(words_of(groups))?;
    multiply_u_all(&UTables { run_start, runs, groups, words }, factors, rows.write(2 * PARTS as usize * n)?);
    Ok(())
}

pub(crate) fn dense_sparse(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [sub_block_start, sub_blocks, sub_block_words, light, row_start, entries, steps, ordered, dense_sparse]) =
        call.parts::<CountParams, 9>(kernel)?;
    let n = 8 * p.count as usize;
    let edges = n / LANES as usize;
    let sub_block_start = &sub_block_start.read::<u32>(edges + 1)?[..edges + 1];
    let count = end(sub_block_start);
    let sub_blocks = &sub_blocks.read::<SubBlock>(count)?[..count];
    let sub_block_words = sub_block_words.read::<u32>(count * SUB_BLOCK_WORDS as usize)?;
    let blocks = sub_blocks.iter().map(|sub_block| (sub_block.column / PARTS) as usize + 1).max().unwrap_or(0);
    let light = light.read::<u32>(blocks * LIGHT_WORDS as usize)?;
    let row_start = &row_start.read::<u32>(n + 1)?[..n + 1];
    let entries = entries.read::<u32>(end(row_start))?;
    let tables =
        DenseSparseTables { sub_block_start, sub_blocks, sub_block_words, row_start, entries, steps: steps.read(n)? };
    dense_sparse_all(
        &tables,
        light,
        &ordered.read::<Rgb>(PERMUTED_INDICES)?[..PERMUTED_INDICES],
        dense_sparse.write(n)?,
    );
    Ok(())
}

pub(crate) fn permute_out(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [permuted_index, sqrt_area, rows, dense_sparse, irradiance]) = call.parts::<CountParams, 5>(kernel)?;
    let n = p.count as usize;
    let permuted_index = &permuted_index.read::<u32>(n)?[..n];
    let sqrt_area = sqrt_area.read(n)?;
    let blocks = named(permuted_index).div_ceil(TILE as usize);
    let rows = rows.read::<Rgb>(blocks * (SPLITS * TILE) as usize)?;
    permute_out_all(
        permuted_index,
        sqrt_area,
        rows,
        dense_sparse.read::<Rgb>(blocks * TILE as usize)?,
        irradiance.write(n)?,
    );
    Ok(())
}
