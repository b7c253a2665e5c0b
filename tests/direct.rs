//! Direct light of what is large at pixels: closed forms, no noise, the same on both executors, nothing twice.

use assets::import::LoadedScene;
use assets::procedural;
use glam::{Vec3, vec3};
use integration_tests::setup::Setup;
use integration_tests::vulkan;
use patchlight::{PictureRenderer, PixelLight, ReceiverUpdate};
use runtime::executor::{DeviceChoice, Executor, open};
use scene::gpu::{LIGHT_RECT, Triangle, TriangleUv};
use scene::math::{atan2, luminance};
use scene::{Camera, Light, Material, Picture, Scene, SceneParts, Sky};

/// Reflectance of everything.
const ALBEDO: f32 = 0.5;
/// Edge of the pictures, pixels.
const SIZE: u32 = 32;

fn cpu() -> Box<dyn Executor> {
    open(&DeviceChoice::Cpu).unwrap().0
}

/// A floor of 20 m, whatever else is given, rectangle lights and a sky.
fn floor_and(walls: &[(Vec3, Vec3, Vec3)], lights: Vec<Light>, sky: f32) -> LoadedScene {
    let floor = (vec3(-10.0, 0.0, -10.0), Vec3::Z * 20.0, Vec3::X * 20.0);
    let mut parts = SceneParts {
        materials: vec![Material { albedo: Vec3::splat(ALBEDO), ..Material::default() }],
        sky: Sky { radiance: Vec3::splat(sky), ..Sky::default() },
        lights,
        ..SceneParts::default()
    };
    for &(corner, a, b) in [floor].iter().chain(walls) {
        for (edge_a, edge_b) in [(a, a + b), (a + b, b)] {
            let source = parts.triangles.len() as u32;
            parts.triangles.push(Triangle { corner, edge_a, edge_b, source, ..Triangle::default() });
            parts.uvs.push(TriangleUv::default());
        }
    }
    LoadedScene { scene: Scene::new(parts).unwrap(), ..procedural::build("furnace").unwrap() }
}

/// A lamp of 1 × 1 m that looks down, radiance 3.
fn lamp(corner: Vec3) -> Light {
    let edge_a = Vec3::X;
    let edge_b = Vec3::Z;
    Light { kind: LIGHT_RECT, position: corner, color: Vec3::splat(3.0), edge_a, edge_b, area: 1.0, ..Light::default() }
}

fn setup(direct: PixelLight) -> Setup {
    Setup {
        patch_count: 600,
        most_receivers: Some(6000),
        sub_frames: 8,
        direct,
        size: (SIZE, SIZE),
        ..Setup::default()
    }
}

/// Looks straight down at 4 × 4 m of the floor round a place.
fn from_above(x: f32, z: f32) -> Camera {
    let eye = vec3(x, 2.0, z);
    Camera::look_at(eye, eye - Vec3::Y, Vec3::NEG_Z, 90.0, SIZE, SIZE)
}

fn direct(loaded: &LoadedScene, camera: &Camera, mode: PixelLight) -> Picture {
    let mut renderer = setup(mode).renderer(loaded, cpu()).unwrap();
    renderer.picture(&loaded.scene.lighting, camera, 0).unwrap().pictures.direct
}

/// Place on the floor of a pixel's middle.
fn place(camera: &Camera, x: u32, y: u32) -> Vec3 {
    let at = |k: u32| (k as f32 + 0.5) / SIZE as f32 * 4.0 - 2.0;
    vec3(camera.eye.x + at(x), 0.0, camera.eye.z + at(y))
}

/// Greatest relative difference of the direct light of the pixels from what is expected at their places.
fn worst(picture: &Picture, camera: &Camera, expected: impl Fn(Vec3) -> f32) -> f32 {
    let mut worst: f32 = 0.0;
    for y in 0..SIZE {
        for x in 0..SIZE {
            let found = picture.pixels[(y * SIZE + x) as usize].x;
            let expected = expected(place(camera, x, y));
            worst = worst.max((found / expected - 1.0).abs());
        }
    }
    worst
}

/// π times the form factor to a rectangle parallel to the point's plane, with a corner over the point.
fn corner_over(a: f32, b: f32, height: f32) -> f32 {
    let x = a / height;
    let y = b / height;
    let rx = (1.0 + x * x).sqrt();
    let ry = (1.0 + y * y).sqrt();
    0.5 * (x / rx * atan2(y, rx) + y / ry * atan2(x, ry))
}

/// Radiance of the floor below [`lamp`] at (0, 3, 0).
fn below_lamp(p: Vec3) -> f32 {
    let part = |a: f32, b: f32| a.signum() * b.signum() * corner_over(a.abs(), b.abs(), 3.0);
    let sum = part(1.0 - p.x, 1.0 - p.z) + part(p.x, 1.0 - p.z) + part(1.0 - p.x, p.z) + part(p.x, p.z);
    ALBEDO / std::f32::consts::PI * 3.0 * sum
}

