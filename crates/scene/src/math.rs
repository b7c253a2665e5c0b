//! Scalar maths of the kernel bodies. What the GPU computes differently (rust-gpu maps `libm` calls to GLSL.std.450
//! instructions) is a polynomial of our own here, so that CPU and GPU give the same bits.

use core::f32::consts::{FRAC_PI_2, LN_2, LOG2_E, PI, TAU};

/// Square root; correctly rounded everywhere.
#[inline]
pub fn sqrt(x: f32) -> f32 {
    libm::sqrtf(x)
}

/// Largest whole number ≤ x. (−0 may become 0.)
#[inline]
pub fn floor(x: f32) -> f32 {
    #[cfg(target_arch = "spirv")]
    {
        libm::floorf(x)
    }
    // Rounding towards zero is one instruction on every processor, rounding down a call on some.
    #[cfg(not(target_arch = "spirv"))]
    {
        // From 2²³ on all numbers are whole; NaN compares with nothing.
        if abs(x) < 8_388_608.0 {
            let cut = x as i32 as f32;
            if cut > x { cut - 1.0 } else { cut }
        } else {
            x
        }
    }
}

/// Magnitude.
#[inline]
pub fn abs(x: f32) -> f32 {
    if x < 0.0 { -x } else { x }
}

/// log₂ x of a normal x > 0, within 3·10⁻⁷ of it or of 1, the same bits on CPU and GPU. x = 2ⁿ m with m about 1, and
/// ln m = 2 artanh((m − 1) / (m + 1)).
#[inline]
pub fn log2(x: f32) -> f32 {
    // Whole numbers that grow with x; √½ is where n changes.
    let n = (x.to_bits() as i32 - 0x3f35_04f3) >> 23;
    let m = f32::from_bits((x.to_bits() as i32 - (n << 23)) as u32);
    let s = (m - 1.0) / (m + 1.0);
    let q = s * s;
    let series = 1.0 + q * (1.0 / 3.0 + q * (1.0 / 5.0 + q * (1.0 / 7.0 + q * (1.0 / 9.0))));
    n as f32 + 2.0 * LOG2_E * s * series
}

/// 2ˣ for x from −126 to 127, within 3·10⁻⁷ of it (relative), the same bits on CPU and GPU.
#[inline]
pub fn exp2(x: f32) -> f32 {
    let n = floor(x + 0.5);
    let y = (x - n) * LN_2;
    let high = 1.0 / 24.0 + y * (1.0 / 120.0 + y * (1.0 / 720.0 + y * (1.0 / 5040.0)));
    let series = 1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * high)));
    series * f32::from_bits(((127 + n as i32) as u32) << 23)
}

/// x to the power y for x from 0 to 1000 and y from 0 to 8, within 10⁻⁵ of it (relative), the same bits on CPU and GPU;
/// 0 for what is below 10⁻³⁰.
#[inline]
pub fn pow_unit(x: f32, y: f32) -> f32 {
    if x < 1e-30 {
        return 0.0;
    }
    let power = y * log2(x);
    if power > -126.0 { exp2(power) } else { 0.0 }
}

/// x to the power y; 7·10⁻⁶ relative between CPU and GPU.
#[inline]
pub fn pow(x: f32, y: f32) -> f32 {
    libm::powf(x, y)
}

/// Tangent, for host set-up code.
#[inline]
pub fn tan(x: f32) -> f32 {
    libm::tanf(x)
}

/// Natural logarithm, for host code (the GPU's is 2·10⁻⁴ off near 1).
#[inline]
pub fn ln(x: f32) -> f32 {
    libm::logf(x)
}

/// e^(−x) for x ≥ 0, within 2·10⁻⁷ of it and 10⁻⁵ of small ones (relative), the same bits on CPU and GPU; 1 at 0, and 0
/// from 87 on.
#[inline]
pub fn exp_minus(x: f32) -> f32 {
    if x >= 87.0 {
        return 0.0;
    }
    let halvings = floor(x * LOG2_E + 0.5);
    // ln 2 in two parts: the first has so few digits that its multiples are exact.
    let y = x - halvings * 0.693_145_75 - halvings * 1.428_606_8e-6;
    let series =
        1.0 - y * (1.0 - y * (0.5 - y * (1.0 / 6.0 - y * (1.0 / 24.0 - y * (1.0 / 120.0 - y * (1.0 / 720.0))))));
    series * f32::from_bits((127 - halvings as u32) << 23)
}

