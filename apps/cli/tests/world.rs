//! Bakes of worlds as a user meets them: the same bytes for any threads, parts and interruptions; what is wrong is
//! named; pictures.

mod program;

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use program::{command, fails, run, succeeds, text};

const SMALL: [&str; 5] = ["--patch-count", "300", "--rays", "64", "--quiet"];

fn bake(scene: &str, path: &Path, more: &[&str]) {
    let path = path.to_string_lossy();
    let arguments: Vec<&str> =
        ["world", scene, "-o", &path].into_iter().chain(SMALL).chain(more.iter().copied()).collect();
    succeeds(&arguments);
}

fn bake_part(path: &Path) {
    bake("cornell", path, &["--part", "1/1"]);
}

#[test]
fn threads_parts_and_interruptions_change_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let name = |file: &str| at(file).to_string_lossy().into_owned();
    bake("cornell", &at("one.bake"), &["--threads", "1"]);
    bake("cornell", &at("two.bake"), &["--threads", "3"]);
    let expected = fs::read(at("one.bake")).unwrap();
    assert!(fs::read(at("two.bake")).unwrap() == expected);
    bake("cornell", &at("seed.bake"), &["--seed", "1"]);
    assert!(fs::read(at("seed.bake")).unwrap() != expected);

    for k in 1..=3 {
        bake("cornell", &at(&format!("part-{k}.bake")), &["--part", &format!("{k}/3")]);
    }
    let lost = fails(1, &["merge", &name("part-1.bake"), &name("part-3.bake"), "-o", &name("merged.bake")]);
    assert!(lost.contains("of 3 parts these are missing: 2") && lost.contains("--part K/3"), "{lost}");
    succeeds(&["merge", &name("part-3.bake"), &name("part-1.bake"), &name("part-2.bake"), "-o", &name("merged.bake")]);
    assert!(fs::read(at("merged.bake")).unwrap() == expected);
    bake("office", &at("other.bake"), &["--part", "2/3"]);
    let other = fails(1, &["merge", &name("part-1.bake"), &name("other.bake"), "-o", &name("merged.bake")]);
    assert!(other.contains("other.bake is of another scene"), "{other}");

    // Killed as soon as there are rows, again and again until it gets through.
    let beginning = at("killed.bake.beginning");
    let long = name("killed.bake");
    let arguments = ["world", "cornell", "-o", &long, "--patch-count", "300", "--rays", "65536"];
    let mut kills = 0;
    while kills < 3 && !at("killed.bake").exists() {
        let before = fs::metadata(&beginning).map_or(0, |m| m.len());
        let mut child = command(&arguments).spawn().unwrap();
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(100) && child.try_wait().unwrap().is_none() {
            if fs::metadata(&beginning).is_ok_and(|m| m.len() > before) {
                child.kill().unwrap();
                kills += 1;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        child.wait().unwrap();
    }
    succeeds(&arguments);
    let whole = name("whole.bake");
    succeeds(&["world", "cornell", "-o", &whole, "--patch-count", "300", "--rays", "65536"]);
    assert!(kills > 0 && fs::read(&long).unwrap() == fs::read(&whole).unwrap());
    assert!(!beginning.exists());
}

/// Kills that a bake must bear; more with the variable `KILLS`.
fn kill_count() -> u64 {
    std::env::var("KILLS").ok().and_then(|text| text.parse().ok()).unwrap_or(8)
}

#[test]
fn a_bake_that_is_killed_at_random_moments_comes_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole.bake");
    let killed = folder.path().join("killed.bake");
    let arguments = |path: &Path| -> Vec<String> {
        let own =
            ["world", "cornell", "-o", path.to_str().unwrap(), "--patch-count", "300", "--rays", "32768", "--quiet"];
        own.map(str::to_owned).to_vec()
    };
    let command_of = |path: &Path| command(&arguments(path).iter().map(String::as_str).collect::<Vec<_>>());
    let start = Instant::now();
    assert!(command_of(&whole).output().unwrap().status.success());
    let time = start.elapsed().as_micros() as u64;
    let expected = fs::read(&whole).unwrap();
    let mut kills = 0;
    let mut finished = 0;
    let mut resumed = 0;
    for k in 0u64.. {
        if kills >= kill_count() && (resumed > 0 || k >= 20 * kill_count()) {
            break;
        }
        let begun = fs::metadata(folder.path().join("killed.bake.beginning")).is_ok();
        let mut child = command_of(&killed).spawn().unwrap();
        // Anywhere in the time that it takes; more and more of it, for other tests may slow the machine since.
        let span = time * (1 + k / kill_count());
        std::thread::sleep(Duration::from_micros(k.wrapping_mul(0x9e37_79b9_7f4a_7c15) % span));
        child.kill().unwrap();
        let is_done = child.wait().unwrap().success();
        kills += u64::from(!is_done);
        resumed += u64::from(begun);
        // What is whole is right, however often it was killed before.
        if killed.exists() {
            assert!(fs::read(&killed).unwrap() == expected, "after {kills} kills");
            fs::remove_file(&killed).unwrap();
            finished += 1;
        }
    }
    assert!(command_of(&killed).output().unwrap().status.success());
    assert!(fs::read(&killed).unwrap() == expected, "after {kills} kills");
    println!("{kills} kills, {resumed} runs went on from another, {finished} came through");
    assert!(resumed > 0);
}

