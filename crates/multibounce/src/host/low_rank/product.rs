//! The product with tiles on all cores.

use alloc::vec::Vec;

use glam::{IVec4, Mat4, Vec3, Vec4};
use scene::parallel::*;
use transport::{LinearOperator, check_length};

use super::dense_sparse::{DenseSparseTables, dense_sparse_block};
use super::lanes::{Lanes, U32x16, WithLanes, dispatch};
use super::{ColumnVectors, LowRank, SIDE, check_bank, check_starts};
use crate::error::Error;
use crate::kernel::low_rank::{
    ALL_CHANNELS, BIAS, CHANNEL_WORDS, FACTOR_WORDS, GROUP_VECTORS, LANES, LIGHT_WORDS, NO_VECTOR, PAIRS, PART_PAIRS,
    PARTS, PERMUTED_INDICES, RUN_GROUPS, RUN_PAIRS, SHORT_BIAS, SPLITS, SUB_BLOCK_WORDS, TILE, chroma_weights, element,
    inverse_of, permute_in, permute_out, quantised, row_of, split_of, step_of,
};
use crate::types::PackedGroup;

/// Lanes of a part.
pub(super) const LANE_COUNT: usize = LANES as usize;
const VECTORS: usize = GROUP_VECTORS as usize;
const PAIRS_OF_PARTS: usize = PART_PAIRS as usize;
/// Packed groups that one task takes, runs, blocks, and rows.
const TASK_GROUPS: usize = 256;
const TASK_RUNS: usize = 64;
const TASK_BLOCKS: usize = 8;
const TASK_ROWS: usize = TASK_BLOCKS * SIDE;

/// Rows of a colour channel of a block, part by part.
type Plane = [[f32; LANE_COUNT]; PARTS as usize];

/// Workspace of products, kept from one to the next.
#[derive(Clone, Debug, Default)]
pub struct LowRankWorkspace {
    ordered: Vec<Vec4>,
    light: Vec<u32>,
    sums: Vec<Vec4>,
    permuted_rows: Vec<Vec4>,
}

/// Irradiance `H = T B`, W/m². The fourth component is 0.
impl LinearOperator for LowRank {
    fn shape(&self) -> (usize, usize) {
        (self.permuted_index.len(), self.order.len())
    }

    fn bytes(&self) -> u64 {
        self.bytes_by_part().iter().map(|part| part.1).sum()
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), transport::Error> {
        self.apply_in(&mut LowRankWorkspace::default(), exitance, irradiance)
    }
}

impl LowRank {
    /// As [`LinearOperator::apply`], in memory that is kept from product to product.
    ///
    /// # Errors
    /// [`transport::Error::Length`] unless there is one exitance a column and one irradiance a row.
    pub fn apply_in(
        &self,
        workspace: &mut LowRankWorkspace,
        exitance: &[Vec4],
        irradiance: &mut [Vec4],
    ) -> Result<(), transport::Error> {
        self.check_vectors(exitance, irradiance)?;
        let LowRankWorkspace { ordered, light, sums, permuted_rows } = workspace;
        let columns = self.column_blocks() * SIDE;
        ordered.resize(PERMUTED_INDICES, Vec4::ZERO);
        light.resize(self.column_blocks() * LIGHT_WORDS as usize, 0);
        sums.resize(self.scale.len(), Vec4::ZERO);
        self.prepare(exitance, &mut ordered[..columns], light);
        multiply_vt_all(&self.vt_tables(), light, sums);
        let found = ordered.len();
        let ordered = ordered.first_chunk().ok_or(transport::Error::Length {
            name: "ordered",
            expected: PERMUTED_INDICES,
            found,
        })?;
        // Rows that stand in their order are written where they belong at once.
        let is_ordered = self.permuted_index.iter().zip(0..).all(|(&permuted_index, i)| permuted_index == i);
        if is_ordered {
            self.rows(light, ordered, sums, irradiance, |p| self.row_sqrt_area[p]);
        } else {
            permuted_rows.resize(self.permuted_index.len(), Vec4::ZERO);
            self.rows(light, ordered, sums, permuted_rows, |_| 1.0);
            permute_out_rows(&self.permuted_index, &self.row_sqrt_area, permuted_rows, irradiance);
        }
        Ok(())
    }

