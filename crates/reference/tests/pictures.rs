//! Pictures and reference folders on disk.

use patchlight_reference::PictureFile as _;
use std::fs;
use std::path::Path;

use glam::Vec3;
use patchlight_reference::data::read_points;
use patchlight_reference::{Error, Picture, Precision, ReferenceData};

fn gradient(scale: f32) -> Picture {
    let pixels = (0..20 * 12).map(|k| Vec3::new(k as f32, 0.5 * k as f32, 1.0 / (k + 1) as f32) * scale).collect();
    Picture::from_pixels(20, 12, pixels).expect("240 pixels")
}

#[test]
fn exr_keeps_linear_values() {
    let folder = tempfile::tempdir().expect("a folder");
    let single = folder.path().join("single.exr");
    let half = folder.path().join("half.exr");
    let p = gradient(3.7);
    p.write_exr(&single, Precision::Single).expect("written");
    assert_eq!(Picture::read(&single).expect("read"), p);
    p.write_exr(&half, Precision::Half).expect("written");
    let again = Picture::read(&half).expect("read");
    for (a, b) in again.pixels.iter().zip(&p.pixels) {
        // 11 bits of mantissa.
        assert!((a - b).abs().cmple(b.abs() * 5e-4).all(), "{a} {b}");
    }
    assert_ne!(again, p);
    assert!(fs::metadata(&half).expect("there").len() < fs::metadata(&single).expect("there").len());
    let bright = gradient(1e6);
    bright.write_exr(&half, Precision::Half).expect("written");
    assert!(Picture::read(&half).expect("read").pixels.iter().all(|p| p.is_finite()), "clamped, not infinite");
}

#[test]
fn exr_files_of_equal_pictures_are_equal_for_any_number_of_threads() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("picture.exr");
    // 12 x 9 tiles of 64 x 64 pixels, those at the edges cut.
    let width = 750;
    let height = 550;
    let value = |k: u32| Vec3::new(k as f32, (k % 97) as f32, 1.0 / (k + 1) as f32);
    let pixels = (0..width * height).map(value).collect();
    let mut p = Picture::from_pixels(width, height, pixels).expect("one for each pixel");
    let written = |p: &Picture, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        pool.install(|| p.write_exr(&path, Precision::Single)).expect("written");
        fs::read(&path).expect("read")
    };
    let bytes = written(&p, 1);
    assert_eq!(Picture::read(&path).expect("read"), p);
    for threads in [1, 2, 3, 8, 8, 8] {
        assert!(written(&p, threads) == bytes, "{threads} threads");
    }
    p.pixels[100_000].y += 1.0;
    assert!(written(&p, 2) != bytes, "another picture is noticed");
}

#[test]
fn png_shows_exposed_srgb() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("picture.png");
    let values = [0.0f32, 0.001, 0.0451, 0.1, 0.25, 0.5];
    let pixels = values.iter().map(|v| Vec3::new(*v, 0.25, 100.0)).collect();
    let p = Picture::from_pixels(6, 1, pixels).expect("6 pixels");
    p.write_png(&path, 1.0).expect("written");
    let again = Picture::read(&path).expect("read");
    for (a, v) in again.pixels.iter().zip(values) {
        // One code value of 255 near white is 0.9 % in linear light.
        assert!((a.x - 2.0 * v).abs() < 5e-3 && (a.y - 0.5).abs() < 5e-3 && a.z == 1.0, "{a} {v}");
    }
    // IEC 61966-2-1: linear 0.5 is code value 188.
    assert_eq!(p.displayed_bytes(2.0)[1], 188);
    assert_eq!(again.displayed_bytes(1.0), p.displayed_bytes(2.0), "8 bits come back as they were");
}

#[test]
fn unreadable_pictures_name_the_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let none = folder.path().join("none.exr");
    assert!(matches!(Picture::read(&none), Err(Error::Read { path, .. }) if path == none));
    let garbage = folder.path().join("garbage.exr");
    fs::write(&garbage, b"v/1\x01 but nothing else").expect("written");
    let error = Picture::read(&garbage).expect_err("not a picture");
    assert!(
        matches!(&error, Error::Decode { path, .. } if *path == garbage) && error.to_string().contains("garbage.exr")
    );
    let whole = folder.path().join("whole.exr");
    gradient(1.0).write_exr(&whole, Precision::Half).expect("written");
    let bytes = fs::read(&whole).expect("read");
    fs::write(&garbage, &bytes[..bytes.len() / 2]).expect("written");
    assert!(Picture::read(&garbage).is_err());
}

