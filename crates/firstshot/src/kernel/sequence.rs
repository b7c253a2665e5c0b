//! The numbers of a photon, all from (number, dimension, seed of its batch): independent, or points of Sobol's sequence
//! with Owen's scrambling. The start takes five dimensions of one sequence. Each reflection takes a pair and a single
//! number of sequences of their own, shuffled (Burley 2020, "Practical Hash-based Owen Scrambling").

use scene::sampling::{hash, hash3, owen_scramble, sobol2_fast};

use crate::types::{PhotonParams, SEQUENCE_SOBOL};

/// Direction numbers `m` of dimensions 3 to 5 (Joe and Kuo 2008, new-joe-kuo-6): degree, coefficients, first numbers.
const DIMENSIONS: [(u32, u32, [u32; 3]); 3] = [(2, 1, [1, 3, 0]), (3, 1, [1, 3, 1]), (3, 2, [1, 1, 1])];

/// Columns of the generator matrices of dimensions 3 to 5.
const COLUMNS: [[u32; 32]; 3] = [columns(0), columns(1), columns(2)];

const fn columns(k: usize) -> [u32; 32] {
    let (degree, coefficients, first) = DIMENSIONS[k];
    let s = degree as usize;
    let mut v = [0u32; 32];
    let mut i = 0;
    while i < 32 {
        if i < s {
            v[i] = first[i] << (31 - i);
        } else {
            let mut x = v[i - s] ^ (v[i - s] >> s);
            let mut j = 1;
            while j < s {
                if (coefficients >> (s - 1 - j)) & 1 == 1 {
                    x ^= v[i - j];
                }
                j += 1;
            }
            v[i] = x;
        }
        i += 1;
    }
    v
}

/// Number `k` of dimension 3, 4 or 5 (`which` = 0, 1, 2) of Sobol's sequence.
#[inline]
pub fn sobol_more(k: u32, which: u32) -> u32 {
    // Every column, whether its bit is set or not: chance decides about bits, so branches on them would be foretold
    // wrongly.
    let mut x = 0u32;
    let mut i = 0usize;
    while i < 32 {
        x ^= COLUMNS[which as usize][i] & (k >> i & 1).wrapping_neg();
        i += 1;
    }
    x
}

/// Place of a photon in its sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sequence {
    /// Number of the photon in its batch.
    pub index: u32,
    /// Seed of the batch.
    pub key: u32,
    /// One of the `SEQUENCE_` constants.
    pub kind: u32,
}

/// The numbers of a start beside that of its element.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StartWords {
    /// Place on the element.
    pub place: (u32, u32),
    /// Which way.
    pub way: (u32, u32),
    /// Random number of the rejection, independent of the others.
    pub rejection: u32,
    /// Random number of the choice between diffuse reflection, mirror and transmission, independent of the others.
    pub part: u32,
}

impl Sequence {
    /// The sequence of photon `k` of a dispatch.
    #[inline]
    pub fn of(p: &PhotonParams, k: u32) -> Self {
        let batch = p.first_batch + k / p.per_batch;
        Self { index: p.first + k % p.per_batch, key: hash3(batch, 0x7068_6f74, p.seed), kind: p.sequence }
    }

    /// An independent number of a dimension.
    #[inline]
    fn random(&self, dimension: u32) -> u32 {
        hash3(self.index, dimension, self.key)
    }

    /// The number that picks the element.
    #[inline]
    pub fn element(&self) -> u32 {
        if self.kind == SEQUENCE_SOBOL {
            owen_scramble(sobol2_fast(self.index).0, hash(self.key ^ hash(0)))
        } else {
            self.random(0)
        }
    }

    /// The numbers of the start.
    #[inline]
    pub fn start(&self) -> StartWords {
        let rejection = self.random(0x7265_6a65);
        let part = self.random(0x7061_7274);
        if self.kind != SEQUENCE_SOBOL {
            let place = (self.random(1), self.random(2));
            return StartWords { place, way: (self.random(3), self.random(4)), rejection, part };
        }
        let scrambled = |x: u32, dimension: u32| owen_scramble(x, hash(self.key ^ hash(dimension)));
        let more = |which: u32| sobol_more(self.index, which);
        StartWords {
            way: (scrambled(sobol2_fast(self.index).1, 1), scrambled(more(0), 2)),
            place: (scrambled(more(1), 3), scrambled(more(2), 4)),
            rejection,
            part,
        }
    }

    /// The numbers of reflection `n`: survival, and the way on.
    #[inline]
    pub fn reflection(&self, n: u32) -> (u32, (u32, u32)) {
        if self.kind != SEQUENCE_SOBOL {
            return (self.random(3 * n + 8), (self.random(3 * n + 9), self.random(3 * n + 10)));
        }
        let key = hash3(self.key, n, 0x7265_666c);
        let single = owen_scramble(self.index, key ^ 0x2545_f491).reverse_bits();
        let (x, y) = sobol2_fast(owen_scramble(self.index, key));
        (
            owen_scramble(single, key ^ 0xc2b2_ae35),
            (owen_scramble(x, key ^ 0x9e37_79b9), owen_scramble(y, key ^ 0x85eb_ca6b)),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_dimension_is_stratified_and_pairs_are_nets() {
        let n = 1u32 << 12;
        for (seed, kind) in [(0, SEQUENCE_SOBOL), (77, SEQUENCE_SOBOL), (77, crate::SEQUENCE_RANDOM)] {
            let words = |index: u32| {
                let sequence = Sequence { index, key: hash(seed), kind };
                let w = sequence.start();
                [sequence.element(), w.place.0, w.place.1, w.way.0, w.way.1]
            };
            for d in 0..5 {
                let mut seen = alloc::vec![false; n as usize];
                let fresh = (0..n).filter(|&k| !core::mem::replace(&mut seen[(words(k)[d] >> 20) as usize], true));
                // Independent numbers leave about 1/e of the strata empty.
                assert_eq!(fresh.count() == n as usize, kind == SEQUENCE_SOBOL, "dimension {d}");
            }
            if kind == SEQUENCE_SOBOL {
                // (0, m, 2)-nets in the first pair; the others are within a factor of 2^t, t ≤ 3: 8 by 8 cells of 64.
                for (a, b) in [(0, 1), (0, 2), (1, 2), (0, 3), (3, 4), (2, 4)] {
                    let mut count = [0u32; 64];
                    (0..n).for_each(|k| count[((words(k)[a] >> 29) * 8 + (words(k)[b] >> 29)) as usize] += 1);
                    assert!(count.iter().all(|&c| c == 64), "{a} {b} {count:?}");
                }
            }
        }
    }

    #[test]
    fn numbers_of_reflections_are_stratified_and_independent_of_each_other() {
        let n = 1u32 << 14;
        let sequence = |index: u32| Sequence { index, key: 5, kind: SEQUENCE_SOBOL };
        let mut seen = alloc::vec![false; n as usize];
        let mut product = [0.0f64; 3];
        let unit = |x: u32| f64::from(x) / 2f64.powi(32) - 0.5;
        for k in 0..n {
            let (survival, way) = sequence(k).reflection(1);
            assert!(!core::mem::replace(&mut seen[(survival >> 18) as usize], true));
            let next = sequence(k).reflection(2);
            product[0] += unit(survival) * unit(way.0) / f64::from(n);
            product[1] += unit(way.0) * unit(next.1.0) / f64::from(n);
            product[2] += unit(survival) * unit(next.0) / f64::from(n);
        }
        // Independent: 0.083/√n = 6.5e-4 (1 σ).
        assert!(product.iter().all(|p| p.abs() < 2.6e-3), "{product:?}");
    }
}