    /// Rows in their permutation, over `sqrt_area`, block by block: what a block adds up stays in the first cache.
    fn rows(
        &self,
        light: &[u32],
        ordered: &[Vec4; PERMUTED_INDICES],
        sums: &[Vec4],
        out: &mut [Vec4],
        sqrt_area: impl Fn(usize) -> f32 + Sync,
    ) {
        let multiply_u = self.u_tables();
        let dense_sparse = self.dense_sparse_tables();
        let factors = Sums { runs: &self.runs, paired: &self.paired, sums };
        out.par_chunks_mut(SIDE).enumerate().for_each_init(
            || [Vec4::ZERO; SIDE],
            |rows, (b, out)| {
                dense_sparse_block(&dense_sparse, light, ordered, b, rows);
                add_rows(&multiply_u, factors, b, rows);
                out.iter_mut().zip(rows).zip(b * SIDE..).for_each(|((out, row), p)| *out = *row / sqrt_area(p));
            },
        );
    }

    /// [`permute_in_all`] and [`quantise_all`], block by block.
    fn prepare(&self, exitance: &[Vec4], ordered: &mut [Vec4], light: &mut [u32]) {
        let columns = self.order.len() as u32;
        let sqrt_area = self.column_sqrt_area();
        let (blocks, _) = ordered.as_chunks_mut::<SIDE>();
        let tasks = blocks.par_iter_mut().zip(light.par_chunks_mut(LIGHT_WORDS as usize)).enumerate();
        tasks.with_min_len(TASK_BLOCKS).for_each(|(b, (block, light))| {
            for (p, x) in (b * SIDE..).zip(block.iter_mut()) {
                *x = permute_in(p as u32, columns, &self.order, sqrt_area, exitance);
            }
            dispatch(Quantise { block, light });
        });
    }

    /// Row `i` of `a_r^-½ T̂ a_c^½`, one colour a column, as products multiply by it.
    ///
    /// # Errors
    /// [`transport::Error::Length`] unless there is one element a column, [`transport::Error::Value`] for a row that
    /// there is not.
    pub fn row(&self, i: usize, row: &mut [Vec3]) -> Result<(), Error> {
        check_length("row", self.order.len(), row.len())?;
        let Some(&permuted_index) = self.permuted_index.get(i) else {
            return Err(
                transport::Error::Value { name: "row", index: i, value: i as f64, rule: "one of the rows" }.into()
            );
        };
        let sums = self.vt_tables();
        let p = permuted_index as usize;
        let r = permuted_index % TILE;
        let block = permuted_index as usize / SIDE;
        let mut permuted_row = vec![Vec3::ZERO; self.column_blocks() * SIDE];
        let group_start = |block: usize| self.runs[self.run_start[block] as usize];
        for index in GROUP_VECTORS * group_start(block)..GROUP_VECTORS * group_start(block + 1) {
            let paired = self.paired[index as usize];
            if paired == NO_VECTOR {
                continue;
            }
            let own = self.groups[(index / GROUP_VECTORS) as usize].vector(index % GROUP_VECTORS);
            let group = sums.groups[(paired / GROUP_VECTORS) as usize];
            let factor = self.scale[paired as usize] * element(&self.words, own, r) as f32;
            let factor = factor * chroma_weights(group.color(), self.chroma_axes);
            let first = group.block() as usize * SIDE;
            for (c, sum) in permuted_row[first..first + SIDE].iter_mut().enumerate() {
                *sum += factor * element(sums.words, group.vector(paired % GROUP_VECTORS), c as u32) as f32;
            }
        }
        let part = p / LANE_COUNT;
        for k in self.sub_block_start[part] as usize..self.sub_block_start[part + 1] as usize {
            let sub_block = self.sub_blocks[k];
            let first = LANE_COUNT * sub_block.column as usize;
            for (columns, four) in permuted_row[first..first + LANE_COUNT].chunks_exact_mut(4).enumerate() {
                let word = self.sub_block_words[k * SUB_BLOCK_WORDS as usize + columns * LANE_COUNT + p % LANE_COUNT];
                four.iter_mut().zip(row_of(word)).for_each(|(sum, x)| *sum += Vec3::splat(x as f32 * sub_block.step));
            }
        }
        for &entry in &self.entries[self.row_start[p] as usize..self.row_start[p + 1] as usize] {
            permuted_row[(entry & 0xffff) as usize] += Vec3::splat(((entry as i32) >> 16) as f32 * self.steps[p]);
        }
        let sqrt_area = self.column_sqrt_area();
        for (&j, value) in self.order.iter().zip(&permuted_row) {
            row[j as usize] = *value * (sqrt_area[j as usize] / self.row_sqrt_area[i]);
        }
        Ok(())
    }

