//! The product with tiles, `y = Σ_k s_k (u_k (v_k·x) + v_k (u_k·x)) + S x`, in four steps: [`enter`] orders and scales the
//! exitance, [`project`] makes the sums `z`, [`expand`] adds them up by rows, [`leave`] undoes order and scale.
//!
//! An invocation of [`project`] makes four sums and one of [`expand`] eight rows: what it loads serves them all.

use glam::{Vec3, Vec4};

use crate::types::{TileQuad, TileVector};

/// Rows and columns of a tile.
pub const TILE: u32 = 128;
/// Sums that [`project`] keeps apart, so that vectors can take them; words of 8-bit elements that make up a group.
pub const LANES: u32 = 16;
/// Parts of a block: element `r` is in part `r / LANES`, lane `r % LANES`.
pub const PARTS: u32 = TILE / LANES;
/// Slots of a quad.
pub const QUAD: u32 = 4;
/// Into how many ranges the quads of a block are split, whose rows [`leave`] adds up.
pub const SPLITS: u32 = 4;
/// Places that the single entries can name.
pub const PLACES: usize = 65_536;
/// The partner of a slot whose vector is multiplied by no sum.
pub const NO_SLOT: u32 = u32::MAX;
/// What is added to elements of 8 and of 4 bits, so that they are not negative.
pub const BIAS: f32 = 128.0;
/// See [`BIAS`].
pub const SHORT_BIAS: f32 = 8.0;
/// Channel of components that are for all three.
pub const ALL_CHANNELS: u32 = 3;

/// What a vector has in one lane: an element of each part.
#[derive(Clone, Copy)]
struct Lane {
    low: u32,
    high: u32,
    bits: u32,
    most: u32,
    bias: f32,
}

impl Lane {
    /// Elements of 4 bits: the parts are the nibbles of the words of one group; of 8 bits: four parts are the bytes of the
    /// first group, four of the second.
    #[inline]
    fn of(words: &[u32], vector: TileVector, lane: u32) -> Self {
        let at = (vector.group * LANES + lane) as usize;
        let low = words[at];
        if vector.is_short {
            Self { low, high: low >> 16, bits: 4, most: 0xf, bias: SHORT_BIAS }
        } else {
            Self { low, high: words[at + LANES as usize], bits: 8, most: 0xff, bias: BIAS }
        }
    }

    #[inline]
    fn element(self, part: u32) -> f32 {
        let word = if part < PARTS / 2 { self.low } else { self.high };
        ((word >> (self.bits * (part % (PARTS / 2)))) & self.most) as f32 - self.bias
    }
}

