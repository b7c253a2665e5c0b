//! Luminaires from IES LM-63 and EULUMDAT files: what is read, what is refused, and the light that they give.

use std::f64::consts::PI;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use assets::export::write_scene;
use assets::import::luminaire::read;
use assets::import::{LoadedScene, Photometry, load};
use firstshot::{Emission, IlluminationMaps, LightElementSettings, PhotonAccumulator, PhotonSettings, Texels, Tracer};
use glam::{DVec3, Vec3};
use patchlight::{Bake, BakeSettings, LightSettings, PictureRenderer, PictureSettings, Silent};
use reference::{PathSettings, PathTracer};
use scene::gpu::{DirectParams, LIGHT_LUMINAIRE};
use scene::math::luminance;
use scene::{Distribution, LUMENS_PER_WATT, Light, Lighting, Scene, SurfacePoint};
use tempfile::TempDir;

/// A luminaire of the examples or the tests.
fn shared(name: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    [root.join("../examples/luminaires"), root.join("luminaires")]
        .map(|folder| folder.join(name))
        .into_iter()
        .find(|path| path.exists())
        .unwrap_or_else(|| panic!("{name} is missing"))
}

fn text(name: &str) -> String {
    std::fs::read_to_string(shared(name)).unwrap()
}

fn read_text(ending: &str, text: &str) -> Result<Photometry, String> {
    read_set(ending, text, 1)
}

fn read_set(ending: &str, text: &str, lamp_set: usize) -> Result<Photometry, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("lamp.{ending}"));
    std::fs::write(&path, text).unwrap();
    read(&path, lamp_set).map_err(|error| error.to_string())
}

/// Greatest difference between two distributions over the greatest intensity, in many directions.
fn difference(a: &Distribution, b: impl Fn(f64, f64) -> f64) -> f64 {
    let mut most = 0.0f64;
    for gamma in 0..=36 {
        for c in 0..48 {
            let gamma = 5.0 * f64::from(gamma);
            let c = 7.5 * f64::from(c);
            most = most.max((a.intensity(gamma, c) - b(gamma, c)).abs());
        }
    }
    most / a.greatest()
}

#[test]
fn the_flux_of_a_file_is_that_of_its_lamps_times_what_leaves_the_luminaire() {
    let downlight = read(&shared("downlight.ies"), 1).unwrap();
    // All leaves it; the intensities are rounded and a table of steps of 2.5°.
    assert!((downlight.flux() / 1000.0 - 1.0).abs() < 3e-4, "{}", downlight.flux());
    assert_eq!((downlight.lamp_flux, downlight.size), (Some(1000.0), [0.2, 0.0, 0.0]));
    // 80 % of 4000 lm, as its line 24 says.
    let batwing = read(&shared("batwing.ldt"), 1).unwrap();
    assert!((batwing.flux() / 3200.0 - 1.0).abs() < 1e-4, "{}", batwing.flux());
    assert_eq!((batwing.lamp_flux, batwing.size), (Some(4000.0), [1.15, 0.25, 0.0]));
    assert!(downlight.warnings.is_empty() && batwing.warnings.is_empty());
    let half = text("downlight.ies").replace("1 1000 1 37", "1 1000 0.5 37");
    assert!((read_text("ies", &half).unwrap().flux() / 500.0 - 1.0).abs() < 3e-4);
}

#[test]
fn the_two_files_of_one_luminaire_agree() {
    let ldt = read(&shared("batwing.ldt"), 1).unwrap();
    let ies = read(&shared("batwing.ies"), 1).unwrap();
    assert!(difference(&ldt.distribution, |gamma, c| ies.distribution.intensity(gamma, c)) < 1e-6);
    assert!(ldt.size.iter().zip(ies.size).all(|(a, b)| (a - b).abs() < 1e-3), "{:?} {:?}", ldt.size, ies.size);
    // Another luminaire does not, nor does this one turned.
    let other = read(&shared("downlight.ies"), 1).unwrap();
    assert!(difference(&ldt.distribution, |gamma, c| other.distribution.intensity(gamma, c)) > 0.1);
    assert!(difference(&ldt.distribution, |gamma, c| ies.distribution.intensity(gamma, c + 90.0)) > 0.1);
}

