//! A step of Horner's rule as a dense product, in tiles.

use glam::Vec4;

use crate::types::MultiplyParams;

/// Rows of a tile: each invocation makes one vector of every row.
pub const TILE_ROWS: u32 = 16;
/// Vectors of a tile's row, of four columns each: one for each invocation of a workgroup.
pub const TILE_VECTORS: u32 = 64;

/// Four rows of four numbers.
#[derive(Clone, Copy)]
pub(super) struct Four {
    pub a: Vec4,
    pub b: Vec4,
    pub c: Vec4,
    pub d: Vec4,
}

/// First row of tile `t`, and the vector of its rows that invocation `lane` makes. Tiles go down the rows first: those
/// that run at a time share their columns of the operator.
#[inline]
pub fn tile_at(t: u32, lane: u32, p: &MultiplyParams) -> (u32, u32) {
    (t % p.row_tiles * TILE_ROWS, t / p.row_tiles * TILE_VECTORS + lane)
}

/// Sixteen rows of `F_ij + Σ_k F_ik ρ_k T_kj` for four columns j, from row `row` on, with the k that are bound: one
/// term of `T_{K+1} = F + F diag(ρ) T_K`. `start` gives a row's sum of the k before, or `F_ij`.
///
/// Shapes: `factors[rows * vectors]`, `operator[4 * inner * vectors]`, both row-major in vectors of four columns;
/// `albedo` has the ρ of four k in each vector. F, T and ρ have no unit. Needs whole tiles.
#[inline]
pub fn multiply(
    row: u32,
    vector: u32,
    p: &MultiplyParams,
    factors: &[Vec4],
    albedo: &[Vec4],
    operator: &[Vec4],
    start: impl Fn(u32) -> Vec4,
) -> [Vec4; TILE_ROWS as usize] {
    let first = |r: u32| Four { a: start(r), b: start(r + 1), c: start(r + 2), d: start(r + 3) };
    let mut s = first(0);
    let mut t = first(4);
    let mut u = first(8);
    let mut v = first(12);
    for k in 0..p.inner {
        let rho = albedo[(p.first_inner + k) as usize];
        let at = (4 * k * p.vectors + vector) as usize;
        let below = p.vectors as usize;
        let right = Four {
            a: operator[at] * rho.x,
            b: operator[at + below] * rho.y,
            c: operator[at + 2 * below] * rho.z,
            d: operator[at + 3 * below] * rho.w,
        };
        let at = (row * p.vectors + p.first_inner + k) as usize;
        s = add(s, rows(factors, at, below), right);
        t = add(t, rows(factors, at + 4 * below, below), right);
        u = add(u, rows(factors, at + 8 * below, below), right);
        v = add(v, rows(factors, at + 12 * below, below), right);
    }
    [s.a, s.b, s.c, s.d, t.a, t.b, t.c, t.d, u.a, u.b, u.c, u.d, v.a, v.b, v.c, v.d]
}

/// Four rows of a matrix.
#[inline]
fn rows(matrix: &[Vec4], at: usize, below: usize) -> Four {
    Four { a: matrix[at], b: matrix[at + below], c: matrix[at + 2 * below], d: matrix[at + 3 * below] }
}

/// Four rows of sums and of a product.
#[inline]
fn add(sum: Four, left: Four, right: Four) -> Four {
    Four {
        a: add_row(sum.a, left.a, right),
        b: add_row(sum.b, left.b, right),
        c: add_row(sum.c, left.c, right),
        d: add_row(sum.d, left.d, right),
    }
}

#[inline]
fn add_row(sum: Vec4, left: Vec4, right: Four) -> Vec4 {
    sum + right.a * left.x + right.b * left.y + right.c * left.z + right.d * left.w
}
