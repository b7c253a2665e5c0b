//! The products H = F B on the host: all cores, the widest vectors the machine has, several rows at a time.

use alloc::vec::Vec;
use glam::Vec4;
use pulp::{Arch, Simd, WithSimd};
use scene::parallel::*;

use super::storage::{Csr, Dense, Half};
use crate::error::{Error, check_length};
use crate::operator::{LinearOperator, TransposedOperator};

/// Rows that share each load of the exitance.
const ROWS: usize = 4;

/// Rows one task works through: enough to hide the cost of starting it, few enough to keep all cores busy to the end.
const TASK_ROWS: usize = 8 * ROWS;

/// Planar RGB, so that vector lanes run along a row of F.
struct Planes([Vec<f32>; 3]);

impl Planes {
    fn new(exitance: &[Vec4]) -> Self {
        Self([0, 1, 2].map(|c| exitance.iter().map(|b| b[c]).collect()))
    }
}

/// The half in the low 16 bits to single precision, exact for every finite half.
#[inline(always)]
pub fn widen_half(bits: u32) -> f32 {
    let magnitude = (bits & 0x7fff) << 13;
    // The exponents' offsets differ by 112. Small form factors are subnormal halves: they are made by a subtraction of
    // normal numbers, because processors take a hundred cycles for subnormal floats.
    let normal = magnitude + (112 << 23);
    let subnormal = (f32::from_bits(magnitude + (113 << 23)) - f32::from_bits(113 << 23)).to_bits();
    let value = if magnitude < 1 << 23 { subnormal } else { normal };
    f32::from_bits(value | (bits & 0x8000) << 16)
}

/// As [`widen_half`] for a vector of words: their upper half by `HIGH`, else the lower.
#[inline(always)]
fn widen_simd<S: Simd, const HIGH: bool>(simd: S, words: S::u32s) -> S::f32s {
    let set = |x: u32| simd.splat_u32s(x);
    let (bits, sign) = if HIGH {
        (simd.wrapping_dyn_shr_u32s(words, set(3)), simd.and_u32s(words, set(0x8000_0000)))
    } else {
        let sign = simd.wrapping_dyn_shl_u32s(words, set(16));
        (simd.wrapping_dyn_shl_u32s(words, set(13)), simd.and_u32s(sign, set(0x8000_0000)))
    };
    let magnitude = simd.and_u32s(bits, set(0x7fff << 13));
    let normal = simd.add_u32s(magnitude, set(112 << 23));
    let shifted = simd.transmute_f32s_u32s(simd.add_u32s(magnitude, set(113 << 23)));
    let subnormal = simd.sub_f32s(shifted, simd.splat_f32s(f32::from_bits(113 << 23)));
    let small = simd.less_than_u32s(magnitude, set(1 << 23));
    let value = simd.select_u32s(small, simd.transmute_u32s_f32s(subnormal), normal);
    simd.transmute_f32s_u32s(simd.or_u32s(value, sign))
}

/// Sums of `ROWS` rows of half-precision words; `even` and `odd` hold the exitance of the lower and upper halves'
/// columns.
struct GatherHalf<'a> {
    rows: [&'a [u32]; ROWS],
    even: &'a Planes,
    odd: &'a Planes,
}

impl WithSimd for GatherHalf<'_> {
    type Output = [Vec4; ROWS];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let length = self.rows[0].len();
        let e = &self.even.0;
        let o = &self.odd.0;
        let (er, er_tail) = S::as_simd_f32s(&e[0][..length]);
        let (eg, eg_tail) = S::as_simd_f32s(&e[1][..length]);
        let (eb, eb_tail) = S::as_simd_f32s(&e[2][..length]);
        let (or, or_tail) = S::as_simd_f32s(&o[0][..length]);
        let (og, og_tail) = S::as_simd_f32s(&o[1][..length]);
        let (ob, ob_tail) = S::as_simd_f32s(&o[2][..length]);
        let split = |k: usize| S::as_simd_u32s(&self.rows[k][..length]);
        let ((w0, t0), (w1, t1), (w2, t2), (w3, t3)) = (split(0), split(1), split(2), split(3));
        let n = er.len();
        let eg = &eg[..n];
        let eb = &eb[..n];
        let or = &or[..n];
        let og = &og[..n];
        let ob = &ob[..n];
        let w0 = &w0[..n];
        let w1 = &w1[..n];
        let w2 = &w2[..n];
        let w3 = &w3[..n];
        let mut sums = [[simd.splat_f32s(0.0); 3]; ROWS];
        for k in 0..n {
            let even = [er[k], eg[k], eb[k]];
            let odd = [or[k], og[k], ob[k]];
            let words = [w0[k], w1[k], w2[k], w3[k]];
            for row in 0..ROWS {
                let low = widen_simd::<S, false>(simd, words[row]);
                let high = widen_simd::<S, true>(simd, words[row]);
                for c in 0..3 {
                    let sum = simd.mul_add_f32s(low, even[c], sums[row][c]);
                    sums[row][c] = simd.mul_add_f32s(high, odd[c], sum);
                }
            }
        }
        let tails = [t0, t1, t2, t3];
        let even = [er_tail, eg_tail, eb_tail];
        let odd = [or_tail, og_tail, ob_tail];
        let mut out = [Vec4::ZERO; ROWS];
        for row in 0..ROWS {
            for c in 0..3 {
                let mut sum = simd.reduce_sum_f32s(sums[row][c]);
                for (k, &word) in tails[row].iter().enumerate() {
                    sum += widen_half(word & 0xffff) * even[c][k] + widen_half(word >> 16) * odd[c][k];
                }
                out[row][c] = sum;
            }
        }
        out
    }
}

