//! Edits of a bake: objects that move, go and come, beside fresh bakes of the scene as it then is.

use std::collections::BTreeMap;
use std::sync::Arc;

use assets::import::LoadedScene;
use integration_tests::setup::Setup;
use patchlight::glam::{Affine3A, Quat, Vec3, Vec3Swizzles as _};
use patchlight::scene::sampling::{hash3, unit};
use patchlight::{
    Bake, BakeSettings, Cpu, EditedBake, Estimator, Flux, Light, LightField, LightSettings, Material, MaterialId, Mesh,
    MethodSettings, Picture, Point, PointKind, Scene, Silent, SurfacePoint,
};

/// Random edits of each scene.
const EDITS: u32 = 20;
/// Most rays that edits of small objects may trace, on average, as a share of those of fresh bakes.
const MOST_TRACED: f64 = 0.1;
/// Objects with less than this share of the area are small.
const SMALL: f32 = 0.01;
/// Edge of a block of pixels.
const BLOCK: u32 = 8;

fn settings() -> BakeSettings {
    BakeSettings::default()
        .with_patch_count(600)
        .with_estimator(Estimator::Hemisphere { rays: 512 })
        .with_receiver_rays(128)
        .with_receiver_density(0.5)
}

fn build(scene: &Scene, seed: u32) -> Bake {
    Bake::build(scene, &settings().with_seed(seed), &Silent).unwrap()
}

/// Indirect light of a scene's view, in blocks.
fn blocks(loaded: &LoadedScene, bake: &Bake) -> Vec<Vec3> {
    let setup = Setup { size: (96, 64), sub_frames: 4, ..Setup::default() };
    let mut renderer = setup.load(loaded, &Arc::new(bake.clone()), Box::new(Cpu::new())).unwrap();
    let camera = loaded.view.camera(96, 64);
    let picture: Picture = renderer.picture(&bake.scene().lighting, &camera, 0).unwrap().pictures.indirect;
    let mut sums = vec![Vec3::ZERO; (96 / BLOCK * (64 / BLOCK)) as usize];
    for (k, pixel) in (0u32..).zip(&picture.pixels) {
        sums[(k / 96 / BLOCK * (96 / BLOCK) + k % 96 / BLOCK) as usize] += *pixel;
    }
    sums
}

/// Mean difference of blocks, as a share of their mean.
fn difference(a: &[Vec3], b: &[Vec3]) -> f32 {
    let sum = |of: &dyn Fn(usize) -> Vec3| (0..a.len()).map(|k| of(k).abs().element_sum()).sum::<f32>();
    sum(&|k| a[k] - b[k]) / sum(&|k| b[k])
}

/// Area and middle of each object.
fn objects(scene: &Scene) -> BTreeMap<u32, (f32, Vec3)> {
    let mut found: BTreeMap<u32, (f32, Vec3)> = BTreeMap::new();
    for t in &scene.geometry.triangles {
        let area = 0.5 * t.edge_a.cross(t.edge_b).length();
        let (sum, middle) = found.entry(t.object).or_default();
        *middle += (t.corner + (t.edge_a + t.edge_b) / 3.0) * area;
        *sum += area;
    }
    found.values_mut().for_each(|(area, middle)| *middle /= *area);
    found
}

fn random(edit: u32, dimension: u32) -> f32 {
    unit(hash3(edit, dimension, 0x6564_6974))
}

/// Moves a small object and turns it, takes one away, or adds a box that lies or floats about one.
fn random_edit(scene: &Scene, number: u32) -> Scene {
    let all = objects(scene);
    let whole: f32 = all.values().map(|object| object.0).sum();
    let small: Vec<(u32, Vec3)> =
        all.iter().filter(|(_, object)| object.0 < SMALL * whole).map(|(&object, found)| (object, found.1)).collect();
    let (object, middle) = small[(random(number, 0) * small.len() as f32) as usize];
    let way = Vec3::new(random(number, 1) - 0.5, 0.0, random(number, 2) - 0.5);
    let turn = Affine3A::from_rotation_y(std::f32::consts::TAU * random(number, 3));
    let mut edit = scene.edit();
    match number % 4 {
        2 => {
            let is_dull = |&m: &usize| scene.materials[m].radiance == Vec3::ZERO;
            let dull: Vec<usize> = (0..scene.materials.len()).filter(is_dull).collect();
            let material = MaterialId::of_scene(dull[(random(number, 4) * dull.len() as f32) as usize]);
            let mut corners = Vec::new();
            for [a, b] in [[Vec3::X, Vec3::Y], [Vec3::Y, Vec3::Z], [Vec3::Z, Vec3::X]] {
                for side in [-0.5, 0.5] {
                    let out = a.cross(b) * side;
                    let [p, q] = if side > 0.0 { [a, b] } else { [b, a] };
                    let quad = [-p - q, p - q, p + q, -p - q, p + q, -p + q];
                    corners.extend(quad.map(|corner| out + corner * 0.5));
                }
            }
            let transform = Affine3A::from_scale_rotation_translation(
                Vec3::new(0.25, 0.35, 0.2),
                Quat::from_mat3a(&turn.matrix3),
                middle + way + Vec3::Y * random(number, 5),
            );
            edit.add(Mesh { name: "box", positions: &corners, material, transform, ..Mesh::default() });
        }
        3 => {
            edit.remove(object);
        }
        _ => {
            let there = Affine3A::from_translation(middle + way) * turn * Affine3A::from_translation(-middle);
            edit.transform(object, there);
        }
    }
    edit.build().unwrap()
}

