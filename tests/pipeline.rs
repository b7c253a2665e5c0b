//! The whole pipeline on scenes whose answer is known, on the CPU and, where there is a device, on Vulkan.

use assets::import::LoadedScene;
use assets::procedural;
use formfactor::{Hemisphere, Stop, balance, closure_residual, form_factors, jacobi, reciprocity_residual};
use glam::{Vec3, Vec4};
use integration_tests::setup::Setup;
use integration_tests::vulkan;
use multibounce::BlockCodec;
use patches::PatchKind;
use patches::{PatchSize, SubdivideSettings, subdivide};
use patchlight::light::with_lights;
use patchlight::low_level::operator::{Codec, Decode, decoder_name};
use patchlight::method::FeedbackSettings;
use patchlight::method::multibounce::Multibounce;
use patchlight::{Estimator, MethodSettings, PictureRenderer, Pictures, ReceiverKind};
use runtime::executor::{DeviceChoice, Executor, open};
use scene::math::luminance;
use scene::{Scene, SceneParts};
use std::ops::ControlFlow;
use std::sync::Arc;

const SIZE: (u32, u32) = (48, 36);

fn settings(patches: usize) -> Setup {
    Setup {
        patches: PatchKind::Polygon,
        patch_count: patches,
        estimator: Estimator::Hemisphere { rays: 1024 },
        bounces: None,
        most_receivers: None,
        receiver_rays: 256,
        sub_frames: 8,
        seed: 3,
        size: SIZE,
        ..Setup::default()
    }
}

fn render(loaded: &LoadedScene, executor: Box<dyn Executor>) -> Pictures {
    render_with(loaded, executor, settings(300))
}

fn render_with(loaded: &LoadedScene, executor: Box<dyn Executor>, settings: Setup) -> Pictures {
    let mut classic = settings.renderer(loaded, executor).unwrap();
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    classic.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures
}

/// Name of what decodes texture blocks.
fn decoder_of(renderer: &PictureRenderer) -> Option<&'static str> {
    renderer.light().method().as_any().downcast_ref::<Multibounce>()?.decoder().map(decoder_name)
}

fn cpu() -> Box<dyn Executor> {
    open(&DeviceChoice::Cpu).unwrap().0
}

fn mean(picture: &reference::Picture) -> f32 {
    picture.pixels.iter().map(|p| luminance(*p)).sum::<f32>() / picture.pixels.len() as f32
}

/// A closed box of uniform emission and albedo: L = Le + ρ/π · Me/(1 − ρ) = Le / (1 − ρ) in every direction.
fn check_furnace(loaded: &LoadedScene, pictures: &Pictures) -> Result<(), String> {
    check_furnace_within(0.01, loaded, pictures)
}

fn check_furnace_within(limit: f32, loaded: &LoadedScene, pictures: &Pictures) -> Result<(), String> {
    let material = loaded.scene.materials[loaded.scene.geometry.triangles[0].material as usize];
    for channel in 0..3 {
        let expected = material.radiance[channel] / (1.0 - material.albedo[channel]);
        let found = pictures.full.pixels.iter().map(|p| p[channel]).sum::<f32>() / pictures.full.pixels.len() as f32;
        if (found / expected - 1.0).abs() > limit {
            return Err(format!("channel {channel}: {found} instead of {expected}"));
        }
    }
    Ok(())
}

#[test]
fn white_furnace() {
    let loaded = procedural::build("furnace").unwrap();
    check_furnace(&loaded, &render(&loaded, cpu())).unwrap();
    if let Some(vulkan) = vulkan() {
        check_furnace(&loaded, &render(&loaded, Box::new(vulkan))).unwrap();
    }
    // A slightly darker box must be noticed.
    let mut darker = procedural::build("furnace").unwrap();
    for m in Arc::make_mut(&mut darker.scene.materials) {
        m.albedo *= 0.93;
    }
    assert!(check_furnace(&loaded, &render(&darker, cpu())).is_err());
}

