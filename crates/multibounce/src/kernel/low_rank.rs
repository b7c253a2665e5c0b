//! The product with tiles, `y = Σ_k s_k (u_k (v_k·x) + v_k (u_k·x)) + D x + S x`, in seven steps:
//! [`permute_in`] permutes and scales the exitance, [`quantise`] quantises it block by block, [`multiply_vt`] makes the
//! sums `z = Vᵀ x`, [`requantise`] quantises these run by run, [`multiply_u`] multiplies by U, [`dense_sparse`] makes
//! the rows of the dense sub-blocks `D` and of the sparse residual `S`, [`permute_out`] undoes permutation and scale.
//!
//! Elements of vectors and sub-blocks are integers, so sums and rows are exact, in whatever order they are added up,
//! but for quantisation to 15 bits and a sign: of the greatest value in the block, in the run. The sparse residual
//! takes the exitance before quantisation.
//!
//! An invocation of [`multiply_vt`] makes up to sixteen sums, one of [`multiply_u`] sixteen rows and one of
//! [`dense_sparse`] eight: what it loads serves them all. Words are loaded as `u32x4`, which costs little more than to
//! load one where loads are made in software.

mod dense_sparse;

use glam::{IVec3, UVec2, UVec3, UVec4, Vec3, Vec4};

use crate::types::{PackedGroup, TileVector};

pub use dense_sparse::{dense_sparse, row_of};

/// Rows and columns of a tile.
pub const TILE: u32 = 128;
/// Lanes of a block: words of a `u32x16`.
pub const LANES: u32 = 16;
/// Parts of a block: element `r` is in part `r / LANES`, lane `r % LANES`.
pub const PARTS: u32 = TILE / LANES;
/// Pairs of parts: k and `k + PART_PAIRS` are multiplied together.
pub const PART_PAIRS: u32 = PARTS / 2;
/// Vectors of a packed group.
pub const GROUP_VECTORS: u32 = 4;
/// Most packed groups of a run, whose sums have one quantisation step.
pub const RUN_GROUPS: u32 = 8;
/// Packed groups whose sums an invocation makes.
pub const INVOCATION_GROUPS: u32 = 4;
/// Invocations for a run, of so many packed groups each.
pub const RUN_INVOCATIONS: u32 = RUN_GROUPS / INVOCATION_GROUPS;
/// Pairs of vectors of a run.
pub const RUN_PAIRS: u32 = RUN_GROUPS * GROUP_VECTORS / 2;
/// Into how many ranges the runs of a block are split, whose rows [`permute_out`] adds up.
pub const SPLITS: u32 = 4;
/// Words of a dense sub-block of [`LANES`] rows and columns.
pub const SUB_BLOCK_WORDS: u32 = LANES * LANES / 4;
/// `u32x4`s of a `u32x16`.
pub const U32X4S: u32 = LANES / 4;
/// Permuted indices that entries of the sparse residual can name.
pub const PERMUTED_INDICES: usize = 65_536;
/// The paired singular vector of one that is multiplied by no sum.
pub const NO_VECTOR: u32 = u32::MAX;
/// Offset that makes elements of 8 and of 4 bits non-negative.
pub const BIAS: i32 = 128;
/// See [`BIAS`].
pub const SHORT_BIAS: i32 = 8;
/// Colour of rank-1 terms that are for all channels alike; 0 and 1 are the chroma axes: of the differences of red and
/// blue to green.
pub const ALL_CHANNELS: u32 = 3;
/// Words of a channel in a block of [`quantise`].
pub const CHANNEL_WORDS: u32 = PART_PAIRS * LANES;
/// Pairs of neighbours in a part.
pub const PAIRS: u32 = LANES / 2;
/// Words of a block of [`quantise`]: of each channel a `u32x16` for each pair of parts, which share words; then the
/// channels' steps; then, from [`PAIRS_AT`] on, the same numbers in pairs of neighbours: of each part, of each channel,
/// [`PAIRS`] words.
pub const LIGHT_WORDS: u32 = PAIRS_AT + PARTS * 3 * PAIRS;
/// See [`LIGHT_WORDS`].
pub const PAIRS_AT: u32 = 3 * CHANNEL_WORDS + LANES;
/// Words of a run of [`requantise`]: for each pair of vectors, which share words, one of each channel and a 0; then
/// their steps.
pub const FACTOR_WORDS: u32 = 4 * (RUN_PAIRS + 1);

