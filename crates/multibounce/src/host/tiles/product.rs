//! The product with tiles on all cores.

use std::vec::Vec;

use glam::{Vec3, Vec4};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::Tiles;
use crate::error::{Error, check_length};
use crate::kernel::tiles::{ALL_CHANNELS, BIAS, LANES, SLOT_WORDS, TILE, enter, leave};
use crate::types::TileSlot;

const SIDE: usize = TILE as usize;
const WORDS: usize = SLOT_WORDS as usize;
/// Slots that one task takes.
const TASK_SLOTS: usize = 1024;

/// Elements of a vector.
type Vector = [u32; WORDS];
/// A colour channel of a block.
type Plane = [f32; SIDE];

impl Tiles {
    /// Irradiance `H = T B`, W/m²; the same bits for any number of threads. The fourth component is 0.
    ///
    /// # Errors
    /// [`Error::Length`] unless both have one element a patch.
    pub fn product(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        check_length("exitance", self.patches(), exitance.len())?;
        check_length("irradiance", self.patches(), irradiance.len())?;
        let mut ordered = vec![Vec4::ZERO; self.blocks() * SIDE];
        enter_all(&self.order, &self.root, exitance, &mut ordered);
        let mut sums = vec![Vec4::ZERO; self.slots.len()];
        project_all(&self.slots, &self.words, &ordered, &mut sums);
        let mut out = vec![Vec4::ZERO; ordered.len()];
        expand_all(&self.expand_tables(), &sums, &ordered, &mut out);
        leave_all(&self.place, &self.root, &out, irradiance);
        Ok(())
    }

    /// The tables of [`expand_all`].
    pub fn expand_tables(&self) -> ExpandTables<'_> {
        let Self { use_start, uses, words, row_start, entries, steps, .. } = self;
        ExpandTables { use_start, uses, words, row_start, entries, steps }
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

/// [`crate::kernel::tiles::project`] for every slot, bit for bit.
pub fn project_all(slots: &[TileSlot], words: &[u32], ordered: &[Vec4], sums: &mut [Vec4]) {
    let plane = |block: &[Vec4], c: usize| std::array::from_fn(|r| block[r][c]);
    let planes = |block: &[Vec4]| [plane(block, 0), plane(block, 1), plane(block, 2)];
    let planes: Vec<[Plane; 3]> = ordered.chunks_exact(SIDE).map(planes).collect();
    let (vectors, _) = words.as_chunks::<WORDS>();
    let arch = Arch::new();
    let tasks = sums.par_chunks_mut(TASK_SLOTS).zip(slots.par_chunks(TASK_SLOTS)).zip(vectors.par_chunks(TASK_SLOTS));
    tasks.for_each(|((sums, slots), vectors)| arch.dispatch(Project { slots, vectors, planes: &planes, sums }));
}

/// What [`expand_all`] reads beside the sums and the ordered exitance.
#[derive(Clone, Copy, Debug)]
pub struct ExpandTables<'a> {
    /// Slots of block b: `uses[use_start[b]..use_start[b + 1]]`.
    pub use_start: &'a [u32],
    /// Slots, block by block.
    pub uses: &'a [u32],
    /// `[slots · SLOT_WORDS]`.
    pub words: &'a [u32],
    /// Entries of each place.
    pub row_start: &'a [u32],
    /// Column in the lower 16 bits, value in the upper.
    pub entries: &'a [u32],
    /// Step of the values of each place.
    pub steps: &'a [f32],
}

/// [`crate::kernel::tiles::expand`] for every place, bit for bit.
pub fn expand_all(tables: &ExpandTables, sums: &[Vec4], ordered: &[Vec4], out: &mut [Vec4]) {
    let (vectors, _) = tables.words.as_chunks::<WORDS>();
    let arch = Arch::new();
    out.par_chunks_mut(SIDE).enumerate().for_each(|(block, out)| {
        let mut planes = [[0.0f32; SIDE]; 3];
        let uses = &tables.uses[tables.use_start[block] as usize..tables.use_start[block + 1] as usize];
        let factors: Vec<Vec4> = uses.iter().map(|&slot| sums[slot as usize ^ 1]).collect();
        arch.dispatch(Expand { vectors, uses, factors: &factors, planes: &mut planes });
        for (r, out) in out.iter_mut().enumerate() {
            *out = Vec4::new(planes[0][r], planes[1][r], planes[2][r], 0.0);
        }
        arch.dispatch(Entries { tables, first: block * SIDE, ordered, out });
    });
}

/// Elements of one byte of words, with their bias taken off: bits of a float of 2²³ and more are integers.
#[inline(always)]
fn elements<S: Simd>(simd: S, words: S::u32s, byte: u32) -> S::f32s {
    let moved = simd.wrapping_dyn_shr_u32s(words, simd.splat_u32s(8 * byte));
    let bits = simd.or_u32s(simd.and_u32s(moved, simd.splat_u32s(0xff)), simd.splat_u32s(0x4b00_0000));
    simd.sub_f32s(simd.transmute_f32s_u32s(bits), simd.splat_f32s(8_388_608.0 + BIAS))
}

/// Rounded after the product, as the kernels do.
#[inline(always)]
fn add_product<S: Simd>(simd: S, sum: S::f32s, a: S::f32s, b: S::f32s) -> S::f32s {
    simd.add_f32s(sum, simd.mul_f32s(a, b))
}

/// The lanes of a sum, as [`crate::kernel::tiles::project`] adds them up.
#[inline(always)]
fn add_lanes(lanes: &[f32; LANES as usize]) -> f32 {
    let (quads, _) = lanes.as_chunks::<4>();
    let sum = quads.iter().fold(Vec4::ZERO, |sum, quad| sum + Vec4::from_array(*quad));
    (sum.x + sum.z) + (sum.y + sum.w)
}