    /// The tables of [`multiply_vt_all`].
    pub fn vt_tables(&self) -> VtTables<'_> {
        let Self { chroma_axes, scale, .. } = self;
        match &self.columns {
            Some(ColumnVectors { groups, words, .. }) => VtTables { chroma_axes: *chroma_axes, groups, words, scale },
            None => VtTables { chroma_axes: *chroma_axes, groups: &self.groups, words: &self.words, scale },
        }
    }

    /// The tables of [`multiply_u_all`].
    pub fn u_tables(&self) -> UTables<'_> {
        let Self { run_start, runs, groups, words, .. } = self;
        UTables { run_start, runs, groups, words }
    }

    /// The tables of [`crate::dense_sparse_all`].
    pub fn dense_sparse_tables(&self) -> DenseSparseTables<'_> {
        let Self { sub_block_start, sub_blocks, sub_block_words, row_start, entries, steps, .. } = self;
        DenseSparseTables { sub_block_start, sub_blocks, sub_block_words, row_start, entries, steps }
    }
}

/// [`permute_in`] for every permuted index.
pub fn permute_in_all(order: &[u32], sqrt_area: &[f32], exitance: &[Vec4], ordered: &mut [Vec4]) {
    let patches = order.len() as u32;
    let tasks = ordered.par_iter_mut().enumerate().with_min_len(TASK_ROWS);
    tasks.for_each(|(p, x)| *x = permute_in(p as u32, patches, order, sqrt_area, exitance));
}

/// [`permute_out`] for every patch.
pub fn permute_out_all(
    permuted_index: &[u32],
    sqrt_area: &[f32],
    rows: &[Vec4],
    dense_sparse: &[Vec4],
    irradiance: &mut [Vec4],
) {
    let tasks = irradiance.par_iter_mut().enumerate().with_min_len(TASK_ROWS);
    tasks.for_each(|(i, h)| *h = permute_out(i as u32, permuted_index, sqrt_area, rows, dense_sparse));
}

/// [`permute_out`] from rows that are added up, for every patch.
pub(super) fn permute_out_rows(permuted_index: &[u32], sqrt_area: &[f32], rows: &[Vec4], irradiance: &mut [Vec4]) {
    let tasks = irradiance.par_iter_mut().zip(permuted_index).zip(sqrt_area).with_min_len(TASK_ROWS);
    tasks.for_each(|((h, &permuted_index), sqrt_area)| *h = rows[permuted_index as usize] / *sqrt_area);
}

/// [`crate::kernel::low_rank::quantise`] for every lane, bit for bit.
pub fn quantise_all(ordered: &[Vec4], light: &mut [u32]) {
    let (blocks, _) = ordered.as_chunks::<SIDE>();
    let tasks = blocks.par_iter().zip(light.par_chunks_mut(LIGHT_WORDS as usize)).with_min_len(TASK_BLOCKS);
    tasks.for_each(|(block, light)| dispatch(Quantise { block, light }));
}

/// Quantises a block.
struct Quantise<'a> {
    block: &'a [Vec4; SIDE],
    light: &'a mut [u32],
}

impl WithLanes for Quantise<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self, _: L) {
        let mut planes = [[0.0; SIDE]; 3];
        let mut most = Vec4::ZERO;
        for (r, x) in self.block.iter().enumerate() {
            most = most.max(x.abs());
            (planes[0][r], planes[1][r], planes[2][r]) = (x.x, x.y, x.z);
        }
        let (channels, rest) = self.light.split_at_mut(3 * CHANNEL_WORDS as usize);
        let (steps, pairs) = rest.split_at_mut(LANE_COUNT);
        steps.fill(0);
        for (c, (words, plane)) in channels.chunks_exact_mut(CHANNEL_WORDS as usize).zip(&planes).enumerate() {
            let step = step_of(most[c]);
            steps[c] = step.to_bits();
            let inverse = inverse_of(step);
            let mut numbers = [0; SIDE];
            numbers.iter_mut().zip(plane).for_each(|(number, x)| *number = quantised(*x, inverse));
            let (first, second) = numbers.split_at(SIDE / 2);
            for (word, (a, b)) in words.iter_mut().zip(first.iter().zip(second)) {
                *word = a & 0xffff | b << 16;
            }
            for (part, own) in pairs.chunks_exact_mut(3 * PAIRS as usize).zip(numbers.chunks_exact(LANE_COUNT)) {
                let part = &mut part[c * PAIRS as usize..(c + 1) * PAIRS as usize];
                part.iter_mut().zip(own.as_chunks::<2>().0).for_each(|(word, [a, b])| *word = a & 0xffff | b << 16);
            }
        }
    }
}