/// Added to a number, it leaves the nearest integer in the lower 16 bits.
const QUANTISE_OFFSET: f32 = 12_582_912.0;
/// Bits of the greatest.
const MAX_QUANTISED: u32 = 0x4b40_7fff;
/// The exponent of what counts as 0, `2^-97`.
const DARK: u32 = 30;

/// Quantisation step for numbers of up to `most`: a power of two, `2^-15` to `2^-14` of it; 0 when it is
/// dark.
#[inline]
pub fn step_of(most: f32) -> f32 {
    let exponent = most.to_bits() >> 23 & 0xff;
    if exponent <= DARK { 0.0 } else { f32::from_bits((exponent - 14) << 23) }
}

/// One over a step of [`step_of`], without rounding; 0 for 0.
#[inline]
pub fn inverse_of(step: f32) -> f32 {
    if step == 0.0 { 0.0 } else { f32::from_bits((254 << 23) - step.to_bits()) }
}

/// Quantised value: the nearest integer to `x · inverse`, in the lower 16 bits.
#[inline]
pub fn quantised(x: f32, inverse: f32) -> u32 {
    let bits = (x * inverse + QUANTISE_OFFSET).to_bits();
    if bits > MAX_QUANTISED { MAX_QUANTISED } else { bits }
}

/// Two quantised values in a word, for each channel.
#[inline]
fn i16x2(a: Vec3, b: Vec3, inverse: Vec3) -> UVec3 {
    let word = |a: f32, b: f32, inverse: f32| quantised(a, inverse) & 0xffff | quantised(b, inverse) << 16;
    UVec3::new(word(a.x, b.x, inverse.x), word(a.y, b.y, inverse.y), word(a.z, b.z, inverse.z))
}

/// The lower numbers of words.
#[inline]
fn low(words: UVec3) -> IVec3 {
    let sign = |word: u32| ((word << 16) as i32) >> 16;
    IVec3::new(sign(words.x), sign(words.y), sign(words.z))
}

/// The upper numbers of words.
#[inline]
fn high(words: UVec3) -> IVec3 {
    let sign = |word: u32| (word as i32) >> 16;
    IVec3::new(sign(words.x), sign(words.y), sign(words.z))
}

#[inline]
fn steps_of(most: Vec3) -> Vec3 {
    Vec3::new(step_of(most.x), step_of(most.y), step_of(most.z))
}

#[inline]
fn inverses_of(steps: Vec3) -> Vec3 {
    Vec3::new(inverse_of(steps.x), inverse_of(steps.y), inverse_of(steps.z))
}

/// One lane of a vector: an element of each part.
#[derive(Clone, Copy)]
struct Lane {
    low: u32,
    high: u32,
    is_short: bool,
}

impl Lane {
    /// Elements of 4 bits: the parts are the nibbles of the words of one `u32x16`. Of 8 bits: parts 0, 1, 4, 5 are the
    /// bytes of the first `u32x16`, 2, 3, 6, 7 of the second.
    #[inline]
    fn of(words: &[u32], vector: TileVector, lane: u32) -> Self {
        let at = (vector.start * LANES + lane) as usize;
        let low = words[at];
        let is_short = vector.is_short;
        let high = if is_short { low >> 8u32 } else { words[at + LANES as usize] };
        Self { low, high, is_short }
    }

    /// The elements of parts `part_pair` and `part_pair + PART_PAIRS`, each with its bias, in the halves of a word.
    #[inline]
    fn word(self, part_pair: u32) -> u32 {
        elements(self.low, self.high, part_pair, self.is_short)
    }
}

/// See [`Lane::word`].
#[inline]
fn elements(low: u32, high: u32, part_pair: u32, is_short: bool) -> u32 {
    let word = if part_pair < PART_PAIRS / 2 { low } else { high };
    let bits = if is_short { 4 } else { 8 };
    let mask = if is_short { 0x000f_000f } else { 0x00ff_00ff };
    word >> (bits * (part_pair % (PART_PAIRS / 2))) & mask
}

/// Four lanes of a vector.
#[derive(Clone, Copy)]
struct LanesX4 {
    low: UVec4,
    high: UVec4,
    is_short: bool,
}

