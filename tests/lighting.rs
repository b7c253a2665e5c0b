//! Light sources may change freely after a bake: lights come, go and move, the sky and the emission of materials
//! change.

use std::sync::Arc;

use assets::import::View;
use assets::{LoadedScene, procedural};
use glam::{Vec3, Vec4};
use integration_tests::limited::Limited;
use integration_tests::setup::Setup;
use integration_tests::vulkan;
use patchlight::low_level::operator::Codec;
use patchlight::method::{FeedbackSettings, TemporalSettings};
use patchlight::{Bake, MethodSettings, PictureRenderer, Pictures, ReceiverUpdate, SampleLight};
use runtime::cpu::Cpu;
use runtime::executor::Executor;
use scene::{Camera, DisplayTransform, Lighting, Tone};

const SIZE: (u32, u32) = (32, 24);

fn setup(method: MethodSettings) -> Setup {
    Setup { method, ..Setup::coarse() }
}

fn methods() -> [MethodSettings; 4] {
    [
        MethodSettings::Classic,
        MethodSettings::Multibounce(Codec::LowRank { epsilon: 0.01 }),
        MethodSettings::Feedback(FeedbackSettings::default()),
        MethodSettings::Temporal(TemporalSettings::default()),
    ]
}

fn picture(renderer: &mut PictureRenderer, loaded: &LoadedScene, lighting: &Lighting) -> Pictures {
    renderer.picture(lighting, &loaded.view.camera(SIZE.0, SIZE.1), 0).unwrap().pictures
}

/// The picture under a lighting by a renderer that knows nothing else.
fn afresh(
    setup: &Setup,
    loaded: &LoadedScene,
    bake: &Arc<Bake>,
    executor: Box<dyn Executor>,
    lighting: &Lighting,
) -> Pictures {
    picture(&mut setup.load(loaded, bake, executor).unwrap(), loaded, lighting)
}

/// `count` lamps instead of the scene's one, of the same power in all.
fn lamps(loaded: &LoadedScene, count: usize) -> Lighting {
    let mut lighting = loaded.scene.lighting.clone();
    let mut lamp = lighting.lights[0];
    lamp.color /= count as f32;
    lighting.lights = (0..count)
        .map(|k| {
            let mut lamp = lamp;
            lamp.position += Vec3::X * 1e-3 * k as f32;
            lamp
        })
        .collect();
    lighting
}

#[test]
fn lights_beyond_those_of_the_bake_are_not_dropped() {
    let loaded = procedural::build("cornell").unwrap();
    let setup = setup(MethodSettings::Classic);
    let bake = setup.bake(&loaded).unwrap();
    let mut renderer = setup.load(&loaded, &bake, Box::new(Cpu::new())).unwrap();
    let one = picture(&mut renderer, &loaded, &loaded.scene.lighting);
    // Far more than fitted.
    let many = picture(&mut renderer, &loaded, &lamps(&loaded, 40));
    // Not of the whole picture: of lamps before each other the camera sees the nearest alone, a 40th as bright.
    let share = many.indirect.mean() / one.indirect.mean();
    assert!((share - Vec3::ONE).abs().max_element() < 0.05, "40 lamps of a 40th each: {share}");
    let first = Lighting { lights: lamps(&loaded, 40).lights[..1].to_vec(), ..loaded.scene.lighting.clone() };
    let dark = picture(&mut renderer, &loaded, &first);
    let share = dark.indirect.mean() / one.indirect.mean();
    assert!((share - Vec3::splat(1.0 / 40.0)).abs().max_element() < 0.002, "one of 40 lamps: {share}");
}

