//! Operators between patches against plain bounces.

use assets::procedural;
use faer::Mat;
use patches::{Density, MeshSettings, PatchKind, PatchMesh, lit_sampler};
use runtime::cpu::Cpu;
use runtime::executor::{DeviceChoice, Executor};
use runtime::recipe::multibounce::Product;
use runtime::vulkan::{Validation, Vulkan};
use transport::Silent;

use super::build::{MATRICES, Panels, check_memory, compress_form_factors};
use super::*;
use crate::form_factors::{Estimator, FormFactors};
use crate::memory::available_bytes;
use crate::method::firstshot::ignore_progress;

/// Every codec, with the relative error of irradiance that it may have against the dense one.
pub const CODECS: [(Codec, f64); 8] = [
    (Codec::Dense, 1e-6),
    (Codec::Half, 5e-4),
    (Codec::Blocks(BlockCodec::Bc1), 0.02),
    (Codec::Blocks(BlockCodec::Bc3), 0.02),
    (Codec::Blocks(BlockCodec::Bc6h), 0.01),
    (Codec::Blocks(BlockCodec::Bc7), 0.01),
    (Codec::LowRank { epsilon: 0.01 }, 0.01),
    (Codec::LowRank { epsilon: 1e-4 }, 1e-4),
];

/// Form factors in the Cornell box, and the patches' albedo. Not a multiple of four patches.
pub fn cornell() -> (SymmetricFactors, Vec<Vec4>) {
    let scene = procedural::build("cornell").unwrap().scene;
    let settings = MeshSettings {
        kind: PatchKind::Cluster,
        count: 149,
        voxel_size: None,
        samples: patches::ViewSettings::default().samples,
        seed: 0,
    };
    let sampler = lit_sampler(&scene, settings.count, Density::default(), settings.seed).unwrap();
    let mesh = PatchMesh::new(&scene, sampler.as_ref(), &settings).unwrap();
    let estimator = Estimator::Hemisphere { rays: 1024 };
    let found = FormFactors::estimate(&scene, &mesh, estimator, 0, &ignore_progress).unwrap();
    (SymmetricFactors::new(&mesh, &found.factors).unwrap(), mesh.albedo.clone())
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

fn made(codec: Codec, channels: [&Mat<f32>; 3], between: &SymmetricFactors) -> PatchOperator {
    PatchOperator::encode(codec, Channels::Three(channels), between, 1, &Silent).unwrap()
}

fn panels<'a>(
    factors: &'a SymmetricFactors,
    albedo: &'a [Vec4],
    bounces: Option<u32>,
    build: &'a Build,
    bytes: u64,
) -> Panels<'a> {
    Panels { factors, albedo, bounces, seed: 1, build, bytes }
}