#[test]
fn editions_of_lm_63_differ_in_the_factor_behind_the_ballast() {
    let with = |first: &str, factors: &str| {
        let body = text("downlight.ies").replace("IESNA:LM-63-2002\n", first).replace("1 1 12", factors);
        read_text("ies", &body).unwrap_or_else(|e| panic!("{first}: {e}")).flux()
    };
    for (first, expected) in [
        // 1986: anything or nothing stands there.
        ("", 400.0),
        ("A downlight\n", 400.0),
        ("IESNA91\n", 400.0),
        ("IESNA:LM-63-1995\n", 800.0),
        ("IESNA:LM-63-2002\n", 800.0),
        ("IES:LM-63-2019\n", 800.0),
    ] {
        let found = with(first, "0.8 0.5 12");
        assert!((found / expected - 1.0).abs() < 1e-3, "{first}: {found}");
    }
    // The kind of file of 2019, and line ends and commas of other programs.
    assert!((with("IES:LM-63-2019\n", "1,1.00001\r12\r\n") / 1000.0 - 1.0).abs() < 1e-3);
    let absolute = text("downlight.ies").replace("1 1000 1 37", "1 -1 1 37");
    let absolute = read_text("ies", &absolute).unwrap();
    assert!(absolute.lamp_flux.is_none() && (absolute.flux() / 1000.0 - 1.0).abs() < 1e-3);
    let feet = text("downlight.ies").replace("1 2 -0.2 0 0", "1 1 -2 1 0");
    assert_eq!(read_text("ies", &feet).unwrap().size, [0.6096, 0.3048, 0.0]);
}

#[test]
fn tilt_is_taken_at_rest_or_refused() {
    let with = |tilt: &str| read_text("ies", &text("downlight.ies").replace("TILT=NONE", tilt));
    let included = with("TILT=INCLUDE\n1\n3\n-30 0 30\n0.7 0.9 0.8").unwrap();
    assert!((included.flux() / 900.0 - 1.0).abs() < 1e-3);
    assert!(included.warnings.len() == 1 && included.warnings[0].contains("tilted"), "{:?}", included.warnings);
    assert!(with("TILT=INCLUDE 1 1 0 1").is_err(), "its numbers begin on the next line");
    assert!(with("tilt = none").is_ok_and(|found| found.warnings.is_empty()));
    let refused = with("TILT=lamp.tlt").unwrap_err();
    assert!(refused.contains("line 5") && refused.contains("lamp.tlt") && refused.contains("TILT=NONE"), "{refused}");
}

/// An intensity that is mirrored as a file of each symmetry has it.
fn mirrored(mirrors: (bool, bool), gamma: f64, c: f64) -> f64 {
    let mut x = c.to_radians().cos();
    let mut y = c.to_radians().sin();
    if mirrors.0 {
        y = y.abs();
    }
    if mirrors.1 {
        x = x.abs();
    }
    100.0 + 30.0 * x + 20.0 * y + 10.0 * x * y + gamma
}

/// The symmetry that LM-63 says by the first and the last angle.
fn ies_of(first: u32, last: u32, mirrors: (bool, bool)) -> String {
    let gammas: Vec<u32> = (0..=180).step_by(15).collect();
    let planes: Vec<u32> = (first..=last).step_by(15).collect();
    let mut text = format!("IESNA:LM-63-2002\nTILT=NONE\n1 -1 1 {} {} 1 2 0 0 0 1 1 0\n", gammas.len(), planes.len());
    let join = |values: &[u32]| values.iter().map(u32::to_string).collect::<Vec<_>>().join(" ");
    text += &format!("{}\n{}\n", join(&gammas), join(&planes));
    for &c in &planes {
        for &gamma in &gammas {
            text += &format!("{} ", mirrored(mirrors, f64::from(gamma), f64::from(c)));
        }
        text += "\n";
    }
    text
}