impl LanesX4 {
    #[inline]
    fn of(words: &[UVec4], vector: TileVector, x4: u32) -> Self {
        let at = (vector.start * U32X4S + x4) as usize;
        let low = words[at];
        let is_short = vector.is_short;
        let up = |word: u32| word >> 8u32;
        let high =
            if is_short { UVec4::new(up(low.x), up(low.y), up(low.z), up(low.w)) } else { words[at + U32X4S as usize] };
        Self { low, high, is_short }
    }

    /// [`Lane::word`] of the four.
    #[inline]
    fn words(self, part_pair: u32) -> UVec4 {
        let low = self.low;
        let high = self.high;
        let is_short = self.is_short;
        UVec4::new(
            elements(low.x, high.x, part_pair, is_short),
            elements(low.y, high.y, part_pair, is_short),
            elements(low.z, high.z, part_pair, is_short),
            elements(low.w, high.w, part_pair, is_short),
        )
    }
}

/// Two lanes of a vector.
#[derive(Clone, Copy)]
struct LanePair {
    low: UVec2,
    high: UVec2,
    is_short: bool,
}

impl LanePair {
    #[inline]
    fn of(words: &[UVec2], vector: TileVector, lane_pair: u32) -> Self {
        let at = (vector.start * PAIRS + lane_pair) as usize;
        let low = words[at];
        let is_short = vector.is_short;
        let mut high = UVec2::new(low.x >> 8u32, low.y >> 8u32);
        if !is_short {
            high = words[at + PAIRS as usize];
        }
        Self { low, high, is_short }
    }

    #[inline]
    fn first(self) -> Lane {
        Lane { low: self.low.x, high: self.high.x, is_short: self.is_short }
    }

    #[inline]
    fn second(self) -> Lane {
        Lane { low: self.low.y, high: self.high.y, is_short: self.is_short }
    }
}

/// The bias of elements.
#[inline]
fn bias_of(is_short: bool) -> i32 {
    if is_short { SHORT_BIAS } else { BIAS }
}

/// The element in the lower half of a word.
#[inline]
fn first_of(word: u32, bias: i32) -> i32 {
    (word & 0xffff) as i32 - bias
}

/// The element in the upper half.
#[inline]
fn last_of(word: u32, bias: i32) -> i32 {
    (word >> 16) as i32 - bias
}

/// Element `r` of a vector.
#[inline]
pub fn element(words: &[u32], vector: TileVector, r: u32) -> i32 {
    let part = r / LANES;
    let word = Lane::of(words, vector, r % LANES).word(part % PART_PAIRS);
    let bias = bias_of(vector.is_short);
    if part < PART_PAIRS { first_of(word, bias) } else { last_of(word, bias) }
}

/// Weights of the channels of a sum, given the colour of its vector: 1 for all, or the red and blue of one of the two
/// `chroma_axes`.
#[inline]
pub fn chroma_weights(color: u32, chroma_axes: Vec4) -> Vec3 {
    if color == ALL_CHANNELS {
        Vec3::ONE
    } else if color == 0 {
        Vec3::new(chroma_axes.x, 0.0, chroma_axes.y)
    } else {
        Vec3::new(chroma_axes.z, 0.0, chroma_axes.w)
    }
}

/// The channels of a sum that a vector is for: green has no differences.
#[inline]
fn masked(sum: Vec3, color: u32) -> Vec3 {
    if color == ALL_CHANNELS { sum } else { Vec3::new(sum.x, 0.0, sum.z) }
}

/// The exitance at permuted index `p`, `x_p = √a_i B_i` with `i = order[p]`; 0 beyond the patches.
///
/// Shapes: `order` and `sqrt_area` `[patches]`, by permuted index and by patch; `exitance[patches]`, W/m².
#[inline]
pub fn permute_in(p: u32, patches: u32, order: &[u32], sqrt_area: &[f32], exitance: &[Vec4]) -> Vec4 {
    if p >= patches {
        return Vec4::ZERO;
    }
    let i = order[p as usize] as usize;
    (exitance[i].truncate() * sqrt_area[i]).extend(0.0)
}

