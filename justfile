# One-line recipes for the usual commands; `just --list` prints them.

# Format, lints, no_std builds, docs.
check:
    cargo fmt --all --check
    cargo clippy --workspace --all-targets -- -D warnings
    cargo check $(.ci/method-crates) --no-default-features
    cargo check -p one-core --target x86_64-unknown-none
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps

# All tests; Vulkan tests skip without a device.
test:
    cargo test --workspace

# All tests; a missing Vulkan device fails.
test-vulkan:
    REQUIRE_VULKAN=1 cargo test --workspace

# Rebuild the committed SPIR-V modules.
spv:
    cd crates/gpu-kernels/builder && cargo run --release

# Fail if a rebuild would change a committed SPIR-V module.
spv-check:
    cd crates/gpu-kernels/builder && cargo run --release -- --check

# Criterion benches: bandwidth of the dense and of the receivers' product, rays a second, scaling of patches and lookups.
bench:
    cargo bench

# Read damaged files of every format: none may make a reader panic, hang or fill the memory.
mutate COUNT="100000":
    cargo run --release -p integration-tests --bin mutate -- {{COUNT}}

# The default demo: pictures and out/report.html.
demo:
    cargo run --release

# Package every crate that can be published, build each from its package, and use three of them from outside.
package:
    .ci/package

# The book, into target/book.
book:
    mdbook build docs/book

# The page of integrations/web in page/dist: the module, its scenes, their bakes.
web:
    cd integrations/web && npm ci && npm run page

# That page at a port of this machine.
web-serve PORT="8000":
    python3 -m http.server {{PORT}} --bind 127.0.0.1 --directory integrations/web/page/dist
