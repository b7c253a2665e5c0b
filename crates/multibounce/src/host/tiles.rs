//! Operators in tiles of low rank, dense squares and single entries.

mod encode;
mod lanes;
mod near;
mod product;
mod rectangular;
mod reduce;
mod source;
mod symmetric;

use std::vec::Vec;

use faer::Mat;
use glam::Vec4;
use transport::check_length;

use crate::error::Error;
use crate::host::solve::Factors;
use crate::host::stored::StoredOperator;
use crate::kernel::tiles::{LANES, NO_SLOT, PLACES, QUAD, RUN_QUADS, SQUARE_WORDS, TILE};
use crate::types::{TileQuad, TileSquare};

pub(super) use reduce::SIDE;

pub use near::{NearTables, near_all};
pub use product::{
    ExpandTables, LowRankWorkspace, ProjectTables, enter_all, expand_all, leave_all, project_all, round_all, weigh_all,
};
pub use rectangular::SparseRows;

/// Most patches: entries name columns by 16 bits.
pub const MOST_TILE_PATCHES: usize = PLACES - TILE as usize;

/// Most receivers: vectors name blocks by 16 bits.
pub const MOST_TILE_RECEIVERS: usize = SIDE << 16;

/// The rows or the columns of an operator.
#[derive(Clone, Copy, Debug)]
pub struct TileSide<'a> {
    /// Area that each of them stands for, m².
    pub area: &'a [f32],
    /// Which of them is at each place of an order in which neighbours are alike ([`crate::halving_order`]).
    pub order: &'a [u32],
}

/// What [`LowRank::encode`] brings into tiles.
#[derive(Clone, Copy)]
pub enum TileSource<'a> {
    /// Operators that are symmetric by the areas of the patches, which are both rows and columns.
    Symmetric {
        /// The operators of the colour channels.
        channels: Channels<'a>,
        /// Their rows and columns.
        patches: TileSide<'a>,
    },
    /// The rows of any operator, one channel for all colours.
    Rows {
        /// Columns and values of each row.
        rows: &'a SparseRows<'a>,
        /// The rows: where irradiance is wanted.
        receivers: TileSide<'a>,
        /// The columns: what sends light.
        senders: TileSide<'a>,
    },
}