#[test]
fn an_open_floor_below_a_constant_sky_receives_all_of_it() {
    let camera = from_above(0.3, 0.2);
    let loaded = floor_and(&[], Vec::new(), 2.0);
    let picture = direct(&loaded, &camera, PixelLight::Smooth);
    let found = worst(&picture, &camera, |_| ALBEDO * 2.0);
    assert!(found < 1e-3, "{found}");
    // Half as bright a sky is told apart.
    assert!(worst(&picture, &camera, |_| ALBEDO) > 0.9);
}

#[test]
fn a_long_wall_takes_its_share_of_the_sky() {
    // 1.5 m high along z at x = 0; both ends are far.
    let wall = (vec3(0.0, 0.0, -10.0), Vec3::Z * 20.0, Vec3::Y * 1.5);
    let loaded = floor_and(&[wall], Vec::new(), 2.0);
    let camera = from_above(2.6, 0.0);
    let picture = direct(&loaded, &camera, PixelLight::Smooth);
    let open = |p: Vec3| 0.5 * (1.0 + p.x / p.x.hypot(1.5));
    let found = worst(&picture, &camera, |p| ALBEDO * 2.0 * open(p));
    assert!(found < 0.05, "{found}");
    // Near the wall half of the sky is left: to take it for open would be wrong by a third.
    assert!(worst(&picture, &camera, |_| ALBEDO * 2.0) > 0.25);
}

#[test]
fn a_lamp_over_a_floor_has_its_closed_form_at_pixels() {
    let camera = from_above(1.8, 0.1);
    // A low wall far off: without anything to reflect light to there would be no receivers.
    let wall = (vec3(-9.0, 0.0, -10.0), Vec3::Z * 20.0, Vec3::Y * 0.5);
    let loaded = floor_and(&[wall], vec![lamp(vec3(0.0, 3.0, 0.0))], 0.0);
    let picture = direct(&loaded, &camera, PixelLight::Smooth);
    // A pixel is the mean over its square, 0.125 m wide.
    let found = worst(&picture, &camera, below_lamp);
    assert!(found < 5e-3, "{found}");
    let higher = |p: Vec3| below_lamp(p * 1.1);
    assert!(worst(&picture, &camera, higher) > 0.02);
}

#[test]
fn shadows_of_a_lamp_are_those_of_many_random_rays() {
    // A board between lamp and floor.
    let board = (vec3(-0.3, 1.0, -0.3), Vec3::Z * 1.2, Vec3::X * 0.8);
    let loaded = floor_and(&[board], vec![lamp(vec3(0.0, 3.0, 0.0))], 0.0);
    // From below the board.
    let camera = Camera::look_at(vec3(2.5, 0.8, 1.5), vec3(0.2, 0.0, 0.2), Vec3::Y, 70.0, SIZE, SIZE);
    let smooth = direct(&loaded, &camera, PixelLight::Smooth);
    let many = Setup { sub_frames: 256, ..setup(PixelLight::Sampled) };
    let mut renderer = many.renderer(&loaded, cpu()).unwrap();
    let expected = renderer.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures.direct;
    let error = |picture: &Picture| {
        let each = picture.pixels.iter().zip(&expected.pixels);
        let (difference, all) = each.fold((0.0, 0.0), |sum, (a, b)| (sum.0 + (*a - *b).x.abs(), sum.1 + b.x));
        difference / all
    };
    let wall = (vec3(-9.0, 0.0, -10.0), Vec3::Z * 20.0, Vec3::Y * 0.5);
    let open = direct(&floor_and(&[wall], loaded.scene.lighting.lights.clone(), 0.0), &camera, PixelLight::Smooth);
    let found = error(&smooth);
    let wrong = error(&open);
    println!("smooth {found}, without the board {wrong}");
    assert!(found < 0.02 && wrong > 5.0 * found, "{found} {wrong}");
}

/// Share of the pixels of two pictures that differ by more than 1/255 as they are displayed.
fn noise(a: &Picture, b: &Picture) -> f64 {
    let shown = |p: &Vec3| p.to_array().map(|c| scene::kernel::shade::encode_srgb(c.clamp(0.0, 1.0)));
    let differ = |(a, b): (&Vec3, &Vec3)| shown(a).iter().zip(shown(b)).any(|(a, b)| (a - b).abs() > 1.0 / 255.0);
    a.pixels.iter().zip(&b.pixels).filter(|&pair| differ(pair)).count() as f64 / a.pixels.len() as f64
}

/// Two frames of a floor with a wall below a lamp and a sky.
fn two_frames(renderer: &mut PictureRenderer, loaded: &LoadedScene, camera: &Camera) -> [Picture; 2] {
    [0, 7].map(|number| renderer.picture(&loaded.scene.lighting, camera, number).unwrap().pictures.full)
}