/// (sin 2πx, cos 2πx) for x in [0, 1], within 2·10⁻⁷, the same bits on CPU and GPU. Taylor series on an eighth of a
/// circle.
#[inline]
pub fn sin_cos_2pi(x: f32) -> (f32, f32) {
    let quadrant = floor(4.0 * x + 0.5);
    let y = (x - 0.25 * quadrant) * TAU;
    let y2 = y * y;
    let s = y * (1.0 + y2 * (-1.0 / 6.0 + y2 * (1.0 / 120.0 + y2 * (-1.0 / 5040.0 + y2 * (1.0 / 362_880.0)))));
    let c = 1.0 + y2 * (-0.5 + y2 * (1.0 / 24.0 + y2 * (-1.0 / 720.0 + y2 * (1.0 / 40_320.0))));
    let q = quadrant as u32 & 3;
    if q == 0 {
        (s, c)
    } else if q == 1 {
        (c, -s)
    } else if q == 2 {
        (-s, -c)
    } else {
        (-c, s)
    }
}

/// Arc tangent of a in [0, 1], within 3·10⁻⁷: two half-angle steps bring the argument below 0.2, where the series
/// converges.
#[inline]
fn atan_unit(a: f32) -> f32 {
    let b = a / (1.0 + sqrt(1.0 + a * a));
    let c = b / (1.0 + sqrt(1.0 + b * b));
    let c2 = c * c;
    4.0 * c * (1.0 + c2 * (-1.0 / 3.0 + c2 * (0.2 + c2 * (-1.0 / 7.0 + c2 * (1.0 / 9.0 - c2 * (1.0 / 11.0))))))
}

/// Angle of the vector (x, y) in (−π, π], the same bits on CPU and GPU; 0 for the zero vector.
#[inline]
pub fn atan2(y: f32, x: f32) -> f32 {
    let ax = abs(x);
    let ay = abs(y);
    let big = if ax > ay { ax } else { ay };
    if big <= 0.0 {
        return 0.0;
    }
    let small = if ax > ay { ay } else { ax };
    let mut angle = atan_unit(small / big);
    if ay > ax {
        angle = FRAC_PI_2 - angle;
    }
    if x < 0.0 {
        angle = PI - angle;
    }
    if y < 0.0 { -angle } else { angle }
}

/// Angle whose cosine is x, x clamped to [−1, 1], the same bits on CPU and GPU.
#[inline]
pub fn acos(x: f32) -> f32 {
    let x = clamp(x, -1.0, 1.0);
    atan2(sqrt((1.0 - x) * (1.0 + x)), x)
}

/// x limited to [low, high]; `low` for NaN.
#[inline]
pub fn clamp(x: f32, low: f32, high: f32) -> f32 {
    if x > high {
        high
    } else if x > low {
        x
    } else {
        low
    }
}

/// Luminance of linear Rec.709 RGB.
#[inline]
pub fn luminance(c: glam::Vec3) -> f32 {
    0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z
}

#[cfg(test)]
mod tests {
    #[test]
    fn polynomials_agree_with_double_precision() {
        for k in 0..=100_000u32 {
            let x = k as f32 / 100_000.0;
            let (s, c) = super::sin_cos_2pi(x);
            let (es, ec) = (f64::from(x) * core::f64::consts::TAU).sin_cos();
            assert!((f64::from(s) - es).abs() < 3e-7 && (f64::from(c) - ec).abs() < 3e-7, "{x}: {s} {c}");
            let angle = super::atan2(s, c);
            let expected = f64::from(s).atan2(f64::from(c));
            // Half a circle is the same angle with either sign.
            let difference = (f64::from(angle) - expected).abs();
            assert!(difference.min((difference - core::f64::consts::TAU).abs()) < 8e-7, "{x}: {angle} {expected}");
            let cosine = 2.0 * x - 1.0;
            assert!((f64::from(super::acos(cosine)) - f64::from(cosine).acos()).abs() < 8e-7, "{cosine}");
        }
        for k in 0..870_000u32 {
            let x = k as f32 * 1e-4;
            let found = f64::from(super::exp_minus(x));
            let expected = (-f64::from(x)).exp();
            assert!(
                (found - expected).abs() < 2e-7 && (found / expected - 1.0).abs() < 1e-5,
                "{x}: {found} {expected}"
            );
        }
        assert_eq!((super::exp_minus(0.0), super::exp_minus(87.0), super::exp_minus(f32::INFINITY)), (1.0, 0.0, 0.0));
        assert_eq!(super::atan2(0.0, 0.0), 0.0);
        assert_eq!(super::clamp(f32::NAN, 0.0, 1.0), 0.0);
    }
}
