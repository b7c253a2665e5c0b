//! Scalar maths against the standard library.

use patchlight_scene::math::floor;
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
