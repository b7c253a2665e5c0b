//! Pictures whose tables exceed a binding run in bands of pixels, and are the same in every bit.

use std::sync::Arc;

use assets::LoadedScene;
use assets::procedural;
use glam::Vec3;
use integration_tests::limited::Limited;
use integration_tests::setup::Setup;
use integration_tests::vulkan;
use patches::PatchKind;
use patchlight::{Bake, Estimator, PictureRenderer, Pictures, PixelLight, ReceiverKind, ReceiverUpdate};
use runtime::cpu::Cpu;
use runtime::executor::Executor;

const SIZE: (u32, u32) = (97, 51);
const SUB_FRAMES: u32 = 2;
/// Bytes of a binding in which 608 pixels fit with the four rows above and below them.
const RANGE: u64 = 32 * (608 + 2 * 4 * (97 + 1) + 16);
const BANDS: usize = (97 * 51_usize).div_ceil(608);

fn setup() -> Setup {
    Setup {
        patch_count: 120,
        estimator: Estimator::Hemisphere { rays: 128 },
        most_receivers: Some(600),
        receiver_rays: 64,
        sub_frames: SUB_FRAMES,
        seed: 5,
        size: SIZE,
        ..Setup::default()
    }
}

fn renderer(setup: &Setup, loaded: &LoadedScene, bake: &Arc<Bake>, executor: Box<dyn Executor>) -> PictureRenderer {
    setup.load(loaded, bake, executor).unwrap()
}

/// Pictures from two places.
fn pictures(renderer: &mut PictureRenderer, loaded: &LoadedScene) -> [Pictures; 2] {
    [0.0, 0.1].map(|step| {
        let mut camera = loaded.view.camera(SIZE.0, SIZE.1);
        camera.eye += Vec3::X * step;
        // An update of its own marks what is in view, too.
        renderer.update_light(&loaded.scene.lighting, &camera).unwrap();
        renderer.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures
    })
}

fn passes_of(renderer: &mut PictureRenderer, kernel: &str) -> usize {
    renderer.light_mut().executor_mut().plan().passes().iter().filter(|pass| pass.kernel.name == kernel).count()
}

fn assert_same_in_bands(scene: &str, setup: &Setup) {
    let loaded = procedural::build(scene).unwrap();
    let bake = setup.bake(&loaded).unwrap();
    let whole = pictures(&mut renderer(setup, &loaded, &bake, Box::new(Cpu::new())), &loaded);
    assert_ne!(whole[0], whole[1], "{scene}: the places see the same");
    let devices = vulkan().map(|vulkan| Box::new(vulkan) as Box<dyn Executor>);
    for executor in [Box::new(Cpu::new()) as Box<dyn Executor>].into_iter().chain(devices) {
        let name = executor.device().name.clone();
        let mut in_bands = renderer(setup, &loaded, &bake, Box::new(Limited::new(executor, RANGE)));
        assert_eq!(passes_of(&mut in_bands, "scene_primary"), BANDS * SUB_FRAMES as usize);
        assert!(pictures(&mut in_bands, &loaded) == whole, "{scene} with {setup:?} on {name}");
    }
}

#[test]
fn direct_light_without_noise_is_averaged_over_the_borders_of_bands() {
    // Lamps of an area, whose visibility is averaged over pixels about; a sky.
    for scene in ["office", "atrium:3000"] {
        assert_same_in_bands(scene, &setup());
    }
}

#[test]
fn what_is_in_view_is_marked_by_all_bands() {
    assert_same_in_bands("office", &Setup { receivers_updated: ReceiverUpdate::InView, ..setup() });
}

#[test]
fn random_rays_of_pixels_are_the_same_in_bands() {
    assert_same_in_bands("office", &Setup { direct: PixelLight::Sampled, ..setup() });
}

#[test]
fn patches_as_receivers_are_looked_up_in_bands() {
    let by_patches = Setup { patches: PatchKind::Voxel, receivers: ReceiverKind::Patches, ..setup() };
    assert_same_in_bands("cornell", &by_patches);
}

#[test]
fn a_picture_that_one_binding_shows_is_one_band() {
    let loaded = procedural::build("cornell").unwrap();
    let mut whole = setup().renderer(&loaded, Box::new(Cpu::new())).unwrap();
    assert_eq!(passes_of(&mut whole, "scene_primary"), SUB_FRAMES as usize);
    assert_eq!(passes_of(&mut whole, "scene_add_large_light"), 1);
}
