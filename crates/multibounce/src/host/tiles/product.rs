//! The product with tiles on all cores.

use std::vec::Vec;

use glam::{Vec3, Vec4};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::Tiles;
use crate::error::{Error, check_length};
use crate::kernel::tiles::{ALL_CHANNELS, BIAS, LANES, PARTS, SHORT_BIAS, TILE, element, enter, leave, masked};
use crate::types::{TileComponent, TileVector};

const SIDE: usize = TILE as usize;
const GROUP: usize = LANES as usize;
/// Components that one task takes.
const TASK_COMPONENTS: usize = 512;
/// Parts of a block whose sums stay in registers together.
const HALF: u32 = PARTS / 2;

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
        ordered.resize(self.blocks() * SIDE, Vec4::ZERO);
        sums.resize(2 * self.components.len(), Vec4::ZERO);
        rows.resize(ordered.len(), Vec4::ZERO);
        enter_all(&self.order, &self.root, exitance, ordered);
        project_all(&self.components, &self.words, ordered, sums);
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
        for &slot in &self.uses[self.use_start[block] as usize..self.use_start[block + 1] as usize] {
            let component = self.components[slot as usize / 2];
            let (own, other) = (component.vector(slot % 2), component.vector(1 - slot % 2));
            let factor = masked(Vec3::splat(component.scale * element(&self.words, own, r)), own.channel);
            let first = other.block as usize * SIDE;
            for (c, sum) in places[first..first + SIDE].iter_mut().enumerate() {
                *sum += factor * element(&self.words, other, c as u32);
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
        let Self { use_start, uses, components, words, row_start, entries, steps, .. } = self;
        ExpandTables { use_start, uses, components, words, row_start, entries, steps }
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
pub fn project_all(components: &[TileComponent], words: &[u32], ordered: &[Vec4], sums: &mut [Vec4]) {
    let plane = |block: &[Vec4], c: usize| std::array::from_fn(|r| block[r][c]);
    let planes = |block: &[Vec4]| [plane(block, 0), plane(block, 1), plane(block, 2)];
    let planes: Vec<[Plane; 3]> = ordered.chunks_exact(SIDE).map(planes).collect();
    let (groups, _) = words.as_chunks::<GROUP>();
    let arch = Arch::new();
    let tasks = sums.par_chunks_mut(2 * TASK_COMPONENTS).zip(components.par_chunks(TASK_COMPONENTS));
    tasks.for_each(|(sums, components)| arch.dispatch(Project { components, groups, planes: &planes, sums }));
}

/// What [`expand_all`] reads beside the sums and the ordered exitance.
#[derive(Clone, Copy, Debug)]
pub struct ExpandTables<'a> {
    /// Slots of block b: `uses[use_start[b]..use_start[b + 1]]`.
    pub use_start: &'a [u32],
    /// Slots, block by block.
    pub uses: &'a [u32],
    /// Pairs of vectors.
    pub components: &'a [TileComponent],
    /// Their elements, in groups of [`LANES`] words.
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
    let (groups, _) = tables.words.as_chunks::<GROUP>();
    let arch = Arch::new();
    out.par_chunks_mut(SIDE).enumerate().for_each(|(block, out)| {
        let mut planes = [[0.0f32; SIDE]; 3];
        let uses = &tables.uses[tables.use_start[block] as usize..tables.use_start[block + 1] as usize];
        let vector = |slot: u32| tables.components[slot as usize / 2].vector(slot % 2);
        let uses: Vec<(TileVector, Vec4)> = uses.iter().map(|&slot| (vector(slot), sums[slot as usize ^ 1])).collect();
        arch.dispatch(Expand { groups, uses: &uses, planes: &mut planes });
        for (r, out) in out.iter_mut().enumerate() {
            *out = Vec4::new(planes[0][r], planes[1][r], planes[2][r], 0.0);
        }
        arch.dispatch(Entries { tables, first: block * SIDE, ordered, out });
    });
}

/// Elements of a part, given its words, how far they are to be moved and the greatest element, with their bias taken off:
/// bits of a float of 2²³ and more are integers.
#[inline(always)]
fn elements<S: Simd>(simd: S, words: S::u32s, shift: u32, most: u32, bias: f32) -> S::f32s {
    let moved = simd.wrapping_dyn_shr_u32s(words, simd.splat_u32s(shift));
    let bits = simd.or_u32s(simd.and_u32s(moved, simd.splat_u32s(most)), simd.splat_u32s(0x4b00_0000));
    simd.sub_f32s(simd.transmute_f32s_u32s(bits), simd.splat_f32s(8_388_608.0 + bias))
}

/// Elements of the parts of one half of a vector, lanes of register `k` of each.
#[inline(always)]
fn half_of<S: Simd>(simd: S, vector: TileVector, groups: &[Group], half: u32, k: usize) -> [S::f32s; HALF as usize] {
    let mut out = [simd.splat_f32s(0.0); HALF as usize];
    if vector.is_short {
        let words = S::as_simd_u32s(&groups[vector.group as usize]).0[k];
        for (part, out) in out.iter_mut().enumerate() {
            *out = elements(simd, words, 4 * (half * HALF + part as u32), 0xf, SHORT_BIAS);
        }
    } else {
        let words = S::as_simd_u32s(&groups[(vector.group + half) as usize]).0[k];
        for (part, out) in out.iter_mut().enumerate() {
            *out = elements(simd, words, 8 * part as u32, 0xff, BIAS);
        }
    }
    out
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

/// Sums of the vectors of some components.
struct Project<'a> {
    components: &'a [TileComponent],
    groups: &'a [Group],
    planes: &'a [[Plane; 3]],
    sums: &'a mut [Vec4],
}

impl WithSimd for Project<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for (sums, component) in self.sums.chunks_mut(2).zip(self.components) {
            for (sum, side) in sums.iter_mut().zip(0..) {
                let vector = component.vector(side);
                let planes = &self.planes[vector.block as usize];
                if vector.channel == ALL_CHANNELS {
                    let z = project(simd, vector, self.groups, [&planes[0], &planes[1], &planes[2]]);
                    *sum = (Vec3::from_array(z) * component.scale).extend(0.0);
                } else {
                    let channel = vector.channel as usize;
                    let mut one = Vec3::ZERO;
                    [one[channel]] = project(simd, vector, self.groups, [&planes[channel]]);
                    *sum = (one * component.scale).extend(0.0);
                }
            }
        }
    }
}

