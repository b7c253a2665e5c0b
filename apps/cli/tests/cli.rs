//! The program as a user meets it: exit codes, messages, files, interruption.

mod program;

use reference::PictureFile as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use program::{fails, leftovers, succeeds, text};

const SMALL: [&str; 10] =
    ["--size", "32x24", "--device", "cpu", "--quiet", "--spp", "2", "--rays", "64", "--patch-count=100"];

#[test]
fn help_and_version_succeed_and_wrong_usage_is_2() {
    let help = succeeds(&["--help"]);
    for word in
        ["render", "bake", "world", "compare", "devices", "info", "scene", "bench", "Examples", "--device", "--json"]
    {
        assert!(help.contains(word), "{word}");
    }
    for command in ["render", "bake", "world", "merge", "compare", "info", "scene", "demo", "man", "completions"] {
        assert!(succeeds(&[command, "--help"]).contains("Example"), "{command}");
    }
    assert!(succeeds(&["--version"]).contains(env!("CARGO_PKG_VERSION")));
    fails(2, &["paint"]);
    fails(2, &["render"]);
    assert!(fails(2, &["render", "cornell", "--size", "10"]).contains("WIDTHxHEIGHT"));
    assert!(fails(2, &["render", "cornell", "--bounces", "0"]).contains("all"));
    fails(2, &["render", "cornell", "--patch-count", "100000000"]);
    assert!(fails(2, &["render", "cornell", "--focus", "0,0,0,1,-1,1"]).contains("X,Y,Z,X,Y,Z"));
}

#[test]
fn photons_of_the_printed_method_are_others_and_as_right() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let photons = |options: &[&str]| {
        let own = ["render", "atrium:3000", "--method", "firstshot", "--error", "0.2", "--json", "--out", out];
        let summary: serde_json::Value =
            serde_json::from_str(&succeeds(&[&own[..], &SMALL, options].concat())).unwrap();
        assert!(summary["photons"]["relative_error"].as_f64().unwrap() <= 0.2, "{summary}");
        summary["photons"].clone()
    };
    let ours = photons(&[]);
    for option in [
        ["--subdivision", "kopylov"],
        ["--texels", "brightest"],
        ["--start-light", "table"],
        ["--cubic", "cardano"],
        ["--sequence", "random"],
    ] {
        assert_ne!(photons(&option), ours, "{option:?}");
    }
}

#[test]
fn a_scene_that_is_not_there_is_named() {
    let message = fails(1, &["render", "no/such/scene.toml", "--quiet"]);
    assert!(message.contains("no/such/scene.toml"), "{message}");
    fails(1, &["info", "no/such/scene.obj"]);
    let message = fails(1, &["scene", "castle"]);
    assert!(message.contains("castle") && message.contains("atrium"), "{message}");
}

#[test]
fn a_medium_is_path_traced_and_refused_by_name_where_form_factors_are_needed() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("a.obj"), "mtllib a.mtl\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nusemtl m\nf 1 2 3\n").unwrap();
    std::fs::write(path("a.mtl"), "newmtl m\nKd 0.5 0.5 0.5\n").unwrap();
    let lamp = "[[light]]\ntype = \"point\"\nposition = [0, 0, 1]\nintensity = [1, 1, 1]\n";
    let medium = "[medium]\nabsorption = [0.1, 0.2, 0.3]\n";
    std::fs::write(path("fog.toml"), format!("version = 1\nmesh = \"a.obj\"\n{lamp}{medium}")).unwrap();
    let scene = path("fog.toml");
    let out = path("out");
    for method in ["classic", "low_rank", "feedback", "temporal", "local"] {
        let own = ["render", &scene, "--method", method, "--out", &out];
        let message = fails(1, &[&own[..], &SMALL].concat());
        assert!(message.contains("medium") && message.contains("path trace"), "{method}: {message}");
        assert!(message.contains(method) && message.contains("firstshot"), "{method}: {message}");
    }
    let bake = path("fog.bake");
    for command in ["bake", "world"] {
        let message = fails(1, &[command, &scene, "--patch-count", "100", "--out", &bake]);
        assert!(message.contains("medium") && message.contains("firstshot"), "{command}: {message}");
    }
    succeeds(&["bake", &scene, "--for", "firstshot", "--patch-count", "60", "--out", &bake, "--quiet"]);
    assert!(succeeds(&["info", &bake]).contains("firstshot, path\n"));
    assert!(fails(1, &["render", &bake, "--method", "low_rank", "--out", &out]).contains("medium"));
    let small = ["--out", &out, "--size", "32x24", "--spp", "2", "--quiet"];
    for (scene, method) in [(&scene, "path"), (&scene, "firstshot"), (&bake, "firstshot")] {
        succeeds(&[&["render", scene.as_str(), "--method", method][..], &small].concat());
    }
    succeeds(&["export", &bake, "--lightmap", "--out", &out, "--quiet"]);
}

