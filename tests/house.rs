//! The shape of the project: which crate may know which, and that words of the glossary are the only ones in use.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// Stands for all method crates: those that build without `std`, above `scene` and `transport`.
const METHODS: &str = "(methods)";

/// Crates of the project that each crate may depend on directly; those of a method, on `scene` and `transport`. The
/// picture is that of ARCHITECTURE.md.
const ARROWS: [(&str, &[&str]); 19] = [
    ("scene", &[]),
    ("transport", &["scene"]),
    (METHODS, &["scene", "transport"]),
    ("ddgi", &["scene"]),
    ("printed", &["scene", "transport", "formfactor", "patches", "multibounce", "localmatrix", "patchlight"]),
    ("solvers", &["scene", "transport", "formfactor", "runtime", "patchlight"]),
    ("lab-kernels", &["scene", "ddgi", "gpu-kernels"]),
    ("opponents", &["scene", "ddgi", "reference"]),
    ("gpu-kernels", &["scene", "transport", METHODS]),
    ("runtime", &["scene", "transport", METHODS, "gpu-kernels"]),
    ("patchlight", &["scene", "transport", METHODS, "gpu-kernels", "runtime"]),
    ("one-core", &["scene", "transport", METHODS]),
    ("assets", &["scene"]),
    ("reference", &["scene"]),
    ("shell", LIBRARY),
    ("cli", LIBRARY_AND_SHELL),
    ("bench", &["experiments", "shell"]),
    ("view", &["shell", "scene", "transport", "temporal", "runtime", "patchlight", "assets", "reference"]),
    ("experiments", EVERYTHING),
];

const LIBRARY: &[&str] = &["scene", "transport", METHODS, "runtime", "patchlight", "assets", "reference"];

const LIBRARY_AND_SHELL: &[&str] =
    &["scene", "transport", METHODS, "runtime", "patchlight", "assets", "reference", "shell"];

const EVERYTHING: &[&str] = &[
    "scene",
    "transport",
    METHODS,
    "gpu-kernels",
    "runtime",
    "patchlight",
    "assets",
    "reference",
    "shell",
    "ddgi",
    "lab-kernels",
    "opponents",
    "printed",
    "solvers",
];

/// Crates that may depend on all others: tests and measurements.
const ABOVE_ALL: [&str; 2] = ["integration-tests", "benches"];

