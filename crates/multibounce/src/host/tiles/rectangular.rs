//! Operators from few senders to many receivers, in tiles.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::vec::Vec;

use faer::Mat;
use glam::Vec4;
use rayon::prelude::*;
use scene::sampling::hash3;
use transport::{LinearOperator, Proceed, check_length};

use super::encode::{Bank, CLOSE, MOST_ROUNDS, Rows, Squares, Vector, checked_places, next_lambda};
use super::near::{NearTables, near_block};
use super::product::{ExpandTables, ProjectTables, Sums, add_rows, enter_all, leave_places, project_all, round_all};
use super::reduce::{Component, Part, Prices, SIDE, Weights, reduce, squared_norm};
use super::{MOST_TILE_PATCHES, TileReport, check_bank, check_below, check_finite, check_root};
use crate::error::Error;
use crate::kernel::tiles::{ALL_CHANNELS, LIGHT_WORDS, NO_SLOT, PARTS, PLACES, QUAD};
use crate::types::{TileQuad, TileSquare};

/// Most receivers: vectors name blocks by 16 bits.
pub const MOST_TILE_RECEIVERS: usize = SIDE << 16;
/// Blocks of rows from which on λ is first looked for with a part of them, and that part.
const MANY_BLOCKS: usize = 64;
const PART: u32 = 16;
/// The rows of a rectangular operator: calls the function with each column of this row, and its value. A column may come more
/// than once.
pub type SparseRows<'a> = dyn Fn(usize, &mut dyn FnMut(u32, f32)) + Sync + 'a;

/// One side of a rectangular operator.
#[derive(Clone, Copy, Debug)]
pub struct TileSide<'a> {
    /// Area that each element stands for, m².
    pub area: &'a [f32],
    /// Element at each place of an order in which neighbours are alike ([`crate::halving_order`]).
    pub order: &'a [u32],
}

/// The operator of few senders j and many receivers i, `H = F_r B`, in tiles: `F̂ = a_r^½ F_r a_s^-½` is cut into tiles of
/// [`crate::kernel::tiles::TILE`] rows and columns, `F̂ ≈ Σ_k u_k s_k v_kᵀ + D + S`, as [`crate::Tiles`] are: each tile is the sum of a few pairs of
/// vectors of 4 or 8 bits, of dense squares of 8 bits and of single entries of 16 bits, by what each takes from the squared
/// error for its bytes.
///
/// Errors that are even over neighbouring senders are weighted when components are found, because light adds them up; errors
/// of neighbouring receivers are not, because nothing does. One channel serves all colours of the exitance.
///
/// The vectors of the senders make sums ([`crate::project_all`]), by which those of the receivers are multiplied
/// ([`crate::expand_all`]): the same kernels as for [`crate::Tiles`], with tables of either side.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RectangularTiles {
    /// Sender at each place of the order.
    pub sender_order: Vec<u32>,
    /// `√a` of each sender, m.
    pub sender_root: Vec<f32>,
    /// Place of each receiver.
    pub place: Vec<u32>,
    /// `√a` of each receiver, m.
    pub root: Vec<f32>,
    /// First quad of each of the senders' runs, which are alike, and their end.
    pub sender_runs: Vec<u32>,
    /// The senders' vectors by fours: slot `4 k + m` is vector m of quad k.
    pub sender_quads: Vec<TileQuad>,
    /// Their elements, in groups of [`crate::kernel::tiles::LANES`] words.
    pub sender_words: Vec<u32>,
    /// What the sum of each of their slots is multiplied by.
    pub scale: Vec<f32>,
    /// Runs of the receivers' block b: `run_start[b]..run_start[b + 1]`.
    pub run_start: Vec<u32>,
    /// Quads of run k, which are alike: `quads[runs[k]..runs[k + 1]]`, at most [`crate::kernel::tiles::RUN_QUADS`].
    pub runs: Vec<u32>,
    /// The receivers' vectors by fours, block by block, alike ones together; where there are no four, zeros fill up.
    pub quads: Vec<TileQuad>,
    /// Their elements, in groups of [`crate::kernel::tiles::LANES`] words.
    pub words: Vec<u32>,
    /// The senders' slot by whose sum each of their slots is multiplied; [`NO_SLOT`] where that is done by none.
    pub partner: Vec<u32>,
    /// Squares of each [`crate::kernel::tiles::LANES`] receivers' places: `square_start[k]..square_start[k + 1]`.
    pub square_start: Vec<u32>,
    /// Dense squares.
    pub squares: Vec<TileSquare>,
    /// Their elements of 8 bits, [`crate::kernel::tiles::SQUARE_WORDS`] each.
    pub square_words: Vec<u32>,
    /// Entries of each receiver's place, `[blocks · TILE + 1]`.
    pub row_start: Vec<u32>,
    /// Sender's place in the lower 16 bits, value in the upper.
    pub entries: Vec<u32>,
    /// Step of the values of each receiver's place.
    pub steps: Vec<f32>,
    /// What was lost; the three channels are the same.
    pub report: TileReport,
}

