//! `patchlight view`: scripts drive the window on a display in memory (Xvfb); what it shows is compared with pictures
//! of the library. Skipped where Xvfb or a Vulkan driver is missing, unless `REQUIRE_VULKAN=1`.

mod program;

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::{Affine3A, Vec3};
use patchlight::low_level::operator::{Build, Codec};
use patchlight::{
    Bake, BakeSettings, Estimator, FileSettings, LightSettings, MethodSettings, Origin, PictureRenderer,
    PictureSettings, Silent,
};
use program::{command, fails, leftovers, run, text};
use runtime::cpu::Cpu;
use scene::{DisplayTransform, Lighting, Picture, Tone};
use shell::args::common::FocusChoice;

/// Size of the window, pixels.
const SIZE: (u32, u32) = (160, 120);
/// Error of the operator: large enough that one sees by which method a picture is.
const EPSILON: f64 = 0.4;
/// Codes by which a channel of a shown picture may differ: the library's is the sum of its parts, which rounds.
const TOLERANCE: u8 = 1;

/// A display in memory, until it is dropped.
struct Xvfb {
    server: Child,
    name: String,
}

impl Xvfb {
    /// The display, or `None` after saying why.
    fn start() -> Option<Self> {
        let has_driver = runtime::vulkan::devices().is_ok_and(|devices| !devices.is_empty());
        match Self::new() {
            Ok(display) if has_driver => Some(display),
            found => {
                let reason = found.err().unwrap_or_else(|| "no Vulkan driver".to_owned());
                let required = std::env::var("REQUIRE_VULKAN").is_ok_and(|value| value == "1");
                assert!(!required, "REQUIRE_VULKAN is set: {reason}");
                println!("skipped: {reason}");
                None
            }
        }
    }

    fn new() -> Result<Self, String> {
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "640x480x24", "-nolisten", "tcp"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|error| format!("Xvfb: {error}"))?;
        let mut number = String::new();
        let read = server.stdout.take().map(|out| BufReader::new(out).read_line(&mut number));
        let name = format!(":{}", number.trim());
        let display = Self { server, name };
        match read {
            Some(Ok(1..)) => Ok(display),
            _ => Err("Xvfb names no display".to_owned()),
        }
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = command(arguments);
        command.env("DISPLAY", &self.name).env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
        command
    }

    fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("the program starts")
    }

    /// Runs a command that must succeed.
    fn succeeds(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    /// Runs a command that must fail with exit code 1, and returns its message.
    fn fails(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {message}");
        assert!(!message.contains("panicked"), "{message}");
        message
    }
}

impl Drop for Xvfb {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// A bake in a file, and the folder that it lies in.
fn baked() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("box.bake").display().to_string();
    let loaded = assets::load_or_build("cornell").unwrap();
    let settings = FileSettings {
        origin: Origin {
            scene: "cornell".to_owned(),
            scene_hash: loaded.content_hash,
            application: loaded.description().into_bytes(),
        },
        bake: BakeSettings::default().with_patch_count(150),
        methods: vec![MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON })],
        build: Build::default(),
    };
    Bake::build_into(path.as_ref(), &loaded.scene, &settings, &mut Cpu::new(), &Silent).unwrap();
    (folder, path)
}

/// Shows a bake as a script says, in a window of [`SIZE`] on the processor; screenshots are in the folder.
fn show(display: &Xvfb, folder: &Path, bake: &str, script: &str, more: &[&str]) {
    let script = write(folder, script);
    let out = folder.display().to_string();
    let options = [bake, "--size", "160x120", "--script", &script, "--device", "cpu", "--out", &out];
    display.succeeds(&[&options[..], more].concat());
}

fn write(folder: &Path, script: &str) -> String {
    let path = folder.join("script.txt");
    std::fs::write(&path, script).unwrap();
    path.display().to_string()
}

/// A picture of the library as it is displayed: bytes red, green, blue.
fn picture(bake: &str, method: MethodSettings, size: (u32, u32), change: impl Fn(&mut Lighting)) -> Vec<u8> {
    linear_picture(bake, method, size, change).shown_bytes(&transform(&assets::load_or_build("cornell").unwrap()))
}

