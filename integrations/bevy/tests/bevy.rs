//! Light in Bevy: its lights in our units, its pictures against ours, frames without end, bakes as assets, things that move.

mod common;
#[path = "../examples/support/mod.rs"]
mod support;

use std::sync::Arc;

use bevy::light::EnvironmentMapLight;
use bevy::prelude::*;
use bevy_patchlight::{PatchlightMoving, PatchlightSettings, PatchlightStage, PatchlightStatic, PatchlightStatus};
use common::{Shot, headless};
use patchlight::glam::Vec3 as OwnVec3;
use patchlight::{Cpu, LightField, LightSettings, PictureRenderer, PictureSettings, Silent};

const SIZE: UVec2 = UVec2::new(320, 240);

fn settings(patch_count: usize, texel: f32) -> PatchlightSettings {
    PatchlightSettings { patch_count, texel, probe_count: 0, wait: true, ..PatchlightSettings::default() }
}

/// Puts the meshes of a built-in scene into an app.
fn spawn(app: &mut App, scene: &assets::LoadedScene) {
    app.world_mut().resource_scope(|world, mut meshes: Mut<Assets<Mesh>>| {
        world.resource_scope(|world, mut materials: Mut<Assets<StandardMaterial>>| {
            world.resource_scope(|world, mut images: Mut<Assets<Image>>| {
                support::spawn_meshes(scene, &mut world.commands(), &mut meshes, &mut materials, &mut images);
            });
        });
    });
    app.world_mut().flush();
}

/// A camera that shows radiance of a number as that number.
fn plain(transform: Transform) -> impl Bundle {
    (Camera3d::default(), transform, bevy::camera::Exposure { ev100: -1.2f32.log2() })
}

/// A white wall at z = 0, Lambertian as far as Bevy's materials are.
fn wall(app: &mut App) {
    let mesh = app.world_mut().resource_mut::<Assets<Mesh>>().add(Rectangle::new(8.0, 8.0));
    let material = StandardMaterial {
        base_color: Color::linear_rgb(0.5, 0.5, 0.5),
        perceptual_roughness: 1.0,
        reflectance: 0.0,
        ..default()
    };
    let material = app.world_mut().resource_mut::<Assets<StandardMaterial>>().add(material);
    app.world_mut().spawn((Mesh3d(mesh), MeshMaterial3d(material)));
}

/// Irradiance on such a wall.
fn irradiance(app: &mut App, places: &[Vec3]) -> Vec<OwnVec3> {
    use patchlight::scene::gpu::DirectParams;
    use patchlight::{Mesh as OwnMesh, Scene, SurfacePoint};
    let lighting = bevy_patchlight::lights_of(app.world_mut());
    let mut builder = Scene::builder();
    let corners = [OwnVec3::new(-4.0, -4.0, 0.0), OwnVec3::new(8.0, -4.0, 0.0), OwnVec3::new(-4.0, 8.0, 0.0)];
    builder.add_mesh(OwnMesh { positions: &corners, ..OwnMesh::default() });
    let scene = Scene::under(builder.build().unwrap().geometry, lighting).unwrap();
    let point = |place: &Vec3| SurfacePoint {
        position: OwnVec3::from(place.to_array()),
        normal: OwnVec3::Z,
        weight: 1.0,
        ..SurfacePoint::default()
    };
    let points: Vec<SurfacePoint> = places.iter().map(point).collect();
    let params =
        DirectParams { count: points.len() as u32, area_rays: 4096, ..patchlight::bake::direct_params(&scene) };
    scene.direct_irradiance(&params, &points)
}