/// What a product keeps between its steps: one for products one after another.
#[derive(Clone, Debug, Default)]
pub struct RectangularRoom {
    ordered: Vec<Vec4>,
    light: Vec<u32>,
    sums: Vec<Vec4>,
    placed: Vec<Vec4>,
}

/// The operator block by block.
struct Source<'a> {
    rows: &'a SparseRows<'a>,
    receivers: TileSide<'a>,
    /// `√a` of the receivers, `1 / √a` of the senders.
    roots: [Vec<f32>; 2],
    /// Place of each sender.
    place: &'a [u32],
    even: Weights,
    /// Of each block of senders.
    light: Vec<Weights>,
}

/// Entries of a tile: row, column, value.
type Entries = Vec<(u8, u8, f32)>;

/// What a block of rows becomes: blocks of columns with what they become.
struct BlockRow {
    parts: Vec<(usize, Part)>,
    /// Squared norm.
    norm: f64,
}

impl Source<'_> {
    fn blocks(&self) -> usize {
        self.receivers.order.len().div_ceil(SIDE)
    }

    /// The entries of a block of rows, tile by tile: row and column in the tile, value.
    fn entries(&self, block: usize) -> Result<Vec<Entries>, Error> {
        let mut tiles = vec![Vec::new(); self.light.len()];
        let mut wrong = None;
        for (r, &i) in self.receivers.order.iter().skip(block * SIDE).take(SIDE).enumerate() {
            let root = self.roots[0][i as usize];
            (self.rows)(i as usize, &mut |column, value| match self.place.get(column as usize) {
                Some(&place) if value.is_finite() => {
                    let value = value * (root * self.roots[1][column as usize]);
                    tiles[place as usize / SIDE].push((r as u8, (place as usize % SIDE) as u8, value));
                }
                Some(_) => wrong = Some(("values", i, f64::from(value), "finite")),
                None => wrong = Some(("columns", i, f64::from(column), "a sender")),
            });
        }
        match wrong {
            Some((name, index, value, rule)) => {
                Err(transport::Error::Value { name, index: index as usize, value, rule }.into())
            }
            None => Ok(tiles),
        }
    }

    fn encode(&self, block: usize, prices: &Prices) -> Result<BlockRow, Error> {
        let (mut parts, mut whole) = (Vec::new(), 0.0);
        for (j, entries) in self.entries(block)?.into_iter().enumerate() {
            if !entries.is_empty() {
                let mut tile = dense(&entries);
                whole += squared_norm(&tile);
                let mut part = Part::default();
                reduce(&mut tile, (&self.even, &self.light[j]), prices, ALL_CHANNELS, &mut part);
                parts.push((j, Part { error: [squared_norm(&tile); 3], ..part }));
            }
        }
        Ok(BlockRow { parts, norm: whole })
    }

    /// Squared norm of some blocks of rows.
    fn norm(&self, blocks: &[usize]) -> Result<f64, Error> {
        let square = |entries: &Entries| squared_norm(&dense(entries));
        let of = |&block: &usize| Ok(self.entries(block)?.iter().map(square).sum::<f64>());
        Ok(blocks.par_iter().map(of).collect::<Result<Vec<f64>, Error>>()?.iter().sum())
    }

    fn encode_all(
        &self,
        blocks: &[usize],
        lambda: f32,
        progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
    ) -> Result<Vec<BlockRow>, Error> {
        let prices = Prices { lambda, ..Prices::RECTANGULAR };
        let (done, total) = (AtomicUsize::new(0), blocks.len());
        let cancelled = |done: usize| Err(transport::Error::Cancelled { done, total }.into());
        let work = |&block: &usize| {
            let row = self.encode(block, &prices)?;
            let count = done.fetch_add(1, Ordering::Relaxed) + 1;
            if progress(count, total).is_break() { cancelled(count) } else { Ok(row) }
        };
        blocks.par_iter().with_max_len(1).map(work).collect()
    }
}

