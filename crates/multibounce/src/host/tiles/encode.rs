//! From dense operators to tiles.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::vec::Vec;

use faer::{unzip, zip};
use glam::Vec4;
use rayon::prelude::*;
use scene::sampling::hash3;
use transport::{Proceed, check_length};

use super::reduce::{Component, EDGE, Part, Prices, SIDE, Square, reduce, squared_norm};
use super::source::{Source, twice};
use super::{Channels, MOST_TILE_PATCHES, TileReport, Tiles, places};
use crate::error::Error;
use crate::kernel::tiles::{ALL_CHANNELS, BIAS, LANES, NO_SLOT, QUAD, RUN_QUADS, SHORT_BIAS};
use crate::types::{TileQuad, TileSquare};

/// The error is at least this share of what was asked for, when it can be.
pub(super) const CLOSE: f64 = 0.85;
/// Times that λ is corrected.
pub(super) const MOST_ROUNDS: usize = 24;
/// Tiles from which on λ is first looked for with a part of them, and that part.
const MANY_TILES: usize = 512;
const PART: u32 = 8;

impl Tiles {
    /// Tiles of operators with a relative Frobenius error of at most `epsilon` in every channel; `area` are the patches' areas
    /// by which they are symmetric, `order` is one of [`crate::halving_order`]. `progress(done, total)` counts tiles of the
    /// last pass; breaking it cancels.
    ///
    /// # Errors
    /// [`transport::Error::Length`] for matrices of another size, [`transport::Error::Setting`] for an ε that is not in 10⁻⁶..1,
    /// [`transport::Error::Value`] for numbers that are not finite, [`transport::Error::TooMany`] patches, [`transport::Error::Cancelled`].
    pub fn encode(
        channels: Channels,
        area: &[f32],
        order: &[u32],
        epsilon: f64,
        progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
    ) -> Result<Self, Error> {
        let n = area.len();
        if n > MOST_TILE_PATCHES {
            return Err(transport::Error::TooMany {
                name: "patches",
                found: n as u64,
                limit: MOST_TILE_PATCHES as u64,
            }
            .into());
        }
        if !(1e-6..1.0).contains(&epsilon) {
            return Err(transport::Error::Setting {
                name: "epsilon",
                value: epsilon,
                rule: "at least 0.000001 and below 1",
            }
            .into());
        }
        let place = checked_places(area, order)?;
        let mut source = Source::new(channels, area, order, &place)?;
        let blocks = n.div_ceil(SIDE);
        let all: Vec<(usize, usize)> = (0..blocks).flat_map(|i| (i..blocks).map(move |j| (i, j))).collect();
        let some: Vec<(usize, usize)> = if all.len() < MANY_TILES {
            all.clone()
        } else {
            all.iter().copied().filter(|&(i, j)| hash3(i as u32, j as u32, 0).is_multiple_of(PART)).collect()
        };
        source.turn_axes(&some)?;
        let silent = |_: usize, _: usize| Proceed::Continue(());

        // λ from a part of the tiles first, then from all of them, each time a little less when it was too much.
        let all_norms = source.norms(&all)?;
        let mut lambda = ((epsilon * all_norms[1]).powi(2) / (0.03 * (n * n) as f64)).max(1e-30) as f32;
        let worst = |parts: &[Part], norms: [f64; 3]| -> f64 {
            let sum = |c: usize| parts.iter().map(|part| part.error[c]).sum::<f64>().sqrt();
            (0..3).filter(|&c| norms[c] > 0.0).map(|c| sum(c) / norms[c]).fold(0.0, f64::max)
        };
        // In the logarithm the error is about half of λ; what is known of both sides bounds the next try.
        let (mut low, mut high) = (0.0f32, f32::INFINITY);
        if some.len() < all.len() {
            let norms = source.norms(&some)?;
            for _ in 0..MOST_ROUNDS {
                let error = worst(&source.encode(&some, lambda, &silent)?, norms);
                if (CLOSE * epsilon..=epsilon).contains(&error) {
                    break;
                }
                lambda = next_lambda(lambda, error, epsilon, &mut low, &mut high);
            }
            (low, high) = (0.0, f32::INFINITY);
        }
        let norms = all_norms;
        let mut best = None;
        for round in 0..MOST_ROUNDS {
            let parts = source.encode(&all, lambda, progress)?;
            let rows = Rows::pack(&all, &parts, blocks * SIDE, true);
            // Entries for all channels are rounded alike in all of them.
            let least = norms.iter().copied().filter(|&x| x > 0.0).fold(f64::INFINITY, f64::min);
            let error = (worst(&parts, norms).powi(2) + rows.error / (least * least)).sqrt();
            let good = error <= epsilon;
            if good {
                best = Some((parts, rows));
            }
            // What is good stays good enough when trying again takes long.
            if good && (error >= CLOSE * epsilon || round > 0 || all.len() >= MANY_TILES) {
                break;
            }
            lambda = next_lambda(lambda, error, epsilon, &mut low, &mut high);
        }
        let Some((parts, rows)) = best else {
            return Err(transport::Error::Setting {
                name: "epsilon",
                value: epsilon,
                rule: "more: single precision cannot give it",
            }
            .into());
        };
        let [first, second] = source.axes;
        let tables = Self {
            order: order.to_vec(),
            place,
            root: area.iter().map(|&a| scene::math::sqrt(a)).collect(),
            axes: Vec4::new(first[0], first[1], second[0], second[1]),
            ..Self::default()
        };
        Ok(tables.assemble(&all, parts, rows, norms))
    }

