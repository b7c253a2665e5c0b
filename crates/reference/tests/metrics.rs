//! Metrics on pictures whose errors are known.

use glam::Vec3;
use patchlight_reference::metrics::{
    absolute_difference_picture, compare_pictures, compare_points, difference_picture, flip_picture, indirect_scale,
    quantile,
};
use patchlight_reference::{Error, Picture, PictureErrors, stops_to_scale};
use scene::kernel::shade::encode_srgb;
use scene::sampling::{hash3, unit};

fn picture(width: u32, height: u32, f: impl Fn(u32, u32) -> Vec3) -> Picture {
    let pixels = (0..width * height).map(|k| f(k % width, k / width)).collect();
    Picture::from_pixels(width, height, pixels).expect("as many as announced")
}

/// A smooth picture with an edge and some texture.
fn test_picture() -> Picture {
    picture(70, 50, |x, y| {
        let noise = unit(hash3(x, y, 9));
        let base = 0.05 + 0.3 * x as f32 / 70.0 + if y > 25 { 0.2 } else { 0.0 };
        Vec3::new(base, base * 0.8, base * 0.5) * (0.9 + 0.2 * noise)
    })
}

fn compare(ours: &Picture, reference: &Picture) -> PictureErrors {
    compare_pictures(ours, reference, 1.0, None).expect("comparable")
}

#[test]
fn equal_pictures_have_no_error() {
    let p = test_picture();
    let e = compare(&p, &p);
    assert_eq!((e.mse, e.psnr_db, e.block_psnr_db), (0.0, f64::INFINITY, f64::INFINITY));
    assert_eq!((e.flip, e.block_median_relative_error, e.mean_ratio), (0.0, 0.0, 1.0));
    assert!((e.ssim - 1.0).abs() < 1e-12);
}

#[test]
fn a_known_factor_gives_known_linear_errors() {
    let reference = test_picture();
    for factor in [0.5f32, 0.9, 1.25] {
        let ours = picture(70, 50, |x, y| reference.pixels[(y * 70 + x) as usize] * factor);
        let e = compare(&ours, &reference);
        assert!((e.block_median_relative_error - f64::from((factor - 1.0).abs())).abs() < 1e-6);
        assert!((e.mean_ratio - f64::from(factor)).abs() < 1e-6);
    }
}

#[test]
fn constant_pictures_have_closed_forms() {
    let a = 0.2f32;
    let b = 0.3f32;
    let pa = picture(40, 24, |_, _| Vec3::splat(a));
    let pb = picture(40, 24, |_, _| Vec3::splat(b));
    for stops in [0.0, 1.0] {
        let scale = stops_to_scale(stops);
        let e = compare_pictures(&pa, &pb, scale, None).expect("comparable");
        let x = f64::from(encode_srgb(a * scale));
        let y = f64::from(encode_srgb(b * scale));
        let mse = (x - y) * (x - y);
        assert!((e.mse / mse - 1.0).abs() < 1e-5, "{} {mse}", e.mse);
        assert!((e.psnr_db + 10.0 * mse.log10()).abs() < 1e-4 && (e.psnr_db - e.block_psnr_db).abs() < 1e-3);
        // No variance: only the luminance term of SSIM is left.
        let ssim = (2.0 * x * y + 1e-4) / (x * x + y * y + 1e-4);
        assert!((e.ssim - ssim).abs() < 1e-6, "{} {ssim}", e.ssim);
        assert!((e.block_median_relative_error - 1.0 / 3.0).abs() < 1e-6);
        assert!(e.flip > 0.0 && e.flip < 1.0);
    }
}

/// SSIM by its definition, window by window, without the separable filter.
fn ssim_by_definition(x: &[f64], y: &[f64], width: usize) -> f64 {
    let height = x.len() / width;
    let mut total = 0.0;
    let mut count = 0.0;
    for row in 0..=height - 11 {
        for column in 0..=width - 11 {
            let mut window = Vec::new();
            for j in 0..11 {
                for i in 0..11 {
                    let d2 = (i as f64 - 5.0).powi(2) + (j as f64 - 5.0).powi(2);
                    let k = (row + j) * width + column + i;
                    window.push(((-d2 / 4.5).exp(), x[k], y[k]));
                }
            }
            let sum: f64 = window.iter().map(|w| w.0).sum();
            let mean = |f: &dyn Fn(f64, f64) -> f64| window.iter().map(|w| w.0 * f(w.1, w.2)).sum::<f64>() / sum;
            let mx = mean(&|x, _| x);
            let my = mean(&|_, y| y);
            let vx = mean(&|x, _| (x - mx) * (x - mx));
            let vy = mean(&|_, y| (y - my) * (y - my));
            let cov = mean(&|x, y| (x - mx) * (y - my));
            total += (2.0 * mx * my + 1e-4) * (2.0 * cov + 9e-4) / ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4));
            count += 1.0;
        }
    }
    total / count
}

