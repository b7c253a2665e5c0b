//! The product with tiles on all cores.

use std::vec::Vec;

use glam::{IVec4, Mat4, Vec3, Vec4};
use rayon::prelude::*;
use transport::{LinearOperator, check_length};

use super::lanes::{Group, Lanes, WithLanes, dispatch};
use super::near::{NearTables, near_block};
use super::{ColumnVectors, LowRank, SIDE, check_bank, check_starts};
use crate::error::Error;
use crate::kernel::tiles::{
    ALL_CHANNELS, BIAS, CHANNEL_WORDS, FACTOR_WORDS, LANES, LIGHT_WORDS, NO_SLOT, PAIRS, PARTS, PLACES, QUAD,
    RUN_PAIRS, RUN_QUADS, SHORT_BIAS, SPLITS, SQUARE_WORDS, TILE, TWOS, element, enter, inverse_of, leave, row_of,
    split_of, step_of, tint, whole,
};
use crate::types::TileQuad;

/// Lanes of a part.
pub(super) const GROUP: usize = LANES as usize;
const FOUR: usize = QUAD as usize;
const HALF: usize = TWOS as usize;
/// Quads that one task takes, runs, blocks, and places.
const TASK_QUADS: usize = 256;
const TASK_RUNS: usize = 64;
const TASK_BLOCKS: usize = 8;
const TASK_PLACES: usize = TASK_BLOCKS * SIDE;

/// Rows of a colour channel of a block, part by part.
type Plane = [[f32; GROUP]; PARTS as usize];

/// What a product keeps between its steps: one for products one after another.
#[derive(Clone, Debug, Default)]
pub struct LowRankWorkspace {
    ordered: Vec<Vec4>,
    light: Vec<u32>,
    sums: Vec<Vec4>,
    placed: Vec<Vec4>,
}

/// Irradiance `H = T B`, W/m². The fourth component is 0.
impl LinearOperator for LowRank {
    fn shape(&self) -> (usize, usize) {
        (self.place.len(), self.order.len())
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
        let LowRankWorkspace { ordered, light, sums, placed } = workspace;
        let columns = self.column_blocks() * SIDE;
        ordered.resize(PLACES, Vec4::ZERO);
        light.resize(self.column_blocks() * LIGHT_WORDS as usize, 0);
        sums.resize(self.scale.len(), Vec4::ZERO);
        self.prepare(exitance, &mut ordered[..columns], light);
        project_all(&self.project_tables(), light, sums);
        let found = ordered.len();
        let ordered =
            ordered.first_chunk().ok_or(transport::Error::Length { name: "ordered", expected: PLACES, found })?;
        // Rows that stand in their order are written where they belong at once.
        let is_ordered = self.place.iter().zip(0..).all(|(&place, i)| place == i);
        if is_ordered {
            self.rows(light, ordered, sums, irradiance, |p| self.root[p]);
        } else {
            placed.resize(self.place.len(), Vec4::ZERO);
            self.rows(light, ordered, sums, placed, |_| 1.0);
            leave_places(&self.place, &self.root, placed, irradiance);
        }
        Ok(())
    }

    /// Rows by places, over the root of the place, block by block: what a block adds up stays in the first cache.
    fn rows(
        &self,
        light: &[u32],
        ordered: &[Vec4; PLACES],
        sums: &[Vec4],
        out: &mut [Vec4],
        root: impl Fn(usize) -> f32 + Sync,
    ) {
        let expand = self.expand_tables();
        let near = self.near_tables();
        let factors = Sums { runs: &self.runs, partner: &self.partner, sums };
        out.par_chunks_mut(SIDE).enumerate().for_each_init(
            || [Vec4::ZERO; SIDE],
            |rows, (b, out)| {
                near_block(&near, light, ordered, b, rows);
                add_rows(&expand, factors, b, rows);
                out.iter_mut().zip(rows).zip(b * SIDE..).for_each(|((out, row), p)| *out = *row / root(p));
            },
        );
    }

