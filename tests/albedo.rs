//! Another albedo of materials after a bake: light and pictures are those of the edited scene with the form factors of
//! the bake.

use std::sync::Arc;

use assets::{LoadedScene, procedural};
use glam::{Vec3, Vec4};
use integration_tests::setup::Setup;
use integration_tests::vulkan;
use patches::PatchKind;
use patchlight::low_level::operator::Codec;
use patchlight::method::temporal::RowKind;
use patchlight::method::{FeedbackSettings, FirstShotSettings, LocalSettings, TemporalSettings};
use patchlight::{Bake, ErrorKind, MethodSettings, Picture, PictureRenderer, ReceiverKind, Silent};
use runtime::cpu::Cpu;
use runtime::executor::Executor;
use scene::math::luminance;
use scene::{Lighting, Material, NONE, Scene};

const SIZE: (u32, u32) = (32, 24);
/// Frames after which light that goes on from frame to frame has settled.
const SETTLING: u32 = 60;
/// Median relative difference of pixels: rounding, and with photons their noise.
const TOLERANCE: f32 = 0.005;
const GREEN: Vec3 = Vec3::new(0.05, 0.9, 0.1);

fn setup(patches: PatchKind, method: MethodSettings) -> Setup {
    Setup { patches, method, ..Setup::coarse() }
}

/// Methods whose operators do not hold the albedo.
fn methods() -> [MethodSettings; 4] {
    [
        MethodSettings::Classic,
        MethodSettings::Feedback(FeedbackSettings::default()),
        MethodSettings::Temporal(TemporalSettings::default()),
        MethodSettings::FirstShot(FirstShotSettings { error: 0.02, ..FirstShotSettings::default() }),
    ]
}

fn cpu() -> Box<dyn Executor> {
    Box::new(Cpu::new())
}

fn picture(renderer: &mut PictureRenderer, loaded: &LoadedScene, lighting: &Lighting) -> Picture {
    renderer.picture(lighting, &loaded.view.camera(SIZE.0, SIZE.1), 0).unwrap().pictures.indirect
}

fn settled(renderer: &mut PictureRenderer, loaded: &LoadedScene) -> Picture {
    let lighting = &loaded.scene.lighting;
    for _ in 0..SETTLING {
        renderer.update_light(lighting, &loaded.view.camera(SIZE.0, SIZE.1)).unwrap();
    }
    picture(renderer, loaded, lighting)
}

/// Median relative difference of the luminance of pixels that are not black.
fn difference(a: &Picture, b: &Picture) -> f32 {
    let pairs = a.pixels.iter().zip(&b.pixels).map(|(a, b)| (luminance(*a), luminance(*b)));
    let mut relative: Vec<f32> = pairs.filter(|pair| pair.1 > 0.0).map(|(a, b)| (a - b).abs() / b).collect();
    relative.sort_by(f32::total_cmp);
    relative[relative.len() / 2]
}

fn bits(picture: &Picture) -> Vec<[u32; 3]> {
    picture.pixels.iter().map(|pixel| pixel.to_array().map(f32::to_bits)).collect()
}

/// The floor, walls and ceiling that are white become green.
fn white_to_green(loaded: &LoadedScene) -> Vec<Option<Vec3>> {
    let is_white = |material: &Material| material.albedo.min_element() > 0.6 && material.radiance == Vec3::ZERO;
    let changed: Vec<Option<Vec3>> =
        loaded.scene.materials.iter().map(|material| is_white(material).then_some(GREEN)).collect();
    assert!(changed.iter().any(Option::is_some) && changed.iter().any(Option::is_none), "{changed:?}");
    changed
}

/// The triangle whose plane is nearest to a point that is within it: with no ray.
fn triangle_of(scene: &Scene, point: Vec3) -> usize {
    let distance = |triangle: usize| {
        let t = scene.geometry.triangles[triangle];
        let (u, v) = scene.shares(triangle as u32, point);
        let inside = u > -1e-4 && v > -1e-4 && u + v < 1.0 + 1e-4;
        let normal = t.edge_a.cross(t.edge_b).normalize();
        if inside { (point - t.corner).dot(normal).abs() } else { f32::INFINITY }
    };
    let triangles = 0..scene.geometry.triangles.len();
    triangles.min_by(|&a, &b| distance(a).total_cmp(&distance(b))).unwrap()
}

