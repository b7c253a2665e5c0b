//! Which entries of a matrix are the largest, for the encoder of blocks.

use alloc::vec;
use alloc::vec::Vec;

use glam::{UVec2, Vec3};
use half::f16;
use scene::parallel::*;

use crate::error::Error;
use crate::host::order::MatrixRows;

/// Rows one task looks through.
const TASK: usize = 64;

/// Greatest channel, the measure of an entry.
pub(in crate::host) fn magnitude(color: Vec3) -> f32 {
    color.max_element()
}

/// The value that at most the share `share` of all entries exceed by their greatest channel: above it are the outliers.
/// Also the sum of the rows, and the greatest entry of all.
pub(in crate::host) struct Extremes {
    /// Entries above it are outliers.
    pub threshold: f32,
    /// Greatest channel of all.
    pub largest: f32,
}

/// Counts of one half of the bits of magnitudes.
struct Counts {
    counts: Vec<u64>,
    largest: f32,
    /// First entry that is not a number ≥ 0, with its channel's value.
    wrong: Option<(usize, f32)>,
}

impl Counts {
    fn new() -> Self {
        Self { counts: vec![0; 1 << 16], largest: 0.0, wrong: None }
    }

    /// Counts magnitudes of rows; `key` says which count a magnitude's bits belong to.
    fn of(n: usize, rows: &MatrixRows, key: impl Fn(u32) -> Option<u32> + Sync) -> Self {
        let one_task = |mut sums: Self, task: usize| {
            let mut row = vec![Vec3::ZERO; n];
            for i in task * TASK..((task + 1) * TASK).min(n) {
                rows(i, &mut row);
                for (j, &color) in row.iter().enumerate() {
                    let low = color.min_element();
                    let value = magnitude(color);
                    if !(low >= 0.0 && value.is_finite() && color.is_finite()) {
                        let channel = color.to_array().into_iter().find(|c| !(c.is_finite() && *c >= 0.0));
                        let wrong = (i * n + j, channel.unwrap_or(value));
                        sums.wrong = Some(first(sums.wrong, wrong));
                        continue;
                    }
                    sums.largest = sums.largest.max(value);
                    if let Some(k) = key(value.to_bits()) {
                        sums.counts[k as usize] += 1;
                    }
                }
            }
            sums
        };
        (0..n.div_ceil(TASK)).into_par_iter().par_fold_reduce(Self::new, one_task, |mut a, b| {
            for (a, b) in a.counts.iter_mut().zip(&b.counts) {
                *a += b;
            }
            a.largest = a.largest.max(b.largest);
            a.wrong = b.wrong.map_or(a.wrong, |wrong| Some(first(a.wrong, wrong)));
            a
        })
    }

    /// The greatest key above which are no more than `limit` entries, and how many are above it.
    fn select(&self, limit: u64) -> (u32, u64) {
        let mut above = 0;
        for (key, count) in self.counts.iter().enumerate().skip(1).rev() {
            if above + count > limit {
                return (key as u32, above);
            }
            above += count;
        }
        (0, above)
    }
}

fn first(a: Option<(usize, f32)>, b: (usize, f32)) -> (usize, f32) {
    match a {
        Some(a) if a.0 < b.0 => a,
        _ => b,
    }
}

/// Finds the threshold in two passes over the rows: by the upper, then by the lower half of the bits, which order
/// numbers ≥ 0 as their values do. Nothing is sorted, and no more than 1 MB a thread is held.
///
/// # Errors
/// [`transport::Error::Value`] names the first entry that is negative or no number.
pub(in crate::host) fn find_extremes(n: usize, rows: &MatrixRows, share: f64) -> Result<Extremes, Error> {
    let limit = (share * n as f64 * n as f64) as u64;
    let coarse = Counts::of(n, rows, |bits| Some(bits >> 16));
    if let Some((index, value)) = coarse.wrong {
        return Err(
            transport::Error::Value { name: "matrix", index, value: f64::from(value), rule: "a number ≥ 0" }.into()
        );
    }
    let (upper, above) = coarse.select(limit);
    let fine = Counts::of(n, rows, |bits| (bits >> 16 == upper).then_some(bits & 0xffff));
    let (lower, _) = fine.select(limit - above);
    Ok(Extremes { threshold: f32::from_bits(upper << 16 | lower), largest: coarse.largest })
}

/// An entry of the table; the value is rounded to halves.
pub(in crate::host) fn pack(column: u32, value: Vec3) -> UVec2 {
    let half = |x: f32| u32::from(f16::from_f32(x).to_bits());
    UVec2::new(column | half(value.x) << 16, half(value.y) | half(value.z) << 16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::sampling::{hash3, unit};

    #[test]
    fn the_threshold_is_the_one_that_sorting_finds() {
        let n = 150;
        let value = |i: usize, j: usize| unit(hash3(i as u32, j as u32, 7)).powi(9);
        let rows = |i: usize, row: &mut [Vec3]| {
            for (j, color) in row.iter_mut().enumerate() {
                *color = Vec3::new(0.5, 0.25, 1.0) * value(i, j);
            }
        };
        let mut sorted: Vec<f32> = (0..n * n).map(|k| value(k / n, k % n)).collect();
        sorted.sort_by(f32::total_cmp);
        for share in [0.0, 0.01, 0.05, 0.5] {
            let found = find_extremes(n, &rows, share).unwrap();
            assert_eq!(found.threshold, sorted[n * n - 1 - (share * (n * n) as f64) as usize]);
            assert_eq!(found.largest, sorted[n * n - 1]);
        }
        assert_eq!(find_extremes(n, &rows, 1.0).unwrap().threshold, 0.0);
    }

    #[test]
    fn equal_entries_are_no_outliers() {
        let rows = |_: usize, row: &mut [Vec3]| row.fill(Vec3::splat(0.25));
        assert_eq!(find_extremes(9, &rows, 0.05).unwrap().threshold, 0.25);
    }

    #[test]
    fn the_first_wrong_entry_is_named() {
        for bad in [f32::NAN, -1.0, f32::INFINITY] {
            let rows = |i: usize, row: &mut [Vec3]| {
                row.fill(Vec3::ONE);
                if i >= 100 {
                    row[3].y = bad;
                }
            };
            let Err(error) = find_extremes(130, &rows, 0.05) else { panic!("{bad} passes") };
            assert!(
                matches!(error, Error::Shared(transport::Error::Value { name: "matrix", index: 13_003, .. })),
                "{error}"
            );
        }
    }
}