/// Inputs of [`multiply_vt_all`] beside the light.
#[derive(Clone, Copy, Debug)]
pub struct VtTables<'a> {
    /// Red and blue of the chroma axes, [`chroma_weights`].
    pub chroma_axes: Vec4,
    /// Packed groups of vectors, block by block, those with equal channels and bits together.
    pub groups: &'a [PackedGroup],
    /// Their elements, in `u32x16`s of [`LANES`] words.
    pub words: &'a [u32],
    /// Factor on the sum of each vector.
    pub scale: &'a [f32],
}

/// [`crate::kernel::low_rank::multiply_vt`] for every packed group, bit for bit.
pub fn multiply_vt_all(tables: &VtTables, light: &[u32], sums: &mut [Vec4]) {
    let VtTables { chroma_axes, groups, words, scale } = *tables;
    let (words, _) = words.as_chunks::<LANE_COUNT>();
    let ((light, _), (scale, _)) = (light.as_chunks::<LANE_COUNT>(), scale.as_chunks::<VECTORS>());
    let (sums, _) = sums.as_chunks_mut::<VECTORS>();
    let tasks = groups.par_chunks(TASK_GROUPS).zip(scale.par_chunks(TASK_GROUPS)).zip(sums.par_chunks_mut(TASK_GROUPS));
    tasks.for_each(|((groups, scale), sums)| {
        let mut done = 0;
        for alike in groups.chunk_by(|a, b| a.tag == b.tag) {
            let first = done;
            let end = done + alike.len();
            done = end;
            let block = (LIGHT_WORDS / LANES) as usize * alike[0].block() as usize;
            let light = &light[block..block + (LIGHT_WORDS / LANES) as usize];
            let steps = Vec3::from_array(steps_of(&light[(3 * CHANNEL_WORDS / LANES) as usize]));
            let steps = (steps * chroma_weights(alike[0].color(), chroma_axes)).to_array();
            // Nothing comes of darkness.
            if steps == [0.0; 3] {
                sums[first..end].fill([Vec4::ZERO; VECTORS]);
                continue;
            }
            let scale = &scale[first..end];
            let sums = &mut sums[first..end];
            dispatch(MultiplyVt { groups: alike, words, light, steps, scale, sums });
        }
    });
}

/// Steps of the channels, from their bits.
pub(super) fn steps_of(words: &[u32]) -> [f32; 3] {
    core::array::from_fn(|c| f32::from_bits(words[c]))
}

/// [`crate::kernel::low_rank::requantise`] for every run, bit for bit.
pub fn requantise_all(runs: &[u32], paired: &[u32], sums: &[Vec4], factors: &mut [u32]) {
    let (factors, _) = factors.as_chunks_mut::<{ FACTOR_WORDS as usize }>();
    let tasks = factors.par_iter_mut().enumerate().with_min_len(TASK_RUNS);
    tasks.for_each(|(run, factors)| *factors = Sums { runs, paired, sums }.of(run));
}

/// Factors on vectors.
pub(super) trait Factors: Copy + Sync {
    /// The words of a run.
    fn of(self, run: usize) -> RunFactors;
}

/// Words of [`crate::kernel::low_rank::requantise`] for one run.
pub(super) type RunFactors = [u32; FACTOR_WORDS as usize];

impl Factors for &[RunFactors] {
    #[inline(always)]
    fn of(self, run: usize) -> RunFactors {
        self[run]
    }
}

/// Sums that become factors when they are needed.
#[derive(Clone, Copy)]
pub(super) struct Sums<'a> {
    pub runs: &'a [u32],
    pub paired: &'a [u32],
    pub sums: &'a [Vec4],
}