#[test]
fn the_inside_of_a_sealed_box_in_the_sun_stays_dark() {
    let loaded = procedural::build("sealed-box").unwrap();
    let pictures = render(&loaded, cpu());
    let outside =
        loaded.scene.lighting.lights.iter().map(|l| luminance(l.color)).fold(0.0, f32::max) / std::f32::consts::PI;
    assert!(outside > 0.0);
    let inside = mean(&pictures.full);
    assert!(inside < 1e-4 * outside, "inside {inside}, outside {outside}");
    // With a wall taken away it is not dark.
    let mut other = procedural::build("sealed-box").unwrap();
    other.scene = with_triangles(&loaded.scene, |source| source > 1);
    let lit = mean(&render(&other, cpu()).full);
    assert!(lit > 1e-3 * outside, "a box with a hole is as dark: {lit}");
    // Without the ground no surface that sees another is lit.
    other.scene = with_triangles(&loaded.scene, |source| source < 12);
    assert_eq!(mean(&render(&other, cpu()).full), 0.0);
}

#[test]
fn a_sealed_room_on_a_floor_and_below_a_slab_that_go_on_outside_stays_dark() {
    // One floor and one slab for both sides of walls without thickness, and of thin ones.
    for wall in ["0", "0.02"] {
        let room = |doorway: &str| {
            let loaded = procedural::build(&format!("rooms:wall={wall},doorway={doorway}")).unwrap();
            let sun = luminance(loaded.scene.lighting.lights[0].color) / std::f32::consts::PI;
            (mean(&render(&loaded, cpu()).full), sun)
        };
        let (inside, outside) = room("0");
        assert!(inside < 1e-4 * outside, "walls of {wall} m: inside {inside}, outside {outside}");
        let (lit, _) = room("1.4");
        assert!(lit > 1e-3 * outside, "walls of {wall} m: a room with doorways is as dark: {lit}");
    }
}

/// The scene with those triangles of its source.
fn with_triangles(scene: &Scene, keep: impl Fn(u32) -> bool) -> Scene {
    let kept: Vec<usize> =
        (0..scene.geometry.triangles.len()).filter(|&k| keep(scene.geometry.triangles[k].source)).collect();
    Scene::new(SceneParts {
        triangles: kept.iter().map(|&k| scene.geometry.triangles[k]).collect(),
        uvs: kept.iter().map(|&k| scene.geometry.uvs[k]).collect(),
        materials: scene.materials.to_vec(),
        textures: scene.geometry.textures.clone(),
        texels: scene.geometry.texels.to_vec(),
        lights: scene.lighting.lights.clone(),
        sky: scene.lighting.sky,
        sky_map: scene.lighting.sky_map.to_vec(),
        distributions: scene.lighting.distributions.to_vec(),
        ray_offset: None,
        absorption: scene.geometry.absorption,
        ..SceneParts::default()
    })
    .unwrap()
}

/// Pixels of two pictures of the same frame may differ where a ray passes an edge, not elsewhere and not on the whole.
fn check_same(a: &Pictures, b: &Pictures) -> Result<(), String> {
    for (name, a, b) in
        [("full", &a.full, &b.full), ("direct", &a.direct, &b.direct), ("indirect", &a.indirect, &b.indirect)]
    {
        let level = 0.01 * mean(a);
        let differs = |(x, y): &(&Vec3, &Vec3)| (**x - **y).abs().max_element() > 1e-3 * x.max_element() + 1e-3 * level;
        let count = a.pixels.iter().zip(&b.pixels).filter(differs).count();
        let ratio = mean(a) / mean(b);
        if count > a.pixels.len() / 100 || (ratio - 1.0).abs() > 1e-3 {
            return Err(format!("{name}: {count} of {} pixels differ, ratio of the means {ratio}", a.pixels.len()));
        }
    }
    Ok(())
}

#[test]
fn both_executors_render_the_same_pictures() {
    let Some(vulkan) = vulkan() else { return };
    let loaded = procedural::build("atrium:3000").unwrap();
    let ours = render(&loaded, cpu());
    check_same(&ours, &render(&loaded, Box::new(vulkan))).unwrap();
    // Another seed gives another picture.
    let other = render_with(&loaded, cpu(), Setup { seed: 4, ..settings(300) });
    assert!(check_same(&ours, &other).is_err());
}