/// Sums of some slots.
struct Project<'a> {
    slots: &'a [TileSlot],
    vectors: &'a [Vector],
    planes: &'a [[Plane; 3]],
    sums: &'a mut [Vec4],
}

impl WithSimd for Project<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for ((sum, slot), vector) in self.sums.iter_mut().zip(self.slots).zip(self.vectors) {
            let planes = &self.planes[slot.block as usize];
            let (words, _) = S::as_simd_u32s(vector);
            let each = words.len();
            // Vectors of words that make up the lanes.
            let groups = (LANES as usize * each / WORDS).max(1);
            if slot.channel == ALL_CHANNELS {
                let [(r, _), (g, _), (b, _)] = [0, 1, 2].map(|c: usize| S::as_simd_f32s(&planes[c]));
                let (r, g, b) = (&r[..4 * each], &g[..4 * each], &b[..4 * each]);
                let mut lanes = [[0.0f32; LANES as usize]; 3];
                let [x, y, z] = &mut lanes;
                let [(x, _), (y, _), (z, _)] = [x, y, z].map(|lanes| S::as_mut_simd_f32s(lanes));
                let (x, y, z) = (&mut x[..groups], &mut y[..groups], &mut z[..groups]);
                for group in 0..groups {
                    let mut out = [simd.splat_f32s(0.0); 3];
                    for k in (group..each).step_by(groups) {
                        for byte in 0..4 {
                            let (value, at) = (elements(simd, words[k], byte), byte as usize * each + k);
                            out[0] = add_product(simd, out[0], r[at], value);
                            out[1] = add_product(simd, out[1], g[at], value);
                            out[2] = add_product(simd, out[2], b[at], value);
                        }
                    }
                    [x[group], y[group], z[group]] = out;
                }
                let [x, y, z] = lanes.map(|lanes| add_lanes(&lanes));
                *sum = (Vec3::new(x, y, z) * slot.scale).extend(0.0);
            } else {
                let channel = slot.channel as usize % 3;
                let (plane, _) = S::as_simd_f32s(&planes[channel]);
                let plane = &plane[..4 * each];
                let mut lanes = [0.0f32; LANES as usize];
                let (own, _) = S::as_mut_simd_f32s(&mut lanes);
                let own = &mut own[..groups];
                for (group, own) in own.iter_mut().enumerate() {
                    let mut out = simd.splat_f32s(0.0);
                    for k in (group..each).step_by(groups) {
                        for byte in 0..4 {
                            let value = elements(simd, words[k], byte);
                            out = add_product(simd, out, plane[byte as usize * each + k], value);
                        }
                    }
                    *own = out;
                }
                let mut one = Vec3::ZERO;
                one[channel] = add_lanes(&lanes);
                *sum = (one * slot.scale).extend(0.0);
            }
        }
    }
}

/// Sums of the components of a block's rows.
struct Expand<'a> {
    vectors: &'a [Vector],
    uses: &'a [u32],
    /// What each use is multiplied by.
    factors: &'a [Vec4],
    planes: &'a mut [Plane; 3],
}

impl WithSimd for Expand<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let [red, green, blue] = self.planes;
        let [(r, _), (g, _), (b, _)] = [red, green, blue].map(|plane| S::as_mut_simd_f32s(plane));
        let each = r.len() / 4;
        // One vector of words of all uses at a time, so that the sums stay in registers.
        for k in 0..each {
            let zero = simd.splat_f32s(0.0);
            let mut sums = [[zero; 3], [zero; 3], [zero; 3], [zero; 3]];
            for (&slot, z) in self.uses.iter().zip(self.factors) {
                let (words, _) = S::as_simd_u32s(&self.vectors[slot as usize]);
                let (words, z) = (words[k], [z.x, z.y, z.z].map(|z| simd.splat_f32s(z)));
                for (byte, sums) in sums.iter_mut().enumerate() {
                    let x = elements(simd, words, byte as u32);
                    for (sum, z) in sums.iter_mut().zip(z) {
                        *sum = add_product(simd, *sum, x, z);
                    }
                }
            }
            for (byte, [x, y, z]) in sums.into_iter().enumerate() {
                (r[byte * each + k], g[byte * each + k], b[byte * each + k]) = (x, y, z);
            }
        }
    }
}

/// Entries that are widened together.
const TOGETHER: usize = 32;

/// Adds the single entries of the rows from a place on.
struct Entries<'a> {
    tables: &'a ExpandTables<'a>,
    first: usize,
    ordered: &'a [Vec4],
    out: &'a mut [Vec4],
}

impl WithSimd for Entries<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { tables, first, ordered, out } = self;
        for (r, out) in out.iter_mut().enumerate() {
            let p = first + r;
            let own = &tables.entries[tables.row_start[p] as usize..tables.row_start[p + 1] as usize];
            let mut sums = [Vec4::ZERO; 4];
            for some in own.chunks(TOGETHER) {
                let mut values = [0.0f32; TOGETHER];
                values.iter_mut().zip(some).for_each(|(v, entry)| *v = ((*entry as i32) >> 16) as f32);
                for (four, values) in some.chunks(4).zip(values.chunks_exact(4)) {
                    for (k, &entry) in four.iter().enumerate() {
                        sums[k] += ordered[(entry & 0xffff) as usize] * values[k];
                    }
                }
            }
            *out += (((sums[0] + sums[1]) + (sums[2] + sums[3])) * tables.steps[p]).truncate().extend(0.0);
        }
    }
}
