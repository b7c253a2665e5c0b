//! Faults that must not reach a user: panics, hangs, lost hours, settings that are ignored in silence.
#![cfg(unix)]

mod program;

use std::fs::{self, File, OpenOptions};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use program::{command, fails, leftovers, run, succeeds, text};

const SMALL: [&str; 10] =
    ["--size", "32x24", "--device", "cpu", "--quiet", "--spp", "1", "--rays", "64", "--patch-count=60"];

/// Time that the test gives to what is told to stop: far more than it needs, far less than the work.
const PATIENCE: Duration = Duration::from_secs(60);

/// The exit code of a program that was told to stop after a while.
fn stopped(mut child: Child, signal: &str, after: Duration) -> Option<i32> {
    std::thread::sleep(after);
    let told = Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
    assert!(told.success() && child.try_wait().unwrap().is_none(), "it ended by itself");
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status.code();
        }
        if start.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("it does not stop");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_closed_pipe_is_no_panic() {
    for arguments in [&["info", "cornell"][..], &["devices"], &["info", "cornell", "--json"]] {
        let mut child = command(arguments).spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
        assert!(!text(&output.stderr).contains("panicked"), "{arguments:?}: {}", text(&output.stderr));
    }
    // And nobody hears warnings and errors.
    let mut child = command(&["info", "no/such/scene.obj"]).spawn().unwrap();
    drop(child.stderr.take());
    assert_eq!(child.wait().unwrap().code(), Some(1));
}

#[test]
fn a_full_standard_output_is_an_error() {
    let Ok(full) = OpenOptions::new().write(true).open("/dev/full") else {
        println!("skipped: there is no /dev/full");
        return;
    };
    let output = command(&["info", "cornell"]).stdout(full).output().unwrap();
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("standard output") && !message.contains("panicked"), "{message}");
}

#[test]
fn distances_between_receivers_that_cannot_be_are_refused() {
    for wrong in ["0", "nan", "inf", "-1", "few"] {
        let message = fails(2, &["render", "cornell", "--receiver-edge", wrong]);
        assert!(message.contains("--receiver-edge") && message.contains("metres"), "{message}");
    }
}

#[test]
fn sizes_that_exceed_the_memory_limit_are_refused_before_they_are_begun() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let refused = |more: &[&str], words: &[&str]| {
        let message = fails(1, &[&["render", "cornell", "--out", out][..], &SMALL, more].concat());
        for word in words {
            assert!(message.contains(word), "{more:?}: {word} is missing in {message}");
        }
    };
    let limit = ["--memory-limit", "1500M"];
    refused(&[&["--receiver-edge", "0.001"][..], &limit].concat(), &["cornell", "receivers", "--receiver-edge", "GB"]);
    let dense = ["--patches", "cluster", "--method", "multibounce", "--codec", "dense", "--patch-count", "60000"];
    let dense: Vec<&str> = SMALL[..9].iter().chain(&dense).chain(&limit).copied().collect();
    let message = fails(1, &[&["render", "cornell", "--out", out][..], &dense].concat());
    assert!(message.contains("60000 patches") && message.contains("--memory-limit"), "{message}");
    let slots = ["--method", "local", "--slots", "32768", "--patch-count", "60000", "--memory-limit", "1500M"];
    let slots: Vec<&str> = SMALL[..9].iter().chain(&slots).copied().collect();
    let message = fails(1, &[&["render", "cornell", "--out", out][..], &slots].concat());
    assert!(message.contains("32768 slots") && message.contains("--slots"), "{message}");
}

#[test]
fn too_many_threads_are_refused() {
    let message = fails(2, &["info", "cornell", "--threads", "10000"]);
    assert!(message.contains("--threads") && message.contains("10000") && message.contains("cores"), "{message}");
    succeeds(&["info", "cornell", "--threads", "64"]);
}

