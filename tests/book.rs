//! The book: its pages, links and pictures exist, and its commands are those of the program.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn source() -> PathBuf {
    root().join("docs/book/src")
}

/// Pages below a folder, by their paths from the source of the book.
fn pages(folder: &Path, found: &mut BTreeSet<PathBuf>) {
    for path in std::fs::read_dir(folder).expect("a folder of the book").flatten().map(|entry| entry.path()) {
        if path.is_dir() {
            pages(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "md") {
            found.insert(path.strip_prefix(source()).expect("below the source").to_path_buf());
        }
    }
}

/// Targets of links and pictures of a text, without those outside of the book, and of its includes.
fn targets(text: &str) -> Vec<String> {
    let links = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    let links = links.filter(|link| !link.contains("://")).filter_map(|link| link.split('#').next());
    let includes = text.split("{{#include ").skip(1).filter_map(|rest| rest.split("}}").next());
    links.chain(includes).filter(|target| !target.is_empty()).map(str::to_owned).collect()
}

/// Targets that are not there.
fn broken(folder: &Path, text: &str) -> Vec<String> {
    targets(text).into_iter().filter(|target| !folder.join(target).is_file()).collect()
}

/// A command of the book.
#[derive(Debug, PartialEq)]
struct Line {
    text: String,
    /// True if it is to be run.
    is_run: bool,
}

/// Commands of the blocks ```sh and ```sh run.
fn commands(text: &str) -> Vec<Line> {
    let mut lines = Vec::new();
    let mut block = None;
    for line in text.lines() {
        match (line.strip_prefix("```"), block) {
            (Some("sh"), None) => block = Some(false),
            (Some("sh run"), None) => block = Some(true),
            (Some(_), None) => block = None,
            (Some(_), Some(_)) => block = None,
            (None, Some(is_run)) if !line.trim().is_empty() => lines.push(Line { text: line.to_owned(), is_run }),
            (None, _) => {}
        }
    }
    lines
}

/// The program that the tests of the workspace build, or `None` after saying why.
fn program() -> Option<PathBuf> {
    let beside = || Some(std::env::current_exe().ok()?.parent()?.parent()?.join("patchlight"));
    let path = std::env::var_os("PATCHLIGHT_BIN").map(PathBuf::from).or_else(beside)?;
    if path.is_file() {
        return Some(path);
    }
    let required = std::env::var("REQUIRE_PROGRAM").is_ok_and(|value| value == "1");
    assert!(!required, "REQUIRE_PROGRAM is set, and there is no {}", path.display());
    println!("skipped: there is no {}", path.display());
    None
}

/// Output of a program.
fn said(program: &Path, folder: &Path, arguments: &[&str]) -> Result<String, String> {
    let output = Command::new(program).args(arguments).current_dir(folder).output().map_err(|e| e.to_string())?;
    let out = String::from_utf8_lossy(&output.stdout);
    let err = String::from_utf8_lossy(&output.stderr);
    if output.status.success() { Ok(out.into_owned()) } else { Err(format!("{arguments:?}: {err}")) }
}

/// Helps of commands, each asked for once.
struct Helps<'a> {
    program: &'a Path,
    known: BTreeMap<String, String>,
}

impl Helps<'_> {
    fn of(&mut self, command: Option<&str>) -> Result<&str, String> {
        let key = command.unwrap_or_default().to_owned();
        if !self.known.contains_key(&key) {
            let arguments: Vec<&str> = command.into_iter().chain(["--help-research"]).collect();
            let text = said(self.program, Path::new("."), &arguments)?;
            self.known.insert(key.clone(), text);
        }
        Ok(&self.known[&key])
    }

    /// Checks that a line names a command of the program and options of that command.
    fn check(&mut self, line: &str) -> Result<(), String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["patchlight", ..] => {
                let command = words.get(1).copied().filter(|word| !word.starts_with('-'));
                let help = self.of(command)?;
                let has = |option: &str| help.split(|c: char| !(c.is_alphanumeric() || c == '-')).any(|w| w == option);
                match words.iter().find(|word| word.starts_with("--") && **word != "--version" && !has(word)) {
                    Some(option) => Err(format!("{line}: no option {option}")),
                    None => Ok(()),
                }
            }
            ["cargo", "build", "--release", "-p", package] => package_exists(package),
            ["cargo", "install", "--path", path] => file_exists(&format!("{path}/Cargo.toml")),
            ["cargo", "run", "--release", "-p", package, "--example", name] => {
                let folder = package.strip_prefix("patchlight-").unwrap_or(package);
                file_exists(&format!("crates/{folder}/examples/{name}.rs"))
            }
            _ => Err(format!("{line} is no command of a known form")),
        }
    }
}

