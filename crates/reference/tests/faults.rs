//! Noise, leaks, stains and blotches of pictures whose faults were counted beforehand.

use glam::Vec3;
use patchlight_reference::metrics::faults::{Fault, NOISE_STEP};
use patchlight_reference::metrics::{noise_picture, noise_share};
use patchlight_reference::{Accumulation, Judge, PathSettings, Picture};
use scene::kernel::shade::encode_srgb;
use scene::{Camera, math::luminance};

const WIDTH: u32 = 80;
const HEIGHT: u32 = 70;
const COUNT: f64 = (WIDTH * HEIGHT) as f64;

fn picture(value: impl Fn(u32, u32) -> f32) -> Picture {
    let pixels = (0..WIDTH * HEIGHT).map(|k| Vec3::splat(value(k % WIDTH, k / WIDTH))).collect();
    Picture::from_pixels(WIDTH, HEIGHT, pixels).expect("the size fits")
}

fn grey(value: f32) -> Picture {
    picture(|_, _| value)
}

fn is_near(found: f64, expected: f64) -> bool {
    (found - expected).abs() <= 1e-5 * expected.abs().max(1e-3)
}

#[test]
fn equal_pictures_have_no_fault() {
    let reference = picture(|x, y| 0.1 + 0.01 * (x % 7) as f32 + 0.02 * (y % 5) as f32);
    let faults = Judge::new(&reference).faults(&reference, None).unwrap();
    assert_eq!((faults.leak_share, faults.stain_share, faults.blotch_p95), (0.0, 0.0, Some(0.0)));
    assert_eq!(noise_share(&reference, &reference, 1.0, None).unwrap(), 0.0);
}

#[test]
fn leaks_and_stains_are_counted_pixel_by_pixel() {
    let reference = grey(1.0);
    // A column that is 11 % too bright, one 9 %; a row 26 % too dark, one 24 %.
    let ours = picture(|x, y| match (x, y) {
        (3, _) => 1.11,
        (5, _) => 1.09,
        (_, 7) => 0.74,
        (_, 9) => 0.76,
        _ => 1.0,
    });
    let judge = Judge::new(&reference);
    let faults = judge.faults(&ours, None).unwrap();
    assert!(is_near(faults.leak_share, f64::from(HEIGHT) / COUNT), "{faults:?}");
    // Two of the row belong to the columns.
    assert!(is_near(faults.stain_share, f64::from(WIDTH - 2) / COUNT), "{faults:?}");
    let map = judge.fault_map(&ours).unwrap();
    let at = |x: u32, y: u32| map[(y * WIDTH + x) as usize];
    assert_eq!([at(3, 0), at(5, 0), at(0, 7), at(0, 9)], [Some(Fault::Leak), None, Some(Fault::Stain), None]);
    // The other way round they change places.
    let turned = Judge::new(&ours).faults(&reference, None).unwrap();
    assert!(turned.leak_share > 0.0 && turned != faults);
    // What is masked does not count.
    let mask: Vec<bool> = (0..WIDTH * HEIGHT).map(|k| k % WIDTH > 40).collect();
    let right = judge.faults(&ours, Some(&mask)).unwrap();
    assert_eq!(right.leak_share, 0.0);
    assert!(is_near(right.stain_share, 1.0 / f64::from(HEIGHT)), "{right:?}");
}

#[test]
fn leaks_are_measured_by_the_mean_indirect_light() {
    let reference = grey(1.0);
    let ours = picture(|x, _| if x < 8 { 1.05 } else { 1.0 });
    let judge = Judge::new(&reference);
    assert_eq!(judge.faults(&ours, None).unwrap().leak_share, 0.0);
    // Where indirect light is 0.4 on average, 0.05 is more than a tenth of it.
    let dim = Judge { mean_light: 0.4, ..judge };
    assert!(is_near(dim.faults(&ours, None).unwrap().leak_share, 0.1));
}

#[test]
fn what_the_noise_of_the_reference_explains_does_not_count() {
    let reference = grey(1.0);
    let ours = picture(|x, _| {
        if x < 8 {
            1.2
        } else if x < 16 {
            0.7
        } else {
            1.0
        }
    });
    for (error, leaks, stains) in [(0.06, 0.1, 0.1), (0.07, 0.0, 0.1), (0.11, 0.0, 0.0)] {
        let standard_error = grey(error);
        let judge = Judge { standard_error: Some(&standard_error), ..Judge::new(&reference) };
        let faults = judge.faults(&ours, None).unwrap();
        assert!(is_near(faults.leak_share, leaks) && is_near(faults.stain_share, stains), "{error}: {faults:?}");
        let noise = judge.noise().unwrap();
        assert!(is_near(noise.median_relative_standard_error, f64::from(error)));
        // 10 % and 25 % are within three standard errors.
        assert_eq!((noise.leaks_hidden_share, noise.stains_hidden_share), (1.0, f64::from(error > 0.25 / 3.0)));
    }
    assert!(Judge::new(&reference).noise().is_none());
}