/// Relative error of irradiance, L2 by area, all channels together.
fn relative_error(ours: &[Vec4], exact: &[Vec4], area: &[f32]) -> f64 {
    let square = |h: Vec4| f64::from(h.truncate().length_squared());
    let sum = |part: &dyn Fn(usize) -> f64| (0..area.len()).map(|i| f64::from(area[i]) * part(i)).sum::<f64>();
    (sum(&|i| square(ours[i] - exact[i])) / sum(&|i| square(exact[i]))).sqrt()
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
    let operators = between.bounces(&albedo, None, &Silent).unwrap();
    let three = between.bounces(&albedo, Some(3), &Silent).unwrap();
    let light = light(n);
    // Bounce by bounce, until nothing changes.
    let mut exitance = light.clone();
    let mut exact = vec![Vec4::ZERO; n];
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
    let operators = between.bounces(&albedo, None, &Silent).unwrap();
    let light = light(n);
    let mut row = vec![Vec3::ZERO; n];
    for (codec, _) in CODECS {
        let operator = made(codec, operators.each_ref(), &between);
        let expected = product(&operator, &light);
        // Products of tiles round the light of a block, and sums, to 15 bits of the greatest; at ε = 1e-4 there are
        // many of these in a row (found: 5.0e-4 of its light, 3.6e-5 of that of all; at ε = 0.01 3.9e-5 of its light).
        let limit = match codec {
            Codec::LowRank { epsilon } if epsilon < 1e-3 => 2.0_f32.powi(-10),
            Codec::LowRank { .. } => 2.0_f32.powi(-14),
            _ => 1e-5,
        };
        let mut sums = Vec::new();
        for (i, right) in expected.iter().enumerate() {
            operator.row(i, &mut row);
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
    for (codec, _) in CODECS.into_iter().chain([(Codec::LowRank { epsilon: 0.3 }, 0.0)]) {
        let radius = plain(&made(codec, [&symmetric; 3], &between));
        // An albedo is at most 0.95.
        assert!((0.5..1.02).contains(&radius), "{codec:?}: {radius}");
    }
}

#[test]
fn form_factors_in_which_light_would_grow_are_scaled() {
    let (mut between, _) = cornell();
    between.factors.values.iter_mut().for_each(|f| *f *= 1.5);
    let wrong = made(Codec::LowRank { epsilon: 0.01 }, [&between.symmetric().unwrap(); 3], &between);
    assert!(plain(&wrong) > 1.02);
    let operator = compress_form_factors(between, 0.01, 1, &Silent).unwrap();
    let radius = plain(&operator);
    assert!((0.99..=1.0 + 2.0 * RADIUS_TOLERANCE).contains(&radius), "{radius}");
    // What does not grow stays as it is.
    let (between, _) = cornell();
    let as_it_is = PatchOperator::encode(Codec::LowRank { epsilon: 0.01 }, between.channels(), &between, 1, &Silent);
    assert_eq!(as_it_is.unwrap(), compress_form_factors(between, 0.01, 1, &Silent).unwrap());
}

#[test]
fn what_exceeds_the_limit_is_built_in_panels_with_the_same_result() {
    let (between, albedo) = cornell();
    let light = light(albedo.len());
    let folder = tempfile::tempdir().unwrap();
    let mut build = Build { memory_limit: Some(1), folder: folder.path().to_owned(), ..Build::default() };
    assert_eq!(build.panel_bytes(149, 9000), Some(0));
    assert_eq!(Build { memory_limit: None, ..build.clone() }.panel_bytes(149, 9000), None);
    let codec = Codec::LowRank { epsilon: 1e-4 };
    let mut others = Vec::new();
    for bounces in [None, Some(3)] {
        let operators = between.bounces(&albedo, bounces, &Silent).unwrap();
        let dense = |channels| PatchOperator::encode(Codec::Dense, channels, &between, 1, &Silent).unwrap();
        let exact = product(&dense(Channels::Three(operators.each_ref())), &light);
        let stored = between.stored(&albedo, bounces, &build, 1 << 20, &Silent).unwrap();
        let channels = Channels::Stored(stored.each_ref());
        let found = product(&dense(channels), &light);
        assert!(relative_error(&found, &exact, &between.area) < 1e-5, "{bounces:?}");
        let rows = between.rows(channels);
        let mut row = vec![Vec3::ZERO; albedo.len()];
        for (i, h) in exact.iter().enumerate() {
            rows(i, &mut row);
            let sum: Vec3 = row.iter().zip(&light).map(|(t, b)| *t * b.truncate()).sum();
            assert!((sum - h.truncate()).abs().max_element() < 1e-5 * h.max_element(), "{sum} {h}");
        }
        let made = panels(&between, &albedo, bounces, &build, 1 << 20).build(codec, &Silent).unwrap();
        let error = relative_error(&product(&made, &light), &exact, &between.area);
        assert!(error < 1e-4, "{bounces:?}: {error}");
        others.push(exact);
    }
    assert!(relative_error(&others[1], &others[0], &between.area) > 0.01, "three bounces are not all");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "files are left");

    let refuse = |codec, build: &Build, bytes| {
        let made = panels(&between, &albedo, None, build, bytes).build(codec, &Silent);
        made.unwrap_err().to_string()
    };
    let message = refuse(Codec::Half, &build, 1 << 20);
    assert!(message.contains("low_rank"), "{message}");
    let message = refuse(codec, &build, 1 << 16);
    assert!(message.contains("allow more memory"), "{message}");
    build.folder = folder.path().join("nowhere");
    let message = refuse(codec, &build, 1 << 20);
    assert!(message.contains("nowhere") && message.contains("another folder"), "{message}");
}

#[test]
fn what_does_not_fit_into_memory_is_refused_with_a_remedy() {
    assert!(check_memory(100, MATRICES, "feedback").is_ok());
    if available_bytes().is_none() {
        println!("the system does not say how much memory is free: skipped");
        return;
    }
    let message = check_memory(30_000_000, MATRICES, "feedback").unwrap_err().to_string();
    assert!(message.contains("fewer patches") && message.contains("feedback"), "{message}");
}

/// The product on an executor alone, by the recipe.
fn run_product(
    executor: &mut dyn Executor,
    operator: &PatchOperator,
    range: u64,
    decoder: Decoder,
    light: &[Vec4],
) -> Vec<Vec4> {
    let n = operator.patches();
    let make = |plan: &mut Plan, tables: &mut Tables| operator.add_tables(plan, tables, range, decoder);
    let product = Product::load(executor, n, n, range, &make).unwrap();
    product.run(executor, light, 1).unwrap().0
}

#[test]
fn the_passes_give_the_product_of_the_host_for_every_size_of_a_binding() {
    let (between, albedo) = cornell();
    let operators = between.bounces(&albedo, None, &Silent).unwrap();
    let n = albedo.len();
    let light = light(albedo.len());
    assert_ne!(n % 4, 0, "whole blocks hide what happens beyond them");
    for (codec, _) in CODECS {
        let channels = Channels::Three(operators.each_ref());
        let operator = PatchOperator::encode(codec, channels, &between, 1, &Silent).unwrap();
        let mut expected = vec![Vec4::ZERO; n];
        operator.apply(&light, &mut expected).unwrap();
        let run_by = |decoder: Decoder, range: u64, light: &[Vec4]| {
            let mut executor: Box<dyn Executor> = Box::new(Cpu::new());
            let irradiance = run_product(executor.as_mut(), &operator, range, decoder, light);
            (executor.plan().passes().len(), irradiance)
        };
        let run = |range: u64, light: &[Vec4]| run_by(Decoder::Kernel, range, light);
        let (whole, found) = run(u64::MAX, &light);
        let error = relative_error(&found, &expected, &between.area);
        assert!(error < 2e-6, "{codec:?}: {error}");
        // In parts: more passes, the same bits.
        let (parts, same) = run(6_000, &light);
        assert_eq!(same, found, "{codec:?}");
        assert_eq!(parts > whole, !matches!(codec, Codec::LowRank { .. }), "{codec:?}");
        // From images, one or several, whose blocks native code decodes exactly: the same bits.
        if matches!(operator, PatchOperator::Blocks(_)) {
            for (edge, passes) in [(u32::MAX, whole), (152, whole), (44, whole + 3)] {
                let by_images = run_by(Decoder::Texture { edge }, u64::MAX, &light);
                assert_eq!((by_images.0, &by_images.1), (passes, &found), "{codec:?}, images of {edge}");
            }
        }
        let mut other = light.clone();
        other[n - 1].x += 1.0;
        assert!(relative_error(&run(6_000, &other).1, &expected, &between.area) > 1e-4);
    }
}

#[test]
fn texture_units_give_the_product_of_the_host_from_one_image_and_from_several() {
    let choice = DeviceChoice::Vulkan;
    let mut executor: Box<dyn Executor> = match Vulkan::open(&choice, Validation::IfThere) {
        Ok(vulkan) if vulkan.device().has_block_images => Box::new(vulkan),
        other => {
            let required = std::env::var("REQUIRE_VULKAN").is_ok_and(|value| value == "1");
            assert!(!required || other.is_ok(), "REQUIRE_VULKAN is set and there is no device");
            println!("skipped: no device with textureCompressionBC");
            return;
        }
    };
    let (between, albedo) = cornell();
    let operators = between.bounces(&albedo, None, &Silent).unwrap();
    let n = albedo.len();
    let light = light(albedo.len());
    for codec in BlockCodec::ALL {
        let channels = Channels::Three(operators.each_ref());
        let mut operator = PatchOperator::encode(Codec::Blocks(codec), channels, &between, 1, &Silent).unwrap();
        let mut expected = vec![Vec4::ZERO; n];
        operator.apply(&light, &mut expected).unwrap();
        let mut run = |operator: &PatchOperator, edge: u32| {
            let decoder = Decoder::Texture { edge };
            let range = executor.device().max_storage_buffer_range;
            run_product(executor.as_mut(), operator, range, decoder, &light)
        };
        let found = run(&operator, 4096);
        assert_eq!(run(&operator, 44), found, "{codec:?}: in several images");
        // BC6H and BC7 are exact by their specification; of BC1 and BC3 up to 1.7/255 is rounded off at a texel, whose
        // square is an entry, and errors of a row's texels have both signs.
        let limit = if matches!(codec, BlockCodec::Bc1 | BlockCodec::Bc3) { 1e-2 } else { 5e-6 };
        let error = |found: &[Vec4]| relative_error(found, &expected, &between.area);
        println!("{codec:?}: {:.1e}", error(&found));
        assert!(error(&found) < limit, "{codec:?}: {}", error(&found));
        let PatchOperator::Blocks(matrix) = &mut operator else { panic!("the codec is one of blocks") };
        let matrix = Arc::get_mut(matrix).expect("nobody else holds it");
        matrix.words_mut().iter_mut().for_each(|word| *word = word.rotate_left(3));
        assert!(error(&run(&operator, 4096)) > limit, "{codec:?}: other blocks pass");
    }
}
