//! Operators between patches against plain bounces.

use super::measure::relative_error;
use super::*;
use crate::render::classic::{ClassicSettings, Estimator, PatchKind};
use crate::render::exchange::exchange;
use crate::render::senders::{SenderSettings, lit_sampler};
use assets::procedural;

/// Every codec, with the relative error of irradiance that it may have against the dense one.
pub const CODECS: [(Codec, f64); 8] = [
    (Codec::Dense, 1e-6),
    (Codec::Half, 5e-4),
    (Codec::Blocks(BlockCodec::Bc1), 0.02),
    (Codec::Blocks(BlockCodec::Bc3), 0.02),
    (Codec::Blocks(BlockCodec::Bc6h), 0.01),
    (Codec::Blocks(BlockCodec::Bc7), 0.01),
    (Codec::Tiles { epsilon: 0.01 }, 0.01),
    (Codec::Tiles { epsilon: 1e-4 }, 1e-4),
];

/// The exchange in the Cornell box, and the patches' albedo. Not a multiple of four patches.
pub fn cornell() -> (Between, Vec<Vec4>) {
    let scene = procedural::build("cornell").unwrap().scene;
    let settings = ClassicSettings {
        patches: PatchKind::Cluster,
        patch_count: 149,
        estimator: Estimator::Hemisphere { rays: 1024 },
        ..ClassicSettings::default()
    };
    let ClassicSettings { patches: kind, patch_count: count, samples, seed, .. } = settings;
    let made = SenderSettings { kind, count, voxel_size: None, samples, seed };
    let senders = Senders::new(&scene, lit_sampler(&scene, count, seed).unwrap().as_ref(), &made).unwrap();
    let found = exchange(&scene, &senders, &settings, &|_| true).unwrap();
    (Between::new(&senders, &found.factors).unwrap(), senders.albedo.clone())
}

/// Light of another colour at every patch.
pub fn light(n: usize) -> Vec<Vec4> {
    let random = |i: usize, c| scene::sampling::unit(scene::sampling::hash3(i as u32, c, 5));
    (0..n).map(|i| Vec4::new(random(i, 0), random(i, 1), 3.0 * random(i, 2), 0.0)).collect()
}

/// Spectral radius of an operator alone.
fn plain(operator: &PatchOperator) -> f32 {
    growth(&vec![Vec4::ONE; operator.patches()], operator).unwrap()
}

fn made(codec: Codec, channels: [&Mat<f32>; 3], between: &Between) -> PatchOperator {
    PatchOperator::encode(codec, Channels::Three(channels), between, 1, &mut Progress::new(true)).unwrap()
}

fn product(operator: &PatchOperator, light: &[Vec4]) -> Vec<Vec4> {
    let mut irradiance = vec![Vec4::ZERO; light.len()];
    operator.apply(light, &mut irradiance).unwrap();
    irradiance
}

#[test]
fn every_codec_gives_the_light_of_all_bounces() {
    let (between, albedo) = cornell();
    let n = albedo.len();
    let operators = between.bounces(&albedo, None, &mut Progress::new(true)).unwrap();
    let three = between.bounces(&albedo, Some(3), &mut Progress::new(true)).unwrap();
    let light = light(n);
    // Bounce by bounce, until nothing changes.
    let (mut exitance, mut exact) = (light.clone(), vec![Vec4::ZERO; n]);
    for _ in 0..200 {
        between.factors.apply(&exitance, &mut exact).unwrap();
        exitance = (0..n).map(|i| light[i] + albedo[i] * exact[i]).collect();
    }
    let [r, g, b] = operators.each_ref();
    for (codec, limit) in CODECS {
        let limit = limit.max(1e-5);
        let error = |channels| {
            let operator = made(codec, channels, &between);
            relative_error(&product(&operator, &light), &exact, &between.area)
        };
        let found = error([r, g, b]);
        println!("{codec:?}: {found}");
        assert!(found <= limit, "{codec:?}: {found}");
        for wrong in [[b, g, r], [g, r, b], three.each_ref()] {
            assert!(error(wrong) > limit.max(0.02), "{codec:?}: {}", error(wrong));
        }
    }
}

#[test]
fn the_rows_are_those_of_the_product() {
    let (between, albedo) = cornell();
    let n = albedo.len();
    let operators = between.bounces(&albedo, None, &mut Progress::new(true)).unwrap();
    let (light, mut row) = (light(n), vec![Vec3::ZERO; n]);
    for (codec, _) in CODECS {
        let operator = made(codec, operators.each_ref(), &between);
        let (rows, expected) = (operator.rows(), product(&operator, &light));
        // Products of tiles round the light of a block, and sums, to 15 bits of the greatest; at ε = 1e-4 there are many of these in a row
        // (found: 1.5e-4 of its light, 3.6e-5 of that of all).
        let limit = match codec {
            Codec::Tiles { epsilon } if epsilon < 1e-3 => 2.0_f32.powi(-12),
            Codec::Tiles { .. } => 2.0_f32.powi(-15),
            _ => 1e-5,
        };
        let mut sums = Vec::new();
        for (i, right) in expected.iter().enumerate() {
            rows(i, &mut row);
            let sum: Vec3 = row.iter().zip(&light).map(|(t, b)| *t * b.truncate()).sum();
            let right = right.truncate();
            assert!((sum - right).abs().max_element() < limit * right.max_element(), "{codec:?}: {sum} {right}");
            let other: Vec3 = row.iter().zip(&light[1..]).map(|(t, b)| *t * b.truncate()).sum();
            assert!((other - right).abs().max_element() > 1e-3 * right.max_element(), "{codec:?}");
            sums.push(sum.extend(0.0));
        }
        let error = relative_error(&expected, &sums, &between.area);
        assert!(error < 2.0_f64.powi(-14), "{codec:?}: {error}");
    }
}