/// The symmetry that EULUMDAT says by a number.
fn ldt_of(kind: u32, planes: &[u32], mirrors: (bool, bool)) -> String {
    let gammas: Vec<u32> = (0..=180).step_by(15).collect();
    let mut lines: Vec<String> =
        ["maker", "1", &kind.to_string(), "24", "15", "13", "15", "", "", "", "", ""].map(str::to_owned).to_vec();
    lines.extend(["0", "0", "0", "1000", "500", "0", "0", "0", "0", "50", "100", "1", "0", "1"].map(str::to_owned));
    lines.extend(["1", "", "1000", "", "", "10"].map(str::to_owned));
    lines.extend(vec!["0,5".to_owned(); 10]);
    lines.extend((0..360).step_by(15).map(|c: u32| c.to_string()));
    lines.extend(gammas.iter().map(u32::to_string));
    for &c in planes {
        for &gamma in &gammas {
            lines.push(mirrored(mirrors, f64::from(gamma), f64::from(c)).to_string().replace('.', ","));
        }
    }
    lines.join("\r\n")
}

#[test]
fn symmetric_files_stand_for_the_whole_sphere() {
    // Between the angles both are linear, so they are compared at them.
    let compare = |what: &str, found: Result<Photometry, String>, mirrors: (bool, bool)| {
        let found = found.unwrap_or_else(|e| panic!("{what}: {e}")).distribution;
        let mut most = 0.0f64;
        for c in (0..360).step_by(15).map(f64::from) {
            for gamma in (0..=180).step_by(15).map(f64::from) {
                most = most.max((found.intensity(gamma, c) - mirrored(mirrors, gamma, c)).abs());
            }
        }
        most
    };
    for (first, last, mirrors) in [
        (0, 360, (false, false)),
        (0, 345, (false, false)),
        (0, 180, (true, false)),
        (90, 270, (false, true)),
        (0, 90, (true, true)),
    ] {
        let most = compare("LM-63", read_text("ies", &ies_of(first, last, mirrors)), mirrors);
        assert!(most < 1e-9, "LM-63 from {first} to {last}: {most}");
    }
    let all: Vec<u32> = (0..360).step_by(15).collect();
    let right: Vec<u32> = (270..360).step_by(15).chain((0..=90).step_by(15)).collect();
    for (kind, planes, mirrors) in [
        (0, &all[..], (false, false)),
        (2, &all[..13], (true, false)),
        (3, &right[..], (false, true)),
        (4, &all[..7], (true, true)),
    ] {
        let most = compare("EULUMDAT", read_text("ldt", &ldt_of(kind, planes, mirrors)), mirrors);
        assert!(most < 1e-9, "Isym {kind}: {most}");
        // The wrong mirror is noticed.
        let wrong = compare("EULUMDAT", read_text("ldt", &ldt_of(kind, planes, mirrors)), (!mirrors.0, mirrors.1));
        assert!(wrong > 1.0, "Isym {kind}");
    }
    let round = read_text("ldt", &ldt_of(1, &[0], (false, false))).unwrap().distribution;
    assert!(difference(&round, |gamma, _| 130.0 + gamma) < 1e-9);
}

#[test]
fn a_set_of_lamps_is_chosen() {
    let mut lines: Vec<String> = ldt_of(1, &[0], (false, false)).split("\r\n").map(str::to_owned).collect();
    lines[25] = String::from("2");
    let second = ["-1", "LED", "2500", "3000", "80", "20"].map(str::to_owned);
    lines.splice(32..32, second);
    let text = lines.join("\n");
    let first = read_set("ldt", &text, 1).unwrap();
    let second = read_set("ldt", &text, 2).unwrap();
    assert!((second.flux() / first.flux() - 2.5).abs() < 1e-12);
    assert_eq!((first.lamp_flux, second.lamp_flux), (Some(1000.0), None));
    assert!(first.warnings[0].contains("1000 lm, 2500 lm") && first.warnings[0].contains("lamp_set"));
    let refused = read_set("ldt", &text, 3).unwrap_err();
    assert!(refused.contains("line 26") && refused.contains("2 sets"), "{refused}");
}

