//! Equal results with `std` (as `cargo test --workspace` builds the crates) and without (`cargo test -p one-core`).

/// The rounded results differ by single precision in sums of a hundred terms.
const TOLERANCE: f32 = 1e-4;

#[test]
fn results_are_those_with_std() {
    let found = one_core::light().unwrap();
    println!("threads: {}", scene::parallel::PARALLEL_ENABLED);
    println!("{found:#?}");
    let is_required = std::env::var_os("REQUIRE_ONE_CORE").is_some();
    assert!(!(is_required && scene::parallel::PARALLEL_ENABLED), "the crates were built with `std`");
    assert_eq!(found.exact, EXACT);
    for ((name, found), (expected_name, expected)) in found.rounded.iter().zip(ROUNDED) {
        assert_eq!(*name, expected_name);
        assert!((found / expected - 1.0).abs() < TOLERANCE, "{name}: {found} in place of {expected}");
    }
}

const EXACT: [(&str, u32); 14] = [
    ("clusters", 1037035158),
    ("voxel patches", 1972517454),
    ("polygons", 110597604),
    ("first exitance", 3728232857),
    ("factors by pairs", 3367841129),
    ("factors by rays", 1394335171),
    ("reciprocal factors", 2218802738),
    ("six bounces", 843614517),
    ("hit counts", 590406069),
    ("order", 2919953353),
    ("order of a world", 1785170414),
    ("sampled frames", 2442721897),
    ("sampled frames", 2442721897),
    ("photons", 3595751745),
];
/// Light by three solvers.
const ROUNDED: [(&str, f32); 3] = [("all bounces", 1.26075), ("low rank", 1.26075), ("round a camera", 1.26075)];