/// The picture itself.
fn linear_picture(bake: &str, method: MethodSettings, size: (u32, u32), change: impl Fn(&mut Lighting)) -> Picture {
    let opened = Bake::open(bake.as_ref()).unwrap();
    let description = std::str::from_utf8(&opened.origin.application).unwrap().to_owned();
    let loaded = assets::LoadedScene::of_description(opened.bake.scene().clone(), &description).unwrap();
    let light = LightSettings::default().with_method(method);
    let pictures = PictureSettings::default().with_size(size).with_sub_frames(1);
    let mut lighting = opened.bake.scene().lighting.clone();
    change(&mut lighting);
    let mut renderer =
        PictureRenderer::of_bake(Arc::new(opened.bake), Box::new(Cpu::new()), &light, &pictures, &Silent).unwrap();
    let camera = loaded.view.camera(size.0, size.1);
    renderer.picture(&lighting, &camera, 0).unwrap().pictures.full
}

/// Exposure and tone curve of a built-in scene's pictures.
fn transform(loaded: &assets::LoadedScene) -> DisplayTransform {
    DisplayTransform { stops: loaded.exposure_stops, tone: Tone::Agx }
}

/// A screenshot: size, bytes red, green, blue.
fn screenshot(path: &Path) -> ((u32, u32), Vec<u8>) {
    let read = image::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display())).to_rgb8();
    (read.dimensions(), read.into_raw())
}

/// Greatest difference of two pictures, and how many bytes differ by more than the tolerance.
fn difference(a: &[u8], b: &[u8]) -> (u8, usize) {
    assert_eq!(a.len(), b.len());
    let pairs = a.iter().zip(b).map(|(x, y)| x.abs_diff(*y));
    (pairs.clone().max().unwrap_or(0), pairs.filter(|difference| *difference > TOLERANCE).count())
}

#[test]
fn the_window_shows_the_pictures_of_the_library() {
    let Some(display) = Xvfb::start() else { return };
    let (folder, bake) = baked();
    let script = write(
        folder.path(),
        "panels off
         wait 1
         screenshot tiles.png
         method classic
         screenshot classic.png
         light 1 color 1 0.1 0.1
         screenshot red.png
         size 200x150
         wait 10
         screenshot larger.png
         quit",
    );
    let tiles = MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON });
    let classic = MethodSettings::Classic;
    let red = |lighting: &mut Lighting| {
        lighting.lights[0].color = Vec3::new(1.0, 0.1, 0.1) * lighting.lights[0].color.max_element();
    };
    let same = |_: &mut Lighting| {};
    let expected = [
        ("tiles.png", picture(&bake, tiles, SIZE, same)),
        ("classic.png", picture(&bake, classic, SIZE, same)),
        ("red.png", picture(&bake, classic, SIZE, red)),
        ("larger.png", picture(&bake, classic, (200, 150), red)),
    ];
    // By the processor, whose pictures are copied into the window, and on the device of the window.
    for device in ["cpu", "vulkan"] {
        let out = folder.path().join(device);
        let options =
            [&bake, "--size", "160x120", "--script", &script, "--device", device, "--out", out.to_str().unwrap()];
        let printed = display.succeeds(&options);
        assert!(printed.contains("a second") && printed.contains("presenting"), "what limits the rate: {printed}");
        let shown: Vec<Vec<u8>> = expected
            .iter()
            .map(|(name, expected)| {
                let ((width, height), shown) = screenshot(&out.join(name));
                assert_eq!((width * height * 3) as usize, expected.len(), "{device} {name}: {width} x {height}");
                assert_eq!(difference(&shown, expected).1, 0, "{device} {name}");
                shown
            })
            .collect();
        // Another method or another light is noticed.
        for (a, b) in [(0, 1), (1, 2)] {
            let (greatest, wrong) = difference(&shown[a], &expected[b].1);
            assert!(greatest > TOLERANCE && wrong > 100, "{device} {a} {b}: {greatest} {wrong}");
        }
        assert_eq!(leftovers(&out), Vec::<String>::new());
    }
}