#[test]
fn classic_and_path_write_their_pictures_and_summary() {
    let folder = tempfile::tempdir().unwrap();
    for method in ["classic", "path"] {
        let out = folder.path().join(method);
        let mut arguments = vec!["render", "cornell", "--method", method, "--json", "--out", out.to_str().unwrap()];
        arguments.extend(SMALL);
        let printed: serde_json::Value = serde_json::from_str(&succeeds(&arguments)).unwrap();
        let written: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
        assert_eq!(printed, written);
        assert_eq!(written["method"], method);
        assert_eq!(written["patches"].is_number(), method == "classic");
        if method == "classic" {
            assert!(written["energy"]["balance"].as_f64().unwrap().abs() < 0.05, "{written}");
            assert!((written["energy"]["near"]["ratio"].as_f64().unwrap() - 1.0).abs() < 0.2, "{written}");
        }
        assert!(written.get("full").is_none(), "no reference, no errors");
        for name in ["full", "direct", "indirect"] {
            assert!(out.join(format!("{name}.exr")).is_file() && out.join(format!("{name}.png")).is_file());
        }
        assert!(leftovers(&out).is_empty());
    }
    let a = folder.path().join("classic/indirect.exr");
    let b = folder.path().join("path/indirect.exr");
    let printed = succeeds(&["compare", a.to_str().unwrap(), b.to_str().unwrap(), "--json"]);
    let printed: serde_json::Value = serde_json::from_str(&printed).unwrap();
    let ratio = printed["full"]["mean_ratio"].as_f64().unwrap();
    assert!((ratio - 1.0).abs() < 0.2, "{printed}");
    let same = succeeds(&["compare", a.to_str().unwrap(), a.to_str().unwrap()]);
    assert!(same.contains("mean_ratio") && same.contains("1.0000"), "{same}");
    // Faults: none of equal pictures; of direct light beside indirect light there are some, and they are marked.
    for name in ["leaks", "stains", "noise"] {
        assert!(same.contains(&format!("{name:30} 0.000 % of the pixels")), "{same}");
    }
    let direct = folder.path().join("path/direct.exr");
    let marked = folder.path().join("marked");
    let [a, b, direct, folder] = [&a, &b, &direct, &marked].map(|path| path.to_str().unwrap());
    let more = ["--reference-error", b, "--indirect", b, "--marked", folder, "--json"];
    let printed = succeeds(&[&["compare", direct, a][..], &more].concat());
    let faults = &serde_json::from_str::<serde_json::Value>(&printed).unwrap()["faults"];
    assert!(faults["leak_share"].as_f64().unwrap() > 0.0 && faults["noise_share"].as_f64().unwrap() > 0.5, "{faults}");
    for name in ["faults.png", "noise.png", "blotches.png"] {
        assert!(marked.join(name).is_file(), "{name}");
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_for_any_thread_count() {
    let folder = tempfile::tempdir().unwrap();
    for (method, scene) in [("classic", "cornell"), ("firstshot", "atrium:3000"), ("path", "atrium:3000")] {
        let render = |threads: &str, seed: &str| {
            let out = folder.path().join(format!("{method}-{threads}-{seed}"));
            let mut arguments = vec!["render", scene, "--method", method, "--threads", threads, "--seed", seed];
            arguments.extend(SMALL);
            let out_text = out.to_str().unwrap().to_owned();
            arguments.extend(["--out", &out_text]);
            succeeds(&arguments);
            std::fs::read(out.join("full.exr")).unwrap()
        };
        assert!(render("1", "7") == render("2", "7"), "{method}: threads change the picture");
        assert!(render("2", "7") != render("2", "8"), "{method}: the seed changes nothing");
    }
}

#[test]
fn an_interrupted_path_tracing_resumes_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = |out: &Path, more: &[&str]| {
        let out = out.to_str().unwrap();
        let fixed = ["render", "cornell", "--method", "path", "--size", "64x48", "--quiet", "--out", out];
        fixed.iter().chain(more).map(|s| (*s).to_owned()).collect::<Vec<_>>()
    };
    let whole = folder.path().join("whole");
    let stopped = folder.path().join("stopped");
    let started = Instant::now();
    let mut child = Command::new(env!("CARGO_BIN_EXE_patchlight"))
        .args(arguments(&stopped, &["--spp", "1000000"]))
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    let interrupted = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(interrupted.success());
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        assert!(started.elapsed() < Duration::from_secs(60), "it does not stop");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(130));
    assert!(stopped.join("accumulation.bin").is_file() && leftovers(&stopped).is_empty());
    assert!(!stopped.join("full.exr").exists());

    // On to a target beyond what was reached, in one go and resumed.
    let header = std::fs::read(stopped.join("accumulation.bin")).unwrap();
    let samples = u32::from_le_bytes(header[20..24].try_into().unwrap());
    let target = (samples + 3).to_string();
    let run = |out: &Path, more: &[&str]| {
        let all = arguments(out, more);
        succeeds(&all.iter().map(String::as_str).collect::<Vec<_>>());
        std::fs::read(out.join("full.exr")).unwrap()
    };
    let resumed = run(&stopped, &["--spp", &target, "--resume"]);
    let at_once = run(&whole, &["--spp", &target]);
    assert!(resumed == at_once, "resumed and whole differ");

    // Another seed is not what was saved.
    let other = arguments(&stopped, &["--spp", &target, "--resume", "--seed", "5"]);
    let message = fails(1, &other.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(message.contains("accumulation.bin") && message.contains("settings"), "{message}");
}

#[test]
fn a_bad_output_folder_is_named_and_nothing_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "x").unwrap();
    let inside = file.join("out");
    let mut arguments = vec!["render", "cornell", "--out", inside.to_str().unwrap()];
    arguments.extend(SMALL);
    let message = fails(1, &arguments);
    assert!(message.contains("file/out") && message.contains("check that the folder"), "{message}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error_and_leaves_no_half_file() {
    let folder = tempfile::tempdir().unwrap();
    // A limit on file sizes stands for the full disk: writes fail in the middle.
    let script = format!(
        "trap '' XFSZ; ulimit -f 2; exec '{}' render cornell --out '{}' {}",
        env!("CARGO_BIN_EXE_patchlight"),
        folder.path().display(),
        SMALL.join(" ").replace("32x24", "200x150")
    );
    let output = Command::new("bash").args(["-c", &script]).output().unwrap();
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("cannot write") && message.contains("full.exr"), "{message}");
    assert!(leftovers(folder.path()).is_empty());
    assert!(!folder.path().join("full.exr").exists());
}

