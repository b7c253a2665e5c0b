//! `patchlight illuminance`: numbers and pictures of calculation planes.

mod program;

use std::fs;
use std::path::{Path, PathBuf};

use program::{fails, succeeds};
use reference::PictureFile as _;
use scene::Picture;

#[test]
fn planes_are_measured_and_wrong_ones_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let arguments = |more: &[&'static str]| -> Vec<String> {
        let all =
            ["illuminance", "cornell", "--patch-count", "100", "--size", "64x48", "--grid", "0.1", "--quiet", "--out"];
        all.iter().chain(&[out.to_str().unwrap()]).chain(more).map(|s| (*s).to_owned()).collect()
    };
    let run = |more| {
        let arguments = arguments(more);
        succeeds(&arguments.iter().map(String::as_str).collect::<Vec<_>>())
    };
    let printed = run(&["--plane", "0.3", "--cylindrical", "0.3", "--json"]);
    let report: serde_json::Value = serde_json::from_str(&printed).unwrap();
    let planes = report["planes"].as_array().unwrap();
    assert_eq!(planes.len(), 2);
    for (number, plane) in planes.iter().enumerate() {
        let [mean, least, most] = ["mean", "minimum", "maximum"].map(|key| plane[key].as_f64().unwrap());
        assert!(0.0 < least && least < mean && mean < most, "{plane}");
        assert!((plane["uniformity"].as_f64().unwrap() - least / mean).abs() < 1e-4);
        let lines = fs::read_to_string(out.join(format!("plane-{number}.csv"))).unwrap().lines().count();
        assert_eq!(lines as u64, 1 + plane["points"].as_u64().unwrap());
        assert!(Picture::read(&out.join(format!("plane-{number}.png"))).unwrap().width > 300);
    }
    let numbers = Picture::read(&out.join("illuminance.exr")).unwrap();
    assert_eq!((numbers.width, numbers.height), (64, 48));
    assert!(numbers.pixels.iter().filter(|lux| lux.x > 0.0).count() > 2000);
    for (more, said) in [
        (["--plane", "high"], "--plane"),
        (["--grid", "0"], "--grid"),
        (["--area", "1,1,1,2"], "--area"),
        (["--scale", "-5"], "--scale"),
    ] {
        let message = fails(2, &[&["illuminance", "cornell"], &more[..]].concat());
        assert!(message.contains(said), "{message}");
    }
}

/// A black box of 4 m × 4 m, 3 m high, under the Lambert luminaire of the examples.
fn black_room(folder: &Path, more: &str) -> PathBuf {
    let lamp = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/luminaires/downlight.ies");
    fs::copy(lamp, folder.join("lamp.ies")).unwrap();
    fs::write(folder.join("black.mtl"), "newmtl black\nKd 0 0 0\n").unwrap();
    let corners = [[0, 0, 0], [4, 0, 0], [4, 0, 4], [0, 0, 4], [0, 3, 0], [4, 3, 0], [4, 3, 4], [0, 3, 4]];
    let mut mesh = String::from("mtllib black.mtl\nusemtl black\n");
    corners.iter().for_each(|[x, y, z]| mesh += &format!("v {x} {y} {z}\n"));
    // Fronts inside.
    for face in ["4 3 2 1", "5 6 7 8", "1 2 6 5", "3 4 8 7", "4 1 5 8", "2 3 7 6"] {
        mesh += &format!("f {face}\n");
    }
    fs::write(folder.join("black.obj"), mesh).unwrap();
    let light = "[[light]]\ntype = \"luminaire\"\nfile = \"lamp.ies\"\nposition = [2, 2.9, 2]\n";
    fs::write(folder.join("black.toml"), format!("version = 1\nmesh = \"black.obj\"\n{light}{more}")).unwrap();
    folder.join("black.toml")
}

#[test]
fn a_luminaire_gives_the_lux_of_the_hand_calculation() {
    let folder = tempfile::tempdir().unwrap();
    let lux = |more: &str| -> Vec<[f64; 3]> {
        let scene = black_room(folder.path(), more);
        let out = folder.path().join("out");
        let paths = [scene.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let options = ["--patch-count", "100", "--size", "32x24", "--grid", "0.25", "--plane", "0.75", "--quiet"];
        succeeds(&[&["illuminance"][..], &paths, &options].concat());
        let table = fs::read_to_string(out.join("plane-0.csv")).unwrap();
        let row = |line: &str| -> [f64; 3] {
            let words: Vec<f64> = line.split(',').map(|word| word.parse().unwrap()).collect();
            [words[0], words[2], words[3]]
        };
        table.lines().skip(1).map(row).collect()
    };
    // E = I₀ cos⁴θ / h², I₀ = 1000 lm / π: 68.86 lx straight below.
    let expected = |x: f64, z: f64| {
        let height = 2.9 - 0.75;
        let squared = height * height + (x - 2.0).powi(2) + (z - 2.0).powi(2);
        1000.0 / std::f64::consts::PI * height * height / (squared * squared)
    };
    let found = lux("");
    assert!(found.len() > 200, "{}", found.len());
    for [x, z, found] in &found {
        assert!((found / expected(*x, *z) - 1.0).abs() < 2e-3, "{x} {z}: {found} lx for {}", expected(*x, *z));
    }
    // Half the flux, and a colour that must not change it.
    for (k, [x, z, found]) in lux("flux = 500\ntemperature = 3000\n").into_iter().enumerate() {
        assert!((found / expected(x, z) - 0.5).abs() < 1e-3, "{k}: {found}");
    }
    // A lamp that hangs askew is another one.
    assert!(lux("direction = [0.5, -1, 0]\n").iter().any(|[x, z, found]| (found / expected(*x, *z) - 1.0).abs() > 0.2));
}
