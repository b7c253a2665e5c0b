//! Objects that move through a bake: beside path tracing of the scene with the object in its place.

use std::sync::Arc;

use assets::import::LoadedScene;
use assets::procedural;
use glam::{Affine3A, Quat, Vec3};
use integration_tests::setup::Setup;
use integration_tests::{block_difference, vulkan};
use patches::PatchKind;
use patchlight::low_level::operator::Codec;
use patchlight::method::FirstShotSettings;
use patchlight::{
    ErrorKind, MethodSettings, ObjectId, PictureRenderer, Pictures, ReceiverKind, ReceiverUpdate, Silent,
};
use reference::{Accumulation, PathSettings, PathTracer, Strategy};
use runtime::executor::{DeviceChoice, Executor, open};
use scene::math::luminance;
use scene::{Material, MaterialId, Mesh, NONE, Picture, Scene, SceneParts, SurfacePoint};

const SIZE: (u32, u32) = (128, 96);
/// Edge of the blocks that are compared, pixels.
const BLOCK: u32 = 4;

fn cpu() -> Box<dyn Executor> {
    open(&DeviceChoice::Cpu).unwrap().0
}

fn setup() -> Setup {
    Setup {
        patch_count: 1000,
        most_receivers: Some(8000),
        receiver_rays: 512,
        sub_frames: 8,
        size: SIZE,
        ..Setup::default()
    }
}

/// The 36 corners of a box about the origin.
fn corners(half: Vec3) -> Vec<Vec3> {
    let mut all = Vec::new();
    for axis in 0..3 {
        for sign in [-1.0f32, 1.0] {
            let mut n = Vec3::ZERO;
            n[axis] = sign;
            let mut u = Vec3::ZERO;
            u[(axis + 1) % 3] = sign;
            let mut v = Vec3::ZERO;
            v[(axis + 2) % 3] = 1.0;
            let at = |a: f32, b: f32| (n + u * a + v * b) * half;
            all.extend([at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]);
        }
    }
    all
}

/// A built-in scene with one more material, red, which the objects have.
fn scene_with_red(name: &str) -> (LoadedScene, MaterialId) {
    let mut loaded = procedural::build(name).unwrap();
    let g = &loaded.scene.geometry;
    let mut materials = g.materials.to_vec();
    let red = MaterialId::of_scene(materials.len());
    materials.push(Material { albedo: Vec3::new(0.8, 0.1, 0.1), ..Material::default() });
    let parts = SceneParts {
        triangles: g.triangles.clone(),
        uvs: g.uvs.clone(),
        materials,
        textures: g.textures.clone(),
        texels: g.texels.to_vec(),
        ray_offset: Some(g.ray_offset),
        ..SceneParts::default()
    };
    let mut lighting = loaded.scene.lighting.clone();
    if !lighting.emission.is_empty() {
        lighting.emission.push(Vec3::ZERO);
    }
    let made = Scene::new(parts).unwrap();
    loaded.scene = Scene::under(made.geometry.clone(), lighting).unwrap();
    (loaded, red)
}

fn with_box(loaded: &LoadedScene, mesh: Mesh, transform: Affine3A) -> Scene {
    let mut edit = loaded.scene.edit();
    edit.add(Mesh { transform, ..mesh });
    edit.build().unwrap()
}

fn traced(scene: &Scene, loaded: &LoadedScene, samples: u32) -> Accumulation {
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let settings = PathSettings { strategy: Strategy::Both, ..PathSettings::default() };
    let mut sums = Accumulation::new(&camera, settings);
    PathTracer::new(scene).accumulate(&camera, &mut sums, samples, |_, _| std::ops::ControlFlow::Continue(())).unwrap();
    sums
}

fn picture_of(renderer: &mut PictureRenderer, loaded: &LoadedScene) -> Pictures {
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    renderer.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures
}