impl Factors for Sums<'_> {
    #[inline(always)]
    fn of(self, run: usize) -> RunFactors {
        let paired = &self.paired[VECTORS * self.runs[run] as usize..VECTORS * self.runs[run + 1] as usize];
        let mut own = [Vec4::ZERO; (RUN_GROUPS * GROUP_VECTORS) as usize];
        let mut most = Vec4::ZERO;
        for (z, &other) in own.iter_mut().zip(paired) {
            if other != NO_VECTOR {
                *z = self.sums[other as usize];
                most = most.max(z.abs());
            }
        }
        let steps = most.to_array().map(step_of);
        let inverse = steps.map(inverse_of);
        let mut factors = [0; FACTOR_WORDS as usize];
        let (pairs, last) = factors.split_at_mut(4 * RUN_PAIRS as usize);
        for (words, two) in pairs.chunks_exact_mut(4).zip(own[..paired.len()].chunks_exact(2)) {
            let a = two[0].to_array();
            let b = two[1].to_array();
            for (c, word) in words[..3].iter_mut().enumerate() {
                *word = quantised(a[c], inverse[c]) & 0xffff | quantised(b[c], inverse[c]) << 16;
            }
        }
        last.copy_from_slice(&[steps[0].to_bits(), steps[1].to_bits(), steps[2].to_bits(), 0]);
        factors
    }
}

/// Inputs of [`multiply_u_all`] beside the factors.
#[derive(Clone, Copy, Debug)]
pub struct UTables<'a> {
    /// Runs of block b: `run_start[b]..run_start[b + 1]`.
    pub run_start: &'a [u32],
    /// Packed groups of run k: `groups[runs[k]..runs[k + 1]]`.
    pub runs: &'a [u32],
    /// Packed groups of vectors, block by block; those of a run have equal channels and bits, and their words follow
    /// one another.
    pub groups: &'a [PackedGroup],
    /// Their elements, in `u32x16`s of [`LANES`] words.
    pub words: &'a [u32],
}

impl UTables<'_> {
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.run_start) + size_of_val(self.runs) + size_of_val(self.groups) + size_of_val(self.words)
    }

    /// Checks that the tables of so many blocks belong together.
    pub(super) fn check(&self, blocks: usize) -> Result<(), Error> {
        check_bank(self.runs, self.groups, self.words, blocks)?;
        check_length("run_start", blocks + 1, self.run_start.len())?;
        check_starts("run_start", self.run_start, self.runs.len().saturating_sub(1))
    }
}

/// [`crate::kernel::low_rank::multiply_u`] for every lane, bit for bit.
pub fn multiply_u_all(tables: &UTables, factors: &[u32], rows: &mut [Vec4]) {
    let (factors, (splits, _)) = (factors.as_chunks().0, rows.as_chunks_mut::<SIDE>());
    splits.par_iter_mut().enumerate().for_each(|(k, rows)| {
        let block = k / SPLITS as usize;
        let split = k % SPLITS as usize;
        let mut planes = NO_PLANES;
        add_split(tables, factors, block, split, &mut planes);
        rows.iter_mut().enumerate().for_each(|(r, row)| *row = row_of_planes(&planes, r));
    });
}

/// Rows of a colour channel each.
type Planes = [Plane; 3];
const NO_PLANES: Planes = [[[0.0; LANE_COUNT]; PARTS as usize]; 3];

/// Adds what the vectors of a split of a block make.
fn add_split(tables: &UTables, factors: impl Factors, block: usize, split: usize, planes: &mut Planes) {
    let (first, end) = split_of(split as u32, tables.run_start[block], tables.run_start[block + 1]);
    dispatch(MultiplyU { tables, factors, runs: first as usize..end as usize, planes });
}

fn row_of_planes(planes: &Planes, r: usize) -> Vec4 {
    let [red, green, blue] = planes.each_ref().map(|plane| plane.as_flattened());
    Vec4::new(red[r], green[r], blue[r], 0.0)
}

/// Adds what the vectors of a block make to its rows, as [`permute_out`] does.
pub(super) fn add_rows(tables: &UTables, factors: impl Factors, block: usize, rows: &mut [Vec4; SIDE]) {
    let mut splits = [NO_PLANES; SPLITS as usize];
    splits.iter_mut().enumerate().for_each(|(k, planes)| add_split(tables, factors, block, k, planes));
    let [sums, one, two, three] = &mut splits;
    let [one, two, three] = [one, two, three].map(|planes| planes.as_flattened().as_flattened());
    let sums = sums.as_flattened_mut().as_flattened_mut();
    for (((sum, one), two), three) in sums.iter_mut().zip(one).zip(two).zip(three) {
        *sum = (*sum + one) + (two + three);
    }
    rows.iter_mut().enumerate().for_each(|(r, row)| *row += row_of_planes(&splits[0], r));
}

