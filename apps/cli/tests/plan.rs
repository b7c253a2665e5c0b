//! `patchlight world --plan` and `patchlight bake --plan`: the jobs of a farm come to the bytes of a bake made whole.

mod program;

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use program::{fails, succeeds, text};
use serde_json::Value;

const PROGRAM: &str = env!("CARGO_BIN_EXE_patchlight");

/// A plan of three parts in a folder with a name that shells and templates stumble over, and the same bake made whole.
fn plan(format: &str) -> (tempfile::TempDir, PathBuf, Value) {
    let folder = tempfile::tempdir().unwrap();
    let inside = folder.path().join("o'f $two @words");
    fs::create_dir(&inside).unwrap();
    let bake = inside.join("small.bake");
    let small = ["world", "cornell", "--patch-count", "300", "--rays", "64", "--seed", "3", "--quiet"];
    let planned = ["--plan", "3", "--format", format, "--json", "-o", bake.to_str().unwrap()];
    let report: Value = serde_json::from_str(&succeeds(&[&small[..], &planned].concat())).unwrap();
    succeeds(&[&small[..], &["-o", inside.join("whole").to_str().unwrap()]].concat());
    assert!(!bake.exists(), "a plan bakes nothing");
    (folder, inside, report)
}

fn assert_whole(inside: &Path) {
    assert!(fs::read(inside.join("small.bake")).unwrap() == fs::read(inside.join("whole")).unwrap());
    for k in 1..=3 {
        assert!(inside.join(format!("small-{k}-of-3.part.bake")).exists());
    }
}

fn assert_success(output: &Output) {
    assert!(output.status.success(), "{}{}", text(&output.stdout), text(&output.stderr));
}