/// All lights are traced in each update, with the same light, where what is kept of them would be more than a binding
/// shows.
#[test]
fn more_lights_than_can_be_kept_give_the_same_light() {
    let loaded = procedural::build("cornell").unwrap();
    let setup = setup(MethodSettings::Classic);
    let bake = setup.bake(&loaded).unwrap();
    let mut kept = setup.load(&loaded, &bake, Box::new(Cpu::new())).unwrap();
    let mut traced = setup.load(&loaded, &bake, Box::new(Limited::new(Box::new(Cpu::new()), 1 << 17))).unwrap();
    let mut lighting = lamps(&loaded, 20);
    for frame in 0..3 {
        let [a, b] = [&mut kept, &mut traced].map(|renderer| picture(renderer, &loaded, &lighting).full);
        let wrong =
            a.pixels.iter().zip(&b.pixels).map(|(a, b)| (*a - *b).abs().max_element() / (1e-6 + a.max_element()));
        let wrong = wrong.fold(0.0, f32::max);
        assert!(wrong < 1e-4, "frame {frame}: {wrong}");
        lighting.lights[frame].position += 0.1 * Vec3::X;
        lighting.lights[7].color *= 3.0;
    }
    let bytes = |renderer: &PictureRenderer| renderer.light().bytes()["light shares"];
    assert!(bytes(&kept) > 5 * bytes(&traced), "{} {}", bytes(&kept), bytes(&traced));
}

#[test]
fn lights_that_come_and_go_leave_nothing_behind() {
    let loaded = procedural::build("cornell").unwrap();
    for method in methods() {
        let setup = setup(method);
        let bake = setup.bake(&loaded).unwrap();
        let mut renderer = setup.load(&loaded, &bake, Box::new(Cpu::new())).unwrap();
        let own = picture(&mut renderer, &loaded, &loaded.scene.lighting);
        for count in [3, 30, 2, 0] {
            picture(&mut renderer, &loaded, &lamps(&loaded, count));
        }
        // Methods that go on from the frame before take some frames.
        let mut again = picture(&mut renderer, &loaded, &loaded.scene.lighting);
        for _ in 0..60 {
            again = picture(&mut renderer, &loaded, &loaded.scene.lighting);
        }
        let ratio = again.full.mean() / own.full.mean();
        assert!((ratio - Vec3::ONE).abs().max_element() < 2e-3, "{method:?}: {ratio}");
    }
}

/// Only lights that have moved are traced: whatever came before, the light is that of a renderer which knows nothing of
/// it.
#[test]
fn lights_that_are_kept_are_those_that_would_be_found() {
    let loaded = procedural::build("office").unwrap();
    let setup = setup(MethodSettings::Classic);
    let bake = setup.bake(&loaded).unwrap();
    let mut renderer = setup.load(&loaded, &bake, Box::new(Cpu::new())).unwrap();
    let mut lighting = loaded.scene.lighting.clone();
    let mut before = picture(&mut renderer, &loaded, &lighting);
    let changes: [fn(&mut Lighting); 6] = [
        |lighting| lighting.lights[1].position += Vec3::X * 0.3,
        |lighting| lighting.lights[2].color = Vec3::ZERO,
        |lighting| lighting.lights[0].color *= 2.0,
        |lighting| {
            // A lamp that is dark moves, and shines again.
            lighting.lights[2].position -= Vec3::Z * 0.2;
            lighting.lights[2].color = Vec3::splat(9.0);
        },
        |lighting| {
            lighting.lights.remove(1);
        },
        |lighting| {
            let lamp = lighting.lights[0];
            lighting.lights.insert(1, scene::Light { position: lamp.position - Vec3::Y * 0.4, ..lamp });
        },
    ];
    for (k, change) in changes.into_iter().enumerate() {
        change(&mut lighting);
        let after = picture(&mut renderer, &loaded, &lighting);
        let expected = afresh(&setup, &loaded, &bake, Box::new(Cpu::new()), &lighting);
        assert!(after == expected, "change {k}");
        assert!(after.indirect != before.indirect, "change {k} shows nothing");
        before = after;
    }
}