    /// [`enter_all`] and [`round_all`], block by block.
    fn prepare(&self, exitance: &[Vec4], ordered: &mut [Vec4], light: &mut [u32]) {
        let columns = self.order.len() as u32;
        let root = self.column_root();
        let (blocks, _) = ordered.as_chunks_mut::<SIDE>();
        let tasks = blocks.par_iter_mut().zip(light.par_chunks_mut(LIGHT_WORDS as usize)).enumerate();
        tasks.with_min_len(TASK_BLOCKS).for_each(|(b, (block, light))| {
            for (p, x) in (b * SIDE..).zip(block.iter_mut()) {
                *x = enter(p as u32, columns, &self.order, root, exitance);
            }
            dispatch(Round { block, light });
        });
    }

    /// Row `i` of `a_r^-½ T̂ a_c^½`, one colour a column, as products multiply by it.
    ///
    /// # Errors
    /// [`transport::Error::Length`] unless there is one element a column, [`transport::Error::Value`] for a row that there is
    /// not.
    pub fn row(&self, i: usize, row: &mut [Vec3]) -> Result<(), Error> {
        check_length("row", self.order.len(), row.len())?;
        let Some(&place) = self.place.get(i) else {
            return Err(
                transport::Error::Value { name: "row", index: i, value: i as f64, rule: "one of the rows" }.into()
            );
        };
        let sums = self.project_tables();
        let (p, r, block) = (place as usize, place % TILE, place as usize / SIDE);
        let mut places = vec![Vec3::ZERO; self.column_blocks() * SIDE];
        let quad_start = |block: usize| self.runs[self.run_start[block] as usize];
        for slot in QUAD * quad_start(block)..QUAD * quad_start(block + 1) {
            let partner = self.partner[slot as usize];
            if partner == NO_SLOT {
                continue;
            }
            let own = self.quads[(slot / QUAD) as usize].vector(slot % QUAD);
            let quad = sums.quads[(partner / QUAD) as usize];
            let factor = self.scale[partner as usize] * element(&self.words, own, r) as f32;
            let factor = factor * tint(quad.color(), self.axes);
            let first = quad.block() as usize * SIDE;
            for (c, sum) in places[first..first + SIDE].iter_mut().enumerate() {
                *sum += factor * element(sums.words, quad.vector(partner % QUAD), c as u32) as f32;
            }
        }
        let part = p / GROUP;
        for k in self.square_start[part] as usize..self.square_start[part + 1] as usize {
            let square = self.squares[k];
            let first = GROUP * square.column as usize;
            for (group, four) in places[first..first + GROUP].chunks_exact_mut(4).enumerate() {
                let word = self.square_words[k * SQUARE_WORDS as usize + group * GROUP + p % GROUP];
                four.iter_mut().zip(row_of(word)).for_each(|(sum, x)| *sum += Vec3::splat(x as f32 * square.step));
            }
        }
        for &entry in &self.entries[self.row_start[p] as usize..self.row_start[p + 1] as usize] {
            places[(entry & 0xffff) as usize] += Vec3::splat(((entry as i32) >> 16) as f32 * self.steps[p]);
        }
        let root = self.column_root();
        for (&j, value) in self.order.iter().zip(&places) {
            row[j as usize] = *value * (root[j as usize] / self.root[i]);
        }
        Ok(())
    }

    /// The tables of [`project_all`].
    pub fn project_tables(&self) -> ProjectTables<'_> {
        let Self { axes, scale, .. } = self;
        match &self.columns {
            Some(ColumnVectors { quads, words, .. }) => ProjectTables { axes: *axes, quads, words, scale },
            None => ProjectTables { axes: *axes, quads: &self.quads, words: &self.words, scale },
        }
    }

    /// The tables of [`expand_all`].
    pub fn expand_tables(&self) -> ExpandTables<'_> {
        let Self { run_start, runs, quads, words, .. } = self;
        ExpandTables { run_start, runs, quads, words }
    }

    /// The tables of [`crate::near_all`].
    pub fn near_tables(&self) -> NearTables<'_> {
        let Self { square_start, squares, square_words, row_start, entries, steps, .. } = self;
        NearTables { square_start, squares, square_words, row_start, entries, steps }
    }
}

/// [`enter`] for every place.
pub fn enter_all(order: &[u32], root: &[f32], exitance: &[Vec4], ordered: &mut [Vec4]) {
    let patches = order.len() as u32;
    let tasks = ordered.par_iter_mut().enumerate().with_min_len(TASK_PLACES);
    tasks.for_each(|(p, x)| *x = enter(p as u32, patches, order, root, exitance));
}

