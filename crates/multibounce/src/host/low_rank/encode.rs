//! From operators to tiles.

use alloc::vec::Vec;

use glam::Vec4;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use transport::{Proceed, check_length, check_setting};

use super::reduce::{DenseSubBlock, EDGE, Part, SIDE, Term};
use super::symmetric::SymmetricTiles;
use super::{
    ColumnVectors, LowRank, MAX_TILE_PATCHES, MAX_TILE_RECEIVERS, TileReport, TileSide, TileSource, permuted_indices,
    rectangular,
};
use crate::error::Error;
use crate::kernel::low_rank::{ALL_CHANNELS, BIAS, GROUP_VECTORS, LANES, NO_VECTOR, PARTS, RUN_GROUPS, SHORT_BIAS};
use crate::types::{PackedGroup, SubBlock};

/// The error is at least this share of what was asked for, when it can be.
const CLOSE: f64 = 0.85;
/// Times that λ is corrected.
const MAX_ROUNDS: usize = 24;

/// Receives how many tiles are done, and says whether to go on.
pub(super) type Progress<'a> = dyn Fn(usize, usize) -> Proceed + Sync + 'a;

/// An operator that can be brought into tiles with any λ.
pub(super) trait Encoder {
    /// λ to begin with.
    fn first_lambda(&self, epsilon: f64) -> Result<f32, Error>;

    /// Returns true if λ is first looked for with a part of the tiles.
    fn has_sample(&self) -> bool;

    /// Relative error of that part.
    fn sample_error(&self, lambda: f32, progress: &Progress) -> Result<f64, Error>;

    /// Returns true if trying again takes long.
    fn is_large(&self) -> bool;

    /// All tiles.
    fn encode(&self, lambda: f32, progress: &Progress) -> Result<Encoded, Error>;
}

/// Encoded tiles.
pub(super) struct Encoded {
    /// Row and column of blocks of each tile.
    pub at: Vec<(usize, usize)>,
    pub parts: Vec<Part>,
    /// Their sparse residual.
    pub rows: Rows,
    /// Relative error of each channel.
    pub error: [f64; 3],
    /// The greatest relative error, as λ is found by.
    pub worst: f64,
}

/// Finds λ so that the whole has the error that was asked for: from a part of the tiles first, then from all of them,
/// each time a little less when it was too much.
fn search(encoder: &impl Encoder, epsilon: f64, progress: &Progress) -> Result<Encoded, Error> {
    let mut lambda = encoder.first_lambda(epsilon)?;
    // In the logarithm the error is about half of λ; what is known of both sides bounds the next try.
    let mut low = 0.0f32;
    let mut high = f32::INFINITY;
    if encoder.has_sample() {
        for _ in 0..MAX_ROUNDS {
            let error = encoder.sample_error(lambda, progress)?;
            if (CLOSE * epsilon..=epsilon).contains(&error) {
                break;
            }
            lambda = next_lambda(lambda, error, epsilon, &mut low, &mut high);
        }
        (low, high) = (0.0, f32::INFINITY);
    }
    let mut best = None;
    for round in 0..MAX_ROUNDS {
        let made = encoder.encode(lambda, progress)?;
        let error = made.worst;
        let good = error <= epsilon;
        if good {
            best = Some(made);
        }
        // What is good stays good enough when trying again takes long.
        if good && (error >= CLOSE * epsilon || round > 0 || encoder.is_large()) {
            break;
        }
        lambda = next_lambda(lambda, error, epsilon, &mut low, &mut high);
    }
    let rule = "more: single precision cannot give it";
    Ok(best.ok_or(transport::Error::Setting { name: "epsilon", value: epsilon, rule })?)
}

