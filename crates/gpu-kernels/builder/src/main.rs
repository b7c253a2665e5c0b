//! Compiles the crates of kernels to SPIR-V: sources → `spv/*.spv` of each, one file per entry point, and
//! `spv/manifest.toml`.
//!
//! ```text
//! cargo run --release             compile and write
//! cargo run --release -- --check  compile into a temporary folder and compare: exit status 1 names what differs
//! ```
//!
//! The compiler is the toolchain `rust-gpu-1.96` of `../shared/rust-gpu` when it is installed. Elsewhere take the
//! public one, which compiles the backend together with the builder:
//!
//! ```text
//! rustup toolchain install nightly-2026-04-11 -c rust-src,rustc-dev,llvm-tools
//! cargo +nightly-2026-04-11 run --release --features public-toolchain
//! ```
//!
//! Both need `spirv-opt` and `spirv-val` (Debian: spirv-tools) in the path.

mod compile;
mod decorate;
mod manifest;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};

use compile::Compiled;

/// Compiled modules by file name.
type Modules = BTreeMap<String, Vec<u8>>;

fn main() -> ExitCode {
    match run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn run() -> Result<bool> {
    let check = match std::env::args().skip(1).collect::<Vec<_>>().as_slice() {
        [] => false,
        [flag] if flag == "--check" => true,
        other => bail!("unknown arguments {other:?}; the only one is --check"),
    };
    // At run time: a binary from a shared target folder may have been compiled elsewhere.
    let builder = std::env::var_os("CARGO_MANIFEST_DIR").context("start the builder with cargo run")?;
    let builder = Path::new(&builder);
    let root: PathBuf = builder.join("../../..").canonicalize()?;
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| builder.join("target"), PathBuf::from);
    // The crate of the laboratory links the library's own, whose entry points it therefore has, too: one compilation
    // for both.
    let compiled = compile::compile(&root.join(LAB), &root, &target)?;
    let (lab, own) = compiled.split(&root.join(LAB))?;
    let is_fresh = [finish(&root, OWN, &own, check)?, finish(&root, LAB, &lab, check)?];
    Ok(is_fresh == [true, true])
}

/// Crates of kernels, from the root of the workspace: the library's, and the laboratory's above it.
const OWN: &str = "crates/gpu-kernels";
const LAB: &str = "lab/kernels";

/// Writes the modules of a crate, or compares them.
fn finish(root: &Path, kernels: &str, compiled: &Compiled, check: bool) -> Result<bool> {
    let folder = root.join(kernels).join("spv");
    let manifest = manifest::write(root, compiled)?;
    if check {
        return Ok(compare(&folder, &compiled.modules, &manifest)?.is_empty());
    }
    fs::create_dir_all(&folder)?;
    for entry in fs::read_dir(&folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name.ends_with(".spv") && !compiled.modules.contains_key(&name) {
            fs::remove_file(&path)?;
            println!("removed {name}");
        }
    }
    for (name, bytes) in &compiled.modules {
        fs::write(folder.join(name), bytes)?;
        println!("{name}: {} bytes", bytes.len());
    }
    fs::write(folder.join(manifest::FILE), manifest)?;
    Ok(true)
}

/// Names every difference between what was just compiled and what lies in the folder.
fn compare(folder: &Path, modules: &Modules, manifest: &str) -> Result<Vec<String>> {
    let mut differences = Vec::new();
    for (name, bytes) in modules {
        match fs::read(folder.join(name)) {
            Ok(found) if found == *bytes => {}
            Ok(_) => differences.push(format!("{name}: the sources compile to other bytes")),
            Err(error) => differences.push(format!("{name}: {error}")),
        }
    }
    for entry in fs::read_dir(folder)? {
        let name = entry?.file_name().to_string_lossy().into_owned();
        if name.ends_with(".spv") && !modules.contains_key(&name) {
            differences.push(format!("{name}: no entry point of this name"));
        }
    }
    if fs::read_to_string(folder.join(manifest::FILE)).unwrap_or_default() != manifest {
        differences.push(format!("{}: not what the sources give", manifest::FILE));
    }
    for difference in &differences {
        println!("{difference}");
    }
    println!("{} modules compared, {} differences", modules.len(), differences.len());
    Ok(differences)
}