#[test]
fn ssim_follows_its_definition() {
    let width = 23;
    let height = 17;
    let value = |seed: u32| move |x: u32, y: u32| Vec3::splat(0.2 + 0.6 * unit(hash3(x, y, seed)));
    let a = picture(width, height, value(1));
    let b = picture(width, height, value(2));
    let shown = |p: &Picture| p.pixels.iter().map(|v| f64::from(encode_srgb(v.x))).collect::<Vec<_>>();
    let expected = ssim_by_definition(&shown(&a), &shown(&b), width as usize);
    let found = compare(&a, &b).ssim;
    assert!((found - expected).abs() < 1e-5, "{found} {expected}");
    // Unrelated noise is hardly alike; symmetric; 1 only for equal pictures.
    assert!(found < 0.3 && (compare(&b, &a).ssim - found).abs() < 1e-9);
}

#[test]
fn worse_pictures_score_worse() {
    let reference = test_picture();
    let noisy = |amount: f32| {
        picture(70, 50, |x, y| {
            let p = reference.pixels[(y * 70 + x) as usize];
            p * (1.0 + amount * (2.0 * unit(hash3(x, y, 77)) - 1.0))
        })
    };
    let mut last = compare(&reference, &reference);
    for amount in [0.05, 0.2, 0.8] {
        let e = compare(&noisy(amount), &reference);
        assert!(e.mse > last.mse && e.psnr_db < last.psnr_db && e.ssim < last.ssim && e.flip > last.flip, "{amount}");
        assert!(e.block_median_relative_error > last.block_median_relative_error);
        assert!(e.block_psnr_db > e.psnr_db, "averaging removes noise");
        last = e;
    }
    // Columns mirrored: the same histogram, another picture.
    let mirrored = picture(70, 50, |x, y| reference.pixels[(y * 70 + 69 - x) as usize]);
    let e = compare(&mirrored, &reference);
    assert!((e.mean_ratio - 1.0).abs() < 1e-6 && e.ssim < 0.9 && e.flip > 0.05 && e.block_median_relative_error > 0.2);
}

#[test]
fn incomplete_blocks_and_dark_blocks_do_not_count() {
    let reference = test_picture();
    let mut ours = reference.clone();
    // 70 × 50: columns from 64 and rows from 48 belong to no whole block.
    for y in 0..50 {
        for x in 0..70 {
            if x >= 64 || y >= 48 {
                ours.pixels[y * 70 + x] = Vec3::splat(9.0);
            }
        }
    }
    assert_eq!(compare(&ours, &reference).block_median_relative_error, 0.0);
    assert_eq!(compare(&ours, &reference).block_psnr_db, f64::INFINITY);

    // A reference that is black but for one block: only that block counts.
    let spot = |value: f32| picture(32, 32, |x, y| Vec3::splat(if x < 8 && y < 8 { value } else { 0.0 }));
    assert!((compare(&spot(1.1), &spot(1.0)).block_median_relative_error - 0.1).abs() < 1e-6);
}

#[test]
fn masked_pixels_do_not_count() {
    let reference = test_picture();
    let mut ours = reference.clone();
    let mut mask = vec![true; ours.pixels.len()];
    for y in 10..20 {
        for x in 10..20 {
            ours.pixels[y * 70 + x] *= 3.0;
            mask[y * 70 + x] = false;
        }
    }
    let masked = compare_pictures(&ours, &reference, 1.0, Some(&mask)).expect("comparable");
    assert_eq!((masked.mse, masked.block_median_relative_error, masked.mean_ratio), (0.0, 0.0, 1.0));
    let whole = compare(&ours, &reference);
    assert!(whole.mse > 0.0 && whole.mean_ratio > 1.0 && whole.ssim < masked.ssim && whole.flip > masked.flip);
    assert!(matches!(
        compare_pictures(&ours, &reference, 1.0, Some(&mask[1..])),
        Err(Error::MaskLength { expected: 3500, found: 3499 })
    ));
    mask.fill(false);
    assert!(matches!(compare_pictures(&ours, &reference, 1.0, Some(&mask)), Err(Error::Nothing { .. })));
}

#[test]
fn pictures_that_cannot_be_compared_are_refused() {
    let p = test_picture();
    let small = picture(10, 40, |_, _| Vec3::ONE);
    assert!(matches!(compare_pictures(&p, &small, 1.0, None), Err(Error::Scene(scene::Error::SizeMismatch { .. }))));
    assert!(matches!(compare_pictures(&small, &small, 1.0, None), Err(Error::TooSmall { least: 11, .. })));
    let mut broken = p.clone();
    broken.pixels[17].y = f32::NAN;
    assert!(matches!(compare_pictures(&broken, &p, 1.0, None), Err(Error::NotFinite { pixel: 17, .. })));
    assert!(matches!(Picture::from_pixels(3, 3, vec![Vec3::ZERO; 8]), Err(scene::Error::PixelCount { found: 8, .. })));
}