/// The edited scene with the form factors of the bake.
fn edited(bake: &Bake, changed: &[Option<Vec3>], bounces: u32) -> Arc<Bake> {
    let mut scene = bake.scene().clone();
    let own = Arc::make_mut(&mut scene.materials).iter_mut().zip(changed);
    own.for_each(|(material, changed)| material.albedo = changed.unwrap_or(material.albedo));
    let mut mesh = patches::PatchMesh::clone(bake.mesh());
    for (albedo, point) in mesh.point_albedo.iter_mut().zip(&mesh.points) {
        let triangle = triangle_of(&scene, point.position);
        let material = scene.geometry.triangles[triangle].material;
        *albedo = scene.materials[material as usize].albedo.extend(0.0);
    }
    for (element, own) in mesh.element_albedo.iter_mut().zip(mesh.offsets.windows(2)) {
        let own = own[0] as usize..own[1] as usize;
        *element = own.map(|k| mesh.point_albedo[k] * mesh.points[k].weight).sum::<Vec4>();
    }
    mesh.albedo = mesh.patch_means(&mesh.element_albedo);
    Arc::new(bake.clone().with_scene(scene).with_mesh(Arc::new(mesh)).with_bounces(bounces))
}

#[test]
fn another_albedo_gives_the_picture_of_the_edited_scene() {
    let loaded = procedural::build("cornell").unwrap();
    let changed = white_to_green(&loaded);
    let kinds = [PatchKind::Cluster, PatchKind::Polygon, PatchKind::Axis];
    for (kind, method) in kinds.into_iter().flat_map(|kind| methods().map(|method| (kind, method))) {
        let setup = setup(kind, method);
        let bake = setup.bake(&loaded).unwrap();
        let mut renderer = setup.load(&loaded, &bake, cpu()).unwrap();
        let before = settled(&mut renderer, &loaded);
        renderer.light_mut().set_albedo(&changed).unwrap();
        let after = settled(&mut renderer, &loaded);
        // More bounces than either has.
        let other = edited(&bake, &changed, 2 * bake.bounces() + 16);
        let expected = settled(&mut setup.load(&loaded, &other, cpu()).unwrap(), &loaded);
        let wrong = difference(&after, &expected);
        assert!(wrong < TOLERANCE, "{kind:?} {method:?}: {wrong}");
        let unchanged = difference(&before, &expected);
        assert!(unchanged > 20.0 * TOLERANCE, "{kind:?} {method:?}: as before: {unchanged}");
        // Half of the way is noticed, too.
        let half: Vec<_> = changed.iter().map(|albedo| albedo.map(|albedo| 0.9 * albedo)).collect();
        renderer.light_mut().set_albedo(&half).unwrap();
        let wrong = difference(&settled(&mut renderer, &loaded), &expected);
        assert!(wrong > 2.0 * TOLERANCE, "{kind:?} {method:?}: nine tenths of it: {wrong}");
    }
}

/// In a closed box of uniform emission Le and albedo ρ all light but that of the first bounce is `Le ρ² / (1 − ρ)`: of
/// two albedos the ratio is known, whatever the box was baked with.
#[test]
fn a_furnace_has_the_light_of_its_new_albedo() {
    let loaded = procedural::build("furnace").unwrap();
    let setup = setup(PatchKind::Polygon, MethodSettings::Classic);
    let bake = setup.bake(&loaded).unwrap();
    let indirect = |albedo: Vec3| albedo * albedo / (Vec3::ONE - albedo);
    let material = loaded.scene.materials[0];
    for method in [MethodSettings::Classic, MethodSettings::Feedback(FeedbackSettings::default())] {
        let mut renderer = Setup { method, ..setup }.load(&loaded, &bake, cpu()).unwrap();
        let own = settled(&mut renderer, &loaded).mean();
        for albedo in [Vec3::new(0.9, 0.2, 0.6), Vec3::new(0.3, 0.1, 0.8)] {
            renderer.light_mut().set_albedo(&vec![Some(albedo); loaded.scene.materials.len()]).unwrap();
            let found = settled(&mut renderer, &loaded).mean() / own;
            let expected = indirect(albedo) / indirect(material.albedo);
            let wrong = (found / expected - Vec3::ONE).abs().max_element();
            assert!(wrong < TOLERANCE, "{method:?} {albedo}: {found} {expected}");
        }
    }
}

