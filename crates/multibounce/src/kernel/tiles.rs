//! The product with tiles, `y = Σ_k s_k (u_k (v_k·x) + v_k (u_k·x)) + S x`, in four steps that are one invocation an element each:
//! [`enter`] orders and scales the exitance, [`project`] makes the sums `z`, [`expand`] adds them up by rows, [`leave`]
//! undoes order and scale.

use glam::{Vec3, Vec4};

use crate::types::{TileComponent, TileVector};

/// Rows and columns of a tile.
pub const TILE: u32 = 128;
/// Sums that [`project`] keeps apart, so that vectors can take them; words of 8-bit elements that make up a group.
pub const LANES: u32 = 16;
/// Parts of a block: element `r` is in part `r / LANES`, lane `r % LANES`.
pub const PARTS: u32 = TILE / LANES;
/// What is added to elements of 8 and of 4 bits, so that they are not negative.
pub const BIAS: f32 = 128.0;
/// See [`BIAS`].
pub const SHORT_BIAS: f32 = 8.0;
/// Channel of components that are for all three.
pub const ALL_CHANNELS: u32 = 3;

/// Element `r` of a vector. Elements of 4 bits: the parts are the nibbles of the words of one group; of 8 bits:
/// four parts are the bytes of the first group, four of the second.
#[inline]
pub fn element(words: &[u32], vector: TileVector, r: u32) -> f32 {
    let (part, lane) = (r / LANES, r % LANES);
    if vector.is_short {
        ((words[(vector.group * LANES + lane) as usize] >> (4 * part)) & 0xf) as f32 - SHORT_BIAS
    } else {
        let word = words[((vector.group + part / 4) * LANES + lane) as usize];
        ((word >> (8 * (part % 4))) & 0xff) as f32 - BIAS
    }
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

/// What lane `l` of a vector adds up, from the block of `ordered` that begins at `base`.
#[inline]
fn lane(vector: TileVector, l: u32, base: u32, words: &[u32], ordered: &[Vec4]) -> Vec3 {
    let mut sum = Vec3::ZERO;
    for part in 0..PARTS {
        let r = part * LANES + l;
        sum += ordered[(base + r) as usize].truncate() * element(words, vector, r);
    }
    sum
}

/// Sum of a slot, `z = s (v·x)`, for its channels: slot `2 k + side` is a vector of component k.
///
/// Shapes: `components[n]`, `words[groups · LANES]`, `ordered[blocks · TILE]`. Needs `slot < 2 n`.
#[inline]
pub fn project(slot: u32, components: &[TileComponent], words: &[u32], ordered: &[Vec4]) -> Vec4 {
    let component = components[(slot / 2) as usize];
    let own = component.vector(slot % 2);
    let base = own.block * TILE;
    let (mut a, mut b, mut c, mut d) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
    for four in 0..LANES / 4 {
        a += lane(own, 4 * four, base, words, ordered);
        b += lane(own, 4 * four + 1, base, words, ordered);
        c += lane(own, 4 * four + 2, base, words, ordered);
        d += lane(own, 4 * four + 3, base, words, ordered);
    }
    (masked((a + c) + (b + d), own.channel) * component.scale).extend(0.0)
}

/// Row `p` of the ordered irradiance: each vector of its block times the sum of the other one of its component, and the
/// row's own entries: columns in the lower 16 bits, signed 16-bit values above them, in steps of the row.
///
/// Shapes: `use_start[blocks + 1]`, `uses` names slots, `sums` has two for each of `components`, `row_start[blocks · TILE + 1]`, `steps[blocks · TILE]`.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn expand(
    p: u32,
    use_start: &[u32],
    uses: &[u32],
    components: &[TileComponent],
    words: &[u32],
    sums: &[Vec4],
    row_start: &[u32],
    entries: &[u32],
    steps: &[f32],
    ordered: &[Vec4],
) -> Vec4 {
    let (block, r) = (p / TILE, p % TILE);
    let mut sum = Vec3::ZERO;
    for k in use_start[block as usize]..use_start[block as usize + 1] {
        let slot = uses[k as usize];
        let vector = components[(slot / 2) as usize].vector(slot % 2);
        sum += masked(sums[(slot ^ 1) as usize].truncate(), vector.channel) * element(words, vector, r);
    }
    // Four sums: an addition takes longer than the loads.
    let (mut a, mut b, mut c, mut d) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
    let (first, end) = (row_start[p as usize], row_start[p as usize + 1]);
    for k in first..end {
        let entry = entries[k as usize];
        let light = ordered[(entry & 0xffff) as usize].truncate() * ((entry as i32) >> 16) as f32;
        let turn = (k - first) % 4;
        if turn == 0 {
            a += light;
        } else if turn == 1 {
            b += light;
        } else if turn == 2 {
            c += light;
        } else {
            d += light;
        }
    }
    (sum + ((a + b) + (c + d)) * steps[p as usize]).extend(0.0)
}

/// Irradiance of patch `i`, `H_i = y_p / √a_i` with `p = place[i]`, W/m².
#[inline]
pub fn leave(i: u32, place: &[u32], root: &[f32], ordered: &[Vec4]) -> Vec4 {
    (ordered[place[i as usize] as usize].truncate() / root[i as usize]).extend(0.0)
}