#[test]
fn an_object_takes_and_gives_light_as_paths_say() {
    for (name, half, at, radiance) in [
        ("cornell", Vec3::new(0.06, 0.05, 0.06), Vec3::new(0.4, 0.0502, 0.06), 0.0),
        ("cornell", Vec3::new(0.06, 0.05, 0.06), Vec3::new(0.4, 0.2, 0.06), 2.0),
        ("office", Vec3::new(0.4, 0.5, 0.4), Vec3::new(2.4, 0.501, 2.9), 0.0),
    ] {
        let (mut loaded, red) = scene_with_red(name);
        let mut lighting = loaded.scene.lighting.clone();
        lighting.emission.resize(loaded.scene.materials.len(), Vec3::ZERO);
        lighting.emission[red.index()] = Vec3::splat(radiance);
        loaded.scene.set_lighting(lighting).unwrap();
        let positions = corners(half);
        let mesh = Mesh { positions: &positions, material: red, ..Mesh::default() };
        let transform = Affine3A::from_rotation_translation(Quat::from_rotation_y(0.4), at);
        let expected = traced(&with_box(&loaded, mesh, transform), &loaded, 256);
        let without = traced(&loaded.scene, &loaded, 256);
        let mut renderer = setup().renderer(&loaded, cpu()).unwrap();
        let bare = picture_of(&mut renderer, &loaded);
        renderer.light_mut().objects().insert(&mesh, transform).unwrap();
        let found = picture_of(&mut renderer, &loaded);
        for (part, found, bare, expected, without) in [
            ("direct", &found.direct, &bare.direct, expected.direct(), without.direct()),
            ("indirect", &found.indirect, &bare.indirect, expected.indirect(), without.indirect()),
        ] {
            let wrong = block_difference(BLOCK, found, &expected);
            let wrong_without = block_difference(BLOCK, bare, &without);
            let change = block_difference(BLOCK, &without, &expected);
            let energy = |found: &Picture, expected: &Picture| luminance(found.mean()) / luminance(expected.mean());
            let (own, own_without) = (energy(found, &expected), energy(bare, &without));
            println!(
                "{name} {part}: {wrong} with, {wrong_without} without, {change} between them; mean {own}, {own_without}"
            );
            // Hardly more is wrong than without the object, which changes far more.
            assert!(wrong < wrong_without + 0.15 * change, "{name} {part}");
            assert!(
                block_difference(BLOCK, bare, &expected) > 1.5 * wrong,
                "{name} {part}: the picture without it is as good"
            );
        }
    }
}

/// A cornell box with a red box in it, small.
fn small(executor: Box<dyn Executor>, change: impl FnOnce(&mut Setup)) -> (PictureRenderer, LoadedScene, ObjectId) {
    let (loaded, red) = scene_with_red("cornell");
    let mut setup = Setup { patch_count: 200, most_receivers: Some(1000), receiver_rays: 128, ..setup() };
    setup.size = (40, 30);
    setup.sub_frames = 2;
    change(&mut setup);
    let positions = corners(Vec3::new(0.06, 0.05, 0.06));
    let mesh = Mesh { positions: &positions, material: red, ..Mesh::default() };
    let mut renderer = setup.renderer(&loaded, executor).unwrap();
    let id = renderer.light_mut().objects().insert(&mesh, place(0)).unwrap();
    (renderer, loaded, id)
}

fn place(k: u32) -> Affine3A {
    let at = [Vec3::new(0.4, 0.0502, 0.06), Vec3::new(0.25, 0.2, 0.2), Vec3::new(0.1, 0.0502, 0.1)][k as usize];
    Affine3A::from_rotation_translation(Quat::from_rotation_y(k as f32), at)
}

fn pixels(renderer: &mut PictureRenderer, loaded: &LoadedScene) -> [Vec<Vec3>; 2] {
    let (width, height) = renderer.size();
    let camera = loaded.view.camera(width, height);
    let pictures = renderer.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures;
    [pictures.direct.pixels, pictures.indirect.pixels]
}

