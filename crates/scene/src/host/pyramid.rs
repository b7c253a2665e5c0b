//! Textures with their mip pyramids, made row by row: nothing is as large as the picture but what is kept.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use glam::Vec4;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;

use crate::gpu::Texture;

/// The levels of a picture under way.
pub struct Pyramid {
    levels: Vec<Level>,
    texture: Texture,
}

/// A level: its texels, where it is kept, and what makes the next level of it.
struct Level {
    words: Option<Vec<u32>>,
    next: Halver,
}

impl Pyramid {
    /// Pyramid of a picture of this width and height, without its first `skip` levels; the last level always stays.
    pub fn new(size: (u32, u32), skip: u32) -> Self {
        let sizes: Vec<(u32, u32)> =
            core::iter::successors(Some(size), |size| (*size != (1, 1)).then(|| half(*size))).collect();
        let skip = (skip as usize).min(sizes.len() - 1);
        let level = |(k, size): (usize, &(u32, u32))| {
            let texels = size.0 as usize * size.1 as usize;
            Level { words: (k >= skip).then(|| Vec::with_capacity(2 * texels)), next: Halver::new(*size) }
        };
        let (width, height) = sizes[skip];
        let texture = Texture { offset: 0, width, height, levels: (sizes.len() - skip) as u32 };
        Self { levels: sizes.iter().enumerate().map(level).collect(), texture }
    }

    /// Texels of all levels of a picture of this width and height.
    pub fn texels(size: (u32, u32)) -> usize {
        let sizes = core::iter::successors(Some(size), |size| (*size != (1, 1)).then(|| half(*size)));
        sizes.map(|(width, height)| width as usize * height as usize).sum()
    }

    /// Takes the next row from the top: linear red, green, blue and alpha of each texel.
    pub fn push(&mut self, row: Vec<Vec4>) {
        add_row(&mut self.levels, row);
    }

    /// The texture, at the offset 0 of its texels, two words each.
    pub fn finish(self) -> (Texture, Vec<u32>) {
        let mut words = Vec::with_capacity(2 * Self::texels((self.texture.width, self.texture.height)));
        self.levels.into_iter().filter_map(|level| level.words).for_each(|own| words.extend(own));
        (self.texture, words)
    }
}

/// Adds the next row to a level, and to those above what follows from it.
fn add_row(levels: &mut [Level], row: Vec<Vec4>) {
    let Some((level, above)) = levels.split_first_mut() else { return };
    if let Some(words) = &mut level.words {
        words.extend(row.iter().flat_map(|texel| quantise(*texel)));
    }
    if let Some(next) = level.next.push(row).filter(|_| !above.is_empty()) {
        add_row(above, next);
    }
}

fn quantise(texel: Vec4) -> [u32; 2] {
    let q = (texel.clamp(Vec4::ZERO, Vec4::ONE) * 65_535.0 + 0.5).as_uvec4();
    [q.x | q.y << 16, q.z | q.w << 16]
}

/// Width and height of the next level.
pub fn half((width, height): (u32, u32)) -> (u32, u32) {
    ((width / 2).max(1), (height / 2).max(1))
}

/// For each of the new cells along an edge: the first of the old ones that it covers, and the share of each in it.
type Shares = Vec<(usize, Vec<f32>)>;

/// Makes the next level of rows that come one after the other: every new texel is the mean over its part of the old
/// picture, so that the mean stays, also for odd sizes.
pub struct Halver {
    columns: Shares,
    rows: Shares,
    /// The old rows that are still needed, and the number of the first of them.
    held: VecDeque<Vec<Vec4>>,
    first: usize,
    /// The next new row.
    next: usize,
}

impl Halver {
    /// For a picture of this width and height.
    pub fn new(size: (u32, u32)) -> Self {
        let new = half(size);
        let columns = shares(size.0, new.0);
        let rows = shares(size.1, new.1);
        Self { columns, rows, held: VecDeque::new(), first: 0, next: 0 }
    }

    /// Takes the next old row; gives the new one that it completes.
    pub fn push(&mut self, row: Vec<Vec4>) -> Option<Vec<Vec4>> {
        self.held.push_back(row);
        let (start, row_weights) = self.rows.get(self.next)?;
        if self.first + self.held.len() < start + row_weights.len() {
            return None;
        }
        let mut new = Vec::with_capacity(self.columns.len());
        for (column, column_weights) in &self.columns {
            let mut sum = Vec4::ZERO;
            for (dy, wy) in row_weights.iter().enumerate() {
                let line = &self.held[start + dy - self.first];
                for (dx, wx) in column_weights.iter().enumerate() {
                    sum += line[column + dx] * (wx * wy);
                }
            }
            new.push(sum);
        }
        self.next += 1;
        let needed = self.rows.get(self.next).map_or(self.first + self.held.len(), |(start, _)| *start);
        self.held.drain(..needed - self.first);
        self.first = needed;
        Some(new)
    }
}

/// Shares of `old` cells along an edge in `new` ones; the shares of each sum to 1.
fn shares(old: u32, new: u32) -> Shares {
    let size = f64::from(old) / f64::from(new);
    (0..new)
        .map(|k| {
            let start = f64::from(k) * size;
            let end = f64::from(k + 1) * size;
            let first = start.floor() as usize;
            let last = ((end - 1e-9).floor() as usize).min(old as usize - 1);
            let part = |c: usize| (((c as f64 + 1.0).min(end) - (c as f64).max(start)) / size) as f32;
            (first, (first..=last).map(part).collect())
        })
        .collect()
}