fn file_exists(file: &str) -> Result<(), String> {
    if root().join(file).is_file() { Ok(()) } else { Err(format!("there is no {file}")) }
}

fn package_exists(package: &str) -> Result<(), String> {
    let manifests = ["apps/cli", "apps/viewer", "apps/experiments"].map(|app| root().join(app).join("Cargo.toml"));
    let name = format!("name = \"{package}\"");
    let exists = manifests.iter().any(|file| std::fs::read_to_string(file).is_ok_and(|text| text.contains(&name)));
    if exists { Ok(()) } else { Err(format!("there is no package {package}")) }
}

fn text_of(page: &Path) -> String {
    std::fs::read_to_string(source().join(page)).expect("a page")
}

#[test]
fn every_page_is_in_the_summary_and_every_link_leads_somewhere() {
    let mut all = BTreeSet::new();
    pages(&source(), &mut all);
    let summary = text_of(Path::new("SUMMARY.md"));
    let listed: BTreeSet<PathBuf> = targets(&summary).into_iter().map(PathBuf::from).collect();
    all.remove(Path::new("SUMMARY.md"));
    assert_eq!(all, listed);
    assert!(all.len() > 25);
    for page in &all {
        let folder = source().join(page.parent().expect("a folder"));
        assert_eq!(broken(&folder, &text_of(page)), Vec::<String>::new(), "{page:?}");
    }
    let wrong = "[a](index.md) ![b](pictures/no.png) {{#include ../no.md}} [c](https://example.com)";
    assert_eq!(broken(&source(), wrong), ["pictures/no.png", "../no.md"]);
}

#[test]
fn commands_are_those_of_the_program() {
    let Some(program) = program() else { return };
    let mut helps = Helps { program: &program, known: BTreeMap::new() };
    let mut all = BTreeSet::new();
    pages(&source(), &mut all);
    let lines: Vec<Line> = all.iter().flat_map(|page| commands(&text_of(page))).collect();
    assert!(lines.len() > 30 && lines.iter().filter(|line| line.is_run).count() >= 4);
    let folder = tempfile::tempdir().unwrap();
    for line in &lines {
        assert_eq!(helps.check(&line.text), Ok(()));
        if line.is_run {
            let arguments: Vec<&str> = line.text.split_whitespace().skip(1).collect();
            said(&program, folder.path(), &arguments).unwrap();
        }
    }
    assert!(folder.path().join("first/full.png").is_file());
    for (wrong, fault) in [
        ("patchlight render cornell --sizes 1x1", "no option --sizes"),
        ("patchlight paint cornell", "paint"),
        ("cargo build --release -p nothing", "no package nothing"),
        ("cargo run --release -p patchlight --example nothing", "nothing.rs"),
        ("make", "no command of a known form"),
    ] {
        assert!(helps.check(wrong).unwrap_err().contains(fault), "{wrong}");
    }
    assert!(said(&program, folder.path(), &["info", "no/such/scene.toml"]).is_err());
    let text = "```sh run\na b\n```\nc\n```rust\nd\n```\n```sh\n\ne\n```";
    let line = |text: &str, is_run| Line { text: text.to_owned(), is_run };
    assert_eq!(commands(text), [line("a b", true), line("e", false)]);
}
