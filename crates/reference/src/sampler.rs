//! The random numbers of a path: for every pair of dimensions its own Owen-scrambled, shuffled Sobol sequence
//! (Burley 2020, "Practical Hash-based Owen Scrambling"), all from one hash of (stream, sample, dimension, seed).

use scene::sampling::{hash, hash3, unit};

/// Points of one sample of one stream (a pixel, a surface point), dimension after dimension.
pub(crate) struct Sampler {
    key: u32,
    index: u32,
    dimension: u32,
}

impl Sampler {
    /// Sample `index` of `stream`.
    #[inline]
    pub(crate) fn new(stream: u32, index: u32, seed: u32) -> Self {
        // Indices beyond 16 bits start a new set with other scrambling, so that 16 bits of Sobol's matrix are enough.
        Self { key: hash3(stream, index >> 16, seed), index: index & 0xffff, dimension: 0 }
    }

    /// The next point of the unit square.
    #[inline]
    pub(crate) fn next(&mut self) -> (f32, f32) {
        let key = hash(self.key ^ hash(self.dimension));
        self.dimension += 1;
        let k = scramble(self.index, key) & 0xffff;
        let (x, y) = sobol2(k);
        let a = scramble(x, key ^ 0x9e37_79b9);
        let b = scramble(y, key ^ 0x85eb_ca6b);
        (unit(a), unit(b))
    }
}

/// Nested uniform scrambling: every bit is flipped by a hash of the bits above it (Laine and Karras 2011, constants of
/// Vegdahl 2021).
#[inline]
fn scramble(x: u32, seed: u32) -> u32 {
    let mut x = x.reverse_bits();
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x.reverse_bits()
}

/// The first two dimensions of Sobol's sequence. The second is Pascal's triangle modulo 2, a sum over the supersets of
/// each bit position: five steps.
#[inline]
fn sobol2(k: u32) -> (u32, u32) {
    let mut y = k;
    y ^= (y & 0xaaaa_aaaa) >> 1;
    y ^= (y & 0xcccc_cccc) >> 2;
    y ^= (y & 0xf0f0_f0f0) >> 4;
    y ^= (y & 0xff00_ff00) >> 8;
    y ^= y >> 16;
    (k.reverse_bits(), y.reverse_bits())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_sobol_points_are_sobol_points() {
        for k in (0..100_000).chain([u32::MAX, 0x8000_0001, 0x1234_5678]) {
            assert_eq!(sobol2(k), scene::sampling::sobol2(k), "{k}");
        }
    }

    #[test]
    fn every_power_of_two_of_samples_is_stratified() {
        for (stream, seed) in [(0, 0), (7, 1), (123_456, 99)] {
            for dimension in 0..6 {
                for bits in [2u32, 4, 6, 8] {
                    let mut seen = vec![false; 1 << bits];
                    for index in 0..1 << bits {
                        let mut sampler = Sampler::new(stream, index, seed);
                        let mut point = (0.0, 0.0);
                        for _ in 0..=dimension {
                            point = sampler.next();
                        }
                        let edge = (1u32 << (bits / 2)) as f32;
                        let cell = (point.0 * edge) as usize * edge as usize + (point.1 * edge) as usize;
                        assert!(!seen[cell], "{stream} {dimension} {bits}");
                        seen[cell] = true;
                    }
                }
            }
        }
    }

    #[test]
    fn streams_and_dimensions_are_independent() {
        let (mut same, mut other, mut mean) = (0.0f64, 0.0f64, 0.0f64);
        let count = 1 << 14;
        for stream in 0..count {
            let mut sampler = Sampler::new(stream, 5, 3);
            let (a, b) = (sampler.next(), sampler.next());
            mean += f64::from(a.0) / f64::from(count);
            same += (f64::from(a.0) - 0.5) * (f64::from(b.0) - 0.5) / f64::from(count);
            let neighbour = Sampler::new(stream + 1, 5, 3).next();
            other += (f64::from(a.0) - 0.5) * (f64::from(neighbour.0) - 0.5) / f64::from(count);
        }
        // Standard errors: 0.29/128 for the mean, 0.083/128 for the products.
        assert!((mean - 0.5).abs() < 0.009 && same.abs() < 0.0026 && other.abs() < 0.0026, "{mean} {same} {other}");
    }

    #[test]
    fn long_sequences_do_not_repeat() {
        assert_ne!(Sampler::new(1, 17, 2).next(), Sampler::new(1, 17 + 0x1_0000, 2).next());
    }
}