#[test]
fn a_scene_is_shown_before_its_bake_is_done_and_ends_as_that() {
    let Some(display) = Xvfb::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let loaded = assets::load_or_build("cornell").unwrap();
    let script = "panels off\nwait 1\nscreenshot first.png\nseconds 0.1\nbaked\nscreenshot last.png\nquit";
    let options = ["--patch-count", "2400", "--receiver-rays", "64", "--rays", "512", "--method", "classic"];
    show(&display, folder.path(), "cornell", script, &[&options[..], &["--for", "classic"]].concat());
    let settings = BakeSettings::default()
        .with_patch_count(2400)
        .with_receiver_rays(64)
        .with_estimator(Estimator::Hemisphere { rays: 512 })
        .with_focus(FocusChoice::default().focus(&loaded, &loaded.animation));
    let bake = Arc::new(Bake::build(&loaded.scene, &settings, &Silent).unwrap());
    let pictures = PictureSettings::default().with_size(SIZE).with_sub_frames(1);
    let light = LightSettings::default();
    let mut renderer = PictureRenderer::of_bake(bake, Box::new(Cpu::new()), &light, &pictures, &Silent).unwrap();
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let expected = renderer.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures.full;
    let expected = expected.shown_bytes(&transform(&loaded));
    assert_eq!(difference(&screenshot(&folder.path().join("last.png")).1, &expected).1, 0);
    // The first level is a picture of the same room, and another one.
    let (greatest, wrong) = difference(&screenshot(&folder.path().join("first.png")).1, &expected);
    assert!(wrong > 100 && greatest < 128, "{greatest} {wrong}");
}

#[test]
fn exposure_follows_what_is_seen_and_curves_are_chosen() {
    let Some(display) = Xvfb::start() else { return };
    let (folder, path) = baked();
    let script = "panels off
         exposure auto
         wait 60
         screenshot film.png
         tone neutral
         wait 1
         screenshot neutral.png
         exposure -1
         tone none
         wait 1
         screenshot dark.png
         quit";
    show(&display, folder.path(), &path, script, &["--method", "classic", "--exposure", "5"]);
    let picture = linear_picture(&path, MethodSettings::Classic, SIZE, |_| {});
    let automatic = picture.automatic_stops();
    for (name, stops, tone, most) in [
        ("film.png", automatic, Tone::Agx, 4),
        ("neutral.png", automatic, Tone::Neutral, 4),
        ("dark.png", -1.0, Tone::None, 1),
    ] {
        let shown = screenshot(&folder.path().join(name)).1;
        let transform = DisplayTransform { stops, tone };
        assert!(difference(&shown, &picture.shown_bytes(&transform)).0 <= most, "{name}");
        let brighter = DisplayTransform { stops: stops + 0.3, tone };
        assert!(difference(&shown, &picture.shown_bytes(&brighter)).0 > most, "{name}: a third of a stop is noticed");
    }
    let output = display.run(&[&path, "--exposure", "bright"]);
    assert_eq!(output.status.code(), Some(2));
    let refused = text(&output.stderr);
    assert!(refused.contains("bright") && refused.contains("auto"), "{refused}");
}

#[test]
fn edges_become_smooth_while_nothing_moves() {
    let Some(display) = Xvfb::start() else { return };
    let (folder, path) = baked();
    let script = "panels off
         wait 1
         screenshot sharp.png
         smooth on
         wait 40
         screenshot smooth.png
         quit";
    // A budget that no frame keeps: what rests has all pixels nevertheless.
    show(&display, folder.path(), &path, script, &["--method", "classic", "--fps", "1000"]);
    let opened = Bake::open(path.as_ref()).unwrap();
    let loaded = assets::load_or_build("cornell").unwrap();
    let pictures = PictureSettings::default().with_size(SIZE).with_sub_frames(16);
    let light = LightSettings::default();
    let lighting = opened.bake.scene().lighting.clone();
    let bake = Arc::new(opened.bake);
    let mut renderer = PictureRenderer::of_bake(bake, Box::new(Cpu::new()), &light, &pictures, &Silent).unwrap();
    let expected = renderer.picture(&lighting, &loaded.view.camera(SIZE.0, SIZE.1), 0).unwrap().pictures.full;
    let expected = expected.shown_bytes(&transform(&loaded));
    let error = |name: &str| {
        let (size, shown) = screenshot(&folder.path().join(name));
        assert_eq!(size, SIZE, "{name}");
        shown.iter().zip(&expected).map(|(a, b)| u64::from(a.abs_diff(*b)).pow(2)).sum::<u64>()
    };
    let [sharp, smooth] = [error("sharp.png"), error("smooth.png")];
    assert!(smooth * 4 < sharp && smooth > 0, "{smooth} beside {sharp}");
}

