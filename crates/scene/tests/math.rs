//! Scalar maths against the standard library.

use patchlight_scene::math::{exp2, floor, log2, pow_unit};
use patchlight_scene::sampling::hash;

/// Numbers of every magnitude and sign, and those where rounding changes.
fn numbers() -> impl Iterator<Item = f32> {
    let special = [0.0, -0.0, 0.5, -0.5, 1.0, -1.0, 8_388_607.5, -8_388_607.5, 8_388_608.0, 3e9, -3e9, f32::INFINITY];
    (0..200_000).map(|k| f32::from_bits(hash(k))).filter(|x| !x.is_nan()).chain(special)
}

#[test]
fn floor_is_that_of_the_standard_library() {
    assert!(numbers().all(|x| floor(x) == x.floor()));
    assert!(floor(f32::NAN).is_nan());
    // Rounding towards zero is something else.
    assert!(numbers().any(|x| x.trunc() != x.floor()));
}

#[test]
fn powers_and_logarithms_are_those_of_the_standard_library() {
    let mut worst = [0.0_f64; 3];
    for x in numbers().map(f32::abs).filter(|x| x.is_normal()) {
        let exact = f64::from(x).log2();
        worst[0] = worst[0].max((f64::from(log2(x)) - exact).abs() / exact.abs().max(1.0));
    }
    for k in -126_000..127_000 {
        let x = k as f32 * 1e-3;
        let exact = f64::from(x).exp2();
        worst[1] = worst[1].max((f64::from(exp2(x)) / exact - 1.0).abs());
    }
    for k in 1..400_000 {
        let x = k as f32 * 1e-5;
        for y in [1.0 / 2.4, 1.0, 2.2, 2.4] {
            let exact = f64::from(x).powf(f64::from(y));
            worst[2] = worst[2].max((f64::from(pow_unit(x, y)) / exact - 1.0).abs());
        }
    }
    assert!(worst[0] < 3e-7 && worst[1] < 3e-7 && worst[2] < 1e-5, "{worst:?}");
    assert_eq!([log2(1.0), log2(8.0), log2(0.25)], [0.0, 3.0, -2.0]);
    assert_eq!([exp2(0.0), exp2(5.0), exp2(-3.0)], [1.0, 32.0, 0.125]);
    assert_eq!([pow_unit(0.0, 2.2), pow_unit(1.0, 2.2)], [0.0, 1.0]);
    // They grow with what they are of, so that no step shows in a ramp.
    let grey: Vec<f32> = (0..100_000).map(|k| pow_unit(k as f32 * 1e-5, 1.0 / 2.4)).collect();
    assert!(grey.windows(2).all(|pair| pair[0] <= pair[1]));
}
