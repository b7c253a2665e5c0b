//! The random numbers of a path: for every pair of dimensions its own Owen-scrambled, shuffled Sobol sequence
//! (Burley 2020, "Practical Hash-based Owen Scrambling"), all from one hash of (stream, sample, dimension, seed).

use scene::sampling::{hash, hash3, owen_scramble, sobol2_fast, unit};

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
        let k = owen_scramble(self.index, key) & 0xffff;
        let (x, y) = sobol2_fast(k);
        let a = owen_scramble(x, key ^ 0x9e37_79b9);
        let b = owen_scramble(y, key ^ 0x85eb_ca6b);
        (unit(a), unit(b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let mut same = 0.0f64;
        let mut other = 0.0f64;
        let mut mean = 0.0f64;
        let count = 1 << 14;
        for stream in 0..count {
            let mut sampler = Sampler::new(stream, 5, 3);
            let a = sampler.next();
            let b = sampler.next();
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
