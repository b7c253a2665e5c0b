//! The inverse of a symmetric positive definite matrix in its place, by Gauss and Jordan's elimination of whole blocks.
//!
//! With the block column k of the matrix M so far, `D = M_kk⁻¹`, `Q = M_k` (rows of the block) and `R = D Q`, a step
//! makes `M_ij − M_ik R_j` of all other entries, `R_j` of the block's rows, `−M_ik D` of its columns and D of the block
//! itself. Rows and columns that were eliminated have the opposite sign on the other side of the diagonal, `M_ij =
//! −M_ji` for i eliminated and j not; else the matrix stays symmetric. So its upper half says all, in n³ operations: Q
//! comes from it, and `M_ik` is Q's column i, or −1 times that.

use glam::Vec4;

use super::multiply::{Four, TILE_ROWS, TILE_VECTORS};
use crate::types::InvertParams;

/// Rows of a block that is eliminated in one step; a tile has columns of whole blocks, and rows of one.
pub const PIVOT_ROWS: u32 = 64;
/// Vectors of four columns of a block.
pub const PIVOT_VECTORS: u32 = PIVOT_ROWS / 4;

/// Four columns of a row of the block that is eliminated: number `k % width` from `first_vector` on, of row `k /
/// width`. From the upper half of the matrix, of which the rows from `first_row` on are bound; where those do not tell
/// it stays as it is `before`.
///
/// Shapes: `matrix[rows * vectors]`, row-major in vectors of four columns. Needs `k < PIVOT_ROWS * width`.
#[inline]
pub fn pivot_row(k: u32, p: &InvertParams, matrix: &[Vec4], before: Vec4) -> Vec4 {
    let row = p.pivot + k / p.width;
    let vector = p.first_vector + k % p.width;
    if vector >= p.pivot / 4 {
        if row < p.first_row || row >= p.first_row + p.rows {
            return before;
        }
        return matrix[((row - p.first_row) * p.vectors + vector) as usize];
    }
    // Eliminated: the other half has the opposite sign.
    let first = 4 * vector;
    if first < p.first_row || first >= p.first_row + p.rows {
        return before;
    }
    let at = ((first - p.first_row) * p.vectors + row / 4) as usize;
    let below = p.vectors as usize;
    let column = row % 4;
    let a = component(matrix[at], column);
    let b = component(matrix[at + below], column);
    let c = component(matrix[at + 2 * below], column);
    let d = component(matrix[at + 3 * below], column);
    -Vec4::new(a, b, c, d)
}

/// Four columns of a row of `R = D Q`, number `k % vectors` of row `k / vectors`.
///
/// Shapes: `inverse[PIVOT_ROWS * PIVOT_VECTORS]` (D), `pivot_rows[PIVOT_ROWS * vectors]` (Q). Needs `k < PIVOT_ROWS *
/// vectors`.
#[inline]
pub fn scaled_row(k: u32, p: &InvertParams, inverse: &[Vec4], pivot_rows: &[Vec4]) -> Vec4 {
    let first = (k / p.vectors * PIVOT_VECTORS) as usize;
    let vector = k % p.vectors;
    let mut sum = Vec4::ZERO;
    for l in 0..PIVOT_VECTORS {
        let left = inverse[first + l as usize];
        let at = (4 * l * p.vectors + vector) as usize;
        let below = p.vectors as usize;
        sum += pivot_rows[at] * left.x;
        sum += pivot_rows[at + below] * left.y;
        sum += pivot_rows[at + 2 * below] * left.z;
        sum += pivot_rows[at + 3 * below] * left.w;
    }
    sum
}

/// First of the rows of tile `t`, counted in the whole matrix, and the vector of its rows that invocation `lane` makes.
#[inline]
pub fn tile_at(t: u32, lane: u32, p: &InvertParams) -> (u32, u32) {
    let row_tiles = p.rows / TILE_ROWS;
    (p.first_row + t % row_tiles * TILE_ROWS, t / row_tiles * TILE_VECTORS + lane)
}

/// Returns true if a vector of a row lies in the upper half of the matrix, or in a block on its diagonal.
#[inline]
pub fn is_upper(row: u32, vector: u32) -> bool {
    vector / PIVOT_VECTORS >= row / PIVOT_ROWS
}

