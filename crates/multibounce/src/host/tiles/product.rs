//! The product with tiles on all cores.

use std::vec::Vec;

use glam::{Mat4, Vec3, Vec4};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::Tiles;
use crate::error::{Error, check_length};
use crate::kernel::tiles::{
    ALL_CHANNELS, BIAS, LANES, NO_SLOT, PARTS, PLACES, QUAD, SHORT_BIAS, SPLITS, TILE, element, enter, leave, masked,
    split_of,
};
use crate::types::TileQuad;

const SIDE: usize = TILE as usize;
const GROUP: usize = LANES as usize;
const FOUR: usize = QUAD as usize;
/// Quads that one task takes.
const TASK_QUADS: usize = 256;
/// Parts of a block whose sums stay in registers together.
const HALF: u32 = PARTS / 2;
/// Vectors that are read for one half of the parts, then for the other: they stay in the first cache.
const TURN: usize = 64;

/// Words of a lane each.
type Group = [u32; GROUP];
/// A colour channel of a block.
type Plane = [f32; SIDE];

/// What a product keeps between its steps: one for products one after another.
#[derive(Clone, Debug, Default)]
pub struct TileRoom {
    ordered: Vec<Vec4>,
    sums: Vec<Vec4>,
    rows: Vec<Vec4>,
}

impl Tiles {
    /// Irradiance `H = T B`, W/m²; the same bits for any number of threads. The fourth component is 0.
    ///
    /// # Errors
    /// [`Error::Length`] unless both have one element a patch.
    pub fn product(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        self.product_in(&mut TileRoom::default(), exitance, irradiance)
    }

    /// As [`Tiles::product`], in room that is kept from product to product.
    ///
    /// # Errors
    /// As [`Tiles::product`].
    pub fn product_in(&self, room: &mut TileRoom, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        check_length("exitance", self.patches(), exitance.len())?;
        check_length("irradiance", self.patches(), irradiance.len())?;
        let TileRoom { ordered, sums, rows } = room;
        ordered.resize(PLACES, Vec4::ZERO);
        sums.resize(self.scale.len(), Vec4::ZERO);
        rows.resize(self.blocks() * SPLITS as usize * SIDE, Vec4::ZERO);
        enter_all(&self.order, &self.root, exitance, &mut ordered[..self.blocks() * SIDE]);
        project_all(&self.quads, &self.words, &self.scale, ordered, sums);
        expand_all(&self.expand_tables(), sums, ordered, rows);
        leave_all(&self.place, &self.root, rows, irradiance);
        Ok(())
    }

    /// Row `i` of `a^-½ T̂ a^½`, one colour a patch, as products multiply by it.
    ///
    /// # Errors
    /// [`Error::Length`] unless there is one element a patch, [`Error::Value`] for a patch that there is not.
    pub fn row(&self, i: usize, row: &mut [Vec3]) -> Result<(), Error> {
        check_length("row", self.patches(), row.len())?;
        let Some(&place) = self.place.get(i) else {
            return Err(Error::Value { name: "patch", index: i, value: i as f64, rule: "one of the patches" });
        };
        let (p, r, block) = (place as usize, place % TILE, place as usize / SIDE);
        let mut places = vec![Vec3::ZERO; self.blocks() * SIDE];
        for slot in QUAD * self.quad_start[block]..QUAD * self.quad_start[block + 1] {
            let partner = self.partner[slot as usize];
            if partner == NO_SLOT {
                continue;
            }
            let vector = |slot: u32| self.quads[(slot / QUAD) as usize].vector(slot % QUAD);
            let quad = self.quads[(partner / QUAD) as usize];
            let factor = self.scale[partner as usize] * element(&self.words, vector(slot), r);
            let factor = masked(Vec3::splat(factor), quad.channel());
            let first = quad.block() as usize * SIDE;
            for (c, sum) in places[first..first + SIDE].iter_mut().enumerate() {
                *sum += factor * element(&self.words, vector(partner), c as u32);
            }
        }
        for &entry in &self.entries[self.row_start[p] as usize..self.row_start[p + 1] as usize] {
            places[(entry & 0xffff) as usize] += Vec3::splat(((entry as i32) >> 16) as f32 * self.steps[p]);
        }
        for (j, value) in row.iter_mut().enumerate() {
            *value = places[self.place[j] as usize] * (self.root[j] / self.root[i]);
        }
        Ok(())
    }

    /// The tables of [`expand_all`].
    pub fn expand_tables(&self) -> ExpandTables<'_> {
        let Self { quad_start, quads, words, partner, row_start, entries, steps, .. } = self;
        ExpandTables { quad_start, quads, words, partner, row_start, entries, steps }
    }
}

