//! Encoding of a tile: rank-1 terms, dense sub-blocks and entries that lower the rate–distortion cost.

use alloc::vec::Vec;

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::svd::{ComputeSvdVectors, svd, svd_scratch};
use faer::{Col, Mat, Par};

use crate::kernel::low_rank::{ALL_CHANNELS, BIAS, LANES, PART_PAIRS, SHORT_BIAS, TILE};
use crate::types::PackedGroup;

/// Size of a tile.
pub(in crate::host) const SIDE: usize = TILE as usize;
/// Rows and columns of a dense sub-block.
pub(super) const EDGE: usize = LANES as usize;
/// Largest elements of vectors of 4 and of 8 bits.
const MAX_SHORT: f32 = 7.0;
const MAX_LONG: f32 = 127.0;
/// Times that what rank-1 terms, sub-blocks and entries leave is looked at again.
const MAX_STAGES: usize = 6;
/// Rank-1 terms and sub-blocks up to which a tile is not tried again.
const FEW_PARTS: usize = 8;

/// Threads that decompositions count on, whatever there are: bits differ where they count on one, and else do not.
#[cfg(feature = "std")]
const DECOMPOSITION_THREADS: usize = 2;

/// Part that is taken from a tile first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Start {
    Terms,
    /// And sub-blocks.
    Entries,
}

/// The rate–distortion cost: squared error plus λ times bytes, with the bytes of each part of a tile.
#[derive(Clone, Copy)]
pub(super) struct Costs {
    pub lambda: f32,
    /// Bytes of a rank-1 term of elements of 4 and of 8 bits.
    pub short: f32,
    pub long: f32,
    pub sub_block: f32,
    pub entry: f32,
}

impl Costs {
    /// Both vectors of a rank-1 term are multiplied by, as rows of Vᵀ and as columns of U. An entry is 8 bytes on both
    /// sides of the diagonal, but takes the time of 12 bytes of rank-1 terms.
    pub const SYMMETRIC: Self = Self::new((2 * (8 + size_of::<PackedGroup>() / 4)) as f32, 12.0);
    /// One vector is a row of Vᵀ, with a scale, the other a column of U, with the index of its paired vector; an entry
    /// is in one row.
    pub const RECTANGULAR: Self = Self::new((2 * (4 + size_of::<PackedGroup>() / 4)) as f32, 8.0);

    /// With so many bytes for a rank-1 term beside its vectors, and for an entry.
    const fn new(fixed: f32, entry: f32) -> Self {
        let short = SIDE as f32 + fixed;
        let sub_block = (EDGE * EDGE + 8) as f32;
        Self { lambda: 0.0, short, long: short + SIDE as f32, sub_block, entry }
    }

    /// Cost of all parts of a tile.
    fn of(&self, part: &Part) -> f32 {
        part.terms.iter().map(|c| if c.is_short { self.short } else { self.long }).sum::<f32>()
            + self.sub_block * part.sub_blocks.len() as f32
            + self.entry * part.entries.len() as f32
    }
}

/// A rank-1 term of a tile.
pub(super) struct Term {
    pub scale: f32,
    pub color: u32,
    pub is_short: bool,
    /// Words along the rows and along the columns.
    pub words: [Vec<u32>; 2],
}

/// A dense sub-block of a tile: [`EDGE`] rows and columns.
pub(super) struct DenseSubBlock {
    /// First row and column, in edges.
    pub at: (usize, usize),
    pub step: f32,
    /// Steps, row by row.
    pub values: [i8; EDGE * EDGE],
}

/// Encoded part of a tile.
#[derive(Default)]
pub(super) struct Part {
    pub terms: Vec<Term>,
    /// Row and column in the tile, value.
    pub entries: Vec<(u8, u8, f32)>,
    pub sub_blocks: Vec<DenseSubBlock>,
    /// Squared error of each channel, both sides of the diagonal.
    pub error: [f64; 3],
}

impl Part {
    fn append(&mut self, other: &mut Self) {
        self.terms.append(&mut other.terms);
        self.sub_blocks.append(&mut other.sub_blocks);
        self.entries.append(&mut other.entries);
    }

    fn count(&self) -> usize {
        self.terms.len() + self.sub_blocks.len() + self.entries.len()
    }
}

/// Sum of the squares.
pub(super) fn squared_norm(tile: &Mat<f32>) -> f64 {
    dot(tile, tile)
}

/// Sum of the products.
pub(super) fn dot(a: &Mat<f32>, b: &Mat<f32>) -> f64 {
    let columns = a.col_iter().zip(b.col_iter());
    columns.flat_map(|(a, b)| a.iter().zip(b.iter())).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
}