/// Sums of a vector for some channels.
#[inline(always)]
fn project<S: Simd, const C: usize>(simd: S, vector: TileVector, groups: &[Group], planes: [&Plane; C]) -> [f32; C] {
    let planes = planes.map(|plane| S::as_simd_f32s(plane).0);
    // Vectors that make up a part.
    let each = planes[0].len() / PARTS as usize;
    let mut lanes = [[0.0f32; GROUP]; C];
    for k in 0..each {
        let mut sums = [simd.splat_f32s(0.0); C];
        for half in 0..PARTS / HALF {
            for (part, x) in half_of(simd, vector, groups, half, k).into_iter().enumerate() {
                let at = (half as usize * HALF as usize + part) * each + k;
                for (sum, plane) in sums.iter_mut().zip(planes) {
                    *sum = add_product(simd, *sum, plane[at], x);
                }
            }
        }
        for (lanes, sum) in lanes.iter_mut().zip(sums) {
            S::as_mut_simd_f32s(lanes).0[k] = sum;
        }
    }
    lanes.map(|lanes| add_lanes(&lanes))
}

/// Adds elements times a factor to the sums of channel `C`.
#[inline(always)]
fn add_channel<S: Simd, const C: usize>(
    simd: S,
    sums: &mut [[S::f32s; 3]; HALF as usize],
    elements: &[S::f32s; HALF as usize],
    factor: f32,
) {
    let factor = simd.splat_f32s(factor);
    for (sums, x) in sums.iter_mut().zip(elements) {
        sums[C] = add_product(simd, sums[C], *x, factor);
    }
}

/// Sums of the components of a block's rows.
struct Expand<'a> {
    groups: &'a [Group],
    /// The vectors of the block, and what each is multiplied by.
    uses: &'a [(TileVector, Vec4)],
    planes: &'a mut [Plane; 3],
}

impl WithSimd for Expand<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let [red, green, blue] = self.planes;
        let mut planes = [S::as_mut_simd_f32s(red).0, S::as_mut_simd_f32s(green).0, S::as_mut_simd_f32s(blue).0];
        let each = planes[0].len() / PARTS as usize;
        // Half of the parts of all uses at a time, so that the sums stay in registers.
        for (half, k) in (0..PARTS / HALF).flat_map(|half| (0..each).map(move |k| (half, k))) {
            let zero = simd.splat_f32s(0.0);
            let mut sums = [[zero; 3]; HALF as usize];
            for &(vector, z) in self.uses {
                let x = half_of(simd, vector, self.groups, half, k);
                // The other channels would add nothing.
                match vector.channel {
                    0 => add_channel::<S, 0>(simd, &mut sums, &x, z.x),
                    1 => add_channel::<S, 1>(simd, &mut sums, &x, z.y),
                    2 => add_channel::<S, 2>(simd, &mut sums, &x, z.z),
                    _ => {
                        add_channel::<S, 0>(simd, &mut sums, &x, z.x);
                        add_channel::<S, 1>(simd, &mut sums, &x, z.y);
                        add_channel::<S, 2>(simd, &mut sums, &x, z.z);
                    }
                }
            }
            for (part, sums) in sums.into_iter().enumerate() {
                for (plane, sum) in planes.iter_mut().zip(sums) {
                    plane[(half as usize * HALF as usize + part) * each + k] = sum;
                }
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