#[test]
fn an_unknown_device_is_named() {
    let message = fails(1, &["render", "cornell", "--device", "no such card", "--quiet"]);
    assert!(message.contains("no such card"), "{message}");
    succeeds(&["devices"]);
}

/// Most lines of a short help.
const SHORT: usize = 60;

#[test]
fn short_help_is_short_and_research_is_hidden() {
    let commands =
        ["render", "bake", "world", "merge", "export", "illuminance", "compare", "devices", "info", "scene", "demo"];
    for command in commands {
        let help = succeeds(&[command, "-h"]);
        assert!(help.lines().count() <= SHORT, "{command}: {} lines", help.lines().count());
    }
    let [shown, hidden] = ["--help", "--help-research"].map(|help| succeeds(&["render", help]));
    for heading in ["Light:", "Method:", "Picture:", "Bake:", "Device:"] {
        assert!(shown.contains(heading) && hidden.contains(heading), "{heading}");
    }
    for option in ["--control-variate", "--cubic", "--graph"] {
        // At the beginning of a line: descriptions of others may name it.
        let listed = format!("\n      {option} <");
        assert!(!shown.contains(&listed) && hidden.contains(&listed), "{option}");
    }
    assert!(shown.contains("--help-research") && !shown.contains("Research:") && hidden.contains("Research:"));
    // What is hidden works as before.
    fails(2, &["render", "cornell", "--cubic", "newtonian"]);
}

#[test]
fn completions_and_manual_pages_are_those_of_the_command_line() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let text = succeeds(&["completions", shell]);
        assert!(text.contains("patchlight") && text.contains("illuminance"), "{shell}");
    }
    fails(2, &["completions", "tcsh"]);
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("man1");
    succeeds(&["man", pages.to_str().unwrap()]);
    let read = |name: &str| std::fs::read_to_string(pages.join(name)).unwrap();
    assert!(read("patchlight.1").contains("radiosity") && read("patchlight-render.1").contains("receiver"));
    assert!(!pages.join("patchlight-help.1").exists() && leftovers(&pages).is_empty());
    let file = folder.path().join("file");
    std::fs::write(&file, "x").unwrap();
    assert!(fails(1, &["man", file.join("man1").to_str().unwrap()]).contains("file/man1"));
}

/// A copy of the program in a folder of its own, where no other program lies beside it.
#[cfg(unix)]
fn alone(folder: &Path) -> Command {
    let copy = folder.join("patchlight");
    std::fs::copy(env!("CARGO_BIN_EXE_patchlight"), &copy).unwrap();
    let mut command = Command::new(copy);
    command.env("PATH", folder.join("bin"));
    command
}

#[cfg(unix)]
#[test]
fn other_programs_are_started_with_what_they_are_given_or_the_command_that_builds_them_is_said() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    for (command, program) in [("view", "patchlight-view"), ("bench", "patchlight-bench")] {
        let missing = alone(folder.path()).args([command, "cornell"]).output().unwrap();
        let message = text(&missing.stderr);
        assert_eq!(missing.status.code(), Some(1), "{message}");
        assert!(
            message.contains(program) && message.contains(&format!("cargo build --release -p {program}")),
            "{message}"
        );
        // Beside the program, then in PATH.
        for place in ["", "bin"] {
            let place = folder.path().join(place);
            std::fs::create_dir_all(&place).unwrap();
            let script = place.join(program);
            std::fs::write(&script, "#!/bin/sh\nfor a in \"$@\"; do echo \"<$a>\"; done\nexit 7\n").unwrap();
            std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).unwrap();
            let given = ["--device", "cpu", command, "a scene", "--help", "--size", "1x1"];
            let output = alone(folder.path()).args(given).output().unwrap();
            assert_eq!(output.status.code(), Some(7), "{}", text(&output.stderr));
            let lines = text(&output.stdout);
            assert_eq!(lines, "<--device>\n<cpu>\n<a scene>\n<--help>\n<--size>\n<1x1>\n");
            std::fs::remove_file(&script).unwrap();
        }
    }
}

