//! lab/docs/sources.md says where the equations, figures and claims of the sources are in the project: what it names
//! exists, and no number of theirs is left out.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const COLUMNS: usize = 7;
const STATES: [&str; 4] = ["as printed", "corrected", "another way", "not here"];
/// A cell that says that there is nothing.
const NONE: &str = "none";
/// Numbers that the thesis gives equations and figures, chapter by chapter: the chapter and its last.
const EQUATIONS: [(u32, u32); 5] = [(1, 2), (2, 4), (3, 5), (5, 3), (6, 1)];
const FIGURES: [(u32, u32); 5] = [(1, 1), (3, 11), (4, 12), (5, 4), (6, 3)];
const OTHERS: [&str; 9] = [
    "T listing 3.1",
    "T table 1",
    "T table 2",
    "T table 3",
    "K alg. 1",
    "K alg. 2",
    "K fig. 1",
    "K fig. 2",
    "K fig. 3",
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(file: &str) -> Result<String, String> {
    std::fs::read_to_string(root().join(file)).map_err(|_| format!("there is no file {file}"))
}

/// All Rust files below a folder.
fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder of the project").flatten() {
        let path = entry.path();
        if path.is_dir() {
            rust_files(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Names of the options that the arguments of a file define: fields below `#[arg(long …)]`.
fn options_of(text: &str) -> BTreeSet<String> {
    let mut options = BTreeSet::new();
    let mut attribute = String::new();
    let mut is_open = false;
    for line in text.lines().map(str::trim) {
        if line.starts_with("#[arg(") {
            attribute.clear();
            is_open = true;
        }
        if is_open {
            attribute.push_str(line);
            is_open = !line.ends_with(")]");
            continue;
        }
        if let Some((field, _)) = line.strip_prefix("pub ").and_then(|rest| rest.split_once(": ")) {
            let parts: Vec<&str> = attribute.split([',', '(', ')']).map(str::trim).collect();
            if let Some(name) = parts.iter().find_map(|part| part.strip_prefix("long = ")) {
                options.insert(name.trim_matches('"').to_owned());
            } else if parts.contains(&"long") {
                options.insert(field.replace('_', "-"));
            }
            attribute.clear();
        }
    }
    options
}

/// Options of the programs.
fn options() -> BTreeSet<String> {
    let mut files = vec![root().join("lab/experiments/src/args.rs")];
    for program in ["apps/cli/src", "apps/shell/src", "apps/viewer/src"] {
        rust_files(&root().join(program), &mut files);
    }
    files.iter().flat_map(|file| options_of(&std::fs::read_to_string(file).expect("a file of the project"))).collect()
}

/// Text before each definition of a function of this name.
fn before_function<'a>(text: &'a str, name: &'a str) -> impl Iterator<Item = &'a str> {
    let is_whole = |rest: &str| !rest.starts_with(|c: char| c.is_alphanumeric() || c == '_');
    text.match_indices("fn ")
        .filter(move |&(at, word)| text[at + word.len()..].strip_prefix(name).is_some_and(is_whole))
        .map(|(at, _)| &text[..at])
}

fn has_function(text: &str, name: &str) -> bool {
    before_function(text, name).next().is_some()
}

/// Returns true if a function of this name has `#[test]` above it.
fn has_test(text: &str, name: &str) -> bool {
    before_function(text, name).any(|before| before.rsplit("fn ").next().is_some_and(|own| own.contains("#[test]")))
}

/// Text between backticks, if that is all.
fn code(text: &str) -> Option<&str> {
    let inner = text.strip_prefix('`')?.strip_suffix('`')?;
    (!inner.is_empty() && !inner.contains('`')).then_some(inner)
}

/// Files with a name of each: `file`: `name`; `file`: `name`.
fn named_places(cell: &str) -> Result<Vec<(&str, &str)>, String> {
    if cell == NONE {
        return Ok(Vec::new());
    }
    cell.split("; ").map(named_place).collect()
}

fn named_place(part: &str) -> Result<(&str, &str), String> {
    let (file, name) = part.split_once(": ").unwrap_or((part, ""));
    code(file).zip(code(name)).ok_or_else(|| format!("{part} is no file with a name"))
}

struct Row<'a> {
    source: &'a str,
    places: &'a str,
    options: &'a str,
    tests: &'a str,
    command: &'a str,
    state: &'a str,
}

impl<'a> Row<'a> {
    fn new(line: &'a str) -> Result<Self, String> {
        let inner = line.trim().strip_prefix('|').and_then(|line| line.strip_suffix('|')).unwrap_or(line);
        let cells: Vec<&str> = inner.split('|').map(str::trim).collect();
        if let Some(column) = cells.iter().position(|cell| cell.is_empty()) {
            return Err(format!("cell {column} is empty"));
        }
        let found = cells.len();
        let [source, _says, places, options, tests, command, state] = cells[..] else {
            return Err(format!("{found} cells in the place of {COLUMNS}"));
        };
        Ok(Self { source, places, options, tests, command, state })
    }

    fn check(&self, options: &BTreeSet<String>) -> Result<(), String> {
        let places = named_places(self.places)?;
        for (file, function) in &places {
            if !has_function(&read(file)?, function) {
                return Err(format!("{file} has no function {function}"));
            }
        }
        for (file, test) in named_places(self.tests)? {
            if !has_test(&read(file)?, test) {
                return Err(format!("{file} has no test {test}"));
            }
        }
        self.check_options(options)?;
        self.check_command(options)?;
        self.check_state(places.is_empty())?;
        check_links(self.state)
    }

    fn check_options(&self, options: &BTreeSet<String>) -> Result<(), String> {
        if self.options == NONE {
            return Ok(());
        }
        for part in self.options.split(", ") {
            let text = code(part).ok_or_else(|| format!("{part} is no option"))?;
            let name = text.split(' ').next().and_then(|word| word.strip_prefix("--"));
            let name = name.ok_or_else(|| format!("{text} is no option"))?;
            if !options.contains(name) {
                return Err(format!("the program has no option --{name}"));
            }
        }
        Ok(())
    }

    fn check_command(&self, options: &BTreeSet<String>) -> Result<(), String> {
        if self.command == NONE {
            return Ok(());
        }
        let text = code(self.command).ok_or_else(|| format!("{} is no command", self.command))?;
        let words: Vec<&str> = text.split(' ').collect();
        match words[..] {
            ["patchlight-bench", name, ..] => {
                check_variant("lab/experiments/src/args.rs", name)?;
                check_words(&words[2..], options)
            }
            ["patchlight", name, ..] => {
                check_variant("apps/cli/src/cli.rs", name)?;
                check_words(&words[2..], options)
            }
            ["cargo", "test", "--workspace", "--test", name] => check_test_file(name),
            ["cargo", "bench", "-p", "benches", "--bench", name] => read(&format!("benches/{name}.rs")).map(drop),
            ["cargo", "run", "--release", "-p", package, "--example", name] => {
                let folder = package.strip_prefix("patchlight-").unwrap_or(package);
                read(&format!("crates/{folder}/examples/{name}.rs")).map(drop)
            }
            _ => Err(format!("{text} is no command of a known form")),
        }
    }

    fn check_state(&self, is_nowhere: bool) -> Result<(), String> {
        let (state, reason) = self.state.split_once(':').unwrap_or((self.state, ""));
        if !STATES.contains(&state) {
            return Err(format!("`{state}` is no state"));
        }
        if state != STATES[0] && reason.trim().is_empty() {
            return Err(format!("{state}, without a reason"));
        }
        let is_absent = state == STATES[3];
        if is_absent != is_nowhere {
            return Err(format!("{state}, and its place is {}", self.places));
        }
        if is_absent && [self.options, self.tests, self.command] != [NONE; 3] {
            return Err(format!("{state}, and it has an option, a test or a command"));
        }
        Ok(())
    }
}

/// Options among the words of a command.
fn check_words(words: &[&str], options: &BTreeSet<String>) -> Result<(), String> {
    match words.iter().filter_map(|word| word.strip_prefix("--")).find(|name| !options.contains(*name)) {
        Some(name) => Err(format!("the program has no option --{name}")),
        None => Ok(()),
    }
}

/// Checks that an enumeration of a file has the variant of a command or an experiment.
fn check_variant(file: &str, name: &str) -> Result<(), String> {
    let (first, rest) = name.split_at(1);
    let variant = first.to_uppercase() + rest;
    let is_variant = |line: &str| {
        line.strip_prefix("    ")
            .and_then(|line| line.strip_prefix(&variant))
            .is_some_and(|rest| rest == "," || rest == " {" || rest.starts_with('(') && rest.ends_with("),"))
    };
    if read(file)?.lines().any(is_variant) { Ok(()) } else { Err(format!("the program has no {name}")) }
}

/// Checks that there are tests of this name, of the project or of one of its crates.
fn check_test_file(name: &str) -> Result<(), String> {
    let mut folders = vec![root().join("tests")];
    let crates = std::fs::read_dir(root().join("crates")).expect("the crates").flatten();
    folders.extend(crates.map(|entry| entry.path().join("tests")));
    let exists = folders.iter().any(|folder| folder.join(format!("{name}.rs")).is_file());
    if exists { Ok(()) } else { Err(format!("there are no tests {name}")) }
}

/// Checks that files that a cell links to exist.
fn check_links(cell: &str) -> Result<(), String> {
    let links = cell.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    for link in links {
        read(&format!("lab/docs/{link}"))?;
    }
    Ok(())
}

/// Name of every number of the sources in the first column.
fn numbers() -> Vec<String> {
    let all = |chapters: [(u32, u32); 5]| {
        chapters.into_iter().flat_map(|(chapter, last)| (1..=last).map(move |n| format!("{chapter}.{n}")))
    };
    let equations = all(EQUATIONS).map(|number| format!("T ({number})"));
    let figures = all(FIGURES).map(|number| format!("T fig. {number}"));
    equations.chain(figures).chain(OTHERS.map(str::to_owned)).collect()
}

/// Lines of the tables' rows.
fn lines(document: &str) -> impl Iterator<Item = (usize, &str)> {
    let is_row = |line: &str| line.starts_with('|') && !line.starts_with("| source |") && !line.starts_with("| ---");
    document.lines().enumerate().filter(move |(_, line)| is_row(line)).map(|(k, line)| (k + 1, line))
}

/// Faults of the rows of the document.
fn faults(document: &str, options: &BTreeSet<String>) -> Vec<String> {
    let fault = |(number, line)| {
        let checked = Row::new(line).and_then(|row| row.check(options));
        checked.err().map(|fault| format!("line {number}: {fault}"))
    };
    lines(document).filter_map(fault).collect()
}

/// Numbers of the sources that have no row.
fn missing(document: &str) -> Vec<String> {
    let rows = lines(document).filter_map(|(_, line)| Row::new(line).ok());
    let sources: BTreeSet<&str> = rows.map(|row| row.source).collect();
    numbers().into_iter().filter(|number| !sources.contains(number.as_str())).collect()
}

#[test]
fn what_the_table_names_exists() {
    let document = read("lab/docs/sources.md").expect("the table");
    assert_eq!(faults(&document, &options()), Vec::<String>::new());
    for state in STATES {
        let rows = lines(&document).filter_map(|(_, line)| Row::new(line).ok());
        let count = rows.filter(|row| row.state.split(':').next() == Some(state)).count();
        println!("{state}: {count}");
        assert!(count > 0, "{state}");
    }
}

const GOOD: &str = "| T (2.4) | All at once | `crates/formfactor/src/host/solve.rs`: `lu` | `--form-factors area` | \
    `crates/formfactor/tests/properties.rs`: `solvers_agree` | `patchlight render cornell --form-factors area` | \
    corrected: in double precision ([direct.md](measurements/direct.md)) |";

#[test]
fn wrong_rows_are_noticed() {
    let options = options();
    let check = |line: &str| Row::new(line).and_then(|row| row.check(&options));
    assert_eq!(check(GOOD), Ok(()));
    for (right, wrong, fault) in [
        ("host/solve.rs", "host/solved.rs", "there is no file crates/formfactor/src/host/solved.rs"),
        ("`: `lu`", "`: `l`", "has no function l"),
        ("`: `lu`", "`: `lu_of_nothing`", "has no function lu_of_nothing"),
        ("`: `lu`", "", "is no file with a name"),
        ("`--form-factors area`", "`--form-factor area`", "no option --form-factor"),
        ("`--form-factors area`", "--form-factors area", "is no option"),
        ("`--form-factors area`", "", "cell 3 is empty"),
        ("tests/properties.rs", "tests/property.rs", "there is no file crates/formfactor/tests/property.rs"),
        ("`solvers_agree`", "`solvers_disagree`", "has no test solvers_disagree"),
        // A function, but no test.
        ("`solvers_agree`", "`room`", "has no test room"),
        ("patchlight render", "patchlight draw", "the program has no draw"),
        ("patchlight render cornell", "patchlight-bench nothing", "the program has no nothing"),
        ("cornell --form-factors", "cornell --form-factor ", "no option --form-factor"),
        ("patchlight render cornell --form-factors area", "make", "no command of a known form"),
        ("patchlight render cornell --form-factors area", "cargo test --workspace --test nothing", "no tests nothing"),
        (
            "patchlight render cornell --form-factors area",
            "cargo bench -p benches --bench nothing",
            "benches/nothing.rs",
        ),
        ("corrected:", "better:", "`better` is no state"),
        ("corrected: in double precision ([direct.md](measurements/direct.md))", "corrected", "without a reason"),
        ("corrected:", "not here:", "not here, and its place is"),
        ("`crates/formfactor/src/host/solve.rs`: `lu`", "none", "corrected, and its place is none"),
        ("measurements/direct.md)", "measurements/nothing.md)", "there is no file lab/docs/measurements/nothing.md"),
        (" | All at once", "", "6 cells in the place of 7"),
        ("All at once", "", "cell 1 is empty"),
    ] {
        assert!(GOOD.contains(right), "{right}");
        let found = check(&GOOD.replacen(right, wrong, 1)).expect_err(wrong);
        assert!(found.contains(fault), "{wrong}: {found}");
    }
    assert_eq!(check("| T fig. 1.1 | Vectors | none | none | none | none | not here: a drawing |"), Ok(()));
    let with_option = "| T fig. 1.1 | Vectors | none | `--form-factors` | none | none | not here: a drawing |";
    assert!(check(with_option).is_err_and(|fault| fault.contains("an option")));
}

#[test]
fn every_number_of_the_sources_has_a_row() {
    let document = read("lab/docs/sources.md").expect("the table");
    assert_eq!(missing(&document), Vec::<String>::new());
    for number in numbers() {
        let without = document.replace(&format!("| {number} |"), "| T 0 |");
        assert_eq!(missing(&without), [number]);
    }
}

#[test]
fn options_are_those_of_the_arguments() {
    let text = "#[arg(long, value_name = \"K/N\")]\npub part: u32,\n#[arg(\nlong = \"for\",\nhide = true)]\npub methods: Vec<u32>,\n\
        #[arg(required = true)]\npub along: u32,\npub scene: String,\n#[arg(short, long)]\npub patch_count: u32,";
    assert_eq!(options_of(text), ["for", "part", "patch-count"].map(str::to_owned).into());
    let all = options();
    assert!(
        all.contains("device") && all.contains("form-factors") && all.contains("for") && !all.contains("scene"),
        "{all:?}"
    );
}