#[test]
fn a_bake_that_is_stopped_says_where_it_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bake");
    let own = ["world", "cornell", "-o", path.to_str().unwrap(), "--patch-count", "4000", "--rays", "65536", "--quiet"];
    let child = command(&own).spawn().unwrap();
    let beginning = folder.path().join("a.bake.beginning");
    let start = Instant::now();
    while !beginning.exists() && start.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(10));
    }
    let told = std::process::Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
    let output = child.wait_with_output().unwrap();
    let message = text(&output.stderr);
    assert!(told.success() && output.status.code() == Some(130), "{message}");
    assert!(message.contains("a.bake.beginning keeps what is done") && beginning.exists(), "{message}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_said_and_the_old_bake_stays() {
    let folder = tempfile::tempdir().unwrap();
    // A small file system of its own, where the system allows to make one.
    let script = format!(
        "mount -t tmpfs -o size=400k none '{0}' || exit 77; '{1}' world cornell -o '{0}/a.bake' --patch-count 300 \
         --rays 64 --quiet || exit 78; sum=$(cksum < '{0}/a.bake'); '{1}' world cornell -o '{0}/a.bake' --patch-count \
         20000 --rays 64 --quiet; code=$?; [ \"$sum\" = \"$(cksum < '{0}/a.bake')\" ] || exit 79; exit $code",
        folder.path().display(),
        env!("CARGO_BIN_EXE_patchlight")
    );
    let output = std::process::Command::new("unshare").args(["-rm", "bash", "-c", &script]).output();
    let Ok(output) = output else {
        println!("skipped: there is no unshare");
        return;
    };
    let message = text(&output.stderr);
    match output.status.code() {
        Some(1) if !message.contains("a.bake") => println!("skipped: {message}"),
        Some(77) => println!("skipped: {message}"),
        code => {
            assert_eq!(code, Some(1), "{message}");
            assert!(message.contains("a.bake.beginning") && message.contains("room"), "{message}");
        }
    }
}

#[test]
fn wrong_bakes_are_named_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let name = |file: &str| at(file).to_string_lossy().into_owned();
    for (option, value) in
        [("--part", "4/3"), ("--patch-count", "1"), ("--voxel-size", "-1"), ("--memory-limit", "lots"), ("--rays", "1")]
    {
        fails(2, &["world", "cornell", option, value]);
    }
    fails(2, &["merge"]);
    let tight = fails(1, &["world", "cornell", "-o", &name("tight.bake"), "--memory-limit", "1M"]);
    assert!(tight.contains("--memory-limit") && !at("tight.bake").exists(), "{tight}");
    bake("cornell", &at("a.bake"), &[]);
    let method = fails(1, &["render", &name("a.bake"), "--method", "classic"]);
    assert!(method.contains("--method local"), "{method}");
    let info = succeeds(&["info", &name("a.bake"), "--json"]);
    assert!(info.contains("\"scene\": \"cornell\"") && info.contains("\"lost_blocks\": []"), "{info}");

    let good = fs::read(at("a.bake")).unwrap();
    let mut altered = good.clone();
    // In the rows of the last block.
    let place = altered.len() - 6 * 1024;
    altered[place] ^= 1;
    fs::write(at("b.bake"), altered).unwrap();
    let output = run(&["info", &name("b.bake")]);
    let said = text(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("b.bake: block ") && said.contains("at byte"), "{said}");
    // A short run says so, too, and no more than that.
    let bake = name("b.bake");
    let out = name("out");
    let output = run(&["render", &bake, "--method", "local", "--size", "32x24", "--slots", "2048", "--out", &out]);
    let warnings = text(&output.stderr);
    assert!(output.status.success(), "{warnings}");
    assert_eq!(warnings.matches("warning: ").count(), 1, "{warnings}");
    assert!(warnings.contains("b.bake: block ") && warnings.contains("its rows are left out"), "{warnings}");
    // Parts that are joined must be whole.
    bake_part(&at("part.bake"));
    let mut part = fs::read(at("part.bake")).unwrap();
    let place = part.len() - 200;
    part[place] ^= 1;
    fs::write(at("part.bake"), part).unwrap();
    let message = fails(1, &["merge", &name("part.bake"), "-o", &name("joined.bake")]);
    assert!(message.contains("part.bake: block ") && message.contains("bake the scene again"), "{message}");
    assert!(!message.contains("left out"), "{message}");
    for (bytes, word) in [(&good[..0], "it is empty"), (&good[..90], "the header"), (&good[..4000], "the world")] {
        fs::write(at("c.bake"), bytes).unwrap();
        for arguments in [["info", &name("c.bake"), "--json"], ["render", &name("c.bake"), "--method=local"]] {
            let message = fails(1, &arguments);
            assert!(message.contains(word) && message.contains("c.bake"), "{message}");
        }
    }
}

