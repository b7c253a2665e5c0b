//! Points of one's own: on surfaces and in the air, of every kind, on every executor.

use std::sync::Arc;

use assets::procedural;
use glam::Vec3;
use integration_tests::setup::Setup;
use integration_tests::vulkan;
use patches::PatchKind;
use patchlight::method::FeedbackSettings;
use patchlight::{
    Bake, Estimator, LightField, LightSettings, Lighting, MethodSettings, PictureRenderer, PictureSettings, Point,
    PointKind, ReceiverKind, ReceiverUpdate, Scene, Silent,
};
use runtime::cpu::Cpu;
use runtime::executor::Executor;
use scene::{NONE, SurfacePoint};

/// Places in the unit square of a box from −1 to 1, and one on its floor.
const PLACES: [Vec3; 4] =
    [Vec3::ZERO, Vec3::new(0.5, -0.3, 0.2), Vec3::new(-0.7, 0.6, -0.8), Vec3::new(0.3, -1.0, 0.1)];

fn field(bake: &Arc<Bake>, settings: &LightSettings, executor: Box<dyn Executor>) -> LightField {
    LightField::new(Arc::clone(bake), executor, settings, &Silent).unwrap()
}

fn cornell() -> (Arc<Bake>, Lighting) {
    let loaded = procedural::build("cornell").unwrap();
    let bake = Setup::coarse().bake(&loaded).unwrap();
    (bake, loaded.scene.lighting.clone())
}

/// Sensors within the bounds of a scene, that look every way.
fn sensors(scene: &Scene) -> Vec<Point> {
    let (low, high) = scene.geometry.bounds;
    let middle = 0.5 * (low + high);
    let normals = [Vec3::Y, Vec3::NEG_X, Vec3::new(0.6, 0.0, 0.8), Vec3::NEG_Y];
    let at = |(place, normal): (&Vec3, Vec3)| Point { position: middle + 0.45 * (high - low) * *place, normal };
    PLACES.iter().zip(normals).map(at).collect()
}

/// In a closed box that shines with L_e and reflects ρ all over, radiance is L_e / (1 − ρ) everywhere; what was
/// reflected at least once is ρ L_e / (1 − ρ).
#[test]
fn points_in_the_air_of_a_furnace_have_the_closed_form() {
    let loaded = procedural::build("furnace").unwrap();
    let material = loaded.scene.materials[loaded.scene.geometry.triangles[0].material as usize];
    let radiance = material.albedo * material.radiance / (Vec3::ONE - material.albedo);
    let irradiance = radiance * std::f32::consts::PI;
    let points = sensors(&loaded.scene);
    for (patches, receivers) in [
        (PatchKind::default(), ReceiverKind::Mesh),
        (PatchKind::default(), ReceiverKind::Pixels),
        (PatchKind::Voxel, ReceiverKind::Patches),
    ] {
        let estimator = Estimator::Hemisphere { rays: 256 };
        let setup = Setup { patches, receivers, estimator, bounces: Some(40), ..Setup::coarse() };
        let bake = setup.bake(&loaded).unwrap();
        let mut field = field(&bake, &LightSettings::default(), Box::new(Cpu::new()));
        let kinds = [PointKind::Irradiance, PointKind::Cube, PointKind::HarmonicsL1];
        let sets = kinds.map(|kind| field.add_points(&points, kind, &Silent).unwrap());
        field.update(&loaded.scene.lighting).unwrap();
        // Samples find direct light with noise, of which a place near a wall sees few.
        let close =
            |found: Vec3, expected: Vec3| (found - expected).abs().max_element() < 0.25 * irradiance.max_element();
        for (kind, set) in kinds.into_iter().zip(sets) {
            let values = field.read(set).unwrap().values;
            assert_eq!(values.len(), points.len() * kind.values());
            for (k, value) in values.iter().enumerate() {
                let expected = match (kind, k % 4) {
                    (PointKind::HarmonicsL1, 0) => radiance * (4.0 * std::f32::consts::PI).sqrt(),
                    (PointKind::HarmonicsL1, _) => Vec3::ZERO,
                    _ => irradiance,
                };
                assert!(close(*value, expected), "{receivers:?} {kind:?} {k}: {value} {expected}");
            }
            assert!(!close(values[0], 0.5 * irradiance), "other light is noticed");
            if kind == PointKind::Cube {
                let mean = values.iter().sum::<Vec3>() / values.len() as f32;
                assert!((mean / irradiance - 1.0).abs().max_element() < 0.05, "{receivers:?} {mean} {irradiance}");
            }
        }
        // Rays that are traced for one call alone.
        let at =
            |point: &Point| SurfacePoint { position: point.position, patch: NONE, normal: point.normal, weight: 1.0 };
        let once: Vec<SurfacePoint> = points.iter().map(at).collect();
        for (value, point) in field.irradiance_at(&once).unwrap().iter().zip(&once) {
            assert!(close(*value, irradiance), "{receivers:?} {point:?}: {value} {irradiance}");
        }
    }
}