impl LowRank {
    /// Tiles of an operator with a relative Frobenius error of at most `epsilon`, in every channel.
    ///
    /// Rows that are asked for are so block by block, more than once and on all cores: they need not be in memory as a
    /// matrix. `progress(done, total)` counts tiles, or blocks of rows, of the last pass; breaking it cancels.
    ///
    /// # Errors
    /// [`transport::Error::Length`] for matrices or orders of another size, [`transport::Error::Setting`] for an ε that
    /// is not in 10⁻⁶..1, [`transport::Error::Value`] for an order that is none, an area that is not positive, a column
    /// or a value that is none, [`transport::Error::TooMany`] rows or columns, [`transport::Error::Cancelled`],
    /// [`Error::File`].
    pub fn encode(source: TileSource, epsilon: f64, progress: &Progress) -> Result<Self, Error> {
        match source {
            TileSource::Symmetric { channels, patches } => {
                check_count("patches", patches.area.len(), MAX_TILE_PATCHES)?;
                check_epsilon(epsilon)?;
                let permuted_index = checked_indices(patches)?;
                let tiles = SymmetricTiles::new(channels, patches, &permuted_index)?;
                let made = search(&tiles, epsilon, progress)?;
                let [first, second] = tiles.source.chroma_axes;
                let chroma_axes = Vec4::new(first[0], first[1], second[0], second[1]);
                let tables = Self {
                    order: patches.order.to_vec(),
                    row_sqrt_area: sqrt_areas_of(patches),
                    permuted_index,
                    chroma_axes,
                    ..Self::default()
                };
                Ok(tables.assemble(made))
            }
            TileSource::Rows { rows, receivers, patches } => {
                check_count("patches", patches.area.len(), MAX_TILE_PATCHES)?;
                check_count("receivers", receivers.area.len(), MAX_TILE_RECEIVERS)?;
                check_epsilon(epsilon)?;
                let permuted_index = checked_indices(receivers)?;
                let column_index = checked_indices(patches)?;
                let source = rectangular::Source::new(rows, receivers, patches, &column_index);
                let made = search(&source, epsilon, progress)?;
                let columns = ColumnVectors { sqrt_area: sqrt_areas_of(patches), ..ColumnVectors::default() };
                let tables = Self {
                    order: patches.order.to_vec(),
                    row_sqrt_area: sqrt_areas_of(receivers),
                    permuted_index,
                    columns: Some(columns),
                    ..Self::default()
                };
                Ok(tables.assemble(made))
            }
        }
    }

    /// Tables from the tiles' parts.
    fn assemble(self, made: Encoded) -> Self {
        let Encoded { at, parts, rows: entries, error, .. } = made;
        let is_symmetric = self.is_symmetric();
        let mut report = TileReport::default();
        let sub_blocks = DenseSubBlocks::pack(&at, &parts, self.blocks() * PARTS as usize, is_symmetric);
        // Vectors of the blocks: rank-1 term, side, channels and bits.
        let mut of_rows: Vec<Vec<Vector>> = vec![Vec::new(); self.blocks()];
        let mut of_columns: Vec<Vec<Vector>> = vec![Vec::new(); self.column_blocks()];
        let mut terms: Vec<&Term> = Vec::new();
        for (&(i, j), part) in at.iter().zip(&parts) {
            report.add(part);
            for term in &part.terms {
                let alike = (term.color, term.is_short);
                let vector = |side, is_multiplied| Vector { alike, is_multiplied, term: terms.len(), side };
                of_rows[i].push(vector(0, true));
                // A symmetric tile on the diagonal is whole: its second vectors only make sums.
                match is_symmetric {
                    true => of_rows[j].push(vector(1, i != j)),
                    false => of_columns[j].push(vector(1, false)),
                }
                terms.push(term);
            }
        }
        let tiles = if is_symmetric { at.len() } else { self.blocks() * self.column_blocks() };
        report.tiles[0] += tiles - at.len();
        report.error = error;
        let words_of = |vector: &Vector| &terms[vector.term].words[vector.side][..];
        let rows = Bank::new(&mut of_rows, words_of);
        let columns = (!is_symmetric).then(|| Bank::new(&mut of_columns, words_of));
        let summed = columns.as_ref().map_or(&rows.indexed, |columns| &columns.indexed);
        let scale = |vector: &Option<&Vector>| vector.map_or(0.0, |vector| terms[vector.term].scale);
        let scale = summed.iter().map(scale).collect();
        let mut index_of = vec![[NO_VECTOR; 2]; terms.len()];
        for (index, vector) in (0u32..).zip(summed) {
            if let Some(vector) = vector {
                index_of[vector.term][vector.side] = index;
            }
        }
        let paired = |vector: &Option<&Vector>| match vector {
            Some(vector) if vector.is_multiplied => index_of[vector.term][1 - vector.side],
            _ => NO_VECTOR,
        };
        let paired = rows.indexed.iter().map(paired).collect();
        let columns = self.columns.zip(columns).map(|(own, bank)| ColumnVectors {
            sqrt_area: own.sqrt_area,
            runs: bank.runs,
            groups: bank.groups,
            words: bank.words,
        });
        Self {
            run_start: rows.run_start,
            runs: rows.runs,
            groups: rows.groups,
            words: rows.words,
            columns,
            scale,
            paired,
            sub_block_start: sub_blocks.start,
            sub_blocks: sub_blocks.sub_blocks,
            sub_block_words: sub_blocks.words,
            row_start: entries.row_start,
            entries: entries.entries,
            steps: entries.steps,
            report,
            ..self
        }
    }
}

