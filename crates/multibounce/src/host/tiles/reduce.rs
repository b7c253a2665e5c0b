//! What a tile becomes: components, squares and entries that are worth their bytes.

use std::vec::Vec;

use faer::Mat;

use crate::kernel::tiles::{BIAS, LANES, SHORT_BIAS, TILE, TWOS};
use crate::types::TileQuad;

/// Size of a tile.
pub(in crate::host) const SIDE: usize = TILE as usize;
/// Rows and columns of a square.
pub(super) const EDGE: usize = LANES as usize;
/// Largest elements of vectors of 4 and of 8 bits.
const MOST_SHORT: f32 = 7.0;
const MOST_LONG: f32 = 127.0;
/// An entry is taken out before components are looked for when it is so many times greater than those that are kept.
const PEAK: f32 = 4.0;
/// Times that what components, squares and entries leave is looked at again.
const MOST_STAGES: usize = 6;
/// Components and squares up to which a tile is not tried again.
const FEW_PARTS: usize = 8;
/// How many times its bytes a component must be worth to come before squares, in the other tries; in the last, none is.
const FIRST: [f32; 3] = [6.0, 36.0, f32::INFINITY];

/// What parts of a tile cost, bytes, and what a byte must take from the squared error.
#[derive(Clone, Copy)]
pub(super) struct Prices {
    pub lambda: f32,
    /// A component of elements of 4 and of 8 bits.
    pub short: f32,
    pub long: f32,
    pub square: f32,
    pub entry: f32,
    /// Orders in which parts are taken that are tried besides: how many times its bytes a component must be worth to come before
    /// squares.
    pub tries: &'static [f32],
}

impl Prices {
    /// Both vectors of a component are projected and expanded. An entry is 8 bytes on both sides of the diagonal, but the time
    /// of 12 bytes of components.
    pub const SYMMETRIC: Self = Self::new((2 * (8 + size_of::<TileQuad>() / 4)) as f32, 12.0);
    /// One vector is projected, which has a scale, the other expanded, which has a partner; an entry is in one row. There are too
    /// many tiles to try other orders.
    pub const RECTANGULAR: Self = Self { tries: &[], ..Self::new((2 * (4 + size_of::<TileQuad>() / 4)) as f32, 8.0) };

    /// With so much for a component beside its vectors, and for an entry.
    const fn new(fixed: f32, entry: f32) -> Self {
        let (short, square) = (SIDE as f32 + fixed, (EDGE * EDGE + 8) as f32);
        Self { lambda: 0.0, short, long: short + SIDE as f32, square, entry, tries: &FIRST }
    }

    /// Of all that a tile became.
    fn of(&self, part: &Part) -> f32 {
        let component = |c: &Component| if c.is_short { self.short } else { self.long };
        part.components.iter().map(component).sum::<f32>()
            + self.square * part.squares.len() as f32
            + self.entry * part.entries.len() as f32
    }
}

/// A pair of vectors of a tile.
pub(super) struct Component {
    pub scale: f32,
    pub channel: u32,
    pub is_short: bool,
    /// Groups of words.
    pub rows: Vec<u32>,
    pub columns: Vec<u32>,
}

impl Component {
    /// Of the vector along the rows (0) or along the columns.
    pub fn words(&self, side: usize) -> &[u32] {
        if side == 0 { &self.rows } else { &self.columns }
    }
}

/// A dense part of a tile: [`EDGE`] rows and columns.
pub(super) struct Square {
    /// First row and column, in edges.
    pub at: (usize, usize),
    pub step: f32,
    /// Steps, row by row.
    pub values: [i8; EDGE * EDGE],
}

/// What a tile becomes.
#[derive(Default)]
pub(super) struct Part {
    pub components: Vec<Component>,
    /// Row and column in the tile, value.
    pub entries: Vec<(u8, u8, f32)>,
    pub squares: Vec<Square>,
    /// Squared error of each channel, both sides of the diagonal.
    pub error: [f64; 3],
}

impl Part {
    fn count(&self) -> usize {
        self.components.len() + self.squares.len() + self.entries.len()
    }
}

/// Sum of the squares.
pub(super) fn squared_norm(tile: &Mat<f32>) -> f64 {
    tile.col_iter().flat_map(|column| column.iter()).map(|&x| f64::from(x) * f64::from(x)).sum()
}

/// What errors count that are even over some neighbours, in a block of the order: light is even over neighbours, so that such
/// errors add up, whereas others cancel.
///
/// In the Haar basis of the halves, quarters and so on of a block, over light of equal exitance (elements are `√a B`), what
/// extends over s places is weighted by [`EVEN`] powers of s; on average the squares are 1.
pub(super) struct Weights(Option<Bases>);

/// To weighted elements and back.
struct Bases {
    there: Mat<f32>,
    back: Mat<f32>,
}