    /// Tables from the tiles' parts.
    fn assemble(self, tiles: &[(usize, usize)], parts: Vec<Part>, rows: Rows, norms: [f64; 3]) -> Self {
        let blocks = self.blocks();
        let mut report = TileReport::default();
        let squares = Squares::pack(tiles, &parts, blocks * SIDE / EDGE, true);
        // Vectors of the blocks: component, side, and what makes them alike.
        let mut vectors: Vec<Vec<Vector>> = vec![Vec::new(); blocks];
        let mut components: Vec<&Component> = Vec::new();
        for (&(i, j), part) in tiles.iter().zip(&parts) {
            report.add(part);
            for component in &part.components {
                let alike = (component.color, component.is_short);
                let vector = |side, is_multiplied| Vector { alike, is_multiplied, component: components.len(), side };
                vectors[i].push(vector(0, true));
                // A tile on the diagonal is whole: its second vectors only make sums.
                vectors[j].push(vector(1, i != j));
                components.push(component);
            }
        }
        for (error, norm) in report.error.iter_mut().zip(norms) {
            *error = if norm > 0.0 { (*error + rows.error).sqrt() / norm } else { 0.0 };
        }
        let Bank { run_start, runs, quads, words, slots } =
            Bank::new(&mut vectors, |vector| &components[vector.component].words[vector.side]);
        let scale = slots.iter().map(|slot| slot.map_or(0.0, |vector| components[vector.component].scale)).collect();
        let mut slot_of = vec![[NO_SLOT; 2]; components.len()];
        for (slot, vector) in (0u32..).zip(&slots) {
            if let Some(vector) = vector {
                slot_of[vector.component][vector.side] = slot;
            }
        }
        let partner = |slot: &Option<&Vector>| match slot {
            Some(vector) if vector.is_multiplied => slot_of[vector.component][1 - vector.side],
            _ => NO_SLOT,
        };
        let partner = slots.iter().map(partner).collect();
        let Rows { row_start, entries, steps, .. } = rows;
        Self {
            run_start,
            runs,
            quads,
            words,
            scale,
            partner,
            square_start: squares.start,
            squares: squares.squares,
            square_words: squares.words,
            row_start,
            entries,
            steps,
            report,
            ..self
        }
    }
}