fn lit_wall() -> (LoadedScene, Camera) {
    let wall = (vec3(0.0, 0.0, -10.0), Vec3::Z * 20.0, Vec3::Y * 1.5);
    let camera = Camera::look_at(vec3(4.0, 2.0, 1.5), vec3(0.0, 0.5, 0.0), Vec3::Y, 60.0, SIZE, SIZE);
    (floor_and(&[wall], vec![lamp(vec3(1.0, 3.0, 0.0))], 0.5), camera)
}

#[test]
fn frames_of_other_seeds_are_the_same_and_sampled_ones_are_not() {
    let (loaded, camera) = lit_wall();
    let bake = setup(PixelLight::Smooth).bake(&loaded).unwrap();
    let mut smooth = setup(PixelLight::Smooth).load(&loaded, &bake, cpu()).unwrap();
    let [a, b] = two_frames(&mut smooth, &loaded, &camera);
    assert_eq!(a, b);
    let mut sampled = setup(PixelLight::Sampled).load(&loaded, &bake, cpu()).unwrap();
    let [c, d] = two_frames(&mut sampled, &loaded, &camera);
    let noise = noise(&c, &d);
    assert!(noise > 0.1, "{noise}");
    // Both show as much light.
    let mean = |p: &Picture| p.pixels.iter().map(|p| luminance(*p)).sum::<f32>();
    assert!((mean(&a) / mean(&c) - 1.0).abs() < 0.01, "{} {}", mean(&a), mean(&c));
}

#[test]
fn both_executors_and_both_updates_make_the_same_pictures() {
    let (loaded, camera) = lit_wall();
    let bake = setup(PixelLight::Smooth).bake(&loaded).unwrap();
    let mut on_cpu = setup(PixelLight::Smooth).load(&loaded, &bake, cpu()).unwrap();
    let [expected, _] = two_frames(&mut on_cpu, &loaded, &camera);
    let in_view = Setup { receivers_updated: ReceiverUpdate::InView, ..setup(PixelLight::Smooth) };
    let mut in_view = in_view.load(&loaded, &bake, cpu()).unwrap();
    assert_eq!(two_frames(&mut in_view, &loaded, &camera)[0], expected);
    if let Some(vulkan) = vulkan() {
        let mut on_vulkan = setup(PixelLight::Smooth).load(&loaded, &bake, Box::new(vulkan)).unwrap();
        assert_eq!(two_frames(&mut on_vulkan, &loaded, &camera)[0], expected);
    }
    // Another sky shows without another bake, as a bake under it has it.
    let mut brighter = loaded.scene.lighting.clone();
    brighter.sky.radiance *= 3.0;
    let found = on_cpu.picture(&brighter, &camera, 0).unwrap().pictures.direct;
    assert!(noise(&found, &on_cpu.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures.direct) > 0.5);
    let again = on_cpu.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures.full;
    assert_eq!(again, expected);
}

#[test]
fn a_sky_that_no_receiver_sees_shows_nowhere() {
    let picture_below = |loaded: &LoadedScene, camera: &Camera, sky: f32| {
        let mut renderer = setup(PixelLight::Smooth).renderer(loaded, cpu()).unwrap();
        let mut lighting = loaded.scene.lighting.clone();
        lighting.sky.radiance = Vec3::splat(sky);
        renderer.picture(&lighting, camera, 0).unwrap().pictures.full
    };
    let difference = |loaded: &LoadedScene, camera: &Camera| {
        let [dark, lit] = [0.0, 1.0].map(|sky| picture_below(loaded, camera, sky));
        dark.pixels.iter().zip(&lit.pixels).map(|(dark, lit)| dark.distance(*lit)).fold(0.0, f32::max)
    };
    let closed = procedural::build("furnace").unwrap();
    // What rounding leaves of the sum of a row of form factors is taken for sky.
    let found = difference(&closed, &closed.view.camera(SIZE, SIZE));
    assert!(found < 1e-6, "{found}");
    let (open, camera) = lit_wall();
    assert!(difference(&open, &camera) > 0.1);
}

#[test]
fn ground_from_which_hardly_anything_but_sky_is_seen_shows_the_sky() {
    let post = (vec3(0.0, 0.0, -0.2), Vec3::Z * 0.4, Vec3::Y * 0.4);
    let loaded = floor_and(&[post], Vec::new(), 2.0);
    let far = from_above(7.5, 7.5);
    let picture = direct(&loaded, &far, PixelLight::Smooth);
    // One ray of 16 that the post stops is 6 %.
    let found = worst(&picture, &far, |_| ALBEDO * 2.0);
    assert!(found < 0.07, "{found}");
    // No light at all is told apart.
    assert!(worst(&picture, &far, |_| ALBEDO * 2e3) > 0.9);
}