/// Relative difference of indirect light, L2.
fn indirect_error(ours: &Pictures, exact: &Pictures) -> f32 {
    let square = |pixels: &mut dyn Iterator<Item = Vec3>| pixels.map(|p| p.length_squared()).sum::<f32>();
    let a = &ours.indirect.pixels;
    let b = &exact.indirect.pixels;
    (square(&mut a.iter().zip(b).map(|(a, b)| *a - *b)) / square(&mut b.iter().copied())).sqrt()
}

#[test]
fn every_codec_renders_the_picture_of_the_dense_operator() {
    let loaded = procedural::build("cornell").unwrap();
    for (patches, receivers, worst) in
        [(PatchKind::Polygon, ReceiverKind::Mesh, 0.002), (PatchKind::Axis, ReceiverKind::Patches, 0.03)]
    {
        let render = |method: MethodSettings, bounces: Option<u32>| {
            let settings = Setup { method, patches, receivers, bounces, ..settings(150) };
            render_with(&loaded, cpu(), settings)
        };
        let exact = render(MethodSettings::Multibounce(Codec::Dense), None);
        // F is made reciprocal for operators, so the light is not quite that of classic radiosity.
        let classic = indirect_error(&render(MethodSettings::Classic, None), &exact);
        assert!(classic < 0.02, "{patches:?}: {classic}");
        let blocks = BlockCodec::ALL.map(|codec| (Codec::Blocks(codec), worst));
        for (codec, limit) in [(Codec::Half, 1e-4), (Codec::LowRank { epsilon: 0.01 }, worst)].into_iter().chain(blocks)
        {
            let found = indirect_error(&render(MethodSettings::Multibounce(codec), None), &exact);
            println!("{patches:?}, {codec:?}: {found}");
            assert!(found < limit, "{patches:?}, {codec:?}: {found}");
            let few = indirect_error(&render(MethodSettings::Multibounce(codec), Some(3)), &exact);
            assert!(few > worst, "{patches:?}, {codec:?} with three bounces: {few}");
        }
    }
}

#[test]
fn both_executors_render_the_same_pictures_with_operators() {
    let loaded = procedural::build("cornell").unwrap();
    let half = MethodSettings::Multibounce(Codec::Half);
    let blocks = MethodSettings::Multibounce(Codec::Blocks(BlockCodec::Bc1));
    for transport in [half, blocks, MethodSettings::Feedback(FeedbackSettings::default())] {
        let Some(vulkan) = vulkan() else { return };
        let by_operator = Setup { method: transport, ..settings(150) };
        let ours = render_with(&loaded, cpu(), by_operator);
        check_same(&ours, &render_with(&loaded, Box::new(vulkan), by_operator)).unwrap();
        let other = render_with(&loaded, cpu(), Setup { bounces: Some(3), ..by_operator });
        assert!(check_same(&ours, &other).is_err(), "{transport:?}");
    }
}