impl TileReport {
    /// Counts a tile.
    pub(super) fn add(&mut self, part: &Part) {
        let kind = if !part.components.is_empty() {
            2
        } else {
            usize::from(!(part.entries.is_empty() && part.squares.is_empty()))
        };
        self.tiles[kind] += 1;
        self.most_rank = self.most_rank.max(part.components.len());
        self.entries += part.entries.len();
        self.squares += part.squares.len();
        for (sum, error) in self.error.iter_mut().zip(part.error) {
            *sum += error;
        }
        for component in &part.components {
            self.components[usize::from(component.color != ALL_CHANNELS)] += 1;
        }
    }
}

/// Place of each number, by an order of as many as there are areas.
pub(super) fn checked_places(area: &[f32], order: &[u32]) -> Result<Vec<u32>, Error> {
    check_length("order", area.len(), order.len())?;
    if let Some(index) = area.iter().position(|a| !(a.is_finite() && *a > 0.0)) {
        return Err(
            transport::Error::Value { name: "area", index, value: f64::from(area[index]), rule: "positive" }.into()
        );
    }
    places(order)
}

/// A vector of a component.
#[derive(Clone)]
pub(super) struct Vector {
    /// The channels that it is for, and whether elements are short.
    pub alike: (u32, bool),
    /// Whether it is multiplied by the sum of the other.
    pub is_multiplied: bool,
    pub component: usize,
    /// Along the rows or along the columns.
    pub side: usize,
}

/// Vectors block by block, alike ones together, by fours.
pub(super) struct Bank<'a> {
    pub run_start: Vec<u32>,
    pub runs: Vec<u32>,
    pub quads: Vec<TileQuad>,
    pub words: Vec<u32>,
    /// Vector of each slot; none where zeros fill up.
    pub slots: Vec<Option<&'a Vector>>,
}

impl<'a> Bank<'a> {
    /// Of the vectors of each block, whose groups of words are given.
    pub fn new<'b>(vectors: &'a mut [Vec<Vector>], words_of: impl Fn(&Vector) -> &'b [u32]) -> Self {
        let (mut quads, mut words) = (Vec::new(), Vec::new());
        let (mut runs, mut run_start) = (Vec::new(), vec![0]);
        let mut slots: Vec<Option<&Vector>> = Vec::new();
        for (block, vectors) in (0u32..).zip(vectors) {
            vectors.sort_by_key(|vector| (vector.alike, vector.is_multiplied));
            for alike in vectors.chunk_by(|a, b| a.alike == b.alike) {
                let (color, is_short) = alike[0].alike;
                for (k, four) in alike.chunks(QUAD as usize).enumerate() {
                    if k.is_multiple_of(RUN_QUADS as usize) {
                        runs.push(quads.len() as u32);
                    }
                    let quad = TileQuad::new(words.len() as u32 / LANES, block, color, is_short);
                    for vector in four {
                        words.extend_from_slice(words_of(vector));
                    }
                    slots.extend(four.iter().map(Some));
                    slots.resize(slots.len().next_multiple_of(QUAD as usize), None);
                    quads.push(quad);
                    let zero = if is_short { ZERO_SHORT } else { ZERO_LONG };
                    words.resize(((quad.group + QUAD * quad.groups()) * LANES) as usize, zero);
                }
            }
            run_start.push(runs.len() as u32);
        }
        runs.push(quads.len() as u32);
        Self { run_start, runs, quads, words, slots }
    }
}

/// Words of elements that are zero, of 4 and of 8 bits.
const ZERO_SHORT: u32 = 0x1111_1111 * SHORT_BIAS as u32;
const ZERO_LONG: u32 = 0x0101_0101 * BIAS as u32;

/// Where each of these begins, and where the last ends.
pub(super) fn starts(lengths: impl Iterator<Item = usize>) -> Vec<u32> {
    let mut starts = vec![0u32];
    for (k, length) in lengths.enumerate() {
        starts.push(starts[k] + length as u32);
    }
    starts
}

/// The single entries of all rows.
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
                let (r, c) = (i * SIDE + r as usize, j * SIDE + c as usize);
                given[r].push((c as u32, value));
                if is_mirrored && i != j {
                    given[c].push((r as u32, value));
                }
            }
        }
        let row_start = starts(given.iter().map(Vec::len));
        let (mut entries, mut steps, mut error) = (Vec::with_capacity(row_start[rows] as usize), Vec::new(), 0.0);
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