/// Sums of `ROWS` rows.
struct Gather<'a> {
    rows: [&'a [f32]; ROWS],
    planes: &'a Planes,
}

impl WithSimd for Gather<'_> {
    type Output = [Vec4; ROWS];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let length = self.rows[0].len();
        let plane = |c: usize| S::as_simd_f32s(&self.planes.0[c][..length]);
        let ((r, r_tail), (g, g_tail), (b, b_tail)) = (plane(0), plane(1), plane(2));
        let split = |k: usize| S::as_simd_f32s(&self.rows[k][..length]);
        let ((f0, t0), (f1, t1), (f2, t2), (f3, t3)) = (split(0), split(1), split(2), split(3));
        let n = r.len();
        let g = &g[..n];
        let b = &b[..n];
        let f0 = &f0[..n];
        let f1 = &f1[..n];
        let f2 = &f2[..n];
        let f3 = &f3[..n];
        let mut sums = [[simd.splat_f32s(0.0); 3]; ROWS];
        for k in 0..n {
            let color = [r[k], g[k], b[k]];
            let factors = [f0[k], f1[k], f2[k], f3[k]];
            for row in 0..ROWS {
                for c in 0..3 {
                    sums[row][c] = simd.mul_add_f32s(factors[row], color[c], sums[row][c]);
                }
            }
        }
        let tails = [t0, t1, t2, t3];
        let mut out = [Vec4::ZERO; ROWS];
        for row in 0..ROWS {
            for (c, tail) in [r_tail, g_tail, b_tail].iter().enumerate() {
                let mut sum = simd.reduce_sum_f32s(sums[row][c]);
                for (f, e) in tails[row].iter().zip(tail.iter()) {
                    sum += f * e;
                }
                out[row][c] = sum;
            }
        }
        out
    }
}

