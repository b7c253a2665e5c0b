//! The bandwidth that products are compared with.

use std::hint::black_box;
use std::time::Instant;

use pulp::Arch;
use rayon::prelude::*;

/// Bandwidth of reading, GB/s (10⁹ bytes a second): all cores add up `bytes` bytes with the widest vectors they have,
/// the best of `rounds` rounds. A size that fits into the last cache gives the cache's bandwidth.
pub fn stream_gb_s(bytes: usize, rounds: usize) -> f64 {
    let mut stream = Stream::new(bytes);
    (0..rounds).map(|_| stream.round()).fold(0.0, f64::max)
}

/// A buffer to read from, so that a bandwidth can be measured alternately with something else.
pub struct Stream {
    words: Vec<u64>,
    sum: u64,
}

impl Stream {
    /// A buffer of `bytes` bytes, every page of it touched by the threads that read it.
    pub fn new(bytes: usize) -> Self {
        let words = (0..bytes as u64 / 8).into_par_iter().collect();
        Self { words, sum: 0 }
    }

    /// Reads the buffer once: GB/s.
    pub fn round(&mut self) -> f64 {
        let arch = Arch::new();
        let start = Instant::now();
        // Blocks of 1 MiB: long runs for the prefetcher, many enough for all cores.
        let sums = self.words.par_chunks(1 << 17).map(|block| arch.dispatch(|| add_up(block)));
        self.sum = black_box(sums.reduce(|| 0, u64::wrapping_add));
        let seconds = start.elapsed().as_secs_f64();
        (8 * self.words.len()) as f64 * 1e-9 / seconds
    }
}

/// Sum of all words, in as many independent sums as fill several vector registers.
#[inline(always)]
fn add_up(block: &[u64]) -> u64 {
    let mut sums = [0u64; 64];
    let chunks = block.chunks_exact(64);
    let rest = chunks.remainder().iter().fold(0, |a: u64, b| a.wrapping_add(*b));
    for chunk in chunks {
        for (sum, word) in sums.iter_mut().zip(chunk) {
            *sum = sum.wrapping_add(*word);
        }
    }
    sums.iter().fold(rest, |a, b| a.wrapping_add(*b))
}