/// Lanes `4 q` to `4 q + 3` of a block's quantised exitance, `q = k % U32X4S`: a word for each pair of parts and
/// channel, and the channels' steps.
///
/// Shapes: `ordered[blocks · TILE]`, `light[blocks · LIGHT_WORDS]`. Needs `k < blocks · U32X4S`.
#[inline]
pub fn quantise(k: u32, ordered: &[Vec4], light: &mut [u32]) {
    let block = k / U32X4S;
    let mut most = Vec3::ZERO;
    for p in block * TILE..(block + 1) * TILE {
        most = most.max(ordered[p as usize].truncate().abs());
    }
    let steps = steps_of(most);
    let inverses = inverses_of(steps);
    for lane in 4 * (k % U32X4S)..4 * (k % U32X4S + 1) {
        let first = block * LIGHT_WORDS + lane;
        for part_pair in 0..PART_PAIRS {
            let p = (block * TILE + part_pair * LANES + lane) as usize;
            let both = i16x2(ordered[p].truncate(), ordered[p + (PART_PAIRS * LANES) as usize].truncate(), inverses);
            let at = (first + part_pair * LANES) as usize;
            light[at] = both.x;
            light[at + CHANNEL_WORDS as usize] = both.y;
            light[at + 2 * CHANNEL_WORDS as usize] = both.z;
        }
        // Half a part's pairs.
        for pair_of in PAIRS / 2 * lane..PAIRS / 2 * (lane + 1) {
            let p = (block * TILE + 2 * pair_of) as usize;
            let both = i16x2(ordered[p].truncate(), ordered[p + 1].truncate(), inverses);
            let at = (block * LIGHT_WORDS + PAIRS_AT + pair_of / PAIRS * (3 * PAIRS) + pair_of % PAIRS) as usize;
            light[at] = both.x;
            light[at + PAIRS as usize] = both.y;
            light[at + 2 * PAIRS as usize] = both.z;
        }
        let step = if lane == 0 {
            steps.x
        } else if lane == 1 {
            steps.y
        } else if lane == 2 {
            steps.z
        } else {
            0.0
        };
        light[(first + 3 * CHANNEL_WORDS) as usize] = step.to_bits();
    }
}

/// Steps of the channels, which four words hold.
#[inline]
fn steps_at(words: &[UVec4], at: u32) -> Vec3 {
    let steps = words[at as usize];
    Vec3::new(f32::from_bits(steps.x), f32::from_bits(steps.y), f32::from_bits(steps.z))
}

/// Sums of the vectors of a packed group.
#[derive(Clone, Copy)]
struct GroupSums {
    a: IVec3,
    b: IVec3,
    c: IVec3,
    d: IVec3,
}

impl GroupSums {
    const ZERO: Self = Self { a: IVec3::ZERO, b: IVec3::ZERO, c: IVec3::ZERO, d: IVec3::ZERO };
}

/// Adds what a vector has in two parts of a lane: a word of elements with their bias, and the exitance there.
#[inline]
fn add(sum: IVec3, word: u32, bias: i32, first: IVec3, second: IVec3) -> IVec3 {
    sum + first * first_of(word, bias) + second * last_of(word, bias)
}

/// Adds the vectors of a packed group.
#[inline]
fn add_lane(sum: GroupSums, words: UVec4, bias: i32, both: UVec3) -> GroupSums {
    let first = low(both);
    let second = high(both);
    GroupSums {
        a: add(sum.a, words.x, bias, first, second),
        b: add(sum.b, words.y, bias, first, second),
        c: add(sum.c, words.z, bias, first, second),
        d: add(sum.d, words.w, bias, first, second),
    }
}

/// Words of a packed group's vectors in four lanes.
#[derive(Clone, Copy)]
struct GroupWords {
    a: LanesX4,
    b: LanesX4,
    c: LanesX4,
    d: LanesX4,
}

impl GroupWords {
    #[inline]
    fn of(words: &[UVec4], group: PackedGroup, x4: u32) -> Self {
        Self {
            a: LanesX4::of(words, group.vector(0), x4),
            b: LanesX4::of(words, group.vector(1), x4),
            c: LanesX4::of(words, group.vector(2), x4),
            d: LanesX4::of(words, group.vector(3), x4),
        }
    }
}

/// Adds what a packed group's vectors have in two parts of four lanes.
#[inline]
fn add_group(sum: GroupSums, own: GroupWords, part_pair: u32, bias: i32, light: (UVec4, UVec4, UVec4)) -> GroupSums {
    let a = own.a.words(part_pair);
    let b = own.b.words(part_pair);
    let c = own.c.words(part_pair);
    let d = own.d.words(part_pair);
    let (red, green, blue) = light;
    let sum = add_lane(sum, UVec4::new(a.x, b.x, c.x, d.x), bias, UVec3::new(red.x, green.x, blue.x));
    let sum = add_lane(sum, UVec4::new(a.y, b.y, c.y, d.y), bias, UVec3::new(red.y, green.y, blue.y));
    let sum = add_lane(sum, UVec4::new(a.z, b.z, c.z, d.z), bias, UVec3::new(red.z, green.z, blue.z));
    add_lane(sum, UVec4::new(a.w, b.w, c.w, d.w), bias, UVec3::new(red.w, green.w, blue.w))
}