/// The symmetric operators of the colour channels, `T̂ = a^½ T a^-½`.
#[derive(Clone, Copy, Debug)]
pub enum Channels<'a> {
    /// One for all three: form factors.
    One(&'a Mat<f32>),
    /// Red, green, blue.
    Three([&'a Mat<f32>; 3]),
    /// Red, green, blue in files that have the order of the tiles: a tile of them is held at a time.
    Stored([&'a StoredOperator; 3]),
    /// One for all three, of reciprocal form factors: no dense matrix is made.
    Factors(Factors<'a>),
}

/// An operator from columns j that send light to rows i that receive it, `H = T B`, as
/// `T̂ = a_r^½ T a_c^-½ ≈ Σ_k u_k s_k v_kᵀ + D + S` with the areas a of rows and columns. It is cut
/// into tiles of [`TILE`] rows and columns, each the sum of a few pairs of vectors of 4 or 8 bits,
/// of dense squares of 8 bits and of single entries of 16 bits; a tile may have none of them.
///
/// A component is kept when it takes more from the squared error than λ times its bytes, squares
/// and entries likewise, and λ is found so that the whole has the error that was asked for. Errors
/// that are even over neighbouring columns are weighted by the cube root of their extent when
/// components are found: light is even over neighbours and adds them up. So the error of the
/// entries is not the least that so many bytes can have, but that of irradiance is about half of
/// what it then would be.
///
/// *Symmetric* operators, whose rows and columns are the same patches, have the upper triangle of
/// tiles only, and every pair of vectors serves both ways: `columns` is `None`. Their three colour
/// channels share what they have in common: green is the common part. Red and blue are stored as
/// differences to it, which have far fewer components, because the light that arrives directly is
/// the same, and which are turned so that the first of their two axes has most of both: where walls
/// are of one hue, red and blue differ from green alike.
///
/// The vectors of the columns make sums ([`crate::project_all`]), by which those of the rows are
/// multiplied ([`crate::expand_all`]).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LowRank {
    /// Column at each place of the columns' order.
    pub order: Vec<u32>,
    /// Place of each row.
    pub place: Vec<u32>,
    /// `√a` of each row, m.
    pub root: Vec<f32>,
    /// Runs of the rows' block b: `run_start[b]..run_start[b + 1]`.
    pub run_start: Vec<u32>,
    /// Quads of run k, which are alike: `quads[runs[k]..runs[k + 1]]`, at most [`RUN_QUADS`].
    pub runs: Vec<u32>,
    /// The rows' vectors by fours, block by block, alike ones together; where there are no four,
    /// zeros fill up. Slot `4 k + m` is vector m of quad k.
    pub quads: Vec<TileQuad>,
    /// Elements of the rows' vectors, in groups of [`LANES`] words.
    pub words: Vec<u32>,
    /// What the columns have of their own, or `None` where they are the rows.
    pub columns: Option<ColumnVectors>,
    /// Red and blue of the first axis of the differences, then of the second,
    /// [`crate::kernel::tiles::tint`].
    pub axes: Vec4,
    /// What the sum of each slot of the columns is multiplied by.
    pub scale: Vec<f32>,
    /// The columns' slot by whose sum each of the rows' slots is multiplied; [`NO_SLOT`] where that
    /// is done by none.
    pub partner: Vec<u32>,
    /// Squares of each [`LANES`] rows' places: `square_start[k]..square_start[k + 1]`,
    /// `[blocks · PARTS + 1]`.
    pub square_start: Vec<u32>,
    /// Dense squares; those of symmetric operators in both of their rows.
    pub squares: Vec<TileSquare>,
    /// Their elements of 8 bits, [`SQUARE_WORDS`] each.
    pub square_words: Vec<u32>,
    /// Entries of each row's place, `[blocks · TILE + 1]`.
    pub row_start: Vec<u32>,
    /// The column's place in the lower 16 bits, value in the upper.
    pub entries: Vec<u32>,
    /// Step of the values of each row's place.
    pub steps: Vec<f32>,
    /// What was lost.
    pub report: TileReport,
}

/// The columns of an operator that are not its rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColumnVectors {
    /// `√a` of each column, m.
    pub root: Vec<f32>,
    /// First quad of each run, whose quads are alike, and the end of the last.
    pub runs: Vec<u32>,
    /// The columns' vectors by fours, as [`LowRank::quads`].
    pub quads: Vec<TileQuad>,
    /// Their elements, in groups of [`LANES`] words.
    pub words: Vec<u32>,
}

/// How an operator was stored.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TileReport {
    /// Relative Frobenius error of each channel.
    pub error: [f64; 3],
    /// Tiles that are empty, without components, with components.
    pub tiles: [usize; 3],
    /// Components (pairs of vectors) for all channels, and of the differences.
    pub components: [usize; 2],
    /// Most components of a tile.
    pub most_rank: usize,
    /// Squares of the upper triangle.
    pub squares: usize,
    /// Single entries of the upper triangle.
    pub entries: usize,
}

impl LowRank {
    /// Whether rows and columns are the same patches.
    pub fn is_symmetric(&self) -> bool {
        self.columns.is_none()
    }

    /// Blocks of [`TILE`] rows.
    pub fn blocks(&self) -> usize {
        self.place.len().div_ceil(SIDE)
    }

    /// Blocks of [`TILE`] columns.
    pub fn column_blocks(&self) -> usize {
        self.order.len().div_ceil(SIDE)
    }

    /// `√a` of each column, m.
    pub fn column_root(&self) -> &[f32] {
        self.columns.as_ref().map_or(&self.root, |columns| &columns.root)
    }

    /// First quad of each run of the columns, and the end of the last.
    pub fn column_runs(&self) -> &[u32] {
        self.columns.as_ref().map_or(&self.runs, |columns| &columns.runs)
    }

    /// Bytes of each part that a product reads.
    pub fn bytes_by_part(&self) -> [(&'static str, u64); 4] {
        let slots = size_of_val(&self.scale[..]) + size_of_val(&self.partner[..]);
        let mut vectors = self.expand_tables().bytes() + slots;
        let mut places = size_of_val(&self.order[..]) + size_of_val(&self.place[..]) + size_of_val(&self.root[..]);
        if let Some(ColumnVectors { root, runs, quads, words }) = &self.columns {
            vectors += size_of_val(&runs[..]) + size_of_val(&quads[..]) + size_of_val(&words[..]);
            places += size_of_val(&root[..]);
        }
        let [squares, entries] = self.near_tables().bytes();
        [
            ("vectors", vectors as u64),
            ("squares", squares as u64),
            ("entries", entries as u64),
            ("places", places as u64),
        ]
    }

    /// Bytes of what does not follow from the rest. Of symmetric operators: entries once, not for both of their rows; scale
    /// and partner once for both vectors of a component; not `place`.
    pub fn stored_bytes(&self) -> u64 {
        let whole = self.bytes_by_part().iter().map(|part| part.1).sum::<u64>();
        if !self.is_symmetric() {
            return whole;
        }
        let squares = self.squares.len() - self.report.squares.min(self.squares.len());
        let entries = self.entries.len() - self.report.entries.min(self.entries.len());
        let mirrored = entries + squares * (SQUARE_WORDS as usize + size_of::<TileSquare>() / size_of::<u32>());
        let components: usize = self.report.components.iter().sum();
        let follows = mirrored + 2 * components.min(self.scale.len() / 2) + self.place.len();
        whole - (follows * size_of::<u32>()) as u64
    }

    /// Whether the tables belong together, so that no product reads beyond them.
    ///
    /// # Errors
    /// [`transport::Error::Length`], [`transport::Error::Value`], naming the table and the entry.
    pub fn check(&self) -> Result<(), Error> {
        let rows = self.place.len();
        let columns = self.order.len();
        check_length("root", rows, self.root.len())?;
        check_length("root of columns", columns, self.column_root().len())?;
        if let Some(own) = &self.columns {
            check_bank(&own.runs, &own.quads, &own.words, self.column_blocks())?;
        }
        let ProjectTables { quads, .. } = self.project_tables();
        let slots = QUAD as usize * quads.len();
        check_length("scale", slots, self.scale.len())?;
        check_length("partner", QUAD as usize * self.quads.len(), self.partner.len())?;
        self.expand_tables().check(self.blocks())?;
        self.near_tables().check(self.blocks(), self.column_blocks())?;
        check_below("order", self.order.iter().copied(), columns)?;
        check_below("place", self.place.iter().copied(), rows)?;
        let partners = self.partner.iter().map(|&slot| if slot == NO_SLOT { 0 } else { slot });
        check_below("partner", partners, slots.max(usize::from(!self.quads.is_empty())))?;
        check_finite("scale", self.scale.iter().copied())?;
        check_root("root", &self.root)?;
        check_root("root of columns", self.column_root())
    }
}

/// Place of each patch in an order of all of them.
pub(super) fn places(order: &[u32]) -> Result<Vec<u32>, Error> {
    let mut place = vec![u32::MAX; order.len()];
    for (p, &i) in order.iter().enumerate() {
        match place.get_mut(i as usize) {
            Some(place) if *place == u32::MAX => *place = p as u32,
            _ => {
                return Err(transport::Error::Value {
                    name: "order",
                    index: p,
                    value: f64::from(i),
                    rule: "every patch once",
                }
                .into());
            }
        }
    }
    Ok(place)
}

fn check_starts(name: &'static str, starts: &[u32], end: usize) -> Result<(), Error> {
    let last = starts.last().map_or(0, |&k| k as usize);
    check_length(name, end, last)?;
    match starts.windows(2).position(|w| w[0] > w[1]) {
        Some(index) => {
            Err(transport::Error::Value { name, index, value: f64::from(starts[index]), rule: "ascending" }.into())
        }
        None => Ok(()),
    }
}

/// Vectors of so many blocks: runs, their quads, and the words of these.
fn check_bank(runs: &[u32], quads: &[TileQuad], words: &[u32], blocks: usize) -> Result<(), Error> {
    check_length("runs", runs.len().max(1), runs.len())?;
    let groups: usize = quads.iter().map(|quad| (QUAD * quad.groups()) as usize).sum();
    check_length("words", groups * LANES as usize, words.len())?;
    check_starts("runs", runs, quads.len())?;
    check_below("quads", quads.iter().map(|quad| quad.block()), blocks)?;
    check_below("quads", quads.iter().map(|quad| quad.group.saturating_add(QUAD * quad.groups() - 1)), groups)?;
    for (k, run) in runs.windows(2).enumerate() {
        let quads = &quads[run[0] as usize..run[1] as usize];
        let follow = quads.windows(2).all(|w| w[0].tag == w[1].tag && w[0].group + QUAD * w[0].groups() == w[1].group);
        if quads.len() > RUN_QUADS as usize || !follow {
            let rule = "the first of a few quads that are alike, one after another";
            return Err(transport::Error::Value { name: "runs", index: k, value: f64::from(run[0]), rule }.into());
        }
    }
    Ok(())
}

fn check_below(name: &'static str, mut table: impl Iterator<Item = u32> + Clone, limit: usize) -> Result<(), Error> {
    match table.clone().position(|k| k as usize >= limit) {
        Some(index) => {
            let value = table.nth(index).map_or(f64::NAN, f64::from);
            Err(transport::Error::Value { name, index, value, rule: "in its range" }.into())
        }
        None => Ok(()),
    }
}

fn check_finite(name: &'static str, mut table: impl Iterator<Item = f32>) -> Result<(), Error> {
    match table.position(|x| !x.is_finite()) {
        Some(index) => Err(transport::Error::Value { name, index, value: f64::NAN, rule: "finite" }.into()),
        None => Ok(()),
    }
}

fn check_root(name: &'static str, root: &[f32]) -> Result<(), Error> {
    match root.iter().position(|r| !(r.is_finite() && *r > 0.0)) {
        Some(index) => {
            Err(transport::Error::Value { name, index, value: f64::from(root[index]), rule: "positive" }.into())
        }
        None => Ok(()),
    }
}
