//! Roots and whole powers by the same operations on every device.

use scene::math::sqrt;

/// Newton's steps of a root: the first guess is a tenth off at most, and each step squares the error and trebles it.
const STEPS: u32 = 4;
/// Bits of 1.
const ONE: i32 = 0x3f80_0000;

/// x to the power n.
#[inline]
pub fn power(x: f32, n: u32) -> f32 {
    let mut result = 1.0;
    let mut square = x;
    let mut left = n;
    while left > 0 {
        if left & 1 == 1 {
            result *= square;
        }
        square *= square;
        left >>= 1;
    }
    result
}

/// Root of degree n of x ≥ 0, within 3·10⁻⁷ of it (relative); 0 of what is less.
#[inline]
pub fn root(x: f32, n: u32) -> f32 {
    if x <= 0.0 || n <= 1 {
        return if x <= 0.0 { 0.0 } else { x };
    }
    // The exponent divided: bits are about a logarithm.
    let bits = (x.to_bits() as i32 - ONE) / n as i32 + ONE;
    let mut y = f32::from_bits(bits as u32);
    let share = 1.0 / n as f32;
    for _ in 0..STEPS {
        y += (x / power(y, n - 1) - y) * share;
    }
    y
}

/// Square root of the power of degree n: of irradiance that is stored as its root of that degree.
#[inline]
pub fn half_power(x: f32, n: u32) -> f32 {
    let whole = power(x, n / 2);
    if n & 1 == 1 { whole * sqrt(x) } else { whole }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roots_are_undone_by_powers() {
        for n in 1..=16 {
            for k in 0..200 {
                let x = 1e-6 * 1.2f32.powi(k);
                let back = f64::from(root(x, n)).powi(n as i32) / f64::from(x);
                assert!((back - 1.0).abs() < 3e-7 * f64::from(n) + 1e-6, "{n}: {x} {back}");
                let half = f64::from(half_power(root(x, n), n)).powi(2) / f64::from(x);
                assert!((half - 1.0).abs() < 1e-5, "{n}: {x} {half}");
            }
        }
        assert_eq!((root(0.0, 5), root(-1.0, 5), root(-1.0, 1)), (0.0, 0.0, 0.0));
    }

    #[test]
    fn powers_are_products() {
        assert_eq!((power(3.0, 0), power(3.0, 5), power(2.0, 10)), (1.0, 243.0, 1024.0));
    }
}
