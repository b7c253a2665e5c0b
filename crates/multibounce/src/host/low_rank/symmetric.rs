//! Symmetric operators, tile by tile of the upper triangle.

use core::sync::atomic::{AtomicUsize, Ordering};

use alloc::vec::Vec;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;

use faer::{unzip, zip};
use scene::parallel::*;
use scene::sampling::hash3;
use transport::Proceed;

use super::encode::{Encoded, Encoder, Progress, Rows};
use super::reduce::{Costs, Part, SIDE, reduce, squared_norm};
use super::source::{Source, twice};
use super::{Channels, TileSide};
use crate::error::Error;
use crate::kernel::low_rank::ALL_CHANNELS;

/// Tiles from which on λ is first looked for with a part of them, and that part.
const MANY_TILES: usize = 512;
const PART: u32 = 8;

/// The tiles of symmetric operators.
pub(super) struct SymmetricTiles<'a> {
    pub source: Source<'a>,
    /// All tiles of the upper triangle, and those by which λ is first looked for.
    all: Vec<(usize, usize)>,
    some: Vec<(usize, usize)>,
    /// Norm of each channel, of all and of some.
    norms: [f64; 3],
    some_norms: [f64; 3],
    patches: usize,
}

impl<'a> SymmetricTiles<'a> {
    pub fn new(channels: Channels<'a>, patches: TileSide<'a>, permuted_index: &[u32]) -> Result<Self, Error> {
        let mut source = Source::new(channels, patches.area, patches.order, permuted_index)?;
        let blocks = patches.order.len().div_ceil(SIDE);
        let all: Vec<(usize, usize)> = (0..blocks).flat_map(|i| (i..blocks).map(move |j| (i, j))).collect();
        let is_some =
            |&(i, j): &(usize, usize)| all.len() < MANY_TILES || hash3(i as u32, j as u32, 0).is_multiple_of(PART);
        let some: Vec<(usize, usize)> = all.iter().copied().filter(is_some).collect();
        source.rotate_axes(&some)?;
        let norms = source.norms(&all)?;
        let some_norms = if some.len() < all.len() { source.norms(&some)? } else { norms };
        Ok(Self { source, all, some, norms, some_norms, patches: patches.order.len() })
    }

    fn parts(&self, tiles: &[(usize, usize)], lambda: f32, progress: &Progress) -> Result<Vec<Part>, Error> {
        let done = AtomicUsize::new(0);
        let total = tiles.len();
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
        let mut part = Part::default();
        let costs = Costs { lambda, ..Costs::SYMMETRIC };
        let weights = (&self.source.weights[at.0], &self.source.weights[at.1]);
        let mut planes = self.source.planes(at)?;
        for (plane, color) in planes.iter_mut().zip([ALL_CHANNELS, 0, 1]) {
            reduce(plane, weights, &costs, color, &mut part);
        }
        part.error = [squared_norm(&planes[0]); 3];
        if let [common, first, second] = &planes[..] {
            let [one, other] = self.source.chroma_axes;
            for (channel, a, b) in [(0, one[0], other[0]), (2, one[1], other[1])] {
                let rest = zip!(common, first, second).map(|unzip!(common, x, y)| common + a * x + b * y);
                part.error[channel] = squared_norm(&rest);
            }
        }
        part.error = part.error.map(|error| twice(at) * error);
        Ok(part)
    }
}

impl Encoder for SymmetricTiles<'_> {
    fn first_lambda(&self, epsilon: f64) -> Result<f32, Error> {
        let entries = (self.patches * self.patches) as f64;
        Ok(((epsilon * self.norms[1]).powi(2) / (0.03 * entries)).max(1e-30) as f32)
    }

    fn has_sample(&self) -> bool {
        self.some.len() < self.all.len()
    }

    fn sample_error(&self, lambda: f32, _: &Progress) -> Result<f64, Error> {
        let silent = |_: usize, _: usize| Proceed::Continue(());
        Ok(worst(&self.parts(&self.some, lambda, &silent)?, self.some_norms))
    }

    fn is_large(&self) -> bool {
        self.all.len() >= MANY_TILES
    }

    fn encode(&self, lambda: f32, progress: &Progress) -> Result<Encoded, Error> {
        let parts = self.parts(&self.all, lambda, progress)?;
        let blocks = self.patches.div_ceil(SIDE);
        let rows = Rows::pack(&self.all, &parts, blocks * SIDE, true);
        // Entries for all channels are rounded alike in all of them.
        let least = self.norms.iter().copied().filter(|&x| x > 0.0).fold(f64::INFINITY, f64::min);
        let worst = (worst(&parts, self.norms).powi(2) + rows.error / (least * least)).sqrt();
        let error = [0, 1, 2].map(|c| {
            let norm = self.norms[c];
            if norm > 0.0 { (squared_error(&parts, c) + rows.error).sqrt() / norm } else { 0.0 }
        });
        Ok(Encoded { at: self.all.clone(), parts, rows, error, worst })
    }
}

/// Squared error of a channel.
fn squared_error(parts: &[Part], channel: usize) -> f64 {
    parts.iter().map(|part| part.error[channel]).sum()
}

/// The greatest relative error of the channels.
fn worst(parts: &[Part], norms: [f64; 3]) -> f64 {
    (0..3).filter(|&c| norms[c] > 0.0).map(|c| squared_error(parts, c).sqrt() / norms[c]).fold(0.0, f64::max)
}