#[test]
fn sky_and_emission_change_as_if_the_renderer_had_begun_with_them() {
    let loaded = procedural::build("atrium:3000").unwrap();
    let setup = setup(MethodSettings::Classic);
    let bake = setup.bake(&loaded).unwrap();
    let mut sky = loaded.scene.lighting.clone();
    sky.sky.radiance *= Vec3::new(0.2, 1.0, 3.0);
    let mut glowing = loaded.scene.lighting.clone();
    glowing.emission = loaded.scene.materials.iter().map(|m| m.radiance).collect();
    glowing.emission[0] = Vec3::new(5.0, 1.0, 0.2);
    type Open = fn() -> Option<Box<dyn Executor>>;
    let mut devices: Vec<Open> = vec![|| Some(Box::new(Cpu::new()))];
    devices.push(|| Some(Box::new(vulkan()?)));
    for device in devices {
        let Some(executor) = device() else { continue };
        let mut renderer = setup.load(&loaded, &bake, executor).unwrap();
        let own = picture(&mut renderer, &loaded, &loaded.scene.lighting);
        for lighting in [&sky, &glowing] {
            let changed = picture(&mut renderer, &loaded, lighting);
            assert_ne!(changed, own);
            let Some(executor) = device() else { continue };
            assert_eq!(changed, afresh(&setup, &loaded, &bake, executor, lighting));
        }
        assert_eq!(picture(&mut renderer, &loaded, &loaded.scene.lighting), own);
    }
}

#[test]
fn emission_of_another_number_of_materials_is_an_error() {
    let loaded = procedural::build("cornell").unwrap();
    let setup = setup(MethodSettings::Classic);
    let mut renderer = setup.renderer(&loaded, Box::new(Cpu::new())).unwrap();
    let wrong = Lighting { emission: vec![Vec3::ONE; 1000], ..loaded.scene.lighting.clone() };
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let message = renderer.update_light(&wrong, &camera).unwrap_err().to_string();
    assert!(message.contains("1000"), "{message}");
    // The lighting before still holds.
    renderer.update_light(&loaded.scene.lighting, &camera).unwrap();
}

#[test]
fn a_method_may_be_changed_between_frames() {
    let loaded = procedural::build("cornell").unwrap();
    let first = setup(MethodSettings::Classic);
    let bake = first.bake(&loaded).unwrap();
    let mut renderer = first.load(&loaded, &bake, Box::new(Cpu::new())).unwrap();
    let classic = picture(&mut renderer, &loaded, &loaded.scene.lighting);
    for method in methods() {
        renderer.set_method(method, &patchlight::Silent).unwrap();
        let changed = picture(&mut renderer, &loaded, &loaded.scene.lighting);
        let expected = afresh(&setup(method), &loaded, &bake, Box::new(Cpu::new()), &loaded.scene.lighting);
        assert_eq!(changed, expected, "{method:?}");
    }
    renderer.set_method(MethodSettings::Classic, &patchlight::Silent).unwrap();
    assert_eq!(picture(&mut renderer, &loaded, &loaded.scene.lighting), classic);
}

/// Pictures while the light and the camera move, and while they rest.
fn flight(setup: &Setup, loaded: &LoadedScene, bake: &Arc<Bake>, executor: Box<dyn Executor>) -> Vec<Pictures> {
    let mut renderer = setup.load(loaded, bake, executor).unwrap();
    // The light and the camera of each frame: both move, one rests, both rest, one comes back.
    [(0, 0), (1, 1), (1, 2), (2, 2), (2, 2), (0, 2), (0, 0)]
        .iter()
        .enumerate()
        .map(|(number, &(light, place))| {
            let mut lighting = loaded.scene.lighting.clone();
            lighting.lights.iter_mut().for_each(|lamp| lamp.color *= 1.0 + light as f32);
            let mut camera = loaded.view.camera(SIZE.0, SIZE.1);
            camera.eye += Vec3::new(0.05, 0.02, 0.0) * place as f32;
            renderer.picture(&lighting, &camera, number as u32).unwrap().pictures
        })
        .collect()
}