/// The squares of all rows, edge by edge.
pub(super) struct Squares {
    pub start: Vec<u32>,
    pub squares: Vec<TileSquare>,
    pub words: Vec<u32>,
}

impl Squares {
    /// With `is_mirrored`, tiles above the diagonal also stand below it.
    pub fn pack(tiles: &[(usize, usize)], parts: &[Part], edges: usize, is_mirrored: bool) -> Self {
        let mut given: Vec<Vec<(TileSquare, Vec<u32>)>> = vec![Vec::new(); edges];
        for (&(i, j), part) in tiles.iter().zip(parts) {
            for Square { at, step, values } in &part.squares {
                let (r, c) = (i * SIDE / EDGE + at.0, j * SIDE / EDGE + at.1);
                let words = |element: &dyn Fn(usize, usize) -> i8| -> Vec<u32> {
                    let byte = |group: usize, lane: usize, k: usize| {
                        u32::from(element(lane, 4 * group + k / 2 + 2 * (k % 2)) as u8) << (8 * k)
                    };
                    let word = |group: usize, lane: usize| (0..4).map(|k| byte(group, lane, k)).sum();
                    (0..EDGE / 4).flat_map(|group| (0..EDGE).map(move |lane| word(group, lane))).collect()
                };
                let square = |column: usize| TileSquare { column: column as u32, step: *step };
                given[r].push((square(c), words(&|row, column| values[row * EDGE + column])));
                if is_mirrored && i != j {
                    given[c].push((square(r), words(&|row, column| values[column * EDGE + row])));
                }
            }
        }
        let start = starts(given.iter().map(Vec::len));
        let (mut squares, mut words) = (Vec::new(), Vec::new());
        for edge in &mut given {
            edge.sort_by_key(|(square, _)| square.column);
            for (square, own) in edge.iter() {
                squares.push(*square);
                words.extend_from_slice(own);
            }
        }
        Self { start, squares, words }
    }
}

/// The next λ to try: by the error's square, between what was too little and too much.
pub(super) fn next_lambda(lambda: f32, error: f64, epsilon: f64, low: &mut f32, high: &mut f32) -> f32 {
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

impl Source<'_> {
    fn encode(
        &self,
        tiles: &[(usize, usize)],
        lambda: f32,
        progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
    ) -> Result<Vec<Part>, Error> {
        let (done, total) = (AtomicUsize::new(0), tiles.len());
        let work = |&at: &(usize, usize)| {
            let part = match self.part(at, lambda) {
                Ok(part) => part,
                Err(error) => return Some(Err(error)),
            };
            let count = done.fetch_add(1, Ordering::Relaxed) + 1;
            (!progress(count, total).is_break()).then_some(Ok(part))
        };
        let parts: Option<Result<Vec<Part>, Error>> = tiles.par_iter().map(work).collect();
        parts.ok_or_else(|| transport::Error::Cancelled { done: done.load(Ordering::Relaxed), total })?
    }

    fn part(&self, at: (usize, usize), lambda: f32) -> Result<Part, Error> {
        let (mut part, prices) = (Part::default(), Prices { lambda, ..Prices::SYMMETRIC });
        let weights = (&self.weights[at.0], &self.weights[at.1]);
        let mut planes = self.planes(at)?;
        for (plane, color) in planes.iter_mut().zip([ALL_CHANNELS, 0, 1]) {
            reduce(plane, weights, &prices, color, &mut part);
        }
        part.error = [squared_norm(&planes[0]); 3];
        if let [common, first, second] = &planes[..] {
            let [one, other] = self.axes;
            for (channel, a, b) in [(0, one[0], other[0]), (2, one[1], other[1])] {
                let rest = zip!(common, first, second).map(|unzip!(common, x, y)| common + a * x + b * y);
                part.error[channel] = squared_norm(&rest);
            }
        }
        part.error = part.error.map(|error| twice(at) * error);
        Ok(part)
    }
}