impl LinearOperator for Dense {
    fn shape(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    fn bytes(&self) -> u64 {
        size_of_val(&self.values[..]) as u64
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        self.check_vectors(exitance, irradiance)?;
        check_length("values", self.rows * self.columns, self.values.len())?;
        let planes = Planes::new(exitance);
        let arch = Arch::new();
        irradiance.par_chunks_mut(TASK_ROWS).enumerate().for_each(|(task, out)| {
            for (group, out) in out.chunks_mut(ROWS).enumerate() {
                let first = task * TASK_ROWS + group * ROWS;
                // A short last group repeats its last row; its sums are not used.
                let rows = [0, 1, 2, 3].map(|k: usize| self.row(first + k.min(out.len() - 1)));
                let sums = arch.dispatch(Gather { rows, planes: &planes });
                out.copy_from_slice(&sums[..out.len()]);
            }
        });
        Ok(())
    }
}

impl LinearOperator for Half {
    fn shape(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    fn bytes(&self) -> u64 {
        size_of_val(&self.words[..]) as u64
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        self.check_vectors(exitance, irradiance)?;
        let width = self.columns.div_ceil(2);
        check_length("words", self.rows * width, self.words.len())?;
        let every_other = |first: usize| {
            Planes([0, 1, 2].map(|c| {
                let mut plane: Vec<f32> = exitance.iter().skip(first).step_by(2).map(|b| b[c]).collect();
                // The unused half at the end of an odd row meets a zero.
                plane.resize(width, 0.0);
                plane
            }))
        };
        let even = every_other(0);
        let odd = every_other(1);
        let arch = Arch::new();
        irradiance.par_chunks_mut(TASK_ROWS).enumerate().for_each(|(task, out)| {
            for (group, out) in out.chunks_mut(ROWS).enumerate() {
                let first = task * TASK_ROWS + group * ROWS;
                let row = |k: usize| (first + k.min(out.len() - 1)) * width;
                let rows = [0, 1, 2, 3].map(|k| &self.words[row(k)..row(k) + width]);
                let sums = arch.dispatch(GatherHalf { rows, even: &even, odd: &odd });
                out.copy_from_slice(&sums[..out.len()]);
            }
        });
        Ok(())
    }
}

impl LinearOperator for Csr {
    fn shape(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    fn bytes(&self) -> u64 {
        (size_of_val(&self.row_start[..]) + size_of_val(&self.column_index[..]) + size_of_val(&self.values[..])) as u64
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        self.check_vectors(exitance, irradiance)?;
        self.check()?;
        irradiance.par_iter_mut().enumerate().with_min_len(TASK_ROWS).for_each(|(i, out)| {
            let first = self.row_start[i] as usize;
            let end = self.row_start[i + 1] as usize;
            // Two sums: an addition takes longer than the loads.
            let mut even = Vec4::ZERO;
            let mut odd = Vec4::ZERO;
            let columns = &self.column_index[first..end];
            let values = &self.values[first..end];
            for (c, v) in columns.chunks(2).zip(values.chunks(2)) {
                even += exitance[c[0] as usize] * v[0];
                if let (Some(&c), Some(&v)) = (c.get(1), v.get(1)) {
                    odd += exitance[c as usize] * v;
                }
            }
            let sum = even + odd;
            *out = sum.truncate().extend(0.0);
        });
        Ok(())
    }
}

impl TransposedOperator for Dense {
    fn apply_transposed(&self, y: &[Vec4], x: &mut [Vec4]) -> Result<(), Error> {
        self.check_vectors(x, y)?;
        check_length("values", self.rows * self.columns, self.values.len())?;
        x.fill(Vec4::ZERO);
        for (i, y) in y.iter().enumerate() {
            for (x, value) in x.iter_mut().zip(self.row(i)) {
                *x += *y * *value;
            }
        }
        Ok(())
    }
}

impl TransposedOperator for Csr {
    fn apply_transposed(&self, y: &[Vec4], x: &mut [Vec4]) -> Result<(), Error> {
        self.check_vectors(x, y)?;
        self.check()?;
        x.fill(Vec4::ZERO);
        for (i, y) in y.iter().enumerate() {
            for (column, value) in self.row(i) {
                x[column] += *y * value;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::product::{gather_row, gather_row_packed, gather_row_sparse};
    use glam::Vec2;
    use half::f16;
    use scene::sampling::{hash3, unit};

    #[test]
    fn every_finite_half_is_widened_exactly() {
        for bits in (0..=u16::MAX).filter(|&b| f16::from_bits(b).is_finite()) {
            assert_eq!(widen_half(u32::from(bits)).to_bits(), f16::from_bits(bits).to_f32().to_bits());
        }
    }

    #[test]
    fn products_agree_with_the_kernel_bodies() {
        for (rows, columns) in [(1, 1), (3, 7), (37, 65), (70, 1030), (9, 2500)] {
            let random = |k: usize, d: u32| unit(hash3(k as u32, d, 7));
            let values = (0..rows * columns).map(|k| if k % 5 == 0 { 0.0 } else { random(k, 0) }).collect();
            let dense = Dense::new(rows, columns, values).unwrap();
            let b: Vec<Vec4> = (0..columns).map(|k| Vec4::new(random(k, 1), random(k, 2), random(k, 3), 0.0)).collect();
            let half = dense.to_half();
            let csr = dense.to_csr(0.0).unwrap();
            let mut h = [vec![Vec4::ZERO; rows], vec![Vec4::ZERO; rows], vec![Vec4::ZERO; rows]];
            dense.apply(&b, &mut h[0]).unwrap();
            half.apply(&b, &mut h[1]).unwrap();
            csr.apply(&b, &mut h[2]).unwrap();
            let unpack =
                |w: u32| Vec2::new(f16::from_bits(w as u16).to_f32(), f16::from_bits((w >> 16) as u16).to_f32());
            for (i, _) in h[0].iter().enumerate() {
                let row = i as u32;
                let n = columns as u32;
                let expected = [
                    gather_row(row, n, &dense.values, &b),
                    gather_row_packed(row, n, &half.words, &b, unpack),
                    gather_row_sparse(row, &csr.row_start, &csr.column_index, &csr.values, &b),
                ];
                for k in 0..3 {
                    // Other order of the sums: a few roundings of a sum of up to 2500 terms.
                    let difference = (h[k][i] - expected[k]).abs().max_element();
                    assert!(difference <= 4e-6 * expected[k].max_element(), "form {k}, row {i}: {difference}");
                }
            }
            assert!((h[0][0].x - 1.001 * h[0][0].x).abs() >= 4e-6 * h[0][0].x || h[0][0].x == 0.0);
            assert!(dense.apply(&b[1..], &mut h[0]).is_err());
        }
    }
}