#[test]
fn work_stops_when_it_is_told_to_also_within_a_frame() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let out = out.to_str().unwrap();
    // A frame of a day; a scene that takes a while; a sample of a path-traced picture that does.
    let frame = ["render", "cornell", "--size", "1280x720", "--spp", "1000000", "--rays", "64", "--patch-count", "60"];
    let scene = ["scene", "city:5000000"];
    let paths = ["render", "cornell", "--method", "path", "--size", "1920x1080", "--spp", "100000"];
    for (arguments, signal) in [(&frame[..], "-INT"), (&scene, "-TERM"), (&paths, "-INT")] {
        let arguments = [arguments, &["--device", "cpu", "--quiet", "--out", out]].concat();
        let child = command(&arguments).stderr(Stdio::null()).spawn().unwrap();
        assert_eq!(stopped(child, signal, Duration::from_millis(1500)), Some(130), "{arguments:?}");
        assert!(leftovers(Path::new(out)).is_empty(), "{arguments:?}");
        assert!(!Path::new(out).join("full.exr").exists());
    }
}

#[test]
fn an_output_that_cannot_be_written_is_found_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "x").unwrap();
    let below = file.join("below");
    let below = below.to_str().unwrap();
    // None of these gets as far as to find that its input is not there, or to take its hours.
    for arguments in [
        &["render", "no/such/scene.toml", "--out", below][..],
        &["render", "no/such/world.bake", "--method", "local", "--out", below],
        &["bake", "no/such/scene.toml", "--out", below],
        &["world", "no/such/scene.toml", "--out", below],
        &["merge", "no/such/part.bake", "--out", below],
        &["scene", "city:5000000", "--out", below],
        &["info", "no/such/scene.toml", "--operator", "--codec", "dense", "--out", below],
        &["--out", below],
        &["compare", "no/such.exr", "no/such.exr", "--marked", below],
        &["compare", "no/such.exr", "no/such.exr", "--difference", below],
    ] {
        let message = fails(1, arguments);
        assert!(message.contains("file/below") && message.contains("check that"), "{arguments:?}: {message}");
        assert!(!message.contains("no/such"), "{arguments:?}: {message}");
    }
    assert_eq!(fs::read(&file).unwrap(), b"x");
    let missing = folder.path().join("missing/a.bake");
    assert!(fails(1, &["bake", "cornell", "--out", missing.to_str().unwrap()]).contains("missing/a.bake"));
    assert!(!folder.path().join("missing").exists());
}

#[test]
fn a_bake_does_not_overwrite_what_is_no_bake() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("thesis.txt");
    fs::write(&file, "ten years of work").unwrap();
    let path = file.to_str().unwrap();
    for command in ["bake", "world"] {
        let message = fails(1, &[command, "cornell", "--patch-count", "100", "--rays", "16", "--quiet", "--out", path]);
        assert!(message.contains("thesis.txt") && message.contains("no bake"), "{message}");
    }
    assert_eq!(fs::read(&file).unwrap(), b"ten years of work");
    // A bake is replaced by a bake.
    let bake = folder.path().join("a.bake");
    for command in ["world", "bake", "world"] {
        let path = bake.to_str().unwrap();
        succeeds(&[command, "cornell", "--patch-count", "100", "--rays", "16", "--quiet", "--out", path]);
    }
}

#[test]
fn what_is_no_regular_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let pipe = |name: &str| {
        let path = folder.path().join(name);
        assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
        path.to_str().unwrap().to_owned()
    };
    let scene = pipe("a.toml");
    let mesh = pipe("a.obj");
    let bake = pipe("a.bake");
    let exr = pipe("a.exr");
    for arguments in [
        &["info", &scene][..],
        &["info", &mesh],
        &["info", &bake],
        &["compare", &exr, &exr],
        &["render", &bake, "--method", "local", "--out", out.to_str().unwrap()],
        &["merge", &bake, "--out", folder.path().join("whole.bake").to_str().unwrap()],
        &["bake", "cornell", "--out", &bake],
        &["world", "cornell", "--out", &bake],
    ] {
        let message = fails(1, arguments);
        assert!(message.contains("no regular file"), "{arguments:?}: {message}");
    }
    // A mesh whose materials and textures are pipes or endless.
    let obj = folder.path().join("b.obj");
    fs::write(&obj, "mtllib a.obj\nmtllib b.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    fs::write(folder.path().join("b.mtl"), "newmtl m\nmap_Kd /dev/zero\n").unwrap();
    let output = run(&["info", obj.to_str().unwrap()]);
    let warnings = text(&output.stderr);
    assert!(output.status.success(), "{warnings}");
    assert_eq!(warnings.matches("no regular file").count(), 2, "{warnings}");
}