#[test]
fn lights_are_those_of_bevy() {
    let place = Transform::from_xyz(0.0, 0.0, 2.0);
    let lamp = LinearRgba::rgb(1.0, 0.5, 0.25).into();
    let mut app = headless(PatchlightSettings::default());
    wall(&mut app);
    let shot = Shot::new(&mut app, UVec2::new(65, 65), plain(place.looking_at(Vec3::ZERO, Vec3::Y)));
    let towards = place.looking_at(Vec3::ZERO, Vec3::Y);
    type Spawn = Box<dyn Fn(&mut World) -> Entity>;
    let lights: [(&str, Spawn); 4] = [
        (
            "sun",
            Box::new(move |world| {
                world.spawn((DirectionalLight { color: lamp, illuminance: 20.0, ..default() }, towards)).id()
            }),
        ),
        (
            "point",
            Box::new(move |world| {
                world.spawn((PointLight { color: lamp, intensity: 900.0, range: 1000.0, ..default() }, place)).id()
            }),
        ),
        (
            "spot",
            Box::new(move |world| {
                let cone = SpotLight {
                    color: lamp,
                    intensity: 900.0,
                    range: 1000.0,
                    inner_angle: 0.1,
                    outer_angle: 0.4,
                    ..default()
                };
                world.spawn((cone, towards)).id()
            }),
        ),
        (
            "rectangle",
            Box::new(move |world| {
                let light = RectLight { color: lamp, intensity: 300.0, width: 0.8, height: 0.5, range: 1000.0 };
                world.spawn((light, towards)).id()
            }),
        ),
    ];
    for (name, spawn) in lights {
        let entity = spawn(app.world_mut());
        let picture = shot.take(&mut app, 3);
        // The middle of the picture, and a place in the half-shadow of the spot.
        let half = std::f32::consts::FRAC_PI_8.tan() * 2.0;
        let pixels = [(32, 32), (48, 32), (32, 20)];
        let at = |pixel: usize| (pixel as f32 + 0.5 - 32.5) / 32.5 * half;
        let places = pixels.map(|(x, y)| Vec3::new(at(x), -at(y), 0.0));
        let expected = irradiance(&mut app, &places);
        for ((x, y), expected) in pixels.into_iter().zip(expected) {
            let found = picture[y * 65 + x];
            let radiance = support::vector(expected) * 0.5 / std::f32::consts::PI;
            let error = (found - radiance).abs() / radiance;
            assert!(radiance.min_element() > 0.0 && error.max_element() < 0.01, "{name} {x} {y}: {found} {radiance}");
            // Lumens that were taken for candela are seen.
            assert!((found * 4.0 * std::f32::consts::PI - radiance).abs().max_element() > 0.5 * radiance.max_element());
        }
        app.world_mut().despawn(entity);
    }
}

/// A place that looks upwards, and one that looks along x, under a cube map: each face takes the share of the hemisphere
/// that it fills, of the one ahead 0.5541 (the view factor of a square twice as wide as it is away, Howell C-11 doubled).
#[test]
fn environment_maps_are_skies() {
    use bevy::asset::RenderAssetUsages;
    use bevy::render::render_resource::{Extent3d, TextureDimension, TextureFormat};
    use patchlight::scene::gpu::DirectParams;
    use patchlight::{Mesh as OwnMesh, Scene, SurfacePoint};
    let mut app = headless(PatchlightSettings::default());
    // Faces +x, -x, +y, -y, +z, -z: blue to the right, red above, green elsewhere.
    let (red, green, blue) = ([1.0f32, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]);
    let faces = [blue, green, red, green, green, green];
    let bytes = faces.iter().flat_map(|face| [*face; 64]).flatten().flat_map(f32::to_le_bytes).collect();
    let size = Extent3d { width: 8, height: 8, depth_or_array_layers: 6 };
    let image =
        Image::new(size, TextureDimension::D2, bytes, TextureFormat::Rgba32Float, RenderAssetUsages::MAIN_WORLD);
    let map = app.world_mut().resource_mut::<Assets<Image>>().add(image);
    let environment = EnvironmentMapLight { diffuse_map: map.clone(), specular_map: map, intensity: 3.0, ..default() };
    app.world_mut().spawn((Camera3d::default(), environment));
    app.update();
    let lighting = bevy_patchlight::lights_of(app.world_mut());
    let mut builder = Scene::builder();
    let corners = [OwnVec3::new(0.0, -99.0, 0.0), OwnVec3::new(0.1, -99.0, 0.0), OwnVec3::new(0.0, -99.0, 0.1)];
    builder.add_mesh(OwnMesh { positions: &corners, ..OwnMesh::default() });
    let scene = Scene::under(builder.build().unwrap().geometry, lighting).unwrap();
    let point = |normal: OwnVec3| SurfacePoint { normal, weight: 1.0, ..SurfacePoint::default() };
    let params = DirectParams { count: 2, sky_rays: 1 << 16, ..patchlight::bake::direct_params(&scene) };
    let found = scene.direct_irradiance(&params, &[point(OwnVec3::Y), point(OwnVec3::X)]);
    let share = |irradiance: OwnVec3| irradiance / (3.0 * std::f32::consts::PI);
    let (up, right) = (share(found[0]), share(found[1]));
    let side = (1.0 - 0.5541) / 4.0;
    assert!((up.x - 0.5541).abs() < 0.02 && (up.z - side).abs() < 0.02, "{up}");
    assert!((right.z - 0.5541).abs() < 0.02 && (right.x - side).abs() < 0.02, "{right}");
    assert!((up.element_sum() - 1.0).abs() < 0.01, "{up}");
}