#[test]
fn a_pixel_that_a_rare_bright_path_missed_is_no_leak() {
    // One pixel of the reference is too dark, and its own standard error knows nothing of it.
    let missed = |x: u32, y: u32| (x, y) == (40, 30);
    let reference = picture(|x, y| if missed(x, y) { 0.7 } else { 1.0 });
    let spread = picture(|x, y| if missed(x, y) { 0.01 } else { 0.15 });
    let judge = Judge { standard_error: Some(&spread), ..Judge::new(&reference) };
    assert_eq!(judge.faults(&grey(1.0), None).unwrap().leak_share, 0.0);
    // Where its neighbours are as sure as it is, it counts; and an own error is never made smaller.
    let sure = grey(0.01);
    assert!(Judge { standard_error: Some(&sure), ..judge }.faults(&grey(1.0), None).unwrap().leak_share > 0.0);
    let unsure = picture(|x, y| if missed(x, y) { 0.15 } else { 0.01 });
    assert_eq!(Judge { standard_error: Some(&unsure), ..judge }.faults(&grey(1.0), None).unwrap().leak_share, 0.0);
}

#[test]
fn blotches_are_errors_that_stay_after_a_low_pass() {
    let reference = grey(2.0);
    let judge = Judge::new(&reference);
    let even = judge.faults(&grey(2.1), None).unwrap();
    for found in [even.blotch_16_p95, even.blotch_p95, even.blotch_64_p95] {
        assert!(is_near(found.unwrap(), 0.05), "{even:?}");
    }
    // A chequered error of ± 20 % is none; one in squares of 32 pixels is.
    let fine = judge.faults(&picture(|x, y| if (x + y) % 2 == 0 { 2.4 } else { 1.6 }), None).unwrap();
    assert!(fine.blotch_16_p95.unwrap() < 1e-6 && fine.leak_share == 0.5, "{fine:?}");
    let coarse = judge.faults(&picture(|x, y| if (x / 32 + y / 32) % 2 == 0 { 2.4 } else { 1.6 }), None).unwrap();
    assert!(is_near(coarse.blotch_16_p95.unwrap(), 0.2) && coarse.blotch_p95.unwrap() > 0.1, "{coarse:?}");
    assert!(coarse.blotch_64_p95.unwrap() < coarse.blotch_p95.unwrap());
    // Half of the width is 10 % too dark: every window of the left half says so.
    let half = judge.faults(&picture(|x, _| if x < 40 { 1.8 } else { 2.0 }), None).unwrap();
    assert!(is_near(half.blotch_16_p95.unwrap(), 0.1), "{half:?}");
    // A pixel's noise of 30 % explains 5 % of one of them, not of the mean of a thousand.
    let noisy = grey(0.6);
    let unsure = Judge { standard_error: Some(&noisy), ..judge };
    assert!(is_near(unsure.faults(&grey(2.1), None).unwrap().blotch_64_p95.unwrap(), 0.05));
    let very = grey(2.0);
    let unsure = Judge { standard_error: Some(&very), ..judge };
    assert_eq!(unsure.faults(&grey(2.1), None).unwrap().blotch_16_p95, Some(0.0));
}

#[test]
fn small_pictures_have_no_large_squares() {
    let small = Picture::from_pixels(20, 16, vec![Vec3::ONE; 320]).unwrap();
    let faults = Judge::new(&small).faults(&small, None).unwrap();
    assert_eq!((faults.blotch_16_p95, faults.blotch_p95, faults.blotch_64_p95), (Some(0.0), None, None));
    let text = serde_json::to_string(&faults).unwrap();
    assert!(text.contains("leak_share") && !text.contains("blotch_p95"), "{text}");
}

#[test]
fn noise_is_what_a_display_shows() {
    let scale = 0.8;
    let first = grey(0.3);
    let shown = encode_srgb(0.3 * scale);
    // Displayed values that differ by 0.9 and 1.1 steps, in one channel only.
    let stepped = |steps: f32| scene::kernel::shade::decode_srgb(shown + steps * NOISE_STEP) / scale;
    for (steps, share) in [(0.9, 0.0), (1.1, 0.25), (-1.1, 0.25), (40.0, 0.25)] {
        let mut second = first.clone();
        let brighter = stepped(steps);
        second.pixels.iter_mut().step_by(4).for_each(|p| p.y = brighter);
        assert!(is_near(noise_share(&first, &second, scale, None).unwrap(), share), "{steps}");
    }
    // Beyond white nothing differs.
    assert_eq!(noise_share(&grey(2.0), &grey(3.0), 1.0, None).unwrap(), 0.0);
    assert_eq!(noise_share(&grey(0.2), &grey(0.3), 1.0, None).unwrap(), 1.0);
}