#[test]
fn a_bake_is_flown_through_with_blocks_missing_too() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let name = |file: &str| at(file).to_string_lossy().into_owned();
    bake("cornell", &at("a.bake"), &[]);
    let fly = |file: &str, out: &str| {
        succeeds(&[
            "render",
            &name(file),
            "--method",
            "local",
            "--path",
            "fly",
            "--frames",
            "4",
            "--slots",
            "128",
            "--size",
            "48x32",
            "--out",
            &name(out),
            "--json",
        ])
    };
    let summary = fly("a.bake", "out");
    assert!(summary.contains("\"method\": \"local\"") && summary.contains("\"slots\": 128"), "{summary}");
    let csv = fs::read_to_string(at("out/frames.csv")).unwrap();
    assert_eq!(csv.lines().count(), 5);
    assert!(at("out/frame-0003.png").exists());
    // Half of its blocks are lost: coarser nodes stand in.
    let good = fs::read(at("a.bake")).unwrap();
    fs::write(at("cut.bake"), &good[..good.len() / 2]).unwrap();
    fly("cut.bake", "cut");
    assert!(at("cut/frame-0003.png").exists());
    assert!(fs::read(at("cut/frame-0003.png")).unwrap() != fs::read(at("out/frame-0003.png")).unwrap());
}

#[test]
fn still_light_does_not_pop_on_a_flight() {
    let folder = tempfile::tempdir().unwrap();
    let name = |file: &str| folder.path().join(file).to_string_lossy().into_owned();
    bake("atrium:3000", Path::new(&name("a.bake")), &[]);
    // Greatest change of displayed values, and nodes that came.
    let fly = |out: &str, more: &[&str]| {
        let shared = [
            "--animate",
            "still",
            "--method",
            "local",
            "--path",
            "fly",
            "--frames",
            "24",
            "--slots",
            "64",
            "--size",
            "48x32",
        ];
        let file = name("a.bake");
        let folder = name(out);
        let own = ["render", &file, "--out", &folder];
        succeeds(&[&own[..], more, &shared].concat());
        let csv = fs::read_to_string(Path::new(&folder).join("frames.csv")).unwrap();
        let head: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
        let column = |name: &str| {
            let at = head.iter().position(|one| *one == name).unwrap();
            csv.lines().skip(2).map(|line| line.split(',').nth(at).unwrap().parse::<f64>().unwrap()).collect::<Vec<_>>()
        };
        let greatest = |name: &str| column(name).into_iter().fold(0.0, f64::max);
        (greatest("change_255"), column("entered").iter().sum::<f64>(), greatest("later") + greatest("behind_255"))
    };
    let ((smooth, came, late), (at_once, ..)) = (fly("16", &["--fade", "16"]), fly("1", &["--fade", "1"]));
    println!("{smooth} of 255 a frame at most, {at_once} at once; {came} nodes came");
    assert!(came > 20.0 && smooth <= 2.0, "{smooth}, {came}");
    assert!(at_once > 4.0, "{at_once}");
    // At rest nothing is late, whatever the budget.
    let (_, all, nothing) = fly("rest", &["--at-rest", "--budget", "4"]);
    println!("{all} nodes came at rest; {late} and {nothing} late");
    assert!(all > 20.0 && late > 1.0 && nothing == 0.0, "{all}, {late}, {nothing}");
}