#[test]
fn all_bounces_by_few_products_are_the_light_of_many() {
    let difference = |a: &[Vec3], b: &[Vec3]| {
        let square = |v: Vec3| f64::from(v.length_squared());
        let wrong: f64 = a.iter().zip(b).map(|(a, b)| square(*a - *b)).sum();
        (wrong / b.iter().map(|h| square(*h)).sum::<f64>()).sqrt()
    };
    for (name, albedo, patches, receivers) in [
        ("cornell", None, PatchKind::Polygon, ReceiverKind::Mesh),
        ("furnace", None, PatchKind::Polygon, ReceiverKind::Mesh),
        // For which a bake has too few plain bounces.
        ("furnace", Some(0.97), PatchKind::Polygon, ReceiverKind::Mesh),
        ("cornell", None, PatchKind::Axis, ReceiverKind::Patches),
        ("corridor", None, PatchKind::Polygon, ReceiverKind::Mesh),
        ("rooms", None, PatchKind::Polygon, ReceiverKind::Mesh),
    ] {
        let mut loaded = procedural::build(name).unwrap();
        if let Some(albedo) = albedo {
            for material in Arc::make_mut(&mut loaded.scene.materials) {
                material.albedo = Vec3::splat(albedo);
            }
        }
        // Irradiance of patches, and products from patch to patch.
        let light = |bounces: Option<u32>| {
            let settings = Setup { patches, receivers, bounces, ..settings(150) };
            let mut renderer = settings.renderer(&loaded, cpu()).unwrap();
            let light = renderer.light_mut();
            light.update(&loaded.scene.lighting).unwrap();
            let buffer = light.buffers().patches;
            let found: Vec<Vec3> = light.download(buffer).unwrap().iter().map(|h| h.truncate()).collect();
            // A product and a bounce each.
            let products = light.executor_mut().plan().passes().iter().filter(|pass| pass.name == "method").count() / 2;
            (found, products as u32)
        };
        let (exact, _) = light(Some(1000));
        let (found, products) = light(None);
        let renderer = Setup { patches, receivers, ..settings(150) }.renderer(&loaded, cpu()).unwrap();
        let enough = renderer.light().bake().bounces();
        let (few, same) = light(Some(products + if receivers == ReceiverKind::Mesh { 2 } else { 0 }));
        assert_eq!(same, products);
        let [wrong, plain] = [&found, &few].map(|light| difference(light, &exact));
        // In the darkest place, too, no more is missing than by plain bounces to the bake's tolerance.
        let worst = |light: &[Vec3]| {
            let lit = light.iter().zip(&exact).filter(|(_, exact)| exact.length() > 0.0);
            lit.map(|(found, exact)| found.distance(*exact) / exact.length()).fold(0.0, f32::max)
        };
        let (settled, _) = light(Some(enough));
        let [new, before] = [&found, &settled].map(|light| worst(light));
        assert!(
            products < enough && new < before.max(1e-4),
            "{name}: {products} of {enough} products, {new}, {before}"
        );
        println!("{name}: in the darkest patch {new:.1e}, plain {before:.1e}");
        println!(
            "{name}, {patches:?}: {products} products leave {wrong:.1e}, plain ones {plain:.1e}; {enough} would do"
        );
        let limit = if albedo.is_some() { 2e-5 } else { 1e-5 };
        assert!(wrong < limit && plain > 5.0 * wrong, "{name}, {patches:?}: {wrong}, {plain}");
    }
}

/// Texture units round decoded values to about 8 bits in BC1 and BC3, and are exact in BC6H and BC7 (`parity.rs`).
/// Entries are squares of texels, so an error of 1.7/255 of a great texel is one of 1.3 % of its entry; those of a row
/// have both signs.
#[test]
fn texture_units_give_the_pictures_that_kernels_do() {
    let loaded = procedural::build("cornell").unwrap();
    for codec in BlockCodec::ALL {
        let render = |decode: Decode, bounces: Option<u32>| {
            let vulkan = vulkan()?;
            if !vulkan.device().has_block_images {
                println!("skipped: the device has no textureCompressionBC");
                return None;
            }
            let transport = MethodSettings::Multibounce(Codec::Blocks(codec));
            let settings = Setup { method: transport, decode, bounces, ..settings(150) };
            let mut classic = settings.renderer(&loaded, Box::new(vulkan)).unwrap();
            let taken = if decode == Decode::Texture { "texture" } else { "kernel" };
            assert_eq!(decoder_of(&classic), Some(taken));
            let camera = loaded.view.camera(SIZE.0, SIZE.1);
            let pictures = classic.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures;
            Some((pictures, classic.light_mut().surface_irradiance().unwrap()))
        };
        let Some((kernel, exact)) = render(Decode::Kernel, None) else { return };
        let Some((texture, found)) = render(Decode::Texture, None) else { return };
        let limit = if matches!(codec, BlockCodec::Bc1 | BlockCodec::Bc3) { 1e-2 } else { 1e-5 };
        let differs = |found: &[Vec3]| {
            let square = |v: Vec3| f64::from(v.length_squared());
            let wrong: f64 = found.iter().zip(&exact).map(|(a, b)| square(*a - *b)).sum();
            (wrong / exact.iter().map(|h| square(*h)).sum::<f64>()).sqrt()
        };
        println!("{codec:?}: irradiance {:.1e}, picture {:.1e}", differs(&found), indirect_error(&texture, &kernel));
        assert!(differs(&found) < limit && f64::from(indirect_error(&texture, &kernel)) < limit, "{codec:?}");
        let Some((few, fewer)) = render(Decode::Texture, Some(3)) else { return };
        assert!(differs(&fewer) > limit && f64::from(indirect_error(&few, &kernel)) > limit, "{codec:?}");
    }
}