/// The rows are those of the first call: another light gives what rays of their own find under it.
#[test]
fn points_follow_the_light_on_every_executor() {
    let (bake, mut lighting) = cornell();
    let points = sensors(bake.scene());
    let at = |point: &Point| SurfacePoint { position: point.position, patch: NONE, normal: point.normal, weight: 1.0 };
    let places: Vec<SurfacePoint> = points.iter().map(at).collect();
    let settings = LightSettings::default().with_point_rays(4096);
    let mut bits: Vec<Vec<[u32; 3]>> = Vec::new();
    let executors = std::iter::once(Box::new(Cpu::new()) as Box<dyn Executor>)
        .chain(vulkan().map(|vulkan| Box::new(vulkan) as Box<dyn Executor>));
    for executor in executors {
        let mut field = field(&bake, &settings, executor);
        let set = field.add_points(&points, PointKind::Irradiance, &Silent).unwrap();
        let cubes = field.add_points(&points, PointKind::Cube, &Silent).unwrap();
        let mut found = Vec::new();
        for scale in [1.0, 3.0] {
            lighting.lights[0].color = bake.scene().lighting.lights[0].color * scale;
            field.update(&lighting).unwrap();
            let light = field.read(set).unwrap();
            let exact = field.irradiance_at(&places).unwrap();
            // One place may be inside of a block.
            assert!(exact.iter().filter(|exact| exact.min_element() > 0.0).count() >= 2, "{exact:?}");
            for (value, exact) in light.values.iter().zip(&exact) {
                assert!((*value - *exact).abs().max_element() <= 0.01 * exact.max_element(), "{value} {exact}");
            }
            found.extend(light.values.iter().map(|value| value.to_array().map(f32::to_bits)));
            found.extend(field.read(cubes).unwrap().values.iter().map(|value| value.to_array().map(f32::to_bits)));
        }
        assert_ne!(found[0], found[points.len() * 7], "the light has changed");
        bits.push(found);
    }
    assert!(bits.windows(2).all(|pair| pair[0] == pair[1]), "executors agree in bits");
}

#[test]
fn the_newest_light_is_read_without_waiting() {
    let (bake, mut lighting) = cornell();
    let points = sensors(bake.scene());
    let executors = std::iter::once(Box::new(Cpu::new()) as Box<dyn Executor>)
        .chain(vulkan().map(|vulkan| Box::new(vulkan) as Box<dyn Executor>));
    for executor in executors {
        let mut field = field(&bake, &LightSettings::default(), executor);
        let set = field.add_points(&points, PointKind::HarmonicsL1, &Silent).unwrap();
        assert!(field.try_read(set).unwrap().is_none(), "there is no light yet");
        assert!(field.read(set).is_err());
        let mut newest = None;
        for frame in 1..12 {
            lighting.lights[0].color = bake.scene().lighting.lights[0].color * frame as f32;
            field.update(&lighting).unwrap();
            let Some(light) = field.try_read(set).unwrap() else { continue };
            assert!(newest <= Some(light.update) && light.update < frame);
            newest = Some(light.update);
        }
        field.executor_mut().wait().unwrap();
        let last = field.try_read(set).unwrap().unwrap().clone();
        assert!(last.update >= 8, "{} of 10", last.update);
        // Light is in proportion to the lamp.
        let now = field.read(set).unwrap();
        assert_eq!(now.update, 10);
        let scale = (last.update + 1) as f32 / 11.0;
        for (then, now) in last.values.iter().zip(&now.values) {
            assert!((*then - *now * scale).abs().max_element() <= 1e-3 * now.abs().max_element(), "{then} {now}");
        }
        field.remove_points(set).unwrap();
        assert!(field.point_buffer(set).is_none() && field.try_read(set).unwrap().is_none());
    }
}