/// Calls a function for elements of 4 or 8 bits, of all channels or of red and blue.
macro_rules! for_kind {
    ($group:expr, $lanes:ty, $own:ident.$function:ident($($argument:expr),*)) => {
        match ($group.is_short(), $group.color()) {
            (true, ALL_CHANNELS) => $own.$function::<$lanes, true, 1, 3>($($argument,)* [0, 1, 2]),
            (true, _) => $own.$function::<$lanes, true, 1, 2>($($argument,)* [0, 2]),
            (false, ALL_CHANNELS) => $own.$function::<$lanes, false, 2, 3>($($argument,)* [0, 1, 2]),
            (false, _) => $own.$function::<$lanes, false, 2, 2>($($argument,)* [0, 2]),
        }
    };
}

#[inline(always)]
const fn bias(is_short: bool) -> i32 {
    if is_short { SHORT_BIAS } else { BIAS }
}

/// Elements of a vector with their bias, in pairs of parts.
#[inline(always)]
fn part_pairs<L: Lanes, const SHORT: bool>(l: L, vector: &[U32x16], k: usize) -> [L::Word; PAIRS_OF_PARTS] {
    let word = l.load(&vector[0], k);
    if SHORT {
        return l.nibbles(word);
    }
    let ([a, b], [c, d]) = (l.bytes(word), l.bytes(l.load(&vector[1], k)));
    [a, b, c, d]
}

/// Elements of a pair of vectors with their bias: the parts of the first or of the second half.
#[inline(always)]
fn vector_pairs<L: Lanes, const SHORT: bool, const VECTOR_LEN: usize>(
    l: L,
    two: &[U32x16],
    half: usize,
    k: usize,
) -> [L::Word; PAIRS_OF_PARTS] {
    let word = merged(l, &two[0], &two[VECTOR_LEN], half, k);
    if SHORT {
        return l.nibbles(word);
    }
    let ([a, b], [c, d]) = (l.bytes(word), l.bytes(merged(l, &two[1], &two[VECTOR_LEN + 1], half, k)));
    [a, b, c, d]
}

#[inline(always)]
fn merged<L: Lanes>(l: L, a: &U32x16, b: &U32x16, half: usize, k: usize) -> L::Word {
    let a = l.load(a, k);
    let b = l.load(b, k);
    if half == 0 { l.low(a, b) } else { l.high(a, b) }
}

/// Sums of some packed groups with equal channels and bits.
struct MultiplyVt<'a> {
    groups: &'a [PackedGroup],
    words: &'a [U32x16],
    /// Light of their block.
    light: &'a [U32x16],
    steps: [f32; 3],
    scale: &'a [[f32; VECTORS]],
    sums: &'a mut [[Vec4; VECTORS]],
}

impl WithLanes for MultiplyVt<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self, l: L) {
        for_kind!(self.groups[0], L, self.sums(l));
    }
}

impl MultiplyVt<'_> {
    #[inline(always)]
    fn sums<L: Lanes, const SHORT: bool, const VECTOR_LEN: usize, const C: usize>(self, l: L, channels: [usize; C]) {
        let mut light = [&self.light[..PAIRS_OF_PARTS]; C];
        let mut biases = [IVec4::ZERO; C];
        let mut steps = [0.0; C];
        for (k, c) in channels.into_iter().enumerate() {
            light[k] = &self.light[c * PAIRS_OF_PARTS..(c + 1) * PAIRS_OF_PARTS];
            let sum: i32 = light[k].as_flattened().iter().map(|&word| both(word)).sum();
            (biases[k], steps[k]) = (IVec4::splat(bias(SHORT) * sum), self.steps[c]);
        }
        for ((group, scale), sums) in self.groups.iter().zip(self.scale).zip(self.sums) {
            let first = group.start as usize;
            let (vectors, _) = self.words[first..first + VECTORS * VECTOR_LEN].as_chunks::<VECTOR_LEN>();
            let mut lanes = [[[0; LANE_COUNT]; VECTORS]; C];
            for (v, vector) in vectors.iter().enumerate() {
                for k in 0..L::EACH {
                    let [a, b, c, d] = part_pairs::<L, SHORT>(l, vector, k);
                    for (lanes, light) in lanes.iter_mut().zip(light) {
                        let mut sum = l.products(a, l.load(&light[0], k));
                        sum = l.add(sum, l.products(b, l.load(&light[1], k)));
                        sum = l.add(sum, l.products(c, l.load(&light[2], k)));
                        sum = l.add(sum, l.products(d, l.load(&light[3], k)));
                        l.store(&mut lanes[v], k, sum);
                    }
                }
            }
            let scale = Vec4::from_array(*scale);
            let mut columns = [Vec4::ZERO; 4];
            for (k, c) in channels.into_iter().enumerate() {
                let sum = IVec4::from_array(l.totals(&lanes[k])) - biases[k];
                columns[c] = sum.as_vec4() * steps[k] * scale;
            }
            let z = Mat4::from_cols(columns[0], columns[1], columns[2], columns[3]).transpose();
            *sums = [z.x_axis, z.y_axis, z.z_axis, z.w_axis];
        }
    }
}