/// [`enter`] for every place.
pub fn enter_all(order: &[u32], root: &[f32], exitance: &[Vec4], ordered: &mut [Vec4]) {
    let patches = order.len() as u32;
    ordered.iter_mut().enumerate().for_each(|(p, x)| *x = enter(p as u32, patches, order, root, exitance));
}

/// [`leave`] for every patch.
pub fn leave_all(place: &[u32], root: &[f32], ordered: &[Vec4], irradiance: &mut [Vec4]) {
    irradiance.iter_mut().enumerate().for_each(|(i, h)| *h = leave(i as u32, place, root, ordered));
}

/// [`crate::kernel::tiles::project`] for every quad, bit for bit.
pub fn project_all(quads: &[TileQuad], words: &[u32], scale: &[f32], ordered: &[Vec4], sums: &mut [Vec4]) {
    let (groups, _) = words.as_chunks::<GROUP>();
    let ((blocks, _), (scale, _)) = (ordered.as_chunks::<SIDE>(), scale.as_chunks::<FOUR>());
    let (sums, _) = sums.as_chunks_mut::<FOUR>();
    let arch = Arch::new();
    let tasks = quads.par_chunks(TASK_QUADS).zip(scale.par_chunks(TASK_QUADS)).zip(sums.par_chunks_mut(TASK_QUADS));
    tasks.for_each(|((quads, scale), sums)| {
        let mut done = 0;
        for alike in quads.chunk_by(|a, b| a.tag == b.tag) {
            let (first, end) = (done, done + alike.len());
            done = end;
            let light = &blocks[alike[0].block() as usize];
            // Nothing comes of darkness.
            if light.iter().all(|x| *x == Vec4::ZERO) {
                sums[first..end].fill([Vec4::ZERO; FOUR]);
                continue;
            }
            let (scale, sums) = (&scale[first..end], &mut sums[first..end]);
            arch.dispatch(Project { quads: alike, groups, light, scale, sums });
        }
    });
}

/// What [`expand_all`] reads beside the sums and the ordered exitance.
#[derive(Clone, Copy, Debug)]
pub struct ExpandTables<'a> {
    /// Quads of block b: `quads[quad_start[b]..quad_start[b + 1]]`.
    pub quad_start: &'a [u32],
    /// Vectors by fours, block by block.
    pub quads: &'a [TileQuad],
    /// Their elements, in groups of [`LANES`] words.
    pub words: &'a [u32],
    /// Slot by whose sum each is multiplied, or [`NO_SLOT`].
    pub partner: &'a [u32],
    /// Entries of each place.
    pub row_start: &'a [u32],
    /// Column in the lower 16 bits, value in the upper.
    pub entries: &'a [u32],
    /// Step of the values of each place.
    pub steps: &'a [f32],
}

/// [`crate::kernel::tiles::expand`] for every lane, bit for bit.
///
/// # Panics
/// Unless `ordered` has [`PLACES`] elements, as many as entries can name.
pub fn expand_all(tables: &ExpandTables, sums: &[Vec4], ordered: &[Vec4], rows: &mut [Vec4]) {
    let ordered: &[Vec4; PLACES] = ordered.try_into().expect("PLACES elements");
    let (groups, _) = tables.words.as_chunks::<GROUP>();
    let (partner, _) = tables.partner.as_chunks::<FOUR>();
    let arch = Arch::new();
    rows.par_chunks_mut(SPLITS as usize * SIDE).enumerate().for_each(|(block, rows)| {
        let mut uses = Vec::new();
        for (split, rows) in rows.chunks_exact_mut(SIDE).enumerate() {
            let (first, end) = split_of(split as u32, tables.quad_start[block], tables.quad_start[block + 1]);
            let range = first as usize..end as usize;
            let (quads, mut partner) = (&tables.quads[range.clone()], &partner[range]);
            let mut planes = [[0.0f32; SIDE]; 3];
            for alike in quads.chunk_by(|a, b| a.tag == b.tag) {
                let (own, rest) = partner.split_at(alike.len());
                partner = rest;
                uses.clear();
                for (quad, partner) in alike.iter().zip(own) {
                    for (k, &other) in (0u32..).zip(partner) {
                        let z = if other == NO_SLOT { Vec4::ZERO } else { sums[other as usize] };
                        if z != Vec4::ZERO {
                            uses.push((quad.vector(k).group, z));
                        }
                    }
                }
                let (is_short, channel) = (alike[0].is_short(), alike[0].channel());
                arch.dispatch(Expand { groups, uses: &uses, is_short, channel, planes: &mut planes });
            }
            for (r, row) in rows.iter_mut().enumerate() {
                *row = Vec4::new(planes[0][r], planes[1][r], planes[2][r], 0.0);
            }
            // The entries of two parts are this split's.
            let first = split * SIDE / SPLITS as usize;
            let rows = &mut rows[first..first + SIDE / SPLITS as usize];
            arch.dispatch(Entries { tables, first: block * SIDE + first, ordered, rows });
        }
    });
}