#[test]
fn light_follows_an_object_that_is_moved() {
    let Some(display) = Xvfb::start() else { return };
    let (folder, path) = baked();
    let script = "panels off
         wait 1
         screenshot before.png
         move tall block 0.15 0 -0.1
         baked
         wait 1
         screenshot after.png
         quit";
    show(&display, folder.path(), &path, script, &["--method", "classic"]);
    let opened = Bake::open(path.as_ref()).unwrap();
    let loaded = assets::load_or_build("cornell").unwrap();
    let object = loaded.objects.iter().position(|name| name == "tall block").unwrap();
    let mut edit = opened.bake.scene().edit();
    edit.transform(object as u32, Affine3A::from_translation(Vec3::new(0.15, 0.0, -0.1)));
    let moved = Arc::new(opened.bake.edit(&edit.build().unwrap(), &Silent).unwrap().bake);
    let pictures = PictureSettings::default().with_size(SIZE).with_sub_frames(1);
    let light = LightSettings::default();
    let mut renderer = PictureRenderer::of_bake(moved, Box::new(Cpu::new()), &light, &pictures, &Silent).unwrap();
    let lighting = opened.bake.scene().lighting.clone();
    let expected = renderer.picture(&lighting, &loaded.view.camera(SIZE.0, SIZE.1), 0).unwrap().pictures.full;
    let expected = expected.shown_bytes(&transform(&loaded));
    assert_eq!(difference(&screenshot(&folder.path().join("after.png")).1, &expected).1, 0);
    let (greatest, wrong) = difference(&screenshot(&folder.path().join("before.png")).1, &expected);
    assert!(wrong > 1000 && greatest > 64, "the block stands elsewhere: {greatest} {wrong}");
}

#[test]
fn the_window_compares_with_the_path_tracer_and_with_a_file() {
    let Some(display) = Xvfb::start() else { return };
    let (folder, bake) = baked();
    let script = "panels off
         split 0.5
         samples 2
         wait 1
         screenshot paths.png
         quit";
    show(&display, folder.path(), &bake, script, &[]);
    let classic = picture(&bake, MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON }), SIZE, |_| {});
    let (_, shown) = screenshot(&folder.path().join("paths.png"));
    let half = |bytes: &[u8], columns: std::ops::Range<usize>| -> Vec<u8> {
        bytes
            .chunks_exact(3 * SIZE.0 as usize)
            .flat_map(|row| row[3 * columns.start..3 * columns.end].to_vec())
            .collect()
    };
    // The line is in the middle.
    assert_eq!(difference(&half(&shown, 0..78), &half(&classic, 0..78)).1, 0, "the method at the left");
    let (_, wrong) = difference(&half(&shown, 82..160), &half(&classic, 82..160));
    assert!(wrong > 1000, "noise of the paths at the right: {wrong}");

    // A file stands at the right as it is.
    let file = folder.path().join("grey.png");
    let grey = image::RgbImage::from_pixel(SIZE.0, SIZE.1, image::Rgb([90, 120, 150]));
    grey.save(&file).unwrap();
    let script = "panels off\nsplit 0.25\nwait 2\nscreenshot file.png\nquit";
    show(&display, folder.path(), &bake, script, &["--reference", file.to_str().unwrap()]);
    let (_, shown) = screenshot(&folder.path().join("file.png"));
    assert_eq!(difference(&half(&shown, 42..160), &half(grey.as_raw(), 42..160)).1, 0, "the file at the right");
    // Beside displayed colours there is no tone curve.
    let clipped = DisplayTransform { tone: Tone::None, ..transform(&assets::load_or_build("cornell").unwrap()) };
    let method = MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON });
    let clipped = linear_picture(&bake, method, SIZE, |_| {}).shown_bytes(&clipped);
    assert_eq!(difference(&half(&shown, 0..38), &half(&clipped, 0..38)).1, 0, "the method at the left");
}