#[test]
fn points_of_one_set_stay_when_others_come_and_go() {
    let (bake, lighting) = cornell();
    let points = sensors(bake.scene());
    let mut field = field(&bake, &LightSettings::default(), Box::new(Cpu::new()));
    let first = field.add_points(&points[..2], PointKind::Cube, &Silent).unwrap();
    let second = field.add_points(&points, PointKind::Irradiance, &Silent).unwrap();
    field.update(&lighting).unwrap();
    let before = (field.read(first).unwrap(), field.read(second).unwrap());
    // Under light that is there, points are lit at once.
    let third = field.add_points(&points, PointKind::Irradiance, &Silent).unwrap();
    assert_eq!(field.read(third).unwrap().values, before.1.values);
    field.remove_points(first).unwrap();
    assert_eq!(field.read(second).unwrap(), before.1);
    // A new plan has them again.
    field.set_method(MethodSettings::Feedback(FeedbackSettings::default()), &Silent).unwrap();
    assert!(field.read(second).is_err(), "no light yet");
    for _ in 0..30 {
        field.update(&lighting).unwrap();
    }
    for (now, before) in field.read(second).unwrap().values.iter().zip(&before.1.values) {
        assert!((*now - *before).abs().max_element() <= 0.05 * before.max_element(), "{now} {before}");
    }
    let wrong = [Point { position: Vec3::ZERO, normal: Vec3::ZERO }];
    let error = field.add_points(&wrong, PointKind::Irradiance, &Silent).unwrap_err().to_string();
    assert!(error.contains("point 0") && error.contains("unit normals"), "{error}");
    assert!(field.add_points(&wrong, PointKind::Cube, &Silent).is_ok(), "cubes have no normal");
}

/// The state of progressive light survives what concerns pictures alone.
#[test]
fn pictures_of_another_size_leave_the_light_as_it_is() {
    let (bake, lighting) = cornell();
    let method = MethodSettings::Feedback(FeedbackSettings::default());
    let light = LightSettings::default().with_method(method);
    let camera = |(width, height)| procedural::build("cornell").unwrap().view.camera(width, height);
    let small = PictureSettings::default().with_size((16, 12)).with_sub_frames(1);
    for receivers in [ReceiverUpdate::All, ReceiverUpdate::InView] {
        let pictures = small.with_receivers(receivers);
        let open = || PictureRenderer::of_bake(Arc::clone(&bake), Box::new(Cpu::new()), &light, &pictures, &Silent);
        let mut resized = open().unwrap();
        let mut steady = open().unwrap();
        for renderer in [&mut resized, &mut steady] {
            for frame in 0..3 {
                renderer.picture(&lighting, &camera((16, 12)), frame).unwrap();
            }
        }
        let buffers = *resized.light().buffers();
        resized.resize((32, 24), 2).unwrap();
        assert_eq!(*resized.light().buffers(), buffers);
        let larger = resized.picture(&lighting, &camera((32, 24)), 3).unwrap().pictures.full;
        steady.picture(&lighting, &camera((16, 12)), 3).unwrap();
        let irradiance = steady.light_mut().surface_irradiance().unwrap();
        assert_eq!(resized.light_mut().surface_irradiance().unwrap(), irradiance, "{receivers:?}");
        // A light field that never had pictures.
        let mut alone = field(&bake, &light, Box::new(Cpu::new()));
        for _ in 0..4 {
            alone.update(&lighting).unwrap();
        }
        assert_eq!(alone.surface_irradiance().unwrap(), irradiance, "{receivers:?}");
        // The picture is that of a renderer of this size under the same light.
        let mut same = PictureRenderer::new(alone, &pictures.with_size((32, 24)).with_sub_frames(2)).unwrap();
        let settled = same.picture(&lighting, &camera((32, 24)), 3).unwrap().pictures.full;
        let difference = larger.minus(&settled).unwrap().mean().abs().max_element();
        assert!(difference < 0.02 * settled.mean().max_element(), "{difference}");
        assert!(same.light().device_bytes() > buffers_alone(&bake, &light), "pictures take memory");
    }
}