/// Of what errors count, by the places over which they are even. Measured: Sponza's sun, errors for the same bytes 2.4 times
/// smaller than with 0, the smallest of 0, 0.22, 0.34, 0.45 and 0.75.
const EVEN: f32 = 1.0 / 3.0;
/// The same where light comes from the places and none is wanted there.
const EVEN_LIGHT: f32 = 1.0 / 2.0;

impl Weights {
    /// `root`: the square roots of the areas, one for each place.
    pub fn new(root: &[f32]) -> Self {
        Self(Some(Bases::new(root, EVEN)))
    }

    /// Of places at which irradiance is wanted and from which no light comes: errors count the same.
    pub fn even() -> Self {
        Self(None)
    }

    /// Of places from which light comes and at which none is wanted.
    pub fn of_light(root: &[f32]) -> Self {
        Self(Some(Bases::new(root, EVEN_LIGHT)))
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
    fn new(root: &[f32], even: f32) -> Self {
        let mut root = root.to_vec();
        root.resize(SIDE, root[0]);
        let mut basis: Vec<(Vec<f32>, f32)> = vec![(root.clone(), SIDE as f32)];
        let mut extent = SIDE;
        while extent > 1 {
            for first in (0..SIDE).step_by(extent) {
                let middle = first + extent / 2;
                let sum = |range: std::ops::Range<usize>| root[range].iter().map(|r| r * r).sum::<f32>();
                let (left, right) = (sum(first..middle), sum(middle..first + extent));
                let mut vector = vec![0.0; SIDE];
                (first..middle).for_each(|p| vector[p] = root[p] / left);
                (middle..first + extent).for_each(|p| vector[p] = -root[p] / right);
                basis.push((vector, extent as f32));
            }
            extent /= 2;
        }
        let square: f32 = basis.iter().map(|(_, extent)| scene::math::pow(*extent, 2.0 * even)).sum();
        let scale = scene::math::sqrt(SIDE as f32 / square);
        let (mut there, mut back) = (Mat::zeros(SIDE, SIDE), Mat::zeros(SIDE, SIDE));
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

/// Takes components, squares and entries out of a tile as long as they are worth their bytes, in the order that leaves least
/// error and bytes.
///
/// Squares are for what is dense and of high rank, and each component that is found first makes them less dense: so a tile of
/// many parts is tried again, with squares after the components that are worth many times their bytes, or before all.
pub(super) fn reduce(
    rest: &mut Mat<f32>,
    weights: (&Weights, &Weights),
    prices: &Prices,
    channel: u32,
    may_have_entries: bool,
    part: &mut Part,
) {
    let cost = |rest: &Mat<f32>, part: &Part| {
        squared_norm(&weighted(rest, weights)) + f64::from(prices.lambda * prices.of(part))
    };
    let (whole, mut own) = (rest.clone(), Part::default());
    take(rest, weights, prices, channel, may_have_entries, None, &mut own);
    if may_have_entries && own.components.len() + own.squares.len() > FEW_PARTS {
        let mut least = cost(rest, &own);
        for &first in prices.tries {
            let (mut left, mut other) = (whole.clone(), Part::default());
            take(&mut left, weights, prices, channel, true, Some(first), &mut other);
            let found = cost(&left, &other);
            if found < least {
                (least, own) = (found, other);
                *rest = left;
            }
        }
    }
    part.components.append(&mut own.components);
    part.squares.append(&mut own.squares);
    part.entries.append(&mut own.entries);
}

/// Great entries are set aside first, for they would need many components; then components; then squares and entries; and
/// again, because few bits leave something. With `first`, components that are worth so many times their bytes, and squares,
/// before all.
fn take(
    rest: &mut Mat<f32>,
    weights: (&Weights, &Weights),
    prices: &Prices,
    channel: u32,
    may_have_entries: bool,
    first: Option<f32>,
    part: &mut Part,
) {
    if let Some(times) = first {
        take_components(rest, weights, times, prices, channel, part);
        take_squares(rest, prices, &mut part.squares);
    }
    for stage in 0..MOST_STAGES {
        let before = part.count();
        let mut peaks = Vec::new();
        if may_have_entries && stage == 0 {
            take_entries(rest, prices.lambda * prices.entry * PEAK * PEAK, &mut peaks);
        }
        take_components(rest, weights, 1.0, prices, channel, part);
        for &(r, c, value) in &peaks {
            rest[(r as usize, c as usize)] += value;
        }
        if may_have_entries {
            take_squares(rest, prices, &mut part.squares);
            take_entries(rest, prices.lambda * prices.entry, &mut part.entries);
        }
        if before == part.count() {
            return;
        }
    }
}

/// Takes squares that are worth more than their greatest entries would be.
fn take_squares(rest: &mut Mat<f32>, prices: &Prices, out: &mut Vec<Square>) {
    for at in (0..SIDE / EDGE).flat_map(|i| (0..SIDE / EDGE).map(move |j| (i, j))) {
        let (mut most, mut sparse) = (0.0f32, 0.0);
        for c in 0..EDGE {
            for r in 0..EDGE {
                let value = rest[(at.0 * EDGE + r, at.1 * EDGE + c)];
                most = most.max(value.abs());
                sparse += (value * value).min(prices.lambda * prices.entry);
            }
        }
        let step = most / f32::from(i8::MAX);
        let rounding = step * step / 12.0 * (EDGE * EDGE) as f32;
        if rounding + prices.lambda * prices.square >= sparse {
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
        out.push(Square { at, step, values });
    }
}

fn take_entries(rest: &mut Mat<f32>, least: f32, out: &mut Vec<(u8, u8, f32)>) {
    for c in 0..SIDE {
        for r in 0..SIDE {
            let value = rest[(r, c)];
            if value * value > least {
                out.push((r as u8, c as u8, value));
                rest[(r, c)] = 0.0;
            }
        }
    }
}

fn take_components(
    rest: &mut Mat<f32>,
    weights: (&Weights, &Weights),
    worth: f32,
    prices: &Prices,
    channel: u32,
    part: &mut Part,
) {
    if worth.is_infinite() {
        return;
    }
    let weighted = weighted(rest, weights);
    let least = worth * prices.lambda * prices.short;
    // Squares of singular values add up to those of the entries.
    if squared_norm(&weighted) <= f64::from(least) {
        return;
    }
    let Ok(svd) = weighted.thin_svd() else { return };
    let sigma = svd.S().column_vector();
    // The values descend.
    let count = (0..SIDE).take_while(|&k| sigma[k] * sigma[k] > least && sigma[k].is_finite()).count();
    let (u, v) = (weights.0.back(svd.U().subcols(0, count)), weights.1.back(svd.V().subcols(0, count)));
    for k in 0..count {
        let (u, v) = (u.col(k), v.col(k));
        let short = Rounded::new(u, v, MOST_SHORT);
        let long = Rounded::new(u, v, MOST_LONG);
        let (Some(short), Some(long)) = (short, long) else { continue };
        let saved = sigma[k] * sigma[k] * (short.error - long.error);
        let is_short = saved <= prices.lambda * (prices.long - prices.short);
        let rounded = if is_short { short } else { long };
        let scale = sigma[k] * rounded.scale;
        for (c, column) in rounded.columns.iter().enumerate() {
            for (r, row) in rounded.rows.iter().enumerate() {
                rest[(r, c)] -= scale * row * column;
            }
        }
        let (rows, columns) = (pack(&rounded.rows, is_short), pack(&rounded.columns, is_short));
        part.components.push(Component { scale, channel, is_short, rows, columns });
    }
}

/// `u vᵀ` in whole numbers.
struct Rounded {
    rows: Vec<f32>,
    columns: Vec<f32>,
    scale: f32,
    /// Squared error.
    error: f32,
}

impl Rounded {
    /// Of vectors that are not zero.
    fn new(u: faer::ColRef<f32>, v: faer::ColRef<f32>, most: f32) -> Option<Self> {
        let step = |x: faer::ColRef<f32>| x.iter().fold(0.0f32, |m, x| m.max(x.abs())) / most;
        let (step_u, step_v) = (step(u), step(v));
        if !(step_u > 0.0 && step_v > 0.0) {
            return None;
        }
        let whole = |x: faer::ColRef<f32>, step: f32| -> Vec<f32> {
            x.iter().map(|x| scene::math::floor(x / step + 0.5)).collect()
        };
        let (rows, columns) = (whole(u, step_u), whole(v, step_v));
        // |u vᵀ − û v̂ᵀ|², with squares and products of the vectors.
        let products = |x: faer::ColRef<f32>, whole: &[f32], step: f32| {
            x.iter().zip(whole).fold([0.0f32; 3], |[a, b, c], (x, w)| {
                let w = w * step;
                [a + x * x, b + w * w, c + x * w]
            })
        };
        let ([a, b, c], [d, e, f]) = (products(u, &rows, step_u), products(v, &columns, step_v));
        Some(Self { rows, columns, scale: step_u * step_v, error: (a * d + b * e - 2.0 * c * f).max(0.0) })
    }
}

/// Groups of words of a vector, as [`crate::kernel::tiles::element`] reads them.
fn pack(vector: &[f32], is_short: bool) -> Vec<u32> {
    let (lanes, half) = (LANES as usize, TWOS / 2);
    let mut words = vec![0; if is_short { lanes } else { 2 * lanes }];
    for (r, x) in vector.iter().enumerate() {
        let (part, lane) = (r as u32 / LANES, r % lanes);
        let (group, bits, bias) = if is_short {
            (0, 4 * part, SHORT_BIAS)
        } else {
            (part % TWOS / half, 8 * (part % half + part / TWOS * half), BIAS)
        };
        words[group as usize * lanes + lane] |= ((*x as i32 + bias) as u32) << bits;
    }
    words
}