#[test]
fn keys_and_pointer_of_a_script_move_the_camera() {
    let Some(display) = Xvfb::start() else { return };
    let (folder, bake) = baked();
    let script = "panels off
         wait 1
         screenshot before.png
         key W 5
         screenshot ahead.png
         drag 80 60 100 50
         screenshot turned.png
         key Home
         wait 1
         screenshot back.png
         key Tab
         wait 1
         screenshot panels.png
         quit";
    show(&display, folder.path(), &bake, script, &[]);
    let shot = |name: &str| screenshot(&folder.path().join(name)).1;
    let before = shot("before.png");
    let ahead = shot("ahead.png");
    let turned = shot("turned.png");
    assert!(difference(&before, &ahead).1 > 1000, "W flies");
    assert!(difference(&ahead, &turned).1 > 1000, "a drag turns");
    assert_eq!(difference(&before, &shot("back.png")).1, 0, "Home leads back");
    assert!(difference(&before, &shot("panels.png")).1 > 1000, "Tab shows the panels");
}

/// The box is 0.55 m wide, its camera looks along +z; the wall at its left, where x is greatest, is red, and the tall
/// block stands before the left of its back wall.
#[test]
fn the_object_is_lit_where_it_is_and_hidden_behind_what_is_before_it() {
    let Some(display) = Xvfb::start() else { return };
    let (folder, bake) = baked();
    let script = "panels off
         method classic
         screenshot without.png
         object radius 0.06
         object 0.46 0.1 0.1
         screenshot red.png
         object 0.09 0.1 0.1
         screenshot green.png
         object albedo 0.1 0.1 0.1
         screenshot dark.png
         object albedo 0.8 0.8 0.8
         object 0.4 0.1 0.48
         screenshot hidden.png
         object off
         screenshot off.png
         quit";
    show(&display, folder.path(), &bake, script, &[]);
    let shot = |name: &str| screenshot(&folder.path().join(name)).1;
    let without = shot("without.png");
    // Mean of the pixels that the object changes, and how many they are.
    let object = |name: &str| {
        let shown = shot(name);
        let pixels = shown.chunks_exact(3).zip(without.chunks_exact(3)).filter(|(a, b)| a != b);
        let (sum, count) = pixels.fold((Vec3::ZERO, 0), |(sum, count), (pixel, _)| {
            (sum + Vec3::new(pixel[0].into(), pixel[1].into(), pixel[2].into()), count + 1)
        });
        (sum / count.max(1) as f32, count)
    };
    let ((red, seen), (green, _), (dark, _)) = (object("red.png"), object("green.png"), object("dark.png"));
    assert!(seen > 200, "{seen} pixels");
    assert!(red.x / red.y > 1.2 * green.x / green.y, "beside the red wall {red}, beside the green one {green}");
    assert!(dark.max_element() < 0.7 * green.max_element(), "of a dark albedo {dark} {green}");
    assert_eq!(object("hidden.png").1, 0, "behind the tall block");
    assert_eq!(object("off.png").1, 0);
}

#[test]
fn the_window_shows_the_albedo_that_a_material_is_given() {
    let Some(display) = Xvfb::start() else { return };
    let (folder, bake) = baked();
    let script = "panels off
         method classic
         screenshot own.png
         albedo white 0.1 0.3 0.9
         screenshot blue.png
         albedo white bake
         screenshot again.png
         quit";
    show(&display, folder.path(), &bake, script, &[]);
    let shot = |name: &str| screenshot(&folder.path().join(name)).1;
    let blue = |bytes: &[u8]| bytes.chunks_exact(3).filter(|pixel| pixel[2] > pixel[0].saturating_add(20)).count();
    assert!(blue(&shot("blue.png")) > blue(&shot("own.png")) + 3000, "{}", blue(&shot("blue.png")));
    assert_eq!(difference(&shot("again.png"), &shot("own.png")).1, 0);
    let script = write(folder.path(), "method low_rank\nalbedo white 0.5 0.5 0.5\nquit");
    let message = display.fails(&[&bake, "--size", "64x48", "--device", "cpu", "--script", &script]);
    assert!(message.contains("line 2") && message.contains("low_rank") && message.contains("feedback"), "{message}");
}

#[test]
fn without_a_display_or_a_driver_render_is_named() {
    let mut command = command(&["cornell"]);
    command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    let output = command.output().unwrap();
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("patchlight render") && !message.contains(".rs"), "{message}");
    let Some(display) = Xvfb::start() else { return };
    let mut command = display.command(&["cornell"]);
    command.env("VK_DRIVER_FILES", "/nowhere.json").env("VK_ICD_FILENAMES", "/nowhere.json");
    let output = command.output().unwrap();
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("Vulkan") && message.contains("patchlight render"), "{message}");
}

