//! Bakes of scenes as a user meets them: the same pictures as without, the same bytes whatever interrupts them, and
//! errors that say what is wrong.

mod program;

use std::fs;
use std::path::Path;
use std::time::Duration;

use program::{command, fails, run, succeeds, text};

const BAKED: [&str; 6] = ["--patch-count", "100", "--rays", "64", "--receiver-rays", "64"];
const SHOWN: [&str; 7] = ["--size", "32x24", "--spp", "2", "--device", "cpu", "--quiet"];

fn bake(scene: &str, path: &str, more: &[&str]) {
    succeeds(&[&["bake", scene, "-o", path, "--quiet"], &BAKED[..], more].concat());
}

/// The bytes of the picture, and the summary.
fn render(arguments: &[&str], out: &Path) -> (Vec<u8>, serde_json::Value) {
    let shared = ["--json", "--out", out.to_str().unwrap()];
    let summary = succeeds(&[&["render"], arguments, &SHOWN, &shared].concat());
    (fs::read(out.join("full.exr")).unwrap(), serde_json::from_str(&summary).unwrap())
}

#[test]
fn every_method_renders_the_same_bits_from_a_bake() {
    let folder = tempfile::tempdir().unwrap();
    let name = |file: &str| folder.path().join(file).to_string_lossy().into_owned();
    let file = name("a.bake");
    let dense = name("dense.bake");
    bake("cornell", &file, &["--for", "low_rank,feedback", "--epsilon", "0.05", "--seed", "3"]);
    bake("cornell", &dense, &["--for", "multibounce", "--codec", "dense", "--seed", "3"]);
    let cases: [(&str, &[&str], &[&str]); 7] = [
        (&file, &["--method", "classic"], &[]),
        (&file, &["--method", "low_rank"], &["--epsilon", "0.05"]),
        (&file, &["--method", "feedback"], &["--epsilon", "0.05"]),
        (&file, &["--method", "temporal"], &[]),
        (&file, &["--method", "local"], &[]),
        (&file, &["--method", "firstshot", "--error", "0.2"], &[]),
        (&dense, &["--method", "multibounce"], &["--codec", "dense"]),
    ];
    for (file, method, of_scene) in cases {
        let (from_bake, summary) = render(&[&[file], method].concat(), &folder.path().join("bake"));
        let of_scene = [&["cornell", "--seed", "3"], method, of_scene, &BAKED].concat();
        let (from_scene, expected) = render(&of_scene, &folder.path().join("scene"));
        assert!(from_bake == from_scene, "{method:?}");
        assert_eq!(summary["patches"], expected["patches"]);
        for phase in ["sample", "form_factors", "receivers", "operator", "compress"] {
            // The matrix round the camera is made for each camera.
            let is_own = phase == "operator" && method.contains(&"local");
            assert!(is_own || summary["bake"].get(phase).is_none(), "{method:?} makes {phase} again: {summary}");
        }
    }
    // A method's picture is its own, and another seed's another.
    let (classic, _) = render(&[&file, "--method", "classic"], &folder.path().join("bake"));
    let (temporal, _) = render(&[&file, "--method", "temporal"], &folder.path().join("bake"));
    let of_scene = [&["cornell", "--seed", "4", "--method", "temporal"], &BAKED[..]].concat();
    let (other, _) = render(&of_scene, &folder.path().join("scene"));
    assert!(classic != temporal && other != temporal);
}

#[test]
fn a_bake_for_frames_is_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let name = |file: &str| folder.path().join(file).to_string_lossy().into_owned();
    let [file, whole] = [name("frames.bake"), name("whole.bake")];
    bake("cornell", &file, &["--for-frames"]);
    bake("cornell", &whole, &["--for", "classic"]);
    let bytes = |file: &str| fs::metadata(file).unwrap().len();
    assert!(bytes(&file) < bytes(&whole));
    let [(near, _), (exact, _)] =
        [&file, &whole].map(|file| render(&[file, "--method", "classic"], &folder.path().join("picture")));
    assert!(near.len() > 1000 && near.len().abs_diff(exact.len()) < exact.len() / 10);
    let refused = run(&["bake", "cornell", "--for-frames", "--for", "low_rank", "-o", &file]);
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
}

#[test]
fn all_kinds_of_patches_and_receivers_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.bake").to_string_lossy().into_owned();
    for (patches, receivers) in [("polygon", "mesh"), ("cluster", "pixels"), ("voxel", "mesh"), ("axis", "self")] {
        let more = ["--patches", patches, "--receivers", receivers, "--for", "low_rank,multibounce", "--codec", "bc1"];
        bake("cornell", &file, &more);
        for method in [&["low_rank"][..], &["multibounce", "--codec", "bc1"]] {
            let method = [&["--method"], method].concat();
            let (from_bake, _) = render(&[&[&file[..]], &method[..]].concat(), &folder.path().join("bake"));
            let of_scene = [&["cornell"], &method[..], &more[..4], &BAKED].concat();
            let (from_scene, _) = render(&of_scene, &folder.path().join("scene"));
            assert!(from_bake == from_scene, "{patches} {receivers} {method:?}");
        }
    }
}

