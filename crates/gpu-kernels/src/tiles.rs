//! Kernels of the product with tiles: the exitance in their order and in whole numbers, the sums of
//! their vectors, those in whole numbers, the rows, those of squares and single entries.

use ::multibounce::kernel::tiles;
use ::multibounce::{TileQuad, TileSquare};
use ::scene::Rgb;
use glam::{UVec2, UVec4, Vec4};

use crate::params::{CountParams, EnterParams, ProjectParams};

kernels! {
    /// Exitance in the order of tiles, times √a: [`tiles::enter`]. An element is a place, of whole
    /// blocks.
    MULTIBOUNCE_TILES_ENTER = "multibounce_tiles_enter"(p: EnterParams) for k in 0..count {
        order: read [u32],
        root: read [f32],
        exitance: read [Rgb],
        ordered: write [Rgb],
    } each {
        tiles::enter(k, p.patches, order, root, exitance)
    } host crate::host::tiles::enter;

    /// Exitance of the blocks of tiles in whole numbers: [`tiles::round`]. An element is four lanes
    /// of a block.
    MULTIBOUNCE_TILES_ROUND = "multibounce_tiles_round"(p: CountParams) for k in 0..count {
        ordered: read [Rgb],
        light: write [u32],
    } invocation {
        tiles::round(k, ordered, light);
    } host crate::host::tiles::round;

    /// Sums of the vectors of tiles (`multibounce::Tiles`): [`tiles::project`]. An element is a
    /// part of a run, four quads of slots at most.
    MULTIBOUNCE_TILES_PROJECT = "multibounce_tiles_project"(p: ProjectParams) for k in 0..count {
        runs: read [u32],
        quads: read [TileQuad],
        words: read [UVec4],
        scales: read [Vec4],
        light: read [UVec4],
        sums: write [Rgb],
    } invocation {
        let (quad, count) = tiles::quads_of(k, runs);
        if count > 0 {
            let sixteen = tiles::project(quad, count, p.axes, quads, words, scales, light);
            let first = (tiles::QUAD * quad) as usize;
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
    } host crate::host::tiles::project;

    /// What the vectors of tiles are multiplied by, in whole numbers: [`tiles::weigh`]. An element
    /// is a run of quads.
    MULTIBOUNCE_TILES_WEIGH = "multibounce_tiles_weigh"(p: CountParams) for k in 0..count {
        runs: read [u32],
        partner: read [UVec4],
        sums: read [Rgb],
        factors: write [UVec4],
    } invocation {
        tiles::weigh(k, runs, partner, sums, factors);
    } host crate::host::tiles::weigh;

    /// Rows of the tiles, those of a block's splits one after another: [`tiles::expand`]. An
    /// element is two lanes of a split of a block: a row of each of their parts.
    MULTIBOUNCE_TILES_EXPAND = "multibounce_tiles_expand"(p: CountParams) for k in 0..count {
        run_start: read [u32],
        runs: read [u32],
        quads: read [TileQuad],
        words: read [UVec2],
        factors: read [UVec4],
        rows: write [Rgb],
    } invocation {
        let rows_of = tiles::expand(k, run_start, runs, quads, words, factors);
        rows[tiles::row_at(k, 0) as usize] = rows_of[0];
        rows[tiles::row_at(k, 0) as usize + 1] = rows_of[8];
        rows[tiles::row_at(k, 1) as usize] = rows_of[1];
        rows[tiles::row_at(k, 1) as usize + 1] = rows_of[9];
        rows[tiles::row_at(k, 2) as usize] = rows_of[2];
        rows[tiles::row_at(k, 2) as usize + 1] = rows_of[10];
        rows[tiles::row_at(k, 3) as usize] = rows_of[3];
        rows[tiles::row_at(k, 3) as usize + 1] = rows_of[11];
        rows[tiles::row_at(k, 4) as usize] = rows_of[4];
        rows[tiles::row_at(k, 4) as usize + 1] = rows_of[12];
        rows[tiles::row_at(k, 5) as usize] = rows_of[5];
        rows[tiles::row_at(k, 5) as usize + 1] = rows_of[13];
        rows[tiles::row_at(k, 6) as usize] = rows_of[6];
        rows[tiles::row_at(k, 6) as usize + 1] = rows_of[14];
        rows[tiles::row_at(k, 7) as usize] = rows_of[7];
        rows[tiles::row_at(k, 7) as usize + 1] = rows_of[15];
    } host crate::host::tiles::expand;

    /// Rows of the squares and of the single entries of tiles: [`tiles::near`]. An element is eight
    /// places of the order. `ordered` has room for every place that entries can name.
    MULTIBOUNCE_TILES_NEAR = "multibounce_tiles_near"(p: CountParams) for k in 0..count {
        square_start: read [u32],
        squares: read [TileSquare],
        square_words: read [UVec4],
        light: read [UVec4],
        row_start: read [u32],
        entries: read [u32],
        steps: read [f32],
        ordered: read [Rgb],
        near: write [Rgb],
    } invocation {
        let eight = tiles::near(
            k, square_start, squares, square_words, light, row_start, entries, steps, ordered,
        );
        let first = 8 * k as usize;
        near[first] = eight[0];
        near[first + 1] = eight[1];
        near[first + 2] = eight[2];
        near[first + 3] = eight[3];
        near[first + 4] = eight[4];
        near[first + 5] = eight[5];
        near[first + 6] = eight[6];
        near[first + 7] = eight[7];
    } host crate::host::tiles::near;

    /// Irradiance of the patches from the rows of tiles, W/m²: [`tiles::leave`]. An element is a
    /// patch.
    MULTIBOUNCE_TILES_LEAVE = "multibounce_tiles_leave"(p: CountParams) for k in 0..count {
        place: read [u32],
        root: read [f32],
        rows: read [Rgb],
        near: read [Rgb],
        irradiance: write [Rgb],
    } each {
        tiles::leave(k, place, root, rows, near)
    } host crate::host::tiles::leave;
}
