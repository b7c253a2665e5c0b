//! Tone curves and automatic exposure.

use glam::Vec3;
use patchlight_scene::host::automatic_stops;
use patchlight_scene::kernel::tone::{agx, neutral, toned};
use patchlight_scene::{DisplayTransform, Picture, Tone};

#[test]
fn without_a_curve_what_is_too_bright_is_cut_off() {
    let transform = DisplayTransform { stops: 1.0, tone: Tone::None };
    assert_eq!(transform.color(Vec3::new(0.25, 0.5, 7.0)), Vec3::new(0.5, 1.0, 1.0));
    assert_eq!(transform.color(Vec3::new(-1.0, 0.0, 0.1)), Vec3::new(0.0, 0.0, 0.2));
}

#[test]
fn neutral_is_that_of_its_definition() {
    // Below the start of the compression only the offset goes: 0.04, or 6.25 times the square of what is dark.
    assert!(neutral(Vec3::new(0.5, 0.3, 0.2)).distance(Vec3::new(0.46, 0.26, 0.16)) < 1e-6);
    assert!(neutral(Vec3::splat(0.04)).distance(Vec3::splat(0.01)) < 1e-6);
    // Grey of 2.04 has the peak 2: 1 − 0.24² / (2 + 0.24 − 0.76).
    assert!(neutral(Vec3::splat(2.04)).distance(Vec3::splat(1.0 - 0.0576 / 1.48)) < 1e-5);
    // A bright colour turns white, and keeps the order of its channels.
    let bright = neutral(Vec3::new(40.0, 4.0, 1.0));
    assert!(bright.x > bright.y && bright.y > bright.z && bright.z > 0.7, "{bright}");
}

#[test]
fn curves_stay_in_range_and_grow_with_the_light() {
    for tone in Tone::ALL {
        let mut last = -1.0;
        for k in 0..200 {
            let x = 1e-4 * 1.08f32.powi(k);
            let shown = toned(Vec3::splat(x), tone.code());
            assert!(shown.min_element() >= 0.0 && shown.max_element() <= 1.0, "{tone:?} {x}: {shown}");
            assert!(shown.max_element() - shown.min_element() < 4e-3, "grey stays grey: {tone:?} {x}: {shown}");
            assert!(shown.y >= last - 1e-6, "{tone:?} {x}: {} after {last}", shown.y);
            last = shown.y;
        }
        assert!(last > 0.99, "{tone:?}: white is white");
        assert!(toned(Vec3::ZERO, tone.code()).max_element() < 1e-3, "{tone:?}: black is black");
    }
    // Film has room above white: eight times as bright is still brighter.
    assert!(agx(Vec3::splat(8.0)).y > agx(Vec3::splat(1.0)).y + 0.1);
}

#[test]
fn automatic_exposure_makes_the_mean_middle_grey() {
    let grey = Picture { pixels: vec![Vec3::splat(0.045); 3000], ..Picture::new(100, 30) };
    assert!((grey.automatic_stops() - 2.0).abs() < 1e-4);
    // A few pixels as bright as the sun change little; black ones that are not there, nothing.
    let mut lamp = grey.clone();
    lamp.pixels[1500] = Vec3::splat(200.0);
    assert!((lamp.automatic_stops() - 2.0).abs() < 0.6, "{}", lamp.automatic_stops());
    let mut dark = grey.clone();
    dark.pixels[256..512].fill(Vec3::ZERO);
    assert!((dark.automatic_stops() - 2.0).abs() < 1e-4);
    assert_eq!(Picture::new(8, 8).automatic_stops(), 0.0);
    assert_eq!(automatic_stops(&[]), 0.0);
    assert_eq!(automatic_stops(&[f32::NAN, 1.0]), 0.0);
}