/// [`leave`] for every patch.
pub fn leave_all(place: &[u32], root: &[f32], rows: &[Vec4], near: &[Vec4], irradiance: &mut [Vec4]) {
    let tasks = irradiance.par_iter_mut().enumerate().with_min_len(TASK_PLACES);
    tasks.for_each(|(i, h)| *h = leave(i as u32, place, root, rows, near));
}

/// [`leave`] from rows that are added up, for every patch.
pub(super) fn leave_places(place: &[u32], root: &[f32], rows: &[Vec4], irradiance: &mut [Vec4]) {
    let tasks = irradiance.par_iter_mut().zip(place).zip(root).with_min_len(TASK_PLACES);
    tasks.for_each(|((h, &place), root)| *h = rows[place as usize] / *root);
}

/// [`crate::kernel::tiles::round`] for every lane, bit for bit.
pub fn round_all(ordered: &[Vec4], light: &mut [u32]) {
    let (blocks, _) = ordered.as_chunks::<SIDE>();
    let tasks = blocks.par_iter().zip(light.par_chunks_mut(LIGHT_WORDS as usize)).with_min_len(TASK_BLOCKS);
    tasks.for_each(|(block, light)| dispatch(Round { block, light }));
}

/// Makes whole numbers of a block.
struct Round<'a> {
    block: &'a [Vec4; SIDE],
    light: &'a mut [u32],
}

impl WithLanes for Round<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self, _: L) {
        let (mut planes, mut most) = ([[0.0; SIDE]; 3], Vec4::ZERO);
        for (r, x) in self.block.iter().enumerate() {
            most = most.max(x.abs());
            (planes[0][r], planes[1][r], planes[2][r]) = (x.x, x.y, x.z);
        }
        let (channels, rest) = self.light.split_at_mut(3 * CHANNEL_WORDS as usize);
        let (steps, pairs) = rest.split_at_mut(GROUP);
        steps.fill(0);
        for (c, (words, plane)) in channels.chunks_exact_mut(CHANNEL_WORDS as usize).zip(&planes).enumerate() {
            let step = step_of(most[c]);
            steps[c] = step.to_bits();
            let inverse = inverse_of(step);
            let mut numbers = [0; SIDE];
            numbers.iter_mut().zip(plane).for_each(|(number, x)| *number = whole(*x, inverse));
            let (first, second) = numbers.split_at(SIDE / 2);
            for (word, (a, b)) in words.iter_mut().zip(first.iter().zip(second)) {
                *word = a & 0xffff | b << 16;
            }
            for (part, own) in pairs.chunks_exact_mut(3 * PAIRS as usize).zip(numbers.chunks_exact(GROUP)) {
                let part = &mut part[c * PAIRS as usize..(c + 1) * PAIRS as usize];
                part.iter_mut().zip(own.as_chunks::<2>().0).for_each(|(word, [a, b])| *word = a & 0xffff | b << 16);
            }
        }
    }
}

/// What [`project_all`] reads beside the light.
#[derive(Clone, Copy, Debug)]
pub struct ProjectTables<'a> {
    /// Red and blue of the axes of the differences, [`tint`].
    pub axes: Vec4,
    /// Vectors by fours, block by block, alike ones together.
    pub quads: &'a [TileQuad],
    /// Their elements, in groups of [`LANES`] words.
    pub words: &'a [u32],
    /// What the sum of each slot is multiplied by.
    pub scale: &'a [f32],
}