#[test]
fn a_black_reference_judges_absolutely() {
    let black = Picture::new(70, 50);
    let grey = picture(70, 50, |_, _| Vec3::splat(0.25));
    let equal = compare_pictures(&black, &black, 2.0, None).expect("comparable");
    assert_eq!((equal.mse, equal.block_median_relative_error, equal.mean_ratio), (0.0, 0.0, 1.0));
    let lit = compare_pictures(&grey, &black, 2.0, None).expect("comparable");
    assert!((lit.block_median_relative_error - 0.5).abs() < 1e-6 && (lit.mean_ratio - 1.5).abs() < 1e-6);
    assert!(lit.mse > 0.1 && lit.ssim < 0.1);
}

#[test]
fn indirect_light_is_exposed_by_its_log_average() {
    let p = picture(16, 16, |x, _| Vec3::splat(if x < 8 { 0.01 } else { 0.04 }));
    assert!((indirect_scale(&p) * 0.02 / 0.18 - 1.0).abs() < 1e-4);
    assert_eq!(indirect_scale(&Picture::new(16, 16)), 1.0);
}

#[test]
fn errors_at_points() {
    let reference: Vec<Vec3> = (1..=101).map(|k| Vec3::splat(k as f32)).collect();
    // Point k is wrong by k tenths of a per cent, so the quantiles are the positions.
    let ours: Vec<Vec3> = (1..=101).map(|k| Vec3::splat(k as f32 * (1.0 + 1e-3 * k as f32))).collect();
    let e = compare_points(&ours, &reference).expect("comparable");
    assert!((e.median_relative_error - 0.051).abs() < 1e-5 && (e.p95_relative_error - 0.096).abs() < 1e-5);
    assert!((e.mean_ratio - 1.067_666).abs() < 1e-4, "{}", e.mean_ratio);

    // A dark point counts relative to 5 % of the mean.
    let reference = [Vec3::splat(1.0), Vec3::splat(1.0), Vec3::ZERO];
    let ours = [Vec3::splat(1.0), Vec3::splat(1.0), Vec3::splat(0.01)];
    let e = compare_points(&ours, &reference).expect("comparable");
    assert_eq!(e.median_relative_error, 0.0);
    assert!((e.p95_relative_error - 0.9 * 0.01 / (0.05 * 2.0 / 3.0)).abs() < 1e-5);

    assert!(matches!(compare_points(&ours[1..], &reference), Err(Error::Count { expected: 3, found: 2, .. })));
    assert!(matches!(compare_points(&[], &[]), Err(Error::Nothing { .. })));
}

#[test]
fn quantiles_interpolate() {
    assert_eq!(quantile(&mut [3.0, 1.0, 2.0], 0.5), 2.0);
    assert_eq!(quantile(&mut [4.0, 1.0, 2.0, 3.0], 0.5), 2.5);
    assert_eq!(quantile(&mut [1.0, 2.0], 0.0), 1.0);
    assert_eq!(quantile(&mut [1.0, 2.0], 1.0), 2.0);
    assert_eq!(quantile(&mut [], 0.5), 0.0);
}

#[test]
fn difference_pictures_show_sign_and_place() {
    let reference = picture(24, 16, |_, _| Vec3::splat(0.5));
    let mut ours = reference.clone();
    ours.pixels[0] *= 2.0;
    ours.pixels[1] *= 0.5;
    let d = difference_picture(&ours, &reference, 0.25).expect("same size");
    assert_eq!((d.pixels[0], d.pixels[1], d.pixels[2]), (Vec3::X, Vec3::Z, Vec3::ONE));

    let times = absolute_difference_picture(&ours, &reference, 25.0).expect("same size");
    assert_eq!(times.pixels[..3], [Vec3::splat(12.5), Vec3::splat(6.25), Vec3::ZERO]);

    let f = flip_picture(&ours, &reference, 1.0).expect("same size");
    let here = f.pixels[0].element_sum();
    let far = f.pixels[23 + 15 * 24].element_sum();
    assert!(here > 10.0 * far.max(1e-3), "{here} {far}");
}

#[test]
fn errors_have_the_names_of_the_summary() {
    let p = test_picture();
    let json = serde_json::to_value(compare(&p, &picture(70, 50, |_, _| Vec3::splat(0.3)))).expect("plain numbers");
    for name in ["mse", "psnr_db", "ssim", "flip", "block_median_relative_error", "block_psnr_db", "mean_ratio"] {
        assert!(json[name].is_f64(), "{name}");
    }
    // What is infinite is left out and comes back.
    let equal = compare(&p, &p);
    let text = serde_json::to_string(&equal).expect("plain numbers");
    assert!(!text.contains("psnr"));
    assert_eq!(serde_json::from_str::<PictureErrors>(&text).expect("our own text"), equal);
}
