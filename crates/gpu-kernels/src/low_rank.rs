//! Kernels of the product with a low-rank operator: the exitance permuted and quantised, its
//! product with Vᵀ, that requantised, its product with U, and the dense and sparse parts.

use ::multibounce::kernel::low_rank;
use ::multibounce::{PackedGroup, SubBlock};
use ::scene::Rgb;
use glam::{UVec2, UVec4, Vec4};

use crate::params::{CountParams, MultiplyVtParams, PermuteInParams};

kernels! {
    /// Exitance in the order of tiles, times √a: [`low_rank::permute_in`]. An invocation takes a
    /// permuted index, of whole blocks.
    MULTIBOUNCE_LOW_RANK_PERMUTE_IN: LowRankPermuteInPass = "multibounce_low_rank_permute_in"(p: PermuteInParams)
    for k in 0..count {
        order: read [u32],
        sqrt_area: read [f32],
        exitance: read [Rgb],
        ordered: write [Rgb],
    } each {
        low_rank::permute_in(k, p.patches, order, sqrt_area, exitance)
    } host crate::host::low_rank::permute_in;

    /// Quantised exitance of the blocks of tiles: [`low_rank::quantise`]. An invocation takes four
    /// lanes of a block.
    MULTIBOUNCE_LOW_RANK_QUANTISE: LowRankQuantisePass = "multibounce_low_rank_quantise"(p: CountParams) for k in 0..count {
        ordered: read [Rgb],
        light: write [u32],
    } invocation {
        low_rank::quantise(k, ordered, light);
    } host crate::host::low_rank::quantise;

    /// Sums of the vectors of tiles (`multibounce::LowRank`): [`low_rank::multiply_vt`]. An invocation
    /// takes a part of a run, four packed groups at most.
    MULTIBOUNCE_LOW_RANK_MULTIPLY_VT: LowRankMultiplyVtPass = "multibounce_low_rank_multiply_vt"(p: MultiplyVtParams)
    for k in 0..count {
        runs: read [u32],
        groups: read [PackedGroup],
        words: read [UVec4],
        scales: read [Vec4],
        light: read [UVec4],
        sums: write [Rgb],
    } invocation {
        let (group, count) = low_rank::groups_of(k, runs);
        if count > 0 {
            let axes = p.chroma_axes;
            let sixteen = low_rank::multiply_vt(group, count, axes, groups, words, scales, light);
            let first = (low_rank::GROUP_VECTORS * group) as usize;
            sums[first] = sixteen[0];
            sums[first + 1] = sixteen[1];
            sums[first + 2] = sixteen[2];
            sums[first + 3] = sixteen[3];
            if count > 1 {
                sums[first + 4] = sixteen[4];
                sums[first + 5] = sixteen[5];
                sums[first + 6] = sixteen[6];
                sums[first + 7] = sixteen[7];
            }
            if count > 2 {
                sums[first + 8] = sixteen[8];
                sums[first + 9] = sixteen[9];
                sums[first + 10] = sixteen[10];
                sums[first + 11] = sixteen[11];
            }
            if count > 3 {
                sums[first + 12] = sixteen[12];
                sums[first + 13] = sixteen[13];
                sums[first + 14] = sixteen[14];
                sums[first + 15] = sixteen[15];
            }
        }
    } host crate::host::low_rank::multiply_vt;

    /// Quantised factors of the vectors of tiles: [`low_rank::requantise`]. An invocation takes a run
    /// of packed groups.
    MULTIBOUNCE_LOW_RANK_REQUANTISE: LowRankRequantisePass = "multibounce_low_rank_requantise"(p: CountParams)
    for k in 0..count {
        runs: read [u32],
        paired: read [UVec4],
        sums: read [Rgb],
        factors: write [UVec4],
    } invocation {
        low_rank::requantise(k, runs, paired, sums, factors);
    } host crate::host::low_rank::requantise;

    /// Rows of the tiles, those of a block's splits one after another: [`low_rank::multiply_u`]. An
    /// invocation takes two lanes of a split of a block: a row of each of their parts.
    MULTIBOUNCE_LOW_RANK_MULTIPLY_U: LowRankMultiplyUPass = "multibounce_low_rank_multiply_u"(p: CountParams)
    for k in 0..count {
        run_start: read [u32],
        runs: read [u32],
        groups: read [PackedGroup],
        words: read [UVec2],
        factors: read [UVec4],
        rows: write [Rgb],
    } invocation {
        let rows_of = low_rank::multiply_u(k, run_start, runs, groups, words, factors);
        rows[low_rank::row_at(k, 0) as usize] = rows_of[0];
        rows[low_rank::row_at(k, 0) as usize + 1] = rows_of[8];
        rows[low_rank::row_at(k, 1) as usize] = rows_of[1];
        rows[low_rank::row_at(k, 1) as usize + 1] = rows_of[9];
        rows[low_rank::row_at(k, 2) as usize] = rows_of[2];
        rows[low_rank::row_at(k, 2) as usize + 1] = rows_of[10];
        rows[low_rank::row_at(k, 3) as usize] = rows_of[3];
        rows[low_rank::row_at(k, 3) as usize + 1] = rows_of[11];
        rows[low_rank::row_at(k, 4) as usize] = rows_of[4];
        rows[low_rank::row_at(k, 4) as usize + 1] = rows_of[12];
        rows[low_rank::row_at(k, 5) as usize] = rows_of[5];
        rows[low_rank::row_at(k, 5) as usize + 1] = rows_of[13];
        rows[low_rank::row_at(k, 6) as usize] = rows_of[6];
        rows[low_rank::row_at(k, 6) as usize + 1] = rows_of[14];
        rows[low_rank::row_at(k, 7) as usize] = rows_of[7];
        rows[low_rank::row_at(k, 7) as usize + 1] = rows_of[15];
    } host crate::host::low_rank::multiply_u;

    /// Rows of the dense sub-blocks and of the sparse residual of tiles: [`low_rank::dense_sparse`].
    /// An invocation takes eight permuted indices. `ordered` covers every index that entries can
    /// name.
    MULTIBOUNCE_LOW_RANK_DENSE_SPARSE: LowRankDenseSparsePass = "multibounce_low_rank_dense_sparse"(p: CountParams)
    for k in 0..count {
        sub_block_start: read [u32],
        sub_blocks: read [SubBlock],
        sub_block_words: read [UVec4],
        light: read [UVec4],
        row_start: read [u32],
        entries: read [u32],
        steps: read [f32],
        ordered: read [Rgb],
        dense_sparse: write [Rgb],
    } invocation {
        let eight = low_rank::dense_sparse(
            k, sub_block_start, sub_blocks, sub_block_words, light, row_start, entries, steps,
            ordered,
        );
        let first = 8 * k as usize;
        dense_sparse[first] = eight[0];
        dense_sparse[first + 1] = eight[1];
        dense_sparse[first + 2] = eight[2];
        dense_sparse[first + 3] = eight[3];
        dense_sparse[first + 4] = eight[4];
        dense_sparse[first + 5] = eight[5];
        dense_sparse[first + 6] = eight[6];
        dense_sparse[first + 7] = eight[7];
    } host crate::host::low_rank::dense_sparse;

    /// Irradiance of the patches from the rows of tiles, W/m²: [`low_rank::permute_out`]. An
    /// invocation takes a patch.
    MULTIBOUNCE_LOW_RANK_PERMUTE_OUT: LowRankPermuteOutPass = "multibounce_low_rank_permute_out"(p: CountParams)
    for k in 0..count {
        permuted_index: read [u32],
        sqrt_area: read [f32],
        rows: read [Rgb],
        dense_sparse: read [Rgb],
        irradiance: write [Rgb],
    } each {
        low_rank::permute_out(k, permuted_index, sqrt_area, rows, dense_sparse)
    } host crate::host::low_rank::permute_out;
}