/// A tile from its entries.
fn dense(entries: &[(u8, u8, f32)]) -> Mat<f32> {
    let mut tile = Mat::zeros(SIDE, SIDE);
    entries.iter().for_each(|&(r, c, value)| tile[(r as usize, c as usize)] += value);
    tile
}

/// Relative error of some blocks of rows.
fn relative_error(rows: &[BlockRow]) -> f64 {
    let norm: f64 = rows.iter().map(|row| row.norm).sum();
    let error: f64 = rows.iter().flat_map(|row| &row.parts).map(|part| part.1.error[0]).sum();
    if norm > 0.0 { (error / norm).sqrt() } else { 0.0 }
}

/// Irradiance `H = F_r B` of the receivers, W/m². The fourth component is 0.
impl LinearOperator for RectangularTiles {
    fn shape(&self) -> (usize, usize) {
        (self.receivers(), self.senders())
    }

    fn bytes(&self) -> u64 {
        self.bytes_by_part().iter().map(|part| part.1).sum()
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), transport::Error> {
        self.apply_in(&mut RectangularRoom::default(), exitance, irradiance)
    }
}

impl RectangularTiles {
    /// Tiles of the operator with these rows, with a relative Frobenius error of F̂ of at most `epsilon`.
    ///
    /// Rows are asked for block by block, more than once and on all cores, so that they need not be in memory as a matrix.
    /// `progress(done, total)` counts blocks of rows of the last pass, none while λ is looked for; breaking it cancels.
    ///
    /// # Errors
    /// [`transport::Error::Length`] of an order, [`transport::Error::Setting`] for an ε that is not in 10⁻⁶..1, [`transport::Error::Value`] for an order that is
    /// none, an area that is not positive, a column or a value that is none, [`transport::Error::TooMany`] senders or receivers,
    /// [`transport::Error::Cancelled`].
    pub fn encode(
        rows: &SparseRows,
        receivers: TileSide,
        senders: TileSide,
        epsilon: f64,
        progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
    ) -> Result<Self, Error> {
        let too_many = |name, found: usize, limit: usize| match found > limit {
            true => Err(transport::Error::TooMany { name, found: found as u64, limit: limit as u64 }),
            false => Ok(()),
        };
        too_many("senders", senders.area.len(), MOST_TILE_PATCHES)?;
        too_many("receivers", receivers.area.len(), MOST_TILE_RECEIVERS)?;
        if !(1e-6..1.0).contains(&epsilon) {
            return Err(transport::Error::Setting {
                name: "epsilon",
                value: epsilon,
                rule: "at least 0.000001 and below 1",
            }
            .into());
        }
        let (place, sender_place) =
            (checked_places(receivers.area, receivers.order)?, checked_places(senders.area, senders.order)?);
        let root = |side: TileSide| -> Vec<f32> { side.area.iter().map(|&a| scene::math::sqrt(a)).collect() };
        let (row_root, column_root) = (root(receivers), root(senders));
        let light =
            |block: &[u32]| Weights::of_light(&block.iter().map(|&j| column_root[j as usize]).collect::<Vec<f32>>());
        let source = Source {
            rows,
            receivers,
            roots: [row_root.clone(), column_root.iter().map(|r| 1.0 / r).collect()],
            place: &sender_place,
            even: Weights::even(),
            light: senders.order.chunks(SIDE).map(light).collect(),
        };
        let all: Vec<usize> = (0..source.blocks()).collect();
        let is_some = |b: &usize| all.len() < MANY_BLOCKS || hash3(*b as u32, 0, 0).is_multiple_of(PART);
        let some: Vec<usize> = all.iter().copied().filter(is_some).collect();
        let search = |_: usize, _: usize| progress(0, all.len());

        // λ from a part of the rows first, then from all of them, each time a little less when it was too much.
        let norm = source.norm(&some)?;
        let tiles = (some.len() * SIDE * senders.area.len()).max(1) as f64;
        let mut lambda = (epsilon * epsilon * norm / (0.03 * tiles)).max(1e-30) as f32;
        let (mut low, mut high) = (0.0f32, f32::INFINITY);
        if some.len() < all.len() {
            for _ in 0..MOST_ROUNDS {
                let error = relative_error(&source.encode_all(&some, lambda, &search)?);
                if (CLOSE * epsilon..=epsilon).contains(&error) {
                    break;
                }
                lambda = next_lambda(lambda, error, epsilon, &mut low, &mut high);
            }
            (low, high) = (0.0, f32::INFINITY);
        }
        let mut best = None;
        for round in 0..MOST_ROUNDS {
            let made = source.encode_all(&all, lambda, progress)?;
            let norm: f64 = made.iter().map(|row| row.norm).sum();
            let (mut at, mut parts) = (Vec::new(), Vec::new());
            for (i, row) in made.into_iter().enumerate() {
                at.extend(row.parts.iter().map(|part| (i, part.0)));
                parts.extend(row.parts.into_iter().map(|part| part.1));
            }
            let packed = Rows::pack(&at, &parts, all.len() * SIDE, false);
            let lost: f64 = parts.iter().map(|part| part.error[0]).sum::<f64>() + packed.error;
            let error = if norm > 0.0 { (lost / norm).sqrt() } else { 0.0 };
            let good = error <= epsilon;
            if good {
                best = Some((at, parts, packed, error));
            }
            // What is good stays good enough when trying again takes long.
            if good && (error >= CLOSE * epsilon || round > 0 || all.len() >= MANY_BLOCKS) {
                break;
            }
            lambda = next_lambda(lambda, error, epsilon, &mut low, &mut high);
        }
        let Some((at, parts, packed, error)) = best else {
            let rule = "more: single precision cannot give it";
            return Err(transport::Error::Setting { name: "epsilon", value: epsilon, rule }.into());
        };
        let tables = Self {
            sender_order: senders.order.to_vec(),
            sender_root: column_root,
            place,
            root: row_root,
            row_start: packed.row_start,
            entries: packed.entries,
            steps: packed.steps,
            ..Self::default()
        };
        Ok(tables.assemble(&at, &parts, error))
    }