#[test]
fn what_is_in_view_has_the_light_that_all_have() {
    for scene in ["cornell", "atrium:3000"] {
        let loaded = procedural::build(scene).unwrap();
        let all = setup(MethodSettings::Classic);
        let in_view = Setup { receivers_updated: ReceiverUpdate::InView, ..all };
        let bake = all.bake(&loaded).unwrap();
        let expected = flight(&all, &loaded, &bake, Box::new(Cpu::new()));
        assert_eq!(flight(&in_view, &loaded, &bake, Box::new(Cpu::new())), expected, "{scene}");
        if let Some(vulkan) = vulkan() {
            assert_eq!(flight(&in_view, &loaded, &bake, Box::new(vulkan)), expected, "{scene}, on the device");
        }
        // The receivers out of view have their light as soon as somebody asks for it.
        let mut renderers = [all, in_view].map(|s| s.load(&loaded, &bake, Box::new(Cpu::new())).unwrap());
        let [all, in_view] = renderers.each_mut().map(|renderer| {
            picture(renderer, &loaded, &loaded.scene.lighting);
            renderer.light_mut().surface_irradiance().unwrap()
        });
        assert_eq!(all, in_view);
    }
}

#[test]
fn an_update_computes_less_when_only_a_part_is_in_view() {
    let loaded = procedural::build("atrium:3000").unwrap();
    let in_view = Setup { receivers_updated: ReceiverUpdate::InView, ..setup(MethodSettings::Classic) };
    let mut renderer = in_view.renderer(&loaded, Box::new(Cpu::new())).unwrap();
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    renderer.update_light(&loaded.scene.lighting, &camera).unwrap();
    let seen = |renderer: &mut PictureRenderer| {
        let interpolated = renderer.light().buffers().interpolated;
        renderer.light_mut().download(interpolated).unwrap().iter().filter(|h| h.truncate() != Vec3::ZERO).count()
    };
    let part = seen(&mut renderer);
    // Other light, the same camera: the same points, and theirs is the light that all updates give.
    let mut bright = loaded.scene.lighting.clone();
    bright.lights.iter_mut().for_each(|lamp| lamp.color *= 2.0);
    renderer.update_light(&bright, &camera).unwrap();
    assert_eq!(seen(&mut renderer), part);
    let interpolated = renderer.light().buffers().interpolated;
    let in_view = renderer.light_mut().download(interpolated).unwrap();
    let exact = renderer.light_mut().surface_irradiance().unwrap();
    let wrong = in_view.iter().zip(&exact).filter(|(h, exact)| h.truncate() != Vec3::ZERO && h.truncate() != **exact);
    assert_eq!(wrong.count(), 0);
    let all = renderer.light_mut().surface_irradiance().unwrap().iter().filter(|h| **h != Vec3::ZERO).count();
    assert!(part > 0 && 2 * part < all, "{part} of {all}");
}

