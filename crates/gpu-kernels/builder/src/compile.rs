//! Runs the compiler and the passes after it.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use spirv_builder::{ModuleResult, ShaderPanicStrategy, SpirvBuilder, SpirvMetadata};

use crate::Modules;
use crate::decorate::forbid_contraction;

/// Target of every module.
pub const TARGET: &str = "spirv-unknown-vulkan1.2";
/// The toolchain of `../shared/rust-gpu`.
const LOCAL_TOOLCHAIN: &str = "rust-gpu-1.96";
/// The public toolchain that the same backend asks for.
const PUBLIC_TOOLCHAIN: &str = "nightly-2026-04-11";

/// Result of a compilation.
pub struct Compiled {
    /// Modules by file name, `<entry point>.spv`.
    pub modules: Modules,
    /// Compiler that was used.
    pub toolchain: &'static str,
    /// Every source file of this workspace that went in, relative to its root.
    pub sources: BTreeSet<PathBuf>,
}

impl Compiled {
    /// Splits into the kernels declared by the laboratory's crate in a folder, with all sources, and those of the
    /// library's crates.
    pub fn split(self, lab: &Path) -> Result<(Self, Self)> {
        let mut declared = String::new();
        for entry in fs::read_dir(lab.join("src"))? {
            declared += &fs::read_to_string(entry?.path())?;
        }
        let is_of_lab = |file: &str| declared.contains(&format!("\"{}\"(", file.trim_end_matches(".spv")));
        let (of_lab, own) = self.modules.into_iter().partition(|(file, _)| is_of_lab(file));
        let sources = self.sources.iter().filter(|file| !file.starts_with("lab")).cloned().collect();
        let own = Self { modules: own, toolchain: self.toolchain, sources };
        Ok((Self { modules: of_lab, toolchain: self.toolchain, sources: self.sources }, own))
    }
}

/// Compiles the kernel crate, one module per entry point, decorated and optimised.
pub fn compile(kernels: &Path, root: &Path, target: &Path) -> Result<Compiled> {
    let mut builder = SpirvBuilder::new(kernels, TARGET);
    builder.multimodule = true;
    builder.spirv_metadata = SpirvMetadata::None;
    builder.shader_panic_strategy = ShaderPanicStrategy::SilentExit;
    builder.shader_crate_features.default_features = false;
    builder.build_script.defaults = false;
    // The optimiser runs after the decorations: see forbid_contraction.
    builder.extra_args.push("--no-spirv-opt".into());
    builder.target_dir_path = Some(target.join("spirv"));
    // Other bytes may come out of another compiler: the manifest names it.
    let toolchain = if cfg!(feature = "public-toolchain") { PUBLIC_TOOLCHAIN } else { LOCAL_TOOLCHAIN };
    builder.toolchain_overwrite = Some(toolchain.into());
    if !cfg!(feature = "public-toolchain") {
        let home = std::env::var_os("HOME").context("HOME is not set")?;
        let backend = Path::new(&home).join(".cache").join(LOCAL_TOOLCHAIN).join("lib/librustc_codegen_spirv.so");
        ensure!(
            backend.is_file(),
            "the backend {} is missing: run ../shared/rust-gpu/install, or use the feature public-toolchain \
             (builder/src/main.rs says how)",
            backend.display()
        );
        builder.rustc_codegen_spirv_location = Some(backend);
    }
    let result = builder.build().context("compiling the kernels")?;
    let ModuleResult::MultiModule(files) = &result.module else { bail!("the compiler gave a single module") };

    let work = tempfile::tempdir()?;
    let mut modules = Modules::new();
    for (entry, path) in files {
        modules.insert(format!("{entry}.spv"), finish(work.path(), entry, &fs::read(path)?)?);
    }
    let name = package(kernels)?.replace('-', "_");
    let depfile = target.join("spirv").join(TARGET).join(format!("release/{name}.spv.d"));
    Ok(Compiled { modules, toolchain, sources: sources(&depfile, root)? })
}

/// The name of the package in a folder.
fn package(folder: &Path) -> Result<String> {
    let path = folder.join("Cargo.toml");
    let manifest: toml::Table = fs::read_to_string(&path)?.parse().with_context(|| path.display().to_string())?;
    let name = manifest.get("package").and_then(|package| package.get("name")).and_then(toml::Value::as_str);
    Ok(name.with_context(|| format!("{} names no package", path.display()))?.to_owned())
}

/// Decorates, strips, optimises and validates one module.
fn finish(work: &Path, entry: &str, bytes: &[u8]) -> Result<Vec<u8>> {
    ensure!(bytes.len().is_multiple_of(4), "{entry}: not whole words");
    let words: Vec<u32> = bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let decorated: Vec<u8> = forbid_contraction(&words).iter().flat_map(|w| w.to_le_bytes()).collect();
    let input = work.join("in.spv");
    let output = work.join("out.spv");
    fs::write(&input, decorated)?;
    run(Command::new("spirv-opt").args(["--strip-debug", "-O"]).arg(&input).arg("-o").arg(&output), entry)?;
    run(Command::new("spirv-val").args(["--target-env", "vulkan1.2"]).arg(&output), entry)?;
    Ok(fs::read(output)?)
}

fn run(command: &mut Command, entry: &str) -> Result<()> {
    let tool = command.get_program().to_string_lossy().into_owned();
    let output = command.output().with_context(|| format!("{tool} (Debian: spirv-tools) does not start"))?;
    ensure!(output.status.success(), "{tool} refuses {entry}: {}", String::from_utf8_lossy(&output.stderr));
    Ok(())
}

/// The files of this workspace that the compiler read, from the dependency file beside its output, and the manifests of
/// their crates.
fn sources(depfile: &Path, root: &Path) -> Result<BTreeSet<PathBuf>> {
    let text = fs::read_to_string(depfile).with_context(|| depfile.display().to_string())?;
    let (_, files) = text.split_once(": ").context("the dependency file names no files")?;
    let mut sources = BTreeSet::new();
    // Paths with blanks are written with a backslash before each.
    for file in files.replace("\\ ", "\0").split_whitespace() {
        let file = PathBuf::from(file.replace('\0', " "));
        let Ok(file) = file.strip_prefix(root) else { continue };
        if file.extension().is_none_or(|e| e != "rs") || !(file.starts_with("crates") || file.starts_with("lab")) {
            continue;
        }
        let manifest: PathBuf = file.components().take(2).collect::<PathBuf>().join("Cargo.toml");
        sources.extend([file.to_path_buf(), manifest]);
    }
    ensure!(!sources.is_empty(), "{} names no source of this workspace", depfile.display());
    Ok(sources)
}