#[test]
fn no_codec_makes_light_grow() {
    let (between, _) = cornell();
    let symmetric = between.symmetric().unwrap();
    for (codec, _) in CODECS.into_iter().chain([(Codec::Tiles { epsilon: 0.3 }, 0.0)]) {
        let radius = plain(&made(codec, [&symmetric; 3], &between));
        // An albedo is at most 0.95.
        assert!((0.5..1.02).contains(&radius), "{codec:?}: {radius}");
    }
}

#[test]
fn form_factors_in_which_light_would_grow_are_scaled() {
    let mut progress = Progress::new(true);
    let (mut between, _) = cornell();
    between.factors.values.iter_mut().for_each(|f| *f *= 1.5);
    let wrong = made(Codec::Tiles { epsilon: 0.01 }, [&between.symmetric().unwrap(); 3], &between);
    assert!(plain(&wrong) > 1.02);
    let operator = feedback(between, 0.01, 1, &mut progress).unwrap();
    let radius = plain(&operator);
    assert!((0.99..=1.0 + 2.0 * RADIUS_TOLERANCE).contains(&radius), "{radius}");
    // What does not grow stays as it is.
    let (between, _) = cornell();
    let as_it_is =
        PatchOperator::encode(Codec::Tiles { epsilon: 0.01 }, between.channels(), &between, 1, &mut progress);
    assert_eq!(as_it_is.unwrap(), feedback(between, 0.01, 1, &mut progress).unwrap());
}

#[test]
fn what_exceeds_the_limit_is_built_in_panels_with_the_same_result() {
    let (between, albedo) = cornell();
    let (mut progress, light, folder) = (Progress::new(true), light(albedo.len()), tempfile::tempdir().unwrap());
    let mut build = Build { memory_limit: Some(1), folder: folder.path().to_owned(), ..Build::default() };
    assert_eq!(build.panel_bytes(149, 9000), Some(0));
    assert_eq!(Build { memory_limit: None, ..build.clone() }.panel_bytes(149, 9000), None);
    let codec = Codec::Tiles { epsilon: 1e-4 };
    let mut others = Vec::new();
    for bounces in [None, Some(3)] {
        let operators = between.bounces(&albedo, bounces, &mut progress).unwrap();
        let exact = measure::exact_product(Channels::Three(operators.each_ref()), &between.area, &light);
        let stored = between.stored(&albedo, bounces, &build, 1 << 20, &mut progress).unwrap();
        let channels = Channels::Stored(stored.each_ref());
        let found = measure::exact_product(channels, &between.area, &light);
        assert!(relative_error(&found, &exact, &between.area) < 1e-5, "{bounces:?}");
        let rows = between.rows(channels);
        let mut row = vec![Vec3::ZERO; albedo.len()];
        for (i, h) in exact.iter().enumerate() {
            rows(i, &mut row);
            let sum: Vec3 = row.iter().zip(&light).map(|(t, b)| *t * b.truncate()).sum();
            assert!((sum - h.truncate()).abs().max_element() < 1e-5 * h.max_element(), "{sum} {h}");
        }
        let made = build_in_panels(codec, &between, &albedo, (bounces, 1), &build, 1 << 20, &mut progress).unwrap();
        let error = relative_error(&product(&made, &light), &exact, &between.area);
        assert!(error < 1e-4, "{bounces:?}: {error}");
        others.push(exact);
    }
    assert!(relative_error(&others[1], &others[0], &between.area) > 0.01, "three bounces are not all");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "files are left");

    let mut refuse = |codec, build: &Build, bytes| {
        let made = build_in_panels(codec, &between, &albedo, (None, 1), build, bytes, &mut progress);
        made.unwrap_err().to_string()
    };
    let message = refuse(Codec::Half, &build, 1 << 20);
    assert!(message.contains("--method tiles"), "{message}");
    let message = refuse(codec, &build, 1 << 16);
    assert!(message.contains("--memory-limit"), "{message}");
    build.folder = folder.path().join("nowhere");
    let message = refuse(codec, &build, 1 << 20);
    assert!(message.contains("nowhere") && message.contains("another folder"), "{message}");
}

#[test]
fn what_does_not_fit_into_memory_is_refused_with_a_remedy() {
    assert!(check_memory(100, MATRICES, "feedback").is_ok());
    if available_memory().is_none() {
        println!("the system does not say how much memory is free: skipped");
        return;
    }
    let message = check_memory(30_000_000, MATRICES, "feedback").unwrap_err().to_string();
    assert!(message.contains("--patch-count") && message.contains("feedback"), "{message}");
}