/// Direct irradiance of the samples of the last update.
#[test]
fn shown_pictures_from_one_camera_are_those_of_new_renderers() {
    let loaded = procedural::build("cornell").unwrap();
    let setup = Setup { sub_frames: 1, ..setup(MethodSettings::Classic) };
    let bake = setup.bake(&loaded).unwrap();
    let executors = [Some(Box::new(Cpu::new()) as Box<dyn Executor>), vulkan().map(|v| Box::new(v) as _)];
    let own = loaded.view.camera(SIZE.0, SIZE.1);
    let other = View { eye: loaded.view.eye + Vec3::X * 0.05, ..loaded.view }.camera(SIZE.0, SIZE.1);
    let [dim, bright] = [0.3, 1.0].map(|share| {
        let mut lighting = loaded.scene.lighting.clone();
        lighting.lights[0].color *= share;
        lighting.lights[0].position.x += 0.1 * share;
        lighting
    });
    for executor in executors.into_iter().flatten() {
        let shown = |renderer: &mut PictureRenderer, lighting: &Lighting, camera: &Camera| -> Vec<u32> {
            renderer.display(lighting, camera, 0, &DisplayTransform::clipped(1.0)).unwrap();
            let buffer = renderer.displayed();
            renderer.light_mut().executor_mut().download_table(buffer).unwrap()
        };
        let afresh = |lighting: &Lighting, camera: &Camera| {
            shown(&mut setup.load(&loaded, &bake, Box::new(Cpu::new())).unwrap(), lighting, camera)
        };
        assert_ne!(afresh(&dim, &own), afresh(&bright, &own), "light that is another is seen");
        let mut renderer = setup.load(&loaded, &bake, executor).unwrap();
        for (lighting, camera) in [(&dim, &own), (&bright, &own), (&bright, &other), (&dim, &other), (&dim, &own)] {
            assert_eq!(shown(&mut renderer, lighting, camera), afresh(lighting, camera));
        }
        // What else uses the buffers of the pixels in between.
        renderer.update_light(&bright, &other).unwrap();
        assert_eq!(shown(&mut renderer, &bright, &own), afresh(&bright, &own));
        renderer.picture(&bright, &other, 3).unwrap();
        assert_eq!(shown(&mut renderer, &dim, &own), afresh(&dim, &own));
        assert_eq!(shown(&mut renderer, &bright, &own), afresh(&bright, &own));
        // Exposure and tone curve are those of the picture itself.
        let picture = renderer.picture(&bright, &own, 0).unwrap().pictures.full;
        let automatic = DisplayTransform { stops: picture.automatic_stops(), tone: Tone::Agx };
        renderer.display(&bright, &own, 0, &DisplayTransform::clipped(3.0)).unwrap();
        let stops = renderer.automatic_stops().unwrap();
        assert!((stops - automatic.stops).abs() < 1e-3, "{stops} beside {}", automatic.stops);
        renderer.display(&bright, &own, 0, &automatic).unwrap();
        let buffer = renderer.displayed();
        let codes: Vec<u32> = renderer.light_mut().executor_mut().download_table(buffer).unwrap();
        let expected = picture.shown_bytes(&automatic);
        let differ = codes.iter().zip(expected.chunks(3)).filter(|(code, bytes)| code.to_le_bytes()[..3] != **bytes);
        let count = differ.count();
        assert!(count * 100 < codes.len(), "{count} of {} pixels", codes.len());
        // What is seen has another albedo.
        let painted: Vec<Option<Vec3>> = loaded.scene.materials.iter().map(|_| Some(Vec3::splat(0.3))).collect();
        let mut other = setup.load(&loaded, &bake, Box::new(Cpu::new())).unwrap();
        for renderer in [&mut renderer, &mut other] {
            renderer.light_mut().set_albedo(&painted).unwrap();
        }
        let found = shown(&mut renderer, &bright, &own);
        assert_eq!(found, shown(&mut other, &bright, &own));
        assert_ne!(found, afresh(&bright, &own));
    }
}

fn sample_light(renderer: &mut PictureRenderer) -> Vec<Vec3> {
    let direct = renderer.light().buffers().direct;
    renderer.light_mut().download(direct).unwrap().iter().map(|h| h.truncate()).collect()
}

/// Indirect irradiance of the interpolation points under a lighting.
fn indirect(renderer: &mut PictureRenderer, loaded: &LoadedScene, lighting: &Lighting) -> Vec<Vec3> {
    picture(renderer, loaded, lighting);
    renderer.light_mut().surface_irradiance().unwrap()
}

/// Direct light of the samples that a caller gives stands for what would be traced; the light then is the same in every
/// bit.
#[test]
fn direct_light_of_the_samples_may_be_the_callers() {
    let loaded = procedural::build("cornell").unwrap();
    let lighting = &loaded.scene.lighting;
    let mut dark = lighting.clone();
    dark.lights.iter_mut().for_each(|lamp| lamp.color = Vec3::ZERO);
    let in_view = Setup { receivers_updated: ReceiverUpdate::InView, ..setup(MethodSettings::Classic) };
    for setup in methods().into_iter().map(setup).chain([in_view]) {
        let bake = setup.bake(&loaded).unwrap();
        let devices = vulkan().map(|vulkan| Box::new(vulkan) as Box<dyn Executor>);
        for executor in [Box::new(Cpu::new()) as Box<dyn Executor>].into_iter().chain(devices) {
            let mut traced = setup.load(&loaded, &bake, Box::new(Cpu::new())).unwrap();
            let expected = indirect(&mut traced, &loaded, lighting);
            let values = sample_light(&mut traced);
            assert_eq!(values.len(), traced.light().samples().len());

            // Lamps that are dark would give none of it.
            let mut given = setup.load(&loaded, &bake, executor).unwrap();
            given.light_mut().set_sample_light(SampleLight::Values(&values)).unwrap();
            assert!(indirect(&mut given, &loaded, &dark) == expected, "{setup:?}");
            assert_eq!(sample_light(&mut given), values);
        }
    }
}