#[test]
fn mistakes_are_named() {
    assert!(fails(2, &["cornell", "--spp", "3"]).contains("[1, 2, 4, 16]"));
    assert!(fails(2, &["cornell", "--for", "path"]).contains("path tracing"));
    let Some(display) = Xvfb::start() else { return };
    let (folder, bake) = baked();
    let script = write(folder.path(), "wait 1\nlight 9 off\nquit");
    let options = [&bake, "--size", "64x48", "--device", "cpu"];
    let failing = |more: &[&str]| display.fails(&[&options[..], more].concat());
    let message = failing(&["--script", &script]);
    assert!(message.contains("script.txt, line 2: there is no light 9; there are 1"), "{message}");
    write(folder.path(), "method feedback");
    let message = failing(&["--script", &script]);
    assert!(message.contains("line 1") && message.contains("--for feedback"), "{message}");
    assert!(failing(&["--script", "no such"]).contains("no such"));
    assert!(failing(&["--reference", "no such.exr"]).contains("no such.exr"));
    let message = display.fails(&[&bake, "--device", "Voodoo"]);
    assert!(message.contains("Voodoo") && message.contains("0: "), "{message}");
    let ignored = display.run(&[&bake, "--patch-count", "9", "--device", "Voodoo"]);
    assert!(text(&ignored.stderr).contains("--patch-count is for scenes"), "{}", text(&ignored.stderr));
}

#[test]
fn ctrl_c_closes_the_window() {
    let Some(display) = Xvfb::start() else { return };
    let (folder, bake) = baked();
    let script = write(folder.path(), "screenshot open.png\nwait 1000000");
    let out = folder.path().display().to_string();
    let options = [&bake, "--size", "64x48", "--device", "cpu", "--script", &script, "--out", &out];
    let mut child = display.command(&options).spawn().unwrap();
    let begun = Instant::now();
    while !folder.path().join("open.png").exists() {
        assert!(begun.elapsed() < Duration::from_secs(120), "the window opens");
        std::thread::sleep(Duration::from_millis(50));
    }
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    let status = child.wait().unwrap();
    assert_eq!(status.code(), Some(130));
    let output = child.wait_with_output().unwrap();
    assert!(!text(&output.stderr).contains("panicked"), "{}", text(&output.stderr));
}

/// Processor time that a process has taken, s: 100 ticks a second in every Linux that Debian has.
#[cfg(target_os = "linux")]
fn processor_seconds(process: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap();
    // After the name, which may hold anything: the state, ten numbers, user time, system time.
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    fields[11..13].iter().map(|ticks| ticks.parse::<f64>().unwrap()).sum::<f64>() / 100.0
}

#[cfg(target_os = "linux")]
#[test]
fn a_window_at_rest_does_no_work() {
    let Some(display) = Xvfb::start() else { return };
    let (folder, bake) = baked();
    let script = write(folder.path(), "wait 2\nscreenshot open.png");
    let out = folder.path().display().to_string();
    let options = [&bake, "--size", "160x120", "--device", "cpu", "--script", &script, "--out", &out];
    let mut child = display.command(&options).spawn().unwrap();
    while !folder.path().join("open.png").exists() {
        assert!(child.try_wait().unwrap().is_none(), "it has ended");
        std::thread::sleep(Duration::from_millis(50));
    }
    let to_open = processor_seconds(child.id());
    assert!(to_open > 0.0);
    std::thread::sleep(Duration::from_secs(1));
    let before = processor_seconds(child.id());
    std::thread::sleep(Duration::from_secs(10));
    let at_rest = processor_seconds(child.id()) - before;
    Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    child.wait().unwrap();
    assert!(at_rest <= 0.2, "{at_rest} s of processor time in 10 s at rest, {to_open} s to open");
}

#[test]
fn the_tour_is_a_script() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/view/tour.txt");
    let script = std::fs::read_to_string(&path).unwrap();
    viewer::script::Script::parse(&path, &script).unwrap();
    assert!(text(&run(&["--help"]).stdout).contains("sun-hour H [TO N]"));
}