/// Error weights of a block of the order: light is even over neighbours, so that errors that are even over some
/// neighbours add up, whereas others cancel.
///
/// In the Haar basis of a block, which is halved again and again, over light of equal exitance (elements are `√a B`),
/// what extends over s indices is weighted by [`EVEN`] powers of s; on average the squares are 1.
pub(super) struct Weights(Option<Bases>);

/// To weighted elements and back.
struct Bases {
    there: Mat<f32>,
    back: Mat<f32>,
}

/// Share of smooth errors in the weights, by the number of indices over which they are even. Measured: Sponza's sun,
/// errors for the same bytes 2.4 times smaller than with 0, the smallest of 0, 0.22, 0.34, 0.45 and 0.75.
const EVEN: f32 = 1.0 / 3.0;
/// Share of smooth errors for columns only, from which light comes and at which none is wanted.
const EVEN_LIGHT: f32 = 1.0 / 2.0;

impl Weights {
    /// `sqrt_area`: one for each permuted index of the block.
    pub fn new(sqrt_area: &[f32]) -> Self {
        Self(Some(Bases::new(sqrt_area, EVEN)))
    }

    /// Weights of rows only, at which irradiance is wanted and from which no light comes: errors count equally.
    pub fn even() -> Self {
        Self(None)
    }

    /// Weights of columns only, from which light comes and at which none is wanted.
    pub fn of_light(sqrt_area: &[f32]) -> Self {
        Self(Some(Bases::new(sqrt_area, EVEN_LIGHT)))
    }

    fn left(&self, tile: &Mat<f32>) -> Mat<f32> {
        self.0.as_ref().map_or_else(|| tile.clone(), |bases| &bases.there * tile)
    }

    fn right(&self, tile: &Mat<f32>) -> Mat<f32> {
        self.0.as_ref().map_or_else(|| tile.clone(), |bases| tile * &bases.there)
    }

    fn back(&self, vectors: faer::MatRef<f32>) -> Mat<f32> {
        self.0.as_ref().map_or_else(|| vectors.to_owned(), |bases| &bases.back * vectors)
    }
}

impl Bases {
    fn new(sqrt_area: &[f32], even: f32) -> Self {
        let mut sqrt_area = sqrt_area.to_vec();
        sqrt_area.resize(SIDE, sqrt_area[0]);
        let mut basis: Vec<(Vec<f32>, f32)> = vec![(sqrt_area.clone(), SIDE as f32)];
        let mut extent = SIDE;
        while extent > 1 {
            for first in (0..SIDE).step_by(extent) {
                let middle = first + extent / 2;
                let sum = |range: core::ops::Range<usize>| sqrt_area[range].iter().map(|r| r * r).sum::<f32>();
                let left = sum(first..middle);
                let right = sum(middle..first + extent);
                let mut vector = vec![0.0; SIDE];
                (first..middle).for_each(|p| vector[p] = sqrt_area[p] / left);
                (middle..first + extent).for_each(|p| vector[p] = -sqrt_area[p] / right);
                basis.push((vector, extent as f32));
            }
            extent /= 2;
        }
        let sum: f32 = basis.iter().map(|(_, extent)| scene::math::pow(*extent, 2.0 * even)).sum();
        let scale = scene::math::sqrt(SIDE as f32 / sum);
        let mut there = Mat::zeros(SIDE, SIDE);
        let mut back = Mat::zeros(SIDE, SIDE);
        for (vector, extent) in &basis {
            let weight = scale * scene::math::pow(*extent, even);
            let length: f32 = vector.iter().map(|x| x * x).sum();
            for c in 0..SIDE {
                for r in 0..SIDE {
                    let product = vector[r] * vector[c] / length;
                    there[(r, c)] += weight * product;
                    back[(r, c)] += product / weight;
                }
            }
        }
        Self { there, back }
    }
}

/// A tile with its weights on both sides.
fn weighted(tile: &Mat<f32>, (left, right): (&Weights, &Weights)) -> Mat<f32> {
    right.right(&left.left(tile))
}

/// Takes rank-1 terms out of a tile, and sub-blocks and entries out of what all channels have in common, as long as
/// they lower the rate–distortion cost.
///
/// Each is looked for in what the others leave, again and again. What is taken first decides where that ends: rank-1
/// terms that stand for what a sub-block holds, or sub-blocks where few rank-1 terms would do. So a tile of many parts
/// is begun from both ends, and what costs less is kept.
pub(super) fn reduce(rest: &mut Mat<f32>, weights: (&Weights, &Weights), costs: &Costs, color: u32, part: &mut Part) {
    if color != ALL_CHANNELS {
        return take(rest, weights, costs, color, part);
    }
    let cost = |(rest, part): &(Mat<f32>, Part)| {
        squared_norm(&weighted(rest, weights)) + f64::from(costs.lambda * costs.of(part))
    };
    let mut least = begin(Start::Terms, rest, weights, costs);
    if least.1.terms.len() + least.1.sub_blocks.len() > FEW_PARTS {
        let other = begin(Start::Entries, rest, weights, costs);
        if cost(&other) < cost(&least) {
            least = other;
        }
    }
    let mut own;
    (*rest, own) = least;
    part.append(&mut own);
}