/// A closed box with the operator in every format: what leaves a patch comes back. Making F reciprocal takes up to 2 %
/// (dense, too); blocks keep the sum of each row, so nothing more goes.
#[test]
fn the_furnace_is_closed_with_every_format_of_blocks() {
    let loaded = procedural::build("furnace").unwrap();
    let with = |codec, bounces| Setup { method: MethodSettings::Multibounce(codec), bounces, ..settings(200) };
    let dense = render_with(&loaded, cpu(), with(Codec::Dense, None));
    check_furnace_within(0.02, &loaded, &dense).unwrap();
    let off = |pictures: &Pictures| (mean(&pictures.full) / mean(&dense.full) - 1.0).abs();
    for codec in BlockCodec::ALL {
        let found = off(&render_with(&loaded, cpu(), with(Codec::Blocks(codec), None)));
        println!("{codec:?}: {found}");
        assert!(found < 1e-3, "{codec:?}: {found}");
        let few = render_with(&loaded, cpu(), with(Codec::Blocks(codec), Some(3)));
        assert!(check_furnace_within(0.02, &loaded, &few).is_err() && off(&few) > 0.015, "{codec:?}");
        if let Some(vulkan) = vulkan().filter(|vulkan| vulkan.device().has_block_images) {
            let by_texture = Setup { decode: Decode::Texture, ..with(Codec::Blocks(codec), None) };
            let found = off(&render_with(&loaded, Box::new(vulkan), by_texture));
            println!("{codec:?}, texture unit: {found}");
            // Entries are alike here, so what lavapipe rounds off has one sign: 1.7/255 of a texel, twice that of its
            // square.
            let limit = if matches!(codec, BlockCodec::Bc1 | BlockCodec::Bc3) { 0.0135 } else { 1e-3 };
            assert!(found < limit, "{codec:?}, texture unit: {found}");
        }
    }
}

#[test]
fn feedback_follows_a_light_that_changes() {
    let loaded = procedural::build("cornell").unwrap();
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let mut brighter = loaded.scene.lighting.lights.clone();
    brighter.iter_mut().for_each(|light| light.color *= 3.0);
    // The light of this and of the frames after it, once the lights are brighter in the second.
    let frames = |method: MethodSettings, count: u32| -> Vec<Pictures> {
        let settings = Setup { method, ..settings(150) };
        let mut classic = settings.renderer(&loaded, cpu()).unwrap();
        let frame = |k| {
            let lights = if k == 0 { &loaded.scene.lighting.lights } else { &brighter };
            classic.picture(&with_lights(&loaded.scene, lights), &camera, 0).unwrap().pictures
        };
        (0..count).map(frame).collect()
    };
    let exact = frames(MethodSettings::Multibounce(Codec::Dense), 2);
    let run = |products: u32, accelerated: bool| -> Vec<f32> {
        let feedback = FeedbackSettings { epsilon: 1e-4, products, accelerated };
        let found = frames(MethodSettings::Feedback(feedback), 5);
        assert!(indirect_error(&found[0], &exact[0]) < 1e-3, "settled before the first frame");
        let errors: Vec<f32> = found[1..].iter().map(|found| indirect_error(found, &exact[1])).collect();
        println!("{products} products, accelerated {accelerated}: {errors:.5?}");
        errors
    };
    let plain = run(1, false);
    let fast = run(1, true);
    let three = run(3, false);
    assert!(plain[0] > 0.02, "the first frame lacks some bounces: {}", plain[0]);
    assert!(plain.windows(2).all(|two| two[1] < two[0]), "{plain:?}");
    assert!(fast[3] < 0.25 * plain[3], "{fast:?} {plain:?}");
    // Three products a frame are three frames.
    assert!((three[0] - plain[2]).abs() < 1e-3 * plain[2], "{three:?} {plain:?}");
}