#[test]
fn direct_light_of_the_samples_changes_as_the_caller_says() {
    let loaded = procedural::build("cornell").unwrap();
    let lighting = &loaded.scene.lighting;
    let setup = setup(MethodSettings::Classic);
    let mut renderer = setup.renderer(&loaded, Box::new(Cpu::new())).unwrap();
    let expected = picture(&mut renderer, &loaded, lighting);
    let values = sample_light(&mut renderer);
    // Other light at one sample that is lit: another picture.
    let mut wrong = values.clone();
    wrong[values.iter().position(|h| h.x > 1.0).unwrap()] *= 3.0;
    renderer.light_mut().set_sample_light(SampleLight::Values(&wrong)).unwrap();
    let of_wrong = indirect(&mut renderer, &loaded, lighting);
    assert!(picture(&mut renderer, &loaded, lighting) != expected);
    // The caller's shader writes: on the device, and nothing but that counts.
    let direct = renderer.light().buffers().direct;
    let on_device: Vec<Vec4> = values.iter().map(|h| h.extend(0.0)).collect();
    renderer.light_mut().executor_mut().upload(direct, &on_device).unwrap();
    renderer.light_mut().set_sample_light(SampleLight::OnDevice).unwrap();
    assert!(picture(&mut renderer, &loaded, lighting) == expected);
    // It lasts while lights move, and through a new plan where the caller's values are known.
    renderer.light_mut().set_sample_light(SampleLight::Values(&wrong)).unwrap();
    assert!(indirect(&mut renderer, &loaded, lighting) == of_wrong);
    assert!(indirect(&mut renderer, &loaded, &lamps(&loaded, 40)) == of_wrong);
    // Traced again.
    renderer.light_mut().set_sample_light(SampleLight::Traced).unwrap();
    assert!(picture(&mut renderer, &loaded, lighting) == expected);
}

#[test]
fn direct_light_that_does_not_suit_the_samples_is_refused() {
    let loaded = procedural::build("cornell").unwrap();
    let mut renderer = setup(MethodSettings::Classic).renderer(&loaded, Box::new(Cpu::new())).unwrap();
    let count = renderer.light().samples().len();
    let few = vec![Vec3::ONE; count - 1];
    match renderer.light_mut().set_sample_light(SampleLight::Values(&few)) {
        Err(error) => assert!(
            error.to_string().contains(&format!("of {} samples, and the bake has {count};", count - 1)),
            "{error}"
        ),
        other => panic!("{other:?}"),
    }
    for wrong in [f32::NAN, f32::INFINITY, -1.0] {
        let mut values = vec![Vec3::ONE; count];
        values[7].y = wrong;
        let error = renderer.light_mut().set_sample_light(SampleLight::Values(&values)).unwrap_err();
        assert!(error.to_string().starts_with("sample 7 is to receive"), "{error}");
    }
    // A plan with room for more lights has another buffer, which the caller has not written.
    picture(&mut renderer, &loaded, &loaded.scene.lighting);
    renderer.light_mut().set_sample_light(SampleLight::OnDevice).unwrap();
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    for _ in 0..2 {
        let error = renderer.update_light(&lamps(&loaded, 40), &camera).unwrap_err();
        assert!(error.to_string().contains("is another one now"), "{error}");
    }
    renderer.light_mut().set_sample_light(SampleLight::OnDevice).unwrap();
    renderer.update_light(&lamps(&loaded, 40), &camera).unwrap();
}