#[test]
fn options_that_a_run_ignores_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let mut arguments = vec!["render", "cornell", "--samples", "16", "--photons", "9", "--path", "fly", "--out"];
    arguments.push(folder.path().to_str().unwrap());
    arguments.extend(SMALL);
    let output = run(&arguments);
    let message = text(&output.stderr);
    assert!(output.status.success(), "{message}");
    for line in ["--samples is for --method temporal", "--photons is for --method firstshot", "--path is for --frames"]
    {
        assert!(message.contains(line), "{line} is missing in {message}");
    }
    assert_eq!(message.matches("this run ignores it").count(), 3, "{message}");
}

#[test]
fn light_beyond_all_numbers_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("bright.toml");
    fs::write(folder.path().join("a.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    fs::write(&scene, "version = 1\nmesh = \"a.obj\"\n[sky]\nradiance = [1e38, 1e38, 1e38]\n").unwrap();
    let message = fails(1, &["info", scene.to_str().unwrap()]);
    assert!(message.contains("bright.toml") && message.contains("line 3") && message.contains("radiance"), "{message}");
    assert!(message.contains("e15") || message.contains("1000000000000000"), "{message}");
}

#[test]
fn a_decoder_that_gives_up_prints_no_backtrace() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.gltf");
    // An index that the decoder takes without looking.
    let text_of = |node: &str| {
        format!(r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{node}],"meshes":[]}}"#)
    };
    fs::write(&path, text_of(r#"{"mesh":7}"#)).unwrap();
    let message = fails(1, &["info", path.to_str().unwrap()]);
    assert!(message.contains("a.gltf") && !message.contains("backtrace"), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
}

/// Writes a picture of one colour but for its last pixel.
fn picture(path: &Path, value: f32, last: f32) {
    use reference::PictureFile as _;
    let mut pixels = vec![glam::Vec3::splat(value); 64 * 48];
    pixels[64 * 48 - 1] = glam::Vec3::splat(last);
    let picture = reference::Picture::from_pixels(64, 48, pixels).unwrap();
    picture.write_exr(path, reference::Precision::Single).unwrap();
}

#[test]
fn a_comparison_names_the_file_and_judges_a_black_reference_absolutely() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let black = at("black.exr");
    let grey = at("grey.exr");
    let odd = at("odd.exr");
    let other = at("other.exr");
    picture(&black, 0.0, 0.0);
    picture(&grey, 0.25, 0.25);
    picture(&odd, 0.25, f32::NAN);
    {
        use reference::PictureFile as _;
        let small = reference::Picture::from_pixels(32, 48, vec![glam::Vec3::ONE; 32 * 48]).unwrap();
        small.write_exr(&other, reference::Precision::Single).unwrap();
    }
    let [black, grey, odd, other] = [&black, &grey, &odd, &other].map(|path| path.to_str().unwrap());
    for (ours, reference, named) in [(odd, grey, "odd.exr"), (grey, odd, "odd.exr"), (other, grey, "other.exr")] {
        let message = fails(1, &["compare", ours, reference]);
        assert!(message.contains(named), "{message}");
    }
    let json = |ours: &str| -> serde_json::Value {
        serde_json::from_str(&succeeds(&["compare", ours, black, "--json"])).unwrap()
    };
    let same = json(black);
    let bright = json(grey);
    assert_eq!(same["full"]["mse"].as_f64(), Some(0.0), "{same}");
    assert_eq!(same["faults"]["leak_share"].as_f64(), Some(0.0), "{same}");
    assert_eq!(bright["faults"]["leak_share"].as_f64(), Some(1.0), "{bright}");
    assert!(bright["full"]["mse"].as_f64().unwrap() > 0.01, "{bright}");
    assert!(File::open(black).is_ok());
}