#[test]
fn pictures_mark_what_is_counted() {
    let reference = grey(1.0);
    let ours = picture(|x, _| {
        if x == 4 {
            1.5
        } else if x == 6 {
            0.5
        } else {
            1.0
        }
    });
    let judge = Judge::new(&reference);
    let marked = judge.fault_picture(&ours, 1.0).unwrap();
    let at = |picture: &Picture, x: u32| picture.pixels[x as usize];
    let is_grey = |p: Vec3| (p - Vec3::splat(p.x)).length() == 0.0 && p.x <= 0.6;
    assert!(at(&marked, 4).x > at(&marked, 4).z && at(&marked, 6).z > at(&marked, 6).x && is_grey(at(&marked, 5)));
    let noise = noise_picture(&ours, &reference, 0.5).unwrap();
    assert!(!is_grey(at(&noise, 4)) && !is_grey(at(&noise, 6)) && is_grey(at(&noise, 5)));
    let blotches = judge.blotch_picture(&grey(1.1), 16, 0.2).unwrap();
    assert!(blotches.pixels.iter().all(|p| (*p - Vec3::new(1.0, 0.5, 0.5)).length() < 1e-4));
    assert!((judge.blotch_picture(&reference, 16, 0.2).unwrap().pixels[0] - Vec3::ONE).length() < 1e-6);
}

#[test]
fn wrong_input_is_refused() {
    let reference = grey(1.0);
    let judge = Judge::new(&reference);
    let other = Picture::from_pixels(3, 2, vec![Vec3::ONE; 6]).unwrap();
    assert!(judge.faults(&other, None).is_err() && noise_share(&reference, &other, 1.0, None).is_err());
    assert!(Judge { standard_error: Some(&other), ..judge }.faults(&reference, None).is_err());
    let mut broken = reference.clone();
    broken.pixels[5].y = f32::NAN;
    assert!(judge.faults(&broken, None).is_err() && judge.fault_picture(&broken, 1.0).is_err());
    let all_out = vec![false; reference.pixels.len()];
    assert!(judge.faults(&reference, Some(&all_out)).is_err());
    assert!(judge.faults(&reference, Some(&all_out[1..])).is_err());
}

#[test]
fn the_standard_error_of_a_pixel_is_that_of_the_mean_of_its_samples() {
    // A floor below a sky, half of it hidden by a wall: paths either escape or not.
    let sky = scene::Sky { radiance: Vec3::ONE, ..scene::Sky::default() };
    let sheet = |corner: Vec3, edge_a: Vec3, edge_b: Vec3| scene::gpu::Triangle {
        corner,
        edge_a,
        edge_b,
        ..Default::default()
    };
    let floor = sheet(Vec3::new(-9.0, 0.0, -9.0), Vec3::Z * 99.0, Vec3::X * 99.0);
    let wall = sheet(Vec3::new(-99.0, -1.0, -2.0), Vec3::X * 400.0, Vec3::Y * 400.0);
    let scene = scene::Scene::new(scene::SceneParts {
        triangles: vec![floor, wall],
        uvs: vec![scene::gpu::TriangleUv::default(); 2],
        materials: vec![scene::Material { albedo: Vec3::splat(0.5), ..Default::default() }],
        sky,
        ..Default::default()
    })
    .unwrap();
    let camera = Camera::look_at(Vec3::new(0.0, 2.0, 0.0), Vec3::ZERO, Vec3::X, 40.0, 24, 24);
    let tracer = patchlight_reference::PathTracer::new(&scene);
    let render = |seed: u32| {
        let mut sums = Accumulation::new(&camera, PathSettings { seed, ..PathSettings::default() });
        let ignore_progress = |_: u32, _: u32| std::ops::ControlFlow::Continue(());
        tracer.accumulate(&camera, &mut sums, 64, ignore_progress).unwrap();
        sums
    };
    let a = render(1);
    let b = render(2);
    let errors = a.full_standard_error().unwrap();
    // Two independent pictures differ by √2 standard errors; passes of stratified samples overestimate them a little.
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
    let light = |picture: Picture| picture.pixels.iter().map(|p| f64::from(luminance(*p))).collect::<Vec<_>>();
    let spread = mean(light(a.full()).iter().zip(light(b.full())).map(|(a, b)| 0.5 * (a - b).powi(2)).collect()).sqrt();
    let expected = mean(light(errors).iter().map(|e| e * e).collect()).sqrt();
    assert!(spread > 0.3 * expected && spread < 1.3 * expected, "{spread} {expected}");
    assert!(expected > 0.0 && Accumulation::new(&camera, PathSettings::default()).full_standard_error().is_none());
}