#[test]
fn light_depends_on_where_an_object_is_and_not_on_its_way() {
    let (mut renderer, loaded, id) = small(cpu(), |_| ());
    let first = pixels(&mut renderer, &loaded);
    for k in [1, 2] {
        assert!(renderer.light_mut().objects().set_transform(id, place(k)).unwrap());
        assert!(pixels(&mut renderer, &loaded) != first, "nothing has moved");
    }
    renderer.light_mut().objects().set_transform(id, place(0)).unwrap();
    assert!(pixels(&mut renderer, &loaded) == first, "the way is seen");
    // Two, and the other one alone.
    let positions = corners(Vec3::splat(0.05));
    let mesh = Mesh { positions: &positions, ..Mesh::default() };
    let other = renderer.light_mut().objects().insert(&mesh, place(2)).unwrap();
    assert_eq!(renderer.light_mut().objects().ids(), [id, other]);
    assert!(pixels(&mut renderer, &loaded) != first);
    renderer.light_mut().objects().remove(other).unwrap();
    assert!(pixels(&mut renderer, &loaded) == first, "an object that is gone is seen");
    // None: as if there had never been one.
    renderer.light_mut().objects().remove(id).unwrap();
    let bare = pixels(&mut renderer, &loaded);
    assert!(bare != first);
    let (mut fresh, loaded, id) = small(cpu(), |_| ());
    fresh.light_mut().objects().remove(id).unwrap();
    assert!(pixels(&mut fresh, &loaded) == bare);
    assert!(!fresh.light_mut().objects().set_transform(id, place(1)).unwrap());
    assert!(fresh.light_mut().objects().transform(id).is_none());
}

#[test]
fn another_bake_has_the_objects_where_they_are() {
    let (mut renderer, loaded, id) = small(cpu(), |_| ());
    pixels(&mut renderer, &loaded);
    renderer.light_mut().objects().set_transform(id, place(1)).unwrap();
    pixels(&mut renderer, &loaded);
    // Of the same room without its tall block: other triangles under other numbers.
    let mut edit = loaded.scene.edit();
    edit.remove(6);
    let scene = edit.build().unwrap();
    let edited = Arc::new(renderer.light().bake().edit(&scene, &Silent).unwrap().bake);
    renderer.light_mut().set_bake(Arc::clone(&edited), &Silent).unwrap();
    renderer.light_mut().objects().set_transform(id, place(2)).unwrap();
    let found = pixels(&mut renderer, &loaded);
    let (mut fresh, _, other) = small(cpu(), |_| ());
    fresh.light_mut().set_bake(edited, &Silent).unwrap();
    fresh.light_mut().objects().set_transform(other, place(2)).unwrap();
    assert!(pixels(&mut fresh, &loaded) == found);
}

/// A renderer of another size is loaded between a bake and its first light: rows have no changes yet.
#[test]
fn pictures_of_a_coarser_bake_forget_the_rows_of_the_finer() {
    let (loaded, red) = scene_with_red("rooms");
    let positions = corners(Vec3::new(0.02, 1.06, 0.72));
    let mesh = Mesh { positions: &positions, material: red, ..Mesh::default() };
    let setup = Setup { patch_count: 200, receiver_rays: 128, size: (40, 30), sub_frames: 2, ..setup() };
    let of = |receivers: usize| Setup { most_receivers: Some(receivers), ..setup };
    let coarse = of(200).bake(&loaded).unwrap();
    let found = [2000, 300].map(|receivers| {
        let mut renderer = of(receivers).renderer(&loaded, cpu()).unwrap();
        let id = renderer.light_mut().objects().insert(&mesh, door(-0.3)).unwrap();
        pixels(&mut renderer, &loaded);
        renderer.light_mut().set_bake(Arc::clone(&coarse), &Silent).unwrap();
        renderer.resize((48, 36), 2).unwrap();
        let at_once = pixels(&mut renderer, &loaded);
        renderer.light_mut().objects().set_transform(id, door(-0.2)).unwrap();
        [at_once, pixels(&mut renderer, &loaded)]
    });
    assert!(found[0] == found[1] && found[0][0] != found[0][1]);
}

