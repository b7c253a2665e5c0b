//! The denoiser on pictures that are known without their noise.

use glam::{Vec3, vec3};
use opponents::denoise::{DenoiseSettings, Guides, denoise};
use reference::{Error, Picture};
use scene::sampling::{hash, unit};

const EDGE: u32 = 48;

/// A floor on the left, a wall on the right.
fn guides() -> Guides {
    let of = |k: u32| {
        let x = (k % EDGE) as f32 / EDGE as f32;
        let y = (k / EDGE) as f32 / EDGE as f32;
        let normal = if k % EDGE < EDGE / 2 { Vec3::Y } else { Vec3::X };
        (normal, vec3(x, y, 0.0) * 0.1)
    };
    let (normals, positions) = (0..EDGE * EDGE).map(of).unzip();
    Guides { normals, positions }
}

/// 1 on the left, 3 on the right, and as much noise.
fn picture(noise: f32) -> Picture {
    let value = |k: u32| if k % EDGE < EDGE / 2 { 1.0 } else { 3.0 };
    let pixel = |k: u32| Vec3::splat(value(k) * (1.0 + noise * (2.0 * unit(hash(k)) - 1.0)));
    Picture::from_pixels(EDGE, EDGE, (0..EDGE * EDGE).map(pixel).collect()).unwrap()
}

/// Root of the mean squared distance from the picture without noise.
fn error(found: &Picture) -> f32 {
    let truth = picture(0.0);
    let squares = found.pixels.iter().zip(&truth.pixels).map(|(a, b)| (a.x - b.x).powi(2));
    (squares.sum::<f32>() / truth.pixels.len() as f32).sqrt()
}

#[test]
fn noise_goes_and_edges_stay() {
    let noisy = picture(0.8);
    let found = denoise(&noisy, &guides(), &DenoiseSettings::default()).unwrap();
    let is_clean = |found: &Picture| error(found) < 0.25 * error(&noisy);
    assert!(is_clean(&found), "{} of {}", error(&found), error(&noisy));
    let flat = Guides { normals: vec![Vec3::Y; (EDGE * EDGE) as usize], ..guides() };
    let blurred = denoise(&noisy, &flat, &DenoiseSettings::default()).unwrap();
    assert!(!is_clean(&blurred), "an edge that is lost goes unnoticed: {}", error(&blurred));
}

#[test]
fn colours_stop_at_edges_of_light() {
    let flat = Guides { normals: vec![Vec3::Y; (EDGE * EDGE) as usize], ..guides() };
    let with =
        |colour| error(&denoise(&picture(0.05), &flat, &DenoiseSettings { colour, ..Default::default() }).unwrap());
    assert!(with(0.5) < 0.1 && with(100.0) > 0.2, "{} {}", with(0.5), with(100.0));
}

#[test]
fn what_sees_nothing_stays() {
    let mut guides = guides();
    guides.normals[..EDGE as usize].fill(Vec3::ZERO);
    let noisy = picture(0.8);
    let found = denoise(&noisy, &guides, &DenoiseSettings::default()).unwrap();
    assert_eq!(found.pixels[..EDGE as usize], noisy.pixels[..EDGE as usize]);
    assert_ne!(found.pixels[EDGE as usize..], noisy.pixels[EDGE as usize..]);
}

#[test]
fn guides_of_another_picture_are_refused() {
    let mut guides = guides();
    guides.normals.pop();
    let refused = denoise(&picture(0.0), &guides, &DenoiseSettings::default());
    assert!(matches!(refused, Err(Error::Count { expected: 2304, found: 2303, .. })));
    let wrong = DenoiseSettings { normal: f32::NAN, ..DenoiseSettings::default() };
    assert!(matches!(denoise(&picture(0.0), &self::guides(), &wrong), Err(Error::Setting { .. })));
}