#[test]
fn broken_files_are_refused_with_line_and_remedy() {
    let check = |ending: &str, text: &str, parts: &[&str]| {
        let message = read_text(ending, text).err().unwrap_or_else(|| panic!("{parts:?}: was read"));
        assert!(parts.iter().all(|part| message.contains(part)), "{message}: {parts:?}");
        assert!(message.contains(&format!("lamp.{ending}, line ")), "{message}");
    };
    let ies = text("downlight.ies");
    for (from, to, parts) in [
        ("TILT=NONE", "TILTED", &["line 1", "TILT="][..]),
        ("1 1000 1 37 1 1 2", "1 1000 1 37 1 2 2", &["line 6", "type B", "type C"]),
        ("1 1000 1 37 1 1 2", "1 1000 1 37 1 3 2", &["line 6", "type A", "type C"]),
        ("1 1000 1 37 1 1 2", "1 1000 1 37 1 1 3", &["line 6", "unit of lengths", "from 1 to 2"]),
        ("1 1000 1 37 1 1 2", "1 1000 0 37 1 1 2", &["line 6", "multiplier"]),
        ("1 1000 1 37 1 1 2", "1 -2 1 37 1 1 2", &["line 6", "flux", "-1"]),
        ("1 1000 1 37 1 1 2", "1 1000 1 4294967296 1 1 2", &["line 6", "vertical angles", "7200"]),
        ("1 1000 1 37 1 1 2", "1 1000 1 36.5 1 1 2", &["line 6", "whole number"]),
        ("1 1000 1 37 1 1 2", "1 1000 1 38 1 1 2", &["line 12", "vertical angle 0", "rising"]),
        ("1 1000 1 37 1 1 2", "1 nan 1 37 1 1 2", &["line 6", "\"nan\"", "number"]),
        ("27.5 30", "27.5 oops", &["line 9", "\"oops\""]),
        ("85 87.5 90", "85 87.5 200", &["line 11", "0 to 1.8e2"]),
        ("\n0\n", "\n45\n", &["line 12", "horizontal angles go from 45"]),
        ("318.01", "-318.01", &["line 13", "intensity"]),
        ("13.88 0.00", "13.88", &["line 16", "ends where an intensity"]),
    ] {
        assert!(ies.contains(from), "{from}");
        check("ies", &ies.replacen(from, to, 1), parts);
    }
    let ldt = text("batwing.ldt");
    let line = |number: usize, with: &str| {
        let mut lines: Vec<&str> = ldt.split("\r\n").collect();
        lines[number - 1] = with;
        lines.join("\r\n")
    };
    for (number, with, parts) in [
        (3, "5", &["line 3", "Isym", "0 to 4"][..]),
        (3, "3", &["line 43", "C270 to C90", "are C270 to C90"]),
        (4, "22", &["line 4", "that 4 divides"]),
        (6, "1", &["line 6", "from 2"]),
        (24, "0", &["line 24", "conversion factor"]),
        (26, "0", &["line 26", "sets of lamps"]),
        (26, "9", &["rising"]),
        (29, "0", &["line 29", "flux of lamp set 1"]),
        (44, "0", &["line 44", "C angle 0", "rising"]),
        (68, "zero", &["line 68", "γ angle", "\"zero\""]),
        (90, "1e400", &["line 90", "intensity"]),
    ] {
        if number == 3 && with == "3" {
            // The half-planes of another symmetry: too few intensities.
            check("ldt", &line(number, with), &["ends where an intensity"]);
            continue;
        }
        check("ldt", &line(number, with), parts);
    }
    check("ldt", &ldt[..ldt.len() / 2], &["ends where"]);
    check(
        "ldt",
        &ldt.replacen("\r\n180\r\n", "\r\n181\r\n", 1).replacen("\r\n4\r\n24", "\r\n2\r\n24", 1),
        &["C180", "C181"],
    );
    assert!(read_text("txt", &ldt).unwrap_err().contains(".ldt"));
    assert!(read_set("ies", &ies, 2).unwrap_err().contains("lamp_set 2"));
}