/// Sixteen rows, from `row` on, of four columns of the matrix after a step. `start` gives an entry of a row as it was.
///
/// Shapes: as in [`scaled_row`], `scaled_rows[PIVOT_ROWS * vectors]` (R). Needs `row` and `vector` in the upper half
/// ([`is_upper`]).
#[inline]
pub fn eliminate(
    row: u32,
    vector: u32,
    p: &InvertParams,
    inverse: &[Vec4],
    pivot_rows: &[Vec4],
    scaled_rows: &[Vec4],
    start: impl Fn(u32) -> Vec4,
) -> [Vec4; TILE_ROWS as usize] {
    let below = p.vectors as usize;
    let is_row = row / PIVOT_ROWS == p.pivot / PIVOT_ROWS;
    let is_column = vector / PIVOT_VECTORS == p.pivot / PIVOT_ROWS;
    let mut s;
    let mut t;
    let mut u;
    let mut v;
    if is_row && is_column {
        let first = ((row - p.pivot) * PIVOT_VECTORS + vector - p.pivot / 4) as usize;
        let step = PIVOT_VECTORS as usize;
        s = four(inverse, first, step);
        t = four(inverse, first + 4 * step, step);
        u = four(inverse, first + 8 * step, step);
        v = four(inverse, first + 12 * step, step);
    } else if is_row {
        let first = ((row - p.pivot) * p.vectors + vector) as usize;
        s = four(scaled_rows, first, below);
        t = four(scaled_rows, first + 4 * below, below);
        u = four(scaled_rows, first + 8 * below, below);
        v = four(scaled_rows, first + 12 * below, below);
    } else if is_column {
        // −M_ik D for i that were eliminated before: R's columns i as rows.
        let first = (4 * vector - p.pivot) as usize * below + (row / 4) as usize;
        s = transposed(four(scaled_rows, first, below));
        t = transposed(four(scaled_rows, first + 1, below));
        u = transposed(four(scaled_rows, first + 2, below));
        v = transposed(four(scaled_rows, first + 3, below));
    } else {
        s = Four { a: start(0), b: start(1), c: start(2), d: start(3) };
        t = Four { a: start(4), b: start(5), c: start(6), d: start(7) };
        u = Four { a: start(8), b: start(9), c: start(10), d: start(11) };
        v = Four { a: start(12), b: start(13), c: start(14), d: start(15) };
        let sign = if row < p.pivot { 1.0 } else { -1.0 };
        for l in 0..PIVOT_ROWS as usize {
            let right = scaled_rows[l * below + vector as usize] * sign;
            let left = l * below + (row / 4) as usize;
            s = add(s, pivot_rows[left], right);
            t = add(t, pivot_rows[left + 1], right);
            u = add(u, pivot_rows[left + 2], right);
            v = add(v, pivot_rows[left + 3], right);
        }
    }
    [s.a, s.b, s.c, s.d, t.a, t.b, t.c, t.d, u.a, u.b, u.c, u.d, v.a, v.b, v.c, v.d]
}

/// Vectors of a table: the first, and three that follow it at distances of `step`.
#[inline]
fn four(table: &[Vec4], first: usize, step: usize) -> Four {
    Four { a: table[first], b: table[first + step], c: table[first + 2 * step], d: table[first + 3 * step] }
}

/// Columns as rows.
#[inline]
fn transposed(rows: Four) -> Four {
    let Four { a, b, c, d } = rows;
    Four {
        a: Vec4::new(a.x, b.x, c.x, d.x),
        b: Vec4::new(a.y, b.y, c.y, d.y),
        c: Vec4::new(a.z, b.z, c.z, d.z),
        d: Vec4::new(a.w, b.w, c.w, d.w),
    }
}

/// Four rows of sums, and a row times a number for each.
#[inline]
fn add(sum: Four, left: Vec4, right: Vec4) -> Four {
    Four { a: sum.a + right * left.x, b: sum.b + right * left.y, c: sum.c + right * left.z, d: sum.d + right * left.w }
}

#[inline]
fn component(v: Vec4, k: u32) -> f32 {
    match k {
        0 => v.x,
        1 => v.y,
        2 => v.z,
        _ => v.w,
    }
}