#[test]
fn an_albedo_on_the_device_gives_the_bits_of_the_processor() {
    let Some(device) = vulkan() else { return };
    let loaded = procedural::build("cornell").unwrap();
    let changed = white_to_green(&loaded);
    let setup = setup(PatchKind::Cluster, MethodSettings::Feedback(FeedbackSettings::default()));
    let bake = setup.bake(&loaded).unwrap();
    let pictures = |executor: Box<dyn Executor>| {
        let mut renderer = setup.load(&loaded, &bake, executor).unwrap();
        let mut pictures = vec![bits(&picture(&mut renderer, &loaded, &loaded.scene.lighting))];
        renderer.light_mut().set_albedo(&changed).unwrap();
        for _ in 0..3 {
            pictures.push(bits(&picture(&mut renderer, &loaded, &loaded.scene.lighting)));
        }
        pictures
    };
    let on_host = pictures(cpu());
    assert_ne!(on_host[0], on_host[3]);
    assert!(pictures(Box::new(device)) == on_host, "the device differs from the processor");
}

#[test]
fn the_albedo_of_the_bake_comes_back() {
    let loaded = procedural::build("cornell").unwrap();
    let setup = setup(PatchKind::Cluster, MethodSettings::Classic);
    let bake = setup.bake(&loaded).unwrap();
    let lighting = &loaded.scene.lighting;
    let mut renderer = setup.load(&loaded, &bake, cpu()).unwrap();
    let before = bits(&picture(&mut renderer, &loaded, lighting));
    let changed = white_to_green(&loaded);
    renderer.light_mut().set_albedo(&changed).unwrap();
    let green = bits(&picture(&mut renderer, &loaded, lighting));
    assert_ne!(green, before);
    // It outlasts other plans and other emission.
    renderer.resize(SIZE, 1).unwrap();
    renderer.set_method(MethodSettings::Temporal(TemporalSettings::default()), &Silent).unwrap();
    let emission = loaded.scene.materials.iter().map(|material| 2.0 * material.radiance).collect();
    picture(&mut renderer, &loaded, &Lighting { emission, ..lighting.clone() });
    renderer.resize(SIZE, setup.sub_frames).unwrap();
    renderer.set_method(MethodSettings::Classic, &Silent).unwrap();
    let again = picture(&mut renderer, &loaded, lighting);
    assert!(bits(&again) == green, "other plans");
    renderer.light_mut().set_albedo(&vec![None; changed.len()]).unwrap();
    assert!(bits(&picture(&mut renderer, &loaded, lighting)) == before);
}

/// A surface that is bright all over needs more bounces than the bake of something dark; the renderer makes another
/// plan.
#[test]
fn a_dark_scene_becomes_bright() {
    let mut loaded = procedural::build("cornell").unwrap();
    let materials: Vec<Material> =
        loaded.scene.materials.iter().map(|material| Material { albedo: Vec3::splat(0.02), ..*material }).collect();
    loaded.scene.materials = materials.into();
    let setup = setup(PatchKind::Polygon, MethodSettings::Classic);
    let bake = setup.bake(&loaded).unwrap();
    let changed = vec![Some(Vec3::splat(0.9)); loaded.scene.materials.len()];
    let other = edited(&bake, &changed, 200);
    let expected = settled(&mut setup.load(&loaded, &other, cpu()).unwrap(), &loaded);
    // Photons need no bounces.
    for method in &methods()[..3] {
        let setup = Setup { method: *method, ..setup };
        let mut renderer = setup.load(&loaded, &bake, cpu()).unwrap();
        renderer.light_mut().set_albedo(&changed).unwrap();
        let wrong = difference(&settled(&mut renderer, &loaded), &expected);
        assert!(wrong < TOLERANCE, "{method:?}: {wrong}");
    }
    // With the bounces of the bake it is not.
    let few = edited(&bake, &changed, bake.bounces());
    let few = settled(&mut setup.load(&loaded, &few, cpu()).unwrap(), &loaded);
    assert!(difference(&few, &expected) > 0.1, "{} bounces suffice", bake.bounces());
}

