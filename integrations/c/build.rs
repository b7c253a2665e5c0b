//! Does nothing. With it, and with the features of `syn` and `once_cell` that the Python package asks for, both bindings have
//! the same crates in the same shape: what one has compiled, the other finds.
fn main() {
    println!("cargo::rerun-if-changed=build.rs");
}