/// The packed groups of invocation `k % RUN_INVOCATIONS` of run `k / RUN_INVOCATIONS`: the first, and how many, 0 to
/// [`INVOCATION_GROUPS`].
#[inline]
pub fn groups_of(k: u32, runs: &[u32]) -> (u32, u32) {
    let run = (k / RUN_INVOCATIONS) as usize;
    let first = runs[run] + k % RUN_INVOCATIONS * INVOCATION_GROUPS;
    let end = runs[run + 1];
    if first + INVOCATION_GROUPS <= end {
        (first, INVOCATION_GROUPS)
    } else if first < end {
        (first, end - first)
    } else {
        (first, 0)
    }
}

/// Sums of the vectors of [`groups_of`], `z = s (v·x)`, for their channels, times their [`chroma_weights`]. Elements
/// beyond them have no meaning.
///
/// Shapes: `groups[n]`, `scale[n]`; `words` and `light` of [`quantise`] as `u32x4`s. Needs `first < n`.
#[inline]
pub fn multiply_vt(
    first: u32,
    count: u32,
    chroma_axes: Vec4,
    groups: &[PackedGroup],
    words: &[UVec4],
    scale: &[Vec4],
    light: &[UVec4],
) -> [Vec4; (INVOCATION_GROUPS * GROUP_VECTORS) as usize] {
    // Those that there are not are the last once more.
    let last = first + count - 1;
    let second = if count > 1 { first + 1 } else { last };
    let third = if count > 2 { first + 2 } else { last };
    let group = groups[first as usize];
    let b = groups[second as usize];
    let c = groups[third as usize];
    let d = groups[last as usize];
    let mut p = GroupSums::ZERO;
    let mut q = GroupSums::ZERO;
    let mut r = GroupSums::ZERO;
    let mut s = GroupSums::ZERO;
    let bias = bias_of(group.is_short());
    for x4 in 0..U32X4S {
        let one = GroupWords::of(words, group, x4);
        let two = GroupWords::of(words, b, x4);
        let three = GroupWords::of(words, c, x4);
        let four = GroupWords::of(words, d, x4);
        for part_pair in 0..PART_PAIRS {
            let at = (group.block() * (LIGHT_WORDS / 4) + part_pair * U32X4S + x4) as usize;
            let channel = (CHANNEL_WORDS / 4) as usize;
            let own = (light[at], light[at + channel], light[at + 2 * channel]);
            p = add_group(p, one, part_pair, bias, own);
            q = add_group(q, two, part_pair, bias, own);
            r = add_group(r, three, part_pair, bias, own);
            s = add_group(s, four, part_pair, bias, own);
        }
    }
    let steps = steps_at(light, group.block() * (LIGHT_WORDS / 4) + 3 * CHANNEL_WORDS / 4);
    // Steps are powers of two: nothing is rounded.
    let steps = steps * chroma_weights(group.color(), chroma_axes);
    let x = scale[first as usize];
    let y = scale[second as usize];
    let z = scale[third as usize];
    let w = scale[last as usize];
    let color = group.color();
    [
        masked(p.a.as_vec3() * steps * x.x, color).extend(0.0),
        masked(p.b.as_vec3() * steps * x.y, color).extend(0.0),
        masked(p.c.as_vec3() * steps * x.z, color).extend(0.0),
        masked(p.d.as_vec3() * steps * x.w, color).extend(0.0),
        masked(q.a.as_vec3() * steps * y.x, color).extend(0.0),
        masked(q.b.as_vec3() * steps * y.y, color).extend(0.0),
        masked(q.c.as_vec3() * steps * y.z, color).extend(0.0),
        masked(q.d.as_vec3() * steps * y.w, color).extend(0.0),
        masked(r.a.as_vec3() * steps * z.x, color).extend(0.0),
        masked(r.b.as_vec3() * steps * z.y, color).extend(0.0),
        masked(r.c.as_vec3() * steps * z.z, color).extend(0.0),
        masked(r.d.as_vec3() * steps * z.w, color).extend(0.0),
        masked(s.a.as_vec3() * steps * w.x, color).extend(0.0),
        masked(s.b.as_vec3() * steps * w.y, color).extend(0.0),
        masked(s.c.as_vec3() * steps * w.z, color).extend(0.0),
        masked(s.d.as_vec3() * steps * w.w, color).extend(0.0),
    ]
}