const MESH: &str = "v -9 0 -9\nv -9 0 9\nv 9 0 9\nv 9 0 -9\nusemtl m\nf 1 2 3 4\n";
const HEAD: &str = "version = 1\nmesh = \"a.obj\"\nmetres_per_unit = 0.5\n";

/// A floor of 9 m under the lights of a scene file, among the luminaires of examples and tests.
fn scene_of(lights: &str) -> (Result<LoadedScene, String>, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    for name in ["downlight.ies", "batwing.ldt", "batwing.ies"] {
        std::fs::copy(shared(name), folder.path().join(name)).unwrap();
    }
    std::fs::write(folder.path().join("a.obj"), MESH).unwrap();
    std::fs::write(folder.path().join("s.toml"), format!("{HEAD}{lights}")).unwrap();
    (load(&folder.path().join("s.toml")).map_err(|error| error.to_string()), folder)
}

fn lit(lights: &str) -> LoadedScene {
    scene_of(lights).0.unwrap_or_else(|error| panic!("{error}"))
}

fn flux(light: &Light) -> f32 {
    4.0 * std::f32::consts::PI * LUMENS_PER_WATT * luminance(light.color)
}

#[test]
fn a_scene_file_hangs_luminaires() {
    let lights = "[[light]]\ntype = \"luminaire\"\nfile = \"batwing.ldt\"\nposition = [2, 6, 4]\n\
        [[light]]\ntype = \"luminaire\"\nfile = \"batwing.ldt\"\nposition = [2, 6, 4]\ndirection = [0, -1, -1]\nc0 = [0, 0, 2]\n\
        temperature = 2700\ndimming = 0.25\n\
        [[light]]\ntype = \"luminaire\"\nfile = \"downlight.ies\"\nposition = [0, 6, 0]\ndirection = [2, 0, 0]\ncolor = [1, 0, 0]\n\
        flux = 500\n";
    let loaded = lit(lights);
    let found = &loaded.scene.lighting.lights;
    assert!(found.iter().all(|light| light.kind == LIGHT_LUMINAIRE));
    assert_eq!(
        (found[0].position, found[0].direction, found[0].edge_a),
        (Vec3::new(1.0, 3.0, 2.0), Vec3::NEG_Y, Vec3::X)
    );
    assert_eq!(found[0].distribution, found[1].distribution);
    assert_ne!(found[0].distribution, found[2].distribution);
    let across = Vec3::new(0.0, -1.0, 1.0).normalize();
    assert!((found[1].edge_a - across).length() < 1e-6 && (found[2].edge_a - Vec3::Z).length() < 1e-6);
    for (light, expected) in found.iter().zip([3200.0, 800.0, 500.0]) {
        assert!((flux(light) / expected - 1.0).abs() < 3e-4, "{}", flux(light));
    }
    assert!(found[0].color.x == found[0].color.z && found[1].color.x > 2.0 * found[1].color.z);
    assert!(found[2].color.y == 0.0 && found[2].color.x > 0.0);
    assert_eq!(loaded.files.len(), 4, "{:?}", loaded.files);
    assert!(loaded.warnings.iter().all(|warning| !warning.contains("nothing shines")), "{:?}", loaded.warnings);

    // What a file says decides a picture: it is in the hash.
    let other = lit(&lights.replace("downlight.ies", "batwing.ies"));
    assert_ne!(other.content_hash, loaded.content_hash);
    assert_eq!(lit(lights).content_hash, loaded.content_hash);

    // Written and read again.
    let out = tempfile::tempdir().unwrap();
    let again = load(&write_scene(&loaded, out.path()).unwrap()).unwrap_or_else(|error| panic!("{error}"));
    let places: Vec<Vec3> = (0..60).map(|k| Vec3::new(0.14 * k as f32 - 4.0, 0.0, 3.0 - 0.1 * k as f32)).collect();
    for (before, after) in direct(&loaded.scene, &places).iter().zip(direct(&again.scene, &places)) {
        assert!((*before - after).abs().max_element() < 1e-5 * before.max_element(), "{before} {after}");
    }
    assert_eq!(again.scene.lighting.distributions.len(), loaded.scene.lighting.distributions.len());
}