/// Remainder of a tile after the first part, and that part.
fn begin(start: Start, tile: &Mat<f32>, weights: (&Weights, &Weights), costs: &Costs) -> (Mat<f32>, Part) {
    let smooth = match start {
        Start::Terms => tile.clone(),
        Start::Entries => tile - stands_out(tile, costs),
    };
    // Sub-blocks and entries are what stands out from rank-1 terms with all of their bits.
    let dense_sparse = stands_out(&(tile - low_rank(&smooth, weights, costs)), costs);
    let mut rest = tile - &dense_sparse;
    let mut part = Part::default();
    take_terms(&mut rest, weights, costs, ALL_CHANNELS, &mut part.terms);
    rest += dense_sparse;
    take_sub_blocks(&mut rest, costs, &mut part.sub_blocks);
    take_entries(&mut rest, costs, &mut part.entries);
    take(&mut rest, weights, costs, ALL_CHANNELS, &mut part);
    (rest, part)
}

/// The rank-1 terms that lower the cost, with all of their bits.
fn low_rank(tile: &Mat<f32>, weights: (&Weights, &Weights), costs: &Costs) -> Mat<f32> {
    let Some((u, v)) = terms(tile, weights, costs.lambda * costs.short) else { return Mat::zeros(SIDE, SIDE) };
    u * v.transpose()
}

/// The sub-blocks and entries that lower the cost, with all of their bits; 0 in between.
fn stands_out(rest: &Mat<f32>, costs: &Costs) -> Mat<f32> {
    let mut left = rest.clone();
    let mut part = Part::default();
    take_sub_blocks(&mut left, costs, &mut part.sub_blocks);
    take_entries(&mut left, costs, &mut part.entries);
    rest - left
}

/// Takes rank-1 terms, sub-blocks and entries, and again, because few bits leave something.
fn take(rest: &mut Mat<f32>, weights: (&Weights, &Weights), costs: &Costs, color: u32, part: &mut Part) {
    for _ in 0..MAX_STAGES {
        let before = part.count();
        take_terms(rest, weights, costs, color, &mut part.terms);
        if color == ALL_CHANNELS {
            take_sub_blocks(rest, costs, &mut part.sub_blocks);
            take_entries(rest, costs, &mut part.entries);
        }
        if before == part.count() {
            return;
        }
    }
}

/// Takes sub-blocks that cost less than their greatest entries would.
fn take_sub_blocks(rest: &mut Mat<f32>, costs: &Costs, out: &mut Vec<DenseSubBlock>) {
    for at in (0..SIDE / EDGE).flat_map(|i| (0..SIDE / EDGE).map(move |j| (i, j))) {
        let mut most = 0.0f32;
        let mut sparse = 0.0;
        for c in 0..EDGE {
            for r in 0..EDGE {
                let value = rest[(at.0 * EDGE + r, at.1 * EDGE + c)];
                most = most.max(value.abs());
                sparse += (value * value).min(costs.lambda * costs.entry);
            }
        }
        let step = most / f32::from(i8::MAX);
        let rounding = step * step / 12.0 * (EDGE * EDGE) as f32;
        if rounding + costs.lambda * costs.sub_block >= sparse {
            continue;
        }
        let mut values = [0; EDGE * EDGE];
        for r in 0..EDGE {
            for c in 0..EDGE {
                let value = &mut rest[(at.0 * EDGE + r, at.1 * EDGE + c)];
                let steps = scene::math::floor(*value / step + 0.5);
                *value -= steps * step;
                values[r * EDGE + c] = steps as i8;
            }
        }
        out.push(DenseSubBlock { at, step, values });
    }
}

fn take_entries(rest: &mut Mat<f32>, costs: &Costs, out: &mut Vec<(u8, u8, f32)>) {
    for c in 0..SIDE {
        for r in 0..SIDE {
            let value = rest[(r, c)];
            if value * value > costs.lambda * costs.entry {
                out.push((r as u8, c as u8, value));
                rest[(r, c)] = 0.0;
            }
        }
    }
}

/// Left singular vectors of a square matrix, its singular values, and its right singular vectors.
fn singular_vectors(matrix: &Mat<f32>) -> Option<(Mat<f32>, Col<f32>, Mat<f32>)> {
    let n = matrix.nrows();
    #[cfg(feature = "std")]
    let parallel = Par::rayon(DECOMPOSITION_THREADS);
    #[cfg(not(feature = "std"))]
    let parallel = Par::Seq;
    let mut left = Mat::zeros(n, n);
    let mut right = Mat::zeros(n, n);
    let mut values = Diag::zeros(n);
    let thin = ComputeSvdVectors::Thin;
    let mut memory = MemBuffer::new(svd_scratch::<f32>(n, n, thin, thin, parallel, Default::default()));
    let stack = MemStack::new(&mut memory);
    let vectors = (Some(left.as_mut()), Some(right.as_mut()));
    svd(matrix.as_ref(), values.as_mut(), vectors.0, vectors.1, parallel, stack, Default::default()).ok()?;
    Some((left, values.column_vector().to_owned(), right))
}