/// The sum that a vector is multiplied by, given the index of its paired vector.
#[inline]
fn factor(other: u32, sums: &[Vec4]) -> Vec3 {
    if other == NO_VECTOR { Vec3::ZERO } else { sums[other as usize].truncate() }
}

/// The quantised factors of the vectors of run `k`: a word for each pair of vectors and channel, and the steps.
///
/// Shapes, `paired` and `factors` as `u32x4`s: `runs[n + 1]`, the first packed group of each; `paired[groups]`, vector
/// indices, `sums[groups · GROUP_VECTORS]`; `factors[n · FACTOR_WORDS / 4]`. Needs `k < n`.
#[inline]
pub fn requantise(k: u32, runs: &[u32], paired: &[UVec4], sums: &[Vec4], factors: &mut [UVec4]) {
    let first = runs[k as usize];
    let end = runs[k as usize + 1];
    let mut most = Vec3::ZERO;
    for group in first..end {
        let other = paired[group as usize];
        most = most.max(factor(other.x, sums).abs()).max(factor(other.y, sums).abs());
        most = most.max(factor(other.z, sums).abs()).max(factor(other.w, sums).abs());
    }
    let steps = steps_of(most);
    let inverses = inverses_of(steps);
    let at = (k * (FACTOR_WORDS / 4)) as usize;
    for j in 0..RUN_GROUPS {
        let group = first + j;
        let mut one = UVec3::ZERO;
        let mut other = UVec3::ZERO;
        if group < end {
            let other_of = paired[group as usize];
            one = i16x2(factor(other_of.x, sums), factor(other_of.y, sums), inverses);
            other = i16x2(factor(other_of.z, sums), factor(other_of.w, sums), inverses);
        }
        let at = at + (2 * j) as usize;
        factors[at] = one.extend(0);
        factors[at + 1] = other.extend(0);
    }
    factors[at + RUN_PAIRS as usize] = UVec4::new(steps.x.to_bits(), steps.y.to_bits(), steps.z.to_bits(), 0);
}

/// The runs of a block that belong to a split of it, given where they begin and end.
#[inline]
pub fn split_of(split: u32, first: u32, end: u32) -> (u32, u32) {
    (first + (end - first) * split / SPLITS, first + (end - first) * (split + 1) / SPLITS)
}

/// Eight rows.
#[derive(Clone, Copy)]
struct Eight<T> {
    a: T,
    b: T,
    c: T,
    d: T,
    e: T,
    f: T,
    g: T,
    h: T,
}

impl<T: Copy> Eight<T> {
    #[inline]
    fn splat(x: T) -> Self {
        Self { a: x, b: x, c: x, d: x, e: x, f: x, g: x, h: x }
    }
}

/// Adds quantised values times their step.
#[inline]
fn add_scaled(rows: Eight<Vec3>, sum: Eight<IVec3>, step: Vec3) -> Eight<Vec3> {
    Eight {
        a: rows.a + sum.a.as_vec3() * step,
        b: rows.b + sum.b.as_vec3() * step,
        c: rows.c + sum.c.as_vec3() * step,
        d: rows.d + sum.d.as_vec3() * step,
        e: rows.e + sum.e.as_vec3() * step,
        f: rows.f + sum.f.as_vec3() * step,
        g: rows.g + sum.g.as_vec3() * step,
        h: rows.h + sum.h.as_vec3() * step,
    }
}

/// Adds what two vectors bring to the rows of a lane, one of each part.
#[inline]
fn add_parts(sum: Eight<IVec3>, one: Lane, other: Lane, y: IVec3, z: IVec3) -> Eight<IVec3> {
    let bias = bias_of(one.is_short);
    let i = one.word(0);
    let j = one.word(1);
    let k = one.word(2);
    let l = one.word(3);
    let m = other.word(0);
    let n = other.word(1);
    let o = other.word(2);
    let p = other.word(3);
    Eight {
        a: sum.a + y * first_of(i, bias) + z * first_of(m, bias),
        b: sum.b + y * first_of(j, bias) + z * first_of(n, bias),
        c: sum.c + y * first_of(k, bias) + z * first_of(o, bias),
        d: sum.d + y * first_of(l, bias) + z * first_of(p, bias),
        e: sum.e + y * last_of(i, bias) + z * last_of(m, bias),
        f: sum.f + y * last_of(j, bias) + z * last_of(n, bias),
        g: sum.g + y * last_of(k, bias) + z * last_of(o, bias),
        h: sum.h + y * last_of(l, bias) + z * last_of(p, bias),
    }
}