#[test]
fn luminaires_that_make_no_sense_are_refused() {
    let refused = |more: &str, parts: &[&str]| {
        let text = format!("[[light]]\ntype = \"luminaire\"\nfile = \"batwing.ldt\"\nposition = [0, 2, 0]\n{more}");
        let message = scene_of(&text).0.err().unwrap_or_else(|| panic!("{more} was taken"));
        assert!(parts.iter().all(|part| message.contains(part)), "{message}: {parts:?}");
    };
    refused("intensity = [1, 1, 1]", &["line 4", "light 1, intensity", "does not belong", "lamp_set"]);
    refused("color = [1, 1, 1]\ntemperature = 3000", &["light 1, temperature", "color"]);
    refused("flux = 5\ndimming = 1", &["light 1, dimming", "flux"]);
    refused("dimming = -1", &["light 1, dimming", "not negative"]);
    refused("flux = nan", &["light 1, flux"]);
    refused("flux = 1e30", &["light 1, flux"]);
    refused("temperature = 20", &["light 1, temperature", "1667"]);
    refused("color = [0, 0, 0]", &["light 1, color", "black"]);
    refused("direction = [0, 0, 0]", &["light 1, direction"]);
    refused("c0 = [0, 3, 0]", &["light 1, c0", "across"]);
    refused("lamp_set = 2", &["batwing.ldt, line 26", "1 sets", "lamp_set 2"]);
    refused("[[light]]\ntype = \"luminaire\"\nposition = [0, 1, 0]", &["light 2, file", "is missing"]);
    refused("[[light]]\ntype = \"luminaire\"\nfile = \"no.ies\"\nposition = [0, 1, 0]", &["no.ies", "cannot be read"]);
    refused("[[light]]\ntype = \"luminaire\"\nfile = \"s.toml\"\nposition = [0, 1, 0]", &["s.toml", ".ies or .ldt"]);
    let animated = "[[animation]]\ntarget = \"light\"\nindex = 0\nproperty = \"direction\"\n\
        keyframes = [{ time = 0, value = [0, -1, 0] }]";
    refused(animated, &["light 0", "direction"]);
}

/// Direct irradiance of a floor, W/m².
fn direct(scene: &Scene, places: &[Vec3]) -> Vec<Vec3> {
    let params = DirectParams {
        count: places.len() as u32,
        light_count: scene.lighting.lights.len() as u32,
        ray_offset: scene.geometry.ray_offset,
        ..DirectParams::default()
    };
    scene.direct_irradiance(&params, &points(places))
}

fn points(places: &[Vec3]) -> Vec<SurfacePoint> {
    places.iter().map(|&position| SurfacePoint { position, patch: 0, normal: Vec3::Y, weight: 1.0 }).collect()
}

const BATWING: &str =
    "[[light]]\ntype = \"luminaire\"\nfile = \"batwing.ldt\"\nposition = [0.6, 4, -0.8]\ndirection = [0.2, -1, 0.1]\n";