impl TileReport {
    /// Counts a tile.
    pub(super) fn add(&mut self, part: &Part) {
        let kind = if !part.terms.is_empty() {
            2
        } else {
            usize::from(!(part.entries.is_empty() && part.sub_blocks.is_empty()))
        };
        self.tiles[kind] += 1;
        self.most_rank = self.most_rank.max(part.terms.len());
        self.entries += part.entries.len();
        self.sub_blocks += part.sub_blocks.len();
        for term in &part.terms {
            self.terms[usize::from(term.color != ALL_CHANNELS)] += 1;
        }
    }
}

fn check_count(name: &'static str, found: usize, limit: usize) -> Result<(), transport::Error> {
    match found > limit {
        true => Err(transport::Error::TooMany { name, found: found as u64, limit: limit as u64 }),
        false => Ok(()),
    }
}

fn check_epsilon(epsilon: f64) -> Result<(), transport::Error> {
    check_setting("epsilon", epsilon, "at least 0.000001 and below 1", (1e-6..1.0).contains(&epsilon))
}

/// Permuted index of each number, by an order of as many as there are areas.
fn checked_indices(side: TileSide) -> Result<Vec<u32>, Error> {
    let TileSide { area, order } = side;
    check_length("order", area.len(), order.len())?;
    if let Some(index) = area.iter().position(|a| !(a.is_finite() && *a > 0.0)) {
        let value = f64::from(area[index]);
        return Err(transport::Error::Value { name: "area", index, value, rule: "positive" }.into());
    }
    permuted_indices(order)
}

/// `√a` of all, m.
pub(super) fn sqrt_areas_of(side: TileSide) -> Vec<f32> {
    side.area.iter().map(|&a| scene::math::sqrt(a)).collect()
}

/// A vector of a rank-1 term.
#[derive(Clone)]
struct Vector {
    /// The channels that it is for, and whether elements are short.
    pub alike: (u32, bool),
    /// True if it is multiplied by the sum of the other.
    pub is_multiplied: bool,
    pub term: usize,
    /// Along the rows or along the columns.
    pub side: usize,
}

/// Vectors in packed groups, block by block, those with equal channels and bits together.
struct Bank<'a> {
    pub run_start: Vec<u32>,
    pub runs: Vec<u32>,
    pub groups: Vec<PackedGroup>,
    pub words: Vec<u32>,
    /// Vector of each vector index; none where zeros fill up.
    pub indexed: Vec<Option<&'a Vector>>,
}

impl<'a> Bank<'a> {
    /// Packs the vectors of each block, whose words are given.
    pub fn new<'b>(vectors: &'a mut [Vec<Vector>], words_of: impl Fn(&Vector) -> &'b [u32]) -> Self {
        let mut groups = Vec::new();
        let mut words = Vec::new();
        let mut runs = Vec::new();
        let mut run_start = vec![0];
        let mut indexed: Vec<Option<&Vector>> = Vec::new();
        for (block, vectors) in (0u32..).zip(vectors) {
            vectors.sort_by_key(|vector| (vector.alike, vector.is_multiplied));
            for alike in vectors.chunk_by(|a, b| a.alike == b.alike) {
                let (color, is_short) = alike[0].alike;
                for (k, four) in alike.chunks(GROUP_VECTORS as usize).enumerate() {
                    if k.is_multiple_of(RUN_GROUPS as usize) {
                        runs.push(groups.len() as u32);
                    }
                    let group = PackedGroup::new(words.len() as u32 / LANES, block, color, is_short);
                    for vector in four {
                        words.extend_from_slice(words_of(vector));
                    }
                    indexed.extend(four.iter().map(Some));
                    indexed.resize(indexed.len().next_multiple_of(GROUP_VECTORS as usize), None);
                    groups.push(group);
                    let zero = if is_short { ZERO_SHORT } else { ZERO_LONG };
                    words.resize(((group.start + GROUP_VECTORS * group.vector_len()) * LANES) as usize, zero);
                }
            }
            run_start.push(runs.len() as u32);
        }
        runs.push(groups.len() as u32);
        Self { run_start, runs, groups, words, indexed }
    }
}

/// Words of elements that are zero, of 4 and of 8 bits.
const ZERO_SHORT: u32 = 0x1111_1111 * SHORT_BIAS as u32;
const ZERO_LONG: u32 = 0x0101_0101 * BIAS as u32;