#[test]
fn threads_and_kills_change_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let arguments = |path: &Path, threads: &str| -> Vec<String> {
        let own = ["bake", "cornell", "--for", "low_rank,feedback", "-o", path.to_str().unwrap(), "--threads", threads];
        own.iter().chain(&BAKED).chain(&["--quiet"]).map(|one| (*one).to_owned()).collect()
    };
    let command_of =
        |path: &Path, threads: &str| command(&arguments(path, threads).iter().map(String::as_str).collect::<Vec<_>>());
    assert!(command_of(&at("one.bake"), "1").output().unwrap().status.success());
    let expected = fs::read(at("one.bake")).unwrap();
    assert!(command_of(&at("two.bake"), "2").output().unwrap().status.success());
    assert!(fs::read(at("two.bake")).unwrap() == expected);
    let killed = at("killed.bake");
    let beginning = at("killed.bake.beginning");
    let mut resumed = 0;
    let begun = || fs::metadata(&beginning).map_or(0, |meta| meta.len());
    // Each when more is written than before the one before, so that they go on from each other.
    for k in 1..=6u64 {
        resumed += u32::from(begun() > 10_000);
        let mut child = command_of(&killed, "2").spawn().unwrap();
        while begun() < expected.len() as u64 * k / 7 && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        if killed.exists() {
            assert!(fs::read(&killed).unwrap() == expected, "kill {k}");
            fs::remove_file(&killed).unwrap();
        }
    }
    assert!(command_of(&killed, "2").output().unwrap().status.success());
    assert!(fs::read(&killed).unwrap() == expected);
    assert!(resumed > 0 && !beginning.exists(), "{resumed}");
    bake("cornell", at("seed.bake").to_str().unwrap(), &["--for", "low_rank,feedback", "--seed", "1"]);
    assert!(fs::read(at("seed.bake")).unwrap() != expected);
}

#[test]
fn a_device_bakes_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let name = |file: &str| folder.path().join(file).to_string_lossy().into_owned();
    let message = fails(1, &["bake", "cornell", "-o", &name("none.bake"), "--device", "nosuch"]);
    assert!(message.contains("nosuch"), "{message}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    if !runtime::vulkan::devices().is_ok_and(|devices| !devices.is_empty()) {
        let required = std::env::var("REQUIRE_VULKAN").is_ok_and(|value| value == "1");
        assert!(!required, "REQUIRE_VULKAN is set, and there is no device");
        println!("skipped: no Vulkan device");
        return;
    }
    let own = name("own.bake");
    let device = name("device.bake");
    // An operator of all bounces that a device makes has other last bits (tests/device.rs).
    let more = ["--patches", "cluster", "--for", "classic"];
    bake("cornell", &own, &[&more[..], &["--device", "cpu"]].concat());
    bake("cornell", &device, &[&more[..], &["--device", "vulkan"]].concat());
    assert!(fs::read(own).unwrap() == fs::read(device).unwrap());
}

#[test]
fn what_a_bake_does_not_hold_is_said_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let name = |file: &str| folder.path().join(file).to_string_lossy().into_owned();
    let file = name("a.bake");
    bake("cornell", &file, &["--for", "temporal"]);
    let message = fails(1, &["render", &file, "--method", "low_rank", "--quiet"]);
    for word in
        ["a.bake", "--method low_rank", "nor any other", "patchlight bake SCENE --for low_rank", "render the scene"]
    {
        assert!(message.contains(word), "{message}");
    }
    bake("cornell", &file, &["--epsilon", "0.05"]);
    for options in [&["--method", "feedback"][..], &["--method", "low_rank", "--epsilon", "0.01"]] {
        let message = fails(1, &[&["render", &file, "--quiet"], options].concat());
        assert!(message.contains("but for --method low_rank --epsilon 0.05"), "{message}");
    }
    // What the bake has decided is not asked for again.
    let out = name("out");
    let output =
        run(&[&["render", &file, "--patch-count", "50", "--bounces", "2", "--out", &out], &SHOWN[..]].concat());
    let message = text(&output.stderr);
    assert!(output.status.success(), "{message}");
    for option in ["--patch-count is for scenes, not bakes", "--bounces is for scenes, not bakes"] {
        assert!(message.contains(option), "{message}");
    }
    let merged = fails(1, &["merge", &file, "-o", &name("merged.bake")]);
    assert!(merged.contains("a.bake is the bake of a scene") && merged.contains("patchlight world"), "{merged}");
    for wrong in [["--for", "path"], ["--for", "paint"], ["--epsilon", "2"], ["--rays", "1"], ["--part", "1/2"]] {
        fails(2, &[&["bake", "cornell"], &wrong[..]].concat());
    }
    assert!(fails(1, &["bake", "cornell", "--patches", "cluster", "--voxel-size", "1", "-o", &file]).contains("voxel"));
}

