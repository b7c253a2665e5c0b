//! Sums in fixed point: 64 bits in two words. Integers can be added in any order with the same sum, and by 32-bit
//! atomics, which every device has.

use crate::types::Fixed;

/// Units of one, 2²⁰: a value is rounded by at most 2⁻²¹.
pub const UNITS: f32 = 1_048_576.0;
/// The greatest value that is added at once, 2²⁴; what is greater counts as this. Sums stay below 2⁴⁴.
pub const MAX_VALUE: f32 = 16_777_216.0;
/// Numbers of a word, 2³².
const WORD: f32 = 4_294_967_296.0;
/// Whole units from here on, 2²³: such a value has no fraction to round.
const WHOLE: f32 = 8_388_608.0;

/// A value in fixed point, rounded to the nearest; 0 for what is below 0 and for what is no number.
#[inline]
pub fn fixed(value: f32) -> Fixed {
    let positive = if value > 0.0 { value } else { 0.0 };
    let units = UNITS * if positive < MAX_VALUE { positive } else { MAX_VALUE };
    let rounded = if units < WHOLE { units + 0.5 } else { units };
    let high = (rounded * (1.0 / WORD)) as u32;
    Fixed { low: (rounded - high as f32 * WORD) as u32, high }
}

/// Carry into a sum's high word when `added` goes to its low word, which was `before`: 1 if the low word overflows.
#[inline]
pub fn carry(before: u32, added: u32) -> u32 {
    (before.wrapping_add(added) < added) as u32
}

/// The sum of two numbers.
#[inline]
pub fn plus(a: Fixed, b: Fixed) -> Fixed {
    let high = a.high.wrapping_add(b.high).wrapping_add(carry(a.low, b.low));
    Fixed { low: a.low.wrapping_add(b.low), high }
}

/// The number, to a relative 2⁻²³.
#[inline]
pub fn to_float(sum: Fixed) -> f32 {
    sum.high as f32 * (WORD / UNITS) + sum.low as f32 * (1.0 / UNITS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn units(sum: Fixed) -> u64 {
        u64::from(sum.high) << 32 | u64::from(sum.low)
    }

    #[test]
    fn values_are_rounded_to_the_nearest_unit_and_great_ones_are_exact() {
        for k in 0..4000 {
            let value = 1.01f32.powi(k - 2400);
            let exact = f64::from(value.min(MAX_VALUE)) * f64::from(UNITS);
            let error = (units(fixed(value)) as f64 - exact).abs();
            assert!(error <= 0.500_001, "{value}: {error}");
            assert!(value < 8.0 || error == 0.0, "{value}: {error}");
        }
        for nothing in [0.0, -0.0, -3.0, f32::NAN, f32::NEG_INFINITY, f32::MIN_POSITIVE] {
            assert_eq!(fixed(nothing), Fixed::default());
        }
        assert_eq!(units(fixed(f32::INFINITY)), 1 << 44);
    }

    #[test]
    fn sums_of_words_are_those_of_64_bits() {
        let number = |k: u32| scene::sampling::hash3(k, 7, 3);
        let mut sum = Fixed::default();
        let mut expected = 0u64;
        for k in 0..10_000 {
            let more = Fixed { low: number(k), high: number(k + 10_000) >> 16 };
            assert_eq!(carry(sum.low, more.low) == 1, sum.low.checked_add(more.low).is_none());
            (sum, expected) = (plus(sum, more), expected + units(more));
        }
        assert_eq!(units(sum), expected);
        let found = f64::from(to_float(sum));
        let exact = expected as f64 / f64::from(UNITS);
        assert!((found / exact - 1.0).abs() < 2f64.powi(-23), "{found} {exact}");
    }

    #[test]
    fn as_many_photons_as_may_be_do_not_overflow_a_sum() {
        // 2³³ photons with 20 segments each, of blue light, one unit of which has a luminance of 0.0722, all on one
        // cell.
        let photons = crate::MAX_PHOTONS as f64;
        let segments = 20.0;
        let blue = 1.0 / 0.0722;
        let room = 2f64.powi(64) / f64::from(UNITS);
        assert!(photons * segments * blue < 0.25 * room);
        // With 24 bits behind the point they would.
        assert!(photons * segments * blue > room / 16.0);
    }
}