/// Many edits, each of the bake that the one before gave; the last bake beside fresh ones.
fn check_edits(name: &str) {
    let mut loaded = assets::procedural::build(name).unwrap();
    let first = build(&loaded.scene, 0);
    let mut bake = first.clone();
    let mut traced = 0.0;
    for number in 0..EDITS {
        loaded.scene = random_edit(&loaded.scene, number);
        let edited: EditedBake = bake.edit(&loaded.scene, &Silent).unwrap();
        assert!(edited.traced_rays > 0, "{name}, edit {number}");
        traced += edited.traced_rays as f64 / edited.all_rays as f64;
        bake = edited.bake;
    }
    let share = traced / f64::from(EDITS);
    assert!(share <= MOST_TRACED, "{name}: {share} of the rays of fresh bakes");
    let fresh = [0, 1, 2].map(|seed| blocks(&loaded, &build(&loaded.scene, seed)));
    let noise = (0..3).map(|k| difference(&fresh[k], &fresh[(k + 1) % 3])).sum::<f32>() / 3.0;
    let beside = |bake: &Bake| {
        let own = blocks(&loaded, bake);
        fresh.iter().map(|fresh| difference(&own, fresh)).sum::<f32>() / 3.0
    };
    let edited = beside(&bake);
    let stale = beside(&first);
    println!("{name}: {edited} beside fresh bakes, which differ by {noise}; {share} of their rays; stale {stale}");
    assert!(edited <= 1.5 * noise, "{name}: {edited} beside fresh bakes, which differ by {noise}");
    assert!(stale > 1.5 * noise, "{name}: a bake without the edits passes: {stale}");
}

#[test]
fn twenty_edits_of_the_office_are_as_good_as_a_fresh_bake() {
    check_edits("office");
}

#[test]
fn twenty_edits_of_the_clutter_are_as_good_as_a_fresh_bake() {
    check_edits("clutter");
}

#[test]
fn an_edit_that_changes_nothing_traces_nothing() {
    let scene = assets::procedural::build("cornell").unwrap().scene;
    let bake = build(&scene, 0);
    let edited = bake.edit(&scene.edit().build().unwrap(), &Silent).unwrap();
    assert_eq!(edited.traced_rays, 0);
    assert!(edited.bake.receivers().rows == bake.receivers().rows && edited.all_rays > 0);
}

#[test]
fn light_comes_into_a_room_that_was_closed() {
    // A box in a box: the lamp is in the outer one. Without its lid the inner one is lit.
    let quad = |p: Vec3, a: Vec3, b: Vec3| [p, p + a, p + a + b, p, p + a + b, p + b];
    let cuboid = |low: Vec3, size: Vec3| {
        let [x, y, z] = [Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z];
        [
            quad(low, x, y),
            quad(low + z, y, x),
            quad(low, y, z),
            quad(low + x, z, y),
            quad(low, z, x),
            quad(low + y, x, z),
        ]
    };
    let mut builder = Scene::builder();
    let grey = builder.add_material(Material::diffuse(Vec3::splat(0.6)));
    let outer = cuboid(Vec3::ZERO, Vec3::splat(4.0)).concat();
    let inner = cuboid(Vec3::new(1.0, 0.0, 1.0), Vec3::new(2.0, 1.0, 2.0));
    builder.add_mesh(Mesh { name: "outer", positions: &outer, material: grey, ..Mesh::default() });
    builder.add_mesh(Mesh { name: "inner", positions: &inner[..5].concat(), material: grey, ..Mesh::default() });
    let lid = builder.add_mesh(Mesh { name: "lid", positions: &inner[5], material: grey, ..Mesh::default() });
    builder.add_light(Light::point(Vec3::new(2.0, 3.5, 2.0), Flux::lumens(3000.0)));
    let closed = builder.build().unwrap();
    let mut edit = closed.edit();
    edit.remove(lid.object());
    let open = edit.build().unwrap();

    let bake = build(&closed, 0);
    let edited = bake.edit(&open, &Silent).unwrap().bake;
    let fresh = build(&open, 0);
    let floor = [Point { position: Vec3::new(2.0, 0.001, 2.0), normal: Vec3::Y }];
    let light = |bake: &Bake| {
        let settings = LightSettings::default().with_method(MethodSettings::Classic);
        let mut field = LightField::new(Arc::new(bake.clone()), Box::new(Cpu::new()), &settings, &Silent).unwrap();
        let set = field.add_points(&floor, PointKind::Irradiance, &Silent).unwrap();
        field.update(&bake.scene().lighting).unwrap();
        let inside = |s: &&SurfacePoint| s.position.y < 0.01 && (s.position.xz() - 2.0).abs().max_element() < 0.9;
        let receivers = bake.receivers().points.iter().filter(inside).count();
        (field.read(set).unwrap().values[0].truncate().element_sum(), receivers)
    };
    let [(dark, none), (lit, some), (expected, others)] = [&bake, &edited, &fresh].map(light);
    assert!(none == 0 && some > 0 && others > 0, "{none}, {some} and {others} receivers inside");
    assert!(dark < 0.01 * expected && (lit / expected - 1.0).abs() < 0.1, "{dark} then {lit}, fresh {expected}");
}