/// Bevy's picture of the light of the lightmaps alone: with them less without them.
fn of_lightmaps(app: &mut App, shot: &Shot) -> Vec<Vec3> {
    let with = shot.take(app, 4);
    set_lightmaps(app, 0.0);
    let without = shot.take(app, 4);
    set_lightmaps(app, 1.0);
    with.iter().zip(without).map(|(with, without)| *with - without).collect()
}

fn set_lightmaps(app: &mut App, exposure: f32) {
    let mut materials = app.world_mut().resource_mut::<Assets<StandardMaterial>>();
    let ids: Vec<_> = materials.ids().collect();
    ids.into_iter().for_each(|id| materials.get_mut(id).unwrap().lightmap_exposure = exposure);
}

fn own_picture(pixels: &[Vec3]) -> patchlight::Picture {
    let pixels = pixels.iter().map(|pixel| OwnVec3::from(pixel.to_array()).max(OwnVec3::ZERO)).collect();
    patchlight::Picture::from_pixels(SIZE.x, SIZE.y, pixels).unwrap()
}

/// Light of lightmaps in Bevy and in Patchlight's own picture.
fn compare(name: &str, settings: PatchlightSettings) -> (f64, f64) {
    let patch_count = settings.patch_count;
    let scene = assets::load_or_build(name).unwrap();
    let scale = 0.1;
    let mut app = app_of(settings);
    spawn(&mut app, &scene);
    for light in &scene.scene.lighting.lights {
        support::spawn_light(light, &mut app.world_mut().commands()).unwrap();
    }
    let shot = Shot::new(&mut app, SIZE, support::camera(&scene, scale));
    let bevy = of_lightmaps(&mut app, &shot);
    assert_eq!(app.world().resource::<PatchlightStatus>().stage, PatchlightStage::Finished);

    let inside = times_in_bevy(&mut app);

    // All that was reflected, and what comes straight from surfaces that shine.
    let bake = patchlight::BakeSettings::default().with_patch_count(patch_count);
    let bake = Arc::new(patchlight::Bake::build(&scene.scene, &bake, &Silent).unwrap());
    let mut field = LightField::new(bake, Box::new(Cpu::new()), &LightSettings::default(), &Silent).unwrap();
    let alone = times_alone(&mut field, &scene.scene.lighting);
    println!("{name}: update {:.1} ms in Bevy, {:.1} ms alone; with texels {:.1} ms", inside.0, alone, inside.1);
    let own = PictureSettings::default().with_size((SIZE.x, SIZE.y)).with_sub_frames(16);
    let mut renderer = PictureRenderer::new(field, &own).unwrap();
    let camera = scene.view.camera(SIZE.x, SIZE.y);
    let lit = renderer.picture(&scene.scene.lighting, &camera, 0).unwrap().pictures;
    let dark = patchlight::Lighting { lights: Vec::new(), ..scene.scene.lighting.clone() };
    let surfaces = renderer.picture(&dark, &camera, 0).unwrap().pictures;
    let ours: Vec<OwnVec3> =
        lit.indirect.pixels.iter().zip(&surfaces.direct.pixels).map(|(a, b)| (*a + *b) * scale).collect();
    let ours = patchlight::Picture::from_pixels(SIZE.x, SIZE.y, ours).unwrap();
    let bevy = own_picture(&bevy);
    if let Ok(folder) = std::env::var("BEVY_PICTURES") {
        for (kind, picture) in [("bevy", &bevy), ("patchlight", &ours)] {
            let bytes = picture.displayed_bytes(reference::metrics::indirect_scale(&ours));
            let path = std::path::Path::new(&folder).join(format!("{name}-{kind}.png"));
            image::save_buffer(path, &bytes, SIZE.x, SIZE.y, image::ColorType::Rgb8).unwrap();
        }
    }
    // Surfaces and lamps that shine are seen themselves in one of the two.
    let is_lamp = |k: usize| lit.indirect.pixels[k] == OwnVec3::ZERO && lit.direct.pixels[k] != OwnVec3::ZERO;
    let mask: Vec<bool> = (0..ours.pixels.len()).map(|k| !is_lamp(k) && !shines(&scene, &camera, k as u32)).collect();
    let scale = reference::metrics::indirect_scale(&ours);
    let errors = reference::metrics::compare_pictures(&bevy, &ours, scale, Some(&mask)).unwrap();
    let wrong = reference::metrics::compare_pictures(&bevy.displayed(2.0 * scale), &ours, scale, Some(&mask)).unwrap();
    assert!(wrong.ssim < 0.97, "a picture with another exposure is seen: {}", wrong.ssim);
    println!("{name}: {errors:?}");
    (errors.ssim, errors.mean_ratio)
}

