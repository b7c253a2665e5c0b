//! The same results with `std` (as `cargo test --workspace` builds the crates) and without (`cargo test -p one-core`).

/// The rounded results differ by single precision in sums of a hundred terms.
const TOLERANCE: f32 = 1e-4;

#[test]
fn results_are_those_with_std() {
    let found = one_core::light().unwrap();
    println!("threads: {}", scene::parallel::PARALLEL_ENABLED);
    println!("{found:#?}");
    if std::env::var_os("REQUIRE_ONE_CORE").is_some() {
        assert!(!scene::parallel::PARALLEL_ENABLED, "the crates were built with `std`");
    }
    assert_eq!(found.exact, EXACT);
    for ((name, found), (expected_name, expected)) in found.rounded.iter().zip(ROUNDED) {
        assert_eq!(*name, expected_name);
        assert!((found / expected - 1.0).abs() < TOLERANCE, "{name}: {found} in place of {expected}");
    }
}

const EXACT: [(&str, u32); 0] = [];
const ROUNDED: [(&str, f32); 0] = [];