#[test]
fn damaged_cut_and_foreign_bakes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let name = |file: &str| folder.path().join(file).to_string_lossy().into_owned();
    bake("cornell", &name("a.bake"), &[]);
    let good = fs::read(name("a.bake")).unwrap();
    let changed = |at: usize| {
        let mut bytes = good.clone();
        bytes[at] ^= 1;
        bytes
    };
    let mut newer = good.clone();
    newer[8] += 1;
    let version = format!("version {}", newer[8]);
    let cases: [(Vec<u8>, &str); 8] = [
        (Vec::new(), "it is empty"),
        (b"solid of triangles".to_vec(), "patchlight bake SCENE"),
        (good[..40].to_vec(), "the header at byte 0"),
        (changed(20), "the header at byte 0"),
        (changed(good.len() / 2), "its checksum is wrong"),
        (good[..good.len() / 2].to_vec(), "no section begins there"),
        (good[..good.len() - 1].to_vec(), "no section begins there"),
        (newer, &version),
    ];
    for (bytes, word) in cases {
        fs::write(name("b.bake"), bytes).unwrap();
        for arguments in [&["info", &name("b.bake")][..], &["render", &name("b.bake"), "--out", &name("out")]] {
            let message = fails(1, arguments);
            assert!(message.contains(word) && message.contains("b.bake"), "{word}: {message}");
            assert!(message.contains("again") || message.contains("bake the scene"), "{message}");
        }
    }
    assert!(fails(1, &["info", &name("none.bake")]).contains("none.bake"));
    assert!(!Path::new(&name("out")).join("full.exr").exists());
    // Bytes tell a bake, whatever its name.
    fs::rename(name("a.bake"), name("a.data")).unwrap();
    assert!(succeeds(&["info", &name("a.data")]).contains("section"));
}

#[test]
fn a_scene_that_was_edited_since_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |file: &str| folder.path().join(file);
    let name = |file: &str| at(file).to_string_lossy().into_owned();
    succeeds(&["scene", "cornell", "--out", &name("")]);
    let scene = name("cornell.toml");
    let file = name("a.bake");
    let out = name("out");
    bake(&scene, &file, &[]);
    let look = || {
        let output = run(&[&["render", &file, "--out", &out], &SHOWN[..]].concat());
        assert!(output.status.success());
        let info: serde_json::Value = serde_json::from_str(&succeeds(&["info", &file, "--json"])).unwrap();
        (text(&output.stderr), info["has_changed"].as_bool().unwrap(), fs::read(at("out/full.exr")).unwrap())
    };
    let (said, has_changed, picture) = look();
    assert!(said.is_empty() && !has_changed, "{said}");
    // Written again, but the same.
    let materials = fs::read_to_string(at("cornell.mtl")).unwrap();
    fs::write(at("cornell.mtl"), &materials).unwrap();
    let (said, has_changed, _) = look();
    assert!(said.is_empty() && !has_changed, "{said}");
    fs::write(at("cornell.mtl"), materials.replacen("Kd ", "Kd 0.1", 1)).unwrap();
    let (said, has_changed, same) = look();
    assert!(said.contains("cornell.toml has changed since") && said.contains("bake it again"), "{said}");
    assert!(has_changed && same == picture);
    // A bake needs no files but its own.
    for gone in ["cornell.toml", "cornell.mtl", "cornell.obj"] {
        fs::remove_file(at(gone)).unwrap();
    }
    let (said, has_changed, same) = look();
    assert!(said.is_empty() && !has_changed && same == picture, "{said}");
}

#[test]
fn info_says_what_a_bake_holds() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.bake").to_string_lossy().into_owned();
    bake("cornell", &file, &["--for", "low_rank,multibounce", "--codec", "f16", "--seed", "5"]);
    let output = run(&["info", &file, "--patch-count", "7"]);
    assert!(text(&output.stderr).contains("--patch-count is for scenes, not bakes"), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    for word in
        ["cornell", "about 100 ", "64 rays a row", "seed 5", "low_rank --epsilon 0.01", "multibounce --codec f16"]
    {
        assert!(said.contains(word), "{word}: {said}");
    }
    for section in ["origin", "scene", "patches", "form factors", "receivers", "operator"] {
        assert!(said.contains(&format!("{:14} {section}: ", "section")), "{section}: {said}");
    }
    let info: serde_json::Value = serde_json::from_str(&succeeds(&["info", &file, "--json"])).unwrap();
    assert_eq!(info["scene_hash"].as_str().unwrap().len(), 64);
    assert_eq!(info["settings"]["patch_count"], 100);
    let sections = info["sections"].as_array().unwrap();
    let held: u64 = sections.iter().map(|section| section["bytes"].as_u64().unwrap()).sum();
    // Headers of the file, of its sections, and of the end.
    assert_eq!(held + 56 + 24 * (sections.len() as u64 + 1), fs::metadata(&file).unwrap().len());
}