#[test]
fn paths_and_photons_know_luminaires() {
    let loaded = lit(BATWING);
    let scene = &loaded.scene;
    let places: Vec<Vec3> = (0..40).map(|k| Vec3::new(0.2 * k as f32 - 4.0, 0.0, 2.0 - 0.1 * k as f32)).collect();
    let ours = direct(scene, &places);
    let found = PathTracer::new(scene).irradiance(&points(&places), 1, &PathSettings::default());
    for ((path, ours), place) in found.iter().zip(&ours).zip(&places) {
        assert!(
            (path.direct - *ours).abs().max_element() < 1e-4 * ours.max_element(),
            "{place}: {} {ours}",
            path.direct
        );
    }

    // Photons from the lamp: all that is on the floor, by integration.
    let cells = 300u32;
    let edge = 9.0f32;
    let step = edge / cells as f32;
    let place =
        |k: u32| Vec3::new((k % cells) as f32 + 0.5, 0.0, (k / cells) as f32 + 0.5) * step - Vec3::new(4.5, 0.0, 4.5);
    let places: Vec<Vec3> = (0..cells * cells).map(place).collect();
    let expected: f64 =
        direct(scene, &places).iter().map(|e| f64::from(luminance(*e))).sum::<f64>() * f64::from(step * step);
    let maps = IlluminationMaps::new(scene, 10.0).unwrap();
    let settings = PhotonSettings { with_direct: true, error: 0.0, most_photons: 1 << 19, ..PhotonSettings::default() };
    let traced = |emission: &Emission| {
        let mut tracer = Tracer::new(scene, emission, &maps, settings).unwrap();
        assert!(tracer.run(&|_| ControlFlow::Continue(())));
        tracer.estimate()
    };
    let landed = |emission: &Emission| -> f64 {
        let found = traced(emission);
        found.irradiance.iter().zip(maps.areas()).map(|(h, area)| f64::from(luminance(*h) * area)).sum()
    };
    let classical = landed(&Emission::classical(scene).unwrap());
    assert!((classical / expected - 1.0).abs() < 0.01, "{classical} for {expected}");
    // Photons from where it falls first have the share of that which the floor reflects.
    let ignore_progress = |_: usize, _: usize| ControlFlow::Continue(());
    let shot =
        Emission::first_shot(scene, &LightElementSettings::default(), Texels::Mean, true, &ignore_progress).unwrap();
    let reflected = traced(&shot).emitted.dot(DVec3::new(0.2126, 0.7152, 0.0722));
    let albedo = f64::from(luminance(scene.materials[0].albedo));
    assert!((reflected / (albedo * expected) - 1.0).abs() < 0.01, "{reflected} for {albedo} of {expected}");
    // Were it a bulb of that power, a third of that would come down.
    let mut bulb = scene.clone();
    bulb.lighting.lights[0].kind = scene::gpu::LIGHT_POINT;
    let wrong = direct(&bulb, &places).iter().map(|e| f64::from(luminance(*e))).sum::<f64>() * f64::from(step * step);
    assert!((wrong / expected - 1.0).abs() > 0.1, "{wrong} for {expected}");
}

#[test]
fn a_renderer_follows_luminaires_that_change() {
    // Two of each kind, in a closed room.
    let loaded = load(&shared("room.toml")).unwrap_or_else(|error| panic!("{error}"));
    let bake = Arc::new(Bake::build(&loaded.scene, &BakeSettings::default().with_patch_count(60), &Silent).unwrap());
    let camera = loaded.view.camera(16, 16);
    let fresh = || {
        PictureRenderer::of_bake(
            Arc::clone(&bake),
            Box::new(runtime::cpu::Cpu::new()),
            &LightSettings::default(),
            &PictureSettings::default(),
            &Silent,
        )
        .unwrap()
    };
    let light = |renderer: &mut PictureRenderer, lighting: &Lighting| {
        renderer.update_light(lighting, &camera).unwrap();
        renderer.light_mut().surface_irradiance().unwrap().iter().map(|h| h.to_array()).collect::<Vec<_>>()
    };
    let first = loaded.scene.lighting.clone();
    let mut turned = first.clone();
    turned.lights[0].edge_a = turned.lights[0].edge_a.cross(turned.lights[0].direction);
    let mut other = first.clone();
    // Tables of the same length, and of another.
    other.distributions =
        first.distributions.iter().enumerate().map(|(k, v)| if k > 465 { v * 0.5 } else { *v }).collect();
    let mut longer = first.clone();
    longer.distributions = first.distributions.iter().copied().chain([1.0; 7]).collect();
    let mut dark = first.clone();
    dark.lights[0].color = Vec3::ZERO;
    let mut renderer = fresh();
    let mut before = Vec::new();
    for (k, lighting) in [&first, &turned, &other, &dark, &longer].into_iter().enumerate() {
        let found = light(&mut renderer, lighting);
        assert_eq!(found, light(&mut fresh(), lighting), "change {k}");
        assert_ne!(found, before, "change {k} changes light");
        before = found;
    }
    let mut nowhere = first.clone();
    nowhere.lights[2].distribution += 1;
    let message = renderer.update_light(&nowhere, &camera).map(|_| ()).unwrap_err().to_string();
    assert!(message.contains("light 2"), "{message}");
}