    /// Vectors and squares from the tiles' parts.
    fn assemble(self, at: &[(usize, usize)], parts: &[Part], error: f64) -> Self {
        let mut report = TileReport::default();
        let squares = Squares::pack(at, parts, self.blocks() * PARTS as usize, false);
        let mut rows: Vec<Vec<Vector>> = vec![Vec::new(); self.blocks()];
        let mut columns: Vec<Vec<Vector>> = vec![Vec::new(); self.sender_blocks()];
        let components: Vec<&Component> = parts.iter().flat_map(|part| &part.components).collect();
        let mut own = 0..components.len();
        for (&(i, j), part) in at.iter().zip(parts) {
            report.add(part);
            for (component, number) in part.components.iter().zip(&mut own) {
                let alike = (component.color, component.is_short);
                let vector = |side| Vector { alike, is_multiplied: side == 0, component: number, side };
                rows[i].push(vector(0));
                columns[j].push(vector(1));
            }
        }
        report.tiles[0] += self.blocks() * self.sender_blocks() - at.len();
        report.error = [error; 3];
        let rows = Bank::new(&mut rows, |vector| &components[vector.component].words[0]);
        let columns = Bank::new(&mut columns, |vector| &components[vector.component].words[1]);
        let scale = |slot: &Option<&Vector>| slot.map_or(0.0, |vector| components[vector.component].scale);
        let mut slot_of = vec![NO_SLOT; components.len()];
        for (slot, vector) in (0u32..).zip(&columns.slots) {
            if let Some(vector) = vector {
                slot_of[vector.component] = slot;
            }
        }
        let partner = |slot: &Option<&Vector>| slot.map_or(NO_SLOT, |vector| slot_of[vector.component]);
        Self {
            scale: columns.slots.iter().map(scale).collect(),
            sender_runs: columns.runs,
            sender_quads: columns.quads,
            sender_words: columns.words,
            partner: rows.slots.iter().map(partner).collect(),
            run_start: rows.run_start,
            runs: rows.runs,
            quads: rows.quads,
            words: rows.words,
            square_start: squares.start,
            squares: squares.squares,
            square_words: squares.words,
            report,
            ..self
        }
    }

    /// Number of receivers.
    pub fn receivers(&self) -> usize {
        self.place.len()
    }

    /// Number of senders.
    pub fn senders(&self) -> usize {
        self.sender_order.len()
    }

