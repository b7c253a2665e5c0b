//! Products H = F B for RGB vectors, one row an invocation. B is the exitance and H the irradiance in
//! W/m²; the fourth component is not used.

use glam::{Vec2, Vec3, Vec4};

use crate::types::GatherParams;

/// Irradiance of row `i`, `H_i = Σ_j F_ij B_j`, W/m².
///
/// Shapes: `factors[rows · n]` row-major, `exitance[n]`. Needs `i < rows`.
#[inline]
pub fn gather_row(i: u32, n: u32, factors: &[f32], exitance: &[Vec4]) -> Vec4 {
    let base = i * n;
    let mut sum = Vec4::ZERO;
    for j in 0..n {
        sum += exitance[j as usize] * factors[(base + j) as usize];
    }
    sum
}

/// Words of one row of `n` half-precision numbers, two a word.
#[inline]
pub fn packed_row_words(n: u32) -> u32 {
    n.div_ceil(2)
}

/// Irradiance of row `i` from half-precision factors, W/m². `unpack` splits a word into its lower and upper half.
///
/// Shapes: `packed[rows · packed_row_words(n)]`, the last upper half of odd rows is 0; `exitance[n]`. Needs `i < rows`.
#[inline]
pub fn gather_row_packed(i: u32, n: u32, packed: &[u32], exitance: &[Vec4], unpack: impl Fn(u32) -> Vec2) -> Vec4 {
    let base = i * packed_row_words(n);
    let mut sum = Vec4::ZERO;
    for pair in 0..n / 2 {
        let f = unpack(packed[(base + pair) as usize]);
        sum += exitance[2 * pair as usize] * f.x;
        sum += exitance[2 * pair as usize + 1] * f.y;
    }
    if n % 2 == 1 {
        sum += exitance[(n - 1) as usize] * unpack(packed[(base + n / 2) as usize]).x;
    }
    sum
}

/// Rows that are gathered together, so that the exitance is loaded once for all of them.
pub const ROWS_PER_BATCH: u32 = 4;

/// Invocations that share the columns of [`ROWS_PER_BATCH`] rows in the kernels for buffers.
pub const LANES: u32 = 64;

/// Row in its block that an invocation reads in place of row `i`: the last one where there is none.
#[inline]
pub fn clamp_row(i: u32, rows: u32) -> u32 {
    if i < rows { i } else { rows - 1 }
}

/// Sums of four rows that grow together. Named, not an array: an array would live in memory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RowSums {
    /// Irradiance of the first row so far, W/m².
    pub a: Vec3,
    /// Value of the second row.
    pub b: Vec3,
    /// Value of the third row.
    pub c: Vec3,
    /// Value of the fourth row.
    pub d: Vec3,
}

impl RowSums {
    /// Adds the light from four columns: `a += Σ_k F_ak B_k` and so on, in the order of k. The factors of a row to
    /// the four columns are one vector, `exitance` is that of the four columns.
    #[inline]
    pub fn add(self, a: Vec4, b: Vec4, c: Vec4, d: Vec4, exitance: (Vec4, Vec4, Vec4, Vec4)) -> Self {
        let p = exitance.0.truncate();
        let q = exitance.1.truncate();
        let r = exitance.2.truncate();
        let s = exitance.3.truncate();
        Self {
            a: self.a + p * a.x + q * a.y + r * a.z + s * a.w,
            b: self.b + p * b.x + q * b.y + r * b.z + s * b.w,
            c: self.c + p * c.x + q * c.y + r * c.z + s * c.w,
            d: self.d + p * d.x + q * d.y + r * d.z + s * d.w,
        }
    }
}

/// One step of the tree by which [`LANES`] partial sums become one: lane k takes in lane k + 32, then k + 16, …, k + 1.
#[inline]
pub fn combine(sum: Vec4, other: Vec4) -> Vec4 {
    sum + other
}

/// Sum of one of [`LANES`] lanes for four rows in packed-vector storage: the vectors `lane, lane + 64, …` of each row
/// (a vector is four columns). `factors(row, vector)` and `exitance(column)` load; `rows` are clamped row numbers.
#[inline]
pub fn gather_lane(
    first_row: u32,
    p: &GatherParams,
    lane: u32,
    lanes: u32,
    factors: impl Fn(u32, u32) -> Vec4,
    exitance: impl Fn(u32) -> Vec4,
) -> RowSums {
    let a = clamp_row(first_row, p.rows);
    let b = clamp_row(first_row + 1, p.rows);
    let c = clamp_row(first_row + 2, p.rows);
    let d = clamp_row(first_row + 3, p.rows);
    let mut sums = RowSums { a: Vec3::ZERO, b: Vec3::ZERO, c: Vec3::ZERO, d: Vec3::ZERO };
    let mut vector = lane;
    while vector < p.vectors {
        let j = 4 * vector;
        let light = (exitance(j), exitance(j + 1), exitance(j + 2), exitance(j + 3));
        sums = sums.add(factors(a, vector), factors(b, vector), factors(c, vector), factors(d, vector), light);
        vector += lanes;
    }
    sums
}

/// Irradiance of row `i` from compressed sparse rows, W/m².
///
/// Shapes: `row_start[rows + 1]`, `columns` and `values` `[row_start[rows]]`. Needs `i < rows`.
#[inline]
pub fn gather_row_sparse(i: u32, row_start: &[u32], columns: &[u32], values: &[f32], exitance: &[Vec4]) -> Vec4 {
    let mut sum = Vec4::ZERO;
    for k in row_start[i as usize]..row_start[i as usize + 1] {
        sum += exitance[columns[k as usize] as usize] * values[k as usize];
    }
    sum
}

/// Exitance after a bounce, `B = E + ρ∘H`, W/m².
#[inline]
pub fn bounce(source: Vec4, albedo: Vec4, irradiance: Vec4) -> Vec4 {
    source + albedo * irradiance
}