#[test]
fn a_slurm_script_bakes_parts_and_joins_them() {
    let (_folder, inside, report) = plan("slurm");
    let script = PathBuf::from(report["file"].as_str().unwrap());
    assert_eq!(script, inside.join("small.sbatch"));
    let written = fs::read_to_string(&script).unwrap();
    let megabytes = report["memory_bytes"].as_u64().unwrap().div_ceil(1 << 20);
    for line in ["#SBATCH --array=1-3".to_owned(), format!("#SBATCH --mem={megabytes}M")] {
        assert!(written.lines().any(|own| own == line), "{line}: {written}");
    }
    // What submits the joining job, and keeps what it was told.
    let told = inside.join("told");
    let sbatch = inside.join("sbatch");
    fs::write(&sbatch, "#!/bin/bash\nprintf '%s\\n' \"$@\" >> \"$TOLD\"\n").unwrap();
    fs::set_permissions(&sbatch, fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", inside.display(), std::env::var("PATH").unwrap());
    let task = |part: u32| {
        let mut command = Command::new("bash");
        command.arg(&script).env("PATH", &path).env("TOLD", &told).env("PATCHLIGHT", PROGRAM);
        command.env("SLURM_ARRAY_JOB_ID", "77").env("SLURM_ARRAY_TASK_ID", part.to_string());
        command.current_dir("/").output().unwrap()
    };
    for part in [3, 1, 2] {
        assert_success(&task(part));
    }
    let told = fs::read_to_string(&told).unwrap();
    assert_eq!(told.matches("--dependency=afterok:77").count(), 1, "{told}");
    let wrap = told.lines().find_map(|line| line.strip_prefix("--wrap=")).unwrap();
    let merged = Command::new("sh").args(["-c", wrap]).current_dir("/").output().unwrap();
    assert_success(&merged);
    assert_whole(&inside);
    // A part that is there is not made again.
    let part = inside.join("small-2-of-3.part.bake");
    fs::write(&part, "kept").unwrap();
    assert_success(&task(2));
    assert_eq!(fs::read(&part).unwrap(), b"kept");
}

#[test]
fn a_job_template_bakes_parts_and_joins_them() {
    let (_folder, inside, report) = plan("openjd");
    let file = report["file"].as_str().unwrap();
    assert_eq!(Path::new(file), inside.join("small.openjd.json"));
    let template: Value = serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap();
    assert_eq!(template["specificationVersion"], "jobtemplate-2023-09");
    assert_eq!(template["steps"][1]["dependencies"][0]["dependsOn"], template["steps"][0]["name"]);
    let openjd = std::env::var("OPENJD").unwrap_or_else(|_| String::from("openjd"));
    if Command::new(&openjd).arg("--version").output().is_err() {
        println!("skipped: openjd is not installed (pip install openjd-cli; OPENJD names the program)");
        return;
    }
    let check = |file: &str| Command::new(&openjd).args(["check", file]).output().unwrap();
    assert_success(&check(file));
    // A template that says nonsense is noticed.
    let wrong = inside.join("wrong.json");
    let broken = fs::read_to_string(file).unwrap().replace("\"dependsOn\": \"Bake\"", "\"dependsOn\": \"Cake\"");
    fs::write(&wrong, broken).unwrap();
    assert!(!check(wrong.to_str().unwrap()).status.success());

    let program = format!("Program={PROGRAM}");
    let run = ["run", file, "--step", "Merge", "--run-dependencies", "--job-param", &program];
    let output = Command::new(&openjd).args(run).current_dir(&inside).output().unwrap();
    assert_success(&output);
    assert_whole(&inside);
}

/// Settings of a small bake whose receivers take several rounds.
const SMALL: [&str; 10] =
    ["bake", "cornell", "--patch-count", "300", "--receiver-rays", "64", "--rays", "256", "--seed", "3"];

/// A plan of three parts a round, the same bake made whole, and the folder of both.
fn round_plan(format: &str) -> (tempfile::TempDir, PathBuf, Value) {
    let folder = tempfile::tempdir().unwrap();
    let inside = folder.path().join("o'f $two @words");
    fs::create_dir(&inside).unwrap();
    let bake = inside.join("small.bake");
    let planned = ["--plan", "3", "--format", format, "--json", "-o", bake.to_str().unwrap()];
    let report: Value = serde_json::from_str(&succeeds(&[&SMALL[..], &planned].concat())).unwrap();
    succeeds(&[&SMALL[..], &["--quiet", "-o", inside.join("whole").to_str().unwrap()]].concat());
    assert!(!bake.exists(), "a plan bakes nothing");
    (folder, inside, report)
}

fn assert_whole_bake(inside: &Path) {
    assert!(fs::read(inside.join("small.bake")).unwrap() == fs::read(inside.join("whole")).unwrap());
    let left = fs::read_dir(inside).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let left: Vec<String> = left.filter(|name| name.contains("rounds") || name.contains("beginning")).collect();
    assert_eq!(left, Vec::<String>::new());
}

#[test]
fn rounds_of_a_bake_come_to_its_bytes() {
    let (_folder, inside, report) = round_plan("slurm");
    let script = PathBuf::from(report["file"].as_str().unwrap());
    assert_eq!(script, inside.join("small.sbatch"));
    // Jobs run when they are submitted, one after the other; tasks of an array in another order.
    let told = inside.join("told");
    let sbatch = inside.join("sbatch");
    let fake = r#"#!/bin/bash
printf '%s\n' "$@" >> "$TOLD"
tasks=(0)
for word in "$@"; do
    case "$word" in
        --array=*) last=${word##*-}; tasks=(); for ((k = last; k >= 1; k--)); do tasks+=("$k"); done ;;
        --wrap=*) wrap=${word#--wrap=} ;;
    esac
done
for task in "${tasks[@]}"; do
    SLURM_ARRAY_TASK_ID=$task sh -c "$wrap" >> "$TOLD.log" 2>&1 || exit 1
done
echo 77
"#;
    fs::write(&sbatch, fake).unwrap();
    fs::set_permissions(&sbatch, fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", inside.display(), std::env::var("PATH").unwrap());
    let mut command = Command::new("bash");
    command.arg(&script).env("PATH", &path).env("TOLD", &told).env("PATCHLIGHT", PROGRAM).current_dir("/");
    let output = command.output().unwrap();
    let log = fs::read_to_string(inside.join("told.log")).unwrap_or_default();
    assert!(output.status.success(), "{}{log}", text(&output.stderr));
    let told = fs::read_to_string(&told).unwrap();
    // Seven jobs that go on and six arrays, each after the one before.
    assert_eq!(told.matches("--wrap=").count(), 13, "{told}");
    assert_eq!(told.matches("--dependency=afterok:77").count(), 12, "{told}");
    assert_whole_bake(&inside);
    // Once more: the bake is there.
    assert_success(&command.output().unwrap());
    assert_whole_bake(&inside);
}

#[test]
fn a_job_template_traces_rounds() {
    let (_folder, inside, report) = round_plan("openjd");
    let file = report["file"].as_str().unwrap();
    let template: Value = serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap();
    let steps = template["steps"].as_array().unwrap();
    assert_eq!(steps.len(), 13);
    for pair in steps.windows(2) {
        assert_eq!(pair[1]["dependencies"][0]["dependsOn"], pair[0]["name"]);
    }
    let openjd = std::env::var("OPENJD").unwrap_or_else(|_| String::from("openjd"));
    if Command::new(&openjd).arg("--version").output().is_err() {
        println!("skipped: openjd is not installed (pip install openjd-cli; OPENJD names the program)");
        return;
    }
    assert_success(&Command::new(&openjd).args(["check", file]).output().unwrap());
    let program = format!("Program={PROGRAM}");
    let run = ["run", file, "--step", "End", "--run-dependencies", "--job-param", &program];
    assert_success(&Command::new(&openjd).args(run).current_dir(&inside).output().unwrap());
    assert_whole_bake(&inside);
}

#[test]
fn what_rounds_lack_or_have_broken_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let bake = folder.path().join("a.bake");
    let out = ["--quiet", "-o", bake.to_str().unwrap()];
    let step = |more: &[&str]| succeeds(&[&SMALL[..], &out, more].concat());
    let refused = |arguments: &[&str], part: &str| {
        let message = fails(1, &[&SMALL[..], &out, arguments].concat());
        assert!(message.contains(part), "{message}");
    };
    // Nothing was begun.
    refused(&["--round", "1", "--part", "1/2"], "1.task");
    let told = step(&["--round", "1"]);
    assert!(told.contains("rows are to be traced"), "{told}");
    step(&["--round", "1", "--part", "2/2"]);
    refused(&["--round", "2"], "1-1-of-2.rows");
    step(&["--round", "1", "--part", "1/2"]);
    // Half of a file, another bake's, and none.
    let part = folder.path().join("a.bake.rounds/1-1-of-2.rows");
    let whole = fs::read(&part).unwrap();
    fs::write(&part, &whole[..whole.len() / 2]).unwrap();
    refused(&["--round", "2"], "checksum");
    fs::write(&part, &whole[..20]).unwrap();
    refused(&["--round", "2"], "cut off");
    let mut other = whole.clone();
    other[3] ^= 1;
    fs::write(&part, other).unwrap();
    refused(&["--round", "2"], "1-1-of-2.rows");
    fs::write(&part, &whole).unwrap();
    step(&["--round", "2"]);
    assert!(folder.path().join("a.bake.rounds/2.task").exists() && !bake.exists());
}

#[test]
fn jobs_get_memory_that_suffices_and_no_ten_times_that() {
    for (scene, patches, rays) in [("cornell", "1000", "128"), ("office", "20000", "512")] {
        let folder = tempfile::tempdir().unwrap();
        let bake = folder.path().join("a.bake");
        let arguments = ["world", scene, "--patch-count", patches, "--rays", rays, "--json", "--quiet", "-o"];
        let arguments = [&arguments[..], &[bake.to_str().unwrap()]].concat();
        let report =
            |more: &[&str]| -> Value { serde_json::from_str(&succeeds(&[&arguments[..], more].concat())).unwrap() };
        let planned = report(&["--plan", "4", "--format", "openjd"])["memory_bytes"].as_u64().unwrap();
        let Some(taken) = report(&["--part", "2/4"])["peak_memory_bytes"].as_u64() else { return };
        assert!(taken <= planned && planned < 10 * taken, "{scene}: {planned} for {taken}");
    }
    // Never more than the bake allows itself.
    let folder = tempfile::tempdir().unwrap();
    let bake = folder.path().join("a.bake");
    let arguments =
        ["world", "office", "--memory-limit", "90M", "--plan", "2", "--format", "slurm", "--json", "--quiet", "-o"];
    let report: Value = serde_json::from_str(&succeeds(&[&arguments[..], &[bake.to_str().unwrap()]].concat())).unwrap();
    assert_eq!(report["memory_bytes"], 90 << 20);
}

#[test]
fn plans_that_make_no_sense_are_refused() {
    let refused = |code: i32, arguments: &[&str], parts: &[&str]| {
        let message = fails(code, arguments);
        assert!(parts.iter().all(|part| message.contains(part)), "{message}: {parts:?}");
    };
    refused(2, &["world", "cornell", "--plan", "0", "--format", "slurm"], &["--plan", "1..=1000"]);
    refused(2, &["world", "cornell", "--plan", "3"], &["--format"]);
    refused(2, &["world", "cornell", "--format", "openjd"], &["--plan"]);
    refused(2, &["world", "cornell", "--plan", "3", "--format", "pbs"], &["pbs", "slurm", "openjd"]);
    refused(2, &["world", "cornell", "--plan", "3", "--format", "slurm", "--part", "1/3"], &["--part", "--plan"]);
    refused(2, &["bake", "cornell", "--plan", "3"], &["--format"]);
    refused(2, &["bake", "cornell", "--part", "1/3"], &["--round"]);
    refused(2, &["bake", "cornell", "--round", "8"], &["1..=7"]);
    refused(2, &["bake", "cornell", "--plan", "3", "--format", "slurm", "--round", "1"], &["--round", "--plan"]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a{{b}}.bake");
    let path = path.to_str().unwrap();
    refused(
        1,
        &["world", "cornell", "--plan", "3", "--format", "openjd", "-o", path],
        &["a{{b}}", "expression", "rename"],
    );
}