/// The sum of the two numbers of a word.
#[inline(always)]
fn both(word: u32) -> i32 {
    i32::from(word as i16) + ((word as i32) >> 16)
}

/// Adds some runs to the rows of their block.
struct MultiplyU<'a, F> {
    tables: &'a UTables<'a>,
    factors: F,
    runs: core::ops::Range<usize>,
    planes: &'a mut Planes,
}

impl<F: Factors> WithLanes for MultiplyU<'_, F> {
    #[inline(always)]
    fn with<L: Lanes>(self, l: L) {
        let Self { tables, factors, runs, planes } = self;
        let (words, _) = tables.words.as_chunks::<LANE_COUNT>();
        for k in runs {
            let groups = &tables.groups[tables.runs[k] as usize..tables.runs[k + 1] as usize];
            let factors = factors.of(k);
            let (pairs, last) = factors.split_at(4 * RUN_PAIRS as usize);
            let steps = steps_of(last);
            // Nothing comes of darkness.
            if steps != [0.0; 3] {
                let run = Run { groups, words, pairs: pairs.as_chunks::<4>().0, steps };
                for_kind!(groups[0], L, run.add(l, planes));
            }
        }
    }
}

/// Packed groups of a run and the factors of their vectors, in pairs.
struct Run<'a> {
    groups: &'a [PackedGroup],
    words: &'a [U32x16],
    pairs: &'a [[u32; 4]],
    steps: [f32; 3],
}

impl Run<'_> {
    #[inline(always)]
    fn add<L: Lanes, const SHORT: bool, const VECTOR_LEN: usize, const C: usize>(
        &self,
        l: L,
        planes: &mut [Plane; 3],
        channels: [usize; C],
    ) {
        let first = self.groups[0].start as usize;
        let vectors = &self.words[first..first + self.groups.len() * VECTORS * VECTOR_LEN];
        let mut biases = [l.splat(0); C];
        for (word, c) in biases.iter_mut().zip(channels) {
            let sum: i32 = self.pairs.iter().map(|pair| both(pair[c])).sum();
            *word = l.splat((bias(SHORT) * sum) as u32);
        }
        for half in 0..2 {
            for k in 0..L::EACH {
                let mut sums = [[l.splat(0); PAIRS_OF_PARTS]; C];
                for (two, factors) in vectors.chunks_exact(2 * VECTOR_LEN).zip(self.pairs) {
                    if *factors == [0; 4] {
                        continue;
                    }
                    let [a, b, c, d] = vector_pairs::<L, SHORT, VECTOR_LEN>(l, two, half, k);
                    for (sums, channel) in sums.iter_mut().zip(channels) {
                        let factor = l.splat(factors[channel]);
                        sums[0] = l.add(sums[0], l.products(a, factor));
                        sums[1] = l.add(sums[1], l.products(b, factor));
                        sums[2] = l.add(sums[2], l.products(c, factor));
                        sums[3] = l.add(sums[3], l.products(d, factor));
                    }
                }
                for ((sums, bias), c) in sums.into_iter().zip(biases).zip(channels) {
                    for (sum, row) in sums.into_iter().zip(&mut planes[c][half * PAIRS_OF_PARTS..]) {
                        l.add_scaled(row, k, l.sub(sum, bias), self.steps[c]);
                    }
                }
            }
        }
    }
}