/// Elements of an even and an odd part come times so many powers of two, which undo their bits' place in the word.
#[inline(always)]
const fn shift(is_short: bool, part: usize) -> u32 {
    if is_short { 4 * (part as u32 % 4) } else { 8 * (part as u32 % 2) }
}

#[inline(always)]
const fn unshift(is_short: bool, part: usize) -> f32 {
    1.0 / (1u32 << shift(is_short, part)) as f32
}

/// Elements of the parts of one half of a vector, lanes of register `k` of each, times `2^shift`: bits of a float of 2²³ and
/// more are integers, so what is to be done is to leave the other bits out and to take off the bias.
#[inline(always)]
fn half_of<S: Simd, const SHORT: bool>(simd: S, groups: &[Group], half: usize, k: usize) -> [S::f32s; HALF as usize] {
    let words = S::as_simd_u32s(&groups[if SHORT { 0 } else { half }]).0[k];
    let moved = simd.wrapping_dyn_shr_u32s(words, simd.splat_u32s(16));
    let mut out = [simd.splat_f32s(0.0); HALF as usize];
    for (part, out) in out.iter_mut().enumerate() {
        let (most, bias) = if SHORT { (0xfu32, SHORT_BIAS) } else { (0xff, BIAS) };
        let words = if if SHORT { half == 0 } else { part < 2 } { words } else { moved };
        let shift = shift(SHORT, part);
        let bits = simd.or_u32s(simd.and_u32s(words, simd.splat_u32s(most << shift)), simd.splat_u32s(0x4b00_0000));
        let bias = simd.splat_f32s(8_388_608.0 + bias * (1u32 << shift) as f32);
        *out = simd.sub_f32s(simd.transmute_f32s_u32s(bits), bias);
    }
    out
}

/// Rounded after the product, as the kernels do.
#[inline(always)]
fn add_product<S: Simd>(simd: S, sum: S::f32s, a: S::f32s, b: S::f32s) -> S::f32s {
    simd.add_f32s(sum, simd.mul_f32s(a, b))
}

/// Sums of some quads that are alike.
struct Project<'a> {
    quads: &'a [TileQuad],
    groups: &'a [Group],
    light: &'a [Vec4; SIDE],
    scale: &'a [[f32; FOUR]],
    sums: &'a mut [[Vec4; FOUR]],
}

impl WithSimd for Project<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match (self.quads[0].is_short(), self.quads[0].channel()) {
            (true, ALL_CHANNELS) => self.sums::<S, true, 1, 3>(simd, [0, 1, 2]),
            (true, channel) => self.sums::<S, true, 1, 1>(simd, [channel as usize]),
            (false, ALL_CHANNELS) => self.sums::<S, false, 2, 3>(simd, [0, 1, 2]),
            (false, channel) => self.sums::<S, false, 2, 1>(simd, [channel as usize]),
        }
    }
}

impl Project<'_> {
    #[inline(always)]
    fn sums<S: Simd, const SHORT: bool, const GROUPS: usize, const C: usize>(self, simd: S, channels: [usize; C]) {
        let mut planes = [[0.0; SIDE]; C];
        for (plane, c) in planes.iter_mut().zip(channels) {
            let scaled = |(r, x): (usize, &Vec4)| x[c] * unshift(SHORT, r / GROUP);
            plane.iter_mut().zip(self.light.iter().enumerate()).for_each(|(x, light)| *x = scaled(light));
        }
        for ((quad, scale), sums) in self.quads.iter().zip(self.scale).zip(self.sums) {
            let first = quad.group as usize;
            let (vectors, _) = self.groups[first..first + FOUR * GROUPS].as_chunks::<GROUPS>();
            for ((vector, scale), sum) in vectors.iter().zip(scale).zip(sums) {
                let lanes = lanes::<S, SHORT, C>(simd, vector, &planes);
                // As the kernel adds up lanes: by fours, and then the four.
                let fours = lanes.map(|lanes| {
                    let (fours, _) = lanes.as_chunks::<4>();
                    fours.iter().fold(Vec4::ZERO, |sum, four| sum + Vec4::from_array(*four))
                });
                let mut columns = [Vec4::ZERO; 4];
                channels.iter().zip(fours).for_each(|(&c, four)| columns[c] = four);
                let rows = Mat4::from_cols(columns[0], columns[1], columns[2], columns[3]).transpose();
                let z = ((rows.x_axis + rows.z_axis) + (rows.y_axis + rows.w_axis)) * *scale;
                *sum = z.truncate().extend(0.0);
            }
        }
    }
}

