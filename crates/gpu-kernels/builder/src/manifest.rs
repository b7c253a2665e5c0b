//! `spv/manifest.toml`: from what the modules were made, so that a test without the compiler can tell whether they are
//! fresh.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::compile::{Compiled, TARGET};

/// Name of the manifest in the folder of the modules.
pub const FILE: &str = "manifest.toml";
/// Version of the compiler's driver and backend; Cargo.toml pins the same.
const SPIRV_BUILDER: &str = "0.10.0-alpha.1";
/// Packages of the root lock file whose code is compiled into the modules.
const PACKAGES: [&str; 4] = ["bytemuck", "glam", "libm", "spirv-std"];

#[derive(Serialize)]
struct Manifest {
    toolchain: &'static str,
    target: &'static str,
    spirv_builder: &'static str,
    spirv_opt: String,
    packages: BTreeMap<String, String>,
    sources: BTreeMap<String, String>,
    modules: BTreeMap<String, String>,
}

/// The manifest of a compilation as TOML.
pub fn write(root: &Path, compiled: &Compiled) -> Result<String> {
    let mut sources = BTreeMap::new();
    for file in &compiled.sources {
        let bytes = fs::read(root.join(file)).with_context(|| file.display().to_string())?;
        sources.insert(file.to_string_lossy().replace('\\', "/"), hash(&bytes));
    }
    let manifest = Manifest {
        toolchain: compiled.toolchain,
        target: TARGET,
        spirv_builder: SPIRV_BUILDER,
        spirv_opt: optimiser()?,
        packages: packages(root)?,
        sources,
        modules: compiled.modules.iter().map(|(name, bytes)| (name.clone(), hash(bytes))).collect(),
    };
    Ok(format!(
        "# Written by ../builder; do not edit. SHA-256 of every source and module.\n{}",
        toml::to_string(&manifest)?
    ))
}

fn hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Release of the optimiser: the first two words of what it says of itself, such as `SPIRV-Tools v2023.1`.
fn optimiser() -> Result<String> {
    let output = Command::new("spirv-opt").arg("--version").output().context("spirv-opt (Debian: spirv-tools)")?;
    let text = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&text);
    let words: Vec<&str> = text.split_whitespace().take(2).collect();
    Ok(words.join(" "))
}

fn packages(root: &Path) -> Result<BTreeMap<String, String>> {
    #[derive(Deserialize)]
    struct Lock {
        package: Vec<Package>,
    }
    #[derive(Deserialize)]
    struct Package {
        name: String,
        version: String,
    }
    let lock: Lock = toml::from_str(&fs::read_to_string(root.join("Cargo.lock"))?)?;
    Ok(lock.package.into_iter().filter(|p| PACKAGES.contains(&p.name.as_str())).map(|p| (p.name, p.version)).collect())
}