/// [`crate::kernel::tiles::project`] for every quad, bit for bit.
pub fn project_all(tables: &ProjectTables, light: &[u32], sums: &mut [Vec4]) {
    let ProjectTables { axes, quads, words, scale } = *tables;
    let (groups, _) = words.as_chunks::<GROUP>();
    let ((light, _), (scale, _)) = (light.as_chunks::<GROUP>(), scale.as_chunks::<FOUR>());
    let (sums, _) = sums.as_chunks_mut::<FOUR>();
    let tasks = quads.par_chunks(TASK_QUADS).zip(scale.par_chunks(TASK_QUADS)).zip(sums.par_chunks_mut(TASK_QUADS));
    tasks.for_each(|((quads, scale), sums)| {
        let mut done = 0;
        for alike in quads.chunk_by(|a, b| a.tag == b.tag) {
            let (first, end) = (done, done + alike.len());
            done = end;
            let block = (LIGHT_WORDS / LANES) as usize * alike[0].block() as usize;
            let light = &light[block..block + (LIGHT_WORDS / LANES) as usize];
            let steps = Vec3::from_array(steps_of(&light[(3 * CHANNEL_WORDS / LANES) as usize]));
            let steps = (steps * tint(alike[0].color(), axes)).to_array();
            // Nothing comes of darkness.
            if steps == [0.0; 3] {
                sums[first..end].fill([Vec4::ZERO; FOUR]);
                continue;
            }
            let (scale, sums) = (&scale[first..end], &mut sums[first..end]);
            dispatch(Project { quads: alike, groups, light, steps, scale, sums });
        }
    });
}

/// Steps of the channels, from their bits.
pub(super) fn steps_of(words: &[u32]) -> [f32; 3] {
    std::array::from_fn(|c| f32::from_bits(words[c]))
}

/// [`crate::kernel::tiles::weigh`] for every run, bit for bit.
pub fn weigh_all(runs: &[u32], partner: &[u32], sums: &[Vec4], factors: &mut [u32]) {
    let (factors, _) = factors.as_chunks_mut::<{ FACTOR_WORDS as usize }>();
    let tasks = factors.par_iter_mut().enumerate().with_min_len(TASK_RUNS);
    tasks.for_each(|(run, factors)| *factors = Sums { runs, partner, sums }.of(run));
}

/// What vectors are multiplied by.
pub(super) trait Factors: Copy + Sync {
    /// The words of a run.
    fn of(self, run: usize) -> RunFactors;
}

/// Words of [`crate::kernel::tiles::weigh`] for one run.
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
    pub partner: &'a [u32],
    pub sums: &'a [Vec4],
}

impl Factors for Sums<'_> {
    #[inline(always)]
    fn of(self, run: usize) -> RunFactors {
        let slots = &self.partner[FOUR * self.runs[run] as usize..FOUR * self.runs[run + 1] as usize];
        let (mut own, mut most) = ([Vec4::ZERO; (RUN_QUADS * QUAD) as usize], Vec4::ZERO);
        for (z, &other) in own.iter_mut().zip(slots) {
            if other != NO_SLOT {
                *z = self.sums[other as usize];
                most = most.max(z.abs());
            }
        }
        let steps = most.to_array().map(step_of);
        let inverse = steps.map(inverse_of);
        let mut factors = [0; FACTOR_WORDS as usize];
        let (pairs, last) = factors.split_at_mut(4 * RUN_PAIRS as usize);
        for (words, two) in pairs.chunks_exact_mut(4).zip(own[..slots.len()].chunks_exact(2)) {
            let (a, b) = (two[0].to_array(), two[1].to_array());
            for (c, word) in words[..3].iter_mut().enumerate() {
                *word = whole(a[c], inverse[c]) & 0xffff | whole(b[c], inverse[c]) << 16;
            }
        }
        last.copy_from_slice(&[steps[0].to_bits(), steps[1].to_bits(), steps[2].to_bits(), 0]);
        factors
    }
}

/// What [`expand_all`] reads beside the factors.
#[derive(Clone, Copy, Debug)]
pub struct ExpandTables<'a> {
    /// Runs of block b: `run_start[b]..run_start[b + 1]`.
    pub run_start: &'a [u32],
    /// Quads of run k: `quads[runs[k]..runs[k + 1]]`.
    pub runs: &'a [u32],
    /// Vectors by fours, block by block; those of a run are alike, and their words follow one another.
    pub quads: &'a [TileQuad],
    /// Their elements, in groups of [`LANES`] words.
    pub words: &'a [u32],
}

impl ExpandTables<'_> {
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.run_start) + size_of_val(self.runs) + size_of_val(self.quads) + size_of_val(self.words)
    }

    /// Whether the tables of so many blocks belong together.
    pub(super) fn check(&self, blocks: usize) -> Result<(), Error> {
        check_bank(self.runs, self.quads, self.words, blocks)?;
        check_length("run_start", blocks + 1, self.run_start.len())?;
        check_starts("run_start", self.run_start, self.runs.len().saturating_sub(1))
    }
}