/// Words that a library must not know: command lines, terminals, reports, files of scenes.
const NOT_IN_LIBRARIES: [&str; 9] =
    ["clap", "indicatif", "ctrlc", "maud", "gltf", "tobj", "toml", "assets", "reference"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A crate of the workspace.
#[derive(Default)]
struct Crate {
    /// Direct dependencies, without those of its tests.
    dependencies: BTreeSet<String>,
    is_method: bool,
}

/// The crates of the workspace by their names.
fn workspace() -> BTreeMap<String, Crate> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let output = Command::new(cargo)
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(root())
        .output()
        .expect("cargo starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("cargo metadata is JSON");
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    // Packages are patchlight-<folder>, which says nothing here.
    let text = |value: &Value| {
        let name = value.as_str().unwrap_or_default();
        name.strip_prefix("patchlight-").unwrap_or(name).to_owned()
    };
    let mut crates = BTreeMap::new();
    for package in list(&metadata["packages"]) {
        let name = text(&package["name"]);
        let normal = list(&package["dependencies"]).into_iter().filter(|d| d["kind"].is_null());
        let dependencies = normal.map(|d| text(&d["name"])).collect();
        let is_no_std = list(&package["categories"]).iter().any(|category| category == "no-std");
        let is_method = is_no_std && !["scene", "transport", "gpu-kernels"].contains(&name.as_str());
        crates.insert(name, Crate { dependencies, is_method });
    }
    crates
}

/// What the picture allows a crate; `None` for one that is not in it.
fn allowed(name: &str, crates: &BTreeMap<String, Crate>) -> Option<Vec<String>> {
    let row = if crates[name].is_method { METHODS } else { name };
    let (_, names) = ARROWS.into_iter().find(|(known, _)| *known == row)?;
    let methods = crates.iter().filter(|(_, it)| it.is_method && names.contains(&METHODS));
    Some(names.iter().map(ToString::to_string).chain(methods.map(|(method, _)| method.clone())).collect())
}

/// Arrows that the picture does not have.
fn wrong_arrows(crates: &BTreeMap<String, Crate>) -> Vec<String> {
    let mut wrong = Vec::new();
    for (name, it) in crates {
        let Some(allowed) = allowed(name, crates) else { continue };
        for other in it.dependencies.iter().filter(|d| crates.contains_key(*d)) {
            if !allowed.contains(other) {
                wrong.push(format!("{name} -> {other}"));
            }
        }
    }
    wrong
}

#[test]
fn arrows_are_those_of_the_picture() {
    let mut crates = workspace();
    assert_eq!(wrong_arrows(&crates), Vec::<String>::new());
    for name in crates.keys().filter(|name| !ABOVE_ALL.contains(&name.as_str())) {
        assert!(allowed(name, &crates).is_some(), "{name} is not in the picture");
    }
    assert!(crates.values().filter(|it| it.is_method).count() >= 6, "categories are read");
    // An arrow between two methods is noticed.
    crates.entry("temporal".into()).or_default().dependencies.insert("patches".into());
    assert_eq!(wrong_arrows(&crates), ["temporal -> patches"]);
}

/// Crates of the laboratory.
const LABORATORY: [&str; 6] = ["ddgi", "lab-kernels", "opponents", "printed", "solvers", "experiments"];

/// Crates of the library, or programs without experiments, that know the laboratory.
fn who_knows_the_laboratory(crates: &BTreeMap<String, Crate>) -> Vec<String> {
    let above = |name: &str| LABORATORY.contains(&name) || ["bench", "benches", "integration-tests"].contains(&name);
    let knows = |it: &Crate| LABORATORY.iter().any(|lab| it.dependencies.contains(*lab));
    let below = crates.iter().filter(|(name, it)| !above(name) && knows(it));
    below.map(|(name, _)| name.clone()).collect()
}

#[test]
fn nothing_below_knows_the_laboratory() {
    let mut crates = workspace();
    assert_eq!(who_knows_the_laboratory(&crates), Vec::<String>::new());
    crates.entry("patchlight".into()).or_default().dependencies.insert("opponents".into());
    assert_eq!(who_knows_the_laboratory(&crates), ["patchlight"]);
}

#[test]
fn libraries_know_no_command_line() {
    let crates = workspace();
    for library in ["runtime", "patchlight"] {
        for unwanted in NOT_IN_LIBRARIES {
            assert!(!crates[library].dependencies.contains(unwanted), "{library} knows {unwanted}");
        }
    }
    assert!(crates["cli"].dependencies.contains("clap"), "the program has a command line");
}

/// Sources of the project, below a folder.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Number of doc comments in a source, and those that open with a question word or refer to another comment.
fn openings(text: &str) -> (usize, Vec<String>) {
    let is_doc = |line: &str| line.starts_with("///") || line.starts_with("//!");
    let mut count = 0;
    let mut riddles = Vec::new();
    let mut was_doc = false;
    for line in text.lines().map(str::trim) {
        if is_doc(line) && !was_doc {
            count += 1;
            let opening = line[3..].trim_start();
            let words = ["What", "Whether", "How", "Where", "Of", "The same"];
            let is_riddle =
                |word: &str| opening.strip_prefix(word).is_some_and(|rest| rest.starts_with([' ', ',', '.']));
            if words.into_iter().any(is_riddle) {
                riddles.push(opening.to_owned());
            }
        }
        was_doc = is_doc(line);
    }
    (count, riddles)
}

#[test]
fn documentation_opens_with_what_a_thing_is() {
    let (_, wrong) =
        openings("/// Whether it is so.\nfn f() {}\n/// Number of rays.\nfn g() {}\n/// Of the second.\nfn h() {}");
    assert_eq!(wrong.len(), 2, "the check finds what it looks for");
    let mut files = Vec::new();
    for folder in ["crates", "apps", "lab", "tests", "benches"] {
        sources(&root().join(folder), &mut files);
    }
    let mut count = 0;
    let mut riddles = Vec::new();
    for file in files {
        let (of_file, found) = openings(&std::fs::read_to_string(&file).expect("a source"));
        count += of_file;
        riddles.extend(found.into_iter().map(|opening| format!("{}: {opening}", file.display())));
    }
    assert!(count > 5_000, "{count} doc comments");
    assert!(riddles.len() * 100 <= 3 * count, "{} of {count} doc comments:\n{}", riddles.len(), riddles.join("\n"));
}