    /// Blocks of [`crate::kernel::tiles::TILE`] receivers.
    pub fn blocks(&self) -> usize {
        self.place.len().div_ceil(SIDE)
    }

    /// Blocks of [`crate::kernel::tiles::TILE`] senders.
    pub fn sender_blocks(&self) -> usize {
        self.sender_order.len().div_ceil(SIDE)
    }

    /// Bytes of each part that a product reads.
    pub fn bytes_by_part(&self) -> [(&'static str, u64); 4] {
        let senders = size_of_val(&self.sender_runs[..])
            + size_of_val(&self.sender_quads[..])
            + size_of_val(&self.sender_words[..]);
        let slots = size_of_val(&self.scale[..]) + size_of_val(&self.partner[..]);
        let vectors = senders + self.expand_tables().bytes() + slots;
        let [squares, entries] = self.near_tables().bytes();
        let places = size_of_val(&self.sender_order[..])
            + size_of_val(&self.sender_root[..])
            + size_of_val(&self.place[..])
            + size_of_val(&self.root[..]);
        [
            ("vectors", vectors as u64),
            ("squares", squares as u64),
            ("entries", entries as u64),
            ("places", places as u64),
        ]
    }

    /// Whether the tables belong together, so that no product reads beyond them.
    ///
    /// # Errors
    /// [`transport::Error::Length`], [`transport::Error::Value`], naming the table and the entry.
    pub fn check(&self) -> Result<(), Error> {
        check_length("root", self.receivers(), self.root.len())?;
        check_length("sender_root", self.senders(), self.sender_root.len())?;
        check_bank(&self.sender_runs, &self.sender_quads, &self.sender_words, self.sender_blocks())?;
        let slots = [&self.sender_quads, &self.quads].map(|quads| QUAD as usize * quads.len());
        check_length("scale", slots[0], self.scale.len())?;
        check_length("partner", slots[1], self.partner.len())?;
        self.expand_tables().check(self.blocks())?;
        self.near_tables().check(self.blocks(), self.sender_blocks())?;
        check_below("sender_order", self.sender_order.iter().copied(), self.senders())?;
        check_below("place", self.place.iter().copied(), self.receivers())?;
        let partners = self.partner.iter().map(|&slot| if slot == NO_SLOT { 0 } else { slot });
        check_below("partner", partners, slots[0].max(usize::from(slots[1] > 0)))?;
        check_finite("scale", self.scale.iter().copied())?;
        check_root("root", &self.root)?;
        check_root("sender_root", &self.sender_root)
    }

    /// As [`LinearOperator::apply`], in memory that is kept from product to product.
    ///
    /// # Errors
    /// [`transport::Error::Length`] unless there is one exitance a patch that sends, and one irradiance a receiver.
    pub fn apply_in(
        &self,
        room: &mut RectangularRoom,
        exitance: &[Vec4],
        irradiance: &mut [Vec4],
    ) -> Result<(), transport::Error> {
        self.check_vectors(exitance, irradiance)?;
        let RectangularRoom { ordered, light, sums, placed } = room;
        let columns = self.sender_blocks() * SIDE;
        ordered.resize(PLACES, Vec4::ZERO);
        light.resize(self.sender_blocks() * LIGHT_WORDS as usize, 0);
        sums.resize(self.scale.len(), Vec4::ZERO);
        enter_all(&self.sender_order, &self.sender_root, exitance, &mut ordered[..columns]);
        round_all(&ordered[..columns], light);
        project_all(&self.project_tables(), light, sums);
        let found = ordered.len();
        let ordered =
            ordered.first_chunk().ok_or(transport::Error::Length { name: "ordered", expected: PLACES, found })?;
        // Receivers that stand in their order are written where they belong at once.
        let is_ordered = self.place.iter().zip(0..).all(|(&place, i)| place == i);
        if is_ordered {
            self.rows(light, ordered, sums, irradiance, |p| self.root[p]);
        } else {
            placed.resize(self.receivers(), Vec4::ZERO);
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
        let (expand, near) = (self.expand_tables(), self.near_tables());
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

    /// The tables of [`project_all`].
    pub fn project_tables(&self) -> ProjectTables<'_> {
        ProjectTables { axes: Vec4::ZERO, quads: &self.sender_quads, words: &self.sender_words, scale: &self.scale }
    }

    /// The tables of [`crate::expand_all`].
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
