//! The product with tiles, `y = Σ_k s_k (u_k (v_k·x) + v_k (u_k·x)) + D x + S x`, in seven steps: [`enter`] orders and scales
//! the exitance, [`round`] makes whole numbers of each block's, [`project`] makes the sums `z`, [`weigh`] makes whole numbers of
//! those that belong together, [`expand`] adds them up by rows, [`near`] makes the rows of the dense squares `D` and of the
//! single entries `S`, [`leave`] undoes order and scale.
//!
//! Vectors and squares are whole numbers, so sums and rows are exact, in whatever order they are added up, but for the rounding
//! to 15 bits and a sign: of what is greatest in the block, in the run. Single entries take the exitance as it is.
//!
//! An invocation of [`project`] makes four sums and one of [`expand`] eight rows: what it loads serves them all.

use glam::{IVec3, UVec3, Vec3, Vec4};

use crate::types::{TileQuad, TileSquare, TileVector};

/// Rows and columns of a tile.
pub const TILE: u32 = 128;
/// Lanes of a block: words of a group.
pub const LANES: u32 = 16;
/// Parts of a block: element `r` is in part `r / LANES`, lane `r % LANES`.
pub const PARTS: u32 = TILE / LANES;
/// Twos of parts: k and `k + TWOS` are multiplied together.
pub const TWOS: u32 = PARTS / 2;
/// Slots of a quad.
pub const QUAD: u32 = 4;
/// Most quads of a run, whose sums have one step.
pub const RUN_QUADS: u32 = 8;
/// Pairs of slots of a run.
pub const RUN_PAIRS: u32 = RUN_QUADS * QUAD / 2;
/// Into how many ranges the runs of a block are split, whose rows [`leave`] adds up.
pub const SPLITS: u32 = 4;
/// Words of a square of [`LANES`] rows and columns.
pub const SQUARE_WORDS: u32 = LANES * LANES / 4;
/// Places that the single entries can name.
pub const PLACES: usize = 65_536;
/// The partner of a slot whose vector is multiplied by no sum.
pub const NO_SLOT: u32 = u32::MAX;
/// What is added to elements of 8 and of 4 bits, so that they are not negative.
pub const BIAS: i32 = 128;
/// See [`BIAS`].
pub const SHORT_BIAS: i32 = 8;
/// Channel of components that are for all three.
pub const ALL_CHANNELS: u32 = 3;
/// Words of a channel in a block of [`round`].
pub const CHANNEL_WORDS: u32 = TWOS * LANES;
/// Pairs of neighbours in a part.
pub const PAIRS: u32 = LANES / 2;
/// Words of a block of [`round`]: of each channel a group of each two of parts, which share a word; then the channels' steps;
/// then, from [`PAIRS_AT`] on, the same numbers in pairs of neighbours: of each part, of each channel, [`PAIRS`] words.
pub const LIGHT_WORDS: u32 = PAIRS_AT + PARTS * 3 * PAIRS;
/// See [`LIGHT_WORDS`].
pub const PAIRS_AT: u32 = 3 * CHANNEL_WORDS + LANES;
/// Words of a run of [`weigh`]: for each pair of slots, which share a word, those of the channels; then their steps.
pub const FACTOR_WORDS: u32 = 3 * RUN_PAIRS + 4;

/// Numbers whose bits are those of a whole number, beside the exponent: the lower 16 are its own.
const WHOLE: f32 = 12_582_912.0;
/// Bits of the greatest.
const MOST_WHOLE: u32 = 0x4b40_7fff;
/// The exponent of what counts as 0, `2^-97`.
const DARK: u32 = 30;

/// Step of the whole numbers that stand for numbers of up to `most`: a power of two, `2^-15` to `2^-14` of it; 0 when it is
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

/// The nearest whole number to `x · inverse`, in the lower 16 bits.
#[inline]
pub fn whole(x: f32, inverse: f32) -> u32 {
    let bits = (x * inverse + WHOLE).to_bits();
    if bits > MOST_WHOLE { MOST_WHOLE } else { bits }
}

