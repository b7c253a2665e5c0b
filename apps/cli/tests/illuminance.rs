//! `patchlight illuminance`: numbers and pictures of calculation planes.

mod program;

use std::fs;

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
