//! Light by printed patches: it has no scale, and its shape is that of ours.

use patchlight::{
    Bake, BakeSettings, Estimator, LightSettings, PictureRenderer, PictureSettings, ReceiverKind, Silent,
};
use printed::{Form, PrintedRadiosity, PrintedSettings};
use scene::math::luminance;

const BOUNCES: u32 = 3;
const SIZE: (u32, u32) = (24, 18);

#[test]
fn light_by_printed_patches_has_no_scale() {
    let loaded = assets::procedural::build("cornell").unwrap();
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let mean = |picture: &patchlight::Picture| {
        picture.pixels.iter().map(|p| luminance(*p)).sum::<f32>() / picture.pixels.len() as f32
    };
    let settings = BakeSettings::default()
        .with_patches(patches::PatchKind::Axis)
        .with_patch_count(200)
        .with_estimator(Estimator::Hemisphere { rays: 512 })
        .with_receivers(ReceiverKind::Patches)
        .with_bounces(Some(BOUNCES));
    let bake = Bake::build(&loaded.scene, &settings, &Silent).unwrap();
    let light = LightSettings::default();
    let pictures = PictureSettings::default().with_size(SIZE).with_sub_frames(2);
    let mut ours =
        PictureRenderer::of_bake(bake.into(), Box::new(runtime::cpu::Cpu::new()), &light, &pictures, &Silent).unwrap();
    let ours = ours.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures.indirect;
    for form in [Form::Clusters, Form::Axes] {
        let settings = PrintedSettings { form, count: 200, voxel_size: None, seed: 1 };
        let printed = PrintedRadiosity::new(&loaded.scene, &settings, &Silent).unwrap();
        assert!((150..300).contains(&printed.set.len()), "{}", printed.set.len());
        assert!(printed.most_entries < printed.set.samples.len().pow(2) / 4);
        let light = |bounces: u32| {
            let irradiance = printed.irradiance(8, bounces).unwrap();
            mean(&printed.indirect(&irradiance, &camera, 2).unwrap())
        };
        let found = light(BOUNCES);
        let one = light(1);
        println!("{form:?}: {} times the light of ours", found / mean(&ours));
        assert!(found.is_finite() && found > 1.5 * mean(&ours), "{form:?}: {found} of {}", mean(&ours));
        assert!(one > 0.0 && one < found, "{form:?}: {one}");
    }
}