/// [`crate::kernel::tiles::expand`] for every lane, bit for bit.
pub fn expand_all(tables: &ExpandTables, factors: &[u32], rows: &mut [Vec4]) {
    let (factors, (splits, _)) = (factors.as_chunks().0, rows.as_chunks_mut::<SIDE>());
    splits.par_iter_mut().enumerate().for_each(|(k, rows)| {
        let (block, split) = (k / SPLITS as usize, k % SPLITS as usize);
        let mut planes = NO_PLANES;
        add_split(tables, factors, block, split, &mut planes);
        rows.iter_mut().enumerate().for_each(|(r, row)| *row = row_of_planes(&planes, r));
    });
}

/// Rows of a colour channel each.
type Planes = [Plane; 3];
const NO_PLANES: Planes = [[[0.0; GROUP]; PARTS as usize]; 3];

/// Adds what the vectors of a split of a block make.
fn add_split(tables: &ExpandTables, factors: impl Factors, block: usize, split: usize, planes: &mut Planes) {
    let (first, end) = split_of(split as u32, tables.run_start[block], tables.run_start[block + 1]);
    dispatch(Expand { tables, factors, runs: first as usize..end as usize, planes });
}

fn row_of_planes(planes: &Planes, r: usize) -> Vec4 {
    let [red, green, blue] = planes.each_ref().map(|plane| plane.as_flattened());
    Vec4::new(red[r], green[r], blue[r], 0.0)
}

/// Adds what the vectors of a block make to its rows, as [`leave`] does.
pub(super) fn add_rows(tables: &ExpandTables, factors: impl Factors, block: usize, rows: &mut [Vec4; SIDE]) {
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
    ($quad:expr, $lanes:ty, $own:ident.$function:ident($($argument:expr),*)) => {
        match ($quad.is_short(), $quad.color()) {
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

/// Elements of a vector with their bias, in twos of parts.
#[inline(always)]
fn twos<L: Lanes, const SHORT: bool>(l: L, vector: &[Group], k: usize) -> [L::Word; HALF] {
    let word = l.load(&vector[0], k);
    if SHORT {
        return l.nibbles(word);
    }
    let ([a, b], [c, d]) = (l.bytes(word), l.bytes(l.load(&vector[1], k)));
    [a, b, c, d]
}

/// Elements of two vectors with their bias, in pairs: the parts of the first or of the second half.
#[inline(always)]
fn pairs<L: Lanes, const SHORT: bool, const GROUPS: usize>(
    l: L,
    two: &[Group],
    half: usize,
    k: usize,
) -> [L::Word; HALF] {
    let word = merged(l, &two[0], &two[GROUPS], half, k);
    if SHORT {
        return l.nibbles(word);
    }
    let ([a, b], [c, d]) = (l.bytes(word), l.bytes(merged(l, &two[1], &two[GROUPS + 1], half, k)));
    [a, b, c, d]
}

#[inline(always)]
fn merged<L: Lanes>(l: L, a: &Group, b: &Group, half: usize, k: usize) -> L::Word {
    let (a, b) = (l.load(a, k), l.load(b, k));
    if half == 0 { l.low(a, b) } else { l.high(a, b) }
}

/// Sums of some quads that are alike.
struct Project<'a> {
    quads: &'a [TileQuad],
    groups: &'a [Group],
    /// Of their block.
    light: &'a [Group],
    steps: [f32; 3],
    scale: &'a [[f32; FOUR]],
    sums: &'a mut [[Vec4; FOUR]],
}

impl WithLanes for Project<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self, l: L) {
        for_kind!(self.quads[0], L, self.sums(l));
    }
}

