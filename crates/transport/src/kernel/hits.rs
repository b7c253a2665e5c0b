//! The product H = F B with rows that are counts of hits, one row an invocation. Rows come from rays, so their factors
//! are small integers times one scale a row: columns that were hit equally often stand in groups of four, with one
//! count each.

use glam::{UVec2, Vec4};

/// Columns of a quad.
pub const QUAD_COLUMNS: u32 = 4;

/// Most columns: 16 bits name one.
pub const MAX_HIT_COLUMNS: u32 = 1 << 16;

/// Counts of quads in a word.
pub const WORD_COUNTS: u32 = 4;

/// One step of a quad's count, hits of each of its four columns: a column that fills a quad alone has four times its
/// count.
pub const COUNT_STEP: f32 = 0.25;

/// Irradiance of row `i` from counts of hits, `H_i = s_i Σ_q c_q (B_q0 + B_q1 + B_q2 + B_q3)`, W/m².
///
/// Shapes: row i owns the quads `row_start[i]..row_start[i + 1]`, counted from `first_quad` on; `columns[quads]`, four
/// numbers of 16 bits each, the first in the lowest bits; `counts[quads / 4]`, four bytes a word, in steps of
/// [`COUNT_STEP`]; `scales[rows]`. Needs `i < rows`.
#[inline]
pub fn gather_row_hits(
    i: u32,
    first_quad: u32,
    row_start: &[u32],
    columns: &[UVec2],
    counts: &[u32],
    scales: &[f32],
    exitance: &[Vec4],
) -> Vec4 {
    let mut sum = Vec4::ZERO;
    for quad in row_start[i as usize] - first_quad..row_start[i as usize + 1] - first_quad {
        let four = columns[quad as usize];
        let count = counts[(quad / WORD_COUNTS) as usize] >> (8 * (quad % WORD_COUNTS)) & 0xff;
        let low = exitance[(four.x & 0xffff) as usize] + exitance[(four.x >> 16) as usize];
        let high = exitance[(four.y & 0xffff) as usize] + exitance[(four.y >> 16) as usize];
        sum += (low + high) * count as f32;
    }
    (sum * (COUNT_STEP * scales[i as usize])).truncate().extend(0.0)
}