/// Two whole numbers in a word, one for each channel.
#[inline]
fn pair(a: Vec3, b: Vec3, inverse: Vec3) -> UVec3 {
    let word = |a: f32, b: f32, inverse: f32| whole(a, inverse) & 0xffff | whole(b, inverse) << 16;
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

/// What a vector has in one lane: an element of each part.
#[derive(Clone, Copy)]
struct Lane {
    low: u32,
    high: u32,
    bits: u32,
    mask: u32,
    bias: i32,
}

impl Lane {
    /// Elements of 4 bits: the parts are the nibbles of the words of one group. Of 8 bits: parts 0, 1, 4, 5 are the bytes of
    /// those of the first group, 2, 3, 6, 7 of the second.
    #[inline]
    fn of(words: &[u32], vector: TileVector, lane: u32) -> Self {
        let at = (vector.group * LANES + lane) as usize;
        let low = words[at];
        if vector.is_short {
            Self { low, high: low >> 8, bits: 4, mask: 0x000f_000f, bias: SHORT_BIAS }
        } else {
            Self { low, high: words[at + LANES as usize], bits: 8, mask: 0x00ff_00ff, bias: BIAS }
        }
    }

    /// The elements of parts `two` and `two + TWOS`.
    #[inline]
    fn elements(self, two: u32) -> (i32, i32) {
        let word = if two < TWOS / 2 { self.low } else { self.high };
        let both = word >> (self.bits * (two % (TWOS / 2))) & self.mask;
        ((both & 0xffff) as i32 - self.bias, (both >> 16) as i32 - self.bias)
    }
}

/// Element `r` of a vector.
#[inline]
pub fn element(words: &[u32], vector: TileVector, r: u32) -> i32 {
    let (lane, part) = (Lane::of(words, vector, r % LANES), r / LANES);
    let (first, second) = lane.elements(part % TWOS);
    if part < TWOS { first } else { second }
}

/// The channels of a sum that a slot is for.
#[inline]
pub fn masked(sum: Vec3, channel: u32) -> Vec3 {
    if channel == 0 {
        Vec3::new(sum.x, 0.0, 0.0)
    } else if channel == 1 {
        Vec3::new(0.0, sum.y, 0.0)
    } else if channel == 2 {
        Vec3::new(0.0, 0.0, sum.z)
    } else {
        sum
    }
}

/// Place `p` of the ordered exitance, `x_p = √a_i B_i` with `i = order[p]`; 0 beyond the patches.
///
/// Shapes: `order` and `root` `[patches]`, by place and by patch; `exitance[patches]`, W/m².
#[inline]
pub fn enter(p: u32, patches: u32, order: &[u32], root: &[f32], exitance: &[Vec4]) -> Vec4 {
    if p >= patches {
        return Vec4::ZERO;
    }
    let i = order[p as usize] as usize;
    (exitance[i].truncate() * root[i]).extend(0.0)
}

/// Lane `k % LANES` of a block's exitance in whole numbers: a word of each two of parts and channel, and a channel's step.
///
/// Shapes: `ordered[blocks · TILE]`, `light[blocks · LIGHT_WORDS]`. Needs `k < blocks · LANES`.
#[inline]
pub fn round(k: u32, ordered: &[Vec4], light: &mut [u32]) {
    let (lane, block) = (k % LANES, k / LANES);
    let mut most = Vec3::ZERO;
    for p in block * TILE..(block + 1) * TILE {
        most = most.max(ordered[p as usize].truncate().abs());
    }
    let steps = steps_of(most);
    let inverses = inverses_of(steps);
    let first = block * LIGHT_WORDS + lane;
    for two in 0..TWOS {
        let p = (block * TILE + two * LANES + lane) as usize;
        let both = pair(ordered[p].truncate(), ordered[p + (TWOS * LANES) as usize].truncate(), inverses);
        let at = (first + two * LANES) as usize;
        light[at] = both.x;
        light[at + CHANNEL_WORDS as usize] = both.y;
        light[at + 2 * CHANNEL_WORDS as usize] = both.z;
    }
    // Half a part's pairs.
    for pair_of in PAIRS / 2 * lane..PAIRS / 2 * (lane + 1) {
        let p = (block * TILE + 2 * pair_of) as usize;
        let both = pair(ordered[p].truncate(), ordered[p + 1].truncate(), inverses);
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

/// Steps of the channels, from a word on.
#[inline]
fn steps_at(words: &[u32], at: u32) -> Vec3 {
    let step = |c: u32| f32::from_bits(words[(at + c) as usize]);
    Vec3::new(step(0), step(1), step(2))
}

/// Sums of the four vectors of a quad.
#[derive(Clone, Copy)]
struct Four {
    a: IVec3,
    b: IVec3,
    c: IVec3,
    d: IVec3,
}

impl Four {
    const ZERO: Self = Self { a: IVec3::ZERO, b: IVec3::ZERO, c: IVec3::ZERO, d: IVec3::ZERO };
}

/// Adds what a vector has in parts `two` and `two + TWOS` of a lane.
#[inline]
fn add(sum: IVec3, vector: Lane, two: u32, first: IVec3, second: IVec3) -> IVec3 {
    let (e, f) = vector.elements(two);
    sum + first * e + second * f
}

/// What a lane adds up.
#[inline]
fn lane(quad: TileQuad, lane: u32, words: &[u32], light: &[u32], mut sum: Four) -> Four {
    let a = Lane::of(words, quad.vector(0), lane);
    let b = Lane::of(words, quad.vector(1), lane);
    let c = Lane::of(words, quad.vector(2), lane);
    let d = Lane::of(words, quad.vector(3), lane);
    for two in 0..TWOS {
        let at = (quad.block() * LIGHT_WORDS + two * LANES + lane) as usize;
        let both = UVec3::new(light[at], light[at + CHANNEL_WORDS as usize], light[at + 2 * CHANNEL_WORDS as usize]);
        let (first, second) = (low(both), high(both));
        sum.a = add(sum.a, a, two, first, second);
        sum.b = add(sum.b, b, two, first, second);
        sum.c = add(sum.c, c, two, first, second);
        sum.d = add(sum.d, d, two, first, second);
    }
    sum
}

/// Sums of a quad's slots, `z = s (v·x)`, for their channels.
///
/// Shapes: `quads[n]`, `scale[n · QUAD]`, `words[groups · LANES]`, `light` of [`round`]. Needs `k < n`.
#[inline]
pub fn project(k: u32, quads: &[TileQuad], words: &[u32], scale: &[f32], light: &[u32]) -> [Vec4; QUAD as usize] {
    let quad = quads[k as usize];
    let mut sum = Four::ZERO;
    for l in 0..LANES {
        sum = lane(quad, l, words, light, sum);
    }
    let steps = steps_at(light, quad.block() * LIGHT_WORDS + 3 * CHANNEL_WORDS);
    let (channel, slot) = (quad.channel(), (QUAD * k) as usize);
    [
        masked(sum.a.as_vec3() * steps * scale[slot], channel).extend(0.0),
        masked(sum.b.as_vec3() * steps * scale[slot + 1], channel).extend(0.0),
        masked(sum.c.as_vec3() * steps * scale[slot + 2], channel).extend(0.0),
        masked(sum.d.as_vec3() * steps * scale[slot + 3], channel).extend(0.0),
    ]
}

/// The sum that a slot's vector is multiplied by.
#[inline]
fn factor(slot: u32, partner: &[u32], sums: &[Vec4]) -> Vec3 {
    let other = partner[slot as usize];
    if other == NO_SLOT { Vec3::ZERO } else { sums[other as usize].truncate() }
}

/// What the vectors of run `k` are multiplied by, in whole numbers: a word of each pair of slots and channel, and the steps.
///
/// Shapes: `runs[n + 1]`, the first quad of each; `partner` and `sums` `[quads · QUAD]`; `factors[n · FACTOR_WORDS]`. Needs
/// `k < n`.
#[inline]
pub fn weigh(k: u32, runs: &[u32], partner: &[u32], sums: &[Vec4], factors: &mut [u32]) {
    let (first, end) = (QUAD * runs[k as usize], QUAD * runs[k as usize + 1]);
    let mut most = Vec3::ZERO;
    for slot in first..end {
        most = most.max(factor(slot, partner, sums).abs());
    }
    let steps = steps_of(most);
    let inverses = inverses_of(steps);
    let at = (k * FACTOR_WORDS) as usize;
    for two in 0..RUN_PAIRS {
        let slot = first + 2 * two;
        let mut both = UVec3::ZERO;
        if slot < end {
            both = pair(factor(slot, partner, sums), factor(slot + 1, partner, sums), inverses);
        }
        let at = at + (3 * two) as usize;
        factors[at] = both.x;
        factors[at + 1] = both.y;
        factors[at + 2] = both.z;
    }
    let at = at + (3 * RUN_PAIRS) as usize;
    factors[at] = steps.x.to_bits();
    factors[at + 1] = steps.y.to_bits();
    factors[at + 2] = steps.z.to_bits();
    factors[at + 3] = 0;
}

/// The runs of a block that belong to a split of it, given where they begin and end.
#[inline]
pub fn split_of(split: u32, first: u32, end: u32) -> (u32, u32) {
    (first + (end - first) * split / SPLITS, first + (end - first) * (split + 1) / SPLITS)
}

/// What single entry `k` brings: its column is in the lower 16 bits, its signed value above them.
#[inline]
fn light(k: u32, entries: &[u32], ordered: &[Vec4]) -> Vec3 {
    let entry = entries[k as usize];
    ordered[(entry & 0xffff) as usize].truncate() * ((entry as i32) >> 16) as f32
}

/// The single entries of place `p`, in steps of the place.
#[inline]
fn single(p: u32, row_start: &[u32], entries: &[u32], steps: &[f32], ordered: &[Vec4]) -> Vec3 {
    // Four sums: an addition takes longer than the loads.
    let (mut a, mut b, mut c, mut d) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
    let (mut k, end) = (row_start[p as usize], row_start[p as usize + 1]);
    while k + 4 <= end {
        a += light(k, entries, ordered);
        b += light(k + 1, entries, ordered);
        c += light(k + 2, entries, ordered);
        d += light(k + 3, entries, ordered);
        k += 4;
    }
    if k < end {
        a += light(k, entries, ordered);
    }
    if k + 1 < end {
        b += light(k + 1, entries, ordered);
    }
    if k + 2 < end {
        c += light(k + 2, entries, ordered);
    }
    ((a + b) + (c + d)) * steps[p as usize]
}

/// Four elements of a square's row, in columns 0 and 1, then 2 and 3.
#[inline]
pub fn row_of(word: u32) -> [i32; 4] {
    let byte = |shift: u32| ((word << shift) as i32) >> 24;
    [byte(24), byte(8), byte(16), byte(0)]
}

/// Row of place `p` of what stands by itself: the squares of its part, in the order in which they stand, then the single
/// entries.
///
/// Shapes: `square_start[blocks · PARTS + 1]`, `squares[n]`, `square_words[n · SQUARE_WORDS]`, `light` of [`round`],
/// `row_start[blocks · TILE + 1]`, `steps[blocks · TILE]`, `ordered` long enough for the entries' columns.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn near(
    p: u32,
    square_start: &[u32],
    squares: &[TileSquare],
    square_words: &[u32],
    light: &[u32],
    row_start: &[u32],
    entries: &[u32],
    steps: &[f32],
    ordered: &[Vec4],
) -> Vec4 {
    let (part, lane) = ((p / LANES) as usize, p % LANES);
    let mut row = Vec3::ZERO;
    for k in square_start[part]..square_start[part + 1] {
        let square = squares[k as usize];
        let first = square.column / PARTS * LIGHT_WORDS;
        let pairs = first + PAIRS_AT + square.column % PARTS * (3 * PAIRS);
        let mut sum = IVec3::ZERO;
        for group in 0..SQUARE_WORDS / LANES {
            let [a, b, c, d] = row_of(square_words[(k * SQUARE_WORDS + group * LANES + lane) as usize]);
            let at = (pairs + 2 * group) as usize;
            let (green, blue) = (at + PAIRS as usize, at + 2 * PAIRS as usize);
            let one = UVec3::new(light[at], light[green], light[blue]);
            let other = UVec3::new(light[at + 1], light[green + 1], light[blue + 1]);
            sum += low(one) * a + high(one) * b + low(other) * c + high(other) * d;
        }
        row += sum.as_vec3() * (steps_at(light, first + 3 * CHANNEL_WORDS) * square.step);
    }
    (row + single(p, row_start, entries, steps, ordered)).extend(0.0)
}

/// What lane `k % LANES` of split `k / LANES % SPLITS` of a block adds to its rows, one of each part: each vector of the split
/// times the sum of its partner, which is 0 in the channels that neither is for.
///
/// Shapes: `run_start[blocks + 1]`, `runs`, `factors` of [`weigh`], `quads[n]`.
#[inline]
pub fn expand(
    k: u32,
    run_start: &[u32],
    runs: &[u32],
    quads: &[TileQuad],
    words: &[u32],
    factors: &[u32],
) -> [Vec4; PARTS as usize] {
    let (lane, split, block) = (k % LANES, k / LANES % SPLITS, k / (LANES * SPLITS));
    let (first, end) = split_of(split, run_start[block as usize], run_start[block as usize + 1]);
    // Variables of their own stay in registers.
    let (mut a, mut b, mut c, mut d) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
    let (mut e, mut f, mut g, mut h) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
    for run in first..end {
        let (mut p, mut q, mut r, mut s) = (IVec3::ZERO, IVec3::ZERO, IVec3::ZERO, IVec3::ZERO);
        let (mut t, mut u, mut v, mut w) = (IVec3::ZERO, IVec3::ZERO, IVec3::ZERO, IVec3::ZERO);
        // Quads of a run are alike, and their words follow one another.
        let (first, end) = (runs[run as usize], runs[run as usize + 1]);
        let quad = quads[first as usize];
        for two in 0..QUAD / 2 * (end - first) {
            let at = (run * FACTOR_WORDS + 3 * two) as usize;
            let both = UVec3::new(factors[at], factors[at + 1], factors[at + 2]);
            let (y, z) = (low(both), high(both));
            let one = Lane::of(words, quad.vector(2 * two), lane);
            let other = Lane::of(words, quad.vector(2 * two + 1), lane);
            let ((i, j), (m, n)) = (one.elements(0), other.elements(0));
            p += y * i + z * m;
            t += y * j + z * n;
            let ((i, j), (m, n)) = (one.elements(1), other.elements(1));
            q += y * i + z * m;
            u += y * j + z * n;
            let ((i, j), (m, n)) = (one.elements(2), other.elements(2));
            r += y * i + z * m;
            v += y * j + z * n;
            let ((i, j), (m, n)) = (one.elements(3), other.elements(3));
            s += y * i + z * m;
            w += y * j + z * n;
        }
        let step = steps_at(factors, run * FACTOR_WORDS + 3 * RUN_PAIRS);
        a += p.as_vec3() * step;
        b += q.as_vec3() * step;
        c += r.as_vec3() * step;
        d += s.as_vec3() * step;
        e += t.as_vec3() * step;
        f += u.as_vec3() * step;
        g += v.as_vec3() * step;
        h += w.as_vec3() * step;
    }
    [
        a.extend(0.0),
        b.extend(0.0),
        c.extend(0.0),
        d.extend(0.0),
        e.extend(0.0),
        f.extend(0.0),
        g.extend(0.0),
        h.extend(0.0),
    ]
}

/// Where [`expand`] writes the row of a part: the splits of a block one after another.
#[inline]
pub fn row_at(k: u32, part: u32) -> u32 {
    k / LANES * TILE + part * LANES + k % LANES
}

/// Irradiance of patch `i`, `H_i = y_p / √a_i` with `p = place[i]`, W/m².
///
/// Shapes: `place` and `root` `[patches]`, `rows[blocks · SPLITS · TILE]` of [`expand`], `near[blocks · TILE]`.
#[inline]
pub fn leave(i: u32, place: &[u32], root: &[f32], rows: &[Vec4], near: &[Vec4]) -> Vec4 {
    let p = place[i as usize];
    let row = |split: u32| rows[((p / TILE * SPLITS + split) * TILE + p % TILE) as usize].truncate();
    let near = near[p as usize].truncate();
    ((((row(0) + row(1)) + (row(2) + row(3))) + near) / root[i as usize]).extend(0.0)
}