#[test]
fn both_executors_and_views_give_the_same_pictures() {
    let walk = |executor: Box<dyn Executor>, receivers: ReceiverUpdate| {
        let (mut renderer, loaded, id) = small(executor, |setup| setup.receivers_updated = receivers);
        let mut all = vec![pixels(&mut renderer, &loaded)];
        for k in [1, 2] {
            renderer.light_mut().objects().set_transform(id, place(k)).unwrap();
            all.push(pixels(&mut renderer, &loaded));
        }
        // Another light in the last place.
        let mut brighter = loaded.clone();
        brighter.scene.lighting.lights.iter_mut().for_each(|light| light.color *= 2.0);
        brighter.scene.lighting.sky.radiance = Vec3::ONE;
        all.push(pixels(&mut renderer, &brighter));
        all
    };
    let expected = walk(cpu(), ReceiverUpdate::All);
    assert!(walk(cpu(), ReceiverUpdate::InView) == expected, "what is in view differs");
    let Some(vulkan) = vulkan() else { return };
    assert!(walk(Box::new(vulkan), ReceiverUpdate::InView) == expected, "Vulkan differs");
}

#[test]
fn what_serves_no_objects_says_so() {
    let (mut renderer, loaded, id) = small(cpu(), |_| ());
    let light = renderer.light_mut();
    let positions = corners(Vec3::splat(0.05));
    let mesh =
        |material: usize| Mesh { positions: &positions, material: MaterialId::of_scene(material), ..Mesh::default() };
    let mut refused =
        |mesh: Mesh, transform: Affine3A| light.objects().insert(&mesh, transform).unwrap_err().to_string();
    assert!(refused(mesh(99), place(0)).contains("material is number 99"));
    assert!(refused(mesh(0), Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0))).contains("flattens"));
    assert!(light.objects().set_transform(id, Affine3A::from_translation(Vec3::NAN)).is_err());
    let error = light.set_method(MethodSettings::FirstShot(FirstShotSettings::default()), &Silent).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
    // What was refused has changed nothing.
    let point = SurfacePoint { position: Vec3::splat(0.2), patch: NONE, normal: Vec3::Y, weight: 1.0 };
    light.update(&loaded.scene.lighting).unwrap();
    assert!(light.irradiance_at(&[point]).unwrap()[0].min_element() > 0.0);
    assert_eq!(light.objects().ids(), [id]);
    assert_eq!(light.surface_irradiance().unwrap().len(), light.bake().receivers().interpolation.points.len());
    let (loaded, red) = scene_with_red("cornell");
    let setup =
        Setup { patches: PatchKind::Voxel, receivers: ReceiverKind::Patches, patch_count: 100, ..Setup::default() };
    let mut renderer = setup.renderer(&loaded, cpu()).unwrap();
    let mesh = Mesh { positions: &positions, material: red, ..Mesh::default() };
    let error = renderer.light_mut().objects().insert(&mesh, place(0)).unwrap_err();
    assert!(error.kind() == ErrorKind::Unsupported && error.to_string().contains("receivers on the mesh"), "{error}");
}

/// The door between two rooms, at an angle: 0 closes it.
fn door(angle: f32) -> Affine3A {
    // Its hinge is an edge of the doorway.
    let hinge = Vec3::new(4.0, 0.0, 1.3);
    Affine3A::from_rotation_translation(Quat::from_rotation_y(angle), hinge)
}