/// What the lanes of a vector add up.
#[inline(always)]
fn lanes<S: Simd, const SHORT: bool, const C: usize>(
    simd: S,
    vector: &[Group],
    planes: &[Plane; C],
) -> [[f32; GROUP]; C] {
    let planes = planes.each_ref().map(|plane| S::as_simd_f32s(plane).0);
    // Registers that make up a part.
    let each = planes[0].len() / PARTS as usize;
    let mut lanes = [[0.0f32; GROUP]; C];
    for k in 0..each {
        let mut sums = [simd.splat_f32s(0.0); C];
        for half in 0..(PARTS / HALF) as usize {
            for (part, x) in half_of::<S, SHORT>(simd, vector, half, k).into_iter().enumerate() {
                let at = (half * HALF as usize + part) * each + k;
                for (sum, plane) in sums.iter_mut().zip(planes) {
                    *sum = add_product(simd, *sum, plane[at], x);
                }
            }
        }
        for (lanes, sum) in lanes.iter_mut().zip(sums) {
            S::as_mut_simd_f32s(lanes).0[k] = sum;
        }
    }
    lanes
}

/// Adds vectors that are alike to a block's rows, times their sums.
struct Expand<'a> {
    groups: &'a [Group],
    /// Their first groups, and what each is multiplied by.
    uses: &'a [(u32, Vec4)],
    is_short: bool,
    channel: u32,
    planes: &'a mut [Plane; 3],
}

impl WithSimd for Expand<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (short, channel) = (self.is_short, self.channel as usize);
        match (short, self.channel) {
            (true, ALL_CHANNELS) => self.add::<S, true, 1, 3>(simd, [0, 1, 2]),
            (true, _) => self.add::<S, true, 1, 1>(simd, [channel]),
            (false, ALL_CHANNELS) => self.add::<S, false, 2, 3>(simd, [0, 1, 2]),
            (false, _) => self.add::<S, false, 2, 1>(simd, [channel]),
        }
    }
}

impl Expand<'_> {
    #[inline(always)]
    fn add<S: Simd, const SHORT: bool, const GROUPS: usize, const C: usize>(self, simd: S, channels: [usize; C]) {
        let [red, green, blue] = self.planes;
        let planes = [S::as_mut_simd_f32s(red).0, S::as_mut_simd_f32s(green).0, S::as_mut_simd_f32s(blue).0];
        let each = planes[0].len() / PARTS as usize;
        for uses in self.uses.chunks(TURN) {
            for (half, k) in (0..(PARTS / HALF) as usize).flat_map(|half| (0..each).map(move |k| (half, k))) {
                let at = |part: usize| (half * HALF as usize + part) * each + k;
                let mut sums = [[simd.splat_f32s(0.0); C]; HALF as usize];
                for (part, sums) in sums.iter_mut().enumerate() {
                    let scale = simd.splat_f32s((1u32 << shift(SHORT, part)) as f32);
                    sums.iter_mut().zip(channels).for_each(|(s, c)| *s = simd.mul_f32s(planes[c][at(part)], scale));
                }
                for (group, z) in uses {
                    let vector = &self.groups[*group as usize..*group as usize + GROUPS];
                    let x = half_of::<S, SHORT>(simd, vector, half, k);
                    let z = channels.map(|c| simd.splat_f32s(z[c]));
                    for (sums, x) in sums.iter_mut().zip(x) {
                        sums.iter_mut().zip(z).for_each(|(sum, z)| *sum = add_product(simd, *sum, x, z));
                    }
                }
                for (part, sums) in sums.iter().enumerate() {
                    let scale = simd.splat_f32s(unshift(SHORT, part));
                    sums.iter().zip(channels).for_each(|(s, c)| planes[c][at(part)] = simd.mul_f32s(*s, scale));
                }
            }
        }
    }
}

/// Adds the single entries of the rows from a place on.
struct Entries<'a> {
    tables: &'a ExpandTables<'a>,
    first: usize,
    ordered: &'a [Vec4; PLACES],
    rows: &'a mut [Vec4],
}

impl WithSimd for Entries<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { tables, first, ordered, rows } = self;
        for (p, row) in (first..).zip(rows) {
            let own = &tables.entries[tables.row_start[p] as usize..tables.row_start[p + 1] as usize];
            let mut sums = [Vec4::ZERO; 4];
            // Eight values are made at a time.
            let (eights, rest) = own.as_chunks::<8>();
            for eight in eights {
                let values = eight.map(|entry| ((entry as i32) >> 16) as f32);
                for (k, (entry, value)) in eight.iter().zip(values).enumerate() {
                    sums[k % 4] += ordered[usize::from(*entry as u16)] * value;
                }
            }
            for (k, entry) in rest.iter().enumerate() {
                sums[k % 4] += ordered[usize::from(*entry as u16)] * ((*entry as i32) >> 16) as f32;
            }
            let [a, b, c, d] = sums;
            *row += (((a + b) + (c + d)) * tables.steps[p]).truncate().extend(0.0);
        }
    }
}