#[test]
fn the_default_method_is_the_one_that_is_recommended() {
    let folder = tempfile::tempdir().unwrap();
    let name = |file: &str| folder.path().join(file).to_str().unwrap().to_owned();
    let method = |scene: &str, more: &[&str]| -> String {
        let out = name("out");
        let arguments = ["render", scene, "--json", "--out", &out];
        let summary = succeeds(
            &[&arguments[..], &["--size", "32x24", "--device", "cpu", "--quiet", "--spp", "2"], more].concat(),
        );
        let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
        summary["method"].as_str().unwrap().to_owned()
    };
    let small = ["--rays", "64", "--patch-count", "100"];
    assert_eq!(method("cornell", &small), "low_rank");
    assert_eq!(method("cornell", &[&small[..], &["--method", "classic"]].concat()), "classic");
    let bake = name("a.bake");
    for (methods, expected) in [("classic", "classic"), ("feedback", "feedback"), ("low_rank", "low_rank")] {
        let baked = ["bake", "cornell", "--for", methods, "--quiet", "--out", &bake, "--device", "cpu"];
        succeeds(&[&baked[..], &small].concat());
        assert_eq!(method(&bake, &[]), expected);
        std::fs::remove_file(&bake).unwrap();
    }
}

#[test]
fn a_device_is_refused_where_only_native_code_works() {
    for arguments in [
        &["merge", "part.bake"][..],
        &["world", "cornell", "--plan", "2", "--format", "slurm"],
        &["render", "cornell", "--method", "path"],
        &["compare", "a.exr", "b.exr"],
        &["scene", "cornell"],
        &["info", "cornell"],
        &["info", "cornell", "--operator", "--codec", "dense"],
    ] {
        let message = fails(1, &[arguments, &["--device", "vulkan"]].concat());
        assert!(message.contains("--device vulkan") && message.contains("--device cpu"), "{message}");
        assert!(message.contains(arguments[0]), "{message}");
    }
    succeeds(&["info", "cornell", "--device", "cpu"]);
}

#[test]
fn one_product_gives_what_many_bounces_give() {
    let folder = tempfile::tempdir().unwrap();
    let full = |method: &str, more: &[&str]| {
        let out = folder.path().join([method, &more.concat()].concat());
        let mut arguments = vec!["render", "cornell", "--method", method, "--patches", "cluster", "--out"];
        arguments.push(out.to_str().unwrap());
        arguments.extend(SMALL);
        arguments.extend(more);
        succeeds(&arguments);
        let summary: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
        assert_eq!(summary["bytes"].get("operator").is_some(), method != "classic", "{summary}");
        let codec = more.iter().position(|option| *option == "--codec").map(|k| more[k + 1]);
        assert_eq!(summary.get("codec").and_then(|name| name.as_str()), codec, "{summary}");
        reference::Picture::read(&out.join("indirect.exr")).unwrap().pixels.iter().map(|c| c.element_sum()).sum::<f32>()
    };
    let classic = full("classic", &[]);
    for (method, more) in [
        ("low_rank", vec!["--epsilon", "0.01"]),
        ("feedback", vec![]),
        ("feedback", vec!["--epsilon=0.001"]),
        ("multibounce", vec![]),
        ("multibounce", vec!["--codec", "dense"]),
        ("multibounce", vec!["--codec", "f16"]),
        ("multibounce", vec!["--codec", "bc1"]),
        ("multibounce", vec!["--codec", "bc3"]),
        ("multibounce", vec!["--codec", "bc6h"]),
        ("multibounce", vec!["--codec", "bc7"]),
    ] {
        let found = full(method, &more);
        // Patches with 64 rays: making F reciprocal moves some light.
        assert!((found / classic - 1.0).abs() < 0.03, "{method}: {found} {classic}");
    }
    let one = full("low_rank", &["--bounces", "3"]);
    assert!(one < 0.98 * classic, "three bounces are not all: {one} {classic}");
    assert!(fails(2, &["render", "cornell", "--method", "low_rank", "--epsilon", "2"]).contains("epsilon"));
    assert!(fails(2, &["render", "cornell", "--method", "multibounce", "--codec", "bc2"]).contains("bc6h"));
    // Native code has no texture unit: said before anything is baked.
    let asked = ["--method", "multibounce", "--codec", "bc1", "--decode", "texture", "--device", "cpu"];
    let message = fails(1, &[&["render", "cornell"][..], &asked].concat());
    assert!(message.contains("textureCompressionBC") && message.contains("--decode kernel"), "{message}");
}

#[test]
fn the_short_form_of_a_method_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let picture = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let mut arguments = vec!["render", "cornell", "--out", out.to_str().unwrap()];
        arguments.extend(SMALL);
        arguments.extend(more);
        succeeds(&arguments);
        std::fs::read(out.join("full.exr")).unwrap()
    };
    let short = picture("short", &["--method", "low_rank", "--epsilon", "0.1"]);
    let long = ["--method", "multibounce", "--codec", "low_rank", "--epsilon", "0.1"];
    assert_eq!(short, picture("long", &long));
    assert_ne!(short, picture("other", &["--method", "multibounce", "--codec", "bc1"]));
}

#[test]
fn too_many_triangles_for_classic_is_said_with_a_remedy() {
    let message = fails(1, &["render", "atrium:120000", "--patches", "polygon", "--quiet", "--size", "32x24"]);
    assert!(message.contains("--method path"), "{message}");
}