/// Start of each of these, and the end of the last.
fn starts(lengths: impl Iterator<Item = usize>) -> Vec<u32> {
    let mut starts = vec![0u32];
    for (k, length) in lengths.enumerate() {
        starts.push(starts[k] + length as u32);
    }
    starts
}

/// The sparse residual of all rows.
pub(super) struct Rows {
    pub row_start: Vec<u32>,
    pub entries: Vec<u32>,
    pub steps: Vec<f32>,
    /// Squared error of their rounding.
    pub error: f64,
}

impl Rows {
    /// With `is_mirrored`, tiles above the diagonal also stand below it.
    pub fn pack(tiles: &[(usize, usize)], parts: &[Part], rows: usize, is_mirrored: bool) -> Self {
        let mut given: Vec<Vec<(u32, f32)>> = vec![Vec::new(); rows];
        for (&(i, j), part) in tiles.iter().zip(parts) {
            for &(r, c, value) in &part.entries {
                let r = i * SIDE + r as usize;
                let c = j * SIDE + c as usize;
                given[r].push((c as u32, value));
                if is_mirrored && i != j {
                    given[c].push((r as u32, value));
                }
            }
        }
        let row_start = starts(given.iter().map(Vec::len));
        let mut entries = Vec::with_capacity(row_start[rows] as usize);
        let mut steps = Vec::new();
        let mut error = 0.0;
        for row in &mut given {
            row.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
            let most = row.iter().map(|entry| entry.1.abs()).fold(0.0, f32::max);
            let step = if most > 0.0 { most / f32::from(i16::MAX) } else { 1.0 };
            steps.push(step);
            for &(column, value) in row.iter() {
                let steps = scene::math::floor(value / step + 0.5);
                error += f64::from(value - steps * step).powi(2);
                entries.push(column | (steps as i32 as u32) << 16);
            }
        }
        Self { row_start, entries, steps, error }
    }
}

/// The dense sub-blocks of all rows, edge by edge.
struct DenseSubBlocks {
    pub start: Vec<u32>,
    pub sub_blocks: Vec<SubBlock>,
    pub words: Vec<u32>,
}

impl DenseSubBlocks {
    /// With `is_mirrored`, tiles above the diagonal also stand below it.
    pub fn pack(tiles: &[(usize, usize)], parts: &[Part], edges: usize, is_mirrored: bool) -> Self {
        let mut given: Vec<Vec<(SubBlock, Vec<u32>)>> = vec![Vec::new(); edges];
        for (&(i, j), part) in tiles.iter().zip(parts) {
            for DenseSubBlock { at, step, values } in &part.sub_blocks {
                let r = i * SIDE / EDGE + at.0;
                let c = j * SIDE / EDGE + at.1;
                let words = |element: &dyn Fn(usize, usize) -> i8| -> Vec<u32> {
                    let byte = |columns: usize, lane: usize, k: usize| {
                        u32::from(element(lane, 4 * columns + k / 2 + 2 * (k % 2)) as u8) << (8 * k)
                    };
                    let word = |columns: usize, lane: usize| (0..4).map(|k| byte(columns, lane, k)).sum();
                    (0..EDGE / 4).flat_map(|columns| (0..EDGE).map(move |lane| word(columns, lane))).collect()
                };
                let sub_block = |column: usize| SubBlock { column: column as u32, step: *step };
                given[r].push((sub_block(c), words(&|row, column| values[row * EDGE + column])));
                if is_mirrored && i != j {
                    given[c].push((sub_block(r), words(&|row, column| values[column * EDGE + row])));
                }
            }
        }
        let start = starts(given.iter().map(Vec::len));
        let mut sub_blocks = Vec::new();
        let mut words = Vec::new();
        for edge in &mut given {
            edge.sort_by_key(|(sub_block, _)| sub_block.column);
            for (sub_block, own) in edge.iter() {
                sub_blocks.push(*sub_block);
                words.extend_from_slice(own);
            }
        }
        Self { start, sub_blocks, words }
    }
}

/// The next λ to try: by the error's square, between what was too little and too much.
fn next_lambda(lambda: f32, error: f64, epsilon: f64, low: &mut f32, high: &mut f32) -> f32 {
    if error > epsilon {
        *high = high.min(lambda)
    } else {
        *low = low.max(lambda)
    }
    let aim = (1.0 + CLOSE) / 2.0 * epsilon;
    let step = if error > 0.0 { ((aim / error).powi(2) as f32).clamp(1e-3, 1e3) } else { 1e3 };
    let next = lambda * step;
    if next > *low && next < *high {
        next
    } else if *low > 0.0 {
        scene::math::sqrt(*low * *high)
    } else {
        lambda * 0.5
    }
}