/// Folder of Radiance's programs that come with the Python package pyradiance.
fn radiance() -> Option<PathBuf> {
    let script = "import os, pyradiance; print(os.path.dirname(pyradiance.__file__))";
    let python = std::env::var("PYRADIANCE_PYTHON").unwrap_or_else(|_| String::from("python3"));
    let output = Command::new(python).args(["-c", script]).output().ok().filter(|output| output.status.success())?;
    let folder = PathBuf::from(String::from_utf8(output.stdout).ok()?.trim());
    folder.join("bin/ies2rad").exists().then_some(folder)
}

#[test]
fn radiance_finds_the_same_irradiance() {
    let Some(package) = radiance() else {
        println!("skipped: pyradiance is not installed (pip install pyradiance; PYRADIANCE_PYTHON names its Python)");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let run = |program: &str, arguments: &[&str], input: Option<&Path>| {
        let mut command = Command::new(package.join("bin").join(program));
        command
            .args(arguments)
            .current_dir(folder.path())
            .env("RAYPATH", format!(".:{}", package.join("lib").display()));
        if let Some(input) = input {
            command.stdin(std::fs::File::open(input).unwrap());
        }
        let output = command.output().unwrap();
        assert!(output.status.success(), "{program}: {}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    };
    let path = shared("batwing.ies");
    run("ies2rad", &["-t", "white", "-o", "lamp", path.to_str().unwrap()], None);
    std::fs::write(folder.path().join("lamp.oct"), run("oconv", &["lamp.rad"], None)).unwrap();
    // There z is up, the lamp at the origin; far enough for its size not to matter.
    let places = [[0.0, 0.0], [10.0, 0.0], [0.0, 10.0], [-8.0, 6.0], [9.0, -15.0], [-30.0, -4.0]];
    let rays: String = places.iter().map(|[x, y]| format!("{x} {y} -20 0 0 1\n")).collect();
    std::fs::write(folder.path().join("rays"), rays).unwrap();
    let rays = folder.path().join("rays");
    let found = run("rtrace", &["-h", "-I", "-ab", "0", "-ds", "0", "-dj", "0", "lamp.oct"], Some(&rays));
    let found: Vec<f64> = String::from_utf8(found)
        .unwrap()
        .lines()
        .map(|line| line.split_whitespace().nth(1).unwrap().parse().unwrap())
        .collect();
    let distribution = read(&path, 1).unwrap().distribution;
    let mut table = Vec::new();
    let begin = distribution.append_to(&mut table).unwrap();
    let light = Light {
        kind: LIGHT_LUMINAIRE,
        direction: Vec3::NEG_Y,
        edge_a: Vec3::X,
        distribution: begin,
        color: Vec3::splat((distribution.mean() / f64::from(LUMENS_PER_WATT)) as f32),
        ..Light::default()
    };
    let ours = |light: &Light, x: f32, y: f32| {
        let place = Vec3::new(x, -20.0, -y);
        f64::from((light.color * scene::kernel::light::unoccluded(light, &table, place, Vec3::Y).share).x)
    };
    for ([x, y], found) in places.iter().zip(&found) {
        let error = ours(&light, *x, *y) / found - 1.0;
        assert!(error.abs() < 3e-3, "{x} {y}: {error}");
    }
    let turned = Light { edge_a: Vec3::Z, ..light };
    assert!((ours(&turned, 10.0, 0.0) / found[1] - 1.0).abs() > 0.1);
    assert!((4.0 * PI * distribution.mean() / 3200.0 - 1.0).abs() < 1e-4);
}