#[test]
fn a_texture_gives_way_to_another_albedo() {
    let loaded = procedural::build("atrium").unwrap();
    let textured = |material: &Material| material.albedo_texture != NONE;
    assert!(loaded.scene.materials.iter().any(textured));
    let setup = setup(PatchKind::Cluster, MethodSettings::Classic);
    let bake = setup.bake(&loaded).unwrap();
    let mut renderer = setup.load(&loaded, &bake, cpu()).unwrap();
    let changed = vec![Some(Vec3::splat(0.5)); loaded.scene.materials.len()];
    renderer.light_mut().set_albedo(&changed).unwrap();
    // With one albedo everywhere that of the elements needs no ray.
    let other = Bake::clone(&edited(&bake, &changed, bake.bounces()));
    let mut scene = other.scene().clone();
    Arc::make_mut(&mut scene.materials).iter_mut().for_each(|material| material.albedo_texture = NONE);
    let other = other.with_scene(scene);
    let expected = picture(&mut setup.load(&loaded, &Arc::new(other), cpu()).unwrap(), &loaded, &loaded.scene.lighting);
    let found = picture(&mut renderer, &loaded, &loaded.scene.lighting);
    let wrong = difference(&found, &expected);
    assert!(wrong < TOLERANCE, "{wrong}");
}

#[test]
fn methods_that_hold_the_albedo_refuse_another_one_by_name() {
    let loaded = procedural::build("cornell").unwrap();
    let changed = white_to_green(&loaded);
    let tiles = MethodSettings::Multibounce(Codec::LowRank { epsilon: 0.1 });
    let local = MethodSettings::Local(LocalSettings { slots: 64, ..LocalSettings::default() });
    let sampled = TemporalSettings { rows: RowKind::AllBounces, ..TemporalSettings::default() };
    let cases = [
        (tiles, "low_rank"),
        (MethodSettings::Multibounce(Codec::Dense), "multibounce"),
        (local, "local"),
        (MethodSettings::Temporal(sampled), "temporal with the rows of all bounces"),
    ];
    let classic = setup(PatchKind::Cluster, MethodSettings::Classic);
    let bake = classic.bake(&loaded).unwrap();
    let lighting = &loaded.scene.lighting;
    for (method, name) in cases {
        let setup = Setup { method, ..classic };
        let mut renderer = setup.load(&loaded, &bake, cpu()).unwrap();
        let before = bits(&picture(&mut renderer, &loaded, lighting));
        let error = renderer.light_mut().set_albedo(&changed).unwrap_err();
        assert!(error.to_string().starts_with(&format!("the operator of {name} holds")), "{error}");
        assert!(error.to_string().contains("feedback"), "{error}");
        assert!(bits(&picture(&mut renderer, &loaded, lighting)) == before);
        // That of the bake is not another one.
        renderer.light_mut().set_albedo(&vec![None; changed.len()]).unwrap();
        // Nor can such a method be chosen after.
        let mut renderer = classic.load(&loaded, &bake, cpu()).unwrap();
        renderer.light_mut().set_albedo(&changed).unwrap();
        assert_eq!(renderer.set_method(method, &Silent).unwrap_err().kind(), ErrorKind::Unsupported);
    }
    let mut renderer = classic.load(&loaded, &bake, cpu()).unwrap();
    let count = changed.len();
    let error = renderer.light_mut().set_albedo(&changed[1..]).unwrap_err();
    assert!(error.to_string().starts_with(&format!("an albedo for {} materials of {count};", count - 1)), "{error}");
    for value in [-0.1, 0.96, f32::NAN, f32::INFINITY] {
        let mut wrong = changed.clone();
        wrong[1] = Some(Vec3::new(0.5, value, 0.5));
        let error = renderer.light_mut().set_albedo(&wrong).unwrap_err();
        assert!(error.to_string().starts_with("material 1 is to reflect"), "{error}");
    }
    let voxels = Setup { receivers: ReceiverKind::Patches, ..setup(PatchKind::Voxel, MethodSettings::Classic) };
    let mut renderer = voxels.renderer(&loaded, cpu()).unwrap();
    let before = picture(&mut renderer, &loaded, lighting);
    renderer.light_mut().set_albedo(&changed).unwrap();
    assert!(difference(&picture(&mut renderer, &loaded, lighting), &before) > 0.1, "patches that are receivers");
}