#[test]
fn patches_of_voxels_render_with_every_kind_of_receivers() {
    let folder = tempfile::tempdir().unwrap();
    let mut counts = Vec::new();
    for patches in ["voxel", "axis"] {
        for receivers in ["self", "mesh", "pixels"] {
            let out = folder.path().join(format!("{patches}-{receivers}"));
            let out = out.to_str().unwrap();
            let mut arguments = vec!["render", "cornell", "--patches", patches, "--receivers", receivers];
            arguments.extend(["--receiver-rays", "16", "--json", "--out", out]);
            arguments.extend(SMALL);
            let summary: serde_json::Value = serde_json::from_str(&succeeds(&arguments)).unwrap();
            let count = summary["patches"].as_u64().unwrap();
            assert!((70..130).contains(&count), "{patches}: {count}");
            assert_eq!(summary["receivers"].as_u64().unwrap() > 0, receivers == "mesh", "{summary}");
            assert!(Path::new(out).join("indirect.exr").is_file());
            counts.push(count);
        }
        // Voxels of this size, whatever the count.
        let out = folder.path().join(patches);
        let mut arguments = vec!["render", "cornell", "--patches", patches, "--receivers", "self", "--json"];
        arguments.extend(["--voxel-size", "0.1", "--out", out.to_str().unwrap()]);
        arguments.extend(SMALL);
        let summary: serde_json::Value = serde_json::from_str(&succeeds(&arguments)).unwrap();
        assert!(summary["patches"].as_u64().unwrap() > 200, "{summary}");
    }
    assert_eq!(counts[0], counts[1]);
}

#[test]
fn what_patches_cannot_do_is_said_with_a_remedy() {
    for patches in ["polygon", "cluster"] {
        let render = |more: &[&'static str]| {
            let mut arguments = vec!["render", "cornell", "--patches", patches, "--quiet"];
            arguments.extend(more);
            fails(1, &arguments)
        };
        let message = render(&["--receivers", "self"]);
        for word in [patches, "--patches voxel or axis", "--receivers mesh"] {
            assert!(message.contains(word), "{message}");
        }
        for message in
            [render(&["--voxel-size", "0.1"]), fails(1, &["info", "cornell", "--patches", patches, "--voxel-size=0.1"])]
        {
            for word in ["--voxel-size", patches, "--patches voxel or axis", "--patch-count"] {
                assert!(message.contains(word), "{message}");
            }
        }
    }
    for size in ["0", "-1", "NaN", "inf", "wide"] {
        let message = fails(2, &["render", "cornell", "--patches", "axis", &format!("--voxel-size={size}")]);
        assert!(message.contains("--voxel-size") && message.contains("length in metres"), "{message}");
    }
    for (size, words) in
        [("0.003", ["occupied voxels", "larger --voxel-size"]), ("0.00001", ["voxels", "larger --voxel-size"])]
    {
        let size = format!("--voxel-size={size}");
        let message = fails(1, &["render", "cornell", "--patches", "axis", &size, "--quiet"]);
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    }
    fails(2, &["render", "cornell", "--voxel-size", "small"]);
    fails(2, &["render", "cornell", "--patches", "hexagon"]);
    let message = fails(
        1,
        &["render", "cornell", "--patches", "voxel", "--form-factors", "contour", "--quiet", "--patch-count", "50"],
    );
    assert!(message.contains("outlines"), "{message}");
}

#[test]
fn info_describes_the_patches() {
    let info = |more: &[&str]| -> serde_json::Value {
        let mut arguments = vec!["info", "cornell", "--json"];
        arguments.extend(more);
        serde_json::from_str(&succeeds(&arguments)).unwrap()
    };
    assert!(info(&[]).get("patches").is_none());
    for kind in ["polygon", "cluster", "voxel", "axis"] {
        let all = info(&["--patches", kind, "--patch-count", "200"]);
        let found = &all["patches"];
        let number = |key: &str| found[key].as_f64().unwrap_or_else(|| panic!("{key}: {found}"));
        let count = number("patches");
        assert_eq!(found["kind"], kind);
        assert!((count / 200.0 - 1.0).abs() < 0.1, "{found}");
        assert!(number("samples") > count && number("sample_points") >= number("samples"), "{found}");
        assert!(number("elements") >= count);
        // Of both sides, the inner ones of the walls, and the outer ones of the boxes.
        assert!((number("surface_sides_m2") / (2.0 * all["area_m2"].as_f64().unwrap()) - 1.0).abs() < 1e-6);
        let share = number("area_m2") / number("surface_sides_m2");
        assert!((0.45..0.55).contains(&share), "{found}");
        let least = number("min_area_m2");
        let middle = number("median_area_m2");
        let most = number("max_area_m2");
        assert!(0.0 < least && least <= middle && middle <= most && most * count >= number("area_m2"), "{found}");
        let has_voxels = ["voxel", "axis"].contains(&kind);
        assert_eq!(found.get("voxels").is_some() && found.get("voxel_edge_m").is_some(), has_voxels);
        if has_voxels {
            assert!(number("voxels") <= count && count <= 6.0 * number("voxels"), "{found}");
        }
        assert!(found["bytes"].as_array().unwrap().iter().any(|part| part[1].as_u64().unwrap() > 0));
        assert!(succeeds(&["info", "cornell", "--patches", kind, "--patch-count=200"]).contains("area of a patch"));
    }
    let edge = info(&["--patches", "axis", "--voxel-size", "0.2"])["patches"]["voxel_edge_m"].as_f64().unwrap();
    assert!((edge - 0.2).abs() < 1e-6);
}