#[test]
fn clusters_carry_the_light_that_polygons_do() {
    let loaded = procedural::build("cornell").unwrap();
    let light = |loaded: &LoadedScene, patches: PatchKind| {
        let settings = Setup { patches, ..settings(600) };
        let mut classic = settings.renderer(loaded, cpu()).unwrap();
        let camera = loaded.view.camera(SIZE.0, SIZE.1);
        mean(&classic.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures.indirect)
    };
    let polygons = light(&loaded, PatchKind::Polygon);
    let off = |x: f32| (x / polygons - 1.0).abs();
    let clusters = light(&loaded, PatchKind::Cluster);
    assert!(off(clusters) < 0.03, "{clusters} {polygons}");
    let mut darker = procedural::build("cornell").unwrap();
    Arc::make_mut(&mut darker.scene.materials).iter_mut().for_each(|m| m.albedo *= 0.95);
    assert!(off(light(&darker, PatchKind::Cluster)) > 0.03);
}

#[test]
fn operator_keeps_energy_reciprocity_and_closure_in_the_atrium() {
    let scene = procedural::build("atrium:3000").unwrap().scene;
    let cut = SubdivideSettings { size: PatchSize::Count(3000), ..SubdivideSettings::default() };
    let subdivision = subdivide(&scene, &cut).unwrap();
    let area = subdivision.areas();
    let surfaces = subdivision.surfaces(&scene, &[]);
    let mut rows = form_factors(&Hemisphere { rays: 512 }, &surfaces, &|_, _| ControlFlow::Continue(())).unwrap();
    let noisy = reciprocity_residual(&rows.factors, &area);
    balance(&mut rows.factors, &mut rows.sky_factor, &area, None).unwrap();
    let reciprocity = reciprocity_residual(&rows.factors, &area);
    let closure = closure_residual(&rows.factors, &rows.sky_factor);
    let open = |i: &usize| (rows.factors.row(*i).iter().sum::<f32>() + rows.sky_factor[*i] - 1.0).abs() > 1e-5;
    let left_open = (0..area.len()).filter(open).count();
    println!("reciprocity {noisy:.1e} before, {reciprocity:.1e} after; closure {closure:.1e}, {left_open} rows open");
    // What sees only smaller patches than itself, as beneath the foot of a column, cannot be closed.
    assert!(reciprocity <= 1e-5 && left_open <= 3 && noisy > 1e-5);

    let n = area.len();
    let albedo = vec![Vec4::new(0.7, 0.5, 0.2, 0.0); n];
    let source: Vec<Vec4> = (0..n).map(|i| Vec4::splat(f32::from(i % 7 == 0))).collect();
    let light = jacobi(&rows.factors, &source, &albedo, Stop::Tolerance(1e-7)).unwrap();
    let balance_of = |absorbing: &[Vec4]| {
        let mut emitted = 0.0f64;
        let mut spent = 0.0f64;
        for i in 0..n {
            let a = f64::from(area[i]);
            emitted += a * f64::from(source[i].x);
            spent += a * f64::from((1.0 - absorbing[i].x) * light.irradiance[i].x);
            spent += a * f64::from(light.exitance[i].x * rows.sky_factor[i]);
        }
        (spent / emitted - 1.0).abs()
    };
    let error = balance_of(&albedo);
    println!("absorbed + escaped differ from emitted by {error:.1e}");
    assert!(error < 1e-3);
    assert!(balance_of(&vec![Vec4::splat(0.65); n]) > 1e-3, "a wrong albedo goes unnoticed");
}