#[test]
fn failed_writes_leave_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let target = folder.path().join("folder.exr");
    fs::create_dir(&target).expect("made");
    let error = gradient(1.0).write_exr(&target, Precision::Half).expect_err("a folder is in the way");
    assert!(matches!(&error, Error::Write { path, .. } if *path == target));
    assert_eq!(fs::read_dir(folder.path()).expect("listed").count(), 1, "no temporary file stays");
    let missing = folder.path().join("missing").join("a.png");
    assert!(matches!(gradient(1.0).write_png(&missing, 0.0), Err(Error::Write { .. })));
}

const HEADER: &str = "px,py,pz,nx,ny,nz,direct_r,direct_g,direct_b,indirect_r,indirect_g,indirect_b,\
se_indirect_r,se_indirect_g,se_indirect_b,se_direct_r,se_direct_g,se_direct_b\n";

#[test]
fn reference_folders() {
    let folder = tempfile::tempdir().expect("a folder");
    assert!(matches!(ReferenceData::load(folder.path()), Err(Error::Read { .. })));
    gradient(3.0).write_exr(&folder.path().join("full.exr"), Precision::Single).expect("written");
    let alone = ReferenceData::load(folder.path()).expect("full.exr is enough");
    assert!(alone.direct.is_none() && alone.indirect.is_none() && alone.points.is_empty());
    gradient(1.0).write_exr(&folder.path().join("direct.exr"), Precision::Single).expect("written");
    let line = (1..=18).map(|k| k.to_string()).collect::<Vec<_>>().join(",");
    fs::write(folder.path().join("points.csv"), format!("{HEADER}{line}\n\n")).expect("written");
    let data = ReferenceData::load(folder.path()).expect("sound");
    assert_eq!(data.indirect.as_ref().expect("full − direct").pixels[7].x, 14.0);
    let point = data.points[0];
    assert_eq!((point.position, point.normal), (Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.0)));
    assert_eq!((point.direct, point.indirect), (Vec3::new(7.0, 8.0, 9.0), Vec3::new(10.0, 11.0, 12.0)));
    assert_eq!((point.indirect_error.x, point.direct_error.z), (13.0, 18.0));
    assert_eq!(data.surface_points(0.5)[0].position, Vec3::new(0.5, 1.0, 1.5));

    Picture::new(4, 4).write_exr(&folder.path().join("indirect.exr"), Precision::Half).expect("written");
    assert!(matches!(ReferenceData::load(folder.path()), Err(Error::Scene(scene::Error::SizeMismatch { .. }))));
}

#[test]
fn damaged_points_name_the_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("points.csv");
    let line = vec!["1"; 18].join(",");
    for (text, expected) in [
        (String::new(), 1),
        (HEADER.replace("nz", "nw"), 1),
        (format!("{HEADER}{line}\n{}\n", line.replacen('1', "x", 1)), 3),
        (format!("{HEADER}{}\n", line.replacen('1', "inf", 1)), 2),
        (format!("{HEADER}{line},1\n"), 2),
    ] {
        fs::write(&path, text).expect("written");
        assert!(matches!(read_points(&path), Err(Error::Points { line, .. }) if line == expected));
    }
}

#[test]
fn the_shared_reference_is_understood() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/reference/cornell"));
    if !folder.exists() {
        println!("skipped: no shared reference data beside the checkout");
        return;
    }
    let data = ReferenceData::load(folder).expect("sound");
    assert_eq!((data.full.width, data.full.height, data.points.len()), (540, 540, 400));
    // stats.json beside it: mean_full, mean_direct, mean_indirect.
    let direct = data.direct.expect("there");
    let indirect = data.indirect.expect("there");
    for (found, expected) in [
        (data.full.mean(), Vec3::new(0.225_046, 0.146_742, 0.042_065_6)),
        (direct.mean(), Vec3::new(0.169_507, 0.115_927, 0.036_227_3)),
        (indirect.mean(), Vec3::new(0.055_539, 0.030_815_1, 0.005_838_32)),
    ] {
        assert!((found / expected - 1.0).abs().max_element() < 1e-3, "{found} {expected}");
    }
}
