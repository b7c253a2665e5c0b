//! Symmetric operators in tiles of low rank, dense squares and single entries.

mod encode;
mod lanes;
mod near;
mod product;
mod rectangular;
mod reduce;
mod source;

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
    ExpandTables, ProjectTables, TileRoom, enter_all, expand_all, leave_all, project_all, round_all, weigh_all,
};

pub use rectangular::{MOST_TILE_RECEIVERS, RectangularRoom, RectangularTiles, SparseRows, TileSide};

/// Most patches: entries name columns by 16 bits.
pub const MOST_TILE_PATCHES: usize = PLACES - TILE as usize;

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

/// A symmetric operator, `T̂ ≈ Σ_k s_k (u_k v_kᵀ + v_k u_kᵀ) + D + S`: the upper triangle is cut into tiles of [`TILE`] rows and
/// columns, each the sum of a few pairs of vectors of 4 or 8 bits, of dense squares of 8 bits and of single entries of 16
/// bits; a tile may have none of them. Three colour channels share what they have in common: green is the common part. Red and
/// blue are stored as differences to it, which have far fewer components, because the light that arrives directly is the same,
/// and which are turned so that the first of their two axes has most of both: where walls are of one hue, red and blue differ
/// from green alike.
///
/// A component is kept when it takes more from the squared error than λ times its bytes, squares and entries likewise, and λ
/// is found so that the whole has the error that was asked for. Errors that are even over neighbouring places are weighted by
/// the cube root of their extent when components are found: light is even over neighbours and adds them up. So the error of
/// the entries is not the least that so many bytes can have, but that of irradiance is about half of what it then would be.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tiles {
    /// Patch at each place of the order.
    pub order: Vec<u32>,
    /// Place of each patch.
    pub place: Vec<u32>,
    /// `√a` of each patch, m.
    pub root: Vec<f32>,
    /// Runs of block b: `run_start[b]..run_start[b + 1]`.
    pub run_start: Vec<u32>,
    /// Quads of run k, which are alike: `quads[runs[k]..runs[k + 1]]`, at most [`RUN_QUADS`].
    pub runs: Vec<u32>,
    /// Vectors by fours, block by block, alike ones together; where there are no four, zeros fill up. Slot `4 k + m` is
    /// vector m of quad k.
    pub quads: Vec<TileQuad>,
    /// Elements of the vectors, in groups of [`LANES`] words.
    pub words: Vec<u32>,
    /// Red and blue of the first axis of the differences, then of the second, [`crate::kernel::tiles::tint`].
    pub axes: Vec4,
    /// What the sum of each slot is multiplied by.
    pub scale: Vec<f32>,
    /// Slot of the other vector of each slot's component, by whose sum the slot's is multiplied; [`NO_SLOT`] where that is
    /// done by none.
    pub partner: Vec<u32>,
    /// Squares of each [`LANES`] places: `square_start[k]..square_start[k + 1]`, `[blocks · PARTS + 1]`.
    pub square_start: Vec<u32>,
    /// Dense squares, in both of their rows.
    pub squares: Vec<TileSquare>,
    /// Their elements of 8 bits, [`SQUARE_WORDS`] each.
    pub square_words: Vec<u32>,
    /// Entries of each place, `[blocks · TILE + 1]`.
    pub row_start: Vec<u32>,
    /// Column in the lower 16 bits, value in the upper.
    pub entries: Vec<u32>,
    /// Step of the values of each place.
    pub steps: Vec<f32>,
    /// What was lost.
    pub report: TileReport,
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

impl Tiles {
    /// Number of patches.
    pub fn patches(&self) -> usize {
        self.order.len()
    }

    /// Blocks of [`TILE`] rows.
    pub fn blocks(&self) -> usize {
        self.order.len().div_ceil(TILE as usize)
    }

    /// Bytes of each part that a product reads.
    pub fn bytes_by_part(&self) -> [(&'static str, u64); 4] {
        let slots = size_of_val(&self.scale[..]) + size_of_val(&self.partner[..]);
        let vectors = self.expand_tables().bytes() + slots;
        let [squares, entries] = self.near_tables().bytes();
        let places = size_of_val(&self.order[..]) + size_of_val(&self.place[..]) + size_of_val(&self.root[..]);
        [
            ("vectors", vectors as u64),
            ("squares", squares as u64),
            ("entries", entries as u64),
            ("places", places as u64),
        ]
    }

    /// Bytes of what does not follow from the rest: entries once, not for both of their rows; scale and partner once for both
    /// vectors of a component; not `place`.
    pub fn stored_bytes(&self) -> u64 {
        let squares = self.squares.len() - self.report.squares.min(self.squares.len());
        let entries = self.entries.len() - self.report.entries.min(self.entries.len());
        let mirrored = entries + squares * (SQUARE_WORDS as usize + size_of::<TileSquare>() / size_of::<u32>());
        let components: usize = self.report.components.iter().sum();
        let follows = mirrored + 2 * components.min(self.scale.len() / 2) + self.place.len();
        self.bytes_by_part().iter().map(|part| part.1).sum::<u64>() - (follows * size_of::<u32>()) as u64
    }

    /// Whether the tables belong together, so that no product reads beyond them.
    ///
    /// # Errors
    /// [`transport::Error::Length`], [`transport::Error::Value`], naming the table and the entry.
    pub fn check(&self) -> Result<(), Error> {
        let n = self.patches();
        check_length("place", n, self.place.len())?;
        check_length("root", n, self.root.len())?;
        let slots = QUAD as usize * self.quads.len();
        check_length("scale", slots, self.scale.len())?;
        check_length("partner", slots, self.partner.len())?;
        self.expand_tables().check(self.blocks())?;
        self.near_tables().check(self.blocks(), self.blocks())?;
        check_below("order", self.order.iter().copied(), n)?;
        check_below("place", self.place.iter().copied(), n)?;
        let partners = self.partner.iter().map(|&slot| if slot == NO_SLOT { 0 } else { slot });
        check_below("partner", partners, slots)?;
        check_finite("scale", self.scale.iter().copied())?;
        check_root("root", &self.root)
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
