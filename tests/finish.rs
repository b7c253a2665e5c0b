//! Pictures of surfaces with a finish: beside path tracing with the same lobes, on both executors, in view and in bands.

use assets::import::LoadedScene;
use assets::procedural;
use integration_tests::limited::Limited;
use integration_tests::setup::Setup;
use integration_tests::{block_difference, vulkan};
use patchlight::{PictureRenderer, Pictures, PixelLight, ReceiverKind, ReceiverUpdate};
use reference::{Accumulation, PathSettings, PathTracer, Strategy};
use runtime::executor::{DeviceChoice, Executor, open};
use scene::Materials;

const SIZE: (u32, u32) = (96, 54);
/// Edge of the blocks that are compared, pixels.
const BLOCK: u32 = 6;

fn cpu() -> Box<dyn Executor> {
    open(&DeviceChoice::Cpu).unwrap().0
}

fn setup(materials: Materials) -> Setup {
    Setup {
        patch_count: 600,
        most_receivers: Some(5000),
        receiver_rays: 512,
        sub_frames: 8,
        size: SIZE,
        materials,
        ..Setup::default()
    }
}

fn pictures(setup: &Setup, loaded: &LoadedScene, executor: Box<dyn Executor>) -> Pictures {
    picture_of(&mut setup.renderer(loaded, executor).unwrap(), loaded)
}

fn picture_of(renderer: &mut PictureRenderer, loaded: &LoadedScene) -> Pictures {
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    renderer.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures
}

fn traced(loaded: &LoadedScene, materials: Materials) -> Accumulation {
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let settings = PathSettings { materials, strategy: Strategy::Both, ..PathSettings::default() };
    let mut sums = Accumulation::new(&camera, settings);
    let tracer = PathTracer::new(&loaded.scene);
    tracer.accumulate(&camera, &mut sums, 256, |_, _| std::ops::ControlFlow::Continue(())).unwrap();
    sums
}

#[test]
fn lobes_and_normals_agree_with_paths_that_have_them() {
    let loaded = procedural::build("gloss").unwrap();
    let expected = traced(&loaded, Materials::Gltf);
    let diffuse = traced(&loaded, Materials::Diffuse);
    let found = pictures(&setup(Materials::Gltf), &loaded, cpu());
    let without = pictures(&setup(Materials::Diffuse), &loaded, cpu());
    for (name, found, without, expected, diffuse) in [
        ("direct", &found.direct, &without.direct, expected.direct(), diffuse.direct()),
        ("indirect", &found.indirect, &without.indirect, expected.indirect(), diffuse.indirect()),
    ] {
        // What the finish changes is far more than what is wrong, and more than what was wrong without.
        let (wrong, change) = (block_difference(BLOCK, found, &expected), block_difference(BLOCK, &diffuse, &expected));
        let wrong_without = block_difference(BLOCK, without, &diffuse);
        assert!(wrong < 0.1 * change + wrong_without, "{name}: {wrong} of {change}, without {wrong_without}");
        // Diffuse pictures are no match.
        let no_match = block_difference(BLOCK, without, &expected);
        assert!(no_match > 0.7 * change && no_match > 2.0 * wrong, "{name}: {no_match} {change} {wrong}");
    }
}

#[test]
fn devices_show_the_same_finish() {
    let Some(vulkan) = vulkan() else { return };
    let loaded = procedural::build("gloss").unwrap();
    let setup = Setup { materials: Materials::Gltf, sub_frames: 2, size: SIZE, ..Setup::coarse() };
    let ours = pictures(&setup, &loaded, cpu());
    let theirs = pictures(&setup, &loaded, Box::new(vulkan));
    assert!(block_difference(BLOCK, &theirs.full, &ours.full) < 1e-4);
    let apart =
        ours.full.pixels.iter().zip(&theirs.full.pixels).filter(|(a, b)| (**a - **b).length() > 1e-3 * a.length());
    assert!(apart.count() < 10);
}

#[test]
fn bands_and_views_show_the_same_finish() {
    let loaded = procedural::build("gloss").unwrap();
    let setup = Setup { materials: Materials::Gltf, sub_frames: 2, size: SIZE, ..Setup::coarse() };
    let bake = setup.bake(&loaded).unwrap();
    let whole = picture_of(&mut setup.load(&loaded, &bake, cpu()).unwrap(), &loaded);
    let view = Setup { receivers_updated: ReceiverUpdate::InView, ..setup };
    let mut renderer = view.load(&loaded, &bake, cpu()).unwrap();
    assert_eq!(picture_of(&mut renderer, &loaded).full.pixels, whole.full.pixels);
    // Another picture from the same renderer is the same: nothing adds up.
    assert_eq!(picture_of(&mut renderer, &loaded).full.pixels, whole.full.pixels);
    let limited = Limited::new(cpu(), 1 << 18);
    let banded = picture_of(&mut setup.load(&loaded, &bake, Box::new(limited)).unwrap(), &loaded);
    assert_eq!(banded.full.pixels, whole.full.pixels);
}

#[test]
fn what_is_shown_again_from_one_place_stays_as_it_is() {
    let loaded = procedural::build("gloss").unwrap();
    let setup = Setup {
        materials: Materials::Gltf,
        sub_frames: 1,
        size: SIZE,
        receivers_updated: ReceiverUpdate::InView,
        ..Setup::coarse()
    };
    let mut renderer = setup.renderer(&loaded, cpu()).unwrap();
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let mut shown = || {
        renderer.display(&loaded.scene.lighting, &camera, 0, &scene::DisplayTransform::default()).unwrap();
        let buffer = renderer.displayed();
        renderer.light_mut().executor_mut().download(buffer).unwrap()
    };
    let first = shown();
    assert_eq!(shown(), first);
    assert_eq!(shown(), first);
}

#[test]
fn a_finish_needs_receivers_on_the_mesh_and_light_without_noise() {
    let loaded = procedural::build("gloss").unwrap();
    let base = Setup { materials: Materials::Gltf, ..Setup::coarse() };
    for setup in [Setup { direct: PixelLight::Sampled, ..base }, Setup { receivers: ReceiverKind::Pixels, ..base }] {
        let error = setup.renderer(&loaded, cpu()).err().unwrap().to_string();
        assert!(error.contains("receivers on the mesh"), "{error}");
    }
    // A scene in which nothing has a finish is the same either way.
    let plain = procedural::build("cornell").unwrap();
    let setup = Setup { size: SIZE, ..Setup::coarse() };
    let diffuse = pictures(&setup, &plain, cpu());
    let asked = pictures(&Setup { materials: Materials::Gltf, ..setup }, &plain, cpu());
    assert_eq!(asked.full.pixels, diffuse.full.pixels);
}