/// Element `r` of a vector.
#[inline]
pub fn element(words: &[u32], vector: TileVector, r: u32) -> f32 {
    Lane::of(words, vector, r % LANES).element(r / LANES)
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

/// Sums of the four vectors of a quad.
#[derive(Clone, Copy)]
struct Four {
    a: Vec3,
    b: Vec3,
    c: Vec3,
    d: Vec3,
}

impl Four {
    const ZERO: Self = Self { a: Vec3::ZERO, b: Vec3::ZERO, c: Vec3::ZERO, d: Vec3::ZERO };

    #[inline]
    fn plus(self, other: Self) -> Self {
        Self { a: self.a + other.a, b: self.b + other.b, c: self.c + other.c, d: self.d + other.d }
    }
}

/// What a lane adds up.
#[inline]
fn lane(quad: TileQuad, lane: u32, words: &[u32], ordered: &[Vec4]) -> Four {
    let a = Lane::of(words, quad.vector(0), lane);
    let b = Lane::of(words, quad.vector(1), lane);
    let c = Lane::of(words, quad.vector(2), lane);
    let d = Lane::of(words, quad.vector(3), lane);
    let mut sum = Four::ZERO;
    for part in 0..PARTS {
        let x = ordered[(quad.block() * TILE + part * LANES + lane) as usize].truncate();
        sum.a += x * a.element(part);
        sum.b += x * b.element(part);
        sum.c += x * c.element(part);
        sum.d += x * d.element(part);
    }
    sum
}

/// Sums of a quad's slots, `z = s (v·x)`, for their channels.
///
/// Shapes: `quads[n]`, `scale[n · QUAD]`, `words[groups · LANES]`, `ordered[blocks · TILE]`. Needs `k < n`.
#[inline]
pub fn project(k: u32, quads: &[TileQuad], words: &[u32], scale: &[f32], ordered: &[Vec4]) -> [Vec4; QUAD as usize] {
    let quad = quads[k as usize];
    let (mut a, mut b, mut c, mut d) = (Four::ZERO, Four::ZERO, Four::ZERO, Four::ZERO);
    for four in 0..LANES / 4 {
        a = a.plus(lane(quad, 4 * four, words, ordered));
        b = b.plus(lane(quad, 4 * four + 1, words, ordered));
        c = c.plus(lane(quad, 4 * four + 2, words, ordered));
        d = d.plus(lane(quad, 4 * four + 3, words, ordered));
    }
    let sum = a.plus(c).plus(b.plus(d));
    let (channel, slot) = (quad.channel(), (QUAD * k) as usize);
    [
        (masked(sum.a, channel) * scale[slot]).extend(0.0),
        (masked(sum.b, channel) * scale[slot + 1]).extend(0.0),
        (masked(sum.c, channel) * scale[slot + 2]).extend(0.0),
        (masked(sum.d, channel) * scale[slot + 3]).extend(0.0),
    ]
}

/// The quads of a block that belong to a split of it, given where they begin and end.
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

/// What lane `k % LANES` of split `k / LANES % SPLITS` of a block adds to its rows, one of each part: each vector of the split
/// times the sum of its partner, which is 0 in the channels that neither is for; and the single entries of those two of the
/// parts that are the split's.
///
/// Shapes: `quad_start[blocks + 1]`, `quads[n]`, `partner` and `sums` `[n · QUAD]`, `row_start[blocks · TILE + 1]`,
/// `steps[blocks · TILE]`, `ordered` long enough for the entries' columns.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn expand(
    k: u32,
    quad_start: &[u32],
    quads: &[TileQuad],
    words: &[u32],
    partner: &[u32],
    sums: &[Vec4],
    row_start: &[u32],
    entries: &[u32],
    steps: &[f32],
    ordered: &[Vec4],
) -> [Vec4; PARTS as usize] {
    let (lane, split, block) = (k % LANES, k / LANES % SPLITS, k / (LANES * SPLITS));
    let (first, end) = split_of(split, quad_start[block as usize], quad_start[block as usize + 1]);
    // Variables of their own stay in registers.
    let (mut a, mut b, mut c, mut d) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
    let (mut e, mut f, mut g, mut h) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
    for slot in QUAD * first..QUAD * end {
        let other = partner[slot as usize];
        if other != NO_SLOT {
            let z = sums[other as usize].truncate();
            let own = Lane::of(words, quads[(slot / QUAD) as usize].vector(slot % QUAD), lane);
            a += z * own.element(0);
            b += z * own.element(1);
            c += z * own.element(2);
            d += z * own.element(3);
            e += z * own.element(4);
            f += z * own.element(5);
            g += z * own.element(6);
            h += z * own.element(7);
        }
    }
    let p = block * TILE + 2 * split * LANES + lane;
    let even = single(p, row_start, entries, steps, ordered);
    let odd = single(p + LANES, row_start, entries, steps, ordered);
    if split == 0 {
        a += even;
        b += odd;
    } else if split == 1 {
        c += even;
        d += odd;
    } else if split == 2 {
        e += even;
        f += odd;
    } else {
        g += even;
        h += odd;
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
/// Shapes: `place` and `root` `[patches]`, `rows[blocks · SPLITS · TILE]`.
#[inline]
pub fn leave(i: u32, place: &[u32], root: &[f32], rows: &[Vec4]) -> Vec4 {
    let p = place[i as usize];
    let row = |split: u32| rows[((p / TILE * SPLITS + split) * TILE + p % TILE) as usize].truncate();
    (((row(0) + row(1)) + (row(2) + row(3))) / root[i as usize]).extend(0.0)
}