#[test]
fn info_tells_what_operators_take_and_lose() {
    let folder = tempfile::tempdir().unwrap();
    let info = |codec: &str, epsilon: &str| -> serde_json::Value {
        let out = folder.path().join([codec, epsilon].concat());
        let arguments = ["info", "cornell", "--patches", "cluster", "--patch-count", "150", "--json", "--operator"];
        let more = ["--codec", codec, "--epsilon", epsilon, "--out", out.to_str().unwrap()];
        let all: serde_json::Value = serde_json::from_str(&succeeds(&[&arguments[..], &more[..]].concat())).unwrap();
        all["operator"].clone()
    };
    let number = |value: &serde_json::Value, key: &str| value[key].as_f64().unwrap_or_else(|| panic!("{key}: {value}"));
    for (codec, limit) in [("dense", 1e-6), ("f16", 1e-3), ("bc1", 0.1), ("bc3", 0.1), ("bc6h", 0.1), ("bc7", 0.1)] {
        let found = info(codec, "0.01");
        let radius = number(&found, "spectral_radius");
        let t = &found["stored"][0];
        assert_eq!((t["operator"].as_str(), t["codec"].as_str()), (Some("T"), Some(codec)));
        assert!((0.1..0.95).contains(&radius) && (number(t, "spectral_radius") - radius).abs() < 0.01, "{found}");
        assert!(number(t, "frobenius") <= limit && number(t, "compact_lights") <= limit, "{t}");
        assert!(number(t, "own_light") <= number(t, "compact_lights") + 1e-6, "{t}");
        assert!(number(t, "total_bytes") <= 3.1 * number(&found, "dense_bytes"), "{t}");
        assert_eq!(found["stored"].as_array().unwrap().len(), 1);
        let is_blocks = codec.starts_with("bc");
        assert_eq!(t["order_mse"].as_array().map(Vec::len), is_blocks.then_some(5), "{t}");
        assert_eq!(t["decode"].as_str().is_some(), is_blocks, "{t}");
    }
    let fine = info("low_rank", "0.001");
    let coarse = info("low_rank", "0.1");
    for k in 0..2 {
        let fine = &fine["stored"][k];
        let coarse = &coarse["stored"][k];
        assert!(number(fine, "frobenius") <= 0.001 && number(coarse, "frobenius") > 0.01, "{fine} {coarse}");
        assert!(number(fine, "total_bytes") > number(coarse, "total_bytes"), "{fine} {coarse}");
        assert!(number(&fine["tiles"], "entries") > 0.0, "{fine}");
    }
    // The error is darker than the matrix, and least where least was allowed.
    let mean = |folder_name: &str, name: &str| -> f32 {
        let picture = reference::Picture::read(&folder.path().join(folder_name).join(format!("{name}.png"))).unwrap();
        assert_eq!((picture.width, picture.height), (150, 150));
        picture.pixels.iter().map(|p| p.x).sum::<f32>() / picture.pixels.len() as f32
    };
    for codec in ["f160.01", "bc10.01", "low_rank0.1"] {
        assert!(mean(codec, "matrix-error") < 0.6 * mean(codec, "matrix"), "{codec}");
    }
    assert!(mean("low_rank0.001", "matrix-error") < mean("low_rank0.1", "matrix-error"));
    assert!((mean("bc10.01", "matrix-reordered") - mean("bc10.01", "matrix")).abs() < 1e-3);
    assert!(!folder.path().join("dense0.01/matrix-reordered.png").exists());
    assert!(fails(2, &["info", "cornell", "--codec", "bc1"]).contains("--operator"));
}

#[test]
fn the_demo_writes_a_report_that_needs_no_other_file() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    succeeds(&["--quiet", "--device", "cpu", "--out", out]);
    let report = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    let words =
        ["cornell", "atrium", "office", "data:image/jpeg;base64,", "median ms", "against the path tracer", "CPU"];
    for word in words.into_iter().chain(["Frame graph, operator in tiles", "type=\"range\"", ">First shot</button>"]) {
        assert!(report.contains(word), "{word}");
    }
    // Six methods beside each other: in the tables of times, memory and phases, and one by one in those of errors.
    let head = "<th>classic</th><th>low_rank</th><th>feedback</th><th>temporal</th><th>local</th><th>firstshot</th>";
    assert_eq!(report.matches(head).count(), 9);
    assert_eq!(report.matches("<td>frame 5, low_rank</td>").count(), 6);
    let summary: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.path().join("summary.json")).unwrap()).unwrap();
    let methods: Vec<&str> = summary.as_array().unwrap().iter().filter_map(|s| s["method"].as_str()).collect();
    assert_eq!(methods, ["classic", "low_rank", "feedback", "temporal", "local", "firstshot"].repeat(3));
    let ssim = |k: usize| summary[k]["indirect"]["ssim"].as_f64().unwrap();
    assert!((0..18).all(|k| (ssim(k) - ssim(k / 6 * 6)).abs() < 0.02 && ssim(k) > 0.1), "{summary}");
    assert!(!report.contains("http") && report.len() < 5 << 20);
    for name in
        ["cornell/frame-0000.png", "atrium/classic/full.exr", "cornell/feedback/full.exr", "atrium/path/full.exr"]
    {
        assert!(folder.path().join(name).is_file(), "{name}");
    }
}