/// Under light at rest, which no update finds again, a picture of another size has all of it.
#[test]
fn pictures_of_another_size_under_light_at_rest_are_those_of_new_renderers() {
    let (bake, lighting) = cornell();
    let loaded = procedural::build("cornell").unwrap();
    let light = LightSettings::default();
    for receivers in [ReceiverUpdate::All, ReceiverUpdate::InView] {
        let open = |size: (u32, u32)| {
            let pictures = PictureSettings::default().with_size(size).with_sub_frames(1).with_receivers(receivers);
            PictureRenderer::of_bake(Arc::clone(&bake), Box::new(Cpu::new()), &light, &pictures, &Silent).unwrap()
        };
        let picture = |renderer: &mut PictureRenderer, (width, height): (u32, u32)| {
            renderer.picture(&lighting, &loaded.view.camera(width, height), 0).unwrap().pictures.full
        };
        let mut renderer = open((16, 12));
        let small = picture(&mut renderer, (16, 12));
        renderer.resize((32, 24), 1).unwrap();
        assert_eq!(picture(&mut renderer, (32, 24)), picture(&mut open((32, 24)), (32, 24)), "{receivers:?}");
        let points = sensors(bake.scene());
        let set = renderer.light_mut().add_points(&points, PointKind::Irradiance, &Silent).unwrap();
        renderer.resize((16, 12), 1).unwrap();
        assert_eq!(picture(&mut renderer, (16, 12)), small, "{receivers:?}: points come before the pictures");
        assert!(renderer.light_mut().read(set).unwrap().values[0].min_element() > 0.0);
    }
}

fn buffers_alone(bake: &Arc<Bake>, light: &LightSettings) -> u64 {
    field(bake, light, Box::new(Cpu::new())).device_bytes()
}

/// A picture that does not fit leaves the light, and the next that does is there again.
#[test]
fn pictures_that_do_not_fit_leave_the_light() {
    let (bake, lighting) = cornell();
    let Some(mut vulkan) = vulkan() else { return };
    vulkan.limit_memory(256 << 20);
    let pictures = PictureSettings::default().with_size((16, 12)).with_sub_frames(1);
    let mut renderer =
        PictureRenderer::of_bake(Arc::clone(&bake), Box::new(vulkan), &LightSettings::default(), &pictures, &Silent)
            .unwrap();
    let camera = procedural::build("cornell").unwrap().view.camera(16, 12);
    let before = renderer.picture(&lighting, &camera, 0).unwrap().pictures.full;
    let irradiance = renderer.light_mut().surface_irradiance().unwrap();
    assert!(renderer.resize((4096, 4096), 1).is_err());
    assert_eq!(renderer.light_mut().surface_irradiance().unwrap(), irradiance);
    assert!(renderer.picture(&lighting, &camera, 0).is_err(), "the size is still too large");
    renderer.resize((16, 12), 1).unwrap();
    assert_eq!(renderer.picture(&lighting, &camera, 0).unwrap().pictures.full, before);
}

#[test]
fn bakes_and_light_cross_threads() {
    fn is_send<T: Send>() {}
    fn is_sync<T: Sync>() {}
    is_send::<LightField>();
    is_send::<PictureRenderer>();
    is_send::<Bake>();
    is_sync::<Bake>();
    is_send::<Scene>();
    is_sync::<Scene>();
}