/// Medians of an update and of all of its work while lights move, ms.
fn times_in_bevy(app: &mut App) -> (f64, f64) {
    let mut times = Vec::new();
    for frame in 0..21 {
        let world = app.world_mut();
        let mut lights = world.query_filtered::<&mut Transform, Or<(With<RectLight>, With<PointLight>)>>();
        lights.iter_mut(world).for_each(|mut place| place.translation.x += if frame % 2 == 0 { 0.01 } else { -0.01 });
        app.update();
        times.push((status(app).update_time.as_secs_f64(), status(app).work_time.as_secs_f64()));
    }
    let median = |mut times: Vec<f64>| {
        times.sort_by(f64::total_cmp);
        1e3 * times[times.len() / 2]
    };
    (median(times.iter().map(|times| times.0).collect()), median(times.iter().map(|times| times.1).collect()))
}

/// Median of an update of a light field under lights that move, ms.
fn times_alone(field: &mut LightField, lighting: &patchlight::Lighting) -> f64 {
    let mut lighting = lighting.clone();
    let mut times = Vec::new();
    for frame in 0..21 {
        lighting.lights.iter_mut().for_each(|light| light.position.x += if frame % 2 == 0 { 0.01 } else { -0.01 });
        let start = std::time::Instant::now();
        field.update(&lighting).unwrap();
        field.surface_irradiance().unwrap();
        times.push(1e3 * start.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn shines(scene: &assets::LoadedScene, camera: &patchlight::Camera, pixel: u32) -> bool {
    use patchlight::scene::Visibility as _;
    let (x, y) = (pixel % camera.width, pixel / camera.width);
    [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].iter().any(|(dx, dy)| {
        let direction = patchlight::scene::kernel::camera::camera_direction(camera, x as f32 + dx, y as f32 + dy);
        let hit = scene.scene.closest(camera.eye, direction.normalize());
        !hit.is_miss() && {
            let triangle = &scene.scene.geometry.triangles[hit.triangle as usize];
            scene.scene.materials[triangle.material as usize].radiance != OwnVec3::ZERO
        }
    })
}

#[test]
fn pictures_of_the_box_are_those_of_patchlight() {
    let (ssim, ratio) = compare("cornell", settings(400, 0.01));
    assert!(ssim >= 0.97 && (ratio - 1.0).abs() < 0.03, "{ssim} {ratio}");
}

#[test]
fn pictures_of_the_office_are_those_of_patchlight() {
    let (ssim, ratio) = compare("office", settings(1000, 0.05));
    assert!(ssim >= 0.97 && (ratio - 1.0).abs() < 0.03, "{ssim} {ratio}");
}

/// The device's read-back and the processor's numbers are the same light.
#[cfg(feature = "vulkan")]
#[test]
fn pictures_of_a_vulkan_device_are_those_of_patchlight() {
    let device = bevy_patchlight::DeviceChoice::Vulkan;
    let (ssim, ratio) = compare("cornell", PatchlightSettings { device, ..settings(400, 0.01) });
    assert!(ssim >= 0.97 && (ratio - 1.0).abs() < 0.03, "{ssim} {ratio}");
}

/// Light that never leaves Bevy's own device.
#[cfg(feature = "vulkan")]
#[test]
fn pictures_of_bevys_own_device_are_those_of_patchlight() {
    let (ssim, ratio) = compare("cornell", PatchlightSettings { shares_device: true, ..settings(400, 0.01) });
    assert!(ssim >= 0.97 && (ratio - 1.0).abs() < 0.03, "{ssim} {ratio}");
}

#[cfg(feature = "vulkan")]
#[test]
fn a_device_that_cannot_be_shared_is_told() {
    let shared = PatchlightSettings { shares_device: true, ..settings(60, 0.2) };
    let mut app = headless(shared.clone());
    room(&mut app);
    (0..6).for_each(|_| app.update());
    let PatchlightStage::Failed(reason) = status(&app).stage else { panic!("{:?}", status(&app)) };
    assert!(reason.contains("vulkan_renderer"), "{reason}");
    let device = bevy_patchlight::DeviceChoice::Vulkan;
    let mut app = headless(PatchlightSettings { device, ..shared });
    room(&mut app);
    (0..4).for_each(|_| app.update());
    let PatchlightStage::Failed(reason) = status(&app).stage else { panic!("{:?}", status(&app)) };
    assert!(reason.contains("shares_device"), "{reason}");
}

#[test]
fn a_device_that_is_not_there_is_told() {
    let device = bevy_patchlight::DeviceChoice::Name("no such card".into());
    let mut app = headless(PatchlightSettings { device, ..settings(60, 0.2) });
    room(&mut app);
    (0..4).for_each(|_| app.update());
    let PatchlightStage::Failed(reason) = status(&app).stage else { panic!("{:?}", status(&app)) };
    assert!(reason.contains("no such card") || reason.contains("Vulkan"), "{reason}");
}

/// An app on the device that the settings ask for.
fn app_of(settings: PatchlightSettings) -> App {
    #[cfg(feature = "vulkan")]
    if settings.shares_device {
        return common::headless_shared(settings);
    }
    headless(settings)
}

/// A closed room of boxes with a lamp, and its light as Bevy shows it.
fn room(app: &mut App) -> Entity {
    let world = app.world_mut();
    let white = world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial {
        base_color: Color::linear_rgb(0.7, 0.7, 0.7),
        perceptual_roughness: 1.0,
        reflectance: 0.0,
        ..default()
    });
    for (middle, size) in [
        ((0.0, -0.1, 0.0), (4.2, 0.2, 4.2)),
        ((0.0, 2.6, 0.0), (4.2, 0.2, 4.2)),
        ((-2.1, 1.25, 0.0), (0.2, 2.9, 4.2)),
        ((2.1, 1.25, 0.0), (0.2, 2.9, 4.2)),
        ((0.0, 1.25, -2.1), (4.2, 2.9, 0.2)),
        ((0.0, 1.25, 2.1), (4.2, 2.9, 0.2)),
    ] {
        let mesh = world.resource_mut::<Assets<Mesh>>().add(Cuboid::from_size(size.into()));
        let place = Transform::from_translation(middle.into());
        world.spawn((Mesh3d(mesh), MeshMaterial3d(white.clone()), place, PatchlightStatic));
    }
    let lamp = PointLight { intensity: 4000.0, range: 100.0, affects_lightmapped_mesh_diffuse: false, ..default() };
    world.spawn((lamp, Transform::from_xyz(0.0, 2.0, 0.0))).id()
}

fn view() -> impl Bundle {
    plain(Transform::from_xyz(1.7, 1.6, 1.7).looking_at(Vec3::new(-0.5, 0.8, -0.5), Vec3::Y))
}

fn mean(picture: &[Vec3]) -> f32 {
    picture.iter().map(|pixel| pixel.element_sum() / 3.0).sum::<f32>() / picture.len() as f32
}

fn status(app: &App) -> PatchlightStatus {
    app.world().resource::<PatchlightStatus>().clone()
}

#[test]
fn light_follows_lamps_for_six_hundred_frames() {
    let messages = common::messages();
    for shares_device in devices() {
        // Drivers of the processor find light in the frames.
        let frames = if shares_device { 180 } else { 600 };
        follow_lamps(PatchlightSettings { wait: false, shares_device, ..settings(100, 0.1) }, frames);
        let said = messages.lock().unwrap().clone();
        assert!(said.is_empty(), "{said:?}");
    }
}

/// Light of the processor, and on Bevy's device where that can be.
fn devices() -> impl Iterator<Item = bool> {
    [false, true].into_iter().take(if cfg!(feature = "vulkan") { 2 } else { 1 })
}

fn follow_lamps(settings: PatchlightSettings, frames: usize) {
    let mut app = app_of(settings);
    let lamp = room(&mut app);
    let shot = Shot::new(&mut app, UVec2::new(64, 48), view());
    let until = std::time::Instant::now() + std::time::Duration::from_secs(300);
    while status(&app).stage != PatchlightStage::Finished {
        assert!(std::time::Instant::now() < until, "{:?}", status(&app));
        app.update();
    }
    settle(&mut app);
    let once = mean(&shot.take(&mut app, 3));
    app.world_mut().get_mut::<PointLight>(lamp).unwrap().intensity *= 2.0;
    settle(&mut app);
    let twice = mean(&shot.take(&mut app, 3));
    assert!(once > 0.0 && (twice / once - 2.0).abs() < 0.01, "{once} {twice}");

    let before = status(&app).updates;
    let mut memory = Vec::new();
    for frame in 0..frames {
        let turn = frame as f32 * 0.05;
        app.world_mut().get_mut::<Transform>(lamp).unwrap().translation = Vec3::new(turn.sin(), 1.8, turn.cos());
        app.update();
        if (frame + 1) % (frames / 6) == 0 {
            memory.push(patchlight::scene::host::memory::resident_bytes().unwrap_or(0));
        }
    }
    assert!(status(&app).updates > before + 30, "{:?}", status(&app));
    let growth = memory[5].saturating_sub(memory[1]);
    assert!(growth < 16 << 20, "{memory:?}");
}

/// Updates until the light is that of the lights.
fn settle(app: &mut App) {
    for _ in 0..2 {
        let before = status(app).updates;
        for _ in 0..200 {
            app.update();
            if status(app).updates > before {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
    }
}

/// Four closed rooms: a lamp of one sends the texels of one, and they arrive.
#[test]
fn what_changes_is_sent() {
    let mut app = headless(settings(200, 0.05));
    let lamp = room(&mut app);
    let world = app.world_mut();
    let mut others = world.query::<(&Mesh3d, &MeshMaterial3d<StandardMaterial>, &Transform, Has<PatchlightStatic>)>();
    let others: Vec<_> = others.iter(world).map(|(a, b, c, _)| (a.clone(), b.clone(), *c)).collect();
    for (mesh, material, place) in others {
        for k in 1..4 {
            let place = place.with_translation(place.translation + Vec3::X * 20.0 * k as f32);
            world.spawn((mesh.clone(), material.clone(), place, PatchlightStatic));
        }
    }
    let far = PointLight { intensity: 4000.0, range: 100.0, affects_lightmapped_mesh_diffuse: false, ..default() };
    let far = world.spawn((far, Transform::from_xyz(20.0, 2.0, 0.0))).id();
    let shot = Shot::new(&mut app, UVec2::new(64, 48), view());
    let once = mean(&shot.take(&mut app, 4));
    let (width, height) = status(&app).lightmap_size;
    let all = u64::from(width) * u64::from(height);
    app.world_mut().get_mut::<PointLight>(far).unwrap().intensity *= 3.0;
    app.update();
    assert!((1..=all / 2).contains(&status(&app).texels_sent), "{} of {all}", status(&app).texels_sent);
    let same = mean(&shot.take(&mut app, 2));
    assert!((same / once - 1.0).abs() < 1e-3, "{same} {once}");
    app.world_mut().get_mut::<PointLight>(lamp).unwrap().intensity *= 2.0;
    app.update();
    assert!((1..=all / 2).contains(&status(&app).texels_sent), "{} of {all}", status(&app).texels_sent);
    let twice = mean(&shot.take(&mut app, 2));
    assert!((twice / once - 2.0).abs() < 0.01, "{twice} {once}");
}

#[test]
fn bakes_are_assets_and_old_ones_are_seen() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.bake");
    let mut app = headless(settings(100, 0.1));
    room(&mut app);
    assert!(status(&app).save_bake(&path).unwrap_err().to_string().contains("not finished"));
    (0..4).for_each(|_| app.update());
    status(&app).save_bake(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();

    let stored = |is_same: bool| {
        let mut app = common::headless_in(settings(60, 0.1), folder.path());
        room(&mut app);
        if !is_same {
            app.world_mut().spawn((Mesh3d(Handle::default()), MeshMaterial3d::<StandardMaterial>(Handle::default())));
            let mesh = app.world_mut().resource_mut::<Assets<Mesh>>().add(Cuboid::new(0.5, 0.5, 0.5));
            let material = app.world_mut().resource_mut::<Assets<StandardMaterial>>().add(Color::WHITE);
            let place = Transform::from_xyz(0.0, 0.3, 0.0);
            app.world_mut().spawn((Mesh3d(mesh), MeshMaterial3d(material), place, PatchlightStatic));
        }
        let handle = app.world().resource::<AssetServer>().load("room.bake");
        app.world_mut().resource_mut::<PatchlightSettings>().bake = Some(handle);
        for _ in 0..400 {
            app.update();
            if status(&app).stage == PatchlightStage::Finished {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        assert_eq!(status(&app).stage, PatchlightStage::Finished);
        status(&app).patches
    };
    let of_file = patchlight::Bake::from_bytes("room", bytes).unwrap().bake.mesh().patches.len();
    assert_eq!(stored(true), of_file);
    assert_ne!(stored(false), of_file);
}

#[test]
fn what_moves_hides_and_reflects_and_is_lit() {
    for shares_device in devices() {
        move_about(PatchlightSettings { probe_count: 200, shares_device, ..settings(200, 0.1) });
    }
}

fn move_about(settings: PatchlightSettings) {
    let mut app = app_of(settings);
    room(&mut app);
    let shot = Shot::new(&mut app, UVec2::new(64, 48), view());
    let empty = mean(&shot.take(&mut app, 4));
    let red = app.world_mut().resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial {
        base_color: Color::linear_rgb(0.6, 0.02, 0.02),
        perceptual_roughness: 1.0,
        reflectance: 0.0,
        ..default()
    });
    let mesh = app.world_mut().resource_mut::<Assets<Mesh>>().add(Cuboid::new(1.2, 1.2, 0.2));
    let place = Transform::from_xyz(-1.0, 0.8, -1.0);
    let entity = app.world_mut().spawn((Mesh3d(mesh), MeshMaterial3d(red), place, PatchlightMoving)).id();
    let picture = shot.take(&mut app, 4);
    let with = mean(&picture);
    assert!((with / empty - 1.0).abs() > 0.01, "{with} {empty}");
    // Its own light is that of the volume.
    let reddest = picture.iter().map(|pixel| pixel.x / (pixel.y + pixel.x * 0.02 + 1e-6)).fold(0.0f32, f32::max);
    assert!(reddest > 5.0, "{reddest}");
    app.world_mut().despawn(entity);
    let again = mean(&shot.take(&mut app, 4));
    assert!((again / empty - 1.0).abs() < 1e-3, "{again} {empty}");

    // A mesh that goes makes a new bake, and the others keep their light.
    let wall = app.world_mut().query_filtered::<Entity, With<PatchlightStatic>>().iter(app.world()).last().unwrap();
    app.world_mut().despawn(wall);
    let open = mean(&shot.take(&mut app, 6));
    assert!(open > 0.0 && open < 0.97 * empty, "{open} {empty}");
}
