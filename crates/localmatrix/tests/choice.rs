//! Which patches come and go.

use glam::Vec3;
use patchlight_localmatrix::{Choice, choose, distance_to_path};

#[test]
fn the_nearest_are_chosen_and_the_farthest_leave() {
    let distance = [5.0, 1.0, 4.0, 2.0, 3.0, f32::NAN, f32::INFINITY];
    let choice = choose(&distance, |_| false, 3, 0.1, 10);
    assert_eq!(choice, Choice { enter: vec![1, 3, 4], leave: vec![] });
    // 0 and 2 are in: 0 is the farthest.
    let choice = choose(&distance, |i| i == 0 || i == 2, 3, 0.1, 10);
    assert_eq!(choice, Choice { enter: vec![1, 3, 4], leave: vec![0, 2] });
    let choice = choose(&distance, |i| i == 0 || i == 2, 3, 0.1, 1);
    assert_eq!(choice, Choice { enter: vec![1], leave: vec![] });
    let choice = choose(&distance, |i| i == 0 || i == 2, 3, 0.1, 2);
    assert_eq!(choice, Choice { enter: vec![1, 3], leave: vec![0] });
    assert_eq!(choose(&[], |_| false, 3, 0.1, 2), Choice::default());
    // What has no distance any more leaves first.
    assert_eq!(choose(&distance, |i| i >= 4, 3, 0.0, 1).leave, vec![5]);
}

#[test]
fn a_camera_that_trembles_moves_nothing() {
    let at = |eye: f32| -> Vec<f32> { (0..20).map(|i| (i as f32 - eye).abs()).collect() };
    let first = choose(&at(5.0), |_| false, 7, 0.2, 20).enter;
    let is_in = |i: u32| first.contains(&i);
    for eye in [4.6, 5.0, 5.4] {
        assert_eq!(choose(&at(eye), is_in, 7, 0.2, 20), Choice::default(), "{eye}");
    }
    assert_ne!(choose(&at(5.6), is_in, 7, 0.0, 20), Choice::default(), "without hysteresis it would");
    assert_ne!(choose(&at(8.0), is_in, 7, 0.2, 20), Choice::default());
}

#[test]
fn what_the_camera_comes_to_is_near() {
    let eye = Vec3::ZERO;
    let predicted = Vec3::X * 10.0;
    assert_eq!(distance_to_path(Vec3::new(4.0, 3.0, 0.0), eye, predicted), 3.0);
    assert_eq!(distance_to_path(Vec3::new(13.0, 4.0, 0.0), eye, predicted), 5.0);
    assert_eq!(distance_to_path(Vec3::new(-3.0, 4.0, 0.0), eye, predicted), 5.0);
    assert_eq!(distance_to_path(Vec3::new(3.0, 4.0, 0.0), eye, eye), 5.0);
}