#[test]
fn a_door_changes_the_light_of_a_whole_room() {
    let (loaded, red) = scene_with_red("rooms");
    let half = Vec3::new(0.02, 1.06, 0.72);
    // Somewhat larger than the doorway, of 1.4 × 2.1 m.
    let positions: Vec<Vec3> = corners(half).iter().map(|p| *p + Vec3::new(0.0, 1.059, 0.7)).collect();
    let mesh = Mesh { positions: &positions, material: red, ..Mesh::default() };
    let sum = |all: &[Vec3]| all.iter().map(|c| luminance(*c)).sum::<f32>();
    for method in [MethodSettings::default(), MethodSettings::Multibounce(Codec::LowRank { epsilon: 0.01 })] {
        let size = (64, 48);
        let setup = Setup { size, patch_count: 1000, most_receivers: Some(6000), method, ..setup() };
        let mut renderer = setup.renderer(&loaded, cpu()).unwrap();
        let open = sum(&pixels(&mut renderer, &loaded)[1]);
        let id = renderer.light_mut().objects().insert(&mesh, door(0.0)).unwrap();
        for angle in [0.0f32, 20.0, 90.0] {
            let transform = door(-angle.to_radians());
            renderer.light_mut().objects().set_transform(id, transform).unwrap();
            let found = sum(&pixels(&mut renderer, &loaded)[1]) / open;
            let camera = loaded.view.camera(size.0, size.1);
            let settings = PathSettings { strategy: Strategy::Both, ..PathSettings::default() };
            let mut sums = Accumulation::new(&camera, settings);
            let scene = with_box(&loaded, mesh, transform);
            let go_on = |_, _| std::ops::ControlFlow::Continue(());
            PathTracer::new(&scene).accumulate(&camera, &mut sums, 256, go_on).unwrap();
            let expected = sum(&sums.indirect().pixels) / open;
            // Of the light of the open room: rows that see past the frame take some with them.
            assert!((found - expected).abs() < 0.08, "{angle}°: {found} of {expected}");
            // Where the door does nothing, or nothing but in front of itself, far more is left.
            assert!(angle > 0.0 || found < 0.1, "a closed door leaves {found}");
        }
    }
}

#[test]
fn scene_files_have_objects() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    write("room.obj", "mtllib room.mtl\nusemtl paint\nv 0 0 0\nv 0 0 400\nv 400 0 0\nf 1 2 3\n");
    write("room.mtl", "newmtl paint\nKd 0.5 0.5 0.5\n");
    write("cart.obj", "v 0 0 0\nv 0 0 10\nv 10 0 0\nf 1 2 3\n");
    let scene = |object: &str| {
        let text = format!("version = 1\nmesh = \"room.obj\"\nmetres_per_unit = 0.01\n[[object]]\n{object}\n");
        assets::load_or_build(write("scene.toml", &text).to_str().unwrap())
    };
    let keyframes = "keyframes = [{ time = 0, position = [100, 50, 100] }, \
                     { time = 2, position = [200, 50, 100], degrees = 90 }]";
    let loaded = scene(&format!("mesh = \"cart.obj\"\nmaterial = \"paint\"\n{keyframes}")).unwrap();
    let cart = &loaded.moving[0];
    assert_eq!((cart.name.as_str(), cart.corners.len(), loaded.scene.geometry.triangles.len()), ("cart", 3, 1));
    let corner = cart.transform(2.0).transform_point3(Vec3::X * 0.1);
    assert!((corner - Vec3::new(2.0, 0.5, 0.9)).length() < 1e-6, "{corner}");
    assert_eq!(loaded.scene_at(1.0).unwrap().geometry.triangles.len(), 2);
    assert!(loaded.files.iter().any(|file| file.ends_with("cart.obj")));
    for (object, fault) in [
        (format!("mesh = \"cart.obj\"\nmaterial = \"gold\"\n{keyframes}"), "no material of the mesh"),
        (format!("mesh = \"no.obj\"\nmaterial = \"paint\"\n{keyframes}"), "no.obj"),
        ("mesh = \"cart.obj\"\nmaterial = \"paint\"\nkeyframes = []".to_owned(), "is empty"),
        (format!("mesh = \"cart.obj\"\nmaterial = \"paint\"\nspeed = 3\n{keyframes}"), "speed"),
        (keyframes.to_owned(), "mesh"),
    ] {
        let error = scene(&object).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(error.contains(fault) && error.contains("scene.toml"), "{error}");
    }
}