/// Vectors of the rank-1 terms of a tile that take more than `least` from its weighted squared error, one a column: `u
/// vᵀ`.
fn terms(tile: &Mat<f32>, weights: (&Weights, &Weights), least: f32) -> Option<(Mat<f32>, Mat<f32>)> {
    let weighted = weighted(tile, weights);
    // Squares of singular values add up to those of the entries.
    if squared_norm(&weighted) <= f64::from(least) {
        return None;
    }
    let (left, sigma, right) = singular_vectors(&weighted)?;
    // The values descend.
    let count = (0..sigma.nrows()).take_while(|&k| sigma[k] * sigma[k] > least && sigma[k].is_finite()).count();
    let mut u = weights.0.back(left.subcols(0, count));
    let v = weights.1.back(right.subcols(0, count));
    for k in 0..count {
        u.col_mut(k).iter_mut().for_each(|x| *x *= sigma[k]);
    }
    Some((u, v))
}

fn take_terms(rest: &mut Mat<f32>, weights: (&Weights, &Weights), costs: &Costs, color: u32, out: &mut Vec<Term>) {
    let Some((u, v)) = terms(rest, weights, costs.lambda * costs.short) else { return };
    for (u, v) in u.col_iter().zip(v.col_iter()) {
        let short = Rounded::new(u, v, MAX_SHORT);
        let long = Rounded::new(u, v, MAX_LONG);
        let (Some(short), Some(long)) = (short, long) else { continue };
        let saved = short.error - long.error;
        let is_short = saved <= costs.lambda * (costs.long - costs.short);
        let rounded = if is_short { short } else { long };
        let scale = rounded.scale;
        for (c, column) in rounded.columns.iter().enumerate() {
            for (r, row) in rounded.rows.iter().enumerate() {
                rest[(r, c)] -= scale * row * column;
            }
        }
        let words = [&rounded.rows, &rounded.columns].map(|vector| pack(vector, is_short));
        out.push(Term { scale, color, is_short, words });
    }
}

/// `u vᵀ`, quantised.
struct Rounded {
    rows: Vec<f32>,
    columns: Vec<f32>,
    scale: f32,
    /// Squared error.
    error: f32,
}

impl Rounded {
    /// Decomposes vectors that are not zero.
    fn new(u: faer::ColRef<f32>, v: faer::ColRef<f32>, most: f32) -> Option<Self> {
        let step = |x: faer::ColRef<f32>| x.iter().fold(0.0f32, |m, x| m.max(x.abs())) / most;
        let step_u = step(u);
        let step_v = step(v);
        if !(step_u > 0.0 && step_v > 0.0) {
            return None;
        }
        let quantised = |x: faer::ColRef<f32>, step: f32| -> Vec<f32> {
            x.iter().map(|x| scene::math::floor(x / step + 0.5)).collect()
        };
        let rows = quantised(u, step_u);
        let columns = quantised(v, step_v);
        // |u vᵀ − û v̂ᵀ|², with squares and products of the vectors.
        let products = |x: faer::ColRef<f32>, w: &[f32], step: f32| {
            x.iter().zip(w).fold([0.0f32; 3], |[a, b, c], (x, w)| {
                let w = w * step;
                [a + x * x, b + w * w, c + x * w]
            })
        };
        let ([a, b, c], [d, e, f]) = (products(u, &rows, step_u), products(v, &columns, step_v));
        Some(Self { rows, columns, scale: step_u * step_v, error: (a * d + b * e - 2.0 * c * f).max(0.0) })
    }
}

/// Words of a vector, as [`crate::kernel::low_rank::element`] reads them.
fn pack(vector: &[f32], is_short: bool) -> Vec<u32> {
    let lanes = LANES as usize;
    let half = PART_PAIRS / 2;
    let mut words = vec![0; if is_short { lanes } else { 2 * lanes }];
    for (r, x) in vector.iter().enumerate() {
        let part = r as u32 / LANES;
        let lane = r % lanes;
        let (row, bits, bias) = if is_short {
            (0, 4 * part, SHORT_BIAS)
        } else {
            (part % PART_PAIRS / half, 8 * (part % half + part / PART_PAIRS * half), BIAS)
        };
        words[row as usize * lanes + lane] |= ((*x as i32 + bias) as u32) << bits;
    }
    words
}