impl Project<'_> {
    #[inline(always)]
    fn sums<L: Lanes, const SHORT: bool, const GROUPS: usize, const C: usize>(self, l: L, channels: [usize; C]) {
        let (mut light, mut biases, mut steps) = ([&self.light[..HALF]; C], [IVec4::ZERO; C], [0.0; C]);
        for (k, c) in channels.into_iter().enumerate() {
            light[k] = &self.light[c * HALF..(c + 1) * HALF];
            let sum: i32 = light[k].as_flattened().iter().map(|&word| both(word)).sum();
            (biases[k], steps[k]) = (IVec4::splat(bias(SHORT) * sum), self.steps[c]);
        }
        for ((quad, scale), sums) in self.quads.iter().zip(self.scale).zip(self.sums) {
            let first = quad.group as usize;
            let (vectors, _) = self.groups[first..first + FOUR * GROUPS].as_chunks::<GROUPS>();
            let mut lanes = [[[0; GROUP]; FOUR]; C];
            for (v, vector) in vectors.iter().enumerate() {
                for k in 0..L::EACH {
                    let [a, b, c, d] = twos::<L, SHORT>(l, vector, k);
                    for (lanes, light) in lanes.iter_mut().zip(light) {
                        let mut sum = l.products(a, l.load(&light[0], k));
                        sum = l.add(sum, l.products(b, l.load(&light[1], k)));
                        sum = l.add(sum, l.products(c, l.load(&light[2], k)));
                        sum = l.add(sum, l.products(d, l.load(&light[3], k)));
                        l.store(&mut lanes[v], k, sum);
                    }
                }
            }
            let (scale, mut columns) = (Vec4::from_array(*scale), [Vec4::ZERO; 4]);
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
struct Expand<'a, F> {
    tables: &'a ExpandTables<'a>,
    factors: F,
    runs: std::ops::Range<usize>,
    planes: &'a mut Planes,
}

impl<F: Factors> WithLanes for Expand<'_, F> {
    #[inline(always)]
    fn with<L: Lanes>(self, l: L) {
        let Self { tables, factors, runs, planes } = self;
        let (groups, _) = tables.words.as_chunks::<GROUP>();
        for k in runs {
            let quads = &tables.quads[tables.runs[k] as usize..tables.runs[k + 1] as usize];
            let factors = factors.of(k);
            let (pairs, last) = factors.split_at(4 * RUN_PAIRS as usize);
            let steps = steps_of(last);
            // Nothing comes of darkness.
            if steps != [0.0; 3] {
                let run = Run { quads, groups, pairs: pairs.as_chunks::<4>().0, steps };
                for_kind!(quads[0], L, run.add(l, planes));
            }
        }
    }
}

/// Quads that are alike and what their vectors are multiplied by, in pairs.
struct Run<'a> {
    quads: &'a [TileQuad],
    groups: &'a [Group],
    pairs: &'a [[u32; 4]],
    steps: [f32; 3],
}

impl Run<'_> {
    #[inline(always)]
    fn add<L: Lanes, const SHORT: bool, const GROUPS: usize, const C: usize>(
        &self,
        l: L,
        planes: &mut [Plane; 3],
        channels: [usize; C],
    ) {
        let first = self.quads[0].group as usize;
        let vectors = &self.groups[first..first + self.quads.len() * FOUR * GROUPS];
        let mut biases = [l.splat(0); C];
        for (word, c) in biases.iter_mut().zip(channels) {
            let sum: i32 = self.pairs.iter().map(|pair| both(pair[c])).sum();
            *word = l.splat((bias(SHORT) * sum) as u32);
        }
        for half in 0..2 {
            for k in 0..L::EACH {
                let mut sums = [[l.splat(0); HALF]; C];
                for (two, factors) in vectors.chunks_exact(2 * GROUPS).zip(self.pairs) {
                    if *factors == [0; 4] {
                        continue;
                    }
                    let [a, b, c, d] = pairs::<L, SHORT, GROUPS>(l, two, half, k);
                    for (sums, channel) in sums.iter_mut().zip(channels) {
                        let factor = l.splat(factors[channel]);
                        sums[0] = l.add(sums[0], l.products(a, factor));
                        sums[1] = l.add(sums[1], l.products(b, factor));
                        sums[2] = l.add(sums[2], l.products(c, factor));
                        sums[3] = l.add(sums[3], l.products(d, factor));
                    }
                }
                for ((sums, bias), c) in sums.into_iter().zip(biases).zip(channels) {
                    for (sum, row) in sums.into_iter().zip(&mut planes[c][half * HALF..]) {
                        l.add_scaled(row, k, l.sub(sum, bias), self.steps[c]);
                    }
                }
            }
        }
    }
}