/// Sums that lanes `2 q` and `2 q + 1` of a split of a block add to its rows, of each lane one of each part, with `q =
/// k % PAIRS` and the split and the block above it: each vector of the split times the sum of its paired vector, 0 in
/// the channels that neither is for.
///
/// Shapes: `run_start[blocks + 1]`, `runs`, `factors` of [`requantise`] as `u32x4`s, `groups[n]`, `words` as `u32x2`s.
#[inline]
pub fn multiply_u(
    k: u32,
    run_start: &[u32],
    runs: &[u32],
    groups: &[PackedGroup],
    words: &[UVec2],
    factors: &[UVec4],
) -> [Vec4; 2 * PARTS as usize] {
    let lane_pair = k % PAIRS;
    let split = k / PAIRS % SPLITS;
    let block = k / (PAIRS * SPLITS);
    let (first, end) = split_of(split, run_start[block as usize], run_start[block as usize + 1]);
    let mut rows = Eight::splat(Vec3::ZERO);
    let mut others = Eight::splat(Vec3::ZERO);
    for run in first..end {
        let mut sum = Eight::splat(IVec3::ZERO);
        let mut rest = Eight::splat(IVec3::ZERO);
        // Packed groups of a run have equal channels and bits, and their words follow one another.
        let first = runs[run as usize];
        let end = runs[run as usize + 1];
        let group = groups[first as usize];
        for vector_pair in 0..GROUP_VECTORS / 2 * (end - first) {
            let both = factors[(run * (FACTOR_WORDS / 4) + vector_pair) as usize].truncate();
            let y = low(both);
            let z = high(both);
            let one = LanePair::of(words, group.vector(2 * vector_pair), lane_pair);
            let other = LanePair::of(words, group.vector(2 * vector_pair + 1), lane_pair);
            sum = add_parts(sum, one.first(), other.first(), y, z);
            rest = add_parts(rest, one.second(), other.second(), y, z);
        }
        let step = steps_at(factors, run * (FACTOR_WORDS / 4) + RUN_PAIRS);
        rows = add_scaled(rows, sum, step);
        others = add_scaled(others, rest, step);
    }
    [
        rows.a.extend(0.0),
        rows.b.extend(0.0),
        rows.c.extend(0.0),
        rows.d.extend(0.0),
        rows.e.extend(0.0),
        rows.f.extend(0.0),
        rows.g.extend(0.0),
        rows.h.extend(0.0),
        others.a.extend(0.0),
        others.b.extend(0.0),
        others.c.extend(0.0),
        others.d.extend(0.0),
        others.e.extend(0.0),
        others.f.extend(0.0),
        others.g.extend(0.0),
        others.h.extend(0.0),
    ]
}

/// Row of a part of the first of its lanes, before that of the second, that [`multiply_u`] writes: the splits of a
/// block one after another.
#[inline]
pub fn row_at(k: u32, part: u32) -> u32 {
    k / PAIRS * TILE + part * LANES + 2 * (k % PAIRS)
}

/// Irradiance of patch `i`, `H_i = y_p / √a_i` with `p = permuted_index[i]`, W/m².
///
/// Shapes: `permuted_index` and `sqrt_area` `[patches]`, `rows[blocks · SPLITS · TILE]` of [`multiply_u`],
/// `dense_sparse[blocks · TILE]`.
#[inline]
pub fn permute_out(i: u32, permuted_index: &[u32], sqrt_area: &[f32], rows: &[Vec4], dense_sparse: &[Vec4]) -> Vec4 {
    let p = permuted_index[i as usize];
    let row = |split: u32| rows[((p / TILE * SPLITS + split) * TILE + p % TILE) as usize].truncate();
    let dense_sparse = dense_sparse[p as usize].truncate();
    ((((row(0) + row(1)) + (row(2) + row(3))) + dense_sparse) / sqrt_area[i as usize]).extend(0.0)
}