/// Colours of a picture, and the share of its pixels that are not black.
fn colours(path: &Path) -> (usize, f64) {
    let picture = reference::Picture::read(path).unwrap();
    let seen: std::collections::HashSet<[u32; 3]> =
        picture.pixels.iter().map(|p| p.to_array().map(f32::to_bits)).collect();
    let bright = picture.pixels.iter().filter(|p| p.max_element() > 0.0).count();
    (seen.len(), bright as f64 / picture.pixels.len() as f64)
}

#[test]
fn debug_pictures_show_the_bake() {
    let folder = tempfile::tempdir().unwrap();
    let always = ["patches", "axis", "source", "irradiance"];
    for (patches, receivers) in [
        ("polygon", "mesh"),
        ("polygon", "pixels"),
        ("cluster", "mesh"),
        ("cluster", "pixels"),
        ("voxel", "mesh"),
        ("voxel", "self"),
        ("axis", "mesh"),
        ("axis", "self"),
        ("axis", "pixels"),
    ] {
        let out = folder.path().join(format!("{patches}-{receivers}"));
        let mut arguments =
            vec!["render", "cornell", "--method", "classic", "--patches", patches, "--receivers", receivers, "--debug"];
        arguments.extend(["--receiver-rays", "16", "--out", out.to_str().unwrap()]);
        arguments.extend(SMALL);
        succeeds(&arguments);
        let written = |name: &str| out.join("debug").join(format!("{name}.png")).is_file();
        assert!(always.iter().all(|name| written(name)), "{patches}, {receivers}");
        // Elements where they are not the patches, receivers where there are some, the worst with a
        // reference only.
        assert_eq!(written("elements"), patches == "cluster");
        for name in ["receivers", "refined"] {
            assert_eq!(written(name), receivers == "mesh", "{patches}, {receivers}: {name}");
        }
        assert!(!written("worst") && leftovers(&out.join("debug")).is_empty());
        let (patch_colours, owned) = colours(&out.join("debug/patches.png"));
        assert!(patch_colours > 30 && owned > 0.5, "{patches}: {patch_colours} {owned}");
        for name in ["source", "irradiance"] {
            let (found, lit) = colours(&out.join(format!("debug/{name}.png")));
            assert!(found > 20 && lit > 0.2, "{patches}, {receivers}, {name}: {found} {lit}");
        }
        // Five directions are seen, darker where they are seen from the side.
        assert!(colours(&out.join("debug/axis.png")).0 >= 5);
    }
    // The reference is a picture that was rendered before, without its lower half.
    let reference = folder.path().join("reference");
    std::fs::create_dir(&reference).unwrap();
    for name in ["full", "direct", "indirect"] {
        let from = folder.path().join("cluster-mesh").join(format!("{name}.exr"));
        let mut picture = reference::Picture::read(&from).unwrap();
        let half = picture.pixels.len() / 2;
        picture.pixels[half..].fill(glam::Vec3::ZERO);
        picture.write_exr(&reference.join(format!("{name}.exr")), reference::Precision::Single).unwrap();
    }
    // Points in the middle of the box that look at its walls, with light of their own.
    let columns = "direct_r,direct_g,direct_b,indirect_r,indirect_g,indirect_b,se_indirect_r,se_indirect_g,se_indirect_b,\
                   se_direct_r,se_direct_g,se_direct_b";
    let point = |normal: &str, light: f32| format!("0.5,0.5,0.5,{normal},0,0,0,{light},{light},{light},0,0,0,0,0,0\n");
    let points = point("0,1,0", 1.0) + &point("1,0,0", 100.0) + &point("0,-1,0", 0.1);
    std::fs::write(reference.join("points.csv"), format!("px,py,pz,nx,ny,nz,{columns}\n{points}")).unwrap();
    let out = folder.path().join("worst");
    let mut arguments = vec!["render", "cornell", "--method", "classic", "--patches", "cluster", "--debug", "--json"];
    arguments.extend(["--reference", reference.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    arguments.extend(SMALL);
    let summary: serde_json::Value = serde_json::from_str(&succeeds(&arguments)).unwrap();
    assert!(summary.get("debug").is_none());
    let table = std::fs::read_to_string(out.join("points.csv")).unwrap();
    let lines: Vec<Vec<&str>> = table.lines().map(|line| line.split(',').collect()).collect();
    assert!(lines.len() == 4 && lines.iter().all(|line| line.len() == 16), "{table}");
    let number = |line: usize, name: &str| -> f64 {
        lines[line][lines[0].iter().position(|n| *n == name).unwrap()].parse().unwrap()
    };
    // Worst first, relative to 5 % of the mean at least; what was asked for stands beside what was found.
    let errors = [1, 2, 3].map(|line| number(line, "relative_error"));
    assert!(errors[0] >= errors[1] && errors[1] >= errors[2] && errors[0] > 0.0, "{table}");
    for line in 1..4 {
        let found = number(line, "indirect_g");
        let asked = number(line, "reference_g");
        let luminance = |name: &str| {
            0.2126 * number(line, &format!("{name}_r"))
                + 0.7152 * number(line, &format!("{name}_g"))
                + 0.0722 * number(line, &format!("{name}_b"))
        };
        let least = 0.05 * (1.0 + 100.0 + 0.1) / 3.0;
        let error = (luminance("indirect") - luminance("reference")).abs() / asked.max(least);
        assert!(found >= 0.0 && (error - number(line, "relative_error")).abs() < 1e-3 * (1.0 + error), "{table}");
    }
    let worst = reference::Picture::read(&out.join("debug/worst.png")).unwrap();
    assert_eq!((worst.width, worst.height), (64, 24));
    // 3 × 4 blocks, and all of them are among the worst 16: frames on both sides.
    assert!(worst.pixels.iter().filter(|p| p.x > 0.9 && p.y < 0.1).count() > 20);
    // A path-traced picture has no bake to show.
    let out = folder.path().join("path");
    let mut arguments = vec!["render", "cornell", "--method", "path", "--debug", "--out", out.to_str().unwrap()];
    arguments.extend(SMALL);
    succeeds(&arguments);
    assert!(!out.join("debug").exists());
}

#[test]
fn the_frame_graph_is_written_with_times() {
    let folder = tempfile::tempdir().unwrap();
    let [out, graph] = ["out", "frame.dot"].map(|name| folder.path().join(name));
    let mut arguments = vec!["render", "cornell", "--method", "low_rank", "--graph", graph.to_str().unwrap()];
    arguments.extend(["--out", out.to_str().unwrap()]);
    arguments.extend(SMALL);
    succeeds(&arguments);
    let text = std::fs::read_to_string(&graph).unwrap();
    assert!(text.starts_with("digraph") && text.ends_with("}\n"), "{text}");
    for pass in ["direct", "method", "gather", "shade"] {
        let times = text.lines().filter(|line| line.contains(&format!(": {pass}, ")) && line.contains(" ms in all"));
        assert!(times.count() > 0, "{pass} in {text}");
    }
    // Path tracing has no passes; a place that cannot be written to is named before anything is computed.
    arguments[3] = "path";
    succeeds(&arguments);
    let file = out.join("summary.json/frame.dot");
    (arguments[3], arguments[5]) = ("low_rank", file.to_str().unwrap());
    assert!(fails(1, &arguments).contains("summary.json/frame.dot"));
}

#[test]
fn first_shot_writes_pictures_tables_and_maps() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    let mean = |method: &str| {
        let out = out.join(method);
        let mut arguments = vec!["render", "cornell", "--method", method, "--out", out.to_str().unwrap()];
        arguments.extend(SMALL);
        succeeds(&arguments);
        let picture = reference::Picture::read(&out.join("indirect.exr")).unwrap();
        picture.pixels.iter().map(|p| p.element_sum()).sum::<f32>()
    };
    let ratio = mean("firstshot") / mean("classic");
    assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
    let out = out.join("firstshot");
    let text = std::fs::read_to_string(out.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    let photons = &summary["photons"];
    assert!(photons["relative_error"].as_f64().unwrap() <= 0.05 && photons["photons"].as_u64().unwrap() > 1000);
    assert!(summary["bytes"]["maps"].is_number() && summary["bytes"].get("form_factors").is_none());
    let patches = std::fs::read_to_string(out.join("patches.csv")).unwrap();
    assert_eq!(patches.lines().count() as u64, 1 + summary["patches"].as_u64().unwrap());
    // Absorbed light of the table is that of the maps.
    let column = |line: &str, k: usize| line.split(',').nth(k).unwrap().parse::<f64>().unwrap();
    let by_patches: f64 = patches.lines().skip(1).map(|l| column(l, 6) * column(l, 8)).sum();
    assert!(by_patches > 0.0);
    let ply = std::fs::read(out.join("vertices.ply")).unwrap();
    let triangles = std::fs::read_to_string(out.join("maps.csv")).unwrap().lines().count() - 1;
    let header = ply.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    assert_eq!(ply.len(), header + triangles * (3 * 9 * 4 + 1 + 3 * 4));
    let maps = reference::Picture::read(&out.join("maps.exr")).unwrap();
    assert!(maps.width == 1024 && maps.pixels.iter().any(|p| p.y > 0.0));
    assert!(leftovers(&out).is_empty());
    for wrong in [["--error", "1e-9"], ["--error", "2"], ["--error", "few"], ["--photons", "0"], ["--photons", "many"]]
    {
        let message = fails(2, &["render", "cornell", "--method", "firstshot", wrong[0], wrong[1]]);
        assert!(message.contains(wrong[0]), "{message}");
    }
    let own = ["--patches", "voxel", "--receivers", "self", "--size", "32x24", "--patch-count", "60", "--quiet"];
    let message = fails(1, &[&["render", "cornell", "--method", "firstshot"][..], &own].concat());
    assert!(message.contains("--receivers mesh or pixels"), "{message}");
}

#[test]
fn info_and_scene_agree_about_a_built_in_scene() {
    let folder = tempfile::tempdir().unwrap();
    succeeds(&["scene", "cornell", "--out", folder.path().to_str().unwrap()]);
    let written = folder.path().join("cornell.toml");
    let info =
        |spec: &str| -> serde_json::Value { serde_json::from_str(&succeeds(&["info", spec, "--json"])).unwrap() };
    let built = info("cornell");
    let read = info(written.to_str().unwrap());
    for key in ["triangles", "materials", "emissive_materials"] {
        assert_eq!(built[key], read[key], "{key}");
    }
    let ratio = built["area_m2"].as_f64().unwrap() / read["area_m2"].as_f64().unwrap();
    assert!((ratio - 1.0).abs() < 1e-4, "{ratio}");
}
